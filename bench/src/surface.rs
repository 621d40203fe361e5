//! An indexed mesh, points spread over it, and the distance to it.
//!
//! The nearest point of a surface is found exactly (up to rounding in double precision), through the bounding-volume
//! hierarchy of parry3d. Triangles without area are no part of the surface that is measured to: their neighbours cover
//! what they do.

use std::num::NonZero;

use anyhow::{Context, Result, ensure};
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::TriMesh;

/// Triangles over positions.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Positions of the vertices. Those that no triangle uses do not count.
    pub positions: Vec<[f32; 3]>,
    /// Corners of the triangles.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The corners of a triangle as points.
    fn corners(&self, triangle: [u32; 3]) -> [Vector; 3] {
        triangle.map(|corner| point(self.positions[corner as usize]))
    }

    /// Length of the diagonal of the bounding box, in mesh units.
    pub fn diagonal(&self) -> f64 {
        let used = self.used_positions();
        let low = used.iter().copied().fold(Vector::INFINITY, Vector::min);
        let high = used.iter().copied().fold(Vector::NEG_INFINITY, Vector::max);
        if used.is_empty() { 0.0 } else { (high - low).length() }
    }

    /// The positions that a triangle uses, each vertex once.
    pub fn used_positions(&self) -> Vec<Vector> {
        let mut is_used = vec![false; self.positions.len()];
        self.triangles.as_flattened().iter().for_each(|corner| is_used[*corner as usize] = true);
        self.positions.iter().zip(is_used).filter(|(_, used)| *used).map(|(position, _)| point(*position)).collect()
    }

    /// `count` points spread evenly over the area: one in each of `count` slices of equal area, at random within it.
    /// The same `seed` gives the same points.
    ///
    /// # Errors
    ///
    /// Where the mesh has no area.
    pub fn sample(&self, count: usize, seed: u64) -> Result<Vec<Vector>> {
        let mut ends = Vec::with_capacity(self.triangles.len());
        let mut total = 0.0;
        for triangle in &self.triangles {
            let [a, b, c] = self.corners(*triangle);
            total += (b - a).cross(c - a).length();
            ends.push(total);
        }
        ensure!(total > 0.0, "the surface has no area");
        let mut random = fastrand::Rng::with_seed(seed);
        let mut triangle = 0;
        let points = (0..count).map(|slice| {
            let place = (slice as f64 + random.f64()) / count as f64 * total;
            while triangle + 1 < ends.len() && ends[triangle] <= place {
                triangle += 1;
            }
            let [a, b, c] = self.corners(self.triangles[triangle]);
            let (mut u, mut v) = (random.f64(), random.f64());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            a + (b - a) * u + (c - a) * v
        });
        Ok(points.collect())
    }
}

fn point(position: [f32; 3]) -> Vector {
    Vector::from_array(position.map(f64::from))
}

/// A surface to which distances are measured.
#[derive(Debug)]
pub struct Surface {
    tree: TriMesh,
}

impl Surface {
    /// That of a mesh.
    ///
    /// # Errors
    ///
    /// Where no triangle has an area.
    pub fn new(mesh: &Mesh) -> Result<Self> {
        let has_area = |triangle: &&[u32; 3]| {
            let [a, b, c] = mesh.corners(**triangle);
            (b - a).cross(c - a).length() > 0.0
        };
        let triangles: Vec<[u32; 3]> = mesh.triangles.iter().filter(has_area).copied().collect();
        let vertices = mesh.positions.iter().map(|position| point(*position)).collect();
        let tree = TriMesh::new(vertices, triangles).context("the surface has no triangle with an area")?;
        Ok(Surface { tree })
    }

    /// Distance of a point from the nearest one of the surface.
    pub fn distance(&self, from: Vector) -> f64 {
        (self.tree.project_local_point(from, false).point - from).length()
    }

    /// Distances of points, by all threads of the machine.
    pub fn distances(&self, points: &[Vector]) -> Vec<f64> {
        let threads = std::thread::available_parallelism().map_or(1, NonZero::get);
        let mut distances = vec![0.0; points.len()];
        let share = points.len().div_ceil(threads).max(1);
        std::thread::scope(|scope| {
            for (points, distances) in points.chunks(share).zip(distances.chunks_mut(share)) {
                scope.spawn(|| {
                    for (point, distance) in points.iter().zip(distances) {
                        *distance = self.distance(*point);
                    }
                });
            }
        });
        distances
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wavy sheet of 2 n² triangles, with one triangle without area.
    fn sheet(n: u32) -> Mesh {
        let mut mesh = Mesh::default();
        for index in 0..(n + 1) * (n + 1) {
            let [x, y] = [index % (n + 1), index / (n + 1)].map(|step| step as f32 / n as f32);
            mesh.positions.push([x, y, 0.2 * (5.0 * x).sin() * (3.0 * y).cos()]);
        }
        for (row, column) in (0..n).flat_map(|row| (0..n).map(move |column| (row, column))) {
            let [a, b] = [row, row + 1].map(|row| row * (n + 1) + column);
            mesh.triangles.extend([[a, a + 1, b + 1], [a, b + 1, b]]);
        }
        mesh.triangles.push([0, 1, 1]);
        mesh
    }

    /// Distance to a triangle by looking at its inside, its three sides and its three corners.
    fn plain_distance(p: Vector, [a, b, c]: [Vector; 3]) -> f64 {
        let side = |a: Vector, b: Vector| {
            let along = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            (a + (b - a) * along - p).length()
        };
        let normal = (b - a).cross(c - a);
        let foot = p - normal * ((p - a).dot(normal) / normal.length_squared());
        let is_left = |a: Vector, b: Vector| (b - a).cross(foot - a).dot(normal) >= 0.0;
        let inside = if is_left(a, b) && is_left(b, c) && is_left(c, a) { (foot - p).length() } else { f64::INFINITY };
        inside.min(side(a, b)).min(side(b, c)).min(side(c, a))
    }

    #[test]
    fn distances_are_those_to_the_nearest_of_all_triangles() {
        let mesh = sheet(9);
        let surface = Surface::new(&mesh).unwrap();
        let mut random = fastrand::Rng::with_seed(7);
        let points: Vec<Vector> =
            (0..500).map(|_| Vector::new(random.f64(), random.f64(), random.f64()) * 2.0 - 0.5).collect();
        for (point, distance) in points.iter().zip(surface.distances(&points)) {
            let triangles = mesh.triangles[..mesh.triangles.len() - 1].iter();
            let expected =
                triangles.map(|triangle| plain_distance(*point, mesh.corners(*triangle))).fold(f64::INFINITY, f64::min);
            assert!((distance - expected).abs() < 1e-12, "{point}: {distance} {expected}");
        }
    }

    #[test]
    fn samples_lie_on_the_surface_and_are_spread_by_area() {
        let mesh = sheet(9);
        let surface = Surface::new(&mesh).unwrap();
        let samples = mesh.sample(4000, 1).unwrap();
        assert!(samples.iter().all(|sample| surface.distance(*sample) < 1e-12));
        assert_eq!(samples, mesh.sample(4000, 1).unwrap());
        assert_ne!(samples, mesh.sample(4000, 2).unwrap());
        // A unit square and one of three times the area.
        let mut squares = Mesh::default();
        squares.positions.extend([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
        squares.positions.extend([[5.0, 0.0, 0.0], [8.0, 0.0, 0.0], [8.0, 1.0, 0.0], [5.0, 1.0, 0.0]]);
        squares.triangles.extend([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]);
        let right = squares.sample(4000, 3).unwrap().iter().filter(|sample| sample.x > 3.0).count();
        assert!((2998..=3002).contains(&right), "{right}");
        assert!((squares.diagonal() - 65.0_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_surface_without_area_is_refused() {
        let mesh = Mesh { positions: vec![[0.0; 3], [1.0; 3]], triangles: vec![[0, 1, 1]] };
        assert!(Surface::new(&mesh).is_err() && mesh.sample(1, 0).is_err());
        assert!(Mesh::default().sample(1, 0).is_err());
        assert_eq!(Mesh::default().diagonal(), 0.0);
    }
}
