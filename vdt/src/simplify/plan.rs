//! How a simplification divides its memory. Blocks, merges and threads follow from it; what rounds do never does.

use super::bound::{Cover, Piece as CutPiece};
use crate::tree::ErrorBound;

/// Bytes that a live mesh takes for each of its triangles, with half as many vertices: 56 for the vertices, 20 for the
/// triangle, 20 for its part of the stars, 10 for batches, and what reading and writing it takes; and what it answers for.
/// Pieces are counted as many as there are at the most, for each triangle of a mesh that is simplified to the end: 0.33 to
/// 0.37, and 0.9 to 1.03 with the tight bound (measured on scans, terrain and CAD).
fn live_bytes(bound: ErrorBound) -> u64 {
    bare_bytes(bound)
        + match bound {
            ErrorBound::None | ErrorBound::Fast => 0,
            ErrorBound::Default | ErrorBound::TwoSided => CUT_PIECE_BYTES * 3 / 8,
            ErrorBound::Tight => CUT_PIECE_BYTES * 17 / 16,
        }
}

/// The same, without pieces.
fn bare_bytes(bound: ErrorBound) -> u64 {
    let cover = if bound.is_certified() { size_of::<Cover>() } else { 0 };
    let reverse = if bound.is_two_sided() { size_of::<f32>() } else { 0 };
    (122 + cover + reverse) as u64
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
    /// What the switch values are to be.
    pub bound: ErrorBound,
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
    pub fn new(memory: u64, threads: usize, bound: ErrorBound) -> Self {
        let live_bytes = live_bytes(bound);
        let buffer_bytes = (memory / BUFFER_PART).clamp(64 << 10, 4 << 20);
        // A quarter of the memory for a block, or less where there are more than two threads.
        let block = memory / (2 * threads.max(2) as u64);
        let core = memory / 10 * 9;
        Plan {
            memory,
            bound,
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
        live_bytes(bound) - live_bytes(ErrorBound::None)
    }

    /// What so many triangles that keep so many pieces take, in triangles as they are in the beginning.
    pub fn load(&self, triangles: u64, cut_pieces: u64) -> u64 {
        let bytes = triangles * bare_bytes(self.bound) + cut_pieces * CUT_PIECE_BYTES;
        triangles.max(bytes / live_bytes(self.bound))
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
        let blocks = FEWEST_BLOCK_TRIANGLES * live_bytes(bound) * 2 * threads.max(2) as u64;
        storage::ByteSize(blocks.min(Plan::memory_for_core(triangles, bound).0).max(1 << 20))
    }

    /// Memory with which so many triangles fit in core.
    pub fn memory_for_core(triangles: u64, bound: ErrorBound) -> storage::ByteSize {
        storage::ByteSize(triangles * live_bytes(bound) / 9 * 10 + 10)
    }
}
