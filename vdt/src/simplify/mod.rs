//! The half-edge collapse engine, and what drives it (the paper, 3.1).
//!
//! | module | what it does |
//! |---|---|
//! | [`metric`] | what a collapse costs: quadric error, or edge length |
//! | `live_mesh` | the mesh that is left: vertices, stars, triangles |
//! | `live_wedges` | its wedges: colours, places in textures, materials, normals |
//! | `wedge_images` | what wedges turn into, and whether the seams of the texture allow a collapse |
//! | `attribute_error` | how much a collapse changes what is on the surface |
//! | `legality` | link condition, boundaries and non-manifold edges, fold-overs |
//! | `bound` | certified errors: how far the input is from what a collapse leaves, at most |
//! | `collapse` | one collapse: tried, made, written down |
//! | `rounds` | the default order: rounds of a frozen batch (design, section 3) |
//! | [`log`] | what is written down: collapses, deaths, roots |
//! | `queue` | the paper's order: shortest edge first, through one priority queue |
//! | `spanned` | the same order for a mesh larger than memory: spanned sub-meshes |
//! | `end_phase` | brings what no legal collapse can reduce down to one root per component |
//!
//! What comes out is [`log::Simplified`]: every collapse with all that its node will ever need, and for each triangle the
//! collapse at which it disappeared. Both orders are functions of the canonical mesh alone, whatever the memory and the
//! threads (`docs/exactness.md`).
//!
//! Determinism: all sums have a fixed order, nothing is fused or vectorised by the machine's features, and only +, -,
//! *, / and square roots are used, which IEEE 754 fixes to the bit.

mod attribute_error;
mod bound;
mod collapse;
mod components;
mod end_phase;
mod initial;
mod journal;
mod legality;
mod live_mesh;
mod live_wedges;
pub mod log;
pub mod metric;
mod passes;
mod plan;
mod prefetch;
mod queue;
mod radix;
mod records;
mod rounds;
mod seams;
mod spanned;
mod unsettled;
mod wedge_images;

pub use spanned::{SpannedCounters, SpannedError};
use storage::{ByteSize, EdgeTreeKind, Scratch, StorageError};
use thiserror::Error;

use crate::ingest::StoredMesh;
use crate::tree::{ErrorBound, Metric, Strategy};
use collapse::Engine;
use components::{BlockLabels, Labels};
use journal::Journal;
use live_mesh::{LiveMesh, Normalisation};
use live_wedges::Heeded;
use log::Simplified;
use metric::{CollapseMetric, LengthMetric, QuadricMetric};
use passes::Left;
use plan::{Carried, Plan};
use queue::Waiting;
use rounds::{Histogram, Schedule};
use spanned::{Shares, Task};

/// How a mesh is to be simplified.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SimplifyOptions {
    /// What a collapse costs.
    pub metric: Metric,
    /// How the order of the collapses is found.
    pub strategy: Strategy,
    /// What the switch values are.
    pub error_bound: ErrorBound,
    /// RAM for what grows with the mesh.
    pub memory: ByteSize,
    /// How many threads may work. [`Strategy::Btree`] has one.
    pub threads: usize,
    /// The tree of edges of [`Strategy::Btree`], for a mesh that does not fit in memory.
    pub edge_tree: EdgeTreeKind,
}

/// Why a mesh was not simplified.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SimplifyError {
    /// The disk failed or is full.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// Spanned sub-meshes could not be simplified.
    #[error(transparent)]
    Spanned(#[from] SpannedError),
    /// Blocks have more in common than fits in memory.
    #[error(
        "the seams between blocks of the mesh have {triangles} triangles, which do not fit in memory together; \
         run again with --memory {}",
        needed.as_argument()
    )]
    Seam {
        /// Triangles at the seams.
        triangles: u64,
        /// What would do.
        needed: ByteSize,
    },
}

/// How many triangles a block of a mesh should have that is to be simplified with so much memory and so many threads.
pub fn block_triangles(memory: ByteSize, threads: usize, bound: ErrorBound) -> u64 {
    Plan::new(memory.0, threads, bound).block_triangles
}

/// About how many bytes an error bound takes at its peak, for each triangle of a mesh that is simplified in memory.
pub fn bound_bytes(bound: ErrorBound) -> u64 {
    Plan::bound_bytes(bound)
}

/// The least memory with which a mesh of so many triangles can be simplified, unless it is of an unusual kind: blocks
/// whose seams hold more than half of the mesh, or components that no legal collapse can reduce.
pub fn smallest_memory(triangles: u64, threads: usize, bound: ErrorBound) -> ByteSize {
    Plan::smallest_memory(triangles, threads, bound)
}

/// About how much scratch a build takes on disk at its peak, in bytes, for a mesh of so many triangles that does not fit in
/// memory: as measured on terrain of 1 to 100 million triangles, within 20 %. Pieces that triangles keep come on top.
pub fn scratch_bytes(triangles: u64, memory: ByteSize, threads: usize, bound: ErrorBound) -> u64 {
    // The first pass writes the mesh while it is still read, the less of it the more rounds it has.
    let for_each = match Plan::new(memory.0, threads, bound).expected_rounds(triangles) {
        4.. => 80,
        2.. => 107,
        _ => 130,
    };
    let for_pieces = match bound {
        ErrorBound::None => 0,
        ErrorBound::Fast => 2,
        ErrorBound::Default | ErrorBound::TwoSided => 32,
        ErrorBound::Tight => 85,
    };
    (triangles * (for_each + for_pieces)).saturating_sub(memory.0 / 4)
}

/// The least memory with which a mesh of so many vertices and triangles can be simplified by [`Strategy::Btree`] with
/// [`EdgeTreeKind::Sled`].
pub fn smallest_memory_with_sled(vertices: u64, triangles: u64, bound: ErrorBound) -> ByteSize {
    spanned::memory_for_sled(vertices, triangles, bound)
}

/// Simplifies a canonical mesh down to one root per component.
///
/// `progress` is called now and then with the share of the vertices that are gone, 0 to 1.
pub fn simplify(
    mesh: &StoredMesh,
    options: &SimplifyOptions,
    scratch: &Scratch,
    progress: &mut (dyn FnMut(f64) + Send),
) -> Result<Simplified, SimplifyError> {
    // What the mesh holds in RAM is not there for anything else.
    let memory = options.memory.0.saturating_sub(mesh.ram_bytes());
    let plan = Plan::new(memory, options.threads, Carried::of(mesh, options.error_bound));
    if options.strategy == Strategy::Btree && mesh.triangles.len() > plan.queue_triangles {
        let result = simplify_spanned(mesh, options, ByteSize(memory), scratch, progress);
        return result.map(|(simplified, counters)| Simplified { spanned: Some(counters), ..simplified });
    }
    match options.metric {
        Metric::Quadric => run(mesh, QuadricMetric, options.strategy, plan, scratch, progress),
        Metric::Length => run(mesh, LengthMetric, options.strategy, plan, scratch, progress),
    }
}

/// Simplifies a canonical mesh in the paper's order, through spanned sub-meshes where it does not fit in memory. The
/// outcome is that of [`simplify`] with [`Strategy::Btree`] and memory without end.
///
/// # Errors
///
/// Besides those of the disk: where sled would not keep to the memory, or what one collapse needs is more than fits.
fn simplify_spanned(
    mesh: &StoredMesh,
    options: &SimplifyOptions,
    memory: ByteSize,
    scratch: &Scratch,
    progress: &mut (dyn FnMut(f64) + Send),
) -> Result<(Simplified, SpannedCounters), SimplifyError> {
    let SimplifyOptions { metric, error_bound: bound, edge_tree: kind, .. } = *options;
    let shares = Shares::new(memory, kind);
    match metric {
        Metric::Quadric => run_spanned(Task { mesh, metric: QuadricMetric, bound, kind, shares, scratch }, progress),
        Metric::Length => run_spanned(Task { mesh, metric: LengthMetric, bound, kind, shares, scratch }, progress),
    }
}

fn run_spanned<M: CollapseMetric>(
    task: Task<'_, M>,
    progress: &mut (dyn FnMut(f64) + Send),
) -> Result<(Simplified, SpannedCounters), SimplifyError> {
    let journal = Journal::new(task.scratch, task.mesh.triangles.len(), task.shares.memory.0 as usize / 16);
    Ok(spanned::run(&task, journal, progress)?)
}

fn run<M: CollapseMetric>(
    mesh: &StoredMesh,
    metric: M,
    strategy: Strategy,
    plan: Plan,
    scratch: &Scratch,
    progress: &mut (dyn FnMut(f64) + Send),
) -> Result<Simplified, SimplifyError> {
    let triangles = mesh.triangles.len();
    let journal = Journal::new(scratch, triangles, plan.memory as usize / 16);
    let mut schedule = Schedule::new(triangles);
    let left = if triangles <= plan.core_triangles {
        load(mesh, metric, plan.carried.bound, scratch)?
    } else {
        passes::run(mesh, metric, &plan, scratch, &journal, &mut schedule, progress)?
    };
    let (mut engine, components) = match left {
        Left::Core(engine, components) => (engine, components),
        Left::Roots { roots, legal_collapses } => return Ok(journal.finish(roots, schedule.done, legal_collapses)?),
    };
    let mut take = |engine: &mut Engine<M>| {
        journal.take(engine)?;
        progress(journal.collapses() as f64 / mesh.positions.len().max(1) as f64);
        Ok::<(), StorageError>(())
    };
    match strategy {
        Strategy::Passes => rounds::run(&mut engine, &mut schedule, &mut Histogram::new(), &mut take)?,
        Strategy::Btree => {
            let waiting = Waiting::all(&engine);
            queue::run(&mut engine, waiting, &mut take)?;
            schedule.done = 1;
        }
    }
    let legal = journal.collapses();
    let mut roots = Vec::new();
    end_phase::run(&mut engine, &components, |_| true, &mut roots, &mut take)?;
    Ok(journal.finish(roots, schedule.done, legal)?)
}

/// The whole mesh in memory, before the first collapse.
fn load<M: CollapseMetric>(
    mesh: &StoredMesh,
    metric: M,
    bound: ErrorBound,
    scratch: &Scratch,
) -> Result<Left<M>, StorageError> {
    let heeded = Heeded::of(mesh.attributes.as_ref());
    let mut live = LiveMesh::new(Normalisation::new(mesh.exponent), mesh.bounds[0], bound, heeded);
    let everything = [mesh.positions.len(), mesh.triangles.len()].map(|count| [0, count as u32]);
    let (positions, corners) = (&mesh.positions, &mesh.triangles);
    initial::load(&mut live, positions, corners, everything, &[], metric.uses_quadrics(), &mut Vec::new())?;
    if let Some(attributes) = &mesh.attributes {
        live.load_first_attributes(attributes, 0)?;
    }
    let mut labels = Labels::new(scratch);
    labels.add(&BlockLabels::of(&mut live, |_| false))?;
    Ok(Left::Core(Engine::new(live, metric, mesh.exponent, bound), labels.join()?))
}

#[cfg(test)]
mod attribute_tests;
#[cfg(test)]
mod tests;
