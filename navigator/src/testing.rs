//! Small trees for the tests: meshes, collapsed in a random order or roughly the shortest edge first, without any test
//! for legality. Every such sequence gives a valid tree.

mod attributes;

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::Vec3;
use metanode::chain::PageChain;
use metanode::header::{Blocking, ErrorBound, Metric, Positions, Strategy};
use metanode::model::Model;
use metanode::page::{Page, PageLocation, Target};
use metanode::write::{ModelOptions, WriteResources, write_model};
use storage::{Disk, MemoryDisk};
use vdt::tree::{
    BornTriangles, NO_SPLIT, Normal, NormalCone, Root, Split, StoredTree, Tree, enclosing_radius, id_after, switch_of,
};

pub use self::attributes::Attributes;

/// A small generator of random numbers (SplitMix64).
#[derive(Debug, Clone)]
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }

    /// A number in 0..1.
    pub fn unit(&mut self) -> f32 {
        self.below(1 << 24) as f32 / (1 << 24) as f32
    }
}

/// A mesh.
#[derive(Debug, Clone, Default)]
pub struct Mesh {
    pub positions: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// A bumpy terrain of `width` × `height` squares, in the xy plane.
    pub fn grid(width: u32, height: u32, seed: u64) -> Self {
        let mut random = Random(seed);
        let mut mesh = Mesh::default();
        for y in 0..=height {
            for x in 0..=width {
                let bump = (x as f32 * 0.3).sin() * (y as f32 * 0.2).cos() * 2.0 + random.unit() * 0.2;
                mesh.positions.push(Vec3::new(x as f32, y as f32, bump));
            }
        }
        for y in 0..height {
            for x in 0..width {
                let corner = y * (width + 1) + x;
                mesh.triangles.push([corner, corner + 1, corner + width + 2]);
                mesh.triangles.push([corner, corner + width + 2, corner + width + 1]);
            }
        }
        mesh
    }

    /// A sphere: an octahedron, its faces cut in four `levels` times.
    pub fn sphere(levels: u32) -> Self {
        let axes = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z];
        let mut mesh = Mesh { positions: axes.to_vec(), triangles: Vec::new() };
        mesh.triangles.extend([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2]]);
        mesh.triangles.extend([[1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]);
        for _ in 0..levels {
            let mut middles = HashMap::new();
            let mut finer = Vec::new();
            for corners in std::mem::take(&mut mesh.triangles) {
                let middle = [0, 1, 2].map(|side| {
                    let (from, to) = (corners[side], corners[(side + 1) % 3]);
                    *middles.entry((from.min(to), from.max(to))).or_insert_with(|| {
                        let sum = mesh.positions[from as usize] + mesh.positions[to as usize];
                        mesh.positions.push(sum.normalize());
                        mesh.positions.len() as u32 - 1
                    })
                });
                finer.push(middle);
                (0..3).for_each(|side| finer.push([corners[side], middle[side], middle[(side + 2) % 3]]));
            }
            mesh.triangles = finer;
        }
        mesh
    }

    /// Several meshes beside each other.
    pub fn beside(parts: Vec<Mesh>) -> Self {
        let mut whole = Mesh::default();
        for (index, part) in parts.into_iter().enumerate() {
            let first = whole.positions.len() as u32;
            whole.positions.extend(part.positions.iter().map(|position| position + Vec3::X * (index as f32 * 50.0)));
            whole.triangles.extend(part.triangles.iter().map(|corners| corners.map(|corner| corner + first)));
        }
        whole
    }

    /// The same vertices with triangles between any three near each other: no surface at all, but connected.
    pub fn tangled(mut self, seed: u64) -> Self {
        let mut random = Random(seed);
        for triangle in &mut self.triangles {
            if random.below(10) == 0 {
                let any = random.below(self.positions.len()) as u32;
                if !triangle.contains(&any) {
                    triangle[random.below(3)] = any;
                }
            }
        }
        self
    }

    /// Collapses the mesh down to one root per component. Each time the shortest edge at `choice` random vertices is
    /// collapsed: 1 is any, many are about the shortest of all.
    pub fn into_tree(self, seed: u64, choice: usize) -> Tree {
        Collapser::new(&self, seed).run(choice)
    }
}

/// A node while the tree is being made.
#[derive(Debug, Clone)]
struct Node {
    position: Vec3,
    /// Kept and born child.
    children: Option<[usize; 2]>,
    id: u32,
    radius: f32,
    axis: Vec3,
    angle: f32,
    born: Vec<[u32; 3]>,
    /// The live triangles at it.
    star: Vec<usize>,
    component: usize,
}

struct Collapser {
    random: Random,
    leaves: usize,
    nodes: Vec<Node>,
    live: Vec<usize>,
    /// The triangles, by leaves and by live nodes.
    triangles: Vec<([u32; 3], [usize; 3])>,
    origin: [f64; 3],
}

impl Collapser {
    fn new(mesh: &Mesh, seed: u64) -> Self {
        let leaves = mesh.positions.len();
        let mut components: Vec<usize> = (0..leaves).collect();
        let mut changed = true;
        while changed {
            changed = false;
            for corners in &mesh.triangles {
                let least = corners.iter().map(|corner| components[*corner as usize]).min().unwrap();
                for corner in corners {
                    changed |= components[*corner as usize] != least;
                    components[*corner as usize] = least;
                }
            }
        }
        let mut nodes: Vec<Node> = (0..leaves)
            .map(|leaf| Node {
                position: mesh.positions[leaf],
                children: None,
                id: 0,
                radius: 0.0,
                axis: Vec3::ZERO,
                angle: 0.0,
                born: Vec::new(),
                star: Vec::new(),
                component: components[leaf],
            })
            .collect();
        let mut triangles = Vec::new();
        for (index, corners) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|corner| mesh.positions[corner as usize]);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            for corner in corners {
                nodes[*corner as usize].star.push(index);
                nodes[*corner as usize].axis += normal;
            }
            triangles.push((*corners, corners.map(|corner| corner as usize)));
        }
        for (corners, _) in &triangles {
            let [a, b, c] = corners.map(|corner| mesh.positions[corner as usize]);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            for corner in corners {
                let node = &mut nodes[*corner as usize];
                node.angle = node.angle.max(node.axis.angle_between(normal));
            }
        }
        nodes.iter_mut().for_each(|node| node.axis = node.axis.normalize_or_zero());
        // A vertex that tangling left without triangles goes with some other.
        let some = triangles.first().map_or(0, |(_, corners)| nodes[corners[0]].component);
        nodes.iter_mut().filter(|node| node.star.is_empty()).for_each(|node| node.component = some);
        let mut random = Random(seed);
        let origin = [(); 3].map(|()| f64::from(random.unit()) * 1e6);
        Collapser { random, leaves, live: (0..leaves).collect(), nodes, triangles, origin }
    }

    fn ring(&self, node: usize) -> Vec<usize> {
        let mut ring: Vec<_> = self.nodes[node].star.iter().flat_map(|triangle| self.triangles[*triangle].1).collect();
        ring.sort_unstable();
        ring.dedup();
        ring.retain(|other| *other != node);
        ring
    }

    fn run(mut self, choice: usize) -> Tree {
        loop {
            let mut best: Option<(f32, usize, usize)> = None;
            for _ in 0..choice {
                let node = self.live[self.random.below(self.live.len().max(1)).min(self.live.len() - 1)];
                for other in self.ring(node) {
                    let length = self.nodes[node].position.distance(self.nodes[other].position);
                    if best.is_none_or(|(least, ..)| length < least) {
                        best = Some((length, node, other));
                    }
                }
                if self.live.is_empty() {
                    break;
                }
            }
            // Where chance found nothing: whatever is left of a component.
            let best = best.or_else(|| {
                let pairs = self.live.iter().flat_map(|node| self.live.iter().map(move |other| (*node, *other)));
                let mut pairs = pairs.filter(|(node, other)| {
                    node != other && self.nodes[*node].component == self.nodes[*other].component
                });
                pairs.next().map(|(node, other)| (0.01, node, other))
            });
            let Some((length, node, other)) = best else { break };
            let (kept, born) = if self.random.below(2) == 0 { (node, other) } else { (other, node) };
            self.collapse(kept, born, length);
            if self.live.is_empty() {
                break;
            }
        }
        self.finish()
    }

    fn collapse(&mut self, kept: usize, born: usize, length: f32) {
        let parent = self.nodes.len();
        let around = [self.ring(kept), self.ring(born), vec![kept, born]].concat();
        let latest = around.into_iter().map(|near| self.nodes[near].id).max().unwrap_or(0);
        let [k, b] = [&self.nodes[kept], &self.nodes[born]];
        let axis = (k.axis + b.axis).normalize_or_zero();
        let angle = [k, b].map(|child| axis.angle_between(child.axis) + child.angle);
        let angle = if axis == Vec3::ZERO || angle.iter().any(|angle| angle.is_nan()) {
            f32::INFINITY
        } else {
            angle[0].max(angle[1]) + CONE_SLACK
        };
        let mut node = Node {
            position: k.position,
            children: Some([kept, born]),
            id: id_after(length, latest),
            radius: enclosing_radius(k.position.to_array(), k.radius, b.position.to_array(), b.radius),
            axis,
            angle,
            born: Vec::new(),
            star: Vec::new(),
            component: k.component,
        };
        let star: Vec<usize> = k.star.iter().chain(&b.star).copied().collect();
        for triangle in star {
            let (leaves, corners) = &mut self.triangles[triangle];
            if !corners.contains(&kept) && !corners.contains(&born) {
                continue;
            }
            if corners.contains(&kept) && corners.contains(&born) {
                let first = corners.iter().position(|corner| *corner == kept).unwrap();
                leaves.rotate_left(first);
                node.born.push(*leaves);
                let third = corners.iter().copied().find(|corner| *corner != kept && *corner != born).unwrap();
                *corners = [usize::MAX; 3];
                self.nodes[third].star.retain(|other| *other != triangle);
            } else {
                corners.iter_mut().filter(|corner| **corner == kept || **corner == born).for_each(|c| *c = parent);
                node.star.push(triangle);
            }
        }
        self.nodes.push(node);
        self.live.retain(|other| *other != kept && *other != born);
        self.live.push(parent);
    }

    fn finish(mut self) -> Tree {
        let count = self.nodes.len();
        let mut tree = Tree { origin: self.origin, ..Tree::default() };
        tree.splits = vec![Split::VACANT; self.leaves];
        let mut intervals = vec![(0, 0); count];
        let mut leaf_of = vec![0; self.leaves];
        self.live.sort_unstable();
        for root in &self.live {
            let mut stack = vec![(*root, false)];
            while let Some((node, done)) = stack.pop() {
                match self.nodes[node].children {
                    None => {
                        let leaf = tree.positions.len() as u32;
                        leaf_of[node] = leaf;
                        intervals[node] = (leaf, leaf + 1);
                        tree.positions.push(self.nodes[node].position.to_array());
                    }
                    Some([kept, born]) if done => {
                        intervals[node] = (intervals[kept].0, intervals[born].1);
                        let split = |child: usize| match self.nodes[child].children {
                            None => NO_SPLIT,
                            Some([_, born]) => intervals[born].0,
                        };
                        let Node { id, radius, axis, angle, .. } = self.nodes[node];
                        tree.splits[intervals[born].0 as usize] = Split {
                            kept: split(kept),
                            born: split(born),
                            id,
                            switch: switch_of(id, tree.exponent),
                            radius,
                            cone: cone(axis, angle),
                            normal: Normal::UP,
                        };
                    }
                    Some([kept, born]) => stack.extend([(node, true), (born, false), (kept, false)]),
                }
            }
            let Some([_, born]) = self.nodes[*root].children else { panic!("a vertex without triangles") };
            let (start, end) = intervals[*root];
            tree.roots.push(Root { start, end, split: intervals[born].0, normal: Normal::UP, is_inward: false });
        }
        let mut born = vec![Vec::new(); self.leaves];
        for node in self.nodes.iter().filter(|node| !node.born.is_empty()) {
            let Some([_, child]) = node.children else { continue };
            let list = &mut born[intervals[child].0 as usize];
            list.extend(node.born.iter().map(|corners| corners.map(|corner| leaf_of[corner as usize])));
            list.sort_unstable();
        }
        tree.triangles = BornTriangles { offsets: vec![0], corners: Vec::new() };
        for list in born {
            tree.triangles.corners.extend(list);
            tree.triangles.offsets.push(tree.triangles.corners.len() as u32);
        }
        tree
    }
}

/// By how much more a parent's cone is opened than its children need: below 1.2 radians, rounding an axis to 127ths
/// turns it by less than 0.007, and rounding a sine up opens a cone by less than 0.012.
const CONE_SLACK: f32 = 0.03;

fn cone(axis: Vec3, angle: f32) -> NormalCone {
    let angle = angle + 0.01;
    if angle >= 1.2 {
        return NormalCone::EVERYTHING;
    }
    let axis = (axis * 127.0).round().to_array().map(|component| component as i8);
    NormalCone { axis, sine: (angle.sin() * 254.0).ceil() as u8 }
}

/// A tree of a bumpy terrain, about the shortest edge first.
pub fn grid_tree(width: u32, height: u32, seed: u64) -> Tree {
    Mesh::grid(width, height, seed).into_tree(seed, 20)
}

/// A tree of a sphere.
pub fn sphere_tree(levels: u32, seed: u64) -> Tree {
    Mesh::sphere(levels).into_tree(seed, 20)
}

/// A single triangle.
pub fn triangle_tree() -> Tree {
    Mesh { positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y], triangles: vec![[0, 1, 2]] }.into_tree(7, 1)
}

/// Nothing at all.
pub fn empty_tree() -> Tree {
    Tree { triangles: BornTriangles { offsets: vec![0], corners: Vec::new() }, ..Tree::default() }
}

/// The small pages of most tests.
pub const SMALL_PAGES: Blocking = Blocking::Forest { slot_bytes: 4096, fan_out: 4 };

/// A disk with the tree's model file, `model.vdt`.
pub fn disk_of(tree: &Tree, blocking: Blocking) -> MemoryDisk {
    disk_of_stored(&StoredTree::from_tree(tree.clone()), blocking)
}

fn disk_of_stored(tree: &StoredTree, blocking: Blocking) -> MemoryDisk {
    let disk = MemoryDisk::new();
    let (metric, strategy, error_bound) = (Metric::Length, Strategy::Btree, ErrorBound::Fast);
    let positions = Positions::Lossless;
    let options = ModelOptions { blocking, metric, strategy, error_bound, input_error: 0.0, positions };
    let shared: Arc<dyn Disk> = Arc::new(disk.clone());
    let resources = WriteResources::in_memory();
    write_model(shared, Path::new("model.vdt"), tree, &options, &resources, &mut |_| ()).unwrap();
    disk
}

/// The model of a tree, with small pages.
pub fn model_of(tree: &Tree) -> Arc<Model> {
    Arc::new(Model::open(&disk_of(tree, SMALL_PAGES), Path::new("model.vdt")).unwrap())
}

/// The tree with the spheres and cones that its model has: not the same, but no smaller.
pub fn as_written(tree: &Tree, model: &Model) -> Tree {
    let mut chain = PageChain::new(model);
    let mut pages: HashMap<u32, Page> = HashMap::new();
    let mut stack: Vec<(PageLocation, Option<u32>)> = model.root_pages().iter().map(|page| (*page, None)).collect();
    while let Some((location, parent)) = stack.pop() {
        let page = chain.page(location, parent).unwrap().clone();
        stack.extend(page.children().map(|child| (child, Some(location.number))));
        pages.insert(location.number, page);
    }
    let mut written = tree.clone();
    for page in pages.values() {
        for record in (0..page.counts().records).map(|index| page.record(index as u16).unwrap()) {
            for entry in [record.kept, record.born].into_iter().flatten() {
                let below = match entry.target {
                    Target::SamePage { record } => page.record(record),
                    Target::ChildPage { child, record } => {
                        pages[&page.child_location(child.into()).number].record(record)
                    }
                };
                let split = &mut written.splits[below.unwrap().born_leaf as usize];
                assert!(entry.radius >= split.radius && (entry.id, entry.switch) == (split.id, split.switch));
                (split.radius, split.cone) = (entry.radius, entry.cone);
            }
        }
    }
    written
}

#[test]
fn the_trees_are_sound() {
    for choice in [1, 5, 50] {
        vdt::tree::check(&Mesh::grid(9, 7, 1).into_tree(3, choice)).unwrap();
        vdt::tree::check(&Mesh::sphere(2).into_tree(4, choice)).unwrap();
        vdt::tree::check(&Mesh::beside(vec![Mesh::sphere(1), Mesh::grid(3, 3, 2)]).into_tree(5, choice)).unwrap();
        vdt::tree::check(&Mesh::grid(9, 7, 1).tangled(8).into_tree(3, choice)).unwrap();
    }
    vdt::tree::check(&triangle_tree()).unwrap();
    vdt::tree::check(&empty_tree()).unwrap();
}
