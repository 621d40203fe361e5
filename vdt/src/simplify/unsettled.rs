//! Which collapses a block of an external pass may decide by itself (design, section 3; the proof is in
//! `docs/exactness.md`).
//!
//! A vertex is *unsettled* in a block when what the block knows of it may not be true: at first the vertices that have
//! triangles in other blocks too, since collapses there can change them, and one ring more, since a collapse of a seam
//! vertex changes the stars of its ring. An edge with an unsettled end is not decided when its turn comes. Whatever its
//! collapse, in either direction, could change is unsettled from then on: the rings of both ends. So an edge that is
//! decided sees the true stars, quadrics and keys, and is decided as it would be in core.

use super::live_mesh::LiveMesh;

/// Unsettles what is so from the start: the vertices for which `is_shared` holds, and their rings.
pub(super) fn unsettle_seams(mesh: &mut LiveMesh, is_shared: impl Fn(usize) -> bool) {
    for triangle in 0..mesh.triangles.len() {
        let corners = mesh.triangles[triangle].corners;
        if corners.iter().any(|corner| is_shared(*corner as usize)) {
            corners.into_iter().for_each(|corner| mesh.unsettle(corner));
        }
    }
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
