//! Nested normal cones, for telling that a whole part of the surface faces away from the eye.
//!
//! A leaf's cone holds the normals of the triangles at it in the input; an inner node's is the smallest cone about its
//! children's two, up to the steps in which cones are stored. It is worked out with each collapse, from the cones of the
//! two nodes that it unites, for the triangles as they are oriented; which way is out is known when a component has come
//! down to its root only. So everything here is exactly odd: turn all normals round, and out come the same cones with
//! their axes negated ([`NormalCone::reversed`]).
//!
//! Angles are added through their sines and cosines, with +, -, *, / and square roots only, so that every machine gets
//! the same bytes. Axes are small integers, so their products are exact.

use crate::vector::{Vector, dot, unit};

use super::record::NormalCone;

/// Steps in which the sine of a half-angle is stored.
const SINE_STEPS: f64 = 254.0;
/// Steps in which an axis is stored.
const AXIS_STEPS: f64 = 127.0;

/// The cone of a leaf: about the normals of the triangles at it, of any length, in canonical order of the triangles.
/// Triangles without an area have no say.
#[inline]
pub fn leaf_cone(normals: impl Iterator<Item = [f64; 3]> + Clone) -> NormalCone {
    let sum = normals.clone().fold([0.0; 3], |sum: Vector, normal| std::array::from_fn(|at| sum[at] + normal[at]));
    let axis = stored_axis(sum);
    let axis_vector = axis.map(f64::from);
    let axis_square = dot(axis_vector, axis_vector);
    // The square of the cosine of the widest angle: one division for each triangle, and no root.
    let mut least = 1.0_f64;
    for normal in normals {
        let square = dot(normal, normal);
        if square > 0.0 {
            let along = dot(axis_vector, normal);
            if along <= 0.0 {
                return NormalCone::EVERYTHING;
            }
            least = least.min(along * along / (square * axis_square));
        }
    }
    stored(axis, least.sqrt(), (1.0 - least).sqrt())
}

/// The smallest cone, as cones are stored, about two cones; the wider one itself where it holds the other.
#[inline]
pub fn enclosing_cone(a: NormalCone, b: NormalCone) -> NormalCone {
    if a.sine == u8::MAX || b.sine == u8::MAX {
        return NormalCone::EVERYTHING;
    }
    let axes = [a, b].map(|cone| cone.axis.map(f64::from));
    let [half_a, half_b] = [a, b].map(HalfAngle::of);
    let between = Angle::between(axes[0], axes[1]);
    // The sine of (angle between the axes + one half-angle - the other). Below a right angle between the axes it is that
    // of an angle from -90 to 180 degrees, so where it is not positive the other cone holds the one.
    let difference = half_b.0.minus(half_a.0);
    let (beyond_a, beyond_b) = (between.plus(difference).sine, between.minus(difference).sine);
    if between.cosine > 0.0 {
        if beyond_a <= 0.0 {
            return a;
        }
        if beyond_b <= 0.0 {
            return b;
        }
    }
    let axis = axis_between(axes, between, half_a.0, half_b.0);
    let axis_vector = axis.map(f64::from);
    // Both cones as seen from the stored axis; the wider one decides.
    let reach_a = Angle::between(axis_vector, axes[0]).plus(half_a.0);
    let reach_b = Angle::between(axis_vector, axes[1]).plus(half_b.0);
    if reach_a.is_right_or_more() || reach_b.is_right_or_more() {
        return NormalCone::EVERYTHING;
    }
    let reach = if reach_a.cosine < reach_b.cosine { reach_a } else { reach_b };
    stored(axis, reach.cosine, reach.sine)
}

/// An angle, by its sine and cosine.
#[derive(Clone, Copy)]
struct Angle {
    cosine: f64,
    sine: f64,
}

impl Angle {
    /// That between two stored axes, not zero.
    #[inline]
    fn between(a: Vector, b: Vector) -> Self {
        let (product, along) = (dot(a, a) * dot(b, b), dot(a, b));
        // Whole numbers below 2^53: the difference is exactly the square of the cross product.
        let length = product.sqrt();
        Angle { cosine: along / length, sine: (product - along * along).sqrt() / length }
    }

    #[inline]
    fn plus(self, other: Angle) -> Angle {
        Angle {
            cosine: self.cosine * other.cosine - self.sine * other.sine,
            sine: self.sine * other.cosine + self.cosine * other.sine,
        }
    }

    #[inline]
    fn minus(self, other: Angle) -> Angle {
        self.plus(Angle { cosine: other.cosine, sine: -other.sine })
    }

    /// Of an angle from 0 to 270 degrees: whether it is 90 or more.
    #[inline]
    fn is_right_or_more(self) -> bool {
        self.cosine <= 0.0 || self.sine < 0.0
    }
}

/// Half of the opening of a cone that does not hold everything.
struct HalfAngle(Angle);

impl HalfAngle {
    #[inline]
    fn of(cone: NormalCone) -> Self {
        let sine = f64::from(cone.sine) / SINE_STEPS;
        HalfAngle(Angle { cosine: (1.0 - sine * sine).sqrt(), sine })
    }
}

/// The axis of the smallest cone about two cones of which none holds the other: half-way between the outermost direction
/// of the first, away from the second, and the outermost direction of the second. With `u` the first axis and `v` the
/// direction at right angles to it towards the second, these are `u cos(a) - v sin(a)` and
/// `u cos(between + b) + v sin(between + b)`.
#[inline]
fn axis_between(axes: [Vector; 2], between: Angle, half_a: Angle, half_b: Angle) -> [i8; 3] {
    let far = between.plus(half_b);
    let (along, sideways) = (half_a.cosine + far.cosine, far.sine - half_a.sine);
    // v = (second - u * cos(between)) / sin(between); only the direction counts, so all is multiplied by the sine, and by
    // the length of the second axis, which differs from that of the first by rounding.
    let lengths = (dot(axes[1], axes[1]) / dot(axes[0], axes[0])).sqrt();
    let along = (along * between.sine - sideways * between.cosine) * lengths;
    stored_axis(std::array::from_fn(|at| axes[0][at] * along + axes[1][at] * sideways))
}

/// A cone with this axis and half-angle, rounded up to a step.
#[inline]
fn stored(axis: [i8; 3], cosine: f64, sine: f64) -> NormalCone {
    // A little more, for the rounding of the sine itself.
    let steps = (sine * SINE_STEPS + 1e-6).ceil();
    if cosine <= 0.0 || steps > SINE_STEPS || axis == [0; 3] {
        NormalCone::EVERYTHING
    } else {
        NormalCone { axis, sine: steps as u8 }
    }
}

/// The nearest axis that can be stored; zero for a vector without a direction.
#[inline]
fn stored_axis(direction: Vector) -> [i8; 3] {
    unit(direction).map(|component| (component * AXIS_STEPS).round() as i8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RIGHT_ANGLE: f64 = std::f64::consts::FRAC_PI_2;

    fn half_angle(cone: NormalCone) -> f64 {
        (f64::from(cone.sine) / SINE_STEPS).asin()
    }

    /// By arc tangents: an angle near 0 or 180 degrees is as exact as any.
    fn angle(a: Vector, b: Vector) -> f64 {
        let across = crate::vector::cross(a, b);
        dot(across, across).sqrt().atan2(dot(a, b))
    }

    fn cone_angle(a: NormalCone, b: NormalCone) -> f64 {
        angle(a.axis.map(f64::from), b.axis.map(f64::from))
    }

    fn any_cone() -> impl Strategy<Value = NormalCone> {
        let direction = prop_oneof![
            4 => prop::array::uniform3(-1.0..1.0_f64),
            // Near each other, and along the axes.
            4 => prop::array::uniform3(0.9..1.0_f64),
            1 => (0..3_usize, any::<bool>()).prop_map(|(at, turned)| {
                std::array::from_fn(|axis| if axis != at { 0.0 } else if turned { -1.0 } else { 1.0 })
            }),
        ];
        let sine = prop_oneof![8 => 0..=254_u8, 2 => Just(0), 4 => 0..20_u8, 1 => Just(u8::MAX)];
        (direction, sine).prop_map(|(direction, sine)| match stored_axis(direction) {
            [0, 0, 0] => NormalCone::EVERYTHING,
            _ if sine == u8::MAX => NormalCone::EVERYTHING,
            axis => NormalCone { axis, sine },
        })
    }

    fn any_normals() -> impl Strategy<Value = Vec<Vector>> {
        let around = prop::array::uniform3(-1.0..1.0_f64);
        let spread = prop_oneof![Just(0.01), Just(0.5), Just(2.0), Just(0.0)];
        (around, spread, -100..100_i32, prop::collection::vec(prop::array::uniform3(-1.0..1.0_f64), 0..9)).prop_map(
            |(around, spread, exponent, offsets)| {
                let scale = 2.0_f64.powi(exponent);
                let normal = |offset: &Vector| std::array::from_fn(|at| (around[at] + spread * offset[at]) * scale);
                offsets.iter().map(normal).collect()
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 4000, ..ProptestConfig::default() })]

        #[test]
        fn the_cone_holds_both_and_is_little_wider_than_the_smallest(a in any_cone(), b in any_cone()) {
            let cone = enclosing_cone(a, b);
            let [half_a, half_b] = [a, b].map(half_angle);
            let is_everything = [a, b].map(|cone| cone.sine == u8::MAX).contains(&true);
            // The half-angle of the smallest cone about both, with angles.
            let between = cone_angle(a, b);
            let least = half_a.max(half_b).max((between + half_a + half_b) / 2.0);
            if cone == NormalCone::EVERYTHING {
                prop_assert!(is_everything || least > RIGHT_ANGLE - 0.15, "{} {}", least, RIGHT_ANGLE);
            } else {
                prop_assert!(!is_everything);
                prop_assert!(cone_angle(cone, a) + half_a <= half_angle(cone) + 1e-9);
                prop_assert!(cone_angle(cone, b) + half_b <= half_angle(cone) + 1e-9);
                // An axis is off by at most 0.87 / 127, the sine by a step.
                let widest = (least + 0.007).min(RIGHT_ANGLE).sin() * SINE_STEPS + 1.01;
                prop_assert!(f64::from(cone.sine) <= widest, "{} {}", cone.sine, widest);
            }
        }

        #[test]
        fn a_cone_inside_another_changes_nothing(a in any_cone(), b in any_cone()) {
            prop_assume!(a.sine != u8::MAX && b.sine != u8::MAX);
            if cone_angle(a, b) + half_angle(b) < half_angle(a) - 1e-7 {
                prop_assert_eq!(enclosing_cone(a, b), a);
                prop_assert_eq!(enclosing_cone(b, a), a);
            }
            prop_assert_eq!(enclosing_cone(a, a), a);
        }

        #[test]
        fn turned_round_the_cones_are_the_same(a in any_cone(), b in any_cone(), normals in any_normals()) {
            prop_assert_eq!(enclosing_cone(a.reversed(), b.reversed()), enclosing_cone(a, b).reversed());
            let turned = normals.iter().map(|normal| normal.map(|component| -component));
            prop_assert_eq!(leaf_cone(turned), leaf_cone(normals.iter().copied()).reversed());
        }

        #[test]
        fn the_cone_of_a_leaf_holds_its_normals(normals in any_normals()) {
            let cone = leaf_cone(normals.iter().copied());
            let axis = stored_axis(normals.iter().fold([0.0; 3], |sum, n| std::array::from_fn(|at| sum[at] + n[at])));
            let widest = normals.iter().map(|normal| angle(axis.map(f64::from), *normal)).fold(0.0, f64::max);
            if cone == NormalCone::EVERYTHING {
                prop_assert!(axis == [0; 3] || widest.sin() > 1.0 - 1e-6 || widest > RIGHT_ANGLE);
            } else {
                prop_assert_eq!(cone.axis, axis);
                prop_assert!(widest <= half_angle(cone) + 1e-9);
                prop_assert!(f64::from(cone.sine) < widest.sin() * SINE_STEPS + 1.01);
            }
        }
    }

    #[test]
    fn triangles_without_an_area_have_no_say() {
        let up = NormalCone { axis: [0, 0, 127], sine: 1 };
        assert_eq!(leaf_cone([[0.0; 3], [0.0, 0.0, 3.0], [0.0; 3]].into_iter()), up);
        assert_eq!(leaf_cone([[0.0; 3]].into_iter()), NormalCone::EVERYTHING);
        assert_eq!(leaf_cone(std::iter::empty()), NormalCone::EVERYTHING);
    }
}
