//! The navigator as a whole: random trees, blockings, budgets and camera paths.

use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use glam::{DVec3, Vec3};
use metanode::chain::PageChain;
use metanode::header::Blocking;
use metanode::model::Model;
use metanode::page::PageLocation;
use metanode::{DecodedFile, DrawnMesh, write_decoded};
use proptest::prelude::*;
use storage::{Disk, FaultyDisk, LocalDisk, MapAdvice, MemoryDisk};
use vdt::tree::{NO_SPLIT, Tree};

use crate::budget::{Streams, plan_with};
use crate::check::{Undone, check, check_cut, undone};
use crate::evaluation::Test;
use crate::flip::tests::{is_flipped, triangle_is_proven};
use crate::testing::{self, Attributes, Mesh, Random, SMALL_PAGES};
use crate::view::{Sphere, View};
use crate::{
    Camera, Dependency, DrawnWedge, FlightSummary, FrameStatistics, Io, Light, Navigator, NavigatorError,
    NavigatorOptions, Policy, PoolCounters, ViewParameters,
};

fn open(disk: &dyn Disk) -> Arc<Model> {
    Arc::new(Model::open(disk, Path::new("model.vdt")).unwrap())
}

fn navigator(tree: &Tree, options: &NavigatorOptions) -> Navigator {
    Navigator::open(testing::model_of(tree), options.clone()).unwrap()
}

/// Options for pictures in which small models have large errors.
fn options() -> NavigatorOptions {
    NavigatorOptions { width: 320, height: 240, io: Io::Sync, memory: 1 << 30, ..NavigatorOptions::default() }
}

/// The fewest bytes with which the model can be navigated.
fn smallest_memory(model: &Arc<Model>) -> u64 {
    match Navigator::open(model.clone(), NavigatorOptions { memory: 0, ..options() }) {
        Err(NavigatorError::Budget(error)) => error.smallest,
        other => panic!("{other:?}"),
    }
}

/// A camera around the model: `place` and `aim` are in diagonals from the middle of its box.
fn camera(model: &Model, place: [f64; 3], aim: [f64; 3]) -> Camera {
    let header = model.header();
    let corner = |corner: [f32; 3]| DVec3::from_array(corner.map(f64::from));
    let middle = DVec3::from_array(header.origin) + (corner(header.minimum) + corner(header.maximum)) / 2.0;
    let size = header.diagonal().max(1.0);
    let eye = middle + DVec3::from_array(place) * size;
    let target = middle + DVec3::from_array(aim) * size;
    Camera::looking_at(eye, if target == eye { eye + DVec3::X } else { target }, 60.0)
}

/// The mesh of the cut, by its definition: the triangles whose corners have three distinct active ancestors.
fn assert_is_mesh_of_cut(navigator: &Navigator, tree: &Tree) {
    let mut ancestors = vec![u32::MAX; tree.leaf_count()];
    for node in navigator.active_nodes() {
        ancestors[node.leaf as usize..node.end_leaf as usize].fill(node.leaf);
        assert_eq!(node.position, tree.positions[node.leaf as usize]);
    }
    let ancestors_of = |corners: &[u32; 3]| corners.map(|corner| ancestors[corner as usize]);
    let is_drawn = |corners: &&[u32; 3]| {
        let [a, b, c] = ancestors_of(corners);
        a != b && b != c && c != a
    };
    let mut expected: Vec<_> =
        tree.triangles.corners.iter().filter(is_drawn).map(|corners| (*corners, ancestors_of(corners))).collect();
    let mut drawn: Vec<_> = navigator.triangles().map(|triangle| (triangle.source, triangle.leaves)).collect();
    expected.sort_unstable();
    drawn.sort_unstable();
    assert!(expected == drawn, "{} triangles are drawn, {} belong to the cut", drawn.len(), expected.len());
    for triangle in navigator.triangles() {
        assert_eq!(triangle.positions, triangle.leaves.map(|leaf| tree.positions[leaf as usize]));
    }
}

/// The first leaves of the active nodes.
fn starts(navigator: &Navigator) -> Vec<u32> {
    let mut starts: Vec<_> = navigator.active_nodes().map(|node| node.leaf).collect();
    starts.sort_unstable();
    starts
}

/// Every active node but the roots begins at a leaf that an applied split bears; and their meta-nodes are those in use.
fn assert_are_applied_splits(navigator: &Navigator, tree: &Tree, pages_in_use: u64) {
    let mut leaves: Vec<_> = navigator.applied_splits().map(|split| split.born_leaf).collect();
    leaves.extend(tree.roots.iter().map(|root| root.start));
    leaves.sort_unstable();
    assert_eq!(leaves, starts(navigator));
    let pages: HashSet<_> = navigator.applied_splits().map(|split| split.page).collect();
    assert_eq!(pages.len() as u64, pages_in_use);
}

/// The first leaves of active nodes, as `starts`, for the cut in which exactly the nodes are split that exceed a test and whose ancestors
/// do.
fn cut_by_criterion(tree: &Tree, test: &Test) -> Vec<u32> {
    cut_where(tree, |start, split| exceeds(tree, test, start, split))
}

/// The same, where a node is split, too, for the sake of any below it: whatever is split there keeps it from being restored. Its
/// own error may be smaller. Roots are stored with cones just as they are, those below with wider ones (`docs/format.md`, 9.8).
fn cut_kept_by_any_below(tree: &Tree, test: &Test) -> Vec<u32> {
    // Children before parents.
    let mut nodes: Vec<(u32, u32)> = tree.roots.iter().map(|root| (root.start, root.split)).collect();
    nodes.retain(|(_, split)| *split != NO_SPLIT);
    let mut next = 0;
    while let Some((start, split)) = nodes.get(next).copied() {
        let children = &tree.splits[split as usize];
        nodes.extend(
            [(start, children.kept), (split, children.born)].into_iter().filter(|(_, child)| *child != NO_SPLIT),
        );
        next += 1;
    }
    let mut is_kept = HashSet::new();
    for (start, split) in nodes.into_iter().rev() {
        let children = &tree.splits[split as usize];
        if exceeds(tree, test, start, split) || is_kept.contains(&children.kept) || is_kept.contains(&children.born) {
            is_kept.insert(split);
        }
    }
    cut_where(tree, |_, split| is_kept.contains(&split))
}

/// Whether the error of a node, that stands at the leaf `start`, is above the threshold.
fn exceeds(tree: &Tree, test: &Test, start: u32, split: u32) -> bool {
    let split = &tree.splits[split as usize];
    let position = tree.positions[start as usize];
    test.is_exceeded(&Sphere { position, radius: split.radius, switch: split.switch, cone: split.cone })
}

/// The first leaves of the nodes of the cut above which all are split for which that is said.
fn cut_where(tree: &Tree, is_split: impl Fn(u32, u32) -> bool) -> Vec<u32> {
    let mut starts = Vec::new();
    for root in &tree.roots {
        let mut stack = vec![(root.start, root.split)];
        while let Some((start, split)) = stack.pop() {
            if split != NO_SPLIT && is_split(start, split) {
                stack.push((start, tree.splits[split as usize].kept));
                stack.push((split, tree.splits[split as usize].born));
            } else {
                starts.push(start);
            }
        }
    }
    starts.sort_unstable();
    starts
}

fn views() -> impl Strategy<Value = ViewParameters> {
    let lights = (prop::array::uniform3(0.1_f64..1.0), 1.0_f32..4.0)
        .prop_map(|(direction, highlights)| Light { direction: direction.into(), highlights });
    (any::<bool>(), any::<bool>(), 1.0_f32..4.0, prop::option::of(lights))
        .prop_map(|(frustum, cones, silhouettes, light)| ViewParameters { frustum, cones, silhouettes, light })
}

fn meshes() -> impl Strategy<Value = Mesh> {
    let one = prop_oneof![
        (1..16_u32, 1..16_u32, any::<u64>()).prop_map(|(width, height, seed)| Mesh::grid(width, height, seed)),
        (0..4_u32).prop_map(Mesh::sphere),
        (2..10_u32, 2..10_u32, any::<u64>()).prop_map(|(w, h, seed)| Mesh::grid(w, h, seed).tangled(seed)),
    ];
    prop_oneof![
        2 => one.clone(),
        1 => prop::collection::vec(one, 1..6).prop_map(Mesh::beside),
        1 => (20..90_usize, any::<u64>()).prop_map(|(parts, seed)| many_parts(parts, seed)),
    ]
}

/// So many small parts, more than the first page has room for: most trees begin further down.
fn many_parts(parts: usize, seed: u64) -> Mesh {
    let mut random = Random(seed);
    Mesh::beside((0..parts).map(|_| Mesh::grid(1 + random.below(4) as u32, 1 + random.below(4) as u32, seed)).collect())
}

fn trees() -> impl Strategy<Value = Tree> {
    let choice = prop_oneof![Just(1_usize), Just(4), Just(30)];
    (meshes(), any::<u64>(), choice).prop_map(|(mesh, seed, choice)| mesh.into_tree(seed, choice))
}

fn blockings() -> impl Strategy<Value = Blocking> {
    prop_oneof![
        3 => (4096..6000_u32, 2..9_u32)
            .prop_map(|(slot_bytes, fan_out)| Blocking::Forest { slot_bytes, fan_out }),
        2 => (1..6_u32).prop_map(|levels| Blocking::Levels { levels }),
    ]
}

fn cameras() -> impl Strategy<Value = Vec<([f64; 3], [f64; 3])>> {
    let place = prop::array::uniform3(-1.5..1.5_f64);
    let aim = prop::array::uniform3(-0.4..0.4_f64);
    prop::collection::vec((place, aim), 1..8)
}

/// Each camera held for two frames, with one half way in between.
fn path(model: &Model, cameras: &[([f64; 3], [f64; 3])]) -> Vec<Camera> {
    let mut path = Vec::new();
    for (index, (place, aim)) in cameras.iter().enumerate() {
        path.extend([camera(model, *place, *aim); 2]);
        if let Some((next, next_aim)) = cameras.get(index + 1) {
            let middle = |a: &[f64; 3], b: &[f64; 3]| [0, 1, 2].map(|axis| (a[axis] + b[axis]) / 2.0);
            path.push(camera(model, middle(place, next), middle(aim, next_aim)));
        }
    }
    path
}

fn policies() -> impl Strategy<Value = Policy> {
    prop_oneof![Just(Policy::SecondChance), Just(Policy::LeastRecentlyUsed), Just(Policy::None)]
}

fn dependencies() -> impl Strategy<Value = Dependency> {
    prop_oneof![Just(Dependency::Implicit), Just(Dependency::Flip), Just(Dependency::None)]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn every_frame_shows_the_mesh_of_a_cut(
        tree in trees(),
        blocking in blockings(),
        cameras in cameras(),
        dependency in dependencies(),
        io in prop_oneof![Just(Io::Sync), Just(Io::Thread)],
        (pixels, share, max_triangles) in (0.3..6.0_f32, 0.0..1.2_f64, prop::option::of(10..400_u64)),
        (prefetch, policy) in (any::<bool>(), policies()),
        io_threads in prop::option::of(1..4_usize),
    ) {
        let disk = testing::disk_of(&tree, blocking);
        let model = open(&disk);
        let (smallest, whole) = (smallest_memory(&model), 1 << 20);
        let memory = smallest + ((whole as f64 - smallest as f64).max(0.0) * share * share) as u64;
        let options =
            NavigatorOptions { memory, pixels, dependency, io, io_threads, max_triangles, prefetch, policy, ..options() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        prop_assert!(navigator.budget_bytes() <= memory);
        prop_assert_eq!(navigator.active_count(), tree.roots.len());
        let path = path(&model, &cameras);
        for (number, camera) in path.iter().enumerate() {
            let statistics = navigator.frame(camera).unwrap();
            check(&navigator).unwrap();
            assert_is_mesh_of_cut(&navigator, &tree);
            assert_are_applied_splits(&navigator, &tree, statistics.pages_in_use);
            prop_assert_eq!(statistics.frame, number as u64);
            prop_assert_eq!(statistics.triangles, navigator.triangle_count() as u64);
            prop_assert_eq!(statistics.requests, statistics.splits + statistics.collapses + statistics.misses);
            prop_assert!(statistics.triangles <= max_triangles.unwrap_or(u64::MAX));
            prop_assert!(statistics.forced <= statistics.splits);
            if io == Io::Sync {
                prop_assert_eq!(statistics.misses, 0);
            }
            if policy == Policy::None {
                prop_assert_eq!(statistics.pool.second_chances, 0);
            }
        }
        // Limits and all: with the camera at rest, the picture comes to rest.
        navigator.run_until_settled(path.last().unwrap(), 2000).unwrap();
        prop_assert!(navigator.settled());
        check(&navigator).unwrap();
        prop_assert_eq!(undone(&navigator, path.last().unwrap()).unwrap(), Undone::default());
        assert_is_mesh_of_cut(&navigator, &tree);
        // And stays there: no part of the front wishes for anything later.
        for _ in 0..6 {
            navigator.frame(path.last().unwrap()).unwrap();
            prop_assert!(navigator.settled());
        }
    }

    #[test]
    fn the_settled_cut_is_that_of_the_criterion(
        tree in trees(),
        blocking in blockings(),
        cameras in cameras(),
        pixels in 0.3..6.0_f32,
        view in views(),
        io in prop_oneof![Just(Io::Sync), Just(Io::Thread)],
    ) {
        let disk = testing::disk_of(&tree, blocking);
        let model = open(&disk);
        let options = NavigatorOptions { pixels, io, view, dependency: Dependency::None, ..options() };
        let path = path(&model, &cameras);
        let view = |camera: &Camera| View::new(camera, model.header(), options.width, options.height, &options.view).unwrap();
        let judged = testing::as_written(&tree, &model);

        let mut fresh = Navigator::open(model.clone(), options.clone()).unwrap();
        let statistics = fresh.run_until_settled(&path[0], 10_000).unwrap();
        prop_assert!(fresh.settled());
        prop_assert_eq!(starts(&fresh), cut_by_criterion(&judged, &view(&path[0]).splits(pixels)));
        prop_assert_eq!(statistics.threshold_factor, 1.0);

        // After a flight, between the cuts of the two thresholds of the hysteresis.
        for camera in &path {
            fresh.frame(camera).unwrap();
        }
        let last = path.last().unwrap();
        fresh.run_until_settled(last, 10_000).unwrap();
        prop_assert!(fresh.settled());
        let found: HashSet<u32> = starts(&fresh).into_iter().collect();
        let finer: HashSet<u32> = cut_kept_by_any_below(&judged, &view(last).collapses(pixels)).into_iter().collect();
        prop_assert!(found.is_subset(&finer));
        prop_assert!(cut_by_criterion(&judged, &view(last).splits(pixels)).iter().all(|start| found.contains(start)));
    }

    /// Dependencies delay nothing for ever: what is to be split is split, with all that has to be split for it.
    #[test]
    fn forced_splits_reach_the_error_asked_for(
        tree in trees(),
        blocking in blockings(),
        cameras in cameras(),
        pixels in 0.3..6.0_f32,
        io in prop_oneof![Just(Io::Sync), Just(Io::Thread)],
    ) {
        let disk = testing::disk_of(&tree, blocking);
        let model = open(&disk);
        let options = NavigatorOptions { pixels, io, ..options() };
        let mut navigator = Navigator::open(model.clone(), options.clone()).unwrap();
        let judged = testing::as_written(&tree, &model);
        for camera in path(&model, &cameras) {
            navigator.run_until_settled(&camera, 10_000).unwrap();
            prop_assert!(navigator.settled());
            check(&navigator).unwrap();
            let view = View::new(&camera, model.header(), options.width, options.height, &options.view).unwrap();
            let found: HashSet<u32> = starts(&navigator).into_iter().collect();
            prop_assert!(cut_by_criterion(&judged, &view.splits(pixels)).iter().all(|start| found.contains(start)));
        }
    }

    /// Who copies what has changed has what is there, as soon as it is copied, however many frames that were.
    #[test]
    fn copies_kept_up_to_date_are_the_streams(
        tree in trees(),
        cameras in cameras(),
        dependency in dependencies(),
        (pixels, max_adapts) in (0.3..6.0_f32, prop::option::of(10..400_u64)),
        (gap, copied_every) in (0..200_u32, 1..4_usize),
    ) {
        let model = testing::model_of(&tree);
        let options = NavigatorOptions { pixels, dependency, max_adapts, ..options() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for (number, camera) in path(&model, &cameras).iter().enumerate() {
            navigator.frame(camera).unwrap();
            if number % copied_every > 0 {
                continue;
            }
            update(&mut vertices, navigator.vertex_stream(), navigator.changed_vertices(gap));
            update(&mut triangles, navigator.triangle_stream(), navigator.changed_triangles(gap));
            navigator.forget_changes();
            prop_assert!(navigator.changed_vertices(gap).next().is_none());
            prop_assert!(navigator.changed_triangles(gap).next().is_none());
            prop_assert_eq!(&triangles, navigator.triangle_stream());
            for node in navigator.active_nodes() {
                prop_assert_eq!(vertices[node.node as usize], navigator.vertex_stream()[node.node as usize]);
                prop_assert_eq!(&vertices[node.node as usize][..3], &node.position);
            }
            let is_drawn = |corners: &&[u32; 3]| corners[0] != corners[1] && corners[1] != corners[2] && corners[2] != corners[0];
            prop_assert!(triangles.iter().all(|corners| is_drawn(&corners) || *corners == [corners[0]; 3]));
            let mut copied: Vec<_> = triangles.iter().filter(is_drawn).copied().collect();
            let mut drawn: Vec<_> = navigator.triangles().map(|triangle| triangle.nodes).collect();
            copied.sort_unstable();
            drawn.sort_unstable();
            prop_assert_eq!(copied, drawn);
        }
    }

    /// With attributes: the triangles are those of the cut with the wedges that their corners have there, by way of the streams and of
    /// copies of what changed of them; all within the budget.
    #[test]
    fn corners_have_the_wedges_of_the_cut(
        tree in trees(),
        (blocking, seed) in (blockings(), any::<u64>()),
        cameras in cameras(),
        dependency in dependencies(),
        io in prop_oneof![Just(Io::Sync), Just(Io::Thread)],
        (pixels, share, max_triangles) in (0.3..6.0_f32, 0.0..1.2_f64, prop::option::of(10..400_u64)),
        (max_adapts, geomorph) in (prop::option::of(10..400_u64), 0..3_u32),
        (gap, copied_every) in (0..200_u32, 1..4_usize),
    ) {
        let disk = Attributes::random(&tree, seed).disk_of(&tree, blocking);
        let model = open(&disk);
        let options = NavigatorOptions {
            attributes: true, pixels, dependency, io, max_triangles, max_adapts, geomorph, memory: 0, ..options()
        };
        let smallest = match Navigator::open(model.clone(), options.clone()) {
            Err(NavigatorError::Budget(error)) => error.smallest,
            other => panic!("{other:?}"),
        };
        let memory = smallest + ((f64::from(1 << 20) - smallest as f64).max(0.0) * share * share) as u64;
        let mut navigator = Navigator::open(model.clone(), NavigatorOptions { memory, ..options }).unwrap();
        prop_assert!(navigator.budget_bytes() <= memory);
        let mut copies = Copies::default();
        for (number, camera) in path(&model, &cameras).iter().enumerate() {
            navigator.frame(camera).unwrap();
            check(&navigator).unwrap();
            prop_assert!(navigator.front_bytes() < navigator.budget_bytes());
            if number % copied_every == 0 {
                copies.update(&mut navigator, gap);
                prop_assert_eq!(copies.drawn(&model), expected_corners(&navigator));
            }
        }
        let last = camera(&model, cameras[0].0, cameras[0].1);
        navigator.run_until_settled(&last, 2000).unwrap();
        prop_assert!(navigator.settled());
        copies.update(&mut navigator, gap);
        prop_assert_eq!(copies.drawn(&model), expected_corners(&navigator));
    }

    /// With geomorphs, where a point of the surface is drawn changes by no more than one step of its way, whatever is split in a
    /// frame. And copies of the morphs kept up to date are the stream.
    #[test]
    fn no_split_is_seen_to_jump(
        tree in trees(),
        cameras in cameras(),
        dependency in dependencies(),
        (pixels, max_adapts) in (0.3..6.0_f32, prop::option::of(10..400_u64)),
        (geomorph, gap) in (1..9_u32, 0..200_u32),
    ) {
        let model = testing::model_of(&tree);
        let options = NavigatorOptions { pixels, dependency, max_adapts, geomorph, ..options() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        // Leaf by leaf, as numbers of vertices change: where it is drawn, how far it is, and how long a step is.
        let drawn = |navigator: &Navigator| -> HashMap<u32, (Vec3, f32, f32)> {
            let places = navigator.active_nodes().map(|node| {
                let [x, y, z, weight] = navigator.morph_stream()[node.node as usize];
                let (origin, position) = (Vec3::new(x, y, z), Vec3::from_array(node.position));
                let place = if weight < 1.0 { origin.lerp(position, weight) } else { position };
                (node.leaf, (place, weight, origin.distance(position) / geomorph as f32))
            });
            places.collect()
        };
        let rounding = 1e-5 * model.header().diagonal() as f32;
        let mut morphs = Vec::new();
        for camera in path(&model, &cameras) {
            let before = drawn(&navigator);
            let frame = navigator.frame(&camera).unwrap();
            let after = drawn(&navigator);
            for (leaf, (place, weight, step)) in &after {
                match before.get(leaf) {
                    Some((last, was, _)) if *was == 1.0 && *weight == 1.0 => prop_assert_eq!(last, place),
                    Some((last, ..)) if *weight > 0.0 => {
                        prop_assert!(last.distance(*place) <= step + rounding, "leaf {leaf}: {last} to {place}");
                    }
                    // It was born where another vertex was drawn: one that was there before the frame, or that was born in it, too.
                    _ => {
                        let mut others = before.values().chain(after.values().filter(|(.., step)| *step > 0.0));
                        let is_there = others.any(|(other, ..)| other.distance(*place) <= rounding);
                        prop_assert!(is_there, "leaf {leaf} at {place}");
                    }
                }
            }
            update(&mut morphs, navigator.morph_stream(), navigator.changed_morphs(gap));
            navigator.forget_changes();
            for node in navigator.active_nodes() {
                prop_assert_eq!(morphs[node.node as usize], navigator.morph_stream()[node.node as usize]);
            }
            prop_assert!(frame.morphs > 0 || after.values().all(|(_, weight, _)| *weight == 1.0));
        }
        navigator.run_until_settled(path(&model, &cameras).last().unwrap(), 10_000).unwrap();
        prop_assert!(navigator.settled() && drawn(&navigator).values().all(|(_, weight, _)| *weight == 1.0));
    }

    /// Nothing that a cone proves is flipped, by brute force; and without dependencies or with repairs, the wishes come true.
    #[test]
    fn what_cones_prove_is_not_flipped(
        tree in trees(),
        blocking in blockings(),
        cameras in cameras(),
        pixels in 0.3..6.0_f32,
        dependency in prop_oneof![Just(Dependency::Flip), Just(Dependency::None)],
    ) {
        let disk = testing::disk_of(&tree, blocking);
        let model = open(&disk);
        let options = NavigatorOptions { pixels, dependency, ..options() };
        let mut navigator = Navigator::open(model.clone(), options.clone()).unwrap();
        let judged = testing::as_written(&tree, &model);
        let original = |leaves: [u32; 3]| leaves.map(|leaf| tree.positions[leaf as usize]);
        for camera in path(&model, &cameras) {
            navigator.run_until_settled(&camera, 10_000).unwrap();
            prop_assert!(navigator.settled());
            for ((triangle, _), drawn) in navigator.front().triangles().zip(navigator.triangles()) {
                let is_flipped = is_flipped(drawn.positions, original(drawn.source));
                prop_assert!(!(is_flipped && triangle_is_proven(navigator.front(), triangle)), "{:?}", drawn);
            }
            let view = View::new(&camera, model.header(), options.width, options.height, &options.view).unwrap();
            let found: HashSet<u32> = starts(&navigator).into_iter().collect();
            prop_assert!(cut_by_criterion(&judged, &view.splits(pixels)).iter().all(|start| found.contains(start)));
        }
    }

    /// By virtual memory a flight is what it is with all pages in RAM.
    #[test]
    fn mapped_pages_draw_the_same(
        tree in trees(),
        blocking in blockings(),
        cameras in cameras(),
        dependency in dependencies(),
        (pixels, max_triangles) in (0.3..6.0_f32, prop::option::of(10..400_u64)),
        advice in prop::sample::select(MapAdvice::ALL.as_slice()),
        attributes in prop::option::of(any::<u64>()),
    ) {
        let disk = disk_with(&tree, blocking, attributes);
        let model = open(&disk);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pages");
        write_decoded(Arc::new(LocalDisk), &path, &model, &mut |_| ()).unwrap();
        let decoded = DecodedFile::open(&LocalDisk, &path, &model).unwrap();
        decoded.advise(advice).unwrap();
        let options =
            NavigatorOptions { pixels, dependency, max_triangles, attributes: attributes.is_some(), ..options() };
        let mut resident = Navigator::open(model.clone(), options.clone()).unwrap();
        let mut mapped = Navigator::open_mapped(model.clone(), options, decoded).unwrap();
        prop_assert!(mapped.budget_bytes() <= resident.budget_bytes());
        for camera in &self::path(&model, &cameras) {
            let of_place_holders = resident.frame(camera).unwrap();
            let statistics = mapped.frame(camera).unwrap();
            check(&mapped).unwrap();
            prop_assert_eq!(statistics.misses + statistics.pool.reads, 0);
            // But for what is read and how long it takes.
            let PoolCounters { retries, read_failures, .. } = of_place_holders.pool;
            let pool = PoolCounters { retries, read_failures, ..PoolCounters::default() };
            let same = FrameStatistics { pool, frame_ms: 0.0, cpu_ms: 0.0, ..of_place_holders };
            prop_assert_eq!(FrameStatistics { frame_ms: 0.0, cpu_ms: 0.0, ..statistics }, same);
            prop_assert_eq!(starts(&mapped), starts(&resident));
            assert_is_mesh_of_cut(&mapped, &tree);
            assert_are_applied_splits(&mapped, &tree, statistics.pages_in_use);
            prop_assert_eq!(mapped.front_bytes(), resident.front_bytes());
        }
    }

    /// Whatever a page says, as long as its checksum is right: an error, or the mesh of some cut.
    #[test]
    fn altered_pages_do_no_harm(
        tree in trees(),
        blocking in blockings(),
        cameras in cameras(),
        seed in any::<u64>(),
        dependency in dependencies(),
        attributes in prop::option::of(any::<u64>()),
    ) {
        let disk = disk_with(&tree, blocking, attributes);
        alter(&disk, seed);
        let Ok(model) = Model::open(&disk, Path::new("model.vdt")) else { return Ok(()) };
        let model = Arc::new(model);
        let options =
            NavigatorOptions { pixels: 0.5, dependency, attributes: attributes.is_some(), ..options() };
        let Ok(mut navigator) = Navigator::open(model.clone(), options) else { return Ok(()) };
        for camera in path(&model, &cameras) {
            if let Err(error) = navigator.frame(&camera) {
                let message = error.to_string();
                prop_assert!(message.starts_with("model.vdt: meta-node"), "{}", message);
            }
            check_cut(&navigator).unwrap();
        }
    }
}

/// A corner as it is drawn: where; colour, texture coordinate, material; and the given normal, where there are such.
type DrawnCorner = ([u32; 3], [u8; 4], [u32; 2], u32, Option<u32>);

/// Copies of the streams with attributes.
#[derive(Default)]
struct Copies {
    vertices: Vec<[f32; 4]>,
    triangles: Vec<[u32; 3]>,
    wedges: Vec<DrawnWedge>,
    corners: Vec<[u32; 3]>,
}

impl Copies {
    fn update(&mut self, navigator: &mut Navigator, gap: u32) {
        update(&mut self.vertices, navigator.vertex_stream(), navigator.changed_vertices(gap));
        update(&mut self.triangles, navigator.triangle_stream(), navigator.changed_triangles(gap));
        update(&mut self.wedges, navigator.wedge_stream(), navigator.changed_wedges(gap));
        update(&mut self.corners, navigator.corner_stream(), navigator.changed_triangles(gap));
        navigator.forget_changes();
        assert_eq!(self.corners, navigator.corner_stream());
        assert!(navigator.changed_wedges(gap).next().is_none());
    }

    /// The triangles, sorted.
    fn drawn(&self, model: &Model) -> Vec<[DrawnCorner; 3]> {
        let layout = model.appearance().unwrap().layout;
        assert_eq!(self.corners.len(), if layout.has_seams { self.triangles.len() } else { 0 });
        let mut drawn = Vec::new();
        for (place, vertices) in self.triangles.iter().enumerate().filter(|(_, [a, b, _])| a != b) {
            let wedges = if layout.has_seams { self.corners[place] } else { *vertices };
            drawn.push([0, 1, 2].map(|corner: usize| {
                let [x, y, z, normal] = self.vertices[vertices[corner] as usize];
                let wedge = self.wedges[wedges[corner] as usize];
                assert!(layout.kinds.normals || wedge.normal == normal.to_bits());
                let given = layout.kinds.normals.then_some(wedge.normal);
                let texture = wedge.texture.map(f32::to_bits);
                ([x, y, z].map(f32::to_bits), wedge.colour, texture, wedge.material, given)
            }));
        }
        drawn.sort_unstable();
        drawn
    }
}

/// Those of the cut, by way of the pages alone.
fn expected_corners(navigator: &Navigator) -> Vec<[DrawnCorner; 3]> {
    let model = navigator.model();
    let (splits, pages) = navigator.applied_splits().map(|split| (split.born_leaf, split.page)).unzip();
    let mesh = DrawnMesh::of(model, splits, pages).unwrap();
    let appearance = model.appearance().unwrap();
    let corner = |vertex: u32| -> DrawnCorner {
        let (position, wedge) = mesh.vertices[vertex as usize];
        let texture = appearance.appearance.texture_value(wedge.texture).map(f32::to_bits);
        let given = appearance.layout.kinds.normals.then_some(wedge.normal.to_word());
        (position.map(f32::to_bits), wedge.colour, texture, wedge.material, given)
    };
    let mut corners: Vec<_> = mesh.triangles.iter().map(|(vertices, _)| vertices.map(corner)).collect();
    corners.sort_unstable();
    corners
}

/// The model file of a tree, with random attributes where a seed for them is given.
fn disk_with(tree: &Tree, blocking: Blocking, attributes: Option<u64>) -> MemoryDisk {
    match attributes {
        Some(seed) => Attributes::random(tree, seed).disk_of(tree, blocking),
        None => testing::disk_of(tree, blocking),
    }
}

/// Brings a copy of a stream up to date.
fn update<T: Copy + Default>(copy: &mut Vec<T>, stream: &[T], changed: impl Iterator<Item = Range<u32>>) {
    copy.resize(stream.len(), T::default());
    for range in changed {
        let (start, end) = (range.start as usize, (range.end as usize).min(stream.len()));
        if start < end {
            copy[start..end].copy_from_slice(&stream[start..end]);
        }
    }
}

/// Where all pages of a model lie.
fn all_pages(model: &Model) -> Vec<PageLocation> {
    let mut chain = PageChain::new(model);
    let mut stack: Vec<_> = model.root_pages().iter().map(|page| (*page, None)).collect();
    let mut locations = Vec::new();
    while let Some((location, parent)) = stack.pop() {
        locations.push(location);
        stack.extend(chain.page(location, parent).unwrap().children().map(|child| (child, Some(location.number))));
    }
    locations
}

/// Changes one word of one page, and makes the checksum right again.
fn alter(disk: &MemoryDisk, seed: u64) {
    let mut random = Random(seed);
    let model = open(disk);
    let pages = all_pages(&model);
    let page = pages[random.below(pages.len())];
    let mut bytes = disk.bytes("model.vdt").unwrap();
    let (start, end) = (page.offset as usize, page.offset as usize + page.length as usize);
    let body = &mut bytes[start..end - 4];
    let place = random.below(body.len() / 4) * 4;
    let word: [u8; 4] = body[place..place + 4].try_into().unwrap();
    let word = u32::from_le_bytes(word);
    let other = match random.below(4) {
        0 => word ^ 1 << random.below(32),
        1 => word.wrapping_add(1),
        2 => word.wrapping_sub(1),
        _ => random.below(model.header().leaf_count as usize * 2) as u32,
    };
    body[place..place + 4].copy_from_slice(&other.to_le_bytes());
    let checksum = crc32fast::hash(body);
    bytes[end - 4..end].copy_from_slice(&checksum.to_le_bytes());
    disk.insert("model.vdt", bytes);
}

#[test]
fn everything_is_drawn_when_asked_for() {
    for dependency in [Dependency::Implicit, Dependency::Flip, Dependency::None] {
        for tree in [testing::sphere_tree(3, 5), testing::grid_tree(20, 20, 5), testing::triangle_tree()] {
            let options = NavigatorOptions { pixels: 0.0, dependency, ..options() };
            let mut navigator = navigator(&tree, &options);
            let camera = camera(navigator.model(), [1.0, 0.5, 0.5], [0.0; 3]);
            navigator.run_until_settled(&camera, 100).unwrap();
            check(&navigator).unwrap();
            assert_eq!(navigator.active_count(), tree.leaf_count());
            assert_eq!(navigator.triangle_count(), tree.triangles.corners.len());
        }
    }
}

/// Where one part of the surface has nearly all of the wedges, and the camera is there: their slots are what decides.
#[test]
fn a_front_without_slots_comes_to_rest() {
    let tree = testing::grid_tree(70, 70, 5);
    let is_dense = |leaf: u32| tree.positions[leaf as usize][0] < 20.0;
    let attributes = Attributes::with_counts(&tree, 14, |leaf, _| if is_dense(leaf) { 25 } else { 1 });
    let model = attributes.model_of(&tree);
    let place = DVec3::from_array(tree.origin) + DVec3::new(10.0, 35.0, 0.0);
    let near = Camera::looking_at(place + DVec3::Z * 20.0, place, 60.0);
    let options = NavigatorOptions { pixels: 0.0, attributes: true, ..options() };
    let whole = Navigator::open(model.clone(), options.clone()).unwrap().budget_bytes();
    for dependency in [Dependency::Implicit, Dependency::None] {
        let options = NavigatorOptions { memory: whole / 2, dependency, ..options.clone() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        let statistics = navigator.run_until_settled(&near, 2000).unwrap();
        assert!(navigator.settled() && statistics.threshold_factor > 1.0);
        check(&navigator).unwrap();
        let (used, capacity) = (navigator.front().used(), navigator.front().capacity());
        assert!(
            used.wedges > capacity.wedges * 3 / 4 && used.vertices < capacity.vertices * 3 / 4,
            "{used:?} {capacity:?}"
        );
    }
}

#[test]
fn from_far_away_only_the_roots_are_left() {
    for dependency in [Dependency::Implicit, Dependency::Flip, Dependency::None] {
        let tree = Mesh::beside(vec![Mesh::sphere(3), Mesh::grid(20, 20, 1)]).into_tree(2, 10);
        let mut navigator = navigator(&tree, &NavigatorOptions { dependency, ..options() });
        let near = camera(navigator.model(), [0.3, 0.2, 0.3], [0.0; 3]);
        navigator.run_until_settled(&near, 100).unwrap();
        assert!(navigator.triangle_count() > 500);
        let far = Camera { eye: near.eye + DVec3::splat(1e6), ..near };
        let statistics = navigator.run_until_settled(&far, 100).unwrap();
        check(&navigator).unwrap();
        assert_eq!((navigator.active_count(), navigator.triangle_count()), (2, 0));
        assert_eq!(statistics.pages_in_use, 0);
    }
}

#[test]
fn the_empty_model_has_frames() {
    for io in [Io::Sync, Io::Thread] {
        let mut navigator = navigator(&testing::empty_tree(), &NavigatorOptions { io, ..options() });
        let camera = camera(navigator.model(), [1.0, 0.0, 0.0], [0.0; 3]);
        let statistics = navigator.run_until_settled(&camera, 10).unwrap();
        assert!(navigator.settled());
        assert_eq!((statistics.triangles, statistics.vertices), (0, 0));
        check(&navigator).unwrap();
    }
}

#[test]
fn a_flight_is_the_same_each_time() {
    let tree = testing::grid_tree(40, 40, 9);
    let model = testing::model_of(&tree);
    let memory = smallest_memory(&model) + 20_000;
    let fly = || {
        let mut navigator = Navigator::open(model.clone(), NavigatorOptions { memory, ..options() }).unwrap();
        let cameras = "flyby:60".parse::<crate::PathSpec>().unwrap().cameras(&MemoryDisk::new(), &model).unwrap();
        let untimed = |camera| {
            let statistics = navigator.frame(camera).unwrap();
            FrameStatistics { frame_ms: 0.0, cpu_ms: 0.0, ..statistics }
        };
        cameras.iter().map(untimed).collect::<Vec<_>>()
    };
    let first = fly();
    assert_eq!(first, fly());
    assert!(first.iter().any(|frame| frame.pool.second_chances > 0));
    assert!(first.iter().any(|frame| frame.threshold_factor > 1.0));
    assert!(first.iter().any(|frame| frame.pool.prefetch_given_up > 0));
}

#[test]
fn what_cannot_be_is_refused() {
    let model = testing::model_of(&testing::triangle_tree());
    let refuse = |options| Navigator::open(model.clone(), options).unwrap_err().to_string();
    assert!(refuse(NavigatorOptions { pixels: -1.0, ..options() }).contains("-1 pixels"));
    assert!(refuse(NavigatorOptions { pixels: f32::NAN, ..options() }).contains("pixels"));
    let view = ViewParameters { silhouettes: 0.0, ..ViewParameters::default() };
    assert!(refuse(NavigatorOptions { view, ..options() }).contains("silhouettes cannot count 0 times"));
    assert!(refuse(NavigatorOptions { width: 0, ..options() }).contains("0x240"));
    assert!(refuse(NavigatorOptions { memory: 10, ..options() }).contains("run again with --memory"));
    let mut navigator = Navigator::open(model.clone(), options()).unwrap();
    let nowhere = Camera { eye: DVec3::NAN, ..camera(&model, [1.0; 3], [0.0; 3]) };
    assert!(matches!(navigator.frame(&nowhere), Err(NavigatorError::Camera(_))));
    assert!(!navigator.settled());
}

/// A disk that fails: the frame after it says so, nothing hangs, and once it is healed the flight goes on.
#[test]
fn disk_errors_are_told_and_survived() {
    let tree = testing::grid_tree(30, 30, 3);
    for io in [Io::Sync, Io::Thread] {
        for reads in 0..12 {
            let disk = FaultyDisk::new(Arc::new(testing::disk_of(&tree, SMALL_PAGES)));
            let model = open(&disk);
            let options = NavigatorOptions { io, pixels: 0.5, ..options() };
            let near = camera(&model, [0.1, 0.2, 0.3], [0.0; 3]);
            disk.fail_reads_after(reads);
            let mut error = None;
            match Navigator::open(model.clone(), options) {
                Err(failure) => error = Some(failure),
                Ok(mut navigator) => {
                    for _ in 0..100 {
                        match navigator.run_until_settled(&near, 100) {
                            Ok(_) => (),
                            Err(failure) => error = Some(failure),
                        }
                        // The check may have to read, too.
                        if let Err(problem) = check(&navigator) {
                            assert!(problem.contains("injected fault"), "{problem}");
                        }
                    }
                    disk.heal();
                    // What failed in between may still be told once.
                    let settled =
                        (0..100).any(|_| navigator.run_until_settled(&near, 10_000).is_ok() && navigator.settled());
                    assert!(settled);
                    check(&navigator).unwrap();
                    assert_is_mesh_of_cut(&navigator, &tree);
                    assert!(navigator.triangle_count() > 500);
                }
            }
            let message = error.expect("the disk failed").to_string();
            assert!(message.contains("model.vdt") && message.contains("injected fault"), "{message}");
        }
    }
}

/// What fails now and then, or comes altered, is read again, and nobody notices but the counters.
#[test]
fn a_flaky_disk_is_read_again() {
    let tree = testing::grid_tree(30, 30, 3);
    let fly = |fail: f64, alter: f64| {
        let disk = FaultyDisk::new(Arc::new(testing::disk_of(&tree, SMALL_PAGES)));
        let model = open(&disk);
        let memory = smallest_memory(&model) + 45_000;
        let mut navigator = Navigator::open(model.clone(), NavigatorOptions { memory, ..options() }).unwrap();
        disk.fail_share_of_reads(fail, 11);
        disk.alter_share_of_reads(alter, 11);
        let cameras = "flyby:60".parse::<crate::PathSpec>().unwrap().cameras(&MemoryDisk::new(), &model);
        let mut summary = FlightSummary::default();
        let mut cuts = Vec::new();
        for camera in cameras.unwrap() {
            summary.add(&navigator.frame(&camera).unwrap());
            cuts.push(starts(&navigator));
        }
        disk.heal();
        check(&navigator).unwrap();
        assert_eq!(summary.pool.read_failures, 0);
        (cuts, summary.pool.retries)
    };
    let (cuts, retries) = fly(0.0, 0.0);
    assert_eq!(retries, 0);
    for (fail, alter) in [(0.03, 0.0), (0.0, 0.03)] {
        let (flaky, retries) = fly(fail, alter);
        assert!(retries > 0);
        assert!(flaky == cuts);
    }
}

/// Several threads read at once, slowly, and with faults: all that must hold does after every frame, and the picture comes to
/// rest.
#[test]
fn threads_that_race_do_no_harm() {
    let tree = Mesh::beside(vec![Mesh::sphere(4), Mesh::grid(30, 30, 1), Mesh::grid(3, 3, 3)]).into_tree(2, 10);
    for (io_threads, policy) in
        [(2, Policy::SecondChance), (4, Policy::SecondChance), (4, Policy::LeastRecentlyUsed), (3, Policy::None)]
    {
        let disk = FaultyDisk::new(Arc::new(testing::disk_of(&tree, SMALL_PAGES)));
        let model = open(&disk);
        // The least with so many threads.
        let smallest = smallest_memory(&model);
        let has_threads =
            |memory: &u64| plan_with(&model, *memory, io_threads, Streams::default()).unwrap().io_threads == io_threads;
        let memory = (0..).map(|step| smallest + step * 20_000).find(has_threads).unwrap();
        let options = NavigatorOptions { memory, policy, io: Io::Thread, io_threads: Some(io_threads), ..options() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        assert_eq!(navigator.io_threads(), io_threads);
        disk.fail_share_of_reads(0.01, 3);
        disk.delay_share_of_reads(0.05, Duration::from_millis(2), 3);
        let cameras = "flyby:150".parse::<crate::PathSpec>().unwrap().cameras(&MemoryDisk::new(), &model).unwrap();
        let mut summary = FlightSummary::default();
        for camera in &cameras {
            summary.add(&navigator.frame(camera).unwrap());
            check_cut(&navigator).unwrap();
            std::thread::sleep(Duration::from_millis(1));
        }
        navigator.run_until_settled(&cameras[75], 10_000).unwrap();
        assert!(navigator.settled());
        disk.heal();
        check(&navigator).unwrap();
        assert_is_mesh_of_cut(&navigator, &tree);
        assert!(summary.pool.prefetched > 0 && summary.pool.read_failures == 0, "{summary:?}");
    }
}

/// A camera in the middle of the surface, and a far one, in turns, in next to no memory.
/// The page of a tree that begins further down can only come after those above it, of which no split may be applied.
#[test]
fn trees_that_begin_further_down_are_reached() {
    let tree = many_parts(300, 4).into_tree(4, 1);
    let disk = testing::disk_of(&tree, Blocking::Forest { slot_bytes: 4096, fan_out: 2 });
    let model = open(&disk);
    let levels = |page: u32| model.way_to(page).len();
    let deepest = model.roots().iter().max_by_key(|root| levels(root.page.number)).unwrap();
    assert!(levels(deepest.page.number) >= 3, "{}", levels(deepest.page.number));
    // A camera that sees nothing but that tree.
    let leaf = Vec3::from_array(deepest.position).as_dvec3() + DVec3::from_array(tree.origin);
    let close = Camera::looking_at(leaf + DVec3::new(0.3, 0.2, 0.5), leaf + DVec3::new(0.3, 0.2, 0.0), 60.0);
    let far = camera(&model, [3.0, 2.0, 1.0], [0.0; 3]);
    let (second_chance, none) = (Policy::SecondChance, Policy::None);
    let modes = |io: Io| [(io, true, second_chance), (io, false, second_chance), (io, true, none)];
    for (io, prefetch, policy) in [Io::Sync, Io::Thread].into_iter().flat_map(modes) {
        let memory = smallest_memory(&model);
        let options = NavigatorOptions { memory, io, prefetch, policy, pixels: 0.5, ..options() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        for camera in [close, far, close] {
            navigator.run_until_settled(&camera, 2000).unwrap();
            assert!(navigator.settled());
            check(&navigator).unwrap();
            assert_is_mesh_of_cut(&navigator, &tree);
            if camera == close {
                let is_in_tree = |node: &crate::ActiveNode| (deepest.start..deepest.end).contains(&node.leaf);
                let active = navigator.active_nodes().filter(is_in_tree).count();
                assert_eq!(active as u32, deepest.end - deepest.start);
            }
        }
    }
}

#[test]
fn the_smallest_memory_works() {
    let tree = Mesh::beside(vec![Mesh::sphere(4), Mesh::grid(30, 30, 1), Mesh::sphere(3)]).into_tree(2, 10);
    let model = testing::model_of(&tree);
    let memory = smallest_memory(&model);
    for io in [Io::Sync, Io::Thread] {
        let mut navigator = Navigator::open(model.clone(), NavigatorOptions { memory, io, ..options() }).unwrap();
        for round in 0..4 {
            let position = Vec3::from_array(tree.positions[round * 37]).as_dvec3() + DVec3::from_array(tree.origin);
            let inside = Camera::looking_at(position, position + DVec3::new(1.0, 1.0, 0.1), 70.0);
            for camera in [inside, camera(&model, [2.0, 1.0, 1.0], [0.0; 3])] {
                navigator.run_until_settled(&camera, 1000).unwrap();
                assert!(navigator.settled());
                check(&navigator).unwrap();
                assert_is_mesh_of_cut(&navigator, &tree);
            }
        }
    }
}

/// What is asked for may change between frames: then the picture is that of a navigator which was opened so.
#[test]
fn other_pixels_sizes_and_limits_act_at_once() {
    let tree = testing::sphere_tree(4, 1);
    // Without dependencies, a cut that is reached by splits alone is that of the criterion.
    let usual = NavigatorOptions { pixels: 60.0, width: 400, height: 300, dependency: Dependency::None, ..options() };
    let mut changed = navigator(&tree, &usual);
    let camera = camera(changed.model(), [1.0, 0.7, 0.6], [0.0; 3]);
    let settled = |navigator: &mut Navigator| {
        let frame = navigator.run_until_settled(&camera, 5000).unwrap();
        assert!(navigator.settled());
        assert_is_mesh_of_cut(navigator, &tree);
        frame.triangles
    };
    let first = settled(&mut changed);

    changed.set_pixels(20.0).unwrap();
    assert!(!changed.settled());
    let finer = settled(&mut changed);
    assert_eq!(finer, settled(&mut navigator(&tree, &NavigatorOptions { pixels: 20.0, ..usual.clone() })));
    assert!(finer > first, "{finer} of {first}");

    changed.set_size(800, 600).unwrap();
    let larger = settled(&mut changed);
    let options = NavigatorOptions { pixels: 20.0, width: 800, height: 600, ..usual.clone() };
    assert_eq!(larger, settled(&mut navigator(&tree, &options)));
    assert!(larger > finer, "{larger} of {finer}");

    // As many as there are now and fewer, though nothing more is wanted; and then again all that is wanted.
    changed.set_max_triangles(Some(larger / 2));
    let limited = settled(&mut changed);
    assert!(limited <= larger / 2 && limited > larger / 8, "{limited} of {larger}");
    changed.set_max_triangles(None);
    assert_eq!(settled(&mut changed), larger);

    for pixels in [-1.0, f32::NAN, f32::INFINITY] {
        assert!(matches!(changed.set_pixels(pixels), Err(NavigatorError::Options { .. })));
    }
    assert!(matches!(changed.set_size(0, 600), Err(NavigatorError::Options { .. })));
    assert_eq!(settled(&mut changed), larger);
}
