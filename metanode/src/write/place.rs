//! The coded pages in their places: numbered breadth-first, one behind the other, each with the places of its child pages.
//!
//! Pages lie in the file by level, and within a level by their first leaf. So the children of all pages, one page after the
//! other, are the pages behind the root pages in order: two readers of the same list, one of them ahead, tell of every page
//! where its children are, and a third one behind who its parent is.
//!
//! Memory: buffers; for each tree 100 bytes, for each root page 16. I/O: what is coded is read once more, and written in the file.

use storage::{AtomicFile, Spool, SpoolReader, SpoolWriter, StorageError};

use super::count::RootPlace;
use super::encode::{Coded, CodedPage};
use super::{WriteError, WriteResources};
use crate::codec::Head;
use crate::page::{NONE_32, PageLocation};

/// Bytes of a reader's buffer.
const BUFFER: usize = 64 << 10;

impl CodedPage {
    /// Bytes that it takes in the file.
    pub fn bytes(&self) -> u32 {
        Head::bytes_around(self.children.into()) as u32 + self.length
    }
}

/// Where everything lies.
#[derive(Debug)]
pub(super) struct Places {
    pub pages: Spool<CodedPage>,
    /// For each tree, where its root is.
    pub roots: Vec<(PageLocation, u16)>,
    pub root_pages: Vec<PageLocation>,
    /// For each level its first page.
    pub levels_start: Vec<u32>,
    /// Bytes of all pages, and of the largest one.
    pub bytes: u64,
    pub largest: u32,
}

impl Places {
    /// Of the pages in their order. Offsets are counted from the first page. `roots` are by page.
    pub fn of(
        coded: &mut Coded,
        trees: usize,
        roots: &[RootPlace],
        resources: &WriteResources,
    ) -> Result<Self, StorageError> {
        let mut pages = SpoolWriter::new(&resources.scratch, "pages", resources.share(1));
        let nowhere = PageLocation { number: 0, offset: 0, length: 0 };
        let mut places = Places {
            pages: Spool::from_vec(Vec::new()),
            roots: vec![(nowhere, 0); trees],
            root_pages: Vec::new(),
            levels_start: Vec::new(),
            bytes: 0,
            largest: 0,
        };
        let mut roots = roots.iter().peekable();
        let mut number = 0;
        while let Some(page) = coded.pages.next()? {
            let location = PageLocation { number, offset: places.bytes, length: page.bytes() };
            if page.level as usize > places.levels_start.len() {
                places.levels_start.push(number);
            }
            if page.level == 1 {
                places.root_pages.push(location);
            }
            while let Some(root) = roots.next_if(|root| root.page == (page.level, page.first_leaf)) {
                places.roots[root.tree as usize] = (location, root.record);
            }
            places.bytes += u64::from(location.length);
            places.largest = places.largest.max(location.length);
            number += 1;
            pages.push(page)?;
        }
        places.pages = pages.finish()?;
        Ok(places)
    }

    /// From now on offsets are counted from the beginning of the file, `pages_offset` before the first page.
    pub fn move_by(&mut self, pages_offset: u64) {
        self.root_pages.iter_mut().for_each(|location| location.offset += pages_offset);
        self.roots.iter_mut().for_each(|(location, _)| location.offset += pages_offset);
    }
}

/// The pages in order, with their numbers and places.
struct Cursor<'a> {
    pages: SpoolReader<'a, CodedPage>,
    number: u32,
    offset: u64,
}

impl<'a> Cursor<'a> {
    fn new(pages: &'a Spool<CodedPage>, offset: u64) -> Self {
        Cursor { pages: pages.reader(BUFFER), number: 0, offset }
    }

    fn next(&mut self) -> Result<Option<(PageLocation, CodedPage)>, StorageError> {
        let Some(page) = self.pages.next()? else { return Ok(None) };
        let location = PageLocation { number: self.number, offset: self.offset, length: page.bytes() };
        self.number += 1;
        self.offset += u64::from(location.length);
        Ok(Some((location, page)))
    }
}

/// Bytes that are written at once.
const WRITTEN_AT_ONCE: usize = 256 << 10;

/// A file that is as long as it will be, written from front to back.
pub(super) struct Front<'a> {
    file: &'a mut AtomicFile,
    offset: u64,
    waiting: Vec<u8>,
}

impl<'a> Front<'a> {
    /// Of a file, from its first byte on.
    pub fn of(file: &'a mut AtomicFile) -> Self {
        Front { file, offset: 0, waiting: Vec::with_capacity(WRITTEN_AT_ONCE) }
    }

    /// Writes behind what was written.
    pub fn push(&mut self, bytes: &[u8]) -> Result<(), StorageError> {
        if self.waiting.len() + bytes.len() > WRITTEN_AT_ONCE {
            self.flush()?;
        }
        self.waiting.extend_from_slice(bytes);
        Ok(())
    }

    /// Writes what waits.
    pub fn flush(&mut self) -> Result<(), StorageError> {
        self.file.write_at(self.offset, &self.waiting)?;
        self.offset += self.waiting.len() as u64;
        self.waiting.clear();
        Ok(())
    }
}

/// Writes all pages, the first of which is at `offset`.
pub(super) fn write_pages(
    file: &mut Front<'_>,
    offset: u64,
    places: &Places,
    fields: &[Spool<u8>],
    progress: &impl Fn(u64),
) -> Result<(), WriteError> {
    let mut here = Cursor::new(&places.pages, offset);
    let mut children = Cursor::new(&places.pages, offset);
    for _ in &places.root_pages {
        children.next()?;
    }
    // Whose child the page at hand is, and how many more it has.
    let mut parents = Cursor::new(&places.pages, offset);
    let (mut parent, mut siblings) = (NONE_32, 0);
    let mut bytes = Vec::new();
    while let Some((location, page)) = here.next()? {
        if location.number as usize >= places.root_pages.len() {
            while siblings == 0 {
                let Some((location, page)) = parents.next()? else { break };
                (parent, siblings) = (location.number, page.children);
            }
            siblings = siblings.saturating_sub(1);
        }
        let mut head = Head {
            number: location.number,
            parent,
            records: page.records,
            root_count: page.roots,
            more_wedges: page.more_wedges,
            triangles: page.triangles,
            ..Head::default()
        };
        for index in 0..page.children {
            let Some((location, child)) = children.next()? else { break };
            if index == 0 {
                (head.first_child, head.first_child_offset) = (location.number, location.offset);
            }
            head.children.push((location.length, child.entries));
        }
        bytes.resize(page.length as usize, 0);
        fields[page.thread as usize].read_at(page.offset, &mut bytes)?;
        file.push(&head.page(&bytes))?;
        progress(page.records.into());
    }
    Ok(())
}
