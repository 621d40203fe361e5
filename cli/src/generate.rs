//! `vdt generate`: test meshes of any size.

use std::sync::Arc;
use std::time::Instant;

use anyhow::Result;
use serde_json::json;
use storage::{ByteSize, LocalDisk};
use vdt::generate::{GenerateOptions, generate};

use crate::arguments;
use crate::output::{Report, counted, may_write};
use crate::progress::Progress;

pub fn run(options: arguments::GenerateOptions, json: bool) -> Result<()> {
    may_write(&LocalDisk, &options.output, options.force, &[])?;
    let start = Instant::now();
    let progress = Progress::new("generating");
    let what = GenerateOptions { shape: options.shape, triangles: options.triangles, seed: options.seed };
    let summary = generate(Arc::new(LocalDisk), &options.output, &what, &mut |share| progress.show(share))?;
    drop(progress);
    let seconds = start.elapsed().as_secs_f64();

    let mut report = Report::default();
    report.line("mesh", options.output.display());
    report.line("triangles", counted(summary.triangles, "triangle", "triangles"));
    report.line("vertices", counted(summary.vertices, "vertex", "vertices"));
    report.line("size", ByteSize(summary.bytes));
    report.line("time", format!("{seconds:.1} s"));
    report.print(
        json,
        &json!({
            "vertices": summary.vertices,
            "triangles": summary.triangles,
            "bytes": summary.bytes,
            "seconds": seconds,
            "peak_rss_bytes": storage::usage::peak_resident_bytes(),
        }),
    )
}
