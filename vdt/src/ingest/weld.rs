//! Canonical ids: the vertices sorted by Morton code, then position; equal positions are one vertex. Where there are
//! attributes, equal ones at a position are one wedge.
//!
//! I/O: 24 bytes for each vertex of the files written and read by the sort (32 where positions are rounded to a lattice, 52
//! with attributes), 8 by the way back to the files' order where the ids do not fit in RAM, 12 written for each that is left. Vertices with
//! a twin shortly before are not sorted.

use bytemuck::{Pod, Zeroable};
use storage::{Scatter, Scattered, Scratch, SortRecord, Sorter, SpoolWriter, StorageError};

use super::blocks::BlockChooser;
use super::frame::{Grid, Rounding};
use super::limits::{Kept, Limits, held};
use super::progress::Progress;
use super::twins::{Look, TwinFinder, Twins};
use super::wedges::{WedgeWords, WedgeWriter, WeldedWedges};

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

/// The same with attributes, with or without a lattice: 52 bytes, since the code is in halves, the high one first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub(super) struct WedgeRecord {
    code: [u32; 2],
    position: [u32; 3],
    wedge: WedgeWords,
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

impl SortRecord for WedgeRecord {
    #[inline]
    fn prefix(&self) -> u64 {
        u64::from(self.code[0]) << 32 | u64::from(self.code[1])
    }
}

/// What all are.
pub(super) trait Vertex: SortRecord {
    /// The attributes, as twins have them in common.
    type Wedge: Copy + Default + PartialEq;
    /// Whether there are attributes.
    const HAS_WEDGE: bool;
    fn new(record: VertexRecord, unrounded: u64, wedge: WedgeWords) -> Self;
    fn record(&self) -> VertexRecord;
    fn unrounded(&self) -> u64;
    /// The attributes; zeros without.
    fn words(&self) -> WedgeWords;
    fn wedge(words: WedgeWords) -> Self::Wedge;
}

impl Vertex for VertexRecord {
    type Wedge = ();
    const HAS_WEDGE: bool = false;

    #[inline]
    fn new(record: VertexRecord, _: u64, _: WedgeWords) -> Self {
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

    #[inline]
    fn words(&self) -> WedgeWords {
        [0; 5]
    }

    #[inline]
    fn wedge(_: WedgeWords) {}
}

impl Vertex for LatticeRecord {
    type Wedge = ();
    const HAS_WEDGE: bool = false;

    #[inline]
    fn new(VertexRecord { code, position, number }: VertexRecord, unrounded: u64, _: WedgeWords) -> Self {
        LatticeRecord { code, position, unrounded: low_and_high(unrounded), number }
    }

    #[inline]
    fn record(&self) -> VertexRecord {
        VertexRecord { code: self.code, position: self.position, number: self.number }
    }

    #[inline]
    fn unrounded(&self) -> u64 {
        of_low_and_high(self.unrounded)
    }

    #[inline]
    fn words(&self) -> WedgeWords {
        [0; 5]
    }

    #[inline]
    fn wedge(_: WedgeWords) {}
}

impl Vertex for WedgeRecord {
    type Wedge = WedgeWords;
    const HAS_WEDGE: bool = true;

    #[inline]
    fn new(VertexRecord { code, position, number }: VertexRecord, unrounded: u64, wedge: WedgeWords) -> Self {
        let code = [(code >> 32) as u32, code as u32];
        WedgeRecord { code, position, wedge, unrounded: low_and_high(unrounded), number }
    }

    #[inline]
    fn record(&self) -> VertexRecord {
        VertexRecord { code: self.prefix(), position: self.position, number: self.number }
    }

    #[inline]
    fn unrounded(&self) -> u64 {
        of_low_and_high(self.unrounded)
    }

    #[inline]
    fn words(&self) -> WedgeWords {
        self.wedge
    }

    #[inline]
    fn wedge(words: WedgeWords) -> WedgeWords {
        words
    }
}

/// The halves of a number, the low one first.
#[inline]
pub(super) fn low_and_high(number: u64) -> [u32; 2] {
    [number as u32, (number >> 32) as u32]
}

/// The number of these halves.
#[inline]
pub(super) fn of_low_and_high([low, high]: [u32; 2]) -> u64 {
    u64::from(low) | u64::from(high) << 32
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
    /// The wedges of the vertices, where there are attributes.
    pub wedges: Option<WeldedWedges>,
    /// The ids of what was welded, in the order of the numbers, but for those with a twin; numbers that did not come have
    /// none. With attributes, the ids are those of wedges.
    pub ids: Scattered<u32>,
    pub twins: Twins,
    /// Bytes of RAM that `ids` and `twins` hold.
    pub ids_ram: usize,
    /// Vertices that became one with another because both were rounded to one point of a lattice.
    pub fallen: u64,
    /// How far they were moved.
    pub rounding: Rounding,
    /// The first vertex of each block.
    pub blocks: Vec<u32>,
}

/// Takes the vertices, in the order of their numbers, as records of a kind.
#[derive(Debug)]
pub(super) struct Entrance<'a, Record: Vertex> {
    sorter: Sorter<Record>,
    twins: TwinFinder<Record::Wedge>,
    grid: &'a Grid,
    count: u64,
}

impl<Record: Vertex> Entrance<'_, Record> {
    /// The vertex of a number, at its place in the frame. `unrounded` is what it would be without a lattice, mixed; 0
    /// without one.
    #[inline]
    pub fn push(
        &mut self,
        number: u32,
        local: [f32; 3],
        unrounded: u64,
        words: WedgeWords,
    ) -> Result<(), StorageError> {
        let position = local.map(ordered_bits);
        let [material, u, v, colour, normal] = words;
        let salt = if Record::HAS_WEDGE { mixed([u ^ material, v, colour ^ normal.rotate_left(12)]) } else { 0 };
        if self.twins.has_twin(number, Look { position, unrounded, wedge: Record::wedge(words) }, salt)? {
            return Ok(());
        }
        let record = VertexRecord { code: self.grid.code(local), position, number };
        self.sorter.push(Record::new(record, unrounded, words))
    }

    /// So many numbers have passed.
    #[inline]
    pub fn passed(&self, numbers: u64, progress: &mut Progress<'_>) {
        progress.count(numbers, 2 * self.count);
    }
}

/// Bytes of RAM that other stores hold.
#[derive(Debug, Clone, Copy)]
pub(super) struct HeldRam {
    /// While the vertices enter.
    pub at_first: usize,
    /// And all the while.
    pub always: usize,
}

/// Sorts and welds the vertices that `enter` pushes, whose numbers are below `count`; it tells how far they were moved.
pub(super) fn weld<Record: Vertex>(
    count: u64,
    grid: &Grid,
    scratch: &Scratch,
    limits: &Limits,
    held_ram: HeldRam,
    progress: &mut Progress<'_>,
    enter: impl FnOnce(&mut Entrance<'_, Record>, &mut Progress<'_>) -> Result<Rounding, StorageError>,
) -> Result<Welded, StorageError> {
    let sorter_ram = limits.left(&[held_ram.at_first, held_ram.always]) / 2;
    let mut entrance = Entrance {
        sorter: Sorter::new(scratch, "vertices-by-code", sorter_ram, limits.threads),
        twins: TwinFinder::new(scratch, limits.buffer()),
        grid,
        count,
    };
    let rounding = enter(&mut entrance, progress)?;
    let Entrance { sorter, twins, .. } = entrance;

    let twins = twins.finish()?;
    let mut sorted = sorter.finish()?;
    let left = limits.left(&[held_ram.always, sorter_ram, twins.ram()]);
    let (positions_share, ids_share) = ((left / 4).min(limits.memory / 8), left / 2);
    let mut positions = SpoolWriter::new(scratch, "positions", positions_share);
    let mut wedges = Record::HAS_WEDGE.then(|| WedgeWriter::new(scratch, left));
    let mut ids = Scatter::new(scratch, "ids", count, ids_share);
    let mut blocks = BlockChooser::new(limits.block_triangles);
    let (mut taken, mut fallen) = (twins.found, 0);
    let mut last: Option<([u32; 3], u64, WedgeWords)> = None;
    while let Some(vertex) = sorted.next()? {
        let VertexRecord { code, position, number } = vertex.record();
        let (unrounded, words) = (vertex.unrounded(), vertex.words());
        let before = last.filter(|(last, ..)| *last == position);
        match before {
            Some((_, of, _)) => fallen += u64::from(of != unrounded),
            None => {
                positions.push(position.map(from_ordered_bits))?;
                blocks.push(code);
            }
        }
        let id = match &mut wedges {
            None => blocks.vertices() - 1,
            Some(wedges) => {
                if before.is_none_or(|(_, _, words_before)| words_before != words) {
                    wedges.push(words, before.is_none())?;
                }
                wedges.note_unrounded(unrounded, before.is_none())?;
                wedges.count() - 1
            }
        };
        last = Some((position, unrounded, words));
        ids.put(number, id)?;
        taken += 1;
        progress.count(count + taken, 2 * count);
    }
    drop(sorted);
    let wedges = match wedges {
        None => None,
        Some(wedges) => {
            let (wedges, really_fallen) = wedges.finish()?;
            fallen = really_fallen;
            Some(wedges)
        }
    };
    // On disk they are read by halves of the share.
    let all_ids = held(count, size_of::<u32>(), ids_share);
    let ids_ram = twins.ram() + if all_ids > 0 { all_ids } else { ids_share / 2 };
    Ok(Welded {
        positions: Kept::finish(positions, positions_share)?,
        wedges,
        ids: ids.finish()?,
        twins,
        ids_ram,
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
