//! Fixed-size records on disk by number, with the pages in use in RAM: random access to more than fits in memory.
//!
//! A page of 4 KiB holds as many whole records as fit. Pages in RAM are replaced by second chance (CLOCK); one that was
//! changed is written when it is replaced. Records that were never put are zero.
//!
//! Memory: the pages that were allowed (at least [`FEWEST_PAGES`]), and about 40 bytes for each. I/O: a page read for
//! each access that finds its page neither in RAM nor new, a page written for each changed page that is replaced.

use std::marker::PhantomData;

use bytemuck::Pod;
use hashbrown::HashMap;

use crate::disk::{Block, StorageError};
use crate::random_file::Traffic;
use crate::scratch::{Scratch, TemporaryFile};

/// There are at least so many pages in RAM.
pub const FEWEST_PAGES: usize = 16;

#[derive(Debug, Clone, Copy)]
struct Frame {
    /// The page that is in it.
    page: u64,
    is_changed: bool,
    /// Used since the hand came by last.
    is_recent: bool,
}

/// Records by number.
#[derive(Debug)]
pub struct RecordFile<T> {
    file: TemporaryFile,
    /// Pages that are on disk, from the first on.
    written: u64,
    traffic: Traffic,
    pages: Vec<Block>,
    frames: Vec<Frame>,
    places: HashMap<u64, u32>,
    hand: usize,
    most: usize,
    /// The page of the last access, and its frame.
    last: (u64, usize),
    records: PhantomData<T>,
}

impl<T: Pod> RecordFile<T> {
    /// Records in a page.
    const IN_PAGE: u64 = {
        assert!(size_of::<T>() > 0 && size_of::<T>() <= Block::BYTES);
        (Block::BYTES / size_of::<T>()) as u64
    };

    /// Records of zeros, with at most `ram_bytes` of pages in RAM. `name` is for people who look at the scratch files.
    pub fn new(scratch: &Scratch, name: &str, ram_bytes: usize) -> Result<Self, StorageError> {
        Ok(RecordFile {
            file: scratch.create(name)?,
            written: 0,
            traffic: Traffic::default(),
            pages: Vec::new(),
            frames: Vec::new(),
            places: HashMap::new(),
            hand: 0,
            most: (ram_bytes / (Block::BYTES + 40)).max(FEWEST_PAGES),
            last: (u64::MAX, 0),
            records: PhantomData,
        })
    }

    /// Bytes that passed between RAM and the file.
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// The record of this number.
    #[inline]
    pub fn get(&mut self, number: u64) -> Result<T, StorageError> {
        let (frame, place) = self.find(number)?;
        Ok(bytemuck::pod_read_unaligned(&bytemuck::bytes_of(&self.pages[frame])[place..place + size_of::<T>()]))
    }

    /// Replaces the record of this number.
    #[inline]
    pub fn put(&mut self, number: u64, record: &T) -> Result<(), StorageError> {
        let (frame, place) = self.find(number)?;
        let bytes = &mut bytemuck::bytes_of_mut(&mut self.pages[frame])[place..place + size_of::<T>()];
        bytes.copy_from_slice(bytemuck::bytes_of(record));
        self.frames[frame].is_changed = true;
        Ok(())
    }

    /// The frame of a record, and where in it the record begins.
    #[inline]
    fn find(&mut self, number: u64) -> Result<(usize, usize), StorageError> {
        let (page, place) = (number / Self::IN_PAGE, (number % Self::IN_PAGE) as usize * size_of::<T>());
        if self.last.0 != page {
            self.last = (u64::MAX, 0);
            let frame = match self.places.get(&page) {
                Some(frame) => *frame as usize,
                None => self.bring_in(page)?,
            };
            self.frames[frame].is_recent = true;
            self.last = (page, frame);
        }
        Ok((self.last.1, place))
    }

    fn bring_in(&mut self, page: u64) -> Result<usize, StorageError> {
        let frame = if self.frames.len() < self.most {
            self.pages.push(Block::ZERO);
            self.frames.push(Frame { page, is_changed: false, is_recent: true });
            self.frames.len() - 1
        } else {
            self.make_room()?
        };
        if page < self.written {
            self.traffic.read += Block::BYTES as u64;
            if let Err(error) = self.file.read(page, &mut self.pages[frame..frame + 1]) {
                // The frame holds nothing: no page has this number.
                self.frames[frame] = Frame { page: u64::MAX, is_changed: false, is_recent: false };
                return Err(error);
            }
        } else {
            self.pages[frame] = Block::ZERO;
        }
        self.frames[frame] = Frame { page, is_changed: false, is_recent: true };
        self.places.insert(page, frame as u32);
        Ok(frame)
    }

    /// Frees the frame of the next page that was not used of late.
    fn make_room(&mut self) -> Result<usize, StorageError> {
        loop {
            let frame = self.hand;
            self.hand = (self.hand + 1) % self.frames.len();
            if std::mem::take(&mut self.frames[frame].is_recent) {
                continue;
            }
            let Frame { page, is_changed, .. } = self.frames[frame];
            if is_changed {
                self.write(page, frame)?;
            }
            self.frames[frame].is_changed = false;
            self.places.remove(&page);
            return Ok(frame);
        }
    }

    /// Writes a page, and zeros for the pages before it that nobody has put anything in.
    fn write(&mut self, page: u64, frame: usize) -> Result<(), StorageError> {
        while self.written < page {
            self.file.write(self.written, &[Block::ZERO])?;
            self.traffic.written += Block::BYTES as u64;
            self.written += 1;
        }
        self.file.write(page, &self.pages[frame..frame + 1])?;
        self.traffic.written += Block::BYTES as u64;
        self.written = self.written.max(page + 1);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Arc;

    use proptest::prelude::*;

    use super::*;
    use crate::{FaultyDisk, MemoryDisk};

    fn records(disk: impl crate::Disk + 'static, ram_bytes: usize) -> RecordFile<[u32; 25]> {
        let scratch = Scratch::open(Arc::new(disk), Path::new("scratch"), "").unwrap().0;
        RecordFile::new(&scratch, "records", ram_bytes).unwrap()
    }

    proptest! {
        #[test]
        fn it_holds_what_a_vector_would(
            puts in prop::collection::vec((0..5000_u64, any::<u32>()), 0..600),
            gets in prop::collection::vec(0..6000_u64, 0..200),
            ram_pages in 0..60_usize,
        ) {
            let mut found = records(MemoryDisk::new(), ram_pages * 4136);
            let mut expected = vec![[0; 25]; 6000];
            for (number, value) in puts {
                found.put(number, &[value; 25]).unwrap();
                expected[number as usize] = [value; 25];
                prop_assert_eq!(found.get(number / 2).unwrap(), expected[number as usize / 2]);
                prop_assert!(found.pages.len() <= ram_pages.max(FEWEST_PAGES));
            }
            for number in gets {
                prop_assert_eq!(found.get(number).unwrap(), expected[number as usize]);
            }
        }
    }

    #[test]
    fn what_fits_in_ram_moves_no_byte_and_what_does_not_moves_whole_pages() {
        let mut small = records(MemoryDisk::new(), 0);
        for number in 0..40 * FEWEST_PAGES as u64 {
            small.put(number, &[1; 25]).unwrap();
        }
        assert_eq!(small.traffic(), Traffic::default());
        small.put(40 * FEWEST_PAGES as u64, &[1; 25]).unwrap();
        assert_eq!(small.traffic(), Traffic { read: 0, written: 4096 });
    }

    #[test]
    fn a_full_disk_is_an_error_and_what_is_in_ram_stays_good() {
        let disk = FaultyDisk::new(Arc::new(MemoryDisk::new()));
        let mut records = records(disk.clone(), 0);
        disk.full_after(3 * 4096);
        let failed = (0..10_000).find(|number| records.put(*number, &[*number as u32 + 1; 25]).is_err()).unwrap();
        disk.heal();
        for number in 0..failed {
            assert_eq!(records.get(number).unwrap(), [number as u32 + 1; 25]);
        }
        disk.fail_reads_after(0);
        assert!((0..failed).any(|number| records.get(number).is_err()));
        disk.heal();
        for number in 0..failed {
            assert_eq!(records.get(number).unwrap(), [number as u32 + 1; 25]);
        }
    }
}
