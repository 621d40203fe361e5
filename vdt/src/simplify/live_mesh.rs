//! The mesh that is left while it is being simplified, or a part of it: vertices, their stars, triangles.
//!
//! One cache line per vertex (position, quadric, star) with what every test reads, and 48 bytes beside it with what only
//! a collapse reads: the node that the vertex stands for. Stars are slices of triangle ids in one pool, with room to
//! grow; a star that outgrows its room moves to the end of the pool. When less than 70 % of the triangles are left,
//! everything is packed again ([`LiveMesh::compact`]). Local ids always keep the order of the canonical ids, so no
//! comparison ever depends on which part of the mesh this is, or on when it was packed.
//!
//! What each triangle answers for, where certified switch values are asked for, is beside them (`bound`), and so are the
//! wedges of a mesh with attributes (`live_wedges`).
//!
//! Memory: 112 bytes per vertex, 20 per triangle, what `bound` needs, the pool of 4 bytes per corner, and 8 + 8 + 4 on
//! average for each star.

use bytemuck::{Pod, Zeroable};

use crate::ingest::power_of_two;
use crate::tree::{CornerPlaces, ErrorBound, Normal};

use super::bound::Covers;
use super::live_wedges::{Heeded, LiveWedges};
use super::metric::Quadric;

/// Bit of [`Vertex::state`]: the vertex lies on an edge that is not regular.
pub(super) const SPECIAL: u32 = 1 << 31;
/// Bit of [`Vertex::state`]: what is known of the vertex may not be true, see `unsettled`.
const UNSETTLED: u32 = 1 << 30;
/// Bit of [`Vertex::state`]: collapsed onto another one.
const GONE: u32 = 1 << 29;
/// Bit of [`Vertex::state`]: all of the vertex's star is here, whatever it shares with other parts of the mesh.
const WHOLE: u32 = 1 << 28;
/// The bits of [`Vertex::state`] that hold since when the vertex is stale, so that the largest counts.
const STALE: u32 = 7 << STALE_SHIFT;
const STALE_SHIFT: u32 = 25;
/// The bits of [`Vertex::state`] that hold the round.
const ROUND: u32 = (1 << STALE_SHIFT) - 1;
/// No pass has more rounds.
pub(super) const MOST_ROUNDS: u8 = 8;

/// A vertex that is left, as all tests read it. 64 bytes: one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Vertex {
    /// Position in normalised coordinates.
    pub position: [f32; 3],
    pub quadric: Quadric,
    /// Canonical id.
    pub id: u32,
    /// Where its star begins in the pool. The two words before hold the room there is, and how many triangles are in it.
    star: u32,
    /// The round in which its star changed last, and flags.
    state: u32,
}

impl Vertex {
    /// The round in which its star changed last.
    pub fn touched(&self) -> u32 {
        self.state & ROUND
    }

    /// Whether it lies on an edge that is not regular: a boundary, a non-manifold edge, an edge whose two triangles
    /// disagree in orientation. Fixed at the start; legal collapses keep it true.
    #[inline]
    pub fn is_special(&self) -> bool {
        self.state & SPECIAL != 0
    }

    /// Whether what is known of it may not be true.
    #[inline]
    pub fn is_unsettled(&self) -> bool {
        self.state & UNSETTLED != 0
    }

    /// Whether it was collapsed onto another one.
    #[inline]
    pub fn is_gone(&self) -> bool {
        self.state & GONE != 0
    }

    /// Whether all of its star is here, whatever it shares with other parts of the mesh.
    pub fn is_whole(&self) -> bool {
        self.state & WHOLE != 0
    }

    /// Whether what a block knows of its star may not be true in the round at hand, see `unsettled`.
    #[inline]
    pub fn is_stale(&self) -> bool {
        self.state & STALE != 0
    }

    /// Takes away, and returns, from which round of the pass on it is stale, by its index; [`MOST_ROUNDS`] where it is
    /// not.
    pub fn take_stale(&mut self) -> u8 {
        let stale = (self.state & STALE) >> STALE_SHIFT;
        self.state &= !STALE;
        MOST_ROUNDS - stale as u8
    }

    /// What of its state goes to disk: the round, whether it is special, and whether all of its star goes along; then also
    /// since when it is stale.
    pub fn lasting_state(&self, is_whole: bool) -> u32 {
        self.state & (SPECIAL | ROUND | if is_whole { STALE } else { 0 }) | if is_whole { WHOLE } else { 0 }
    }
}

/// The node of the tree that a vertex stands for at present. 48 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Node {
    /// Canonical id of the vertex.
    pub id: u32,
    /// Its position, in mesh units.
    pub position: [f32; 3],
    /// Its dependency id; 0 for leaves.
    pub order: u32,
    /// The largest id of a collapse that took a triangle out of the vertex's star without rewriting another one there for
    /// certain; 0 where there was none.
    pub star_order: u32,
    /// Leaves under the node.
    pub leaves: u32,
    /// Leaves under the kept child of its last split; 0 for leaves.
    pub last_split: u32,
    /// Radius of its bounding sphere, in mesh units.
    pub radius: f32,
    /// Its normal cone, as a word.
    pub cone: u32,
    /// The normal of the input at the vertex.
    pub normal: Normal,
    /// The label of its component, see `components`.
    pub label: u32,
}

impl Node {
    /// The leaf that is a vertex of the input.
    pub fn leaf(id: u32, position: [f32; 3], cone: u32, normal: Normal) -> Self {
        Node { id, position, order: 0, star_order: 0, leaves: 1, last_split: 0, radius: 0.0, cone, normal, label: 0 }
    }
}

/// A triangle that is left, or was. 16 bytes, so that none straddles two cache lines.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(16))]
pub(super) struct Triangle {
    /// Its corners in its orientation. Of a triangle that is gone, all three are the same.
    pub corners: [u32; 3],
    /// Dependency id of the collapse that rewrote it last; 0 where none did.
    pub order: u32,
}

impl Triangle {
    const GONE: Triangle = Triangle { corners: [u32::MAX; 3], order: 0 };

    #[inline]
    pub fn is_gone(&self) -> bool {
        self.corners[0] == u32::MAX
    }
}

/// How many triangles run along an edge a, b in each direction.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct EdgeUse {
    /// With b right after a.
    pub forward: usize,
    /// With a right after b.
    pub backward: usize,
}

impl EdgeUse {
    /// An inner edge of an oriented manifold.
    pub fn is_regular(self) -> bool {
        self.forward == 1 && self.backward == 1
    }

    pub fn is_unused(self) -> bool {
        self.forward == 0 && self.backward == 0
    }
}

/// How the triangles of a ring run along the edge from the ring's centre to `vertex`. A ring has, for each triangle at
/// its centre, the corners after the centre in the triangle's orientation.
pub(super) fn edge_use(ring: &[[u32; 2]], vertex: u32) -> EdgeUse {
    let mut edge = EdgeUse::default();
    for [next, previous] in ring {
        edge.forward += usize::from(*next == vertex);
        edge.backward += usize::from(*previous == vertex);
    }
    edge
}

/// Mesh units to normalised ones, by a power of two. In two steps, since the whole factor may lie outside the range of
/// f32 when both parts do not.
#[derive(Debug, Clone, Copy)]
pub(super) struct Normalisation {
    factors: [f64; 2],
}

impl Normalisation {
    /// For a mesh that is at most 2^exponent wide.
    pub fn new(exponent: i32) -> Self {
        let half = -exponent / 2;
        Normalisation { factors: [power_of_two(half), power_of_two(-exponent - half)] }
    }

    pub fn apply(self, position: [f32; 3]) -> [f32; 3] {
        position.map(|value| (f64::from(value) * self.factors[0] * self.factors[1]) as f32)
    }
}

#[derive(Debug)]
pub(super) struct LiveMesh {
    normalisation: Normalisation,
    /// A corner of the box of the whole mesh, normalised.
    pub reference: [f32; 3],
    pub vertices: Vec<Vertex>,
    /// The node of each vertex; their canonical ids ascend.
    pub nodes: Vec<Node>,
    pub triangles: Vec<Triangle>,
    /// Canonical id of each triangle; ascending where this is the whole mesh.
    pub triangle_ids: Vec<u32>,
    /// What each triangle answers for.
    pub covers: Covers,
    /// The wedges of the vertices and of the corners.
    pub wedges: LiveWedges,
    pool: Vec<u32>,
    /// How long the pool was when the stars were laid out.
    packed_pool: usize,
    /// Room for a number for each vertex.
    places: Vec<u32>,
    live_triangles: usize,
}

/// Words in front of each star in the pool.
const STAR_HEADER: usize = 2;
/// How far in front of a star its room stands.
const ROOM: usize = 2;
/// How far in front of a star its degree stands.
const DEGREE: usize = 1;

/// Room for a star of this degree: a little more, since stars grow before they vanish.
fn room_for(degree: usize) -> usize {
    (degree + 2).next_multiple_of(4)
}

impl LiveMesh {
    /// A mesh without anything in it. `corner`, in mesh units, is one of the box of the whole mesh. `bound`
    /// says what is noted of each triangle, `heeded` which attributes there are.
    pub fn new(normalisation: Normalisation, corner: [f32; 3], bound: ErrorBound, heeded: Heeded) -> Self {
        LiveMesh {
            normalisation,
            reference: normalisation.apply(corner),
            vertices: Vec::new(),
            nodes: Vec::new(),
            triangles: Vec::new(),
            triangle_ids: Vec::new(),
            covers: Covers::new(bound),
            wedges: LiveWedges::new(heeded),
            pool: Vec::new(),
            packed_pool: 0,
            places: Vec::new(),
            live_triangles: 0,
        }
    }

    /// Lets go of everything in it, but keeps the memory for another one.
    pub fn clear(&mut self) {
        self.vertices.clear();
        self.nodes.clear();
        self.triangles.clear();
        self.triangle_ids.clear();
        self.covers.clear();
        self.wedges.clear();
        self.pool.clear();
        self.live_triangles = 0;
    }

    /// Lets go of everything in it, and of the memory that it took.
    pub fn release(&mut self) {
        let LiveMesh { normalisation, reference, .. } = *self;
        let empty = LiveMesh::new(normalisation, [0.0; 3], self.covers.bound(), self.wedges.heeded());
        *self = LiveMesh { reference, ..empty };
    }

    /// Appends a vertex, whose canonical id is larger than all before.
    pub fn push_vertex(&mut self, node: Node, quadric: Quadric, state: u32) {
        let position = self.normalisation.apply(node.position);
        self.vertices.push(Vertex { position, quadric, id: node.id, star: 0, state });
        self.nodes.push(node);
    }

    /// Appends a triangle between vertices that are there or will be. `residual` is that of what it answers for.
    pub fn push_triangle(&mut self, id: u32, triangle: Triangle, residual: f32) {
        self.triangles.push(triangle);
        self.triangle_ids.push(id);
        self.covers.push(residual);
        self.wedges.push_triangle();
        self.live_triangles += 1;
    }

    /// Makes room for this many more, so that nothing has to grow by doubling.
    pub fn reserve(&mut self, vertices: usize, triangles: usize) {
        self.vertices.reserve_exact(vertices);
        self.nodes.reserve_exact(vertices);
        self.triangles.reserve_exact(triangles);
        self.triangle_ids.reserve_exact(triangles);
        self.covers.reserve(triangles);
        self.wedges.reserve(triangles);
    }

    /// Lays out all stars anew, from the triangles: each in the order of the triangles.
    pub fn build_stars(&mut self) {
        // First the degrees, then where the next triangle of each star goes.
        let places = &mut self.places;
        places.clear();
        places.resize(self.vertices.len(), 0);
        for corner in self.triangles.iter().flat_map(|triangle| triangle.corners) {
            places[corner as usize] += 1;
        }
        let length: usize = places.iter().map(|degree| STAR_HEADER + room_for(*degree as usize)).sum();
        self.pool.clear();
        self.packed_pool = length;
        // With some room for stars that will move, so that the pool need not be copied soon.
        self.pool.reserve_exact(length + length / 8);
        self.pool.resize(length, 0);
        let mut next = STAR_HEADER;
        for (vertex, place) in self.vertices.iter_mut().zip(places.iter_mut()) {
            let room = room_for(*place as usize);
            self.pool[next - ROOM] = room as u32;
            self.pool[next - DEGREE] = *place;
            vertex.star = next as u32;
            *place = next as u32;
            next += room + STAR_HEADER;
        }
        for (number, triangle) in (0..).zip(&self.triangles) {
            for corner in triangle.corners {
                let place = &mut places[corner as usize];
                self.pool[*place as usize] = number;
                *place += 1;
            }
        }
    }

    /// Gives a vertex its star, where the mesh grows piece by piece instead of being laid out by [`Self::build_stars`]. A
    /// vertex must have one, be it empty, before anything is done to its neighbours.
    pub fn set_star(&mut self, vertex: u32, triangles: &[u32]) {
        let room = if triangles.is_empty() { 0 } else { room_for(triangles.len()) };
        let star = self.pool.len() + STAR_HEADER;
        self.pool.extend([room as u32, triangles.len() as u32]);
        self.pool.extend_from_slice(triangles);
        self.pool.resize(star + room, 0);
        self.vertices[vertex as usize].star = star as u32;
    }

    /// Words of all stars, and of the room that they have left.
    pub fn pool_words(&self) -> usize {
        self.pool.len()
    }

    /// Notes that a vertex lies on an edge that is not regular.
    pub fn mark_special(&mut self, vertex: u32) {
        self.vertices[vertex as usize].state |= SPECIAL;
    }

    /// Notes that what is known of a vertex may not be true.
    #[inline]
    pub fn unsettle(&mut self, vertex: u32) {
        self.vertices[vertex as usize].state |= UNSETTLED;
    }

    /// Makes stale, from the round of this index in the pass on, what is unsettled and not stale yet. The index is 1 at
    /// least, and below [`MOST_ROUNDS`].
    pub fn make_stale(&mut self, round_index: u8) {
        let stale = u32::from(MOST_ROUNDS - round_index) << STALE_SHIFT;
        for vertex in &mut self.vertices {
            if vertex.is_unsettled() && !vertex.is_stale() {
                vertex.state |= stale;
            }
        }
    }

    /// The triangles at a vertex.
    #[inline]
    pub fn star(&self, vertex: u32) -> &[u32] {
        let star = self.vertices[vertex as usize].star as usize;
        &self.pool[star..star + self.pool[star - DEGREE] as usize]
    }

    /// The corners of a triangle after `vertex`, in its orientation.
    #[inline]
    pub fn others(&self, triangle: u32, vertex: u32) -> [u32; 2] {
        let [a, b, c] = self.triangles[triangle as usize].corners;
        if a == vertex {
            [b, c]
        } else if b == vertex {
            [c, a]
        } else {
            [a, b]
        }
    }

    /// Fills `ring` with the other two corners of every triangle at `vertex`, in the order of the star.
    #[inline]
    pub fn fill_ring(&self, vertex: u32, ring: &mut Vec<[u32; 2]>) {
        ring.clear();
        ring.extend(self.star(vertex).iter().map(|triangle| self.others(*triangle, vertex)));
    }

    /// Whether a triangle has both of these vertices.
    pub fn has_edge(&self, a: u32, b: u32) -> bool {
        self.star(a).iter().any(|triangle| self.triangles[*triangle as usize].corners.contains(&b))
    }

    /// The displacement from one vertex to another.
    #[inline]
    pub fn displacement(&self, from: u32, to: u32) -> [f32; 3] {
        let (from, to) = (&self.vertices[from as usize].position, &self.vertices[to as usize].position);
        [to[0] - from[0], to[1] - from[1], to[2] - from[2]]
    }

    pub fn live_triangles(&self) -> usize {
        self.live_triangles
    }

    #[inline]
    pub fn is_live(&self, triangle: usize) -> bool {
        !self.triangles[triangle].is_gone()
    }

    /// Notes that the star of a vertex changed in this round.
    #[inline]
    pub fn touch(&mut self, vertex: u32, round: u32) {
        let state = &mut self.vertices[vertex as usize].state;
        *state = *state & !ROUND | round;
    }

    /// Gives the corners at `gone` of the triangles that survive its collapse onto `stays` the images of their wedges, turned
    /// as [`Self::contract`] will turn the triangles.
    pub fn rewrite_corners(&mut self, gone: u32, stays: u32, images: &[u32]) {
        for index in 0..self.star(gone).len() {
            let triangle = self.star(gone)[index] as usize;
            let corners = self.triangles[triangle].corners;
            let Some(first) = corners.iter().position(|corner| *corner == gone) else { continue };
            if !corners.contains(&stays) {
                let [own, next, previous] = self.wedges.corners(triangle).turned(first).places();
                self.wedges.set_corners(triangle, CornerPlaces::of([images[own as usize], next, previous]));
            }
        }
    }

    /// Moves every triangle of the star of `gone`, whose ring is `ring`, to `stays`; `dead` receives those that had
    /// both, which are then gone, each with its third corner. The survivors get `order` as that of the collapse that
    /// rewrote them.
    pub fn contract(&mut self, gone: u32, stays: u32, ring: &[[u32; 2]], order: u32, dead: &mut Vec<(u32, u32)>) {
        dead.clear();
        let Vertex { star, .. } = self.vertices[gone as usize];
        // The triangles that survive, packed to the front of the old star.
        let mut survivors = 0;
        for (index, [next, previous]) in (star..).zip(ring) {
            let triangle = self.pool[index as usize];
            if *next == stays {
                dead.push((triangle, *previous));
            } else if *previous == stays {
                dead.push((triangle, *next));
            } else {
                // In the same orientation, from the corner that was rewritten on.
                self.triangles[triangle as usize] = Triangle { corners: [stays, *next, *previous], order };
                self.pool[(star + survivors) as usize] = triangle;
                survivors += 1;
            }
        }
        self.vertices[gone as usize].state |= GONE;
        for (triangle, apex) in &*dead {
            self.remove_from_star(*apex, *triangle);
            self.remove_from_star(stays, *triangle);
            self.triangles[*triangle as usize] = Triangle::GONE;
        }
        self.live_triangles -= dead.len();
        self.append_to_star(stays, star, survivors);
    }

    fn remove_from_star(&mut self, vertex: u32, triangle: u32) {
        let star = self.vertices[vertex as usize].star as usize;
        let degree = self.pool[star - DEGREE] as usize;
        let slots = &mut self.pool[star..star + degree];
        if let Some(place) = slots.iter().position(|other| *other == triangle) {
            slots[place] = slots[degree - 1];
            self.pool[star - DEGREE] -= 1;
        }
    }

    /// Appends `count` pool words from `source` on to the star of `vertex`.
    fn append_to_star(&mut self, vertex: u32, source: u32, count: u32) {
        let star = self.vertices[vertex as usize].star as usize;
        let (source, count) = (source as usize, count as usize);
        let degree = self.pool[star - DEGREE] as usize;
        let total = degree + count;
        if total > self.pool[star - ROOM] as usize {
            let room = room_for(total + total / 2);
            let moved = self.pool.len() + STAR_HEADER;
            if self.pool.capacity() < moved + room {
                // Not by doubling: the pool is a fifth of all that there is in memory.
                self.pool.reserve_exact(room + STAR_HEADER + self.pool.len() / 32);
            }
            self.pool.resize(moved, 0);
            self.pool.extend_from_within(star..star + degree);
            self.pool.extend_from_within(source..source + count);
            self.pool.resize(moved + room, 0);
            self.pool[moved - ROOM] = room as u32;
            self.pool[moved - DEGREE] = total as u32;
            self.vertices[vertex as usize].star = moved as u32;
        } else {
            self.pool.copy_within(source..source + count, star + degree);
            self.pool[star - DEGREE] = total as u32;
        }
    }

    /// Packs everything once less than 70 % of the triangles are left, or the pool has grown by a quarter.
    pub fn compact(&mut self) {
        let small = self.triangles.len() < 256;
        let grown = self.pool.len() > self.packed_pool + self.packed_pool / 4 + 1024;
        if (small || self.live_triangles * 10 >= self.triangles.len() * 7) && !grown {
            return;
        }
        let vertices = &self.vertices;
        self.wedges.keep_vertices(|vertex| !vertices[vertex].is_gone());
        let mut renumbered = vec![0; self.vertices.len()];
        let mut kept = 0;
        for old in 0..self.vertices.len() {
            if !self.vertices[old].is_gone() {
                renumbered[old] = kept as u32;
                self.vertices[kept] = self.vertices[old];
                self.nodes[kept] = self.nodes[old];
                kept += 1;
            }
        }
        self.vertices.truncate(kept);
        self.nodes.truncate(kept);
        let mut kept = 0;
        for old in 0..self.triangles.len() {
            if self.is_live(old) {
                let Triangle { corners, order } = self.triangles[old];
                let corners = corners.map(|corner| renumbered[corner as usize]);
                self.triangles[kept] = Triangle { corners, order };
                self.triangle_ids[kept] = self.triangle_ids[old];
                self.covers.renumber(old, kept);
                self.wedges.renumber_triangle(old, kept);
                kept += 1;
            }
        }
        self.triangles.truncate(kept);
        self.triangle_ids.truncate(kept);
        self.covers.truncate(kept);
        self.wedges.truncate_triangles(kept);
        self.build_stars();
    }

    /// Has the lines of a vertex on their way from memory.
    #[inline]
    pub fn prefetch_vertex(&self, vertex: u32) {
        super::prefetch::read(&self.vertices, vertex as usize);
    }

    /// Has the star of a vertex, whose line should be there by now, on its way from memory.
    #[inline]
    pub fn prefetch_star(&self, vertex: u32) {
        super::prefetch::read(&self.pool, self.vertices[vertex as usize].star as usize - DEGREE);
    }

    /// Has the triangles of a vertex, whose star should be there by now, on their way from memory, with what they answer for.
    #[inline]
    pub fn prefetch_triangles(&self, vertex: u32) {
        for triangle in self.star(vertex).iter().take(8) {
            super::prefetch::read(&self.triangles, *triangle as usize);
            self.covers.prefetch(*triangle as usize);
        }
    }

    /// Has the node of a vertex on its way from memory.
    #[inline]
    pub fn prefetch_node(&self, vertex: u32) {
        super::prefetch::read(&self.nodes, vertex as usize);
    }

    /// Has the neighbours of a vertex, whose triangles should be there by now, on their way from memory, and the pieces
    /// that those triangles keep.
    #[inline]
    pub fn prefetch_ring(&self, vertex: u32) {
        for triangle in self.star(vertex).iter().take(8) {
            self.covers.prefetch_piece(*triangle as usize);
            for corner in self.others(*triangle, vertex) {
                super::prefetch::read(&self.vertices, corner as usize);
            }
        }
    }
}
