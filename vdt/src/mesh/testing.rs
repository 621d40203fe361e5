//! What the tests of all format readers share: a sink that keeps everything, and ways to feed a reader.

use std::path::{Path, PathBuf};

use proptest::prelude::*;
use storage::MemoryDisk;

use super::{Face, Material, MeshError, MeshSink, Reader, Vertex, Wedges};

/// All that a reader pushed.
#[derive(Debug, Default, Clone, PartialEq)]
pub struct Collected {
    pub announced: Option<(u64, u64)>,
    pub vertices: Vec<[f64; 3]>,
    pub faces: Vec<Vec<i64>>,
    pub left_out: u64,
}

impl MeshSink for Collected {
    fn wants_attributes(&self) -> bool {
        false
    }

    fn announce(&mut self, vertices: u64, faces: u64) -> Result<(), MeshError> {
        assert!(self.announced.is_none() && self.vertices.is_empty() && self.faces.is_empty());
        self.announced = Some((vertices, faces));
        Ok(())
    }

    fn vertex(&mut self, vertex: Vertex) -> Result<(), MeshError> {
        self.vertices.push(vertex.position);
        Ok(())
    }

    fn face(&mut self, face: Face<'_>) -> Result<(), MeshError> {
        self.faces.push(face.corners.to_vec());
        Ok(())
    }

    fn texture_coordinate(&mut self, _: [f32; 2]) -> Result<(), MeshError> {
        panic!("nobody wants texture coordinates");
    }

    fn normal(&mut self, _: [f32; 3]) -> Result<(), MeshError> {
        panic!("nobody wants normals");
    }

    fn material(&mut self, _: Material) -> Result<(), MeshError> {
        panic!("nobody wants materials");
    }

    fn missing_file(&mut self, _: PathBuf) -> Result<(), MeshError> {
        panic!("nobody wants other files");
    }

    fn left_out(&mut self, elements: u64) {
        self.left_out += elements;
    }
}

/// The attributes of a vertex: normal, colour, texture coordinate.
pub type VertexAttributes = (Option<[f32; 3]>, Option<[u8; 4]>, Option<[f32; 2]>);

/// The values of a face's corners, as they were pushed.
#[derive(Debug, Clone, PartialEq)]
pub enum OwnedWedges<V> {
    None,
    Numbers(Vec<i64>),
    Values(Vec<V>),
}

impl<V: Clone> From<Wedges<'_, V>> for OwnedWedges<V> {
    fn from(wedges: Wedges<'_, V>) -> Self {
        match wedges {
            Wedges::None => OwnedWedges::None,
            Wedges::Numbers(numbers) => OwnedWedges::Numbers(numbers.to_vec()),
            Wedges::Values(values) => OwnedWedges::Values(values.to_vec()),
        }
    }
}

/// The attributes of a face.
#[derive(Debug, Clone, PartialEq)]
pub struct FaceAttributes {
    pub textures: OwnedWedges<[f32; 2]>,
    pub normals: OwnedWedges<[f32; 3]>,
    pub colour: Option<[u8; 4]>,
    pub material: Option<u32>,
}

/// All that a reader pushed to a sink that wants attributes.
#[derive(Debug, Default, Clone, PartialEq)]
pub struct WithAttributes {
    pub plain: Collected,
    pub vertices: Vec<VertexAttributes>,
    pub faces: Vec<FaceAttributes>,
    pub texture_coordinates: Vec<[f32; 2]>,
    pub normals: Vec<[f32; 3]>,
    pub materials: Vec<Material>,
    pub missing_files: Vec<PathBuf>,
}

impl MeshSink for WithAttributes {
    fn wants_attributes(&self) -> bool {
        true
    }

    fn announce(&mut self, vertices: u64, faces: u64) -> Result<(), MeshError> {
        self.plain.announce(vertices, faces)
    }

    fn vertex(&mut self, vertex: Vertex) -> Result<(), MeshError> {
        self.vertices.push((vertex.normal, vertex.colour, vertex.texture));
        self.plain.vertex(vertex)
    }

    fn face(&mut self, face: Face<'_>) -> Result<(), MeshError> {
        let (colour, material) = (face.colour, face.material);
        assert!(material.is_none_or(|material| (material as usize) < self.materials.len()));
        let (textures, normals) = (face.textures.into(), face.normals.into());
        self.faces.push(FaceAttributes { textures, normals, colour, material });
        self.plain.face(face)
    }

    fn texture_coordinate(&mut self, value: [f32; 2]) -> Result<(), MeshError> {
        self.texture_coordinates.push(value);
        Ok(())
    }

    fn normal(&mut self, value: [f32; 3]) -> Result<(), MeshError> {
        self.normals.push(value);
        Ok(())
    }

    fn material(&mut self, material: Material) -> Result<(), MeshError> {
        self.materials.push(material);
        Ok(())
    }

    fn missing_file(&mut self, path: PathBuf) -> Result<(), MeshError> {
        self.missing_files.push(path);
        Ok(())
    }

    fn left_out(&mut self, elements: u64) {
        self.plain.left_out(elements);
    }
}

/// Reads the first of these files, with all others beside it and with what attributes it has. That the vertices and faces
/// are those that are there without is checked.
pub fn read_attributes(reader: Reader, files: &[(&str, &[u8])]) -> Result<WithAttributes, MeshError> {
    let disk = MemoryDisk::new();
    files.iter().for_each(|(name, bytes)| disk.insert(name, *bytes));
    let mut found = WithAttributes::default();
    reader(&disk, Path::new(files[0].0), &mut found)?;
    let mut plain = Collected::default();
    reader(&disk, Path::new(files[0].0), &mut plain)?;
    assert_eq!(format!("{plain:?}"), format!("{:?}", found.plain));
    Ok(found)
}

/// Reads `bytes` as a file called "file".
pub fn read_bytes(reader: Reader, bytes: impl AsRef<[u8]>) -> Result<Collected, MeshError> {
    let disk = MemoryDisk::new();
    disk.insert("file", bytes.as_ref());
    let mut collected = Collected::default();
    reader(&disk, Path::new("file"), &mut collected).map(|()| collected)
}

/// The message with which `reader` refuses `bytes`.
pub fn refusal(reader: Reader, bytes: impl AsRef<[u8]>) -> String {
    match read_bytes(reader, bytes) {
        Ok(found) => panic!("not refused: {found:?}"),
        Err(error) => error.to_string(),
    }
}

/// Reads `bytes` cut at every length, which must not panic, and says at which lengths it was not refused.
pub fn lengths_accepted(reader: Reader, bytes: &[u8]) -> Vec<usize> {
    (0..bytes.len()).for_each(|length| drop(read_attributes(reader, &[("file", &bytes[..length])])));
    (0..bytes.len()).filter(|&length| read_bytes(reader, &bytes[..length]).is_ok()).collect()
}

/// Changes `bytes` at every position in turn, which must not panic.
pub fn survives_altered_bytes(reader: Reader, bytes: &[u8]) {
    for place in 0..bytes.len() {
        for value in [0, 1, 0x7f, 0x80, 0xff, b'-', b' ', b'\n', b'9', bytes[place] ^ 1] {
            let mut altered = bytes.to_vec();
            altered[place] = value;
            let _ = read_attributes(reader, &[("file", &altered)]);
            let _ = read_bytes(reader, altered);
        }
    }
}

/// Small meshes: positions that f32 holds exactly, and polygons of three to six corners.
pub fn meshes() -> impl Strategy<Value = (Vec<[f32; 3]>, Vec<Vec<i64>>)> {
    let coordinate = prop_oneof![
        prop::num::f32::NORMAL | prop::num::f32::ZERO | prop::num::f32::SUBNORMAL,
        (-1000_i16..1000).prop_map(f32::from),
    ];
    prop::collection::vec(prop::array::uniform3(coordinate), 1..20).prop_flat_map(|vertices| {
        let corner = 0..vertices.len() as i64;
        (Just(vertices), prop::collection::vec(prop::collection::vec(corner, 3..7), 0..20))
    })
}

/// The f32 positions as readers hand them on.
pub fn widened(vertices: &[[f32; 3]]) -> Vec<[f64; 3]> {
    vertices.iter().map(|position| position.map(f64::from)).collect()
}
