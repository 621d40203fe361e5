//! From the history of collapses to the finished tree: numbering, leaf intervals, born triangles.
//!
//! - Leaves are renumbered in depth-first order of the forest, the kept child first; trees by their root's canonical id.
//! - Ids: leaves 0..n, inner nodes n + their rank by (switch value as stored, build order): a linear extension of the
//!   dependency DAG, since switch values are monotone over it (the paper, 3.3.5; design, section 1).
//! - A triangle is born at the split that undoes the collapse at which it died: the deepest node that holds two of its
//!   corners.
//!
//! All by counting and by passes in build order or against it, without recursion: the tree may be deep. Memory: what the
//! tree itself takes, and 20 bytes for each vertex and 4 for each triangle on top.

use crate::ingest::CoreMesh;
use crate::simplify::History;

use super::record::{BornTriangles, NO_SPLIT, Root, Split, Tree};
use super::{bounding_spheres, normal_cones};

/// Makes the tree of a mesh and the history of its simplification.
pub fn finish(mesh: CoreMesh, history: History) -> Tree {
    let leaf_count = mesh.positions.len();
    let collapses = &history.collapses;
    // Nodes: leaf i is i, the node of collapse i is leaf_count + i.
    let mut node_of: Vec<u32> = (0..leaf_count as u32).collect();
    let mut children = Vec::with_capacity(collapses.len());
    let mut size = vec![1_u32; leaf_count];
    let mut is_root = vec![true; leaf_count];
    for (index, collapse) in collapses.iter().enumerate() {
        let (kept, born) = (collapse.kept as usize, collapse.born as usize);
        children.push([node_of[kept], node_of[born]]);
        node_of[kept] = (leaf_count + index) as u32;
        is_root[born] = false;
        size[kept] += size[born];
    }

    // First leaves, from the roots down. `first[node]` for inner nodes; leaves get their number in `renumbered`.
    let mut first = vec![0_u32; collapses.len()];
    let mut renumbered = vec![0_u32; leaf_count];
    let mut roots = Vec::new();
    let mut next = 0;
    for vertex in (0..leaf_count).filter(|vertex| is_root[*vertex]) {
        let node = node_of[vertex] as usize;
        if node >= leaf_count {
            first[node - leaf_count] = next;
            roots.push(Root { start: next, end: next + size[vertex], split: node as u32 });
        }
        next += size[vertex];
    }
    drop(is_root);
    drop(node_of);
    // Against the build order, the sizes go back to what they were before each collapse.
    let mut born_leaf = vec![0_u32; collapses.len()];
    for (index, collapse) in collapses.iter().enumerate().rev() {
        let (kept, born) = (collapse.kept as usize, collapse.born as usize);
        size[kept] -= size[born];
        let starts = [first[index], first[index] + size[kept]];
        born_leaf[index] = starts[1];
        for ((child, start), vertex) in children[index].into_iter().zip(starts).zip([kept, born]) {
            match (child as usize).checked_sub(leaf_count) {
                Some(inner) => first[inner] = start,
                None => renumbered[vertex] = start,
            }
        }
    }
    drop(size);

    let split_of = |node: u32| match (node as usize).checked_sub(leaf_count) {
        Some(inner) => born_leaf[inner],
        None => NO_SPLIT,
    };
    let mut splits = vec![Split::VACANT; leaf_count];
    for (index, collapse) in collapses.iter().enumerate() {
        let [kept, born] = children[index].map(split_of);
        splits[born_leaf[index] as usize] = Split { kept, born, switch: collapse.switch, ..Split::VACANT };
    }
    drop(children);
    for root in &mut roots {
        root.split = born_leaf[root.split as usize - leaf_count];
    }
    let mut order: Vec<u32> = (0..collapses.len() as u32).collect();
    // Positive floats order as their bits do. Stable, so equal switch values stay in build order.
    order.sort_by_key(|index| collapses[*index as usize].switch.to_bits());
    for (rank, index) in order.iter().enumerate() {
        splits[born_leaf[*index as usize] as usize].id = (leaf_count + rank) as u32;
    }
    drop(order);

    let mut positions = vec![[0.0; 3]; leaf_count];
    for (canonical, position) in mesh.positions.iter().enumerate() {
        positions[renumbered[canonical] as usize] = *position;
    }
    let mut regular = vec![false; leaf_count];
    for (canonical, is_regular) in history.regular.iter().enumerate() {
        regular[renumbered[canonical] as usize] = *is_regular;
    }
    let nodes: Vec<NodePlace> =
        first.into_iter().zip(born_leaf).map(|(first, born)| NodePlace { first, born }).collect();
    let triangles = born_triangles(mesh.triangles, &history.death, &nodes, &renumbered);
    let mut tree = Tree { positions, splits, roots, triangles, origin: mesh.origin };
    bounding_spheres::fill(&mut tree, &nodes);
    normal_cones::fill(&mut tree, &nodes, &regular);
    tree
}

/// An inner node: the first leaf of its interval, and its born leaf.
#[derive(Debug, Clone, Copy)]
pub(super) struct NodePlace {
    pub first: u32,
    pub born: u32,
}

/// The triangles, grouped by the split at which they are born, each rotated so that its first corner lies under the
/// kept child.
fn born_triangles(triangles: Vec<[u32; 3]>, death: &[u32], nodes: &[NodePlace], renumbered: &[u32]) -> BornTriangles {
    let leaf_count = renumbered.len();
    let mut offsets = vec![0_u32; leaf_count + 1];
    for collapse in death {
        offsets[nodes[*collapse as usize].born as usize + 1] += 1;
    }
    for leaf in 0..leaf_count {
        offsets[leaf + 1] += offsets[leaf];
    }
    // Each group is filled from its end, which so becomes its start.
    let mut corners = vec![[0; 3]; triangles.len()];
    for (triangle, collapse) in triangles.iter().zip(death) {
        let NodePlace { first, born } = nodes[*collapse as usize];
        let [a, b, c] = triangle.map(|corner| renumbered[corner as usize]);
        let is_kept = |leaf: u32| first <= leaf && leaf < born;
        let place = &mut offsets[born as usize + 1];
        *place -= 1;
        corners[*place as usize] = if is_kept(a) {
            [a, b, c]
        } else if is_kept(b) {
            [b, c, a]
        } else {
            [c, a, b]
        };
    }
    offsets.remove(0);
    offsets.push(corners.len() as u32);
    for range in offsets.windows(2) {
        corners[range[0] as usize..range[1] as usize].sort_unstable();
    }
    BornTriangles { offsets, corners }
}
