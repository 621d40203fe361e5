//! Where the spatial blocks begin.
//!
//! A block is a range of vertices in Morton order. Where its end may lie, a boundary is put where the codes before and
//! after differ in the highest bit: there a large cube of space ends, so blocks are close to boxes and their seams short.
//! [`BlockChooser`] counts vertices, since it must decide before there are triangles in order, and a block should have
//! twice as many triangles as vertices. Where that fails, [`BlockRefiner`] cuts a block again, by its triangles.
//!
//! RAM: 4 bytes for each block.

/// Puts boundaries between vertices that pass in canonical order.
#[derive(Debug)]
pub(super) struct BlockChooser {
    /// The most vertices of a block, and the fewest (but for the last).
    most: u32,
    least: u32,
    firsts: Vec<u32>,
    vertices: u32,
    last_code: u64,
    /// The best place for the next boundary so far: the highest bit that changes there, and the vertex behind it.
    best: (u32, u32),
}

impl BlockChooser {
    pub fn new(block_triangles: u64) -> Self {
        let most = u32::try_from(block_triangles / 2).unwrap_or(u32::MAX).max(1);
        // More than half of the most: so the search for a boundary begins after that for the one before has ended.
        let least = most - most / 5 * 2;
        BlockChooser { most, least, firsts: Vec::new(), vertices: 0, last_code: 0, best: (0, 0) }
    }

    /// The next vertex, by its Morton code.
    #[inline]
    pub fn push(&mut self, code: u64) {
        let vertex = self.vertices;
        match self.firsts.last() {
            None => self.firsts.push(0),
            Some(first) if vertex - first >= self.least => self.consider(vertex, vertex - first, code),
            Some(_) => {}
        }
        self.vertices += 1;
        self.last_code = code;
    }

    /// The block may end before this vertex, and must if it has the most vertices.
    fn consider(&mut self, vertex: u32, size: u32, code: u64) {
        let changed = u64::BITS - (code ^ self.last_code).leading_zeros();
        self.best = self.best.max((changed, vertex));
        if size == self.most {
            self.firsts.push(self.best.1);
            self.best = (0, 0);
        }
    }

    /// How many vertices have passed.
    pub fn vertices(&self) -> u32 {
        self.vertices
    }

    /// The first vertex of each block.
    pub fn finish(self) -> Vec<u32> {
        self.firsts
    }
}

/// Cuts blocks with too many triangles again, while their triangles pass in canonical order.
///
/// What comes out has at most twice the triangles that were asked for in a block, but where a single vertex is the
/// smallest corner of more.
#[derive(Debug)]
pub(super) struct BlockRefiner {
    most_triangles: u64,
    /// The blocks that are still to come begin here, the next one last.
    coming: Vec<u32>,
    firsts: Vec<u32>,
    /// The vertex whose triangles pass, the first of them, and the first of the block.
    vertex: u32,
    vertex_start: u64,
    block_start: u64,
    triangles: u64,
}

impl BlockRefiner {
    pub fn new(blocks: &[u32], block_triangles: u64) -> Self {
        BlockRefiner {
            most_triangles: block_triangles.saturating_mul(2).max(1),
            coming: blocks.iter().rev().copied().collect(),
            firsts: Vec::with_capacity(blocks.len()),
            vertex: 0,
            vertex_start: 0,
            block_start: 0,
            triangles: 0,
        }
    }

    /// The next triangle, by its smallest corner.
    #[inline]
    pub fn push(&mut self, corner: u32) {
        if corner != self.vertex || self.triangles == 0 {
            self.begin_vertex(corner);
        }
        self.triangles += 1;
        if self.triangles - self.block_start > self.most_triangles && self.vertex_start > self.block_start {
            self.firsts.push(self.vertex);
            self.block_start = self.vertex_start;
        }
    }

    fn begin_vertex(&mut self, vertex: u32) {
        self.vertex = vertex;
        self.vertex_start = self.triangles;
        while let Some(first) = self.coming.pop_if(|first| *first <= vertex) {
            self.firsts.push(first);
            self.block_start = self.triangles;
        }
    }

    /// The first vertex of each block.
    pub fn finish(mut self) -> Vec<u32> {
        self.firsts.extend(self.coming.into_iter().rev());
        self.firsts
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn chosen(codes: &[u64], block_triangles: u64) -> Vec<u32> {
        let mut chooser = BlockChooser::new(block_triangles);
        codes.iter().for_each(|code| chooser.push(*code));
        chooser.finish()
    }

    #[test]
    fn a_block_ends_where_the_largest_cube_ends() {
        // Sixteen vertices in two cubes of eight, one to a cell; then the cells of the second are fuller.
        let even: Vec<u64> = (0..16).collect();
        assert_eq!(chosen(&even, 20), [0, 8]);
        let uneven = [0, 1, 2, 3, 4, 5, 6, 7, 8, 8, 8, 8, 9, 9, 9, 10];
        assert_eq!(chosen(&uneven, 20), [0, 8]);
        assert_eq!(chosen(&uneven[8..], 8), [0, 4]);
        assert!(chosen(&[], 20).is_empty());
    }

    #[test]
    fn equal_codes_are_kept_together_where_that_is_possible() {
        assert_eq!(chosen(&[0, 1, 1, 1, 1, 2, 2, 2], 12), [0, 5]);
        assert_eq!(chosen(&[7; 10], 8), [0, 4, 8]);
    }

    proptest! {
        #[test]
        fn blocks_have_about_as_many_vertices_as_they_should(
            mut codes in prop::collection::vec(prop_oneof![0_u64..8, 0_u64..1 << 63], 1..200),
            block_triangles in 0_u64..60,
        ) {
            codes.sort_unstable();
            let firsts = chosen(&codes, block_triangles);
            prop_assert_eq!(firsts[0], 0);
            let most = (block_triangles as u32 / 2).max(1);
            for pair in firsts.windows(2) {
                let size = pair[1] - pair[0];
                prop_assert!(size <= most && 5 * size >= 3 * most, "{} of {}", size, most);
                // No better boundary was passed over.
                let changed = |first: u32| (codes[first as usize] ^ codes[first as usize - 1]).leading_zeros();
                for other in pair[0] + most - most / 5 * 2..=(pair[0] + most).min(codes.len() as u32 - 1) {
                    prop_assert!(changed(pair[1]) <= changed(other));
                }
            }
            prop_assert!(codes.len() as u32 - firsts[firsts.len() - 1] <= most);
        }

        #[test]
        fn no_block_has_more_than_twice_its_triangles(
            stars in prop::collection::vec(prop_oneof![4 => 0_u64..4, 1 => 0_u64..30], 1..60),
            mut blocks in prop::collection::vec(0_u32..60, 0..10),
            block_triangles in 0_u64..12,
        ) {
            blocks.push(0);
            blocks.retain(|first| (*first as usize) < stars.len());
            blocks.sort_unstable();
            blocks.dedup();
            let mut refiner = BlockRefiner::new(&blocks, block_triangles);
            for (vertex, triangles) in stars.iter().enumerate() {
                (0..*triangles).for_each(|_| refiner.push(vertex as u32));
            }
            let refined = refiner.finish();
            prop_assert!(refined.is_sorted_by(|left, right| left < right));
            prop_assert!(blocks.iter().all(|first| refined.contains(first)));
            let most = (2 * block_triangles).max(1);
            for (place, first) in refined.iter().enumerate() {
                let end = refined.get(place + 1).map_or(stars.len(), |end| *end as usize);
                let sizes = &stars[*first as usize..end];
                let not_empty = sizes.iter().filter(|triangles| **triangles > 0).count();
                prop_assert!(sizes.iter().sum::<u64>() <= most || not_empty == 1);
                // Nothing is cut that is small enough.
                if !blocks.contains(first) {
                    let whole = blocks.partition_point(|block| block <= first);
                    let start = blocks[whole - 1] as usize;
                    let end = blocks.get(whole).map_or(stars.len(), |end| *end as usize);
                    prop_assert!(stars[start..end].iter().sum::<u64>() > most);
                }
            }
        }
    }
}
