//! Writes binary little-endian PLY, streaming: first all vertices, then all triangles.
//!
//! The header comes first in the file, so the numbers of both are promised beforehand ([`PlyLayout`]) and held to.
//! The file appears under its name whole or not at all ([`AtomicFile`]): a [`PlyWriter`] that is dropped before
//! [`PlyWriter::finish`] leaves whatever was there before.
//!
//! Memory: one write buffer.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use storage::{AtomicFile, Disk};

use super::MeshError;

/// Vertex numbers are written in 32 bits, so there can be this many of them.
const MOST_VERTICES: u64 = 1 << 32;

/// How coordinates are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CoordinateType {
    /// In 32 bits. Values are rounded to the nearest.
    Float,
    /// In 64 bits, exactly as they are handed over.
    Double,
}

/// What the header of a PLY file says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlyLayout {
    /// How many vertices will be written.
    pub vertices: u64,
    /// How many triangles will be written.
    pub triangles: u64,
    /// How the coordinates of the vertices are written.
    pub coordinates: CoordinateType,
    /// Lines for the reader of the header, one for each comment.
    pub comments: Vec<String>,
}

/// A PLY file on its way to its name.
#[derive(Debug)]
pub struct PlyWriter {
    file: AtomicFile,
    path: PathBuf,
    layout: PlyLayout,
    vertices_written: u64,
    triangles_written: u64,
}

impl PlyWriter {
    /// Begins the file `path` and writes its header.
    ///
    /// # Errors
    ///
    /// The disk's, and [`MeshError::Unwritable`] for more vertices than 32 bits can number and for comments that
    /// are not one line of text.
    pub fn create(disk: Arc<dyn Disk>, path: &Path, layout: PlyLayout) -> Result<Self, MeshError> {
        let unwritable = |problem: String| MeshError::Unwritable {
            path: path.to_path_buf(),
            element: "the header".to_string(),
            problem,
        };
        if layout.vertices > MOST_VERTICES {
            return Err(unwritable(format!(
                "{} vertices are more than the {MOST_VERTICES} that PLY can number in 32 bits",
                layout.vertices
            )));
        }
        if let Some(comment) = layout.comments.iter().find(|comment| comment.contains(char::is_control)) {
            return Err(unwritable(format!("the comment {comment:?} is not one line of plain text")));
        }
        let mut file = AtomicFile::create(disk, path)?;
        file.append(header(&layout).as_bytes())?;
        Ok(PlyWriter { file, path: path.to_path_buf(), layout, vertices_written: 0, triangles_written: 0 })
    }

    /// Writes the next vertex.
    ///
    /// # Errors
    ///
    /// The disk's, [`MeshError::NotFinite`] for a coordinate that is not a finite number as it is written, and
    /// [`MeshError::Unwritable`] for a vertex after the first triangle or beyond the promised number.
    pub fn vertex(&mut self, position: [f64; 3]) -> Result<(), MeshError> {
        if self.triangles_written > 0 {
            let problem = "all vertices come before the first triangle";
            return Err(self.unwritable(format!("vertex {}", self.vertices_written), problem));
        }
        if self.vertices_written == self.layout.vertices {
            let problem = format!("the header promises {} vertices", self.layout.vertices);
            return Err(self.unwritable(format!("vertex {}", self.vertices_written), problem));
        }
        match self.layout.coordinates {
            CoordinateType::Float => {
                let rounded = position.map(|coordinate| coordinate as f32);
                self.check_finite(position, rounded.map(f32::is_finite))?;
                let mut bytes = [0; 12];
                for (place, coordinate) in bytes.chunks_exact_mut(4).zip(rounded) {
                    place.copy_from_slice(&coordinate.to_le_bytes());
                }
                self.file.append(&bytes)?;
            }
            CoordinateType::Double => {
                self.check_finite(position, position.map(f64::is_finite))?;
                let mut bytes = [0; 24];
                for (place, coordinate) in bytes.chunks_exact_mut(8).zip(position) {
                    place.copy_from_slice(&coordinate.to_le_bytes());
                }
                self.file.append(&bytes)?;
            }
        }
        self.vertices_written += 1;
        Ok(())
    }

    /// Writes the next triangle. Its corners are vertex numbers, counted from 0 in the order of writing.
    ///
    /// # Errors
    ///
    /// The disk's, [`MeshError::CornerOutOfRange`] for a corner that is no vertex of this file, and
    /// [`MeshError::Unwritable`] for a triangle before the last vertex or beyond the promised number.
    pub fn triangle(&mut self, corners: [u64; 3]) -> Result<(), MeshError> {
        if self.vertices_written < self.layout.vertices {
            let (written, promised) = (self.vertices_written, self.layout.vertices);
            let problem = format!("only {written} of the {promised} vertices before it are written");
            return Err(self.unwritable(format!("triangle {}", self.triangles_written), problem));
        }
        if self.triangles_written == self.layout.triangles {
            let problem = format!("the header promises {} triangles", self.layout.triangles);
            return Err(self.unwritable(format!("triangle {}", self.triangles_written), problem));
        }
        let mut bytes = [3; 13];
        for (corner, (place, index)) in bytes[1..].chunks_exact_mut(4).zip(corners).enumerate() {
            if index >= self.layout.vertices {
                return Err(MeshError::CornerOutOfRange {
                    path: self.path.clone(),
                    face: self.triangles_written,
                    corner,
                    index: i64::try_from(index).unwrap_or(i64::MAX),
                    vertices: self.layout.vertices,
                });
            }
            // Fits: there are at most 2^32 vertices. Below 2^31 the bytes of `int` and `uint` are the same.
            place.copy_from_slice(&(index as u32).to_le_bytes());
        }
        self.file.append(&bytes)?;
        self.triangles_written += 1;
        Ok(())
    }

    /// Flushes everything to the device, gives the file its name, and tells its length in bytes.
    ///
    /// # Errors
    ///
    /// The disk's, and [`MeshError::Unwritable`] where fewer elements were written than promised.
    pub fn finish(self) -> Result<u64, MeshError> {
        let vertices = (self.vertices_written, self.layout.vertices, "vertices");
        let triangles = (self.triangles_written, self.layout.triangles, "triangles");
        for (written, promised, name) in [vertices, triangles] {
            if written < promised {
                let problem = format!("only {written} of the {promised} {name} that the header promises are written");
                return Err(self.unwritable("the end of the file", problem));
            }
        }
        let length = self.file.length();
        self.file.commit()?;
        Ok(length)
    }

    fn check_finite(&self, position: [f64; 3], finite: [bool; 3]) -> Result<(), MeshError> {
        match (0..3).find(|&axis| !finite[axis]) {
            None => Ok(()),
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

fn header(layout: &PlyLayout) -> String {
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
    let _ = writeln!(text, "element vertex {}", layout.vertices);
    for axis in ["x", "y", "z"] {
        let _ = writeln!(text, "property {coordinate} {axis}");
    }
    let _ = writeln!(text, "element face {}", layout.triangles);
    let _ = writeln!(text, "property list uchar {index} vertex_indices");
    text.push_str("end_header\n");
    text
}

#[cfg(test)]
mod tests {
    use storage::{FaultyDisk, MemoryDisk};

    use super::*;

    fn layout(vertices: u64, triangles: u64) -> PlyLayout {
        PlyLayout { vertices, triangles, coordinates: CoordinateType::Float, comments: Vec::new() }
    }

    fn writer(memory: &MemoryDisk, layout: PlyLayout) -> Result<PlyWriter, MeshError> {
        PlyWriter::create(Arc::new(memory.clone()), Path::new("mesh.ply"), layout)
    }

    #[test]
    fn one_triangle_byte_for_byte() {
        for (coordinates, name) in [(CoordinateType::Float, "float"), (CoordinateType::Double, "double")] {
            let memory = MemoryDisk::new();
            let layout = PlyLayout { coordinates, comments: vec!["made by hand".to_string()], ..layout(3, 1) };
            let mut writer = writer(&memory, layout).unwrap();
            let positions = [[0.0, 0.5, -1.0], [1.0, 0.1, 0.0], [0.0, 1.0, 2.5]];
            positions.iter().for_each(|&position| writer.vertex(position).unwrap());
            writer.triangle([2, 0, 1]).unwrap();
            let length = writer.finish().unwrap();

            let mut expected = format!(
                "ply\nformat binary_little_endian 1.0\ncomment made by hand\nelement vertex 3\n\
                 property {name} x\nproperty {name} y\nproperty {name} z\n\
                 element face 1\nproperty list uchar int vertex_indices\nend_header\n"
            )
            .into_bytes();
            for coordinate in positions.into_iter().flatten() {
                match coordinates {
                    CoordinateType::Float => expected.extend((coordinate as f32).to_le_bytes()),
                    CoordinateType::Double => expected.extend(coordinate.to_le_bytes()),
                }
            }
            expected.extend([3, 2, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]);
            assert_eq!(memory.bytes("mesh.ply").unwrap(), expected);
            assert_eq!(length, expected.len() as u64);
        }
    }

    #[test]
    fn vertex_numbers_are_signed_while_they_fit() {
        assert!(header(&layout(1 << 31, 1)).contains("uchar int "));
        assert!(header(&layout((1 << 31) + 1, 1)).contains("uchar uint "));
        let memory = MemoryDisk::new();
        assert!(writer(&memory, layout(1 << 32, 1)).is_ok());
        let message = writer(&memory, layout((1 << 32) + 1, 1)).unwrap_err().to_string();
        assert!(message.contains("4294967297 vertices are more than"), "{message}");
    }

    #[test]
    fn a_comment_is_one_line() {
        let layout = PlyLayout { comments: vec!["two\nlines".to_string()], ..layout(0, 0) };
        let message = writer(&MemoryDisk::new(), layout).unwrap_err().to_string();
        assert!(message.contains("is not one line"), "{message}");
    }

    #[test]
    fn the_header_is_held_to() {
        let memory = MemoryDisk::new();
        let mut writer = writer(&memory, layout(2, 1)).unwrap();
        writer.vertex([0.0; 3]).unwrap();
        let early = writer.triangle([0, 0, 0]).unwrap_err().to_string();
        assert_eq!(early, "mesh.ply: cannot write triangle 0: only 1 of the 2 vertices before it are written");
        writer.vertex([1.0; 3]).unwrap();
        let many = writer.vertex([2.0; 3]).unwrap_err().to_string();
        assert_eq!(many, "mesh.ply: cannot write vertex 2: the header promises 2 vertices");
        let range = writer.triangle([0, 1, 2]).unwrap_err();
        assert!(matches!(range, MeshError::CornerOutOfRange { face: 0, corner: 2, index: 2, vertices: 2, .. }));
        writer.triangle([0, 1, 0]).unwrap();
        let late = writer.vertex([2.0; 3]).unwrap_err().to_string();
        assert_eq!(late, "mesh.ply: cannot write vertex 2: all vertices come before the first triangle");
        let many = writer.triangle([0, 1, 0]).unwrap_err().to_string();
        assert_eq!(many, "mesh.ply: cannot write triangle 1: the header promises 1 triangles");
        writer.finish().unwrap();
        assert_eq!(memory.paths().len(), 1);
    }

    #[test]
    fn an_unfinished_file_does_not_appear() {
        let memory = MemoryDisk::new();
        let mut few = writer(&memory, layout(2, 0)).unwrap();
        few.vertex([0.0; 3]).unwrap();
        let message = few.finish().unwrap_err().to_string();
        assert!(message.contains("only 1 of the 2 vertices that the header promises"), "{message}");
        let mut few = writer(&memory, layout(1, 1)).unwrap();
        few.vertex([0.0; 3]).unwrap();
        let message = few.finish().unwrap_err().to_string();
        assert!(message.contains("only 0 of the 1 triangles that the header promises"), "{message}");
        assert!(memory.paths().is_empty());
    }

    #[test]
    fn coordinates_are_finite_as_they_are_written() {
        let mut single = writer(&MemoryDisk::new(), layout(1, 0)).unwrap();
        let error = single.vertex([0.0, 1e39, 0.0]).unwrap_err();
        assert!(matches!(error, MeshError::NotFinite { index: 0, axis: 'y', .. }));
        let layout = PlyLayout { coordinates: CoordinateType::Double, ..layout(1, 0) };
        let mut double = writer(&MemoryDisk::new(), layout).unwrap();
        let error = double.vertex([0.0, 1e39, f64::NAN]).unwrap_err();
        assert!(matches!(error, MeshError::NotFinite { index: 0, axis: 'z', .. }));
        double.vertex([0.0, 1e39, 0.0]).unwrap();
    }

    #[test]
    fn a_full_disk_leaves_the_previous_file() {
        let memory = MemoryDisk::new();
        memory.insert("mesh.ply", b"old".to_vec());
        let disk = FaultyDisk::new(Arc::new(memory.clone()));
        disk.full_after(200_000);
        let mut writer = PlyWriter::create(Arc::new(disk), Path::new("mesh.ply"), layout(50_000, 0)).unwrap();
        let result = (0..50_000).try_for_each(|_| writer.vertex([1.0; 3])).and_then(|()| writer.finish());
        let message = result.unwrap_err().to_string();
        assert!(message.contains("cannot write") && message.contains("mesh.ply"), "{message}");
        assert_eq!(memory.bytes("mesh.ply").unwrap(), b"old");
        assert_eq!(memory.paths().len(), 1);
    }
}
