//! The triangles, grouped by the split at which they are born, in leaf order: each turned so that its first corner lies
//! under the kept child, sorted within a split. One external sort of 16-byte records.
//!
//! Which corner that is follows from the born leaf `m` alone: *the largest of those below `m`*. For let the split's node
//! have the leaves `s..e`, its kept child `s..m`, its born child `m..e`. The triangle died when the two children became
//! one, so exactly one corner `k` lies in `s..m`, exactly one in `m..e`, and the third outside `s..e`, that is below `s`
//! and so below `k`, or not below `e` and so not below `m`.

use bytemuck::{Pod, Zeroable};
use storage::{PagedArray, Scattered, SortRecord, Sorted, Sorter, Spool, SpoolWriter};

use super::{FinishError, Work};

/// A triangle with the split that bears it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub(super) struct BornTriangle {
    split: u32,
    corners: [u32; 3],
}

impl SortRecord for BornTriangle {
    #[inline]
    fn prefix(&self) -> u64 {
        u64::from(self.split) << 32 | u64::from(self.corners[0])
    }
}

/// Sorts the canonical triangles by the split that bears them. `deaths` has, for each of them, the vertex whose going it
/// died of.
pub(super) fn sort(
    triangles: Spool<[u32; 3]>,
    mut deaths: Scattered<u32>,
    mut leaf_of: PagedArray,
    work: &mut Work<'_>,
) -> Result<Sorted<BornTriangle>, FinishError> {
    let mut sorter = Sorter::new(work.scratch, "born-triangles", work.shares.born_triangles, work.threads);
    let mut number = 0;
    {
        let mut reader = triangles.reader(work.shares.input);
        while let Some(corners) = reader.next()? {
            let Some(death) = deaths.next()?.filter(|death| *death < work.leaf_count) else {
                return Err(FinishError::Triangle { triangle: number, problem: "it did not die" });
            };
            let split = leaf_of.get(death)?;
            let [a, b, c] = corners;
            let corners = [leaf_of.get(a)?, leaf_of.get(b)?, leaf_of.get(c)?];
            let Some(corners) = kept_corner_first(corners, split) else {
                let problem = "none of its leaves comes before the one that went when it died";
                return Err(FinishError::Triangle { triangle: number, problem });
            };
            sorter.push(BornTriangle { split, corners })?;
            number += 1;
            work.step();
        }
    }
    drop((triangles, deaths, leaf_of));
    Ok(sorter.finish()?)
}

/// Turns a triangle so that its first corner lies under the kept child of the split that bears it.
#[inline]
fn kept_corner_first([a, b, c]: [u32; 3], split: u32) -> Option<[u32; 3]> {
    // One more than the leaf where it is below the split's, so that 0 is for the others.
    let below = |leaf: u32| if leaf < split { leaf + 1 } else { 0 };
    let largest = below(a).max(below(b)).max(below(c));
    match largest {
        0 => None,
        _ if largest == a + 1 => Some([a, b, c]),
        _ if largest == b + 1 => Some([b, c, a]),
        _ => Some([c, a, b]),
    }
}

/// For each leaf how many triangles its split bears, and their corners.
pub(super) fn write(
    mut sorted: Sorted<BornTriangle>,
    work: &mut Work<'_>,
) -> Result<(Spool<u32>, Spool<[u32; 3]>), FinishError> {
    let mut counts = SpoolWriter::new(work.scratch, "triangle-counts", work.shares.triangle_counts);
    let mut triangles = SpoolWriter::new(work.scratch, "triangles", work.shares.triangles);
    let mut next = sorted.next()?;
    for leaf in 0..work.leaf_count {
        let mut count = 0;
        while let Some(triangle) = next.filter(|triangle| triangle.split == leaf) {
            triangles.push(triangle.corners)?;
            count += 1;
            next = sorted.next()?;
            work.step();
        }
        counts.push(count)?;
    }
    Ok((counts.finish()?, triangles.finish()?))
}
