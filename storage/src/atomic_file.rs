//! A file that appears under its name whole, or not at all (invariant 8 of the design).
//!
//! It is written under a temporary name beside its target, flushed to the device, and renamed. Dropped before
//! [`AtomicFile::commit`], it removes the temporary file and leaves whatever the target was; a program that is told to
//! stop calls [`remove_unfinished`] first. Appends are gathered in a buffer of 64 KiB.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use crate::disk::{Disk, StorageError, WriteFile};

const BUFFER_BYTES: usize = 64 * 1024;

/// The temporary files of this process, and the disks that they are on.
static UNFINISHED: Mutex<Vec<(Arc<dyn Disk>, PathBuf)>> = Mutex::new(Vec::new());

fn unfinished() -> MutexGuard<'static, Vec<(Arc<dyn Disk>, PathBuf)>> {
    // A list of names is sound whatever happened to the thread that held it.
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps every [`AtomicFile`] of this process from beginning, being committed or being given up, as long as it lives.
#[derive(Debug)]
pub struct Standstill {
    _list: MutexGuard<'static, Vec<(Arc<dyn Disk>, PathBuf)>>,
    _folders: MutexGuard<'static, Vec<Weak<crate::scratch::Inner>>>,
}

/// Removes the temporary files of all [`AtomicFile`]s that are not committed, and what is in the [`crate::Scratch`]
/// folders of this process but for their checkpoints: what a program does when it is told to
/// stop at once. It ends while it holds the [`Standstill`], so that nothing new is left behind meanwhile; those files
/// cannot be committed any more.
pub fn remove_unfinished() -> Standstill {
    let mut list = unfinished();
    for (disk, temporary) in list.drain(..) {
        // There is nobody to tell, and no time.
        let _ = disk.remove(&temporary);
    }
    Standstill { _list: list, _folders: crate::scratch::clean_up_all() }
}

/// Whether a process of this number is running. Where the system does not tell, one is.
fn is_running(process: u32) -> bool {
    #[cfg(unix)]
    {
        let process = i32::try_from(process).ok().and_then(rustix::process::Pid::from_raw);
        process.is_some_and(|process| rustix::process::test_kill_process(process) != Err(rustix::io::Errno::SRCH))
    }
    #[cfg(not(unix))]
    {
        let _ = process;
        true
    }
}

/// Removes what killed processes left of this target.
fn remove_leftovers(disk: &dyn Disk, target: &Path, name: &str) -> Result<(), StorageError> {
    for path in disk.list(target.parent().unwrap_or(Path::new("")))? {
        let found = path.file_name().map(|found| found.to_string_lossy().into_owned()).unwrap_or_default();
        let process = found
            .strip_prefix('.')
            .and_then(|rest| rest.strip_prefix(name))
            .and_then(|rest| rest.strip_prefix('.'))
            .and_then(|rest| rest.strip_suffix(".tmp"))
            .and_then(|process| process.parse().ok());
        // A file of our own number is from an earlier process that had it: ours are on the list, and nobody writes the
        // same output twice at once.
        if process.is_some_and(|process| process == std::process::id() || !is_running(process)) {
            disk.remove(&path)?;
        }
    }
    Ok(())
}

/// A file on its way to its name.
#[derive(Debug)]
pub struct AtomicFile {
    disk: Arc<dyn Disk>,
    target: PathBuf,
    temporary: PathBuf,
    file: Option<Box<dyn WriteFile>>,
    buffer: Vec<u8>,
    length: u64,
}

impl AtomicFile {
    /// Begins a file that will be called `target`. Whether an existing `target` may be replaced is the caller's
    /// question; here it simply is, at the commit.
    pub fn create(disk: Arc<dyn Disk>, target: &Path) -> Result<Self, StorageError> {
        let name = target.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let temporary = target.with_file_name(format!(".{name}.{}.tmp", std::process::id()));
        let mut list = unfinished();
        remove_leftovers(disk.as_ref(), target, &name)?;
        let file = disk.create_new(&temporary).map_err(|error| match error {
            // The user asked for the target; the temporary name would only puzzle.
            StorageError::Io { operation, source, .. } => StorageError::io(target, operation, source),
            other => other,
        })?;
        list.push((disk.clone(), temporary.clone()));
        drop(list);
        Ok(AtomicFile {
            disk,
            target: target.to_path_buf(),
            temporary,
            file: Some(file),
            buffer: Vec::with_capacity(BUFFER_BYTES),
            length: 0,
        })
    }

    /// Bytes appended so far.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Appends all of `bytes`.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), StorageError> {
        self.length += bytes.len() as u64;
        if self.buffer.len() + bytes.len() > BUFFER_BYTES {
            self.flush()?;
        }
        if bytes.len() >= BUFFER_BYTES {
            return self.with_file(|file| file.append(bytes));
        }
        self.buffer.extend_from_slice(bytes);
        Ok(())
    }

    /// Makes the file so long; what was not written is zero. For a file that is written in any order.
    pub fn set_length(&mut self, length: u64) -> Result<(), StorageError> {
        self.flush()?;
        self.length = length;
        self.with_file(|file| file.set_length(length))
    }

    /// Overwrites bytes that were appended before, or that [`AtomicFile::set_length`] made room for.
    pub fn write_at(&mut self, offset: u64, bytes: &[u8]) -> Result<(), StorageError> {
        self.flush()?;
        self.with_file(|file| file.write_at(offset, bytes))
    }

    /// Flushes everything to the device and gives the file its name.
    pub fn commit(mut self) -> Result<(), StorageError> {
        self.flush()?;
        self.with_file(|file| file.sync())?;
        // Closed before it is renamed: some systems insist.
        self.file = None;
        let mut list = unfinished();
        let renamed = self.disk.rename(&self.temporary, &self.target);
        self.forget(&mut list);
        if renamed.is_err() {
            let _ = self.disk.remove(&self.temporary);
        }
        renamed
    }

    fn forget(&self, list: &mut Vec<(Arc<dyn Disk>, PathBuf)>) {
        list.retain(|(disk, temporary)| !Arc::ptr_eq(disk, &self.disk) || *temporary != self.temporary);
    }

    fn flush(&mut self) -> Result<(), StorageError> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        let buffer = std::mem::take(&mut self.buffer);
        let result = self.with_file(|file| file.append(&buffer));
        self.buffer = buffer;
        self.buffer.clear();
        result
    }

    fn with_file(
        &mut self,
        action: impl FnOnce(&mut dyn WriteFile) -> Result<(), StorageError>,
    ) -> Result<(), StorageError> {
        // `file` is only taken by `commit`, which consumes `self`.
        let result = match &mut self.file {
            Some(file) => action(file.as_mut()),
            None => Ok(()),
        };
        result.map_err(|error| match error {
            StorageError::Io { operation, source, .. } => StorageError::io(&self.target, operation, source),
            other => other,
        })
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        if self.file.take().is_some() {
            self.forget(&mut unfinished());
            // An error here has no one to go to; the next build finds the leftover by its name.
            let _ = self.disk.remove(&self.temporary);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FaultyDisk, MemoryDisk};

    #[test]
    fn nothing_is_seen_before_the_commit_and_nothing_is_left_without_it() {
        let memory = MemoryDisk::new();
        memory.insert("model", b"old".to_vec());
        let disk: Arc<dyn Disk> = Arc::new(memory.clone());
        let mut file = AtomicFile::create(disk.clone(), Path::new("model")).unwrap();
        file.append(b"half a model").unwrap();
        drop(file);
        assert_eq!(memory.bytes("model").unwrap(), b"old");
        assert_eq!(memory.paths().len(), 1);

        let mut file = AtomicFile::create(disk, Path::new("model")).unwrap();
        file.append(b"new").unwrap();
        file.commit().unwrap();
        assert_eq!(memory.bytes("model").unwrap(), b"new");
        assert_eq!(memory.paths().len(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn what_a_killed_process_left_is_removed_and_what_a_running_one_writes_is_not() {
        let memory = MemoryDisk::new();
        let running = std::os::unix::process::parent_id();
        let kept = [format!("there/.model.{running}.tmp"), "there/.model.x.tmp".into(), "there/.other.1.tmp".into()];
        kept.iter().for_each(|path| memory.insert(path, b"half".to_vec()));
        // Numbers of processes end far below this one.
        memory.insert("there/.model.2000000000.tmp", b"half".to_vec());
        let file = AtomicFile::create(Arc::new(memory.clone()), Path::new("there/model")).unwrap();
        file.commit().unwrap();
        let mut expected: Vec<PathBuf> = kept.iter().map(PathBuf::from).collect();
        expected.push("there/model".into());
        expected.sort();
        assert_eq!(memory.paths(), expected);
    }

    #[test]
    fn a_full_disk_leaves_the_previous_file() {
        let memory = MemoryDisk::new();
        memory.insert("model", b"old".to_vec());
        let disk = FaultyDisk::new(Arc::new(memory.clone()));
        disk.full_after(100_000);
        let mut file = AtomicFile::create(Arc::new(disk), Path::new("model")).unwrap();
        let result = (0..4).try_for_each(|_| file.append(&[7; 50_000])).and_then(|()| file.commit());
        assert!(result.unwrap_err().to_string().contains("cannot write"));
        assert_eq!(memory.bytes("model").unwrap(), b"old");
        assert_eq!(memory.paths().len(), 1);
    }
}
