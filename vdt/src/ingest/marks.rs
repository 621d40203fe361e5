//! One bit for each of many numbers: which of them are used.
//!
//! They are marked in any order, so they must be in RAM while they are marked. Where all do not fit, a window of them
//! is, and whoever marks goes over everything again for each further window. Once complete they are read from front to
//! back, an eighth of a byte each.

use storage::{Scratch, SpoolReader, SpoolWriter, StorageError};

use super::limits::Kept;

/// The marks of a range of numbers, being set. What lies outside of the range is ignored.
#[derive(Debug)]
pub(super) struct MarkWindow {
    first: u64,
    words: Vec<u64>,
    most_words: usize,
}

impl MarkWindow {
    /// The window that begins at number 0, and takes at most `ram_bytes`.
    pub fn new(ram_bytes: usize) -> Self {
        // It grows to twice its size, with the old one beside it.
        MarkWindow { first: 0, words: Vec::new(), most_words: (ram_bytes / 2 / size_of::<u64>()).max(1) }
    }

    #[inline]
    pub fn mark(&mut self, number: u64) {
        let offset = number.wrapping_sub(self.first);
        let word = (offset / 64) as usize;
        if word < self.words.len() || self.grow_to(offset / 64) {
            self.words[word] |= 1 << (offset % 64);
        }
    }

    #[cold]
    fn grow_to(&mut self, word: u64) -> bool {
        if word >= self.most_words as u64 {
            return false;
        }
        let length = (word as usize + 1).max(2 * self.words.len()).min(self.most_words);
        self.words.reserve_exact(length - self.words.len());
        self.words.resize(length, 0);
        true
    }

    /// Completes the marks of the numbers below `count`. `mark_again` marks everything once more, in the window that it
    /// is given; it is called for each window after this one. What is finished goes to a sequence with a share of
    /// `ram_bytes`.
    pub fn complete<E: From<StorageError>>(
        mut self,
        count: u64,
        scratch: &Scratch,
        name: &str,
        ram_bytes: usize,
        mut mark_again: impl FnMut(&mut MarkWindow) -> Result<(), E>,
    ) -> Result<Marks, E> {
        let mut writer = SpoolWriter::new(scratch, name, ram_bytes);
        let mut marked = 0;
        loop {
            let numbers = (count - self.first).min(64 * self.most_words as u64);
            self.words.resize(numbers.div_ceil(64) as usize, 0);
            marked += self.words.iter().map(|word| u64::from(word.count_ones())).sum::<u64>();
            writer.extend(&self.words)?;
            self.first += numbers;
            if self.first == count {
                return Ok(Marks { words: Kept::finish(writer, ram_bytes)?, marked, unmarked: count - marked });
            }
            self.words.clear();
            mark_again(&mut self)?;
        }
    }
}

/// The marks of all numbers below a count.
#[derive(Debug)]
pub(super) struct Marks {
    words: Kept<u64>,
    /// How many are marked.
    pub marked: u64,
    /// How many are not.
    pub unmarked: u64,
}

impl Marks {
    /// Bytes of RAM that they hold.
    pub fn ram(&self) -> usize {
        self.words.ram
    }

    /// Reads them from number 0 on, through a buffer of so many bytes.
    pub fn reader(&self, buffer: usize) -> MarksReader<'_> {
        let reader = (self.unmarked > 0).then(|| self.words.spool.reader(buffer));
        MarksReader { reader, word: 0, left: 0 }
    }
}

/// Reads [`Marks`] from front to back.
#[derive(Debug)]
pub(super) struct MarksReader<'a> {
    /// Not needed where all are marked.
    reader: Option<SpoolReader<'a, u64>>,
    word: u64,
    left: u32,
}

impl MarksReader<'_> {
    /// Whether the next number is marked.
    #[inline]
    pub fn next(&mut self) -> Result<bool, StorageError> {
        let Some(reader) = &mut self.reader else { return Ok(true) };
        if self.left == 0 {
            self.word = reader.next()?.unwrap_or(0);
            self.left = 64;
        }
        let marked = self.word & 1 == 1;
        self.word >>= 1;
        self.left -= 1;
        Ok(marked)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn any_window_marks_what_is_named(
            numbers in prop::collection::vec(0_u64..700, 0..50),
            beyond in 0_u64..200,
            everything: bool,
            ram_bytes in 1_usize..200,
        ) {
            let count = numbers.iter().max().map_or(0, |most| most + 1) + beyond;
            let numbers = if everything { (0..count).rev().collect() } else { numbers };
            let mark_all = |window: &mut MarkWindow| numbers.iter().for_each(|number| window.mark(*number));
            let mut window = MarkWindow::new(ram_bytes);
            mark_all(&mut window);
            let mut windows = 1_u64;
            let marks = window
                .complete(count, &Scratch::in_memory(), "marks", 100, |window| {
                    windows += 1;
                    mark_all(window);
                    Ok::<_, StorageError>(())
                })
                .unwrap();
            prop_assert_eq!(windows, count.div_ceil(64 * (ram_bytes as u64 / 16).max(1)).max(1));
            let mut reader = marks.reader(100);
            for number in 0..count {
                prop_assert_eq!(reader.next().unwrap(), numbers.contains(&number));
            }
            let distinct = (0..count).filter(|number| numbers.contains(number)).count() as u64;
            prop_assert_eq!((marks.marked, marks.unmarked), (distinct, count - distinct));
        }
    }
}
