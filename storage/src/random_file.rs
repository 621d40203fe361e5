//! A scratch file that is read and written at any byte, for stores of others that lay out their files themselves.
//!
//! Blocks are what passes: where only a part of one is written, it is read first. Bytes that were never written are
//! zero. What passes is counted.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::disk::{Block, StorageError};
use crate::scratch::{Scratch, TemporaryFile};

/// Bytes that went through a file or a store.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Bytes read.
    pub read: u64,
    /// Bytes written.
    pub written: u64,
}

impl std::ops::Add for Traffic {
    type Output = Traffic;

    fn add(self, other: Traffic) -> Traffic {
        Traffic { read: self.read + other.read, written: self.written + other.written }
    }
}

/// A file of temporary data. Shared freely between threads.
#[derive(Debug)]
pub(crate) struct RandomFile {
    file: TemporaryFile,
    inner: Mutex<Inner>,
    blocks_read: AtomicU64,
    blocks_written: AtomicU64,
}

#[derive(Debug)]
struct Inner {
    /// Blocks that were written, from the first on: behind them is nothing but zeros.
    blocks: u64,
    /// Bytes in the file, as its user sees it.
    length: u64,
    /// What passes, while it does.
    buffer: Vec<Block>,
}

/// Bytes of a block.
const BLOCK: u64 = Block::BYTES as u64;

impl RandomFile {
    /// An empty file.
    pub fn create(scratch: &Scratch, name: &str) -> Result<Self, StorageError> {
        Ok(RandomFile {
            file: scratch.create(name)?,
            inner: Mutex::new(Inner { blocks: 0, length: 0, buffer: Vec::new() }),
            blocks_read: AtomicU64::new(0),
            blocks_written: AtomicU64::new(0),
        })
    }

    /// Its name, for messages.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Length in bytes.
    pub fn length(&self) -> u64 {
        self.inner().length
    }

    /// What passed through the file so far.
    pub fn traffic(&self) -> Traffic {
        let [read, written] = [&self.blocks_read, &self.blocks_written].map(|count| count.load(Ordering::Relaxed));
        Traffic { read: read * BLOCK, written: written * BLOCK }
    }

    /// A thread that died while it held the lock leaves a file behind that is as good as any.
    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes the file longer, by zeros, or shorter.
    pub fn set_length(&self, length: u64) -> Result<(), StorageError> {
        let inner = &mut *self.inner();
        if length < inner.length {
            // What is cut off must be zero, should the file grow again.
            let kept = length.div_ceil(BLOCK).min(inner.blocks);
            if length < kept * BLOCK {
                let cut = (kept * BLOCK - length) as usize;
                self.write(inner, length, &vec![0; cut])?;
            }
            inner.blocks = kept;
        }
        inner.length = length;
        Ok(())
    }

    /// Fills `bytes` from byte `offset` on; all of it must lie within the file.
    pub fn read_at(&self, offset: u64, bytes: &mut [u8]) -> Result<(), StorageError> {
        let inner = &mut *self.inner();
        let end = offset + bytes.len() as u64;
        if inner.length < end {
            let (path, length, needed) = (self.path().to_path_buf(), inner.length, bytes.len() as u64);
            return Err(StorageError::TooShort { path, length, offset, needed });
        }
        let first = offset / BLOCK;
        let count = (end.div_ceil(BLOCK) - first) as usize;
        inner.buffer.clear();
        inner.buffer.resize(count, Block::ZERO);
        let written = inner.blocks.saturating_sub(first).min(count as u64) as usize;
        self.read_blocks(first, &mut inner.buffer[..written])?;
        let start = (offset - first * BLOCK) as usize;
        bytes.copy_from_slice(&bytemuck::cast_slice(&inner.buffer)[start..start + bytes.len()]);
        Ok(())
    }

    /// Writes at byte `offset`; the file grows to hold it.
    pub fn write_at(&self, offset: u64, bytes: &[u8]) -> Result<(), StorageError> {
        self.write(&mut self.inner(), offset, bytes)
    }

    fn write(&self, inner: &mut Inner, offset: u64, bytes: &[u8]) -> Result<(), StorageError> {
        if bytes.is_empty() {
            return Ok(());
        }
        while inner.blocks < offset / BLOCK {
            static ZEROS: [Block; 16] = [Block::ZERO; 16];
            let gap = (offset / BLOCK - inner.blocks).min(ZEROS.len() as u64);
            self.write_blocks(inner.blocks, &ZEROS[..gap as usize])?;
            inner.blocks += gap;
        }
        let end = offset + bytes.len() as u64;
        let first = offset / BLOCK;
        let count = (end.div_ceil(BLOCK) - first) as usize;
        inner.buffer.clear();
        inner.buffer.resize(count, Block::ZERO);
        for (edge, is_partial) in [(first, !offset.is_multiple_of(BLOCK)), (end / BLOCK, !end.is_multiple_of(BLOCK))] {
            if is_partial && edge < inner.blocks {
                let place = (edge - first) as usize;
                self.read_blocks(edge, &mut inner.buffer[place..place + 1])?;
            }
        }
        let start = (offset - first * BLOCK) as usize;
        bytemuck::cast_slice_mut(&mut inner.buffer)[start..start + bytes.len()].copy_from_slice(bytes);
        self.write_blocks(first, &inner.buffer)?;
        inner.blocks = inner.blocks.max(first + count as u64);
        inner.length = inner.length.max(end);
        Ok(())
    }

    fn read_blocks(&self, first: u64, blocks: &mut [Block]) -> Result<(), StorageError> {
        if blocks.is_empty() {
            return Ok(());
        }
        self.blocks_read.fetch_add(blocks.len() as u64, Ordering::Relaxed);
        self.file.read(first, blocks)
    }

    fn write_blocks(&self, first: u64, blocks: &[Block]) -> Result<(), StorageError> {
        self.blocks_written.fetch_add(blocks.len() as u64, Ordering::Relaxed);
        self.file.write(first, blocks)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;

    use super::*;
    use crate::MemoryDisk;

    #[derive(Debug, Clone)]
    enum Step {
        Write { offset: u64, bytes: Vec<u8> },
        Length(u64),
    }

    /// A place that is near the edge of a block more often than not.
    fn place() -> impl Strategy<Value = u64> {
        prop_oneof![0..30_000_u64, (0..8_u64, 0..3_u64).prop_map(|(block, more)| block * BLOCK + more)]
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            3 => (place(), place()).prop_map(|(offset, length)| {
                Step::Write { offset, bytes: (0..length).map(|byte| byte as u8 | 1).collect() }
            }),
            1 => place().prop_map(Step::Length),
        ]
    }

    proptest! {
        #[test]
        fn it_holds_what_a_vector_would(steps in prop::collection::vec(step(), 0..12)) {
            let disk = MemoryDisk::new();
            let scratch = Scratch::open(Arc::new(disk.clone()), Path::new("scratch"), "").unwrap().0;
            let file = RandomFile::create(&scratch, "file").unwrap();
            let mut expected: Vec<u8> = Vec::new();
            for step in steps {
                match step {
                    Step::Write { offset, bytes } => {
                        file.write_at(offset, &bytes).unwrap();
                        let end = offset as usize + bytes.len();
                        if !bytes.is_empty() {
                            expected.resize(expected.len().max(end), 0);
                            expected[offset as usize..end].copy_from_slice(&bytes);
                        }
                    }
                    Step::Length(length) => {
                        file.set_length(length).unwrap();
                        expected.resize(length as usize, 0);
                    }
                }
                prop_assert_eq!(file.length(), expected.len() as u64);
                let mut found = vec![7; expected.len()];
                file.read_at(0, &mut found).unwrap();
                prop_assert!(found == expected);
                if let Some(middle) = found.get_mut(expected.len() / 3..expected.len() / 2) {
                    file.read_at(expected.len() as u64 / 3, middle).unwrap();
                    prop_assert!(found == expected);
                }
                prop_assert!(file.read_at(1, &mut found).is_err());
            }
            drop((file, scratch));
            prop_assert!(disk.paths().is_empty());
        }
    }
}
