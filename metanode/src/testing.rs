//! Random trees for the tests, by any sequence of merges.
//!
//! A sequence of merges of two roots of one component each is a valid tree, whatever the geometry. So trees are drawn
//! at random: how many components, which roots merge, which keeps its position, by how much switch values rise, and
//! triangles over random leaves. Leaves are then numbered depth-first, kept child first, and every triangle goes to the
//! deepest node that holds two of its corners.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use storage::{Disk, MemoryDisk};
use vdt::tree::{BornTriangles, NO_SPLIT, NormalCone, Root, Split, StoredTree, Tree};

use crate::header::{Blocking, ErrorBound, Metric, Strategy};
use crate::model::Model;
use crate::page::{ChildEntry, Page, Target};
use crate::write::{ModelOptions, ModelSummary, WriteResources, write_model};

/// A small generator of random numbers (SplitMix64).
#[derive(Debug, Clone)]
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number below `bound`.
    pub(crate) fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }

    /// A number in -1..1.
    pub(crate) fn signed(&mut self) -> f32 {
        self.below(2_000_001) as f32 / 1_000_000.0 - 1.0
    }
}

/// What kind of tree to draw.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TreePlan {
    pub(crate) seed: u64,
    pub(crate) leaves: u32,
    pub(crate) components: u32,
    pub(crate) triangles: u32,
    pub(crate) shape: Shape,
    /// How far, in leaves, the corners of a triangle lie apart at most.
    pub(crate) reach: u32,
    /// This many triangles more share two leaves of the first tree, so that one split bears them all.
    pub(crate) hub: u32,
}

/// Which roots merge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shape {
    /// Any two.
    Random,
    /// Any two neighbours in a line: what stands together merges.
    Neighbours,
    /// Always the same with one leaf more: as deep as can be.
    Chain,
}

/// A node while the tree is made; its children by number.
#[derive(Clone, Copy)]
struct Node {
    children: Option<(u32, u32)>,
    switch: f32,
}

/// Draws a tree.
pub(crate) fn random_tree(plan: &TreePlan) -> Tree {
    let mut random = Random(plan.seed);
    let leaves = plan.leaves as usize;
    // Every component has two leaves at least.
    let components = (plan.components as usize).clamp(1, (leaves / 2).max(1));
    let mut nodes = vec![Node { children: None, switch: 0.0 }; leaves];
    let mut roots = Vec::new();
    let mut first = 0;
    for component in 0..components {
        let rest = components - component - 1;
        let spare = leaves - first - 2 * (rest + 1);
        let count = 2 + if rest == 0 { spare } else { random.below(2 * spare / (rest + 1) + 1).min(spare) };
        let mut active: Vec<u32> = (first as u32..(first + count) as u32).collect();
        first += count;
        merge(&mut random, plan.shape, &mut nodes, &mut active);
        roots.push(active[0]);
    }
    number(&mut random, plan, &nodes, &roots)
}

fn merge(random: &mut Random, shape: Shape, nodes: &mut Vec<Node>, active: &mut Vec<u32>) {
    while active.len() > 1 {
        let mut merged = Vec::new();
        let rounds = if shape == Shape::Neighbours { active.len() / 2 } else { 1 };
        let mut next = 0;
        for _ in 0..rounds {
            let (a, b) = match shape {
                Shape::Neighbours => {
                    // Some stay over for the next round.
                    while next + 2 < active.len() && random.below(4) == 0 {
                        merged.push(active[next]);
                        next += 1;
                    }
                    if next + 2 > active.len() {
                        break;
                    }
                    next += 2;
                    (active[next - 2], active[next - 1])
                }
                Shape::Random => {
                    let index = random.below(active.len());
                    let a = active.swap_remove(index);
                    let index = random.below(active.len());
                    (a, active.swap_remove(index))
                }
                // The last is the one that was merged last.
                Shape::Chain => (active.pop().unwrap(), active.pop().unwrap()),
            };
            let (kept, born) = if random.below(2) == 0 { (a, b) } else { (b, a) };
            let below = nodes[kept as usize].switch.max(nodes[born as usize].switch);
            // Often equal to a child's, as flat regions make it.
            let rise = if random.below(4) == 0 { 0.0 } else { random.signed().abs() };
            nodes.push(Node { children: Some((kept, born)), switch: below.max(0.01) + rise });
            merged.push(nodes.len() as u32 - 1);
        }
        if shape == Shape::Neighbours {
            merged.extend(&active[next..]);
            *active = merged;
        } else {
            active.extend(merged);
        }
    }
}

fn number(random: &mut Random, plan: &TreePlan, nodes: &[Node], node_roots: &[u32]) -> Tree {
    let leaves = plan.leaves as usize;
    let mut ranks: Vec<u32> = (0..nodes.len() as u32).collect();
    ranks[leaves..].sort_by(|a, b| nodes[*a as usize].switch.total_cmp(&nodes[*b as usize].switch).then(a.cmp(b)));
    let mut ids = vec![0; nodes.len()];
    ranks.iter().enumerate().for_each(|(id, node)| ids[*node as usize] = id as u32);

    // Children have smaller numbers than parents, so counts come bottom-up and intervals top-down.
    let mut counts = vec![1_u32; nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        if let Some((kept, born)) = node.children {
            counts[index] = counts[kept as usize] + counts[born as usize];
        }
    }
    let mut starts = vec![0; nodes.len()];
    let mut parents = vec![u32::MAX; nodes.len()];
    let mut next = 0;
    for root in node_roots {
        starts[*root as usize] = next;
        next += counts[*root as usize];
    }
    for (index, node) in nodes.iter().enumerate().rev() {
        if let Some((kept, born)) = node.children {
            starts[kept as usize] = starts[index];
            starts[born as usize] = starts[index] + counts[kept as usize];
            parents[kept as usize] = index as u32;
            parents[born as usize] = index as u32;
        }
    }
    let positions: Vec<[f32; 3]> = (0..leaves).map(|_| [(); 3].map(|()| random.signed() * 10.0)).collect();
    let split_of = |node: u32| match nodes[node as usize].children {
        Some((_, born)) => starts[born as usize],
        None => NO_SPLIT,
    };
    let mut splits = vec![Split::VACANT; leaves];
    let mut radii = vec![0.0_f32; nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        let Some((kept, born)) = node.children else { continue };
        let (a, b) = (positions[starts[index] as usize], positions[starts[born as usize] as usize]);
        let distance = (0..3).map(|axis| (a[axis] - b[axis]) * (a[axis] - b[axis])).sum::<f32>().sqrt();
        radii[index] = radii[kept as usize].max(distance + radii[born as usize]);
        splits[starts[born as usize] as usize] = Split {
            kept: split_of(kept),
            born: split_of(born),
            id: ids[index],
            switch: node.switch,
            radius: radii[index],
            cone: NormalCone::from_word(random.next() as u32),
        };
    }
    let roots = node_roots.iter().map(|root| Root {
        start: starts[*root as usize],
        end: starts[*root as usize] + counts[*root as usize],
        split: split_of(*root),
    });
    let roots: Vec<Root> = roots.collect();

    let mut leaf_nodes = vec![0; leaves];
    (0..leaves).for_each(|node| leaf_nodes[starts[node] as usize] = node as u32);
    let mut born = Vec::new();
    let contains =
        |node: u32, leaf: u32| (starts[node as usize]..starts[node as usize] + counts[node as usize]).contains(&leaf);
    let hub = [(); 2].map(|()| roots[0].start + random.below((roots[0].end - roots[0].start) as usize) as u32);
    for index in 0..plan.triangles + plan.hub {
        // Any three leaves of one tree.
        let root = if index < plan.triangles { roots[random.below(roots.len())] } else { roots[0] };
        let span = (root.end - root.start) as usize;
        let reach = span.min(plan.reach.max(3) as usize);
        let window = root.start as usize + random.below(span - reach + 1);
        let mut corners = [(); 3].map(|()| (window + random.below(reach)) as u32);
        if index >= plan.triangles {
            corners[..2].copy_from_slice(&hub);
        }
        if corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0] {
            continue;
        }
        let holds = |node: u32| corners.iter().filter(|leaf| contains(node, **leaf)).count();
        let deepest = corners.iter().map(|leaf| {
            let mut node = leaf_nodes[*leaf as usize];
            while holds(node) < 2 {
                node = parents[node as usize];
            }
            node
        });
        // Two of the corners meet first; of the nodes found, it is the smallest.
        let node = deepest.min_by_key(|node| counts[*node as usize]).unwrap();
        let Some((kept, _)) = nodes[node as usize].children else { panic!("a leaf holds one corner") };
        if holds(node) == 3 {
            // Then two children share three corners, and one of them would hold two.
            panic!("node {node} is not the deepest");
        }
        let first = corners.iter().position(|leaf| contains(kept, *leaf)).unwrap();
        corners.rotate_left(first);
        born.push((split_of(node), corners));
    }
    born.sort_unstable();
    born.dedup();
    let mut offsets = vec![0; leaves + 1];
    born.iter().for_each(|(split, _)| offsets[*split as usize + 1] += 1);
    (0..leaves).for_each(|leaf| offsets[leaf + 1] += offsets[leaf]);
    let corners = born.into_iter().map(|(_, corners)| corners).collect();
    let origin = [(); 3].map(|()| f64::from(random.signed()) * 1e6);
    Tree { positions, splits, roots, triangles: BornTriangles { offsets, corners }, origin }
}

/// The options of the tests, with this blocking.
pub(crate) fn options(blocking: Blocking) -> ModelOptions {
    ModelOptions { blocking, metric: Metric::Quadric, strategy: Strategy::Passes, error_bound: ErrorBound::Fast }
}

/// The bytes of a model file.
pub(crate) fn model_bytes(tree: &Tree, blocking: Blocking) -> (Vec<u8>, ModelSummary) {
    let memory = MemoryDisk::new();
    let disk: Arc<dyn Disk> = Arc::new(memory.clone());
    let (tree, resources) = (StoredTree::from_tree(tree.clone()), WriteResources::in_memory());
    let summary =
        write_model(disk, Path::new("model.vdt"), &tree, &options(blocking), &resources, &mut |_| ()).unwrap();
    (memory.bytes("model.vdt").unwrap(), summary)
}

/// A model file with these bytes, open; or why it does not open.
pub(crate) fn open_bytes(bytes: impl Into<Vec<u8>>) -> Result<Model, crate::header::ModelError> {
    let memory = MemoryDisk::new();
    memory.insert("model.vdt", bytes);
    Model::open(&memory, Path::new("model.vdt"))
}

/// A model of this tree, open.
pub(crate) fn model(tree: &Tree, blocking: Blocking) -> Model {
    open_bytes(model_bytes(tree, blocking).0).unwrap()
}

/// Reads a whole model back, page by page, into the tree that it was made of.
pub(crate) fn read_back(model: &Model) -> Tree {
    let header = model.header();
    let leaves = header.leaf_count as usize;
    let mut tree = Tree {
        positions: vec![[f32::NAN; 3]; leaves],
        splits: vec![Split::VACANT; leaves],
        roots: Vec::new(),
        triangles: BornTriangles::default(),
        origin: header.origin,
    };
    let mut pages: HashMap<u32, Page> = HashMap::new();
    let mut born = vec![Vec::new(); leaves];
    for root in model.roots() {
        tree.positions[root.start as usize] = root.position;
        // A node with its split's place, and where its parent's record refers to it.
        let entry = ChildEntry {
            id: root.id,
            switch: root.switch,
            radius: root.radius,
            cone: root.cone,
            target: Target::SamePage { record: root.record },
        };
        let mut stack = vec![(root.page, entry, root.start, root.end, None)];
        while let Some((location, entry, start, end, parent)) = stack.pop() {
            let (location, index) = match entry.target {
                Target::SamePage { record } => (location, record),
                Target::ChildPage { child, record } => {
                    let location = pages[&location.number].child_location(child.into());
                    (location, record)
                }
            };
            let page = pages.entry(location.number).or_insert_with(|| {
                let mut page = model.empty_page();
                model.read_page(location, &mut Vec::new(), &mut page).unwrap();
                page
            });
            let record = page.record(index).unwrap();
            let split = record.born_leaf;
            assert!(start < split && split < end);
            assert_eq!(record.kept.is_none(), split - start == 1);
            assert_eq!(record.born.is_none(), end - split == 1);
            if matches!(entry.target, Target::ChildPage { .. }) || parent.is_none() {
                assert!(usize::from(index) < page.root_count());
                let (first, last) = page.leaf_interval();
                assert!(first <= start && end <= last);
            }
            match parent {
                None => tree.roots.push(Root { start, end, split }),
                Some((parent, true)) => tree.splits[parent as usize].kept = split,
                Some((parent, false)) => tree.splits[parent as usize].born = split,
            }
            let ChildEntry { id, switch, radius, cone, .. } = entry;
            tree.splits[split as usize] = Split { kept: NO_SPLIT, born: NO_SPLIT, id, switch, radius, cone };
            tree.positions[split as usize] = record.position;
            born[split as usize] = page.triangles(index).collect();
            stack.extend(record.kept.map(|entry| (location, entry, start, split, Some((split, true)))));
            stack.extend(record.born.map(|entry| (location, entry, split, end, Some((split, false)))));
        }
    }
    tree.triangles.offsets.push(0);
    for mut triangles in born {
        tree.triangles.corners.append(&mut triangles);
        tree.triangles.offsets.push(tree.triangles.corners.len() as u32);
    }
    tree
}

/// Plans for trees of up to `leaves` leaves of every kind.
pub(crate) fn plans(leaves: u32) -> impl proptest::strategy::Strategy<Value = TreePlan> {
    use proptest::prelude::*;
    let shape = prop_oneof![Just(Shape::Random), Just(Shape::Neighbours), Just(Shape::Chain)];
    let components = prop_oneof![Just(1), 2..5_u32, Just(u32::MAX)];
    let hub = prop_oneof![4 => Just(0_u32), 1 => 200..800_u32];
    let reach = prop_oneof![Just(u32::MAX), 3..100_u32];
    (any::<u64>(), 2..=leaves, components, 0..3_u32, shape, hub, reach).prop_map(
        |(seed, leaves, components, density, shape, hub, reach)| TreePlan {
            seed,
            leaves,
            components,
            triangles: leaves * density,
            shape,
            hub,
            reach,
        },
    )
}

/// Every kind of blocking, with pages small enough that small trees need many.
pub(crate) fn blockings() -> impl proptest::strategy::Strategy<Value = Blocking> {
    use proptest::prelude::*;
    prop_oneof![
        3 => (prop_oneof![Just(4096_u32), 4096..8192_u32], 2..9_u32)
            .prop_map(|(slot_bytes, fan_out)| Blocking::Forest { slot_bytes, fan_out }),
        1 => (1..8_u32).prop_map(|levels| Blocking::Levels { levels }),
    ]
}
