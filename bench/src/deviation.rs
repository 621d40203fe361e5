//! How far two surfaces are apart, in both directions, as Metro measures it (Cignoni, Rocchini, Scopigno 1998).
//!
//! From each surface to the other, distances are taken at points spread evenly over the area and at all vertices. The
//! root mean square is that over the spread points; the symmetric one is the root of the mean of both mean squares. The
//! Hausdorff distance is the largest of all, at least at the points looked at. All of it is done with two seeds, which
//! say how much of a figure is chance.

use anyhow::Result;
use parry3d_f64::math::Vector;
use serde_json::{Value, json};

use crate::surface::{Mesh, Surface};

/// The two choices of points.
const SEEDS: [u64; 2] = [1, 2];

/// What was measured from one surface to another, in mesh units.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct OneSided {
    /// Root mean square distance, for each seed.
    pub rms: [f64; 2],
    /// Largest distance, for each seed.
    pub largest: [f64; 2],
}

/// How far two surfaces are apart, in mesh units.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Deviation {
    /// From the original to the approximation.
    pub forward: OneSided,
    /// From the approximation to the original.
    pub backward: OneSided,
}

/// A figure that was measured twice.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Figure {
    /// The figure.
    pub value: f64,
    /// Difference of the two measurements, as a part of the figure.
    pub noise: f64,
}

impl Figure {
    fn of(values: [f64; 2], value: f64) -> Self {
        let noise = if value > 0.0 { (values[0] - values[1]).abs() / value } else { 0.0 };
        Figure { value, noise }
    }
}

impl Deviation {
    /// Symmetric root mean square distance.
    pub fn rms(&self) -> Figure {
        let both = [0, 1].map(|seed| mean_square([self.forward.rms[seed], self.backward.rms[seed]]));
        Figure::of(both, mean_square(both))
    }

    /// Hausdorff distance.
    pub fn hausdorff(&self) -> Figure {
        let both = [0, 1].map(|seed| self.forward.largest[seed].max(self.backward.largest[seed]));
        Figure::of(both, both[0].max(both[1]))
    }

    /// As JSON, as parts of `diagonal`.
    pub fn to_json(&self, diagonal: f64) -> Value {
        let one_sided = |side: &OneSided| {
            json!({
                "rms_of_diagonal": side.rms.map(|value| value / diagonal),
                "largest_of_diagonal": side.largest.map(|value| value / diagonal),
            })
        };
        let (rms, hausdorff) = (self.rms(), self.hausdorff());
        json!({
            "rms_of_diagonal": rms.value / diagonal,
            "rms_noise": rms.noise,
            "hausdorff_of_diagonal": hausdorff.value / diagonal,
            "hausdorff_noise": hausdorff.noise,
            "forward": one_sided(&self.forward),
            "backward": one_sided(&self.backward),
        })
    }
}

/// The root of the mean of two squares.
fn mean_square(values: [f64; 2]) -> f64 {
    ((values[0] * values[0] + values[1] * values[1]) / 2.0).sqrt()
}

/// A mesh with what measuring from it and to it takes.
#[derive(Debug)]
pub struct Original {
    surface: Surface,
    vertices: Vec<Vector>,
    samples: [Vec<Vector>; 2],
}

impl Original {
    /// Prepares a mesh, with so many points in each direction besides the vertices.
    pub fn new(mesh: &Mesh, samples: usize) -> Result<Self> {
        let [first, second] = SEEDS.map(|seed| mesh.sample(samples, seed));
        Ok(Original { surface: Surface::new(mesh)?, vertices: mesh.used_positions(), samples: [first?, second?] })
    }

    /// How far an approximation is off.
    pub fn deviation(&self, approximation: &Mesh) -> Result<Deviation> {
        let count = self.samples[0].len();
        let surface = Surface::new(approximation)?;
        let [first, second] = SEEDS.map(|seed| approximation.sample(count, seed));
        let samples = [first?, second?];
        Ok(Deviation {
            forward: one_sided(&surface, &self.vertices, &self.samples),
            backward: one_sided(&self.surface, &approximation.used_positions(), &samples),
        })
    }
}

fn one_sided(to: &Surface, vertices: &[Vector], samples: &[Vec<Vector>; 2]) -> OneSided {
    let largest = |distances: &[f64]| distances.iter().copied().fold(0.0, f64::max);
    let at_vertices = largest(&to.distances(vertices));
    let mut side = OneSided::default();
    for (seed, samples) in samples.iter().enumerate() {
        let distances = to.distances(samples);
        let squares: f64 = distances.iter().map(|distance| distance * distance).sum();
        side.rms[seed] = (squares / distances.len().max(1) as f64).sqrt();
        side.largest[seed] = largest(&distances).max(at_vertices);
    }
    side
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of side 1 in the plane z = `z`, with a flap of the same size beside it where `flap` says how high its
    /// far side stands.
    fn square(z: f32, flap: Option<f32>) -> Mesh {
        let mut mesh = Mesh {
            positions: vec![[0.0, 0.0, z], [1.0, 0.0, z], [1.0, 1.0, z], [0.0, 1.0, z]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        if let Some(height) = flap {
            mesh.positions.extend([[1.0, 0.0, z + height], [1.0, 1.0, z + height]]);
            mesh.triangles.extend([[1, 4, 5], [1, 5, 2]]);
        }
        mesh
    }

    #[test]
    fn a_shifted_square_is_off_by_its_shift() {
        let off = Original::new(&square(0.0, None), 1000).unwrap().deviation(&square(0.5, None)).unwrap();
        assert!((off.rms().value - 0.5).abs() < 1e-12 && (off.hausdorff().value - 0.5).abs() < 1e-12);
        assert!(off.rms().noise < 1e-12 && off.hausdorff().noise < 1e-12);
    }

    #[test]
    fn what_one_surface_lacks_shows_in_one_direction_only() {
        // An upright flap of height 2 over the side of the square, and the square without it.
        let (with, without) = (square(0.0, Some(2.0)), square(0.0, None));
        let off = Original::new(&with, 20_000).unwrap().deviation(&without).unwrap();
        let is_zero = |side: OneSided| side.rms.iter().chain(&side.largest).all(|value| *value < 1e-12);
        assert!(is_zero(off.backward), "{off:?}");
        assert_eq!(off.forward.largest, [2.0; 2]);
        // Two thirds of the area are flap, where the mean square is 4/3. With so many points, the standard deviation of
        // the root mean square is 0.0036.
        let expected = (2.0_f64 / 3.0 * 4.0 / 3.0).sqrt();
        assert!(off.forward.rms.iter().all(|rms| (rms - expected).abs() < 0.01), "{off:?}");
        let symmetric = expected / 2.0_f64.sqrt();
        assert!((off.rms().value - symmetric).abs() < 0.01 && off.rms().noise < 0.01 && off.rms().noise > 0.0);
        let back = Original::new(&without, 20_000).unwrap().deviation(&with).unwrap();
        assert!(is_zero(back.forward) && back.backward.largest == [2.0; 2], "{back:?}");
    }
}
