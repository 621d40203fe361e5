//! Opens a model, flies around it in 16 MB, and takes the triangles of every frame: what a renderer would do.
//!
//!     cargo run --release -p vdt-examples --example fly -- model.vdt

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result};
use metanode::model::Model;
use navigator::{Navigator, NavigatorOptions, PathSpec};
use storage::LocalDisk;

fn main() -> Result<()> {
    let path = std::env::args_os().nth(1).map(PathBuf::from).context("which model?")?;
    let model = Arc::new(Model::open(&LocalDisk, &path)?);
    let cameras = PathSpec::Orbit { frames: 100 }.cameras(&LocalDisk, &model)?;
    let mut navigator = Navigator::open(model, NavigatorOptions { memory: 16 << 20, ..NavigatorOptions::default() })?;
    for camera in &cameras {
        let frame = navigator.frame(camera)?;
        // The area is a stand-in for drawing: it reads every corner of every triangle.
        let area: f64 = navigator.triangles().map(|triangle| area(triangle.positions)).sum();
        println!("frame {}: {} triangles, {} misses, area {area:.3}", frame.frame, frame.triangles, frame.misses);
    }
    Ok(())
}

fn area([a, b, c]: [[f32; 3]; 3]) -> f64 {
    let side = |to: [f32; 3]| -> [f64; 3] { std::array::from_fn(|axis| f64::from(to[axis]) - f64::from(a[axis])) };
    let (u, v) = (side(b), side(c));
    let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    normal.iter().map(|x| x * x).sum::<f64>().sqrt() / 2.0
}
