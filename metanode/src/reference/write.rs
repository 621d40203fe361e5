//! What the decoded pages of a blocked tree must hold, and what a model file says of them.
//!
//! Slow and obvious: every page is put together from the whole tree in memory. Bytes and places in the file are not its
//! business: those follow from the coded pages.
//!
//! Memory: the tree once more.

use std::collections::{BTreeSet, VecDeque};

use vdt::tree::{NO_SPLIT, Normal, Split, Tree};

use super::{self as blocking, Block, Blocks};
use crate::blocking::BlockingError;
use crate::header::Blocking;
use crate::model::Model;
use crate::page::{ChildEntry, NONE_32, Page, PageLocation, Record, Target};
use crate::testing::is_cone_of;
use crate::write::ModelSummary;

/// What a page must hold once it is decoded.
#[derive(Debug)]
pub struct ExpectedPage {
    /// Its counts, its parent and its children by number.
    pub block: Block,
    /// The leaves under its roots.
    pub leaf_interval: (u32, u32),
    /// In order; the radii and cones of the entries are those of the tree.
    pub records: Vec<ExpectedRecord>,
}

/// A record that a page must hold.
#[derive(Debug)]
pub struct ExpectedRecord {
    /// The split.
    pub record: Record,
    /// Its triangles.
    pub triangles: Vec<[u32; 3]>,
    /// The normal where its node stands, and whether the surface there is inward.
    pub normal: Normal,
    pub is_inward: bool,
}

/// What a model must hold.
#[derive(Debug)]
pub struct Expected {
    blocks: Blocks,
    pages: Vec<ExpectedPage>,
    /// The page and record of each tree's root: trees begin in any page.
    places: Vec<(u32, u16)>,
    /// The pages, but for root pages, on the way down to those.
    ways: BTreeSet<u32>,
}

/// What a model of `tree` must hold, blocked as asked.
pub fn expected(tree: &Tree, blocking: Blocking) -> Result<Expected, BlockingError> {
    let blocks = blocking::block(tree, blocking)?;
    let mut places = vec![(0, 0); tree.roots.len()];
    let mut ways = BTreeSet::new();
    for (number, page) in (0..).zip(&blocks.pages) {
        for (record, split) in (0..).zip(blocks.page_roots(page)) {
            if let Some(index) = blocking::tree_of_root(tree, *split) {
                places[index] = (number, record);
                let mut above = number;
                while above >= blocks.root_pages {
                    ways.insert(above);
                    above = blocks.pages[above as usize].parent;
                }
            }
        }
    }
    let mut pages = Pages { tree, blocks: &blocks, waiting: VecDeque::new() };
    let pages = blocks.pages.iter().map(|page| pages.expected(page)).collect();
    Ok(Expected { blocks, pages, places, ways })
}

impl Expected {
    /// Whether `model`, with these decoded pages, is what it must be; what is not.
    pub fn compare(&self, model: &Model, pages: &[(PageLocation, Page)], summary: ModelSummary) -> Result<(), String> {
        let same = |what: &str, one: &dyn std::fmt::Debug, other: &dyn std::fmt::Debug| {
            let (one, other) = (format!("{one:?}"), format!("{other:?}"));
            if one == other { Ok(()) } else { Err(format!("{what}: {one} for {other}")) }
        };
        let header = model.header();
        let blocks = &self.blocks;
        let slot_bytes = blocks.pages.iter().map(|page| page.counts().decoded_bytes()).max().unwrap_or(0);
        let decoded = blocks.pages.iter().map(|page| page.counts().decoded_bytes() as u64).sum();
        let levels = blocks.pages.iter().map(|page| page.level).max().unwrap_or(0);
        same("pages", &header.page_count, &blocks.pages.len())?;
        same("root pages", &header.root_page_count, &blocks.root_pages)?;
        same("levels", &header.page_levels, &levels)?;
        same("slot", &header.slot_bytes, &slot_bytes)?;
        same("summary", &summary, &ModelSummary::of(header, decoded))?;
        let largest = pages.iter().map(|(location, _)| location.length).max().unwrap_or(0);
        same("largest page", &header.largest_page_bytes, &largest)?;
        let places: Vec<(u32, u16)> = model.roots().iter().map(|root| (root.page.number, root.record)).collect();
        same("places of roots", &places, &self.places)?;
        let ways: Vec<(u32, u32)> = model.ways().iter().map(|way| (way.page.number, way.parent)).collect();
        let due: Vec<(u32, u32)> =
            self.ways.iter().map(|number| (*number, blocks.pages[*number as usize].parent)).collect();
        same("ways", &ways, &due)?;
        let mut offset = header.pages_offset;
        for (number, (location, page)) in pages.iter().enumerate() {
            same("offset", &location.offset, &offset)?;
            offset += u64::from(location.length);
            self.pages[number].compare(page).map_err(|problem| format!("page {number}: {problem}"))?;
        }
        same("end", &header.file_length, &offset)
    }
}

impl ExpectedPage {
    fn compare(&self, page: &Page) -> Result<(), String> {
        let block = &self.block;
        if page.counts() != block.counts() {
            return Err(format!("{:?} for {:?}", page.counts(), block.counts()));
        }
        let parent = (block.parent != NONE_32).then_some(block.parent);
        let first_child = page.children().next().map_or(0, |child| child.number);
        let found = (page.parent(), page.root_count(), page.leaf_interval(), first_child);
        let due = (parent, block.root_count as usize, self.leaf_interval, block.first_child);
        if found != due {
            return Err(format!("{found:?} for {due:?}"));
        }
        for (index, expected) in (0..).zip(&self.records) {
            let Some(found) = page.record(index) else { return Err(format!("no record {index}")) };
            let due = &expected.record;
            let normals = [expected.normal, due.normal];
            for ((entry, expected_entry), normal) in
                [(found.kept, due.kept), (found.born, due.born)].into_iter().zip(normals)
            {
                let is_there = match (entry, expected_entry) {
                    (None, None) => true,
                    (Some(found), Some(due)) => {
                        let plain = ChildEntry { radius: due.radius, cone: due.cone, ..found };
                        let has_cone = is_cone_of(found.cone, due.cone, normal, expected.is_inward);
                        plain == due && found.radius >= due.radius && has_cone
                    }
                    _ => false,
                };
                if !is_there {
                    return Err(format!("record {index}: {entry:?} for {expected_entry:?}"));
                }
            }
            let plain = Record { kept: due.kept, born: due.born, ..found };
            let triangles: Vec<[u32; 3]> = page.triangles(index).collect();
            if plain != *due || triangles != expected.triangles {
                return Err(format!("record {index}: {plain:?} with {triangles:?} for {expected:?}"));
            }
        }
        Ok(())
    }
}

/// Puts the pages together, in the order of their numbers.
struct Pages<'a> {
    tree: &'a Tree,
    blocks: &'a Blocks,
    /// The leaves under the roots of the pages to come, for those roots that have a parent, in the order of the pages.
    waiting: VecDeque<(u32, u32)>,
}

impl Pages<'_> {
    fn expected(&mut self, page: &Block) -> ExpectedPage {
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
            let tree = self.tree.roots.partition_point(|root| root.end <= start);
            let root = &self.tree.roots[tree];
            let at_start = if start == root.start { root.normal } else { self.tree.splits[start as usize].normal };
            records.push(ExpectedRecord {
                record: Record { born_leaf: split, position, normal: node.normal, kept, born },
                triangles: self.tree.triangles.of(split).to_vec(),
                normal: at_start,
                is_inward: root.is_inward,
            });
        }
        frontier.sort_unstable();
        self.waiting.extend(frontier);
        ExpectedPage { block: *page, leaf_interval, records }
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
