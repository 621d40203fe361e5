//! How positions are kept, by the program itself: rounded to a lattice, or on one that the mesh has of its own.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use serde_json::Value;
use vdt_tests::mesh_files::{Coordinates, Encoding, ply, read_ply};
use vdt_tests::random_mesh::{RawMesh, sheet, sphere};
use vdt_tests::workplace;

fn number(document: &Value, key: &str) -> f64 {
    document[key].as_f64().unwrap_or_else(|| panic!("{key} in {document}"))
}

/// The largest distance of a vertex of `mesh` from the nearest one of `other`.
fn farthest(mesh: &RawMesh, other: &RawMesh) -> f64 {
    let nearest = |from: &[f64; 3]| {
        let squares = other.positions.iter().map(|to| (0..3).map(|axis| (from[axis] - to[axis]).powi(2)).sum::<f64>());
        squares.fold(f64::INFINITY, f64::min).sqrt()
    };
    mesh.positions.iter().map(nearest).fold(0.0, f64::max)
}

/// Two orders of the file, three memories, both strategies; near zero and far from it.
#[test]
fn a_lattice_moves_no_vertex_farther_than_it_says() {
    for far in [0.0, 4e5] {
        let place = workplace!();
        let mut mesh = sphere(3, 0.1, 8);
        mesh.positions.iter_mut().flatten().for_each(|value| *value = *value * 0.37 + far);
        place.write("mesh.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Double));
        place.write("other.ply", ply(&mesh.shuffled(4), Encoding::Ascii, Coordinates::Double));
        let mut last = f64::INFINITY;
        for bits in [10_i32, 13, 16, 20, 24] {
            let built = place.json(&format!("build mesh.ply -o m.vdt --force --positions {bits}"));
            let other = format!("build other.ply -o other.vdt --force --positions {bits} --memory 16M --threads 2");
            assert_eq!(built["model_sha256"], place.json(&other)["model_sha256"]);
            let info = place.json("info m.vdt");
            assert_eq!(info["positions"], bits.to_string());
            assert_eq!(info["lattice_step"], built["lattice_step"]);
            let (step, told) = (number(&built, "lattice_step"), number(&built, "input_error"));
            let width = |axis: usize| info["maximum"][axis].as_f64().unwrap() - info["minimum"][axis].as_f64().unwrap();
            let widest = (0..3).map(width).fold(0.0, f64::max);
            assert!(
                widest / step <= f64::from(1 << bits) && widest / step > f64::from((1 << bits) - 3),
                "{widest} {step}"
            );
            // Half the diagonal of a cell, and what single precision rounds off the product.
            let most = 0.8661 * step * (1.0 + f64::from(bits - 24).exp2());
            assert!(told <= most && told > 0.4 * step && told < last, "{told} {step}");
            last = told;
            place.json("verify m.vdt --against mesh.ply");
            place.json("extract m.vdt -o back.ply --error 0 --force");
            let moved = farthest(&mesh, &read_ply(&place.read("back.ply")));
            assert!(moved <= told && moved > 0.4 * told, "{moved} {told}");
        }
        place.json("build mesh.ply -o b.vdt --positions 12 --strategy btree");
        place.json("verify b.vdt --against other.ply");
        let text = place.run("build mesh.ply -o b.vdt --force --positions 12").success();
        assert!(text.contains("12 bits: rounded to a lattice with steps of "), "{text}");
    }
}

#[test]
fn a_lattice_of_its_own_is_kept_whatever_is_asked_for() {
    let place = workplace!();
    let mut mesh = sphere(3, 0.3, 2);
    mesh.positions.iter_mut().flatten().for_each(|value| *value = (*value * 800.0).round() * 2.5 + 1000.0);
    place.write("mesh.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Float));
    for positions in ["lossless", "auto", "12", "24"] {
        let built = place.json(&format!("build mesh.ply -o m.vdt --force --positions {positions}"));
        assert_eq!((&built["positions"], number(&built, "lattice_step")), (&"lossless".into(), 2.5));
        assert_eq!(built["input_error"], 0.0);
        place.json("verify m.vdt --against mesh.ply");
    }
    let text = place.run("info m.vdt").success();
    assert!(text.contains("lossless, on a lattice with steps of 2.500"), "{text}");
    // It has more steps than that.
    let coarser = place.json("build mesh.ply -o m.vdt --force --positions 10");
    assert_eq!(coarser["positions"], "10");
    // A vertex beside it.
    mesh.positions[0][0] = 1e-3;
    place.write("mesh.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Float));
    let built = place.json("build mesh.ply -o m.vdt --force --positions lossless");
    assert_eq!((&built["positions"], number(&built, "lattice_step")), (&"lossless".into(), 0.0));
}

/// Decimals need no more bits than they have digits, if not all of them are some.
#[test]
fn decimals_are_small() {
    let place = workplace!();
    let mut mesh = sphere(5, 0.1, 8);
    mesh.positions.iter_mut().flatten().for_each(|value| *value *= 0.037);
    let size = |mesh: &RawMesh| {
        place.write("mesh.ply", ply(mesh, Encoding::LittleEndian, Coordinates::Float));
        let built = place.json("build mesh.ply -o m.vdt --force --positions lossless");
        place.json("verify m.vdt --against mesh.ply");
        assert_eq!((&built["positions"], number(&built, "lattice_step")), (&"lossless".into(), 0.0));
        number(&built, "model_bytes") / mesh.positions.len() as f64
    };
    let as_they_are = size(&mesh);
    mesh.positions.iter_mut().flatten().for_each(|value| *value = (*value * 1e5).round() / 1e5);
    mesh.positions[7] = [0.012_345_678; 3];
    let decimals = size(&mesh);
    assert!(decimals < as_they_are - 3.0, "{decimals} and {as_they_are} bytes for a vertex");
}

/// A ribbon beside a plate, thinner than a step of the lattice: it vanishes, and is in the input error all the same.
#[test]
fn what_vanishes_on_the_lattice_is_told() {
    let place = workplace!();
    let mut mesh = RawMesh {
        positions: vec![[0.0; 3], [100.0, 0.0, 0.0], [100.0, 100.0, 0.0], [0.0, 100.0, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    for step in 0..10 {
        let along = f64::from(step) * 5.0 + 10.1;
        mesh.positions.extend([[along, 50.0, 31.0], [along, 50.003, 31.0]]);
    }
    for step in 0..9 {
        let first = 4 + 2 * step;
        mesh.triangles.extend([[first, first + 1, first + 2], [first + 2, first + 1, first + 3]]);
    }
    place.write("mesh.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Double));
    let built = place.json("build mesh.ply -o m.vdt --positions 10");
    assert_eq!((built["triangles"].as_u64(), built["vertices"].as_u64()), (Some(2), Some(4)));
    let count = |kind: &str| {
        let warnings = built["warnings"].as_array().unwrap().iter();
        warnings.filter(|warning| warning["kind"] == kind).find_map(|warning| warning["count"].as_u64())
    };
    assert_eq!((count("fallen_vertices"), count("degenerate_triangles")), (Some(10), Some(18)));
    let told = number(&built, "input_error");
    assert!((31.0..150.0).contains(&told), "{told}");
    place.json("verify m.vdt --against mesh.ply");
    let fine = place.json("build mesh.ply -o m.vdt --positions 18 --force");
    assert_eq!((fine["triangles"].as_u64(), fine["components"].as_u64()), (Some(20), Some(2)));
}

/// Vertices are put in order by where they are in the mesh's box. Here most of the box is that of triangles without area,
/// which are left out of a model: `verify --against` once took the model for that of another mesh.
#[test]
fn a_model_is_that_of_its_mesh_whatever_was_left_out_at_the_edge_of_the_box() {
    let place = workplace!();
    for ribbon in [0.0, 3e-4] {
        let mut mesh = sheet(19, 19, 0.3, 0, 1);
        mesh.positions.iter_mut().flatten().for_each(|value| *value *= 5.3);
        let first = mesh.positions.len() as u32;
        for step in 0..10 {
            let along = f64::from(step) * 5.0 + 10.1;
            mesh.positions.extend([[along, 350.0, 31.0], [along, 350.0, 31.0 + ribbon]]);
        }
        for pair in (first..first + 18).step_by(2) {
            mesh.triangles.extend([[pair, pair + 1, pair + 2], [pair + 2, pair + 1, pair + 3]]);
        }
        place.write("mesh.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Double));
        for positions in ["lossless", "10", "12"] {
            let built = place.json(&format!("build mesh.ply -o m.vdt --force --positions {positions}"));
            let is_left_out = ribbon == 0.0 || positions != "lossless";
            assert_eq!(built["components"], if is_left_out { 1 } else { 2 });
            place.json("verify m.vdt --against mesh.ply");
            mesh.positions[5][2] += 3.0;
            place.write("other.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Double));
            place.refuses(1, "verify m.vdt --against other.ply", &["m.vdt: not this mesh"]);
            mesh.positions[5][2] -= 3.0;
        }
    }
}

#[test]
fn positions_that_cannot_be_are_refused() {
    let place = workplace!();
    let mut mesh = sphere(2, 0.1, 8);
    place.write("mesh.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Float));
    for wrong in ["9", "25", "16bits", "exact"] {
        place.refuses(2, &format!("build mesh.ply -o m.vdt --positions {wrong}"), &[wrong, "lossless, and 10 to 24"]);
    }
    mesh.positions.iter_mut().flatten().for_each(|value| *value *= 1e-36);
    place.write("small.ply", ply(&mesh, Encoding::Ascii, Coordinates::Double));
    let says = ["small.ply", "20 bits", "run again with --positions lossless"];
    place.refuses(1, "build small.ply -o m.vdt --positions 20", &says);
    let built = place.json("build small.ply -o m.vdt --positions auto");
    assert_eq!(built["positions"], "lossless");
}
