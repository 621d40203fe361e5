//! What the triangles of a surface look like: the colours and texture coordinates of their corners, and their material.
//!
//! Memory: while they are gathered, under half of that with which the surface is read; afterwards a sixteenth of it at most.
//! I/O: for what does not fit, 40 bytes a triangle, written once and read where samples lie.

use bytemuck::{Pod, Zeroable};
use storage::{ByteSize, Scratch, Spool, StorageError};

use super::records::{Records, RecordsWriter, Window};
use crate::tree::{Appearance, MeshAttributes, Wedge};

/// The look of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Look {
    /// Number of its material, counted from 1; 0: none. It is that of the first corner: all have the same.
    pub material: u32,
    /// Texture coordinates of the corners, v up.
    pub textures: [[f32; 2]; 3],
    /// Red, green, blue and alpha of the corners.
    pub colours: [[u8; 4]; 3],
}

/// The looks of all triangles of a surface, in its order.
#[derive(Debug)]
pub(super) struct Looks {
    pub records: Records<Look>,
    pub appearance: Appearance,
}

impl Looks {
    /// Those of a mesh with these triangles; none where its attributes say nothing of colours.
    pub fn of(
        attributes: MeshAttributes,
        triangles: &Spool<[u32; 3]>,
        scratch: &Scratch,
        memory: ByteSize,
    ) -> Result<Option<Self>, StorageError> {
        let MeshAttributes { appearance, wedges, seams } = attributes;
        if !may_have_colours(&appearance) {
            return Ok(None);
        }
        let share = usize::try_from(memory.0 / 16).unwrap_or(usize::MAX);
        let wedges = Records::of(wedges)?;
        let mut wedge_window = Window::new(&wedges, 1, share);
        let (firsts, corners) = match seams {
            Some(seams) => (Some(Records::of(seams.first_wedges)?), Some(seams.corners)),
            None => (None, None),
        };
        let mut first_window = firsts.as_ref().map(|firsts| Window::new(firsts, 1, share));
        let mut places = corners.as_ref().map(|corners| corners.reader(share / 4));
        let mut reader = triangles.reader(share / 4);
        let mut looks = RecordsWriter::new(scratch, "looks", triangles.len(), share);
        while let Some(vertices) = reader.next()? {
            let places = match &mut places {
                Some(places) => places.next()?.unwrap_or_default().places(),
                None => [0; 3],
            };
            let mut corners = [Wedge::PLAIN; 3];
            for (corner, (vertex, place)) in corners.iter_mut().zip(vertices.into_iter().zip(places)) {
                let first = match &mut first_window {
                    Some(window) => window.run(vertex.into(), 1)?.first().copied().unwrap_or_default(),
                    None => vertex,
                };
                // Each wedge that a corner names is there: ingest made them so.
                let number = u64::from(first) + u64::from(place);
                *corner = wedge_window.run(number, 1)?.first().copied().unwrap_or(Wedge::PLAIN);
            }
            looks.push(Look {
                material: corners[0].material,
                textures: corners.map(|wedge| appearance.texture_value(wedge.texture)),
                colours: corners.map(|wedge| wedge.colour),
            })?;
        }
        Ok(Some(Looks { records: looks.finish()?, appearance }))
    }
}

/// Whether there is anything that gives a surface a colour. An image may turn out to be unreadable.
fn may_have_colours(appearance: &Appearance) -> bool {
    let kinds = appearance.kinds;
    let has_image = kinds.textures && appearance.materials.iter().any(|material| material.image.is_some());
    kinds.colours || has_image || appearance.materials.iter().any(|material| material.base_colour.is_some())
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Arc;

    use proptest::prelude::*;
    use storage::MemoryDisk;

    use super::*;
    use crate::tree::{AttributeKinds, CornerPlaces, MeshSeams, Normal};

    /// The corners of a triangle, and the places of their wedges.
    type Placed = ([u32; 3], [u32; 3]);

    /// Wedges of each vertex, and triangles.
    fn wedged() -> impl Strategy<Value = (Vec<Vec<Wedge>>, Vec<Placed>)> {
        let wedge = (any::<[u8; 4]>(), [-500..500_i32, -500..500], 0..3_u32)
            .prop_map(|(colour, texture, material)| Wedge { material, texture, colour, normal: Normal::UP });
        let vertices = prop::collection::vec(prop::collection::vec(wedge, 1..4), 3..10);
        (vertices, prop::collection::vec(any::<[(prop::sample::Index, prop::sample::Index); 3]>(), 1..40)).prop_map(
            |(vertices, triangles)| {
                let corner = |(vertex, place): (prop::sample::Index, prop::sample::Index)| {
                    let vertex = vertex.index(vertices.len());
                    (vertex as u32, place.index(vertices[vertex].len()) as u32)
                };
                let triangles = triangles.into_iter().map(|corners| {
                    let corners = corners.map(corner);
                    (corners.map(|(vertex, _)| vertex), corners.map(|(_, place)| place))
                });
                let triangles = triangles.collect();
                (vertices, triangles)
            },
        )
    }

    proptest! {
        #[test]
        fn looks_are_those_of_the_wedges_that_the_corners_name((vertices, triangles) in wedged(), is_small: bool) {
            let (scratch, _) = Scratch::open(Arc::new(MemoryDisk::new()), Path::new("scratch"), "").unwrap();
            let appearance = Appearance {
                kinds: AttributeKinds { colours: true, textures: true, materials: true, normals: false },
                texture_exponent: -3,
                ..Appearance::default()
            };
            let firsts = vertices.iter().scan(0, |next, wedges| {
                let first = *next;
                *next += wedges.len() as u32;
                Some(first)
            });
            let has_seams = vertices.iter().any(|wedges| wedges.len() > 1);
            let places = triangles.iter().map(|(_, places)| CornerPlaces::of(*places));
            let attributes = MeshAttributes {
                appearance,
                seams: has_seams.then(|| MeshSeams {
                    first_wedges: Spool::from_vec(firsts.collect()),
                    corners: Spool::from_vec(places.collect()),
                }),
                wedges: Spool::from_vec(vertices.concat()),
            };
            let corners = Spool::from_vec(triangles.iter().map(|(corners, _)| *corners).collect());
            let memory = ByteSize(if is_small { 0 } else { 1 << 20 });
            let looks = Looks::of(attributes, &corners, &scratch, memory).unwrap().unwrap();
            let mut found = vec![Look::zeroed(); triangles.len() + 1];
            prop_assert_eq!(looks.records.read(0, &mut found).unwrap(), triangles.len());
            for (look, (corners, places)) in found.iter().zip(&triangles) {
                let wedges = [0, 1, 2].map(|at| vertices[corners[at] as usize][places[at] as usize]);
                prop_assert_eq!(look.colours, wedges.map(|wedge| wedge.colour));
                prop_assert_eq!(look.textures, wedges.map(|wedge| wedge.texture.map(|step| step as f32 / 8.0)));
                prop_assert_eq!(look.material, wedges[0].material);
            }
        }
    }
}
