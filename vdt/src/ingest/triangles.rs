//! The triangles in canonical order, in blocks; and the vertices that none of them uses.
//!
//! I/O: 12 bytes for each triangle written and read by the sort, 12 written once more. Two rare things cost a pass over
//! the triangles each: a block with far more triangles than it should have, and a window of marks that does not hold all
//! vertices, where there were degenerate triangles.

use bytemuck::{Pod, Zeroable};
use storage::{Scratch, SortRecord, Sorted, SpoolWriter, StorageError};

use super::blocks::BlockRefiner;
use super::limits::{Kept, Limits};
use super::marks::{MarkWindow, Marks};
use super::progress::Progress;
use super::seams::{Tiler, Tiling};
use super::wedges::{UsedWedges, UsedWedgesWriter};

/// A triangle on its way into canonical order: its corners' ids, the smallest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(transparent)]
pub(super) struct Corners([u32; 3]);

impl Corners {
    /// Turned so that the smallest corner comes first; none if two corners are equal.
    #[inline]
    pub fn of([a, b, c]: [u32; 3]) -> Option<Corners> {
        let corners = if a < b && a < c {
            [a, b, c]
        } else if b < c {
            [b, c, a]
        } else {
            [c, a, b]
        };
        (a != b && b != c && c != a).then_some(Corners(corners))
    }
}

impl SortRecord for Corners {
    #[inline]
    fn prefix(&self) -> u64 {
        u64::from(self.0[0]) << 32 | u64::from(self.0[1])
    }
}

/// The same with the numbers of its corners' wedges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub(super) struct WedgeCorners {
    corners: Corners,
    wedges: [u32; 3],
}

impl WedgeCorners {
    /// Turned so that the smallest corner comes first; none if two corners are equal.
    #[inline]
    pub fn of(vertices: [u32; 3], mut wedges: [u32; 3]) -> Option<WedgeCorners> {
        let corners = Corners::of(vertices)?;
        let turn = vertices.iter().position(|vertex| *vertex == corners.0[0]).unwrap_or(0);
        wedges.rotate_left(turn);
        Some(WedgeCorners { corners, wedges })
    }
}

impl SortRecord for WedgeCorners {
    #[inline]
    fn prefix(&self) -> u64 {
        self.corners.prefix()
    }
}

/// A triangle that can be brought into canonical order.
pub(super) trait SortedTriangle: SortRecord {
    /// Whether it has wedges.
    const HAS_WEDGES: bool;
    /// The ids of its corners.
    fn vertices(&self) -> [u32; 3];
    /// The numbers of the wedges of its corners; zeros without.
    fn wedges(&self) -> [u32; 3];
}

impl SortedTriangle for Corners {
    const HAS_WEDGES: bool = false;

    #[inline]
    fn vertices(&self) -> [u32; 3] {
        self.0
    }

    #[inline]
    fn wedges(&self) -> [u32; 3] {
        [0; 3]
    }
}

impl SortedTriangle for WedgeCorners {
    const HAS_WEDGES: bool = true;

    #[inline]
    fn vertices(&self) -> [u32; 3] {
        self.corners.0
    }

    #[inline]
    fn wedges(&self) -> [u32; 3] {
        self.wedges
    }
}

/// The triangles in their final order.
#[derive(Debug)]
pub(super) struct Ordered {
    pub triangles: Kept<[u32; 3]>,
    /// The wedges of their corners, where they have some.
    pub wedges: Option<UsedWedges>,
    pub tiling: Tiling,
    /// Triangles that were there before.
    pub duplicates: u64,
    /// The vertices that triangles use, if it was asked for them.
    pub used: Option<Marks>,
}

/// Takes the triangles as they come from the sort. `blocks` are the first vertices of the blocks, `vertices` is the
/// number of all vertices, `left` are the bytes of RAM to share; `mark_used` asks for the vertices that are used.
#[expect(clippy::too_many_arguments, reason = "the state of the pipeline")]
pub(super) fn order<T: SortedTriangle>(
    mut sorted: Sorted<T>,
    blocks: &[u32],
    vertices: u32,
    mark_used: bool,
    scratch: &Scratch,
    limits: &Limits,
    left: usize,
    progress: &mut Progress<'_>,
) -> Result<Ordered, StorageError> {
    let share = (left / 2).min(limits.memory / 4);
    let mut triangles = SpoolWriter::new(scratch, "triangles", share);
    let mut tiler = Tiler::new(blocks, vertices, scratch, limits, left);
    let mut refiner = BlockRefiner::new(blocks, limits.block_triangles);
    let mut used = mark_used.then(|| MarkWindow::new(left / 8));
    let mut wedges = T::HAS_WEDGES.then(|| UsedWedgesWriter::new(scratch, left));
    let (all, mut taken, mut last) = (sorted.len(), 0, None);
    while let Some(triangle) = sorted.next()? {
        let corners = triangle.vertices();
        taken += 1;
        progress.count(taken, all);
        if last == Some(corners) {
            continue;
        }
        last = Some(corners);
        triangles.push(corners)?;
        if let Some(wedges) = &mut wedges {
            wedges.push(triangle.wedges())?;
        }
        refiner.push(corners[0]);
        tiler.push(corners)?;
        if let Some(used) = &mut used {
            corners.iter().for_each(|corner| used.mark(u64::from(*corner)));
        }
    }
    drop(sorted);
    let duplicates = taken - triangles.len();
    let triangles = Kept::finish(triangles, share)?;
    let refined = refiner.finish();
    let tiling = if refined.len() == blocks.len() {
        tiler.finish()?
    } else {
        drop(tiler);
        let mut tiler = Tiler::new(&refined, vertices, scratch, limits, left);
        let mut reader = triangles.spool.reader(limits.buffer());
        while let Some(corners) = reader.next()? {
            tiler.push(corners)?;
        }
        tiler.finish()?
    };
    let mark_again = |window: &mut MarkWindow| {
        let mut reader = triangles.spool.reader(limits.buffer());
        while let Some(corners) = reader.next()? {
            corners.iter().for_each(|corner| window.mark(u64::from(*corner)));
        }
        Ok::<_, StorageError>(())
    };
    let used = match used {
        Some(window) => Some(window.complete(u64::from(vertices), scratch, "used-vertices", left / 16, mark_again)?),
        None => None,
    };
    let wedges = wedges.map(UsedWedgesWriter::finish).transpose()?;
    Ok(Ordered { triangles, wedges, tiling, duplicates, used })
}
