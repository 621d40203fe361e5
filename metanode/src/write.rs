//! Writes a blocked tree as a model file, whatever its size.
//!
//! The pages are filled and encoded depth-first over the page tree, so that what they need of the tree moves through the
//! leaves from left to right. They are to lie in the file breadth-first; within a level of the page tree both orders are
//! the same. So the encoded pages wait in the scratch, their places are sorted by level, and in that order they are given
//! their numbers, their places in the file and those of their children, and written from front to back. The file appears
//! under its name whole or not at all. Its bytes are a function of the tree and the options: no memory, time, path or
//! thread has a part in them.
//!
//! Memory: what is allowed, for the caches of `leaf_order` and buffers; and on top, for each tree, 100 bytes,
//! for each page on the way from the root down its splits, and one page. I/O: see `leaf_order`; each page is
//! written and read once in the scratch before it is written to the file.

use std::path::Path;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use storage::{AtomicFile, ByteSize, Disk, Scratch, SortRecord, Sorter, Spool, SpoolWriter, StorageError};
use thiserror::Error;
use vdt::tree::{Split, StoredTree};

use crate::blocking::{self, BlockingError, Filled, Filler};
use crate::header::{
    Blocking, HEADER_BYTES, Header, LARGEST_SLOT_BYTES, Metric, ModelRoot, ROOT_PAGE_WORDS, ROOT_WORDS, Strategy,
};
use crate::leaf_order::{Cache, Nodes, Outline, Subtree, check_place, outline};
use crate::page::{
    CHILD_PAGE_WORDS, ENTRY_WORDS, HEADER_WORDS, NONE_16, NONE_32, PageLocation, RECORD_WORDS, TRIANGLE_WORDS, pack,
};

/// How a model is to be written, and what it says of its origin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ModelOptions {
    /// How the tree is cut into pages.
    pub blocking: Blocking,
    /// The metric that gave the switch values.
    pub metric: Metric,
    /// How the collapses were ordered.
    pub strategy: Strategy,
}

/// Why a model was not written. No file is left, or the one that was there before.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The disk failed or is full.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The tree cannot be blocked as asked.
    #[error(transparent)]
    Blocking(#[from] BlockingError),
    /// A page would be larger than any reader accepts.
    #[error(
        "a meta-node would take {bytes} bytes decoded, more than the {LARGEST_SLOT_BYTES} that can be: \
         its {splits} splits, the first of which bears leaf {leaf}, have {triangles} triangles"
    )]
    PageTooLarge {
        /// The leaf born by its first split.
        leaf: u32,
        /// Its size in bytes, decoded.
        bytes: u64,
        /// Its splits.
        splits: u32,
        /// Their born triangles.
        triangles: u32,
    },
}

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelSummary {
    /// Meta-nodes.
    pub pages: u32,
    /// Meta-nodes without a parent.
    pub root_pages: u32,
    /// Levels of the meta-node tree.
    pub page_levels: u32,
    /// Bytes of the largest page, decoded.
    pub slot_bytes: u32,
    /// Bytes of the file.
    pub bytes: u64,
    /// Mean size of a decoded page, as a part of the slot: the one asked for with `forest`, the largest page with
    /// `levels`. 0 where there are no pages.
    pub fill: f64,
    /// The largest switch value: from this error on only roots are drawn.
    pub largest_switch: f32,
}

/// What the writing of a model may use.
#[derive(Debug, Clone)]
pub struct WriteResources {
    /// Where what does not fit in memory goes.
    pub scratch: Scratch,
    /// RAM for what grows with the tree.
    pub memory: ByteSize,
}

impl WriteResources {
    /// For a tree that is small beside the memory of the machine: everything in RAM.
    pub fn in_memory() -> Self {
        WriteResources { scratch: Scratch::in_memory(), memory: ByteSize(u64::MAX) }
    }

    /// So many sixteenths of the memory, in bytes.
    fn share(&self, sixteenths: u64) -> usize {
        usize::try_from(self.memory.0 / 16 * sixteenths).unwrap_or(usize::MAX)
    }
}

/// A page that waits in the scratch. Ordered by level, and within a level as it was filled: breadth-first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct WaitingPage {
    /// Its level in the page tree; root pages are on level 1.
    level: u32,
    /// How many pages were filled before it.
    sequence: u32,
    /// Where its words begin.
    first_word: u64,
    /// How many they are.
    words: u32,
    /// How many child pages it has.
    children: u32,
}

impl WaitingPage {
    fn encoded_bytes(&self) -> u32 {
        self.words * 4 + 4
    }
}

impl SortRecord for WaitingPage {
    fn prefix(&self) -> u64 {
        u64::from(self.level) << 32 | u64::from(self.sequence)
    }
}

/// Writes `tree` to the model file `path`, replacing what was there. `progress` is told the share that is done, 0 to 1.
pub fn write_model(
    disk: Arc<dyn Disk>,
    path: &Path,
    tree: &StoredTree,
    options: &ModelOptions,
    resources: &WriteResources,
    progress: &mut dyn FnMut(f64),
) -> Result<ModelSummary, WriteError> {
    blocking::check_parameters(options.blocking)?;
    check_arrays(tree)?;
    let Encoded { words, pages, places, minimum, maximum, totals } = encode(tree, options, resources, progress)?;
    let splits = tree.leaf_count() - tree.roots.len() as u64;
    if totals.splits != splits || totals.triangles != tree.triangles.len() {
        let problem = format!(
            "{} of {splits} splits and {} of {} triangles belong to one of its trees",
            totals.splits,
            totals.triangles,
            tree.triangles.len()
        );
        return Err(BlockingError::Tree { problem }.into());
    }

    let layout = Layout::of(tree, &pages, &places, resources)?;
    let page_count = pages.len() as u32;
    let switches = layout.roots.iter().map(|root| root.switch);
    let header = Header {
        leaf_count: tree.leaf_count() as u32,
        triangle_count: tree.triangles.len() as u32,
        split_count: splits as u32,
        root_count: tree.roots.len() as u32,
        page_count,
        root_page_count: layout.root_pages.len() as u32,
        slot_bytes: layout.slot_bytes,
        largest_page_bytes: if page_count == 0 { 0 } else { layout.slot_bytes + 4 },
        page_levels: layout.levels,
        origin: tree.origin,
        minimum,
        maximum,
        largest_switch: switches.fold(0.0, f32::max),
        metric: options.metric,
        strategy: options.strategy,
        blocking: options.blocking,
        roots_offset: HEADER_BYTES as u64,
        pages_offset: layout.pages_offset,
        file_length: layout.file_length,
    };
    let mut file = AtomicFile::create(disk, path)?;
    file.append(&header.to_bytes())?;
    file.append(&layout.tables())?;
    append_pages(&mut file, &words, &pages, &layout, resources, progress)?;
    file.commit()?;

    let slot_bytes = match options.blocking {
        Blocking::Forest { slot_bytes, .. } => slot_bytes,
        Blocking::Levels { .. } => header.slot_bytes,
    };
    let slots = f64::from(page_count) * f64::from(slot_bytes);
    Ok(ModelSummary {
        pages: header.page_count,
        root_pages: header.root_page_count,
        page_levels: header.page_levels,
        slot_bytes: header.slot_bytes,
        bytes: header.file_length,
        fill: if slots > 0.0 { (words.len() * 4) as f64 / slots } else { 0.0 },
        largest_switch: header.largest_switch,
    })
}

/// What everything else relies on.
fn check_arrays(tree: &StoredTree) -> Result<(), BlockingError> {
    let leaves = tree.leaf_count();
    let fail = |problem| Err(BlockingError::Tree { problem });
    if leaves >= u64::from(NONE_32) {
        return fail(format!("{leaves} leaves are more than 32 bits can number"));
    }
    if tree.triangles.len() > u64::from(u32::MAX) {
        return fail(format!("{} triangles are more than 32 bits can number", tree.triangles.len()));
    }
    if tree.splits.len() != leaves || tree.triangle_counts.len() != leaves {
        let (splits, counts) = (tree.splits.len(), tree.triangle_counts.len());
        return fail(format!("{leaves} leaves, but {splits} splits and {counts} triangle counts"));
    }
    if !tree.origin.iter().all(|value| value.is_finite()) {
        return fail("a coordinate of the origin is not finite".into());
    }
    let mut next_leaf = 0;
    for (index, root) in tree.roots.iter().enumerate() {
        if root.start != next_leaf || root.end <= root.start || u64::from(root.end) > leaves {
            return fail(format!("tree {index} has the leaves {}..{}, after leaf {next_leaf}", root.start, root.end));
        }
        next_leaf = root.end;
    }
    if u64::from(next_leaf) != leaves {
        return fail(format!("the trees end at leaf {next_leaf} of {leaves}"));
    }
    Ok(())
}

/// How much of a tree went into pages.
#[derive(Debug, Clone, Copy, Default)]
struct Totals {
    splits: u64,
    triangles: u64,
}

/// The encoded pages of a tree. What is known only when all are is still 0 in them.
struct Encoded {
    words: Spool<u32>,
    /// Breadth-first.
    pages: Spool<WaitingPage>,
    /// For each tree the page with its root, by its sequence, and the record there.
    places: Vec<(u32, u16)>,
    minimum: [f32; 3],
    maximum: [f32; 3],
    totals: Totals,
}

/// A page that was filled and is not yet encoded.
struct Pending {
    level: u32,
    filled: Filled,
}

fn encode(
    tree: &StoredTree,
    options: &ModelOptions,
    resources: &WriteResources,
    progress: &mut dyn FnMut(f64),
) -> Result<Encoded, WriteError> {
    let scratch = &resources.scratch;
    let outline = outline(tree, scratch, resources.share(2))?;
    let trees =
        tree.roots.iter().map(|root| Subtree { split: root.split, start: root.start, end: root.end, is_tree: true });
    let trees: Vec<Subtree> = trees.collect();
    trees.iter().try_for_each(|tree| check_place(*tree))?;
    let filler = Filler::new(options.blocking);
    let mut encoder = Encoder::new(tree, &outline, resources);
    let mut sorter = Sorter::new(scratch, "pages", resources.share(1), 1);
    let mut root_groups = filler.root_groups(trees).into_iter();
    let mut stack: Vec<Pending> = Vec::new();
    let (mut sequence, mut first_word) = (0, 0);
    loop {
        if stack.is_empty()
            && let Some(group) = root_groups.next()
        {
            stack.push(Pending { level: 1, filled: filler.fill(&mut encoder.nodes, group)? });
        }
        let Some(Pending { level, filled }) = stack.pop() else { break };
        // The child pages are filled first: where the splits of the page lead to depends on them.
        let Filled { root_count, records, groups } = filled;
        let first_child = stack.len();
        for group in groups {
            stack.push(Pending { level: level + 1, filled: filler.fill(&mut encoder.nodes, group)? });
        }
        let children = &stack[first_child..];
        encoder.page(root_count, &records, children, sequence)?;
        let words = encoder.words.len() - first_word;
        let page = WaitingPage { level, sequence, first_word, words: words as u32, children: children.len() as u32 };
        sorter.push(page)?;
        stack[first_child..].reverse();
        first_word += words;
        sequence += 1;
        progress(0.75 * encoder.totals.splits as f64 / tree.leaf_count() as f64);
    }
    let Encoder { words, places, mut minimum, mut maximum, totals, .. } = encoder;
    let mut sorted = sorter.finish()?;
    let mut pages = SpoolWriter::new(scratch, "pages", resources.share(1));
    while let Some(page) = sorted.next()? {
        pages.push(page)?;
    }
    if tree.roots.is_empty() {
        (minimum, maximum) = ([0.0; 3], [0.0; 3]);
    }
    Ok(Encoded { words: words.finish()?, pages: pages.finish()?, places, minimum, maximum, totals })
}

/// Encodes pages.
struct Encoder<'a> {
    tree: &'a StoredTree,
    nodes: Nodes<'a>,
    splits: Cache<'a, Split>,
    positions: Cache<'a, [f32; 3]>,
    triangles: Cache<'a, [u32; 3]>,
    words: SpoolWriter<u32>,
    /// The page at hand: its entries and triangles follow its records.
    page: Vec<u32>,
    entries: Vec<u32>,
    corners: Vec<u32>,
    places: Vec<(u32, u16)>,
    minimum: [f32; 3],
    maximum: [f32; 3],
    totals: Totals,
}

impl<'a> Encoder<'a> {
    fn new(tree: &'a StoredTree, outline: &'a Spool<Outline>, resources: &WriteResources) -> Self {
        Encoder {
            tree,
            nodes: Nodes::new(outline, resources.share(6)),
            splits: Cache::new(&tree.splits, resources.share(2)),
            positions: Cache::new(&tree.positions, resources.share(1)),
            triangles: Cache::new(&tree.triangles, resources.share(1)),
            words: SpoolWriter::new(&resources.scratch, "page-words", resources.share(2)),
            page: Vec::new(),
            entries: Vec::new(),
            corners: Vec::new(),
            places: vec![(0, 0); tree.roots.len()],
            minimum: [f32::INFINITY; 3],
            maximum: [f32::NEG_INFINITY; 3],
            totals: Totals::default(),
        }
    }

    /// The page of these records, the first of which are its roots.
    fn page(
        &mut self,
        roots: usize,
        records: &[Subtree],
        children: &[Pending],
        sequence: u32,
    ) -> Result<(), WriteError> {
        let interval = (records[0].start, records[roots - 1].end);
        self.page.clear();
        self.page.resize(HEADER_WORDS + children.len() * CHILD_PAGE_WORDS, 0);
        self.entries.clear();
        self.corners.clear();
        // Breadth-first, so the next record that is not a root belongs to the next child that is in this page.
        let mut next_inside = roots;
        for (index, subtree) in records.iter().enumerate() {
            if subtree.is_tree {
                let tree = self.tree.roots.partition_point(|root| root.start < subtree.start);
                self.places[tree] = (sequence, index as u16);
                let first_leaf = self.positions.get(subtree.start)?;
                self.extend_box(subtree.start, first_leaf)?;
            }
            let position = self.positions.get(subtree.split)?;
            self.extend_box(subtree.split, position)?;
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
                let Split { id, switch, radius, cone, .. } = self.splits.get(child.split)?;
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
        let triangles = self.corners.len() / TRIANGLE_WORDS;
        let bytes = (self.page.len() + self.entries.len() + self.corners.len()) as u64 * 4;
        if bytes > LARGEST_SLOT_BYTES.into() {
            let (splits, triangles) = (records.len() as u32, triangles as u32);
            return Err(WriteError::PageTooLarge { leaf: records[0].split, bytes, splits, triangles });
        }
        self.page[1] = NONE_32;
        self.page[2] = pack(records.len() as u16, children.len() as u16);
        self.page[3] = pack(roots as u16, (self.entries.len() / ENTRY_WORDS) as u16);
        self.page[4] = triangles as u32;
        (self.page[8], self.page[9]) = interval;
        debug_assert_eq!((self.page.len() - HEADER_WORDS - children.len()) % RECORD_WORDS, 0);
        self.words.extend(&self.page)?;
        self.words.extend(&self.entries)?;
        self.words.extend(&self.corners)?;
        self.totals.splits += records.len() as u64;
        self.totals.triangles += triangles as u64;
        Ok(())
    }

    fn extend_box(&mut self, leaf: u32, position: [f32; 3]) -> Result<(), BlockingError> {
        for axis in 0..3 {
            let value = position[axis];
            if !value.is_finite() {
                return Err(BlockingError::Tree { problem: format!("leaf {leaf}: a coordinate is not finite") });
            }
            // Not `f32::min`, which may take either of 0.0 and -0.0.
            if value < self.minimum[axis] {
                self.minimum[axis] = value;
            }
            if value > self.maximum[axis] {
                self.maximum[axis] = value;
            }
        }
        Ok(())
    }
}

/// The reader refuses numbers that are not finite.
fn check_values(split: u32, switch: f32, radius: f32) -> Result<(), BlockingError> {
    if switch > 0.0 && switch.is_finite() && radius >= 0.0 && radius.is_finite() {
        return Ok(());
    }
    Err(BlockingError::Tree { problem: format!("split {split}: switch value {switch}, radius {radius}") })
}

/// Where `split`, at a root of one of the child pages, is recorded, as an entry has it.
fn in_child_page(children: &[Pending], split: u32) -> u32 {
    // The child pages' roots ascend, within a page and from page to page.
    let begins_before = |page: &Pending| page.filled.roots().first().is_some_and(|root| root.split <= split);
    let child = children.partition_point(begins_before).saturating_sub(1);
    let record = children[child].filled.roots().partition_point(|root| root.split < split);
    pack(record as u16, child as u16)
}

/// Where everything will lie.
struct Layout {
    roots: Vec<ModelRoot>,
    root_pages: Vec<PageLocation>,
    pages_offset: u64,
    file_length: u64,
    slot_bytes: u32,
    levels: u32,
}

impl Layout {
    fn of(
        tree: &StoredTree,
        pages: &Spool<WaitingPage>,
        places: &[(u32, u16)],
        resources: &WriteResources,
    ) -> Result<Self, WriteError> {
        // The trees by the page in which they begin.
        let mut by_page: Vec<(u32, u32)> = (0..).zip(places).map(|(tree, (sequence, _))| (*sequence, tree)).collect();
        by_page.sort_unstable();
        let mut locations = vec![PageLocation { number: 0, offset: 0, length: 0 }; places.len()];
        let mut root_pages = Vec::new();
        let (mut number, mut offset, mut slot_bytes, mut levels) = (0, 0, 0, 0);
        let mut reader = pages.reader(resources.share(1));
        while let Some(page) = reader.next()? {
            let location = PageLocation { number, offset, length: page.encoded_bytes() };
            if page.level == 1 {
                root_pages.push(location);
            }
            let first = by_page.partition_point(|(sequence, _)| *sequence < page.sequence);
            for (_, tree) in by_page[first..].iter().take_while(|(sequence, _)| *sequence == page.sequence) {
                locations[*tree as usize] = location;
            }
            slot_bytes = slot_bytes.max(page.words * 4);
            levels = page.level;
            offset += u64::from(location.length);
            number += 1;
        }
        let tables = tree.roots.len() * ROOT_WORDS * 4 + root_pages.len() * ROOT_PAGE_WORDS * 4 + 4;
        let pages_offset = (HEADER_BYTES + tables) as u64;
        root_pages.iter_mut().chain(&mut locations).for_each(|location| location.offset += pages_offset);
        let mut roots = Vec::with_capacity(places.len());
        for ((root, (_, record)), page) in tree.roots.iter().zip(places).zip(locations) {
            let (mut split, mut position) = ([Split::VACANT], [[0.0; 3]]);
            tree.splits.read_at(root.split.into(), &mut split)?;
            tree.positions.read_at(root.start.into(), &mut position)?;
            let Split { id, switch, radius, cone, .. } = split[0];
            check_values(root.split, switch, radius)?;
            let (start, end) = (root.start, root.end);
            roots.push(ModelRoot {
                start,
                end,
                position: position[0],
                id,
                switch,
                radius,
                cone,
                record: *record,
                page,
            });
        }
        Ok(Layout { roots, root_pages, pages_offset, file_length: pages_offset + offset, slot_bytes, levels })
    }

    /// The root table and the root page table, with their checksum.
    fn tables(&self) -> Vec<u8> {
        let mut words: Vec<u32> = self.roots.iter().flat_map(ModelRoot::to_words).collect();
        for PageLocation { number, offset, length } in &self.root_pages {
            words.extend([*number, *offset as u32, (*offset >> 32) as u32, *length]);
        }
        with_checksum(&words)
    }
}

/// Words as they are in the file, and behind them their checksum.
fn with_checksum(words: &[u32]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(words.len() * 4 + 4);
    words.iter().for_each(|word| bytes.extend_from_slice(&word.to_le_bytes()));
    let checksum = crc32fast::hash(&bytes);
    bytes.extend(checksum.to_le_bytes());
    bytes
}

/// Writes the pages in their order, with their numbers and places.
fn append_pages(
    file: &mut AtomicFile,
    words: &Spool<u32>,
    pages: &Spool<WaitingPage>,
    layout: &Layout,
    resources: &WriteResources,
    progress: &mut dyn FnMut(f64),
) -> Result<(), WriteError> {
    // Three go through the pages in the same order: the page that is written, its first child, and its parent.
    let mut reader = pages.reader(resources.share(1));
    let mut children = pages.reader(resources.share(1));
    let mut parents = pages.reader(resources.share(1));
    let (mut child_number, mut child_offset) = (0, layout.pages_offset);
    for _ in &layout.root_pages {
        if let Some(root_page) = children.next()? {
            child_number += 1;
            child_offset += u64::from(root_page.encoded_bytes());
        }
    }
    // The page that has children still to come, and how many.
    let (mut parent, mut children_left, mut parent_next) = (0, 0, 0);
    let mut page_words = Vec::new();
    let mut number = 0;
    while let Some(page) = reader.next()? {
        page_words.resize(page.words as usize, 0);
        words.read_at(page.first_word, &mut page_words)?;
        page_words[0] = number;
        if number >= layout.root_pages.len() as u32 {
            while children_left == 0
                && let Some(next) = parents.next()?
            {
                (parent, children_left) = (parent_next, next.children);
                parent_next += 1;
            }
            children_left -= 1;
            page_words[1] = parent;
        }
        if page.children > 0 {
            page_words[5] = child_number;
            page_words[6] = child_offset as u32;
            page_words[7] = (child_offset >> 32) as u32;
            for index in 0..page.children as usize {
                if let Some(child) = children.next()? {
                    page_words[HEADER_WORDS + index] = child.encoded_bytes();
                    child_number += 1;
                    child_offset += u64::from(child.encoded_bytes());
                }
            }
        }
        file.append(&with_checksum(&page_words))?;
        number += 1;
        progress(0.75 + 0.25 * f64::from(number) / pages.len() as f64);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use storage::{FaultyDisk, MemoryDisk};
    use vdt::tree::{BornTriangles, NO_SPLIT, Tree};

    use super::*;
    use crate::model::Model;
    use crate::page::{Page, PageCounts};
    use crate::reference;
    use crate::testing::{
        Shape, TreePlan, blockings, model, model_bytes, open_bytes, options, plans, random_tree, read_back,
    };

    const SMALL: Blocking = Blocking::Forest { slot_bytes: 4096, fan_out: 3 };

    fn small_tree() -> Tree {
        random_tree(&TreePlan {
            seed: 1,
            leaves: 900,
            components: 3,
            triangles: 1800,
            shape: Shape::Random,
            hub: 0,
            reach: 60,
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        fn every_record_comes_back_as_it_was(plan in plans(2500), blocking in blockings()) {
            let tree = random_tree(&plan);
            let (bytes, summary) = model_bytes(&tree, blocking);
            prop_assert_eq!(bytes.len() as u64, summary.bytes);
            prop_assert_eq!(&bytes, &model_bytes(&tree, blocking).0);
            let model = open_bytes(bytes).unwrap();
            let back = read_back(&model);
            prop_assert!(tree == back);
        }

        #[test]
        fn pages_keep_to_the_slot(plan in plans(2500), blocking in blockings()) {
            let tree = random_tree(&plan);
            let blocks = reference::block(&tree, blocking).unwrap();
            let largest = blocks.pages.iter().map(|page| page.counts().decoded_bytes()).max().unwrap();
            prop_assert_eq!(largest, model(&tree, blocking).header().slot_bytes as usize);
            let mut seen = vec![false; tree.leaf_count()];
            for page in &blocks.pages {
                prop_assert!(page.root_count > 0 && page.record_count >= page.root_count);
                for split in blocks.records(page) {
                    prop_assert!(!std::mem::replace(&mut seen[*split as usize], true));
                }
                let PageCounts { records, children, .. } = page.counts();
                match blocking {
                    Blocking::Forest { slot_bytes, fan_out } => {
                        prop_assert!(records == 1 || page.counts().decoded_bytes() <= slot_bytes as usize);
                        prop_assert!(children <= fan_out as usize || plan.hub > 0);
                    }
                    Blocking::Levels { levels } => {
                        prop_assert!(records < 1 << levels && children <= 1 << levels && page.root_count == 1);
                    }
                }
            }
            prop_assert_eq!(seen.iter().filter(|seen| **seen).count(), tree.leaf_count() - tree.roots.len());
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(96))]

        /// Whatever the memory, the same bytes as those of the reference, and nothing is left in the scratch.
        #[test]
        fn the_model_is_that_of_the_reference(
            plan in plans(6000), blocking in blockings(), memory in prop::sample::select(vec![0_u64, 100_000, 1 << 40]),
        ) {
            let tree = random_tree(&plan);
            let expected = MemoryDisk::new();
            let path = Path::new("model.vdt");
            let summary =
                reference::write::write_model(Arc::new(expected.clone()), path, &tree, &options(blocking)).unwrap();
            let found = MemoryDisk::new();
            let (scratch, _) = Scratch::open(Arc::new(found.clone()), Path::new("scratch"), "test").unwrap();
            let resources = WriteResources { scratch, memory: ByteSize(memory) };
            let mut shares = Vec::new();
            let written = write_model(
                Arc::new(found.clone()),
                path,
                &StoredTree::from_tree(tree),
                &options(blocking),
                &resources,
                &mut |share| shares.push(share),
            );
            prop_assert_eq!(written.unwrap(), summary);
            prop_assert!(shares.is_sorted() && shares.last() == Some(&1.0));
            prop_assert!(found.bytes(path) == expected.bytes(path));
            drop(resources);
            prop_assert_eq!(found.paths(), [path]);
        }
    }

    #[test]
    fn a_tree_that_fits_has_one_page_and_a_large_one_has_full_pages() {
        let tree = small_tree();
        let (_, summary) = model_bytes(&tree, Blocking::Forest { slot_bytes: 1 << 20, fan_out: 8 });
        assert_eq!((summary.pages, summary.page_levels), (1, 1));
        let (_, summary) = model_bytes(&tree, Blocking::Forest { slot_bytes: 4096, fan_out: 8 });
        assert!(summary.fill > 0.7, "{summary:?}");
    }

    #[test]
    fn splits_with_very_many_triangles_have_pages_of_their_own() {
        let plan =
            TreePlan { seed: 9, leaves: 90, components: 1, triangles: 40_000, shape: Shape::Random, hub: 0, reach: 90 };
        let tree = random_tree(&plan);
        let (bytes, summary) = model_bytes(&tree, SMALL);
        assert!(summary.slot_bytes > 4 * 4096, "{summary:?}");
        let blocks = reference::block(&tree, SMALL).unwrap();
        let oversized = blocks.pages.iter().filter(|page| page.counts().decoded_bytes() > 4096);
        assert!(oversized.clone().count() > 5);
        assert!(oversized.clone().all(|page| page.record_count == 1));
        let model = open_bytes(bytes).unwrap();
        assert!(read_back(&model) == tree);
        crate::verify(&model, &mut |_| ()).unwrap();
    }

    #[test]
    fn an_empty_mesh_is_a_model_too() {
        for tree in [
            Tree::default(),
            Tree { triangles: BornTriangles { offsets: vec![0], corners: vec![] }, ..Tree::default() },
        ] {
            for blocking in [SMALL, Blocking::Levels { levels: 5 }] {
                let (bytes, summary) = model_bytes(&tree, blocking);
                assert_eq!((summary.pages, summary.page_levels, summary.fill), (0, 0, 0.0));
                let model = open_bytes(bytes).unwrap();
                assert_eq!((model.header().leaf_count, model.roots().len(), model.root_pages().len()), (0, 0, 0));
            }
        }
    }

    #[test]
    fn a_full_disk_leaves_no_file() {
        let tree = small_tree();
        let (bytes, _) = model_bytes(&tree, SMALL);
        for room in (0..bytes.len() as u64).step_by(4999) {
            let memory = MemoryDisk::new();
            let disk = FaultyDisk::new(Arc::new(memory.clone()));
            disk.full_after(room);
            let tree = StoredTree::from_tree(tree.clone());
            let (path, resources) = (Path::new("model.vdt"), WriteResources::in_memory());
            let error = write_model(Arc::new(disk), path, &tree, &options(SMALL), &resources, &mut |_| ()).unwrap_err();
            assert!(error.to_string().contains("model.vdt"), "{error}");
            assert!(memory.paths().is_empty());
        }
    }

    #[test]
    fn a_read_that_fails_names_the_file() {
        let (bytes, _) = model_bytes(&small_tree(), SMALL);
        let memory = MemoryDisk::new();
        memory.insert("model.vdt", bytes);
        let disk = FaultyDisk::new(Arc::new(memory));
        for reads in 0..2 {
            disk.fail_reads_after(reads);
            let error = Model::open(&disk, Path::new("model.vdt")).unwrap_err();
            assert!(error.to_string().contains("model.vdt"), "{error}");
        }
        disk.heal();
        let model = Model::open(&disk, Path::new("model.vdt")).unwrap();
        disk.fail_reads_after(0);
        let mut page: Page = model.empty_page();
        let error = model.read_page(model.root_pages()[0], &mut Vec::new(), &mut page).unwrap_err();
        assert!(error.to_string().contains("model.vdt"), "{error}");
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let refuse = |tree: &Tree, blocking| {
            let memory = MemoryDisk::new();
            let tree = StoredTree::from_tree(tree.clone());
            let (path, resources) = (Path::new("m"), WriteResources::in_memory());
            let disk = Arc::new(memory.clone());
            let result = write_model(disk, path, &tree, &options(blocking), &resources, &mut |_| ());
            assert!(memory.paths().is_empty());
            result.unwrap_err().to_string()
        };
        let tree = small_tree();
        assert!(refuse(&tree, Blocking::Forest { slot_bytes: 4095, fan_out: 8 }).contains("4095 bytes"));
        assert!(refuse(&tree, Blocking::Forest { slot_bytes: 4096, fan_out: 1 }).contains("up to 1 children"));
        assert!(refuse(&tree, Blocking::Levels { levels: 16 }).contains("16 levels"));
        let broken = |change: &dyn Fn(&mut Tree)| {
            let mut tree = tree.clone();
            change(&mut tree);
            refuse(&tree, SMALL)
        };
        let root = tree.roots[0];
        let top = root.split as usize;
        assert!(broken(&|tree| tree.splits[top].kept = root.split).contains("divide the leaves"));
        assert!(broken(&|tree| tree.splits[top].born = NO_SPLIT).contains("does not fit its children"));
        assert!(broken(&|tree| tree.splits[top].switch = 0.0).contains("switch value 0"));
        assert!(broken(&|tree| tree.roots[0].end -= 1).contains("tree 1 has the leaves"));
        assert!(broken(&|tree| tree.positions[5][1] = f32::NAN).contains("not finite"));
        assert!(broken(&|tree| tree.triangles.corners[0][0] = 900).contains("corner 900"));
        assert!(broken(&|tree| tree.triangles.offsets[root.start as usize] += 1).contains("triangle"));
    }
}
