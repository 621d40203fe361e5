//! OBJ, and MTL for its materials.
//!
//! Each output vertex is a `v`, with its colour as three numbers from 0 to 1 behind the coordinates, and where there are such
//! a `vt` (v points up) and a `vn` of the same number. `usemtl` stands where the material changes; without a name it means
//! no material. The alpha of colours has no place in the format.
//!
//! Coordinates have as many digits as double precision needs, so that they are read back exactly, also in single precision.
//! Texture coordinates and normals, which readers take in single precision, have as many as that needs, also where it is read in
//! double precision first.

use std::fmt::Write as _;
use std::io::Write as _;

use super::{Coordinates, MeshLayout, MeshWriter, Names, OutputVertex};
use crate::tree::Appearance;

/// What knows the format.
#[derive(Debug)]
pub(super) struct Encoder {
    materials: Vec<String>,
    /// The material of the last triangle, counted from 1.
    current: u32,
    has_textures: bool,
    has_normals: bool,
}

impl Encoder {
    pub fn new(layout: &MeshLayout, materials: Vec<String>) -> Self {
        let kinds = layout.attributes.as_ref().map(|attributes| attributes.appearance.kinds).unwrap_or_default();
        Encoder {
            materials,
            current: MeshWriter::NO_MATERIAL,
            has_textures: kinds.textures,
            has_normals: kinds.normals,
        }
    }

    // Writing to a Vec cannot fail.
    pub fn vertex(&self, row: &mut Vec<u8>, vertex: &OutputVertex) {
        row.extend_from_slice(b"v");
        match vertex.position {
            Coordinates::Float(position) => position.into_iter().for_each(|value| double(row, value.into())),
            Coordinates::Double(position) => position.into_iter().for_each(|value| double(row, value)),
        }
        if let Some([red, green, blue, _]) = vertex.colour {
            for channel in [red, green, blue] {
                let _ = write!(row, " {:.4}", f64::from(channel) / 255.0);
            }
        }
        row.push(b'\n');
        if let Some(texture) = vertex.texture {
            row.extend_from_slice(b"vt");
            texture.into_iter().for_each(|value| single(row, value));
            row.push(b'\n');
        }
        if let Some(normal) = vertex.normal {
            row.extend_from_slice(b"vn");
            normal.into_iter().for_each(|value| single(row, value));
            row.push(b'\n');
        }
    }

    pub fn triangle(&mut self, row: &mut Vec<u8>, corners: [u64; 3], material: u32) {
        if material != self.current && !self.materials.is_empty() {
            self.current = material;
            row.extend_from_slice(b"usemtl");
            // Numbers of materials are checked before.
            if let Some(name) = (material as usize).checked_sub(1).and_then(|number| self.materials.get(number)) {
                let _ = write!(row, " {name}");
            }
            row.push(b'\n');
        }
        row.push(b'f');
        for number in corners.map(|corner| corner + 1) {
            let _ = match (self.has_textures, self.has_normals) {
                (false, false) => write!(row, " {number}"),
                (true, false) => write!(row, " {number}/{number}"),
                (false, true) => write!(row, " {number}//{number}"),
                (true, true) => write!(row, " {number}/{number}/{number}"),
            };
        }
        row.push(b'\n');
    }
}

/// A number behind a blank.
fn double(row: &mut Vec<u8>, value: f64) {
    let _ = match value == 0.0 || (1e-5..1e16).contains(&value.abs()) {
        true => write!(row, " {value}"),
        false => write!(row, " {value:e}"),
    };
}

/// The same in single precision. Its digits are those that tell it from its neighbours; the very rare number that would become
/// a neighbour where these are rounded twice has all of its digits.
fn single(row: &mut Vec<u8>, value: f32) {
    let start = row.len();
    let _ = match value == 0.0 || (1e-5..1e9).contains(&value.abs()) {
        true => write!(row, " {value}"),
        false => write!(row, " {value:e}"),
    };
    let text = std::str::from_utf8(&row[start + 1..]).unwrap_or_default();
    if text.parse::<f64>().map(|value| value as f32) != Ok(value) {
        row.truncate(start);
        double(row, value.into());
    }
}

/// What stands before the vertices.
pub(super) fn header(layout: &MeshLayout, names: &Names) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    for comment in &layout.comments {
        let _ = writeln!(text, "# {comment}");
    }
    if !names.materials.is_empty() {
        let _ = writeln!(text, "mtllib {}", names.library);
    }
    text
}

/// The library of materials.
pub(super) fn library(appearance: &Appearance, names: &Names) -> String {
    let mut text = String::new();
    for (material, name) in appearance.materials.iter().zip(&names.materials) {
        let _ = writeln!(text, "newmtl {name}");
        if let Some([red, green, blue, alpha]) = material.base_colour {
            let _ = writeln!(text, "Kd {red} {green} {blue}\nd {alpha}");
        }
        if let Some(image) = material.image.and_then(|image| names.images.get(image as usize)) {
            let _ = writeln!(text, "map_Kd {image}");
        }
    }
    text
}

/// What has no place in the format.
pub(super) fn left_out(layout: &MeshLayout) -> Vec<&'static str> {
    let attributes = layout.attributes.as_ref();
    let has_alpha = attributes.is_some_and(|attributes| attributes.has_alpha && attributes.appearance.kinds.colours);
    if has_alpha { vec!["the alpha of colours, for which OBJ has no place"] } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A famous number whose shortest digits become a neighbour of it when they are read in double precision first.
    #[test]
    fn digits_that_would_be_rounded_twice_are_all_written() {
        let value = f32::from_bits(0x15ae_43fd);
        assert_ne!(value.to_string().parse::<f64>().unwrap() as f32, value);
        let mut row = Vec::new();
        single(&mut row, value);
        let text = String::from_utf8(row).unwrap();
        assert_eq!(text.trim().parse::<f64>().unwrap() as f32, value);
        assert_eq!(text.trim().parse::<f32>().unwrap(), value);
    }

    #[test]
    fn numbers_are_short() {
        let written = |value: f32| {
            let mut row = Vec::new();
            single(&mut row, value);
            String::from_utf8(row).unwrap()
        };
        for (value, text) in [(0.1, " 0.1"), (-0.0, " -0"), (1e-30, " 1e-30"), (3.0e20, " 3e20"), (-17.0, " -17")] {
            assert_eq!(written(value), text);
        }
    }
}
