//! The gate in front of every format reader: [`read_mesh`] finds the format, and judges all formats alike.
//!
//! Constant memory: a face may name a vertex that is still to come, so the largest vertex number seen and the face
//! that named it are remembered, and judged at the end of the file.

use std::path::Path;

use storage::Disk;

use super::{Face, MeshError, MeshFormat, MeshSink, ReadSummary, TriangleSink, Vertex, off, reader_of, stl, text};

/// Reads the mesh file `path` of any known format, and pushes its vertices and triangles into `sink` in file order.
///
/// The format is told by the file's first bytes; where they do not decide (OBJ, STL), by the file's extension.
///
/// # Errors
///
/// The disk's, the format's, those of [`MeshError::NotFinite`] and [`MeshError::CornerOutOfRange`], and whatever the
/// sink refuses. What was pushed before an error is to be thrown away.
pub fn read_mesh(disk: &dyn Disk, path: &Path, sink: &mut dyn TriangleSink) -> Result<ReadSummary, MeshError> {
    let format = detect_format(disk, path)?;
    let summary =
        ReadSummary { format, vertices: 0, faces: 0, triangles: 0, polygons: 0, degenerate_faces: 0, left_out: 0 };
    let mut gate = Gate { path, sink, summary, highest: None };
    reader_of(format)(disk, path, &mut gate)?;
    gate.finish()
}

/// Tells the format of a file by its first bytes, and where they do not decide by its extension.
///
/// A byte order mark, and comments in front of the first word, are stepped over.
///
/// # Errors
///
/// The disk's, [`MeshError::Empty`], and [`MeshError::UnknownFormat`].
pub fn detect_format(disk: &dyn Disk, path: &Path) -> Result<MeshFormat, MeshError> {
    let file = disk.open(path)?;
    let mut start = [0; 4096];
    let count = file.read_at(0, &mut start)?;
    let start = &start[..count];
    if start.is_empty() {
        return Err(MeshError::Empty { path: path.to_path_buf() });
    }
    let extension = path.extension().map(|text| text.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    // The header of a binary STL may say anything. Its size is no accident, and less so where the name agrees.
    let binary_stl = stl::has_binary_size(file.as_ref())?;
    if binary_stl && extension == "stl" {
        return Ok(MeshFormat::Stl);
    }
    let word = first_word(start);
    if word == b"ply" {
        Ok(MeshFormat::Ply)
    } else if start.starts_with(b"glTF") || word.starts_with(b"{") {
        Ok(MeshFormat::Gltf)
    } else if off::HeaderWord::parse(word).is_some() {
        Ok(MeshFormat::Off)
    } else {
        match extension.as_str() {
            "obj" => Ok(MeshFormat::Obj),
            "stl" => Ok(MeshFormat::Stl),
            _ if binary_stl || stl::looks_like_text(file.as_ref())? => Ok(MeshFormat::Stl),
            _ if [b"v".as_slice(), b"vt", b"vn", b"mtllib"].contains(&word) => Ok(MeshFormat::Obj),
            // The others begin with their magic, or they are something else under a wrong name.
            _ => Err(MeshError::UnknownFormat { path: path.to_path_buf() }),
        }
    }
}

/// The first word of a text that is not part of a comment.
fn first_word(start: &[u8]) -> &[u8] {
    let text = start.strip_prefix(text::BYTE_ORDER_MARK).unwrap_or(start);
    let lines = text.split(|&byte| byte == b'\n' || byte == b'\r').map(|line| line.trim_ascii_start());
    let line = lines.into_iter().find(|line| !line.is_empty() && !line.starts_with(b"#")).unwrap_or_default();
    line.split(|byte| byte.is_ascii_whitespace()).next().unwrap_or_default()
}

/// The largest vertex number named so far, and by whom.
#[derive(Debug, Clone, Copy)]
struct HighestCorner {
    index: i64,
    face: u64,
    corner: usize,
}

struct Gate<'a> {
    path: &'a Path,
    sink: &'a mut dyn TriangleSink,
    summary: ReadSummary,
    highest: Option<HighestCorner>,
}

impl Gate<'_> {
    fn out_of_range(&self, bad: HighestCorner) -> MeshError {
        MeshError::CornerOutOfRange {
            path: self.path.to_path_buf(),
            face: bad.face,
            corner: bad.corner,
            index: bad.index,
            vertices: self.summary.vertices,
        }
    }

    fn finish(self) -> Result<ReadSummary, MeshError> {
        match self.highest {
            Some(highest) if highest.index.unsigned_abs() >= self.summary.vertices => Err(self.out_of_range(highest)),
            _ => Ok(self.summary),
        }
    }
}

impl MeshSink for Gate<'_> {
    fn announce(&mut self, vertices: u64, faces: u64) -> Result<(), MeshError> {
        self.sink.announce(vertices, faces)
    }

    fn vertex(&mut self, vertex: Vertex) -> Result<(), MeshError> {
        for (axis, value) in ['x', 'y', 'z'].into_iter().zip(vertex.position) {
            if !value.is_finite() {
                let (path, index) = (self.path.to_path_buf(), self.summary.vertices);
                return Err(MeshError::NotFinite { path, index, axis, value });
            }
        }
        self.summary.vertices += 1;
        self.sink.vertex(vertex.position)
    }

    fn face(&mut self, face: Face<'_>) -> Result<(), MeshError> {
        let number = self.summary.faces;
        for (corner, &index) in face.corners.iter().enumerate() {
            let named = HighestCorner { index, face: number, corner };
            if index < 0 {
                return Err(self.out_of_range(named));
            }
            if self.highest.is_none_or(|highest| highest.index < index) {
                self.highest = Some(named);
            }
        }
        self.summary.faces += 1;
        match face.corners {
            [first, rest @ ..] if rest.len() >= 2 => {
                self.summary.polygons += u64::from(rest.len() > 2);
                for pair in rest.windows(2) {
                    self.summary.triangles += 1;
                    self.sink.triangle([first, &pair[0], &pair[1]].map(|index| index.unsigned_abs()))?;
                }
            }
            _ => self.summary.degenerate_faces += 1,
        }
        Ok(())
    }

    fn left_out(&mut self, elements: u64) {
        self.summary.left_out += elements;
    }
}

#[cfg(test)]
mod tests {
    use storage::MemoryDisk;

    use super::*;

    fn format_of(path: &str, bytes: impl AsRef<[u8]>) -> Result<MeshFormat, MeshError> {
        let disk = MemoryDisk::new();
        disk.insert(path, bytes.as_ref());
        detect_format(&disk, Path::new(path))
    }

    /// A binary STL of no facets, whose header begins with `word`.
    fn binary_stl(word: &str) -> Vec<u8> {
        let mut bytes = word.as_bytes().to_vec();
        bytes.resize(84, 0);
        bytes
    }

    #[test]
    fn the_first_bytes_tell_the_format_whatever_the_name() {
        for (bytes, expected) in [
            ("ply\nformat ascii 1.0\n", MeshFormat::Ply),
            ("ply\r\n", MeshFormat::Ply),
            ("\u{feff}ply\r", MeshFormat::Ply),
            ("OFF 8 6 12", MeshFormat::Off),
            ("# made by hand\n\n# in two lines\nSTCNOFF\n", MeshFormat::Off),
            ("glTF\u{2}", MeshFormat::Gltf),
            ("\n {\"asset\": {}}", MeshFormat::Gltf),
            ("\u{feff}{", MeshFormat::Gltf),
        ] {
            for path in ["a", "a.ply", "a.obj", "a.stl", "a.glb", "a.txt"] {
                assert_eq!(format_of(path, bytes).unwrap(), expected, "{path}: {bytes}");
            }
        }
    }

    #[test]
    fn stl_and_obj_are_known_by_their_names_and_by_more_than_one_word_without_one() {
        for path in ["a.stl", "a.STL"] {
            for bytes in [b"anything".as_slice(), &binary_stl("ply\n"), &binary_stl("solid")] {
                assert_eq!(format_of(path, bytes).unwrap(), MeshFormat::Stl);
            }
        }
        for bytes in [binary_stl("COLOR="), binary_stl("solid"), b"  Solid a\nfacet".to_vec()] {
            assert_eq!(format_of("a.bin", bytes).unwrap(), MeshFormat::Stl);
        }
        assert_eq!(format_of("a.Obj", "anything").unwrap(), MeshFormat::Obj);
        assert_eq!(format_of("a", "# made by hand\nmtllib a.mtl\n").unwrap(), MeshFormat::Obj);
        assert_eq!(format_of("a.txt", "v 1 2 3\n").unwrap(), MeshFormat::Obj);
    }

    #[test]
    fn what_is_no_mesh_is_refused() {
        assert!(matches!(format_of("a.ply", ""), Err(MeshError::Empty { .. })));
        for (path, bytes) in
            [("a.ply", "plywood"), ("a", "hello"), ("a.off", "8 6 12"), ("a.gltf", "<xml>"), ("a", "\n#")]
        {
            assert!(matches!(format_of(path, bytes), Err(MeshError::UnknownFormat { .. })), "{path}");
        }
    }
}
