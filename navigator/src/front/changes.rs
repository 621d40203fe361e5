//! Which elements of a list have changed since somebody last asked: what a renderer has to upload.
//!
//! Memory: a bit for each element.

use std::ops::Range;

/// A bit for each element.
#[derive(Debug)]
pub struct Changes {
    words: Vec<u64>,
}

impl Changes {
    /// No changes, of up to `most` elements.
    pub fn new(most: usize) -> Self {
        Changes { words: vec![0; most.div_ceil(64)] }
    }

    /// Notes that an element has changed.
    #[inline]
    pub fn note(&mut self, element: u32) {
        self.words[element as usize / 64] |= 1 << (element % 64);
    }

    /// The elements that have changed, as ranges; two with at most `gap` unchanged elements between them as one.
    pub fn ranges(&self, gap: u32) -> impl Iterator<Item = Range<u32>> + '_ {
        let mut elements = self.elements().peekable();
        std::iter::from_fn(move || {
            let first = elements.next()?;
            let mut end = first + 1;
            while let Some(next) = elements.next_if(|next| next - end <= gap) {
                end = next + 1;
            }
            Some(first..end)
        })
    }

    fn elements(&self) -> impl Iterator<Item = u32> + '_ {
        let words = self.words.iter().enumerate().filter(|(_, word)| **word != 0);
        words.flat_map(|(index, word)| {
            let mut rest = *word;
            std::iter::from_fn(move || {
                let place = (rest != 0).then(|| rest.trailing_zeros())?;
                rest &= rest - 1;
                Some(index as u32 * 64 + place)
            })
        })
    }

    /// Forgets them.
    pub fn clear(&mut self) {
        self.words.fill(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_told_as_ranges() {
        let mut changes = Changes::new(300);
        assert!(changes.ranges(0).next().is_none());
        [0, 1, 5, 63, 64, 65, 200, 299].into_iter().for_each(|element| changes.note(element));
        let ranges =
            |changes: &Changes, gap| changes.ranges(gap).map(|range| (range.start, range.end)).collect::<Vec<_>>();
        assert_eq!(ranges(&changes, 0), [(0, 2), (5, 6), (63, 66), (200, 201), (299, 300)]);
        assert_eq!(ranges(&changes, 3), [(0, 6), (63, 66), (200, 201), (299, 300)]);
        assert_eq!(ranges(&changes, 1000), [(0, 300)]);
        changes.clear();
        assert!(changes.ranges(9).next().is_none());
    }
}
