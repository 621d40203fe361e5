//! Is this a well-formed view-dependence tree? Invariant 1 of the design, checked node by node in O(n).

use thiserror::Error;

use super::order::switch_of;
use super::record::{NO_SPLIT, Root, Split, Tree};

/// What is wrong with a tree, and where. Splits are named by their born leaf.
#[derive(Debug, Error, PartialEq)]
pub enum TreeError {
    /// The roots do not partition the leaves.
    #[error("root {root}: its leaves {start}..{end} do not go on where the one before ends")]
    Root {
        /// Which root.
        root: usize,
        /// Its first leaf.
        start: u32,
        /// One past its last leaf.
        end: u32,
    },
    /// A split does not lie inside its node's interval.
    #[error("split {split}: it does not divide its node's leaves {start}..{end}")]
    Interval {
        /// Which split.
        split: u32,
        /// First leaf of its node.
        start: u32,
        /// One past the last leaf.
        end: u32,
    },
    /// A leaf that is never born, or a split that belongs to no node.
    #[error("leaf {leaf}: it is born {times} times")]
    Born {
        /// Which leaf.
        leaf: u32,
        /// How often.
        times: u32,
    },
    /// A value of a child does not fit its parent's.
    #[error("split {child}, child of {parent}: {problem}")]
    Child {
        /// The parent.
        parent: u32,
        /// The child.
        child: u32,
        /// What does not fit.
        problem: &'static str,
    },
    /// The id does not stand for a switch value, or for another one.
    #[error("split {split}: the id {id} does not have the switch value {switch}")]
    Id {
        /// Which split.
        split: u32,
        /// Its id.
        id: u32,
        /// Its switch value.
        switch: f32,
    },
    /// A triangle is not born where it should be.
    #[error("triangle {triangle} {corners:?}: it is not born at split {split}, which divides {start}..{end}")]
    Triangle {
        /// Which triangle.
        triangle: u32,
        /// Its corners.
        corners: [u32; 3],
        /// The split.
        split: u32,
        /// First leaf of the split's node.
        start: u32,
        /// One past the last leaf.
        end: u32,
    },
}

/// Checks everything that a tree promises: intervals nest, every leaf but each tree's first is born once, switch values
/// never fall and ids rise from child to parent, switch values are those of the ids, spheres nest, and every triangle is born once, at a
/// split that divides two of its corners and has the third outside.
pub fn check(tree: &Tree) -> Result<(), TreeError> {
    let leaf_count = tree.leaf_count();
    let mut born = vec![0_u32; leaf_count];
    let mut next_leaf = 0;
    let mut stack = Vec::new();
    for (number, Root { start, end, split, .. }) in tree.roots.iter().copied().enumerate() {
        if start != next_leaf || end <= start || end as usize > leaf_count || split == NO_SPLIT {
            return Err(TreeError::Root { root: number, start, end });
        }
        next_leaf = end;
        born[start as usize] += 1;
        stack.push((split, start, end));
        while let Some((split, start, end)) = stack.pop() {
            if split <= start || split >= end {
                return Err(TreeError::Interval { split, start, end });
            }
            let node = &tree.splits[split as usize];
            born[split as usize] += 1;
            if node.switch <= 0.0 || node.switch != switch_of(node.id, tree.exponent) {
                return Err(TreeError::Id { split, id: node.id, switch: node.switch });
            }
            check_triangles(tree, split, start, end)?;
            for (child, child_start, child_end) in [(node.kept, start, split), (node.born, split, end)] {
                if child == NO_SPLIT {
                    if child_end - child_start != 1 {
                        return Err(TreeError::Interval { split, start, end });
                    }
                    continue;
                }
                if child <= child_start || child >= child_end {
                    return Err(TreeError::Interval { split: child, start: child_start, end: child_end });
                }
                check_child(tree, start, split, child, child_start)?;
                stack.push((child, child_start, child_end));
            }
        }
    }
    if next_leaf as usize != leaf_count {
        return Err(TreeError::Root { root: tree.roots.len(), start: next_leaf, end: leaf_count as u32 });
    }
    match born.iter().position(|times| *times != 1) {
        Some(leaf) => Err(TreeError::Born { leaf: leaf as u32, times: born[leaf] }),
        None => Ok(()),
    }
}

fn check_child(tree: &Tree, parent_at: u32, parent: u32, child: u32, child_at: u32) -> Result<(), TreeError> {
    let problem = |problem| Err(TreeError::Child { parent, child, problem });
    let [above, below]: [&Split; 2] = [parent, child].map(|split| &tree.splits[split as usize]);
    let [from, to] = [parent_at, child_at].map(|leaf| tree.positions[leaf as usize].map(f64::from));
    let square: f64 = (0..3).map(|axis| (to[axis] - from[axis]) * (to[axis] - from[axis])).sum();
    if below.switch.is_nan() || below.switch <= 0.0 || below.switch > above.switch {
        problem("its switch value is larger, or not positive")
    } else if below.id >= above.id {
        problem("its id is not smaller")
    } else if square.sqrt() + f64::from(below.radius) > f64::from(above.radius) {
        problem("its sphere reaches out of its parent's")
    } else {
        Ok(())
    }
}

fn check_triangles(tree: &Tree, split: u32, start: u32, end: u32) -> Result<(), TreeError> {
    let first = tree.triangles.offsets[split as usize];
    let triangles = tree.triangles.of(split);
    for (index, corners) in triangles.iter().copied().enumerate() {
        let [a, b, c] = corners;
        let kept = |leaf: u32| start <= leaf && leaf < split;
        let born = |leaf: u32| split <= leaf && leaf < end;
        let outside = |leaf: u32| (leaf < start || leaf >= end) && (leaf as usize) < tree.leaf_count();
        let divided = kept(a) && ((born(b) && outside(c)) || (outside(b) && born(c)));
        let is_new = index == 0 || triangles[index - 1] < corners;
        if !divided || !is_new {
            return Err(TreeError::Triangle { triangle: first + index as u32, corners, split, start, end });
        }
    }
    Ok(())
}
