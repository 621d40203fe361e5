//! The machine's file system, with files read past the system's page cache (`O_DIRECT`) where the file system can do that.
//!
//! A program with a buffer pool of its own gains nothing from a second copy in the system's: what was read once lies in
//! RAM twice, and in a memory cgroup the cache counts. Such reads begin and end at multiples of [`Block::BYTES`], on disk and
//! in memory, so a read goes to a buffer of blocks, and what was asked for is copied out of it. The buffers are kept for the
//! next reads: as many as there are reads at a time, each as large as the largest read.
//!
//! What it costs is the system's reading ahead. Flights over two models that no cache held, with two threads that read 3 KB pages,
//! missed 3.9 and 5.1 % of the pages like this and 3.1 and 3.4 % through the cache (srtm in 16 MB), 7 % and more against 2 to
//! 11 % (16 M triangles in 64 MB). So it is for those whose cache counts, or is needed for something else.

use std::fmt::Debug;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use crate::disk::{Block, Disk, LocalDisk, ReadAt, ScratchFile, StorageError, WriteFile, positioned_read};

/// The machine's own file system, without the page cache for what [`Disk::open`] opens. In all else it is [`LocalDisk`], and
/// so it is for files that cannot be read like this.
#[derive(Debug, Clone, Copy, Default)]
pub struct DirectDisk;

#[derive(Debug)]
struct DirectFile {
    file: fs::File,
    path: PathBuf,
    length: u64,
    /// Buffers that no read uses at the moment.
    buffers: Mutex<Vec<Vec<Block>>>,
}

impl DirectFile {
    /// A buffer of at least so many blocks.
    fn buffer(&self, blocks: usize) -> Vec<Block> {
        let kept = self.buffers.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut buffer = kept.unwrap_or_default();
        if buffer.len() < blocks {
            buffer.resize(blocks, Block::ZERO);
        }
        buffer
    }

    fn give_back(&self, buffer: Vec<Block>) {
        self.buffers.lock().unwrap_or_else(PoisonError::into_inner).push(buffer);
    }
}

impl ReadAt for DirectFile {
    fn path(&self) -> &Path {
        &self.path
    }

    fn length(&self) -> u64 {
        self.length
    }

    fn is_direct(&self) -> bool {
        true
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<usize, StorageError> {
        let block = Block::BYTES as u64;
        let skipped = (offset % block) as usize;
        let count = (skipped + buffer.len()).div_ceil(Block::BYTES);
        let mut blocks = self.buffer(count);
        let read = loop {
            match positioned_read(&self.file, offset - skipped as u64, bytemuck::cast_slice_mut(&mut blocks[..count])) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                other => break other,
            }
        };
        let result = match read {
            Ok(read) => {
                let bytes: &[u8] = bytemuck::cast_slice(&blocks);
                let found = bytes[skipped.min(read)..read].len().min(buffer.len());
                buffer[..found].copy_from_slice(&bytes[skipped..skipped + found]);
                Ok(found)
            }
            Err(error) => {
                let operation = format!("read {} bytes at offset {offset} of", buffer.len());
                Err(StorageError::io(&self.path, operation, error))
            }
        };
        self.give_back(blocks);
        result
    }
}

/// The file, past the page cache; `None` where that cannot be.
#[cfg(target_os = "linux")]
fn open_direct(path: &Path) -> Option<fs::File> {
    use std::os::unix::fs::OpenOptionsExt;
    let flags = rustix::fs::OFlags::DIRECT.bits() as i32;
    let file = fs::OpenOptions::new().read(true).custom_flags(flags).open(path).ok()?;
    // Some file systems take the flag and refuse the reads.
    let mut block = [Block::ZERO];
    positioned_read(&file, 0, bytemuck::cast_slice_mut(&mut block)).ok()?;
    Some(file)
}

#[cfg(not(target_os = "linux"))]
fn open_direct(_path: &Path) -> Option<fs::File> {
    None
}

impl Disk for DirectDisk {
    fn open(&self, path: &Path) -> Result<Arc<dyn ReadAt>, StorageError> {
        // What cannot be opened at all is told by the one that opens everything.
        let other = LocalDisk.open(path)?;
        let Some(file) = open_direct(path) else { return Ok(other) };
        let length = other.length();
        Ok(Arc::new(DirectFile { file, path: path.to_path_buf(), length, buffers: Mutex::default() }))
    }

    fn create_new(&self, path: &Path) -> Result<Box<dyn WriteFile>, StorageError> {
        LocalDisk.create_new(path)
    }

    fn create_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        LocalDisk.create_scratch(path)
    }

    fn open_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        LocalDisk.open_scratch(path)
    }

    fn create_folder(&self, path: &Path) -> Result<(), StorageError> {
        LocalDisk.create_folder(path)
    }

    fn lock(&self, path: &Path) -> Result<Box<dyn Send + Debug>, StorageError> {
        LocalDisk.lock(path)
    }

    fn remove_folder(&self, path: &Path) -> Result<(), StorageError> {
        LocalDisk.remove_folder(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> Result<(), StorageError> {
        LocalDisk.rename(from, to)
    }

    fn remove(&self, path: &Path) -> Result<(), StorageError> {
        LocalDisk.remove(path)
    }

    fn list(&self, folder: &Path) -> Result<Vec<PathBuf>, StorageError> {
        LocalDisk.list(folder)
    }

    fn exists(&self, path: &Path) -> bool {
        LocalDisk.exists(path)
    }

    fn is_file_system(&self) -> bool {
        LocalDisk.is_file_system()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_part_of_a_file_is_read_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let bytes: Vec<u8> = (0..3 * Block::BYTES + 17).map(|index| (index * 31 % 251) as u8).collect();
        fs::write(&path, &bytes).unwrap();
        let file = DirectDisk.open(&path).unwrap();
        assert_eq!(file.length(), bytes.len() as u64);
        for (start, length) in [(0, 1), (5, 4090), (4095, 2), (4096, 4096), (1, 3 * 4096), (12_288, 17), (12_300, 5)] {
            let mut read = vec![0; length];
            file.read_exact_at(start as u64, &mut read).unwrap();
            assert_eq!(read, bytes[start..start + length], "{length} bytes at {start}");
        }
        let mut past = [0; 10];
        assert_eq!(file.read_at(bytes.len() as u64 - 3, &mut past).unwrap(), 3);
        assert_eq!(file.read_at(bytes.len() as u64 + 3, &mut past).unwrap(), 0);
        let message = file.read_exact_at(bytes.len() as u64 - 3, &mut past).unwrap_err().to_string();
        assert!(message.contains("is too short"), "{message}");
        let message = DirectDisk.open(folder.path()).unwrap_err().to_string();
        assert!(message.contains("is a directory"), "{message}");
    }
}
