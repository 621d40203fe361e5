//! How the RAM of [`super::store`] is shared out among the stores that are alive at the same time.
//!
//! A store that stays within its share is kept in RAM whole, as long as it lives; one that outgrows it goes to disk and
//! holds nothing when it is finished. So the mesh of a small file never touches the disk, and for a large one each phase
//! has nearly all of the memory for what it is about. With M for the limit, and "left" for M less what is held:
//!
//! | phase | store | share |
//! |---|---|---|
//! | reading | triangles of the files; vertices in single, in double precision | M/4; M/8, M/8 |
//! | | marks of the vertices that faces name: window, all | M/8, M/16 |
//! | | attributes of vertices, of triangles; lists of texture coordinates, of normals | M/16, M/8; M/32, M/64 |
//! | welding | sorter of the vertices; twins | left/2; M/32 |
//! | | corners as vertices: vertices in the frame; what is read at any place; triangles | left/4; left/8; left/16 |
//! | | then: positions; ids by number in the file | left/4 and at most M/8; left/2 |
//! | | wedges; which are the first of their vertex; vertices that fell together | left/16 each |
//! | corners | window of the ids | at most 3/8 left |
//! | | sorter of the triangles; those that wait for another window | 5/8 of the rest; 3/16 of the rest |
//! | | sorter of the triangles without area | 1/16 of the rest |
//! | | vertices of wedges | 1/16 of what is left before |
//! | triangles | triangles in order | left/2 and at most M/4 |
//! | | seams: sorter, list; marks of the used vertices: window, all | left/8, left/16; left/8, left/16 |
//! | | wedges of corners; marks of the used wedges: window, all | left/16; left/32, left/32 |
//! | wedges | wedges; first of each vertex; places of corners | M/32; M/64; M/64 |
//! | | places of wedges: all, or what is read at any place | left/4 each |
//!
//! Each store that is read is read through a buffer of M/32 and at most 4 MiB. The stores of the result hold at most
//! half of M. Beside the shares there are lists of chunks and of blocks, [`smallest_memory`] says how long.

use bytemuck::Pod;
use storage::{ByteSize, Spool, SpoolWriter, StorageError};

use super::{FileCounts, IngestPlan};

/// What an ingest may use, and how fine it works.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Bytes of RAM.
    pub memory: usize,
    /// Threads.
    pub threads: usize,
    /// Triangles that a block should have.
    pub block_triangles: u64,
    /// Vertices in a chunk of vertices.
    pub vertex_chunk: usize,
    /// Triangles in a chunk of triangles.
    pub triangle_chunk: u64,
}

/// Vertices in a chunk: they are looked at twice while they are in the cache, at 24 bytes each.
const VERTEX_CHUNK: usize = 1 << 12;
/// Triangles in a chunk, which is 384 KiB.
const TRIANGLE_CHUNK: u64 = 1 << 15;
/// What a chunk of triangles takes in the list of chunks.
const CHUNK_LIST_BYTES: u64 = 48;
/// What a block takes in the lists of blocks.
const BLOCK_LIST_BYTES: u64 = 32;
/// Below this the buffers are too small for a disk.
const BUFFERS: u64 = 4 << 20;
/// The same for the stores of attributes.
const ATTRIBUTE_BUFFERS: u64 = 2 << 20;
const LARGEST_BUFFER: usize = 4 << 20;

impl Limits {
    pub fn of(plan: &IngestPlan) -> Limits {
        Limits {
            memory: usize::try_from(plan.memory.0).unwrap_or(usize::MAX),
            threads: plan.threads,
            block_triangles: plan.block_triangles,
            vertex_chunk: VERTEX_CHUNK,
            triangle_chunk: TRIANGLE_CHUNK,
        }
    }

    /// Bytes of a buffer through which a store is read.
    pub fn buffer(&self) -> usize {
        (self.memory / 32).min(LARGEST_BUFFER)
    }

    /// Bytes that are left while stores hold so many.
    pub fn left(&self, held: &[usize]) -> usize {
        held.iter().fold(self.memory, |left, held| left.saturating_sub(*held))
    }
}

/// The smallest [`IngestPlan::memory`] with which files that hold so much, with attributes or without, can be brought into
/// blocks of so many triangles.
///
/// It is in proportion to the mesh only by the lists of chunks and of blocks, which have a byte for hundreds of
/// triangles and one entry for each block.
pub fn smallest_memory(files: FileCounts, has_attributes: bool, block_triangles: u64) -> ByteSize {
    let FileCounts { vertices, triangles } = files;
    // Where corners become vertices, there are two lists of triangles.
    let (buffers, lists) = if has_attributes { (BUFFERS + ATTRIBUTE_BUFFERS, 2) } else { (BUFFERS, 1) };
    // Lists grow to twice their size, with the old one beside them.
    let triangle_chunks = lists * 3 * CHUNK_LIST_BYTES * triangles.div_ceil(TRIANGLE_CHUNK);
    let vertex_chunks = 3 * vertices.div_ceil(VERTEX_CHUNK as u64);
    let blocks = (3 * BLOCK_LIST_BYTES).saturating_mul(triangles.div_ceil(block_triangles.max(1)));
    ByteSize(buffers.saturating_add(triangle_chunks).saturating_add(vertex_chunks).saturating_add(blocks))
}

/// A finished sequence of records, and how much RAM it holds as long as it lives.
#[derive(Debug)]
pub(super) struct Kept<T> {
    pub spool: Spool<T>,
    /// Bytes: all of it or nothing.
    pub ram: usize,
}

impl<T: Pod> Kept<T> {
    /// Finishes a sequence that was given a share of so many bytes.
    pub fn finish(writer: SpoolWriter<T>, share: usize) -> Result<Kept<T>, StorageError> {
        let ram = held(writer.len(), size_of::<T>(), share);
        Ok(Kept { spool: writer.finish()?, ram })
    }
}

/// Bytes that a store of so many records holds in RAM, when it was given a share of so many bytes.
pub(super) fn held(records: u64, record_bytes: usize, share: usize) -> usize {
    let bytes = records.saturating_mul(record_bytes as u64);
    usize::try_from(bytes).ok().filter(|bytes| *bytes <= share).unwrap_or(0)
}
