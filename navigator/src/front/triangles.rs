//! The active triangles: the list of corners that a renderer draws as it is, and which parts of it have changed.
//!
//! Triangle t has its corners, numbers of vertices, at place t. A place without a triangle holds the same vertex three times,
//! so nothing is drawn there.
//!
//! Memory: 12 bytes and three bits for each place.

use super::CHUNK;
use super::changes::Changes;
use super::numbers::Numbers;

/// Bytes that a triangle takes.
pub const TRIANGLE_BYTES: usize = size_of::<[u32; 3]>();
/// Most triangles a front can hold: corners are numbered in 32 bits.
pub const TRIANGLE_LIMIT: usize = 1 << 30;
/// What stands in a place without a triangle.
const VACANT: [u32; 3] = [0; 3];

/// The triangles.
#[derive(Debug)]
pub struct Triangles {
    corners: Vec<[u32; 3]>,
    numbers: Numbers,
    capacity: usize,
    changes: Changes,
}

impl Triangles {
    /// Room for so many triangles.
    pub fn new(capacity: usize) -> Self {
        let places = capacity.next_multiple_of(CHUNK);
        let mut corners: Vec<[u32; 3]> = Vec::with_capacity(places);
        storage::prefetch::ask_for_large_pages(corners.spare_capacity_mut());
        Triangles { corners, numbers: Numbers::new(places), capacity, changes: Changes::new(places) }
    }

    /// Most triangles.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Triangles there are.
    pub fn count(&self) -> usize {
        self.numbers.used()
    }

    /// The list, with places without a triangle in it.
    pub fn list(&self) -> &[[u32; 3]] {
        &self.corners
    }

    /// The places that have changed.
    pub fn changes(&self) -> &Changes {
        &self.changes
    }

    /// Forgets which have.
    pub fn clear_changes(&mut self) {
        self.changes.clear();
    }

    /// The corners of a triangle.
    #[inline]
    pub fn corners(&self, triangle: u32) -> [u32; 3] {
        self.corners[triangle as usize]
    }

    /// The triangles with their numbers.
    pub fn iter(&self) -> impl Iterator<Item = (u32, [u32; 3])> + '_ {
        (0..).zip(self.corners.iter().copied()).filter(|(triangle, _)| self.numbers.is_used(*triangle))
    }

    /// Adds a triangle with three distinct corners, where there is room: at best beside `near`.
    #[inline]
    pub fn add(&mut self, corners: [u32; 3], near: u32) -> u32 {
        let Some(triangle) = self.numbers.allocate(near) else {
            unreachable!("there are as many places as the capacity says")
        };
        if triangle as usize >= self.corners.len() {
            self.corners.resize(self.numbers.chunks() * CHUNK, VACANT);
        }
        self.corners[triangle as usize] = corners;
        self.changes.note(triangle);
        triangle
    }

    /// Puts another vertex at a corner of a triangle.
    #[inline]
    pub fn move_corner(&mut self, triangle: u32, place: usize, vertex: u32) {
        self.corners[triangle as usize][place] = vertex;
        self.changes.note(triangle);
    }

    /// Takes a triangle away.
    #[inline]
    pub fn remove(&mut self, triangle: u32) {
        self.corners[triangle as usize] = VACANT;
        self.numbers.release(triangle);
        self.changes.note(triangle);
    }

    /// Shortens the list to what is used of it. Then, if many places in it have no triangle, the last one: to be put elsewhere.
    pub fn last_if_sparse(&mut self) -> Option<u32> {
        if self.numbers.drop_free_chunks() {
            self.corners.truncate(self.numbers.chunks() * CHUNK);
        }
        self.numbers.last_if_sparse()
    }

    /// Fetches a triangle into the cache.
    #[inline]
    pub fn prefetch(&self, triangle: u32) {
        storage::prefetch::prefetch(&self.corners, triangle as usize);
    }
}
