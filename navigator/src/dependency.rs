//! Implicit dependency (the paper, 3.3.5): whether a split or a collapse is safe, told from the ids of the nodes
//! around.
//!
//! The id of a collapse is larger than those of all that it depends on; leaves have 0. A collapse *moves* the corners at the born child to the kept child's place; those at the kept child stay where
//! they are. The front keeps, for every active triangle, that of all the collapses that move one of its corners those that
//! are not undone come before those that are: for each two of its corners, at the nodes a and b, that at a was moved there
//! last no later than the next collapse that moves what is at b, by their ids (`docs/error.md`, section 4). (Where those have
//! the same id, neither depends on the other.) So the front is a state of the
//! construction, made in some order: nothing is ever drawn that was not tested for fold-over, and errors are bounded.
//!
//! - A node may split if it did not come to be before the corners next to those that move back were moved last: at the triangles
//!   around it that have a corner under the born child, and at those that its split bears.
//! - A node may be restored, its children collapsed, if its id is not above that of the next collapse to move any of the
//!   nodes around the born child.
//! - Where a third corner is not a neighbour of the node before the split (it is, but at some borders and knots), it
//!   may lie so much deeper that it moved on before a corner at a child was moved there. That child has to split too, at
//!   once.
//!
//! When a corner was moved last is known to be no later than its node came to be (the paper's rule), and more exactly where
//! the kept children below the node are in a page in use.
//!
//! A node that came to be later has to be split first; else a region with a large error would wait for ever for a
//! neighbour that is out of sight. Those forced splits form chains of rising ids, so they end.

use metanode::page::Target;

use crate::front::{Corner, Front, NONE, Prepared, State};
use crate::paging::Paging;

/// How changes of the front depend on each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Dependency {
    /// By the ids of the neighbours, as in the paper: the front is a state of the construction.
    #[default]
    Implicit,
    /// Not at all: each node by its own error. Always a mesh of a cut, without cracks; but it may fold over.
    None,
}

/// When a corner was moved to the active node that it is at, by the id of the collapse that did, or later: the node's
/// id, unless what is known of the kept children below it says more. (0: it never was moved.) Only pages in use are looked
/// at, and no longer than it may be later than `enough`.
pub fn last_moved(front: &Front, paging: &Paging, Corner { node, leaf }: Corner, enough: u32) -> u32 {
    let mut moved = front.id(node);
    let parent = front.parent(node);
    if front.state(node) == State::Leaf {
        return 0;
    }
    if parent == NONE || moved <= enough {
        return moved;
    }
    let slot = front.page_or_slot(parent);
    if paging.page_number(slot) != front.page_or_slot(node) {
        return moved;
    }
    let page = paging.page(slot);
    let mut index = front.record(node);
    // As many steps as there are records, whatever a damaged file says.
    for _ in 0..page.counts().records {
        let Some(record) = page.record(index) else { break };
        if leaf >= record.born_leaf {
            break;
        }
        let Some(kept) = record.kept else { return 0 };
        moved = moved.min(kept.id);
        match kept.target {
            Target::SamePage { record } if moved > enough => index = record,
            _ => break,
        }
    }
    moved
}

/// A node that has to be split before the split that was just prepared can be: one with a corner of a triangle that moves to
/// the born child or is born, that was moved there after the node was made.
pub fn blocking_node(front: &Front, paging: &Paging, prepared: &Prepared) -> Option<u32> {
    let id = front.id(prepared.node());
    let mut corners = front.around_moved(prepared).chain(front.thirds().iter().copied());
    corners.find(|corner| last_moved(front, paging, *corner, id) > id).map(|corner| corner.node)
}

/// Whether a corner at an active node was moved there when another corner of its triangle had moved on, so that the node has
/// to be split. Of its triangles those count that have a corner at `other`, if there is one given.
pub fn is_late(front: &Front, paging: &Paging, node: u32, other: Option<u32>) -> bool {
    let id = front.id(node);
    front.corners_around(node).any(|(leaf, others)| {
        let counts = other.is_none_or(|other| others.iter().any(|corner| corner.node == other));
        let moves_on = front.moved_by(others[0].node).min(front.moved_by(others[1].node));
        counts && moves_on < id && last_moved(front, paging, Corner { node, leaf }, moves_on) > moves_on
    })
}

/// Whether a node around its children keeps a collapsible node from being restored: one that had moved on by then, of a
/// triangle that has a corner at the born child. (Where that has none but what vanishes, of any triangle around.)
pub fn collapse_is_blocked(front: &Front, node: u32) -> bool {
    let id = front.id(node);
    let [kept, born] = front.children(node);
    let moves_any = front.star(born).any(|others| !others.contains(&kept));
    let around_kept = (!moves_any).then(|| front.star(kept)).into_iter().flatten();
    let mut around = front.star(born).chain(around_kept).flatten();
    around.any(|neighbour| front.moved_by(neighbour) < id && neighbour != kept && neighbour != born)
}
