//! What the tests of all format readers share: a sink that keeps everything, and ways to feed a reader.

use std::path::Path;

use proptest::prelude::*;
use storage::MemoryDisk;

use super::{Face, MeshError, MeshSink, Reader, Vertex};

/// All that a reader pushed.
#[derive(Debug, Default, Clone, PartialEq)]
pub struct Collected {
    pub announced: Option<(u64, u64)>,
    pub vertices: Vec<[f64; 3]>,
    pub faces: Vec<Vec<i64>>,
    pub left_out: u64,
}

impl MeshSink for Collected {
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

    fn left_out(&mut self, elements: u64) {
        self.left_out += elements;
    }
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
    (0..bytes.len()).filter(|&length| read_bytes(reader, &bytes[..length]).is_ok()).collect()
}

/// Changes `bytes` at every position in turn, which must not panic.
pub fn survives_altered_bytes(reader: Reader, bytes: &[u8]) {
    for place in 0..bytes.len() {
        for value in [0, 1, 0x7f, 0x80, 0xff, b'-', b' ', b'\n', b'9', bytes[place] ^ 1] {
            let mut altered = bytes.to_vec();
            altered[place] = value;
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
