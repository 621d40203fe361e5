//! Checks a whole model file, believing nothing that it says (design, 6: invariants 1 and 7).
//!
//! Two passes over the pages. The *first*, in the order of the file, decodes each page (so: checksums, lengths, all that
//! [`crate::page`] can check in one page) and makes sure that the pages tile the file from the tables to its end, in the
//! order of their numbers, and that the child tables, page by page, claim each page but the root pages once, in the
//! order of the numbers. The *second* follows the references from the root table down, so it reads each page at the
//! place that its parent gives, and checks what the tree promises:
//!
//! - a page's roots are the nodes that refer to it, each once, by ascending leaf, and the trees that the root table says
//!   begin there; its leaf interval is theirs;
//! - each born leaf divides its node's interval, and a child is a leaf just where a single leaf is left: so every leaf
//!   that does not begin a tree is born once;
//! - ids fall strictly from parent to child, switch values never rise; all ids together have the sum and the exclusive
//!   or of the whole range (that they are unique cannot be seen in constant memory);
//! - a child's sphere lies in its parent's, and each born leaf in its node's;
//! - a born triangle has its first corner under the kept child, one of the others under the born child, and the third
//!   outside the node; the triangles of a split ascend strictly;
//! - the counts, sizes and bounds in the header are those found.
//!
//! Not checked: that the normal cones hold the normals of the surface, and that the splits and triangles are those of
//! some mesh that one would want.
//!
//! Spheres: radii are sums of rounded distances. A child may stick out by [`SPHERE_TOLERANCE`] of its parent's radius.
//!
//! RAM: the root table and 4 bytes for each tree, one page, and for the pages on one path the nodes that lead to their
//! children (40 bytes each). Time: each page is read twice.

use std::path::PathBuf;

use thiserror::Error;

use crate::header::{ModelError, ModelRoot};
use crate::model::Model;
use crate::page::{ChildEntry, HEADER_WORDS, Page, PageLocation, Record, Target, encoded_length_by_header};

/// How far a child's sphere may stick out of its parent's, as a part of the parent's radius: 2⁻²⁰, eight units in the
/// last place of a 32-bit float.
pub const SPHERE_TOLERANCE: f64 = 1.0 / (1 << 20) as f64;

/// What is wrong with a model file, and where.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum VerifyError {
    /// The disk failed, or a page cannot be decoded.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A meta-node breaks a promise of the format.
    #[error("{}: meta-node {} at byte {}: {problem}", path.display(), location.number, location.offset)]
    Page {
        /// The file in question.
        path: PathBuf,
        /// The page.
        location: PageLocation,
        /// What is wrong with it.
        problem: String,
    },
    /// A record breaks a promise of the tree.
    #[error("{}: meta-node {} at byte {}, record {record}: {problem}", path.display(), location.number, location.offset)]
    Record {
        /// The file in question.
        path: PathBuf,
        /// The page.
        location: PageLocation,
        /// Index of the record in the page.
        record: u16,
        /// What is wrong with it.
        problem: String,
    },
    /// The root table does not fit the pages.
    #[error("{}: root table, tree {tree}: {problem}", path.display())]
    Root {
        /// The file in question.
        path: PathBuf,
        /// Which tree, counted from 0.
        tree: u32,
        /// What is wrong with it.
        problem: String,
    },
    /// The header promises something else than there is.
    #[error("{}: header: {what}: {promised} promised, {found} found", path.display())]
    Header {
        /// The file in question.
        path: PathBuf,
        /// What was counted.
        what: &'static str,
        /// What the header says.
        promised: String,
        /// What there is.
        found: String,
    },
}

/// What was found in a sound model file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VerifyReport {
    /// Leaves, that is vertices of the mesh.
    pub leaves: u32,
    /// Inner nodes.
    pub splits: u32,
    /// Triangles of the mesh.
    pub triangles: u32,
    /// Trees, that is components.
    pub roots: u32,
    /// Meta-nodes.
    pub pages: u32,
    /// Levels of the meta-node tree.
    pub page_levels: u32,
    /// Bytes read and checked: those of the file.
    pub bytes: u64,
}

/// Checks the whole of `model`. `progress` is told the part done, from 0 to 1, now and then.
pub fn verify(model: &Model, progress: &mut dyn FnMut(f64)) -> Result<VerifyReport, VerifyError> {
    check_tiling(model, progress)?;
    let found = Descent::new(model).run(progress)?;
    found.compare(model)?;
    progress(1.0);
    let header = model.header();
    Ok(VerifyReport {
        leaves: header.leaf_count,
        splits: header.split_count,
        triangles: header.triangle_count,
        roots: header.root_count,
        pages: header.page_count,
        page_levels: header.page_levels,
        bytes: header.file_length,
    })
}

/// The error that the header promises something else than there is.
fn header_error(model: &Model, what: &'static str, promised: impl ToString, found: impl ToString) -> VerifyError {
    VerifyError::Header { path: model.path().into(), what, promised: promised.to_string(), found: found.to_string() }
}

/// The first pass: the pages follow each other to the end of the file, and so do their claims to children.
fn check_tiling(model: &Model, progress: &mut dyn FnMut(f64)) -> Result<(), VerifyError> {
    let header = model.header();
    let broken = |location: PageLocation, problem: String| {
        Err(VerifyError::Page { path: model.path().into(), location, problem })
    };
    let mut page = model.empty_page();
    let mut staging = Vec::new();
    let mut offset = header.pages_offset;
    let mut largest = 0;
    // What no page has claimed as a child yet.
    let mut next_child = header.root_page_count;
    let mut next_child_offset =
        model.root_pages().iter().fold(header.pages_offset, |offset, page| offset.saturating_add(page.length.into()));
    for number in 0..header.page_count {
        progress(0.5 * f64::from(number) / f64::from(header.page_count));
        let mut start = [0; HEADER_WORDS * 4];
        model.read_bytes(offset, &mut start)?;
        let mut words = [0; HEADER_WORDS];
        words.iter_mut().zip(start.as_chunks::<4>().0).for_each(|(word, bytes)| *word = u32::from_le_bytes(*bytes));
        let length = u32::try_from(encoded_length_by_header(&words)).unwrap_or(u32::MAX);
        let location = PageLocation { number, offset, length };
        model.read_page(location, &mut staging, &mut page)?;
        offset += u64::from(length);
        largest = largest.max(page.counts().decoded_bytes());

        match model.root_pages().get(number as usize) {
            Some(root_page) if *root_page != location => {
                return broken(location, format!("the root page table has it at byte {}", root_page.offset));
            }
            Some(_) if page.parent().is_some() => {
                return broken(location, format!("a root page whose parent is {:?}", page.parent()));
            }
            None if page.parent().is_none() => return broken(location, "no root page, but without a parent".into()),
            _ => {}
        }
        if let Some(first) = page.children().next() {
            if (first.number, first.offset) != (next_child, next_child_offset) {
                let problem = format!(
                    "its children begin with meta-node {} at byte {}, where {next_child} at byte {next_child_offset} is due",
                    first.number, first.offset
                );
                return broken(location, problem);
            }
            next_child = next_child.saturating_add(page.counts().children as u32);
            next_child_offset =
                page.children().fold(next_child_offset, |offset, child| offset.saturating_add(child.length.into()));
        }
    }
    if offset != header.file_length {
        return Err(header_error(model, "end of the meta-nodes", header.file_length, offset));
    }
    if next_child != header.page_count || next_child_offset != header.file_length {
        return Err(header_error(
            model,
            "meta-nodes with a parent or in the root page table",
            header.page_count,
            next_child,
        ));
    }
    if largest != header.slot_bytes as usize {
        return Err(header_error(model, "bytes of the largest meta-node", header.slot_bytes, largest));
    }
    Ok(())
}

/// A node that splits: what is known of it before its record is read.
#[derive(Debug, Clone, Copy)]
struct Node {
    start: u32,
    end: u32,
    position: [f32; 3],
    id: u32,
    switch: f32,
    radius: f32,
    /// Index of its record.
    record: u16,
}

impl Node {
    fn of_root(root: &ModelRoot) -> Self {
        Node {
            start: root.start,
            end: root.end,
            position: root.position,
            id: root.id,
            switch: root.switch,
            radius: root.radius,
            record: root.record,
        }
    }
}

/// A page that is to be checked: where, and which nodes refer to it.
struct Visit {
    location: PageLocation,
    parent: Option<u32>,
    level: u32,
    nodes: Vec<Node>,
}

/// What the second pass counts, to be compared with the header.
struct Found {
    splits: u64,
    triangles: u64,
    pages: u64,
    roots: u64,
    levels: u32,
    largest_switch: f32,
    bounds: Option<([f32; 3], [f32; 3])>,
    id_sum: u128,
    id_xor: u64,
}

impl Found {
    fn add_position(&mut self, position: [f32; 3]) {
        let (minimum, maximum) = self.bounds.get_or_insert((position, position));
        for axis in 0..3 {
            minimum[axis] = minimum[axis].min(position[axis]);
            maximum[axis] = maximum[axis].max(position[axis]);
        }
    }

    fn check_id(&mut self, model: &Model, id: u32) -> Result<(), String> {
        let first = u64::from(model.header().leaf_count);
        let end = first + u64::from(model.header().split_count);
        if !(first..end).contains(&id.into()) {
            return Err(format!("the id {id} is none of {first}..{end}"));
        }
        self.id_sum += u128::from(id);
        self.id_xor ^= u64::from(id);
        Ok(())
    }

    fn compare(&self, model: &Model) -> Result<(), VerifyError> {
        let header = model.header();
        let counts = [
            ("splits", header.split_count, self.splits),
            ("triangles", header.triangle_count, self.triangles),
            ("meta-nodes", header.page_count, self.pages),
            ("trees", header.root_count, self.roots),
            ("levels of meta-nodes", header.page_levels, self.levels.into()),
        ];
        for (what, promised, found) in counts {
            if u64::from(promised) != found {
                return Err(header_error(model, what, promised, found));
            }
        }
        if header.largest_switch != self.largest_switch {
            return Err(header_error(model, "largest switch value", header.largest_switch, self.largest_switch));
        }
        let (minimum, maximum) = self.bounds.unwrap_or_default();
        if (header.minimum, header.maximum) != (minimum, maximum) {
            let promised = format!("{:?} to {:?}", header.minimum, header.maximum);
            return Err(header_error(model, "bounding box", promised, format!("{minimum:?} to {maximum:?}")));
        }
        let (first, end) = (u64::from(header.leaf_count), u64::from(header.leaf_count) + u64::from(header.split_count));
        let sum = (u128::from(first) + u128::from(end)).saturating_sub(1) * u128::from(end - first) / 2;
        if self.id_sum != sum || self.id_xor != xor_below(end) ^ xor_below(first) {
            let promised = format!("each of {first}..{end} once");
            let found = format!("others: their sum is {}, their exclusive or {}", self.id_sum, self.id_xor);
            return Err(header_error(model, "dependency ids", promised, found));
        }
        Ok(())
    }
}

/// The exclusive or of all numbers below `end`.
fn xor_below(end: u64) -> u64 {
    match (end % 4, end.saturating_sub(1)) {
        (0, _) => 0,
        (1, last) => last,
        (2, _) => 1,
        (_, last) => last + 1,
    }
}

/// The second pass, from the root table down.
struct Descent<'a> {
    model: &'a Model,
    roots_by_page: Vec<u32>,
    found: Found,
}

impl<'a> Descent<'a> {
    fn new(model: &'a Model) -> Self {
        let found = Found {
            splits: 0,
            triangles: 0,
            pages: 0,
            roots: 0,
            levels: 0,
            largest_switch: 0.0,
            bounds: None,
            id_sum: 0,
            id_xor: 0,
        };
        Descent { model, roots_by_page: model.roots_by_page(), found }
    }

    fn run(mut self, progress: &mut dyn FnMut(f64)) -> Result<Found, VerifyError> {
        let model = self.model;
        let page_count = f64::from(model.header().page_count);
        let mut page = model.empty_page();
        let mut staging = Vec::new();
        let first = |location: &PageLocation| Visit { location: *location, parent: None, level: 1, nodes: Vec::new() };
        let mut stack: Vec<Visit> = model.root_pages().iter().rev().map(first).collect();
        while let Some(visit) = stack.pop() {
            progress(0.5 + 0.5 * self.found.pages as f64 / page_count);
            model.read_page(visit.location, &mut staging, &mut page)?;
            let (location, level) = (visit.location, visit.level);
            if page.parent() != visit.parent {
                let problem = format!("its parent is given as {:?}, it is {:?}", page.parent(), visit.parent);
                return Err(self.page_error(location, problem));
            }
            self.found.pages += 1;
            self.found.levels = self.found.levels.max(level);
            let nodes = self.page_roots(visit, &page)?;
            let below = self.check_page(location, &page, nodes)?;
            let first = stack.len();
            let parent = Some(location.number);
            let visits = page.children().zip(below);
            stack.extend(visits.map(|(location, nodes)| Visit { location, parent, level: level + 1, nodes }));
            stack[first..].reverse();
        }
        Ok(self.found)
    }

    fn page_error(&self, location: PageLocation, problem: String) -> VerifyError {
        VerifyError::Page { path: self.model.path().into(), location, problem }
    }

    fn record_error(&self, location: PageLocation, record: usize, problem: String) -> VerifyError {
        VerifyError::Record { path: self.model.path().into(), location, record: record as u16, problem }
    }

    /// The nodes at the roots of a page: those that its parent's entries refer to, and the trees that begin here.
    fn page_roots(&mut self, visit: Visit, page: &Page) -> Result<Vec<Node>, VerifyError> {
        let Visit { location, mut nodes, .. } = visit;
        for tree in self.model.roots_in_page(&self.roots_by_page, location.number).to_vec() {
            let root = &self.model.roots()[tree as usize];
            let wrong = |problem| VerifyError::Root { path: self.model.path().into(), tree, problem };
            if root.page != location {
                return Err(wrong(format!("meta-node {} is not at byte {}", location.number, root.page.offset)));
            }
            self.found.check_id(self.model, root.id).map_err(wrong)?;
            nodes.push(Node::of_root(root));
            self.found.roots += 1;
            self.found.add_position(root.position);
            self.found.largest_switch = self.found.largest_switch.max(root.switch);
        }
        nodes.sort_by_key(|node| node.record);
        let records = nodes.iter().map(|node| usize::from(node.record));
        if !records.eq(0..page.root_count()) {
            let records: Vec<u16> = nodes.iter().map(|node| node.record).collect();
            let problem = format!("its {} roots are not what is referred to: {records:?}", page.root_count());
            return Err(self.page_error(location, problem));
        }
        if let Some(pair) = nodes.array_windows().position(|[one, next]: &[Node; 2]| one.end > next.start) {
            let problem = format!("its leaves do not come before those of root {}", pair + 1);
            return Err(self.record_error(location, pair, problem));
        }
        let interval = (nodes.first().map_or(0, |node| node.start), nodes.last().map_or(0, |node| node.end));
        if page.leaf_interval() != interval {
            let problem = format!("its leaves are given as {:?}, they are {interval:?}", page.leaf_interval());
            return Err(self.page_error(location, problem));
        }
        Ok(nodes)
    }

    /// Checks the records of a page whose roots are `nodes`, and gives the nodes that lead to each child page.
    fn check_page(
        &mut self,
        location: PageLocation,
        page: &Page,
        mut nodes: Vec<Node>,
    ) -> Result<Vec<Vec<Node>>, VerifyError> {
        let mut frontier = Vec::new();
        for index in 0..page.counts().records {
            // Decoding has made sure that each record behind the roots is referred to by one before it.
            let (Some(&node), Some(record)) = (nodes.get(index), page.record(index as u16)) else {
                return Err(self.record_error(location, index, "nothing refers to it".into()));
            };
            let children = self.check_record(&node, &record);
            let children = children.map_err(|problem| self.record_error(location, index, problem))?;
            for (child, target) in children.into_iter().flatten() {
                match target {
                    Target::SamePage { .. } => nodes.push(child),
                    Target::ChildPage { child: page, .. } => frontier.push((page, child)),
                }
            }
            let triangles = self.check_triangles(&node, &record, page.triangles(index as u16));
            triangles.map_err(|problem| self.record_error(location, index, problem))?;
        }
        // In the order of the leaves the child pages ascend: each has a contiguous part of the frontier.
        frontier.sort_by_key(|(_, node): &(u16, Node)| node.start);
        if let Some([_, (child, node)]) = frontier.array_windows().find(|[(one, _), (next, _)]| one > next) {
            let problem = format!("leaf {} leads to child {child}, a leaf before it to a later one", node.start);
            return Err(self.page_error(location, problem));
        }
        let mut below = vec![Vec::new(); page.counts().children];
        for (child, node) in frontier {
            below[usize::from(child)].push(node);
        }
        Ok(below)
    }

    /// Checks a split and what it says of its children; gives those that split further.
    fn check_record(&mut self, node: &Node, record: &Record) -> Result<[Option<(Node, Target)>; 2], String> {
        let Node { start, end, .. } = *node;
        let born_leaf = record.born_leaf;
        if born_leaf <= start || born_leaf >= end {
            return Err(format!("its born leaf {born_leaf} does not divide the leaves {start}..{end}"));
        }
        self.found.splits += 1;
        self.found.add_position(record.position);
        let kept = self.check_child(node, record.kept, (start, born_leaf), node.position)?;
        let born = self.check_child(node, record.born, (born_leaf, end), record.position)?;
        Ok([kept, born])
    }

    fn check_child(
        &mut self,
        parent: &Node,
        entry: Option<ChildEntry>,
        (start, end): (u32, u32),
        position: [f32; 3],
    ) -> Result<Option<(Node, Target)>, String> {
        if entry.is_none() != (end - start == 1) {
            let kind = if entry.is_none() { "a leaf" } else { "a node that splits" };
            return Err(format!("the child with the leaves {start}..{end} is {kind}"));
        }
        let distance: f64 =
            (0..3).map(|axis| f64::from(position[axis]) - f64::from(parent.position[axis])).map(|d| d * d).sum();
        let reach = distance.sqrt() + entry.map_or(0.0, |entry| f64::from(entry.radius));
        if reach > f64::from(parent.radius) * (1.0 + SPHERE_TOLERANCE) {
            let radius = parent.radius;
            return Err(format!(
                "the child with the leaves {start}..{end} reaches {reach} out of a sphere of {radius}"
            ));
        }
        let Some(entry) = entry else { return Ok(None) };
        self.found.check_id(self.model, entry.id)?;
        if entry.id >= parent.id {
            return Err(format!("the id {} of a child is not below its parent's, {}", entry.id, parent.id));
        }
        if entry.switch > parent.switch {
            let problem =
                format!("the switch value {} of a child is above its parent's, {}", entry.switch, parent.switch);
            return Err(problem);
        }
        let (Target::SamePage { record } | Target::ChildPage { record, .. }) = entry.target;
        let node = Node { start, end, position, id: entry.id, switch: entry.switch, radius: entry.radius, record };
        Ok(Some((node, entry.target)))
    }

    fn check_triangles(
        &mut self,
        node: &Node,
        record: &Record,
        triangles: impl Iterator<Item = [u32; 3]>,
    ) -> Result<(), String> {
        let (kept, born) = (node.start..record.born_leaf, record.born_leaf..node.end);
        let mut before = None;
        for corners in triangles {
            let [first, second, third] = corners;
            let under_born = u32::from(born.contains(&second)) + u32::from(born.contains(&third));
            let outside = [second, third].iter().filter(|leaf| !(node.start..node.end).contains(leaf)).count();
            if !kept.contains(&first) || under_born != 1 || outside != 1 {
                let problem = format!("the triangle {corners:?} is not born between {kept:?} and {born:?}");
                return Err(problem);
            }
            if before.is_some_and(|before| before >= corners) {
                return Err(format!("the triangle {corners:?} stands behind {:?}", before.unwrap_or_default()));
            }
            before = Some(corners);
            self.found.triangles += 1;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::path::Path;
    use std::sync::Arc;

    use proptest::prelude::*;
    use storage::{FaultyDisk, MemoryDisk};
    use vdt::tree::Tree;

    use super::*;
    use crate::cut::{UniformCut, error_for_triangles};
    use crate::header::{Blocking, ROOT_WORDS};
    use crate::page::{CHILD_PAGE_WORDS, ENTRY_WORDS, RECORD_WORDS};
    use crate::statistics::statistics;
    use crate::testing::{Random, Shape, TreePlan, blockings, model_bytes, open_bytes, plans, random_tree};

    const SMALL: Blocking = Blocking::Forest { slot_bytes: 4096, fan_out: 2 };

    fn check(bytes: impl Into<Vec<u8>>) -> Result<VerifyReport, VerifyError> {
        verify(&open_bytes(bytes)?, &mut |_| ())
    }

    /// Several pages on several levels, several trees, one of which begins in no root page.
    fn small_tree(leaves: u32) -> Tree {
        let plan = TreePlan {
            seed: 3,
            leaves,
            components: leaves / 9,
            triangles: leaves,
            shape: Shape::Random,
            hub: 0,
            reach: 30,
        };
        random_tree(&plan)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        #[test]
        fn what_is_written_is_sound(plan in plans(2500), blocking in blockings()) {
            let tree = random_tree(&plan);
            let (bytes, summary) = model_bytes(&tree, blocking);
            let length = bytes.len() as u64;
            let model = open_bytes(bytes).unwrap();
            let mut last = 0.0;
            let report = verify(&model, &mut |done| {
                assert!(last <= done && done <= 1.0);
                last = done;
            });
            let report = report.map_err(|error| TestCaseError::fail(error.to_string()))?;
            prop_assert_eq!(last, 1.0);
            prop_assert_eq!(report.leaves as usize, tree.leaf_count());
            prop_assert_eq!(report.splits as usize, tree.leaf_count() - tree.roots.len());
            prop_assert_eq!(report.triangles as usize, tree.triangles.corners.len());
            prop_assert_eq!(report.roots as usize, tree.roots.len());
            prop_assert_eq!((report.pages, report.page_levels), (summary.pages, summary.page_levels));
            prop_assert_eq!(report.bytes, length);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        /// Several wrong words at once: all that reads ends, and whatever passes can be read.
        #[test]
        fn what_passes_can_be_read(seed in any::<u64>(), count in 1..6) {
            let mut random = Random(seed);
            let blocking = if seed % 2 == 0 { SMALL } else { Blocking::Levels { levels: 3 } };
            let (mut bytes, _) = model_bytes(&small_tree(130), blocking);
            let stretches = stretches(&bytes);
            for _ in 0..count {
                let stretch = &stretches[random.below(stretches.len())];
                // Mostly where the references are.
                let words = if random.below(2) == 0 { stretch.words.len().min(20) } else { stretch.words.len() };
                let at = stretch.start + random.below(words) * 4;
                let other = stretch.start + random.below(words) * 4;
                let old = word_at(&bytes, at);
                let word = match random.below(4) {
                    0 => old.wrapping_add(random.below(7) as u32).wrapping_sub(3),
                    1 => old.wrapping_add((random.below(7) as u32) << 16).wrapping_sub(3 << 16),
                    2 => word_at(&bytes, other),
                    _ => old ^ 1 << random.below(32),
                };
                bytes = alter(&bytes, stretch, at, word);
            }
            if let Ok(model) = open_bytes(bytes) {
                let sound = verify(&model, &mut |_| ()).is_ok();
                let read = || {
                    let cut = UniformCut::new(&model, 0.0)?;
                    let (mut vertices, mut triangles) = (0, 0);
                    cut.for_each_vertex(|_| {
                        vertices += 1;
                        Ok::<_, ModelError>(())
                    })?;
                    cut.for_each_triangle(|_| {
                        triangles += 1;
                        Ok::<_, ModelError>(())
                    })?;
                    statistics(&model)?;
                    error_for_triangles(&model, 50)?;
                    Ok::<_, ModelError>((vertices, triangles))
                };
                let counts = read();
                if sound {
                    prop_assert_eq!(counts.unwrap(), (model.header().leaf_count, model.header().triangle_count));
                }
            }
        }
    }

    #[test]
    fn an_empty_model_is_sound() {
        let report = check(model_bytes(&Tree::default(), SMALL).0).unwrap();
        assert_eq!((report.leaves, report.pages, report.bytes), (0, 0, 260));
    }

    #[test]
    fn every_altered_byte_is_found() {
        for (leaves, blocking) in [(380, SMALL), (130, Blocking::Levels { levels: 3 })] {
            let (bytes, summary) = model_bytes(&small_tree(leaves), blocking);
            assert!(summary.pages >= 5 && summary.page_levels > 2, "{summary:?}");
            check(bytes.clone()).unwrap();
            for index in 0..bytes.len() {
                let mut altered = bytes.clone();
                altered[index] ^= if index % 2 == 0 { 0xff } else { 1 << (index / 2 % 8) };
                assert!(check(altered).is_err(), "byte {index}");
            }
        }
    }

    #[test]
    fn every_length_but_the_right_one_is_refused() {
        let (bytes, _) = model_bytes(&small_tree(380), SMALL);
        for length in 0..bytes.len() {
            assert!(check(&bytes[..length]).is_err(), "{length} bytes");
        }
        for more in [1, 4, 4096] {
            let mut longer = bytes.clone();
            longer.resize(bytes.len() + more, 0);
            assert!(check(longer).unwrap_err().to_string().contains("appended"));
        }
    }

    #[test]
    fn a_read_that_fails_is_reported() {
        let (bytes, summary) = model_bytes(&small_tree(380), SMALL);
        let memory = MemoryDisk::new();
        memory.insert("model.vdt", bytes);
        let disk = FaultyDisk::new(Arc::new(memory));
        let model = Model::open(&disk, Path::new("model.vdt")).unwrap();
        for reads in 0..u64::from(summary.pages) * 3 {
            disk.fail_reads_after(reads);
            let message = verify(&model, &mut |_| ()).unwrap_err().to_string();
            assert!(message.contains("model.vdt") && message.contains("injected fault"), "{message}");
        }
        disk.fail_reads_after(u64::from(summary.pages) * 3);
        verify(&model, &mut |_| ()).unwrap();
    }

    /// What a word of the file is: whether another value there can be as good.
    #[derive(Debug, Clone, Copy, PartialEq)]
    enum Word {
        /// Any change breaks something that verify promises to find.
        Fixed,
        /// A coordinate, radius, switch value, cone, corner or the like: a change may give another sound model.
        Free,
    }

    /// A stretch of the file under one checksum: its first byte, and what its words are. The checksum follows.
    struct Stretch {
        start: usize,
        words: Vec<Word>,
    }

    fn stretches(bytes: &[u8]) -> Vec<Stretch> {
        let model = open_bytes(bytes).unwrap();
        let header = model.header();
        let free = |from: std::ops::Range<usize>, words: &mut [Word]| words[from].fill(Word::Free);
        // The header: origin, metric, strategy, error bound, the blocking's parameters and the input error tell of the
        // making only.
        let mut words = vec![Word::Fixed; 63];
        free(14..20, &mut words);
        free(27..33, &mut words);
        free(39..40, &mut words);
        let mut found = vec![Stretch { start: 0, words }];
        // The root table: position, switch, radius, cone.
        let mut words = vec![Word::Fixed; (header.pages_offset as usize - 260) / 4];
        for root in 0..model.roots().len() {
            free(root * ROOT_WORDS + 2..root * ROOT_WORDS + 5, &mut words);
            free(root * ROOT_WORDS + 6..root * ROOT_WORDS + 9, &mut words);
        }
        found.push(Stretch { start: 256, words });
        let mut offset = header.pages_offset as usize;
        while offset < bytes.len() {
            let mut start = [0; HEADER_WORDS];
            let stored = bytes[offset..].as_chunks::<4>().0;
            start.iter_mut().zip(stored).for_each(|(word, bytes)| *word = u32::from_le_bytes(*bytes));
            let length = encoded_length_by_header(&start) as usize;
            let mut words = vec![Word::Fixed; length / 4 - 1];
            let records = HEADER_WORDS + (start[2] >> 16) as usize * CHILD_PAGE_WORDS;
            let entries = records + (start[2] & 0xffff) as usize * RECORD_WORDS;
            let triangles = entries + (start[3] >> 16) as usize * ENTRY_WORDS;
            (records..entries).step_by(RECORD_WORDS).for_each(|record| free(record + 1..record + 4, &mut words));
            (entries..triangles).step_by(ENTRY_WORDS).for_each(|entry| free(entry + 1..entry + 4, &mut words));
            let end = words.len();
            free(triangles..end, &mut words);
            found.push(Stretch { start: offset, words });
            offset += length;
        }
        found
    }

    /// Alters the word at byte `at` of a stretch and puts the checksum right.
    fn alter(bytes: &[u8], stretch: &Stretch, at: usize, word: u32) -> Vec<u8> {
        let mut altered = bytes.to_vec();
        altered[at..at + 4].copy_from_slice(&word.to_le_bytes());
        let end = stretch.start + stretch.words.len() * 4;
        let checksum = crc32fast::hash(&altered[stretch.start..end]);
        altered[end..end + 4].copy_from_slice(&checksum.to_le_bytes());
        altered
    }

    fn word_at(bytes: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    /// What reads a model must end with a result whatever the file holds, and only a sound one may be called so.
    #[test]
    fn wrong_words_under_right_checksums_are_found_and_do_no_harm() {
        let mut random = Random(7);
        for (leaves, blocking) in [(380, SMALL), (130, Blocking::Levels { levels: 3 })] {
            let (bytes, _) = model_bytes(&small_tree(leaves), blocking);
            for stretch in stretches(&bytes) {
                for (index, kind) in stretch.words.iter().enumerate() {
                    let at = stretch.start + index * 4;
                    let old = word_at(&bytes, at);
                    let any = stretch.start + random.below(stretch.words.len()) * 4;
                    let values = [
                        old.wrapping_add(1),
                        old.wrapping_sub(1),
                        old ^ 1 << random.below(32),
                        word_at(&bytes, any),
                        0,
                        u32::MAX,
                        random.next() as u32,
                    ];
                    // Each word is made two of them.
                    let from = random.below(values.len());
                    let some = (0..2).map(|turn| values[(from + turn * 3) % values.len()]);
                    for word in some.filter(|word| *word != old) {
                        let altered = alter(&bytes, &stretch, at, word);
                        let sound = catch_unwind(AssertUnwindSafe(|| {
                            let Ok(model) = open_bytes(altered) else { return false };
                            let cut = UniformCut::new(&model, model.header().largest_switch / 2.0);
                            if let Ok(cut) = cut {
                                let _ = cut.for_each_vertex(|_| Ok::<_, ModelError>(()));
                                let _ = cut.for_each_triangle(|_| Ok::<_, ModelError>(()));
                            }
                            let _ = statistics(&model);
                            if index % 16 == 0 {
                                let _ = error_for_triangles(&model, 10);
                            }
                            verify(&model, &mut |_| ()).is_ok()
                        }));
                        let place = format!("{blocking}: byte {at}, {old:#x} made {word:#x}");
                        let sound = sound.unwrap_or_else(|_| panic!("{place}: panicked"));
                        assert!(!sound || *kind == Word::Free, "{place}: called sound");
                    }
                }
            }
        }
    }

    /// The stretch of the page, the index of a record in it, and the byte of one of its entries.
    fn some_entry(bytes: &[u8]) -> (Stretch, usize) {
        let page = stretches(bytes).swap_remove(2);
        let start: Vec<u32> = (0..HEADER_WORDS).map(|word| word_at(bytes, page.start + word * 4)).collect();
        let entries = HEADER_WORDS + (start[2] >> 16) as usize + (start[2] & 0xffff) as usize * RECORD_WORDS;
        let at = page.start + entries * 4;
        (page, at)
    }

    #[test]
    fn a_broken_promise_is_named_with_its_place() {
        let tree = random_tree(&TreePlan {
            seed: 4,
            leaves: 200,
            components: 1,
            triangles: 400,
            shape: Shape::Random,
            hub: 0,
            reach: 30,
        });
        let (bytes, _) = model_bytes(&tree, SMALL);
        let refuse = |bytes: Vec<u8>, expected: &str| {
            let message = check(bytes).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
            message
        };
        let (page, entry) = some_entry(&bytes);
        let root = tree.splits[tree.roots[0].split as usize];
        let above = f32::from_bits(root.switch.to_bits() + 1);
        let message = refuse(alter(&bytes, &page, entry + 4, above.to_bits()), "of a child is above its parent's");
        assert!(message.contains("model.vdt: meta-node 0 at byte 336, record 0"), "{message}");
        refuse(alter(&bytes, &page, entry, root.id), "is not below its parent's");
        refuse(alter(&bytes, &page, entry, 199), "is none of 200..399");
        refuse(alter(&bytes, &page, entry, word_at(&bytes, entry) - 1), "exclusive or");
        refuse(alter(&bytes, &page, entry + 8, (root.radius * 1.001).to_bits()), "out of a sphere");
        refuse(alter(&bytes, &page, page.start + 4, 0), "the parent");
        refuse(alter(&bytes, &page, page.start + 32, 1), "its leaves are given as");
        let triangle = page.start + page.words.len() * 4 - 12;
        refuse(alter(&bytes, &page, triangle, word_at(&bytes, triangle + 4)), "is not born between");
        let header = &stretches(&bytes)[0];
        refuse(alter(&bytes, header, 56 + 24, 0), "bounding box");
        refuse(alter(&bytes, header, 104, 0), "largest switch value");
        refuse(alter(&bytes, header, 52, 1), "levels of meta-nodes");
    }

    #[test]
    fn exclusive_ors_of_ranges() {
        let mut expected = 0;
        for end in 0..40 {
            assert_eq!(xor_below(end), expected);
            expected ^= end;
        }
    }
}
