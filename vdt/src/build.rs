//! From mesh files to a finished tree, within a memory limit, whatever the size of the mesh.
//!
//! | phase | what it does | module |
//! |---|---|---|
//! | reading | canonical form, in spatial blocks | [`crate::ingest`] |
//! | simplifying | collapses, written down in a log | [`crate::simplify`] |
//! | numbering | leaf numbers, ids, born triangles | [`crate::tree`] |
//!
//! The phases follow each other, so each has all of the memory. What does not fit goes to the scratch. After the first
//! two there is a checkpoint in it, from which another process can go on.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use storage::{ByteSize, Disk, EdgeTreeKind, Scratch, StorageError};
use thiserror::Error;

use crate::ingest::{self, CleaningCounts, FileCounts, IngestPlan, KeptMesh, PositionsRule, StoredMesh};
use crate::mesh::MeshError;
use crate::simplify::log::{KeptSimplified, Simplified};
use crate::simplify::{self, SimplifyError, SimplifyOptions, SpannedCounters};
use crate::tree::{AttributeKinds, ErrorBound, FinishError, Metric, Positions, StoredTree, Strategy, finish};

/// How a tree is to be built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BuildOptions {
    /// Limit on what grows with the mesh.
    pub memory: ByteSize,
    /// How many threads may work.
    pub threads: usize,
    /// What a collapse costs.
    pub metric: Metric,
    /// How the order of the collapses is found.
    pub strategy: Strategy,
    /// What the switch values are.
    pub error_bound: ErrorBound,
    /// The tree of edges of [`Strategy::Btree`], for a mesh that does not fit in memory.
    pub edge_tree: EdgeTreeKind,
    /// How positions are kept.
    pub positions: PositionsRule,
    /// Whether normals, colours, texture coordinates and materials of the files are kept.
    pub attributes: bool,
}

/// The phases of a build.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Reading the mesh files and bringing them into canonical form.
    Reading,
    /// Collapsing edges.
    Simplifying,
    /// Leaf numbers, born triangles.
    Numbering,
    /// Cutting the tree into meta-nodes and writing the model: not done here, but watched in the same way.
    Writing,
}

/// Why there is no tree.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BuildError {
    /// A mesh file could not be read, or holds no mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// Simplification failed.
    #[error(transparent)]
    Simplify(#[from] SimplifyError),
    /// Numbering failed.
    #[error(transparent)]
    Finish(#[from] FinishError),
    /// The scratch failed.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The mesh cannot be simplified in so little memory.
    #[error(
        "{triangles} triangles need {needed} of RAM to be simplified, and {memory} are allowed; \
         run again with --memory {}",
        needed.as_argument()
    )]
    Memory {
        /// Triangles of the mesh.
        triangles: u64,
        /// What would do.
        needed: ByteSize,
        /// What is allowed.
        memory: ByteSize,
    },
    /// What the build had come to could not be written down.
    #[error("the state of the build cannot be written down: {problem}")]
    Checkpoint {
        /// Why.
        problem: String,
    },
}

/// What a phase took.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhaseCost {
    /// Which phase.
    pub phase: Phase,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// CPU seconds of all threads.
    pub cpu_seconds: f64,
    /// Bytes read, as the operating system counts them; 0 where it does not.
    pub bytes_read: u64,
    /// Bytes written.
    pub bytes_written: u64,
}

/// How far a build is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Where it is.
    pub phase: Phase,
    /// The share of the phase that is done, 0 to 1.
    pub share: f64,
    /// Triangles that the phase has to do; 0 while they are being counted.
    pub triangles: u64,
}

/// A watch over what a phase takes.
#[derive(Debug)]
pub struct PhaseWatch {
    start: Instant,
    cpu: Duration,
    bytes: (u64, u64),
}

impl PhaseWatch {
    /// Begins to watch.
    pub fn start() -> Self {
        let (start, cpu) = (Instant::now(), storage::usage::cpu_time());
        PhaseWatch { start, cpu, bytes: storage::usage::bytes_read_and_written().unwrap_or_default() }
    }

    /// What was taken since.
    pub fn cost(&self, phase: Phase) -> PhaseCost {
        let bytes = storage::usage::bytes_read_and_written().unwrap_or_default();
        PhaseCost {
            phase,
            seconds: self.start.elapsed().as_secs_f64(),
            cpu_seconds: (storage::usage::cpu_time() - self.cpu).as_secs_f64(),
            bytes_read: bytes.0 - self.bytes.0,
            bytes_written: bytes.1 - self.bytes.1,
        }
    }
}

/// What happened during a build.
#[derive(Debug, Clone, PartialEq)]
pub struct BuildReport {
    /// What the files held.
    pub files: FileCounts,
    /// What was changed on the way in.
    pub cleaning: CleaningCounts,
    /// How positions were kept.
    pub positions: Positions,
    /// The step of the lattice that all positions are on, in mesh units; 0 where there is none.
    pub lattice_step: f32,
    /// No point of a triangle in the files is farther than this from the mesh that was simplified, in mesh units.
    pub input_error: f32,
    /// Which attributes were kept.
    pub attributes: AttributeKinds,
    /// What the files name and is not there, without which the mesh is still one: libraries of materials, images.
    pub missing_files: Vec<PathBuf>,
    /// Rounds of collapses that kept all legality tests (1 with [`Strategy::Btree`]).
    pub rounds: u32,
    /// Collapses that kept all legality tests.
    pub legal_collapses: u64,
    /// Collapses of the end phase.
    pub end_phase_collapses: u64,
    /// What the way through spanned sub-meshes took, where that was taken.
    pub spanned: Option<SpannedCounters>,
    /// What each phase took. Phases that an earlier process had finished are not among them.
    pub phases: Vec<PhaseCost>,
}

/// What a build is going to take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The largest resident set, in bytes.
    pub peak_bytes: u64,
    /// The least memory with which it can be done.
    pub smallest_memory: ByteSize,
    /// Bytes of scratch on disk at the peak.
    pub scratch_bytes: u64,
    /// CPU seconds of all threads, on a machine like that on which it was measured.
    pub cpu_seconds: f64,
}

/// The program itself, its code and stacks, in bytes.
const PROGRAM_BYTES: u64 = 5 << 20;
/// Bytes for each triangle at the peak of a build that touches no disk, without what the error bound takes.
const CORE_BYTES: u64 = 140;
/// CPU time for each triangle, in core and with a scratch, in nanoseconds, without what the error bound takes.
const CPU_NANOSECONDS: [f64; 2] = [1900.0, 2400.0];

/// CPU time of the error bound for each triangle, in nanoseconds.
fn bound_nanoseconds(bound: ErrorBound) -> f64 {
    match bound {
        ErrorBound::None => 0.0,
        ErrorBound::Fast => 500.0,
        ErrorBound::Default => 1300.0,
        ErrorBound::Tight => 2700.0,
        ErrorBound::TwoSided => 1900.0,
    }
}

/// Says beforehand what a build of files that hold this much is going to take, with these attributes.
pub fn estimate(counts: FileCounts, kinds: AttributeKinds, options: &BuildOptions) -> Estimate {
    let memory = options.memory.0;
    let in_core = counts.triangles * (CORE_BYTES + simplify::bound_bytes(options.error_bound));
    let is_external = in_core > memory;
    let simplify = match (options.strategy, options.edge_tree) {
        (Strategy::Btree, EdgeTreeKind::Sled) => {
            simplify::smallest_memory_with_sled(counts.vertices, counts.triangles, options.error_bound).0
        }
        _ => simplify::smallest_memory(counts.triangles, options.threads, options.error_bound).0,
    };
    let reading = ingest::smallest_memory(
        counts,
        options.attributes && !kinds.is_empty(),
        simplify::block_triangles(options.memory, options.threads, options.error_bound),
    )
    .0;
    let nanoseconds = CPU_NANOSECONDS[usize::from(is_external)] + bound_nanoseconds(options.error_bound);
    Estimate {
        peak_bytes: PROGRAM_BYTES + in_core.min(memory),
        smallest_memory: ByteSize(simplify.max(reading)),
        scratch_bytes: if is_external {
            simplify::scratch_bytes(counts.triangles, options.memory, options.threads, options.error_bound)
        } else {
            0
        },
        cpu_seconds: counts.triangles as f64 * nanoseconds * 1e-9,
    }
}

/// The version of the records in the files of a checkpoint. Those of another one are not taken up.
const RECORDS_VERSION: u32 = 3;

/// A checkpoint, as the scratch has it.
#[derive(Debug, Serialize, Deserialize)]
struct Saved {
    records_version: u32,
    checkpoint: Checkpoint,
}

/// What an interrupted build had come to.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Checkpoint {
    /// The mesh was read.
    Read(KeptMesh),
    /// All collapses were made.
    Simplified(KeptMesh, Box<KeptSimplified>),
}

/// Builds the view-dependence tree of the mesh in `paths` (several files are one mesh).
///
/// `resumed` is the checkpoint of an earlier process, as [`Scratch::open`] gave it for the same files and options.
/// `progress` is told of each phase when it begins, and how far it is.
pub fn build(
    disk: &dyn Disk,
    paths: &[PathBuf],
    options: &BuildOptions,
    scratch: &Scratch,
    resumed: Option<serde_json::Value>,
    progress: &mut (dyn FnMut(Step) + Send),
) -> Result<(StoredTree, BuildReport), BuildError> {
    let BuildOptions { memory, threads, metric, strategy, error_bound, edge_tree, positions, attributes } = *options;
    let mut phases = Vec::new();
    let saved = resumed.and_then(|state| serde_json::from_value::<Saved>(state).ok());
    let saved = saved.filter(|saved| saved.records_version == RECORDS_VERSION);
    let (mesh, simplified) = match saved.map(|saved| saved.checkpoint) {
        Some(Checkpoint::Simplified(mesh, simplified)) => {
            (StoredMesh::reopen(scratch, &mesh)?, Some(Simplified::reopen(scratch, &simplified)?))
        }
        Some(Checkpoint::Read(mesh)) => (StoredMesh::reopen(scratch, &mesh)?, None),
        None => {
            progress(Step { phase: Phase::Reading, share: 0.0, triangles: 0 });
            let watch = PhaseWatch::start();
            let block_triangles = simplify::block_triangles(memory, threads, error_bound);
            let plan = IngestPlan { memory, threads, block_triangles, positions, attributes };
            let mut mesh = ingest::store(disk, scratch, paths, &plan, &mut |share| {
                progress(Step { phase: Phase::Reading, share, triangles: 0 });
            })?;
            if mesh.is_on_disk() {
                let kept = mesh.keep(scratch)?;
                let files = kept.files().collect();
                save(scratch, Checkpoint::Read(kept), files)?;
            }
            phases.push(watch.cost(Phase::Reading));
            (mesh, None)
        }
    };
    let mut mesh = mesh;
    let triangles = mesh.triangles.len();
    let needed = simplify::smallest_memory(triangles, threads, error_bound);
    if strategy == Strategy::Passes && needed > memory {
        return Err(BuildError::Memory { triangles, needed, memory });
    }
    let simplified = match simplified {
        Some(simplified) => simplified,
        None => {
            progress(Step { phase: Phase::Simplifying, share: 0.0, triangles });
            let watch = PhaseWatch::start();
            let simplify_options = SimplifyOptions { metric, strategy, error_bound, memory, threads, edge_tree };
            let mut simplified = simplify::simplify(&mesh, &simplify_options, scratch, &mut |share| {
                progress(Step { phase: Phase::Simplifying, share, triangles });
            })?;
            if mesh.is_on_disk() {
                let (kept_mesh, kept) = (mesh.keep(scratch)?, simplified.keep(scratch)?);
                let files = kept_mesh.files().chain(kept.files()).collect();
                save(scratch, Checkpoint::Simplified(kept_mesh, Box::new(kept)), files)?;
            }
            phases.push(watch.cost(Phase::Simplifying));
            simplified
        }
    };
    progress(Step { phase: Phase::Numbering, share: 0.0, triangles });
    let watch = PhaseWatch::start();
    let mut report = BuildReport {
        files: mesh.files,
        cleaning: mesh.cleaning,
        positions: mesh.kept_as,
        lattice_step: mesh.lattice_step,
        input_error: mesh.input_error,
        attributes: mesh.attributes.as_ref().map(|attributes| attributes.appearance.kinds).unwrap_or_default(),
        missing_files: mesh.missing_files.clone(),
        rounds: simplified.rounds,
        legal_collapses: simplified.legal_collapses,
        end_phase_collapses: simplified.log.len() - simplified.legal_collapses,
        spanned: simplified.spanned,
        phases: Vec::new(),
    };
    let tree = finish(mesh, simplified, scratch, memory, threads, &mut |share| {
        progress(Step { phase: Phase::Numbering, share, triangles });
    })?;
    phases.push(watch.cost(Phase::Numbering));
    report.phases = phases;
    Ok((tree, report))
}

fn save(scratch: &Scratch, checkpoint: Checkpoint, files: Vec<String>) -> Result<(), BuildError> {
    let saved = Saved { records_version: RECORDS_VERSION, checkpoint };
    let state = serde_json::to_value(&saved).map_err(|error| BuildError::Checkpoint { problem: error.to_string() })?;
    Ok(scratch.checkpoint(state, files)?)
}
