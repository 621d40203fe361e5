//! `vdt info`: what is in a model or mesh file.
//!
//! A model's header and tables are read, and what stands in front of the coded fields of each page; `--pages` decodes the
//! pages too. Either way the RAM does not grow with the model, but for the root tables and the largest page.

use std::path::Path;

use anyhow::{Result, bail};
use metanode::header::{ErrorBound, Header, VERSION};
use metanode::model::Model;
use metanode::{FieldBits, ModelDetails, ModelStatistics, details, statistics};
use navigator::plan;
use serde_json::{Map, Value, json};
use storage::{ByteSize, LocalDisk};
use vdt::mesh::{Attributes, ImageSource, Material, MeshError, TriangleSink, read_mesh};
use vdt::tree::{Appearance, AttributeKinds, Image, Material as ModelMaterial, Normal};

use crate::arguments::InfoOptions;
use crate::compare::is_model;
use crate::output::{Report, attribute_names, bound, counted, grouped, input_error, length, positions};
use crate::progress::Progress;

/// The budget whose place holders are told.
const BUDGET: ByteSize = ByteSize(16 << 20);
/// The errors at which the triangles are told, in parts of the diagonal.
const ERRORS: [f64; 3] = [0.0001, 0.001, 0.01];

pub fn run(options: InfoOptions, json: bool) -> Result<()> {
    if is_model(&options.file)? {
        return model_info(&options.file, options.pages, json);
    }
    if options.pages {
        bail!("{}: --pages is for models, and this is none", options.file.display());
    }
    mesh_info(&options.file, json)
}

fn model_info(path: &Path, decodes: bool, json: bool) -> Result<()> {
    let model = Model::open(&LocalDisk, path)?;
    let header = model.header();
    let figures = statistics(&model)?;
    let details = decodes.then(|| {
        let progress = Progress::new("decoding");
        let errors = ERRORS.map(|error| (error * header.diagonal()) as f32);
        details(&model, &errors, &mut |share| progress.show(share))
    });
    let details = details.transpose()?;
    let place_holders = plan(&model, BUDGET.0).ok().map(|budget| budget.slots as u64);

    let mut report = Report::default();
    report.line("model", format!("{}, format version {VERSION}", path.display()));
    mesh_lines(&mut report, header);
    attribute_lines_of_model(&mut report, &model);
    error_lines(&mut report, header, details.as_ref());
    page_lines(&mut report, header, &figures, place_holders);
    size_lines(&mut report, header, &figures, details.as_ref());
    coder_lines(&mut report, &model);
    let (metric, strategy) = (header.metric.to_string(), header.strategy.to_string());
    report.line(
        "built",
        format!(
            "metric {metric}, strategy {strategy}, error bound {}, blocking {}, positions {}",
            header.error_bound, header.blocking, header.positions
        ),
    );
    let mut document = model_json(header, &figures, details.as_ref(), place_holders);
    // Normals there are always.
    let kinds = model.appearance().map_or(AttributeKinds::default(), |found| found.layout.kinds);
    document["attributes"] = attribute_names(AttributeKinds { normals: true, ..kinds }).into();
    document["normals_given"] = model.appearance().is_some_and(|found| found.layout.kinds.normals).into();
    if let Some(found) = model.appearance() {
        let Appearance { materials, images, texture_exponent, .. } = &found.appearance;
        let image = |image: Option<u32>| image.and_then(|image| images.get(image as usize));
        let of_material =
            |material: &ModelMaterial| material_json(&material.name, material.base_colour, image(material.image));
        document["wedges"] = found.wedge_count.into();
        document["has_seams"] = found.layout.has_seams.into();
        document["texture_step"] = 2.0_f64.powi(*texture_exponent).into();
        document["materials"] = materials.iter().map(of_material).collect();
    }
    document["coder_contexts_of_its_own"] = model.own_contexts().into();
    document["denominator"] = model.denominator().into();
    report.print(json, &document)
}

/// The box in the coordinates of the mesh file.
fn corners(header: &Header) -> [[f64; 3]; 2] {
    [header.minimum, header.maximum]
        .map(|corner| std::array::from_fn(|axis| f64::from(corner[axis]) + header.origin[axis]))
}

/// How long the box is along each axis.
fn extents(header: &Header) -> [f64; 3] {
    std::array::from_fn(|axis| f64::from(header.maximum[axis]) - f64::from(header.minimum[axis]))
}

fn mesh_lines(report: &mut Report, header: &Header) {
    report.line(
        "mesh",
        format!(
            "{}, {}, {}",
            counted(header.triangle_count.into(), "triangle", "triangles"),
            counted(header.leaf_count.into(), "vertex", "vertices"),
            counted(header.root_count.into(), "component", "components"),
        ),
    );
    let [minimum, maximum] = corners(header);
    report.line("from", format!("{minimum:?}"));
    report.line("to", format!("{maximum:?}"));
    let [x, y, z] = extents(header).map(length);
    report.line(
        "extents",
        format!("{x} by {y} by {z}, diagonal {}; in units of the mesh file", length(header.diagonal())),
    );
    if header.origin != [0.0; 3] {
        report.line("origin", format!("{:?} is added to every position", header.origin));
    }
    report.line("positions", positions(header.positions, header.lattice_step));
    if header.input_error > 0.0 {
        report.line("input error", input_error(header.input_error, header.positions));
    }
}

fn attribute_lines_of_model(report: &mut Report, model: &Model) {
    let Some(found) = model.appearance() else {
        return report.line("attributes", format!("normals, computed, to {} bits; no others", Normal::WORD_BITS));
    };
    let Appearance { kinds, materials, images, .. } = &found.appearance;
    let normals = if kinds.normals { "" } else { "normals, computed; " };
    report.line("attributes", format!("{normals}of the mesh file: {kinds}"));
    if found.layout.has_seams {
        let more = found.wedge_count - model.header().leaf_count;
        report.line("", format!("along seams {} more", counted(more.into(), "set of them", "sets of them")));
    }
    for (number, material) in materials.iter().take(LISTED_MATERIALS).enumerate() {
        let image = material.image.and_then(|image| images.get(image as usize));
        report.line(
            if number == 0 { "materials" } else { "" },
            material_line(&material.name, material.base_colour, image),
        );
    }
    if materials.len() > LISTED_MATERIALS {
        let more = materials.len() - LISTED_MATERIALS;
        report.line("", format!("and {} more; --json lists all", grouped(more as u64)));
    }
}

fn error_lines(report: &mut Report, header: &Header, details: Option<&ModelDetails>) {
    let kind = match header.error_bound {
        ErrorBound::None => "the metric's estimates, not certified bounds".into(),
        bound => format!("certified bounds, error bound {bound}"),
    };
    let largest = bound(header.largest_switch.into());
    let Some(details) = details else {
        return report.line("errors", format!("up to {largest}: {kind}"));
    };
    report.line("errors", format!("from {} to {largest}: {kind}", length(details.smallest_switch.into())));
    for (share, triangles) in ERRORS.into_iter().zip(&details.triangles) {
        let left = counted(*triangles, "triangle", "triangles");
        report.line("", format!("{left} left at {} % of the diagonal", 100.0 * share));
    }
}

fn page_lines(report: &mut Report, header: &Header, figures: &ModelStatistics, place_holders: Option<u64>) {
    report.line(
        "meta-nodes",
        format!(
            "{} in {}, {:.1} on the way to a leaf, {:.1} % full; {} in the file at most",
            grouped(figures.pages),
            counted(header.page_levels.into(), "level", "levels"),
            figures.pages_per_path,
            100.0 * figures.mean_fill,
            ByteSize(header.largest_page_bytes.into()),
        ),
    );
    let fit = match place_holders {
        Some(count) => format!("{BUDGET} of RAM for a flight have {}", grouped(count)),
        None => format!("{BUDGET} of RAM are too few for a flight"),
    };
    report.line("place holder", format!("{} hold any meta-node; {fit}", ByteSize(header.slot_bytes.into())));
}

fn coder_lines(report: &mut Report, model: &Model) {
    let tables = match model.own_contexts() {
        0 => "the built-in ones".into(),
        own => format!("its own for {}, else the built-in ones", counted(own as u64, "context", "contexts")),
    };
    report.line("coder's tables", tables);
    if model.denominator() > 0.0 {
        report.line("coordinates", format!("most are fractions of {}", model.denominator()));
    }
}

/// The parts of the file, for people and for programs.
fn parts(figures: &ModelStatistics) -> [(&'static str, &'static str, u64); 9] {
    let bytes = &figures.file;
    [
        ("header", "header", bytes.header),
        ("root table", "roots", bytes.roots),
        ("root page and way tables", "ways", bytes.ways),
        ("tables of the coder", "coder_tables", bytes.coder_tables),
        ("appearance", "appearance", bytes.appearance),
        ("images", "images", bytes.images),
        ("heads of meta-nodes", "page_heads", bytes.page_heads),
        ("coded fields", "fields", bytes.fields),
        ("checksums", "checksums", bytes.checksums),
    ]
}

/// The root table and the pages decoded, by what they are for.
fn decoded_json(figures: &ModelStatistics) -> Value {
    let decoded = &figures.decoded;
    json!({
        "roots": decoded.roots,
        "records": decoded.records,
        "entries": decoded.entries,
        "positions": decoded.positions,
        "triangles": decoded.triangles,
        "attributes": decoded.wedges,
        "page_headers": decoded.page_headers,
    })
}

/// The kinds of coded fields, for people and for programs, with their bytes.
fn fields(fields: &FieldBits) -> [(&'static str, &'static str, f64); 7] {
    [
        ("links and sizes", "structure", fields.structure / 8.0),
        ("ids, for switch values", "ids", fields.ids / 8.0),
        ("positions", "positions", fields.positions / 8.0),
        ("triangles", "triangles", fields.triangles / 8.0),
        ("normals", "normals", fields.normals / 8.0),
        ("normal cones", "cones", fields.cones / 8.0),
        ("attributes", "attributes", fields.attributes / 8.0),
    ]
}

fn size_lines(report: &mut Report, header: &Header, figures: &ModelStatistics, details: Option<&ModelDetails>) {
    let per_vertex = |bytes: f64| bytes / f64::from(header.leaf_count.max(1));
    let line = |name: &str, bytes: f64| {
        format!("{:>10}  {:6.3} per vertex  {name}", ByteSize(bytes.round() as u64).to_string(), per_vertex(bytes))
    };
    report.line("size", line("all of the file", header.file_length as f64));
    for (name, _, bytes) in parts(figures).into_iter().filter(|(_, _, bytes)| *bytes > 0) {
        report.line("", line(name, bytes as f64));
    }
    report.line("decoded", line("all of it", figures.decoded.total() as f64));
    if let Some(details) = details {
        let fields = fields(&details.fields).into_iter().filter(|(_, _, bytes)| *bytes > 0.0);
        for (number, (name, _, bytes)) in fields.enumerate() {
            report.line(if number == 0 { "fields" } else { "" }, line(name, bytes));
        }
    }
}

fn model_json(
    header: &Header,
    figures: &ModelStatistics,
    details: Option<&ModelDetails>,
    place_holders: Option<u64>,
) -> Value {
    let [minimum, maximum] = corners(header);
    let parts: Map<String, Value> =
        parts(figures).into_iter().map(|(_, key, bytes)| (key.into(), bytes.into())).collect();
    let mut document = json!({
        "kind": "model",
        "format_version": VERSION,
        "vertices": header.leaf_count,
        "triangles": header.triangle_count,
        "components": header.root_count,
        "roots": header.root_count,
        "splits": header.split_count,
        "minimum": minimum,
        "maximum": maximum,
        "extents": extents(header),
        "diagonal": header.diagonal(),
        "origin": header.origin,
        "metric": header.metric.to_string(),
        "strategy": header.strategy.to_string(),
        "blocking": header.blocking.to_string(),
        "positions": header.positions.to_string(),
        "lattice_step": header.lattice_step,
        "normal_bits": Normal::WORD_BITS,
        "largest_error": header.largest_switch,
        "input_error": header.input_error,
        "error_bound": header.error_bound.to_string(),
        "errors_certified": header.error_bound.is_certified(),
        "meta_nodes": header.page_count,
        "root_meta_nodes": header.root_page_count,
        "meta_node_levels": header.page_levels,
        "meta_node_fill": figures.mean_fill,
        "meta_node_fill_least": figures.least_fill,
        "meta_nodes_per_path": figures.pages_per_path,
        "records_per_meta_node": figures.records_per_page,
        "fill_histogram": figures.fill_histogram,
        "slot_bytes": header.slot_bytes,
        "largest_meta_node_bytes": header.largest_page_bytes,
        "place_holders_in_16m": place_holders,
        "model_bytes": header.file_length,
        "bytes_per_vertex": header.file_length as f64 / f64::from(header.leaf_count.max(1)),
        "bytes_by_part": parts,
        "decoded_bytes_by_part": decoded_json(figures),
    });
    if let Some(details) = details {
        let fields: Map<String, Value> = fields(&details.fields)
            .into_iter()
            .map(|(_, key, bytes)| (key.into(), (bytes.round() as u64).into()))
            .collect();
        let levels = ERRORS.into_iter().zip(&details.triangles);
        let levels: Vec<Value> = levels
            .map(|(share, triangles)| json!({ "error": share * header.diagonal(), "triangles": triangles }))
            .collect();
        document["smallest_error"] = details.smallest_switch.into();
        document["levels_of_detail"] = levels.into();
        document["bytes_by_field"] = fields.into();
    }
    document
}

/// Bounds of the vertices that pass by.
struct Bounds {
    minimum: [f64; 3],
    maximum: [f64; 3],
}

impl TriangleSink for Bounds {
    fn wants_attributes(&self) -> bool {
        true
    }

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

/// Materials that are listed for people; all are in the JSON document.
const LISTED_MATERIALS: usize = 12;

fn mesh_info(path: &Path, json: bool) -> Result<()> {
    let mut bounds = Bounds { minimum: [f64::INFINITY; 3], maximum: [f64::NEG_INFINITY; 3] };
    let summary = read_mesh(&LocalDisk, path, &mut bounds)?;
    let attributes = &summary.attributes;
    let has_box = summary.vertices > 0;
    let diagonal = (0..3).map(|axis| (bounds.maximum[axis] - bounds.minimum[axis]).powi(2)).sum::<f64>().sqrt();
    let mut report = Report::default();
    report.line("mesh", format!("{}: {}", path.display(), summary.format));
    report.line("triangles", counted(summary.triangles, "triangle", "triangles"));
    let polygons = match summary.polygons {
        0 => String::new(),
        count => format!(", {} of more than three corners", grouped(count)),
    };
    report.line("faces", counted(summary.faces, "face", "faces") + &polygons);
    report.line("vertices", counted(summary.vertices, "vertex", "vertices"));
    if has_box {
        report.line("from", format!("{:?}", bounds.minimum));
        report.line("to", format!("{:?}", bounds.maximum));
        report.line("diagonal", length(diagonal));
    }
    let lines = attribute_lines(attributes);
    for (number, line) in lines.iter().enumerate() {
        report.line(if number == 0 { "attributes" } else { "" }, line);
    }
    if lines.is_empty() {
        report.line("attributes", "none");
    }
    for (number, material) in attributes.materials.iter().take(LISTED_MATERIALS).enumerate() {
        let image = material.image.as_ref().map(plain_image);
        report.line(
            if number == 0 { "materials" } else { "" },
            material_line(&material.name, material.base_colour, image.as_ref()),
        );
    }
    if attributes.materials.len() > LISTED_MATERIALS {
        let more = attributes.materials.len() - LISTED_MATERIALS;
        report.line("", format!("and {} more; --json lists all", grouped(more as u64)));
    }
    for missing in &attributes.missing_files {
        report.line("warning", format!("{} is named, and is not there", missing.display()));
    }
    report.print(
        json,
        &json!({
            "kind": "mesh",
            "format": summary.format.to_string(),
            "vertices": summary.vertices,
            "faces": summary.faces,
            "triangles": summary.triangles,
            "polygons": summary.polygons,
            "minimum": has_box.then_some(bounds.minimum),
            "maximum": has_box.then_some(bounds.maximum),
            "diagonal": has_box.then_some(diagonal),
            "attributes": {
                "vertex_normals": attributes.vertex_normals,
                "vertex_colours": attributes.vertex_colours,
                "vertex_texture_coordinates": attributes.vertex_textures,
                "face_colours": attributes.face_colours,
                "face_materials": attributes.face_materials,
                "wedge_normals": attributes.wedge_normals,
                "wedge_texture_coordinates": attributes.wedge_textures,
                "listed_normals": attributes.normals,
                "listed_texture_coordinates": attributes.texture_coordinates,
            },
            "materials": attributes.materials.iter().map(mesh_material_json).collect::<Vec<_>>(),
            "missing_files": attributes.missing_files.iter().map(|path| path.display().to_string()).collect::<Vec<_>>(),
        }),
    )
}

/// Each kind of attribute that is there, for people.
fn attribute_lines(attributes: &Attributes) -> Vec<String> {
    let listed = |count: u64| if count > 0 { format!(", from a list of {}", grouped(count)) } else { String::new() };
    let corners = |count| counted(count, "corner", "corners");
    let vertices = |count| counted(count, "vertex", "vertices");
    let faces = |count| counted(count, "face", "faces");
    [
        (attributes.vertex_normals, format!("normals of {}", vertices(attributes.vertex_normals))),
        (attributes.vertex_colours, format!("colours of {}", vertices(attributes.vertex_colours))),
        (attributes.vertex_textures, format!("texture coordinates of {}", vertices(attributes.vertex_textures))),
        (attributes.face_colours, format!("colours of {}", faces(attributes.face_colours))),
        (attributes.face_materials, format!("materials of {}", faces(attributes.face_materials))),
        (
            attributes.wedge_normals + attributes.normals,
            format!("normals of {} of faces{}", corners(attributes.wedge_normals), listed(attributes.normals)),
        ),
        (
            attributes.wedge_textures + attributes.texture_coordinates,
            format!(
                "texture coordinates of {} of faces{}",
                corners(attributes.wedge_textures),
                listed(attributes.texture_coordinates)
            ),
        ),
    ]
    .into_iter()
    .filter_map(|(count, line)| (count > 0).then_some(line))
    .collect()
}

/// An image as models have them.
fn plain_image(image: &vdt::mesh::Image) -> Image {
    Image { name: image.name.clone(), source: image.source.clone() }
}

fn material_line(name: &str, base_colour: Option<[f32; 4]>, image: Option<&Image>) -> String {
    let name = if name.is_empty() { "(no name)" } else { name };
    let colour = match base_colour {
        Some([red, green, blue, alpha]) => format!(", colour {red} {green} {blue}, alpha {alpha}"),
        None => String::new(),
    };
    let image = match image {
        Some(image) => format!(", image {} ({})", image.name, place_of(&image.source).1),
        None => String::new(),
    };
    format!("{name}{colour}{image}")
}

/// Where an image is: for programs, and for people.
fn place_of(source: &ImageSource) -> (&'static str, String) {
    match source {
        ImageSource::File(_) => ("file", "it is there".into()),
        ImageSource::Part { length, .. } => ("part", format!("inside, {}", ByteSize(*length))),
        ImageSource::Bytes(bytes) => ("part", format!("inside, {}", ByteSize(bytes.len() as u64))),
        ImageSource::Missing => ("missing", "it is not there".into()),
    }
}

fn mesh_material_json(material: &Material) -> Value {
    material_json(&material.name, material.base_colour, material.image.as_ref().map(plain_image).as_ref())
}

fn material_json(name: &str, base_colour: Option<[f32; 4]>, image: Option<&Image>) -> Value {
    json!({
        "name": name,
        "base_colour": base_colour,
        "image": image.map(|image| &image.name),
        "image_found": image.map(|image| image.source != ImageSource::Missing),
        "image_place": image.map(|image| place_of(&image.source).0),
    })
}
