//! Colours between sRGB, which meshes have here, and linear light, which glTF has.
//!
//! The power functions of the standard are made of additions, multiplications, divisions and square roots, so that every
//! machine comes to the same bits. Alpha is linear in both, and none of this module's business.
//!
//! Reference: IEC 61966-2-1.

use std::sync::LazyLock;

/// The linear light of a channel in sRGB. Goes on beyond 0 and 1.
pub(super) fn linear_of_srgb(value: f64) -> f64 {
    if value <= 0.040_45 {
        return value / 12.92;
    }
    let base = (value + 0.055) / 1.055;
    let square = base * base;
    square * root::<5>(square)
}

/// A channel in sRGB of its linear light. Goes on beyond 0 and 1.
pub(super) fn srgb_of_linear(value: f64) -> f64 {
    if value <= 0.003_130_8 {
        return 12.92 * value;
    }
    1.055 * root::<3>(value * value.sqrt().sqrt()) - 0.055
}

/// The root of this degree of a positive number, by Newton's method from above: each step comes nearer, until rounding ends it.
fn root<const DEGREE: i32>(value: f64) -> f64 {
    let mut found = value.max(1.0);
    loop {
        let power = (1..DEGREE).fold(1.0, |power, _| power * found);
        let next = (f64::from(DEGREE - 1) * found + value / power) / f64::from(DEGREE);
        if next >= found {
            return found;
        }
        found = next;
    }
}

/// The linear light of each byte in sRGB, in 16 bits.
pub(super) fn words_of_bytes() -> [u16; 256] {
    std::array::from_fn(|byte| (linear_of_srgb(byte as f64 / 255.0) * 65_535.0).round() as u16)
}

/// The least linear light in 16 bits to which each byte is the nearest.
static FIRST_WORDS: LazyLock<[u16; 256]> = LazyLock::new(|| {
    std::array::from_fn(|byte| match byte {
        0 => 0,
        _ => (linear_of_srgb((byte as f64 - 0.5) / 255.0) * 65_535.0).ceil() as u16,
    })
});

/// The nearest byte in sRGB to linear light in 16 bits.
#[inline]
pub(super) fn byte_of_word(word: u16) -> u8 {
    // The first of them is 0, so at least one is not larger.
    (FIRST_WORDS.partition_point(|first| *first <= word) - 1) as u8
}

/// The same of linear light in 8 bits.
#[inline]
pub(super) fn byte_of_byte(byte: u8) -> u8 {
    byte_of_word(u16::from(byte) * 257)
}

/// The same of linear light from 0 to 1; none if it is no finite number.
#[inline]
pub(super) fn byte_of_unit(value: f64) -> Option<u8> {
    value.is_finite().then(|| byte_of_word((value.clamp(0.0, 1.0) * 65_535.0).round() as u16))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The standard, as it is written.
    fn standard(linear: f64) -> f64 {
        if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
    }

    #[test]
    fn the_functions_are_those_of_the_standard() {
        for step in 0..=20_000 {
            let value = f64::from(step) / 10_000.0;
            let srgb = srgb_of_linear(value);
            assert!((srgb - standard(value)).abs() < 1e-14, "{value}");
            assert!((linear_of_srgb(srgb) - value).abs() < 1e-13, "{value}");
        }
        assert_eq!((srgb_of_linear(0.0), linear_of_srgb(0.0)), (0.0, 0.0));
        assert_eq!((srgb_of_linear(1.0) as f32, linear_of_srgb(1.0)), (1.0, 1.0));
        assert_eq!((srgb_of_linear(-1.0), linear_of_srgb(-12.92)), (-12.92, -1.0));
        for huge in [1e30, f64::from(f32::MAX)] {
            assert!((linear_of_srgb(srgb_of_linear(huge)) / huge - 1.0).abs() < 1e-12);
            assert!(linear_of_srgb(huge).is_finite());
        }
    }

    #[test]
    fn every_byte_comes_back() {
        for (byte, word) in words_of_bytes().into_iter().enumerate() {
            assert_eq!(usize::from(byte_of_word(word)), byte);
            assert_eq!(byte_of_unit(linear_of_srgb(byte as f64 / 255.0)), Some(byte as u8));
        }
    }

    #[test]
    fn linear_light_becomes_the_nearest_byte() {
        for word in 0..=u16::MAX {
            let expected = (standard(f64::from(word) / 65_535.0) * 255.0).round() as u8;
            assert_eq!(byte_of_word(word), expected, "{word}");
            assert_eq!(byte_of_unit(f64::from(word) / 65_535.0), Some(expected));
            if let (byte, 0) = (word / 257, word % 257) {
                assert_eq!(byte_of_byte(byte as u8), expected);
            }
        }
        assert_eq!([-1.0, 7.0, f64::NAN].map(byte_of_unit), [Some(0), Some(255), None]);
    }
}
