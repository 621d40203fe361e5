//! A stored tree, looked up anywhere through caches: what blocking asks of it, and what goes into pages.
//!
//! Everything lies in leaf order, and the splits of a subtree are those born inside its interval. So the weight of a
//! subtree, in words of a page, is the difference of two running sums, and no walk from the leaves up is needed. The
//! sums at every 2,048th leaf are made in one pass ([`Sums`]); those between follow when a stretch is read.
//!
//! Blocking goes depth first, so what it asks for moves through the leaves from left to right; only the pages near the
//! root of the page tree, which are few, look all over the tree.
//!
//! Memory: the caches, and 28 bytes for each 2,048 leaves. I/O: splits, triangle counts and, with seams, where wedges begin
//! are read once for the sums; then each array once more for every walk.

use bytemuck::Pod;
use storage::{Spool, StorageError};
use vdt::tree::{NO_SPLIT, Split, StoredTree};

use crate::blocking::BlockingError;
use crate::page::PageCounts;
use crate::wedges::WedgeLayout;

/// Nodes that are read at once, and between two sums.
const NODES: usize = 2048;
/// Bytes of a buffer for reading from front to back.
const BUFFER: usize = 256 << 10;

/// Where the records of a [`Cache`] come from.
pub(crate) trait Source {
    /// A record.
    type Record: Copy;

    /// Records that are read at once: many are read faster, few are read in vain where one is looked up here and there.
    const STRETCH: usize;

    /// A record to fill room with.
    fn empty() -> Self::Record;

    /// How many there are.
    fn len(&self) -> u64;

    /// Fills `records` with those from number `start` on, which exist.
    fn read(&mut self, start: u64, records: &mut [Self::Record]) -> Result<(), StorageError>;
}

impl<T: Pod> Source for &Spool<T> {
    type Record = T;

    const STRETCH: usize = 1024;

    fn empty() -> T {
        T::zeroed()
    }

    fn len(&self) -> u64 {
        Spool::len(self)
    }

    fn read(&mut self, start: u64, records: &mut [T]) -> Result<(), StorageError> {
        self.read_at(start, records)
    }
}

/// The last records of a source that were looked up, by stretches. Frames are let go by second chance.
#[derive(Debug)]
pub(crate) struct Cache<S: Source> {
    source: S,
    frame_of: Vec<u32>,
    /// The stretch in each frame, and whether it was looked up since the hand came by.
    frames: Vec<(u32, bool)>,
    records: Vec<S::Record>,
    most_frames: usize,
    hand: usize,
}

const NO_FRAME: u32 = u32::MAX;

impl<S: Source> Cache<S> {
    /// A cache of at most so many bytes, two stretches at least.
    pub fn new(source: S, ram_bytes: usize) -> Self {
        let stretches = source.len().div_ceil(S::STRETCH as u64) as usize;
        let most_frames = (ram_bytes / (S::STRETCH * size_of::<S::Record>())).clamp(2, stretches.max(2));
        let frame_of = vec![NO_FRAME; stretches];
        Cache { source, frame_of, frames: Vec::new(), records: Vec::new(), most_frames, hand: 0 }
    }

    /// Whether so many records fit in it.
    pub fn holds(&self, records: usize) -> bool {
        records <= self.most_frames * S::STRETCH
    }

    /// The record with this number, which must exist.
    #[inline]
    pub fn get(&mut self, number: u32) -> Result<S::Record, StorageError> {
        let stretch = number as usize / S::STRETCH;
        let mut frame = self.frame_of[stretch];
        if frame == NO_FRAME {
            frame = self.load(stretch)?;
        }
        self.frames[frame as usize].1 = true;
        Ok(self.records[frame as usize * S::STRETCH + number as usize % S::STRETCH])
    }

    #[cold]
    fn load(&mut self, stretch: usize) -> Result<u32, StorageError> {
        let frame = if self.frames.len() < self.most_frames {
            self.frames.push((NO_FRAME, false));
            self.records.resize(self.frames.len() * S::STRETCH, S::empty());
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
        let start = (stretch * S::STRETCH) as u64;
        let count = (self.source.len() - start).min(S::STRETCH as u64) as usize;
        self.source.read(start, &mut self.records[frame * S::STRETCH..][..count])?;
        self.frames[frame] = (stretch as u32, false);
        self.frame_of[stretch] = frame as u32;
        self.hand = (frame + 1) % self.most_frames.min(self.frames.len());
        Ok(frame as u32)
    }
}

/// What lies before each stretch of a tree: the words in pages and the triangles of all splits, and at the end those of
/// the whole tree.
#[derive(Debug)]
pub(crate) struct Sums {
    layout: WedgeLayout,
    before: Vec<(u64, u32)>,
    all: (u64, u32),
}

impl Sums {
    /// Adds up a tree.
    pub fn of(tree: &StoredTree) -> Result<Self, StorageError> {
        let mut splits = tree.splits.reader(BUFFER);
        let mut counts = tree.triangle_counts.reader(BUFFER);
        let layout = WedgeLayout::of(tree);
        let mut wedges = WedgeCounts::of(tree)?;
        let mut before = Vec::with_capacity((tree.leaf_count() as usize).div_ceil(NODES));
        let (mut number, mut all) = (0, (0, 0));
        while let (Some(split), Some(triangles)) = (splits.next()?, counts.next()?) {
            if number % NODES == 0 {
                before.push(all);
            }
            number += 1;
            all = after(all, &split, triangles, wedges.next()?, layout);
        }
        Ok(Sums { layout, before, all })
    }
}

/// The sums behind a split, from those before it.
#[inline]
fn after((words, triangles): (u64, u32), split: &Split, born: u32, wedges: u32, layout: WedgeLayout) -> (u64, u32) {
    let entries = usize::from(split.kept != NO_SPLIT) + usize::from(split.born != NO_SPLIT);
    let own = PageCounts::record_words(entries, born as usize, wedges as usize, layout);
    (words + own as u64, triangles.wrapping_add(born))
}

/// How many wedges the leaves have, one after the other.
struct WedgeCounts<'a> {
    firsts: Option<storage::SpoolReader<'a, u32>>,
    first: u64,
    end: u64,
    /// What each leaf has where there are no seams.
    each: u32,
}

impl<'a> WedgeCounts<'a> {
    fn of(tree: &'a StoredTree) -> Result<Self, StorageError> {
        let (each, end) = tree.attributes.as_ref().map_or((0, 0), |attributes| (1, attributes.wedges.len()));
        let seams = tree.attributes.as_ref().and_then(|attributes| attributes.seams.as_ref());
        let mut firsts = seams.map(|seams| seams.first_wedges.reader(BUFFER));
        let first = firsts.as_mut().map(|firsts| firsts.next()).transpose()?.flatten().unwrap_or_default();
        Ok(WedgeCounts { firsts, first: first.into(), end, each })
    }

    fn next(&mut self) -> Result<u32, StorageError> {
        let Some(firsts) = &mut self.firsts else { return Ok(self.each) };
        let next = firsts.next()?.map_or(self.end, u64::from);
        Ok(next.saturating_sub(std::mem::replace(&mut self.first, next)) as u32)
    }
}

/// A split, with the sums over all before it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    split: Split,
    before: (u64, u32),
}

impl Node {
    const VACANT: Node = Node { split: Split::VACANT, before: (0, 0) };
}

/// The nodes of a tree by the leaf that they bear; the last, one more than there are leaves, has the sums of all.
#[derive(Debug)]
pub(crate) struct NodeSource<'a> {
    tree: &'a StoredTree,
    sums: &'a Sums,
    splits: Vec<Split>,
    counts: Vec<u32>,
    first_wedges: Vec<u32>,
}

impl Source for NodeSource<'_> {
    type Record = Node;

    const STRETCH: usize = NODES;

    fn empty() -> Node {
        Node::VACANT
    }

    fn len(&self) -> u64 {
        self.tree.leaf_count() + 1
    }

    fn read(&mut self, start: u64, nodes: &mut [Node]) -> Result<(), StorageError> {
        let count = (self.tree.leaf_count() - start).min(nodes.len() as u64) as usize;
        self.splits.resize(count, Split::VACANT);
        self.counts.resize(count, 0);
        self.tree.splits.read_at(start, &mut self.splits)?;
        self.tree.triangle_counts.read_at(start, &mut self.counts)?;
        let attributes = self.tree.attributes.as_ref();
        let wedge_count = attributes.map_or(0, |attributes| attributes.wedges.len() as u32);
        let seams = attributes.and_then(|attributes| attributes.seams.as_ref());
        if let Some(seams) = seams {
            // One more, or the end of all, tells how many the last one has.
            let known = (self.tree.leaf_count() - start).min(count as u64 + 1) as usize;
            self.first_wedges.resize(count + 1, wedge_count);
            self.first_wedges[count] = wedge_count;
            seams.first_wedges.read_at(start, &mut self.first_wedges[..known])?;
        }
        let each = u32::from(attributes.is_some());
        let mut before = self.sums.before.get(start as usize / NODES).copied().unwrap_or(self.sums.all);
        for (index, ((node, split), born)) in nodes.iter_mut().zip(&self.splits).zip(&self.counts).enumerate() {
            *node = Node { split: *split, before };
            let wedges = match seams {
                Some(_) => self.first_wedges[index + 1].saturating_sub(self.first_wedges[index]),
                None => each,
            };
            before = after(before, split, *born, wedges, self.sums.layout);
        }
        if let Some(last) = nodes.get_mut(count) {
            *last = Node { split: Split::VACANT, before };
        }
        Ok(())
    }
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

/// The splits of a tree with what they weigh, looked up.
#[derive(Debug)]
pub(crate) struct Nodes<'a> {
    cache: Cache<NodeSource<'a>>,
}

impl<'a> Nodes<'a> {
    /// Of a tree with these sums, within so many bytes.
    pub fn new(tree: &'a StoredTree, sums: &'a Sums, ram_bytes: usize) -> Self {
        let source = NodeSource { tree, sums, splits: Vec::new(), counts: Vec::new(), first_wedges: Vec::new() };
        Nodes { cache: Cache::new(source, ram_bytes) }
    }

    /// Whether so many of them can be looked up again and again without being read again.
    pub fn holds(&self, nodes: usize) -> bool {
        self.cache.holds(nodes)
    }

    /// The split born at a leaf.
    pub fn split(&mut self, split: u32) -> Result<Split, StorageError> {
        Ok(self.cache.get(split)?.split)
    }

    /// The subtrees below a split that split further, the kept one first.
    ///
    /// The tree comes from our own build, but what follows would run in circles or out of an array on a wrong one: so a
    /// split that does not divide its leaves is refused, and so is one that is not among them.
    pub fn children(&mut self, subtree: Subtree) -> Result<[Option<Subtree>; 2], BlockingError> {
        let Subtree { split, start, end, .. } = subtree;
        check_place(subtree)?;
        let Split { kept, born, .. } = self.split(split)?;
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

    fn words_before(&mut self, split: u32) -> Result<u64, StorageError> {
        Ok(self.cache.get(split)?.before.0)
    }

    /// Words of a page that a split takes.
    pub fn split_words(&mut self, split: u32) -> Result<usize, StorageError> {
        Ok((self.words_before(split + 1)? - self.words_before(split)?) as usize)
    }

    /// Words of pages that all splits of a subtree take: those born behind its first leaf.
    pub fn weight(&mut self, subtree: Subtree) -> Result<u64, StorageError> {
        Ok(self.words_before(subtree.end)? - self.words_before(subtree.start + 1)?)
    }

    /// The triangles of a split, by number.
    pub fn triangles(&mut self, split: u32) -> Result<std::ops::Range<u32>, StorageError> {
        Ok(self.cache.get(split)?.before.1..self.cache.get(split + 1)?.before.1)
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
            prop_assert!(cache.records.len() * 4 <= ram.max(2 * 1024 * 4));
        }
    }
}
