//! A file system in RAM: what tests use when they do not want to touch the machine's.

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::disk::{Block, Disk, ReadAt, ScratchFile, StorageError, WriteFile};

type Content = Arc<Mutex<Vec<u8>>>;

/// Files held in memory. Clones share the same files.
#[derive(Debug, Clone, Default)]
pub struct MemoryDisk {
    files: Arc<Mutex<BTreeMap<PathBuf, Content>>>,
}

/// A thread that died while it held the lock leaves bytes behind that are as good as any.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl MemoryDisk {
    /// An empty file system.
    pub fn new() -> Self {
        Self::default()
    }

    /// Puts a file in place, replacing what was there.
    pub fn insert(&self, path: impl Into<PathBuf>, bytes: impl Into<Vec<u8>>) {
        lock(&self.files).insert(path.into(), Arc::new(Mutex::new(bytes.into())));
    }

    /// A copy of a file's bytes, if it exists.
    pub fn bytes(&self, path: impl AsRef<Path>) -> Option<Vec<u8>> {
        lock(&self.files).get(path.as_ref()).map(|content| lock(content).clone())
    }

    /// The names of all files, sorted.
    pub fn paths(&self) -> Vec<PathBuf> {
        lock(&self.files).keys().cloned().collect()
    }
}

#[derive(Debug)]
struct MemoryFile {
    path: PathBuf,
    content: Content,
}

impl ReadAt for MemoryFile {
    fn path(&self) -> &Path {
        &self.path
    }

    fn length(&self) -> u64 {
        lock(&self.content).len() as u64
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<usize, StorageError> {
        let content = lock(&self.content);
        let start = usize::try_from(offset).unwrap_or(usize::MAX).min(content.len());
        let count = buffer.len().min(content.len() - start);
        buffer[..count].copy_from_slice(&content[start..start + count]);
        Ok(count)
    }
}

impl WriteFile for MemoryFile {
    fn append(&mut self, bytes: &[u8]) -> Result<(), StorageError> {
        lock(&self.content).extend_from_slice(bytes);
        Ok(())
    }

    fn set_length(&mut self, length: u64) -> Result<(), StorageError> {
        lock(&self.content).resize(usize::try_from(length).unwrap_or(usize::MAX), 0);
        Ok(())
    }

    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> Result<(), StorageError> {
        let mut content = lock(&self.content);
        let start = usize::try_from(offset).unwrap_or(usize::MAX);
        match content.get_mut(start..start.saturating_add(bytes.len())) {
            Some(place) => {
                place.copy_from_slice(bytes);
                Ok(())
            }
            None => {
                let error = io::Error::new(io::ErrorKind::InvalidInput, "past the end of what was appended");
                Err(StorageError::io(&self.path, "overwrite", error))
            }
        }
    }

    fn sync(&mut self) -> Result<(), StorageError> {
        Ok(())
    }
}

impl ScratchFile for MemoryFile {
    fn path(&self) -> &Path {
        &self.path
    }

    fn read_blocks(&self, first: u64, blocks: &mut [Block]) -> Result<(), StorageError> {
        self.read_exact_at(first * Block::BYTES as u64, bytemuck::cast_slice_mut(blocks))
    }

    fn write_blocks(&self, first: u64, blocks: &[Block]) -> Result<(), StorageError> {
        let mut content = lock(&self.content);
        let start = first as usize * Block::BYTES;
        let bytes: &[u8] = bytemuck::cast_slice(blocks);
        if content.len() < start + bytes.len() {
            content.resize(start + bytes.len(), 0);
        }
        content[start..start + bytes.len()].copy_from_slice(bytes);
        Ok(())
    }

    fn length(&self) -> Result<u64, StorageError> {
        Ok(ReadAt::length(self))
    }

    fn sync(&self) -> Result<(), StorageError> {
        Ok(())
    }

    fn is_direct(&self) -> bool {
        true
    }
}

fn not_found(path: &Path, operation: &str) -> StorageError {
    StorageError::io(path, operation, io::Error::from(io::ErrorKind::NotFound))
}

impl Disk for MemoryDisk {
    fn open(&self, path: &Path) -> Result<Arc<dyn ReadAt>, StorageError> {
        let content = lock(&self.files).get(path).cloned().ok_or_else(|| not_found(path, "open"))?;
        Ok(Arc::new(MemoryFile { path: path.to_path_buf(), content }))
    }

    fn create_new(&self, path: &Path) -> Result<Box<dyn WriteFile>, StorageError> {
        let mut files = lock(&self.files);
        if files.contains_key(path) {
            return Err(StorageError::io(path, "create", io::Error::from(io::ErrorKind::AlreadyExists)));
        }
        let content = Content::default();
        files.insert(path.to_path_buf(), content.clone());
        Ok(Box::new(MemoryFile { path: path.to_path_buf(), content }))
    }

    fn create_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        self.create_new(path)?;
        self.open_scratch(path)
    }

    fn open_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        let content = lock(&self.files).get(path).cloned().ok_or_else(|| not_found(path, "open"))?;
        Ok(Arc::new(MemoryFile { path: path.to_path_buf(), content }))
    }

    /// There are no folders, only names.
    fn create_folder(&self, _: &Path) -> Result<(), StorageError> {
        Ok(())
    }

    /// No other process sees this disk.
    fn lock(&self, path: &Path) -> Result<Box<dyn Send + Debug>, StorageError> {
        self.insert(path, Vec::new());
        Ok(Box::new(()))
    }

    fn remove_folder(&self, _: &Path) -> Result<(), StorageError> {
        Ok(())
    }

    fn rename(&self, from: &Path, to: &Path) -> Result<(), StorageError> {
        let mut files = lock(&self.files);
        let content = files.remove(from).ok_or_else(|| not_found(from, "rename"))?;
        files.insert(to.to_path_buf(), content);
        Ok(())
    }

    fn remove(&self, path: &Path) -> Result<(), StorageError> {
        lock(&self.files).remove(path).map(|_| ()).ok_or_else(|| not_found(path, "remove"))
    }

    fn list(&self, folder: &Path) -> Result<Vec<PathBuf>, StorageError> {
        Ok(lock(&self.files).keys().filter(|path| path.parent() == Some(folder)).cloned().collect())
    }

    /// A folder exists as long as a file is in it.
    fn exists(&self, path: &Path) -> bool {
        lock(&self.files).keys().any(|file| file.starts_with(path))
    }
}
