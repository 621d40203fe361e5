//! The first way through the page tree: how large each page is, and so where everything will lie.
//!
//! What the pages of the file need of each other are numbers and places, and these follow from the sizes of all pages
//! before them. Pages are sorted by level, and within a level by their first leaf: breadth-first, as they lie in the file.
//!
//! Memory: the cache, the sorter; for each root page 16 bytes, for each tree 92, for each job and level 16. I/O: 24 bytes
//! for each page are sorted, 8 are kept.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use bytemuck::{Pod, Zeroable};
use storage::{SortRecord, Sorter, Spool, SpoolWriter};
use vdt::tree::{Split, StoredTree};

use super::descent::{self, Visitor};
use super::{Totals, WriteError, WriteResources, check_values};
use crate::blocking::{BlockingError, Filled, Filler};
use crate::header::{HEADER_BYTES, LARGEST_SLOT_BYTES, ModelRoot, ROOT_PAGE_WORDS, ROOT_WORDS};
use crate::leaf_order::{Nodes, Subtree, Sums};
use crate::page::{CHILD_PAGE_WORDS, HEADER_WORDS, PageLocation};

/// A page is large whose leaves, so many times over, the cache cannot hold: that of the second way is smaller.
const LARGE: usize = 3;

/// A page that waits for its place. Ordered as pages lie in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct WaitingPage {
    level: u32,
    first_leaf: u32,
    size: PageSize,
}

impl SortRecord for WaitingPage {
    fn prefix(&self) -> u64 {
        u64::from(self.level) << 32 | u64::from(self.first_leaf)
    }
}

/// What there is to know of a page in the order of the file. 8 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub(super) struct PageSize {
    pub words: u32,
    /// How many child pages it has.
    pub children: u32,
}

impl PageSize {
    pub fn encoded_bytes(self) -> u32 {
        self.words * 4 + 4
    }
}

/// Where the root of a tree lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct RootPlace {
    /// The page's level and first leaf.
    page: (u32, u32),
    tree: u32,
    record: u16,
}

/// A page of a level, from which on its pages are read.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    pub number: u32,
    pub offset: u64,
}

/// Where everything will lie.
#[derive(Debug)]
pub(super) struct Layout {
    pub roots: Vec<ModelRoot>,
    pub root_pages: Vec<PageLocation>,
    pub pages_offset: u64,
    pub file_length: u64,
    pub slot_bytes: u32,
    pub levels: u32,
    /// All pages, in the order of the file.
    pub sizes: Spool<PageSize>,
    /// Words of all pages.
    pub words: u64,
    /// For each level, from 1 on, its first page.
    pub levels_start: Vec<Start>,
    /// For each level the first page of each job in it, where there is one.
    pub jobs_start: Vec<Vec<Option<Start>>>,
    pub totals: Totals,
    /// The sums of the tree.
    pub sums: Sums,
    /// Pages near the root of the page tree as they were filled, by level and first leaf of what they were handed. To fill
    /// one of them takes looking all over a part of the tree that is larger than the cache, several times: not once more.
    pub large: HashMap<(u32, u32), Filled>,
}

/// What is known of the pages when all are measured, besides their sizes.
struct Measured {
    /// By page.
    places: Vec<RootPlace>,
    totals: Totals,
    large: HashMap<(u32, u32), Filled>,
    /// Of each job.
    first_leaves: Vec<u32>,
    sums: Sums,
}

/// Fills the pages, and measures them.
struct Measurer<'a> {
    tree: &'a StoredTree,
    nodes: Nodes<'a>,
    waiting: &'a Mutex<Sorter<WaitingPage>>,
    places: Vec<RootPlace>,
    totals: Totals,
    large: HashMap<(u32, u32), Filled>,
}

impl<'a> Visitor<'a> for Measurer<'a> {
    fn nodes(&mut self) -> &mut Nodes<'a> {
        &mut self.nodes
    }

    fn splits(&self) -> u64 {
        self.totals.splits
    }

    fn fill(&mut self, filler: Filler, level: u32, subtrees: Vec<Subtree>) -> Result<Filled, BlockingError> {
        let (start, end) = (subtrees[0].start, subtrees[subtrees.len() - 1].end);
        let page = filler.fill(&mut self.nodes, subtrees)?;
        if !self.nodes.holds((end - start) as usize * LARGE) {
            self.large.insert((level, start), page.clone());
        }
        Ok(page)
    }

    fn page(&mut self, level: u32, _: u32, page: &Filled, children: &[Cow<'_, [Subtree]>]) -> Result<u32, WriteError> {
        let first_leaf = page.records[0].start;
        let mut words = (HEADER_WORDS + children.len() * CHILD_PAGE_WORDS) as u64;
        let mut triangles = 0;
        for (record, subtree) in page.records.iter().enumerate() {
            words += self.nodes.split_words(subtree.split)? as u64;
            triangles += self.nodes.triangles(subtree.split)?.len() as u64;
            if subtree.is_tree {
                let tree = self.tree.roots.partition_point(|root| root.start < subtree.start) as u32;
                self.places.push(RootPlace { page: (level, first_leaf), tree, record: record as u16 });
            }
        }
        if words * 4 > LARGEST_SLOT_BYTES.into() {
            let (splits, triangles) = (page.records.len() as u32, triangles as u32);
            return Err(WriteError::PageTooLarge { leaf: page.records[0].split, bytes: words * 4, splits, triangles });
        }
        self.totals.splits += page.records.len() as u64;
        self.totals.triangles += triangles;
        let size = PageSize { words: words as u32, children: children.len() as u32 };
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.push(WaitingPage { level, first_leaf, size })?;
        Ok(0)
    }
}

impl Layout {
    /// Of a tree. `root_groups` is what the root pages are handed; `progress` is told how many splits more
    /// are in pages.
    pub fn of(
        tree: &StoredTree,
        filler: Filler,
        root_groups: Vec<Vec<Subtree>>,
        resources: &WriteResources,
        progress: &(impl Fn(u64) + Sync),
    ) -> Result<Self, WriteError> {
        let sums = Sums::of(tree)?;
        let waiting = Mutex::new(Sorter::new(&resources.scratch, "pages", resources.share(1), 1));
        let mut measurers: Vec<Measurer<'_>> = (0..resources.threads.max(1))
            .map(|_| Measurer {
                tree,
                nodes: Nodes::new(tree, &sums, resources.thread_share(10)),
                waiting: &waiting,
                places: Vec::new(),
                totals: Totals::default(),
                large: HashMap::new(),
            })
            .collect();
        let jobs = descent::first_levels(&mut measurers[0], filler, root_groups)?;
        let first_leaves: Vec<u32> = jobs.iter().map(|job| job[0].subtrees[0].start).collect();
        descent::do_jobs(&mut measurers, filler, jobs, progress, |_, _| (), |_| ())?;
        let (mut places, mut totals, mut large) = (Vec::new(), Totals::default(), HashMap::new());
        for measurer in measurers {
            places.extend(measurer.places);
            large.extend(measurer.large);
            totals.splits += measurer.totals.splits;
            totals.triangles += measurer.totals.triangles;
        }
        places.sort_unstable();
        let waiting = waiting.into_inner().unwrap_or_else(PoisonError::into_inner);
        let measured = Measured { places, totals, large, first_leaves, sums };
        Self::place(tree, waiting, measured, resources)
    }

    /// Gives each page its number and place.
    fn place(
        tree: &StoredTree,
        waiting: Sorter<WaitingPage>,
        measured: Measured,
        resources: &WriteResources,
    ) -> Result<Self, WriteError> {
        let Measured { places, totals, large, first_leaves, sums } = measured;
        let mut sizes = SpoolWriter::new(&resources.scratch, "page-sizes", resources.share(1));
        let mut locations = vec![(PageLocation { number: 0, offset: 0, length: 0 }, 0); tree.roots.len()];
        let (mut root_pages, mut levels_start, mut jobs_start) = (Vec::new(), Vec::new(), Vec::new());
        let (mut number, mut offset, mut slot_bytes, mut words) = (0, 0, 0, 0);
        let mut places = places.iter().peekable();
        let mut sorted = waiting.finish()?;
        while let Some(WaitingPage { level, first_leaf, size }) = sorted.next()? {
            let location = PageLocation { number, offset, length: size.encoded_bytes() };
            let start = Start { number, offset };
            if level as usize > levels_start.len() {
                levels_start.push(start);
                jobs_start.push(vec![None; first_leaves.len()]);
            }
            if let Some(job) = first_leaves.partition_point(|first| *first <= first_leaf).checked_sub(1) {
                jobs_start[level as usize - 1][job].get_or_insert(start);
            }
            if level == 1 {
                root_pages.push(location);
            }
            while let Some(place) = places.next_if(|place| place.page == (level, first_leaf)) {
                locations[place.tree as usize] = (location, place.record);
            }
            slot_bytes = slot_bytes.max(size.words * 4);
            words += u64::from(size.words);
            offset += u64::from(location.length);
            number += 1;
            sizes.push(size)?;
        }
        let tables = tree.roots.len() * ROOT_WORDS * 4 + root_pages.len() * ROOT_PAGE_WORDS * 4 + 4;
        let pages_offset = (HEADER_BYTES + tables) as u64;
        let starts = levels_start.iter_mut().chain(jobs_start.iter_mut().flatten().flatten());
        starts.for_each(|start: &mut Start| start.offset += pages_offset);
        root_pages.iter_mut().for_each(|location| location.offset += pages_offset);
        let mut roots = Vec::with_capacity(locations.len());
        for (root, (mut page, record)) in tree.roots.iter().zip(locations) {
            page.offset += pages_offset;
            let (mut split, mut position) = ([Split::VACANT], [[0.0; 3]]);
            tree.splits.read_at(root.split.into(), &mut split)?;
            tree.positions.read_at(root.start.into(), &mut position)?;
            let Split { id, switch, radius, cone, .. } = split[0];
            check_values(root.split, switch, radius)?;
            let (start, end) = (root.start, root.end);
            roots.push(ModelRoot { start, end, position: position[0], id, switch, radius, cone, record, page });
        }
        let levels = levels_start.len() as u32;
        let (file_length, sizes) = (pages_offset + offset, sizes.finish()?);
        Ok(Layout {
            roots,
            root_pages,
            pages_offset,
            file_length,
            slot_bytes,
            levels,
            sizes,
            words,
            levels_start,
            jobs_start,
            totals,
            sums,
            large,
        })
    }

    /// The root table and the root page table, in words.
    pub fn tables(&self) -> Vec<u32> {
        let mut words: Vec<u32> = self.roots.iter().flat_map(ModelRoot::to_words).collect();
        for PageLocation { number, offset, length } in &self.root_pages {
            words.extend([*number, *offset as u32, (*offset >> 32) as u32, *length]);
        }
        words
    }
}
