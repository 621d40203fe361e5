//! From the file's vertices and triangles to the canonical mesh that everything later works on.
//!
//! What comes out depends on the set of triangles over positions only: not on the file's format, nor on the order of
//! its vertices and triangles (invariant 2 of the design). In this order:
//!
//! 1. *Local origin.* Where the box of the mesh lies so far from zero, on some axis, that single precision would lose
//!    detail, a point of it is subtracted on that axis. The origin is a multiple of a power of two as large as the box,
//!    so for coordinates that were single precision to begin with the subtraction is exact.
//! 2. *Single precision*, the same for every format; -0.0 becomes 0.0.
//! 3. *Welding.* Bitwise equal positions are one vertex, nothing else is.
//! 4. *Canonical ids.* Vertices by Morton code in the box of the mesh, then by position; triangles by their corners'
//!    ids, rotated so that the smallest comes first.
//! 5. *Cleaning*, each kind counted: triangles with two equal corners, triangles that are there twice with the same
//!    orientation, vertices that no triangle uses.
//! 6. *Normalisation* by a power of two, [`CoreMesh::exponent`]: exact, so that a mesh scaled by 1024 gives the same
//!    tree bit by bit. No absolute tolerance is used anywhere.
//!
//! Memory: 24 bytes for each vertex and 12 for each triangle of the file while it is read, 20 more for each vertex
//! while it is sorted; [`crate::build::needs`] adds it up.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use storage::{ByteSize, Disk};

use crate::mesh::{MeshError, ReadSummary, TriangleSink, read_mesh};

/// What was changed on the way in. None of it changes the surface; all of it is told to the user.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CleaningCounts {
    /// Vertices that had the position of another one, and became one with it.
    pub welded_vertices: u64,
    /// Vertices that no triangle uses: left out.
    pub isolated_vertices: u64,
    /// Triangles with two corners at the same position: left out, they have no area.
    pub degenerate_triangles: u64,
    /// Triangles that were there before with the same corners and orientation: left out.
    pub duplicate_triangles: u64,
    /// Faces of fewer than three corners: left out.
    pub degenerate_faces: u64,
    /// Polygons of more than three corners: cut into triangles.
    pub polygons: u64,
    /// Points, lines and curves: left out, they are no part of a surface.
    pub skipped_elements: u64,
}

/// A mesh in RAM, in canonical form.
#[derive(Debug, Clone, Default)]
pub struct CoreMesh {
    /// Positions by canonical id, in mesh units, relative to `origin`.
    pub positions: Vec<[f32; 3]>,
    /// Triangles in canonical order: three vertex ids in the file's orientation, the smallest first.
    pub triangles: Vec<[u32; 3]>,
    /// What to add to a position to get the file's coordinates back.
    pub origin: [f64; 3],
    /// The mesh is at most 2^exponent wide along every axis; dividing by that normalises it.
    pub exponent: i32,
    /// What was changed on the way in.
    pub cleaning: CleaningCounts,
}

/// What one or several mesh files held.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FileCounts {
    /// Vertices in the files.
    pub vertices: u64,
    /// Triangles in the files, after polygons were cut.
    pub triangles: u64,
}

/// Reads mesh files into RAM as one mesh, in canonical form.
///
/// `needs` says how much memory a mesh of a given size takes for whatever is to be done with it.
///
/// # Errors
///
/// Those of [`read_mesh`]; [`MeshError::OverMemory`] with the number needed where the mesh does not fit in `memory`:
/// then the rest of the files was still counted, but not kept.
pub fn load(
    disk: &dyn Disk,
    paths: &[PathBuf],
    memory: ByteSize,
    needs: &dyn Fn(FileCounts) -> ByteSize,
) -> Result<(CoreMesh, FileCounts), MeshError> {
    let mut loader = Loader::new(Some(memory), needs);
    for path in paths {
        loader.read(disk, path)?;
    }
    loader.finish(paths)
}

/// Bytes that reading a mesh into canonical form takes at the peak.
pub fn reading_needs(counts: FileCounts) -> ByteSize {
    ByteSize(counts.vertices.saturating_mul(64).saturating_add(counts.triangles.saturating_mul(12)))
}

/// Counts what mesh files hold, without keeping any of it.
pub fn count(disk: &dyn Disk, paths: &[PathBuf]) -> Result<FileCounts, MeshError> {
    let mut loader = Loader::new(None, &reading_needs);
    for path in paths {
        loader.read(disk, path)?;
    }
    Ok(loader.counts)
}

/// Keeps what is read as long as it fits; counts it in any case.
struct Loader<'a> {
    /// What the mesh may take; nothing is kept without it.
    memory: Option<ByteSize>,
    needs: &'a dyn Fn(FileCounts) -> ByteSize,
    counts: FileCounts,
    /// Where the vertices of the file being read begin.
    first_vertex: u64,
    keeping: bool,
    positions: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    cleaning: CleaningCounts,
}

impl<'a> Loader<'a> {
    fn new(memory: Option<ByteSize>, needs: &'a dyn Fn(FileCounts) -> ByteSize) -> Self {
        Loader {
            memory,
            needs,
            counts: FileCounts::default(),
            first_vertex: 0,
            keeping: memory.is_some(),
            positions: Vec::new(),
            triangles: Vec::new(),
            cleaning: CleaningCounts::default(),
        }
    }

    fn read(&mut self, disk: &dyn Disk, path: &Path) -> Result<(), MeshError> {
        self.first_vertex = self.counts.vertices;
        let ReadSummary { polygons, degenerate_faces, left_out, .. } = read_mesh(disk, path, self)?;
        self.cleaning.polygons += polygons;
        self.cleaning.degenerate_faces += degenerate_faces;
        self.cleaning.skipped_elements += left_out;
        Ok(())
    }

    /// Whether this many elements fit; once they do not, what was kept is let go.
    fn fits(&mut self, counts: FileCounts) -> bool {
        self.keeping = self.keeping && self.memory.is_some_and(|memory| (self.needs)(counts) <= memory);
        if !self.keeping {
            self.positions = Vec::new();
            self.triangles = Vec::new();
        }
        self.keeping
    }

    fn finish(mut self, paths: &[PathBuf]) -> Result<(CoreMesh, FileCounts), MeshError> {
        if !self.fits(self.counts) {
            return Err(over_memory(paths, self.counts, (self.needs)(self.counts), self.memory.unwrap_or(ByteSize(0))));
        }
        let mesh = canonical(std::mem::take(&mut self.positions), std::mem::take(&mut self.triangles), self.cleaning)
            .map_err(|index| {
            let path = paths.first().cloned().unwrap_or_default();
            MeshError::malformed(&path, format!("vertex {index}"), "the coordinates are too large for single precision")
        })?;
        // Only now is it known how many vertices a soup really has.
        let counts = FileCounts { vertices: mesh.positions.len() as u64, triangles: mesh.triangles.len() as u64 };
        if !self.fits(counts) {
            return Err(over_memory(paths, counts, (self.needs)(counts), self.memory.unwrap_or(ByteSize(0))));
        }
        Ok((mesh, self.counts))
    }
}

fn over_memory(paths: &[PathBuf], counts: FileCounts, needed: ByteSize, limit: ByteSize) -> MeshError {
    MeshError::OverMemory {
        path: paths.first().cloned().unwrap_or_default(),
        vertices: counts.vertices,
        triangles: counts.triangles,
        needed,
        limit,
        advice: needed.as_argument(),
    }
}

impl TriangleSink for Loader<'_> {
    fn announce(&mut self, vertices: u64, faces: u64) -> Result<(), MeshError> {
        let FileCounts { vertices: old_vertices, triangles: old_faces } = self.counts;
        let promised =
            FileCounts { vertices: old_vertices.saturating_add(vertices), triangles: old_faces.saturating_add(faces) };
        if self.fits(promised) {
            // A header is only a promise: what it does not hold is not paid for.
            self.positions.reserve_exact(vertices.min(1 << 24) as usize);
            self.triangles.reserve_exact(faces.min(1 << 24) as usize);
        }
        Ok(())
    }

    fn vertex(&mut self, position: [f64; 3]) -> Result<(), MeshError> {
        self.counts.vertices += 1;
        // Asked often enough that growth stays within the budget, seldom enough to cost nothing.
        if self.counts.vertices.is_multiple_of(4096) {
            self.fits(self.counts);
        }
        if self.keeping {
            self.positions.push(position);
        }
        Ok(())
    }

    fn triangle(&mut self, corners: [u64; 3]) -> Result<(), MeshError> {
        self.counts.triangles += 1;
        if self.counts.triangles.is_multiple_of(4096) {
            self.fits(self.counts);
        }
        if self.keeping {
            // What fits in RAM is far below 2^32 vertices; a corner that is not, is refused by the reader's gate.
            let corner = |index: u64| u32::try_from(index.saturating_add(self.first_vertex)).unwrap_or(u32::MAX);
            self.triangles.push(corners.map(corner));
        }
        Ok(())
    }
}

/// The smallest power of two that is at least `extent`, as an exponent. `extent` is positive and finite.
fn exponent_above(extent: f64) -> i32 {
    // The exponent field of a normal f64: below it lie the powers of two that are too small.
    let bits = extent.to_bits();
    let floor = ((bits >> 52) as i32) - 1023;
    floor + i32::from(bits & ((1 << 52) - 1) != 0)
}

/// 2^exponent, exactly. Out of f64's range it is 0 or infinite.
pub(crate) fn power_of_two(exponent: i32) -> f64 {
    match exponent {
        -1022..=1023 => f64::from_bits(((exponent + 1023) as u64) << 52),
        ..-1022 => power_of_two(exponent + 512) * power_of_two(-512),
        1024.. => f64::INFINITY,
    }
}

/// A box that grows.
#[derive(Clone, Copy)]
struct Bounds {
    minimum: [f64; 3],
    maximum: [f64; 3],
}

impl Bounds {
    fn of(positions: impl Iterator<Item = [f64; 3]>) -> Self {
        let mut bounds = Bounds { minimum: [f64::INFINITY; 3], maximum: [f64::NEG_INFINITY; 3] };
        for position in positions {
            for axis in 0..3 {
                bounds.minimum[axis] = bounds.minimum[axis].min(position[axis]);
                bounds.maximum[axis] = bounds.maximum[axis].max(position[axis]);
            }
        }
        bounds
    }

    fn largest_extent(&self) -> f64 {
        (0..3).map(|axis| self.maximum[axis] - self.minimum[axis]).fold(0.0, f64::max)
    }
}

/// How many times the extent of the mesh its box may lie from zero before an origin is subtracted. Up to here single
/// precision loses at most three of its 24 bits; from here on the subtraction is exact for single-precision input.
const FAR_FROM_ZERO: f64 = 8.0;

fn local_origin(bounds: &Bounds) -> [f64; 3] {
    let extent = bounds.largest_extent();
    if !(extent > 0.0 && extent.is_finite()) {
        return [0.0; 3];
    }
    let step = power_of_two(exponent_above(extent));
    std::array::from_fn(|axis| {
        let (minimum, maximum) = (bounds.minimum[axis], bounds.maximum[axis]);
        if minimum.abs().max(maximum.abs()) <= FAR_FROM_ZERO * extent {
            0.0
        } else {
            ((minimum + (maximum - minimum) * 0.5) / step).round() * step
        }
    })
}

/// Spreads the low 21 bits of `value` to every third bit.
fn spread(value: u64) -> u64 {
    let mut bits = value & 0x1f_ffff;
    bits = (bits | bits << 32) & 0x001f_0000_0000_ffff;
    bits = (bits | bits << 16) & 0x001f_0000_ff00_00ff;
    bits = (bits | bits << 8) & 0x100f_00f0_0f00_f00f;
    bits = (bits | bits << 4) & 0x10c3_0c30_c30c_30c3;
    (bits | bits << 2) & 0x1249_2492_4924_9249
}

/// Morton code of 3 x 21 bits in a cube of edge 2^exponent whose lowest corner is `minimum`.
fn morton(position: [f32; 3], minimum: [f64; 3], cells_per_unit: f64) -> u64 {
    let cell = |axis: usize| (((f64::from(position[axis]) - minimum[axis]) * cells_per_unit) as u64).min(0x1f_ffff);
    spread(cell(0)) | spread(cell(1)) << 1 | spread(cell(2)) << 2
}

fn compare_positions(left: &[f32; 3], right: &[f32; 3]) -> Ordering {
    let axis = |axis: usize| left[axis].total_cmp(&right[axis]);
    axis(0).then_with(|| axis(1)).then_with(|| axis(2))
}

/// Brings a mesh as read into canonical form. `triangles` name vertices that exist. The error is the number of a
/// vertex that is too large for single precision.
pub fn canonical(
    positions: Vec<[f64; 3]>,
    mut triangles: Vec<[u32; 3]>,
    mut cleaning: CleaningCounts,
) -> Result<CoreMesh, usize> {
    // Vertices that no face names must not move the box: one format keeps them, another does not.
    let mut named = vec![false; positions.len()];
    triangles.iter().flatten().for_each(|corner| named[*corner as usize] = true);
    let named_positions = positions.iter().zip(&named).filter(|(_, named)| **named).map(|(position, _)| *position);
    let origin = local_origin(&Bounds::of(named_positions));
    let mut local: Vec<[f32; 3]> = Vec::with_capacity(positions.len());
    for (index, position) in positions.iter().enumerate() {
        // Adding 0.0 turns -0.0 into 0.0.
        let single: [f32; 3] = std::array::from_fn(|axis| (position[axis] - origin[axis]) as f32 + 0.0);
        if named[index] && !single.iter().all(|value| value.is_finite()) {
            return Err(index);
        }
        local.push(single);
    }
    drop(positions);

    let bounds =
        Bounds::of(local.iter().zip(&named).filter(|(_, named)| **named).map(|(position, _)| position.map(f64::from)));
    let extent = bounds.largest_extent();
    if extent <= 0.0 {
        // No triangle has three different corners.
        cleaning.degenerate_triangles += triangles.len() as u64;
        cleaning.isolated_vertices += local.len() as u64;
        return Ok(CoreMesh { cleaning, ..CoreMesh::default() });
    }
    let exponent = exponent_above(extent);
    let cells_per_unit = power_of_two(21 - exponent);
    let mut order: Vec<(u64, u32)> = (0..local.len() as u32)
        .filter(|index| named[*index as usize])
        .map(|index| (morton(local[index as usize], bounds.minimum, cells_per_unit), index))
        .collect();
    cleaning.isolated_vertices += (local.len() - order.len()) as u64;
    drop(named);
    order.sort_unstable_by(|left, right| {
        left.0.cmp(&right.0).then_with(|| compare_positions(&local[left.1 as usize], &local[right.1 as usize]))
    });

    // Ids after welding, and their positions.
    let mut renumbered = vec![u32::MAX; local.len()];
    let mut welded: Vec<[f32; 3]> = Vec::with_capacity(order.len());
    for (_, index) in &order {
        let position = local[*index as usize];
        if welded.last() == Some(&position) {
            cleaning.welded_vertices += 1;
        } else {
            welded.push(position);
        }
        renumbered[*index as usize] = welded.len() as u32 - 1;
    }
    drop(order);
    drop(local);

    let before = triangles.len();
    triangles.retain_mut(|corners| {
        let [a, b, c] = corners.map(|corner| renumbered[corner as usize]);
        *corners = if a < b && a < c {
            [a, b, c]
        } else if b < c {
            [b, c, a]
        } else {
            [c, a, b]
        };
        a != b && b != c && c != a
    });
    drop(renumbered);
    cleaning.degenerate_triangles += (before - triangles.len()) as u64;
    triangles.sort_unstable();
    let before = triangles.len();
    triangles.dedup();
    cleaning.duplicate_triangles += (before - triangles.len()) as u64;
    let positions = without_unused(welded, &mut triangles, &mut cleaning);
    triangles.shrink_to_fit();
    Ok(CoreMesh { positions, triangles, origin, exponent, cleaning })
}

/// Drops the vertices that only degenerate triangles used, and closes the gaps in the ids; keeps all orders.
fn without_unused(
    positions: Vec<[f32; 3]>,
    triangles: &mut [[u32; 3]],
    cleaning: &mut CleaningCounts,
) -> Vec<[f32; 3]> {
    let mut used = vec![false; positions.len()];
    triangles.iter().flatten().for_each(|corner| used[*corner as usize] = true);
    if used.iter().all(|used| *used) {
        return positions;
    }
    let mut kept = Vec::with_capacity(positions.len());
    let mut renumbered = vec![u32::MAX; positions.len()];
    for (index, position) in positions.iter().enumerate() {
        if used[index] {
            renumbered[index] = kept.len() as u32;
            kept.push(*position);
        }
    }
    cleaning.isolated_vertices += (positions.len() - kept.len()) as u64;
    triangles.iter_mut().flatten().for_each(|corner| *corner = renumbered[*corner as usize]);
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn make(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> CoreMesh {
        canonical(positions.to_vec(), triangles.to_vec(), CleaningCounts::default()).unwrap()
    }

    const SQUARE: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];

    #[test]
    fn the_order_of_the_file_does_not_matter() {
        let mesh = make(&SQUARE, &[[0, 1, 2], [0, 2, 3]]);
        let shuffled = [SQUARE[2], SQUARE[0], SQUARE[3], SQUARE[1]];
        let same = make(&shuffled, &[[2, 1, 0], [3, 0, 1]]);
        assert_eq!(mesh.positions, same.positions);
        assert_eq!(mesh.triangles, same.triangles);
    }

    #[test]
    fn a_soup_is_welded_and_minus_zero_is_zero() {
        let soup = [SQUARE[0], SQUARE[1], SQUARE[2], [-0.0, 0.0, -0.0], SQUARE[2], SQUARE[3]];
        let mesh = make(&soup, &[[0, 1, 2], [3, 4, 5]]);
        assert_eq!(mesh.positions.len(), 4);
        assert_eq!(mesh.cleaning.welded_vertices, 2);
        assert_eq!(mesh.triangles, make(&SQUARE, &[[0, 1, 2], [0, 2, 3]]).triangles);
    }

    #[test]
    fn cleaning_is_counted() {
        let mut positions = SQUARE.to_vec();
        positions.extend([[5.0, 5.0, 5.0], [0.5, 0.5, 0.5]]);
        // A duplicate (rotated), its mirror image (kept), a degenerate one that alone uses vertex 5, and vertex 4 unused.
        let mesh = make(&positions, &[[0, 1, 2], [1, 2, 0], [0, 2, 1], [5, 5, 0]]);
        assert_eq!(mesh.triangles.len(), 2);
        assert_eq!(mesh.positions.len(), 3);
        let expected = CleaningCounts {
            isolated_vertices: 3,
            duplicate_triangles: 1,
            degenerate_triangles: 1,
            ..CleaningCounts::default()
        };
        assert_eq!(mesh.cleaning, expected);
    }

    #[test]
    fn far_from_zero_an_origin_keeps_the_detail_of_doubles() {
        let moved: Vec<[f64; 3]> =
            SQUARE.iter().map(|p| [p[0] * 1e-3 + 4e5 + 0.1, p[1] * 1e-3 + 5e6 + 0.2, p[2]]).collect();
        let mesh = make(&moved, &[[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions.len(), 4);
        assert_eq!(mesh.origin[2], 0.0);
        for position in &mesh.positions {
            let back: [f64; 3] = std::array::from_fn(|axis| f64::from(position[axis]) + mesh.origin[axis]);
            assert!(moved.iter().any(|original| (0..3).all(|axis| (original[axis] - back[axis]).abs() < 1e-9)));
        }
    }

    #[test]
    fn far_from_zero_single_precision_survives_exactly() {
        let moved: Vec<[f64; 3]> =
            SQUARE.iter().map(|p| [0, 1, 2].map(|axis| f64::from((p[axis] * 0.37 + 1234.5678) as f32))).collect();
        let mesh = make(&moved, &[[0, 1, 2], [0, 2, 3]]);
        assert_ne!(mesh.origin, [0.0; 3]);
        let mut back: Vec<_> = mesh
            .positions
            .iter()
            .map(|p| [0, 1, 2].map(|axis| (f64::from(p[axis]) + mesh.origin[axis]) as f32))
            .collect();
        let mut expected: Vec<_> = moved.iter().map(|p| p.map(|value| value as f32)).collect();
        back.sort_by(compare_positions);
        expected.sort_by(compare_positions);
        assert_eq!(back, expected);
    }

    #[test]
    fn nothing_but_degenerate_triangles_is_an_empty_mesh() {
        let mesh = make(&[[1.0; 3], [1.0; 3], [1.0; 3]], &[[0, 1, 2]]);
        assert!(mesh.triangles.is_empty() && mesh.positions.is_empty());
        assert_eq!(mesh.cleaning.degenerate_triangles, 1);
        assert!(make(&[], &[]).triangles.is_empty());
    }

    #[test]
    fn powers_of_two() {
        for (extent, exponent) in [(1.0, 0), (1.5, 1), (2.0, 1), (0.75, 0), (1e-30, -99), (1e30, 100)] {
            assert_eq!(exponent_above(extent), exponent, "{extent}");
            assert!(power_of_two(exponent) >= extent && power_of_two(exponent - 1) < extent);
        }
    }
}
