//! An array of numbers on disk, of which the pages in use are in RAM.
//!
//! For accesses with locality; each one that misses costs a page read. Pages are let go by second chance: a hand goes
//! round the frames, and takes the first whose page was not used since it last came by. Where everything fits there are
//! no pages, only the array.
//!
//! Memory: the bytes given, and 5 for each page of 16 KiB, whether it is in RAM or not. I/O: a page read for each miss of
//! a page that was written before, and a page written where the one that goes was changed.
//!
//! Measured: 1 to 2 ns for an access where everything fits, 4 ns where the page is in RAM.

use crate::disk::{Block, StorageError};
use crate::scratch::{Scratch, TemporaryFile};

/// Blocks of a page.
const PAGE_BLOCKS: usize = 4;
/// Numbers in a page.
const PAGE_VALUES: usize = PAGE_BLOCKS * Block::BYTES / size_of::<u32>();
/// Stands for a page that is not in RAM, and for a frame without a page.
const NONE: u32 = u32::MAX;

/// An array of `u32`.
#[derive(Debug)]
pub struct PagedArray {
    name: String,
    count: u64,
    content: Content,
}

#[derive(Debug)]
enum Content {
    Ram(Vec<u32>),
    Pages(Pages),
}

#[derive(Debug)]
struct Pages {
    file: TemporaryFile,
    fill: u32,
    /// For each page its frame, and whether it is on disk (else all of it is `fill`).
    frames_of: Vec<u32>,
    is_written: Vec<bool>,
    frames: Vec<Frame>,
    blocks: Vec<Block>,
    hand: usize,
}

#[derive(Debug, Clone, Copy)]
struct Frame {
    page: u32,
    is_used: bool,
    is_changed: bool,
}

impl PagedArray {
    /// An array of `count` times `fill`, that holds at most `ram_bytes` in RAM, and 5 bytes for each page of 16 KiB.
    pub fn new(scratch: &Scratch, name: &str, count: u64, fill: u32, ram_bytes: usize) -> Result<Self, StorageError> {
        let array = |content| Ok(PagedArray { name: name.to_owned(), count, content });
        if !scratch.has_disk() || count * 4 <= ram_bytes as u64 {
            return array(Content::Ram(vec![fill; count as usize]));
        }
        let pages = count.div_ceil(PAGE_VALUES as u64) as usize;
        let frames = (ram_bytes / (PAGE_BLOCKS * Block::BYTES)).max(2);
        array(Content::Pages(Pages {
            file: scratch.create(name)?,
            fill,
            frames_of: vec![NONE; pages],
            is_written: vec![false; pages],
            frames: vec![Frame { page: NONE, is_used: false, is_changed: false }; frames],
            blocks: vec![Block::ZERO; frames * PAGE_BLOCKS],
            hand: 0,
        }))
    }

    /// The value at an index below the count.
    ///
    /// # Errors
    ///
    /// Those of the disk; [`StorageError::NoSuchPlace`] where the index is not below the count.
    #[inline]
    pub fn get(&mut self, index: u32) -> Result<u32, StorageError> {
        self.check(index)?;
        match &mut self.content {
            Content::Ram(values) => Ok(values[index as usize]),
            Content::Pages(pages) => {
                let place = pages.place(index, false)?;
                Ok(bytemuck::cast_slice(&pages.blocks)[place])
            }
        }
    }

    /// Sets the value at an index below the count.
    ///
    /// # Errors
    ///
    /// As of [`PagedArray::get`].
    #[inline]
    pub fn set(&mut self, index: u32, value: u32) -> Result<(), StorageError> {
        self.check(index)?;
        match &mut self.content {
            Content::Ram(values) => values[index as usize] = value,
            Content::Pages(pages) => {
                let place = pages.place(index, true)?;
                bytemuck::cast_slice_mut(&mut pages.blocks)[place] = value;
            }
        }
        Ok(())
    }

    #[inline]
    fn check(&self, index: u32) -> Result<(), StorageError> {
        if u64::from(index) < self.count { Ok(()) } else { Err(self.no_such_place(index)) }
    }

    #[cold]
    fn no_such_place(&self, index: u32) -> StorageError {
        StorageError::NoSuchPlace { name: self.name.clone(), count: self.count, index: index.into() }
    }
}

impl Pages {
    /// Where in the frames a value is.
    #[inline]
    fn place(&mut self, index: u32, is_changed: bool) -> Result<usize, StorageError> {
        let page = index as usize / PAGE_VALUES;
        let mut frame = self.frames_of[page];
        if frame == NONE {
            frame = self.load(page)?;
        }
        let state = &mut self.frames[frame as usize];
        state.is_used = true;
        state.is_changed |= is_changed;
        Ok(frame as usize * PAGE_VALUES + index as usize % PAGE_VALUES)
    }

    #[cold]
    fn load(&mut self, page: usize) -> Result<u32, StorageError> {
        loop {
            self.hand = (self.hand + 1) % self.frames.len();
            let frame = &mut self.frames[self.hand];
            if !std::mem::replace(&mut frame.is_used, false) {
                break;
            }
        }
        let Frame { page: old, is_changed, .. } = self.frames[self.hand];
        let blocks = self.hand * PAGE_BLOCKS..(self.hand + 1) * PAGE_BLOCKS;
        if old != NONE {
            self.frames_of[old as usize] = NONE;
            if is_changed {
                self.file.write(u64::from(old) * PAGE_BLOCKS as u64, &self.blocks[blocks.clone()])?;
                self.is_written[old as usize] = true;
            }
        }
        self.frames[self.hand].page = NONE;
        if self.is_written[page] {
            self.file.read((page * PAGE_BLOCKS) as u64, &mut self.blocks[blocks])?;
        } else {
            bytemuck::cast_slice_mut::<Block, u32>(&mut self.blocks[blocks]).fill(self.fill);
        }
        self.frames[self.hand] = Frame { page: page as u32, is_used: false, is_changed: false };
        self.frames_of[page] = self.hand as u32;
        Ok(self.hand as u32)
    }
}
