//! `vdt compare`: what it prints, on meshes of which the distances are known, and what it refuses.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use serde_json::Value;
use vdt_tests::mesh_files::{Coordinates, Encoding, obj, off, ply, stl_binary};
use vdt_tests::program::Workplace;
use vdt_tests::random_mesh::{RawMesh, closed_box, sphere};
use vdt_tests::workplace;

const SIDES: [&str; 2] = ["a_to_b", "b_to_a"];

fn float(document: &Value, key: &str) -> f64 {
    document[key].as_f64().unwrap_or_else(|| panic!("no `{key}` in {document}"))
}

fn moved(mesh: &RawMesh, by: [f64; 3]) -> RawMesh {
    let mut moved = RawMesh::default();
    moved.append(mesh, by);
    moved
}

/// The figures that do not depend on the machine and its load.
fn figures(mut document: Value) -> Value {
    let map = document.as_object_mut().unwrap();
    for key in ["seconds", "cpu_seconds", "peak_rss_bytes", "memory_bytes"] {
        map.remove(key).unwrap();
    }
    document
}

/// A box, and another of the same size 10 to its right, in the coordinates of a country: the nearest side of one is a side
/// of the other, and the farthest points are a side away from it.
#[test]
fn two_boxes_in_every_format() {
    let place = workplace!();
    let far = [4.0e6, 5.5e6, 100.0];
    place.write("left.ply", ply(&moved(&closed_box(), far), Encoding::Ascii, Coordinates::Double));
    let right = moved(&closed_box(), [far[0] + 10.0, far[1], far[2]]);
    place.write("right.ply", ply(&right, Encoding::BigEndian, Coordinates::Double));
    let found = place.json("compare left.ply right.ply --samples 10000");
    for side in SIDES {
        assert!((float(&found, &format!("{side}_max")) - 10.0).abs() < 1e-9, "{found}");
        assert!((float(&found, &format!("{side}_max_at_most")) - 10.0).abs() < 0.011, "{found}");
        let (mean, rms) = (float(&found, &format!("{side}_mean")), float(&found, &format!("{side}_rms")));
        // A side is 9 away, the one across 10, and the four between lie between.
        assert!(mean > 9.0 && mean < rms && rms < 10.0, "{found}");
        let at: Vec<f64> = found[format!("{side}_max_at")].as_array().unwrap().iter().flat_map(Value::as_f64).collect();
        assert_eq!(at.len(), 3);
        let across = if side == "a_to_b" { far[0] } else { far[0] + 11.0 };
        assert!((at[0] - across).abs() < 1e-9, "{found}");
    }
    assert_eq!(float(&found, "hausdorff"), float(&found, "a_to_b_max").max(float(&found, "b_to_a_max")));
    assert!((float(&found, "diagonal") - 3.0_f64.sqrt()).abs() < 1e-9, "{found}");
    assert_eq!((found["samples"].as_u64(), found["a_triangles"].as_u64()), (Some(10_000), Some(12)));
    assert!(float(&found, "seconds") > 0.0 && float(&found, "cpu_seconds") > 0.0);

    // The same surface in another format is no distance away.
    place.write("box.obj", obj(&closed_box()));
    place.write("box.off", off(&closed_box()));
    place.write("box.stl", stl_binary(&closed_box()));
    for other in ["box.obj", "box.off", "box.stl"] {
        let same = place.json(&format!("compare box.obj {other} --samples 1000"));
        assert!(float(&same, "hausdorff") < 1e-12 && float(&same, "a_to_b_mean") < 1e-12, "{same}");
    }
}

/// A cut is as far from its mesh as the library says, whatever the memory and the threads, and whichever comes first.
#[test]
fn memory_threads_and_order_change_nothing() {
    let place = workplace!();
    place.json("generate sphere --triangles 150000 --seed 3 -o sphere.ply");
    place.json("build sphere.ply -o sphere.vdt");
    place.json("extract sphere.vdt -o cut.ply --triangles 9000");
    let compare = "compare sphere.ply cut.ply --samples 30000 --scratch .";
    let names = place.names();
    let found = figures(place.json(&format!("{compare} --threads 1")));
    for options in ["--threads 3", "--memory 16M --threads 2", "--memory 1G"] {
        assert_eq!(figures(place.json(&format!("{compare} {options}"))), found, "{options}");
    }
    assert_eq!(place.names(), names);
    let back = figures(place.json("compare cut.ply sphere.ply --samples 30000"));
    for key in ["mean", "rms", "max", "max_at", "max_at_most", "max_settled"] {
        for (side, other) in [("a_to_b", "b_to_a"), ("b_to_a", "a_to_b")] {
            assert_eq!(back[format!("{side}_{key}")], found[format!("{other}_{key}")], "{key}");
        }
    }
    let diagonal = float(&found, "diagonal");
    assert!(float(&found, "hausdorff") > 1e-5 * diagonal && float(&found, "hausdorff") < 0.05 * diagonal, "{found}");
    let one_sided = place.json(&format!("{compare} --one-sided"));
    assert_eq!(one_sided["a_to_b_max"], found["a_to_b_max"]);
    assert!(one_sided["b_to_a_max"].is_null() && one_sided["hausdorff"].is_null(), "{one_sided}");
}

#[test]
fn what_is_printed_for_people() {
    let place = workplace!();
    place.write("ball.ply", ply(&sphere(3, 0.0, 1), Encoding::LittleEndian, Coordinates::Float));
    let text = place.run("compare ball.ply ball.ply --samples 1000").success();
    for word in
        ["A  ", "B  ", "mean", "rms", "max at most", "A to B", "B to A", "largest", "Hausdorff", "diagonal", "%"]
    {
        assert!(text.contains(word), "no `{word}` in {text}");
    }
    assert!(text.lines().all(|line| line.chars().count() <= 110), "{text}");
    assert!(!text.contains("colour"), "{text}");
    let found = place.json("compare ball.ply ball.ply --samples 1000 --no-colours");
    assert!(found.as_object().unwrap().keys().all(|key| !key.contains("colour")), "{found}");
    let text = place.run("compare ball.ply ball.ply --samples 1000 --one-sided").success();
    assert!(text.contains("A to B") && !text.contains("B to A") && !text.contains("Hausdorff"), "{text}");
}

fn place_with_meshes() -> Workplace {
    let place = workplace!();
    place.write("box.ply", ply(&closed_box(), Encoding::Ascii, Coordinates::Double));
    place.write("empty.off", "OFF\n0 0 0\n");
    place.write("segment.off", "OFF\n2 1 0\n0 0 0\n1 1 1\n3 0 1 1\n");
    place.write("letter.txt", "Dear reader,\n");
    place
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let place = place_with_meshes();
    place.json("build box.ply -o box.vdt");
    for (other, says) in [
        ("missing.ply", &["missing.ply", "No such file"][..]),
        ("empty.off", &["empty.off", "no surface"]),
        ("segment.off", &["segment.off", "no surface"]),
        ("letter.txt", &["letter.txt", "not a mesh"]),
        ("box.vdt", &["box.vdt", "is a model", "vdt extract"]),
    ] {
        place.refuses(1, &format!("compare box.ply {other}"), says);
        place.refuses(1, &format!("compare {other} box.ply"), says);
    }
    place.refuses(1, "compare box.ply box.ply --memory 1M", &["--memory 16M"]);
    place.refuses(1, "compare box.ply box.ply --scratch nowhere", &["nowhere"]);
    place.refuses(2, "compare box.ply", &["<MESH_B>"]);
    place.refuses(2, "compare box.ply box.ply box.ply", &["box.ply"]);
    place.refuses(2, "compare box.ply box.ply --samples 0", &["--samples"]);
    place.refuses(2, "compare box.ply box.ply --threads 0", &["--threads"]);
    place.refuses(2, "compare box.ply box.ply --memory 1X", &["1X"]);
}
