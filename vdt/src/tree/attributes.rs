//! What the corners of triangles carry besides a position: normals, colours, texture coordinates, materials.
//!
//! A *wedge* is what some of the corners at one vertex have in common: all their attributes (Hoppe, "Efficient implementation
//! of progressive meshes", 1998). Most vertices have one wedge; along a *seam*, where two pieces of a texture, two
//! materials or two colours meet, they have several. Positions are welded all the same, so a seam is no crack.
//!
//! Attributes of faces (colours, materials) are those of all their corners, so they need no place of their own.

use std::fmt;

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};
use storage::Spool;

use super::Normal;
pub use crate::mesh::ImageSource;

/// No vertex has more wedges: the place of a wedge at its vertex has ten bits.
pub const MOST_WEDGES: usize = 1023;

/// The attributes of corners at one vertex. 20 bytes. Of two wedges at a vertex the smaller one, in the order of these fields,
/// comes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Wedge {
    /// Which material the surface is of: its number in [`Appearance::materials`], counted from 1; 0: none.
    pub material: u32,
    /// Texture coordinate, in steps of [`Appearance::texture_step`], as far from 0 as [`Appearance::LARGEST_TEXTURE`] at
    /// most, with v upwards as in OBJ, whatever the file's format has; zeros where there are none.
    pub texture: [i32; 2],
    /// Red, green, blue and alpha, in sRGB; 255 each where there are no colours.
    pub colour: [u8; 4],
    /// The normal that the file gives; [`Normal::UP`] where it gives none.
    pub normal: Normal,
}

impl Wedge {
    /// The wedge of a corner without any attribute.
    pub const PLAIN: Wedge = Wedge { material: 0, texture: [0; 2], colour: [u8::MAX; 4], normal: Normal::UP };

    /// What wedges are ordered by.
    pub fn order(&self) -> impl Ord + use<> {
        (self.material, self.texture, self.colour, self.normal.to_word())
    }

    /// Whether a surface may go on from one to the other without a cut in its texture: same material, same place in it.
    /// (Colours and normals may jump.)
    pub fn is_same_surface(&self, other: &Wedge) -> bool {
        self.material == other.material && self.texture == other.texture
    }
}

/// The places of the wedges of a triangle's three corners among the wedges of their vertices: ten bits each, the first
/// corner's lowest.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(transparent)]
pub struct CornerPlaces(u32);

impl CornerPlaces {
    /// Of three places, each below [`MOST_WEDGES`].
    pub fn of(places: [u32; 3]) -> Self {
        debug_assert!(places.iter().all(|place| (*place as usize) < MOST_WEDGES));
        CornerPlaces(places[0] | places[1] << 10 | places[2] << 20)
    }

    /// The three places.
    pub fn places(self) -> [u32; 3] {
        [self.0, self.0 >> 10, self.0 >> 20].map(|place| place & 1023)
    }

    /// The three places, as of the triangle turned so that its corner `first` comes first.
    pub fn turned(self, first: usize) -> Self {
        let mut places = self.places();
        places.rotate_left(first);
        CornerPlaces::of(places)
    }
}

/// Which attributes a mesh has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AttributeKinds {
    /// Normals that the file gave.
    pub normals: bool,
    /// Colours.
    pub colours: bool,
    /// Texture coordinates.
    pub textures: bool,
    /// Materials.
    pub materials: bool,
}

impl AttributeKinds {
    /// Whether there are none at all.
    pub fn is_empty(self) -> bool {
        self == AttributeKinds::default()
    }
}

impl fmt::Display for AttributeKinds {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let AttributeKinds { normals, colours, textures, materials } = *self;
        let all =
            [(normals, "normals"), (colours, "colours"), (textures, "texture coordinates"), (materials, "materials")];
        let names: Vec<_> = all.into_iter().filter(|(is_there, _)| *is_there).map(|(_, name)| name).collect();
        out.pad(&if names.is_empty() { "none".into() } else { names.join(", ") })
    }
}

/// What a surface may be made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Its name in the file; empty where it has none.
    pub name: String,
    /// Red, green, blue and alpha, mostly from 0 to 1, in sRGB whatever the file has. None where the file does not say.
    pub base_colour: Option<[f32; 4]>,
    /// Number of the image that the texture coordinates lie in, counted from 0 in [`Appearance::images`].
    pub image: Option<u32>,
}

/// An image of a texture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Image {
    /// The file's name, without folders, or what the mesh file calls it.
    pub name: String,
    /// Where its bytes are. A missing one has none.
    pub source: ImageSource,
}

/// What all wedges of a mesh refer to.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Appearance {
    /// Which attributes there are.
    pub kinds: AttributeKinds,
    /// Texture coordinates are whole numbers of steps of 2 to this power.
    pub texture_exponent: i32,
    /// The materials.
    pub materials: Vec<Material>,
    /// The images, each once.
    pub images: Vec<Image>,
}

impl Appearance {
    /// No texture coordinate has more steps: single precision holds them all exactly.
    pub const LARGEST_TEXTURE: i32 = 1 << 23;
    /// Steps are no smaller than 2 to this power: an eighth of a pixel in an image of 8,192 pixels.
    pub const FINEST_TEXTURE: i32 = -16;

    /// The exponent for texture coordinates none of which is farther from 0 than `largest`.
    pub fn texture_exponent_for(largest: f32) -> i32 {
        let fits = |exponent: &i32| {
            f64::from(largest) / crate::ingest::power_of_two(*exponent) <= f64::from(Self::LARGEST_TEXTURE - 1)
        };
        (Self::FINEST_TEXTURE..).find(fits).unwrap_or(i32::MAX)
    }

    /// The step of texture coordinates.
    pub fn texture_step(&self) -> f32 {
        crate::ingest::power_of_two(self.texture_exponent) as f32
    }

    /// The nearest lattice point to a texture coordinate.
    pub fn texture_number(&self, value: [f32; 2]) -> [i32; 2] {
        let step = crate::ingest::power_of_two(self.texture_exponent);
        value.map(|value| (f64::from(value) / step).round() as i32)
    }

    /// The texture coordinate of a lattice point.
    pub fn texture_value(&self, number: [i32; 2]) -> [f32; 2] {
        number.map(|number| number as f32 * self.texture_step())
    }
}

/// The wedges of a mesh of any size, by canonical vertex.
#[derive(Debug)]
pub struct MeshAttributes {
    /// What they refer to.
    pub appearance: Appearance,
    /// All wedges: those of a vertex follow each other in their order, each once, those of the first vertex first.
    pub wedges: Spool<Wedge>,
    /// None where each vertex has exactly one wedge.
    pub seams: Option<MeshSeams>,
}

/// Which wedges belong to which vertices and corners, where there are vertices with several.
#[derive(Debug)]
pub struct MeshSeams {
    /// For each vertex, the number of its first wedge. It has those up to the next one's first, at least one.
    pub first_wedges: Spool<u32>,
    /// For each triangle, in canonical order, the wedges of its corners.
    pub corners: Spool<CornerPlaces>,
}

/// The wedges of a tree, by leaf.
///
/// A collapse gives each wedge of the vertex that goes an *image* among those of the vertex that stays; so wedges are forests, as
/// vertices are. They are numbered in depth-first order: the wedges that turn into one of a node's are an interval that
/// begins with it.
#[derive(Debug)]
pub struct TreeAttributes {
    /// What they refer to.
    pub appearance: Appearance,
    /// All wedges: those of a leaf follow each other, as in the mesh.
    pub wedges: Spool<Wedge>,
    /// None where each leaf has exactly one wedge: its number is that of the leaf.
    pub seams: Option<TreeSeams>,
}

/// Which wedges belong to which leaves and corners.
#[derive(Debug)]
pub struct TreeSeams {
    /// For each leaf, the place of its first wedge in [`TreeAttributes::wedges`].
    pub first_wedges: Spool<u32>,
    /// For each wedge in [`TreeAttributes::wedges`], where it is in the forest.
    pub nodes: Spool<WedgeNode>,
    /// The wedges of the corners of each born triangle, by place at their leaves.
    pub corners: Spool<CornerPlaces>,
}

/// A wedge in the forest of wedges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct WedgeNode {
    /// Its number.
    pub number: u32,
    /// One past the last number of the wedges that turn into it.
    pub end: u32,
    /// The place of its image among the wedges of the leaf onto which its own is collapsed; 0 where that leaf has only one, and for
    /// those of roots.
    pub image: u32,
}
