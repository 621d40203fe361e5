//! Numbers for the vertices and the triangles of the front, in chunks of 64: what is near each other on the surface gets
//! numbers near each other, where there are any.
//!
//! What is born gets a number in the chunk of what it was born from, else in the first chunk that is not full. So the lists
//! stay short, and a ring of neighbours is spread over few cache lines. Chunks at the end that are not used any more are
//! dropped.
//!
//! Memory: two bits for each number.

use super::CHUNK;

/// Many are free where more than one of so many is.
const SPARSE: usize = 8;

/// Which numbers are free.
#[derive(Debug)]
pub struct Numbers {
    /// For each chunk a bit for each number: whether it is free.
    free: Vec<u64>,
    /// A bit for each chunk: whether any is.
    open: Vec<u64>,
    /// No word of `open` before this one has a bit.
    first_open: usize,
    most_chunks: usize,
    used: usize,
}

impl Numbers {
    /// Room for `most` numbers, rounded up to whole chunks.
    pub fn new(most: usize) -> Self {
        let most_chunks = most.div_ceil(CHUNK);
        Numbers {
            free: Vec::with_capacity(most_chunks),
            open: Vec::with_capacity(most_chunks.div_ceil(64)),
            first_open: 0,
            most_chunks,
            used: 0,
        }
    }

    /// Chunks begun. All numbers are below 64 times that.
    pub fn chunks(&self) -> usize {
        self.free.len()
    }

    /// Numbers in use.
    pub fn used(&self) -> usize {
        self.used
    }

    /// Whether the number is in use.
    pub fn is_used(&self, number: u32) -> bool {
        self.free.get(number as usize / CHUNK).is_some_and(|free| free & 1 << (number as usize % CHUNK) == 0)
    }

    /// Takes a number, best one in the chunk of `near`; `None` where all are taken.
    pub fn allocate(&mut self, near: u32) -> Option<u32> {
        let near = near as usize / CHUNK;
        let chunk = if self.free.get(near).is_some_and(|free| *free != 0) { near } else { self.open_chunk()? };
        let place = self.free[chunk].trailing_zeros();
        self.free[chunk] &= self.free[chunk] - 1;
        if self.free[chunk] == 0 {
            self.open[chunk / 64] &= !(1 << (chunk % 64));
        }
        self.used += 1;
        Some((chunk * CHUNK) as u32 + place)
    }

    /// The first chunk that is not full; a new one where there is none.
    fn open_chunk(&mut self) -> Option<usize> {
        while let Some(word) = self.open.get(self.first_open) {
            if *word != 0 {
                return Some(self.first_open * 64 + word.trailing_zeros() as usize);
            }
            self.first_open += 1;
        }
        let chunk = self.free.len();
        if chunk == self.most_chunks {
            return None;
        }
        self.free.push(u64::MAX);
        if chunk / 64 == self.open.len() {
            self.open.push(0);
        }
        self.open[chunk / 64] |= 1 << (chunk % 64);
        self.first_open = chunk / 64;
        Some(chunk)
    }

    /// Gives a number back.
    pub fn release(&mut self, number: u32) {
        let (chunk, place) = (number as usize / CHUNK, number as usize % CHUNK);
        self.free[chunk] |= 1 << place;
        self.open[chunk / 64] |= 1 << (chunk % 64);
        self.first_open = self.first_open.min(chunk / 64);
        self.used -= 1;
    }

    /// Drops the chunks at the end in which no number is used. True if there were any.
    pub fn drop_free_chunks(&mut self) -> bool {
        let chunks = self.free.len();
        while self.free.last() == Some(&u64::MAX) {
            self.free.pop();
            self.open[self.free.len() / 64] &= !(1 << (self.free.len() % 64));
        }
        self.open.truncate(self.free.len().div_ceil(64));
        self.first_open = self.first_open.min(self.open.len());
        self.free.len() < chunks
    }

    /// Where many numbers below the largest in use are free, that one. No chunk at the end can be dropped.
    pub fn last_if_sparse(&self) -> Option<u32> {
        let numbers = self.free.len() * CHUNK;
        let free = numbers - self.used;
        if free > CHUNK && free > numbers / SPARSE { self.last() } else { None }
    }

    /// The largest number in use, where no chunk at the end can be dropped.
    pub fn last(&self) -> Option<u32> {
        let free = self.free.last()?;
        Some((self.free.len() * CHUNK) as u32 - 1 - (!free).leading_zeros())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Random;
    use std::collections::HashSet;

    #[test]
    fn numbers_are_given_once_and_near_where_that_can_be() {
        let mut numbers = Numbers::new(200);
        let mut random = Random(3);
        let mut taken = HashSet::new();
        for _ in 0..10_000 {
            let near = random.below(256) as u32;
            if random.below(3) > 0 {
                let has_near = (near / 64 * 64..near / 64 * 64 + 64).any(|number| !taken.contains(&number));
                match numbers.allocate(near) {
                    Some(number) => {
                        assert!(taken.insert(number) && (number as usize) < 256);
                        assert!(
                            !has_near
                                || near as usize / 64 >= numbers.chunks()
                                || number / 64 == near / 64
                                || taken.len() <= 64 * numbers.chunks()
                        );
                    }
                    None => assert_eq!(taken.len(), 256),
                }
            } else if let Some(number) = taken.iter().copied().min_by_key(|number| number ^ near) {
                taken.remove(&number);
                numbers.release(number);
                if random.below(50) == 0 {
                    numbers.drop_free_chunks();
                    assert_eq!(numbers.last(), taken.iter().max().copied());
                }
            }
            assert_eq!(numbers.used(), taken.len());
        }
        assert!((0..300).all(|number| numbers.is_used(number) == taken.contains(&number)));
    }

    #[test]
    fn a_hole_in_the_chunk_is_filled_before_others() {
        let mut numbers = Numbers::new(192);
        (0..192).for_each(|number| assert_eq!(numbers.allocate(0), Some(number)));
        assert_eq!(numbers.allocate(0), None);
        [3, 70, 130].into_iter().for_each(|number| numbers.release(number));
        assert_eq!(
            [numbers.allocate(129), numbers.allocate(128), numbers.allocate(128)],
            [Some(130), Some(3), Some(70)]
        );
    }
}
