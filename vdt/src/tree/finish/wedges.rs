//! Wedges in leaf order, and the forest that they make, in depth-first order as the leaves are.
//!
//! Where each vertex has one wedge, wedges are only moved to the places of their leaves. Else they are sorted by leaf, and so are
//! their images; and then two passes over the leaves number them:
//!
//! 1. From the last leaf to the first, how many wedges turn into each: one, and those of the wedges whose image it is, all of
//!    which belong to later leaves. Leaves under one another are nested intervals, so what waits is a stack.
//! 2. From the first to the last, numbers: behind that of its image, and behind all that turned into the image deeper down the
//!    tree, which are those of earlier leaves.
//!
//! Memory: shares of the build's, and in either pass 4 bytes for each wedge of the leaves under which one leaf is. I/O: 28 bytes
//! for each wedge and 12 for each image by the sorts, 28 more by the passes.

use bytemuck::{Pod, Zeroable};
use storage::{PagedArray, Scatter, Scattered, SortRecord, Sorted, Sorter, Spool, SpoolWriter, StorageError};

use super::{FinishError, UNNUMBERED, Work};
use crate::simplify::log::WedgeImage;
use crate::tree::attributes::{MOST_WEDGES, MeshSeams, TreeAttributes, TreeSeams, Wedge, WedgeNode};
use crate::tree::{MeshAttributes, Root};

/// A wedge on its way to its leaf.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct LeafWedge {
    leaf: u32,
    place: u32,
    wedge: [u32; 5],
}

impl SortRecord for LeafWedge {
    fn prefix(&self) -> u64 {
        u64::from(self.leaf) << 32 | u64::from(self.place)
    }
}

/// An image on its way to the leaf of its wedge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct LeafImage {
    leaf: u32,
    place: u32,
    image: u32,
}

impl SortRecord for LeafImage {
    fn prefix(&self) -> u64 {
        u64::from(self.leaf) << 32 | u64::from(self.place)
    }
}

/// Brings the wedges of a mesh to its leaves, of which the triangles' corners are still to come.
///
/// `keepers` has for each leaf that onto which it is collapsed, and for the first one of a tree that itself; only where there are
/// seams.
pub(super) fn in_leaf_order(
    attributes: MeshAttributes,
    images: Spool<WedgeImage>,
    keepers: Option<Scattered<u32>>,
    roots: &[Root],
    leaf_of: &mut PagedArray,
    work: &mut Work<'_>,
) -> Result<TreeAttributes, FinishError> {
    let MeshAttributes { appearance, wedges, seams } = attributes;
    let (Some(seams), Some(keepers)) = (seams, keepers) else {
        let wedges = one_each(wedges, leaf_of, work)?;
        return Ok(TreeAttributes { appearance, wedges, seams: None });
    };
    let sorted = sort_wedges(&wedges, &seams, leaf_of, work)?;
    let sorted_images = sort_images(&images, leaf_of, work)?;
    drop((wedges, images));
    let ByLeaf { wedges, first_wedges, images } = by_leaf(sorted, sorted_images, work)?;
    let mut kept = SpoolWriter::new(work.scratch, "keepers", work.shares.wedges);
    let mut keepers = keepers;
    while let Some(keeper) = keepers.next()? {
        kept.push(keeper)?;
    }
    let keepers = kept.finish()?;
    let sizes = sizes(&first_wedges, wedges.len(), &images, &keepers, work)?;
    let nodes = number(&first_wedges, &images, &keepers, sizes, roots, work)?;
    let corners = Spool::from_vec(Vec::new());
    Ok(TreeAttributes { appearance, wedges, seams: Some(TreeSeams { first_wedges, nodes, corners }) })
}

/// Wedges by leaf, where each vertex has one.
fn one_each(wedges: Spool<Wedge>, leaf_of: &mut PagedArray, work: &mut Work<'_>) -> Result<Spool<Wedge>, FinishError> {
    let mut moved = Scatter::new(work.scratch, "wedges-by-leaf", work.leaf_count.into(), work.shares.moved_positions);
    let mut reader = wedges.reader(work.shares.input);
    let mut vertex = 0;
    while let Some(wedge) = reader.next()? {
        moved.put(leaf(leaf_of, vertex)?, wedge)?;
        vertex += 1;
    }
    drop(reader);
    drop(wedges);
    if vertex != work.leaf_count {
        return Err(FinishError::Wedges { vertex, problem: "there is not one wedge for each vertex" });
    }
    let mut moved = moved.finish()?;
    let mut ordered = SpoolWriter::new(work.scratch, "wedges", work.shares.wedges);
    while let Some(wedge) = moved.next()? {
        ordered.push(wedge)?;
    }
    Ok(ordered.finish()?)
}

/// The leaf of a vertex.
fn leaf(leaf_of: &mut PagedArray, vertex: u32) -> Result<u32, FinishError> {
    match leaf_of.get(vertex)? {
        UNNUMBERED => Err(FinishError::Vertex { vertex }),
        leaf => Ok(leaf),
    }
}

fn sort_wedges(
    wedges: &Spool<Wedge>,
    seams: &MeshSeams,
    leaf_of: &mut PagedArray,
    work: &mut Work<'_>,
) -> Result<Sorted<LeafWedge>, FinishError> {
    let share = work.shares.moved_positions;
    let mut sorter = Sorter::new(work.scratch, "wedges-by-leaf", share, work.threads);
    let mut firsts = seams.first_wedges.reader(work.shares.input / 2);
    let mut reader = wedges.reader(work.shares.input / 2);
    let wrong = |vertex| FinishError::Wedges { vertex, problem: "it has none, or more than can be" };
    let mut next_first = firsts.next()?;
    let mut index = 0;
    for vertex in 0..work.leaf_count {
        let first = next_first.ok_or(wrong(vertex))?;
        next_first = firsts.next()?;
        let end = next_first.map_or(wedges.len(), u64::from);
        let count = end.saturating_sub(first.into());
        if u64::from(first) != index || count == 0 || count > MOST_WEDGES as u64 {
            return Err(wrong(vertex));
        }
        let leaf = leaf(leaf_of, vertex)?;
        for place in 0..count as u32 {
            let wedge = reader.next()?.ok_or(wrong(vertex))?;
            sorter.push(LeafWedge { leaf, place, wedge: bytemuck::cast(wedge) })?;
        }
        index = end;
    }
    if index != wedges.len() {
        let problem = "there are wedges behind its own, which is the last";
        return Err(FinishError::Wedges { vertex: work.leaf_count.saturating_sub(1), problem });
    }
    Ok(sorter.finish()?)
}

fn sort_images(
    images: &Spool<WedgeImage>,
    leaf_of: &mut PagedArray,
    work: &mut Work<'_>,
) -> Result<Sorted<LeafImage>, FinishError> {
    let mut sorter = Sorter::new(work.scratch, "images-by-leaf", work.shares.wedges, 1);
    let mut reader = images.reader(work.shares.input);
    while let Some(WedgeImage { born, wedge, image }) = reader.next()? {
        if born >= work.leaf_count {
            return Err(FinishError::Wedges { vertex: born, problem: "there is no such vertex" });
        }
        sorter.push(LeafImage { leaf: leaf(leaf_of, born)?, place: wedge.into(), image: image.into() })?;
    }
    Ok(sorter.finish()?)
}

/// What was sorted by leaf.
struct ByLeaf {
    wedges: Spool<Wedge>,
    first_wedges: Spool<u32>,
    /// The image of each wedge; 0 where none is noted.
    images: Spool<u32>,
}

fn by_leaf(
    mut sorted: Sorted<LeafWedge>,
    mut sorted_images: Sorted<LeafImage>,
    work: &mut Work<'_>,
) -> Result<ByLeaf, FinishError> {
    let share = work.shares.wedges;
    let mut wedges = SpoolWriter::new(work.scratch, "wedges", share);
    let mut first_wedges = SpoolWriter::new(work.scratch, "first-wedges", share);
    let mut images = SpoolWriter::new(work.scratch, "images", share);
    let mut next_image = sorted_images.next()?;
    while let Some(LeafWedge { leaf, place, wedge }) = sorted.next()? {
        if place == 0 {
            first_wedges.push(wedges.len() as u32)?;
        }
        let image = next_image.filter(|image| (image.leaf, image.place) == (leaf, place));
        if image.is_some() {
            next_image = sorted_images.next()?;
        }
        images.push(image.map_or(0, |image| image.image))?;
        wedges.push(bytemuck::cast(wedge))?;
    }
    if let Some(LeafImage { leaf, .. }) = next_image {
        return Err(FinishError::WedgeForest {
            leaf,
            problem: "an image of a wedge that it does not have, or a second one",
        });
    }
    Ok(ByLeaf { wedges: wedges.finish()?, first_wedges: first_wedges.finish()?, images: images.finish()? })
}

/// Reads a spool from its end.
struct Backward<'a, T> {
    spool: &'a Spool<T>,
    /// Records `start..start + buffer.len()`, of which the last have been taken.
    buffer: Vec<T>,
    start: u64,
}

/// Records that are read at once.
const CHUNK: u64 = 4096;

impl<'a, T: Pod> Backward<'a, T> {
    fn new(spool: &'a Spool<T>) -> Self {
        Backward { spool, buffer: Vec::new(), start: spool.len() }
    }

    fn next(&mut self) -> Result<Option<T>, StorageError> {
        if self.buffer.is_empty() && self.start > 0 {
            let end = self.start;
            self.start = end.saturating_sub(CHUNK);
            self.buffer.resize((end - self.start) as usize, T::zeroed());
            self.spool.read_at(self.start, &mut self.buffer)?;
        }
        Ok(self.buffer.pop())
    }
}

/// How many wedges turn into each wedge, itself among them; those of the last leaf first, and of a leaf the last one first.
fn sizes(
    first_wedges: &Spool<u32>,
    wedge_count: u64,
    images: &Spool<u32>,
    keepers: &Spool<u32>,
    work: &mut Work<'_>,
) -> Result<Spool<u32>, FinishError> {
    let mut sizes = SpoolWriter::new(work.scratch, "wedge-sizes", work.shares.wedges);
    let (mut firsts, mut images) = (Backward::new(first_wedges), Backward::new(images));
    let mut keepers = Backward::new(keepers);
    // Leaves that have not been reached but onto which others are collapsed: where their sums begin in `sums`, which have one
    // for each image met so far.
    let mut waiting: Vec<(u32, usize)> = Vec::new();
    let mut sums: Vec<u32> = Vec::new();
    let mut own: Vec<u32> = Vec::new();
    let mut end = wedge_count;
    for leaf in (0..work.leaf_count).rev() {
        let wrong = FinishError::WedgeForest { leaf, problem: "its wedges are not where they should be" };
        let (Some(first), Some(keeper)) = (firsts.next()?, keepers.next()?) else { return Err(wrong) };
        let count = (end - u64::from(first)) as usize;
        end = first.into();
        own.clear();
        own.resize(count, 1);
        if let Some((_, start)) = waiting.pop_if(|(waits, _)| *waits == leaf) {
            if sums.len() - start > count {
                return Err(FinishError::WedgeForest { leaf, problem: "it has fewer wedges than others turn into" });
            }
            own.iter_mut().zip(&sums[start..]).for_each(|(size, sum)| *size += sum);
            sums.truncate(start);
        }
        let start = match waiting.last() {
            _ if keeper == leaf => None,
            Some((waits, start)) if *waits == keeper => Some(*start),
            _ => {
                waiting.push((keeper, sums.len()));
                Some(sums.len())
            }
        };
        for size in own.iter().rev() {
            sizes.push(*size)?;
            let Some(image) = images.next()? else { return Err(wrong) };
            if let Some(start) = start {
                let place = start + image as usize;
                if image as usize >= MOST_WEDGES {
                    return Err(FinishError::WedgeForest { leaf, problem: "an image that there cannot be" });
                }
                if place >= sums.len() {
                    sums.resize(place + 1, 0);
                }
                sums[place] += size;
            }
        }
    }
    Ok(sizes.finish()?)
}

/// Numbers the wedges. `sizes` is what [`sizes`] has found.
fn number(
    first_wedges: &Spool<u32>,
    images: &Spool<u32>,
    keepers: &Spool<u32>,
    sizes: Spool<u32>,
    roots: &[Root],
    work: &mut Work<'_>,
) -> Result<Spool<WedgeNode>, FinishError> {
    let wedge_count = sizes.len();
    let mut nodes = SpoolWriter::new(work.scratch, "wedge-nodes", work.shares.wedges);
    let mut firsts = first_wedges.reader(work.shares.input / 2);
    let mut images = images.reader(work.shares.input / 4);
    let mut keepers = keepers.reader(work.shares.input / 4);
    let mut sizes = Backward::new(&sizes);
    // The leaves that are under way: where the next numbers for what turns into their wedges begin in `next`.
    let mut open: Vec<(u32, usize)> = Vec::new();
    let mut next: Vec<u32> = Vec::new();
    let mut next_first = firsts.next()?;
    let (mut next_of_trees, mut trees) = (0_u32, roots.iter().peekable());
    for leaf in 0..work.leaf_count {
        let wrong = FinishError::WedgeForest { leaf, problem: "its wedges are not where they should be" };
        let (Some(first), Some(keeper)) = (next_first, keepers.next()?) else { return Err(wrong) };
        next_first = firsts.next()?;
        let end = next_first.map_or(wedge_count, u64::from);
        let begins_tree = trees.next_if(|root| root.start == leaf).is_some();
        if begins_tree {
            open.clear();
            next.clear();
        }
        // What is nested deeper than the leaf onto which this one is collapsed is done.
        while !begins_tree && open.last().is_some_and(|(other, _)| *other != keeper) {
            if let Some((_, start)) = open.pop() {
                next.truncate(start);
            }
        }
        let image_start = open.last().map(|(_, start)| *start);
        let own = next.len();
        for _ in first.into()..end {
            let (Some(size), Some(image)) = (sizes.next()?, images.next()?) else { return Err(wrong) };
            let place = match image_start {
                None if begins_tree => &mut next_of_trees,
                None => {
                    return Err(FinishError::WedgeForest { leaf, problem: "it is under no other leaf of its tree" });
                }
                Some(start) => next[..own].get_mut(start + image as usize).ok_or(FinishError::WedgeForest {
                    leaf,
                    problem: "an image that the leaf onto which it is collapsed does not have",
                })?,
            };
            let number = *place;
            *place += size;
            nodes.push(WedgeNode { number, end: number + size, image })?;
            next.push(number + 1);
        }
        open.push((leaf, own));
    }
    Ok(nodes.finish()?)
}
