//! Binary glTF is what the specification asks for, and is read back as what it was.

use serde_json::Value;
use storage::LocalDisk;

use super::*;
use crate::mesh::srgb;

/// The document and the binary chunk of a file, which must be as the specification has it: lengths, alignment, padding, what
/// lies where, and the bounds of accessors.
fn parts(bytes: &[u8]) -> (Value, Vec<u8>) {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], word(4), word(8)), (b"glTF".as_slice(), 2, bytes.len()));
    let document_bytes = word(12);
    assert_eq!((document_bytes % 4, &bytes[16..20]), (0, b"JSON".as_slice()));
    let document: Value = serde_json::from_slice(&bytes[20..20 + document_bytes]).unwrap();
    let rest = 20 + document_bytes;
    if rest == bytes.len() {
        assert_eq!(document.get("buffers"), None);
        return (document, Vec::new());
    }
    assert_eq!((word(rest) % 4, &bytes[rest + 4..rest + 8]), (0, b"BIN\0".as_slice()));
    assert_eq!(rest + 8 + word(rest), bytes.len());
    let binary = bytes[rest + 8..].to_vec();
    assert_eq!(document["buffers"], serde_json::json!([{ "byteLength": binary.len() }]));

    let number = |value: &Value| value.as_u64().unwrap() as usize;
    let views = document["bufferViews"].as_array().unwrap();
    let mut ends = Vec::new();
    for view in views {
        let (offset, length) = (number(&view["byteOffset"]), number(&view["byteLength"]));
        assert!(offset % 4 == 0 && length > 0 && offset + length <= binary.len());
        assert!(view.get("byteStride").is_none_or(|stride| number(stride) % 4 == 0 && number(stride) <= 252));
        ends.push((offset, offset + length));
    }
    ends.sort_unstable();
    assert!(ends.windows(2).all(|pair| pair[0].1 <= pair[1].0), "{ends:?}");
    let accessors = document["accessors"].as_array().unwrap();
    for accessor in accessors {
        let width = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            _ => 4,
        };
        let component = if accessor["componentType"] == 5123 { 2 } else { 4 };
        let view = &views[number(&accessor["bufferView"])];
        let stride = view.get("byteStride").map_or(width * component, number);
        let (offset, count) = (number(&accessor["byteOffset"]), number(&accessor["count"]));
        assert!(count > 0 && offset % component == 0);
        assert!(offset + (count - 1) * stride + width * component <= number(&view["byteLength"]));
    }
    for primitive in document["meshes"][0]["primitives"].as_array().unwrap() {
        let positions = &accessors[number(&primitive["attributes"]["POSITION"])];
        let vertices = number(&positions["count"]);
        let indices = &accessors[number(&primitive["indices"])];
        let first = number(&views[number(&indices["bufferView"])]["byteOffset"]) + number(&indices["byteOffset"]);
        let corners = &binary[first..first + 4 * number(&indices["count"])];
        let corners = corners.chunks(4).map(|corner| u32::from_le_bytes(corner.try_into().unwrap()) as usize);
        assert!(corners.count() % 3 == 0);
        let corners = binary[first..][..4 * number(&indices["count"])].chunks(4);
        assert!(corners.map(|corner| u32::from_le_bytes(corner.try_into().unwrap()) as usize).all(|at| at < vertices));
        let view = &views[number(&positions["bufferView"])];
        let (start, stride) = (number(&view["byteOffset"]), number(&view["byteStride"]));
        for axis in 0..3 {
            let values = (0..vertices).map(|vertex| {
                let at = start + vertex * stride + 4 * axis;
                f64::from(f32::from_le_bytes(binary[at..at + 4].try_into().unwrap()))
            });
            let (minimum, maximum) = values.fold((f64::MAX, f64::MIN), |(a, b), value| (a.min(value), b.max(value)));
            assert_eq!(positions["min"][axis].as_f64(), Some(minimum));
            assert_eq!(positions["max"][axis].as_f64(), Some(maximum));
        }
    }
    (document, binary)
}

/// A corner with its normal as models have it: where the node moves the mesh, readers make it of length 1 again.
fn rounded((position, normal, colour, texture): Corner) -> impl PartialEq + std::fmt::Debug {
    (position, normal.map(|normal| Normal::encode(normal.map(f64::from))), colour, texture)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn what_is_written_as_glb_is_read_back(mesh in meshes()) {
        let appearance = mesh.appearance();
        let disk = MemoryDisk::new();
        let written = mesh.write(&disk, "mesh.glb", &mut |number, _| {
            Ok((number != 1).then(|| [b"\x89PNG".as_slice(), &vec![number as u8; number]].concat()))
        });
        let written = written.unwrap();
        prop_assert_eq!(disk.paths(), [PathBuf::from("mesh.glb")]);
        let bytes = disk.bytes("mesh.glb").unwrap();
        prop_assert_eq!(written.bytes, bytes.len() as u64);
        let (document, _) = parts(&bytes);

        let (corners, sink) = found(&disk, "mesh.glb");
        let mut expected = mesh.expected(OutputFormat::Glb);
        expected.sort_by_key(|(_, material)| material.map_or(0, |material| material + 1));
        let turned = |(position, normal, colour, texture): Corner| {
            (position, normal, colour, texture.map(|[u, v]: [f32; 2]| [u, 1.0 - v]))
        };
        // The gate turns v once more.
        let found: Vec<_> = corners.iter().map(|(corners, material)| (corners.map(rounded), *material)).collect();
        let expected: Vec<_> =
            expected.iter().map(|(corners, material)| (corners.map(turned).map(rounded), *material)).collect();
        prop_assert_eq!(found, expected);
        prop_assert_eq!(sink.plain.vertices.len(), mesh.vertices.len());

        prop_assert_eq!(sink.materials.len(), appearance.materials.len());
        for (read, material) in sink.materials.iter().zip(&appearance.materials) {
            prop_assert_eq!(&read.name, &material.name);
            prop_assert_eq!(read.base_colour, Some(material.base_colour.unwrap_or([1.0; 4])));
            let number = material.image.filter(|image| *image != 1);
            prop_assert_eq!(read.image.is_some(), number.is_some());
            if let (Some(image), Some(number)) = (&read.image, number) {
                let name = &appearance.images[number as usize].name;
                prop_assert!(image.name == *name || name.is_empty());
                let ImageSource::Part { .. } = &image.source else { panic!("{image:?}") };
                let expected = [b"\x89PNG".as_slice(), &vec![number as u8; number as usize]].concat();
                prop_assert_eq!(image_bytes(&disk, &image.source).unwrap(), Some(expected));
            }
        }
        let loses_digits = mesh.vertices.iter().any(|(position, _)| {
            mesh.layout.coordinates == CoordinateType::Double && (0..3).any(|axis| {
                let origin = mesh.layout.origin[axis];
                f64::from((position[axis] - origin) as f32) + origin != position[axis]
            })
        });
        let told = |word: &str| written.left_out.iter().any(|phrase| phrase.contains(word));
        prop_assert_eq!(told("last digits"), loses_digits);
        prop_assert_eq!(told("missing"), appearance.images.len() > 1);
        prop_assert_eq!(written.left_out.len(), usize::from(loses_digits) + usize::from(appearance.images.len() > 1));
        prop_assert_eq!(document["asset"].get("extras").is_some(), !mesh.layout.comments.is_empty());

        let mut counting = Counting(0);
        let summary = read_mesh(&disk, Path::new("mesh.glb"), &mut counting).unwrap();
        prop_assert_eq!((counting.0, summary.vertices), (mesh.triangles.len() as u64, mesh.vertices.len() as u64));
    }
}

#[test]
fn every_byte_of_a_colour_comes_back() {
    let mut mesh = painted();
    mesh.vertices = (0..=255)
        .map(|byte: u8| {
            let colour = [byte, 255 - byte, byte ^ 0x55, byte];
            ([f64::from(byte), 0.0, 0.0], Wedge { colour, ..Wedge::PLAIN })
        })
        .collect();
    mesh.layout.vertices = 256;
    let memory = MemoryDisk::new();
    mesh.write(&memory, "mesh.glb", &mut |_, _| Ok(None)).unwrap();
    let (_, sink) = found(&memory, "mesh.glb");
    for (vertex, (_, wedge)) in sink.vertices.iter().zip(&mesh.vertices) {
        assert_eq!(vertex.1, Some(wedge.colour));
    }
}

#[test]
fn a_glb_file_with_everything_word_for_word() {
    let memory = MemoryDisk::new();
    let written = painted().write(&memory, "mesh.glb", &mut |_, _| Ok(Some(b"\xff\xd8\xff!?".to_vec()))).unwrap();
    assert_eq!((written.beside.len(), written.left_out.len()), (0, 0));
    let (document, binary) = parts(&memory.bytes("mesh.glb").unwrap());
    let linear = srgb::linear_of_srgb(0.25);
    let expected = serde_json::json!({
        "asset": { "version": "2.0", "generator": "vdt" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [
            { "attributes": { "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2, "COLOR_0": 3 }, "indices": 4 },
            { "attributes": { "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2, "COLOR_0": 3 }, "indices": 5, "material": 0 },
            { "attributes": { "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2, "COLOR_0": 3 }, "indices": 6, "material": 1 },
        ] }],
        "accessors": [
            { "bufferView": 0, "byteOffset": 0, "componentType": 5126, "count": 3, "type": "VEC3",
              "min": [0.0, 0.0, 0.0], "max": [1.0, 1.0, 0.0] },
            { "bufferView": 0, "byteOffset": 12, "componentType": 5126, "count": 3, "type": "VEC3" },
            { "bufferView": 0, "byteOffset": 24, "componentType": 5126, "count": 3, "type": "VEC2" },
            { "bufferView": 0, "byteOffset": 32, "componentType": 5123, "count": 3, "type": "VEC4", "normalized": true },
            { "bufferView": 1, "byteOffset": 0, "componentType": 5125, "count": 3, "type": "SCALAR" },
            { "bufferView": 1, "byteOffset": 12, "componentType": 5125, "count": 3, "type": "SCALAR" },
            { "bufferView": 1, "byteOffset": 24, "componentType": 5125, "count": 3, "type": "SCALAR" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 8, "byteLength": 120, "byteStride": 40, "target": 34962 },
            { "buffer": 0, "byteOffset": 128, "byteLength": 36, "target": 34963 },
            { "buffer": 0, "byteOffset": 0, "byteLength": 5 },
        ],
        "buffers": [{ "byteLength": 164 }],
        "materials": [
            { "name": "red paint", "alphaMode": "BLEND", "pbrMetallicRoughness": {
                "metallicFactor": 0, "baseColorFactor": [1.0, linear, 0.0, 0.5], "baseColorTexture": { "index": 0 } } },
            { "alphaMode": "BLEND", "pbrMetallicRoughness": { "metallicFactor": 0 } },
        ],
        "textures": [{ "source": 0 }],
        "images": [{ "name": "maps/paint.png", "bufferView": 2, "mimeType": "image/jpeg" }],
    });
    assert_eq!(document, expected);
    assert_eq!(&binary[..8], b"\xff\xd8\xff!?\0\0\0");
    let mut vertex = Vec::new();
    for value in [1.0_f32, 0.5, 0.0, 0.0, 0.0, 1.0, 0.25, 0.0] {
        vertex.extend(value.to_le_bytes());
    }
    for value in [65_535_u16, 0, 2_170, 128 * 257] {
        vertex.extend(value.to_le_bytes());
    }
    assert_eq!(binary[8 + 40..8 + 80], vertex);
    let corners: Vec<u32> =
        binary[128..].chunks(4).map(|corner| u32::from_le_bytes(corner.try_into().unwrap())).collect();
    assert_eq!(corners, [0, 1, 2, 0, 1, 2, 2, 1, 0]);
}

#[test]
fn what_glb_has_no_place_for_is_told() {
    let mut mesh = painted();
    let appearance = &mut mesh.layout.attributes.as_mut().unwrap().appearance;
    appearance.materials[1].base_colour = Some([0.0, 1.5, 0.0, 1.0]);
    let memory = MemoryDisk::new();
    let written = mesh.write(&memory, "mesh.glb", &mut |_, _| Ok(Some(b"GIF89a".to_vec()))).unwrap();
    assert!(written.left_out[0].contains("neither PNG nor JPEG"), "{:?}", written.left_out);
    assert!(written.left_out[1].contains("above 1"), "{:?}", written.left_out);
    let (document, _) = parts(&memory.bytes("mesh.glb").unwrap());
    assert_eq!(document["materials"][1]["pbrMetallicRoughness"]["baseColorFactor"][1], 1.0);
    assert!(document.get("images").is_none() && document.get("textures").is_none());

    for vertices in [0, 1] {
        let layout = MeshLayout { vertices, triangles: 0, ..mesh.layout.clone() };
        let empty = Mesh { layout, vertices: mesh.vertices[..vertices as usize].to_vec(), triangles: Vec::new() };
        let written = empty.write(&memory, "mesh.glb", &mut |_, _| Ok(Some(b"\x89PNG".to_vec()))).unwrap();
        let (document, _) = parts(&memory.bytes("mesh.glb").unwrap());
        assert!(document.get("meshes").is_none());
        assert_eq!(written.left_out.len() as u64, vertices);
        assert!(found(&memory, "mesh.glb").0.is_empty());
    }
}

#[test]
fn coordinates_in_double_precision_are_those_of_the_node() {
    let memory = MemoryDisk::new();
    let layout = MeshLayout { coordinates: CoordinateType::Double, origin: [4e6, 5e6, 100.0], ..layout(3, 1) };
    let positions = [[4e6 + 0.125, 5e6, 100.0], [4e6, 5e6 + 0.1, 100.0], [4e6, 5e6, 99.5]];
    let mut writer =
        MeshWriter::create(Arc::new(memory.clone()), Path::new("mesh.glb"), OutputFormat::Glb, layout).unwrap();
    let error = writer.vertex([0.0, 1e39, 0.0], None).unwrap_err();
    assert!(matches!(error, MeshError::NotFinite { index: 0, axis: 'y', .. }));
    positions.iter().for_each(|position| writer.vertex(*position, None).unwrap());
    writer.triangle([0, 1, 2], MeshWriter::NO_MATERIAL).unwrap();
    // A tenth is nowhere exact.
    assert_eq!(writer.finish().unwrap().left_out.len(), 1);
    let (document, _) = parts(&memory.bytes("mesh.glb").unwrap());
    assert_eq!(document["nodes"][0]["translation"], serde_json::json!([4e6, 5e6, 100.0]));
    let (_, sink) = found(&memory, "mesh.glb");
    assert_eq!((sink.plain.vertices[0], sink.plain.vertices[2]), (positions[0], positions[2]));
    assert!((sink.plain.vertices[1][1] - positions[1][1]).abs() < 1e-8);
}

/// More triangles than the memory for sorting them has room for, of two materials in turn.
#[test]
fn triangles_are_sorted_on_disk_where_they_are_many() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.glb");
    let mut mesh = painted();
    let count = 600_000;
    mesh.layout.triangles = count;
    let disk: Arc<dyn Disk> = Arc::new(LocalDisk);
    let mut writer = MeshWriter::create(disk, &path, OutputFormat::Glb, mesh.layout.clone()).unwrap();
    for (position, wedge) in &mesh.vertices {
        writer.vertex(*position, Some(wedge)).unwrap();
    }
    for number in 0..count {
        writer.triangle([number % 3, 1, 2], 1 + (number % 2) as u32).unwrap();
    }
    assert!(folder.path().join(".mesh.glb.triangles").exists());
    writer.finish().unwrap();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    let (_, binary) = parts(&std::fs::read(&path).unwrap());
    let corners = binary[binary.len() - 12 * count as usize..].chunks(12);
    let firsts = corners.map(|corners| u64::from(corners[0]));
    assert!(firsts.eq((0..count).step_by(2).chain((1..count).step_by(2)).map(|number| number % 3)));
}
