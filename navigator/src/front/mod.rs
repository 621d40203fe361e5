//! The active front (the paper, 3.3.1): the lists of active nodes and of active triangles, with the splits that are
//! applied above them, and the two exact inverses that change them, split and collapse.
//!
//! # Vertices
//!
//! A node has the position of its first leaf, and so has its kept child. So a *vertex* of the front stands for a leaf whose
//! position is drawn: it is there from the split that bears that leaf until that split is undone, while the active node at it
//! goes from a node to its kept child with every split, and back. So there is one vertex for each active node; and one for each
//! applied split, the one that it bore, but for the roots', which no split bears. What is known of both is kept by the number of
//! the vertex; split nodes need no place of their own:
//!
//! - of the active node, its leaf interval, ids, where its split is recorded, its star ([`stars`]), and what decides whether it
//!   is to be split;
//! - of the *birth*, the split that bore the vertex: the vertex that it was born from (`kept`), the place holder of its record,
//!   and what the split node is when it is restored;
//! - the vertex born `last` from this one, and the one born from the same vertex `previous`ly. So the splits that were applied at
//!   a vertex form a stack. The one on top can be undone, that is its node collapsed, where the vertex that it bore has none.
//!   What decides about that node is kept at the vertex where it would stand.
//!
//! # Triangles
//!
//! An active triangle has three vertices for corners ([`triangles`]). Splitting p moves the corners at p whose leaf belongs to the
//! born child there, and adds p's born triangles: the first corner is under the kept child, one other under the born child, and
//! the third corner's vertex is found by its leaf: first around p, else from the root down ([`lookup`]). So nothing here takes room
//! in proportion to the mesh. Collapsing p removes the triangles that have both children for corners, and moves all other corners
//! to p.
//!
//! Where it is asked for, the front also has where vertices come from that are on their way ([`morphs`]), and what corners carry
//! besides positions ([`wedges`]).
//!
//! All lists are allocated once and never grow. Nothing that comes from a page is trusted: what does not fit is a [`Misfit`],
//! found before anything is changed ([`prepare`]).
//!
//! What belongs to a vertex is one cache line, but for its position, which a renderer takes as it is, and for what decides about
//! changes there, which stands in groups of eight vertices, so that a whole front is judged in one stream.
//!
//! Memory: [`VERTEX_BYTES`] = 106 for each vertex, 68 for each line of its star, and 12 for each triangle; 4 for each tree;
//! and what [`morphs`] and [`wedges`] say. Time: a split or a collapse looks at some 30 cache lines, which are fetched ahead
//! ([`ahead`]).

mod ahead;
mod changes;
mod collapse;
mod lookup;
mod morphs;
mod numbers;
mod prepare;
mod split;
mod stars;
mod triangles;
mod wedges;

use metanode::appearance::ModelAppearance;
use metanode::header::ModelRoot;
use metanode::page::{ChildEntry, NormalCone, Target};

pub use self::changes::Changes;
pub use self::morphs::MORPH_BYTES;
use self::morphs::Morphs;
use self::numbers::Numbers;
pub use self::prepare::{Misfit, Prepared};
use self::stars::Stars;
pub use self::stars::{Entry, LINE_BYTES};
use self::triangles::Triangles;
pub use self::triangles::{TRIANGLE_BYTES, TRIANGLE_LIMIT};
use self::wedges::Wedges;
pub use self::wedges::{DrawnWedge, Seams, WedgeKeeping};
use crate::evaluation::{self, Criteria, GROUP, Group, Groups};
use crate::view::Sphere;
use storage::prefetch::ask_for_large_pages;

/// Numbers of vertices in a chunk: those that are judged together.
pub const CHUNK: usize = evaluation::BLOCK;
/// "None" for vertices, lines and pages.
pub const NONE: u32 = u32::MAX;
/// The id of a collapse that there is not: later than everything.
pub const NEVER: u32 = u32::MAX;
/// Bytes that a vertex takes, without its star.
pub const VERTEX_BYTES: usize = size_of::<Vertex>() + POSITION_BYTES + CRITERIA_BYTES + size_of::<u16>();
/// Bytes that a tree takes.
pub const TREE_BYTES: usize = size_of::<u32>();
const POSITION_BYTES: usize = size_of::<[f32; 4]>();
const CRITERIA_BYTES: usize = size_of::<Group>() / GROUP;

/// The switch value that stands where there is no node to be split: no view asks for that.
const NO_SPLIT: f32 = -1.0;
/// The switch value that stands where there is no node to be restored: every view asks for more.
const NO_COLLAPSE: f32 = f32::INFINITY;

/// Of the active node at a vertex, what its neighbours ask for.
#[derive(Debug, Clone, Copy, Default)]
struct Span {
    /// First leaf under the node; that of the vertex.
    start: u32,
    /// One past the last.
    end: u32,
    /// Dependency id; 0 of a leaf.
    id: u32,
    /// Id of the first collapse above that moves the node's corners elsewhere, see [`Front::moved_by`].
    moved_by: u32,
}

/// Of a vertex, what only its own changes ask for.
#[derive(Debug, Clone, Copy)]
struct Links {
    /// The vertex that was born from this one last.
    last: u32,
    /// The star of the active node: its first line.
    star: u32,
    /// Number of the page with the split of the active node, [`NONE`] for a leaf.
    page: u32,
}

/// The split that bore a vertex.
#[derive(Debug, Clone, Copy)]
struct Birth {
    /// The vertex that it was born from; [`NONE`] for a root, which no split bore.
    kept: u32,
    /// The vertex that was born from that one before.
    previous: u32,
    /// The place holder that the record is in.
    slot: u32,
    /// Of the node that was split: its id, that of the first collapse above it that moves its corners, and its sphere and cone.
    id: u32,
    moved_by: u32,
    radius: f32,
    switch: f32,
    cone: NormalCone,
}

/// A vertex, in one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
struct Vertex {
    span: Span,
    links: Links,
    birth: Birth,
    /// Index of the record of the active node's split in its page.
    record: u16,
    /// The same for the split that bore the vertex.
    birth_record: u16,
}

const NO_LINKS: Links = Links { last: NONE, star: NONE, page: NONE };
const NO_BIRTH: Birth = Birth {
    kept: NONE,
    previous: NONE,
    slot: NONE,
    id: NEVER,
    moved_by: NEVER,
    radius: 0.0,
    switch: NO_COLLAPSE,
    cone: NormalCone::EVERYTHING,
};
const NO_VERTEX: Vertex = Vertex {
    span: Span { start: 0, end: 0, id: 0, moved_by: 0 },
    links: NO_LINKS,
    birth: NO_BIRTH,
    record: 0,
    birth_record: 0,
};
const NO_GROUP: Group = Group { split: Criteria::vacant(NO_SPLIT), collapse: Criteria::vacant(NO_COLLAPSE) };

/// Room in a front.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Capacity {
    /// Vertices, that is active nodes. A multiple of [`CHUNK`].
    pub vertices: usize,
    /// Active triangles.
    pub triangles: usize,
    /// Cache lines of stars.
    pub lines: usize,
    /// Triangles that one split can bear.
    pub born_triangles: usize,
    /// Slots of wedges, where there are any. A multiple of [`CHUNK`].
    pub wedges: usize,
}

impl Capacity {
    /// Cache lines of stars that are enough for the front of any model with so many vertices and triangles: all lines but one of
    /// each star are full.
    pub fn most_lines(vertices: usize, triangles: usize) -> usize {
        vertices + (3 * triangles).div_ceil(stars::CORNERS)
    }
}

/// A corner of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Corner {
    /// The vertex that it is at.
    pub vertex: u32,
    /// The leaf that it is in the input.
    pub leaf: u32,
}

/// The front.
#[derive(Debug)]
pub struct Front {
    vertices: Vec<Vertex>,
    /// x, y, z, and the normal.
    positions: Vec<[f32; 4]>,
    /// What decides about splits and collapses: each eight vertices.
    groups: Vec<Group>,
    /// For each vertex the time before which the split that bore it is not to be undone, in frames modulo 65536, if that is near.
    not_before: Vec<u16>,
    /// For each chunk a bit for each vertex: whether the split of the active node is in another page than its parent's.
    leads_out: Vec<u64>,
    numbers: Numbers,
    changes: Changes,
    morphs: Option<Morphs>,
    wedges: Option<Wedges>,
    stars: Stars,
    triangles: Triangles,
    /// Active triangles of each tree.
    tree_triangles: Vec<u32>,
    /// Trees that have none.
    vanished_trees: usize,
    root_count: u32,
    leaf_count: u32,
    capacity: Capacity,
    /// The third corners of the triangles that the prepared split bears.
    thirds: Vec<Corner>,
}

/// A list that never grows, on large memory pages.
fn list<T>(capacity: usize) -> Vec<T> {
    let mut list = Vec::with_capacity(capacity);
    ask_for_large_pages(list.spare_capacity_mut());
    list
}

impl Front {
    /// The front with all roots active.
    pub fn new(roots: &[ModelRoot], leaf_count: u32, capacity: Capacity) -> Self {
        let chunks = capacity.vertices.max(roots.len()).div_ceil(CHUNK);
        let vertices = chunks * CHUNK;
        let mut front = Front {
            vertices: list(vertices),
            positions: list(vertices),
            groups: list(vertices / GROUP),
            not_before: list(vertices),
            leads_out: list(chunks),
            numbers: Numbers::new(vertices),
            changes: Changes::new(vertices),
            morphs: None,
            wedges: None,
            stars: Stars::new(capacity.lines),
            triangles: Triangles::new(capacity.triangles),
            tree_triangles: vec![0; roots.len()],
            vanished_trees: roots.len(),
            root_count: roots.len() as u32,
            leaf_count,
            capacity: Capacity { vertices, ..capacity },
            thirds: Vec::with_capacity(capacity.born_triangles),
        };
        for root in roots {
            // The roots have the first numbers, in their order, and keep them.
            let vertex = front.new_vertex(0, root.position, root.normal.to_word());
            front.vertices[vertex] = Vertex {
                span: Span { start: root.start, end: root.end, id: root.id, moved_by: NEVER },
                links: Links { page: root.page.number, ..NO_LINKS },
                record: root.record,
                ..NO_VERTEX
            };
            front.set_split(vertex, root.radius, root.switch, root.cone);
            front.set_leads_out(vertex, true);
        }
        front
    }

    /// The same where what splits bear goes to its place in so many frames.
    pub fn with_morphs(mut self, frames: u32) -> Self {
        let mut morphs = Morphs::new(self.capacity.vertices, frames);
        morphs.resize(self.positions.len());
        self.vertices().for_each(|root| morphs.put(root));
        self.morphs = Some(morphs);
        self
    }

    /// The same where corners of triangles have what a model that looks like this says.
    pub fn with_wedges(mut self, appearance: &ModelAppearance) -> Self {
        let mut wedges = Wedges::new(appearance, &self.capacity);
        wedges.resize(self.positions.len());
        for (tree, root) in self.vertices().enumerate() {
            let normal = self.positions[root as usize][3].to_bits();
            wedges.bear(root, root, appearance.root_wedges.of_tree(tree).iter().copied(), normal);
        }
        self.wedges = Some(wedges);
        self
    }

    /// Most vertices, triangles, lines and slots.
    pub fn capacity(&self) -> Capacity {
        self.capacity
    }

    /// How many of them there are, and no born triangles.
    pub fn used(&self) -> Capacity {
        Capacity {
            vertices: self.vertex_count(),
            triangles: self.triangle_count(),
            lines: self.line_count(),
            born_triangles: 0,
            wedges: self.wedges.as_ref().and_then(Wedges::seams).map_or(0, |seams| seams.used()),
        }
    }

    /// Vertices, that is active nodes (and perhaps roots without a triangle).
    pub fn vertex_count(&self) -> usize {
        self.numbers.used()
    }

    /// Active triangles.
    pub fn triangle_count(&self) -> usize {
        self.triangles.count()
    }

    /// Cache lines that the stars take.
    pub fn line_count(&self) -> usize {
        self.stars.used()
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
        // The roots are the first vertices, in the order of their leaves.
        let after = self.vertices[..self.root_count as usize].partition_point(|root| root.span.start <= leaf);
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

    /// Whether there is room for the split that was prepared last.
    pub fn has_room(&self, prepared: &Prepared) -> bool {
        let born_triangles = self.thirds.len();
        self.numbers.used() < self.capacity.vertices
            && self.triangles.count() + born_triangles <= self.triangles.capacity()
            && self.stars.room() >= Stars::most_for_split(born_triangles)
            && self.wedges.as_ref().and_then(Wedges::seams).is_none_or(|seams| seams.room() >= prepared.born_wedges)
    }

    /// The numbers of vertices are below this; those below it may be free.
    pub fn vertex_bound(&self) -> u32 {
        self.positions.len() as u32
    }

    /// Whether there is a vertex with this number.
    pub fn is_vertex(&self, vertex: u32) -> bool {
        self.numbers.is_used(vertex)
    }

    /// The vertices.
    pub fn vertices(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.vertex_bound()).filter(|vertex| self.is_vertex(*vertex))
    }

    /// Whether the active node at a vertex is a leaf of the tree.
    pub fn is_leaf(&self, vertex: u32) -> bool {
        self.vertices[vertex as usize].span.id == 0
    }

    /// Dependency id of the active node at a vertex; 0 of a leaf.
    pub fn id(&self, vertex: u32) -> u32 {
        self.vertices[vertex as usize].span.id
    }

    /// Dependency id of the first collapse above an active node that moves its corners: that of its parent for a born child. A
    /// kept child's corners stay where they are, so for that it is what it is for the parent. [`NEVER`] where there is none.
    pub fn moved_by(&self, vertex: u32) -> u32 {
        self.vertices[vertex as usize].span.moved_by
    }

    /// The leaves under the active node at a vertex, from the first to one past the last.
    pub fn interval(&self, vertex: u32) -> (u32, u32) {
        let span = &self.vertices[vertex as usize].span;
        (span.start, span.end)
    }

    /// Where a vertex stands, and what decides about the active node there. The switch value of a leaf is 0.
    pub fn sphere(&self, vertex: u32) -> Sphere {
        let [x, y, z, _] = self.positions[vertex as usize];
        let (criteria, place) = (&self.groups[vertex as usize / GROUP].split, vertex as usize % GROUP);
        Sphere {
            position: [x, y, z],
            radius: criteria.radius[place],
            switch: criteria.switch[place].max(0.0),
            cone: NormalCone::from_word(criteria.cone[place]),
        }
    }

    /// The same for the node that would be restored where the split that bore `born` was undone.
    pub fn sphere_above(&self, born: u32) -> Sphere {
        let birth = &self.vertices[born as usize].birth;
        let [x, y, z, _] = self.positions[birth.kept as usize];
        Sphere { position: [x, y, z], radius: birth.radius, switch: birth.switch, cone: birth.cone }
    }

    /// For each 64 vertices the first number, positions, and what decides about splits and collapses. Places without a vertex, leaves, and vertices
    /// at which nothing can be undone, have switch values by which no view wants a change.
    pub fn blocks(&self) -> impl Iterator<Item = (u32, &[[f32; 4]; CHUNK], &Groups)> {
        let (positions, _) = self.positions.as_chunks::<CHUNK>();
        let (groups, _) = self.groups.as_chunks::<{ CHUNK / GROUP }>();
        let blocks = (0..).step_by(CHUNK).zip(positions).zip(groups);
        blocks.map(|((first, positions), groups)| (first, positions, groups))
    }

    /// For each block, of which vertices the split of the active node is in another page than its parent's: a bit for each.
    pub fn leads_out(&self) -> impl Iterator<Item = u64> + '_ {
        self.leads_out.iter().copied()
    }

    /// Positions, with the word of the normal, by the numbers of the vertices.
    pub fn positions(&self) -> &[[f32; 4]] {
        &self.positions
    }

    /// The corners of the triangles, as numbers of vertices; three times the same where there is no triangle.
    pub fn corners(&self) -> &[[u32; 3]] {
        self.triangles.list()
    }

    /// Which vertices and which triangles have changed.
    pub fn changes(&self) -> (&Changes, &Changes) {
        (&self.changes, self.triangles.changes())
    }

    /// Where vertices come from that go to their places, and how far they are, see [`morphs`]; `None` where none ever does.
    pub fn morphs(&self) -> Option<&Morphs> {
        self.morphs.as_ref()
    }

    /// What corners of triangles carry besides positions; `None` where nothing is kept of that.
    pub fn wedges(&self) -> Option<&Wedges> {
        self.wedges.as_ref()
    }

    /// Which wedges have changed, see [`Wedges::stream`]: without seams those of new vertices.
    pub fn changed_wedges(&self) -> Option<&Changes> {
        self.wedges.as_ref().map(|wedges| wedges.seams().map_or(&self.changes, |seams| seams.changes()))
    }

    /// How many vertices are on their way.
    pub fn under_way(&self) -> usize {
        self.morphs.as_ref().map_or(0, |morphs| morphs.under_way(&self.numbers))
    }

    /// All vertices that are on their way go a step on.
    pub fn step_morphs(&mut self) {
        if let Some(morphs) = &mut self.morphs {
            morphs.step(&self.numbers);
        }
    }

    /// Forgets which have.
    pub fn clear_changes(&mut self) {
        if let Some(morphs) = &mut self.morphs {
            morphs.clear_changes();
        }
        if let Some(wedges) = &mut self.wedges {
            wedges.clear_changes();
        }
        self.changes.clear();
        self.triangles.clear_changes();
    }

    /// The page that the split of the active node at a vertex is in, and its record; [`NONE`] for a leaf.
    pub fn place(&self, vertex: u32) -> (u32, u16) {
        let vertex = &self.vertices[vertex as usize];
        (vertex.links.page, vertex.record)
    }

    /// The split whose child the active node at a vertex is, by the vertex that it bore; [`NONE`] for a root.
    pub fn split_above(&self, vertex: u32) -> u32 {
        match self.vertices[vertex as usize].links.last {
            NONE if self.vertices[vertex as usize].birth.kept == NONE => NONE,
            NONE => vertex,
            last => last,
        }
    }

    /// The place holder with the record of the split that bore a vertex.
    pub fn slot(&self, born: u32) -> u32 {
        self.vertices[born as usize].birth.slot
    }

    /// The same for the split whose child the active node at a vertex is; [`NONE`] for a root.
    pub fn slot_above(&self, vertex: u32) -> u32 {
        match self.split_above(vertex) {
            NONE => NONE,
            born => self.slot(born),
        }
    }

    /// Index of the record of the split that bore a vertex.
    pub fn record_of_birth(&self, born: u32) -> u16 {
        self.vertices[born as usize].birth_record
    }

    /// Id of the node whose split bore a vertex.
    pub fn id_above(&self, born: u32) -> u32 {
        self.vertices[born as usize].birth.id
    }

    /// The vertex from which one was born; [`NONE`] for a root.
    pub fn kept(&self, born: u32) -> u32 {
        self.vertices[born as usize].birth.kept
    }

    /// The vertex born from the same one before; [`NONE`] where it was the first.
    pub fn previous(&self, born: u32) -> u32 {
        self.vertices[born as usize].birth.previous
    }

    /// The vertices that splits bore: for each applied split the one.
    pub fn born(&self) -> impl Iterator<Item = u32> + '_ {
        self.vertices().filter(|vertex| self.kept(*vertex) != NONE)
    }

    /// Whether the split that bore a vertex can be undone: whether both children of its node are active.
    pub fn is_collapsible(&self, born: u32) -> bool {
        let kept = self.vertices[born as usize].birth.kept;
        kept != NONE
            && self.vertices[born as usize].links.last == NONE
            && self.vertices[kept as usize].links.last == born
    }

    /// The vertex born last from this one, where there is one: whose split can be undone if any there can.
    pub fn last_born(&self, vertex: u32) -> u32 {
        self.vertices[vertex as usize].links.last
    }

    /// The leaves under the node that a vertex was born as.
    pub fn interval_of_birth(&self, vertex: u32) -> (u32, u32) {
        let (start, mut end) = self.interval(vertex);
        let mut born = self.last_born(vertex);
        while born != NONE {
            (_, end) = self.interval_of_birth(born);
            born = self.previous(born);
        }
        (start, end)
    }

    /// Whether what decides about splits and collapses at a vertex is that of the nodes there; else which is not. For checks.
    pub fn criteria_fit(&self, vertex: u32) -> Result<(), &'static str> {
        let (group, place) = (&self.groups[vertex as usize / GROUP], vertex as usize % GROUP);
        let (split, collapse) = (group.split.switch[place], group.collapse.switch[place]);
        let last = self.last_born(vertex);
        let restored = if last != NONE && self.is_collapsible(last) {
            self.vertices[last as usize].birth.switch
        } else {
            NO_COLLAPSE
        };
        if (split == NO_SPLIT) != self.is_leaf(vertex) {
            Err("a leaf is to be split, or a node never is")
        } else if (self.leads_out[vertex as usize / CHUNK] >> (vertex as usize % CHUNK) & 1 == 1)
            && self.is_leaf(vertex)
        {
            Err("a leaf leads into a page")
        } else if collapse != restored {
            Err("the node to be restored is another one")
        } else {
            Ok(())
        }
    }

    /// The corners of triangles at a vertex.
    pub fn star(&self, vertex: u32) -> impl Iterator<Item = Entry> + '_ {
        self.stars.corners(self.vertices[vertex as usize].links.star)
    }

    /// Whether a vertex has no triangle.
    pub fn is_bare(&self, vertex: u32) -> bool {
        self.vertices[vertex as usize].links.star == NONE
    }

    /// The vertices at the other corners of a triangle, in its orientation.
    #[inline]
    pub fn others(&self, entry: Entry) -> [u32; 2] {
        let corners = self.triangles.corners(entry.triangle());
        let place = entry.place();
        [corners[NEXT[place]], corners[NEXT[NEXT[place]]]]
    }

    /// The active triangles: their corners as vertices.
    pub fn triangles(&self) -> impl Iterator<Item = (u32, [u32; 3])> + '_ {
        self.triangles.iter()
    }

    /// The leaf that the corner of a triangle at a vertex is in the input.
    pub fn leaf_at(&self, vertex: u32, triangle: u32) -> u32 {
        let found = self.star(vertex).find(|entry| entry.triangle() == triangle);
        found.map_or(NONE, |entry| entry.leaf)
    }

    /// Keeps the split that bore a vertex from being undone before the time `until`, in frames modulo 65536.
    pub fn defer_collapse(&mut self, born: u32, until: u16) {
        self.not_before[born as usize] = until;
    }

    /// Whether the time before which it is not to be undone lies ahead, by no more than `most` frames.
    pub fn collapse_is_deferred(&self, born: u32, now: u16, most: u16) -> bool {
        (1..=most).contains(&self.not_before[born as usize].wrapping_sub(now))
    }

    /// Moves up to `most` of the last triangles, and of the last vertices, to places before them that have none, where there are
    /// many of those.
    pub fn close_gaps(&mut self, most: usize) {
        (0..most).take_while(|_| self.move_last_triangle()).count();
        (0..most).take_while(|_| self.move_last_vertex()).count();
        if let Some(wedges) = &mut self.wedges {
            wedges.drop_free_slots();
        }
    }

    /// False where there are not many gaps.
    fn move_last_triangle(&mut self) -> bool {
        let last = self.triangles.last_if_sparse();
        let seams = self.wedges.as_mut().and_then(Wedges::seams_mut);
        let Some(last) = last else {
            if let Some(seams) = seams {
                seams.resize_triangles(self.triangles.list().len());
            }
            return false;
        };
        let corners = self.triangles.corners(last);
        let moved = self.triangles.add(corners, 0);
        if let Some(seams) = seams {
            seams.resize_triangles(self.triangles.list().len());
            seams.renumber_triangle(last, moved);
        }
        for (place, vertex) in corners.into_iter().enumerate() {
            self.stars.rename(
                self.vertices[vertex as usize].links.star,
                last << 2 | place as u32,
                moved << 2 | place as u32,
            );
        }
        self.triangles.remove(last);
        true
    }

    /// False where there are not many gaps, or only roots, which keep their numbers.
    fn move_last_vertex(&mut self) -> bool {
        if self.numbers.drop_free_chunks() {
            self.resize(self.numbers.chunks() * CHUNK);
        }
        let Some(last) = self.numbers.last_if_sparse().filter(|last| *last >= self.root_count) else { return false };
        let Vertex { links, birth: Birth { kept, .. }, .. } = self.vertices[last as usize];
        // At best beside the one that it was born from, where that is before it.
        let near = if kept / CHUNK as u32 == last / CHUNK as u32 { 0 } else { kept };
        let [x, y, z, normal] = self.positions[last as usize];
        let moved = self.new_vertex(near, [x, y, z], normal.to_bits());
        self.vertices[moved] = self.vertices[last as usize];
        self.not_before[moved] = self.not_before[last as usize];
        let (of_last, place) = (self.groups[last as usize / GROUP], last as usize % GROUP);
        self.groups[moved / GROUP].split.copy(moved % GROUP, &of_last.split, place);
        self.groups[moved / GROUP].collapse.copy(moved % GROUP, &of_last.collapse, place);
        if let Some(morphs) = &mut self.morphs {
            morphs.renumber(last, moved as u32);
        }
        if let Some(wedges) = &mut self.wedges {
            wedges.renumber(last, moved as u32);
        }
        self.set_leads_out(moved, self.leads_out[last as usize / CHUNK] >> (last as usize % CHUNK) & 1 == 1);
        let moved = moved as u32;

        let triangles = &mut self.triangles;
        self.stars.corners(links.star).for_each(|entry| triangles.move_corner(entry.triangle(), entry.place(), moved));
        let mut born = links.last;
        while born != NONE {
            let birth = &mut self.vertices[born as usize].birth;
            birth.kept = moved;
            born = birth.previous;
        }
        // Among those born from the same vertex, the one that was born next leads to it.
        let mut after = self.vertices[kept as usize].links.last;
        if after == last {
            self.vertices[kept as usize].links.last = moved;
        } else {
            while self.vertices[after as usize].birth.previous != last {
                after = self.vertices[after as usize].birth.previous;
            }
            self.vertices[after as usize].birth.previous = moved;
        }
        self.vacate(last);
        true
    }

    /// Gives the number of a vertex back. No view wants a change there any more.
    fn vacate(&mut self, vertex: u32) {
        self.set_child(vertex as usize, None);
        self.groups[vertex as usize / GROUP].collapse.switch[vertex as usize % GROUP] = NO_COLLAPSE;
        self.vertices[vertex as usize].birth.kept = NONE;
        self.numbers.release(vertex);
    }

    /// So many places for vertices.
    fn resize(&mut self, bound: usize) {
        self.vertices.resize(bound, NO_VERTEX);
        self.positions.resize(bound, [0.0; 4]);
        self.leads_out.resize(bound / CHUNK, 0);
        self.groups.resize(bound / GROUP, NO_GROUP);
        self.not_before.resize(bound, 0);
        if let Some(morphs) = &mut self.morphs {
            morphs.resize(bound);
        }
        if let Some(wedges) = &mut self.wedges {
            wedges.resize(bound);
        }
    }

    /// A vertex with everything but its position still to be said.
    fn new_vertex(&mut self, near: u32, [x, y, z]: [f32; 3], normal: u32) -> usize {
        let Some(vertex) = self.numbers.allocate(near) else {
            unreachable!("there are as many numbers as the capacity says")
        };
        if vertex as usize >= self.positions.len() {
            self.resize(self.numbers.chunks() * CHUNK);
        }
        self.positions[vertex as usize] = [x, y, z, f32::from_bits(normal)];
        self.changes.note(vertex);
        vertex as usize
    }

    /// What decides about the split of the node at a vertex.
    #[inline]
    fn set_split(&mut self, vertex: usize, radius: f32, switch: f32, cone: NormalCone) {
        self.groups[vertex / GROUP].split.set(vertex % GROUP, radius, switch, cone);
    }

    /// Whether the split of the node at a vertex is in another page than its parent's.
    #[inline]
    fn set_leads_out(&mut self, vertex: usize, leads_out: bool) {
        let (word, place) = (&mut self.leads_out[vertex / CHUNK], vertex % CHUNK);
        *word = *word & !(1 << place) | u64::from(leads_out) << place;
    }

    /// The same for a child that was just born or kept; `None` for a leaf.
    #[inline]
    fn set_child(&mut self, vertex: usize, entry: Option<&ChildEntry>) {
        self.set_leads_out(vertex, entry.is_some_and(|entry| matches!(entry.target, Target::ChildPage { .. })));
        match entry {
            Some(entry) => self.set_split(vertex, entry.radius, entry.switch, entry.cone),
            None => self.set_split(vertex, 0.0, NO_SPLIT, NormalCone::EVERYTHING),
        }
    }

    /// What decides about the collapse into a vertex: that of the split which bore `born`, if that one can be undone.
    #[inline]
    fn set_collapse(&mut self, vertex: u32, born: u32) {
        let (criteria, place) = (&mut self.groups[vertex as usize / GROUP].collapse, vertex as usize % GROUP);
        if born != NONE && self.vertices[born as usize].links.last == NONE {
            let Birth { radius, switch, cone, .. } = self.vertices[born as usize].birth;
            criteria.set(place, radius, switch, cone);
        } else {
            criteria.switch[place] = NO_COLLAPSE;
        }
    }
}

/// The corner after one.
const NEXT: [usize; 3] = [1, 2, 0];

/// Index of the record of a child in its page.
fn record_of(entry: Option<&ChildEntry>) -> u16 {
    entry.map_or(0, |entry| match entry.target {
        Target::SamePage { record } | Target::ChildPage { record, .. } => record,
    })
}

#[cfg(test)]
mod tests;
