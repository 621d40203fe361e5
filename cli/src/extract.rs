//! `vdt extract`: a level of detail of a model, as a mesh file.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use metanode::header::Header;
use metanode::model::Model;
use metanode::{CutWedges, DrawnMesh, Statement, UniformCut, error_for_triangles};
use navigator::{Dependency, Io, Navigator, NavigatorOptions};
use serde_json::{Value, json};
use storage::{ByteSize, LocalDisk, StorageError};
use vdt::mesh::MeshError;
use vdt::mesh::writer::{CoordinateType, LayoutAttributes, MeshLayout, MeshWriter, OutputFormat, WrittenMesh};
use vdt::tree::Image;

use crate::arguments::{CameraArgument, ErrorArgument, ExtractOptions, PictureSize};
use crate::output::{Report, counted, may_write};
use crate::progress::Progress;
use crate::statement;

/// RAM for a view, where nothing else is said.
const DEFAULT_MEMORY: ByteSize = ByteSize(256 << 20);
/// After so many frames a view that does not settle is taken as it is.
pub const MOST_FRAMES: u64 = 10_000;

/// What was written.
pub struct Extracted {
    vertices: u64,
    triangles: u64,
    files: WrittenMesh,
    said: Statement,
    /// Something that the user should know.
    note: Option<String>,
}

/// The file in which a level of detail is written.
#[derive(Debug, Clone, Copy)]
pub struct Target<'a> {
    pub path: &'a Path,
    pub format: OutputFormat,
    /// Whether files beside it that have other content may be replaced.
    pub may_replace: bool,
    /// The command that writes it.
    pub command: &'static str,
}

pub fn run(options: ExtractOptions, json: bool) -> Result<()> {
    options.check();
    may_write(&LocalDisk, &options.output, options.force, &[&options.model])?;
    let target = Target {
        path: &options.output,
        format: format_of(&options.output)?,
        may_replace: options.force,
        command: "extract",
    };
    let model = Arc::new(Model::open(&LocalDisk, &options.model)?);
    let progress = Progress::new("extracting");
    let extracted = match (level(&model, options.cut.error, options.cut.triangles)?, options.cut.camera) {
        (Some(error), _) => uniform(&model, target, error)?,
        (None, Some(camera)) => seen(model.clone(), &options, target, camera)?,
        // clap asks for exactly one of the three.
        (None, None) => bail!("say which level of detail: --error, --triangles or --camera"),
    };
    drop(progress);
    let (report, document) = extracted.told(&options.output, model.header());
    report.print(json, &document)
}

/// The format that the extension of an output asks for.
pub fn format_of(path: &Path) -> Result<OutputFormat> {
    OutputFormat::of(path).with_context(|| format!("{}: {}", path.display(), OutputFormat::EXTENSIONS))
}

/// The error of the uniform cut that is asked for, if one is.
pub fn level(model: &Model, error: Option<ErrorArgument>, triangles: Option<u64>) -> Result<Option<f32>> {
    Ok(match (error, triangles) {
        (Some(error), _) => Some(not_above(error.in_units(model.header().diagonal()))),
        (None, Some(triangles)) => Some(error_for_triangles(model, triangles)?),
        (None, None) => None,
    })
}

impl Extracted {
    /// What there is to tell of it, for people and for programs.
    pub fn told(&self, output: &Path, header: &Header) -> (Report, Value) {
        let mut report = Report::default();
        report.line("mesh", output.display());
        report.line("triangles", counted(self.triangles, "triangle", "triangles"));
        report.line("vertices", counted(self.vertices, "vertex", "vertices"));
        statement::tell(&mut report, &self.said, header);
        tell_files(&mut report, &self.files);
        if let Some(note) = &self.note {
            report.line("note", note);
        }
        let mut document = json!({
            "triangles": self.triangles,
            "vertices": self.vertices,
            "bytes": self.files.bytes,
            "beside": self.files.beside,
            "left_out": self.files.left_out,
            "note": self.note,
            "peak_rss_bytes": storage::usage::peak_resident_bytes(),
        });
        statement::add_to(&mut document, &self.said, header);
        (report, document)
    }
}

/// Tells which files were written.
pub fn tell_files(report: &mut Report, files: &WrittenMesh) {
    report.line("size", ByteSize(files.bytes));
    for (number, path) in files.beside.iter().enumerate() {
        report.line(if number == 0 { "beside it" } else { "" }, path.display());
    }
    for phrase in &files.left_out {
        report.line("left out", phrase);
    }
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

/// What is written of a model.
fn layout(vertices: u64, triangles: u64, single: bool, origin: [f64; 3], comment: String) -> MeshLayout {
    let coordinates = coordinate_type(single);
    MeshLayout { vertices, triangles, coordinates, origin, comments: vec![comment], attributes: None }
}

/// Writes the cut with the same error everywhere.
pub fn uniform(model: &Model, target: Target<'_>, error: f32) -> Result<Extracted> {
    let Target { path, format, may_replace, command } = target;
    let cut = UniformCut::new(model, error)?;
    let origin = model.header().origin;
    let mut single = true;
    if origin != [0.0; 3] {
        cut.for_each_vertex(|position| -> Result<()> {
            single &= is_single(with_origin(position, origin));
            Ok(())
        })?;
    }
    let comment = format!("vdt {command}: uniform cut, error {error}");
    let layout = layout(cut.vertex_count(), cut.triangle_count(), single, origin, comment);
    let disk = Arc::new(LocalDisk);
    let (files, vertices) = match (model.appearance(), CutWedges::of(&cut)?) {
        (Some(found), Some(wedges)) => {
            let attributes =
                LayoutAttributes { appearance: found.appearance.clone(), has_alpha: wedges.has_alpha(), may_replace };
            let vertices = wedges.vertex_count();
            let layout = MeshLayout { vertices, attributes: Some(attributes), ..layout };
            let mut images = |number: usize, _: &Image| image_bytes(model, number);
            let mut writer = MeshWriter::create_with_images(disk, path, format, layout, &mut images)?;
            wedges.for_each_vertex(|position, wedge| -> Result<()> {
                Ok(writer.vertex(with_origin(position, origin), Some(wedge))?)
            })?;
            wedges.for_each_triangle(|corners, material| -> Result<()> { Ok(writer.triangle(corners, material)?) })?;
            (writer.finish()?, vertices)
        }
        _ => {
            let mut writer = MeshWriter::create(disk, path, format, layout)?;
            cut.for_each_vertex(|position| -> Result<()> { Ok(writer.vertex(with_origin(position, origin), None)?) })?;
            cut.for_each_triangle(|corners| -> Result<()> { Ok(writer.triangle(corners, MeshWriter::NO_MATERIAL)?) })?;
            (writer.finish()?, cut.vertex_count())
        }
    };
    let said = cut.statement()?;
    Ok(Extracted { vertices, triangles: cut.triangle_count(), files, said, note: None })
}

/// The bytes of an image of a model, if it is there.
fn image_bytes(model: &Model, number: usize) -> Result<Option<Vec<u8>>, MeshError> {
    let mut bytes = Vec::new();
    let is_there = model.image(number, |chunk| -> Result<(), StorageError> {
        bytes.extend_from_slice(chunk);
        Ok(())
    })?;
    Ok(is_there.then_some(bytes))
}

fn seen(model: Arc<Model>, options: &ExtractOptions, target: Target<'_>, camera: CameraArgument) -> Result<Extracted> {
    let origin = model.header().origin;
    let (pixels, size) = (options.pixels.unwrap_or(1.0), options.size.unwrap_or(PictureSize::FULL_HD));
    let camera = camera.camera();
    let navigator_options = NavigatorOptions {
        memory: options.memory.unwrap_or(DEFAULT_MEMORY).0,
        pixels,
        width: size.width,
        height: size.height,
        dependency: Dependency::Implicit,
        io: Io::Sync,
        prefetch: false,
        ..NavigatorOptions::default()
    };
    let mut navigator = Navigator::open(model.clone(), navigator_options)?;
    let frame = navigator.run_until_settled(&camera, MOST_FRAMES)?;

    let comment = format!("vdt {}: {pixels} pixels from camera {camera}", target.command);
    let (splits, pages) = navigator.applied_splits().map(|split| (split.born_leaf, split.page)).unzip();
    let said = navigator.statement();
    // Its memory is now that of the mesh.
    drop(navigator);
    let mesh = DrawnMesh::of(&model, splits, pages)?;
    let single = mesh.vertices.iter().all(|(position, _)| is_single(with_origin(*position, origin)));
    let (vertices, triangles) = (mesh.vertices.len() as u64, mesh.triangles.len() as u64);
    let attributes = model.appearance().map(|found| LayoutAttributes {
        appearance: found.appearance.clone(),
        has_alpha: mesh.vertices.iter().any(|(_, wedge)| wedge.colour[3] < u8::MAX),
        may_replace: target.may_replace,
    });
    let layout = MeshLayout { attributes, ..layout(vertices, triangles, single, origin, comment) };
    let mut images = |number: usize, _: &Image| image_bytes(&model, number);
    let mut writer =
        MeshWriter::create_with_images(Arc::new(LocalDisk), target.path, target.format, layout, &mut images)?;
    mesh.vertices
        .iter()
        .try_for_each(|(position, wedge)| writer.vertex(with_origin(*position, origin), Some(wedge)))?;
    let numbers = |corners: [u32; 3]| corners.map(u64::from);
    mesh.triangles.iter().try_for_each(|(corners, material)| writer.triangle(numbers(*corners), *material))?;
    let note = (frame.threshold_factor > 1.0)
        .then(|| format!("the memory did not allow {pixels} pixels, but {:.1}", pixels * frame.threshold_factor));
    Ok(Extracted { vertices, triangles, files: writer.finish()?, said, note })
}
