//! Attributes of every kind, in core and stored, on random meshes with next to no memory, and in any order of the file.

use std::fmt::Write;
use std::path::PathBuf;

use proptest::prelude::*;
use storage::{MemoryDisk, Scratch};

use super::limits::Limits;
use super::tests::{FileContent, all, check, in_core, meshes, rule, scratch_on, store_within};
use super::*;

/// Numbers without order.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % limit
    }

    /// One of few, or none.
    fn maybe(&mut self, is_there: bool, limit: usize) -> Option<usize> {
        let number = self.below(limit + 1);
        (is_there && number < limit).then_some(number)
    }
}

/// Which attributes a file has.
#[derive(Debug, Clone, Copy)]
struct Kinds {
    vertex_colours: bool,
    vertex_normals: bool,
    vertex_textures: bool,
    corner_textures: bool,
    corner_normals: bool,
    face_colours: bool,
    materials: bool,
}

fn kinds() -> impl Strategy<Value = Kinds> {
    let often = || prop_oneof![2 => Just(false), 1 => Just(true)];
    let of_corners = (often(), often(), often(), often());
    (of_corners, any::<[bool; 3]>()).prop_map(|((corner_textures, corner_normals, face_colours, materials), vertex)| {
        Kinds {
            vertex_colours: vertex[0],
            vertex_normals: vertex[1],
            vertex_textures: vertex[2],
            corner_textures,
            corner_normals,
            face_colours,
            materials,
        }
    })
}

/// What a vertex has: numbers of values.
#[derive(Debug, Clone)]
struct RichVertex {
    position: [f64; 3],
    colour: Option<usize>,
    normal: usize,
    texture: usize,
}

#[derive(Debug, Clone)]
struct RichTriangle {
    corners: [usize; 3],
    textures: [Option<usize>; 3],
    normals: [Option<usize>; 3],
    colour: usize,
    material: Option<usize>,
}

/// What one file holds.
#[derive(Debug, Clone)]
struct RichFile {
    kinds: Kinds,
    vertices: Vec<RichVertex>,
    triangles: Vec<RichTriangle>,
    is_obj: bool,
    lists_come_last: bool,
}

const TEXTURES: [[f32; 2]; 5] = [[0.0, 0.0], [0.25, 1.0], [-0.0, 1e-9], [0.1, -3.7], [300.0, 0.5]];
const NORMALS: [[f32; 3]; 4] = [[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [-1.0, 0.5, 0.1], [0.0; 3]];
const MATERIALS: usize = 3;

impl RichFile {
    fn of(content: &FileContent, kinds: Kinds, is_obj: bool, lists_come_last: bool, random: &mut Random) -> Self {
        let variety = 1 + random.below(4);
        let vertices = content.positions.iter().map(|position| RichVertex {
            position: *position,
            colour: random.maybe(kinds.vertex_colours, variety),
            normal: random.below(variety.min(NORMALS.len())),
            texture: random.below(variety),
        });
        let vertices = vertices.collect();
        let triangles = content.triangles.iter().map(|corners| RichTriangle {
            corners: *corners,
            textures: [0; 3].map(|_| random.maybe(kinds.corner_textures, TEXTURES.len())),
            normals: [0; 3].map(|_| random.maybe(kinds.corner_normals, NORMALS.len())),
            colour: random.below(variety),
            material: random.maybe(kinds.materials, variety.min(MATERIALS)),
        });
        let triangles = triangles.collect();
        RichFile { kinds, vertices, triangles, is_obj, lists_come_last }
    }

    /// Vertices and triangles in another order, each triangle turned.
    fn shuffled(&self, random: &mut Random) -> Self {
        let mut places: Vec<usize> = (0..self.vertices.len()).collect();
        (1..places.len()).rev().for_each(|last| places.swap(last, random.below(last + 1)));
        let mut file = self.clone();
        places.iter().zip(&self.vertices).for_each(|(place, vertex)| file.vertices[*place] = vertex.clone());
        for triangle in &mut file.triangles {
            triangle.corners = triangle.corners.map(|corner| places[corner]);
            let turn = random.below(3);
            triangle.corners.rotate_left(turn);
            triangle.textures.rotate_left(turn);
            triangle.normals.rotate_left(turn);
        }
        (1..file.triangles.len()).rev().for_each(|last| file.triangles.swap(last, random.below(last + 1)));
        file
    }

    fn text(&self) -> String {
        if self.is_obj { self.as_obj() } else { self.as_ply() }
    }

    fn as_obj(&self) -> String {
        let lists: String = TEXTURES
            .iter()
            .map(|[u, v]| format!("vt {u:?} {v:?}\n"))
            .chain(NORMALS.iter().map(|[x, y, z]| format!("vn {x:?} {y:?} {z:?}\n")))
            .collect();
        let mut text = "# made for a test\nmtllib m.mtl\n".to_string();
        if !self.lists_come_last {
            text += &lists;
        }
        for RichVertex { position: [x, y, z], colour, .. } in &self.vertices {
            let colour = colour.map_or(String::new(), |number| format!(" 0.{number} 0.5 0.25"));
            writeln!(text, "v {x:?} {y:?} {z:?}{colour}").unwrap();
        }
        for triangle in &self.triangles {
            if self.kinds.materials {
                // One without a name in the library has no number of its own in another order: all have one.
                writeln!(text, "usemtl m{}", triangle.material.unwrap_or(0)).unwrap();
            }
            text += "f";
            for corner in 0..3 {
                write!(text, " {}", triangle.corners[corner] + 1).unwrap();
                match (triangle.textures[corner], triangle.normals[corner]) {
                    (None, None) => {}
                    (Some(texture), None) => write!(text, "/{}", texture + 1).unwrap(),
                    (None, Some(normal)) => write!(text, "//{}", normal + 1).unwrap(),
                    (Some(texture), Some(normal)) => write!(text, "/{}/{}", texture + 1, normal + 1).unwrap(),
                }
            }
            text += "\n";
        }
        if self.lists_come_last {
            text += &lists;
        }
        text
    }

    fn as_ply(&self) -> String {
        let Kinds { vertex_colours, vertex_normals, vertex_textures, corner_textures, corner_normals, .. } = self.kinds;
        let mut text = "ply\nformat ascii 1.0\n".to_string();
        (0..MATERIALS).for_each(|number| writeln!(text, "comment TextureFile {number}.png").unwrap());
        writeln!(text, "element vertex {}", self.vertices.len()).unwrap();
        let mut properties = |kind: &str, names: &str, is_there: bool| {
            names.split(' ').filter(|_| is_there).for_each(|name| writeln!(text, "property {kind} {name}").unwrap());
        };
        properties("double", "x y z", true);
        properties("uchar", "red green blue alpha", vertex_colours);
        properties("float", "nx ny nz", vertex_normals);
        properties("float", "u v", vertex_textures);
        writeln!(text, "element face {}\nproperty list uchar int vertex_indices", self.triangles.len()).unwrap();
        let mut properties = |kind: &str, names: &str, is_there: bool| {
            names.split(' ').filter(|_| is_there).for_each(|name| writeln!(text, "property {kind} {name}").unwrap());
        };
        properties("list uchar float", "texcoord", corner_textures);
        properties("list uchar float", "wedge_normal", corner_normals);
        properties("uchar", "red green blue", self.kinds.face_colours);
        properties("int", "texnumber", self.kinds.materials);
        text += "end_header\n";
        for RichVertex { position: [x, y, z], colour, normal, texture } in &self.vertices {
            write!(text, "{x:?} {y:?} {z:?}").unwrap();
            if vertex_colours {
                write!(text, " {} 7 9 {}", colour.unwrap_or(99), 200 + colour.unwrap_or(0)).unwrap();
            }
            let [nx, ny, nz] = NORMALS[*normal];
            if vertex_normals {
                write!(text, " {nx:?} {ny:?} {nz:?}").unwrap();
            }
            let [u, v] = TEXTURES[*texture];
            if vertex_textures {
                write!(text, " {u:?} {v:?}").unwrap();
            }
            text += "\n";
        }
        for RichTriangle { corners: [a, b, c], textures, normals, colour, material } in &self.triangles {
            write!(text, "3 {a} {b} {c}").unwrap();
            // A list is whole or empty.
            if corner_textures {
                list(&mut text, textures.map(|number| number.map(|number| TEXTURES[number])));
            }
            if corner_normals {
                list(&mut text, normals.map(|number| number.map(|number| NORMALS[number])));
            }
            if self.kinds.face_colours {
                write!(text, " {colour} 100 200").unwrap();
            }
            if self.kinds.materials {
                write!(text, " {}", material.map_or(-1, |number| number as i64)).unwrap();
            }
            text += "\n";
        }
        text
    }
}

fn list<const N: usize>(text: &mut String, values: [Option<[f32; N]>; 3]) {
    if values.iter().any(Option::is_none) {
        *text += " 0";
        return;
    }
    write!(text, " {}", 3 * N).unwrap();
    values.iter().flatten().flatten().for_each(|value| write!(text, " {value:?}").unwrap());
}

fn on_disk(files: &[RichFile]) -> (MemoryDisk, Vec<PathBuf>) {
    let disk = MemoryDisk::new();
    disk.insert("m.mtl", "newmtl m0\nnewmtl m1\nmap_Kd 1.png\nnewmtl m2\nKd 1 0 0.5\n");
    disk.insert("1.png", "not read");
    let paths: Vec<PathBuf> = (0..files.len()).map(|number| PathBuf::from(format!("{number}.mesh"))).collect();
    for (number, file) in files.iter().enumerate() {
        disk.insert(&paths[number], file.text());
    }
    (disk, paths)
}

/// The stored attributes are those in core.
pub(super) fn check_attributes(stored: &StoredMesh, core: &CoreMesh) {
    let (Some(stored), Some(core)) = (&stored.attributes, &core.attributes) else {
        assert!(stored.attributes.is_none() && core.attributes.is_none());
        return;
    };
    assert_eq!(stored.appearance, core.appearance);
    assert_eq!(all(&stored.wedges), core.wedges.concat());
    assert!(core.wedges.iter().all(|wedges| wedges.is_sorted_by(|left, right| left.order() < right.order())));
    let has_seams = core.wedges.iter().any(|wedges| wedges.len() > 1);
    assert_eq!(stored.seams.is_some(), has_seams);
    let Some(seams) = &stored.seams else { return };
    let mut first = 0;
    let firsts = core.wedges.iter().map(|wedges| {
        first += wedges.len() as u32;
        first - wedges.len() as u32
    });
    assert_eq!(all(&seams.first_wedges), firsts.collect::<Vec<_>>());
    assert_eq!(all(&seams.corners), core.corners);
}

fn files() -> impl Strategy<Value = Vec<(FileContent, Kinds, bool, bool)>> {
    let of_files = prop::collection::vec((kinds(), any::<bool>(), any::<bool>()), 3);
    (meshes(), of_files).prop_map(|(contents, of_files)| {
        contents.into_iter().zip(of_files).map(|(content, (kinds, obj, last))| (content, kinds, obj, last)).collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn any_attributes_in_any_memory_and_any_order_are_those_in_core(
        contents in files(),
        rule in rule(),
        seed: u64,
        memory in prop_oneof![0_usize..4000, Just(1 << 20)],
        block_triangles in prop_oneof![0_u64..40, Just(u64::MAX)],
        vertex_chunk in 1_usize..30,
        triangle_chunk in 1_u64..30,
        threads in 1_usize..3,
        in_memory: bool,
    ) {
        let mut random = Random(seed);
        let files: Vec<RichFile> = contents
            .iter()
            .map(|(content, kinds, is_obj, last)| RichFile::of(content, *kinds, *is_obj, *last, &mut random))
            .collect();
        let (disk, paths) = on_disk(&files);
        let limits = Limits { memory, threads, block_triangles, vertex_chunk, triangle_chunk };
        let temporary = MemoryDisk::new();
        let scratch = if in_memory { Scratch::in_memory() } else { scratch_on(temporary.clone()) };
        match (store_within(&disk, &scratch, &paths, rule, &limits), in_core(&disk, &paths, rule)) {
            (Ok(mut stored), Ok((core, counts))) => {
                prop_assert_eq!(stored.files, counts);
                check(&stored, &core, block_triangles.min(1 << 32));
                check_attributes(&stored, &core);
                let kept = stored.keep(&scratch).unwrap();
                if !in_memory {
                    let text = serde_json::to_string(&kept).unwrap();
                    let again = StoredMesh::reopen(&scratch, &serde_json::from_str(&text).unwrap()).unwrap();
                    check_attributes(&again, &core);
                    prop_assert_eq!(again.missing_files, stored.missing_files);
                }

                let shuffled: Vec<RichFile> = files.iter().map(|file| file.shuffled(&mut random)).collect();
                let (disk, paths) = on_disk(&shuffled);
                let (other, _) = in_core(&disk, &paths, rule).unwrap();
                prop_assert_eq!(&other.attributes, &core.attributes);
                let stored = store_within(&disk, &scratch, &paths, rule, &limits).unwrap();
                check(&stored, &core, block_triangles.min(1 << 32));
                check_attributes(&stored, &core);
            }
            (Err(stored), Err(core)) => prop_assert_eq!(stored.to_string(), core.to_string()),
            (stored, core) => prop_assert!(false, "stored: {:?}, in core: {:?}", stored.is_ok(), core.is_ok()),
        }
    }
}
