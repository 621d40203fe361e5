//! What of the front a split or a collapse will look at, fetched ahead in steps: each step looks at what the one before
//! fetched. With some other changes made in between, nothing waits for memory (`facts/front.md`: twice as fast).
//!
//! Stars beyond their first line are left out.

use super::{Birth, CHUNK, Front, NEXT, NONE};
use storage::prefetch::prefetch;

impl Front {
    /// A step towards the split of the node at a vertex.
    #[inline]
    pub fn prefetch_for_split(&self, vertex: u32, step: usize) {
        match step {
            0 => {
                prefetch(&self.links, vertex as usize);
                prefetch(&self.spans, vertex as usize);
                prefetch(&self.births, vertex as usize);
            }
            1 => {
                let links = &self.links[vertex as usize];
                self.stars.prefetch(links.star);
                // Its place holder is that of the parent, most often.
                prefetch(&self.births, links.last as usize);
                if links.last == NONE {
                    prefetch(&self.links, self.births[vertex as usize].kept as usize);
                }
                self.prefetch_criteria(vertex);
            }
            2 => self.prefetch_triangles(vertex),
            3 => self.prefetch_ring(vertex),
            _ => self.prefetch_stars(vertex),
        }
    }

    /// A step towards the collapse into a vertex: that of the split that bore a vertex last.
    #[inline]
    pub fn prefetch_for_collapse(&self, born: u32, step: usize) {
        match step {
            0 => {
                prefetch(&self.links, born as usize);
                prefetch(&self.spans, born as usize);
                prefetch(&self.births, born as usize);
                self.prefetch_criteria(born);
            }
            1 => {
                let Birth { kept, previous, .. } = self.births[born as usize];
                if kept != NONE {
                    prefetch(&self.links, kept as usize);
                    prefetch(&self.spans, kept as usize);
                    prefetch(&self.births, kept as usize);
                    self.prefetch_criteria(kept);
                }
                // What can be undone next.
                prefetch(&self.births, previous as usize);
                prefetch(&self.links, previous as usize);
                self.stars.prefetch(self.links[born as usize].star);
            }
            2 => {
                let kept = self.births[born as usize].kept;
                if kept != NONE {
                    self.stars.prefetch(self.links[kept as usize].star);
                }
                self.prefetch_triangles(born);
            }
            3 => self.prefetch_ring(born),
            _ => self.prefetch_stars(born),
        }
    }

    /// The parts of a vertex's criteria: two cache lines apart by what they are of.
    fn prefetch_criteria(&self, vertex: u32) {
        let (chunk, place) = (vertex as usize / CHUNK, vertex as usize % CHUNK);
        for criteria in [&self.split_criteria, &self.collapse_criteria] {
            if let Some(criteria) = criteria.get(chunk) {
                prefetch(&criteria.radius, place);
                prefetch(&criteria.switch, place);
                prefetch(&criteria.cone, place);
            }
        }
    }

    fn prefetch_triangles(&self, vertex: u32) {
        for corner in self.stars.first_corners(self.links[vertex as usize].star) {
            self.triangles.prefetch(corner >> 2);
        }
    }

    /// The vertices around one: each comes after it in one triangle of a closed ring.
    fn ring(&self, vertex: u32) -> impl Iterator<Item = u32> + '_ {
        self.stars.first_corners(self.links[vertex as usize].star).iter().map(|corner| {
            // What was fetched a while ago may have changed since, but there is always something.
            let corners = self.triangles.list().get((corner >> 2) as usize).copied().unwrap_or_default();
            corners[NEXT[(corner & 3) as usize]]
        })
    }

    fn prefetch_ring(&self, vertex: u32) {
        for next in self.ring(vertex) {
            prefetch(&self.spans, next as usize);
            prefetch(&self.links, next as usize);
        }
    }

    fn prefetch_stars(&self, vertex: u32) {
        for next in self.ring(vertex) {
            self.stars.prefetch(self.links[next as usize].star);
        }
    }
}
