//! Undoing a split.

use super::{Birth, Front, Links, NONE, Span};

impl Front {
    /// Collapses the two children of the node whose split bore `born`, which can be undone. `page` is the number of the page that
    /// its record is in.
    pub fn collapse(&mut self, born: u32, page: u32) {
        let Birth { kept: vertex, previous, slot, id, moved_by, radius, switch, cone, record, .. } =
            self.births[born as usize];
        let kept = vertex as usize;
        let Span { end, .. } = self.spans[born as usize];

        let mut star = self.links[kept].star;
        let mut dead = 0;
        let (triangles, links) = (&mut self.triangles, &mut self.links);
        let born_star = links[born as usize].star;
        self.stars.take(born_star, |stars, entry| {
            let triangle = entry.triangle();
            let corners = triangles.corners(triangle);
            if corners.contains(&vertex) {
                for corner in corners.into_iter().filter(|corner| *corner != vertex && *corner != born) {
                    stars.remove(&mut links[corner as usize].star, triangle);
                }
                stars.remove(&mut star, triangle);
                triangles.remove(triangle);
                dead += 1;
            } else {
                triangles.move_corner(triangle, entry.place(), vertex);
                stars.push(&mut star, entry);
            }
        });
        let start = self.spans[kept].start;
        self.count_in_tree(start, 0, dead);

        self.spans[kept] = Span { start, end, id, moved_by };
        self.links[kept] = Links { last: previous, star, page, record };
        self.set_split(kept, radius, switch, cone);
        self.set_child(born as usize, None);
        // Pages in use are each in a place holder of their own.
        self.set_leads_out(kept, self.slot_above(vertex) != slot);
        self.set_collapse(vertex, previous);
        let above = self.births[kept].kept;
        if previous == NONE && above != NONE && self.links[above as usize].last == vertex {
            self.set_collapse(above, vertex);
        }
        self.births[born as usize].kept = NONE;
        self.numbers.release(born);
    }
}
