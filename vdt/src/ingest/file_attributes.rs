//! The attributes of the files, as they were read: of vertices, of triangles and their corners, and the lists that corners
//! name by number.
//!
//! Most files have only some of these, and what a file does not have costs nothing. Where all faces have the same material
//! and colour, and corners have nothing of their own, that is one record; so a mesh of one material is one whose vertices have
//! all that there is.
//!
//! I/O: 16 bytes for each vertex, 48 for each triangle, 8 for each texture coordinate and 4 for each normal of the lists,
//! written once.

use std::path::{Path, PathBuf};

use bytemuck::{Pod, Zeroable};
use storage::{Scratch, SpoolWriter, StorageError};

use super::appearance::AppearanceReader;
use super::files::MOST_ELEMENTS;
use super::limits::Kept;
use crate::mesh::{self, CornerValue, MeshError, TriangleAttributes, VertexAttributes};
use crate::tree::{Appearance, Normal, Wedge};

/// What a vertex has; or a corner, together with its vertex.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct VertexLook {
    /// Not yet rounded; NaN where there is none.
    pub texture: [f32; 2],
    pub colour: [u8; 4],
    pub normal: Normal,
}

impl VertexLook {
    /// Of a vertex that has nothing.
    pub const NONE: VertexLook = VertexLook { texture: [f32::NAN; 2], colour: [u8::MAX; 4], normal: Normal::UP };

    fn of(VertexAttributes { normal, colour, texture }: VertexAttributes) -> Self {
        VertexLook {
            texture: texture.unwrap_or(Self::NONE.texture),
            colour: colour.unwrap_or(Self::NONE.colour),
            normal: normal.map_or(Self::NONE.normal, encoded),
        }
    }

    /// The wedge of a corner that has this, of a material.
    #[inline]
    pub fn wedge(&self, material: u32, appearance: &Appearance) -> Wedge {
        let has_texture = !self.texture[0].is_nan();
        let texture = if has_texture { appearance.texture_number(self.texture) } else { [0; 2] };
        Wedge { material, texture, colour: self.colour, normal: self.normal }
    }
}

#[inline]
fn encoded(normal: [f32; 3]) -> Normal {
    Normal::encode(normal.map(f64::from))
}

/// What a corner has of its own, in two bits.
const NUMBER: u32 = 1;
const VALUE: u32 = 2;
/// The bits of all corners.
const OF_CORNERS: u32 = (1 << 12) - 1;
/// The face has a colour.
const COLOUR: u32 = 1 << 12;

/// What a triangle and its corners have. Numbers are those in the lists of all files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct TriangleLook {
    /// Bits of texture coordinates, or numbers and zeros.
    textures: [[u32; 2]; 3],
    /// Normals, encoded, or numbers.
    normals: [u32; 3],
    colour: [u8; 4],
    /// Counted from 1; 0 for none.
    pub material: u32,
    /// What is what: two bits for the texture coordinate of each corner, then two for each normal, then one for the colour.
    kinds: u32,
}

impl TriangleLook {
    /// Of a triangle that has nothing.
    pub const NONE: TriangleLook =
        TriangleLook { textures: [[0; 2]; 3], normals: [0; 3], colour: [0; 4], material: 0, kinds: 0 };

    /// Where the lists and the materials of the file begin at these numbers.
    fn of(attributes: &TriangleAttributes, first: &Firsts) -> Self {
        let mut look = TriangleLook::NONE;
        // A number beyond 32 bits is not there, or is refused when it comes: until then any number beyond will do.
        let moved = |number: u64, first: u64| u32::try_from(number.saturating_add(first)).unwrap_or(u32::MAX);
        for corner in 0..3 {
            match attributes.textures[corner] {
                CornerValue::None => {}
                CornerValue::Number(number) => {
                    look.textures[corner] = [moved(number, first.texture), 0];
                    look.kinds |= NUMBER << (2 * corner);
                }
                CornerValue::Value(value) => {
                    look.textures[corner] = value.map(f32::to_bits);
                    look.kinds |= VALUE << (2 * corner);
                }
            }
            match attributes.normals[corner] {
                CornerValue::None => {}
                CornerValue::Number(number) => {
                    look.normals[corner] = moved(number, first.normal);
                    look.kinds |= NUMBER << (6 + 2 * corner);
                }
                CornerValue::Value(value) => {
                    look.normals[corner] = encoded(value).to_word();
                    look.kinds |= VALUE << (6 + 2 * corner);
                }
            }
        }
        if let Some(colour) = attributes.colour {
            look.colour = colour;
            look.kinds |= COLOUR;
        }
        look.material = attributes.material.map_or(0, |material| first.material + material + 1);
        look
    }

    /// Whether no corner has anything of its own.
    fn is_of_face(&self) -> bool {
        self.kinds & OF_CORNERS == 0
    }

    /// What a corner has, where its vertex has `vertex`, and the lists have what `texture` and `normal` tell.
    #[inline]
    pub fn at_corner(
        &self,
        corner: usize,
        vertex: VertexLook,
        texture: impl FnOnce(u32) -> Result<[f32; 2], StorageError>,
        normal: impl FnOnce(u32) -> Result<Normal, StorageError>,
    ) -> Result<VertexLook, StorageError> {
        let texture = match self.kinds >> (2 * corner) & 3 {
            NUMBER => texture(self.textures[corner][0])?,
            VALUE => self.textures[corner].map(f32::from_bits),
            _ => vertex.texture,
        };
        let normal = match self.kinds >> (6 + 2 * corner) & 3 {
            NUMBER => normal(self.normals[corner])?,
            VALUE => Normal::from_word(self.normals[corner]),
            _ => vertex.normal,
        };
        Ok(VertexLook { texture, normal, ..self.at_vertex(vertex) })
    }

    /// What any corner at a vertex has, where corners have nothing of their own.
    #[inline]
    pub fn at_vertex(&self, vertex: VertexLook) -> VertexLook {
        let colour = if self.kinds & COLOUR == 0 { vertex.colour } else { self.colour };
        VertexLook { colour, ..vertex }
    }
}

/// What triangles have: the same, or each its own.
#[derive(Debug)]
pub(super) enum TriangleLooks {
    /// All have this, and corners nothing of their own.
    Same(TriangleLook),
    /// One for each triangle.
    Each(Kept<TriangleLook>),
}

/// Takes what triangles have; nothing is written as long as it is the same.
#[derive(Debug)]
struct TriangleLookWriter {
    scratch: Scratch,
    share: usize,
    same: TriangleLook,
    length: u64,
    writer: Option<SpoolWriter<TriangleLook>>,
}

impl TriangleLookWriter {
    fn new(scratch: &Scratch, share: usize) -> Self {
        TriangleLookWriter { scratch: scratch.clone(), share, same: TriangleLook::NONE, length: 0, writer: None }
    }

    fn push(&mut self, look: TriangleLook) -> Result<(), StorageError> {
        if self.length == 0 && look.is_of_face() {
            self.same = look;
        }
        if self.writer.is_none() && (look != self.same || !look.is_of_face()) {
            let mut writer = SpoolWriter::new(&self.scratch, "attributes-of-triangles", self.share);
            (0..self.length).try_for_each(|_| writer.push(self.same))?;
            self.writer = Some(writer);
        }
        self.length += 1;
        self.writer.as_mut().map_or(Ok(()), |writer| writer.push(look))
    }

    /// Up to this length, triangles have nothing.
    fn fill_to(&mut self, length: u64) -> Result<(), StorageError> {
        (self.length..length).try_for_each(|_| self.push(TriangleLook::NONE))
    }

    fn finish(self) -> Result<TriangleLooks, StorageError> {
        match self.writer {
            None => Ok(TriangleLooks::Same(self.same)),
            Some(writer) => Kept::finish(writer, self.share).map(TriangleLooks::Each),
        }
    }
}

/// Where what a file names by number begins.
#[derive(Debug, Default)]
struct Firsts {
    texture: u64,
    normal: u64,
    material: u32,
}

/// Takes the attributes of all files.
#[derive(Debug)]
pub(super) struct AttributeWriter {
    appearance: AppearanceReader,
    vertices: SpoolWriter<VertexLook>,
    triangles: TriangleLookWriter,
    textures: SpoolWriter<[f32; 2]>,
    normals: SpoolWriter<Normal>,
    first: Firsts,
    memory: usize,
}

impl AttributeWriter {
    /// `memory` are the bytes of RAM of the whole ingest: 15 of 64 parts are taken.
    pub fn new(scratch: &Scratch, memory: usize) -> Self {
        AttributeWriter {
            appearance: AppearanceReader::default(),
            vertices: SpoolWriter::new(scratch, "attributes-of-vertices", memory / 16),
            triangles: TriangleLookWriter::new(scratch, memory / 8),
            textures: SpoolWriter::new(scratch, "texture-coordinates", memory / 32),
            normals: SpoolWriter::new(scratch, "normals", memory / 64),
            first: Firsts::default(),
            memory,
        }
    }

    pub fn begin_file(&mut self) {
        let (texture, normal) = (self.textures.len(), self.normals.len());
        self.first = Firsts { texture, normal, material: self.appearance.materials() };
    }

    /// The attributes of vertex `number`; those before it that did not come have none.
    pub fn vertex(&mut self, number: u64, attributes: VertexAttributes) -> Result<(), StorageError> {
        attributes.texture.into_iter().for_each(|texture| self.appearance.include_texture(texture));
        while self.vertices.len() < number {
            self.vertices.push(VertexLook::NONE)?;
        }
        self.vertices.push(VertexLook::of(attributes))
    }

    /// The attributes of triangle `number`; those before it that did not come have none.
    pub fn triangle(&mut self, number: u64, attributes: &TriangleAttributes) -> Result<(), StorageError> {
        for texture in &attributes.textures {
            if let CornerValue::Value(texture) = texture {
                self.appearance.include_texture(*texture);
            }
        }
        self.triangles.fill_to(number)?;
        self.triangles.push(TriangleLook::of(attributes, &self.first))
    }

    /// The next texture coordinate of the list of a file.
    pub fn texture(&mut self, value: [f32; 2], path: &Path) -> Result<(), MeshError> {
        check_count(self.textures.len(), "texture coordinates", path)?;
        self.appearance.include_texture(value);
        Ok(self.textures.push(value)?)
    }

    /// The next normal of the list of a file.
    pub fn normal(&mut self, value: [f32; 3], path: &Path) -> Result<(), MeshError> {
        check_count(self.normals.len(), "normals", path)?;
        Ok(self.normals.push(encoded(value))?)
    }

    pub fn end_file(&mut self, attributes: mesh::Attributes) {
        self.appearance.end_file(attributes);
    }

    /// All files were read, which have so many triangles. The attributes, if there are any, and the missing files.
    pub fn finish(mut self, triangles: u64) -> Result<(Option<FileAttributes>, Vec<PathBuf>), StorageError> {
        let (appearance, missing_files) = self.appearance.finish();
        let Some(appearance) = appearance else { return Ok((None, missing_files)) };
        self.triangles.fill_to(triangles)?;
        let attributes = FileAttributes {
            appearance,
            vertices: Kept::finish(self.vertices, self.memory / 16)?,
            triangles: self.triangles.finish()?,
            textures: Kept::finish(self.textures, self.memory / 32)?,
            normals: Kept::finish(self.normals, self.memory / 64)?,
        };
        Ok((Some(attributes), missing_files))
    }
}

fn check_count(before: u64, kind: &'static str, path: &Path) -> Result<(), MeshError> {
    if before < MOST_ELEMENTS {
        return Ok(());
    }
    Err(MeshError::TooMany { path: path.to_path_buf(), kind, most: MOST_ELEMENTS })
}

/// All attributes of the files.
#[derive(Debug)]
pub(super) struct FileAttributes {
    pub appearance: Appearance,
    /// Of the vertices up to the last that has any.
    pub vertices: Kept<VertexLook>,
    pub triangles: TriangleLooks,
    pub textures: Kept<[f32; 2]>,
    pub normals: Kept<Normal>,
}
