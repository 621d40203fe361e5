//! The numbers that coordinates of displacements are again and again.
//!
//! Many meshes are made of regular parts: terrain over a grid, surfaces extracted from voxels, anything that was rounded before. Their
//! displacements have the same few coordinates very often, which half-octave classes do not show. The writer looks for
//! such numbers beforehand; the file has a list of them ([`Frequent`]), and each coordinate is first said to be which of
//! them, or none. Where there are none nothing is said.

use storage::{Spool, StorageError};

/// How many numbers a file can have.
pub(crate) const MOST: usize = 63;
/// Symbols: none, or a number.
pub(super) const SYMBOLS: usize = MOST + 1;
/// Contexts by what is expected.
pub(super) const OCTAVES: usize = 24;

/// Neighbours that are looked at, and how many of them follow each other.
const SAMPLES: u64 = 1 << 18;
const STRETCH: u64 = 1 << 10;
/// A number is frequent if one of so many is it, and it comes so often at least: each costs bytes in the file.
const ONE_OF: u64 = 200;
const FEWEST: u64 = 64;

/// The frequent numbers of a file, ascending; whether they are negative is said apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Frequent {
    numbers: [u32; MOST],
    count: usize,
}

impl Frequent {
    /// There are none.
    pub const NONE: Frequent = Frequent { numbers: [0; MOST], count: 0 };

    /// Of numbers that ascend and are no more than there can be; none where they do not, or are.
    pub fn new(numbers: &[u32]) -> Option<Self> {
        let mut frequent = Frequent { count: numbers.len(), ..Frequent::NONE };
        frequent.numbers.get_mut(..numbers.len())?.copy_from_slice(numbers);
        numbers.is_sorted_by(|a, b| a < b).then_some(frequent)
    }

    /// The numbers.
    pub fn numbers(&self) -> &[u32] {
        &self.numbers[..self.count]
    }

    /// Whether there are none.
    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The symbol of a number: 0 where it is not frequent.
    pub(super) fn symbol(&self, magnitude: u64) -> usize {
        u32::try_from(magnitude)
            .ok()
            .and_then(|number| self.numbers().binary_search(&number).ok())
            .map_or(0, |at| at + 1)
    }

    /// The number of a symbol that is not 0; none where there is none.
    #[inline(always)]
    pub(super) fn number(&self, symbol: usize) -> Option<u32> {
        self.numbers().get(symbol - 1).copied()
    }

    /// Looks for them: between leaves that follow each other, since half of them are children of one node. `numbers_of` has
    /// the whole numbers that positions are, where they are some.
    pub fn find(
        positions: &Spool<[f32; 3]>,
        numbers_of: impl Fn([f32; 3]) -> [Option<i32>; 3],
    ) -> Result<Self, StorageError> {
        let mut numbers = Vec::new();
        for_each_stretch(positions, SAMPLES, |stretch| {
            for pair in stretch.windows(2) {
                let [a, b] = [pair[0], pair[1]].map(&numbers_of);
                let along = |axis: usize| Some(b[axis]?.wrapping_sub(a[axis]?).unsigned_abs());
                numbers.extend((0..3).filter_map(along));
            }
        })?;
        numbers.sort_unstable();
        let all = numbers.len() as u64;
        let mut frequent: Vec<(u64, u32)> = numbers
            .chunk_by(|a, b| a == b)
            .map(|same| (same.len() as u64, same[0]))
            .filter(|(count, _)| *count * ONE_OF >= all && *count >= FEWEST)
            .collect();
        frequent.sort_unstable_by_key(|(count, number)| (u64::MAX - count, *number));
        let mut numbers: Vec<u32> = frequent.into_iter().take(MOST).map(|(_, number)| number).collect();
        numbers.sort_unstable();
        Ok(Frequent::new(&numbers).unwrap_or(Frequent::NONE))
    }
}

/// Reads some of the positions, `most` at most: stretches evenly over all, whatever their number.
pub(super) fn for_each_stretch(
    positions: &Spool<[f32; 3]>,
    most: u64,
    mut visit: impl FnMut(&[[f32; 3]]),
) -> Result<(), StorageError> {
    let stretches = (most / STRETCH).min(positions.len().div_ceil(STRETCH)).max(1);
    let mut stretch = vec![[0.0; 3]; STRETCH as usize];
    for index in 0..stretches {
        let start =
            (positions.len().saturating_sub(STRETCH) as u128 * u128::from(index) / u128::from(stretches)) as u64;
        let count = (positions.len() - start).min(STRETCH) as usize;
        positions.read_at(start, &mut stretch[..count])?;
        visit(&stretch[..count]);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_shows() {
        let positions = (0..5000_u32)
            .map(|index| [(index % 70) as f32 * 30.0, (index / 70) as f32 * 30.0, (index * index % 977) as f32]);
        let whole = |position: [f32; 3]| position.map(|value| Some(value as i32));
        let frequent = Frequent::find(&Spool::from_vec(positions.collect()), whole).unwrap();
        assert!(frequent.numbers().contains(&30) && frequent.numbers().contains(&0), "{frequent:?}");
        assert_eq!(frequent.number(frequent.symbol(30)), Some(30));
        assert_eq!((frequent.symbol(31), frequent.symbol(1 << 40)), (0, 0));
        let noise = (0..5000_u32).map(|index| [(index.wrapping_mul(index).wrapping_mul(0x9e37_79b1) >> 10) as f32; 3]);
        assert!(Frequent::find(&Spool::from_vec(noise.collect()), whole).unwrap().is_empty());
    }

    #[test]
    fn only_ascending_numbers_are_a_list() {
        assert!(Frequent::new(&[1, 1]).is_none() && Frequent::new(&[2, 1]).is_none());
        assert!(Frequent::new(&[0; MOST + 1]).is_none());
        assert_eq!(Frequent::new(&[1, 7]).unwrap().numbers(), [1, 7]);
    }
}
