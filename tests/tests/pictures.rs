//! Pictures by a graphics driver and by the processor: against each other, and against what they looked like before.
//!
//! The driver may be any, lavapipe for one (`mesa-vulkan-drivers`), which `.ci/run` installs. After an intended change of what
//! pictures look like, `VDT_WRITE_REFERENCES=1 cargo test --release -p vdt-tests --test pictures` writes the references anew.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

use image::{ImageFormat, Rgb, RgbImage};
use metanode::model::Model;
use navigator::path::overview;
use navigator::{Camera, Io, Navigator, NavigatorOptions, PathSpec};
use render::gpu::{Drivers, Gpu, GpuError, OffScreen, Scene, SceneOptions, SceneView};
use render::{Looks, Picture, Projection, Room, Style};
use storage::LocalDisk;
use vdt_tests::mesh_files::{Coordinates, Encoding, glb, ply};
use vdt_tests::program::Workplace;
use vdt_tests::random_mesh::{Random, sheet, sphere, torus};
use vdt_tests::workplace;

/// Least likeness of pictures that are to look the same: 1 for the same points.
const ALIKE: f64 = 0.985;
/// The same of pictures of lines.
const ALIKE_LINES: f64 = 0.96;

/// A wavy sheet, with all that corners can carry: three materials, an image torn apart in its middle.
fn write_textured(place: &Workplace) {
    const SIDE: usize = 24;
    let mut text = String::from("mtllib sheet.mtl\n");
    for number in 0..SIDE * SIDE {
        let (x, y) = ((number % SIDE) as f64, (number / SIDE) as f64);
        writeln!(text, "v {x} {y} {}", 2.0 * (x / 4.0).sin() + (y / 3.0).cos()).unwrap();
        for shift in [0.0, 0.5] {
            writeln!(text, "vt {} {}", x / 32.0 + shift, y / 16.0).unwrap();
        }
    }
    for number in 0..(SIDE - 1) * (SIDE - 1) {
        let (x, y) = (number % (SIDE - 1), number / (SIDE - 1));
        let right = usize::from(x >= SIDE / 2);
        let corner = |x: usize, y: usize| format!("{}/{}", y * SIDE + x + 1, 2 * (y * SIDE + x) + right + 1);
        writeln!(text, "usemtl {}", ["red", "board", "board", "plain"][(x / 6 + y / 6) % 4]).unwrap();
        let corners = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
        writeln!(text, "f {}", corners.join(" ")).unwrap();
    }
    place.write("textured.obj", text);
    place.write("sheet.mtl", "newmtl red\nKd 0.9 0.1 0.2\nnewmtl board\nKd 1 1 1\nmap_Kd board.png\nnewmtl plain\n");
    // An arrow would tell what is up: the upper half is darker, the left half is blue.
    let board = RgbImage::from_fn(48, 32, |x, y| {
        let light = if y < 16 { 120 } else { 240 };
        let dark = if (x / 4 + y / 4) % 2 == 0 { 40 } else { 100 };
        if x < 24 { Rgb([dark, dark, light]) } else { Rgb([light, light / 2, dark]) }
    });
    let mut bytes = std::io::Cursor::new(Vec::new());
    board.write_to(&mut bytes, ImageFormat::Png).unwrap();
    place.write("board.png", bytes.into_inner());
}

/// A ball whose vertices have colours.
fn write_coloured(place: &Workplace) {
    let ball = sphere(4, 0.0, 3);
    let mut text = String::from("ply\nformat ascii 1.0\n");
    writeln!(text, "element vertex {}\nproperty float x\nproperty float y\nproperty float z", ball.positions.len())
        .unwrap();
    text.push_str("property uchar red\nproperty uchar green\nproperty uchar blue\n");
    writeln!(text, "element face {}\nproperty list uchar int vertex_indices\nend_header", ball.triangles.len())
        .unwrap();
    for position in &ball.positions {
        let [x, y, z] = *position;
        let [red, green, blue] = position.map(|value| (127.0 + 120.0 * (3.0 * value).sin()) as u8);
        writeln!(text, "{x} {y} {z} {red} {green} {blue}").unwrap();
    }
    for [a, b, c] in &ball.triangles {
        writeln!(text, "3 {a} {b} {c}").unwrap();
    }
    place.write("coloured.ply", text);
}

fn place_with_models() -> Workplace {
    let place = workplace!();
    place.write("ring.ply", ply(&torus(120, 60, 0.02, 5), Encoding::LittleEndian, Coordinates::Float));
    write_textured(&place);
    write_coloured(&place);
    for mesh in ["ring.ply", "textured.obj", "coloured.ply"] {
        place.json(&format!("build {mesh} -o {}.vdt", mesh.split_once('.').unwrap().0));
    }
    place
}

fn likeness(one: &RgbImage, other: &RgbImage) -> f64 {
    image_compare::rgb_hybrid_compare(one, other).unwrap().score
}

fn reference(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("references").join(format!("{name}.png"))
}

#[test]
fn pictures_look_as_they_did_whoever_draws_them() {
    let place = place_with_models();
    let pictures = [
        ("ring", "ring.vdt --pixels 2"),
        ("edges", "ring.vdt --pixels 4 --edges"),
        ("levels", "ring.vdt --pixels 2 --levels"),
        ("boxes", "ring.vdt --pixels 2 --boxes"),
        ("coloured", "coloured.vdt --pixels 2"),
        ("textured", "textured.vdt --pixels 0.5 --camera 12,-14,22,12,11,0"),
    ];
    for (name, options) in pictures {
        let [by_processor, by_driver] = ["software", "gpu"].map(|renderer| {
            let said =
                place.json(&format!("render {options} -o {renderer}.png --force --size 240x160 --renderer {renderer}"));
            assert_eq!((&said["renderer"], &said["problems"]), (&renderer.into(), &serde_json::json!([])));
            image::load_from_memory(&place.read(&format!("{renderer}.png"))).unwrap().to_rgb8()
        });
        if std::env::var_os("VDT_WRITE_REFERENCES").is_some() {
            by_processor.save(reference(name)).unwrap();
        }
        let before = image::open(reference(name)).unwrap().to_rgb8();
        for (who, picture) in [("the processor", &by_processor), ("the driver", &by_driver)] {
            let alike = likeness(picture, &before);
            // Lines are a point wide, and drivers differ in which.
            let least = if name == "boxes" && who == "the driver" { ALIKE_LINES } else { ALIKE };
            assert!(alike >= least, "{name} by {who}: only {alike:.4} like {}", reference(name).display());
        }
        // A picture that is another one is not alike: the measure can fail.
        assert!(name == "ring" || likeness(&before, &image::open(reference("ring")).unwrap().to_rgb8()) < ALIKE);
    }
}

#[test]
fn a_driver_draws_the_same_wherever_the_mesh_lies_and_on_every_run() {
    let place = workplace!();
    let mut meshes = Vec::new();
    for shift in [0.0, 1e6] {
        let mut ball = sphere(5, 0.05, 3);
        // Steps that doubles have there, too.
        let snap = |value: f64| (value * 65536.0).round() / 65536.0;
        ball.positions
            .iter_mut()
            .for_each(|position| *position = [snap(position[0]) + shift, snap(position[1]) + shift, snap(position[2])]);
        let name = format!("ball{shift}");
        place.write(&format!("{name}.ply"), ply(&ball, Encoding::LittleEndian, Coordinates::Double));
        place.json(&format!("build {name}.ply -o {name}.vdt"));
        meshes.push(name);
    }
    for renderer in ["software", "gpu"] {
        let pictures = [0, 1, 1].map(|mesh: usize| {
            let name = &meshes[mesh];
            place.json(&format!("render {name}.vdt -o {name}.png --force --size 300x200 --renderer {renderer}"));
            image::load_from_memory(&place.read(&format!("{name}.png"))).unwrap().to_rgb8()
        });
        assert_eq!(pictures[1], pictures[2], "{renderer}: not the same on every run");
        let alike = likeness(&pictures[0], &pictures[1]);
        assert!(alike > 0.995, "{renderer}: only {alike}");
    }
}

/// A navigator for a model, with all streams.
fn navigator(model: &Arc<Model>, memory: u64) -> Navigator {
    let options = NavigatorOptions {
        memory,
        width: WIDTH,
        height: HEIGHT,
        geomorph: 4,
        attributes: true,
        io: Io::Sync,
        ..NavigatorOptions::default()
    };
    Navigator::open(model.clone(), options).unwrap()
}

const WIDTH: u32 = 160;
const HEIGHT: u32 = 120;

fn scene(gpu: &Gpu, model: &Model, most_buffer_bytes: Option<u64>) -> Scene {
    let room = Room { bytes: 1 << 22, decoding_bytes: 1 << 24, most_side: 1024, most_textures: 16 };
    let looks = Looks::of(model, room).unwrap();
    let options =
        SceneOptions { memory: 64 << 20, format: OffScreen::FORMAT, size: [WIDTH, HEIGHT], most_buffer_bytes };
    Scene::new(gpu, model, &looks, options).unwrap()
}

fn view(model: &Model, camera: &Camera, style: Style) -> SceneView {
    let header = model.header();
    let projection = Projection::new(camera, header.origin, header.diagonal(), WIDTH, HEIGHT).unwrap();
    SceneView { projection, rectangle: [0, 0, WIDTH, HEIGHT], style }
}

/// (A stream that was long, became short, and long again, was drawn with what it had been there before.)
///
/// Frame after frame only what has changed is sent, to buffers each of which holds a part of the streams only; and what is then drawn
/// is what is drawn of all of it, sent at once, to buffers that hold it all.
#[test]
fn what_is_brought_up_to_date_is_what_is_new() {
    let gpu = Gpu::open(Drivers::Any).expect("a Vulkan driver: install mesa-vulkan-drivers");
    let place = place_with_models();
    let all = Style { edges: true, levels: false, boxes: true };
    let styles = [Style::default(), all, Style { levels: true, ..Style::default() }];
    for name in ["ring.vdt", "textured.vdt", "coloured.vdt"] {
        let model = Arc::new(Model::open(&LocalDisk, &place.path(name)).unwrap());
        let cameras = PathSpec::Flyby { frames: 36 }.cameras(&LocalDisk, &model).unwrap();
        let mut flown = navigator(&model, 8 << 20);
        let mut kept = scene(&gpu, &model, Some(32 << 10));
        let off_screen = OffScreen::new(&gpu, WIDTH, HEIGHT).unwrap();
        let [mut of_kept, mut of_fresh] = [Picture::new(WIDTH, HEIGHT), Picture::new(WIDTH, HEIGHT)];
        let mut same = navigator(&model, 8 << 20);
        for (number, camera) in cameras.iter().enumerate() {
            let style = styles[number / 3 % styles.len()];
            flown.frame(camera).unwrap();
            same.frame(camera).unwrap();
            let upload = kept.update(&gpu, &mut flown, style).unwrap();
            assert!(number > 0 || upload.bytes > 0);
            if number % 3 == 2 {
                off_screen.draw(&gpu, &mut kept, &view(&model, camera, style), &mut of_kept).unwrap();
                // The changes of the other navigator were never forgotten: it sends everything.
                let mut fresh = scene(&gpu, &model, None);
                let whole = fresh.update(&gpu, &mut same, style).unwrap();
                off_screen.draw(&gpu, &mut fresh, &view(&model, camera, style), &mut of_fresh).unwrap();
                assert!(of_kept == of_fresh, "{name}, frame {number}");
                assert!(of_kept.distances().any(f32::is_finite), "{name}, frame {number}");
                assert!(whole.bytes >= 16 * same.vertex_stream().len() as u64);
                same = navigator(&model, 8 << 20);
                for camera in &cameras[..=number] {
                    same.frame(camera).unwrap();
                }
            }
        }
    }
}

#[test]
fn little_memory_on_the_device_is_kept_to() {
    let gpu = Gpu::open(Drivers::Any).expect("a Vulkan driver: install mesa-vulkan-drivers");
    let place = place_with_models();
    place.write("large.ply", ply(&torus(240, 120, 0.02, 5), Encoding::LittleEndian, Coordinates::Float));
    place.json("build large.ply -o large.vdt");
    let model = Arc::new(Model::open(&LocalDisk, &place.path("large.vdt")).unwrap());
    let options = |memory: u64| SceneOptions {
        memory,
        format: OffScreen::FORMAT,
        size: [WIDTH, HEIGHT],
        most_buffer_bytes: None,
    };
    let refused = Scene::new(&gpu, &model, &Looks::default(), options(1 << 20));
    assert!(matches!(refused, Err(GpuError::Memory { .. })));
    let memory = Scene::new(&gpu, &model, &Looks::default(), options(1 << 30)).unwrap().bytes() + (600 << 10);
    let mut small = Scene::new(&gpu, &model, &Looks::default(), options(memory)).unwrap();
    // With no more triangles than it says, all of a view fits in; without, it is refused, and nothing is allocated.
    assert!((1000..14_000).contains(&small.most_triangles()), "{}", small.most_triangles());
    for max_triangles in [Some(small.most_triangles()), None] {
        let options = NavigatorOptions { pixels: 0.01, max_triangles, io: Io::Sync, ..NavigatorOptions::default() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        navigator.run_until_settled(&overview(&model, WIDTH, HEIGHT), 1000).unwrap();
        let updated = small.update(&gpu, &mut navigator, Style::default());
        assert_eq!(updated.is_ok(), max_triangles.is_some(), "{updated:?}");
        assert!(small.bytes() <= memory);
    }
    place.refuses(1, "render ring.vdt -o a.png --renderer gpu --gpu-memory 1M", &["GPU memory", "the picture"]);
    assert!(!place.path("a.png").exists());
}

#[test]
fn images_that_cannot_be_drawn_are_told_of() {
    let place = workplace!();
    write_textured(&place);
    let picture = |mesh: &str| {
        place.json(&format!("build {mesh} -o it.vdt --force"));
        let said = place.json("render it.vdt -o it.png --force --size 80x60 --renderer software");
        (said["problems"].clone(), place.read("it.png"))
    };
    let (none, textured) = picture("textured.obj");
    assert_eq!(none, serde_json::json!([]));
    place.write("board.png", b"\x89PNG and more");
    let (damaged, plain) = picture("textured.obj");
    assert!(damaged[0].as_str().unwrap().contains("board.png"), "{damaged}");
    assert_ne!(textured, plain);
    std::fs::remove_file(place.path("board.png")).unwrap();
    let (absent, without) = picture("textured.obj");
    assert!(absent[0].as_str().unwrap().contains("does not have it"), "{absent}");
    assert_eq!(plain, without);
}

/// Without attributes, without triangles, of any kind: a driver has something to draw, or nothing.
#[test]
fn a_driver_draws_small_and_odd_meshes() {
    let place = workplace!();
    let mut random = Random(4);
    for (name, bytes) in [
        ("one.glb", glb(&sheet(2, 2, 0.1, 0, random.bits()), 2)),
        ("point.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n1 2 3\n".to_vec()),
    ] {
        place.write(name, bytes);
        place.json(&format!("build {name} -o odd.vdt --force"));
        let [by_processor, by_driver] = ["software", "gpu"].map(|renderer| {
            place.json(&format!("render odd.vdt -o odd.png --force --size 60x40 --edges --boxes --levels --renderer {renderer}"))["points_drawn"].clone()
        });
        let drawn = [&by_processor, &by_driver].map(|points| points.as_u64().unwrap());
        assert!(drawn[0].abs_diff(drawn[1]) < 30 && (drawn[0] > 0) == (name == "one.glb"), "{name}: {drawn:?}");
    }
}
