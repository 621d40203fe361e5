//! Numbers whose size is roughly known: coded as half-octave classes relative to what is expected, and raw bits.
//!
//! A coordinate of a displacement can be anything from 0 to 2²⁴ steps, but how large it is can be told within an octave or
//! two from the displacements around it. Seen from there, all have the same distribution: one context does for all sizes,
//! but for the smallest, where whole numbers show. So the tables of a file are small.
//!
//! Logarithms here are in 32nds of an octave and come from the bits of an f32: exact, the same everywhere, and only as good
//! as they need be (the mantissa stands for its own logarithm, which is off by at most 0.09 of an octave).

use super::rans::Coder;

/// From so many half octaves on, what is expected is one context.
const LARGE: i32 = 8;
/// Contexts for what is expected.
pub(crate) const CONTEXTS: usize = LARGE as usize + 1;
/// Classes that have a symbol of their own, from [`BELOW`] under what is expected on; before and behind them are the two that
/// stand for all others.
const CLASSES: i32 = 20;
const BELOW: i32 = 14;
/// Symbols: a sign and a class.
pub(crate) const SYMBOLS: usize = 2 * (CLASSES as usize + 2);
/// Bits of a class that has no symbol of its own.
const CLASS_BITS: u32 = 7;

/// The logarithm of a number that is not negative, in 16ths of an octave; so of a square, in 32nds of an octave of its root. (The
/// sign of what is no number is not the same on all machines.)
#[inline(always)]
pub(crate) fn logarithm(value: f32) -> i32 {
    (value.abs().to_bits() >> 19) as i32 - (127 << 4)
}

/// The half-octave class of a number: 0, 1, 2, 3, 4 (4 and 5), 5 (6 and 7), 6 (8 to 11), ….
#[inline(always)]
fn class(magnitude: u64) -> i32 {
    if magnitude < 4 {
        return magnitude as i32;
    }
    let top = 63 - magnitude.leading_zeros() as i32;
    2 * top + (magnitude >> (top - 1) & 1) as i32
}

/// The smallest number of a class, and how many bits tell its numbers apart.
#[inline(always)]
fn of_class(class: i32) -> (u64, u32) {
    if class < 4 {
        return (class.max(0) as u64, 0);
    }
    let top = (class / 2) as u32;
    ((2 | (class & 1) as u64) << (top - 1), top - 1)
}

/// Codes which number of its class one is. The class is known; the number itself to an encoder only.
#[inline(always)]
fn within<C: Coder>(coder: &mut C, class: i32, number: u64) -> u64 {
    let (smallest, bits) = of_class(class);
    let rest = number.wrapping_sub(smallest);
    // A class may have more numbers than raw bits can tell apart at once.
    let low = coder.raw(bits.min(24), rest as u32);
    let high = if bits > 24 { coder.raw(bits - 24, (rest >> 24) as u32) } else { 0 };
    smallest + (u64::from(high) << 24 | u64::from(low))
}

/// Codes a number of which nothing is expected, as its class.
#[inline(always)]
pub(super) fn number<C: Coder>(coder: &mut C, context: usize, number: u64) -> u64 {
    let found = coder.symbol(context, class(number) as usize);
    within(coder, found as i32, number)
}

/// The same for one that may be negative.
#[inline(always)]
pub(super) fn signed<C: Coder>(coder: &mut C, context: usize, number: i64) -> i64 {
    let magnitude = number.unsigned_abs();
    let symbol = coder.symbol(context, 2 * class(magnitude) as usize + usize::from(number < 0));
    let magnitude = within(coder, (symbol / 2) as i32, magnitude) as i64;
    if symbol & 1 == 1 { -magnitude } else { magnitude }
}

/// Codes a signed number. `expected` is the logarithm of how large it is likely to be, in 32nds of an octave; `first` the first of
/// [`CONTEXTS`] contexts. Numbers are below 2⁴⁰; a decoder returns what is none where the file is wrong.
#[inline(always)]
pub(crate) fn code<C: Coder>(coder: &mut C, first: usize, expected: i32, value: i64) -> i64 {
    let bucket = (expected >> 4).clamp(0, 80);
    let (context, base) = if bucket < LARGE { (bucket, 0) } else { (LARGE, bucket - BELOW) };
    let magnitude = value.unsigned_abs();
    let mut found = class(magnitude);
    let place = (found - base).clamp(-1, CLASSES) + 1;
    let symbol = 2 * place as usize + usize::from(value < 0);
    let symbol = coder.symbol(first + context as usize, symbol);
    let place = (symbol / 2) as i32 - 1;
    found = if place == -1 || place == CLASSES { coder.raw(CLASS_BITS, found as u32) as i32 } else { base + place };
    let magnitude = within(coder, found.clamp(0, 81), magnitude) as i64;
    if symbol & 1 == 1 { -magnitude } else { magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_are_half_octaves() {
        for magnitude in (0..5000).chain([1 << 24, (1 << 40) - 1]) {
            let (smallest, bits) = of_class(class(magnitude));
            assert!(smallest <= magnitude && magnitude - smallest < 1 << bits, "{magnitude}");
        }
        assert_eq!((0..10).map(class).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 4, 5, 5, 6, 6]);
    }

    #[test]
    fn logarithms_are_near() {
        for value in [1e-6_f32, 0.3, 1.0, 1.5, 1000.0, 3e20] {
            let expected = f64::from(value).log2() * 16.0;
            assert!((f64::from(logarithm(value)) - expected).abs() <= 2.4, "{value}");
        }
        assert_eq!(logarithm(1.0), 0);
    }
}
