//! The dependency order of a node: one small number that says both when the node came to be, among all that it depends on,
//! and its switch value (the paper, 3.3.5; `facts/codec.md`, section 2, "Dependency id").
//!
//! An id is `class << 16 | chain`. The *class* is the switch value rounded up to a step of a geometric scale, in units of the
//! normalised mesh: class 1 is 2^-33, and each class is an eighth of an octave above the one before. The *chain* is how many
//! collapses of the class, each a dependency of the next, lead here. So
//!
//! - the id of a collapse is above those of all its dependencies ([`id_after`]), and ids order any two nodes of which one
//!   depends on the other; collapses that have nothing to do with each other may have the same id;
//! - switch values never fall along a dependency, since classes do not;
//! - a switch value is at most 2^(1/8) times the error that it stands for, and never below it: still a bound. Should a chain
//!   ever be longer than its 16 bits, it goes on in the next class, which rounds switch values up once more.
//!
//! Leaves have the id 0. No id overflows: there are fewer than 2^31 collapses, and the largest class of an error is 1289.
//!
//! To the bit the same on all machines: a table of eight numbers, comparisons, and powers of two.

use crate::ingest::power_of_two;

/// How many bits of an id are for the chain.
pub const CHAIN_BITS: u32 = 16;
/// Classes from a switch value to its double.
pub const CLASSES_PER_OCTAVE: u32 = 8;

/// Class 1 is 2 to this, normalised: flat regions have no error but rounding noise, and "split where the switch value is
/// above 0" must still split everything.
const LOWEST_OCTAVE: i32 = -33;
/// Bits of an f32 below its exponent.
const MANTISSA_BITS: u32 = f32::MANTISSA_DIGITS - 1;
/// The exponent field of an f32 of 1.
const EXPONENT_OF_ONE: i32 = f32::MAX_EXP - 1;
/// The mantissas of 2^(j/8), each rounded up.
const MANTISSAS: [u32; CLASSES_PER_OCTAVE as usize] =
    [0x00_0000, 0x0b_95c2, 0x18_37f1, 0x25_fed7, 0x35_04f4, 0x45_672b, 0x57_44fd, 0x6a_c0c7];

/// The smallest class whose value is not below `switch`, which is normalised; 1 for what is no number.
#[inline]
fn class_of(switch: f32) -> u32 {
    let bits = switch.to_bits();
    let octave = (bits >> MANTISSA_BITS) as i32 - EXPONENT_OF_ONE - LOWEST_OCTAVE;
    if switch.is_nan() || switch <= 0.0 || octave < 0 {
        return 1;
    }
    let mantissa = bits & ((1 << MANTISSA_BITS) - 1);
    // Beyond the last step, it is the first of the next octave.
    let step = MANTISSAS.iter().filter(|step| **step < mantissa).count() as u32;
    octave as u32 * CLASSES_PER_OCTAVE + step + 1
}

/// The id of a collapse with this error, normalised, the largest id of whose dependencies is `latest`: the smallest that is
/// above it, and whose class has the error.
#[inline]
pub fn id_after(error: f32, latest: u32) -> u32 {
    (class_of(error) << CHAIN_BITS).max(latest + 1)
}

/// The switch value of an id, in mesh units, of a mesh that is normalised by 2^`exponent`; 0 for class 0, that of leaves.
/// Where it would be too small or too large for single precision, it is the smallest normal number, or the largest.
#[inline]
pub fn switch_of(id: u32, exponent: i32) -> f32 {
    let Some(step) = (id >> CHAIN_BITS).checked_sub(1) else { return 0.0 };
    let mantissa = MANTISSAS[(step % CLASSES_PER_OCTAVE) as usize];
    let value = f32::from_bits((EXPONENT_OF_ONE as u32) << MANTISSA_BITS | mantissa);
    let octave = ((step / CLASSES_PER_OCTAVE) as i32 + LOWEST_OCTAVE).saturating_add(exponent);
    let in_mesh_units = f64::from(value) * power_of_two(octave.clamp(-512, 512));
    (in_mesh_units as f32).clamp(f32::MIN_POSITIVE, f32::MAX)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A class's value, in the units of what is asked for.
    fn value(class: u32) -> f32 {
        switch_of(class << CHAIN_BITS, 0)
    }

    #[test]
    fn each_class_is_an_eighth_of_an_octave() {
        assert_eq!(value(0), 0.0);
        assert_eq!(value(1), 2.0_f32.powi(-33));
        assert_eq!(value(1 + 33 * CLASSES_PER_OCTAVE), 1.0);
        for class in 1..=(127 + 33) * CLASSES_PER_OCTAVE {
            // Rounded up, and by no more than need be.
            let exact = 2.0_f64.powf(f64::from(class - 1) / f64::from(CLASSES_PER_OCTAVE) - 33.0);
            assert!(f64::from(value(class)) >= exact * (1.0 - 1e-14), "{class}");
            assert!(f64::from(value(class).next_down()) < exact, "{class}");
            // A class has its own value, and nothing above it.
            assert_eq!(class_of(value(class)), class);
            assert_eq!(class_of(value(class).next_up()), class + 1);
        }
    }

    #[test]
    fn what_is_out_of_range_has_a_class_too() {
        for nothing in [0.0, -0.0, -1.0, f32::NAN, f32::MIN_POSITIVE, 1e-45, f32::NEG_INFINITY] {
            assert_eq!(class_of(nothing), 1, "{nothing}");
        }
        assert_eq!(class_of(f32::INFINITY), class_of(f32::MAX));
        assert_eq!(value(class_of(f32::MAX)), f32::MAX);
        assert_eq!(class_of(f32::MAX), 1289);
        assert_eq!(switch_of(u32::MAX, i32::MAX), f32::MAX);
        assert_eq!(switch_of(u32::MAX, -149), f32::MAX);
        assert_eq!(switch_of(1 << CHAIN_BITS, -149), f32::MIN_POSITIVE);
        assert_eq!(switch_of(1 << CHAIN_BITS, i32::MIN), f32::MIN_POSITIVE);
    }

    #[test]
    fn a_chain_that_is_too_long_goes_on_in_the_next_class() {
        let last = 5 << CHAIN_BITS | 0xffff;
        assert_eq!(id_after(0.0, last), 6 << CHAIN_BITS);
        assert_eq!(id_after(0.0, last - 1), last);
        assert_eq!(id_after(value(5), 0), 5 << CHAIN_BITS);
    }

    proptest! {
        #[test]
        fn an_id_is_above_what_it_depends_on_and_its_switch_value_not_below_the_error(
            error in prop_oneof![any::<f32>().prop_map(f32::abs), 0.0..2.0_f32, 1e-12..1e-6_f32],
            latest in 0..1300_u32 << CHAIN_BITS, exponent in -100..100_i32,
        ) {
            prop_assume!(error.is_finite());
            let id = id_after(error, latest);
            prop_assert!(id > latest);
            prop_assert!(id == latest + 1 || id & 0xffff == 0);
            prop_assert!(switch_of(id, 0) >= error);
            prop_assert!(switch_of(id, exponent) >= switch_of(latest, exponent));
            if id > latest + 1 && error > 2.0_f32.powi(-33) && class_of(error) < 1289 {
                prop_assert!(switch_of(id, 0) < error * 1.0906);
            }
            let scaled = f64::from(switch_of(id, 0)) * 2.0_f64.powi(exponent);
            if switch_of(id, 0) < f32::MAX && (1e-37..3e38).contains(&scaled) {
                prop_assert_eq!(f64::from(switch_of(id, exponent)), scaled);
            }
        }
    }
}
