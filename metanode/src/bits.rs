//! A bit for each leaf, or vertex, or tree, and ranks: how many bits are set up to a leaf.
//!
//! Memory: one bit for each leaf; the ranks take half a bit more. A rank is one look-up and one population count.

/// A set of numbers below a fixed bound.
#[derive(Debug, Clone)]
pub(crate) struct Bits {
    words: Vec<u64>,
}

impl Bits {
    /// The empty set of numbers below `count`.
    pub(crate) fn new(count: u32) -> Self {
        Bits { words: vec![0; (count as usize).div_ceil(64)] }
    }

    /// Puts `number` in.
    pub(crate) fn insert(&mut self, number: u32) {
        self.words[number as usize / 64] |= 1 << (number % 64);
    }

    /// Whether `number` is in it.
    pub(crate) fn contains(&self, number: u32) -> bool {
        self.words[number as usize / 64] >> (number % 64) & 1 == 1
    }

    /// Bytes of RAM that this holds.
    pub(crate) fn resident_bytes(&self) -> usize {
        self.words.capacity() * size_of::<u64>()
    }

    /// The same set, closed to changes, with ranks.
    pub(crate) fn ranked(self) -> RankedBits {
        let mut before = Vec::with_capacity(self.words.len());
        let mut total = 0;
        for word in &self.words {
            before.push(total);
            total += word.count_ones();
        }
        RankedBits { words: self.words, before, total }
    }
}

/// A set of numbers that tells ranks.
#[derive(Debug, Clone)]
pub(crate) struct RankedBits {
    words: Vec<u64>,
    /// For each word, how many bits are set in the words before it.
    before: Vec<u32>,
    total: u32,
}

impl RankedBits {
    /// How many numbers are in the set.
    pub(crate) fn len(&self) -> u32 {
        self.total
    }

    /// How many numbers of the set are at most `number`.
    pub(crate) fn rank(&self, number: u32) -> u32 {
        let word = number as usize / 64;
        self.before[word] + (self.words[word] << (63 - number % 64)).count_ones()
    }

    /// Bytes of RAM that this holds.
    pub(crate) fn resident_bytes(&self) -> usize {
        self.words.capacity() * size_of::<u64>() + self.before.capacity() * size_of::<u32>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_count_up_to_and_with_the_number() {
        let mut bits = Bits::new(200);
        [0, 5, 63, 64, 130, 199].into_iter().for_each(|number| bits.insert(number));
        assert!((0..200).filter(|number| bits.contains(*number)).eq([0, 5, 63, 64, 130, 199]));
        let ranked = bits.ranked();
        let expected = |number: u32| [0, 5, 63, 64, 130, 199].iter().filter(|set| **set <= number).count() as u32;
        assert!((0..200).all(|number| ranked.rank(number) == expected(number)));
        assert_eq!(ranked.len(), 6);
    }
}
