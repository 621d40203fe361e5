//! From the files' vertices and triangles to the canonical mesh that everything later works on.
//!
//! What comes out depends on the set of triangles over positions only: not on the file's format, nor on the order of
//! its vertices and triangles (invariant 2 of the design), nor on memory, threads or blocks. In this order:
//!
//! 1. *Frame*: local origin, single precision, a power of two as the unit (module `frame`); or, instead of single precision
//!    alone, a lattice (module `lattice`), to which positions are rounded before everything else.
//! 2. *Welding.* Bitwise equal positions are one vertex, nothing else is.
//! 3. *Canonical ids.* Vertices by Morton code in the box of the mesh, then by position; triangles by their corners'
//!    ids, rotated so that the smallest comes first.
//! 4. *Cleaning*, each kind counted: triangles with two equal corners, triangles that are there twice with the same
//!    orientation, vertices that no triangle uses.
//! 5. *Wedges*, where there are attributes: those of the corners of the triangles that are left, at each vertex in their order. Of
//!    triangles that are there twice the one stays whose corners' wedges come first.
//!
//! A corner has its own normal, else its vertex's; the same for texture coordinates. It has the colour of its face, else of
//! its vertex. Normals of faces are left out: those that are computed are as good.
//!
//! What that may cost is the *input error*: no point of a triangle in the files is farther from the canonical mesh. It is
//! the sum of how far single precision or the lattice moves a vertex, and how far the triangles without area that are left out reach
//! beyond the others (module `segments`). A file in single precision without such triangles has none.
//!
//! [`canonical`] does that in RAM, in the obvious way; [`store`] does it for files of any size within a memory limit,
//! and cuts the mesh into spatial blocks. Both give the same mesh.
//!
//! | module | what it does |
//! |---|---|
//! | `files` | the files, once, into sequences on disk |
//! | `vertices`, `marks` | the vertices in file order; a bit for each of many numbers |
//! | `frame`, `lattice`, `morton` | origin, unit, what positions are rounded to, Morton codes |
//! | `file_attributes` | the attributes of the files, as they were read |
//! | `entering` | what is welded: vertices, or corners with their attributes |
//! | `weld`, `twins` | vertices sorted and welded: canonical ids |
//! | `wedges` | the wedges of vertices and corners |
//! | `corners` | triangles from file numbers to canonical ids |
//! | `triangles` | triangles sorted, duplicates dropped |
//! | `segments` | triangles without area, and how far they reach beyond the mesh |
//! | `blocks`, `seams` | spatial blocks and the vertices between them |
//! | `gaps` | vertices that only degenerate triangles used |
//! | `limits` | who gets how much RAM |
//! | `kept` | the stored mesh in a checkpoint |
//! | `appearance` | materials, images and the lattice of texture coordinates of all files |
//! | `canonical`, `load` | the same in RAM |
//! | `write` | the stored mesh as a mesh file |

mod appearance;
#[cfg(test)]
mod attribute_tests;
mod blocks;
mod canonical;
mod corners;
mod entering;
mod file_attributes;
mod files;
mod frame;
mod gaps;
mod kept;
mod lattice;
mod limits;
mod load;
mod marks;
mod morton;
mod progress;
mod seams;
mod segments;
mod stored;
#[cfg(test)]
mod tests;
mod triangles;
mod twins;
mod vertices;
#[cfg(test)]
mod wedge_tests;
mod wedges;
mod weld;
mod write;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use storage::{ByteSize, Spool};

pub use canonical::{FrameError, RawAttributes, canonical, canonical_as, canonical_with};
pub(crate) use frame::power_of_two;
pub use kept::KeptMesh;
pub use lattice::PositionsRule;
pub use limits::smallest_memory;
pub use load::{count, load, reading_needs};
pub use stored::store;
pub use write::{Output, write_mesh};

use crate::tree::{Appearance, CornerPlaces, MeshAttributes, MeshSeams, Positions, Wedge};

/// What was changed on the way in. None of it changes the surface, or by no more than the input error; all of it is told
/// to the user.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CleaningCounts {
    /// Vertices that had the position of another one, and became one with it.
    pub welded_vertices: u64,
    /// Vertices that became one with another because both were rounded to the same point of a lattice.
    pub fallen_vertices: u64,
    /// Vertices that no triangle uses: left out.
    pub isolated_vertices: u64,
    /// Triangles with two corners at the same position: left out, they have no area. Those that touch no other triangle are
    /// taken for lines, which are no part of a surface.
    pub degenerate_triangles: u64,
    /// Triangles that were there before with the same corners and orientation: left out.
    pub duplicate_triangles: u64,
    /// Faces of fewer than three corners: left out.
    pub degenerate_faces: u64,
    /// Polygons of more than three corners: cut into triangles.
    pub polygons: u64,
    /// Wedges beyond the most that a vertex may have ([`crate::tree::MOST_WEDGES`]): the corners got the last one.
    pub merged_wedges: u64,
    /// Points, lines and curves: left out, they are no part of a surface.
    pub skipped_elements: u64,
}

/// A mesh in RAM, in canonical form.
#[derive(Debug, Clone, Default)]
pub struct CoreMesh {
    /// Positions by canonical id, in mesh units, relative to `origin`.
    pub positions: Vec<[f32; 3]>,
    /// Triangles in canonical order: three vertex ids in the file's orientation, the smallest first.
    pub triangles: Vec<[u32; 3]>,
    /// What to add to a position to get the file's coordinates back.
    pub origin: [f64; 3],
    /// The mesh is at most 2^exponent wide along every axis; dividing by that normalises it.
    pub exponent: i32,
    /// How the positions are kept.
    pub kept_as: Positions,
    /// The step of the lattice that all positions are on, in mesh units; 0 where there is none.
    pub lattice_step: f32,
    /// What was changed on the way in.
    pub cleaning: CleaningCounts,
    /// No point of a triangle in the files is farther than this from the mesh, in mesh units.
    pub input_error: f32,
    /// What the corners carry, where they carry anything and it was asked for.
    pub attributes: Option<CoreAttributes>,
}

/// The wedges of a [`CoreMesh`], as [`MeshAttributes`] has them.
#[derive(Debug, Clone, PartialEq)]
pub struct CoreAttributes {
    /// What they refer to.
    pub appearance: Appearance,
    /// The wedges of each vertex, at least one, ascending.
    pub wedges: Vec<Vec<Wedge>>,
    /// The wedges of the corners of each triangle.
    pub corners: Vec<CornerPlaces>,
}

/// A mesh of any size in canonical form, in spatial blocks.
///
/// A block is a range of canonical vertex ids, that is of Morton codes. A triangle is in the block of its first, that is
/// its smallest corner; so the triangles of a block are a range of the canonical triangles.
#[derive(Debug)]
pub struct StoredMesh {
    /// Positions by canonical id, in mesh units, relative to `origin`. Each is a corner of a triangle.
    pub positions: Spool<[f32; 3]>,
    /// Triangles in canonical order: three vertex ids in the file's orientation, the smallest first.
    pub triangles: Spool<[u32; 3]>,
    /// The blocks, by ascending first vertex; they tile the vertices and the triangles.
    pub blocks: Vec<MeshBlock>,
    /// The vertices that have a triangle in a block other than their own, ascending, each once.
    pub seam_vertices: Spool<u32>,
    /// Smallest and largest coordinates of all positions.
    pub bounds: [[f32; 3]; 2],
    /// What to add to a position to get the file's coordinates back.
    pub origin: [f64; 3],
    /// The mesh is at most 2^exponent wide along every axis; dividing by that normalises it.
    pub exponent: i32,
    /// How the positions are kept.
    pub kept_as: Positions,
    /// The step of the lattice that all positions are on, in mesh units; 0 where there is none.
    pub lattice_step: f32,
    /// What was changed on the way in.
    pub cleaning: CleaningCounts,
    /// No point of a triangle in the files is farther than this from the mesh, in mesh units; see the module.
    pub input_error: f32,
    /// What the files held.
    pub files: FileCounts,
    /// What the corners carry, where they carry anything and it was asked for.
    pub attributes: Option<MeshAttributes>,
    /// What the files name and is not there, without which the mesh is still one: libraries of materials, images. In order, each
    /// once.
    pub missing_files: Vec<PathBuf>,
}

impl StoredMesh {
    /// A mesh in RAM as a stored one of one block.
    pub fn from_core(mesh: CoreMesh, files: FileCounts) -> Self {
        let mut bounds = [mesh.positions.first().copied().unwrap_or_default(); 2];
        for position in &mesh.positions {
            for axis in 0..3 {
                bounds[0][axis] = bounds[0][axis].min(position[axis]);
                bounds[1][axis] = bounds[1][axis].max(position[axis]);
            }
        }
        StoredMesh {
            positions: Spool::from_vec(mesh.positions),
            triangles: Spool::from_vec(mesh.triangles),
            blocks: vec![MeshBlock { first_vertex: 0, first_triangle: 0 }],
            seam_vertices: Spool::from_vec(Vec::new()),
            bounds,
            origin: mesh.origin,
            exponent: mesh.exponent,
            kept_as: mesh.kept_as,
            lattice_step: mesh.lattice_step,
            cleaning: mesh.cleaning,
            input_error: mesh.input_error,
            files,
            attributes: mesh.attributes.map(CoreAttributes::into_stored),
            missing_files: Vec::new(),
        }
    }
}

impl CoreAttributes {
    fn into_stored(self) -> MeshAttributes {
        let mut first_wedges = Vec::with_capacity(self.wedges.len());
        let mut wedges = Vec::with_capacity(self.wedges.len());
        for of_vertex in &self.wedges {
            first_wedges.push(wedges.len() as u32);
            wedges.extend_from_slice(of_vertex);
        }
        let has_seams = wedges.len() > self.wedges.len();
        MeshAttributes {
            appearance: self.appearance,
            wedges: Spool::from_vec(wedges),
            seams: has_seams.then(|| MeshSeams {
                first_wedges: Spool::from_vec(first_wedges),
                corners: Spool::from_vec(self.corners),
            }),
        }
    }
}

/// A block of a [`StoredMesh`]: it ends where the next one begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeshBlock {
    /// Its first vertex.
    pub first_vertex: u32,
    /// Its first triangle.
    pub first_triangle: u32,
}

/// What one or several mesh files held.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileCounts {
    /// Vertices in the files.
    pub vertices: u64,
    /// Triangles in the files, after polygons were cut.
    pub triangles: u64,
}

/// What [`store`] may use, and what blocks it makes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct IngestPlan {
    /// Limit on all RAM that grows with the data. At least [`smallest_memory`].
    pub memory: ByteSize,
    /// Threads that may be used.
    pub threads: usize,
    /// How many triangles a block should have. Most have between a half of it and all of it; none has more than twice
    /// as many, but where a single vertex is the smallest corner of more.
    pub block_triangles: u64,
    /// How positions are to be kept.
    pub positions: PositionsRule,
    /// Whether attributes are kept.
    pub attributes: bool,
}
