//! How a simplification divides its memory. Blocks, merges and threads follow from it; what rounds do never does.

/// Bytes that a live mesh takes for each of its triangles, with half as many vertices: 54 for the vertices, 20 for the
/// triangle, 20 for its part of the stars, 10 for batches, and what reading and writing it takes.
const LIVE_BYTES: u64 = 120;

/// What a queue of all edges takes more, for each triangle: several entries for each edge.
const QUEUE_BYTES: u64 = 70;

/// A block of fewer triangles is mostly seam.
const FEWEST_BLOCK_TRIANGLES: u64 = 30_000;

/// Buffers for reading and writing are this part of the memory, for each thread.
const BUFFER_PART: u64 = 64;

/// Shares of the memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Plan {
    /// All of it, in bytes.
    pub memory: u64,
    /// Threads that work.
    pub threads: usize,
    /// Triangles that a block may have.
    pub block_triangles: u64,
    /// Triangles that may be in memory when there is nothing else.
    pub core_triangles: u64,
    /// Triangles that may be in memory with a queue of all their edges, when there is nothing else.
    pub queue_triangles: u64,
    /// A thread's buffer, in bytes.
    pub buffer_bytes: usize,
}

impl Plan {
    /// For so many bytes and threads.
    pub fn new(memory: u64, threads: usize) -> Self {
        let buffer_bytes = (memory / BUFFER_PART).clamp(64 << 10, 4 << 20);
        // A quarter of the memory for a block, or less where there are more than two threads.
        let block = memory / (2 * threads.max(2) as u64);
        Plan {
            memory,
            threads: threads.max(1),
            block_triangles: (block / LIVE_BYTES).max(FEWEST_BLOCK_TRIANGLES),
            core_triangles: memory / 10 * 9 / LIVE_BYTES,
            queue_triangles: memory / 10 * 9 / (LIVE_BYTES + QUEUE_BYTES),
            buffer_bytes: buffer_bytes as usize,
        }
    }

    /// The least memory for a mesh of so many triangles: all of it, or a block for each thread.
    pub fn smallest_memory(triangles: u64, threads: usize) -> storage::ByteSize {
        let blocks = FEWEST_BLOCK_TRIANGLES * LIVE_BYTES * 2 * threads.max(2) as u64;
        storage::ByteSize(blocks.min(Plan::memory_for_core(triangles).0).max(1 << 20))
    }

    /// Memory with which so many triangles fit in core.
    pub fn memory_for_core(triangles: u64) -> storage::ByteSize {
        storage::ByteSize(triangles * LIVE_BYTES / 9 * 10 + 10)
    }
}
