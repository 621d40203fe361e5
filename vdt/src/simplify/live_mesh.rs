//! The mesh that is left while it is being simplified: vertices, their stars, triangles.
//!
//! One cache line per vertex (position, quadric, star). Stars are slices of triangle ids in one pool, with room to grow;
//! a star that outgrows its room moves to the end of the pool. When less than 70 % of the triangles are left, everything
//! is packed again ([`LiveMesh::compact`]): local ids change then, but keep the order of the canonical ids, so no
//! comparison ever depends on when it happened.
//!
//! Memory: 64 bytes per vertex, 4 for its canonical id and 8 for switch values; 20 bytes per triangle; the pool, 4
//! bytes per corner, and 4 + 2 on average for each star.

use crate::ingest::{CoreMesh, power_of_two};
use crate::vector::{cross, dot, minus};

use super::metric::Quadric;

/// Stands in the first corner of a triangle that is gone.
const GONE: u32 = u32::MAX;

/// Top bit of [`Vertex::state`]: the vertex lies on an edge that is not regular.
const SPECIAL: u32 = 1 << 31;

/// A vertex that is left. 64 bytes: one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Vertex {
    /// Position in normalised coordinates.
    pub position: [f32; 3],
    pub quadric: Quadric,
    /// Where its star begins in the pool. The word before holds the room there is.
    star: u32,
    /// Triangles in its star; 0: gone, or left alone by the end phase.
    degree: u32,
    /// The round in which its star changed last, and [`SPECIAL`].
    state: u32,
}

impl Vertex {
    /// The round in which its star changed last.
    pub fn touched(&self) -> u32 {
        self.state & !SPECIAL
    }

    /// Whether it lies on an edge that is not regular: a boundary, a non-manifold edge, an edge whose two triangles
    /// disagree in orientation. Fixed at the start; legal collapses keep it true.
    pub fn is_special(&self) -> bool {
        self.state & SPECIAL != 0
    }

    pub fn is_gone(&self) -> bool {
        self.degree == 0
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

#[derive(Debug)]
pub(super) struct LiveMesh {
    pub vertices: Vec<Vertex>,
    /// Canonical id of each vertex; ascending.
    pub canonical_vertex: Vec<u32>,
    /// Switch value of the node that each vertex stands for at present, normalised; 0 for leaves.
    pub node_switch: Vec<f32>,
    /// The largest switch value of a collapse that took a triangle out of each vertex's star without rewriting another
    /// one there for certain; normalised, 0 where there was none.
    pub star_switch: Vec<f32>,
    pub triangles: Vec<[u32; 3]>,
    /// Canonical id of each triangle; ascending.
    pub canonical_triangle: Vec<u32>,
    /// Switch value of the collapse that rewrote each triangle last; 0 where none did.
    pub triangle_switch: Vec<f32>,
    pool: Vec<u32>,
    live_triangles: usize,
}

/// Room for a star of this degree: a little more, since stars grow before they vanish.
fn room_for(degree: usize) -> usize {
    (degree + 2).next_multiple_of(4)
}

impl LiveMesh {
    /// The mesh before the first collapse. `with_quadrics`: whether the quadrics are to be filled.
    pub fn new(mesh: &CoreMesh, with_quadrics: bool) -> Self {
        // Two steps, since the whole factor may lie outside the range of f32 when both parts do not.
        let half = -mesh.exponent / 2;
        let factors = [power_of_two(half), power_of_two(-mesh.exponent - half)];
        let blank = Vertex { position: [0.0; 3], quadric: Quadric::default(), star: 0, degree: 0, state: 0 };
        let vertices = mesh
            .positions
            .iter()
            .map(|p| Vertex { position: p.map(|value| (f64::from(value) * factors[0] * factors[1]) as f32), ..blank })
            .collect();
        let mut live = LiveMesh {
            vertices,
            canonical_vertex: (0..mesh.positions.len() as u32).collect(),
            node_switch: vec![0.0; mesh.positions.len()],
            star_switch: vec![0.0; mesh.positions.len()],
            triangles: mesh.triangles.clone(),
            canonical_triangle: (0..mesh.triangles.len() as u32).collect(),
            triangle_switch: vec![0.0; mesh.triangles.len()],
            pool: Vec::new(),
            live_triangles: mesh.triangles.len(),
        };
        live.build_stars();
        live.mark_special();
        if with_quadrics {
            live.fill_quadrics();
        }
        live
    }

    /// Lays out all stars anew, from the triangles.
    fn build_stars(&mut self) {
        for vertex in &mut self.vertices {
            vertex.degree = 0;
        }
        for corner in self.triangles.iter().flatten() {
            self.vertices[*corner as usize].degree += 1;
        }
        let mut length = 0;
        for vertex in &mut self.vertices {
            vertex.star = length + 1;
            length += 1 + room_for(vertex.degree as usize) as u32;
        }
        self.pool.clear();
        // With some room for stars that will move, so that the pool need not be copied soon.
        self.pool.reserve_exact(length as usize + length as usize / 8);
        self.pool.resize(length as usize, 0);
        for vertex in &mut self.vertices {
            self.pool[vertex.star as usize - 1] = room_for(vertex.degree as usize) as u32;
            vertex.degree = 0;
        }
        for (triangle, corners) in self.triangles.iter().enumerate() {
            for corner in corners {
                let vertex = &mut self.vertices[*corner as usize];
                self.pool[(vertex.star + vertex.degree) as usize] = triangle as u32;
                vertex.degree += 1;
            }
        }
    }

    fn mark_special(&mut self) {
        for triangle in 0..self.triangles.len() {
            let corners = self.triangles[triangle];
            for side in 0..3 {
                let (a, b) = (corners[side], corners[(side + 1) % 3]);
                if !self.edge_use(a, b).is_regular() {
                    self.vertices[a as usize].state |= SPECIAL;
                    self.vertices[b as usize].state |= SPECIAL;
                }
            }
        }
    }

    /// The starting quadrics, summed in the order of the triangles.
    fn fill_quadrics(&mut self) {
        for triangle in 0..self.triangles.len() {
            let corners = self.triangles[triangle];
            let [a, b, c] = corners.map(|corner| self.vertices[corner as usize].position.map(f64::from));
            let normal = cross(minus(b, a), minus(c, a));
            let area = dot(normal, normal).sqrt() * 0.5;
            for corner in corners {
                self.vertices[corner as usize].quadric.add_plane_through_vertex(normal, area);
            }
            for side in 0..3 {
                let ends = [corners[side], corners[(side + 1) % 3]];
                if ends.iter().all(|end| self.vertices[*end as usize].is_special())
                    && !self.edge_use(ends[0], ends[1]).is_regular()
                {
                    let [from, to] = ends.map(|end| self.vertices[end as usize].position.map(f64::from));
                    let edge = minus(to, from);
                    for end in ends {
                        let quadric = &mut self.vertices[end as usize].quadric;
                        quadric.add_plane_through_vertex(cross(edge, normal), dot(edge, edge));
                    }
                }
            }
        }
    }

    /// The triangles at a vertex.
    pub fn star(&self, vertex: u32) -> &[u32] {
        let Vertex { star, degree, .. } = self.vertices[vertex as usize];
        &self.pool[star as usize..(star + degree) as usize]
    }

    /// The corners of a triangle after `vertex`, in its orientation.
    pub fn others(&self, triangle: u32, vertex: u32) -> [u32; 2] {
        let [a, b, c] = self.triangles[triangle as usize];
        if a == vertex {
            [b, c]
        } else if b == vertex {
            [c, a]
        } else {
            [a, b]
        }
    }

    /// How the triangles run along the edge from `a` to `b`.
    pub fn edge_use(&self, a: u32, b: u32) -> EdgeUse {
        let mut edge = EdgeUse::default();
        for triangle in self.star(a) {
            let [next, previous] = self.others(*triangle, a);
            edge.forward += usize::from(next == b);
            edge.backward += usize::from(previous == b);
        }
        edge
    }

    /// The displacement from one vertex to another.
    pub fn displacement(&self, from: u32, to: u32) -> [f32; 3] {
        let (from, to) = (&self.vertices[from as usize].position, &self.vertices[to as usize].position);
        [to[0] - from[0], to[1] - from[1], to[2] - from[2]]
    }

    pub fn live_triangles(&self) -> usize {
        self.live_triangles
    }

    pub fn is_live(&self, triangle: usize) -> bool {
        self.triangles[triangle][0] != GONE
    }

    /// Notes that the stars of all corners of the star of `vertex` changed in this round.
    pub fn touch_ring(&mut self, vertex: u32, round: u32) {
        let Vertex { star, degree, .. } = self.vertices[vertex as usize];
        for index in star..star + degree {
            for corner in self.triangles[self.pool[index as usize] as usize] {
                let state = &mut self.vertices[corner as usize].state;
                *state = *state & SPECIAL | round;
            }
        }
    }

    /// Moves every triangle of the star of `gone` to `stays`; `dead` receives those that had both, which are then gone,
    /// each with its third corner.
    /// Says how many were moved: they are the last ones in the star of `stays`.
    pub fn contract(&mut self, gone: u32, stays: u32, dead: &mut Vec<(u32, u32)>) -> u32 {
        dead.clear();
        let Vertex { star, degree, .. } = self.vertices[gone as usize];
        // The triangles that survive, packed to the front of the old star.
        let mut survivors = 0;
        for index in star..star + degree {
            let triangle = self.pool[index as usize];
            let corners = &mut self.triangles[triangle as usize];
            if corners.contains(&stays) {
                let apex = corners.iter().copied().find(|corner| *corner != gone && *corner != stays);
                dead.push((triangle, apex.unwrap_or(stays)));
            } else {
                for corner in corners {
                    if *corner == gone {
                        *corner = stays;
                    }
                }
                self.pool[(star + survivors) as usize] = triangle;
                survivors += 1;
            }
        }
        self.vertices[gone as usize].degree = 0;
        for (triangle, apex) in &*dead {
            self.remove_from_star(*apex, *triangle);
            self.remove_from_star(stays, *triangle);
            self.triangles[*triangle as usize] = [GONE; 3];
        }
        self.live_triangles -= dead.len();
        self.append_to_star(stays, star, survivors);
        survivors
    }

    /// Notes the switch value of the collapse that rewrote the last `count` triangles of a star.
    pub fn rewrite_last(&mut self, vertex: u32, count: u32, switch: f32) {
        let Vertex { star, degree, .. } = self.vertices[vertex as usize];
        for triangle in &self.pool[(star + degree - count) as usize..(star + degree) as usize] {
            self.triangle_switch[*triangle as usize] = switch;
        }
    }

    fn remove_from_star(&mut self, vertex: u32, triangle: u32) {
        let Vertex { star, degree, .. } = self.vertices[vertex as usize];
        let slots = &mut self.pool[star as usize..(star + degree) as usize];
        if let Some(place) = slots.iter().position(|other| *other == triangle) {
            slots[place] = slots[slots.len() - 1];
            self.vertices[vertex as usize].degree -= 1;
        }
    }

    /// Appends `count` pool words from `source` on to the star of `vertex`.
    fn append_to_star(&mut self, vertex: u32, source: u32, count: u32) {
        let Vertex { star, degree, .. } = self.vertices[vertex as usize];
        let (source, old) = (source as usize, star as usize..(star + degree) as usize);
        let total = (degree + count) as usize;
        if total > self.pool[star as usize - 1] as usize {
            let room = room_for(total + total / 2);
            self.pool.push(room as u32);
            let moved = self.pool.len();
            self.pool.extend_from_within(old);
            self.pool.extend_from_within(source..source + count as usize);
            self.pool.resize(moved + room, 0);
            self.vertices[vertex as usize].star = moved as u32;
        } else {
            self.pool.copy_within(source..source + count as usize, old.end);
        }
        self.vertices[vertex as usize].degree = total as u32;
    }

    /// Packs everything once less than 70 % of the triangles are left, or the pool has grown to twice its need.
    pub fn compact(&mut self) {
        let small = self.triangles.len() < 256;
        let grown = self.pool.len() > 8 * self.triangles.len() + 4 * self.vertices.len() + 1024;
        if (small || self.live_triangles * 10 >= self.triangles.len() * 7) && !grown {
            return;
        }
        let mut renumbered = vec![GONE; self.vertices.len()];
        let mut kept = 0;
        for old in 0..self.vertices.len() {
            if !self.vertices[old].is_gone() {
                renumbered[old] = kept as u32;
                self.vertices[kept] = self.vertices[old];
                self.canonical_vertex[kept] = self.canonical_vertex[old];
                self.node_switch[kept] = self.node_switch[old];
                self.star_switch[kept] = self.star_switch[old];
                kept += 1;
            }
        }
        self.vertices.truncate(kept);
        self.canonical_vertex.truncate(kept);
        self.node_switch.truncate(kept);
        self.star_switch.truncate(kept);
        let mut kept = 0;
        for old in 0..self.triangles.len() {
            if self.is_live(old) {
                self.triangles[kept] = self.triangles[old].map(|corner| renumbered[corner as usize]);
                self.canonical_triangle[kept] = self.canonical_triangle[old];
                self.triangle_switch[kept] = self.triangle_switch[old];
                kept += 1;
            }
        }
        self.triangles.truncate(kept);
        self.canonical_triangle.truncate(kept);
        self.triangle_switch.truncate(kept);
        self.build_stars();
    }
}
