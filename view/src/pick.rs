//! What of the surface is under the cursor (Möller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997).
//!
//! Time: once through the triangles drawn, about 10 ms for a million; that is for a double click.

use glam::DVec3;

/// How many times the direction the nearest place of the surface is away that the ray meets, of the streams of a
/// [`Navigator`](navigator::Navigator). Both sides of the surface count. The eye is relative to the model's origin.
pub fn nearest(vertices: &[[f32; 4]], triangles: &[[u32; 3]], eye: DVec3, direction: DVec3) -> Option<f64> {
    let position = |vertex: u32| {
        vertices.get(vertex as usize).map(|[x, y, z, _]| DVec3::new((*x).into(), (*y).into(), (*z).into()))
    };
    let met = triangles.iter().filter(|corners| corners[0] != corners[1]).filter_map(|corners| {
        let [Some(first), Some(second), Some(third)] = corners.map(position) else { return None };
        meets(eye, direction, first, second - first, third - first)
    });
    met.min_by(f64::total_cmp)
}

/// How many times the direction the place of a triangle is away, given by a corner and the two sides there.
fn meets(eye: DVec3, direction: DVec3, corner: DVec3, one: DVec3, other: DVec3) -> Option<f64> {
    let across = direction.cross(other);
    let volume = one.dot(across);
    if volume == 0.0 {
        return None;
    }
    let from_corner = eye - corner;
    let share = from_corner.dot(across) / volume;
    let around = from_corner.cross(one);
    let other_share = direction.dot(around) / volume;
    let away = other.dot(around) / volume;
    (share >= 0.0 && other_share >= 0.0 && share + other_share <= 1.0 && away > 0.0).then_some(away)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_of_two_squares() {
        let vertices: Vec<[f32; 4]> = [(0, 0), (1, 0), (1, 1), (0, 1)]
            .into_iter()
            .flat_map(|(x, y)| [[x as f32, y as f32, 0.0, 0.0], [x as f32, y as f32, 5.0, 0.0]])
            .collect();
        // Of each square one triangle each way round, and places where there is none.
        let triangles = [[0, 2, 4], [0, 6, 4], [0; 3], [1, 3, 5], [1, 7, 5], [3; 3]];
        let from = |x: f64, y: f64, z: f64, down: f64| {
            nearest(&vertices, &triangles, DVec3::new(x, y, z), DVec3::new(0.0, 0.0, -down))
        };
        for (x, y) in [(0.25, 0.75), (0.75, 0.25), (0.5, 0.5)] {
            assert_eq!(from(x, y, 9.0, 1.0), Some(4.0));
            assert_eq!(from(x, y, 9.0, 2.0), Some(2.0));
            assert_eq!(from(x, y, 3.0, 1.0), Some(3.0));
            assert_eq!(from(x, y, 3.0, -1.0), Some(2.0));
            assert_eq!(from(x, y, -1.0, 1.0), None);
        }
        assert_eq!(from(1.25, 0.5, 9.0, 1.0), None);
        assert_eq!(nearest(&vertices, &[[0, 2, 400]], DVec3::Z, DVec3::NEG_Z), None);
    }
}
