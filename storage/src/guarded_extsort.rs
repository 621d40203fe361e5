//! External sorting by the crate extsort, behind guards against its traps (all three reproduced in the tests):
//!
//! 1. It writes a segment when more than `segment_size` records wait. Where none is left over at the end, it hands out
//!    *nothing at all*. So one record is held back from it, and put into its place on the way out if need be; and what is
//!    handed out is counted, so that a segment cut short is an error too.
//! 2. Its segments are called 0, 1, 2... in the folder that it is given, where two sorters overwrite each other, and where
//!    they stay. So each sorter has a folder of its own in the scratch, gone with it.
//! 3. It merges all segments at once, with an open file and a buffer of 8 KiB for each, and counts its memory in records.
//!    So the segment follows from the bytes given, and their number has a bound: [`ExtsortSorter::capacity`].
//!
//! Memory: the bytes given, first for one segment, then for the buffers of the merge. I/O: every record is written once and
//! read once, by extsort itself with the standard library, in the scratch folder on the machine's file system and through
//! its page cache; so it is not seen by a [`crate::Disk`], nor counted by [`Scratch::bytes_on_disk`]. Without a disk
//! everything stays in RAM. It sorts on one thread: extsort's other way is rayon, with all the cores of the machine.

use std::cmp::Ordering;
use std::fmt;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use extsort::{ExternalSorter, PushExternalSorter, Sortable, SortedIterator};

use crate::disk::StorageError;
use crate::scratch::{ForeignFolder, Scratch};
use crate::sorter::SortRecord;

/// The most segments, and so open files, of a merge: half of what a process may usually have.
const MOST_SEGMENTS: usize = 512;
/// What a segment takes in a merge, in bytes: the buffer of its reader...
const READER_BYTES: usize = 8 << 10;
/// ...and so many records in the heap.
const HEAP_RECORDS: usize = 20;

/// A record as extsort has it: as the bytes that it consists of.
#[derive(Debug, Clone, Copy)]
struct Item<T>(T);

impl<T: SortRecord> Sortable for Item<T> {
    fn encode<W: Write>(&self, writer: &mut W) -> io::Result<()> {
        writer.write_all(bytemuck::bytes_of(&self.0))
    }

    fn decode<R: Read>(reader: &mut R) -> io::Result<Self> {
        let mut record = T::zeroed();
        reader.read_exact(bytemuck::bytes_of_mut(&mut record))?;
        Ok(Item(record))
    }
}

/// The order of records as extsort has them.
type Compare<T> = fn(&Item<T>, &Item<T>) -> Ordering;

fn compare<T: SortRecord>(a: &Item<T>, b: &Item<T>) -> Ordering {
    a.0.prefix().cmp(&b.0.prefix()).then_with(|| a.0.cmp(&b.0))
}

/// Takes records in any order.
pub struct ExtsortSorter<T: SortRecord> {
    /// Before the folder, so that its files are closed when that goes.
    sorter: PushExternalSorter<Item<T>, Compare<T>>,
    folder: Option<ForeignFolder>,
    ram_bytes: usize,
    /// Records of a segment.
    segment: u64,
    capacity: u64,
    /// The record that came last.
    held: Option<T>,
    taken: u64,
}

impl<T: SortRecord> ExtsortSorter<T> {
    /// A sorter that takes at most `ram_bytes`, and never less than what two records and two segments take.
    ///
    /// # Errors
    ///
    /// Where its folder cannot be made.
    pub fn new(scratch: &Scratch, name: &str, ram_bytes: usize) -> Result<Self, StorageError> {
        let folder = if scratch.has_disk() { Some(scratch.foreign_folder(name)?) } else { None };
        let (mut segment, mut segments) = (usize::MAX, 1);
        let mut sorter = ExternalSorter::new();
        if let Some(folder) = &folder {
            // Its buffer doubles as it grows, so that a power of two is what it never grows beyond.
            segment = 1 << (ram_bytes / size_of::<T>()).max(2).ilog2();
            segments = (ram_bytes / (READER_BYTES + HEAP_RECORDS * size_of::<T>())).clamp(2, MOST_SEGMENTS);
            sorter = sorter.with_sort_dir(folder.path().to_path_buf());
        }
        Ok(ExtsortSorter {
            // It writes a segment when one record more than this waits.
            sorter: sorter.with_segment_size(segment - 1).pushed_by(compare::<T> as Compare<T>),
            folder,
            ram_bytes,
            segment: segment as u64,
            capacity: segment as u64 * segments as u64,
            held: None,
            taken: 0,
        })
    }

    /// The most records that it takes.
    pub fn capacity(&self) -> u64 {
        self.capacity
    }

    /// Takes a record.
    ///
    /// # Errors
    ///
    /// Those of the disk; [`StorageError::SortTooLarge`] beyond the [`ExtsortSorter::capacity`].
    #[inline]
    pub fn push(&mut self, record: T) -> Result<(), StorageError> {
        if self.taken == self.capacity {
            let (path, most, ram_bytes) = (self.path(), self.capacity, self.ram_bytes);
            return Err(StorageError::SortTooLarge { path, most, ram_bytes });
        }
        self.taken += 1;
        match self.held.replace(record) {
            Some(before) => self.give(before),
            None => Ok(()),
        }
    }

    /// Gives a record to extsort.
    fn give(&mut self, record: T) -> Result<(), StorageError> {
        self.sorter.push(Item(record)).map_err(|error| StorageError::io(&self.path(), "sort in", error))
    }

    fn path(&self) -> PathBuf {
        path_of(self.folder.as_ref())
    }

    /// Sorts what was taken.
    pub fn finish(mut self) -> Result<ExtsortSorted<T>, StorageError> {
        // As many as fill whole segments would all be lost.
        if !self.taken.is_multiple_of(self.segment)
            && let Some(last) = self.held.take()
        {
            self.give(last)?;
        }
        let path = self.path();
        let sorted = self.sorter.done().map_err(|error| StorageError::io(&path, "sort in", error))?;
        let mut sorted = ExtsortSorted {
            sorted,
            folder: self.folder,
            held: self.held,
            waiting: None,
            taken: self.taken,
            delivered: 0,
        };
        sorted.waiting = sorted.read()?;
        Ok(sorted)
    }
}

fn path_of(folder: Option<&ForeignFolder>) -> PathBuf {
    folder.map_or(Path::new("memory"), ForeignFolder::path).to_path_buf()
}

/// Hands the records out in order. Records that compare equal come in any order.
pub struct ExtsortSorted<T: SortRecord> {
    sorted: SortedIterator<Item<T>, Compare<T>>,
    folder: Option<ForeignFolder>,
    /// The record that extsort was not given, until it is handed out.
    held: Option<T>,
    /// The next one that extsort has.
    waiting: Option<T>,
    taken: u64,
    delivered: u64,
}

impl<T: SortRecord> ExtsortSorted<T> {
    /// How many records there are in all.
    pub fn len(&self) -> u64 {
        self.taken
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.taken == 0
    }

    /// The next record, `None` behind the last.
    ///
    /// # Errors
    ///
    /// Those of the disk; [`StorageError::SortIncomplete`] at the end, if records were lost.
    #[expect(clippy::should_implement_trait, reason = "it can fail")]
    pub fn next(&mut self) -> Result<Option<T>, StorageError> {
        let is_held_next = match (&self.held, &self.waiting) {
            (Some(held), Some(waiting)) => compare(&Item(*held), &Item(*waiting)).is_le(),
            (held, _) => held.is_some(),
        };
        let next = if is_held_next {
            self.held.take()
        } else {
            let read = self.read()?;
            std::mem::replace(&mut self.waiting, read)
        };
        self.delivered += u64::from(next.is_some());
        if self.delivered > self.taken || next.is_none() && self.delivered < self.taken {
            let (path, taken, delivered) = (path_of(self.folder.as_ref()), self.taken, self.delivered);
            return Err(StorageError::SortIncomplete { path, taken, delivered });
        }
        Ok(next)
    }

    /// The next record that extsort has.
    fn read(&mut self) -> Result<Option<T>, StorageError> {
        let item = self.sorted.next().transpose();
        let item = item.map_err(|error| StorageError::io(&path_of(self.folder.as_ref()), "sort in", error))?;
        Ok(item.map(|Item(record)| record))
    }
}

impl<T: SortRecord> fmt::Debug for ExtsortSorter<T> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("ExtsortSorter").field("folder", &self.folder).field("taken", &self.taken).finish()
    }
}

impl<T: SortRecord> fmt::Debug for ExtsortSorted<T> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("ExtsortSorted").field("folder", &self.folder).field("taken", &self.taken).finish()
    }
}
