//! A sequence of records of one fixed size: written from front to back, then read from front to back, or anywhere.
//!
//! It stays in RAM as long as it takes no more than the bytes it was given, and goes to a scratch file beyond that, one
//! record behind the other without gaps. Files are written and read in whole blocks, as many at once as the bytes allow.

use std::marker::PhantomData;

use bytemuck::Pod;
use serde::{Deserialize, Serialize};

use crate::disk::{Block, StorageError};
use crate::scratch::{Scratch, TemporaryFile};

/// The fewest blocks of a buffer.
const FEWEST_BLOCKS: usize = 2;
/// Reads of more than this many blocks are done in parts.
const MOST_BLOCKS_AT_ONCE: usize = 64;

/// A [`Spool`] being written.
#[derive(Debug)]
pub struct SpoolWriter<T> {
    scratch: Scratch,
    name: String,
    most_blocks: usize,
    buffer: Vec<Block>,
    /// Bytes of the buffer that are in use.
    used: usize,
    file: Option<TemporaryFile>,
    /// Blocks in the file.
    written: u64,
    length: u64,
    records: PhantomData<T>,
}

impl<T: Pod> SpoolWriter<T> {
    /// Begins an empty sequence that holds at most `ram_bytes` in RAM. `name` is for messages and file names.
    pub fn new(scratch: &Scratch, name: &str, ram_bytes: usize) -> Self {
        let most_blocks = if scratch.has_disk() { (ram_bytes / Block::BYTES).max(FEWEST_BLOCKS) } else { usize::MAX };
        SpoolWriter {
            scratch: scratch.clone(),
            name: name.to_owned(),
            most_blocks,
            buffer: Vec::new(),
            used: 0,
            file: None,
            written: 0,
            length: 0,
            records: PhantomData,
        }
    }

    /// Appends a record.
    #[inline]
    pub fn push(&mut self, record: T) -> Result<(), StorageError> {
        if self.used + size_of::<T>() > self.buffer.len() * Block::BYTES {
            self.make_room()?;
        }
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut self.buffer);
        bytes[self.used..self.used + size_of::<T>()].copy_from_slice(bytemuck::bytes_of(&record));
        self.used += size_of::<T>();
        self.length += 1;
        Ok(())
    }

    /// Appends records.
    pub fn extend(&mut self, records: &[T]) -> Result<(), StorageError> {
        records.iter().try_for_each(|record| self.push(*record))
    }

    /// Makes the buffer larger, or writes what it has: then less than a block is left in it.
    #[cold]
    fn make_room(&mut self) -> Result<(), StorageError> {
        let blocks = self.buffer.len();
        if blocks < self.most_blocks {
            let more = blocks.max(FEWEST_BLOCKS).max(size_of::<T>() / Block::BYTES + 1).min(self.most_blocks - blocks);
            // Not by doubling without need: the bytes given are a limit.
            self.buffer.reserve_exact(more);
            self.buffer.resize(blocks + more, Block::ZERO);
            if self.used + size_of::<T>() <= self.buffer.len() * Block::BYTES {
                return Ok(());
            }
        }
        let full = self.used / Block::BYTES;
        self.write(full)?;
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut self.buffer);
        bytes.copy_within(full * Block::BYTES..self.used, 0);
        self.used -= full * Block::BYTES;
        if self.used + size_of::<T>() > self.buffer.len() * Block::BYTES {
            self.buffer.resize(self.buffer.len() + size_of::<T>() / Block::BYTES + 1, Block::ZERO);
        }
        Ok(())
    }

    /// Writes the first blocks of the buffer.
    fn write(&mut self, blocks: usize) -> Result<(), StorageError> {
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(self.scratch.create(&self.name)?),
        };
        file.write(self.written, &self.buffer[..blocks])?;
        self.written += blocks as u64;
        Ok(())
    }

    /// Records so far.
    pub fn len(&self) -> u64 {
        self.length
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Ends the writing.
    pub fn finish(mut self) -> Result<Spool<T>, StorageError> {
        if self.file.is_some() {
            return self.finish_on_disk();
        }
        self.buffer.truncate(self.used.div_ceil(Block::BYTES));
        self.buffer.shrink_to_fit();
        Ok(Spool { content: Content::Blocks(self.buffer), length: self.length, records: PhantomData })
    }

    /// Ends the writing, and keeps nothing in RAM.
    pub fn finish_on_disk(mut self) -> Result<Spool<T>, StorageError> {
        if self.length == 0 || !self.scratch.has_disk() {
            let content = Content::Blocks(std::mem::take(&mut self.buffer));
            return Ok(Spool { content, length: self.length, records: PhantomData });
        }
        self.write(self.used.div_ceil(Block::BYTES))?;
        let content = match self.file {
            Some(file) => Content::File(file),
            None => Content::Blocks(Vec::new()),
        };
        Ok(Spool { content, length: self.length, records: PhantomData })
    }
}

/// A finished sequence of records. Its file is gone with it.
#[derive(Debug)]
pub struct Spool<T> {
    content: Content<T>,
    length: u64,
    records: PhantomData<T>,
}

/// How to open a [`Spool`] again that was kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeptSpool {
    /// Its file in the scratch; `None` where it has no records.
    pub file: Option<String>,
    /// How many records it has.
    pub length: u64,
}

#[derive(Debug)]
enum Content<T> {
    Records(Vec<T>),
    Blocks(Vec<Block>),
    File(TemporaryFile),
}

impl<T: Pod> Spool<T> {
    /// A sequence that is in RAM already.
    pub fn from_vec(records: Vec<T>) -> Self {
        Spool { length: records.len() as u64, content: Content::Records(records), records: PhantomData }
    }

    /// Keeps it for a checkpoint, on disk where it was not: its file stays when it goes. Says how to open it again.
    pub fn keep(&mut self, scratch: &Scratch, name: &str) -> Result<KeptSpool, StorageError> {
        if !matches!(self.content, Content::File(_)) {
            let mut writer = SpoolWriter::new(scratch, name, MOST_BLOCKS_AT_ONCE * Block::BYTES);
            let mut reader = self.reader(0);
            while let Some(record) = reader.next()? {
                writer.push(record)?;
            }
            *self = writer.finish_on_disk()?;
        }
        let file = match &self.content {
            Content::File(file) => Some(file.keep()),
            _ => None,
        };
        Ok(KeptSpool { file, length: self.length })
    }

    /// Opens one that was kept.
    pub fn reopen(scratch: &Scratch, kept: &KeptSpool) -> Result<Self, StorageError> {
        let blocks = (kept.length * size_of::<T>() as u64).div_ceil(Block::BYTES as u64);
        let content = match &kept.file {
            Some(file) => Content::File(scratch.reopen(file, blocks)?),
            None => Content::Records(Vec::new()),
        };
        Ok(Spool { content, length: kept.length, records: PhantomData })
    }

    /// How many records there are.
    pub fn len(&self) -> u64 {
        self.length
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Bytes of RAM that it holds; 0 where it is on disk.
    pub fn ram_bytes(&self) -> usize {
        match &self.content {
            Content::Records(records) => records.capacity() * size_of::<T>(),
            Content::Blocks(blocks) => blocks.capacity() * Block::BYTES,
            Content::File(_) => 0,
        }
    }

    /// Fills `records` with those from number `start` on. They must exist.
    pub fn read_at(&self, start: u64, records: &mut [T]) -> Result<(), StorageError> {
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(records);
        let first_byte = start * size_of::<T>() as u64;
        match &self.content {
            Content::Records(all) => bytes.copy_from_slice(bytes_in(all, first_byte, bytes.len())),
            Content::Blocks(all) => bytes.copy_from_slice(bytes_in(all, first_byte, bytes.len())),
            Content::File(file) => {
                let mut buffer = Vec::new();
                let mut done = 0;
                while done < bytes.len() {
                    let from = first_byte + done as u64;
                    let (block, offset) = (from / Block::BYTES as u64, (from % Block::BYTES as u64) as usize);
                    let blocks = (offset + bytes.len() - done).div_ceil(Block::BYTES).min(MOST_BLOCKS_AT_ONCE);
                    buffer.resize(blocks, Block::ZERO);
                    file.read(block, &mut buffer)?;
                    let found = &bytemuck::cast_slice::<Block, u8>(&buffer)[offset..];
                    let count = found.len().min(bytes.len() - done);
                    bytes[done..done + count].copy_from_slice(&found[..count]);
                    done += count;
                }
            }
        }
        Ok(())
    }

    /// Reads from the first record on, through a buffer of at most `ram_bytes`.
    pub fn reader(&self, ram_bytes: usize) -> SpoolReader<'_, T> {
        self.reader_of(0, self.len(), ram_bytes)
    }

    /// Reads the records `start..end`, through a buffer of at most `ram_bytes`.
    pub fn reader_of(&self, start: u64, end: u64, ram_bytes: usize) -> SpoolReader<'_, T> {
        let most_blocks = (ram_bytes / Block::BYTES).max(FEWEST_BLOCKS).max(size_of::<T>() / Block::BYTES + 2);
        SpoolReader { spool: self, next: start, end, most_blocks, buffer: Vec::new(), offset: 0, left: 0 }
    }
}

/// The bytes of a slice from `first` on.
fn bytes_in<T: Pod>(all: &[T], first: u64, count: usize) -> &[u8] {
    &bytemuck::cast_slice(all)[first as usize..][..count]
}

/// A cursor over a [`Spool`].
#[derive(Debug)]
pub struct SpoolReader<'a, T> {
    spool: &'a Spool<T>,
    /// The record behind those in the buffer.
    next: u64,
    end: u64,
    most_blocks: usize,
    /// Of a file, blocks of it. What is in RAM is read where it is.
    buffer: Vec<Block>,
    /// Where in the buffer the next record begins.
    offset: usize,
    /// Records of the buffer that are left.
    left: usize,
}

impl<T: Pod> SpoolReader<'_, T> {
    /// The next record, `None` behind the last.
    #[inline]
    #[expect(clippy::should_implement_trait, reason = "it can fail")]
    pub fn next(&mut self) -> Result<Option<T>, StorageError> {
        if self.left == 0 && !self.fill()? {
            return Ok(None);
        }
        let offset = self.offset;
        self.offset += size_of::<T>();
        self.left -= 1;
        Ok(Some(bytemuck::pod_read_unaligned(&self.bytes()[offset..offset + size_of::<T>()])))
    }

    /// As many of the next records as lie together in the buffer; none behind the last.
    pub fn next_chunk(&mut self) -> Result<&[T], StorageError> {
        if self.left == 0 && !self.fill()? {
            return Ok(&[]);
        }
        let range = self.offset..self.offset + self.left * size_of::<T>();
        self.offset = range.end;
        self.left = 0;
        Ok(bytemuck::cast_slice(&self.bytes()[range]))
    }

    #[inline]
    fn bytes(&self) -> &[u8] {
        match &self.spool.content {
            Content::Records(all) => bytemuck::cast_slice(all),
            Content::Blocks(all) => bytemuck::cast_slice(all),
            Content::File(_) => bytemuck::cast_slice(&self.buffer),
        }
    }

    /// Has more records in the buffer; false where there are none.
    #[cold]
    fn fill(&mut self) -> Result<bool, StorageError> {
        if self.next == self.end {
            return Ok(false);
        }
        let first_byte = self.next * size_of::<T>() as u64;
        if let Content::File(file) = &self.spool.content {
            let block = first_byte / Block::BYTES as u64;
            self.offset = (first_byte % Block::BYTES as u64) as usize;
            let wanted = self.offset + (self.end - self.next) as usize * size_of::<T>();
            let blocks = wanted.div_ceil(Block::BYTES).min(self.most_blocks);
            self.buffer.reserve_exact(blocks.saturating_sub(self.buffer.len()));
            self.buffer.resize(blocks, Block::ZERO);
            file.read(block, &mut self.buffer)?;
            self.left = ((blocks * Block::BYTES - self.offset) / size_of::<T>()).min((self.end - self.next) as usize);
        } else {
            self.offset = first_byte as usize;
            self.left = (self.end - self.next) as usize;
        }
        self.next += self.left as u64;
        Ok(true)
    }
}
