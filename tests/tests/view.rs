//! The window, in a display without a screen, with real key and mouse events: what is seen, and what is left on disk.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::process::{Child, Stdio};
use std::time::Duration;

use image::RgbImage;
use vdt_tests::display::{Display, button, key};
use vdt_tests::mesh_files::{Coordinates, Encoding, ply};
use vdt_tests::program::{Outcome, Workplace, wait};
use vdt_tests::random_mesh::sphere;
use vdt_tests::workplace;

/// Parts of the window: x, y, width, height.
type Part = [u32; 4];
/// Where the figures are.
const FIGURES: Part = [12, 12, 220, 150];
/// Where the help is.
const HELP: Part = [900, 12, 360, 200];
/// The middle, in which the model is.
const MIDDLE: Part = [540, 300, 200, 200];
/// What is beside the figures.
const SCENE: Part = [410, 0, 870, 800];
/// The corner window.
const CORNER: Part = [860, 530, 390, 240];
/// Where messages are.
const MESSAGES: Part = [12, 690, 800, 100];
const CENTER: [i16; 2] = [640, 400];

fn place_with_ball() -> Workplace {
    let place = workplace!();
    place.write("ball.ply", ply(&sphere(5, 0.02, 3), Encoding::LittleEndian, Coordinates::Float));
    place
}

/// A window that is open.
struct Viewer {
    child: Child,
    title: String,
}

impl Viewer {
    fn open(place: &Workplace, display: &Display, arguments: &str) -> Self {
        let words: Vec<&str> = arguments.split_whitespace().collect();
        let mut command = place.command(&words);
        display.lend(&mut command);
        command.env("XDG_STATE_HOME", place.path("state")).env("HOME", place.path("home"));
        // Mesa complains without one.
        command.env("XDG_RUNTIME_DIR", place.folder());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        display.move_to(CENTER);
        let child = command.spawn().unwrap();
        display.focus();
        Viewer { child, title: arguments.into() }
    }

    fn end(self, display: &Display) -> Outcome {
        display.tap(key::ESCAPE);
        wait(self.child, &self.title, |_| ())
    }
}

fn part(picture: &RgbImage, [x, y, width, height]: Part) -> RgbImage {
    image::imageops::crop_imm(picture, x, y, width, height).to_image()
}

/// How many points of a part are bright: the surface in the light, or letters.
fn bright(picture: &RgbImage, of: Part) -> usize {
    part(picture, of).pixels().filter(|colour| colour.0.iter().all(|part| *part > 100)).count()
}

/// How many points of a part have the colour of errors.
fn reddish(picture: &RgbImage, of: Part) -> usize {
    let is_reddish = |colour: &&image::Rgb<u8>| colour.0[0] > 180 && colour.0[1] < 150 && colour.0[2] < 130;
    part(picture, of).pixels().filter(is_reddish).count()
}

fn differing(one: &RgbImage, other: &RgbImage, of: Part) -> usize {
    let (one, other) = (part(one, of), part(other, of));
    let is_other =
        |(one, other): &(&image::Rgb<u8>, &image::Rgb<u8>)| (0..3).any(|at| one.0[at].abs_diff(other.0[at]) > 6);
    one.pixels().zip(other.pixels()).filter(is_other).count()
}

/// The window is open, and shows a finished picture of a model.
fn model_is_seen(display: &Display) -> RgbImage {
    display
        .wait_until("the model is seen", |picture| bright(picture, MIDDLE) > 20_000 && bright(picture, FIGURES) > 100);
    display.finished_picture()
}

/// What happens changes a part of the picture by many points.
fn changes(display: &Display, what: &str, of: Part, happen: impl FnOnce()) -> RgbImage {
    let before = display.finished_picture();
    happen();
    display.wait_until(what, |picture| differing(&before, picture, of) > 400);
    display.finished_picture()
}

#[test]
fn a_mesh_is_built_and_looked_at() {
    let (place, display) = (place_with_ball(), Display::start());
    let viewer = Viewer::open(&place, &display, "view ball.ply --json");
    let first = model_is_seen(&display);
    assert!(place.path("ball.vdt").exists());
    assert!(!place.names().iter().any(|name| name.contains("scratch")), "{:?}", place.names());

    // Keys: each changes the picture, and again, back.
    for letter in ['e', 'l', 'b'] {
        changes(&display, &format!("{letter} is seen"), MIDDLE, || display.letter(letter));
        let back = changes(&display, &format!("{letter} goes"), MIDDLE, || display.letter(letter));
        assert_eq!(differing(&first, &back, MIDDLE), 0, "{letter}");
    }
    changes(&display, "the help is seen", HELP, || display.letter('h'));
    let hidden = changes(&display, "Tab hides all", HELP, || display.tap(key::TAB));
    assert_eq!(bright(&hidden, FIGURES), 0);
    changes(&display, "Tab brings it back", FIGURES, || display.tap(key::TAB));
    changes(&display, "the help goes", HELP, || display.letter('h'));

    // The mouse: a ball that is not quite round turns, comes nearer and goes aside.
    let turned = changes(&display, "a drag turns", SCENE, || display.drag(button::LEFT, CENTER, [800, 440]));
    let near = changes(&display, "the wheel zooms", SCENE, || (0..6).for_each(|_| display.click(button::WHEEL_UP)));
    assert!(bright(&near, [300, 100, 600, 600]) > bright(&turned, [300, 100, 600, 600]));
    changes(&display, "a middle drag moves", SCENE, || display.drag(button::MIDDLE, CENTER, [900, 500]));
    changes(&display, "so does the left one with Shift", SCENE, || {
        display.press(key::SHIFT);
        display.drag(button::LEFT, CENTER, [400, 300]);
        display.release(key::SHIFT);
    });
    changes(&display, "a right drag looks around", SCENE, || display.drag(button::RIGHT, CENTER, [800, 400]));
    changes(&display, "W flies", SCENE, || {
        display.press('w'.into());
        std::thread::sleep(Duration::from_millis(200));
        display.release('w'.into());
    });
    changes(&display, "E flies then, too", SCENE, || {
        display.press('w'.into());
        display.press('e'.into());
        std::thread::sleep(Duration::from_millis(200));
        display.release('e'.into());
        display.release('w'.into());
    });
    let back = changes(&display, "Enter goes back", SCENE, || display.tap(key::ENTER));
    assert_eq!(differing(&first, &back, MIDDLE), 0);

    // A place of the surface becomes the pivot.
    display.move_to([700, 350]);
    changes(&display, "the new pivot is told", MESSAGES, || (0..2).for_each(|_| display.click(button::LEFT)));

    // Frozen, one walks around what was made for another eye; and the corner shows what the viewer sees.
    changes(&display, "the corner opens", CORNER, || display.letter('c'));
    let corner = changes(&display, "the corner turns", CORNER, || display.drag(button::LEFT, [1050, 640], [1100, 660]));
    let main = changes(&display, "the large picture turns", MIDDLE, || display.drag(button::LEFT, CENTER, [700, 420]));
    assert_eq!(differing(&corner, &main, CORNER), 0);
    changes(&display, "the corner closes", CORNER, || display.letter('c'));
    display.letter('e');
    display.letter('f');
    changes(&display, "frozen, it still turns", MIDDLE, || display.drag(button::LEFT, CENTER, [560, 300]));
    changes(&display, "one goes away", SCENE, || (0..6).for_each(|_| display.click(button::WHEEL_DOWN)));
    changes(&display, "and the detail follows again", MIDDLE, || display.letter('f'));
    display.letter('e');
    display.tap(key::ENTER);
    display.finished_picture();

    // A path and pictures are kept, under names that are free.
    place.write("ball.png", "mine");
    display.letter('r');
    display.drag(button::LEFT, CENTER, [800, 440]);
    display.letter('r');
    display.finished_picture();
    changes(&display, "only the picture is there", FIGURES, || display.tap(key::TAB));
    let seen = display.finished_picture();
    display.tap(key::F12);
    let kept = || std::fs::read(place.path("ball-2.png")).is_ok();
    display.wait_until("F12 keeps the picture", |_| kept());
    let said = viewer.end(&display).document();
    let shot = image::load_from_memory(&place.read("ball-2.png")).unwrap().to_rgb8();
    assert_eq!(shot.dimensions(), (1280, 800));
    assert_eq!(differing(&seen, &shot, [0, 0, 1280, 800]), 0);
    assert_eq!(place.read("ball.png"), b"mine");

    let path = String::from_utf8(place.read("ball.path")).unwrap();
    let cameras = path.lines().filter(|line| !line.starts_with('#')).count();
    assert!(cameras >= 5, "{path}");
    assert_eq!(place.json("navigate ball.vdt --path ball.path")["frames"], cameras);
    let model_path = place.path("ball.vdt").display().to_string();
    assert!(model_path.ends_with(said["model"].as_str().unwrap()), "{said}");
    assert_eq!((&said["settled"], &said["renderer_is_processor"]), (&true.into(), &true.into()), "{said}");
    assert!(said["frames"].as_u64().unwrap() > 50 && said["uploaded_bytes"].as_u64().unwrap() > 0, "{said}");
    assert_eq!(said["paths"].as_array().unwrap().len() + said["screenshots"].as_array().unwrap().len(), 2, "{said}");
    assert!(said["frame_ms_p50"].as_f64().unwrap() <= said["frame_ms_p99"].as_f64().unwrap(), "{said}");
    assert!(said["first_picture_seconds"].as_f64().unwrap() > 0.0 && said["triangles"].as_u64().unwrap() > 1000);
}

#[test]
fn the_last_view_is_there_again() {
    let (place, display) = (place_with_ball(), Display::start());
    place.json("build ball.ply -o ball.vdt");
    let open = |file: &str| Viewer::open(&place, &display, &format!("view {file} --json"));
    let viewer = open("ball.vdt");
    model_is_seen(&display);
    changes(&display, "a drag turns", SCENE, || display.drag(button::LEFT, CENTER, [720, 440]));
    display.click(button::WHEEL_UP);
    let left = changes(&display, "the figures go", FIGURES, || display.tap(key::TAB));
    viewer.end(&display).document();

    // By the mesh it is the same model, which is not built again.
    let model = place.read("ball.vdt");
    let viewer = open("ball.ply");
    model_is_seen(&display);
    let again = changes(&display, "the figures go", FIGURES, || display.tap(key::TAB));
    assert!(differing(&left, &again, [0, 0, 1280, 800]) < 100);
    viewer.end(&display).document();
    assert!(place.read("ball.vdt") == model);

    // Damaged, it is ignored.
    let state = place.path("state/vdt");
    let files: Vec<_> = std::fs::read_dir(&state).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 1);
    let text = std::fs::read_to_string(&files[0]).unwrap();
    std::fs::write(&files[0], text.replace("camera", "kamera")).unwrap();
    let viewer = open("ball.vdt");
    model_is_seen(&display);
    viewer.end(&display).document();
}

#[test]
fn sliders_act_at_once() {
    let (place, display) = (place_with_ball(), Display::start());
    place.json("build ball.ply -o ball.vdt");
    let viewer = Viewer::open(&place, &display, "view ball.vdt --json --pixels 0.3");
    let before = model_is_seen(&display);
    // The first slider is below the figures: from its left end to the right.
    let sliders = (150..420).find(|y| {
        let row: Vec<_> = (20..190).map(|x| before.get_pixel(x, *y).0).collect();
        // The rail is one colour of grey over its whole width, but for the handle.
        let rail = row[160];
        rail[0] > 30 && row.iter().filter(|colour| **colour == rail).count() > 120
    });
    let y = sliders.expect("there is a slider") as i16;
    changes(&display, "the edges are seen", MIDDLE, || display.letter('e'));
    changes(&display, "more pixels of error are fewer edges", MIDDLE, || {
        display.drag_slowly(button::LEFT, [60, y], [185, y], Duration::from_millis(400));
    });
    // Back to a fine picture, of the most triangles; the slider of that is the last.
    let pause = Duration::from_millis(400);
    display.drag_slowly(button::LEFT, [185, y], [60, y], pause);
    changes(&display, "fewer triangles are fewer edges", MIDDLE, || {
        display.drag_slowly(button::LEFT, [185, y + 46], [24, y + 46], pause);
    });
    // Between them that of the RAM, from 256 MiB to the least: all the while there is a picture.
    display.drag_slowly(button::LEFT, [123, y + 23], [20, y + 23], pause);
    assert!(bright(&display.picture(), MIDDLE) > 10_000);
    assert!(bright(&display.finished_picture(), MIDDLE) > 10_000);
    let said = viewer.end(&display).document();
    assert!(said["pixels_drawn"].as_f64().unwrap() > 0.5, "{said}");
    assert!(said["budget_bytes"].as_u64().unwrap() < 2 << 20, "{said}");
    assert!((100..=1000).contains(&said["triangles"].as_u64().unwrap()), "{said}");
}

#[test]
fn what_cannot_be_opened_is_told() {
    let (place, display) = (place_with_ball(), Display::start());
    place.write("letter.txt", "Dear reader, this is no mesh.\n");
    let viewer = Viewer::open(&place, &display, "view letter.txt");
    display.wait_until("the message is seen", |picture| reddish(picture, MESSAGES) > 50);
    display.finished_picture();
    viewer.end(&display).refusal(1, &["letter.txt"]);
    assert!(!place.names().iter().any(|name| name.contains("letter.") && name != "letter.txt"), "{:?}", place.names());

    // A model that is older than its mesh is not replaced.
    place.json("build ball.ply -o ball.vdt");
    let old = std::time::SystemTime::now() - Duration::from_secs(1000);
    std::fs::File::options().write(true).open(place.path("ball.vdt")).unwrap().set_modified(old).unwrap();
    let viewer = Viewer::open(&place, &display, "view ball.ply");
    display.wait_until("the message is seen", |picture| reddish(picture, MESSAGES) > 50);
    display.finished_picture();
    viewer.end(&display).refusal(1, &["ball.vdt: this model is older than ball.ply", "--force"]);
    let viewer = Viewer::open(&place, &display, "view ball.ply --force --json");
    model_is_seen(&display);
    viewer.end(&display).document();

    // Without a file, a window says what to do.
    let viewer = Viewer::open(&place, &display, "view --json");
    display.wait_until("the invitation is seen", |picture| bright(picture, [400, 340, 480, 120]) > 200);
    let said = viewer.end(&display).document();
    assert!(said["model"].is_null() && said["frames"] == 0, "{said}");
}

#[test]
fn files_can_be_dropped_onto_the_window() {
    let (place, display) = (place_with_ball(), Display::start());
    place.write("letter.txt", "Dear reader, this is no mesh.\n");
    let viewer = Viewer::open(&place, &display, "view --json");
    display.wait_until("the invitation is seen", |picture| bright(picture, [400, 340, 480, 120]) > 200);
    display.drop_file(&place.path("letter.txt"));
    display.wait_until("the message is seen", |picture| reddish(picture, MESSAGES) > 50);
    display.drop_file(&place.path("ball.ply"));
    model_is_seen(&display);
    let Outcome { status, stdout, stderr, .. } = viewer.end(&display);
    assert!(status.success() && stderr.starts_with("vdt: ") && stderr.contains("letter.txt"), "{stderr}");
    let said: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(said["model"], place.path("ball.vdt").canonicalize().unwrap().to_str().unwrap());
}

#[test]
fn without_a_display_it_says_so() {
    let place = place_with_ball();
    for display in ["", ":98765"] {
        let mut command = place.command(&["view", "ball.ply"]);
        command.env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET").env("DISPLAY", display);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let outcome = wait(command.spawn().unwrap(), "view ball.ply", |_| ());
        outcome.refusal(1, &["display", "`vdt render`"]);
    }
    place.refuses(1, "view absent.ply", &["absent.ply", "No such file"]);
    place.refuses(1, "view ball.ply --camera 1,1,1,1,1,1", &["--camera", "same point"]);
    place.refuses(2, "view ball.ply --pixels 0", &["--pixels"]);
    assert!(!place.path("ball.vdt").exists());
}

/// OpenGL has no texture of a single layer: what had one image was black.
#[test]
fn a_texture_is_seen_by_opengl_too() {
    let (place, display) = (workplace!(), Display::start());
    place.write(
        "board.obj",
        "mtllib board.mtl\nusemtl paper\nv -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
         f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n",
    );
    place.write("board.mtl", "newmtl paper\nmap_Kd paper.png\n");
    let mut png = std::io::Cursor::new(Vec::new());
    RgbImage::from_pixel(8, 8, image::Rgb([250; 3])).write_to(&mut png, image::ImageFormat::Png).unwrap();
    place.write("paper.png", png.into_inner());
    place.json("build board.obj -o board.vdt");
    let mut command = place.command(&["view", "board.vdt", "--json"]);
    display.lend(&mut command);
    command.env("XDG_STATE_HOME", place.path("state")).env("WGPU_BACKEND", "gl");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let viewer = Viewer { child: command.spawn().unwrap(), title: "view by OpenGL".into() };
    display.focus();
    display.wait_until("the board is seen", |picture| bright(picture, MIDDLE) > 10_000);
    let said = viewer.end(&display).document();
    assert!(said["renderer"].as_str().unwrap().contains("(gl)"), "{said}");
}
