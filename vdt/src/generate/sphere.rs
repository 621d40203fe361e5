//! Sphere: a closed surface without handles, a small planet with a rough crust.
//!
//! Exactly as many triangles as asked for, less one if that is odd: a closed surface has an even number of them. One
//! component, no boundary, every triangle facing outward.
//!
//! Rings of vertices are stacked from pole to pole. With `n` the sum of the ring sizes there are `2 n` triangles, so
//! any even number can be had; each ring has as many vertices as its circumference asks for, and the rounding is
//! spread over all. Every vertex is then moved towards or away from the centre by fractal noise, of so many octaves
//! as the triangles can show: the surface stays star-shaped, so it does not cut itself. The mean radius is 1000.
//!
//! Memory: the ring sizes, O(sqrt(triangles)).

use crate::mesh::MeshError;

use super::noise::{Noise, sine_and_cosine};
use super::{Model, TriangleSink, VertexSink};

const RADIUS: f64 = 1000.0;
/// No ring is smaller: two edges do not enclose anything.
const SMALLEST_RING: u64 = 3;

pub(super) struct Sphere {
    rings: Vec<u64>,
    octaves: Vec<Noise>,
    turn: Noise,
}

impl Sphere {
    /// For 10 triangles or more.
    pub(super) fn new(triangles: u64, seed: u64) -> Self {
        let total = triangles / 2;
        // With rings as far apart as rows of equilateral triangles, (rings + 1)² = triangles * pi / (4 sqrt(3)).
        let gaps = (triangles as f64 * 0.4534 + 0.25).sqrt() + 0.5;
        let count = (gaps as u64).saturating_sub(1).max(1);
        let weight = |ring: u64| {
            let (sine, _) = sine_and_cosine((ring + 1) as f64 / (2 * (count + 1)) as f64);
            // In distances between rings, with the edges longer than those by 2 / sqrt(3).
            let ideal = sine * 1.732_050_8 * (count + 1) as f64;
            (ideal - SMALLEST_RING as f64).max(0.1)
        };
        let all: f64 = (0..count).map(weight).sum();
        // What each ring has above the smallest one adds up to this.
        let above = total - SMALLEST_RING * count;
        let (mut rings, mut reached, mut sum) = (Vec::with_capacity(count as usize), 0, 0.0);
        for ring in 0..count {
            sum += weight(ring);
            let next = if ring + 1 == count { above } else { (above as f64 * (sum / all)) as u64 };
            rings.push(SMALLEST_RING + next - reached);
            reached = next;
        }
        let mut octaves = Vec::new();
        let mut frequency = 1.3;
        // A wave of the finest octave is no shorter than four edges; the equator has 2 pi / 1.3 of the first.
        while octaves.len() < 2 || frequency * 16.0 < count as f64 {
            octaves.push(Noise::new(seed, 200 + octaves.len() as u64));
            frequency *= 2.03;
        }
        Sphere { rings, octaves, turn: Noise::new(seed, 0) }
    }

    /// A point of the surface in a direction of length 1.
    fn surface(&self, direction: [f64; 3]) -> [f64; 3] {
        let (mut sum, mut amplitude, mut frequency) = (0.0, 0.13, 1.3);
        for octave in &self.octaves {
            let [x, y, z] = direction.map(|coordinate| coordinate * frequency);
            sum += amplitude * octave.solid(x, y, z);
            amplitude *= 0.45;
            frequency *= 2.03;
        }
        // The noise is within -3 and 3 in theory and hardly beyond 1 in practice.
        let radius = RADIUS * (1.0 + sum).max(0.4);
        direction.map(|coordinate| coordinate * radius)
    }

    /// By how many half steps the vertices of a ring are turned: every other ring by one.
    fn half_steps(ring: usize) -> u64 {
        (ring % 2) as u64
    }
}

impl Model for Sphere {
    fn vertex_count(&self) -> u64 {
        self.rings.iter().sum::<u64>() + 2
    }

    fn triangle_count(&self) -> u64 {
        2 * self.rings.iter().sum::<u64>()
    }

    fn emit_vertices(&self, emit: &mut VertexSink<'_>) -> Result<(), MeshError> {
        let start = self.turn.uniform(0, 0);
        emit(self.surface([0.0, 0.0, 1.0]))?;
        for (ring, &size) in self.rings.iter().enumerate() {
            let (radius, height) = sine_and_cosine((ring + 1) as f64 / (2 * (self.rings.len() + 1)) as f64);
            for index in 0..size {
                let turns = (2 * index + Self::half_steps(ring)) as f64 / (2 * size) as f64;
                let (sine, cosine) = sine_and_cosine(start + turns);
                emit(self.surface([radius * cosine, radius * sine, height]))?;
            }
        }
        emit(self.surface([0.0, 0.0, -1.0]))
    }

    fn emit_triangles(&self, emit: &mut TriangleSink<'_>) -> Result<(), MeshError> {
        let mut upper = 1;
        for index in 0..self.rings[0] {
            emit([0, upper + index, upper + (index + 1) % self.rings[0]])?;
        }
        for (ring, pair) in self.rings.windows(2).enumerate() {
            let [above, below] = [pair[0], pair[1]];
            let lower = upper + above;
            let (mut high, mut low) = (0, 0);
            while high < above || low < below {
                // Of the two edges that could come next across the strip, the shorter one: the one whose step has
                // its middle farther back.
                let high_middle = (2 * high + 1 + Self::half_steps(ring)) * below;
                let low_middle = (2 * low + 1 + Self::half_steps(ring + 1)) * above;
                let (from_high, from_low) = (upper + high % above, lower + low % below);
                if low == below || (high < above && high_middle < low_middle) {
                    high += 1;
                    emit([from_high, from_low, upper + high % above])?;
                } else {
                    low += 1;
                    emit([from_high, from_low, lower + low % below])?;
                }
            }
            upper = lower;
        }
        let last = self.rings[self.rings.len() - 1];
        for index in 0..last {
            emit([upper + (index + 1) % last, upper + index, upper + last])?;
        }
        Ok(())
    }
}
