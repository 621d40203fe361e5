//! Gyroid: a closed surface with very many handles, a block of sponge. In small meshes there may be a few pieces.
//!
//! It bounds the part of a block where `sin x cos y + sin y cos z + sin z cos x` lies below a level that smooth
//! noise moves up and down, so that the walls are thick here and thin there. The larger the mesh, the more holes it
//! has and the finer each is cut: from one period of the gyroid along the side at a thousand triangles to some forty
//! at a thousand million. The block is a cube, or nearly one where there are few triangles; its width is 100.
//!
//! # How it is cut
//!
//! By marching tetrahedra on the body-centred cubic lattice, whose tetrahedra are all alike and nearly regular. A
//! vertex stands on every edge of the lattice of which one end is inside and the other outside; every tetrahedron
//! with ends of both kinds holds one triangle or two. Two tetrahedra that share a face agree on what is in it, all
//! lattice points near the rim are outside, and a triangle touches the faces of its tetrahedron only with its edges:
//! so the surface is a closed manifold, oriented outward, that does not cut itself, whatever the values at the
//! lattice points are. Vertices are kept [`MARGIN`] of the edge away from its ends, which rules out slivers and
//! vertices in one place.
//!
//! # How near to the number of triangles
//!
//! Exactly as many as asked for, less one if that is odd: a closed surface has an even number of them. Counting
//! passes tune the period of the gyroid (and, below 50,000 triangles, the height of the block) until there are up to
//! 1 % too few triangles (in rare cases 2 %; below 1000 mostly up to 10 %, never more than two thirds); half so many,
//! evenly spread, are then cut in three at their centres. Below 24 triangles, the fewest with which this lattice encloses
//! anything, there is the [`Sphere`] of that number in place of a gyroid.
//!
//! Memory: six planes of the lattice, O(triangles^(2/3)): about 30 MB for a thousand million triangles. Nothing is
//! stored between the passes; the field is computed anew for each.

use crate::mesh::MeshError;

use super::noise::{Noise, sine_and_cosine};
use super::sphere::Sphere;
use super::{Model, TriangleSink, VertexSink};

/// The width of the block.
const WIDTH: f64 = 100.0;
/// How close a vertex may come to either end of its lattice edge.
const MARGIN: f64 = 0.15;
/// Planes of points outside around the lattice points that may be inside.
const RIM: usize = 2;
/// Up to this number of triangles a counting pass costs next to nothing, and the search may do hundreds.
const FEW_TRIANGLES: u64 = 50_000;
/// Counting passes for a larger mesh, at most. Two do, but for some below a million triangles.
const PASSES: u64 = 12;

// Corners of a cluster, which is a lattice point and its seven neighbours that come after it: three at two half
// spacings along the axes, four diagonally in the next plane.
const X: usize = 1;
const Y: usize = 2;
const Z: usize = 3;
const PLACES: [[i32; 3]; 8] =
    [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2], [-1, -1, 1], [1, -1, 1], [-1, 1, 1], [1, 1, 1]];
/// The six tetrahedra of which the point is the first: every tetrahedron of the lattice belongs to one cluster.
const TETRAHEDRA: [[usize; 4]; 6] =
    [[0, Z, 4, 5], [0, Z, 5, 7], [0, Z, 7, 6], [0, Z, 6, 4], [0, X, 5, 7], [0, Y, 6, 7]];

/// An edge of the lattice as seen from a cluster: from one of its corners to that corner's own neighbour.
#[derive(Debug, Clone, Copy, Default)]
struct ClusterEdge {
    corner: usize,
    neighbour: usize,
}

/// What a cluster holds, for each of the 256 ways in which its corners can be inside (bit set) or outside.
struct Cases {
    triangles: Vec<Vec<[ClusterEdge; 3]>>,
}

impl Cases {
    fn new() -> Self {
        Cases { triangles: (0..=255).map(triangles_of_case).collect() }
    }
}

/// The triangles in the tetrahedra of a cluster, facing away from the corners inside.
fn triangles_of_case(signs: u8) -> Vec<[ClusterEdge; 3]> {
    let mut triangles = Vec::new();
    for tetrahedron in TETRAHEDRA {
        let (inside, outside): (Vec<usize>, Vec<usize>) =
            tetrahedron.into_iter().partition(|corner| signs >> corner & 1 == 1);
        let polygon: Vec<[usize; 2]> = match (inside.as_slice(), outside.as_slice()) {
            (&[a], &[b, c, d]) | (&[b, c, d], &[a]) => vec![[a, b], [a, c], [a, d]],
            (&[a, b], &[c, d]) => vec![[a, c], [a, d], [b, d], [b, c]],
            _ => continue,
        };
        // Twice the middles of the edges, and the direction from the inside to the outside.
        let middles: Vec<[i32; 3]> =
            polygon.iter().map(|&[a, b]| [0, 1, 2].map(|axis| PLACES[a][axis] + PLACES[b][axis])).collect();
        let away = [0, 1, 2].map(|axis| {
            let mean = |corners: &[usize]| {
                corners.iter().map(|&corner| PLACES[corner][axis]).sum::<i32>() * (12 / corners.len() as i32)
            };
            mean(&outside) - mean(&inside)
        });
        let [u, v] = [1, 2].map(|end| [0, 1, 2].map(|axis| middles[end][axis] - middles[0][axis]));
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        let outward = (0..3).map(|axis| normal[axis] * away[axis]).sum::<i32>() > 0;
        let edges: Vec<ClusterEdge> = polygon.iter().map(|&[a, b]| cluster_edge(a, b)).collect();
        for end in 2..edges.len() {
            let (second, third) = if outward { (end - 1, end) } else { (end, end - 1) };
            triangles.push([edges[0], edges[second], edges[third]]);
        }
    }
    triangles
}

/// The edge between two corners of a cluster: it belongs to the one from which the other is a neighbour after it.
fn cluster_edge(a: usize, b: usize) -> ClusterEdge {
    let neighbour_of = |from: usize, to: usize| {
        let step = [0, 1, 2].map(|axis| PLACES[to][axis] - PLACES[from][axis]);
        (1..8).find(|&neighbour| PLACES[neighbour] == step)
    };
    match (neighbour_of(a, b), neighbour_of(b, a)) {
        (Some(neighbour), _) => ClusterEdge { corner: a, neighbour },
        (None, Some(neighbour)) => ClusterEdge { corner: b, neighbour },
        // Any two corners of a tetrahedron are neighbours.
        (None, None) => ClusterEdge::default(),
    }
}

/// The size of the block.
#[derive(Debug, Clone, Copy)]
struct Size {
    /// In pairs of units, along x and along y.
    width: usize,
    /// In units.
    height: usize,
}

impl Size {
    /// The largest cube that has no more than about so many triangles.
    fn cube(triangles: u64, period: f64) -> Self {
        let fits = |width: usize| lids(width) + walls(width, period) <= triangles as f64;
        let width = (1..).take_while(|&width| fits(width)).last().unwrap_or(1);
        Size { width, height: 2 * width }
    }
}

/// The values at the lattice points: negative inside.
///
/// Planes lie one unit apart; in a plane, points lie two units apart, in odd planes shifted by one unit along x and
/// y.
struct Field {
    /// Points along x and along y.
    across: usize,
    /// Planes along z.
    planes: usize,
    /// Units to one period of the gyroid.
    period: f64,
    /// Sine and cosine of the angles that belong to the coordinates 0, 1, .. along x, y and z.
    waves: [Vec<(f64, f64)>; 3],
    level: [Noise; 2],
}

impl Field {
    /// `phase` says where in the block the gyroid begins, in some way.
    fn new(size: Size, period: f64, phase: u64, seed: u64) -> Self {
        let across = size.width + 2 * RIM;
        let planes = size.height + 2 * RIM;
        let phases = Noise::new(seed, 0);
        let waves = [0, 1, 2].map(|axis| {
            let start = phases.uniform(axis, phase);
            (0..planes.max(2 * across)).map(|place| sine_and_cosine(start + place as f64 / period)).collect()
        });
        Field { across, planes, period, waves, level: [Noise::new(seed, 1), Noise::new(seed, 2)] }
    }

    /// Half the size of the block, and its centre: its sides lie half a unit outside the points that may be inside.
    fn block(&self) -> ([f64; 3], [f64; 3]) {
        let (width, height) = ((self.across - 2 * RIM) as f64, (self.planes - 2 * RIM) as f64 / 2.0);
        let centre = (2 * self.across - 1) as f64 / 2.0;
        ([width, width, height], [centre, centre, (self.planes - 1) as f64 / 2.0])
    }

    fn value(&self, x: usize, y: usize, z: usize) -> f64 {
        let (half, centre) = self.block();
        let [(sine_x, cosine_x), (sine_y, cosine_y), (sine_z, cosine_z)] =
            [self.waves[0][x], self.waves[1][y], self.waves[2][z]];
        let gyroid = sine_x * cosine_y + sine_y * cosine_z + sine_z * cosine_x;
        let place = [x, y, z].map(|coordinate| coordinate as f64);
        let [u, v, w] = place.map(|coordinate| coordinate / self.period);
        let level = 0.5 * self.level[0].solid(u * 0.61, v * 0.61, w * 0.61)
            + 0.2 * self.level[1].solid(u * 1.7, v * 1.7, w * 1.7);
        // As steep as the gyroid, so that the two meet without a jump.
        let slope = 8.0 / self.period;
        let beyond = [0, 1, 2].map(|axis| (place[axis] - centre[axis]).abs() - half[axis]);
        (gyroid - level).max(beyond[0].max(beyond[1]).max(beyond[2]) * slope)
    }

    fn fill_plane(&self, plane: usize, values: &mut [f64]) {
        values.fill(1.0);
        if plane < RIM || plane + RIM >= self.planes {
            return;
        }
        let shift = plane & 1;
        for row in RIM..self.across - RIM {
            for column in RIM..self.across - RIM {
                values[row * self.across + column] = self.value(2 * column + shift, 2 * row + shift, plane);
            }
        }
    }
}

/// Four planes of values, of which the first is plane `first`, and what follows from them.
struct Window<'a> {
    field: &'a Field,
    first: usize,
    values: [Vec<f64>; 4],
}

impl<'a> Window<'a> {
    fn new(field: &'a Field) -> Self {
        let plane = vec![1.0; field.across * field.across];
        let mut window = Window { field, first: 0, values: [plane.clone(), plane.clone(), plane.clone(), plane] };
        for ahead in 0..4 {
            field.fill_plane(ahead, &mut window.values[ahead]);
        }
        window
    }

    fn advance(&mut self) {
        self.first += 1;
        self.values.rotate_left(1);
        if self.first + 3 < self.field.planes {
            self.field.fill_plane(self.first + 3, &mut self.values[3]);
        } else {
            self.values[3].fill(1.0);
        }
    }

    /// Where the neighbours of the point `index` of the plane `ahead` are: planes ahead, and numbers in their plane.
    fn neighbours(&self, ahead: usize, index: usize) -> [(usize, usize); 8] {
        let across = self.field.across;
        // In even planes the four points of the next one start one column and one row before.
        let low = if (self.first + ahead) & 1 == 0 { index - across - 1 } else { index };
        [
            (ahead, index),
            (ahead, index + 1),
            (ahead, index + across),
            (ahead + 2, index),
            (ahead + 1, low),
            (ahead + 1, low + 1),
            (ahead + 1, low + across),
            (ahead + 1, low + across + 1),
        ]
    }

    /// Every point of the plane `ahead` whose cluster can hold a triangle, with which of its corners are inside.
    fn clusters(&self, ahead: usize) -> impl Iterator<Item = (usize, u8)> {
        let across = self.field.across;
        (1..across - 1).flat_map(move |row| row * across + 1..row * across + across - 1).filter_map(move |index| {
            let mut signs = 0;
            for (corner, (plane, point)) in self.neighbours(ahead, index).into_iter().enumerate() {
                signs |= u8::from(self.values[plane][point] < 0.0) << corner;
            }
            (signs != 0 && signs != 255).then_some((index, signs))
        })
    }

    /// The vertex on an edge, in units.
    fn position(&self, ahead: usize, index: usize, neighbour: usize) -> [f64; 3] {
        let (other_plane, other) = self.neighbours(ahead, index)[neighbour];
        let (from, to) = (self.values[ahead][index], self.values[other_plane][other]);
        let share = (from / (from - to)).clamp(MARGIN, 1.0 - MARGIN);
        let across = self.field.across;
        let plane = self.first + ahead;
        let [x, y, z] = [2 * (index % across) + (plane & 1), 2 * (index / across) + (plane & 1), plane];
        [(x, 0), (y, 1), (z, 2)].map(|(place, axis)| place as f64 + share * f64::from(PLACES[neighbour][axis]))
    }
}

/// Vertices and triangles as they are before any triangle is cut in three.
#[derive(Debug, Clone, Copy, Default)]
struct Count {
    vertices: u64,
    triangles: u64,
}

fn count(field: &Field, cases: &Cases, progress: &mut dyn FnMut(f64)) -> Count {
    let mut window = Window::new(field);
    let mut sum = Count::default();
    while window.first < field.planes {
        for (_, signs) in window.clusters(0) {
            sum.vertices += u64::from(crossed(signs).count_ones());
            sum.triangles += cases.triangles[usize::from(signs)].len() as u64;
        }
        window.advance();
        progress(window.first as f64 / field.planes as f64);
    }
    sum
}

/// Which of a point's edges have a vertex, by the neighbour at their end.
fn crossed(signs: u8) -> u8 {
    if signs & 1 == 1 { !signs } else { signs }
}

pub(super) struct Gyroid {
    field: Field,
    cases: Cases,
    count: Count,
    /// How many triangles are cut in three.
    cuts: u64,
}

/// What marching comes upon.
enum Found {
    Vertex([f64; 3]),
    Triangle([u64; 3]),
}

impl Gyroid {
    /// The gyroid of `triangles` triangles, if there is one.
    fn new(triangles: u64, seed: u64, progress: &mut dyn FnMut(f64)) -> Option<Self> {
        let wanted = triangles & !1;
        let cases = Cases::new();
        let mut best: Option<(Field, Count)> = None;
        let mut try_out = |size: Size, period: f64, phase: u64, progress: &mut dyn FnMut(f64)| {
            let field = Field::new(size, period, phase, seed);
            let count = count(&field, &cases, progress);
            let best_so_far = best.as_ref().map_or(0, |(_, count)| count.triangles);
            if count.triangles <= wanted && count.triangles > best_so_far {
                best = Some((field, count));
            }
            count.triangles
        };
        let lacking = if wanted < 1000 { wanted / 10 } else { wanted / 100 };
        let near_enough = |count: u64| count <= wanted && count >= wanted - lacking;

        if wanted <= FEW_TRIANGLES {
            // From the finest period on, so that there are as many holes as can be.
            'search: for step in 0..200u32 {
                let period = 2.0 * fineness(wanted) * (1.0 + 0.01 * f64::from(step / 4));
                let cube = Size::cube(wanted, period);
                let count = try_out(cube, period, u64::from(step % 4), &mut |_| {}).max(1);
                // A pillar in place of the cube, so much higher as there are triangles lacking.
                let height = (cube.height as u64 * wanted / count).clamp(1, 4 * cube.height as u64) as usize;
                for height in [height, height.max(2) - 1, height + 1] {
                    if near_enough(try_out(Size { height, ..cube }, period, u64::from(step % 4), &mut |_| {})) {
                        break 'search;
                    }
                }
            }
        } else {
            let mut period = 2.0 * fineness(wanted);
            let cube = Size::cube(wanted, period);
            let target = wanted as f64 * 0.995;
            let lids = lids(cube.width);
            period *= walls(cube.width, period) / (target - lids);
            let mut share = 1.0;
            for pass in 0..PASSES {
                // No one knows how many passes there will be: each is worth half of what is left.
                share /= 2.0;
                // Where the period is in step with the lattice, the number of triangles jumps: another beginning
                // helps.
                let phase = pass / 3;
                let count = try_out(cube, period, phase, &mut |done| progress(1.0 - 2.0 * share + share * done));
                if near_enough(count) {
                    break;
                }
                // The walls shrink as the period grows, the lids do not.
                period *= (count as f64 - lids) / (target - lids);
            }
        }
        let (field, count) = best?;
        let cuts = (wanted - count.triangles) / 2;
        (cuts <= count.triangles).then_some(Gyroid { field, cases, count, cuts })
    }

    /// Walks over the whole surface. Vertices are numbered in the order in which they are found.
    fn march(&self, mut found: impl FnMut(Found) -> Result<(), MeshError>) -> Result<(), MeshError> {
        let mut window = Window::new(&self.field);
        let points = self.field.across * self.field.across;
        let mut next = 0;
        let [mut lower, mut upper] = [(); 2].map(|()| Numbers { first: vec![0; points], crossed: vec![0; points] });
        upper.assign(&window, 0, &mut next, &mut found)?;
        let mut cut_share = 0;
        while window.first < self.field.planes {
            std::mem::swap(&mut lower, &mut upper);
            upper.assign(&window, 1, &mut next, &mut found)?;
            for (index, signs) in window.clusters(0) {
                let corners = window.neighbours(0, index);
                for edges in &self.cases.triangles[usize::from(signs)] {
                    let triangle = edges.map(|edge| match corners[edge.corner] {
                        (0, point) => lower.number(point, edge.neighbour),
                        (_, point) => upper.number(point, edge.neighbour),
                    });
                    // Cut every so-and-so-many-th triangle: whenever the shares of all before it have made one.
                    cut_share += self.cuts;
                    if cut_share < self.count.triangles {
                        found(Found::Triangle(triangle))?;
                        continue;
                    }
                    cut_share -= self.count.triangles;
                    let [a, b, c] = edges.map(|edge| {
                        let (ahead, point) = corners[edge.corner];
                        window.position(ahead, point, edge.neighbour)
                    });
                    found(Found::Vertex([0, 1, 2].map(|axis| (a[axis] + b[axis] + c[axis]) / 3.0)))?;
                    let [a, b, c] = triangle;
                    for part in [[a, b, next], [b, c, next], [c, a, next]] {
                        found(Found::Triangle(part))?;
                    }
                    next += 1;
                }
            }
            window.advance();
        }
        Ok(())
    }
}

/// The numbers of the vertices on the edges that belong to the points of one plane.
struct Numbers {
    /// The number of a point's first vertex.
    first: Vec<u64>,
    /// Which of a point's edges have a vertex, by the neighbour at their end.
    crossed: Vec<u8>,
}

impl Numbers {
    /// Numbers all vertices of the plane `ahead`, from `next` on.
    fn assign(
        &mut self,
        window: &Window<'_>,
        ahead: usize,
        next: &mut u64,
        found: &mut impl FnMut(Found) -> Result<(), MeshError>,
    ) -> Result<(), MeshError> {
        for (index, signs) in window.clusters(ahead) {
            self.first[index] = *next;
            self.crossed[index] = crossed(signs);
            for neighbour in (1..8).filter(|neighbour| crossed(signs) >> neighbour & 1 == 1) {
                found(Found::Vertex(window.position(ahead, index, neighbour)))?;
                *next += 1;
            }
        }
        Ok(())
    }

    fn number(&self, index: usize, neighbour: usize) -> u64 {
        let before = self.crossed[index] & ((1 << neighbour) - 1);
        self.first[index] + u64::from(before.count_ones())
    }
}

impl Model for Gyroid {
    fn vertex_count(&self) -> u64 {
        self.count.vertices + self.cuts
    }

    fn triangle_count(&self) -> u64 {
        self.count.triangles + 2 * self.cuts
    }

    fn emit_vertices(&self, emit: &mut VertexSink<'_>) -> Result<(), MeshError> {
        let (half, centre) = self.field.block();
        self.march(|found| match found {
            Found::Vertex(place) => emit([0, 1, 2].map(|axis| (place[axis] - centre[axis]) * (WIDTH / 2.0 / half[0]))),
            Found::Triangle(_) => Ok(()),
        })
    }

    fn emit_triangles(&self, emit: &mut TriangleSink<'_>) -> Result<(), MeshError> {
        self.march(|found| match found {
            Found::Vertex(_) => Ok(()),
            Found::Triangle(corners) => emit(corners),
        })
    }
}

/// About how many triangles lie on the sides of a cube `width` pairs of units wide.
fn lids(width: usize) -> f64 {
    38.0 * (width * width) as f64
}

/// About how many triangles lie inside of it.
fn walls(width: usize, period: f64) -> f64 {
    2.0 * 39.8 * (width * width * width) as f64 / period
}

/// How many pairs of units a period has in a mesh of so many triangles: from as few as keep the tunnels open, slowly
/// up.
fn fineness(triangles: u64) -> f64 {
    3.6 + 0.75 * f64::from(triangles.ilog2().saturating_sub(10))
}

/// The gyroid of `triangles` triangles, or the sphere where there are too few for a gyroid.
pub(super) fn model(triangles: u64, seed: u64, progress: &mut dyn FnMut(f64)) -> Box<dyn Model> {
    match Gyroid::new(triangles, seed, progress) {
        Some(gyroid) => Box::new(gyroid),
        None => Box::new(Sphere::new(triangles, seed)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_search_leaves_few_triangles_to_be_cut() {
        for triangles in [24, 37, 77, 150, 500, 999, 1000, 1500, 3001, 9000, 30_000, 50_000, 50_002, 77_777, 150_000] {
            for seed in 0..3 {
                let gyroid = Gyroid::new(triangles, seed, &mut |_| {}).unwrap();
                let share = gyroid.count.triangles as f64 / triangles as f64;
                let least = if triangles < 1000 { 1.0 / 3.0 } else { 0.989 };
                assert!(share >= least && share <= 1.0, "{triangles}, seed {seed}: {share}");
            }
        }
    }

    #[test]
    fn every_edge_of_a_tetrahedron_is_an_edge_of_the_lattice() {
        for tetrahedron in TETRAHEDRA {
            for (a, b) in
                [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)].map(|(a, b)| (tetrahedron[a], tetrahedron[b]))
            {
                let edge = cluster_edge(a, b);
                let end = [0, 1, 2].map(|axis| PLACES[edge.corner][axis] + PLACES[edge.neighbour][axis]);
                let other = if edge.corner == a { b } else { a };
                assert_eq!(end, PLACES[other], "from {a} to {b}");
                // Its vertex is numbered with the two planes that are at hand.
                assert!((0..=1).contains(&PLACES[edge.corner][2]), "from {a} to {b}");
            }
        }
    }
}
