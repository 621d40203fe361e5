//! External sorting of fixed-size records within a given number of bytes of RAM.
//!
//! Records are sorted in RAM, a buffer full at a time, and the sorted runs are merged through a heap. Where there are more
//! runs than the RAM has room for their buffers, groups of them are merged to longer ones first. What fits in the buffer
//! touches no disk. With two threads the one sorts and writes a buffer while the other is filled, each half as large.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::thread::JoinHandle;

use bytemuck::Pod;

use crate::disk::{Block, StorageError};
use crate::scratch::Scratch;
use crate::spool::{Spool, SpoolWriter};

/// Buffer for each run in a merge, in bytes, where the RAM allows it.
const RUN_BUFFER: usize = 128 << 10;
/// Buffer for writing a run.
const WRITE_BUFFER: usize = 256 << 10;

/// A record that can be sorted. [`Ord`] is the order; `prefix` orders coarsely the same way, and fast.
pub trait SortRecord: Pod + Ord + Send + Sync {
    /// Monotone in the order: `a < b` implies `a.prefix() <= b.prefix()`.
    fn prefix(&self) -> u64;
}

fn sort<T: SortRecord>(records: &mut [T]) {
    records.sort_unstable_by(|a, b| a.prefix().cmp(&b.prefix()).then_with(|| a.cmp(b)));
}

/// A run that was written, and the buffer that it was in.
type Written<T> = Result<(Spool<T>, Vec<T>), StorageError>;

/// Takes records in any order.
#[derive(Debug)]
pub struct Sorter<T: SortRecord> {
    scratch: Scratch,
    name: String,
    ram_bytes: usize,
    /// Records in a full buffer.
    most: usize,
    records: Vec<T>,
    runs: Vec<Spool<T>>,
    length: u64,
    /// The thread that sorts and writes a run; it hands the emptied buffer back.
    helper: Option<JoinHandle<Written<T>>>,
    has_helper: bool,
}

impl<T: SortRecord> Sorter<T> {
    /// A sorter that takes at most `ram_bytes`, and may use so many threads.
    pub fn new(scratch: &Scratch, name: &str, ram_bytes: usize, threads: usize) -> Self {
        let has_helper = threads > 1 && scratch.has_disk();
        let buffers = 1 + usize::from(has_helper);
        let most = if scratch.has_disk() { (ram_bytes / buffers / size_of::<T>()).max(64) } else { usize::MAX };
        Sorter {
            scratch: scratch.clone(),
            name: name.to_owned(),
            ram_bytes,
            most,
            records: Vec::new(),
            runs: Vec::new(),
            length: 0,
            helper: None,
            has_helper,
        }
    }

    /// A sorter of what others have sorted: runs, which must be in order.
    pub(crate) fn of_runs(scratch: &Scratch, name: &str, ram_bytes: usize, runs: Vec<Spool<T>>) -> Self {
        let mut sorter = Sorter::new(scratch, name, ram_bytes, 1);
        sorter.length = runs.iter().map(Spool::len).sum();
        sorter.runs = runs;
        sorter
    }

    /// Takes a record.
    #[inline]
    pub fn push(&mut self, record: T) -> Result<(), StorageError> {
        if self.records.len() == self.records.capacity() {
            self.make_room()?;
        }
        self.records.push(record);
        self.length += 1;
        Ok(())
    }

    #[cold]
    fn make_room(&mut self) -> Result<(), StorageError> {
        let count = self.records.len();
        if count < self.most {
            // Doubling, but never past what was given.
            self.records.reserve_exact(count.max(64).min(self.most - count));
            return Ok(());
        }
        self.write_run()
    }

    /// Writes what is in the buffer as a run.
    fn write_run(&mut self) -> Result<(), StorageError> {
        let mut records = std::mem::take(&mut self.records);
        let writer = SpoolWriter::new(&self.scratch, &self.name, WRITE_BUFFER.min(self.ram_bytes / 4));
        if !self.has_helper {
            self.runs.push(write(&mut records, writer)?);
            records.clear();
            self.records = records;
            return Ok(());
        }
        let emptied = self.wait()?;
        self.helper = Some(std::thread::spawn(move || {
            let run = write(&mut records, writer)?;
            records.clear();
            Ok((run, records))
        }));
        self.records = emptied;
        Ok(())
    }

    /// Waits for the helper, if it is at work.
    fn wait(&mut self) -> Result<Vec<T>, StorageError> {
        let Some(helper) = self.helper.take() else { return Ok(Vec::new()) };
        let (run, emptied) = helper.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        self.runs.push(run);
        Ok(emptied)
    }

    /// Sorts what was taken.
    pub fn finish(mut self) -> Result<Sorted<T>, StorageError> {
        drop(self.wait()?);
        if self.runs.is_empty() {
            sort(&mut self.records);
            return Ok(Sorted { length: self.length, source: Source::Ram(std::mem::take(&mut self.records), 0) });
        }
        if !self.records.is_empty() {
            self.has_helper = false;
            self.write_run()?;
        }
        self.records = Vec::new();
        let mut runs = std::mem::take(&mut self.runs);
        let fan_in = (self.ram_bytes / RUN_BUFFER).max(2);
        while runs.len() > fan_in {
            let rest = runs.split_off(fan_in.min(runs.len()));
            let mut merge = Merge::new(runs, self.ram_bytes / 4 * 3)?;
            let mut writer = SpoolWriter::new(&self.scratch, &self.name, self.ram_bytes / 4);
            while let Some(record) = merge.next()? {
                writer.push(record)?;
            }
            runs = rest;
            runs.push(writer.finish_on_disk()?);
        }
        Ok(Sorted { length: self.length, source: Source::Merge(Merge::new(runs, self.ram_bytes)?) })
    }
}

impl<T: SortRecord> Drop for Sorter<T> {
    fn drop(&mut self) {
        // Its run goes with it, and not some time after the scratch.
        if let Some(helper) = self.helper.take() {
            let _ = helper.join();
        }
    }
}

fn write<T: SortRecord>(records: &mut [T], mut writer: SpoolWriter<T>) -> Result<Spool<T>, StorageError> {
    sort(records);
    writer.extend(records)?;
    writer.finish_on_disk()
}

/// Hands the records out in order. Records that compare equal come in any order.
#[derive(Debug)]
pub struct Sorted<T: SortRecord> {
    length: u64,
    source: Source<T>,
}

#[derive(Debug)]
enum Source<T: SortRecord> {
    Ram(Vec<T>, usize),
    Merge(Merge<T>),
}

impl<T: SortRecord> Sorted<T> {
    /// How many records there are in all.
    pub fn len(&self) -> u64 {
        self.length
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// The next record, `None` behind the last.
    #[inline]
    #[expect(clippy::should_implement_trait, reason = "it can fail")]
    pub fn next(&mut self) -> Result<Option<T>, StorageError> {
        match &mut self.source {
            Source::Ram(records, next) => {
                *next += 1;
                Ok(records.get(*next - 1).copied())
            }
            Source::Merge(merge) => merge.next(),
        }
    }
}

/// Several runs as one.
#[derive(Debug)]
struct Merge<T: SortRecord> {
    runs: Vec<Run<T>>,
    heap: BinaryHeap<Reverse<Head<T>>>,
}

/// A run with the part of it that is in RAM.
#[derive(Debug)]
struct Run<T> {
    spool: Spool<T>,
    next: u64,
    buffer: Vec<T>,
    used: usize,
    most: usize,
}

/// The first record of a run that is not handed out.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Head<T> {
    prefix: u64,
    record: T,
    run: usize,
}

impl<T: SortRecord> Run<T> {
    #[inline]
    fn next(&mut self) -> Result<Option<T>, StorageError> {
        if self.used == self.buffer.len() {
            let count = ((self.spool.len() - self.next) as usize).min(self.most);
            if count == 0 {
                return Ok(None);
            }
            self.buffer.resize(count, T::zeroed());
            self.spool.read_at(self.next, &mut self.buffer)?;
            self.next += count as u64;
            self.used = 0;
        }
        self.used += 1;
        Ok(Some(self.buffer[self.used - 1]))
    }
}

impl<T: SortRecord> Merge<T> {
    fn new(spools: Vec<Spool<T>>, ram_bytes: usize) -> Result<Self, StorageError> {
        let bytes = (ram_bytes / spools.len()).clamp(2 * Block::BYTES, 1 << 20);
        let most = (bytes / size_of::<T>()).max(1);
        let mut merge = Merge { runs: Vec::with_capacity(spools.len()), heap: BinaryHeap::with_capacity(spools.len()) };
        for (number, spool) in spools.into_iter().enumerate() {
            let mut run = Run { spool, next: 0, buffer: Vec::new(), used: 0, most };
            if let Some(record) = run.next()? {
                merge.heap.push(Reverse(Head { prefix: record.prefix(), record, run: number }));
            }
            merge.runs.push(run);
        }
        Ok(merge)
    }

    #[inline]
    fn next(&mut self) -> Result<Option<T>, StorageError> {
        let Some(mut top) = self.heap.peek_mut() else { return Ok(None) };
        let Reverse(Head { record, run, .. }) = &mut *top;
        let found = *record;
        match self.runs[*run].next()? {
            Some(next) => *top = Reverse(Head { prefix: next.prefix(), record: next, run: *run }),
            None => {
                std::collections::binary_heap::PeekMut::pop(top);
            }
        }
        Ok(Some(found))
    }
}
