//! The canonical form of a mesh that fits in RAM: the slow obvious way, by which [`super::store`] is judged.
//!
//! Memory: 24 bytes for each vertex and 12 for each triangle of the file, 20 more for each vertex while it is sorted; and
//! where there are triangles without area, a table of all edges.

use std::cmp::Ordering;
use std::collections::HashSet;

use super::frame::{Bounds, Grid, Rounding, local, local_origin};
use super::{CleaningCounts, CoreMesh};
use crate::vector::{length, length_not_below, minus};

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
    let mut locals: Vec<[f32; 3]> = Vec::with_capacity(positions.len());
    let mut rounding = Rounding::default();
    for (index, position) in positions.iter().enumerate() {
        let in_frame = local(*position, origin);
        if named[index] && !in_frame.iter().all(|value| value.is_finite()) {
            return Err(index);
        }
        if named[index] {
            rounding.include(*position, origin, in_frame);
        }
        locals.push(in_frame);
    }
    drop(positions);

    let named_locals = locals.iter().zip(&named).filter(|(_, named)| **named);
    let Some(grid) = Grid::of(&Bounds::of(named_locals.map(|(position, _)| position.map(f64::from)))) else {
        // No triangle has three different corners.
        cleaning.degenerate_triangles += triangles.len() as u64;
        cleaning.isolated_vertices += locals.len() as u64;
        return Ok(CoreMesh { cleaning, ..CoreMesh::default() });
    };
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
    drop(order);
    drop(locals);

    let (before, mut segments) = (triangles.len(), Vec::new());
    triangles.retain_mut(|corners| {
        let [a, b, c] = corners.map(|corner| renumbered[corner as usize]);
        *corners = if a < b && a < c {
            [a, b, c]
        } else if b < c {
            [b, c, a]
        } else {
            [c, a, b]
        };
        let has_area = a != b && b != c && c != a;
        if !has_area {
            segments.push(if a == b { [a, c] } else { [a, b] });
        }
        has_area
    });
    drop(renumbered);
    cleaning.degenerate_triangles += (before - triangles.len()) as u64;
    triangles.sort_unstable();
    let before = triangles.len();
    triangles.dedup();
    cleaning.duplicate_triangles += (before - triangles.len()) as u64;
    let lost = reach(&segments, &triangles, &welded);
    let positions = without_unused(welded, &mut triangles, &mut cleaning);
    triangles.shrink_to_fit();
    let input_error = length_not_below(rounding.largest + lost);
    Ok(CoreMesh { positions, triangles, origin, exponent: grid.exponent, cleaning, input_error })
}

/// How far segments reach beyond the triangles: not at all where they are edges, half their length between two corners,
/// their length from a corner to elsewhere.
fn reach(segments: &[[u32; 2]], triangles: &[[u32; 3]], positions: &[[f32; 3]]) -> f64 {
    if segments.is_empty() {
        return 0.0;
    }
    let corners: HashSet<u32> = triangles.iter().flatten().copied().collect();
    let edges: HashSet<[u32; 2]> =
        triangles.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a], [*b, *a], [*c, *b], [*a, *c]]).collect();
    let at = |vertex: u32| positions[vertex as usize].map(f64::from);
    let beyond = segments.iter().filter(|segment| !edges.contains(*segment)).map(|segment| {
        let whole = length(minus(at(segment[0]), at(segment[1])));
        match segment.iter().filter(|end| corners.contains(end)).count() {
            0 => 0.0,
            1 => whole,
            _ => whole * 0.5,
        }
    });
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
