//! Mesh files of every format, written as other programs write them, and a reader of PLY: nothing here is vdt's.

use std::collections::BTreeSet;
use std::fmt::{Display, Write};

use serde_json::{Value, json};

use crate::cut::smallest_first;
use crate::random_mesh::RawMesh;

/// How the numbers of a PLY file are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// As text.
    Ascii,
    /// In binary, the lowest byte first.
    LittleEndian,
    /// In binary, the highest byte first.
    BigEndian,
}

impl Encoding {
    /// All there are.
    pub const ALL: [Encoding; 3] = [Encoding::Ascii, Encoding::LittleEndian, Encoding::BigEndian];

    fn name(self) -> &'static str {
        match self {
            Encoding::Ascii => "ascii",
            Encoding::LittleEndian => "binary_little_endian",
            Encoding::BigEndian => "binary_big_endian",
        }
    }
}

/// The type of the coordinates of a PLY file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coordinates {
    /// Single precision.
    Float,
    /// Double precision.
    Double,
}

/// The rows of a PLY file.
struct Rows {
    encoding: Encoding,
    bytes: Vec<u8>,
}

impl Rows {
    /// One number: as text, or its little-endian bytes in the order asked for.
    fn put<const BYTES: usize>(&mut self, value: impl Display, mut little_endian: [u8; BYTES]) {
        match self.encoding {
            Encoding::Ascii => {
                self.bytes.extend(value.to_string().bytes());
                self.bytes.push(b' ');
                return;
            }
            Encoding::LittleEndian => (),
            Encoding::BigEndian => little_endian.reverse(),
        }
        self.bytes.extend(little_endian);
    }

    fn byte(&mut self, value: u8) {
        self.put(value, value.to_le_bytes());
    }

    fn int(&mut self, value: u32) {
        self.put(value, value.to_le_bytes());
    }

    fn float(&mut self, value: f32) {
        // The text of the very number, not the shortest that is near enough for single precision.
        self.put(f64::from(value), value.to_le_bytes());
    }

    fn coordinate(&mut self, value: f64, coordinates: Coordinates) {
        match coordinates {
            Coordinates::Float => self.float(value as f32),
            Coordinates::Double => self.put(value, value.to_le_bytes()),
        }
    }

    fn end_row(&mut self) {
        if self.encoding == Encoding::Ascii {
            self.bytes.pop();
            self.bytes.push(b'\n');
        }
    }
}

/// PLY as most programs write it.
pub fn ply(mesh: &RawMesh, encoding: Encoding, coordinates: Coordinates) -> Vec<u8> {
    let kind = if coordinates == Coordinates::Float { "float" } else { "double" };
    let header = format!(
        "ply\nformat {} 1.0\ncomment by hand\nelement vertex {}\nproperty {kind} x\nproperty {kind} y\n\
         property {kind} z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        encoding.name(),
        mesh.positions.len(),
        mesh.triangles.len(),
    );
    let mut rows = Rows { encoding, bytes: header.into_bytes() };
    for position in &mesh.positions {
        position.iter().for_each(|value| rows.coordinate(*value, coordinates));
        rows.end_row();
    }
    for corners in &mesh.triangles {
        rows.byte(3);
        corners.iter().for_each(|corner| rows.int(*corner));
        rows.end_row();
    }
    rows.bytes
}

/// PLY as few programs write it, but may: faces first, coordinates from z to x, of two types, with colours, a confidence
/// and a list between them, faces with a list before the corners and a number behind, and an element nobody knows.
pub fn unusual_ply(mesh: &RawMesh, encoding: Encoding) -> Vec<u8> {
    let header = format!(
        "ply\nformat {} 1.0\nobj_info made by hand\nelement face {}\nproperty list uint8 float32 texcoord\n\
         property list int32 uint32 vertex_index\nproperty uchar flags\nelement sensor 2\nproperty float64 gain\n\
         property list uchar uchar name\nelement vertex {}\nproperty float64 z\nproperty uchar red\n\
         property list uchar float weights\nproperty float32 y\nproperty float confidence\nproperty double x\n\
         end_header\n",
        encoding.name(),
        mesh.triangles.len(),
        mesh.positions.len(),
    );
    let mut rows = Rows { encoding, bytes: header.into_bytes() };
    for (index, corners) in mesh.triangles.iter().enumerate() {
        let texture = [[0.0; 6].as_slice(), &[]][index % 2];
        rows.byte(texture.len() as u8);
        texture.iter().for_each(|value| rows.float(*value));
        rows.int(3);
        corners.iter().for_each(|corner| rows.int(*corner));
        rows.byte(index as u8);
        rows.end_row();
    }
    for sensor in 0..2_u8 {
        rows.put(0.5, 0.5_f64.to_le_bytes());
        rows.byte(sensor);
        (0..sensor).for_each(|letter| rows.byte(letter));
        rows.end_row();
    }
    for (index, [x, y, z]) in mesh.positions.iter().enumerate() {
        rows.coordinate(*z, Coordinates::Double);
        rows.byte(200);
        rows.byte((index % 3) as u8);
        (0..index % 3).for_each(|_| rows.float(0.25));
        rows.coordinate(*y, Coordinates::Float);
        rows.float(1.0);
        rows.coordinate(*x, Coordinates::Double);
        rows.end_row();
    }
    rows.bytes
}

/// Wavefront OBJ with positions and triangles.
pub fn obj(mesh: &RawMesh) -> Vec<u8> {
    let mut text = String::from("# by hand\n");
    for [x, y, z] in &mesh.positions {
        let _ = writeln!(text, "v {x} {y} {z}");
    }
    for corners in &mesh.triangles {
        let [a, b, c] = corners.map(|corner| corner + 1);
        let _ = writeln!(text, "f {a} {b} {c}");
    }
    text.into_bytes()
}

/// Wavefront OBJ with normals, texture, groups and materials, and corners counted backwards.
pub fn unusual_obj(mesh: &RawMesh) -> Vec<u8> {
    let mut text = String::from("mtllib nothing.mtl\r\nvt 0 0\r\nvn 0 0 1\r\no thing\r\n");
    for [x, y, z] in &mesh.positions {
        let _ = write!(text, "v  {x:e} {y} {z} 1.0\r\n");
    }
    text.push_str("g one two\r\nusemtl stone\r\ns off\r\n");
    let count = mesh.positions.len() as i64;
    for (index, corners) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = corners.map(|corner| i64::from(corner) - count);
        let _ = match index % 3 {
            0 => write!(text, "f {a}/1/1 {b}/1/1 {c}/1/1\r\n"),
            1 => write!(text, "f {a}//1 \\\r\n  {b}//1 {c}//1 # a line in two\r\n"),
            _ => write!(text, "f {a}/-1 {b}/-1 {c}/-1\r\n"),
        };
    }
    text.into_bytes()
}

/// Object File Format.
pub fn off(mesh: &RawMesh) -> Vec<u8> {
    let mut text = format!("OFF\n# by hand\n{} {} 0\n", mesh.positions.len(), mesh.triangles.len());
    for [x, y, z] in &mesh.positions {
        let _ = writeln!(text, "{x} {y} {z}");
    }
    for [a, b, c] in &mesh.triangles {
        let _ = writeln!(text, "3 {a} {b} {c} 255 0 0");
    }
    text.into_bytes()
}

/// Binary STL, in single precision.
pub fn stl_binary(mesh: &RawMesh) -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend((mesh.triangles.len() as u32).to_le_bytes());
    for corners in &mesh.triangles {
        // A normal of zero: many programs write none.
        bytes.extend([0; 12]);
        for value in corners.iter().flat_map(|corner| mesh.positions[*corner as usize]) {
            bytes.extend((value as f32).to_le_bytes());
        }
        bytes.extend([0; 2]);
    }
    bytes
}

/// ASCII STL.
pub fn stl_ascii(mesh: &RawMesh) -> Vec<u8> {
    let mut text = String::from("solid by hand\n");
    for corners in &mesh.triangles {
        text.push_str("  facet normal 0 0 1\n    outer loop\n");
        for corner in corners {
            let [x, y, z] = mesh.positions[*corner as usize];
            let _ = writeln!(text, "      vertex {x:e} {y:e} {z:e}");
        }
        text.push_str("    endloop\n  endfacet\n");
    }
    text.push_str("endsolid by hand\n");
    text.into_bytes()
}

/// The buffer of a glTF asset: positions in single precision, then vertex numbers of so many bytes each.
pub fn gltf_buffer(mesh: &RawMesh, index_bytes: usize) -> Vec<u8> {
    let mut bytes: Vec<u8> = mesh.positions.iter().flatten().flat_map(|value| (*value as f32).to_le_bytes()).collect();
    for corner in mesh.triangles.iter().flatten() {
        bytes.extend(&corner.to_le_bytes()[..index_bytes]);
    }
    bytes
}

fn gltf_document(mesh: &RawMesh, index_bytes: usize, uri: Option<String>) -> Value {
    let (positions, corners) = (12 * mesh.positions.len(), 3 * mesh.triangles.len());
    let bound = |pick: fn(f64, f64) -> f64| {
        let pick_all = |a: [f64; 3], b: &[f64; 3]| std::array::from_fn(|axis| pick(a[axis], b[axis]));
        mesh.positions.iter().fold(mesh.positions[0], pick_all)
    };
    let mut buffer = json!({ "byteLength": positions + index_bytes * corners });
    if let Some(uri) = uri {
        buffer["uri"] = uri.into();
    }
    let component = match index_bytes {
        1 => 5121,
        2 => 5123,
        _ => 5125,
    };
    json!({
        "asset": { "version": "2.0", "generator": "by hand" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "mode": 4 }] }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": mesh.positions.len(), "type": "VEC3",
              "min": bound(f64::min), "max": bound(f64::max) },
            { "bufferView": 1, "componentType": component, "count": corners, "type": "SCALAR" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": positions },
            { "buffer": 0, "byteOffset": positions, "byteLength": index_bytes * corners },
        ],
        "buffers": [buffer],
    })
}

/// The `.gltf` document of an asset whose buffer, [`gltf_buffer`], is in the file `buffer`.
pub fn gltf(mesh: &RawMesh, index_bytes: usize, buffer: &str) -> Vec<u8> {
    gltf_document(mesh, index_bytes, Some(buffer.to_owned())).to_string().into_bytes()
}

/// A `.gltf` document with its buffer inside, as a data URI.
pub fn gltf_in_one(mesh: &RawMesh, index_bytes: usize) -> Vec<u8> {
    let data = base64(&gltf_buffer(mesh, index_bytes));
    gltf(mesh, index_bytes, &format!("data:application/octet-stream;base64,{data}"))
}

/// Binary glTF.
pub fn glb(mesh: &RawMesh, index_bytes: usize) -> Vec<u8> {
    let mut document = gltf_document(mesh, index_bytes, None).to_string().into_bytes();
    document.resize(document.len().next_multiple_of(4), b' ');
    let mut buffer = gltf_buffer(mesh, index_bytes);
    buffer.resize(buffer.len().next_multiple_of(4), 0);
    let mut bytes = b"glTF".to_vec();
    let word = |bytes: &mut Vec<u8>, value: usize| bytes.extend((value as u32).to_le_bytes());
    word(&mut bytes, 2);
    word(&mut bytes, 12 + 8 + document.len() + 8 + buffer.len());
    for (kind, chunk) in [(b"JSON", document), (b"BIN\0", buffer)] {
        word(&mut bytes, chunk.len());
        bytes.extend(kind);
        bytes.extend(chunk);
    }
    bytes
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for group in bytes.chunks(3) {
        let byte = |place: usize| u32::from(group.get(place).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for place in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * place) & 63) as usize];
            text.push(if place > group.len() { '=' } else { char::from(digit) });
        }
    }
    text
}

/// Reads a binary little-endian PLY file of triangles: floats or doubles `x y z`, then `list uchar int` of corners.
pub fn read_ply(bytes: &[u8]) -> RawMesh {
    const END: &[u8] = b"end_header\n";
    let body = bytes.windows(END.len()).position(|window| window == END).expect("end_header") + END.len();
    let header = std::str::from_utf8(&bytes[..body]).unwrap();
    let lines: Vec<&str> = header.lines().filter(|line| !line.starts_with("comment ")).collect();
    assert_eq!(lines[..2], ["ply", "format binary_little_endian 1.0"]);
    let count = |line: &str, element: &str| -> usize {
        line.strip_prefix(element).unwrap_or_else(|| panic!("{element}: {line}")).parse().unwrap()
    };
    let (vertices, faces) = (count(lines[2], "element vertex "), count(lines[6], "element face "));
    let kind = if lines[3].contains("float") { "float" } else { "double" };
    assert_eq!(lines[3..6], ["x", "y", "z"].map(|axis| format!("property {kind} {axis}")));
    assert_eq!(lines[7..], ["property list uchar int vertex_indices", "end_header"]);

    let mut rest = &bytes[body..];
    let coordinate = |rest: &mut &[u8]| -> f64 {
        if kind == "float" { f32::from_le_bytes(take(rest)).into() } else { f64::from_le_bytes(take(rest)) }
    };
    let positions = (0..vertices).map(|_| [0; 3].map(|_| coordinate(&mut rest))).collect();
    let triangles = (0..faces)
        .map(|_| {
            assert_eq!(take(&mut rest), [3]);
            [0; 3].map(|_| u32::from_le_bytes(take(&mut rest)))
        })
        .collect();
    assert!(rest.is_empty(), "{} bytes behind the last face", rest.len());
    let mesh = RawMesh { positions, triangles };
    assert!(mesh.triangles.iter().flatten().all(|corner| (*corner as usize) < vertices));
    mesh
}

fn take<const BYTES: usize>(rest: &mut &[u8]) -> [u8; BYTES] {
    let (bytes, behind) = rest.split_first_chunk().expect("the file ends early");
    *rest = behind;
    *bytes
}

/// A triangle by the bits of its corners' coordinates, the smallest corner first.
pub type PlacedTriangle = [[u64; 3]; 3];

/// The set of a mesh's triangles over positions, in their orientation: what a surface is, whatever the order of vertices
/// and triangles. Bitwise equal positions are one (0 and -0 too); triangles with two equal corners are none.
pub fn surface(mesh: &RawMesh) -> BTreeSet<PlacedTriangle> {
    let place = |corner: u32| mesh.positions[corner as usize].map(|value| (value + 0.0).to_bits());
    let triangles = mesh.triangles.iter().map(|corners| smallest_first(corners.map(place)));
    triangles.filter(|[a, b, c]| a != b && b != c && c != a).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random_mesh::closed_box;

    #[test]
    fn the_reader_reads_what_the_writer_writes() {
        let mesh = closed_box();
        for coordinates in [Coordinates::Float, Coordinates::Double] {
            let read = read_ply(&ply(&mesh, Encoding::LittleEndian, coordinates));
            assert_eq!((read.positions, read.triangles), (mesh.positions.clone(), mesh.triangles.clone()));
        }
    }

    #[test]
    fn a_surface_knows_no_order_but_orientation() {
        let mesh = closed_box();
        assert_eq!(surface(&mesh).len(), 12);
        assert_eq!(surface(&mesh), surface(&mesh.shuffled(7)));
        let mut turned = mesh.clone();
        turned.triangles[3].swap(0, 1);
        assert_ne!(surface(&mesh), surface(&turned));
    }

    #[test]
    fn base64_as_in_its_specification() {
        for (text, code) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(text.as_bytes()), code);
        }
    }
}
