//! What the shapes promise, checked on the bytes of the files.

use std::collections::{HashMap, HashSet};

use storage::{FaultyDisk, MemoryDisk};

use super::*;

const FEW: [u64; 14] = [10, 11, 12, 13, 16, 24, 25, 31, 50, 100, 333, 999, 1000, 1001];
const MANY: [u64; 2] = [5003, 20_000];

struct Mesh {
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
}

fn bytes_of(shape: Shape, triangles: u64, seed: u64) -> Vec<u8> {
    let memory = MemoryDisk::new();
    let options = GenerateOptions { shape, triangles, seed };
    let summary = generate(Arc::new(memory.clone()), Path::new("mesh.ply"), &options, &mut |_| {}).unwrap();
    let bytes = memory.bytes("mesh.ply").unwrap();
    let header = format!("element vertex {}\nproperty float x\n", summary.vertices);
    assert!(String::from_utf8_lossy(&bytes[..300]).contains(&header));
    assert_eq!(summary.bytes, bytes.len() as u64);
    bytes
}

fn make(shape: Shape, triangles: u64, seed: u64) -> Mesh {
    let bytes = bytes_of(shape, triangles, seed);
    let mark = b"end_header\n";
    let header_length = bytes.windows(mark.len()).position(|window| window == mark).unwrap() + mark.len();
    let header = String::from_utf8(bytes[..header_length].to_vec()).unwrap();
    let number = |name: &str| -> usize {
        header.lines().find_map(|line| line.strip_prefix(name)).unwrap().trim().parse().unwrap()
    };
    let (vertices, body) = (number("element vertex"), &bytes[header_length..]);
    let word = |bytes: &[u8]| u32::from_le_bytes(bytes.try_into().unwrap());
    let positions = body[..12 * vertices]
        .chunks_exact(12)
        .map(|bytes| [0, 4, 8].map(|start| f32::from_bits(word(&bytes[start..start + 4]))))
        .collect();
    let faces = body[12 * vertices..].chunks_exact(13);
    assert!(faces.remainder().is_empty());
    let triangles: Vec<[u32; 3]> = faces
        .map(|bytes| {
            assert_eq!(bytes[0], 3);
            [1, 5, 9].map(|start| word(&bytes[start..start + 4]))
        })
        .collect();
    assert_eq!(triangles.len(), number("element face"));
    Mesh { positions, triangles }
}

impl Mesh {
    fn position(&self, vertex: u32) -> [f64; 3] {
        self.positions[vertex as usize].map(f64::from)
    }

    fn edges_of(triangle: [u32; 3]) -> [(u32, u32); 3] {
        let [a, b, c] = triangle;
        [(a, b), (b, c), (c, a)]
    }

    /// How many triangles have each edge, whichever way they run through it.
    fn edge_uses(&self) -> HashMap<(u32, u32), usize> {
        let mut uses = HashMap::new();
        for (a, b) in self.triangles.iter().flat_map(|&triangle| Mesh::edges_of(triangle)) {
            *uses.entry((a.min(b), a.max(b))).or_default() += 1;
        }
        uses
    }

    /// How many vertices have triangles around them that do not hang together there.
    fn split_vertices(&self) -> usize {
        // Around each vertex: its triangles as links between their two other corners.
        let mut links: Vec<Vec<(u32, u32)>> = vec![Vec::new(); self.positions.len()];
        for &[a, b, c] in &self.triangles {
            links[a as usize].push((b, c));
            links[b as usize].push((c, a));
            links[c as usize].push((a, b));
        }
        let is_split = |links: Vec<(u32, u32)>| {
            let mut left = links;
            let mut reached: Vec<u32> = left.pop().map_or(Vec::new(), |(a, b)| vec![a, b]);
            while let Some(next) = left.iter().position(|(a, b)| reached.contains(a) || reached.contains(b)) {
                let (a, b) = left.swap_remove(next);
                reached.extend([a, b]);
            }
            !left.is_empty()
        };
        links.into_iter().filter(|links| is_split(links.clone())).count()
    }

    fn components(&self) -> usize {
        let mut parent: Vec<u32> = (0..self.positions.len() as u32).collect();
        fn root(parent: &mut [u32], mut vertex: u32) -> u32 {
            while parent[vertex as usize] != vertex {
                parent[vertex as usize] = parent[parent[vertex as usize] as usize];
                vertex = parent[vertex as usize];
            }
            vertex
        }
        for &[a, b, c] in &self.triangles {
            for other in [b, c] {
                let (one, two) = (root(&mut parent, a), root(&mut parent, other));
                parent[one as usize] = two;
            }
        }
        (0..).zip(&parent).filter(|&(vertex, &parent)| vertex == parent).count()
    }

    /// Vertices less edges plus triangles.
    fn euler_characteristic(&self) -> i64 {
        self.positions.len() as i64 - self.edge_uses().len() as i64 + self.triangles.len() as i64
    }

    /// Twice the area of a triangle, as a vector along its normal.
    fn normal(&self, triangle: [u32; 3]) -> [f64; 3] {
        let [a, b, c] = triangle.map(|corner| self.position(corner));
        let [u, v] = [b, c].map(|end| [0, 1, 2].map(|axis| end[axis] - a[axis]));
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    }

    /// Twice the area over the square of the longest edge: 0.87 for an equilateral triangle, 0 for one without area.
    fn quality(&self, triangle: [u32; 3]) -> f64 {
        let dot = |v: [f64; 3]| v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
        let longest = Mesh::edges_of(triangle)
            .map(|(a, b)| dot([0, 1, 2].map(|axis| self.position(b)[axis] - self.position(a)[axis])))
            .into_iter()
            .fold(0.0, f64::max);
        dot(self.normal(triangle)).sqrt() / longest
    }

    fn worst_quality(&self) -> f64 {
        self.triangles.iter().map(|&triangle| self.quality(triangle)).fold(1.0, f64::min)
    }

    /// Six times the volume inside.
    fn volume(&self) -> f64 {
        let of = |&triangle: &[u32; 3]| {
            let (normal, corner) = (self.normal(triangle), self.position(triangle[0]));
            normal[0] * corner[0] + normal[1] * corner[1] + normal[2] * corner[2]
        };
        self.triangles.iter().map(of).sum()
    }

    /// What every shape promises.
    fn check_soundness(&self, name: &str) {
        assert!(self.positions.iter().flatten().all(|coordinate| coordinate.is_finite()), "{name}");
        // -0 is 0: what counts is whether two vertices are in one place.
        let places: HashSet<[u32; 3]> = self.positions.iter().map(|place| place.map(|c| (c + 0.0).to_bits())).collect();
        assert_eq!(places.len(), self.positions.len(), "{name}: vertices in one place");
        let used: HashSet<u32> = self.triangles.iter().flatten().copied().collect();
        assert_eq!(used.len(), self.positions.len(), "{name}: vertices without a triangle");
        assert!(used.iter().all(|&vertex| (vertex as usize) < self.positions.len()), "{name}");
        assert!(self.worst_quality() > 1e-4, "{name}: a sliver, quality {}", self.worst_quality());
    }

    /// Every edge has one triangle on either side, or two in a sheet's inside and one at its boundary, and they
    /// agree on what is outside.
    fn check_manifold(&self, closed: bool, name: &str) {
        let directed: HashSet<(u32, u32)> =
            self.triangles.iter().flat_map(|&triangle| Mesh::edges_of(triangle)).collect();
        assert_eq!(directed.len(), 3 * self.triangles.len(), "{name}: an edge runs twice the same way");
        let open = directed.iter().filter(|&&(a, b)| !directed.contains(&(b, a))).count();
        assert_eq!(open == 0, closed, "{name}: {open} boundary edges");
        assert_eq!(self.split_vertices(), 0, "{name}: vertices with more than one fan");
    }
}

#[test]
fn every_shape_is_sound_and_has_the_promised_number_of_triangles() {
    for shape in Shape::ALL {
        for triangles in FEW.into_iter().chain(MANY) {
            for seed in [0, u64::MAX] {
                let name = format!("{shape} of {triangles}, seed {seed}");
                let mesh = make(shape, triangles, seed);
                let even = matches!(shape, Shape::Sphere | Shape::Gyroid);
                let promised = if even { triangles & !1 } else { triangles };
                assert_eq!(mesh.triangles.len() as u64, promised, "{name}");
                mesh.check_soundness(&name);
            }
        }
    }
}

#[test]
fn any_number_of_triangles_will_do() {
    for shape in Shape::ALL {
        for triangles in (10..130).chain((130..1000).step_by(29)) {
            let mesh = make(shape, triangles, triangles);
            let name = format!("{shape} of {triangles}");
            mesh.check_soundness(&name);
            match shape {
                Shape::Terrain => mesh.check_manifold(false, &name),
                Shape::Sphere | Shape::Gyroid => mesh.check_manifold(true, &name),
                Shape::City => assert!(mesh.components() >= 2, "{name}: {} parts", mesh.components()),
            }
        }
    }
}

#[test]
fn the_bytes_are_these() {
    // Should they change on purpose, then so do all results that were measured on generated meshes: say so.
    let sum = |bytes: &[u8]| {
        bytes.iter().fold(0xcbf2_9ce4_8422_2325u64, |sum, &byte| (sum ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
    };
    let sums = Shape::ALL.map(|shape| format!("{shape} {:016x}", sum(&bytes_of(shape, 5001, 7))));
    let expected =
        ["terrain c0f45b3de95322f8", "sphere d7f56028ec470325", "gyroid a8296b753aee730d", "city cb06e98df716e290"];
    assert_eq!(sums, expected);
}

#[test]
fn another_seed_gives_another_mesh_and_the_same_one_the_same() {
    for shape in Shape::ALL {
        let meshes = [1, 1, 2, 1 << 40].map(|seed| {
            let mesh = make(shape, 2000, seed);
            (mesh.positions.into_iter().map(|place| place.map(f32::to_bits)).collect::<Vec<_>>(), mesh.triangles)
        });
        assert!(meshes[0] == meshes[1], "{shape}");
        assert!(meshes[0].0 != meshes[2].0 && meshes[0].0 != meshes[3].0 && meshes[2].0 != meshes[3].0, "{shape}");
    }
}

#[test]
fn terrain_is_a_sheet_without_folds() {
    for (triangles, seed) in [(10, 0), (101, 1), (5003, 2), (60_000, 3), (60_000, 4)] {
        let name = format!("terrain of {triangles}, seed {seed}");
        let mesh = make(Shape::Terrain, triangles, seed);
        mesh.check_manifold(false, &name);
        assert_eq!((mesh.components(), mesh.euler_characteristic()), (1, 1), "{name}");
        assert!(mesh.triangles.iter().all(|&triangle| mesh.normal(triangle)[2] > 0.0), "{name}: a fold");
    }
}

#[test]
fn terrain_looks_like_mountains() {
    for seed in 0..6 {
        let mesh = make(Shape::Terrain, 40_000, seed);
        let extent = |axis: usize| {
            let values = mesh.positions.iter().map(|place| f64::from(place[axis]));
            values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
        };
        let [width, depth, height] = [0, 1, 2].map(extent);
        assert!((width - 10_000.0).abs() < 150.0 && (depth - 10_000.0).abs() < 150.0, "{width} by {depth}");
        assert!(height > 0.08 * width && height < 0.22 * width, "seed {seed}: {height} high");

        // Steep places there are, but no needles.
        let mut slopes: Vec<f64> = mesh
            .triangles
            .iter()
            .map(|&triangle| mesh.normal(triangle))
            .map(|normal| (normal[0] * normal[0] + normal[1] * normal[1]).sqrt() / normal[2])
            .collect();
        slopes.sort_by(f64::total_cmp);
        let at = |share: f64| slopes[(share * (slopes.len() - 1) as f64) as usize];
        assert!(at(0.5) > 0.25 && at(0.5) < 1.0, "seed {seed}: median slope {}", at(0.5));
        assert!(at(0.99) < 3.0 && at(1.0) < 8.0, "seed {seed}: slopes of {} and {}", at(0.99), at(1.0));

        // Triangles seen from above: the sampling is denser here than there.
        let mut areas: Vec<f64> = mesh.triangles.iter().map(|&triangle| mesh.normal(triangle)[2]).collect();
        areas.sort_by(f64::total_cmp);
        let spacing = (areas[areas.len() * 99 / 100] / areas[areas.len() / 100]).sqrt();
        assert!(spacing > 3.0 && spacing < 8.0, "seed {seed}: spacing varies by {spacing}");
    }
}

#[test]
fn the_sphere_is_closed_and_star_shaped() {
    for (triangles, seed) in [(10, 0), (12, 1), (14, 2), (101, 3), (5003, 4), (60_000, 5)] {
        let name = format!("sphere of {triangles}, seed {seed}");
        let mesh = make(Shape::Sphere, triangles, seed);
        mesh.check_manifold(true, &name);
        assert_eq!((mesh.components(), mesh.euler_characteristic()), (1, 2), "{name}");
        let outward = |&triangle: &[u32; 3]| {
            let (normal, corner) = (mesh.normal(triangle), mesh.position(triangle[0]));
            normal[0] * corner[0] + normal[1] * corner[1] + normal[2] * corner[2] > 0.0
        };
        assert!(mesh.triangles.iter().all(outward), "{name}: a triangle turned inward");
        assert!(mesh.worst_quality() > 0.25, "{name}: a sliver, quality {}", mesh.worst_quality());
    }
}

#[test]
fn the_gyroid_is_closed_and_full_of_holes() {
    for (triangles, seed, handles) in [(24, 0, 0), (1001, 1, 0), (5003, 2, 5), (20_000, 3, 15), (60_000, 4, 50)] {
        let name = format!("gyroid of {triangles}, seed {seed}");
        let mesh = make(Shape::Gyroid, triangles, seed);
        mesh.check_manifold(true, &name);
        assert!(mesh.volume() > 0.0, "{name}: inside out");
        let genus = mesh.components() as i64 - mesh.euler_characteristic() / 2;
        assert!(mesh.worst_quality() > 0.02, "{name}: a sliver, quality {}", mesh.worst_quality());
        assert!(genus >= handles, "{name}: {genus} handles");
        // Within the block, give or take a part of a lattice edge.
        let within = |place: &[f32; 3]| place[0].abs() < 55.0 && place[1].abs() < 55.0;
        assert!(triangles < 5000 || mesh.positions.iter().all(within), "{name}");
    }
}

#[test]
fn the_city_has_everything_that_a_mesh_can_have() {
    for (triangles, parts) in [(1000, 30), (20_000, 150), (100_000, 400)] {
        for seed in [0, 5] {
            let name = format!("city of {triangles}, seed {seed}");
            let mesh = make(Shape::City, triangles, seed);
            let uses = mesh.edge_uses();
            let with = |count: usize| uses.values().filter(|&&uses| uses == count).count();
            assert!(mesh.components() >= parts, "{name}: {} parts", mesh.components());
            assert!(with(1) > 0 && with(3) > 0 && with(4) > 0 && mesh.split_vertices() > 0, "{name}");
            assert_eq!(with(1) + with(2) + with(3) + with(4), uses.len(), "{name}");
        }
    }
}

#[test]
fn progress_runs_from_0_to_1() {
    for shape in Shape::ALL {
        let mut steps = Vec::new();
        let options = GenerateOptions { shape, triangles: 200_000, seed: 3 };
        generate(Arc::new(MemoryDisk::new()), Path::new("mesh.ply"), &options, &mut |share| steps.push(share)).unwrap();
        assert!(steps.len() > 3 && steps[0] == 0.0 && steps[steps.len() - 1] == 1.0, "{shape}: {steps:?}");
        assert!(steps.is_sorted(), "{shape}: {steps:?}");
    }
}

#[test]
fn numbers_and_names_out_of_range_are_refused() {
    for triangles in [0, 9, 1_000_000_001, u64::MAX] {
        let memory = MemoryDisk::new();
        let options = GenerateOptions { shape: Shape::City, triangles, seed: 0 };
        let error = generate(Arc::new(memory.clone()), Path::new("mesh.ply"), &options, &mut |_| {}).unwrap_err();
        let expected = format!(
            "a mesh of {triangles} triangles cannot be made: it takes at least 10 and at most 1000000000 of them"
        );
        assert_eq!(error.to_string(), expected);
        assert!(memory.paths().is_empty());
    }
    for shape in Shape::ALL {
        assert_eq!(shape.to_string().parse::<Shape>().unwrap(), shape);
    }
    let error = "torus".parse::<Shape>().unwrap_err().to_string();
    assert_eq!(error, "there is no shape \"torus\"; there are terrain, sphere, gyroid and city");
}

#[test]
fn a_full_disk_leaves_the_previous_file() {
    let memory = MemoryDisk::new();
    memory.insert("mesh.ply", b"old".to_vec());
    let disk = FaultyDisk::new(Arc::new(memory.clone()));
    disk.full_after(100_000);
    let options = GenerateOptions { shape: Shape::Terrain, triangles: 20_000, seed: 0 };
    let error = generate(Arc::new(disk), Path::new("mesh.ply"), &options, &mut |_| {}).unwrap_err();
    assert!(matches!(error, GenerateError::Mesh(MeshError::Storage(_))), "{error}");
    assert_eq!(memory.bytes("mesh.ply").unwrap(), b"old");
    assert_eq!(memory.paths().len(), 1);
}
