//! What a coder knows of the nodes around: those of the page at hand, and those of its ancestor pages.
//!
//! Contexts are made from the geometry of nodes: where both children stand, how large they are, which way the surface faces.
//! For the page at hand that is filled in field by field, as they are decoded; for its ancestors it is worked out from the
//! decoded pages ([`Nodes::begin`]), once for all their child pages that are decoded one after the other.
//!
//! Memory: 128 bytes for each record of the pages on the path from a root page down.

use super::paths::step_class;
use super::scale::logarithm;
use super::{Damage, Shape};
use crate::header::ModelRoot;
use crate::page::{Page, Target};

/// In place of a node: the child is a leaf.
pub(super) const LEAF: u32 = u32::MAX;
/// In place of a node: the child's split is in another page, which is not an ancestor.
pub(super) const ELSEWHERE: u32 = u32::MAX - 1;
/// In place of a node: there is none.
pub(super) const NONE: u32 = u32::MAX;

/// The kept child, as an index.
pub(super) const KEPT: usize = 0;
/// The born child, as an index.
pub(super) const BORN: usize = 1;

/// A node whose split is known, or about to be. Two cache lines; what ways through the tree read is in the first.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Node {
    /// The leaves under it.
    pub start: u32,
    pub end: u32,
    /// The leaf that its split bears.
    pub born: u32,
    /// The node above, or [`NONE`].
    pub parent: u32,
    /// The children: nodes, or [`LEAF`] or [`ELSEWHERE`].
    pub children: [u32; 2],
    /// Where they stand, in mesh units.
    pub places: [[f32; 3]; 2],
    /// The displacement from the one to the other, divided by its square.
    pub axis: [f32; 3],
    /// See `paths`.
    pub step_class: u8,
    /// Which child of the node above it is.
    pub side: u8,
    /// Whether the surface faces the other way than its triangles' orientation says.
    pub is_inward: bool,
    /// The running logarithm of how long displacements are hereabouts, for the size of their node.
    pub length: i16,
    /// That of how far they leave the tangent plane, for their length.
    pub bend: i16,
    /// The node that bore its first leaf, among those here, or [`NONE`].
    pub bearer: u32,
    /// The radii of the children's bounding spheres.
    pub radii: [f32; 2],
    /// The dependency id.
    pub id: u32,
    /// The radius of its bounding sphere.
    pub radius: f32,
    /// Where the children stand on the lattice, if there is one.
    pub steps: [[i32; 3]; 2],
    /// Which way the surface faces there. Known, but for leaves that are born in the page at hand: estimated.
    pub normals: [[f32; 3]; 2],
}

/// Where the bend of a tree begins: an eighth of the length off the plane.
const FIRST_BEND: i16 = -96;
/// What a bend is at least and at most.
const BENDS: std::ops::RangeInclusive<i32> = -256..=32;
/// What the logarithm of a length is at most, either way.
const LARGEST_LENGTH: i32 = 8192;

impl Node {
    /// In its place until it is known.
    pub const UNKNOWN: Node = Node {
        start: 0,
        end: 0,
        born: 0,
        parent: NONE,
        side: 0,
        is_inward: false,
        length: 0,
        bend: FIRST_BEND,
        id: 0,
        bearer: NONE,
        radius: 0.0,
        children: [LEAF; 2],
        radii: [0.0; 2],
        axis: [0.0; 3],
        step_class: 0,
        places: [[0.0; 3]; 2],
        steps: [[0; 3]; 2],
        normals: [[0.0; 3]; 2],
    };

    /// The root of a tree, before its split is known.
    pub fn of_tree(root: &ModelRoot, shape: &Shape) -> Self {
        let length = logarithm(root.radius * root.radius) - logarithm((root.end - root.start) as f32);
        Node {
            start: root.start,
            end: root.end,
            is_inward: root.is_inward,
            length: length.clamp(-LARGEST_LENGTH, LARGEST_LENGTH) as i16,
            id: root.id,
            radius: root.radius,
            places: [root.position; 2],
            steps: [shape.steps(root.position); 2],
            normals: [root.normal.decode(); 2],
            ..Node::UNKNOWN
        }
    }

    /// How many leaves there are under it.
    #[inline(always)]
    pub fn size(&self) -> u32 {
        self.end - self.start
    }

    /// The leaves under a child: the first, and one past the last.
    #[inline(always)]
    pub fn interval(&self, side: usize) -> (u32, u32) {
        if side == KEPT { (self.start, self.born) } else { (self.born, self.end) }
    }

    /// The displacement from the kept to the born child, in mesh units.
    #[inline(always)]
    pub fn displacement(&self) -> [f32; 3] {
        minus(self.places[BORN], self.places[KEPT])
    }

    /// Has the born child at a place.
    #[inline(always)]
    pub fn bear_at(&mut self, place: [f32; 3], steps: [i32; 3]) {
        (self.places[BORN], self.steps[BORN]) = (place, steps);
        let d = self.displacement();
        let inverse = 1.0 / dot(d, d).max(f32::MIN_POSITIVE);
        self.axis = d.map(|value| value * inverse);
    }

    /// A child, before its split is known, of the node with this index.
    #[inline(always)]
    pub fn child(&self, index: u32, side: usize) -> Node {
        let (start, end) = self.interval(side);
        let (length, bend) = self.scales();
        Node {
            start,
            end,
            parent: index,
            side: side as u8,
            is_inward: self.is_inward,
            length,
            bend,
            bearer: if side == KEPT { self.bearer } else { index },
            radius: self.radii[side],
            places: [self.places[side]; 2],
            steps: [self.steps[side]; 2],
            normals: [self.normals[side]; 2],
            ..Node::UNKNOWN
        }
    }

    /// The running logarithms behind its displacement.
    #[inline(always)]
    fn scales(&self) -> (i16, i16) {
        let d = self.displacement();
        let square = dot(d, d);
        let found = logarithm(square) - logarithm(self.size() as f32);
        let off = dot(d, self.normals[KEPT]);
        let bend = (logarithm(off * off) - logarithm(square)).clamp(*BENDS.start(), *BENDS.end());
        let run = |before: i16, now: i32| {
            (i32::from(before) + (now - i32::from(before)) * 3 / 8).clamp(-LARGEST_LENGTH, LARGEST_LENGTH) as i16
        };
        (run(self.length, found), run(self.bend, bend))
    }
}

#[inline(always)]
pub(super) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(super) fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub(super) fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// A normal at the other end of a displacement, on a surface that bends evenly: turned by most of twice the angle between the
/// displacement and the tangent plane.
#[inline(always)]
pub(super) fn reflected(normal: [f32; 3], d: [f32; 3]) -> [f32; 3] {
    let square = dot(d, d);
    let factor = 1.2 * dot(normal, d) / square;
    let turned: [f32; 3] = std::array::from_fn(|axis| normal[axis] - factor * d[axis]);
    let length = dot(turned, turned).sqrt();
    if square > 0.0 && length > 0.0 { turned.map(|value| value / length) } else { normal }
}

/// A child that is in a child page.
#[derive(Debug, Clone, Copy)]
struct Leading {
    /// The node that it is a child of, and on which side.
    node: u32,
    side: u8,
    id: u32,
    /// The child page, counted from 0, and the record there.
    page: u16,
    record: u16,
}

/// The nodes of the pages on a path, one page behind the other, and behind them those of the page at hand.
#[derive(Debug, Default)]
pub(crate) struct Nodes {
    pub all: Vec<Node>,
    /// For each page on the path its number, and where its nodes begin.
    pages: Vec<(u32, usize)>,
    /// The children in child pages, of all pages on the path, one page behind the other; and where those of each begin.
    leading: Vec<Leading>,
    leading_starts: Vec<usize>,
    /// Where those of the page at hand begin.
    pub first: usize,
}

impl Nodes {
    /// Has the nodes of these pages, from a root page down, and behind them the roots of the page `number` below the last of
    /// them. `trees` finds the trees that begin in a page.
    pub fn begin<'t, T: Iterator<Item = &'t ModelRoot>>(
        &mut self,
        ancestors: &[&Page],
        number: u32,
        root_count: usize,
        trees: impl Fn(u32) -> T,
        shape: &Shape,
    ) -> Result<(), Damage> {
        let known = self.pages.iter().zip(ancestors).take_while(|((number, _), page)| *number == page.number()).count();
        let end = self.pages.get(known).map_or(self.first, |(_, first)| *first);
        self.all.truncate(end);
        // What leads into a page that is no longer at hand leads elsewhere.
        let last = self.pages[..known].last().map_or(end, |(_, first)| *first);
        for child in self.all[last..].iter_mut().flat_map(|node| &mut node.children) {
            if *child < ELSEWHERE && *child as usize >= end {
                *child = ELSEWHERE;
            }
        }
        self.pages.truncate(known);
        self.leading.truncate(self.leading_starts.get(known).copied().unwrap_or(self.leading.len()));
        self.leading_starts.truncate(known);
        for (level, page) in ancestors.iter().enumerate().skip(known) {
            let parent = level.checked_sub(1).map(|above| ancestors[above]);
            let first = self.all.len();
            self.push_roots(parent, page.number(), page.root_count(), trees(page.number()), shape)?;
            self.leading_starts.push(self.leading.len());
            self.push_others(page, first, shape);
            self.pages.push((page.number(), first));
        }
        self.first = self.all.len();
        self.push_roots(ancestors.last().copied(), number, root_count, trees(number), shape)
    }

    /// Forgets all pages.
    pub fn clear(&mut self) {
        let Nodes { all, pages, leading, leading_starts, first } = self;
        *first = 0;
        all.clear();
        pages.clear();
        leading.clear();
        leading_starts.clear();
    }

    /// The roots of a page: those that its parent, whose nodes are the last ones, leads to, and trees.
    fn push_roots<'t>(
        &mut self,
        parent: Option<&Page>,
        number: u32,
        root_count: usize,
        trees: impl Iterator<Item = &'t ModelRoot>,
        shape: &Shape,
    ) -> Result<(), Damage> {
        let first = self.all.len();
        self.all.resize(first + root_count, Node::UNKNOWN);
        let mut missing = root_count;
        let mut put = |all: &mut Vec<Node>, record: u16, node: Node| match all.get_mut(first + usize::from(record)) {
            Some(place) if place.end == 0 => {
                *place = node;
                missing -= 1;
                Ok(())
            }
            _ => Err(Damage { field: "root", index: record.into(), problem: "it is referred to twice, or is none" }),
        };
        for root in trees {
            put(&mut self.all, root.record, Node::of_tree(root, shape))?;
        }
        if let Some(page) = parent
            && let Some(child) = page.children().position(|child| child.number == number)
        {
            let start = self.leading_starts.last().copied().unwrap_or(0);
            for leading in self.leading[start..].iter().filter(|leading| usize::from(leading.page) == child) {
                let Leading { node, side, id, record, .. } = *leading;
                let below = self.all[node as usize].child(node, side.into());
                put(&mut self.all, record, Node { id, ..below })?;
                self.all[node as usize].children[usize::from(side)] = (first + usize::from(record)) as u32;
            }
        }
        match missing {
            0 => Ok(()),
            _ => Err(Damage { field: "root", index: root_count - missing, problem: "nothing refers to it" }),
        }
    }

    /// The splits of a decoded page whose roots are the last nodes, and all nodes below them.
    fn push_others(&mut self, page: &Page, first: usize, shape: &Shape) {
        for index in 0..page.counts().records {
            let Some(record) = page.record(index as u16) else { break };
            let place = first + index;
            let node = &mut self.all[place];
            node.born = record.born_leaf;
            node.step_class = step_class(node.start, node.born, node.end);
            node.bear_at(record.position, shape.steps(record.position));
            node.normals[BORN] = record.normal.decode();
            for (side, entry) in [record.kept, record.born].into_iter().enumerate() {
                let Some(entry) = entry else { continue };
                self.all[place].radii[side] = entry.radius;
                match entry.target {
                    Target::SamePage { record } => {
                        self.all[place].children[side] = (first + usize::from(record)) as u32;
                        let child = self.all[place].child(place as u32, side);
                        // Breadth-first: they come in the order in which they are referred to.
                        self.all.push(Node { id: entry.id, ..child });
                    }
                    Target::ChildPage { child: page, record } => {
                        self.all[place].children[side] = ELSEWHERE;
                        let (node, side) = (place as u32, side as u8);
                        self.leading.push(Leading { node, side, id: entry.id, page, record });
                    }
                }
            }
        }
    }
}
