//! A [`StoredMesh`] written down in a checkpoint, so that another process can open it again.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use storage::{KeptSpool, Scratch, Spool, StorageError};

use super::{CleaningCounts, FileCounts, MeshBlock, StoredMesh};
use crate::tree::{Appearance, MeshAttributes, MeshSeams, Positions};

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
    attributes: Option<KeptAttributes>,
    missing_files: Vec<PathBuf>,
}

/// The same for [`MeshAttributes`].
#[derive(Debug, Serialize, Deserialize)]
struct KeptAttributes {
    appearance: KeptAppearance,
    wedges: KeptSpool,
    /// First wedges, places of corners.
    seams: Option<[KeptSpool; 2]>,
}

/// The same for [`Appearance`]: base colours apart, as bits.
#[derive(Debug, Serialize, Deserialize)]
struct KeptAppearance {
    /// Without base colours.
    appearance: Appearance,
    base_colours: Vec<Option<[u32; 4]>>,
}

impl KeptAppearance {
    fn of(appearance: &Appearance) -> Self {
        let mut appearance = appearance.clone();
        let base_colours = appearance
            .materials
            .iter_mut()
            .map(|material| material.base_colour.take().map(|colour| colour.map(f32::to_bits)))
            .collect();
        KeptAppearance { appearance, base_colours }
    }

    fn reopen(&self) -> Appearance {
        let mut appearance = self.appearance.clone();
        for (material, colour) in appearance.materials.iter_mut().zip(&self.base_colours) {
            material.base_colour = colour.map(|colour| colour.map(f32::from_bits));
        }
        appearance
    }
}

impl KeptMesh {
    /// Its files in the scratch.
    pub fn files(&self) -> impl Iterator<Item = String> + '_ {
        let attributes = self.attributes.iter();
        let of_attributes = attributes.flat_map(|kept| [&kept.wedges].into_iter().chain(kept.seams.iter().flatten()));
        let all = [&self.positions, &self.triangles, &self.seam_vertices].into_iter().chain(of_attributes);
        all.filter_map(|spool| spool.file.clone())
    }
}

impl MeshAttributes {
    /// Bytes of RAM that they hold, but for names.
    pub(super) fn ram_bytes(&self) -> usize {
        let seams = self.seams.as_ref();
        let of_seams = seams.map_or(0, |seams| seams.first_wedges.ram_bytes() + seams.corners.ram_bytes());
        self.wedges.ram_bytes() + of_seams
    }

    fn keep(&mut self, scratch: &Scratch) -> Result<KeptAttributes, StorageError> {
        let seams = match &mut self.seams {
            None => None,
            Some(MeshSeams { first_wedges, corners }) => {
                Some([first_wedges.keep(scratch, "first-wedges")?, corners.keep(scratch, "corner-places")?])
            }
        };
        let appearance = KeptAppearance::of(&self.appearance);
        Ok(KeptAttributes { appearance, wedges: self.wedges.keep(scratch, "wedges")?, seams })
    }

    fn reopen(scratch: &Scratch, kept: &KeptAttributes) -> Result<Self, StorageError> {
        let seams = match &kept.seams {
            None => None,
            Some([first_wedges, corners]) => Some(MeshSeams {
                first_wedges: Spool::reopen(scratch, first_wedges)?,
                corners: Spool::reopen(scratch, corners)?,
            }),
        };
        let wedges = Spool::reopen(scratch, &kept.wedges)?;
        Ok(MeshAttributes { appearance: kept.appearance.reopen(), wedges, seams })
    }
}

impl StoredMesh {
    /// Whether its triangles are on disk, beside which attributes in RAM are few: a mesh in RAM is read again sooner than it is written down.
    pub fn is_on_disk(&self) -> bool {
        self.triangles.ram_bytes() == 0 && !self.triangles.is_empty()
    }

    /// Bytes of RAM that it holds.
    pub fn ram_bytes(&self) -> u64 {
        let blocks = self.blocks.len() * size_of::<MeshBlock>();
        let attributes = self.attributes.as_ref().map_or(0, MeshAttributes::ram_bytes);
        let mesh = self.positions.ram_bytes() + self.triangles.ram_bytes() + self.seam_vertices.ram_bytes();
        (mesh + attributes + blocks) as u64
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
            attributes: self.attributes.as_mut().map(|attributes| attributes.keep(scratch)).transpose()?,
            missing_files: self.missing_files.clone(),
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
            attributes: kept.attributes.as_ref().map(|kept| MeshAttributes::reopen(scratch, kept)).transpose()?,
            missing_files: kept.missing_files.clone(),
        })
    }
}
