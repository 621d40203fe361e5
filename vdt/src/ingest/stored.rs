//! The canonical mesh of files of any size, in spatial blocks, within a memory limit.
//!
//! 1. The files are read once, into sequences of vertices and triangles (module `files`).
//! 2. The box of the named vertices gives the frame, with the lattice that positions are rounded to, if any (`lattice`); the
//!    vertices are sorted and welded (`weld`).
//! 3. The triangles get canonical ids for their corners, a window of the ids in RAM at a time (`corners`), and are
//!    sorted; degenerate ones are dropped on the way into the sort, duplicates on the way out (`triangles`). How far the
//!    dropped ones reach is looked up afterwards (`segments`).
//! 4. Blocks were chosen while the vertices passed, seams are found while the triangles do (`blocks`, `seams`).
//!
//! Memory: [`IngestPlan::memory`], shared out as module `limits` says; what fits never touches the disk. I/O with
//! everything on disk, for V vertices and T triangles in the files, in single precision, where faces lie near their
//! vertices: the files, and 84 V + 60 T bytes in scratch files, 16 V more where the ids do not fit either; with V = T/2
//! that is 102 to 110 bytes a triangle. At the peak there are 44 V + 12 T bytes on disk, 34 a triangle. Vertices and faces
//! in no order cost 24 T bytes for each window of ids after the first. CPU, measured on a terrain of 16 M triangles in a
//! binary PLY within 256 MB, a triangle: 40 ns for reading, 60 for welding, 85 for corners, 27 for the rest.

use std::path::PathBuf;

use storage::{Disk, Scratch, Sorted, Sorter, Spool, StorageError};

use super::corners::{Chunk, ResolveLimits, resolve};
use super::files::{self, FileList, FilesRead};
use super::frame::{Bounds, Frame, Grid};
use super::gaps::{closed_ids, used_vertices};
use super::lattice::{OwnLattice, choose};
use super::limits::{Kept, Limits, smallest_memory};
use super::marks::Marks;
use super::progress::Progress;
use super::seams::Tiling;
use super::segments::{Segment, reach};
use super::triangles::{Corners, Ordered, order};
use super::vertices::VertexSpool;
use super::weld::{LatticeRecord, VertexRecord, Welded, weld};
use super::{CleaningCounts, FileCounts, IngestPlan, PositionsRule, StoredMesh};
use crate::mesh::MeshError;
use crate::tree::Positions;
use crate::vector::length_not_below;

/// Brings the mesh in `paths` (several files are one mesh) into canonical form and into blocks.
///
/// The mesh is exactly that of [`super::canonical`], whatever the memory. The stores of the result hold at most half of
/// [`IngestPlan::memory`]. `progress` is told the share of the work that is done, from 0 to 1.
///
/// # Errors
///
/// Those of [`crate::mesh::read_mesh`] and of the scratch disk; [`MeshError::TooMany`] above 2^32 - 2 vertices or
/// triangles; [`MeshError::Malformed`] for coordinates beyond single precision; [`MeshError::Lattice`] where there cannot be
/// the lattice that is asked for; [`MeshError::OverMemory`] below [`smallest_memory`].
pub fn store(
    disk: &dyn Disk,
    scratch: &Scratch,
    paths: &[PathBuf],
    plan: &IngestPlan,
    progress: &mut dyn FnMut(f64),
) -> Result<StoredMesh, MeshError> {
    let limits = Limits::of(plan);
    let mut progress = Progress::new(progress);
    progress.phase(0.3);
    let files = files::read(disk, scratch, paths, &limits, &mut progress)?;
    let FileCounts { vertices, triangles } = files.counts;
    let needed = smallest_memory(files.counts, plan.block_triangles);
    if needed > plan.memory {
        let path = paths.first().cloned().unwrap_or_default();
        let advice = needed.as_argument();
        return Err(MeshError::OverMemory { path, vertices, triangles, needed, limit: plan.memory, advice });
    }
    in_blocks(files, plan.positions, scratch, &limits, &mut progress)
}

/// All that follows the reading.
pub(super) fn in_blocks(
    files: FilesRead,
    rule: PositionsRule,
    scratch: &Scratch,
    limits: &Limits,
    progress: &mut Progress<'_>,
) -> Result<StoredMesh, MeshError> {
    let FilesRead { list, counts, mut cleaning, vertices, triangles, bounds, named } = files;
    cleaning.isolated_vertices += named.unmarked;
    let bounds = if named.unmarked == 0 { bounds } else { bounds_of(&vertices, &named, limits)? };
    let single = Frame::single(&bounds);
    let local_bounds = single.local_bounds(&bounds);
    if named.marked > 0 && !local_bounds.iter().flatten().all(|value| value.is_finite()) {
        return Err(first_too_large(&vertices, &named, &single, &list, limits)?);
    }
    let is_empty = named.marked == 0 || local_bounds[0] == local_bounds[1];
    let own_step = if is_empty { 0.0 } else { own_step(&vertices, &named, &single, limits)? };
    let rule = if is_empty { PositionsRule::LOSSLESS } else { rule };
    let choice = choose(rule, single, own_step, &bounds, counts.triangles)
        .map_err(|bits| list.no_lattice(bits, bounds.largest_extent()))?;
    let (origin, local_bounds) = (choice.frame.origin, choice.frame.local_bounds(&bounds));
    let [minimum, maximum] = local_bounds.map(|corner| corner.map(f64::from));
    let Some(grid) = Grid::of(&Bounds { minimum, maximum }) else {
        // No triangle has three different corners.
        cleaning.degenerate_triangles += counts.triangles;
        cleaning.isolated_vertices += named.marked;
        return Ok(empty(counts, cleaning));
    };

    progress.phase(0.3);
    let triangles_ram = Chunk::ram(&triangles);
    let frame = &choice.frame;
    let weld = if frame.is_on_lattice() { weld::<LatticeRecord> } else { weld::<VertexRecord> };
    let Welded { positions, ids, twins, ids_ram, welded, fallen, rounding, blocks } =
        weld(vertices, named, counts.vertices, frame, &single, &grid, scratch, limits, triangles_ram, progress)?;
    cleaning.welded_vertices += welded;
    cleaning.fallen_vertices += fallen;

    progress.phase(0.15);
    let mut ids = twins.ids(ids, limits.buffer());
    let left = limits.left(&[triangles_ram, positions.ram, ids_ram]);
    let keeps_points = frame.is_on_lattice();
    let sorting = sort_corners(triangles, counts, || ids.next(), keeps_points, scratch, limits, left, progress)?;
    drop(ids);
    drop(twins);
    cleaning.degenerate_triangles += sorting.degenerate;

    progress.phase(0.25);
    let vertices = positions.spool.len() as u32;
    let left = limits.left(&[positions.ram, sorting.ram, sorting.segments_ram]);
    let mark_used = sorting.degenerate > 0;
    let ordered = order(sorting.sorted, &blocks, vertices, mark_used, scratch, limits, left, progress)?;
    cleaning.duplicate_triangles += ordered.duplicates;
    let used_ram = ordered.used.as_ref().map_or(0, Marks::ram);
    let share = limits.left(&[positions.ram, ordered.triangles.ram, used_ram, sorting.segments_ram]) / 4;
    let staying = ordered.used.as_ref().filter(|_| frame.is_on_lattice());
    let lost = reach(sorting.segments, &ordered.triangles.spool, &positions.spool, staying, share, limits.buffer())?;
    let mut mesh = StoredMesh {
        bounds: local_bounds,
        origin,
        exponent: grid.exponent,
        kept_as: choice.positions,
        lattice_step: choice.step,
        cleaning,
        input_error: length_not_below(rounding.largest + lost),
        files: counts,
        ..empty(counts, cleaning)
    };
    match ordered {
        Ordered { used: Some(used), triangles, .. } if used.unmarked > 0 => {
            mesh.cleaning.isolated_vertices += used.unmarked;
            close_gaps(&mut mesh, positions, triangles, &used, &grid, scratch, limits, progress)?;
        }
        Ordered { triangles, tiling, .. } => fill(&mut mesh, positions, triangles, tiling),
    }
    progress.set(1.0);
    Ok(mesh)
}

fn fill(mesh: &mut StoredMesh, positions: Kept<[f32; 3]>, triangles: Kept<[u32; 3]>, tiling: Tiling) {
    mesh.positions = positions.spool;
    mesh.triangles = triangles.spool;
    mesh.blocks = tiling.blocks;
    mesh.seam_vertices = tiling.seam_vertices;
}

/// Fills in the mesh without the vertices that only degenerate triangles used.
#[expect(clippy::too_many_arguments, reason = "the state of the pipeline")]
fn close_gaps(
    mesh: &mut StoredMesh,
    positions: Kept<[f32; 3]>,
    triangles: Kept<[u32; 3]>,
    used: &Marks,
    grid: &Grid,
    scratch: &Scratch,
    limits: &Limits,
    progress: &mut Progress<'_>,
) -> Result<(), MeshError> {
    let left = limits.left(&[positions.ram, triangles.ram, used.ram()]);
    let share = (left / 4).min(limits.memory / 8);
    let kept = used_vertices(&positions.spool, used, grid, scratch, limits, share)?;
    drop(positions);
    mesh.bounds = kept.bounds_in_single_precision();

    let left = limits.left(&[kept.positions.ram, triangles.ram, used.ram()]);
    let counts = FileCounts { vertices: used.marked + used.unmarked, triangles: triangles.spool.len() };
    let chunks = Chunk::of_ordered(triangles, limits.triangle_chunk)?;
    let sorting =
        sort_corners(chunks, counts, closed_ids(used, limits.buffer()), false, scratch, limits, left, progress)?;
    let left = limits.left(&[kept.positions.ram, used.ram(), sorting.ram, sorting.segments_ram]);
    let vertices = used.marked as u32;
    let ordered = order(sorting.sorted, &kept.blocks, vertices, false, scratch, limits, left, progress)?;
    fill(mesh, kept.positions, ordered.triangles, ordered.tiling);
    Ok(())
}

/// Triangles on their way into canonical order.
struct Sorting {
    sorted: Sorted<Corners>,
    /// Bytes of RAM that the sort may hold.
    ram: usize,
    /// Triangles with two equal corners.
    degenerate: u64,
    /// Those of them that are not points, or all.
    segments: Sorted<Segment>,
    /// Bytes of RAM that these may hold.
    segments_ram: usize,
}

/// Gives triangles the ids of their corners, one by one from `next_id`, and sorts them. `left` are the bytes of RAM to
/// share, `counts` are the vertices that have ids and the triangles. Triangles with three equal corners are kept among the
/// segments with `keeps_points`.
#[expect(clippy::too_many_arguments, reason = "the state of the pipeline")]
fn sort_corners(
    chunks: Vec<Chunk>,
    counts: FileCounts,
    next_id: impl FnMut() -> Result<Option<u32>, StorageError>,
    keeps_points: bool,
    scratch: &Scratch,
    limits: &Limits,
    left: usize,
    progress: &mut Progress<'_>,
) -> Result<Sorting, StorageError> {
    let all_ids = usize::try_from(counts.vertices.saturating_mul(4)).unwrap_or(usize::MAX);
    let window = all_ids.min(left / 8 * 3);
    let rest = left - window;
    let (ram, segments_ram) = (rest / 8 * 5, rest / 16);
    let mut sorter = Sorter::new(scratch, "triangles-by-corners", ram, limits.threads);
    let mut segments = Sorter::new(scratch, "triangles-without-area", segments_ram, 1);
    let (mut degenerate, mut taken) = (0, 0);
    let resolve_limits = ResolveLimits { window, waiting: rest / 16, chunk_triangles: limits.triangle_chunk };
    resolve(chunks, next_id, scratch, &resolve_limits, |corners| {
        taken += 1;
        progress.count(taken, counts.triangles);
        match Corners::of(corners) {
            Some(corners) => sorter.push(corners),
            None => {
                degenerate += 1;
                let segment = Segment::of(corners);
                if keeps_points || !segment.is_point() { segments.push(segment) } else { Ok(()) }
            }
        }
    })?;
    Ok(Sorting { sorted: sorter.finish()?, ram, degenerate, segments: segments.finish()?, segments_ram })
}

/// The box of the vertices that faces name.
fn bounds_of(vertices: &VertexSpool, named: &Marks, limits: &Limits) -> Result<Bounds, StorageError> {
    let mut bounds = Bounds::EMPTY;
    let mut marks = named.reader(limits.buffer());
    vertices.for_each(limits.buffer(), |position| {
        if marks.next()? {
            bounds.include(position);
        }
        Ok::<_, StorageError>(())
    })?;
    Ok(bounds)
}

/// The step of the lattice that the vertices which faces name are on in this frame; 0 where there is none.
fn own_step(vertices: &VertexSpool, named: &Marks, frame: &Frame, limits: &Limits) -> Result<f32, StorageError> {
    let mut own = OwnLattice::EMPTY;
    let mut marks = named.reader(limits.buffer());
    let seen = vertices.for_each(limits.buffer(), |position| {
        let is_named = marks.next()?;
        if is_named && !own.include(frame.local(position)) { Err(Stopped::NoLattice) } else { Ok(()) }
    });
    match seen {
        Ok(()) | Err(Stopped::NoLattice) => Ok(own.step()),
        Err(Stopped::Storage(error)) => Err(error),
    }
}

/// Why vertices were looked at no further.
enum Stopped {
    /// It is known that there is no lattice.
    NoLattice,
    /// The scratch failed.
    Storage(StorageError),
}

impl From<StorageError> for Stopped {
    fn from(error: StorageError) -> Self {
        Stopped::Storage(error)
    }
}

/// The error that names the first vertex beyond single precision, of those that faces name.
fn first_too_large(
    vertices: &VertexSpool,
    named: &Marks,
    frame: &Frame,
    list: &FileList,
    limits: &Limits,
) -> Result<MeshError, StorageError> {
    let (mut number, mut first) = (0, None);
    let mut marks = named.reader(limits.buffer());
    vertices.for_each(limits.buffer(), |position| {
        if marks.next()? && first.is_none() && !frame.local(position).iter().all(|value| value.is_finite()) {
            first = Some(number);
        }
        number += 1;
        Ok::<_, StorageError>(())
    })?;
    Ok(list.too_large(first.unwrap_or(number)))
}

/// A mesh without a triangle.
fn empty(files: FileCounts, cleaning: CleaningCounts) -> StoredMesh {
    StoredMesh {
        positions: Spool::from_vec(Vec::new()),
        triangles: Spool::from_vec(Vec::new()),
        blocks: Vec::new(),
        seam_vertices: Spool::from_vec(Vec::new()),
        bounds: [[0.0; 3]; 2],
        origin: [0.0; 3],
        exponent: 0,
        kept_as: Positions::Lossless,
        lattice_step: 0.0,
        cleaning,
        input_error: 0.0,
        files,
    }
}
