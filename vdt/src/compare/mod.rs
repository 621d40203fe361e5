//! How far two triangle meshes of any size are apart, as sets of points: mean, root mean square and Hausdorff distance.
//!
//! It knows nothing of how meshes are simplified and shares no code with that, so that it can judge it. Attributes are no
//! part of a distance; where both meshes have colours, of vertices, faces, textures or materials, how far these are apart is
//! measured as well.
//!
//! For each point of one surface, the distance is that to the nearest point of the other, in double precision, exact up to
//! rounding.
//! - *Mean and root mean square* are over the area, by samples that are spread evenly over it.
//! - *The maximum* is found by looking at the samples, at the vertices, and then closer where it may be larger. What is
//!   told is a distance that was found at a point that is told, too; the true maximum is no smaller, and no larger than the
//!   bound beside it. That is mostly a thousandth more. The search is limited: where very many places are as far apart as
//!   each other it may end early, which is told, and the bound is larger.
//!
//! The same meshes and number of samples give the same figures bit by bit, whatever the memory and threads.
//!
//! | module | what it does |
//! |---|---|
//! | `surface`, `records` | a mesh as triangles with positions; in RAM or on disk, read through a cache |
//! | `triangle` | a point and a triangle |
//! | `target` | the nearest point of a surface: runs of triangles under a hierarchy of boxes |
//! | `samples` | points spread over a surface |
//! | `looks` | colours and texture coordinates of the triangles of a surface |
//! | `paint` | the colour of a surface at a point; images |
//! | `one_sided` | one direction |
//! | `refine` | the maximum by branch and bound, as in Guthe et al., *Fast and Accurate Hausdorff Distance between Meshes* (2005) |
//!
//! Memory: [`compare`] keeps to its limit; both surfaces take 36 bytes a triangle and 12 a vertex, in RAM where they fit
//! and on disk where they do not. Where there are colours, 40 bytes a triangle more, and 3 a pixel of all images, which are in
//! RAM. CPU, measured: a microsecond or two for each sample and vertex.

mod looks;
mod one_sided;
mod paint;
mod records;
mod refine;
mod samples;
mod surface;
mod target;
#[cfg(test)]
mod tests;
mod triangle;

use std::path::{Path, PathBuf};

use storage::{ByteSize, Disk, Scratch, StorageError};
use thiserror::Error;

use crate::mesh::MeshError;

pub use one_sided::{ColourDifference, Effort, OneSided, one_sided};
use one_sided::{Painted, one_sided_painted};
use paint::{ImageLimits, Paint, Pictures};
pub use surface::Surface;
pub use target::Target;
pub use triangle::{Triangle, squared_distance};

/// The least memory with which two meshes can be compared.
pub const SMALLEST_MEMORY: ByteSize = ByteSize(16 << 20);

/// Why two meshes cannot be compared.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CompareError {
    /// A mesh file could not be read, or holds no mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The scratch failed.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// A mesh has no surface.
    #[error("{}: no triangle has three different corners: there is no surface to measure", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The memory is too little for any mesh.
    #[error("comparing takes {needed} of RAM, and {memory} are allowed; run again with --memory {}", needed.as_argument())]
    Memory {
        /// What would do.
        needed: ByteSize,
        /// What is allowed.
        memory: ByteSize,
    },
    /// The memory is too little for the images of textures.
    #[error(
        "comparing colours takes {needed} of RAM for the images of the textures, and {memory} are allowed; run again with \
         --memory {}, or with --no-colours",
        needed.as_argument()
    )]
    Images {
        /// What would do.
        needed: ByteSize,
        /// What is allowed.
        memory: ByteSize,
    },
}

/// What a surface is read with.
#[derive(Debug, Clone, Copy)]
pub struct Resources<'a> {
    /// Where what does not fit goes.
    pub scratch: &'a Scratch,
    /// Limit on what grows with the mesh.
    pub memory: ByteSize,
    /// Threads that may be used.
    pub threads: usize,
}

/// How to compare two meshes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CompareOptions {
    /// Samples on each surface, at least one.
    pub samples: u64,
    /// Limit on what grows with the meshes. The result does not depend on it.
    pub memory: ByteSize,
    /// Threads that may work. The result does not depend on them.
    pub threads: usize,
    /// Whether only the distance of the first mesh from the second is measured.
    pub is_one_sided: bool,
    /// Whether colours are compared, where both meshes have any.
    pub with_colours: bool,
}

/// How far two meshes are apart.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// From the first to the second.
    pub a_to_b: OneSided,
    /// From the second to the first, if it was asked for.
    pub b_to_a: Option<OneSided>,
    /// Length of the diagonal of the first mesh's bounding box.
    pub diagonal: f64,
    /// Triangles of both surfaces.
    pub triangles: [u64; 2],
    /// Which of them have colours, where it was asked for these to be compared.
    pub have_colours: [bool; 2],
    /// What the user should know of the colours: images that are not there or cannot be decoded.
    pub colour_notes: Vec<String>,
}

impl Comparison {
    /// The Hausdorff distance: the larger of both maxima. `None` where only one was measured.
    pub fn hausdorff(&self) -> Option<f64> {
        self.b_to_a.map(|b_to_a| self.a_to_b.max.max(b_to_a.max))
    }
}

/// Compares two mesh files of any size. `progress` is told the share of the work that is done, from 0 to 1.
///
/// # Errors
///
/// As [`CompareError`] has them.
pub fn compare(
    disk: &dyn Disk,
    [a, b]: [&Path; 2],
    options: &CompareOptions,
    scratch: &Scratch,
    progress: &mut dyn FnMut(f64),
) -> Result<Comparison, CompareError> {
    let CompareOptions { memory, threads, with_colours, .. } = *options;
    if memory < SMALLEST_MEMORY {
        return Err(CompareError::Memory { needed: SMALLEST_MEMORY, memory });
    }
    let shares = Shares::of(memory);
    let resources = Resources { scratch, memory: shares.reading, threads };
    let read = |path| {
        let read = if with_colours { Surface::read_with_looks } else { Surface::read };
        read(disk, path, &resources).map_err(|error| for_all_of_it(error, memory))
    };
    let first = read(a)?;
    progress(0.1);
    let second = read(b)?;
    progress(0.2);
    compare_surfaces(disk, [first, second], options, progress)
}

/// Compares two surfaces that were read with the share of the memory for that.
fn compare_surfaces(
    disk: &dyn Disk,
    [mut first, mut second]: [Surface; 2],
    options: &CompareOptions,
    progress: &mut dyn FnMut(f64),
) -> Result<Comparison, CompareError> {
    let CompareOptions { samples, memory, threads, is_one_sided, .. } = *options;
    let looks = [first.looks.take(), second.looks.take()];
    let mut shares = Shares::of(memory);
    let pictures = match &looks {
        [Some(a), Some(b)] => Pictures::decode(disk, [&a.appearance, &b.appearance], &shares.images, memory)?,
        // There is nothing to compare with.
        _ => Pictures::default(),
    };
    if !pictures.is_empty() {
        shares.boxes /= 2;
    }
    let paint = [0, 1].map(|side| looks[side].as_ref().and_then(|looks| Paint::of(&looks.appearance, &pictures)));
    let have_colours = match &looks {
        [Some(_), Some(_)] => paint.each_ref().map(Option::is_some),
        _ => looks.each_ref().map(Option::is_some),
    };
    let painted = |from: usize, to: usize| {
        Some(Painted {
            looks: [looks[from].as_ref()?, looks[to].as_ref()?],
            paint: [paint[from].as_ref()?, paint[to].as_ref()?],
        })
    };
    let effort = Effort { samples, threads, cache_bytes: shares.caches };
    let part = if is_one_sided { 0.8 } else { 0.4 };
    let target = Target::new(&second, shares.boxes)?;
    let a_to_b = one_sided_painted(&first, &target, painted(0, 1), effort, &mut |share| progress(0.2 + part * share))?;
    drop(target);
    let b_to_a = if is_one_sided {
        None
    } else {
        let target = Target::new(&first, shares.boxes)?;
        let mut progress = |share| progress(0.2 + part + part * share);
        Some(one_sided_painted(&second, &target, painted(1, 0), effort, &mut progress)?)
    };
    let triangles = [first.triangle_count(), second.triangle_count()];
    let diagonal = first.diagonal();
    Ok(Comparison { a_to_b, b_to_a, diagonal, triangles, have_colours, colour_notes: pictures.notes })
}

/// How the memory is shared out, in 64 parts: 40 while a surface is read, of which it holds 15 afterwards, and 2 1/2 more where
/// it has looks; 16 for boxes and 8 for caches, which come when images are decoded. Images have what is left of that, and half
/// of what boxes would have, which then are of longer runs.
#[derive(Debug, Clone, Copy)]
struct Shares {
    reading: ByteSize,
    boxes: u64,
    caches: usize,
    images: ImageLimits,
}

impl Shares {
    fn of(memory: ByteSize) -> Self {
        Shares {
            reading: ByteSize(memory.0 / 8 * 5),
            boxes: memory.0 / 4,
            caches: usize::try_from(memory.0 / 8).unwrap_or(usize::MAX),
            images: ImageLimits { kept: memory.0 / 64 * 13, in_all: memory.0 / 64 * 29 },
        }
    }
}

/// The same complaint in terms of the memory that the whole comparison has.
fn for_all_of_it(error: CompareError, memory: ByteSize) -> CompareError {
    match error {
        CompareError::Mesh(MeshError::OverMemory { path, vertices, triangles, needed, .. }) => {
            let needed = ByteSize(needed.0.div_ceil(5).saturating_mul(8));
            let advice = needed.as_argument();
            CompareError::Mesh(MeshError::OverMemory { path, vertices, triangles, needed, limit: memory, advice })
        }
        error => error,
    }
}
