//! The triangles, grouped by the split at which they are born, in leaf order: each turned so that its first corner lies
//! under the kept child, sorted within a split. One external sort of 16-byte records, 20 where corners have a choice of wedges.
//!
//! Which corner that is follows from the born leaf `m` alone: *the largest of those below `m`*. For let the split's node
//! have the leaves `s..e`, its kept child `s..m`, its born child `m..e`. The triangle died when the two children became
//! one, so exactly one corner `k` lies in `s..m`, exactly one in `m..e`, and the third outside `s..e`, that is below `s`
//! and so below `k`, or not below `e` and so not below `m`.

use bytemuck::{Pod, Zeroable};
use storage::{PagedArray, Scattered, SortRecord, Sorted, Sorter, Spool, SpoolWriter};

use super::{FinishError, Work};
use crate::tree::CornerPlaces;

/// A triangle with the split that bears it.
trait BornTriangle: SortRecord {
    fn new(split: u32, corners: [u32; 3], places: CornerPlaces) -> Self;
    fn split(&self) -> u32;
    fn corners(&self) -> [u32; 3];
    fn places(&self) -> CornerPlaces;
}

/// One whose corners have no choice of wedges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct Plain {
    split: u32,
    corners: [u32; 3],
}

/// One whose corners have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct WithPlaces {
    plain: Plain,
    places: u32,
}

impl SortRecord for Plain {
    #[inline]
    fn prefix(&self) -> u64 {
        u64::from(self.split) << 32 | u64::from(self.corners[0])
    }
}

impl SortRecord for WithPlaces {
    fn prefix(&self) -> u64 {
        self.plain.prefix()
    }
}

impl BornTriangle for Plain {
    #[inline]
    fn new(split: u32, corners: [u32; 3], _: CornerPlaces) -> Self {
        Plain { split, corners }
    }

    #[inline]
    fn split(&self) -> u32 {
        self.split
    }

    #[inline]
    fn corners(&self) -> [u32; 3] {
        self.corners
    }

    #[inline]
    fn places(&self) -> CornerPlaces {
        CornerPlaces::default()
    }
}

impl BornTriangle for WithPlaces {
    fn new(split: u32, corners: [u32; 3], places: CornerPlaces) -> Self {
        WithPlaces { plain: Plain { split, corners }, places: bytemuck::cast(places) }
    }

    fn split(&self) -> u32 {
        self.plain.split
    }

    fn corners(&self) -> [u32; 3] {
        self.plain.corners
    }

    fn places(&self) -> CornerPlaces {
        bytemuck::cast(self.places)
    }
}

/// All triangles, in the order of the splits that bear them.
pub(super) struct Born {
    /// For each leaf how many triangles its split bears.
    pub counts: Spool<u32>,
    pub corners: Spool<[u32; 3]>,
    /// The wedges of the corners; empty where these have no choice.
    pub places: Spool<CornerPlaces>,
}

/// Brings the canonical triangles into the order of the splits that bear them. `deaths` has, for each of them, the vertex whose
/// going it died of; `places` the wedges of its corners, where these have a choice.
pub(super) fn bear(
    triangles: Spool<[u32; 3]>,
    places: Option<Spool<CornerPlaces>>,
    deaths: Scattered<u32>,
    leaf_of: PagedArray,
    work: &mut Work<'_>,
) -> Result<Born, FinishError> {
    if places.is_some() {
        write(sort::<WithPlaces>(triangles, places, deaths, leaf_of, work)?, true, work)
    } else {
        write(sort::<Plain>(triangles, None, deaths, leaf_of, work)?, false, work)
    }
}

/// Sorts the canonical triangles by the split that bears them.
fn sort<T: BornTriangle>(
    triangles: Spool<[u32; 3]>,
    places: Option<Spool<CornerPlaces>>,
    mut deaths: Scattered<u32>,
    mut leaf_of: PagedArray,
    work: &mut Work<'_>,
) -> Result<Sorted<T>, FinishError> {
    let mut sorter = Sorter::new(work.scratch, "born-triangles", work.shares.born_triangles, work.threads);
    let mut number = 0;
    {
        let mut reader = triangles.reader(work.shares.input);
        let mut places = places.as_ref().map(|places| places.reader(work.shares.input));
        while let Some(corners) = reader.next()? {
            let Some(death) = deaths.next()?.filter(|death| *death < work.leaf_count) else {
                return Err(FinishError::Triangle { triangle: number, problem: "it did not die" });
            };
            let split = leaf_of.get(death)?;
            let [a, b, c] = corners;
            let corners = [leaf_of.get(a)?, leaf_of.get(b)?, leaf_of.get(c)?];
            let Some(first) = kept_corner(corners, split) else {
                let problem = "none of its leaves comes before the one that went when it died";
                return Err(FinishError::Triangle { triangle: number, problem });
            };
            let places = match &mut places {
                None => CornerPlaces::default(),
                Some(places) => places
                    .next()?
                    .map(|places| places.turned(first))
                    .ok_or(FinishError::Triangle { triangle: number, problem: "its corners have no wedges" })?,
            };
            let [a, b, c] = corners;
            sorter.push(T::new(split, [[a, b, c], [b, c, a], [c, a, b]][first], places))?;
            number += 1;
            work.step();
        }
    }
    drop((triangles, places, deaths, leaf_of));
    Ok(sorter.finish()?)
}

/// Which corner of a triangle lies under the kept child of the split that bears it.
#[inline]
fn kept_corner([a, b, c]: [u32; 3], split: u32) -> Option<usize> {
    // One more than the leaf where it is below the split's, so that 0 is for the others.
    let below = |leaf: u32| if leaf < split { leaf + 1 } else { 0 };
    let largest = below(a).max(below(b)).max(below(c));
    match largest {
        0 => None,
        _ if largest == a + 1 => Some(0),
        _ if largest == b + 1 => Some(1),
        _ => Some(2),
    }
}

/// For each leaf how many triangles its split bears, and their corners.
fn write<T: BornTriangle>(mut sorted: Sorted<T>, with_places: bool, work: &mut Work<'_>) -> Result<Born, FinishError> {
    let mut counts = SpoolWriter::new(work.scratch, "triangle-counts", work.shares.triangle_counts);
    let mut corners = SpoolWriter::new(work.scratch, "triangles", work.shares.triangles);
    let mut places = SpoolWriter::new(work.scratch, "corner-places", work.shares.wedges);
    let mut next = sorted.next()?;
    for leaf in 0..work.leaf_count {
        let mut count = 0;
        while let Some(triangle) = next.filter(|triangle| triangle.split() == leaf) {
            corners.push(triangle.corners())?;
            if with_places {
                places.push(triangle.places())?;
            }
            count += 1;
            next = sorted.next()?;
            work.step();
        }
        counts.push(count)?;
    }
    Ok(Born { counts: counts.finish()?, corners: corners.finish()?, places: places.finish()? })
}
