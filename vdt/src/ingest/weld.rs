//! Canonical ids: the vertices sorted by Morton code, then position; equal positions are one vertex.
//!
//! I/O: 24 bytes for each vertex of the files written and read by the sort (32 where positions are rounded to a lattice),
//! 8 by the way back to the files' order where the ids do not fit in RAM, 12 written for each that is left. Vertices with
//! a twin shortly before are not sorted.

use bytemuck::{Pod, Zeroable};
use storage::{Scatter, Scattered, Scratch, SortRecord, Sorter, SpoolWriter, StorageError};

use super::blocks::BlockChooser;
use super::frame::{Frame, Grid, Rounding};
use super::limits::{Kept, Limits, held};
use super::marks::Marks;
use super::progress::Progress;
use super::twins::{TwinFinder, Twins};
use super::vertices::VertexSpool;

/// A vertex on its way into canonical order, which is the order of these fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub(super) struct VertexRecord {
    code: u64,
    position: [u32; 3],
    /// Its number in the files.
    number: u32,
}

/// The same where positions are rounded to a lattice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub(super) struct LatticeRecord {
    code: u64,
    position: [u32; 3],
    /// What the position would be without the lattice, mixed into 64 bits; low and high half.
    unrounded: [u32; 2],
    number: u32,
}

impl SortRecord for VertexRecord {
    #[inline]
    fn prefix(&self) -> u64 {
        self.code
    }
}

impl SortRecord for LatticeRecord {
    #[inline]
    fn prefix(&self) -> u64 {
        self.code
    }
}

/// What both are.
pub(super) trait Vertex: SortRecord {
    fn new(record: VertexRecord, unrounded: u64) -> Self;
    fn record(&self) -> VertexRecord;
    fn unrounded(&self) -> u64;
}

impl Vertex for VertexRecord {
    #[inline]
    fn new(record: VertexRecord, _: u64) -> Self {
        record
    }

    #[inline]
    fn record(&self) -> VertexRecord {
        *self
    }

    #[inline]
    fn unrounded(&self) -> u64 {
        0
    }
}

impl Vertex for LatticeRecord {
    #[inline]
    fn new(VertexRecord { code, position, number }: VertexRecord, unrounded: u64) -> Self {
        LatticeRecord { code, position, unrounded: [unrounded as u32, (unrounded >> 32) as u32], number }
    }

    #[inline]
    fn record(&self) -> VertexRecord {
        VertexRecord { code: self.code, position: self.position, number: self.number }
    }

    #[inline]
    fn unrounded(&self) -> u64 {
        u64::from(self.unrounded[0]) | u64::from(self.unrounded[1]) << 32
    }
}

/// Three words mixed into one, which different ones hardly ever have in common.
#[inline]
pub(super) fn mixed(words: [u32; 3]) -> u64 {
    let [x, y, z] = words.map(u64::from);
    let mut mixed = (x << 32 | y).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ z;
    mixed = (mixed ^ mixed >> 32).wrapping_mul(0xd6e8_feb8_6659_fd93);
    mixed ^ mixed >> 32
}

/// Bits of a number that are in the order of [`f32::total_cmp`] as integers.
#[inline]
fn ordered_bits(value: f32) -> u32 {
    let bits = value.to_bits();
    bits ^ if bits >> 31 == 1 { u32::MAX } else { 1 << 31 }
}

/// The number with these [`ordered_bits`].
#[inline]
fn from_ordered_bits(bits: u32) -> f32 {
    f32::from_bits(bits ^ if bits >> 31 == 1 { 1 << 31 } else { u32::MAX })
}

/// The vertices in canonical order.
#[derive(Debug)]
pub(super) struct Welded {
    pub positions: Kept<[f32; 3]>,
    /// The ids of the vertices of the files, in their order, but for those with a twin; those that no face names have
    /// none.
    pub ids: Scattered<u32>,
    pub twins: Twins,
    /// Bytes of RAM that `ids` and `twins` hold.
    pub ids_ram: usize,
    /// Vertices of the files that became one with another at the same position.
    pub welded: u64,
    /// Vertices that became one with another because both were rounded to one point of a lattice.
    pub fallen: u64,
    /// How far they were moved.
    pub rounding: Rounding,
    /// The first vertex of each block.
    pub blocks: Vec<u32>,
}

/// Sorts and welds the vertices that are marked, as records of a kind. `single` is the frame that they would have without a lattice, `held_ram`
/// are the bytes that other stores hold all the while.
#[expect(clippy::too_many_arguments, reason = "the state of the pipeline, each part of it used up by one phase")]
pub(super) fn weld<Record: Vertex>(
    vertices: VertexSpool,
    named: Marks,
    count: u64,
    frame: &Frame,
    single: &Frame,
    grid: &Grid,
    scratch: &Scratch,
    limits: &Limits,
    held_ram: usize,
    progress: &mut Progress<'_>,
) -> Result<Welded, StorageError> {
    let sorter_ram = limits.left(&[held_ram, vertices.ram(), named.ram()]) / 2;
    let mut sorter = Sorter::new(scratch, "vertices-by-code", sorter_ram, limits.threads);
    let mut twins = TwinFinder::new(scratch, limits.buffer());
    let mut marks = named.reader(limits.buffer());
    let (mut number, mut rounding) = (0_u32, Rounding::default());
    vertices.for_each(limits.buffer(), |position| {
        if marks.next()? {
            let local = frame.local(position);
            rounding.include(position, frame, local);
            let unrounded = if frame.is_on_lattice() { mixed(single.local(position).map(f32::to_bits)) } else { 0 };
            let position = local.map(ordered_bits);
            if !twins.has_twin(number, position, unrounded)? {
                let record = VertexRecord { code: grid.code(local), position, number };
                sorter.push(Record::new(record, unrounded))?;
            }
        }
        number += 1;
        progress.count(u64::from(number), 2 * count);
        Ok::<_, StorageError>(())
    })?;
    drop((vertices, named));

    let twins = twins.finish()?;
    let mut sorted = sorter.finish()?;
    let left = limits.left(&[held_ram, sorter_ram, twins.ram()]);
    let (positions_share, ids_share) = ((left / 4).min(limits.memory / 8), left / 2);
    let mut positions = SpoolWriter::new(scratch, "positions", positions_share);
    let mut ids = Scatter::new(scratch, "ids", count, ids_share);
    let mut blocks = BlockChooser::new(limits.block_triangles);
    let (mut taken, mut fallen, mut last) = (twins.found, 0, None);
    while let Some(vertex) = sorted.next()? {
        let VertexRecord { code, position, number } = vertex.record();
        let unrounded = vertex.unrounded();
        match last {
            Some((last, of)) if last == position => fallen += u64::from(of != unrounded),
            _ => {
                positions.push(position.map(from_ordered_bits))?;
                blocks.push(code);
            }
        }
        last = Some((position, unrounded));
        ids.put(number, blocks.vertices() - 1)?;
        taken += 1;
        progress.count(count + taken, 2 * count);
    }
    drop(sorted);
    let welded = taken - positions.len() - fallen;
    // On disk they are read by halves of the share.
    let all_ids = held(count, size_of::<u32>(), ids_share);
    let ids_ram = twins.ram() + if all_ids > 0 { all_ids } else { ids_share / 2 };
    Ok(Welded {
        positions: Kept::finish(positions, positions_share)?,
        ids: ids.finish()?,
        twins,
        ids_ram,
        welded,
        fallen,
        rounding,
        blocks: blocks.finish(),
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn bits_are_in_the_order_of_the_numbers(left: f32, right: f32) {
            prop_assert_eq!(ordered_bits(left).cmp(&ordered_bits(right)), left.total_cmp(&right));
            prop_assert_eq!(from_ordered_bits(ordered_bits(left)).to_bits(), left.to_bits());
        }
    }
}
