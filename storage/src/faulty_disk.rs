//! A disk that fails where a test says so: the n-th read, or the write that passes a number of bytes (a full disk).
//!
//! It wraps any other [`Disk`]; until the fault it behaves like the disk it wraps.

use std::fmt::Debug;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::disk::{Block, Disk, ReadAt, ScratchFile, StorageError, WriteFile};

/// When the faults strike; shared by all files of one [`FaultyDisk`].
#[derive(Debug)]
struct Plan {
    reads_left: AtomicU64,
    bytes_left: AtomicU64,
}

impl Plan {
    /// One more read.
    fn read(&self, path: &Path, bytes: usize, offset: u64) -> Result<(), StorageError> {
        if Plan::take(&self.reads_left, 1) {
            return Ok(());
        }
        let operation = format!("read {bytes} bytes at offset {offset} of");
        Err(StorageError::io(path, operation, io::Error::other("injected fault")))
    }

    /// So many bytes more.
    fn write(&self, path: &Path, bytes: usize) -> Result<(), StorageError> {
        if Plan::take(&self.bytes_left, bytes as u64) {
            return Ok(());
        }
        let operation = format!("write {bytes} bytes to");
        Err(StorageError::io(path, operation, io::Error::from(io::ErrorKind::StorageFull)))
    }

    /// Takes `amount` off a counter; false when it was not there any more.
    fn take(counter: &AtomicU64, amount: u64) -> bool {
        counter
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| {
                if left == u64::MAX { Some(left) } else { left.checked_sub(amount) }
            })
            .is_ok()
    }
}

/// A disk with a fault in it.
#[derive(Debug, Clone)]
pub struct FaultyDisk {
    inner: Arc<dyn Disk>,
    plan: Arc<Plan>,
}

impl FaultyDisk {
    /// Wraps `inner`; without a fault as yet.
    pub fn new(inner: Arc<dyn Disk>) -> Self {
        let plan = Plan { reads_left: AtomicU64::new(u64::MAX), bytes_left: AtomicU64::new(u64::MAX) };
        FaultyDisk { inner, plan: Arc::new(plan) }
    }

    /// Every read after the next `count` fails, until told otherwise.
    pub fn fail_reads_after(&self, count: u64) {
        self.plan.reads_left.store(count, Ordering::Relaxed);
    }

    /// The disk is full once `bytes` more were written to it.
    pub fn full_after(&self, bytes: u64) {
        self.plan.bytes_left.store(bytes, Ordering::Relaxed);
    }

    /// No fault from now on.
    pub fn heal(&self) {
        self.fail_reads_after(u64::MAX);
        self.full_after(u64::MAX);
    }
}

#[derive(Debug)]
struct FaultyRead {
    inner: Arc<dyn ReadAt>,
    plan: Arc<Plan>,
}

impl ReadAt for FaultyRead {
    fn path(&self) -> &Path {
        self.inner.path()
    }

    fn length(&self) -> u64 {
        self.inner.length()
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<usize, StorageError> {
        self.plan.read(self.path(), buffer.len(), offset)?;
        self.inner.read_at(offset, buffer)
    }
}

#[derive(Debug)]
struct FaultyWrite {
    inner: Box<dyn WriteFile>,
    path: PathBuf,
    plan: Arc<Plan>,
}

impl WriteFile for FaultyWrite {
    fn append(&mut self, bytes: &[u8]) -> Result<(), StorageError> {
        self.plan.write(&self.path, bytes.len())?;
        self.inner.append(bytes)
    }

    fn set_length(&mut self, length: u64) -> Result<(), StorageError> {
        self.plan.write(&self.path, usize::try_from(length).unwrap_or(usize::MAX))?;
        self.inner.set_length(length)
    }

    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> Result<(), StorageError> {
        self.inner.write_at(offset, bytes)
    }

    fn sync(&mut self) -> Result<(), StorageError> {
        self.inner.sync()
    }
}

#[derive(Debug)]
struct FaultyScratch {
    inner: Arc<dyn ScratchFile>,
    plan: Arc<Plan>,
}

impl ScratchFile for FaultyScratch {
    fn path(&self) -> &Path {
        self.inner.path()
    }

    fn read_blocks(&self, first: u64, blocks: &mut [Block]) -> Result<(), StorageError> {
        self.plan.read(self.path(), size_of_val(blocks), first * Block::BYTES as u64)?;
        self.inner.read_blocks(first, blocks)
    }

    fn write_blocks(&self, first: u64, blocks: &[Block]) -> Result<(), StorageError> {
        self.plan.write(self.path(), size_of_val(blocks))?;
        self.inner.write_blocks(first, blocks)
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

impl Disk for FaultyDisk {
    fn open(&self, path: &Path) -> Result<Arc<dyn ReadAt>, StorageError> {
        Ok(Arc::new(FaultyRead { inner: self.inner.open(path)?, plan: self.plan.clone() }))
    }

    fn create_new(&self, path: &Path) -> Result<Box<dyn WriteFile>, StorageError> {
        let inner = self.inner.create_new(path)?;
        Ok(Box::new(FaultyWrite { inner, path: path.to_path_buf(), plan: self.plan.clone() }))
    }

    fn create_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        let inner = self.inner.create_scratch(path)?;
        Ok(Arc::new(FaultyScratch { inner, plan: self.plan.clone() }))
    }

    fn open_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        let inner = self.inner.open_scratch(path)?;
        Ok(Arc::new(FaultyScratch { inner, plan: self.plan.clone() }))
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
}
