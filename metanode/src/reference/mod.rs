//! Blocking: which splits of the view-dependence tree share a meta-node ("page"), and in which order (the paper, 3.2).
//!
//! | module | what it does |
//! |---|---|
//! | `outline` | walks a tree once, refuses one that cannot be written, and weighs its subtrees |
//! | [`forest`] | each page a set of subtrees, filled by largest switch value first (design, 4) |
//! | [`levels`] | each page a subtree of L levels, as in the paper |
//!
//! Both give the same thing, [`Blocks`]: for each page its splits in breadth-first order, the page's roots first. Pages
//! are numbered breadth-first over the page tree, root pages first, so the children of a page have consecutive numbers.
//! Memory: 4 bytes for each leaf and 36 for each page; while it is made, up to 9 bytes for each leaf on top, and what
//! waits on one level of the page tree.

mod forest;
mod levels;
mod outline;
pub(crate) mod write;

use vdt::tree::{NO_SPLIT, Tree};

use crate::blocking::{BlockingError, check_parameters};
use crate::header::Blocking;
use crate::page::{NONE_32, PageCounts};

/// One page: a stretch of [`Blocks::order`], and its place in the page tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block {
    /// Where its splits begin in [`Blocks::order`].
    pub first_record: u32,
    /// How many splits it has.
    pub record_count: u32,
    /// How many of the first are roots of the page: nodes whose parent's split is elsewhere, or that have no parent.
    pub root_count: u32,
    /// Children of its splits that split further.
    pub entry_count: u32,
    /// Triangles born by its splits.
    pub triangle_count: u32,
    /// Number of the parent page, [`NONE_32`] for a root page.
    pub parent: u32,
    /// Number of the first child page, 0 where there is none.
    pub first_child: u32,
    /// How many child pages it has.
    pub child_count: u32,
    /// Its level in the page tree; root pages are on level 1.
    pub level: u32,
}

impl Block {
    fn new(parent: u32, level: u32) -> Self {
        Block {
            first_record: 0,
            record_count: 0,
            root_count: 0,
            entry_count: 0,
            triangle_count: 0,
            parent,
            first_child: 0,
            child_count: 0,
            level,
        }
    }

    /// The counts that fix the page's size.
    pub fn counts(&self) -> PageCounts {
        PageCounts {
            children: self.child_count as usize,
            records: self.record_count as usize,
            entries: self.entry_count as usize,
            triangles: self.triangle_count as usize,
            ..PageCounts::default()
        }
    }
}

/// A blocked tree.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Blocks {
    /// Every split once, by born leaf: page by page, breadth-first within the page.
    pub order: Vec<u32>,
    /// The pages by number: root pages first, then breadth-first.
    pub pages: Vec<Block>,
    /// How many root pages there are.
    pub root_pages: u32,
}

impl Blocks {
    /// The splits of a page in the order of its records.
    pub fn records(&self, page: &Block) -> &[u32] {
        &self.order[page.first_record as usize..][..page.record_count as usize]
    }

    /// The splits at the roots of a page, by ascending leaf.
    pub fn page_roots(&self, page: &Block) -> &[u32] {
        &self.records(page)[..page.root_count as usize]
    }

    /// The child pages of a page.
    pub fn children(&self, page: &Block) -> &[Block] {
        &self.pages[page.first_child as usize..][..page.child_count as usize]
    }

    /// Completes page `number`, whose roots, by ascending leaf, are those splits of `order` that no page has yet: puts
    /// the splits below them for which `is_inside` holds behind them, breadth-first. It is asked once for each child of
    /// a split of the page that splits further, with the child's level in the page; the roots are on level 1.
    fn complete(&mut self, tree: &Tree, number: usize, mut is_inside: impl FnMut(u32, u32) -> bool) {
        let first = match number.checked_sub(1).map(|before| &self.pages[before]) {
            Some(before) => before.first_record + before.record_count,
            None => 0,
        };
        let root_count = self.order.len() as u32 - first;
        let mut page = Block { first_record: first, root_count, ..self.pages[number] };
        let (mut next, mut level, mut level_end) = (first as usize, 1, self.order.len());
        while let Some(&split) = self.order.get(next) {
            if next == level_end {
                level += 1;
                level_end = self.order.len();
            }
            for child in children(tree, split) {
                page.entry_count += 1;
                if is_inside(child, level + 1) {
                    self.order.push(child);
                }
            }
            page.triangle_count += tree.triangles.of(split).len() as u32;
            next += 1;
        }
        page.record_count = next as u32 - first;
        self.pages[number] = page;
    }

    /// Appends an unfinished child page of page `parent`, whose children so far are the last pages there are.
    fn push_child(&mut self, parent: usize) {
        let number = self.pages.len() as u32;
        let page = &mut self.pages[parent];
        if page.child_count == 0 {
            page.first_child = number;
        }
        page.child_count += 1;
        let level = page.level + 1;
        self.pages.push(Block::new(parent as u32, level));
    }
}

/// The children of a split that split further, the kept one first.
fn children(tree: &Tree, split: u32) -> impl Iterator<Item = u32> {
    let node = &tree.splits[split as usize];
    [node.kept, node.born].into_iter().filter(|child| *child != NO_SPLIT)
}

/// Blocks `tree` as `blocking` says.
pub fn block(tree: &Tree, blocking: Blocking) -> Result<Blocks, BlockingError> {
    check_parameters(blocking)?;
    match blocking {
        Blocking::Forest { slot_bytes, fan_out } => forest::block(tree, slot_bytes, fan_out),
        Blocking::Levels { levels } => levels::block(tree, levels),
    }
}

/// The index of the tree whose root is `split`, where it is one.
pub(crate) fn tree_of_root(tree: &Tree, split: u32) -> Option<usize> {
    let index = tree.roots.partition_point(|root| root.start <= split).checked_sub(1)?;
    (tree.roots[index].split == split).then_some(index)
}

/// A root page.
fn root_page() -> Block {
    Block::new(NONE_32, 1)
}
