//! What the corners of triangles carry besides a position, for who draws colours, textures, materials and given normals.
//!
//! A *wedge* is what some of the corners at a vertex have in common (`metanode::wedges`). A vertex has the wedges of its first leaf,
//! from the split that bears it until that is undone. Where no leaf has more than one, they stand by the numbers of the vertices,
//! and that is all.
//!
//! Where some have, the model has *seams*. Then each wedge has a *slot*, and those of a vertex are a list, by rising numbers in the
//! forest of wedges. Of each corner of a triangle it is kept which wedge it has in the input, and in which slot the one is that it is
//! drawn with: of the wedges at its vertex, that with the largest number which is not above its own. So a corner is looked up only
//! where its triangle is added, or where it moves to another vertex, to the one that was born or back.
//!
//! Of each vertex, no corner there has a number below the least of its wedges; and what was born from a vertex has none that is not
//! above the least there. [`Front::wedges_that_fit`] sees to that before a split. So every corner finds its wedge, whatever the pages
//! say.
//!
//! Memory: without seams 20 bytes for each vertex. With seams 4 for each vertex, 28 and two bits for each slot, and 24 for each
//! triangle. Time: with seams, a list of wedges is gone through for each corner that moves; nearly all have one or two, none more
//! than 1,023.

use bytemuck::{Pod, Zeroable};
use metanode::appearance::ModelAppearance;
use metanode::model::Model;
use metanode::page::Page;
use metanode::wedges::{MOST_WEDGES, PlacedWedge};
use storage::prefetch::prefetch;

use super::changes::Changes;
use super::numbers::Numbers;
use super::{CHUNK, Capacity, Entry, Front, NONE, list};

/// What a corner of the drawn mesh carries besides its position.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct DrawnWedge {
    /// Red, green, blue and alpha, in sRGB; 255 each where the model has no colours.
    pub colour: [u8; 4],
    /// Texture coordinate, with v upwards; zeros where the model has none.
    pub texture: [f32; 2],
    /// Which material the surface is of: its number among those of the model, counted from 1; 0: none.
    pub material: u32,
    /// The word of the normal ([`metanode::page::Normal`]): the given one, or that of the vertex where none are given.
    pub normal: u32,
}

/// How the wedges of a front are kept.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum WedgeKeeping {
    /// Not at all.
    #[default]
    None,
    /// One for each vertex.
    Vertices,
    /// In slots, since there are seams.
    Slots,
}

impl WedgeKeeping {
    /// How those of a model are kept.
    pub fn of(model: &Model) -> Self {
        match model.appearance() {
            None => WedgeKeeping::None,
            Some(appearance) if appearance.layout.has_seams => WedgeKeeping::Slots,
            Some(_) => WedgeKeeping::Vertices,
        }
    }

    /// Bytes for each vertex.
    pub fn vertex_bytes(self) -> usize {
        match self {
            WedgeKeeping::None => 0,
            WedgeKeeping::Vertices => size_of::<DrawnWedge>(),
            WedgeKeeping::Slots => size_of::<u32>(),
        }
    }

    /// Bytes for each slot.
    pub fn slot_bytes(self) -> usize {
        if self == WedgeKeeping::Slots { size_of::<DrawnWedge>() + size_of::<Slot>() } else { 0 }
    }

    /// Bytes for each triangle.
    pub fn triangle_bytes(self) -> usize {
        if self == WedgeKeeping::Slots { 2 * size_of::<[u32; 3]>() } else { 0 }
    }
}

/// The wedges of a front.
#[derive(Debug)]
pub struct Wedges {
    /// By the numbers of the vertices; with seams, by slots.
    stream: Vec<DrawnWedge>,
    texture_step: f32,
    /// Whether normals are given.
    has_normals: bool,
    seams: Option<Seams>,
}

/// Which wedges belong to which vertices and corners.
#[derive(Debug)]
pub struct Seams {
    slots: Vec<Slot>,
    numbers: Numbers,
    changes: Changes,
    /// Most slots.
    most: usize,
    /// For each vertex the slot of the first of its wedges; [`NONE`] where there is no vertex.
    firsts: Vec<u32>,
    /// For each triangle the slots of its corners, zeros where there is none.
    corners: Vec<[u32; 3]>,
    /// For each triangle the numbers of the wedges that its corners have in the input.
    sources: Vec<[u32; 3]>,
}

/// Where the wedge in a slot belongs.
#[derive(Debug, Clone, Copy)]
struct Slot {
    /// Its number in the forest of wedges.
    number: u32,
    /// The slot of the next one at its vertex.
    next: u32,
}

const NO_SLOT: Slot = Slot { number: 0, next: NONE };

impl Wedges {
    /// Those of a model that looks like this, as many as there is room for.
    pub fn new(appearance: &ModelAppearance, capacity: &Capacity) -> Self {
        let Capacity { vertices, wedges, .. } = *capacity;
        let seams = appearance.layout.has_seams.then(|| {
            let places = capacity.triangles.next_multiple_of(CHUNK);
            Seams {
                slots: list(wedges),
                numbers: Numbers::new(wedges),
                changes: Changes::new(wedges),
                most: wedges,
                firsts: list(vertices),
                corners: list(places),
                sources: list(places),
            }
        });
        Wedges {
            stream: list(if seams.is_some() { wedges } else { vertices }),
            texture_step: appearance.appearance.texture_step(),
            has_normals: appearance.layout.kinds.normals,
            seams,
        }
    }

    /// The wedges, by the numbers of the vertices; with seams, by slots.
    pub fn stream(&self) -> &[DrawnWedge] {
        &self.stream
    }

    /// Where there are seams, which wedges belong where.
    pub fn seams(&self) -> Option<&Seams> {
        self.seams.as_ref()
    }

    /// The same, to be changed.
    #[inline]
    pub fn seams_mut(&mut self) -> Option<&mut Seams> {
        self.seams.as_mut()
    }

    /// Forgets what has changed.
    pub fn clear_changes(&mut self) {
        if let Some(seams) = &mut self.seams {
            seams.changes.clear();
        }
    }

    /// So many places for vertices.
    pub fn resize(&mut self, bound: usize) {
        match &mut self.seams {
            Some(seams) => seams.firsts.resize(bound, NONE),
            None => self.stream.resize(bound, DrawnWedge::default()),
        }
    }

    /// What is drawn of a wedge at a vertex with this normal.
    pub fn drawn(&self, placed: &PlacedWedge, normal: u32) -> DrawnWedge {
        let wedge = &placed.wedge;
        DrawnWedge {
            colour: wedge.colour,
            texture: wedge.texture.map(|number| number as f32 * self.texture_step),
            material: wedge.material,
            normal: if self.has_normals { wedge.normal.to_word() } else { normal },
        }
    }

    /// A new vertex, with this normal, gets its wedges, at best beside those of the vertex `near`. There is room for them.
    #[inline(never)] // Like what follows: so the code of splits and collapses without attributes stays short.
    pub fn bear(&mut self, vertex: u32, near: u32, wedges: impl Iterator<Item = PlacedWedge>, normal: u32) {
        let mut last = NONE;
        for placed in wedges {
            let drawn = self.drawn(&placed, normal);
            let place = match &mut self.seams {
                None => vertex,
                Some(seams) => {
                    last = seams.add(vertex, near, placed.number, last);
                    self.stream.resize(seams.slots.len(), DrawnWedge::default());
                    last
                }
            };
            self.stream[place as usize] = drawn;
        }
    }

    /// Corners of triangles are at another vertex.
    #[inline(never)]
    pub fn move_corners(&mut self, corners: impl Iterator<Item = Entry>, vertex: u32) {
        if let Some(seams) = &mut self.seams {
            for entry in corners {
                let (triangle, place) = (entry.triangle(), entry.place());
                seams.corners[triangle as usize][place] = seams.find(vertex, seams.source(triangle, place));
            }
        }
    }

    /// Triangles that have these corners are gone.
    #[inline(never)]
    pub fn remove_triangles(&mut self, corners: impl Iterator<Item = Entry>) {
        if let Some(seams) = &mut self.seams {
            corners.for_each(|entry| seams.corners[entry.triangle() as usize] = [0; 3]);
        }
    }

    /// A vertex is gone.
    pub fn release(&mut self, vertex: u32) {
        if let Some(seams) = &mut self.seams {
            let mut slot = std::mem::replace(&mut seams.firsts[vertex as usize], NONE);
            while slot != NONE {
                seams.numbers.release(slot);
                slot = seams.slots[slot as usize].next;
            }
        }
    }

    /// A vertex gets another number, that of no vertex.
    pub fn renumber(&mut self, from: u32, to: u32) {
        match &mut self.seams {
            None => self.stream[to as usize] = self.stream[from as usize],
            Some(seams) => seams.firsts[to as usize] = std::mem::replace(&mut seams.firsts[from as usize], NONE),
        }
    }

    /// Drops slots at the end that are not used.
    pub fn drop_free_slots(&mut self) {
        if let Some(seams) = &mut self.seams
            && seams.numbers.drop_free_chunks()
        {
            seams.slots.truncate(seams.numbers.chunks() * CHUNK);
            self.stream.truncate(seams.slots.len());
        }
    }
}

impl Seams {
    /// Slots in use.
    pub fn used(&self) -> usize {
        self.numbers.used()
    }

    /// Slots that are free.
    pub fn room(&self) -> usize {
        self.most - self.used()
    }

    /// Which of them have changed.
    pub fn changes(&self) -> &Changes {
        &self.changes
    }

    /// For each triangle the slots of its corners; zeros where there is none.
    pub fn corners(&self) -> &[[u32; 3]] {
        &self.corners
    }

    /// The number of the wedge that a corner has in the input.
    pub fn source(&self, triangle: u32, place: usize) -> u32 {
        self.sources[triangle as usize][place]
    }

    /// The wedges of a vertex, by rising numbers: slots, with the numbers.
    pub fn at(&self, vertex: u32) -> impl Iterator<Item = (u32, u32)> + '_ {
        let mut next = self.firsts[vertex as usize];
        std::iter::from_fn(move || {
            let slot = next;
            let Slot { number, next: after } = *self.slots.get(slot as usize)?;
            next = after;
            Some((slot, number))
        })
    }

    /// The least number of a wedge of a vertex.
    #[inline]
    pub fn least(&self, vertex: u32) -> u32 {
        self.slots.get(self.firsts[vertex as usize] as usize).map_or(NONE, |slot| slot.number)
    }

    /// A slot at a vertex for the wedge of this number. `last` is the one that was added there before.
    fn add(&mut self, vertex: u32, near: u32, number: u32, last: u32) -> u32 {
        let Some(slot) = self.numbers.allocate(self.firsts[near as usize]) else {
            unreachable!("there are as many slots as the capacity says")
        };
        if slot as usize >= self.slots.len() {
            self.slots.resize(self.numbers.chunks() * CHUNK, NO_SLOT);
        }
        self.changes.note(slot);
        let (mut before, mut next) = (NONE, self.firsts[vertex as usize]);
        // Most come by rising numbers.
        if last != NONE && self.slots[last as usize].number <= number {
            (before, next) = (last, self.slots[last as usize].next);
        }
        while next != NONE && self.slots[next as usize].number <= number {
            (before, next) = (next, self.slots[next as usize].next);
        }
        self.slots[slot as usize] = Slot { number, next };
        if before == NONE {
            self.firsts[vertex as usize] = slot;
        } else {
            self.slots[before as usize].next = slot;
        }
        slot
    }

    /// The slot of the wedge at a vertex that one with this number turns into.
    #[inline]
    fn find(&self, vertex: u32, number: u32) -> u32 {
        let mut found = self.firsts[vertex as usize];
        let mut next = self.slots[found as usize].next;
        while next != NONE {
            let slot = self.slots[next as usize];
            if slot.number > number {
                break;
            }
            (found, next) = (next, slot.next);
        }
        found
    }

    /// So many places for triangles.
    #[inline]
    pub fn resize_triangles(&mut self, places: usize) {
        if self.corners.len() != places {
            self.corners.resize(places, [0; 3]);
            self.sources.resize(places, [0; 3]);
        }
    }

    /// A triangle is there, with these vertices and these wedges in the input, which pages of models with seams have for each.
    #[inline(never)]
    pub fn add_triangle(&mut self, triangle: u32, vertices: [u32; 3], sources: Option<[u32; 3]>) {
        let sources = sources.unwrap_or_default();
        self.sources[triangle as usize] = sources;
        self.corners[triangle as usize] = [0, 1, 2].map(|place: usize| self.find(vertices[place], sources[place]));
    }

    /// A triangle gets another number, that of none.
    pub fn renumber_triangle(&mut self, from: u32, to: u32) {
        self.sources[to as usize] = self.sources[from as usize];
        self.corners[to as usize] = std::mem::take(&mut self.corners[from as usize]);
    }

    /// Fetches what is known of a triangle into the cache.
    #[inline]
    pub fn prefetch(&self, triangle: u32) {
        prefetch(&self.corners, triangle as usize);
        prefetch(&self.sources, triangle as usize);
    }
}

impl Front {
    /// Makes sure that the wedges of a split fit into the front, whose third corners are known; how many slots they take. The split is
    /// that of the active node at a vertex, in its page, and bears the leaf `middle`.
    #[inline(never)]
    pub(super) fn wedges_that_fit(
        &self,
        seams: &Seams,
        vertex: u32,
        middle: u32,
        page: &Page,
    ) -> Result<usize, String> {
        let index = self.vertices[vertex as usize].record;
        let (count, least) = page
            .wedges(index)
            .fold((0, NONE), |(count, least), placed: PlacedWedge| (count + 1, placed.number.min(least)));
        if count == 0 || count > MOST_WEDGES {
            return Err(format!("leaf {middle} cannot have {count} wedges"));
        }
        let least_kept = seams.least(vertex);
        if least <= least_kept {
            return Err(format!(
                "wedge {least} of leaf {middle} does not come after {least_kept}, the first one above it"
            ));
        }
        let born = page.triangles(index).zip(page.corner_wedges(index)).zip(&self.thirds);
        for ((leaves, numbers), third) in born {
            let least_at = |place: usize| match leaves[place] {
                _ if place == 0 => least_kept,
                leaf if leaf == third.leaf => seams.least(third.vertex),
                _ => least,
            };
            if (0..3).any(|place| numbers[place] < least_at(place)) {
                return Err(format!(
                    "a corner of the triangle {leaves:?}, with the wedges {numbers:?}, has none that is drawn"
                ));
            }
        }
        let mut moving = self.star(vertex).filter(|entry| entry.leaf >= middle);
        let lost = moving.find(|entry| seams.source(entry.triangle(), entry.place()) < least);
        lost.map_or(Ok(count), |entry| {
            let number = seams.source(entry.triangle(), entry.place());
            Err(format!(
                "wedge {number} of leaf {} turns into none of leaf {middle}, which bears {least} first",
                entry.leaf
            ))
        })
    }
}
