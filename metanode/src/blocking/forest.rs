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
//! for each subtree that waits for its page 16 bytes, for those of one page 50 more.

use std::collections::BinaryHeap;
use std::ops::RangeInclusive;

use super::{BlockingError, Filled, fill_page};
use crate::leaf_order::{Nodes, Subtree};
use crate::page::{CHILD_PAGE_WORDS, HEADER_WORDS, RECORD_WORDS};

/// What a slot may hold, in bytes. A page of 1 MiB has at most 32,768 child entries and 43,690 records, well within the
/// page's 16-bit fields.
pub const SLOT_BYTES: RangeInclusive<u32> = 4096..=1 << 20;
/// How many children a page may be given. The most take a quarter of the smallest slot.
pub const FAN_OUT: RangeInclusive<u32> = 2..=256;

/// Whether there can be pages of so many bytes with so many child pages.
pub fn check_parameters(slot_bytes: u32, fan_out: u32) -> Result<(), BlockingError> {
    if !SLOT_BYTES.contains(&slot_bytes) {
        return Err(BlockingError::SlotBytes { slot_bytes });
    }
    if !FAN_OUT.contains(&fan_out) {
        return Err(BlockingError::FanOut { fan_out });
    }
    Ok(())
}

/// How large pages are, and how many children they have.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slot {
    /// Words behind the page header.
    capacity: usize,
    fan_out: usize,
}

/// What a page takes of the subtrees that it was handed.
#[derive(Debug, Default)]
struct Taking {
    /// The splits taken: first those that are due, then the others in the order in which they were chosen.
    taken: Vec<Subtree>,
    /// How many of them the page cannot do without.
    due: usize,
    /// Words that they take.
    words: usize,
    /// The splits taken, ascending.
    placed: Vec<u32>,
    /// What they leave.
    frontier: Vec<Subtree>,
}

impl Taking {
    fn sort_placed(&mut self) {
        self.placed.clear();
        self.placed.extend(self.taken.iter().map(|subtree| subtree.split));
        self.placed.sort_unstable();
    }

    fn has(&self, split: u32) -> bool {
        self.placed.binary_search(&split).is_ok()
    }
}

impl Slot {
    pub fn new(slot_bytes: u32, fan_out: u32) -> Self {
        Slot { capacity: slot_bytes as usize / 4 - HEADER_WORDS, fan_out: fan_out as usize }
    }

    /// Fills a page from a set of subtrees.
    pub fn fill(&self, nodes: &mut Nodes<'_>, subtrees: Vec<Subtree>) -> Result<Filled, BlockingError> {
        let mut whole = 0;
        for subtree in &subtrees {
            whole += nodes.weight(*subtree)?;
        }
        if whole <= self.capacity as u64 {
            return fill_page(nodes, subtrees, |_, _| true);
        }
        let mut taking = Taking::default();
        self.take_best_first(nodes, &subtrees, &mut taking)?;
        let groups = loop {
            find_frontier(nodes, &subtrees, &mut taking)?;
            let groups = self.cut(nodes, &taking.frontier)?;
            let optional = taking.taken.len() - taking.due;
            let fits = taking.words + groups.len() * CHILD_PAGE_WORDS <= self.capacity;
            if optional == 0 || (groups.len() <= self.fan_out && fits) {
                break groups;
            }
            for subtree in taking.taken.drain(taking.due + optional / 2..) {
                taking.words -= nodes.split_words(subtree.split)?;
            }
            taking.sort_placed();
        };
        let roots = subtrees.into_iter().filter(|subtree| taking.has(subtree.split)).collect();
        let mut filled = fill_page(nodes, roots, |child, _| taking.has(child.split))?;
        let mut frontier = taking.frontier.iter().copied();
        filled.groups = groups.into_iter().map(|size| frontier.by_ref().take(size).collect()).collect();
        Ok(filled)
    }

    /// Takes what is due, then the greatest ids, as long as any split fits beside a table of the asked-for children.
    fn take_best_first(
        &self,
        nodes: &mut Nodes<'_>,
        subtrees: &[Subtree],
        taking: &mut Taking,
    ) -> Result<(), BlockingError> {
        let room = self.capacity - self.fan_out * CHILD_PAGE_WORDS;
        let mut heap: BinaryHeap<(u32, Subtree)> = BinaryHeap::new();
        for &subtree in subtrees {
            if subtree.is_tree {
                heap.push((nodes.split(subtree.split)?.id, subtree));
            } else {
                taking.words += nodes.split_words(subtree.split)?;
                taking.taken.push(subtree);
                push_children(nodes, subtree, &mut heap)?;
            }
        }
        if taking.taken.is_empty()
            && let Some((_, greatest)) = heap.pop()
        {
            // A page holds something, however large.
            taking.taken.push(greatest);
            taking.words = nodes.split_words(greatest.split)?;
            push_children(nodes, greatest, &mut heap)?;
        }
        taking.due = taking.taken.len();
        while let Some((_, best)) = heap.pop()
            && taking.words + RECORD_WORDS <= room
        {
            let needed = nodes.split_words(best.split)?;
            if taking.words + needed <= room {
                taking.taken.push(best);
                taking.words += needed;
                push_children(nodes, best, &mut heap)?;
            }
        }
        taking.sort_placed();
        Ok(())
    }

    /// Cuts the frontier into groups, and gives their sizes.
    fn cut(&self, nodes: &mut Nodes<'_>, frontier: &[Subtree]) -> Result<Vec<usize>, BlockingError> {
        let items = frontier.iter().map(|subtree| item(nodes, *subtree)).collect::<Result<Vec<_>, _>>()?;
        Ok(cut(&items, self.capacity, self.fan_out))
    }
}

fn push_children(
    nodes: &mut Nodes<'_>,
    subtree: Subtree,
    heap: &mut BinaryHeap<(u32, Subtree)>,
) -> Result<(), BlockingError> {
    for child in nodes.children(subtree)?.into_iter().flatten() {
        heap.push((nodes.split(child.split)?.id, child));
    }
    Ok(())
}

fn find_frontier(nodes: &mut Nodes<'_>, subtrees: &[Subtree], taking: &mut Taking) -> Result<(), BlockingError> {
    let mut frontier: Vec<Subtree> = subtrees.iter().filter(|subtree| subtree.is_tree).copied().collect();
    for subtree in &taking.taken {
        frontier.extend(nodes.children(*subtree)?.into_iter().flatten());
    }
    frontier.retain(|subtree| !taking.has(subtree.split));
    // By born leaf is by leaf, since the subtrees' intervals are disjoint.
    frontier.sort_unstable();
    taking.frontier = frontier;
    Ok(())
}

/// A subtree of the frontier that is to be grouped.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Item {
    /// Words of the whole subtree.
    pub weight: u64,
    /// Words that the page which gets it must have for it at once.
    pub due: usize,
}

fn item(nodes: &mut Nodes<'_>, subtree: Subtree) -> Result<Item, BlockingError> {
    let children = nodes.children(subtree)?.into_iter().flatten().count();
    let due = if subtree.is_tree { 0 } else { nodes.split_words(subtree.split)? + children * CHILD_PAGE_WORDS };
    Ok(Item { weight: nodes.weight(subtree)?, due })
}

/// Cuts a frontier into groups, and gives their sizes: for pages of so many words behind the header, each with up to so many
/// child pages.
pub(crate) fn cut(items: &[Item], capacity: usize, fan_out: usize) -> Vec<usize> {
    let total: u64 = items.iter().map(|item| item.weight).sum();
    let due_at_most = capacity - fan_out * CHILD_PAGE_WORDS;
    let capacity = capacity as u64;
    let fan_out = fan_out as u64;
    let count = |heaviest| groups(items, heaviest, due_at_most).count() as u64;
    let full_pages = count(capacity);
    let pages = total.div_ceil(capacity).max(full_pages);
    let wanted = if pages <= fan_out {
        full_pages
    } else {
        let mut below = fan_out;
        while below.saturating_mul(fan_out) < pages {
            below *= fan_out;
        }
        pages.div_ceil(below)
    };
    // The least weight of the heaviest group with so many groups, or with as many as what is due asks for.
    let wanted = wanted.max(count(u64::MAX));
    let mut too_little = (total / wanted.max(1)).saturating_sub(1);
    let mut enough = if full_pages <= wanted { capacity.min(total) } else { total };
    while enough > too_little + 1 + enough / 1024 {
        let middle = too_little + (enough - too_little) / 2;
        if count(middle) <= wanted {
            enough = middle;
        } else {
            too_little = middle;
        }
    }
    groups(items, enough, due_at_most).collect()
}

/// The sizes of the groups when each, from the first on, gets as many items as stay within `heaviest` words altogether
/// and `due_at_most` due at once. A group of one item may be larger.
fn groups(items: &[Item], heaviest: u64, due_at_most: usize) -> impl Iterator<Item = usize> {
    let mut rest = items;
    std::iter::from_fn(move || {
        let (mut weight, mut due) = (0_u64, 0);
        let fitting = rest.iter().take_while(|item| {
            weight = weight.saturating_add(item.weight);
            due += item.due;
            weight <= heaviest && due <= due_at_most
        });
        let size = fitting.count().max(1).min(rest.len());
        rest = &rest[size..];
        (size > 0).then_some(size)
    })
}
