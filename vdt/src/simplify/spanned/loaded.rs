//! The spanned sub-meshes that are in memory: loaded edge by edge with the stars that a collapse can change, collapsed,
//! and written back.
//!
//! *What is loaded for an edge*: the whole stars of both of its ends, with the vertices of their rings; and the whole star
//! of each vertex of these rings that has rejected edges, for these come back when the edge is collapsed. Nothing else is
//! read by a decision or changed by a collapse but what it takes away: a triangle that disappears from the star of a third
//! vertex. That star need not be whole here: on disk the triangle stays in its chain, marked as gone.
//!
//! In memory as on disk, a rejected edge is one that was found illegal, and that has kept the stars of its ends since. It
//! is marked on all triangles that share it, and counted at both ends; a triangle that is rewritten has no such edge.
//!
//! Local ids ascend as vertices come in, not as canonical ids do: order is always by edges as the tree has them.
//!
//! Memory: 144 bytes for each vertex, 96 for each triangle, 56 for each piece that one keeps, 4 for each place in a star; of
//! a mesh with attributes, its wedges (see `live_wedges`).

use std::collections::HashSet;

use hashbrown::HashMap;
use storage::{Edge, StorageError};

use crate::simplify::bound::Piece;
use crate::simplify::collapse::{Engine, Outcome};
use crate::simplify::live_mesh::{Normalisation, Triangle};
use crate::simplify::metric::{CollapseMetric, Quadric};
use crate::simplify::queue::neighbours;
use crate::tree::Wedge;

use super::edges::{candidate, dearer, edge_between, edge_of, ends, is_dearer};
use super::stored::{CutPieces, GONE, Link, MeshStore, PIECES_SHIFT, StoredTriangle, StoredVertex};

/// Bytes of a vertex: its line, its node, what is kept here of it, its place in the table.
const VERTEX_BYTES: usize = 64 + 48 + 12 + 20;
/// Bytes of a triangle.
const TRIANGLE_BYTES: usize = 20 + 12 + 44 + 20;

/// Bytes of a quadric that is kept, in its table.
const QUADRIC_BYTES: usize = (size_of::<Quadric>() + 5) * 8 / 7;

/// What is known of a vertex besides what the engine knows.
#[derive(Debug, Clone, Copy)]
struct LoadedVertex {
    /// Where its chain begins on disk.
    star: Link,
    /// How many of its edges are rejected.
    rejected: u32,
    /// Whether its star in memory is all of it.
    is_whole: bool,
    is_changed: bool,
}

#[derive(Debug, Clone, Copy)]
struct LoadedTriangle {
    /// As it is on disk.
    stored: StoredTriangle,
    is_changed: bool,
}

/// What an edge amounts to before it is tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// It waits for its turn.
    Due,
    /// One of its ends is gone, or its key has grown since: then it is in the queue with the new key, too.
    Void,
}

#[derive(Debug)]
pub(super) struct SubMeshes<M> {
    pub engine: Engine<M>,
    normalisation: Normalisation,
    places: HashMap<u32, u32>,
    triangle_places: HashMap<u32, u32>,
    vertices: Vec<LoadedVertex>,
    triangles: Vec<LoadedTriangle>,
    /// By local ids, the smaller one first.
    rejected: HashSet<(u32, u32)>,
    /// Of the ends of edges that were collapsed, by local ids.
    quadrics_before: HashMap<u32, Quadric>,
    star: Vec<u32>,
    ring: Vec<u32>,
    around: Vec<u32>,
}

fn pair(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

impl<M: CollapseMetric> SubMeshes<M> {
    /// None as yet. The engine's mesh is empty.
    pub fn new(engine: Engine<M>, normalisation: Normalisation) -> Self {
        SubMeshes {
            engine,
            normalisation,
            places: HashMap::new(),
            triangle_places: HashMap::new(),
            vertices: Vec::new(),
            triangles: Vec::new(),
            rejected: HashSet::new(),
            quadrics_before: HashMap::new(),
            star: Vec::new(),
            ring: Vec::new(),
            around: Vec::new(),
        }
    }

    /// Bytes that they take.
    pub fn bytes(&self) -> usize {
        let (vertices, triangles) = (self.vertices.len(), self.triangles.len());
        vertices * VERTEX_BYTES
            + triangles * TRIANGLE_BYTES
            + self.engine.mesh.covers.piece_count() * size_of::<Piece>()
            + self.engine.mesh.pool_words() * 4
            + self.engine.mesh.wedges.bytes()
            + self.rejected.len() * 16
            + self.quadrics_before.len() * QUADRIC_BYTES
    }

    /// What bytes this takes, with the stars, where each triangle keeps so many pieces.
    pub fn bytes_of(extent: Extent, most_kept: usize) -> usize {
        let Extent { vertices, triangles, wedges } = extent;
        let for_wedges = if wedges > 0 { wedges * size_of::<Wedge>() + (vertices + triangles) * 4 } else { 0 };
        vertices * (VERTEX_BYTES + 24) + triangles * (TRIANGLE_BYTES + 16 + most_kept * size_of::<Piece>()) + for_wedges
    }

    /// Triangles that are in memory, gone or not: by the local ids of their corners where they are left.
    pub fn triangles(&self) -> impl Iterator<Item = [u32; 3]> {
        self.engine.mesh.triangles.iter().filter(|triangle| !triangle.is_gone()).map(|triangle| triangle.corners)
    }

    /// The local ids of the ends of an edge, which must be loaded.
    pub fn places(&self, edge: Edge) -> Option<[u32; 2]> {
        let [low, high] = ends(edge).map(|end| self.places.get(&end).copied());
        Some([low?, high?])
    }

    /// What an edge amounts to at present. Loads nothing.
    pub fn standing(&self, store: &mut MeshStore<'_>, edge: Edge) -> Result<Standing, StorageError> {
        let mut read = |id: u32| {
            let stored = store.vertex(id)?;
            Ok::<_, StorageError>(
                (!stored.is_gone()).then(|| (self.normalisation.apply(stored.node.position), stored.quadric)),
            )
        };
        let [low, high] = ends(edge);
        let low = match self.look(low) {
            Some(known) => known,
            None => read(low)?,
        };
        let high = match self.look(high) {
            Some(known) => known,
            None => read(high)?,
        };
        Ok(self.judge(edge, [low, high]))
    }

    /// What an edge amounts to at present, if both of its ends are loaded.
    pub fn standing_of_loaded(&self, edge: Edge) -> Option<Standing> {
        let [low, high] = ends(edge);
        Some(self.judge(edge, [self.look(low)?, self.look(high)?]))
    }

    /// The normalised position and the quadric of a vertex that is loaded, `None` in it if the vertex is gone.
    fn look(&self, id: u32) -> Option<Option<([f32; 3], Quadric)>> {
        let vertex = &self.engine.mesh.vertices[*self.places.get(&id)? as usize];
        Some((!vertex.is_gone()).then_some((vertex.position, vertex.quadric)))
    }

    /// What an edge amounts to between these ends, which are `None` where they are gone.
    fn judge(&self, edge: Edge, ends: [Option<([f32; 3], Quadric)>; 2]) -> Standing {
        let [Some((position, quadric)), Some((other_position, other_quadric))] = ends else { return Standing::Void };
        let keys = self.keys((position, quadric), (other_position, other_quadric));
        let key = if is_dearer(edge) { keys[0].max(keys[1]) } else { keys[0].min(keys[1]) };
        if edge.key < key { Standing::Void } else { Standing::Due }
    }

    /// The keys of an edge in both directions, by the normalised positions and the quadrics of its ends.
    fn keys(&self, (position, quadric): ([f32; 3], Quadric), other: ([f32; 3], Quadric)) -> [u32; 2] {
        let d = std::array::from_fn(|axis| other.0[axis] - position[axis]);
        self.engine.metric.keys(&quadric, &other.1, d).map(f32::to_bits)
    }

    /// Loads all that the decision of an edge reads and may change. `false`: there are `limit` bytes (or a triangle more)
    /// already, and it is not all. Where everything is there already, it is never too much.
    pub fn prepare(&mut self, store: &mut MeshStore<'_>, edge: Edge, limit: usize) -> Result<bool, StorageError> {
        let [low, high] = ends(edge);
        let both = [self.vertex(store, low)?, self.vertex(store, high)?];
        for end in both {
            if !self.load_star(store, end, limit)? {
                return Ok(false);
            }
        }
        let mut ring = std::mem::take(&mut self.ring);
        for end in both {
            neighbours(&self.engine, end, &mut ring);
            for vertex in &ring {
                if self.vertices[*vertex as usize].rejected > 0 && !self.load_star(store, *vertex, limit)? {
                    self.ring = ring;
                    return Ok(false);
                }
            }
        }
        self.ring = ring;
        Ok(true)
    }

    /// The local id of a vertex, which is loaded if need be.
    fn vertex(&mut self, store: &mut MeshStore<'_>, id: u32) -> Result<u32, StorageError> {
        if let Some(place) = self.places.get(&id) {
            return Ok(*place);
        }
        let StoredVertex { node, quadric, state, star, rejected } = store.vertex(id)?;
        let place = self.vertices.len() as u32;
        self.engine.mesh.push_vertex(node, quadric, state);
        store.load_wedges(&mut self.engine.mesh)?;
        self.engine.mesh.set_star(place, &[]);
        self.vertices.push(LoadedVertex { star, rejected, is_whole: false, is_changed: false });
        self.places.insert(id, place);
        Ok(place)
    }

    /// Loads the triangles at a vertex. `false`: there are too many.
    fn load_star(&mut self, store: &mut MeshStore<'_>, vertex: u32, limit: usize) -> Result<bool, StorageError> {
        let LoadedVertex { star: first, is_whole, .. } = self.vertices[vertex as usize];
        if is_whole {
            return Ok(true);
        }
        let id = self.engine.mesh.vertices[vertex as usize].id;
        let mut star = std::mem::take(&mut self.star);
        star.clear();
        let mut link = first;
        while let Some(triangle) = link.triangle() {
            let place = self.triangle_places.get(&triangle).copied();
            let stored = match place {
                Some(place) => self.triangles[place as usize].stored,
                None => store.triangle(triangle)?,
            };
            link = stored.next_at(id);
            match place {
                Some(place) if self.engine.mesh.is_live(place as usize) => star.push(place),
                None if !stored.is_gone() => {
                    if self.bytes() > limit {
                        self.star = star;
                        return Ok(false);
                    }
                    star.push(self.add_triangle(store, triangle, stored)?);
                }
                Some(_) | None => {}
            }
        }
        self.engine.mesh.set_star(vertex, &star);
        self.vertices[vertex as usize].is_whole = true;
        self.star = star;
        Ok(true)
    }

    fn add_triangle(
        &mut self,
        store: &mut MeshStore<'_>,
        id: u32,
        stored: StoredTriangle,
    ) -> Result<u32, StorageError> {
        let mut corners = [0; 3];
        for (corner, id) in corners.iter_mut().zip(stored.corners) {
            *corner = self.vertex(store, id)?;
        }
        let place = self.triangles.len() as u32;
        self.engine.mesh.push_triangle(id, Triangle { corners, order: stored.order }, stored.residual);
        self.engine.mesh.covers.set_reverse(place as usize, stored.reverse);
        self.engine.mesh.wedges.set_corners(place as usize, store.corners(id)?);
        for piece in store.cut_pieces(id, &stored)?.in_order().iter().rev() {
            self.engine.mesh.covers.add_piece(place as usize, piece);
        }
        self.triangles.push(LoadedTriangle { stored, is_changed: false });
        self.triangle_places.insert(id, place);
        for side in (0..3).filter(|side| stored.flags >> side & 1 != 0) {
            self.rejected.insert(pair(corners[side], corners[(side + 1) % 3]));
        }
        Ok(place)
    }

    /// The turn of an edge has come, for which everything is loaded. `again` receives the edges that are to wait.
    pub fn decide(&mut self, edge: Edge, again: &mut Vec<Edge>) {
        let Some(places) = self.places(edge) else { return };
        let deaths = self.engine.deaths.len();
        let quadrics = places.map(|place| self.engine.mesh.vertices[place as usize].quadric);
        match self.engine.attempt(candidate(edge, places)) {
            // One whose key has grown is in the queue with the new key.
            Outcome::Gone | Outcome::Grown(_) => {}
            Outcome::OtherWay(other) => again.push(dearer(edge, other.key)),
            Outcome::Raised(raised) => again.push(Edge { key: raised.key, ..edge }),
            Outcome::Illegal => self.reject(places),
            Outcome::Collapsed { stays } => {
                for (place, quadric) in places.into_iter().zip(quadrics) {
                    self.quadrics_before.entry(place).or_insert(quadric);
                }
                let gone = if places[0] == stays { places[1] } else { places[0] };
                self.follow(gone, stays, deaths, again);
            }
        }
    }

    fn reject(&mut self, [a, b]: [u32; 2]) {
        if self.rejected.insert(pair(a, b)) {
            for end in [a, b] {
                self.vertices[end as usize].rejected += 1;
                self.vertices[end as usize].is_changed = true;
            }
            self.change_triangles(a, Some(b));
        }
    }

    /// Notes that the triangles at a vertex have changed; those at an edge, where its other end is given.
    fn change_triangles(&mut self, vertex: u32, other: Option<u32>) {
        for triangle in self.engine.mesh.star(vertex) {
            let corners = self.engine.mesh.triangles[*triangle as usize].corners;
            if other.is_none_or(|other| corners.contains(&other)) {
                self.triangles[*triangle as usize].is_changed = true;
            }
        }
    }

    /// What follows from a collapse: which records change, and which edges are to wait (as in `queue`). The triangles that
    /// disappeared are among the engine's deaths, from number `deaths` on.
    fn follow(&mut self, gone: u32, stays: u32, deaths: usize, again: &mut Vec<Edge>) {
        for vertex in [gone, stays] {
            self.vertices[vertex as usize].is_changed = true;
        }
        self.change_triangles(stays, None);
        for (id, _) in &self.engine.deaths[deaths..] {
            if let Some(place) = self.triangle_places.get(id) {
                let triangle = &mut self.triangles[*place as usize];
                triangle.is_changed = true;
                for corner in triangle.stored.corners {
                    if let Some(place) = self.places.get(&corner) {
                        self.vertices[*place as usize].is_changed = true;
                    }
                }
            }
        }
        let (mut around, mut ring) = (std::mem::take(&mut self.around), std::mem::take(&mut self.ring));
        neighbours(&self.engine, stays, &mut around);
        again.extend(around.iter().map(|other| edge_between(&self.engine, [stays, *other])));
        around.push(stays);
        for vertex in &around {
            if self.rejected.remove(&pair(gone, *vertex)) {
                self.vertices[*vertex as usize].rejected -= 1;
                self.vertices[*vertex as usize].is_changed = true;
            }
        }
        for vertex in &around {
            if self.vertices[*vertex as usize].rejected == 0 {
                continue;
            }
            neighbours(&self.engine, *vertex, &mut ring);
            for other in &ring {
                if self.rejected.remove(&pair(*vertex, *other)) {
                    for end in [*vertex, *other] {
                        self.vertices[end as usize].rejected -= 1;
                        self.vertices[end as usize].is_changed = true;
                    }
                    self.change_triangles(*vertex, Some(*other));
                    again.push(edge_between(&self.engine, [*vertex, *other]));
                }
            }
        }
        (self.around, self.ring) = (around, ring);
    }

    /// The edges above `limit` that wait in the tree for nothing, since one of their ends is gone: in ascending order, some
    /// of them perhaps not in the tree. Each as it was put in last: an older entry of it, at a smaller key, stays.
    pub fn waiting_for_nothing(&self, limit: Edge) -> Vec<Edge> {
        let mut edges = Vec::new();
        for LoadedTriangle { stored, .. } in self.triangles.iter().filter(|triangle| triangle.is_changed) {
            let places = stored.corners.map(|id| self.places.get(&id).copied());
            let [Some(a), Some(b), Some(c)] = places else { continue };
            let corners = [a, b, c];
            let is_gone = corners.map(|corner| self.engine.mesh.vertices[corner as usize].is_gone());
            // Rejected edges wait in no tree.
            for side in (0..3).filter(|side| stored.flags >> side & 1 == 0) {
                let next = (side + 1) % 3;
                if is_gone[side] || is_gone[next] {
                    let keys = self.keys(self.before(corners[side]), self.before(corners[next]));
                    edges.push(edge_of([stored.corners[side], stored.corners[next]], keys[0].min(keys[1])));
                }
            }
        }
        edges.retain(|edge| *edge > limit);
        edges.sort_unstable();
        edges.dedup();
        edges
    }

    /// The normalised position and the quadric that a vertex had when it was loaded.
    fn before(&self, place: u32) -> ([f32; 3], Quadric) {
        let line = &self.engine.mesh.vertices[place as usize];
        (line.position, self.quadrics_before.get(&place).copied().unwrap_or(line.quadric))
    }

    /// Writes back what has changed, and lets go of everything.
    pub fn write_back(&mut self, store: &mut MeshStore<'_>) -> Result<(), StorageError> {
        let SubMeshes { engine, vertices, triangles, rejected, .. } = self;
        let mesh = &engine.mesh;
        for (place, LoadedTriangle { stored, .. }) in
            triangles.iter_mut().enumerate().filter(|(_, triangle)| triangle.is_changed)
        {
            if !mesh.is_live(place) {
                stored.flags = GONE;
                store.live_triangles -= 1;
                continue;
            }
            let Triangle { corners, order } = mesh.triangles[place];
            let before = *stored;
            stored.corners = corners.map(|corner| mesh.vertices[corner as usize].id);
            stored.order = order;
            stored.next = stored.corners.map(|corner| before.next_at(corner));
            stored.flags = (0..3)
                .filter(|side| rejected.contains(&pair(corners[*side], corners[(side + 1) % 3])))
                .map(|side| 1 << side)
                .sum();
            let cover = mesh.covers.of(place);
            let mut pieces = CutPieces::default();
            mesh.covers.pieces(cover).for_each(|piece| pieces.push(piece));
            (stored.residual, stored.reverse) = (cover.residual, mesh.covers.reverse(place));
            stored.flags |= (pieces.in_order().len() as u32) << PIECES_SHIFT;
            store.put_cut_pieces(mesh.triangle_ids[place], &pieces)?;
            store.put_corners(mesh.triangle_ids[place], mesh.wedges.corners(place))?;
        }
        for (place, vertex) in vertices.iter_mut().enumerate().filter(|(_, vertex)| vertex.is_changed) {
            let line = &mesh.vertices[place];
            if line.is_gone() {
                vertex.star = Link::END;
                store.live_vertices -= 1;
            } else if vertex.is_whole {
                vertex.star = Link::END;
                for triangle in mesh.star(place as u32).iter().rev() {
                    let LoadedTriangle { stored, is_changed } = &mut triangles[*triangle as usize];
                    *is_changed |= stored.set_next_at(line.id, vertex.star);
                    vertex.star = Link::to(mesh.triangle_ids[*triangle as usize]);
                }
            }
            let (quadric, state) = (line.quadric, line.lasting_state(false));
            let LoadedVertex { star, rejected, .. } = *vertex;
            let record = StoredVertex { node: mesh.nodes[place], quadric, state, star, rejected };
            store.put_vertex(line.id, &record)?;
        }
        for (triangle, id) in triangles.iter().zip(&mesh.triangle_ids).filter(|(triangle, _)| triangle.is_changed) {
            store.put_triangle(*id, &triangle.stored)?;
        }
        self.clear();
        Ok(())
    }

    /// Lets go of everything.
    fn clear(&mut self) {
        self.engine.mesh.clear();
        self.places.clear();
        self.triangle_places.clear();
        self.vertices.clear();
        self.triangles.clear();
        self.rejected.clear();
        self.quadrics_before.clear();
    }
}

/// What the decision of an edge needs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Extent {
    pub vertices: usize,
    pub triangles: usize,
    /// Wedges of the vertices, where the mesh has attributes.
    pub wedges: usize,
}

/// What the decision of an edge needs, counted without loading it.
pub(super) fn extent(store: &mut MeshStore<'_>, edge: Edge) -> Result<Extent, StorageError> {
    let (mut vertices, mut triangles) = (HashSet::new(), HashSet::new());
    let mut left: Vec<u32> = ends(edge).to_vec();
    let mut is_ring = false;
    for _ in 0..2 {
        for vertex in std::mem::take(&mut left) {
            let stored = store.vertex(vertex)?;
            if is_ring && stored.rejected == 0 {
                continue;
            }
            let mut link = stored.star;
            while let Some(id) = link.triangle() {
                let triangle = store.triangle(id)?;
                link = triangle.next_at(vertex);
                if !triangle.is_gone() && triangles.insert(id) {
                    left.extend(triangle.corners.into_iter().filter(|corner| vertices.insert(*corner)));
                }
            }
        }
        is_ring = true;
    }
    let wedges = vertices.iter().map(|vertex| store.wedge_count(*vertex)).sum::<Result<_, _>>()?;
    Ok(Extent { vertices: vertices.len(), triangles: triangles.len(), wedges })
}
