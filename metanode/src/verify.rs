//! Checks a whole model file, believing nothing that it says (design, 6: invariants 1 and 7).
//!
//! One pass over the pages. It follows the references from the root tables down, so it reads each page at the place that
//! its parent gives, with its ancestors at hand, and decodes it (so: checksums, lengths, all that [`crate::page`] can check
//! in one page). On each level of the page tree it comes by the pages from left to right. So it sees whether the children
//! that they claim follow each other, in the numbers and in the file; and in the end, whether each level begins where the
//! one above ends. So the pages tile the file from the tables to its end, in the order of their numbers. And it checks
//! what the tree promises:
//!
//! - a page's roots are the nodes that refer to it, each once, by ascending leaf, and the trees that the root table says
//!   begin there; its leaf interval is theirs;
//! - each born leaf divides its node's interval, and a child is a leaf just where a single leaf is left: so every leaf
//!   that does not begin a tree is born once;
//! - ids fall strictly from parent to child, and each switch value is that of its id, bit for bit (so switch values never
//!   rise);
//! - a tree's switch value is no less than the diagonal of the box of its leaves, at which it vanishes;
//! - a child's sphere lies in its parent's, and each born leaf in its node's;
//! - positions are on the lattice, within its bits, and normals in their square;
//! - a born triangle has its first corner under the kept child, one of the others under the born child, and the third
//!   outside the node in the same tree; the triangles of a split ascend strictly;
//! - the pages of the way table are where it says, below the parents that it says;
//! - there are as many wedges as it says, with materials that there are, and a corner under a born leaf has a wedge that turns
//!   into one of this leaf's; images have their checksums;
//! - the counts, sizes and bounds in the header are those found.
//!
//! Not checked: that the normal cones hold the normals of the surface, and that the splits and triangles are those of
//! some mesh that one would want.
//!
//! Spheres: radii are sums of rounded distances. A child may stick out by [`SPHERE_TOLERANCE`] of its parent's radius.
//!
//! RAM: the root tables and 28 bytes for each tree, a page for each level of the page tree, and for the pages on one path
//! the nodes that lead to their children (40 bytes each). Time: each page is read once.

use std::path::PathBuf;

use thiserror::Error;
use vdt::tree::{Normal, Positions, Wedge, lattice_number, switch_of};

use crate::chain::PageChain;
use crate::header::{ModelError, ModelRoot};
use crate::model::Model;
use crate::page::{ChildEntry, Page, PageLocation, Record, Target};

/// How far a child's sphere may stick out of its parent's, as a part of the parent's radius: 2⁻²⁰, eight units in the
/// last place of a 32-bit float.
pub const SPHERE_TOLERANCE: f64 = 1.0 / (1 << 20) as f64;
/// How much less than the diagonal of its box a tree's switch value may be, as a part of it: 2⁻²², what rounding may take.
const SWITCH_TOLERANCE: f64 = 1.0 / (1 << 22) as f64;

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
    let found = Descent::new(model).run(progress)?;
    found.compare(model)?;
    model.check_images()?;
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

/// A level of the page tree, as far as its pages were claimed as children: numbers and byte offsets.
#[derive(Debug, Clone, Copy)]
struct Level {
    first: (u32, u64),
    /// What no page has claimed yet.
    next: (u32, u64),
    /// Who claimed the first.
    claimed_by: Option<PageLocation>,
}

/// The levels of the page tree, from that of the root pages down to the deepest that was claimed.
struct Tiling {
    levels: Vec<Level>,
}

impl Tiling {
    fn new(model: &Model) -> Self {
        let first = (0, model.header().pages_offset);
        let mut roots = Level { first, next: first, claimed_by: None };
        roots.extend(model.root_pages().iter().copied());
        Tiling { levels: vec![roots] }
    }

    /// Adds the children of a page of a level, counted from 0; says what is wrong with them.
    fn add(&mut self, level: usize, page: &Page, location: PageLocation) -> Result<(), String> {
        let Some(child) = page.children().next() else { return Ok(()) };
        let first = (child.number, child.offset);
        if self.levels.len() == level + 1 {
            self.levels.push(Level { first, next: first, claimed_by: Some(location) });
        }
        let below = &mut self.levels[level + 1];
        if below.next != first {
            return Err(wrong_children(first, below.next));
        }
        below.extend(page.children());
        Ok(())
    }

    /// Whether each level begins where the one above ends, and the last ends with the file.
    fn check(&self, model: &Model) -> Result<(), VerifyError> {
        for [above, below] in self.levels.array_windows() {
            if let Some(location) = below.claimed_by.filter(|_| below.first != above.next) {
                let problem = wrong_children(below.first, above.next);
                return Err(VerifyError::Page { path: model.path().into(), location, problem });
            }
        }
        let header = model.header();
        let (number, offset) = self.levels.last().map_or((0, header.pages_offset), |level| level.next);
        if offset != header.file_length {
            return Err(header_error(model, "end of the meta-nodes", header.file_length, offset));
        }
        if number != header.page_count {
            let what = "meta-nodes with a parent or in the root page table";
            return Err(header_error(model, what, header.page_count, number));
        }
        Ok(())
    }
}

impl Level {
    fn extend(&mut self, pages: impl Iterator<Item = PageLocation>) {
        for page in pages {
            self.next = (self.next.0.saturating_add(1), self.next.1.saturating_add(page.length.into()));
        }
    }
}

fn wrong_children((number, offset): (u32, u64), (due, due_at): (u32, u64)) -> String {
    format!("its children begin with meta-node {number} at byte {offset}, where {due} at byte {due_at} is due")
}

/// A node that splits: what is known of it before its record is read.
#[derive(Debug, Clone, Copy)]
struct Node {
    /// Its tree, counted from 0.
    tree: u32,
    start: u32,
    end: u32,
    position: [f32; 3],
    id: u32,
    radius: f32,
    /// Index of its record.
    record: u16,
}

impl Node {
    fn of_root(tree: u32, root: &ModelRoot) -> Self {
        Node {
            tree,
            start: root.start,
            end: root.end,
            position: root.position,
            id: root.id,
            radius: root.radius,
            record: root.record,
        }
    }
}

/// A page that is to be checked: where, and which nodes refer to it.
struct Visit {
    location: PageLocation,
    parent: Option<u32>,
    /// Counted from 0.
    level: u32,
    nodes: Vec<Node>,
}

/// The box of some positions.
#[derive(Debug, Clone, Copy)]
struct Bounds {
    minimum: [f32; 3],
    maximum: [f32; 3],
}

impl Bounds {
    const EMPTY: Bounds = Bounds { minimum: [f32::INFINITY; 3], maximum: [f32::NEG_INFINITY; 3] };

    fn add(&mut self, position: [f32; 3]) {
        for axis in 0..3 {
            self.minimum[axis] = self.minimum[axis].min(position[axis]);
            self.maximum[axis] = self.maximum[axis].max(position[axis]);
        }
    }

    fn diagonal(&self) -> f64 {
        let extents = (0..3).map(|axis| f64::from(self.maximum[axis]) - f64::from(self.minimum[axis]));
        extents.map(|extent| extent * extent).sum::<f64>().sqrt()
    }
}

/// What is counted, to be compared with the header.
struct Found {
    splits: u64,
    triangles: u64,
    pages: u64,
    roots: u64,
    ways: u64,
    levels: u32,
    /// Bytes of the largest page, decoded, and in the file.
    slot_bytes: usize,
    largest_page_bytes: u32,
    largest_switch: f32,
    /// The box of each tree.
    bounds: Vec<Bounds>,
    wedges: u64,
}

impl Found {
    /// Takes a leaf of a tree.
    fn add_leaf(&mut self, model: &Model, tree: u32, position: [f32; 3], normal: Normal) -> Result<(), String> {
        let step = model.header().lattice_step;
        if step > 0.0 {
            let largest = match model.header().positions {
                Positions::Lossless => u32::MAX,
                Positions::Bits(bits) => 1 << (bits - 1),
            };
            let is_on_it = |coordinate: &f32| {
                lattice_number(*coordinate, step).is_some_and(|number| number.unsigned_abs() <= largest)
            };
            if !position.iter().all(is_on_it) {
                return Err(format!("the position {position:?} is not on the lattice with steps of {step}"));
            }
        }
        if !normal.is_valid() {
            return Err(format!("{:#x} is no normal", normal.to_word()));
        }
        self.bounds[tree as usize].add(position);
        Ok(())
    }

    /// Whether each tree vanishes no sooner than it may.
    fn check_trees(&self, model: &Model) -> Result<(), VerifyError> {
        for (tree, (root, bounds)) in (0..).zip(model.roots().iter().zip(&self.bounds)) {
            let diagonal = bounds.diagonal();
            if f64::from(root.switch) < (diagonal * (1.0 - SWITCH_TOLERANCE)).min(f32::MAX.into()) {
                let problem =
                    format!("the switch value {} is less than the tree's box is across, {diagonal}", root.switch);
                return Err(VerifyError::Root { path: model.path().into(), tree, problem });
            }
        }
        Ok(())
    }

    fn compare(&self, model: &Model) -> Result<(), VerifyError> {
        let header = model.header();
        let counts = [
            ("splits", header.split_count, self.splits),
            ("triangles", header.triangle_count, self.triangles),
            ("meta-nodes", header.page_count, self.pages),
            ("trees", header.root_count, self.roots),
            ("meta-nodes in the way table", header.way_count, self.ways),
            ("levels of meta-nodes", header.page_levels, self.levels.into()),
        ];
        for (what, promised, found) in counts {
            if u64::from(promised) != found {
                return Err(header_error(model, what, promised, found));
            }
        }
        if header.slot_bytes as usize != self.slot_bytes {
            return Err(header_error(model, "bytes of the largest meta-node", header.slot_bytes, self.slot_bytes));
        }
        if header.largest_page_bytes != self.largest_page_bytes {
            let what = "bytes of the largest meta-node in the file";
            return Err(header_error(model, what, header.largest_page_bytes, self.largest_page_bytes));
        }
        if header.largest_switch != self.largest_switch {
            return Err(header_error(model, "largest switch value", header.largest_switch, self.largest_switch));
        }
        let wedges = model.appearance().map_or(0, |appearance| appearance.wedge_count);
        if u64::from(wedges) != self.wedges {
            return Err(header_error(model, "wedges", wedges, self.wedges));
        }
        let mut all = Bounds::EMPTY;
        for bounds in &self.bounds {
            all.add(bounds.minimum);
            all.add(bounds.maximum);
        }
        let Bounds { minimum, maximum } = all;
        let (minimum, maximum) = if self.bounds.is_empty() { Default::default() } else { (minimum, maximum) };
        if (header.minimum, header.maximum) != (minimum, maximum) {
            let promised = format!("{:?} to {:?}", header.minimum, header.maximum);
            return Err(header_error(model, "bounding box", promised, format!("{minimum:?} to {maximum:?}")));
        }
        Ok(())
    }
}

/// A node that splits has the switch value of its id.
fn check_switch(model: &Model, id: u32, switch: f32) -> Result<(), String> {
    let expected = switch_of(id, model.header().exponent);
    if switch != expected {
        return Err(format!("the switch value {switch} is not that of the id {id}, {expected}"));
    }
    Ok(())
}

/// Whether wedges have materials that there are.
fn check_materials(model: &Model, wedges: impl Iterator<Item = Wedge>) -> Result<(), String> {
    let materials = model.appearance().map_or(0, |appearance| appearance.appearance.materials.len());
    match wedges.map(|wedge| wedge.material).find(|material| *material as usize > materials) {
        Some(material) => Err(format!("a wedge has material {material} of {materials}")),
        None => Ok(()),
    }
}

/// The pass, from the root tables down.
struct Descent<'a> {
    model: &'a Model,
    found: Found,
}

impl<'a> Descent<'a> {
    fn new(model: &'a Model) -> Self {
        let found = Found {
            splits: 0,
            triangles: 0,
            pages: 0,
            roots: 0,
            ways: 0,
            levels: 0,
            slot_bytes: 0,
            largest_page_bytes: 0,
            largest_switch: 0.0,
            bounds: vec![Bounds::EMPTY; model.roots().len()],
            wedges: 0,
        };
        Descent { model, found }
    }

    fn run(mut self, progress: &mut dyn FnMut(f64)) -> Result<Found, VerifyError> {
        let model = self.model;
        let page_count = f64::from(model.header().page_count);
        let mut chain = PageChain::new(model);
        let mut tiling = Tiling::new(model);
        let first = |location: &PageLocation| Visit { location: *location, parent: None, level: 0, nodes: Vec::new() };
        let mut stack: Vec<Visit> = model.root_pages().iter().rev().map(first).collect();
        while let Some(visit) = stack.pop() {
            progress((self.found.pages as f64 / page_count).min(1.0));
            let (location, level) = (visit.location, visit.level);
            let page = chain.page(location, visit.parent)?;
            page.check(model.header().leaf_count).map_err(|source| ModelError::Page {
                path: model.path().into(),
                location,
                source,
            })?;
            self.found.pages += 1;
            self.found.levels = self.found.levels.max(level + 1);
            self.found.slot_bytes = self.found.slot_bytes.max(page.counts().decoded_bytes());
            self.found.largest_page_bytes = self.found.largest_page_bytes.max(location.length);
            tiling.add(level as usize, page, location).map_err(|problem| self.page_error(location, problem))?;
            self.check_way(location, page)?;
            let nodes = self.page_roots(visit, page)?;
            let below = self.check_page(location, page, nodes)?;
            let first = stack.len();
            let parent = Some(location.number);
            let visits = page.children().zip(below);
            stack.extend(visits.map(|(location, nodes)| Visit { location, parent, level: level + 1, nodes }));
            stack[first..].reverse();
        }
        tiling.check(model)?;
        self.found.check_trees(model)?;
        Ok(self.found)
    }

    /// What the way table says of a page.
    fn check_way(&mut self, location: PageLocation, page: &Page) -> Result<(), VerifyError> {
        let ways = self.model.ways();
        let Ok(way) = ways.binary_search_by_key(&location.number, |way| way.page.number) else { return Ok(()) };
        self.found.ways += 1;
        if ways[way].page != location || Some(ways[way].parent) != page.parent() {
            let problem = format!("the way table has it at byte {}, below {}", ways[way].page.offset, ways[way].parent);
            return Err(self.page_error(location, problem));
        }
        Ok(())
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
        for tree in self.model.roots_in_page(location.number).to_vec() {
            let root = &self.model.roots()[tree as usize];
            let wrong = |problem| VerifyError::Root { path: self.model.path().into(), tree, problem };
            if root.page != location {
                return Err(wrong(format!("meta-node {} is not at byte {}", location.number, root.page.offset)));
            }
            check_switch(self.model, root.id, root.switch).map_err(wrong)?;
            nodes.push(Node::of_root(tree, root));
            self.found.roots += 1;
            self.found.add_leaf(self.model, tree, root.position, root.normal).map_err(wrong)?;
            self.found.largest_switch = self.found.largest_switch.max(root.switch);
            if let Some(appearance) = self.model.appearance() {
                let wedges = appearance.root_wedges.of_tree(tree as usize);
                self.found.wedges += wedges.len() as u64;
                check_materials(self.model, wedges.iter().map(|placed| placed.wedge)).map_err(wrong)?;
            }
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
            let wedges = self.check_wedges(&node, &record, page, index as u16);
            wedges.map_err(|problem| self.record_error(location, index, problem))?;
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
        self.found.add_leaf(self.model, node.tree, record.position, record.normal)?;
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
        check_switch(self.model, entry.id, entry.switch)?;
        if entry.id >= parent.id {
            return Err(format!("the id {} of a child is not below its parent's, {}", entry.id, parent.id));
        }
        let (Target::SamePage { record } | Target::ChildPage { record, .. }) = entry.target;
        let node = Node { tree: parent.tree, start, end, position, id: entry.id, radius: entry.radius, record };
        Ok(Some((node, entry.target)))
    }

    /// Checks the wedges of a born leaf, and those of the corners that lie under it. That wedges are numbered depth-first is what
    /// decoding makes sure of.
    fn check_wedges(&mut self, node: &Node, record: &Record, page: &Page, index: u16) -> Result<(), String> {
        let wedges = page.wedges(index);
        self.found.wedges += wedges.len() as u64;
        check_materials(self.model, wedges.map(|placed| placed.wedge))?;
        for (leaves, wedges) in page.triangles(index).zip(page.corner_wedges(index)) {
            for (leaf, number) in leaves.into_iter().zip(wedges) {
                let is_born = (record.born_leaf..node.end).contains(&leaf);
                let has_born = page.wedges(index).any(|placed| (placed.number..placed.end).contains(&number));
                if is_born != has_born {
                    return Err(format!("leaf {leaf} cannot have wedge {number}"));
                }
            }
        }
        Ok(())
    }

    fn check_triangles(
        &mut self,
        node: &Node,
        record: &Record,
        triangles: impl Iterator<Item = [u32; 3]>,
    ) -> Result<(), String> {
        let (kept, born) = (node.start..record.born_leaf, record.born_leaf..node.end);
        let root = &self.model.roots()[node.tree as usize];
        let mut before = None;
        for corners in triangles {
            let [first, second, third] = corners;
            let under_born = u32::from(born.contains(&second)) + u32::from(born.contains(&third));
            let outside = [second, third].iter().filter(|leaf| !(node.start..node.end).contains(leaf)).count();
            let is_elsewhere = [second, third].iter().any(|leaf| !(root.start..root.end).contains(leaf));
            if !kept.contains(&first) || under_born != 1 || outside != 1 || is_elsewhere {
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
    use vdt::tree::{Tree, on_lattice};

    use super::*;
    use crate::codec::{Classes, Numbers};
    use crate::cut::{UniformCut, error_for_triangles};
    use crate::header::{Blocking, HEADER_BYTES, ROOT_WORDS};
    use crate::statistics::statistics;
    use crate::testing::{Random, Shape, TreePlan, all_pages, blockings, model_bytes, open_bytes, plans, random_tree};

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
                let values = stretch.len() / stretch.grain - 1;
                let values = if random.below(2) == 0 { values.min(30) } else { values };
                let at = stretch.start + random.below(values) * stretch.grain;
                let other = other_value(&mut random, &bytes, stretch, at, stretch.grain);
                bytes = alter(&bytes, stretch, at, &other);
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
        let bytes = (HEADER_BYTES + 4 + Classes::unseen().to_bytes(Numbers::ANY).len() + 4) as u64;
        assert_eq!((report.leaves, report.pages, report.bytes), (0, 0, bytes));
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
        for reads in 0..u64::from(summary.pages) {
            disk.fail_reads_after(reads);
            let message = verify(&model, &mut |_| ()).unwrap_err().to_string();
            assert!(message.contains("model.vdt") && message.contains("injected fault"), "{message}");
        }
        disk.fail_reads_after(summary.pages.into());
        verify(&model, &mut |_| ()).unwrap();
    }

    /// A stretch of the file under one checksum, which follows it.
    struct Stretch {
        start: usize,
        /// For each byte, whether any change breaks something that verify promises to find. Another value of a coordinate,
        /// radius, id, cone, or of what is coded may give another sound model.
        is_fixed: Vec<bool>,
        /// Bytes of what its fields are made of.
        grain: usize,
    }

    impl Stretch {
        fn new(start: usize, end: usize, grain: usize, free: &[std::ops::Range<usize>]) -> Self {
            let mut is_fixed = vec![true; end - start];
            free.iter().for_each(|range| is_fixed[range.start - start..range.end - start].fill(false));
            Stretch { start, is_fixed, grain }
        }

        fn len(&self) -> usize {
            self.is_fixed.len()
        }
    }

    /// The header, the root tables, the tables of the coder, and each page.
    fn stretches(bytes: &[u8]) -> Vec<Stretch> {
        let model = open_bytes(bytes).unwrap();
        let header = model.header();
        // Origin, metric, strategy, error bound, the blocking's parameters and the input error tell of the making only, and
        // so do the bits of a lattice, where there is one.
        let of_lattice = if header.lattice_step > 0.0 { 8 } else { 0 };
        let mut found = vec![Stretch::new(0, 252, 4, &[56..80, 108..132, 156..160, 164..164 + of_lattice])];
        // The root table: position, id (further along its chain), radius, cone, normal.
        let roots = (0..model.roots().len()).map(|root| HEADER_BYTES + root * ROOT_WORDS * 4);
        let free: Vec<_> = roots.flat_map(|at| [at + 8..at + 24, at + 28..at + 36, at + 56..at + 60]).collect();
        let (roots_end, tables_end) = (header.after_root_tables() as usize - 4, header.pages_offset as usize - 4);
        found.push(Stretch::new(HEADER_BYTES, roots_end, 4, &free));
        let coder = roots_end + 4..tables_end;
        found.push(Stretch::new(coder.start, coder.end, 1, std::slice::from_ref(&coder)));
        for (location, page) in all_pages(&model) {
            let (start, end) = (location.offset as usize, location.offset as usize + location.length as usize - 4);
            let children = page.counts().children;
            let fields = start + PAGE_HEAD + if children > 0 { FIRST_CHILD + children * CHILD } else { 0 };
            found.push(Stretch::new(start, end, 2, std::slice::from_ref(&(fields..end))));
        }
        found
    }

    /// Bytes of a page in front of what is said of its children; of the first child's place; and for each child.
    const PAGE_HEAD: usize = 24;
    const FIRST_CHILD: usize = 12;
    const CHILD: usize = 6;

    /// Alters some bytes of a stretch, from byte `at` of the file on, and puts the checksum right.
    fn alter(bytes: &[u8], stretch: &Stretch, at: usize, other: &[u8]) -> Vec<u8> {
        let mut altered = bytes.to_vec();
        altered[at..at + other.len()].copy_from_slice(other);
        let end = stretch.start + stretch.len();
        let checksum = crc32fast::hash(&altered[stretch.start..end]);
        altered[end..end + 4].copy_from_slice(&checksum.to_le_bytes());
        altered
    }

    /// Alters the word at byte `at`.
    fn alter_word(bytes: &[u8], stretch: &Stretch, at: usize, word: u32) -> Vec<u8> {
        alter(bytes, stretch, at, &word.to_le_bytes())
    }

    fn word_at(bytes: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    /// Another value for some bytes, most of them near the old one.
    fn other_value(random: &mut Random, bytes: &[u8], stretch: &Stretch, at: usize, count: usize) -> Vec<u8> {
        let value = |at: usize| (0..count).rev().fold(0_u64, |value, byte| value << 8 | u64::from(bytes[at + byte]));
        let old = value(at);
        let other = match random.below(7) {
            0 => old.wrapping_add(1 + random.below(3) as u64),
            1 => old.wrapping_sub(1 + random.below(3) as u64),
            2 => old ^ 1 << random.below(8 * count),
            3 => value(stretch.start + random.below(stretch.len() - count)),
            4 => 0,
            5 => u64::MAX,
            _ => random.next(),
        };
        other.to_le_bytes()[..count].to_vec()
    }

    /// Everything there is to be read is read; whether all of it is sound.
    fn read_everything(bytes: Vec<u8>, is_thorough: bool) -> bool {
        let Ok(model) = open_bytes(bytes) else { return false };
        if let Ok(cut) = UniformCut::new(&model, model.header().largest_switch / 2.0) {
            let _ = cut.for_each_vertex(|_| Ok::<_, ModelError>(()));
            let _ = cut.for_each_triangle(|_| Ok::<_, ModelError>(()));
        }
        let _ = statistics(&model);
        if is_thorough {
            let _ = error_for_triangles(&model, 10);
        }
        verify(&model, &mut |_| ()).is_ok()
    }

    /// What reads a model must end with a result whatever the file holds, and only a sound one may be called so.
    #[test]
    fn wrong_values_under_right_checksums_are_found_and_do_no_harm() {
        let mut random = Random(7);
        for (leaves, blocking) in [(380, SMALL), (130, Blocking::Levels { levels: 3 })] {
            let (bytes, _) = model_bytes(&small_tree(leaves), blocking);
            for stretch in stretches(&bytes) {
                for index in (0..stretch.len() - stretch.grain).step_by(stretch.grain) {
                    let at = stretch.start + index;
                    let is_fixed = stretch.is_fixed[index];
                    // What is coded is most of it, and one place there is as good as another.
                    for _ in 0..if is_fixed { 3 } else { 1 } {
                        let other = other_value(&mut random, &bytes, &stretch, at, stretch.grain);
                        if other == bytes[at..at + other.len()] {
                            continue;
                        }
                        let altered = alter(&bytes, &stretch, at, &other);
                        let is_thorough = index % 64 == 0;
                        let sound = catch_unwind(AssertUnwindSafe(|| read_everything(altered, is_thorough)));
                        let place = format!("{blocking}: byte {at} of the stretch at {}, {other:?}", stretch.start);
                        let sound = sound.unwrap_or_else(|_| panic!("{place}: panicked"));
                        assert!(!sound || !is_fixed, "{place}: called sound");
                    }
                }
            }
        }
    }

    #[test]
    fn a_broken_promise_is_named_with_its_place() {
        let plan =
            TreePlan { seed: 4, leaves: 200, components: 1, triangles: 400, shape: Shape::Random, hub: 0, reach: 30 };
        let tree = random_tree(&plan);
        let (bytes, _) = model_bytes(&tree, SMALL);
        let refuse = |bytes: Vec<u8>, expected: &str| {
            let message = check(bytes).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
            message
        };
        let stretches = stretches(&bytes);
        let [header, roots, _, page, ..] = &stretches[..] else { panic!("no pages") };
        let root = HEADER_BYTES;
        let above = f32::from_bits(word_at(&bytes, root + 24) + 1);
        let message = refuse(alter_word(&bytes, roots, root + 24, above.to_bits()), "is not that of the id");
        assert!(message.contains("model.vdt: root table, tree 0"), "{message}");
        refuse(alter_word(&bytes, header, 160, tree.exponent.wrapping_add(1).cast_unsigned()), "is not that of the id");
        // By so little that all that is coded comes back as it was.
        let radius = f32::from_bits(word_at(&bytes, root + 28));
        let message = refuse(alter_word(&bytes, roots, root + 28, (radius * 0.9999).to_bits()), "out of a sphere");
        assert!(message.contains("model.vdt: meta-node ") && message.contains(", record "), "{message}");
        refuse(alter_word(&bytes, page, page.start + 4, 0), "its parent is given as meta-node 0, not none");
        let first_child = page.start + PAGE_HEAD;
        refuse(alter_word(&bytes, page, first_child, 2), "this is meta-node 1, not 2");
        refuse(alter_word(&bytes, page, first_child + 4, word_at(&bytes, first_child + 4) + 1), "checksum");
        // The second of its level with children: those of the first have been seen.
        let model = open_bytes(&*bytes).unwrap();
        let pages = all_pages(&model);
        let parents = pages.iter().filter(|(_, page)| page.parent() == Some(0) && page.children().len() > 0);
        let (second, children) = parents.map(|(at, page)| (at.number as usize, page.child_location(0))).nth(1).unwrap();
        let page = &stretches[3 + second];
        let message =
            refuse(alter_word(&bytes, page, page.start + PAGE_HEAD, children.number + 1), "its children begin");
        assert!(message.contains(&format!("meta-node {second} at byte {}: ", page.start)), "{message}");
        let wrong_offset = alter_word(&bytes, page, page.start + PAGE_HEAD + 4, children.offset as u32 + 1);
        refuse(wrong_offset, &format!("where {} at byte {} is due", children.number, children.offset));
        refuse(alter_word(&bytes, header, 56 + 24, 0), "bounding box");
        refuse(alter_word(&bytes, header, 104, 0), "largest switch value");
        refuse(alter_word(&bytes, header, 52, 1), "levels of meta-nodes");
        refuse(alter_word(&bytes, header, 44, word_at(&bytes, 44) + 4), "bytes of the largest meta-node");
        refuse(alter_word(&bytes, header, 48, word_at(&bytes, 48) + 1), "bytes of the largest meta-node in the file");
        let mut twice = tree.clone();
        let split = (0..tree.leaf_count()).find(|split| !tree.triangles.of(*split as u32).is_empty()).unwrap();
        let (at, corners) = (tree.triangles.offsets[split] as usize, tree.triangles.of(split as u32)[0]);
        twice.triangles.corners.insert(at, corners);
        twice.triangles.offsets[split + 1..].iter_mut().for_each(|offset| *offset += 1);
        refuse(model_bytes(&twice, SMALL).0, "stands behind");
    }

    #[test]
    fn a_tree_that_vanishes_too_soon_is_named() {
        let mut tree = small_tree(380);
        check(model_bytes(&tree, SMALL).0).unwrap();
        tree.exponent -= 60;
        tree.splits.iter_mut().for_each(|split| split.switch = switch_of(split.id, tree.exponent));
        let message = check(model_bytes(&tree, SMALL).0).unwrap_err().to_string();
        assert!(message.contains("root table, tree ") && message.contains("is less than the tree's box"), "{message}");
    }

    #[test]
    fn a_normal_beside_its_square_is_named() {
        let (bytes, _) = model_bytes(&small_tree(380), SMALL);
        let altered = alter_word(&bytes, &stretches(&bytes)[1], HEADER_BYTES + 56, 0x3ff);
        let message = check(altered).unwrap_err().to_string();
        assert!(message.contains("root 0: a field holds what it cannot hold"), "{message}");
    }

    #[test]
    fn a_root_beside_the_lattice_is_named_with_its_place() {
        let mut tree = Tree { lattice_step: 1e-3, ..small_tree(380) };
        tree.positions.iter_mut().flatten().for_each(|value| *value = on_lattice((*value * 1e3) as i32 % 10_000, 1e-3));
        check(model_bytes(&tree, SMALL).0).unwrap();
        tree.positions[tree.roots[1].start as usize][2] = 1.0005;
        let message = check(model_bytes(&tree, SMALL).0).unwrap_err().to_string();
        assert!(message.contains("root table, tree 1: the position"), "{message}");
        assert!(message.contains("is not on the lattice with steps of 0.001"), "{message}");
    }
}
