//! `vdt navigate`: a flight along a camera path, within a RAM budget, and what every frame of it did.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use metanode::model::Model;
use metanode::{DecodedFile, write_decoded};
use navigator::{
    FlightSummary, FrameStatistics, Io, Light, Navigator, NavigatorOptions, PathSpec, Policy, PoolCounters,
    ViewParameters,
};
use serde_json::{Value, json};
use storage::{AtomicFile, ByteSize, DirectDisk, Disk, LocalDisk};

use crate::arguments::{self, IoName, PolicyName};
use crate::bench::Workshop;
use crate::output::{Report, bound, counted, grouped, length, may_write};
use crate::progress::Progress;
use crate::statement::why_not_guaranteed;

/// The first line of the CSV file: the fields of [`FrameStatistics`].
const CSV_HEADER: &str = "frame,triangles,vertices,splits,collapses,requests,misses,blocked,forced,repaired,unrepaired,over_budget,postponed,morphs,\
threshold_factor,pixels_drawn,error_stated,guaranteed,vanished_parts,pages_in_use,reads,bytes_read,second_chances,urgent,prefetch_given_up,\
prefetched,prefetch_used,cancelled,evicted,evicted_wished,evicted_untried,retries,read_failures,frame_ms,cpu_ms\n";

/// Frames in which the picture of the first camera has to come to rest, where it is to.
const MOST_FRAMES_TO_SETTLE: u64 = 2000;

/// What is known of a flight besides the summary of its frames.
#[derive(Debug, Default)]
struct Flight {
    summary: FlightSummary,
    /// Place holders; `None` where there are none.
    place_holders: Option<usize>,
    /// Bytes that were planned for.
    planned_bytes: u64,
    /// Those who read and decode meta-nodes.
    io_threads: usize,
    /// Bytes of the file of decoded meta-nodes, if it was flown by virtual memory.
    decoded_bytes: Option<u64>,
    /// Most bytes that nodes and triangles of the front took after a frame.
    front_bytes: u64,
    /// Frames with a threshold raised because of a limit.
    raised_frames: u64,
    /// Wishes that were refused because of a limit.
    over_budget: u64,
    /// Largest resident set of the process.
    peak: Option<u64>,
}

pub fn run(options: arguments::NavigateOptions, json: bool) -> Result<()> {
    options.check();
    let disk: Arc<dyn Disk> = Arc::new(LocalDisk);
    if let Some(csv) = &options.csv {
        let mut inputs = vec![options.model.as_path()];
        if let PathSpec::File(path) = &options.path {
            inputs.push(path);
        }
        may_write(disk.as_ref(), csv, options.force, &inputs)?;
    }
    let model_disk: &dyn Disk = if options.direct { &DirectDisk } else { &LocalDisk };
    let model = Arc::new(Model::open(model_disk, &options.model)?);
    let cameras = options.path.cameras(disk.as_ref(), &model)?;
    let navigator_options = NavigatorOptions {
        memory: options.memory.0,
        pixels: options.picture.pixels,
        width: options.picture.size.width,
        height: options.picture.size.height,
        view: ViewParameters {
            frustum: !options.no_frustum,
            cones: !options.no_cones,
            silhouettes: options.silhouettes,
            light: options.light.map(|light| Light { direction: light.0.into(), highlights: options.highlights }),
        },
        dependency: options.dependency.into(),
        max_triangles: options.max_triangles,
        max_adapts: (options.max_adapts > 0).then_some(options.max_adapts),
        geomorph: options.geomorph,
        attributes: false,
        io: match options.io {
            IoName::Thread => Io::Thread,
            IoName::Sync | IoName::Mmap => Io::Sync,
        },
        io_threads: options.io_threads.map(usize::from),
        prefetch: !options.no_prefetch,
        policy: match options.policy {
            PolicyName::SecondChance => Policy::SecondChance,
            PolicyName::Lru => Policy::LeastRecentlyUsed,
            PolicyName::None => Policy::None,
        },
    };
    let mut flight = Flight::default();
    let mut navigator = if options.io == IoName::Mmap {
        let decoded = decoded_file(&disk, &options, &model)?;
        flight.decoded_bytes = Some(decoded.bytes());
        Navigator::open_mapped(model.clone(), navigator_options, decoded)?
    } else {
        Navigator::open(model.clone(), navigator_options)?
    };
    flight.place_holders = flight.decoded_bytes.is_none().then(|| navigator.place_holders());
    flight.planned_bytes = navigator.budget_bytes();
    flight.io_threads = navigator.io_threads();

    if options.warm {
        let progress = Progress::new("flying to warm up");
        for (number, camera) in cameras.iter().enumerate() {
            navigator.frame(camera)?;
            progress.show((number + 1) as f64 / cameras.len() as f64);
        }
    }
    let progress = Progress::new("flying");
    let pace = (options.frame_rate > 0.0 && options.io != IoName::Sync).then(|| 1.0 / options.frame_rate);
    let mut csv = options.csv.as_deref().map(|path| AtomicFile::create(disk.clone(), path)).transpose()?;
    if let Some(csv) = &mut csv {
        csv.append(CSV_HEADER.as_bytes())?;
    }
    if let Some(first) = cameras.first().filter(|_| options.settle) {
        navigator.run_until_settled(first, MOST_FRAMES_TO_SETTLE)?;
    }
    let start = Instant::now();
    for (number, camera) in cameras.iter().enumerate() {
        if let Some(seconds) = pace {
            let due = Duration::from_secs_f64(seconds * number as f64);
            std::thread::sleep(due.saturating_sub(start.elapsed()));
        }
        let frame = FrameStatistics { frame: number as u64, ..navigator.frame(camera)? };
        flight.summary.add(&frame);
        flight.front_bytes = flight.front_bytes.max(navigator.front_bytes());
        flight.raised_frames += u64::from(frame.threshold_factor > 1.0);
        flight.over_budget += frame.over_budget;
        if let Some(csv) = &mut csv {
            csv.append(csv_line(&frame).as_bytes())?;
        }
        progress.show((number + 1) as f64 / cameras.len() as f64);
    }
    drop(progress);
    drop(navigator);
    if let Some(csv) = csv {
        csv.commit()?;
    }
    flight.peak = storage::usage::peak_resident_bytes();
    report(&options, &flight, &model).print(json, &to_json(&options, &flight, &model))
}

/// The decoded meta-nodes of the model, in the file asked for or in a temporary one, which has no name any more once it is
/// mapped.
fn decoded_file(disk: &Arc<dyn Disk>, options: &arguments::NavigateOptions, model: &Model) -> Result<DecodedFile> {
    let advice = options.advice.unwrap_or_default();
    let open = |path: &Path| -> Result<DecodedFile> {
        let decoded = DecodedFile::open(disk.as_ref(), path, model)?;
        decoded.advise(advice)?;
        Ok(decoded)
    };
    let write = |path: &Path| {
        let progress = Progress::new("decoding all meta-nodes");
        write_decoded(disk.clone(), path, model, &mut |share| progress.show(share))
    };
    match &options.decoded {
        Some(path) => {
            if !disk.exists(path) {
                may_write(disk.as_ref(), path, false, &[&options.model])?;
                write(path)?;
            }
            open(path)
        }
        None => {
            let workshop = Workshop::new(&std::env::temp_dir())?;
            let path = workshop.folder().join("pages");
            write(&path)?;
            open(&path)
        }
    }
}

fn csv_line(frame: &FrameStatistics) -> String {
    let FrameStatistics {
        frame,
        triangles,
        vertices,
        splits,
        collapses,
        misses,
        requests,
        blocked,
        forced,
        repaired,
        unrepaired,
        over_budget,
        postponed,
        morphs,
        threshold_factor,
        pixels_drawn,
        error_stated,
        guaranteed,
        vanished_parts,
        pages_in_use,
        frame_ms,
        cpu_ms,
        pool,
    } = frame;
    let PoolCounters {
        reads,
        bytes_read,
        second_chances,
        urgent,
        prefetched,
        prefetch_used,
        prefetch_given_up,
        cancelled,
        evicted,
        evicted_wished,
        evicted_untried,
        retries,
        read_failures,
        starved: _,
    } = pool;
    format!(
        "{frame},{triangles},{vertices},{splits},{collapses},{requests},{misses},{blocked},{forced},{repaired},{unrepaired},{over_budget},{postponed},{morphs},\
         {threshold_factor},{pixels_drawn},{error_stated},{},{vanished_parts},{pages_in_use},{reads},{bytes_read},{second_chances},{urgent},\
         {prefetch_given_up},{prefetched},{prefetch_used},{cancelled},{evicted},{evicted_wished},{evicted_untried},{retries},\
         {read_failures},{frame_ms:.3},{cpu_ms:.3}\n",
        u8::from(*guaranteed)
    )
}

fn report(options: &arguments::NavigateOptions, flight: &Flight, model: &Model) -> Report {
    let Flight { summary, .. } = flight;
    let mut report = Report::default();
    report.line("model", options.model.display());
    report.line("flight", format!("{} frames at {} pixel(s)", grouped(summary.frames()), options.picture.pixels));
    report.line(
        "triangles",
        format!(
            "{} in a frame on average, of {}",
            grouped(summary.triangles_mean() as u64),
            grouped(model.header().triangle_count.into())
        ),
    );
    report.line("adapts", format!("{} splits and collapses in a frame", grouped(summary.adapts_mean() as u64)));
    report.line("misses", format!("{:.2} % of the requests", summary.miss_percent()));
    if summary.postponed > 0 {
        let most = grouped(options.max_adapts);
        report.line(
            "postponed",
            format!("{} wishes, because a frame makes at most {most} changes", grouped(summary.postponed)),
        );
    }
    if options.geomorph > 0 {
        let (morphs, frames) = (grouped(summary.morphs_mean() as u64), options.geomorph);
        report.line("geomorphs", format!("{morphs} vertices on their way in a frame, each for {frames} frames"));
    }
    report.line(
        "frame time",
        format!(
            "{:.2} ms on average, {:.2} ms median, {:.2} ms at the 99th percentile; {:.2} ms of CPU",
            summary.frame_ms_mean(),
            summary.frame_ms_percentile(50.0),
            summary.frame_ms_percentile(99.0),
            summary.cpu_ms_mean(),
        ),
    );
    report.line(
        "disk",
        format!(
            "{} meta-nodes read ({}), {} of them urgently, {} ahead of time, of which {} were used; {} second chances",
            grouped(summary.pool.reads),
            ByteSize(summary.pool.bytes_read),
            grouped(summary.pool.urgent),
            grouped(summary.pool.prefetched),
            grouped(summary.pool.prefetch_used),
            grouped(summary.pool.second_chances),
        ),
    );
    report.line(
        "pixels",
        format!(
            "{:.2} median, {:.2} at the 99th percentile; at most twice what is asked for in {:.1} % of the frames",
            summary.pixels_percentile(50.0),
            summary.pixels_percentile(99.0),
            summary.within_pixels_percent(2.0 * f64::from(options.picture.pixels)),
        ),
    );
    let stated = f64::from(summary.error_stated);
    let error = match summary.guaranteed() {
        true => format!("up to {} in the picture, guaranteed for the parts that are drawn", bound(stated)),
        false => format!("up to {} in the picture, {}", length(stated), why_not_guaranteed(model.header().error_bound)),
    };
    report.line("error", error);
    if summary.vanished_parts > 0 {
        let parts = counted(model.header().root_count.into(), "part", "parts");
        let vanished = grouped(summary.vanished_parts);
        report.line("vanished", format!("up to {vanished} of {parts} are not drawn; the error is that of the others"));
    }
    if summary.threshold_factor > 1.0 {
        let pixels = options.picture.pixels * summary.threshold_factor;
        report.line("note", format!("the budget did not always allow this error: up to {pixels:.1} pixels were drawn"));
    }
    if summary.pool.retries > 0 {
        let (retries, failures) = (grouped(summary.pool.retries), grouped(summary.pool.read_failures));
        report.line("note", format!("{retries} reads were tried again, {failures} meta-nodes could not be read"));
    }
    if let Some(peak) = flight.peak {
        let pages = match (flight.place_holders, flight.decoded_bytes) {
            (Some(count), _) => format!("with {} place holders, and 8 MiB for the program", grouped(count as u64)),
            (None, bytes) => format!("and what the system keeps of a file of {}", ByteSize(bytes.unwrap_or(0))),
        };
        report.line("peak RAM", format!("{}; {} allowed, {pages}", ByteSize(peak), options.memory));
    }
    report
}

fn to_json(options: &arguments::NavigateOptions, flight: &Flight, model: &Model) -> Value {
    let Flight { summary, .. } = flight;
    let mut frames = json!({
        "frames": summary.frames(),
        "triangles_mean": summary.triangles_mean(),
        "adapts_mean": summary.adapts_mean(),
        "miss_percent": summary.miss_percent(),
        "postponed": summary.postponed,
        "frame_ms_mean": summary.frame_ms_mean(),
        "frame_ms_p50": summary.frame_ms_percentile(50.0),
        "frame_ms_p99": summary.frame_ms_percentile(99.0),
        "cpu_ms_mean": summary.cpu_ms_mean(),
        "cpu_ms_p50": summary.cpu_ms_percentile(50.0),
        "cpu_ms_p99": summary.cpu_ms_percentile(99.0),
        "morphs_mean": summary.morphs_mean(),
        "pixels_p50": summary.pixels_percentile(50.0),
        "pixels_p99": summary.pixels_percentile(99.0),
        "pixels_max": summary.pixels_percentile(100.0),
        "within_twice_percent": summary.within_pixels_percent(2.0 * f64::from(options.picture.pixels)),
        "error_stated": summary.error_stated,
        "guaranteed": summary.guaranteed(),
        "vanished_parts_max": summary.vanished_parts,
        "input_error": model.header().input_error,
        "error_bound": model.header().error_bound.to_string(),
    });
    let of_disk = json!({
        "reads": summary.pool.reads,
        "bytes_read": summary.pool.bytes_read,
        "second_chances": summary.pool.second_chances,
        "urgent": summary.pool.urgent,
        "prefetch_given_up": summary.pool.prefetch_given_up,
        "prefetched": summary.pool.prefetched,
        "prefetch_used": summary.pool.prefetch_used,
        "cancelled": summary.pool.cancelled,
        "evicted": summary.pool.evicted,
        "evicted_wished": summary.pool.evicted_wished,
        "evicted_untried": summary.pool.evicted_untried,
        "retries": summary.pool.retries,
        "read_failures": summary.pool.read_failures,
        "io_threads": flight.io_threads,
        "direct": model.is_direct(),
        "threshold_factor_max": summary.threshold_factor,
        "raised_frames": flight.raised_frames,
        "over_budget": flight.over_budget,
        "place_holders": flight.place_holders,
        "decoded_bytes": flight.decoded_bytes,
        "front_bytes_max": flight.front_bytes,
        "peak_rss_bytes": flight.peak,
        "budget_bytes": options.memory.0,
        "planned_bytes": flight.planned_bytes,
    });
    if let (Value::Object(all), Value::Object(of_disk)) = (&mut frames, of_disk) {
        all.extend(of_disk);
    }
    let by_dependency = [
        ("blocked", summary.blocked),
        ("forced", summary.forced),
        ("repaired", summary.repaired),
        ("unrepaired", summary.unrepaired),
    ];
    by_dependency.into_iter().for_each(|(name, count)| frames[name] = count.into());
    frames
}
