//! Where a surface is looked at: points spread evenly over its area.
//!
//! The area of all triangles, one behind the other in their order, is cut into as many equal pieces as there are to be
//! samples; each triangle gets those whose middle lies in its share. Within a triangle they follow the R2 sequence of
//! Roberts, a low-discrepancy sequence, by the number of the sample: so a sample depends on the mesh and on how many there
//! are, and on nothing else. Where no triangle has an area, the longest sides take its place.
//!
//! Memory: one chunk of triangles. I/O: the triangles of the pieces asked for, once.

use std::ops::Range;

use storage::StorageError;

use super::surface::{CHUNK, Corners, Spread, Surface, exact};
use super::triangle::{Triangle, longest_side_corners};
use crate::vector::Vector;

/// Steps of the R2 sequence: 1/p and 1/p², where p³ = p + 1.
const STEPS: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_2];

/// A point of a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    /// Relative to the origin of the surface.
    pub point: Vector,
    /// Which triangle it is in.
    pub triangle: u64,
    /// The weights of its corners there.
    pub weights: Vector,
}

/// Hands samples number `numbers` of `count` to `action`, in order.
pub(super) fn for_each_sample(
    surface: &Surface,
    numbers: Range<u64>,
    count: u64,
    triangles: &mut [Corners],
    mut action: impl FnMut(Sample) -> Result<(), StorageError>,
) -> Result<(), StorageError> {
    let all = surface.before.last().copied().unwrap_or(0.0);
    // The first sample that does not lie before a place.
    let first_at = |place: f64| (place / all * count as f64 - 0.5).ceil().max(0.0) as u64;
    let behind = surface.before.partition_point(|place| first_at(*place) <= numbers.start);
    let mut next = numbers.start;
    for chunk in behind.saturating_sub(1).. {
        let Some(before) = surface.before.get(chunk) else { return Ok(()) };
        let mut place = *before;
        let first = (chunk * CHUNK) as u64;
        let found = surface.triangles.read(first, triangles)?;
        for (number, corners) in (first..).zip(&triangles[..found]) {
            let triangle = exact(corners);
            place += surface.spread.of(&triangle);
            let end = first_at(place).min(numbers.end);
            while next < end {
                let (point, weights) = sample(&triangle, surface.spread, next);
                action(Sample { point, triangle: number, weights })?;
                next += 1;
            }
            if next == numbers.end {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// A sample in a triangle, and the weights of the corners there.
fn sample(triangle: &Triangle, spread: Spread, number: u64) -> (Vector, Vector) {
    let [mut u, mut v] = STEPS.map(|step| (0.5 + number as f64 * step).fract());
    match spread {
        Spread::Area => {
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let [a, b, c] = triangle;
            let point = std::array::from_fn(|axis| a[axis] + (b[axis] - a[axis]) * u + (c[axis] - a[axis]) * v);
            (point, [1.0 - u - v, u, v])
        }
        Spread::Length => {
            let ends = longest_side_corners(triangle);
            let [a, b] = ends.map(|corner| triangle[corner]);
            let mut weights = [0.0; 3];
            (weights[ends[0]], weights[ends[1]]) = (1.0 - u, u);
            (std::array::from_fn(|axis| a[axis] + (b[axis] - a[axis]) * u), weights)
        }
    }
}
