//! Coordinates that are mostly fractions of one denominator.
//!
//! Positions that were written down as decimals, scaled by a power of ten, or cut out of a grid of voxels are whole numbers
//! over a common denominator, rounded to single precision; a lossless model need not keep the noise of that rounding. But
//! seldom are all of them: surfaces of voxels leave the grid along one axis, and 0 comes out of sums as 1e-18. So the writer
//! looks for the denominator that most coordinates have ([`denominator`]), the file says it, and each coordinate is first said
//! to be such a fraction, or to be off it by a few of the numbers that single precision has (sums of fractions are); what
//! is neither is coded as any other number.
//!
//! I/O: some 16,000 positions are read once.

use storage::{Spool, StorageError};

use super::frequent::for_each_stretch;
use super::scale::logarithm;

/// How many single-precision numbers a coordinate may be beside a fraction.
pub(super) const NEAR: i64 = 3;
/// Symbols: none, or how far beside a fraction.
pub(super) const SYMBOLS: usize = 2 * NEAR as usize + 2;
/// Contexts: which of the three coordinates, and how many before it were no fractions.
pub(super) const CONTEXTS: usize = 6;
/// Numerators are at most that large: what single precision holds.
const LARGEST: i32 = 1 << 24;

/// Single-precision numbers as whole numbers in the same order.
#[inline(always)]
pub(super) fn ordered(value: f32) -> i64 {
    let bits = value.to_bits() as i32;
    i64::from(if bits < 0 { i32::MIN.wrapping_sub(bits) } else { bits })
}

/// The inverse of [`ordered`]; none where there is no such number.
#[inline(always)]
pub(super) fn from_ordered(value: i64) -> Option<f32> {
    let value = i32::try_from(value).ok()?;
    Some(f32::from_bits(if value < 0 { i32::MIN.wrapping_sub(value) } else { value } as u32))
        .filter(|value| value.is_finite())
}

/// The numerator that comes nearest to a coordinate.
#[inline(always)]
pub(super) fn nearest(coordinate: f32, denominator: f32) -> i32 {
    (f64::from(coordinate) * f64::from(denominator)).round() as i32
}

/// How many single-precision numbers a coordinate lies behind the fraction; none where that is not near, or no fraction.
#[inline(always)]
pub(super) fn offset(coordinate: f32, numerator: i32, denominator: f32) -> Option<i64> {
    let off = ordered(coordinate) - ordered(numerator as f32 / denominator);
    (off.abs() <= NEAR && numerator.abs() <= LARGEST).then_some(off)
}

/// The denominators looked for: powers of ten as far as single precision has them, their doubles and fourfolds, and powers of
/// two.
fn candidates() -> impl Iterator<Item = f32> {
    let tens = std::iter::successors(Some(1.0_f32), |ten| Some(10.0 * ten)).take(11);
    let twos = (-40..=40).map(|power: i32| f32::from_bits(((127 + power) as u32) << 23));
    [1.0, 2.0, 4.0].into_iter().flat_map(move |times| tens.clone().map(move |ten| times * ten)).chain(twos)
}

/// Positions that are looked at.
const SAMPLES: u64 = 1 << 14;
/// A denominator is worth saying if it saves that many 16ths of a bit for each coordinate.
const WORTH: i64 = 8;
/// What it costs to say of a coordinate that it is no fraction, or not quite one, in 16ths of a bit.
const NONE_COSTS: i64 = 3 * 16;
const OFF_COSTS: i64 = 2 * 16;

/// The denominator of which most coordinates are fractions, by what that saves; 0 where it would save nothing.
pub(crate) fn denominator(positions: &Spool<[f32; 3]>) -> Result<f32, StorageError> {
    let mut coordinates = Vec::new();
    for_each_stretch(positions, SAMPLES, |stretch| coordinates.extend(stretch.as_flattened()))?;
    // 0 is a fraction of all denominators.
    coordinates.retain(|coordinate| *coordinate != 0.0);
    // In 16ths of a bit, what tells the multiples of a step apart less than it tells single-precision numbers apart.
    let saved = |denominator: f32| -> i64 {
        let of_step = i64::from(logarithm(1.0 / denominator));
        let saved = |coordinate: f32| match offset(coordinate, nearest(coordinate, denominator), denominator) {
            None => -NONE_COSTS,
            Some(off) => of_step - i64::from(octave(coordinate) - 23) * 16 - if off == 0 { 0 } else { OFF_COSTS },
        };
        coordinates.iter().map(|coordinate| saved(*coordinate)).sum()
    };
    let mut best = (WORTH * coordinates.len() as i64, 0.0);
    for denominator in candidates() {
        let saved = saved(denominator);
        if saved > best.0 {
            best = (saved, denominator);
        }
    }
    Ok(best.1)
}

/// The power of two that a number begins with.
fn octave(value: f32) -> i32 {
    (value.abs().to_bits() >> 23) as i32 - 127
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing::Random;

    fn found(positions: Vec<[f32; 3]>) -> f32 {
        denominator(&Spool::from_vec(positions)).unwrap()
    }

    /// Positions with fractions for coordinates, but for one of so many.
    fn fractions(denominator: f32, but_one_of: usize) -> Vec<[f32; 3]> {
        let random = &mut Random(7);
        let mut coordinate = |_| match random.below(but_one_of) {
            0 => random.signed().abs().sqrt() * 3e4 / denominator,
            _ => random.below(30_000) as f32 / denominator,
        };
        (0..3000).map(|_| [0, 1, 2].map(&mut coordinate)).collect()
    }

    #[test]
    fn the_denominator_of_most_is_found() {
        for denominator in [1.0, 1e3, 1e6, 2e6, 4e5, 1e10, 0.125, 1024.0] {
            for but_one_of in [3, 1000] {
                assert_eq!(found(fractions(denominator, but_one_of)), denominator);
            }
        }
        assert_eq!(found(fractions(1e6, 1)), 0.0);
        assert_eq!(found(Vec::new()), 0.0);
        assert_eq!(found(vec![[0.0; 3]; 5000]), 0.0);
        // Sums of fractions lie beside them.
        let sums = fractions(1e6, 1000).into_iter().map(|position| position.map(|value| value + 0.03 - 0.03)).collect();
        assert_eq!(found(sums), 1e6);
    }

    #[test]
    fn no_more_than_near_is_near() {
        let fraction = 12_345.0 / 1e6_f32;
        for off in -5..=5 {
            let coordinate = from_ordered(ordered(fraction) + off).unwrap();
            assert_eq!(nearest(coordinate, 1e6), 12_345);
            assert_eq!(offset(coordinate, 12_345, 1e6), (off.abs() <= NEAR).then_some(off));
        }
        assert_eq!(offset(f32::MAX, nearest(f32::MAX, 1e6), 1e6), None);
        assert_eq!(offset(2.0_f32.powi(25), 1 << 25, 1.0), None);
    }

    proptest! {
        #[test]
        fn the_order_of_numbers_is_theirs(left in any::<f32>(), right in any::<f32>()) {
            prop_assert_eq!(ordered(left) < ordered(right), left < right);
            prop_assert_eq!(from_ordered(ordered(left)), Some(left).filter(|value| value.is_finite()));
        }
    }
}
