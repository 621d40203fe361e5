//! `vdt bench uploads`: what a renderer has to upload with each frame, against what is different in the mesh.
//!
//! A renderer keeps copies of the streams of vertices, 16 bytes each, and triangles, 12 bytes each, and brings them up to date with
//! the ranges that have changed ([`Navigator::changed_vertices`], [`Navigator::changed_triangles`]), as far as these are within
//! the streams. Ranges with few unchanged elements between them are uploaded as one: more bytes, and fewer calls.
//!
//! What is different is the set difference of the triangles of consecutive frames, both ways: those that are new, and those that
//! are gone. A triangle is the same where its corners, from whichever on, stand on the same leaves, and so at the same positions. This
//! is found anew from all triangles, not from the changes that are told.
//!
//! Pages that are missing are read at once. Memory: 12 bytes for each triangle of two frames.

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use metanode::model::Model;
use navigator::walk::Step;
use navigator::{Camera, Io, Navigator, NavigatorOptions, RandomWalk};
use serde_json::{Value, json};
use storage::LocalDisk;

use super::machine::Machine;
use super::{check_files, mesh_name};
use crate::arguments::UploadsBenchOptions;
use crate::extract::MOST_FRAMES;
use crate::output::grouped;
use crate::progress::Progress;
use crate::table::{Table, UNKNOWN};

/// Bytes for each vertex and each triangle.
const BYTES: [u64; 2] = [size_of::<[f32; 4]>() as u64, size_of::<[u32; 3]>() as u64];
/// The most bytes that are to be uploaded for each triangle that is new or gone.
const GOAL: f64 = 200.0;

/// What is uploaded with one frame, with one gap.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Upload {
    /// Of vertices, and of triangles.
    bytes: [u64; 2],
    ranges: u64,
}

impl Upload {
    fn of(navigator: &Navigator, gap: u32) -> Self {
        let mut upload = Upload::default();
        let lengths = [navigator.vertex_stream().len(), navigator.triangle_stream().len()];
        let mut add = |stream: usize, range: std::ops::Range<u32>| {
            let end = (range.end as usize).min(lengths[stream]);
            let elements = end.saturating_sub(range.start as usize) as u64;
            upload.bytes[stream] += BYTES[stream] * elements;
            upload.ranges += u64::from(elements > 0);
        };
        navigator.changed_vertices(gap).for_each(|range| add(0, range));
        navigator.changed_triangles(gap).for_each(|range| add(1, range));
        upload
    }

    fn all_bytes(&self) -> u64 {
        self.bytes.iter().sum()
    }
}

/// What is different after a frame, and what it takes to upload that.
struct Frame {
    new: u64,
    gone: u64,
    /// For each gap.
    uploads: Vec<Upload>,
}

impl Frame {
    fn different(&self) -> u64 {
        self.new + self.gone
    }
}

/// The flight over one model.
struct Flight {
    model: String,
    triangles: u64,
    jumps: u64,
    frames: Vec<Frame>,
}

/// What the frames of a flight come to, with one gap.
struct Row {
    gap: u32,
    bytes: [u64; 2],
    ranges: u64,
    /// Bytes for each triangle that is different: all for all; and of the frames with any, the mean, the median, that which 99 % of
    /// them have at most, and the most.
    per_triangle: Option<[f64; 5]>,
    /// The same, all for all, for each that is new.
    per_new: Option<f64>,
    /// Bytes with frames that have none.
    idle_bytes: u64,
    most_bytes: u64,
}

impl Row {
    fn of(flight: &Flight, place: usize, gap: u32) -> Self {
        let uploads = || flight.frames.iter().map(|frame| (frame, &frame.uploads[place]));
        let bytes = [0, 1].map(|stream| uploads().map(|(_, upload)| upload.bytes[stream]).sum());
        let all: u64 = uploads().map(|(_, upload)| upload.all_bytes()).sum();
        let [different, new] = [Frame::different, |frame: &Frame| frame.new]
            .map(|count: fn(&Frame) -> u64| flight.frames.iter().map(count).sum::<u64>());
        let busy = uploads().filter(|(frame, _)| frame.different() > 0);
        let mut ratios: Vec<f64> =
            busy.map(|(frame, upload)| upload.all_bytes() as f64 / frame.different() as f64).collect();
        ratios.sort_by(f64::total_cmp);
        let per_triangle = ratios.last().map(|most| {
            let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
            [all as f64 / different as f64, mean, at_rank(&ratios, 0.5), at_rank(&ratios, 0.99), *most]
        });
        let idle = uploads().filter(|(frame, _)| frame.different() == 0);
        Row {
            gap,
            bytes,
            ranges: uploads().map(|(_, upload)| upload.ranges).sum(),
            per_triangle,
            per_new: (new > 0).then(|| all as f64 / new as f64),
            idle_bytes: idle.map(|(_, upload)| upload.all_bytes()).sum(),
            most_bytes: uploads().map(|(_, upload)| upload.all_bytes()).max().unwrap_or(0),
        }
    }
}

/// The number that this share of sorted ones does not exceed.
fn at_rank(sorted: &[f64], share: f64) -> f64 {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or_default()
}

/// The triangles that are drawn, sorted: each as its leaves, the smallest first.
fn triangles_of(navigator: &Navigator) -> Vec<[u32; 3]> {
    let mut found: Vec<[u32; 3]> = navigator.triangles().map(|triangle| smallest_first(triangle.leaves)).collect();
    found.sort_unstable();
    found
}

fn smallest_first(leaves: [u32; 3]) -> [u32; 3] {
    let mut turned = leaves;
    let first = (0..3).min_by_key(|place| leaves[*place]).unwrap_or(0);
    turned.rotate_left(first);
    turned
}

/// How many of the second sorted list are not in the first, and of the first not in the second. What is there twice counts twice.
fn difference<T: Ord>(before: &[T], after: &[T]) -> [u64; 2] {
    let (mut left, mut right) = (before.iter().peekable(), after.iter().peekable());
    let (mut new, mut gone) = (0, 0);
    while let (Some(old), Some(young)) = (left.peek(), right.peek()) {
        match old.cmp(young) {
            std::cmp::Ordering::Less => (gone, _) = (gone + 1, left.next()),
            std::cmp::Ordering::Greater => (new, _) = (new + 1, right.next()),
            std::cmp::Ordering::Equal => (_, _) = (left.next(), right.next()),
        }
    }
    [new + right.count() as u64, gone + left.count() as u64]
}

pub fn run(options: &UploadsBenchOptions, json: bool) -> Result<()> {
    check_files(&options.models.iter().map(|model| model.as_path()).collect::<Vec<_>>(), None, false)?;
    let progress = Progress::new("walking");
    let mut flights = Vec::new();
    for (number, path) in options.models.iter().enumerate() {
        let show = |part: f64| progress.show((number as f64 + part) / options.models.len() as f64);
        flights.push(fly(options, path, &show)?);
    }
    drop(progress);
    let mut out = io::stdout().lock();
    if json {
        writeln!(out, "{:#}", to_json(options, &flights))?;
    } else {
        write!(out, "{}", table(options, &flights).text())?;
        writeln!(
            out,
            "\nnew, gone: triangles in a frame that are not in the one before, and the reverse; KiB and ranges uploaded, means of a\n\
             frame. Bytes for each triangle that is new or gone: all for all, the median of frames, what 99 % of them have at\n\
             most, and the most; and all bytes for each that is new. The goal is {GOAL}, all for all. {} at {} pixel(s), with {} of\n\
             RAM. {}.",
            path_name(options),
            options.picture.pixels,
            options.memory,
            Machine::this().text(),
        )?;
    }
    Ok(())
}

fn path_name(options: &UploadsBenchOptions) -> String {
    let UploadsBenchOptions { walk, seed, .. } = options;
    options.path.as_ref().map_or_else(|| format!("walk:{walk} of seed {seed}"), |path| format!("Path {path}"))
}

fn fly(options: &UploadsBenchOptions, path: &Path, show: &dyn Fn(f64)) -> Result<Flight> {
    let model = Arc::new(Model::open(&LocalDisk, path)?);
    let navigator_options = NavigatorOptions {
        memory: options.memory.0,
        pixels: options.picture.pixels,
        width: options.picture.size.width,
        height: options.picture.size.height,
        io: Io::Sync,
        ..NavigatorOptions::default()
    };
    let mut navigator = Navigator::open(model.clone(), navigator_options)?;
    let mut recorder = Recorder {
        gaps: &options.gap,
        before: Vec::new(),
        flight: Flight { model: mesh_name(path), triangles: 0, jumps: 0, frames: Vec::new() },
    };
    if let Some(path) = &options.path {
        let cameras = path.cameras(&LocalDisk, &model)?;
        if let Some(first) = cameras.first() {
            recorder.settle(&mut navigator, first)?;
        }
        for (number, camera) in cameras.iter().enumerate().skip(1) {
            recorder.frame(&mut navigator, camera)?;
            show(number as f64 / cameras.len() as f64);
        }
    } else {
        let mut walk = RandomWalk::new(&model, options.seed)?;
        recorder.settle(&mut navigator, &walk.camera())?;
        while recorder.flight.frames.len() < options.walk as usize {
            match walk.step() {
                Step::Flight => recorder.frame(&mut navigator, &walk.camera())?,
                // Nobody waits there.
                Step::Stop => (),
                Step::Jump => {
                    recorder.flight.jumps += 1;
                    recorder.settle(&mut navigator, &walk.camera())?;
                }
            }
            show(recorder.flight.frames.len() as f64 / f64::from(options.walk));
        }
    }
    Ok(recorder.flight)
}

/// Looks at what changes.
struct Recorder<'a> {
    gaps: &'a [u32],
    before: Vec<[u32; 3]>,
    flight: Flight,
}

impl Recorder<'_> {
    /// Comes to a view without counting what it takes.
    fn settle(&mut self, navigator: &mut Navigator, camera: &Camera) -> Result<()> {
        navigator.run_until_settled(camera, MOST_FRAMES)?;
        navigator.forget_changes();
        self.before = triangles_of(navigator);
        Ok(())
    }

    fn frame(&mut self, navigator: &mut Navigator, camera: &Camera) -> Result<()> {
        self.flight.triangles += navigator.frame(camera)?.triangles;
        let uploads = self.gaps.iter().map(|gap| Upload::of(navigator, *gap)).collect();
        navigator.forget_changes();
        let after = triangles_of(navigator);
        let [new, gone] = difference(&self.before, &after);
        self.flight.frames.push(Frame { new, gone, uploads });
        self.before = after;
        Ok(())
    }
}

/// The rows of a flight, one for each gap.
fn rows<'a>(options: &'a UploadsBenchOptions, flight: &'a Flight) -> impl Iterator<Item = Row> + 'a {
    options.gap.iter().enumerate().map(|(place, gap)| Row::of(flight, place, *gap))
}

fn table(options: &UploadsBenchOptions, flights: &[Flight]) -> Table {
    let mut table = Table::new(&[
        "model",
        "triangles",
        "new",
        "gone",
        "gap",
        "KiB",
        "ranges",
        "B/tri",
        "median",
        "99 %",
        "most",
        "B/new",
    ]);
    for flight in flights {
        let frames = flight.frames.len().max(1) as u64;
        let mean = |sum: u64| grouped(sum / frames);
        for row in rows(options, flight) {
            let cell = |figure: Option<f64>| figure.map_or(UNKNOWN.into(), |figure| format!("{figure:.0}"));
            let [all, _, median, high, most] = [0, 1, 2, 3, 4].map(|place| cell(row.per_triangle.map(|of| of[place])));
            table.line(vec![
                flight.model.clone(),
                mean(flight.triangles),
                mean(flight.frames.iter().map(|frame| frame.new).sum()),
                mean(flight.frames.iter().map(|frame| frame.gone).sum()),
                row.gap.to_string(),
                format!("{:.1}", row.bytes.iter().sum::<u64>() as f64 / frames as f64 / 1024.0),
                mean(row.ranges),
                all,
                median,
                high,
                most,
                cell(row.per_new),
            ]);
        }
    }
    table
}

fn to_json(options: &UploadsBenchOptions, flights: &[Flight]) -> Value {
    let row_json = |flight: &Flight, row: &Row| {
        let figure = |place: usize| row.per_triangle.map(|of| of[place]);
        let sum = |count: fn(&Frame) -> u64| flight.frames.iter().map(count).sum::<u64>();
        json!({
            "model": flight.model,
            "gap": row.gap,
            "frames": flight.frames.len(),
            "jumps": flight.jumps,
            "triangles_mean": flight.triangles as f64 / flight.frames.len().max(1) as f64,
            "triangles_new": sum(|frame| frame.new),
            "triangles_gone": sum(|frame| frame.gone),
            "vertex_bytes": row.bytes[0],
            "triangle_bytes": row.bytes[1],
            "ranges": row.ranges,
            "frame_bytes_max": row.most_bytes,
            "idle_bytes": row.idle_bytes,
            "bytes_per_triangle": figure(0),
            "bytes_per_triangle_mean": figure(1),
            "bytes_per_triangle_p50": figure(2),
            "bytes_per_triangle_p99": figure(3),
            "bytes_per_triangle_max": figure(4),
            "bytes_per_new_triangle": row.per_new,
        })
    };
    let all = flights.iter().flat_map(|flight| rows(options, flight).map(move |row| row_json(flight, &row)));
    json!({
        "machine": Machine::this().to_json(),
        "path": path_name(options),
        "pixels": options.picture.pixels,
        "memory_bytes": options.memory.0,
        "goal_bytes_per_triangle": GOAL,
        "rows": all.collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_difference_of_lists() {
        assert_eq!(difference(&[1, 2, 2, 4], &[2, 3, 4, 5]), [2, 2]);
        assert_eq!(difference(&[], &[7, 8]), [2, 0]);
        assert_eq!(difference(&[7, 8], &[]), [0, 2]);
        assert_eq!([[1, 2, 3], [3, 1, 2], [2, 3, 1]].map(smallest_first), [[1, 2, 3]; 3]);
        assert_eq!(smallest_first([3, 2, 1]), [1, 3, 2]);
    }

    #[test]
    fn what_frames_come_to() {
        let frame = |new: u64, gone: u64, vertices: u64, triangles: u64| Frame {
            new,
            gone,
            uploads: vec![Upload { bytes: [16 * vertices, 12 * triangles], ranges: 2 }],
        };
        // 100 bytes for 4, 28 for 2, and 12 for nothing.
        let frames = vec![frame(3, 1, 1, 7), frame(1, 1, 1, 1), frame(0, 0, 0, 1)];
        let row = Row::of(&Flight { model: String::new(), triangles: 0, jumps: 0, frames }, 0, 0);
        assert_eq!((row.bytes, row.ranges, row.idle_bytes, row.most_bytes), ([32, 108], 6, 12, 100));
        assert_eq!(row.per_triangle, Some([140.0 / 6.0, 19.5, 14.0, 25.0, 25.0]));
        assert_eq!(row.per_new, Some(35.0));
    }
}
