//! `vdt bench decode`: how fast the pages of a model are decoded, by one thread and by several.
//!
//! Every page of a model is read and decoded, with its ancestors at hand, several times over; of each number of threads the run
//! with the least CPU time counts. A record is a split: a vertex with its normal and its triangles.

use std::io::{self, Write};
use std::time::Instant;

use anyhow::Result;
use metanode::decode::{Decoded, decode_all};
use metanode::model::Model;
use serde_json::{Value, json};
use storage::LocalDisk;

use super::check_files;
use super::machine::Machine;
use crate::arguments::DecodeBenchOptions;
use crate::compare::available_threads;
use crate::output::grouped;
use crate::table::Table;

/// A number of threads, and what it came to.
struct Row {
    threads: usize,
    decoded: Decoded,
    /// Wall clock of the run with the least CPU time, in seconds.
    seconds: f64,
}

impl Row {
    fn per_cpu_second(&self) -> f64 {
        self.decoded.records as f64 / self.decoded.cpu.as_secs_f64().max(f64::MIN_POSITIVE)
    }

    fn per_second(&self) -> f64 {
        self.decoded.records as f64 / self.seconds.max(f64::MIN_POSITIVE)
    }
}

pub fn run(options: &DecodeBenchOptions, json: bool) -> Result<()> {
    check_files(&[&options.model], None, false)?;
    let model = Model::open(&LocalDisk, &options.model)?;
    let most = options.threads.map_or_else(available_threads, usize::from);
    let mut rows = Vec::new();
    for threads in 1..=most {
        let mut best: Option<Row> = None;
        for _ in 0..options.runs {
            let start = Instant::now();
            let decoded = decode_all(&model, threads)?;
            let row = Row { threads, decoded, seconds: start.elapsed().as_secs_f64() };
            if best.as_ref().is_none_or(|best| row.decoded.cpu < best.decoded.cpu) {
                best = Some(row);
            }
        }
        rows.extend(best);
    }
    if json { print_json(options, &rows) } else { print_text(options, &rows) }
}

fn print_text(options: &DecodeBenchOptions, rows: &[Row]) -> Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{}", Machine::this().text())?;
    if let Some(Row { decoded, .. }) = rows.first() {
        let (records, pages) = (grouped(decoded.records), grouped(decoded.pages));
        writeln!(out, "{}: {records} records in {pages} meta-nodes", options.model.display())?;
    }
    let mut table = Table::new(&["threads", "records per CPU-second", "records per second", "MiB read per second"]);
    for row in rows {
        table.line(vec![
            row.threads.to_string(),
            grouped(row.per_cpu_second() as u64),
            grouped(row.per_second() as u64),
            format!("{:.1}", row.decoded.bytes as f64 / row.seconds.max(f64::MIN_POSITIVE) / f64::from(1 << 20)),
        ]);
    }
    write!(out, "{}", table.text())?;
    Ok(())
}

fn print_json(options: &DecodeBenchOptions, rows: &[Row]) -> Result<()> {
    let rows: Vec<Value> = rows
        .iter()
        .map(|row| {
            json!({
                "threads": row.threads,
                "pages": row.decoded.pages,
                "records": row.decoded.records,
                "bytes_read": row.decoded.bytes,
                "cpu_seconds": row.decoded.cpu.as_secs_f64(),
                "seconds": row.seconds,
                "records_per_cpu_second": row.per_cpu_second(),
                "records_per_second": row.per_second(),
            })
        })
        .collect();
    let document =
        json!({ "machine": Machine::this().to_json(), "model": options.model.display().to_string(), "rows": rows });
    writeln!(io::stdout(), "{document:#}")?;
    Ok(())
}
