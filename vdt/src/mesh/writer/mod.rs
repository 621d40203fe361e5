//! Writes mesh files, streaming: first all vertices, then all triangles. With or without attributes.
//!
//! An output vertex has one position and one wedge: along a seam, where a vertex of the mesh has several wedges, there are as
//! many output vertices at one position. Readers weld them again.
//!
//! Headers come first in a file, so the numbers of both are promised beforehand ([`MeshLayout`]) and held to. The file appears
//! under its name whole or not at all ([`AtomicFile`]): a [`MeshWriter`] that is dropped before [`MeshWriter::finish`] leaves
//! whatever was there before. Images, and the library of materials of an OBJ file, are files beside it, which are there
//! before it is; binary glTF has all in one.
//!
//! | module | what it does |
//! |---|---|
//! | `ply` | binary little-endian PLY |
//! | `obj` | OBJ, and MTL for its materials |
//! | `glb`, `glb_document` | binary glTF, and the JSON in it |
//! | `beside` | the files beside the mesh: their names, and what may be replaced |
//!
//! Memory: one write buffer, the names, and one image at a time; for glTF with materials also a sort of a fixed size.

mod beside;
mod glb;
mod glb_document;
mod obj;
mod ply;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use storage::{AtomicFile, Disk};

pub use beside::image_bytes;

use super::MeshError;
use crate::tree::{Appearance, Image, Wedge};

/// The formats that are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutputFormat {
    /// Binary little-endian PLY.
    Ply,
    /// Wavefront OBJ, with a library of materials (MTL) beside it where there are any.
    Obj,
    /// Binary glTF 2.0, with everything in one file.
    Glb,
}

impl OutputFormat {
    /// What the user is told of the extensions.
    pub const EXTENSIONS: &str =
        "meshes are written as PLY, OBJ or binary glTF; give a name that ends in .ply, .obj or .glb";

    /// The format that a file's extension asks for.
    pub fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "ply" => Some(OutputFormat::Ply),
            "obj" => Some(OutputFormat::Obj),
            "glb" => Some(OutputFormat::Glb),
            _ => None,
        }
    }
}

/// How coordinates are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CoordinateType {
    /// In 32 bits. Values are rounded to the nearest.
    Float,
    /// In 64 bits, exactly as they are handed over; in 32 bits, relative to [`MeshLayout::origin`], in glTF.
    Double,
}

/// What is promised of a mesh before it is written.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshLayout {
    /// How many vertices will be written.
    pub vertices: u64,
    /// How many triangles will be written.
    pub triangles: u64,
    /// How the coordinates of the vertices are written.
    pub coordinates: CoordinateType,
    /// What formats without double precision count coordinates from where they are promised in it.
    pub origin: [f64; 3],
    /// Lines for the reader of the header, one for each comment.
    pub comments: Vec<String>,
    /// Which attributes the vertices will have, if any.
    pub attributes: Option<LayoutAttributes>,
}

/// What is promised of the attributes.
#[derive(Debug, Clone, PartialEq)]
pub struct LayoutAttributes {
    /// What the wedges refer to. Only the kinds of attributes that it has are written.
    pub appearance: Appearance,
    /// Whether the alpha of a colour is other than 255 anywhere. If not it is not written.
    pub has_alpha: bool,
    /// Whether files beside the mesh that have other content may be replaced.
    pub may_replace: bool,
}

/// Gives the bytes of an image, by its number; none where there are none.
pub type ImageBytes<'a> = dyn FnMut(usize, &Image) -> Result<Option<Vec<u8>>, MeshError> + 'a;

/// What was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WrittenMesh {
    /// Length of the mesh file, in bytes.
    pub bytes: u64,
    /// The files beside it that it names and that are there: images, a library of materials.
    pub beside: Vec<PathBuf>,
    /// What the format has no place for, as phrases.
    pub left_out: Vec<&'static str>,
}

/// A mesh file on its way to its name.
#[derive(Debug)]
pub struct MeshWriter {
    file: AtomicFile,
    path: PathBuf,
    layout: MeshLayout,
    encoder: Encoder,
    /// The library of materials.
    library: Option<beside::Library>,
    beside: Vec<PathBuf>,
    /// The bytes of one vertex or triangle.
    row: Vec<u8>,
    vertices_written: u64,
    triangles_written: u64,
}

/// What knows the format.
#[derive(Debug)]
enum Encoder {
    Ply(ply::Encoder),
    Obj(obj::Encoder),
    Glb(Box<glb::Encoder>),
}

/// The names by which a mesh file calls what lies beside it.
#[derive(Debug, Default)]
struct Names {
    /// File names of the images.
    images: Vec<String>,
    /// Names of the materials, distinct and not empty.
    materials: Vec<String>,
    /// File name of the library of materials.
    library: String,
}

/// Coordinates as they are written.
#[derive(Debug, Clone, Copy)]
enum Coordinates {
    Float([f32; 3]),
    Double([f64; 3]),
}

/// A vertex as the formats see it.
#[derive(Debug, Clone, Copy)]
struct OutputVertex {
    position: Coordinates,
    normal: Option<[f32; 3]>,
    /// Red, green, blue and alpha.
    colour: Option<[u8; 4]>,
    texture: Option<[f32; 2]>,
}

impl MeshWriter {
    /// What [`MeshWriter::triangle`] is told of a triangle without a material.
    pub const NO_MATERIAL: u32 = 0;

    /// Begins the mesh file `path` and writes its header. Images are named, not written.
    ///
    /// # Errors
    ///
    /// The disk's, and [`MeshError::Unwritable`] for more vertices or materials than the format can number, for comments
    /// that are not one line of text, for materials whose colour is not finite or whose image does not exist, and for files
    /// beside the mesh that may not be replaced.
    pub fn create(
        disk: Arc<dyn Disk>,
        path: &Path,
        format: OutputFormat,
        layout: MeshLayout,
    ) -> Result<Self, MeshError> {
        Self::create_with_images(disk, path, format, layout, &mut |_, _| Ok(None))
    }

    /// The same, and writes the images beside the mesh at once, under their own names as far as these are plain, distinct
    /// names of files. A file that is there with the same content is left as it is.
    ///
    /// # Errors
    ///
    /// Those of [`MeshWriter::create`], and those of `images`.
    pub fn create_with_images(
        disk: Arc<dyn Disk>,
        path: &Path,
        format: OutputFormat,
        layout: MeshLayout,
        images: &mut ImageBytes<'_>,
    ) -> Result<Self, MeshError> {
        let unwritable = |element: &str, problem: String| MeshError::Unwritable {
            path: path.to_path_buf(),
            element: element.to_string(),
            problem,
        };
        if let Some(comment) = layout.comments.iter().find(|comment| comment.contains(char::is_control)) {
            let problem = format!("the comment {comment:?} is not one line of plain text");
            return Err(unwritable("the header", problem));
        }
        check_materials(&layout).map_err(|(material, problem)| unwritable(&format!("material {material}"), problem))?;
        let (file, encoder, library, beside) = match format {
            OutputFormat::Glb => {
                let (encoder, file) = glb::Encoder::begin(&disk, path, &layout, images)?;
                (file, Encoder::Glb(Box::new(encoder)), None, Vec::new())
            }
            OutputFormat::Ply => {
                ply::check(&layout).map_err(|problem| unwritable("the header", problem))?;
                let (names, beside) = beside::write_images(&disk, path, layout.attributes.as_ref(), images)?;
                let mut file = AtomicFile::create(disk, path)?;
                file.append(ply::header(&layout, &names).as_bytes())?;
                (file, Encoder::Ply(ply::Encoder::new(&layout)), None, beside)
            }
            OutputFormat::Obj => {
                let (names, mut beside) = beside::write_images(&disk, path, layout.attributes.as_ref(), images)?;
                let library = match &layout.attributes {
                    Some(attributes) if !attributes.appearance.materials.is_empty() => {
                        let text = obj::library(&attributes.appearance, &names);
                        let library_path = path.with_file_name(&names.library);
                        Some(beside::Library::begin(&disk, library_path, &text, attributes.may_replace)?)
                    }
                    _ => None,
                };
                beside.extend(library.as_ref().map(|library| library.path().to_path_buf()));
                let mut file = AtomicFile::create(disk, path)?;
                file.append(obj::header(&layout, &names).as_bytes())?;
                (file, Encoder::Obj(obj::Encoder::new(&layout, names.materials)), library, beside)
            }
        };
        Ok(MeshWriter {
            file,
            path: path.to_path_buf(),
            layout,
            encoder,
            library,
            beside,
            row: Vec::new(),
            vertices_written: 0,
            triangles_written: 0,
        })
    }

    /// Writes the next vertex. Its wedge is of no interest where the layout promises no attributes.
    ///
    /// # Errors
    ///
    /// The disk's, [`MeshError::NotFinite`] for a coordinate that is not a finite number as it is written, and
    /// [`MeshError::Unwritable`] for a vertex after the first triangle, beyond the promised number, or without the promised
    /// attributes.
    pub fn vertex(&mut self, position: [f64; 3], wedge: Option<&Wedge>) -> Result<(), MeshError> {
        if self.triangles_written > 0 {
            let problem = "all vertices come before the first triangle";
            return Err(self.unwritable(format!("vertex {}", self.vertices_written), problem));
        }
        if self.vertices_written == self.layout.vertices {
            let problem = format!("the header promises {} vertices", self.layout.vertices);
            return Err(self.unwritable(format!("vertex {}", self.vertices_written), problem));
        }
        let position = self.coordinates(position)?;
        let mut vertex = OutputVertex { position, normal: None, colour: None, texture: None };
        if let Some(LayoutAttributes { appearance, .. }) = &self.layout.attributes {
            let Some(wedge) = wedge else {
                let problem = "the header promises attributes, and it has none";
                return Err(self.unwritable(format!("vertex {}", self.vertices_written), problem));
            };
            let kinds = appearance.kinds;
            vertex.normal = kinds.normals.then(|| wedge.normal.decode());
            vertex.colour = kinds.colours.then_some(wedge.colour);
            vertex.texture = kinds.textures.then(|| appearance.texture_value(wedge.texture));
        }
        self.row.clear();
        match &mut self.encoder {
            Encoder::Ply(encoder) => encoder.vertex(&mut self.row, &vertex),
            Encoder::Obj(encoder) => encoder.vertex(&mut self.row, &vertex),
            Encoder::Glb(encoder) => encoder.vertex(&mut self.row, &vertex),
        }
        self.file.append(&self.row)?;
        self.vertices_written += 1;
        Ok(())
    }

    /// Writes the next triangle. Its corners are vertex numbers, counted from 0 in the order of writing; its material is that
    /// of its corners' wedges ([`Wedge::material`]), of no interest where the layout promises none.
    ///
    /// # Errors
    ///
    /// The disk's, [`MeshError::CornerOutOfRange`] for a corner that is no vertex of this file, and
    /// [`MeshError::Unwritable`] for a triangle before the last vertex or beyond the promised number, and for a material that
    /// does not exist.
    pub fn triangle(&mut self, corners: [u64; 3], material: u32) -> Result<(), MeshError> {
        if self.vertices_written < self.layout.vertices {
            let (written, promised) = (self.vertices_written, self.layout.vertices);
            let problem = format!("only {written} of the {promised} vertices before it are written");
            return Err(self.unwritable(format!("triangle {}", self.triangles_written), problem));
        }
        if self.triangles_written == self.layout.triangles {
            let problem = format!("the header promises {} triangles", self.layout.triangles);
            return Err(self.unwritable(format!("triangle {}", self.triangles_written), problem));
        }
        for (corner, index) in corners.into_iter().enumerate() {
            if index >= self.layout.vertices {
                return Err(MeshError::CornerOutOfRange {
                    path: self.path.clone(),
                    face: self.triangles_written,
                    corner,
                    index: i64::try_from(index).unwrap_or(i64::MAX),
                    vertices: self.layout.vertices,
                });
            }
        }
        let materials = self.layout.attributes.as_ref().map_or(0, |attributes| attributes.appearance.materials.len());
        if materials > 0 && material as usize > materials {
            let problem = format!("it is of material {material}, and there are {materials} (numbered from 1)");
            return Err(self.unwritable(format!("triangle {}", self.triangles_written), problem));
        }
        self.row.clear();
        match &mut self.encoder {
            Encoder::Ply(encoder) => encoder.triangle(&mut self.row, corners, material),
            Encoder::Obj(encoder) => encoder.triangle(&mut self.row, corners, material),
            Encoder::Glb(encoder) => encoder.triangle(&mut self.row, self.triangles_written, corners, material)?,
        }
        self.file.append(&self.row)?;
        self.triangles_written += 1;
        Ok(())
    }

    /// Flushes everything to the device, gives the file its name, and tells what was written.
    ///
    /// # Errors
    ///
    /// The disk's, and [`MeshError::Unwritable`] where fewer elements were written than promised.
    pub fn finish(mut self) -> Result<WrittenMesh, MeshError> {
        let vertices = (self.vertices_written, self.layout.vertices, "vertices");
        let triangles = (self.triangles_written, self.layout.triangles, "triangles");
        for (written, promised, name) in [vertices, triangles] {
            if written < promised {
                let problem = format!("only {written} of the {promised} {name} that the header promises are written");
                return Err(self.unwritable("the end of the file", problem));
            }
        }
        let left_out = match self.encoder {
            Encoder::Ply(_) => Vec::new(),
            Encoder::Obj(_) => obj::left_out(&self.layout),
            Encoder::Glb(encoder) => encoder.finish(&mut self.file, &self.layout)?,
        };
        let bytes = self.file.length();
        if let Some(library) = self.library {
            library.commit()?;
        }
        self.file.commit()?;
        Ok(WrittenMesh { bytes, beside: self.beside, left_out })
    }

    /// A position as it will be written.
    fn coordinates(&self, position: [f64; 3]) -> Result<Coordinates, MeshError> {
        let (coordinates, finite) = match self.layout.coordinates {
            CoordinateType::Float => {
                let rounded = position.map(|coordinate| coordinate as f32);
                (Coordinates::Float(rounded), rounded.map(f32::is_finite))
            }
            CoordinateType::Double => {
                let finite = match &self.encoder {
                    Encoder::Glb(encoder) => encoder.relative(position).map(f32::is_finite),
                    _ => position.map(f64::is_finite),
                };
                (Coordinates::Double(position), finite)
            }
        };
        match (0..3).find(|&axis| !finite[axis]) {
            None => Ok(coordinates),
            Some(axis) => Err(MeshError::NotFinite {
                path: self.path.clone(),
                index: self.vertices_written,
                axis: ['x', 'y', 'z'][axis],
                value: position[axis],
            }),
        }
    }

    fn unwritable(&self, element: impl Into<String>, problem: impl Into<String>) -> MeshError {
        MeshError::Unwritable { path: self.path.clone(), element: element.into(), problem: problem.into() }
    }
}

/// Finds the first material, counted from 0, that no format can hold, and says why.
fn check_materials(layout: &MeshLayout) -> Result<(), (usize, String)> {
    let Some(LayoutAttributes { appearance, .. }) = &layout.attributes else { return Ok(()) };
    for (number, material) in appearance.materials.iter().enumerate() {
        if let Some(colour) = material.base_colour
            && !colour.iter().all(|channel| channel.is_finite())
        {
            return Err((number, format!("its colour {colour:?} is not finite")));
        }
        let images = appearance.images.len();
        if let Some(image) = material.image
            && image as usize >= images
        {
            return Err((number, format!("it names image {image}, and there are {images} (numbered from 0)")));
        }
    }
    Ok(())
}
