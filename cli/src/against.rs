//! Is a model, fully refined, this mesh? Positions and triangles exactly, or as they were rounded; and all that the corners carry,
//! where the model keeps that.
//!
//! Both are brought into canonical form in RAM; attributes are compared as sorted lists of triangles, with all that their corners
//! have.
//!
//! RAM: the mesh twice; with attributes 320 bytes a triangle more.

use anyhow::{Result, anyhow, bail};
use metanode::header::ModelError;
use metanode::model::Model;
use metanode::{CutWedges, UniformCut};
use storage::ByteSize;
use vdt::ingest::{self, CleaningCounts, CoreAttributes, CoreMesh, FileCounts};
use vdt::tree::{Positions, Wedge};

/// Bytes that the comparison takes: both meshes in canonical form, and the corners of both with their attributes.
pub fn needs(counts: FileCounts, has_attributes: bool) -> ByteSize {
    let of_mesh = 12 * (counts.vertices + counts.triangles);
    let of_corners = if has_attributes { of_mesh + 2 * size_of::<Corners>() as u64 * counts.triangles } else { 0 };
    ByteSize(ingest::reading_needs(counts).0.saturating_add(of_mesh).saturating_add(of_corners))
}

/// Brings both the model, fully refined, and the mesh into canonical form as if they were mesh files of the vertices that
/// triangles are left of, and compares. (Those of triangles that were left out have moved the box by which vertices are
/// ordered, where they lay on it.)
///
/// # Errors
///
/// What is not the same.
pub fn compare(model: &Model, mut mesh: CoreMesh) -> Result<()> {
    let attributes = mesh.attributes.take();
    match (model.appearance(), attributes) {
        (None, _) => compare_triangles(model, mesh),
        (Some(_), Some(attributes)) => {
            compare_triangles(model, mesh.clone())?;
            compare_attributes(model, &mesh, &attributes)
        }
        (Some(found), None) => {
            compare_triangles(model, mesh)?;
            bail!("{}: not this mesh: it has {}, the mesh has none", model.path().display(), found.layout.kinds)
        }
    }
}

fn compare_triangles(model: &Model, mesh: CoreMesh) -> Result<()> {
    let header = model.header();
    // What was rounded is compared as it was rounded: relative to the origin, which is not added and taken off again.
    let is_rounded = header.positions != Positions::Lossless;
    if is_rounded && (mesh.origin, mesh.lattice_step) != (header.origin, header.lattice_step) && header.leaf_count > 0 {
        bail!("{}: not this mesh: it has another box, and so another lattice", model.path().display());
    }
    let whole = |position: [f32; 3], origin: [f64; 3]| -> [f64; 3] {
        let origin = if is_rounded { [0.0; 3] } else { origin };
        std::array::from_fn(|axis| f64::from(position[axis]) + origin[axis])
    };
    let too_large = || anyhow!("{}: a position is too large for single precision", model.path().display());
    let CoreMesh { positions, triangles, origin, .. } = mesh;
    let positions = positions.into_iter().map(|position| whole(position, origin)).collect();
    let mesh = ingest::canonical(positions, triangles, CleaningCounts::default()).map_err(|_| too_large())?;

    let cut = UniformCut::new(model, 0.0)?;
    let mut positions = Vec::with_capacity(cut.vertex_count() as usize);
    let mut triangles = Vec::with_capacity(cut.triangle_count() as usize);
    cut.for_each_vertex(|position| -> Result<(), ModelError> {
        positions.push(whole(position, header.origin));
        Ok(())
    })?;
    cut.for_each_triangle(|corners| -> Result<(), ModelError> {
        triangles.push(corners.map(|corner| corner as u32));
        Ok(())
    })?;
    let refined = ingest::canonical(positions, triangles, CleaningCounts::default()).map_err(|_| too_large())?;
    let place = |mesh: &CoreMesh, corners: [u32; 3]| corners.map(|corner| mesh.positions[corner as usize]);
    if (refined.positions.len(), refined.triangles.len()) != (mesh.positions.len(), mesh.triangles.len()) {
        bail!(
            "{}: not this mesh: the model has {} vertices and {} triangles, the mesh has {} and {}",
            model.path().display(),
            refined.positions.len(),
            refined.triangles.len(),
            mesh.positions.len(),
            mesh.triangles.len(),
        );
    }
    let mut pairs = refined.triangles.iter().zip(&mesh.triangles);
    match pairs.position(|(model, other)| place(&refined, *model) != place(&mesh, *other)) {
        None if refined.origin == mesh.origin => Ok(()),
        None => bail!("{}: not this mesh: it lies elsewhere", model.path().display()),
        Some(first) => bail!(
            "{}: not this mesh: of {} triangles, in canonical order, the first that differs is number {first}, {:?}",
            model.path().display(),
            mesh.triangles.len(),
            place(&mesh, mesh.triangles[first]),
        ),
    }
}

/// A corner of a triangle: the bits of its position, and its wedge.
type Corner = ([u64; 3], [u32; 5]);
/// The corners of a triangle, the smallest first.
type Corners = [Corner; 3];

fn corner(position: [f32; 3], origin: [f64; 3], wedge: &Wedge) -> Corner {
    // There is one zero only.
    let bits = |axis: usize| (f64::from(position[axis]) + origin[axis] + 0.0).to_bits();
    ([bits(0), bits(1), bits(2)], bytemuck::cast(*wedge))
}

fn turned(mut corners: Corners) -> Corners {
    let smallest = (0..3).min_by_key(|place| corners[*place]).unwrap_or_default();
    corners.rotate_left(smallest);
    corners
}

fn compare_attributes(model: &Model, mesh: &CoreMesh, attributes: &CoreAttributes) -> Result<()> {
    let path = model.path().display();
    let cut = UniformCut::new(model, 0.0)?;
    let (Some(found), Some(wedges)) = (model.appearance(), CutWedges::of(&cut)?) else { return Ok(()) };
    let (kinds, of_mesh) = (found.layout.kinds, attributes.appearance.kinds);
    if kinds != of_mesh {
        bail!("{path}: not this mesh: it has {kinds}, the mesh has {of_mesh}");
    }
    if found.appearance.texture_exponent != attributes.appearance.texture_exponent {
        bail!("{path}: not this mesh: its texture coordinates are in other steps");
    }
    let names = |appearance: &vdt::tree::Appearance| -> Vec<String> {
        appearance.materials.iter().map(|material| material.name.clone()).collect()
    };
    if names(&found.appearance) != names(&attributes.appearance) {
        bail!("{path}: not this mesh: it has other materials");
    }
    let mut vertices = Vec::with_capacity(wedges.vertex_count() as usize);
    wedges.for_each_vertex(|position, wedge| -> Result<(), ModelError> {
        vertices.push(corner(position, model.header().origin, wedge));
        Ok(())
    })?;
    let mut refined: Vec<Corners> = Vec::with_capacity(mesh.triangles.len());
    wedges.for_each_triangle(|corners, _| -> Result<(), ModelError> {
        refined.push(turned(corners.map(|corner| vertices[corner as usize])));
        Ok(())
    })?;
    drop(vertices);
    let of_triangle = |(corners, places): (&[u32; 3], &vdt::tree::CornerPlaces)| {
        let places = places.places();
        turned([0, 1, 2].map(|place: usize| {
            let vertex = corners[place] as usize;
            corner(mesh.positions[vertex], mesh.origin, &attributes.wedges[vertex][places[place] as usize])
        }))
    };
    let mut expected: Vec<Corners> = mesh.triangles.iter().zip(&attributes.corners).map(of_triangle).collect();
    refined.sort_unstable();
    expected.sort_unstable();
    match refined.iter().zip(&expected).position(|(one, other)| one != other) {
        None => Ok(()),
        Some(first) => {
            let [a, b, c] = expected[first].map(|(position, _)| position.map(f64::from_bits));
            bail!("{path}: not this mesh: the corners of the triangle {a:?}, {b:?}, {c:?} carry something else")
        }
    }
}
