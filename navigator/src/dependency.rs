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

use crate::front::{Corner, Entry, Front, NONE, Prepared};
use crate::paging::Paging;

/// How changes of the front depend on each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Dependency {
    /// By the ids of the neighbours, as in the paper: the front is a state of the construction.
    #[default]
    Implicit,
    /// By what is drawn: each node by its own error; but where a triangle would be turned round, nodes around it are split until
    /// it is not, see `flip`. Always a mesh of a cut, without cracks.
    Flip,
    /// Not at all: each node by its own error. Always a mesh of a cut, without cracks; but it may fold over.
    None,
}

/// When a corner was moved to the active node that it is at, by the id of the collapse that did, or later: the node's
/// id, unless what is known of the kept children below it says more. (0: it never was moved.) Only pages in use are looked
/// at, and no longer than it may be later than `enough`.
fn last_moved(front: &Front, paging: &Paging, Corner { vertex, leaf }: Corner, enough: u32) -> u32 {
    let mut moved = front.id(vertex);
    let above = front.slot_above(vertex);
    if above == NONE || moved <= enough {
        return moved;
    }
    let (page, mut index) = front.place(vertex);
    if paging.page_number(above) != page {
        return moved;
    }
    let page = paging.page(above);
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

/// Whether the corner of a triangle at a vertex was moved there after the collapse with this id.
fn is_moved_after(front: &Front, paging: &Paging, vertex: u32, triangle: u32, id: u32) -> bool {
    // Seldom is more to be known than the node's id.
    front.id(vertex) > id && {
        let leaf = front.leaf_at(vertex, triangle);
        last_moved(front, paging, Corner { vertex, leaf }, id) > id
    }
}

/// A vertex whose node has to be split before the split that was just prepared can be applied: one with a corner of a triangle
/// that moves to the born child or is born, that was moved there after the node was made.
pub fn blocking_vertex(front: &Front, paging: &Paging, prepared: &Prepared) -> Option<u32> {
    let id = front.id(prepared.vertex());
    let blocking = |entry: Entry| {
        front.others(entry).into_iter().find(|vertex| is_moved_after(front, paging, *vertex, entry.triangle(), id))
    };
    // Of the triangles that have a corner there that moves to the born child; of all where no corner does.
    let mut moves_any = false;
    for entry in front.star(prepared.vertex()).filter(|entry| entry.leaf >= prepared.born_leaf()) {
        moves_any = true;
        if let Some(vertex) = blocking(entry) {
            return Some(vertex);
        }
    }
    if !moves_any && let Some(vertex) = front.star(prepared.vertex()).find_map(blocking) {
        return Some(vertex);
    }
    let late = |corner: &&Corner| front.id(corner.vertex) > id && last_moved(front, paging, **corner, id) > id;
    front.thirds().iter().find(late).map(|corner| corner.vertex)
}

/// Whether a corner of a triangle that the last split bore, at a child of it, was moved there when another corner of the triangle had
/// moved on, so that the child has to be split. `other` is the other child.
pub fn is_born_late(front: &Front, paging: &Paging, child: u32, other: u32) -> bool {
    let (id, of_other) = (front.id(child), front.moved_by(other));
    let may_be_late = |third: &Corner| of_other.min(front.moved_by(third.vertex)) < id;
    front.thirds().iter().any(may_be_late) && is_late(front, paging, child, |others| others.contains(&other))
}

/// Whether a corner at an active node was moved there when another corner of its triangle had moved on, so that the node has
/// to be split. Of its triangles those count whose other corners do.
pub fn is_late(front: &Front, paging: &Paging, vertex: u32, counts: impl Fn([u32; 2]) -> bool) -> bool {
    let id = front.id(vertex);
    front.star(vertex).any(|entry| {
        let others = front.others(entry);
        let moves_on = front.moved_by(others[0]).min(front.moved_by(others[1]));
        let corner = Corner { vertex, leaf: entry.leaf };
        moves_on < id && counts(others) && last_moved(front, paging, corner, moves_on) > moves_on
    })
}

/// Whether a vertex around its children keeps the split that bore `born` from being undone: one whose node had moved on by
/// then, of a triangle that has a corner at the born child. (Where that has none but what vanishes, of any triangle around.)
pub fn collapse_is_blocked(front: &Front, born: u32) -> bool {
    let (id, kept) = (front.id_above(born), front.kept(born));
    let blocks = |vertex: u32| vertex != kept && vertex != born && front.moved_by(vertex) < id;
    let mut moves_any = false;
    for entry in front.star(born) {
        let others = front.others(entry);
        moves_any |= !others.contains(&kept);
        if others.into_iter().any(blocks) {
            return true;
        }
    }
    !moves_any && front.star(kept).flat_map(|entry| front.others(entry)).any(blocks)
}
