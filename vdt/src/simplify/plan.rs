//! How a simplification divides its memory. Blocks, merges and threads follow from it; what rounds do never does.

use super::bound::{Cover, Piece as CutPiece};
use super::live_wedges::Heeded;
use crate::ingest::StoredMesh;
use crate::tree::{ErrorBound, Wedge};

/// What a live mesh carries besides its vertices and triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Carried {
    /// What the switch values are to be.
    pub bound: ErrorBound,
    /// Which attributes there are.
    pub heeded: Heeded,
    /// Bytes of wedges for each triangle of the mesh as it came.
    wedge_bytes: u64,
}

impl From<ErrorBound> for Carried {
    /// Without attributes.
    fn from(bound: ErrorBound) -> Self {
        Carried { bound, heeded: Heeded::default(), wedge_bytes: 0 }
    }
}

impl Carried {
    /// For a mesh as it came.
    pub fn of(mesh: &StoredMesh, bound: ErrorBound) -> Self {
        let heeded = Heeded::of(mesh.attributes.as_ref());
        let wedges = mesh.attributes.as_ref().filter(|_| heeded.has_wedges()).map_or(0, |all| all.wedges.len());
        Carried { bound, heeded, wedge_bytes: (wedges * WEDGE_BYTES).div_ceil(mesh.triangles.len().max(1)) }
    }

    /// Bytes for each triangle that there are for attributes besides wedges: 4 for its corners and 2 for the ends of the
    /// vertices' wedges where there are seams; 4 for what waits at vertices.
    fn attribute_bytes(self) -> u64 {
        let for_seams = if self.heeded.seams { 6 } else { 0 };
        let for_waits = if self.heeded.counts() { 4 } else { 0 };
        for_seams + for_waits
    }
}

const WEDGE_BYTES: u64 = size_of::<Wedge>() as u64;

/// Bytes that a live mesh takes for each of its triangles, with half as many vertices: 56 for the vertices, 20 for the
/// triangle, 20 for its part of the stars, 10 for batches, and what reading and writing it takes; and what it answers for.
/// Pieces are counted as many as there are at the most, for each triangle of a mesh that is simplified to the end: 0.33 to
/// 0.37, and 0.9 to 1.03 with the tight bound (measured on scans, terrain and CAD).
fn live_bytes(carried: Carried) -> u64 {
    bare_bytes(carried)
        + carried.wedge_bytes
        + match carried.bound {
            ErrorBound::None | ErrorBound::Fast => 0,
            ErrorBound::Default | ErrorBound::TwoSided => CUT_PIECE_BYTES * 3 / 8,
            ErrorBound::Tight => CUT_PIECE_BYTES * 17 / 16,
        }
}

/// The same, without pieces and wedges.
fn bare_bytes(carried: Carried) -> u64 {
    let bound = carried.bound;
    let cover = if bound.is_certified() { size_of::<Cover>() } else { 0 };
    let reverse = if bound.is_two_sided() { size_of::<f32>() } else { 0 };
    (122 + cover + reverse) as u64 + carried.attribute_bytes()
}

const CUT_PIECE_BYTES: u64 = size_of::<CutPiece>() as u64;

/// What a queue of all edges takes more, for each triangle: several entries for each edge.
const QUEUE_BYTES: u64 = 70;

/// A block of fewer triangles is mostly seam.
const FEWEST_BLOCK_TRIANGLES: u64 = 30_000;

/// Rounds that a pass may have, and about how many triangles its seams then have for each vertex that blocks share
/// (measured on terrain: 36 blocks of 440,000 triangles, 140 of 110,000).
const SEAM_WIDTHS: [(usize, u64); 3] = [(4, 62), (2, 30), (1, 14)];

/// Buffers for reading and writing are this part of the memory, for each thread.
const BUFFER_PART: u64 = 64;

/// Shares of the memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Plan {
    /// All of it, in bytes.
    pub memory: u64,
    /// What a live mesh carries.
    pub carried: Carried,
    /// Threads that work.
    pub threads: usize,
    /// Triangles that a block may have.
    pub block_triangles: u64,
    /// Triangles that may be in memory when there is nothing else.
    pub core_triangles: u64,
    /// Triangles that a group of seams should have.
    pub group_triangles: u64,
    /// Triangles that a group of seams may have, when no other is at work.
    pub seam_triangles: u64,
    /// Triangles that may be in memory with a queue of all their edges, when there is nothing else.
    pub queue_triangles: u64,
    /// Rounds that a pass may have.
    pub most_rounds: usize,
    /// A thread's buffer, in bytes.
    pub buffer_bytes: usize,
}

impl Plan {
    /// For so many bytes and threads.
    pub fn new(memory: u64, threads: usize, carried: impl Into<Carried>) -> Self {
        let carried = carried.into();
        let live_bytes = live_bytes(carried);
        let buffer_bytes = (memory / BUFFER_PART).clamp(64 << 10, 4 << 20);
        // A quarter of the memory for a block, or less where there are more than two threads.
        let block = memory / (2 * threads.max(2) as u64);
        let core = memory / 10 * 9;
        Plan {
            memory,
            carried,
            threads: threads.max(1),
            block_triangles: (block / live_bytes).max(FEWEST_BLOCK_TRIANGLES),
            core_triangles: core / live_bytes,
            group_triangles: (memory / 10 * 6 / live_bytes / threads.max(1) as u64).max(FEWEST_BLOCK_TRIANGLES),
            seam_triangles: core / live_bytes,
            queue_triangles: core / (live_bytes + QUEUE_BYTES),
            most_rounds: SEAM_WIDTHS[0].0,
            buffer_bytes: buffer_bytes as usize,
        }
    }

    /// What the bound takes for each triangle of a mesh that is simplified to the end in memory, in bytes.
    pub fn bound_bytes(bound: ErrorBound) -> u64 {
        live_bytes(bound.into()) - live_bytes(ErrorBound::None.into())
    }

    /// What so many triangles that keep so many pieces, and whose corners have so many wedges, take, in triangles as they are
    /// in the beginning.
    pub fn load(&self, triangles: u64, cut_pieces: u64, wedges: u64) -> u64 {
        let bytes = triangles * bare_bytes(self.carried) + cut_pieces * CUT_PIECE_BYTES + wedges * WEDGE_BYTES;
        triangles.max(bytes / live_bytes(self.carried))
    }

    /// How many rounds a pass should have over so many blocks that share so many vertices: as many as can be, but so that
    /// what the last group of groups is left with surely fits. That is what crosses the borders of the last few groups; of
    /// the borders of n blocks, it is a part that falls with the root of n.
    pub fn pass_rounds(&self, blocks: usize, shared_vertices: u64) -> usize {
        let part = (1.0 / blocks.max(1) as f64).sqrt();
        let fits = |width: u64| (shared_vertices * width) as f64 * part <= 0.55 * self.seam_triangles as f64;
        SEAM_WIDTHS.into_iter().find(|(_, width)| fits(*width)).map_or(1, |(rounds, _)| rounds).min(self.most_rounds)
    }

    /// How many rounds the first pass over so many triangles will have: blocks are a sixth smaller than they may be, and
    /// their borders run through twice the root of their triangles in vertices (measured on terrain).
    pub fn expected_rounds(&self, triangles: u64) -> usize {
        let blocks = (triangles as f64 / self.block_triangles as f64 * 1.2).ceil();
        let shared_vertices = 2.0 * (triangles as f64 * blocks).sqrt();
        self.pass_rounds(blocks as usize, shared_vertices as u64)
    }

    /// About how many vertices blocks share, by the triangles of the seams of a pass of so many rounds.
    pub fn shared_vertices(seam_triangles: u64, rounds: usize) -> u64 {
        let width = SEAM_WIDTHS.into_iter().rev().find(|(most, _)| rounds <= *most).map_or(1, |(_, width)| width);
        seam_triangles / width
    }

    /// The least memory for a mesh of so many triangles: all of it, or a block for each thread.
    pub fn smallest_memory(triangles: u64, threads: usize, bound: ErrorBound) -> storage::ByteSize {
        let blocks = FEWEST_BLOCK_TRIANGLES * live_bytes(bound.into()) * 2 * threads.max(2) as u64;
        storage::ByteSize(blocks.min(Plan::memory_for_core(triangles, bound).0).max(1 << 20))
    }

    /// Memory with which so many triangles fit in core.
    pub fn memory_for_core(triangles: u64, carried: impl Into<Carried>) -> storage::ByteSize {
        storage::ByteSize(triangles * live_bytes(carried.into()) / 9 * 10 + 10)
    }
}
