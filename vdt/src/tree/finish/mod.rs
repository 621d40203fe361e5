//! From the log of collapses to the stored tree, in external memory: numbering, leaf intervals, born triangles.
//!
//! - Leaves are renumbered in depth-first order of the forest, the kept child first; trees by their root's canonical id.
//! - Dependency ids are those of the log; the switch value of a split follows from its id (`order`).
//! - A triangle is born at the split that undoes the collapse at which it died: the deepest node that holds two of its
//!   corners.
//!
//! | step | from | to |
//! |---|---|---|
//! | `numbering` | the log, read from its end | leaf of each vertex; splits, by leaf |
//! | here | splits | [`StoredTree::splits`], with their cones turned outward |
//! | here | positions, leaf of each vertex | [`StoredTree::positions`] |
//! | `born_triangles` | triangles and deaths, leaf of each vertex | [`StoredTree::triangles`] and their counts |
//!
//! Everything is streamed, put in place by dense keys or sorted, so nothing takes RAM in proportion to the mesh but the
//! roots: 32 bytes for each component, on top of `memory` (as the engine's are). Of `memory`, the leaves of the vertices
//! take more than half, from the first step to the last (looked up at random, it is what thrashes first); the finished
//! tree takes up to an eighth, and may keep it in RAM; each step shares the rest ([`Shares`]). What the mesh and the log hold in RAM is theirs, and not counted; each part is
//! dropped as soon as it was read. Where everything fits, no disk is touched.
//!
//! I/O where nothing fits, in bytes for each triangle of a mesh with two triangles for each vertex:
//!
//! | | read | written |
//! |---|---|---|
//! | log, deaths, positions, triangles | 44 | |
//! | leaf of each vertex, where segments of the log are local | 6 | 4 |
//! | splits, positions, put in place (with their keys) | 24 | 24 |
//! | born triangles, sorted in one merge | 16 | 16 |
//! | the tree | | 34 |
//!
//! In all 168, and 64 on disk at the peak (at the end of the numbering, 44 of them the input).

mod born_triangles;
mod numbering;
mod wedges;

use std::sync::{Mutex, PoisonError};

use storage::{ByteSize, PagedArray, Scatter, Scattered, Scratch, Spool, SpoolWriter, StorageError};
use thiserror::Error;

use super::record::{NormalCone, Root, Split};
use super::stored::StoredTree;
use crate::ingest::StoredMesh;
use crate::simplify::log::{LoggedRoot, Simplified};

/// Why a log of collapses does not make a tree, or could not be read.
#[derive(Debug, Error)]
pub enum FinishError {
    /// The disk failed.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// Not as many collapses and roots as vertices, or too many to be numbered.
    #[error("{vertices} vertices, {collapses} collapses and {roots} roots: they do not add up, or are more than 2^31")]
    Count {
        /// Vertices of the mesh.
        vertices: u64,
        /// Collapses of the log.
        collapses: u64,
        /// Roots that were left.
        roots: u64,
    },
    /// The trees have to tile the leaves.
    #[error("root {root} (vertex {vertex}) has {leaves} leaves and a split at {split}: not a tree of this mesh")]
    Root {
        /// Which root.
        root: usize,
        /// Its canonical vertex.
        vertex: u32,
        /// How many leaves it is said to have.
        leaves: u32,
        /// Where its split is said to divide them.
        split: u32,
    },
    /// A collapse is not in its place of the log, or its node does not fit in its parent.
    #[error("collapse {collapse} of the log (vertex {born} onto {kept}): {problem}")]
    Collapse {
        /// Its index in the log.
        collapse: u64,
        /// The vertex that stays.
        kept: u32,
        /// The vertex that goes.
        born: u32,
        /// What does not fit.
        problem: &'static str,
    },
    /// A vertex is neither a root nor born by a collapse.
    #[error("vertex {vertex} is neither a root nor born by a collapse")]
    Vertex {
        /// Its canonical id.
        vertex: u32,
    },
    /// A vertex has not the wedges that it must have.
    #[error("the wedges of vertex {vertex}: {problem}")]
    Wedges {
        /// Its canonical id.
        vertex: u32,
        /// What does not fit.
        problem: &'static str,
    },
    /// The images of wedges do not make forests.
    #[error("the wedges of leaf {leaf}: {problem}")]
    WedgeForest {
        /// The leaf.
        leaf: u32,
        /// What does not fit.
        problem: &'static str,
    },
    /// A triangle cannot have died at the collapse that it is said to have died at.
    #[error("triangle {triangle}: {problem}")]
    Triangle {
        /// Its canonical number.
        triangle: u64,
        /// What does not fit.
        problem: &'static str,
    },
}

/// Makes the tree of a mesh from the log of its simplification.
///
/// `memory` bounds what the steps hold in RAM (see the module), not what `mesh` and `simplified` hold; `progress` is
/// called now and then with the share of the work that is done, 0 to 1. The tree depends on neither of `scratch`,
/// `memory` and `threads`.
///
/// # Errors
///
/// Those of the disk; [`FinishError`] where mesh and log do not belong together.
pub fn finish(
    mesh: StoredMesh,
    simplified: Simplified,
    scratch: &Scratch,
    memory: ByteSize,
    threads: usize,
    progress: &mut (dyn FnMut(f64) + Send),
) -> Result<StoredTree, FinishError> {
    let StoredMesh { positions, triangles, origin, exponent, lattice_step, mut attributes, .. } = mesh;
    let Simplified { log, deaths, roots, wedge_images, .. } = simplified;
    let (vertices, collapses) = (positions.len(), log.len());
    let wrong = FinishError::Count { vertices, collapses, roots: roots.len() as u64 };
    // No chain of so many collapses makes an id overflow.
    let leaf_count = match u32::try_from(vertices) {
        Ok(count) if count <= 1 << 31 && collapses + roots.len() as u64 == vertices => count,
        _ => return Err(wrong),
    };
    let total = 3 * vertices + 2 * triangles.len();
    // Corners stay beside the triangles, wedges go with the vertices.
    let corners = attributes.as_mut().and_then(|attributes| attributes.seams.as_mut());
    let corners = corners.map(|seams| std::mem::replace(&mut seams.corners, Spool::from_vec(Vec::new())));
    let mut shares = Shares::of(memory, vertices * size_of::<u32>() as u64, threads);
    if attributes.is_some() {
        shares = shares.with_wedges();
    }
    let report = Report { total, work: Mutex::new((0, progress)) };
    let work = Work { leaf_count, scratch, shares, threads, report: &report, done: 0 };

    let outward: Vec<i8> = roots.iter().map(|root| root.outward).collect();
    let mut leaf_of = PagedArray::new(scratch, "leaf-of-vertex", vertices, UNNUMBERED, work.shares.leaf_of)?;
    let roots = place_roots(&roots, leaf_count, &mut leaf_of)?;
    let mut keepers = corners.is_some().then(|| Scatter::new(scratch, "keepers-by-leaf", vertices, work.shares.wedges));
    if let Some(keepers) = &mut keepers {
        roots.iter().try_for_each(|root| keepers.put(root.start, root.start))?;
    }
    let splits = numbering::number(&log, &mut leaf_of, exponent, keepers.as_mut(), &mut work.clone())?;
    drop(log);
    let keepers = keepers.map(Scatter::finish).transpose()?;
    let complete = || complete_splits(splits, &roots, &outward, &mut work.clone());
    let bear = || {
        let work = &mut work.clone();
        let positions = in_leaf_order(positions, &mut leaf_of, work)?;
        let bring = |attributes| wedges::in_leaf_order(attributes, wedge_images, keepers, &roots, &mut leaf_of, work);
        let mut attributes = attributes.map(bring).transpose()?;
        let born = born_triangles::bear(triangles, corners, deaths, leaf_of, work)?;
        if let Some(seams) = attributes.as_mut().and_then(|attributes| attributes.seams.as_mut()) {
            seams.corners = born.places;
        }
        Ok((positions, attributes, born.counts, born.corners))
    };
    let (splits, born): (_, Result<_, FinishError>) = if work.shares.are_for_two {
        std::thread::scope(|scope| {
            let completed = scope.spawn(complete);
            let born = bear();
            (completed.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)), born)
        })
    } else {
        (complete(), bear())
    };
    let (splits, (positions, attributes, triangle_counts, triangles)) = (splits?, born?);
    Ok(StoredTree { positions, splits, triangle_counts, triangles, roots, origin, exponent, lattice_step, attributes })
}

/// What all steps are given.
#[derive(Clone)]
struct Work<'a> {
    leaf_count: u32,
    scratch: &'a Scratch,
    shares: Shares,
    threads: usize,
    report: &'a Report<'a>,
    /// Records done so far by this step.
    done: u64,
}

/// How far all steps are together.
struct Report<'a> {
    total: u64,
    /// Records done so far, and who is told.
    work: Mutex<(u64, &'a mut (dyn FnMut(f64) + Send))>,
}

impl Work<'_> {
    /// One record more is done: tells of it now and then.
    #[inline]
    fn step(&mut self) {
        self.done += 1;
        if self.done & 0xffff == 0 {
            self.tell();
        }
    }

    #[cold]
    fn tell(&self) {
        let (done, progress) = &mut *self.report.work.lock().unwrap_or_else(PoisonError::into_inner);
        *done += 0x1_0000;
        progress(*done as f64 / self.report.total as f64);
    }
}

/// In the table of leaves: a vertex whose leaf is not known yet.
const UNNUMBERED: u32 = u32::MAX;

/// Who gets how many bytes of RAM. A step begins when the one before it has let go of its share. Splits on the one
/// hand, positions and triangles on the other, have nothing to do with each other: with two threads they are done side by
/// side, where the table of leaves leaves enough for both.
///
/// | share | /16 of memory | side by side | held from | to |
/// |---|---|---|---|---|
/// | `leaf_of` | 9 | 6 | numbering | sorting of triangles |
/// | `log` | 1 | 1 | numbering | |
/// | `moved_splits` | 5 | 4 | numbering | completing of splits |
/// | `moved_positions` | 4 | 2 | positions | |
/// | `input` | 1 | 1 | positions | sorting of triangles |
/// | `born_triangles` | 4 | 3 | sorting of triangles | writing of triangles |
/// | the four of the finished tree | 2 | 2 | | the end |
#[derive(Clone, Copy)]
struct Shares {
    are_for_two: bool,
    leaf_of: usize,
    log: usize,
    moved_splits: usize,
    moved_positions: usize,
    input: usize,
    born_triangles: usize,
    splits: usize,
    positions: usize,
    triangles: usize,
    triangle_counts: usize,
    /// Of each sequence of wedges, where there are any.
    wedges: usize,
}

impl Shares {
    /// The same with room for wedges, by the sizes of what the finished tree has for them: 44 bytes for a leaf beside 68.
    fn with_wedges(self) -> Self {
        let of_tree = |share: usize| share / 112 * 68;
        let positions = of_tree(self.positions);
        Shares {
            splits: of_tree(self.splits),
            positions,
            triangles: of_tree(self.triangles),
            triangle_counts: of_tree(self.triangle_counts),
            wedges: positions / 12 * 20,
            ..self
        }
    }

    /// Of so much memory, where the table of leaves has so many bytes.
    fn of(memory: ByteSize, table_bytes: u64, threads: usize) -> Self {
        let are_for_two = threads > 1 && table_bytes <= memory.0 / 16 * 6;
        let memory = usize::try_from(memory.0).unwrap_or(usize::MAX);
        let share = |alone: usize, side_by_side: usize| memory / 16 * if are_for_two { side_by_side } else { alone };
        // By their sizes, with two triangles for each leaf: 28, 12, 24 and 4 bytes for a leaf.
        let of_tree = |bytes: usize| memory / 8 / 68 * bytes;
        Shares {
            are_for_two,
            leaf_of: share(9, 6),
            log: share(1, 1),
            moved_splits: share(5, 4),
            moved_positions: share(4, 2),
            input: share(1, 1),
            born_triangles: share(4, 3),
            splits: of_tree(28),
            positions: of_tree(12),
            triangles: of_tree(24),
            triangle_counts: of_tree(4),
            wedges: 0,
        }
    }
}

/// Lays the trees side by side, by ascending vertex of their roots.
fn place_roots(roots: &[LoggedRoot], leaf_count: u32, leaf_of: &mut PagedArray) -> Result<Vec<Root>, FinishError> {
    let mut placed = Vec::with_capacity(roots.len());
    let mut start = 0_u32;
    for (number, LoggedRoot { vertex, leaves, split, normal, outward }) in roots.iter().copied().enumerate() {
        let wrong = FinishError::Root { root: number, vertex, leaves, split };
        let is_last = number + 1 == roots.len();
        let end = start.checked_add(leaves).filter(|end| if is_last { *end == leaf_count } else { *end < leaf_count });
        let (Some(end), true) = (end, 0 < split && split < leaves && vertex < leaf_count) else {
            return Err(wrong);
        };
        placed.push(Root { start, end, split: start + split, normal, is_inward: outward < 0 });
        leaf_of.set(vertex, start)?;
        start = end;
    }
    Ok(placed)
}

/// Turns the cones of the splits outward, and marks the places that no split has.
fn complete_splits(
    mut splits: Scattered<Split>,
    roots: &[Root],
    outward: &[i8],
    work: &mut Work<'_>,
) -> Result<Spool<Split>, FinishError> {
    let mut completed = SpoolWriter::new(work.scratch, "splits", work.shares.splits);
    for (root, outward) in roots.iter().zip(outward) {
        for leaf in root.start..root.end {
            let Some(split) = splits.next()? else { break };
            completed.push(if leaf == root.start {
                Split::VACANT
            } else {
                let cone = match outward {
                    1 => split.cone,
                    -1 => split.cone.reversed(),
                    _ => NormalCone::EVERYTHING,
                };
                Split { cone, ..split }
            })?;
            work.step();
        }
    }
    Ok(completed.finish()?)
}

/// Positions by leaf, from positions by canonical id.
fn in_leaf_order(
    positions: Spool<[f32; 3]>,
    leaf_of: &mut PagedArray,
    work: &mut Work<'_>,
) -> Result<Spool<[f32; 3]>, FinishError> {
    let mut moved = Scatter::new(work.scratch, "positions-by-leaf", positions.len(), work.shares.moved_positions);
    {
        let mut reader = positions.reader(work.shares.input);
        let mut vertex = 0;
        while let Some(position) = reader.next()? {
            match leaf_of.get(vertex)? {
                UNNUMBERED => return Err(FinishError::Vertex { vertex }),
                leaf => moved.put(leaf, position)?,
            }
            vertex += 1;
            work.step();
        }
    }
    drop(positions);
    let mut moved = moved.finish()?;
    let mut ordered = SpoolWriter::new(work.scratch, "positions", work.shares.positions);
    while let Some(position) = moved.next()? {
        ordered.push(position)?;
    }
    Ok(ordered.finish()?)
}
