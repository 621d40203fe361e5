//! Eight numbers side by side, as one instruction or two take them: plain arrays, which the compiler turns into vector
//! instructions. Each operation is that of IEEE 754 on each lane, so the outcome is the same on every machine.

use std::ops::{Add, Mul, Sub};

/// Numbers worked on at once.
pub(super) const LANES: usize = 8;

/// Eight numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(32))]
pub(super) struct Lanes(pub [f32; LANES]);

impl Lanes {
    pub const ZERO: Lanes = Lanes([0.0; LANES]);
    pub const ONE: Lanes = Lanes([1.0; LANES]);

    /// The same number in every lane.
    #[inline(always)]
    pub fn all(value: f32) -> Self {
        Lanes([value; LANES])
    }

    #[inline(always)]
    fn zip(self, other: Lanes, operation: impl Fn(f32, f32) -> f32) -> Self {
        let mut lanes = [0.0; LANES];
        for lane in 0..LANES {
            lanes[lane] = operation(self.0[lane], other.0[lane]);
        }
        Lanes(lanes)
    }

    /// The smaller of each two; the other's where this is not a number.
    #[inline(always)]
    pub fn min(self, other: Lanes) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }

    /// The larger of each two; the other's where this is not a number.
    #[inline(always)]
    pub fn max(self, other: Lanes) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }

    /// Brought between 0 and `most`; 0 where it is not a number.
    #[inline(always)]
    pub fn clamp_to(self, most: Lanes) -> Self {
        self.max(Lanes::ZERO).min(most)
    }

    /// One over each; 0 over 0 and below.
    #[inline(always)]
    pub fn inverse(self) -> Self {
        self.zip(self, |value, _| if value > 0.0 { 1.0 / value } else { 0.0 })
    }

    /// The largest of all.
    #[inline(always)]
    pub fn largest(self) -> f32 {
        let [a, b, c, d, e, f, g, h] = self.0;
        let max = |a: f32, b: f32| if a > b { a } else { b };
        max(max(max(a, e), max(b, f)), max(max(c, g), max(d, h)))
    }
}

impl Add for Lanes {
    type Output = Lanes;

    #[inline(always)]
    fn add(self, other: Lanes) -> Lanes {
        self.zip(other, |a, b| a + b)
    }
}

impl Sub for Lanes {
    type Output = Lanes;

    #[inline(always)]
    fn sub(self, other: Lanes) -> Lanes {
        self.zip(other, |a, b| a - b)
    }
}

impl Mul for Lanes {
    type Output = Lanes;

    #[inline(always)]
    fn mul(self, other: Lanes) -> Lanes {
        self.zip(other, |a, b| a * b)
    }
}

/// Eight vectors, axis by axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Vectors(pub [Lanes; 3]);

impl Vectors {
    pub const ZERO: Vectors = Vectors([Lanes::ZERO; 3]);

    /// The same vector in every lane.
    #[inline(always)]
    pub fn all(vector: [f32; 3]) -> Self {
        Vectors(vector.map(Lanes::all))
    }

    /// These vectors, and 0 in the lanes that are left.
    #[inline(always)]
    pub fn of(vectors: impl IntoIterator<Item = [f32; 3]>) -> Self {
        let mut lanes = Vectors::ZERO;
        for (lane, vector) in vectors.into_iter().take(LANES).enumerate() {
            lanes.set(lane, vector);
        }
        lanes
    }

    #[inline(always)]
    pub fn set(&mut self, lane: usize, vector: [f32; 3]) {
        for axis in 0..3 {
            self.0[axis].0[lane] = vector[axis];
        }
    }

    #[inline(always)]
    pub fn minus(self, other: Vectors) -> Self {
        Vectors([self.0[0] - other.0[0], self.0[1] - other.0[1], self.0[2] - other.0[2]])
    }

    #[inline(always)]
    pub fn plus(self, other: Vectors) -> Self {
        Vectors([self.0[0] + other.0[0], self.0[1] + other.0[1], self.0[2] + other.0[2]])
    }

    #[inline(always)]
    pub fn times(self, factor: Lanes) -> Self {
        Vectors(self.0.map(|axis| axis * factor))
    }

    #[inline(always)]
    pub fn dot(self, other: Vectors) -> Lanes {
        self.0[0] * other.0[0] + self.0[1] * other.0[1] + self.0[2] * other.0[2]
    }
}
