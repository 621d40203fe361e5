//! Triangles without area, and how far they reach beyond the mesh that stays.
//!
//! A triangle with two equal corners is a segment. It is left out, so the points on it have to be near what stays, and the
//! statements that are made of the model have to say how near:
//!
//! - where the segment is an edge of a triangle that stays, they are on it;
//! - where both ends are corners of triangles that stay, half its length at most is between a point and one of them;
//! - where one end is, its length is.
//! - A segment without such an end is a line apart from the surface, and no part of it, like the lines in a file.
//!
//! Where positions are rounded to a lattice, such lines, and triangles of which all three corners fell together, may have
//! been parts of the surface: they are, then. An end that is no corner of a triangle that stays is no farther from the mesh
//! than from the nearer one of the two vertices before and behind it in canonical order that stay, which is mostly near,
//! as the order is by Morton codes. With d and e for that of both ends, 0 where they stay, and L for the length, no point
//! of the segment is farther than the smallest of L + d, L + e and (L + d + e) / 2. Without a lattice d is infinite, and
//! this is what is said above.
//!
//! Memory: what it is given, for as many segments at a time as fit. I/O: for each segment 8 bytes written and read by the
//! sort; the triangles and the positions once for each such window. Where no triangle is a segment, nothing.

use bytemuck::{Pod, Zeroable};
use storage::{SortRecord, Sorted, Spool, StorageError};

use super::marks::Marks;
use crate::vector::{length, minus};

/// A triangle without area: the ids of its two corners, the smaller first; the same one twice where all three are equal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(transparent)]
pub(super) struct Segment([u32; 2]);

impl Segment {
    /// The segment of a triangle of which two corners are equal.
    pub fn of([a, b, c]: [u32; 3]) -> Segment {
        Segment::between(a, if a == b { c } else { b })
    }

    /// Whether it has no length.
    pub fn is_point(self) -> bool {
        self.0[0] == self.0[1]
    }

    fn between(one: u32, other: u32) -> Segment {
        Segment([one.min(other), one.max(other)])
    }
}

impl SortRecord for Segment {
    #[inline]
    fn prefix(&self) -> u64 {
        u64::from(self.0[0]) << 32 | u64::from(self.0[1])
    }
}

/// The end of a segment.
#[derive(Debug, Clone, Copy)]
struct End {
    id: u32,
    /// Whether it is a corner of a triangle that stays.
    stays: bool,
    position: [f32; 3],
    /// How far it is from the mesh that stays, at most.
    distance: f64,
}

/// What a segment takes in RAM, with its ends.
const SEGMENT_BYTES: usize = size_of::<(Segment, bool)>() + 2 * size_of::<End>();

/// The largest distance, in mesh units, between a point of a segment and the mesh that stays, or more.
///
/// `triangles` are those that stay, by the same ids as the segments; `staying`, the vertices that they use, is given where
/// positions are on a lattice. `ram_bytes` are for the segments, `buffer` for each sequence that is read.
pub(super) fn reach(
    mut segments: Sorted<Segment>,
    triangles: &Spool<[u32; 3]>,
    positions: &Spool<[f32; 3]>,
    staying: Option<&Marks>,
    ram_bytes: usize,
    buffer: usize,
) -> Result<f64, StorageError> {
    let most = (ram_bytes / SEGMENT_BYTES).max(1);
    let (mut window, mut largest): (Vec<Segment>, f64) = (Vec::new(), 0.0);
    loop {
        let next = segments.next()?;
        if let Some(segment) = next
            && window.last() == Some(&segment)
        {
            continue;
        }
        if window.len() == most || next.is_none() {
            largest = largest.max(reach_of(&window, triangles, positions, staying, buffer)?);
            window.clear();
        }
        match next {
            Some(segment) => window.push(segment),
            None => return Ok(largest),
        }
    }
}

/// The reach of segments that ascend, each there once.
fn reach_of(
    segments: &[Segment],
    triangles: &Spool<[u32; 3]>,
    positions: &Spool<[f32; 3]>,
    staying: Option<&Marks>,
    buffer: usize,
) -> Result<f64, StorageError> {
    let ids = segments.iter().flat_map(|segment| segment.0);
    let mut ends: Vec<End> =
        ids.map(|id| End { id, stays: false, position: [0.0; 3], distance: f64::INFINITY }).collect();
    ends.sort_unstable_by_key(|end| end.id);
    ends.dedup_by_key(|end| end.id);
    let (Some(first), Some(last)) = (ends.first().map(|end| end.id), ends.last().map(|end| end.id)) else {
        return Ok(0.0);
    };

    let mut are_edges = vec![false; segments.len()];
    let mut reader = triangles.reader(buffer);
    while let Some(corners) = reader.next()? {
        let found = corners.map(|corner| {
            let is_in_range = first <= corner && corner <= last;
            is_in_range.then(|| ends.binary_search_by_key(&corner, |end| end.id).ok()).flatten()
        });
        for end in found.iter().flatten() {
            ends[*end].stays = true;
            ends[*end].distance = 0.0;
        }
        for corner in 0..3 {
            let next = (corner + 1) % 3;
            if found[corner].is_some() && found[next].is_some() {
                let edge = Segment::between(corners[corner], corners[next]);
                segments.binary_search(&edge).into_iter().for_each(|segment| are_edges[segment] = true);
            }
        }
    }
    let mut reader = positions.reader_of(first.into(), u64::from(last) + 1, buffer);
    let mut next_end = 0;
    for id in first..=last {
        let Some(position) = reader.next()? else { break };
        if ends[next_end].id == id {
            ends[next_end].position = position;
            next_end += 1;
        }
    }
    if let Some(staying) = staying {
        look_around(&mut ends, positions, staying, buffer)?;
    }

    let end = |id: u32| ends.binary_search_by_key(&id, |end| end.id).map(|index| ends[index]);
    let mut largest = 0.0_f64;
    for (Segment([from, to]), _) in segments.iter().zip(&are_edges).filter(|(_, is_edge)| !**is_edge) {
        let (Ok(from), Ok(to)) = (end(*from), end(*to)) else { continue };
        let farthest = farthest(between(from.position, to.position), from.distance, to.distance);
        largest = largest.max(farthest);
    }
    Ok(largest)
}

/// How far a point of a segment of this length can be from the mesh, where its ends are so far from it; 0 where nothing is
/// known of either.
pub(super) fn farthest(length: f64, from: f64, to: f64) -> f64 {
    let farthest = (length + from).min(length + to).min((length + from + to) * 0.5);
    if farthest.is_finite() { farthest } else { 0.0 }
}

/// The distance of two positions.
pub(super) fn between(one: [f32; 3], other: [f32; 3]) -> f64 {
    length(minus(one.map(f64::from), other.map(f64::from)))
}

/// Finds for the ends that do not stay how far they are from the nearest vertices before and behind them that do.
fn look_around(
    ends: &mut [End],
    positions: &Spool<[f32; 3]>,
    staying: &Marks,
    buffer: usize,
) -> Result<(), StorageError> {
    let (mut reader, mut marks) = (positions.reader(buffer), staying.reader(buffer));
    let (mut before, mut id) = (None, 0);
    // Ends from `waiting` to `next` wait for the next vertex that stays.
    let (mut waiting, mut next) = (0, 0);
    while waiting < ends.len()
        && let Some(position) = reader.next()?
    {
        let stays = marks.next()?;
        if let Some(end) = ends.get_mut(next).filter(|end| end.id == id) {
            if let Some(before) = before.filter(|_| !stays) {
                end.distance = between(before, position);
            }
            next += 1;
        }
        if stays {
            for end in ends[waiting..next].iter_mut().filter(|end| !end.stays) {
                end.distance = end.distance.min(between(position, end.position));
            }
            waiting = next;
            before = Some(position);
        }
        id += 1;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use storage::{Scratch, Sorter};

    use super::*;

    #[test]
    fn a_segment_reaches_as_far_as_its_ends_allow() {
        // A triangle over 0, 1, 2, of which 0 to 1 is 4 long; 3 and 4 are apart from it.
        let positions = [[0.0; 3], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0], [10.0, 3.0, 0.0], [90.0, 0.0, 0.0]];
        let cases: [(&[[u32; 3]], f64); 7] = [
            (&[], 0.0),
            (&[[3, 3, 3], [0, 0, 0]], 0.0),
            (&[[1, 0, 1], [0, 2, 2]], 0.0),
            (&[[3, 4, 4]], 0.0),
            (&[[3, 2, 2], [0, 0, 1]], 10.0),
            (&[[0, 0, 5], [5, 0, 5], [2, 2, 0]], 2.0),
            (&[[0, 0, 5], [5, 5, 1], [3, 3, 2], [2, 3, 2]], 10.0),
        ];
        // 5 is a corner of another triangle, 4 away from 0.
        let positions = positions.into_iter().chain([[0.0, 0.0, 4.0], [0.0, 1.0, 9.0], [1.0, 0.0, 9.0]]).collect();
        let (positions, triangles) = (Spool::from_vec(positions), Spool::from_vec(vec![[0, 1, 2], [5, 6, 7]]));
        for (degenerate, expected) in cases {
            for ram_bytes in [0, 1 << 20] {
                let mut sorter = Sorter::new(&Scratch::in_memory(), "segments", 1 << 20, 1);
                let segments = degenerate.iter().map(|corners| Segment::of(*corners));
                segments.for_each(|segment| sorter.push(segment).unwrap());
                let found = reach(sorter.finish().unwrap(), &triangles, &positions, None, ram_bytes, 100).unwrap();
                // From 5 to 1 there are 32 to the root, half of which is less than 10.
                assert_eq!(found, expected, "{degenerate:?}");
            }
        }
    }
}
