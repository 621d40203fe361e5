//! The first way through the page tree: how large pages are decoded, what roots of trees begin in which, and how often each symbol
//! comes, which makes the tables that all pages are coded with.
//!
//! Of the pages without children, which are most, not all have to be counted once there are many: every eighth will do, told by
//! its first leaf.
//!
//! Memory: the caches; for each tree 92 bytes.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::AtomicU32;

use vdt::tree::StoredTree;

use super::descent::{self, Visitor};
use super::gather::{Ancestor, Gatherer, Position, Work};
use super::{Totals, WriteError};
use crate::blocking::{BlockingError, Filled, Filler};
use crate::codec::{Counts, Uncounted};
use crate::header::LARGEST_SLOT_BYTES;
use crate::leaf_order::{Nodes, Subtree};
use crate::page::{CHILD_PAGE_WORDS, HEADER_WORDS};

/// A page is large whose leaves, so many times over, the cache cannot hold.
const LARGE: usize = 3;
/// Models of so many leaves and more are counted in part.
const COUNTED_WHOLE: u64 = 1 << 20;
/// One of so many pages is counted then.
const ONE_OF: u32 = 8;

/// Where the root of a tree lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RootPlace {
    /// The page's level and first leaf.
    pub page: (u32, u32),
    pub tree: u32,
    pub record: u16,
}

/// What is known of the pages when all were gone through once.
#[derive(Debug)]
pub(super) struct Counted {
    pub counts: Counts,
    /// By page.
    pub places: Vec<RootPlace>,
    pub totals: Totals,
    /// Words of all pages decoded, and bytes of the largest one.
    pub words: u64,
    pub slot_bytes: u32,
    /// Pages near the root of the page tree as they were filled, by level and first leaf of what they were handed. To fill
    /// one of them takes looking all over a part of the tree that is larger than the cache, several times: not once more.
    pub large: HashMap<(u32, u32), Filled>,
}

/// Fills the pages, and counts.
struct Counter<'a> {
    tree: &'a StoredTree,
    gatherer: Gatherer<'a>,
    counts: Counts,
    places: Vec<RootPlace>,
    totals: Totals,
    words: u64,
    slot_bytes: u32,
    large: HashMap<(u32, u32), Filled>,
}

impl<'a> Visitor<'a> for Counter<'a> {
    fn nodes(&mut self) -> &mut Nodes<'a> {
        &mut self.gatherer.nodes
    }

    fn splits(&self) -> u64 {
        self.totals.splits
    }

    fn fill(&mut self, filler: Filler, level: u32, subtrees: Vec<Subtree>) -> Result<Filled, BlockingError> {
        let (start, end) = (subtrees[0].start, subtrees[subtrees.len() - 1].end);
        let page = filler.fill(&mut self.gatherer.nodes, subtrees)?;
        if !self.gatherer.nodes.holds((end - start) as usize * LARGE) {
            self.large.insert((level, start), page.clone());
        }
        Ok(page)
    }

    fn page(
        &mut self,
        position: &Position,
        page: &Filled,
        children: &[Cow<'_, [Subtree]>],
    ) -> Result<Option<Arc<Ancestor>>, WriteError> {
        let first_leaf = page.records[0].start;
        let mut words = (HEADER_WORDS + children.len() * CHILD_PAGE_WORDS) as u64;
        let mut triangles = 0;
        for (record, subtree) in page.records.iter().enumerate() {
            words += self.gatherer.nodes.split_words(subtree.split)? as u64;
            triangles += self.gatherer.nodes.triangles(subtree.split)?.len() as u64;
            if subtree.is_tree {
                let tree = self.tree.roots.partition_point(|root| root.start < subtree.start) as u32;
                self.places.push(RootPlace { page: (position.level, first_leaf), tree, record: record as u16 });
            }
        }
        if words * 4 > LARGEST_SLOT_BYTES.into() {
            let (splits, triangles) = (page.records.len() as u32, triangles as u32);
            return Err(WriteError::PageTooLarge { leaf: page.records[0].split, bytes: words * 4, splits, triangles });
        }
        self.totals.splits += page.records.len() as u64;
        self.totals.triangles += triangles;
        self.words += words;
        self.slot_bytes = self.slot_bytes.max(words as u32 * 4);
        let is_counted =
            self.tree.leaf_count() < COUNTED_WHOLE || first_leaf.wrapping_mul(0x9e37_79b1) >> 16 & (ONE_OF - 1) == 0;
        if children.is_empty() && !is_counted {
            return Ok(None);
        }
        let gathered = if is_counted {
            self.gatherer.code(position, page, children, &mut self.counts)?
        } else {
            self.gatherer.code(position, page, children, &mut Uncounted)?
        };
        Ok(gathered.ancestor)
    }
}

/// Goes through the pages of a tree. `root_groups` is what the root pages are handed; `progress` is told how many splits more
/// were seen.
pub(super) fn count(
    work: &Work<'_>,
    root_groups: Vec<Vec<Subtree>>,
    progress: &(impl Fn(u64) + Sync),
) -> Result<Counted, WriteError> {
    let Work { tree, filler, resources, .. } = *work;
    let next_number = AtomicU32::new(root_groups.len() as u32);
    let mut counters: Vec<Counter<'_>> = (0..resources.threads.max(1))
        .map(|_| Counter {
            tree,
            gatherer: Gatherer::new(work, &next_number),
            counts: Counts::new(),
            places: Vec::new(),
            totals: Totals::default(),
            words: 0,
            slot_bytes: 0,
            large: HashMap::new(),
        })
        .collect();
    let jobs = descent::first_levels(&mut counters[0], filler, root_groups)?;
    descent::do_jobs(&mut counters, filler, jobs, progress, |_, _| (), |_| ())?;
    let mut counted = Counted {
        counts: Counts::new(),
        places: Vec::new(),
        totals: Totals::default(),
        words: 0,
        slot_bytes: 0,
        large: HashMap::new(),
    };
    for counter in counters {
        counted.counts.add(&counter.counts);
        counted.places.extend(counter.places);
        counted.large.extend(counter.large);
        counted.totals.splits += counter.totals.splits;
        counted.totals.triangles += counter.totals.triangles;
        counted.words += counter.words;
        counted.slot_bytes = counted.slot_bytes.max(counter.slot_bytes);
    }
    counted.places.sort_unstable();
    Ok(counted)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use storage::LocalDisk;

    use super::*;
    use crate::blocking::Filler;
    use crate::codec::{Shape, built_in_to_bytes};
    use crate::header::Blocking;
    use crate::leaf_order::Sums;
    use crate::model::Model;
    use crate::testing::read_back;
    use crate::wedges::RootWedges;
    use crate::write::{WriteResources, trees};

    /// A model counts for what it is up to so many splits, and for no more.
    const MOST_SPLITS: u64 = 20_000;

    /// Makes `codec/built_in.tables` anew, from the models in the folder that `VDT_MODELS` names. (What a model looks like
    /// hardly depends on the tables that were built in when it was written, so once is enough.)
    #[test]
    #[ignore = "changes the format; needs a folder of models in VDT_MODELS"]
    fn the_built_in_tables_made_anew() {
        let folder = std::env::var_os("VDT_MODELS").expect("VDT_MODELS names a folder");
        let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        paths.retain(|path| path.extension().is_some_and(|extension| extension == "vdt"));
        paths.sort();
        let mut all = Counts::new();
        for path in paths {
            let model = Model::open(&LocalDisk, &path).unwrap();
            let tree = StoredTree::from_tree(read_back(&model).tree);
            let splits = u64::from(model.header().split_count);
            let (sums, resources) = (Sums::of(&tree).unwrap(), WriteResources::in_memory());
            let filler = Filler::new(Blocking::default());
            let work = Work {
                tree: &tree,
                shape: Shape::of(&tree).unwrap(),
                sums: &sums,
                root_wedges: &RootWedges::default(),
                filler,
                resources: &resources,
            };
            let counted = count(&work, filler.root_groups(trees(&tree).unwrap()), &|_| ()).unwrap();
            let share = 256 * MOST_SPLITS / splits.max(MOST_SPLITS);
            all.add_share(&counted.counts, share);
            eprintln!("{}: {splits} splits, {share} / 256", path.display());
        }
        let bytes = built_in_to_bytes(&all.classes());
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/codec/built_in.tables");
        eprintln!("{}: {} bytes, CRC-32 {:08x}", path.display(), bytes.len(), crc32fast::hash(&bytes));
        std::fs::write(path, bytes).unwrap();
    }
}
