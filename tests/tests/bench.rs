//! `vdt bench`: what it prints and draws, what it refuses, and that it leaves nothing behind.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use vdt_tests::mesh_files::{Coordinates, Encoding, ply};
use vdt_tests::program::{Workplace, wait};
use vdt_tests::random_mesh::{closed_box, sphere};
use vdt_tests::workplace;

/// A ball and a box, and a file that is no mesh.
fn place_with_meshes() -> Workplace {
    let place = workplace!();
    place.write("ball.ply", ply(&sphere(4, 0.05, 3), Encoding::LittleEndian, Coordinates::Float));
    place.write("box.ply", ply(&closed_box(), Encoding::Ascii, Coordinates::Double));
    place.write("letter.txt", "Dear reader,\n");
    place
}

fn whole(row: &Value, key: &str) -> u64 {
    row[key].as_u64().unwrap_or_else(|| panic!("no `{key}` in {row}"))
}

fn float(row: &Value, key: &str) -> f64 {
    row[key].as_f64().unwrap_or_else(|| panic!("no `{key}` in {row}"))
}

/// The phases are all there, and what they moved is what was moved.
fn check_phases(row: &Value) {
    let phases = row["phases"].as_array().unwrap();
    let names: Vec<&str> = phases.iter().map(|phase| phase["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["ingest", "simplify", "number", "write"]);
    for key in ["bytes_read", "bytes_written"] {
        assert_eq!(phases.iter().map(|phase| whole(phase, key)).sum::<u64>(), whole(row, key));
    }
    assert!(phases.iter().all(|phase| float(phase, "seconds") >= 0.0 && float(phase, "cpu_seconds") >= 0.0));
}

fn check_picture(place: &Workplace, name: &str, words: &[&str]) {
    let svg = String::from_utf8(place.read(name)).unwrap();
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    for word in words {
        assert!(svg.contains(word), "no `{word}` in {name}");
    }
}

#[test]
fn table1_for_people() {
    let place = place_with_meshes();
    let mut names = place.names();
    let text =
        place.run("bench table1 ball.ply box.ply --memory 8M --threads 1 --scratch . --plot times.svg").success();
    let lines: Vec<&str> = text.lines().collect();
    let cells = |line: usize| lines[line].split_whitespace().collect::<Vec<_>>();
    let sizes = ["input MiB", "VDT MiB", "DATA MiB", "MNT MiB", "model MiB"];
    for heading in ["mesh", "triangles", "vertices", "VDT s", "MNT s"].into_iter().chain(sizes) {
        assert!(lines[0].contains(heading), "no `{heading}` in {text}");
    }
    assert_eq!((cells(1).len(), cells(2).len()), (10, 10), "{text}");
    assert_eq!((cells(1)[0], &cells(2)[..3]), ("ball.ply", &["box.ply", "12", "8"][..]), "{text}");
    for heading in ["CPU s", "tri/CPU-s", "peak MiB", "scratch MiB", "read B/tri", "written B/tri", "passes"] {
        assert!(lines[4].contains(heading), "no `{heading}` in {text}");
    }
    assert_eq!((cells(5)[0], cells(6)[0], cells(5).len()), ("ball.ply", "box.ply", 8), "{text}");
    assert!(
        text.contains("--memory 8M --threads 1 --strategy passes --metric quadric --error-bound default on "),
        "{text}"
    );
    assert!(lines.iter().take(8).all(|line| line.chars().count() <= 100), "{text}");
    check_picture(&place, "times.svg", &["ball.ply", "box.ply", "simplify", "microseconds of CPU time"]);
    names.insert("times.svg".into());
    assert_eq!(place.names(), names);
}

#[test]
fn table1_for_programs() {
    let place = place_with_meshes();
    let options = "--strategy btree:redb --metric length --error-bound none --runs 2 --scratch .";
    let names = place.names();
    let document = place.json(&format!("bench table1 ball.ply box.ply {options}"));
    assert_eq!(place.names(), names);
    assert_eq!((whole(&document, "memory_bytes"), whole(&document, "runs")), (256 << 20, 2));
    assert_eq!((&document["strategy"], &document["metric"]), (&"btree:redb".into(), &"length".into()));
    assert_eq!(document["error_bound"], "none");
    assert!(whole(&document["machine"], "cores") > 0);
    let rows = document["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 2);
    for (row, name) in rows.iter().zip(["ball", "box"]) {
        assert_eq!(row["mesh"], format!("{name}.ply"));
        // What is measured is the build that users run.
        let build = place.json(&format!(
            "build {name}.ply -o {name}.vdt --strategy btree --edge-tree redb --metric length --error-bound none --memory 256M"
        ));
        for key in ["triangles", "vertices", "input_triangles", "model_bytes", "passes"] {
            assert_eq!(row[key], build[key], "{key}");
        }
        assert_eq!(whole(row, "input_bytes"), place.read(&format!("{name}.ply")).len() as u64);
        assert_eq!(whole(row, "model_bytes"), place.read(&format!("{name}.vdt")).len() as u64);
        // Each vertex has one position, each triangle three corners.
        assert_eq!(whole(row, "decoded_data_bytes"), 12 * (whole(row, "vertices") + whole(row, "triangles")));
        let info = place.json(&format!("info {name}.vdt"));
        let decoded = |keys: &[&str]| keys.iter().map(|key| whole(&info["decoded_bytes_by_part"], key)).sum::<u64>();
        assert_eq!(whole(row, "decoded_tree_bytes"), decoded(&["roots", "records", "entries"]));
        assert_eq!(whole(row, "decoded_directory_bytes"), decoded(&["page_headers"]));
        assert_eq!(row["cpu_seconds_of_runs"].as_array().unwrap().len(), 2);
        assert!(float(row, "tree_seconds") > 0.0 && float(row, "meta_node_seconds") > 0.0);
        assert!(float(row, "triangles_per_cpu_second") > 0.0);
        assert!(whole(row, "peak_rss_bytes") > 1 << 20);
        assert_eq!(whole(row, "scratch_peak_bytes"), 0);
        assert!(whole(row, "bytes_read") >= whole(row, "input_bytes"));
        assert!(whole(row, "bytes_written") >= whole(row, "model_bytes"));
        check_phases(row);
    }
}

/// A mesh that does not fit: less memory moves more bytes to the same model, and sled is refused, which is no failure.
#[test]
fn io_against_memory() {
    let place = workplace!();
    place.json("generate gyroid --triangles 150000 -o gyroid.ply");
    let io = "bench io gyroid.ply --scratch . --memory 18M,256M --strategy passes,btree:sled";
    let mut names = place.names();
    let document = place.json(&format!("{io} --plot bytes.svg"));
    names.insert("bytes.svg".into());
    assert_eq!(place.names(), names);
    check_picture(
        &place,
        "bytes.svg",
        &["passes", "btree:sled", "refused or failed", "18 MiB", "256 MiB", "gyroid.ply"],
    );

    let rows = document["rows"].as_array().unwrap();
    let keys: Vec<_> = rows.iter().map(|row| (row["strategy"].as_str().unwrap(), whole(row, "memory_bytes"))).collect();
    assert_eq!(
        keys,
        [("passes", 18 << 20), ("passes", 256 << 20), ("btree:sled", 18 << 20), ("btree:sled", 256 << 20)].as_slice()
    );
    let [small, large, refused, sled] = rows.as_slice() else { panic!("{document}") };
    for row in [small, large, sled] {
        check_phases(row);
        for key in ["bytes_read", "bytes_written"] {
            let each = whole(row, key) as f64 / whole(row, "input_triangles") as f64;
            assert_eq!(float(row, &format!("{key}_per_triangle")), each);
        }
        assert!(float(row, "seconds") > 0.0 && float(row, "cpu_seconds") > 0.0);
    }
    assert_eq!(small["model_sha256"], large["model_sha256"]);
    assert!(whole(small, "bytes_read") > 2 * whole(large, "bytes_read"), "{document}");
    assert!(whole(small, "bytes_written") > 2 * whole(large, "bytes_written"), "{document}");
    assert!(whole(small, "scratch_peak_bytes") > 0 && whole(large, "scratch_peak_bytes") == 0);
    let reason = refused["refused"].as_str().unwrap();
    assert!(reason.contains("sled") && reason.contains("--memory "), "{reason}");
    assert!(refused["bytes_read"].is_null() && refused["error"].is_null());

    let text = place.run(io).success();
    for heading in ["strategy", "memory", "read B/tri", "written B/tri", "both B/tri", "CPU s", "peak MiB"] {
        assert!(text.lines().next().unwrap().contains(heading), "no `{heading}` in {text}");
    }
    let row = text.lines().nth(3).unwrap();
    assert!(row.starts_with("btree:sled") && row.contains("8 MiB") && row.contains(&format!("refused: {reason}")));
    assert!(text.lines().nth(4).unwrap().starts_with("btree:sled"), "{text}");
    assert!(text.contains("gyroid.ply (") && text.contains(" triangles)"), "{text}");
}

/// What is stated, what is measured, and the summary of both kinds of cuts.
#[test]
fn stated_errors_against_measured_ones() {
    let place = place_with_meshes();
    place.json("build ball.ply -o ball.vdt");
    let error = "bench error ball.vdt ball.ply --cuts 4 --samples 5000 --memory 64M --scratch .";
    let mut names = place.names();
    let document = place.json(&format!("{error} --plot ratios.svg"));
    names.insert("ratios.svg".into());
    assert_eq!(place.names(), names);
    check_picture(&place, "ratios.svg", &["uniform", "view-dependent", "triangles of the cut", "ball.vdt"]);
    let rows = document["rows"].as_array().unwrap();
    assert_eq!(rows.len() as u64 + whole(&document, "skipped"), 8);
    let input = whole(&document, "input_triangles");
    for row in rows {
        assert!(whole(row, "triangles") > 0 && whole(row, "triangles") <= input, "{row}");
        let [stated, measured] = ["error_stated", "input_to_cut_max"].map(|key| float(row, key));
        assert!(stated > 0.0 && measured > 0.0 && float(row, "cut_to_input_max") > 0.0, "{row}");
        assert!(float(row, "input_to_cut_max_at_most") >= measured, "{row}");
        assert!((float(row, "ratio") * measured / stated - 1.0).abs() < 1e-12, "{row}");
        assert_eq!(row["violation"], measured > stated * (1.0 + 1e-6) + 1e-7 * float(&document, "diagonal"));
    }
    let summary = document["summary"].as_array().unwrap();
    let kinds: Vec<&str> = summary.iter().map(|kind| kind["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["uniform", "view-dependent"]);
    for kind in summary {
        let own: Vec<&Value> = rows.iter().filter(|row| row["kind"] == kind["kind"]).collect();
        assert!(own.len() >= 2 && whole(kind, "cuts") == own.len() as u64, "{document}");
        assert_eq!(whole(kind, "violations"), own.iter().filter(|row| row["violation"] == true).count() as u64);
        let ratios = ["ratio_min", "ratio_median", "ratio_p90", "ratio_max"].map(|key| float(kind, key));
        assert!(ratios.is_sorted(), "{kind}");
        assert!(own.iter().all(|row| (ratios[0]..=ratios[3]).contains(&float(row, "ratio"))), "{kind}");
    }
    // The same again, as text.
    let text = place.run(error).success();
    for heading in ["stated %", "measured %", "ratio", "reverse %", "violation", "median"] {
        assert!(text.contains(heading), "no `{heading}` in {text}");
    }
    assert_eq!(
        text.lines().filter(|line| line.starts_with("uniform")).count(),
        1 + whole(&summary[0], "cuts") as usize
    );

    place.write("old.svg", "precious");
    place.refuses(1, "bench error ball.vdt missing.ply", &["missing.ply", "No such file"]);
    place.refuses(1, "bench error ball.ply ball.ply", &["ball.ply"]);
    place.refuses(1, "bench error ball.vdt ball.vdt", &["ball.vdt", "is a model"]);
    place.refuses(1, "bench error ball.vdt ball.ply --plot old.svg", &["old.svg", "--force"]);
    place.refuses(1, "bench error ball.vdt ball.ply --memory 1M", &["--memory 32M"]);
    place.refuses(1, "bench error ball.vdt ball.ply --scratch nowhere", &["nowhere"]);
    place.refuses(2, "bench error ball.vdt", &["<MESH>"]);
    place.refuses(2, "bench error ball.vdt ball.ply --cuts 0", &["--cuts"]);
}

/// A figure of every frame of a flight, from its CSV file.
fn column(csv: &str, name: &str) -> Vec<u64> {
    let mut lines = csv.lines();
    let place = lines.next().unwrap().split(',').position(|heading| heading == name).unwrap();
    lines.map(|line| line.split(',').nth(place).unwrap().parse().unwrap()).collect()
}

/// The models measured are those that `build` writes, and the flights those of `navigate`.
#[test]
fn blockings_and_what_flights_read() {
    let place = place_with_meshes();
    let flight = "--path orbit:5 --pixels 0.3 --size 800x600 --frame-rate 0";
    let bench = format!(
        "bench blocking ball.ply --scratch . --blocking levels:3..4 --blocking forest:4K..8K,4 {flight} --memory 800K"
    );
    let mut names = place.names();
    let document = place.json(&format!("{bench} --plot reads.svg"));
    names.insert("reads.svg".into());
    assert_eq!(place.names(), names);
    check_picture(&place, "reads.svg", &["ball.ply", "levels", "forest, fan-out 4", "place holder", "read in a frame"]);
    assert_eq!((&document["path"], whole(&document, "memory_bytes")), (&"orbit:5".into(), 800 << 10));
    let rows = document["rows"].as_array().unwrap();
    let blockings: Vec<&str> = rows.iter().map(|row| row["blocking"].as_str().unwrap()).collect();
    assert_eq!(blockings, ["levels:3", "levels:4", "forest:4K,4", "forest:8K,4"]);
    for (row, blocking) in rows.iter().zip(blockings) {
        let build = place.json(&format!("build ball.ply -o ball.vdt --force --blocking {blocking}"));
        for (key, of_build) in [
            ("vertices", "vertices"),
            ("triangles", "triangles"),
            ("pages", "meta_nodes"),
            ("page_levels", "meta_node_levels"),
            ("slot_bytes", "slot_bytes"),
            ("model_bytes", "model_bytes"),
        ] {
            assert_eq!(row[key], build[of_build], "{key}");
        }
        assert!((float(row, "fill_mean") - float(&build, "meta_node_fill")).abs() < 1e-9);
        assert!(float(row, "pages_per_path_mean") <= whole(row, "pages_per_path_max") as f64);
        for (key, memory) in [("in_budget", "800K"), ("all_in_ram", "1G")] {
            let found = &row[key];
            let options = format!("{flight} --memory {memory} --io sync --csv flight.csv --force");
            let flown = place.json(&format!("navigate ball.vdt {options}"));
            for same in ["reads", "bytes_read", "triangles_mean", "second_chances", "place_holders"] {
                assert_eq!(found[same], flown[same], "{same}");
            }
            let csv = String::from_utf8(place.read("flight.csv")).unwrap();
            let pages = column(&csv, "pages_in_use");
            let mean = pages.iter().sum::<u64>() as f64 / pages.len() as f64;
            assert!((float(found, "pages_per_cut_mean") - mean).abs() < 1e-9);
            // Each split bears one vertex, and a ball is one tree.
            let splits: Vec<u64> = column(&csv, "vertices").iter().map(|vertices| vertices - 1).collect();
            let used = whole(found, "records_used");
            assert!((*splits.iter().max().unwrap()..=splits.iter().sum()).contains(&used), "{found}");
            let pages_used = whole(found, "pages_used");
            assert!((*pages.iter().max().unwrap()..=whole(found, "reads")).contains(&pages_used), "{found}");
            let bytes_used = used as f64 * float(row, "record_bytes_mean");
            let [read, needed] = ["bytes_read", "pages_used_bytes"].map(|key| whole(found, key) as f64 / bytes_used);
            assert!((float(found, "bytes_read_over_bytes_used") / read - 1.0).abs() < 1e-9);
            assert!((float(found, "pages_used_bytes_over_bytes_used") / needed - 1.0).abs() < 1e-9 && needed <= read);
            let share = float(found, "records_used_share");
            assert!(share > 0.0 && share <= 1.0, "{found}");
        }
        // Where there is room for all, no page is read twice, and more is drawn.
        assert!(whole(&row["all_in_ram"], "reads") <= whole(row, "pages"));
        assert!(whole(&row["all_in_ram"], "bytes_read") < whole(row, "model_bytes"));
        assert!(float(&row["in_budget"], "triangles_mean") < float(&row["all_in_ram"], "triangles_mean"), "{row}");
        assert!(float(&row["in_time"], "miss_percent") <= 100.0);
    }
    // One frame uses what it shows.
    place.json("build ball.ply -o ball.vdt --force");
    let one = place.json("bench blocking ball.vdt --scratch . --path orbit:1 --frame-rate 0");
    let flown = place.json("navigate ball.vdt --path orbit:1 --io sync --csv flight.csv --force");
    let csv = String::from_utf8(place.read("flight.csv")).unwrap();
    let flight = &one["rows"][0]["in_budget"];
    assert_eq!(one["rows"][0]["blocking"], "forest:16K,8");
    assert_eq!(
        (whole(flight, "records_used"), whole(flight, "pages_used")),
        (column(&csv, "vertices")[0] - 1, column(&csv, "pages_in_use")[0])
    );
    assert_eq!(flight["reads"], flown["reads"]);
}

/// Flights by virtual memory, by our I/O and with all in RAM draw the same, in memory cgroups where there can be any.
#[test]
fn flights_by_virtual_memory_and_by_our_io() {
    let place = place_with_meshes();
    place.json("generate terrain --triangles 200000 -o terrain.ply");
    place.json("build terrain.ply -o terrain.vdt");
    place.json("generate sphere --triangles 80000 -o sphere.ply");
    let flight = "--size 1024x768 --frame-rate 200";
    let bench = format!("bench table2 terrain.vdt sphere.ply --path flyby:25 --memory 1/3,1 --scratch . {flight}");
    let mut names = place.names();
    let document = place.json(&format!("{bench} --path orbit:8 --plot table2.svg"));
    names.insert("table2.svg".into());
    assert_eq!(place.names(), names);
    check_picture(
        &place,
        "table2.svg",
        &[
            "terrain.vdt, flyby:25",
            "sphere.ply, orbit:8",
            "virtual memory, random",
            "our I/O",
            "all in RAM",
            "milliseconds",
        ],
    );
    let has_cgroups = storage::MemoryCgroup::new(64 << 20).is_ok();
    assert_eq!(document["cgroup"], has_cgroups);
    assert_eq!(document["no_cgroup_because"].is_null(), has_cgroups);
    let rows = document["rows"].as_array().unwrap();
    let keys: Vec<_> = rows.iter().map(|row| (row["mesh"].as_str().unwrap(), row["path"].as_str().unwrap())).collect();
    let flights = [
        ("terrain.vdt", "flyby:25"),
        ("terrain.vdt", "orbit:8"),
        ("sphere.ply", "flyby:25"),
        ("sphere.ply", "orbit:8"),
    ];
    let mut distinct = keys.clone();
    distinct.dedup();
    assert_eq!(distinct, flights);
    for (number, row) in rows.iter().enumerate() {
        let (memory, whole_bytes) = (whole(row, "memory_bytes"), whole(row, "in_memory_bytes"));
        assert_eq!(whole(row, "limit_bytes"), memory + (8 << 20));
        assert_eq!(float(row, "memory_share"), memory as f64 / whole_bytes as f64);
        // Of one flight, more memory follows on less, and allows no larger error.
        if let Some(next) = rows
            .get(number + 1)
            .filter(|next| keys[number] == (next["mesh"].as_str().unwrap(), next["path"].as_str().unwrap()))
        {
            assert!(
                memory < whole(next, "memory_bytes") && float(row, "pixels") >= float(next, "pixels"),
                "{document}"
            );
        }
        let runs = &row["runs"];
        let mapped = ["mmap_normal", "mmap_random", "mmap_will_need"].map(|name| &runs[name]);
        let all = mapped.into_iter().chain([&runs["in_memory"], &runs["ours"]]);
        for run in all {
            assert_eq!((&run["killed"], &run["error"]), (&false.into(), &Value::Null), "{run}");
            assert_eq!(float(run, "threshold_factor_max"), 1.0, "{run}");
            assert_eq!(
                run["frames"].as_u64().unwrap(),
                row["path"].as_str().unwrap().split_once(':').unwrap().1.parse::<u64>().unwrap()
            );
        }
        for run in mapped {
            for same in ["triangles_mean", "error_stated", "adapts_mean"] {
                assert_eq!(run[same], runs["in_memory"][same], "{same}");
            }
            assert_eq!((float(run, "miss_percent"), whole(run, "reads")), (0.0, 0));
            if has_cgroups {
                assert!(whole(run, "cgroup_peak_bytes") <= whole(row, "limit_bytes"), "{run}");
            }
        }
        assert!(runs["in_memory"]["cgroup_peak_bytes"].is_null());
        assert!(whole(&runs["ours"], "peak_rss_bytes") <= whole(row, "limit_bytes"), "{row}");
        let times = mapped.map(|run| float(run, "frame_ms_mean"));
        let best = times.into_iter().fold(f64::INFINITY, f64::min);
        let ours = float(&runs["ours"], "frame_ms_mean");
        assert_eq!(
            (float(row, "speed_up_over_best"), float(row, "speed_up_over_default")),
            (best / ours, times[0] / ours)
        );
        assert_eq!(float(&row["frame_ms"], "mmap_best"), best);
        assert_eq!(row["miss_percent"], runs["ours"]["miss_percent"]);
        let more = 100.0 * (float(&runs["ours"], "triangles_mean") / float(&runs["in_memory"], "triangles_mean") - 1.0);
        assert!((float(row, "more_triangles_percent") - more).abs() < 1e-9);
    }

    let text = place.run(&bench).success();
    for heading in
        ["share", "pixels", "adapt", "Virt.", "Ext.", "miss %", "x best", "x default", "will-need", "tris +%"]
    {
        assert!(text.contains(heading), "no `{heading}` in {text}");
    }
    assert!(text.starts_with("terrain.vdt, flyby:25\n") && text.contains("\nsphere.ply, flyby:25\n"), "{text}");
    assert!(text.lines().take(6).all(|line| line.chars().count() <= 110), "{text}");
    assert!(
        text.contains("memory cgroup of its memory and 8 MiB") || !has_cgroups && text.contains("NO MEMORY CGROUP")
    );

    // What is no mesh has its line, and the others theirs.
    let outcome = place.run("bench table2 letter.txt ball.ply --path orbit:2 --memory 4M --scratch . --frame-rate 0");
    assert_eq!((outcome.status.code(), outcome.stderr.as_str()), (Some(1), "vdt: 1 measurement failed\n"));
    assert!(outcome.stdout.contains("letter.txt  failed: ") && outcome.stdout.contains("\nball.ply"), "{outcome:?}");
    assert_eq!(place.names(), names);

    place.write("old.svg", "precious");
    place.refuses(1, "bench table2 missing.vdt", &["missing.vdt", "No such file"]);
    place.refuses(1, "bench table2 ball.ply --plot old.svg", &["old.svg", "--force"]);
    place.refuses(2, "bench table2", &["<MESH|MODEL.vdt>"]);
    place.refuses(2, "bench table2 ball.ply --memory half", &["half", "neither a share"]);
    place.refuses(2, "bench table2 ball.ply --path orbit:x", &["orbit:x"]);
    place.refuses(2, "bench table2 ball.ply --runs 0", &["--runs"]);
}

#[test]
fn blockings_for_people() {
    let place = place_with_meshes();
    let bench = "bench blocking ball.ply box.ply --scratch . --blocking forest:4K,4 --blocking levels:3 --path orbit:3 --frame-rate 0";
    let text = place.run(bench).success();
    for heading in
        ["B/vertex", "fill %", "path", "longest", "KiB/cut", "needed/used", "read/used", "holders", "misses %"]
    {
        assert!(text.lines().any(|line| line.contains(heading)), "no `{heading}` in {text}");
    }
    assert!(
        text.contains("ball.ply: 2,048 triangles, 1,026 vertices") && text.contains("box.ply: 12 triangles"),
        "{text}"
    );
    for blocking in ["forest:4K,4", "levels:3"] {
        assert_eq!(text.lines().filter(|line| line.starts_with(blocking)).count(), 6, "{text}");
    }
    assert!(text.contains("Path orbit:3, 1 pixel(s), 16 MiB of RAM, on "), "{text}");
    assert!(text.lines().take(16).all(|line| line.chars().count() <= 100), "{text}");

    // Too little memory has its line, and is no failure.
    let text = place.run(&format!("{bench} --memory 1K")).success();
    assert!(text.contains("forest:4K,4  refused: ") && text.contains("run again with --memory"), "{text}");
    // What is no mesh has its line, and the others theirs.
    let outcome =
        place.run("bench blocking letter.txt box.ply --scratch . --blocking levels:3 --path orbit:1 --frame-rate 0");
    assert_eq!(
        (outcome.status.code(), outcome.stderr.as_str()),
        (Some(1), "vdt: 1 measurement failed\n"),
        "{outcome:?}"
    );
    assert!(outcome.stdout.contains("letter.txt  failed: ") && outcome.stdout.contains("box.ply: 12 triangles"));

    place.write("old.svg", "precious");
    let names = place.names();
    place.refuses(1, "bench blocking missing.ply", &["missing.ply", "No such file"]);
    place.refuses(1, "bench blocking ball.ply --plot old.svg", &["old.svg", "--force"]);
    place.refuses(1, "bench blocking ball.ply --plot ball.ply --force", &["ball.ply", "would replace"]);
    place.refuses(1, "bench blocking ball.ply --scratch nowhere", &["nowhere"]);
    place.refuses(2, "bench blocking", &["<MESH|MODEL.vdt>"]);
    place.refuses(2, "bench blocking ball.ply --blocking oak", &["oak", "forest:SLOT,K"]);
    place.refuses(2, "bench blocking ball.ply --blocking levels:8..3", &["levels:8..3", "empty"]);
    place.refuses(2, "bench blocking ball.ply --path orbit:0", &["orbit:0"]);
    assert_eq!(place.names(), names);
}

/// A file that no build takes has its line, and the others theirs; then the bench has failed.
#[test]
fn a_build_that_fails_is_told_and_the_others_go_on() {
    let place = place_with_meshes();
    let names = place.names();
    for (arguments, failed, built) in [
        ("bench table1 letter.txt box.ply --scratch .", "letter.txt  failed: ", "vdt: 1 mesh could not be built\n"),
        ("bench io letter.txt --memory 8M,16M --strategy passes --scratch .", "failed: ", "vdt: 2 builds failed\n"),
    ] {
        let outcome = place.run(arguments);
        assert_eq!((outcome.status.code(), outcome.stderr.as_str()), (Some(1), built), "{outcome:?}");
        assert!(
            outcome.stdout.contains(failed) && outcome.stdout.contains("not a mesh in a known format"),
            "{outcome:?}"
        );
        assert_eq!(outcome.stdout.contains("box.ply"), arguments.contains("box.ply"), "{outcome:?}");
    }
    let outcome = place.run("bench table1 letter.txt box.ply --scratch . --json");
    let document: Value = serde_json::from_str(&outcome.stdout).unwrap();
    assert!(document["rows"][0]["error"].as_str().unwrap().contains("letter.txt"));
    assert_eq!(document["rows"][1]["triangles"], 12);
    assert_eq!(place.names(), names);
}

#[test]
fn what_cannot_be_is_refused_before_anything_is_built() {
    let place = place_with_meshes();
    place.write("old.svg", "precious");
    for bench in ["table1", "io"] {
        let refuses =
            |code, rest: &str, says: &[&str]| place.refuses(code, &format!("bench {bench} --scratch . {rest}"), says);
        refuses(1, "missing.ply", &["missing.ply", "No such file"]);
        refuses(1, "ball.ply --plot old.svg", &["old.svg", "--force"]);
        refuses(1, "ball.ply --plot ball.ply --force", &["ball.ply", "would replace"]);
        refuses(1, "ball.ply --plot nowhere/new.svg", &["nowhere"]);
        place.refuses(1, &format!("bench {bench} ball.ply --scratch nowhere"), &["nowhere"]);
        refuses(2, "", &["<MESH>"]);
        refuses(2, "ball.ply --memory 1X", &["1X"]);
        refuses(2, "ball.ply --threads 0", &["--threads"]);
        refuses(2, "ball.ply --strategy oak", &["oak"]);
        refuses(2, "ball.ply --strategy passes:redb", &["passes"]);
    }
    place.refuses(1, "bench table1 box.ply missing.ply --scratch .", &["missing.ply", "No such file"]);
    place.refuses(2, "bench io ball.ply box.ply", &["box.ply"]);
    place.refuses(2, "bench table1 ball.ply --runs 0", &["--runs"]);
    place.refuses(2, "bench table9 ball.ply", &["table9"]);
    place.run("bench table1 box.ply --scratch . --plot old.svg --force").success();
    check_picture(&place, "old.svg", &["box.ply"]);
}

#[test]
fn the_examples_of_the_help_are_right() {
    let place = workplace!();
    for bench in ["table1", "table2", "io", "error", "blocking", "pictures", "uploads"] {
        let help = place.run(&format!("bench {bench} --help")).success();
        let examples: Vec<&str> = help.split_once("Examples:\n").unwrap().1.lines().collect();
        assert!(examples.len() >= 2);
        for example in examples {
            let arguments = example.trim_start().strip_prefix("vdt ").unwrap();
            assert!(arguments.starts_with(&format!("bench {bench} ")), "{arguments}");
            place.refuses(1, arguments, &["No such file"]);
        }
    }
}

/// Each dependency on each model: what is drawn, and how much of it is flipped, for people and for programs.
#[test]
fn dependencies_side_by_side() {
    let place = workplace!();
    place.write("ball.ply", ply(&sphere(5, 0.05, 3), Encoding::LittleEndian, Coordinates::Float));
    place.write("box.ply", ply(&closed_box(), Encoding::Ascii, Coordinates::Double));
    place.json("build ball.ply -o ball.vdt");
    place.json("build box.ply -o box.vdt");
    let bench = "bench dependency ball.vdt box.vdt --path orbit:20 --pixels 4 --memory 64M --every 2";
    let names = place.names();
    let document = place.json(bench);
    assert_eq!(place.names(), names);
    let rows = document["rows"].as_array().unwrap();
    let keys: Vec<_> =
        rows.iter().map(|row| (row["model"].as_str().unwrap(), row["dependency"].as_str().unwrap())).collect();
    let expected = ["ball.vdt", "box.vdt"].map(|model| ["implicit", "flip", "none"].map(|name| (model, name)));
    assert_eq!(keys, expected.as_flattened());
    for row in rows {
        assert_eq!((whole(row, "frames"), whole(row, "frames_looked_at")), (20, 10));
        assert!(float(row, "flipped_mean") <= float(row, "triangles_mean"), "{row}");
        assert!(float(row, "cpu_ms_p50") <= float(row, "cpu_ms_p99"), "{row}");
        assert!(row["dependency"] != "implicit" || row["guaranteed"] == true, "{row}");
    }
    let [implicit, flip, none, ..] = rows.as_slice() else { panic!("{document}") };
    assert!(float(implicit, "triangles_mean") > 100.0, "{document}");
    assert!(float(none, "triangles_mean") <= float(flip, "triangles_mean"), "{document}");
    assert!(float(flip, "flipped_mean") <= float(none, "flipped_mean"), "{document}");
    for key in ["blocked_mean", "forced_mean", "repaired_mean", "unrepaired_mean"] {
        assert_eq!(float(none, key), 0.0);
    }
    assert_eq!((float(implicit, "repaired_mean"), float(implicit, "unrepaired_mean")), (0.0, 0.0));
    let text = place.run(bench).success();
    for heading in ["model", "dependency", "flipped", "repaired", "median"] {
        assert!(text.lines().next().unwrap().contains(heading), "no `{heading}` in {text}");
    }
    assert!(text.lines().nth(2).unwrap().contains("flip"), "{text}");
}

/// A sheet with a border, a closed surface, and many parts with non-manifold edges.
fn place_with_models() -> Workplace {
    let place = workplace!();
    for shape in ["terrain", "sphere", "city"] {
        place.json(&format!("generate {shape} --triangles 20000 --seed 3 -o {shape}.ply"));
        place.json(&format!("build {shape}.ply -o {shape}.vdt"));
    }
    place
}

/// What is drawn looks like the full mesh, and where it does not, that is said.
#[test]
fn pictures_against_the_full_mesh() {
    let place = place_with_models();
    let names = place.names();
    let bench = "bench pictures terrain.vdt sphere.vdt --size 640x360";
    let document = place.json(bench);
    assert_eq!(place.names(), names);
    assert_eq!(document["goals_met"], true, "{document}");
    let rows = document["rows"].as_array().unwrap();
    let viewpoints = ["overview", "orbit 1", "orbit 2", "flyby 1", "flyby 2"];
    let expected = ["terrain.vdt", "sphere.vdt"].map(|model| viewpoints.map(|seen_from| (model, seen_from)));
    let keys: Vec<_> =
        rows.iter().map(|row| (row["model"].as_str().unwrap(), row["seen_from"].as_str().unwrap())).collect();
    assert_eq!(keys, expected.as_flattened());
    for row in rows {
        assert_eq!((&row["settled"], &row["cold_frame"], whole(row, "misses")), (&true.into(), &Value::Null, 0));
        assert!(whole(row, "triangles") < whole(row, "full_triangles") && float(row, "pixels_drawn") <= 1.0, "{row}");
        let likeness = &row["likeness"];
        for key in ["front_to_full", "full_to_front", "outline_to_full", "outline_to_front"] {
            let share = &likeness[key];
            assert!(whole(share, "good") <= whole(share, "points") && float(share, "percent") >= 99.9, "{row}");
        }
        assert!(whole(&likeness["front_to_full"], "points") > 1000, "{row}");
        assert_eq!(["holes", "pinholes", "open_sides"].map(|key| whole(likeness, key)), [0; 3], "{row}");
    }
    // Eight points are too much to be taken for one.
    let coarse = place.json(&format!("{bench} --pixels 8"));
    assert_eq!(coarse["goals_met"], false);
    assert!(float(&coarse["worst_percent"], "full_to_front") < 99.0, "{coarse}");
    assert!(coarse["rows"].as_array().unwrap().iter().all(|row| row["likeness"]["open_sides"] == 0), "{coarse}");
    // The bound is of the way from the full mesh to what is drawn; back, it is where the model was built so.
    place.json("build city.ply -o streets.vdt --error-bound two-sided");
    let streets = place.json("bench pictures city.vdt streets.vdt --size 640x360");
    for row in streets["rows"].as_array().unwrap() {
        let likeness = &row["likeness"];
        assert_eq!(float(&likeness["full_to_front"], "percent"), 100.0, "{row}");
        assert_eq!(["holes", "pinholes", "open_sides"].map(|key| whole(likeness, key)), [0; 3], "{row}");
        let is_two_sided = row["model"] == "streets.vdt";
        assert!(!is_two_sided || float(&likeness["front_to_full"], "percent") == 100.0, "{row}");
    }

    let text = place.run(&format!("{bench} --cameras 1")).success();
    for heading in ["seen from", "near %", "outline %", "holes", "cracks", "open"] {
        assert!(text.lines().next().unwrap().contains(heading), "no `{heading}` in {text}");
    }
    assert!(text.contains("Pictures of 640x360 points at 1 pixel(s), settled"), "{text}");
    place.refuses(1, "bench pictures missing.vdt", &["missing.vdt", "No such file"]);
    place.refuses(1, "bench pictures terrain.ply", &["terrain.ply"]);
    place.refuses(2, "bench pictures", &["<MODEL.vdt>"]);
    place.refuses(2, "bench pictures terrain.vdt --delay 5", &["--cold"]);
    place.refuses(2, "bench pictures terrain.vdt --cameras 0", &["--cameras"]);
}

/// While pages are missing, what is drawn is coarser, but as closed as ever.
#[test]
fn pictures_of_a_cold_start() {
    let place = place_with_models();
    let bench = "bench pictures terrain.vdt city.vdt --size 640x360 --cameras 2 --cold --delay 200";
    let document = place.json(bench);
    assert_eq!((&document["goals_met"], whole(&document, "delay_ms")), (&true.into(), 200), "{document}");
    let rows = document["rows"].as_array().unwrap();
    let frames: Vec<_> = rows.iter().map(|row| whole(row, "cold_frame")).collect();
    assert_eq!(frames, [1, 10, 100].repeat(4));
    for row in rows {
        let likeness = &row["likeness"];
        assert_eq!(["holes", "cracks", "pinholes", "open_sides"].map(|key| whole(likeness, key)), [0; 4], "{row}");
    }
    for start in rows.chunks(3) {
        assert!(whole(&start[0], "misses") > 0 && whole(&start[1], "misses") > 0, "{document}");
        assert!(whole(&start[0], "triangles") < whole(&start[2], "triangles"), "{document}");
    }
    let text = place.run(bench).success();
    assert!(text.contains("misses") && text.contains("each read takes 200 ms more"), "{text}");
}

/// What is uploaded with each frame, against what is different in the mesh.
#[test]
fn uploads_of_a_walk() {
    let place = place_with_models();
    let bench = "bench uploads terrain.vdt city.vdt --walk 200 --size 640x360 --gap 0,8,1000000";
    let names = place.names();
    let document = place.json(bench);
    assert_eq!(place.names(), names);
    let rows = document["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 6);
    for gaps in rows.chunks(3) {
        let all = |key: &str| [0, 1, 2].map(|gap| whole(&gaps[gap], key));
        let bytes = [0, 1, 2].map(|gap| whole(&gaps[gap], "vertex_bytes") + whole(&gaps[gap], "triangle_bytes"));
        assert!(all("frames") == [200; 3] && all("triangles_new")[0] > 0, "{document}");
        assert!(bytes[0] < bytes[1] && bytes[1] < bytes[2], "{document}");
        let ranges = all("ranges");
        assert!(ranges[0] > ranges[1] && ranges[1] > ranges[2] && ranges[2] <= 400, "{document}");
        // All that is new has to be uploaded, and what is gone be crossed out.
        let [row, ..] = gaps else { panic!("{document}") };
        let different = whole(row, "triangles_new") + whole(row, "triangles_gone");
        assert!(whole(row, "triangle_bytes") >= 12 * whole(row, "triangles_new"), "{row}");
        assert!((float(row, "bytes_per_triangle") - bytes[0] as f64 / different as f64).abs() < 1e-9, "{row}");
        assert!(float(row, "bytes_per_triangle") <= 200.0, "{row}");
        assert!(float(row, "bytes_per_triangle_p50") <= float(row, "bytes_per_triangle_max"), "{row}");
    }
    // The same path gives the same figures.
    let path = place.json("bench uploads terrain.vdt --path orbit:30 --gap 0 --size 640x360");
    assert_eq!(path["rows"], place.json("bench uploads terrain.vdt --path orbit:30 --gap 0 --size 640x360")["rows"]);
    assert_eq!((whole(&path["rows"][0], "frames"), &path["path"]), (29, &"Path orbit:30".into()));
    let text = place.run("bench uploads terrain.vdt --walk 20").success();
    for heading in ["new", "gone", "gap", "ranges", "B/tri", "median", "B/new"] {
        assert!(text.lines().next().unwrap().contains(heading), "no `{heading}` in {text}");
    }
    place.refuses(1, "bench uploads missing.vdt", &["missing.vdt", "No such file"]);
    place.refuses(2, "bench uploads", &["<MODEL.vdt>"]);
    place.refuses(2, "bench uploads terrain.vdt --walk 9 --path orbit:9", &["cannot be used with"]);
}

/// A build has begun to make files. (Looks at no more than it must: the build removes files, too.)
fn is_building(place: &Workplace) -> bool {
    let is_begun = |folder: PathBuf| {
        let places = ["build", "scratch"].map(|name| fs::read_dir(folder.join(name)));
        places.into_iter().flatten().any(|mut files| files.next().is_some())
    };
    fs::read_dir(place.folder()).unwrap().any(|entry| is_begun(entry.unwrap().path()))
}

/// Told to stop while a build goes on, the bench ends it and removes what it has made.
#[test]
fn stopped_in_between_nothing_is_left() {
    let place = workplace!();
    place.json("generate terrain --triangles 400000 -o terrain.ply");
    let names = place.names();
    let table1 = "bench table1 terrain.ply --memory 24M --runs 1000 --scratch . --plot times.svg";
    let blocking = "bench blocking terrain.ply --build-memory 24M --scratch . --plot times.svg";
    for (command, signal) in [(table1, "TERM"), (table1, "INT"), (blocking, "TERM")] {
        let words: Vec<&str> = command.split_whitespace().collect();
        let child = place.command(&words).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        let child = child.unwrap();
        let start = Instant::now();
        while !is_building(&place) {
            assert!(start.elapsed() < Duration::from_secs(60), "no build was begun");
            std::thread::sleep(Duration::from_millis(5));
        }
        let sent = Command::new("kill").args(["-s", signal, &child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        let outcome = wait(child, command, |_| ());
        assert_eq!((outcome.status.code(), outcome.stderr.as_str()), (Some(130), "vdt: interrupted\n"), "{outcome:?}");
        assert_eq!(place.names(), names);
    }
}

/// Told to stop while a flight goes on, the bench ends it, and its memory cgroup goes too, where there was one.
#[test]
fn stopped_in_a_flight_nothing_is_left() {
    let place = workplace!();
    place.json("generate sphere --triangles 20000 -o sphere.ply");
    place.json("build sphere.ply -o sphere.vdt");
    let names = place.names();
    let command = "bench table2 sphere.vdt --path orbit:100000 --memory 4M --frame-rate 20 --scratch .";
    // All in RAM is flown first, without a cgroup, and takes too long to wait for; so it is flown fast.
    let fast = "bench table2 sphere.vdt --path orbit:20000 --pixels 50 --memory 4M --frame-rate 4000 --scratch .";
    for (command, waits_for_cgroup) in [(command, false), (fast, storage::MemoryCgroup::new(64 << 20).is_ok())] {
        let words: Vec<&str> = command.split_whitespace().collect();
        let child = place.command(&words).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        let child = child.unwrap();
        let cgroup = |parent: &str| PathBuf::from(parent).join(format!("vdt-{}-0", child.id()));
        let cgroups = ["/sys/fs/cgroup/memory", "/sys/fs/cgroup"].map(cgroup);
        let has_begun = || match waits_for_cgroup {
            true => cgroups.iter().any(|folder| folder.exists()),
            false => place.names().iter().any(|name| name.ends_with("/pages")),
        };
        let start = Instant::now();
        while !has_begun() {
            assert!(start.elapsed() < Duration::from_secs(60), "no flight was begun");
            std::thread::sleep(Duration::from_millis(2));
        }
        let sent = Command::new("kill").args(["-s", "TERM", &child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        let outcome = wait(child, command, |_| ());
        assert_eq!((outcome.status.code(), outcome.stderr.as_str()), (Some(130), "vdt: interrupted\n"), "{outcome:?}");
        assert_eq!(place.names(), names);
        assert!(cgroups.iter().all(|folder| !folder.exists()));
    }
}
