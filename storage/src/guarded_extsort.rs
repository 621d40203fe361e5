//! External sorting by the crate `extsort`, with a guard before each of the three traps that version 0.5 was found to have.
//! The face is that of [`crate::Sorter`].
//!
//! *An exact multiple.* When as many records were put in as fill its buffer a whole number of times, extsort hands out none,
//! and says nothing. Here one record more goes in then: the last one again, which is left out when it comes out. And
//! whatever extsort does, what comes out is counted: too few or too many are [`StorageError::Miscounted`].
//!
//! *One folder for two.* extsort names its files 0, 1, 2 in the folder that it is given, writes over what is there, and
//! leaves them. Here each of its sorters has a folder of its own within the scratch, which is gone with it.
//!
//! *A merge of one level.* extsort opens all of its runs at once, reads each through 8 KiB, and counts its buffer in
//! records. Here its buffer is as many records as the bytes hold, and it is given no more of them than make
//! `MOST_RUNS` runs, or fewer where the bytes do not reach for more. What that many records come out as is one run of
//! ours; `MOST_MERGED` of these are merged to a longer one as soon as there are as many, by the merge of
//! [`crate::Sorter`], and so on, so that few files are open whatever the number of records.
//!
//! extsort does its own I/O: on the machine's file system, past [`crate::Disk`], and through the system's page cache, which
//! is no memory of the process. Where the scratch is on another disk, or on none, [`crate::Sorter`] does the work.
//!
//! Memory: the bytes given. I/O: each record is written once and read once; once more for each level of our merge, where
//! there is one.

use std::cmp::Ordering;
use std::io::{self, Read, Write};

use extsort::{ExternalSorter, PushExternalSorter, Sortable, SortedIterator};

use crate::disk::StorageError;
use crate::scratch::{ForeignFolder, Scratch};
use crate::sorter::{SortRecord, Sorted, Sorter};
use crate::spool::{Spool, SpoolWriter};

/// The most runs that one sorter of extsort makes. A process may have 256 files open at least, on the systems that there
/// are.
const MOST_RUNS: usize = 128;
/// The most runs of ours of about the same length.
const MOST_MERGED: usize = 32;
/// The fewest records in a run.
const FEWEST_RECORDS: usize = 64;
/// What a run takes while it is merged: the buffer of its reader, and 20 records in a heap with what belongs to each.
const fn run_bytes(record: usize) -> usize {
    (8 << 10) + 20 * (record + 16)
}

/// A record as extsort has it.
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

type Compare<T> = fn(&Item<T>, &Item<T>) -> Ordering;

fn compare<T: SortRecord>(a: &Item<T>, b: &Item<T>) -> Ordering {
    a.0.prefix().cmp(&b.0.prefix()).then_with(|| a.0.cmp(&b.0))
}

/// Takes records in any order.
pub struct GuardedSorter<T: SortRecord> {
    inner: Inner<T>,
}

enum Inner<T: SortRecord> {
    Extsort(Batches<T>),
    Ours(Sorter<T>),
}

/// Batches of records, of which each is sorted by extsort.
struct Batches<T: SortRecord> {
    scratch: Scratch,
    name: String,
    ram_bytes: usize,
    /// Records in a run.
    run: usize,
    /// Records in a batch.
    most: u64,
    /// The batch that is open.
    batch: Option<Batch<T>>,
    /// Those that are closed; merged once, twice and so on.
    sorted: Vec<Vec<Spool<T>>>,
}

/// One sorter of extsort.
struct Batch<T: SortRecord> {
    sorter: PushExternalSorter<Item<T>, Compare<T>>,
    folder: ForeignFolder,
    length: u64,
    last: T,
}

impl<T: SortRecord> GuardedSorter<T> {
    /// A sorter that takes at most `ram_bytes`.
    pub fn new(scratch: &Scratch, name: &str, ram_bytes: usize) -> Self {
        if !scratch.is_on_file_system() {
            return GuardedSorter { inner: Inner::Ours(Sorter::new(scratch, name, ram_bytes, 1)) };
        }
        // The buffer grows by doubling from 4 on: any other size would take as much as the next power of two.
        let records = (ram_bytes / size_of::<T>()).max(FEWEST_RECORDS);
        let run = (records + 1).next_power_of_two() / 2;
        let runs = (ram_bytes / 4 * 3 / run_bytes(size_of::<T>())).clamp(2, MOST_RUNS);
        let inner = Batches {
            scratch: scratch.clone(),
            name: name.to_owned(),
            ram_bytes,
            run,
            most: run as u64 * runs as u64,
            batch: None,
            sorted: Vec::new(),
        };
        GuardedSorter { inner: Inner::Extsort(inner) }
    }

    /// Takes a record.
    #[inline]
    pub fn push(&mut self, record: T) -> Result<(), StorageError> {
        match &mut self.inner {
            Inner::Extsort(batches) => batches.push(record),
            Inner::Ours(sorter) => sorter.push(record),
        }
    }

    /// Sorts what was taken.
    pub fn finish(self) -> Result<GuardedSorted<T>, StorageError> {
        let source = match self.inner {
            Inner::Extsort(batches) => batches.finish()?,
            Inner::Ours(sorter) => Source::Ours(sorter.finish()?),
        };
        Ok(GuardedSorted { source })
    }
}

impl<T: SortRecord> Batches<T> {
    fn push(&mut self, record: T) -> Result<(), StorageError> {
        if self.batch.as_ref().is_some_and(|batch| batch.length == self.most) {
            self.close_batch()?;
        }
        let batch = match &mut self.batch {
            Some(batch) => batch,
            none => none.insert(Batch::new(&self.scratch, &self.name, self.run, record)?),
        };
        batch.push(record)?;
        batch.length += 1;
        Ok(())
    }

    /// Makes a run of ours of the batch that is open, if one is.
    fn close_batch(&mut self) -> Result<(), StorageError> {
        let Some(batch) = self.batch.take() else { return Ok(()) };
        let mut sorted = batch.finish(self.run)?;
        let mut run = self.write_run(&mut || sorted.next())?;
        drop(sorted);
        for level in 0.. {
            if self.sorted.len() == level {
                self.sorted.push(Vec::new());
            }
            self.sorted[level].push(run);
            if self.sorted[level].len() < MOST_MERGED {
                break;
            }
            let runs = std::mem::take(&mut self.sorted[level]);
            let mut merge = Sorter::of_runs(&self.scratch, &self.name, self.ram_bytes / 4 * 3, runs).finish()?;
            run = self.write_run(&mut || merge.next())?;
        }
        Ok(())
    }

    /// Writes all that `next` hands out as a run of ours.
    fn write_run(&self, next: &mut dyn FnMut() -> Result<Option<T>, StorageError>) -> Result<Spool<T>, StorageError> {
        let mut writer = SpoolWriter::new(&self.scratch, &self.name, self.ram_bytes / 4);
        while let Some(record) = next()? {
            writer.push(record)?;
        }
        writer.finish_on_disk()
    }

    fn finish(mut self) -> Result<Source<T>, StorageError> {
        if self.sorted.is_empty()
            && let Some(batch) = self.batch.take()
        {
            return Ok(Source::Extsort(batch.finish(self.run)?));
        }
        self.close_batch()?;
        let runs = self.sorted.into_iter().flatten().collect();
        Ok(Source::Ours(Sorter::of_runs(&self.scratch, &self.name, self.ram_bytes, runs).finish()?))
    }
}

impl<T: SortRecord> Batch<T> {
    fn new(scratch: &Scratch, name: &str, run: usize, first: T) -> Result<Self, StorageError> {
        let folder = scratch.foreign_folder(name)?;
        // extsort writes a run as soon as it has one record more than it was told.
        let sorter = ExternalSorter::new().with_segment_size(run - 1).with_sort_dir(folder.path().to_path_buf());
        Ok(Batch { sorter: sorter.pushed_by(compare::<T>), folder, length: 0, last: first })
    }

    /// Puts a record in, without counting it.
    fn push(&mut self, record: T) -> Result<(), StorageError> {
        self.last = record;
        self.sorter.push(Item(record)).map_err(|error| StorageError::io(self.folder.path(), "sort in", error))
    }

    fn finish(mut self, run: usize) -> Result<SortedBatch<T>, StorageError> {
        let padding = self.length.is_multiple_of(run as u64).then_some(self.last);
        if let Some(record) = padding {
            self.push(record)?;
        }
        let Batch { sorter, folder, length, .. } = self;
        let taken = length + u64::from(padding.is_some());
        let records = sorter.done().map_err(|error| StorageError::io(folder.path(), "sort in", error))?;
        if records.disk_segment_count() > 0 {
            folder.grow(taken * size_of::<T>() as u64);
        }
        Ok(SortedBatch { records, length, taken, delivered: 0, padding, folder })
    }
}

/// A batch in order.
struct SortedBatch<T: SortRecord> {
    records: SortedIterator<Item<T>, Compare<T>>,
    length: u64,
    /// Records that extsort got.
    taken: u64,
    /// Records that it handed out.
    delivered: u64,
    /// The record that was put in once more, as long as it has not come out.
    padding: Option<T>,
    // The last to go.
    folder: ForeignFolder,
}

impl<T: SortRecord> SortedBatch<T> {
    fn next(&mut self) -> Result<Option<T>, StorageError> {
        loop {
            let Some(item) = self.records.next() else {
                let is_complete = self.delivered == self.taken && self.padding.is_none();
                return if is_complete { Ok(None) } else { Err(self.miscounted()) };
            };
            let Item(record) = item.map_err(|error| StorageError::io(self.folder.path(), "read a run in", error))?;
            self.delivered += 1;
            if self.delivered > self.taken {
                return Err(self.miscounted());
            }
            if self.padding.is_none_or(|padding| bytemuck::bytes_of(&padding) != bytemuck::bytes_of(&record)) {
                return Ok(Some(record));
            }
            self.padding = None;
        }
    }

    fn miscounted(&self) -> StorageError {
        let SortedBatch { taken, delivered, .. } = *self;
        StorageError::Miscounted { path: self.folder.path().to_path_buf(), taken, delivered }
    }
}

/// Hands the records out in order. Records that compare equal come in any order.
pub struct GuardedSorted<T: SortRecord> {
    source: Source<T>,
}

enum Source<T: SortRecord> {
    Extsort(SortedBatch<T>),
    Ours(Sorted<T>),
}

impl<T: SortRecord> GuardedSorted<T> {
    /// How many records there are in all.
    pub fn len(&self) -> u64 {
        match &self.source {
            Source::Extsort(batch) => batch.length,
            Source::Ours(sorted) => sorted.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The next record, `None` behind the last.
    #[expect(clippy::should_implement_trait, reason = "it can fail")]
    pub fn next(&mut self) -> Result<Option<T>, StorageError> {
        match &mut self.source {
            Source::Extsort(batch) => batch.next(),
            Source::Ours(sorted) => sorted.next(),
        }
    }
}
