//! `vdt info`: of mesh files what attributes are found in each format; of models their figures, for people and for programs.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use serde_json::{Value, json};
use vdt_tests::mesh_files::{Coordinates, Encoding, ply};
use vdt_tests::program::Workplace;
use vdt_tests::random_mesh::closed_box;
use vdt_tests::workplace;

/// The attributes that are there, with their numbers.
fn attributes(place: &Workplace, file: &str) -> Value {
    let document = place.json(&format!("info {file}"));
    let all = document["attributes"].as_object().unwrap();
    all.iter().filter(|(_, count)| **count != 0).map(|(name, count)| (name.clone(), count.clone())).collect()
}

const OBJ: &str = "mtllib skin.mtl\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nv 0 1 0 1 1 1\nvt 0 0\nvt 1 0\nvt 1 1\n\
                   vn 0 0 1\nusemtl skin\nf 1/1/1 2/2/1 3/3/1\nusemtl wood\nf 1 3 4\nusemtl odd\nf 1 2 3 4\n";
const MTL: &str = "newmtl skin\nKd 1 0.5 0.25\nmap_Kd skin.png\nnewmtl wood\nmap_Kd wood.png\n";

#[test]
fn a_mesh_without_attributes_has_none() {
    let place = workplace!();
    place.write("box.ply", ply(&closed_box(), Encoding::LittleEndian, Coordinates::Float));
    assert_eq!(attributes(&place, "box.ply"), json!({}));
    let document = place.json("info box.ply");
    assert_eq!((&document["materials"], &document["missing_files"]), (&json!([]), &json!([])));
    let text = place.run("info box.ply").success();
    assert!(text.lines().any(|line| line == "attributes  none"), "{text}");
}

#[test]
fn an_obj_has_values_at_corners_and_materials() {
    let place = workplace!();
    place.write("mesh.obj", OBJ);
    place.write("skin.mtl", MTL);
    place.write("skin.png", "png");
    let document = place.json("info mesh.obj");
    assert_eq!((&document["triangles"], &document["polygons"]), (&json!(4), &json!(1)));
    let expected = json!({
        "vertex_colours": 4, "wedge_texture_coordinates": 3, "wedge_normals": 3, "listed_texture_coordinates": 3,
        "listed_normals": 1, "face_materials": 3,
    });
    assert_eq!(attributes(&place, "mesh.obj"), expected);
    let expected = json!([
        {"name": "skin", "base_colour": [1.0, 0.5, 0.25, 1.0], "image": "skin.png", "image_found": true, "image_place": "file"},
        {"name": "wood", "base_colour": null, "image": "wood.png", "image_found": false, "image_place": "missing"},
        {"name": "odd", "base_colour": null, "image": null, "image_found": null, "image_place": null},
    ]);
    assert_eq!(document["materials"], expected);
    assert_eq!(document["missing_files"], json!(["wood.png"]));
    let text = place.run("info mesh.obj").success();
    for words in [
        "3 faces, 1 of more than three corners",
        "colours of 4 vertices",
        "texture coordinates of 3 corners of faces, from a list of 3",
        "materials   skin, colour 1 0.5 0.25, alpha 1, image skin.png (it is there)",
        "wood, image wood.png (it is not there)",
        "warning     wood.png is named, and is not there",
    ] {
        assert!(text.contains(words), "no `{words}` in {text}");
    }
}

/// A library or an image that is not there is no reason not to read a mesh, whoever asks.
#[test]
fn what_is_not_there_is_a_warning() {
    let place = workplace!();
    place.write("mesh.obj", OBJ);
    let document = place.json("info mesh.obj");
    assert_eq!(document["missing_files"], json!(["skin.mtl"]));
    assert_eq!(document["materials"].as_array().unwrap().len(), 3);
    assert_eq!(place.json("build mesh.obj -o mesh.vdt")["vertices"], 4);
}

#[test]
fn attributes_that_are_wrong_are_refused_and_a_build_can_leave_them_out() {
    let place = workplace!();
    place.write("mesh.obj", OBJ.replace("3/3/1", "3/9/1"));
    let expected = "mesh.obj: face 0, corner 2: it names texture coordinate 8, but the file has 3 (numbered from 0)";
    place.refuses(1, "info mesh.obj", &[expected]);
    place.refuses(1, "build mesh.obj -o mesh.vdt", &[expected, "--no-attributes"]);
    place.json("build mesh.obj -o mesh.vdt --no-attributes");
}

#[test]
fn the_other_formats() {
    let place = workplace!();
    let mut stl = b"COLOR=\x01\x02\x03\xff".to_vec();
    stl.resize(80, b' ');
    stl.extend(1_u32.to_le_bytes());
    stl.extend([0; 50]);
    place.write("mesh.stl", stl);
    place.write(
        "mesh.off",
        "STCNOFF 3 1 0\n0 0 0 0 0 1 9 9 9 0 1\n1 0 0 0 0 1 9 9 9 0 1\n0 1 0 0 0 1 9 9 9 0 1\n3 0 1 2 1 0 0\n",
    );
    place.write(
        "mesh.ply",
        "ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 3\nproperty float x\nproperty float y\n\
         property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n\
         property list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n\
         0 0 0 1 2 3\n1 0 0 1 2 3\n0 1 0 1 2 3\n3 0 1 2 6 0 0 1 0 0 1\n",
    );
    let data = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
    let document = json!({
        "asset": {"version": "2.0"},
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 0, "COLOR_0": 0}, "material": 0}]}],
        "materials": [{"name": "m", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": format!("data:image/png;base64,{data}")}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": format!("data:;base64,{data}")}],
    });
    place.write("mesh.gltf", document.to_string());
    for (file, expected) in [
        ("mesh.stl", json!({"face_colours": 1})),
        (
            "mesh.off",
            json!({"vertex_normals": 3, "vertex_colours": 3, "vertex_texture_coordinates": 3, "face_colours": 1}),
        ),
        ("mesh.ply", json!({"vertex_colours": 3, "wedge_texture_coordinates": 3, "face_materials": 1})),
        ("mesh.gltf", json!({"vertex_normals": 3, "vertex_colours": 3, "face_materials": 1})),
    ] {
        assert_eq!(attributes(&place, file), expected, "{file}");
    }
    assert_eq!(place.json("info mesh.ply")["missing_files"], json!(["a.png"]));
    let text = place.run("info mesh.gltf").success();
    assert!(text.contains("m, colour 1 1 1, alpha 1, image image 0 (inside, 36 B"), "{text}");
}

/// Many materials are cut short for people, not for programs.
#[test]
fn many_materials_are_listed_in_part() {
    let place = workplace!();
    let uses: String = (0..40).map(|number| format!("usemtl material {number}\nf 1 2 3\n")).collect();
    place.write("mesh.obj", format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{uses}"));
    assert_eq!(place.json("info mesh.obj")["materials"].as_array().unwrap().len(), 40);
    let text = place.run("info mesh.obj").success();
    assert!(text.contains("material 11\n") && !text.contains("material 12\n"), "{text}");
    assert!(text.contains("and 28 more; --json lists all"), "{text}");
}

/// What `info` tells of a model, against what else is known of it.
#[test]
fn the_figures_of_a_model() {
    let place = workplace!();
    place.json("generate city --triangles 3000 --seed 2 -o city.ply");
    let built = place.json("build city.ply -o city.vdt --positions 14 --blocking forest:8K,3");
    let info = place.json("info city.vdt");
    for key in ["vertices", "triangles", "components", "meta_nodes", "model_bytes", "slot_bytes", "input_error"] {
        assert_eq!(info[key], built[key], "{key}");
    }
    let fill = info["fill_histogram"].as_array().unwrap().iter().map(|count| count.as_u64().unwrap()).sum::<u64>();
    assert_eq!(info["meta_nodes"], fill);
    assert_eq!(info["splits"], info["vertices"].as_u64().unwrap() - info["components"].as_u64().unwrap());
    let sum = |values: &Value| values.as_object().unwrap().values().map(|bytes| bytes.as_u64().unwrap()).sum::<u64>();
    assert_eq!(info["model_bytes"], sum(&info["bytes_by_part"]));
    let square = |axis: usize| info["extents"][axis].as_f64().unwrap().powi(2);
    let diagonal = info["diagonal"].as_f64().unwrap();
    assert!(((square(0) + square(1) + square(2)).sqrt() - diagonal).abs() < 1e-9 * diagonal);
    assert!(info["place_holders_in_16m"].as_u64().unwrap() > info["meta_nodes"].as_u64().unwrap());
    assert_eq!(info["smallest_error"], Value::Null);

    let details = place.json("info city.vdt --pages");
    let (smallest, largest) = (&details["smallest_error"], &details["largest_error"]);
    assert!(0.0 < smallest.as_f64().unwrap() && smallest.as_f64() < largest.as_f64());
    // The states of each page's coder are 12 of its bytes, and what is left over up to two more.
    let (fields, coded) = (sum(&details["bytes_by_field"]), info["bytes_by_part"]["fields"].as_u64().unwrap());
    assert!(fields <= coded + 3 && fields + 15 * info["meta_nodes"].as_u64().unwrap() >= coded, "{fields} of {coded}");
    for level in details["levels_of_detail"].as_array().unwrap() {
        let cut = place.json(&format!("extract city.vdt -o cut.ply --force --error {}", level["error"]));
        assert_eq!(cut["triangles"], level["triangles"]);
    }
    let text = place.run("info city.vdt --pages").success();
    for words in [
        "format version 3",
        "14 bits: rounded",
        "normals, computed, to 20 bits",
        "blocking forest:8K,3",
        "left at 0.1 % of",
        "MiB",
    ] {
        assert!(text.contains(words), "no `{words}` in {text}");
    }
    place.refuses(1, "info city.ply --pages", &["city.ply", "--pages is for models"]);
}

/// Of models there is nothing, or next to nothing, in.
#[test]
fn the_figures_of_small_models() {
    let place = workplace!();
    for (name, text, triangles) in [
        ("none.obj", "v 0 0 0\n", 0),
        ("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", 1),
        ("one.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", 1),
    ] {
        place.write(name, text);
        place.json(&format!("build {name} -o m.vdt --force"));
        for command in ["info m.vdt", "info m.vdt --pages"] {
            let info = place.json(command);
            assert_eq!((&info["triangles"], &info["vertices"]), (&triangles.into(), &(3 * triangles).into()), "{name}");
            assert_eq!(info["model_bytes"], place.read("m.vdt").len());
            place.run(command).success();
        }
        place.json("verify m.vdt");
    }
}
