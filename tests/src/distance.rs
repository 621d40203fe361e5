//! How far points are from triangles, by trying them all.

type Point = [f64; 3];

fn minus(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Point, b: Point) -> Point {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn to_segment(point: Point, a: Point, b: Point) -> f64 {
    let side = minus(b, a);
    let length = dot(side, side);
    let t = if length > 0.0 { (dot(minus(point, a), side) / length).clamp(0.0, 1.0) } else { 0.0 };
    let nearest = [a[0] + t * side[0], a[1] + t * side[1], a[2] + t * side[2]];
    dot(minus(point, nearest), minus(point, nearest)).sqrt()
}

/// How far a point is from a triangle.
pub fn to_triangle(point: Point, [a, b, c]: [Point; 3]) -> f64 {
    let to_sides = to_segment(point, a, b).min(to_segment(point, b, c)).min(to_segment(point, c, a));
    let normal = cross(minus(b, a), minus(c, a));
    let is_inside = [(a, b), (b, c), (c, a)]
        .into_iter()
        .all(|(from, to)| dot(cross(minus(to, from), minus(point, from)), normal) >= 0.0);
    let square = dot(normal, normal);
    // Without an area, the sides are all there is.
    if is_inside && square > 1e-18 * dot(minus(b, a), minus(b, a)) * dot(minus(c, a), minus(c, a)) {
        to_sides.min(dot(minus(point, a), normal).abs() / square.sqrt())
    } else {
        to_sides
    }
}

/// How far a point is from the nearest of some triangles.
pub fn to_triangles(point: Point, triangles: &[[Point; 3]]) -> f64 {
    triangles.iter().map(|triangle| to_triangle(point, *triangle)).fold(f64::INFINITY, f64::min)
}

/// Points of a triangle: those with barycentric coordinates that are multiples of 1 / `steps`.
pub fn points_of([a, b, c]: [Point; 3], steps: u32) -> impl Iterator<Item = Point> {
    (0..=steps).flat_map(move |i| (0..=steps - i).map(move |j| (i, j))).map(move |(i, j)| {
        let (s, t) = (f64::from(i) / f64::from(steps), f64::from(j) / f64::from(steps));
        std::array::from_fn(|axis| a[axis] + s * (b[axis] - a[axis]) + t * (c[axis] - a[axis]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_by_hand() {
        let triangle = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]];
        assert_eq!(to_triangle([1.0, 1.0, 2.0], triangle), 2.0);
        assert_eq!(to_triangle([-3.0, -4.0, 0.0], triangle), 5.0);
        assert_eq!(to_triangle([2.0, -1.0, 0.0], triangle), 1.0);
        assert_eq!(to_triangle([1.0, 1.0, 0.0], triangle), 0.0);
        assert!((to_triangle([4.0, 4.0, 0.0], triangle) - 8.0_f64.sqrt()).abs() < 1e-12);
        // No area: the segment.
        assert_eq!(to_triangle([2.0, 3.0, 0.0], [[0.0; 3], [4.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 3.0);
        assert_eq!(points_of(triangle, 4).count(), 15);
    }
}
