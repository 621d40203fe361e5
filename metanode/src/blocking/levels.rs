//! The paper's blocking (3.2): each page holds a subtree of L levels of one tree.
//!
//! Every tree begins a page, and so does every child of the L-th level of a page. On real trees such pages fill badly:
//! with L = 5 two of five hold a single split, and the largest is nearly ten times the mean. It is here to be compared
//! with.

use std::ops::RangeInclusive;

use super::{BlockingError, Filled, fill_page};
use crate::leaf_order::{Nodes, Subtree};

/// How many levels a page may have. A page of 15 levels has up to 65,534 child entries, the most that 16 bits can tell.
pub const LEVELS: RangeInclusive<u32> = 1..=15;

/// Whether there can be pages of so many levels.
pub fn check_parameters(levels: u32) -> Result<(), BlockingError> {
    if LEVELS.contains(&levels) { Ok(()) } else { Err(BlockingError::Levels { levels }) }
}

/// Fills a page with `levels` levels from a root on.
pub(super) fn fill(nodes: &mut Nodes<'_>, root: Subtree, levels: u32) -> Result<Filled, BlockingError> {
    let mut groups = Vec::new();
    let mut filled = fill_page(nodes, vec![root], |child, level| {
        let is_inside = level <= levels;
        if !is_inside {
            groups.push(vec![child]);
        }
        is_inside
    })?;
    filled.groups = groups;
    Ok(filled)
}
