//! Flights over real trees, through the libraries: a random mesh is simplified, blocked, written and flown over, with a
//! random budget, along a random path. After every frame, misses outstanding or not, what is drawn is held against the
//! brute-force mesh of the cut ([`vdt_tests::cut`]), against the states of the construction done over again
//! ([`vdt_tests::replay`]), and against the library's own checkers.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use metanode::header::{Blocking, ModelError};
use metanode::model::Model;
use metanode::{ModelOptions, UniformCut, WriteResources, error_for_triangles, verify, write_model};
use navigator::check::check;
use navigator::{Camera, Dependency, Io, Navigator, NavigatorError, NavigatorOptions};
use proptest::prelude::*;
use storage::{Disk, MemoryDisk, ReadAt, StorageError, WriteFile};
use vdt::ingest::{CleaningCounts, CoreMesh, canonical};
use vdt::tree::{ErrorBound, Metric, Positions, StoredTree, Strategy as Order, Tree};
use vdt_tests::cut::{self, Node, smallest_first};
use vdt_tests::history::{self, History, history};
use vdt_tests::random_mesh::{RawMesh, any_mesh, closed_box, sheet, sphere, torus};
use vdt_tests::replay::PlainMesh;

const FILE: &str = "model.vdt";

/// Where something is, to the bit: what names a vertex through all renumbering.
type Place = [u32; 3];

fn place(position: [f32; 3]) -> Place {
    position.map(f32::to_bits)
}

/// A triangle of the input, and what has become of each of its corners.
type TriangleState = [(Place, Place); 3];

/// A mesh, the history of its simplification, and the tree.
struct Sample {
    core: CoreMesh,
    history: History,
    tree: Tree,
}

impl Sample {
    fn new(mesh: &RawMesh, metric: Metric, order: Order) -> Self {
        let core = canonical(mesh.positions.clone(), mesh.triangles.clone(), CleaningCounts::default()).unwrap();
        let history = history(&core, metric, order);
        let tree = history::tree(&core, metric, order);
        Sample { core, history, tree }
    }

    /// The model of the tree, on a disk in memory.
    fn disk(&self, blocking: Blocking) -> MemoryDisk {
        let disk = MemoryDisk::new();
        let (metric, strategy, error_bound) = (Metric::Quadric, Order::Passes, ErrorBound::default());
        let positions = Positions::Lossless;
        let options = ModelOptions { blocking, metric, strategy, error_bound, input_error: 0.0, positions };
        let tree = StoredTree::from_tree(self.tree.clone());
        let (path, resources) = (Path::new(FILE), WriteResources::in_memory());
        write_model(Arc::new(disk.clone()), path, &tree, &options, &resources, &mut |_| ()).unwrap();
        disk
    }

    /// Every triangle in every state that the construction went through, from the input to the last collapse.
    fn states(&self) -> HashSet<TriangleState> {
        let mut plain = PlainMesh::new(&self.core.positions, &self.core.triangles);
        let place = |vertex: u32| place(self.core.positions[vertex as usize]);
        let state = |(original, current): (&[u32; 3], [u32; 3])| {
            smallest_first([0, 1, 2].map(|corner| (place(original[corner]), place(current[corner]))))
        };
        let input: Vec<_> = self.core.triangles.iter().map(|corners| state((corners, *corners))).collect();
        let mut states: HashSet<TriangleState> = input.into_iter().collect();
        for collapse in &self.history.collapses {
            plain.collapse(collapse.born, collapse.kept);
            let current = plain.triangles.iter().zip(&self.core.triangles);
            let moved = current.filter_map(|(now, original)| now.map(|now| (original, now)));
            states.extend(moved.filter(|(_, now)| now.contains(&collapse.kept)).map(state));
        }
        states
    }
}

fn open(disk: &dyn Disk) -> Arc<Model> {
    Arc::new(Model::open(disk, Path::new(FILE)).unwrap())
}

/// Options for pictures in which small models have large errors.
fn options() -> NavigatorOptions {
    NavigatorOptions { width: 320, height: 240, io: Io::Sync, memory: 1 << 30, ..NavigatorOptions::default() }
}

/// The fewest bytes with which the model can be flown over.
fn smallest_memory(model: &Arc<Model>) -> u64 {
    match Navigator::open(model.clone(), NavigatorOptions { memory: 0, ..options() }) {
        Err(NavigatorError::Budget(error)) => error.smallest,
        other => panic!("{other:?}"),
    }
}

/// A camera around the model: `eye` and `target` are in diagonals from the middle of its box.
fn camera(model: &Model, eye: [f64; 3], target: [f64; 3]) -> Camera {
    let header = model.header();
    let size = if header.diagonal() > 0.0 { header.diagonal() } else { 1.0 };
    let at = |offset: [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|axis| {
            let middle = (f64::from(header.minimum[axis]) + f64::from(header.maximum[axis])) / 2.0;
            header.origin[axis] + middle + offset[axis] * size
        })
    };
    let target = if eye == target { [eye[0] + 1.0, eye[1], eye[2]] } else { target };
    Camera::looking_at(at(eye).into(), at(target).into(), 60.0)
}

/// A camera path: stands, jumps, and goes half the way.
fn path(model: &Model, stations: &[([f64; 3], [f64; 3])]) -> Vec<Camera> {
    let mut path = Vec::new();
    for (index, (eye, target)) in stations.iter().enumerate() {
        path.extend([camera(model, *eye, *target); 2]);
        if let Some((next, next_target)) = stations.get(index + 1) {
            let middle = |a: &[f64; 3], b: &[f64; 3]| [0, 1, 2].map(|axis| (a[axis] + b[axis]) / 2.0);
            path.push(camera(model, middle(eye, next), middle(target, next_target)));
        }
    }
    path
}

/// The nodes that are active, by the tree: each must be one of it, and together they must be a cut.
fn active_nodes(navigator: &Navigator, tree: &Tree) -> Vec<Node> {
    let drawn: BTreeMap<(u32, u32), _> =
        navigator.active_nodes().map(|active| ((active.leaf, active.end_leaf), active)).collect();
    assert_eq!(drawn.len(), navigator.active_count());
    let nodes = cut::cut(tree, |node| !drawn.contains_key(&(node.start, node.end)));
    assert_eq!(nodes.len(), drawn.len(), "an active node that is none of the tree, or twice the same leaf");
    for node in &nodes {
        let active = drawn.get(&(node.start, node.end)).expect("an active ancestor for each leaf");
        assert_eq!(active.position, tree.positions[node.start as usize]);
        let split = tree.splits.get(node.split as usize);
        assert_eq!(active.switch, split.map_or(0.0, |split| split.switch));
    }
    nodes
}

/// What is drawn must be the mesh of the cut: every triangle of it once, and no other.
fn assert_draws_the_cut(navigator: &Navigator, tree: &Tree) {
    let nodes = active_nodes(navigator, tree);
    let mut drawn: Vec<_> = navigator.triangles().map(|triangle| smallest_first(triangle.leaves)).collect();
    drawn.sort_unstable();
    let expected = cut::triangles(tree, &nodes);
    assert!(drawn == expected, "{} triangles are drawn, {} belong to the cut", drawn.len(), expected.len());
    assert_eq!(navigator.triangle_count(), expected.len());
    let sources: BTreeSet<_> = navigator.triangles().map(|triangle| smallest_first(triangle.source)).collect();
    assert_eq!(sources.len(), drawn.len(), "one triangle of the input is drawn twice");
    for triangle in navigator.triangles() {
        assert_eq!(triangle.positions, triangle.leaves.map(|leaf| tree.positions[leaf as usize]));
    }
}

/// Every triangle that is drawn must be one that the construction went through.
fn assert_draws_states(navigator: &Navigator, tree: &Tree, states: &HashSet<TriangleState>) {
    let at = |leaf: u32| place(tree.positions[leaf as usize]);
    for triangle in navigator.triangles() {
        let state = [0, 1, 2].map(|corner| (at(triangle.source[corner]), at(triangle.leaves[corner])));
        assert!(states.contains(&smallest_first(state)), "{triangle:?} never was");
    }
}

/// On a closed surface, whatever the level of detail, for each triangle that runs along an edge another runs back.
fn assert_is_closed(navigator: &Navigator) {
    let mut runs: BTreeMap<(u32, u32), i64> = BTreeMap::new();
    for [a, b, c] in navigator.triangles().map(|triangle| triangle.leaves) {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *runs.entry((from.min(to), from.max(to))).or_insert(0) += if from < to { 1 } else { -1 };
        }
    }
    let cracks: Vec<_> = runs.into_iter().filter(|(_, balance)| *balance != 0).collect();
    assert!(cracks.is_empty(), "{} cracks, as {:?}", cracks.len(), cracks[0]);
}

fn metrics() -> impl Strategy<Value = Metric> {
    prop_oneof![Just(Metric::Quadric), Just(Metric::Length)]
}

fn orders() -> impl Strategy<Value = Order> {
    prop_oneof![Just(Order::Passes), Just(Order::Btree)]
}

/// Pages so small that small trees have many, in both ways of blocking.
fn blockings() -> impl Strategy<Value = Blocking> {
    prop_oneof![
        3 => (4096..8192_u32, 2..9_u32).prop_map(|(slot_bytes, fan_out)| Blocking::Forest { slot_bytes, fan_out }),
        2 => (1..7_u32).prop_map(|levels| Blocking::Levels { levels }),
    ]
}

fn dependencies() -> impl Strategy<Value = Dependency> {
    prop_oneof![Just(Dependency::Implicit), Just(Dependency::Flip), Just(Dependency::None)]
}

fn io() -> impl Strategy<Value = Io> {
    prop_oneof![Just(Io::Sync), Just(Io::Thread)]
}

fn stations() -> impl Strategy<Value = Vec<([f64; 3], [f64; 3])>> {
    let eye = prop::array::uniform3(-1.2..1.2_f64);
    let target = prop::array::uniform3(-0.4..0.4_f64);
    prop::collection::vec((eye, target), 1..7)
}

/// Closed manifold surfaces, of one or several parts.
fn closed_meshes() -> impl Strategy<Value = RawMesh> {
    let one = prop_oneof![
        (3..10_u32, 3..10_u32, prop_oneof![Just(0.0), Just(0.2)], any::<u64>())
            .prop_map(|(around, across, noise, seed)| torus(around, across, noise, seed)),
        (0..4_u32, prop_oneof![Just(0.0), Just(0.2)], any::<u64>())
            .prop_map(|(times, noise, seed)| sphere(times, noise, seed)),
        Just(closed_box()),
    ];
    prop::collection::vec(one, 1..4).prop_map(|parts| {
        let mut mesh = RawMesh::default();
        for (number, part) in parts.iter().enumerate() {
            mesh.append(part, [10.0 * number as f64, 0.0, 0.0]);
        }
        mesh
    })
}

fn config(cases: u32) -> ProptestConfig {
    // Cases that once failed become tests of their own; a file beside this one would be of no use to anyone else.
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(config(500))]

    #[test]
    fn every_frame_draws_the_mesh_of_a_cut(
        mesh in any_mesh(),
        (metric, order) in (metrics(), orders()),
        blocking in blockings(),
        stations in stations(),
        (dependency, io) in (dependencies(), io()),
        (pixels, share, max_triangles) in (0.2..8.0_f32, 0.0..1.1_f64, prop::option::of(10..400_u64)),
        prefetch in any::<bool>(),
    ) {
        let sample = Sample::new(&mesh, metric, order);
        let (tree, states) = (&sample.tree, sample.states());
        let model = open(&sample.disk(blocking));
        let (smallest, whole) = (smallest_memory(&model), 600_000);
        let memory = smallest + ((whole as f64 - smallest as f64).max(0.0) * share) as u64;
        let options = NavigatorOptions { memory, pixels, dependency, io, max_triangles, prefetch, ..options() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        prop_assert!(navigator.budget_bytes() <= memory);
        let look = |navigator: &Navigator| {
            check(navigator).unwrap();
            assert_draws_the_cut(navigator, tree);
            if dependency == Dependency::Implicit {
                assert_draws_states(navigator, tree, &states);
            }
        };
        look(&navigator);
        let path = path(&model, &stations);
        for camera in &path {
            let frame = navigator.frame(camera).unwrap();
            look(&navigator);
            prop_assert_eq!(frame.triangles, navigator.triangle_count() as u64);
            prop_assert_eq!(frame.vertices, navigator.active_count() as u64);
            prop_assert!(frame.triangles <= max_triangles.unwrap_or(u64::MAX));
            prop_assert!(io == Io::Thread || frame.misses == 0);
        }

        // Where the camera stands still, the picture comes to rest, and stays as it is.
        let last = path.last().unwrap();
        navigator.run_until_settled(last, 5000).unwrap();
        prop_assert!(navigator.settled());
        look(&navigator);
        let at_rest = active_nodes(&navigator, tree);
        for _ in 0..3 {
            let frame = navigator.frame(last).unwrap();
            prop_assert_eq!((frame.splits, frame.collapses, frame.misses), (0, 0, 0));
            prop_assert!(navigator.settled());
        }
        prop_assert_eq!(active_nodes(&navigator, tree), at_rest);
    }

    #[test]
    fn a_closed_surface_has_no_crack_in_any_frame(
        mesh in closed_meshes(),
        (metric, order) in (metrics(), orders()),
        blocking in blockings(),
        stations in stations(),
        (dependency, io) in (dependencies(), io()),
        pixels in 0.2..8.0_f32,
        share in 0.0..1.1_f64,
    ) {
        let sample = Sample::new(&mesh, metric, order);
        let model = open(&sample.disk(blocking));
        let smallest = smallest_memory(&model);
        let memory = smallest + (share * 300_000.0) as u64;
        let options = NavigatorOptions { memory, pixels, dependency, io, ..options() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        for camera in path(&model, &stations) {
            navigator.frame(&camera).unwrap();
            check(&navigator).unwrap();
            assert_draws_the_cut(&navigator, &sample.tree);
            assert_is_closed(&navigator);
        }
    }

    /// With all the memory there is, and next to no error allowed, the mesh itself is drawn; from very far away, nothing
    /// but the roots; and the way back leads to the same mesh.
    #[test]
    fn from_everything_to_nothing_and_back(
        mesh in any_mesh(),
        (metric, order) in (metrics(), orders()),
        blocking in blockings(),
        (dependency, io) in (dependencies(), io()),
    ) {
        let sample = Sample::new(&mesh, metric, order);
        let tree = &sample.tree;
        let model = open(&sample.disk(blocking));
        let options = NavigatorOptions { pixels: 1e-9, dependency, io, ..options() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        let near = camera(&model, [0.6, 0.7, 0.8], [0.0; 3]);
        // So far that with `flip`, too, nothing is kept for the sake of a triangle.
        let far = camera(&model, [1e15, 1e15, 1e15], [0.0; 3]);
        let at = |corner: u32| place(sample.core.positions[corner as usize]);
        let mut everything: Vec<_> = sample.core.triangles.iter().map(|t| smallest_first(t.map(at))).collect();
        everything.sort_unstable();
        for _ in 0..2 {
            navigator.run_until_settled(&near, 10_000).unwrap();
            assert_draws_the_cut(&navigator, tree);
            prop_assert!(navigator.settled());
            prop_assert_eq!(navigator.active_count(), tree.leaf_count());
            let mut drawn: Vec<_> = navigator.triangles().map(|t| smallest_first(t.positions.map(place))).collect();
            drawn.sort_unstable();
            prop_assert_eq!(&drawn, &everything);
            navigator.run_until_settled(&far, 10_000).unwrap();
            check(&navigator).unwrap();
            prop_assert_eq!((navigator.active_count(), navigator.triangle_count()), (tree.roots.len(), 0));
        }
    }

    /// The streaming uniform cut is the brute-force one, at any error; and the error for a number of triangles is the
    /// smallest that does.
    #[test]
    fn uniform_cuts_are_the_brute_force_ones(
        mesh in any_mesh(),
        (metric, order) in (metrics(), orders()),
        blocking in blockings(),
        shares in prop::collection::vec(0.0..1.0_f64, 4),
        limits in prop::collection::vec(0..400_u64, 4),
    ) {
        let sample = Sample::new(&mesh, metric, order);
        let tree = &sample.tree;
        let model = open(&sample.disk(blocking));
        verify(&model, &mut |_| {}).unwrap();
        let mut switches: Vec<f32> = tree.roots.iter().flat_map(|root| root.start + 1..root.end)
            .map(|split| tree.splits[split as usize].switch)
            .collect();
        switches.sort_by(f32::total_cmp);
        let mut errors = vec![0.0, f32::MIN_POSITIVE, f32::MAX, f32::INFINITY];
        for share in shares.iter().filter(|_| !switches.is_empty()) {
            let switch = switches[(share * switches.len() as f64) as usize];
            errors.extend([switch, switch.next_down(), switch.next_up(), switch * *share as f32]);
        }
        let brute_force = |error: f32| cut::cut(tree, |node| tree.splits[node.split as usize].switch > error);
        for error in errors {
            let nodes = brute_force(error);
            let expected = cut::triangles(tree, &nodes);
            let cut = UniformCut::new(&model, error).unwrap();
            prop_assert_eq!(cut.vertex_count(), nodes.len() as u64);
            prop_assert_eq!(cut.triangle_count(), expected.len() as u64);
            let mut positions = Vec::new();
            cut.for_each_vertex(|position| -> Result<(), ModelError> {
                positions.push(position);
                Ok(())
            }).unwrap();
            let at = |node: &Node| tree.positions[node.start as usize];
            prop_assert_eq!(positions, nodes.iter().map(at).collect::<Vec<_>>());
            let mut triangles = Vec::new();
            cut.for_each_triangle(|corners| -> Result<(), ModelError> {
                triangles.push(smallest_first(corners.map(|corner| nodes[corner as usize].start)));
                Ok(())
            }).unwrap();
            triangles.sort_unstable();
            prop_assert_eq!(&triangles, &expected);
            let said = cut.statement().unwrap();
            let tree_of = |leaf: u32| tree.roots.partition_point(|root| root.start <= leaf);
            let drawn: HashSet<usize> = expected.iter().map(|starts| tree_of(starts[0])).collect();
            prop_assert_eq!(said.vanished_parts as usize, tree.roots.len() - drawn.len());
            let unsplit = nodes.iter().filter(|node| drawn.contains(&tree_of(node.start)));
            let unsplit = unsplit.filter_map(|node| tree.splits.get(node.split as usize)).map(|split| split.switch);
            prop_assert_eq!(said.error_drawn, unsplit.fold(0.0, f32::max));
        }
        for limit in limits {
            let count = |error: f32| cut::triangles(tree, &brute_force(error)).len() as u64;
            let error = error_for_triangles(&model, limit).unwrap();
            prop_assert!(count(error) <= limit, "{} triangles, not {}", count(error), limit);
            prop_assert!(error == 0.0 || count(error.next_down()) > limit, "{error} is more than is needed");
        }
    }
}

/// A disk that takes its time for each read.
#[derive(Debug)]
struct SlowDisk {
    disk: MemoryDisk,
    time: Duration,
}

#[derive(Debug)]
struct SlowFile {
    file: Arc<dyn ReadAt>,
    time: Duration,
}

impl ReadAt for SlowFile {
    fn path(&self) -> &Path {
        self.file.path()
    }

    fn length(&self) -> u64 {
        self.file.length()
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<usize, StorageError> {
        std::thread::sleep(self.time);
        self.file.read_at(offset, buffer)
    }
}

impl Disk for SlowDisk {
    fn open(&self, path: &Path) -> Result<Arc<dyn ReadAt>, StorageError> {
        Ok(Arc::new(SlowFile { file: self.disk.open(path)?, time: self.time }))
    }

    fn create_new(&self, path: &Path) -> Result<Box<dyn WriteFile>, StorageError> {
        self.disk.create_new(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> Result<(), StorageError> {
        self.disk.rename(from, to)
    }

    fn remove(&self, path: &Path) -> Result<(), StorageError> {
        self.disk.remove(path)
    }

    fn list(&self, folder: &Path) -> Result<Vec<PathBuf>, StorageError> {
        self.disk.list(folder)
    }

    fn exists(&self, path: &Path) -> bool {
        self.disk.exists(path)
    }
}

/// A large closed surface, a disk that is much too slow, and a budget that is too small, through which the camera flies
/// right over the surface: frame after frame with misses, none with a crack, and in the end all is there.
#[test]
fn a_fast_flight_over_a_slow_disk() {
    let sample = Sample::new(&sphere(5, 0.03, 12), Metric::Quadric, Order::Passes);
    let (tree, states) = (&sample.tree, sample.states());
    for dependency in [Dependency::Implicit, Dependency::Flip, Dependency::None] {
        let disk = sample.disk(Blocking::Forest { slot_bytes: 4096, fan_out: 4 });
        let model = open(&SlowDisk { disk, time: Duration::from_millis(1) });
        assert!(model.header().page_count > 40);
        let memory = smallest_memory(&model) + 400_000;
        let options = NavigatorOptions { memory, dependency, io: Io::Thread, pixels: 2.0, ..options() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        let (mut misses, mut limited) = (0, 0);
        let flight = (0..120).map(|frame| {
            let (y, x) = (f64::from(frame) * 0.1).sin_cos();
            camera(&model, [0.45 * x, 0.45 * y, 0.1], [0.3 * x - 0.2 * y, 0.3 * y + 0.2 * x, 0.0])
        });
        let flight: Vec<Camera> = flight.collect();
        for camera in &flight {
            let statistics = navigator.frame(camera).unwrap();
            misses += u64::from(statistics.misses > 0);
            limited += u64::from(statistics.threshold_factor > 1.0);
            check(&navigator).unwrap();
            assert_draws_the_cut(&navigator, tree);
            assert_is_closed(&navigator);
            if dependency == Dependency::Implicit {
                assert_draws_states(&navigator, tree, &states);
            }
        }
        assert!(misses > 10, "{misses} frames with misses: the disk was not slow enough to test anything");
        navigator.run_until_settled(&flight[flight.len() - 1], 5000).unwrap();
        assert!(navigator.settled());
        assert!(navigator.triangle_count() > 500, "{}", navigator.triangle_count());
        assert_draws_the_cut(&navigator, tree);
        assert!(limited < 120, "the budget is never enough");
    }
}

/// Without dependencies, there are triangles that never were: the check for them above can fail.
#[test]
fn without_dependencies_triangles_are_drawn_that_never_were() {
    let sample = Sample::new(&sheet(30, 30, 0.8, 0, 5), Metric::Quadric, Order::Passes);
    let states = sample.states();
    let model = open(&sample.disk(Blocking::default()));
    let strange = |dependency: Dependency| {
        let mut navigator = Navigator::open(model.clone(), NavigatorOptions { dependency, ..options() }).unwrap();
        let close = camera(&model, [0.02, 0.01, 0.05], [0.1, 0.1, 0.0]);
        navigator.run_until_settled(&close, 1000).unwrap();
        assert!(navigator.triangle_count() > 100);
        let at = |leaf: u32| place(sample.tree.positions[leaf as usize]);
        let state = |triangle: navigator::ActiveTriangle| {
            smallest_first([0, 1, 2].map(|corner| (at(triangle.source[corner]), at(triangle.leaves[corner]))))
        };
        navigator.triangles().filter(|triangle| !states.contains(&state(*triangle))).count()
    };
    assert_eq!(strange(Dependency::Implicit), 0);
    assert!(strange(Dependency::None) > 0);
}

/// By brute force: of the triangles that would be turned round against the input, repairs leave few.
#[test]
fn repairs_turn_triangles_the_right_way_round() {
    let flipped = |dependency: Dependency| {
        let mut flipped = 0;
        for (seed, mesh) in [(5, sheet(40, 40, 0.8, 0, 5)), (12, sphere(5, 0.05, 12))] {
            let sample = Sample::new(&mesh, Metric::Quadric, Order::Passes);
            let model = open(&sample.disk(Blocking::default()));
            let mut navigator = Navigator::open(model.clone(), NavigatorOptions { dependency, ..options() }).unwrap();
            for step in 0..40 {
                let (y, x) = (f64::from(step) * 0.3 + f64::from(seed)).sin_cos();
                navigator.frame(&camera(&model, [0.6 * x, 0.6 * y, 0.2], [0.2 * y, 0.2 * x, 0.0])).unwrap();
                let normal = |[a, b, c]: [[f32; 3]; 3]| {
                    let [u, v] = [b, c].map(|to| [0, 1, 2].map(|axis| f64::from(to[axis]) - f64::from(a[axis])));
                    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
                };
                flipped += navigator
                    .triangles()
                    .filter(|triangle| {
                        let original = normal(triangle.source.map(|leaf| sample.tree.positions[leaf as usize]));
                        normal(triangle.positions).iter().zip(original).map(|(a, b)| a * b).sum::<f64>() < 0.0
                    })
                    .count();
            }
        }
        flipped
    };
    let (none, flip) = (flipped(Dependency::None), flipped(Dependency::Flip));
    assert!(none > 5 && flip * 4 < none, "{flip} with repairs, {none} without");
}
