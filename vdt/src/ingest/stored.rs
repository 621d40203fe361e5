//! The canonical mesh of files of any size, in spatial blocks, within a memory limit.
//!
//! 1. The files are read once, into sequences of vertices and triangles (module `files`).
//! 2. The box of the named vertices gives the frame, with the lattice that positions are rounded to, if any (`lattice`); the
//!    vertices are sorted and welded (`weld`).
//! 3. The triangles get canonical ids for their corners, a window of the ids in RAM at a time (`corners`), and are
//!    sorted; degenerate ones are dropped on the way into the sort, duplicates on the way out (`triangles`). How far the
//!    dropped ones reach is looked up afterwards (`segments`).
//! 4. Attributes enter with the vertices, or with the corners where these have some of their own (`entering`); equal ones at a
//!    vertex are one wedge (`wedges`), and corners go by the numbers of wedges until the triangles are in order.
//! 5. Blocks were chosen while the vertices passed, seams are found while the triangles do (`blocks`, `seams`).
//!
//! Memory: [`IngestPlan::memory`], shared out as module `limits` says; what fits never touches the disk. I/O with
//! everything on disk, for V vertices and T triangles in the files, in single precision, where faces lie near their
//! vertices: the files, and 84 V + 60 T bytes in scratch files, 16 V more where the ids do not fit either; with V = T/2
//! that is 102 to 110 bytes a triangle. At the peak there are 44 V + 12 T bytes on disk, 34 a triangle. Vertices and faces
//! in no order cost 24 T bytes for each window of ids after the first. CPU, measured on a terrain of 16 M triangles in a
//! binary PLY within 256 MB, a triangle: 40 ns for reading, 60 for welding, 85 for corners, 27 for the rest.

use std::path::PathBuf;

use storage::{Disk, Scattered, Scratch, Sorted, Sorter, Spool, StorageError};

use super::corners::{Chunk, ResolveLimits, resolve};
use super::entering::{Entered, Vertices, weld_all};
use super::files::{self, FileList, FilesRead, MOST_ELEMENTS};
use super::frame::{Bounds, Frame, Grid};
use super::gaps::{closed_ids, used_vertices};
use super::lattice::{OwnLattice, choose};
use super::limits::{Kept, Limits, smallest_memory};
use super::marks::Marks;
use super::progress::Progress;
use super::seams::Tiling;
use super::segments::{Segment, reach};
use super::triangles::{Corners, Ordered, SortedTriangle, WedgeCorners, order};
use super::twins::Twins;
use super::vertices::VertexSpool;
use super::wedges::{UsedWedges, WeldedWedges};
use super::weld::Welded;
use super::{CleaningCounts, FileCounts, IngestPlan, PositionsRule, StoredMesh};
use crate::mesh::MeshError;
use crate::tree::{MeshAttributes, Positions};
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
    let files = files::read(disk, scratch, paths, plan.attributes, &limits, &mut progress)?;
    let FileCounts { vertices, triangles } = files.counts;
    let needed = smallest_memory(files.counts, files.attributes.is_some(), plan.block_triangles);
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
    let corners = if files.has_corner_attributes() { files.counts.triangles.saturating_mul(3) } else { 0 };
    let FilesRead { list, counts, mut cleaning, vertices, triangles, bounds, named, attributes, missing_files } = files;
    if corners > MOST_ELEMENTS {
        return Err(list.too_many_corners());
    }
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
        return Ok(StoredMesh { missing_files, ..empty(counts, cleaning) });
    };

    progress.phase(0.3);
    let named_vertices = named.marked;
    let frame = &choice.frame;
    let vertices = Vertices { spool: vertices, named, frame, single: &single };
    let Entered { welded, triangles, numbers, appearance } =
        weld_all(vertices, counts.vertices, triangles, attributes, &grid, scratch, limits, progress)?;
    let Welded { positions, wedges, ids, twins, ids_ram, fallen, rounding, blocks } = welded;
    cleaning.fallen_vertices += fallen;
    cleaning.welded_vertices += named_vertices - positions.spool.len() - fallen;

    let wedges_ram = wedges.as_ref().map_or(0, WeldedWedges::ram);
    let left = limits.left(&[Chunk::ram(&triangles), positions.ram, ids_ram, wedges_ram]);
    let vertices_of_wedges = wedges.as_ref().and_then(|wedges| wedges.vertices(left / 16));
    let arranging = Arranging {
        triangles,
        counts: FileCounts { vertices: numbers, ..counts },
        ids,
        twins,
        sorting_ram: left - if vertices_of_wedges.is_some() { left / 16 } else { 0 },
        keeps_points: frame.is_on_lattice(),
        blocks: &blocks,
        vertices: positions.spool.len() as u32,
        ordering_ram: limits.left(&[positions.ram, wedges_ram]),
    };
    let arranged = match vertices_of_wedges {
        None => arrange(arranging, scratch, limits, progress, |corners| Ok((corners, Corners::of(corners))))?,
        Some(mut vertices) => arrange(arranging, scratch, limits, progress, |wedges| {
            let corners = vertices.of_corners(wedges)?;
            Ok((corners, WedgeCorners::of(corners, wedges)))
        })?,
    };
    let Arranged { ordered, degenerate, segments, segments_ram } = arranged;
    let Ordered { triangles, wedges: used_wedges, tiling, duplicates, used } = ordered;
    cleaning.degenerate_triangles += degenerate;
    cleaning.duplicate_triangles += duplicates;
    let used_ram = used.as_ref().map_or(0, Marks::ram) + used_wedges.as_ref().map_or(0, UsedWedges::ram);
    let share = limits.left(&[positions.ram, triangles.ram, used_ram, wedges_ram, segments_ram]) / 4;
    let staying = used.as_ref().filter(|_| frame.is_on_lattice());
    let lost = reach(segments, &triangles.spool, &positions.spool, staying, share, limits.buffer())?;
    let mut mesh = StoredMesh {
        bounds: local_bounds,
        origin,
        exponent: grid.exponent,
        kept_as: choice.positions,
        lattice_step: choice.step,
        cleaning,
        input_error: length_not_below(rounding.largest + lost),
        missing_files,
        ..empty(counts, cleaning)
    };
    let used = used.filter(|used| used.unmarked > 0);
    if let (Some(wedges), Some(appearance)) = (wedges, appearance.filter(|_| !triangles.spool.is_empty())) {
        mesh.attributes = Some(match used_wedges {
            None => wedges.without_seams(appearance, used.as_ref(), scratch, limits)?,
            Some(corners) => {
                let left = limits.left(&[positions.ram, triangles.ram, used_ram, wedges_ram]);
                let (attributes, merged) = wedges.with_seams(appearance, corners, left, scratch, limits)?;
                mesh.cleaning.merged_wedges += merged;
                attributes
            }
        });
    }
    match used {
        Some(used) => {
            mesh.cleaning.isolated_vertices += used.unmarked;
            close_gaps(&mut mesh, positions, triangles, &used, &grid, scratch, limits, progress)?;
        }
        None => fill(&mut mesh, positions, triangles, tiling),
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
    let attributes_ram = mesh.attributes.as_ref().map_or(0, MeshAttributes::ram_bytes);
    let left = limits.left(&[attributes_ram, positions.ram, triangles.ram, used.ram()]);
    let share = (left / 4).min(limits.memory / 8);
    let kept = used_vertices(&positions.spool, used, grid, scratch, limits, share)?;
    drop(positions);
    mesh.bounds = kept.bounds_in_single_precision();

    let left = limits.left(&[attributes_ram, kept.positions.ram, triangles.ram, used.ram()]);
    let counts = FileCounts { vertices: used.marked + used.unmarked, triangles: triangles.spool.len() };
    let chunks = Chunk::of_ordered(triangles, limits.triangle_chunk)?;
    let next_id = closed_ids(used, limits.buffer());
    let sorting = sort_corners(chunks, counts, next_id, false, scratch, limits, left, progress, |corners| {
        Ok((corners, Corners::of(corners)))
    })?;
    let left = limits.left(&[attributes_ram, kept.positions.ram, used.ram(), sorting.ram, sorting.segments_ram]);
    let vertices = used.marked as u32;
    let ordered = order(sorting.sorted, &kept.blocks, vertices, false, scratch, limits, left, progress)?;
    fill(mesh, kept.positions, ordered.triangles, ordered.tiling);
    Ok(())
}

/// What [`arrange`] uses up.
struct Arranging<'a> {
    /// By numbers of what was welded, of which `counts` says how many there are.
    triangles: Vec<Chunk>,
    counts: FileCounts,
    ids: Scattered<u32>,
    twins: Twins,
    /// Bytes of RAM for the sort.
    sorting_ram: usize,
    /// Whether triangles with three equal corners are kept among the segments.
    keeps_points: bool,
    /// The first vertices of the blocks.
    blocks: &'a [u32],
    /// How many vertices there are.
    vertices: u32,
    /// Bytes of RAM for the sort together with what follows it.
    ordering_ram: usize,
}

/// Triangles in canonical order.
struct Arranged {
    ordered: Ordered,
    /// Triangles with two equal corners.
    degenerate: u64,
    /// Those of them that are not points, or all.
    segments: Sorted<Segment>,
    /// Bytes of RAM that these may hold.
    segments_ram: usize,
}

/// Brings triangles into canonical order. `place` tells the vertices of three ids, and the triangle, if it has an area.
fn arrange<T: SortedTriangle>(
    arranging: Arranging<'_>,
    scratch: &Scratch,
    limits: &Limits,
    progress: &mut Progress<'_>,
    place: impl FnMut([u32; 3]) -> Result<([u32; 3], Option<T>), StorageError>,
) -> Result<Arranged, StorageError> {
    let Arranging { triangles, counts, ids, twins, sorting_ram, keeps_points, blocks, vertices, ordering_ram } =
        arranging;
    progress.phase(0.15);
    let mut ids = twins.ids(ids, limits.buffer());
    let next_id = || ids.next();
    let Sorting { sorted, ram, degenerate, segments, segments_ram } =
        sort_corners(triangles, counts, next_id, keeps_points, scratch, limits, sorting_ram, progress, place)?;
    drop(ids);
    drop(twins);

    progress.phase(0.25);
    let left = ordering_ram.saturating_sub(ram).saturating_sub(segments_ram);
    let ordered = order(sorted, blocks, vertices, degenerate > 0, scratch, limits, left, progress)?;
    Ok(Arranged { ordered, degenerate, segments, segments_ram })
}

/// Triangles on their way into canonical order.
struct Sorting<T: SortedTriangle> {
    sorted: Sorted<T>,
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
/// segments with `keeps_points`. `place` tells the vertices of three ids, and the triangle, if it has an area.
#[expect(clippy::too_many_arguments, reason = "the state of the pipeline")]
fn sort_corners<T: SortedTriangle>(
    chunks: Vec<Chunk>,
    counts: FileCounts,
    next_id: impl FnMut() -> Result<Option<u32>, StorageError>,
    keeps_points: bool,
    scratch: &Scratch,
    limits: &Limits,
    left: usize,
    progress: &mut Progress<'_>,
    mut place: impl FnMut([u32; 3]) -> Result<([u32; 3], Option<T>), StorageError>,
) -> Result<Sorting<T>, StorageError> {
    let all_ids = usize::try_from(counts.vertices.saturating_mul(4)).unwrap_or(usize::MAX);
    let window = all_ids.min(left / 8 * 3);
    let rest = left - window;
    let (ram, segments_ram) = (rest / 8 * 5, rest / 16);
    let mut sorter = Sorter::new(scratch, "triangles-by-corners", ram, limits.threads);
    let mut segments = Sorter::new(scratch, "triangles-without-area", segments_ram, 1);
    let (mut degenerate, mut taken) = (0, 0);
    let resolve_limits = ResolveLimits { window, waiting: rest / 16, chunk_triangles: limits.triangle_chunk };
    resolve(chunks, next_id, scratch, &resolve_limits, |ids| {
        taken += 1;
        progress.count(taken, counts.triangles);
        match place(ids)? {
            (_, Some(triangle)) => sorter.push(triangle),
            (corners, None) => {
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
        attributes: None,
        missing_files: Vec::new(),
    }
}
