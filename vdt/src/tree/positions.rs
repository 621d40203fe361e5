//! How positions are kept, and what a lattice of positions is.
//!
//! A lattice has a *step*, an f32. A coordinate on it is the product of a whole number and the step, rounded once, as IEEE
//! 754 multiplies single-precision numbers. The number is found again from the coordinate: it is the nearest to their
//! quotient. That holds up to [`LARGEST_NUMBER`]: half a unit in the last place is 2^-24 of a product at most, so the
//! quotient is less than 1/2 away from the number. And it holds up to twice that where the product needs no rounding.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// How the positions of a mesh are kept.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Positions {
    /// In single precision, each as it is.
    #[default]
    Lossless,
    /// Rounded to a lattice that has fewer than 2^bits steps along the longest axis of the mesh's box.
    Bits(u8),
}

/// What is no way to keep positions.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("positions are not kept as `{text}`; there are lossless, and 10 to 24 for so many bits along the longest axis")]
pub struct ParsePositionsError {
    text: String,
}

impl Positions {
    /// The bits that a lattice may have: below, meshes fall apart; above, single precision holds no more.
    pub const BITS: RangeInclusive<u8> = 10..=24;

    /// Whether the bits are among those that may be.
    pub fn is_valid(self) -> bool {
        match self {
            Positions::Lossless => true,
            Positions::Bits(bits) => Positions::BITS.contains(&bits),
        }
    }
}

impl fmt::Display for Positions {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Positions::Lossless => out.pad("lossless"),
            Positions::Bits(bits) => out.pad(&bits.to_string()),
        }
    }
}

impl FromStr for Positions {
    type Err = ParsePositionsError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let positions =
            if text == "lossless" { Some(Positions::Lossless) } else { text.parse().ok().map(Positions::Bits) };
        positions.filter(|positions| positions.is_valid()).ok_or_else(|| ParsePositionsError { text: text.to_owned() })
    }
}

/// The largest number of a coordinate, of either sign, on a lattice that positions are rounded to.
pub const LARGEST_NUMBER: u32 = 1 << 23;

/// The coordinate with this number on a lattice; never -0.0. The number is less than 2^24, of either sign.
#[inline]
pub fn on_lattice(number: i32, step: f32) -> f32 {
    number as f32 * step + 0.0
}

/// The number of a coordinate on a lattice, or `None` where it is not on it.
#[inline]
pub fn lattice_number(coordinate: f32, step: f32) -> Option<i32> {
    let number = (f64::from(coordinate) / f64::from(step)).round();
    let is_on_it = number.abs() < f64::from(2 * LARGEST_NUMBER) && on_lattice(number as i32, step) == coordinate;
    is_on_it.then_some(number as i32)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn positions_as_people_write_them() {
        for positions in Positions::BITS.map(Positions::Bits).chain([Positions::Lossless]) {
            assert_eq!(positions.to_string().parse(), Ok(positions));
        }
        for wrong in ["9", "25", "0", "16.0", "-16", "Lossless", "", "bits"] {
            let message = wrong.parse::<Positions>().unwrap_err().to_string();
            assert!(message.contains(wrong) && message.contains("lossless, and 10 to 24"), "{message}");
        }
    }

    #[test]
    fn what_lies_between_the_points_of_a_lattice_has_no_number() {
        assert_eq!(lattice_number(-7.5, 2.5), Some(-3));
        assert_eq!(lattice_number(7.0, 2.5), None);
        assert_eq!(lattice_number(7.5_f32.next_up(), 2.5), None);
        assert_eq!(lattice_number(16_777_216.0, 1.0), None);
        assert_eq!(lattice_number(-16_777_215.0, 1.0), Some(-16_777_215));
        assert_eq!(lattice_number(f32::INFINITY, 1.0), None);
    }

    /// Steps of any size that is a normal number, with few bits or with all of them.
    fn step() -> impl Strategy<Value = f32> {
        let bits = prop_oneof![Just(0_u32), Just(1), Just((1 << 23) - 1), 0..1_u32 << 23];
        // Up to 2^104, where the largest number is still finite.
        (prop_oneof![Just(1_u32), Just(230), 1..231_u32], bits)
            .prop_map(|(exponent, mantissa)| f32::from_bits(exponent << 23 | mantissa))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn a_number_is_found_again_from_its_coordinate(
            step in step(),
            number in prop_oneof![
                Just(LARGEST_NUMBER as i32),
                Just(-(LARGEST_NUMBER as i32)),
                -(LARGEST_NUMBER as i32)..=LARGEST_NUMBER as i32,
                -1000..1000_i32,
            ],
        ) {
            let coordinate = on_lattice(number, step);
            prop_assert!(coordinate.is_finite() && (coordinate != 0.0 || coordinate.is_sign_positive()));
            prop_assert_eq!(lattice_number(coordinate, step), Some(number));
        }
    }
}
