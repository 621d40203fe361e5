//! Normals of vertices, in 20 bits: a direction is projected on the octahedron |x| + |y| + |z| = 1, whose lower half is
//! folded outward, so that all of it is a square; in that, 1023 steps in either direction. (Meyer et al., "On floating-point
//! normal vectors", 2010.)
//!
//! The steps are odd in number, so that the directions of the axes are among them: flat regions that lie with the axes, as in
//! CAD models and over water, have exactly their normal. The decoded direction is off by at most [`LARGEST_ERROR`].
//!
//! Only +, -, *, / and square roots, so that every machine gets the same bytes.

use bytemuck::{Pod, Zeroable};

use crate::vector::Vector;

/// The direction of the surface at a vertex, rounded.
///
/// The low ten bits and the ten above them are the coordinates in the folded square, 0 to 1022; the others are 0. A direction
/// at the border of the square has two or four such pairs of coordinates (the square's corners all are -z); of these,
/// [`Normal::encode`] gives one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(transparent)]
pub struct Normal(u32);

/// The largest angle between a direction and what is decoded of it, in radians: a quarter of a degree. (It is
/// reached where all three coordinates are the same: there the steps are the widest apart.)
pub const LARGEST_ERROR: f64 = 4.2e-3;

const BITS: u32 = 10;
/// Steps from the middle of the square to its border.
const STEPS: f64 = 511.0;

impl Normal {
    /// The direction of the z axis: that of a vertex whose triangles have none together.
    pub const UP: Normal = Normal(511 << BITS | 511);

    /// Bits of its word that are used.
    pub const WORD_BITS: u32 = 2 * BITS;

    /// The nearest step to a direction, of any length; [`Normal::UP`] where there is none.
    pub fn encode(direction: [f64; 3]) -> Self {
        let sum = direction[0].abs() + direction[1].abs() + direction[2].abs();
        if sum.is_nan() || sum.is_infinite() || sum <= 0.0 {
            return Normal::UP;
        }
        let [x, y] = fold([direction[0] / sum, direction[1] / sum], direction[2] < 0.0);
        // Not below 0, so this rounds to the nearest.
        let [x, y] = [x, y].map(|coordinate| (coordinate * STEPS + (STEPS + 0.5)) as u32);
        Normal(y << BITS | x)
    }

    /// The direction, at length one.
    pub fn decode(self) -> [f32; 3] {
        let [x, y, z] = self.steps().map(|steps| steps as f32);
        let length = (x * x + y * y + z * z).sqrt();
        [x / length, y / length, z / length]
    }

    /// The direction in whole steps, at some length: nothing is rounded.
    #[inline]
    pub fn steps(self) -> [i32; 3] {
        let mask = (1 << BITS) - 1;
        let [x, y] = [self.0 & mask, self.0 >> BITS & mask].map(|step| step as i32 - STEPS as i32);
        let z = STEPS as i32 - x.abs() - y.abs();
        let folded =
            |value: i32, other: i32| if value < 0 { other.abs() - STEPS as i32 } else { STEPS as i32 - other.abs() };
        let [x, y] = if z < 0 { [folded(x, y), folded(y, x)] } else { [x, y] };
        [x, y, z]
    }

    /// Whether both coordinates are in the square, and there is nothing else.
    pub fn is_valid(self) -> bool {
        let most = 2 * STEPS as u32;
        self.0 & ((1 << BITS) - 1) <= most && self.0 >> BITS <= most
    }

    /// The two coordinates as one word.
    #[inline]
    pub fn to_word(self) -> u32 {
        self.0
    }

    /// The inverse of [`Normal::to_word`].
    #[inline]
    pub fn from_word(word: u32) -> Self {
        Normal(word)
    }
}

/// Folds the lower half of the octahedron outward, or back.
fn fold([x, y]: [f64; 2], is_lower: bool) -> [f64; 2] {
    let signed = |value: f64, sign: f64| if sign < 0.0 { -value } else { value };
    if is_lower { [signed(1.0 - y.abs(), x), signed(1.0 - x.abs(), y)] } else { [x, y] }
}

/// The normal of a vertex from those of the triangles at it, each as long as its triangle is large, in canonical order.
pub fn vertex_normal(normals: impl Iterator<Item = [f64; 3]>) -> Normal {
    Normal::encode(normals.fold([0.0; 3], |sum: Vector, normal| std::array::from_fn(|at| sum[at] + normal[at])))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::vector::{cross, dot, unit};

    fn angle(a: Vector, b: Vector) -> f64 {
        let (a, b) = (unit(a), unit(b));
        let across = cross(a, b);
        dot(across, across).sqrt().atan2(dot(a, b))
    }

    #[test]
    fn every_step_comes_back_as_it_was() {
        for step in (0..1 << 20).filter(|step| step & 1023 != 1023 && step >> 10 != 1023) {
            let normal = Normal::from_word(step);
            let direction = normal.decode();
            let length = dot(direction.map(f64::from), direction.map(f64::from)).sqrt();
            assert!((length - 1.0).abs() < 1e-7, "{step}");
            let back = Normal::encode(direction.map(f64::from));
            let is_at_border = [step & 1023, step >> 10].iter().any(|coordinate| [0, 1022].contains(coordinate));
            assert!(back == normal || is_at_border, "{step}");
            assert_eq!(back.decode(), direction, "{step}");
        }
    }

    #[test]
    fn the_axes_are_exact_and_nothing_points_up() {
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let mut direction = [0.0; 3];
                direction[axis] = sign;
                assert_eq!(Normal::encode(direction).decode().map(f64::from), direction);
            }
        }
        for nothing in [[0.0; 3], [f64::NAN, 0.0, 0.0], [0.0, f64::INFINITY, 1.0]] {
            assert_eq!(Normal::encode(nothing), Normal::UP);
        }
        assert_eq!(Normal::UP.decode(), [0.0, 0.0, 1.0]);
        assert_eq!(vertex_normal(std::iter::empty()), Normal::UP);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn a_direction_is_off_by_next_to_nothing(
            direction in prop::array::uniform3(-1.0..1.0_f64), scale in prop_oneof![Just(1.0), 1e-80..1e-70, 1e70..1e80],
        ) {
            prop_assume!(dot(direction, direction) > 1e-6);
            let found = Normal::encode(direction.map(|component| component * scale)).decode();
            prop_assert!(angle(direction, found.map(f64::from)) < LARGEST_ERROR);
        }
    }
}
