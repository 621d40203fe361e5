//! Random trees for the tests, by any sequence of merges.
//!
//! A sequence of merges of two roots of one component each is a valid tree, whatever the geometry. So trees are drawn
//! at random: how many components, which roots merge, which keeps its position, by how much errors rise, and
//! triangles over random leaves. Leaves are then numbered depth-first, kept child first, and every triangle goes to the
//! deepest node that holds two of its corners. Half of the trees are on a lattice; normals are random; cones are random, or
//! about the normals, which few on a random tree would otherwise be.
//!
//! What comes back from a model is the tree but for spheres and cones below the roots, which are no smaller, and not much
//! larger ([`Back::compare`]).

use std::path::Path;
use std::sync::Arc;

use storage::{Disk, MemoryDisk};
use vdt::tree::{
    BornTriangles, NO_SPLIT, Normal, NormalCone, Root, Split, StoredTree, Tree, enclosing_radius, id_after, on_lattice,
    switch_of,
};

use crate::header::{Blocking, ErrorBound, Metric, ModelRoot, Positions, Strategy};
use crate::model::{Model, PageReader};
use crate::page::{ChildEntry, Page, PageLocation, Target};
use crate::verify::SPHERE_TOLERANCE;
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
    id: u32,
}

/// Draws a tree.
pub(crate) fn random_tree(plan: &TreePlan) -> Tree {
    let mut random = Random(plan.seed);
    let leaves = plan.leaves as usize;
    // Every component has two leaves at least.
    let components = (plan.components as usize).clamp(1, (leaves / 2).max(1));
    let mut nodes = vec![Node { children: None, id: 0 }; leaves];
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
            let below = nodes[kept as usize].id.max(nodes[born as usize].id);
            // Often the class of a child, as flat regions make it.
            let rise = if random.below(4) == 0 { 0.0 } else { random.signed().abs() };
            let error = switch_of(below, 0).max(0.01) + rise;
            nodes.push(Node { children: Some((kept, born)), id: id_after(error, below) });
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
    let exponent = random.below(21) as i32 - 10;
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
    let Places { positions, lattice_step } = places(random, leaves);
    // A tree vanishes at its diameter, not before.
    let exponent = node_roots.iter().fold(exponent, |exponent, root| {
        let first = starts[*root as usize] as usize;
        let diameter = diagonal(&positions[first..first + counts[*root as usize] as usize]);
        let octaves = (diameter / f64::from(switch_of(nodes[*root as usize].id, 0))).log2().ceil();
        exponent.max(octaves as i32)
    });
    let normals: Vec<Normal> = (0..leaves).map(|_| normal(random)).collect();
    let inward: Vec<bool> = node_roots.iter().map(|_| random.below(2) == 0).collect();
    let mut is_inward = vec![false; nodes.len()];
    node_roots.iter().zip(&inward).for_each(|(root, inward)| is_inward[*root as usize] = *inward);
    for (index, node) in nodes.iter().enumerate().rev() {
        let below = node.children.map_or([u32::MAX; 2], |(kept, born)| [kept, born]);
        let inward = is_inward[index];
        below.iter().filter_map(|child| is_inward.get_mut(*child as usize).map(|place| *place = inward)).count();
    }
    let has_cones = random.below(2) == 0;
    let split_of = |node: u32| match nodes[node as usize].children {
        Some((_, born)) => starts[born as usize],
        None => NO_SPLIT,
    };
    let mut splits = vec![Split::VACANT; leaves];
    let mut radii = vec![0.0_f32; nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        let Some((kept, born)) = node.children else { continue };
        let (a, b) = (positions[starts[index] as usize], positions[starts[born as usize] as usize]);
        radii[index] = enclosing_radius(a, radii[kept as usize], b, radii[born as usize]);
        let cone = if has_cones {
            cone_about(random, normals[starts[index] as usize], is_inward[index])
        } else {
            NormalCone::from_word(random.next() as u32)
        };
        splits[starts[born as usize] as usize] = Split {
            kept: split_of(kept),
            born: split_of(born),
            id: node.id,
            switch: switch_of(node.id, exponent),
            radius: radii[index],
            cone,
            normal: normals[starts[born as usize] as usize],
        };
    }
    let roots = node_roots.iter().zip(&inward).map(|(root, is_inward)| Root {
        start: starts[*root as usize],
        end: starts[*root as usize] + counts[*root as usize],
        split: split_of(*root),
        normal: normals[starts[*root as usize] as usize],
        is_inward: *is_inward,
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
    let triangles = BornTriangles { offsets, corners };
    Tree { positions, splits, roots, triangles, origin, exponent, lattice_step }
}

/// That of the box of some positions.
fn diagonal(positions: &[[f32; 3]]) -> f64 {
    let extent = |axis: usize| {
        let along = positions.iter().map(|position| f64::from(position[axis]));
        along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
    };
    (0..3).map(|axis| extent(axis).powi(2)).sum::<f64>().sqrt()
}

/// Where the leaves of a tree are.
struct Places {
    positions: Vec<[f32; 3]>,
    lattice_step: f32,
}

/// Anywhere, in any unit; on a lattice, coarse enough for many to be in one place, or as fine as one may be; fractions of one
/// denominator, most of them; sometimes all in a plane.
fn places(random: &mut Random, leaves: usize) -> Places {
    let unit = 10.0_f32.powi([0, 0, -5, 5, -20, 15][random.below(6)]);
    let steps = [0, 0, 0, 1 << 4, 1 << 12, 1 << 23][random.below(6)];
    let lattice_step = if steps > 0 { (1.0 + random.signed().abs()) * unit / steps as f32 } else { 0.0 };
    let denominator = [0.0, 1e3, 1e7, 0.25][random.below(4)];
    let is_flat = random.below(8) == 0;
    let mut coordinate = |axis: usize| {
        let value = if is_flat && axis == 1 { 0.5 } else { random.signed() };
        if steps > 0 {
            on_lattice((value * (steps - 1) as f32) as i32, lattice_step)
        } else if denominator > 0.0 && random.below(8) > 0 {
            (value * 1e5).trunc() / denominator
        } else {
            value * unit * 10.0
        }
    };
    Places { positions: (0..leaves).map(|_| [0, 1, 2].map(&mut coordinate)).collect(), lattice_step }
}

fn normal(random: &mut Random) -> Normal {
    Normal::encode([(); 3].map(|()| f64::from(random.signed())))
}

/// A cone near a normal, or beside it, or none.
fn cone_about(random: &mut Random, normal: Normal, is_inward: bool) -> NormalCone {
    if random.below(8) == 0 {
        return NormalCone::EVERYTHING;
    }
    let sign = if is_inward { -120.0 } else { 120.0 };
    let off = [0.0, 5.0, 60.0][random.below(3)];
    let axis = normal.decode().map(|value| (value * sign + random.signed() * off).clamp(-127.0, 127.0) as i8);
    let widest = [2, 60, 255][random.below(3)];
    NormalCone { axis, sine: random.below(widest) as u8 }
}

/// The half-angle of a cone in radians.
fn half_angle(cone: NormalCone) -> f64 {
    (f64::from(cone.sine) / 254.0).min(1.0).asin()
}

/// The angle between two axes in radians; that of an axis that is none is no number.
fn between(one: [i8; 3], other: [i8; 3]) -> f64 {
    let [one, other] = [one, other].map(|axis| axis.map(f64::from));
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let across = [
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
    ];
    match dot(one, one) * dot(other, other) {
        0.0 => f64::NAN,
        _ => dot(across, across).sqrt().atan2(dot(one, other)),
    }
}

/// Whether a cone that came back is that of the tree about the normal of its node: whether it holds it, and is not much wider.
pub(crate) fn is_cone_of(back: NormalCone, cone: NormalCone, normal: Normal, is_inward: bool) -> bool {
    /// Steps of half-angles, and the rounding of an axis.
    const STEP: f64 = std::f64::consts::FRAC_PI_2 / 16.0 + 0.012;
    let sign = if is_inward { -127.0 } else { 127.0 };
    let axis = normal.decode().map(|value| (value * sign).round() as i8);
    let needed = between(axis, cone.axis) + half_angle(cone);
    if back == NormalCone::EVERYTHING {
        return cone.sine == u8::MAX || needed.is_nan() || needed > std::f64::consts::FRAC_PI_2 - STEP;
    }
    // Near 90 degrees one step of a sine is several degrees.
    let (reach, before) = (half_angle(back), half_angle(NormalCone { sine: back.sine.saturating_sub(1), ..back }));
    cone.sine != u8::MAX && back.axis == axis && needed <= reach + 1e-7 && before <= needed + STEP
}

/// The options of the tests, with this blocking.
pub(crate) fn options(blocking: Blocking) -> ModelOptions {
    let (metric, strategy, error_bound) = (Metric::Quadric, Strategy::Passes, ErrorBound::Fast);
    ModelOptions { blocking, metric, strategy, error_bound, input_error: 0.0, positions: Positions::Lossless }
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

/// All pages of a model by number, each decoded below its ancestors and sound in itself; and where they are.
pub(crate) fn all_pages(model: &Model) -> Vec<(PageLocation, Page)> {
    let mut pages: Vec<(PageLocation, Page)> = Vec::new();
    let mut locations: Vec<PageLocation> = model.root_pages().to_vec();
    let mut reader = PageReader::default();
    // Numbers are breadth-first, so this is in their order.
    let mut next = 0;
    let mut parents = vec![None; locations.len()];
    while let Some(&location) = locations.get(next) {
        let mut ancestors: Vec<&Page> = Vec::new();
        let mut above: Option<usize> = parents[next];
        while let Some(number) = above {
            ancestors.insert(0, &pages[number].1);
            above = parents[number];
        }
        let mut page = model.empty_page();
        model.read_page(location, &ancestors, &mut reader, &mut page).unwrap();
        page.check(model.header().leaf_count).unwrap();
        assert_eq!((page.number() as usize, location.number as usize), (next, next));
        assert_eq!(page.parent(), parents[next].map(|parent| parent as u32));
        locations.extend(page.children());
        parents.resize(locations.len(), Some(next));
        pages.push((location, page));
        next += 1;
    }
    assert_eq!(pages.len(), model.header().page_count as usize);
    pages
}

/// What a model has of the tree that it was made of, page by page.
#[derive(Debug)]
pub(crate) struct Back {
    /// Radii and cones are those of the pages.
    pub(crate) tree: Tree,
}

/// Reads a whole model back.
pub(crate) fn read_back(model: &Model) -> Back {
    let header = model.header();
    let leaves = header.leaf_count as usize;
    let mut tree = Tree {
        positions: vec![[f32::NAN; 3]; leaves],
        splits: vec![Split::VACANT; leaves],
        roots: Vec::new(),
        triangles: BornTriangles::default(),
        origin: header.origin,
        exponent: header.exponent,
        lattice_step: header.lattice_step,
    };
    let pages = all_pages(model);
    let mut born = vec![Vec::new(); leaves];
    for root in model.roots() {
        tree.positions[root.start as usize] = root.position;
        let mut above = pages[root.page.number as usize].1.parent();
        for location in model.way_to(root.page.number).into_iter().rev() {
            assert_eq!(above, Some(location.number));
            let (found, page) = &pages[location.number as usize];
            assert_eq!(*found, location);
            above = page.parent();
        }
        assert_eq!(above, None);
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
                    (pages[location.number as usize].1.child_location(child.into()), record)
                }
            };
            let (found, page) = &pages[location.number as usize];
            assert_eq!(*found, location);
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
                None => {
                    let ModelRoot { normal, is_inward, .. } = *root;
                    tree.roots.push(Root { start, end, split, normal, is_inward });
                }
                Some((parent, true)) => tree.splits[parent as usize].kept = split,
                Some((parent, false)) => tree.splits[parent as usize].born = split,
            }
            let ChildEntry { id, switch, radius, cone, .. } = entry;
            tree.splits[split as usize] = Split { id, switch, radius, cone, normal: record.normal, ..Split::VACANT };
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
    Back { tree }
}

impl Back {
    /// Whether this is what a model must have of `tree`; what is not, where it is not. All but spheres and cones is as it was,
    /// those of roots, too. Other spheres are no smaller, and nested; they are larger by no more than the rounding of the
    /// radii below pages: a quarter octave, or a 2^15th of that of their root. Other cones hold those of the tree.
    pub(crate) fn compare(&self, tree: &Tree) -> Result<(), String> {
        let mut plain = self.tree.clone();
        for root in &tree.roots {
            let of_root = tree.splits[root.split as usize].radius;
            // Each node with the leaf where it stands.
            let mut stack = vec![(root.split, root.start, root.normal)];
            while let Some((split, start, normal)) = stack.pop() {
                let (node, back) = (tree.splits[split as usize], self.tree.splits[split as usize]);
                if split == root.split {
                    if (back.radius, back.cone) != (node.radius, node.cone) {
                        return Err(format!("split {split}, a root: {back:?} for {node:?}"));
                    }
                } else {
                    if back.radius < node.radius || back.radius > node.radius * 1.2 + of_root / 32_000.0 {
                        return Err(format!("split {split}: radius {} for {}", back.radius, node.radius));
                    }
                    if !is_cone_of(back.cone, node.cone, normal, root.is_inward) {
                        return Err(format!("split {split}: cone {:?} for {:?} at {normal:?}", back.cone, node.cone));
                    }
                }
                for (child, at) in [(node.kept, start), (node.born, split)] {
                    let [from, to] = [start, at].map(|leaf| tree.positions[leaf as usize].map(f64::from));
                    let distance =
                        (0..3).map(|axis| (to[axis] - from[axis]) * (to[axis] - from[axis])).sum::<f64>().sqrt();
                    let below = self.tree.splits.get(child as usize).map_or(0.0, |split| f64::from(split.radius));
                    if distance + below > f64::from(back.radius) * (1.0 + SPHERE_TOLERANCE) {
                        return Err(format!("split {split}: a child reaches {} of {}", distance + below, back.radius));
                    }
                    if child != NO_SPLIT {
                        let normal = if at == start { normal } else { tree.splits[split as usize].normal };
                        stack.push((child, at, normal));
                    }
                }
                let Split { radius, cone, .. } = node;
                plain.splits[split as usize] = Split { radius, cone, ..plain.splits[split as usize] };
            }
        }
        if plain == *tree {
            return Ok(());
        }
        for leaf in 0..tree.leaf_count().min(plain.leaf_count()) {
            let (one, other) = (plain.positions[leaf], tree.positions[leaf]);
            if one != other {
                return Err(format!("leaf {leaf}: {one:?} for {other:?}, of steps of {}", tree.lattice_step));
            }
            let (one, other) = (plain.splits[leaf], tree.splits[leaf]);
            if one != other {
                return Err(format!("split {leaf}: {one:?} for {other:?}"));
            }
        }
        Err("roots, triangles or units are others".into())
    }
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
