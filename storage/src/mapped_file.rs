//! A file mapped into memory: reading it is looking at it, and the operating system decides which of its pages are in
//! RAM. That is what the paper measures itself against as *virtual memory* (section 4).
//!
//! The system can be told how the file will be looked at ([`MapAdvice`]), and to forget what it has of it in its page
//! cache ([`forget_cached`]), so that a measurement begins where a fresh machine would.
//!
//! A disk that is full, fails, or has the file cut short by others while it is mapped ends the process with a signal
//! (SIGBUS) where a read would have given an error. So this is for experiments on files that this program made itself.
//!
//! RAM: as much as the system gives. No page of it is this process's own.

use std::fmt;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use memmap2::Mmap;
use thiserror::Error;

use crate::disk::StorageError;

/// How a mapped file will be looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MapAdvice {
    /// Nothing is said: the system reads some pages around each that is missing.
    #[default]
    Normal,
    /// Here and there: each page that is missing is read alone.
    Random,
    /// All of it, soon: the system reads ahead as much as it likes.
    WillNeed,
    /// All of it is read before it is looked at, and stays while there is room: how fast all would be in RAM.
    Populate,
}

impl MapAdvice {
    /// All of them.
    pub const ALL: [MapAdvice; 4] = [MapAdvice::Normal, MapAdvice::Random, MapAdvice::WillNeed, MapAdvice::Populate];

    /// As it is written on a command line.
    pub fn name(self) -> &'static str {
        match self {
            MapAdvice::Normal => "normal",
            MapAdvice::Random => "random",
            MapAdvice::WillNeed => "will-need",
            MapAdvice::Populate => "populate",
        }
    }
}

impl fmt::Display for MapAdvice {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(self.name())
    }
}

/// A text that is no advice.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("`{text}` is not one of normal, random, will-need and populate")]
pub struct ParseAdviceError {
    text: String,
}

impl FromStr for MapAdvice {
    type Err = ParseAdviceError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let found = MapAdvice::ALL.into_iter().find(|advice| advice.name() == text);
        found.ok_or_else(|| ParseAdviceError { text: text.to_owned() })
    }
}

/// A file mapped for reading.
#[derive(Debug)]
pub struct MappedFile {
    map: Mmap,
    path: PathBuf,
}

impl MappedFile {
    /// Maps a file whole. Nothing of it is read by that.
    pub(crate) fn open(path: &Path) -> Result<Self, StorageError> {
        let fail = |error| StorageError::io(path, "map", error);
        let file = File::open(path).map_err(fail)?;
        let metadata = file.metadata().map_err(fail)?;
        if metadata.is_dir() {
            return Err(StorageError::Directory { path: path.to_path_buf() });
        }
        if usize::try_from(metadata.len()).is_err() {
            let problem = io::Error::new(io::ErrorKind::FileTooLarge, "it does not fit into the address space");
            return Err(fail(problem));
        }
        Ok(MappedFile { map: map(&file).map_err(fail)?, path: path.to_path_buf() })
    }

    /// The path under which the file was opened, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its bytes. The first lies at an address that is a multiple of the system's page size.
    pub fn bytes(&self) -> &[u8] {
        &self.map
    }

    /// Tells the system how the file will be looked at. Where it takes no such advice, nothing happens.
    pub fn advise(&self, advice: MapAdvice) -> Result<(), StorageError> {
        #[cfg(unix)]
        {
            use memmap2::Advice;
            let advise = |advice| {
                self.map.advise(advice).map_err(|error| StorageError::io(&self.path, "advise the system on", error))
            };
            match advice {
                MapAdvice::Normal => advise(Advice::Normal)?,
                MapAdvice::Random => advise(Advice::Random)?,
                MapAdvice::WillNeed => advise(Advice::WillNeed)?,
                MapAdvice::Populate => {
                    let pages = self.bytes().iter().step_by(LEAST_PAGE_BYTES);
                    std::hint::black_box(pages.fold(0, |sum: u8, byte| sum.wrapping_add(*byte)));
                }
            }
        }
        #[cfg(not(unix))]
        let _ = advice;
        Ok(())
    }
}

/// No system has smaller pages.
#[cfg(unix)]
const LEAST_PAGE_BYTES: usize = 4096;

/// Maps a file.
fn map(file: &File) -> io::Result<Mmap> {
    // SAFETY: the bytes of a mapping must not change while there are references to them. This one is for reading only,
    // private to this process; and only files are mapped that this program has written whole under a name of their own, and
    // that it never writes to again (they are replaced by renaming). Another program that changes one meanwhile breaks that; the
    // module's documentation says so, and there is no way to keep it from it.
    unsafe { memmap2::MmapOptions::new().map(file) }
}

/// Has the system forget what it has of a file in its page cache, so that what is read next comes from the disk: whoever
/// reads it first pays for it, in time and in a memory cgroup. What another process has mapped stays. Where the system does not
/// know such a wish, nothing happens.
pub fn forget_cached(path: &Path) -> Result<(), StorageError> {
    #[cfg(target_os = "linux")]
    {
        let file = File::open(path).map_err(|error| StorageError::io(path, "open", error))?;
        // What is not written yet would stay.
        let forget = || {
            file.sync_all()?;
            Ok(rustix::fs::fadvise(&file, 0, None, rustix::fs::Advice::DontNeed)?)
        };
        forget().map_err(|error: io::Error| StorageError::io(path, "empty the page cache of", error))?;
    }
    #[cfg(not(target_os = "linux"))]
    let _ = path;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_what_it_was_written_as_under_any_advice() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let bytes: Vec<u8> = (0..100_000_u32).map(|number| (number % 251) as u8).collect();
        std::fs::write(&path, &bytes).unwrap();
        for advice in MapAdvice::ALL {
            assert_eq!(advice.to_string().parse(), Ok(advice));
            forget_cached(&path).unwrap();
            let mapped = MappedFile::open(&path).unwrap();
            mapped.advise(advice).unwrap();
            assert!(mapped.bytes() == bytes);
        }
        assert!("sequential".parse::<MapAdvice>().is_err());
    }

    #[test]
    fn what_is_no_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert!(MappedFile::open(folder.path()).unwrap_err().to_string().contains("is a directory"));
        let missing = folder.path().join("missing");
        assert!(MappedFile::open(&missing).unwrap_err().to_string().contains("cannot map"));
        assert!(forget_cached(&missing).is_err());
    }

    #[test]
    fn an_empty_file_has_no_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("empty");
        std::fs::write(&path, b"").unwrap();
        let mapped = MappedFile::open(&path).unwrap();
        mapped.advise(MapAdvice::Populate).unwrap();
        assert_eq!(mapped.bytes().len(), 0);
    }
}
