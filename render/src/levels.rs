//! Levels of detail, to be seen as colours: each step is half the error of the one before.
//!
//! A vertex has the level of its switch value: the error at which it would be split. Vertices of the input mesh have one of their own.
//!
//! Memory: two bytes for each vertex of the front, while levels are drawn. Time: once through the active nodes in each frame.

use std::ops::Range;

use navigator::Navigator;

/// Levels that have a colour of their own.
pub const LEVELS: usize = 64;
/// The level of a vertex of the input mesh.
const OF_INPUT: u8 = 0;
/// Levels after which hues come again.
const HUES: f32 = 12.0;
/// Levels that are compared at once, and sent at once: a multiple of four, as what is sent to a device.
pub const BLOCK: usize = 64;

/// The levels of the vertices of a front, by their numbers.
#[derive(Debug, Default)]
pub struct Levels {
    of_vertices: Vec<u8>,
    before: Vec<u8>,
}

impl Levels {
    /// Takes over those of a front.
    pub fn update(&mut self, navigator: &Navigator) {
        std::mem::swap(&mut self.of_vertices, &mut self.before);
        self.of_vertices.clear();
        self.of_vertices.resize((navigator.node_bound() as usize).next_multiple_of(BLOCK), OF_INPUT);
        let diagonal = navigator.model().header().diagonal();
        for node in navigator.active_nodes() {
            self.of_vertices[node.node as usize] = level(node.switch.into(), diagonal);
        }
    }

    /// The levels, by the numbers of the vertices, and some more: a multiple of [`BLOCK`] in all.
    pub fn of_vertices(&self) -> &[u8] {
        &self.of_vertices
    }

    /// Which blocks of [`BLOCK`] are not what they were before the last update.
    pub fn changed(&self) -> impl Iterator<Item = Range<u32>> + '_ {
        let blocks = (0..).zip(self.of_vertices.chunks(BLOCK));
        let mut before = self.before.chunks(BLOCK);
        blocks.filter(move |(_, block)| before.next() != Some(*block)).map(|(number, _): (u32, _)| number..number + 1)
    }
}

fn level(switch: f64, diagonal: f64) -> u8 {
    if switch <= 0.0 {
        return OF_INPUT;
    }
    let halvings = (diagonal / switch).log2().floor();
    1 + halvings.clamp(0.0, (LEVELS - 2) as f64) as u8
}

/// The colour of a level: parts of the light that it throws back, red, green and blue.
pub fn colour(level: u8) -> [f32; 3] {
    if level == OF_INPUT {
        return [0.8, 0.8, 0.8];
    }
    let hue = f32::from(level) / HUES * 6.0;
    // Red, green and blue have their turn a third of the way round apart.
    [0.0, 4.0, 2.0].map(|turn| {
        let part = ((hue + turn).rem_euclid(6.0) - 3.0).abs() - 1.0;
        0.08 + 0.8 * part.clamp(0.0, 1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_the_error_is_another_level_with_another_colour() {
        assert_eq!((level(0.0, 8.0), level(8.0, 8.0), level(4.0, 8.0), level(3.9, 8.0)), (0, 1, 2, 2));
        assert_eq!((level(1e-300, 1.0), level(9.0, 8.0)), (LEVELS as u8 - 1, 1));
        for step in 0..20 {
            assert_ne!(colour(step), colour(step + 1));
        }
    }
}
