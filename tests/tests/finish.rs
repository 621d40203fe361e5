//! The tree that is made from a log in external memory: that of the slow reference, for any memory, and an error where
//! mesh and log do not belong together.

// A test says what it expects by unwrapping.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use storage::{ByteSize, Scratch};
use vdt::ingest::{CleaningCounts, canonical};
use vdt::tree::{FinishError, Tree, check, finish};
use vdt_tests::plain_tree::plain_tree;
use vdt_tests::random_log::RandomLog;
use vdt_tests::random_mesh::{RawMesh, any_mesh, sheet};

fn random_log(mesh: &RawMesh, deep: usize, seed: u64) -> RandomLog {
    let mut core = canonical(mesh.positions.clone(), mesh.triangles.clone(), CleaningCounts::default()).unwrap();
    core.origin = [1.0, 2.0, 3.0];
    RandomLog::new(core, deep, seed)
}

fn finished(log: &RandomLog, memory: u64, threads: usize, seed: u64) -> Result<Tree, FinishError> {
    let simplified = log.simplified(seed);
    let scratch = Scratch::in_memory();
    let tree = finish(log.stored_mesh(), simplified, &scratch, ByteSize(memory), threads, &mut |_| ())?;
    Ok(tree.load()?)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn the_tree_is_that_of_the_slow_reference(
        mesh in any_mesh(), deep in 0..9_usize, seed in any::<u64>(), memory in 10..24_u32, threads in 1..3_usize
    ) {
        let log = random_log(&mesh, deep, seed);
        let tree = finished(&log, 1 << memory, threads, !seed).unwrap();
        check(&tree).unwrap();
        let expected = plain_tree(&log.mesh, &log.collapses, &log.roots);
        prop_assert_eq!(&tree.roots, &expected.roots);
        prop_assert_eq!(&tree.positions, &expected.positions);
        for (leaf, (split, expected)) in tree.splits.iter().zip(&expected.splits).enumerate() {
            prop_assert_eq!(split, expected, "leaf {}", leaf);
        }
        prop_assert_eq!(tree, expected);
    }
}

/// A log that is not this mesh's, or not in order, is told from a good one.
#[test]
fn a_log_that_does_not_fit_is_refused() {
    let good = random_log(&sheet(6, 6, 0.3, 0, 1), 2, 5);
    assert!(finished(&good, 1 << 20, 1, 0).is_ok());
    let refused = |change: &dyn Fn(&mut RandomLog)| {
        let mut log = good.clone();
        change(&mut log);
        finished(&log, 1 << 20, 1, 0).unwrap_err()
    };
    let last = good.collapses.len() - 1;
    let error = refused(&|log| log.collapses.truncate(last));
    assert!(matches!(error, FinishError::Count { vertices: 49, collapses: 47, roots: 1 }), "{error}");
    let error = refused(&|log| log.roots[0].leaves -= 1);
    assert!(matches!(error, FinishError::Collapse { .. } | FinishError::Root { .. }), "{error}");
    let error = refused(&|log| log.roots[0].split = 49);
    assert!(matches!(error, FinishError::Root { root: 0, .. }), "{error}");
    let error = refused(&|log| log.roots[0].vertex = log.collapses[last].born);
    assert!(matches!(error, FinishError::Collapse { collapse: 47, .. }), "{error}");
    let error = refused(&|log| log.collapses[last].kept_leaves = 49);
    assert!(matches!(error, FinishError::Collapse { collapse: 47, .. }), "{error}");
    let error = refused(&|log| log.collapses[last].born = 49);
    assert!(matches!(error, FinishError::Collapse { collapse: 47, .. }), "{error}");
    let error = refused(&|log| log.deaths[3] = u32::MAX);
    assert!(matches!(error, FinishError::Triangle { triangle: 3, .. }), "{error}");
}
