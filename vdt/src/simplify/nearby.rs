//! Records by number, for look-ups that stay near each other: a few stretches of a spool are kept in memory.
//!
//! Memory: `kept` stretches. I/O: a stretch is read whenever it is not there.

use bytemuck::Pod;
use storage::{Spool, StorageError};

/// A spool with some stretches of it in memory.
#[derive(Debug)]
pub(super) struct Nearby<'a, T> {
    spool: &'a Spool<T>,
    /// Records in a stretch.
    length: u64,
    /// The number of each stretch that is there, and its records.
    stretches: Vec<(u64, Vec<T>)>,
}

impl<'a, T: Pod> Nearby<'a, T> {
    /// With this many stretches of `length` records.
    pub fn new(spool: &'a Spool<T>, length: u64, kept: usize) -> Self {
        Nearby { spool, length, stretches: (0..kept).map(|_| (u64::MAX, Vec::new())).collect() }
    }

    /// How many records there are in all.
    pub fn len(&self) -> u64 {
        self.spool.len()
    }

    /// The stretch of this number.
    fn stretch(&mut self, number: u64) -> Result<&[T], StorageError> {
        let place = (number % self.stretches.len() as u64) as usize;
        let (there, stretch) = &mut self.stretches[place];
        if *there != number {
            let start = number * self.length;
            stretch.resize((self.spool.len() - start).min(self.length) as usize, T::zeroed());
            *there = u64::MAX;
            self.spool.read_at(start, stretch)?;
            *there = number;
        }
        Ok(stretch)
    }

    /// The record of this number.
    pub fn get(&mut self, number: u64) -> Result<T, StorageError> {
        let length = self.length;
        Ok(self.stretch(number / length)?[(number % length) as usize])
    }

    /// Appends the records `first..end`.
    pub fn append_to(&mut self, records: &mut Vec<T>, first: u64, end: u64) -> Result<(), StorageError> {
        let length = self.length;
        let mut next = first;
        while next < end {
            let number = next / length;
            let until = end.min((number + 1) * length);
            let start = number * length;
            let stretch = self.stretch(number)?;
            records.extend_from_slice(&stretch[(next - start) as usize..(until - start) as usize]);
            next = until;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn it_finds_what_is_there(
            count in 1_u32..500, length in 1_u64..40, kept in 1_usize..5,
            looks in prop::collection::vec((any::<u32>(), any::<u32>()), 1..60),
        ) {
            let records: Vec<u32> = (0..count).map(|number| number.wrapping_mul(0x9e37_79b9)).collect();
            let spool = Spool::from_vec(records.clone());
            let mut nearby = Nearby::new(&spool, length, kept);
            prop_assert_eq!(nearby.len(), u64::from(count));
            for (a, b) in looks {
                let (first, end) = ((a % count).min(b % count), (a % count).max(b % count));
                prop_assert_eq!(nearby.get(first.into()).unwrap(), records[first as usize]);
                let mut found = vec![7];
                nearby.append_to(&mut found, first.into(), end.into()).unwrap();
                prop_assert_eq!(found[0], 7);
                prop_assert_eq!(&found[1..], &records[first as usize..end as usize]);
            }
        }
    }
}
