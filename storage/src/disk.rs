//! The one door to the disk: [`Disk`], and the machine's own file system behind it, [`LocalDisk`].
//!
//! Reads are positioned (`read_at`), so that several threads can share one open file without a cursor; writes go
//! front to back, with [`WriteFile::write_at`] for the rare header that is known only at the end. Every error names
//! the file and what was being done to it.

use std::fmt::Debug;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use thiserror::Error;

use crate::mapped_file::MappedFile;

/// A failed disk operation: which file, what was being done, and what the system said.
#[derive(Debug, Error)]
pub enum StorageError {
    /// The system refused an operation on a file.
    #[error("cannot {operation} {}: {source}", path.display())]
    Io {
        /// The file in question.
        path: PathBuf,
        /// What was being done, as a verb phrase: "open", "read 4096 bytes at offset 0 of".
        operation: String,
        /// What the system said.
        source: io::Error,
    },
    /// The path names something that is not a plain file.
    #[error("cannot open {}: it is a directory, not a file", path.display())]
    Directory {
        /// The path in question.
        path: PathBuf,
    },
    /// Another process is at work where only one can be.
    #[error(
        "another build is at work in {}: wait until it is done, or name another place with --scratch",
        path.display()
    )]
    Busy {
        /// The folder in question.
        path: PathBuf,
    },
    /// A sorter did not give back what it got.
    #[error(
        "sorting in {} failed: {taken} records were put in, but {delivered} came out; the disk or the program is at fault",
        path.display()
    )]
    Miscounted {
        /// The folder in question.
        path: PathBuf,
        /// Records that were put in.
        taken: u64,
        /// Records that came out, until there were no more or too many.
        delivered: u64,
    },
    /// A read reached past the end of the file.
    #[error(
        "{} is too short: it has {length} bytes, but {needed} bytes are needed from offset {offset} on; \
         the file is truncated or altered",
        path.display()
    )]
    TooShort {
        /// The file in question.
        path: PathBuf,
        /// Its length in bytes.
        length: u64,
        /// Where the read began, in bytes from the start.
        offset: u64,
        /// How many bytes were asked for.
        needed: u64,
    },
    /// A number that a store has no place for.
    #[error("{name} has places 0 to {count} (without {count}), not {index}")]
    NoSuchPlace {
        /// What the store is for.
        name: String,
        /// How many places it has.
        count: u64,
        /// The number in question.
        index: u64,
    },
    /// A scratch file is not as it was written.
    #[error("{} is altered: {what}", path.display())]
    Altered {
        /// The file in question.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
}

impl StorageError {
    /// An [`StorageError::Io`] for `operation` on `path`.
    pub fn io(path: &Path, operation: impl Into<String>, source: io::Error) -> Self {
        StorageError::Io { path: path.to_path_buf(), operation: operation.into(), source }
    }
}

/// A file open for positioned reads. Shared freely between threads.
pub trait ReadAt: Send + Sync + Debug {
    /// The path under which the file was opened, for messages.
    fn path(&self) -> &Path;

    /// Length of the file in bytes, as it was when it was opened.
    fn length(&self) -> u64;

    /// Whether reads go past the system's page cache. Decided when the file is opened.
    fn is_direct(&self) -> bool {
        false
    }

    /// Reads up to `buffer.len()` bytes at byte `offset`; fewer only at the end of the file (0 past it).
    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<usize, StorageError>;

    /// Fills `buffer` from byte `offset` on, or says how much of the file there is.
    fn read_exact_at(&self, offset: u64, buffer: &mut [u8]) -> Result<(), StorageError> {
        let mut done = 0;
        while done < buffer.len() {
            let count = self.read_at(offset + done as u64, &mut buffer[done..])?;
            if count == 0 {
                return Err(StorageError::TooShort {
                    path: self.path().to_path_buf(),
                    length: self.length(),
                    offset,
                    needed: buffer.len() as u64,
                });
            }
            done += count;
        }
        Ok(())
    }
}

/// A new file being written front to back.
pub trait WriteFile: Send + Debug {
    /// Appends all of `bytes`.
    fn append(&mut self, bytes: &[u8]) -> Result<(), StorageError>;

    /// Makes the file so long, where it was shorter; the new bytes are zero.
    fn set_length(&mut self, length: u64) -> Result<(), StorageError>;

    /// Overwrites `bytes.len()` bytes at byte `offset`, which must lie inside the file as it is so far.
    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> Result<(), StorageError>;

    /// Waits until everything written has reached the device.
    fn sync(&mut self) -> Result<(), StorageError>;
}

/// A unit in which scratch files are read and written: aligned in memory as it is on disk, so that the system can move it
/// to and from the device without a copy.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C, align(4096))]
pub struct Block {
    bytes: [u8; Block::BYTES],
}

impl Block {
    /// Bytes of a block.
    pub const BYTES: usize = 4096;

    /// A block of zeros.
    pub const ZERO: Block = Block { bytes: [0; Block::BYTES] };
}

/// A scratch file: written and read anywhere, block by block, by several threads.
pub trait ScratchFile: Send + Sync + Debug {
    /// The path under which the file was created, for messages.
    fn path(&self) -> &Path;

    /// Fills `blocks` from block number `first` on. All of them must have been written.
    fn read_blocks(&self, first: u64, blocks: &mut [Block]) -> Result<(), StorageError>;

    /// Writes `blocks` from block number `first` on.
    fn write_blocks(&self, first: u64, blocks: &[Block]) -> Result<(), StorageError>;

    /// Length of the file in bytes.
    fn length(&self) -> Result<u64, StorageError>;

    /// Waits until everything written has reached the device.
    fn sync(&self) -> Result<(), StorageError>;

    /// Whether reads and writes go past the system's page cache. Decided when the file is opened.
    fn is_direct(&self) -> bool;
}

/// A file system. The libraries hold it as `&dyn Disk` or `Arc<dyn Disk>` and touch no file in any other way.
pub trait Disk: Send + Sync + Debug {
    /// Opens an existing file for reading.
    fn open(&self, path: &Path) -> Result<Arc<dyn ReadAt>, StorageError>;

    /// Maps an existing file into memory. Disks without files of the machine's cannot.
    fn map(&self, path: &Path) -> Result<MappedFile, StorageError> {
        Err(StorageError::io(path, "map", io::Error::from(io::ErrorKind::Unsupported)))
    }

    /// Creates a file that must not exist yet.
    fn create_new(&self, path: &Path) -> Result<Box<dyn WriteFile>, StorageError>;

    /// Creates a scratch file that must not exist yet. Disks that only read need not be able to.
    fn create_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        Err(StorageError::io(path, "create", io::Error::from(io::ErrorKind::Unsupported)))
    }

    /// Opens a scratch file that exists.
    fn open_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        Err(StorageError::io(path, "open", io::Error::from(io::ErrorKind::Unsupported)))
    }

    /// Creates a folder for scratch files, and those above it, where there is none.
    fn create_folder(&self, path: &Path) -> Result<(), StorageError> {
        Err(StorageError::io(path, "create", io::Error::from(io::ErrorKind::Unsupported)))
    }

    /// Takes the lock that the file `path` stands for, in a folder that is there; held until the value is dropped or the
    /// process ends. [`StorageError::Busy`] where another process holds it.
    fn lock(&self, path: &Path) -> Result<Box<dyn Send + Debug>, StorageError> {
        Err(StorageError::io(path, "lock", io::Error::from(io::ErrorKind::Unsupported)))
    }

    /// Removes an empty folder.
    fn remove_folder(&self, path: &Path) -> Result<(), StorageError> {
        Err(StorageError::io(path, "remove", io::Error::from(io::ErrorKind::Unsupported)))
    }

    /// Gives `from` the name `to`, replacing what was there, in one step.
    fn rename(&self, from: &Path, to: &Path) -> Result<(), StorageError>;

    /// Deletes a file.
    fn remove(&self, path: &Path) -> Result<(), StorageError>;

    /// The files in a folder, in no particular order.
    fn list(&self, folder: &Path) -> Result<Vec<PathBuf>, StorageError>;

    /// Whether anything exists under this name.
    fn exists(&self, path: &Path) -> bool;

    /// Whether its files are those of the machine's file system, under the same names: then code of others that does its
    /// own I/O can be given a folder of it.
    fn is_file_system(&self) -> bool {
        false
    }
}

/// The machine's own file system.
#[derive(Debug, Clone, Copy, Default)]
pub struct LocalDisk;

#[derive(Debug)]
struct LocalFile {
    file: fs::File,
    path: PathBuf,
    length: u64,
}

impl ReadAt for LocalFile {
    fn path(&self) -> &Path {
        &self.path
    }

    fn length(&self) -> u64 {
        self.length
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<usize, StorageError> {
        loop {
            match positioned_read(&self.file, offset, buffer) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => {
                    let operation = format!("read {} bytes at offset {offset} of", buffer.len());
                    return Err(StorageError::io(&self.path, operation, error));
                }
                Ok(count) => return Ok(count),
            }
        }
    }
}

#[cfg(unix)]
pub(crate) fn positioned_read(file: &fs::File, offset: u64, buffer: &mut [u8]) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, buffer, offset)
}

#[cfg(windows)]
pub(crate) fn positioned_read(file: &fs::File, offset: u64, buffer: &mut [u8]) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_read(file, buffer, offset)
}

#[derive(Debug)]
struct LocalWriteFile {
    file: fs::File,
    path: PathBuf,
    length: u64,
}

impl WriteFile for LocalWriteFile {
    fn append(&mut self, bytes: &[u8]) -> Result<(), StorageError> {
        use io::Write;
        self.file.write_all(bytes).map_err(|error| {
            let operation = format!("write {} bytes at offset {} of", bytes.len(), self.length);
            StorageError::io(&self.path, operation, error)
        })?;
        self.length += bytes.len() as u64;
        Ok(())
    }

    fn set_length(&mut self, length: u64) -> Result<(), StorageError> {
        use io::{Seek, SeekFrom};
        let mut lengthen = || {
            set_aside(&self.file, length)?;
            self.file.set_len(length)?;
            self.file.seek(SeekFrom::Start(length))
        };
        lengthen().map_err(|error| {
            let operation = format!("write {length} bytes to");
            StorageError::io(&self.path, operation, error)
        })?;
        self.length = length;
        Ok(())
    }

    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> Result<(), StorageError> {
        use io::{Seek, SeekFrom, Write};
        let mut overwrite = || {
            self.file.seek(SeekFrom::Start(offset))?;
            self.file.write_all(bytes)?;
            self.file.seek(SeekFrom::Start(self.length)).map(|_| ())
        };
        overwrite().map_err(|error| {
            let operation = format!("write {} bytes at offset {offset} of", bytes.len());
            StorageError::io(&self.path, operation, error)
        })
    }

    fn sync(&mut self) -> Result<(), StorageError> {
        self.file.sync_all().map_err(|error| StorageError::io(&self.path, "flush", error))
    }
}

/// Has the file system set room aside for so much of a file, where it can, so that a disk that is too full says so before
/// anything is written.
fn set_aside(file: &fs::File, length: u64) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{FallocateFlags, fallocate};
        use rustix::io::Errno;
        if length > 0 {
            match fallocate(file, FallocateFlags::empty(), 0, length) {
                Err(error) if error != Errno::OPNOTSUPP && error != Errno::NOSYS => return Err(error.into()),
                _ => {}
            }
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (file, length);
    Ok(())
}

#[derive(Debug)]
struct LocalScratchFile {
    file: fs::File,
    path: PathBuf,
    is_direct: bool,
}

impl ScratchFile for LocalScratchFile {
    fn path(&self) -> &Path {
        &self.path
    }

    fn read_blocks(&self, first: u64, blocks: &mut [Block]) -> Result<(), StorageError> {
        let (offset, bytes) = (first * Block::BYTES as u64, bytemuck::cast_slice_mut(blocks));
        read_exact(&self.file, offset, bytes).map_err(|error| match (error.kind(), self.length()) {
            (io::ErrorKind::UnexpectedEof, Ok(length)) => {
                StorageError::TooShort { path: self.path.clone(), length, offset, needed: bytes.len() as u64 }
            }
            _ => StorageError::io(&self.path, format!("read {} bytes at offset {offset} of", bytes.len()), error),
        })
    }

    fn write_blocks(&self, first: u64, blocks: &[Block]) -> Result<(), StorageError> {
        let (offset, bytes) = (first * Block::BYTES as u64, bytemuck::cast_slice(blocks));
        write_all(&self.file, offset, bytes).map_err(|error| {
            let operation = format!("write {} bytes at offset {offset} of", bytes.len());
            StorageError::io(&self.path, operation, error)
        })
    }

    fn length(&self) -> Result<u64, StorageError> {
        let metadata =
            self.file.metadata().map_err(|error| StorageError::io(&self.path, "find the length of", error))?;
        Ok(metadata.len())
    }

    fn sync(&self) -> Result<(), StorageError> {
        self.file.sync_all().map_err(|error| StorageError::io(&self.path, "flush", error))
    }

    fn is_direct(&self) -> bool {
        self.is_direct
    }
}

#[cfg(unix)]
fn read_exact(file: &fs::File, offset: u64, bytes: &mut [u8]) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

#[cfg(unix)]
fn write_all(file: &fs::File, offset: u64, bytes: &[u8]) -> io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, offset)
}

#[cfg(windows)]
fn read_exact(file: &fs::File, mut offset: u64, mut bytes: &mut [u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        let count = positioned_read(file, offset, bytes)?;
        if count == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        offset += count as u64;
        bytes = &mut bytes[count..];
    }
    Ok(())
}

#[cfg(windows)]
fn write_all(file: &fs::File, mut offset: u64, mut bytes: &[u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        let count = std::os::windows::fs::FileExt::seek_write(file, bytes, offset)?;
        offset += count as u64;
        bytes = &bytes[count..];
    }
    Ok(())
}

/// Opens a scratch file past the system's page cache where the file system can do that. Through the cache, writing a new
/// file takes 2 ns of the processor for each byte, fifty times as much (measured), and a memory cgroup counts it.
fn open_scratch_file(path: &Path) -> io::Result<LocalScratchFile> {
    let mut options = fs::OpenOptions::new();
    options.read(true).write(true);
    #[cfg(target_os = "linux")]
    {
        use std::os::unix::fs::OpenOptionsExt;
        let direct = options.clone().custom_flags(rustix::fs::OFlags::DIRECT.bits() as i32).open(path);
        match direct {
            // Some file systems, as those in RAM, have no other way than through the cache.
            Err(error) if error.raw_os_error() == Some(rustix::io::Errno::INVAL.raw_os_error()) => {}
            Err(error) => return Err(error),
            Ok(file) => return Ok(LocalScratchFile { file, path: path.to_path_buf(), is_direct: true }),
        }
    }
    Ok(LocalScratchFile { file: options.open(path)?, path: path.to_path_buf(), is_direct: false })
}

/// Whether the file that is open is still the one of this name.
fn has_name(file: &fs::File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let identity = |metadata: fs::Metadata| (metadata.dev(), metadata.ino());
        match (file.metadata(), fs::metadata(path)) {
            (Ok(file), Ok(named)) => identity(file) == identity(named),
            _ => false,
        }
    }
    #[cfg(not(unix))]
    {
        // A file that is open cannot be removed there.
        let _ = (file, path);
        true
    }
}

impl Disk for LocalDisk {
    fn open(&self, path: &Path) -> Result<Arc<dyn ReadAt>, StorageError> {
        let fail = |error| StorageError::io(path, "open", error);
        let file = fs::File::open(path).map_err(fail)?;
        let metadata = file.metadata().map_err(fail)?;
        if metadata.is_dir() {
            return Err(StorageError::Directory { path: path.to_path_buf() });
        }
        Ok(Arc::new(LocalFile { file, path: path.to_path_buf(), length: metadata.len() }))
    }

    fn map(&self, path: &Path) -> Result<MappedFile, StorageError> {
        MappedFile::open(path)
    }

    fn create_new(&self, path: &Path) -> Result<Box<dyn WriteFile>, StorageError> {
        let file = fs::File::create_new(path).map_err(|error| StorageError::io(path, "create", error))?;
        Ok(Box::new(LocalWriteFile { file, path: path.to_path_buf(), length: 0 }))
    }

    fn create_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        let fail = |error| StorageError::io(path, "create", error);
        // In two steps, since a file system that refuses to go past the cache may have created the file by then.
        fs::File::create_new(path).map_err(fail)?;
        Ok(Arc::new(open_scratch_file(path).map_err(fail)?))
    }

    fn open_scratch(&self, path: &Path) -> Result<Arc<dyn ScratchFile>, StorageError> {
        let file = open_scratch_file(path).map_err(|error| StorageError::io(path, "open", error))?;
        Ok(Arc::new(file))
    }

    fn create_folder(&self, path: &Path) -> Result<(), StorageError> {
        fs::create_dir_all(path).map_err(|error| StorageError::io(path, "create", error))
    }

    fn lock(&self, path: &Path) -> Result<Box<dyn Send + Debug>, StorageError> {
        let fail = |error| StorageError::io(path, "lock", error);
        loop {
            let file = fs::OpenOptions::new().create(true).truncate(false).write(true).open(path).map_err(fail)?;
            match file.try_lock() {
                // Who held it before may have removed the file since it was opened here: then it keeps nobody out.
                Ok(()) if !has_name(&file, path) => continue,
                Ok(()) => return Ok(Box::new(file)),
                Err(fs::TryLockError::WouldBlock) => {
                    return Err(StorageError::Busy { path: path.parent().unwrap_or(path).to_path_buf() });
                }
                Err(fs::TryLockError::Error(error)) => return Err(fail(error)),
            }
        }
    }

    fn remove_folder(&self, path: &Path) -> Result<(), StorageError> {
        fs::remove_dir(path).map_err(|error| StorageError::io(path, "remove", error))
    }

    fn rename(&self, from: &Path, to: &Path) -> Result<(), StorageError> {
        fs::rename(from, to).map_err(|error| {
            let operation = format!("rename {} to", from.display());
            StorageError::io(to, operation, error)
        })
    }

    fn remove(&self, path: &Path) -> Result<(), StorageError> {
        fs::remove_file(path).map_err(|error| StorageError::io(path, "remove", error))
    }

    fn list(&self, folder: &Path) -> Result<Vec<PathBuf>, StorageError> {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        let fail = |error| StorageError::io(folder, "list", error);
        fs::read_dir(folder).map_err(fail)?.map(|entry| Ok(entry.map_err(fail)?.path())).collect()
    }

    fn exists(&self, path: &Path) -> bool {
        path.symlink_metadata().is_ok()
    }

    fn is_file_system(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_read_past_the_end_says_how_much_there_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("short");
        fs::write(&path, b"abc").unwrap();
        let file = LocalDisk.open(&path).unwrap();
        let mut buffer = [0; 4];
        let message = file.read_exact_at(1, &mut buffer).unwrap_err().to_string();
        assert!(message.contains("has 3 bytes") && message.contains("4 bytes are needed from offset 1"), "{message}");
    }

    #[test]
    fn a_directory_is_not_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let message = LocalDisk.open(folder.path()).unwrap_err().to_string();
        assert!(message.contains("is a directory"), "{message}");
    }

    #[test]
    fn an_overwritten_header_leaves_the_end_where_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let mut file = LocalDisk.create_new(&path).unwrap();
        file.append(b"....body").unwrap();
        file.write_at(0, b"head").unwrap();
        file.append(b"tail").unwrap();
        drop(file);
        assert_eq!(fs::read(&path).unwrap(), b"headbodytail");
    }
}
