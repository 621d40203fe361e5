//! Edges as the tree on disk has them, by canonical ids, and as the engine has them, by local ones.

use storage::Edge;

use crate::simplify::collapse::{Candidate, Engine, hash_pair};
use crate::simplify::metric::CollapseMetric;

/// Bit of [`Edge::high`]: the dearer direction is meant.
const DEARER: u32 = 1 << 31;

/// An edge by its canonical ends.
pub(super) fn edge_of(ends: [u32; 2], key: u32) -> Edge {
    let (low, high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
    Edge { key, tie: hash_pair(low, high), low, high }
}

/// The cheaper direction of the edge between two vertices, given by local ids.
pub(super) fn edge_between<M: CollapseMetric>(engine: &Engine<M>, ends: [u32; 2]) -> Edge {
    let [a, b] = ends.map(|end| &engine.mesh.vertices[end as usize]);
    let keys = engine.edge_keys(a, b);
    edge_of([a.id, b.id], keys[0].min(keys[1]))
}

/// The canonical ends of an edge.
pub(super) fn ends(edge: Edge) -> [u32; 2] {
    [edge.low, edge.high & !DEARER]
}

pub(super) fn is_dearer(edge: Edge) -> bool {
    edge.high & DEARER != 0
}

/// The same edge at the key of its dearer direction.
pub(super) fn dearer(edge: Edge, key: u32) -> Edge {
    Edge { key, high: edge.high | DEARER, ..edge }
}

/// An edge as the engine tries it, with its ends by local ids.
pub(super) fn candidate(edge: Edge, local: [u32; 2]) -> Candidate {
    let candidate = Candidate::of(local, ends(edge), edge.key);
    if is_dearer(edge) { candidate.dearer(edge.key) } else { candidate }
}
