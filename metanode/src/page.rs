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
//! 6 r     records: born leaf, x, y, z (f32), kept entry | born entry << 16 (0xffff: that child is a leaf),
//!         index of the first born triangle (the next record's says where they end)
//! 5 e     entries, one for each child that splits further: id, switch (f32), radius (f32), cone,
//!         target record | target child page << 16 (0xffff: in this page)
//! 3 t     born triangles: three leaf numbers
//! ```
//!
//! Records stand in breadth-first order, those of the page's roots first, by ascending leaf; below a record the kept
//! child comes before the born one. Entries stand in the order of their records, kept before born. So the n-th entry
//! that leads into the same page leads to the n-th record behind the roots, and no reference can lead in a circle.
//!
//! So what decides whether a node is to be split (id, switch value, sphere, cone) stands with its *parent's* record:
//! an active node can be judged without its own page, and a page is needed only when a split is really to be made.
//!
//! In this version of the format the encoded page is these words, little endian, and a CRC-32 of them. The coder of a
//! later version replaces [`Page::decode`] and [`encoded`] and leaves the decoded form as it is.

use thiserror::Error;
pub use vdt::tree::NormalCone;

/// Words of the page header.
pub const HEADER_WORDS: usize = 10;
/// Words of one entry of the child page table.
pub const CHILD_PAGE_WORDS: usize = 1;
/// Words of one record.
pub const RECORD_WORDS: usize = 6;
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
}

impl PageCounts {
    /// Words that one record takes, with its child entries and born triangles.
    pub fn record_words(entries: usize, triangles: usize) -> usize {
        RECORD_WORDS + entries * ENTRY_WORDS + triangles * TRIANGLE_WORDS
    }

    /// Words that a page with these counts takes decoded.
    pub fn words(&self) -> usize {
        self.triangles_start() + self.triangles * TRIANGLE_WORDS
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
}

/// A decoded meta-node, in a buffer of fixed capacity.
#[derive(Debug, Clone)]
pub struct Page {
    words: Vec<u32>,
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
        let mut page = Page { words, slot_bytes, counts: PageCounts::default() };
        page.clear();
        page
    }

    /// Makes the page one without records, whose number no page has.
    fn clear(&mut self) {
        self.words.clear();
        self.words.extend(EMPTY_HEADER);
        self.counts = PageCounts::default();
    }

    /// Takes the encoded bytes of the page at `location` apart, checks everything that can be checked without other
    /// pages, and leaves `self` empty where it fails. `leaf_count` is that of the model.
    pub fn decode(&mut self, bytes: &[u8], location: PageLocation, leaf_count: u32) -> Result<(), PageError> {
        let result = self.fill(bytes).and_then(|()| self.check(location, leaf_count));
        if result.is_err() {
            self.clear();
        }
        result
    }

    fn fill(&mut self, bytes: &[u8]) -> Result<(), PageError> {
        let Some((body, checksum)) = bytes.split_last_chunk::<4>() else { return Err(PageError::Checksum) };
        if crc32fast::hash(body) != u32::from_le_bytes(*checksum) {
            return Err(PageError::Checksum);
        }
        if body.len() > self.slot_bytes {
            return Err(PageError::TooLarge { bytes: body.len(), slot_bytes: self.slot_bytes });
        }
        let (words, rest) = body.as_chunks::<4>();
        if !rest.is_empty() || words.len() < HEADER_WORDS {
            return Err(PageError::Length { found: words.len(), expected: HEADER_WORDS });
        }
        self.words.clear();
        self.words.extend(words.iter().map(|word| u32::from_le_bytes(*word)));
        self.counts = PageCounts {
            children: high(self.words[2]).into(),
            records: low(self.words[2]).into(),
            entries: high(self.words[3]).into(),
            // Compared with the length just below, so a wild count cannot do harm.
            triangles: (self.words[4] as usize).min(words.len()),
        };
        if self.counts.words() != words.len() {
            return Err(PageError::Length { found: words.len(), expected: self.counts.words() });
        }
        Ok(())
    }

    /// Everything that one page can be asked without the others. What passes cannot send a traversal in circles: each
    /// record that is not a root of the page is the target of exactly one entry, of a record before it; child pages
    /// have greater numbers.
    fn check(&self, location: PageLocation, leaf_count: u32) -> Result<(), PageError> {
        self.check_header(location, leaf_count)?;
        let next_record = self.check_records()?;
        if next_record != self.counts.records {
            let problem = format!("no entry refers to record {next_record} of {}", self.counts.records);
            return Err(PageError::Field { what: "record", index: next_record, problem });
        }
        let corners = &self.words[self.counts.triangles_start()..];
        if let Some(wrong) = corners.iter().position(|leaf| *leaf >= leaf_count) {
            let problem = format!("leaf {} of {leaf_count}", corners[wrong]);
            return Err(PageError::Field { what: "triangle", index: wrong / TRIANGLE_WORDS, problem });
        }
        Ok(())
    }

    fn check_header(&self, location: PageLocation, leaf_count: u32) -> Result<(), PageError> {
        let wrong = |index, problem: String| Err(PageError::Field { what: "header word", index, problem });
        let PageCounts { records, children, .. } = self.counts;
        let (number, first_child) = (self.number(), self.words[5]);
        if number != location.number {
            return wrong(0, format!("this is meta-node {number}, not {}", location.number));
        }
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
            for entry in [low(self.words[start + 4]), high(self.words[start + 4])] {
                if entry == NONE_16 {
                    continue;
                }
                if usize::from(entry) != next_entry || next_entry >= entries {
                    return wrong(format!("entry {entry} where entry {next_entry} of {entries} is due"));
                }
                self.check_entry(next_entry, index, &mut next_record)?;
                next_entry += 1;
            }
            let first_triangle = self.words[start + 5] as usize;
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

    fn records_start(&self, index: usize) -> usize {
        self.counts.records_start() + index * RECORD_WORDS
    }

    /// Number of the meta-node.
    pub fn number(&self) -> u32 {
        self.words[0]
    }

    /// Number of the parent meta-node, `None` at a root of the meta-node forest.
    pub fn parent(&self) -> Option<u32> {
        (self.words[1] != NONE_32).then_some(self.words[1])
    }

    /// The counts of its parts.
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
    pub fn record(&self, index: u16) -> Option<Record> {
        if usize::from(index) >= self.counts.records {
            return None;
        }
        let start = self.records_start(index.into());
        let words = &self.words[start..start + RECORD_WORDS];
        Some(Record {
            born_leaf: words[0],
            position: [words[1], words[2], words[3]].map(f32::from_bits),
            kept: self.entry(low(words[4])),
            born: self.entry(high(words[4])),
        })
    }

    fn entry(&self, index: u16) -> Option<ChildEntry> {
        if usize::from(index) >= self.counts.entries {
            return None;
        }
        let start = self.counts.entries_start() + usize::from(index) * ENTRY_WORDS;
        let words = &self.words[start..start + ENTRY_WORDS];
        let (record, child) = (low(words[4]), high(words[4]));
        Some(ChildEntry {
            id: words[0],
            switch: f32::from_bits(words[1]),
            radius: f32::from_bits(words[2]),
            cone: NormalCone::from_word(words[3]),
            target: if child == NONE_16 { Target::SamePage { record } } else { Target::ChildPage { child, record } },
        })
    }

    /// The triangles born by the record with this index; none where there is no such record.
    pub fn triangles(&self, index: u16) -> impl ExactSizeIterator<Item = [u32; 3]> + '_ {
        let index = usize::from(index);
        let first = |index: usize| self.words[self.records_start(index) + 5] as usize;
        let range = if index >= self.counts.records {
            0..0
        } else if index + 1 == self.counts.records {
            first(index)..self.counts.triangles
        } else {
            first(index)..first(index + 1)
        };
        let start = self.counts.triangles_start();
        let words = &self.words[start + range.start * TRIANGLE_WORDS..start + range.end * TRIANGLE_WORDS];
        words.as_chunks::<TRIANGLE_WORDS>().0.iter().copied()
    }
}

/// The parts of a page before they are laid out: what a blocking hands over to be encoded.
#[derive(Debug, Clone, Default)]
pub struct PageParts {
    /// Number of the meta-node.
    pub number: u32,
    /// Number of the parent meta-node.
    pub parent: Option<u32>,
    /// How many of the first records are roots of the page.
    pub root_count: u16,
    /// The leaves under the roots of the page, from the first to one past the last.
    pub leaf_interval: (u32, u32),
    /// Number of the first child page; 0 where there is none.
    pub first_child: u32,
    /// Byte offset of the first child page in the file; 0 where there is none.
    pub first_child_offset: u64,
    /// Encoded length of each child page, in bytes.
    pub child_lengths: Vec<u32>,
    /// The records, with their born triangles.
    pub records: Vec<(Record, Vec<[u32; 3]>)>,
}

impl PageParts {
    /// The counts of the parts.
    pub fn counts(&self) -> PageCounts {
        let entries = |record: &Record| usize::from(record.kept.is_some()) + usize::from(record.born.is_some());
        PageCounts {
            children: self.child_lengths.len(),
            records: self.records.len(),
            entries: self.records.iter().map(|(record, _)| entries(record)).sum(),
            triangles: self.records.iter().map(|(_, triangles)| triangles.len()).sum(),
        }
    }
}

/// Bytes that a page with these counts takes in the file.
pub fn encoded_length(counts: PageCounts) -> usize {
    counts.decoded_bytes() + 4
}

/// Bytes that a page takes in the file, by its first [`HEADER_WORDS`] words there.
pub(crate) fn encoded_length_by_header(words: &[u32; HEADER_WORDS]) -> u64 {
    let table = u64::from(high(words[2])) * CHILD_PAGE_WORDS as u64;
    let records = u64::from(low(words[2])) * RECORD_WORDS as u64;
    let entries = u64::from(high(words[3])) * ENTRY_WORDS as u64;
    let triangles = u64::from(words[4]) * TRIANGLE_WORDS as u64;
    (HEADER_WORDS as u64 + table + records + entries + triangles) * 4 + 4
}

/// The bytes of a page in the file.
pub fn encoded(parts: &PageParts) -> Vec<u8> {
    let counts = parts.counts();
    let mut words = Vec::with_capacity(counts.words());
    words.push(parts.number);
    words.push(parts.parent.unwrap_or(NONE_32));
    words.push(pack(counts.records as u16, counts.children as u16));
    words.push(pack(parts.root_count, counts.entries as u16));
    words.push(counts.triangles as u32);
    words.push(parts.first_child);
    words.push(parts.first_child_offset as u32);
    words.push((parts.first_child_offset >> 32) as u32);
    words.push(parts.leaf_interval.0);
    words.push(parts.leaf_interval.1);
    words.extend(&parts.child_lengths);
    let (mut entries, mut triangles) = (0, 0);
    for (record, born_triangles) in &parts.records {
        let mut entry = |child: Option<ChildEntry>| match child {
            None => NONE_16,
            Some(_) => {
                entries += 1;
                entries - 1
            }
        };
        let (kept, born) = (entry(record.kept), entry(record.born));
        words.push(record.born_leaf);
        words.extend(record.position.map(f32::to_bits));
        words.push(pack(kept, born));
        words.push(triangles);
        triangles += born_triangles.len() as u32;
    }
    for child in parts.records.iter().flat_map(|(record, _)| [record.kept, record.born]).flatten() {
        let target = match child.target {
            Target::SamePage { record } => pack(record, NONE_16),
            Target::ChildPage { child, record } => pack(record, child),
        };
        words.extend([child.id, child.switch.to_bits(), child.radius.to_bits(), child.cone.to_word(), target]);
    }
    words.extend(parts.records.iter().flat_map(|(_, triangles)| triangles.as_flattened()));
    let mut bytes = Vec::with_capacity(encoded_length(counts));
    words.iter().for_each(|word| bytes.extend_from_slice(&word.to_le_bytes()));
    let checksum = crc32fast::hash(&bytes);
    bytes.extend(checksum.to_le_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(target: Target) -> ChildEntry {
        ChildEntry { id: 7, switch: 0.5, radius: 2.0, cone: NormalCone::EVERYTHING, target }
    }

    fn some_parts() -> PageParts {
        let record = |born_leaf, kept, born| Record { born_leaf, position: [1.0, 2.0, 3.0], kept, born };
        let inside = Some(entry(Target::SamePage { record: 1 }));
        let below = Some(entry(Target::ChildPage { child: 1, record: 4 }));
        PageParts {
            number: 5,
            parent: Some(2),
            root_count: 1,
            leaf_interval: (10, 20),
            first_child: 9,
            first_child_offset: 5 << 32,
            child_lengths: vec![100, 200],
            records: vec![
                (record(15, inside, None), vec![[10, 15, 30], [11, 16, 30]]),
                (record(12, None, below), vec![[11, 12, 40]]),
            ],
        }
    }

    fn decoded(parts: &PageParts, page: &mut Page) -> Result<(), PageError> {
        page.decode(&encoded(parts), PageLocation { number: 5, offset: 0, length: 0 }, 50)
    }

    #[test]
    fn a_page_comes_back_as_it_was() {
        let parts = some_parts();
        let mut page = Page::with_slot_bytes(parts.counts().decoded_bytes());
        decoded(&parts, &mut page).unwrap();
        assert_eq!((page.number(), page.parent(), page.root_count(), page.leaf_interval()), (5, Some(2), 1, (10, 20)));
        assert_eq!(page.counts(), parts.counts());
        assert_eq!(encoded(&parts).len(), encoded_length(parts.counts()));
        for (index, (record, triangles)) in (0..).zip(&parts.records) {
            assert_eq!(page.record(index).as_ref(), Some(record));
            assert_eq!(&page.triangles(index).collect::<Vec<_>>(), triangles);
        }
        assert_eq!(page.record(2), None);
        assert_eq!(page.triangles(2).len(), 0);
        let second = PageLocation { number: 10, offset: (5 << 32) + 100, length: 200 };
        assert_eq!(page.children().collect::<Vec<_>>()[1], second);
        assert_eq!(page.child_location(1), second);
    }

    #[test]
    fn what_does_not_decode_leaves_an_empty_page() {
        let parts = some_parts();
        let mut page = Page::with_slot_bytes(parts.counts().decoded_bytes());
        let refuse = |page: &mut Page, change: &dyn Fn(&mut PageParts), expected: &str| {
            let mut broken = some_parts();
            change(&mut broken);
            decoded(&parts, page).unwrap();
            let message = decoded(&broken, page).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
            assert_eq!((page.counts(), page.root_count(), page.children().len()), (PageCounts::default(), 0, 0));
            assert_eq!((page.number(), page.record(0), page.triangles(0).len()), (NONE_32, None, 0));
        };
        refuse(&mut page, &|parts| parts.records[0].1.push([1, 2, 3]), "more than a place holder");
        refuse(&mut page, &|parts| parts.number = 6, "this is meta-node 6");
        refuse(&mut page, &|parts| parts.parent = Some(5), "does not come before");
        refuse(&mut page, &|parts| parts.root_count = 0, "0 roots");
        refuse(&mut page, &|parts| parts.root_count = 2, "record 1 where 2 of 2 is due");
        refuse(&mut page, &|parts| parts.first_child = 5, "the first of 2 children is meta-node 5");
        refuse(&mut page, &|parts| parts.first_child = u32::MAX, "the first of 2 children");
        refuse(&mut page, &|parts| parts.child_lengths.clear(), "first child 9 of none");
        refuse(&mut page, &|parts| parts.leaf_interval = (10, 51), "leaves 10..51 of 50");
        refuse(&mut page, &|parts| parts.records[1].0.born_leaf = 20, "born leaf 20");
        refuse(&mut page, &|parts| parts.records[1].0.position[2] = f32::INFINITY, "not finite");
        let itself = Some(entry(Target::SamePage { record: 0 }));
        refuse(&mut page, &|parts| parts.records[0].0.kept = itself, "record 0 where 1 of 2 is due");
        refuse(&mut page, &|parts| parts.records[0].0.kept = None, "no entry refers to record 1");
        let beyond = Some(entry(Target::ChildPage { child: 2, record: 0 }));
        refuse(&mut page, &|parts| parts.records[1].0.born = beyond, "child page 2 of 2");
        let flat = Some(ChildEntry { switch: 0.0, ..entry(Target::SamePage { record: 1 }) });
        refuse(&mut page, &|parts| parts.records[0].0.kept = flat, "switch value 0");
        refuse(&mut page, &|parts| parts.records[1].1[0][0] = 50, "leaf 50 of 50");
        let bytes = encoded(&parts);
        let location = PageLocation { number: 5, offset: 0, length: 0 };
        assert_eq!(page.decode(&bytes[..3], location, 50), Err(PageError::Checksum));
        let short = [&bytes[..8], &crc32fast::hash(&bytes[..8]).to_le_bytes()].concat();
        assert_eq!(page.decode(&short, location, 50), Err(PageError::Length { found: 2, expected: HEADER_WORDS }));
    }
}
