//! `vdt bench soak`: a walk over a disk that fails, with everything checked; what it says, and what it refuses.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::process::{Command, Stdio};
use std::time::Duration;

use serde_json::Value;
use vdt_tests::program::{Workplace, wait};
use vdt_tests::workplace;

fn place_with_model() -> Workplace {
    let place = workplace!();
    place.run("generate terrain --triangles 20000 --seed 3 -o terrain.ply").success();
    place.run("build terrain.ply -o terrain.vdt").success();
    place
}

fn whole(document: &Value, key: &str) -> u64 {
    document[key].as_u64().unwrap_or_else(|| panic!("no `{key}` in {document}"))
}

#[test]
fn a_walk_over_a_disk_that_fails_breaks_nothing() {
    let place = place_with_model();
    for (dependency, memory) in [("implicit", "1400K"), ("none", "1400K"), ("implicit", "16M")] {
        let found = place.json(&format!(
            "bench soak terrain.vdt --seconds 2.5 --frame-rate 0 --memory {memory} --faults 5 --delay 2 --outage 50 \
             --check-every 100 --dependency {dependency}"
        ));
        assert_eq!(whole(&found, "violations"), 0, "{found}");
        assert_eq!(whole(&found, "stops_unsettled"), 0, "{found}");
        for key in ["frames", "jumps", "stops", "checks", "retries", "reads", "outages", "rss_peak_bytes"] {
            assert!(whole(&found, key) > 0, "{key}: {found}");
        }
        assert!(found["settled_seconds_max"].as_f64().unwrap() > 0.0, "{found}");
        let limited = memory != "16M";
        assert_eq!(whole(&found, "raised_frames") > 0, limited, "{found}");
        if dependency == "none" {
            assert_eq!(whole(&found, "missing_splits"), 0, "{found}");
        }
    }
}

#[test]
fn for_people_and_until_it_is_interrupted() {
    let place = place_with_model();
    let text = place.run("bench soak terrain.vdt --seconds 1 --faults 0 --outage 0").success();
    for word in ["walk", "checks", "0 violations", "settled", "fresh start", "0 tried again", "0 outages"] {
        assert!(text.contains(word), "no `{word}` in {text}");
    }
    let mut command = place.command(&["bench", "soak", "terrain.vdt", "--seconds", "1000", "--json"]);
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    std::thread::sleep(Duration::from_secs(2));
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let document = wait(child, "bench soak, interrupted", |_| ()).document();
    let seconds = document["seconds"].as_f64().unwrap();
    assert!((0.5..60.0).contains(&seconds) && whole(&document, "frames") > 10, "{document}");
}

#[test]
fn what_cannot_be_is_refused() {
    let place = workplace!();
    place.write("letter.vdt", "Dear reader,\n");
    place.refuses(1, "bench soak letter.vdt", &["letter.vdt"]);
    place.refuses(1, "bench soak absent.vdt", &["absent.vdt"]);
    place.refuses(2, "bench soak letter.vdt --faults 101", &["101", "0 to 100"]);
    place.refuses(2, "bench soak letter.vdt --seconds 0", &["seconds above 0"]);
}
