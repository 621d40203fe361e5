//! From mesh files to a finished tree, in core, within a memory limit.
//!
//! [`needs`] says beforehand what a mesh of a given size takes; a mesh that does not fit is refused before anything is
//! built, with the number that would do. (The external build, which has no such limit, is yet to come.)

use std::path::PathBuf;
use std::time::Instant;

use storage::{ByteSize, Disk};

use crate::ingest::{self, CleaningCounts, FileCounts};
use crate::mesh::MeshError;
use crate::simplify;
use crate::tree::{Metric, Strategy, Tree, finish};

/// How a tree is to be built.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BuildOptions {
    /// Limit on what grows with the mesh.
    pub memory: ByteSize,
    /// What a collapse costs.
    pub metric: Metric,
    /// How the order of the collapses is found.
    pub strategy: Strategy,
}

/// The phases of a build, for whoever shows progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Reading the mesh files and bringing them into canonical form.
    Reading,
    /// Collapsing edges.
    Simplifying,
    /// Numbering, leaf intervals, bounding spheres, normal cones.
    Finishing,
}

/// What happened during a build.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BuildReport {
    /// What the files held.
    pub files: FileCounts,
    /// What was changed on the way in.
    pub cleaning: CleaningCounts,
    /// Rounds of collapses that kept all legality tests (1 with [`Strategy::Btree`]).
    pub rounds: u32,
    /// Collapses that kept all legality tests.
    pub legal_collapses: u64,
    /// Collapses of the end phase.
    pub end_phase_collapses: u64,
    /// Wall-clock seconds of simplification alone.
    pub simplify_seconds: f64,
    /// CPU seconds of simplification alone.
    pub simplify_cpu_seconds: f64,
}

/// Bytes at the peak of an in-core build for each vertex and for each triangle: the collapse engine's (see `simplify`),
/// with the canonical mesh and the history beside it. Measured on ten meshes, it is 5 to 15 % less.
const BYTES_PER_VERTEX: u64 = 140;
const BYTES_PER_TRIANGLE: u64 = 56;
/// What the priority queue of [`Strategy::Btree`] takes more, for each triangle: several entries for each edge.
const QUEUE_BYTES_PER_TRIANGLE: u64 = 60;
/// Tables that do not depend on the size.
const FIXED_BYTES: u64 = 1 << 20;

/// Bytes that building the tree of a mesh in core takes, for files that hold this much.
pub fn needs(counts: FileCounts, strategy: Strategy) -> ByteSize {
    // A soup of triangles has three vertices for each facet, of which a sixth is left after welding.
    let vertices = counts.vertices.min(counts.triangles.saturating_mul(3) / 4 + 4);
    let per_triangle = match strategy {
        Strategy::Passes => BYTES_PER_TRIANGLE,
        Strategy::Btree => BYTES_PER_TRIANGLE + QUEUE_BYTES_PER_TRIANGLE,
    };
    let engine =
        vertices.saturating_mul(BYTES_PER_VERTEX).saturating_add(counts.triangles.saturating_mul(per_triangle));
    ByteSize(engine.max(ingest::reading_needs(counts).0).saturating_add(FIXED_BYTES))
}

/// Builds the view-dependence tree of the mesh in `paths` (several files are one mesh).
///
/// # Errors
///
/// Those of reading the files, [`MeshError::OverMemory`] where the mesh does not fit.
pub fn build(
    disk: &dyn Disk,
    paths: &[PathBuf],
    options: &BuildOptions,
    progress: &mut dyn FnMut(Phase, f64),
) -> Result<(Tree, BuildReport), MeshError> {
    progress(Phase::Reading, 0.0);
    let (mesh, files) = ingest::load(disk, paths, options.memory, &|counts| needs(counts, options.strategy))?;
    progress(Phase::Simplifying, 0.0);
    let (start, cpu_start) = (Instant::now(), storage::usage::cpu_time());
    let history = simplify::simplify(&mesh, options.metric, options.strategy, &mut |share| {
        progress(Phase::Simplifying, share);
    });
    let report = BuildReport {
        files,
        cleaning: mesh.cleaning,
        rounds: history.rounds,
        legal_collapses: history.legal as u64,
        end_phase_collapses: (history.collapses.len() - history.legal) as u64,
        simplify_seconds: start.elapsed().as_secs_f64(),
        simplify_cpu_seconds: (storage::usage::cpu_time() - cpu_start).as_secs_f64(),
    };
    progress(Phase::Finishing, 0.0);
    Ok((finish(mesh, history), report))
}
