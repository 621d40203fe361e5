//! `vdt view`: a window onto a model, or onto the model of a mesh, which is built where there is none.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail};
use metanode::header::{Blocking, ErrorBound, Metric, ModelError, Strategy};
use metanode::model::Model;
use serde_json::{Value, json};
use storage::{AtomicFile, ByteSize, Disk, EdgeTreeKind, LocalDisk, Scratch};
use vdt::build::{BuildOptions, Step};
use vdt::ingest::PositionsRule;
use view::{LastViews, Opened, Opener, Progress, Summary, ViewOptions};

use crate::arguments;
use crate::build::{Built, Way, available_threads, build_model, doing, fingerprint, scratch_folder, share_of_all};
use crate::compare::is_model;
use crate::output::{Report, counted, grouped};
use crate::warnings;

pub fn run(options: arguments::ViewOptions, json: bool) -> Result<()> {
    if let Some(file) = &options.file {
        // Before there is a window.
        is_model(file)?;
    }
    let camera = options.camera.map(|camera| camera.camera());
    if let Some(camera) = &camera {
        camera.frame().context("--camera")?;
    }
    let files = Files { memory: options.memory, may_replace: options.force };
    let seen = view::run(
        ViewOptions {
            file: options.file,
            memory: options.memory.0,
            gpu_memory: options.gpu_memory.0,
            pixels: options.pixels,
            max_triangles: options.max_triangles,
            size: [options.size.width, options.size.height],
            camera,
            state_folder: LastViews::usual_folder(),
            tell: |problem| eprintln!("vdt: {problem}"),
        },
        Arc::new(files),
    )?;
    if seen.is_building {
        crate::end_at_once();
    }
    if let Some(problem) = seen.unopened {
        return Err(anyhow!(problem));
    }
    report(&seen).print(json, &to_json(&seen))
}

/// What opens files for the window.
struct Files {
    /// For building.
    memory: ByteSize,
    /// Whether a model beside its mesh may be replaced.
    may_replace: bool,
}

impl Opener for Files {
    fn open(&self, path: &Path, tell: &mut (dyn FnMut(Progress) + Send)) -> Result<Opened, String> {
        self.open_or_build(path, tell).map_err(|error| crate::message(&error))
    }
}

impl Files {
    fn open_or_build(&self, path: &Path, tell: &mut (dyn FnMut(Progress) + Send)) -> Result<Opened> {
        if path.is_dir() {
            bail!("{}: this is a directory; name a file in it", path.display());
        }
        if is_model(path)? {
            return Ok(Opened { model: Model::open(&LocalDisk, path)?, notes: Vec::new() });
        }
        let output = path.with_extension("vdt");
        if output == path {
            // It is called a model, and says better itself why it is none.
            return Ok(Opened { model: Model::open(&LocalDisk, path)?, notes: Vec::new() });
        }
        let kept = if LocalDisk.exists(&output) { self.kept(path, &output)? } else { None };
        match kept {
            Some(model) => Ok(Opened { model, notes: Vec::new() }),
            None => self.build(path, &output, tell),
        }
    }

    /// The model that is there already, unless it is to be built again.
    fn kept(&self, mesh: &Path, model: &Path) -> Result<Option<Model>> {
        let (mesh_name, name) = (mesh.display(), model.display());
        let changed = |path: &Path| -> Result<_> {
            std::fs::metadata(path).and_then(|metadata| metadata.modified()).with_context(|| path.display().to_string())
        };
        if changed(model)? < changed(mesh)? {
            if self.may_replace {
                return Ok(None);
            }
            bail!(
                "{name}: this model is older than {mesh_name}; use --force to build it again, or open {name} as it is"
            );
        }
        match Model::open(&LocalDisk, model) {
            Ok(model) => Ok(Some(model)),
            Err(ModelError::NotAModel { .. }) if !self.may_replace => {
                bail!(
                    "{name}: here the model of {mesh_name} would be, but this is none; use --force to replace it, or move it"
                )
            }
            Err(_) if self.may_replace => Ok(None),
            Err(error) => Err(error).context(format!("{name}: use --force to build it again")),
        }
    }

    fn build(&self, mesh: &Path, output: &Path, tell: &mut (dyn FnMut(Progress) + Send)) -> Result<Opened> {
        let disk: Arc<dyn Disk> = Arc::new(LocalDisk);
        // It leaves nothing when it is dropped.
        AtomicFile::create(disk.clone(), output).with_context(|| {
            let (mesh, output) = (mesh.display(), output.display());
            format!(
                "{mesh}: the model cannot be written to {output}; build it elsewhere: vdt build {mesh} -o MODEL.vdt"
            )
        })?;
        let meshes: [PathBuf; 1] = [mesh.into()];
        let options = BuildOptions {
            memory: self.memory,
            threads: available_threads(),
            metric: Metric::Quadric,
            strategy: Strategy::Passes,
            error_bound: ErrorBound::default(),
            edge_tree: EdgeTreeKind::default(),
            positions: PositionsRule::default(),
            attributes: true,
        };
        let folder = scratch_folder(None, output)?;
        let (scratch, resumed) = Scratch::open(disk.clone(), &folder, &fingerprint(&meshes, &options)?)?;
        tell(Progress { phase: "reading".into(), share: 0.0 });
        let mut show = |Step { phase, share, .. }: Step| {
            tell(Progress { phase: doing(phase).into(), share: share_of_all(phase, share) });
        };
        let way = Way { options: &options, blocking: Blocking::default(), scratch: &scratch, progress: &mut show };
        let Built { report, .. } = build_model(disk, &meshes, output, resumed, way)?;
        scratch.release_memory();
        let mut notes = vec![format!("the model is kept: {}", output.display())];
        notes.extend(warnings::texts(&report.cleaning, &report.missing_files));
        Ok(Opened { model: Model::open(&LocalDisk, output)?, notes })
    }
}

fn report(seen: &Summary) -> Report {
    let mut report = Report::default();
    let Some(model) = &seen.model else {
        report.line("model", "none");
        return report;
    };
    report.line("model", model.display());
    report.line(
        "frames",
        format!(
            "{}, {:.1} ms median, {:.1} ms at the 99th percentile",
            counted(seen.frames, "frame", "frames"),
            seen.frame_ms_p50,
            seen.frame_ms_p99
        ),
    );
    let (triangles, all) = (grouped(seen.triangles), grouped(seen.model_triangles));
    let settled = if seen.is_settled { "" } else { ", not finished" };
    report.line("last", format!("{triangles} of {all} triangles, {:.2} pixels of error{settled}", seen.pixels_drawn));
    report.line("disk", format!("{} reads, {}", grouped(seen.reads), ByteSize(seen.bytes_read)));
    let card = if seen.is_processor { " (the processor)" } else { "" };
    report.line("drawn by", format!("{}{card}; {} went there", seen.renderer, ByteSize(seen.uploaded_bytes)));
    for path in seen.paths.iter().chain(&seen.screenshots) {
        report.line("kept", path.display());
    }
    if let Some(peak) = storage::usage::peak_resident_bytes() {
        report.line("peak RAM", format!("{}; {} for the navigation", ByteSize(peak), ByteSize(seen.budget_bytes)));
    }
    report
}

fn to_json(seen: &Summary) -> Value {
    json!({
        "model": seen.model,
        "frames": seen.frames,
        "frame_ms_p50": seen.frame_ms_p50,
        "frame_ms_p99": seen.frame_ms_p99,
        "triangles": seen.triangles,
        "model_triangles": seen.model_triangles,
        "pixels_drawn": seen.pixels_drawn,
        "adapts": seen.adapts,
        "misses": seen.misses,
        "reads": seen.reads,
        "bytes_read": seen.bytes_read,
        "uploaded_bytes": seen.uploaded_bytes,
        "budget_bytes": seen.budget_bytes,
        "gpu_bytes": seen.gpu_bytes,
        "settled": seen.is_settled,
        "first_picture_seconds": seen.first_picture_seconds,
        "renderer": seen.renderer,
        "renderer_is_processor": seen.is_processor,
        "paths": seen.paths,
        "screenshots": seen.screenshots,
        "peak_rss_bytes": storage::usage::peak_resident_bytes(),
    })
}
