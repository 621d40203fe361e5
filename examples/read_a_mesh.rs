//! Reads a mesh of any format as a stream, in constant memory: here, to count and measure.
//!
//!     cargo run --release -p vdt-examples --example read_a_mesh -- mesh.obj

use std::path::PathBuf;

use anyhow::{Context, Result};
use storage::LocalDisk;
use vdt::mesh::{MeshError, TriangleSink, read_mesh};

/// Counts what passes, and how far it reaches.
#[derive(Default)]
struct Counter {
    vertices: u64,
    triangles: u64,
    farthest: f64,
}

impl TriangleSink for Counter {
    fn vertex(&mut self, position: [f64; 3]) -> Result<(), MeshError> {
        self.vertices += 1;
        self.farthest = position.into_iter().fold(self.farthest, |farthest, value| farthest.max(value.abs()));
        Ok(())
    }

    fn triangle(&mut self, _corners: [u64; 3]) -> Result<(), MeshError> {
        self.triangles += 1;
        Ok(())
    }
}

fn main() -> Result<()> {
    let path = std::env::args_os().nth(1).map(PathBuf::from).context("which mesh?")?;
    let mut counter = Counter::default();
    let summary = read_mesh(&LocalDisk, &path, &mut counter)?;
    println!(
        "{}: {} triangles, {} vertices, no coordinate farther from zero than {}",
        summary.format, counter.triangles, counter.vertices, counter.farthest
    );
    Ok(())
}
