//! Terrain: a piece of mountain land, 10 km on a side, as one open sheet over a warped grid.
//!
//! Exactly as many triangles as asked for: the last row of the grid is cut off where they are used up. One component
//! with one boundary, no handles, no fold: seen from above, no two triangles overlap.
//!
//! The heights are a fractal: ridged noise of so many octaves as the grid can show, more of it in some regions than
//! in others, over a gentle large-scale relief; from the lowest to the highest point about a tenth to a fifth of the
//! side. The lines of the grid lie three to six times as close in some places as in others, in both directions, and
//! every vertex is moved from its crossing by up to 15 % of the distance to the nearest line. Units are metres.
//!
//! Memory: the places of the grid lines, O(sqrt(triangles)).

use crate::mesh::MeshError;

use super::noise::{Noise, sine_and_cosine};
use super::sheet::Sheet;
use super::{Model, TriangleSink, VertexSink};

/// The side of the square, in metres.
const SIDE: f64 = 10_000.0;
/// How far a vertex is moved from its crossing, in distances to the nearest line. Below 1/4 no triangle turns over.
const JITTER: f64 = 0.15;
/// The largest ridges: how many wavelengths to the side.
const FIRST_FREQUENCY: f64 = 3.7;
/// From octave to octave: the wavelength goes down by a little more than half, so that lattices do not line up.
const FREQUENCY_STEP: f64 = 2.03;
/// From octave to octave: the height goes down a little faster than the wavelength, so that slopes stay bounded.
const AMPLITUDE_STEP: f64 = 0.44;

pub(super) struct Terrain {
    sheet: Sheet,
    columns: Vec<Line>,
    rows: Vec<Line>,
    jitter: Noise,
    bend: [Noise; 2],
    relief: Noise,
    octaves: Vec<Noise>,
}

/// Where a line of the grid lies, and how far it is to the nearest other one, both in sides.
struct Line {
    place: f64,
    room: f64,
}

/// The lines of `cells` cells in a row, their spacing varied by two waves of random phase.
fn lines(cells: u64, noise: Noise) -> Vec<Line> {
    let [slow, fast, slow_phase, fast_phase] = [0, 1, 2, 3].map(|index| noise.uniform(index, 0));
    let (slow, fast) = (1.0 + slow, 4.0 + 3.0 * fast);
    let mut places = vec![0.0];
    let mut sum = 0.0;
    for cell in 0..cells {
        let middle = (cell as f64 + 0.5) / cells as f64;
        let (slow_wave, _) = sine_and_cosine(slow * middle + slow_phase);
        let (fast_wave, _) = sine_and_cosine(fast * middle + fast_phase);
        sum += 1.0 + 0.58 * slow_wave + 0.12 * fast_wave;
        places.push(sum);
    }
    let room = |index: usize| {
        let before = index.checked_sub(1).map_or(f64::INFINITY, |before| places[index] - places[before]);
        let after = places.get(index + 1).map_or(f64::INFINITY, |after| after - places[index]);
        before.min(after) / sum
    };
    (0..places.len()).map(|index| Line { place: places[index] / sum, room: room(index) }).collect()
}

impl Terrain {
    pub(super) fn new(triangles: u64, seed: u64) -> Self {
        let sheet = Sheet::with_triangles(triangles);
        // No octave finer than four cells to a wave: it would be lost between the vertices.
        let mut octaves = Vec::new();
        let mut frequency = FIRST_FREQUENCY;
        while octaves.len() < 2 || frequency * 4.0 < sheet.columns as f64 {
            octaves.push(Noise::new(seed, 100 + octaves.len() as u64));
            frequency *= FREQUENCY_STEP;
        }
        Terrain {
            sheet,
            columns: lines(sheet.columns, Noise::new(seed, 0)),
            rows: lines(sheet.lines().1, Noise::new(seed, 1)),
            jitter: Noise::new(seed, 2),
            bend: [Noise::new(seed, 3), Noise::new(seed, 4)],
            relief: Noise::new(seed, 5),
            octaves,
        }
    }

    /// The height at a place, both in sides.
    fn height(&self, x: f64, y: f64) -> f64 {
        let relief = self.relief.flat(x * 1.3, y * 1.3) + 0.4 * self.relief.flat(x * 3.1 + 17.0, y * 3.1);
        // Where the mountains are: 0 in the plains, 1 in the highest ranges.
        let range = (0.55 + 0.6 * relief).clamp(0.0, 1.0);
        let range = range * range * (3.0 - 2.0 * range);
        // Ridges do not run straight.
        let bent_x = x + 0.05 * self.bend[0].flat(x * 3.7, y * 3.7);
        let bent_y = y + 0.05 * self.bend[1].flat(x * 3.7, y * 3.7);
        let (mut sum, mut weight, mut amplitude, mut frequency) = (0.0, 1.0, 1.0, FIRST_FREQUENCY);
        for octave in &self.octaves {
            // The crest is where the noise goes through 0. Valleys are smoother: there the finer octaves weigh less.
            let crest = (1.0 - octave.flat(bent_x * frequency, bent_y * frequency).abs()).max(0.0);
            let ridge = crest * crest * weight;
            sum += ridge * amplitude;
            weight = (0.15 + ridge * 1.3).min(1.0);
            amplitude *= AMPLITUDE_STEP;
            frequency *= FREQUENCY_STEP;
        }
        0.025 * relief + 0.08 * (0.25 + 0.75 * range) * sum
    }
}

impl Model for Terrain {
    fn vertex_count(&self) -> u64 {
        self.sheet.vertices()
    }

    fn triangle_count(&self) -> u64 {
        self.sheet.triangles()
    }

    fn emit_vertices(&self, emit: &mut VertexSink<'_>) -> Result<(), MeshError> {
        for (row, y) in (0..).zip(&self.rows) {
            for column in 0..self.sheet.row_vertices(row) {
                let x = &self.columns[column as usize];
                let bits = self.jitter.hash(column, row);
                let share = |bits: u64| f64::from(bits as i32) * (JITTER / 2_147_483_648.0);
                let place_x = x.place + x.room * share(bits);
                let place_y = y.place + y.room * share(bits >> 32);
                let height = self.height(place_x, place_y);
                emit([(place_x - 0.5) * SIDE, (place_y - 0.5) * SIDE, height * SIDE])?;
            }
        }
        Ok(())
    }

    fn emit_triangles(&self, emit: &mut TriangleSink<'_>) -> Result<(), MeshError> {
        self.sheet.emit_triangles(0, emit)
    }
}
