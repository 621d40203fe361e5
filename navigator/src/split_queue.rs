//! The vertices whose nodes are to be split, the most visible first.
//!
//! They stand in lists by their error over the threshold, two lists for each doubling: so a frame that cannot do everything
//! has done the most important, up to a factor of 1.4, and a vertex is put in or taken out in constant time. Within a list the one
//! put in last goes first: the children of what was just split, which are still in the cache.
//!
//! Memory: 4 bytes for each vertex of the front.

use storage::prefetch::prefetch;

use crate::front::NONE;

/// Lists: for errors up to 2^32 times the threshold, and one for what is beyond.
const LISTS: usize = 64;
/// What stands at a vertex that is in no list.
const NOWHERE: u32 = NONE - 1;
/// Bytes for each vertex.
pub const QUEUE_BYTES: usize = size_of::<u32>();

/// The lists.
#[derive(Debug)]
pub struct SplitQueue {
    /// For each vertex the next one of its list.
    next: Vec<u32>,
    firsts: [u32; LISTS],
    /// A bit for each list that is not empty.
    filled: u64,
    length: usize,
}

/// The list for an error so many times the threshold, at least 1.
fn list_of(times: f32) -> usize {
    // The bits of floats are in their order: exponent, then mantissa. One bit of the latter halves each doubling.
    let step = (times.max(1.0).to_bits() >> 22) - (1.0_f32.to_bits() >> 22);
    (step as usize).min(LISTS - 1)
}

impl SplitQueue {
    /// An empty queue, for vertices with numbers below this.
    pub fn new(vertices: usize) -> Self {
        SplitQueue { next: vec![NOWHERE; vertices], firsts: [NONE; LISTS], filled: 0, length: 0 }
    }

    /// Vertices in it.
    pub fn len(&self) -> usize {
        self.length
    }

    /// Puts in a vertex whose node's error is so many times the threshold; no effect where it is in already.
    #[inline]
    pub fn push(&mut self, vertex: u32, times: f32) {
        let list = list_of(times);
        let next = &mut self.next[vertex as usize];
        if *next == NOWHERE {
            *next = std::mem::replace(&mut self.firsts[list], vertex);
            self.filled |= 1 << list;
            self.length += 1;
        }
    }

    /// Takes out one of the most visible.
    #[inline]
    pub fn pop(&mut self) -> Option<u32> {
        let list = self.filled.checked_ilog2()? as usize;
        let vertex = self.firsts[list];
        self.firsts[list] = std::mem::replace(&mut self.next[vertex as usize], NOWHERE);
        if self.firsts[list] == NONE {
            self.filled &= !(1 << list);
        }
        self.length -= 1;
        prefetch(&self.next, self.firsts[list] as usize);
        Some(vertex)
    }

    /// Takes out all.
    pub fn clear(&mut self) {
        while self.pop().is_some() {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Random;

    #[test]
    fn the_largest_error_goes_first_up_to_half_a_doubling() {
        let mut queue = SplitQueue::new(1000);
        let mut random = Random(7);
        let errors: Vec<f32> = (0..1000).map(|_| (random.unit() * 60.0).exp2()).collect();
        (0..1000).for_each(|vertex| queue.push(vertex, errors[vertex as usize]));
        // Once is enough.
        queue.push(17, 1e30);
        assert_eq!(queue.len(), 1000);
        let order: Vec<u32> = std::iter::from_fn(|| queue.pop()).collect();
        assert!(order.len() == 1000 && queue.len() == 0);
        let capped = |vertex: u32| errors[vertex as usize].min(1.5 * 31.0_f32.exp2());
        assert!(order.windows(2).all(|pair| capped(pair[0]) * 1.51 >= capped(pair[1])));
        queue.push(17, f32::INFINITY);
        queue.push(18, 0.0);
        queue.clear();
        assert_eq!((queue.len(), queue.pop()), (0, None));
    }
}
