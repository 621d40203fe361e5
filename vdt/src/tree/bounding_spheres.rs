//! Nested bounding spheres: about the position of each node, round all leaves under it and round its children's spheres.
//!
//! radius(p) = max(radius(kept child), distance to the born child + its radius): the kept child stands where its parent
//! does. A leaf's radius is 0. Worked out with each collapse, from the values of the two nodes that it unites.

use crate::vector::rounded_up;

/// Radius of the bounding sphere of a new node, in mesh units, from the positions of its kept and its born child and the
/// radii of their spheres. Rounded up, so that "inside" is true of the stored numbers.
#[inline]
pub fn enclosing_radius(kept_at: [f32; 3], kept_radius: f32, born_at: [f32; 3], born_radius: f32) -> f32 {
    let [from, to] = [kept_at, born_at].map(|position| position.map(f64::from));
    let square: f64 = (0..3).map(|axis| (to[axis] - from[axis]) * (to[axis] - from[axis])).sum();
    rounded_up(f64::from(kept_radius).max(square.sqrt() + f64::from(born_radius)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn distance(a: [f32; 3], b: [f32; 3]) -> f64 {
        let square: f64 = (0..3).map(|axis| (f64::from(b[axis]) - f64::from(a[axis])).powi(2)).sum();
        square.sqrt()
    }

    proptest! {
        #[test]
        fn the_sphere_holds_both_spheres_and_no_more(
            kept in prop::array::uniform3(-1e3..1e3_f32), born in prop::array::uniform3(-1e3..1e3_f32),
            kept_radius in 0.0..1e4_f32, born_radius in 0.0..1e4_f32,
        ) {
            let radius = enclosing_radius(kept, kept_radius, born, born_radius);
            let least = f64::from(kept_radius).max(distance(kept, born) + f64::from(born_radius));
            prop_assert!(least <= f64::from(radius));
            prop_assert!(f64::from(radius.next_down()) < least);
        }
    }

    #[test]
    fn radii_stay_numbers() {
        assert_eq!(enclosing_radius([0.0; 3], 0.0, [0.0; 3], 0.0), 0.0);
        assert_eq!(enclosing_radius([-f32::MAX; 3], 0.0, [f32::MAX; 3], 0.0), f32::MAX);
    }
}
