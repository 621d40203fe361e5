//! Pictures that the program draws, point by point.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::collections::BTreeSet;

use image::RgbImage;
use vdt_tests::mesh_files::{Coordinates, Encoding, ply};
use vdt_tests::program::Workplace;
use vdt_tests::random_mesh::sphere;
use vdt_tests::workplace;

/// A ball of radius 1 about a place.
fn place_with_ball(middle: [f64; 3]) -> Workplace {
    let place = workplace!();
    let mut ball = sphere(5, 0.0, 3);
    ball.positions.iter_mut().for_each(|position| (0..3).for_each(|axis| position[axis] += middle[axis]));
    place.write("ball.ply", ply(&ball, Encoding::LittleEndian, Coordinates::Double));
    place.json("build ball.ply -o ball.vdt");
    place
}

fn picture(place: &Workplace, name: &str) -> RgbImage {
    image::load_from_memory(&place.read(name)).unwrap().to_rgb8()
}

/// What is drawn where there is nothing.
const BACKGROUND: [u8; 3] = [30, 32, 38];

/// The points that are not background.
fn points_of_model(picture: &RgbImage) -> Vec<(u32, u32)> {
    let drawn = picture.enumerate_pixels().filter(|(.., colour)| colour.0 != BACKGROUND);
    drawn.map(|(x, y, _)| (x, y)).collect()
}

#[test]
fn a_ball_is_a_disc() {
    let place = place_with_ball([0.0; 3]);
    let said = place.json("render ball.vdt -o ball.png --camera 5,0,0,0,0,0 --size 300x200 --pixels 0.25");
    let drawn = picture(&place, "ball.png");
    assert_eq!(drawn.dimensions(), (300, 200));
    let points = points_of_model(&drawn);
    assert_eq!(said["points_drawn"], points.len());
    assert_eq!((&said["settled"], &said["renderer"], &said["pictures"]), (&true.into(), &"software".into(), &1.into()));
    assert!(said["pixels_drawn"].as_f64().unwrap() <= 0.25 && said["triangles"].as_u64().unwrap() > 1000);
    // Its outline is a circle whose radius, at distance 5, is the tangent of the angle with the sine 1/5; half the picture is
    // that of 30 degrees.
    let radius = 100.0 / 24.0_f64.sqrt() / 30.0_f64.to_radians().tan();
    let from_middle = |(x, y): (u32, u32)| (f64::from(x) + 0.5 - 150.0).hypot(f64::from(y) + 0.5 - 100.0);
    assert!(points.iter().all(|point| from_middle(*point) < radius + 0.5));
    let inside = (0..300 * 200).map(|at| (at % 300, at / 300)).filter(|point| from_middle(*point) < radius - 1.0);
    let points: BTreeSet<_> = points.into_iter().collect();
    assert!(inside.into_iter().all(|point| points.contains(&point)), "there is a hole");
    // The light comes from the upper left.
    let light = |x, y| drawn.get_pixel(x, y).0.iter().map(|part| u32::from(*part)).sum::<u32>();
    assert!(light(140, 90) > light(160, 110) && light(160, 110) > light(0, 0));
}

#[test]
fn the_same_picture_on_every_run_and_wherever_the_mesh_lies() {
    let (place, far) = (place_with_ball([0.0; 3]), place_with_ball([1e6, 1e6, 0.0]));
    for options in ["--size 200x150", "--size 150x200 --edges", "--size 200x150 --path flyby:9 --frame 7 --memory 8M"] {
        for name in ["one.png", "other.png"] {
            place.json(&format!("render ball.vdt -o {name} --force {options}"));
        }
        assert_eq!(place.read("one.png"), place.read("other.png"), "{options}");
        far.json(&format!("render ball.vdt -o far.png --force {options}"));
        let (near, far) = (picture(&place, "one.png"), picture(&far, "far.png"));
        assert!(points_of_model(&near).len() > 2000, "{options}");
        // Coordinates have other roundings there, by less than a ten-millionth; so may a point at an outline.
        let differing = near.pixels().zip(far.pixels());
        let differing =
            differing.filter(|(one, other)| (0..3).any(|part| one.0[part].abs_diff(other.0[part]) > 8)).count();
        assert!(differing < 150, "{options}: {differing} points");
    }
    let (plain, edges) = (picture(&place, "one.png"), {
        place.json("render ball.vdt -o edges.png --size 200x150 --path flyby:9 --frame 7 --memory 8M --edges");
        picture(&place, "edges.png")
    });
    assert!(points_of_model(&plain) == points_of_model(&edges) && plain != edges);
}

#[test]
fn all_of_a_model_is_seen_where_nothing_else_is_asked_for() {
    let place = place_with_ball([3.0, 4.0, 5.0]);
    for (width, height) in [(300, 200), (100, 300), (1, 1)] {
        let said = place.json(&format!("render ball.vdt -o all.png --force --size {width}x{height}"));
        if width == 1 {
            assert_eq!(said["points_drawn"], 1);
            continue;
        }
        let points = points_of_model(&picture(&place, "all.png"));
        assert!(points.iter().all(|(x, y)| (1..width - 1).contains(x) && (1..height - 1).contains(y)));
        let across = points.iter().map(|(x, _)| x).max().unwrap() - points.iter().map(|(x, _)| x).min().unwrap();
        assert!(across > width.min(height) / 2, "{across} of {width}x{height}");
    }
}

#[test]
fn a_film_is_a_folder() {
    let place = place_with_ball([0.0; 3]);
    let said = place.json("render ball.vdt -o film --path orbit:3 --size 80x60 --settle");
    assert_eq!(said["pictures"], 3);
    let names = ["000000.png", "000001.png", "000002.png"];
    let frames = names.map(|name| picture(&place, &format!("film/{name}")));
    assert!(frames.iter().all(|frame| points_of_model(frame).len() > 100));
    assert_ne!(frames[0], frames[1]);
    place.json("render ball.vdt -o single.png --path orbit:3 --frame 1 --size 80x60 --settle");
    assert_eq!(picture(&place, "single.png"), frames[1]);
    // With geomorphs, the same front is on its way to where it is without.
    let [plain, morphed] = [0, 4].map(|geomorph| {
        place.json(&format!(
            "render ball.vdt -o way.png --force --path flyby:40 --frame 12 --size 80x60 --geomorph {geomorph}"
        ));
        picture(&place, "way.png")
    });
    assert_ne!(plain, morphed);
    place.refuses(1, "render ball.vdt -o film --path orbit:3", &["film: there is something in the folder", "--force"]);
    place.json("render ball.vdt -o film --path orbit:3 --size 80x60 --force");
}

#[test]
fn what_cannot_be_drawn_is_refused() {
    let place = place_with_ball([0.0; 3]);
    place.write("there.png", b"mine");
    place.refuses(1, "render ball.vdt -o there.png", &["there.png: the file exists already", "--force"]);
    assert_eq!(place.read("there.png"), b"mine");
    place.refuses(1, "render ball.vdt -o there.png --path orbit:3", &["there.png: this is a file", "--frame"]);
    place.refuses(1, "render ball.vdt -o a.png --path orbit:3 --frame 3", &["the path has 3 frames", "no frame 3"]);
    place.refuses(1, "render ball.vdt -o a.jpg", &["a.jpg: pictures are PNG files"]);
    place.refuses(1, "render ball.vdt -o no/a.png", &["there is no directory no"]);
    place.refuses(1, "render ball.ply -o a.png", &["ball.ply"]);
    place.refuses(1, "render absent.vdt -o a.png", &["absent.vdt"]);
    place.refuses(1, "render ball.vdt -o a.png --size 60000x60000", &["60000x60000", "more --memory"]);
    let said = place.refuses(1, "render ball.vdt -o a.png --memory 28M", &["too few for this model and the picture"]);
    let (_, needed) = said.trim_end().rsplit_once("--memory ").unwrap();
    place.json(&format!("render ball.vdt -o enough.png --memory {needed}"));
    place.refuses(1, "render ball.vdt -o a.png --camera 1,1,1,1,1,1", &["--camera", "same point"]);
    place.refuses(2, "render ball.vdt", &["--output"]);
    place.refuses(2, "render ball.vdt -o a.png --frame 3", &["--path"]);
    place.refuses(2, "render ball.vdt -o a.png --camera 0,0,9,0,0,0 --path orbit:3", &["cannot be used with"]);
    assert!(!place.path("a.png").exists());
}

/// Nothing, a point, a triangle: a model of any mesh has a picture.
#[test]
fn small_meshes_have_pictures() {
    let place = workplace!();
    let header = |vertices: u32, faces: u32| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    for (name, text, is_seen) in [
        ("point", header(1, 0) + "1 2 3\n", false),
        ("triangle", header(3, 1) + "0 0 0\n1 0 0\n0 0 1\n3 0 1 2\n", true),
    ] {
        place.write(&format!("{name}.ply"), text);
        place.json(&format!("build {name}.ply -o {name}.vdt"));
        let said = place.json(&format!("render {name}.vdt -o {name}.png --size 40x30"));
        assert_eq!(said["points_drawn"].as_u64().unwrap() > 50, is_seen, "{name}");
        assert_eq!(picture(&place, &format!("{name}.png")).dimensions(), (40, 30));
    }
}
