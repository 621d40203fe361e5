//! Closing the gaps in the canonical ids that vertices leave which only degenerate triangles used.
//!
//! Rare, for which it takes one more pass over the vertices and one more sort of the triangles: the ids without gaps are
//! a map from the old ones, just as the canonical ids were one from the numbers in the files.

use storage::{Scratch, Spool, SpoolWriter, StorageError};

use super::blocks::BlockChooser;
use super::frame::{Bounds, Grid};
use super::limits::{Kept, Limits};
use super::marks::Marks;

/// The vertices that are used, in their order.
#[derive(Debug)]
pub(super) struct UsedVertices {
    pub positions: Kept<[f32; 3]>,
    bounds: Bounds,
    /// The first vertex of each block.
    pub blocks: Vec<u32>,
}

impl UsedVertices {
    /// The box of the positions; zeros if there are none.
    pub fn bounds_in_single_precision(&self) -> [[f32; 3]; 2] {
        if self.positions.spool.is_empty() {
            return [[0.0; 3]; 2];
        }
        // They are single-precision numbers, widened.
        [self.bounds.minimum, self.bounds.maximum].map(|corner| corner.map(|value| value as f32))
    }
}

/// Leaves out the positions of vertices that are not used, with a share of `ram_bytes` for the others.
pub(super) fn used_vertices(
    positions: &Spool<[f32; 3]>,
    used: &Marks,
    grid: &Grid,
    scratch: &Scratch,
    limits: &Limits,
    ram_bytes: usize,
) -> Result<UsedVertices, StorageError> {
    let mut writer = SpoolWriter::new(scratch, "positions", ram_bytes);
    let mut bounds = Bounds::EMPTY;
    let mut blocks = BlockChooser::new(limits.block_triangles);
    let mut marks = used.reader(limits.buffer());
    let mut reader = positions.reader(limits.buffer());
    while let Some(position) = reader.next()? {
        if marks.next()? {
            writer.push(position)?;
            bounds.include(position.map(f64::from));
            blocks.push(grid.code(position));
        }
    }
    Ok(UsedVertices { positions: Kept::finish(writer, ram_bytes)?, bounds, blocks: blocks.finish() })
}

/// The ids without gaps, one for each vertex: those of vertices that are not used mean nothing.
pub(super) fn closed_ids(used: &Marks, buffer: usize) -> impl FnMut() -> Result<Option<u32>, StorageError> {
    let mut marks = used.reader(buffer);
    let mut left = used.marked + used.unmarked;
    let mut next = 0;
    move || {
        if left == 0 {
            return Ok(None);
        }
        left -= 1;
        let id = next;
        next += u32::from(marks.next()?);
        Ok(Some(id))
    }
}
