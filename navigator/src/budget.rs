//! How the memory that the user allows is shared out, before anything is allocated.
//!
//! Everything that grows with the model counts: its root table, the place holders, the front's nodes and triangles and
//! the lists of candidates, and the buffers for one page. A page is there with all above it, so the fewest place holders
//! rise with the levels of the page tree. What is left after the fixed parts is shared by the place holders and the
//! front; neither gets more than the whole model needs, and what one cannot use goes to the other.

use std::path::PathBuf;

use metanode::model::Model;
use metanode::page::{ENTRY_WORDS, PageLocation, RECORD_WORDS, TRIANGLE_WORDS};
use metanode::wedges::MOST_WEDGES;
use thiserror::Error;

use crate::board::BOARD_BYTES;
use crate::collapse_queue::CollapseQueue;
use crate::front::{
    CHUNK, Capacity, Corner, LINE_BYTES, MORPH_BYTES, TREE_BYTES, TRIANGLE_BYTES, TRIANGLE_LIMIT, VERTEX_BYTES,
    WedgeKeeping,
};
use crate::io_process::reader_bytes;
use crate::paging::{MAPPED_PAGE_BYTES, WISH_BYTES};
use crate::pool::{LEAST_FOR_URGENT, SLOT_OVERHEAD_BYTES, there_bytes};
use crate::refine::CHAIN_BYTES;
use crate::split_queue::QUEUE_BYTES;

/// Bits for each vertex, each place of a triangle and each slot: whether its number is used, and whether it has changed; rounded up.
const NOTE_BYTES: f64 = 0.5;
/// Cache lines of stars for a vertex. Cuts of scans, terrains and isosurfaces take 1.09 to 1.12.
const LINES_PER_VERTEX: f64 = 1.2;
/// Slots of wedges beyond one for a vertex, in relation to how many there are where seams are curves; and where each vertex has as
/// many as any other. In flights over surfaces of textured patches and over parts of several materials, vertices took 1.2 to 1.7
/// slots; with 1.1 in place of 1.3, slots were what ran out first in some.
const SLOTS_ALONG_CURVES: f64 = 1.3;
const SLOTS_EVERYWHERE: f64 = 1.5;
/// The part of the memory that those who read may take, more than one of them. (Tests have little memory and want several.)
const READERS_SHARE: f64 = if cfg!(test) { 0.5 } else { 0.08 };
/// Bytes of a record in a page, with the entry that leads to it and two born triangles, as most have.
const USUAL_RECORD_BYTES: usize = 4 * (RECORD_WORDS + ENTRY_WORDS + 2 * TRIANGLE_WORDS);
/// The place holders' share. Flights and orbits over three models (dragon, terrain, robot) in 2, 4 and 16 MB, at a
/// tenth of a pixel so that the limits decided, drew 3 to 18 % more triangles with 0.55 than with 0.5, 2 to 4 % more
/// than with 0.6, and clearly more than with 0.3 or 0.7.
const POOL_SHARE: f64 = 0.55;
/// Fewest applied splits that the front has room for, in a model that has as many.
const LEAST_SPLITS: usize = 256;
/// Place holders more than there are pages from which on none is ever missing: by the rule of three, with all pages but
/// one needed, three must not be for the last to be loaded.
pub const SPARE_SLOTS: usize = LEAST_FOR_URGENT - 1;

/// What is allocated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// Place holders.
    pub slots: usize,
    /// Room in the front.
    pub front: Capacity,
    /// Those who read and decode pages.
    pub io_threads: usize,
    /// All of it, in bytes.
    pub bytes: u64,
}

impl Budget {
    /// The same front with all pages of the model in a mapped file in place of place holders.
    pub fn with_mapped_pages(self, model: &Model) -> Self {
        let needs = Needs::of(model, Streams::default());
        let bytes = self.bytes - (self.slots * needs.slot_cost()) as u64 + (needs.pages * MAPPED_PAGE_BYTES) as u64;
        Budget { slots: needs.pages, bytes, ..self }
    }
}

/// The memory allowed is less than the model needs at the least.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error(
    "{}: {memory} bytes of RAM are too few to fly through this model (components: {roots}, meta-nodes of {slot_bytes} \
     bytes on {page_levels} levels); run again with --memory {}K", path.display(), smallest.div_ceil(1024)
)]
pub struct BudgetError {
    /// The model.
    pub path: PathBuf,
    /// Bytes allowed.
    pub memory: u64,
    /// The fewest bytes that work.
    pub smallest: u64,
    /// Roots of the forest.
    pub roots: u32,
    /// Bytes of the largest page, decoded.
    pub slot_bytes: u32,
    /// Levels of the page tree: a page takes those above it.
    pub page_levels: u32,
}

/// The parts of a model that decide what it needs.
struct Needs {
    roots: usize,
    splits: usize,
    triangles: usize,
    pages: usize,
    page_levels: usize,
    slot_bytes: usize,
    /// What is needed whatever the size of pool and front, but for those who read.
    fixed_bytes: usize,
    /// What each of those who read needs.
    reader_bytes: usize,
    io_threads: usize,
    born_triangles: usize,
    /// Wedges of the whole model, and of the roots, where they have slots.
    wedges: usize,
    root_wedges: usize,
    streams: Streams,
}

/// What a front keeps for who draws, besides vertices and triangles.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Streams {
    /// Whether there are geomorphs.
    pub morphs: bool,
    /// How wedges are kept.
    pub wedges: WedgeKeeping,
}

impl Needs {
    fn of(model: &Model, streams: Streams) -> Self {
        let header = model.header();
        let slot_bytes = header.slot_bytes as usize;
        let born_triangles = slot_bytes / 12;
        let slots = model.appearance().filter(|_| streams.wedges == WedgeKeeping::Slots);
        Needs {
            roots: header.root_count as usize,
            splits: header.split_count as usize,
            triangles: header.triangle_count as usize,
            pages: header.page_count as usize,
            page_levels: header.page_levels as usize,
            slot_bytes,
            fixed_bytes: model.resident_bytes()
                + header.root_count as usize * TREE_BYTES
                + header.page_levels as usize * size_of::<PageLocation>()
                + BOARD_BYTES
                + there_bytes(header.page_count as usize)
                + born_triangles * size_of::<Corner>()
                + CHAIN_BYTES,
            reader_bytes: reader_bytes(model, header.page_levels as usize * (slot_bytes / USUAL_RECORD_BYTES)),
            io_threads: 1,
            born_triangles,
            wedges: slots.map_or(0, |appearance| appearance.wedge_count as usize),
            root_wedges: slots.map_or(0, |appearance| appearance.root_wedges.wedge_count()),
            streams,
        }
    }

    fn slot_cost(&self) -> usize {
        self.slot_bytes + SLOT_OVERHEAD_BYTES + WISH_BYTES
    }

    /// Fewest place holders: for the pages above one on the last level, or for one page in use where there is no other
    /// level; and those that the rule of three asks for. So any page can be used (see [`pool`](crate::pool)).
    fn least_slots(&self) -> usize {
        (self.page_levels.saturating_sub(1).max(1) + LEAST_FOR_URGENT).min(self.most_slots())
    }

    fn most_slots(&self) -> usize {
        self.pages + SPARE_SLOTS
    }

    /// Triangles for a front with so many splits: the model's average and a tenth more.
    fn triangles_for(&self, splits: usize) -> usize {
        let average = self.triangles as f64 / self.splits.max(1) as f64;
        ((splits as f64 * average * 1.1) as usize + 64).min(self.triangles).min(TRIANGLE_LIMIT)
    }

    /// Slots of wedges for a front with so many splits: all where it has room for the whole model. Else each vertex has one, and
    /// those beyond lie along seams. Seams are curves: of a surface drawn with a hundredth of its vertices, a tenth of those along
    /// them is left. Where they are everywhere, with faces of many colours, they are as many for each vertex as in the whole
    /// model. There is always room for any leaf's wedges beside those of the roots.
    fn wedges_for(&self, splits: usize) -> usize {
        if splits == self.splits {
            return self.wedges;
        }
        let (vertices, leaves) = (self.roots + splits, self.roots + self.splits);
        let more = self.wedges.saturating_sub(leaves) as f64;
        let part = vertices as f64 / leaves as f64;
        let along_curves = more * part.sqrt() * SLOTS_ALONG_CURVES;
        let everywhere = vertices as f64 * (more / leaves as f64 * SLOTS_EVERYWHERE).max(1.0);
        (vertices + along_curves.min(everywhere) as usize + self.root_wedges + MOST_WEDGES).min(self.wedges)
    }

    fn budget(&self, slots: usize, splits: usize) -> Budget {
        let vertices = (self.roots + splits).next_multiple_of(CHUNK);
        let triangles = self.triangles_for(splits);
        let most_lines = Capacity::most_lines(vertices, triangles);
        let front = Capacity {
            vertices,
            triangles,
            // A front that has room for the whole model has it for any.
            lines: if splits == self.splits { most_lines } else { (vertices as f64 * LINES_PER_VERTEX) as usize + 64 },
            born_triangles: self.born_triangles,
            wedges: self.wedges_for(splits).next_multiple_of(CHUNK),
        };
        let places = Capacity { triangles: front.triangles.next_multiple_of(CHUNK), ..front };
        let bytes = self.fixed_bytes
            + self.io_threads * self.reader_bytes
            + slots * self.slot_cost()
            + front_bytes(&places, self.streams) as usize
            + CollapseQueue::bytes(vertices);
        Budget { slots, front, io_threads: self.io_threads, bytes: bytes as u64 }
    }

    /// The most splits for which a pool of `slots` and a front fit into `bytes`, but no fewer than `least`.
    fn most_splits(&self, slots: usize, least: usize, bytes: u64) -> usize {
        let (mut fits, mut too_many) = (least, self.splits + 1);
        while fits + 1 < too_many {
            let middle = fits + (too_many - fits) / 2;
            if self.budget(slots, middle).bytes <= bytes {
                fits = middle;
            } else {
                too_many = middle;
            }
        }
        fits
    }
}

/// Bytes that a front takes with so many vertices, cache lines of stars, places of triangles and slots of wedges.
pub fn front_bytes(parts: &Capacity, streams: Streams) -> u64 {
    let Capacity { vertices, triangles, lines, wedges, .. } = *parts;
    let Streams { morphs, wedges: keeping } = streams;
    let of_morphs = if morphs { MORPH_BYTES } else { 0 };
    let notes = ((vertices + triangles + wedges) as f64 * NOTE_BYTES) as usize;
    let bytes = vertices * (VERTEX_BYTES + QUEUE_BYTES + of_morphs + keeping.vertex_bytes())
        + lines * LINE_BYTES
        + triangles * (TRIANGLE_BYTES + keeping.triangle_bytes())
        + wedges * keeping.slot_bytes()
        + notes;
    bytes as u64
}

/// Shares out `memory` bytes for `model`, with one thread for I/O.
pub fn plan(model: &Model, memory: u64) -> Result<Budget, BudgetError> {
    plan_with(model, memory, 1, Streams::default())
}

/// Shares out `memory` bytes for `model`, with so many threads for I/O, or fewer, and for a front that keeps this for who draws.
pub fn plan_with(model: &Model, memory: u64, io_threads: usize, streams: Streams) -> Result<Budget, BudgetError> {
    let mut needs = Needs::of(model, streams);
    let least_slots = needs.least_slots();
    let least_splits = LEAST_SPLITS.min(needs.splits);
    let smallest = needs.budget(least_slots, least_splits).bytes;
    if smallest > memory {
        let header = model.header();
        return Err(BudgetError {
            path: model.path().into(),
            memory,
            smallest,
            roots: header.root_count,
            slot_bytes: header.slot_bytes,
            page_levels: header.page_levels,
        });
    }
    let for_readers = (memory as f64 * READERS_SHARE) as u64;
    let most_readers = usize::try_from(for_readers / needs.reader_bytes as u64).unwrap_or(usize::MAX);
    if needs.pages > 1 && memory - smallest >= for_readers {
        needs.io_threads = io_threads.min(most_readers).max(1);
    }
    // At least what the least pool and the least front take, by the check just made.
    let to_share = memory - needs.budget(0, 0).bytes;
    let whole_front = needs.budget(0, needs.splits).bytes - needs.budget(0, 0).bytes;
    let least_front = needs.budget(0, least_splits).bytes - needs.budget(0, 0).bytes;
    let for_pool =
        ((to_share as f64 * POOL_SHARE) as u64).max(to_share.saturating_sub(whole_front)).min(to_share - least_front);
    let slots = usize::try_from(for_pool / needs.slot_cost() as u64).unwrap_or(usize::MAX);
    let slots = slots.clamp(least_slots, needs.most_slots());
    let splits = needs.most_splits(slots, least_splits, memory);
    Ok(needs.budget(slots, splits))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn a_budget_is_kept_and_used() {
        let model = testing::model_of(&testing::grid_tree(40, 40, 1));
        let smallest = plan(&model, 0).unwrap_err().smallest;
        assert!(plan(&model, smallest - 1).is_err());
        let whole = plan(&model, 1 << 40).unwrap();
        assert_eq!(whole.front.vertices, (model.header().leaf_count as usize).next_multiple_of(CHUNK));
        assert_eq!(whole.front.triangles, model.header().triangle_count as usize);
        assert_eq!(whole.slots, model.header().page_count as usize + SPARE_SLOTS);
        // With the last split comes room for the largest stars that there can be.
        let usual_lines = (whole.front.vertices as f64 * LINES_PER_VERTEX) as usize;
        let last_step = ((whole.front.lines - usual_lines) * LINE_BYTES) as u64;
        let unused = 2 * u64::from(model.header().slot_bytes) + (32 << 10) + last_step;
        let mut memory = smallest;
        while memory < whole.bytes {
            let budget = plan(&model, memory).unwrap();
            assert!(budget.bytes <= memory && budget.bytes > memory - unused);
            assert!(budget.slots >= LEAST_FOR_URGENT + model.header().page_levels as usize - 1);
            memory += 1000;
        }
        assert_eq!(plan(&model, whole.bytes).unwrap(), whole);
    }

    /// Attributes take room from place holders and front, but no more than there is; the whole model has it for all wedges.
    #[test]
    fn a_budget_with_attributes_is_kept() {
        let tree = testing::grid_tree(40, 40, 1);
        for seed in 0..8 {
            let model = testing::Attributes::random(&tree, seed).model_of(&tree);
            let (wedges, all) = (WedgeKeeping::of(&model), model.appearance().unwrap().wedge_count as usize);
            let has_slots = wedges == WedgeKeeping::Slots;
            assert_eq!(has_slots, all > tree.leaf_count());
            let plan = |memory: u64| plan_with(&model, memory, 1, Streams { morphs: false, wedges });
            let (smallest, whole) = (plan(0).unwrap_err().smallest, plan(1 << 40).unwrap());
            assert_eq!(whole.front.wedges, if has_slots { all.next_multiple_of(CHUNK) } else { 0 });
            let mut memory = smallest;
            while memory < whole.bytes {
                let (budget, without) = (plan(memory).unwrap(), super::plan(&model, memory).unwrap());
                assert!(budget.bytes <= memory);
                assert!(budget.front.vertices <= without.front.vertices && budget.slots <= without.slots);
                assert!(!has_slots || budget.front.wedges >= (budget.front.vertices + MOST_WEDGES).min(all));
                memory += 3000;
            }
            assert_eq!(plan(whole.bytes).unwrap(), whole);
        }
    }

    #[test]
    fn mapped_pages_take_no_place_holders() {
        let model = testing::model_of(&testing::grid_tree(40, 40, 1));
        let budget = plan(&model, 1 << 20).unwrap();
        let mapped = budget.with_mapped_pages(&model);
        assert!(mapped.bytes < budget.bytes - (budget.slots * 4096) as u64);
        assert_eq!(mapped.front, budget.front);
    }

    #[test]
    fn too_little_is_refused_with_what_would_do() {
        let model = testing::model_of(&testing::grid_tree(40, 40, 1));
        let error = plan(&model, 1000).unwrap_err();
        let (_, number) =
            error.to_string().rsplit_once("--memory ").map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
        let kilobytes: u64 = number.strip_suffix('K').unwrap().parse().unwrap();
        assert!(plan(&model, kilobytes * 1024).is_ok() && plan(&model, (kilobytes - 1) * 1024).is_err());
    }

    #[test]
    fn the_empty_model_needs_next_to_nothing() {
        let model = testing::model_of(&testing::empty_tree());
        assert!(plan(&model, 1 << 20).unwrap().bytes < 1 << 19);
    }
}
