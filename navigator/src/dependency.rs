//! Implicit dependency (the paper, 3.3.5): whether a split or a collapse is safe, told from the ids of the nodes
//! around.
//!
//! The nodes were numbered in the order in which the collapses of the build made them: leaves first, then 0 to the last
//! collapse. A node *lives*, in the construction, from its own collapse to its parent's: at the times from its id to
//! just before its parent's id. The front keeps, for every active triangle, that the lives of its three corners overlap
//! pairwise: `id(a) < id(parent(b))` for each two of them. Intervals that overlap pairwise have a time in common
//! (Helly), and at that time the triangle was in the mesh, just as it is drawn. So nothing is ever drawn that the
//! construction had not tested for fold-over.
//!
//! - A node may split if its id is greater than the ids of all its neighbours, and than those of the third corners of
//!   the triangles that its split bears: they are then alive when the node's children are.
//! - A node may be restored, its children collapsed, if its id is less than the ids of the parents of all nodes around
//!   the children.
//! - Where a third corner is not a neighbour of the node before the split (it is, but at some borders and knots), it
//!   may lie so much deeper that it was gone before a child of the node came to be. That child has to split too, at
//!   once.
//!
//! A neighbour with a greater id has to be split first; else a region with a large error would wait for ever for a
//! neighbour that is out of sight. Those forced splits form chains of rising ids, so they end.

use crate::front::{Front, Prepared};

/// How changes of the front depend on each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Dependency {
    /// By the ids of the neighbours, as in the paper: every active triangle is one of the construction.
    #[default]
    Implicit,
    /// Not at all: each node by its own error. Always a mesh of a cut, without cracks; but it may fold over.
    None,
}

/// A node that has to be split before the split that was just prepared can be: its id is greater (or equal, in a damaged
/// file), and it has a corner in common with what moves to the born child, or is a third corner of a triangle that is born.
pub fn blocking_node(front: &Front, prepared: &Prepared) -> Option<u32> {
    let id = front.id(prepared.node());
    front.around_moved(prepared).chain(front.thirds().iter().copied()).find(|other| front.id(*other) >= id)
}

/// When the first of the third corners of the split prepared last moves on: the children of the node that is split must
/// not have come to be as late. `None` without third corners.
pub fn thirds_moved_on(front: &Front) -> Option<u32> {
    front.thirds().iter().map(|third| front.moved_by(*third)).min()
}

/// Whether an active node came to be when a neighbour had moved on, so that it has to be split.
pub fn is_late(front: &Front, node: u32) -> bool {
    let id = front.id(node);
    front.star(node).flatten().any(|neighbour| front.moved_by(neighbour) <= id)
}

/// Whether a node around its children keeps a collapsible node from being restored.
pub fn collapse_is_blocked(front: &Front, node: u32) -> bool {
    let id = front.id(node);
    let children = front.children(node);
    let mut around = children.into_iter().flat_map(|child| front.star(child)).flatten();
    around.any(|neighbour| front.moved_by(neighbour) <= id && !children.contains(&neighbour))
}
