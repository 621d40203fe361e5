//! What the program says of itself and prints: help, JSON, CSV, charts, path files, and the meshes that it generates.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use serde_json::Value;
use vdt_tests::mesh_files::{Coordinates, Encoding, ply, read_ply, surface};
use vdt_tests::program::Workplace;
use vdt_tests::random_mesh::{closed_box, sphere};
use vdt_tests::workplace;

const COMMANDS: [&str; 11] =
    ["demo", "generate", "build", "info", "verify", "extract", "navigate", "render", "view", "compare", "bench"];

fn place_with_ball() -> Workplace {
    let place = workplace!();
    place.write("ball.ply", ply(&sphere(4, 0.05, 3), Encoding::LittleEndian, Coordinates::Float));
    place.json("build ball.ply -o ball.vdt");
    place
}

#[test]
fn help_and_version() {
    let place = workplace!();
    let version = place.run("--version").success();
    assert_eq!(version, format!("vdt {}\n", env!("CARGO_PKG_VERSION")));
    assert_eq!(place.run("-V").success(), version);
    let [short, long] = ["-h", "--help"].map(|option| place.run(option).success());
    for command in COMMANDS {
        for help in [&short, &long] {
            assert!(help.lines().any(|line| line.trim_start().starts_with(&format!("{command} "))), "{help}");
        }
        let [short, long] = ["-h", "--help"].map(|option| place.run(&format!("{command} {option}")).success());
        assert!(short.contains(&format!("Usage: vdt {command}")), "{short}");
        assert!(short.contains("--json"), "{short}");
        assert!(short.lines().count() < long.lines().count());
        // The long help shows how it is done.
        let (_, examples) = long.split_once("Examples:\n").unwrap_or_else(|| panic!("no examples: {long}"));
        assert!(
            examples.contains(&format!("vdt {command} ")) || examples.contains(&format!("vdt {command}\n")),
            "{long}"
        );
        assert_eq!(place.run(&format!("help {command}")).success(), long);
        for line in short.lines().chain(long.lines()).filter(|line| !line.starts_with("Usage: ")) {
            assert!(line.chars().count() <= 120, "{line}");
        }
    }
    assert!(place.contents().is_empty());
}

/// The commands in the examples of the help are commands: each is taken apart without complaint about its options.
#[test]
fn the_examples_of_the_help_are_right() {
    let place = workplace!();
    let mut count = 0;
    for command in COMMANDS {
        let help = place.run(&format!("{command} --help")).success();
        for example in help.split_once("Examples:\n").unwrap().1.lines().filter(|line| line.starts_with("  vdt ")) {
            let arguments = example.trim_start().strip_prefix("vdt ").unwrap();
            // What would work for long is not tried.
            if !["demo", "generate"].contains(&command) {
                // There is no such file, which is only seen once the options are found right.
                place.refuses(1, arguments, &["No such file"]);
            }
            count += 1;
        }
    }
    assert!(count >= 14, "{count} examples");
}

/// With `--json`, before or behind the command, one document is printed and nothing else.
#[test]
fn json_is_one_document_and_nothing_else() {
    let place = place_with_ball();
    for command in [
        "generate gyroid --triangles 500 -o new.ply --force",
        "build ball.ply -o new.vdt --force",
        "build ball.ply -o new.vdt --dry-run",
        "info ball.vdt",
        "info ball.ply",
        "verify ball.vdt",
        "verify ball.vdt --against ball.ply",
        "extract ball.vdt -o new.ply --error 1% --force",
        "extract ball.vdt -o new.ply --triangles 100 --force",
        "extract ball.vdt -o new.ply --camera 3,2,1,0,0,0 --force",
        "navigate ball.vdt --path orbit:10 --io sync",
        "navigate ball.vdt --path flyby:10 --frame-rate 1000 --csv new.csv --force",
        "demo --triangles 2000 --frames 10 -o demo",
    ] {
        let behind = place.run(&format!("{command} --json")).document();
        let before = place.run(&format!("--json {command}")).document();
        let keys = |document: &Value| document.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
        assert_eq!(keys(&behind), keys(&before), "{command}");
        // Without it, people read lines, of the same things, and no JSON.
        let text = place.run(command).success();
        assert!(serde_json::from_str::<Value>(&text).is_err() && text.lines().count() >= 2, "{command}: {text}");
        for key in keys(&behind) {
            let is_plain =
                key.chars().all(|letter| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == '_');
            assert!(is_plain, "{command}: {key}");
        }
    }
}

/// Opening and closing tags fit into each other, there is one outermost element, and attributes are in quotes.
fn assert_is_xml(text: &str) {
    let mut open: Vec<&str> = Vec::new();
    let mut outermost = 0;
    let mut rest = text.trim();
    while let Some(start) = rest.find('<') {
        assert!(!open.is_empty() || rest[..start].trim().is_empty(), "text outside: {:?}", &rest[..start]);
        for (place, _) in rest[..start].match_indices('&') {
            let entity = &rest[place..start];
            assert!(["&lt;", "&gt;", "&amp;", "&quot;", "&apos;", "&#"].iter().any(|known| entity.starts_with(known)));
        }
        let (tag, behind) = rest[start + 1..].split_once('>').expect("a tag ends");
        rest = behind;
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name.trim()));
            continue;
        }
        if tag.starts_with('?') || tag.starts_with('!') {
            continue;
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "<{tag}>");
        let name = tag.split([' ', '/', '\n']).next().unwrap();
        assert!(name.starts_with(|letter: char| letter.is_ascii_alphabetic()), "<{tag}>");
        outermost += usize::from(open.is_empty());
        if !tag.ends_with('/') {
            open.push(name);
        }
    }
    assert!(open.is_empty() && rest.trim().is_empty(), "{open:?} never end");
    assert_eq!(outermost, 1);
}

/// The columns of a flight's figures, and the values by frame; whole numbers all but where a fraction is meant.
fn read_csv(text: &str) -> (Vec<String>, Vec<Vec<f64>>) {
    let mut lines = text.lines();
    let columns: Vec<String> = lines.next().unwrap().split(',').map(str::to_owned).collect();
    let number = |field: &str| field.parse::<f64>().unwrap_or_else(|error| panic!("`{field}`: {error}"));
    let rows: Vec<Vec<f64>> = lines.map(|line| line.split(',').map(number).collect()).collect();
    assert!(rows.iter().all(|row| row.len() == columns.len()));
    (columns, rows)
}

const CSV_COLUMNS: [&str; 35] = [
    "frame",
    "triangles",
    "vertices",
    "splits",
    "collapses",
    "requests",
    "misses",
    "blocked",
    "forced",
    "repaired",
    "unrepaired",
    "over_budget",
    "postponed",
    "morphs",
    "threshold_factor",
    "pixels_drawn",
    "error_stated",
    "guaranteed",
    "vanished_parts",
    "pages_in_use",
    "reads",
    "bytes_read",
    "second_chances",
    "urgent",
    "prefetch_given_up",
    "prefetched",
    "prefetch_used",
    "cancelled",
    "evicted",
    "evicted_wished",
    "evicted_untried",
    "retries",
    "read_failures",
    "frame_ms",
    "cpu_ms",
];

/// The flight of the summary is that of the CSV file, frame by frame.
#[test]
fn a_flight_in_figures() {
    let place = place_with_ball();
    for options in ["--path orbit:37 --io sync", "--path flyby:37 --frame-rate 500", "--path flyby:1"] {
        let said = place.json(&format!("navigate ball.vdt {options} --csv flight.csv --force"));
        let (columns, rows) = read_csv(&String::from_utf8(place.read("flight.csv")).unwrap());
        assert_eq!(columns, CSV_COLUMNS);
        assert_eq!(said["frames"], rows.len());
        assert!(rows.len() == 37 || options.ends_with(":1"));
        let column = |name: &str| -> Vec<f64> {
            let place = columns.iter().position(|column| column == name).unwrap();
            rows.iter().map(|row| row[place]).collect()
        };
        assert!(column("frame").into_iter().eq((0..rows.len()).map(|frame| frame as f64)));
        let close = |key: &str, expected: f64| {
            let found = said[key].as_f64().unwrap();
            // The file has three digits behind the point.
            assert!((found - expected).abs() <= 1e-3 + 1e-6 * expected, "{key}: {found}, by the file {expected}");
        };
        let sum = |name: &str| column(name).iter().sum::<f64>();
        let mean = |name: &str| sum(name) / rows.len() as f64;
        close("triangles_mean", mean("triangles"));
        close("adapts_mean", mean("splits") + mean("collapses"));
        close("frame_ms_mean", mean("frame_ms"));
        close("cpu_ms_mean", mean("cpu_ms"));
        close("miss_percent", 100.0 * sum("misses") / sum("requests").max(1.0));
        let largest = column("error_stated").into_iter().fold(0.0, f64::max);
        assert!((said["error_stated"].as_f64().unwrap() - largest).abs() <= 1e-6 * largest);
        for key in ["second_chances", "urgent"] {
            close(key, sum(key));
        }
        // What is read before the first frame is in the first frame's figures.
        close("reads", sum("reads"));
        close("bytes_read", sum("bytes_read"));
        assert!(sum("reads") >= 1.0 && sum("bytes_read") > 0.0);
        assert!(said["frame_ms_p50"].as_f64().unwrap() <= said["frame_ms_p99"].as_f64().unwrap());
        // Vertices and triangles come and go together.
        assert!(column("triangles").iter().any(|triangles| *triangles > 100.0));
        for row in &rows {
            let value = |name: &str| row[columns.iter().position(|column| column == name).unwrap()];
            assert_eq!(value("requests"), value("splits") + value("collapses") + value("misses"));
        }
    }
}

/// The options of a flight do what they say.
#[test]
fn options_of_a_flight() {
    let place = place_with_ball();
    let triangles_along = |path: &str, options: &str| {
        let flown = place.json(&format!("navigate ball.vdt --path {path}:30 --io sync {options}"));
        flown["triangles_mean"].as_f64().unwrap()
    };
    let triangles = |options: &str| triangles_along("orbit", options);
    let usual = triangles("");
    assert!(triangles("--pixels 0.25") > usual && usual > triangles("--pixels 4"));
    assert!(triangles("--size 640x360") < usual);
    assert!(triangles("--dependency none") <= usual);
    for finer in ["--no-cones", "--silhouettes 4", "--light -1,0,2 --highlights 8"] {
        let count = triangles(finer);
        assert!(count > usual, "{finer}: {count} of {usual}");
    }
    assert!(triangles_along("flyby", "--no-frustum") > triangles_along("flyby", ""));
    for (wrong, says) in [
        ("--silhouettes 0.5", "from 1 to 1000000"),
        ("--light 1,1,1 --highlights none", "from 1 to 1000000"),
        ("--light 0,0,0", "not a direction"),
        ("--highlights 3", "--light"),
    ] {
        place.refuses(2, &format!("navigate ball.vdt --path orbit:30 {wrong}"), &[says]);
    }
    let limited = place.json("navigate ball.vdt --path orbit:30 --io sync --max-triangles 150 --csv limited.csv");
    assert!(limited["triangles_mean"].as_f64().unwrap() <= 150.0);
    let (columns, rows) = read_csv(&String::from_utf8(place.read("limited.csv")).unwrap());
    let most = columns.iter().position(|column| column == "triangles").unwrap();
    assert!(rows.iter().all(|row| row[most] <= 150.0) && rows.iter().any(|row| row[most] > 50.0));
    let small = place.json("navigate ball.vdt --path orbit:30 --io sync --memory 800K");
    assert_eq!(small["budget_bytes"], 800 << 10);
    // At 100 frames a second, 30 frames are due within 0.29 seconds.
    let start = std::time::Instant::now();
    place.json("navigate ball.vdt --path orbit:30 --frame-rate 100");
    assert!(start.elapsed().as_secs_f64() >= 0.29);
}

/// By virtual memory a flight draws what it draws by reads; the file for it is kept where one is named, and checked.
#[test]
fn a_flight_by_virtual_memory() {
    let place = place_with_ball();
    let path = "--path orbit:30 --frame-rate 0 --force --csv";
    place.json(&format!("navigate ball.vdt --io sync {path} sync.csv"));
    let (columns, of_reads) = read_csv(&String::from_utf8(place.read("sync.csv")).unwrap());
    let names = place.names();
    for advice in ["", "--advice normal", "--advice random", "--advice will-need", "--advice populate"] {
        let flown = place.json(&format!("navigate ball.vdt --io mmap {advice} {path} sync.csv"));
        assert_eq!((&flown["reads"], &flown["miss_percent"]), (&0.into(), &0.0.into()));
        assert!(flown["place_holders"].is_null() && flown["decoded_bytes"].as_u64().unwrap() > 1 << 16, "{flown}");
        let (_, rows) = read_csv(&String::from_utf8(place.read("sync.csv")).unwrap());
        for name in ["triangles", "vertices", "splits", "collapses", "error_stated", "pages_in_use"] {
            let column = columns.iter().position(|column| column == name).unwrap();
            let figures = |rows: &[Vec<f64>]| rows.iter().map(|row| row[column]).collect::<Vec<_>>();
            assert_eq!(figures(&rows), figures(&of_reads), "{name}");
        }
        // Nothing is left in the folder, nor anywhere else.
        assert_eq!(place.names(), names);
    }
    let text = place.run(&format!("navigate ball.vdt --io mmap --decoded pages {path} sync.csv")).success();
    assert!(text.contains("what the system keeps of a file of "), "{text}");
    let pages = place.read("pages");
    place.json(&format!("navigate ball.vdt --io mmap --decoded pages {path} sync.csv"));
    assert!(pages == place.read("pages"));

    // Once settled, the first frame of a flight changes nothing.
    place.json(&format!("navigate ball.vdt --settle {path} settled.csv"));
    let (_, rows) = read_csv(&String::from_utf8(place.read("settled.csv")).unwrap());
    let first = |name: &str| rows[0][columns.iter().position(|column| column == name).unwrap()];
    assert_eq!((rows.len(), first("frame"), first("requests"), first("misses")), (30, 0.0, 0.0, 0.0));
    assert!(first("triangles") > 100.0);

    place.write("letter.txt", "Dear reader, this is no file of decoded pages, but it is long enough for one.\n");
    let mut damaged = pages.clone();
    damaged[pages.len() / 2] ^= 1;
    place.write("damaged", damaged);
    place.write("cut", &pages[..pages.len() - 64]);
    let flight = "navigate ball.vdt --path orbit:3";
    for (file, says) in [("letter.txt", "no file of decoded"), ("damaged", "the checksum does not"), ("cut", "it says")]
    {
        place.refuses(1, &format!("{flight} --io mmap --decoded {file}"), &[file, says]);
    }
    place.json("generate sphere --triangles 500 -o other.ply");
    place.json("build other.ply -o other.vdt");
    place.refuses(
        1,
        "navigate other.vdt --path orbit:3 --io mmap --decoded pages",
        &["pages", "another model", "other.vdt"],
    );
    place.refuses(1, &format!("{flight} --io mmap --decoded nowhere/pages"), &["nowhere"]);
    place.refuses(2, &format!("{flight} --advice random"), &["--advice", "--io mmap"]);
    place.refuses(2, &format!("{flight} --io sync --decoded pages"), &["--decoded", "--io mmap"]);
    place.refuses(2, &format!("{flight} --io mmap --advice maybe"), &["maybe", "will-need"]);
}

#[test]
fn path_files() {
    let place = place_with_ball();
    place.write(
        "good.txt",
        "# eye, target, up, field of view\n\n3 0 0  0 0 0  0 0 1  60\n  # in between\n\
         3,0.1,0, 0,0,0, 0,0,1, 60 # with commas\r\n\t3e0 0.2 0 0 0 0 0 0 2 45.5\n\n3 0.3 -0.0 0 0 0 0 1 1 60",
    );
    let flown = place.json("navigate ball.vdt --path good.txt --io sync --csv flight.csv");
    assert_eq!(flown["frames"], 4);
    assert!(flown["triangles_mean"].as_f64().unwrap() > 50.0);

    let camera = "3 0 0  0 0 0  0 0 1  60\n";
    for (text, says) in [
        (format!("{camera}# fine\n\n3 0 0  0 0 0  0 0 1\n"), ["line 4", "ten numbers"]),
        (format!("{camera}{camera}{camera}3 0 0  0 0 0  0 0 1 60 1\n"), ["line 4", "ten numbers"]),
        ("3 0 0  0 0 zero  0 0 1 60\n".into(), ["line 1", "zero"]),
        (format!("{camera}3 0 0  3 0 0  0 0 1 60\n"), ["line 2", "same point"]),
        (format!("{camera}3 0 0  0 0 0  1 0 0 60\n"), ["line 2", "up"]),
        (format!("{camera}3 0 0  0 0 0  0 0 0 60\n"), ["line 2", "up"]),
        (format!("{camera}3 0 0  0 0 0  0 0 1 180\n"), ["line 2", "180"]),
        (format!("{camera}3 0 NaN  0 0 0  0 0 1 60\n"), ["line 2", "finite"]),
        (format!("{camera}3 0 0  0 0 inf  0 0 1 60\n"), ["line 2", "finite"]),
        ("# nothing\n\n  # at all\n".into(), ["no camera", "file"]),
        (String::new(), ["no camera", "file"]),
    ] {
        place.write("bad.txt", text);
        let says = ["bad.txt", says[0], says[1]];
        place.refuses(1, "navigate ball.vdt --path bad.txt", &says);
    }
    place.write("bad.txt", b"3 0 0  0 0 0  0 0 1  60\n\xff\xfe\n");
    place.refuses(1, "navigate ball.vdt --path bad.txt", &["bad.txt", "line 2"]);
}

#[test]
fn a_small_demo() {
    let place = workplace!();
    let said = place.run("demo --triangles 20000 --frames 30 -o made").success();
    let made = ["terrain.ply", "terrain.vdt", "flight.csv", "flight.svg", "flight.png"];
    let mut expected: Vec<String> = made.iter().map(|name| format!("made/{name}")).collect();
    expected.push("made".into());
    expected.sort();
    assert_eq!(place.names().into_iter().collect::<Vec<_>>(), expected);
    assert!(said.contains("20,000 triangles") && said.contains("made/flight.svg"), "{said}");
    assert!(said.contains("peak RAM") && said.contains("misses") && said.contains("done"), "{said}");

    assert_eq!(read_ply(&place.read("made/terrain.ply")).triangles.len(), 20_000);
    place.json("verify made/terrain.vdt --against made/terrain.ply");
    let (columns, rows) = read_csv(&String::from_utf8(place.read("made/flight.csv")).unwrap());
    assert_eq!((columns.as_slice(), rows.len()), (CSV_COLUMNS.map(str::to_owned).as_slice(), 30));
    let chart = String::from_utf8(place.read("made/flight.svg")).unwrap();
    assert_is_xml(&chart);
    assert!(chart.starts_with("<svg") && chart.contains("20,000 triangles in 16 MiB"), "{}", &chart[..200]);
    assert!(chart.matches("<polyline").count() >= 3);
    let picture = image::load_from_memory(&place.read("made/flight.png")).unwrap().to_rgb8();
    assert!(picture.dimensions() == (1280, 720) && picture.pixels().any(|colour| colour != picture.get_pixel(0, 0)));
    for label in ["triangles", "misses", "frame time, ms", "frame"] {
        assert!(chart.contains(label), "{label}");
    }

    // The commands that it names next are right, and it may be run again in the same folder.
    for command in said.lines().filter_map(|line| line.split_once("vdt ").map(|(_, command)| command.trim())) {
        if ["info", "extract"].iter().any(|name| command.starts_with(name)) {
            place.run(command).success();
        }
    }
    assert!(place.names().contains("small.ply"));
    let again = place.json("demo --triangles 10000 --frames 5 -o made");
    assert_eq!((&again["generate"]["triangles"], &again["navigate"]["frames"]), (&10_000.into(), &5.into()));
    assert_eq!(again["build"]["triangles"], 10_000);
    assert_eq!(again["verify"]["same_as_mesh"], true);
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let place = workplace!();
    for shape in ["terrain", "sphere", "gyroid", "city"] {
        let make = |triangles: u64, seed: u64| {
            let said =
                place.json(&format!("generate {shape} --triangles {triangles} --seed {seed} -o mesh.ply --force"));
            let bytes = place.read("mesh.ply");
            let mesh = read_ply(&bytes);
            assert_eq!(said["triangles"], mesh.triangles.len(), "{shape}");
            assert_eq!(said["vertices"], mesh.positions.len(), "{shape}");
            assert_eq!(said["bytes"], bytes.len(), "{shape}");
            (bytes, mesh)
        };
        let (bytes, mesh) = make(2000, 1);
        assert!(bytes == make(2000, 1).0, "{shape}");
        assert!(bytes != make(2000, 2).0, "{shape}");
        let (default, _) = make(2000, 0);
        place.json(&format!("generate {shape} --triangles 2000 -o default.ply --force"));
        assert!(default == place.read("default.ply"), "{shape}: the seed is 0 if none is given");
        // No triangle twice and none without corners: what was asked for is what one gets.
        assert_eq!(surface(&mesh).len(), mesh.triangles.len(), "{shape}");
        for triangles in [10, 11, 57, 1000, 4321] {
            let (_, mesh) = make(triangles, 3);
            let (found, asked) = (mesh.triangles.len() as f64, triangles as f64);
            match shape {
                "terrain" | "city" => assert_eq!(found, asked, "{shape}"),
                _ => assert!((found - asked).abs() <= 1.0 && found <= asked, "{shape}: {found} of {asked}"),
            }
        }
    }
}

/// What a generated shape is said to be, it is: closed or not, in one part or in many.
#[test]
fn generated_shapes_are_what_they_are_called() {
    let place = workplace!();
    let made = |shape: &str| {
        place.json(&format!("generate {shape} --triangles 4000 --seed 2 -o mesh.ply --force"));
        let components = place.json("build mesh.ply -o mesh.vdt --force")["components"].as_u64().unwrap();
        let mesh = read_ply(&place.read("mesh.ply"));
        let mut edges = std::collections::BTreeMap::new();
        for [a, b, c] in &mesh.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *edges.entry((*from.min(to), *from.max(to))).or_insert(0) += if from < to { 1_i64 } else { 1 << 32 };
            }
        }
        let open = edges.values().filter(|runs| **runs == 1 || **runs == 1 << 32).count();
        let regular = edges.values().filter(|runs| **runs == 1 + (1 << 32)).count();
        let euler = mesh.positions.len() as i64 - edges.len() as i64 + mesh.triangles.len() as i64;
        (components, open, edges.len() - open - regular, euler)
    };
    let (components, open, others, euler) = made("sphere");
    assert_eq!((components, open, others, euler), (1, 0, 0, 2));
    let (components, open, others, euler) = made("terrain");
    assert_eq!((components, others, euler), (1, 0, 1));
    assert!(open > 50);
    let (_, open, others, euler) = made("gyroid");
    assert_eq!((open, others), (0, 0));
    assert!(euler <= -10, "{euler}: many handles");
    let (components, open, others, _) = made("city");
    assert!(components > 20 && open > 20 && others > 5, "{components} {open} {others}");
}

/// `info` tells of a mesh what is in the file, and of a model what it was made from and how.
#[test]
fn info_of_both_kinds() {
    let place = workplace!();
    place.write("box.ply", ply(&closed_box(), Encoding::Ascii, Coordinates::Double));
    let mesh = place.json("info box.ply");
    assert_eq!((&mesh["kind"], &mesh["format"]), (&"mesh".into(), &"PLY".into()));
    assert_eq!((&mesh["vertices"], &mesh["faces"], &mesh["triangles"]), (&8.into(), &12.into(), &12.into()));
    assert!((mesh["diagonal"].as_f64().unwrap() - 3.0_f64.sqrt()).abs() < 1e-12);
    place.json("build box.ply -o box.vdt --metric length --strategy btree --error-bound tight --blocking levels:3");
    let model = place.json("info box.vdt");
    assert_eq!((&model["kind"], &model["positions"]), (&"model".into(), &"lossless".into()));
    assert_eq!((&model["metric"], &model["strategy"]), (&"length".into(), &"btree".into()));
    assert_eq!((&model["error_bound"], &model["errors_certified"]), (&"tight".into(), &true.into()));
    assert_eq!(model["blocking"], "levels:3");
    assert_eq!((&model["minimum"], &model["maximum"]), (&mesh["minimum"], &mesh["maximum"]));
    assert_eq!(model["model_bytes"], place.read("box.vdt").len());
    let parts = model["bytes_by_part"].as_object().unwrap();
    assert_eq!(parts.values().map(|bytes| bytes.as_u64().unwrap()).sum::<u64>(), place.read("box.vdt").len() as u64);
}
