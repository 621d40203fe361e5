//! The attributes of the mesh that is left: the wedges of its vertices, and which of them the corners of its triangles have.
//!
//! A vertex keeps its position and its wedges for as long as it lives. So its wedges are looked up in the mesh as it came
//! whenever (a part of) the mesh is loaded, and are never written again. What changes, and travels with the triangles, is
//! the place of each corner among the wedges of its present vertex; and, where attributes count in the order of collapses,
//! what waits for its turn at each vertex (see `rounds`).
//!
//! Memory: nothing for a mesh without attributes, or without any that a simplification heeds. Else 20 bytes for each wedge;
//! where there are seams, 4 for each vertex and 4 for each triangle; 8 for each vertex once something waits.

use bytemuck::{Pod, Zeroable};
use storage::StorageError;

use crate::nearby::Nearby;
use crate::tree::{CornerPlaces, MeshAttributes, Wedge};

use super::live_mesh::LiveMesh;

/// Which attributes a simplification heeds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Heeded {
    /// There are vertices with several wedges.
    pub seams: bool,
    /// Colours count in keys and switch values.
    pub colours: bool,
    /// Texture coordinates count in keys and switch values.
    pub textures: bool,
}

impl Heeded {
    /// Those of a mesh. (Normals follow the geometry, and materials only make seams.)
    pub fn of(attributes: Option<&MeshAttributes>) -> Self {
        attributes.map_or(Heeded::default(), |attributes| Heeded {
            seams: attributes.seams.is_some(),
            colours: attributes.appearance.kinds.colours,
            textures: attributes.appearance.kinds.textures,
        })
    }

    /// Whether any of them counts in keys and switch values.
    pub fn counts(self) -> bool {
        self.colours || self.textures
    }

    /// Whether a live mesh has wedges at all.
    pub fn has_wedges(self) -> bool {
        self.seams || self.counts()
    }
}

/// The smallest key for which an edge waits at the vertex that is its smaller end. 8 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Wait {
    /// The round in which this was noted last.
    pub round: u32,
    /// Bits of the key.
    pub key: u32,
}

impl Wait {
    /// Nothing waits.
    pub const NONE: Wait = Wait { round: 0, key: 0 };

    /// What two copies of the same vertex know together: the later one counts.
    pub fn united(self, other: Wait) -> Self {
        match self.round.cmp(&other.round) {
            std::cmp::Ordering::Less => other,
            std::cmp::Ordering::Equal => Wait { key: self.key.min(other.key), ..self },
            std::cmp::Ordering::Greater => self,
        }
    }

    /// Whether its turn comes in a round with this limit, after one with the limit `last`.
    #[inline]
    pub fn is_due(self, last: Option<u32>, limit: u32) -> bool {
        self.key <= limit && last.is_none_or(|last| self.key > last)
    }
}

/// The wedges of a live mesh.
#[derive(Debug, Default)]
pub(super) struct LiveWedges {
    heeded: Heeded,
    wedges: Vec<Wedge>,
    /// Where the wedges of each vertex end, and those of the next one begin. Not kept where each vertex has one.
    ends: Vec<u32>,
    /// The places of each triangle's corners among the wedges of their vertices. Not kept where each vertex has one.
    corners: Vec<CornerPlaces>,
    /// What waits at each vertex, once anything does.
    waits: Vec<Wait>,
}

impl LiveWedges {
    /// Of nothing yet.
    pub fn new(heeded: Heeded) -> Self {
        LiveWedges { heeded, ..LiveWedges::default() }
    }

    /// What is heeded.
    #[inline]
    pub fn heeded(&self) -> Heeded {
        self.heeded
    }

    /// Forgets all, but keeps the memory.
    pub fn clear(&mut self) {
        self.wedges.clear();
        self.ends.clear();
        self.corners.clear();
        self.waits.clear();
    }

    /// Makes room for so many triangles more.
    pub fn reserve(&mut self, triangles: usize) {
        if self.heeded.seams {
            self.corners.reserve_exact(triangles);
        }
    }

    /// Bytes that they take.
    pub fn bytes(&self) -> usize {
        self.wedges.len() * size_of::<Wedge>()
            + (self.ends.len() + self.corners.len()) * size_of::<u32>()
            + self.waits.len() * size_of::<Wait>()
    }

    /// Vertices whose wedges are here.
    fn vertices(&self) -> usize {
        if self.heeded.seams { self.ends.len() } else { self.wedges.len() }
    }

    /// The wedges of a vertex; none where none are heeded.
    #[inline]
    pub fn of(&self, vertex: u32) -> &[Wedge] {
        let vertex = vertex as usize;
        if !self.heeded.seams {
            return self.wedges.get(vertex..=vertex).unwrap_or_default();
        }
        let first = if vertex == 0 { 0 } else { self.ends[vertex - 1] };
        &self.wedges[first as usize..self.ends[vertex] as usize]
    }

    /// The wedge of a vertex at this place.
    #[inline]
    pub fn wedge(&self, vertex: u32, place: u32) -> &Wedge {
        &self.of(vertex)[place as usize]
    }

    /// Appends a triangle whose corners have the first wedges of their vertices.
    #[inline]
    pub fn push_triangle(&mut self) {
        if self.heeded.seams {
            self.corners.push(CornerPlaces::default());
        }
    }

    /// The places of a triangle's corners.
    #[inline]
    pub fn corners(&self, triangle: usize) -> CornerPlaces {
        self.corners.get(triangle).copied().unwrap_or_default()
    }

    /// Notes the places of a triangle's corners, if such are noted.
    #[inline]
    pub fn set_corners(&mut self, triangle: usize, places: CornerPlaces) {
        if let Some(corners) = self.corners.get_mut(triangle) {
            *corners = places;
        }
    }

    /// Moves a triangle to another number, which is not larger.
    pub fn renumber_triangle(&mut self, old: usize, new: usize) {
        if self.heeded.seams {
            self.corners[new] = self.corners[old];
        }
    }

    /// Forgets the triangles from this number on.
    pub fn truncate_triangles(&mut self, triangles: usize) {
        self.corners.truncate(triangles);
    }

    /// Forgets the vertices that are not kept; the others move up.
    pub fn keep_vertices(&mut self, is_kept: impl Fn(usize) -> bool) {
        keep(&mut self.waits, &is_kept);
        if !self.heeded.seams {
            keep(&mut self.wedges, &is_kept);
            return;
        }
        let (mut first, mut kept, mut kept_end) = (0, 0, 0);
        for vertex in 0..self.ends.len() {
            let end = self.ends[vertex];
            if is_kept(vertex) {
                self.wedges.copy_within(first as usize..end as usize, kept_end as usize);
                kept_end += end - first;
                self.ends[kept] = kept_end;
                kept += 1;
            }
            first = end;
        }
        self.ends.truncate(kept);
        self.wedges.truncate(kept_end as usize);
    }

    /// What waits at a vertex.
    #[inline]
    pub fn wait(&self, vertex: u32) -> Wait {
        self.waits.get(vertex as usize).copied().unwrap_or(Wait::NONE)
    }

    /// Notes what waits at a vertex.
    pub fn set_wait(&mut self, vertex: u32, wait: Wait) {
        if wait == Wait::NONE {
            return;
        }
        let count = self.vertices().max(vertex as usize + 1);
        if self.waits.len() < count {
            self.waits.resize(count, Wait::NONE);
        }
        self.waits[vertex as usize] = wait;
    }

    /// Notes, in a round with this limit, that an edge waits at its smaller end with a key above the limit.
    pub fn make_wait(&mut self, vertex: u32, key: u32, round: u32, limit: u32) {
        let before = self.wait(vertex);
        let is_to_come = before.key > limit;
        self.set_wait(vertex, Wait { round, key: if is_to_come { before.key.min(key) } else { key } });
    }
}

/// Keeps some records.
fn keep<T>(records: &mut Vec<T>, is_kept: impl Fn(usize) -> bool) {
    let mut number = 0;
    records.retain(|_| {
        number += 1;
        is_kept(number - 1)
    });
}

impl LiveMesh {
    /// Looks up the wedges of all vertices that do not have theirs yet: the last ones.
    pub fn load_wedges(&mut self, reader: &mut WedgeReader<'_>) -> Result<(), StorageError> {
        let LiveWedges { heeded, wedges, ends, .. } = &mut self.wedges;
        if !heeded.has_wedges() {
            return Ok(());
        }
        let first = if heeded.seams { ends.len() } else { wedges.len() };
        for node in &self.nodes[first..] {
            reader.append_to(wedges, node.id)?;
            if heeded.seams {
                ends.push(wedges.len() as u32);
            }
        }
        Ok(())
    }

    /// Looks up all that there is of a part of the mesh before the first collapse: its triangles are `first..` of the
    /// canonical ones.
    pub fn load_first_attributes(&mut self, attributes: &MeshAttributes, first: u32) -> Result<(), StorageError> {
        self.load_wedges(&mut WedgeReader::new(attributes, 1))?;
        if let Some(seams) = attributes.seams.as_ref().filter(|_| self.wedges.heeded.seams) {
            seams.corners.read_at(first.into(), &mut self.wedges.corners)?;
        }
        Ok(())
    }
}

/// Wedges by canonical vertex, for look-ups that stay near each other.
#[derive(Debug)]
pub(super) struct WedgeReader<'a> {
    wedges: Nearby<'a, Wedge>,
    first_wedges: Option<Nearby<'a, u32>>,
}

impl<'a> WedgeReader<'a> {
    /// Records in a stretch.
    const STRETCH: u64 = 1024;
    /// Bytes of a stretch of wedges, with one of where wedges begin.
    pub const STRETCH_BYTES: usize = Self::STRETCH as usize * (size_of::<Wedge>() + size_of::<u32>());

    /// With so many stretches of either kind in memory: one, where vertices are asked for in ascending order.
    pub fn new(attributes: &'a MeshAttributes, kept: usize) -> Self {
        let seams = attributes.seams.as_ref();
        WedgeReader {
            wedges: Nearby::new(&attributes.wedges, Self::STRETCH, kept),
            first_wedges: seams.map(|seams| Nearby::new(&seams.first_wedges, Self::STRETCH, kept)),
        }
    }

    /// The numbers of the wedges of a vertex: of the first, and one past the last.
    fn numbers(&mut self, vertex: u32) -> Result<[u64; 2], StorageError> {
        let vertex = u64::from(vertex);
        let Some(first_wedges) = &mut self.first_wedges else { return Ok([vertex, vertex + 1]) };
        let first = first_wedges.get(vertex)?.into();
        let is_last = vertex + 1 == first_wedges.len();
        let end = if is_last { self.wedges.len() } else { first_wedges.get(vertex + 1)?.into() };
        Ok([first, end])
    }

    /// How many wedges a vertex has.
    pub fn count(&mut self, vertex: u32) -> Result<usize, StorageError> {
        let [first, end] = self.numbers(vertex)?;
        Ok((end - first) as usize)
    }

    /// Appends the wedges of a vertex.
    fn append_to(&mut self, wedges: &mut Vec<Wedge>, vertex: u32) -> Result<(), StorageError> {
        let [first, end] = self.numbers(vertex)?;
        self.wedges.append_to(wedges, first, end)
    }
}
