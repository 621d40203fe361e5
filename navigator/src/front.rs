//! The active front (the paper, 3.3.1): the lists of active nodes and of active triangles, with the splits that are
//! applied above them, and the two exact inverses that change them, split and collapse.
//!
//! A *node* of the front is an active node, or one whose split is applied. It keeps the interval of leaves under it,
//! where it stands, and what decides whether it is to be split. An active triangle keeps its three corners as leaf
//! numbers, and for each the active node that the leaf is under now. The corners at one node are linked to a list, the
//! node's *star*.
//!
//! Splitting p moves the corners at p whose leaf belongs to the born child there and the others to the kept child, and
//! adds p's born triangles: the first corner is under the kept child, one other under the born child, and the third
//! corner's node is found by its leaf: first around p, else by climbing from p to an ancestor that has the leaf under
//! it and going down from there. So nothing here takes room in proportion to the mesh. Collapsing p removes the
//! triangles that have both children for corners, and moves all other corners to p.
//!
//! All arrays are allocated once and never grow. Nothing that comes from a page is trusted: what does not fit is a
//! [`Misfit`], found before anything is changed.
//!
//! Memory: 64 bytes for each node, of which a front with n active nodes has about 2 n; 36 for each triangle; 4 for each
//! tree.

use metanode::header::ModelRoot;
use metanode::page::{ChildEntry, NormalCone, Page, Record, Target};
use thiserror::Error;

use crate::view::Sphere;

/// "None" for nodes, corners and pages.
pub const NONE: u32 = u32::MAX;
/// The id of a collapse that there is not: later than everything.
pub const NEVER: u32 = u32::MAX;
/// Bytes that a node of the front takes.
pub const NODE_BYTES: usize = size_of::<Shape>() + size_of::<Links>();
/// Bytes that an active triangle takes.
pub const TRIANGLE_BYTES: usize = size_of::<Triangle>();
/// Bytes that a tree takes.
pub const TREE_BYTES: usize = size_of::<u32>();
/// Most triangles a front can hold: corners are numbered in 32 bits.
pub const TRIANGLE_LIMIT: usize = 1 << 30;

/// A page that cannot belong to this model: what in it does not fit to what is known from its ancestors.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("record {record}: {problem}")]
pub struct Misfit {
    /// Index of the record in its page.
    pub record: u16,
    /// What is wrong with it.
    pub problem: String,
}

/// What a node of the front is at the moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Not a node: free for use.
    Free,
    /// Active, and a leaf of the tree.
    Leaf,
    /// Active, with a split to be applied.
    Active,
    /// Its split is applied, and at least one child is split further.
    Split,
    /// Its split is applied and both children are active: it can be collapsed.
    Collapsible,
}

/// The part of a node that the evaluation of a frame streams through.
#[derive(Debug, Clone, Copy)]
struct Shape {
    sphere: Sphere,
    /// Active: number of the page with its split. Split: the place holder that the page is in. Leaf: none.
    page: u32,
    state: State,
}

/// The part of a node that only changes touch.
#[derive(Debug, Clone, Copy)]
struct Links {
    /// First leaf under the node.
    start: u32,
    /// One past the last.
    end: u32,
    id: u32,
    /// Id of the first collapse above that moves the node's corners elsewhere, see [`Front::moved_by`].
    moved_by: u32,
    /// Free: the next free node.
    parent: u32,
    /// Active: the first corner of its star. Split: the kept child.
    first: u32,
    /// Split: the born child.
    second: u32,
    /// Index of the record in the page.
    record: u16,
    /// Split: not to be collapsed before this time, in frames modulo 65536, if that is near.
    not_before: u16,
}

/// An active triangle. A corner is numbered `4 * triangle + 0, 1 or 2`.
#[derive(Debug, Clone, Copy)]
struct Triangle {
    /// The corners as leaf numbers.
    leaves: [u32; 3],
    /// The active nodes they are under; the first is [`NONE`] where the triangle is free.
    nodes: [u32; 3],
    /// The next corner of the same star; the first of a free triangle is the next free triangle.
    next: [u32; 3],
}

impl Triangle {
    /// The corners after one, in their orientation.
    fn others(&self, place: usize) -> [Corner; 2] {
        [1, 2].map(|step| (place + step) % 3).map(|place| Corner { node: self.nodes[place], leaf: self.leaves[place] })
    }
}

/// A corner of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Corner {
    /// The active node that it is at.
    pub node: u32,
    /// The leaf that it is in the input.
    pub leaf: u32,
}

/// A split, read from its page and found to fit: what [`Front::split`] applies.
#[derive(Debug, Clone, Copy)]
pub struct Prepared {
    node: u32,
    record: Record,
    kept_page: u32,
    born_page: u32,
}

impl Prepared {
    /// The node that is to be split.
    pub fn node(&self) -> u32 {
        self.node
    }
}

/// The front: nodes, triangles, and their free lists.
#[derive(Debug)]
pub struct Front {
    shapes: Vec<Shape>,
    links: Vec<Links>,
    node_capacity: usize,
    free_node: u32,
    node_count: usize,
    active_count: usize,
    triangles: Vec<Triangle>,
    triangle_capacity: usize,
    free_triangle: u32,
    triangle_count: usize,
    /// Active triangles of each tree.
    tree_triangles: Vec<u32>,
    /// Trees that have none.
    vanished_trees: usize,
    root_count: u32,
    leaf_count: u32,
    /// The third corners of the triangles that the prepared split bears.
    thirds: Vec<Corner>,
}

impl Front {
    /// The front with all roots active. `born_capacity` is the most triangles that one split can bear.
    pub fn new(
        roots: &[ModelRoot],
        leaf_count: u32,
        node_capacity: usize,
        triangle_capacity: usize,
        born_capacity: usize,
    ) -> Self {
        let node_capacity = node_capacity.max(roots.len());
        let mut front = Front {
            shapes: Vec::with_capacity(node_capacity),
            links: Vec::with_capacity(node_capacity),
            node_capacity,
            free_node: NONE,
            node_count: 0,
            active_count: 0,
            triangles: Vec::with_capacity(triangle_capacity),
            triangle_capacity,
            free_triangle: NONE,
            triangle_count: 0,
            tree_triangles: vec![0; roots.len()],
            vanished_trees: roots.len(),
            root_count: roots.len() as u32,
            leaf_count,
            thirds: Vec::with_capacity(born_capacity),
        };
        for root in roots {
            let sphere = Sphere { position: root.position, radius: root.radius, switch: root.switch, cone: root.cone };
            let shape = Shape { sphere, page: root.page.number, state: State::Active };
            front.new_node(
                shape,
                Links {
                    start: root.start,
                    end: root.end,
                    id: root.id,
                    moved_by: NEVER,
                    parent: NONE,
                    first: NONE,
                    second: NONE,
                    record: root.record,
                    not_before: 0,
                },
            );
        }
        front.active_count = roots.len();
        front
    }

    /// Most nodes, active or split, that fit.
    pub fn node_capacity(&self) -> usize {
        self.node_capacity
    }

    /// Nodes there are, active or split.
    pub fn node_count(&self) -> usize {
        self.node_count
    }

    /// Active nodes, that is vertices of the drawn mesh (and perhaps roots without a triangle).
    pub fn active_count(&self) -> usize {
        self.active_count
    }

    /// Most active triangles that fit.
    pub fn triangle_capacity(&self) -> usize {
        self.triangle_capacity
    }

    /// Active triangles.
    pub fn triangle_count(&self) -> usize {
        self.triangle_count
    }

    /// Active triangles of a tree, by the number of its root.
    pub fn tree_triangles(&self, tree: usize) -> u32 {
        self.tree_triangles.get(tree).copied().unwrap_or(0)
    }

    /// Trees without an active triangle.
    pub fn vanished_trees(&self) -> usize {
        self.vanished_trees
    }

    /// The number of the tree that a leaf is in.
    pub fn tree_of(&self, leaf: u32) -> usize {
        // The roots are the first nodes, in the order of their leaves.
        let after = self.links[..self.root_count as usize].partition_point(|root| root.start <= leaf);
        after.saturating_sub(1)
    }

    /// Counts triangles that the tree of a leaf has more, and fewer.
    fn count_in_tree(&mut self, leaf: u32, more: u32, fewer: u32) {
        let tree = self.tree_of(leaf);
        if let Some(count) = self.tree_triangles.get_mut(tree) {
            let before = std::mem::replace(count, *count + more - fewer);
            self.vanished_trees -= usize::from(before == 0);
            self.vanished_trees += usize::from(*count == 0);
        }
    }

    /// Whether another split, with so many born triangles, fits.
    pub fn has_room(&self, born_triangles: usize) -> bool {
        self.node_count + 2 <= self.node_capacity && self.triangle_count + born_triangles <= self.triangle_capacity
    }

    /// The numbers that nodes can have: below this, each may be free.
    pub fn node_bound(&self) -> u32 {
        self.shapes.len() as u32
    }

    /// What the node is.
    pub fn state(&self, node: u32) -> State {
        self.shapes.get(node as usize).map_or(State::Free, |shape| shape.state)
    }

    /// Whether the node is active.
    pub fn is_active(&self, node: u32) -> bool {
        matches!(self.state(node), State::Active | State::Leaf)
    }

    /// Where a node stands, and what decides about it.
    pub fn sphere(&self, node: u32) -> &Sphere {
        &self.shapes[node as usize].sphere
    }

    /// The states and spheres of all nodes, in the order of their numbers.
    pub fn evaluation_stream(&self) -> impl Iterator<Item = (State, &Sphere)> {
        self.shapes.iter().map(|shape| (shape.state, &shape.sphere))
    }

    /// Dependency id of a node; 0 of a leaf.
    pub fn id(&self, node: u32) -> u32 {
        self.links[node as usize].id
    }

    /// Dependency id of the first collapse above a node that moves its corners: that of its parent for a born child. A kept
    /// child's corners stay where they are, so for that it is what it is for the parent. [`NEVER`] where there is none.
    pub fn moved_by(&self, node: u32) -> u32 {
        self.links[node as usize].moved_by
    }

    /// Its parent, [`NONE`] for a root.
    pub fn parent(&self, node: u32) -> u32 {
        self.links[node as usize].parent
    }

    /// The leaves under it, from the first to one past the last.
    pub fn interval(&self, node: u32) -> (u32, u32) {
        let links = &self.links[node as usize];
        (links.start, links.end)
    }

    /// The kept and the born child of a split node.
    pub fn children(&self, node: u32) -> [u32; 2] {
        let links = &self.links[node as usize];
        [links.first, links.second]
    }

    /// Of an active node the page that its split is in, [`NONE`] for a leaf; of a split node the place holder.
    pub fn page_or_slot(&self, node: u32) -> u32 {
        self.shapes[node as usize].page
    }

    /// Index of the node's record in its page.
    pub fn record(&self, node: u32) -> u16 {
        self.links[node as usize].record
    }

    /// The star of an active node: of each of its triangles the nodes of the other two corners, in their orientation.
    pub fn star(&self, node: u32) -> impl Iterator<Item = [u32; 2]> + '_ {
        self.corners_at(node)
            .map(|(triangle, place)| [triangle.nodes[(place + 1) % 3], triangle.nodes[(place + 2) % 3]])
    }

    /// The corners around an active node, of the triangles that have a corner there that moves to the born child when the
    /// split that was prepared for it is applied; of all triangles there where no corner does.
    pub fn around_moved(&self, prepared: &Prepared) -> impl Iterator<Item = Corner> + '_ {
        let Prepared { node, record, .. } = *prepared;
        let middle = if self.moves_any(prepared) { record.born_leaf } else { 0 };
        self.corners_at(node)
            .filter(move |(triangle, place)| triangle.leaves[*place] >= middle)
            .flat_map(|(triangle, place)| triangle.others(place))
    }

    /// The triangles at an active node: for each the leaf that its corner there is in the input, and its other corners.
    pub fn corners_around(&self, node: u32) -> impl Iterator<Item = (u32, [Corner; 2])> + '_ {
        self.corners_at(node).map(|(triangle, place)| (triangle.leaves[place], triangle.others(place)))
    }

    /// Whether any corner moves to the born child when a split is applied.
    fn moves_any(&self, prepared: &Prepared) -> bool {
        self.corners_at(prepared.node).any(|(triangle, place)| triangle.leaves[place] >= prepared.record.born_leaf)
    }

    /// The corners at an active node, with their places in their triangles.
    fn corners_at(&self, node: u32) -> impl Iterator<Item = (&Triangle, usize)> + '_ {
        let mut corner = self.links[node as usize].first;
        std::iter::from_fn(move || {
            if corner == NONE {
                return None;
            }
            let (triangle, place) = self.corner(corner);
            corner = triangle.next[place];
            Some((triangle, place))
        })
    }

    /// The active triangles: their corners as leaf numbers, and the active nodes they are under.
    pub fn triangles(&self) -> impl Iterator<Item = ([u32; 3], [u32; 3])> + '_ {
        self.triangles
            .iter()
            .filter(|triangle| triangle.nodes[0] != NONE)
            .map(|triangle| (triangle.leaves, triangle.nodes))
    }

    /// The nodes, active or split.
    pub fn nodes(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.node_bound()).filter(|node| self.state(*node) != State::Free)
    }

    fn corner(&self, corner: u32) -> (&Triangle, usize) {
        (&self.triangles[(corner >> 2) as usize], (corner & 3) as usize)
    }

    fn new_node(&mut self, shape: Shape, links: Links) -> u32 {
        self.node_count += 1;
        match self.free_node {
            NONE => {
                self.shapes.push(shape);
                self.links.push(links);
                (self.shapes.len() - 1) as u32
            }
            node => {
                self.free_node = self.links[node as usize].parent;
                self.shapes[node as usize] = shape;
                self.links[node as usize] = links;
                node
            }
        }
    }

    fn free_node(&mut self, node: u32) {
        self.node_count -= 1;
        self.shapes[node as usize].state = State::Free;
        self.links[node as usize].parent = self.free_node;
        self.free_node = node;
    }

    fn new_triangle(&mut self, triangle: Triangle) -> u32 {
        self.triangle_count += 1;
        match self.free_triangle {
            NONE => {
                self.triangles.push(triangle);
                (self.triangles.len() - 1) as u32
            }
            index => {
                self.free_triangle = self.triangles[index as usize].next[0];
                self.triangles[index as usize] = triangle;
                index
            }
        }
    }

    fn free_triangle(&mut self, index: u32) {
        self.triangle_count -= 1;
        let triangle = &mut self.triangles[index as usize];
        triangle.nodes[0] = NONE;
        triangle.next[0] = self.free_triangle;
        self.free_triangle = index;
    }

    /// The active node that `leaf` is under, found from the active node `near`.
    pub fn active_node_of(&self, leaf: u32, near: u32) -> u32 {
        let holds = |node: u32| {
            let links = &self.links[node as usize];
            links.start <= leaf && leaf < links.end
        };
        if let Some(neighbour) = self.star(near).flatten().find(|other| holds(*other)) {
            return neighbour;
        }
        let mut node = near;
        while !holds(node) {
            node = match self.links[node as usize].parent {
                // The roots are the first nodes.
                NONE => self.tree_of(leaf) as u32,
                parent => parent,
            };
        }
        while !self.is_active(node) {
            let [kept, born] = self.children(node);
            node = if leaf < self.links[born as usize].start { kept } else { born };
        }
        node
    }

    /// Reads the split of an active node from its page, and makes sure that it fits into the front. After it,
    /// [`Front::thirds`] are the third corners.
    pub fn prepare(&mut self, node: u32, page: &Page) -> Result<Prepared, Misfit> {
        let Links { start, end, id, record: index, .. } = self.links[node as usize];
        let misfit = |problem: String| Misfit { record: index, problem };
        let Some(record) = page.record(index) else {
            return Err(misfit(format!("there are only {} records, and a parent refers to it", page.counts().records)));
        };
        let middle = record.born_leaf;
        if middle <= start || middle >= end {
            return Err(misfit(format!("born leaf {middle} does not split the leaves {start}..{end}")));
        }
        for (entry, from, to) in [(record.kept, start, middle), (record.born, middle, end)] {
            let fits = match entry {
                Some(entry) => to - from > 1 && entry.id > 0 && entry.id < id,
                None => to - from == 1,
            };
            if !fits {
                return Err(misfit(format!("the child with the leaves {from}..{to} cannot be of node {id}")));
            }
        }
        self.thirds.clear();
        for corners in page.triangles(index) {
            let [first, second, third] = corners;
            let under_born = |leaf: u32| middle <= leaf && leaf < end;
            let outside = |leaf: u32| leaf < start || leaf >= end;
            let fits = start <= first && first < middle;
            let other = if fits && under_born(second) && outside(third) {
                third
            } else if fits && under_born(third) && outside(second) {
                second
            } else {
                return Err(misfit(format!(
                    "the triangle of the leaves {corners:?} is not born where {start}..{end} splits at {middle}"
                )));
            };
            if other >= self.leaf_count || self.thirds.len() == self.thirds.capacity() {
                return Err(misfit(format!("a triangle of the leaves {corners:?} cannot be")));
            }
            self.thirds.push(Corner { node: self.active_node_of(other, node), leaf: other });
        }
        let page_of = |entry: Option<ChildEntry>| match entry.map(|entry| entry.target) {
            None => NONE,
            Some(Target::SamePage { .. }) => page.number(),
            Some(Target::ChildPage { child, .. }) => page.child_location(child.into()).number,
        };
        Ok(Prepared { node, record, kept_page: page_of(record.kept), born_page: page_of(record.born) })
    }

    /// The third corners of the triangles that the split last prepared bears.
    pub fn thirds(&self) -> &[Corner] {
        &self.thirds
    }

    /// Applies the split that was prepared last, with nothing changed in between and with [`Front::has_room`]. `slot`
    /// is the place holder that `page` is in.
    pub fn split(&mut self, prepared: &Prepared, page: &Page, slot: u32) {
        let Prepared { node, record, kept_page, born_page } = *prepared;
        let Links { start, end, id, moved_by, parent, first, record: index, .. } = self.links[node as usize];
        // Where no triangle was left around the vertex that went, those around the one that stayed took over what it
        // answered for, so that they count as moved.
        let kept_moved_by = if self.moves_any(prepared) { moved_by } else { id };
        let position = self.shapes[node as usize].sphere.position;
        let middle = record.born_leaf;
        let kept = self.new_child(node, kept_moved_by, record.kept, kept_page, position, start, middle);
        let born = self.new_child(node, id, record.born, born_page, record.position, middle, end);

        let (mut kept_star, mut born_star) = (NONE, NONE);
        let mut corner = first;
        while corner != NONE {
            let place = (corner & 3) as usize;
            let triangle = &mut self.triangles[(corner >> 2) as usize];
            let (to, star) =
                if triangle.leaves[place] >= middle { (born, &mut born_star) } else { (kept, &mut kept_star) };
            triangle.nodes[place] = to;
            let next = std::mem::replace(&mut triangle.next[place], *star);
            *star = corner;
            corner = next;
        }
        for (born_triangle, leaves) in page.triangles(index).enumerate() {
            let third = self.thirds[born_triangle].node;
            let third_star = self.links[third as usize].first;
            let inside = middle <= leaves[1] && leaves[1] < end;
            let (nodes, next) = if inside {
                ([kept, born, third], [kept_star, born_star, third_star])
            } else {
                ([kept, third, born], [kept_star, third_star, born_star])
            };
            let corner = self.new_triangle(Triangle { leaves, nodes, next }) << 2;
            kept_star = corner;
            let (born_place, third_place) = if inside { (1, 2) } else { (2, 1) };
            born_star = corner | born_place;
            self.links[third as usize].first = corner | third_place;
        }
        self.count_in_tree(start, page.triangles(index).len() as u32, 0);
        self.links[kept as usize].first = kept_star;
        self.links[born as usize].first = born_star;

        self.links[node as usize].first = kept;
        self.links[node as usize].second = born;
        self.shapes[node as usize].page = slot;
        self.shapes[node as usize].state = State::Collapsible;
        if parent != NONE {
            self.shapes[parent as usize].state = State::Split;
        }
        self.active_count += 1;
    }

    #[allow(clippy::too_many_arguments)]
    fn new_child(
        &mut self,
        parent: u32,
        moved_by: u32,
        entry: Option<ChildEntry>,
        page: u32,
        position: [f32; 3],
        start: u32,
        end: u32,
    ) -> u32 {
        let (shape, id, record) = match entry {
            None => {
                let sphere = Sphere { position, radius: 0.0, switch: 0.0, cone: NormalCone::EVERYTHING };
                (Shape { sphere, page: NONE, state: State::Leaf }, 0, 0)
            }
            Some(ChildEntry { id, switch, radius, cone, target }) => {
                let record = match target {
                    Target::SamePage { record } | Target::ChildPage { record, .. } => record,
                };
                let sphere = Sphere { position, radius, switch, cone };
                (Shape { sphere, page, state: State::Active }, id, record)
            }
        };
        let (first, second, not_before) = (NONE, NONE, 0);
        self.new_node(shape, Links { start, end, id, moved_by, parent, first, second, record, not_before })
    }

    /// Undoes the split of a collapsible node; `page` is the number of the page that its split is in.
    pub fn collapse(&mut self, node: u32, page: u32) {
        let [kept, born] = self.children(node);
        let mut star = NONE;
        // The triangles with a corner at each child die. They stay linked to neither, and leave the third star.
        let mut corner = self.links[kept as usize].first;
        while corner != NONE {
            let place = (corner & 3) as usize;
            let triangle = &mut self.triangles[(corner >> 2) as usize];
            let next = triangle.next[place];
            if !triangle.nodes.contains(&born) {
                triangle.nodes[place] = node;
                triangle.next[place] = star;
                star = corner;
            }
            corner = next;
        }
        let (mut corner, mut dead) = (self.links[born as usize].first, 0);
        while corner != NONE {
            let (index, place) = (corner >> 2, (corner & 3) as usize);
            let triangle = &mut self.triangles[index as usize];
            let next = triangle.next[place];
            if triangle.nodes.contains(&kept) {
                let third = triangle.nodes.iter().position(|other| *other != kept && *other != born);
                if let Some(third) = third {
                    self.unlink(index << 2 | third as u32);
                }
                self.free_triangle(index);
                dead += 1;
            } else {
                triangle.nodes[place] = node;
                triangle.next[place] = star;
                star = corner;
            }
            corner = next;
        }
        self.count_in_tree(self.links[node as usize].start, 0, dead);
        self.free_node(born);
        self.free_node(kept);
        self.links[node as usize].first = star;
        self.links[node as usize].second = NONE;
        self.shapes[node as usize].page = page;
        self.shapes[node as usize].state = State::Active;
        self.active_count -= 1;
        let parent = self.links[node as usize].parent;
        if parent != NONE {
            let [kept, born] = self.children(parent);
            if self.is_active(kept) && self.is_active(born) {
                self.shapes[parent as usize].state = State::Collapsible;
            }
        }
    }

    /// Keeps a split node from being collapsed before the time `until`, in frames modulo 65536.
    pub fn defer_collapse(&mut self, node: u32, until: u16) {
        self.links[node as usize].not_before = until;
    }

    /// Whether the time before which a split node is not to be collapsed lies ahead, by no more than `most` frames.
    pub fn collapse_is_deferred(&self, node: u32, now: u16, most: u16) -> bool {
        (1..=most).contains(&self.links[node as usize].not_before.wrapping_sub(now))
    }

    /// Takes a corner out of the star that it is in.
    fn unlink(&mut self, corner: u32) {
        let (triangle, place) = self.corner(corner);
        let (node, after) = (triangle.nodes[place], triangle.next[place]);
        let mut before = self.links[node as usize].first;
        if before == corner {
            self.links[node as usize].first = after;
            return;
        }
        while before != NONE {
            let next = &mut self.triangles[(before >> 2) as usize].next[(before & 3) as usize];
            if *next == corner {
                *next = after;
                return;
            }
            before = *next;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn a_node_takes_one_cache_line() {
        assert_eq!((NODE_BYTES, TRIANGLE_BYTES), (64, 36));
    }

    /// All splits of a model that fits into one page, down to the leaves, and back: each time what it was before.
    #[test]
    fn a_collapse_undoes_a_split() {
        let tree = testing::Mesh::grid(7, 6, 3).into_tree(5, 3);
        let blocking = metanode::header::Blocking::Forest { slot_bytes: 1 << 20, fan_out: 2 };
        let disk = testing::disk_of(&tree, blocking);
        let model = metanode::model::Model::open(&disk, "model.vdt".as_ref()).unwrap();
        let mut page = model.empty_page();
        model.read_page(model.root_pages()[0], &[], &mut metanode::model::PageReader::default(), &mut page).unwrap();
        let leaves = tree.leaf_count();
        let mut front = Front::new(model.roots(), leaves as u32, 2 * leaves, tree.triangles.corners.len(), 100);
        let state = |front: &Front| {
            let mut triangles: Vec<_> = front.triangles().collect();
            triangles.sort_unstable();
            triangles
        };
        let mut random = testing::Random(1);
        let mut log = Vec::new();
        loop {
            let inner: Vec<u32> = front.nodes().filter(|node| front.state(*node) == State::Active).collect();
            if inner.is_empty() {
                break;
            }
            let node = inner[random.below(inner.len())];
            log.push((node, state(&front)));
            let prepared = front.prepare(node, &page).unwrap();
            assert!(front.has_room(front.thirds().len()));
            front.split(&prepared, &page, 0);
        }
        assert_eq!(front.active_count(), leaves);
        assert_eq!(front.triangle_count(), tree.triangles.corners.len());
        assert!(!front.has_room(0));
        for (node, before) in log.into_iter().rev() {
            assert_eq!(front.state(node), State::Collapsible);
            front.collapse(node, page.number());
            assert!(state(&front) == before);
        }
        assert_eq!((front.active_count(), front.node_count(), front.triangle_count()), (1, 1, 0));
    }
}
