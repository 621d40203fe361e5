//! Trees of random meshes: well formed, legal in both orders, the same for any order of the input, scale-free.

// A test says what it expects by unwrapping.
#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;
use vdt::ingest::{CleaningCounts, CoreMesh, canonical};
use vdt::tree::{LARGEST_NORMAL_ERROR, Metric, Normal, Strategy as Order, Tree, check, switch_of};
use vdt_tests::cut;
use vdt_tests::history::{self, History, history};
use vdt_tests::random_mesh::{RawMesh, any_mesh, closed_box, sheet, sphere, torus};
use vdt_tests::replay::PlainMesh;

fn core(mesh: &RawMesh) -> CoreMesh {
    canonical(mesh.positions.clone(), mesh.triangles.clone(), CleaningCounts::default()).unwrap()
}

fn tree(mesh: &RawMesh, metric: Metric, order: Order) -> Tree {
    history::tree(&core(mesh), metric, order)
}

fn either_metric() -> impl Strategy<Value = Metric> {
    prop_oneof![Just(Metric::Quadric), Just(Metric::Length)]
}

fn either_order() -> impl Strategy<Value = Order> {
    prop_oneof![Just(Order::Passes), Just(Order::Btree)]
}

/// The triangles, as they were, that a collapse moved or removed.
type Rewritten = Vec<(usize, [u32; 3])>;

/// Replays collapses in the given order on a plain list of triangles: what each of them rewrote. Every triangle must
/// vanish exactly at the collapse that the history says, and with `legal` those of the history that are said to be legal
/// must break no rule.
fn replay(mesh: &CoreMesh, history: &History, order: &[usize], legal: bool) -> Vec<Rewritten> {
    let mut plain = PlainMesh::new(&mesh.positions, &mesh.triangles);
    let mut death: BTreeMap<usize, u32> = BTreeMap::new();
    let mut rewritten = vec![Vec::new(); order.len()];
    for index in order {
        let collapse = history.collapses[*index];
        if legal && *index < history.legal {
            assert_eq!(plain.objection(collapse.born, collapse.kept), None, "collapse {index} {collapse:?}");
        }
        let live = plain.triangles.iter().enumerate().filter_map(|(index, slot)| slot.map(|corners| (index, corners)));
        rewritten[*index] = live.filter(|(_, corners)| corners.contains(&collapse.born)).collect();
        for triangle in plain.collapse(collapse.born, collapse.kept) {
            death.insert(triangle, *index as u32);
        }
    }
    assert_eq!(death.values().copied().collect::<Vec<_>>(), history.death);
    rewritten
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn a_tree_is_well_formed_with_one_root_per_component(
        mesh in any_mesh(), metric in either_metric(), order in either_order()
    ) {
        let core = core(&mesh);
        let components = PlainMesh::new(&core.positions, &core.triangles).component_count();
        let tree = tree(&mesh, metric, order);
        check(&tree).unwrap();
        prop_assert_eq!(tree.roots.len(), components);
        prop_assert_eq!(tree.triangles.corners.len(), core.triangles.len());
        for root in &tree.roots {
            // What is said of parts that vanish rests on it.
            let most = f64::from(tree.splits[root.split as usize].switch) * (1.0 + 2.0_f64.powi(-22));
            let leaves = tree.positions[root.start as usize..root.end as usize].iter().map(|leaf| leaf.map(f64::from));
            let leaves: Vec<[f64; 3]> = leaves.collect();
            for (number, one) in leaves.iter().enumerate() {
                for other in &leaves[..number] {
                    let square: f64 = (0..3).map(|axis| (one[axis] - other[axis]).powi(2)).sum();
                    prop_assert!(square.sqrt() <= most, "{one:?} and {other:?} in a tree that vanishes at {most}");
                }
            }
        }
    }

    /// In the order of the ids, those with the same in the reverse of the order in which they were decided, every collapse
    /// finds the very triangles that it found when it was decided, corner for corner. So every triangle of a uniform cut is one that the construction
    /// went through, and the implicit dependency is sound.
    #[test]
    fn id_order_goes_through_the_same_triangles(
        mesh in any_mesh(), metric in either_metric(), order in either_order()
    ) {
        let core = core(&mesh);
        let history = history(&core, metric, order);
        let mut sequence: Vec<usize> = (0..history.collapses.len()).collect();
        let as_built = replay(&core, &history, &sequence, true);
        sequence.reverse();
        sequence.sort_by_key(|index| history.collapses[*index].id);
        prop_assert_eq!(as_built, replay(&core, &history, &sequence, false));
    }

    #[test]
    fn the_order_of_the_input_does_not_matter(mesh in any_mesh(), seed in any::<u64>(), order in either_order()) {
        prop_assert_eq!(
            tree(&mesh, Metric::Quadric, order),
            tree(&mesh.shuffled(seed), Metric::Quadric, order)
        );
    }

    #[test]
    fn a_scale_of_a_power_of_two_changes_nothing_else(mesh in any_mesh(), exponent in -40..40_i32) {
        let factor = 2.0_f64.powi(exponent);
        let mut scaled = mesh.clone();
        scaled.positions.iter_mut().flatten().for_each(|value| *value *= factor);
        let (tree, scaled) = (tree(&mesh, Metric::Quadric, Order::Passes), tree(&scaled, Metric::Quadric, Order::Passes));
        prop_assert_eq!(&tree.roots, &scaled.roots);
        prop_assert_eq!(&tree.triangles, &scaled.triangles);
        for (split, other) in tree.splits.iter().zip(&scaled.splits) {
            prop_assert_eq!((split.id, split.kept, split.born, split.cone), (other.id, other.kept, other.born, other.cone));
            prop_assert_eq!((f64::from(split.switch) * factor) as f32, other.switch);
        }
    }

    /// The normals of the leaves are those of the triangles at them in the input, by their areas.
    #[test]
    fn leaves_have_the_normals_of_the_input(mesh in any_mesh(), order in either_order()) {
        let core = core(&mesh);
        let mut sums: BTreeMap<[u32; 3], [f64; 3]> = BTreeMap::new();
        let place = |position: [f32; 3]| position.map(f32::to_bits);
        let cross = |u: [f64; 3], v: [f64; 3]| {
            [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
        };
        let dot = |u: [f64; 3], v: [f64; 3]| u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
        for corners in &core.triangles {
            let at = corners.map(|corner| core.positions[corner as usize]);
            let [a, b, c] = at.map(|position| position.map(f64::from));
            let [ab, ac] = [b, c].map(|end| [0, 1, 2].map(|axis| end[axis] - a[axis]));
            let normal = cross(ab, ac);
            for at in at {
                let sum = sums.entry(place(at)).or_default();
                (0..3).for_each(|axis| sum[axis] += normal[axis]);
            }
        }
        let tree = tree(&mesh, Metric::Quadric, order);
        let mut normals: Vec<Normal> = tree.splits.iter().map(|split| split.normal).collect();
        tree.roots.iter().for_each(|root| normals[root.start as usize] = root.normal);
        for (position, normal) in tree.positions.iter().zip(normals) {
            let (sum, found) = (sums[&place(*position)], normal.decode().map(f64::from));
            // Where triangles face each other, it is rounding that says which way.
            if dot(sum, sum).sqrt() > 1e-4 {
                let across = cross(sum, found);
                let angle = dot(across, across).sqrt().atan2(dot(sum, found));
                prop_assert!(angle < LARGEST_NORMAL_ERROR + 1e-6, "{sum:?} {found:?}");
            }
        }
    }

    /// Fully refined is the input, fully coarse is one root per component and no triangle, and every triangle of any
    /// uniform cut has three distinct corners.
    #[test]
    fn uniform_cuts_lead_from_the_input_to_the_roots(mesh in any_mesh(), order in either_order()) {
        let core = core(&mesh);
        let tree = tree(&mesh, Metric::Quadric, order);
        let finest = cut::cut(&tree, |node| tree.splits[node.split as usize].switch > 0.0);
        let place = |corner: u32| tree.positions[corner as usize].map(f32::to_bits);
        let mut drawn: Vec<_> = cut::triangles(&tree, &finest).iter().map(|t| cut::smallest_first(t.map(place))).collect();
        let input = |corner: u32| core.positions[corner as usize].map(f32::to_bits);
        let mut expected: Vec<_> = core.triangles.iter().map(|t| cut::smallest_first(t.map(input))).collect();
        drawn.sort();
        expected.sort();
        prop_assert_eq!(drawn, expected);
        let coarsest = cut::cut(&tree, |_| false);
        prop_assert_eq!(coarsest.len(), tree.roots.len());
        prop_assert!(cut::triangles(&tree, &coarsest).is_empty());
    }
}

#[test]
fn a_closed_manifold_stays_one_down_to_the_tetrahedron() {
    for metric in [Metric::Quadric, Metric::Length] {
        let core = core(&sphere(3, 0.1, 7));
        let history = history(&core, metric, Order::Passes);
        assert_eq!(history.legal, core.positions.len() - 4);
        let mut plain = PlainMesh::new(&core.positions, &core.triangles);
        for collapse in &history.collapses[..history.legal] {
            plain.collapse(collapse.born, collapse.kept);
            assert!(plain.doubled_edges().is_empty());
        }
        assert_eq!(plain.triangles.iter().flatten().count(), 4);
    }
}

#[test]
fn both_orders_reach_the_same_quality() {
    let core = core(&sphere(4, 0.02, 3));
    let mean = |order| {
        let history = history(&core, Metric::Quadric, order);
        // The middle of the simplification: the end is a matter of a few vertices.
        let most = &history.collapses[..core.positions.len() * 9 / 10];
        let switches: Vec<f32> = most.iter().map(|collapse| switch_of(collapse.id, core.exponent)).collect();
        switches.iter().sum::<f32>() / switches.len() as f32
    };
    let (rounds, queue) = (mean(Order::Passes), mean(Order::Btree));
    assert!((rounds / queue - 1.0).abs() < 0.1, "{rounds} {queue}");
}

/// A flat sheet has no error but its outline's: a terrain's corners must stay to the last.
#[test]
fn the_outline_of_a_flat_sheet_keeps_its_corners() {
    let mesh = sheet(16, 16, 0.0, 0, 1);
    let tree = tree(&mesh, Metric::Quadric, Order::Passes);
    let active = cut::cut(&tree, |node| tree.splits[node.split as usize].switch > 1e-3);
    let mut corners: Vec<_> = active.iter().map(|node| tree.positions[node.start as usize]).collect();
    corners.sort_by(|a, b| a.partial_cmp(b).unwrap());
    assert_eq!(corners, [[0.0, 0.0, 0.0], [0.0, 16.0, 0.0], [16.0, 0.0, 0.0], [16.0, 16.0, 0.0]]);
    assert_eq!(cut::triangles(&tree, &active).len(), 2);
}

/// Parts vanish when the error allowed reaches their size, and not before.
#[test]
fn a_small_part_vanishes_at_its_diameter() {
    let mut mesh = sheet(8, 8, 0.0, 0, 1);
    mesh.append(&closed_box(), [20.0, 0.0, 0.0]);
    let tree = tree(&mesh, Metric::Quadric, Order::Passes);
    let root_switches: Vec<f32> = tree.roots.iter().map(|root| tree.splits[root.split as usize].switch).collect();
    assert_eq!(root_switches.len(), 2);
    for diameter in [3.0_f32.sqrt(), 128.0_f32.sqrt()] {
        // Switch values are rounded up to eighths of an octave.
        let vanishes = |switch: &f32| (diameter..1.0906 * diameter).contains(switch);
        assert!(root_switches.iter().any(vanishes), "{root_switches:?}");
    }
}

/// Any other scale rounds the positions anew, which breaks some ties: nearly all collapses are the same, and switch values
/// are nearly the same, scaled.
#[test]
fn any_scale_changes_next_to_nothing() {
    let noisy = [sphere(5, 0.05, 9), torus(60, 40, 0.05, 4), sheet(50, 50, 0.2, 3, 5)];
    for mesh in noisy.map(RawMesh::in_single_precision) {
        let expected = history(&core(&mesh), Metric::Quadric, Order::Passes);
        for factor in [1000.0, 0.001] {
            let mut scaled = mesh.clone();
            scaled.positions.iter_mut().flatten().for_each(|value| *value *= factor);
            let scaled = core(&scaled.in_single_precision());
            let found = history(&scaled, Metric::Quadric, Order::Passes);
            // By places, since canonical ids may change.
            let places = |mesh: &CoreMesh, factor: f64, history: &History| -> BTreeSet<[[i64; 3]; 2]> {
                let place = |vertex: u32| {
                    mesh.positions[vertex as usize].map(|value| (f64::from(value) / factor * 1e5).round() as i64)
                };
                history.collapses.iter().map(|collapse| [collapse.kept, collapse.born].map(place)).collect()
            };
            let (before, after) = (places(&core(&mesh), 1.0, &expected), places(&scaled, factor, &found));
            assert!(before.intersection(&after).count() * 100 >= before.len() * 95);
            let switches = |history: &History, exponent: i32| {
                let switches = history.collapses.iter().map(|collapse| switch_of(collapse.id, exponent));
                let mut switches: Vec<f32> = switches.collect();
                switches.sort_by(f32::total_cmp);
                [0.5, 0.9, 0.99].map(|share| f64::from(switches[(switches.len() as f64 * share) as usize]))
            };
            let before = switches(&expected, core(&mesh).exponent);
            for (before, after) in before.into_iter().zip(switches(&found, scaled.exponent)) {
                assert!((after / (before * factor) - 1.0).abs() < 0.2, "{before} {after} {factor}");
            }
        }
    }
}
