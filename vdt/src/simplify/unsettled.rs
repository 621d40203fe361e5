//! Which collapses a block of an external pass may decide by itself (design, section 3; the proof is in
//! `docs/exactness.md`).
//!
//! A vertex is *unsettled* in a block when what the block knows of it may not be true: at first the vertices that have
//! triangles in other blocks too, since collapses there can change them, and one ring more, since a collapse of a seam
//! vertex changes the stars of its ring. An edge with an unsettled end is not decided when its turn comes. Whatever its
//! collapse, in either direction, could change is unsettled from then on: the rings of both ends. So an edge that is
//! decided sees the true stars, quadrics and keys, and is decided as it would be in core.
//!
//! A pass may do several rounds in one go. When a round begins that is not the first, what is unsettled by then is *stale*:
//! whether its edges are in the batch of the round, and at which key, is not known here. So nothing near them is decided:
//! two rings more are unsettled.

use super::live_mesh::LiveMesh;

/// Unsettles what is so from the start: the vertices for which `is_shared` holds, and their rings.
pub(super) fn unsettle_seams(mesh: &mut LiveMesh, is_shared: impl Fn(usize) -> bool) {
    for triangle in 0..mesh.triangles.len() {
        let corners = mesh.triangles[triangle].corners;
        if mesh.is_live(triangle) && corners.iter().any(|corner| is_shared(*corner as usize)) {
            corners.into_iter().for_each(|corner| mesh.unsettle(corner));
        }
    }
}

/// Begins a round of this index in the pass, 1 or more. `is_near` receives, for each vertex, whether it is stale or next to
/// one that is: what the edges of the round that are not seen here are the ends of.
pub(super) fn begin_round(mesh: &mut LiveMesh, round_index: u8, is_near: &mut Vec<bool>) {
    mesh.make_stale(round_index);
    is_near.clear();
    is_near.resize(mesh.vertices.len(), false);
    for triangle in mesh.triangles.iter().filter(|triangle| !triangle.is_gone()) {
        if triangle.corners.iter().any(|corner| mesh.vertices[*corner as usize].is_stale()) {
            triangle.corners.into_iter().for_each(|corner| is_near[corner as usize] = true);
        }
    }
    unsettle_seams(mesh, |vertex| is_near[vertex]);
}

/// Unsettles what the collapse of an edge, in either direction, could change.
pub(super) fn unsettle_rings(mesh: &mut LiveMesh, low: u32, high: u32) {
    for end in [low, high] {
        mesh.unsettle(end);
        for index in 0..mesh.star(end).len() {
            let triangle = mesh.star(end)[index] as usize;
            mesh.triangles[triangle].corners.into_iter().for_each(|corner| mesh.unsettle(corner));
        }
    }
}
