//! Spanned sub-meshes: the paper's order of collapses for a mesh larger than memory (the paper, 3.1.2).
//!
//! 1. All edges are sorted externally and put into a B-tree on disk ([`begin`], [`storage::EdgeTree`]); vertices and
//!    triangles lie in a store with random access ([`stored`]).
//! 2. Edges are deleted from the tree, cheapest first, as *spanning edges*; the sub-meshes that they span are loaded, with
//!    the stars that a collapse can change ([`loaded`]); until the memory is full. ℓ is the dearest of them ([`spanning`]).
//! 3. All edges up to ℓ are collapsed, those made on the way included, through one priority queue in memory.
//! 4. What was changed is written back; edges that are left over, or are to wait with a key above ℓ, are put into the
//!    tree; collapses go to the log.
//! 5. Again from 2, until all that is left fits in memory, where the queue goes on ([`finish`]).
//!
//! *The result is that of the queue in memory* (`queue`), decision for decision, whatever the memory and the tree:
//!
//! - *One queue.* At any moment the edges that wait are those in the tree and those in the queue in memory. In step 2 the
//!   tree's smallest move to the queue, so every edge in the tree is above ℓ, and in step 3 only edges above ℓ are put
//!   aside. So the next edge of step 3, which is at most ℓ, is the smallest of all that wait: the one that the queue in
//!   memory would hand out. When memory is full in the middle of step 3, what waits goes back to the tree: nothing else.
//! - *The same state.* A decision reads the stars of the two ends, their quadrics and nodes, the positions and quadrics of
//!   their neighbours, and the rejected edges of these. All of that is loaded before the decision, what was changed is
//!   written back whole, and what is not loaded was not changed, but for triangles that are marked as gone.
//! - *What is left out has no effect.* The queue in memory may hold an edge several times; the tree holds equal entries
//!   once, which is the same, as the second of two equal entries comes right after the first and finds the edge gone, or
//!   illegal for the same reasons. An entry whose key is below the edge's key of now is dropped, here and there. A key changes
//!   only when one of the ends takes over the quadric of another vertex; then the edge is put into the queue at its new key,
//!   in the cheaper direction. Until the old entry is taken out, nothing above it is, so that the new one is still there, or,
//!   if its key is that small, it was found illegal and waits in the dearer direction; or the edge is gone. Rounding may make
//!   keys shrink; then the old entry, above the key of now, is kept and tried at its turn.
//! - *Raised keys* (see `collapse`) are worked out when an entry's turn comes. It then waits with the raised key as its key,
//!   which only a key that has grown makes void. So what waits is the same, here and there, and so is what it waits for.
//!
//! So exterior boundary edges, those that touch a loaded sub-mesh but are not in the queue, are never below ℓ (paper).
//! Unlike in the paper, left-over edges are not deleted and put in again where they did not change. Entries that a
//! collapse makes void: those with an end that is gone are deleted from the tree in the same go in which edges are put in.
//! On a scan of 269 K triangles, that moves 2 % fewer bytes in 16 MiB and 7 % fewer in 32 MiB than to leave them, the
//! processor has no more to do, and the tree is never larger than at first by more than a fifteenth, else by a third. Those
//! whose key has grown stay until they are the tree's smallest, since by rounding the key may shrink again (see above).
//!
//! Memory: [`Shares`]. I/O: a page for each access of the tree and of the stores that is not in the cache, see
//! [`SpannedCounters`].

mod begin;
mod edges;
mod finish;
mod loaded;
mod spanning;
mod stored;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use storage::{ByteSize, Edge, EdgeTree, EdgeTreeError, EdgeTreeKind, Scratch, StorageError, Traffic};
use thiserror::Error;

use crate::ingest::StoredMesh;
use crate::tree::ErrorBound;

use super::collapse::Engine;
use super::components::Components;
use super::journal::Journal;
use super::live_mesh::{LiveMesh, Normalisation};
use super::live_wedges::Heeded;
use super::log::Simplified;
use super::metric::CollapseMetric;
use super::plan::{Carried, Plan};
use super::queue;
use loaded::{Standing, SubMeshes};
use spanning::{Spanned, Spanning};
use stored::MeshStore;

/// Advice on memory is given in whole ones.
const MEBIBYTE: u64 = 1 << 20;

/// How the memory is divided, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shares {
    /// All of it.
    pub memory: ByteSize,
    /// The cache of the edge tree.
    pub tree: u64,
    /// Pages of vertices and triangles.
    pub pages: u64,
    /// Sub-meshes, the queue, and the edges that are put aside.
    pub sub_meshes: u64,
    /// All that is left of the mesh, with its queue, for it to stay in memory.
    pub core: u64,
}

impl Shares {
    /// As measured: pages are read in order, and need little; sub-meshes are what there should be much of at a time. The
    /// mesh in the end has the memory of the tree and of the sub-meshes; an eighth is for the log, deaths and buffers.
    ///
    /// sled gets three quarters, so that there are meshes that fit in memory only with it, and not with their edges in a
    /// queue: those of more than about 2.3 million triangles. All else makes do with the rest.
    pub fn new(memory: ByteSize, kind: EdgeTreeKind) -> Self {
        let part = memory.0 / 32;
        match kind {
            EdgeTreeKind::Redb => {
                Shares { memory, tree: 8 * part, pages: 4 * part, sub_meshes: 14 * part, core: 22 * part }
            }
            EdgeTreeKind::Sled => {
                Shares { memory, tree: 24 * part, pages: 2 * part, sub_meshes: 3 * part, core: 22 * part }
            }
        }
    }

    /// A limit for the whole with which sub-meshes would get so many bytes.
    fn advice(&self, sub_meshes: u64) -> ByteSize {
        let ratio = self.memory.0 as f64 / self.sub_meshes.max(1) as f64;
        ByteSize(((sub_meshes as f64 * ratio) as u64).next_multiple_of(MEBIBYTE))
    }
}

/// Edges of a mesh of so many triangles: each is between two triangles, or has one of its own.
fn edges_of(triangles: u64) -> u64 {
    triangles.saturating_mul(3) / 2
}

/// The least memory in whole MiB with which a mesh of so many vertices and triangles can be simplified with sled: in its
/// tree, or with a queue in memory and without a tree.
pub(super) fn memory_for_sled(vertices: u64, triangles: u64, bound: ErrorBound) -> ByteSize {
    let needed = storage::edge_tree::sled_needs(edges_of(triangles)).0;
    // The mesh itself may be in RAM then, and takes what it takes from this.
    let mesh = vertices.saturating_add(triangles).saturating_mul(size_of::<[u32; 3]>() as u64);
    let does = |memory: u64| {
        let left = memory.saturating_sub(mesh);
        Shares::new(ByteSize(left), EdgeTreeKind::Sled).tree >= needed
            || Plan::new(left, 1, bound).queue_triangles >= triangles
    };
    let mut too_little = 0;
    for bit in (MEBIBYTE.ilog2()..u64::BITS).rev() {
        if !does(too_little + (1 << bit)) {
            too_little += 1 << bit;
        }
    }
    ByteSize(too_little.saturating_add(MEBIBYTE))
}

/// What it took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SpannedCounters {
    /// Bytes between RAM and the files of the edge tree.
    pub tree: Traffic,
    /// Bytes between RAM and the files of vertices and triangles.
    pub records: Traffic,
    /// How often steps 2 to 4 were done.
    pub loads: u64,
    /// Loads that had to end early, since edges made in step 3 needed more than what was left of the memory.
    pub cut_short: u64,
    /// Spanning edges of all loads.
    pub spanning_edges: u64,
    /// Sub-meshes of all loads.
    pub sub_meshes: u64,
    /// Triangles of the sub-meshes of all loads.
    pub sub_mesh_triangles: u64,
    /// Triangles of the largest sub-mesh.
    pub largest_sub_mesh: u64,
    /// Entries taken from the tree that were void.
    pub void_edges: u64,
    /// Entries deleted when they became void, before they were the smallest.
    pub removed_edges: u64,
    /// Edges put into the tree after the beginning.
    pub inserted_edges: u64,
    /// The most edges that the tree had.
    pub largest_tree: u64,
    /// Triangles that were left when the rest fitted in memory.
    pub core_triangles: u64,
}

/// Why spanned sub-meshes could not be simplified.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SpannedError {
    /// The disk failed or is full.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The tree of edges failed.
    #[error(transparent)]
    EdgeTree(#[from] EdgeTreeError),
    /// sled would need more memory than there is.
    #[error("{refusal}; use --edge-tree redb, or --memory {}", advice.as_argument())]
    SledMemory {
        /// What it would need.
        refusal: EdgeTreeError,
        /// What would do for all.
        advice: ByteSize,
    },
    /// One edge with its stars takes more than there is.
    #[error(
        "the edge between vertices {low} and {high} can only be collapsed with {triangles} triangles around it in memory, \
         which do not fit; run again with --memory {}",
        needed.as_argument()
    )]
    Star {
        /// One end of the edge, by its canonical id.
        low: u32,
        /// The other end.
        high: u32,
        /// Triangles that are needed.
        triangles: u64,
        /// What would do.
        needed: ByteSize,
    },
    /// A part that no legal collapse reduces takes more than there is.
    #[error(
        "a connected part of the mesh has {triangles} triangles left that no legal collapse reduces; they take {needed} in \
         memory, where {share} bytes are free; run again with more --memory"
    )]
    Component {
        /// Its triangles.
        triangles: u64,
        /// What they take.
        needed: ByteSize,
        /// What there is, in bytes.
        share: u64,
    },
}

/// What a simplification works with.
pub(super) struct Task<'a, M> {
    pub mesh: &'a StoredMesh,
    pub metric: M,
    pub bound: ErrorBound,
    pub kind: EdgeTreeKind,
    pub shares: Shares,
    pub scratch: &'a Scratch,
}

impl<M: CollapseMetric> Task<'_, M> {
    fn normalisation(&self) -> Normalisation {
        Normalisation::new(self.mesh.exponent)
    }

    /// What the mesh carries in memory.
    fn carried(&self) -> Carried {
        Carried::of(self.mesh, self.bound)
    }

    /// An engine without a mesh.
    fn engine(&self) -> Engine<M> {
        let heeded = Heeded::of(self.mesh.attributes.as_ref());
        let live = LiveMesh::new(self.normalisation(), self.mesh.bounds[0], self.bound, heeded);
        Engine::new(live, self.metric, self.mesh.exponent, self.bound)
    }
}

/// Simplifies a mesh in the order of the queue in memory.
pub(super) fn run<M: CollapseMetric>(
    task: &Task<'_, M>,
    journal: Journal,
    progress: &mut (dyn FnMut(f64) + Send),
) -> Result<(Simplified, SpannedCounters), SpannedError> {
    let Task { mesh, shares, .. } = task;
    let progress = &mut |journal: &Journal| progress(journal.collapses() as f64 / mesh.positions.len().max(1) as f64);
    let (mut loads, components) = Loads::begin(task)?;
    while !finish::fits(&loads.store, task.carried(), loads.tree.len(), shares.core) && !loads.tree.is_empty() {
        loads.one(shares, &journal)?;
        progress(&journal);
    }
    // What loads have worked with makes room for the rest of the mesh.
    let Loads { mut store, mut tree, mut counters, .. } = loads;
    counters.core_triangles = store.live_triangles;
    let mut engine = task.engine();
    if finish::fits(&store, task.carried(), tree.len(), shares.core) {
        let queued = finish::drain(&mut *tree)?;
        counters.tree = tree.traffic();
        drop(tree);
        let waiting = finish::load_all(&mut engine, &mut store, queued)?;
        counters.records = store.traffic();
        drop(store);
        let mut take = |engine: &mut Engine<M>| {
            journal.take(engine)?;
            progress(&journal);
            Ok::<(), StorageError>(())
        };
        queue::run(&mut engine, waiting, &mut take)?;
        let legal = journal.collapses();
        let mut roots = Vec::new();
        super::end_phase::run(&mut engine, &components, |_| true, &mut roots, &mut take)?;
        Ok((journal.finish(roots, 1, legal)?, counters))
    } else {
        counters.tree = tree.traffic();
        drop(tree);
        let legal = journal.collapses();
        let roots = finish::end_phase(&mut engine, &mut store, &components, task, &journal)?;
        counters.records = store.traffic();
        Ok((journal.finish(roots, 1, legal)?, counters))
    }
}

/// The mesh between loads, and what loads work with.
struct Loads<'a, M> {
    store: MeshStore<'a>,
    tree: Box<dyn EdgeTree>,
    loaded: SubMeshes<M>,
    spanning: Spanning,
    /// Edges up to ℓ that wait.
    heap: BinaryHeap<Reverse<Edge>>,
    /// Edges above ℓ that are to be put into the tree.
    left_over: Vec<Edge>,
    /// Bytes that all of it may take.
    most: usize,
    /// Pieces that a triangle may keep.
    most_kept: usize,
    /// Bytes that a spanning edge took in the last load, with what its collapse made.
    edge_bytes: usize,
    /// The share of the edges last taken from the tree that were due.
    due_share: f64,
    counters: SpannedCounters,
}

/// Bytes of edges that the collapse of one makes: eight, with the room that their list grows by.
const MADE_BYTES: usize = 8 * 2 * size_of::<Edge>();

/// What a spanning edge is taken to need before the first load: a star of six triangles at either end.
const FIRST_EDGE_BYTES: usize = 3 << 10;

impl<'a, M: CollapseMetric> Loads<'a, M> {
    /// Step 1: puts a mesh on disk.
    fn begin(task: &Task<'a, M>) -> Result<(Self, Components), SpannedError> {
        let Task { mesh, metric, bound, kind, shares, scratch } = *task;
        let [vertices, triangles] = [mesh.positions.len(), mesh.triangles.len()].map(|count| count as u32);
        let mut tree =
            kind.create(scratch, edges_of(mesh.triangles.len()), shares.tree).map_err(|error| match error {
                refusal @ EdgeTreeError::SledMemory { .. } => SpannedError::SledMemory {
                    refusal,
                    advice: memory_for_sled(mesh.positions.len(), mesh.triangles.len(), bound),
                },
                error => SpannedError::EdgeTree(error),
            })?;
        let most_kept = bound.pieces().saturating_sub(1);
        let (counts, attributes) = ([vertices, triangles], mesh.attributes.as_ref());
        let mut store = MeshStore::new(scratch, counts, most_kept, attributes, shares.pages as usize)?;
        let (mut edges, components) = begin::begin(mesh, metric, scratch, shares.sub_meshes as usize, &mut store)?;
        let mut before = None;
        tree.bulk_load(&mut || {
            loop {
                let edge = edges.next()?;
                if edge.is_none() || before.replace(edge) != Some(edge) {
                    return Ok(edge);
                }
            }
        })?;
        let counters = SpannedCounters { largest_tree: tree.len(), ..SpannedCounters::default() };
        let loads = Loads {
            store,
            tree,
            loaded: SubMeshes::new(task.engine(), task.normalisation()),
            spanning: Spanning::default(),
            heap: BinaryHeap::new(),
            left_over: Vec::new(),
            most: shares.sub_meshes as usize,
            most_kept,
            edge_bytes: FIRST_EDGE_BYTES,
            due_share: 1.0,
            counters,
        };
        Ok((loads, components))
    }

    /// Bytes that the mesh may take, beside the edges.
    fn room(&self) -> usize {
        let edges = self.heap.len() + self.left_over.len();
        self.most.saturating_sub(edges * size_of::<Edge>())
    }

    /// Steps 2 to 4, once. The tree is not empty.
    fn one(&mut self, shares: &Shares, journal: &Journal) -> Result<(), SpannedError> {
        let Some(limit) = self.load(shares)? else { return Ok(()) };
        let Spanned { sub_meshes, triangles, largest } = self.spanning.measure(self.loaded.triangles());
        self.counters.loads += 1;
        self.counters.sub_meshes += sub_meshes;
        self.counters.sub_mesh_triangles += triangles;
        self.counters.largest_sub_mesh = self.counters.largest_sub_mesh.max(largest);
        if !self.collapse(limit)? {
            self.counters.cut_short += 1;
        }
        self.put_back(limit, journal)
    }

    /// Step 4: writes back what has changed; puts edges that wait into the tree.
    fn put_back(&mut self, limit: Edge, journal: &Journal) -> Result<(), SpannedError> {
        let Loads { loaded, left_over, heap, .. } = self;
        left_over.extend(heap.drain().map(|Reverse(edge)| edge));
        // What later collapses of the same load made void need not be put in.
        left_over.retain(|edge| loaded.standing_of_loaded(*edge) != Some(Standing::Void));
        left_over.sort_unstable();
        left_over.dedup();
        let removed = loaded.waiting_for_nothing(limit);
        loaded.write_back(&mut self.store)?;
        journal.take(&mut loaded.engine)?;
        self.counters.removed_edges += self.tree.change(&removed, left_over)?;
        self.counters.inserted_edges += left_over.len() as u64;
        self.counters.largest_tree = self.counters.largest_tree.max(self.tree.len());
        left_over.clear();
        Ok(())
    }

    /// Step 2: takes the smallest edges from the tree, as many as are expected to fill the memory with what they span and
    /// leave room for what their collapses make, and loads that, in the order of the vertices, so that few pages are read
    /// twice. Returns ℓ; `None` where all edges that were taken are void.
    fn load(&mut self, shares: &Shares) -> Result<Option<Edge>, SpannedError> {
        let wanted = (self.most / 3 * 2 / self.edge_bytes).max(1);
        let count = (wanted as f64 / self.due_share) as usize;
        let mut taken = Vec::with_capacity(count.min(self.tree.len() as usize));
        self.tree.delete_smallest(&mut |edge| {
            let is_taken = taken.len() < count;
            if is_taken {
                taken.push(edge);
            }
            is_taken
        })?;
        let Some(limit) = taken.last().copied() else { return Ok(None) };
        let all = taken.len();
        let mut first = None;
        for (place, edge) in taken.iter().enumerate() {
            if self.loaded.standing(&mut self.store, *edge)? == Standing::Due {
                first = Some(place);
                break;
            }
        }
        self.counters.void_edges += first.unwrap_or(all) as u64;
        let Some(place) = first else { return Ok(None) };
        taken.drain(..place);
        // The first one may take all there is, so that there is always one that can be decided.
        let first = taken[0];
        if !self.loaded.prepare(&mut self.store, first, self.most)? {
            let extent = loaded::extent(&mut self.store, first)?;
            let [low, high] = edges::ends(first);
            let needed = shares.advice(SubMeshes::<M>::bytes_of(extent, self.most_kept) as u64);
            return Err(SpannedError::Star { low, high, triangles: extent.triangles as u64, needed });
        }
        self.spanning.clear();
        taken.sort_unstable_by_key(|edge| edges::ends(*edge));
        let (mut due, mut loaded) = (0, 0);
        for edge in taken.drain(..) {
            if self.loaded.standing(&mut self.store, edge)? == Standing::Void {
                self.counters.void_edges += 1;
                continue;
            }
            due += 1;
            self.heap.push(Reverse(edge));
            // Once there is no room, an edge may still find all that it needs in memory.
            let room = (self.most / 6 * 5).saturating_sub(self.heap.len() * size_of::<Edge>());
            if (edge == first || self.loaded.prepare(&mut self.store, edge, room)?)
                && let Some(places) = self.loaded.places(edge)
            {
                self.spanning.add(places);
                loaded += 1;
            }
        }
        self.counters.spanning_edges += loaded as u64;
        self.edge_bytes = self.loaded.bytes() / loaded.max(1) + MADE_BYTES;
        self.due_share = (f64::from(due) / all as f64).max(0.05);
        Ok(Some(limit))
    }

    /// Step 3: decides all edges up to ℓ. `false`: memory is full before all are decided.
    fn collapse(&mut self, limit: Edge) -> Result<bool, SpannedError> {
        let mut again = Vec::new();
        while let Some(Reverse(edge)) = self.heap.pop() {
            if self.loaded.standing(&mut self.store, edge)? == Standing::Void {
                continue;
            }
            let room = self.room();
            if !self.loaded.prepare(&mut self.store, edge, room)? {
                self.heap.push(Reverse(edge));
                return Ok(false);
            }
            self.loaded.decide(edge, &mut again);
            for edge in again.drain(..) {
                if edge <= limit {
                    self.heap.push(Reverse(edge));
                } else {
                    self.left_over.push(edge);
                }
            }
        }
        Ok(true)
    }
}

#[cfg(test)]
pub(super) mod tests;
