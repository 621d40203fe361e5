//! The splits to be undone, in the order of rising ids: so every collapse finds done what it depends on (the paper, 3.3.5).
//!
//! Those that the evaluation of a frame found are sorted once. Those that follow, because both children became active, have
//! larger ids than what they follow, and go to a heap beside them.
//!
//! Memory: 8 bytes for each. There is room for so many found and so many that follow; more wait for the next frame.

use std::collections::BinaryHeap;

use crate::window::Window;

/// The most collapses that a frame finds, and the most that follow. (Few in tests, so that some wait.)
const MOST: usize = if cfg!(test) { 48 } else { 1 << 15 };
/// How many others lie between the steps in which what is known of those found is fetched.
const APART: usize = 8;

/// The queue. A split is named by the vertex that it bore.
#[derive(Debug)]
pub struct CollapseQueue {
    found: Vec<u64>,
    /// How many of those found went into the window.
    begun: usize,
    window: Window,
    /// The first of those found that is not done yet.
    head: Option<u64>,
    follows: BinaryHeap<std::cmp::Reverse<u64>>,
    most: usize,
}

fn key(id: u32, born: u32) -> u64 {
    u64::from(id) << 32 | u64::from(born)
}

impl CollapseQueue {
    /// An empty queue, for a front with so many vertices.
    pub fn new(vertices: usize) -> Self {
        let most = Self::room(vertices);
        CollapseQueue {
            found: Vec::with_capacity(most),
            begun: 0,
            window: Window::default(),
            head: None,
            follows: BinaryHeap::with_capacity(most),
            most,
        }
    }

    /// Room for a front with so many vertices.
    fn room(vertices: usize) -> usize {
        (vertices / 2 + 1).min(MOST)
    }

    /// Bytes for such a front.
    pub fn bytes(vertices: usize) -> usize {
        2 * Self::room(vertices) * size_of::<u64>()
    }

    /// Empties it, for a new frame.
    pub fn clear(&mut self) {
        self.found.clear();
        self.follows.clear();
        (self.begun, self.window, self.head) = (0, Window::default(), None);
    }

    /// Splits in it.
    pub fn len(&self) -> usize {
        let found = self.found.len().saturating_sub(self.begun) + self.window.len();
        found + usize::from(self.head.is_some()) + self.follows.len()
    }

    /// Adds vertices into which is to be collapsed: the bits of a block of them, whose first is given. False where those are too
    /// many: then some of them were not added.
    pub fn find(&mut self, first: u32, mut block: u64) -> bool {
        while block != 0 && self.found.len() < self.most {
            self.found.push(u64::from(first + block.trailing_zeros()));
            block &= block - 1;
        }
        block == 0
    }

    /// All are found: `split_of` says of each the id of the node that is to be restored there, and the vertex that its split bore;
    /// `None` for one that is to wait. `fetch` makes two steps towards that.
    pub fn order(&mut self, fetch: impl Fn(u32, usize), mut split_of: impl FnMut(u32) -> Option<(u32, u32)>) {
        let found = &mut self.found;
        let mut left = 0;
        for index in 0..found.len() + 2 * APART {
            if let Some(vertex) = found.get(index) {
                fetch(*vertex as u32, 0);
            }
            if let Some(vertex) = index.checked_sub(APART).and_then(|index| found.get(index)) {
                fetch(*vertex as u32, 1);
            }
            let Some(vertex) = index.checked_sub(2 * APART).map(|index| found[index] as u32) else { continue };
            if let Some((id, born)) = split_of(vertex) {
                found[left] = key(id, born);
                left += 1;
            }
        }
        found.truncate(left);
        found.sort_unstable();
    }

    /// Adds one that follows the one taken last. False where there are too many.
    pub fn follow(&mut self, id: u32, born: u32) -> bool {
        let fits = self.follows.len() < self.most;
        if fits {
            self.follows.push(std::cmp::Reverse(key(id, born)));
        }
        fits
    }

    /// The next one. `fetch` makes a step towards it, see [`Window`].
    #[inline]
    pub fn next(&mut self, fetch: impl FnMut(u32, usize)) -> Option<u32> {
        if self.head.is_none() {
            let (found, begun) = (&self.found, &mut self.begun);
            let more = || {
                let index = *begun;
                found.get(index)?;
                *begun += 1;
                Some(index as u32)
            };
            let mut fetch = fetch;
            let next = self.window.next(more, |index, step| fetch(found[index as usize] as u32, step));
            self.head = next.map(|index| self.found[index as usize]);
        }
        let follows = self.follows.peek().map(|key| key.0);
        let is_first = match (self.head, follows) {
            (Some(head), Some(follows)) => head <= follows,
            (head, _) => head.is_some(),
        };
        let key = if is_first { self.head.take() } else { self.follows.pop().map(|key| key.0) };
        key.map(|key| key as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Random;

    /// Whatever is found and whatever follows, with larger ids than what it follows: the ids rise.
    #[test]
    fn ids_rise() {
        let mut random = Random(5);
        let mut queue = CollapseQueue::new(1000);
        for round in 0..20 {
            queue.clear();
            let count = random.below(40);
            let mut expected: Vec<u32> = (0..count).map(|_| random.below(1000) as u32).collect();
            // One block for each, as vertices need not be in order; one more waits.
            expected.iter().chain([&2000]).for_each(|id| assert!(queue.find(*id, 1)));
            queue.order(|_, _| (), |vertex| (vertex < 2000).then_some((vertex, vertex + 5)));
            let mut order = Vec::new();
            while let Some(born) = queue.next(|_, _| ()) {
                order.push(born - 5);
                if random.below(3) == 0 {
                    let later = born - 5 + random.below(500) as u32;
                    assert!(queue.follow(later, later + 5));
                    expected.push(later);
                }
                assert_eq!(queue.len(), expected.len() - order.len());
            }
            expected.sort_unstable();
            assert!(order == expected, "round {round}");
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let mut queue = CollapseQueue::new(8);
        assert!(queue.find(0, 0b1011) && !queue.find(64, 0b111) && queue.len() == 5 && !queue.find(128, 1));
        assert_eq!((0..9).filter(|id| queue.follow(*id, 0)).count(), 5);
    }
}
