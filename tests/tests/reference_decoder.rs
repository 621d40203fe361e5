//! Every page of a model, decoded by `metanode` from its ancestors alone, is what `docs/format.md` says, bit by bit: it is compared with
//! that of a decoder that was written from the document.
//!
//! `VDT_MODELS=FOLDER cargo test --release -p vdt-tests --test reference_decoder -- --ignored` does the same with all models of a folder.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use metanode::header::{Blocking, ErrorBound, Metric, Positions, Strategy as Order};
use metanode::model::{Model, PageReader};
use metanode::page::{self, ChildEntry, PageLocation, Target};
use metanode::wedges::PlacedWedge;
use metanode::{ModelOptions, WriteResources, write_model};
use proptest::prelude::*;
use storage::{Disk, LocalDisk, MemoryDisk};
use vdt::ingest::{CleaningCounts, canonical};
use vdt::tree::{AttributeKinds, StoredTree, Tree};
use vdt_tests::mesh_files::{Coordinates, Encoding, ply};
use vdt_tests::plain_tree::plain_tree;
use vdt_tests::program::Workplace;
use vdt_tests::random_log::RandomLog;
use vdt_tests::random_mesh::{RawMesh, any_mesh, sheet, soup, sphere, torus};
use vdt_tests::random_wedges::{WedgePlan, with_random_wedges};
use vdt_tests::reference_decoder::{self, Appearance, Entry, Material, Page, Record, Wedge};
use vdt_tests::workplace;

/// A wedge as `metanode` has it, as one of the reference.
fn plain_wedge(placed: PlacedWedge) -> Wedge {
    let PlacedWedge { number, end, wedge: vdt::tree::Wedge { material, texture, colour, normal } } = placed;
    Wedge { number, end, material, texture, colour, normal: normal.to_word() }
}

/// What a model says of its wedges, as the reference has it, but for the density of textures, which the library keeps to itself.
fn appearance(model: &Model, texture_density: i32) -> Option<Appearance> {
    let found = model.appearance()?;
    let AttributeKinds { normals, colours, textures, materials } = found.layout.kinds;
    let image = |number: usize| {
        let mut bytes = Vec::new();
        let mut take = |chunk: &[u8]| -> Result<(), storage::StorageError> {
            bytes.extend(chunk);
            Ok(())
        };
        model.image(number, &mut take).unwrap().then_some(bytes)
    };
    let names = found.appearance.images.iter().map(|image| image.name.clone());
    Some(Appearance {
        kinds: [normals, colours, textures, materials],
        has_seams: found.layout.has_seams,
        texture_exponent: found.appearance.texture_exponent,
        texture_density,
        wedge_count: found.wedge_count,
        root_wedges: (0..found.root_wedges.tree_count())
            .map(|tree| found.root_wedges.of_tree(tree).iter().copied().map(plain_wedge).collect())
            .collect(),
        materials: found
            .appearance
            .materials
            .iter()
            .map(|material| Material {
                name: material.name.clone(),
                base_colour: material.base_colour,
                image: material.image.map_or(0, |image| image + 1),
            })
            .collect(),
        images: names.enumerate().map(|(number, name)| (name, image(number))).collect(),
    })
}

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
        let (wedges, corner_wedges) =
            (page.wedges(index).map(plain_wedge).collect(), page.corner_wedges(index).collect());
        Record { born_leaf, position, normal, children, triangles, wedges, corner_wedges }
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
fn pages_of(model: &Model) -> BTreeMap<u32, Page> {
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
    let mut pages = BTreeMap::new();
    for root in model.root_pages() {
        below(model, &[], *root, &mut pages);
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
    let model = Model::open(&LocalDisk, path).unwrap();
    compare_with(&model, &fs::read(path).unwrap())
}

/// The same for a model and its bytes.
fn compare_with(model: &Model, bytes: &[u8]) -> (usize, usize) {
    let path = model.path();
    let (expected_appearance, expected) = reference_decoder::decode(bytes);
    let density = expected_appearance.as_ref().map_or(0, |appearance| appearance.texture_density);
    assert_eq!(appearance(model, density), expected_appearance, "{}", path.display());
    let found = pages_of(model);
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

/// Decimals, all but some, and sums of such: fractions of a denominator, some floats beside them, and others.
#[test]
fn fractions_of_a_denominator() {
    let mut mesh = sphere(4, 0.2, 3);
    for (number, value) in mesh.positions.iter_mut().flatten().enumerate() {
        let decimal = (*value * 1e4).round() as f32 / 1e6;
        *value = f64::from(match number % 50 {
            0 => decimal + 1e-8,
            1 => decimal + 1.0 - 1.0,
            2 => decimal + 0.1 - 0.1,
            _ => decimal,
        });
    }
    let place = place_with(&mesh);
    for blocking in ["forest:4K,4", "forest:32K,8", "levels:5"] {
        check(&place, &format!("--positions lossless --blocking {blocking}"));
    }
    assert_eq!(place.json("info m.vdt")["lattice_step"], 0.0);
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

/// A tree of a mesh, simplified in random order; `deep` of 8 collapses make it deeper.
fn random_tree(mesh: &RawMesh, deep: usize, seed: u64) -> Tree {
    let core = canonical(mesh.positions.clone(), mesh.triangles.clone(), CleaningCounts::default()).unwrap();
    let log = RandomLog::new(core, deep, seed);
    plain_tree(&log.mesh, &log.collapses, &log.roots)
}

/// Writes a tree as a model, in memory, and compares that. How many pages it has.
fn check_tree(tree: &StoredTree, blocking: Blocking) -> usize {
    let disk = MemoryDisk::new();
    let path = Path::new("model.vdt");
    let options = ModelOptions {
        blocking,
        metric: Metric::Length,
        strategy: Order::Btree,
        error_bound: ErrorBound::None,
        input_error: 0.0,
        positions: Positions::Lossless,
    };
    let shared: Arc<dyn Disk> = Arc::new(disk.clone());
    write_model(shared, path, tree, &options, &WriteResources::in_memory(), &mut |_| ()).unwrap();
    let (different, count) = compare_with(&Model::open(&disk, path).unwrap(), &disk.bytes(path).unwrap());
    assert_eq!(different, 0, "{blocking:?}: of {count} pages");
    count
}

/// Large and small pages, and such as have little more than one split.
const BLOCKINGS: [Blocking; 5] = [
    Blocking::Forest { slot_bytes: 1 << 20, fan_out: 8 },
    Blocking::Forest { slot_bytes: 16 << 10, fan_out: 8 },
    Blocking::Forest { slot_bytes: 4 << 10, fan_out: 3 },
    Blocking::Levels { levels: 1 },
    Blocking::Levels { levels: 5 },
];

/// As deep as can be, so ways to corners take hundreds of steps, and other triangles of a split follow them farther than is kept
/// in mind.
#[test]
fn ways_longer_than_those_behind_them_may_follow() {
    for seed in 0..3 {
        let tree = StoredTree::from_tree(random_tree(&sheet(20, 14, 0.3, 0, seed), 8, seed));
        for blocking in BLOCKINGS {
            check_tree(&tree, blocking);
        }
    }
}

fn kinds(bits: u32) -> AttributeKinds {
    let is = |bit: u32| bits >> bit & 1 == 1;
    AttributeKinds { normals: is(0), colours: is(1), textures: is(2), materials: is(3) }
}

/// All that a model can have, in all combinations, with and without seams.
#[test]
fn attributes_of_every_kind() {
    let mut mesh = sheet(12, 9, 0.3, 3, 1);
    for number in 1..6_u32 {
        mesh.append(&sphere(1, 0.2, number.into()), [f64::from(number) * 20.0, 0.0, 0.0]);
    }
    for bits in 1..16 {
        for seams in [0, 30, 3] {
            let seed = u64::from(bits);
            let tree = random_tree(&mesh, bits as usize % 9, seed);
            let plan = WedgePlan { kinds: kinds(bits), seams, has_fans: seams == 3, is_smooth: bits % 2 == 0, seed };
            let tree = with_random_wedges(&tree, &plan);
            let pages: usize = BLOCKINGS.iter().map(|blocking| check_tree(&tree, *blocking)).sum();
            assert!(pages > 50, "{pages} pages");
        }
    }
}

fn wedge_plans() -> impl Strategy<Value = WedgePlan> {
    let seams = prop::sample::select(vec![0_usize, 1, 2, 5, 40]);
    (1..16_u32, seams, any::<bool>(), any::<bool>(), any::<u64>()).prop_map(
        |(bits, seams, has_fans, is_smooth, seed)| WedgePlan { kinds: kinds(bits), seams, has_fans, is_smooth, seed },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn any_attributes_at_all(
        mesh in any_mesh(), deep in 0..9_usize, plan in wedge_plans(), blocking in prop::sample::select(&BLOCKINGS[..])
    ) {
        let tree = with_random_wedges(&random_tree(&mesh, deep, plan.seed), &plan);
        check_tree(&tree, blocking);
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
