//! Builds of meshes that do not fit in memory (invariants 2 and 8 of the design): the same bytes whatever the memory, the
//! threads and the order of the input, and what happens when one is interrupted.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::process::Stdio;
use std::time::{Duration, Instant};

use serde_json::Value;
use vdt_tests::mesh_files::{obj, read_ply};
use vdt_tests::program::Workplace;
use vdt_tests::workplace;

/// Builds a model of `mesh.ply` and returns the report.
fn build(place: &Workplace, options: &str) -> Value {
    place.json(&format!("build mesh.ply -o model.vdt --force {options}"))
}

/// The least memory for `mesh.ply`, by the program's own account.
fn least(place: &Workplace) -> u64 {
    place.json("build mesh.ply --dry-run --threads 2")["memory_needed_bytes"].as_u64().unwrap()
}

#[test]
fn memory_and_threads_do_not_change_a_byte() {
    for (shape, triangles) in [("terrain", 250_000), ("sphere", 250_000), ("city", 250_000)] {
        let place = workplace!();
        place.json(&format!("generate {shape} --triangles {triangles} --seed 5 -o mesh.ply"));
        let in_core = build(&place, "--memory 1G --threads 1");
        assert_eq!(in_core["scratch_peak_bytes"], 0, "{shape}");
        let least = least(&place);
        for options in [
            format!("--memory {least} --threads 1"),
            format!("--memory {least} --threads 2"),
            "--memory 26M --threads 3".into(),
            "--memory 28M --threads 2".into(),
        ] {
            let external = build(&place, &options);
            assert_eq!(external["model_sha256"], in_core["model_sha256"], "{shape} {options}");
            assert!(external["scratch_peak_bytes"].as_u64().unwrap() > triangles * 20, "{shape} {options}");
            assert_eq!(place.names().len(), 2, "{:?}", place.names());
        }
    }
}

/// Nor do they with the other bounds: what triangles answer for travels with them.
#[test]
fn memory_changes_no_switch_value_of_any_bound() {
    let place = workplace!();
    place.json("generate terrain --triangles 250000 --seed 7 -o mesh.ply");
    let mut digests = Vec::new();
    for bound in ["none", "fast", "default", "tight", "two-sided"] {
        let in_core = build(&place, &format!("--memory 1G --error-bound {bound}"));
        let external = build(&place, &format!("--memory 26M --threads 2 --error-bound {bound}"));
        assert!(external["scratch_peak_bytes"].as_u64().unwrap() > 250_000 * 20);
        assert_eq!(external["model_sha256"], in_core["model_sha256"], "{bound}");
        digests.push(in_core["model_sha256"].to_string());
    }
    digests.sort();
    digests.dedup();
    assert_eq!(digests.len(), 5);
}

#[test]
fn the_order_of_the_input_does_not_change_a_byte() {
    let place = workplace!();
    place.json("generate terrain --triangles 250000 --seed 6 -o mesh.ply");
    let expected = build(&place, "--memory 1G");
    let mut mesh = read_ply(&place.read("mesh.ply"));
    // Vertices and triangles by numbers that have nothing to do with where they lie.
    let count = mesh.positions.len() as u64;
    let place_of = |vertex: u64| (vertex * 1_000_003 % count) as usize;
    let mut positions = mesh.positions.clone();
    for (vertex, position) in mesh.positions.iter().enumerate() {
        positions[place_of(vertex as u64)] = *position;
    }
    mesh.positions = positions;
    mesh.triangles.sort_by_key(|corners| corners[1].wrapping_mul(0x9e37_79b9));
    mesh.triangles.iter_mut().flatten().for_each(|corner| *corner = place_of((*corner).into()) as u32);
    let least = least(&place);
    place.write("mesh.obj", obj(&mesh));
    let shuffled = place.json(&format!("build mesh.obj -o model.vdt --force --memory {least}"));
    assert_eq!(shuffled["model_sha256"], expected["model_sha256"]);
}

/// Through the B-tree on disk with the least memory there is, the collapses are those of the queue in memory.
#[test]
fn the_paper_s_order_does_not_depend_on_memory_either() {
    let place = workplace!();
    place.json("generate terrain --triangles 60000 --seed 7 -o mesh.ply");
    let in_core = build(&place, "--strategy btree --memory 1G");
    assert!(in_core["spanned"].is_null() && in_core["scratch_peak_bytes"] == 0, "{in_core}");
    let dry = place.json("build mesh.ply --dry-run --strategy btree");
    let least = dry["memory_needed_bytes"].as_u64().unwrap();
    let external = build(&place, &format!("--strategy btree --edge-tree redb --memory {least}"));
    assert_eq!(external["model_sha256"], in_core["model_sha256"]);
    let spanned = |figure: &str| external["spanned"][figure].as_u64().unwrap();
    assert!(spanned("loads") > 3 && spanned("tree_bytes_read") > 1 << 20, "{external}");
    assert_eq!(place.names().len(), 2, "{:?}", place.names());
}

/// sled is refused where it would not keep to the memory, and what is advised then is accepted.
#[test]
fn the_memory_that_is_advised_for_sled_is_enough() {
    let place = workplace!();
    place.json("generate terrain --triangles 60000 --seed 7 -o mesh.ply");
    let sled = "--strategy btree --edge-tree sled";
    let message = place.refuses(1, &format!("build mesh.ply -o model.vdt {sled} --memory 6M"), &["sled"]);
    let advice = message.split("--memory ").nth(1).unwrap().trim();
    let dry = place.json(&format!("build mesh.ply --dry-run {sled} --memory 6M"));
    let needed = dry["memory_needed_bytes"].as_u64().unwrap();
    assert_eq!((&dry["fits"], format!("{}M", needed >> 20)), (&Value::from(false), advice.to_owned()));
    let found = build(&place, &format!("{sled} --memory {advice}"));
    let expected = build(&place, "--strategy btree --memory 1G");
    assert_eq!(found["model_sha256"], expected["model_sha256"]);
}

/// A build that is killed after a phase was finished goes on from there when it is run again; with other options it
/// begins anew. In the end nothing is left but the model.
#[test]
fn a_killed_build_is_taken_up_again() {
    let place = workplace!();
    place.json("generate terrain --triangles 600000 --seed 8 -o mesh.ply");
    let expected = build(&place, "--memory 1G")["model_sha256"].clone();
    std::fs::remove_file(place.path("model.vdt")).unwrap();
    // A manifest that tells of the finished phase, the memory of the second run, and the phases that it has to do.
    let cases = [
        ("read", "--memory 24M", &["simplify", "number", "write"][..]),
        // Regression: the file of the roots was gone before the checkpoint was written, so nothing was taken over.
        ("simplified", "--memory 24M", &["number", "write"]),
        ("read", "--memory 25M", &["ingest", "simplify", "number", "write"]),
    ];
    for (finished, again, phases) in cases {
        let mut command = place.command(&["build", "mesh.ply", "-o", "model.vdt", "--memory", "24M"]);
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let start = Instant::now();
        let manifest = place.path(".model.vdt.scratch/manifest.json");
        while !std::fs::read_to_string(&manifest).is_ok_and(|text| text.contains(&format!("\"{finished}\""))) {
            assert!(start.elapsed() < Duration::from_secs(60) && child.try_wait().unwrap().is_none());
            std::thread::sleep(Duration::from_millis(1));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(!place.path("model.vdt").exists());
        let document = build(&place, again);
        assert_eq!(document["model_sha256"], expected);
        assert_eq!(document["resumed"], Value::from(phases.len() < 4));
        let done: Vec<&str> =
            document["phases"].as_array().unwrap().iter().map(|phase| phase["name"].as_str().unwrap()).collect();
        assert_eq!(done, phases);
        assert_eq!(place.names().len(), 2, "{:?}", place.names());
        std::fs::remove_file(place.path("model.vdt")).unwrap();
    }
}
