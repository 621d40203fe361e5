//! The first phase of [`super::store`]: the mesh files, once, into sequences of vertices and triangles.
//!
//! On the way: the box of all vertices, and the marks of those that faces name. A vertex is known by its number in all
//! files together, which must fit in 32 bits.
//!
//! I/O: what the files hold is written once, 12 bytes a vertex (24 in double precision) and 12 a triangle; with attributes
//! more, as module `file_attributes` says.

use std::path::{Path, PathBuf};

use storage::{Disk, Scratch};

use super::corners::{Chunk, WaitingWriter};
use super::file_attributes::{AttributeWriter, FileAttributes, TriangleLooks};
use super::frame::Bounds;
use super::limits::Limits;
use super::marks::{MarkWindow, Marks};
use super::progress::Progress;
use super::vertices::{VertexSpool, VertexWriter};
use super::{CleaningCounts, FileCounts};
use crate::mesh::{MeshError, ReadSummary, TriangleAttributes, TriangleSink, VertexAttributes, read_mesh};

/// The most vertices, and the most triangles, that files may hold: numbers are 32 bits, and one means "none".
pub(super) const MOST_ELEMENTS: u64 = u32::MAX as u64 - 1;

/// Which vertices come from which file.
#[derive(Debug)]
pub(super) struct FileList {
    /// The files, each with the number of its first vertex.
    files: Vec<(PathBuf, u64)>,
}

impl FileList {
    pub fn new() -> Self {
        FileList { files: Vec::new() }
    }

    /// The next file begins with vertex number `first_vertex` of all files together.
    pub fn begin(&mut self, path: &Path, first_vertex: u64) {
        self.files.push((path.to_path_buf(), first_vertex));
    }

    /// The error that there is no lattice of so many bits over a mesh of this extent.
    pub fn no_lattice(&self, bits: u8, extent: f64) -> MeshError {
        let path = self.files.first().map(|(path, _)| path.clone()).unwrap_or_default();
        MeshError::Lattice { path, bits, extent }
    }

    /// The error that there are more corners than numbers, where they become vertices.
    pub fn too_many_corners(&self) -> MeshError {
        let path = self.files.first().map(|(path, _)| path.clone()).unwrap_or_default();
        MeshError::TooMany { path, kind: "corners with attributes of their own", most: MOST_ELEMENTS }
    }

    /// The error that a vertex is too large for single precision.
    pub fn too_large(&self, vertex: u64) -> MeshError {
        let begun = self.files.partition_point(|(_, first)| *first <= vertex);
        let (path, first) = self.files[..begun].last().cloned().unwrap_or_default();
        let place = format!("vertex {}", vertex - first);
        MeshError::malformed(&path, place, "the coordinates are too large for single precision")
    }
}

/// What the files held.
#[derive(Debug)]
pub(super) struct FilesRead {
    pub list: FileList,
    pub counts: FileCounts,
    /// Polygons, faces and elements that were changed or left out by the readers.
    pub cleaning: CleaningCounts,
    pub vertices: VertexSpool,
    /// The triangles, by numbers of vertices in the files.
    pub triangles: Vec<Chunk>,
    /// The box of all vertices, also of those that no face names.
    pub bounds: Bounds,
    /// The vertices that faces name.
    pub named: Marks,
    /// The attributes, where there are any and they are wanted.
    pub attributes: Option<FileAttributes>,
    /// What the files name and is not there.
    pub missing_files: Vec<PathBuf>,
}

impl FilesRead {
    /// Whether corners have attributes of their own, and become vertices.
    pub fn has_corner_attributes(&self) -> bool {
        self.attributes.as_ref().is_some_and(|attributes| matches!(attributes.triangles, TriangleLooks::Each(_)))
    }
}

/// Reads all files, with their attributes if they are wanted.
pub(super) fn read(
    disk: &dyn Disk,
    scratch: &Scratch,
    paths: &[PathBuf],
    attributes: bool,
    limits: &Limits,
    progress: &mut Progress<'_>,
) -> Result<FilesRead, MeshError> {
    let lengths = paths.iter().map(|path| Ok(disk.open(path)?.length())).collect::<Result<Vec<u64>, MeshError>>()?;
    let all_bytes = lengths.iter().sum::<u64>().max(1) as f64;
    let mut sink = FileSink {
        path: PathBuf::new(),
        first_vertex: 0,
        counts: FileCounts::default(),
        vertices: VertexWriter::new(scratch, limits),
        triangles: WaitingWriter::new(scratch, limits.memory / 4, limits.triangle_chunk, 0),
        bounds: Bounds::EMPTY,
        named: MarkWindow::new(limits.memory / 8),
        attributes: attributes.then(|| AttributeWriter::new(scratch, limits.memory)),
        promised: 0,
        elements: 0,
        progress,
        before: 0.0,
        share: 0.0,
    };
    let mut list = FileList::new();
    let mut cleaning = CleaningCounts::default();
    for (path, length) in paths.iter().zip(lengths) {
        list.begin(path, sink.counts.vertices);
        sink.path.clone_from(path);
        sink.first_vertex = sink.counts.vertices;
        (sink.promised, sink.elements) = (0, 0);
        sink.before += sink.share;
        sink.share = length as f64 / all_bytes;
        sink.attributes.as_mut().into_iter().for_each(AttributeWriter::begin_file);
        let ReadSummary { polygons, degenerate_faces, left_out, attributes, .. } = read_mesh(disk, path, &mut sink)?;
        if let Some(writer) = &mut sink.attributes {
            writer.end_file(attributes);
        }
        cleaning.polygons += polygons;
        cleaning.degenerate_faces += degenerate_faces;
        cleaning.skipped_elements += left_out;
    }
    let FileSink { counts, vertices, triangles, bounds, named, attributes, .. } = sink;
    let vertices = vertices.finish()?;
    let triangles = triangles.finish()?;
    let named = named.complete(counts.vertices, scratch, "named-vertices", limits.memory / 16, |window| {
        Chunk::for_each(&triangles, limits.buffer(), |corners| {
            corners.iter().for_each(|corner| window.mark(u64::from(*corner)));
            Ok::<_, MeshError>(())
        })
    })?;
    let (attributes, missing_files) = match attributes {
        None => (None, Vec::new()),
        Some(writer) => writer.finish(counts.triangles)?,
    };
    Ok(FilesRead { list, counts, cleaning, vertices, triangles, bounds, named, attributes, missing_files })
}

/// Takes what the reader of a file finds.
struct FileSink<'a, 'b> {
    path: PathBuf,
    /// Vertices of the files before this one.
    first_vertex: u64,
    counts: FileCounts,
    vertices: VertexWriter,
    triangles: WaitingWriter,
    bounds: Bounds,
    named: MarkWindow,
    attributes: Option<AttributeWriter>,
    /// Vertices and faces that the file's header promises, and those that were found so far.
    promised: u64,
    elements: u64,
    progress: &'a mut Progress<'b>,
    /// Shares of the files before this one, and of this one, in all bytes.
    before: f64,
    share: f64,
}

impl FileSink<'_, '_> {
    #[inline]
    fn count_element(&mut self, count_before: u64, kind: &'static str) -> Result<(), MeshError> {
        self.elements += 1;
        if self.elements.is_multiple_of(Progress::STRIDE) && self.promised > 0 {
            let done = (self.elements as f64 / self.promised as f64).min(1.0);
            self.progress.set(self.before + self.share * done);
        }
        if count_before < MOST_ELEMENTS {
            return Ok(());
        }
        Err(MeshError::TooMany { path: self.path.clone(), kind, most: MOST_ELEMENTS })
    }
}

impl TriangleSink for FileSink<'_, '_> {
    fn announce(&mut self, vertices: u64, faces: u64) -> Result<(), MeshError> {
        self.promised = vertices.saturating_add(faces);
        Ok(())
    }

    #[inline]
    fn vertex(&mut self, position: [f64; 3]) -> Result<(), MeshError> {
        self.count_element(self.counts.vertices, "vertices")?;
        self.counts.vertices += 1;
        self.bounds.include(position);
        Ok(self.vertices.push(position)?)
    }

    #[inline]
    fn triangle(&mut self, corners: [u64; 3]) -> Result<(), MeshError> {
        self.count_element(self.counts.triangles, "triangles")?;
        self.counts.triangles += 1;
        // A vertex beyond 32 bits is not there, or is refused when it comes: until then any number beyond will do.
        let corners = corners.map(|corner| u32::try_from(corner.saturating_add(self.first_vertex)).unwrap_or(u32::MAX));
        corners.iter().for_each(|corner| self.named.mark(u64::from(*corner)));
        Ok(self.triangles.push(corners)?)
    }

    fn wants_attributes(&self) -> bool {
        self.attributes.is_some()
    }

    fn vertex_attributes(&mut self, attributes: VertexAttributes) -> Result<(), MeshError> {
        let number = self.counts.vertices - 1;
        self.attributes.as_mut().map_or(Ok(()), |writer| Ok(writer.vertex(number, attributes)?))
    }

    fn triangle_attributes(&mut self, attributes: TriangleAttributes) -> Result<(), MeshError> {
        let number = self.counts.triangles - 1;
        self.attributes.as_mut().map_or(Ok(()), |writer| Ok(writer.triangle(number, &attributes)?))
    }

    fn texture_coordinate(&mut self, value: [f32; 2]) -> Result<(), MeshError> {
        self.attributes.as_mut().map_or(Ok(()), |writer| writer.texture(value, &self.path))
    }

    fn normal(&mut self, value: [f32; 3]) -> Result<(), MeshError> {
        self.attributes.as_mut().map_or(Ok(()), |writer| writer.normal(value, &self.path))
    }
}
