//! A disk that counts what is read from it and written to it: the I/O figures of the reports.

use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::disk::{Block, Disk, ReadAt, ScratchFile, StorageError, WriteFile};

#[derive(Debug, Default)]
struct Counters {
    read: AtomicU64,
    written: AtomicU64,
}

/// Counts the bytes that pass through another disk. Clones share their counts.
#[derive(Debug, Clone)]
pub struct CountingDisk {
    inner: Arc<dyn Disk>,
    counters: Arc<Counters>,
}

impl CountingDisk {
    /// Counts what passes through `inner` from now on.
    pub fn new(inner: Arc<dyn Disk>) -> Self {
        CountingDisk { inner, counters: Arc::default() }
    }

    /// Bytes read so far.
    pub fn bytes_read(&self) -> u64 {
        self.counters.read.load(Ordering::Relaxed)
    }

    /// Bytes written so far.
    pub fn bytes_written(&self) -> u64 {
        self.counters.written.load(Ordering::Relaxed)
    }
}

#[derive(Debug)]
struct CountingRead {
    inner: Arc<dyn ReadAt>,
    counters: Arc<Counters>,
}

impl ReadAt for CountingRead {
    fn path(&self) -> &Path {
        self.inner.path()
    }

    fn length(&self) -> u64 {
        self.inner.length()
    }

    fn is_direct(&self) -> bool {
        self.inner.is_direct()
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<usize, StorageError> {
        let count = self.inner.read_at(offset, buffer)?;
        self.counters.read.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }
}

#[derive(Debug)]
struct CountingWrite {
    inner: Box<dyn WriteFile>,
    counters: Arc<Counters>,
}

impl WriteFile for CountingWrite {
    fn append(&mut self, bytes: &[u8]) -> Result<(), StorageError> {
        self.inner.append(bytes)?;
        self.counters.written.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        Ok(())
    }

    fn set_length(&mut self, length: u64) -> Result<(), StorageError> {
        self.inner.set_length(length)
    }

    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> Result<(), StorageError> {
        self.inner.write_at(offset, bytes)?;
        self.counters.written.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        Ok(())
    }

    fn sync(&mut self) -> Result<(), StorageError> {
        self.inner.sync()
    }
}

#[derive(Debug)]
struct CountingScratch {
    inner: Arc<dyn ScratchFile>,
    counters: Arc<Counters>,
}

impl ScratchFile for CountingScratch {
    fn path(&self) -> &Path {
        self.inner.path()
    }

    fn read_blocks(&self, first: u64, blocks: &mut [Block]) -> Result<(), StorageError> {
        self.inner.read_blocks(first, blocks)?;
        self.counters.read.fetch_add(size_of_val(blocks) as u64, Ordering::Relaxed);
        Ok(())
    }

    fn write_blocks(&self, first: u64, blocks: &[Block]) -> Result<(), StorageError> {
        self.inner.write_blocks(first, blocks)?;
        self.counters.written.fetch_add(size_of_val(blocks) as u64, Ordering::Relaxed);
        Ok(())
    }

    fn length(&self) -> Result<u64, StorageError> {
        self.inner.length()
    }

    fn sync(&self) -> Result<(), StorageError> {
        self.inner.sync()
    }

    fn is_direct(&self) -> bool {
        self.inner.is_direct()
    }
}

impl Disk for CountingDisk {
    fn open(&self, path: &Path) -> Result<Arc<dyn ReadAt>, StorageError> {
        Ok(Arc::new(CountingRead { inner: self.inner.open(path)?, counters: self.counters.clone() }))
    }

    fn create_new(&self, path: &Path) -> Result<Box<dyn WriteFile>, StorageError> {
        Ok(Box::new(CountingWrite { inner: self.inner.create_new(path)?, counters: self.counters.clone() }))
    }

    fn create_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        let inner = self.inner.create_scratch(path)?;
        Ok(Arc::new(CountingScratch { inner, counters: self.counters.clone() }))
    }

    fn open_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        let inner = self.inner.open_scratch(path)?;
        Ok(Arc::new(CountingScratch { inner, counters: self.counters.clone() }))
    }

    fn create_folder(&self, path: &Path) -> Result<(), StorageError> {
        self.inner.create_folder(path)
    }

    fn lock(&self, path: &Path) -> Result<Box<dyn Send + Debug>, StorageError> {
        self.inner.lock(path)
    }

    fn remove_folder(&self, path: &Path) -> Result<(), StorageError> {
        self.inner.remove_folder(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> Result<(), StorageError> {
        self.inner.rename(from, to)
    }

    fn remove(&self, path: &Path) -> Result<(), StorageError> {
        self.inner.remove(path)
    }

    fn list(&self, folder: &Path) -> Result<Vec<PathBuf>, StorageError> {
        self.inner.list(folder)
    }

    fn exists(&self, path: &Path) -> bool {
        self.inner.exists(path)
    }

    fn is_file_system(&self) -> bool {
        self.inner.is_file_system()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MemoryDisk;

    #[test]
    fn what_passes_is_counted_and_what_is_past_the_end_is_not() {
        let disk = CountingDisk::new(Arc::new(MemoryDisk::new()));
        let mut file = disk.create_new(Path::new("file")).unwrap();
        file.append(b"twelve bytes").unwrap();
        file.write_at(0, b"T").unwrap();
        assert_eq!((disk.bytes_written(), disk.bytes_read()), (13, 0));
        let mut buffer = [0; 8];
        let file = disk.open(Path::new("file")).unwrap();
        assert_eq!(file.read_at(8, &mut buffer).unwrap(), 4);
        assert_eq!(disk.bytes_read(), 4);
    }
}
