//! The frame of a mesh: its local origin, its power of two, and the grid of its Morton codes.
//!
//! - *Local origin.* Where the box of the mesh lies so far from zero, on some axis, that single precision would lose
//!   detail, a point of it is subtracted on that axis. The origin is a multiple of a power of two as large as the box,
//!   so for coordinates that were single precision to begin with the subtraction is exact.
//! - *Single precision*, the same for every file format; -0.0 becomes 0.0. How far that moves a vertex at most is noted.
//! - Or, instead of both, a *lattice* over the box, whose origin is near its middle (module `lattice`).
//! - *Normalisation* by a power of two: exact, so that a mesh scaled by 1024 gives the same tree bit by bit. No absolute
//!   tolerance is used anywhere.
//!
//! The box is that of the vertices which faces name: one format keeps the others, another does not. Taking a coordinate
//! into the frame is monotone along each axis (so are both roundings), hence the corners of the box, taken into the
//! frame, are the corners of the box in the frame: nobody has to look at all vertices twice.

use super::lattice::Lattice;
use super::morton;
use crate::tree::on_lattice;
use crate::vector::length;

/// A box that grows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub minimum: [f64; 3],
    pub maximum: [f64; 3],
}

impl Bounds {
    pub const EMPTY: Bounds = Bounds { minimum: [f64::INFINITY; 3], maximum: [f64::NEG_INFINITY; 3] };

    pub fn of(positions: impl Iterator<Item = [f64; 3]>) -> Self {
        let mut bounds = Bounds::EMPTY;
        positions.for_each(|position| bounds.include(position));
        bounds
    }

    #[inline]
    pub fn include(&mut self, position: [f64; 3]) {
        for axis in 0..3 {
            self.minimum[axis] = self.minimum[axis].min(position[axis]);
            self.maximum[axis] = self.maximum[axis].max(position[axis]);
        }
    }

    pub fn largest_extent(&self) -> f64 {
        (0..3).map(|axis| self.maximum[axis] - self.minimum[axis]).fold(0.0, f64::max)
    }
}

/// How many times the extent of the mesh its box may lie from zero before an origin is subtracted. Up to here single
/// precision loses at most three of its 24 bits; from here on the subtraction is exact for single-precision input.
const FAR_FROM_ZERO: f64 = 8.0;

/// How a coordinate of the files becomes one of the mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    /// What is subtracted from each position, in mesh units.
    pub origin: [f64; 3],
    /// The step of the lattice that what is left is rounded to; 0 where it is rounded to single precision only.
    pub step: f32,
}

impl Frame {
    /// The frame of a mesh with this box that rounds to single precision only.
    pub fn single(bounds: &Bounds) -> Frame {
        Frame { origin: local_origin(bounds), step: 0.0 }
    }

    /// The frame that rounds to a lattice.
    pub fn on(lattice: Lattice) -> Frame {
        Frame { origin: lattice.origin, step: lattice.step }
    }

    /// Whether it rounds to a lattice.
    pub fn is_on_lattice(&self) -> bool {
        self.step > 0.0
    }

    /// A position in the frame. Infinite where single precision does not reach.
    #[inline]
    pub fn local(&self, position: [f64; 3]) -> [f32; 3] {
        if self.is_on_lattice() {
            lattice_numbers(position, self.origin, self.step).map(|number| on_lattice(number as i32, self.step))
        } else {
            // Adding 0.0 turns -0.0 into 0.0.
            std::array::from_fn(|axis| (position[axis] - self.origin[axis]) as f32 + 0.0)
        }
    }

    /// The box in the frame of a mesh with this one in the files.
    pub fn local_bounds(&self, bounds: &Bounds) -> [[f32; 3]; 2] {
        [bounds.minimum, bounds.maximum].map(|corner| self.local(corner))
    }
}

/// The numbers of the point of a lattice that is nearest to a position, along each axis.
#[inline]
pub(super) fn lattice_numbers(position: [f64; 3], origin: [f64; 3], step: f32) -> [f64; 3] {
    std::array::from_fn(|axis| ((position[axis] - origin[axis]) / f64::from(step)).round())
}

/// What to subtract from the coordinates of a mesh with this box.
fn local_origin(bounds: &Bounds) -> [f64; 3] {
    let extent = bounds.largest_extent();
    if !(extent > 0.0 && extent.is_finite()) {
        return [0.0; 3];
    }
    let step = power_of_two(exponent_above(extent));
    std::array::from_fn(|axis| {
        let (minimum, maximum) = (bounds.minimum[axis], bounds.maximum[axis]);
        if minimum.abs().max(maximum.abs()) <= FAR_FROM_ZERO * extent {
            0.0
        } else {
            ((minimum + (maximum - minimum) * 0.5) / step).round() * step
        }
    })
}

/// How far positions are moved by single precision, or by a lattice.
///
/// Without a lattice each difference here is exact: a position and the origin are within a factor of two of each other on
/// each axis where there is an origin, and what single precision leaves of a number is less than what double precision
/// holds of it. The origin of a lattice is any number; there each difference from it counts with what its rounding may
/// have hidden.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Rounding {
    /// The largest distance so far, in mesh units, but for the rounding of its own square root.
    pub largest: f64,
}

impl Rounding {
    /// Takes a position, and what it became in the frame.
    #[inline]
    pub fn include(&mut self, position: [f64; 3], frame: &Frame, local: [f32; 3]) {
        let hidden = if frame.is_on_lattice() { f64::EPSILON } else { 0.0 };
        let moved = [0, 1, 2].map(|axis| {
            let exact = position[axis] - frame.origin[axis];
            (exact - f64::from(local[axis])).abs() + exact.abs() * hidden
        });
        if moved != [0.0; 3] {
            self.largest = self.largest.max(length(moved));
        }
    }
}

/// The power of two of a mesh and the grid of its Morton codes: 2^21 cells along the longest axis, so that the order of the
/// codes does not depend on the scale of the mesh, but for the rounding of positions.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    /// The mesh is at most 2^exponent wide along every axis.
    pub exponent: i32,
    minimum: [f64; 3],
    cells_per_unit: f64,
}

impl Grid {
    /// The grid of a mesh whose local positions have this box; none if the box is a point, or empty.
    pub fn of(bounds: &Bounds) -> Option<Grid> {
        let extent = bounds.largest_extent();
        (extent > 0.0).then(|| {
            let exponent = exponent_above(extent);
            Grid { exponent, minimum: bounds.minimum, cells_per_unit: f64::from(1 << 21) / extent }
        })
    }

    /// The Morton code of a local position.
    #[inline]
    pub fn code(&self, position: [f32; 3]) -> u64 {
        morton::code(position.map(f64::from), self.minimum, self.cells_per_unit)
    }
}

/// The smallest power of two that is at least `extent`, as an exponent. `extent` is positive and finite.
pub(super) fn exponent_above(extent: f64) -> i32 {
    // The exponent field of a normal f64: below it lie the powers of two that are too small.
    let bits = extent.to_bits();
    let floor = ((bits >> 52) as i32) - 1023;
    floor + i32::from(bits & ((1 << 52) - 1) != 0)
}

/// 2^exponent, exactly. Out of f64's range it is 0 or infinite.
pub(crate) fn power_of_two(exponent: i32) -> f64 {
    match exponent {
        -1022..=1023 => f64::from_bits(((exponent + 1023) as u64) << 52),
        ..-1022 => power_of_two(exponent + 512) * power_of_two(-512),
        1024.. => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn powers_of_two() {
        for (extent, exponent) in [(1.0, 0), (1.5, 1), (2.0, 1), (0.75, 0), (1e-30, -99), (1e30, 100)] {
            assert_eq!(exponent_above(extent), exponent, "{extent}");
            assert!(power_of_two(exponent) >= extent && power_of_two(exponent - 1) < extent);
        }
    }

    proptest! {
        #[test]
        fn the_box_goes_into_the_frame_as_its_corners_do(
            positions in prop::collection::vec(prop::array::uniform3(-1e3..1e3), 1..20),
            scale in prop_oneof![Just(1.0), Just(1e-30), Just(1e30), Just(3.7)],
            far in prop_oneof![Just(0.0), Just(1e5), Just(-4.3e6)],
        ) {
            let positions: Vec<[f64; 3]> =
                positions.iter().map(|p: &[f64; 3]| p.map(|value| (value + far) * scale)).collect();
            let bounds = Bounds::of(positions.iter().copied());
            let frames = [Some(Frame::single(&bounds)), Lattice::over(&bounds, 12).map(Frame::on)];
            for frame in frames.into_iter().flatten() {
                let all = Bounds::of(positions.iter().map(|p| frame.local(*p).map(f64::from)));
                let [minimum, maximum] = frame.local_bounds(&bounds).map(|corner| corner.map(f64::from));
                prop_assert_eq!(minimum, all.minimum);
                prop_assert_eq!(maximum, all.maximum);
            }
        }
    }
}
