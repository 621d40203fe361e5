//! `vdt bench error`: what a model states of the errors of its cuts, against what is measured.
//!
//! A cut states how far, at most, any point of the input mesh is from it ([`metanode::statement`]). Whether that is so is measured by [`vdt::compare`], which knows nothing of how the model was built. A measured maximum is a
//! distance that was found, so a statement that it exceeds is wrong; allowed for rounding are 10^-6 of the statement and
//! 10^-7 of the diagonal. The way back, from the cut to the input, is measured too; only where the model's bound is two-sided
//! anything is stated of it, the same for what is drawn.
//!
//! A half of the cuts has the same detail everywhere, the others are those of cameras. Cuts that have no triangles, or that
//! are the input itself, are counted and left out.

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use serde_json::{Value, json};
use storage::{ByteSize, LocalDisk, Scratch};
use vdt::compare::{CompareError, Effort, Resources, Surface, Target, one_sided};

use super::child::Workshop;
use super::cuts::{Cut, Cutter, Kind};
use super::figures::float_cell;
use super::machine::Machine;
use super::{check_files, mesh_name, plot, workshop_parent, write_plot};
use crate::arguments::ErrorBenchOptions;
use crate::compare::{available_threads, refuse_a_model};
use crate::output::{grouped, length};
use crate::progress::Progress;
use crate::table::{Table, UNKNOWN};

/// What rounding may do: relative to what is stated, and to the diagonal.
const ROUNDING: [f64; 2] = [1e-6, 1e-7];
/// The least memory: three eighths of it are enough to read a cut.
const SMALLEST_MEMORY: ByteSize = ByteSize(32 << 20);

/// A cut, what it states, and what was measured.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// What kind of cut it is.
    pub kind: Kind,
    /// Its triangles.
    pub triangles: u64,
    /// The largest distance from the input to the cut, as stated.
    stated: f64,
    /// The same for the parts that are drawn.
    stated_drawn: f64,
    /// Parts that are not drawn at all.
    vanished: u32,
    /// Whether the statement is said to be proven.
    is_guaranteed: bool,
    /// Whether it is about the way back, too.
    is_two_sided: bool,
    /// The same, as measured: it is no smaller.
    measured: f64,
    /// It is no larger.
    measured_at_most: f64,
    /// The largest distance from the cut to the input, as measured.
    reverse: f64,
    /// Whether more was measured than stated.
    pub is_violation: bool,
}

impl Row {
    /// What is stated, for each unit of what is measured.
    pub fn ratio(&self) -> Option<f64> {
        (self.measured > 0.0).then(|| self.stated / self.measured)
    }
}

/// What was measured in all.
struct Measured {
    rows: Vec<Row>,
    /// Cuts without triangles, or without an error.
    skipped: u64,
    input_triangles: u64,
    diagonal: f64,
}

pub fn run(options: &ErrorBenchOptions, json: bool) -> Result<()> {
    check_files(&[&options.model, &options.mesh], options.plot.as_deref(), options.shared.force)?;
    refuse_a_model(&options.mesh)?;
    let measured = measure(options)?;
    if let Some(path) = &options.plot {
        let title = format!("Stated errors of {}, against measured ones", mesh_name(&options.model));
        write_plot(path, &plot::ratios(&measured.rows, &title)?)?;
    }
    let mut out = io::stdout().lock();
    if json {
        writeln!(out, "{}", serde_json::to_string_pretty(&to_json(options, &measured))?)?;
    } else {
        let Measured { rows, skipped, input_triangles, diagonal } = &measured;
        write!(out, "{}\n{}", table(rows, *diagonal).text(), summary_table(rows).text())?;
        writeln!(
            out,
            "\nvanished: parts that are not drawn at all; stated: how far the input is from the cut, at most; measured: the\n\
             largest distance that was found, and beside it what no distance can exceed; reverse: from the cut to the input, of\n\
             which nothing is stated but with a two-sided bound. In % of the diagonal, {}. ratio: stated for measured; below 1 the statement is wrong.\n\
             {} of {} triangles against {}; {} samples each; {skipped} cuts were left out. On {}.",
            length(*diagonal),
            mesh_name(&options.mesh),
            grouped(*input_triangles),
            mesh_name(&options.model),
            grouped(options.samples),
            Machine::this().text(),
        )?;
    }
    Ok(())
}

fn measure(options: &ErrorBenchOptions) -> Result<Measured> {
    let memory = options.memory;
    if memory < SMALLEST_MEMORY {
        return Err(CompareError::Memory { needed: SMALLEST_MEMORY, memory }.into());
    }
    let workshop = Workshop::new(&workshop_parent(options.shared.scratch.as_deref()))?;
    let (scratch, _) = Scratch::open(Arc::new(LocalDisk), &workshop.folder().join("scratch"), "")?;
    let file = workshop.folder().join("cut.ply");
    let threads = options.shared.threads.map_or_else(available_threads, usize::from);
    let progress = Progress::new("measuring");

    // The input holds three sixteenths of the memory, its boxes an eighth; a cut and its boxes less than that.
    let read = |path: &Path, memory| Surface::read(&LocalDisk, path, &Resources { scratch: &scratch, memory, threads });
    let input = read(&options.mesh, ByteSize(memory.0 / 2))?;
    let input_target = Target::new(&input, memory.0 / 8)?;
    let diagonal = input.diagonal();
    let cutter = Cutter::open(&options.model, options.cuts, memory.0 / 8 * 3)?;
    let cache_bytes = usize::try_from(memory.0 / 8).unwrap_or(usize::MAX);
    let effort = Effort { samples: options.samples, threads, cache_bytes };
    let (mut rows, mut skipped) = (Vec::new(), 0);
    let cuts = Kind::ALL.into_iter().flat_map(|kind| (0..options.cuts).map(move |number| (kind, number)));
    for (done, (kind, number)) in (0..).zip(cuts) {
        progress.show(f64::from(done) / f64::from(2 * options.cuts));
        let Cut { triangles, said } = cutter.write(kind, number, &file)?;
        let stated = f64::from(said.error_stated);
        if triangles == 0 || stated == 0.0 {
            skipped += 1;
        } else {
            let cut = read(&file, ByteSize(memory.0 / 8 * 3))?;
            let forward = one_sided(&input, &Target::new(&cut, memory.0 / 8)?, effort, &mut |_| ())?;
            let back = one_sided(&cut, &input_target, effort, &mut |_| ())?;
            let exceeds = |measured: f64, stated: f64| measured > stated * (1.0 + ROUNDING[0]) + ROUNDING[1] * diagonal;
            let stated_drawn = f64::from(said.error_drawn);
            let is_violation = exceeds(forward.max, stated) || said.is_two_sided && exceeds(back.max, stated_drawn);
            rows.push(Row {
                kind,
                triangles,
                stated,
                stated_drawn,
                is_two_sided: said.is_two_sided,
                vanished: said.vanished_parts,
                is_guaranteed: said.guaranteed,
                measured: forward.max,
                measured_at_most: forward.max_at_most,
                reverse: back.max,
                is_violation,
            });
        }
        std::fs::remove_file(&file)?;
    }
    Ok(Measured { rows, skipped, input_triangles: input.triangle_count(), diagonal })
}

fn table(rows: &[Row], diagonal: f64) -> Table {
    let mut table = Table::new(&[
        "cut",
        "triangles",
        "vanished",
        "stated %",
        "measured %",
        "at most %",
        "ratio",
        "reverse %",
        "violation",
    ]);
    let percent = |value: f64| format!("{:.5}", 100.0 * value / diagonal);
    for row in rows {
        table.line(vec![
            row.kind.name().into(),
            grouped(row.triangles),
            grouped(row.vanished.into()),
            percent(row.stated),
            percent(row.measured),
            percent(row.measured_at_most),
            float_cell(row.ratio()),
            percent(row.reverse),
            if row.is_violation { "yes".into() } else { UNKNOWN.into() },
        ]);
    }
    table
}

/// What is said of the cuts of one kind.
struct Summary {
    kind: Kind,
    cuts: usize,
    violations: usize,
    /// Smallest, median, 90th percentile and largest ratio.
    ratios: [Option<f64>; 4],
}

fn summaries(rows: &[Row]) -> [Summary; 2] {
    Kind::ALL.map(|kind| {
        let own = || rows.iter().filter(move |row| row.kind == kind);
        let mut ratios: Vec<f64> = own().filter_map(Row::ratio).collect();
        ratios.sort_by(f64::total_cmp);
        let at = |share: f64| ratios.get((share * ratios.len().saturating_sub(1) as f64).round() as usize).copied();
        Summary {
            kind,
            cuts: own().count(),
            violations: own().filter(|row| row.is_violation).count(),
            ratios: [0.0, 0.5, 0.9, 1.0].map(at),
        }
    })
}

fn summary_table(rows: &[Row]) -> Table {
    let mut table = Table::new(&["cuts", "number", "violations", "least ratio", "median", "90 %", "largest"]);
    for Summary { kind, cuts, violations, ratios } in summaries(rows) {
        let counts = [kind.name().into(), cuts.to_string(), violations.to_string()];
        table.line(counts.into_iter().chain(ratios.map(float_cell)).collect());
    }
    table
}

fn to_json(options: &ErrorBenchOptions, measured: &Measured) -> Value {
    let row_json = |row: &Row| {
        json!({
            "kind": row.kind.name(),
            "triangles": row.triangles,
            "error_stated": row.stated,
            "error_drawn": row.stated_drawn,
            "vanished_parts": row.vanished,
            "guaranteed": row.is_guaranteed,
            "two_sided": row.is_two_sided,
            "input_to_cut_max": row.measured,
            "input_to_cut_max_at_most": row.measured_at_most,
            "cut_to_input_max": row.reverse,
            "ratio": row.ratio(),
            "violation": row.is_violation,
        })
    };
    let summary_json = |summary: &Summary| {
        let [least, median, p90, largest] = summary.ratios;
        json!({
            "kind": summary.kind.name(),
            "cuts": summary.cuts,
            "violations": summary.violations,
            "ratio_min": least,
            "ratio_median": median,
            "ratio_p90": p90,
            "ratio_max": largest,
        })
    };
    json!({
        "machine": Machine::this().to_json(),
        "model": options.model.display().to_string(),
        "mesh": options.mesh.display().to_string(),
        "input_triangles": measured.input_triangles,
        "diagonal": measured.diagonal,
        "samples": options.samples,
        "memory_bytes": options.memory.0,
        "skipped": measured.skipped,
        "violations": measured.rows.iter().filter(|row| row.is_violation).count(),
        "rows": measured.rows.iter().map(row_json).collect::<Vec<_>>(),
        "summary": summaries(&measured.rows).iter().map(summary_json).collect::<Vec<_>>(),
    })
}
