//! `vdt bench io`: how many bytes a build moves for each triangle, against the memory that it may have, for each strategy.
//!
//! A strategy may refuse a limit as too small for it, with the limit that would do. That is a result; any other failure of
//! a build makes the bench end as failed, when all is measured.

use std::io::{self, Write};
use std::path::Path;

use anyhow::{Result, bail};
use serde_json::{Value, json};
use storage::ByteSize;

use super::child::Workshop;
use super::figures::{Figures, float_cell, mebibytes_cell, whole_cell};
use super::machine::Machine;
use super::strategy::StrategyChoice;
use super::{build_options, check_files, mesh_name, plot, workshop_parent, write_plot};
use crate::arguments::IoBenchOptions;
use crate::output::counted;
use crate::progress::Progress;
use crate::table::Table;

/// What became of one build.
#[derive(Debug)]
pub enum Outcome {
    /// It was done.
    Built(Box<Figures>),
    /// The strategy cannot do with so little memory, for this reason.
    Refused(String),
    /// Something else went wrong.
    Failed(String),
}

/// One build.
#[derive(Debug)]
pub struct Point {
    /// How it was built.
    pub strategy: StrategyChoice,
    /// What it was allowed.
    pub limit: ByteSize,
    /// What became of it.
    pub outcome: Outcome,
}

impl Point {
    /// Bytes read and written for each triangle of the input, together.
    pub fn bytes_per_triangle(&self) -> Option<f64> {
        match &self.outcome {
            Outcome::Built(figures) => figures.bytes_per_triangle().map(|[read, written]| read + written),
            Outcome::Refused(_) | Outcome::Failed(_) => None,
        }
    }
}

pub fn run(options: &IoBenchOptions, json: bool) -> Result<()> {
    check_files(&[&options.mesh], options.plot.as_deref(), options.shared.force)?;
    let workshop = Workshop::new(&workshop_parent(options.shared.scratch.as_deref()))?;
    let progress = Progress::new("building");
    let builds: Vec<(StrategyChoice, ByteSize)> = options
        .strategy
        .iter()
        .flat_map(|strategy| options.memory.iter().map(move |limit| (*strategy, *limit)))
        .collect();
    let mut points = Vec::new();
    for (number, (strategy, limit)) in builds.iter().copied().enumerate() {
        progress.show(number as f64 / builds.len() as f64);
        let outcome = build(&workshop, options, strategy, limit)?;
        points.push(Point { strategy, limit, outcome });
    }
    drop(progress);
    drop(workshop);

    if let Some(path) = &options.plot {
        let title = format!("Bytes moved by building {}", described(&options.mesh, &points));
        write_plot(path, &plot::bytes_against_memory(&options.strategy, &points, &title)?)?;
    }
    let mut out = io::stdout().lock();
    if json {
        writeln!(out, "{}", serde_json::to_string_pretty(&to_json(options, &points))?)?;
    } else {
        write!(out, "{}", table(&points).text())?;
        writeln!(
            out,
            "\nread, written, both: bytes for each triangle of the input, as the operating system counts them; so are CPU\n\
             time and peak RAM. Mesh: {}. Built with{} --error-bound {} on {}.",
            described(&options.mesh, &points),
            options.shared.threads.map_or(String::new(), |threads| format!(" --threads {threads}")),
            options.error_bound,
            Machine::this().text(),
        )?;
    }
    let failed = points.iter().filter(|point| matches!(point.outcome, Outcome::Failed(_))).count() as u64;
    match failed {
        0 => Ok(()),
        _ => bail!("{} failed", counted(failed, "build", "builds")),
    }
}

fn build(workshop: &Workshop, bench: &IoBenchOptions, strategy: StrategyChoice, limit: ByteSize) -> Result<Outcome> {
    let mut options = strategy.options();
    options.extend(build_options(&[
        ("--memory", Some(limit.0.to_string())),
        ("--threads", bench.shared.threads.map(|threads| threads.to_string())),
        ("--error-bound", Some(bench.error_bound.to_string())),
    ]));
    Ok(match workshop.build(&bench.mesh, &options)? {
        Ok(document) => Outcome::Built(Box::new(Figures::new(document))),
        // A build that says which memory would do has refused the one it was given.
        Err(complaint) if complaint.contains("--memory ") => Outcome::Refused(complaint),
        Err(complaint) => Outcome::Failed(complaint),
    })
}

/// The mesh, with its size where a build has told it.
fn described(mesh: &Path, points: &[Point]) -> String {
    let size = points.iter().find_map(|point| match &point.outcome {
        Outcome::Built(figures) => figures.whole("input_triangles"),
        Outcome::Refused(_) | Outcome::Failed(_) => None,
    });
    let name = mesh_name(mesh);
    size.map_or(name.clone(), |size| format!("{name} ({})", counted(size, "triangle", "triangles")))
}

fn table(points: &[Point]) -> Table {
    let mut table = Table::new(&[
        "strategy",
        "memory",
        "read B/tri",
        "written B/tri",
        "both B/tri",
        "CPU s",
        "seconds",
        "peak MiB",
        "scratch B/tri",
    ]);
    for point in points {
        let mut cells = vec![point.strategy.to_string(), point.limit.to_string()];
        match &point.outcome {
            Outcome::Built(figures) => {
                let moved = figures.bytes_per_triangle();
                let triangles = figures.whole("input_triangles").filter(|triangles| *triangles > 0);
                let scratch = figures.whole("scratch_peak_bytes").zip(triangles).map(|(bytes, all)| bytes / all);
                cells.extend([
                    whole_cell(moved.map(|[read, _]| read.round() as u64)),
                    whole_cell(moved.map(|[_, written]| written.round() as u64)),
                    whole_cell(point.bytes_per_triangle().map(|both| both.round() as u64)),
                    float_cell(figures.float("cpu_seconds")),
                    float_cell(figures.float("seconds")),
                    mebibytes_cell(figures.whole("peak_rss_bytes")),
                    whole_cell(scratch),
                ]);
            }
            Outcome::Refused(complaint) => cells.push(format!("refused: {complaint}")),
            Outcome::Failed(complaint) => cells.push(format!("failed: {complaint}")),
        }
        table.line(cells);
    }
    table
}

fn to_json(options: &IoBenchOptions, points: &[Point]) -> Value {
    json!({
        "machine": Machine::this().to_json(),
        "mesh": mesh_name(&options.mesh),
        "file": options.mesh.display().to_string(),
        "threads": options.shared.threads,
        "error_bound": options.error_bound.to_string(),
        "rows": points.iter().map(point_json).collect::<Vec<_>>(),
    })
}

fn point_json(point: &Point) -> Value {
    let mut row = json!({ "strategy": point.strategy.to_string(), "memory_bytes": point.limit.0 });
    let figures = match &point.outcome {
        Outcome::Built(figures) => figures,
        Outcome::Refused(complaint) => {
            row["refused"] = complaint.as_str().into();
            return row;
        }
        Outcome::Failed(complaint) => {
            row["error"] = complaint.as_str().into();
            return row;
        }
    };
    let (moved, each) = (figures.bytes_moved(), figures.bytes_per_triangle());
    row["input_triangles"] = json!(figures.whole("input_triangles"));
    row["bytes_read"] = json!(moved.map(|[read, _]| read));
    row["bytes_written"] = json!(moved.map(|[_, written]| written));
    row["bytes_read_per_triangle"] = json!(each.map(|[read, _]| read));
    row["bytes_written_per_triangle"] = json!(each.map(|[_, written]| written));
    row["seconds"] = json!(figures.float("seconds"));
    row["cpu_seconds"] = json!(figures.float("cpu_seconds"));
    row["peak_rss_bytes"] = json!(figures.whole("peak_rss_bytes"));
    row["scratch_peak_bytes"] = json!(figures.whole("scratch_peak_bytes"));
    row["passes"] = json!(figures.whole("passes"));
    row["model_sha256"] = figures.document()["model_sha256"].clone();
    row["phases"] = figures.phases_json();
    row
}
