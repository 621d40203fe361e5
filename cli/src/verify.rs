//! `vdt verify`: is every byte of a model as it should be, and is it this mesh?

use anyhow::Result;
use metanode::model::Model;
use metanode::verify;
use serde_json::json;
use storage::{ByteSize, LocalDisk};
use vdt::ingest::{self, PositionsRule};
use vdt::tree::Positions;

use crate::against;
use crate::arguments::VerifyOptions;
use crate::output::{Report, counted};
use crate::progress::Progress;

pub fn run(options: VerifyOptions, json: bool) -> Result<()> {
    let progress = Progress::new("verifying");
    let model = Model::open(&LocalDisk, &options.model)?;
    let found = verify(&model, &mut |share| progress.show(share))?;
    if !options.against.is_empty() {
        progress.phase("comparing");
        let rule = PositionsRule::Fixed(model.header().positions);
        let has_attributes = model.appearance().is_some();
        let needs = |counts| against::needs(counts, has_attributes);
        let (mesh, _) = ingest::load(&LocalDisk, &options.against, rule, has_attributes, options.memory, &needs)?;
        against::compare(&model, mesh)?;
    }
    drop(progress);

    let mut report = Report::default();
    report.line("model", options.model.display());
    report.line(
        "sound",
        format!(
            "{}, {}, {} in {}, {}",
            counted(found.triangles.into(), "triangle", "triangles"),
            counted(found.leaves.into(), "vertex", "vertices"),
            counted(found.splits.into(), "split", "splits"),
            counted(found.pages.into(), "meta-node", "meta-nodes"),
            ByteSize(found.bytes),
        ),
    );
    if let Some(mesh) = options.against.first() {
        let lattice = match model.header().positions {
            Positions::Lossless => "",
            Positions::Bits(_) => ", rounded to its lattice",
        };
        let attributes = match model.appearance() {
            Some(found) => format!(", with its {}", found.layout.kinds),
            None => String::new(),
        };
        report
            .line("same", format!("fully refined, it is exactly the mesh of {}{lattice}{attributes}", mesh.display()));
    }
    report.print(
        json,
        &json!({
            "sound": true,
            "vertices": found.leaves,
            "triangles": found.triangles,
            "splits": found.splits,
            "roots": found.roots,
            "meta_nodes": found.pages,
            "bytes": found.bytes,
            "same_as_mesh": (!options.against.is_empty()).then_some(true),
            "attributes_compared": (!options.against.is_empty()).then_some(model.appearance().is_some()),
            "peak_rss_bytes": storage::usage::peak_resident_bytes(),
        }),
    )
}
