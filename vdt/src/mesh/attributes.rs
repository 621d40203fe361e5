//! What a mesh file says beside positions and corners: normals, colours, texture coordinates, materials with images.
//!
//! Readers look for them only where the sink asks ([`super::MeshSink::wants_attributes`]). Values are as the file has them:
//! normals are not made unit length, texture coordinates not turned; the gate turns them, vertex by vertex and corner by
//! corner, so that all it hands on has one meaning. Colours are sRGB from the start: PLY, OBJ, OFF and STL mean that, and the
//! linear ones of glTF are converted (module `srgb`) before they become bytes, since linear bytes do not tell dark colours
//! apart. Floats from 0 to 1 and numbers of 16 bits are scaled and rounded, what is beyond is the nearest that there is.
//!
//! Images are named, not read: where their bytes lie is told, and whether they are there.
//!
//! Memory: the names of materials and files, at most [`NAMES_LIMIT`] bytes, and images that are part of a JSON document.

use std::collections::BTreeSet;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// The most bytes that the names of materials, images and missing files may have together.
pub(super) const NAMES_LIMIT: usize = 4 << 20;

/// Stands in [`Wedges::Numbers`] for a corner that has no value.
pub const NO_VALUE: i64 = -1;

/// Values at the corners of a face, which other faces at the same vertices need not share.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Wedges<'a, V> {
    /// The face has none.
    #[default]
    None,
    /// Numbers in the file's list of such values, counted from 0, or [`NO_VALUE`]: one for each corner. The list may be
    /// pushed later.
    Numbers(&'a [i64]),
    /// The values themselves, one for each corner.
    Values(&'a [V]),
}

/// What a vertex has besides its position, as the gate hands it on.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct VertexAttributes {
    /// Finite, of any length.
    pub normal: Option<[f32; 3]>,
    /// Red, green, blue and alpha, in sRGB.
    pub colour: Option<[u8; 4]>,
    /// Finite, v upwards.
    pub texture: Option<[f32; 2]>,
}

/// What a corner of a triangle has of its own.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum CornerValue<V> {
    /// Nothing.
    #[default]
    None,
    /// The number of a value in the file's list, counted from 0. The value may come later.
    Number(u64),
    /// A value: finite.
    Value(V),
}

/// What a triangle and its corners have, as the gate hands it on.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TriangleAttributes {
    /// Texture coordinates of the corners, v upwards.
    pub textures: [CornerValue<[f32; 2]>; 3],
    /// Normals of the corners, of any length.
    pub normals: [CornerValue<[f32; 3]>; 3],
    /// Red, green, blue and alpha, in sRGB.
    pub colour: Option<[u8; 4]>,
    /// Number of the material in [`Attributes::materials`], counted from 0.
    pub material: Option<u32>,
}

/// What faces may be made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Its name in the file; empty where it has none.
    pub name: String,
    /// Red, green, blue and alpha of the surface, mostly from 0 to 1, in sRGB whatever the file has. None where the file
    /// does not say.
    pub base_colour: Option<[f32; 4]>,
    /// The image that the texture coordinates lie in.
    pub image: Option<Image>,
}

/// An image, where it lies.
#[derive(Debug, Clone, PartialEq)]
pub struct Image {
    /// How messages call it: the file's name, or what the mesh file calls it.
    pub name: String,
    /// Where its bytes are.
    pub source: ImageSource,
}

/// Where the bytes of an image are.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ImageSource {
    /// A file of its own, which is there.
    File(PathBuf),
    /// A part of a file.
    Part {
        /// The file.
        path: PathBuf,
        /// Its first byte.
        offset: u64,
        /// How many bytes it has.
        length: u64,
    },
    /// Bytes that the mesh file has as text.
    Bytes(Vec<u8>),
    /// Nowhere: the file that is named is not there.
    Missing,
}

/// Which attributes a file has, and how many, if the sink wanted them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Attributes {
    /// Vertices with a normal.
    pub vertex_normals: u64,
    /// Vertices with a colour.
    pub vertex_colours: u64,
    /// Vertices with a texture coordinate.
    pub vertex_textures: u64,
    /// Faces with a colour.
    pub face_colours: u64,
    /// Faces with a material.
    pub face_materials: u64,
    /// Corners of faces with a normal of their own.
    pub wedge_normals: u64,
    /// Corners of faces with a texture coordinate of their own.
    pub wedge_textures: u64,
    /// Normals in the file's list, which corners name by number.
    pub normals: u64,
    /// Texture coordinates in the file's list, which corners name by number.
    pub texture_coordinates: u64,
    /// The materials by number.
    pub materials: Vec<Material>,
    /// Files that are named and not there: libraries of materials, images.
    pub missing_files: BTreeSet<PathBuf>,
}

/// A colour channel from 0 to 1 as a byte; none if it is no finite number.
#[inline]
pub(super) fn byte_of_unit(value: f64) -> Option<u8> {
    value.is_finite().then(|| (value.clamp(0.0, 1.0) * 255.0).round() as u8)
}

/// A colour channel of 16 bits as a byte.
#[inline]
pub(super) fn byte_of_word(value: u16) -> u8 {
    ((u32::from(value) * 255 + 32_767) / 65_535) as u8
}

/// A colour as text files have it, which do not say in what: whole numbers are bytes, others go from 0 to 1. Where all are 0
/// or 1 they go from 0 to 1, too. None if a channel is no number, or a whole one that is no byte.
pub(super) fn colour_of_words(words: &[(f64, bool)]) -> Option<[u8; 4]> {
    let are_bytes = words.iter().all(|(_, is_whole)| *is_whole) && words.iter().any(|(value, _)| *value > 1.0);
    let mut colour = [u8::MAX; 4];
    for (channel, (value, _)) in colour.iter_mut().zip(words) {
        *channel =
            if are_bytes { (0.0..=255.0).contains(value).then_some(*value as u8)? } else { byte_of_unit(*value)? };
    }
    Some(colour)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_rounded_to_the_nearest_byte() {
        for byte in 0..=u8::MAX {
            assert_eq!(byte_of_unit(f64::from(byte) / 255.0), Some(byte));
            assert_eq!(byte_of_word(u16::from(byte) * 257), byte);
        }
        assert_eq!([0, 128, 129, 65_407, 65_535].map(byte_of_word), [0, 0, 1, 255, 255]);
        assert_eq!([-1.0, 0.001, 0.5, 7.0].map(byte_of_unit), [Some(0), Some(0), Some(128), Some(255)]);
        assert_eq!([f64::NAN, f64::INFINITY].map(byte_of_unit), [None, None]);
    }

    #[test]
    fn whole_numbers_are_bytes_unless_all_are_zero_or_one() {
        let whole = |values: &[f64]| colour_of_words(&values.iter().map(|value| (*value, true)).collect::<Vec<_>>());
        assert_eq!(whole(&[1.0, 0.0, 2.0]), Some([1, 0, 2, 255]));
        assert_eq!(whole(&[1.0, 0.0, 1.0, 0.0]), Some([255, 0, 255, 0]));
        assert_eq!((whole(&[256.0, 0.0, 0.0]), whole(&[-1.0, 9.0, 0.0])), (None, None));
        assert_eq!(colour_of_words(&[(0.5, false), (1.0, true), (0.0, true)]), Some([128, 255, 0, 255]));
    }
}
