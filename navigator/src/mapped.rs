//! Pages by virtual memory, for comparison with the pool (the paper, 4, Table 2: *Virt.*): all of them lie decoded in one
//! mapped file. To the navigator each is always there, and its place holder is its number; which of them are in RAM is the
//! operating system's matter, and a frame that looks at one that is not waits for the disk. So there is nothing to prefetch,
//! nothing is missing, and no split is refused for want of place holders.
//!
//! RAM, beside what the system keeps of the file: [`MAPPED_PAGE_BYTES`] for each page of the model, and what a view of a page
//! takes for each page in use.

use metanode::DecodedFile;
use metanode::page::Page;

/// Bytes of RAM for each page of the model: its usage count, and where the view of it is.
pub const MAPPED_PAGE_BYTES: usize = size_of::<u32>() + size_of::<Option<Box<Page>>>();

/// The mapped pages, with what is known of their use.
#[derive(Debug)]
pub struct Mapped {
    decoded: DecodedFile,
    /// How many splits of each page are applied.
    usage: Vec<u32>,
    /// Those that are in use.
    pages: Vec<Option<Box<Page>>>,
    in_use: usize,
    /// What there is to see of a page that is not in use.
    nothing: Page,
}

impl Mapped {
    /// The pages of a decoded file, none of them in use.
    pub fn new(decoded: DecodedFile) -> Self {
        let count = decoded.page_count() as usize;
        let pages = std::iter::repeat_with(|| None).take(count).collect();
        Mapped { decoded, usage: vec![0; count], pages, in_use: 0, nothing: Page::with_slot_bytes(0) }
    }

    /// Number of pages, and of their place holders.
    pub fn page_count(&self) -> usize {
        self.pages.len()
    }

    /// Pages in use.
    pub fn in_use(&self) -> usize {
        self.in_use
    }

    /// How many splits of a page are applied.
    pub fn usage(&self, page: u32) -> u32 {
        self.usage[page as usize]
    }

    /// A page that is in use.
    pub fn page(&self, page: u32) -> &Page {
        self.pages[page as usize].as_deref().unwrap_or(&self.nothing)
    }

    /// A split of a page is to be applied; false where there is no such page.
    pub fn begin_use(&mut self, page: u32) -> bool {
        let Some(place) = self.pages.get_mut(page as usize) else { return false };
        if place.is_none() {
            *place = self.decoded.page(page).map(Box::new);
            if place.is_none() {
                return false;
            }
            self.in_use += 1;
        }
        self.usage[page as usize] += 1;
        true
    }

    /// A split of a page that is in use is not applied any more, or was not after all.
    pub fn end_use(&mut self, page: u32) {
        let usage = &mut self.usage[page as usize];
        *usage = usage.saturating_sub(1);
        if *usage == 0 && self.pages[page as usize].take().is_some() {
            self.in_use -= 1;
        }
    }

    /// The ancestors of a page that is in use, from the root page down to its parent.
    pub fn ancestors(&self, page: u32) -> Vec<Page> {
        let above = |page: &Page| page.parent().and_then(|parent| self.decoded.page(parent));
        let mut ancestors: Vec<Page> = std::iter::successors(above(self.page(page)), above).collect();
        ancestors.reverse();
        ancestors
    }
}
