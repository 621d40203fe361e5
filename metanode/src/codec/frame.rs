//! A page in the file: what is known of it at once, the coded fields, a checksum.
//!
//! ```text
//! bytes  what
//! 4      number of the page
//! 4      number of its parent; 0xffffffff in a root page
//! 4      bytes of all this
//! 2      records
//! 2      how many of them are roots of the page
//! 2      child pages
//! 2      wedges beyond one for each record; 0 where there are no seams
//! 4      born triangles
//!        where there are child pages:
//! 4        number of the first one
//! 8        its byte offset in the file
//! 6 c      for each one its length in bytes (4), and how many child entries lead into it (2)
//!        the fields, coded (`rans`)
//! 4      CRC-32 of all before
//! ```
//!
//! Memory to decode: the bytes, the decoded page, and some 300 bytes for each record of it and its ancestors.

use vdt::tree::switch_of;

use super::nodes::{BORN, ELSEWHERE, KEPT, LEAF};
use super::{Decoder, FieldBits, Measured, PageCoder, Shape, Tables, cones};
use crate::header::ModelRoot;
use crate::page::{CHILD_PAGE_WORDS, HEADER_WORDS, NONE_16, NONE_32, Page, PageCounts, PageError, PageLocation, pack};
use crate::wedges::{RootWedges, WedgeLayout};

/// Bytes in front of the child pages.
const HEAD_BYTES: usize = 24;
/// Bytes of the first child page's place.
const FIRST_CHILD_BYTES: usize = 12;
/// Bytes for each child page.
const CHILD_BYTES: usize = 6;
/// Bytes of the checksum.
pub(crate) const CHECKSUM_BYTES: usize = 4;

/// What is in front of the coded fields.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Head {
    pub number: u32,
    pub parent: u32,
    pub records: u16,
    pub root_count: u16,
    /// Wedges beyond one for each record.
    pub more_wedges: u16,
    pub triangles: u32,
    pub first_child: u32,
    pub first_child_offset: u64,
    /// Of each child page its length in the file, and how many entries lead into it.
    pub children: Vec<(u32, u16)>,
}

impl Head {
    /// How many bytes at the start of a page tell its length.
    pub const START_BYTES: usize = 12;

    /// The length of a page that starts like this.
    pub fn length(start: [u8; Head::START_BYTES]) -> u32 {
        u32::from_le_bytes([start[8], start[9], start[10], start[11]])
    }

    /// The counts of the decoded page, of a model whose wedges lie like this. Each record but the roots of the page has an entry that
    /// leads to it; the others lead into child pages.
    pub fn counts(&self, layout: WedgeLayout) -> PageCounts {
        let below: usize = self.children.iter().map(|(_, entries)| usize::from(*entries)).sum();
        let inside = self.records.saturating_sub(self.root_count);
        let wedges = usize::from(self.records) + usize::from(self.more_wedges);
        PageCounts {
            children: self.children.len(),
            records: self.records.into(),
            entries: usize::from(inside) + below,
            triangles: self.triangles as usize,
            wedges: if layout.kinds.is_empty() { 0 } else { wedges },
            layout,
        }
    }

    /// Bytes of a page with so many child pages but for the coded fields.
    pub fn bytes_around(children: usize) -> usize {
        let of_children = if children == 0 { 0 } else { FIRST_CHILD_BYTES + children * CHILD_BYTES };
        HEAD_BYTES + of_children + CHECKSUM_BYTES
    }

    /// The whole page.
    pub fn page(&self, fields: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(Head::bytes_around(self.children.len()) + fields.len());
        bytes.extend(self.number.to_le_bytes());
        bytes.extend(self.parent.to_le_bytes());
        let length = Head::bytes_around(self.children.len()) + fields.len();
        bytes.extend((length as u32).to_le_bytes());
        for half in [self.records, self.root_count, self.children.len() as u16, self.more_wedges] {
            bytes.extend(half.to_le_bytes());
        }
        bytes.extend(self.triangles.to_le_bytes());
        if !self.children.is_empty() {
            bytes.extend(self.first_child.to_le_bytes());
            bytes.extend(self.first_child_offset.to_le_bytes());
            for (length, entries) in &self.children {
                bytes.extend(length.to_le_bytes());
                bytes.extend(entries.to_le_bytes());
            }
        }
        bytes.extend(fields);
        let checksum = crc32fast::hash(&bytes);
        bytes.extend(checksum.to_le_bytes());
        bytes
    }

    /// The inverse of [`Head::page`], into `self`: the coded fields.
    fn parse<'b>(&mut self, bytes: &'b [u8]) -> Result<&'b [u8], PageError> {
        let Some((body, checksum)) = bytes.split_last_chunk::<CHECKSUM_BYTES>() else {
            return Err(PageError::Checksum);
        };
        if crc32fast::hash(body) != u32::from_le_bytes(*checksum) {
            return Err(PageError::Checksum);
        }
        let too_short = PageError::Length { found: bytes.len(), expected: Head::bytes_around(0) };
        let Some((head, mut rest)) = body.split_first_chunk::<HEAD_BYTES>() else { return Err(too_short) };
        let half = |at: usize| u16::from_le_bytes([head[at], head[at + 1]]);
        let word = |at: usize| u32::from(half(at)) | u32::from(half(at + 2)) << 16;
        let children = usize::from(half(16));
        self.number = word(0);
        self.parent = word(4);
        (self.records, self.root_count, self.triangles) = (half(12), half(14), word(20));
        self.more_wedges = half(18);
        (self.first_child, self.first_child_offset) = (0, 0);
        self.children.clear();
        if word(8) as usize != bytes.len() {
            return Err(PageError::Length { found: bytes.len(), expected: word(8) as usize });
        }
        if children > 0 {
            let expected = Head::bytes_around(children);
            let split = rest.split_at_checked(FIRST_CHILD_BYTES + children * CHILD_BYTES);
            let Some((table, fields)) = split else { return Err(PageError::Length { found: bytes.len(), expected }) };
            rest = fields;
            let (first, table) = table.split_at(FIRST_CHILD_BYTES);
            let long = |bytes: &[u8]| bytes.iter().rev().fold(0, |value, byte| value << 8 | u64::from(*byte));
            self.first_child = long(&first[..4]) as u32;
            self.first_child_offset = long(&first[4..]);
            let entry = |child: &[u8; CHILD_BYTES]| (long(&child[..4]) as u32, long(&child[4..]) as u16);
            self.children.extend(table.as_chunks::<CHILD_BYTES>().0.iter().map(entry));
        }
        Ok(rest)
    }

    /// What a page says of itself before its coded fields, if the checksum is right.
    pub fn read(&mut self, bytes: &[u8]) -> Result<(), PageError> {
        self.parse(bytes).map(|_| ())
    }

    /// What can be told to be wrong before anything is decoded.
    fn check(&self, location: PageLocation, ancestors: &[&Page], layout: WedgeLayout) -> Result<(), PageError> {
        let wrong = |index, problem: String| Err(PageError::Field { what: "header", index, problem });
        let (number, first_child, children) = (self.number, self.first_child, self.children.len() as u32);
        if number != location.number {
            return wrong(0, format!("this is meta-node {number}, not {}", location.number));
        }
        let above = ancestors.last().map_or(NONE_32, |page| page.number());
        if self.parent != above {
            let named = |number| if number == NONE_32 { "none".into() } else { format!("meta-node {number}") };
            return wrong(4, format!("its parent is given as {}, not {}", named(self.parent), named(above)));
        }
        if self.records == 0 || self.root_count == 0 || self.root_count > self.records {
            return wrong(12, format!("{} roots among {} records", self.root_count, self.records));
        }
        if self.more_wedges > 0 && !layout.has_seams {
            return wrong(18, format!("{} more wedges than records, where there are no seams", self.more_wedges));
        }
        if children > 0 && (first_child <= number || first_child.checked_add(children).is_none()) {
            return wrong(24, format!("the first of {children} children is meta-node {first_child}"));
        }
        Ok(())
    }
}

/// Decodes pages.
#[derive(Debug, Default)]
pub(crate) struct PageDecoder {
    /// What the fields of all pages took, where that is asked for.
    sizes: Option<FieldBits>,
    coder: PageCoder,
    head: Head,
    corners: Vec<[u32; 3]>,
    places: Vec<(u32, u32)>,
}

/// What a decoder is told of a page and its model.
pub(crate) struct Context<'a, F> {
    pub location: PageLocation,
    /// The decoded pages from a root page down to the parent of the page.
    pub ancestors: &'a [&'a Page],
    pub shape: &'a Shape,
    pub tables: &'a Tables,
    /// The wedges of the trees' first leaves.
    pub root_wedges: &'a RootWedges,
    /// The trees that begin in a page, by ascending record.
    pub trees: F,
}

impl PageDecoder {
    /// One that adds up what the fields of all pages take.
    pub fn measuring() -> Self {
        PageDecoder { sizes: Some(FieldBits::default()), ..PageDecoder::default() }
    }

    /// What the fields of the pages decoded have taken, where that was asked for.
    pub fn sizes(&self) -> FieldBits {
        self.sizes.unwrap_or_default()
    }

    /// Decodes a page into `page`, which is left empty where it cannot be.
    pub fn decode<'t, T: Iterator<Item = &'t ModelRoot>>(
        &mut self,
        bytes: &[u8],
        context: &Context<'_, impl Fn(u32) -> T>,
        page: &mut Page,
    ) -> Result<(), PageError> {
        page.clear();
        let result = self.fill(bytes, context, page);
        if result.is_err() {
            page.clear();
            self.coder.nodes.clear();
            self.coder.wedges.clear();
        }
        result
    }

    fn fill<'t, T: Iterator<Item = &'t ModelRoot>>(
        &mut self,
        bytes: &[u8],
        context: &Context<'_, impl Fn(u32) -> T>,
        page: &mut Page,
    ) -> Result<(), PageError> {
        let PageDecoder { coder, head, .. } = self;
        let coded = head.parse(bytes)?;
        head.check(context.location, context.ancestors, context.shape.wedges)?;
        let (records, root_count) = (usize::from(head.records), usize::from(head.root_count));
        let layout = context.shape.wedges;
        let counts = head.counts(layout);
        page.check_size(&PageCounts { entries: 0, ..counts })?;
        let number = head.number;
        coder.nodes.begin(context.ancestors, number, root_count, &context.trees, context.shape)?;
        coder.wedges.begin(context.ancestors, layout);
        let fields = &mut coder.fields;
        fields.clear();
        fields.most_wedges = counts.wedges;
        fields.root_count = root_count;
        fields.children.extend(head.children.iter().map(|(_, entries)| *entries));
        fields.kinds.resize(records, 0);
        fields.counts.resize(records, [0; 2]);
        fields.starts.resize(records, 0);
        fields.corners.resize(head.triangles as usize, [0; 3]);
        fields.normals.resize(records, 0);
        let Some(mut decoder) = Decoder::new(context.tables, coded) else {
            return Err(PageError::Length { found: coded.len(), expected: 12 });
        };
        match &mut self.sizes {
            None => coder.code(&mut decoder, context.shape, context.root_wedges)?,
            Some(sizes) => {
                let mut measured = Measured::new(&mut decoder, context.tables, sizes);
                coder.code(&mut measured, context.shape, context.root_wedges)?;
            }
        }
        if coder.wedges.of_page().len() != counts.wedges {
            let problem = format!("{} wedges, where the page has {}", counts.wedges, coder.wedges.of_page().len());
            return Err(PageError::Field { what: "header", index: 18, problem });
        }
        if !decoder.is_exact() {
            let problem = "what is coded does not end where it should".into();
            return Err(PageError::Field { what: "page", index: number as usize, problem });
        }
        self.write(context, page)
    }

    /// Writes the decoded fields down as a page.
    fn write<'t, T: Iterator<Item = &'t ModelRoot>>(
        &mut self,
        context: &Context<'_, impl Fn(u32) -> T>,
        page: &mut Page,
    ) -> Result<(), PageError> {
        let PageDecoder { coder, head, corners, places, .. } = self;
        let trees = |child: usize, record: u16| {
            let number = head.first_child.wrapping_add(child as u32);
            (context.trees)(number).any(|root| root.record == record)
        };
        coder.targets(&trees, places)?;
        coder.write(head, places, context.shape, corners, page)
    }
}

/// What the corners of a triangle have, in the order of its orientation.
fn oriented([kept, born, third]: [u32; 3], is_right: bool) -> [u32; 3] {
    if is_right { [kept, third, born] } else { [kept, born, third] }
}

impl PageCoder {
    /// Finds the records that the children in child pages are, as they are in the words of their entries: within their page
    /// and from page to page they ascend by leaf, with the trees that begin there among them.
    pub fn targets(
        &self,
        is_tree: &impl Fn(usize, u16) -> bool,
        places: &mut Vec<(u32, u32)>,
    ) -> Result<(), PageError> {
        let PageCoder { nodes, fields, .. } = self;
        places.clear();
        let mut entry = 0;
        for node in &nodes.all[nodes.first..] {
            for side in [KEPT, BORN] {
                if node.children[side] == ELSEWHERE {
                    places.push((node.interval(side).0, entry));
                }
                entry += u32::from(node.children[side] != LEAF);
            }
        }
        let counted: usize = fields.children.iter().map(|entries| usize::from(*entries)).sum();
        if counted != places.len() {
            let problem = format!("{} children lead into child pages, which have {counted} such roots", places.len());
            return Err(PageError::Field { what: "header", index: 0, problem });
        }
        places.sort_unstable();
        let mut next = 0;
        for (child, entries) in fields.children.iter().enumerate() {
            let mut record = 0;
            for place in &mut places[next..next + usize::from(*entries)] {
                while is_tree(child, record) {
                    record += 1;
                }
                place.0 = pack(record, child as u16);
                record = record.saturating_add(1);
            }
            next += usize::from(*entries);
        }
        places.sort_unstable_by_key(|(_, entry)| *entry);
        Ok(())
    }

    /// Writes the fields down as a page. `places` is what [`PageCoder::targets`] has found, `corners` room to work in.
    pub fn write(
        &self,
        head: &Head,
        places: &[(u32, u32)],
        shape: &Shape,
        corners: &mut Vec<[u32; 3]>,
        page: &mut Page,
    ) -> Result<(), PageError> {
        let PageCoder { nodes, fields, .. } = self;
        let records = &nodes.all[nodes.first..];
        let counts = self.counts(shape);
        page.check_size(&counts)?;
        let words = page.begin(counts);
        words.extend([head.number, head.parent]);
        words.push(pack(counts.records as u16, counts.children as u16));
        words.push(pack(fields.root_count as u16, counts.entries as u16));
        words.push(counts.triangles as u32);
        let offset = head.first_child_offset;
        words.extend([head.first_child, offset as u32, (offset >> 32) as u32]);
        words.extend([records[0].start, records[fields.root_count - 1].end]);
        words.extend(head.children.iter().map(|(length, _)| length));
        debug_assert_eq!(words.len(), HEADER_WORDS + counts.children * CHILD_PAGE_WORDS);
        let (mut entry, mut triangle) = (0, 0);
        for (record, node) in records.iter().enumerate() {
            let mut entries = [NONE_16; 2];
            for side in [KEPT, BORN] {
                if node.children[side] != LEAF {
                    entries[side] = entry;
                    entry += 1;
                }
            }
            words.push(node.born);
            words.extend(node.places[BORN].map(f32::to_bits));
            words.push(fields.normals[record]);
            words.push(pack(entries[KEPT], entries[BORN]));
            words.push(triangle);
            triangle += fields.counts[record][0] + fields.counts[record][1];
        }
        let (mut entry, mut places) = (0, places.iter());
        for node in records {
            for side in [KEPT, BORN] {
                let target = match node.children[side] {
                    LEAF => continue,
                    ELSEWHERE => places.next().map_or(0, |(place, _)| *place),
                    child => pack((child as usize - nodes.first) as u16, NONE_16),
                };
                let (id, class) = (fields.ids[entry], fields.cones[entry]);
                let cone = cones::cone(class, node.normals[side], node.is_inward);
                let switch = switch_of(id, shape.exponent);
                words.extend([id, switch.to_bits(), node.radii[side].to_bits(), cone.to_word(), target]);
                entry += 1;
            }
        }
        for ([left, right], start) in fields.counts.iter().zip(&fields.starts) {
            let start = *start as usize;
            corners.clear();
            for (number, corners_here) in fields.corners[start..start + (left + right) as usize].iter().enumerate() {
                corners.push(oriented(*corners_here, number >= *left as usize));
            }
            corners.sort_unstable();
            words.extend(corners.as_flattened());
        }
        if !shape.wedges.kinds.is_empty() {
            self.write_wedges(shape, words);
        }
        debug_assert_eq!(words.len(), counts.words());
        Ok(())
    }

    /// Writes down what stands behind the triangles.
    fn write_wedges(&self, shape: &Shape, words: &mut Vec<u32>) {
        let PageCoder { fields, wedges, .. } = self;
        let layout = shape.wedges;
        if layout.has_seams {
            words.extend(wedges.firsts_of_page());
        }
        wedges.of_page().iter().for_each(|placed| layout.push(placed, words));
        if layout.has_seams {
            let mut triangles = Vec::new();
            for ([left, right], start) in fields.counts.iter().zip(&fields.starts) {
                let here = *start as usize..(start + left + right) as usize;
                triangles.clear();
                for (number, (corners, wedges)) in
                    fields.corners[here.clone()].iter().zip(&wedges.corners[here]).enumerate()
                {
                    let is_right = number >= *left as usize;
                    triangles.push((oriented(*corners, is_right), oriented(*wedges, is_right)));
                }
                // As the triangles were.
                triangles.sort_unstable();
                triangles.iter().for_each(|(_, wedges)| words.extend(wedges));
            }
        }
    }
}
