//! Mesh files, read and written as streams: the whole mesh is never in RAM here.
//!
//! A format reader knows its file format and nothing else: it pushes what it finds, in file order, into a
//! [`MeshSink`]. [`read_mesh`] puts one common gate in front of the caller's [`TriangleSink`], so that every format
//! is judged alike: coordinates must be finite, face corners must name vertices that exist, polygons are cut into
//! fans, faces with fewer than three corners are counted.
//!
//! Normals, colours, texture coordinates and materials (module `attributes`) are looked for only where the sink asks: who
//! does not pays nothing for them.
//!
//! Memory: one read buffer, plus what a format needs to find its way (a PLY header, a glTF document), and the names of
//! materials.

mod attributes;
mod gate;
pub mod gltf;
mod input;
mod mtl;
pub mod obj;
pub mod off;
pub mod ply;
mod polygon;
mod srgb;
pub mod stl;
#[cfg(test)]
mod testing;
mod text;
pub mod writer;

use std::fmt;
use std::path::{Path, PathBuf};

use storage::{Disk, StorageError};
use thiserror::Error;

pub use attributes::{
    Attributes, CornerValue, Image, ImageSource, Material, NO_VALUE, TriangleAttributes, VertexAttributes, Wedges,
};
pub use gate::read_mesh;

/// A vertex as a format reader finds it.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct Vertex {
    /// Position in the file's own coordinates and units. Not yet checked to be finite.
    pub position: [f64; 3],
    /// Normal as the file has it, of any length. Not yet checked to be finite.
    pub normal: Option<[f32; 3]>,
    /// Red, green, blue and alpha, in sRGB; alpha is 255 where the file has none.
    pub colour: Option<[u8; 4]>,
    /// Texture coordinate as the file has it. Not yet checked to be finite.
    pub texture: Option<[f32; 2]>,
}

impl Vertex {
    /// A vertex with a position and nothing else.
    #[inline]
    pub fn at(position: [f64; 3]) -> Self {
        Vertex { position, normal: None, colour: None, texture: None }
    }
}

/// A face as a format reader finds it: a polygon of any number of corners.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct Face<'a> {
    /// Vertex numbers, counted from 0 in the order in which the vertices were pushed. Not yet checked.
    pub corners: &'a [i64],
    /// Texture coordinates of the corners.
    pub textures: Wedges<'a, [f32; 2]>,
    /// Normals of the corners.
    pub normals: Wedges<'a, [f32; 3]>,
    /// Red, green, blue and alpha, in sRGB; alpha is 255 where the file has none.
    pub colour: Option<[u8; 4]>,
    /// Number of its material, counted from 0 in the order in which they were pushed. It was pushed before.
    pub material: Option<u32>,
}

impl<'a> Face<'a> {
    /// A face with corners and nothing else.
    #[inline]
    pub fn new(corners: &'a [i64]) -> Self {
        Face { corners, textures: Wedges::None, normals: Wedges::None, colour: None, material: None }
    }
}

/// Where a format reader pushes what it finds.
///
/// Faces may come before the vertices, texture coordinates and normals that they name. Element numbers for messages are
/// counted by the sink.
pub trait MeshSink {
    /// Whether readers are to look for attributes. If not, they push vertices and faces without any, and nothing else.
    fn wants_attributes(&self) -> bool;

    /// What the file's header promises, where it has one: vertices and faces. Called at most once, before the rest.
    fn announce(&mut self, vertices: u64, faces: u64) -> Result<(), MeshError>;

    /// The next vertex of the file.
    fn vertex(&mut self, vertex: Vertex) -> Result<(), MeshError>;

    /// The next face of the file.
    fn face(&mut self, face: Face<'_>) -> Result<(), MeshError>;

    /// The next of the texture coordinates that corners name by number. Not yet checked to be finite.
    fn texture_coordinate(&mut self, value: [f32; 2]) -> Result<(), MeshError>;

    /// The next of the normals that corners name by number. Not yet checked to be finite.
    fn normal(&mut self, value: [f32; 3]) -> Result<(), MeshError>;

    /// The next material.
    fn material(&mut self, material: Material) -> Result<(), MeshError>;

    /// The file names another one that is not there, without which the mesh is still one: a library of materials, an image.
    fn missing_file(&mut self, path: PathBuf) -> Result<(), MeshError>;

    /// The file holds geometry that is no part of a surface (points, lines, curves): this many elements were left out.
    fn left_out(&mut self, elements: u64);
}

/// Where [`read_mesh`] puts what passed its checks.
///
/// Attributes come only where they are asked for. In them all formats mean the same: colours are sRGB, and texture
/// coordinates have v upwards, as OBJ has it (those of glTF are turned).
pub trait TriangleSink {
    /// Whether attributes, and [`ReadSummary::attributes`], are of interest. Finding them may take longer, and what is wrong with
    /// them is an error then.
    fn wants_attributes(&self) -> bool {
        false
    }

    /// What the file's header promises, where it has one: at most this many vertices and at least this many faces.
    /// A sink that already knows that it cannot hold them may refuse here.
    fn announce(&mut self, vertices: u64, faces: u64) -> Result<(), MeshError> {
        let _ = (vertices, faces);
        Ok(())
    }

    /// The next vertex: finite coordinates in the file's own units.
    fn vertex(&mut self, position: [f64; 3]) -> Result<(), MeshError>;

    /// The next triangle: three vertex numbers, each of a vertex that came before or will still come, in the file's
    /// orientation. Two or three of them may be equal.
    fn triangle(&mut self, corners: [u64; 3]) -> Result<(), MeshError>;

    /// What the last vertex has besides its position; not called where it has nothing.
    fn vertex_attributes(&mut self, attributes: VertexAttributes) -> Result<(), MeshError> {
        let _ = attributes;
        Ok(())
    }

    /// What the last triangle and its corners have, in the order of the corners; not called where they have nothing.
    fn triangle_attributes(&mut self, attributes: TriangleAttributes) -> Result<(), MeshError> {
        let _ = attributes;
        Ok(())
    }

    /// The next of the texture coordinates that corners name by number: finite.
    fn texture_coordinate(&mut self, value: [f32; 2]) -> Result<(), MeshError> {
        let _ = value;
        Ok(())
    }

    /// The next of the normals that corners name by number: finite, of any length.
    fn normal(&mut self, value: [f32; 3]) -> Result<(), MeshError> {
        let _ = value;
        Ok(())
    }
}

/// The mesh formats that can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeshFormat {
    /// Stanford PLY: ASCII, binary little endian, binary big endian.
    Ply,
    /// Wavefront OBJ.
    Obj,
    /// STL, ASCII or binary: a soup of triangles.
    Stl,
    /// Object File Format.
    Off,
    /// glTF 2.0, as `.gltf` with its buffers beside or inside it, or as binary `.glb`.
    Gltf,
}

impl fmt::Display for MeshFormat {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            MeshFormat::Ply => "PLY",
            MeshFormat::Obj => "OBJ",
            MeshFormat::Stl => "STL",
            MeshFormat::Off => "OFF",
            MeshFormat::Gltf => "glTF",
        })
    }
}

/// What a file held, counted while it was read.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadSummary {
    /// The format that the file turned out to be in.
    pub format: MeshFormat,
    /// Vertices in the file (STL: three for each facet).
    pub vertices: u64,
    /// Faces in the file, of any number of corners.
    pub faces: u64,
    /// Triangles handed on, after polygons were cut.
    pub triangles: u64,
    /// Faces of more than three corners, cut into fans from their first corner.
    pub polygons: u64,
    /// Faces of fewer than three corners: they have no area and were left out.
    pub degenerate_faces: u64,
    /// Elements that are no part of a surface (points, lines, curves): left out.
    pub left_out: u64,
    /// Attributes; empty if the sink did not want them.
    pub attributes: Attributes,
}

/// What is wrong with a mesh file, or with reading it. Each message names the file, the element and its index.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MeshError {
    /// The disk failed.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The file is in none of the formats known here.
    #[error(
        "{}: not a mesh in a known format; known are PLY, OBJ, STL, OFF and glTF (.gltf, .glb)",
        path.display()
    )]
    UnknownFormat {
        /// The file in question.
        path: PathBuf,
    },
    /// The file holds nothing at all.
    #[error("{}: the file is empty", path.display())]
    Empty {
        /// The file in question.
        path: PathBuf,
    },
    /// The file breaks the rules of its format.
    #[error("{}: {place}: {problem}", path.display())]
    Malformed {
        /// The file in question.
        path: PathBuf,
        /// Where: "line 12", "vertex 40000", "header", "face 7, corner 2", with "byte 1234" where that helps.
        place: String,
        /// What is wrong there, and where it helps what was expected.
        problem: String,
    },
    /// A coordinate is NaN or infinite.
    #[error("{}: vertex {index}: coordinate {axis} is {value}, not a finite number", path.display())]
    NotFinite {
        /// The file in question.
        path: PathBuf,
        /// The vertex, counted from 0.
        index: u64,
        /// `x`, `y` or `z`.
        axis: char,
        /// The value found.
        value: f64,
    },
    /// A face names a vertex that does not exist.
    #[error(
        "{}: face {face}: corner {corner} names vertex {index}, but the file has {vertices} vertices (numbered from 0)",
        path.display()
    )]
    CornerOutOfRange {
        /// The file in question.
        path: PathBuf,
        /// The face, counted from 0.
        face: u64,
        /// The corner, counted from 0.
        corner: usize,
        /// The vertex number found.
        index: i64,
        /// How many vertices there are.
        vertices: u64,
    },
    /// A number of an attribute is NaN or infinite.
    #[error("{}: {element}: {value} is not a finite number", path.display())]
    AttributeNotFinite {
        /// The file in question.
        path: PathBuf,
        /// Which it is: "normal of vertex 7", "texture coordinate of face 3, corner 1", "normal 12".
        element: String,
        /// The value found.
        value: f32,
    },
    /// A face names a texture coordinate, a normal or a material that does not exist.
    #[error(
        "{}: face {face}{}: it names {kind} {index}, but the file has {count} (numbered from 0)",
        path.display(),
        corner.map(|corner| format!(", corner {corner}")).unwrap_or_default()
    )]
    AttributeOutOfRange {
        /// The file in question.
        path: PathBuf,
        /// The face, counted from 0.
        face: u64,
        /// The corner, counted from 0; none for a material.
        corner: Option<usize>,
        /// What it names: "texture coordinate", "normal" or "material".
        kind: &'static str,
        /// The number found.
        index: i64,
        /// How many there are.
        count: u64,
    },
    /// The file needs a feature of its format that is not supported.
    #[error("{}: {feature} is not supported; {advice}", path.display())]
    Unsupported {
        /// The file in question.
        path: PathBuf,
        /// What the file uses.
        feature: String,
        /// What can be done about it.
        advice: String,
    },
    /// The file, with those before it, holds more elements than there are numbers for.
    #[error("{}: more than {most} {kind} cannot be numbered in 32 bits; cut the mesh into parts", path.display())]
    TooMany {
        /// The file in question.
        path: PathBuf,
        /// What there is too much of: "vertices", "triangles", "texture coordinates".
        kind: &'static str,
        /// How many there may be.
        most: u64,
    },
    /// There is no lattice of so many bits over the mesh: its steps would be too small for single precision, or the mesh is
    /// too large or too far from zero for it.
    #[error(
        "{}: positions cannot be kept with {bits} bits along the longest axis, which is {extent:e} long: the steps \
         would be too small for single precision, or the mesh lies too far from zero; run again with --positions lossless",
        path.display()
    )]
    Lattice {
        /// The file in question, or the first of several.
        path: PathBuf,
        /// The bits asked for.
        bits: u8,
        /// How long the longest axis is, in mesh units.
        extent: f64,
    },
    /// The mesh does not fit in the memory that the caller allows.
    #[error(
        "{}: {vertices} vertices and {triangles} triangles need {needed} of RAM, and {limit} are allowed; \
         run again with --memory {advice}",
        path.display()
    )]
    OverMemory {
        /// The file in question.
        path: PathBuf,
        /// Vertices in the file.
        vertices: u64,
        /// Triangles in the file.
        triangles: u64,
        /// What the build would need.
        needed: storage::ByteSize,
        /// What it is allowed.
        limit: storage::ByteSize,
        /// The smallest limit that works, as it is written on the command line.
        advice: String,
    },
    /// A mesh writer was handed something else than its header promises, or something that its format cannot hold.
    #[error("{}: cannot write {element}: {problem}", path.display())]
    Unwritable {
        /// The file in question.
        path: PathBuf,
        /// What could not be written: "vertex 12", "triangle 0", "the header", "the end of the file".
        element: String,
        /// Why not.
        problem: String,
    },
}

impl MeshError {
    /// A [`MeshError::Malformed`] at `place` of `path`.
    pub fn malformed(path: &Path, place: impl Into<String>, problem: impl Into<String>) -> Self {
        MeshError::Malformed { path: path.to_path_buf(), place: place.into(), problem: problem.into() }
    }
}

/// A format reader: pushes the whole of `path` into `sink`.
type Reader = fn(&dyn Disk, &Path, &mut dyn MeshSink) -> Result<(), MeshError>;

fn reader_of(format: MeshFormat) -> Reader {
    match format {
        MeshFormat::Ply => ply::read,
        MeshFormat::Obj => obj::read,
        MeshFormat::Stl => stl::read,
        MeshFormat::Off => off::read,
        MeshFormat::Gltf => gltf::read,
    }
}
