//! A disk that fails where a test says so: the n-th read, the write that passes a number of bytes (a full disk), or a share of
//! all reads, which may also take their time.
//!
//! It wraps any other [`Disk`]; until the fault it behaves like the disk it wraps. Which reads of a share it strikes depends on
//! their number and a seed, so it is the same each time where the reads are.

use std::fmt::Debug;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crate::disk::{Block, Disk, ReadAt, ScratchFile, StorageError, WriteFile};

/// When the faults strike; shared by all files of one [`FaultyDisk`].
#[derive(Debug)]
struct Plan {
    reads_left: AtomicU64,
    bytes_left: AtomicU64,
    /// Reads so far.
    reads: AtomicU64,
    seed: AtomicU64,
    /// The shares of the reads that fail, and that are delayed, in parts of 2^32; and by how many microseconds.
    failing: AtomicU64,
    delayed: AtomicU64,
    delay: AtomicU64,
    /// The share of the reads that bring something else than what was written.
    altered: AtomicU64,
}

impl Plan {
    /// A number of 32 bits that is the same for the same read, seed and purpose.
    fn chance(&self, read: u64, purpose: u64) -> u64 {
        let mut z = self.seed.load(Ordering::Relaxed) ^ purpose << 56 ^ read.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) >> 32
    }

    /// One more read. Returns its number.
    fn read(&self, path: &Path, bytes: usize, offset: u64) -> Result<u64, StorageError> {
        let read = self.reads.fetch_add(1, Ordering::Relaxed);
        if self.chance(read, 1) < self.delayed.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_micros(self.delay.load(Ordering::Relaxed)));
        }
        let strikes = self.chance(read, 2) < self.failing.load(Ordering::Relaxed);
        if !strikes && Plan::take(&self.reads_left, 1) {
            return Ok(read);
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
        let plan = Plan {
            reads_left: AtomicU64::new(u64::MAX),
            bytes_left: AtomicU64::new(u64::MAX),
            reads: AtomicU64::new(0),
            seed: AtomicU64::new(0),
            failing: AtomicU64::new(0),
            delayed: AtomicU64::new(0),
            delay: AtomicU64::new(0),
            altered: AtomicU64::new(0),
        };
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

    /// This share of all reads fails from now on, and does not when it is tried again, but for the same share.
    pub fn fail_share_of_reads(&self, share: f64, seed: u64) {
        self.plan.seed.store(seed, Ordering::Relaxed);
        self.plan.failing.store(parts(share), Ordering::Relaxed);
    }

    /// This share of all reads takes so much longer from now on.
    pub fn delay_share_of_reads(&self, share: f64, delay: Duration, seed: u64) {
        self.plan.seed.store(seed, Ordering::Relaxed);
        self.plan.delay.store(delay.as_micros() as u64, Ordering::Relaxed);
        self.plan.delayed.store(parts(share), Ordering::Relaxed);
    }

    /// This share of all reads of files brings one bit that was not written, from now on.
    pub fn alter_share_of_reads(&self, share: f64, seed: u64) {
        self.plan.seed.store(seed, Ordering::Relaxed);
        self.plan.altered.store(parts(share), Ordering::Relaxed);
    }

    /// No fault from now on.
    pub fn heal(&self) {
        self.alter_share_of_reads(0.0, 0);
        self.fail_share_of_reads(0.0, 0);
        self.delay_share_of_reads(0.0, Duration::ZERO, 0);
        self.fail_reads_after(u64::MAX);
        self.full_after(u64::MAX);
    }
}

/// A share, 0 to 1, in parts of 2^32.
fn parts(share: f64) -> u64 {
    (share.clamp(0.0, 1.0) * (1_u64 << 32) as f64) as u64
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

    fn is_direct(&self) -> bool {
        self.inner.is_direct()
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<usize, StorageError> {
        let read = self.plan.read(self.path(), buffer.len(), offset)?;
        let count = self.inner.read_at(offset, buffer)?;
        if self.plan.chance(read, 3) < self.plan.altered.load(Ordering::Relaxed)
            && let Some(byte) = buffer.get_mut(self.plan.chance(read, 4) as usize % count.max(1))
        {
            *byte ^= 1;
        }
        Ok(count)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MemoryDisk;

    #[test]
    fn a_share_of_the_reads_fails_and_the_same_ones_each_time() {
        let memory = MemoryDisk::new();
        memory.insert("file", vec![7; 10]);
        let failures = |share: f64, seed: u64| {
            let disk = FaultyDisk::new(Arc::new(memory.clone()));
            let file = disk.open("file".as_ref()).unwrap();
            disk.fail_share_of_reads(share, seed);
            let failed: Vec<bool> = (0..10_000).map(|_| file.read_at(0, &mut [0]).is_err()).collect();
            disk.heal();
            assert!((0..100).all(|_| file.read_at(0, &mut [0]).is_ok()));
            failed
        };
        let first = failures(0.01, 5);
        let count = first.iter().filter(|failed| **failed).count();
        assert!((60..150).contains(&count), "{count}");
        assert_eq!(first, failures(0.01, 5));
        assert_ne!(first, failures(0.01, 6));
        assert!(failures(1.0, 3).iter().all(|failed| *failed) && failures(0.0, 3).iter().all(|failed| !failed));
    }

    #[test]
    fn a_read_that_is_altered_is_right_the_next_time() {
        let memory = MemoryDisk::new();
        memory.insert("file", vec![0; 10]);
        let disk = FaultyDisk::new(Arc::new(memory));
        let file = disk.open("file".as_ref()).unwrap();
        let read = || {
            let mut bytes = [0; 10];
            file.read_exact_at(0, &mut bytes).unwrap();
            bytes.iter().filter(|byte| **byte != 0).count()
        };
        disk.alter_share_of_reads(1.0, 4);
        assert_eq!((read(), read()), (1, 1));
        disk.alter_share_of_reads(0.0, 4);
        assert_eq!(read(), 0);
    }

    #[test]
    fn a_delayed_read_takes_longer() {
        let memory = MemoryDisk::new();
        memory.insert("file", vec![7; 10]);
        let disk = FaultyDisk::new(Arc::new(memory));
        let file = disk.open("file".as_ref()).unwrap();
        disk.delay_share_of_reads(1.0, Duration::from_millis(20), 1);
        let start = std::time::Instant::now();
        file.read_at(0, &mut [0]).unwrap();
        assert!(start.elapsed() >= Duration::from_millis(20));
    }
}
