//! `vdt bench pictures`: whether what is drawn looks like the full mesh, point by point.
//!
//! The front is drawn as `vdt render` draws it, and so is the full mesh: the model with every split applied, which is the input but
//! for what its input error tells. See [`likeness`](super::likeness) for what is compared and when a point counts as a hole or a
//! crack, and [`open_sides`](super::open_sides) for the sides that are open.
//!
//! With `--cold` each camera stands still from a start with nothing read, and pictures are looked at while pages are missing. They
//! are coarser; a hole is then only what is farther from the outline than the error that is drawn, and where that is more than the
//! picture, nothing is said of holes. Whether the mesh is closed where it should be is exact all the same, and whether it is drawn so
//! does not depend on the error.
//!
//! The full mesh, its triangles by place and both pictures are in RAM beside the front: about 100 bytes for each triangle.

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use metanode::UniformCut;
use metanode::header::ModelError;
use metanode::model::Model;
use metanode::page::Normal;
use navigator::path::overview;
use navigator::walk::STEPS_PER_SECOND;
use navigator::{Camera, FrameStatistics, Io, Navigator, NavigatorOptions, PathSpec};
use render::{Buffers, Picture, Projection, draw};
use serde_json::{Value, json};
use storage::{FaultyDisk, LocalDisk};

use super::likeness::{Likeness, NEAR, OUTLINE_REACH, Share, Side};
use super::machine::Machine;
use super::open_sides::OpenSides;
use super::surface::Surface;
use super::{check_files, mesh_name};
use crate::arguments::{PictureSize, PicturesBenchOptions};
use crate::compare::available_threads;
use crate::extract::MOST_FRAMES;
use crate::output::grouped;
use crate::progress::Progress;
use crate::table::{Table, UNKNOWN};

/// How much of the surface and of the outlines is to be near, in percent.
const GOAL_PERCENT: f64 = 99.9;
/// How far from the outline of the full mesh a hole is, in points, beside the error where that is more than was asked for.
const HOLE_REACH: f64 = 2.0;
/// Frames of a cold start that are looked at, counted from 1.
const COLD_FRAMES: [u64; 3] = [1, 10, 100];
/// Frames of the flight of which those near the surface are.
const FLIGHT_FRAMES: u32 = 1000;

/// All triangles of a model.
struct FullMesh {
    vertices: Vec<[f32; 4]>,
    triangles: Vec<[u32; 3]>,
    surface: Surface,
    open_sides: OpenSides,
}

impl FullMesh {
    fn of(model: &Model) -> Result<Self> {
        let cut = UniformCut::new(model, 0.0)?;
        let normal = f32::from_bits(Normal::UP.to_word());
        let mut vertices = Vec::with_capacity(cut.vertex_count() as usize);
        cut.for_each_vertex(|[x, y, z]| -> Result<(), ModelError> {
            vertices.push([x, y, z, normal]);
            Ok(())
        })?;
        let mut triangles = Vec::with_capacity(cut.triangle_count() as usize);
        cut.for_each_triangle(|corners| -> Result<(), ModelError> {
            triangles.push(corners.map(|corner| corner as u32));
            Ok(())
        })?;
        let surface = surface(&vertices, &triangles);
        let open_sides = OpenSides::new(vertices.len(), &triangles);
        Ok(FullMesh { vertices, triangles, surface, open_sides })
    }

    fn buffers(&self) -> Buffers<'_> {
        Buffers { vertices: &self.vertices, triangles: &self.triangles, ..Buffers::default() }
    }
}

/// The triangles of two streams; places without one are left out.
fn surface(vertices: &[[f32; 4]], triangles: &[[u32; 3]]) -> Surface {
    let position = |corner: u32| {
        let [x, y, z, _] = vertices[corner as usize];
        [x, y, z]
    };
    let is_there = |[a, b, c]: &&[u32; 3]| a != b && b != c && c != a;
    Surface::new(triangles.iter().filter(is_there).map(|corners| corners.map(position)))
}

/// A camera with the name of its place.
struct Viewpoint {
    name: String,
    camera: Camera,
}

/// Where the model is looked at from: as a whole, from an orbit, and from near its surface.
fn viewpoints(model: &Model, count: u32, size: PictureSize) -> Result<Vec<Viewpoint>> {
    let mut found = vec![Viewpoint { name: "overview".into(), camera: overview(model, size.width, size.height) }];
    let on_orbit = (count - 1) / 2;
    if on_orbit > 0 {
        let cameras = PathSpec::Orbit { frames: on_orbit }.cameras(&LocalDisk, model)?;
        found.extend((1..).zip(cameras).map(|(number, camera)| Viewpoint { name: format!("orbit {number}"), camera }));
    }
    let near = count - 1 - on_orbit;
    if near > 0 {
        let flight = PathSpec::Flyby { frames: FLIGHT_FRAMES }.cameras(&LocalDisk, model)?;
        found.extend((1..=near).map(|number| {
            let frame = u64::from(number) * flight.len() as u64 / u64::from(near + 1);
            Viewpoint { name: format!("flyby {number}"), camera: flight[frame as usize] }
        }));
    }
    Ok(found)
}

/// A picture of a front, beside that of the full mesh.
struct Row {
    model: String,
    full_triangles: u64,
    viewpoint: String,
    camera: Camera,
    /// Which frame after a cold start, counted from 1.
    cold_frame: Option<u64>,
    settled: bool,
    statistics: FrameStatistics,
    likeness: Likeness,
    open_sides: u64,
}

/// What all pictures come to.
#[derive(Default)]
struct Total {
    likeness: Likeness,
    /// The smallest share of a picture in percent: of the surface and of the outline.
    least: [f64; 4],
    open_sides: u64,
}

impl Total {
    fn of(rows: &[Row]) -> Self {
        let mut total = Total { least: [100.0; 4], ..Total::default() };
        for row in rows {
            let Likeness { near, outline, holes, seen_through, cracks, chinks, pinholes, looked_at, .. } =
                &row.likeness;
            for side in 0..2 {
                total.likeness.near[side].add(near[side]);
                total.likeness.outline[side].add(outline[side]);
            }
            total.likeness.holes += holes;
            total.likeness.seen_through += seen_through;
            total.likeness.cracks += cracks;
            total.likeness.chinks += chinks;
            total.likeness.pinholes += pinholes;
            total.likeness.looked_at += looked_at;
            total.open_sides += row.open_sides;
            for (least, share) in total.least.iter_mut().zip(shares(&row.likeness)) {
                *least = least.min(share.percent());
            }
        }
        total
    }

    fn has_gaps(&self) -> bool {
        self.likeness.holes + self.likeness.cracks + self.likeness.pinholes + self.open_sides > 0
    }
}

/// Those of the surface, and those of the outline.
fn shares(Likeness { near, outline, .. }: &Likeness) -> [&Share; 4] {
    [&near[0], &near[1], &outline[0], &outline[1]]
}

/// What a picture is drawn into and compared with.
struct Studio<'a> {
    options: &'a PicturesBenchOptions,
    mesh: &'a FullMesh,
    full: Picture,
    front: Picture,
}

impl Studio<'_> {
    /// Draws the full mesh.
    fn draw_full(&mut self, projection: &Projection) {
        self.full.clear();
        draw(&mut self.full, projection, self.mesh.buffers(), false);
    }

    /// Draws the front, and compares.
    fn row(
        &mut self,
        navigator: &Navigator,
        viewpoint: &Viewpoint,
        projection: &Projection,
        statistics: FrameStatistics,
        cold_frame: Option<u64>,
    ) -> Row {
        let (vertices, triangles) = (navigator.vertex_stream(), navigator.triangle_stream());
        self.front.clear();
        draw(&mut self.front, projection, Buffers { vertices, triangles, ..Buffers::default() }, false);
        let drawn = surface(vertices, triangles);
        let front = Side {
            picture: &self.front,
            buffers: Buffers { vertices, triangles, ..Buffers::default() },
            surface: &drawn,
        };
        let full = Side { picture: &self.full, buffers: self.mesh.buffers(), surface: &self.mesh.surface };
        let more = if cold_frame.is_some() { f64::from(statistics.pixels_drawn) } else { 0.0 };
        Row {
            model: mesh_name(navigator.model().path()),
            full_triangles: self.mesh.triangles.len() as u64,
            viewpoint: viewpoint.name.clone(),
            camera: viewpoint.camera,
            cold_frame,
            settled: navigator.settled(),
            statistics,
            likeness: Likeness::of(projection, front, full, HOLE_REACH + more, available_threads()),
            open_sides: self.mesh.open_sides.wrong(navigator),
        }
    }
}

pub fn run(options: &PicturesBenchOptions, json: bool) -> Result<()> {
    check_files(&options.models.iter().map(|model| model.as_path()).collect::<Vec<_>>(), None, false)?;
    let progress = Progress::new("drawing");
    let mut rows = Vec::new();
    for (number, path) in options.models.iter().enumerate() {
        let show = |part: f64| progress.show((number as f64 + part) / options.models.len() as f64);
        look_at(options, path, &mut rows, &show)?;
    }
    drop(progress);
    let total = Total::of(&rows);
    let mut out = io::stdout().lock();
    if json {
        writeln!(out, "{:#}", to_json(options, &rows, &total))?;
    } else {
        let (heading, table) = if options.cold {
            ("while pages are missing", cold_table(&rows).text())
        } else {
            ("settled", table(&rows, &total).text())
        };
        write!(out, "{table}")?;
        writeln!(out, "\n{}", explanation(options, heading))?;
    }
    Ok(())
}

/// Looks at a model from all sides.
fn look_at(options: &PicturesBenchOptions, path: &Path, rows: &mut Vec<Row>, show: &dyn Fn(f64)) -> Result<()> {
    let PictureSize { width, height } = options.picture.size;
    let model = Arc::new(Model::open(&LocalDisk, path)?);
    let mesh = FullMesh::of(&model)?;
    let blank = || Picture::new(width, height);
    let mut studio = Studio { options, mesh: &mesh, full: blank(), front: blank() };
    let navigator_options = NavigatorOptions {
        memory: options.memory.0,
        pixels: options.picture.pixels,
        width,
        height,
        ..NavigatorOptions::default()
    };
    let all = viewpoints(&model, options.cameras, options.picture.size)?;
    let header = model.header();
    for (number, viewpoint) in all.iter().enumerate() {
        let projection = Projection::new(&viewpoint.camera, header.origin, header.diagonal(), width, height)?;
        studio.draw_full(&projection);
        if options.cold {
            start_cold(&mut studio, path, &navigator_options, viewpoint, &projection, rows)?;
        } else {
            let settling = NavigatorOptions { io: Io::Sync, ..navigator_options.clone() };
            let mut navigator = Navigator::open(model.clone(), settling)?;
            let statistics = navigator.run_until_settled(&viewpoint.camera, MOST_FRAMES)?;
            rows.push(studio.row(&navigator, viewpoint, &projection, statistics, None));
        }
        show((number + 1) as f64 / all.len() as f64);
    }
    Ok(())
}

/// Starts with nothing read, from a disk that is slow, and looks at some of the first frames.
fn start_cold(
    studio: &mut Studio<'_>,
    path: &Path,
    navigator_options: &NavigatorOptions,
    viewpoint: &Viewpoint,
    projection: &Projection,
    rows: &mut Vec<Row>,
) -> Result<()> {
    let disk = FaultyDisk::new(Arc::new(LocalDisk));
    let model = Arc::new(Model::open(&disk, path)?);
    disk.delay_share_of_reads(1.0, Duration::from_millis(studio.options.delay), 0);
    let mut navigator = Navigator::open(model, navigator_options.clone())?;
    let pace = Duration::from_secs_f64(1.0 / STEPS_PER_SECOND);
    let mut next = Instant::now();
    for frame in 1..=COLD_FRAMES[COLD_FRAMES.len() - 1] {
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
        next += pace;
        let statistics = navigator.frame(&viewpoint.camera)?;
        if COLD_FRAMES.contains(&frame) {
            let looked_from = Instant::now();
            // What is read meanwhile comes to the front with the next frame: the clock of the flight goes on.
            rows.push(studio.row(&navigator, viewpoint, projection, statistics, Some(frame)));
            next += looked_from.elapsed();
        }
    }
    Ok(())
}

/// A share as a cell: two decimals, rounded down, so that only what is whole is 100.
fn percent(share: f64) -> String {
    format!("{:.2}", (share * 100.0).floor() / 100.0)
}

fn distance(distance: f64) -> String {
    if distance.is_finite() { format!("{distance:.2}") } else { "far".into() }
}

fn table(rows: &[Row], total: &Total) -> Table {
    let mut table = Table::new(&[
        "model",
        "seen from",
        "triangles",
        "pixels",
        "near %",
        "worst",
        "back %",
        "worst",
        "outline %",
        "back %",
        "holes",
        "through",
        "cracks",
        "chinks",
        "pinholes",
        "open",
    ]);
    let mut line = |names: [String; 4], likeness: &Likeness, open_sides: u64, percents: [f64; 4]| {
        let [near, back, outline, outline_back] = percents.map(percent);
        let worst = likeness.near.map(|share| distance(share.worst));
        let [worst, back_worst] = worst;
        let counts =
            [likeness.holes, likeness.seen_through, likeness.cracks, likeness.chinks, likeness.pinholes, open_sides]
                .map(grouped);
        let shares = [near, worst, back, back_worst, outline, outline_back];
        table.line(names.into_iter().chain(shares).chain(counts).collect());
    };
    for row in rows {
        let names = [
            row.model.clone(),
            row.viewpoint.clone(),
            grouped(row.statistics.triangles),
            format!("{:.2}", row.statistics.pixels_drawn),
        ];
        line(names, &row.likeness, row.open_sides, shares(&row.likeness).map(Share::percent));
    }
    let name = |name: &str| [name.into(), String::new(), String::new(), String::new()];
    line(name("all"), &total.likeness, total.open_sides, shares(&total.likeness).map(Share::percent));
    line(name("worst"), &total.likeness, total.open_sides, total.least);
    table
}

fn cold_table(rows: &[Row]) -> Table {
    let mut table = Table::new(&[
        "model",
        "seen from",
        "frame",
        "triangles",
        "pixels",
        "misses",
        "holes",
        "through",
        "cracks",
        "chinks",
        "pinholes",
        "open",
    ]);
    for row in rows {
        let likeness = &row.likeness;
        let found = [likeness.holes, likeness.seen_through, likeness.cracks, likeness.chinks];
        let found = found.map(|count| if likeness.looked_at > 0 { grouped(count) } else { UNKNOWN.into() });
        let before = [
            row.model.clone(),
            row.viewpoint.clone(),
            row.cold_frame.map_or_else(String::new, |frame| frame.to_string()),
            grouped(row.statistics.triangles),
            format!("{:.2}", row.statistics.pixels_drawn),
            grouped(row.statistics.misses),
        ];
        let always = [likeness.pinholes, row.open_sides].map(grouped);
        table.line(before.into_iter().chain(found).chain(always).collect());
    }
    table
}

fn explanation(options: &PicturesBenchOptions, heading: &str) -> String {
    let PictureSize { width, height } = options.picture.size;
    let columns = if options.cold {
        format!(
            "misses: nodes that wait for a page; each read takes {} ms more. Holes are farther from the outline of the full mesh\n\
             than {HOLE_REACH} points and the error drawn (pixels); where that is not within the picture, nothing is said.",
            options.delay
        )
    } else {
        format!(
            "near: points of the surface within {NEAR} footprints of the full mesh, and back, from that to what is drawn; worst: the\n\
             farthest, in footprints. outline: points of the outline within {OUTLINE_REACH} points of that of the full mesh, and back.\n\
             The goal is {GOAL_PERCENT} % for each, and no hole. Holes are farther than {HOLE_REACH} points from the outline of the full mesh."
        )
    };
    format!(
        "Pictures of {width}x{height} points at {} pixel(s), {heading}, with {} of RAM for the front.\n{columns}\n\
         through: points in which something behind is seen; cracks: those of both that are thin; chinks: those that\n\
         are none of them, since the full mesh has one there, thinner than a point; pinholes: what the drawing leaves open between\n\
         triangles. open: sides of triangles that are open and should not be, or the reverse, seen or not. {}.",
        options.picture.pixels,
        options.memory,
        Machine::this().text(),
    )
}

fn share_json(share: &Share) -> Value {
    // JSON has no infinity.
    let worst = share.worst.is_finite().then_some(share.worst);
    json!({ "points": share.all, "good": share.good, "percent": share.percent(), "worst": worst })
}

fn likeness_json(likeness: &Likeness, open_sides: u64) -> Value {
    let Likeness { near, outline, holes, seen_through, cracks, chinks, pinholes, looked_at, gaps_at } = likeness;
    json!({
        "front_to_full": share_json(&near[0]),
        "full_to_front": share_json(&near[1]),
        "outline_to_full": share_json(&outline[0]),
        "outline_to_front": share_json(&outline[1]),
        "holes": holes,
        "seen_through": seen_through,
        "cracks": cracks,
        "chinks": chinks,
        "pinholes": pinholes,
        "hole_points_looked_at": looked_at,
        "gaps_at": gaps_at,
        "open_sides": open_sides,
    })
}

fn to_json(options: &PicturesBenchOptions, rows: &[Row], total: &Total) -> Value {
    let PictureSize { width, height } = options.picture.size;
    let row_json = |row: &Row| {
        json!({
            "model": row.model,
            "seen_from": row.viewpoint,
            "camera": row.camera.to_string(),
            "cold_frame": row.cold_frame,
            "triangles": row.statistics.triangles,
            "full_triangles": row.full_triangles,
            "pixels_drawn": row.statistics.pixels_drawn,
            "threshold_factor": row.statistics.threshold_factor,
            "settled": row.settled,
            "misses": row.statistics.misses,
            "vanished_parts": row.statistics.vanished_parts,
            "likeness": likeness_json(&row.likeness, row.open_sides),
        })
    };
    let [near, back, outline, outline_back] = total.least;
    let goals_met = !total.has_gaps() && (options.cold || total.least.iter().all(|percent| *percent >= GOAL_PERCENT));
    json!({
        "machine": Machine::this().to_json(),
        "width": width,
        "height": height,
        "pixels": options.picture.pixels,
        "memory_bytes": options.memory.0,
        "cold": options.cold,
        "delay_ms": options.cold.then_some(options.delay),
        "near_footprints": NEAR,
        "outline_points": OUTLINE_REACH,
        "goal_percent": GOAL_PERCENT,
        "goals_met": goals_met,
        "rows": rows.iter().map(row_json).collect::<Vec<_>>(),
        "total": likeness_json(&total.likeness, total.open_sides),
        "worst_percent": {
            "front_to_full": near,
            "full_to_front": back,
            "outline_to_full": outline,
            "outline_to_front": outline_back,
        },
    })
}
