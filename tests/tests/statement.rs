//! What the program says of how far the input is from a surface: measured, point by point, on surfaces that it wrote.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::collections::{HashMap, HashSet};

use serde_json::Value;
use vdt_tests::mesh_files::{Coordinates, Encoding, ply, read_ply};
use vdt_tests::program::Workplace;
use vdt_tests::random_mesh::{Random, RawMesh, closed_box, sheet, sphere};
use vdt_tests::workplace;

type Point = [f64; 3];

fn minus(left: Point, right: Point) -> Point {
    [0, 1, 2].map(|axis| left[axis] - right[axis])
}

fn dot(left: Point, right: Point) -> f64 {
    (0..3).map(|axis| left[axis] * right[axis]).sum()
}

/// The distance from a point to a triangle: the least of those to its edges and, above its inside, to its plane.
fn distance(point: Point, triangle: [Point; 3]) -> f64 {
    let along = |from: Point, to: Point| {
        let (edge, way) = (minus(to, from), minus(point, from));
        let share = (dot(way, edge) / dot(edge, edge).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        let rest = minus(way, edge.map(|component| component * share));
        dot(rest, rest).sqrt()
    };
    let [a, b, c] = triangle;
    let nearest = along(a, b).min(along(b, c)).min(along(c, a));
    let (u, v, w) = (minus(b, a), minus(c, a), minus(point, a));
    let (uu, uv, vv, wu, wv) = (dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v));
    let area = uu * vv - uv * uv;
    let (s, t) = ((wu * vv - wv * uv) / area, (wv * uu - wu * uv) / area);
    if !(area > 0.0 && s >= 0.0 && t >= 0.0 && s + t <= 1.0) {
        return nearest;
    }
    let rest = [0, 1, 2].map(|axis| w[axis] - s * u[axis] - t * v[axis]);
    nearest.min(dot(rest, rest).sqrt())
}

/// A mesh as triangles over places, and the part (connected over equal positions) that each place is in.
struct Parts {
    triangles: Vec<[Point; 3]>,
    part_of: HashMap<[u64; 3], usize>,
}

fn key(position: Point) -> [u64; 3] {
    position.map(|value| (value + 0.0).to_bits())
}

fn placed(mesh: &RawMesh) -> Vec<[Point; 3]> {
    mesh.triangles.iter().map(|corners| corners.map(|corner| mesh.positions[corner as usize])).collect()
}

impl Parts {
    fn of(mesh: &RawMesh) -> Self {
        let triangles = placed(mesh);
        let mut part_of: HashMap<[u64; 3], usize> = HashMap::new();
        for (number, corners) in triangles.iter().enumerate() {
            let there: HashSet<usize> =
                corners.iter().filter_map(|corner| part_of.get(&key(*corner)).copied()).collect();
            part_of.values_mut().filter(|part| there.contains(part)).for_each(|part| *part = number);
            corners.iter().for_each(|corner| {
                part_of.insert(key(*corner), number);
            });
        }
        Parts { triangles, part_of }
    }

    fn part(&self, corners: &[Point; 3]) -> usize {
        self.part_of[&key(corners[0])]
    }

    fn count(&self) -> usize {
        self.part_of.values().collect::<HashSet<_>>().len()
    }
}

fn number(said: &Value, key: &str) -> f64 {
    said[key].as_f64().unwrap_or_else(|| panic!("{key} in {said}"))
}

/// Some points of a triangle.
fn points_of(corners: [Point; 3]) -> impl Iterator<Item = Point> {
    let weights = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.5, 0.0], [0.3, 0.3, 0.4]];
    weights
        .into_iter()
        .map(move |weights| [0, 1, 2].map(|axis| (0..3).map(|corner| weights[corner] * corners[corner][axis]).sum()))
}

/// What was said of the mesh in `cut.ply` is true of points of the input, those of parts that are not in it and the others.
/// How many parts have vanished.
fn check(place: &Workplace, parts: &Parts, said: &Value, title: &str) -> usize {
    let cut = placed(&read_ply(&place.read("cut.ply")));
    let drawn: HashSet<usize> = cut.iter().map(|corners| parts.part(corners)).collect();
    let vanished = parts.count() - drawn.len();
    assert_eq!(said["vanished_parts"], vanished, "{title}: {said}");
    assert_eq!(said["triangles"], cut.len(), "{title}");
    if cut.is_empty() {
        assert_eq!((&said["guaranteed"], &said["vanished_distance"]), (&false.into(), &Value::Null), "{title}: {said}");
        return vanished;
    }
    let (stated, told) = (number(said, "error_stated"), number(said, "vanished_distance"));
    assert_eq!(stated, told.max(number(said, "error_drawn")), "{title}: {said}");
    let diameter = number(said, "vanished_diameter");
    let coordinates = parts.triangles.iter().flatten().flatten();
    let widest_coordinate = coordinates.fold(0.0_f64, |widest, value| widest.max(value.abs()));
    let (mut farthest, mut to_vertices, mut extents) = (0.0_f64, 0.0_f64, HashMap::new());
    for corners in &parts.triangles {
        for point in points_of(*corners) {
            let nearest = cut.iter().map(|triangle| distance(point, *triangle)).fold(f64::INFINITY, f64::min);
            // The slack is for the rounding of the distances here.
            let is_true = nearest <= stated * (1.0 + 1e-9) + 1e-12 * widest_coordinate;
            assert!(is_true || said["guaranteed"] == false, "{title}: {point:?} is {nearest} away, {said}");
            if drawn.contains(&parts.part(corners)) {
                continue;
            }
            farthest = farthest.max(nearest);
            let vertices = cut.iter().flatten().map(|vertex| dot(minus(point, *vertex), minus(point, *vertex)));
            to_vertices = to_vertices.max(vertices.fold(f64::INFINITY, f64::min).sqrt());
            let extent = extents.entry(parts.part(corners)).or_insert((point, 0.0_f64));
            extent.1 = extent.1.max(dot(minus(point, extent.0), minus(point, extent.0)).sqrt());
        }
    }
    assert!(farthest <= told && told <= to_vertices + diameter, "{title}: {farthest} away, {said}");
    let widest = extents.values().map(|(_, extent)| *extent).fold(0.0, f64::max);
    assert!(widest <= diameter && diameter <= 2.0 * widest, "{title}: {widest} across, {said}");
    vanished
}

/// Boxes of very different sizes, strewn about a sheet, which is the last to go.
fn boxes(count: usize) -> RawMesh {
    let mut random = Random(5);
    let mut mesh = sheet(12, 12, 0.3, 3, 2);
    for _ in 0..count {
        let size = 0.02 * 80_f64.powf(random.signed().abs());
        let mut part = closed_box();
        part.positions.iter_mut().flatten().for_each(|value| *value *= size);
        mesh.append(&part, [0, 1, 2].map(|axis| 6.0 + 20.0 * random.signed() + f64::from(axis)));
    }
    mesh.in_single_precision()
}

#[test]
fn parts_that_vanish_are_no_farther_than_is_said() {
    let place = workplace!();
    place.json("generate city --triangles 1500 -o city.ply");
    place.write("boxes.ply", ply(&boxes(90), Encoding::LittleEndian, Coordinates::Float));
    for name in ["city", "boxes"] {
        place.json(&format!("build --positions lossless {name}.ply -o {name}.vdt"));
        let info = place.json(&format!("info {name}.vdt"));
        let parts = Parts::of(&read_ply(&place.read(&format!("{name}.ply"))));
        assert_eq!(info["components"], parts.count());
        let mut counts = Vec::new();
        for percent in [0.0, 0.3, 1.0, 3.0, 6.0, 12.0, 101.0] {
            let title = format!("{name} --error {percent}%");
            let said = place.json(&format!("extract {name}.vdt -o cut.ply --force --error {percent}%"));
            counts.push(check(&place, &parts, &said, &title));
            let asked_for = number(&info, "diagonal") * percent / 100.0;
            assert!(number(&said, "error_drawn") <= asked_for, "{title}: {said}");
        }
        assert_eq!(counts[0], 0);
        assert!(counts.is_sorted() && counts.iter().collect::<HashSet<_>>().len() > 4, "{name}: {counts:?}");
        assert_eq!(*counts.last().unwrap(), parts.count());

        for (camera, pixels) in [("60,50,40,6,6,6", 4), ("60,50,40,6,6,6", 40), ("7,7,7,6,6,0", 25)] {
            let title = format!("{name} --camera {camera} --pixels {pixels}");
            let said =
                place.json(&format!("extract {name}.vdt -o cut.ply --force --camera {camera} --pixels {pixels}"));
            let vanished = check(&place, &parts, &said, &title);
            assert_eq!(said["guaranteed"], info["errors_certified"], "{title}");
            assert!(vanished > 0 || pixels < 40, "{title}: {said}");
        }
        let flown = place.json(&format!("navigate {name}.vdt --path orbit:12 --io sync --pixels 40"));
        let most = flown["vanished_parts_max"].as_u64().unwrap();
        assert!(most > 0 && most <= parts.count() as u64, "{flown}");
    }
}

#[test]
fn what_is_said_in_words() {
    let place = workplace!();
    place.write("boxes.ply", ply(&boxes(40), Encoding::LittleEndian, Coordinates::Float));
    let line = |arguments: &str, label: &str| -> Option<String> {
        let said = place.run(arguments).success();
        said.lines().find(|line| line.starts_with(label)).map(|line| line[label.len()..].trim().to_owned())
    };
    let extract = |cut: &str, label: &str| line(&format!("extract m.vdt -o cut.ply --force {cut}"), label);
    let fly = |options: &str, label: &str| line(&format!("navigate m.vdt --path orbit:3 --io sync {options}"), label);

    place.json("build --positions lossless boxes.ply -o m.vdt --error-bound none");
    assert_eq!(place.json("info m.vdt")["errors_certified"], false);
    assert!(line("info m.vdt", "errors").unwrap().ends_with("the metric's estimates, not certified bounds"));
    let estimate = "by the metric's estimate (not guaranteed); build with --error-bound default";
    assert!(extract("--error 2%", "error").unwrap().ends_with(estimate));
    assert!(fly("--pixels 30", "error").unwrap().ends_with(estimate));
    assert_eq!(extract("--error 0", "error").unwrap(), "none: this is the mesh itself");
    assert_eq!(extract("--error 0", "vanished"), None);
    let nothing = extract("--error 200%", "error").unwrap();
    assert!(
        nothing.starts_with("nothing is drawn, so there is no distance to it: the last of the 41 parts"),
        "{nothing}"
    );

    for error_bound in ["fast", "default", "tight", "two-sided"] {
        place.json(&format!("build --positions lossless boxes.ply -o m.vdt --force --error-bound {error_bound}"));
        assert!(
            line("info m.vdt", "errors").unwrap().ends_with(&format!("certified bounds, error bound {error_bound}"))
        );
        let said = extract("--error 2%", "error").unwrap();
        let within = said.strip_prefix("guaranteed: every point of the input lies within ").unwrap();
        let two_sided = error_bound == "two-sided";
        let rest = if two_sided {
            " of this surface, and every point of the surface within that of the input"
        } else {
            " of this surface"
        };
        let within: f64 = within.strip_suffix(rest).unwrap().parse().unwrap();
        let document = place.json("extract m.vdt -o cut.ply --force --error 2%");
        assert_eq!((&document["guaranteed"], &document["error_bound"]), (&true.into(), &error_bound.into()));
        assert_eq!(document["two_sided"], two_sided);
        let stated = number(&document, "error_stated");
        assert!(within >= stated && within < stated * 1.001, "{within} {stated}");
        let vanished = extract("--error 2%", "vanished").unwrap();
        assert!(vanished.starts_with(&format!("{} parts not drawn", document["vanished_parts"])), "{vanished}");
        assert!(
            fly("--pixels 30", "error").unwrap().ends_with("in the picture, guaranteed for the parts that are drawn")
        );
        assert!(fly("--pixels 30", "vanished").unwrap().contains(" of 41 parts are not drawn"));
        let mixed = fly("--pixels 30 --dependency none", "error").unwrap();
        assert!(
            mixed.ends_with("not guaranteed: the cut mixes levels without the dependency (docs/error.md)"),
            "{mixed}"
        );
        let flown = ["implicit", "none"].map(|dependency| {
            place.json(&format!("navigate m.vdt --path orbit:3 --io sync --pixels 30 --dependency {dependency}"))
        });
        assert_eq!(flown.map(|flown| flown["guaranteed"].as_bool().unwrap()), [true, false]);
    }
    assert_eq!(extract("--error 0", "error").unwrap(), "none: this is the mesh itself");
}

/// Coordinates that single precision does not hold, in two orders of the file and two memories.
#[test]
fn what_was_lost_on_the_way_in_is_said() {
    let place = workplace!();
    let mut mesh = sphere(3, 0.1, 8);
    mesh.positions.iter_mut().flatten().for_each(|value| *value = *value * 0.1 + 700.3);
    place.write("mesh.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Double));
    place.write("other.ply", ply(&mesh.shuffled(4), Encoding::Ascii, Coordinates::Double));
    let built = place.json("build --positions lossless mesh.ply -o m.vdt");
    let other = place.json("build --positions lossless other.ply -o other.vdt --memory 16M --threads 2");
    assert_eq!(built["model_sha256"], other["model_sha256"]);
    let info = place.json("info m.vdt");
    let origin = [0, 1, 2].map(|axis| info["origin"][axis].as_f64().unwrap());
    let steps = mesh.positions.iter().map(|position| {
        let step = [0, 1, 2].map(|axis| {
            let local = position[axis] - origin[axis];
            local - f64::from(local as f32)
        });
        dot(step, step).sqrt()
    });
    let largest = steps.fold(0.0, f64::max);
    let told = number(&built, "input_error");
    assert!(largest > 0.0 && told >= largest && told <= largest * 1.000_001, "{told} {largest}");
    assert_eq!(info["input_error"], built["input_error"]);
    for text in
        [place.run("info m.vdt").success(), place.run("build --positions lossless mesh.ply -o m.vdt --force").success()]
    {
        assert!(text.lines().any(|line| line.starts_with("input error ")), "{text}");
    }

    let whole = place.json("extract m.vdt -o whole.ply --error 0");
    assert_eq!((&whole["guaranteed"], &whole["error_stated"]), (&true.into(), &info["input_error"]));
    let text = place.run("extract m.vdt -o whole.ply --error 0 --force").success();
    assert!(text.contains("guaranteed: every point of the input lies within "), "{text}");
    // What has been in single precision once loses nothing more.
    let again = place.json("build --positions lossless whole.ply -o again.vdt");
    assert_eq!(again["input_error"], 0.0);
    assert!(!place.run("info again.vdt").success().contains("input error"));
}
