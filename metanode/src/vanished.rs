//! The parts of a mesh that are not drawn at all, and how far their points are from what is drawn.
//!
//! A tree of which no triangle is active has vanished whole: nothing that is drawn stands for it. The root's switch value is
//! no less than the tree's diameter ([`vdt::tree::Split::switch`]), up to its rounding, and the root stands on it; so none
//! of its points is farther from there. Nor is one outside of the bounding sphere, which holds its leaves and so, being
//! convex, the triangles between them. The smaller of the two is the *reach* of the part. So no point is farther from the
//! surface drawn than the root is from the nearest vertex of that surface, plus the reach.
//!
//! The vertices drawn pass by once, in any order. The roots of the parts are in a tree of boxes; each box keeps the largest
//! distance from one of its roots to its nearest vertex so far. A vertex that is farther from the box than that is nearer
//! to none of the roots in it.
//!
//! RAM: 31 bytes for each part, whatever is drawn.

use vdt::tree::{length_not_below, rounded_up};

use crate::header::ModelRoot;

/// Parts in a box that is not divided further.
const PARTS_IN_A_BOX: usize = 8;

/// More than what rounding to the nearest single-precision number can have taken from a switch value.
const SWITCH_ROUNDING: f64 = 1.0 + 1.0 / (1 << 22) as f64;

/// A part that is not drawn.
#[derive(Debug, Clone, Copy)]
struct Part {
    position: [f32; 3],
    /// No point of the part is farther from there.
    reach: f32,
    /// Square of the distance from there to the nearest vertex so far.
    square: f64,
}

/// A box around the roots of some parts, a range of them.
#[derive(Debug, Clone, Copy)]
struct PartBox {
    first: u32,
    end: u32,
    minimum: [f32; 3],
    maximum: [f32; 3],
    /// The largest square of a distance in it.
    square: f64,
    /// The second of the two boxes that it is divided into, which stand behind it; 0: it is not divided.
    second: u32,
}

/// The parts that are not drawn, and the distances to what is, while it passes by.
#[derive(Debug, Clone, Default)]
pub struct VanishedParts {
    parts: Vec<Part>,
    /// The boxes in preorder.
    boxes: Vec<PartBox>,
    diameter: f64,
}

impl VanishedParts {
    /// These trees have vanished.
    pub fn new<'a>(roots: impl Iterator<Item = &'a ModelRoot>) -> Self {
        let (mut parts, mut diameter) = (Vec::new(), 0.0_f64);
        for ModelRoot { position, radius, switch, .. } in roots {
            let most = f64::from(*switch) * SWITCH_ROUNDING;
            diameter = diameter.max(most.min(2.0 * f64::from(*radius)));
            let reach = rounded_up(most.min(f64::from(*radius)));
            parts.push(Part { position: *position, reach, square: f64::INFINITY });
        }
        let mut vanished = VanishedParts { parts, boxes: Vec::new(), diameter };
        if !vanished.parts.is_empty() {
            vanished.divide(0, vanished.parts.len());
        }
        vanished
    }

    /// Puts a box around these parts, and divides it along its longest side.
    fn divide(&mut self, first: usize, end: usize) {
        let parts = &mut self.parts[first..end];
        let (mut minimum, mut maximum) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for part in parts.iter() {
            for axis in 0..3 {
                minimum[axis] = minimum[axis].min(part.position[axis]);
                maximum[axis] = maximum[axis].max(part.position[axis]);
            }
        }
        let index = self.boxes.len();
        let (from, to) = (first as u32, end as u32);
        self.boxes.push(PartBox { first: from, end: to, minimum, maximum, square: f64::INFINITY, second: 0 });
        if parts.len() > PARTS_IN_A_BOX {
            let side = |axis: usize| f64::from(maximum[axis]) - f64::from(minimum[axis]);
            let longest = (1..3).fold(0, |longest, axis| if side(axis) > side(longest) { axis } else { longest });
            let middle = parts.len() / 2;
            parts.select_nth_unstable_by(middle, |a, b| a.position[longest].total_cmp(&b.position[longest]));
            self.divide(first, first + middle);
            self.boxes[index].second = self.boxes.len() as u32;
            self.divide(first + middle, end);
        }
    }

    /// How many there are.
    pub fn count(&self) -> u32 {
        self.parts.len() as u32
    }

    /// No part is larger across than this, in mesh units: the largest of their switch values, or of the diameters of their
    /// bounding spheres where that is less. 0 without parts.
    pub fn diameter(&self) -> f32 {
        length_not_below(self.diameter)
    }

    /// Takes a vertex of a triangle that is drawn, in mesh units relative to the model's origin.
    #[inline]
    pub fn pass(&mut self, vertex: [f32; 3]) {
        if !self.boxes.is_empty() {
            self.lower(0, vertex);
        }
    }

    /// Lowers the distances of the parts in a box to that of a vertex.
    fn lower(&mut self, index: usize, vertex: [f32; 3]) {
        let PartBox { first, end, minimum, maximum, square, second } = self.boxes[index];
        // Rounding is monotone, so by the same operations no root in the box is found to be nearer than the box.
        let nearest = [0, 1, 2].map(|axis| vertex[axis].clamp(minimum[axis], maximum[axis]));
        if square_distance(nearest, vertex) >= square {
            return;
        }
        self.boxes[index].square = if second > 0 {
            let (first, second) = (index + 1, second as usize);
            self.lower(first, vertex);
            self.lower(second, vertex);
            self.boxes[first].square.max(self.boxes[second].square)
        } else {
            let parts = &mut self.parts[first as usize..end as usize];
            parts.iter_mut().for_each(|part| part.square = part.square.min(square_distance(part.position, vertex)));
            parts.iter().map(|part| part.square).fold(0.0, f64::max)
        };
    }

    /// No point of the parts is farther than this from the surface that passed by, in mesh units. `None` where there are
    /// parts, but nothing passed by; 0 where there are none.
    pub fn distance(&self) -> Option<f32> {
        let distances = self.parts.iter().map(|part| part.square.sqrt() + f64::from(part.reach));
        let largest = distances.fold(0.0, f64::max);
        largest.is_finite().then(|| length_not_below(largest))
    }
}

fn square_distance(from: [f32; 3], to: [f32; 3]) -> f64 {
    let square = |axis: usize| {
        let difference = f64::from(to[axis]) - f64::from(from[axis]);
        difference * difference
    };
    square(0) + square(1) + square(2)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vdt::tree::{Normal, NormalCone};

    use super::*;
    use crate::page::PageLocation;

    fn root(position: [f32; 3], radius: f32, switch: f32) -> ModelRoot {
        let page = PageLocation { number: 0, offset: 0, length: 0 };
        let (cone, normal, is_inward) = (NormalCone::EVERYTHING, Normal::UP, false);
        ModelRoot { start: 0, end: 2, position, normal, is_inward, id: 2, switch, radius, cone, record: 0, page }
    }

    proptest! {
        #[test]
        fn the_distance_is_that_of_all_pairs(
            parts in prop::collection::vec((prop::array::uniform3(-9.0..9.0_f32), 0.0..2.0_f32, 0.1..4.0_f32), 0..120),
            vertices in prop::collection::vec(prop::array::uniform3(-9.0..9.0_f32), 0..60),
            scale in prop_oneof![Just(1.0_f32), Just(1e-30), Just(1e30)],
            flat: bool,
        ) {
            let place = |[x, y, z]: [f32; 3]| [x * scale, y * scale, if flat { 0.0 } else { z * scale }];
            let roots: Vec<ModelRoot> =
                parts.iter().map(|(at, radius, switch)| root(place(*at), radius * scale, switch * scale)).collect();
            let mut vanished = VanishedParts::new(roots.iter());
            vertices.iter().for_each(|vertex| vanished.pass(place(*vertex)));
            prop_assert_eq!(vanished.count() as usize, roots.len());
            let largest = roots.iter().map(|root| root.switch.min(2.0 * root.radius)).fold(0.0, f32::max);
            prop_assert!(vanished.diameter() >= largest && vanished.diameter() <= largest * 1.000_001);

            let to_nearest = |root: &ModelRoot| {
                let squares = vertices.iter().map(|vertex| square_distance(root.position, place(*vertex)));
                squares.fold(f64::INFINITY, f64::min).sqrt() + f64::from(root.radius.min(root.switch))
            };
            let expected = roots.iter().map(to_nearest).fold(0.0, f64::max);
            match vanished.distance() {
                None => prop_assert!(expected.is_infinite()),
                Some(distance) => {
                    prop_assert!(f64::from(distance) >= expected, "{} < {}", distance, expected);
                    prop_assert!(f64::from(distance) <= expected * (1.0 + 1e-6), "{} > {}", distance, expected);
                }
            }
        }
    }
}
