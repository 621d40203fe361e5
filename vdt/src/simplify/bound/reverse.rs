//! The other direction: how far the new triangles of a collapse are from the input.
//!
//! Every point of an old triangle lies within its reverse bound of a point of the input. So a point of a new triangle that
//! lies within d of an old one lies within d and that bound of the input. A new triangle goes whole to the old one at the
//! same outer side, or is cut along the old spokes, the edges from the vertex that goes, whichever is less far: what
//! `rewrite` does with pieces, with the old and the new in each other's places. Nothing of it is kept but the bound.

use std::cmp::Ordering;

use super::cut::{Cutter, Shape};
use super::distance::Triangles;
use super::fan::Fan;
use super::lanes::{LANES, Lanes, Vectors};
use super::rewrite::{ROUND_UP, Rounding};
use super::{minus, square};
use crate::simplify::live_mesh::LiveMesh;

/// Works out reverse bounds; kept from one collapse to the next for its memory.
#[derive(Debug, Default)]
pub(super) struct Reverse {
    cutter: Cutter,
    /// Where each old spoke ends, relative to the vertex that goes.
    spokes: Vec<[f32; 3]>,
    /// For each old triangle, the squared distance of the vertex that stays.
    from_stays: Vec<f32>,
    /// The reverse bound of each new triangle.
    pub bounds: Vec<f32>,
}

/// A point of a triangle near another point: the nearest one but for rounding, where that is not at a side.
fn near(point: [f32; 3], [v, a, b]: [[f32; 3]; 3]) -> [f32; 3] {
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let clamped = |value: f32, most: f32| if value > 0.0 { value.min(most) } else { 0.0 };
    let (point, a, b) = (minus(point, v), minus(a, v), minus(b, v));
    let (aa, ab, bb, pa, pb) = (dot(a, a), dot(a, b), dot(b, b), dot(point, a), dot(point, b));
    let area = aa * bb - ab * ab;
    let s = clamped((bb * pa - ab * pb) / area, 1.0);
    let t = clamped((aa * pb - ab * pa) / area, 1.0 - s);
    std::array::from_fn(|axis| v[axis] + (s * a[axis] + t * b[axis]))
}

impl Reverse {
    /// The new triangles of a fan around `gone`, of which `old_triangles` has the triangles in the order of the ring; `nearest`
    /// is the sector that `gone` is nearest to. Returns the largest bound.
    pub fn measure_fan(
        &mut self,
        mesh: &LiveMesh,
        [gone, stays]: [u32; 2],
        fan: &Fan,
        nearest: usize,
        old_triangles: &[u32],
        rounding: Rounding,
    ) -> f32 {
        let reverse = |number: usize| mesh.covers.reverse(old_triangles[fan.order[number]] as usize);
        let position = |vertex: u32| mesh.vertices[vertex as usize].position;
        let origin = position(gone);
        let count = fan.order.len();
        self.spokes.clear();
        self.spokes.extend(fan.corners.iter().map(|corner| minus(position(*corner), origin)));
        self.from_stays.clear();
        let stays_vector = Vectors::all(minus(position(stays), origin));
        for first in (0..count).step_by(LANES) {
            let end = count.min(first + LANES);
            let a = Vectors::of(self.spokes[first..end].iter().copied());
            let b = Vectors::of(self.spokes[first + 1..=end].iter().copied());
            let squares = Triangles::new(a, b).square_distance(stays_vector);
            self.from_stays.extend_from_slice(&squares.0[..end - first]);
        }
        let last = if fan.is_closed() { count - 1 } else { 0 };
        self.bounds.clear();
        for own in 1..=fan.sectors() {
            let corners = [stays, fan.corners[own], fan.corners[own + 1]].map(position);
            let [v, a, b] = corners;
            // The vertex that stays is a corner of the first old triangle, and of the last one in a closed fan. What lies on
            // this side of the vertex that goes is towards the first, what lies beyond towards the last.
            let cut = match own.cmp(&(nearest + 1)) {
                Ordering::Less => self.part([(v, 0, 0.0), (a, own, 0.0), (b, own, 0.0)], origin, &reverse),
                Ordering::Greater => self.part([(v, last, 0.0), (a, own, 0.0), (b, own, 0.0)], origin, &reverse),
                // This one has triangles on both sides of it, and is divided where the vertex that goes is near; that is a
                // corner of all old triangles.
                Ordering::Equal => {
                    let middle = near(origin, corners);
                    let from_gone = square(minus(middle, origin));
                    let after = (own + 1).min(last.max(own));
                    let sides = [
                        [(v, 0, 0.0), (a, own - 1, 0.0), (middle, own - 1, from_gone)],
                        [(a, own, 0.0), (b, own, 0.0), (middle, own, from_gone)],
                        [(v, last, 0.0), (b, after, 0.0), (middle, after, from_gone)],
                    ];
                    let parts = sides.map(|side| self.part(side, origin, &reverse));
                    parts[0].max(parts[1]).max(parts[2])
                }
            };
            let whole = reverse(own) + self.from_stays[own].sqrt();
            let least = whole.min(cut + 2.0 * rounding.of_places);
            self.bounds.push(least * ROUND_UP + 2.0 * rounding.of_distances);
        }
        self.bounds.iter().copied().fold(0.0, f32::max)
    }

    /// The bound of a part of a new triangle: its corners, each with the old triangle that it is given to and its squared
    /// distance from that. Infinite where it cannot be cut.
    fn part(&mut self, corners: [([f32; 3], usize, f32); 3], origin: [f32; 3], reverse: &impl Fn(usize) -> f32) -> f32 {
        let mut shape = Shape::default();
        for (corner, number, square) in corners {
            shape.push(corner, number, square);
        }
        if !self.cutter.cut(&shape, origin, &self.spokes) {
            return f32::INFINITY;
        }
        let parts = self.cutter.parts.iter().map(|part| reverse(part.sector) + part.square.sqrt());
        parts.fold(0.0, f32::max)
    }

    /// New triangles in the places of old ones that are no fan, by their numbers and the two corners after the vertex that
    /// stays. Returns the largest bound.
    pub fn measure_whole(
        &mut self,
        mesh: &LiveMesh,
        [gone, stays]: [u32; 2],
        ring: &[[u32; 2]],
        old_triangles: &[u32],
        new_corners: impl Iterator<Item = [[f32; 3]; 2]>,
        rounding: Rounding,
    ) -> f32 {
        let position = |vertex: u32| mesh.vertices[vertex as usize].position;
        let origin = position(gone);
        let offset = minus(position(stays), origin);
        self.bounds.clear();
        for [a, b] in new_corners {
            let from_gone = |corner: [f32; 3]| [corner[0] + offset[0], corner[1] + offset[1], corner[2] + offset[2]];
            let points = Vectors::of([offset, from_gone(a), from_gone(b)]);
            let distances = ring.iter().zip(old_triangles).map(|(pair, triangle)| {
                let [c, d] = pair.map(|corner| Vectors::all(minus(position(corner), origin)));
                let squares: Lanes = Triangles::new(c, d).square_distance(points);
                let farthest = squares.0[..3].iter().fold(0.0_f32, |farthest, square| square.max(farthest));
                mesh.covers.reverse(*triangle as usize) + farthest.sqrt()
            });
            let least = distances.fold(f32::INFINITY, f32::min);
            self.bounds.push(least * ROUND_UP + 2.0 * rounding.of_distances);
        }
        self.bounds.iter().copied().fold(0.0, f32::max)
    }
}
