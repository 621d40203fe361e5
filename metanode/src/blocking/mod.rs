//! Blocking: which splits of the view-dependence tree share a meta-node ("page"), and in which order (the paper, 3.2).
//!
//! | module | what it does |
//! |---|---|
//! | [`forest`] | each page a set of subtrees, filled by largest switch value first (design, 4) |
//! | [`levels`] | each page a subtree of L levels, as in the paper |
//!
//! Both fill one page after the other: each is handed a set of subtrees, takes splits of them, and hands what it leaves to
//! its child pages. They look at the tree through `leaf_order::Nodes`, so it may be larger than memory.

pub mod forest;
pub mod levels;

use std::fmt;
use std::str::FromStr;

use storage::{ByteSize, StorageError};
use thiserror::Error;

use crate::header::Blocking;
use crate::leaf_order::{Nodes, Subtree};

/// Why a tree cannot be blocked.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BlockingError {
    /// The disk failed.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The slot size asked for is out of range.
    #[error(
        "a meta-node of {slot_bytes} bytes cannot be: between {} and {} bytes, please",
        forest::SLOT_BYTES.start(),
        forest::SLOT_BYTES.end()
    )]
    SlotBytes {
        /// What was asked for.
        slot_bytes: u32,
    },
    /// The number of child pages asked for is out of range.
    #[error(
        "a meta-node with up to {fan_out} children cannot be: between {} and {}, please",
        forest::FAN_OUT.start(),
        forest::FAN_OUT.end()
    )]
    FanOut {
        /// What was asked for.
        fan_out: u32,
    },
    /// The number of levels asked for is out of range.
    #[error("meta-nodes of {levels} levels cannot be: between {} and {}, please", levels::LEVELS.start(), levels::LEVELS.end())]
    Levels {
        /// What was asked for.
        levels: u32,
    },
    /// The tree breaks a promise of its type.
    #[error("the tree cannot be blocked: {problem}")]
    Tree {
        /// What is wrong, and where.
        problem: String,
    },
}

/// A page that was filled: its splits, and what it leaves for its child pages.
#[derive(Debug, Clone, Default)]
pub(crate) struct Filled {
    /// How many of its splits are at its roots: those whose parents are in another page, or that are roots of trees.
    pub root_count: usize,
    /// Its splits, the roots first, then breadth-first, the kept child before the born one.
    pub records: Vec<Subtree>,
    /// For each child page the subtrees that it is handed, by ascending leaf.
    pub groups: Vec<Vec<Subtree>>,
}

/// Puts the splits below `roots` for which `is_inside` holds behind them, breadth-first. It is asked once for each child
/// of a split of the page that splits further, with the child's level in the page; the roots are on level 1.
fn fill_page(
    nodes: &mut Nodes<'_>,
    roots: Vec<Subtree>,
    mut is_inside: impl FnMut(Subtree, u32) -> bool,
) -> Result<Filled, BlockingError> {
    let mut filled = Filled { root_count: roots.len(), records: roots, groups: Vec::new() };
    let (mut next, mut level, mut level_end) = (0, 1, filled.root_count);
    while let Some(&subtree) = filled.records.get(next) {
        if next == level_end {
            level += 1;
            level_end = filled.records.len();
        }
        for child in nodes.children(subtree)?.into_iter().flatten() {
            if is_inside(child, level + 1) {
                filled.records.push(child);
            }
        }
        next += 1;
    }
    Ok(filled)
}

/// A blocking, page by page.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Filler {
    /// By `forest`.
    Forest(forest::Slot),
    /// By `levels`.
    Levels(u32),
}

impl Filler {
    /// Of a blocking that can be.
    pub fn new(blocking: Blocking) -> Self {
        match blocking {
            Blocking::Forest { slot_bytes, fan_out } => Filler::Forest(forest::Slot::new(slot_bytes, fan_out)),
            Blocking::Levels { levels } => Filler::Levels(levels),
        }
    }

    /// What the root pages are handed, from the trees by ascending leaf.
    pub fn root_groups(self, trees: Vec<Subtree>) -> Vec<Vec<Subtree>> {
        match self {
            Filler::Forest(_) if trees.is_empty() => Vec::new(),
            Filler::Forest(_) => vec![trees],
            Filler::Levels(_) => trees.into_iter().map(|tree| vec![tree]).collect(),
        }
    }

    /// Fills a page from what it was handed.
    pub fn fill(self, nodes: &mut Nodes<'_>, group: Vec<Subtree>) -> Result<Filled, BlockingError> {
        match self {
            Filler::Forest(slot) => slot.fill(nodes, group),
            // A page of this kind is handed one subtree.
            Filler::Levels(levels) => match group.first() {
                Some(root) => levels::fill(nodes, *root, levels),
                None => Ok(Filled::default()),
            },
        }
    }
}

/// Whether a blocking with these parameters can be: for those who want to know before they have a
/// tree.
pub fn check_parameters(blocking: Blocking) -> Result<(), BlockingError> {
    match blocking {
        Blocking::Forest { slot_bytes, fan_out } => forest::check_parameters(slot_bytes, fan_out),
        Blocking::Levels { levels } => levels::check_parameters(levels),
    }
}

impl fmt::Display for Blocking {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Blocking::Forest { slot_bytes, fan_out } => {
                let kilobytes = slot_bytes / 1024;
                if slot_bytes.is_multiple_of(1024) {
                    write!(out, "forest:{kilobytes}K,{fan_out}")
                } else {
                    write!(out, "forest:{slot_bytes},{fan_out}")
                }
            }
            Blocking::Levels { levels } => write!(out, "levels:{levels}"),
        }
    }
}

/// What is wrong with a blocking that someone wrote.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("`{text}` is not a blocking: write forest:SLOT,K (as in forest:32K,8) or levels:L (as in levels:5)")]
pub struct ParseBlockingError {
    text: String,
}

impl FromStr for Blocking {
    type Err = ParseBlockingError;

    /// `forest`, `forest:32K`, `forest:32K,8` or `levels:5`. Whether the numbers can be, the blocking itself says.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let fail = || ParseBlockingError { text: text.to_owned() };
        let (name, parameters) = text.split_once(':').unwrap_or((text, ""));
        match (name, Blocking::default()) {
            ("forest", Blocking::Forest { slot_bytes, fan_out }) => {
                let (slot, children) = parameters.split_once(',').unwrap_or((parameters, ""));
                let slot_bytes = match slot {
                    "" => slot_bytes,
                    slot => {
                        let ByteSize(bytes) = slot.parse().map_err(|_| fail())?;
                        u32::try_from(bytes).map_err(|_| fail())?
                    }
                };
                let fan_out = if children.is_empty() { fan_out } else { children.parse().map_err(|_| fail())? };
                Ok(Blocking::Forest { slot_bytes, fan_out })
            }
            ("levels", _) => Ok(Blocking::Levels { levels: parameters.parse().map_err(|_| fail())? }),
            _ => Err(fail()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blocking_is_written_as_it_is_read() {
        let forest = |slot_bytes, fan_out| Blocking::Forest { slot_bytes, fan_out };
        for (text, blocking) in [
            ("forest:16K,8", Blocking::default()),
            ("forest:4100,3", forest(4100, 3)),
            ("forest:1024K,256", forest(1 << 20, 256)),
            ("levels:5", Blocking::Levels { levels: 5 }),
        ] {
            assert_eq!(text.parse(), Ok(blocking));
            assert_eq!(blocking.to_string(), text);
        }
        assert_eq!("forest".parse(), Ok(Blocking::default()));
        assert_eq!("forest:64K".parse(), Ok(forest(64 << 10, 8)));
        assert_eq!("forest:1M,4".parse(), Ok(forest(1 << 20, 4)));
        for wrong in
            ["", "tree", "forest:x", "forest:4K,x", "forest:8G", "levels", "levels:", "levels:-1", "levels:5,2"]
        {
            let message = wrong.parse::<Blocking>().unwrap_err().to_string();
            assert!(message.contains("forest:SLOT,K"), "{message}");
        }
    }
}
