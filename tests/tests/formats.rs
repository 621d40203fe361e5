//! One mesh, many files: whatever the format and the order of vertices and triangles, the model is the same byte for
//! byte, `verify --against` says that it is that mesh, and fully refined it gives the mesh back.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use serde_json::{Value, json};
use vdt_tests::mesh_files::{
    Coordinates, Encoding, glb, gltf, gltf_buffer, gltf_in_one, obj, off, ply, read_ply, stl_ascii, stl_binary,
    surface, unusual_obj, unusual_ply,
};
use vdt_tests::program::Workplace;
use vdt_tests::random_mesh::{RawMesh, closed_box, sheet};
use vdt_tests::workplace;

/// A mesh of the program's own making.
fn generated(place: &Workplace, shape: &str) -> RawMesh {
    place.json(&format!("generate {shape} -o generated.ply --force"));
    read_ply(&place.read("generated.ply"))
}

/// Writes the mesh in every format that holds doubles; the names of the files.
fn write_exact_formats(place: &Workplace, mesh: &RawMesh) -> Vec<String> {
    let mut files: Vec<(String, Vec<u8>)> = vec![
        ("plain.obj".into(), obj(mesh)),
        ("unusual.obj".into(), unusual_obj(mesh)),
        ("plain.off".into(), off(mesh)),
        ("shuffled.obj".into(), obj(&mesh.shuffled(1))),
        ("shuffled.off".into(), off(&mesh.shuffled(2))),
        ("shuffled.ply".into(), ply(&mesh.shuffled(3), Encoding::LittleEndian, Coordinates::Double)),
    ];
    for encoding in Encoding::ALL {
        files.push((format!("{encoding:?}-double.ply"), ply(mesh, encoding, Coordinates::Double)));
    }
    write_all(place, files)
}

/// The same in the formats, and the types of number, that have single precision; STL has no isolated vertices.
fn write_single_formats(place: &Workplace, mesh: &RawMesh) -> Vec<String> {
    let smallest_index = match mesh.positions.len() {
        ..=0xff => 1,
        0x100..=0xffff => 2,
        _ => 4,
    };
    place.write("buffer.bin", gltf_buffer(mesh, smallest_index));
    let mut files: Vec<(String, Vec<u8>)> = vec![
        ("binary.stl".into(), stl_binary(mesh)),
        ("text.stl".into(), stl_ascii(mesh)),
        ("two-files.gltf".into(), gltf(mesh, smallest_index, "buffer.bin")),
        ("in-one.gltf".into(), gltf_in_one(mesh, 4)),
        ("binary.glb".into(), glb(mesh, 4)),
        ("shuffled.stl".into(), stl_binary(&mesh.shuffled(4))),
        ("shuffled.glb".into(), glb(&mesh.shuffled(5), smallest_index)),
    ];
    for encoding in Encoding::ALL {
        files.push((format!("{encoding:?}-float.ply"), ply(mesh, encoding, Coordinates::Float)));
        files.push((format!("{encoding:?}-unusual.ply"), unusual_ply(mesh, encoding)));
        files.push((format!("{encoding:?}-shuffled.ply"), unusual_ply(&mesh.shuffled(6), encoding)));
    }
    write_all(place, files)
}

fn write_all(place: &Workplace, files: Vec<(String, Vec<u8>)>) -> Vec<String> {
    files.iter().for_each(|(name, bytes)| place.write(name, bytes));
    files.into_iter().map(|(name, _)| name).collect()
}

/// Builds a model of each file, all the same; leaves `model.vdt`, which each file is checked against. Some of the files have normals
/// and more beside the mesh: they are left out.
fn assert_one_model(place: &Workplace, files: &[String]) {
    let first = place.json(&format!("build --positions lossless --no-attributes {} -o model.vdt --force", files[0]));
    for file in files {
        let built = place.json(&format!("build --positions lossless --no-attributes {file} -o other.vdt --force"));
        assert_eq!(built["model_sha256"], first["model_sha256"], "{file} and {}", files[0]);
        assert!(place.read("other.vdt") == place.read("model.vdt"), "{file}");
        let verified = place.json(&format!("verify model.vdt --against {file}"));
        assert_eq!((&verified["sound"], &verified["same_as_mesh"]), (&true.into(), &true.into()), "{file}");
    }
}

/// How often a build warned of something.
fn warning(built: &Value, kind: &str) -> Option<u64> {
    let warnings = built["warnings"].as_array().unwrap();
    warnings.iter().find(|warning| warning["kind"] == kind).map(|warning| warning["count"].as_u64().unwrap())
}

/// Fully refined, the model must be the mesh: its triangles, over bitwise its positions.
fn assert_gives_back(place: &Workplace, mesh: &RawMesh) {
    let expected = surface(mesh);
    let extracted = place.json("extract model.vdt -o back.ply --error 0 --force");
    let back = read_ply(&place.read("back.ply"));
    assert_eq!(back.triangles.len(), expected.len(), "a triangle twice, or one that is none");
    assert!(surface(&back) == expected);
    assert_eq!(extracted["triangles"], expected.len());
    assert_eq!((&extracted["error_stated"], &extracted["guaranteed"]), (&0.0.into(), &true.into()));
}

#[test]
fn generated_meshes_are_the_same_in_every_format() {
    for shape in ["terrain --triangles 3000", "sphere --triangles 2000 --seed 3", "city --triangles 2500"] {
        let place = workplace!();
        let mesh = generated(&place, shape);
        assert!(surface(&mesh).len() > 1900, "{shape}");
        let mut files = vec!["generated.ply".to_owned()];
        files.extend(write_exact_formats(&place, &mesh));
        files.extend(write_single_formats(&place, &mesh));
        assert_one_model(&place, &files);
        assert_gives_back(&place, &mesh);
    }
}

/// The extension of an output says its format, and what is written in it is the same mesh.
#[test]
fn written_meshes_are_the_same_in_every_format() {
    let place = workplace!();
    for name in ["made.ply", "made.OBJ", "made.glb", "made"] {
        place.json(&format!("generate sphere --triangles 3000 --seed 5 -o {name}"));
    }
    assert_eq!(place.read("made"), place.read("made.ply"));
    assert!(place.read("made.OBJ").starts_with(b"# made by: vdt generate sphere"));
    assert_one_model(&place, &["made.ply", "made.OBJ", "made.glb"].map(str::to_owned));
    for cut in ["--triangles 700", "--camera 3,2,1,0,0,0 --pixels 4"] {
        let extracted = ["cut.ply", "cut.obj", "cut.glb"].map(|name| {
            let mut said = place.json(&format!("extract model.vdt -o {name} --force {cut}"));
            let bytes = said["bytes"].take();
            assert_eq!(bytes, place.read(name).len());
            said.as_object_mut().unwrap().remove("peak_rss_bytes").unwrap();
            said
        });
        assert!(extracted.iter().all(|said| *said == extracted[0]), "{extracted:?}");
        for name in ["cut.obj", "cut.glb"] {
            let same = place.json(&format!("compare cut.ply {name} --samples 100"));
            assert!(same["hausdorff"].as_f64().unwrap() < 1e-12, "{same}");
            assert_eq!(same["a_triangles"], same["b_triangles"]);
        }
    }
    for name in ["cut.stl", "cut", "cut.ply.gz"] {
        place.refuses(1, &format!("extract model.vdt -o {name} --error 0"), &[name, "ends in .ply, .obj or .glb"]);
    }
}

/// With isolated vertices far outside, vertices that are there twice, a zero with a minus sign, a triangle that is there
/// twice and one that is degenerate: what one format has and another has not changes nothing.
#[test]
fn what_is_left_out_does_not_matter() {
    let place = workplace!();
    let mut mesh = sheet(9, 7, 0.25, 5, 1);
    mesh.append(&closed_box(), [20.0, 0.0, 0.0]);
    let mut mesh = mesh.in_single_precision();
    let clean = mesh.clone();
    mesh.positions.insert(0, [1e9, -1e9, 1e9]);
    mesh.triangles.iter_mut().flatten().for_each(|corner| *corner += 1);
    mesh.positions.extend([[0.1, 0.2, 0.3], [-5.0, 500.0, 0.0], [-5.0, 500.0, 0.0]].map(|p| p.map(f64::round)));
    // Each corner of the first triangle once more, with the other zero.
    let doubles = mesh.triangles[0].map(|corner| {
        mesh.positions.push(mesh.positions[corner as usize].map(|value| if value == 0.0 { -value } else { value }));
        mesh.positions.len() as u32 - 1
    });
    mesh.triangles.push([doubles[1], doubles[2], doubles[0]]);
    mesh.triangles.push([doubles[0], doubles[0], doubles[1]]);
    let mut files = write_exact_formats(&place, &mesh);
    files.extend(write_single_formats(&place, &mesh));
    place.write("clean.ply", ply(&clean, Encoding::Ascii, Coordinates::Float));
    files.push("clean.ply".into());
    assert_one_model(&place, &files);
    assert_gives_back(&place, &clean);

    let built = place.json("build --positions lossless plain.off -o other.vdt --force");
    assert_eq!(warning(&built, "isolated_vertices"), Some(4));
    assert_eq!(warning(&built, "welded_vertices"), Some(3));
    assert_eq!(warning(&built, "duplicate_triangles"), Some(1));
    assert_eq!(warning(&built, "degenerate_triangles"), Some(1));
    assert_eq!(warning(&built, "polygons"), None);
    assert_eq!((&built["vertices"], &built["triangles"]), (&88.into(), &clean.triangles.len().into()));
    assert_eq!(place.json("build --positions lossless clean.ply -o other.vdt --force")["warnings"], json!([]));
}

/// So far from zero that an origin is kept: single precision comes back to the bit.
#[test]
fn single_precision_far_from_zero_is_the_same_in_every_format() {
    let place = workplace!();
    let mut mesh = sheet(12, 12, 0.3, 3, 2);
    mesh.positions.iter_mut().for_each(|[x, y, z]| (*x, *y, *z) = (*x * 0.5 + 70_000.0, *y * 0.5 - 4321.0, *z));
    let mesh = mesh.in_single_precision();
    let mut files = write_exact_formats(&place, &mesh);
    files.extend(write_single_formats(&place, &mesh));
    assert_one_model(&place, &files);
    assert_ne!(place.json("info model.vdt")["origin"], json!([0.0, 0.0, 0.0]));
    assert_gives_back(&place, &mesh);
}

/// Doubles with more detail at that place than single precision has: the same in all formats that hold doubles.
#[test]
fn doubles_far_from_zero_are_the_same_in_every_format_that_holds_them() {
    let place = workplace!();
    let mut mesh = sheet(12, 12, 0.3, 3, 2);
    mesh.positions.iter_mut().for_each(|[x, y, z]| (*x, *y, *z) = (*x * 0.013 + 412_345.678, *y * 0.017 + 5.1e6, *z));
    let files = write_exact_formats(&place, &mesh);
    assert_one_model(&place, &files);
    let in_single = stl_binary(&mesh);
    place.write("single.stl", in_single);
    place.refuses(1, "verify model.vdt --against single.stl", &["model.vdt", "not this mesh"]);
}

#[test]
fn polygons_and_strips_are_their_triangles() {
    let place = workplace!();
    // A square, a pentagon and a fan, as one would cut them from their first corner.
    let mut mesh = RawMesh::default();
    for index in 0..9_i32 {
        mesh.positions.push([f64::from(index % 3), f64::from(index / 3), f64::from(index * index % 5)]);
    }
    mesh.triangles = vec![[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 8], [1, 8, 4], [3, 4, 7]];
    place.write("triangles.ply", ply(&mesh, Encoding::LittleEndian, Coordinates::Float));
    let positions: Vec<String> = mesh.positions.iter().map(|[x, y, z]| format!("{x} {y} {z}")).collect();
    let rows = positions.join("\n");
    place.write("polygons.off", format!("OFF 9 3 0\n{rows}\n4 0 1 4 3\n5 1 2 5 8 4\n3 3 4 7\n"));
    place.write("polygons.obj", format!("v {}\nf 1 2 5 4\nf 2 3 6 9 5\nf 4 5 8\n", positions.join("\nv ")));
    place.write(
        "polygons.ply",
        format!(
            "ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\n\
             element face 3\nproperty list uchar int vertex_indices\nend_header\n{rows}\n4 0 1 4 3\n5 1 2 5 8 4\n3 3 4 7\n"
        ),
    );
    let files = ["triangles.ply", "polygons.off", "polygons.obj", "polygons.ply"].map(String::from);
    assert_one_model(&place, &files);
    assert_gives_back(&place, &mesh);
    for file in &files[1..] {
        let built = place.json(&format!("build --positions lossless {file} -o other.vdt --force"));
        assert_eq!(warning(&built, "polygons"), Some(2), "{file}");
    }

    let strip = "0 3 1 4 2 5 -1 6 7 8";
    place.write(
        "strips.ply",
        format!(
            "ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\n\
             element tristrips 1\nproperty list int int vertex_indices\nend_header\n{rows}\n{} {strip}\n",
            strip.split(' ').count()
        ),
    );
    mesh.triangles = vec![[0, 3, 1], [1, 3, 4], [1, 4, 2], [2, 4, 5], [6, 7, 8]];
    place.write("triangles.ply", ply(&mesh, Encoding::BigEndian, Coordinates::Double));
    assert_one_model(&place, &["triangles.ply", "strips.ply"].map(String::from));
    assert_gives_back(&place, &mesh);
}

/// Several files are one mesh, welded along the seam, in whatever order they are named.
#[test]
fn parts_in_several_files_are_one_mesh() {
    let place = workplace!();
    let whole = sheet(20, 15, 0.4, 4, 5).in_single_precision();
    let (one, two) = whole.triangles.split_at(300);
    let part = |triangles: &[[u32; 3]]| RawMesh { positions: whole.positions.clone(), triangles: triangles.to_vec() };
    place.write("whole.ply", ply(&whole, Encoding::LittleEndian, Coordinates::Float));
    place.write("one.stl", stl_binary(&part(one)));
    place.write("two.obj", obj(&part(two)));
    let files = ["whole.ply", "one.stl two.obj", "two.obj one.stl"].map(String::from);
    let first = place.json("build --positions lossless whole.ply -o model.vdt");
    assert_eq!(first["components"], 1);
    for files in &files {
        let built = place.json(&format!("build --positions lossless {files} -o other.vdt --force"));
        assert_eq!(built["model_sha256"], first["model_sha256"], "{files}");
    }
    let verified = place.json("verify model.vdt --against one.stl --against two.obj");
    assert_eq!(verified["same_as_mesh"], true);
    assert_gives_back(&place, &whole);
    place.refuses(1, "verify model.vdt --against one.stl", &["model.vdt", "not this mesh"]);
}

/// The way back is a mesh file like any other: its model is the model that it came from.
#[test]
fn what_is_extracted_builds_the_same_model() {
    let place = workplace!();
    for shape in ["sphere --triangles 1000", "gyroid --triangles 2000", "city --triangles 1500 --seed 9"] {
        let mesh = generated(&place, shape);
        let built = place.json("build --positions lossless generated.ply -o model.vdt --force");
        assert_gives_back(&place, &mesh);
        let again = place.json("build --positions lossless back.ply -o again.vdt --force");
        assert_eq!(built["model_sha256"], again["model_sha256"], "{shape}");
    }
}

#[test]
fn what_a_mesh_names_and_is_not_there_is_a_warning_and_no_error() {
    let place = workplace!();
    place.write("m.mtl", b"newmtl a\nmap_Kd gone.png\n");
    let corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\n";
    let faces = "usemtl a\nf 1/1 2/2 3/3\nf 1/1 3/3 4/2\n";
    place.write("a.obj", format!("mtllib m.mtl n.mtl\n{corners}{faces}").as_bytes());
    let built = place.json("build a.obj -o a.vdt");
    let missing: Vec<&str> = built["warnings"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|warning| warning["kind"] == "missing_file")
        .map(|warning| warning["path"].as_str().unwrap())
        .collect();
    assert_eq!(missing, ["gone.png", "n.mtl"]);
    assert_eq!(built["attributes"], json!(["texture_coordinates", "materials"]));
    let plain = place.json("build a.obj -o b.vdt --no-attributes");
    assert_eq!((&plain["warnings"], &plain["attributes"]), (&json!([]), &json!([])));
}
