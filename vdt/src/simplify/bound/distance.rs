//! Distances from above: of points from triangles, and between segments, eight at a time.
//!
//! What is returned is the distance to *some* point of the triangle or segment, the nearest one but for rounding: its
//! parameters are brought into their range before the point is worked out, so that it lies there however badly they came
//! out (needles, triangles without area). So every distance is a bound, up to the rounding of the last few operations,
//! for which [`ROUNDING`] stands.
//!
//! All vectors are relative to the vertex that stays, which is a corner of every new triangle, and an end of every spoke.

use super::lanes::{Lanes, Vectors};

/// A distance that comes out of this module is too small by less than this part of the longest vector that went into it.
///
/// The vectors themselves are differences of single-precision positions, off by one rounding (2^-24 of their length) each;
/// a point `s a + t b` with `s + t <= 1 + 2^-24` and its difference from a third vector add at most 12 roundings of that
/// length; the square, the sum and the root 4. That is less than 20 roundings of 2^-24; 32 are allowed for.
pub(super) const ROUNDING: f32 = 32.0 / (1 << 24) as f32;

/// Eight triangles with the origin as their first corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Triangles {
    a: Vectors,
    b: Vectors,
    aa: Lanes,
    ab: Lanes,
    bb: Lanes,
    per_aa: Lanes,
    per_bb: Lanes,
    /// One over the squared length of the side from a to b.
    per_side: Lanes,
    /// One over the determinant: four times the squared area.
    per_area: Lanes,
}

impl Triangles {
    /// By their second and third corners.
    #[inline(always)]
    pub fn new(a: Vectors, b: Vectors) -> Self {
        let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
        let side = b.minus(a);
        Triangles {
            a,
            b,
            aa,
            ab,
            bb,
            per_aa: aa.inverse(),
            per_bb: bb.inverse(),
            per_side: side.dot(side).inverse(),
            per_area: (aa * bb - ab * ab).inverse(),
        }
    }

    /// The triangle of one lane in all of them.
    #[inline(always)]
    pub fn spread(&self, lane: usize) -> Self {
        let all = |lanes: &Lanes| Lanes::all(lanes.0[lane]);
        let vectors = |vectors: &Vectors| Vectors(vectors.0.map(|axis| Lanes::all(axis.0[lane])));
        Triangles {
            a: vectors(&self.a),
            b: vectors(&self.b),
            aa: all(&self.aa),
            ab: all(&self.ab),
            bb: all(&self.bb),
            per_aa: all(&self.per_aa),
            per_bb: all(&self.per_bb),
            per_side: all(&self.per_side),
            per_area: all(&self.per_area),
        }
    }

    /// The squared distance of the point in each lane from the triangle there.
    #[inline(always)]
    pub fn square_distance(&self, point: Vectors) -> Lanes {
        let Triangles { a, b, aa, ab, bb, per_aa, per_bb, per_side, per_area } = *self;
        let (pa, pb) = (point.dot(a), point.dot(b));
        let square = |from: Vectors| from.dot(from);
        let to_a = square(point.minus(a.times((pa * per_aa).clamp_to(Lanes::ONE))));
        let to_b = square(point.minus(b.times((pb * per_bb).clamp_to(Lanes::ONE))));
        let along = (((pb - pa) + (aa - ab)) * per_side).clamp_to(Lanes::ONE);
        let to_side = square(point.minus(a).minus(b.minus(a).times(along)));
        let s = ((bb * pa - ab * pb) * per_area).clamp_to(Lanes::ONE);
        let t = ((aa * pb - ab * pa) * per_area).clamp_to(Lanes::ONE - s);
        let inside = square(point.minus(a.times(s)).minus(b.times(t)));
        to_a.min(to_b).min(to_side.min(inside))
    }
}

/// Where segments pass each other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Passing {
    /// The place on the first segment, 0 to 1.
    pub place: Lanes,
    /// The squared distance of that place from the second segment.
    pub square_distance: Lanes,
}

/// Where the segments from `start` by `step` come nearest to those from the origin to `spoke`, no earlier than
/// `earliest` on the first ones.
#[inline(always)]
pub(super) fn pass(start: Vectors, step: Vectors, spoke: Vectors, earliest: Lanes) -> Passing {
    let (a, b, e) = (step.dot(step), step.dot(spoke), spoke.dot(spoke));
    let (c, f) = (step.dot(start), spoke.dot(start));
    let (per_a, per_e) = (a.inverse(), e.inverse());
    let first = ((b * f - c * e) * (a * e - b * b).inverse()).clamp_to(Lanes::ONE);
    let on_spoke = ((b * first + f) * per_e).clamp_to(Lanes::ONE);
    let place = ((b * on_spoke - c) * per_a).clamp_to(Lanes::ONE).max(earliest);
    let on_spoke = ((b * place + f) * per_e).clamp_to(Lanes::ONE);
    let between = start.plus(step.times(place)).minus(spoke.times(on_spoke));
    Passing { place, square_distance: between.dot(between) }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::lanes::LANES;
    use super::*;
    use crate::vector::{Vector, dot, minus};

    fn length(vector: Vector) -> f64 {
        dot(vector, vector).sqrt()
    }

    fn along(a: Vector, b: Vector, t: f64) -> Vector {
        std::array::from_fn(|axis| a[axis] + (b[axis] - a[axis]) * t)
    }

    fn point_segment(point: Vector, a: Vector, b: Vector) -> f64 {
        let d = minus(b, a);
        let t = if dot(d, d) > 0.0 { (dot(minus(point, a), d) / dot(d, d)).clamp(0.0, 1.0) } else { 0.0 };
        length(minus(point, along(a, b, t)))
    }

    /// The smallest value of a convex function of a number from 0 to 1, by ternary search.
    fn smallest(mut distance: impl FnMut(f64) -> f64) -> f64 {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..100 {
            let (first, second) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
            if distance(first) < distance(second) { high = second } else { low = first }
        }
        distance(low)
    }

    fn slowly(point: Vector, a: Vector, b: Vector) -> f64 {
        // From the segment across the triangle at each distance from its first corner.
        smallest(|t| point_segment(point, along([0.0; 3], a, t), along([0.0; 3], b, t)))
    }

    fn vector() -> impl Strategy<Value = [f32; 3]> {
        prop_oneof![
            4 => prop::array::uniform3(-1.0_f32..1.0),
            1 => prop::array::uniform3(prop::sample::select(vec![0.0_f32, 0.5, -0.25, 1e-6, 1.0])),
        ]
    }

    proptest! {
        #[test]
        fn a_distance_is_that_to_the_nearest_point(a in vector(), b in vector(), point in vector()) {
            let triangles = Triangles::new(Vectors::all(a), Vectors::all(b));
            let found = triangles.square_distance(Vectors::all(point)).0.map(f32::sqrt);
            prop_assert_eq!(found, [found[0]; LANES]);
            let [wide_a, wide_b, wide_point] = [a, b, point].map(|vector| vector.map(f64::from));
            let expected = slowly(wide_point, wide_a, wide_b);
            let longest = [wide_a, wide_b, wide_point].into_iter().map(length).fold(0.0, f64::max);
            let found = f64::from(found[0]);
            prop_assert!(found + f64::from(ROUNDING) * longest >= expected, "{} {}", found, expected);
            prop_assert!(found <= expected + 1e-2 * longest, "{} {}", found, expected);
            prop_assert_eq!(
                triangles.spread(3).square_distance(Vectors::all(point)), triangles.square_distance(Vectors::all(point))
            );
        }

        #[test]
        fn segments_pass_where_they_are_nearest(
            start in vector(), end in vector(), spoke in vector(), earliest in 0.0_f32..1.0,
        ) {
            let step: [f32; 3] = std::array::from_fn(|axis| end[axis] - start[axis]);
            let wide = |vector: [f32; 3]| vector.map(f64::from);
            let spoke_distance = |t: f64| {
                point_segment(along(wide(start), wide(end), t), [0.0; 3], wide(spoke))
            };
            for earliest in [0.0, earliest] {
                let lanes = [start, step, spoke].map(Vectors::all);
                let passing = pass(lanes[0], lanes[1], lanes[2], Lanes::all(earliest));
                let (place, found) = (passing.place.0[0], passing.square_distance.0[0].sqrt());
                prop_assert!((earliest..=1.0).contains(&place));
                prop_assert!((spoke_distance(place.into()) - f64::from(found)).abs() < 1e-5);
                if earliest == 0.0 {
                    prop_assert!(f64::from(found) <= smallest(spoke_distance) + 1e-2);
                }
            }
        }
    }
}
