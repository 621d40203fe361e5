//! The triangles of a front, drawn by the processor (Pineda, "A parallel algorithm for polygon rasterization", 1988).
//!
//! A point of the picture belongs to the triangle that its middle is in. Corners are rounded to 1/256 of a point, and from there
//! on everything is whole numbers; a middle that lies on the side between two triangles belongs to the one below or to the right
//! of it. So each point of a closed surface is drawn, and by one triangle only. What reaches nearer than the least depth, or far
//! out of the picture, is cut off there before; both triangles at a side cut it at the same place.
//!
//! Both sides of the surface are drawn, as if each was the outer one. The light comes over the viewer's left shoulder; the
//! normal at a point is between those of the corners.
//!
//! Memory: none beside the picture. Time: once through the triangles, and through the points around each. (A vertex is brought to
//! the picture once for each triangle there: to keep them would take RAM in proportion to the front.)

use glam::DVec3;
use metanode::page::Normal;

use crate::picture::Picture;
use crate::projection::{Place, Projection};

/// Steps in a point.
const STEPS: i64 = 256;
/// What is so many half pictures beside the middle is cut off. (So all products stay within 64 bits.)
const MARGIN: f64 = 16.0;
/// The part of the light that comes from everywhere.
const AMBIENT: f64 = 0.12;
/// The part of it that the surface throws back: red, green and blue.
const SURFACE: [f64; 3] = [0.76, 0.74, 0.70];
/// The same for a point on the side of a triangle, where those are drawn.
const SIDE: [f64; 3] = [0.02, 0.05, 0.12];
/// How far from a side a point belongs to it, in points.
const SIDE_WIDTH: f64 = 0.6;

/// What is drawn: the streams of a navigator.
#[derive(Debug, Clone, Copy)]
pub struct Buffers<'a> {
    /// Positions, and normals, see [`Navigator::vertex_stream`](navigator::Navigator::vertex_stream).
    pub vertices: &'a [[f32; 4]],
    /// Origins and weights, see [`Navigator::morph_stream`](navigator::Navigator::morph_stream); may be empty.
    pub morphs: &'a [[f32; 4]],
    /// Corners, see [`Navigator::triangle_stream`](navigator::Navigator::triangle_stream).
    pub triangles: &'a [[u32; 3]],
}

/// How it is drawn.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Style {
    /// Whether the sides of the triangles are seen.
    pub edges: bool,
    /// Whether each triangle has the colour of its level of detail.
    pub levels: bool,
    /// Whether the boxes of the meta-nodes in use are seen.
    pub boxes: bool,
}

/// A vertex as the eye sees it, with its normal.
#[derive(Debug, Clone, Copy)]
struct Vertex {
    place: Place,
    normal: DVec3,
}

/// A corner of a triangle on the picture.
#[derive(Debug, Clone, Copy)]
struct Corner {
    /// In steps, from the top left corner.
    x: i64,
    y: i64,
    /// One over the depth, and the normal times that: both are linear on the picture.
    nearness: f64,
    normal: DVec3,
}

/// Draws the triangles into the picture, before and behind what is there already.
pub fn draw(picture: &mut Picture, projection: &Projection, buffers: Buffers<'_>, style: Style) {
    let mut painter = Painter { picture, light: projection.headlight(), style };
    for corners in buffers.triangles {
        if corners[0] != corners[1] && corners[1] != corners[2] && corners[2] != corners[0] {
            painter.triangle(corners.map(|corner| seen(projection, &buffers, corner as usize)), projection.nearest());
        }
    }
}

fn seen(projection: &Projection, buffers: &Buffers<'_>, vertex: usize) -> Vertex {
    let [x, y, z, normal] = buffers.vertices[vertex];
    let position = match buffers.morphs.get(vertex) {
        Some([from_x, from_y, from_z, weight]) if *weight < 1.0 => {
            let between = |from: f32, to: f32| from + weight * (to - from);
            [between(*from_x, x), between(*from_y, y), between(*from_z, z)]
        }
        _ => [x, y, z],
    };
    let normal = DVec3::from_array(Normal::from_word(normal.to_bits()).decode().map(f64::from));
    Vertex { place: projection.place(position), normal }
}

/// By how much a place is on the inner side of each plane at which triangles are cut: the one before the eye, and four far out of
/// the picture.
fn insides(place: Place, nearest: f64) -> [f64; 5] {
    let Place { x, y, depth } = place;
    let wide = MARGIN * depth;
    [depth - nearest, wide - x, wide + x, wide - y, wide + y]
}

/// The vertex between two, on the side of a plane that the first is within by `inside`, and the second beyond by `outside`.
fn between(within: Vertex, inside: f64, beyond: Vertex, outside: f64) -> Vertex {
    let part = inside / (inside + outside);
    let mix = |from: f64, to: f64| from + part * (to - from);
    let (from, to) = (within.place, beyond.place);
    let place = Place { x: mix(from.x, to.x), y: mix(from.y, to.y), depth: mix(from.depth, to.depth) };
    Vertex { place, normal: within.normal.lerp(beyond.normal, part) }
}

/// The part of a polygon that is on the inner side of a plane.
fn cut(polygon: &[Vertex], nearest: f64, plane: usize) -> Vec<Vertex> {
    let mut left = Vec::with_capacity(polygon.len() + 1);
    for (index, vertex) in polygon.iter().enumerate() {
        let next = polygon[(index + 1) % polygon.len()];
        let [here, there] = [*vertex, next].map(|vertex| insides(vertex.place, nearest)[plane]);
        if here >= 0.0 {
            left.push(*vertex);
        }
        // From the inner side to the outer one, whichever way round: so both triangles at a side have the same place.
        if here >= 0.0 && there < 0.0 {
            left.push(between(*vertex, here, next, -there));
        } else if here < 0.0 && there >= 0.0 {
            left.push(between(next, there, *vertex, -here));
        }
    }
    left
}

struct Painter<'a> {
    picture: &'a mut Picture,
    light: DVec3,
    style: Style,
}

impl Painter<'_> {
    fn triangle(&mut self, vertices: [Vertex; 3], nearest: f64) {
        let sides = vertices.map(|vertex| insides(vertex.place, nearest));
        if (0..5).any(|plane| sides.iter().all(|insides| insides[plane] < 0.0)) {
            return;
        }
        if sides.iter().flatten().all(|inside| *inside >= 0.0) {
            return self.fill(vertices.map(|vertex| self.corner(vertex)));
        }
        let mut polygon = vertices.to_vec();
        for plane in 0..5 {
            polygon = cut(&polygon, nearest, plane);
        }
        let corners: Vec<Corner> = polygon.into_iter().map(|vertex| self.corner(vertex)).collect();
        let Some((first, others)) = corners.split_first() else { return };
        others.windows(2).for_each(|pair| self.fill([*first, pair[0], pair[1]]));
    }

    fn corner(&self, Vertex { place: Place { x, y, depth }, normal }: Vertex) -> Corner {
        let (width, height) = (f64::from(self.picture.width()), f64::from(self.picture.height()));
        let steps = |points: f64| (points * STEPS as f64).round() as i64;
        let (x, y) = ((0.5 + 0.5 * x / depth) * width, (0.5 - 0.5 * y / depth) * height);
        Corner { x: steps(x), y: steps(y), nearness: 1.0 / depth, normal: normal / depth }
    }

    fn fill(&mut self, [first, mut second, mut third]: [Corner; 3]) {
        let mut area = doubled_area(first, second, third.x, third.y);
        // Downwards, the outer side is drawn the other way round.
        let facing = if area < 0 { 1.0 } else { -1.0 };
        if area < 0 {
            (second, third, area) = (third, second, -area);
        }
        if area == 0 {
            return;
        }
        let corners = [first, second, third];
        let range = |values: [i64; 3], points: u32| {
            // Middles of points are half a point beyond their first steps.
            let least = values.into_iter().min().unwrap_or(0) - STEPS / 2;
            let most = values.into_iter().max().unwrap_or(0) - STEPS / 2;
            let begin = least.div_euclid(STEPS) + i64::from(least.rem_euclid(STEPS) > 0);
            (begin.max(0), (most.div_euclid(STEPS) + 1).min(i64::from(points)))
        };
        let (left, right) = range(corners.map(|corner| corner.x), self.picture.width());
        let (top, bottom) = range(corners.map(|corner| corner.y), self.picture.height());
        if left >= right {
            return;
        }
        // Opposite the first, the second and the third corner.
        let sides = [(second, third), (third, first), (first, second)];
        let over_area = 1.0 / area as f64;
        let lengths = sides.map(|(from, to)| ((to.x - from.x) as f64).hypot((to.y - from.y) as f64));
        for row in top..bottom {
            let y = row * STEPS + STEPS / 2;
            let mut areas = sides.map(|(from, to)| doubled_area(from, to, left * STEPS + STEPS / 2, y));
            let (colours, nearness) = self.picture.row(row as usize, left as usize, right as usize);
            for (colour, nearest) in colours.iter_mut().zip(nearness) {
                if areas.iter().zip(&sides).all(|(area, (from, to))| *area > 0 || (*area == 0 && has_side(*from, *to)))
                {
                    let shares = areas.map(|area| area as f64 * over_area);
                    let near = (0..3).map(|corner| shares[corner] * corners[corner].nearness).sum::<f64>() as f32;
                    if near > *nearest {
                        *nearest = near;
                        let normal: DVec3 = (0..3).map(|corner| shares[corner] * corners[corner].normal).sum();
                        let is_side = |side: usize| areas[side] as f64 <= SIDE_WIDTH * STEPS as f64 * lengths[side];
                        let surface = if self.style.edges && (0..3).any(is_side) { SIDE } else { SURFACE };
                        let direct = (facing * normal.normalize_or_zero().dot(self.light)).max(0.0);
                        *colour = surface.map(|part| srgb(part * (AMBIENT + (1.0 - AMBIENT) * direct)));
                    }
                }
                for (area, (from, to)) in areas.iter_mut().zip(&sides) {
                    *area -= (to.y - from.y) * STEPS;
                }
            }
        }
    }
}

/// Twice the area of the triangle of two corners and a place; positive where the place is to the right of the way from one to the
/// other, as it is seen with y downwards.
fn doubled_area(from: Corner, to: Corner, x: i64, y: i64) -> i64 {
    (to.x - from.x) * (y - from.y) - (to.y - from.y) * (x - from.x)
}

/// Whether what lies on a side belongs to the triangle to the right of it: where that is below it, or on its right.
fn has_side(from: Corner, to: Corner) -> bool {
    to.y < from.y || (to.y == from.y && to.x > from.x)
}

/// A part of the light, 0 to 1, as it is stored.
fn srgb(linear: f64) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let stored = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (255.0 * stored).round() as u8
}

#[cfg(test)]
mod tests;
