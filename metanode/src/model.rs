//! A model file open for reading: header and root table in RAM, pages on disk.
//!
//! RAM: 60 bytes for each root (component), 16 for each root page and 24 for each page on the way to a tree that begins in
//! no root page; with attributes the appearance, in which are the wedges of each root; nothing else that grows with the model.
//! Each page is one positioned read, and is decoded with all its ancestors at hand. The file is shared by as many threads as
//! like.

use std::path::Path;
use std::sync::Arc;

use storage::{Disk, ReadAt, StorageError};
use vdt::tree::ImageSource;

use crate::appearance::{ModelAppearance, read_chunks};
use crate::codec::{self as coder, Context, FieldBits, Head, PageDecoder, Shape};
use crate::header::{HEADER_BYTES, Header, ModelError, ModelRoot, ROOT_PAGE_WORDS, ROOT_WORDS, WAY_WORDS, Way};
use crate::page::{Page, PageLocation};

/// A model file open for reading.
#[derive(Debug)]
pub struct Model {
    file: Arc<dyn ReadAt>,
    header: Header,
    roots: Vec<ModelRoot>,
    /// The indices of the roots, by the page that their splits are in, and there by record.
    roots_by_page: Vec<u32>,
    root_pages: Vec<PageLocation>,
    ways: Vec<Way>,
    shape: Shape,
    tables: coder::Tables,
    appearance: ModelAppearance,
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
        let Tables { roots, root_pages, ways } = Tables::read(file.as_ref(), &header)?;
        let (tables, numbers) = read_coder_tables(file.as_ref(), &header)?;
        let mut roots_by_page: Vec<u32> = (0..roots.len() as u32).collect();
        roots_by_page.sort_by_key(|index| {
            let root: &ModelRoot = &roots[*index as usize];
            (root.page.number, root.record)
        });
        let appearance = ModelAppearance::read(file.as_ref(), &header, &roots)?;
        let Header { exponent, lattice_step, .. } = header;
        let ModelAppearance { layout: wedges, texture_density, .. } = appearance;
        let shape = Shape { exponent, lattice_step, numbers, wedges, texture_density };
        Ok(Model { file, header, roots, roots_by_page, root_pages, ways, shape, tables, appearance })
    }

    /// The path under which the file was opened.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// What the header says.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// What it says of the wedges, if the model has attributes.
    pub fn appearance(&self) -> Option<&ModelAppearance> {
        (self.header.appearance_bytes > 0).then_some(&self.appearance)
    }

    /// Hands on the bytes of the image with this number in [`Appearance::images`], piece by piece. False where it is missing, or
    /// there is none.
    ///
    /// [`Appearance::images`]: vdt::tree::Appearance::images
    pub fn image<E: From<StorageError>>(
        &self,
        number: usize,
        action: impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<bool, E> {
        let image = self.appearance.appearance.images.get(number);
        let Some(ImageSource::Part { offset, length, .. }) = image.map(|image| &image.source) else { return Ok(false) };
        read_chunks(self.file.as_ref(), *offset, *length, action)?;
        Ok(true)
    }

    /// Checks the bytes of all images. RAM: 1 MiB.
    pub(crate) fn check_images(&self) -> Result<(), ModelError> {
        for (number, checksum) in self.appearance.image_checksums.iter().enumerate() {
            let mut hasher = crc32fast::Hasher::new();
            let is_there = self.image::<ModelError>(number, |chunk| {
                hasher.update(chunk);
                Ok(())
            })?;
            if is_there && hasher.finalize() != *checksum {
                let (part, problem) = (format!("image {number}"), "the checksum does not match".into());
                return Err(ModelError::Damaged { path: self.path().into(), part, problem });
            }
        }
        Ok(())
    }

    /// The roots of the forest, by ascending first leaf; their intervals partition the leaves.
    pub fn roots(&self) -> &[ModelRoot] {
        &self.roots
    }

    /// The meta-nodes without a parent.
    pub fn root_pages(&self) -> &[PageLocation] {
        &self.root_pages
    }

    /// The meta-nodes with a parent in which a tree begins, or that lead to one, by ascending number.
    pub fn ways(&self) -> &[Way] {
        &self.ways
    }

    /// The ancestors of a page in which a tree begins, from its root page down to its parent: none for a root page, nor
    /// for a page that is in no table.
    pub fn way_to(&self, page: u32) -> Vec<PageLocation> {
        let way_at =
            |page: u32| self.ways.binary_search_by_key(&page, |way| way.page.number).map(|way| &self.ways[way]);
        let mut way = Vec::new();
        let mut number = page;
        // Each parent has a smaller number, so this ends.
        while let Ok(Way { parent, .. }) = way_at(number) {
            number = *parent;
            way.extend(way_at(number).map(|way| way.page).ok().or(self.root_pages.get(number as usize).copied()));
        }
        way.reverse();
        way
    }

    /// How many contexts of the coder have probabilities of the file's own; all others have the built-in ones.
    pub fn own_contexts(&self) -> usize {
        self.tables.own_contexts()
    }

    /// The number of which most coordinates are fractions, where there is no lattice; 0 where there is none.
    pub fn denominator(&self) -> f32 {
        self.shape.numbers.denominator
    }

    /// Bytes of RAM that this holds.
    pub fn resident_bytes(&self) -> usize {
        size_of::<Self>()
            + self.roots.capacity() * (size_of::<ModelRoot>() + size_of::<u32>())
            + self.tables.ram_bytes()
            + self.header.appearance_bytes as usize
            + self.appearance.root_wedges.ram_bytes()
            + self.root_pages.capacity() * size_of::<PageLocation>()
            + self.ways.capacity() * size_of::<Way>()
    }

    /// A page with room for any page of this model, empty.
    pub fn empty_page(&self) -> Page {
        Page::with_slot_bytes(self.header.slot_bytes as usize)
    }

    /// The indices of the roots whose splits are in page `number`, by record.
    pub(crate) fn roots_in_page(&self, number: u32) -> &[u32] {
        let by_page = &self.roots_by_page;
        let first = by_page.partition_point(|index| self.roots[*index as usize].page.number < number);
        let count = by_page[first..].partition_point(|index| self.roots[*index as usize].page.number == number);
        &by_page[first..first + count]
    }

    /// The error that says that meta-node `number` is not as it must be.
    pub(crate) fn damaged_page(&self, number: u32, problem: impl Into<String>) -> ModelError {
        ModelError::Damaged { path: self.path().into(), part: format!("meta-node {number}"), problem: problem.into() }
    }

    /// Reads and decodes the page at `location` into `page`. `ancestors` are the decoded pages from a root page down to
    /// its parent, in that order; none for a root page. What fails leaves an empty page.
    pub fn read_page(
        &self,
        location: PageLocation,
        ancestors: &[&Page],
        reader: &mut PageReader,
        page: &mut Page,
    ) -> Result<(), ModelError> {
        page.clear();
        self.read_encoded(location, reader)?;
        let PageReader { encoded, decoder, .. } = reader;
        self.decode_with(location, encoded, ancestors, decoder, page)
    }

    /// Reads the encoded page at `location`: the first half of [`Model::read_page`].
    fn read_encoded(&self, location: PageLocation, reader: &mut PageReader) -> Result<(), ModelError> {
        self.check_location(location)?;
        reader.encoded.resize(location.length as usize, 0);
        Ok(self.file.read_exact_at(location.offset, &mut reader.encoded)?)
    }

    /// Whether a page can lie there.
    pub fn check_location(&self, location: PageLocation) -> Result<(), ModelError> {
        let end = location.offset.saturating_add(location.length.into());
        let inside = location.offset >= self.header.pages_offset && end <= self.header.file_length;
        if inside && location.length <= self.header.largest_page_bytes && location.number < self.header.page_count {
            return Ok(());
        }
        let problem = format!(
            "a reference to {} bytes at byte {} leads out of the pages of this file",
            location.length, location.offset
        );
        Err(self.damaged_page(location.number, problem))
    }

    /// Reads the bytes from `offset` on: one or more encoded pages, for [`Model::decode`], by those who do not hold on to the
    /// ancestors meanwhile.
    pub fn read_bytes(&self, offset: u64, bytes: &mut [u8]) -> Result<(), ModelError> {
        Ok(self.file.read_exact_at(offset, bytes)?)
    }

    /// Whether reads go past the system's page cache.
    pub fn is_direct(&self) -> bool {
        self.file.is_direct()
    }

    /// Reads page `number`, which lies at `offset`, and what stands in front of its coded fields. Its place is not known from
    /// its parent but from the page before it.
    pub(crate) fn read_head<'r>(
        &self,
        number: u32,
        offset: u64,
        reader: &'r mut PageReader,
    ) -> Result<(PageLocation, &'r Head), ModelError> {
        if offset.saturating_add(Head::START_BYTES as u64) > self.header.file_length {
            return Err(self.damaged_page(number, "the file ends before it"));
        }
        let mut start = [0; Head::START_BYTES];
        self.file.read_exact_at(offset, &mut start)?;
        let location = PageLocation { number, offset, length: Head::length(start) };
        self.read_encoded(location, reader)?;
        let PageReader { encoded, head, .. } = reader;
        let read = head.read(encoded);
        read.map_err(|source| ModelError::Page { path: self.path().into(), location, source })?;
        if head.number != number {
            return Err(self.damaged_page(number, format!("this is meta-node {}", head.number)));
        }
        Ok((location, head))
    }

    /// Decodes the encoded page that was read from `location`: the second half of [`Model::read_page`].
    pub fn decode(
        &self,
        location: PageLocation,
        encoded: &[u8],
        ancestors: &[&Page],
        reader: &mut PageReader,
        page: &mut Page,
    ) -> Result<(), ModelError> {
        self.decode_with(location, encoded, ancestors, &mut reader.decoder, page)
    }

    fn decode_with(
        &self,
        location: PageLocation,
        encoded: &[u8],
        ancestors: &[&Page],
        decoder: &mut PageDecoder,
        page: &mut Page,
    ) -> Result<(), ModelError> {
        page.clear();
        let mut above = None;
        for ancestor in ancestors {
            if ancestor.parent() != above {
                let problem = format!(
                    "meta-node {}, whose parent is {:?}, was taken for a child of {above:?} above it",
                    ancestor.number(),
                    ancestor.parent()
                );
                return Err(self.damaged_page(location.number, problem));
            }
            above = Some(ancestor.number());
        }
        let trees = |number| self.roots_in_page(number).iter().map(|index| &self.roots[*index as usize]);
        let Model { shape, tables, appearance, .. } = self;
        let context = Context { location, ancestors, shape, tables, root_wedges: &appearance.root_wedges, trees };
        decoder.decode(encoded, &context, page).map_err(|source| ModelError::Page {
            path: self.path().into(),
            location,
            source,
        })
    }
}

/// Room to read and decode pages in: the largest encoded page, and what is known of the nodes of a page and its ancestors, some
/// 300 bytes for each of their records. Of use for one model only.
#[derive(Debug, Default)]
pub struct PageReader {
    encoded: Vec<u8>,
    head: Head,
    decoder: PageDecoder,
}

impl PageReader {
    /// One that adds up what the fields of the pages take.
    pub(crate) fn measuring() -> Self {
        PageReader { decoder: PageDecoder::measuring(), ..PageReader::default() }
    }

    /// What the fields of the pages read have taken, where that was asked for.
    pub(crate) fn sizes(&self) -> FieldBits {
        self.decoder.sizes()
    }
}

/// What stands between the header and the pages.
struct Tables {
    roots: Vec<ModelRoot>,
    root_pages: Vec<PageLocation>,
    ways: Vec<Way>,
}

impl Tables {
    fn read(file: &dyn ReadAt, header: &Header) -> Result<Self, ModelError> {
        let damaged = |part: String, problem: &str| ModelError::Damaged {
            path: file.path().into(),
            part,
            problem: problem.into(),
        };
        // The header's check makes sure that the tables lie inside the file, so this cannot be larger than the file is.
        let mut bytes = vec![0; (header.after_root_tables() - header.roots_offset) as usize];
        file.read_exact_at(header.roots_offset, &mut bytes)?;
        let (body, checksum) = bytes.split_at(bytes.len() - 4);
        if crc32fast::hash(body).to_le_bytes() != *checksum {
            return Err(damaged("root table".into(), "the checksum does not match"));
        }
        let words: Vec<u32> = body.as_chunks::<4>().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
        let (root_words, words) = words.split_at(header.root_count as usize * ROOT_WORDS);
        let (page_words, way_words) = words.split_at(header.root_page_count as usize * ROOT_PAGE_WORDS);

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
        let mut ways: Vec<Way> = Vec::with_capacity(header.way_count as usize);
        for (index, words) in way_words.as_chunks::<WAY_WORDS>().0.iter().enumerate() {
            let way = Way::from_words(words);
            let before = ways.last().map_or(header.root_page_count, |way| way.page.number + 1);
            let has_parent = (way.parent as usize) < root_pages.len()
                || ways.binary_search_by_key(&way.parent, |way| way.page.number).is_ok();
            if !(before..header.page_count).contains(&way.page.number) || !has_parent {
                return Err(damaged(format!("way page {index}"), "it does not follow its parent and the one before"));
            }
            ways.push(way);
        }
        let tables = Tables { roots, root_pages, ways };
        tables.check_ways().map_err(|(part, problem)| damaged(part, problem))?;
        Ok(tables)
    }

    /// Every tree begins in a page of the tables, and each way leads to one.
    fn check_ways(&self) -> Result<(), (String, &'static str)> {
        let mut leads = vec![false; self.ways.len()];
        let index_of = |page: u32| self.ways.binary_search_by_key(&page, |way| way.page.number).ok();
        for (number, root) in self.roots.iter().enumerate() {
            let way = index_of(root.page.number);
            let page = way.map(|way| &self.ways[way].page).or(self.root_pages.get(root.page.number as usize));
            if page != Some(&root.page) {
                return Err((format!("root {number}"), "no table has the page in which it begins"));
            }
            way.iter().for_each(|way| leads[*way] = true);
        }
        for (index, way) in self.ways.iter().enumerate().rev() {
            if !leads[index] {
                return Err((format!("way page {index}"), "it leads to no tree"));
            }
            index_of(way.parent).iter().for_each(|parent| leads[*parent] = true);
        }
        Ok(())
    }
}

/// The tables of the coder, which stand behind the root tables.
fn read_coder_tables(file: &dyn ReadAt, header: &Header) -> Result<(coder::Tables, coder::Numbers), ModelError> {
    let damaged = |problem: &str| ModelError::Damaged {
        path: file.path().into(),
        part: "coder's tables".into(),
        problem: problem.into(),
    };
    let start = header.after_root_tables();
    let mut bytes = vec![0; (header.after_tables() - start) as usize];
    file.read_exact_at(start, &mut bytes)?;
    let (body, checksum) = bytes.split_at(bytes.len() - 4);
    if crc32fast::hash(body).to_le_bytes() != *checksum {
        return Err(damaged("the checksum does not match"));
    }
    match coder::Classes::from_bytes(body) {
        Ok((_, numbers)) if numbers.denominator > 0.0 && header.lattice_step > 0.0 => {
            Err(damaged("they are for fractions, and there is a lattice"))
        }
        Ok((classes, numbers)) => Ok((coder::Tables::new(&classes), numbers)),
        Err(coder::BadTables) => Err(damaged("they are not such as are written")),
    }
}
