//! Whatever the memory and the tree: the collapses of the queue in memory, one by one; and the sub-meshes by brute force.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use proptest::prelude::*;
use storage::{Disk, FaultyDisk, LocalDisk, MemoryDisk};

use super::*;
use crate::ingest::{CoreMesh, FileCounts};
use crate::simplify::metric::{LengthMetric, QuadricMetric};
use crate::simplify::plan::Plan;
use crate::simplify::tests::{Outcome, any_bound, any_shape, blocked, either_metric, made, outcome, soup};
use crate::simplify::{SimplifyError, run_spanned};
use crate::tree::{Metric, Strategy as Order};

/// Triangles between the points of a small lattice: every kind of edge and vertex there is.
fn lattice_soup(points: u32, triangles: &[[u32; 3]], size: u32) -> Option<CoreMesh> {
    let positions = (0..points).map(|point| {
        let scattered = point.wrapping_mul(0x9e37_79b9) >> 8;
        [scattered % size, scattered / size % size, scattered / size / size % size].map(f64::from)
    });
    let triangles = triangles.iter().map(|corners| corners.map(|corner| corner % points)).collect();
    let mesh = crate::ingest::canonical(positions.collect(), triangles, Default::default()).unwrap();
    (!mesh.triangles.is_empty()).then_some(mesh)
}

pub(in crate::simplify) fn any_soup() -> impl Strategy<Value = CoreMesh> {
    (4..90_u32, prop::collection::vec(any::<[u32; 3]>(), 1..160), 2..6_u32)
        .prop_filter_map("no triangle", |(points, triangles, size)| lattice_soup(points, &triangles, size))
}

pub(in crate::simplify) fn in_core(mesh: &CoreMesh, metric: Metric, bound: ErrorBound) -> Outcome {
    let stored = StoredMesh::from_core(mesh.clone(), FileCounts::default());
    let plan = Plan::new(1 << 40, 1, Carried::of(&stored, bound));
    outcome(&stored, metric, Order::Btree, plan)
}

/// A tree and pages that hardly hold anything.
pub(in crate::simplify) fn tight(sub_meshes: u64, core: u64) -> Shares {
    Shares { memory: ByteSize(4 * sub_meshes), tree: 0, pages: 0, sub_meshes, core }
}

fn simplify(
    mesh: &StoredMesh,
    (metric, bound): (Metric, ErrorBound),
    kind: EdgeTreeKind,
    shares: Shares,
    disk: impl Disk + 'static,
    folder: &Path,
) -> Result<(Simplified, SpannedCounters), SimplifyError> {
    let (scratch, _) = Scratch::open(Arc::new(disk), folder, "").unwrap();
    match metric {
        Metric::Quadric => {
            run_spanned(Task { mesh, metric: QuadricMetric, bound, kind, shares, scratch: &scratch }, &mut |_| ())
        }
        Metric::Length => {
            run_spanned(Task { mesh, metric: LengthMetric, bound, kind, shares, scratch: &scratch }, &mut |_| ())
        }
    }
}

/// With redb, on a disk in RAM.
pub(in crate::simplify) fn with_redb(
    mesh: &StoredMesh,
    (metric, bound): (Metric, ErrorBound),
    shares: Shares,
) -> (Outcome, SpannedCounters) {
    let (simplified, counters) =
        simplify(mesh, (metric, bound), EdgeTreeKind::Redb, shares, MemoryDisk::new(), Path::new("scratch")).unwrap();
    (Outcome::of(simplified), counters)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn the_outcome_is_that_of_the_queue_in_memory(
        shape in any_shape(), triangles in 500_u64..6_000, seed in any::<u64>(), metric in either_metric(),
        bound in any_bound(), block_vertices in 100_u32..3_000, sub_meshes in 30_000_u64..400_000, core in 25_000_u64..400_000,
    ) {
        let mesh = made(shape, triangles, seed);
        let (found, counters) = with_redb(&blocked(&mesh, block_vertices), (metric, bound), tight(sub_meshes, core));
        in_core(&mesh, metric, bound).assert_same(&found);
        prop_assert!(counters.loads > 1 || counters.core_triangles > 0);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn so_it_is_where_nothing_is_regular(
        mesh in any_soup(), metric in either_metric(), bound in any_bound(), block_vertices in 3_u32..90,
        sub_meshes in 40_000_u64..90_000, core in prop_oneof![Just(35_000), 35_000_u64..70_000],
    ) {
        let (found, _) = with_redb(&blocked(&mesh, block_vertices), (metric, bound), tight(sub_meshes, core));
        in_core(&mesh, metric, bound).assert_same(&found);
    }
}

/// The paper's extreme case: no more than one edge with its stars in memory.
#[test]
fn one_edge_at_a_time_comes_to_the_same() {
    for metric in Metric::ALL {
        let mesh = made(crate::generate::Shape::Gyroid, 800, 5);
        let stored = blocked(&mesh, 150);
        // Hardly more than the edge takes that takes most.
        let mut sub_meshes = 2000;
        let (simplified, counters) = loop {
            let shares = tight(sub_meshes, 20_000);
            match simplify(
                &stored,
                (metric, ErrorBound::Default),
                EdgeTreeKind::Redb,
                shares,
                MemoryDisk::new(),
                Path::new("scratch"),
            ) {
                Err(SimplifyError::Spanned(SpannedError::Star { .. })) => sub_meshes += 500,
                other => break other.unwrap(),
            }
        };
        in_core(&mesh, metric, ErrorBound::Default).assert_same(&Outcome::of(simplified));
        assert!(counters.spanning_edges < counters.loads * 5, "{counters:?}");
        assert!(counters.loads > 100, "{counters:?}");
    }
}

#[test]
fn a_star_that_does_not_fit_is_an_error_that_says_what_would_do() {
    // A wheel: its hub has all triangles.
    let spokes = 3000_u32;
    let rim = (0..spokes).map(|spoke| {
        let angle = f64::from(spoke) / f64::from(spokes) * std::f64::consts::TAU;
        [angle.cos(), angle.sin(), 0.01 * f64::from(spoke % 7)]
    });
    // The shortest edge is one at the hub.
    let positions = std::iter::once([1.0 - 1e-5, 0.0, 0.0]).chain(rim).collect();
    let triangles = (0..spokes).map(|spoke| [0, 1 + spoke, 1 + (spoke + 1) % spokes]).collect();
    let mesh = crate::ingest::canonical(positions, triangles, Default::default()).unwrap();
    let stored = blocked(&mesh, 500);
    let shares = tight(20_000, 20_000);
    let outcome = simplify(
        &stored,
        (Metric::Length, ErrorBound::Default),
        EdgeTreeKind::Redb,
        shares,
        MemoryDisk::new(),
        Path::new("scratch"),
    );
    let Err(error) = outcome else { panic!("no error") };
    let message = error.to_string();
    let SimplifyError::Spanned(SpannedError::Star { triangles, needed, .. }) = error else { panic!("{message}") };
    assert_eq!(triangles, 3000);
    assert!(message.contains("3000 triangles") && message.contains(&needed.as_argument()), "{message}");
    // What it advises is enough.
    let (found, _) = with_redb(&stored, (Metric::Length, ErrorBound::Default), tight(needed.0 / 4, 40_000));
    in_core(&mesh, Metric::Length, ErrorBound::Default).assert_same(&found);
}

/// What no legal collapse can reduce may be more than fits in memory: then the end phase takes some components at a time.
#[test]
fn the_end_phase_comes_to_the_same_some_components_at_a_time() {
    for metric in Metric::ALL {
        for (mesh, core) in [(soup(800), 4_000), (made(crate::generate::Shape::City, 6_000, 3), 30_000)] {
            let (found, counters) = with_redb(&blocked(&mesh, 300), (metric, ErrorBound::None), tight(100_000, core));
            in_core(&mesh, metric, ErrorBound::None).assert_same(&found);
            assert!(Plan::memory_for_core(counters.core_triangles, ErrorBound::None).0 > core, "{counters:?}");
        }
    }
    let stored = blocked(&made(crate::generate::Shape::City, 6_000, 3), 300);
    let shares = tight(100_000, 100);
    let outcome = simplify(
        &stored,
        (Metric::Length, ErrorBound::Default),
        EdgeTreeKind::Redb,
        shares,
        MemoryDisk::new(),
        Path::new("scratch"),
    );
    assert!(matches!(outcome, Err(SimplifyError::Spanned(SpannedError::Component { .. }))));
}

#[test]
fn with_sled_it_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("scratch");
    for (metric, seed) in [(Metric::Quadric, 1), (Metric::Length, 2)] {
        let mesh = made(crate::generate::Shape::Terrain, 4_000, seed);
        let shares = Shares { tree: 1 << 40, ..tight(150_000, 50_000) };
        let (simplified, counters) = simplify(
            &blocked(&mesh, 700),
            (metric, ErrorBound::Default),
            EdgeTreeKind::Sled,
            shares,
            LocalDisk,
            &place,
        )
        .unwrap();
        in_core(&mesh, metric, ErrorBound::Default).assert_same(&Outcome::of(simplified));
        assert!(counters.loads > 5, "{counters:?}");
        assert!(!place.exists());
        let refused = simplify(
            &blocked(&mesh, 700),
            (metric, ErrorBound::Default),
            EdgeTreeKind::Sled,
            tight(150_000, 0),
            LocalDisk,
            &place,
        );
        let message = refused.unwrap_err().to_string();
        let advice = memory_for_sled(mesh.positions.len() as u64, mesh.triangles.len() as u64, ErrorBound::Default)
            .as_argument();
        assert!(message.contains("--edge-tree redb") && message.contains(&advice), "{message}");
        assert!(!place.exists());
    }
}

proptest! {
    #[test]
    fn with_what_is_advised_for_sled_it_does_and_with_less_it_does_not(
        triangles in prop_oneof![1_u64..5_000_000, 1_u64..1 << 32], missing in 1_u64..100_000_000,
    ) {
        let (bound, vertices) = (ErrorBound::Default, triangles / 2 + 2);
        let mesh = vertices * 12 + triangles * 12;
        let does = |memory: u64| {
            let memory = memory.saturating_sub(mesh);
            let needed = storage::edge_tree::sled_needs(triangles * 3 / 2).0;
            let is_in_core = triangles <= Plan::new(memory, 1, bound).queue_triangles;
            (is_in_core, needed <= Shares::new(ByteSize(memory), EdgeTreeKind::Sled).tree)
        };
        let ByteSize(advice) = memory_for_sled(vertices, triangles, bound);
        let (is_in_core, is_in_tree) = does(advice);
        prop_assert!(is_in_core || is_in_tree);
        prop_assert_eq!(does(advice.saturating_sub(1 << 20).saturating_sub(missing)), (false, false));
        // Large meshes go into the tree before they fit in memory.
        prop_assert!(!is_in_core || triangles < 4_000_000);
    }

    #[test]
    fn shares_are_parts_of_the_memory(memory in any::<u64>()) {
        for kind in EdgeTreeKind::ALL {
            let Shares { tree, pages, sub_meshes, core, .. } = Shares::new(ByteSize(memory), kind);
            // The journal has what `run_spanned` gives it.
            let journal = memory / 16 + memory / 32;
            prop_assert!(tree + pages + sub_meshes <= memory - journal);
            prop_assert!(core <= memory - journal - pages);
        }
    }
}

#[test]
fn advice_for_sled_ends_whatever_a_file_claims() {
    for bound in ErrorBound::ALL {
        assert_eq!(memory_for_sled(0, 0, bound), ByteSize(MEBIBYTE));
        memory_for_sled(u64::MAX, u64::MAX, bound);
    }
}

#[test]
fn a_full_disk_or_one_that_cannot_be_read_is_an_error_and_nothing_is_left() {
    let stored = blocked(&made(crate::generate::Shape::Terrain, 3_000, 4), 500);
    let memory = MemoryDisk::new();
    let (place, shares) = (Path::new("scratch"), tight(150_000, 50_000));
    let with =
        |disk| simplify(&stored, (Metric::Quadric, ErrorBound::Default), EdgeTreeKind::Redb, shares, disk, place);
    for full in [0, 5_000, 300_000, 1_500_000] {
        let disk = FaultyDisk::new(Arc::new(memory.clone()));
        disk.full_after(full);
        let message = with(disk).unwrap_err().to_string();
        assert!(message.contains("scratch"), "{message}");
        assert_eq!(memory.paths(), [] as [std::path::PathBuf; 0]);
    }
    for reads in [0, 10, 1000, 5000] {
        let disk = FaultyDisk::new(Arc::new(memory.clone()));
        disk.fail_reads_after(reads);
        let message = with(disk).unwrap_err().to_string();
        assert!(message.contains("injected"), "{message}");
        assert_eq!(memory.paths(), [] as [std::path::PathBuf; 0]);
    }
    with(FaultyDisk::new(Arc::new(memory.clone()))).unwrap();
    assert_eq!(memory.paths(), [] as [std::path::PathBuf; 0]);
}

/// The triangles that are left on disk, and at each vertex the rejected edges, read from front to back.
fn on_disk(store: &mut MeshStore<'_>) -> (BTreeMap<u32, [u32; 3]>, BTreeMap<u32, BTreeSet<u32>>) {
    let (mut triangles, mut rejected) = (BTreeMap::new(), BTreeMap::<u32, BTreeSet<u32>>::new());
    for id in 0..store.triangle_count {
        let triangle = store.triangle(id).unwrap();
        if triangle.is_gone() {
            continue;
        }
        triangles.insert(id, triangle.corners);
        for side in (0..3).filter(|side| triangle.flags >> side & 1 != 0) {
            let [a, b] = [triangle.corners[side], triangle.corners[(side + 1) % 3]];
            rejected.entry(a).or_default().insert(b);
            rejected.entry(b).or_default().insert(a);
        }
    }
    (triangles, rejected)
}

/// The chains, counts and marks of the store agree with each other.
fn check_store(store: &mut MeshStore<'_>) {
    let (triangles, rejected) = on_disk(store);
    assert_eq!(store.live_triangles, triangles.len() as u64);
    let mut live = 0;
    for id in 0..store.vertex_count {
        let vertex = store.vertex(id).unwrap();
        let expected: BTreeSet<u32> =
            triangles.iter().filter(|(_, corners)| corners.contains(&id)).map(|(triangle, _)| *triangle).collect();
        assert_eq!(vertex.is_gone(), expected.is_empty());
        let mut found = BTreeSet::new();
        let mut link = vertex.star;
        while let Some(triangle) = link.triangle() {
            let stored = store.triangle(triangle).unwrap();
            link = stored.next_at(id);
            if !stored.is_gone() {
                assert!(found.insert(triangle));
            }
        }
        assert_eq!(found, expected);
        if !vertex.is_gone() {
            live += 1;
            assert_eq!(vertex.rejected as usize, rejected.get(&id).map_or(0, BTreeSet::len));
        }
    }
    assert_eq!(store.live_vertices, live);
    // An edge is marked on all triangles that share it.
    for id in triangles.keys() {
        let triangle = store.triangle(*id).unwrap();
        for side in 0..3 {
            let [a, b] = [triangle.corners[side], triangle.corners[(side + 1) % 3]];
            let is_rejected = rejected.get(&a).is_some_and(|others| others.contains(&b));
            assert_eq!(triangle.flags >> side & 1 != 0, is_rejected);
        }
    }
}

/// What a set of edges spans, by the definition (the paper, 3.1.1) and by walking.
fn spanned_by_definition(edges: &[(u32, u32)], triangles: &[[u32; 3]]) -> Spanned {
    let mut left: BTreeSet<(u32, u32)> = edges.iter().copied().collect();
    let mut sizes = Vec::new();
    while let Some(first) = left.pop_first() {
        let mut component = BTreeSet::from([first]);
        let mut ends = BTreeSet::from([first.0, first.1]);
        while let Some(next) = left.iter().copied().find(|(a, b)| ends.contains(a) || ends.contains(b)) {
            left.remove(&next);
            component.insert(next);
            ends.extend([next.0, next.1]);
        }
        let is_spanned = |corners: &&[u32; 3]| {
            let has_edge = component.iter().any(|(a, b)| corners.contains(a) && corners.contains(b));
            has_edge || corners.iter().all(|corner| ends.contains(corner))
        };
        sizes.push(triangles.iter().filter(is_spanned).count() as u64);
    }
    Spanned {
        sub_meshes: sizes.len() as u64,
        triangles: sizes.iter().sum(),
        largest: sizes.iter().copied().max().unwrap_or(0),
    }
}

fn check_loads<M: CollapseMetric>(task: &Task<'_, M>) {
    let journal = Journal::new(task.scratch, task.mesh.triangles.len(), 1 << 20);
    let (mut loads, _) = Loads::begin(task).unwrap();
    check_store(&mut loads.store);
    while !loads.tree.is_empty() {
        let Some(limit) = loads.load(&task.shares).unwrap() else { continue };
        // A triangle more than the limit at most.
        let enough = loads.most + SubMeshes::<M>::bytes_of(loaded::Extent { vertices: 3, triangles: 1, wedges: 0 }, 1);
        assert!(loads.loaded.bytes() <= enough);
        // Every edge that is left in the tree is above the limit, those that touch what is loaded, too.
        let mut smallest = None;
        loads
            .tree
            .delete_smallest(&mut |edge| {
                smallest = Some(edge);
                false
            })
            .unwrap();
        assert!(smallest.is_none_or(|edge| edge > limit));
        assert!(loads.heap.iter().all(|Reverse(edge)| *edge <= limit));
        // Everything that a decision reads is there.
        let (triangles, rejected) = on_disk(&mut loads.store);
        let mesh = &loads.loaded.engine.mesh;
        let mut spanning = Vec::new();
        for Reverse(edge) in &loads.heap {
            assert_eq!(loads.loaded.standing(&mut loads.store, *edge).unwrap(), Standing::Due);
            let Some(places) = loads.loaded.places(*edge) else { continue };
            let star = |id: u32| triangles.iter().filter(move |(_, corners)| corners.contains(&id));
            let ids = places.map(|place| mesh.vertices[place as usize].id);
            let found = |place: u32| -> BTreeSet<u32> {
                mesh.star(place).iter().map(|triangle| mesh.triangle_ids[*triangle as usize]).collect()
            };
            let is_whole = |id: u32, place: u32| found(place) == star(id).map(|(triangle, _)| *triangle).collect();
            if !ids.iter().zip(places).all(|(id, place)| is_whole(*id, place)) {
                // Only where memory was full.
                assert!(loads.loaded.bytes() > loads.most / 2);
                continue;
            }
            spanning.push((places[0].min(places[1]), places[0].max(places[1])));
            for neighbour in ids.iter().flat_map(|id| star(*id)).flat_map(|(_, corners)| *corners) {
                let place = mesh.vertices.iter().position(|vertex| vertex.id == neighbour).unwrap();
                assert!(!rejected.contains_key(&neighbour) || is_whole(neighbour, place as u32));
            }
        }
        let corners: Vec<[u32; 3]> = loads.loaded.triangles().collect();
        let found = loads.spanning.measure(corners.iter().copied());
        assert_eq!(found, spanned_by_definition(&spanning, &corners));
        loads.collapse(limit).unwrap();
        // Stars that grow move to where there is room.
        assert!(loads.loaded.bytes() <= enough + enough / 8);
        loads.put_back(limit, &journal).unwrap();
        check_store(&mut loads.store);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn loads_hold_what_they_should_and_leave_the_store_in_order(
        mesh in any_soup(), metric in either_metric(), block_vertices in 3_u32..90, sub_meshes in 40_000_u64..90_000,
    ) {
        let stored = blocked(&mesh, block_vertices);
        let (scratch, _) = Scratch::open(Arc::new(MemoryDisk::new()), Path::new("scratch"), "").unwrap();
        let (mesh, kind, shares, scratch) = (&stored, EdgeTreeKind::Redb, tight(sub_meshes, 0), &scratch);
        let bound = ErrorBound::Default;
        match metric {
            Metric::Quadric => check_loads(&Task { mesh, metric: QuadricMetric, bound, kind, shares, scratch }),
            Metric::Length => check_loads(&Task { mesh, metric: LengthMetric, bound, kind, shares, scratch }),
        }
    }
}

/// The same on a regular surface, where sub-meshes grow and merge.
#[test]
fn so_do_loads_of_a_surface() {
    let stored = blocked(&made(crate::generate::Shape::Terrain, 700, 2), 120);
    let (scratch, _) = Scratch::open(Arc::new(MemoryDisk::new()), Path::new("scratch"), "").unwrap();
    let shares = tight(60_000, 0);
    let kind = EdgeTreeKind::Redb;
    let bound = ErrorBound::Default;
    check_loads(&Task { mesh: &stored, metric: QuadricMetric, bound, kind, shares, scratch: &scratch });
}
