//! `vdt build`: from mesh files to a model.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Instant, UNIX_EPOCH};

use anyhow::{Context, Result, anyhow, bail};
use metanode::header::{Blocking, Strategy};
use metanode::{ModelOptions, ModelSummary, WriteResources, write_model};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use storage::{ByteSize, CountingDisk, Disk, LocalDisk, Scratch};
use vdt::build::{BuildError, BuildOptions, BuildReport, Estimate, Phase, PhaseWatch, Step, build, estimate};
use vdt::ingest::{self, PositionsRule};
use vdt::mesh::MeshError;
use vdt::tree::Positions;

use crate::arguments;
use crate::output::{Report, attribute_names, counted, grouped, input_error, may_write, positions};
use crate::progress::Progress;
use crate::warnings;

/// Bytes of a model for each vertex, with positions of 16 bits or on a lattice of the mesh's own; measured: 5.3 to 7.4.
const MODEL_BYTES_PER_VERTEX: u64 = 7;
/// The same where every bit is kept of positions that are on no lattice; measured: 10.8 to 11.3.
const LOSSLESS_MODEL_BYTES_PER_VERTEX: u64 = 11;

pub fn run(options: arguments::BuildOptions, json: bool) -> Result<()> {
    let build_options = BuildOptions {
        memory: options.memory,
        threads: options.threads.map_or_else(available_threads, usize::from),
        metric: options.metric,
        strategy: options.strategy,
        error_bound: options.error_bound,
        edge_tree: options.edge_tree,
        positions: options.positions,
        attributes: !options.no_attributes,
    };
    let Some(output) = options.output.as_deref().filter(|_| !options.dry_run) else {
        return dry_run(&options, &build_options, json);
    };
    let inputs: Vec<&Path> = options.meshes.iter().map(AsRef::as_ref).collect();
    may_write(&LocalDisk, output, options.force, &inputs)?;

    let start = Instant::now();
    let disk = CountingDisk::new(Arc::new(LocalDisk));
    let folder = scratch_folder(options.scratch.as_deref(), output)?;
    let fingerprint = fingerprint(&options.meshes, &build_options)?;
    let (scratch, resumed) = Scratch::open(Arc::new(disk.clone()), &folder, &fingerprint)?;
    let is_resumed = resumed.is_some();
    let progress = BuildProgress::new();
    let mut show = |step| progress.show(step);
    let way = Way { options: &build_options, blocking: options.blocking, scratch: &scratch, progress: &mut show };
    let Built { vertices, triangles, roots, report, model } =
        build_model(Arc::new(disk.clone()), &options.meshes, output, resumed, way)?;
    let scratch_peak_bytes = scratch.peak_bytes_on_disk();
    drop(scratch);
    let (bytes_read, bytes_written) = (disk.bytes_read(), disk.bytes_written());
    let seconds = start.elapsed().as_secs_f64();
    let cpu_seconds = storage::usage::cpu_time().as_secs_f64();
    // Another look at every byte of the model: only for those who get to see it.
    let digest = if json { Some(sha256(&disk, output)?) } else { None };
    drop(progress);

    let done = Done {
        vertices,
        triangles,
        roots,
        options: build_options,
        is_resumed,
        scratch_peak_bytes,
        report,
        model,
        seconds,
        cpu_seconds,
        bytes_read,
        bytes_written,
        digest,
    };
    done.print(output, options.memory, json)
}

/// A model that was built.
pub struct Built {
    vertices: u64,
    triangles: u64,
    roots: u64,
    /// What happened.
    pub report: BuildReport,
    model: ModelSummary,
}

/// How a model is built.
pub struct Way<'a> {
    /// All that decides the tree.
    pub options: &'a BuildOptions,
    /// How the tree is cut into meta-nodes.
    pub blocking: Blocking,
    /// Where what does not fit goes, and checkpoints.
    pub scratch: &'a Scratch,
    /// Is told how far it is.
    pub progress: &'a mut (dyn FnMut(Step) + Send),
}

/// What is wrong with attributes does not keep anybody from the mesh: says how to do without.
fn advised(error: BuildError) -> anyhow::Error {
    match error {
        BuildError::Mesh(MeshError::AttributeNotFinite { .. } | MeshError::AttributeOutOfRange { .. }) => {
            anyhow!("{error}; run again with --no-attributes to leave all attributes out")
        }
        error => error.into(),
    }
}

/// Builds the model of mesh files and writes it to `output`; from the checkpoint of an earlier run on, where there is one.
pub fn build_model(
    disk: Arc<dyn Disk>,
    meshes: &[PathBuf],
    output: &Path,
    resumed: Option<Value>,
    way: Way<'_>,
) -> Result<Built> {
    let Way { options, blocking, scratch, progress } = way;
    if options.threads > 1 {
        scratch.overlap();
    }
    let (tree, mut report) = build(disk.as_ref(), meshes, options, scratch, resumed, progress).map_err(advised)?;
    let watch = PhaseWatch::start();
    let BuildOptions { metric, strategy, error_bound, memory, threads, .. } = *options;
    let (input_error, positions) = (report.input_error, report.positions);
    let model_options = ModelOptions { blocking, metric, strategy, error_bound, input_error, positions };
    let (vertices, triangles, roots) = (tree.leaf_count(), tree.triangles.len(), tree.roots.len() as u64);
    let resources = WriteResources { scratch: scratch.clone(), memory, threads };
    let model = write_model(disk, output, &tree, &model_options, &resources, &mut |share| {
        progress(Step { phase: Phase::Writing, share, triangles });
    })?;
    drop(resources);
    drop(tree);
    scratch.discard_checkpoint()?;
    report.phases.push(watch.cost(Phase::Writing));
    Ok(Built { vertices, triangles, roots, report, model })
}

/// Everything that a build has to tell.
struct Done {
    vertices: u64,
    triangles: u64,
    roots: u64,
    options: BuildOptions,
    is_resumed: bool,
    scratch_peak_bytes: u64,
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
        let simplifying = build.phases.iter().find(|cost| cost.phase == Phase::Simplifying);
        let rate = simplifying.map(|cost| collapses as f64 / cost.cpu_seconds.max(1e-9));
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
        warnings::tell(&mut report, &build.cleaning, &build.missing_files);
        report.line("attributes", build.attributes);
        report.line("positions", positions(build.positions, build.lattice_step));
        if build.input_error > 0.0 {
            report.line("input error", input_error(build.input_error, build.positions));
        }
        report.line(
            "collapses",
            format!(
                "{} in {}, {} of them in the end phase{}",
                grouped(collapses),
                counted(build.rounds.into(), "round", "rounds"),
                grouped(build.end_phase_collapses),
                rate.map_or(String::new(), |rate| format!("; {} per CPU-second", grouped(rate as u64))),
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
        if self.is_resumed {
            report.line("resumed", "an earlier run was interrupted; what it had finished was taken over");
        }
        let phases = build.phases.iter().map(|cost| format!("{} {:.1} s", name_of(cost.phase), cost.seconds));
        report.line("time", format!("{:.2} s ({:.2} s of CPU)", self.seconds, self.cpu_seconds));
        report.line("", phases.collect::<Vec<_>>().join(", "));
        if let Some(peak) = peak {
            report.line("peak RAM", format!("{} of {} allowed", ByteSize(peak), memory));
        }
        if self.scratch_peak_bytes > 0 {
            report.line("scratch", format!("{} of disk at its peak", ByteSize(self.scratch_peak_bytes)));
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

    fn to_json(&self, peak: Option<u64>, rate: Option<f64>) -> Value {
        let Done { report: build, model, options, .. } = self;
        let simplifying = build.phases.iter().find(|cost| cost.phase == Phase::Simplifying);
        let phases: Vec<Value> = build
            .phases
            .iter()
            .map(|cost| {
                json!({
                    "name": name_of(cost.phase),
                    "seconds": cost.seconds,
                    "cpu_seconds": cost.cpu_seconds,
                    "bytes_read": cost.bytes_read,
                    "bytes_written": cost.bytes_written,
                })
            })
            .collect();
        let io = storage::usage::bytes_read_and_written();
        json!({
            "vertices": self.vertices,
            "triangles": self.triangles,
            "components": self.roots,
            "input_vertices": build.files.vertices,
            "input_triangles": build.files.triangles,
            "positions": build.positions.to_string(),
            "lattice_step": build.lattice_step,
            "input_error": build.input_error,
            "attributes": attribute_names(build.attributes),
            "warnings": warnings::to_json(&build.cleaning, &build.missing_files),
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "simplify_cpu_seconds": simplifying.map(|cost| cost.cpu_seconds),
            "collapses_per_cpu_second": rate,
            "peak_rss_bytes": peak,
            "memory_bytes": options.memory.0,
            "threads": options.threads,
            "metric": options.metric.to_string(),
            "strategy": options.strategy.to_string(),
            "error_bound": options.error_bound.to_string(),
            "edge_tree": (options.strategy == Strategy::Btree).then(|| options.edge_tree.to_string()),
            "spanned": build.spanned.map(|spanned| json!({
                "tree_bytes_read": spanned.tree.read,
                "tree_bytes_written": spanned.tree.written,
                "record_bytes_read": spanned.records.read,
                "record_bytes_written": spanned.records.written,
                "loads": spanned.loads,
                "loads_cut_short": spanned.cut_short,
                "spanning_edges": spanned.spanning_edges,
                "sub_meshes": spanned.sub_meshes,
                "sub_mesh_triangles": spanned.sub_mesh_triangles,
                "largest_sub_mesh_triangles": spanned.largest_sub_mesh,
                "edges_void": spanned.void_edges,
                "edges_removed": spanned.removed_edges,
                "edges_inserted": spanned.inserted_edges,
                "edges_at_most": spanned.largest_tree,
            })),
            "resumed": self.is_resumed,
            "phases": phases,
            "bytes_read": self.bytes_read,
            "bytes_written": self.bytes_written,
            "io_read_bytes": io.map(|io| io.0),
            "io_written_bytes": io.map(|io| io.1),
            "scratch_peak_bytes": self.scratch_peak_bytes,
            "passes": build.rounds,
            "collapses": build.legal_collapses + build.end_phase_collapses,
            "end_phase_collapses": build.end_phase_collapses,
            "roots": self.roots,
            "meta_nodes": model.pages,
            "meta_node_levels": model.page_levels,
            "meta_node_fill": model.fill,
            "slot_bytes": model.slot_bytes,
            "largest_error": model.largest_switch,
            "model_bytes": model.bytes,
            "model_sha256": self.digest,
        })
    }
}

/// The name of a phase for programs.
fn name_of(phase: Phase) -> &'static str {
    match phase {
        Phase::Reading => "ingest",
        Phase::Simplifying => "simplify",
        Phase::Numbering => "number",
        Phase::Writing => "write",
    }
}

/// How many threads this machine runs at once.
pub fn available_threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Where the scratch of this output is: a hidden folder beside it, or one of its own in the folder asked for.
pub fn scratch_folder(asked_for: Option<&Path>, output: &Path) -> Result<PathBuf> {
    let name = output.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let Some(folder) = asked_for else { return Ok(output.with_file_name(format!(".{name}.scratch"))) };
    if !folder.is_dir() {
        bail!("{}: there is no such directory for the scratch", folder.display());
    }
    // Outputs of the same name in different places are different outputs.
    let place = std::path::absolute(output).with_context(|| format!("{}: where is that?", output.display()))?;
    let digest = Sha256::digest(place.as_os_str().as_encoded_bytes());
    let mark: String = digest.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
    Ok(folder.join(format!("vdt-{name}-{mark}.scratch")))
}

/// What a checkpoint depends on: the files, as far as their size and time tell, and the options.
pub fn fingerprint(meshes: &[PathBuf], build: &BuildOptions) -> Result<String> {
    let mut text = format!(
        "vdt {} memory {} threads {} metric {} strategy {} {} error bound {} positions {} attributes {}",
        env!("CARGO_PKG_VERSION"),
        build.memory.0,
        build.threads,
        build.metric,
        build.strategy,
        build.edge_tree,
        build.error_bound,
        build.positions,
        build.attributes
    );
    for mesh in meshes {
        let path = std::path::absolute(mesh).with_context(|| format!("{}: where is that?", mesh.display()))?;
        // A file that cannot be read is the reader's to complain of.
        if let Ok(metadata) = std::fs::metadata(mesh) {
            let changed = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
            let nanoseconds = changed.map_or(0, |time| time.as_nanos());
            text.push_str(&format!("; {} {} {nanoseconds}", path.display(), metadata.len()));
        }
    }
    Ok(text)
}

/// How much of the whole build each phase is, on average, and where it begins.
fn share_of(phase: Phase) -> (f64, f64) {
    match phase {
        Phase::Reading => (0.0, 0.15),
        Phase::Simplifying => (0.15, 0.6),
        Phase::Numbering => (0.75, 0.12),
        Phase::Writing => (0.87, 0.13),
    }
}

/// What part of the whole build is done with this part of a phase.
pub fn share_of_all(phase: Phase, share: f64) -> f64 {
    let (start, length) = share_of(phase);
    start + length * share
}

/// What is done in a phase, for people.
pub fn doing(phase: Phase) -> &'static str {
    match phase {
        Phase::Reading => "reading",
        Phase::Simplifying => "simplifying",
        Phase::Numbering => "numbering",
        Phase::Writing => "writing",
    }
}

/// A bar over the whole build, with the rate of the phase that goes on.
#[derive(Debug)]
pub struct BuildProgress {
    bar: Progress,
    /// The phase, and since when it goes on.
    phase: Mutex<(Phase, Instant)>,
}

impl BuildProgress {
    /// Begins a bar.
    pub fn new() -> Self {
        BuildProgress { bar: Progress::new("reading"), phase: Mutex::new((Phase::Reading, Instant::now())) }
    }

    /// Shows how far the build is.
    pub fn show(&self, Step { phase, share, triangles }: Step) {
        let mut at = self.phase.lock().unwrap_or_else(PoisonError::into_inner);
        if at.0 != phase {
            *at = (phase, Instant::now());
        }
        let seconds = at.1.elapsed().as_secs_f64();
        let name = doing(phase);
        let rate = triangles as f64 * share / seconds.max(1e-3);
        if triangles > 0 && seconds > 0.5 {
            self.bar.phase(format!("{name}, {:.0} K triangles/s", rate / 1e3));
        } else {
            self.bar.phase(name);
        }
        self.bar.show(share_of_all(phase, share));
    }
}

fn dry_run(options: &arguments::BuildOptions, build_options: &BuildOptions, json: bool) -> Result<()> {
    let progress = Progress::waiting("counting");
    let (counts, kinds) =
        ingest::count(&LocalDisk, &options.meshes, build_options.attributes).map_err(|error| advised(error.into()))?;
    drop(progress);
    let Estimate { peak_bytes, smallest_memory, scratch_bytes, cpu_seconds } = estimate(counts, kinds, build_options);
    let fits = smallest_memory <= options.memory;
    let per_vertex = match build_options.positions {
        PositionsRule::Fixed(Positions::Lossless) => LOSSLESS_MODEL_BYTES_PER_VERTEX,
        PositionsRule::Fixed(Positions::Bits(_)) | PositionsRule::Auto => MODEL_BYTES_PER_VERTEX,
    };
    let model_bytes = counts.vertices.min(counts.triangles / 2 + 2) * per_vertex;
    let mut report = Report::default();
    report.line(
        "mesh",
        format!(
            "{}, {}",
            counted(counts.triangles, "triangle", "triangles"),
            counted(counts.vertices, "vertex", "vertices")
        ),
    );
    let smallest = smallest_memory.as_argument();
    report.line("RAM", format!("{} of {} allowed", ByteSize(peak_bytes), options.memory));
    report.line(
        "least RAM",
        format!("{smallest}: {}", if fits { "what is allowed is enough" } else { "run with --memory of that or more" }),
    );
    report.line("scratch", format!("{} of disk", ByteSize(scratch_bytes)));
    report.line("model", format!("about {}", ByteSize(model_bytes)));
    report.line("time", format!("about {cpu_seconds:.0} s of CPU, on a machine like the author's"));
    report.print(
        json,
        &json!({
            "input_vertices": counts.vertices,
            "input_triangles": counts.triangles,
            "memory_needed_bytes": smallest_memory.0,
            "memory_bytes": options.memory.0,
            "fits": fits,
            "estimated_peak_rss_bytes": peak_bytes,
            "estimated_scratch_peak_bytes": scratch_bytes,
            "estimated_model_bytes": model_bytes,
            "estimated_cpu_seconds": cpu_seconds,
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
