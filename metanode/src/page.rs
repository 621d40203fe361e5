//! The decoded meta-node ("page"): the unit of disk access, and what lies in a place holder (the paper, 3.2 and 3.3.3).
//!
//! A page holds the splits of a set of subtrees of the view-dependence tree, with their born triangles (the paper's
//! *local triangle list*), and says where its child pages lie. It lives in one buffer of 32-bit words whose capacity
//! is set once, so a pool of pages is a fixed amount of memory:
//!
//! ```text
//! words   what
//! 10      header: number, parent (0xffffffff: none), record count | child count << 16,
//!         root count | entry count << 16, triangle count, first child number, first child offset (low, high)
//!         (0, 0, 0: no children), first leaf, end leaf
//! c       encoded length of each child page, in bytes; child i has number `first child + i` and lies behind child i-1
//! 7 r     records: born leaf, x, y, z (f32), normal, kept entry | born entry << 16 (0xffff: that child is a leaf),
//!         index of the first born triangle (the next record's says where they end)
//! 5 e     entries, one for each child that splits further: id, switch (f32), radius (f32), cone,
//!         target record | target child page << 16 (0xffff: in this page)
//! 3 t     born triangles: three leaf numbers
//!         where the model has attributes (`wedges`):
//! r         with seams: the first wedge of each record (the next record's says where they end)
//!           wedges of the born leaves: with seams number, end, and the normal if normals are given; colour (red, green, blue,
//!           alpha from the lowest byte on); texture coordinate, two i32; material: each only where the model has it
//! 3 t       with seams: the numbers of the wedges of the triangles' corners
//! ```
//!
//! Records stand in breadth-first order, those of the page's roots first, by ascending leaf; below a record the kept
//! child comes before the born one. Entries stand in the order of their records, kept before born. So the n-th entry
//! that leads into the same page leads to the n-th record behind the roots, and no reference can lead in a circle.
//!
//! So what decides whether a node is to be split (id, switch value, sphere, cone) stands with its *parent's* record:
//! an active node can be judged without its own page, and a page is needed only when a split is really to be made.
//!
//! How a page is coded in the file is the matter of `codec`.

use storage::prefetch::prefetch;
use thiserror::Error;
pub use vdt::tree::{Normal, NormalCone};

use crate::page_words::PageWords;
use crate::wedges::{PlacedWedge, WedgeLayout};

/// Words of the page header.
pub const HEADER_WORDS: usize = 10;
/// Words of one entry of the child page table.
pub const CHILD_PAGE_WORDS: usize = 1;
/// Words of one record.
pub const RECORD_WORDS: usize = 7;
/// Words of one child entry.
pub const ENTRY_WORDS: usize = 5;
/// Words of one born triangle.
pub const TRIANGLE_WORDS: usize = 3;

/// "None", in the 16-bit fields.
pub const NONE_16: u16 = u16::MAX;
/// "None", in the 32-bit fields.
pub const NONE_32: u32 = u32::MAX;

/// Where a page lies in the model file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PageLocation {
    /// Number of the meta-node.
    pub number: u32,
    /// Byte offset in the model file.
    pub offset: u64,
    /// Encoded length in bytes.
    pub length: u32,
}

/// What is wrong with the bytes of a page.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum PageError {
    /// The bytes are not those that were written.
    #[error("the checksum does not match: the file is damaged here")]
    Checksum,
    /// The page is not as long as its counts say.
    #[error("the page holds {found} words, its counts ask for {expected}")]
    Length {
        /// Words there are.
        found: usize,
        /// Words there should be.
        expected: usize,
    },
    /// The page is larger, decoded, than the file's header promises.
    #[error("the page takes {bytes} bytes decoded, more than a place holder's {slot_bytes}")]
    TooLarge {
        /// Its decoded size in bytes.
        bytes: usize,
        /// The size of a place holder in bytes.
        slot_bytes: usize,
    },
    /// A field holds something that it cannot hold.
    #[error("{what} {index}: {problem}")]
    Field {
        /// What kind of element: "record", "entry", "triangle", "header".
        what: &'static str,
        /// Which one, counted from 0.
        index: usize,
        /// What is wrong with it.
        problem: String,
    },
}

/// Where the split of a child node is recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// In the same page as the parent's.
    SamePage {
        /// Index of the record.
        record: u16,
    },
    /// In a child page.
    ChildPage {
        /// Which child page, counted from 0.
        child: u16,
        /// Index of the record there: a root of that page.
        record: u16,
    },
}

/// A child node that splits further: what is needed to judge it, and where its split is recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChildEntry {
    /// Dependency id of the child.
    pub id: u32,
    /// Its switch value, in mesh units.
    pub switch: f32,
    /// Radius of its bounding sphere about its position, in mesh units.
    pub radius: f32,
    /// Its normal cone.
    pub cone: NormalCone,
    /// Where its split is.
    pub target: Target,
}

/// The split of one node, as recorded in a page.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record {
    /// The born leaf: the kept child has the leaves before it, the born child those from it on.
    pub born_leaf: u32,
    /// Position of the born leaf, in mesh units relative to the model's origin.
    pub position: [f32; 3],
    /// Its normal.
    pub normal: Normal,
    /// The kept child's entry, `None` where it is a leaf.
    pub kept: Option<ChildEntry>,
    /// The born child's entry, `None` where it is a leaf.
    pub born: Option<ChildEntry>,
}

/// The counts that fix the layout of a page.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PageCounts {
    /// Child pages.
    pub children: usize,
    /// Records, that is splits.
    pub records: usize,
    /// Child entries.
    pub entries: usize,
    /// Born triangles.
    pub triangles: usize,
    /// Wedges of the born leaves.
    pub wedges: usize,
    /// How they lie there.
    pub layout: WedgeLayout,
}

impl PageCounts {
    /// Words that one record takes, with its child entries and born triangles.
    pub fn record_words(entries: usize, triangles: usize, wedges: usize, layout: WedgeLayout) -> usize {
        RECORD_WORDS
            + layout.place_words()
            + entries * ENTRY_WORDS
            + triangles * (TRIANGLE_WORDS + layout.corner_words())
            + wedges * layout.words()
    }

    /// Words that a page with these counts takes decoded.
    pub fn words(&self) -> usize {
        self.corner_wedges_start() + self.triangles * self.layout.corner_words()
    }

    /// Bytes that a page with these counts takes decoded.
    pub fn decoded_bytes(&self) -> usize {
        self.words() * 4
    }

    fn records_start(&self) -> usize {
        HEADER_WORDS + self.children * CHILD_PAGE_WORDS
    }

    fn entries_start(&self) -> usize {
        self.records_start() + self.records * RECORD_WORDS
    }

    fn triangles_start(&self) -> usize {
        self.entries_start() + self.entries * ENTRY_WORDS
    }

    fn wedge_places_start(&self) -> usize {
        self.triangles_start() + self.triangles * TRIANGLE_WORDS
    }

    fn wedges_start(&self) -> usize {
        self.wedge_places_start() + self.records * self.layout.place_words()
    }

    fn corner_wedges_start(&self) -> usize {
        self.wedges_start() + self.wedges * self.layout.words()
    }
}

/// A decoded meta-node, in a buffer of fixed capacity; or in a mapped file, and then for looking at only.
#[derive(Debug, Clone)]
pub struct Page {
    words: PageWords,
    slot_bytes: usize,
    counts: PageCounts,
}

/// The header of a page that holds nothing.
const EMPTY_HEADER: [u32; HEADER_WORDS] = [NONE_32, NONE_32, 0, 0, 0, 0, 0, 0, 0, 0];

fn low(word: u32) -> u16 {
    (word & 0xffff) as u16
}

fn high(word: u32) -> u16 {
    (word >> 16) as u16
}

pub(crate) fn pack(low: u16, high: u16) -> u32 {
    u32::from(low) | u32::from(high) << 16
}

impl Page {
    /// An empty page whose buffer holds `slot_bytes` and never grows. The memory is touched at once, so that it
    /// counts from the start.
    pub fn with_slot_bytes(slot_bytes: usize) -> Self {
        let words = vec![1; slot_bytes.div_ceil(4).max(HEADER_WORDS)];
        let mut page = Page { words: PageWords::own(words), slot_bytes, counts: PageCounts::default() };
        page.clear();
        page
    }

    /// Makes the page one without records, whose number no page has.
    pub(crate) fn clear(&mut self) {
        self.begin(PageCounts::default()).extend(EMPTY_HEADER);
    }

    /// Whether a page with these counts fits, and can be numbered.
    pub(crate) fn check_size(&self, counts: &PageCounts) -> Result<(), PageError> {
        let bytes = counts.decoded_bytes();
        if bytes > self.slot_bytes {
            return Err(PageError::TooLarge { bytes, slot_bytes: self.slot_bytes });
        }
        if counts.records.max(counts.entries).max(counts.children) >= usize::from(NONE_16) {
            let problem =
                format!("{} records with {} entries are more than can be numbered", counts.records, counts.entries);
            return Err(PageError::Field { what: "header", index: 8, problem });
        }
        Ok(())
    }

    /// The words of a page with these counts, which fits, to be pushed in order.
    pub(crate) fn begin(&mut self, counts: PageCounts) -> &mut Vec<u32> {
        self.counts = counts;
        self.words.begin()
    }

    /// The page that these words are, of a model whose wedges lie like this. They are as many as its counts say; all else is
    /// for [`Page::check`] to find.
    pub(crate) fn of_words(words: PageWords, layout: WedgeLayout) -> Result<Self, PageError> {
        let found = words.len();
        let short = |expected| PageError::Length { found, expected };
        let Some(header) = words.first_chunk::<HEADER_WORDS>() else { return Err(short(HEADER_WORDS)) };
        let mut counts = PageCounts {
            children: high(header[2]).into(),
            records: low(header[2]).into(),
            entries: high(header[3]).into(),
            triangles: header[4] as usize,
            wedges: 0,
            layout,
        };
        if counts.triangles > found {
            return Err(short(counts.triangles));
        }
        // How many wedges there are beyond one for each record, only the length tells.
        counts.wedges = match (layout.kinds.is_empty(), layout.has_seams) {
            (true, _) => 0,
            (false, false) => counts.records,
            (false, true) => found.saturating_sub(counts.words()) / layout.words(),
        };
        if counts.words() != found {
            return Err(short(counts.words()));
        }
        Ok(Page { words, slot_bytes: found * 4, counts })
    }

    /// All of its words.
    pub(crate) fn words(&self) -> &[u32] {
        &self.words
    }

    /// Everything that one page can be asked without the others. What passes cannot send a traversal in circles: each
    /// record that is not a root of the page is the target of exactly one entry, of a record before it; child pages
    /// have greater numbers.
    pub fn check(&self, leaf_count: u32) -> Result<(), PageError> {
        self.check_header(leaf_count)?;
        let next_record = self.check_records()?;
        if next_record != self.counts.records {
            let problem = format!("no entry refers to record {next_record} of {}", self.counts.records);
            return Err(PageError::Field { what: "record", index: next_record, problem });
        }
        self.check_wedges()?;
        let corners = &self.words[self.counts.triangles_start()..self.counts.wedge_places_start()];
        if let Some(wrong) = corners.iter().position(|leaf| *leaf >= leaf_count) {
            let problem = format!("leaf {} of {leaf_count}", corners[wrong]);
            return Err(PageError::Field { what: "triangle", index: wrong / TRIANGLE_WORDS, problem });
        }
        Ok(())
    }

    /// Each record has at least one wedge, and each wedge an interval of numbers that begins with its own.
    fn check_wedges(&self) -> Result<(), PageError> {
        let PageCounts { records, wedges, layout, .. } = self.counts;
        if !layout.has_seams {
            return Ok(());
        }
        let first = |index: usize| self.words[self.counts.wedge_places_start() + index] as usize;
        for index in 0..records {
            let end = if index + 1 < records { first(index + 1) } else { wedges };
            if (index == 0 && first(0) != 0) || first(index) >= end || end > wedges {
                let problem = format!("wedges {}..{end} of {wedges}", first(index));
                return Err(PageError::Field { what: "record", index, problem });
            }
        }
        let words = &self.words[self.counts.wedges_start()..self.counts.corner_wedges_start()];
        match words.chunks_exact(layout.words()).position(|wedge| wedge[0] >= wedge[1]) {
            None => Ok(()),
            Some(index) => {
                Err(PageError::Field { what: "wedge", index, problem: "the numbers below it are none".into() })
            }
        }
    }

    fn check_header(&self, leaf_count: u32) -> Result<(), PageError> {
        let wrong = |index, problem: String| Err(PageError::Field { what: "header word", index, problem });
        let PageCounts { records, children, .. } = self.counts;
        let (number, first_child) = (self.number(), self.words[5]);
        if self.parent().is_some_and(|parent| parent >= number) {
            return wrong(1, format!("the parent, {}, does not come before it", self.words[1]));
        }
        if records == 0 || self.root_count() == 0 || self.root_count() > records {
            return wrong(3, format!("{} roots among {records} records", self.root_count()));
        }
        if children == 0 && self.words[5..8] != [0; 3] {
            return wrong(5, format!("first child {first_child} of none"));
        }
        if children > 0 && (first_child <= number || first_child.checked_add(children as u32).is_none()) {
            return wrong(5, format!("the first of {children} children is meta-node {first_child}"));
        }
        let (first_leaf, end_leaf) = self.leaf_interval();
        if first_leaf >= end_leaf || end_leaf > leaf_count {
            return wrong(8, format!("leaves {first_leaf}..{end_leaf} of {leaf_count}"));
        }
        Ok(())
    }

    /// Checks the records and their entries, and says how many records are roots or targets of entries.
    fn check_records(&self) -> Result<usize, PageError> {
        let PageCounts { records, entries, triangles, .. } = self.counts;
        let (first_leaf, end_leaf) = self.leaf_interval();
        let (mut next_entry, mut next_record, mut triangles_before) = (0, self.root_count(), 0);
        for index in 0..records {
            let wrong = |problem: String| Err(PageError::Field { what: "record", index, problem });
            let start = self.records_start(index);
            let born_leaf = self.words[start];
            if born_leaf <= first_leaf || born_leaf >= end_leaf {
                return wrong(format!("born leaf {born_leaf} outside {first_leaf}..{end_leaf}"));
            }
            if !self.words[start + 1..start + 4].iter().all(|word| f32::from_bits(*word).is_finite()) {
                return wrong("the position is not finite".into());
            }
            for entry in [low(self.words[start + 5]), high(self.words[start + 5])] {
                if entry == NONE_16 {
                    continue;
                }
                if usize::from(entry) != next_entry || next_entry >= entries {
                    return wrong(format!("entry {entry} where entry {next_entry} of {entries} is due"));
                }
                self.check_entry(next_entry, index, &mut next_record)?;
                next_entry += 1;
            }
            let first_triangle = self.words[start + 6] as usize;
            if first_triangle < triangles_before || first_triangle > triangles || (index == 0 && first_triangle != 0) {
                return wrong(format!("born triangles from {first_triangle} of {triangles}"));
            }
            triangles_before = first_triangle;
        }
        if next_entry != entries {
            let problem = format!("no record refers to it, nor to those behind it up to {entries}");
            return Err(PageError::Field { what: "entry", index: next_entry, problem });
        }
        Ok(next_record)
    }

    /// Checks entry `index`, which belongs to record `owner`; `next_record` is the next record that has no entry yet.
    fn check_entry(&self, index: usize, owner: usize, next_record: &mut usize) -> Result<(), PageError> {
        let wrong = |problem: String| Err(PageError::Field { what: "entry", index, problem });
        let start = self.counts.entries_start() + index * ENTRY_WORDS;
        let (record, child) = (low(self.words[start + 4]), high(self.words[start + 4]));
        if child != NONE_16 {
            if usize::from(child) >= self.counts.children {
                return wrong(format!("child page {child} of {}", self.counts.children));
            }
        } else if usize::from(record) != *next_record || *next_record <= owner || *next_record >= self.counts.records {
            return wrong(format!("record {record} where {next_record} of {} is due", self.counts.records));
        } else {
            *next_record += 1;
        }
        let (switch, radius) = (f32::from_bits(self.words[start + 1]), f32::from_bits(self.words[start + 2]));
        if !(switch > 0.0 && switch.is_finite() && radius >= 0.0 && radius.is_finite()) {
            return wrong(format!("switch value {switch}, radius {radius}"));
        }
        Ok(())
    }

    #[inline]
    fn records_start(&self, index: usize) -> usize {
        self.counts.records_start() + index * RECORD_WORDS
    }

    /// Number of the meta-node.
    #[inline]
    pub fn number(&self) -> u32 {
        self.words[0]
    }

    /// Number of the parent meta-node, `None` at a root of the meta-node forest.
    pub fn parent(&self) -> Option<u32> {
        (self.words[1] != NONE_32).then_some(self.words[1])
    }

    /// The counts of its parts.
    #[inline]
    pub fn counts(&self) -> PageCounts {
        self.counts
    }

    /// How many of the first records are roots of the page: nodes whose parent's split is in another page.
    pub fn root_count(&self) -> usize {
        low(self.words[3]).into()
    }

    /// The leaves from the first to one past the last that lie under the roots of the page.
    pub fn leaf_interval(&self) -> (u32, u32) {
        (self.words[8], self.words[9])
    }

    /// Number of child page `child`, of those that there are.
    #[inline]
    pub fn child_number(&self, child: u16) -> u32 {
        self.words[5].wrapping_add(child.into())
    }

    /// Where child page `child` lies.
    pub fn child_location(&self, child: usize) -> PageLocation {
        self.children().nth(child).unwrap_or(PageLocation { number: NONE_32, offset: u64::MAX, length: 0 })
    }

    /// Where the child pages lie, in order.
    pub fn children(&self) -> impl ExactSizeIterator<Item = PageLocation> + '_ {
        let first_number = self.words[5];
        let mut offset = u64::from(self.words[6]) | u64::from(self.words[7]) << 32;
        self.words[HEADER_WORDS..HEADER_WORDS + self.counts.children].iter().enumerate().map(move |(index, length)| {
            let location = PageLocation { number: first_number.wrapping_add(index as u32), offset, length: *length };
            offset = offset.saturating_add(u64::from(*length));
            location
        })
    }

    /// The record with this index, `None` where there is none.
    #[inline]
    pub fn record(&self, index: u16) -> Option<Record> {
        if usize::from(index) >= self.counts.records {
            return None;
        }
        let words: &[u32] = &self.words;
        let [born_leaf, x, y, z, normal, entries, _] = *words.get(self.records_start(index.into())..)?.first_chunk()?;
        Some(Record {
            born_leaf,
            position: [x, y, z].map(f32::from_bits),
            normal: Normal::from_word(normal),
            kept: self.entry(words, low(entries)),
            born: self.entry(words, high(entries)),
        })
    }

    #[inline]
    fn entry(&self, words: &[u32], index: u16) -> Option<ChildEntry> {
        if usize::from(index) >= self.counts.entries {
            return None;
        }
        let start = self.counts.entries_start() + usize::from(index) * ENTRY_WORDS;
        let [id, switch, radius, cone, target] = *words.get(start..)?.first_chunk()?;
        let (record, child) = (low(target), high(target));
        Some(ChildEntry {
            id,
            switch: f32::from_bits(switch),
            radius: f32::from_bits(radius),
            cone: NormalCone::from_word(cone),
            target: if child == NONE_16 { Target::SamePage { record } } else { Target::ChildPage { child, record } },
        })
    }

    /// Fetches a record into the cache; no effect where there is none.
    #[inline]
    pub fn prefetch_record(&self, index: u16) {
        prefetch(&self.words, self.records_start(index.into()));
    }

    /// Fetches the entries and the born triangles of a record, which itself was fetched before.
    #[inline]
    pub fn prefetch_parts(&self, index: u16) {
        if usize::from(index) < self.counts.records {
            let start = self.records_start(index.into());
            let [kept, born] = [low(self.words[start + 5]), high(self.words[start + 5])];
            let first = if kept == NONE_16 { born } else { kept };
            prefetch(&self.words, self.counts.entries_start() + usize::from(first) * ENTRY_WORDS);
            prefetch(&self.words, self.counts.triangles_start() + self.words[start + 6] as usize * TRIANGLE_WORDS);
        }
    }

    /// The triangles born by the record with this index; none where there is no such record.
    #[inline]
    pub fn triangles(&self, index: u16) -> impl ExactSizeIterator<Item = [u32; 3]> + '_ {
        self.of_triangles(self.counts.triangles_start(), index)
    }

    /// For each of these triangles the numbers of its corners' wedges. Where the model has no seams there are none, and each
    /// corner has the wedge of its leaf.
    pub fn corner_wedges(&self, index: u16) -> impl ExactSizeIterator<Item = [u32; 3]> + '_ {
        let index = if self.counts.layout.has_seams { index } else { NONE_16 };
        self.of_triangles(self.counts.corner_wedges_start(), index)
    }

    /// Three words for each triangle of a record, from those that begin at `start`.
    #[inline]
    fn of_triangles(&self, start: usize, index: u16) -> impl ExactSizeIterator<Item = [u32; 3]> + '_ {
        let index = usize::from(index);
        let first = |index: usize| self.words[self.records_start(index) + 6] as usize;
        let range = if index >= self.counts.records {
            0..0
        } else if index + 1 == self.counts.records {
            first(index)..self.counts.triangles
        } else {
            first(index)..first(index + 1)
        };
        let words = &self.words[start + range.start * TRIANGLE_WORDS..start + range.end * TRIANGLE_WORDS];
        words.as_chunks::<TRIANGLE_WORDS>().0.iter().copied()
    }

    /// The wedges of the leaf that the record with this index bears; none where there is no such record, or the model has no
    /// attributes.
    pub fn wedges(&self, index: u16) -> impl ExactSizeIterator<Item = PlacedWedge> + '_ {
        let PageCounts { records, layout, .. } = self.counts;
        let index = usize::from(index);
        let first = |index: usize| self.words[self.counts.wedge_places_start() + index] as usize;
        let range = if index >= records || layout.kinds.is_empty() {
            0..0
        } else if !layout.has_seams {
            index..index + 1
        } else if index + 1 == records {
            first(index)..self.counts.wedges
        } else {
            first(index)..first(index + 1)
        };
        let record = self.records_start(index.min(records.saturating_sub(1)));
        let (leaf, normal) = match self.words.get(record + 4) {
            Some(normal) => (self.words[record], Normal::from_word(*normal)),
            None => (0, Normal::UP),
        };
        let (start, words) = (self.counts.wedges_start(), layout.words());
        range.map(move |wedge| layout.wedge(&self.words[start + wedge * words..][..words], leaf, normal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The words of page 5, a child of page 2, with two child pages: a root that leads to record 1, which leads to child 1.
    fn some_words() -> Vec<u32> {
        let position = [1.0_f32, 2.0, 3.0].map(f32::to_bits);
        let record = |born_leaf, entries, triangle| {
            let [x, y, z] = position;
            [born_leaf, x, y, z, Normal::UP.to_word(), entries, triangle]
        };
        let entry = |target| [7, 0.5_f32.to_bits(), 2.0_f32.to_bits(), NormalCone::EVERYTHING.to_word(), target];
        let mut words = vec![5, 2, pack(2, 2), pack(1, 2), 3, 9, 0, 5, 10, 20, 100, 200];
        words.extend(record(15, pack(0, NONE_16), 0));
        words.extend(record(12, pack(NONE_16, 1), 2));
        words.extend(entry(pack(1, NONE_16)));
        words.extend(entry(pack(4, 1)));
        words.extend([10, 15, 30, 11, 16, 30, 11, 12, 40]);
        words
    }

    /// Where the records, entries and triangles of that page are.
    const RECORDS: usize = HEADER_WORDS + 2 * CHILD_PAGE_WORDS;
    const ENTRIES: usize = RECORDS + 2 * RECORD_WORDS;

    fn page_of(words: &[u32]) -> Page {
        let counts = PageCounts { children: 2, records: 2, entries: 2, triangles: 3, ..PageCounts::default() };
        let mut page = Page::with_slot_bytes(counts.decoded_bytes());
        page.check_size(&counts).unwrap();
        page.begin(counts).extend(words);
        page
    }

    #[test]
    fn a_page_is_what_its_words_say() {
        let page = page_of(&some_words());
        page.check(50).unwrap();
        assert_eq!((page.number(), page.parent(), page.root_count(), page.leaf_interval()), (5, Some(2), 1, (10, 20)));
        assert_eq!(page.counts().words(), some_words().len());
        let (cone, id, switch, radius) = (NormalCone::EVERYTHING, 7, 0.5, 2.0);
        let inside = ChildEntry { id, switch, radius, cone, target: Target::SamePage { record: 1 } };
        let below = ChildEntry { target: Target::ChildPage { child: 1, record: 4 }, ..inside };
        let (position, normal) = ([1.0, 2.0, 3.0], Normal::UP);
        let record = Record { born_leaf: 15, position, normal, kept: Some(inside), born: None };
        assert_eq!(page.record(0), Some(record));
        assert_eq!(page.record(1), Some(Record { born_leaf: 12, kept: None, born: Some(below), ..record }));
        assert_eq!(page.record(2), None);
        assert_eq!(page.triangles(0).collect::<Vec<_>>(), [[10, 15, 30], [11, 16, 30]]);
        assert_eq!(page.triangles(1).collect::<Vec<_>>(), [[11, 12, 40]]);
        assert_eq!(page.triangles(2).len(), 0);
        let second = PageLocation { number: 10, offset: (5 << 32) + 100, length: 200 };
        assert_eq!(page.children().collect::<Vec<_>>()[1], second);
        assert_eq!(page.child_location(1), second);
    }

    #[test]
    fn what_is_wrong_with_a_page_is_said() {
        let refuse = |changes: &[(usize, u32)], expected: &str| {
            let mut words = some_words();
            changes.iter().for_each(|(index, word)| words[*index] = *word);
            let message = page_of(&words).check(50).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        };
        refuse(&[(1, 5)], "does not come before");
        refuse(&[(3, pack(0, 2))], "0 roots");
        refuse(&[(3, pack(2, 2))], "record 1 where 2 of 2 is due");
        refuse(&[(5, 5)], "the first of 2 children is meta-node 5");
        refuse(&[(5, u32::MAX)], "the first of 2 children");
        refuse(&[(9, 51)], "leaves 10..51 of 50");
        refuse(&[(8, 20)], "leaves 20..20");
        refuse(&[(RECORDS + RECORD_WORDS, 20)], "born leaf 20");
        refuse(&[(RECORDS + RECORD_WORDS, 10)], "born leaf 10");
        refuse(&[(RECORDS + 3, f32::INFINITY.to_bits())], "not finite");
        refuse(&[(RECORDS + 5, pack(1, NONE_16))], "entry 1 where entry 0 of 2 is due");
        refuse(&[(RECORDS + 5, pack(NONE_16, NONE_16))], "entry 1 where entry 0");
        refuse(&[(RECORDS + RECORD_WORDS + 5, pack(NONE_16, NONE_16))], "no record refers to it");
        refuse(&[(RECORDS + 6, 1)], "born triangles from 1 of 3");
        refuse(&[(RECORDS + RECORD_WORDS + 6, 4)], "born triangles from 4 of 3");
        refuse(&[(ENTRIES + 4, pack(0, NONE_16))], "record 0 where 1 of 2 is due");
        refuse(&[(ENTRIES + 4, pack(1, 0))], "no entry refers to record 1");
        refuse(&[(ENTRIES + ENTRY_WORDS + 4, pack(0, 2))], "child page 2 of 2");
        refuse(&[(ENTRIES + 1, 0)], "switch value 0");
        refuse(&[(ENTRIES + 2, f32::NAN.to_bits())], "radius NaN");
        refuse(&[(ENTRIES + 2 * ENTRY_WORDS + 4, 50)], "leaf 50 of 50");
    }

    #[test]
    fn a_page_that_is_cleared_has_nothing_in_it() {
        let mut page = page_of(&some_words());
        page.clear();
        assert_eq!((page.counts(), page.root_count(), page.children().len()), (PageCounts::default(), 0, 0));
        assert_eq!((page.number(), page.record(0), page.triangles(0).len()), (NONE_32, None, 0));
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let counts = PageCounts { children: 1, records: 2, entries: 1, triangles: 3, ..PageCounts::default() };
        let page = Page::with_slot_bytes(counts.decoded_bytes());
        page.check_size(&counts).unwrap();
        let more = PageCounts { triangles: 4, ..counts };
        let expected = PageError::TooLarge { bytes: counts.decoded_bytes() + 12, slot_bytes: counts.decoded_bytes() };
        assert_eq!(page.check_size(&more), Err(expected));
        let large = Page::with_slot_bytes(1 << 23);
        let numbered = PageCounts { records: 65_534, ..counts };
        large.check_size(&numbered).unwrap();
        for (children, records, entries) in [(1, 65_535, 1), (1, 1, 65_535), (65_535, 1, 1)] {
            let counts = PageCounts { children, records, entries, ..PageCounts::default() };
            assert!(large.check_size(&counts).unwrap_err().to_string().contains("than can be numbered"));
        }
    }
}
