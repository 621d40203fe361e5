//! A model file open for reading: header and root table in RAM, pages on disk.
//!
//! RAM: 60 bytes for each root (component) and 16 for each root page; nothing else that grows with the model. Each page
//! is one positioned read. The file is shared by as many threads as like.

use std::path::Path;
use std::sync::Arc;

use storage::{Disk, ReadAt};

use crate::header::{HEADER_BYTES, Header, ModelError, ModelRoot, ROOT_PAGE_WORDS, ROOT_WORDS};
use crate::page::{Page, PageLocation};

/// A model file open for reading.
#[derive(Debug)]
pub struct Model {
    file: Arc<dyn ReadAt>,
    header: Header,
    roots: Vec<ModelRoot>,
    root_pages: Vec<PageLocation>,
}

impl Model {
    /// Opens a model file, and checks its header, its root tables and its length.
    pub fn open(disk: &dyn Disk, path: &Path) -> Result<Self, ModelError> {
        let file = disk.open(path)?;
        let mut start = vec![0; HEADER_BYTES.min(usize::try_from(file.length()).unwrap_or(HEADER_BYTES))];
        file.read_exact_at(0, &mut start)?;
        let header = Header::from_bytes(path, &start)?;
        if header.file_length != file.length() {
            let problem = format!(
                "the header says {} bytes, the file has {}: it was cut or something was appended",
                header.file_length,
                file.length()
            );
            return Err(ModelError::Damaged { path: path.into(), part: "file".into(), problem });
        }
        let (roots, root_pages) = read_tables(file.as_ref(), &header)?;
        Ok(Model { file, header, roots, root_pages })
    }

    /// The path under which the file was opened.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// What the header says.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The roots of the forest, by ascending first leaf; their intervals partition the leaves.
    pub fn roots(&self) -> &[ModelRoot] {
        &self.roots
    }

    /// The meta-nodes without a parent.
    pub fn root_pages(&self) -> &[PageLocation] {
        &self.root_pages
    }

    /// Bytes of RAM that this holds.
    pub fn resident_bytes(&self) -> usize {
        size_of::<Self>()
            + self.roots.capacity() * size_of::<ModelRoot>()
            + self.root_pages.capacity() * size_of::<PageLocation>()
    }

    /// A page with room for any page of this model, empty.
    pub fn empty_page(&self) -> Page {
        Page::with_slot_bytes(self.header.slot_bytes as usize)
    }

    /// The indices of the roots, by the page that their splits are in.
    pub(crate) fn roots_by_page(&self) -> Vec<u32> {
        let mut indices: Vec<u32> = (0..self.roots.len() as u32).collect();
        indices.sort_by_key(|index| self.roots[*index as usize].page.number);
        indices
    }

    /// Of the indices that [`Model::roots_by_page`] gave, those of the roots in page `number`.
    pub(crate) fn roots_in_page<'a>(&self, by_page: &'a [u32], number: u32) -> &'a [u32] {
        let first = by_page.partition_point(|index| self.roots[*index as usize].page.number < number);
        let count = by_page[first..].partition_point(|index| self.roots[*index as usize].page.number == number);
        &by_page[first..first + count]
    }

    /// Fills `buffer` from byte `offset` of the file on.
    pub(crate) fn read_bytes(&self, offset: u64, buffer: &mut [u8]) -> Result<(), ModelError> {
        Ok(self.file.read_exact_at(offset, buffer)?)
    }

    /// The error that says that meta-node `number` is not as it must be.
    pub(crate) fn damaged_page(&self, number: u32, problem: impl Into<String>) -> ModelError {
        ModelError::Damaged { path: self.path().into(), part: format!("meta-node {number}"), problem: problem.into() }
    }

    /// Reads and decodes the page at `location` into `page`. `staging` is scratch space for the encoded bytes; it grows
    /// to the largest encoded page of the model and no further.
    pub fn read_page(&self, location: PageLocation, staging: &mut Vec<u8>, page: &mut Page) -> Result<(), ModelError> {
        let end = location.offset.saturating_add(location.length.into());
        let inside = location.offset >= self.header.pages_offset && end <= self.header.file_length;
        if !inside || location.length > self.header.largest_page_bytes || location.number >= self.header.page_count {
            let problem = format!(
                "a reference to {} bytes at byte {} leads out of the pages of this file",
                location.length, location.offset
            );
            return Err(self.damaged_page(location.number, problem));
        }
        staging.resize(location.length as usize, 0);
        self.file.read_exact_at(location.offset, staging)?;
        page.decode(staging, location, self.header.leaf_count).map_err(|source| ModelError::Page {
            path: self.path().into(),
            location,
            source,
        })
    }
}

fn read_tables(file: &dyn ReadAt, header: &Header) -> Result<(Vec<ModelRoot>, Vec<PageLocation>), ModelError> {
    let damaged =
        |part: String, problem: &str| ModelError::Damaged { path: file.path().into(), part, problem: problem.into() };
    // The header's check makes sure that the tables lie inside the file, so this cannot be larger than the file is.
    let mut bytes = vec![0; (header.pages_offset - header.roots_offset) as usize];
    file.read_exact_at(header.roots_offset, &mut bytes)?;
    let (body, checksum) = bytes.split_at(bytes.len() - 4);
    if crc32fast::hash(body).to_le_bytes() != *checksum {
        return Err(damaged("root table".into(), "the checksum does not match"));
    }
    let words: Vec<u32> = body.as_chunks::<4>().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
    let (root_words, page_words) = words.split_at(header.root_count as usize * ROOT_WORDS);

    let mut roots = Vec::with_capacity(header.root_count as usize);
    let mut next_leaf = 0;
    for (index, words) in root_words.as_chunks::<ROOT_WORDS>().0.iter().enumerate() {
        let root = ModelRoot::from_words(words).filter(|root| root.start == next_leaf);
        let root = root.ok_or_else(|| damaged(format!("root {index}"), "a field holds what it cannot hold"))?;
        next_leaf = root.end;
        roots.push(root);
    }
    if next_leaf != header.leaf_count {
        return Err(damaged("root table".into(), "the roots do not hold all leaves"));
    }
    let mut root_pages = Vec::with_capacity(header.root_page_count as usize);
    let mut next_offset = header.pages_offset;
    for (index, words) in page_words.as_chunks::<ROOT_PAGE_WORDS>().0.iter().enumerate() {
        let offset = u64::from(words[1]) | u64::from(words[2]) << 32;
        // Root pages come first in the file, one behind the other.
        if words[0] as usize != index || offset != next_offset {
            return Err(damaged(format!("root page {index}"), "it does not follow the one before"));
        }
        next_offset += u64::from(words[3]);
        root_pages.push(PageLocation { number: words[0], offset, length: words[3] });
    }
    Ok((roots, root_pages))
}
