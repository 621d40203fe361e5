//! The certified switch values, held against distances by brute force: every point of the input lies within the largest
//! switch value of the nodes of a cut from the mesh of the cut, whatever the mesh, the order and the cut; and with the
//! two-sided bound every point of the cut from the input.

// A test says what it expects by unwrapping.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use vdt::ingest::{CleaningCounts, CoreMesh, canonical};
use vdt::tree::{ErrorBound, Metric, NO_SPLIT, Strategy as Order, Tree};
use vdt_tests::cut::{self, Node};
use vdt_tests::distance::{points_of, to_triangles};
use vdt_tests::history::tree_with;
use vdt_tests::random_mesh::{Random, RawMesh, any_mesh, sheet, sphere, torus};

fn core(mesh: &RawMesh) -> CoreMesh {
    canonical(mesh.positions.clone(), mesh.triangles.clone(), CleaningCounts::default()).unwrap()
}

fn any_bound() -> impl Strategy<Value = ErrorBound> {
    prop::sample::select(ErrorBound::ALL[1..].to_vec())
}

fn any_order() -> impl Strategy<Value = (Metric, Order)> {
    prop_oneof![
        3 => Just((Metric::Quadric, Order::Passes)),
        1 => Just((Metric::Quadric, Order::Btree)),
        1 => Just((Metric::Length, Order::Passes)),
    ]
}

fn switch(tree: &Tree, node: Node) -> f32 {
    if node.split == NO_SPLIT { 0.0 } else { tree.splits[node.split as usize].switch }
}

/// How far the input is from a cut, and with `both_ways`, if that is more, the cut from the input; and what the cut states.
/// Of the input those trees count of which anything is drawn.
fn measured_and_stated(tree: &Tree, active: &[Node], steps: u32, both_ways: bool) -> (f64, f64) {
    let place = |leaf: u32| tree.positions[leaf as usize].map(f64::from);
    let drawn = cut::triangles(tree, active);
    let surface: Vec<_> = drawn.iter().map(|corners| corners.map(place)).collect();
    let tree_of = |leaf: u32| tree.roots.partition_point(|root| root.start <= leaf);
    let mut is_drawn = vec![false; tree.roots.len() + 1];
    drawn.iter().for_each(|corners| is_drawn[tree_of(corners[0])] = true);
    let input = tree.triangles.corners.iter().filter(|corners| is_drawn[tree_of(corners[0])]);
    let points = input.flat_map(|corners| points_of(corners.map(place), steps));
    let mut measured = points.map(|point| to_triangles(point, &surface)).fold(0.0, f64::max);
    if both_ways {
        let input: Vec<_> = tree.triangles.corners.iter().map(|corners| corners.map(place)).collect();
        let points = surface.iter().flat_map(|triangle| points_of(*triangle, steps));
        measured = points.map(|point| to_triangles(point, &input)).fold(measured, f64::max);
    }
    let stated = active.iter().filter(|node| is_drawn[tree_of(node.start)]).map(|node| switch(tree, *node));
    (measured, stated.fold(0.0, f32::max).into())
}

/// Fails where the input is farther from a cut than that states, or with a two-sided bound the cut from the input.
fn check(tree: &Tree, active: &[Node], steps: u32, bound: ErrorBound) -> Result<f64, TestCaseError> {
    let (measured, stated) = measured_and_stated(tree, active, steps, bound.is_two_sided());
    // The reference computes with doubles, on coordinates up to 200.
    prop_assert!(measured <= stated + 1e-11, "{} is stated, and {} measured", stated, measured);
    Ok(if measured > 0.0 { stated / measured } else { 1.0 })
}

/// Switch values to cut at: from the finest to the coarsest.
fn thresholds(tree: &Tree, count: usize) -> Vec<f32> {
    let mut switches: Vec<f32> = tree.splits.iter().map(|split| split.switch).filter(|switch| *switch > 0.0).collect();
    switches.sort_by(f32::total_cmp);
    (0..count).filter_map(|index| switches.get(index * switches.len() / count).copied()).collect()
}

/// Splits nodes of a cut until, of the collapses that moved a corner of a triangle of the input, those that are not undone
/// come before those that are: the closure over the dependency, triangles that are not drawn included.
fn close(tree: &Tree, mut active: Vec<Node>) -> Vec<Node> {
    let moves = Moves::of(tree);
    loop {
        let ancestor = cut::ancestors(tree, &active);
        let mut is_split = vec![false; active.len()];
        for corners in &tree.triangles.corners {
            for (x, y) in [(0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)] {
                let [at_x, at_y] = [corners[x], corners[y]].map(|leaf| ancestor[leaf as usize]);
                if at_x != at_y && moves.last(tree, active[at_x], corners[x]) > moves.next(active[at_y]) {
                    is_split[at_x] = true;
                }
            }
        }
        if !is_split.contains(&true) {
            return active;
        }
        let nodes = active.iter().zip(is_split);
        active = nodes
            .flat_map(|(node, is_split)| if is_split { cut::children(tree, *node).to_vec() } else { vec![*node] })
            .collect();
    }
}

/// For each node the id of the first collapse above it that moves its corners.
struct Moves(std::collections::BTreeMap<Node, u32>);

impl Moves {
    fn of(tree: &Tree) -> Self {
        let mut moves = std::collections::BTreeMap::new();
        let mut stack: Vec<(Node, u32)> = cut::roots(tree).into_iter().map(|root| (root, u32::MAX)).collect();
        while let Some((node, moved_by)) = stack.pop() {
            moves.insert(node, moved_by);
            if node.split != NO_SPLIT {
                let [kept, born] = cut::children(tree, node);
                stack.extend([(kept, moved_by), (born, tree.splits[node.split as usize].id)]);
            }
        }
        Moves(moves)
    }

    fn next(&self, node: Node) -> u32 {
        self.0[&node]
    }

    /// The id of the collapse that moved the corner of a leaf to a node; 0 where none did.
    fn last(&self, tree: &Tree, mut node: Node, leaf: u32) -> u32 {
        while node.split != NO_SPLIT {
            let [kept, born] = cut::children(tree, node);
            if leaf >= born.start {
                return tree.splits[node.split as usize].id;
            }
            node = kept;
        }
        0
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, ..ProptestConfig::default() })]

    #[test]
    fn the_input_is_no_farther_from_a_uniform_cut_than_stated(
        mesh in any_mesh(), bound in any_bound(), (metric, order) in any_order(),
    ) {
        let tree = tree_with(&core(&mesh), metric, order, bound);
        for threshold in thresholds(&tree, 12) {
            let active = cut::cut(&tree, |node| switch(&tree, node) > threshold);
            check(&tree, &active, 4, bound)?;
        }
    }

    /// A cut that mixes levels, closed over the dependency.
    #[test]
    fn nor_from_one_that_mixes_levels(
        mesh in any_mesh(), bound in any_bound(), (metric, order) in any_order(), seed in any::<u64>(),
    ) {
        let tree = tree_with(&core(&mesh), metric, order, bound);
        let mut random = Random(seed);
        for threshold in thresholds(&tree, 6) {
            let coarse = 10.0_f32.powf(3.0 * random.signed() as f32);
            let (axis, border) = (random.below(3), 2.0 * random.signed() as f32);
            let active = cut::cut(&tree, |node| {
                let is_coarse = tree.positions[node.start as usize][axis] > border;
                switch(&tree, node) > threshold * if is_coarse { coarse } else { 1.0 }
            });
            check(&tree, &close(&tree, active), 4, bound)?;
        }
    }
}

/// The bound is not only true, but near, the more is kept the nearer: with one piece, at most twice what is measured, in the
/// median of some cuts; and up to 1.09 times that, since switch values are rounded up to eighths of an octave.
#[test]
fn what_is_stated_is_near_what_is_measured() {
    for mesh in [sphere(4, 0.0, 1), torus(30, 20, 0.02, 2), sheet(25, 25, 0.3, 0, 3)] {
        let mut medians = Vec::new();
        for bound in [ErrorBound::Fast, ErrorBound::Default, ErrorBound::Tight, ErrorBound::TwoSided] {
            let tree = tree_with(&core(&mesh), Metric::Quadric, Order::Passes, bound);
            let mut ratios: Vec<f64> = thresholds(&tree, 20)[10..19]
                .iter()
                .map(|threshold| {
                    let active = cut::cut(&tree, |node| switch(&tree, node) > *threshold);
                    check(&tree, &active, 2, bound).unwrap()
                })
                .collect();
            ratios.sort_by(f64::total_cmp);
            medians.push(ratios[ratios.len() / 2]);
        }
        assert!(medians[0] < 3.0 && medians[1] < 2.0 && medians[2] < 1.6 * 1.0906, "{medians:?}");
        assert!(medians[..3].is_sorted_by(|a, b| a >= b) && medians[3] < 3.0, "{medians:?}");
    }
}
