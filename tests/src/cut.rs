//! The mesh of a cut, by brute force: a triangle is there if its three corners have three distinct active ancestors.

use std::collections::BTreeSet;

use vdt::tree::{NO_SPLIT, Tree};

/// A node of a tree: its interval of leaves, and its split unless it is a leaf.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Node {
    /// First leaf.
    pub start: u32,
    /// One past the last leaf.
    pub end: u32,
    /// Its split, by the born leaf; [`NO_SPLIT`] for a leaf.
    pub split: u32,
}

/// The roots of a tree.
pub fn roots(tree: &Tree) -> Vec<Node> {
    tree.roots.iter().map(|root| Node { start: root.start, end: root.end, split: root.split }).collect()
}

/// The two children of a node that splits.
pub fn children(tree: &Tree, node: Node) -> [Node; 2] {
    let split = &tree.splits[node.split as usize];
    [
        Node { start: node.start, end: node.split, split: split.kept },
        Node { start: node.split, end: node.end, split: split.born },
    ]
}

/// The cut in which exactly the nodes are split for which `is_split` says so, from the roots down; by first leaf.
pub fn cut(tree: &Tree, mut is_split: impl FnMut(Node) -> bool) -> Vec<Node> {
    let mut active = Vec::new();
    let mut stack = roots(tree);
    while let Some(node) = stack.pop() {
        if node.split != NO_SPLIT && is_split(node) {
            stack.extend(children(tree, node));
        } else {
            active.push(node);
        }
    }
    active.sort();
    active
}

/// The active ancestor of every leaf, as an index into `active`.
pub fn ancestors(tree: &Tree, active: &[Node]) -> Vec<usize> {
    let mut ancestor = vec![usize::MAX; tree.leaf_count()];
    for (index, node) in active.iter().enumerate() {
        ancestor[node.start as usize..node.end as usize].fill(index);
    }
    ancestor
}

/// The triangles of a cut as first leaves of their corners' active nodes, each rotated so that the smallest comes first;
/// sorted. (A list, not a set: the same corners may carry several triangles.)
pub fn triangles(tree: &Tree, active: &[Node]) -> Vec<[u32; 3]> {
    let ancestor = ancestors(tree, active);
    let mut triangles: Vec<[u32; 3]> = tree
        .triangles
        .corners
        .iter()
        .map(|corners| corners.map(|leaf| active[ancestor[leaf as usize]].start))
        .filter(|corners| corners.iter().collect::<BTreeSet<_>>().len() == 3)
        .map(smallest_first)
        .collect();
    triangles.sort_unstable();
    triangles
}

/// The same triangle, rotated so that its smallest corner comes first.
pub fn smallest_first<T: Ord + Copy>([a, b, c]: [T; 3]) -> [T; 3] {
    if a <= b && a <= c {
        [a, b, c]
    } else if b <= c {
        [b, c, a]
    } else {
        [c, a, b]
    }
}
