//! RAM (invariant 6 of the design): `--memory` bounds all that grows with the data, and on top come at most 8 MiB for a
//! flight and 32 MiB for a build. Judged by the operating system: by the peak of the resident set, and where a memory
//! cgroup can be made, by not being killed in one of that size.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::os::unix::process::ExitStatusExt;

use serde_json::Value;
use vdt_tests::memory::{MemoryCgroup, run_in, run_watched};
use vdt_tests::program::{Outcome, Workplace};
use vdt_tests::workplace;

const MIB: u64 = 1 << 20;
/// What a build may take on top of `--memory`.
const FOR_BUILD: u64 = 32 * MIB;
/// What a flight may take on top.
const FOR_FLIGHT: u64 = 8 * MIB;

/// A folder with `terrain.ply`, of 300,000 triangles.
fn place_with_terrain() -> Workplace {
    let place = workplace!();
    place.json("generate terrain --triangles 300000 --seed 4 -o terrain.ply");
    place
}

/// The same with its model.
fn place_with_model() -> Workplace {
    let place = place_with_terrain();
    place.json("build terrain.ply -o terrain.vdt");
    place
}

/// The fewest bytes in which a build will do, by its own account.
fn needed(place: &Workplace, options: &str) -> u64 {
    let dry = place.json(&format!("build terrain.ply -o new.vdt --dry-run {options}"));
    dry["memory_needed_bytes"].as_u64().unwrap()
}

/// Runs the program; neither by the system's account nor by its own, where it gives one, may it have taken more than
/// this.
fn within(place: &Workplace, bytes: u64, arguments: &str) -> Value {
    let (outcome, watched) = run_watched(place, &format!("{arguments} --json"));
    let document = outcome.document();
    let own = document["peak_rss_bytes"].as_u64();
    match own.max(watched) {
        Some(peak) => assert!(peak <= bytes, "`vdt {arguments}` took {peak} bytes, {} too many", peak - bytes),
        None => println!("`vdt {arguments}`: this system does not tell the memory of a process"),
    }
    document
}

/// What the program says of its own peak is what is seen from outside, in a run that is long enough to be watched.
#[test]
fn the_program_says_truly_what_it_took() {
    let place = place_with_terrain();
    let (outcome, watched) = run_watched(&place, "build terrain.ply -o new.vdt --json");
    let own = outcome.document()["peak_rss_bytes"].as_u64();
    assert_eq!(own.is_some(), watched.is_some());
    if let (Some(own), Some(watched)) = (own, watched) {
        assert!(own > 30 * MIB && watched > own / 4 * 3 && watched < own + 2 * MIB, "{own} by itself, {watched} seen");
    }
}

/// Runs the program in a memory cgroup of this size, if there are such: not killed, and done. `small` must be killed
/// in a cgroup much too small for it, or else the cgroups of this system hold nobody to anything.
fn not_killed(place: &Workplace, bytes: u64, arguments: &str) -> Option<Outcome> {
    match MemoryCgroup::new(bytes) {
        Ok(group) => Some(run_in(&group, place, arguments)),
        Err(error) => {
            println!("`vdt {arguments}` was not run in a memory cgroup, only its resident set was watched: {error}");
            None
        }
    }
}

#[test]
fn a_build_keeps_to_its_memory() {
    let place = place_with_terrain();
    // With the least memory nearly everything goes through the scratch; with 64 MiB the priority queue fits.
    for (options, memory) in [
        ("", needed(&place, "")),
        ("--threads 3", needed(&place, "--threads 3")),
        ("--metric length --blocking levels:5", needed(&place, "")),
        ("", 24 * MIB),
        ("--error-bound tight", 24 * MIB),
        ("--strategy btree", 64 * MIB),
    ] {
        let build = format!("build terrain.ply -o new.vdt --force --memory {memory} {options}");
        let built = within(&place, memory + FOR_BUILD, &build);
        assert_eq!(built["triangles"], 300_000);
        // What was promised is needed, too: a promise much larger than that would refuse what would fit.
        if let Some(peak) = built["peak_rss_bytes"].as_u64() {
            assert!(peak > memory / 2, "{peak} bytes of {memory} promised");
        }
    }
}

/// Two meshes that do not fit: what is read of them, the boxes over them and the caches keep to the memory together.
#[test]
fn a_comparison_keeps_to_its_memory() {
    let place = place_with_terrain();
    place.json("generate terrain --triangles 250000 --seed 5 -o other.ply");
    for (memory, threads) in [(16 * MIB, 1), (24 * MIB, 3)] {
        let compare = format!("compare terrain.ply other.ply --samples 20000 --memory {memory} --threads {threads}");
        let found = within(&place, memory + FOR_FLIGHT, &compare);
        assert_eq!((&found["a_triangles"], &found["b_triangles"]), (&300_000.into(), &250_000.into()));
    }
}

/// A soup has three vertices for each triangle, and lists of triangles grow while they are read.
#[test]
fn a_build_keeps_to_its_memory_whatever_the_format() {
    use vdt_tests::mesh_files::{gltf_in_one, obj, off, read_ply, stl_binary};
    let place = workplace!();
    place.json("generate sphere --triangles 200000 -o sphere.ply");
    let mesh = read_ply(&place.read("sphere.ply"));
    place.write("sphere.stl", stl_binary(&mesh));
    place.write("sphere.obj", obj(&mesh));
    place.write("sphere.off", off(&mesh));
    place.write("sphere.gltf", gltf_in_one(&mesh, 4));
    let mut digests = Vec::new();
    for (file, document) in [("sphere.stl", 0), ("sphere.obj", 0), ("sphere.off", 0), ("sphere.gltf", 1)] {
        let dry = place.json(&format!("build {file} -o new.vdt --dry-run"));
        let memory = dry["memory_needed_bytes"].as_u64().unwrap();
        // A data URI is part of the document, which has to be in RAM.
        let document = document * place.read(file).len() as u64;
        let build = format!("build {file} -o new.vdt --force --memory {memory}");
        within(&place, memory + FOR_BUILD + document, &build);
        // Some of the formats give the triangles' normals, others do not.
        digests.push(place.json(&format!("{build} --no-attributes"))["model_sha256"].clone());
    }
    assert!(digests.iter().all(|digest| *digest == digests[0]));
}

#[test]
fn a_flight_keeps_to_its_memory() {
    let place = place_with_model();
    for megabytes in [4, 8, 16] {
        for flight in [
            "--path flyby:120 --frame-rate 200",
            "--path flyby:120 --io sync --pixels 0.3",
            "--path orbit:60 --io sync --pixels 0.1 --dependency none",
        ] {
            let navigate = format!("navigate terrain.vdt --memory {megabytes}M {flight}");
            let flown = within(&place, megabytes * MIB + FOR_FLIGHT, &navigate);
            assert_eq!(flown["budget_bytes"], megabytes * MIB);
            let planned = flown["planned_bytes"].as_u64().unwrap();
            assert!(planned <= megabytes * MIB && planned > megabytes * MIB * 9 / 10, "{planned}");
            assert!(flown["triangles_mean"].as_f64().unwrap() > 1000.0, "{flown}");
        }
    }
    // With more than is needed for everything, no more is taken than that.
    let rich = place.json("navigate terrain.vdt --path flyby:30 --io sync --memory 64G");
    assert!(rich["planned_bytes"].as_u64().unwrap() < 200 * MIB, "{rich}");
}

/// The commands that read a model from end to end take next to nothing: it streams past.
#[test]
fn what_streams_takes_little() {
    let place = place_with_model();
    within(&place, 8 * MIB, "info terrain.vdt");
    within(&place, 8 * MIB, "info terrain.ply");
    within(&place, 8 * MIB, "build terrain.ply -o new.vdt --dry-run --memory 1G");
    within(&place, 12 * MIB, "extract terrain.vdt -o new.ply --force --error 0");
    within(&place, 12 * MIB, "extract terrain.vdt -o new.ply --force --triangles 100000");
    within(&place, 8 * MIB + FOR_FLIGHT, "extract terrain.vdt -o new.ply --force --camera 0,0,9000,1,1,0 --memory 8M");
    // Eight bytes of marks for each vertex and triangle, and nothing of the model.
    within(&place, 16 * MIB, "verify terrain.vdt");
    let message = place.refuses(1, "verify terrain.vdt --against terrain.ply --memory 1K", &["--memory"]);
    let (_, memory) = message.trim_end().rsplit_once("--memory ").unwrap();
    let bytes = memory.strip_suffix('M').unwrap().parse::<u64>().unwrap() * MIB;
    within(&place, bytes + FOR_BUILD, &format!("verify terrain.vdt --against terrain.ply --memory {memory}"));
    for triangles in [100_000, 400_000] {
        for shape in ["terrain", "sphere", "gyroid", "city"] {
            within(&place, 8 * MIB, &format!("generate {shape} --triangles {triangles} -o new.ply --force"));
        }
    }
}

/// The kernel's own judgement. First, that it judges at all: a build is killed in a cgroup that is far too small.
#[test]
fn nobody_is_killed_in_a_cgroup_of_the_size_allowed() {
    let place = place_with_model();
    let build_memory = needed(&place, "");
    let build = format!("build terrain.ply -o new.vdt --force --memory {build_memory}");
    let Some(control) = not_killed(&place, build_memory / 2, &build) else { return };
    if control.status.success() {
        println!("the memory cgroups of this system kill nobody: only resident sets were watched");
        return;
    }
    assert_eq!(control.status.signal(), Some(9), "{control:?}");

    let survives = |bytes: u64, arguments: &str| {
        not_killed(&place, bytes, arguments).expect("there were cgroups a moment ago").success();
    };
    survives(build_memory + FOR_BUILD, &build);
    for megabytes in [4, 8, 16] {
        for flight in ["--path flyby:120 --frame-rate 200", "--path flyby:120 --io sync --pixels 0.3"] {
            let navigate = format!("navigate terrain.vdt --memory {megabytes}M {flight}");
            survives(megabytes * MIB + FOR_FLIGHT, &navigate);
        }
    }
    survives(16 * MIB, "extract terrain.vdt -o new.ply --force --error 0");
}
