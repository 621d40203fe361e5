//! `vdt convert`: the same mesh in another format, with all that it carries, and levels of detail of it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::fmt::Write as _;

use serde_json::Value;
use vdt_tests::mesh_files::{Coordinates, Encoding, ply, read_ply, surface};
use vdt_tests::program::Workplace;
use vdt_tests::random_mesh::RawMesh;
use vdt_tests::workplace;

/// Vertices along each side of [`textured`].
const SIDE: usize = 12;

/// A bent sheet of three materials in turn with normals and textures, torn apart in the middle of the image.
fn textured(place: &Workplace) {
    let mut text = String::from("mtllib sheet.mtl\n");
    for number in 0..SIDE * SIDE {
        let (x, y) = (number % SIDE, number / SIDE);
        writeln!(text, "v {x} {y} {}", (x * x + 3 * y) as f64 / 8.0).unwrap();
        writeln!(text, "vn {} -0.25 1", x as f64 / 4.0 - 1.0).unwrap();
        for shift in [0.0, 0.5] {
            writeln!(text, "vt {} {}", x as f64 / 64.0 + shift, y as f64 / 32.0).unwrap();
        }
    }
    for number in 0..(SIDE - 1) * (SIDE - 1) {
        let (x, y) = (number % (SIDE - 1), number / (SIDE - 1));
        let corner = |x: usize, y: usize, is_right: bool| {
            let vertex = y * SIDE + x;
            format!("{}/{}/{}", vertex + 1, 2 * vertex + usize::from(is_right) + 1, vertex + 1)
        };
        let is_right = x >= SIDE / 2;
        writeln!(text, "usemtl {}", ["red", "wood", "plain"][(x + y) % 3]).unwrap();
        let corners = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)].map(|(x, y)| corner(x, y, is_right));
        writeln!(text, "f {}", corners.join(" ")).unwrap();
    }
    place.write("sheet.obj", text);
    let library = "newmtl red\nKd 0.9 0.1 0.33\nd 0.5\nnewmtl wood\nKd 1 1 1\nmap_Kd wood.png\n\
                   newmtl plain\nKd 0.2 0.2 0.2\nmap_Kd bark.jpg\nnewmtl unused\nKd 0 0 0\n";
    place.write("sheet.mtl", library);
    place.write("wood.png", b"\x89PNG and more");
    place.write("bark.jpg", b"\xff\xd8\xff and so on");
}

/// A grid whose vertices have all kinds of colours.
fn coloured(alpha: &str) -> String {
    let mut text = String::from("ply\nformat ascii 1.0\nelement vertex 256\n");
    for axis in ["x", "y", "z"] {
        writeln!(text, "property float {axis}").unwrap();
    }
    for channel in ["red", "green", "blue"].iter().chain(Some(&alpha).filter(|alpha| !alpha.is_empty())) {
        writeln!(text, "property uchar {channel}").unwrap();
    }
    text.push_str("element face 225\nproperty list uchar int vertex_indices\nend_header\n");
    for number in 0..256 {
        let alpha = if alpha.is_empty() { String::new() } else { format!(" {}", (number * 7) % 256) };
        writeln!(text, "{} {} 0.5 {number} {} {}{alpha}", number % 16, number / 16, 255 - number, number ^ 85).unwrap();
    }
    for number in 0..225 {
        let first = number / 15 * 16 + number % 15;
        writeln!(text, "4 {first} {} {} {}", first + 1, first + 17, first + 16).unwrap();
    }
    text
}

/// The model of a mesh, to the last bit of positions and attributes.
fn model(place: &Workplace, mesh: &str) -> (Value, Value) {
    let built = place.json(&format!("build {mesh} -o model.vdt --positions lossless --force"));
    (built["model_sha256"].clone(), built["attributes"].clone())
}

#[test]
fn a_textured_mesh_goes_to_glb_and_back() {
    let place = workplace!();
    textured(&place);
    let before = model(&place, "sheet.obj");
    assert_eq!(before.1, serde_json::json!(["normals", "texture_coordinates", "materials"]));
    std::fs::create_dir(place.path("back")).unwrap();

    let said = place.json("convert sheet.obj sheet.glb");
    assert_eq!((&said["triangles"], &said["guaranteed"]), (&242.into(), &true.into()), "{said}");
    assert!(said["vertices"].as_u64().unwrap() > 144 && said["error_stated"] == 0.0, "{said}");
    assert_eq!(said["warnings"][0]["kind"], "polygons");
    assert_eq!(
        (said["left_out"].as_array().unwrap().len(), &said["bytes"]),
        (0, &place.read("sheet.glb").len().into())
    );
    assert!(model(&place, "sheet.glb") == before);

    let said = place.json("convert sheet.glb back/sheet.obj");
    assert_eq!(said["beside"].as_array().unwrap().len(), 3, "{said}");
    assert!(model(&place, "back/sheet.obj") == before);
    for image in ["wood.png", "bark.jpg"] {
        assert_eq!(place.read(&format!("back/{image}")), place.read(image));
    }
    place.json("convert back/sheet.obj sheet.ply --memory 16M --threads 1");
    assert!(model(&place, "sheet.ply") == before);

    place.json("convert sheet.obj plain.glb --no-attributes");
    assert_eq!(model(&place, "plain.glb").1.as_array().unwrap().len(), 0);
}

#[test]
fn colours_go_everywhere() {
    let place = workplace!();
    place.write("opaque.ply", coloured(""));
    place.write("clear.ply", coloured("alpha"));
    let before = model(&place, "opaque.ply");
    for name in ["colours.obj", "colours.glb", "colours.ply"] {
        let said = place.json(&format!("convert opaque.ply {name}"));
        assert_eq!((&said["vertices"], said["left_out"].as_array().unwrap().len()), (&256.into(), 0), "{said}");
        assert!(model(&place, name) == before, "{name}");
    }
    let before = model(&place, "clear.ply");
    for (name, left_out) in [("clear.glb", 0), ("again.ply", 0), ("clear.obj", 1)] {
        let said = place.json(&format!("convert clear.ply {name}"));
        assert_eq!(said["left_out"].as_array().unwrap().len(), left_out, "{said}");
        assert_eq!(model(&place, name) == before, left_out == 0, "{name}");
    }
    let text = place.run("convert clear.ply clear.obj --force").success();
    assert!(text.contains("left out") && text.contains("none: this is the mesh itself"), "{text}");
}

#[test]
fn positions_far_from_zero_stay_where_they_are() {
    let place = workplace!();
    let mut mesh = RawMesh { positions: Vec::new(), triangles: Vec::new() };
    for number in 0..400_u32 {
        let (x, y) = (f64::from(number % 20), f64::from(number / 20));
        mesh.positions.push([4_000_000.0 + x / 1024.0, -5_000_000.0 + y / 1024.0, 100.0 + x * y / 4096.0]);
        if number % 20 < 19 && number < 380 {
            mesh.triangles.extend([[number, number + 1, number + 21], [number, number + 21, number + 20]]);
        }
    }
    place.write("far.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Double));
    for (from, to) in
        [("far.ply", "far.glb"), ("far.glb", "back.ply"), ("far.ply", "far.obj"), ("far.obj", "again.ply")]
    {
        let said = place.json(&format!("convert {from} {to}"));
        assert_eq!((&said["triangles"], said["left_out"].as_array().unwrap().len()), (&722.into(), 0), "{said}");
        assert_eq!((&said["error_stated"], &said["guaranteed"]), (&0.0.into(), &true.into()));
    }
    for name in ["back.ply", "again.ply"] {
        assert!(surface(&read_ply(&place.read(name))) == surface(&mesh), "{name}");
    }
}

#[test]
fn a_level_of_detail_is_that_of_the_model() {
    let place = workplace!();
    place.json("generate sphere --triangles 6000 -o ball.ply");
    textured(&place);
    for (mesh, asked) in [("ball.ply", "--triangles 500"), ("ball.ply", "--error 1%"), ("sheet.obj", "--triangles 60")]
    {
        place.json(&format!("build {mesh} -o model.vdt --positions lossless --force"));
        for output in ["small.ply", "small.glb", "small.obj"] {
            let extracted = place.json(&format!("extract model.vdt -o {output} --force {asked}"));
            let bytes = place.read(output);
            let before = place.names();
            let converted = place.json(&format!("convert {mesh} {output} --force {asked}"));
            assert_eq!(place.names(), before);
            for key in ["triangles", "vertices", "error_stated", "guaranteed", "beside", "left_out", "input_error"] {
                assert_eq!(converted[key], extracted[key], "{key}");
            }
            assert!(converted["triangles"].as_u64().unwrap() > 0 && converted["guaranteed"] == true, "{converted}");
            // The comment tells which command wrote it.
            let same = String::from_utf8_lossy(&bytes).replace("vdt extract", "vdt convert");
            let found = place.read(output);
            assert!(String::from_utf8_lossy(&found) == same, "{mesh} {output}");
        }
        let said = place.json(&format!("compare {mesh} small.glb --samples 20000 --no-colours"));
        let stated = place.json(&format!("extract model.vdt -o small.ply --force {asked}"))["error_stated"].clone();
        assert!(said["a_to_b_max"].as_f64() <= stated.as_f64(), "{said}");
    }
}

#[test]
fn what_cannot_be_is_refused() {
    let place = workplace!();
    place.json("generate sphere --triangles 100 -o ball.ply");
    place.json("build ball.ply -o ball.vdt");
    place.refuses(1, "convert ball.ply ball.stl", &["ball.stl", "ends in .ply, .obj or .glb"]);
    place.refuses(1, "convert ball.ply ball.ply --force", &["ball.ply", "would replace ball.ply"]);
    place.refuses(1, "convert ball.ply ball.ply", &["exists already", "--force"]);
    place.refuses(1, "convert ball.ply there/ball.glb", &["there is no directory there"]);
    place.refuses(1, "convert ball.ply x.glb --scratch there", &["there is no such directory"]);
    place.refuses(1, "convert none.ply x.glb", &["none.ply"]);
    place.refuses(1, "convert ball.vdt x.glb", &["this is a model", "vdt extract"]);
    place.refuses(1, "convert ball.ply x.glb --memory 1M", &["run again with --memory"]);
    place.refuses(1, "convert ball.ply x.glb --memory 1M --triangles 9", &["--memory"]);
    place.refuses(2, "convert ball.ply", &["<OUT>"]);
    place.refuses(2, "convert ball.ply x.glb --error 1% --triangles 9", &["--triangles"]);
    let help = place.run("convert --help").success();
    assert!(help.contains("Examples:") && help.contains("vdt convert scan.obj scan.glb"), "{help}");
}

#[test]
fn memory_is_that_which_is_allowed() {
    let place = workplace!();
    place.json("generate terrain --triangles 1500000 -o terrain.ply");
    for output in ["terrain.glb", "terrain.obj"] {
        let said = place.json(&format!("convert terrain.ply {output} --memory 16M"));
        let peak = said["peak_rss_bytes"].as_u64().unwrap();
        assert!(peak <= 48 << 20, "{peak} bytes for {output}");
        assert_eq!(said["triangles"], 1_500_000);
    }
}
