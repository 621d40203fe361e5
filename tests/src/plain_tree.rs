//! A tree made from a list of collapses in the slowest way that is sure: nodes with links, one walk down for the leaf
//! numbers, and for each triangle the deepest node that holds two of its corners.

use std::collections::BTreeMap;

use vdt::ingest::CoreMesh;
use vdt::simplify::log::{LoggedCollapse, LoggedRoot};
use vdt::tree::{BornTriangles, NO_SPLIT, NormalCone, Root, Split, Tree, switch_of};

#[derive(Debug, Clone)]
struct Node {
    /// The canonical vertex at which it stands.
    vertex: u32,
    parent: Option<usize>,
    /// Kept child, born child, index of the collapse.
    inner: Option<[usize; 3]>,
    start: u32,
    end: u32,
}

/// The tree of a mesh, from its collapses in build order, of which only vertices, ids, radii, cones and
/// normals are looked at. Of `logged_roots`, which way is out, and normals.
pub fn plain_tree(mesh: &CoreMesh, collapses: &[LoggedCollapse], logged_roots: &[LoggedRoot]) -> Tree {
    let CoreMesh { positions, triangles, origin, exponent, lattice_step, .. } = mesh;
    let logged: BTreeMap<u32, &LoggedRoot> = logged_roots.iter().map(|root| (root.vertex, root)).collect();
    let leaf_count = positions.len();
    let leaf = |vertex| Node { vertex, parent: None, inner: None, start: 0, end: 0 };
    let mut nodes: Vec<Node> = (0..leaf_count as u32).map(leaf).collect();
    let mut standing: Vec<usize> = (0..leaf_count).collect();
    for (index, collapse) in collapses.iter().enumerate() {
        let [kept, born] = [collapse.kept, collapse.born].map(|vertex| standing[vertex as usize]);
        let parent = nodes.len();
        nodes.push(Node { inner: Some([kept, born, index]), ..leaf(collapse.kept) });
        nodes[kept].parent = Some(parent);
        nodes[born].parent = Some(parent);
        standing[collapse.kept as usize] = parent;
    }

    // Leaf numbers: depth first, the kept child first. A node ends where the leaf after its last one begins.
    let mut next = 0;
    let mut roots: Vec<usize> = (0..nodes.len()).filter(|node| nodes[*node].parent.is_none()).collect();
    roots.sort_by_key(|root| nodes[*root].vertex);
    for root in &roots {
        let mut stack = vec![(*root, false)];
        while let Some((node, is_done)) = stack.pop() {
            if is_done {
                nodes[node].end = next;
                continue;
            }
            nodes[node].start = next;
            stack.push((node, true));
            match nodes[node].inner {
                None => next += 1,
                Some([kept, born, _]) => stack.extend([(born, false), (kept, false)]),
            }
        }
    }
    let split_of = |node: usize| nodes[node].inner.map_or(NO_SPLIT, |[_, born, _]| nodes[born].start);

    let inner = || nodes.iter().filter_map(|node| node.inner.map(|inner| (node, inner)));
    let mut splits = vec![Split::VACANT; leaf_count];
    for (node, [kept, born, index]) in inner() {
        let root =
            roots.iter().find(|root| nodes[**root].start <= node.start && node.end <= nodes[**root].end).unwrap();
        let cone = NormalCone::from_word(collapses[index].cone);
        splits[nodes[born].start as usize] = Split {
            kept: split_of(kept),
            born: split_of(born),
            id: collapses[index].id,
            switch: switch_of(collapses[index].id, *exponent),
            radius: collapses[index].radius,
            cone: match logged[&nodes[*root].vertex].outward {
                1 => cone,
                -1 => NormalCone { axis: cone.axis.map(|component| -component), sine: cone.sine },
                _ => NormalCone::EVERYTHING,
            },
            normal: collapses[index].normal,
        };
    }

    let mut born_by = vec![Vec::new(); leaf_count];
    for triangle in triangles {
        let leaves = triangle.map(|vertex| nodes[vertex as usize].start);
        let holds = |node: &Node, leaf: u32| node.start <= leaf && leaf < node.end;
        let held_by = |node: &Node| leaves.iter().filter(|leaf| holds(node, **leaf)).count();
        let (_, [kept, born, _]) =
            inner().filter(|(node, _)| held_by(node) >= 2).min_by_key(|(node, _)| node.end - node.start).unwrap();
        let first = leaves.iter().position(|leaf| holds(&nodes[kept], *leaf)).unwrap();
        let mut corners = leaves;
        corners.rotate_left(first);
        born_by[nodes[born].start as usize].push(corners);
    }
    let mut born_triangles = BornTriangles { offsets: vec![0], corners: Vec::new() };
    for mut corners in born_by {
        corners.sort();
        born_triangles.corners.extend(corners);
        born_triangles.offsets.push(born_triangles.corners.len() as u32);
    }

    let mut ordered = vec![[0.0; 3]; leaf_count];
    for (vertex, position) in positions.iter().enumerate() {
        ordered[nodes[vertex].start as usize] = *position;
    }
    let roots = roots
        .iter()
        .map(|root| {
            let Node { vertex, start, end, .. } = nodes[*root];
            let LoggedRoot { normal, outward, .. } = *logged[&vertex];
            Root { start, end, split: split_of(*root), normal, is_inward: outward == -1 }
        })
        .collect();
    let (triangles, origin, exponent, lattice_step) = (born_triangles, *origin, *exponent, *lattice_step);
    Tree { positions: ordered, splits, roots, triangles, origin, exponent, lattice_step }
}
