//! What comes after the loads: the rest of the mesh into memory (the paper, 3.1.2, step 5), or, where no edge is left
//! before it fits, the end phase, some components at a time.
//!
//! Memory of the latter: the components in memory and the sorter. I/O: all that is left is read once to sort it by
//! component, and once more by number.

use std::cmp::Reverse;

use bytemuck::{Pod, Zeroable};
use storage::{Edge, EdgeTree, SortRecord, Sorted, Sorter, StorageError};

use crate::simplify::collapse::Engine;
use crate::simplify::components::Components;
use crate::simplify::end_phase;
use crate::simplify::journal::Journal;
use crate::simplify::live_mesh::Triangle;
use crate::simplify::log::LoggedRoot;
use crate::simplify::metric::CollapseMetric;
use crate::simplify::plan::{Carried, Plan};
use crate::simplify::queue::Waiting;

use super::edges::{candidate, ends};
use super::stored::{MeshStore, StoredTriangle, StoredVertex};
use super::{SpannedError, Task};

/// Bytes of an edge in the queue in memory, with the room that the queue takes to grow.
const QUEUED_BYTES: u64 = 3 * 16;

/// Whether what is left fits in so many bytes, with the queue.
pub(super) fn fits(store: &MeshStore<'_>, carried: Carried, edges: u64, bytes: u64) -> bool {
    Plan::memory_for_core(store.live_triangles, carried).0 + edges * QUEUED_BYTES <= bytes
}

/// All edges that are left in the tree.
pub(super) fn drain(tree: &mut dyn EdgeTree) -> Result<Vec<Edge>, SpannedError> {
    let mut edges = Vec::with_capacity(tree.len() as usize);
    tree.delete_smallest(&mut |edge| {
        edges.push(edge);
        true
    })?;
    Ok(edges)
}

/// Loads all that is left into an engine's empty mesh. Returns what the queue goes on with: these edges.
pub(super) fn load_all<M: CollapseMetric>(
    engine: &mut Engine<M>,
    store: &mut MeshStore<'_>,
    edges: Vec<Edge>,
) -> Result<Waiting, SpannedError> {
    engine.mesh.reserve(store.live_vertices as usize, store.live_triangles as usize);
    for id in 0..store.vertex_count {
        let vertex = store.vertex(id)?;
        if !vertex.is_gone() {
            engine.mesh.push_vertex(vertex.node, vertex.quadric, vertex.state);
        }
    }
    store.load_wedges(&mut engine.mesh)?;
    let mut waiting = Waiting::default();
    for id in 0..store.triangle_count {
        let triangle = store.triangle(id)?;
        if !triangle.is_gone() {
            push_triangle(engine, store, id, &triangle, &mut waiting)?;
        }
    }
    engine.mesh.build_stars();
    // Edges with an end that is gone are void.
    let candidates = edges.into_iter().filter_map(|edge| {
        let [low, high] = ends(edge).map(|id| place_of(engine, id));
        Some(Reverse(candidate(edge, [low?, high?])))
    });
    waiting.heap = candidates.collect::<Vec<_>>().into();
    Ok(waiting)
}

/// The local id of a vertex, if it is left. Local ids ascend with the canonical ones.
fn place_of<M>(engine: &Engine<M>, id: u32) -> Option<u32> {
    engine.mesh.vertices.binary_search_by_key(&id, |vertex| vertex.id).ok().map(|place| place as u32)
}

fn push_triangle<M>(
    engine: &mut Engine<M>,
    store: &mut MeshStore<'_>,
    id: u32,
    triangle: &StoredTriangle,
    waiting: &mut Waiting,
) -> Result<(), StorageError> {
    let [Some(a), Some(b), Some(c)] = triangle.corners.map(|corner| place_of(engine, corner)) else { return Ok(()) };
    let corners = [a, b, c];
    let place = engine.mesh.triangles.len();
    engine.mesh.push_triangle(id, Triangle { corners, order: triangle.order }, triangle.residual);
    engine.mesh.covers.set_reverse(place, triangle.reverse);
    engine.mesh.wedges.set_corners(place, store.corners(id)?);
    for piece in store.cut_pieces(id, triangle)?.in_order().iter().rev() {
        engine.mesh.covers.add_piece(place, piece);
    }
    for side in (0..3).filter(|side| triangle.flags >> side & 1 != 0) {
        let ends = [corners[side], corners[(side + 1) % 3]];
        waiting.rejected.insert((ends[0].min(ends[1]), ends[0].max(ends[1])));
    }
    Ok(())
}

/// A vertex or a triangle by the component that it belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct Member {
    component: u32,
    id: u32,
}

impl SortRecord for Member {
    fn prefix(&self) -> u64 {
        u64::from(self.component) << 32 | u64::from(self.id)
    }
}

/// Members of components, one component after the other.
struct Members {
    sorted: Sorted<Member>,
    next: Option<Member>,
}

impl Members {
    fn of(sorter: Sorter<Member>) -> Result<Self, StorageError> {
        let mut sorted = sorter.finish()?;
        let next = sorted.next()?;
        Ok(Members { sorted, next })
    }

    /// Appends the members of a component.
    fn take(&mut self, component: u32, ids: &mut Vec<u32>) -> Result<(), StorageError> {
        while let Some(member) = self.next.filter(|member| member.component == component) {
            ids.push(member.id);
            self.next = self.sorted.next()?;
        }
        Ok(())
    }
}

/// Runs the end phase on all that is left, of which no more than the share of the core is in memory at once, unless a component is
/// larger. Returns the roots.
pub(super) fn end_phase<M: CollapseMetric>(
    engine: &mut Engine<M>,
    store: &mut MeshStore<'_>,
    components: &Components,
    task: &Task<'_, M>,
    journal: &Journal,
) -> Result<Vec<LoggedRoot>, SpannedError> {
    let Task { scratch, shares, .. } = *task;
    let carried = task.carried();
    let bytes = shares.core;
    let sorter = || Sorter::new(scratch, "component-members", bytes as usize / 4, 1);
    let (mut vertices, mut triangles) = (sorter(), sorter());
    for id in 0..store.vertex_count {
        let vertex: StoredVertex = store.vertex(id)?;
        if !vertex.is_gone() {
            vertices.push(Member { component: components.of(vertex.node.label), id })?;
        }
    }
    for id in 0..store.triangle_count {
        let triangle = store.triangle(id)?;
        if !triangle.is_gone() {
            let label = store.vertex(triangle.corners[0])?.node.label;
            triangles.push(Member { component: components.of(label), id })?;
        }
    }
    let (mut vertices, mut triangles) = (Members::of(vertices)?, Members::of(triangles)?);
    let mut roots = Vec::new();
    let (mut vertex_ids, mut triangle_ids) = (Vec::new(), Vec::new());
    while vertices.next.is_some() {
        vertex_ids.clear();
        triangle_ids.clear();
        while let Some(Member { component, .. }) = vertices.next {
            vertices.take(component, &mut vertex_ids)?;
            triangles.take(component, &mut triangle_ids)?;
            if Plan::memory_for_core(triangle_ids.len() as u64, carried).0 >= bytes / 4 {
                break;
            }
        }
        let needed = Plan::memory_for_core(triangle_ids.len() as u64, carried);
        if needed.0 > bytes {
            return Err(SpannedError::Component { triangles: triangle_ids.len() as u64, needed, share: bytes });
        }
        vertex_ids.sort_unstable();
        engine.mesh.clear();
        for id in &vertex_ids {
            let vertex = store.vertex(*id)?;
            engine.mesh.push_vertex(vertex.node, vertex.quadric, vertex.state);
        }
        store.load_wedges(&mut engine.mesh)?;
        for id in &triangle_ids {
            let triangle = store.triangle(*id)?;
            push_triangle(engine, store, *id, &triangle, &mut Waiting::default())?;
        }
        engine.mesh.build_stars();
        end_phase::run(engine, components, |_| true, &mut roots, |engine| journal.take(engine))?;
    }
    Ok(roots)
}
