//! The blocks of the triangles, and the vertices on the seams between blocks.
//!
//! A triangle belongs to the block of its smallest corner. So a vertex has triangles in its own block and in earlier
//! ones, never in later ones. While the triangles pass in canonical order, block by block, a corner in a later block is
//! noted: few, and sorted externally afterwards (4 bytes each).

use bytemuck::{Pod, Zeroable};
use storage::{Scratch, SortRecord, Sorter, Spool, SpoolWriter, StorageError};

use super::MeshBlock;
use super::limits::Limits;

/// A vertex that has a triangle in a block before its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(transparent)]
struct Note(u32);

impl SortRecord for Note {
    #[inline]
    fn prefix(&self) -> u64 {
        self.0.into()
    }
}

/// What is known when all triangles have passed.
#[derive(Debug)]
pub(super) struct Tiling {
    pub blocks: Vec<MeshBlock>,
    pub seam_vertices: Spool<u32>,
}

/// Takes the triangles in canonical order.
#[derive(Debug)]
pub(super) struct Tiler<'a> {
    firsts: &'a [u32],
    vertices: u32,
    blocks: Vec<MeshBlock>,
    /// The first vertex behind the block.
    end: u32,
    triangles: u32,
    notes: Sorter<Note>,
    seam_vertices: SpoolWriter<u32>,
}

impl<'a> Tiler<'a> {
    /// For blocks that begin at these vertices, of so many in all. `left` are the bytes of RAM to share.
    pub fn new(firsts: &'a [u32], vertices: u32, scratch: &Scratch, limits: &Limits, left: usize) -> Self {
        Tiler {
            firsts,
            vertices,
            blocks: Vec::with_capacity(firsts.len()),
            end: 0,
            triangles: 0,
            notes: Sorter::new(scratch, "seams", left / 8, limits.threads),
            seam_vertices: SpoolWriter::new(scratch, "seam-vertices", left / 16),
        }
    }

    /// The next triangle, its smallest corner first.
    #[inline]
    pub fn push(&mut self, [first, second, third]: [u32; 3]) -> Result<(), StorageError> {
        while first >= self.end {
            self.next_block();
        }
        for corner in [second, third] {
            if corner >= self.end {
                self.notes.push(Note(corner))?;
            }
        }
        self.triangles += 1;
        Ok(())
    }

    /// Ends the block, and begins the next one.
    fn next_block(&mut self) {
        self.blocks.push(MeshBlock { first_vertex: self.end, first_triangle: self.triangles });
        self.end = self.firsts.get(self.blocks.len()).copied().unwrap_or(self.vertices);
    }

    pub fn finish(mut self) -> Result<Tiling, StorageError> {
        while self.end < self.vertices {
            self.next_block();
        }
        let mut notes = self.notes.finish()?;
        let mut before = None;
        while let Some(Note(vertex)) = notes.next()? {
            if before != Some(vertex) {
                self.seam_vertices.push(vertex)?;
                before = Some(vertex);
            }
        }
        Ok(Tiling { blocks: self.blocks, seam_vertices: self.seam_vertices.finish()? })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn blocks_tile_and_seams_are_those_of_a_count(
            vertices in 1_u32..300,
            near in prop_oneof![Just(4_u32), Just(400)],
            corners in prop::collection::vec((any::<u32>(), any::<u32>(), any::<u32>()), 0..300),
            cuts in prop::collection::btree_set(0_u32..300, 0..12),
        ) {
            let firsts: Vec<u32> = Some(0).into_iter().chain(cuts.into_iter().filter(|cut| (1..vertices).contains(cut))).collect();
            let mut triangles: Vec<[u32; 3]> = corners
                .iter()
                .map(|&(a, b, c)| {
                    let a = a % vertices;
                    let other = |offset: u32| (a + offset % near).min(vertices - 1);
                    [a, other(b), other(c)]
                })
                .collect();
            triangles.sort();
            let limits = Limits { memory: 1000, threads: 1, block_triangles: 1, vertex_chunk: 1, triangle_chunk: 1 };
            let mut tiler = Tiler::new(&firsts, vertices, &Scratch::in_memory(), &limits, 1000);
            for triangle in &triangles {
                tiler.push(*triangle).unwrap();
            }
            let tiling = tiler.finish().unwrap();

            let block_of = |vertex: u32| firsts.partition_point(|first| *first <= vertex) - 1;
            let abroad = |corners: &[u32; 3]| {
                let home = block_of(corners[0]);
                corners.map(|corner| (block_of(corner) != home).then_some(corner))
            };
            let expected: BTreeSet<u32> = triangles.iter().flat_map(abroad).flatten().collect();
            let mut found = vec![0; tiling.seam_vertices.len() as usize];
            tiling.seam_vertices.read_at(0, &mut found).unwrap();
            prop_assert_eq!(found, Vec::from_iter(expected));
            let first_triangle = |first: u32| triangles.partition_point(|triangle| triangle[0] < first) as u32;
            let blocks: Vec<MeshBlock> = firsts
                .iter()
                .map(|first| MeshBlock { first_vertex: *first, first_triangle: first_triangle(*first) })
                .collect();
            prop_assert_eq!(tiling.blocks, blocks);
        }
    }
}
