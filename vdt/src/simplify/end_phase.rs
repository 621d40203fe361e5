//! Brings what no legal collapse can reduce down to one root per component: closed parts that ended as tetrahedra, loops
//! around holes, non-manifold knots (design, section 3).
//!
//! It begins at a point that the state defines, when no legal candidate is left, never "when it fits in memory". Each
//! component is taken alone: cheapest edge first, edges made on the way included, without legality tests, until it has no
//! triangle left. The collapse with which its last triangle vanishes has the component's diameter as its switch value:
//! its error is its size. What is then left, single vertices, is joined to one root, neighbours in canonical order first,
//! so that the tree stays flat.
//!
//! What happens to a component depends on nothing but what is left of it. So components can be taken in any order, and
//! only one has to be in memory as a whole.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::collapse::{Candidate, Engine, Outcome, Watched};
use super::components::Components;
use super::live_mesh::Node;
use super::log::LoggedRoot;
use super::metric::CollapseMetric;

/// Runs the end phase on the components for which `is_taken` holds, of which all that is left is in the engine's mesh, and
/// appends their roots. `after_component` takes away what was written down.
pub(super) fn run<M: CollapseMetric, E>(
    engine: &mut Engine<M>,
    components: &Components,
    is_taken: impl Fn(u32) -> bool,
    roots: &mut Vec<LoggedRoot>,
    mut after_component: impl FnMut(&mut Engine<M>) -> Result<(), E>,
) -> Result<(), E> {
    engine.relax();
    let mut vertices: Vec<(u32, u32)> = (0..engine.mesh.vertices.len() as u32)
        .filter(|vertex| !engine.mesh.vertices[*vertex as usize].is_gone())
        .map(|vertex| (components.of(engine.mesh.nodes[vertex as usize].label), vertex))
        .filter(|(component, _)| is_taken(*component))
        .collect();
    vertices.sort_unstable();
    let mut triangles: Vec<(u32, u32)> = (0..engine.mesh.triangles.len())
        .filter(|triangle| engine.mesh.is_live(*triangle))
        .map(|triangle| {
            let corner = engine.mesh.triangles[triangle].corners[0];
            (components.of(engine.mesh.nodes[corner as usize].label), triangle as u32)
        })
        .filter(|(component, _)| is_taken(*component))
        .collect();
    triangles.sort_unstable();
    let mut triangles = triangles.chunk_by(|a, b| a.0 == b.0).peekable();
    let mut heap = BinaryHeap::new();
    for vertices in vertices.chunk_by(|a, b| a.0 == b.0) {
        let component = vertices[0].0;
        let triangles = triangles.next_if(|triangles| triangles[0].0 == component).unwrap_or_default();
        let diameter = ((components.diameter(component) / engine.unit()) as f32).next_up();
        engine.watched = Watched { triangles: triangles.len() as u32, diameter };
        collapse_all(engine, triangles, &mut heap);
        let root = join_remains(engine, vertices);
        let Node { id: vertex, leaves, last_split: split, normal, .. } = engine.mesh.nodes[root as usize];
        roots.push(LoggedRoot { vertex, leaves, split, outward: components.outward(component), normal });
        after_component(engine)?;
    }
    Ok(())
}

/// Collapses edges, the cheapest first, until no triangle of the component is left.
fn collapse_all<M: CollapseMetric>(
    engine: &mut Engine<M>,
    triangles: &[(u32, u32)],
    heap: &mut BinaryHeap<Reverse<Candidate>>,
) {
    heap.clear();
    for (_, triangle) in triangles {
        let corners = engine.mesh.triangles[*triangle as usize].corners;
        for side in 0..3 {
            heap.push(Reverse(engine.candidate(corners[side], corners[(side + 1) % 3])));
        }
    }
    let mut ring = Vec::new();
    while let Some(Reverse(candidate)) = heap.pop() {
        match engine.attempt(candidate) {
            Outcome::Gone | Outcome::Illegal => {}
            Outcome::Grown(again) | Outcome::OtherWay(again) | Outcome::Raised(again) => heap.push(Reverse(again)),
            Outcome::Collapsed { stays } => {
                // The quadric of `stays` has changed, and with it the keys of all its edges.
                engine.mesh.fill_ring(stays, &mut ring);
                for other in ring.as_flattened() {
                    heap.push(Reverse(engine.candidate(stays, *other)));
                }
            }
        }
    }
}

/// Joins the vertices that are left of a component to one root, and names it.
fn join_remains<M: CollapseMetric>(engine: &mut Engine<M>, vertices: &[(u32, u32)]) -> u32 {
    let is_left = |vertex: &u32| !engine.mesh.vertices[*vertex as usize].is_gone();
    let mut remains: Vec<u32> = vertices.iter().map(|(_, vertex)| *vertex).filter(is_left).collect();
    let latest = remains.iter().map(|vertex| engine.mesh.nodes[*vertex as usize].order).fold(0, u32::max);
    let diameter = engine.watched.diameter;
    while remains.len() > 1 {
        for pair in remains.chunks_exact(2) {
            engine.join(pair[0], pair[1], diameter, latest);
        }
        remains = remains.into_iter().step_by(2).collect();
    }
    remains[0]
}
