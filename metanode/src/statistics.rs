//! What can be said of a model as a whole: how full its pages are, how long its paths, where its bytes go.
//!
//! One pass over the pages. RAM: one page, those of its entries that lead to other pages for the pages on one path, and
//! 5 bytes for each tree.

use crate::header::{Blocking, ModelError, ROOT_WORDS};
use crate::model::Model;
use crate::page::{CHILD_PAGE_WORDS, ENTRY_WORDS, HEADER_WORDS, RECORD_WORDS, TRIANGLE_WORDS};
use crate::walk::walk;

/// Words of a position, in roots and records.
const POSITION_WORDS: usize = 3;
/// Buckets of the fill histogram.
pub const FILL_BUCKETS: usize = 10;

/// Bytes of a model file, by what they are for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct BytesByPart {
    /// Header, root page table, the checksum of the tables.
    pub tables: u64,
    /// Page headers, child page tables and checksums.
    pub page_headers: u64,
    /// Root table, without positions.
    pub roots: u64,
    /// Records, without positions: born leaves, where the children's entries and the triangles are.
    pub records: u64,
    /// Positions, of roots and records.
    pub positions: u64,
    /// Child entries: ids, switch values, spheres, cones, references.
    pub entries: u64,
    /// Born triangles.
    pub triangles: u64,
}

impl BytesByPart {
    /// All of them.
    pub fn total(&self) -> u64 {
        self.tree() + self.data() + self.directory()
    }

    /// The tree itself: the paper's *VDT* (its Table 1).
    pub fn tree(&self) -> u64 {
        self.roots + self.records + self.entries
    }

    /// What is drawn: the paper's *DATA*.
    pub fn data(&self) -> u64 {
        self.positions + self.triangles
    }

    /// What says where the meta-nodes are: the paper's *MNT*.
    pub fn directory(&self) -> u64 {
        self.tables + self.page_headers
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
    /// Pages on the way from a tree's root to a leaf, on average over the leaves.
    pub pages_per_path: f64,
    /// Pages on the longest of these ways.
    pub longest_path: u32,
    /// Where the bytes of the file go.
    pub bytes: BytesByPart,
}

/// Reads the whole model once and counts.
pub fn statistics(model: &Model) -> Result<ModelStatistics, ModelError> {
    let header = model.header();
    let slot_bytes = match header.blocking {
        Blocking::Forest { slot_bytes, .. } => slot_bytes,
        Blocking::Levels { .. } => header.slot_bytes,
    };
    let mut found = ModelStatistics { slot_bytes, least_fill: f64::INFINITY, ..ModelStatistics::default() };
    let bytes = |words: usize| words as u64 * 4;
    let tree_count = u64::from(header.root_count);
    found.bytes.roots = tree_count * bytes(ROOT_WORDS - POSITION_WORDS);
    found.bytes.positions = tree_count * bytes(POSITION_WORDS);
    // The pages follow the tables, and the header's length was checked against the number of roots.
    found.bytes.tables = header.pages_offset - tree_count * bytes(ROOT_WORDS);
    let (mut records, mut roots, mut children, mut path_pages) = (0, 0, 0, 0);
    walk(model, -1.0, |page, nodes| {
        let counts = page.counts();
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
        roots += page.root_count() as u64;
        children += counts.children as u64;
        for (index, node) in (0..).zip(nodes) {
            let Some(record) = page.record(index) else { continue };
            let leaves = u64::from(record.kept.is_none()) + u64::from(record.born.is_none());
            path_pages += leaves * u64::from(node.pages);
            found.longest_path = found.longest_path.max(node.pages);
        }
        found.bytes.page_headers += bytes(HEADER_WORDS + 1 + counts.children * CHILD_PAGE_WORDS);
        found.bytes.records += bytes(counts.records * (RECORD_WORDS - POSITION_WORDS));
        found.bytes.positions += bytes(counts.records * POSITION_WORDS);
        found.bytes.entries += bytes(counts.entries * ENTRY_WORDS);
        found.bytes.triangles += bytes(counts.triangles * TRIANGLE_WORDS);
        Ok::<_, ModelError>(())
    })?;
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
    use crate::testing::{blockings, model, model_bytes, plans, random_tree};

    /// Pages on the way from the root of a leaf's tree to the leaf, added up over all leaves; and the most for one.
    fn path_pages(tree: &Tree, blocking: Blocking) -> (u64, u32) {
        let blocks = reference::block(tree, blocking).unwrap();
        let mut page_of = vec![0; tree.leaf_count()];
        for (number, page) in blocks.pages.iter().enumerate() {
            blocks.records(page).iter().for_each(|split| page_of[*split as usize] = number);
        }
        let (mut sum, mut most) = (0, 0);
        for root in &tree.roots {
            for leaf in root.start..root.end {
                let (mut split, mut pages, mut page) = (root.split, 0, usize::MAX);
                while split != NO_SPLIT {
                    pages += u32::from(page_of[split as usize] != page);
                    page = page_of[split as usize];
                    let node = &tree.splits[split as usize];
                    split = if leaf < split { node.kept } else { node.born };
                }
                sum += u64::from(pages);
                most = most.max(pages);
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
            prop_assert_eq!(found.bytes.total(), bytes.len() as u64);
            // Every leaf stands somewhere once, every triangle has three corners.
            let drawn = 12 * (tree.leaf_count() + tree.triangles.corners.len()) as u64;
            prop_assert_eq!(found.bytes.data(), drawn);
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
        assert_eq!((found.pages, found.bytes.total(), found.least_fill), (0, 260, 0.0));
        assert_eq!(found.bytes.directory(), 260);
    }
}
