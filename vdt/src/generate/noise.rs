//! Hashes, smooth noise and angles: all the arithmetic from which the shapes are made.
//!
//! The same numbers come out on every machine. Nothing is used here but integer operations and the operations that
//! IEEE 754 defines to the last bit (`+`, `-`, `*`, `/`, comparison, conversion); sine and cosine are polynomials.

/// A source of numbers that look random: the same ones for the same seed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Noise {
    seed: u64,
}

// Odd, with their bits well mixed: neighbouring lattice points get keys that differ in many places.
const STEP_X: u64 = 0x9e37_79b9_7f4a_7c15;
const STEP_Y: u64 = 0xc2b2_ae3d_27d4_eb4f;
const STEP_Z: u64 = 0x1656_67b1_9e37_79f9;
const MIX: u64 = 0xd6e8_feb8_6659_fd93;

/// Spreads every bit of `key` over all bits of the result.
fn mix(mut key: u64) -> u64 {
    key ^= key >> 32;
    key = key.wrapping_mul(MIX);
    key ^= key >> 32;
    key = key.wrapping_mul(MIX);
    key ^ (key >> 32)
}

/// The integer at or below `value`, and how far above it `value` is: from 0 to 1.
///
/// For values that fit in an `i64`, which all lattice coordinates here do.
fn split(value: f64) -> (i64, f64) {
    let truncated = value as i64;
    let floor = truncated - i64::from(value < truncated as f64);
    (floor, value - floor as f64)
}

/// Goes from 0 to 1 with its first and second derivative 0 at both ends.
fn fade(t: f64) -> f64 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

fn blend(from: f64, to: f64, share: f64) -> f64 {
    from + (to - from) * share
}

impl Noise {
    /// The `stream`-th of the sources that belong to `seed`.
    pub(super) fn new(seed: u64, stream: u64) -> Self {
        Noise { seed: mix(mix(seed.wrapping_add(STEP_X)).wrapping_add(stream.wrapping_mul(STEP_Y))) }
    }

    /// A hash of a pair of integers.
    pub(super) fn hash(&self, first: u64, second: u64) -> u64 {
        mix(self.seed.wrapping_add(first.wrapping_mul(STEP_X)).wrapping_add(second.wrapping_mul(STEP_Y)))
    }

    /// A number from 0 to below 1 for a pair of integers.
    pub(super) fn uniform(&self, first: u64, second: u64) -> f64 {
        (self.hash(first, second) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Smooth noise in the plane: gradient noise on the unit lattice. Mostly within -1 and 1, always within -2 and 2.
    pub(super) fn flat(&self, x: f64, y: f64) -> f64 {
        let ((column, dx), (row, dy)) = (split(x), split(y));
        let left = self.seed.wrapping_add((column as u64).wrapping_mul(STEP_X));
        let low = (row as u64).wrapping_mul(STEP_Y);
        let corner = |key: u64, dx: f64, dy: f64| {
            let bits = mix(key);
            // Two signed halves of the hash are the gradient.
            f64::from(bits as i32) * dx + f64::from((bits >> 32) as i32) * dy
        };
        let right = left.wrapping_add(STEP_X);
        let high = low.wrapping_add(STEP_Y);
        let (across, up) = (fade(dx), fade(dy));
        let bottom =
            blend(corner(left.wrapping_add(low), dx, dy), corner(right.wrapping_add(low), dx - 1.0, dy), across);
        let top = blend(
            corner(left.wrapping_add(high), dx, dy - 1.0),
            corner(right.wrapping_add(high), dx - 1.0, dy - 1.0),
            across,
        );
        blend(bottom, top, up) * (2.0 / 2_147_483_648.0)
    }

    /// Smooth noise in space: gradient noise on the unit lattice. Mostly within -1 and 1, always within -3 and 3.
    pub(super) fn solid(&self, x: f64, y: f64, z: f64) -> f64 {
        let ((column, dx), (row, dy), (layer, dz)) = (split(x), split(y), split(z));
        let left = self.seed.wrapping_add((column as u64).wrapping_mul(STEP_X));
        let low = (row as u64).wrapping_mul(STEP_Y);
        let near = (layer as u64).wrapping_mul(STEP_Z);
        let corner = |key: u64, dx: f64, dy: f64, dz: f64| {
            let bits = mix(key);
            // The gradient: 20 bits of the hash for each axis, and a constant to put 0 in the middle.
            let part = |shift: u32| f64::from(((bits >> shift) & 0xf_ffff) as u32) - 524_287.5;
            part(0) * dx + part(20) * dy + part(40) * dz
        };
        let right = left.wrapping_add(STEP_X);
        let high = low.wrapping_add(STEP_Y);
        let far = near.wrapping_add(STEP_Z);
        let across = fade(dx);
        let row = |key: u64, dy: f64, dz: f64| {
            blend(corner(left.wrapping_add(key), dx, dy, dz), corner(right.wrapping_add(key), dx - 1.0, dy, dz), across)
        };
        let up = fade(dy);
        let front = blend(row(low.wrapping_add(near), dy, dz), row(high.wrapping_add(near), dy - 1.0, dz), up);
        let back = blend(row(low.wrapping_add(far), dy, dz - 1.0), row(high.wrapping_add(far), dy - 1.0, dz - 1.0), up);
        blend(front, back, fade(dz)) * (2.0 / 524_288.0)
    }
}

/// Sine and cosine of an angle given in turns (1 is the full circle), to about 15 digits: the Taylor polynomials,
/// after the angle was brought to within an eighth of a turn of an axis.
pub(super) fn sine_and_cosine(turns: f64) -> (f64, f64) {
    let (quarter, rest) = split(turns * 4.0 + 0.5);
    let angle = (rest - 0.5) * std::f64::consts::FRAC_PI_2;
    let square = angle * angle;
    // 1 / (k * (k + 1)) for k = 2, 4, .. and 1, 3, ..: each term of the series from the one before it.
    let series = |first: u32| {
        let mut sum = 1.0;
        for k in (0..7).rev() {
            let below = f64::from(first + 2 * k);
            sum = 1.0 - sum * square / (below * (below + 1.0));
        }
        sum
    };
    let (sine, cosine) = (angle * series(2), series(1));
    match quarter.rem_euclid(4) {
        0 => (sine, cosine),
        1 => (cosine, -sine),
        2 => (-sine, -cosine),
        _ => (-cosine, sine),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_right() {
        for step in -4000..4000 {
            let turns = f64::from(step) / 1777.0;
            let (sine, cosine) = sine_and_cosine(turns);
            let (expected_sine, expected_cosine) = (turns * std::f64::consts::TAU).sin_cos();
            assert!((sine - expected_sine).abs() < 1e-14, "sine of {turns} turns: {sine}, not {expected_sine}");
            assert!((cosine - expected_cosine).abs() < 1e-14, "cosine of {turns} turns: {cosine}");
        }
        assert_eq!(sine_and_cosine(0.0), (0.0, 1.0));
    }

    #[test]
    fn noise_is_smooth_bounded_and_fills_its_range() {
        let noise = Noise::new(1, 2);
        let (mut lowest, mut highest, mut sum) = ([0.0f64; 2], [0.0f64; 2], [0.0; 2]);
        let step = 0.013;
        for index in 0..100_000 {
            let x = f64::from(index) * step - 500.0;
            let here = [noise.flat(x, 0.7 * x), noise.solid(x, 0.7 * x, -0.4 * x)];
            let next = [noise.flat(x + 1e-6, 0.7 * x), noise.solid(x + 1e-6, 0.7 * x, -0.4 * x)];
            for kind in 0..2 {
                lowest[kind] = lowest[kind].min(here[kind]);
                highest[kind] = highest[kind].max(here[kind]);
                sum[kind] += here[kind];
                assert!((here[kind] - next[kind]).abs() < 1e-5, "a jump at {x}");
            }
        }
        for kind in 0..2 {
            assert!(lowest[kind] > -2.0 && lowest[kind] < -0.7, "lowest {lowest:?}");
            assert!(highest[kind] < 2.0 && highest[kind] > 0.7, "highest {highest:?}");
            assert!((sum[kind] / 100_000.0f64).abs() < 0.03, "sums {sum:?}");
        }
    }

    #[test]
    fn seeds_and_streams_differ() {
        let values = [(0, 0), (0, 1), (1, 0), (u64::MAX, 0)].map(|(seed, stream)| Noise::new(seed, stream).hash(3, 4));
        for (index, value) in values.iter().enumerate() {
            assert!(!values[..index].contains(value));
        }
        assert!((0..1000).all(|index| (0.0..1.0).contains(&Noise::new(9, 9).uniform(index, 0))));
    }
}
