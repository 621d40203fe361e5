//! `vdt bench table1`: the paper's Table 1 on other meshes. For each mesh the time in which the view-dependence tree (VDT)
//! and the meta-nodes (MNT) are made, and the sizes of the mesh file, of the model file, and of what is in that, decoded:
//! tree (VDT), positions and triangles (DATA), directory of the meta-nodes (MNT). The paper has three files in place of
//! our one, which is coded. On top come CPU time, peak RAM, bytes moved and passes, which the paper does not give.

use std::ffi::OsString;
use std::io::{self, Write};
use std::path::Path;

use anyhow::{Context, Result, bail};
use metanode::model::Model;
use metanode::statistics;
use metanode::statistics::DecodedBytes;
use serde_json::{Value, json};
use storage::LocalDisk;

use super::child::Workshop;
use super::figures::{Figures, float_cell, mebibytes_cell, whole_cell};
use super::machine::Machine;
use super::{build_options, check_files, mesh_name, plot, workshop_parent, write_plot};
use crate::arguments::Table1Options;
use crate::output::counted;
use crate::progress::Progress;
use crate::table::Table;

/// A mesh and what became of it.
#[derive(Debug)]
pub struct Row {
    /// Name of the mesh.
    pub name: String,
    /// Its file.
    file: String,
    /// Bytes of the mesh file.
    input_bytes: Option<u64>,
    /// The build, or why there is none.
    pub outcome: Result<Built, String>,
}

/// A mesh that was built.
#[derive(Debug)]
pub struct Built {
    /// The run with the least CPU time.
    pub figures: Figures,
    /// CPU seconds of all runs, in order.
    cpu_seconds: Vec<Option<f64>>,
    /// What is in the model file, decoded.
    decoded: DecodedBytes,
    /// Bytes of the model file.
    model_bytes: u64,
}

pub fn run(options: &Table1Options, json: bool) -> Result<()> {
    let inputs: Vec<&Path> = options.meshes.iter().map(AsRef::as_ref).collect();
    check_files(&inputs, options.plot.as_deref(), options.shared.force)?;
    let mut all_options = options.strategy.options();
    all_options.extend(build_options(&[
        ("--memory", Some(options.memory.0.to_string())),
        ("--threads", options.shared.threads.map(|threads| threads.to_string())),
        ("--metric", Some(options.metric.to_string())),
        ("--error-bound", Some(options.error_bound.to_string())),
    ]));
    let workshop = Workshop::new(&workshop_parent(options.shared.scratch.as_deref()))?;
    let progress = Progress::new("building");
    let mut rows = Vec::new();
    for (number, mesh) in inputs.iter().enumerate() {
        progress.show(number as f64 / inputs.len() as f64);
        let input_bytes = std::fs::metadata(mesh).ok().map(|metadata| metadata.len());
        let outcome = build(&workshop, mesh, &all_options, options.runs)?;
        rows.push(Row { name: mesh_name(mesh), file: mesh.display().to_string(), input_bytes, outcome });
    }
    drop(progress);
    drop(workshop);

    if let Some(path) = &options.plot {
        let title =
            format!("Building by {} in {} of RAM: {}", options.strategy, options.memory, Machine::this().text());
        write_plot(path, &plot::times_per_triangle(&rows, &title)?)?;
    }
    let mut out = io::stdout().lock();
    if json {
        writeln!(out, "{}", serde_json::to_string_pretty(&to_json(options, &rows))?)?;
    } else {
        write!(out, "{}", paper_table(&rows).text())?;
        if rows.iter().any(|row| row.outcome.is_ok()) {
            write!(out, "\n{}\n{}\n", cost_table(&rows).text(), legend(options))?;
        }
    }
    let failed = rows.iter().filter(|row| row.outcome.is_err()).count() as u64;
    match failed {
        0 => Ok(()),
        _ => bail!("{} could not be built", counted(failed, "mesh", "meshes")),
    }
}

/// Builds a mesh so many times.
fn build(workshop: &Workshop, mesh: &Path, build_options: &[OsString], runs: u32) -> Result<Result<Built, String>> {
    let mut built: Vec<Figures> = Vec::new();
    for _ in 0..runs {
        match workshop.build(mesh, build_options)? {
            Ok(document) => built.push(Figures::new(document)),
            Err(complaint) => return Ok(Err(complaint)),
        }
    }
    let cpu_seconds: Vec<Option<f64>> = built.iter().map(|figures| figures.float("cpu_seconds")).collect();
    let order = |figures: &Figures| figures.float("cpu_seconds").unwrap_or(f64::INFINITY);
    let best = built.into_iter().min_by(|left, right| order(left).total_cmp(&order(right)));
    let figures = best.context("a mesh has to be built at least once")?;
    let statistics = statistics(&Model::open(&LocalDisk, &workshop.model())?)?;
    let (decoded, model_bytes) = (statistics.decoded, statistics.file.total());
    Ok(Ok(Built { figures, cpu_seconds, decoded, model_bytes }))
}

/// The columns of the paper's table, and a line for each mesh that could not be built.
fn paper_table(rows: &[Row]) -> Table {
    let columns =
        ["mesh", "triangles", "vertices", "VDT s", "MNT s", "input MiB", "VDT MiB", "DATA MiB", "MNT MiB", "model MiB"];
    let mut table = Table::new(&columns);
    for row in rows {
        let built = match &row.outcome {
            Ok(built) => built,
            Err(complaint) => {
                table.line(vec![row.name.clone(), format!("failed: {complaint}")]);
                continue;
            }
        };
        let figures = &built.figures;
        table.line(vec![
            row.name.clone(),
            whole_cell(figures.whole("triangles")),
            whole_cell(figures.whole("vertices")),
            float_cell(figures.tree_seconds()),
            float_cell(figures.meta_node_seconds()),
            mebibytes_cell(row.input_bytes),
            mebibytes_cell(Some(built.decoded.tree())),
            mebibytes_cell(Some(built.decoded.data())),
            mebibytes_cell(Some(built.decoded.page_headers)),
            mebibytes_cell(Some(built.model_bytes)),
        ]);
    }
    table
}

/// What building took, which the paper does not tell.
fn cost_table(rows: &[Row]) -> Table {
    let mut table =
        Table::new(&["mesh", "CPU s", "tri/CPU-s", "peak MiB", "scratch MiB", "read B/tri", "written B/tri", "passes"]);
    for row in rows {
        let Ok(Built { figures, .. }) = &row.outcome else { continue };
        let moved = figures.bytes_per_triangle();
        table.line(vec![
            row.name.clone(),
            float_cell(figures.float("cpu_seconds")),
            whole_cell(figures.triangles_per_cpu_second().map(|rate| rate as u64)),
            mebibytes_cell(figures.whole("peak_rss_bytes")),
            mebibytes_cell(figures.whole("scratch_peak_bytes")),
            whole_cell(moved.map(|[read, _]| read.round() as u64)),
            whole_cell(moved.map(|[_, written]| written.round() as u64)),
            whole_cell(figures.whole("passes")),
        ]);
    }
    table
}

/// What the columns are, and how and on what they were measured.
fn legend(options: &Table1Options) -> String {
    let threads = options.shared.threads.map_or(String::new(), |threads| format!(" --threads {threads}"));
    let runs = if options.runs > 1 {
        format!(" Of {} runs, that with the least CPU time.", options.runs)
    } else {
        String::new()
    };
    format!(
        "VDT   the tree: seconds of reading, collapsing and numbering; bytes of roots, records and child entries\n\
         DATA  positions and triangles\n\
         MNT   the meta-nodes: seconds of blocking and writing; bytes of page headers\n\
         Sizes of VDT, DATA and MNT are those once they are decoded; the model file is all three, coded. tri: triangles\n\
         of the input. Bytes read and written, CPU time and peak RAM are as the operating system counts them.{runs}\n\
         Built with --memory {}{threads} --strategy {} --metric {} --error-bound {} on {}.",
        options.memory.as_argument(),
        options.strategy,
        options.metric,
        options.error_bound,
        Machine::this().text(),
    )
}

fn to_json(options: &Table1Options, rows: &[Row]) -> Value {
    json!({
        "machine": Machine::this().to_json(),
        "memory_bytes": options.memory.0,
        "threads": options.shared.threads,
        "strategy": options.strategy.to_string(),
        "metric": options.metric.to_string(),
        "error_bound": options.error_bound.to_string(),
        "runs": options.runs,
        "rows": rows.iter().map(row_json).collect::<Vec<_>>(),
    })
}

fn row_json(row: &Row) -> Value {
    let built = match &row.outcome {
        Ok(built) => built,
        Err(complaint) => {
            return json!({
                "mesh": row.name,
                "file": row.file,
                "input_bytes": row.input_bytes,
                "error": complaint,
            });
        }
    };
    let figures = &built.figures;
    let moved = figures.bytes_moved();
    json!({
        "mesh": row.name,
        "file": row.file,
        "triangles": figures.whole("triangles"),
        "vertices": figures.whole("vertices"),
        "input_triangles": figures.whole("input_triangles"),
        "tree_seconds": figures.tree_seconds(),
        "meta_node_seconds": figures.meta_node_seconds(),
        "cpu_seconds": figures.float("cpu_seconds"),
        "cpu_seconds_of_runs": built.cpu_seconds,
        "triangles_per_cpu_second": figures.triangles_per_cpu_second(),
        "input_bytes": row.input_bytes,
        "model_bytes": built.model_bytes,
        "decoded_tree_bytes": built.decoded.tree(),
        "decoded_data_bytes": built.decoded.data(),
        "decoded_directory_bytes": built.decoded.page_headers,
        "peak_rss_bytes": figures.whole("peak_rss_bytes"),
        "scratch_peak_bytes": figures.whole("scratch_peak_bytes"),
        "bytes_read": moved.map(|[read, _]| read),
        "bytes_written": moved.map(|[_, written]| written),
        "passes": figures.whole("passes"),
        "phases": figures.phases_json(),
    })
}
