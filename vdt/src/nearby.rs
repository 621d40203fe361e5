//! Records by number, for look-ups that stay near each other: of a spool on disk some stretches are kept in memory, each at the
//! place that its number says. What is in RAM is read where it is.
//!
//! Memory: the stretches that were looked at, as many as are kept at most. I/O: a stretch is read whenever it is not there.

use bytemuck::Pod;
use storage::{Spool, StorageError};

/// Bytes of a stretch, where these are shared out.
const STRETCH_BYTES: usize = 8 << 10;

/// A spool with some stretches of it in memory.
#[derive(Debug)]
pub(crate) struct Nearby<'a, T> {
    spool: &'a Spool<T>,
    is_in_ram: bool,
    /// Records in a stretch.
    length: u64,
    /// The number of each stretch that is there, and its records.
    stretches: Vec<(u64, Vec<T>)>,
}

impl<'a, T: Pod> Nearby<'a, T> {
    /// With this many stretches of `length` records.
    pub fn new(spool: &'a Spool<T>, length: u64, kept: usize) -> Self {
        let is_in_ram = spool.ram_bytes() > 0;
        Nearby { spool, is_in_ram, length, stretches: (0..kept).map(|_| (u64::MAX, Vec::new())).collect() }
    }

    /// With as many stretches of 8 KiB as there are bytes for, at least one.
    pub fn within(spool: &'a Spool<T>, ram_bytes: usize) -> Self {
        let length = (STRETCH_BYTES / size_of::<T>()).max(1);
        Nearby::new(spool, length as u64, (ram_bytes / (length * size_of::<T>())).max(1))
    }

    /// How many records there are in all.
    pub fn len(&self) -> u64 {
        self.spool.len()
    }

    /// The stretch of this number.
    #[inline]
    fn stretch(&mut self, number: u64) -> Result<&[T], StorageError> {
        let place = (number % self.stretches.len() as u64) as usize;
        if self.stretches[place].0 != number {
            self.load(number, place)?;
        }
        Ok(&self.stretches[place].1)
    }

    #[cold]
    fn load(&mut self, number: u64, place: usize) -> Result<(), StorageError> {
        let (there, stretch) = &mut self.stretches[place];
        let start = number * self.length;
        let count = (self.spool.len() - start).min(self.length) as usize;
        stretch.reserve_exact(count.saturating_sub(stretch.len()));
        stretch.resize(count, T::zeroed());
        *there = u64::MAX;
        self.spool.read_at(start, stretch)?;
        *there = number;
        Ok(())
    }

    /// The record of this number, which must exist.
    #[inline]
    pub fn get(&mut self, number: u64) -> Result<T, StorageError> {
        if self.is_in_ram {
            let mut record = [T::zeroed()];
            self.spool.read_at(number, &mut record)?;
            return Ok(record[0]);
        }
        let length = self.length;
        Ok(self.stretch(number / length)?[(number % length) as usize])
    }

    /// Appends the records `first..end`.
    pub fn append_to(&mut self, records: &mut Vec<T>, first: u64, end: u64) -> Result<(), StorageError> {
        if self.is_in_ram {
            let before = records.len();
            records.resize(before + end.saturating_sub(first) as usize, T::zeroed());
            return self.spool.read_at(first, &mut records[before..]);
        }
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
    use std::path::Path;
    use std::sync::Arc;

    use proptest::prelude::*;
    use storage::{MemoryDisk, Scratch, SpoolWriter};

    use super::*;

    /// A spool in RAM, or on a disk.
    fn spool<T: Pod>(records: impl IntoIterator<Item = T>, on_disk: bool) -> Spool<T> {
        let scratch = Scratch::open(Arc::new(MemoryDisk::new()), Path::new("scratch"), "").unwrap().0;
        let mut writer = SpoolWriter::new(&scratch, "records", 1 << 20);
        records.into_iter().for_each(|record| writer.push(record).unwrap());
        if on_disk { writer.finish_on_disk().unwrap() } else { writer.finish().unwrap() }
    }

    proptest! {
        #[test]
        fn it_finds_what_is_there(
            count in 1_u32..500, length in 1_u64..40, kept in 1_usize..5,
            looks in prop::collection::vec((any::<u32>(), any::<u32>()), 1..60), on_disk: bool,
        ) {
            let records: Vec<u32> = (0..count).map(|number| number.wrapping_mul(0x9e37_79b9)).collect();
            let spool = spool(records.iter().copied(), on_disk);
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

        #[test]
        fn every_record_is_found_wherever_it_is(
            count in 1_u32..5000,
            places in prop::collection::vec(any::<prop::sample::Index>(), 1..200),
            ram_bytes in 0_usize..60_000,
            on_disk: bool,
        ) {
            let spool = spool((0..count).map(|number| [number; 5]), on_disk);
            let mut reader = Nearby::within(&spool, ram_bytes);
            for place in places {
                let number = place.index(count as usize) as u32;
                prop_assert_eq!(reader.get(number.into()).unwrap(), [number; 5]);
            }
            let records: usize = reader.stretches.iter().map(|(_, stretch)| stretch.capacity()).sum();
            prop_assert!(records * size_of::<[u32; 5]>() <= ram_bytes.max(STRETCH_BYTES));
        }
    }
}
