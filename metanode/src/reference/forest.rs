//! The default blocking: each page a *set* of subtrees, filled by largest switch value first (design, 4).
//!
//! A page is handed the roots of a set of subtrees, by ascending leaf. It takes their splits, then always the one with
//! the greatest id (so the greatest switch value) whose parent it has, as long as one fits into the slot. The frontier,
//! that is the children of its splits that it did not take, by ascending leaf, is cut into contiguous groups of about
//! equal weight, one for each child page. How many groups: *bottom-full*. Let L be the pages that the frontier takes
//! when its subtrees are packed in order. If L is at most the fan-out k, there are L groups, and each is a whole page;
//! otherwise L / kʲ, rounded up, with the smallest j that keeps this at most k. So the pages at the bottom, which are
//! most, are full: pages of 32 KiB with k = 8 come to 0.91 to 0.93 on meshes of 171 K to 540 K vertices. (With the plain
//! sum of the weights in place of the packing, subtrees that are large beside a page spilled over into pages with little
//! in them: 0.7 with k = 32.)
//!
//! The first page is handed the roots of all trees. A tree's root which does not fit goes on into a child page, to be
//! judged there among the others; the root of a subtree does not, since its parent's entry can only lead into a child
//! page. So a group's subtree roots must fit into a page together (*what is due*); where the fan-out is too small for
//! that, the page takes fewer splits, and where that does not help either, it has more children than asked for. Each
//! split that is due is counted with a child page of its own for each of its children, so that never makes a page too
//! large. Only a split that does not fit into a slot by itself does; it has a page of its own.
//!
//! Time: O(n log s) for n splits and s in a page; a tree's root that goes on from page to page counts each time. Memory:
//! 12 bytes for each leaf, 36 for each page and one bit for each leaf, and for each subtree that waits for its page on
//! one level of the page tree 8, for those of one page 50 more.

use std::collections::{BinaryHeap, VecDeque};

use vdt::tree::Tree;

use super::{Blocks, children, outline, root_page};
use crate::blocking::BlockingError;
use crate::blocking::forest::{Item, cut};
use crate::page::{CHILD_PAGE_WORDS, HEADER_WORDS, RECORD_WORDS};

/// A subtree handed to a page, by the split at its root.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Subtree {
    split: u32,
    /// Whether it is a whole tree: no entry leads to it, so it may go on into a child page.
    is_tree: bool,
}

/// The subtrees handed to a page, and what it has taken of them.
#[derive(Debug, Default)]
struct Filling {
    subtrees: Vec<Subtree>,
    /// The splits taken: first those that are due, then the others in the order in which they were chosen.
    taken: Vec<u32>,
    /// How many of them the page cannot do without.
    due: usize,
    /// Words that they take.
    words: usize,
    /// What they leave.
    frontier: Vec<Subtree>,
    heap: BinaryHeap<(u32, Subtree)>,
}

struct Forest<'a> {
    tree: &'a Tree,
    /// Words of whole subtrees.
    weights: Vec<u64>,
    /// Splits that are in a page.
    placed: Vec<bool>,
    /// Words of a slot behind the page header.
    capacity: usize,
    fan_out: usize,
}

/// Blocks `tree` into pages of `slot_bytes` bytes, decoded, with up to `fan_out` child pages.
pub fn block(tree: &Tree, slot_bytes: u32, fan_out: u32) -> Result<Blocks, BlockingError> {
    let preorder = outline::preorder(tree)?;
    let split_count = preorder.len();
    let mut forest = Forest {
        tree,
        weights: outline::weights(tree, &preorder),
        placed: vec![false; tree.leaf_count()],
        capacity: slot_bytes as usize / 4 - HEADER_WORDS,
        fan_out: fan_out as usize,
    };
    drop(preorder);

    let mut blocks = Blocks { order: Vec::with_capacity(split_count), ..Blocks::default() };
    let mut waiting: VecDeque<Subtree> =
        tree.roots.iter().map(|root| Subtree { split: root.split, is_tree: true }).collect();
    let mut group_sizes = VecDeque::new();
    if !waiting.is_empty() {
        group_sizes.push_back(waiting.len());
        blocks.pages.push(root_page());
        blocks.root_pages = 1;
    }
    let mut filling = Filling::default();
    let mut number = 0;
    while let Some(size) = group_sizes.pop_front() {
        filling.subtrees.clear();
        filling.subtrees.extend(waiting.drain(..size));
        let groups = forest.fill(&mut filling);
        let roots = filling.subtrees.iter().filter(|subtree| forest.placed[subtree.split as usize]);
        blocks.order.extend(roots.map(|subtree| subtree.split));
        blocks.complete(tree, number, |child, _| forest.placed[child as usize]);
        for size in groups {
            group_sizes.push_back(size);
            blocks.push_child(number);
        }
        waiting.extend(&filling.frontier);
        number += 1;
    }
    Ok(blocks)
}

impl Forest<'_> {
    /// Chooses the splits of a page and marks them as placed; leaves the frontier in `filling`, and says how it is cut
    /// into groups.
    fn fill(&mut self, filling: &mut Filling) -> Vec<usize> {
        let whole: u64 = filling.subtrees.iter().map(|subtree| self.weights[subtree.split as usize]).sum();
        if whole <= self.capacity as u64 {
            self.take_everything(filling);
            return Vec::new();
        }
        self.take_best_first(filling);
        loop {
            self.find_frontier(filling);
            let frontier: Vec<Item> = filling.frontier.iter().map(|subtree| self.item(*subtree)).collect();
            let groups = cut(&frontier, self.capacity, self.fan_out);
            let optional = filling.taken.len() - filling.due;
            let fits = filling.words + groups.len() * CHILD_PAGE_WORDS <= self.capacity;
            if optional == 0 || (groups.len() <= self.fan_out && fits) {
                return groups;
            }
            for split in filling.taken.drain(filling.due + optional / 2..) {
                self.placed[split as usize] = false;
                filling.words -= outline::split_words(self.tree, split);
            }
        }
    }

    fn take_everything(&mut self, filling: &mut Filling) {
        filling.frontier.clear();
        let taken = &mut filling.taken;
        taken.clear();
        taken.extend(filling.subtrees.iter().map(|subtree| subtree.split));
        while let Some(split) = taken.pop() {
            self.placed[split as usize] = true;
            taken.extend(children(self.tree, split));
        }
    }

    /// Takes what is due, then the greatest ids, as long as any split fits beside a table of the asked-for children.
    fn take_best_first(&mut self, filling: &mut Filling) {
        let room = self.capacity - self.fan_out * CHILD_PAGE_WORDS;
        let ranked = |subtree: Subtree| (self.tree.splits[subtree.split as usize].id, subtree);
        let below = |split| children(self.tree, split).map(|split| ranked(Subtree { split, is_tree: false }));
        let Filling { subtrees, taken, due, words, heap, .. } = filling;
        taken.clear();
        heap.clear();
        *words = 0;
        for &subtree in subtrees.iter() {
            if subtree.is_tree {
                heap.push(ranked(subtree));
            } else {
                taken.push(subtree.split);
                *words += outline::split_words(self.tree, subtree.split);
                heap.extend(below(subtree.split));
            }
        }
        if taken.is_empty()
            && let Some((_, greatest)) = heap.pop()
        {
            // A page holds something, however large.
            taken.push(greatest.split);
            *words = outline::split_words(self.tree, greatest.split);
            heap.extend(below(greatest.split));
        }
        *due = taken.len();
        while let Some((_, best)) = heap.pop()
            && *words + RECORD_WORDS <= room
        {
            let needed = outline::split_words(self.tree, best.split);
            if *words + needed <= room {
                taken.push(best.split);
                *words += needed;
                heap.extend(below(best.split));
            }
        }
        for split in taken.iter() {
            self.placed[*split as usize] = true;
        }
    }

    fn find_frontier(&self, filling: &mut Filling) {
        let Filling { subtrees, taken, frontier, .. } = filling;
        let trees = subtrees.iter().filter(|subtree| subtree.is_tree).copied();
        let parts = taken.iter().flat_map(|split| children(self.tree, *split));
        frontier.clear();
        frontier.extend(trees.chain(parts.map(|split| Subtree { split, is_tree: false })));
        frontier.retain(|subtree| !self.placed[subtree.split as usize]);
        // By born leaf is by leaf, since the subtrees' intervals are disjoint.
        frontier.sort_unstable();
    }

    fn item(&self, subtree: Subtree) -> Item {
        let split = subtree.split;
        let due = if subtree.is_tree {
            0
        } else {
            outline::split_words(self.tree, split) + children(self.tree, split).count() * CHILD_PAGE_WORDS
        };
        Item { weight: self.weights[split as usize], due }
    }
}
