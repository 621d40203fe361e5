//! Geomorphs: what a split bears begins where the vertex that it was born from was drawn, and goes to its own place in a few
//! frames, so that no split pops (Hoppe, "Smooth view-dependent level-of-detail control", 1998). When it is born, all its new
//! triangles have no area yet, and the others are drawn as before.
//!
//! The way is one in time, not in error: what came late, because a page had to be read, goes slowly, too. Nothing but the
//! drawing depends on it. Collapses have no way back: they are made where the error is below what was asked for, while a split
//! may come when it is far above.
//!
//! Who draws puts a vertex at `origin + weight * (position - origin)`: both stand here, in a stream like that of the positions,
//! by the numbers of the vertices. What does not move has weight 1.
//!
//! Memory: [`MORPH_BYTES`] = 20 and two bits for each vertex. Time: a look at each vertex that is on its way, in each frame.

use super::CHUNK;
use super::changes::Changes;
use super::numbers::Numbers;

/// Bytes for each vertex; two bits more are notes.
pub const MORPH_BYTES: usize = size_of::<[f32; 4]>() + size_of::<u32>();

/// What stands where nothing moves.
const AT_REST: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

/// Where the vertices come from, and how far they are.
#[derive(Debug)]
pub struct Morphs {
    /// Origin, and weight.
    stream: Vec<[f32; 4]>,
    /// The vertices that are on their way, and perhaps some that are gone; a bit for each that is in that list.
    under_way: Vec<u32>,
    is_listed: Vec<u64>,
    /// By how much a weight grows in a frame.
    step: f32,
    changes: Changes,
}

impl Morphs {
    /// For so many vertices at most, whose ways take so many frames, at least one.
    pub fn new(vertices: usize, frames: u32) -> Self {
        Morphs {
            stream: super::list(vertices),
            under_way: super::list(vertices),
            is_listed: vec![0; vertices.div_ceil(CHUNK)],
            step: 1.0 / frames.max(1) as f32,
            changes: Changes::new(vertices),
        }
    }

    /// Origins and weights, by the numbers of the vertices.
    pub fn stream(&self) -> &[[f32; 4]] {
        &self.stream
    }

    /// Which of them have changed.
    pub fn changes(&self) -> &Changes {
        &self.changes
    }

    /// Forgets which have.
    pub fn clear_changes(&mut self) {
        self.changes.clear();
    }

    /// Vertices that are on their way.
    pub fn under_way(&self, numbers: &Numbers) -> usize {
        self.under_way.iter().filter(|vertex| numbers.is_used(**vertex)).count()
    }

    /// So many places.
    pub fn resize(&mut self, bound: usize) {
        self.stream.resize(bound, AT_REST);
    }

    /// Where a vertex that stands at this position is drawn.
    pub fn drawn(&self, vertex: u32, position: [f32; 3]) -> [f32; 3] {
        let [x, y, z, weight] = self.stream[vertex as usize];
        let between = |from: f32, to: f32| if weight < 1.0 { from + weight * (to - from) } else { to };
        [between(x, position[0]), between(y, position[1]), between(z, position[2])]
    }

    /// A vertex is there that comes from nowhere.
    pub fn put(&mut self, vertex: u32) {
        self.set(vertex, AT_REST);
    }

    /// A vertex sets out from where another was drawn.
    pub fn begin(&mut self, vertex: u32, [x, y, z]: [f32; 3]) {
        self.set(vertex, [x, y, z, 0.0]);
    }

    /// A vertex gets another number, with its way.
    pub fn renumber(&mut self, from: u32, to: u32) {
        self.set(to, self.stream[from as usize]);
    }

    fn set(&mut self, vertex: u32, way: [f32; 4]) {
        self.stream[vertex as usize] = way;
        self.changes.note(vertex);
        let (word, bit) = (&mut self.is_listed[vertex as usize / 64], 1 << (vertex % 64));
        if way[3] < 1.0 && *word & bit == 0 {
            *word |= bit;
            self.under_way.push(vertex);
        }
    }

    /// All that are on their way go a step on.
    pub fn step(&mut self, numbers: &Numbers) {
        let Morphs { stream, under_way, is_listed, step, changes } = self;
        under_way.retain(|vertex| {
            let mut goes_on = numbers.is_used(*vertex);
            if goes_on {
                let way = &mut stream[*vertex as usize];
                way[3] += *step;
                // Steps may not add up to one.
                goes_on = way[3] < 1.0 - *step / 2.0;
                if !goes_on {
                    way[3] = 1.0;
                }
                changes.note(*vertex);
            }
            if !goes_on {
                is_listed[*vertex as usize / 64] &= !(1 << (vertex % 64));
            }
            goes_on
        });
    }
}
