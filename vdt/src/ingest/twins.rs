//! Vertices at the position of one shortly before: what a soup of triangles has five for each of.
//!
//! They need no place of their own in the sort, only the way back to their twin: two bytes each, the distance between the
//! two numbers, in the order of the files. Twins that are farther apart, or that a small table has forgotten, are welded
//! by the sort as any other; so the table decides what is fast and nothing else.
//!
//! Memory: 512 KiB for the table (896 with attributes), 256 KiB to find the ids again. I/O: 2 bytes for each vertex of the files up to the last
//! one that has a twin, and none where there is none.

use storage::{Scattered, Scratch, Spool, SpoolReader, SpoolWriter, StorageError};

/// Entries of the table, as a power of two.
const TABLE_BITS: u32 = 14;
/// How many ids are remembered: as far as a twin may be.
const RECENT_IDS: usize = 1 << 16;

/// A vertex as twins have it in common.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Look<W> {
    /// The position, bit by bit.
    pub position: [u32; 3],
    /// What it was before it was rounded.
    pub unrounded: u64,
    /// Its attributes, where there are any.
    pub wedge: W,
}

/// What was seen, and the last vertex that had it.
#[derive(Debug, Clone, Copy, Default)]
struct Seen<W> {
    look: Look<W>,
    /// The vertex's number and one, 0 for none.
    number: u64,
}

/// Finds the twins of vertices that pass in the order of their numbers. `W` are the attributes.
#[derive(Debug)]
pub(super) struct TwinFinder<W> {
    table: Vec<Seen<W>>,
    distances: SpoolWriter<u16>,
    found: u64,
}

impl<W: Copy + Default + PartialEq> TwinFinder<W> {
    /// `ram_bytes` are the share of the distances.
    pub fn new(scratch: &Scratch, ram_bytes: usize) -> Self {
        TwinFinder {
            table: vec![Seen::default(); 1 << TABLE_BITS],
            distances: SpoolWriter::new(scratch, "twins", ram_bytes),
            found: 0,
        }
    }

    /// Whether a vertex has a twin before it. `salt` is a number that different attributes hardly have in common.
    #[inline]
    pub fn has_twin(&mut self, number: u32, look: Look<W>, salt: u64) -> Result<bool, StorageError> {
        let [x, y, z] = look.position.map(u64::from);
        let mixed = (x ^ y.rotate_left(21) ^ z.rotate_left(42) ^ salt).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let seen = &mut self.table[(mixed >> (u64::BITS - TABLE_BITS)) as usize];
        let number = u64::from(number) + 1;
        let before = std::mem::replace(seen, Seen { look, number });
        if before.number == 0 || before.look != look {
            return Ok(false);
        }
        match u16::try_from(number - before.number) {
            Ok(distance) => self.note(number - 1, distance).map(|()| true),
            Err(_) => Ok(false),
        }
    }

    fn note(&mut self, number: u64, distance: u16) -> Result<(), StorageError> {
        while self.distances.len() < number {
            self.distances.push(0)?;
        }
        self.found += 1;
        self.distances.push(distance)
    }

    pub fn finish(self) -> Result<Twins, StorageError> {
        Ok(Twins { distances: self.distances.finish()?, found: self.found })
    }
}

/// For each vertex, how far before it its twin is; 0 where it has none, and nothing behind the last that has one.
#[derive(Debug)]
pub(super) struct Twins {
    distances: Spool<u16>,
    /// How many vertices have a twin.
    pub found: u64,
}

impl Twins {
    /// Bytes of RAM that they hold.
    pub fn ram(&self) -> usize {
        self.distances.ram_bytes()
    }

    /// The ids of all vertices, where `ids` has those of the vertices without a twin. Reads through a buffer of so many
    /// bytes.
    pub fn ids(&self, ids: Scattered<u32>, buffer: usize) -> TwinIds<'_> {
        let recent = vec![0; if self.found > 0 { RECENT_IDS } else { 0 }];
        TwinIds { ids, distances: self.distances.reader(buffer), recent, number: 0 }
    }
}

/// Hands out the ids of all vertices in the order of their numbers.
#[derive(Debug)]
pub(super) struct TwinIds<'a> {
    ids: Scattered<u32>,
    distances: SpoolReader<'a, u16>,
    /// The last ids, each at its number modulo the length.
    recent: Vec<u32>,
    number: usize,
}

impl TwinIds<'_> {
    /// The id of the next vertex, `None` behind the last.
    #[inline]
    pub fn next(&mut self) -> Result<Option<u32>, StorageError> {
        let Some(mut id) = self.ids.next()? else { return Ok(None) };
        if !self.recent.is_empty() {
            let distance = usize::from(self.distances.next()?.unwrap_or(0));
            if distance > 0 {
                id = self.recent[(self.number - distance) % RECENT_IDS];
            }
            self.recent[self.number % RECENT_IDS] = id;
            self.number += 1;
        }
        Ok(Some(id))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use proptest::prelude::*;
    use storage::Scatter;

    use super::*;

    /// Gives ids to the vertices at these positions; how many have a twin, and the ids of all.
    fn ids_of(positions: &[[u32; 3]]) -> (u64, Vec<u32>) {
        let scratch = Scratch::in_memory();
        let mut finder = TwinFinder::new(&scratch, 100);
        let mut scatter = Scatter::new(&scratch, "ids", positions.len() as u64, 100);
        let mut welded = HashMap::new();
        for (number, position) in positions.iter().enumerate() {
            let next = welded.len() as u32;
            let id = *welded.entry(*position).or_insert(next);
            if !finder.has_twin(number as u32, Look { position: *position, unrounded: 0, wedge: () }, 0).unwrap() {
                scatter.put(number as u32, id).unwrap();
            }
        }
        let twins = finder.finish().unwrap();
        let mut ids = twins.ids(scatter.finish().unwrap(), 100);
        let mut found = Vec::new();
        while let Some(id) = ids.next().unwrap() {
            found.push(id);
        }
        assert_eq!(found.len(), positions.len());
        for (position, id) in positions.iter().zip(&found) {
            assert_eq!(id, &welded[position]);
        }
        (twins.found, found)
    }

    #[test]
    fn twins_are_found_as_far_as_a_distance_reaches() {
        for (between, expected) in [(0_u32, 1), (65_534, 1), (65_535, 0), (200_000, 0)] {
            // The vertices in between are all the same: they do not drive the first out of the table.
            let mut positions = vec![[1, 2, 3]];
            positions.extend((0..between).map(|_| [4, 5, 6]));
            positions.push([1, 2, 3]);
            let (found, _) = ids_of(&positions);
            assert_eq!(found, u64::from(between.saturating_sub(1)) + expected, "{between}");
        }
    }

    #[test]
    fn a_table_that_forgets_does_no_harm() {
        let positions: Vec<[u32; 3]> = (0..60_000_u32).map(|number| [number % 30_000, 7, 7]).collect();
        let (found, _) = ids_of(&positions);
        assert!(found < 30_000);
    }

    proptest! {
        #[test]
        fn every_vertex_has_the_id_of_its_position(
            positions in prop::collection::vec(prop::array::uniform3(0_u32..3), 0..200),
        ) {
            let (found, ids) = ids_of(&positions);
            let distinct = ids.iter().max().map_or(0, |most| most + 1);
            prop_assert!(found > 0 || positions.len() == distinct as usize);
        }
    }
}
