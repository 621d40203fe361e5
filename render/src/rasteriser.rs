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

use std::ops::{Add, Mul};

use glam::{DVec2, DVec3};
use metanode::page::Normal;
use navigator::DrawnWedge;

use crate::boxes::LineEnd;
use crate::colours::{from_stored, stored};
use crate::levels::colour;
use crate::looks::{Looks, PLAIN, Texture};
use crate::picture::Picture;
use crate::projection::{Place, Projection};

/// Steps in a point.
const STEPS: i64 = 256;
/// What is so many half pictures beside the middle is cut off. (So all products stay within 64 bits.)
const MARGIN: f64 = 16.0;
/// The part of the light that comes from everywhere.
pub(crate) const AMBIENT: f64 = 0.12;
/// The part of it that a point on the side of a triangle throws back, where those are drawn: red, green and blue.
pub(crate) const SIDE: [f64; 3] = [0.02, 0.05, 0.12];
/// How far from a side a point belongs to it, in points.
pub(crate) const SIDE_WIDTH: f64 = 0.6;

/// What is drawn: the streams of a navigator.
#[derive(Debug, Clone, Copy, Default)]
pub struct Buffers<'a> {
    /// Positions, and normals, see [`Navigator::vertex_stream`](navigator::Navigator::vertex_stream).
    pub vertices: &'a [[f32; 4]],
    /// Origins and weights, see [`Navigator::morph_stream`](navigator::Navigator::morph_stream); may be empty.
    pub morphs: &'a [[f32; 4]],
    /// Corners, see [`Navigator::triangle_stream`](navigator::Navigator::triangle_stream).
    pub triangles: &'a [[u32; 3]],
    /// Levels of detail, by the numbers of the vertices; empty where their colours are not to be seen.
    pub levels: &'a [u8],
    /// What corners carry, see [`Navigator::wedge_stream`](navigator::Navigator::wedge_stream); may be empty.
    pub wedges: &'a [DrawnWedge],
    /// Which corners carry which, see [`Navigator::corner_stream`](navigator::Navigator::corner_stream); may be empty.
    pub corners: &'a [[u32; 3]],
    /// What the materials of wedges look like; needed where there are wedges.
    pub looks: Option<&'a Looks>,
}

/// What is different from corner to corner, and between them in the middle.
#[derive(Debug, Clone, Copy)]
struct Carried {
    normal: DVec3,
    /// The part of the light that the surface throws back: red, green and blue.
    surface: DVec3,
    /// Texture coordinate.
    texture: DVec2,
}

/// A corner of a triangle as the eye sees it.
#[derive(Debug, Clone, Copy)]
struct Vertex {
    place: Place,
    carried: Carried,
}

/// A corner of a triangle on the picture.
#[derive(Debug, Clone, Copy)]
struct Corner {
    /// In steps, from the top left corner.
    x: i64,
    y: i64,
    /// One over the depth, and what is carried times that: these are linear on the picture.
    nearness: f64,
    carried: Carried,
}

impl Mul<f64> for Carried {
    type Output = Carried;

    fn mul(self, factor: f64) -> Carried {
        let Carried { normal, surface, texture } = self;
        Carried { normal: normal * factor, surface: surface * factor, texture: texture * factor }
    }
}

impl Add for Carried {
    type Output = Carried;

    fn add(self, other: Carried) -> Carried {
        Carried {
            normal: self.normal + other.normal,
            surface: self.surface + other.surface,
            texture: self.texture + other.texture,
        }
    }
}

/// Draws the triangles into the picture, before and behind what is there already, with their sides or without.
pub fn draw(picture: &mut Picture, projection: &Projection, buffers: Buffers<'_>, edges: bool) {
    let mut painter = Painter { picture, light: projection.headlight(), edges, texture: None };
    for (triangle, vertices) in buffers.triangles.iter().enumerate() {
        if vertices[0] == vertices[1] || vertices[1] == vertices[2] || vertices[2] == vertices[0] {
            continue;
        }
        let wedges = buffers.corners.get(triangle).unwrap_or(vertices);
        let wedges = wedges.map(|wedge| buffers.wedges.get(wedge as usize));
        painter.texture = wedges[0].filter(|_| buffers.levels.is_empty()).and_then(|wedge| texture(&buffers, wedge));
        let corners = [0, 1, 2].map(|corner| seen(projection, &buffers, vertices[corner] as usize, wedges[corner]));
        painter.triangle(corners, projection.nearest());
    }
}

/// The texture of what has a wedge.
fn texture<'a>(buffers: &Buffers<'a>, wedge: &DrawnWedge) -> Option<&'a Texture> {
    let looks = buffers.looks?;
    let look = looks.materials().get(wedge.material as usize)?;
    looks.textures().get((look.texture as usize).checked_sub(1)?)
}

fn seen(projection: &Projection, buffers: &Buffers<'_>, vertex: usize, wedge: Option<&DrawnWedge>) -> Vertex {
    let [x, y, z, normal] = buffers.vertices[vertex];
    let position = match buffers.morphs.get(vertex) {
        Some([from_x, from_y, from_z, weight]) if *weight < 1.0 => {
            let between = |from: f32, to: f32| from + weight * (to - from);
            [between(*from_x, x), between(*from_y, y), between(*from_z, z)]
        }
        _ => [x, y, z],
    };
    let word = wedge.map_or(normal.to_bits(), |wedge| wedge.normal);
    let normal = DVec3::from_array(Normal::from_word(word).decode().map(f64::from));
    let surface = match (buffers.levels.get(vertex), wedge) {
        (Some(level), _) => DVec3::from_array(colour(*level).map(f64::from)),
        (None, Some(wedge)) => surface(buffers.looks, wedge),
        (None, None) => DVec3::from_array(PLAIN.map(f64::from)),
    };
    let texture = wedge.map_or(DVec2::ZERO, |wedge| DVec2::from_array(wedge.texture.map(f64::from)));
    Vertex { place: projection.place(position), carried: Carried { normal, surface, texture } }
}

/// What a corner throws back, but for its texture.
fn surface(looks: Option<&Looks>, wedge: &DrawnWedge) -> DVec3 {
    let [red, green, blue, _] = wedge.colour;
    let of_vertex = [red, green, blue].map(|part| from_stored(f64::from(part) / 255.0));
    let look = looks.and_then(|looks| looks.materials().get(wedge.material as usize));
    DVec3::from_array(of_vertex) * DVec3::from_array(look.map_or(PLAIN, |look| look.colour).map(f64::from))
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
    let place = place_between(within.place, beyond.place, part);
    Vertex { place, carried: within.carried * (1.0 - part) + beyond.carried * part }
}

/// The place a part of the way from one to another.
fn place_between(from: Place, to: Place, part: f64) -> Place {
    let mix = |from: f64, to: f64| from + part * (to - from);
    Place { x: mix(from.x, to.x), y: mix(from.y, to.y), depth: mix(from.depth, to.depth) }
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
    edges: bool,
    /// That of the triangle at hand.
    texture: Option<&'a Texture>,
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

    fn corner(&self, Vertex { place, carried }: Vertex) -> Corner {
        let [x, y] = on_picture(self.picture, place).map(|points| (points * STEPS as f64).round() as i64);
        let nearness = 1.0 / place.depth;
        Corner { x, y, nearness, carried: carried * nearness }
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
        // How many points of the texture there are for a point of the picture, on each side.
        let texture_points = self.texture.map_or(0.0, |texture| {
            let [origin, right, down] = corners.map(|corner| corner.carried.texture / corner.nearness);
            let of_texture = (right - origin).perp_dot(down - origin).abs() * f64::from(texture.side()).powi(2);
            (of_texture * over_area).sqrt() * STEPS as f64
        });
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
                        let [one, two, three] = [0, 1, 2].map(|corner| corners[corner].carried * shares[corner]);
                        let Carried { normal, mut surface, texture } = (one + two + three) * (1.0 / f64::from(near));
                        if let Some(found) = self.texture {
                            surface *= DVec3::from_array(found.at(texture.to_array(), texture_points));
                        }
                        let is_side = |side: usize| areas[side] as f64 <= SIDE_WIDTH * STEPS as f64 * lengths[side];
                        if self.edges && (0..3).any(is_side) {
                            surface = DVec3::from_array(SIDE);
                        }
                        let direct = (facing * normal.normalize_or_zero().dot(self.light)).max(0.0);
                        *colour = surface.to_array().map(|part| stored(part * (AMBIENT + (1.0 - AMBIENT) * direct)));
                    }
                }
                for (area, (from, to)) in areas.iter_mut().zip(&sides) {
                    *area -= (to.y - from.y) * STEPS;
                }
            }
        }
    }
}

/// Draws lines into the picture, before and behind what is there already: each two ends are one.
pub fn draw_lines(picture: &mut Picture, projection: &Projection, lines: &[LineEnd]) {
    for ends in lines.as_chunks::<2>().0 {
        let mut line = ends.iter().map(|end| projection.place(end.position)).collect::<Vec<_>>();
        for plane in 0..5 {
            let insides = [line[0], line[1]].map(|place| insides(place, projection.nearest())[plane]);
            let cut = |inner: usize, outer: usize| {
                place_between(line[inner], line[outer], insides[inner] / (insides[inner] - insides[outer]))
            };
            match insides.map(|inside| inside >= 0.0) {
                [true, true] => {}
                [true, false] => line[1] = cut(0, 1),
                [false, true] => line[0] = cut(1, 0),
                [false, false] => line.clear(),
            }
            if line.is_empty() {
                break;
            }
        }
        if let [from, to] = line[..] {
            draw_line(picture, [from, to], ends[0].colour);
        }
    }
}

/// One point in each row or column, whichever of them it goes through more of.
fn draw_line(picture: &mut Picture, ends: [Place; 2], colour: [u8; 4]) {
    let [from, to] = ends.map(|end| on_picture(picture, end));
    let [red, green, blue, _] = colour;
    let stored = [red, green, blue].map(|part| stored(f64::from(part) / 255.0));
    let steps = (to[0] - from[0]).abs().max((to[1] - from[1]).abs()).ceil();
    let nearness = ends.map(|end| 1.0 / end.depth);
    for step in 0..=steps as u64 {
        let part = if steps > 0.0 { step as f64 / steps } else { 0.0 };
        let [x, y] = [0, 1].map(|axis| (from[axis] + part * (to[axis] - from[axis])).floor());
        if x < 0.0 || y < 0.0 || x >= f64::from(picture.width()) || y >= f64::from(picture.height()) {
            continue;
        }
        let near = (nearness[0] + part * (nearness[1] - nearness[0])) as f32;
        let (colours, nearest) = picture.row(y as usize, x as usize, x as usize + 1);
        if near > nearest[0] {
            (colours[0], nearest[0]) = (stored, near);
        }
    }
}

/// Points from the left and from the top.
fn on_picture(picture: &Picture, Place { x, y, depth }: Place) -> [f64; 2] {
    let (width, height) = (f64::from(picture.width()), f64::from(picture.height()));
    [(0.5 + 0.5 * x / depth) * width, (0.5 - 0.5 * y / depth) * height]
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

#[cfg(test)]
mod tests;
