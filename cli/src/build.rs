//! `vdt build`: from mesh files to a model.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Result;
use metanode::{ModelOptions, ModelSummary, write_model};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use storage::{ByteSize, CountingDisk, Disk, LocalDisk};
use vdt::build::{BuildOptions, BuildReport, Phase, build, needs};
use vdt::ingest::{self, CleaningCounts};

use crate::arguments;
use crate::output::{Report, counted, grouped, may_write};
use crate::progress::Progress;

pub fn run(options: arguments::BuildOptions, json: bool) -> Result<()> {
    let build_options = BuildOptions { memory: options.memory, metric: options.metric, strategy: options.strategy };
    let Some(output) = options.output.as_deref().filter(|_| !options.dry_run) else {
        return dry_run(&options, &build_options, json);
    };
    let inputs: Vec<&Path> = options.meshes.iter().map(AsRef::as_ref).collect();
    may_write(&LocalDisk, output, options.force, &inputs)?;

    let start = Instant::now();
    let disk = CountingDisk::new(Arc::new(LocalDisk));
    let progress = Progress::new("reading");
    let (tree, report) = build(&disk, &options.meshes, &build_options, &mut |phase, share| {
        progress.phase(match phase {
            Phase::Reading => "reading",
            Phase::Simplifying => "simplifying",
            Phase::Finishing => "finishing",
        });
        progress.show(share);
    })?;
    progress.phase("writing");
    let model_options = ModelOptions { blocking: options.blocking, metric: options.metric, strategy: options.strategy };
    let model = write_model(Arc::new(disk.clone()), output, &tree, &model_options)?;
    let (bytes_read, bytes_written) = (disk.bytes_read(), disk.bytes_written());
    let seconds = start.elapsed().as_secs_f64();
    // Another look at every byte of the model: only for those who get to see it.
    let digest = if json { Some(sha256(&disk, output)?) } else { None };
    drop(progress);

    let done = Done {
        vertices: tree.leaf_count() as u64,
        triangles: tree.triangles.corners.len() as u64,
        roots: tree.roots.len() as u64,
        largest_switch: tree.roots.iter().map(|root| tree.splits[root.split as usize].switch).fold(0.0, f32::max),
        report,
        model,
        seconds,
        cpu_seconds: storage::usage::cpu_time().as_secs_f64(),
        bytes_read,
        bytes_written,
        digest,
    };
    done.print(output, options.memory, json)
}

/// Everything that a build has to tell.
struct Done {
    vertices: u64,
    triangles: u64,
    roots: u64,
    largest_switch: f32,
    report: BuildReport,
    model: ModelSummary,
    seconds: f64,
    cpu_seconds: f64,
    bytes_read: u64,
    bytes_written: u64,
    digest: Option<String>,
}

impl Done {
    fn print(&self, output: &Path, memory: ByteSize, json: bool) -> Result<()> {
        let Done { report: build, model, .. } = self;
        let collapses = build.legal_collapses + build.end_phase_collapses;
        let rate = collapses as f64 / build.simplify_cpu_seconds.max(1e-9);
        let peak = storage::usage::peak_resident_bytes();
        let mut report = Report::default();
        report.line("model", output.display());
        report.line(
            "mesh",
            format!(
                "{}, {}, {}",
                counted(self.triangles, "triangle", "triangles"),
                counted(self.vertices, "vertex", "vertices"),
                counted(self.roots, "component", "components"),
            ),
        );
        for (_, count, message) in warnings(&build.cleaning) {
            report.line("note", format!("{} {message}", grouped(count)));
        }
        report.line(
            "collapses",
            format!(
                "{} in {}, {} of them in the end phase; {} per CPU-second",
                grouped(collapses),
                counted(build.rounds.into(), "round", "rounds"),
                grouped(build.end_phase_collapses),
                grouped(rate as u64),
            ),
        );
        report.line(
            "meta-nodes",
            format!(
                "{} in {}, {:.0} % full, at most {} decoded",
                grouped(model.pages.into()),
                counted(model.page_levels.into(), "level", "levels"),
                100.0 * model.fill,
                ByteSize(model.slot_bytes.into()),
            ),
        );
        report.line("size", self.size());
        report.line("time", format!("{:.2} s ({:.2} s of CPU)", self.seconds, self.cpu_seconds));
        if let Some(peak) = peak {
            report.line("peak RAM", format!("{} of {} allowed", ByteSize(peak), memory));
        }
        report.print(json, &self.to_json(peak, rate))
    }

    fn size(&self) -> String {
        let per_vertex = self.model.bytes as f64 / self.vertices.max(1) as f64;
        match self.vertices {
            0 => ByteSize(self.model.bytes).to_string(),
            _ => format!("{}, {per_vertex:.1} bytes per vertex", ByteSize(self.model.bytes)),
        }
    }

    fn to_json(&self, peak: Option<u64>, rate: f64) -> Value {
        let Done { report: build, model, .. } = self;
        json!({
            "vertices": self.vertices,
            "triangles": self.triangles,
            "components": self.roots,
            "input_vertices": build.files.vertices,
            "input_triangles": build.files.triangles,
            "warnings": warnings_json(&build.cleaning),
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "simplify_cpu_seconds": build.simplify_cpu_seconds,
            "collapses_per_cpu_second": rate,
            "peak_rss_bytes": peak,
            "bytes_read": self.bytes_read,
            "bytes_written": self.bytes_written,
            "passes": build.rounds,
            "collapses": build.legal_collapses + build.end_phase_collapses,
            "end_phase_collapses": build.end_phase_collapses,
            "roots": self.roots,
            "meta_nodes": model.pages,
            "meta_node_levels": model.page_levels,
            "meta_node_fill": model.fill,
            "slot_bytes": model.slot_bytes,
            "largest_error": self.largest_switch,
            "model_bytes": model.bytes,
            "model_sha256": self.digest,
        })
    }
}

/// What was changed on the way in: a name for programs, how often, and a sentence for people that begins with the number.
fn warnings(cleaning: &CleaningCounts) -> Vec<(&'static str, u64, &'static str)> {
    let CleaningCounts {
        welded_vertices,
        isolated_vertices,
        degenerate_triangles,
        duplicate_triangles,
        degenerate_faces,
        polygons,
        skipped_elements,
    } = *cleaning;
    [
        ("welded_vertices", welded_vertices, "vertices had the position of another one and were welded to it"),
        ("isolated_vertices", isolated_vertices, "vertices that no triangle uses were left out"),
        ("degenerate_triangles", degenerate_triangles, "triangles with two corners at one position were left out"),
        ("duplicate_triangles", duplicate_triangles, "triangles were there before and were left out"),
        ("degenerate_faces", degenerate_faces, "faces of fewer than three corners were left out"),
        ("polygons", polygons, "polygons were cut into triangles"),
        ("skipped_elements", skipped_elements, "points, lines or curves are no part of a surface and were left out"),
    ]
    .into_iter()
    .filter(|(_, count, _)| *count > 0)
    .collect()
}

fn warnings_json(cleaning: &CleaningCounts) -> Vec<Value> {
    warnings(cleaning)
        .into_iter()
        .map(|(kind, count, message)| json!({ "kind": kind, "count": count, "message": message }))
        .collect()
}

fn dry_run(options: &arguments::BuildOptions, build_options: &BuildOptions, json: bool) -> Result<()> {
    let progress = Progress::new("counting");
    let counts = ingest::count(&LocalDisk, &options.meshes)?;
    drop(progress);
    let needs = needs(counts, build_options.strategy);
    let fits = needs <= options.memory;
    let mut report = Report::default();
    report.line(
        "mesh",
        format!(
            "{}, {}",
            counted(counts.triangles, "triangle", "triangles"),
            counted(counts.vertices, "vertex", "vertices")
        ),
    );
    report.line("RAM needed", format!("{needs}: run with --memory {} or more", needs.as_argument()));
    report.line("RAM allowed", format!("{}: {}", options.memory, if fits { "enough" } else { "not enough" }));
    report.print(
        json,
        &json!({
            "input_vertices": counts.vertices,
            "input_triangles": counts.triangles,
            "memory_needed_bytes": needs.0,
            "memory_bytes": options.memory.0,
            "fits": fits,
        }),
    )
}

fn sha256(disk: &dyn Disk, path: &Path) -> Result<String> {
    let file = disk.open(path)?;
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 256 << 10];
    let mut offset = 0;
    loop {
        let count = file.read_at(offset, &mut buffer)?;
        if count == 0 {
            break;
        }
        hasher.update(&buffer[..count]);
        offset += count as u64;
    }
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}
