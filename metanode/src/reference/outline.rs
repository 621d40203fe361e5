//! One walk over a tree before it is blocked: is it a tree that a model file can hold, and how much is below a split.
//!
//! The tree comes from our own build, but what follows would run in circles or out of an array on a wrong one, and
//! the reader refuses numbers that are not finite. So the walk checks what the writer relies on; whether the *values*
//! nest as they should is the business of `verify`.
//!
//! Linear time; no call stack over the depth of the tree. Memory: 4 bytes for each split, and 8 for its weight.

use vdt::tree::{NO_SPLIT, Split, Tree};

use super::children;
use crate::blocking::BlockingError;
use crate::page::PageCounts;
use crate::wedges::WedgeLayout;

/// The splits of `tree` in an order in which parents come before their children.
pub(super) fn preorder(tree: &Tree) -> Result<Vec<u32>, BlockingError> {
    check_arrays(tree).map_err(|problem| BlockingError::Tree { problem })?;
    let mut order = Vec::with_capacity(tree.leaf_count() - tree.roots.len());
    let mut stack = Vec::new();
    let mut next_leaf = 0;
    let mut triangles = 0;
    for (index, root) in tree.roots.iter().enumerate() {
        if root.start != next_leaf || root.end <= root.start || root.end as usize > tree.leaf_count() {
            let problem = format!("tree {index} has the leaves {}..{}, after leaf {next_leaf}", root.start, root.end);
            return Err(BlockingError::Tree { problem });
        }
        next_leaf = root.end;
        stack.push((root.split, root.start, root.end));
        while let Some((split, start, end)) = stack.pop() {
            let node = check_split(tree, split, start, end)
                .map_err(|problem| BlockingError::Tree { problem: format!("split {split}: {problem}") })?;
            order.push(split);
            triangles += tree.triangles.of(split).len();
            if node.born != NO_SPLIT {
                stack.push((node.born, split, end));
            }
            if node.kept != NO_SPLIT {
                stack.push((node.kept, start, split));
            }
        }
    }
    let problem = if next_leaf as usize != tree.leaf_count() {
        format!("the trees end at leaf {next_leaf} of {}", tree.leaf_count())
    } else if triangles != tree.triangles.corners.len() {
        format!("{triangles} of {} triangles are born by a split", tree.triangles.corners.len())
    } else {
        return Ok(order);
    };
    Err(BlockingError::Tree { problem })
}

fn check_arrays(tree: &Tree) -> Result<(), String> {
    let leaves = tree.leaf_count();
    let offsets = &tree.triangles.offsets;
    let corners = &tree.triangles.corners;
    if leaves >= NO_SPLIT as usize {
        Err(format!("{leaves} leaves are more than 32 bits can number"))
    } else if tree.splits.len() != leaves || tree.roots.len() > leaves {
        Err(format!("{leaves} leaves, but {} splits and {} trees", tree.splits.len(), tree.roots.len()))
    } else if offsets.len() != leaves + 1 && !(leaves == 0 && offsets.is_empty()) {
        Err(format!("{leaves} leaves, but {} triangle offsets", offsets.len()))
    } else if offsets.first().is_some_and(|first| *first != 0)
        || offsets.last().map_or(0, |last| *last as usize) != corners.len()
        || !offsets.is_sorted()
    {
        Err(format!("the triangle offsets do not lead from 0 up to {}", corners.len()))
    } else if let Some(wrong) = corners.as_flattened().iter().find(|leaf| **leaf as usize >= leaves) {
        Err(format!("a triangle with the corner {wrong}, of {leaves} leaves"))
    } else if !tree.positions.as_flattened().iter().all(|value| value.is_finite())
        || !tree.origin.iter().all(|value| value.is_finite())
    {
        Err("a coordinate is not finite".into())
    } else {
        Ok(())
    }
}

/// The split that divides the leaves `start..end` at its born leaf.
fn check_split(tree: &Tree, split: u32, start: u32, end: u32) -> Result<&Split, String> {
    let node = match tree.splits.get(split as usize) {
        Some(node) if start < split && split < end => node,
        _ => return Err(format!("it is to divide the leaves {start}..{end}")),
    };
    // A child is a leaf just where one leaf is left: so each leaf that can be born is.
    if (node.kept == NO_SPLIT) != (split - start == 1) || (node.born == NO_SPLIT) != (end - split == 1) {
        return Err(format!("it leaves {} and {} leaves, which does not fit its children", split - start, end - split));
    }
    if !(node.switch > 0.0 && node.switch.is_finite() && node.radius >= 0.0 && node.radius.is_finite()) {
        return Err(format!("switch value {}, radius {}", node.switch, node.radius));
    }
    Ok(node)
}

/// Words that a split takes in a page.
pub(super) fn split_words(tree: &Tree, split: u32) -> usize {
    PageCounts::record_words(children(tree, split).count(), tree.triangles.of(split).len(), 0, WedgeLayout::default())
}

/// Words that all splits of a subtree take, by the split at its root. `preorder` is that of the tree.
pub(super) fn weights(tree: &Tree, preorder: &[u32]) -> Vec<u64> {
    let mut weights = vec![0; tree.leaf_count()];
    for &split in preorder.iter().rev() {
        let below: u64 = children(tree, split).map(|child| weights[child as usize]).sum();
        weights[split as usize] = below + split_words(tree, split) as u64;
    }
    weights
}
