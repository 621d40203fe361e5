//! A stored tree, looked up anywhere through caches: what blocking asks of it, and what goes into pages.
//!
//! Everything lies in leaf order, and the splits of a subtree are those born inside its interval. So the weight of a
//! subtree, in words of a page, is the difference of two running sums, and no walk from the leaves up is needed. The
//! sums are made in one pass, with the links that blocking follows: the *outline*, 24 bytes for each leaf.
//!
//! Blocking goes depth first, so what it asks for moves through the leaves from left to right; only the pages near the
//! root of the page tree, which are few, look all over the tree.
//!
//! Memory: the caches, and 4 bytes for each 1,024 leaves. I/O: splits and triangle counts are read once for the outline,
//! which is written and read once; then each array once more.

use bytemuck::{Pod, Zeroable};
use storage::{Scratch, Spool, SpoolWriter, StorageError};
use vdt::tree::{NO_SPLIT, Split, StoredTree};

use crate::blocking::BlockingError;
use crate::page::{ENTRY_WORDS, RECORD_WORDS, TRIANGLE_WORDS};

/// Records that a cache reads at once.
const STRETCH: usize = 1024;
/// Bytes of a buffer for reading from front to back.
const BUFFER: usize = 256 << 10;

/// What blocking knows of the split born at a leaf, and of all before it.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Outline {
    /// Words in pages of all splits before it.
    words_before: u64,
    /// The split of the kept child, or [`NO_SPLIT`].
    pub kept: u32,
    /// The split of the born child, or [`NO_SPLIT`].
    pub born: u32,
    /// Dependency id of the node.
    pub id: u32,
    /// Triangles of all splits before it.
    triangles_before: u32,
}

/// The last records of a spool that were looked up, by stretches. Frames are let go by second chance.
#[derive(Debug)]
pub(crate) struct Cache<'a, T> {
    spool: &'a Spool<T>,
    frame_of: Vec<u32>,
    /// The stretch in each frame, and whether it was looked up since the hand came by.
    frames: Vec<(u32, bool)>,
    records: Vec<T>,
    most_frames: usize,
    hand: usize,
}

const NO_FRAME: u32 = u32::MAX;

impl<'a, T: Pod> Cache<'a, T> {
    /// A cache of at most so many bytes, two stretches at least.
    pub fn new(spool: &'a Spool<T>, ram_bytes: usize) -> Self {
        let stretches = spool.len().div_ceil(STRETCH as u64) as usize;
        let most_frames = (ram_bytes / (STRETCH * size_of::<T>())).clamp(2, stretches.max(2));
        let frame_of = vec![NO_FRAME; stretches];
        Cache { spool, frame_of, frames: Vec::new(), records: Vec::new(), most_frames, hand: 0 }
    }

    /// The record with this number, which must exist.
    #[inline]
    pub fn get(&mut self, number: u32) -> Result<T, StorageError> {
        let stretch = number as usize / STRETCH;
        let mut frame = self.frame_of[stretch];
        if frame == NO_FRAME {
            frame = self.load(stretch)?;
        }
        self.frames[frame as usize].1 = true;
        Ok(self.records[frame as usize * STRETCH + number as usize % STRETCH])
    }

    #[cold]
    fn load(&mut self, stretch: usize) -> Result<u32, StorageError> {
        let frame = if self.frames.len() < self.most_frames {
            self.frames.push((NO_FRAME, false));
            self.records.resize(self.frames.len() * STRETCH, T::zeroed());
            self.frames.len() - 1
        } else {
            while std::mem::replace(&mut self.frames[self.hand].1, false) {
                self.hand = (self.hand + 1) % self.frames.len();
            }
            self.hand
        };
        if let Some(place) = self.frame_of.get_mut(self.frames[frame].0 as usize) {
            *place = NO_FRAME;
        }
        self.frames[frame].0 = NO_FRAME;
        let start = (stretch * STRETCH) as u64;
        let count = (self.spool.len() - start).min(STRETCH as u64) as usize;
        self.spool.read_at(start, &mut self.records[frame * STRETCH..][..count])?;
        self.frames[frame] = (stretch as u32, false);
        self.frame_of[stretch] = frame as u32;
        self.hand = (frame + 1) % self.most_frames.min(self.frames.len());
        Ok(frame as u32)
    }
}

/// Makes the outline of a tree; the last record, one more than there are leaves, has the sums of all.
pub(crate) fn outline(tree: &StoredTree, scratch: &Scratch, ram_bytes: usize) -> Result<Spool<Outline>, StorageError> {
    let mut splits = tree.splits.reader(BUFFER);
    let mut counts = tree.triangle_counts.reader(BUFFER);
    let mut outline = SpoolWriter::new(scratch, "outline", ram_bytes);
    let (mut words_before, mut triangles_before) = (0, 0_u32);
    while let (Some(Split { kept, born, id, .. }), Some(triangles)) = (splits.next()?, counts.next()?) {
        outline.push(Outline { words_before, kept, born, id, triangles_before })?;
        let entries = u64::from(kept != NO_SPLIT) + u64::from(born != NO_SPLIT);
        words_before +=
            RECORD_WORDS as u64 + entries * ENTRY_WORDS as u64 + u64::from(triangles) * TRIANGLE_WORDS as u64;
        triangles_before = triangles_before.wrapping_add(triangles);
    }
    outline.push(Outline { words_before, kept: NO_SPLIT, born: NO_SPLIT, id: 0, triangles_before })?;
    outline.finish()
}

/// A subtree, by the split at its root.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Subtree {
    /// The split.
    pub split: u32,
    /// The leaves under it.
    pub start: u32,
    pub end: u32,
    /// Whether it is a whole tree: no entry leads to it, so it may go on into a child page.
    pub is_tree: bool,
}

/// The outline, looked up.
#[derive(Debug)]
pub(crate) struct Nodes<'a> {
    cache: Cache<'a, Outline>,
}

impl<'a> Nodes<'a> {
    pub fn new(outline: &'a Spool<Outline>, ram_bytes: usize) -> Self {
        Nodes { cache: Cache::new(outline, ram_bytes) }
    }

    pub fn get(&mut self, split: u32) -> Result<Outline, StorageError> {
        self.cache.get(split)
    }

    /// The subtrees below a split that split further, the kept one first.
    ///
    /// The tree comes from our own build, but what follows would run in circles or out of an array on a wrong one: so a
    /// split that does not divide its leaves is refused, and so is one that is not among them.
    pub fn children(&mut self, subtree: Subtree) -> Result<[Option<Subtree>; 2], BlockingError> {
        let Subtree { split, start, end, .. } = subtree;
        check_place(subtree)?;
        let Outline { kept, born, .. } = self.cache.get(split)?;
        // A child is a leaf just where one leaf is left: so each leaf that can be born is.
        if (kept == NO_SPLIT) != (split - start == 1) || (born == NO_SPLIT) != (end - split == 1) {
            let (kept, born) = (split - start, end - split);
            let problem = format!("it leaves {kept} and {born} leaves, which does not fit its children");
            return Err(BlockingError::Tree { problem: format!("split {split}: {problem}") });
        }
        let below = [(kept, start, split), (born, split, end)].map(|(child, start, end)| {
            (child != NO_SPLIT).then_some(Subtree { split: child, start, end, is_tree: false })
        });
        below.into_iter().flatten().try_for_each(check_place)?;
        Ok(below)
    }

    /// Words of a page that a split takes.
    pub fn split_words(&mut self, split: u32) -> Result<usize, StorageError> {
        Ok((self.cache.get(split + 1)?.words_before - self.cache.get(split)?.words_before) as usize)
    }

    /// Words of pages that all splits of a subtree take: those born behind its first leaf.
    pub fn weight(&mut self, subtree: Subtree) -> Result<u64, StorageError> {
        Ok(self.cache.get(subtree.end)?.words_before - self.cache.get(subtree.start + 1)?.words_before)
    }

    /// The triangles of a split, by number.
    pub fn triangles(&mut self, split: u32) -> Result<std::ops::Range<u32>, StorageError> {
        Ok(self.cache.get(split)?.triangles_before..self.cache.get(split + 1)?.triangles_before)
    }
}

/// Whether the split of a subtree is among its leaves.
pub(crate) fn check_place(subtree: Subtree) -> Result<(), BlockingError> {
    let Subtree { split, start, end, .. } = subtree;
    if start < split && split < end {
        return Ok(());
    }
    Err(BlockingError::Tree { problem: format!("split {split}: it is to divide the leaves {start}..{end}") })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_cache_looks_up_what_is_there(
            count in 1_u32..20_000, ram in 0_usize..60_000, numbers in prop::collection::vec(any::<u32>(), 1..500),
        ) {
            let spool = Spool::from_vec((0..count).map(|number| number.wrapping_mul(0x9e37_79b9)).collect());
            let mut cache = Cache::new(&spool, ram);
            for number in numbers {
                let number = number % count;
                prop_assert_eq!(cache.get(number).unwrap(), number.wrapping_mul(0x9e37_79b9));
            }
            prop_assert!(cache.records.len() * 4 <= ram.max(2 * STRETCH * 4));
        }
    }
}
