//! Small and strange meshes that are valid: each is built, described, checked against its file, flown around in both
//! modes of reading, and extracted in every way; and fully refined it comes back.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use serde_json::Value;
use vdt_tests::mesh_files::{Coordinates, Encoding, ply, read_ply, surface};
use vdt_tests::program::Workplace;
use vdt_tests::random_mesh::{RawMesh, closed_box, sheet, soup, sphere, torus};
use vdt_tests::workplace;

/// What each command's document has at least: section 8 of the design.
const BUILD_KEYS: [&str; 15] = [
    "vertices",
    "triangles",
    "components",
    "warnings",
    "seconds",
    "cpu_seconds",
    "peak_rss_bytes",
    "bytes_read",
    "bytes_written",
    "passes",
    "collapses",
    "roots",
    "meta_nodes",
    "model_bytes",
    "model_sha256",
];
const EXTRACT_KEYS: [&str; 8] = [
    "triangles",
    "vertices",
    "error_stated",
    "guaranteed",
    "error_drawn",
    "vanished_parts",
    "vanished_diameter",
    "input_error",
];
const NAVIGATE_KEYS: [&str; 18] = [
    "frames",
    "triangles_mean",
    "adapts_mean",
    "miss_percent",
    "frame_ms_mean",
    "frame_ms_p50",
    "frame_ms_p99",
    "cpu_ms_mean",
    "error_stated",
    "guaranteed",
    "vanished_parts_max",
    "input_error",
    "reads",
    "bytes_read",
    "second_chances",
    "urgent",
    "peak_rss_bytes",
    "budget_bytes",
];

fn assert_has(document: &Value, keys: &[&str]) {
    for key in keys {
        assert!(document.get(key).is_some(), "no {key} in {document}");
    }
}

/// Numbers that are neither negative nor, as JSON has it where they are not finite, null.
fn assert_numbers(document: &Value, keys: &[&str]) {
    for key in keys {
        let is_number = document[key].as_f64().is_some_and(|number| number >= 0.0);
        assert!(is_number || document[key].is_boolean(), "{key} is {} in {document}", document[key]);
    }
}

/// The whole way with `mesh.ply`, which is this mesh, of so many components.
fn the_whole_way(place: &Workplace, mesh: &RawMesh, components: usize) {
    let expected = surface(mesh);
    let built = place.json("build --positions lossless mesh.ply -o model.vdt --force");
    assert_has(&built, &BUILD_KEYS);
    assert_eq!((&built["triangles"], &built["roots"]), (&expected.len().into(), &components.into()));
    assert_eq!(built["components"], built["roots"]);
    assert_eq!(built["collapses"].as_u64(), Some(built["vertices"].as_u64().unwrap() - components as u64));
    let info = place.json("info model.vdt");
    for key in ["triangles", "vertices", "components", "meta_nodes", "model_bytes"] {
        assert_eq!(info[key], built[key], "{key}");
    }
    assert_eq!(place.json("info mesh.ply")["triangles"], mesh.triangles.len());
    let verified = place.json("verify model.vdt --against mesh.ply");
    assert_eq!((&verified["sound"], &verified["same_as_mesh"]), (&true.into(), &true.into()));

    for flight in [
        "--path orbit:20 --frame-rate 2000",
        "--path orbit:20 --io sync",
        "--path flyby:20 --frame-rate 2000 --memory 1G",
        "--path flyby:20 --io sync --pixels 0.01 --dependency none",
        "--path flyby:20 --io sync --pixels 0.01 --no-prefetch",
    ] {
        let flown = place.json(&format!("navigate model.vdt {flight}"));
        assert_has(&flown, &NAVIGATE_KEYS);
        assert_numbers(&flown, &NAVIGATE_KEYS);
        assert_eq!(flown["frames"], 20, "{flight}");
        assert!(flown["triangles_mean"].as_f64().unwrap() <= expected.len() as f64, "{flight}: {flown}");
        let sync = flight.contains("sync");
        assert!(!sync || flown["miss_percent"] == 0.0, "{flight}: {flown}");
    }

    let extract = |cut: &str| {
        let extracted = place.json(&format!("extract model.vdt -o cut.ply --force {cut}"));
        assert_has(&extracted, &EXTRACT_KEYS);
        assert_numbers(&extracted, &EXTRACT_KEYS);
        let cut = read_ply(&place.read("cut.ply"));
        assert_eq!(extracted["triangles"], cut.triangles.len());
        assert_eq!(extracted["vertices"], cut.positions.len());
        let has_three_corners = |corners: &[u32; 3]| {
            let [a, b, c] = corners;
            a != b && b != c && c != a
        };
        assert!(cut.triangles.iter().all(has_three_corners));
        (cut, extracted)
    };
    let (whole, said) = extract("--error 0");
    assert!(surface(&whole) == expected && whole.triangles.len() == expected.len());
    assert_eq!((&said["guaranteed"], &said["error_stated"]), (&true.into(), &built["input_error"]));
    let (coarse, _) = extract("--error 1%");
    assert!(coarse.triangles.len() <= expected.len());
    // The last part vanishes at the largest switch value, which the reader of the document may have rounded.
    let (nothing, _) = extract(&format!("--error {}", info["largest_error"].as_f64().unwrap() * 1.000_001));
    assert!(nothing.triangles.is_empty());
    for limit in [0, 1, 10, expected.len() / 2, expected.len(), 1_000_000] {
        let (limited, said) = extract(&format!("--triangles {limit}"));
        assert!(limited.triangles.len() <= limit, "--triangles {limit}: {said}");
        assert!(limit < expected.len() || surface(&limited) == expected, "--triangles {limit}: {said}");
    }
    let number = |value: &Value| value.as_f64().unwrap();
    let middle: Vec<f64> =
        (0..3).map(|axis| (number(&info["minimum"][axis]) + number(&info["maximum"][axis])) / 2.0).collect();
    let (x, y, z, far) = (middle[0], middle[1], middle[2], number(&info["diagonal"]).max(1e-37));
    let (seen, _) = extract(&format!("--camera {},{y},{},{x},{y},{z} --pixels 0.5", x + far, z + far));
    assert!(seen.triangles.len() <= expected.len());
    // With next to no error allowed, everything is there.
    let (all, said) = extract(&format!("--camera {},{y},{},{x},{y},{z} --pixels 1e-30", x + far, z + far));
    assert!(surface(&all) == expected, "{} of {} triangles: {said}", all.triangles.len(), expected.len());
}

/// Writes the mesh as `mesh.ply`, in numbers that keep it, and goes the whole way.
fn go(mesh: &RawMesh, components: usize) -> Workplace {
    let place = workplace!();
    place.write("mesh.ply", ply(mesh, Encoding::LittleEndian, Coordinates::Float));
    the_whole_way(&place, mesh, components);
    place
}

fn of(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> RawMesh {
    RawMesh { positions: positions.to_vec(), triangles: triangles.to_vec() }
}

const CORNERS: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn warnings(place: &Workplace) -> Vec<(String, u64)> {
    let built = place.json("build --positions lossless mesh.ply -o model.vdt --force");
    let warnings = built["warnings"].as_array().unwrap();
    let pair = |warning: &Value| (warning["kind"].as_str().unwrap().to_owned(), warning["count"].as_u64().unwrap());
    warnings.iter().map(pair).collect()
}

#[test]
fn nothing_at_all() {
    let place = go(&of(&[], &[]), 0);
    assert!(warnings(&place).is_empty());
}

#[test]
fn vertices_without_faces() {
    let place = go(&of(&CORNERS, &[]), 0);
    assert_eq!(warnings(&place), [("isolated_vertices".to_owned(), 4)]);
}

#[test]
fn one_triangle() {
    go(&of(&CORNERS, &[[0, 1, 2]]), 1);
}

#[test]
fn two_triangles() {
    go(&of(&CORNERS, &[[0, 1, 2], [0, 3, 1]]), 1);
    // With one vertex in common, and with none.
    let mut apart = of(&CORNERS, &[[0, 1, 2]]);
    apart.positions.extend([[3.0, 0.0, 0.0], [4.0, 0.0, 0.0], [3.0, 1.0, 0.0]]);
    apart.triangles.push([2, 4, 5]);
    go(&apart, 1);
    apart.triangles[1] = [3, 4, 5];
    go(&apart, 2);
}

#[test]
fn one_closed_tetrahedron() {
    let place = go(&of(&CORNERS, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]), 1);
    // Tables of its own would be larger than all the rest.
    let info = place.json("info model.vdt");
    assert_eq!(info["coder_contexts_of_its_own"], 0);
    assert!(info["model_bytes"].as_u64() < Some(420), "{info}");
    assert!(place.run("info model.vdt").success().contains("the built-in ones"));
}

#[test]
fn five_hundred_closed_boxes() {
    let mut boxes = RawMesh::default();
    for number in 0..500_u32 {
        boxes.append(&closed_box(), [number % 10, number / 10 % 10, number / 100].map(|place| f64::from(place) * 2.5));
    }
    go(&boxes, 500);
}

#[test]
fn nothing_but_degenerate_triangles() {
    let place = go(&of(&CORNERS, &[[0, 0, 1], [1, 1, 1], [2, 3, 2]]), 0);
    assert_eq!(warnings(&place), [("isolated_vertices".to_owned(), 4), ("degenerate_triangles".to_owned(), 3)]);
    // Corners of different numbers, but at one place.
    let one_place = of(&[[1.0, 2.0, 3.0]; 3], &[[0, 1, 2]]);
    go(&one_place, 0);
    // Three corners in a line are a triangle without area, but not without corners.
    go(&of(&[[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], &[[0, 1, 2]]), 1);
}

#[test]
fn triangles_that_are_there_twice() {
    let place = go(&of(&CORNERS, &[[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 1, 3]]), 1);
    assert_eq!(warnings(&place), [("duplicate_triangles".to_owned(), 2)]);
    // There and back again is two triangles.
    let place = go(&of(&CORNERS, &[[0, 1, 2], [2, 1, 0]]), 1);
    assert_eq!(warnings(&place), [("isolated_vertices".to_owned(), 1)]);
}

#[test]
fn as_small_and_as_large_as_single_precision_goes() {
    for scale in [1e-30, 1e-37, 1e30, 1e37] {
        for shape in [sheet(8, 6, 0.4, 0, 3), sphere(2, 0.1, 4), closed_box()] {
            let mut mesh = shape;
            mesh.positions.iter_mut().flatten().for_each(|value| *value *= scale);
            go(&mesh.in_single_precision(), 1);
        }
    }
}

/// The same, 2^100 times as large or as small: a camera sees the same triangles.
#[test]
fn what_is_seen_does_not_depend_on_the_unit() {
    let seen = |exponent: i32| {
        let place = workplace!();
        let scale = 2.0_f64.powi(exponent);
        let mut mesh = sphere(4, 0.05, 9).in_single_precision();
        mesh.positions.iter_mut().flatten().for_each(|value| *value *= scale);
        place.write("mesh.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Float));
        place.json("build --positions lossless mesh.ply -o model.vdt");
        let camera = [3.0, 1.0, 2.0, 0.0, 0.0, 0.0].map(|value| (value * scale).to_string()).join(",");
        let extracted = place.json(&format!("extract model.vdt -o seen.ply --camera {camera} --pixels 8"));
        let flown = place.json("navigate model.vdt --path orbit:30 --io sync --pixels 4");
        (extracted["triangles"].clone(), flown["triangles_mean"].clone())
    };
    let expected = seen(0);
    assert!((100..1500).contains(&expected.0.as_u64().unwrap()), "{expected:?}");
    for exponent in [-100, -60, 60, 100] {
        assert_eq!(seen(exponent), expected, "2^{exponent}");
    }
}

/// A survey of a kilometre, to the millimetre, in coordinates of 5,000 km: doubles come back, nearly to the bit.
#[test]
fn millimetres_five_thousand_kilometres_away() {
    let place = workplace!();
    let mut mesh = sheet(20, 20, 3.0, 4, 8);
    for [x, y, z] in &mut mesh.positions {
        (*x, *y, *z) = (*x * 50.001 + 500_000.123, *y * 50.002 + 5_000_000.456, *z + 812.789);
    }
    place.write("mesh.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Double));
    place.json("build --positions lossless mesh.ply -o model.vdt");
    assert_eq!(place.json("verify model.vdt --against mesh.ply")["same_as_mesh"], true);
    place.json("extract model.vdt -o back.ply --error 0");
    assert!(String::from_utf8_lossy(&place.read("back.ply")[..200]).contains("property double x"));
    let back = read_ply(&place.read("back.ply"));
    assert_eq!((back.positions.len(), back.triangles.len()), (mesh.positions.len(), mesh.triangles.len()));
    // Each position is near one of the input's, and each triangle is one over those.
    let nearest = |place: &[f64; 3]| {
        let off = |other: &[f64; 3]| (0..3).map(|axis| (place[axis] - other[axis]).abs()).fold(0.0, f64::max);
        let nearest = mesh.positions.iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap();
        assert!(off(nearest) < 1e-4, "{place:?} is {} away from {nearest:?}", off(nearest));
        *nearest
    };
    let moved = RawMesh { positions: back.positions.iter().map(nearest).collect(), triangles: back.triangles.clone() };
    assert!(surface(&moved) == surface(&mesh));

    for flight in ["--path orbit:20 --io sync", "--path flyby:20 --frame-rate 2000"] {
        let flown = place.json(&format!("navigate model.vdt {flight} --pixels 0.1"));
        assert!(flown["triangles_mean"].as_f64().unwrap() > 100.0, "{flown}");
    }
    let camera = "500500,5000500,2000,500500,5000501,800";
    let seen = place.json(&format!("extract model.vdt -o seen.ply --camera {camera} --pixels 0.1"));
    assert!(seen["triangles"].as_u64().unwrap() > 100, "{seen}");
    for position in read_ply(&place.read("seen.ply")).positions {
        nearest(&position);
    }
    // What came back makes the same model, but for what was lost on the first way in: the origin is a matter of the mesh,
    // not of the file.
    let again = place.json("build --positions lossless back.ply -o again.vdt");
    let lost = place.json("build --positions lossless mesh.ply -o model.vdt --force")["input_error"].as_f64().unwrap();
    assert!(lost > 0.0 && lost < 1e-4 && again["input_error"] == 0.0, "{lost} {again}");
    let but_for_the_input_error = |bytes: Vec<u8>| [&bytes[..156], &bytes[160..252], &bytes[256..]].concat();
    let [first, second] = ["model.vdt", "again.vdt"].map(|model| but_for_the_input_error(place.read(model)));
    assert!(first == second);
}

#[test]
fn edges_of_many_triangles() {
    // Five leaves of a book, and two cones that meet at their tips.
    let mut mesh = of(&[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]], &[]);
    for leaf in 0..5_u32 {
        let (y, x) = (f64::from(leaf) * 1.2).sin_cos();
        mesh.positions.push([x, y, 0.5]);
        mesh.triangles.push([0, 1, leaf + 2]);
    }
    go(&mesh.in_single_precision(), 1);
    let mut cones = of(&[[0.0; 3]], &[]);
    for (side, height) in [-1.0, 1.0].into_iter().enumerate() {
        let first = 1 + 8 * side as u32;
        for step in 0..8_u32 {
            let (y, x) = (f64::from(step) * 0.78).sin_cos();
            cones.positions.push([x, y, height]);
            cones.triangles.push([0, first + step, first + (step + 1) % 8]);
        }
    }
    go(&cones.in_single_precision(), 1);
    go(&soup(60, 400, 4, 11), 1);
}

/// A fan: every level of detail has a vertex with very many triangles.
#[test]
fn one_vertex_with_five_thousand_triangles() {
    const TRIANGLES: u32 = 5000;
    let mut fan = of(&[[0.0, 0.0, 0.5]], &[]);
    for step in 0..TRIANGLES {
        let (y, x) = (f64::from(step) / f64::from(TRIANGLES) * std::f64::consts::TAU).sin_cos();
        fan.positions.push([x * 10.0, y * 10.0, 0.1 * f64::from(step * 7919 % 13)]);
        fan.triangles.push([0, 1 + step, 1 + (step + 1) % TRIANGLES]);
    }
    let fan = fan.in_single_precision();
    let place = go(&fan, 1);
    place.write("mesh.ply", ply(&fan, Encoding::LittleEndian, Coordinates::Float));
    let built = place.json("build --positions lossless mesh.ply -o model.vdt --force --blocking levels:5");
    assert_eq!(built["triangles"], TRIANGLES);
    assert_eq!(place.json("verify model.vdt --against mesh.ply")["same_as_mesh"], true);
    place.json("navigate model.vdt --path flyby:20 --io sync --pixels 0.1");
}

#[test]
fn closed_and_open_surfaces() {
    go(&torus(12, 9, 0.0, 1).in_single_precision(), 1);
    go(&sphere(3, 0.1, 2).in_single_precision(), 1);
    go(&sheet(16, 16, 0.0, 0, 1), 1);
}

/// What the program makes itself, of every kind, down to the fewest triangles.
#[test]
fn generated_meshes() {
    for shape in ["terrain", "sphere", "gyroid", "city"] {
        for triangles in [10, 100, 3000] {
            let place = workplace!();
            place.json(&format!("generate {shape} --triangles {triangles} --seed 5 -o mesh.ply"));
            let mesh = read_ply(&place.read("mesh.ply"));
            let components =
                place.json("build --positions lossless mesh.ply -o model.vdt")["components"].as_u64().unwrap();
            assert!(
                components >= 1 && (components == 1 || ["city", "gyroid"].contains(&shape)),
                "{components} {shape}"
            );
            the_whole_way(&place, &mesh, components as usize);
        }
    }
}

/// Every way of building gives a model that is the mesh.
#[test]
fn every_way_of_building() {
    let place = workplace!();
    place.json("generate city --triangles 4000 -o mesh.ply");
    let mesh = read_ply(&place.read("mesh.ply"));
    for metric in ["quadric", "length"] {
        for strategy in ["passes", "btree"] {
            for blocking in ["forest:32K,8", "forest:4K,2", "forest:1M,64", "levels:1", "levels:5", "levels:15"] {
                let options = format!("--metric {metric} --strategy {strategy} --blocking {blocking}");
                let built = place.json(&format!("build --positions lossless mesh.ply -o model.vdt --force {options}"));
                assert_eq!(built["triangles"], surface(&mesh).len(), "{options}");
                assert_eq!(place.json("verify model.vdt --against mesh.ply")["same_as_mesh"], true, "{options}");
                let info = place.json("info model.vdt");
                assert_eq!((&info["metric"], &info["strategy"]), (&metric.into(), &strategy.into()));
                place.json("navigate model.vdt --path flyby:10 --io sync --pixels 0.3 --memory 4M");
                let again = place.json(&format!("build --positions lossless mesh.ply -o again.vdt --force {options}"));
                assert_eq!(again["model_sha256"], built["model_sha256"], "{options}");
            }
        }
    }
}
