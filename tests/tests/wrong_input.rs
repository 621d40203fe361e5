//! Whatever is wrong with what the program is given, it ends with exit code 1 (failed) or 2 (wrong usage), with one
//! message that names the file and the place, without a panic, without anything on standard output, and with every file
//! in the folder as it was: no partial output, no temporary file, a previous output untouched.
//!
//! [`Workplace::refuses`] holds every run here against all of that.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::fs::{self, File, Permissions};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};

use vdt_tests::mesh_files::{
    Coordinates, Encoding, glb, gltf, gltf_buffer, obj, off, ply, read_ply, stl_ascii, stl_binary, surface,
};
use vdt_tests::program::{Workplace, finish};
use vdt_tests::random_mesh::{closed_box, sphere};
use vdt_tests::workplace;

/// A folder with the mesh of a box and its model.
fn place_with_box() -> Workplace {
    let place = workplace!();
    place.write("box.ply", ply(&closed_box(), Encoding::LittleEndian, Coordinates::Float));
    place.json("build box.ply -o box.vdt");
    place
}

/// The same with a terrain, of several meta-nodes.
fn place_with_terrain() -> Workplace {
    let place = workplace!();
    place.json("generate terrain --triangles 3000 -o terrain.ply");
    place.json("build terrain.ply -o terrain.vdt --blocking forest:8K,4");
    place
}

/// Every command that reads a mesh refuses this one.
fn refuses_mesh(place: &Workplace, mesh: &str, says: &[&str]) {
    let says = [&[mesh], says].concat();
    place.refuses(1, &format!("build {mesh} -o new.vdt"), &says);
    // With a previous output that may be replaced, but must not be by nothing.
    place.refuses(1, &format!("build {mesh} -o box.vdt --force"), &says);
    place.refuses(1, &format!("build {mesh} -o new.vdt --dry-run --json"), &says);
    place.refuses(1, &format!("build box.ply {mesh} -o new.vdt"), &says);
    place.refuses(1, &format!("verify box.vdt --against {mesh}"), &says);
    place.refuses(1, &format!("info {mesh}"), &says);
}

/// Every command that reads a model refuses this one.
fn refuses_model(place: &Workplace, model: &str, says: &[&str]) {
    let says = [&[model], says].concat();
    place.refuses(1, &format!("verify {model}"), &says);
    place.refuses(1, &format!("verify {model} --json"), &says);
    place.refuses(1, &format!("navigate {model} --path orbit:5 --frame-rate 0 --csv new.csv"), &says);
    place.refuses(1, &format!("extract {model} -o new.ply --error 0"), &says);
    place.refuses(1, &format!("extract {model} -o new.ply --triangles 100"), &says);
    place.refuses(1, &format!("extract {model} -o new.ply --camera 9,9,9,0,0,0"), &says);
}

#[test]
fn files_that_are_not_there_or_no_files() {
    let place = place_with_box();
    fs::create_dir(place.path("folder")).unwrap();
    fs::create_dir(place.path("folder.ply")).unwrap();
    symlink("nowhere.ply", place.path("dangling.ply")).unwrap();
    for missing in ["missing.ply", "missing", "no/such/folder/mesh.ply", "dangling.ply"] {
        refuses_mesh(&place, missing, &["No such file"]);
        refuses_model(&place, missing, &["No such file"]);
    }
    for folder in ["folder", "folder.ply", "folder/", "."] {
        refuses_mesh(&place, folder, &["directory"]);
        refuses_model(&place, folder, &["directory"]);
    }
    let message = place.refuses(1, "build box.ply/inside.ply -o new.vdt", &["box.ply/inside.ply"]);
    assert!(message.contains("Not a directory"), "{message}");
    place.refuses(1, "navigate box.vdt --path missing.txt", &["missing.txt", "No such file"]);
    place.refuses(1, "navigate box.vdt --path folder", &["folder", "directory"]);
}

#[test]
fn files_that_hold_no_mesh() {
    let place = place_with_box();
    for name in ["empty", "empty.ply", "empty.obj", "empty.stl", "empty.off", "empty.gltf", "empty.glb"] {
        place.write(name, "");
        refuses_mesh(&place, name, &["empty"]);
    }
    let letter = "Dear Sir or Madam,\nplease find enclosed no mesh at all.\nYours, 3 4 5\n";
    let noise: Vec<u8> = (0..10_000_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    for (name, bytes) in [
        ("letter.txt", letter.as_bytes()),
        ("letter", letter.as_bytes()),
        ("letter.ply", letter.as_bytes()),
        ("letter.obj", letter.as_bytes()),
        ("letter.stl", letter.as_bytes()),
        ("letter.off", letter.as_bytes()),
        ("letter.gltf", letter.as_bytes()),
        ("noise.bin", &noise),
        ("noise.ply", &noise),
        ("noise.obj", &noise),
        ("noise.stl", &noise),
        ("noise.glb", &noise),
        ("zeros.ply", &[0; 500]),
        ("zeros.stl", &[0; 500]),
        ("newlines.obj", b"\n\n\n\n"),
        ("json.gltf", b"{\"a\": [1, 2, 3]}"),
        ("word.ply", b"ply"),
        ("magic.glb", b"glTF"),
    ] {
        place.write(name, bytes);
        refuses_mesh(&place, name, &[]);
    }
    place.refuses(1, "info letter.txt", &["not a mesh in a known format", "PLY, OBJ, STL, OFF", "glTF"]);
}

/// Cut off anywhere, a mesh file is refused: never taken for a smaller mesh.
#[test]
fn a_mesh_cut_off_anywhere() {
    let place = place_with_box();
    let mesh = closed_box();
    place.write("buffer.bin", gltf_buffer(&mesh, 2));
    // Each with what may be missing at its end, for it says nothing.
    for (name, bytes, idle) in [
        ("ascii.ply", ply(&mesh, Encoding::Ascii, Coordinates::Float), "\n"),
        ("little.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Double), ""),
        ("big.ply", ply(&mesh, Encoding::BigEndian, Coordinates::Float), ""),
        ("binary.stl", stl_binary(&mesh), ""),
        ("binary.glb", glb(&mesh, 2), ""),
        ("document.gltf", gltf(&mesh, 2, "buffer.bin"), ""),
        ("text.off", off(&mesh), " 255 0 0\n"),
        ("text.stl", stl_ascii(&mesh), "endsolid by hand\n"),
    ] {
        place.write(name, &bytes);
        place.run(&format!("info {name}")).success();
        assert!(bytes.ends_with(idle.as_bytes()));
        let end = bytes.len() - idle.len();
        let cut = format!("cut-{name}");
        for length in (0..end).filter(|length| *length < 60 || length % 7 == 0 || *length > end - 30) {
            place.write(&cut, &bytes[..length]);
            place.refuses(1, &format!("info {cut}"), &[&cut]);
        }
        place.write(&cut, &bytes[..end - 1]);
        refuses_mesh(&place, &cut, &[]);
    }
    place.write("buffer.bin", &gltf_buffer(&mesh, 2)[..100]);
    place.refuses(1, "build document.gltf -o new.vdt", &["buffer.bin", "100"]);
    fs::remove_file(place.path("buffer.bin")).unwrap();
    place.refuses(1, "build document.gltf -o new.vdt", &["buffer.bin", "No such file"]);
}

#[test]
fn truncated_bodies_say_where_they_end() {
    let place = place_with_box();
    let mesh = closed_box();
    let bytes = ply(&mesh, Encoding::LittleEndian, Coordinates::Float);
    let faces = 13 * mesh.triangles.len();
    place.write("faces.ply", &bytes[..bytes.len() - 30]);
    refuses_mesh(&place, "faces.ply", &["face 9", "12 faces"]);
    place.write("vertices.ply", &bytes[..bytes.len() - faces - 20]);
    refuses_mesh(&place, "vertices.ply", &["vertex 6", "8 vertices"]);
    let text = String::from_utf8(ply(&mesh, Encoding::Ascii, Coordinates::Float)).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    place.write("rows.ply", lines[..lines.len() - 2].join("\n"));
    refuses_mesh(&place, "rows.ply", &["face 10"]);
    place.write("header.ply", lines[..6].join("\n"));
    refuses_mesh(&place, "header.ply", &["header", "end_header"]);
    // A header may promise the world: nothing is reserved for it.
    let row = lines.iter().position(|line| *line == "end_header").unwrap() + 1;
    let promise = lines[..row].join("\n").replace("element vertex 8", "element vertex 4000000000000");
    place.write("promise.ply", format!("{promise}\n1 2 3\n4 5 6\n"));
    refuses_mesh(&place, "promise.ply", &["vertex 2", "4000000000000 vertices"]);
}

#[test]
fn faces_that_name_no_vertex() {
    let place = place_with_box();
    let mut mesh = closed_box();
    mesh.triangles[7][1] = 8;
    for (name, bytes) in [
        ("ascii.ply", ply(&mesh, Encoding::Ascii, Coordinates::Float)),
        ("little.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Double)),
        ("big.ply", ply(&mesh, Encoding::BigEndian, Coordinates::Float)),
        ("text.off", off(&mesh)),
        ("text.obj", obj(&mesh)),
    ] {
        place.write(name, bytes);
        refuses_mesh(&place, name, &["face 7", "corner 1", "vertex 8", "8 vertices"]);
    }
    // glTF has no faces, but a list of corners.
    place.write("binary.glb", glb(&mesh, 1));
    refuses_mesh(&place, "binary.glb", &["primitive 0", "corner 22", "vertex 8", "8 vertices"]);
    mesh.triangles[7][1] = u32::MAX;
    for (name, encoding) in [("ascii.ply", Encoding::Ascii), ("little.ply", Encoding::LittleEndian)] {
        place.write(name, ply(&mesh, encoding, Coordinates::Float));
        refuses_mesh(&place, name, &["face 7"]);
    }
    // In OBJ 0 is no vertex, and backwards there are only so many.
    let good = String::from_utf8(obj(&closed_box())).unwrap();
    for (corner, says) in [
        ("0", "line 22"),
        ("-9", "line 22"),
        ("9", "face 12"),
        ("1.5", "line 22"),
        ("x", "line 22"),
        ("1e99", "line 22"),
    ] {
        place.write("corner.obj", format!("{good}f 1 {corner} 2\n"));
        refuses_mesh(&place, "corner.obj", &[says]);
    }
}

#[test]
fn coordinates_that_are_no_numbers() {
    let place = place_with_box();
    for (value, shown) in [(f64::NAN, "NaN"), (f64::INFINITY, "inf"), (f64::NEG_INFINITY, "-inf")] {
        let mut mesh = closed_box();
        mesh.positions[5][1] = value;
        for (name, bytes) in [
            ("ascii.ply", ply(&mesh, Encoding::Ascii, Coordinates::Float)),
            ("little.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Double)),
            ("big.ply", ply(&mesh, Encoding::BigEndian, Coordinates::Float)),
            ("text.off", off(&mesh)),
            ("text.obj", obj(&mesh)),
        ] {
            place.write(name, bytes);
            refuses_mesh(&place, name, &["vertex 5", "coordinate y", shown]);
        }
        // A soup numbers its vertices on its own; a binary glTF has no text for such values but in its buffer.
        place.write("binary.stl", stl_binary(&mesh));
        refuses_mesh(&place, "binary.stl", &["vertex ", "coordinate y", shown]);
        let mut bytes = glb(&closed_box(), 2);
        let first = bytes.len() - 8 * 12 - 2 * 36;
        bytes[first + 64..first + 68].copy_from_slice(&(value as f32).to_le_bytes());
        place.write("binary.glb", bytes);
        refuses_mesh(&place, "binary.glb", &["vertex 5", "coordinate y", shown]);
    }
    let mut mesh = closed_box();
    mesh.positions[5][1] = 1e39;
    place.write("large.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Double));
    let says = ["large.ply", "vertex 5", "too large"];
    place.refuses(1, "build large.ply -o new.vdt", &says);
    place.refuses(1, "verify box.vdt --against large.ply", &says);
    let text = String::from_utf8(ply(&closed_box(), Encoding::Ascii, Coordinates::Float)).unwrap();
    for word in ["one", "1,0", "0x10", "--1", "1e"] {
        place.write("word.ply", text.replacen("1 0 0\n", &format!("1 {word} 0\n"), 1));
        refuses_mesh(&place, "word.ply", &["vertex 1", "line 12", word]);
    }
}

/// Every byte of a model counts: with any one of them flipped, `verify` refuses it.
#[test]
fn a_model_with_any_one_byte_flipped() {
    let place = place_with_box();
    let good = place.read("box.vdt");
    place.json("verify box.vdt");
    for offset in 0..good.len() {
        let mut bytes = good.clone();
        bytes[offset] ^= 1 << (offset % 8);
        place.write("flipped.vdt", bytes);
        place.refuses(1, "verify flipped.vdt", &["flipped.vdt"]);
    }
}

/// What is read first is judged by every command, and says where it is wrong.
#[test]
fn a_model_with_a_flipped_byte_in_each_part() {
    let place = place_with_terrain();
    let good = place.read("terrain.vdt");
    let info = place.json("info terrain.vdt");
    assert!(info["meta_nodes"].as_u64().unwrap() > 10);
    let flip = |name: &str, offset: usize| {
        let mut bytes = good.clone();
        bytes[offset] ^= 0x10;
        place.write(name, bytes);
    };
    flip("magic.vdt", 3);
    refuses_model(&place, "magic.vdt", &["not a vdt model", "vdt build"]);
    flip("version.vdt", 8);
    refuses_model(&place, "version.vdt", &["version"]);
    for offset in [20, 60, 100, 140, 200, 253] {
        flip("header.vdt", offset);
        refuses_model(&place, "header.vdt", &["header"]);
        place.refuses(1, "info header.vdt", &["header.vdt", "header"]);
    }
    let tables = 256..256 + 60 + 16 + 4;
    for offset in [tables.start, tables.start + 30, tables.start + 65, tables.end - 1] {
        flip("table.vdt", offset);
        refuses_model(&place, "table.vdt", &["root table"]);
        place.refuses(1, "info table.vdt", &["table.vdt", "root table"]);
    }
    let pages = tables.end + info["bytes_by_part"]["coder_tables"].as_u64().unwrap() as usize;
    for offset in [tables.end, (tables.end + pages) / 2, pages - 1] {
        flip("coder.vdt", offset);
        refuses_model(&place, "coder.vdt", &["coder's tables"]);
        place.refuses(1, "info coder.vdt", &["coder.vdt", "coder's tables"]);
    }
    // The first page is needed whatever is drawn, and by `info` to say how full it is.
    for offset in [pages, pages + 77, pages + 1000] {
        flip("page.vdt", offset);
        refuses_model(&place, "page.vdt", &["meta-node 0"]);
        place.refuses(1, "info page.vdt", &["page.vdt", "meta-node 0"]);
    }
    // The last one by whoever wants everything.
    for offset in [good.len() - 1, good.len() - 100] {
        flip("last.vdt", offset);
        let last = format!("meta-node {}", info["meta_nodes"].as_u64().unwrap() - 1);
        place.refuses(1, "verify last.vdt", &["last.vdt", &last]);
        place.refuses(1, "extract last.vdt -o new.ply --error 0", &["last.vdt", &last]);
        place.refuses(
            1,
            "navigate last.vdt --path flyby:5 --pixels 0.0001 --io sync --csv new.csv",
            &["last.vdt", &last],
        );
        place.refuses(1, "navigate last.vdt --path flyby:50 --pixels 0.0001 --csv new.csv", &["last.vdt", &last]);
    }
}

#[test]
fn a_model_cut_off_or_longer() {
    let place = place_with_terrain();
    let good = place.read("terrain.vdt");
    for length in [0, 1, 7, 8, 100, 255, 256, 300, 335, 336, 5000, good.len() / 2, good.len() - 1] {
        place.write("cut.vdt", &good[..length]);
        refuses_model(&place, "cut.vdt", &[]);
        place.refuses(1, "info cut.vdt", &["cut.vdt"]);
    }
    place.write("cut.vdt", &good[..good.len() - 1]);
    refuses_model(&place, "cut.vdt", &[&good.len().to_string(), &(good.len() - 1).to_string()]);
    place.write("long.vdt", [good.as_slice(), b"more"].concat());
    refuses_model(&place, "long.vdt", &["appended"]);
}

/// Mesh and model mixed up; and a model of another mesh.
#[test]
fn one_kind_of_file_for_the_other() {
    let place = place_with_box();
    refuses_model(&place, "box.ply", &["not a vdt model"]);
    place.write("letter.txt", "Dear Sir or Madam");
    refuses_model(&place, "letter.txt", &["not a vdt model"]);
    place.refuses(1, "build box.vdt -o new.vdt", &["box.vdt", "not a mesh"]);
    place.refuses(1, "verify box.vdt --against box.vdt", &["box.vdt", "not a mesh"]);
    place.refuses(1, "navigate box.vdt --path box.ply", &["box.ply", "line 1"]);
    place.write("ball.ply", ply(&sphere(1, 0.0, 1), Encoding::Ascii, Coordinates::Float));
    place.refuses(1, "verify box.vdt --against ball.ply", &["box.vdt", "not this mesh", "12 triangles"]);
    let mut other = closed_box();
    other.positions[3][0] = f64::from(1.0_f32.next_up());
    place.write("nearly.ply", ply(&other, Encoding::Ascii, Coordinates::Float));
    place.refuses(1, "verify box.vdt --against nearly.ply", &["box.vdt", "not this mesh"]);
    let mut turned = closed_box();
    turned.triangles[5].swap(0, 1);
    place.write("turned.ply", ply(&turned, Encoding::Ascii, Coordinates::Float));
    place.refuses(1, "verify box.vdt --against turned.ply", &["box.vdt", "not this mesh"]);
}

/// What is there is not replaced unless one says so, and not lost when the run fails.
#[test]
fn outputs_that_exist() {
    let place = place_with_box();
    for (command, output) in [
        ("build box.ply -o", "old.vdt"),
        ("generate sphere --triangles 20 -o", "old.ply"),
        ("extract box.vdt --error 0 -o", "old.ply"),
        ("extract box.vdt --camera 9,9,9,0,0,0 -o", "old.ply"),
        ("navigate box.vdt --path orbit:3 --frame-rate 0 --csv", "old.csv"),
    ] {
        place.write(output, "precious");
        place.refuses(1, &format!("{command} {output}"), &[output, "exists", "--force"]);
        place.run(&format!("{command} {output} --force")).success();
        assert_ne!(place.read(output), b"precious", "{command}");
        place.write(output, "precious");
        place.refuses(
            1,
            &format!("{command} nowhere/{output}"),
            &[&format!("nowhere/{output}"), "no directory nowhere"],
        );
        place.refuses(1, &format!("{command} nowhere/{output} --force"), &["no directory nowhere"]);
        place.refuses(1, &format!("{command} box.ply/{output} --force"), &["box.ply"]);
        let folder = format!("folder-{output}");
        fs::create_dir_all(place.path(&folder)).unwrap();
        place.refuses(1, &format!("{command} {folder}"), &[&folder, "directory"]);
        place.refuses(1, &format!("{command} {folder} --force"), &[&folder, "directory"]);
    }
    place.refuses(1, "extract box.vdt --error 0 -o mesh.stl", &["mesh.stl", "PLY"]);
    place.refuses(1, "extract box.vdt --error 0 -o mesh", &["mesh", "PLY"]);
    // A demo makes its folder, but not out of a file.
    place.refuses(1, "demo --triangles 100 --frames 2 -o box.ply", &["box.ply"]);
}

/// Not even with `--force` does an output take the place of what it is made from.
#[test]
fn outputs_that_are_inputs() {
    let place = place_with_box();
    fs::create_dir(place.path("folder")).unwrap();
    symlink("box.ply", place.path("link.ply")).unwrap();
    for output in ["box.ply", "./box.ply", "folder/../box.ply", "link.ply"] {
        place.refuses(1, &format!("build box.ply -o {output} --force"), &["box.ply"]);
        place.refuses(1, &format!("build link.ply -o {output} --force"), &[".ply"]);
    }
}

/// The same for a model, and for a camera path.
#[test]
fn outputs_that_are_models_or_paths() {
    let place = place_with_box();
    fs::copy(place.path("box.vdt"), place.path("model.ply")).unwrap();
    place.refuses(1, "extract model.ply -o model.ply --error 0 --force", &["model.ply"]);
    place.refuses(1, "navigate box.vdt --path orbit:3 --csv box.vdt --force", &["box.vdt"]);
    place.write("path.txt", "9 9 9 0 0 0 0 0 1 60\n");
    place.refuses(1, "navigate box.vdt --path path.txt --csv path.txt --force", &["path.txt"]);
}

#[test]
fn wrong_usage() {
    let place = place_with_box();
    for (arguments, says) in [
        ("", "Usage: vdt"),
        ("fly", "fly"),
        ("--fast", "--fast"),
        ("build", "<MESH>"),
        ("build box.ply", "--output"),
        ("build -o new.vdt", "<MESH>"),
        ("build box.ply -o", "--output"),
        ("build box.ply -o new.vdt -o newer.vdt", "--output"),
        ("build box.ply -o new.vdt --memory", "--memory"),
        ("build box.ply -o new.vdt --memory lots", "lots"),
        ("build box.ply -o new.vdt --memory -5", "-5"),
        ("build box.ply -o new.vdt --memory 99999999999T", "99999999999T"),
        ("build box.ply -o new.vdt --metric cubic", "cubic"),
        ("build box.ply -o new.vdt --strategy luck", "luck"),
        ("build box.ply -o new.vdt --blocking levels", "levels:5"),
        ("build box.ply -o new.vdt --blocking forest:K", "forest:32K,8"),
        ("build box.ply -o new.vdt --blocking forest:1K,8", "1"),
        ("build box.ply -o new.vdt --blocking forest:32K,1", "1"),
        ("build box.ply -o new.vdt --blocking levels:0", "0"),
        ("build box.ply -o new.vdt --blocking levels:4000000000", "4000000000"),
        ("build box.ply -o new.vdt --blocking forest:32K,x", "forest:32K,x"),
        ("build box.ply -o new.vdt --blocking levels:-1", "levels:-1"),
        ("build box.ply -o new.vdt --blocking trees:5", "trees:5"),
        ("build box.ply -o new.vdt --colour", "--colour"),
        ("generate", "--triangles"),
        ("generate sphere --triangles 20", "--output"),
        ("generate sphere -o new.ply", "--triangles"),
        ("generate cube --triangles 20 -o new.ply", "cube"),
        ("generate sphere --triangles many -o new.ply", "many"),
        ("generate sphere --triangles -20 -o new.ply", "-2"),
        ("generate sphere --triangles 2e3 -o new.ply", "2e3"),
        ("generate sphere --triangles 20 --seed x -o new.ply", "--seed"),
        ("info", "<FILE>"),
        ("info box.ply box.vdt", "box.vdt"),
        ("verify", "<MODEL.vdt>"),
        ("verify box.vdt --against", "--against"),
        ("verify box.vdt --memory x", "--memory"),
        ("extract box.vdt -o new.ply", "--error"),
        ("extract box.vdt --error 0", "--output"),
        ("extract -o new.ply --error 0", "<MODEL.vdt>"),
        ("extract box.vdt -o new.ply --error 0 --triangles 5", "--triangles"),
        ("extract box.vdt -o new.ply --error 0 --camera 1,2,3,4,5,6", "--camera"),
        ("extract box.vdt -o new.ply --error -1", "-1"),
        ("extract box.vdt -o new.ply --error=-1", "-1"),
        ("extract box.vdt -o new.ply --error much", "much"),
        ("extract box.vdt -o new.ply --error NaN", "NaN"),
        ("extract box.vdt -o new.ply --error 1%%", "1%%"),
        ("extract box.vdt -o new.ply --triangles some", "some"),
        ("extract box.vdt -o new.ply --camera 1,2,3", "1,2,3"),
        ("extract box.vdt -o new.ply --camera 1,2,3,4,5,six", "six"),
        ("extract box.vdt -o new.ply --camera 1,2,3,4,5,6 --pixels 0", "--pixels"),
        ("extract box.vdt -o new.ply --camera 1,2,3,4,5,6 --pixels NaN", "NaN"),
        ("extract box.vdt -o new.ply --camera 1,2,3,4,5,6 --size big", "big"),
        ("navigate box.vdt", "--path"),
        ("navigate --path orbit:3", "<MODEL.vdt>"),
        ("navigate box.vdt --path orbit:", "orbit:"),
        ("navigate box.vdt --path orbit:0", "orbit:0"),
        ("navigate box.vdt --path orbit:-3", "orbit:-3"),
        ("navigate box.vdt --path flyby:many", "flyby:many"),
        ("navigate box.vdt --path orbit:3 --memory 1X", "1X"),
        ("navigate box.vdt --path orbit:3 --pixels 0", "--pixels"),
        ("navigate box.vdt --path orbit:3 --pixels inf", "inf"),
        ("navigate box.vdt --path orbit:3 --size 1920", "1920x1080"),
        ("navigate box.vdt --path orbit:3 --size 0x100", "0x100"),
        ("navigate box.vdt --path orbit:3 --size 100x99999999", "100x99999999"),
        ("navigate box.vdt --path orbit:3 --dependency much", "much"),
        ("navigate box.vdt --path orbit:3 --io magic", "magic"),
        ("navigate box.vdt --path orbit:3 --max-triangles few", "few"),
        ("navigate box.vdt --path orbit:3 --frame-rate -1", "-1"),
        ("navigate box.vdt --path orbit:3 --frame-rate NaN", "NaN"),
        ("demo --triangles x", "--triangles"),
        ("demo --frames -1", "-1"),
        ("demo here", "here"),
    ] {
        if arguments.is_empty() {
            // No command at all is answered with the help.
            let outcome = place.run(arguments);
            assert_eq!((outcome.status.code(), outcome.stdout.as_str()), (Some(2), ""));
            assert!(outcome.stderr.contains(says), "{outcome:?}");
            continue;
        }
        place.refuses(2, arguments, &[says]);
    }
}

/// What means nothing without a camera is not passed over in silence where there is none.
#[test]
fn options_of_a_camera_without_one() {
    let place = place_with_box();
    for cut in ["--error 0", "--triangles 5"] {
        for option in ["--pixels 2", "--size 640x480", "--memory 16M"] {
            place.refuses(2, &format!("extract box.vdt -o new.ply {cut} {option}"), &["--camera"]);
        }
    }
}

/// What only the command itself can see to be wrong.
#[test]
fn values_out_of_range() {
    let place = place_with_box();
    for (arguments, says) in [
        ("extract box.vdt -o new.ply --camera 1,2,3,1,2,3", "the same point"),
        ("extract box.vdt -o new.ply --camera 1,2,3,1,2,NaN", "not finite"),
        ("extract box.vdt -o new.ply --camera 1,2,3,1,inf,3", "not finite"),
    ] {
        place.refuses(1, arguments, &[says]);
    }
    for number in ["0", "9", "1000000001"] {
        place.refuses(2, &format!("generate sphere --triangles {number} -o new.ply"), &[number, "10..=1000000000"]);
    }
}

/// What goes wrong in a step of the demo is told once.
#[test]
fn a_demo_that_cannot_be() {
    let place = workplace!();
    for (arguments, says) in [
        ("demo --triangles 3 --frames 2 -o new", "3"),
        ("demo --triangles 100 --frames 0 -o new", "0"),
        ("demo --triangles 5000 --frames 2 --build-memory 10K -o new", "memory"),
        ("demo --triangles 5000 --frames 2 --memory 10K -o new", "memory"),
    ] {
        let outcome = place.run(arguments);
        assert!([Some(1), Some(2)].contains(&outcome.status.code()), "{outcome:?}");
        let begins = if outcome.status.code() == Some(2) { "error: " } else { "vdt: " };
        assert_eq!(outcome.stderr.lines().filter(|line| line.starts_with(begins)).count(), 1, "{outcome:?}");
        assert!(outcome.stderr.contains(says), "{outcome:?}");
    }
}

/// The number behind `--memory` in a message.
fn advised_memory(message: &str) -> String {
    message.rsplit_once("--memory ").expect("the message says what would do").1.trim_end().to_owned()
}

/// The next smaller number that one could write.
fn less(memory: &str) -> String {
    let (number, unit) = memory.split_at(memory.len() - 1);
    format!("{}{unit}", number.parse::<u64>().unwrap() - 1)
}

/// Where the memory does not suffice, the program says so before it starts, with the smallest number that works: it
/// works, and less does not.
#[test]
fn too_little_memory() {
    let place = place_with_terrain();
    place.json("generate city --triangles 20000 -o city.ply");
    place.json("build city.ply -o city.vdt");
    for command in [
        "build city.ply -o new.vdt --force --memory",
        "build city.ply -o new.vdt --force --strategy btree --memory",
        "build city.ply terrain.ply -o new.vdt --force --memory",
        "verify city.vdt --against city.ply --memory",
        "navigate city.vdt --path flyby:3 --frame-rate 0 --memory",
        "navigate terrain.vdt --path flyby:3 --io sync --memory",
        "extract terrain.vdt --camera 9,9,9,0,0,0 -o new.ply --force --memory",
    ] {
        for memory in ["0", "1000", "20K"] {
            let enough = advised_memory(&place.refuses(1, &format!("{command} {memory}"), &["--memory"]));
            let too_little = less(&enough);
            let again = place.refuses(1, &format!("{command} {too_little}"), &["--memory"]);
            assert_eq!(advised_memory(&again), enough, "{command}");
            place.run(&format!("{command} {enough}")).success();
            for made in ["new.vdt", "new.ply"] {
                let _ = fs::remove_file(place.path(made));
            }
        }
    }
    // A dry run tells the same number, and whether it is there.
    let dry = place.json("build city.ply -o new.vdt --dry-run --memory 1M");
    assert_eq!(dry["fits"], false);
    let needed = dry["memory_needed_bytes"].as_u64().unwrap();
    let enough = place.json(&format!("build city.ply -o new.vdt --dry-run --memory {needed}"));
    assert_eq!((&enough["fits"], &enough["memory_bytes"]), (&true.into(), &needed.into()));
    place.refuses(1, &format!("build city.ply -o new.vdt --memory {}", needed - 1), &["city.ply", "--memory"]);
    assert!(!place.names().contains("new.vdt"));
    place.json(&format!("build city.ply -o new.vdt --memory {needed}"));
}

/// Who navigates several models has to know which one it is.
#[test]
fn too_little_memory_is_said_of_a_file() {
    let place = place_with_box();
    place.refuses(1, "build box.ply -o new.vdt --memory 1K", &["box.ply", "--memory"]);
    place.refuses(1, "verify box.vdt --against box.ply --memory 100", &["box.ply", "--memory"]);
    place.refuses(1, "navigate box.vdt --path orbit:3 --memory 1K", &["box.vdt", "--memory"]);
    place.refuses(1, "extract box.vdt -o new.ply --camera 9,9,9,0,0,0 --memory 1K", &["box.vdt", "--memory"]);
}

/// A disk on which there is room for `blocks` of 512 bytes in a file and no more.
fn on_full_disk(place: &Workplace, blocks: u32, arguments: &str) -> Command {
    let mut shell = Command::new("sh");
    // The signal would end the program; ignored, the write fails as on a full disk.
    shell.args(["-c", &format!(r#"trap "" XFSZ; ulimit -f {blocks}; exec "$0" "$@""#)]);
    shell.arg(place.program()).args(arguments.split(' ')).current_dir(place.folder());
    shell
}

#[test]
fn a_full_disk() {
    let place = place_with_terrain();
    for (command, output) in [
        ("build terrain.ply -o", "old.vdt"),
        ("generate city --triangles 5000 -o", "old.ply"),
        ("extract terrain.vdt --error 0 -o", "old.ply"),
        ("extract terrain.vdt --pixels 0.01 --camera 1,1,9,0,0,0 -o", "old.ply"),
        ("navigate terrain.vdt --path orbit:200 --frame-rate 0 --csv", "old.csv"),
    ] {
        place.write(output, "precious");
        let arguments = format!("{command} {output} --force");
        let before = place.contents();
        // The very first bytes, some, and all but the last.
        for blocks in [0, 3, 11] {
            let outcome = finish(on_full_disk(&place, blocks, &arguments), &arguments);
            outcome.refusal(1, &[output, "cannot write"]);
            assert!(place.contents() == before, "{arguments}: {:?}", place.names());
        }
        finish(on_full_disk(&place, 1 << 16, &arguments), &arguments).success();
        assert_ne!(place.read(output), b"precious", "{arguments}");
    }
}

/// Nobody listens: that is no reason to panic. A disk that is full for the output of the program itself is one to fail.
#[test]
fn standard_output_that_takes_nothing() {
    let place = place_with_box();
    let commands = [
        "info box.vdt",
        "info box.ply --json",
        "verify box.vdt",
        "build box.ply -o new.vdt --dry-run",
        "navigate box.vdt --path orbit:3 --frame-rate 0",
        "demo --triangles 100 --frames 2 -o demo",
    ];
    for command in commands {
        let words: Vec<&str> = command.split(' ').collect();
        let run = |stdout: Stdio| {
            let mut child = place.command(&words);
            let output = child.stdin(Stdio::null()).stdout(stdout).stderr(Stdio::piped()).output().unwrap();
            (output.status.code(), String::from_utf8(output.stderr).unwrap())
        };
        let (code, message) = run(File::options().write(true).open("/dev/full").unwrap().into());
        assert_eq!(code, Some(1), "`vdt {command}` on a full disk: {message}");
        assert!(message.starts_with("vdt: ") && message.lines().count() == 1, "{command}: {message}");
        assert!(message.contains("No space left"), "{command}: {message}");

        // A pipe whose other end is closed.
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let (code, message) = run(writer.into());
        assert_eq!((code, message.as_str()), (Some(0), ""), "`vdt {command}` into a closed pipe");
    }
}

/// Files that one may not read, folders that one may not write to: as another user where this is root, who may all.
#[test]
fn files_that_may_not_be_read() {
    /// Whoever has no rights of their own.
    const NOBODY: u32 = 65_534;
    let place = place_with_box();
    // Where the program and the folder are may be out of bounds too.
    let folder = tempfile::Builder::new().prefix("vdt-").tempdir().unwrap();
    let open = |mode| Permissions::from_mode(mode);
    let path = |name: &str| folder.path().join(name);
    // Not by this process: while another test starts a program, that one would hold the copy open for writing.
    assert!(Command::new("cp").arg(place.program()).arg(path("vdt")).status().unwrap().success());
    for name in ["box.ply", "box.vdt"] {
        fs::copy(place.path(name), path(name)).unwrap();
        fs::set_permissions(path(name), open(0o000)).unwrap();
    }
    fs::set_permissions(path("vdt"), open(0o755)).unwrap();
    fs::copy(place.path("box.ply"), path("open.ply")).unwrap();
    fs::set_permissions(path("open.ply"), open(0o444)).unwrap();
    fs::set_permissions(folder.path(), open(0o555)).unwrap();
    let is_root = fs::metadata("/proc/self").is_ok_and(|process| {
        use std::os::unix::fs::MetadataExt;
        process.uid() == 0
    });
    let run = |arguments: &str| {
        let mut command = Command::new(path("vdt"));
        command.args(arguments.split(' ')).current_dir(folder.path());
        if is_root {
            command.uid(NOBODY).gid(NOBODY);
        }
        finish(command, arguments)
    };
    run("info open.ply").success();
    run("info box.ply").refusal(1, &["box.ply", "Permission denied"]);
    run("verify box.vdt").refusal(1, &["box.vdt", "Permission denied"]);
    run("build open.ply -o new.vdt").refusal(1, &["new.vdt", "Permission denied"]);
    run("generate sphere --triangles 20 -o new.ply").refusal(1, &["new.ply", "Permission denied"]);
    run("demo --triangles 100 --frames 2 -o new").refusal(1, &["new", "Permission denied"]);
    fs::set_permissions(folder.path(), open(0o755)).unwrap();
}

/// Names that are no text are names like others.
#[test]
fn names_that_are_not_unicode() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let place = place_with_box();
    let name = OsStr::from_bytes(b"b\xffx.ply");
    let missing = OsStr::from_bytes(b"m\xffssing.ply");
    fs::copy(place.path("box.ply"), place.folder().join(name)).unwrap();
    let run = |words: &[&OsStr]| {
        let mut command = place.command(&[]);
        command.args(words);
        finish(command, "with a name that is not Unicode")
    };
    let [build, verify, against, output] = ["build", "verify", "--against", "-o"].map(OsStr::new);
    run(&[build, name, output, OsStr::from_bytes(b"n\xffw.vdt")]).success();
    run(&[verify, OsStr::from_bytes(b"n\xffw.vdt"), against, name]).success();
    run(&[build, missing, output, OsStr::new("new.vdt")]).refusal(1, &["ssing.ply", "No such file"]);
    run(&[OsStr::new("navigate"), OsStr::new("box.vdt"), OsStr::new("--path"), missing]).refusal(2, &["UTF-8"]);
}

/// The box is still what it was, whatever was tried with it: the refusals above are not those of a program that can do
/// nothing at all.
#[test]
fn the_box_itself_is_fine() {
    let place = place_with_box();
    place.json("verify box.vdt --against box.ply");
    place.json("extract box.vdt -o back.ply --error 0");
    assert_eq!(surface(&read_ply(&place.read("back.ply"))), surface(&closed_box()));
    place.json("navigate box.vdt --path orbit:5 --frame-rate 0 --csv new.csv");
    place.json("extract box.vdt -o seen.ply --camera 9,9,9,0,0,0");
}
