//! `vdt compare`: how far two meshes are apart.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Result, bail};
use metanode::header::MAGIC;
use serde_json::{Value, json};
use storage::{ByteSize, Disk, LocalDisk, Scratch};
use vdt::compare::{Comparison, OneSided, compare};

use crate::arguments::CompareOptions;
use crate::output::{Report, counted, grouped, length};
use crate::progress::Progress;
use crate::table::Table;

pub fn run(options: &CompareOptions, json: bool) -> Result<()> {
    let start = Instant::now();
    let paths = [options.mesh_a.as_path(), options.mesh_b.as_path()];
    paths.into_iter().try_for_each(refuse_a_model)?;
    let parent = options.scratch.clone().unwrap_or_else(std::env::temp_dir);
    if !parent.is_dir() {
        bail!("{}: there is no such directory for the scratch", parent.display());
    }
    // Of this process alone: two comparisons may go on side by side.
    let folder = parent.join(format!("vdt-compare-{}.scratch", std::process::id()));
    let (scratch, _) = Scratch::open(Arc::new(LocalDisk), &folder, "")?;
    let progress = Progress::new("comparing");
    let compare_options = vdt::compare::CompareOptions {
        samples: options.samples,
        memory: options.memory,
        threads: options.threads.map_or_else(available_threads, usize::from),
        is_one_sided: options.one_sided,
        with_colours: !options.no_colours,
    };
    let found = compare(&LocalDisk, paths, &compare_options, &scratch, &mut |share| progress.show(share))?;
    drop(progress);
    drop(scratch);
    let costs = Costs {
        seconds: start.elapsed().as_secs_f64(),
        cpu_seconds: storage::usage::cpu_time().as_secs_f64(),
        peak: storage::usage::peak_resident_bytes(),
    };
    report(options, &found, &costs).print(json, &to_json(options, &found, &costs))
}

/// How many threads this machine runs at once.
pub fn available_threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Whether a file says that it is a model.
pub fn is_model(path: &Path) -> Result<bool> {
    let mut start = [0; MAGIC.len()];
    let count = LocalDisk.open(path)?.read_at(0, &mut start)?;
    Ok(start[..count] == MAGIC)
}

/// A model holds many meshes; which one is meant has to be said.
pub fn refuse_a_model(path: &Path) -> Result<()> {
    if is_model(path)? {
        bail!(
            "{}: this is a model, not a mesh; take a level of detail out of it first, as in `vdt extract {} -o mesh.ply \
             --error 0`",
            path.display(),
            path.display()
        );
    }
    Ok(())
}

/// What the comparison took.
struct Costs {
    seconds: f64,
    cpu_seconds: f64,
    peak: Option<u64>,
}

fn report(options: &CompareOptions, found: &Comparison, costs: &Costs) -> Report {
    let Comparison { a_to_b, b_to_a, diagonal, triangles, .. } = found;
    let mut report = Report::default();
    for (name, path, triangles) in [("A", &options.mesh_a, triangles[0]), ("B", &options.mesh_b, triangles[1])] {
        report.line(name, format!("{}: {}", path.display(), counted(triangles, "triangle", "triangles")));
    }
    let percent = |value: f64| format!("{:.4} %", 100.0 * value / diagonal);
    let mut table = Table::new(&["", "mean", "rms", "max", "max at most"]);
    let directions = [("A to B", Some(a_to_b)), ("B to A", b_to_a.as_ref())];
    for (name, side) in directions.into_iter().filter_map(|(name, side)| Some((name, side?))) {
        let values = [side.mean, side.rms, side.max, side.max_at_most];
        table.line(std::iter::once(name.into()).chain(values.map(length)).collect());
        table.line(std::iter::once(String::new()).chain(values.map(percent)).collect());
    }
    for (number, line) in table.text().lines().enumerate() {
        report.line(if number == 0 { "distances" } else { "" }, line);
    }
    for (number, (name, side)) in directions.into_iter().enumerate() {
        if let Some(OneSided { max_at: [x, y, z], .. }) = side {
            report.line(if number == 0 { "largest" } else { "" }, format!("{name} at {x}, {y}, {z}"));
        }
    }
    for (name, _) in directions.iter().filter(|(_, side)| side.is_some_and(|side| !side.is_max_settled)) {
        report.line("note", format!("{name}: the search for the max ended early; look at what it is at most"));
    }
    let mut table = Table::new(&["", "mean", "rms", "max"]);
    for (name, colours) in directions.into_iter().filter_map(|(name, side)| Some((name, side?.colours?))) {
        let values = [colours.mean, colours.rms, colours.max].map(|share| format!("{:.4} %", 100.0 * share));
        table.line(std::iter::once(name.into()).chain(values).collect());
    }
    if a_to_b.colours.is_some() {
        for (number, line) in table.text().lines().enumerate() {
            report.line(if number == 0 { "colours" } else { "" }, line);
        }
    }
    for note in colour_notes(found) {
        report.line("note", note);
    }
    if let Some(hausdorff) = found.hausdorff() {
        report.line("Hausdorff", format!("{}, {} of the diagonal", length(hausdorff), percent(hausdorff)));
    }
    report.line("diagonal", format!("{} (of A)", length(*diagonal)));
    report.line("samples", format!("{} on each surface, and vertices", grouped(options.samples)));
    report.line("time", format!("{:.2} s ({:.2} s of CPU)", costs.seconds, costs.cpu_seconds));
    if let Some(peak) = costs.peak {
        report.line("peak RAM", format!("{} of {} allowed", ByteSize(peak), options.memory));
    }
    report
}

/// What there is to say of colours that could not be compared.
fn colour_notes(found: &Comparison) -> Vec<String> {
    let only = match found.have_colours {
        [true, false] => Some("A"),
        [false, true] => Some("B"),
        _ => None,
    };
    let only = only.map(|name| format!("only {name} has colours: they are not compared"));
    only.into_iter().chain(found.colour_notes.iter().cloned()).collect()
}

fn to_json(options: &CompareOptions, found: &Comparison, costs: &Costs) -> Value {
    let mut document = json!({
        "a_triangles": found.triangles[0],
        "b_triangles": found.triangles[1],
        "hausdorff": found.hausdorff(),
        "samples": options.samples,
        "diagonal": found.diagonal,
        "memory_bytes": options.memory.0,
        "seconds": costs.seconds,
        "cpu_seconds": costs.cpu_seconds,
        "peak_rss_bytes": costs.peak,
    });
    for (name, side) in [("a_to_b", Some(found.a_to_b)), ("b_to_a", found.b_to_a)] {
        document[format!("{name}_mean")] = json!(side.map(|side| side.mean));
        document[format!("{name}_rms")] = json!(side.map(|side| side.rms));
        document[format!("{name}_max")] = json!(side.map(|side| side.max));
        document[format!("{name}_max_at")] = json!(side.map(|side| side.max_at));
        document[format!("{name}_max_at_most")] = json!(side.map(|side| side.max_at_most));
        document[format!("{name}_max_settled")] = json!(side.map(|side| side.is_max_settled));
        if let Some(colours) = side.and_then(|side| side.colours) {
            document[format!("{name}_colour_mean")] = json!(colours.mean);
            document[format!("{name}_colour_rms")] = json!(colours.rms);
            document[format!("{name}_colour_max")] = json!(colours.max);
        }
    }
    let notes = colour_notes(found);
    if !notes.is_empty() {
        document["colour_notes"] = json!(notes);
    }
    document
}
