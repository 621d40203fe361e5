//! All pages of a model, decoded, in one file that is mapped into memory: what the paper compares its own paging with
//! (section 4, Table 2, *Virt.*: "the same view-dependent rendering algorithm using virtual memory"). The operating
//! system then decides which pages are in RAM, and a frame that looks at one that is not waits for the disk.
//!
//! The file is for the machine that wrote it, beside the model and not in place of it. All words are in the machine's own
//! byte order, as they are in RAM:
//!
//! ```text
//! bytes   what
//! 64      header: "VDTPAGES"; version (1); number of pages; length of the model file, low and high word; checksum of its
//!         header; checksum of the table; length of this file, low and high word; five zeros; checksum of the header
//! 16 p    table, an entry for each page, by number: offset in this file, low and high word; words; checksum
//!         zeros up to a multiple of 64
//! ...     the pages by number, each as `page` says, followed by zeros up to a multiple of 64
//! ```
//!
//! Checksums are CRC-32 of what they are for, that of the header of its first 60 bytes.
//!
//! Whoever opens a file has it read once from front to back, by ordinary reads: every checksum is looked at, and every page
//! checked as those of a model are ([`Page::check`]). What is looked at through the mapping afterwards is trusted to be
//! that; nobody may write to the file meanwhile.
//!
//! RAM: 16 bytes for each page while the file is written or opened, and what a [`PageChain`] takes while it is written;
//! afterwards nothing but what the system keeps in its cache.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use storage::{AtomicFile, Disk, MapAdvice, MappedFile, StorageError};
use thiserror::Error;

use crate::chain::PageChain;
use crate::header::ModelError;
use crate::model::{Model, PageReader};
use crate::page::{Page, PageLocation};
use crate::page_words::PageWords;
use crate::wedges::WedgeLayout;

/// The first bytes of such a file.
const MAGIC: [u8; 8] = *b"VDTPAGES";
const VERSION: u32 = 1;
/// Words of the header.
const HEADER_WORDS: usize = 16;
/// Bytes of the header.
const HEADER_BYTES: usize = HEADER_WORDS * 4;
/// Words of an entry of the table.
const ENTRY_WORDS: usize = 4;
/// Bytes of an entry of the table.
const ENTRY_BYTES: usize = ENTRY_WORDS * 4;
/// What the places of pages are multiples of: a line of the processor's cache.
const ALIGNMENT: u64 = 64;

/// What can be wrong with a file of decoded pages.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DecodedFileError {
    /// The disk failed, or the file is too short.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The model itself cannot be read.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The file is something else.
    #[error("{}: this is no file of decoded pages, or one of another version or byte order", path.display())]
    Foreign {
        /// The file in question.
        path: PathBuf,
    },
    /// The file belongs to another model.
    #[error("{}: these are the decoded pages of another model than {}", path.display(), model.display())]
    OtherModel {
        /// The file in question.
        path: PathBuf,
        /// The model that they were to be of.
        model: PathBuf,
    },
    /// The bytes are not those that were written.
    #[error("{}: {part}: {problem}; the file is damaged, delete it and have it made again", path.display())]
    Damaged {
        /// The file in question.
        path: PathBuf,
        /// Which part: "header", "table", "page 7".
        part: String,
        /// What is wrong.
        problem: String,
    },
}

/// Where a page lies in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Place {
    offset: u64,
    words: u32,
    checksum: u32,
}

impl Place {
    fn to_words(self) -> [u32; ENTRY_WORDS] {
        [self.offset as u32, (self.offset >> 32) as u32, self.words, self.checksum]
    }

    fn from_words(words: [u32; ENTRY_WORDS]) -> Self {
        Place { offset: join(words[0], words[1]), words: words[2], checksum: words[3] }
    }

    /// Where it ends, with the zeros behind it.
    fn end(self) -> u64 {
        self.offset.saturating_add(u64::from(self.words) * 4).saturating_add(ALIGNMENT - 1) & !(ALIGNMENT - 1)
    }
}

fn join(low: u32, high: u32) -> u64 {
    u64::from(low) | u64::from(high) << 32
}

/// Where the first of so many pages lies.
fn pages_start(page_count: u32) -> u64 {
    (HEADER_BYTES as u64 + u64::from(page_count) * ENTRY_BYTES as u64).next_multiple_of(ALIGNMENT)
}

/// The header of the file for a model.
fn header_of(model: &Model, table_checksum: u32, length: u64) -> [u32; HEADER_WORDS] {
    let header = model.header();
    let magic: [u32; 2] = bytemuck::cast(MAGIC);
    let mut words = [0; HEADER_WORDS];
    words[..2].copy_from_slice(&magic);
    (words[2], words[3]) = (VERSION, header.page_count);
    (words[4], words[5]) = (header.file_length as u32, (header.file_length >> 32) as u32);
    (words[6], words[7]) = (crc32fast::hash(&header.to_bytes()), table_checksum);
    (words[8], words[9]) = (length as u32, (length >> 32) as u32);
    words[HEADER_WORDS - 1] = checksum_of(&words[..HEADER_WORDS - 1]);
    words
}

fn checksum_of(words: &[u32]) -> u32 {
    crc32fast::hash(bytemuck::cast_slice(words))
}

/// Writes all pages of a model, decoded, to a file; one that is there is replaced. `progress` is told the share done.
///
/// # Errors
///
/// Where a page cannot be read or decoded, or the file not be written.
pub fn write_decoded(
    disk: Arc<dyn Disk>,
    path: &Path,
    model: &Model,
    progress: &mut dyn FnMut(f64),
) -> Result<(), DecodedFileError> {
    let mut places = places_of(model)?;
    let length = places.last().map_or(pages_start(0), |place| place.end());
    let mut file = AtomicFile::create(disk, path)?;
    file.set_length(length)?;
    // A page is decoded below its ancestors, so parents come first here, and places out of order.
    let mut chain = PageChain::new(model);
    let mut waiting: Vec<(PageLocation, Option<u32>)> =
        model.root_pages().iter().rev().map(|page| (*page, None)).collect();
    let mut done = 0;
    while let Some((location, parent)) = waiting.pop() {
        let page = chain.page(location, parent)?;
        // A page that could be read has a number below the count, and its counts are those of its head.
        let place = &mut places[location.number as usize];
        place.checksum = checksum_of(page.words());
        file.write_at(place.offset, bytemuck::cast_slice(page.words()))?;
        let first = waiting.len();
        waiting.extend(page.children().map(|child| (child, Some(location.number))));
        waiting[first..].reverse();
        done += 1;
        progress(f64::from(done) / places.len() as f64);
    }
    let table: Vec<u32> = places.iter().flat_map(|place| place.to_words()).collect();
    file.write_at(HEADER_BYTES as u64, bytemuck::cast_slice(&table))?;
    file.write_at(0, bytemuck::cast_slice(&header_of(model, checksum_of(&table), length)))?;
    Ok(file.commit()?)
}

/// Where each page will lie: their heads tell what they take decoded.
fn places_of(model: &Model) -> Result<Vec<Place>, ModelError> {
    let header = model.header();
    let layout = layout_of(model);
    let mut places = Vec::with_capacity(header.page_count as usize);
    let mut reader = PageReader::default();
    let (mut offset, mut next) = (pages_start(header.page_count), header.pages_offset);
    for number in 0..header.page_count {
        let (location, head) = model.read_head(number, next, &mut reader)?;
        next += u64::from(location.length);
        // No page takes as much as 4 GiB: it has a place holder.
        let place = Place { offset, words: head.counts(layout).words() as u32, checksum: 0 };
        offset = place.end();
        places.push(place);
    }
    Ok(places)
}

fn layout_of(model: &Model) -> WedgeLayout {
    model.appearance().map_or(WedgeLayout::default(), |appearance| appearance.layout)
}

/// The decoded pages of a model, mapped into memory.
#[derive(Debug)]
pub struct DecodedFile {
    file: Arc<MappedFile>,
    page_count: u32,
    layout: WedgeLayout,
}

impl DecodedFile {
    /// Reads a file from front to back and checks that all of it is what was written for this model; then has the system
    /// forget what it has of it in its cache, and maps it.
    ///
    /// # Errors
    ///
    /// Where the file cannot be read or mapped, belongs to another model, or is damaged.
    pub fn open(disk: &dyn Disk, path: &Path, model: &Model) -> Result<Self, DecodedFileError> {
        let layout = layout_of(model);
        check_file(disk, path, model, layout)?;
        storage::mapped_file::forget_cached(path)?;
        let file = disk.map(path)?;
        Ok(DecodedFile { file: Arc::new(file), page_count: model.header().page_count, layout })
    }

    /// Tells the system how the pages will be looked at.
    pub fn advise(&self, advice: MapAdvice) -> Result<(), StorageError> {
        self.file.advise(advice)
    }

    /// Number of pages.
    pub fn page_count(&self) -> u32 {
        self.page_count
    }

    /// Bytes of the file: of all pages, decoded, and the table of them.
    pub fn bytes(&self) -> u64 {
        self.file.bytes().len() as u64
    }

    /// The page with this number, which stays where it is in the file; `None` where there is none.
    pub fn page(&self, number: u32) -> Option<Page> {
        let entry = HEADER_BYTES + number as usize * ENTRY_BYTES;
        let bytes = self.file.bytes().get(entry..entry + ENTRY_BYTES).filter(|_| number < self.page_count)?;
        let words: &[u32] = bytemuck::try_cast_slice(bytes).ok()?;
        let Place { offset, words, .. } = Place::from_words(*words.first_chunk()?);
        let offset = usize::try_from(offset).ok()?;
        let words = PageWords::mapped(&self.file, offset..offset.checked_add(words as usize * 4)?)?;
        Page::of_words(words, self.layout).ok()
    }
}

/// Checks everything in a file of decoded pages.
fn check_file(disk: &dyn Disk, path: &Path, model: &Model, layout: WedgeLayout) -> Result<(), DecodedFileError> {
    let damaged =
        |part: &str, problem: String| DecodedFileError::Damaged { path: path.into(), part: part.into(), problem };
    let file = disk.open(path)?;
    if file.length() < HEADER_BYTES as u64 {
        return Err(DecodedFileError::Foreign { path: path.into() });
    }
    let mut header = [0_u32; HEADER_WORDS];
    file.read_exact_at(0, bytemuck::cast_slice_mut(&mut header))?;
    let expected = header_of(model, header[7], join(header[8], header[9]));
    if header[..3] != expected[..3] {
        return Err(DecodedFileError::Foreign { path: path.into() });
    }
    if header[HEADER_WORDS - 1] != checksum_of(&header[..HEADER_WORDS - 1]) {
        return Err(damaged("header", "the checksum does not match".into()));
    }
    if header != expected {
        return Err(DecodedFileError::OtherModel { path: path.into(), model: model.path().into() });
    }
    let length = join(header[8], header[9]);
    if file.length() != length {
        let problem = format!("it says {length} bytes, the file has {}", file.length());
        return Err(damaged("header", problem));
    }
    let model_header = model.header();
    // The model has so many pages, so this is no more than what belongs to it.
    let mut table = vec![0_u32; model_header.page_count as usize * ENTRY_WORDS];
    file.read_exact_at(HEADER_BYTES as u64, bytemuck::cast_slice_mut(&mut table))?;
    if checksum_of(&table) != header[7] {
        return Err(damaged("table", "the checksum does not match".into()));
    }
    let mut next = pages_start(model_header.page_count);
    for (number, entry) in table.as_chunks::<ENTRY_WORDS>().0.iter().enumerate() {
        let wrong = |problem: String| damaged(&format!("page {number}"), problem);
        let place = Place::from_words(*entry);
        let bytes = u64::from(place.words) * 4;
        if place.offset != next || place.end() > length || bytes > model_header.slot_bytes.into() {
            return Err(wrong(format!("{bytes} bytes at byte {} are not where they must be", place.offset)));
        }
        next = place.end();
        let mut words = vec![0; place.words as usize];
        file.read_exact_at(place.offset, bytemuck::cast_slice_mut(&mut words))?;
        if checksum_of(&words) != place.checksum {
            return Err(wrong("the checksum does not match".into()));
        }
        let page = Page::of_words(PageWords::own(words), layout).map_err(|error| wrong(error.to_string()))?;
        page.check(model_header.leaf_count).map_err(|error| wrong(error.to_string()))?;
        if page.number() as usize != number {
            return Err(wrong(format!("this is page {}", page.number())));
        }
        if page.children().any(|child| child.number >= model_header.page_count) {
            return Err(wrong(format!("it has children beyond page {}", model_header.page_count)));
        }
    }
    if next != length {
        return Err(damaged("table", format!("the pages end at byte {next} of {length}")));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use storage::LocalDisk;

    use super::*;
    use crate::header::Blocking;
    use crate::testing::{Shape, TreePlan, model, random_tree};
    use crate::wedge_tests;

    fn some_model(seed: u64, blocking: Blocking) -> Model {
        let plan =
            TreePlan { seed, leaves: 3000, components: 40, triangles: 5000, shape: Shape::Random, hub: 0, reach: 60 };
        model(&random_tree(&plan), blocking)
    }

    const SMALL: Blocking = Blocking::Forest { slot_bytes: 4096, fan_out: 3 };

    fn pages_of(model: &Model) -> HashMap<u32, Page> {
        let mut chain = PageChain::new(model);
        let mut waiting: Vec<_> = model.root_pages().iter().map(|page| (*page, None)).collect();
        let mut pages = HashMap::new();
        while let Some((location, parent)) = waiting.pop() {
            let page = chain.page(location, parent).unwrap().clone();
            waiting.extend(page.children().map(|child| (child, Some(location.number))));
            pages.insert(location.number, page);
        }
        pages
    }

    #[test]
    fn every_page_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pages");
        let models = [some_model(1, SMALL), some_model(2, Blocking::Levels { levels: 3 })];
        // With and without seams, and with all kinds of attributes.
        for model in models.into_iter().chain((0..20).map(wedge_tests::some_model)) {
            let mut last = 0.0;
            write_decoded(Arc::new(LocalDisk), &path, &model, &mut |share| last = share).unwrap();
            assert_eq!(last, 1.0);
            let decoded = DecodedFile::open(&LocalDisk, &path, &model).unwrap();
            let pages = pages_of(&model);
            assert_eq!(pages.len(), decoded.page_count() as usize);
            for advice in MapAdvice::ALL {
                decoded.advise(advice).unwrap();
                for (number, page) in &pages {
                    let found = decoded.page(*number).unwrap();
                    assert_eq!((found.words(), found.counts()), (page.words(), page.counts()));
                }
            }
            assert!(decoded.page(decoded.page_count()).is_none() && decoded.page(u32::MAX).is_none());
            assert_eq!(decoded.bytes(), std::fs::metadata(&path).unwrap().len());
        }
    }

    #[test]
    fn what_is_decoded_into_is_no_view_any_more() {
        let folder = tempfile::tempdir().unwrap();
        let (path, model) = (folder.path().join("pages"), some_model(1, SMALL));
        write_decoded(Arc::new(LocalDisk), &path, &model, &mut |_| ()).unwrap();
        let decoded = DecodedFile::open(&LocalDisk, &path, &model).unwrap();
        let mut page = decoded.page(0).unwrap();
        page.clear();
        assert_eq!(page.counts().records, 0);
        assert!(decoded.page(0).unwrap().counts().records > 0);
    }

    #[test]
    fn what_is_damaged_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (path, model) = (folder.path().join("pages"), some_model(1, SMALL));
        write_decoded(Arc::new(LocalDisk), &path, &model, &mut |_| ()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let refused = |bytes: &[u8], says: &str| {
            std::fs::write(&path, bytes).unwrap();
            let message = DecodedFile::open(&LocalDisk, &path, &model).unwrap_err().to_string();
            assert!(message.contains("pages") && message.contains(says), "{message}");
        };
        let start = pages_start(model.header().page_count) as usize;
        let changed = |place: usize| {
            let mut bytes = bytes.clone();
            bytes[place] ^= 4;
            bytes
        };
        refused(&bytes[..10], "no file of decoded pages");
        refused(&changed(0), "no file of decoded pages");
        refused(&changed(8), "no file of decoded pages");
        refused(&changed(13), "header: the checksum does not match");
        refused(&changed(62), "header: the checksum does not match");
        refused(&changed(HEADER_BYTES + 5), "table: the checksum does not match");
        refused(&changed(start + 40), "page 0: the checksum does not match");
        refused(&bytes[..bytes.len() - 1], "header: it says");
        let mut longer = bytes.clone();
        longer.push(0);
        refused(&longer, "header: it says");

        // With checksums that are right.
        let altered = |place: usize, word: u32| {
            let mut words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
            words[place] = word;
            let table = HEADER_WORDS..HEADER_WORDS + model.header().page_count as usize * ENTRY_WORDS;
            let first = words[start / 4..start / 4 + words[HEADER_WORDS + 2] as usize].to_vec();
            words[HEADER_WORDS + 3] = checksum_of(&first);
            words[7] = checksum_of(&words[table]);
            words[HEADER_WORDS - 1] = checksum_of(&words[..HEADER_WORDS - 1]);
            bytemuck::cast_slice::<u32, u8>(&words).to_vec()
        };
        refused(&altered(HEADER_WORDS, start as u32 + 64), "page 0: ");
        refused(&altered(HEADER_WORDS + 2, 11), "page 0: the page holds 11 words, its counts ask for ");
        refused(&altered(start / 4, 7), "page 0: ");
        refused(&altered(start / 4 + 4, 1 << 30), "page 0: the page holds ");
        refused(&altered(start / 4 + 5, model.header().page_count), "page 0: it has children beyond");
        refused(&altered(6, 0), "of another model than model.vdt");
        std::fs::write(&path, &bytes).unwrap();
        DecodedFile::open(&LocalDisk, &path, &model).unwrap();
        let message = DecodedFile::open(&LocalDisk, &path, &some_model(2, SMALL)).unwrap_err().to_string();
        assert!(message.contains("of another model than model.vdt"), "{message}");
    }
}
