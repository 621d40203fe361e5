//! Puts records into the order of their keys, where the keys are numbers below a known count, each used at most once.
//!
//! One write and one read of everything that does not fit in RAM, without a comparison: records go to buckets by ranges
//! of keys, each of which fits in half of the RAM, where every record has its place.
//!
//! All buckets share one file, of chunks: a chunk holds records of one bucket, each behind its key, and the number of the
//! bucket's chunk before. So few files are open, and what there is to know of a bucket is its last chunk.
//!
//! Memory: the bytes given, first for a chunk of each bucket, then for the records of one bucket and a chunk. It takes more
//! where the bytes of all records are more than a sixteen-thousandth of the square of the bytes given (16 MiB do for
//! 16 GiB): there are never more than 512 buckets, and a chunk is never less than a block. I/O: 4 bytes for the key besides
//! each record, each way.

use bytemuck::Pod;
use serde::{Deserialize, Serialize};

use crate::disk::{Block, StorageError};
use crate::scratch::{Scratch, TemporaryFile};
use crate::spool::{Cursor, KeptSpool, Spool};

/// The most buckets.
const MOST_BUCKETS: u64 = 512;
/// The most blocks of a chunk.
const MOST_CHUNK_BLOCKS: usize = 64;
/// Bytes in front of a chunk: the number of the block where the chunk before begins, and how many records there are.
const HEADER: usize = 16;
/// Stands for no chunk.
const NONE: u64 = u64::MAX;
/// Buffer for reading records that are in order already, in bytes.
const READ_BUFFER: usize = 256 << 10;

/// Takes records with their keys.
#[derive(Debug)]
pub struct Scatter<T> {
    name: String,
    count: u64,
    target: Target<T>,
}

#[derive(Debug)]
enum Target<T> {
    Ram(Vec<T>),
    Disk(Box<OnDisk>),
}

/// The buckets, and what is on its way to the file.
#[derive(Debug)]
struct OnDisk {
    scratch: Scratch,
    file: Option<TemporaryFile>,
    /// Blocks in the file.
    written: u64,
    layout: Layout,
    /// A chunk for each bucket.
    blocks: Vec<Block>,
    /// Bytes of it that are in use.
    used: Vec<u32>,
    buckets: Vec<Bucket>,
}

/// What lies where.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct Layout {
    /// Keys in a bucket: 2^shift.
    shift: u32,
    /// Blocks of a chunk that is full.
    chunk_blocks: usize,
}

/// The chunks of a bucket that are in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct Bucket {
    /// Where the last one begins, in blocks.
    last: u64,
    /// How many records there are in all.
    records: u64,
}

impl<T: Pod + Send + Sync> Scatter<T> {
    /// For keys below `count`, within `ram_bytes`. `name` is for messages and file names.
    pub fn new(scratch: &Scratch, name: &str, count: u64, ram_bytes: usize) -> Self {
        let (size, ram) = (size_of::<T>() as u64, ram_bytes as u64);
        let name = name.to_owned();
        if !scratch.has_disk() || count * size <= ram {
            return Scatter { name, count, target: Target::Ram(vec![T::zeroed(); count as usize]) };
        }
        // A bucket takes at most half of the RAM while it is read.
        let keys = (ram / 2 / size).max(count.div_ceil(MOST_BUCKETS) * 2);
        let shift = keys.ilog2();
        let buckets = count.div_ceil(1 << shift) as usize;
        let fewest_blocks = (HEADER + 4 + size_of::<T>()).div_ceil(Block::BYTES);
        let chunk_blocks =
            (ram_bytes / buckets / Block::BYTES).clamp(fewest_blocks, MOST_CHUNK_BLOCKS.max(fewest_blocks));
        let on_disk = OnDisk {
            scratch: scratch.clone(),
            file: None,
            written: 0,
            layout: Layout { shift, chunk_blocks },
            blocks: vec![Block::ZERO; buckets * chunk_blocks],
            used: vec![HEADER as u32; buckets],
            buckets: vec![Bucket { last: NONE, records: 0 }; buckets],
        };
        Scatter { name, count, target: Target::Disk(Box::new(on_disk)) }
    }

    /// Takes the record of a key.
    ///
    /// # Errors
    ///
    /// Those of the disk; [`StorageError::NoSuchPlace`] where the key is not below the count.
    #[inline]
    pub fn put(&mut self, key: u32, record: T) -> Result<(), StorageError> {
        if u64::from(key) >= self.count {
            return Err(self.no_such_place(key));
        }
        match &mut self.target {
            Target::Ram(records) => {
                records[key as usize] = record;
                Ok(())
            }
            Target::Disk(on_disk) => on_disk.put(key, record, &self.name),
        }
    }

    #[cold]
    fn no_such_place(&self, key: u32) -> StorageError {
        StorageError::NoSuchPlace { name: self.name.clone(), count: self.count, index: key.into() }
    }

    /// All are there; where none was put, there is one of zeros.
    pub fn finish(self) -> Result<Scattered<T>, StorageError> {
        let source = match self.target {
            Target::Ram(records) => Source::in_order(Spool::from_vec(records)),
            Target::Disk(on_disk) => {
                let (layout, file, buckets) = on_disk.finish::<T>(&self.name)?;
                Source::Buckets(Buckets { file, layout, buckets, next: 0, records: Vec::new(), used: 0 })
            }
        };
        Ok(Scattered { count: self.count, source })
    }
}

impl OnDisk {
    #[inline]
    fn put<T: Pod>(&mut self, key: u32, record: T, name: &str) -> Result<(), StorageError> {
        let bucket = (key >> self.layout.shift) as usize;
        let entry = 4 + size_of::<T>();
        if self.used[bucket] as usize + entry > self.layout.chunk_blocks * Block::BYTES {
            self.write::<T>(bucket, name)?;
        }
        let start = bucket * self.layout.chunk_blocks * Block::BYTES + self.used[bucket] as usize;
        let place = &mut bytemuck::cast_slice_mut::<Block, u8>(&mut self.blocks)[start..start + entry];
        place[..4].copy_from_slice(&key.to_le_bytes());
        place[4..].copy_from_slice(bytemuck::bytes_of(&record));
        self.used[bucket] += entry as u32;
        Ok(())
    }

    /// Writes the chunk of a bucket.
    #[cold]
    fn write<T: Pod>(&mut self, bucket: usize, name: &str) -> Result<(), StorageError> {
        let used = self.used[bucket] as usize;
        let records = ((used - HEADER) / (4 + size_of::<T>())) as u64;
        if records == 0 {
            return Ok(());
        }
        let first = bucket * self.layout.chunk_blocks;
        let blocks = &mut self.blocks[first..first + used.div_ceil(Block::BYTES)];
        let header = &mut bytemuck::cast_slice_mut::<Block, u8>(blocks)[..HEADER];
        header[..8].copy_from_slice(&self.buckets[bucket].last.to_le_bytes());
        header[8..].copy_from_slice(&records.to_le_bytes());
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(self.scratch.create(name)?),
        };
        file.write(self.written, blocks)?;
        let before = self.buckets[bucket].records;
        self.buckets[bucket] = Bucket { last: self.written, records: before + records };
        self.written += blocks.len() as u64;
        self.used[bucket] = HEADER as u32;
        Ok(())
    }

    /// Writes what is left.
    fn finish<T: Pod>(mut self, name: &str) -> Result<(Layout, Option<TemporaryFile>, Vec<Bucket>), StorageError> {
        (0..self.buckets.len()).try_for_each(|bucket| self.write::<T>(bucket, name))?;
        Ok((self.layout, self.file, self.buckets))
    }
}

/// How to open a [`Scattered`] again that was kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptScattered {
    count: u64,
    content: KeptContent,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
enum KeptContent {
    InOrder(KeptSpool),
    Buckets {
        /// `None` where no record was put.
        file: Option<String>,
        /// Blocks of it.
        blocks: u64,
        layout: Layout,
        buckets: Vec<Bucket>,
    },
}

impl KeptScattered {
    /// Its files in the scratch.
    pub fn files(&self) -> impl Iterator<Item = String> + '_ {
        let (KeptContent::InOrder(KeptSpool { file, .. }) | KeptContent::Buckets { file, .. }) = &self.content;
        file.iter().cloned()
    }
}

/// Hands out the records of all keys, by ascending key.
#[derive(Debug)]
pub struct Scattered<T> {
    count: u64,
    source: Source<T>,
}

#[derive(Debug)]
enum Source<T> {
    /// They were in RAM when all were there, so they are in order.
    InOrder(Spool<T>, Cursor),
    Buckets(Buckets<T>),
}

#[derive(Debug)]
struct Buckets<T> {
    file: Option<TemporaryFile>,
    layout: Layout,
    buckets: Vec<Bucket>,
    /// The bucket behind the one in RAM.
    next: usize,
    /// Those of the bucket in RAM.
    records: Vec<T>,
    /// How many of them are handed out.
    used: usize,
}

impl<T: Pod> Source<T> {
    fn in_order(spool: Spool<T>) -> Self {
        let cursor = Cursor::new::<T>(0, spool.len(), READ_BUFFER);
        Source::InOrder(spool, cursor)
    }
}

impl<T: Pod + Send + Sync> Scattered<T> {
    /// Keeps it for a checkpoint, on disk where it was not, and begins with the first record again: its file stays when it
    /// goes. Says how to open it again.
    pub fn keep(&mut self, scratch: &Scratch, name: &str) -> Result<KeptScattered, StorageError> {
        let content = match &mut self.source {
            Source::InOrder(spool, cursor) => {
                *cursor = Cursor::new::<T>(0, spool.len(), READ_BUFFER);
                KeptContent::InOrder(spool.keep(scratch, name)?)
            }
            Source::Buckets(Buckets { file, layout, buckets, next, records, used }) => {
                (*next, *used) = (0, 0);
                records.clear();
                let blocks = file.as_ref().map_or(0, TemporaryFile::blocks);
                let file = file.as_ref().map(TemporaryFile::keep);
                KeptContent::Buckets { file, blocks, layout: *layout, buckets: buckets.clone() }
            }
        };
        Ok(KeptScattered { count: self.count, content })
    }

    /// Opens one that was kept.
    pub fn reopen(scratch: &Scratch, kept: &KeptScattered) -> Result<Self, StorageError> {
        let source = match &kept.content {
            KeptContent::InOrder(kept) => Source::in_order(Spool::reopen(scratch, kept)?),
            KeptContent::Buckets { file, blocks, layout, buckets } => {
                let file = file.as_ref().map(|name| scratch.reopen(name, *blocks)).transpose()?;
                let (layout, buckets) = (*layout, buckets.clone());
                Source::Buckets(Buckets { file, layout, buckets, next: 0, records: Vec::new(), used: 0 })
            }
        };
        Ok(Scattered { count: kept.count, source })
    }

    /// The record of the next key, `None` behind the last.
    #[inline]
    #[expect(clippy::should_implement_trait, reason = "it can fail")]
    pub fn next(&mut self) -> Result<Option<T>, StorageError> {
        match &mut self.source {
            Source::InOrder(spool, cursor) => cursor.next(spool),
            Source::Buckets(buckets) => {
                if buckets.used == buckets.records.len() && !buckets.fill(self.count)? {
                    return Ok(None);
                }
                buckets.used += 1;
                Ok(Some(buckets.records[buckets.used - 1]))
            }
        }
    }
}

impl<T: Pod> Buckets<T> {
    /// Has the records of the next bucket in RAM; false behind the last.
    #[cold]
    fn fill(&mut self, count: u64) -> Result<bool, StorageError> {
        let Some(Bucket { mut last, records }) = self.buckets.get(self.next).copied() else { return Ok(false) };
        let first = (self.next as u64) << self.layout.shift;
        let end = (first + (1 << self.layout.shift)).min(count);
        self.records.clear();
        self.records.resize((end - first) as usize, T::zeroed());
        let mut blocks = vec![Block::ZERO; if records == 0 { 0 } else { self.layout.chunk_blocks }];
        let mut left = records;
        while left > 0 {
            let file = self.file.as_ref().ok_or_else(no_file)?;
            let altered = |what: String| StorageError::Altered { path: file.path().to_path_buf(), what };
            // The last chunks of the buckets may end before a full one would.
            let in_file = file.blocks().saturating_sub(last);
            let read = self.layout.chunk_blocks.min(in_file as usize);
            if last == NONE || read == 0 {
                return Err(altered(format!("a bucket has {left} records more than there are")));
            }
            file.read(last, &mut blocks[..read])?;
            let (header, entries) = bytemuck::cast_slice::<Block, u8>(&blocks[..read]).split_at(HEADER);
            let [before, here] =
                [&header[..8], &header[8..]].map(|bytes| u64::from_le(bytemuck::pod_read_unaligned(bytes)));
            let entry = 4 + size_of::<T>();
            if here == 0 || here > left || here > (entries.len() / entry) as u64 {
                return Err(altered(format!("the chunk at block {last} has {here} records")));
            }
            for entry in entries.chunks_exact(entry).take(here as usize) {
                let (key, record) = entry.split_at(4);
                let key = u64::from(u32::from_le(bytemuck::pod_read_unaligned(key)));
                match self.records.get_mut(key.wrapping_sub(first) as usize) {
                    Some(place) => *place = bytemuck::pod_read_unaligned(record),
                    None => return Err(altered(format!("the chunk at block {last} has a record with the key {key}"))),
                }
            }
            (last, left) = (before, left - here);
        }
        self.next += 1;
        self.used = 0;
        Ok(true)
    }
}

/// A bucket of a kept store has records, but the store has no file.
fn no_file() -> StorageError {
    StorageError::Altered { path: "manifest.json".into(), what: "records without a file".to_owned() }
}
