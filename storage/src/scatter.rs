//! Puts records into the order of their keys, where the keys are numbers below a known count, each used at most once.
//!
//! One write and one read of everything that does not fit in RAM, without a comparison: records go to buckets by ranges
//! of keys, each of which fits in RAM, where every record has its place.

use bytemuck::Pod;
use serde::{Deserialize, Serialize};

use crate::disk::{Block, StorageError};
use crate::scratch::Scratch;
use crate::spool::{KeptSpool, Spool, SpoolWriter};

/// The most buckets: more would only have tiny buffers. Where that many do not bring a bucket down to half of the RAM, it
/// takes what it takes.
const MOST_BUCKETS: u64 = 512;
/// Buffer for reading a bucket.
const READ_BUFFER: usize = 256 << 10;

/// Takes records with their keys.
#[derive(Debug)]
pub struct Scatter<T> {
    count: u64,
    /// Keys in a bucket: 2^shift.
    shift: u32,
    target: Target<T>,
}

#[derive(Debug)]
enum Target<T> {
    Ram(Vec<T>),
    Buckets(Vec<Bucket<T>>),
}

#[derive(Debug)]
struct Bucket<T> {
    keys: SpoolWriter<u32>,
    records: SpoolWriter<T>,
}

impl<T: Pod + Send + Sync> Scatter<T> {
    /// For keys below `count`, within `ram_bytes`.
    pub fn new(scratch: &Scratch, name: &str, count: u64, ram_bytes: usize) -> Self {
        let size = size_of::<T>() as u64;
        if !scratch.has_disk() || count * size <= ram_bytes as u64 {
            return Scatter { count, shift: 0, target: Target::Ram(vec![T::zeroed(); count as usize]) };
        }
        // A bucket takes at most half of the RAM while it is read.
        let keys = (ram_bytes as u64 / 2 / size).max(count.div_ceil(MOST_BUCKETS) * 2);
        let shift = keys.ilog2();
        let buckets = count.div_ceil(1 << shift);
        let bytes = (ram_bytes as u64 / buckets).max(4 * Block::BYTES as u64);
        let share = |part: u64| (bytes * part / (size + 4)) as usize;
        let bucket = || Bucket {
            keys: SpoolWriter::new(scratch, name, share(4)),
            records: SpoolWriter::new(scratch, name, share(size)),
        };
        Scatter { count, shift, target: Target::Buckets((0..buckets).map(|_| bucket()).collect()) }
    }

    /// Takes the record of a key. The key must be below the count.
    #[inline]
    pub fn put(&mut self, key: u32, record: T) -> Result<(), StorageError> {
        match &mut self.target {
            Target::Ram(records) => records[key as usize] = record,
            Target::Buckets(buckets) => {
                let bucket = &mut buckets[(key >> self.shift) as usize];
                bucket.keys.push(key)?;
                bucket.records.push(record)?;
            }
        }
        Ok(())
    }

    /// All are there; where none was put, there is one of zeros.
    pub fn finish(self) -> Result<Scattered<T>, StorageError> {
        let Scatter { count, shift, target } = self;
        let (records, buckets) = match target {
            Target::Ram(records) => (records, Vec::new()),
            Target::Buckets(buckets) => {
                let finish = |bucket: Bucket<T>| Ok((bucket.keys.finish_on_disk()?, bucket.records.finish_on_disk()?));
                (Vec::new(), buckets.into_iter().map(finish).collect::<Result<_, StorageError>>()?)
            }
        };
        Ok(Scattered { count, shift, records, next: 0, first: 0, buckets: buckets.into_iter() })
    }
}

/// How to open a [`Scattered`] again that was kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptScattered {
    count: u64,
    shift: u32,
    /// Keys and records of each bucket.
    buckets: Vec<(KeptSpool, KeptSpool)>,
}

impl KeptScattered {
    /// Its files in the scratch.
    pub fn files(&self) -> impl Iterator<Item = String> + '_ {
        self.buckets.iter().flat_map(|(keys, records)| [&keys.file, &records.file]).flatten().cloned()
    }
}

/// Hands out the records of all keys, by ascending key.
#[derive(Debug)]
pub struct Scattered<T> {
    count: u64,
    shift: u32,
    /// Those in RAM.
    records: Vec<T>,
    /// The next of them.
    next: usize,
    /// Key of the first one behind those in RAM.
    first: u64,
    buckets: std::vec::IntoIter<(Spool<u32>, Spool<T>)>,
}

impl<T: Pod + Send + Sync> Scattered<T> {
    /// Keeps it for a checkpoint, on disk where it was not, as long as none was handed out: its files stay when it goes.
    /// Says how to open it again.
    pub fn keep(&mut self, scratch: &Scratch, name: &str) -> Result<KeptScattered, StorageError> {
        if self.first == 0 && !self.records.is_empty() {
            // What is in RAM is one bucket.
            let keys = Spool::from_vec((0..self.records.len() as u32).collect());
            let records = Spool::from_vec(std::mem::take(&mut self.records));
            self.shift = u32::BITS;
            self.buckets = vec![(keys, records)].into_iter();
        }
        let keep = |(keys, records): &mut (Spool<u32>, Spool<T>)| {
            Ok((keys.keep(scratch, name)?, records.keep(scratch, name)?))
        };
        let buckets = self.buckets.as_mut_slice().iter_mut().map(keep).collect::<Result<_, StorageError>>()?;
        Ok(KeptScattered { count: self.count, shift: self.shift, buckets })
    }

    /// Opens one that was kept.
    pub fn reopen(scratch: &Scratch, kept: &KeptScattered) -> Result<Self, StorageError> {
        let reopen = |(keys, records): &(KeptSpool, KeptSpool)| {
            Ok((Spool::reopen(scratch, keys)?, Spool::reopen(scratch, records)?))
        };
        let buckets: Vec<_> = kept.buckets.iter().map(reopen).collect::<Result<_, StorageError>>()?;
        let KeptScattered { count, shift, .. } = *kept;
        Ok(Scattered { count, shift, records: Vec::new(), next: 0, first: 0, buckets: buckets.into_iter() })
    }

    /// The record of the next key, `None` behind the last.
    #[inline]
    #[expect(clippy::should_implement_trait, reason = "it can fail")]
    pub fn next(&mut self) -> Result<Option<T>, StorageError> {
        if self.next == self.records.len() && !self.fill()? {
            return Ok(None);
        }
        self.next += 1;
        Ok(Some(self.records[self.next - 1]))
    }

    #[cold]
    fn fill(&mut self) -> Result<bool, StorageError> {
        let Some((keys, records)) = self.buckets.next() else { return Ok(false) };
        let end = (self.first + (1 << self.shift)).min(self.count);
        self.records.clear();
        self.records.resize((end - self.first) as usize, T::zeroed());
        let (mut keys, mut records) = (keys.reader(READ_BUFFER), records.reader(READ_BUFFER));
        while let (Some(key), Some(record)) = (keys.next()?, records.next()?) {
            self.records[(u64::from(key) - self.first) as usize] = record;
        }
        self.first = end;
        self.next = 0;
        Ok(true)
    }
}
