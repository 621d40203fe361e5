//! Small meshes with attributes, made by hand, in core and stored.

use std::path::PathBuf;

use storage::{ByteSize, MemoryDisk};

use super::attribute_tests::check_attributes;
use super::limits::Limits;
use super::tests::{check, scratch_on, store_within};
use super::*;
use crate::mesh::ImageSource;
use crate::tree::{AttributeKinds, MOST_WEDGES, Normal, Wedge};

/// The mesh of these files, in core; it is the same stored.
fn loaded(files: &[(&str, &[u8])], paths: &[&str]) -> CoreMesh {
    let disk = MemoryDisk::new();
    files.iter().for_each(|(name, bytes)| disk.insert(name, *bytes));
    let paths: Vec<PathBuf> = paths.iter().map(PathBuf::from).collect();
    let rule = PositionsRule::LOSSLESS;
    let mesh = load(&disk, &paths, rule, true, ByteSize(u64::MAX), &reading_needs).unwrap().0;
    for memory in [0, 20_000, 1 << 20] {
        let limits = Limits { memory, threads: 1, block_triangles: 100, vertex_chunk: 10, triangle_chunk: 10 };
        let scratch = scratch_on(MemoryDisk::new());
        let stored = store_within(&disk, &scratch, &paths, rule, &limits).unwrap();
        check(&stored, &mesh, 100);
        check_attributes(&stored, &mesh);
    }
    mesh
}

fn of_obj(text: &str) -> CoreMesh {
    loaded(&[("a.obj", text.as_bytes())], &["a.obj"])
}

fn attributes(mesh: &CoreMesh) -> &CoreAttributes {
    mesh.attributes.as_ref().unwrap()
}

/// The wedges of the corners of a triangle.
fn wedges_of(mesh: &CoreMesh, triangle: usize) -> [Wedge; 3] {
    let CoreAttributes { wedges, corners, .. } = attributes(mesh);
    let places = corners[triangle].places();
    [0, 1, 2].map(|corner| wedges[mesh.triangles[triangle][corner] as usize][places[corner] as usize])
}

/// The corners of a cube, and its faces.
const CUBE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n";
const FACES: [[usize; 4]; 6] = [[4, 3, 2, 1], [5, 6, 7, 8], [1, 2, 6, 5], [3, 4, 8, 7], [2, 3, 7, 6], [4, 1, 5, 8]];

#[test]
fn a_cube_with_its_own_texture_on_each_face_has_three_wedges_at_each_corner() {
    let mut text = CUBE.to_string();
    for face in 0..6 {
        for [u, v] in [[0, 0], [1, 0], [1, 1], [0, 1]] {
            text += &format!("vt {} {}\n", 2 * face + u, v);
        }
    }
    for (face, corners) in FACES.iter().enumerate() {
        let corners = corners.iter().enumerate().map(|(place, vertex)| format!(" {vertex}/{}", 4 * face + place + 1));
        text += &format!("f{}\n", corners.collect::<String>());
    }
    let mesh = of_obj(&text);
    let found = attributes(&mesh);
    assert_eq!(found.appearance.kinds, AttributeKinds { textures: true, ..AttributeKinds::default() });
    assert!(found.wedges.iter().all(|wedges| wedges.len() == 3));
    assert_eq!((mesh.positions.len(), mesh.triangles.len(), mesh.cleaning.polygons), (8, 12, 6));
    for triangle in 0..12 {
        let faces = wedges_of(&mesh, triangle).map(|wedge| found.appearance.texture_value(wedge.texture)[0] as u32 / 2);
        assert!(faces[0] == faces[1] && faces[1] == faces[2], "{faces:?}");
    }
}

#[test]
fn materials_of_two_files_follow_each_other_and_images_are_there_once() {
    let library = b"newmtl red\nKd 1 0 0\nmap_Kd a.png\nnewmtl blue\nmap_Kd gone.png\n".as_slice();
    let first = b"mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl blue\nf 1 2 3\n".as_slice();
    let second = b"mtllib m.mtl\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl red\nf 1 2 3\n".as_slice();
    let files = [("a.obj", first), ("b.obj", second), ("m.mtl", library), ("a.png", b"png".as_slice())];
    let mesh = loaded(&files, &["a.obj", "b.obj"]);
    let CoreAttributes { appearance, wedges, .. } = attributes(&mesh);
    assert_eq!(mesh.triangles.len(), 2);
    let mut materials: Vec<_> = (0..2).map(|triangle| wedges_of(&mesh, triangle).map(|wedge| wedge.material)).collect();
    materials.sort();
    assert_eq!(materials, [[2; 3], [3; 3]]);
    let mut counts: Vec<_> = wedges.iter().map(Vec::len).collect();
    counts.sort();
    assert_eq!(counts, [1, 1, 2, 2]);
    let names: Vec<_> = appearance.materials.iter().map(|material| (material.name.as_str(), material.image)).collect();
    assert_eq!(names, [("red", Some(0)), ("blue", Some(1)), ("red", Some(0)), ("blue", Some(1))]);
    assert_eq!(appearance.materials[0].base_colour, Some([1.0, 0.0, 0.0, 1.0]));
    let sources: Vec<_> = appearance.images.iter().map(|image| &image.source).collect();
    assert_eq!(sources, [&ImageSource::File("a.png".into()), &ImageSource::Missing]);
}

/// An ASCII PLY of these lines of vertices and faces.
fn ply(vertex: &str, face: &str, vertices: &[&str], faces: &[&str]) -> String {
    let properties =
        |names: &str| names.split_whitespace().map(|name| format!("property uchar {name}\n")).collect::<String>();
    format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n{}\
         element face {}\nproperty list uchar int vertex_indices\n{}end_header\n{}\n{}\n",
        vertices.len(),
        properties(vertex),
        faces.len(),
        properties(face),
        vertices.join("\n"),
        faces.join("\n")
    )
}

#[test]
fn the_colour_of_a_face_goes_before_that_of_a_vertex() {
    let vertices = ["0 0 0 1 2 3", "1 0 0 4 5 6", "1 1 0 7 8 9", "0 1 0 10 11 12"];
    let plain = ply("red green blue", "", &vertices, &["3 0 1 2", "3 0 2 3"]);
    let mesh = loaded(&[("a.ply", plain.as_bytes())], &["a.ply"]);
    let mut colours: Vec<_> = attributes(&mesh).wedges.iter().map(|wedges| wedges[0].colour).collect();
    colours.sort();
    assert_eq!(colours, [[1, 2, 3, 255], [4, 5, 6, 255], [7, 8, 9, 255], [10, 11, 12, 255]]);
    assert!(attributes(&mesh).wedges.iter().all(|wedges| wedges.len() == 1));

    let faces = ["3 0 1 2 100 101 102", "3 0 2 3 200 201 202"];
    let coloured = ply("red green blue", "red green blue", &vertices, &faces);
    let mesh = loaded(&[("a.ply", coloured.as_bytes())], &["a.ply"]);
    for triangle in 0..2 {
        let [a, b, c] = wedges_of(&mesh, triangle).map(|wedge| wedge.colour);
        assert!(a == b && b == c && [[100, 101, 102, 255], [200, 201, 202, 255]].contains(&a));
    }
    assert_eq!(attributes(&mesh).wedges.iter().map(Vec::len).sum::<usize>(), 6);
}

#[test]
fn of_two_equal_triangles_the_one_with_the_smaller_wedges_stays_and_the_wedges_of_the_other_go() {
    let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvn 1 0 0\nvn 0 1 0\n";
    let faces = ["f 1//1 2//1 3//3\n", "f 2//1 3//1 1//1\n"];
    let expected = of_obj(&format!("{corners}f 1//1 2//1 3//1\n"));
    for [first, second] in [faces, [faces[1], faces[0]]] {
        let mesh = of_obj(&format!("{corners}{first}{second}"));
        assert_eq!((mesh.triangles.len(), mesh.cleaning.duplicate_triangles), (1, 1));
        let least = Normal::encode([0.0, 0.0, 1.0]).to_word() < Normal::encode([0.0, 1.0, 0.0]).to_word();
        assert!(least);
        assert_eq!(mesh.attributes, expected.attributes);
    }
}

/// A fan of so many triangles around one vertex, each with a colour of its own.
fn fan(triangles: usize) -> String {
    let mut vertices = vec!["0 0 0".to_string()];
    vertices.extend((0..=triangles).map(|number| format!("{} {} 1", number, number * number)));
    let faces: Vec<_> = (0..triangles)
        .map(|number| format!("3 0 {} {} {} {} 7", number + 1, number + 2, number / 256, number % 256))
        .collect();
    let vertices: Vec<_> = vertices.iter().map(String::as_str).collect();
    ply("", "red green blue", &vertices, &faces.iter().map(String::as_str).collect::<Vec<_>>())
}

#[test]
fn a_vertex_has_no_more_wedges_than_it_may_and_it_is_told() {
    for (triangles, merged) in [(MOST_WEDGES, 0), (MOST_WEDGES + 300, 300)] {
        let mesh = loaded(&[("a.ply", fan(triangles).as_bytes())], &["a.ply"]);
        assert_eq!(mesh.cleaning.merged_wedges, merged);
        let most = attributes(&mesh).wedges.iter().map(Vec::len).max();
        assert_eq!(most, Some(MOST_WEDGES));
        let number = |wedge: Wedge| usize::from(wedge.colour[0]) * 256 + usize::from(wedge.colour[1]);
        for triangle in 0..triangles {
            let all = wedges_of(&mesh, triangle).map(number);
            let own = all.into_iter().max().unwrap();
            assert!(all.iter().all(|found| *found == own.min(MOST_WEDGES - 1) || *found == own), "{all:?}");
        }
    }
}

#[test]
fn what_no_attribute_is_asked_for_or_there_has_none() {
    assert_eq!(of_obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1 2 3\n").attributes, None);
    assert_eq!(of_obj("v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0\nf 1 1 3\n").attributes, None);
}

/// A square of two triangles as glTF: the document, and its buffer.
fn square_as_gltf() -> (String, Vec<u8>) {
    let positions = [[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    let normals = [[0.0_f32, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]];
    let textures = [[0.0_f32, 1.0], [0.5, 1.0], [0.5, 0.25], [0.0, 0.0]];
    let colours = [[0_u8, 0, 0, 255], [255, 0, 55, 255], [55, 55, 55, 255], [0, 255, 0, 255]];
    let parts: [(&[u8], &str); 5] = [
        (bytemuck::bytes_of(&positions), r#""componentType": 5126, "count": 4, "type": "VEC3""#),
        (bytemuck::bytes_of(&normals), r#""componentType": 5126, "count": 4, "type": "VEC3""#),
        (bytemuck::bytes_of(&textures), r#""componentType": 5126, "count": 4, "type": "VEC2""#),
        (bytemuck::bytes_of(&colours), r#""componentType": 5121, "normalized": true, "count": 4, "type": "VEC4""#),
        (bytemuck::bytes_of(&[0_u16, 1, 2, 0, 2, 3]), r#""componentType": 5123, "count": 6, "type": "SCALAR""#),
    ];
    let (mut bytes, mut views, mut accessors) = (Vec::new(), Vec::new(), Vec::new());
    for (number, (part, accessor)) in parts.into_iter().enumerate() {
        views.push(format!(r#"{{"buffer": 0, "byteOffset": {}, "byteLength": {}}}"#, bytes.len(), part.len()));
        accessors.push(format!(r#"{{"bufferView": {number}, {accessor}}}"#));
        bytes.extend_from_slice(part);
    }
    let document = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}], "nodes": [{{"mesh": 0}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2, "COLOR_0": 3}},
        "indices": 4, "material": 0}}]}}], "materials": [{{"name": "m", "pbrMetallicRoughness":
        {{"baseColorTexture": {{"index": 0}}}}}}], "textures": [{{"source": 0}}], "images": [{{"uri": "a.png"}}],
        "buffers": [{{"uri": "b.bin", "byteLength": {}}}], "bufferViews": [{}], "accessors": [{}]}}"#,
        bytes.len(),
        views.join(", "),
        accessors.join(", ")
    );
    (document, bytes)
}

#[test]
fn gltf_and_obj_of_the_same_mesh_have_the_same_wedges() {
    let (document, buffer) = square_as_gltf();
    let gltf = loaded(&[("a.gltf", document.as_bytes()), ("b.bin", &buffer), ("a.png", b"png")], &["a.gltf"]);
    // Linear 55 is 128 in sRGB, and v goes upwards.
    let obj = "mtllib m.mtl\nv 0 0 0 0 0 0\nv 1 0 0 1.0 0.0 0.502\nv 1 1 0 0.502 0.502 0.502\nv 0 1 0 0 1 0\n\
               vt 0 0\nvt 0.5 0\nvt 0.5 0.75\nvt 0 1\nvn 0 0 1\nvn 0 1 0\nvn 1 0 0\nusemtl m\n\
               f 1/1/1 2/2/2 3/3/1\nf 1/1/1 3/3/1 4/4/3\n";
    let library = b"newmtl m\nmap_Kd a.png\n";
    let obj = loaded(&[("a.obj", obj.as_bytes()), ("m.mtl", library), ("a.png", b"png")], &["a.obj"]);
    let (gltf_attributes, obj_attributes) = (attributes(&gltf), attributes(&obj));
    assert_eq!((&gltf.positions, &gltf.triangles), (&obj.positions, &obj.triangles));
    assert_eq!(gltf_attributes.wedges, obj_attributes.wedges);
    assert_eq!(gltf_attributes.corners, obj_attributes.corners);
    assert_eq!(gltf_attributes.appearance.kinds, obj_attributes.appearance.kinds);
    assert_eq!(gltf_attributes.appearance.images, obj_attributes.appearance.images);
    let all = gltf_attributes.wedges.concat();
    assert!(all.iter().any(|wedge| wedge.colour == [128, 128, 128, 255]));
    assert!(all.iter().any(|wedge| wedge.texture == [1 << 15, 3 << 14]));
}

#[test]
fn missing_libraries_and_images_are_told() {
    let disk = MemoryDisk::new();
    disk.insert("m.mtl", "newmtl a\nmap_Kd gone.png\n");
    disk.insert("a.obj", "mtllib m.mtl n.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n");
    let mut plan = IngestPlan {
        memory: ByteSize(64 << 20),
        threads: 1,
        block_triangles: 1000,
        positions: PositionsRule::Auto,
        attributes: true,
    };
    let mut stored = |attributes| {
        plan.attributes = attributes;
        store(&disk, &storage::Scratch::in_memory(), &["a.obj".into()], &plan, &mut |_| ()).unwrap()
    };
    let mesh = stored(true);
    assert_eq!(mesh.missing_files, ["gone.png", "n.mtl"].map(PathBuf::from));
    assert_eq!(mesh.attributes.unwrap().appearance.images[0].source, ImageSource::Missing);
    let plain = stored(false);
    assert!(plain.attributes.is_none() && plain.missing_files.is_empty());
}
