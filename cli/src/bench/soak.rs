//! `vdt bench soak`: a long random walk over a model from a disk that fails now and then, and whether everything holds that must.
//!
//! The camera walks at random ([`navigator::walk`]), jumps and stops. Of all reads a share fails, as large a share is delayed, and
//! as large a one brings a bit that was not written; and after each stop, with the next jump, the disk fails for good for a while. So
//! reads are tried again, and some pages cannot be read at all: such a frame returns an error, and the flight goes on.
//!
//! Looked at are
//! - invariants 4 and 5 of the design ([`navigator::check::check`]), with every so many frames and at every stop;
//! - the memory in use, as the operating system counts it, once a second: that of the first tenth of the flight and of the last;
//! - at every stop, how long it takes until the picture rests, with the faults going on; and what it is then.
//!
//! # The picture at a stop
//!
//! That of a fresh navigator, opened without faults and with the same memory, is the coarsest with which no node exceeds the
//! threshold. The one that has flown may have more: what is split already stays split as long as its error is not below the
//! threshold by a margin, so that nothing changes back and forth. So their pictures need not be equal. What must hold is:
//!
//! - Nothing is left undone ([`navigator::check::undone`]): no active node exceeds the threshold, and no node whose children are
//!   active could be restored, being below it by the margin, with nothing that depends on it. Neither may be in a fresh one.
//! - What is split in the fresh front is split in the other. With implicit dependencies that is counted only: what has to be
//!   split for a node may be told in several ways. With none, it must hold.
//! - Where the same nodes are split, the same triangles are drawn.
//!
//! Where the budget does not allow the error asked for, the threshold is raised, and how far depends on what was before. Then the
//! fresh navigator is asked for the error that the other has come to. (How much finer or coarser that is than what a fresh one comes
//! to by itself is told, too.)

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use metanode::model::Model;
use navigator::check::{Undone, check, undone};
use navigator::walk::{RandomWalk, STEPS_PER_SECOND, Step};
use navigator::{Camera, Io, Navigator, NavigatorError, NavigatorOptions, PoolCounters};
use serde_json::{Value, json};
use storage::{ByteSize, FaultyDisk, LocalDisk};

use super::check_files;
use super::machine::Machine;
use crate::arguments::{DependencyName, SoakOptions};
use crate::output::{Report, counted, grouped};
use crate::progress::Progress;

/// In so many seconds the picture is to be at rest.
const TIME_TO_SETTLE: f64 = 2.0;
/// After so many it is given up.
const PATIENCE: f64 = 20.0;
/// Most seconds between two frames.
const SLOWEST: f64 = 60.0;
/// Most frames of a fresh navigator.
const MOST_FRESH_FRAMES: u32 = 5000;
/// How many of the things that are wrong are told.
const TOLD: usize = 5;

/// Whether a soak goes on, and whether it was asked to end.
static STATE: AtomicU8 = AtomicU8::new(IDLE);
const IDLE: u8 = 0;
const RUNNING: u8 = 1;
const ASKED_TO_END: u8 = 2;

/// Has a soak that goes on end, and print what it came to so far: what a program does when it is told to stop. False if there is none,
/// or it was asked before.
pub fn end_early() -> bool {
    STATE.compare_exchange(RUNNING, ASKED_TO_END, Ordering::Relaxed, Ordering::Relaxed).is_ok()
}

/// What happened.
#[derive(Debug, Default)]
struct Tally {
    frames: u64,
    jumps: u64,
    stops: u64,
    checks: u64,
    /// What is wrong: how often, and the first of it.
    violations: u64,
    told: Vec<String>,
    /// Frames that returned an error, and the first of these.
    errors: u64,
    first_error: Option<String>,
    outages: u64,
    misses: u64,
    requests: u64,
    adapts: u64,
    pool: PoolCounters,
    frame_ms: f64,
    frame_ms_max: f64,
    /// Frames with a threshold raised because of a limit.
    raised_frames: u64,
    triangles: u64,
    /// How long it took, at each stop where it did, until the picture was at rest.
    settled: Vec<f64>,
    /// Stops at which it did not come to rest.
    unsettled: u64,
    /// Stops at which the fresh picture was the same; and at which it could not be compared, since the fresh navigator hit limits.
    equal: u64,
    incomparable: u64,
    /// Nodes that were split in the fresh fronts; beyond these, in those flown; and those of them that were not.
    fresh_splits: u64,
    more_splits: u64,
    missing_splits: u64,
    /// By how much the threshold of each limited stop was that of a fresh navigator.
    factors: Vec<f32>,
    /// Resident set, once a second.
    resident: Vec<u64>,
}

impl Tally {
    fn violation(&mut self, what: String) {
        self.violations += 1;
        if self.told.len() < TOLD {
            self.told.push(what);
        }
    }

    fn settled_max(&self) -> f64 {
        self.settled.iter().copied().fold(0.0, f64::max)
    }

    fn settled_mean(&self) -> f64 {
        self.settled.iter().sum::<f64>() / self.settled.len().max(1) as f64
    }

    fn settled_late(&self) -> usize {
        self.settled.iter().filter(|seconds| **seconds > TIME_TO_SETTLE).count()
    }

    /// The least, the mean and the most of the factors, if there are any.
    fn threshold_ratios(&self) -> Option<[f32; 3]> {
        let factors = self.factors.iter().copied();
        let least = factors.clone().reduce(f32::min)?;
        let (mean, most) = (factors.clone().sum::<f32>() / self.factors.len() as f32, factors.fold(least, f32::max));
        Some([least, mean, most])
    }

    /// The resident set in the first and in the last tenth of the flight, on average.
    fn resident_ends(&self) -> Option<[u64; 2]> {
        let length = self.resident.len().div_ceil(10);
        let mean = |samples: &[u64]| samples.iter().sum::<u64>() / samples.len() as u64;
        let (first, last) = (self.resident.get(..length)?, self.resident.get(self.resident.len() - length..)?);
        (length > 0).then(|| [mean(first), mean(last)])
    }
}

/// A front that came to rest.
struct Rest {
    navigator: Navigator,
    /// By how much its threshold is raised, and was at the most.
    factor: f32,
    most_raised: f32,
}

/// A soak.
struct Soak<'a> {
    options: &'a SoakOptions,
    disk: FaultyDisk,
    /// The model from a disk without faults.
    sound: Arc<Model>,
    navigator_options: NavigatorOptions,
    navigator: Navigator,
    walk: RandomWalk,
    tally: Tally,
    start: Instant,
    /// When the next frame begins, and until when the disk fails for good.
    next_frame: Instant,
    outage_ends: Option<Instant>,
    /// Whether the next jump comes with an outage.
    outage_is_due: bool,
    threshold_factor: f32,
}

pub fn run(options: &SoakOptions, json: bool) -> Result<()> {
    check_files(&[&options.model], None, false)?;
    let disk = FaultyDisk::new(Arc::new(LocalDisk));
    let model = Arc::new(Model::open(&disk, &options.model)?);
    let sound = Arc::new(Model::open(&LocalDisk, &options.model)?);
    let navigator_options = NavigatorOptions {
        memory: options.memory.0,
        pixels: options.picture.pixels,
        width: options.picture.size.width,
        height: options.picture.size.height,
        dependency: options.dependency.into(),
        ..NavigatorOptions::default()
    };
    let now = Instant::now();
    let mut soak = Soak {
        options,
        disk,
        navigator: Navigator::open(model, navigator_options.clone())?,
        walk: RandomWalk::new(&sound, options.seed)?,
        sound,
        navigator_options,
        tally: Tally::default(),
        start: now,
        next_frame: now,
        outage_ends: None,
        outage_is_due: false,
        threshold_factor: 1.0,
    };
    STATE.store(RUNNING, Ordering::Relaxed);
    let flown = soak.fly();
    STATE.store(IDLE, Ordering::Relaxed);
    flown?;
    let (tally, seconds) = (&soak.tally, soak.start.elapsed().as_secs_f64());
    report(options, tally, seconds).print(json, &to_json(options, tally, seconds))?;
    match tally.violations {
        0 => Ok(()),
        count => bail!("{} found: {}", counted(count, "violation", "violations"), tally.told.join("; ")),
    }
}

impl Soak<'_> {
    fn fly(&mut self) -> Result<()> {
        let progress = Progress::new("walking");
        self.strike(true);
        let rate = self.options.frame_rate;
        let pace = Duration::from_secs_f64(if rate > 0.0 { rate.recip().min(SLOWEST) } else { 0.0 });
        loop {
            let elapsed = self.start.elapsed().as_secs_f64();
            progress.show(elapsed / self.options.seconds);
            let is_over = elapsed >= self.options.seconds || STATE.load(Ordering::Relaxed) != RUNNING;
            let step = if is_over { Step::Stop } else { self.walk.step() };
            let camera = self.walk.camera();
            match step {
                Step::Flight => self.frame(&camera, pace)?,
                Step::Jump => {
                    self.tally.jumps += 1;
                    self.begin_outage();
                    self.frame(&camera, pace)?;
                }
                Step::Stop => self.stop(&camera)?,
            }
            if is_over {
                return Ok(());
            }
        }
    }

    /// Turns the faults on or off.
    fn strike(&self, on: bool) {
        let SoakOptions { faults, delay, seed, .. } = self.options;
        let share = if on { faults / 100.0 } else { 0.0 };
        self.disk.fail_share_of_reads(share, *seed);
        self.disk.alter_share_of_reads(share, *seed);
        self.disk.delay_share_of_reads(share, Duration::from_millis(*delay), *seed);
    }

    fn begin_outage(&mut self) {
        if self.outage_is_due && self.options.outage > 0 {
            self.disk.fail_reads_after(0);
            self.outage_ends = Some(Instant::now() + Duration::from_millis(self.options.outage));
            self.outage_is_due = false;
            self.tally.outages += 1;
        }
    }

    /// The disk is what it was before it failed for good.
    fn end_outage(&mut self) {
        self.disk.fail_reads_after(u64::MAX);
        self.outage_ends = None;
    }

    /// A frame, no sooner than is due.
    fn frame(&mut self, camera: &Camera, pace: Duration) -> Result<()> {
        let now = Instant::now();
        std::thread::sleep(self.next_frame.saturating_duration_since(now));
        self.next_frame = self.next_frame.max(now) + pace;
        if self.outage_ends.is_some_and(|end| end <= now) {
            self.end_outage();
        }
        let tally = &mut self.tally;
        match self.navigator.frame(camera) {
            Ok(frame) => {
                tally.misses += frame.misses;
                tally.requests += frame.requests;
                tally.adapts += frame.splits + frame.collapses;
                tally.pool += frame.pool;
                tally.frame_ms += frame.frame_ms;
                tally.frame_ms_max = tally.frame_ms_max.max(frame.frame_ms);
                tally.raised_frames += u64::from(frame.threshold_factor > 1.0);
                tally.triangles += frame.triangles;
                self.threshold_factor = frame.threshold_factor;
            }
            // What the injected faults come to.
            Err(NavigatorError::Model(error)) => {
                tally.errors += 1;
                tally.first_error.get_or_insert_with(|| error.to_string());
            }
            Err(error) => return Err(error.into()),
        }
        tally.frames += 1;
        if tally.resident.len() as f64 <= self.start.elapsed().as_secs_f64() {
            tally.resident.extend(storage::usage::resident_bytes());
        }
        if tally.frames.is_multiple_of(self.options.check_every) {
            self.check();
        }
        Ok(())
    }

    /// Checks the invariants. What it has to read is read without faults.
    fn check(&mut self) {
        self.strike(false);
        self.end_outage();
        self.tally.checks += 1;
        if let Err(problem) = check(&self.navigator) {
            let frame = self.tally.frames;
            self.tally.violation(format!("frame {frame}: {problem}"));
        }
        self.strike(true);
    }

    /// Stands still until the picture is at rest, and looks at it.
    fn stop(&mut self, camera: &Camera) -> Result<()> {
        self.end_outage();
        self.tally.stops += 1;
        let start = Instant::now();
        let pace = Duration::from_secs_f64(1.0 / STEPS_PER_SECOND);
        while start.elapsed().as_secs_f64() < PATIENCE {
            self.frame(camera, pace)?;
            if self.navigator.settled() {
                break;
            }
        }
        if self.navigator.settled() {
            self.tally.settled.push(start.elapsed().as_secs_f64());
            self.check();
            self.compare(camera)?;
            // What the fresh navigator had is not to be seen in the memory of this one.
            storage::usage::trim_freed_memory();
        } else {
            self.tally.unsettled += 1;
        }
        self.outage_is_due = true;
        self.next_frame = Instant::now();
        Ok(())
    }

    /// Looks at a picture at rest, by itself and beside that of a fresh navigator.
    fn compare(&mut self, camera: &Camera) -> Result<()> {
        let own = self.threshold_factor;
        let rest = self.fresh(camera, self.options.picture.pixels)?;
        let rest = if own > 1.0 {
            self.tally.factors.push(own / rest.factor);
            drop(rest);
            self.fresh(camera, self.navigator.threshold())?
        } else {
            rest
        };
        for (navigator, which) in [(&self.navigator, "the front flown"), (&rest.navigator, "a fresh front")] {
            let Undone { splits, collapses } = undone(navigator, camera)?;
            if splits + collapses > 0 {
                let frame = self.tally.frames;
                let what =
                    format!("frame {frame}: {which} at rest leaves {splits} splits and {collapses} collapses undone");
                self.tally.violation(what);
            }
        }
        if rest.most_raised > 1.0 {
            self.tally.incomparable += 1;
            return Ok(());
        }
        let (flown, fresh) = (splits(&self.navigator), splits(&rest.navigator));
        let missing = fresh.iter().filter(|split| flown.binary_search(split).is_err()).count() as u64;
        let tally = &mut self.tally;
        tally.fresh_splits += fresh.len() as u64;
        tally.missing_splits += missing;
        tally.more_splits += flown.len() as u64 + missing - fresh.len() as u64;
        let frame = tally.frames;
        if missing > 0 && self.options.dependency == DependencyName::None {
            tally.violation(format!("frame {frame}: {missing} nodes are not split that a fresh navigator splits"));
        }
        if flown == fresh {
            tally.equal += 1;
            if digest(&self.navigator) != digest(&rest.navigator) {
                tally.violation(format!("frame {frame}: the same nodes are split, but other triangles are drawn"));
            }
        }
        Ok(())
    }

    /// A navigator that has seen nothing but this camera, with every page read at once.
    fn fresh(&self, camera: &Camera, pixels: f32) -> Result<Rest> {
        let options = NavigatorOptions { io: Io::Sync, max_adapts: None, pixels, ..self.navigator_options.clone() };
        let navigator = Navigator::open(self.sound.clone(), options)?;
        let mut rest = Rest { navigator, factor: 1.0, most_raised: 1.0 };
        for _ in 0..MOST_FRESH_FRAMES {
            rest.factor = rest.navigator.frame(camera)?.threshold_factor;
            rest.most_raised = rest.most_raised.max(rest.factor);
            if rest.navigator.settled() {
                return Ok(rest);
            }
        }
        bail!("a fresh navigator did not come to rest in {MOST_FRESH_FRAMES} frames");
    }
}

/// The splits that are applied, by the leaves that they bear, in rising order.
fn splits(navigator: &Navigator) -> Vec<u32> {
    let mut splits: Vec<u32> = navigator.applied_splits().map(|split| split.born_leaf).collect();
    splits.sort_unstable();
    splits
}

/// A sum over the triangles that are drawn, whatever their order.
fn digest(navigator: &Navigator) -> u64 {
    let mix = |hash: u64, word: u32| (hash ^ u64::from(word)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29);
    let triangles = navigator.triangles();
    triangles.fold(0, |sum, triangle| {
        let words = triangle.source.into_iter().chain(triangle.leaves);
        sum.wrapping_add(words.fold(1, mix))
    })
}

fn report(options: &SoakOptions, tally: &Tally, seconds: f64) -> Report {
    let mut report = Report::default();
    let frames = tally.frames.max(1) as f64;
    report.line("model", options.model.display());
    report.line(
        "walk",
        format!(
            "{} in {seconds:.1} s, {}, {}",
            counted(tally.frames, "frame", "frames"),
            counted(tally.jumps, "jump", "jumps"),
            counted(tally.stops, "stop", "stops"),
        ),
    );
    report.line(
        "frames",
        format!(
            "{:.2} ms on average, {:.1} ms at the most; {} triangles and {} changes on average; threshold raised in {}",
            tally.frame_ms / frames,
            tally.frame_ms_max,
            grouped((tally.triangles as f64 / frames) as u64),
            grouped((tally.adapts as f64 / frames) as u64),
            grouped(tally.raised_frames),
        ),
    );
    report.line(
        "disk",
        format!(
            "{} read, {} tried again, {} given up; {}",
            counted(tally.pool.reads, "meta-node", "meta-nodes"),
            grouped(tally.pool.retries),
            grouped(tally.pool.read_failures),
            counted(tally.outages, "outage", "outages"),
        ),
    );
    report.line("misses", format!("{} of {} requests", grouped(tally.misses), grouped(tally.requests)));
    report.line("errors", format!("{} returned one", counted(tally.errors, "frame", "frames")));
    if let Some(error) = &tally.first_error {
        report.line("", format!("the first: {error}"));
    }
    report
        .line("checks", format!("{}, {}", grouped(tally.checks), counted(tally.violations, "violation", "violations")));
    for problem in &tally.told {
        report.line("", problem);
    }
    report.line(
        "settled",
        format!(
            "after {:.2} s on average, {:.2} s at the most; {} later than {TIME_TO_SETTLE} s, {} not within {PATIENCE} s",
            tally.settled_mean(),
            tally.settled_max(),
            counted(tally.settled_late() as u64, "stop", "stops"),
            tally.unsettled,
        ),
    );
    let part = |splits: u64| 100.0 * splits as f64 / tally.fresh_splits.max(1) as f64;
    report.line(
        "fresh start",
        format!(
            "the same picture at {}; {:.2} % more nodes split on average, {} fewer ({:.4} %)",
            counted(tally.equal, "stop", "stops"),
            part(tally.more_splits),
            grouped(tally.missing_splits),
            part(tally.missing_splits),
        ),
    );
    if let Some([least, mean, most]) = tally.threshold_ratios() {
        report.line(
            "limits",
            format!(
                "{} with a threshold raised, {least:.2} to {most:.2} times as far as from a fresh start, {mean:.2} on average; {} \
                 not compared",
                counted(tally.factors.len() as u64, "stop", "stops"),
                tally.incomparable,
            ),
        );
    }
    if let Some([first, last]) = tally.resident_ends() {
        let most = tally.resident.iter().copied().max().unwrap_or(0);
        let growth = (last as f64 - first as f64) / f64::from(1 << 20);
        report.line(
            "RAM",
            format!(
                "{} in the first tenth, {} in the last ({growth:+.1} MiB), {} at the most; {} allowed, and 8 MiB for the program",
                ByteSize(first),
                ByteSize(last),
                ByteSize(most),
                options.memory,
            ),
        );
    }
    report
}

fn to_json(options: &SoakOptions, tally: &Tally, seconds: f64) -> Value {
    let (ends, ratios) = (tally.resident_ends(), tally.threshold_ratios());
    let frames = tally.frames.max(1) as f64;
    let mut document = json!({
        "machine": Machine::this().to_json(),
        "model": options.model.display().to_string(),
        "memory_bytes": options.memory.0,
        "faults_percent": options.faults,
        "delay_ms": options.delay,
        "outage_ms": options.outage,
        "seed": options.seed,
        "frame_rate": options.frame_rate,
        "seconds": seconds,
        "frames": tally.frames,
        "jumps": tally.jumps,
        "stops": tally.stops,
        "checks": tally.checks,
        "violations": tally.violations,
        "violations_told": tally.told,
        "errors": tally.errors,
        "first_error": tally.first_error,
    });
    let figures = json!({
        "outages": tally.outages,
        "reads": tally.pool.reads,
        "retries": tally.pool.retries,
        "read_failures": tally.pool.read_failures,
        "misses": tally.misses,
        "requests": tally.requests,
        "adapts_mean": tally.adapts as f64 / frames,
        "triangles_mean": tally.triangles as f64 / frames,
        "frame_ms_mean": tally.frame_ms / frames,
        "frame_ms_max": tally.frame_ms_max,
        "raised_frames": tally.raised_frames,
        "settled_seconds_mean": tally.settled_mean(),
        "settled_seconds_max": tally.settled_max(),
        "stops_over_2_seconds": tally.settled_late(),
        "stops_unsettled": tally.unsettled,
        "stops_equal": tally.equal,
        "stops_limited": tally.factors.len(),
        "stops_not_compared": tally.incomparable,
        "fresh_splits": tally.fresh_splits,
        "more_splits": tally.more_splits,
        "missing_splits": tally.missing_splits,
        "threshold_ratio_min": ratios.map(|[least, _, _]| least),
        "threshold_ratio_mean": ratios.map(|[_, mean, _]| mean),
        "threshold_ratio_max": ratios.map(|[_, _, most]| most),
        "rss_first_bytes": ends.map(|[first, _]| first),
        "rss_last_bytes": ends.map(|[_, last]| last),
        "rss_growth_bytes": ends.map(|[first, last]| last as i64 - first as i64),
        "rss_peak_bytes": tally.resident.iter().max(),
    });
    if let (Value::Object(document), Value::Object(figures)) = (&mut document, figures) {
        document.extend(figures);
    }
    document
}
