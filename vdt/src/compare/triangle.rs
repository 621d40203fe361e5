//! A point and a triangle: how far apart they are.
//!
//! Exact up to rounding in double precision, for every triangle: slivers, segments and points too. What is computed is
//! always the distance to some point of the triangle (up to rounding), so it is never too small by more than that.
//!
//! Where the foot of the perpendicular lies inside, it is nearest. Else the nearest point lies on a side that has the
//! point on its outside. A triangle whose smallest angle is below a thousandth has a normal that says little: there all
//! three sides are looked at, and the error is less than its width.

use crate::vector::{Vector, cross, dot, minus};

/// Three corners.
pub type Triangle = [Vector; 3];

/// Below this square of the sine of an angle, a triangle counts as a sliver.
const SLIVER: f64 = 1e-6;

/// A point that lies `along` the way from one point to another, 0 to 1.
fn between(from: Vector, to: Vector, along: f64) -> Vector {
    std::array::from_fn(|axis| from[axis] + (to[axis] - from[axis]) * along)
}

/// The distance between two points.
pub(super) fn length(left: Vector, right: Vector) -> f64 {
    let way = minus(left, right);
    dot(way, way).sqrt()
}

/// Square of the distance of the origin from a segment.
fn to_segment(a: Vector, b: Vector) -> f64 {
    let side = minus(b, a);
    let square = dot(side, side);
    let along = if square > 0.0 { (-dot(a, side) / square).clamp(0.0, 1.0) } else { 0.0 };
    let nearest: Vector = std::array::from_fn(|axis| a[axis] + side[axis] * along);
    dot(nearest, nearest)
}

/// Square of the distance of a point from the nearest one of a triangle.
pub fn squared_distance(point: Vector, triangle: &Triangle) -> f64 {
    // Seen from the point.
    let [a, b, c] = triangle.map(|corner| minus(corner, point));
    let (ab, ac) = (minus(b, a), minus(c, a));
    let normal = cross(ab, ac);
    let square = dot(normal, normal);
    let is_sliver = square <= SLIVER * dot(ab, ab) * dot(ac, ac);
    // The weights of the corners at the foot of the perpendicular, times `square`.
    let at_b = dot(normal, cross(ac, a));
    let at_c = dot(normal, cross(a, ab));
    let at_a = square - at_b - at_c;
    let mut least = f64::INFINITY;
    if at_a >= 0.0 && at_b >= 0.0 && at_c >= 0.0 && square > 0.0 {
        let (along_b, along_c) = (at_b / square, at_c / square);
        let foot: Vector = std::array::from_fn(|axis| a[axis] + ab[axis] * along_b + ac[axis] * along_c);
        least = dot(foot, foot);
        if !is_sliver {
            return least;
        }
    }
    if at_c < 0.0 || is_sliver {
        least = least.min(to_segment(a, b));
    }
    if at_b < 0.0 || is_sliver {
        least = least.min(to_segment(a, c));
    }
    if at_a < 0.0 || is_sliver {
        least = least.min(to_segment(b, c));
    }
    least
}

/// The weights of the corners at the point of a triangle that is nearest to a point. They are not below 0, and their sum is 1.
pub(super) fn nearest_weights(point: Vector, triangle: &Triangle) -> Vector {
    let [a, b, c] = triangle.map(|corner| minus(corner, point));
    let (ab, ac) = (minus(b, a), minus(c, a));
    let normal = cross(ab, ac);
    let square = dot(normal, normal);
    let mut nearest = [1.0, 0.0, 0.0];
    let mut least = dot(a, a);
    let mut try_at = |weights: Vector| {
        let place: Vector =
            std::array::from_fn(|axis| a[axis] * weights[0] + b[axis] * weights[1] + c[axis] * weights[2]);
        let squared = dot(place, place);
        if squared < least {
            (nearest, least) = (weights, squared);
        }
    };
    let along = |from: Vector, to: Vector| {
        let side = minus(to, from);
        let square = dot(side, side);
        if square > 0.0 { (-dot(from, side) / square).clamp(0.0, 1.0) } else { 0.0 }
    };
    let (on_ab, on_ac, on_bc) = (along(a, b), along(a, c), along(b, c));
    try_at([1.0 - on_ab, on_ab, 0.0]);
    try_at([1.0 - on_ac, 0.0, on_ac]);
    try_at([0.0, 1.0 - on_bc, on_bc]);
    if square > 0.0 {
        let (at_b, at_c) = (dot(normal, cross(ac, a)) / square, dot(normal, cross(a, ab)) / square);
        if at_b >= 0.0 && at_c >= 0.0 && at_b + at_c <= 1.0 {
            try_at([1.0 - at_b - at_c, at_b, at_c]);
        }
    }
    nearest
}

/// The middle of a triangle.
pub(super) fn centre(triangle: &Triangle) -> Vector {
    std::array::from_fn(|axis| triangle.iter().map(|corner| corner[axis]).sum::<f64>() / 3.0)
}

/// How far the corner farthest from a point is: no point of the triangle is farther.
pub(super) fn farthest(point: Vector, triangle: &Triangle) -> f64 {
    triangle.iter().map(|corner| length(point, *corner)).fold(0.0, f64::max)
}

/// The largest distance of a corner of a convex polygon from `other`. The distance from a convex set is convex, so no point
/// of the polygon is farther from it.
pub(super) fn farthest_corner(polygon: &[Vector], other: &Triangle) -> f64 {
    polygon.iter().map(|corner| squared_distance(*corner, other)).fold(0.0, f64::max).sqrt()
}

/// The two halves of a triangle, cut in the middle of its longest side.
pub(super) fn halves(triangle: &Triangle) -> [Triangle; 2] {
    let sides = [0, 1, 2].map(|first| length(triangle[first], triangle[(first + 1) % 3]));
    let first = if sides[0] >= sides[1] && sides[0] >= sides[2] {
        0
    } else if sides[1] >= sides[2] {
        1
    } else {
        2
    };
    let [a, b, c] = [0, 1, 2].map(|corner| triangle[(first + corner) % 3]);
    let middle = between(a, b, 0.5);
    [[a, middle, c], [middle, b, c]]
}

/// Cuts a triangle by the planes through the sides of another that are orthogonal to that one. Returns the convex polygon
/// that lies over the other one, up to a `tolerance`, and triangles that hold all the rest. `None` where no part of it lies
/// over the other one, or that one has no area.
pub(super) fn cut_around(
    triangle: &Triangle,
    other: &Triangle,
    tolerance: f64,
) -> Option<(Vec<Vector>, Vec<Triangle>)> {
    let [a, b, c] = *other;
    let normal = cross(minus(b, a), minus(c, a));
    let mut sides = vec![(a, b), (b, c), (c, a)];
    let (mut over, mut beside) = (triangle.to_vec(), Vec::new());
    while !sides.is_empty() {
        // The one that a corner is farthest outside of comes first: it cuts off the most.
        let mut heights: Vec<Vec<f64>> = Vec::with_capacity(sides.len());
        for (from, to) in &sides {
            let outward = cross(minus(*to, *from), normal);
            let scale = dot(outward, outward).sqrt();
            if scale <= 0.0 {
                return None;
            }
            heights.push(over.iter().map(|corner| dot(minus(*corner, *from), outward) / scale).collect());
        }
        let largest = heights.iter().map(|heights| heights.iter().copied().fold(f64::NEG_INFINITY, f64::max));
        let (side, outside) = largest.enumerate().max_by(|left, right| left.1.total_cmp(&right.1))?;
        if outside <= tolerance {
            break;
        }
        let (heights, _) = (heights.swap_remove(side), sides.swap_remove(side));
        if heights.iter().all(|height| *height >= -tolerance) {
            return None;
        }
        let (inner, outer) = split(&over, &heights, tolerance);
        beside.extend((2..outer.len()).map(|corner| [outer[0], outer[corner - 1], outer[corner]]));
        over = inner;
    }
    Some((over, beside))
}

/// Splits a convex polygon by a plane: what lies below it and what lies above, by the heights of the corners. A corner that
/// is within the tolerance of the plane belongs to both.
fn split(polygon: &[Vector], heights: &[f64], tolerance: f64) -> (Vec<Vector>, Vec<Vector>) {
    let (mut below, mut above) = (Vec::with_capacity(polygon.len() + 1), Vec::with_capacity(polygon.len() + 1));
    for (corner, height) in heights.iter().enumerate() {
        let next = (corner + 1) % polygon.len();
        if *height <= tolerance {
            below.push(polygon[corner]);
        }
        if *height >= -tolerance {
            above.push(polygon[corner]);
        }
        let ends = [*height, heights[next]];
        if ends.iter().all(|end| end.abs() > tolerance) && (ends[0] > 0.0) != (ends[1] > 0.0) {
            let crossing = between(polygon[corner], polygon[next], ends[0] / (ends[0] - ends[1]));
            below.push(crossing);
            above.push(crossing);
        }
    }
    (below, above)
}

/// Area of a triangle.
pub(super) fn area(triangle: &Triangle) -> f64 {
    let normal = cross(minus(triangle[1], triangle[0]), minus(triangle[2], triangle[0]));
    dot(normal, normal).sqrt() * 0.5
}

/// The longest side of a triangle: its two ends.
pub(super) fn longest_side(triangle: &Triangle) -> [Vector; 2] {
    longest_side_corners(triangle).map(|corner| triangle[corner])
}

/// The numbers of the two ends of the longest side of a triangle.
pub(super) fn longest_side_corners(triangle: &Triangle) -> [usize; 2] {
    let [a, b, c] = *triangle;
    let [ab, bc, ca] = [length(a, b), length(b, c), length(c, a)];
    if ab >= bc && ab >= ca {
        [0, 1]
    } else if bc >= ca {
        [1, 2]
    } else {
        [2, 0]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The least distance to the points of a fine grid in the triangle.
    fn by_a_grid(point: Vector, triangle: &Triangle) -> f64 {
        let steps = 60;
        let mut least = f64::INFINITY;
        for i in 0..=steps {
            for j in 0..=steps - i {
                let [u, v] = [i, j].map(|step| f64::from(step) / f64::from(steps));
                let place: Vector = std::array::from_fn(|axis| {
                    let [a, b, c] = triangle.map(|corner| corner[axis]);
                    a + (b - a) * u + (c - a) * v
                });
                least = least.min(length(point, place));
            }
        }
        least
    }

    fn coordinate() -> impl Strategy<Value = f64> {
        // Whole numbers give corners that coincide, lie on a line, and points in the plane.
        prop_oneof![-1.0..1.0, (-1..=1).prop_map(f64::from)]
    }

    proptest! {
        #[test]
        fn distance_is_that_of_the_nearest_of_many_points(
            point in prop::array::uniform3(coordinate()),
            triangle in prop::array::uniform3(prop::array::uniform3(coordinate())),
            flatness in prop_oneof![Just(1.0), Just(1e-3), Just(1e-5), Just(1e-9), Just(0.0)],
        ) {
            let triangle = triangle.map(|corner: Vector| [corner[0], corner[1] * flatness, corner[2] * flatness]);
            let distance = squared_distance(point, &triangle).sqrt();
            let grid = by_a_grid(point, &triangle);
            prop_assert!(distance <= grid + 1e-12, "{} {}", distance, grid);
            let step = triangle.iter().map(|corner| length(*corner, triangle[0])).fold(0.0, f64::max) / 30.0;
            prop_assert!(distance >= grid - step - 1e-12, "{} {}", distance, grid);
            let weights = nearest_weights(point, &triangle);
            prop_assert!(weights.iter().all(|weight| *weight >= 0.0), "{:?}", weights);
            prop_assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{:?}", weights);
            let place = std::array::from_fn(|axis| (0..3).map(|at| triangle[at][axis] * weights[at]).sum());
            prop_assert!((length(point, place) - distance).abs() < 1e-9, "{} {}", length(point, place), distance);
            let halved = halves(&triangle).map(|half| squared_distance(point, &half)).into_iter().fold(9.0, f64::min);
            prop_assert!((halved.sqrt() - distance).abs() < 1e-9, "{} {}", halved.sqrt(), distance);
            let middle = centre(&triangle);
            let radius = farthest(middle, &triangle);
            prop_assert!(squared_distance(middle, &triangle).sqrt() < 1e-12);
            prop_assert!(length(middle, point) <= distance + 2.0 * radius + 1e-12);
        }
    }

    proptest! {
        /// The parts hold the whole triangle and no more, and what lies over the other triangle does.
        #[test]
        fn what_is_cut_around_a_triangle_is_all_there(
            triangle in prop::array::uniform3(prop::array::uniform3(coordinate())),
            other in prop::array::uniform3(prop::array::uniform3(coordinate())),
            is_flat: bool,
            weights in prop::collection::vec((0.0..1.0, 0.0..1.0), 20),
        ) {
            let flat = |corner: Vector| [corner[0], corner[1], if is_flat { 0.0 } else { corner[2] }];
            let (triangle, other) = (triangle.map(flat), other.map(flat));
            let Some((over, beside)) = cut_around(&triangle, &other, 1e-9) else { return Ok(()) };
            let fan = (2..over.len()).map(|corner| [over[0], over[corner - 1], over[corner]]);
            let parts: Vec<Triangle> = fan.chain(beside).collect();
            let all: f64 = parts.iter().map(area).sum();
            prop_assert!((all - area(&triangle)).abs() < 1e-7, "{} {}", all, area(&triangle));
            for (u, v) in weights {
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let [a, b, c] = triangle;
                let point: Vector = std::array::from_fn(|axis| a[axis] + (b[axis] - a[axis]) * u + (c[axis] - a[axis]) * v);
                let nearest = parts.iter().map(|part| squared_distance(point, part)).fold(f64::INFINITY, f64::min);
                prop_assert!(nearest.sqrt() < 1e-8, "{}", nearest.sqrt());
            }
            let normal = cross(minus(other[1], other[0]), minus(other[2], other[0]));
            let scale = dot(normal, normal).sqrt();
            if scale > 1e-3 {
                for corner in over {
                    let height = dot(minus(corner, other[0]), normal).abs() / scale;
                    let distance = squared_distance(corner, &other).sqrt();
                    prop_assert!((distance - height).abs() < 1e-6, "{} {}", distance, height);
                }
            }
        }
    }

    #[test]
    fn a_triangle_around_another_is_cut_along_its_three_sides() {
        let large = [[-4.0, -4.0, 1.0], [6.0, -4.0, 1.0], [-4.0, 6.0, 1.0]];
        let small = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let (over, beside) = cut_around(&large, &small, 1e-9).unwrap();
        assert_eq!(farthest_corner(&over, &small), 1.0);
        assert_eq!((over.len(), beside.iter().map(area).sum::<f64>()), (3, 49.5));
        let (over, beside) = cut_around(&small, &large, 1e-9).unwrap();
        assert_eq!((over, beside.len()), (small.to_vec(), 0));
        // Beside it, and a triangle without area.
        assert_eq!(cut_around(&small.map(|[x, y, z]| [x + 2.0, y, z]), &small, 1e-9), None);
        assert_eq!(cut_around(&large, &[small[0], small[1], small[1]], 1e-9), None);
    }

    #[test]
    fn nearest_inside_at_a_side_and_at_a_corner() {
        let triangle = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        for (point, expected) in [
            ([0.5, 0.5, 3.0], 9.0),
            ([0.5, 0.5, 0.0], 0.0),
            ([1.0, -2.0, 0.0], 4.0),
            ([2.0, 2.0, 0.0], 2.0),
            ([-1.0, -1.0, 1.0], 3.0),
        ] {
            assert_eq!(squared_distance(point, &triangle), expected, "{point:?}");
        }
        assert_eq!((area(&triangle), longest_side(&triangle)), (2.0, [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0]]));
    }
}
