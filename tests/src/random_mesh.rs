//! Meshes of every kind that people have, for property tests: manifold or not, closed or with holes, in one part or in
//! many, on lattices (ties, flat regions) or not, with duplicate and degenerate triangles and unused vertices.

use proptest::prelude::*;

/// Positions and triangles, as a file would hold them.
#[derive(Debug, Clone, Default)]
pub struct RawMesh {
    /// Positions.
    pub positions: Vec<[f64; 3]>,
    /// Triangles.
    pub triangles: Vec<[u32; 3]>,
}

impl RawMesh {
    /// Adds another mesh beside this one.
    pub fn append(&mut self, other: &RawMesh, offset: [f64; 3]) {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions.iter().map(|p| [p[0] + offset[0], p[1] + offset[1], p[2] + offset[2]]));
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|corner| corner + first)));
    }

    /// The same mesh with every coordinate rounded to single precision, so that files of every format can hold it.
    pub fn in_single_precision(mut self) -> RawMesh {
        self.positions.iter_mut().flatten().for_each(|value| *value = f64::from(*value as f32));
        self
    }

    /// The same mesh with its vertices and triangles in another order, and each triangle rotated.
    pub fn shuffled(&self, seed: u64) -> RawMesh {
        let mut random = Random(seed);
        let mut order: Vec<u32> = (0..self.positions.len() as u32).collect();
        random.shuffle(&mut order);
        let mut place = vec![0; order.len()];
        order.iter().enumerate().for_each(|(new, old)| place[*old as usize] = new as u32);
        let mut triangles: Vec<[u32; 3]> =
            self.triangles.iter().map(|t| t.map(|corner| place[corner as usize])).collect();
        random.shuffle(&mut triangles);
        triangles.iter_mut().for_each(|corners| corners.rotate_left(random.below(3)));
        RawMesh { positions: order.iter().map(|old| self.positions[*old as usize]).collect(), triangles }
    }
}

/// A small random number generator (SplitMix64), so that meshes depend on their seed only.
#[derive(Debug, Clone)]
pub struct Random(pub u64);

impl Random {
    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number below `limit`.
    pub fn below(&mut self, limit: usize) -> usize {
        (self.bits() % limit.max(1) as u64) as usize
    }

    /// A number from -1 to 1.
    pub fn signed(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// Puts the items in random order.
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last + 1));
        }
    }
}

/// A sheet of `columns` by `rows` squares, its heights off by up to `height`, with `holes` triangles taken out.
pub fn sheet(columns: u32, rows: u32, height: f64, holes: usize, seed: u64) -> RawMesh {
    let mut random = Random(seed);
    let mut mesh = RawMesh::default();
    for row in 0..=rows {
        for column in 0..=columns {
            mesh.positions.push([f64::from(column), f64::from(row), height * random.signed()]);
        }
    }
    let at = |column: u32, row: u32| row * (columns + 1) + column;
    for row in 0..rows {
        for column in 0..columns {
            let [a, b] = [at(column, row), at(column + 1, row)];
            let [c, d] = [at(column + 1, row + 1), at(column, row + 1)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    for _ in 0..holes.min(mesh.triangles.len() - 1) {
        mesh.triangles.swap_remove(random.below(mesh.triangles.len()));
    }
    mesh
}

/// A torus of `around` by `across` squares: closed, of genus one.
pub fn torus(around: u32, across: u32, noise: f64, seed: u64) -> RawMesh {
    let mut random = Random(seed);
    let mut mesh = RawMesh::default();
    for i in 0..around {
        for j in 0..across {
            let (u, v) = (f64::from(i) / f64::from(around), f64::from(j) / f64::from(across));
            let (u, v) = (u * std::f64::consts::TAU, v * std::f64::consts::TAU);
            let ring = 3.0 + v.cos() + noise * random.signed();
            mesh.positions.push([ring * u.cos(), ring * u.sin(), v.sin() + noise * random.signed()]);
        }
    }
    let at = |i: u32, j: u32| (i % around) * across + j % across;
    for i in 0..around {
        for j in 0..across {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// An octahedron, each face cut `times` times in four, pushed out to a bumpy sphere.
pub fn sphere(times: u32, noise: f64, seed: u64) -> RawMesh {
    use std::collections::HashMap;
    let mut random = Random(seed);
    let axes = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
    let mut positions: Vec<[f64; 3]> = axes.iter().map(|p| p.map(f64::from)).collect();
    let mut triangles: Vec<[u32; 3]> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..times {
        let mut middles: HashMap<(u32, u32), u32> = HashMap::new();
        let mut middle = |a: u32, b: u32, positions: &mut Vec<[f64; 3]>| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let (p, q) = (positions[a as usize], positions[b as usize]);
                positions.push(std::array::from_fn(|axis| (p[axis] + q[axis]) * 0.5));
                positions.len() as u32 - 1
            })
        };
        triangles = triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let ab = middle(a, b, &mut positions);
                let bc = middle(b, c, &mut positions);
                let ca = middle(c, a, &mut positions);
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    for position in &mut positions {
        let length = position.iter().map(|x| x * x).sum::<f64>().sqrt();
        let radius = 1.0 + noise * random.signed();
        *position = position.map(|x| x / length * radius);
    }
    RawMesh { positions, triangles }
}

/// A closed box of twelve triangles.
pub fn closed_box() -> RawMesh {
    let positions = (0..8_u32).map(|corner| [corner & 1, corner >> 1 & 1, corner >> 2].map(f64::from)).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    RawMesh { positions, triangles }
}

/// Triangles between random points of a small lattice: everything can happen.
pub fn soup(points: usize, triangles: usize, lattice: usize, seed: u64) -> RawMesh {
    let mut random = Random(seed);
    let coordinate = |random: &mut Random| random.below(lattice) as f64;
    let positions =
        (0..points).map(|_| [coordinate(&mut random), coordinate(&mut random), coordinate(&mut random)]).collect();
    let triangles = (0..triangles).map(|_| [0; 3].map(|_: u32| random.below(points) as u32)).collect();
    RawMesh { positions, triangles }
}

/// One part of any kind.
fn part() -> impl Strategy<Value = RawMesh> {
    prop_oneof![
        3 => (1..9_u32, 1..9_u32, prop_oneof![Just(0.0), Just(0.3)], 0..6_usize, any::<u64>())
            .prop_map(|(columns, rows, height, holes, seed)| sheet(columns, rows, height, holes, seed)),
        2 => (3..9_u32, 3..9_u32, prop_oneof![Just(0.0), Just(0.2)], any::<u64>())
            .prop_map(|(around, across, noise, seed)| torus(around, across, noise, seed)),
        2 => (0..3_u32, prop_oneof![Just(0.0), Just(0.2)], any::<u64>())
            .prop_map(|(times, noise, seed)| sphere(times, noise, seed)),
        1 => Just(closed_box()),
        2 => (3..16_usize, 1..40_usize, 1..5_usize, any::<u64>())
            .prop_map(|(points, triangles, lattice, seed)| soup(points, triangles, lattice, seed)),
    ]
}

/// One to five parts, apart from each other, overlapping or touching at vertices and edges.
pub fn any_mesh() -> impl Strategy<Value = RawMesh> {
    let offset = prop_oneof![Just(0.0), Just(1.0), Just(20.0)];
    prop::collection::vec((part(), offset), 1..6).prop_map(|parts| {
        let mut mesh = RawMesh::default();
        for (number, (part, offset)) in parts.iter().enumerate() {
            mesh.append(part, [offset * number as f64, 0.0, 0.0]);
        }
        mesh
    })
}
