//! `vdt bench dependency`: what the implicit dependency, `flip` and none cost, and how many triangles each of them draws the wrong
//! way round.
//!
//! Each model is flown over with each, along the same path, with the same error and RAM for all of it. Every page that is missing
//! is read at once; the path is flown once without counting before, so that no page is missing where frames are timed.
//!
//! A triangle is *flipped* where its normal is more than 90 degrees from that of the input triangle that it stands for. That is
//! found by brute force, from the positions of all leaves. RAM, beside the navigator's: 12 bytes for each leaf.

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use metanode::chain::PageChain;
use metanode::header::ModelError;
use metanode::model::Model;
use navigator::{Camera, Dependency, FlightSummary, Io, Navigator, NavigatorError, NavigatorOptions};
use serde_json::{Value, json};
use storage::LocalDisk;

use super::machine::Machine;
use super::{check_files, mesh_name};
use crate::arguments::{DependencyBenchOptions, DependencyName};
use crate::output::grouped;
use crate::progress::Progress;
use crate::table::Table;

/// What is compared, in this order.
const COMPARED: [DependencyName; 3] = [DependencyName::Implicit, DependencyName::Flip, DependencyName::None];

/// Where the leaves of a model are, relative to its origin, by their numbers.
struct Leaves {
    positions: Vec<[f32; 3]>,
}

impl Leaves {
    /// Reads every page.
    fn of(model: &Model) -> Result<Self, ModelError> {
        let mut positions = vec![[0.0; 3]; model.header().leaf_count as usize];
        let mut place = |leaf: u32, position: [f32; 3]| {
            // A page that was read has no leaf that the model has not.
            if let Some(place) = positions.get_mut(leaf as usize) {
                *place = position;
            }
        };
        model.roots().iter().for_each(|root| place(root.start, root.position));
        let mut chain = PageChain::new(model);
        let mut stack: Vec<_> = model.root_pages().iter().rev().map(|page| (*page, None)).collect();
        while let Some((location, parent)) = stack.pop() {
            let page = chain.page(location, parent)?;
            let records = (0..page.counts().records as u16).filter_map(|index| page.record(index));
            records.for_each(|record| place(record.born_leaf, record.position));
            let first = stack.len();
            stack.extend(page.children().map(|child| (child, Some(location.number))));
            stack[first..].reverse();
        }
        Ok(Leaves { positions })
    }

    /// How many of the triangles that are drawn are flipped.
    fn flipped(&self, navigator: &Navigator) -> u64 {
        let position = |leaf: u32| self.positions.get(leaf as usize).copied().unwrap_or_default();
        let is_flipped = |triangle: &navigator::ActiveTriangle| {
            let (drawn, original) = (normal(triangle.positions), normal(triangle.source.map(position)));
            drawn.iter().zip(original).map(|(a, b)| a * b).sum::<f64>() < 0.0
        };
        navigator.triangles().filter(is_flipped).count() as u64
    }
}

/// The normal of a triangle, twice as long as its area.
fn normal(positions: [[f32; 3]; 3]) -> [f64; 3] {
    let [a, b, c] = positions.map(|position| position.map(f64::from));
    let [u, v] = [b, c].map(|to| [to[0] - a[0], to[1] - a[1], to[2] - a[2]]);
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

/// A flight over one model.
struct Row {
    dependency: DependencyName,
    summary: FlightSummary,
    /// Frames whose triangles were held against the input, and how many were flipped in all of them together.
    looked_at: u64,
    flipped: u64,
}

impl Row {
    fn flipped_mean(&self) -> f64 {
        self.flipped as f64 / self.looked_at.max(1) as f64
    }
}

/// The flights over one model.
struct Flights {
    model: Arc<Model>,
    rows: Vec<Row>,
}

pub fn run(options: &DependencyBenchOptions, json: bool) -> Result<()> {
    check_files(&options.models.iter().map(|model| model.as_path()).collect::<Vec<_>>(), None, false)?;
    let progress = Progress::new("flying");
    let all = (options.models.len() * COMPARED.len()) as f64;
    let mut flights = Vec::new();
    for (number, path) in options.models.iter().enumerate() {
        let model = Arc::new(Model::open(&LocalDisk, path)?);
        let cameras = options.path.cameras(&LocalDisk, &model)?;
        let leaves = Leaves::of(&model)?;
        let mut rows = Vec::new();
        for dependency in COMPARED {
            progress.show((number * COMPARED.len() + rows.len()) as f64 / all);
            rows.push(fly(options, &model, &cameras, &leaves, dependency)?);
        }
        flights.push(Flights { model, rows });
    }
    drop(progress);
    let mut out = io::stdout().lock();
    if json {
        writeln!(out, "{:#}", to_json(options, &flights))?;
    } else {
        write!(out, "{}", table(&flights).text())?;
        writeln!(
            out,
            "\nMeans of a frame: triangles, those flipped against the input, splits and collapses, forced splits, changes that\n\
             were blocked, triangles repaired; CPU time in milliseconds. Path {} at {} pixel(s), {} of RAM and 12 bytes for\n\
             each vertex to find what is flipped, in every {}. frame. {}.",
            options.path,
            options.picture.pixels,
            options.memory,
            options.every,
            Machine::this().text(),
        )?;
    }
    Ok(())
}

fn fly(
    options: &DependencyBenchOptions,
    model: &Arc<Model>,
    cameras: &[Camera],
    leaves: &Leaves,
    name: DependencyName,
) -> Result<Row, NavigatorError> {
    let navigator_options = NavigatorOptions {
        memory: options.memory.0,
        pixels: options.picture.pixels,
        width: options.picture.size.width,
        height: options.picture.size.height,
        dependency: Dependency::from(name),
        io: Io::Sync,
        ..NavigatorOptions::default()
    };
    let mut navigator = Navigator::open(model.clone(), navigator_options)?;
    for camera in cameras {
        navigator.frame(camera)?;
    }
    let mut row = Row { dependency: name, summary: FlightSummary::default(), looked_at: 0, flipped: 0 };
    for (number, camera) in cameras.iter().enumerate() {
        row.summary.add(&navigator.frame(camera)?);
        if number % options.every as usize == 0 {
            row.looked_at += 1;
            row.flipped += leaves.flipped(&navigator);
        }
    }
    Ok(row)
}

fn table(flights: &[Flights]) -> Table {
    let mut table = Table::new(&[
        "model",
        "dependency",
        "triangles",
        "flipped",
        "adapts",
        "forced",
        "blocked",
        "repaired",
        "left",
        "CPU ms",
        "median",
        "99 %",
        "error",
        "proven",
    ]);
    for Flights { model, rows } in flights {
        for row in rows {
            let summary = &row.summary;
            let mean = |sum: u64| format!("{:.1}", sum as f64 / summary.frames().max(1) as f64);
            table.line(vec![
                mesh_name(model.path()),
                row.dependency.to_string(),
                grouped(summary.triangles_mean() as u64),
                format!("{:.2}", row.flipped_mean()),
                grouped(summary.adapts_mean() as u64),
                mean(summary.forced),
                mean(summary.blocked),
                mean(summary.repaired),
                mean(summary.unrepaired),
                format!("{:.2}", summary.cpu_ms_mean()),
                format!("{:.2}", summary.cpu_ms_percentile(50.0)),
                format!("{:.2}", summary.cpu_ms_percentile(99.0)),
                format!("{:.3e}", summary.error_stated),
                if summary.guaranteed() { "yes" } else { "no" }.into(),
            ]);
        }
    }
    table
}

fn to_json(options: &DependencyBenchOptions, flights: &[Flights]) -> Value {
    let row_json = |path: &Path, row: &Row| {
        let summary = &row.summary;
        let mean = |sum: u64| sum as f64 / summary.frames().max(1) as f64;
        json!({
            "model": path.display().to_string(),
            "dependency": row.dependency.to_string(),
            "frames": summary.frames(),
            "triangles_mean": summary.triangles_mean(),
            "frames_looked_at": row.looked_at,
            "flipped_mean": row.flipped_mean(),
            "adapts_mean": summary.adapts_mean(),
            "forced_mean": mean(summary.forced),
            "blocked_mean": mean(summary.blocked),
            "repaired_mean": mean(summary.repaired),
            "unrepaired_mean": mean(summary.unrepaired),
            "cpu_ms_mean": summary.cpu_ms_mean(),
            "cpu_ms_p50": summary.cpu_ms_percentile(50.0),
            "cpu_ms_p99": summary.cpu_ms_percentile(99.0),
            "error_stated": summary.error_stated,
            "guaranteed": summary.guaranteed(),
            "threshold_factor_max": summary.threshold_factor,
        })
    };
    let rows = flights.iter().flat_map(|flights| flights.rows.iter().map(|row| row_json(flights.model.path(), row)));
    json!({
        "machine": Machine::this().to_json(),
        "path": options.path.to_string(),
        "pixels": options.picture.pixels,
        "memory_bytes": options.memory.0,
        "rows": rows.collect::<Vec<_>>(),
    })
}
