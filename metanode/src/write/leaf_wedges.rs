//! The wedges of a stored tree, looked up through caches: those of a leaf, and those of a triangle's corners.
//!
//! Memory: the caches. I/O: wedges, and with seams where they begin, once for the density of the texture; all of it once more for
//! every way through the pages.

use storage::Spool;
use vdt::tree::{CornerPlaces, StoredTree, TreeAttributes, TreeSeams, Wedge, WedgeNode};

use super::WriteError;
use crate::blocking::BlockingError;
use crate::codec::{KnownWedge, logarithm};
use crate::leaf_order::Cache;
use crate::page::NONE_32;
use crate::wedges::{PlacedWedge, RootWedges};

/// Looks up wedges.
pub(super) struct LeafWedges<'a> {
    wedges: Cache<&'a Spool<Wedge>>,
    seams: Option<Seams<'a>>,
}

struct Seams<'a> {
    wedge_count: u32,
    leaf_count: u64,
    first_wedges: Cache<&'a Spool<u32>>,
    nodes: Cache<&'a Spool<WedgeNode>>,
    corners: Cache<&'a Spool<CornerPlaces>>,
}

impl<'a> LeafWedges<'a> {
    /// Within about three times so many bytes.
    pub fn new(attributes: &'a TreeAttributes, ram_bytes: usize) -> Self {
        let of_seams = |seams: &'a TreeSeams| Seams {
            wedge_count: attributes.wedges.len() as u32,
            leaf_count: seams.first_wedges.len(),
            first_wedges: Cache::new(&seams.first_wedges, ram_bytes / 4),
            nodes: Cache::new(&seams.nodes, ram_bytes / 4 * 3),
            corners: Cache::new(&seams.corners, ram_bytes),
        };
        LeafWedges { wedges: Cache::new(&attributes.wedges, ram_bytes), seams: attributes.seams.as_ref().map(of_seams) }
    }

    /// The wedge of a leaf of a tree without seams.
    pub fn wedge(&mut self, leaf: u32) -> Result<Wedge, WriteError> {
        Ok(self.wedges.get(leaf)?)
    }

    /// Appends the wedges of a leaf.
    pub fn of_leaf(&mut self, leaf: u32, wedges: &mut Vec<KnownWedge>) -> Result<(), WriteError> {
        let Some(seams) = &mut self.seams else {
            let wedge = self.wedges.get(leaf)?;
            wedges.push(KnownWedge { placed: PlacedWedge { wedge, number: leaf, end: leaf + 1 }, image: 0 });
            return Ok(());
        };
        let (first, end) = seams.range(leaf)?;
        for place in first..end {
            let WedgeNode { number, end, image } = seams.nodes.get(place)?;
            let wedge = self.wedges.get(place)?;
            wedges.push(KnownWedge { placed: PlacedWedge { wedge, number, end }, image });
        }
        Ok(())
    }

    /// The numbers of the wedges of the corners of a triangle.
    pub fn of_corners(&mut self, triangle: u32, leaves: [u32; 3]) -> Result<[u32; 3], WriteError> {
        let Some(seams) = &mut self.seams else { return Ok(leaves) };
        let mut numbers = seams.corners.get(triangle)?.places();
        for (place, leaf) in numbers.iter_mut().zip(leaves) {
            let (first, end) = seams.range(leaf)?;
            let Some(wedge) = first.checked_add(*place).filter(|wedge| *wedge < end) else {
                let problem = format!("triangle {triangle} has wedge {place} of leaf {leaf}, of {}", end - first);
                return Err(BlockingError::Tree { problem }.into());
            };
            *place = seams.nodes.get(wedge)?.number;
        }
        Ok(numbers)
    }
}

impl Seams<'_> {
    /// The places of the wedges of a leaf among all.
    fn range(&mut self, leaf: u32) -> Result<(u32, u32), WriteError> {
        let first = self.first_wedges.get(leaf)?;
        let end = match u64::from(leaf) + 1 < self.leaf_count {
            true => self.first_wedges.get(leaf + 1)?,
            false => self.wedge_count,
        };
        if first < end && end <= self.wedge_count {
            return Ok((first, end));
        }
        let problem = format!("leaf {leaf} has the wedges {first}..{end} of {}", self.wedge_count);
        Err(BlockingError::Tree { problem }.into())
    }
}

/// Whether there are as many of everything as there must be.
pub(super) fn check(tree: &StoredTree) -> Result<(), BlockingError> {
    let Some(attributes) = &tree.attributes else { return Ok(()) };
    let (leaves, wedges) = (tree.leaf_count(), attributes.wedges.len());
    let fits = match &attributes.seams {
        None => wedges == leaves,
        Some(TreeSeams { first_wedges, nodes, corners }) => {
            wedges < u64::from(NONE_32)
                && first_wedges.len() == leaves
                && nodes.len() == wedges
                && corners.len() == tree.triangles.len()
        }
    };
    if fits && !attributes.appearance.kinds.is_empty() {
        return Ok(());
    }
    Err(BlockingError::Tree { problem: format!("{wedges} wedges do not belong to {leaves} leaves, or are none") })
}

/// The wedges of the first leaves of all trees.
pub(super) fn of_roots(tree: &StoredTree) -> Result<RootWedges, WriteError> {
    let mut found = RootWedges::default();
    let Some(attributes) = &tree.attributes else { return Ok(found) };
    let mut lookup = LeafWedges::new(attributes, 0);
    let mut wedges = Vec::new();
    for root in &tree.roots {
        wedges.clear();
        lookup.of_leaf(root.start, &mut wedges)?;
        found.push(root.start, wedges.iter().map(|known| known.placed));
    }
    Ok(found)
}

/// How long ways in the texture are for those in the mesh: from each leaf to the next, which is near it, on average.
pub(super) fn texture_density(tree: &StoredTree) -> Result<i32, WriteError> {
    const BUFFER: usize = 256 << 10;
    let Some(attributes) = tree.attributes.as_ref().filter(|attributes| attributes.appearance.kinds.textures) else {
        return Ok(0);
    };
    let mut positions = tree.positions.reader(BUFFER);
    let mut wedges = attributes.wedges.reader(BUFFER);
    let mut firsts = attributes.seams.as_ref().map(|seams| seams.first_wedges.reader(BUFFER));
    let (mut next, mut before) = (0, None);
    let (mut sum, mut count) = (0_i64, 0_i64);
    while let Some(position) = positions.next()? {
        let first = match &mut firsts {
            Some(firsts) => firsts.next()?.unwrap_or(u32::MAX),
            None => next,
        };
        let mut texture = [0; 2];
        while next <= first {
            let Some(wedge) = wedges.next()? else { break };
            (texture, next) = (wedge.texture, next + 1);
        }
        if let Some((last, at)) = before.replace((position, texture)) {
            let (last, at): ([f32; 3], [i32; 2]) = (last, at);
            let square: f32 = (0..3).map(|axis| (position[axis] - last[axis]) * (position[axis] - last[axis])).sum();
            let steps: f32 = (0..2).map(|axis| (texture[axis] as f32 - at[axis] as f32).powi(2)).sum();
            if square > 0.0 && steps > 0.0 {
                (sum, count) = (sum + i64::from(logarithm(steps)) - i64::from(logarithm(square)), count + 1);
            }
        }
    }
    Ok(if count == 0 { 0 } else { (sum / count) as i32 })
}
