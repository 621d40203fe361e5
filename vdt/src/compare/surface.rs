//! A mesh as a set of points: its triangles with their corners' positions, in an order in which neighbours are near.
//!
//! The mesh comes through [`crate::ingest`]: welded, in Morton order, and without triangles of which two corners are one
//! point and without duplicates. None of that changes the surface, except where a degenerate triangle stands alone: a
//! segment that no other triangle covers is no part of what is measured. Positions are in single precision relative to
//! the mesh's own origin, as a model has them.
//!
//! Memory: while a mesh is read, the limit given; afterwards at most three eighths of it. I/O: that of ingest, and for
//! what does not fit 36 bytes a triangle, written once and read once for each pass over the surface.

use std::path::{Path, PathBuf};

use storage::{ByteSize, Disk, Scratch, SpoolReader, StorageError};

use super::looks::Looks;
use super::records::{Records, RecordsWriter, Window};
use super::triangle::{Triangle, area, length, longest_side};
use super::{CompareError, Resources};
use crate::ingest::{self, IngestPlan, PositionsRule, StoredMesh};
use crate::vector::Vector;

/// Triangles that are handled together: what is computed does not depend on memory or threads, so they are always as many.
pub(super) const CHUNK: usize = 4096;
/// A triangle in single precision, as it is stored.
pub(super) type Corners = [[f32; 3]; 3];

/// What samples are spread over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Spread {
    /// Area.
    Area,
    /// The longest side of each triangle, where none has an area.
    Length,
}

impl Spread {
    /// How much of it a triangle has.
    pub fn of(self, triangle: &Triangle) -> f64 {
        match self {
            Spread::Area => area(triangle),
            Spread::Length => {
                let [a, b] = longest_side(triangle);
                length(a, b)
            }
        }
    }
}

/// A surface, to be measured from or to.
#[derive(Debug)]
pub struct Surface {
    pub(super) triangles: Records<Corners>,
    pub(super) positions: Records<[f32; 3]>,
    pub(super) origin: [f64; 3],
    pub(super) bounds: [[f32; 3]; 2],
    pub(super) spread: Spread,
    /// How much of what samples are spread over lies before each chunk of triangles, and behind the last.
    pub(super) before: Vec<f64>,
    /// What its triangles look like, where that was asked for and the file says anything of it.
    pub(super) looks: Option<Looks>,
}

impl Surface {
    /// Reads the surface of a mesh file, of any size. The limit on memory is that while it is read; afterwards it holds at
    /// most three eighths of it.
    ///
    /// # Errors
    ///
    /// Those of [`ingest::store`]; [`CompareError::Empty`] where no triangle has three different corners.
    pub fn read(disk: &dyn Disk, path: &Path, resources: &Resources<'_>) -> Result<Self, CompareError> {
        Self::read_as(disk, path, resources, false)
    }

    /// The same, and what its triangles look like, which takes up to a sixteenth of the memory more.
    ///
    /// # Errors
    ///
    /// Those of [`Surface::read`].
    pub fn read_with_looks(disk: &dyn Disk, path: &Path, resources: &Resources<'_>) -> Result<Self, CompareError> {
        Self::read_as(disk, path, resources, true)
    }

    fn read_as(
        disk: &dyn Disk,
        path: &Path,
        resources: &Resources<'_>,
        with_looks: bool,
    ) -> Result<Self, CompareError> {
        let Resources { scratch, memory, threads } = *resources;
        let plan = IngestPlan {
            memory,
            threads,
            block_triangles: u64::MAX,
            positions: PositionsRule::LOSSLESS,
            attributes: with_looks,
        };
        let paths: [PathBuf; 1] = [path.to_path_buf()];
        let mesh = ingest::store(disk, scratch, &paths, &plan, &mut |_| ())?;
        if mesh.triangles.is_empty() {
            return Err(CompareError::Empty { path: path.to_path_buf() });
        }
        let surface = Surface::of(mesh, scratch, memory)?;
        scratch.release_memory();
        Ok(surface)
    }

    pub(super) fn of(mesh: StoredMesh, scratch: &Scratch, memory: ByteSize) -> Result<Self, StorageError> {
        let share = usize::try_from(memory.0 / 4).unwrap_or(usize::MAX);
        let positions = Records::of(mesh.positions)?;
        let mut window = Window::new(&positions, 1, share / 2);
        let count = mesh.triangles.len();
        let mut triangles = RecordsWriter::new(scratch, "corners", count, share);
        let mut reader: SpoolReader<'_, [u32; 3]> = mesh.triangles.reader(share / 16);
        let (mut areas, mut lengths) = (Sums::default(), Sums::default());
        while let Some(vertices) = reader.next()? {
            let mut corners = Corners::default();
            for (corner, vertex) in corners.iter_mut().zip(vertices) {
                // Each vertex that a triangle names is there: ingest made them so.
                *corner = window.run(vertex.into(), 1)?.first().copied().unwrap_or_default();
            }
            let triangle = exact(&corners);
            areas.add(Spread::Area.of(&triangle));
            lengths.add(Spread::Length.of(&triangle));
            triangles.push(corners)?;
        }
        drop(window);
        drop(reader);
        let looks = match mesh.attributes {
            Some(attributes) => Looks::of(attributes, &mesh.triangles, scratch, memory)?,
            None => None,
        };
        let (spread, sums) = if areas.sum > 0.0 { (Spread::Area, areas) } else { (Spread::Length, lengths) };
        Ok(Surface {
            triangles: triangles.finish()?,
            positions,
            origin: mesh.origin,
            bounds: mesh.bounds,
            spread,
            before: sums.finish(),
            looks,
        })
    }

    /// Triangles of the surface.
    pub fn triangle_count(&self) -> u64 {
        self.triangles.len()
    }

    /// Length of the diagonal of its bounding box, in mesh units.
    pub fn diagonal(&self) -> f64 {
        let [low, high] = self.bounds.map(|corner| corner.map(f64::from));
        length(low, high)
    }

    /// Which share of what samples are spread over is that of a chunk of triangles.
    pub(super) fn share(&self, chunk: u64) -> f64 {
        let all = self.before.last().copied().unwrap_or(0.0);
        match self.before.get(chunk as usize..) {
            Some([start, end, ..]) => (end - start) / all,
            _ => 0.0,
        }
    }

    /// What to add to a position of this surface to have it relative to the origin of `other`.
    pub(super) fn offset_to(&self, other: &Surface) -> Vector {
        std::array::from_fn(|axis| self.origin[axis] - other.origin[axis])
    }
}

/// A stored triangle in double precision: exactly the same.
pub(super) fn exact(corners: &Corners) -> Triangle {
    corners.map(|corner| corner.map(f64::from))
}

/// A sum, and what it was before each chunk.
#[derive(Debug, Default)]
struct Sums {
    before: Vec<f64>,
    sum: f64,
    count: usize,
}

impl Sums {
    fn add(&mut self, value: f64) {
        if self.count.is_multiple_of(CHUNK) {
            self.before.push(self.sum);
        }
        self.count += 1;
        self.sum += value;
    }

    fn finish(mut self) -> Vec<f64> {
        self.before.push(self.sum);
        self.before
    }
}
