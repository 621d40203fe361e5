//! The wedges of the vertices, from the weld to the finished mesh.
//!
//! While vertices are welded, wedges are numbered by vertex, then by their order; a corner is known by the number of its wedge,
//! and the vertex of a wedge follows by rank: a bit for each wedge says whether it is the first of its vertex. When the
//! triangles are in order, it is known which wedges corners use. The others go, and what is left has its place at its
//! vertex.
//!
//! I/O: 20 bytes for each wedge written and read twice; where there are vertices with several wedges, a byte for four
//! wedges, and 4 for each wedge and 12 for each triangle written and read on the way to the places.

use bytemuck::{Pod, Zeroable};
use storage::{Scratch, SortRecord, Sorter, SpoolReader, SpoolWriter, StorageError};

use super::limits::{Kept, Limits};
use super::marks::{MarkWindow, Marks, MarksReader};
use crate::nearby::Nearby;
use crate::tree::{Appearance, CornerPlaces, MOST_WEDGES, MeshAttributes, MeshSeams, Normal, Wedge};

/// Words that are in the order of the wedge.
pub(super) type WedgeWords = [u32; 5];

/// The words of a wedge.
#[inline]
pub(super) fn words_of(wedge: &Wedge) -> WedgeWords {
    let [u, v] = wedge.texture.map(|number| number as u32 ^ 1 << 31);
    [wedge.material, u, v, u32::from_be_bytes(wedge.colour), wedge.normal.to_word()]
}

/// The wedge of these words.
#[inline]
fn wedge_of([material, u, v, colour, normal]: WedgeWords) -> Wedge {
    Wedge {
        material,
        texture: [u, v].map(|word| (word ^ 1 << 31) as i32),
        colour: colour.to_be_bytes(),
        normal: Normal::from_word(normal),
    }
}

/// What a vertex was before it was rounded to a lattice, where others fell onto the same point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct Fallen {
    vertex: u32,
    unrounded: [u32; 2],
}

impl SortRecord for Fallen {
    #[inline]
    fn prefix(&self) -> u64 {
        u64::from(self.vertex) << 32 | u64::from(self.unrounded[0])
    }
}

/// 32 wedges: which of them are the first of their vertex, and how many before them are.
type Word = [u32; 2];

/// Takes the wedges in their order.
#[derive(Debug)]
pub(super) struct WedgeWriter {
    wedges: SpoolWriter<Wedge>,
    words: SpoolWriter<Word>,
    word: Word,
    vertices: u32,
    shares: [usize; 2],
    /// What fell together is not in order: the wedges come first.
    fallen: Sorter<Fallen>,
    unrounded: [u32; 2],
    has_fallen: bool,
}

impl WedgeWriter {
    /// `left` are the bytes of RAM to share: three sixteenths of it are taken.
    pub fn new(scratch: &Scratch, left: usize) -> Self {
        let shares = [left / 16, left / 16];
        WedgeWriter {
            wedges: SpoolWriter::new(scratch, "wedges", shares[0]),
            words: SpoolWriter::new(scratch, "first-wedges", shares[1]),
            word: [0; 2],
            vertices: 0,
            shares,
            fallen: Sorter::new(scratch, "fallen-vertices", left / 16, 1),
            unrounded: [0; 2],
            has_fallen: false,
        }
    }

    /// The next wedge, and whether it is at another vertex than the one before.
    pub fn push(&mut self, words: WedgeWords, is_first: bool) -> Result<(), StorageError> {
        let place = self.wedges.len() % 32;
        if place == 0 {
            self.end_word()?;
            self.word = [0, self.vertices];
        }
        self.word[0] |= u32::from(is_first) << place;
        self.vertices += u32::from(is_first);
        self.wedges.push(wedge_of(words))
    }

    fn end_word(&mut self) -> Result<(), StorageError> {
        if self.wedges.is_empty() { Ok(()) } else { self.words.push(self.word) }
    }

    /// What a vertex that was welded to the last one was before it was rounded; `is_first` if it is the first there.
    #[inline]
    pub fn note_unrounded(&mut self, unrounded: u64, is_first: bool) -> Result<(), StorageError> {
        let halves = [unrounded as u32, (unrounded >> 32) as u32];
        if is_first {
            self.has_fallen = false;
        } else if halves != self.unrounded {
            let vertex = self.vertices - 1;
            if !self.has_fallen {
                self.fallen.push(Fallen { vertex, unrounded: self.unrounded })?;
            }
            self.has_fallen = true;
            self.fallen.push(Fallen { vertex, unrounded: halves })?;
        }
        self.unrounded = halves;
        Ok(())
    }

    /// How many wedges there are so far.
    pub fn count(&self) -> u32 {
        self.wedges.len() as u32
    }

    /// All wedges, and how many vertices fell onto another.
    pub fn finish(mut self) -> Result<(WeldedWedges, u64), StorageError> {
        self.end_word()?;
        let mut sorted = self.fallen.finish()?;
        let (mut fallen, mut last): (u64, Option<Fallen>) = (0, None);
        while let Some(next) = sorted.next()? {
            let is_other = last.is_some_and(|last| last.vertex == next.vertex && last.unrounded != next.unrounded);
            fallen += u64::from(is_other);
            last = Some(next);
        }
        let has_seams = self.wedges.len() > u64::from(self.vertices);
        let wedges = Kept::finish(self.wedges, self.shares[0])?;
        let words = if has_seams { Some(Kept::finish(self.words, self.shares[1])?) } else { None };
        Ok((WeldedWedges { wedges, words }, fallen))
    }
}

/// The wedges of all vertices, whether corners use them or not.
#[derive(Debug)]
pub(super) struct WeldedWedges {
    wedges: Kept<Wedge>,
    /// Which are the first of their vertex; none where each vertex has one.
    words: Option<Kept<Word>>,
}

impl WeldedWedges {
    /// Bytes of RAM that they hold.
    pub fn ram(&self) -> usize {
        self.wedges.ram + self.words.as_ref().map_or(0, |words| words.ram)
    }

    /// Tells the vertices of wedges, if some vertex has several wedges; through `ram_bytes`.
    pub fn vertices(&self, ram_bytes: usize) -> Option<WedgeVertices<'_>> {
        let words = self.words.as_ref()?;
        Some(WedgeVertices { words: Nearby::within(&words.spool, ram_bytes) })
    }

    /// The wedges that are used, where no vertex has several. `used` are the vertices that are, if some are not.
    pub fn without_seams(
        self,
        appearance: Appearance,
        used: Option<&Marks>,
        scratch: &Scratch,
        limits: &Limits,
    ) -> Result<MeshAttributes, StorageError> {
        let wedges = match used {
            None => self.wedges.spool,
            Some(used) => {
                let mut writer = SpoolWriter::new(scratch, "wedges", limits.memory / 32);
                let mut marks = used.reader(limits.buffer());
                let mut reader = self.wedges.spool.reader(limits.buffer());
                while let Some(wedge) = reader.next()? {
                    if marks.next()? {
                        writer.push(wedge)?;
                    }
                }
                writer.finish()?
            }
        };
        Ok(MeshAttributes { appearance, wedges, seams: None })
    }

    /// The wedges that corners use, and the places of corners among them; and how many wedges were too many for
    /// their vertex. `left` are the bytes of RAM to share.
    pub fn with_seams(
        self,
        appearance: Appearance,
        corners: UsedWedges,
        left: usize,
        scratch: &Scratch,
        limits: &Limits,
    ) -> Result<(MeshAttributes, u64), StorageError> {
        let Some(words) = &self.words else {
            return Ok((self.without_seams(appearance, None, scratch, limits)?, 0));
        };
        let (corners, used) = corners.marks(self.wedges.spool.len(), scratch, limits)?;
        let mut wedges = SpoolWriter::new(scratch, "wedges", limits.memory / 32);
        let mut first_wedges = SpoolWriter::new(scratch, "first-wedges", limits.memory / 64);
        let mut places = SpoolWriter::new(scratch, "places-of-wedges", left / 4);
        let mut merged = 0;
        let mut next = 0;
        let mut walk =
            Walk { firsts: words.spool.reader(limits.buffer()), used: used.reader(limits.buffer()), word: 0, left: 0 };
        let mut reader = self.wedges.spool.reader(limits.buffer());
        while let Some(wedge) = reader.next()? {
            let (is_first, is_used) = walk.next()?;
            if is_first {
                next = 0;
            }
            places.push(next.min(MOST_WEDGES as u32 - 1))?;
            if !is_used {
                continue;
            }
            if next == 0 {
                first_wedges.push(wedges.len() as u32)?;
            }
            if (next as usize) < MOST_WEDGES {
                wedges.push(wedge)?;
            } else {
                merged += 1;
            }
            next += 1;
        }
        drop((reader, walk));
        drop(self);
        let (places, wedges, first_wedges) = (places.finish()?, wedges.finish()?, first_wedges.finish()?);
        if wedges.len() == first_wedges.len() {
            return Ok((MeshAttributes { appearance, wedges, seams: None }, merged));
        }
        let mut writer = SpoolWriter::new(scratch, "corner-places", limits.memory / 64);
        let mut place = Nearby::within(&places, left / 4);
        let mut reader = corners.spool.reader(limits.buffer());
        while let Some([a, b, c]) = reader.next()? {
            let [a, b, c] = [place.get(a.into())?, place.get(b.into())?, place.get(c.into())?];
            writer.push(CornerPlaces::of([a, b, c]))?;
        }
        let seams = Some(MeshSeams { first_wedges, corners: writer.finish()? });
        Ok((MeshAttributes { appearance, wedges, seams }, merged))
    }
}

/// Goes through the wedges.
struct Walk<'a> {
    firsts: SpoolReader<'a, Word>,
    used: MarksReader<'a>,
    word: u32,
    left: u32,
}

impl Walk<'_> {
    /// Whether the next wedge is the first of its vertex, and whether corners use it.
    fn next(&mut self) -> Result<(bool, bool), StorageError> {
        if self.left == 0 {
            self.word = self.firsts.next()?.unwrap_or_default()[0];
            self.left = 32;
        }
        let is_first = self.word & 1 == 1;
        self.word >>= 1;
        self.left -= 1;
        Ok((is_first, self.used.next()?))
    }
}

/// Tells the vertex of a wedge.
#[derive(Debug)]
pub(super) struct WedgeVertices<'a> {
    words: Nearby<'a, Word>,
}

impl WedgeVertices<'_> {
    #[inline]
    fn of(&mut self, wedge: u32) -> Result<u32, StorageError> {
        let [word, before] = self.words.get(u64::from(wedge / 32))?;
        Ok(before + (word << (31 - wedge % 32)).count_ones() - 1)
    }

    /// The vertices of three wedges.
    #[inline]
    pub fn of_corners(&mut self, [a, b, c]: [u32; 3]) -> Result<[u32; 3], StorageError> {
        Ok([self.of(a)?, self.of(b)?, self.of(c)?])
    }
}

/// Takes the wedges of the corners of the triangles that stay, in canonical order.
#[derive(Debug)]
pub(super) struct UsedWedgesWriter {
    corners: SpoolWriter<[u32; 3]>,
    window: MarkWindow,
    left: usize,
}

impl UsedWedgesWriter {
    /// `left` are the bytes of RAM to share: an eighth of it is taken.
    pub fn new(scratch: &Scratch, left: usize) -> Self {
        let corners = SpoolWriter::new(scratch, "wedges-of-corners", left / 16);
        UsedWedgesWriter { corners, window: MarkWindow::new(left / 32), left }
    }

    #[inline]
    pub fn push(&mut self, wedges: [u32; 3]) -> Result<(), StorageError> {
        wedges.iter().for_each(|wedge| self.window.mark(u64::from(*wedge)));
        self.corners.push(wedges)
    }

    /// All of them.
    pub fn finish(self) -> Result<UsedWedges, StorageError> {
        let UsedWedgesWriter { corners, window, left } = self;
        Ok(UsedWedges { corners: Kept::finish(corners, left / 16)?, window, left })
    }
}

/// The wedges of all corners.
#[derive(Debug)]
pub(super) struct UsedWedges {
    corners: Kept<[u32; 3]>,
    /// Which wedges these are, as far as was room.
    window: MarkWindow,
    left: usize,
}

impl UsedWedges {
    /// Bytes of RAM that they hold.
    pub fn ram(&self) -> usize {
        self.corners.ram + self.left / 16
    }

    /// The wedges of all corners; and which of so many wedges these are.
    fn marks(self, wedges: u64, scratch: &Scratch, limits: &Limits) -> Result<(Kept<[u32; 3]>, Marks), StorageError> {
        let UsedWedges { corners, window, left } = self;
        let mark_again = |window: &mut MarkWindow| {
            let mut reader = corners.spool.reader(limits.buffer());
            while let Some(wedges) = reader.next()? {
                wedges.iter().for_each(|wedge| window.mark(u64::from(*wedge)));
            }
            Ok::<_, StorageError>(())
        };
        let used = window.complete(wedges, scratch, "used-wedges", left / 32, mark_again)?;
        Ok((corners, used))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn wedges() -> impl Strategy<Value = Wedge> {
        let small = prop_oneof![Just(0_i32), Just(-1), Just(1), Just(-Appearance::LARGEST_TEXTURE), any::<i32>()];
        let byte = prop_oneof![Just(0_u8), Just(255), any::<u8>()];
        (0..3_u32, prop::array::uniform2(small), prop::array::uniform4(byte), 0..3_u32).prop_map(
            |(material, texture, colour, normal)| Wedge {
                material,
                texture,
                colour,
                normal: Normal::from_word(normal),
            },
        )
    }

    proptest! {
        #[test]
        fn words_are_in_the_order_of_wedges(left in wedges(), right in wedges()) {
            prop_assert_eq!(words_of(&left).cmp(&words_of(&right)), left.order().cmp(&right.order()));
            prop_assert_eq!(wedge_of(words_of(&left)), left);
        }

        #[test]
        fn the_vertex_of_a_wedge_is_found_by_rank(counts in prop::collection::vec(1_u32..70, 1..40)) {
            let mut writer = WedgeWriter::new(&Scratch::in_memory(), 1000);
            let mut expected = Vec::new();
            for (vertex, count) in counts.iter().enumerate() {
                for place in 0..*count {
                    writer.push([place; 5], place == 0).unwrap();
                    expected.push(vertex as u32);
                }
            }
            let (welded, fallen) = writer.finish().unwrap();
            prop_assert_eq!((fallen, welded.words.is_some()), (0, expected.len() > counts.len()));
            let Some(mut vertices) = welded.vertices(100) else { return Ok(()) };
            for (wedge, vertex) in expected.iter().enumerate() {
                prop_assert_eq!(vertices.of(wedge as u32).unwrap(), *vertex);
            }
        }
    }
}
