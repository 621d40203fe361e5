//! The mesh before the first collapse, on disk: its vertices and triangles in their store, its edges sorted from the
//! cheapest to the dearest (the paper, 3.1.2, step 1).
//!
//! Block by block, each with the state that all of it has in memory (see `initial`). A triangle is in the block of its
//! smallest corner, so the chain of a vertex is begun in earlier blocks and ended in its own.
//!
//! Memory: one block, and the sorter. I/O: the mesh is read twice, the records are written once, 16 bytes are sorted for
//! each edge.

use bytemuck::Zeroable;
use storage::{Edge, GuardedSorted, GuardedSorter, Scratch, StorageError};

use crate::ingest::StoredMesh;
use crate::simplify::collapse::Engine;
use crate::simplify::components::{BlockLabels, Components, Labels};
use crate::simplify::live_mesh::{LiveMesh, Normalisation, Triangle};
use crate::simplify::live_wedges::Heeded;
use crate::simplify::metric::CollapseMetric;
use crate::simplify::records::VertexRecord;
use crate::simplify::{initial, seams};
use crate::tree::ErrorBound;

use super::edges::edge_between;
use super::stored::{Link, MeshStore, StoredTriangle, StoredVertex};

/// Writes a mesh to an empty store. Returns its edges in ascending order, some of them more than once, and its
/// components.
pub(super) fn begin<M: CollapseMetric>(
    mesh: &StoredMesh,
    metric: M,
    scratch: &Scratch,
    memory: usize,
    store: &mut MeshStore<'_>,
) -> Result<(GuardedSorted<Edge>, Components), StorageError> {
    let inboxes = seams::find(mesh, metric, scratch, memory)?.vertices;
    let mut edges = GuardedSorter::new(scratch, "edges", memory / 2);
    let mut labels = Labels::new(scratch);
    // No collapse is made here, so there is no error to be bounded.
    let heeded = Heeded::of(mesh.attributes.as_ref());
    let live = LiveMesh::new(Normalisation::new(mesh.exponent), mesh.bounds[0], ErrorBound::None, heeded);
    let mut engine = Engine::new(live, metric, mesh.exponent, ErrorBound::None);
    let (mut spans, mut known) = (Vec::new(), Vec::new());
    for (number, start) in mesh.blocks.iter().enumerate() {
        let end = mesh.blocks.get(number + 1);
        engine.mesh.clear();
        spans.clear();
        known.clear();
        known.resize(inboxes[number].len() as usize, VertexRecord::zeroed());
        inboxes[number].read_at(0, &mut known)?;
        initial::load(
            &mut engine.mesh,
            &mesh.positions,
            &mesh.triangles,
            [
                [start.first_vertex, end.map_or(store.vertex_count, |end| end.first_vertex)],
                [start.first_triangle, end.map_or(store.triangle_count, |end| end.first_triangle)],
            ],
            &known,
            metric.uses_quadrics(),
            &mut spans,
        )?;
        if let Some(attributes) = &mesh.attributes {
            engine.mesh.load_first_attributes(attributes, start.first_triangle)?;
        }
        let block = BlockLabels::of(&mut engine.mesh, |vertex| spans[vertex].is_shared());
        let raise = labels.add(&block)?;
        engine.mesh.nodes.iter_mut().for_each(|node| node.label += raise);
        write_block(&engine.mesh, store)?;
        push_edges(&engine, &mut edges)?;
    }
    Ok((edges.finish()?, labels.join()?))
}

/// Writes what is in a block, and chains its triangles.
fn write_block(mesh: &LiveMesh, store: &mut MeshStore<'_>) -> Result<(), StorageError> {
    let mut next = vec![[Link::END; 3]; mesh.triangles.len()];
    for (vertex, node) in (0..).zip(&mesh.nodes) {
        // Earlier blocks may have begun the chain.
        let mut star = store.vertex(node.id)?.star;
        for triangle in mesh.star(vertex).iter().rev() {
            let corners = mesh.triangles[*triangle as usize].corners;
            if let Some(corner) = corners.iter().position(|corner| *corner == vertex) {
                next[*triangle as usize][corner] = star;
                star = Link::to(mesh.triangle_ids[*triangle as usize]);
            }
        }
        let line = &mesh.vertices[vertex as usize];
        let (quadric, state) = (line.quadric, line.lasting_state(false));
        store.put_vertex(node.id, &StoredVertex { node: *node, quadric, state, star, rejected: 0 })?;
    }
    for (place, next) in next.into_iter().enumerate() {
        let (Triangle { corners, order }, id) = (mesh.triangles[place], mesh.triangle_ids[place]);
        let corners = corners.map(|corner| mesh.nodes[corner as usize].id);
        store.put_triangle(id, &StoredTriangle { corners, order, next, flags: 0, residual: 0.0, reverse: 0.0 })?;
        store.put_corners(id, mesh.wedges.corners(place))?;
    }
    Ok(())
}

/// Hands on the edges of a block, as the queue in memory would begin with them.
fn push_edges<M: CollapseMetric>(engine: &Engine<M>, edges: &mut GuardedSorter<Edge>) -> Result<(), StorageError> {
    for Triangle { corners, .. } in &engine.mesh.triangles {
        for side in 0..3 {
            let ends = [corners[side], corners[(side + 1) % 3]];
            let special = ends.iter().all(|end| engine.mesh.vertices[*end as usize].is_special());
            if ends[0] < ends[1] || special {
                edges.push(edge_between(engine, ends))?;
            }
        }
    }
    Ok(())
}
