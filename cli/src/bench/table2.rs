//! `vdt bench table2`: the paper's Table 2 on other meshes. Flights along the same path in several sizes of memory: by virtual
//! memory (the paper's *Virt.*: all meta-nodes decoded in one mapped file), by our own I/O (*Ext.*), and with all in RAM.
//!
//! **The same picture.** All flights have fronts of the same size, and the error in pixels that is asked for; where the
//! memory does not allow it, the first of its doubles at which no flight ever raises its threshold, which is a figure of its
//! own. So no miss hides in a raised threshold. Virtual memory never misses, since it waits. What is drawn is compared, too.
//!
//! **The same memory.** Each flight is a process in a memory cgroup of the budget and 8 MiB for the program. Pages of the
//! mapped file count in there, so virtual memory has for them what our flight has for place holders, and more. The
//! files are not in the system's cache when a flight begins; the picture of its first camera is finished before frames
//! count. Frames are begun in time, as in a viewer, so that both our thread and the system can read ahead in between.
//! What counts is the wall time within frames.
//!
//! **All in RAM**: the mapped file in the system's cache, and no cgroup. That is what virtual memory comes to in memory
//! enough. What all takes together is the file of decoded meta-nodes and the front at most, at the error asked for; it is
//! what shares of memory are of.
//!
//! RAM: what building takes, then what is flown in.

use std::cell::RefCell;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use metanode::model::Model;
use navigator::PathSpec;
use serde_json::{Value, json};
use storage::{LocalDisk, MapAdvice};

use super::child::{self, RunCgroup, Workshop};
use super::figures::{float_cell, mebibytes_cell, whole_cell};
use super::machine::Machine;
use super::{build_options, check_files, mesh_name, plot, workshop_parent, write_plot};
use crate::arguments::Table2Options;
use crate::compare::is_model;
use crate::output::counted;
use crate::progress::Progress;
use crate::table::{Table, UNKNOWN};

/// What a program may take on top of its budget.
const FOR_THE_PROGRAM: u64 = 8 << 20;
/// The advices that virtual memory is flown with; the system's default first.
const ADVICES: [MapAdvice; 3] = [MapAdvice::Normal, MapAdvice::Random, MapAdvice::WillNeed];
/// By how much the error asked for is multiplied at most. A model of few meta-nodes in the smallest memory of all may need more
/// of them than it has place holders at any error; its frames with a raised threshold are told.
const MOST_PIXELS_FACTOR: f32 = 256.0;

/// A mesh or model, and what became of it.
#[derive(Debug)]
struct Subject {
    name: String,
    file: String,
    outcome: Result<Vec<Row>, String>,
}

/// The flights along one path in one size of memory.
#[derive(Debug)]
struct Row {
    path: String,
    /// What flights were allowed, in bytes.
    memory: u64,
    /// What all takes.
    whole: u64,
    /// The error that they had, in pixels.
    pixels: f32,
    in_memory: Run,
    ours: Run,
    /// By virtual memory, with each of the [`ADVICES`].
    mapped: [Run; ADVICES.len()],
}

/// How a flight is flown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    /// By our I/O thread.
    Ours,
    /// By virtual memory.
    Mapped(MapAdvice),
    /// With all in RAM, however much that takes.
    InMemory,
}

/// A flight.
#[derive(Debug, Clone)]
struct Run {
    /// What it printed or complained of.
    outcome: child::Outcome,
    /// The most memory that its cgroup had.
    cgroup_peak: Option<u64>,
    /// Whether it was killed because of the limit.
    killed: bool,
}

impl Run {
    fn float(&self, key: &str) -> Option<f64> {
        self.outcome.as_ref().ok()?[key].as_f64()
    }

    fn whole(&self, key: &str) -> Option<u64> {
        self.outcome.as_ref().ok()?[key].as_u64()
    }

    fn frame_ms(&self) -> Option<f64> {
        self.float("frame_ms_mean")
    }

    /// Whether a limit had the threshold raised in any frame.
    fn was_raised(&self) -> bool {
        self.float("threshold_factor_max").is_some_and(|factor| factor > 1.0)
    }

    /// Its mean time of a frame, or why there is none.
    fn cell(&self) -> String {
        match (&self.outcome, self.killed) {
            (Ok(_), _) => float_cell(self.frame_ms()),
            (Err(_), true) => "killed".into(),
            (Err(_), false) => "failed".into(),
        }
    }

    fn to_json(&self) -> Value {
        let mut document = match &self.outcome {
            Ok(document) => document.clone(),
            Err(complaint) => json!({ "error": complaint }),
        };
        document["killed"] = self.killed.into();
        document["cgroup_peak_bytes"] = json!(self.cgroup_peak);
        document
    }
}

impl Row {
    /// The fastest flight by virtual memory, if one came to its end.
    fn best(&self) -> Option<(MapAdvice, &Run)> {
        let flown = ADVICES.into_iter().zip(&self.mapped).filter(|(_, run)| run.frame_ms().is_some());
        flown.min_by(|(_, left), (_, right)| {
            let [left, right] = [left, right].map(|run| run.frame_ms().unwrap_or(f64::INFINITY));
            left.total_cmp(&right)
        })
    }

    /// How many times as long a frame of this flight takes as one of ours.
    fn over_ours(&self, run: Option<&Run>) -> Option<f64> {
        Some(run?.frame_ms()? / self.ours.frame_ms()?)
    }

    fn speed_up_over_best(&self) -> Option<f64> {
        self.over_ours(self.best().map(|(_, run)| run))
    }

    fn speed_up_over_default(&self) -> Option<f64> {
        self.over_ours(self.mapped.first())
    }

    /// How many times as long a frame of ours takes as one with all in RAM.
    fn over_in_memory(&self) -> Option<f64> {
        Some(self.ours.frame_ms()? / self.in_memory.frame_ms()?)
    }

    /// What a figure of our flight is, as a multiple of that by virtual memory.
    fn ours_over_mapped(&self, key: &str) -> Option<f64> {
        Some(self.ours.float(key)? / self.best()?.1.float(key)?)
    }

    /// How many percent more triangles ours draws than virtual memory.
    fn more_triangles(&self) -> Option<f64> {
        Some(100.0 * (self.ours_over_mapped("triangles_mean")? - 1.0))
    }
}

/// What all flights of a bench share.
struct Bench<'a> {
    options: &'a Table2Options,
    workshop: &'a Workshop,
    /// Why no memory cgroup could be made, once that is known.
    no_cgroup: RefCell<Option<String>>,
}

pub fn run(options: &Table2Options, json: bool) -> Result<()> {
    let inputs: Vec<&Path> = options.files.iter().map(AsRef::as_ref).collect();
    check_files(&inputs, options.plot.as_deref(), options.shared.force)?;
    let workshop = Workshop::new(&workshop_parent(options.shared.scratch.as_deref()))?;
    let bench = Bench { options, workshop: &workshop, no_cgroup: RefCell::new(None) };
    let progress = Progress::new("measuring");
    let mut subjects = Vec::new();
    for (number, file) in inputs.iter().enumerate() {
        let show = |share: f64| progress.show((number as f64 + share) / inputs.len() as f64);
        let outcome = bench.measure(file, &show)?;
        subjects.push(Subject { name: mesh_name(file), file: file.display().to_string(), outcome });
    }
    drop(progress);
    let no_cgroup = bench.no_cgroup.into_inner();
    drop(workshop);

    if let Some(path) = &options.plot {
        let title = format!("Mean time of a frame: {}", Machine::this().text());
        write_plot(path, &plot::frame_times_against_memory(pictures(&subjects), &title)?)?;
    }
    let mut out = io::stdout().lock();
    if json {
        let document = to_json(options, &subjects, no_cgroup.as_deref());
        writeln!(out, "{}", serde_json::to_string_pretty(&document)?)?;
    } else {
        for subject in &subjects {
            write!(out, "{}", text(subject))?;
        }
        writeln!(out, "{}", legend(options, no_cgroup.as_deref()))?;
    }
    let failed = subjects.iter().map(failures).sum();
    match failed {
        0 => Ok(()),
        _ => bail!("{} failed", counted(failed, "measurement", "measurements")),
    }
}

/// How many of a subject's measurements failed. That virtual memory was killed is none: it is a result.
fn failures(subject: &Subject) -> u64 {
    let failed = |row: &Row| {
        let mapped = row.mapped.iter().any(|run| run.outcome.is_err() && !run.killed);
        row.ours.outcome.is_err() || row.in_memory.outcome.is_err() || mapped
    };
    match &subject.outcome {
        Ok(rows) => rows.iter().filter(|row| failed(row)).count() as u64,
        Err(_) => 1,
    }
}

impl Bench<'_> {
    /// Flies over a model, or over that of a mesh, along all paths and in all sizes of memory.
    fn measure(&self, file: &Path, show: &dyn Fn(f64)) -> Result<Result<Vec<Row>, String>> {
        let model = if is_model(file)? {
            file.to_path_buf()
        } else {
            let options = build_options(&[
                ("--memory", Some(self.options.build_memory.0.to_string())),
                ("--threads", self.options.shared.threads.map(|threads| threads.to_string())),
            ]);
            match self.workshop.build(file, &options)? {
                Ok(_) => self.workshop.model(),
                Err(complaint) => return Ok(Err(complaint)),
            }
        };
        let decoded = self.decoded();
        if decoded.exists() {
            std::fs::remove_file(&decoded)?;
        }
        let mut rows = Vec::new();
        for (number, path) in self.options.path.iter().enumerate() {
            let show = |share: f64| show((number as f64 + share) / self.options.path.len() as f64);
            match self.measure_path(&model, path, &show)? {
                Ok(found) => rows.extend(found),
                Err(complaint) => return Ok(Err(complaint)),
            }
        }
        Ok(Ok(rows))
    }

    /// The file of decoded meta-nodes of the model at hand.
    fn decoded(&self) -> PathBuf {
        self.workshop.folder().join("pages")
    }

    fn measure_path(&self, model: &Path, path: &PathSpec, show: &dyn Fn(f64)) -> Result<Result<Vec<Row>, String>> {
        let mut in_memory = self.fly(model, path, Way::InMemory, self.options.picture.pixels, u64::MAX)?;
        let whole = match &in_memory.outcome {
            Ok(_) => in_memory.whole("decoded_bytes").unwrap_or(0) + in_memory.whole("front_bytes_max").unwrap_or(0),
            Err(complaint) => return Ok(Err(complaint.clone())),
        };
        let smallest = smallest_budget(model)?;
        let mut sizes: Vec<u64> =
            self.options.memory.iter().map(|share| share.bytes(whole).max(smallest).next_multiple_of(1024)).collect();
        // What little memory allows is no finer than what much does: from the largest on, the error only rises.
        sizes.sort_unstable();
        sizes.dedup();
        let mut pixels = self.options.picture.pixels;
        let mut rows = Vec::new();
        for (number, memory) in sizes.iter().rev().copied().enumerate() {
            show(number as f64 / sizes.len() as f64);
            let before = pixels;
            let fly = |way, pixels| self.fly(model, path, way, pixels, memory);
            let (ours, random) = loop {
                // Who misses nothing may need more room than who does.
                let ours = fly(Way::Ours, pixels)?;
                let random = if ours.was_raised() { None } else { Some(fly(Way::Mapped(MapAdvice::Random), pixels)?) };
                let is_last = pixels >= self.options.picture.pixels * MOST_PIXELS_FACTOR;
                match random {
                    Some(random) if !random.was_raised() || is_last => break (ours, random),
                    None if is_last => break (ours, fly(Way::Mapped(MapAdvice::Random), pixels)?),
                    _ => pixels *= 2.0,
                }
            };
            if pixels != before {
                in_memory = self.fly(model, path, Way::InMemory, pixels, u64::MAX)?;
            }
            let mapped =
                [fly(Way::Mapped(MapAdvice::Normal), pixels)?, random, fly(Way::Mapped(MapAdvice::WillNeed), pixels)?];
            let path = path.to_string();
            rows.push(Row { path, memory, whole, pixels, in_memory: in_memory.clone(), ours, mapped });
        }
        rows.reverse();
        Ok(Ok(rows))
    }

    /// Flies as often as asked for, and keeps the run with the least time for a frame.
    fn fly(&self, model: &Path, path: &PathSpec, way: Way, pixels: f32, memory: u64) -> Result<Run> {
        let mut best = self.fly_once(model, path, way, pixels, memory)?;
        for _ in 1..self.options.runs {
            let run = self.fly_once(model, path, way, pixels, memory)?;
            let time = |run: &Run| run.frame_ms().unwrap_or(f64::INFINITY);
            if time(&run) < time(&best) {
                best = run;
            }
        }
        Ok(best)
    }

    fn fly_once(&self, model: &Path, path: &PathSpec, way: Way, pixels: f32, memory: u64) -> Result<Run> {
        storage::mapped_file::forget_cached(model)?;
        let group = match way {
            Way::InMemory => None,
            Way::Ours | Way::Mapped(_) => match RunCgroup::new(memory + FOR_THE_PROGRAM) {
                Ok(group) => Some(group),
                Err(error) => {
                    *self.no_cgroup.borrow_mut() = Some(error.to_string());
                    None
                }
            },
        };
        let mut command = self.workshop.command(group.as_ref().map(RunCgroup::group));
        command.arg("navigate").arg(model).args(["--json", "--settle", "--path", &path.to_string()]);
        command.args(["--pixels", &pixels.to_string(), "--memory", &memory.to_string()]);
        let size = self.options.picture.size;
        command.args(["--size", &format!("{}x{}", size.width, size.height)]);
        command.args(["--frame-rate", &self.options.frame_rate.to_string()]);
        let advice = match way {
            Way::Ours => None,
            Way::Mapped(advice) => Some(advice),
            Way::InMemory => Some(MapAdvice::Populate),
        };
        if let Some(advice) = advice {
            command.args(["--io", "mmap", "--advice", advice.name(), "--decoded"]).arg(self.decoded());
        }
        let outcome = self.workshop.run(command, "flight")?;
        let group = group.as_ref().map(RunCgroup::group);
        let killed = outcome.is_err() && group.and_then(|group| group.kills()).is_some_and(|kills| kills > 0);
        Ok(Run { outcome, cgroup_peak: group.and_then(|group| group.peak_bytes()), killed })
    }
}

/// The fewest bytes with which a model can be flown over.
fn smallest_budget(model: &Path) -> Result<u64> {
    let model = Model::open(&LocalDisk, model)?;
    Ok(navigator::plan(&model, 0).map_or_else(|refusal| refusal.smallest, |budget| budget.bytes))
}

/// The tables of each flight over a mesh, under its name; or why there are none.
fn text(subject: &Subject) -> String {
    let rows = match &subject.outcome {
        Ok(rows) => rows,
        Err(complaint) => return format!("{}  failed: {complaint}\n\n", subject.name),
    };
    let flights = rows.chunk_by(|row, next| row.path == next.path);
    let text = |rows: &[Row]| {
        let path = rows.first().map_or("", |row| row.path.as_str());
        format!("{}, {path}\n{}\n{}\n", subject.name, paper_table(rows).text(), details_table(rows).text())
    };
    flights.map(text).collect()
}

/// The columns of the paper's table, and how many times as fast we are.
fn paper_table(rows: &[Row]) -> Table {
    let headings =
        ["MiB", "share", "pixels", "tris", "adapt", "RAM", "Virt.", "Ext.", "miss %", "x best", "x default", "/ RAM"];
    let mut table = Table::new(&headings);
    for row in rows {
        table.line(vec![
            mebibytes_cell(Some(row.memory)),
            float_cell(Some(row.memory as f64 / row.whole.max(1) as f64)),
            float_cell(Some(row.pixels.into())),
            whole_cell(row.ours.float("triangles_mean").map(|count| count as u64)),
            whole_cell(row.ours.float("adapts_mean").map(|count| count as u64)),
            row.in_memory.cell(),
            row.best().map_or_else(|| row.mapped[0].cell(), |(_, run)| run.cell()),
            row.ours.cell(),
            float_cell(row.ours.float("miss_percent")),
            float_cell(row.speed_up_over_best()),
            float_cell(row.speed_up_over_default()),
            float_cell(row.over_in_memory()),
        ]);
    }
    table
}

/// What the flights took one by one, and whether they are of the same picture.
fn details_table(rows: &[Row]) -> Table {
    let mut table = Table::new(&[
        "MiB",
        "normal",
        "random",
        "will-need",
        "p99",
        "Ext. p50",
        "p99",
        "reads",
        "peak MiB",
        "limit",
        "tris +%",
        "error x",
        "raised",
    ]);
    for row in rows {
        let [normal, random, will_need] = &row.mapped;
        table.line(vec![
            mebibytes_cell(Some(row.memory)),
            normal.cell(),
            random.cell(),
            will_need.cell(),
            float_cell(row.best().and_then(|(_, run)| run.float("frame_ms_p99"))),
            float_cell(row.ours.float("frame_ms_p50")),
            float_cell(row.ours.float("frame_ms_p99")),
            whole_cell(row.ours.whole("reads")),
            mebibytes_cell(row.ours.whole("peak_rss_bytes")),
            mebibytes_cell(Some(row.memory + FOR_THE_PROGRAM)),
            row.more_triangles().map_or(UNKNOWN.into(), |percent| format!("{percent:+.2}")),
            float_cell(row.ours_over_mapped("error_stated")),
            whole_cell(row.ours.whole("raised_frames")),
        ]);
    }
    table
}

/// What the columns are, and how and on what they were measured.
fn legend(options: &Table2Options, no_cgroup: Option<&str>) -> String {
    let cgroups = match no_cgroup {
        None => "Each flight but those in RAM ran in a memory cgroup of its memory and 8 MiB (limit).".to_owned(),
        Some(reason) => format!(
            "NO MEMORY CGROUP could be made ({reason}): virtual memory had all RAM that it liked, and Virt. says nothing."
        ),
    };
    let runs = if options.runs > 1 {
        format!(" Of {} runs each, the one with the least mean.", options.runs)
    } else {
        String::new()
    };
    format!(
        "MiB: memory allowed; share: of all decoded meta-nodes and the front; pixels: the error that all flights had, which\n\
         is above {} where the memory did not allow that. adapt: splits and collapses in a frame. RAM, Virt., Ext.: mean wall\n\
         milliseconds of a frame, with all in RAM, by virtual memory with the best of the advices (normal, random,\n\
         will-need), and by our I/O; x best, x default: how many times as long Virt. takes as Ext., with the best and with no\n\
         advice; / RAM: Ext. over RAM. miss: of the requests of Ext.; Virt. waits and misses none. p99: 99th percentile, of\n\
         the best Virt. and of Ext.; reads: meta-nodes that Ext. read; peak: its resident set. tris, error: what Ext. drew and\n\
         stated against Virt.; raised: frames in which Ext. had a higher error because of its memory.\n\
         {cgroups}\n\
         Begun cold, with the first picture finished, at {} frames a second.{runs}\n\
         Measured on {}.",
        options.picture.pixels,
        options.frame_rate,
        Machine::this().text(),
    )
}

/// For each mesh and path a line for each way to fly: memory and mean time of a frame.
fn pictures(subjects: &[Subject]) -> Vec<(String, Vec<plot::Line>)> {
    let mut pictures: Vec<(String, Vec<plot::Line>)> = Vec::new();
    let names =
        ["virtual memory, normal", "virtual memory, random", "virtual memory, will-need", "our I/O", "all in RAM"];
    for subject in subjects {
        for row in subject.outcome.iter().flatten() {
            let name = format!("{}, {}", subject.name, row.path);
            if pictures.last().is_none_or(|(last, _)| *last != name) {
                pictures.push((name, names.map(|name| (name.to_owned(), Vec::new())).to_vec()));
            }
            let runs = row.mapped.iter().chain([&row.ours, &row.in_memory]);
            let Some((_, lines)) = pictures.last_mut() else { continue };
            for ((_, points), run) in lines.iter_mut().zip(runs) {
                // On a logarithmic scale there is no zero.
                points.extend(run.frame_ms().map(|time| (row.memory as f64, time.max(1e-3))));
            }
        }
    }
    pictures
}

fn to_json(options: &Table2Options, subjects: &[Subject], no_cgroup: Option<&str>) -> Value {
    json!({
        "machine": Machine::this().to_json(),
        "pixels": options.picture.pixels,
        "size": [options.picture.size.width, options.picture.size.height],
        "frames_per_second": options.frame_rate,
        "runs": options.runs,
        "memory": options.memory.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "cgroup": no_cgroup.is_none(),
        "no_cgroup_because": no_cgroup,
        "rows": subjects.iter().flat_map(subject_json).collect::<Vec<_>>(),
    })
}

fn subject_json(subject: &Subject) -> Vec<Value> {
    match &subject.outcome {
        Ok(rows) => rows.iter().map(|row| row_json(subject, row)).collect(),
        Err(complaint) => vec![json!({ "mesh": subject.name, "file": subject.file, "error": complaint })],
    }
}

fn row_json(subject: &Subject, row: &Row) -> Value {
    let [normal, random, will_need] = &row.mapped;
    json!({
        "mesh": subject.name,
        "file": subject.file,
        "path": row.path,
        "memory_bytes": row.memory,
        "limit_bytes": row.memory + FOR_THE_PROGRAM,
        "in_memory_bytes": row.whole,
        "memory_share": row.memory as f64 / row.whole.max(1) as f64,
        "pixels": row.pixels,
        "triangles_mean": row.ours.float("triangles_mean"),
        "adapts_mean": row.ours.float("adapts_mean"),
        "miss_percent": row.ours.float("miss_percent"),
        "frame_ms": {
            "in_memory": row.in_memory.frame_ms(),
            "ours": row.ours.frame_ms(),
            "mmap_best": row.best().and_then(|(_, run)| run.frame_ms()),
            "mmap_normal": normal.frame_ms(),
            "mmap_random": random.frame_ms(),
            "mmap_will_need": will_need.frame_ms(),
        },
        "best_advice": row.best().map(|(advice, _)| advice.name()),
        "speed_up_over_best": row.speed_up_over_best(),
        "speed_up_over_default": row.speed_up_over_default(),
        "ours_over_in_memory": row.over_in_memory(),
        "more_triangles_percent": row.more_triangles(),
        "error_over_mmap": row.ours_over_mapped("error_stated"),
        "runs": {
            "in_memory": row.in_memory.to_json(),
            "ours": row.ours.to_json(),
            "mmap_normal": normal.to_json(),
            "mmap_random": random.to_json(),
            "mmap_will_need": will_need.to_json(),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(frame_ms: f64) -> Run {
        let document = json!({ "frame_ms_mean": frame_ms, "triangles_mean": 1000.0, "threshold_factor_max": 1.0 });
        Run { outcome: Ok(document), cgroup_peak: Some(1), killed: false }
    }

    fn killed() -> Run {
        Run { outcome: Err("the flight ended with signal: 9".into()), cgroup_peak: None, killed: true }
    }

    fn row(mapped: [Run; 3]) -> Row {
        let (in_memory, ours) = (run(4.0), run(5.0));
        Row { path: "orbit:9".into(), memory: 1 << 20, whole: 1 << 23, pixels: 2.0, in_memory, ours, mapped }
    }

    #[test]
    fn ours_is_held_against_the_best_and_the_default() {
        let row = row([run(50.0), run(20.0), killed()]);
        assert_eq!(row.best().map(|(advice, _)| advice), Some(MapAdvice::Random));
        assert_eq!((row.speed_up_over_best(), row.speed_up_over_default()), (Some(4.0), Some(10.0)));
        assert_eq!((row.over_in_memory(), row.more_triangles()), (Some(1.25), Some(0.0)));
        let document = row_json(&Subject { name: "a".into(), file: "b".into(), outcome: Ok(Vec::new()) }, &row);
        assert_eq!((&document["best_advice"], &document["memory_share"]), (&json!("random"), &json!(0.125)));
        assert_eq!(document["runs"]["mmap_will_need"]["killed"], true);
    }

    #[test]
    fn that_virtual_memory_is_killed_is_a_result() {
        let row = row([killed(), killed(), killed()]);
        assert_eq!((row.speed_up_over_best(), row.speed_up_over_default()), (None, None));
        let subject = Subject { name: "a".into(), file: "b".into(), outcome: Ok(vec![row]) };
        assert_eq!(failures(&subject), 0);
        let text = super::text(&subject);
        assert!(text.starts_with("a, orbit:9\n") && text.matches("killed").count() == 4, "{text}");
        let failed = Subject { name: "a".into(), file: "b".into(), outcome: Err("no room".into()) };
        assert_eq!(failures(&failed), 1);
        assert_eq!(super::text(&failed), "a  failed: no room\n\n");
    }
}
