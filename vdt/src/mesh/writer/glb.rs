//! Binary glTF 2.0 (GLB): one file with everything in it.
//!
//! ```text
//! bytes  what
//! 12     header: glTF, version 2, length
//! 8 + n  the JSON document, with blanks behind it
//! 8 + n  the binary chunk, where there are triangles:
//!          the images, each from a multiple of 4 on
//!          the vertices: position, normal, texture coordinate and colour, one vertex behind the other
//!          the corners of the triangles, in 32 bits each, those of one material behind each other
//! ```
//!
//! The document stands in front but tells what comes out at the end; so the place for it is as long as it can be at the most. It
//! shows one mesh with one primitive for each material that has triangles. Positions are in single precision: where coordinates
//! are promised in double precision, they are relative to the layout's origin, to which the mesh's node moves them, and
//! whether digits are lost all the same is told.
//!
//! Colours in sRGB become linear ones of 16 bits, each of which is read as the same byte again; v points down. Materials are not
//! metallic. Triangles without a material stay without: glTF's default is then what viewers show.
//!
//! Memory: the document, and one image at a time; where there are materials, [`SORTING_BYTES`] for sorting the triangles by them.
//! I/O: the file is written once. What does not fit into the memory for sorting is 20 bytes a triangle in a scratch folder beside
//! the file, written and read once.
//!
//! Format: glTF 2.0 specification, sections 3.6 (binary data), 3.7.2 (meshes), 3.8 (images), 3.9 (materials) and 4 (GLB).

use std::path::Path;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use storage::{AtomicFile, ByteSize, Disk, Scratch, SortRecord, Sorter, StorageError};

use super::super::MeshError;
use super::super::srgb;
use super::beside::extension_of;
use super::glb_document::{Document, Group, PlacedImage};
use super::{CoordinateType, Coordinates, ImageBytes, LayoutAttributes, MeshLayout, OutputVertex};
use crate::tree::AttributeKinds;

/// Lengths are written in 32 bits.
const MOST_BYTES: u64 = u32::MAX as u64;
const HEADER_BYTES: u64 = 12;
const CHUNK_HEADER_BYTES: u64 = 8;
/// Bytes of RAM for sorting triangles by material.
const SORTING_BYTES: usize = 8 << 20;
/// Bytes of a triangle's corners.
const TRIANGLE_BYTES: u64 = 12;

/// What knows the format.
#[derive(Debug)]
pub(super) struct Encoder {
    has_alpha: bool,
    /// Positions are written relative to it.
    origin: [f64; 3],
    /// The linear light of each byte in sRGB.
    linear: [u16; 256],
    /// What the document tells, as far as it is known.
    document: Document,
    /// Bytes of the place for the document.
    document_space: u64,
    triangles: Triangles,
    is_rounded: bool,
    has_other_images: bool,
    has_missing_images: bool,
    has_clamped_colours: bool,
    has_lost_vertices: bool,
}

/// Where the triangles go.
#[derive(Debug)]
enum Triangles {
    /// There are no materials: to the file at once.
    Plain,
    /// To be sorted by material, of each of which, with none in front, there are so many.
    ByMaterial(Box<Sorter<Triangle>>, Vec<u64>),
}

/// A triangle on its way to its material's others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct Triangle {
    material: u32,
    /// Its number: those of a material stay in their order.
    number: u32,
    corners: [u32; 3],
}

impl SortRecord for Triangle {
    fn prefix(&self) -> u64 {
        u64::from(self.material) << 32 | u64::from(self.number)
    }
}

/// Bytes of a vertex with these attributes.
fn vertex_bytes(kinds: AttributeKinds) -> u64 {
    let AttributeKinds { normals, colours, textures, .. } = kinds;
    12 + u64::from(normals) * 12 + u64::from(colours) * 8 + u64::from(textures) * 8
}

fn kinds_of(layout: &MeshLayout) -> AttributeKinds {
    layout.attributes.as_ref().map(|attributes| attributes.appearance.kinds).unwrap_or_default()
}

/// Says what the format has no room for, with these bytes besides the mesh itself.
fn check(layout: &MeshLayout, others: u64) -> Result<(), String> {
    let vertices = layout.vertices.saturating_mul(vertex_bytes(kinds_of(layout)));
    let bytes = vertices.saturating_add(layout.triangles.saturating_mul(TRIANGLE_BYTES)).saturating_add(others);
    if bytes <= MOST_BYTES {
        return Ok(());
    }
    let needed = ByteSize(bytes);
    Err(format!("the file would have {needed}, and GLB ends at 4 GiB; write PLY or OBJ, or a coarser level of detail"))
}

impl Encoder {
    /// Makes room for the document, and writes the images. Nothing is written if the file would be too long without them.
    pub fn begin(
        disk: &Arc<dyn Disk>,
        path: &Path,
        layout: &MeshLayout,
        images: &mut ImageBytes<'_>,
    ) -> Result<(Self, AtomicFile), MeshError> {
        let too_long = |problem: String| MeshError::Unwritable {
            path: path.to_path_buf(),
            element: "the header".to_string(),
            problem,
        };
        let widest = Document::widest(layout, vertex_bytes(kinds_of(layout)));
        let document_space = (widest.to_json(layout).len() as u64).next_multiple_of(4);
        let has_binary = layout.triangles > 0;
        let chunks = if has_binary { 2 } else { 1 };
        let front_bytes = HEADER_BYTES + chunks * CHUNK_HEADER_BYTES + document_space;
        check(layout, front_bytes).map_err(too_long)?;
        let mut file = AtomicFile::create(disk.clone(), path)?;
        fill(&mut file, front_bytes, b' ')?;

        let mut encoder = Encoder {
            has_alpha: layout.attributes.as_ref().is_some_and(|attributes| attributes.has_alpha),
            origin: match layout.coordinates {
                CoordinateType::Float => [0.0; 3],
                CoordinateType::Double => layout.origin,
            },
            linear: srgb::words_of_bytes(),
            document: Document::empty(vertex_bytes(kinds_of(layout))),
            document_space,
            triangles: Triangles::Plain,
            is_rounded: false,
            has_other_images: false,
            has_missing_images: false,
            has_clamped_colours: false,
            has_lost_vertices: layout.triangles == 0 && layout.vertices > 0,
        };
        // Nothing of it would be shown without triangles.
        let Some(LayoutAttributes { appearance, .. }) = layout.attributes.as_ref().filter(|_| has_binary) else {
            return Ok((encoder, file));
        };
        for (number, image) in appearance.images.iter().enumerate() {
            let Some(bytes) = images(number, image)? else {
                encoder.has_missing_images = true;
                encoder.document.images.push(None);
                continue;
            };
            let mime = match extension_of(&bytes) {
                Some(".png") => Some("image/png"),
                Some(".jpg") => Some("image/jpeg"),
                _ => None,
            };
            encoder.has_other_images |= mime.is_none();
            let Some(mime) = mime else {
                encoder.document.images.push(None);
                continue;
            };
            let (offset, length) = (file.length() - front_bytes, bytes.len() as u64);
            check(layout, file.length() + length.next_multiple_of(4)).map_err(too_long)?;
            file.append(&bytes)?;
            fill(&mut file, length.next_multiple_of(4) - length, 0)?;
            encoder.document.images.push(Some(PlacedImage { offset, length, mime }));
        }
        encoder.document.vertices_at = file.length() - front_bytes;
        encoder.has_clamped_colours =
            appearance.materials.iter().filter_map(|material| material.base_colour).flatten().any(is_beyond);
        if !appearance.materials.is_empty() {
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let folder = path.with_file_name(format!(".{name}.triangles"));
            let (scratch, _) = Scratch::open(disk.clone(), &folder, "")?;
            let sorter = Sorter::new(&scratch, "triangles-by-material", SORTING_BYTES, 1);
            let counts = vec![0; appearance.materials.len() + 1];
            encoder.triangles = Triangles::ByMaterial(Box::new(sorter), counts);
        }
        Ok((encoder, file))
    }

    /// A position as it is written.
    pub fn relative(&self, position: [f64; 3]) -> [f32; 3] {
        std::array::from_fn(|axis| (position[axis] - self.origin[axis]) as f32)
    }

    pub fn vertex(&mut self, row: &mut Vec<u8>, vertex: &OutputVertex) {
        if self.has_lost_vertices {
            return;
        }
        let position = match vertex.position {
            Coordinates::Float(position) => position,
            Coordinates::Double(position) => {
                let relative = self.relative(position);
                self.is_rounded |= (0..3).any(|axis| f64::from(relative[axis]) + self.origin[axis] != position[axis]);
                relative
            }
        };
        let [minimum, maximum] = &mut self.document.bounds;
        for (axis, value) in position.into_iter().enumerate() {
            minimum[axis] = minimum[axis].min(value.into());
            maximum[axis] = maximum[axis].max(value.into());
        }
        let mut floats = |values: &[f32]| values.iter().for_each(|value| row.extend_from_slice(&value.to_le_bytes()));
        floats(&position);
        if let Some(normal) = vertex.normal {
            floats(&normal);
        }
        if let Some([u, v]) = vertex.texture {
            floats(&[u, 1.0 - v]);
        }
        if let Some([red, green, blue, alpha]) = vertex.colour {
            let [red, green, blue] = [red, green, blue].map(|channel| self.linear[usize::from(channel)]);
            let alpha = if self.has_alpha { u16::from(alpha) * 257 } else { u16::MAX };
            [red, green, blue, alpha].iter().for_each(|channel| row.extend_from_slice(&channel.to_le_bytes()));
        }
    }

    /// Takes triangle `number`; its bytes are in `row` where they are to be written now.
    pub fn triangle(
        &mut self,
        row: &mut Vec<u8>,
        number: u64,
        corners: [u64; 3],
        material: u32,
    ) -> Result<(), StorageError> {
        // All numbers fit: so many elements as there are in 4 GiB.
        let corners = corners.map(|corner| corner as u32);
        match &mut self.triangles {
            Triangles::Plain => push_corners(row, corners),
            Triangles::ByMaterial(sorter, counts) => {
                counts[material as usize] += 1;
                sorter.push(Triangle { material, number: number as u32, corners })?;
            }
        }
        Ok(())
    }

    /// Writes what is not written yet. Says what is left out.
    pub fn finish(mut self, file: &mut AtomicFile, layout: &MeshLayout) -> Result<Vec<&'static str>, StorageError> {
        let counts = match self.triangles {
            Triangles::Plain => vec![layout.triangles],
            Triangles::ByMaterial(sorter, counts) => {
                let mut sorted = sorter.finish()?;
                let mut row = Vec::new();
                while let Some(triangle) = sorted.next()? {
                    row.clear();
                    push_corners(&mut row, triangle.corners);
                    file.append(&row)?;
                }
                counts
            }
        };
        let mut offset = 0;
        for (material, count) in (0..).zip(counts).filter(|(_, count)| *count > 0) {
            let material = u32::checked_sub(material, 1);
            self.document.groups.push(Group { material, offset, triangles: count });
            offset += count * TRIANGLE_BYTES;
        }
        let length = file.length();
        let binary_at = HEADER_BYTES + CHUNK_HEADER_BYTES + self.document_space;
        self.document.binary_bytes = length.saturating_sub(binary_at + CHUNK_HEADER_BYTES);
        // All lengths fit: that was checked.
        let mut front = b"glTF".to_vec();
        for word in [2, length as u32, self.document_space as u32] {
            front.extend_from_slice(&word.to_le_bytes());
        }
        front.extend_from_slice(b"JSON");
        front.extend_from_slice(self.document.to_json(layout).as_bytes());
        front.resize(binary_at as usize, b' ');
        if layout.triangles > 0 {
            front.extend_from_slice(&(self.document.binary_bytes as u32).to_le_bytes());
            front.extend_from_slice(b"BIN\0");
        }
        file.write_at(0, &front)?;

        let phrases = [
            (self.is_rounded, "the last digits of coordinates, which glTF has in single precision"),
            (self.has_lost_vertices, "all vertices, since there is no triangle"),
            (self.has_missing_images, "images that are missing"),
            (self.has_other_images, "images that are neither PNG nor JPEG, for which glTF has no place"),
            (self.has_clamped_colours, "what base colours have below 0 or above 1, for which glTF has no place"),
        ];
        Ok(phrases.into_iter().filter(|(is_so, _)| *is_so).map(|(_, phrase)| phrase).collect())
    }
}

/// Whether a channel is one that glTF does not have.
fn is_beyond(channel: f32) -> bool {
    !(0.0..=1.0).contains(&channel)
}

fn push_corners(row: &mut Vec<u8>, corners: [u32; 3]) {
    corners.iter().for_each(|corner| row.extend_from_slice(&corner.to_le_bytes()));
}

/// Appends a byte so many times.
fn fill(file: &mut AtomicFile, count: u64, byte: u8) -> Result<(), StorageError> {
    let piece = [byte; 4096];
    let mut left = count;
    while left > 0 {
        let now = left.min(piece.len() as u64);
        file.append(&piece[..now as usize])?;
        left -= now;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tests::layout;
    use super::*;

    #[test]
    fn four_gibibytes_are_the_end() {
        let most = (1 << 32) / 12;
        assert_eq!(check(&layout(most - 10, 10), 3), Ok(()));
        assert!(check(&layout(most - 10, 10), 4).is_err());
        let message = check(&layout(u64::MAX, 1 << 40), 0).unwrap_err();
        assert!(message.contains("write PLY or OBJ, or a coarser level of detail"), "{message}");
        let message = check(&layout(1 << 29, 0), 0).unwrap_err();
        assert!(message.contains("would have 6 GiB"), "{message}");
    }
}
