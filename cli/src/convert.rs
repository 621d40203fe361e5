//! `vdt convert`: a mesh in another format, or a level of detail of it.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use metanode::header::{Blocking, ErrorBound, Metric, Strategy};
use metanode::model::Model;
use serde_json::{Value, json};
use storage::{Disk, EdgeTreeKind, LocalDisk, Scratch};
use vdt::build::BuildOptions;
use vdt::ingest::{self, IngestPlan, Output, PositionsRule};

use crate::arguments::ConvertOptions;
use crate::build::{BuildProgress, Built, Way, available_threads, build_model, fingerprint, scratch_folder};
use crate::compare::refuse_a_model;
use crate::extract::{self, Target, format_of};
use crate::output::{Report, bound, counted, may_write};
use crate::progress::Progress;
use crate::warnings;

/// What the reading of the mesh takes of all the work, without a level of detail.
const READING_SHARE: f64 = 0.7;

pub fn run(options: &ConvertOptions, json: bool) -> Result<()> {
    let inputs: Vec<&Path> = options.meshes.iter().map(AsRef::as_ref).collect();
    let target = Target {
        path: &options.output,
        format: format_of(&options.output)?,
        may_replace: options.force,
        command: "convert",
    };
    may_write(&LocalDisk, target.path, options.force, &inputs)?;
    inputs.into_iter().try_for_each(refuse_a_model)?;
    let (report, document) = match (options.error, options.triangles) {
        (None, None) => whole(options, target)?,
        _ => level_of_detail(options, target)?,
    };
    report.print(json, &document)
}

fn threads(options: &ConvertOptions) -> usize {
    options.threads.map_or_else(available_threads, usize::from)
}

/// Writes all of the mesh.
fn whole(options: &ConvertOptions, target: Target<'_>) -> Result<(Report, Value)> {
    let disk: Arc<dyn Disk> = Arc::new(LocalDisk);
    let folder = scratch_folder(options.scratch.as_deref(), target.path)?;
    let (scratch, _) = Scratch::open(disk.clone(), &folder, "")?;
    let progress = Progress::new("converting");
    let plan = IngestPlan {
        memory: options.memory,
        threads: threads(options),
        block_triangles: u64::MAX,
        positions: PositionsRule::LOSSLESS,
        attributes: !options.no_attributes,
    };
    let mut show = |share| progress.show(READING_SHARE * share);
    let mesh = ingest::store(disk.as_ref(), &scratch, &options.meshes, &plan, &mut show)?;
    scratch.release_memory();
    let output = Output {
        path: target.path,
        format: target.format,
        may_replace: target.may_replace,
        comment: "vdt convert: all of the mesh",
    };
    // The mesh itself holds at most half of the memory.
    let ram = usize::try_from(options.memory.0 / 4).unwrap_or(usize::MAX);
    let mut show = |share| progress.show(READING_SHARE + (1.0 - READING_SHARE) * share);
    let (files, vertices) = ingest::write_mesh(&disk, &mesh, output, ram, &mut show)?;
    drop(progress);

    let triangles = mesh.triangles.len();
    let mut report = Report::default();
    report.line("mesh", target.path.display());
    report.line("triangles", counted(triangles, "triangle", "triangles"));
    report.line("vertices", counted(vertices, "vertex", "vertices"));
    warnings::tell(&mut report, &mesh.cleaning, &mesh.missing_files);
    report.line(
        "error",
        match mesh.input_error {
            0.0 => "none: this is the mesh itself".to_string(),
            error => {
                let error = bound(error.into());
                format!(
                    "guaranteed: every point of the input lies within {error} of this surface: single precision, and \
                         triangles without area that were left out"
                )
            }
        },
    );
    extract::tell_files(&mut report, &files);
    let document = json!({
        "triangles": triangles,
        "vertices": vertices,
        "bytes": files.bytes,
        "beside": files.beside,
        "left_out": files.left_out,
        "error_stated": mesh.input_error,
        "guaranteed": true,
        "input_error": mesh.input_error,
        "warnings": warnings::to_json(&mesh.cleaning, &mesh.missing_files),
        "peak_rss_bytes": storage::usage::peak_resident_bytes(),
    });
    Ok((report, document))
}

/// Builds a model, takes the level of detail out of it, and removes it.
fn level_of_detail(options: &ConvertOptions, target: Target<'_>) -> Result<(Report, Value)> {
    let disk: Arc<dyn Disk> = Arc::new(LocalDisk);
    let build_options = BuildOptions {
        memory: options.memory,
        threads: threads(options),
        metric: Metric::Quadric,
        strategy: Strategy::Passes,
        error_bound: ErrorBound::default(),
        edge_tree: EdgeTreeKind::default(),
        positions: PositionsRule::LOSSLESS,
        attributes: !options.no_attributes,
    };
    let folder = scratch_folder(options.scratch.as_deref(), target.path)?;
    let fingerprint = fingerprint(&options.meshes, &build_options)?;
    let (scratch, resumed) = Scratch::open(disk.clone(), &folder, &fingerprint)?;
    let place = scratch.foreign_folder("model")?;
    let path = place.path().join("model.vdt");
    let progress = BuildProgress::new();
    let mut show = |step| progress.show(step);
    let way = Way { options: &build_options, blocking: Blocking::default(), scratch: &scratch, progress: &mut show };
    let Built { report: built, .. } = build_model(disk, &options.meshes, &path, resumed, way)?;
    drop(progress);
    scratch.release_memory();
    let model = Model::open(&LocalDisk, &path)?;
    let progress = Progress::new("extracting");
    let error = extract::level(&model, options.error, options.triangles)?;
    let extracted = extract::uniform(&model, target, error.context("say which level of detail")?)?;
    drop(progress);
    let (mut report, mut document) = extracted.told(target.path, model.header());
    warnings::tell(&mut report, &built.cleaning, &built.missing_files);
    document["warnings"] = json!(warnings::to_json(&built.cleaning, &built.missing_files));
    Ok((report, document))
}
