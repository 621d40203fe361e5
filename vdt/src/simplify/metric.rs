//! What a collapse costs: the quadric error of Garland and Heckbert with a small edge-length term, or the edge's length.
//!
//! The quadric of a vertex is kept about the vertex's own position, in single precision: centred there, 24 bits are
//! enough (measured: the same distances as double precision), and a vertex with its quadric fits one cache line.
//! Every vertex starts with the area-weighted planes of its triangles; an edge that is not shared by exactly two
//! triangles with opposite directions along it adds the plane through it that is square to each of its triangles,
//! weighted by the square of its length, so that boundaries keep their shape.

use bytemuck::{Pod, Zeroable};

use crate::vector::{Vector, dot};

/// Weight of the edge-length term against the quadric. Never zero: in flat regions the quadric is rounding noise, and
/// without this term slivers would wander there. Small: distances measured from the input, at 50, 20, 5 and 1 % of the
/// triangles, root mean square in 1e-4 of the diagonal, are 0.079, 0.81, 4.3, 38 on a CAD part (fandisk) with 1e-3, and
/// 0.010, 0.25, 2.6, 30 with 1e-5; 1e-6 is no better from 1 % on. Scans and terrain differ by less than a tenth between
/// 1e-4 and 1e-6.
const LENGTH_WEIGHT: f32 = 1e-5;

/// A sum of squared distances to planes, as a polynomial in the displacement from the vertex that it belongs to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Quadric {
    /// Second-order part: xx, xy, xz, yy, yz, zz.
    a: [f32; 6],
    /// Half of the first-order part.
    b: [f32; 3],
    /// The value at the vertex itself.
    c: f32,
}

impl Quadric {
    /// Adds the plane through the vertex with normal `direction` (of any length), with this weight.
    pub fn add_plane_through_vertex(&mut self, direction: Vector, weight: f64) {
        let square = dot(direction, direction);
        if square <= 0.0 {
            return;
        }
        let scale = weight / square;
        let [x, y, z] = direction;
        let terms = [x * x, x * y, x * z, y * y, y * z, z * z];
        for (sum, term) in self.a.iter_mut().zip(terms) {
            *sum += (term * scale) as f32;
        }
    }

    /// The weights of all planes, added up.
    #[inline]
    fn weight(&self) -> f32 {
        self.a[0] + self.a[3] + self.a[5]
    }

    #[inline]
    fn linear(&self, d: [f32; 3]) -> [f32; 3] {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        [xx * d[0] + xy * d[1] + xz * d[2], xy * d[0] + yy * d[1] + yz * d[2], xz * d[0] + yz * d[1] + zz * d[2]]
    }

    /// The value at displacement `d`, with the terms that all quadrics share at hand. In an order that lets four lanes
    /// work side by side.
    #[inline]
    fn at_terms(&self, terms: &Terms) -> f32 {
        let Quadric { a, b, c } = self;
        let Terms { second, first } = terms;
        let sums = [
            a[0] * second[0] + a[4] * second[4],
            a[1] * second[1] + a[5] * second[5],
            a[2] * second[2] + b[0] * first[0],
            a[3] * second[3] + b[1] * first[1],
        ];
        ((sums[0] + sums[1]) + (sums[2] + sums[3])) + (b[2] * first[2] + c)
    }

    /// The value at displacement `d`.
    #[inline]
    fn at(&self, d: [f32; 3]) -> f32 {
        self.at_terms(&Terms::of(d))
    }

    /// Adds `other`, whose vertex is at displacement `-d` from this one's: this vertex is at `d` from it.
    fn add_moved(&mut self, other: &Quadric, d: [f32; 3]) {
        let l = other.linear(d);
        self.c += at_least_zero(other.at(d));
        for axis in 0..3 {
            self.b[axis] += other.b[axis] + l[axis];
        }
        for (sum, term) in self.a.iter_mut().zip(other.a) {
            *sum += term;
        }
    }
}

/// A displacement, as quadrics are evaluated at it.
#[derive(Debug, Clone, Copy)]
struct Terms {
    /// Squares and doubled products: xx, xy, xz, yy, yz, zz.
    second: [f32; 6],
    /// Doubled components.
    first: [f32; 3],
}

impl Terms {
    #[inline]
    fn of(d: [f32; 3]) -> Self {
        let first = [d[0] + d[0], d[1] + d[1], d[2] + d[2]];
        let second = [d[0] * d[0], first[0] * d[1], first[0] * d[2], d[1] * d[1], first[1] * d[2], d[2] * d[2]];
        Terms { second, first }
    }

    /// Those of the opposite displacement.
    #[inline]
    fn back(&self) -> Self {
        Terms { first: self.first.map(|value| -value), ..*self }
    }

    #[inline]
    fn square(&self) -> f32 {
        self.second[0] + self.second[3] + self.second[5]
    }
}

/// Rounding can push a value below zero; keys are compared by their bits, so they must not be negative, nor -0.0.
#[inline]
fn at_least_zero(value: f32) -> f32 {
    if value > 0.0 { value } else { 0.0 }
}

#[inline]
fn square(d: [f32; 3]) -> f32 {
    d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
}

/// What the engine asks of a metric. Unless said otherwise, `d` is the displacement from the vertex that goes to the one
/// that stays.
pub trait CollapseMetric: Copy + Send + Sync {
    /// The keys by which collapses are ordered, of the edge between two vertices, the second of which is at displacement
    /// `d` from the first: that of the first one's going, and that of the second one's. At least 0, never -0.0 or NaN.
    fn keys(&self, first: &Quadric, second: &Quadric, d: [f32; 3]) -> [f32; 2];

    /// A key raised by what the collapse changes on the surface: by the square of that length, weighted as the key is. At
    /// least the key.
    fn raised(&self, key: f32, first: &Quadric, second: &Quadric, attribute_error: f32) -> f32;

    /// The error of the collapse as a length: what its switch value starts from.
    fn error(&self, gone: &Quadric, stays: &Quadric, d: [f32; 3]) -> f32;

    /// What the vertex that stays takes over.
    fn merge(&self, gone: &Quadric, stays: &mut Quadric, d: [f32; 3]);

    /// Whether the quadrics are used at all.
    fn uses_quadrics(&self) -> bool;
}

/// Quadric error: key = error sum + small term in the squared length; error = weighted root mean square distance.
#[derive(Debug, Clone, Copy)]
pub struct QuadricMetric;

impl CollapseMetric for QuadricMetric {
    #[inline]
    fn keys(&self, first: &Quadric, second: &Quadric, d: [f32; 3]) -> [f32; 2] {
        let terms = Terms::of(d);
        let length = LENGTH_WEIGHT * (first.weight() + second.weight()) * terms.square();
        [
            at_least_zero(at_least_zero(first.at_terms(&terms)) + second.c + length),
            at_least_zero(at_least_zero(second.at_terms(&terms.back())) + first.c + length),
        ]
    }

    fn raised(&self, key: f32, first: &Quadric, second: &Quadric, attribute_error: f32) -> f32 {
        key + (first.weight() + second.weight()) * (attribute_error * attribute_error)
    }

    fn error(&self, gone: &Quadric, stays: &Quadric, d: [f32; 3]) -> f32 {
        let weight = gone.weight() + stays.weight();
        if weight > 0.0 { ((at_least_zero(gone.at(d)) + stays.c) / weight).sqrt() } else { 0.0 }
    }

    fn merge(&self, gone: &Quadric, stays: &mut Quadric, d: [f32; 3]) {
        stays.add_moved(gone, d);
    }

    fn uses_quadrics(&self) -> bool {
        true
    }
}

/// Euclidean edge length, the paper's simplest metric. The key is its square: the same order, without the root.
#[derive(Debug, Clone, Copy)]
pub struct LengthMetric;

impl CollapseMetric for LengthMetric {
    #[inline]
    fn keys(&self, _: &Quadric, _: &Quadric, d: [f32; 3]) -> [f32; 2] {
        [square(d); 2]
    }

    fn raised(&self, key: f32, _: &Quadric, _: &Quadric, attribute_error: f32) -> f32 {
        key + attribute_error * attribute_error
    }

    fn error(&self, _: &Quadric, _: &Quadric, d: [f32; 3]) -> f32 {
        square(d).sqrt()
    }

    fn merge(&self, _: &Quadric, _: &mut Quadric, _: [f32; 3]) {}

    fn uses_quadrics(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moved_quadric_measures_the_same_distances() {
        let mut gone = Quadric::default();
        gone.add_plane_through_vertex([0.0, 0.0, 2.0], 3.0);
        gone.add_plane_through_vertex([1.0, 1.0, 0.0], 0.5);
        let mut stays = Quadric::default();
        stays.add_plane_through_vertex([0.0, 1.0, 0.0], 1.0);
        let d = [0.25, -0.5, 1.5];
        let mut sum = stays;
        sum.add_moved(&gone, d);
        for x in [[0.0, 0.0, 0.0], [1.0, 2.0, -1.0], [-0.3, 0.7, 0.1]] {
            let from_gone = [x[0] + d[0], x[1] + d[1], x[2] + d[2]];
            let expected = stays.at(x) + gone.at(from_gone);
            assert!((sum.at(x) - expected).abs() < 1e-5, "{} {expected}", sum.at(x));
        }
        // Distances by hand: 1.5 from the first plane, (0.25 - 0.5) / sqrt 2 from the second.
        let by_hand = 3.0 * 1.5_f32.powi(2) + 0.5 * (0.25_f32).powi(2) / 2.0;
        assert!((gone.at(d) - by_hand).abs() < 1e-5);
        assert!((QuadricMetric.error(&gone, &stays, d) - (by_hand / 4.5).sqrt()).abs() < 1e-6);
    }
}
