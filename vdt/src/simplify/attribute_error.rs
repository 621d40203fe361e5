//! How much a collapse changes what is on the surface: its *attribute error*, a length.
//!
//! The vertex that goes is projected on the triangles that are left of its star, on each side of a seam by itself (the triangles
//! that have the same wedge there), and what these show at the nearest point is compared with what the wedge shows:
//! - *colour*: the largest difference of a channel, as a part of all there is, times the length of the edge: a wrong colour
//!   is as bad as a wrong place, on as much of the surface as the collapse moves;
//! - *texture*: how far the texture slides: the difference of the coordinates, times the length on the surface that a unit of the
//!   texture has around the vertex. That is the longest of the vertex's edges there, over the longest in the texture. What is
//!   wrong is so on the side's triangles only: as a length, it is no more than the root of their area;
//! - *area*: where a seam of the texture moves, what lies between the old one and the new shows another part of the texture
//!   than before; where all of a side vanishes, all that it had does. That counts as the root of the area
//!   ([`SWAPPED_WEIGHT`], [`TEXTURE_WEIGHT`]).
//!
//! What rounding to whole steps can amount to, one of them, is no difference: a linear gradient costs nothing. Normals follow
//! the geometry and do not count, materials do not mix.
//!
//! What it reads are the star of the vertex that goes, positions, and wedges. Where triangles are equally near, the smaller
//! difference counts; so the order of the star does not matter.

use crate::tree::Wedge;

use super::live_mesh::LiveMesh;

/// No error is larger, normalised: the mesh is at most 1 wide along each axis.
const LARGEST: f32 = 2.0;

/// What counts for the area between an old seam and a new one, against that of a side. (See [`TEXTURE_WEIGHT`].)
const SWAPPED_WEIGHT: f32 = 2.0;

/// Weight of errors of the texture, as lengths, against those of the geometry.
///
/// Measured: the mean colour error at 50 and 10 % of the triangles, in per cent, and there the distance, root mean square in
/// 1e-4 of the diagonal, of bunny10k_textured.obj, which has 190 charts. As it was without areas 0.77, 2.5; 7.9, 38. With
/// areas, weights (texture, swapped) of (1, 1): 0.30, 2.3; 8.7, 43. (1.5, 1): 0.23, 2.2; 9.8, 45. (1.5, 2): 0.19, 1.95; 10.8,
/// 42. (1.5, 3): 0.17, 1.93; 11, 47. (2, 3): 0.14, 1.93; 11, 58. (3, 3): 0.14, 1.82; 13, 62. The noise is 0.1. To refuse
/// collapses that turn triangles over in the texture, or to sum errors up over collapses, made no difference beyond that.
/// Twice as much for colours, on terrain (jacksboro_dem_color.ply): 1.12 instead of 1.19 %, with a certified error 9 % larger.
const TEXTURE_WEIGHT: f32 = 1.5;

/// A sum of areas of triangles, in whole steps: the same in any order. Triangles smaller than a step, 2^-44 of the square
/// around the mesh, do not count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Area(u64);

impl Area {
    const STEPS: f32 = (1_u64 << 44) as f32;

    /// Adds a triangle.
    fn add(&mut self, a: [f32; 3], b: [f32; 3], c: [f32; 3]) {
        let (u, v) = (minus(b, a), minus(c, a));
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        self.0 = self.0.saturating_add((dot(normal, normal).sqrt() / 2.0 * Area::STEPS) as u64);
    }

    /// The side of a square of that area.
    fn root(self) -> f32 {
        (self.0 as f32 / Area::STEPS).sqrt()
    }
}

/// One side of a seam.
#[derive(Debug, Clone, Copy)]
struct Side {
    /// The place of its wedge.
    place: u32,
    /// The squared distance of the nearest triangle.
    square: f32,
    /// The largest difference of a colour channel there, 0 to 1.
    colour: f32,
    /// The difference in the texture there, in its steps.
    texture: f32,
    /// The longest edges of the vertex, squared: normalised, and in the texture.
    longest: [f32; 2],
    /// The area of its triangles that are left, as they become.
    left: Area,
    /// The area of its triangles that vanish.
    vanishing: Area,
    /// The area between its seams as they were and as they become.
    swapped: Area,
}

impl Side {
    /// Nothing of the side with the wedge at this place.
    fn new(place: u32) -> Self {
        let square = f32::INFINITY;
        Side {
            place,
            square,
            colour: 0.0,
            texture: 0.0,
            longest: [0.0; 2],
            left: Area(0),
            vanishing: Area(0),
            swapped: Area(0),
        }
    }

    /// What changes in the texture there, as a length.
    fn texture_error(&self) -> f32 {
        if self.square == f32::INFINITY {
            return TEXTURE_WEIGHT * self.vanishing.root();
        }
        let [on_surface, in_texture] = self.longest;
        let scale = if in_texture > 0.0 { (on_surface / in_texture).sqrt() } else { 0.0 };
        // Another material is wrong wherever in the texture it is.
        let slide = if self.texture < f32::INFINITY { self.texture * scale } else { f32::INFINITY };
        TEXTURE_WEIGHT * slide.max(SWAPPED_WEIGHT.sqrt() * self.swapped.root()).min(self.left.root())
    }
}

/// Works out attribute errors; kept from one to the next for its memory.
#[derive(Debug, Default)]
pub(super) struct AttributeError {
    sides: Vec<Side>,
    /// The edges of the triangles at the vertex that goes, if that has several wedges: the other end, and the place of the
    /// triangle's wedge.
    spokes: Vec<(u32, u32)>,
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// A part of a whole, which may be nothing.
fn part(part: f32, whole: f32) -> f32 {
    if whole > 0.0 { (part / whole).min(1.0) } else { 0.0 }
}

/// The barycentric coordinates of the point of a triangle that is nearest to 0. (Ericson, "Real-time collision detection",
/// 2005, 5.1.5.)
fn nearest_to_origin([a, b, c]: [[f32; 3]; 3]) -> [f32; 3] {
    let (ab, ac) = (minus(b, a), minus(c, a));
    let (d1, d2) = (-dot(ab, a), -dot(ac, a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let (d3, d4) = (-dot(ab, b), -dot(ac, b));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let of_c = d1 * d4 - d3 * d2;
    if of_c <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let at_b = part(d1, d1 - d3);
        return [1.0 - at_b, at_b, 0.0];
    }
    let (d5, d6) = (-dot(ab, c), -dot(ac, c));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let of_b = d5 * d2 - d1 * d6;
    if of_b <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let at_c = part(d2, d2 - d6);
        return [1.0 - at_c, 0.0, at_c];
    }
    let of_a = d3 * d6 - d5 * d4;
    if of_a <= 0.0 && d4 >= d3 && d5 >= d6 {
        let at_c = part(d4 - d3, (d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - at_c, at_c];
    }
    let area = of_a + of_b + of_c;
    let (at_b, at_c) = (part(of_b, area), part(of_c, area));
    [1.0 - at_b - at_c, at_b, at_c]
}

/// The difference of two places in the texture, in its steps.
fn slide(from: &Wedge, to: &Wedge) -> [f32; 2] {
    [0, 1].map(|axis| (i64::from(to.texture[axis]) - i64::from(from.texture[axis])) as f32)
}

/// The largest difference of a channel between a wedge and what a triangle shows between its corners, 0 to 1.
fn colour_difference(wedge: &Wedge, corners: [&Wedge; 3], weights: [f32; 3]) -> f32 {
    let of_channel = |channel: usize| {
        let own = f32::from(wedge.colour[channel]);
        let [a, b, c] = corners.map(|corner| f32::from(corner.colour[channel]) - own);
        (a * weights[0] + b * weights[1] + c * weights[2]).abs()
    };
    let largest = (0..4).map(of_channel).fold(0.0, f32::max);
    (largest - 1.0).max(0.0) / f32::from(u8::MAX)
}

/// How far what a triangle shows between its corners lies from a wedge in the texture, in its steps; infinitely far in
/// that of another material.
fn texture_difference(wedge: &Wedge, corners: [&Wedge; 3], weights: [f32; 3]) -> f32 {
    if corners.iter().any(|corner| corner.material != wedge.material) {
        return f32::INFINITY;
    }
    let [a, b, c] = corners.map(|corner| slide(wedge, corner));
    let [x, y] = [0, 1].map(|axis| a[axis] * weights[0] + b[axis] * weights[1] + c[axis] * weights[2]);
    ((x * x + y * y).sqrt() - 1.0).max(0.0)
}

impl AttributeError {
    /// That of the collapse of `gone` onto `stays`, where the wedges of the one have these images at the other: normalised.
    pub fn measure(&mut self, mesh: &LiveMesh, gone: u32, stays: u32, images: &[u32]) -> f32 {
        let heeded = mesh.wedges.heeded();
        self.sides.clear();
        let position = |vertex: u32| mesh.vertices[vertex as usize].position;
        let origin = position(gone);
        for triangle in mesh.star(gone) {
            let triangle = *triangle as usize;
            let corners = mesh.triangles[triangle].corners;
            let Some(first) = corners.iter().position(|corner| *corner == gone) else { continue };
            let [next, previous] = [corners[(first + 1) % 3], corners[(first + 2) % 3]];
            let [own, at_next, at_previous] = mesh.wedges.corners(triangle).turned(first).places();
            let wedge = mesh.wedges.wedge(gone, own);
            let [of_next, of_previous] =
                [(next, at_next), (previous, at_previous)].map(|(vertex, place)| mesh.wedges.wedge(vertex, place));
            let [to_next, to_previous] = [next, previous].map(|vertex| minus(position(vertex), origin));
            let side = self.side(own);
            if heeded.textures {
                for (edge, other) in [(to_next, of_next), (to_previous, of_previous)] {
                    let [x, y] = slide(wedge, other);
                    side.longest = [side.longest[0].max(dot(edge, edge)), side.longest[1].max(x * x + y * y)];
                }
            }
            if next == stays || previous == stays {
                if heeded.textures {
                    side.vanishing.add([0.0; 3], to_next, to_previous);
                }
                continue;
            }
            let shape = [minus(position(stays), origin), to_next, to_previous];
            if heeded.textures {
                side.left.add(shape[0], to_next, to_previous);
            }
            let weights = nearest_to_origin(shape);
            let point: [f32; 3] = std::array::from_fn(|axis| {
                shape[0][axis] * weights[0] + shape[1][axis] * weights[1] + shape[2][axis] * weights[2]
            });
            let square = dot(point, point);
            if square > side.square {
                continue;
            }
            let shown = [mesh.wedges.wedge(stays, images[own as usize]), of_next, of_previous];
            let colour = if heeded.colours { colour_difference(wedge, shown, weights) } else { 0.0 };
            let texture = if heeded.textures { texture_difference(wedge, shown, weights) } else { 0.0 };
            if square < side.square {
                (side.square, side.colour, side.texture) = (square, colour, texture);
            } else {
                (side.colour, side.texture) = (side.colour.min(colour), side.texture.min(texture));
            }
        }
        if heeded.textures && mesh.wedges.of(gone).len() > 1 {
            self.measure_swapped(mesh, gone, stays);
        }
        let d = minus(position(stays), origin);
        let length = dot(d, d).sqrt();
        let of_side = |side: &Side| {
            let texture = if heeded.textures { side.texture_error() } else { 0.0 };
            (side.colour * length).max(texture)
        };
        self.sides.iter().map(of_side).fold(0.0, f32::max).min(LARGEST)
    }

    /// Measures for each side what lies between its seams at `gone` and those from their other ends to `stays`.
    fn measure_swapped(&mut self, mesh: &LiveMesh, gone: u32, stays: u32) {
        self.spokes.clear();
        for triangle in mesh.star(gone) {
            let triangle = *triangle as usize;
            let places = mesh.wedges.corners(triangle).places();
            let corners = mesh.triangles[triangle].corners;
            let own = corners.into_iter().zip(places).find(|(corner, _)| *corner == gone).map_or(0, |(_, place)| place);
            let others = corners.into_iter().filter(|corner| *corner != gone && *corner != stays);
            self.spokes.extend(others.map(|other| (other, own)));
        }
        self.spokes.sort_unstable();
        let wedges = mesh.wedges.of(gone);
        let position = |vertex: u32| mesh.vertices[vertex as usize].position;
        let origin = position(gone);
        let to_stays = minus(position(stays), origin);
        for spokes in self.spokes.chunk_by(|a, b| a.0 == b.0) {
            let surface = |place: u32| &wedges[place as usize];
            let is_seam = spokes.iter().any(|(_, place)| !surface(*place).is_same_surface(surface(spokes[0].1)));
            if is_seam {
                let to_other = minus(position(spokes[0].0), origin);
                for (_, place) in spokes {
                    if let Some(side) = self.sides.iter_mut().find(|side| side.place == *place) {
                        side.swapped.add([0.0; 3], to_stays, to_other);
                    }
                }
            }
        }
    }

    /// The side of a wedge.
    fn side(&mut self, place: u32) -> &mut Side {
        let number = self.sides.iter().position(|side| side.place == place).unwrap_or_else(|| {
            self.sides.push(Side::new(place));
            self.sides.len() - 1
        });
        &mut self.sides[number]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn any_point() -> impl Strategy<Value = [f32; 3]> {
        prop_oneof![
            prop::array::uniform3(-2.0_f32..2.0),
            prop::array::uniform3(-2_i32..3).prop_map(|point| point.map(|value| value as f32)),
        ]
    }

    proptest! {
        #[test]
        fn no_point_of_the_triangle_is_nearer(corners in prop::array::uniform3(any_point())) {
            let square = |weights: [f32; 3]| {
                let at = |axis: usize| (0..3).map(|corner| corners[corner][axis] * weights[corner]).sum::<f32>();
                (0..3).map(|axis| at(axis) * at(axis)).sum::<f32>()
            };
            let found = nearest_to_origin(corners);
            prop_assert!((found.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{:?}", found);
            prop_assert!(found.iter().all(|weight| *weight >= -1e-5), "{:?}", found);
            let spread = |a: usize, b: usize| dot(minus(corners[a], corners[b]), minus(corners[a], corners[b]));
            let normal = (spread(0, 1) * spread(0, 2) - dot(minus(corners[1], corners[0]), minus(corners[2], corners[0])).powi(2)).max(0.0);
            // Of a needle, no more than a point of it is asked for.
            prop_assume!(normal > 1e-2);
            for step in 0..=400_u32 {
                let (i, j) = (step % 21, step / 21);
                if i + j <= 20 {
                    let weights = [(20 - i - j) as f32 / 20.0, i as f32 / 20.0, j as f32 / 20.0];
                    prop_assert!(square(found) <= square(weights) + 1e-3);
                }
            }
        }
    }
}
