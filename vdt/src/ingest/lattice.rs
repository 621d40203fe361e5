//! Lattices of positions: the one that a mesh lies on, the one that it is rounded to, and which of them is taken.
//!
//! - *Its own.* Terrain in metres, voxels, what was quantised before: the largest step of which all coordinates, relative to
//!   the origin, are whole multiples, each by a number below 2^24. It is the greatest common divisor of the coordinates as
//!   exact binary fractions, odd number times power of two, so it depends on no order. What has no such step is mostly
//!   known by its first few vertices.
//! - *Of n bits.* The step is the longest side of the box over 2^n - 1, rounded up to single precision. The origin is the
//!   middle of the box, rounded to a power of two of at most a quarter of the step, so that it has few bits of its own; the
//!   numbers of all positions then lie within 2^(n-1) on both sides of it.
//!
//! Everything here scales exactly with powers of two. Rounding to a lattice comes before everything else: welds, triangles
//! without area, bounds and errors are those of the rounded mesh.
//!
//! Memory: nothing. I/O: where something needs to know the mesh's own lattice, the vertices are read once more, until it is
//! known that there is none.

use std::fmt;
use std::str::FromStr;

use super::frame::{Bounds, Frame, exponent_above, lattice_numbers, power_of_two};
use crate::tree::{LARGEST_NUMBER, ParsePositionsError, Positions};

/// How positions are asked to be kept.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum PositionsRule {
    /// Lossless where the mesh has a lattice of its own; else by so many bits, 16 or more, that a step of the lattice is
    /// at most 1/32 of the length of the edges, as the box and the number of triangles let it be estimated; lossless
    /// where no lattice is so fine.
    #[default]
    Auto,
    /// As it says. Bits are the most that the lattice may have: a mesh with a lattice of its own that has no more is
    /// kept on that, lossless.
    Fixed(Positions),
}

impl PositionsRule {
    /// Every position as it is.
    pub const LOSSLESS: PositionsRule = PositionsRule::Fixed(Positions::Lossless);
}

impl fmt::Display for PositionsRule {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PositionsRule::Auto => out.pad("auto"),
            PositionsRule::Fixed(positions) => positions.fmt(out),
        }
    }
}

impl FromStr for PositionsRule {
    type Err = ParsePositionsError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text == "auto" { Ok(PositionsRule::Auto) } else { text.parse().map(PositionsRule::Fixed) }
    }
}

/// The fewest bits that are chosen where nothing is asked for.
const FEWEST_BITS: u8 = 16;
/// How many steps the length of an edge has at least where nothing is asked for.
const STEPS_OF_AN_EDGE: f64 = 32.0;

/// Where positions are rounded to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lattice {
    pub origin: [f64; 3],
    pub step: f32,
}

impl Lattice {
    /// The lattice of so many bits over this box, which has an extent. None where the step is no normal single-precision
    /// number, where single precision does not reach a corner of the box, or where double precision has no number near
    /// enough to the middle of it.
    pub fn over(bounds: &Bounds, bits: u8) -> Option<Lattice> {
        let steps = f64::from((1_u32 << bits) - 1);
        let exact = bounds.largest_extent() / steps;
        let nearest = exact as f32;
        let step = if f64::from(nearest) < exact { nearest.next_up() } else { nearest };
        if !step.is_normal() {
            return None;
        }
        // At most a quarter of the step.
        let unit = power_of_two(exponent_above(f64::from(step)) - 3);
        let origin = std::array::from_fn(|axis| {
            let (minimum, maximum) = (bounds.minimum[axis], bounds.maximum[axis]);
            ((minimum + (maximum - minimum) * 0.5) / unit).round() * unit
        });
        let lattice = Lattice { origin, step };
        let largest = f64::from(LARGEST_NUMBER >> (Positions::BITS.end() - bits));
        let numbers = [bounds.minimum, bounds.maximum].map(|corner| lattice_numbers(corner, origin, step));
        let is_within = numbers.iter().flatten().all(|number| number.abs() <= largest);
        let local = Frame::on(lattice).local_bounds(bounds);
        (is_within && local.iter().flatten().all(|value| value.is_finite())).then_some(lattice)
    }
}

/// What was chosen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Choice {
    pub frame: Frame,
    /// How positions are kept.
    pub positions: Positions,
    /// The step of the lattice that they are on; 0 where there is none.
    pub step: f32,
}

/// Chooses how positions are kept, for a mesh of so many triangles with this box, which has an extent. `single` is its
/// frame without a lattice, `own_step` that of the mesh's own lattice in there, or 0. The error is the number of bits of
/// the lattice that was asked for and cannot be.
pub(super) fn choose(
    rule: PositionsRule,
    single: Frame,
    own_step: f32,
    bounds: &Bounds,
    triangles: u64,
) -> Result<Choice, u8> {
    let lossless = Choice { frame: single, positions: Positions::Lossless, step: own_step };
    let rounded = |lattice: Lattice, bits| Choice {
        frame: Frame::on(lattice),
        positions: Positions::Bits(bits),
        step: lattice.step,
    };
    match rule {
        PositionsRule::Fixed(Positions::Lossless) => Ok(lossless),
        PositionsRule::Auto => {
            if own_step > 0.0 {
                return Ok(lossless);
            }
            let most = edge_length(bounds, triangles) / STEPS_OF_AN_EDGE;
            let lattices =
                (FEWEST_BITS..=*Positions::BITS.end()).filter_map(|bits| Some((Lattice::over(bounds, bits)?, bits)));
            let fine = lattices.into_iter().find(|(lattice, _)| f64::from(lattice.step) <= most);
            Ok(fine.map_or(lossless, |(lattice, bits)| rounded(lattice, bits)))
        }
        PositionsRule::Fixed(Positions::Bits(bits)) => {
            if !Positions::BITS.contains(&bits) {
                return Err(bits);
            }
            let steps = f64::from((1_u32 << bits) - 1);
            if own_step > 0.0 && bounds.largest_extent() <= steps * f64::from(own_step) {
                return Ok(lossless);
            }
            Lattice::over(bounds, bits).map(|lattice| rounded(lattice, bits)).ok_or(bits)
        }
    }
}

/// About how long the edges of so many triangles are, if they are equilateral and cover half of the box's surface.
fn edge_length(bounds: &Bounds, triangles: u64) -> f64 {
    /// 4 / sqrt(3): the square of the side of an equilateral triangle over its area.
    const SQUARE_OVER_AREA: f64 = 2.309_401_076_758_503;
    let [x, y, z] = [0, 1, 2].map(|axis| bounds.maximum[axis] - bounds.minimum[axis]);
    (SQUARE_OVER_AREA * (x * y + y * z + z * x) / triangles.max(1) as f64).sqrt()
}

/// Finds the step of a mesh's own lattice, from positions in any order.
#[derive(Debug, Clone, Copy)]
pub(super) struct OwnLattice {
    /// The greatest common divisor so far, as an odd number times a power of two; 0 before the first coordinate that
    /// is not 0.
    odd: u32,
    exponent: i32,
    /// The largest coordinate so far.
    largest: f32,
}

impl OwnLattice {
    pub const EMPTY: OwnLattice = OwnLattice { odd: 0, exponent: 0, largest: 0.0 };

    /// Takes a position. Whether there can still be a lattice: once there is none, there never will be.
    #[inline]
    pub fn include(&mut self, position: [f32; 3]) -> bool {
        let before = *self;
        for coordinate in position {
            if coordinate != 0.0 {
                self.take(coordinate);
            }
        }
        self.odd == before.odd && self.exponent == before.exponent && self.largest == before.largest
            || self.is_fine_enough()
    }

    #[inline]
    fn take(&mut self, coordinate: f32) {
        let bits = coordinate.to_bits();
        let (field, fraction) = (bits >> 23 & 0xff, bits & ((1 << 23) - 1));
        let (mantissa, exponent) = if field == 0 { (fraction, -149) } else { (fraction | 1 << 23, field as i32 - 150) };
        let zeros = mantissa.trailing_zeros();
        let (odd, exponent) = (mantissa >> zeros, exponent + zeros as i32);
        self.exponent = if self.odd == 0 { exponent } else { self.exponent.min(exponent) };
        if self.odd != 1 && (self.odd == 0 || odd % self.odd != 0) {
            self.odd = greatest_common_divisor(odd, self.odd);
        }
        self.largest = self.largest.max(coordinate.abs());
    }

    fn is_fine_enough(&self) -> bool {
        let step = f64::from(self.odd) * power_of_two(self.exponent);
        f64::from(self.largest) < step * f64::from(2 * LARGEST_NUMBER)
    }

    /// The step, or 0 where there is no lattice whose step is a normal number.
    pub fn step(&self) -> f32 {
        // Exact: an odd number of 24 bits, within the range that is asked for.
        let step = (f64::from(self.odd) * power_of_two(self.exponent)) as f32;
        if step.is_normal() && self.is_fine_enough() { step } else { 0.0 }
    }
}

fn greatest_common_divisor(mut left: u32, mut right: u32) -> u32 {
    while right != 0 {
        (left, right) = (right, left % right);
    }
    left
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::tree::{lattice_number, on_lattice};

    fn own(positions: &[[f32; 3]]) -> f32 {
        let mut own = OwnLattice::EMPTY;
        let all = positions.iter().all(|position| own.include(*position));
        assert!(all || own.step() == 0.0);
        own.step()
    }

    #[test]
    fn a_lattice_that_is_there_is_found() {
        assert_eq!(own(&[[30.0, -60.0, 90.0], [0.0, 0.0, 150.0]]), 30.0);
        assert_eq!(own(&[[30.0, -60.0, 90.0], [0.0, 45.5, 150.0]]), 0.5);
        assert_eq!(own(&[[0.0; 3]]), 0.0);
        assert_eq!(own(&[[0.1, 0.2, 0.4]]), 0.1);
        assert_eq!(own(&[[0.1, 0.2, 0.3]]), 0.0);
        assert_eq!(own(&[[16_777_215.0, 1.0, 0.0]]), 1.0);
        assert_eq!(own(&[[16_777_216.0, 1.0, 0.0]]), 0.0);
        assert_eq!(own(&[[f32::from_bits(1), f32::from_bits(3), 0.0]]), 0.0);
        assert_eq!(own(&[[f32::MAX, -f32::MAX, 0.0]]), f32::MAX);
    }

    #[test]
    fn the_rule_is_written_as_people_write_it() {
        assert_eq!("auto".parse(), Ok(PositionsRule::Auto));
        assert_eq!("16".parse(), Ok(PositionsRule::Fixed(Positions::Bits(16))));
        assert_eq!("lossless".parse(), Ok(PositionsRule::LOSSLESS));
        assert!("9".parse::<PositionsRule>().is_err());
        for rule in [PositionsRule::Auto, PositionsRule::LOSSLESS, PositionsRule::Fixed(Positions::Bits(24))] {
            assert_eq!(rule.to_string().parse(), Ok(rule));
        }
    }

    fn choice(rule: PositionsRule, bounds: &Bounds, own_step: f32, triangles: u64) -> Result<(Positions, f32), u8> {
        choose(rule, Frame::single(bounds), own_step, bounds, triangles).map(|choice| (choice.positions, choice.step))
    }

    fn cube(size: f64) -> Bounds {
        Bounds { minimum: [0.0; 3], maximum: [size; 3] }
    }

    #[test]
    fn what_is_asked_for_is_chosen_or_refused() {
        let fixed = |bits| PositionsRule::Fixed(Positions::Bits(bits));
        assert_eq!(choice(fixed(10), &cube(1023.0), 0.0, 1), Ok((Positions::Bits(10), 1.0)));
        // Its own lattice, where it has no more steps.
        assert_eq!(choice(fixed(10), &cube(1023.0), 1.0, 1), Ok((Positions::Lossless, 1.0)));
        assert_eq!(
            choice(fixed(10), &cube(1024.0), 1.0, 1),
            Ok((Positions::Bits(10), (1024.0 / 1023.0_f32).next_up()))
        );
        assert_eq!(choice(PositionsRule::LOSSLESS, &cube(1.0), 0.0, 1), Ok((Positions::Lossless, 0.0)));
        // Steps below single precision, corners beyond it.
        assert_eq!(choice(fixed(24), &cube(1e-36), 0.0, 1), Err(24));
        assert_eq!(choice(fixed(24), &cube(1e-30), 0.0, 1).map(|(positions, _)| positions), Ok(Positions::Bits(24)));
        let whole = Bounds { minimum: [-f64::from(f32::MAX); 3], maximum: [f64::from(f32::MAX) * 0.9997; 3] };
        assert_eq!(choice(fixed(10), &whole, 0.0, 1), Err(10));
        assert_eq!(choice(fixed(9), &cube(1.0), 0.0, 1), Err(9));
        // Double precision is too coarse there for the middle of the box.
        let far = Bounds { minimum: [1e15; 3], maximum: [1e15 + 0.125; 3] };
        assert_eq!(choice(fixed(24), &far, 0.0, 1), Err(24));
    }

    #[test]
    fn bits_follow_the_length_of_the_edges() {
        let bits = |triangles| choice(PositionsRule::Auto, &cube(1.0), 0.0, triangles).unwrap().0;
        assert_eq!(bits(12), Positions::Bits(16));
        assert_eq!(bits(20_000_000), Positions::Bits(16));
        assert_eq!(bits(40_000_000), Positions::Bits(17));
        assert_eq!(bits(4_000_000_000), Positions::Bits(20));
        // Nearly on a line: there is no lattice fine enough.
        let line = Bounds { minimum: [0.0; 3], maximum: [1.0, 1e-14, 0.0] };
        assert_eq!(choice(PositionsRule::Auto, &line, 0.0, 1000), Ok((Positions::Lossless, 0.0)));
        assert_eq!(choice(PositionsRule::Auto, &cube(1e-36), 0.0, 12), Ok((Positions::Lossless, 0.0)));
        assert_eq!(choice(PositionsRule::Auto, &cube(1.0), 0.25, 12), Ok((Positions::Lossless, 0.25)));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn a_lattice_holds_its_box_and_moves_no_coordinate_by_more_than_half_a_step(
            size in prop::array::uniform3(prop_oneof![Just(0.0), Just(1.0), 0.0..1.0_f64]),
            longest in 0..3_usize,
            scale in prop_oneof![Just(1.0), Just(1e-27), Just(1e30), Just(1e-3), 1e-5..1e5_f64],
            far in prop_oneof![2 => Just(0.0), 1 => -10.0..10.0_f64, 1 => Just(4.3e6)],
            bits in Positions::BITS,
            places in prop::collection::vec(prop::array::uniform3(0.0..1.0_f64), 1..20),
            power in -3..20_i32,
        ) {
            let mut size = size;
            size[longest] = 1.0;
            let minimum = [far * scale, -far * scale, 0.0];
            let bounds = Bounds { minimum, maximum: std::array::from_fn(|axis| minimum[axis] + size[axis] * scale) };
            let lattice = Lattice::over(&bounds, bits);
            prop_assert!(lattice.is_some());
            let Some(lattice) = lattice else { return Ok(()) };
            let step = f64::from(lattice.step);
            prop_assert!(bounds.largest_extent() / step <= f64::from((1_u32 << bits) - 1) * (1.0 + 1e-15));
            let frame = Frame::on(lattice);
            let larger = power_of_two(power);
            let scaled = Bounds { minimum: bounds.minimum.map(|v| v * larger), maximum: bounds.maximum.map(|v| v * larger) };
            let scaled_frame = Frame::on(Lattice::over(&scaled, bits).unwrap());
            let inside = |place: &[f64; 3]| std::array::from_fn(|axis| {
                let (from, to) = (bounds.minimum[axis], bounds.maximum[axis]);
                (from + (to - from) * place[axis]).clamp(from, to)
            });
            for position in places.iter().map(inside).chain([bounds.minimum, bounds.maximum]) {
                let local = frame.local(position);
                for axis in 0..3 {
                    let number = lattice_number(local[axis], lattice.step).unwrap();
                    prop_assert!(number.unsigned_abs() <= 1 << (bits - 1));
                    prop_assert_eq!(on_lattice(number, lattice.step).to_bits(), local[axis].to_bits());
                    let moved = (position[axis] - lattice.origin[axis] - f64::from(local[axis])).abs();
                    // Half a step, and the rounding of the product.
                    prop_assert!(moved <= step * (0.5 + 2.0_f64.powi(i32::from(bits) - 25)) * (1.0 + 1e-6), "{}", moved / step);
                }
                let scaled = scaled_frame.local(position.map(|value| value * larger));
                prop_assert_eq!(scaled.map(f64::from), local.map(|value| f64::from(value) * larger));
            }
        }

        #[test]
        fn the_step_of_any_lattice_is_found(
            step_bits in 1_u32..1 << 24,
            power in -120..80_i32,
            numbers in prop::collection::vec(prop::array::uniform3(-3000..3000_i32), 1..20),
        ) {
            // Products of 12 and 12 bits are exact.
            let step = (f64::from(step_bits % 4096 + 1) * power_of_two(power)) as f32;
            let positions: Vec<[f32; 3]> =
                numbers.iter().map(|n| n.map(|number| number as f32 * step)).collect();
            let found = own(&positions);
            let divisor = numbers.iter().flatten().fold(0_u32, |divisor, n| greatest_common_divisor(divisor, n.unsigned_abs()));
            prop_assert_eq!(found, divisor as f32 * step);
            for coordinate in positions.iter().flatten().filter(|_| divisor > 0) {
                let number = lattice_number(*coordinate, found).unwrap();
                prop_assert_eq!(f64::from(number) * f64::from(found), f64::from(*coordinate));
            }
            let reversed: Vec<_> = positions.iter().rev().map(|[x, y, z]| [*z, *x, *y]).collect();
            prop_assert_eq!(own(&reversed), found);
        }
    }
}
