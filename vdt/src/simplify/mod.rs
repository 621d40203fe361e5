//! The half-edge collapse engine, and what drives it (the paper, 3.1).
//!
//! | module | what it does |
//! |---|---|
//! | [`metric`] | what a collapse costs: quadric error, or edge length |
//! | `live_mesh` | the mesh that is left: vertices, stars, triangles |
//! | `legality` | link condition, boundaries and non-manifold edges, fold-overs |
//! | `collapse` | one collapse: tried, made, written down |
//! | `rounds` | the default order: rounds of a frozen batch (design, section 3) |
//! | `queue` | the paper's order: shortest edge first, through one priority queue |
//! | `end_phase` | brings what no legal collapse can reduce down to one root per component |
//!
//! What comes out is a [`History`]: every collapse in the order in which it was decided, and for each triangle the
//! collapse at which it disappeared. Both orders are functions of the canonical mesh alone.
//!
//! Determinism: all sums have a fixed order, nothing is fused or vectorised by the machine's features, and only +, -,
//! *, / and square roots are used, which IEEE 754 fixes to the bit.

mod collapse;
mod end_phase;
mod legality;
mod live_mesh;
pub mod metric;
mod queue;
mod rounds;

use crate::ingest::CoreMesh;
use crate::tree::{Metric, Strategy};
use metric::{CollapseMetric, LengthMetric, QuadricMetric};

pub use collapse::Collapse;

/// Everything that happened to a mesh until one root per component was left.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct History {
    /// The collapses in the order in which they were decided.
    pub collapses: Vec<Collapse>,
    /// For each canonical triangle the collapse, as an index, at which two of its corners became one.
    pub death: Vec<u32>,
    /// For each canonical vertex: no edge at it but has exactly two triangles with opposite directions along it.
    pub regular: Vec<bool>,
    /// How many of the collapses passed the legality tests; those after them belong to the end phase.
    pub legal: usize,
    /// Rounds that the legal collapses took (1 for [`Strategy::Btree`]).
    pub rounds: u32,
}

/// Simplifies a canonical mesh down to one root per component.
///
/// `progress` is called now and then with the share of the vertices that are gone, 0 to 1.
pub fn simplify(mesh: &CoreMesh, metric: Metric, strategy: Strategy, progress: &mut dyn FnMut(f64)) -> History {
    match metric {
        Metric::Quadric => run(mesh, QuadricMetric, strategy, progress),
        Metric::Length => run(mesh, LengthMetric, strategy, progress),
    }
}

fn run<M: CollapseMetric>(mesh: &CoreMesh, metric: M, strategy: Strategy, progress: &mut dyn FnMut(f64)) -> History {
    let mut engine = collapse::Engine::new(mesh, metric);
    match strategy {
        Strategy::Passes => rounds::run(&mut engine, progress),
        Strategy::Btree => queue::run(&mut engine, progress),
    }
    let (legal, rounds) = (engine.collapse_count(), engine.round());
    end_phase::run(&mut engine, mesh, progress);
    engine.into_history(legal, rounds)
}
