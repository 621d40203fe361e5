//! A stored mesh as a mesh file: the same mesh in another format.
//!
//! Each wedge is a vertex of the file, in canonical order, and each triangle is one, too; so positions that were welded are as
//! many vertices as their attributes ask for. Coordinates are in double precision only where single precision would lose any
//! of them.
//!
//! Memory: a fixed number of buffers and, for what corners name, the bytes given; the writer's. I/O: positions are read once, twice
//! where they have an origin, wedges twice, all else once, but for what corners name: pieces of 8 KiB where they are not near
//! each other.

use std::path::Path;
use std::sync::Arc;

use storage::{Disk, StorageError};

use super::StoredMesh;
use crate::mesh::MeshError;
use crate::mesh::writer::{
    CoordinateType, LayoutAttributes, MeshLayout, MeshWriter, OutputFormat, WrittenMesh, image_bytes,
};
use crate::nearby::Nearby;
use crate::tree::{Image, MeshAttributes, Wedge};

/// Bytes of a buffer through which a sequence is read from front to back.
const BUFFER: usize = 256 << 10;

/// Where a mesh is to be written, and how.
#[derive(Debug, Clone, Copy)]
pub struct Output<'a> {
    /// The file.
    pub path: &'a Path,
    /// Its format.
    pub format: OutputFormat,
    /// Whether files beside it that have other content may be replaced.
    pub may_replace: bool,
    /// One line for the reader of its header.
    pub comment: &'a str,
}

/// Writes a mesh to a file. `ram_bytes` are for what corners name. Says what was written, and how many vertices it has.
///
/// # Errors
///
/// Those of the disks, and of [`MeshWriter`].
pub fn write_mesh(
    disk: &Arc<dyn Disk>,
    mesh: &StoredMesh,
    output: Output<'_>,
    ram_bytes: usize,
    progress: &mut dyn FnMut(f64),
) -> Result<(WrittenMesh, u64), MeshError> {
    let attributes = mesh.attributes.as_ref();
    let vertices = attributes.map_or(mesh.positions.len(), |attributes| attributes.wedges.len());
    let layout = MeshLayout {
        vertices,
        triangles: mesh.triangles.len(),
        coordinates: coordinate_type(mesh)?,
        origin: mesh.origin,
        comments: vec![output.comment.to_string()],
        attributes: match attributes {
            Some(attributes) => Some(LayoutAttributes {
                appearance: attributes.appearance.clone(),
                has_alpha: has_alpha(attributes)?,
                may_replace: output.may_replace,
            }),
            None => None,
        },
    };
    let mut images = |_: usize, image: &Image| Ok(image_bytes(disk.as_ref(), &image.source)?);
    let mut writer = MeshWriter::create_with_images(disk.clone(), output.path, output.format, layout, &mut images)?;
    let all = (vertices + mesh.triangles.len()).max(1) as f64;
    write_vertices(mesh, &mut writer, &mut |done| progress(done as f64 / all))?;
    write_triangles(mesh, &mut writer, ram_bytes, &mut |done| progress((vertices + done) as f64 / all))?;
    Ok((writer.finish()?, vertices))
}

/// The file's coordinates of a position.
fn placed(mesh: &StoredMesh, position: [f32; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| f64::from(position[axis]) + mesh.origin[axis])
}

fn coordinate_type(mesh: &StoredMesh) -> Result<CoordinateType, StorageError> {
    let mut positions = mesh.positions.reader(BUFFER);
    while mesh.origin != [0.0; 3]
        && let Some(position) = positions.next()?
    {
        if placed(mesh, position).iter().any(|value| f64::from(*value as f32) != *value) {
            return Ok(CoordinateType::Double);
        }
    }
    Ok(CoordinateType::Float)
}

fn has_alpha(attributes: &MeshAttributes) -> Result<bool, StorageError> {
    let mut wedges = attributes.wedges.reader(BUFFER);
    while attributes.appearance.kinds.colours
        && let Some(wedge) = wedges.next()?
    {
        if wedge.colour[3] < u8::MAX {
            return Ok(true);
        }
    }
    Ok(false)
}

/// After so many elements progress is told.
const REPORT_EVERY: u64 = 1 << 16;

fn write_vertices(mesh: &StoredMesh, writer: &mut MeshWriter, progress: &mut dyn FnMut(u64)) -> Result<(), MeshError> {
    let mut positions = mesh.positions.reader(BUFFER);
    let Some(attributes) = &mesh.attributes else {
        for number in 0.. {
            let Some(position) = positions.next()? else { break };
            writer.vertex(placed(mesh, position), None)?;
            if number % REPORT_EVERY == 0 {
                progress(number);
            }
        }
        return Ok(());
    };
    let mut wedges = attributes.wedges.reader(BUFFER);
    // The first wedge of the next vertex.
    let mut firsts = attributes.seams.as_ref().map(|seams| seams.first_wedges.reader(BUFFER));
    if let Some(firsts) = &mut firsts {
        firsts.next()?;
    }
    let mut number = 0;
    while let Some(position) = positions.next()? {
        let end = match &mut firsts {
            Some(firsts) => firsts.next()?.map_or(attributes.wedges.len(), u64::from),
            None => number + 1,
        };
        while number < end
            && let Some(wedge) = wedges.next()?
        {
            writer.vertex(placed(mesh, position), Some(&wedge))?;
            if number % REPORT_EVERY == 0 {
                progress(number);
            }
            number += 1;
        }
    }
    Ok(())
}

fn write_triangles(
    mesh: &StoredMesh,
    writer: &mut MeshWriter,
    ram_bytes: usize,
    progress: &mut dyn FnMut(u64),
) -> Result<(), MeshError> {
    let mut triangles = mesh.triangles.reader(BUFFER);
    let attributes = mesh.attributes.as_ref();
    let seams = attributes.and_then(|attributes| attributes.seams.as_ref());
    let mut firsts = seams.map(|seams| Nearby::within(&seams.first_wedges, ram_bytes / 2));
    let mut places = seams.map(|seams| seams.corners.reader(BUFFER));
    let with_materials = attributes.filter(|attributes| attributes.appearance.kinds.materials);
    let mut wedges = with_materials.map(|attributes| Nearby::<Wedge>::within(&attributes.wedges, ram_bytes / 2));
    for number in 0.. {
        let Some(triangle) = triangles.next()? else { break };
        let mut corners = triangle.map(u64::from);
        if let (Some(firsts), Some(places)) = (&mut firsts, &mut places) {
            let places = places.next()?.unwrap_or_default().places();
            for (corner, place) in corners.iter_mut().zip(places) {
                *corner = u64::from(firsts.get(*corner)?) + u64::from(place);
            }
        }
        // All corners of a triangle have the same.
        let material = match &mut wedges {
            Some(wedges) => wedges.get(corners[0])?.material,
            None => MeshWriter::NO_MATERIAL,
        };
        writer.triangle(corners, material)?;
        if number % REPORT_EVERY == 0 {
            progress(number);
        }
    }
    Ok(())
}
