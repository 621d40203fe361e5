//! Test meshes of any size, written as PLY while they are made.
//!
//! | shape | what it tests |
//! |---|---|
//! | terrain | a sheet with a boundary, sampled more densely in some places than in others |
//! | sphere | a closed surface |
//! | gyroid | a closed surface with very many handles |
//! | city | many separate parts, boundaries, edges of three and four triangles |
//!
//! A shape is a formula, not a mesh in memory: its vertices, and after them its triangles, are computed one after the
//! other and written at once. How much memory that takes, and how near a shape comes to the number of triangles
//! asked for, is said where it is made (`terrain`, `sphere`, `gyroid`, `city`): terrain and city have exactly so many,
//! sphere and gyroid one less if the number is odd.
//!
//! The same seed and number give the same bytes on every machine (`noise` says how).

mod city;
mod gyroid;
mod noise;
mod sheet;
mod sphere;
mod terrain;

use std::fmt;
use std::ops::RangeInclusive;
use std::path::Path;
use std::str::FromStr;
use std::sync::Arc;

use storage::Disk;
use thiserror::Error;

use crate::mesh::MeshError;
use crate::mesh::writer::{CoordinateType, MeshLayout, MeshWriter, OutputFormat};

/// How many triangles can be asked for.
pub const TRIANGLES: RangeInclusive<u64> = 10..=1_000_000_000;

/// Progress is reported after so many vertices or triangles.
const REPORT_EVERY: u64 = 1 << 16;
/// The share of the time that the search for the right gyroid takes.
const SEARCH_SHARE: f64 = 0.4;

/// What can be made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// Mountains: one sheet with a boundary.
    Terrain,
    /// A planet: one closed surface.
    Sphere,
    /// A sponge: a closed surface with very many handles.
    Gyroid,
    /// Very many separate parts, open, closed and non-manifold.
    City,
}

impl Shape {
    /// All there are.
    pub const ALL: [Shape; 4] = [Shape::Terrain, Shape::Sphere, Shape::Gyroid, Shape::City];
}

impl fmt::Display for Shape {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        // `pad` minds a width, for tables.
        out.pad(match self {
            Shape::Terrain => "terrain",
            Shape::Sphere => "sphere",
            Shape::Gyroid => "gyroid",
            Shape::City => "city",
        })
    }
}

impl FromStr for Shape {
    type Err = GenerateError;

    fn from_str(name: &str) -> Result<Self, GenerateError> {
        let found = Shape::ALL.into_iter().find(|shape| shape.to_string() == name);
        found.ok_or_else(|| GenerateError::UnknownShape { name: name.to_string() })
    }
}

/// What to make.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GenerateOptions {
    /// The shape.
    pub shape: Shape,
    /// How many triangles, within [`TRIANGLES`].
    pub triangles: u64,
    /// Another seed gives another mesh of the same kind.
    pub seed: u64,
}

/// What was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GenerateSummary {
    /// Vertices in the file.
    pub vertices: u64,
    /// Triangles in the file.
    pub triangles: u64,
    /// Length of the file.
    pub bytes: u64,
}

/// Why a test mesh was not made.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum GenerateError {
    /// There is no shape of that name.
    #[error("there is no shape {name:?}; there are terrain, sphere, gyroid and city")]
    UnknownShape {
        /// The name.
        name: String,
    },
    /// The number of triangles is out of range.
    #[error(
        "a mesh of {triangles} triangles cannot be made: it takes at least {} and at most {} of them",
        TRIANGLES.start(),
        TRIANGLES.end()
    )]
    TriangleCount {
        /// The number asked for.
        triangles: u64,
    },
    /// The file could not be written.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

/// Takes vertices, one by one.
type VertexSink<'a> = dyn FnMut([f64; 3]) -> Result<(), MeshError> + 'a;
/// Takes triangles, one by one.
type TriangleSink<'a> = dyn FnMut([u64; 3]) -> Result<(), MeshError> + 'a;

/// A mesh that is computed anew each time one looks at it.
trait Model {
    fn vertex_count(&self) -> u64;
    fn triangle_count(&self) -> u64;
    /// Every vertex once, in order.
    fn emit_vertices(&self, emit: &mut VertexSink<'_>) -> Result<(), MeshError>;
    /// Every triangle once, by the numbers of its corners.
    fn emit_triangles(&self, emit: &mut TriangleSink<'_>) -> Result<(), MeshError>;
}

fn model(options: &GenerateOptions, progress: &mut dyn FnMut(f64)) -> Box<dyn Model> {
    match options.shape {
        Shape::Terrain => Box::new(terrain::Terrain::new(options.triangles, options.seed)),
        Shape::Sphere => Box::new(sphere::Sphere::new(options.triangles, options.seed)),
        Shape::Gyroid => gyroid::model(options.triangles, options.seed, progress),
        Shape::City => Box::new(city::City::new(options.triangles, options.seed)),
    }
}

/// Makes a test mesh and writes it to the file `path`, which appears whole or not at all: an OBJ file where its name ends in
/// .obj, binary glTF where it ends in .glb, else a PLY file.
///
/// `progress` is told the share of the work that is done, from 0 to 1.
///
/// # Errors
///
/// [`GenerateError::TriangleCount`] for a number outside [`TRIANGLES`], and the disk's.
pub fn generate(
    disk: Arc<dyn Disk>,
    path: &Path,
    options: &GenerateOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<GenerateSummary, GenerateError> {
    let GenerateOptions { shape, triangles, seed } = *options;
    if !TRIANGLES.contains(&triangles) {
        return Err(GenerateError::TriangleCount { triangles });
    }
    progress(0.0);
    let model = model(options, &mut |share| progress(share * SEARCH_SHARE));
    let (vertices, triangles_made) = (model.vertex_count(), model.triangle_count());
    let layout = MeshLayout {
        vertices,
        triangles: triangles_made,
        coordinates: CoordinateType::Float,
        origin: [0.0; 3],
        comments: vec![format!("made by: vdt generate {shape} --triangles {triangles} --seed {seed}")],
        attributes: None,
    };
    let format = OutputFormat::of(path).unwrap_or(OutputFormat::Ply);
    let mut writer = MeshWriter::create(disk, path, format, layout)?;

    let start = if shape == Shape::Gyroid { SEARCH_SHARE } else { 0.0 };
    let mut done = 0;
    let mut report = || {
        done += 1;
        if done % REPORT_EVERY == 0 {
            progress(start + (1.0 - start) * (done as f64 / (vertices + triangles_made) as f64));
        }
    };
    model.emit_vertices(&mut |position| {
        report();
        writer.vertex(position, None)
    })?;
    model.emit_triangles(&mut |corners| {
        report();
        writer.triangle(corners, MeshWriter::NO_MATERIAL)
    })?;
    let bytes = writer.finish()?.bytes;
    progress(1.0);
    Ok(GenerateSummary { vertices, triangles: triangles_made, bytes })
}

#[cfg(test)]
mod tests;
