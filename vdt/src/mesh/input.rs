//! A file read from front to back through one window of RAM.
//!
//! [`storage::SequentialReader`] hands out whatever its buffer happens to hold. A parser wants more: that the next
//! few bytes lie together, even where they straddle two reads. [`Input::peek`] promises that, without a copy in the
//! usual case and without an allocation in any.
//!
//! Memory: one window, of 256 KiB unless told otherwise. Every byte that is not skipped is read once.

use std::path::Path;
use std::sync::Arc;

use storage::{Disk, ReadAt, StorageError};

const WINDOW_BYTES: usize = 256 * 1024;

/// A cursor over a file, with a window of bytes ahead of it.
#[derive(Debug)]
pub(super) struct Input {
    file: Arc<dyn ReadAt>,
    window: Vec<u8>,
    start: usize,
    end: usize,
    /// Offset in the file of the byte after the window's last one.
    next_offset: u64,
    at_end: bool,
}

impl Input {
    /// Opens `path`, at byte 0.
    pub fn open(disk: &dyn Disk, path: &Path) -> Result<Self, StorageError> {
        Ok(Self::starting_at(disk.open(path)?, 0, WINDOW_BYTES as u64))
    }

    /// Starts at byte `offset` of an open file, of which `wanted` bytes are going to be read: no point in a window
    /// that is larger.
    pub fn starting_at(file: Arc<dyn ReadAt>, offset: u64, wanted: u64) -> Self {
        let size = usize::try_from(wanted).unwrap_or(WINDOW_BYTES).clamp(1, WINDOW_BYTES);
        Input { file, window: vec![0; size], start: 0, end: 0, next_offset: offset, at_end: false }
    }

    /// The path of the file, for messages.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Offset in the file of the next byte.
    pub fn position(&self) -> u64 {
        self.next_offset - (self.end - self.start) as u64
    }

    /// How many bytes the file still holds.
    pub fn remaining(&self) -> u64 {
        self.file.length().saturating_sub(self.position())
    }

    /// The bytes ahead: at least `count` of them (which is at most the window's size), or all that the file still
    /// has. Usually more.
    #[inline]
    pub fn peek(&mut self, count: usize) -> Result<&[u8], StorageError> {
        if self.end - self.start < count && !self.at_end {
            self.refill(count)?;
        }
        Ok(&self.window[self.start..self.end])
    }

    #[cold]
    fn refill(&mut self, count: usize) -> Result<(), StorageError> {
        self.window.copy_within(self.start..self.end, 0);
        self.end -= self.start;
        self.start = 0;
        while self.end < count.min(self.window.len()) {
            let read = self.file.read_at(self.next_offset, &mut self.window[self.end..])?;
            if read == 0 {
                self.at_end = true;
                break;
            }
            self.end += read;
            self.next_offset += read as u64;
        }
        Ok(())
    }

    /// Moves past `count` of the bytes that [`Input::peek`] showed.
    #[inline]
    pub fn consume(&mut self, count: usize) {
        self.start = (self.start + count).min(self.end);
    }

    /// The next `count` of the bytes that [`Input::peek`] showed, and moves past them.
    #[inline]
    pub fn take(&mut self, count: usize) -> &[u8] {
        let from = self.start;
        self.consume(count);
        &self.window[from..self.start]
    }

    /// Moves past `count` bytes, without reading those that lie beyond the window. False if the file holds fewer;
    /// then nothing was moved.
    #[inline]
    pub fn skip(&mut self, count: u64) -> bool {
        let buffered = self.end - self.start;
        if count <= buffered as u64 {
            self.start += count as usize;
            return true;
        }
        if count > self.remaining() {
            return false;
        }
        self.next_offset += count - buffered as u64;
        self.start = self.end;
        true
    }

    /// Whether the file ends here.
    pub fn is_at_end(&mut self) -> Result<bool, StorageError> {
        Ok(self.peek(1)?.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use storage::MemoryDisk;

    use super::*;

    fn input_of(bytes: Vec<u8>, window: u64) -> Input {
        let disk = MemoryDisk::new();
        disk.insert("file", bytes);
        Input::starting_at(disk.open(&PathBuf::from("file")).unwrap(), 0, window)
    }

    #[test]
    fn bytes_that_straddle_two_windows_lie_together() {
        let bytes: Vec<u8> = (0..100).collect();
        let mut input = input_of(bytes.clone(), 8);
        for chunk in bytes.chunks(3) {
            let seen = input.peek(chunk.len()).unwrap();
            assert!(seen.len() >= chunk.len() && seen.len() <= 8);
            assert_eq!(input.take(chunk.len()), chunk);
        }
        assert!(input.is_at_end().unwrap());
        assert_eq!(input.position(), 100);
    }

    #[test]
    fn skipping_goes_beyond_the_window_but_not_beyond_the_file() {
        let mut input = input_of((0..100).collect(), 8);
        assert_eq!(input.peek(1).unwrap()[0], 0);
        assert!(input.skip(50));
        assert_eq!((input.position(), input.peek(1).unwrap()[0]), (50, 50));
        assert!(!input.skip(51));
        assert!(!input.skip(u64::MAX));
        assert_eq!((input.position(), input.remaining()), (50, 50));
        assert!(input.skip(50));
        assert!(input.is_at_end().unwrap());
    }
}
