//! The paper's order (3.1): always the edge with the smallest key, edges made on the way included, through one priority
//! queue in memory. This is step 5 of the paper's 3.1.2, for a mesh that fits; the order to which the others are held.
//!
//! An edge that is not legal is taken out, and comes back when the star of one of its ends changes. Each edge is on the
//! rejected list at most once: lists at both ends without that were seen to multiply entries a thousandfold.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};

use super::collapse::{Candidate, Engine, Outcome};
use super::metric::CollapseMetric;

/// What waits for the queue to go on.
#[derive(Debug, Default)]
pub(super) struct Waiting {
    /// The edges in the queue.
    pub heap: BinaryHeap<Reverse<Candidate>>,
    /// Edges that were found illegal, smaller vertex first.
    pub rejected: HashSet<(u32, u32)>,
}

impl Waiting {
    /// All edges of a mesh, before the first collapse.
    pub fn all<M: CollapseMetric>(engine: &Engine<M>) -> Self {
        let mut heap = BinaryHeap::new();
        for corners in engine.mesh.triangles.iter().map(|triangle| triangle.corners) {
            for side in 0..3 {
                let (a, b) = (corners[side], corners[(side + 1) % 3]);
                // Twice for most special edges; the second finds its edge gone or rejected.
                let special = [a, b].iter().all(|end| engine.mesh.vertices[*end as usize].is_special());
                if a < b || special {
                    heap.push(Reverse(engine.candidate(a, b)));
                }
            }
        }
        Waiting { heap, rejected: HashSet::new() }
    }
}

/// Collapses until no legal candidate is left. `after_some` takes away what was
/// written down.
pub(super) fn run<M: CollapseMetric, E>(
    engine: &mut Engine<M>,
    waiting: Waiting,
    mut after_some: impl FnMut(&mut Engine<M>) -> Result<(), E>,
) -> Result<(), E> {
    let Waiting { mut heap, mut rejected } = waiting;
    // For each vertex how many of its edges are rejected.
    let mut rejected_at = vec![0_u32; engine.mesh.vertices.len()];
    for (low, high) in &rejected {
        rejected_at[*low as usize] += 1;
        rejected_at[*high as usize] += 1;
    }
    let mut ring = Vec::new();
    while let Some(Reverse(candidate)) = heap.pop() {
        let (low, high) = candidate.vertices();
        match engine.attempt(candidate) {
            // One whose key has grown is in the queue with the new key, too: its end that took over a quadric saw to that.
            Outcome::Gone | Outcome::Grown(_) => {}
            Outcome::OtherWay(again) | Outcome::Raised(again) => heap.push(Reverse(again)),
            Outcome::Illegal => {
                if rejected.insert((low, high)) {
                    rejected_at[low as usize] += 1;
                    rejected_at[high as usize] += 1;
                }
            }
            Outcome::Collapsed { stays } => {
                neighbours(engine, stays, &mut ring);
                // The quadric of `stays` has changed, and with it the keys of all its edges.
                for other in &ring {
                    heap.push(Reverse(engine.candidate(stays, *other)));
                }
                let around = std::mem::take(&mut ring);
                for vertex in around.iter().copied().chain([stays]) {
                    if rejected_at[vertex as usize] == 0 {
                        continue;
                    }
                    neighbours(engine, vertex, &mut ring);
                    for other in &ring {
                        if rejected.remove(&(vertex.min(*other), vertex.max(*other))) {
                            rejected_at[vertex as usize] -= 1;
                            rejected_at[*other as usize] -= 1;
                            heap.push(Reverse(engine.candidate(vertex, *other)));
                        }
                    }
                }
                ring = around;
                if engine.collapses.len() >= 4096 {
                    after_some(engine)?;
                }
            }
        }
    }
    after_some(engine)
}

/// The vertices next to `vertex`, sorted, each once.
pub(super) fn neighbours<M: CollapseMetric>(engine: &Engine<M>, vertex: u32, ring: &mut Vec<u32>) {
    ring.clear();
    let star = engine.mesh.star(vertex).iter();
    ring.extend(star.flat_map(|triangle| engine.mesh.others(*triangle, vertex)));
    ring.sort_unstable();
    ring.dedup();
}
