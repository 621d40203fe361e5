//! What of the front a split or a collapse will look at, fetched ahead in steps: each step looks at what the one before
//! fetched. With some other changes made in between, nothing waits for memory (`facts/front.md`: twice as fast).
//!
//! Stars beyond their first line are left out.

use super::wedges::Wedges;
use super::{Birth, Front, GROUP, NEXT, NONE, Vertex};
use storage::prefetch::prefetch;

impl Front {
    /// A step towards the split of the node at a vertex.
    #[inline]
    pub fn prefetch_for_split(&self, vertex: u32, step: usize) {
        match step {
            0 => prefetch(&self.vertices, vertex as usize),
            1 => {
                let Vertex { links, birth, .. } = &self.vertices[vertex as usize];
                self.stars.prefetch(links.star);
                // Its place holder is that of the parent.
                prefetch(&self.vertices, if links.last == NONE { birth.kept } else { links.last } as usize);
                self.prefetch_criteria(vertex);
            }
            2 => self.prefetch_triangles(vertex),
            3 => self.prefetch_ring(vertex),
            _ => self.prefetch_stars(vertex),
        }
    }

    /// A step towards knowing which vertex was born last from this one, and as what.
    #[inline]
    pub fn prefetch_last_born(&self, vertex: u32, step: usize) {
        match step {
            0 => prefetch(&self.vertices, vertex as usize),
            _ => {
                let last = self.vertices[vertex as usize].links.last as usize;
                prefetch(&self.vertices, last);
                prefetch(&self.not_before, last);
            }
        }
    }

    /// A step towards the collapse into a vertex: that of the split that bore a vertex last.
    #[inline]
    pub fn prefetch_for_collapse(&self, born: u32, step: usize) {
        match step {
            0 => {
                prefetch(&self.vertices, born as usize);
                self.prefetch_criteria(born);
            }
            1 => {
                let Vertex { links, birth: Birth { kept, previous, .. }, .. } = self.vertices[born as usize];
                if kept != NONE {
                    prefetch(&self.vertices, kept as usize);
                    self.prefetch_criteria(kept);
                }
                // What can be undone next.
                prefetch(&self.vertices, previous as usize);
                self.stars.prefetch(links.star);
            }
            2 => {
                let kept = self.vertices[born as usize].birth.kept;
                if kept != NONE {
                    self.stars.prefetch(self.vertices[kept as usize].links.star);
                }
                self.prefetch_triangles(born);
            }
            3 => self.prefetch_ring(born),
            _ => self.prefetch_stars(born),
        }
    }

    /// A vertex's position and what decides there.
    #[inline]
    fn prefetch_criteria(&self, vertex: u32) {
        prefetch(&self.positions, vertex as usize);
        if let Some(group) = self.groups.get(vertex as usize / GROUP) {
            for criteria in [&group.split, &group.collapse] {
                prefetch(&criteria.switch, vertex as usize % GROUP);
                prefetch(&criteria.cone, vertex as usize % GROUP);
            }
        }
    }

    fn prefetch_triangles(&self, vertex: u32) {
        let corners = self.stars.first_corners(self.vertices[vertex as usize].links.star);
        for corner in corners {
            self.triangles.prefetch(corner >> 2);
        }
        if let Some(seams) = self.wedges.as_ref().and_then(Wedges::seams) {
            corners.iter().for_each(|corner| seams.prefetch(corner >> 2));
        }
    }

    /// The vertices around one: each comes after it in one triangle of a closed ring.
    fn ring(&self, vertex: u32) -> impl Iterator<Item = u32> + '_ {
        self.stars.first_corners(self.vertices[vertex as usize].links.star).iter().map(|corner| {
            // What was fetched a while ago may have changed since, but there is always something.
            let corners = self.triangles.list().get((corner >> 2) as usize).copied().unwrap_or_default();
            corners[NEXT[(corner & 3) as usize]]
        })
    }

    fn prefetch_ring(&self, vertex: u32) {
        for next in self.ring(vertex) {
            prefetch(&self.vertices, next as usize);
        }
    }

    fn prefetch_stars(&self, vertex: u32) {
        for next in self.ring(vertex) {
            self.stars.prefetch(self.vertices[next as usize].links.star);
        }
    }
}
