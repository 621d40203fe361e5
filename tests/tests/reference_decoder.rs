//! Every page of a model, decoded by `metanode` from its ancestors alone, is what `docs/format.md` says, bit by bit: it is compared with
//! that of a decoder that was written from the document.
//!
//! `VDT_MODELS=FOLDER cargo test --release -p vdt-tests --test reference_decoder -- --ignored` does the same with all models of a folder.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use metanode::model::{Model, PageReader};
use metanode::page::{self, ChildEntry, PageLocation, Target};
use proptest::prelude::*;
use storage::LocalDisk;
use vdt_tests::mesh_files::{Coordinates, Encoding, ply};
use vdt_tests::program::Workplace;
use vdt_tests::random_mesh::{RawMesh, any_mesh, sheet, soup, sphere, torus};
use vdt_tests::reference_decoder::{self, Entry, Page, Record};
use vdt_tests::workplace;

/// A page as `metanode` has it, as one of the reference.
fn plain(page: &page::Page) -> Page {
    let entry = |entry: ChildEntry| {
        let (child_page, record) = match entry.target {
            Target::SamePage { record } => (None, record),
            Target::ChildPage { child, record } => (Some(child.into()), record),
        };
        let cone = (entry.cone.axis, entry.cone.sine);
        Entry { id: entry.id, switch: entry.switch, radius: entry.radius, cone, child_page, record: record.into() }
    };
    let record = |index: u16| {
        let found = page.record(index).unwrap();
        let children = [found.kept, found.born].map(|child| child.map(entry));
        let triangles = page.triangles(index).collect();
        let (born_leaf, position, normal) = (found.born_leaf, found.position, found.normal.to_word());
        Record { born_leaf, position, normal, children, triangles }
    };
    Page {
        number: page.number(),
        parent: page.parent(),
        children: page.children().map(|child| (child.number, child.offset, child.length)).collect(),
        root_count: page.root_count(),
        leaves: page.leaf_interval(),
        records: (0..page.counts().records as u16).map(record).collect(),
    }
}

/// Each page of a model, decoded with nothing but its ancestors at hand: every one has a reader of its own.
fn pages_of(path: &Path) -> BTreeMap<u32, Page> {
    fn below(model: &Model, ancestors: &[page::Page], location: PageLocation, pages: &mut BTreeMap<u32, Page>) {
        let mut found = model.empty_page();
        let above: Vec<&page::Page> = ancestors.iter().collect();
        model.read_page(location, &above, &mut PageReader::default(), &mut found).unwrap();
        assert!(pages.insert(location.number, plain(&found)).is_none());
        let children: Vec<PageLocation> = found.children().collect();
        let mut chain = ancestors.to_vec();
        chain.push(found);
        for child in children {
            below(model, &chain, child, pages);
        }
    }
    let model = Model::open(&LocalDisk, path).unwrap();
    let mut pages = BTreeMap::new();
    for root in model.root_pages() {
        below(&model, &[], *root, &mut pages);
    }
    assert_eq!(pages.len(), model.header().page_count as usize);
    pages
}

/// The bits of a page's floats: -0.0 is not 0.0.
fn bits(page: &Page) -> Vec<u32> {
    let entries = page.records.iter().flat_map(|record| record.children.iter().flatten());
    let of_entries = entries.flat_map(|entry| [entry.switch, entry.radius]);
    page.records.iter().flat_map(|record| record.position).chain(of_entries).map(f32::to_bits).collect()
}

/// How many pages differ, and how many there are; the first difference is told.
fn compare(path: &Path) -> (usize, usize) {
    let expected = reference_decoder::decode(&fs::read(path).unwrap());
    let found = pages_of(path);
    assert!(found.keys().eq(expected.keys()), "{}: not the same pages", path.display());
    let mut different = 0;
    for (number, page) in &found {
        let other = &expected[number];
        if page != other || bits(page) != bits(other) {
            different += 1;
            let record = page.records.iter().zip(&other.records).position(|(a, b)| a != b);
            let records = record.map(|record| (&page.records[record], &other.records[record]));
            eprintln!("{}: page {number}, record {record:?}: {records:#?}", path.display());
        }
    }
    (different, found.len())
}

/// Builds a model of `mesh.ply` with these options, and compares it. How many pages it has.
fn check(place: &Workplace, options: &str) -> usize {
    place.json(&format!("build mesh.ply -o m.vdt --force {options}"));
    let (different, count) = compare(&place.path("m.vdt"));
    assert_eq!(different, 0, "build mesh.ply {options}: of {count} pages");
    count
}

fn place_with(mesh: &RawMesh) -> Workplace {
    let place = workplace!();
    place.write("mesh.ply", ply(mesh, Encoding::LittleEndian, Coordinates::Double));
    place
}

/// Every way to keep positions, small pages: many of them have ancestors, and are roots of others.
const OPTIONS: [&str; 4] = [
    "--positions lossless --blocking forest:4K,4",
    "--positions 12 --blocking forest:4K,4",
    "--positions 16 --blocking levels:5",
    "--positions 24 --blocking forest:32K,32",
];

#[test]
fn meshes_of_the_programs_own_making() {
    let place = workplace!();
    for shape in ["sphere", "terrain", "gyroid", "city"] {
        place.json(&format!("generate {shape} --triangles 6000 -o mesh.ply --force"));
        let pages: usize = OPTIONS.into_iter().map(|options| check(&place, options)).sum();
        assert!(pages > 200, "{shape}: {pages} pages");
    }
}

/// Terrain in whole metres over a grid of thirty: a lattice of its own, and frequent numbers.
#[test]
fn a_lattice_of_its_own() {
    let mut mesh = sheet(60, 50, 0.3, 4, 5);
    for position in &mut mesh.positions {
        *position = [position[0] * 30.0, position[1] * 30.0, (position[2] * 200.0).round() + 1000.0];
    }
    let place = place_with(&mesh);
    for blocking in ["forest:4K,4", "forest:32K,8", "levels:5"] {
        check(&place, &format!("--positions lossless --blocking {blocking}"));
    }
    let info = place.json("info m.vdt");
    assert_eq!((&info["positions"], info["lattice_step"].as_f64() > Some(0.0)), (&"lossless".into(), true), "{info}");
}

/// Closed and open parts, some of them inside out, more of them than begin in the root page.
#[test]
fn many_components() {
    let mut mesh = RawMesh::default();
    for number in 0..150_u32 {
        let seed = number.into();
        let mut part = match number % 3 {
            0 => sphere(number % 2 + 1, 0.1, seed),
            1 => torus(5, 4, 0.1, seed),
            _ => sheet(4, 3, 0.2, 1, seed),
        };
        if number % 2 == 0 {
            part.triangles.iter_mut().for_each(|triangle| triangle.reverse());
        }
        mesh.append(&part, [f64::from(number % 12) * 4.0, f64::from(number / 12) * 4.0, 0.1]);
    }
    let place = place_with(&mesh);
    for options in OPTIONS {
        check(&place, options);
    }
}

/// No surface at all: triangles anywhere, so ways lead far off, and numbers are of any size.
#[test]
fn soups_and_sizes_at_the_ends_of_single_precision() {
    let place = place_with(&soup(700, 3000, 40, 3));
    for options in OPTIONS {
        check(&place, options);
    }
    for scale in [1e-37, 1e-30, 1e19, 1e38] {
        let mut mesh = soup(300, 900, 30, 4);
        mesh.append(&sphere(3, 0.2, 6), [40.0, 0.0, 0.0]);
        mesh.positions.iter_mut().flatten().for_each(|value| *value *= scale / 40.0);
        check(&place_with(&mesh), "--positions lossless --blocking forest:4K,4");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn any_mesh_at_all(mesh in any_mesh(), options in prop::sample::select(&OPTIONS[..])) {
        let place = place_with(&mesh);
        if place.run(&format!("build mesh.ply -o m.vdt {options}")).status.success() {
            prop_assert_eq!(compare(&place.path("m.vdt")).0, 0);
        }
    }
}

/// Not in the suite, since it wants models: those in the folder that `VDT_MODELS` names.
#[test]
#[ignore = "needs a folder of models in VDT_MODELS"]
fn all_models_of_a_folder() {
    let folder = std::env::var_os("VDT_MODELS").expect("VDT_MODELS names a folder");
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "vdt"));
    paths.sort();
    assert!(!paths.is_empty(), "no model there");
    let (mut different, mut pages) = (0, 0);
    for path in paths {
        let (of_it, count) = compare(&path);
        eprintln!("{}: {of_it} of {count} pages differ", path.display());
        (different, pages) = (different + of_it, pages + count);
    }
    eprintln!("{different} of {pages} pages differ");
    assert_eq!(different, 0);
}
