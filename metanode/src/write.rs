//! Writes a blocked tree as a model file, whatever its size.
//!
//! The pages lie in the file breadth-first, parents before children. To be filled they are gone through depth-first, so
//! that what they need of the tree moves through the leaves from left to right, and that twice: first symbols are counted
//! (`count`), which makes the tables; then the pages are coded (`encode`), and put in their places (`place`). The file appears
//! under its name whole or not at all. Its bytes are a function of the tree and the options: no memory, time, path or
//! thread has a part in them.
//!
//! Memory: what is allowed, for the caches of `leaf_order` and buffers; and on top, for each tree, 100 bytes
//! and the wedges of its first leaf, and for each page on the way from the root down its splits, and the decoded page. I/O: of
//! the tree, splits and triangle counts are read three times, the rest, and images, two or three times; what is coded is
//! written, read, and written into the file.

mod count;
mod descent;
mod encode;
mod gather;
mod leaf_wedges;
mod place;
mod ways;

use std::path::Path;
use std::sync::atomic::AtomicU32;
use std::sync::{Arc, Mutex, PoisonError};

use storage::{AtomicFile, ByteSize, Disk, Scratch, StorageError};
use thiserror::Error;
use vdt::tree::StoredTree;

use crate::appearance::{ImageCheck, ModelAppearance, for_each_chunk};
use crate::blocking::{self, BlockingError, Filler};
use crate::codec::{Shape, Tables};
use crate::header::{
    self, Blocking, ErrorBound, HEADER_BYTES, Header, LARGEST_SLOT_BYTES, Metric, ModelRoot, Positions, Strategy, Way,
};
use crate::leaf_order::{Subtree, Sums, check_place};
use crate::page::{NONE_32, PageLocation};
use count::Counted;
use gather::{Bounds, Gatherer, Work};
use place::{Front, Places};

/// How a model is to be written, and what it says of its origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelOptions {
    /// How the tree is cut into pages.
    pub blocking: Blocking,
    /// The metric that ordered the collapses.
    pub metric: Metric,
    /// How the order of the collapses was found.
    pub strategy: Strategy,
    /// What the switch values are.
    pub error_bound: ErrorBound,
    /// No point of a triangle of the input files is farther than this from the tree's leaves and triangles, in mesh units.
    pub input_error: f32,
    /// How the positions were kept. Bits ask for a tree whose positions are on a lattice.
    pub positions: Positions,
}

/// Why a model was not written. No file is left, or the one that was there before.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The disk failed or is full.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The tree cannot be blocked as asked.
    #[error(transparent)]
    Blocking(#[from] BlockingError),
    /// The input error is no length.
    #[error("an input error of {value} cannot be: it is a length, 0 or more")]
    InputError {
        /// What was given.
        value: f32,
    },
    /// The positions are said to be kept as they cannot be.
    #[error("positions cannot be {positions}, on a lattice with steps of {step}")]
    Positions {
        /// How they are said to be kept.
        positions: Positions,
        /// The step of the tree's lattice; 0 without one.
        step: f32,
    },
    /// An image is no longer as long as it was.
    #[error("the image {name} was changed while the model was written; build it again")]
    Image {
        /// Its name.
        name: String,
    },
    /// A page would be larger than any reader accepts.
    #[error(
        "a meta-node would take {bytes} bytes decoded, more than the {LARGEST_SLOT_BYTES} that can be: \
         its {splits} splits, the first of which bears leaf {leaf}, have {triangles} triangles"
    )]
    PageTooLarge {
        /// The leaf born by its first split.
        leaf: u32,
        /// Its size in bytes, decoded.
        bytes: u64,
        /// Its splits.
        splits: u32,
        /// Their born triangles.
        triangles: u32,
    },
}

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelSummary {
    /// Meta-nodes.
    pub pages: u32,
    /// Meta-nodes without a parent.
    pub root_pages: u32,
    /// Levels of the meta-node tree.
    pub page_levels: u32,
    /// Bytes of the largest page, decoded.
    pub slot_bytes: u32,
    /// Bytes of the file.
    pub bytes: u64,
    /// Mean size of a decoded page, as a part of the slot: the one asked for with `forest`, the largest page with
    /// `levels`. 0 where there are no pages.
    pub fill: f64,
    /// The largest switch value: from this error on only roots are drawn.
    pub largest_switch: f32,
}

impl ModelSummary {
    /// Of a model with this header, whose pages take so many bytes decoded.
    pub(crate) fn of(header: &Header, decoded_bytes: u64) -> Self {
        let slot_bytes = match header.blocking {
            Blocking::Forest { slot_bytes, .. } => slot_bytes,
            Blocking::Levels { .. } => header.slot_bytes,
        };
        let slots = f64::from(header.page_count) * f64::from(slot_bytes);
        ModelSummary {
            pages: header.page_count,
            root_pages: header.root_page_count,
            page_levels: header.page_levels,
            slot_bytes: header.slot_bytes,
            bytes: header.file_length,
            fill: if slots > 0.0 { decoded_bytes as f64 / slots } else { 0.0 },
            largest_switch: header.largest_switch,
        }
    }
}

/// What the writing of a model may use.
#[derive(Debug, Clone)]
pub struct WriteResources {
    /// Where what does not fit in memory goes.
    pub scratch: Scratch,
    /// RAM for what grows with the tree.
    pub memory: ByteSize,
    /// How many threads may work.
    pub threads: usize,
}

impl WriteResources {
    /// For a tree that is small beside the memory of the machine: everything in RAM.
    pub fn in_memory() -> Self {
        WriteResources { scratch: Scratch::in_memory(), memory: ByteSize(u64::MAX), threads: 1 }
    }

    /// So many sixteenths of the memory, in bytes.
    fn share(&self, sixteenths: u64) -> usize {
        usize::try_from(self.memory.0 / 16 * sixteenths).unwrap_or(usize::MAX)
    }

    /// The part of it that each thread has.
    fn thread_share(&self, sixteenths: u64) -> usize {
        self.share(sixteenths) / self.threads.max(1)
    }
}

/// Writes `tree` to the model file `path`, replacing what was there. `progress` is told the share that is done, 0 to 1.
pub fn write_model(
    disk: Arc<dyn Disk>,
    path: &Path,
    tree: &StoredTree,
    options: &ModelOptions,
    resources: &WriteResources,
    progress: &mut (dyn FnMut(f64) + Send),
) -> Result<ModelSummary, WriteError> {
    blocking::check_parameters(options.blocking)?;
    check_arrays(tree)?;
    if !(options.input_error >= 0.0 && options.input_error.is_finite()) {
        return Err(WriteError::InputError { value: options.input_error });
    }
    let (positions, step) = (options.positions, tree.lattice_step);
    if !header::has_lattice(positions, step) {
        return Err(WriteError::Positions { positions, step });
    }
    leaf_wedges::check(tree)?;
    let splits = tree.leaf_count() - tree.roots.len() as u64;
    // Three ways through the pages count each split: counting, coding, which takes most of the time, and placing.
    let work = Mutex::new((0, progress));
    let progress = |part: u64| {
        let (done, progress) = &mut *work.lock().unwrap_or_else(PoisonError::into_inner);
        *done += part;
        progress((*done as f64 / (6 * splits.max(1)) as f64).min(1.0));
    };
    let filler = Filler::new(options.blocking);
    let shape = Shape { texture_density: leaf_wedges::texture_density(tree)?, ..Shape::of(tree)? };
    let sums = Sums::of(tree)?;
    let root_wedges = leaf_wedges::of_roots(tree)?;
    let ways_through = Work { tree, shape, sums: &sums, root_wedges: &root_wedges, filler, resources };
    let root_groups = || Ok::<_, WriteError>(filler.root_groups(trees(tree)?));
    let counted = count::count(&ways_through, root_groups()?, &|part| progress(2 * part))?;
    let totals = counted.totals;
    if totals.splits != splits || totals.triangles != tree.triangles.len() {
        let problem = format!(
            "{} of {splits} splits and {} of {} triangles belong to one of its trees",
            totals.splits,
            totals.triangles,
            tree.triangles.len()
        );
        return Err(BlockingError::Tree { problem }.into());
    }
    let classes = counted.counts.classes_worth_writing();
    let table_bytes = classes.to_bytes(shape.numbers);
    let tables = Tables::new(&classes);
    let code = |part| progress(3 * part);
    let mut coded = encode::encode(&ways_through, &counted, &tables, root_groups()?, &code)?;
    let mut places = Places::of(&mut coded, tree.roots.len(), &counted.places, resources)?;
    let mut ways = ways::ways(&places)?;
    let roots = tree_roots(&ways_through, &places)?;
    let mut header = header_of(&ways_through, options, &counted, &coded.bounds);
    header.page_count = places.pages.len() as u32;
    header.root_page_count = places.root_pages.len() as u32;
    header.way_count = ways.len() as u32;
    header.largest_page_bytes = places.largest;
    header.page_levels = places.levels_start.len() as u32;
    header.largest_switch = roots.iter().map(|root| root.switch).fold(0.0, f32::max);
    header.table_bytes = table_bytes.len() as u32;
    let images = tree.attributes.as_ref().map_or(&[][..], |attributes| &attributes.appearance.images);
    let checks = images.iter().map(|image| ImageCheck::of(disk.as_ref(), image)).collect::<Result<Vec<_>, _>>()?;
    let appearance = match &tree.attributes {
        None => Vec::new(),
        Some(attributes) => ModelAppearance {
            appearance: attributes.appearance.clone(),
            layout: shape.wedges,
            wedge_count: attributes.wedges.len() as u32,
            root_wedges: root_wedges.clone(),
            texture_density: shape.texture_density,
            image_checksums: Vec::new(),
        }
        .to_bytes(&checks),
    };
    header.appearance_bytes = appearance.len() as u32;
    header.image_bytes = ImageCheck::total(&checks);
    // From here on places are counted from the beginning of the file.
    header.pages_offset = header.after_images();
    header.file_length = header.pages_offset + places.bytes;
    places.move_by(header.pages_offset);
    ways.iter_mut().for_each(|way| way.page.offset += header.pages_offset);

    let mut file = AtomicFile::create(disk.clone(), path)?;
    file.set_length(header.file_length)?;
    let mut front = Front::of(&mut file);
    front.push(&header.to_bytes())?;
    front.push(&with_checksum(words_as_bytes(&root_tables(&roots, &places, &ways))))?;
    front.push(&with_checksum(table_bytes))?;
    front.push(&appearance)?;
    for (image, check) in images.iter().zip(&checks) {
        let mut left = check.map_or(0, |check| check.length());
        let changed = || WriteError::Image { name: image.name.clone() };
        for_each_chunk(disk.as_ref(), &image.source, |chunk| {
            left = left.checked_sub(chunk.len() as u64).ok_or_else(changed)?;
            front.push(chunk).map_err(WriteError::from)
        })?;
        if left > 0 {
            return Err(changed());
        }
    }
    place::write_pages(&mut front, header.pages_offset, &places, &coded.fields, &progress)?;
    front.flush()?;
    file.commit()?;
    progress(6 * splits);

    Ok(ModelSummary::of(&header, counted.words * 4))
}

/// The header, without what follows from the places of pages.
fn header_of(work: &Work<'_>, options: &ModelOptions, counted: &Counted, bounds: &Bounds) -> Header {
    let Work { tree, shape, .. } = work;
    let Bounds { minimum, maximum } =
        if tree.roots.is_empty() { Bounds { minimum: [0.0; 3], maximum: [0.0; 3] } } else { *bounds };
    Header {
        leaf_count: tree.leaf_count() as u32,
        triangle_count: tree.triangles.len() as u32,
        split_count: (tree.leaf_count() - tree.roots.len() as u64) as u32,
        root_count: tree.roots.len() as u32,
        page_count: 0,
        root_page_count: 0,
        way_count: 0,
        slot_bytes: counted.slot_bytes,
        largest_page_bytes: 0,
        page_levels: 0,
        origin: tree.origin,
        minimum,
        maximum,
        largest_switch: 0.0,
        metric: options.metric,
        strategy: options.strategy,
        error_bound: options.error_bound,
        input_error: options.input_error,
        exponent: shape.exponent,
        positions: options.positions,
        lattice_step: tree.lattice_step,
        blocking: options.blocking,
        roots_offset: HEADER_BYTES as u64,
        table_bytes: 0,
        appearance_bytes: 0,
        image_bytes: 0,
        pages_offset: 0,
        file_length: 0,
    }
}

/// The roots of the trees, without where their pages lie.
fn tree_roots(work: &Work<'_>, places: &Places) -> Result<Vec<ModelRoot>, WriteError> {
    let next_number = AtomicU32::new(0);
    let mut gatherer = Gatherer::new(work, &next_number);
    let placed = work.tree.roots.iter().zip(&places.roots);
    placed.map(|(root, (_, record))| gatherer.tree_root(*root, *record)).collect()
}

/// The tables behind the header, in words.
fn root_tables(roots: &[ModelRoot], places: &Places, ways: &[Way]) -> Vec<u32> {
    let placed = roots.iter().zip(&places.roots).map(|(root, (page, _))| ModelRoot { page: *page, ..*root });
    let mut words: Vec<u32> = placed.flat_map(|root| root.to_words()).collect();
    for PageLocation { number, offset, length } in &places.root_pages {
        words.extend([*number, *offset as u32, (*offset >> 32) as u32, *length]);
    }
    words.extend(ways.iter().flat_map(Way::to_words));
    words
}

/// The trees, as blocking has them.
fn trees(tree: &StoredTree) -> Result<Vec<Subtree>, BlockingError> {
    let whole =
        tree.roots.iter().map(|root| Subtree { split: root.split, start: root.start, end: root.end, is_tree: true });
    let trees: Vec<Subtree> = whole.collect();
    trees.iter().try_for_each(|tree| check_place(*tree))?;
    Ok(trees)
}

/// What everything else relies on.
fn check_arrays(tree: &StoredTree) -> Result<(), BlockingError> {
    let leaves = tree.leaf_count();
    let fail = |problem| Err(BlockingError::Tree { problem });
    if leaves >= u64::from(NONE_32) {
        return fail(format!("{leaves} leaves are more than 32 bits can number"));
    }
    if tree.triangles.len() > u64::from(u32::MAX) {
        return fail(format!("{} triangles are more than 32 bits can number", tree.triangles.len()));
    }
    if tree.splits.len() != leaves || tree.triangle_counts.len() != leaves {
        let (splits, counts) = (tree.splits.len(), tree.triangle_counts.len());
        return fail(format!("{leaves} leaves, but {splits} splits and {counts} triangle counts"));
    }
    if !tree.origin.iter().all(|value| value.is_finite()) {
        return fail("a coordinate of the origin is not finite".into());
    }
    let mut next_leaf = 0;
    for (index, root) in tree.roots.iter().enumerate() {
        if root.start != next_leaf || root.end <= root.start || u64::from(root.end) > leaves {
            return fail(format!("tree {index} has the leaves {}..{}, after leaf {next_leaf}", root.start, root.end));
        }
        next_leaf = root.end;
    }
    if u64::from(next_leaf) != leaves {
        return fail(format!("the trees end at leaf {next_leaf} of {leaves}"));
    }
    Ok(())
}

/// How much of a tree went into pages.
#[derive(Debug, Clone, Copy, Default)]
struct Totals {
    splits: u64,
    triangles: u64,
}

/// The reader refuses numbers that are not finite.
fn check_values(split: u32, switch: f32, radius: f32) -> Result<(), BlockingError> {
    if switch > 0.0 && switch.is_finite() && radius >= 0.0 && radius.is_finite() {
        return Ok(());
    }
    Err(BlockingError::Tree { problem: format!("split {split}: switch value {switch}, radius {radius}") })
}

/// Words as they are in the file.
fn words_as_bytes(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// Bytes, and behind them their checksum.
fn with_checksum(mut bytes: Vec<u8>) -> Vec<u8> {
    let checksum = crc32fast::hash(&bytes);
    bytes.extend(checksum.to_le_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use storage::{FaultyDisk, MemoryDisk};
    use vdt::tree::{BornTriangles, NO_SPLIT, Tree};

    use super::*;
    use crate::model::{Model, PageReader};
    use crate::page::{Page, PageCounts};
    use crate::reference;
    use crate::testing::{
        Shape, TreePlan, all_pages, blockings, model, model_bytes, open_bytes, options, plans, random_tree, read_back,
    };

    const SMALL: Blocking = Blocking::Forest { slot_bytes: 4096, fan_out: 3 };

    fn small_tree() -> Tree {
        random_tree(&TreePlan {
            seed: 1,
            leaves: 900,
            components: 3,
            triangles: 1800,
            shape: Shape::Random,
            hub: 0,
            reach: 60,
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        fn every_record_comes_back_as_it_was(plan in plans(2500), blocking in blockings()) {
            let tree = random_tree(&plan);
            let (bytes, summary) = model_bytes(&tree, blocking);
            prop_assert_eq!(bytes.len() as u64, summary.bytes);
            prop_assert_eq!(&bytes, &model_bytes(&tree, blocking).0);
            let model = open_bytes(bytes).unwrap();
            prop_assert_eq!(read_back(&model).compare(&tree), Ok(()));
        }

        #[test]
        fn pages_keep_to_the_slot(plan in plans(2500), blocking in blockings()) {
            let tree = random_tree(&plan);
            let blocks = reference::block(&tree, blocking).unwrap();
            let largest = blocks.pages.iter().map(|page| page.counts().decoded_bytes()).max().unwrap();
            prop_assert_eq!(largest, model(&tree, blocking).header().slot_bytes as usize);
            let mut seen = vec![false; tree.leaf_count()];
            for page in &blocks.pages {
                prop_assert!(page.root_count > 0 && page.record_count >= page.root_count);
                for split in blocks.records(page) {
                    prop_assert!(!std::mem::replace(&mut seen[*split as usize], true));
                }
                let PageCounts { records, children, .. } = page.counts();
                match blocking {
                    Blocking::Forest { slot_bytes, fan_out } => {
                        prop_assert!(records == 1 || page.counts().decoded_bytes() <= slot_bytes as usize);
                        prop_assert!(children <= fan_out as usize || plan.hub > 0);
                    }
                    Blocking::Levels { levels } => {
                        prop_assert!(records < 1 << levels && children <= 1 << levels && page.root_count == 1);
                    }
                }
            }
            prop_assert_eq!(seen.iter().filter(|seen| **seen).count(), tree.leaf_count() - tree.roots.len());
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(96))]

        /// Whatever the memory and the threads, the same bytes, which hold what the reference says, page by page; and nothing
        /// is left in the scratch.
        #[test]
        fn the_model_is_that_of_the_reference(
            plan in plans(6000), blocking in blockings(), memory in prop::sample::select(vec![0_u64, 100_000, 1 << 40]),
            threads in 1_usize..4,
        ) {
            let tree = random_tree(&plan);
            let path = Path::new("model.vdt");
            let (bytes, summary) = model_bytes(&tree, blocking);
            let model = open_bytes(bytes.clone()).unwrap();
            let expected = reference::write::expected(&tree, blocking).unwrap();
            prop_assert_eq!(expected.compare(&model, &all_pages(&model), summary), Ok(()));
            let found = MemoryDisk::new();
            let (scratch, _) = Scratch::open(Arc::new(found.clone()), Path::new("scratch"), "test").unwrap();
            let resources = WriteResources { scratch, memory: ByteSize(memory), threads };
            let mut shares = Vec::new();
            let written = write_model(
                Arc::new(found.clone()),
                path,
                &StoredTree::from_tree(tree),
                &options(blocking),
                &resources,
                &mut |share| shares.push(share),
            );
            prop_assert_eq!(written.unwrap(), summary);
            prop_assert!(shares.is_sorted() && shares.last() == Some(&1.0));
            prop_assert!(found.bytes(path) == Some(bytes));
            drop(resources);
            prop_assert_eq!(found.paths(), [path]);
        }
    }

    #[test]
    fn a_tree_that_fits_has_one_page_and_a_large_one_has_full_pages() {
        let tree = small_tree();
        let (_, summary) = model_bytes(&tree, Blocking::Forest { slot_bytes: 1 << 20, fan_out: 8 });
        assert_eq!((summary.pages, summary.page_levels), (1, 1));
        let (_, summary) = model_bytes(&tree, Blocking::Forest { slot_bytes: 4096, fan_out: 8 });
        assert!(summary.fill > 0.7, "{summary:?}");
    }

    #[test]
    fn splits_with_very_many_triangles_have_pages_of_their_own() {
        let plan =
            TreePlan { seed: 9, leaves: 90, components: 1, triangles: 40_000, shape: Shape::Random, hub: 0, reach: 90 };
        let tree = random_tree(&plan);
        let (bytes, summary) = model_bytes(&tree, SMALL);
        assert!(summary.slot_bytes > 4 * 4096, "{summary:?}");
        let blocks = reference::block(&tree, SMALL).unwrap();
        let oversized = blocks.pages.iter().filter(|page| page.counts().decoded_bytes() > 4096);
        assert!(oversized.clone().count() > 5);
        assert!(oversized.clone().all(|page| page.record_count == 1));
        let model = open_bytes(bytes).unwrap();
        assert_eq!(read_back(&model).compare(&tree), Ok(()));
        crate::verify(&model, &mut |_| ()).unwrap();
    }

    #[test]
    fn an_empty_mesh_is_a_model_too() {
        for tree in [
            Tree::default(),
            Tree { triangles: BornTriangles { offsets: vec![0], corners: vec![] }, ..Tree::default() },
        ] {
            for blocking in [SMALL, Blocking::Levels { levels: 5 }] {
                let (bytes, summary) = model_bytes(&tree, blocking);
                assert_eq!((summary.pages, summary.page_levels, summary.fill), (0, 0, 0.0));
                let model = open_bytes(bytes).unwrap();
                assert_eq!((model.header().leaf_count, model.roots().len(), model.root_pages().len()), (0, 0, 0));
            }
        }
    }

    #[test]
    fn a_full_disk_leaves_no_file() {
        let tree = small_tree();
        let (bytes, _) = model_bytes(&tree, SMALL);
        for room in (0..bytes.len() as u64).step_by(4999) {
            let memory = MemoryDisk::new();
            let disk = FaultyDisk::new(Arc::new(memory.clone()));
            disk.full_after(room);
            let tree = StoredTree::from_tree(tree.clone());
            let (path, resources) = (Path::new("model.vdt"), WriteResources::in_memory());
            let error = write_model(Arc::new(disk), path, &tree, &options(SMALL), &resources, &mut |_| ()).unwrap_err();
            assert!(error.to_string().contains("model.vdt"), "{error}");
            assert!(memory.paths().is_empty());
        }
    }

    #[test]
    fn a_read_that_fails_names_the_file() {
        let (bytes, _) = model_bytes(&small_tree(), SMALL);
        let memory = MemoryDisk::new();
        memory.insert("model.vdt", bytes);
        let disk = FaultyDisk::new(Arc::new(memory));
        for reads in 0..3 {
            disk.fail_reads_after(reads);
            let error = Model::open(&disk, Path::new("model.vdt")).unwrap_err();
            assert!(error.to_string().contains("model.vdt"), "{error}");
        }
        disk.heal();
        let model = Model::open(&disk, Path::new("model.vdt")).unwrap();
        disk.fail_reads_after(0);
        let mut page: Page = model.empty_page();
        let error = model.read_page(model.root_pages()[0], &[], &mut PageReader::default(), &mut page).unwrap_err();
        assert!(error.to_string().contains("model.vdt"), "{error}");
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let refuse = |tree: &Tree, blocking| {
            let memory = MemoryDisk::new();
            let tree = StoredTree::from_tree(tree.clone());
            let (path, resources) = (Path::new("m"), WriteResources::in_memory());
            let disk = Arc::new(memory.clone());
            let result = write_model(disk, path, &tree, &options(blocking), &resources, &mut |_| ());
            assert!(memory.paths().is_empty());
            result.unwrap_err().to_string()
        };
        let tree = small_tree();
        assert!(refuse(&tree, Blocking::Forest { slot_bytes: 4095, fan_out: 8 }).contains("4095 bytes"));
        assert!(refuse(&tree, Blocking::Forest { slot_bytes: 4096, fan_out: 1 }).contains("up to 1 children"));
        assert!(refuse(&tree, Blocking::Levels { levels: 16 }).contains("16 levels"));
        let broken = |change: &dyn Fn(&mut Tree)| {
            let mut tree = tree.clone();
            change(&mut tree);
            refuse(&tree, SMALL)
        };
        let root = tree.roots[0];
        let top = root.split as usize;
        assert!(broken(&|tree| tree.splits[top].kept = root.split).contains("divide the leaves"));
        assert!(broken(&|tree| tree.splits[top].born = NO_SPLIT).contains("does not fit its children"));
        assert!(broken(&|tree| tree.splits[top].switch = 0.0).contains("switch value 0"));
        assert!(broken(&|tree| tree.roots[0].end -= 1).contains("tree 1 has the leaves"));
        assert!(broken(&|tree| tree.positions[5][1] = f32::NAN).contains("not finite"));
        assert!(broken(&|tree| tree.triangles.corners[0][0] = 900).contains("corner 900"));
        let message = broken(&|tree| tree.triangles.corners.push([0, 1, 2]));
        assert!(message.contains("triangles belong to one of its trees"), "{message}");
    }
}
