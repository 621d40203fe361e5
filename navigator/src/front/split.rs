//! Applying a split.

use metanode::page::{ChildEntry, NormalCone, Page};

use super::wedges::Wedges;
use super::{Birth, Entry, Front, GROUP, Links, NONE, Prepared, Span, Vertex, record_of};

impl Front {
    /// Applies the split that was prepared last, with nothing changed in between and with [`Front::has_room`]. `slot` is the
    /// place holder that `page` is in. Returns the vertex that is born.
    pub fn split(&mut self, prepared: &Prepared, page: &Page, slot: u32) -> u32 {
        let Prepared { vertex, record, kept_page, born_page, .. } = *prepared;
        let (kept, middle) = (vertex as usize, record.born_leaf);
        let Vertex { span: Span { start, end, id, moved_by }, links: Links { last, star, .. }, record: index, .. } =
            self.vertices[kept];
        let born = self.new_vertex(vertex, record.position, record.normal.to_word());
        if let Some(morphs) = &mut self.morphs {
            let [x, y, z, _] = self.positions[kept];
            morphs.begin(born as u32, morphs.drawn(vertex, [x, y, z]));
        }

        let (mut kept_star, mut born_star) = (NONE, NONE);
        let triangles = &mut self.triangles;
        // Where it goes to what is near.
        let mut near = 0;
        self.stars.take(star, |stars, entry| {
            near = entry.triangle();
            if entry.leaf >= middle {
                triangles.move_corner(entry.triangle(), entry.place(), born as u32);
                stars.push(&mut born_star, entry);
            } else {
                stars.push(&mut kept_star, entry);
            }
        });
        // Where no triangle was left around the vertex that went, those around the one that stayed took over what it
        // answered for, so that they count as moved.
        let kept_moved_by = if born_star == NONE { id } else { moved_by };
        if let Some(wedges) = &mut self.wedges {
            wedges.bear(born as u32, vertex, page.wedges(index), record.normal.to_word());
            wedges.move_corners(self.stars.corners(born_star), born as u32);
        }
        let mut seams = self.wedges.as_mut().and_then(Wedges::seams_mut);

        for (number, (leaves, third)) in page.triangles(index).zip(&self.thirds).enumerate() {
            let inside = middle <= leaves[1] && leaves[1] < end;
            let (corners, born_place, third_place) = if inside {
                ([vertex, born as u32, third.vertex], 1, 2)
            } else {
                ([vertex, third.vertex, born as u32], 2, 1)
            };
            let triangle = self.triangles.add(corners, near);
            if let Some(seams) = &mut seams {
                seams.resize_triangles(self.triangles.list().len());
                seams.add_triangle(triangle, corners, page.corner_wedges(index).nth(number));
            }
            let entry = |place: usize| Entry { corner: triangle << 2 | place as u32, leaf: leaves[place] };
            self.stars.push(&mut kept_star, entry(0));
            self.stars.push(&mut born_star, entry(born_place));
            self.stars.push(&mut self.vertices[third.vertex as usize].links.star, entry(third_place));
        }
        self.count_in_tree(start, self.thirds.len() as u32, 0);

        let (of_node, place) = (&self.groups[kept / GROUP].split, kept % GROUP);
        let (radius, switch) = (of_node.radius[place], of_node.switch[place]);
        let cone = NormalCone::from_word(of_node.cone[place]);
        let (kept_entry, born_entry) = (record.kept.as_ref(), record.born.as_ref());
        let id_of = |entry: Option<&ChildEntry>| entry.map_or(0, |entry| entry.id);
        self.vertices[born] = Vertex {
            span: Span { start: middle, end, id: id_of(born_entry), moved_by: id },
            links: Links { last: NONE, star: born_star, page: born_page },
            birth: Birth { kept: vertex, previous: last, slot, id, moved_by, radius, switch, cone },
            record: record_of(born_entry),
            birth_record: index,
        };
        self.not_before[born] = 0;
        let vertex_kept = &mut self.vertices[kept];
        vertex_kept.span = Span { start, end: middle, id: id_of(kept_entry), moved_by: kept_moved_by };
        vertex_kept.links = Links { last: born as u32, star: kept_star, page: kept_page };
        vertex_kept.record = record_of(kept_entry);
        self.set_child(kept, kept_entry);
        self.set_child(born, born_entry);
        self.set_collapse(vertex, born as u32);
        self.set_collapse(born as u32, NONE);
        let above = self.vertices[kept].birth.kept;
        if last == NONE && above != NONE && self.vertices[above as usize].links.last == vertex {
            self.set_collapse(above, NONE);
        }
        born as u32
    }
}
