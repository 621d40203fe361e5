//! Buffers of blocks that stores of one scratch hand on to each other.
//!
//! A pass over a large mesh opens and closes thousands of files, each with a buffer for a short while. From the allocator
//! such a buffer is a piece of a heap that small allocations soon pin down from all sides: at 1,900 files, 90 MiB of freed
//! memory could not be used again (measured). And the system's new pages would have to be zeroed first. So what is
//! dropped here is kept for the next one that asks, up to [`MOST_KEPT`] buffers.

use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, PoisonError};

use crate::disk::Block;

/// The most buffers that are kept for others.
const MOST_KEPT: usize = 8;

/// Buffers that nobody uses at present.
#[derive(Debug, Default)]
pub(crate) struct Buffers {
    kept: Mutex<Vec<Vec<Block>>>,
}

impl Buffers {
    /// A buffer of so many blocks, with anything in them.
    pub fn take(self: &Arc<Self>, blocks: usize) -> Buffer {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        // Not a much larger one: whoever asked was given so many bytes.
        let fitting = (0..kept.len()).filter(|index| (blocks..=2 * blocks).contains(&kept[*index].capacity()));
        let best = fitting.min_by_key(|index| kept[*index].capacity());
        let mut found = match best {
            Some(index) => kept.swap_remove(index),
            None => {
                // What does not fit makes room, so that in all there is never much more than what was once in use.
                let mut room = 0;
                while room < blocks
                    && let Some(smallest) = smallest(&kept)
                {
                    room += kept.swap_remove(smallest).capacity();
                }
                Vec::with_capacity(blocks)
            }
        };
        drop(kept);
        found.resize(blocks, Block::ZERO);
        Buffer { blocks: found, buffers: self.clone() }
    }

    /// Keeps a buffer for the next one, if there is room: else the smallest goes.
    fn give_back(&self, blocks: Vec<Block>) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.push(blocks);
        if kept.len() > MOST_KEPT
            && let Some(smallest) = smallest(&kept)
        {
            kept.swap_remove(smallest);
        }
    }

    /// Lets go of all that is kept.
    pub fn clear(&self) {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

/// Which of these buffers is the smallest.
fn smallest(kept: &[Vec<Block>]) -> Option<usize> {
    (0..kept.len()).min_by_key(|index| kept[*index].capacity())
}

/// Blocks that are someone's until they are dropped.
#[derive(Debug)]
pub(crate) struct Buffer {
    blocks: Vec<Block>,
    buffers: Arc<Buffers>,
}

impl Deref for Buffer {
    type Target = [Block];

    #[inline]
    fn deref(&self) -> &[Block] {
        &self.blocks
    }
}

impl DerefMut for Buffer {
    #[inline]
    fn deref_mut(&mut self) -> &mut [Block] {
        &mut self.blocks
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        self.buffers.give_back(std::mem::take(&mut self.blocks));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_memory_goes_round() {
        let buffers = Arc::new(Buffers::default());
        let first = buffers.take(5).as_ptr();
        let again = buffers.take(3);
        assert_eq!((again.as_ptr(), again.len()), (first, 3));
        assert_ne!(buffers.take(4).as_ptr(), first);
        drop(again);
        drop((0..20).map(|blocks| buffers.take(blocks)).collect::<Vec<_>>());
        let kept: Vec<usize> = buffers.kept.lock().unwrap().iter().map(Vec::capacity).collect();
        assert_eq!(kept.len(), MOST_KEPT);
        assert!(kept.iter().all(|blocks| *blocks >= 12), "{kept:?}");
        buffers.clear();
        assert!(buffers.kept.lock().unwrap().is_empty());
    }
}
