//! Models of released format versions, from `tests/fixtures`: what this version reads it must go on reading, to the same
//! triangles; what it does not read it refuses, and says what to do.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::fs;
use std::path::Path;

use metanode::header::{ModelError, VERSION};
use metanode::model::Model;
use metanode::{CutWedges, UniformCut};
use storage::{LocalDisk, StorageError};
use vdt::tree::ImageSource;
use vdt_tests::mesh_files::read_ply;
use vdt_tests::program::Workplace;
use vdt_tests::random_mesh::RawMesh;
use vdt_tests::workplace;

/// What to do where the fixture cannot be read as it was.
const CHANGED: &str = "the format was changed without a new version: raise VERSION in metanode/src/header.rs; or, as \
                       long as this version is not released, make the fixture anew with tests/fixtures/make.sh";
/// The hash of the triangles of the city in `version-3.vdt`.
const TRIANGLES: u64 = 9_596_253_393_195_556_325;

fn place_with_fixture() -> Workplace {
    let place = workplace!();
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/version-3.vdt");
    place.write("city.vdt", fs::read(fixture).unwrap());
    place
}

/// The hash of the triangles, each from its smallest corner on, sorted.
fn hash(mesh: &RawMesh) -> u64 {
    let bits = |corner: &u32| mesh.positions[*corner as usize].map(f64::to_bits);
    let mut triangles: Vec<_> = mesh
        .triangles
        .iter()
        .map(|corners| {
            let mut corners = [0, 1, 2].map(|corner| bits(&corners[corner]));
            let smallest = (0..3).min_by_key(|corner| corners[*corner]).unwrap();
            corners.rotate_left(smallest);
            corners
        })
        .collect();
    triangles.sort_unstable();
    fnv(triangles.into_iter().flatten().flatten().flat_map(u64::to_le_bytes))
}

/// FNV-1a.
fn fnv(bytes: impl Iterator<Item = u8>) -> u64 {
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
}

#[test]
fn a_model_of_version_3_is_read_as_it_was_written() {
    let place = place_with_fixture();
    assert_eq!(VERSION, 3, "add a fixture of this version, and expect of this one what the new version does with it");
    let verified = place.run("verify city.vdt");
    assert!(verified.status.success(), "{CHANGED}\n{verified:?}");
    let info = place.json("info city.vdt --pages");
    for (key, expected) in
        [("format_version", 3), ("triangles", 900), ("vertices", 657), ("components", 38), ("splits", 619)]
    {
        assert_eq!(info[key], expected, "{key}: {CHANGED}");
    }
    assert_eq!((&info["positions"], &info["blocking"]), (&"12".into(), &"forest:4K,4".into()), "{CHANGED}");
    assert!(info["meta_nodes"].as_u64().unwrap() > 5 && info["meta_node_levels"] == 3, "{info}");
    let extracted = place.run("extract city.vdt -o city.ply --error 0");
    assert!(extracted.status.success(), "{CHANGED}\n{extracted:?}");
    assert_eq!(hash(&read_ply(&place.read("city.ply"))), TRIANGLES, "{CHANGED}");
    // Into a small view, too: pages are decoded by another way there.
    let flown = place.run("navigate city.vdt --path orbit:5 --frame-rate 0 --memory 4M");
    assert!(flown.status.success(), "{CHANGED}\n{flown:?}");
}

/// The hash of the corners of the sheet in `version-3-attributes.vdt`, with all that they carry.
const CORNERS: u64 = 3_865_667_769_715_259_873;

#[test]
fn attributes_of_version_3_are_read_as_they_were_written() {
    let place = workplace!();
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/version-3-attributes.vdt");
    place.write("sheet.vdt", fs::read(&fixture).unwrap());
    let verified = place.run("verify sheet.vdt");
    assert!(verified.status.success(), "{CHANGED}\n{verified:?}");
    let info = place.json("info sheet.vdt --pages");
    for (key, expected) in [("triangles", 512), ("vertices", 289), ("components", 1), ("wedges", 324)] {
        assert_eq!(info[key], expected, "{key}: {CHANGED}");
    }
    assert_eq!(info["attributes"], serde_json::json!(["normals", "colours", "texture_coordinates", "materials"]));
    let model = Model::open(&LocalDisk, &fixture).unwrap();
    let appearance = &model.appearance().unwrap().appearance;
    let materials: Vec<_> = appearance
        .materials
        .iter()
        .map(|material| (material.name.as_str(), material.base_colour, material.image))
        .collect();
    assert_eq!(materials, [("skin", Some([1.0, 0.5, 0.25, 1.0]), Some(0)), ("roof", None, Some(1))]);
    let mut image = Vec::new();
    let is_there = model.image::<StorageError>(0, |chunk| {
        image.extend_from_slice(chunk);
        Ok(())
    });
    assert!(is_there.unwrap() && image.starts_with(b"\x89PNG") && image.len() == 70, "{CHANGED}");
    assert_eq!(appearance.images[1].source, ImageSource::Missing);

    let cut = UniformCut::new(&model, 0.0).unwrap();
    let wedges = CutWedges::of(&cut).unwrap().unwrap();
    let mut vertices: Vec<[u32; 8]> = Vec::new();
    wedges
        .for_each_vertex(|position, wedge| -> Result<(), ModelError> {
            let [x, y, z] = position.map(f32::to_bits);
            let [u, v] = wedge.texture.map(i32::cast_unsigned);
            let colour = u32::from_le_bytes(wedge.colour);
            vertices.push([x, y, z, u, v, colour, wedge.material, wedge.normal.to_word()]);
            Ok(())
        })
        .unwrap();
    let mut triangles = Vec::new();
    wedges
        .for_each_triangle(|corners, _| -> Result<(), ModelError> {
            let mut corners = corners.map(|corner| vertices[corner as usize]);
            let smallest = (0..3).min_by_key(|corner| corners[*corner]).unwrap();
            corners.rotate_left(smallest);
            triangles.push(corners);
            Ok(())
        })
        .unwrap();
    triangles.sort_unstable();
    let bytes = triangles.into_iter().flatten().flatten().flat_map(u32::to_le_bytes);
    assert_eq!(fnv(bytes), CORNERS, "{CHANGED}");
}

/// Each command that reads a model refuses those that this version does not know, with what was found and what to do.
#[test]
fn other_versions_and_unknown_flags_are_refused_with_advice() {
    let place = place_with_fixture();
    let good = place.read("city.vdt");
    let refuse = |bytes: &[u8], says: &[&str]| {
        place.write("other.vdt", bytes);
        for command in ["info", "info --pages", "verify", "extract -o new.ply --error 0", "navigate --path orbit:5"] {
            let (name, options) = command.split_once(' ').unwrap_or((command, ""));
            place.refuses(1, &format!("{name} other.vdt {options}"), &[&["other.vdt"], says].concat());
        }
    };
    for version in [0_u32, 1, 2, VERSION + 1, u32::MAX] {
        let mut bytes = good.clone();
        bytes[8..12].copy_from_slice(&version.to_le_bytes());
        let found = format!("format version {version}, this program reads version {VERSION}");
        refuse(&bytes, &[&found, "build the model again from its mesh, or use the vdt that wrote it"]);
        // Whatever else may be different there: no reader of this version knows its length or checksum.
        bytes.truncate(300);
        bytes[40..200].fill(0xab);
        refuse(&bytes, &[&found]);
    }
    for flags in [2_u32, 0x8000_0000] {
        let mut bytes = good.clone();
        bytes[12..16].copy_from_slice(&flags.to_le_bytes());
        let checksum = crc32fast::hash(&bytes[..252]);
        bytes[252..256].copy_from_slice(&checksum.to_le_bytes());
        refuse(&bytes, &[&format!("flags {flags:#x}"), "use a newer vdt"]);
    }
}
