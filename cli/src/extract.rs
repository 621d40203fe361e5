//! `vdt extract`: a level of detail of a model, as a mesh file.

use std::sync::Arc;

use anyhow::{Result, bail};
use metanode::model::Model;
use metanode::{Statement, UniformCut, error_for_triangles};
use navigator::{Camera, Dependency, Io, Navigator, NavigatorOptions};
use serde_json::json;
use storage::{ByteSize, LocalDisk};
use vdt::mesh::MeshError;
use vdt::mesh::ply_writer::{CoordinateType, PlyLayout, PlyWriter};

use crate::arguments::{CameraArgument, ExtractOptions, PictureSize};
use crate::output::{Report, counted, may_write};
use crate::progress::Progress;
use crate::statement;

/// Vertical field of view of `--camera`, in degrees.
const FIELD_OF_VIEW: f64 = 60.0;
/// RAM for a view, where nothing else is said.
const DEFAULT_MEMORY: ByteSize = ByteSize(256 << 20);
/// After so many frames a view that does not settle is taken as it is.
const MOST_FRAMES: u64 = 10_000;

/// What was written.
struct Extracted {
    vertices: u64,
    triangles: u64,
    bytes: u64,
    said: Statement,
    /// Something that the user should know.
    note: Option<String>,
}

pub fn run(options: ExtractOptions, json: bool) -> Result<()> {
    options.check();
    may_write(&LocalDisk, &options.output, options.force, &[&options.model])?;
    if options.output.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("ply")) {
        bail!("{}: meshes are written as PLY; give a name that ends in .ply", options.output.display());
    }
    let model = Arc::new(Model::open(&LocalDisk, &options.model)?);
    let progress = Progress::new("extracting");
    let extracted = match (options.cut.error, options.cut.triangles, options.cut.camera) {
        (Some(error), _, _) => uniform(&model, &options, not_above(error.in_units(model.header().diagonal())))?,
        (_, Some(triangles), _) => uniform(&model, &options, error_for_triangles(&model, triangles)?)?,
        (_, _, Some(camera)) => seen(model.clone(), &options, camera)?,
        // clap asks for exactly one of the three.
        _ => bail!("say which level of detail: --error, --triangles or --camera"),
    };
    drop(progress);

    let mut report = Report::default();
    report.line("mesh", options.output.display());
    report.line("triangles", counted(extracted.triangles, "triangle", "triangles"));
    report.line("vertices", counted(extracted.vertices, "vertex", "vertices"));
    statement::tell(&mut report, &extracted.said, model.header());
    report.line("size", ByteSize(extracted.bytes));
    if let Some(note) = &extracted.note {
        report.line("note", note);
    }
    let mut document = json!({
        "triangles": extracted.triangles,
        "vertices": extracted.vertices,
        "bytes": extracted.bytes,
        "note": extracted.note,
        "peak_rss_bytes": storage::usage::peak_resident_bytes(),
    });
    statement::add_to(&mut document, &extracted.said, model.header());
    report.print(json, &document)
}

/// The largest f32 that is not above `error`.
fn not_above(error: f64) -> f32 {
    let nearest = error as f32;
    if f64::from(nearest) > error { nearest.next_down() } else { nearest }
}

/// Single precision where every coordinate survives it, double precision where the origin asks for more.
fn coordinate_type(is_single: bool) -> CoordinateType {
    if is_single { CoordinateType::Float } else { CoordinateType::Double }
}

fn with_origin(position: [f32; 3], origin: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| f64::from(position[axis]) + origin[axis])
}

fn is_single(position: [f64; 3]) -> bool {
    position.iter().all(|value| f64::from(*value as f32) == *value)
}

fn layout(vertices: u64, triangles: u64, single: bool, comment: String) -> PlyLayout {
    PlyLayout { vertices, triangles, coordinates: coordinate_type(single), comments: vec![comment] }
}

fn uniform(model: &Model, options: &ExtractOptions, error: f32) -> Result<Extracted> {
    let cut = UniformCut::new(model, error)?;
    let origin = model.header().origin;
    let mut single = true;
    if origin != [0.0; 3] {
        cut.for_each_vertex(|position| -> Result<()> {
            single &= is_single(with_origin(position, origin));
            Ok(())
        })?;
    }
    let comment = format!("vdt extract: uniform cut, error {error}");
    let layout = layout(cut.vertex_count(), cut.triangle_count(), single, comment);
    let mut writer = PlyWriter::create(Arc::new(LocalDisk), &options.output, layout)?;
    cut.for_each_vertex(|position| -> Result<()> { Ok(writer.vertex(with_origin(position, origin))?) })?;
    cut.for_each_triangle(|corners| -> Result<()> { Ok(writer.triangle(corners)?) })?;
    let said = cut.statement()?;
    Ok(Extracted {
        vertices: cut.vertex_count(),
        triangles: cut.triangle_count(),
        bytes: writer.finish()?,
        said,
        note: None,
    })
}

fn seen(model: Arc<Model>, options: &ExtractOptions, camera: CameraArgument) -> Result<Extracted> {
    let origin = model.header().origin;
    let (pixels, size) = (options.pixels.unwrap_or(1.0), options.size.unwrap_or(PictureSize::FULL_HD));
    let camera = Camera::looking_at(camera.eye.into(), camera.target.into(), FIELD_OF_VIEW);
    let navigator_options = NavigatorOptions {
        memory: options.memory.unwrap_or(DEFAULT_MEMORY).0,
        pixels,
        width: size.width,
        height: size.height,
        dependency: Dependency::Implicit,
        io: Io::Sync,
        ..NavigatorOptions::default()
    };
    let mut navigator = Navigator::open(model, navigator_options)?;
    let frame = navigator.run_until_settled(&camera, MOST_FRAMES)?;

    // Vertices in the order in which the triangles name them; those that none names are left out.
    let mut number = vec![u64::MAX; navigator.node_bound() as usize];
    let mut vertices: Vec<[f64; 3]> = Vec::with_capacity(navigator.active_count());
    for triangle in navigator.triangles() {
        for (node, position) in triangle.nodes.into_iter().zip(triangle.positions) {
            if number[node as usize] == u64::MAX {
                number[node as usize] = vertices.len() as u64;
                vertices.push(with_origin(position, origin));
            }
        }
    }
    let single = vertices.iter().all(|position| is_single(*position));
    let triangles = navigator.triangle_count() as u64;
    let comment = format!("vdt extract: {pixels} pixels from camera {camera}");
    let layout = layout(vertices.len() as u64, triangles, single, comment);
    let mut writer = PlyWriter::create(Arc::new(LocalDisk), &options.output, layout)?;
    vertices.iter().try_for_each(|position| writer.vertex(*position))?;
    navigator.triangles().try_for_each(|triangle| -> Result<(), MeshError> {
        writer.triangle(triangle.nodes.map(|node| number[node as usize]))
    })?;
    let note = (frame.threshold_factor > 1.0)
        .then(|| format!("the memory did not allow {pixels} pixels, but {:.1}", pixels * frame.threshold_factor));
    Ok(Extracted {
        vertices: vertices.len() as u64,
        triangles,
        bytes: writer.finish()?,
        said: navigator.statement(),
        note,
    })
}
