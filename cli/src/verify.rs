//! `vdt verify`: is every byte of a model as it should be, and is it this mesh?

use anyhow::{Result, anyhow, bail};
use metanode::model::Model;
use metanode::{UniformCut, header::ModelError, verify};
use serde_json::json;
use storage::{ByteSize, LocalDisk};
use vdt::ingest::{self, CleaningCounts, CoreMesh, FileCounts, PositionsRule};
use vdt::tree::Positions;

use crate::arguments::VerifyOptions;
use crate::output::{Report, counted};
use crate::progress::Progress;

pub fn run(options: VerifyOptions, json: bool) -> Result<()> {
    let progress = Progress::new("verifying");
    let model = Model::open(&LocalDisk, &options.model)?;
    let found = verify(&model, &mut |share| progress.show(share))?;
    if !options.against.is_empty() {
        progress.phase("comparing");
        let rule = PositionsRule::Fixed(model.header().positions);
        let (mesh, _) = ingest::load(&LocalDisk, &options.against, rule, options.memory, &comparison_needs)?;
        compare(&model, mesh)?;
    }
    drop(progress);

    let mut report = Report::default();
    report.line("model", options.model.display());
    report.line(
        "sound",
        format!(
            "{}, {}, {} in {}, {}",
            counted(found.triangles.into(), "triangle", "triangles"),
            counted(found.leaves.into(), "vertex", "vertices"),
            counted(found.splits.into(), "split", "splits"),
            counted(found.pages.into(), "meta-node", "meta-nodes"),
            ByteSize(found.bytes),
        ),
    );
    if let Some(mesh) = options.against.first() {
        let lattice = match model.header().positions {
            Positions::Lossless => "",
            Positions::Bits(_) => ", rounded to its lattice",
        };
        report.line("same", format!("fully refined, it is exactly the mesh of {}{lattice}", mesh.display()));
    }
    report.print(
        json,
        &json!({
            "sound": true,
            "vertices": found.leaves,
            "triangles": found.triangles,
            "splits": found.splits,
            "roots": found.roots,
            "meta_nodes": found.pages,
            "bytes": found.bytes,
            "same_as_mesh": (!options.against.is_empty()).then_some(true),
            "peak_rss_bytes": storage::usage::peak_resident_bytes(),
        }),
    )
}

/// Bytes that the comparison takes: both meshes in canonical form.
fn comparison_needs(counts: FileCounts) -> ByteSize {
    ByteSize(ingest::reading_needs(counts).0.saturating_add(12 * (counts.vertices + counts.triangles)))
}

/// Brings both the model, fully refined, and the mesh into canonical form as if they were mesh files of the vertices that
/// triangles are left of, and compares. (Those of triangles that were left out have moved the box by which vertices are
/// ordered, where they lay on it.)
fn compare(model: &Model, mesh: CoreMesh) -> Result<()> {
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
