//! `vdt bench blocking`: what the size and the shape of meta-nodes mean for the model file and for flights.
//!
//! For each mesh the tree is built once, and written with one blocking after the other. Over each of these models there
//! are three flights along the same path, that of the default blocking:
//! - with RAM for the whole model, so that no page is read twice;
//! - within the budget, each page read when it is missing, so that the flight is the same each time;
//! - within the budget, with the I/O thread and in time, which may miss pages.
//!
//! *Bytes of the records used*: how many different splits were applied at the end of any frame, times the bytes that a
//! record of the model takes in the file on average, page headers included. What was read is held against it.
//!
//! RAM: what building takes (`--build-memory`), then what the whole model takes decoded.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Result, bail};
use metanode::header::Blocking;
use metanode::model::Model;
use metanode::{ModelOptions, ModelStatistics, WriteResources, statistics, write_model};
use navigator::{Camera, FlightSummary, NavigatorError, NavigatorOptions};
use serde_json::{Value, json};
use storage::{EdgeTreeKind, LocalDisk, Scratch};
use vdt::build::{BuildOptions, BuildReport, build};
use vdt::tree::{ErrorBound, Metric, StoredTree, Strategy};

use super::child::Workshop;
use super::figures::{float_cell, whole_cell};
use super::flight::{Flight, PageSizes, fly_in_time};
use super::machine::Machine;
use super::{check_files, mesh_name, plot, workshop_parent, write_plot};
use crate::arguments::BlockingBenchOptions;
use crate::compare::{available_threads, is_model};
use crate::output::{counted, grouped};
use crate::progress::Progress;
use crate::table::Table;

/// A mesh or model that was measured.
#[derive(Debug)]
pub struct Subject {
    /// Name of its file.
    pub name: String,
    file: String,
    /// The blockings in turn, or why there are none.
    pub outcome: Result<Vec<Row>, String>,
}

/// A blocking of a mesh, and what became of it.
#[derive(Debug)]
pub struct Row {
    /// The blocking.
    pub blocking: Blocking,
    /// What was measured.
    pub outcome: Outcome,
}

/// What became of a blocking.
#[derive(Debug)]
pub enum Outcome {
    /// It was measured.
    Measured(Box<Measured>),
    /// The budget is too little for place holders of this size, for this reason.
    Refused(String),
    /// Something else went wrong.
    Failed(String),
}

/// What was measured of a model.
#[derive(Debug)]
pub struct Measured {
    /// Bytes of a decoded page at the most.
    pub slot_bytes: u32,
    vertices: u32,
    triangles: u32,
    page_levels: u32,
    model_bytes: u64,
    statistics: ModelStatistics,
    sizes: PageSizes,
    /// With RAM for everything.
    whole: Flight,
    /// Within the budget.
    pub budget: Flight,
    /// Within the budget, in time.
    in_time: FlightSummary,
}

impl Measured {
    fn bytes_per_vertex(&self) -> f64 {
        self.model_bytes as f64 / f64::from(self.vertices.max(1))
    }
}

pub fn run(options: &BlockingBenchOptions, json: bool) -> Result<()> {
    let inputs: Vec<&Path> = options.files.iter().map(AsRef::as_ref).collect();
    check_files(&inputs, options.plot.as_deref(), options.shared.force)?;
    let workshop = Workshop::new(&workshop_parent(options.shared.scratch.as_deref()))?;
    let progress = Progress::new("measuring");
    let mut subjects = Vec::new();
    for (number, file) in inputs.iter().enumerate() {
        let show = |share: f64| progress.show((number as f64 + share) / inputs.len() as f64);
        let outcome = if is_model(file)? {
            measure_model(options, file).map(|row| vec![row])
        } else {
            measure_mesh(options, &workshop, file, &show)
        };
        subjects.push(Subject {
            name: mesh_name(file),
            file: file.display().to_string(),
            outcome: outcome.map_err(|error| format!("{error:#}")),
        });
    }
    drop(progress);
    drop(workshop);

    if let Some(path) = &options.plot {
        let title = format!("A flight in {} at {} pixel(s)", options.memory, options.picture.pixels);
        write_plot(path, &plot::reads_against_slots(&subjects, &title)?)?;
    }
    let mut out = io::stdout().lock();
    if json {
        writeln!(out, "{}", serde_json::to_string_pretty(&to_json(options, &subjects))?)?;
    } else {
        for subject in &subjects {
            write!(out, "{}", text(subject))?;
        }
        writeln!(out, "{}", legend(options))?;
    }
    let failed = subjects.iter().map(failures).sum();
    match failed {
        0 => Ok(()),
        _ => bail!("{} failed", counted(failed, "measurement", "measurements")),
    }
}

/// How many of a subject's measurements failed. A refusal is none.
fn failures(subject: &Subject) -> u64 {
    match &subject.outcome {
        Ok(rows) => rows.iter().filter(|row| matches!(row.outcome, Outcome::Failed(_))).count() as u64,
        Err(_) => 1,
    }
}

/// A model as it is blocked.
fn measure_model(options: &BlockingBenchOptions, file: &Path) -> Result<Row> {
    let model = Model::open(&LocalDisk, file)?;
    let cameras = options.path.cameras(&LocalDisk, &model)?;
    Ok(Row { blocking: model.header().blocking, outcome: outcome(measure(options, model, &cameras)) })
}

/// A mesh, built once and blocked in all ways asked for.
fn measure_mesh(
    options: &BlockingBenchOptions,
    workshop: &Workshop,
    mesh: &Path,
    progress: &dyn Fn(f64),
) -> Result<Vec<Row>> {
    let blockings = options.blockings();
    let steps = (blockings.len() + 2) as f64;
    let build_options = BuildOptions {
        memory: options.build_memory,
        threads: options.shared.threads.map_or_else(available_threads, usize::from),
        metric: Metric::Quadric,
        strategy: Strategy::Passes,
        error_bound: ErrorBound::default(),
        edge_tree: EdgeTreeKind::default(),
        positions: options.positions,
        attributes: false,
    };
    let disk = Arc::new(LocalDisk);
    let (scratch, _) = Scratch::open(disk.clone(), &workshop.folder().join("scratch"), "")?;
    let (tree, report) = build(&LocalDisk, &[PathBuf::from(mesh)], &build_options, &scratch, None, &mut |_| ())?;
    progress(1.0 / steps);
    let model = workshop.folder().join("model.vdt");
    let write = |blocking| write(&model, &tree, &report, blocking, &build_options, &scratch);
    // A flight over the surface passes points of root pages: all blockings are flown over along the path of the default one.
    write(Blocking::default())?;
    let cameras = options.path.cameras(&LocalDisk, &Model::open(&LocalDisk, &model)?)?;
    let mut rows = Vec::new();
    for (number, blocking) in blockings.into_iter().enumerate() {
        progress((number + 2) as f64 / steps);
        let measured = write(blocking).and_then(|()| measure(options, Model::open(&LocalDisk, &model)?, &cameras));
        rows.push(Row { blocking, outcome: outcome(measured) });
    }
    drop(tree);
    scratch.discard_checkpoint()?;
    Ok(rows)
}

/// Writes the model with one blocking, in place of the one before.
fn write(
    model: &Path,
    tree: &StoredTree,
    report: &BuildReport,
    blocking: Blocking,
    built: &BuildOptions,
    scratch: &Scratch,
) -> Result<()> {
    let options = ModelOptions {
        blocking,
        metric: built.metric,
        strategy: built.strategy,
        error_bound: built.error_bound,
        input_error: report.input_error,
        positions: report.positions,
    };
    let resources = WriteResources { scratch: scratch.clone(), memory: built.memory, threads: built.threads };
    write_model(Arc::new(LocalDisk), model, tree, &options, &resources, &mut |_| ())?;
    Ok(())
}

fn measure(options: &BlockingBenchOptions, model: Model, cameras: &[Camera]) -> Result<Measured> {
    let model = Arc::new(model);
    let (statistics, sizes) = (statistics(&model)?, PageSizes::of(&model)?);
    let flight = NavigatorOptions {
        memory: options.memory.0,
        pixels: options.picture.pixels,
        width: options.picture.size.width,
        height: options.picture.size.height,
        max_adapts: None,
        ..NavigatorOptions::default()
    };
    // The one that may be refused goes first.
    let budget = Flight::fly(&model, &sizes, cameras, flight.clone())?;
    let whole = Flight::fly(&model, &sizes, cameras, NavigatorOptions { memory: u64::MAX, ..flight.clone() })?;
    let in_time = fly_in_time(&model, cameras, flight, options.frame_rate)?;
    let header = model.header();
    Ok(Measured {
        slot_bytes: header.slot_bytes,
        vertices: header.leaf_count,
        triangles: header.triangle_count,
        page_levels: header.page_levels,
        model_bytes: header.file_length,
        statistics,
        sizes,
        whole,
        budget,
        in_time,
    })
}

fn outcome(measured: Result<Measured>) -> Outcome {
    match measured {
        Ok(measured) => Outcome::Measured(Box::new(measured)),
        Err(error) if matches!(error.downcast_ref(), Some(NavigatorError::Budget(_))) => {
            Outcome::Refused(error.to_string())
        }
        Err(error) => Outcome::Failed(format!("{error:#}")),
    }
}

/// The tables of a mesh, under its name.
fn text(subject: &Subject) -> String {
    let rows = match &subject.outcome {
        Ok(rows) => rows,
        Err(complaint) => return format!("{}  failed: {complaint}\n\n", subject.name),
    };
    let size = rows.iter().find_map(|row| match &row.outcome {
        Outcome::Measured(measured) => Some((u64::from(measured.triangles), u64::from(measured.vertices))),
        Outcome::Refused(_) | Outcome::Failed(_) => None,
    });
    let size = size.map_or(String::new(), |(triangles, vertices)| {
        format!(": {}, {}", counted(triangles, "triangle", "triangles"), counted(vertices, "vertex", "vertices"))
    });
    let tables = [model_table(rows), cut_table(rows), flight_table(rows)].map(|table| table.text()).join("\n");
    format!("{}{size}\n{tables}\n", subject.name)
}

/// A line for each blocking: its cells, or in the first of the tables why there are none.
fn lines(table: &mut Table, rows: &[Row], is_first: bool, cells: impl Fn(&Measured) -> Vec<String>) {
    for row in rows {
        let mut line = vec![row.blocking.to_string()];
        match &row.outcome {
            Outcome::Measured(measured) => line.extend(cells(measured)),
            Outcome::Refused(complaint) if is_first => line.push(format!("refused: {complaint}")),
            Outcome::Failed(complaint) if is_first => line.push(format!("failed: {complaint}")),
            Outcome::Refused(_) | Outcome::Failed(_) => continue,
        }
        table.line(line);
    }
}

fn percent_cell(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

fn kibibytes_cell(bytes: f64) -> String {
    float_cell(Some(bytes / 1024.0))
}

/// What the model is like.
fn model_table(rows: &[Row]) -> Table {
    let mut table = Table::new(&[
        "blocking",
        "pages",
        "levels",
        "slot KiB",
        "page KiB",
        "fill %",
        "path",
        "longest",
        "B/vertex",
        "decode ns",
    ]);
    lines(&mut table, rows, true, |measured| {
        let Measured { statistics, sizes, .. } = measured;
        vec![
            grouped(statistics.pages),
            measured.page_levels.to_string(),
            kibibytes_cell(measured.slot_bytes.into()),
            kibibytes_cell(sizes.encoded_mean()),
            percent_cell(statistics.mean_fill),
            float_cell(Some(statistics.pages_per_path)),
            statistics.longest_path.to_string(),
            float_cell(Some(measured.bytes_per_vertex())),
            float_cell(Some(sizes.decode_nanoseconds())),
        ]
    });
    table
}

/// What a flight with RAM for everything uses and reads.
fn cut_table(rows: &[Row]) -> Table {
    let mut table = Table::new(&[
        "all in RAM",
        "pages/cut",
        "KiB/cut",
        "decoded",
        "used %",
        "pages/frame",
        "KiB/frame",
        "needed/used",
        "read/used",
    ]);
    lines(&mut table, rows, false, |Measured { whole, .. }| {
        vec![
            float_cell(Some(whole.pages_per_cut())),
            kibibytes_cell(whole.encoded_per_cut()),
            kibibytes_cell(whole.decoded_per_cut()),
            percent_cell(whole.used_share()),
            float_cell(Some(whole.reads_per_frame())),
            kibibytes_cell(whole.bytes_per_frame()),
            float_cell(whole.needed_over_used()),
            float_cell(whole.read_over_used()),
        ]
    });
    table
}

/// What a flight within the budget reads and draws.
fn flight_table(rows: &[Row]) -> Table {
    let mut table = Table::new(&[
        "in the budget",
        "holders",
        "pages/frame",
        "KiB/frame",
        "read/used",
        "triangles",
        "error x",
        "CPU ms",
        "misses %",
    ]);
    lines(&mut table, rows, false, |Measured { budget, in_time, .. }| {
        vec![
            whole_cell(Some(budget.place_holders as u64)),
            float_cell(Some(budget.reads_per_frame())),
            kibibytes_cell(budget.bytes_per_frame()),
            float_cell(budget.read_over_used()),
            grouped(budget.summary.triangles_mean() as u64),
            float_cell(Some(budget.summary.threshold_factor.into())),
            float_cell(Some(budget.summary.cpu_ms_mean())),
            float_cell(Some(in_time.miss_percent())),
        ]
    });
    table
}

/// What the columns are, and how and on what they were measured.
fn legend(options: &BlockingBenchOptions) -> String {
    format!(
        "page: its mean size in the file; fill: of decoded pages, as a part of the slot; path: pages from a root to a leaf, mean\n\
         and most; decode: CPU time of reading and decoding a record. pages/cut: those in use after a frame, with their KiB in\n\
         the file and decoded; used: the share of their records that is applied. pages/frame, KiB/frame: read from disk.\n\
         needed: bytes of the pages ever in use; read: bytes read, what is prefetched included; both for each byte of the\n\
         records ever applied, of the model's mean size. holders: place holders; error x: by how much the budget raised the\n\
         error at most; CPU: of a frame, with reading and decoding; misses: of the requests, with an I/O thread, at {} frames\n\
         a second. Path {}, {} pixel(s), {} of RAM, on {}.",
        options.frame_rate,
        options.path,
        options.picture.pixels,
        options.memory,
        Machine::this().text(),
    )
}

fn to_json(options: &BlockingBenchOptions, subjects: &[Subject]) -> Value {
    json!({
        "machine": Machine::this().to_json(),
        "path": options.path.to_string(),
        "pixels": options.picture.pixels,
        "memory_bytes": options.memory.0,
        "frames_per_second": options.frame_rate,
        "positions": options.positions.to_string(),
        "rows": subjects.iter().flat_map(subject_json).collect::<Vec<_>>(),
    })
}

fn subject_json(subject: &Subject) -> Vec<Value> {
    let named = || json!({ "mesh": subject.name, "file": subject.file });
    match &subject.outcome {
        Ok(rows) => rows.iter().map(|row| row_json(named(), row)).collect(),
        Err(complaint) => {
            let mut row = named();
            row["error"] = complaint.as_str().into();
            vec![row]
        }
    }
}

fn row_json(mut document: Value, row: &Row) -> Value {
    document["blocking"] = row.blocking.to_string().into();
    let measured = match &row.outcome {
        Outcome::Measured(measured) => measured,
        Outcome::Refused(complaint) => {
            document["refused"] = complaint.as_str().into();
            return document;
        }
        Outcome::Failed(complaint) => {
            document["error"] = complaint.as_str().into();
            return document;
        }
    };
    let Measured { statistics, sizes, in_time, .. } = measured.as_ref();
    document["vertices"] = measured.vertices.into();
    document["triangles"] = measured.triangles.into();
    document["model_bytes"] = measured.model_bytes.into();
    document["bytes_per_vertex"] = measured.bytes_per_vertex().into();
    document["pages"] = statistics.pages.into();
    document["page_levels"] = measured.page_levels.into();
    document["slot_bytes"] = measured.slot_bytes.into();
    document["page_bytes_mean"] = sizes.encoded_mean().into();
    document["record_bytes_mean"] = sizes.record_bytes().into();
    document["fill_mean"] = statistics.mean_fill.into();
    document["pages_per_path_mean"] = statistics.pages_per_path.into();
    document["pages_per_path_max"] = statistics.longest_path.into();
    document["decode_ns_per_record"] = sizes.decode_nanoseconds().into();
    document["frames"] = measured.budget.summary.frames().into();
    document["all_in_ram"] = measured.whole.to_json();
    document["in_budget"] = measured.budget.to_json();
    document["in_time"] = json!({
        "triangles_mean": in_time.triangles_mean(),
        "miss_percent": in_time.miss_percent(),
        "reads": in_time.pool.reads,
        "bytes_read": in_time.pool.bytes_read,
        "urgent": in_time.pool.urgent,
        "cpu_ms_mean": in_time.cpu_ms_mean(),
        "frame_ms_p99": in_time.frame_ms_percentile(99.0),
    });
    document
}
