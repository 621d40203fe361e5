//! Walks over a model in 16 MB and keeps copies of the vertices and of the triangles to be drawn, as a renderer has them in the
//! memory of its GPU: after each frame only what has changed is copied.
//!
//!     cargo run --release -p vdt-examples --example buffers -- model.vdt

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result};
use metanode::model::Model;
use navigator::{Navigator, NavigatorOptions, RandomWalk};
use storage::LocalDisk;

fn main() -> Result<()> {
    let path = std::env::args_os().nth(1).map(PathBuf::from).context("which model?")?;
    let model = Arc::new(Model::open(&LocalDisk, &path)?);
    let mut walk = RandomWalk::new(&model, 1)?;
    let mut navigator = Navigator::open(model, NavigatorOptions { memory: 16 << 20, ..NavigatorOptions::default() })?;
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for _ in 0..600 {
        walk.step();
        let frame = navigator.frame(&walk.camera())?;
        // To copy a few elements between two changes costs less than to begin another copy.
        let vertex_bytes = update(&mut vertices, navigator.vertex_stream(), navigator.changed_vertices(16));
        let triangle_bytes = update(&mut triangles, navigator.triangle_stream(), navigator.changed_triangles(16));
        navigator.forget_changes();
        let triangles = frame.triangles;
        println!("frame {}: {triangles} triangles, {} bytes copied", frame.frame, vertex_bytes + triangle_bytes);
    }
    Ok(())
}

/// Brings a copy of a stream up to date; how many bytes that took.
fn update<T: Copy + Default>(copy: &mut Vec<T>, stream: &[T], changed: impl Iterator<Item = Range<u32>>) -> usize {
    copy.resize(stream.len(), T::default());
    let mut copied = 0;
    for range in changed {
        let (start, end) = (range.start as usize, (range.end as usize).min(stream.len()));
        if start < end {
            copy[start..end].copy_from_slice(&stream[start..end]);
            copied += (end - start) * size_of::<T>();
        }
    }
    copied
}
