//! Binary little-endian PLY.
//!
//! Attributes have the names that most programs know: `nx ny nz`, `red green blue`, with `alpha` where there is one, `s t` with
//! t up, and for each image `comment TextureFile NAME`. Materials have no place in the format; what they are is in comments
//! of our own, one for each, and which of them a face is of in its property `material_index`, counted from 0, where -1 is none:
//!
//! ```text
//! comment VdtMaterial IMAGE RED GREEN BLUE ALPHA NAME
//! comment VdtMaterial IMAGE - NAME
//! ```
//!
//! IMAGE is the number of a `TextureFile`, counted from 0, or `-`.

use std::fmt::Write;

use super::{CoordinateType, Coordinates, MeshLayout, Names, OutputVertex};

/// Vertex numbers are written in 32 bits, so there can be this many of them.
const MOST_VERTICES: u64 = 1 << 32;
/// Readers of this project take headers with a thousand declarations.
const MOST_MATERIALS_AND_IMAGES: usize = 900;

/// What knows the format.
#[derive(Debug)]
pub(super) struct Encoder {
    has_alpha: bool,
    has_materials: bool,
}

impl Encoder {
    pub fn new(layout: &MeshLayout) -> Self {
        let attributes = layout.attributes.as_ref();
        Encoder {
            has_alpha: attributes.is_some_and(|attributes| attributes.has_alpha),
            has_materials: attributes.is_some_and(|attributes| !attributes.appearance.materials.is_empty()),
        }
    }

    pub fn vertex(&self, row: &mut Vec<u8>, vertex: &OutputVertex) {
        match vertex.position {
            Coordinates::Float(position) => floats(row, &position),
            Coordinates::Double(position) => {
                position.into_iter().for_each(|coordinate| row.extend_from_slice(&coordinate.to_le_bytes()));
            }
        }
        if let Some(normal) = vertex.normal {
            floats(row, &normal);
        }
        if let Some(colour) = vertex.colour {
            row.extend_from_slice(if self.has_alpha { &colour } else { &colour[..3] });
        }
        if let Some(texture) = vertex.texture {
            floats(row, &texture);
        }
    }

    pub fn triangle(&self, row: &mut Vec<u8>, corners: [u64; 3], material: u32) {
        row.push(3);
        for index in corners {
            // Fits: there are at most 2^32 vertices. Below 2^31 the bytes of `int` and `uint` are the same.
            row.extend_from_slice(&(index as u32).to_le_bytes());
        }
        if self.has_materials {
            // None is -1.
            row.extend_from_slice(&material.wrapping_sub(1).to_le_bytes());
        }
    }
}

fn floats(row: &mut Vec<u8>, values: &[f32]) {
    values.iter().for_each(|value| row.extend_from_slice(&value.to_le_bytes()));
}

/// Says what the format has no room for.
pub(super) fn check(layout: &MeshLayout) -> Result<(), String> {
    if layout.vertices > MOST_VERTICES {
        let vertices = layout.vertices;
        return Err(format!("{vertices} vertices are more than the {MOST_VERTICES} that PLY can number in 32 bits"));
    }
    let names = layout
        .attributes
        .as_ref()
        .map_or(0, |attributes| attributes.appearance.materials.len() + attributes.appearance.images.len());
    if names > MOST_MATERIALS_AND_IMAGES {
        return Err(format!(
            "{names} materials and images are more than the {MOST_MATERIALS_AND_IMAGES} for which there is room; write OBJ"
        ));
    }
    Ok(())
}

/// What stands before the vertices.
pub(super) fn header(layout: &MeshLayout, names: &Names) -> String {
    let coordinate = match layout.coordinates {
        CoordinateType::Float => "float",
        CoordinateType::Double => "double",
    };
    // The largest vertex number is one less than the number of vertices.
    let index = if layout.vertices > 1 << 31 { "uint" } else { "int" };
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    // Writing to a String cannot fail.
    for comment in &layout.comments {
        let _ = writeln!(text, "comment {comment}");
    }
    for image in &names.images {
        let _ = writeln!(text, "comment TextureFile {image}");
    }
    let attributes = layout.attributes.as_ref();
    let materials = attributes.map_or(&[][..], |attributes| &attributes.appearance.materials);
    for (material, name) in materials.iter().zip(&names.materials) {
        let image = material.image.map_or("-".to_string(), |image| image.to_string());
        let colour = match material.base_colour {
            Some([red, green, blue, alpha]) => format!("{red} {green} {blue} {alpha}"),
            None => "-".to_string(),
        };
        let _ = writeln!(text, "comment VdtMaterial {image} {colour} {name}");
    }
    let kinds = attributes.map(|attributes| attributes.appearance.kinds).unwrap_or_default();
    let has_alpha = attributes.is_some_and(|attributes| attributes.has_alpha);
    let _ = writeln!(text, "element vertex {}", layout.vertices);
    let mut properties = |kind: &str, names: &[&str]| {
        for name in names {
            let _ = writeln!(text, "property {kind} {name}");
        }
    };
    properties(coordinate, &["x", "y", "z"]);
    if kinds.normals {
        properties("float", &["nx", "ny", "nz"]);
    }
    if kinds.colours {
        properties("uchar", if has_alpha { &["red", "green", "blue", "alpha"] } else { &["red", "green", "blue"] });
    }
    if kinds.textures {
        properties("float", &["s", "t"]);
    }
    let _ = writeln!(text, "element face {}", layout.triangles);
    let _ = writeln!(text, "property list uchar {index} vertex_indices");
    if !materials.is_empty() {
        text.push_str("property int material_index\n");
    }
    text.push_str("end_header\n");
    text
}
