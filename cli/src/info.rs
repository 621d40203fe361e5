//! `vdt info`: what is in a model or mesh file.

use std::path::Path;

use anyhow::Result;
use metanode::header::{ErrorBound, Header, MAGIC};
use metanode::model::Model;
use metanode::statistics;
use serde_json::json;
use storage::{ByteSize, Disk, LocalDisk};
use vdt::mesh::{MeshError, TriangleSink, read_mesh};

use crate::arguments::InfoOptions;
use crate::output::{Report, counted, grouped, length};

pub fn run(options: InfoOptions, json: bool) -> Result<()> {
    let mut start = [0; MAGIC.len()];
    let count = LocalDisk.open(&options.file)?.read_at(0, &mut start)?;
    if start[..count] == MAGIC { model_info(&options.file, json) } else { mesh_info(&options.file, json) }
}

fn model_info(path: &Path, json: bool) -> Result<()> {
    let model = Model::open(&LocalDisk, path)?;
    let header: &Header = model.header();
    let figures = statistics(&model)?;
    let (metric, strategy) = (header.metric.to_string(), header.strategy.to_string());
    let (error_bound, blocking) = (header.error_bound.to_string(), header.blocking.to_string());
    let corner =
        |values: [f32; 3]| -> [f64; 3] { std::array::from_fn(|axis| f64::from(values[axis]) + header.origin[axis]) };
    let (minimum, maximum) = (corner(header.minimum), corner(header.maximum));

    let mut report = Report::default();
    report.line("model", path.display());
    report.line(
        "mesh",
        format!(
            "{}, {}, {}",
            counted(header.triangle_count.into(), "triangle", "triangles"),
            counted(header.leaf_count.into(), "vertex", "vertices"),
            counted(header.root_count.into(), "component", "components"),
        ),
    );
    report.line("from", format!("{minimum:?}"));
    report.line("to", format!("{maximum:?}"));
    report.line("diagonal", length(header.diagonal()));
    if header.origin != [0.0; 3] {
        report.line("origin", format!("{:?} is added to every position", header.origin));
    }
    report.line("built", format!("metric {metric}, strategy {strategy}, blocking {blocking}, lossless positions"));
    let errors = match header.error_bound {
        ErrorBound::None => "the metric's estimates, not certified bounds".into(),
        _ => format!("certified bounds, error bound {error_bound}"),
    };
    report.line("errors", format!("up to {}: {errors}", length(header.largest_switch.into())));
    report.line(
        "meta-nodes",
        format!(
            "{} in {}, {:.1} on the way to a leaf, {:.0} % full",
            grouped(figures.pages),
            counted(header.page_levels.into(), "level", "levels"),
            figures.pages_per_path,
            100.0 * figures.mean_fill,
        ),
    );
    report.line("place holder", format!("{} hold any of them", ByteSize(header.slot_bytes.into())));
    let bytes = figures.bytes;
    report.line(
        "size",
        format!("{}, {:.1} bytes per vertex", ByteSize(header.file_length), per_vertex(header.file_length, header)),
    );
    for (part, size) in [
        ("tree: roots", bytes.roots),
        ("tree: records", bytes.records),
        ("tree: child entries", bytes.entries),
        ("data: positions", bytes.positions),
        ("data: triangles", bytes.triangles),
        ("directory: page headers", bytes.page_headers),
        ("directory: tables", bytes.tables),
    ] {
        report.line("", format!("{:>10} {part}", ByteSize(size).to_string()));
    }
    report.print(
        json,
        &json!({
            "kind": "model",
            "format_version": metanode::header::VERSION,
            "vertices": header.leaf_count,
            "triangles": header.triangle_count,
            "components": header.root_count,
            "roots": header.root_count,
            "minimum": minimum,
            "maximum": maximum,
            "diagonal": header.diagonal(),
            "origin": header.origin,
            "metric": metric,
            "strategy": strategy,
            "blocking": blocking,
            "positions": "lossless",
            "largest_error": header.largest_switch,
            "error_bound": error_bound,
            "errors_certified": header.error_bound.is_certified(),
            "meta_nodes": header.page_count,
            "root_meta_nodes": header.root_page_count,
            "meta_node_levels": header.page_levels,
            "meta_node_fill": figures.mean_fill,
            "meta_nodes_per_path": figures.pages_per_path,
            "records_per_meta_node": figures.records_per_page,
            "fill_histogram": figures.fill_histogram,
            "slot_bytes": header.slot_bytes,
            "model_bytes": header.file_length,
            "bytes_per_vertex": per_vertex(header.file_length, header),
            "bytes_by_part": {
                "roots": bytes.roots,
                "records": bytes.records,
                "entries": bytes.entries,
                "positions": bytes.positions,
                "triangles": bytes.triangles,
                "page_headers": bytes.page_headers,
                "tables": bytes.tables,
            },
        }),
    )
}

fn per_vertex(bytes: u64, header: &Header) -> f64 {
    bytes as f64 / f64::from(header.leaf_count.max(1))
}

/// Bounds of the vertices that pass by.
struct Bounds {
    minimum: [f64; 3],
    maximum: [f64; 3],
}

impl TriangleSink for Bounds {
    fn vertex(&mut self, position: [f64; 3]) -> Result<(), MeshError> {
        for axis in 0..3 {
            self.minimum[axis] = self.minimum[axis].min(position[axis]);
            self.maximum[axis] = self.maximum[axis].max(position[axis]);
        }
        Ok(())
    }

    fn triangle(&mut self, _: [u64; 3]) -> Result<(), MeshError> {
        Ok(())
    }
}

fn mesh_info(path: &Path, json: bool) -> Result<()> {
    let mut bounds = Bounds { minimum: [f64::INFINITY; 3], maximum: [f64::NEG_INFINITY; 3] };
    let summary = read_mesh(&LocalDisk, path, &mut bounds)?;
    let has_box = summary.vertices > 0;
    let diagonal = (0..3).map(|axis| (bounds.maximum[axis] - bounds.minimum[axis]).powi(2)).sum::<f64>().sqrt();
    let mut report = Report::default();
    report.line("mesh", format!("{}: {}", path.display(), summary.format));
    report.line("triangles", counted(summary.triangles, "triangle", "triangles"));
    report.line("faces", counted(summary.faces, "face", "faces"));
    report.line("vertices", counted(summary.vertices, "vertex", "vertices"));
    if has_box {
        report.line("from", format!("{:?}", bounds.minimum));
        report.line("to", format!("{:?}", bounds.maximum));
        report.line("diagonal", length(diagonal));
    }
    report.print(
        json,
        &json!({
            "kind": "mesh",
            "format": summary.format.to_string(),
            "vertices": summary.vertices,
            "faces": summary.faces,
            "triangles": summary.triangles,
            "minimum": has_box.then_some(bounds.minimum),
            "maximum": has_box.then_some(bounds.maximum),
            "diagonal": has_box.then_some(diagonal),
        }),
    )
}
