//! Writes a blocked tree as a model file.
//!
//! The sizes of all pages follow from their counts, so every offset is known before the first byte is written, and the
//! file is written from front to back. It appears under its name whole or not at all. Its bytes are a function of the
//! tree and the options: no time, path or thread has a part in them.
//!
//! Memory besides the tree and its blocking ([`crate::blocking`]): 8 bytes for each page, up to 8 for each root of the
//! pages of one level, 76 for each tree, and one page.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

use storage::{AtomicFile, Disk};
use vdt::tree::{NO_SPLIT, Split, Tree};

use super::{self as blocking, Block, Blocks};
use crate::header::{HEADER_BYTES, Header, LARGEST_SLOT_BYTES, ModelRoot, ROOT_PAGE_WORDS, ROOT_WORDS};
use crate::page::{ChildEntry, NONE_32, PageLocation, PageParts, Record, Target, encoded, encoded_length};

use crate::write::{ModelOptions, ModelSummary, WriteError};

/// Writes `tree` to the model file `path`, replacing what was there.
pub fn write_model(
    disk: Arc<dyn Disk>,
    path: &Path,
    tree: &Tree,
    options: &ModelOptions,
) -> Result<ModelSummary, WriteError> {
    let blocks = blocking::block(tree, options.blocking)?;
    let layout = Layout::of(tree, &blocks)?;
    let header = header(tree, &blocks, &layout, options);
    let mut file = AtomicFile::create(disk, path)?;
    file.append(&header.to_bytes())?;
    file.append(&tables(tree, &blocks, &layout))?;
    let mut pages = Pages { tree, blocks: &blocks, layout: &layout, waiting: VecDeque::new() };
    for (number, page) in (0..).zip(&blocks.pages) {
        file.append(&encoded(&pages.parts(number, page)))?;
    }
    file.commit()?;

    let decoded = blocks.pages.iter().map(|page| page.counts().decoded_bytes() as u64).sum();
    Ok(ModelSummary::of(&header, decoded))
}

/// Where everything will lie.
struct Layout {
    pages_offset: u64,
    /// Byte offset of each page, and the length of the file.
    offsets: Vec<u64>,
    slot_bytes: u32,
}

impl Layout {
    fn of(tree: &Tree, blocks: &Blocks) -> Result<Self, WriteError> {
        let tables = tree.roots.len() * ROOT_WORDS * 4 + blocks.root_pages as usize * ROOT_PAGE_WORDS * 4 + 4;
        let pages_offset = (HEADER_BYTES + tables) as u64;
        let mut offsets = Vec::with_capacity(blocks.pages.len() + 1);
        let (mut offset, mut slot_bytes) = (pages_offset, 0);
        for (page, block) in (0..).zip(&blocks.pages) {
            let bytes = block.counts().decoded_bytes() as u64;
            slot_bytes = match u32::try_from(bytes) {
                Ok(bytes) if bytes <= LARGEST_SLOT_BYTES => bytes.max(slot_bytes),
                _ => {
                    let (splits, triangles) = (block.record_count, block.triangle_count);
                    return Err(WriteError::PageTooLarge { leaf: page, bytes, splits, triangles });
                }
            };
            offsets.push(offset);
            offset += encoded_length(block.counts()) as u64;
        }
        offsets.push(offset);
        Ok(Layout { pages_offset, offsets, slot_bytes })
    }

    fn location(&self, number: u32) -> PageLocation {
        let offset = self.offsets[number as usize];
        PageLocation { number, offset, length: (self.offsets[number as usize + 1] - offset) as u32 }
    }

    fn file_length(&self) -> u64 {
        self.offsets.last().copied().unwrap_or(self.pages_offset)
    }
}

fn header(tree: &Tree, blocks: &Blocks, layout: &Layout, options: &ModelOptions) -> Header {
    let page_count = blocks.pages.len() as u32;
    let mut minimum = tree.positions.first().copied().unwrap_or_default();
    let mut maximum = minimum;
    for position in &tree.positions {
        for axis in 0..3 {
            // Not `f32::min`, which may take either of 0.0 and -0.0.
            if position[axis] < minimum[axis] {
                minimum[axis] = position[axis];
            }
            if position[axis] > maximum[axis] {
                maximum[axis] = position[axis];
            }
        }
    }
    let switches = tree.roots.iter().map(|root| tree.splits[root.split as usize].switch);
    Header {
        leaf_count: tree.leaf_count() as u32,
        triangle_count: tree.triangles.corners.len() as u32,
        split_count: blocks.order.len() as u32,
        root_count: tree.roots.len() as u32,
        page_count,
        root_page_count: blocks.root_pages,
        slot_bytes: layout.slot_bytes,
        largest_page_bytes: if page_count == 0 { 0 } else { layout.slot_bytes + 4 },
        page_levels: blocks.pages.last().map_or(0, |page| page.level),
        origin: tree.origin,
        minimum,
        maximum,
        largest_switch: switches.fold(0.0, f32::max),
        metric: options.metric,
        strategy: options.strategy,
        error_bound: options.error_bound,
        blocking: options.blocking,
        roots_offset: HEADER_BYTES as u64,
        pages_offset: layout.pages_offset,
        file_length: layout.file_length(),
    }
}

/// The root table and the root page table, with their checksum.
fn tables(tree: &Tree, blocks: &Blocks, layout: &Layout) -> Vec<u8> {
    // The page and record of each tree's root: trees begin in any page.
    let mut places = vec![(0, 0); tree.roots.len()];
    for (number, page) in (0..).zip(&blocks.pages) {
        for (record, split) in (0..).zip(blocks.page_roots(page)) {
            if let Some(index) = blocking::tree_of_root(tree, *split) {
                places[index] = (number, record);
            }
        }
    }
    let mut words = Vec::with_capacity(tree.roots.len() * ROOT_WORDS + blocks.root_pages as usize * ROOT_PAGE_WORDS);
    for (root, (page, record)) in tree.roots.iter().zip(places) {
        let split = &tree.splits[root.split as usize];
        let root = ModelRoot {
            start: root.start,
            end: root.end,
            position: tree.positions[root.start as usize],
            id: split.id,
            switch: split.switch,
            radius: split.radius,
            cone: split.cone,
            record,
            page: layout.location(page),
        };
        words.extend(root.to_words());
    }
    for number in 0..blocks.root_pages {
        let PageLocation { number, offset, length } = layout.location(number);
        words.extend([number, offset as u32, (offset >> 32) as u32, length]);
    }
    let mut bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    let checksum = crc32fast::hash(&bytes);
    bytes.extend(checksum.to_le_bytes());
    bytes
}

/// Puts the parts of the pages together, in the order of their numbers.
struct Pages<'a> {
    tree: &'a Tree,
    blocks: &'a Blocks,
    layout: &'a Layout,
    /// The leaves under the roots of the pages to come, for those roots that have a parent, in the order of the pages.
    waiting: VecDeque<(u32, u32)>,
}

impl Pages<'_> {
    fn parts(&mut self, number: u32, page: &Block) -> PageParts {
        let splits = self.blocks.records(page);
        let page_roots = self.blocks.page_roots(page);
        // The leaves under each record. Breadth-first, so the next record that is not a root belongs to the next child
        // that is in this page.
        let mut intervals: Vec<(u32, u32)> = page_roots.iter().map(|root| self.root_interval(*root)).collect();
        let leaf_interval =
            (intervals.first().map_or(0, |interval| interval.0), intervals.last().map_or(0, |interval| interval.1));
        let mut frontier = Vec::new();
        let mut records = Vec::with_capacity(splits.len());
        for (index, &split) in splits.iter().enumerate() {
            let node = &self.tree.splits[split as usize];
            let (start, end) = intervals[index];
            let mut entry = |child: u32, interval| {
                if child == NO_SPLIT {
                    return None;
                }
                let target = if splits.get(intervals.len()) == Some(&child) {
                    intervals.push(interval);
                    Target::SamePage { record: intervals.len() as u16 - 1 }
                } else {
                    frontier.push(interval);
                    self.in_child_page(page, child)
                };
                let Split { id, switch, radius, cone, .. } = self.tree.splits[child as usize];
                Some(ChildEntry { id, switch, radius, cone, target })
            };
            let (kept, born) = (entry(node.kept, (start, split)), entry(node.born, (split, end)));
            let position = self.tree.positions[split as usize];
            let triangles = self.tree.triangles.of(split).to_vec();
            records.push((Record { born_leaf: split, position, kept, born }, triangles));
        }
        frontier.sort_unstable();
        self.waiting.extend(frontier);
        let children = page.first_child..page.first_child + page.child_count;
        let has_children = !children.is_empty();
        PageParts {
            number,
            parent: (page.parent != NONE_32).then_some(page.parent),
            root_count: page.root_count as u16,
            leaf_interval,
            first_child: page.first_child,
            first_child_offset: if has_children { self.layout.location(page.first_child).offset } else { 0 },
            child_lengths: children.map(|child| self.layout.location(child).length).collect(),
            records,
        }
    }

    /// The leaves under a root of the page that is being put together.
    fn root_interval(&mut self, split: u32) -> (u32, u32) {
        match blocking::tree_of_root(self.tree, split) {
            Some(index) => (self.tree.roots[index].start, self.tree.roots[index].end),
            // Each entry that led into a child page has put an interval there.
            None => self.waiting.pop_front().unwrap_or_default(),
        }
    }

    /// Where `split`, at a root of one of the child pages of `page`, is recorded.
    fn in_child_page(&self, page: &Block, split: u32) -> Target {
        // The child pages' roots ascend, within a page and from page to page.
        let children = self.blocks.children(page);
        let first_root = |child: &Block| self.blocks.order[child.first_record as usize];
        let child = children.partition_point(|child| first_root(child) <= split).saturating_sub(1);
        let record = self.blocks.page_roots(&children[child]).partition_point(|root| *root < split);
        Target::ChildPage { child: child as u16, record: record as u16 }
    }
}
