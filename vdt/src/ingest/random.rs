//! Reading a finished sequence of records at any place.
//!
//! What is in RAM is read where it is. Of what is on disk, pieces of a few records are kept, each at the place that its number
//! says: where the reader stays near where it was, most records are there.
//!
//! Memory: the bytes given. I/O: a piece of 8 KiB for each access that does not find it.

use bytemuck::Pod;
use storage::{Spool, StorageError};

/// Bytes of a piece.
const PIECE_BYTES: usize = 8 << 10;
/// Stands for no piece.
const NONE: u64 = u64::MAX;

/// Reads records by number.
#[derive(Debug)]
pub(super) struct RandomReader<'a, T> {
    spool: &'a Spool<T>,
    is_in_ram: bool,
    /// Records of a piece.
    length: u64,
    /// Which piece is in each place, and the records of all places.
    pieces: Vec<u64>,
    records: Vec<T>,
}

impl<'a, T: Pod> RandomReader<'a, T> {
    /// With `ram_bytes` for what is on disk, at least one piece.
    pub fn new(spool: &'a Spool<T>, ram_bytes: usize) -> Self {
        let is_in_ram = spool.ram_bytes() > 0;
        let length = (PIECE_BYTES / size_of::<T>()).max(1);
        let pieces = if is_in_ram { 0 } else { (ram_bytes / (length * size_of::<T>())).max(1) };
        RandomReader {
            spool,
            is_in_ram,
            length: length as u64,
            pieces: vec![NONE; pieces],
            records: vec![T::zeroed(); pieces * length],
        }
    }

    /// The record of a number, which must exist.
    #[inline]
    pub fn get(&mut self, number: u64) -> Result<T, StorageError> {
        if self.is_in_ram {
            let mut record = [T::zeroed()];
            self.spool.read_at(number, &mut record)?;
            return Ok(record[0]);
        }
        let piece = number / self.length;
        let place = (piece % self.pieces.len() as u64) as usize;
        if self.pieces[place] != piece {
            self.load(piece, place)?;
        }
        Ok(self.records[place * self.length as usize + (number % self.length) as usize])
    }

    #[cold]
    fn load(&mut self, piece: u64, place: usize) -> Result<(), StorageError> {
        self.pieces[place] = NONE;
        let start = piece * self.length;
        let count = self.length.min(self.spool.len() - start) as usize;
        let first = place * self.length as usize;
        self.spool.read_at(start, &mut self.records[first..first + count])?;
        self.pieces[place] = piece;
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

    proptest! {
        #[test]
        fn every_record_is_found_wherever_it_is(
            count in 1_u32..5000,
            places in prop::collection::vec(any::<prop::sample::Index>(), 1..200),
            ram_bytes in 0_usize..60_000,
            on_disk: bool,
        ) {
            let scratch = Scratch::open(Arc::new(MemoryDisk::new()), Path::new("scratch"), "").unwrap().0;
            let mut writer = SpoolWriter::new(&scratch, "records", 1 << 20);
            (0..count).for_each(|number| writer.push([number; 5]).unwrap());
            let spool = if on_disk { writer.finish_on_disk().unwrap() } else { writer.finish().unwrap() };
            let mut reader = RandomReader::new(&spool, ram_bytes);
            for place in places {
                let number = place.index(count as usize) as u32;
                prop_assert_eq!(reader.get(number.into()).unwrap(), [number; 5]);
            }
            prop_assert!(size_of_val(&*reader.records) <= ram_bytes.max(PIECE_BYTES));
        }
    }
}
