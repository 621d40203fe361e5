//! What can be said of a model as a whole: how full its pages are, how long its paths, where its bytes go.
//!
//! One pass over the file, page after page. What stands in front of the coded fields of a page says enough, so none is
//! decoded, and no page needs those above it: they are numbered by levels. The checksums are looked at. A file that `verify`
//! would refuse gives wrong figures or an error.
//!
//! RAM: the largest page in the file.

use crate::codec::{CHECKSUM_BYTES, Head};
use crate::header::{Blocking, HEADER_BYTES, ModelError, ROOT_PAGE_WORDS, ROOT_WORDS, WAY_WORDS};
use crate::model::{Model, PageReader};
use crate::page::{CHILD_PAGE_WORDS, ENTRY_WORDS, HEADER_WORDS, PageCounts, RECORD_WORDS, TRIANGLE_WORDS};
use crate::wedges::WedgeLayout;

/// Words of a position, in roots and records.
const POSITION_WORDS: usize = 3;
/// Buckets of the fill histogram.
pub const FILL_BUCKETS: usize = 10;

/// Bytes of a model file, by what they are for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FileBytes {
    /// The header.
    pub header: u64,
    /// Root table.
    pub roots: u64,
    /// Root page table and way table.
    pub ways: u64,
    /// Tables of the coder, with their checksum.
    pub coder_tables: u64,
    /// The appearance: root wedges, materials.
    pub appearance: u64,
    /// Images.
    pub images: u64,
    /// What stands in front of the coded fields of pages: numbers, counts, where the children are.
    pub page_heads: u64,
    /// Coded fields.
    pub fields: u64,
    /// Checksums of the root tables and of pages.
    pub checksums: u64,
}

impl FileBytes {
    /// All of them: those of the file.
    pub fn total(&self) -> u64 {
        let FileBytes { header, roots, ways, coder_tables, appearance, images, page_heads, fields, checksums } = self;
        header + roots + ways + coder_tables + appearance + images + page_heads + fields + checksums
    }
}

/// Bytes of the root table and of all pages decoded, by what they are for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DecodedBytes {
    /// Page headers and child page tables.
    pub page_headers: u64,
    /// Root table, without positions.
    pub roots: u64,
    /// Records, without positions: born leaves, normals, where the children's entries and the triangles are.
    pub records: u64,
    /// Positions, of roots and records.
    pub positions: u64,
    /// Child entries: ids, switch values, spheres, cones, references.
    pub entries: u64,
    /// Born triangles.
    pub triangles: u64,
    /// Wedges of born leaves and corners.
    pub wedges: u64,
}

impl DecodedBytes {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.tree() + self.data() + self.page_headers
    }

    /// The tree itself: the paper's *VDT* (its Table 1).
    pub fn tree(&self) -> u64 {
        self.roots + self.records + self.entries
    }

    /// What is drawn: the paper's *DATA*.
    pub fn data(&self) -> u64 {
        self.positions + self.triangles + self.wedges
    }
}

/// Figures of a model.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ModelStatistics {
    /// Meta-nodes.
    pub pages: u64,
    /// Meta-nodes without children.
    pub bottom_pages: u64,
    /// Meta-nodes that hold a single split.
    pub single_split_pages: u64,
    /// Meta-nodes larger than the slot that was asked for: their one split has very many triangles.
    pub oversized_pages: u64,
    /// Bytes that the fill is measured against: the slot asked for with `forest`, the largest page with `levels`.
    pub slot_bytes: u32,
    /// Pages by how full they are decoded, in tenths of the slot; a full one counts for the last tenth.
    pub fill_histogram: [u64; FILL_BUCKETS],
    /// Mean size of a decoded page, as a part of the slot.
    pub mean_fill: f64,
    /// Smallest size of a decoded page, as a part of the slot.
    pub least_fill: f64,
    /// Splits of a page, on average.
    pub records_per_page: f64,
    /// Subtrees that begin in a page, on average.
    pub roots_per_page: f64,
    /// Children of a page that has any, on average.
    pub children_per_page: f64,
    /// Pages on the way from a root page to a leaf, which must be decoded to draw it, on average over the leaves.
    pub pages_per_path: f64,
    /// Pages on the longest of these ways.
    pub longest_path: u32,
    /// Where the bytes of the file go.
    pub file: FileBytes,
    /// And where they go once all is decoded.
    pub decoded: DecodedBytes,
}

/// Reads the whole file once and counts.
pub fn statistics(model: &Model) -> Result<ModelStatistics, ModelError> {
    let header = model.header();
    let slot_bytes = match header.blocking {
        Blocking::Forest { slot_bytes, .. } => slot_bytes,
        Blocking::Levels { .. } => header.slot_bytes,
    };
    let mut found = ModelStatistics { slot_bytes, least_fill: f64::INFINITY, ..ModelStatistics::default() };
    let words = |count: u32, words: usize| u64::from(count) * 4 * words as u64;
    found.file = FileBytes {
        header: HEADER_BYTES as u64,
        roots: words(header.root_count, ROOT_WORDS),
        ways: words(header.root_page_count, ROOT_PAGE_WORDS) + words(header.way_count, WAY_WORDS),
        coder_tables: header.after_tables() - header.after_root_tables(),
        appearance: header.appearance_bytes.into(),
        images: header.image_bytes,
        checksums: CHECKSUM_BYTES as u64,
        ..FileBytes::default()
    };
    let bytes = |count: usize, words: usize| (count * words) as u64 * 4;
    found.decoded.roots = bytes(header.root_count as usize, ROOT_WORDS - POSITION_WORDS);
    found.decoded.positions = bytes(header.root_count as usize, POSITION_WORDS);
    let (mut records, mut roots, mut children, mut path_pages) = (0, 0, 0, 0);
    let layout = model.appearance().map_or(WedgeLayout::default(), |appearance| appearance.layout);
    let mut reader = PageReader::default();
    // One past the last page of the level at hand, and of the one below as far as it is known.
    let (mut level_end, mut next_end) = (header.root_page_count, header.root_page_count);
    let mut offset = header.pages_offset;
    found.longest_path = u32::from(header.page_count > 0);
    for number in 0..header.page_count {
        let (location, head) = model.read_head(number, offset, &mut reader)?;
        offset += u64::from(location.length);
        if number == level_end {
            found.longest_path += 1;
            level_end = next_end;
        }
        let counts = head.counts(layout);
        if counts.children > 0 {
            next_end = head.first_child.saturating_add(counts.children as u32);
        }
        found.pages += 1;
        found.bottom_pages += u64::from(counts.children == 0);
        found.single_split_pages += u64::from(counts.records == 1);
        let decoded = counts.decoded_bytes();
        found.oversized_pages += u64::from(decoded > slot_bytes as usize);
        let fill = decoded as f64 / f64::from(slot_bytes);
        found.fill_histogram[((fill * FILL_BUCKETS as f64) as usize).min(FILL_BUCKETS - 1)] += 1;
        found.mean_fill += fill;
        found.least_fill = found.least_fill.min(fill);
        records += counts.records as u64;
        roots += u64::from(head.root_count);
        children += counts.children as u64;
        // A split has two children; those without an entry are leaves.
        let leaves = (2 * counts.records).saturating_sub(counts.entries) as u64;
        path_pages += leaves * u64::from(found.longest_path);
        let around = Head::bytes_around(counts.children) as u64;
        found.file.page_heads += around - CHECKSUM_BYTES as u64;
        found.file.checksums += CHECKSUM_BYTES as u64;
        found.file.fields += u64::from(location.length) - around;
        found.decoded.page_headers += bytes(1, HEADER_WORDS) + bytes(counts.children, CHILD_PAGE_WORDS);
        found.decoded.records += bytes(counts.records, RECORD_WORDS - POSITION_WORDS);
        found.decoded.positions += bytes(counts.records, POSITION_WORDS);
        found.decoded.entries += bytes(counts.entries, ENTRY_WORDS);
        found.decoded.triangles += bytes(counts.triangles, TRIANGLE_WORDS);
        let plain = PageCounts { wedges: 0, layout: WedgeLayout::default(), ..counts };
        found.decoded.wedges += (decoded - plain.decoded_bytes()) as u64;
    }
    if offset != header.file_length {
        let problem = format!("the last of them ends at byte {offset} of {}", header.file_length);
        return Err(ModelError::Damaged { path: model.path().into(), part: "meta-nodes".into(), problem });
    }
    if found.pages == 0 {
        found.least_fill = 0.0;
        return Ok(found);
    }
    let pages = found.pages as f64;
    found.mean_fill /= pages;
    found.records_per_page = records as f64 / pages;
    found.roots_per_page = roots as f64 / pages;
    let with_children = found.pages - found.bottom_pages;
    found.children_per_page = if with_children == 0 { 0.0 } else { children as f64 / with_children as f64 };
    found.pages_per_path = path_pages as f64 / f64::from(header.leaf_count);
    Ok(found)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use vdt::tree::{NO_SPLIT, Tree};

    use super::*;
    use crate::reference;
    use crate::testing::{all_pages, blockings, model, model_bytes, plans, random_tree};

    /// Pages on the way from a root page to a leaf, added up over all leaves; and the most for one.
    fn path_pages(tree: &Tree, blocking: Blocking) -> (u64, u32) {
        let blocks = reference::block(tree, blocking).unwrap();
        let (mut sum, mut most) = (0, 0);
        for page in &blocks.pages {
            for split in blocks.records(page) {
                let node = &tree.splits[*split as usize];
                let leaves = [node.kept, node.born].iter().filter(|child| **child == NO_SPLIT).count();
                sum += leaves as u64 * u64::from(page.level);
                most = most.max(page.level);
            }
        }
        (sum, most)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn figures_add_up(plan in plans(900), blocking in blockings()) {
            let tree = random_tree(&plan);
            let (bytes, summary) = model_bytes(&tree, blocking);
            let found = statistics(&model(&tree, blocking)).unwrap();
            prop_assert_eq!(found.file.total(), bytes.len() as u64);
            let model = model(&tree, blocking);
            let pages = all_pages(&model);
            let decoded: usize = pages.iter().map(|(_, page)| page.counts().decoded_bytes()).sum();
            prop_assert_eq!(found.decoded.total(), (decoded + tree.roots.len() * ROOT_WORDS * 4) as u64);
            let heads = pages.iter().map(|(_, page)| match page.children().len() {
                0 => 24,
                children => 36 + 6 * children as u64,
            });
            prop_assert_eq!(found.file.page_heads, heads.sum::<u64>());
            // Every leaf stands somewhere once, every triangle has three corners.
            let drawn = 12 * (tree.leaf_count() + tree.triangles.corners.len()) as u64;
            prop_assert_eq!(found.decoded.data(), drawn);
            prop_assert_eq!(found.pages, u64::from(summary.pages));
            prop_assert_eq!(found.fill_histogram.iter().sum::<u64>(), found.pages);
            prop_assert!((found.mean_fill - summary.fill).abs() < 1e-9);
            prop_assert!(found.least_fill <= found.mean_fill);
            prop_assert!(found.oversized_pages <= found.single_split_pages);
            let splits = (tree.leaf_count() - tree.roots.len()) as f64;
            prop_assert!((found.records_per_page * found.pages as f64 - splits).abs() < 1e-6);
            let (sum, most) = path_pages(&tree, blocking);
            prop_assert!((found.pages_per_path - sum as f64 / tree.leaf_count() as f64).abs() < 1e-9);
            prop_assert_eq!(found.longest_path, most);
        }
    }

    #[test]
    fn an_empty_model_has_figures() {
        let found = statistics(&model(&Tree::default(), Blocking::default())).unwrap();
        assert_eq!((found.pages, found.file.fields, found.least_fill, found.longest_path), (0, 0, 0.0, 0));
    }
}
