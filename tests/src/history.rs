//! A mesh in RAM, simplified: what happened, in build order, and the tree that comes of it.

use storage::{ByteSize, EdgeTreeKind, Scratch};
use vdt::ingest::{CoreMesh, FileCounts, StoredMesh};
use vdt::simplify::log::{LoggedCollapse, Simplified};
use vdt::simplify::{SimplifyOptions, simplify};
use vdt::tree::{ErrorBound, Metric, Strategy, Tree, finish};

/// RAM enough for any test.
const PLENTY: ByteSize = ByteSize(1 << 34);

/// Everything that happened to a mesh until one root per component was left.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct History {
    /// The collapses in the order in which they were decided: that of the log, as all is in memory.
    pub collapses: Vec<LoggedCollapse>,
    /// For each canonical triangle the collapse, as an index, at which two of its corners became one.
    pub death: Vec<u32>,
    /// How many of the collapses passed the legality tests; those after them belong to the end phase.
    pub legal: usize,
}

fn simplified(mesh: &StoredMesh, metric: Metric, strategy: Strategy, error_bound: ErrorBound) -> Simplified {
    let edge_tree = EdgeTreeKind::Redb;
    let options = SimplifyOptions { metric, strategy, error_bound, memory: PLENTY, threads: 1, edge_tree };
    simplify(mesh, &options, &Scratch::in_memory(), &mut |_| ()).unwrap()
}

fn stored(mesh: &CoreMesh) -> StoredMesh {
    StoredMesh::from_core(mesh.clone(), FileCounts::default())
}

/// What happens to a mesh when it is simplified.
pub fn history(mesh: &CoreMesh, metric: Metric, strategy: Strategy) -> History {
    let simplified = simplified(&stored(mesh), metric, strategy, ErrorBound::default());
    let mut reader = simplified.log.reader(1 << 20);
    let mut collapses = Vec::new();
    while let Some(collapse) = reader.next().unwrap() {
        collapses.push(collapse);
    }
    let mut by_born = vec![u32::MAX; mesh.positions.len()];
    for (index, collapse) in (0..).zip(&collapses) {
        by_born[collapse.born as usize] = index;
    }
    let mut deaths = simplified.deaths;
    let mut death = Vec::new();
    while let Some(born) = deaths.next().unwrap() {
        death.push(by_born[born as usize]);
    }
    History { collapses, death, legal: simplified.legal_collapses as usize }
}

/// The tree of a mesh, with the default bound.
pub fn tree(mesh: &CoreMesh, metric: Metric, strategy: Strategy) -> Tree {
    tree_with(mesh, metric, strategy, ErrorBound::default())
}

/// The tree of a mesh.
pub fn tree_with(mesh: &CoreMesh, metric: Metric, strategy: Strategy, error_bound: ErrorBound) -> Tree {
    let mesh = stored(mesh);
    let simplified = simplified(&mesh, metric, strategy, error_bound);
    finish(mesh, simplified, &Scratch::in_memory(), PLENTY, 1, &mut |_| ()).unwrap().load().unwrap()
}
