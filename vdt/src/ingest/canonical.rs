//! The canonical form of a mesh that fits in RAM: the slow obvious way, by which [`super::store`] is judged.
//!
//! Memory: 48 bytes for each vertex and 12 for each triangle of the file; or 56 for each vertex while it is sorted; and
//! where there are triangles without area, a table of all edges. With attributes, 150 bytes more for each triangle.

use std::cmp::Ordering;
use std::collections::HashSet;

use thiserror::Error;

use super::frame::{Bounds, Frame, Grid, Rounding};
use super::lattice::{OwnLattice, choose};
use super::segments::{between, farthest};
use super::{CleaningCounts, CoreAttributes, CoreMesh, PositionsRule};
use crate::tree::{Appearance, CornerPlaces, MOST_WEDGES, Wedge};
use crate::vector::length_not_below;

fn compare_positions(left: &[f32; 3], right: &[f32; 3]) -> Ordering {
    let axis = |axis: usize| left[axis].total_cmp(&right[axis]);
    axis(0).then_with(|| axis(1)).then_with(|| axis(2))
}

/// Why a mesh has no canonical form.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum FrameError {
    /// A vertex is too large for single precision.
    #[error("vertex {vertex}: the coordinates are too large for single precision")]
    TooLarge {
        /// Its number.
        vertex: usize,
    },
    /// There is no lattice of so many bits.
    #[error("there is no lattice of {bits} bits over an axis of length {extent:e}")]
    Lattice {
        /// The bits asked for.
        bits: u8,
        /// How long the longest axis is, in mesh units.
        extent: f64,
    },
}

/// Brings a mesh as read into canonical form, with every position as it is. `triangles` name vertices that exist.
///
/// # Errors
///
/// [`FrameError::TooLarge`].
pub fn canonical(
    positions: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    cleaning: CleaningCounts,
) -> Result<CoreMesh, FrameError> {
    canonical_as(PositionsRule::LOSSLESS, positions, triangles, cleaning)
}

/// Brings a mesh as read into canonical form, with positions kept by this rule. `triangles` name vertices that exist.
///
/// # Errors
///
/// Those of [`FrameError`].
pub fn canonical_as(
    rule: PositionsRule,
    positions: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    cleaning: CleaningCounts,
) -> Result<CoreMesh, FrameError> {
    canonical_with(rule, positions, triangles, None, cleaning)
}

/// What the corners of a mesh as read carry.
#[derive(Debug, Clone, PartialEq)]
pub struct RawAttributes {
    /// What they refer to.
    pub appearance: Appearance,
    /// The attributes of the corners of each triangle.
    pub corners: Vec<[Wedge; 3]>,
}

/// Brings a mesh as read into canonical form, with positions kept by this rule, and with what its corners carry. `triangles`
/// name vertices that exist. An empty mesh has no attributes.
///
/// # Errors
///
/// Those of [`FrameError`].
pub fn canonical_with(
    rule: PositionsRule,
    positions: Vec<[f64; 3]>,
    mut triangles: Vec<[u32; 3]>,
    attributes: Option<RawAttributes>,
    mut cleaning: CleaningCounts,
) -> Result<CoreMesh, FrameError> {
    // Vertices that no face names must not move the box: one format keeps them, another does not.
    let mut named = vec![false; positions.len()];
    triangles.iter().flatten().for_each(|corner| named[*corner as usize] = true);
    let named_positions = positions.iter().zip(&named).filter(|(_, named)| **named).map(|(position, _)| *position);
    let bounds = Bounds::of(named_positions);
    let single = Frame::single(&bounds);
    let mut unrounded: Vec<[f32; 3]> = positions.iter().map(|position| single.local(*position)).collect();
    let mut own = OwnLattice::EMPTY;
    for (vertex, position) in unrounded.iter().enumerate().filter(|(vertex, _)| named[*vertex]) {
        if !position.iter().all(|value| value.is_finite()) {
            return Err(FrameError::TooLarge { vertex });
        }
        own.include(*position);
    }
    let named_locals = |locals: &[[f32; 3]]| {
        Bounds::of(locals.iter().zip(&named).filter(|(_, named)| **named).map(|(position, _)| position.map(f64::from)))
    };
    if Grid::of(&named_locals(&unrounded)).is_none() {
        // No triangle has three different corners.
        cleaning.degenerate_triangles += triangles.len() as u64;
        cleaning.isolated_vertices += unrounded.len() as u64;
        return Ok(CoreMesh { cleaning, ..CoreMesh::default() });
    }
    let choice = choose(rule, single, own.step(), &bounds, triangles.len() as u64)
        .map_err(|bits| FrameError::Lattice { bits, extent: bounds.largest_extent() })?;
    let frame = choice.frame;
    let locals: Vec<[f32; 3]> = positions.iter().map(|position| frame.local(*position)).collect();
    let mut rounding = Rounding::default();
    for vertex in (0..positions.len()).filter(|vertex| named[*vertex]) {
        rounding.include(positions[vertex], &frame, locals[vertex]);
    }
    drop(positions);
    let Some(grid) = Grid::of(&named_locals(&locals)) else { return Ok(CoreMesh { cleaning, ..CoreMesh::default() }) };
    if !frame.is_on_lattice() {
        unrounded = Vec::new();
    }
    let mut order: Vec<(u64, u32)> = (0..locals.len() as u32)
        .filter(|index| named[*index as usize])
        .map(|index| (grid.code(locals[index as usize]), index))
        .collect();
    cleaning.isolated_vertices += (locals.len() - order.len()) as u64;
    drop(named);
    order.sort_unstable_by(|left, right| {
        left.0.cmp(&right.0).then_with(|| compare_positions(&locals[left.1 as usize], &locals[right.1 as usize]))
    });

    // Ids after welding, and their positions.
    let mut renumbered = vec![u32::MAX; locals.len()];
    let mut welded: Vec<[f32; 3]> = Vec::with_capacity(order.len());
    for (_, index) in &order {
        let position = locals[*index as usize];
        if welded.last() == Some(&position) {
            cleaning.welded_vertices += 1;
        } else {
            welded.push(position);
        }
        renumbered[*index as usize] = welded.len() as u32 - 1;
    }
    if frame.is_on_lattice() {
        let bits = |index: u32| unrounded[index as usize].map(f32::to_bits);
        for together in order.chunk_by(|left, right| renumbered[left.1 as usize] == renumbered[right.1 as usize]) {
            let mut places: Vec<_> = together.iter().map(|(_, index)| bits(*index)).collect();
            places.sort_unstable();
            places.dedup();
            cleaning.fallen_vertices += places.len() as u64 - 1;
        }
        cleaning.welded_vertices -= cleaning.fallen_vertices;
    }
    drop((order, locals, unrounded));

    let (appearance, all_wedges) = match attributes {
        Some(RawAttributes { appearance, corners }) => (Some(appearance), corners),
        None => (None, Vec::new()),
    };
    let (before, mut segments) = (triangles.len(), Vec::new());
    let (mut wedges, mut number) = (Vec::new(), 0);
    triangles.retain_mut(|corners| {
        let [a, b, c] = corners.map(|corner| renumbered[corner as usize]);
        let first = if a < b && a < c {
            0
        } else if b < c {
            1
        } else {
            2
        };
        *corners = [a, b, c];
        corners.rotate_left(first);
        let has_area = a != b && b != c && c != a;
        if !has_area {
            segments.push(if a == b { [a, c] } else { [a, b] });
        } else if appearance.is_some() {
            let mut turned = all_wedges[number];
            turned.rotate_left(first);
            wedges.push(turned);
        }
        number += 1;
        has_area
    });
    drop((renumbered, all_wedges));
    cleaning.degenerate_triangles += (before - triangles.len()) as u64;
    let before = triangles.len();
    if appearance.is_some() {
        let mut all: Vec<([u32; 3], [Wedge; 3])> = triangles.into_iter().zip(wedges).collect();
        all.sort_unstable_by_key(|(corners, wedges)| (*corners, wedges.map(|wedge| wedge.order())));
        all.dedup_by_key(|(corners, _)| *corners);
        (triangles, wedges) = all.into_iter().unzip();
    } else {
        triangles.sort_unstable();
        triangles.dedup();
    }
    cleaning.duplicate_triangles += (before - triangles.len()) as u64;
    let lost = reach(&segments, &triangles, &welded, frame.is_on_lattice());
    let positions = without_unused(welded, &mut triangles, &mut cleaning);
    triangles.shrink_to_fit();
    let attributes = appearance.filter(|_| !triangles.is_empty()).map(|appearance| {
        let (wedges, corners) = by_vertex(positions.len(), &triangles, &wedges, &mut cleaning);
        CoreAttributes { appearance, wedges, corners }
    });
    let input_error = length_not_below(rounding.largest + lost);
    Ok(CoreMesh {
        positions,
        triangles,
        origin: frame.origin,
        exponent: grid.exponent,
        kept_as: choice.positions,
        lattice_step: choice.step,
        cleaning,
        input_error,
        attributes,
    })
}

/// The wedges of each vertex, and the places among them of the corners of each triangle.
fn by_vertex(
    vertices: usize,
    triangles: &[[u32; 3]],
    corners: &[[Wedge; 3]],
    cleaning: &mut CleaningCounts,
) -> (Vec<Vec<Wedge>>, Vec<CornerPlaces>) {
    let mut wedges = vec![Vec::new(); vertices];
    for (vertex, wedge) in triangles.iter().flatten().zip(corners.iter().flatten()) {
        wedges[*vertex as usize].push(*wedge);
    }
    for of_vertex in &mut wedges {
        of_vertex.sort_unstable_by_key(Wedge::order);
        of_vertex.dedup();
        cleaning.merged_wedges += of_vertex.len().saturating_sub(MOST_WEDGES) as u64;
        of_vertex.truncate(MOST_WEDGES);
        of_vertex.shrink_to_fit();
    }
    let place = |vertex: u32, wedge: &Wedge| {
        let of_vertex = &wedges[vertex as usize];
        let place = of_vertex.partition_point(|other| other.order() < wedge.order());
        place.min(of_vertex.len() - 1) as u32
    };
    let places = |(vertices, wedges): (&[u32; 3], &[Wedge; 3])| {
        CornerPlaces::of([0, 1, 2].map(|corner| place(vertices[corner], &wedges[corner])))
    };
    let places = triangles.iter().zip(corners).map(places).collect();
    (wedges, places)
}

/// How far segments reach beyond the triangles: not at all where they are edges, half their length between two corners,
/// their length from a corner to elsewhere; on a lattice more where an end is no corner, see `segments`.
fn reach(segments: &[[u32; 2]], triangles: &[[u32; 3]], positions: &[[f32; 3]], is_on_lattice: bool) -> f64 {
    if segments.is_empty() {
        return 0.0;
    }
    let corners: HashSet<u32> = triangles.iter().flatten().copied().collect();
    let edges: HashSet<[u32; 2]> =
        triangles.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a], [*b, *a], [*c, *b], [*a, *c]]).collect();
    let at = |vertex: u32| positions[vertex as usize];
    let distance = |end: u32| {
        if corners.contains(&end) {
            return 0.0;
        }
        let before = (0..end).rev().find(|vertex| corners.contains(vertex));
        let behind = (end..positions.len() as u32).find(|vertex| corners.contains(vertex));
        let near = [before, behind].into_iter().flatten().filter(|_| is_on_lattice);
        near.map(|vertex| between(at(vertex), at(end))).fold(f64::INFINITY, f64::min)
    };
    let beyond = segments
        .iter()
        .filter(|segment| !edges.contains(*segment))
        .map(|[from, to]| farthest(between(at(*from), at(*to)), distance(*from), distance(*to)));
    beyond.fold(0.0, f64::max)
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
}
