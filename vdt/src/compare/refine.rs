//! The largest distance, found by branch and bound: triangles that may hold it are cut until it is known.
//!
//! No point of a triangle is farther from the other surface than
//! - the distance of any point plus the way from there, since a distance changes by no more than the way that one goes;
//! - the farthest of its corners is from any one triangle of the other surface, since that one is convex.
//!
//! The second bound is exact where a triangle has one triangle for its nearest, the first works where there are edges and
//! gaps below it.
//!
//! Where the part that lies over the nearest triangle is settled by the second bound, that part is cut out, and what lies
//! beside it goes on. So surfaces that lie on each other are settled after finitely many cuts, however they are cut into
//! triangles. Elsewhere the longest side is halved.
//!
//! Memory: less than two hundred bytes for each triangle that is open, of which there are [`MOST_OPEN`] at first and one
//! more for each search at most.

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use storage::StorageError;

use super::target::Searcher;
use super::triangle::{Triangle, centre, cut_around, farthest, farthest_corner, halves};
use crate::vector::Vector;

/// The open triangles that are looked at closer in the end, at most.
const MOST_OPEN: usize = 1024;
/// Searches for what is halved together, at most.
const MOST_SEARCHES: u64 = 20_000;
/// How well the maximum is to be known, relative to itself.
const RELATIVE: f64 = 1e-3;
/// How well it is to be known at least, relative to the diagonal of the box.
const OF_DIAGONAL: f64 = 1e-9;
/// What sticks out less over a side of a triangle is not cut off, relative to the diagonal of the box: well below what the
/// maximum is known to, so that it is settled as it is.
const OVERHANG: f64 = OF_DIAGONAL / 4.0;

/// A largest distance, and where it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Farthest {
    pub distance: f64,
    pub at: Vector,
}

impl Farthest {
    /// Nothing was looked at.
    pub const NONE: Farthest = Farthest { distance: f64::NEG_INFINITY, at: [0.0; 3] };

    /// Takes the larger one; among equals the one with the smaller coordinates, whichever came first.
    pub fn include(&mut self, other: Farthest) {
        if other.distance > self.distance || (other.distance == self.distance && other.at < self.at) {
            *self = other;
        }
    }

    /// What need not be looked at any closer: a maximum of so much would be the same, as well as it is to be known.
    pub fn enough(&self, diagonal: f64) -> f64 {
        self.distance + (RELATIVE * self.distance).max(OF_DIAGONAL * diagonal)
    }
}

/// A triangle, or a part of one, that may hold a larger distance than is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Open {
    /// What no point of it exceeds.
    pub bound: f64,
    /// How far its middle is.
    pub distance: f64,
    /// Which triangle of the surface it is in.
    pub number: u64,
    pub triangle: Triangle,
    /// The triangle of the other surface that is nearest to its middle.
    pub nearest: Triangle,
}

impl Open {
    /// Looks at the middle of a triangle, of which no point exceeds `bound`. Also says where that is.
    pub fn look(
        searcher: &mut Searcher<'_>,
        number: u64,
        triangle: Triangle,
        bound: f64,
    ) -> Result<(Open, Farthest), StorageError> {
        let at = centre(&triangle);
        let nearest = searcher.nearest(at)?;
        let distance = nearest.distance();
        let by_the_way = distance + farthest(at, &triangle);
        let by_one_triangle = farthest_corner(&triangle, &nearest.triangle);
        let bound = bound.min(by_the_way).min(by_one_triangle);
        Ok((Open { bound, distance, number, triangle, nearest: nearest.triangle }, Farthest { distance, at }))
    }

    /// Cuts the triangle in pieces. Where what lies over the nearest triangle is no farther than `enough`, it is no piece;
    /// what no point of it exceeds is told.
    fn cut(&self, enough: f64, diagonal: f64) -> (Vec<Triangle>, Option<f64>) {
        if let Some((over, beside)) = cut_around(&self.triangle, &self.nearest, OVERHANG * diagonal) {
            let bound = farthest_corner(&over, &self.nearest);
            if bound <= enough {
                return (beside, Some(bound));
            }
        }
        (halves(&self.triangle).to_vec(), None)
    }
}

/// Open triangles by their bounds.
#[derive(Debug, Clone, Copy, PartialEq)]
struct ByBound(Open);

/// Open triangles by the distances of their middles; among equals the order is that of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
struct ByDistance(Open);

impl Eq for ByBound {}
impl Eq for ByDistance {}

impl Ord for ByBound {
    fn cmp(&self, other: &Self) -> Ordering {
        self.0.bound.total_cmp(&other.0.bound).then_with(|| ByDistance(self.0).cmp(&ByDistance(other.0)))
    }
}

impl Ord for ByDistance {
    fn cmp(&self, other: &Self) -> Ordering {
        let (left, right) = (&self.0, &other.0);
        let by_distance = left.distance.total_cmp(&right.distance).then_with(|| right.number.cmp(&left.number));
        by_distance.then_with(|| left.triangle.partial_cmp(&right.triangle).unwrap_or(Ordering::Equal))
    }
}

impl PartialOrd for ByBound {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialOrd for ByDistance {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// What cutting came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Outcome {
    /// What no point exceeds of what was settled.
    pub settled: f64,
    /// Searches that it took.
    pub searches: u64,
}

/// Cuts open triangles, those with the largest bounds first, until nothing is open any more or there were so many
/// searches, or [`MOST_SEARCHES`]; what is left is handed to `leave`.
pub(super) fn cut(
    open: Vec<Open>,
    allowed: u64,
    searcher: &mut Searcher<'_>,
    best: &mut Farthest,
    diagonal: f64,
    mut leave: impl FnMut(Open),
) -> Result<Outcome, StorageError> {
    let allowed = allowed.min(MOST_SEARCHES);
    let mut open: BinaryHeap<ByBound> = open.into_iter().map(ByBound).collect();
    let mut outcome = Outcome { settled: f64::NEG_INFINITY, searches: 0 };
    while let Some(ByBound(worst)) = open.pop() {
        if worst.bound <= best.enough(diagonal) {
            // So are all the others.
            outcome.settled = outcome.settled.max(worst.bound);
            break;
        }
        if outcome.searches >= allowed {
            leave(worst);
            continue;
        }
        let (pieces, settled) = worst.cut(best.enough(diagonal), diagonal);
        outcome.settled = outcome.settled.max(settled.unwrap_or(f64::NEG_INFINITY));
        outcome.searches += pieces.len() as u64;
        for piece in pieces {
            let (piece, found) = Open::look(searcher, worst.number, piece, worst.bound)?;
            best.include(found);
            open.push(ByBound(piece));
        }
    }
    Ok(outcome)
}

/// The open triangles that look worst: those whose middles are the farthest. Which they are does not depend on the order
/// in which they come.
#[derive(Debug)]
pub(super) struct OpenSet {
    kept: BinaryHeap<Reverse<ByDistance>>,
    /// What no point exceeds that is in none of them.
    others: f64,
}

impl OpenSet {
    /// Nothing is open.
    pub fn new() -> Self {
        OpenSet { kept: BinaryHeap::new(), others: f64::NEG_INFINITY }
    }

    /// Adds a triangle.
    pub fn add(&mut self, open: Open) {
        self.kept.push(Reverse(ByDistance(open)));
        if self.kept.len() > MOST_OPEN
            && let Some(Reverse(ByDistance(least))) = self.kept.pop()
        {
            self.settle(least.bound);
        }
    }

    /// Takes note of a part of the surface that is not looked at any closer.
    pub fn settle(&mut self, bound: f64) {
        self.others = self.others.max(bound);
    }

    /// Adds those of another set.
    pub fn append(&mut self, other: OpenSet) {
        self.settle(other.others);
        other.kept.into_iter().for_each(|Reverse(ByDistance(open))| self.add(open));
    }

    /// Looks closer, until `best` is known well enough or there was enough searching. Returns what no distance exceeds.
    pub fn refine(self, searcher: &mut Searcher<'_>, best: &mut Farthest, diagonal: f64) -> Result<f64, StorageError> {
        let mut others = self.others;
        let open = self.kept.into_iter().map(|Reverse(ByDistance(open))| open).collect();
        let leave = |open: Open| others = others.max(open.bound);
        let outcome = cut(open, MOST_SEARCHES, searcher, best, diagonal, leave)?;
        Ok(others.max(outcome.settled).max(best.distance))
    }
}
