//! The second way through the page tree: every page is encoded, and written at its place in the file.
//!
//! Within a level pages are met in the order in which they lie in the file. So one reader for each level tells of each
//! page its number and place, and another one those of its child pages.
//!
//! Memory: the caches, two readers for each level, one page. I/O: see `leaf_order`; the sizes are read twice.

use std::borrow::Cow;
use std::sync::{Mutex, PoisonError};

use storage::{AtomicFile, Spool, SpoolReader, StorageError};
use vdt::tree::{Split, StoredTree};

use super::descent::{self, Visitor};
use super::layout::{Layout, PageSize, Start};
use super::{WriteError, WriteResources, check_values, with_checksum};
use crate::blocking::{BlockingError, Filled, Filler};
use crate::leaf_order::{Cache, Nodes, Subtree};
use crate::page::{ENTRY_WORDS, HEADER_WORDS, NONE_16, RECORD_WORDS, TRIANGLE_WORDS, pack};

/// Bytes of a reader's buffer.
const BUFFER: usize = 8 << 10;

/// The box of some positions.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub minimum: [f32; 3],
    pub maximum: [f32; 3],
}

impl Bounds {
    pub const NONE: Bounds = Bounds { minimum: [f32::INFINITY; 3], maximum: [f32::NEG_INFINITY; 3] };

    fn extend(&mut self, position: [f32; 3]) {
        self.add(&Bounds { minimum: position, maximum: position });
    }

    fn add(&mut self, other: &Bounds) {
        for axis in 0..3 {
            // Not `f32::min`, which may take either of 0.0 and -0.0.
            if other.minimum[axis] < self.minimum[axis] {
                self.minimum[axis] = other.minimum[axis];
            }
            if other.maximum[axis] > self.maximum[axis] {
                self.maximum[axis] = other.maximum[axis];
            }
        }
    }
}

/// The pages of a level, from left to right.
#[derive(Debug)]
struct LevelReader<'a> {
    sizes: SpoolReader<'a, PageSize>,
    next: Start,
}

impl<'a> LevelReader<'a> {
    fn new(sizes: &'a Spool<PageSize>, start: Start) -> Self {
        LevelReader { sizes: sizes.reader_of(start.number.into(), sizes.len(), BUFFER), next: start }
    }

    /// The next page: its number and place, and its size.
    fn next(&mut self) -> Result<Option<(Start, PageSize)>, StorageError> {
        let Some(size) = self.sizes.next()? else { return Ok(None) };
        let start = self.next;
        self.next = Start { number: start.number + 1, offset: start.offset + u64::from(size.encoded_bytes()) };
        Ok(Some((start, size)))
    }
}

/// Encodes pages.
struct Encoder<'a> {
    tree: &'a StoredTree,
    layout: &'a Layout,
    file: &'a Mutex<AtomicFile>,
    nodes: Nodes<'a>,
    positions: Cache<&'a Spool<[f32; 3]>>,
    triangles: Cache<&'a Spool<[u32; 3]>>,
    /// For each level, who tells of its pages, and who tells of them as children.
    pages: Vec<Option<LevelReader<'a>>>,
    children: Vec<Option<LevelReader<'a>>>,
    /// The page at hand: its entries and triangles follow its records.
    page: Vec<u32>,
    entries: Vec<u32>,
    corners: Vec<u32>,
    bounds: Bounds,
    /// Splits that were written.
    splits: u64,
}

/// Writes the pages of a tree into a file that is as long as it will be. `progress` is told how many splits more are
/// written. Returns the box of all positions.
pub(super) fn write_pages(
    file: &Mutex<AtomicFile>,
    tree: &StoredTree,
    layout: &Layout,
    filler: Filler,
    root_groups: Vec<Vec<Subtree>>,
    resources: &WriteResources,
    progress: &(impl Fn(u64) + Sync),
) -> Result<Bounds, WriteError> {
    let mut encoders: Vec<Encoder<'_>> = (0..resources.threads.max(1))
        .map(|_| Encoder {
            tree,
            layout,
            file,
            nodes: Nodes::new(tree, &layout.sums, resources.thread_share(5)),
            positions: Cache::new(&tree.positions, resources.thread_share(3)),
            triangles: Cache::new(&tree.triangles, resources.thread_share(4)),
            pages: Vec::new(),
            children: Vec::new(),
            page: Vec::new(),
            entries: Vec::new(),
            corners: Vec::new(),
            bounds: Bounds::NONE,
            splits: 0,
        })
        .collect();
    let first = &mut encoders[0];
    first.start_at(layout.levels_start.iter().map(|start| Some(*start)));
    let jobs = descent::first_levels(first, filler, root_groups)?;
    let mut bounds = std::mem::replace(&mut first.bounds, Bounds::NONE);
    let begin = |encoder: &mut Encoder<'_>, number: usize| {
        encoder.start_at(layout.jobs_start.iter().map(|jobs| jobs[number]));
    };
    let end = |encoder: &mut Encoder<'_>| std::mem::replace(&mut encoder.bounds, Bounds::NONE);
    let boxes = descent::do_jobs(&mut encoders, filler, jobs, progress, begin, end)?;
    boxes.iter().for_each(|part| bounds.add(part));
    Ok(bounds)
}

impl<'a> Visitor<'a> for Encoder<'a> {
    fn nodes(&mut self) -> &mut Nodes<'a> {
        &mut self.nodes
    }

    fn splits(&self) -> u64 {
        self.splits
    }

    fn fill(&mut self, filler: Filler, level: u32, subtrees: Vec<Subtree>) -> Result<Filled, BlockingError> {
        match self.layout.large.get(&(level, subtrees[0].start)) {
            Some(page) => Ok(page.clone()),
            None => filler.fill(&mut self.nodes, subtrees),
        }
    }

    fn page(
        &mut self,
        level: u32,
        parent: u32,
        page: &Filled,
        children: &[Cow<'_, [Subtree]>],
    ) -> Result<u32, WriteError> {
        let Some((place, size)) = next_of(&mut self.pages, level)? else { return Err(unplaced(page)) };
        self.page.clear();
        self.page.resize(HEADER_WORDS, 0);
        self.page[1] = parent;
        for index in 0..children.len() {
            let Some((child, size)) = next_of(&mut self.children, level + 1)? else { return Err(unplaced(page)) };
            if index == 0 {
                self.page[5] = child.number;
                self.page[6] = child.offset as u32;
                self.page[7] = (child.offset >> 32) as u32;
            }
            self.page.push(size.encoded_bytes());
        }
        self.encode(page.root_count, &page.records, children)?;
        self.page[0] = place.number;
        if self.page.len() != size.words as usize {
            return Err(unplaced(page));
        }
        let bytes = with_checksum(&self.page);
        self.file.lock().unwrap_or_else(PoisonError::into_inner).write_at(place.offset, &bytes)?;
        Ok(place.number)
    }
}

/// The next page of a level.
fn next_of(readers: &mut [Option<LevelReader<'_>>], level: u32) -> Result<Option<(Start, PageSize)>, StorageError> {
    match readers.get_mut(level as usize - 1) {
        Some(Some(reader)) => reader.next(),
        _ => Ok(None),
    }
}

/// Both ways through the tree are the same, unless the tree has changed in between.
fn unplaced(page: &Filled) -> WriteError {
    let problem = format!("the page of split {} is not as large as it was at first", page.records[0].split);
    BlockingError::Tree { problem }.into()
}

impl<'a> Encoder<'a> {
    /// Goes on with these pages of each level.
    fn start_at(&mut self, starts: impl Iterator<Item = Option<Start>> + Clone) {
        let sizes = &self.layout.sizes;
        let readers = || starts.clone().map(|start| start.map(|start| LevelReader::new(sizes, start))).collect();
        (self.pages, self.children) = (readers(), readers());
    }

    /// Encodes the page of these records, the first of which are its roots, behind its header and its children.
    fn encode(&mut self, roots: usize, records: &[Subtree], children: &[Cow<'_, [Subtree]>]) -> Result<(), WriteError> {
        let interval = (records[0].start, records[roots - 1].end);
        let child_words = self.page.len() - HEADER_WORDS;
        self.entries.clear();
        self.corners.clear();
        // Breadth-first, so the next record that is not a root belongs to the next child that is in this page.
        let mut next_inside = roots;
        for subtree in records {
            if subtree.is_tree {
                let first_leaf = self.position(subtree.start)?;
                self.bounds.extend(first_leaf);
            }
            let position = self.position(subtree.split)?;
            self.bounds.extend(position);
            let first_triangle = (self.corners.len() / TRIANGLE_WORDS) as u32;
            let mut places = [NONE_16; 2];
            for (place, child) in places.iter_mut().zip(self.nodes.children(*subtree)?) {
                let Some(child) = child else { continue };
                *place = (self.entries.len() / ENTRY_WORDS) as u16;
                let target = if records.get(next_inside).is_some_and(|record| record.split == child.split) {
                    next_inside += 1;
                    pack(next_inside as u16 - 1, NONE_16)
                } else {
                    in_child_page(children, child.split)
                };
                let Split { id, switch, radius, cone, .. } = self.nodes.split(child.split)?;
                check_values(child.split, switch, radius)?;
                self.entries.extend([id, switch.to_bits(), radius.to_bits(), cone.to_word(), target]);
            }
            for triangle in self.nodes.triangles(subtree.split)? {
                let corners = self.triangles.get(triangle)?;
                if let Some(wrong) = corners.iter().find(|leaf| u64::from(**leaf) >= self.tree.leaf_count()) {
                    let problem = format!("a triangle with the corner {wrong}, of {} leaves", self.tree.leaf_count());
                    return Err(BlockingError::Tree { problem }.into());
                }
                self.corners.extend(corners);
            }
            self.page.push(subtree.split);
            self.page.extend(position.map(f32::to_bits));
            self.page.push(pack(places[0], places[1]));
            self.page.push(first_triangle);
        }
        debug_assert_eq!(self.page.len() - HEADER_WORDS - child_words, records.len() * RECORD_WORDS);
        self.page[2] = pack(records.len() as u16, children.len() as u16);
        self.page[3] = pack(roots as u16, (self.entries.len() / ENTRY_WORDS) as u16);
        self.page[4] = (self.corners.len() / TRIANGLE_WORDS) as u32;
        (self.page[8], self.page[9]) = interval;
        self.page.extend(&self.entries);
        self.page.extend(&self.corners);
        self.splits += records.len() as u64;
        Ok(())
    }

    /// The position of a leaf.
    fn position(&mut self, leaf: u32) -> Result<[f32; 3], WriteError> {
        let position = self.positions.get(leaf)?;
        if position.iter().all(|value| value.is_finite()) {
            return Ok(position);
        }
        Err(BlockingError::Tree { problem: format!("leaf {leaf}: a coordinate is not finite") }.into())
    }
}

/// Where `split`, at a root of one of the child pages, is recorded, as an entry has it.
fn in_child_page(children: &[Cow<'_, [Subtree]>], split: u32) -> u32 {
    // The child pages' roots ascend, within a page and from page to page.
    let begins_before = |roots: &Cow<'_, [Subtree]>| roots.first().is_some_and(|root| root.split <= split);
    let child = children.partition_point(begins_before).saturating_sub(1);
    let record = children[child].partition_point(|root| root.split < split);
    pack(record as u16, child as u16)
}
