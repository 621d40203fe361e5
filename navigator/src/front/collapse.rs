//! Undoing a split.

use super::{Birth, Entry, Front, Links, NONE, Span, Vertex};

impl Front {
    /// Collapses the two children of the node whose split bore `born`, which can be undone. `page` is the number of the page that
    /// its record is in.
    pub fn collapse(&mut self, born: u32, page: u32) {
        let Vertex {
            span: Span { end, .. }, links: Links { star: born_star, .. }, birth, birth_record: record, ..
        } = self.vertices[born as usize];
        let Birth { kept: vertex, previous, slot, id, moved_by, radius, switch, cone } = birth;
        let kept = vertex as usize;

        if let Some(wedges) = &mut self.wedges {
            let triangles = &self.triangles;
            let is_dead = |entry: &Entry| triangles.corners(entry.triangle()).contains(&vertex);
            wedges.remove_triangles(self.stars.corners(born_star).filter(is_dead));
            wedges.move_corners(self.stars.corners(born_star).filter(|entry| !is_dead(entry)), vertex);
            wedges.release(born);
        }
        let mut star = self.vertices[kept].links.star;
        let mut dead = 0;
        let (triangles, vertices) = (&mut self.triangles, &mut self.vertices);
        self.stars.take(born_star, |stars, entry| {
            let triangle = entry.triangle();
            let corners = triangles.corners(triangle);
            if corners.contains(&vertex) {
                for corner in corners.into_iter().filter(|corner| *corner != vertex && *corner != born) {
                    stars.remove(&mut vertices[corner as usize].links.star, triangle);
                }
                stars.remove(&mut star, triangle);
                triangles.remove(triangle);
                dead += 1;
            } else {
                triangles.move_corner(triangle, entry.place(), vertex);
                stars.push(&mut star, entry);
            }
        });
        let start = self.vertices[kept].span.start;
        self.count_in_tree(start, 0, dead);

        let vertex_kept = &mut self.vertices[kept];
        vertex_kept.span = Span { start, end, id, moved_by };
        vertex_kept.links = Links { last: previous, star, page };
        vertex_kept.record = record;
        self.set_split(kept, radius, switch, cone);
        // Pages in use are each in a place holder of their own.
        self.set_leads_out(kept, self.slot_above(vertex) != slot);
        self.set_collapse(vertex, previous);
        let above = self.vertices[kept].birth.kept;
        if previous == NONE && above != NONE && self.vertices[above as usize].links.last == vertex {
            self.set_collapse(above, vertex);
        }
        self.vacate(born);
    }
}
