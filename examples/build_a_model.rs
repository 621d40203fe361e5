//! From a mesh file to a model file with the libraries.
//!
//!     cargo run --release -p vdt-examples --example build_a_model -- mesh.ply model.vdt

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result};
use metanode::header::{Blocking, ErrorBound, Metric, Strategy};
use metanode::{ModelOptions, WriteResources, write_model};
use storage::{ByteSize, EdgeTreeKind, LocalDisk};
use vdt::build::{BuildOptions, build};
use vdt::ingest::PositionsRule;

fn main() -> Result<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let mesh = arguments.next().context("which mesh?")?;
    let model = arguments.next().context("which model?")?;

    let options = BuildOptions {
        memory: ByteSize(256 << 20),
        threads: 1,
        metric: Metric::Quadric,
        strategy: Strategy::Passes,
        error_bound: ErrorBound::default(),
        edge_tree: EdgeTreeKind::default(),
        positions: PositionsRule::default(),
        attributes: true,
    };
    let (tree, report) = build(&LocalDisk, &[mesh], &options, &storage::Scratch::in_memory(), None, &mut |step| {
        eprint!("\r{:?} {:.0} %   ", step.phase, 100.0 * step.share);
    })?;

    let BuildOptions { metric, strategy, error_bound, .. } = options;
    let (blocking, input_error, positions) = (Blocking::default(), report.input_error, report.positions);
    let options = ModelOptions { blocking, metric, strategy, error_bound, input_error, positions };
    let resources = WriteResources::in_memory();
    let summary = write_model(Arc::new(LocalDisk), &model, &tree, &options, &resources, &mut |_| ())?;
    println!("\n{} collapses, {} meta-nodes, {} bytes", report.legal_collapses, summary.pages, summary.bytes);
    Ok(())
}
