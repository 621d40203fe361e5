//! What is promised is held to, and what is written is read back.

mod glb;

use proptest::prelude::*;
use storage::{FaultyDisk, MemoryDisk};

use super::super::testing::{OwnedWedges, WithAttributes};
use super::super::{ImageSource, TriangleSink, gltf as gltf_reader, obj as obj_reader, ply as ply_reader, read_mesh};
use super::*;
use crate::tree::{AttributeKinds, Material, Normal};

pub(super) fn layout(vertices: u64, triangles: u64) -> MeshLayout {
    MeshLayout {
        vertices,
        triangles,
        coordinates: CoordinateType::Float,
        origin: [0.0; 3],
        comments: Vec::new(),
        attributes: None,
    }
}

fn writer(memory: &MemoryDisk, layout: MeshLayout) -> Result<MeshWriter, MeshError> {
    MeshWriter::create(Arc::new(memory.clone()), Path::new("mesh.ply"), OutputFormat::Ply, layout)
}

#[test]
fn one_triangle_byte_for_byte() {
    for (coordinates, name) in [(CoordinateType::Float, "float"), (CoordinateType::Double, "double")] {
        let memory = MemoryDisk::new();
        let layout = MeshLayout { coordinates, comments: vec!["made by hand".to_string()], ..layout(3, 1) };
        let mut writer = writer(&memory, layout).unwrap();
        let positions = [[0.0, 0.5, -1.0], [1.0, 0.1, 0.0], [0.0, 1.0, 2.5]];
        positions.iter().for_each(|&position| writer.vertex(position, None).unwrap());
        writer.triangle([2, 0, 1], MeshWriter::NO_MATERIAL).unwrap();
        let length = writer.finish().unwrap().bytes;

        let mut expected = format!(
            "ply\nformat binary_little_endian 1.0\ncomment made by hand\nelement vertex 3\n\
             property {name} x\nproperty {name} y\nproperty {name} z\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        )
        .into_bytes();
        for coordinate in positions.into_iter().flatten() {
            match coordinates {
                CoordinateType::Float => expected.extend((coordinate as f32).to_le_bytes()),
                CoordinateType::Double => expected.extend(coordinate.to_le_bytes()),
            }
        }
        expected.extend([3, 2, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]);
        assert_eq!(memory.bytes("mesh.ply").unwrap(), expected);
        assert_eq!(length, expected.len() as u64);
    }
}

#[test]
fn vertex_numbers_are_signed_while_they_fit() {
    assert!(ply::header(&layout(1 << 31, 1), &Names::default()).contains("uchar int "));
    assert!(ply::header(&layout((1 << 31) + 1, 1), &Names::default()).contains("uchar uint "));
    let memory = MemoryDisk::new();
    assert!(writer(&memory, layout(1 << 32, 1)).is_ok());
    let message = writer(&memory, layout((1 << 32) + 1, 1)).unwrap_err().to_string();
    assert!(message.contains("4294967297 vertices are more than"), "{message}");
}

#[test]
fn a_comment_is_one_line() {
    let layout = MeshLayout { comments: vec!["two\nlines".to_string()], ..layout(0, 0) };
    let message = writer(&MemoryDisk::new(), layout).unwrap_err().to_string();
    assert!(message.contains("is not one line"), "{message}");
}

#[test]
fn the_header_is_held_to() {
    let memory = MemoryDisk::new();
    let mut writer = writer(&memory, layout(2, 1)).unwrap();
    writer.vertex([0.0; 3], None).unwrap();
    let early = writer.triangle([0, 0, 0], MeshWriter::NO_MATERIAL).unwrap_err().to_string();
    assert_eq!(early, "mesh.ply: cannot write triangle 0: only 1 of the 2 vertices before it are written");
    writer.vertex([1.0; 3], None).unwrap();
    let many = writer.vertex([2.0; 3], None).unwrap_err().to_string();
    assert_eq!(many, "mesh.ply: cannot write vertex 2: the header promises 2 vertices");
    let range = writer.triangle([0, 1, 2], MeshWriter::NO_MATERIAL).unwrap_err();
    assert!(matches!(range, MeshError::CornerOutOfRange { face: 0, corner: 2, index: 2, vertices: 2, .. }));
    writer.triangle([0, 1, 0], MeshWriter::NO_MATERIAL).unwrap();
    let late = writer.vertex([2.0; 3], None).unwrap_err().to_string();
    assert_eq!(late, "mesh.ply: cannot write vertex 2: all vertices come before the first triangle");
    let many = writer.triangle([0, 1, 0], MeshWriter::NO_MATERIAL).unwrap_err().to_string();
    assert_eq!(many, "mesh.ply: cannot write triangle 1: the header promises 1 triangles");
    writer.finish().unwrap();
    assert_eq!(memory.paths().len(), 1);
}

#[test]
fn an_unfinished_file_does_not_appear() {
    let memory = MemoryDisk::new();
    let mut few = writer(&memory, layout(2, 0)).unwrap();
    few.vertex([0.0; 3], None).unwrap();
    let message = few.finish().unwrap_err().to_string();
    assert!(message.contains("only 1 of the 2 vertices that the header promises"), "{message}");
    let mut few = writer(&memory, layout(1, 1)).unwrap();
    few.vertex([0.0; 3], None).unwrap();
    let message = few.finish().unwrap_err().to_string();
    assert!(message.contains("only 0 of the 1 triangles that the header promises"), "{message}");
    assert!(memory.paths().is_empty());
}

#[test]
fn coordinates_are_finite_as_they_are_written() {
    let mut single = writer(&MemoryDisk::new(), layout(1, 0)).unwrap();
    let error = single.vertex([0.0, 1e39, 0.0], None).unwrap_err();
    assert!(matches!(error, MeshError::NotFinite { index: 0, axis: 'y', .. }));
    let layout = MeshLayout { coordinates: CoordinateType::Double, ..layout(1, 0) };
    let mut double = writer(&MemoryDisk::new(), layout).unwrap();
    let error = double.vertex([0.0, 1e39, f64::NAN], None).unwrap_err();
    assert!(matches!(error, MeshError::NotFinite { index: 0, axis: 'z', .. }));
    double.vertex([0.0, 1e39, 0.0], None).unwrap();
}

#[test]
fn a_full_disk_leaves_the_previous_file() {
    let memory = MemoryDisk::new();
    memory.insert("mesh.ply", b"old".to_vec());
    let disk = FaultyDisk::new(Arc::new(memory.clone()));
    disk.full_after(200_000);
    let mut writer =
        MeshWriter::create(Arc::new(disk), Path::new("mesh.ply"), OutputFormat::Ply, layout(50_000, 0)).unwrap();
    let result = (0..50_000).try_for_each(|_| writer.vertex([1.0; 3], None)).and_then(|()| writer.finish());
    let message = result.unwrap_err().to_string();
    assert!(message.contains("cannot write") && message.contains("mesh.ply"), "{message}");
    assert_eq!(memory.bytes("mesh.ply").unwrap(), b"old");
    assert_eq!(memory.paths().len(), 1);
}

/// A mesh as it is handed to a writer.
#[derive(Debug, Clone)]
struct Mesh {
    layout: MeshLayout,
    vertices: Vec<([f64; 3], Wedge)>,
    triangles: Vec<([u64; 3], u32)>,
}

/// A corner as a reader finds it: position, normal, colour, texture coordinate.
type Corner = ([f64; 3], Option<[f32; 3]>, Option<[u8; 4]>, Option<[f32; 2]>);
/// A triangle as a reader finds it, with its material.
type Found = ([Corner; 3], Option<u32>);

impl Mesh {
    fn write(&self, disk: &MemoryDisk, path: &str, images: &mut ImageBytes<'_>) -> Result<WrittenMesh, MeshError> {
        let path = Path::new(path);
        let format = OutputFormat::of(path).unwrap();
        let (disk, layout) = (Arc::new(disk.clone()), self.layout.clone());
        let mut writer = MeshWriter::create_with_images(disk, path, format, layout, images)?;
        self.vertices.iter().try_for_each(|(position, wedge)| writer.vertex(*position, Some(wedge)))?;
        self.triangles.iter().try_for_each(|(corners, material)| writer.triangle(*corners, *material))?;
        writer.finish()
    }

    fn appearance(&self) -> Appearance {
        self.layout.attributes.as_ref().map(|attributes| attributes.appearance.clone()).unwrap_or_default()
    }

    /// The corners of the triangles, and their materials, as a reader is to find them.
    fn expected(&self, format: OutputFormat) -> Vec<Found> {
        let appearance = self.appearance();
        let has_alpha = self.layout.attributes.as_ref().is_some_and(|attributes| attributes.has_alpha);
        let corner = |number: u64| {
            let (position, wedge) = &self.vertices[number as usize];
            let position = match self.layout.coordinates {
                CoordinateType::Float => position.map(|value| f64::from(value as f32)),
                CoordinateType::Double if format == OutputFormat::Glb => {
                    let origin = self.layout.origin;
                    [0, 1, 2].map(|axis| f64::from((position[axis] - origin[axis]) as f32) + origin[axis])
                }
                CoordinateType::Double => *position,
            };
            let [red, green, blue, alpha] = wedge.colour;
            let alpha = if has_alpha && format != OutputFormat::Obj { alpha } else { u8::MAX };
            let kinds = appearance.kinds;
            (
                position,
                kinds.normals.then(|| wedge.normal.decode()),
                kinds.colours.then_some([red, green, blue, alpha]),
                kinds.textures.then(|| appearance.texture_value(wedge.texture)),
            )
        };
        let material = |material: u32| material.checked_sub(1).filter(|_| !appearance.materials.is_empty());
        self.triangles.iter().map(|(corners, number)| (corners.map(corner), material(*number))).collect()
    }
}

/// What a reader finds in a file, corner by corner.
fn found(disk: &MemoryDisk, path: &str) -> (Vec<Found>, WithAttributes) {
    let path = Path::new(path);
    let mut sink = WithAttributes::default();
    let reader = match OutputFormat::of(path).unwrap() {
        OutputFormat::Ply => ply_reader::read,
        OutputFormat::Obj => obj_reader::read,
        OutputFormat::Glb => gltf_reader::read,
    };
    reader(disk, path, &mut sink).unwrap();
    let corners = sink.plain.faces.iter().zip(&sink.faces).map(|(corners, face)| {
        let corner = |at: usize| {
            let number = corners[at] as usize;
            let position = sink.plain.vertices[number];
            let (mut normal, colour, mut texture) = sink.vertices[number];
            if let OwnedWedges::Numbers(numbers) = &face.textures {
                texture = Some(sink.texture_coordinates[numbers[at] as usize]);
            }
            if let OwnedWedges::Numbers(numbers) = &face.normals {
                normal = Some(sink.normals[numbers[at] as usize]);
            }
            (position, normal, colour, texture)
        };
        ([0, 1, 2].map(corner), face.material)
    });
    let corners = corners.collect();
    (corners, sink)
}

/// A sink that the attributes are of interest to.
struct Counting(u64);

impl TriangleSink for Counting {
    fn wants_attributes(&self) -> bool {
        true
    }

    fn vertex(&mut self, _: [f64; 3]) -> Result<(), MeshError> {
        Ok(())
    }

    fn triangle(&mut self, _: [u64; 3]) -> Result<(), MeshError> {
        self.0 += 1;
        Ok(())
    }
}

fn appearances() -> impl Strategy<Value = Appearance> {
    let names = prop_oneof![
        Just(""),
        Just("wood.png"),
        Just("WOOD.png"),
        Just("../a b.jpg"),
        Just("folder\\-x.png"),
        Just("mesh.ply"),
        Just("mesh.mtl"),
        Just("two\nlines"),
        Just("a #b"),
        Just("no extension"),
    ];
    let name = names.prop_map(str::to_string);
    let colour = prop::option::of(prop::array::uniform4(prop_oneof![0.0_f32..1.0, Just(0.0), Just(1.0)]));
    let images = prop::collection::vec(name.clone(), 0..5);
    (any::<[bool; 4]>(), -16..3, images).prop_flat_map(
        move |([normals, colours, textures, materials], exponent, images)| {
            let most = if materials { 5 } else { 0 };
            let count = images.len();
            let image = (0..=count).prop_map(move |image| (image < count).then_some(image as u32));
            prop::collection::vec((name.clone(), colour.clone(), image), 0..=most).prop_map(move |materials| {
                Appearance {
                    kinds: AttributeKinds { normals, colours, textures, materials: !materials.is_empty() },
                    texture_exponent: exponent,
                    // Images that no material names are of no use to anybody.
                    images: images
                        .iter()
                        .filter(|_| !materials.is_empty())
                        .map(|name| Image { name: name.clone(), source: ImageSource::Missing })
                        .collect(),
                    materials: materials
                        .into_iter()
                        .map(|(name, base_colour, image)| Material { name, base_colour, image })
                        .collect(),
                }
            })
        },
    )
}

fn meshes() -> impl Strategy<Value = Mesh> {
    let coordinate = prop_oneof![
        prop::num::f32::NORMAL.prop_map(f64::from),
        (-1000_i16..1000).prop_map(f64::from),
        (-1.0..1.0),
        Just(f64::from(f32::from_bits(0x15ae_43fd))),
    ];
    let step = -Appearance::LARGEST_TEXTURE..=Appearance::LARGEST_TEXTURE;
    let wedge = (any::<u32>(), any::<[u8; 4]>(), [step.clone(), step], prop::array::uniform3(-1.0..1.0)).prop_map(
        |(material, colour, texture, normal)| Wedge { material, colour, texture, normal: Normal::encode(normal) },
    );
    let vertex = (prop::array::uniform3(coordinate), wedge);
    (appearances(), prop::collection::vec(vertex, 3..20), any::<[bool; 3]>())
        .prop_flat_map(|(appearance, vertices, flags)| {
            let (corner, material) = (0..vertices.len() as u64, 0..=appearance.materials.len() as u32);
            let triangles = prop::collection::vec((prop::array::uniform3(corner), material), 1..30);
            (Just(appearance), Just(vertices), triangles, Just(flags))
        })
        .prop_map(|(appearance, vertices, triangles, [is_single, has_alpha, has_comment])| Mesh {
            layout: MeshLayout {
                vertices: vertices.len() as u64,
                triangles: triangles.len() as u64,
                coordinates: if is_single { CoordinateType::Float } else { CoordinateType::Double },
                origin: if is_single { [0.0; 3] } else { [1e6, -0.5, 3.0] },
                comments: has_comment.then(|| "made by a test".to_string()).into_iter().collect(),
                attributes: Some(LayoutAttributes { appearance, has_alpha, may_replace: false }),
            },
            vertices,
            triangles,
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn what_is_written_is_read_back(mesh in meshes()) {
        let appearance = mesh.appearance();
        for path in ["folder/mesh.ply", "folder/mesh.obj"] {
            let format = OutputFormat::of(Path::new(path)).unwrap();
            let disk = MemoryDisk::new();
            let written = mesh.write(&disk, path, &mut |number, _| {
                Ok((number != 1).then(|| [b"\x89PNG".as_slice(), &[number as u8]].concat()))
            });
            let written = written.unwrap();
            prop_assert_eq!(written.bytes, disk.bytes(path).unwrap().len() as u64);
            let (corners, sink) = found(&disk, path);
            prop_assert_eq!(corners, mesh.expected(format));
            prop_assert_eq!(sink.plain.vertices.len(), mesh.vertices.len());

            // Materials: names may have been made plain, colours and images are the same.
            prop_assert_eq!(sink.materials.len(), appearance.materials.len());
            let mut names = Vec::new();
            let mut files = Vec::new();
            for (read, material) in sink.materials.iter().zip(&appearance.materials) {
                prop_assert_eq!(read.base_colour, material.base_colour);
                prop_assert!(!read.name.is_empty() && !names.contains(&read.name), "{:?}", sink.materials);
                names.push(read.name.clone());
                let source = read.image.as_ref().map(|image| &image.source);
                match (source, material.image) {
                    (None, None) => {}
                    (Some(ImageSource::Missing), Some(1)) => {}
                    (Some(ImageSource::File(file)), Some(number)) => {
                        prop_assert_eq!(file.parent(), Some(Path::new("folder")));
                        prop_assert_eq!(disk.bytes(file).unwrap(), [b"\x89PNG".as_slice(), &[number as u8]].concat());
                        prop_assert!(written.beside.contains(file));
                        files.push((number, file.to_string_lossy().to_lowercase()));
                    }
                    other => prop_assert!(false, "{:?}", other),
                }
            }
            files.sort();
            files.dedup();
            let count = files.len();
            files.dedup_by_key(|(_, file)| std::mem::take(file));
            prop_assert_eq!(files.len(), count);
            prop_assert!(written.beside.iter().all(|path| disk.bytes(path).is_some()));
            prop_assert_eq!(disk.paths().len(), 1 + written.beside.len());
            prop_assert_eq!(written.left_out.len(), usize::from(
                format == OutputFormat::Obj && appearance.kinds.colours
                    && mesh.layout.attributes.as_ref().is_some_and(|attributes| attributes.has_alpha)));

            // The gate in front of all readers has nothing against it.
            let mut counting = Counting(0);
            let summary = read_mesh(&disk, Path::new(path), &mut counting).unwrap();
            prop_assert_eq!((counting.0, summary.vertices), (mesh.triangles.len() as u64, mesh.vertices.len() as u64));
            prop_assert_eq!(summary.attributes.vertex_colours > 0, appearance.kinds.colours);
        }
    }
}

/// A triangle with everything, in red paint.
fn painted() -> Mesh {
    let appearance = Appearance {
        kinds: AttributeKinds { normals: true, colours: true, textures: true, materials: true },
        texture_exponent: -2,
        materials: vec![
            Material { name: "red paint".into(), base_colour: Some([1.0, 0.25, 0.0, 0.5]), image: Some(0) },
            Material { name: String::new(), base_colour: None, image: None },
        ],
        images: vec![Image { name: "maps/paint.png".into(), source: ImageSource::Missing }],
    };
    let wedge = Wedge { material: 1, texture: [1, 4], colour: [255, 0, 51, 128], normal: Normal::UP };
    Mesh {
        layout: MeshLayout {
            attributes: Some(LayoutAttributes { appearance, has_alpha: true, may_replace: false }),
            ..layout(3, 3)
        },
        vertices: [[0.0; 3], [1.0, 0.5, 0.0], [0.0, 1.0, 0.0]].map(|position| (position, wedge)).to_vec(),
        triangles: vec![([0, 1, 2], 1), ([0, 1, 2], 0), ([2, 1, 0], 2)],
    }
}

#[test]
fn an_obj_file_with_everything_letter_for_letter() {
    let memory = MemoryDisk::new();
    let written = painted().write(&memory, "my mesh.obj", &mut |_, _| Ok(Some(b"png".to_vec()))).unwrap();
    let text = String::from_utf8(memory.bytes("my mesh.obj").unwrap()).unwrap();
    let attributes = "vt 0.25 1\nvn 0 0 1\n";
    let expected = format!(
        "mtllib my mesh.mtl\nv 0 0 0 1.0000 0.0000 0.2000\n{attributes}v 1 0.5 0 1.0000 0.0000 0.2000\n{attributes}\
         v 0 1 0 1.0000 0.0000 0.2000\n{attributes}usemtl red paint\nf 1/1/1 2/2/2 3/3/3\nusemtl\n\
         f 1/1/1 2/2/2 3/3/3\nusemtl material\nf 3/3/3 2/2/2 1/1/1\n"
    );
    assert_eq!(text, expected);
    let library = String::from_utf8(memory.bytes("my mesh.mtl").unwrap()).unwrap();
    assert_eq!(library, "newmtl red paint\nKd 1 0.25 0\nd 0.5\nmap_Kd paint.png\nnewmtl material\n");
    assert_eq!(written.beside, ["paint.png", "my mesh.mtl"].map(PathBuf::from));
    assert_eq!(written.left_out, ["the alpha of colours, for which OBJ has no place"]);
}

#[test]
fn a_ply_header_with_everything_letter_for_letter() {
    let memory = MemoryDisk::new();
    painted().write(&memory, "mesh.ply", &mut |_, _| Ok(None)).unwrap();
    let bytes = memory.bytes("mesh.ply").unwrap();
    let expected = "ply\nformat binary_little_endian 1.0\ncomment TextureFile paint.png\n\
                    comment VdtMaterial 0 1 0.25 0 0.5 red paint\ncomment VdtMaterial - - material\nelement vertex 3\n\
                    property float x\nproperty float y\nproperty float z\n\
                    property float nx\nproperty float ny\nproperty float nz\n\
                    property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n\
                    property float s\nproperty float t\n\
                    element face 3\nproperty list uchar int vertex_indices\nproperty int material_index\nend_header\n";
    assert!(bytes.starts_with(expected.as_bytes()), "{}", String::from_utf8_lossy(&bytes));
    assert_eq!(bytes.len(), expected.len() + 3 * (12 + 12 + 4 + 8) + 3 * (13 + 4));
    assert_eq!(memory.paths().len(), 1);
}

#[test]
fn other_files_are_not_replaced() {
    let write = |memory: &MemoryDisk, may_replace: bool| {
        let mut mesh = painted();
        mesh.layout.attributes.as_mut().unwrap().may_replace = may_replace;
        mesh.write(memory, "mesh.obj", &mut |_, _| Ok(Some(b"png".to_vec())))
    };
    for (name, content) in [("paint.png", "new"), ("paint.png", "longer"), ("mesh.mtl", "newmtl a\n")] {
        let memory = MemoryDisk::new();
        memory.insert(name, content);
        let message = write(&memory, false).unwrap_err().to_string();
        assert!(message.contains(name) && message.contains("use --force"), "{message}");
        assert_eq!(memory.bytes(name).unwrap(), content.as_bytes());
        assert!(memory.bytes("mesh.obj").is_none());
        write(&memory, true).unwrap();
        assert_ne!(memory.bytes(name).unwrap(), content.as_bytes());
        // What is there with the same content is no other file.
        write(&memory, false).unwrap();
    }
}

#[test]
fn what_no_format_can_hold_is_refused() {
    let refused = |change: fn(&mut Mesh)| {
        let mut mesh = painted();
        change(&mut mesh);
        let memory = MemoryDisk::new();
        let messages = ["mesh.ply", "mesh.obj", "mesh.glb"].map(|path| {
            let error = mesh.write(&memory, path, &mut |_, _| Ok(None)).unwrap_err();
            error.to_string().replace(path, "mesh")
        });
        assert!(memory.paths().is_empty());
        assert!(messages.iter().all(|message| *message == messages[0]), "{messages:?}");
        messages[0].clone()
    };
    fn appearance(mesh: &mut Mesh) -> &mut Appearance {
        &mut mesh.layout.attributes.as_mut().unwrap().appearance
    }
    let message = refused(|mesh| appearance(mesh).materials[1].base_colour = Some([0.0, f32::NAN, 0.0, 1.0]));
    assert_eq!(message, "mesh: cannot write material 1: its colour [0.0, NaN, 0.0, 1.0] is not finite");
    let message = refused(|mesh| appearance(mesh).materials[0].image = Some(1));
    assert_eq!(message, "mesh: cannot write material 0: it names image 1, and there are 1 (numbered from 0)");
    let message = refused(|mesh| mesh.triangles[2].1 = 3);
    assert_eq!(message, "mesh: cannot write triangle 2: it is of material 3, and there are 2 (numbered from 1)");

    let mut writer = writer(&MemoryDisk::new(), painted().layout).unwrap();
    let message = writer.vertex([0.0; 3], None).unwrap_err().to_string();
    assert_eq!(message, "mesh.ply: cannot write vertex 0: the header promises attributes, and it has none");

    let mut many = painted();
    appearance(&mut many).materials = vec![Material { name: "a".into(), base_colour: None, image: None }; 901];
    let message = many.write(&MemoryDisk::new(), "mesh.ply", &mut |_, _| Ok(None)).unwrap_err().to_string();
    assert!(message.contains("902 materials and images") && message.contains("write OBJ"), "{message}");
    assert!(many.write(&MemoryDisk::new(), "mesh.obj", &mut |_, _| Ok(None)).is_ok());
}

#[test]
fn bytes_of_images_come_from_wherever_they_are() {
    let memory = MemoryDisk::new();
    memory.insert("a.png", "0123456789");
    let bytes = |source: &ImageSource| image_bytes(&memory, source);
    assert_eq!(bytes(&ImageSource::File("a.png".into())).unwrap(), Some(b"0123456789".to_vec()));
    let part = |offset, length| ImageSource::Part { path: "a.png".into(), offset, length };
    assert_eq!(bytes(&part(3, 4)).unwrap(), Some(b"3456".to_vec()));
    assert_eq!(bytes(&ImageSource::Bytes(b"x".to_vec())).unwrap(), Some(b"x".to_vec()));
    assert_eq!(bytes(&ImageSource::Missing).unwrap(), None);
    for part in [part(3, 8), part(u64::MAX, 2), part(0, u64::MAX)] {
        assert!(bytes(&part).unwrap_err().to_string().contains("a.png is too short"));
    }
}

#[test]
fn the_extension_says_the_format() {
    for (path, format) in [
        ("a.ply", Some(OutputFormat::Ply)),
        ("a.b/c.OBJ", Some(OutputFormat::Obj)),
        ("c.glb", Some(OutputFormat::Glb)),
        ("c.gltf", None),
        ("a.stl", None),
        ("ply", None),
        (".obj", None),
    ] {
        assert_eq!(OutputFormat::of(Path::new(path)), format, "{path}");
    }
}
