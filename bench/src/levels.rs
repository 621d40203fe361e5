//! Levels of detail of one mesh: uniform cuts of a vdt model, as `vdt extract --triangles` makes them, and what meshopt's
//! simplifier makes of the same mesh.
//!
//! Everything stays in RAM. The mesh that both start from is that of the model, fully refined: welded, without what
//! ingest leaves out, and in the order of the leaves.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use meshopt::{SimplifyOptions, VertexDataAdapter};
use metanode::header::{Blocking, ModelError};
use metanode::model::Model;
use metanode::{ModelOptions, UniformCut, WriteResources, error_for_triangles, write_model};
use storage::{ByteSize, Disk, EdgeTreeKind, LocalDisk, MemoryDisk, Scratch};
use vdt::build::{BuildOptions, build};
use vdt::ingest::PositionsRule;
use vdt::tree::{ErrorBound, Metric, Strategy};

use crate::surface::Mesh;

/// More than any mesh takes that a bench would be run on.
const MEMORY: ByteSize = ByteSize(1 << 40);

/// Builds the model of a mesh file in RAM, with the quadric metric and the default bound.
pub fn build_model(mesh: &Path, strategy: Strategy) -> Result<Model> {
    let (metric, error_bound) = (Metric::Quadric, ErrorBound::default());
    let edge_tree = EdgeTreeKind::default();
    let positions = PositionsRule::LOSSLESS;
    let options = BuildOptions {
        memory: MEMORY,
        threads: 1,
        metric,
        strategy,
        error_bound,
        edge_tree,
        positions,
        attributes: false,
    };
    let paths = [mesh.to_path_buf()];
    let (tree, report) = build(&LocalDisk, &paths, &options, &Scratch::in_memory(), None, &mut |_| ())?;
    let disk: Arc<dyn Disk> = Arc::new(MemoryDisk::new());
    let path = PathBuf::from("model.vdt");
    let (blocking, input_error, positions) = (Blocking::default(), report.input_error, report.positions);
    let model_options = ModelOptions { blocking, metric, strategy, error_bound, input_error, positions };
    write_model(disk.clone(), &path, &tree, &model_options, &WriteResources::in_memory(), &mut |_| ())?;
    Ok(Model::open(disk.as_ref(), &path)?)
}

/// The finest uniform cut of a model with at most so many triangles.
pub fn cut(model: &Model, triangles: u64) -> Result<Mesh> {
    let cut = UniformCut::new(model, error_for_triangles(model, triangles)?)?;
    let mut mesh = Mesh::default();
    cut.for_each_vertex(|position| -> Result<(), ModelError> {
        mesh.positions.push(position);
        Ok(())
    })?;
    cut.for_each_triangle(|corners| -> Result<()> {
        let [a, b, c] = corners.map(u32::try_from);
        mesh.triangles.push([a?, b?, c?]);
        Ok(())
    })?;
    Ok(mesh)
}

/// What meshopt makes of a mesh, with at most so many triangles where it can, whatever the error.
pub fn meshopt_level(mesh: &Mesh, triangles: usize, options: SimplifyOptions) -> Result<Mesh> {
    let bytes = meshopt::typed_to_bytes(&mesh.positions);
    let vertices = VertexDataAdapter::new(bytes, size_of::<[f32; 3]>(), 0).context("meshopt takes no such vertices")?;
    let indices = mesh.triangles.as_flattened();
    let left = meshopt::simplify(indices, &vertices, triangles * 3, f32::MAX, options, None);
    let (triangles, _) = left.as_chunks();
    Ok(Mesh { positions: mesh.positions.clone(), triangles: triangles.to_vec() })
}
