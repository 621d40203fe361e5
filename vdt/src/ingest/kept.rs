//! A [`StoredMesh`] written down in a checkpoint, so that another process can open it again.

use serde::{Deserialize, Serialize};
use storage::{KeptSpool, Scratch, Spool, StorageError};

use super::{CleaningCounts, FileCounts, MeshBlock, StoredMesh};
use crate::tree::Positions;

/// How to open a [`StoredMesh`] again that was kept. Floats are written as their bits: text might round them.
#[derive(Debug, Serialize, Deserialize)]
pub struct KeptMesh {
    positions: KeptSpool,
    triangles: KeptSpool,
    seam_vertices: KeptSpool,
    /// First vertex and first triangle of each block.
    blocks: Vec<[u32; 2]>,
    bounds: [[u32; 3]; 2],
    origin: [u64; 3],
    exponent: i32,
    kept_as: Positions,
    lattice_step: u32,
    cleaning: CleaningCounts,
    input_error: u32,
    files: FileCounts,
}

impl KeptMesh {
    /// Its files in the scratch.
    pub fn files(&self) -> impl Iterator<Item = String> + '_ {
        [&self.positions.file, &self.triangles.file, &self.seam_vertices.file].into_iter().flatten().cloned()
    }
}

impl StoredMesh {
    /// Whether its triangles are on disk: a mesh in RAM is read again sooner than it is written down.
    pub fn is_on_disk(&self) -> bool {
        self.triangles.ram_bytes() == 0 && !self.triangles.is_empty()
    }

    /// Bytes of RAM that it holds.
    pub fn ram_bytes(&self) -> u64 {
        let blocks = self.blocks.len() * size_of::<MeshBlock>();
        (self.positions.ram_bytes() + self.triangles.ram_bytes() + self.seam_vertices.ram_bytes() + blocks) as u64
    }

    /// Keeps it for a checkpoint: its files stay when it goes. Says how to open it again.
    pub fn keep(&mut self, scratch: &Scratch) -> Result<KeptMesh, StorageError> {
        Ok(KeptMesh {
            positions: self.positions.keep(scratch, "positions")?,
            triangles: self.triangles.keep(scratch, "triangles")?,
            seam_vertices: self.seam_vertices.keep(scratch, "seam-vertices")?,
            blocks: self.blocks.iter().map(|block| [block.first_vertex, block.first_triangle]).collect(),
            bounds: self.bounds.map(|corner| corner.map(f32::to_bits)),
            origin: self.origin.map(f64::to_bits),
            exponent: self.exponent,
            kept_as: self.kept_as,
            lattice_step: self.lattice_step.to_bits(),
            cleaning: self.cleaning,
            input_error: self.input_error.to_bits(),
            files: self.files,
        })
    }

    /// Opens one that was kept.
    pub fn reopen(scratch: &Scratch, kept: &KeptMesh) -> Result<Self, StorageError> {
        let block = |[first_vertex, first_triangle]: &[u32; 2]| MeshBlock {
            first_vertex: *first_vertex,
            first_triangle: *first_triangle,
        };
        Ok(StoredMesh {
            positions: Spool::reopen(scratch, &kept.positions)?,
            triangles: Spool::reopen(scratch, &kept.triangles)?,
            seam_vertices: Spool::reopen(scratch, &kept.seam_vertices)?,
            blocks: kept.blocks.iter().map(block).collect(),
            bounds: kept.bounds.map(|corner| corner.map(f32::from_bits)),
            origin: kept.origin.map(f64::from_bits),
            exponent: kept.exponent,
            kept_as: kept.kept_as,
            lattice_step: f32::from_bits(kept.lattice_step),
            cleaning: kept.cleaning,
            input_error: f32::from_bits(kept.input_error),
            files: kept.files,
        })
    }
}
