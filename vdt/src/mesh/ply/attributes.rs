//! What the properties of a PLY file mean that are neither coordinates nor corners, by the names that programs give them.
//!
//! | what | names |
//! |---|---|
//! | normal | `nx ny nz` |
//! | colour | `red green blue`, with or without `alpha`; `r g b a`; `diffuse_red` and so on |
//! | texture coordinate | `s t`, `u v`, `texture_u texture_v`, `texture_s texture_t` |
//! | texture coordinates of corners | the list `texcoord` or `wedge_texcoord` of `face`, two numbers a corner |
//! | normals of corners | the list `wedge_normal` of `face`, three numbers a corner |
//! | image | `comment TextureFile NAME`, and `texnumber` of `face` where there are several |
//! | material | `comment VdtMaterial` (module [`super::super::writer`]), and `material_index` of `face` |
//!
//! What is not complete is no attribute and stepped over. Colours in floats go from 0 to 1, in `ushort` to 65535, in all else
//! they are bytes.

use super::super::attributes::{byte_of_unit, byte_of_word};
use super::super::polygon::CORNER_LIMIT;
use super::super::{Face, Vertex, Wedges};
use super::{Element, Flaw, Scalar, Shape, Value};

/// Which number of an element a property is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Channel {
    Normal(usize),
    Colour(usize),
    Texture(usize),
    Material,
}

/// Which values of the corners of a face a list has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wedge {
    Texture,
    Normal,
}

const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
const COLOURS: [[&str; 4]; 3] = [
    ["red", "green", "blue", "alpha"],
    ["r", "g", "b", "a"],
    ["diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"],
];
const TEXTURES: [[&str; 2]; 4] = [["s", "t"], ["u", "v"], ["texture_u", "texture_v"], ["texture_s", "texture_t"]];

fn single(element: &Element, name: &str) -> Option<usize> {
    let is_single = |shape| matches!(shape, Shape::Single(_));
    element.properties.iter().position(|property| property.name == name && is_single(property.shape))
}

/// The places of the properties of all these names; none if one is missing.
fn all(element: &Element, names: &[&str]) -> Option<Vec<usize>> {
    names.iter().map(|name| single(element, name)).collect()
}

/// The properties that are numbers of attributes, by their places. `material` is the name of the one that says the material.
pub(super) fn channels(element: &Element, material: Option<&str>) -> Vec<(usize, Channel)> {
    let mut found = Vec::new();
    let is_face = element.name == "face";
    if !is_face && let Some(places) = all(element, &NORMAL) {
        found.extend(places.into_iter().enumerate().map(|(axis, place)| (place, Channel::Normal(axis))));
    }
    if let Some((names, places)) = COLOURS.iter().find_map(|names| Some((names, all(element, &names[..3])?))) {
        let places = places.into_iter().chain(single(element, names[3]));
        found.extend(places.enumerate().map(|(channel, place)| (place, Channel::Colour(channel))));
    }
    if !is_face && let Some(places) = TEXTURES.iter().find_map(|names| all(element, names)) {
        found.extend(places.into_iter().enumerate().map(|(axis, place)| (place, Channel::Texture(axis))));
    }
    if let Some(place) = material.and_then(|name| single(element, name)) {
        found.push((place, Channel::Material));
    }
    found
}

/// The lists that are values of corners, by their places.
pub(super) fn wedges(element: &Element) -> Vec<(usize, Wedge)> {
    let named = |names: &[&str], wedge| {
        let is_list = |shape| matches!(shape, Shape::List { .. });
        let mut properties = element.properties.iter();
        let place = properties.position(|property| names.contains(&property.name.as_str()) && is_list(property.shape));
        place.map(|place| (place, wedge))
    };
    let texture = named(&["texcoord", "wedge_texcoord"], Wedge::Texture);
    texture.into_iter().chain(named(&["wedge_normal"], Wedge::Normal)).collect()
}

/// A vertex that has what the channels give, still all zero, and an alpha of 255.
pub(super) fn blank_vertex(channels: impl Iterator<Item = Channel>) -> Vertex {
    let mut vertex = Vertex::at([0.0; 3]);
    for channel in channels {
        match channel {
            Channel::Normal(_) => vertex.normal = Some([0.0; 3]),
            Channel::Colour(_) => vertex.colour = Some(BLACK),
            Channel::Texture(_) => vertex.texture = Some([0.0; 2]),
            Channel::Material => {}
        }
    }
    vertex
}

const BLACK: [u8; 4] = [0, 0, 0, u8::MAX];

/// Puts the value of a channel into a vertex that [`blank_vertex`] made.
#[inline]
pub(super) fn put(vertex: &mut Vertex, channel: Channel, scalar: Scalar, value: Value) -> Result<(), Flaw> {
    match channel {
        Channel::Normal(axis) => {
            if let Some(normal) = &mut vertex.normal {
                normal[axis] = value.real() as f32;
            }
        }
        Channel::Texture(axis) => {
            if let Some(texture) = &mut vertex.texture {
                texture[axis] = value.real() as f32;
            }
        }
        Channel::Colour(channel) => {
            if let Some(colour) = &mut vertex.colour {
                colour[channel] = colour_byte(scalar, value)?;
            }
        }
        Channel::Material => {}
    }
    Ok(())
}

#[inline]
fn colour_byte(scalar: Scalar, value: Value) -> Result<u8, Flaw> {
    let byte = match scalar {
        Scalar::Float32 | Scalar::Float64 => byte_of_unit(value.real()),
        Scalar::Unsigned16 => value.integer().ok().and_then(|value| u16::try_from(value).ok()).map(byte_of_word),
        _ => value.integer().ok().and_then(|value| u8::try_from(value).ok()),
    };
    byte.ok_or_else(|| Flaw::Bad(format!("{} is no part of a colour", value.real())))
}

/// The attributes of the face that is being read.
#[derive(Debug, Default)]
pub(super) struct FaceAttributes {
    textures: Vec<f32>,
    normals: Vec<f32>,
    colour: Option<[u8; 4]>,
    material: Option<u32>,
}

impl FaceAttributes {
    /// Begins the next face, which has `material` if it does not say.
    pub fn begin(&mut self, material: Option<u32>) {
        self.textures.clear();
        self.normals.clear();
        self.colour = None;
        self.material = material;
    }

    /// The value of a channel.
    pub fn put(&mut self, channel: Channel, scalar: Scalar, value: Value) -> Result<(), Flaw> {
        match channel {
            Channel::Colour(channel) => self.colour.get_or_insert(BLACK)[channel] = colour_byte(scalar, value)?,
            // -1 is none.
            Channel::Material => match value.integer()? {
                -1 => self.material = None,
                number => {
                    let number = u32::try_from(number);
                    self.material =
                        Some(number.map_err(|_| {
                            Flaw::Bad(format!("{} is no number of an image or material", value.real()))
                        })?);
                }
            },
            Channel::Normal(_) | Channel::Texture(_) => {}
        }
        Ok(())
    }

    /// The next number of the values of the corners.
    pub fn push(&mut self, wedge: Wedge, value: f64) -> Result<(), Flaw> {
        let (list, per_corner) = match wedge {
            Wedge::Texture => (&mut self.textures, 2),
            Wedge::Normal => (&mut self.normals, 3),
        };
        if list.len() == CORNER_LIMIT * per_corner {
            return Err(Flaw::Bad(format!("more than {} values of corners", list.len())));
        }
        list.push(value as f32);
        Ok(())
    }

    /// The face with these corners.
    pub fn face<'a>(&'a self, corners: &'a [i64]) -> Result<Face<'a>, Flaw> {
        let mut face = Face::new(corners);
        face.colour = self.colour;
        face.material = self.material;
        face.textures = values(&self.textures, corners.len())?;
        face.normals = values(&self.normals, corners.len())?;
        Ok(face)
    }
}

fn values<const N: usize>(numbers: &[f32], corners: usize) -> Result<Wedges<'_, [f32; N]>, Flaw> {
    match numbers.as_chunks::<N>() {
        ([], []) => Ok(Wedges::None),
        (values, []) if values.len() == corners => Ok(Wedges::Values(values)),
        _ => Err(Flaw::Bad(format!("{} values for {corners} corners, which need {N} each", numbers.len()))),
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::super::super::testing::{FaceAttributes as Found, OwnedWedges, WithAttributes, read_attributes};
    use super::super::super::{Image, ImageSource, Material, MeshError};
    use super::super::read;

    fn file(encoding: &str, vertex: &str, face: &str, body: &[u8]) -> Vec<u8> {
        let mut bytes = format!(
            "ply\nformat {encoding} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{vertex}\
             element face 1\nproperty list uchar int vertex_indices\n{face}end_header\n"
        )
        .into_bytes();
        bytes.extend_from_slice(body);
        bytes
    }

    fn found(bytes: &[u8]) -> Result<WithAttributes, MeshError> {
        read_attributes(read, &[("file", bytes)])
    }

    fn declared(kind: &str, names: &str) -> String {
        names.split(' ').map(|name| format!("property {kind} {name}\n")).collect()
    }

    /// The numbers of three vertices and a face behind their coordinates and corners, in an encoding.
    fn body(encoding: &str, vertex: &[(&str, f64)], face: &[(&str, f64)]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut push = |kind: &str, value: f64| {
            let mut number = match (encoding, kind) {
                ("ascii", _) => {
                    bytes.extend_from_slice(format!("{value} ").as_bytes());
                    return;
                }
                (_, "uchar") => vec![value as u8],
                (_, "ushort") => (value as u16).to_le_bytes().to_vec(),
                (_, "int") => (value as i32).to_le_bytes().to_vec(),
                (_, "float") => (value as f32).to_le_bytes().to_vec(),
                _ => value.to_le_bytes().to_vec(),
            };
            if encoding == "binary_big_endian" {
                number.reverse();
            }
            bytes.extend(number);
        };
        for _ in 0..3 {
            [0.0, 1.0, 2.0].into_iter().for_each(|value| push("float", value));
            vertex.iter().for_each(|(kind, value)| push(kind, *value));
        }
        push("uchar", 3.0);
        [0.0, 1.0, 2.0].into_iter().for_each(|value| push("int", value));
        face.iter().for_each(|(kind, value)| push(kind, *value));
        if encoding == "ascii" {
            // Each row on a line of its own.
            let text = String::from_utf8(bytes).unwrap();
            let words: Vec<&str> = text.split_whitespace().collect();
            let (vertices, face) = words.split_at(3 * (3 + vertex.len()));
            let mut lines: Vec<String> = vertices.chunks(3 + vertex.len()).map(|row| row.join(" ")).collect();
            lines.push(face.join(" "));
            return (lines.join("\n") + "\n").into_bytes();
        }
        bytes
    }

    const ENCODINGS: [&str; 3] = ["ascii", "binary_little_endian", "binary_big_endian"];

    #[test]
    fn vertices_have_attributes_of_any_type_in_any_encoding() {
        let vertex = declared("double", "nx ny nz") + &declared("int", "odd") + &declared("float", "u v");
        for (kind, colour) in
            [("uchar", [51.0, 102.0, 255.0]), ("ushort", [13107.0, 26214.0, 65535.0]), ("float", [0.2, 0.4, 1.0])]
        {
            for encoding in ENCODINGS {
                let declarations = format!("{vertex}{}", declared(kind, "red green blue"));
                let numbers =
                    [("double", 0.0), ("double", 0.5), ("double", -2.0), ("int", 9.0), ("float", 0.25), ("float", 7.0)];
                let numbers = [numbers.as_slice(), &colour.map(|channel| (kind, channel))].concat();
                let bytes = file(encoding, &declarations, "", &body(encoding, &numbers, &[]));
                let expected = (Some([0.0, 0.5, -2.0]), Some([51, 102, 255, 255]), Some([0.25, 7.0]));
                assert_eq!(found(&bytes).unwrap().vertices, [expected; 3], "{kind} {encoding}");
            }
        }
    }

    #[test]
    fn names_are_those_that_programs_write_and_what_is_not_complete_is_none() {
        let vertices = |names: &str| {
            let count = names.split(' ').count();
            let numbers: Vec<(&str, f64)> = (0..count).map(|number| ("uchar", number as f64)).collect();
            let bytes = file("ascii", &declared("uchar", names), "", &body("ascii", &numbers, &[]));
            found(&bytes).unwrap().vertices[0]
        };
        for names in ["red green blue alpha", "r g b a", "diffuse_red diffuse_green diffuse_blue diffuse_alpha"] {
            assert_eq!(vertices(names), (None, Some([0, 1, 2, 3]), None), "{names}");
        }
        for names in ["s t", "u v", "texture_u texture_v", "texture_s texture_t"] {
            assert_eq!(vertices(names), (None, None, Some([0.0, 1.0])), "{names}");
        }
        assert_eq!(vertices("nz ny nx"), (Some([2.0, 1.0, 0.0]), None, None));
        for names in ["nx nz", "red green alpha", "u t", "texture_u", "confidence"] {
            assert_eq!(vertices(names), (None, None, None), "{names}");
        }
    }

    #[test]
    fn faces_have_colours_and_values_at_their_corners() {
        let face = declared("uchar", "red green blue")
            + "property list uchar float texcoord\nproperty list uchar double wedge_normal\n";
        for encoding in ENCODINGS {
            let mut numbers = vec![("uchar", 1.0), ("uchar", 2.0), ("uchar", 3.0), ("uchar", 6.0)];
            numbers.extend((0..6).map(|number| ("float", f64::from(number))));
            numbers.push(("uchar", 9.0));
            numbers.extend((0..9).map(|number| ("double", f64::from(number))));
            let bytes = file(encoding, "", &face, &body(encoding, &[], &numbers));
            let expected = Found {
                textures: OwnedWedges::Values(vec![[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]),
                normals: OwnedWedges::Values(vec![[0.0, 1.0, 2.0], [3.0, 4.0, 5.0], [6.0, 7.0, 8.0]]),
                colour: Some([1, 2, 3, 255]),
                material: None,
            };
            assert_eq!(found(&bytes).unwrap().faces, [expected], "{encoding}");
        }
        let none = file("ascii", "", "property list uchar float texcoord\n", &body("ascii", &[], &[("uchar", 0.0)]));
        assert_eq!(found(&none).unwrap().faces[0].textures, OwnedWedges::None);
    }

    #[test]
    fn images_are_named_in_comments() {
        let material = |bytes: &[u8]| {
            let files = [("folder/file", bytes), ("folder/my skin.png", b"png".as_slice())];
            let found = read_attributes(read, &files).unwrap();
            (found.materials, found.faces[0].material, found.missing_files)
        };
        let comments = "comment TextureFile my skin.png\ncomment made by hand\n";
        let image = |source| Some(Image { name: "my skin.png".into(), source });
        let expected = Material {
            name: "my skin.png".into(),
            base_colour: None,
            image: image(ImageSource::File("folder/my skin.png".into())),
        };
        for encoding in ENCODINGS {
            let bytes = file(encoding, "", comments, &body(encoding, &[], &[]));
            assert_eq!(material(&bytes), (vec![expected.clone()], Some(0), vec![]), "{encoding}");
            let two = format!("comment TextureFile no.png\n{comments}property int texnumber\n");
            for (number, chosen) in [(1, Some(1)), (0, Some(0)), (-1, None)] {
                let bytes = file(encoding, "", &two, &body(encoding, &[], &[("int", f64::from(number))]));
                let (materials, found, missing) = material(&bytes);
                assert_eq!((materials.len(), found), (2, chosen), "{encoding}");
                assert_eq!(missing, [PathBuf::from("folder/no.png")]);
            }
        }
        let long = format!("comment {}\ncomment TextureFiles no.png\n", "x".repeat(10_000));
        assert_eq!(material(&file("ascii", "", &long, &body("ascii", &[], &[]))), (vec![], None, vec![]));
    }

    #[test]
    fn materials_are_in_comments_of_our_own() {
        let comments = "comment TextureFile a.png\ncomment VdtMaterial 0 - red  paint\ncomment VdtMaterial - 1 0.5 0 1 -\n\
                        comment VdtMaterials 9\nproperty int material_index\nproperty int texnumber\n";
        for encoding in ENCODINGS {
            for (number, chosen) in [(1, Some(1)), (-1, None)] {
                let numbers = [("int", f64::from(number)), ("int", 0.0)];
                let bytes = file(encoding, "", comments, &body(encoding, &[], &numbers));
                let found = found(&bytes).unwrap();
                let image = Some(Image { name: "a.png".into(), source: ImageSource::Missing });
                let expected = [
                    Material { name: "red  paint".into(), base_colour: None, image },
                    Material { name: "-".into(), base_colour: Some([1.0, 0.5, 0.0, 1.0]), image: None },
                ];
                assert_eq!(
                    (found.materials.as_slice(), found.faces[0].material),
                    (&expected[..], chosen),
                    "{encoding}"
                );
            }
        }
        for (material, says) in [
            ("", "line 9: a material is the number of an image"),
            ("x - name", "line 9: a material is the number of an image"),
            ("- 1 2 3 name", "line 9: a material is the number of an image"),
            ("- 1 2 3 nan name", "line 9: a material is the number of an image"),
            ("0 - red", "header: material 'red' names image 0, which is not there"),
        ] {
            let bytes = file("ascii", "", &format!("comment VdtMaterial {material}\n"), &body("ascii", &[], &[]));
            let message = found(&bytes).unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }

    #[test]
    fn broken_attributes_say_where_and_what() {
        let colour = declared("float", "red green blue");
        for encoding in ENCODINGS {
            let numbers = [("float", 0.5), ("float", f64::NAN), ("float", 0.5)];
            let message = found(&file(encoding, &colour, "", &body(encoding, &numbers, &[]))).unwrap_err().to_string();
            assert!(message.starts_with("file: vertex 0, "), "{message}");
            assert!(message.ends_with(": NaN is no part of a colour"), "{message}");
        }
        let message = |face: &str, numbers: &[(&str, f64)]| {
            found(&file("ascii", "", face, &body("ascii", &[], numbers))).unwrap_err().to_string()
        };
        let list = "property list uchar float texcoord\n";
        let numbers = [("uchar", 5.0), ("float", 0.0), ("float", 0.0), ("float", 0.0), ("float", 0.0), ("float", 0.0)];
        assert!(message(list, &numbers).ends_with(": 5 values for 3 corners, which need 2 each"));
        assert!(message(list, &numbers).starts_with("file: face 0, line "));
        let bytes = declared("int", "red green blue");
        let numbers = [("int", 0.0), ("int", 256.0), ("int", 0.0)];
        assert!(message(&bytes, &numbers).ends_with(": 256 is no part of a colour"));
        let image = "comment TextureFile a\ncomment TextureFile b\nproperty int texnumber\n";
        assert!(message(image, &[("int", -2.0)]).ends_with(": -2 is no number of an image or material"));
    }
}
