//! The state of the mesh before the first collapse: special vertices, quadrics, the cones and normals of the leaves.
//!
//! All of it follows, vertex by vertex, from the triangles at a vertex, summed in canonical order. So a vertex comes out
//! the same whether its star is found in the whole mesh, in a block, or in a list of the triangles at the seams.

use storage::{Spool, StorageError};

use crate::tree::{Normal, leaf_cone, vertex_normal};
use crate::vector::{cross, dot, minus};

use super::live_mesh::{LiveMesh, Node, Triangle, edge_use};
use super::metric::Quadric;
use super::records::{Span, VertexRecord};

/// Bytes of a buffer for reading.
const BUFFER: usize = 256 << 10;

/// What a vertex begins with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct InitialVertex {
    /// Whether one of its edges is not regular.
    pub is_special: bool,
    /// The planes around it, zero where no quadrics are used.
    pub quadric: Quadric,
    /// The normals around it, as a word.
    pub cone: u32,
    /// Their sum, by the areas of the triangles.
    pub normal: Normal,
}

/// Finds what a vertex begins with. `ring` has the corners after the vertex of every triangle at it, in canonical order;
/// `spokes` their displacements from the vertex, normalised.
pub(super) fn initial_vertex(ring: &[[u32; 2]], spokes: &[[[f64; 3]; 2]], with_quadric: bool) -> InitialVertex {
    let is_special = ring.as_flattened().iter().any(|other| !edge_use(ring, *other).is_regular());
    let mut quadric = Quadric::default();
    if with_quadric {
        for (ends, [next, previous]) in ring.iter().zip(spokes) {
            let normal = cross(*next, *previous);
            let area = dot(normal, normal).sqrt() * 0.5;
            quadric.add_plane_through_vertex(normal, area);
            if is_special {
                for (end, spoke) in ends.iter().zip([next, previous]) {
                    if !edge_use(ring, *end).is_regular() {
                        quadric.add_plane_through_vertex(cross(*spoke, normal), dot(*spoke, *spoke));
                    }
                }
            }
        }
    }
    let normals = spokes.iter().map(|[next, previous]| cross(*next, *previous));
    let (cone, normal) = (leaf_cone(normals.clone()).to_word(), vertex_normal(normals));
    InitialVertex { is_special, quadric, cone, normal }
}

/// Reads the vertices of a range of a mesh, and the triangles of another one, into an empty live mesh, as they are before
/// the first collapse. `seam_vertices`, ascending, are those of the corners that have triangles elsewhere
/// or are beyond `end`: they are known already.
pub(super) fn load(
    live: &mut LiveMesh,
    positions: &Spool<[f32; 3]>,
    triangles: &Spool<[u32; 3]>,
    [[first_vertex, end_vertex], [first_triangle, end_triangle]]: [[u32; 2]; 2],
    seam_vertices: &[VertexRecord],
    with_quadrics: bool,
    spans: &mut Vec<Span>,
) -> Result<(), StorageError> {
    // Places of the block's own vertices in the live mesh.
    let own = (end_vertex - first_vertex) as usize;
    let mut places = vec![u32::MAX; own];
    let (own_seams, foreign) =
        seam_vertices.split_at(seam_vertices.partition_point(|record| record.node.id < end_vertex));
    let mut is_known = vec![false; own];
    for record in own_seams {
        is_known[(record.node.id - first_vertex) as usize] = true;
    }
    let count = (end_triangle - first_triangle) as usize;
    live.reserve(own + foreign.len(), count);
    // Own vertices none of whose triangles is in this block have records in other blocks only.
    let mut reader = triangles.reader_of(first_triangle.into(), end_triangle.into(), BUFFER);
    let mut id = first_triangle;
    while let Some(corners) = reader.next()? {
        for corner in corners {
            if let Some(place) = corner.checked_sub(first_vertex).and_then(|own| places.get_mut(own as usize)) {
                *place = 0;
            }
        }
        live.push_triangle(id, Triangle { corners, order: 0 }, 0.0);
        id += 1;
    }
    let mut reader = positions.reader_of(first_vertex.into(), end_vertex.into(), BUFFER);
    let mut known = own_seams.iter();
    let mut index = 0;
    while let Some(position) = reader.next()? {
        let record = if is_known[index] { known.next() } else { None };
        if places[index] != u32::MAX {
            places[index] = live.vertices.len() as u32;
            match record {
                Some(VertexRecord { node, quadric, state, span }) => {
                    live.push_vertex(*node, *quadric, *state);
                    spans.push(*span);
                }
                None => {
                    spans.push(Span::NONE);
                    let node = Node::leaf(first_vertex + index as u32, position, 0, Normal::UP);
                    live.push_vertex(node, Quadric::default(), 0);
                }
            }
        }
        index += 1;
    }
    let first_foreign = live.vertices.len() as u32;
    for VertexRecord { node, quadric, state, span } in foreign {
        live.push_vertex(*node, *quadric, *state);
        spans.push(*span);
    }
    for Triangle { corners, .. } in &mut live.triangles {
        *corners = corners.map(|corner| match places.get(corner.wrapping_sub(first_vertex) as usize) {
            Some(place) => *place,
            None => first_foreign + foreign.partition_point(|record| record.node.id < corner) as u32,
        });
    }
    live.build_stars();

    let (mut ring, mut spokes) = (Vec::new(), Vec::new());
    for vertex in 0..first_foreign {
        if is_known[(live.nodes[vertex as usize].id - first_vertex) as usize] {
            continue;
        }
        live.fill_ring(vertex, &mut ring);
        let position = |vertex: u32| live.vertices[vertex as usize].position.map(f64::from);
        let centre = position(vertex);
        spokes.clear();
        spokes.extend(ring.iter().map(|ends| ends.map(|end| minus(position(end), centre))));
        let InitialVertex { is_special, quadric, cone, normal } = initial_vertex(&ring, &spokes, with_quadrics);
        live.vertices[vertex as usize].quadric = quadric;
        let node = &mut live.nodes[vertex as usize];
        (node.cone, node.normal) = (cone, normal);
        if is_special {
            live.mark_special(vertex);
        }
    }
    Ok(())
}
