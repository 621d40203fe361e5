//! Mesh files into RAM, in canonical form, if they fit; and how much they hold.

use std::path::{Path, PathBuf};

use storage::{ByteSize, Disk};

use super::files::FileList;
use super::{CleaningCounts, CoreMesh, FileCounts, FrameError, PositionsRule, canonical_as};
use crate::mesh::{MeshError, ReadSummary, TriangleSink, read_mesh};

/// Reads mesh files into RAM as one mesh, in canonical form.
///
/// `rule` says how positions are kept, `needs` how much memory a mesh of a given size takes for whatever is to be done with it.
///
/// # Errors
///
/// Those of [`read_mesh`]; [`MeshError::OverMemory`] with the number needed where the mesh does not fit in `memory`:
/// then the rest of the files was still counted, but not kept.
pub fn load(
    disk: &dyn Disk,
    paths: &[PathBuf],
    rule: PositionsRule,
    memory: ByteSize,
    needs: &dyn Fn(FileCounts) -> ByteSize,
) -> Result<(CoreMesh, FileCounts), MeshError> {
    let mut loader = Loader::new(Some(memory), needs);
    for path in paths {
        loader.read(disk, path)?;
    }
    loader.finish(paths, rule)
}

/// Bytes that reading a mesh into canonical form takes at the peak.
pub fn reading_needs(counts: FileCounts) -> ByteSize {
    ByteSize(counts.vertices.saturating_mul(64).saturating_add(counts.triangles.saturating_mul(12)))
}

/// Counts what mesh files hold, without keeping any of it.
pub fn count(disk: &dyn Disk, paths: &[PathBuf]) -> Result<FileCounts, MeshError> {
    let mut loader = Loader::new(None, &reading_needs);
    for path in paths {
        loader.read(disk, path)?;
    }
    Ok(loader.counts)
}

/// Keeps what is read as long as it fits; counts it in any case.
struct Loader<'a> {
    /// What the mesh may take; nothing is kept without it.
    memory: Option<ByteSize>,
    needs: &'a dyn Fn(FileCounts) -> ByteSize,
    counts: FileCounts,
    files: FileList,
    /// Where the vertices of the file being read begin.
    first_vertex: u64,
    keeping: bool,
    positions: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    cleaning: CleaningCounts,
}

impl<'a> Loader<'a> {
    fn new(memory: Option<ByteSize>, needs: &'a dyn Fn(FileCounts) -> ByteSize) -> Self {
        Loader {
            memory,
            needs,
            counts: FileCounts::default(),
            files: FileList::new(),
            first_vertex: 0,
            keeping: memory.is_some(),
            positions: Vec::new(),
            triangles: Vec::new(),
            cleaning: CleaningCounts::default(),
        }
    }

    fn read(&mut self, disk: &dyn Disk, path: &Path) -> Result<(), MeshError> {
        self.first_vertex = self.counts.vertices;
        self.files.begin(path, self.first_vertex);
        let ReadSummary { polygons, degenerate_faces, left_out, .. } = read_mesh(disk, path, self)?;
        self.cleaning.polygons += polygons;
        self.cleaning.degenerate_faces += degenerate_faces;
        self.cleaning.skipped_elements += left_out;
        Ok(())
    }

    /// Whether this many elements fit; once they do not, what was kept is let go.
    fn fits(&mut self, counts: FileCounts) -> bool {
        self.keeping = self.keeping && self.memory.is_some_and(|memory| (self.needs)(counts) <= memory);
        if !self.keeping {
            self.positions = Vec::new();
            self.triangles = Vec::new();
        }
        self.keeping
    }

    fn finish(mut self, paths: &[PathBuf], rule: PositionsRule) -> Result<(CoreMesh, FileCounts), MeshError> {
        if !self.fits(self.counts) {
            return Err(over_memory(paths, self.counts, (self.needs)(self.counts), self.memory.unwrap_or(ByteSize(0))));
        }
        let (positions, triangles) = (std::mem::take(&mut self.positions), std::mem::take(&mut self.triangles));
        let mesh = canonical_as(rule, positions, triangles, self.cleaning).map_err(|error| match error {
            FrameError::TooLarge { vertex } => self.files.too_large(vertex as u64),
            FrameError::Lattice { bits, extent } => self.files.no_lattice(bits, extent),
        })?;
        // Only now is it known how many vertices a soup really has.
        let counts = FileCounts { vertices: mesh.positions.len() as u64, triangles: mesh.triangles.len() as u64 };
        if !self.fits(counts) {
            return Err(over_memory(paths, counts, (self.needs)(counts), self.memory.unwrap_or(ByteSize(0))));
        }
        Ok((mesh, self.counts))
    }
}

fn over_memory(paths: &[PathBuf], counts: FileCounts, needed: ByteSize, limit: ByteSize) -> MeshError {
    MeshError::OverMemory {
        path: paths.first().cloned().unwrap_or_default(),
        vertices: counts.vertices,
        triangles: counts.triangles,
        needed,
        limit,
        advice: needed.as_argument(),
    }
}

impl TriangleSink for Loader<'_> {
    fn announce(&mut self, vertices: u64, faces: u64) -> Result<(), MeshError> {
        let FileCounts { vertices: old_vertices, triangles: old_faces } = self.counts;
        let promised =
            FileCounts { vertices: old_vertices.saturating_add(vertices), triangles: old_faces.saturating_add(faces) };
        if self.fits(promised) {
            // A header is only a promise: what it does not hold is not paid for.
            self.positions.reserve_exact(vertices.min(1 << 24) as usize);
            self.triangles.reserve_exact(faces.min(1 << 24) as usize);
        }
        Ok(())
    }

    fn vertex(&mut self, position: [f64; 3]) -> Result<(), MeshError> {
        self.counts.vertices += 1;
        // Asked often enough that growth stays within the budget, seldom enough to cost nothing.
        if self.counts.vertices.is_multiple_of(4096) {
            self.fits(self.counts);
        }
        if self.keeping {
            self.positions.push(position);
        }
        Ok(())
    }

    fn triangle(&mut self, corners: [u64; 3]) -> Result<(), MeshError> {
        self.counts.triangles += 1;
        if self.counts.triangles.is_multiple_of(4096) {
            self.fits(self.counts);
        }
        if self.keeping {
            // What fits in RAM is far below 2^32 vertices; a corner that is not, is refused by the reader's gate.
            let corner = |index: u64| u32::try_from(index.saturating_add(self.first_vertex)).unwrap_or(u32::MAX);
            self.triangles.push(corners.map(corner));
        }
        Ok(())
    }
}
