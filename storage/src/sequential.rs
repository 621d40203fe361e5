//! Buffered reading of a file from front to back, as a [`std::io::Read`] and [`std::io::BufRead`].
//!
//! Holds one buffer (256 KiB unless told otherwise), whatever the size of the file.

use std::io::{self, BufRead, Read};
use std::sync::Arc;

use crate::disk::ReadAt;

const BUFFER_BYTES: usize = 256 * 1024;

/// A cursor over a [`ReadAt`]. Errors are wrapped in [`io::Error`]; their text names the file.
#[derive(Debug)]
pub struct SequentialReader {
    file: Arc<dyn ReadAt>,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    next_offset: u64,
}

impl SequentialReader {
    /// Starts at byte 0.
    pub fn new(file: Arc<dyn ReadAt>) -> Self {
        Self::starting_at(file, 0)
    }

    /// Starts at byte `offset`.
    pub fn starting_at(file: Arc<dyn ReadAt>, offset: u64) -> Self {
        SequentialReader { file, buffer: vec![0; BUFFER_BYTES], start: 0, end: 0, next_offset: offset }
    }

    /// Offset in the file, in bytes, of the next byte that will be handed out.
    pub fn position(&self) -> u64 {
        self.next_offset - (self.end - self.start) as u64
    }

    /// The file being read.
    pub fn file(&self) -> &Arc<dyn ReadAt> {
        &self.file
    }
}

impl BufRead for SequentialReader {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.start == self.end {
            let count = self.file.read_at(self.next_offset, &mut self.buffer).map_err(io::Error::other)?;
            self.start = 0;
            self.end = count;
            self.next_offset += count as u64;
        }
        Ok(&self.buffer[self.start..self.end])
    }

    fn consume(&mut self, amount: usize) {
        self.start = (self.start + amount).min(self.end);
    }
}

impl Read for SequentialReader {
    fn read(&mut self, target: &mut [u8]) -> io::Result<usize> {
        let available = self.fill_buf()?;
        let count = available.len().min(target.len());
        target[..count].copy_from_slice(&available[..count]);
        self.consume(count);
        Ok(count)
    }
}
