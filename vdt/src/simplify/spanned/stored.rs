//! The mesh on disk, with random access: every vertex and every triangle by its canonical id, and from a vertex to the
//! triangles at it.
//!
//! The triangles at a vertex are chained through the triangles themselves, so that all records have one size and a
//! collapse moves none of them. A triangle that is gone may stay in the chain of a corner whose whole star was not in
//! memory when it went; it is passed over, and taken out when that star is written the next time.
//!
//! Memory: what was allowed, for pages and, where there are attributes, for wedges. I/O: 100 bytes for each vertex, 40 for
//! each triangle, 4 more where there are seams of a texture, and 56 for each piece that it may keep, in pages of 4 KiB;
//! canonical ids follow the Morton order, so neighbours mostly lie in the same or in a few pages.

use bytemuck::{Pod, Zeroable};
use storage::{RecordFile, Scratch, StorageError, Traffic};

use crate::simplify::bound::{MOST_PIECES, Piece};
use crate::simplify::live_mesh::{LiveMesh, Node};
use crate::simplify::live_wedges::WedgeReader;
use crate::simplify::metric::Quadric;
use crate::tree::{CornerPlaces, MeshAttributes};

/// A vertex. 100 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct StoredVertex {
    /// The node that it stands for.
    pub node: Node,
    /// Its quadric, about its own position.
    pub quadric: Quadric,
    /// Whether it lies on an edge that is not regular, as `Vertex::lasting_state` has it.
    pub state: u32,
    /// Where its chain of triangles begins. No vertex that is left is without triangles: one without is gone.
    pub star: Link,
    /// How many of its edges are rejected.
    pub rejected: u32,
}

impl StoredVertex {
    /// Whether it was collapsed onto another one.
    pub fn is_gone(&self) -> bool {
        self.star == Link::END
    }
}

/// A triangle. 40 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct StoredTriangle {
    /// Canonical ids of its corners, in its orientation.
    pub corners: [u32; 3],
    /// Dependency id of the collapse that rewrote it last; 0 where none did.
    pub order: u32,
    /// The next triangle in the chain of each corner.
    pub next: [Link; 3],
    /// [`GONE`], and for each side, from corner 0 to 1, 1 to 2, 2 to 0, a bit that says that this edge is rejected; from
    /// [`PIECES_SHIFT`] on, how many pieces it keeps.
    pub flags: u32,
    /// How far, at most, what it answers for itself lies from it, see `bound`.
    pub residual: f32,
    /// How far, at most, a point of it lies from the input, where that is noted.
    pub reverse: f32,
}

/// Where [`StoredTriangle::flags`] has the number of pieces that the triangle keeps.
pub(super) const PIECES_SHIFT: u32 = 4;

/// Bit of [`StoredTriangle::flags`]: the triangle disappeared.
pub(super) const GONE: u32 = 1 << 3;

impl StoredTriangle {
    pub fn is_gone(&self) -> bool {
        self.flags & GONE != 0
    }

    /// The next triangle in the chain of a vertex; the end where the vertex is no corner.
    pub fn next_at(&self, vertex: u32) -> Link {
        match self.corners.iter().position(|corner| *corner == vertex) {
            Some(corner) => self.next[corner],
            None => Link::END,
        }
    }

    /// Changes the next triangle in the chain of a corner. Whether it was another one.
    pub fn set_next_at(&mut self, vertex: u32, next: Link) -> bool {
        let Some(corner) = self.corners.iter().position(|corner| *corner == vertex) else { return false };
        std::mem::replace(&mut self.next[corner], next) != next
    }
}

/// A triangle in a chain, or the end of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(transparent)]
pub(super) struct Link(u32);

impl Link {
    pub const END: Link = Link(0);

    pub fn to(triangle: u32) -> Self {
        Link(triangle + 1)
    }

    pub fn triangle(self) -> Option<u32> {
        self.0.checked_sub(1)
    }
}

/// The pieces that a triangle keeps, in their order.
#[derive(Debug, Clone, Copy)]
pub(super) struct CutPieces {
    pieces: [Piece; MOST_PIECES],
    count: usize,
}

impl Default for CutPieces {
    fn default() -> Self {
        CutPieces { pieces: [Piece::zeroed(); MOST_PIECES], count: 0 }
    }
}

impl CutPieces {
    pub fn push(&mut self, piece: &Piece) {
        if let Some(place) = self.pieces.get_mut(self.count) {
            *place = *piece;
            self.count += 1;
        }
    }

    pub fn in_order(&self) -> &[Piece] {
        &self.pieces[..self.count]
    }
}

/// The stores of vertices and triangles.
#[derive(Debug)]
pub(super) struct MeshStore<'a> {
    vertices: RecordFile<StoredVertex>,
    triangles: RecordFile<StoredTriangle>,
    /// Pieces that triangles keep: so many places for each, where there may be any.
    cut_pieces: Option<(usize, RecordFile<Piece>)>,
    /// The places of the corners among the wedges of their vertices, where there are vertices with several.
    corners: Option<RecordFile<CornerPlaces>>,
    /// The wedges of the mesh as it came, where it has attributes.
    wedges: Option<WedgeReader<'a>>,
    /// How many vertices there were in the beginning.
    pub vertex_count: u32,
    /// How many triangles there were in the beginning.
    pub triangle_count: u32,
    /// Vertices that are left.
    pub live_vertices: u64,
    /// Triangles that are left.
    pub live_triangles: u64,
}

/// The most stretches of wedges that are kept in memory.
const MOST_WEDGE_STRETCHES: usize = 32;

impl<'a> MeshStore<'a> {
    /// An empty store for a mesh with these attributes whose triangles keep at most so many pieces, with so many bytes of
    /// pages in RAM.
    pub fn new(
        scratch: &Scratch,
        [vertex_count, triangle_count]: [u32; 2],
        most_kept: usize,
        attributes: Option<&'a MeshAttributes>,
        ram_bytes: usize,
    ) -> Result<Self, StorageError> {
        let seams = attributes.and_then(|attributes| attributes.seams.as_ref());
        let for_wedges = if attributes.is_some() { ram_bytes / 8 } else { 0 };
        let stretches = (for_wedges / WedgeReader::STRETCH_BYTES).clamp(1, MOST_WEDGE_STRETCHES);
        let part = (ram_bytes - for_wedges) / (5 + if most_kept > 0 { 2 } else { 0 } + usize::from(seams.is_some()));
        let most_kept = most_kept.min(MOST_PIECES);
        let cut_pieces = match most_kept {
            0 => None,
            _ => Some((most_kept, RecordFile::new(scratch, "cut-pieces", part * 2)?)),
        };
        Ok(MeshStore {
            vertices: RecordFile::new(scratch, "vertex-records", part * 3)?,
            triangles: RecordFile::new(scratch, "triangle-records", part * 2)?,
            cut_pieces,
            corners: seams.map(|_| RecordFile::new(scratch, "corner-records", part)).transpose()?,
            wedges: attributes.map(|attributes| WedgeReader::new(attributes, stretches)),
            vertex_count,
            triangle_count,
            live_vertices: vertex_count.into(),
            live_triangles: triangle_count.into(),
        })
    }

    pub fn vertex(&mut self, id: u32) -> Result<StoredVertex, StorageError> {
        self.vertices.get(id.into())
    }

    pub fn put_vertex(&mut self, id: u32, vertex: &StoredVertex) -> Result<(), StorageError> {
        self.vertices.put(id.into(), vertex)
    }

    pub fn triangle(&mut self, id: u32) -> Result<StoredTriangle, StorageError> {
        self.triangles.get(id.into())
    }

    pub fn put_triangle(&mut self, id: u32, triangle: &StoredTriangle) -> Result<(), StorageError> {
        self.triangles.put(id.into(), triangle)
    }

    /// Reads the pieces that a triangle keeps.
    pub fn cut_pieces(&mut self, id: u32, triangle: &StoredTriangle) -> Result<CutPieces, StorageError> {
        let mut pieces = CutPieces::default();
        if let Some((most, file)) = &mut self.cut_pieces {
            for number in 0..((triangle.flags >> PIECES_SHIFT) as usize).min(*most) {
                pieces.push(&file.get(u64::from(id) * *most as u64 + number as u64)?);
            }
        }
        Ok(pieces)
    }

    /// Writes the pieces that a triangle keeps.
    pub fn put_cut_pieces(&mut self, id: u32, pieces: &CutPieces) -> Result<(), StorageError> {
        if let Some((most, file)) = &mut self.cut_pieces {
            for (number, piece) in pieces.in_order().iter().enumerate().take(*most) {
                file.put(u64::from(id) * *most as u64 + number as u64, piece)?;
            }
        }
        Ok(())
    }

    /// The places of a triangle's corners among the wedges of their vertices.
    pub fn corners(&mut self, id: u32) -> Result<CornerPlaces, StorageError> {
        self.corners.as_mut().map_or(Ok(CornerPlaces::default()), |file| file.get(id.into()))
    }

    /// Writes the places of a triangle's corners, if such are kept.
    pub fn put_corners(&mut self, id: u32, places: CornerPlaces) -> Result<(), StorageError> {
        self.corners.as_mut().map_or(Ok(()), |file| file.put(id.into(), &places))
    }

    /// How many wedges a vertex has, where the mesh has attributes.
    pub fn wedge_count(&mut self, vertex: u32) -> Result<usize, StorageError> {
        self.wedges.as_mut().map_or(Ok(0), |reader| reader.count(vertex))
    }

    /// Looks up the wedges of those vertices of a mesh that do not have theirs yet: the last ones.
    pub fn load_wedges(&mut self, mesh: &mut LiveMesh) -> Result<(), StorageError> {
        self.wedges.as_mut().map_or(Ok(()), |reader| mesh.load_wedges(reader))
    }

    /// Bytes that passed between RAM and the files.
    pub fn traffic(&self) -> Traffic {
        let of_pieces = self.cut_pieces.as_ref().map_or(Traffic::default(), |(_, file)| file.traffic());
        let of_corners = self.corners.as_ref().map_or(Traffic::default(), RecordFile::traffic);
        self.vertices.traffic() + self.triangles.traffic() + of_pieces + of_corners
    }
}
