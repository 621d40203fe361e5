//! Rounds over a mesh larger than memory (design, section 3; the proof that they come to the same as in core is in
//! `docs/exactness.md`).
//!
//! The mesh lies on disk in spatial blocks. A pass is one round, or several of a cycle:
//!
//! 1. *Blocks*, in parallel. Each is read, decides, round by round, every edge of its batch that no unsettled vertex
//!    touches, and is written again, in two parts: what is settled, and the *seam*: the stars of the vertices that it
//!    shares with other blocks, of the ends of the edges that it could not decide, and of the ends of those that it could
//!    not even see (see `unsettled`).
//! 2. *Seams*. Those of a group of neighbouring blocks make a mesh, in which the same rule decides, round by round, what
//!    only this group touches; what is still undecided goes on to a group of groups, until one group has everything.
//! 3. Neighbouring blocks that have become small are one block from the next pass on.
//!
//! The more rounds a pass has, the fewer times is the mesh read and written, and the wider are the seams: how many are
//! best follows from the size of the blocks ([`Plan`]).
//!
//! Once all that is left fits in memory, the rounds go on in core. Where no candidate is left before that (a mesh of very
//! many small closed parts), the end phase goes through the blocks and groups in the same way, each taking the components
//! that it has whole. What is done never depends on blocks, groups, threads or memory.
//!
//! Memory: a block and its buffers for each thread. I/O of a pass: what is left of the mesh is read and written once, 92
//! bytes for each vertex, 24 for each triangle and 56 for each piece that one keeps (see `bound`), and the seams twice. Of a
//! mesh with attributes, 4 bytes more for each triangle and 8 for each vertex, where they are needed, and its wedges are read.

use std::collections::HashSet;
use std::sync::{Mutex, PoisonError};

use bytemuck::{Pod, Zeroable};
use storage::{Scratch, Spool, SpoolWriter, StorageError};

use crate::ingest::StoredMesh;
use crate::tree::{ErrorBound, MeshAttributes};

use super::collapse::{Candidate, Engine};
use super::components::{BlockLabels, Components, Labels};
use super::journal::Journal;
use super::live_mesh::{LiveMesh, Normalisation, Vertex};
use super::live_wedges::Heeded;
use super::log::LoggedRoot;
use super::metric::CollapseMetric;
use super::plan::Plan;
use super::records::{Piece, PieceWriter, Span, VertexRecord, read_pieces};
use super::rounds::{Batch, CYCLE, Histogram, Round, Sample, Schedule, count_keys};
use super::seams::Seams;
use super::unsettled::{begin_round, unsettle_seams};
use super::{SimplifyError, end_phase, initial};
use crate::workers;

/// An edge that a block or a group could not decide, by the canonical ids of its ends.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Undecided {
    low: u32,
    high: u32,
    key: u32,
    is_dearer: u16,
    /// The round, by its index in the pass.
    round_index: u16,
}

/// Where the triangles of a block are.
#[derive(Debug)]
enum Content {
    /// In the mesh as it came, so many.
    Initial(u64),
    /// On disk, as passes left it.
    Pieces(Vec<Piece>),
}

impl Content {
    fn triangles(&self) -> u64 {
        match self {
            Content::Initial(triangles) => *triangles,
            Content::Pieces(pieces) => pieces.iter().map(|piece| piece.triangles.len()).sum(),
        }
    }

    /// What they take in memory, see [`Plan::load`].
    fn load(&self, plan: &Plan) -> u64 {
        match self {
            Content::Initial(triangles) => *triangles,
            Content::Pieces(pieces) => pieces.iter().map(|piece| load(piece, plan)).sum(),
        }
    }
}

/// What a piece of the mesh takes in memory, see [`Plan::load`].
fn load(piece: &Piece, plan: &Plan) -> u64 {
    plan.load(piece.triangles.len(), piece.cut_pieces.len(), piece.wedges)
}

/// What is settled of a group, by the numbers that blocks have in the next pass.
type Settled = Vec<(u16, Piece)>;

/// What a block or a group hands on: the seam, by the blocks that its triangles belong to.
#[derive(Debug)]
struct Seam {
    /// The first and the last block.
    first: u16,
    last: u16,
    pieces: Vec<(u16, Piece)>,
    undecided: Spool<Undecided>,
}

impl Seam {
    fn triangles(&self) -> u64 {
        self.pieces.iter().map(|(_, piece)| piece.triangles.len()).sum()
    }

    /// What they take in memory, see [`Plan::load`].
    fn load(&self, plan: &Plan) -> u64 {
        self.pieces.iter().map(|(_, piece)| load(piece, plan)).sum()
    }
}

/// What one thread works with.
#[derive(Debug)]
struct Workspace<M> {
    engine: Engine<M>,
    batch: Batch,
    undecided: Vec<Candidate>,
    /// For each round of the pass that is done, how many were undecided when it ended.
    undecided_until: Vec<usize>,
    /// For each vertex, the blocks that have triangles at it, where there is more than one.
    spans: Vec<Span>,
    /// For each triangle, the block that it belongs to.
    homes: Vec<u16>,
    /// For each vertex, whether it is, since the last round began, stale or next to one that is.
    is_near: Vec<bool>,
    /// For each vertex, whether its whole star belongs to the seam.
    is_seam: Vec<bool>,
    /// For each triangle, whether it belongs to the seam.
    in_seam: Vec<bool>,
    places: Vec<u32>,
    histogram: Histogram,
}

impl<M: CollapseMetric> Workspace<M> {
    fn new(mesh: &StoredMesh, metric: M, bound: ErrorBound) -> Self {
        let heeded = Heeded::of(mesh.attributes.as_ref());
        let live = LiveMesh::new(Normalisation::new(mesh.exponent), mesh.bounds[0], bound, heeded);
        Workspace {
            engine: Engine::new(live, metric, mesh.exponent, bound),
            batch: Batch::default(),
            undecided: Vec::new(),
            undecided_until: Vec::new(),
            spans: Vec::new(),
            homes: Vec::new(),
            is_near: Vec::new(),
            is_seam: Vec::new(),
            in_seam: Vec::new(),
            places: Vec::new(),
            histogram: Histogram::new(),
        }
    }

    fn clear(&mut self) {
        self.engine.mesh.clear();
        self.undecided.clear();
        self.undecided_until.clear();
        self.is_near.clear();
        self.spans.clear();
        self.homes.clear();
    }

    /// Lets go of the memory of what was in it last.
    fn release(&mut self) {
        self.engine.release();
        self.batch = Batch::default();
        (self.undecided, self.spans, self.homes, self.places) = Default::default();
    }

    /// Does the batch of a round.
    fn process(&mut self, round: Round) {
        self.engine.round = round.number;
        self.batch.process(&mut self.engine, round.limit, &mut self.undecided);
        self.undecided_until.push(self.undecided.len());
    }

    /// Marks the seam: the stars of the vertices for which `is_shared` holds, of the ends of undecided edges, and of those
    /// that may be ends of edges that were not seen.
    fn mark_seam(&mut self, is_shared: impl Fn(Span) -> bool) {
        let mesh = &self.engine.mesh;
        self.is_seam.clear();
        self.is_seam.extend(self.spans.iter().map(|span| is_shared(*span)));
        for (is_seam, is_near) in self.is_seam.iter_mut().zip(&self.is_near) {
            *is_seam |= is_near;
        }
        for candidate in &self.undecided {
            let (low, high) = candidate.vertices();
            self.is_seam[low as usize] = true;
            self.is_seam[high as usize] = true;
        }
        self.in_seam.clear();
        let is_seam = &self.is_seam;
        self.in_seam.extend(
            mesh.triangles
                .iter()
                .map(|triangle| !triangle.is_gone() && triangle.corners.iter().any(|corner| is_seam[*corner as usize])),
        );
    }

    fn write_undecided(&self, scratch: &Scratch, buffer: usize) -> Result<Spool<Undecided>, StorageError> {
        let mut undecided = SpoolWriter::to_disk(scratch, "undecided", buffer);
        let mut round_index = 0;
        for (number, candidate) in self.undecided.iter().enumerate() {
            while self.undecided_until[usize::from(round_index)] <= number {
                round_index += 1;
            }
            let (low, high) = candidate.vertices();
            let [low, high] = [low, high].map(|end| self.engine.mesh.vertices[end as usize].id);
            let is_dearer = candidate.is_dearer().into();
            undecided.push(Undecided { low, high, key: candidate.key, is_dearer, round_index })?;
        }
        undecided.finish_on_disk()
    }
}

/// Everything that the threads of a pass share.
struct Pass<'a> {
    mesh: &'a StoredMesh,
    scratch: &'a Scratch,
    journal: &'a Journal,
    plan: Plan,
    rounds: Vec<Round>,
    /// The sample in which keys are counted for the cycle to come, where this one is over with the pass.
    sample: Option<Sample>,
    histogram: Mutex<Histogram>,
}

impl Pass<'_> {
    /// Counts the keys above the last limit of what is settled.
    fn count<M: CollapseMetric>(&self, workspace: &mut Workspace<M>) {
        let (Some(sample), Some(last)) = (self.sample, self.rounds.last()) else { return };
        let Workspace { engine, in_seam, histogram, .. } = workspace;
        count_keys(engine, Some(last.limit), sample, |triangle| !in_seam[triangle], histogram);
        self.histogram.lock().unwrap_or_else(PoisonError::into_inner).add_all(histogram);
        histogram.clear();
    }

    fn piece_writer(&self, name: &str) -> PieceWriter {
        PieceWriter::new(self.scratch, name, self.plan.carried, self.plan.buffer_bytes)
    }

    /// Does block `number`, which is loaded. Returns what is settled of it, its seam, and how many edges were in its
    /// batches.
    fn do_block<M: CollapseMetric>(
        &self,
        workspace: &mut Workspace<M>,
        number: u16,
    ) -> Result<(Piece, Seam, usize), StorageError> {
        let Workspace { engine, spans, .. } = workspace;
        unsettle_seams(&mut engine.mesh, |vertex| spans[vertex].is_shared());
        let mut edges = 0;
        for (index, round) in (0..).zip(&self.rounds) {
            let Workspace { engine, batch, is_near, .. } = workspace;
            if index > 0 {
                begin_round(&mut engine.mesh, index, is_near);
            }
            batch.collect(engine, *round);
            edges += batch.len();
            workspace.process(*round);
            self.journal.take(&mut workspace.engine)?;
        }
        workspace.mark_seam(Span::is_shared);
        self.count(workspace);
        let undecided = workspace.write_undecided(self.scratch, self.plan.buffer_bytes / 8)?;
        let Workspace { engine, is_seam, in_seam, spans, places, .. } = workspace;
        let mesh = &engine.mesh;
        let settled = self.piece_writer("settled").write(mesh, spans, |t| !in_seam[t], |_| false, places)?;
        let seam = self.piece_writer("seam").write(mesh, spans, |t| in_seam[t], |vertex| is_seam[vertex], places)?;
        Ok((settled, Seam { first: number, last: number, pieces: vec![(number, seam)], undecided }, edges))
    }

    /// Does a group of seams. `next` gives the number that each block has in the next pass; `is_last` says that there is
    /// no other group. Returns what is settled, by those numbers, and the seam of the group where there are others.
    fn do_group<M: CollapseMetric>(
        &self,
        workspace: &mut Workspace<M>,
        seams: &[Seam],
        next: &[u16],
        is_last: bool,
    ) -> Result<(Settled, Option<Seam>), StorageError> {
        workspace.clear();
        let (first, last) = (seams[0].first, seams[seams.len() - 1].last);
        let pieces = || seams.iter().flat_map(|seam| &seam.pieces).map(|(home, piece)| (*home, piece));
        let Workspace { engine, spans, homes, .. } = workspace;
        let attributes = self.mesh.attributes.as_ref();
        read_pieces(&mut engine.mesh, attributes, pieces(), spans, homes, self.plan.buffer_bytes * 2)?;
        let is_shared = |span: Span| !is_last && !span.is_within(first, last);
        unsettle_seams(&mut engine.mesh, |vertex| is_shared(spans[vertex]));
        // What was stale in the parts is known here; what is so for the group is noted anew.
        let stale_from: Vec<u8> = engine.mesh.vertices.iter_mut().map(Vertex::take_stale).collect();
        let mut candidates = vec![Vec::new(); self.rounds.len()];
        for seam in seams {
            let mut reader = seam.undecided.reader(self.plan.buffer_bytes / 8);
            while let Some(Undecided { low, high, key, is_dearer, round_index }) = reader.next()? {
                let place = |id: u32| engine.mesh.vertices.partition_point(|vertex| vertex.id < id) as u32;
                let candidate = Candidate::of([low, high].map(place), [low, high], key);
                candidates[usize::from(round_index)].push(if is_dearer != 0 {
                    candidate.dearer(key)
                } else {
                    candidate
                });
            }
        }
        for ((index, round), candidates) in (0..).zip(&self.rounds).zip(candidates) {
            let Workspace { engine, batch, is_near, .. } = workspace;
            if index > 0 {
                begin_round(&mut engine.mesh, index, is_near);
            }
            let is_stale = |vertex: u32| stale_from[vertex as usize] <= index;
            batch.replace(candidates.into_iter(), engine, *round, is_stale);
            workspace.process(*round);
            self.journal.take(&mut workspace.engine)?;
        }
        workspace.mark_seam(is_shared);
        self.count(workspace);

        let seam_undecided = workspace.write_undecided(self.scratch, self.plan.buffer_bytes / 8)?;
        let Workspace { engine, is_seam, in_seam, spans, homes, places, .. } = workspace;
        let mesh = &engine.mesh;
        // Collapses may have changed which blocks have triangles at a vertex: known where its whole star is here.
        let is_known = |vertex: usize, span: Span| mesh.vertices[vertex].is_whole() && !is_shared(span);
        let stars: Vec<bool> = spans.iter().enumerate().map(|(vertex, span)| is_known(vertex, *span)).collect();
        for (span, is_known) in spans.iter_mut().zip(&stars) {
            if *is_known {
                *span = Span::NONE;
            }
        }
        for (triangle, home) in mesh.triangles.iter().zip(homes.iter()).filter(|(triangle, _)| !triangle.is_gone()) {
            for corner in triangle.corners.into_iter().filter(|corner| stars[*corner as usize]) {
                let span = &mut spans[corner as usize];
                *span = span.around(Span::of(*home));
            }
        }
        let mut settled = Vec::new();
        for block in next[usize::from(first)]..=next[usize::from(last)] {
            let is_chosen = |t: usize| !in_seam[t] && next[usize::from(homes[t])] == block;
            let piece = self.piece_writer("settled").write(mesh, spans, is_chosen, |_| false, places)?;
            if !piece.triangles.is_empty() {
                settled.push((block, piece));
            }
        }
        if is_last {
            return Ok((settled, None));
        }
        let mut pieces = Vec::new();
        for home in first..=last {
            let is_chosen = |t: usize| in_seam[t] && homes[t] == home;
            let piece = self.piece_writer("seam").write(mesh, spans, is_chosen, |vertex| is_seam[vertex], places)?;
            if !piece.triangles.is_empty() {
                pieces.push((home, piece));
            }
        }
        Ok((settled, Some(Seam { first, last, pieces, undecided: seam_undecided })))
    }
}

/// The blocks as they are between passes.
struct Blocks {
    contents: Vec<Content>,
    /// The number that each block of the last pass has now.
    numbers: Vec<u16>,
}

impl Blocks {
    /// As the mesh came.
    fn of(mesh: &StoredMesh) -> Self {
        let firsts = mesh.blocks.iter().map(|block| block.first_triangle).chain([mesh.triangles.len() as u32]);
        let firsts: Vec<u32> = firsts.collect();
        let contents = firsts.windows(2).map(|ends| Content::Initial((ends[1] - ends[0]).into())).collect();
        Blocks { contents, numbers: Vec::new() }
    }

    fn triangles(&self) -> u64 {
        self.contents.iter().map(Content::triangles).sum()
    }

    /// Whether they fit in memory together.
    fn fit(&self, plan: &Plan) -> bool {
        self.contents.iter().map(|content| content.load(plan)).sum::<u64>() <= plan.core_triangles
    }
}

/// What passes have left.
#[expect(clippy::large_enum_variant, reason = "there is one of it, and it is taken apart at once")]
pub(super) enum Left<M> {
    /// A mesh that fits in memory, for the rounds to go on.
    Core(Engine<M>, Components),
    /// One vertex of each component: also the end phase is over.
    Roots {
        /// They are.
        roots: Vec<LoggedRoot>,
        /// How many collapses there were before the end phase.
        legal_collapses: u64,
    },
}

/// Runs passes until what is left fits in memory, and loads it; or to the end.
pub(super) fn run<M: CollapseMetric>(
    mesh: &StoredMesh,
    metric: M,
    plan: &Plan,
    scratch: &Scratch,
    journal: &Journal,
    schedule: &mut Schedule,
    progress: &mut (dyn FnMut(f64) + Send),
) -> Result<Left<M>, SimplifyError> {
    let Seams { vertices: inboxes, mut histogram } = super::seams::find(mesh, metric, scratch, plan.memory as usize)?;
    scratch.release_memory();
    let labels = Mutex::new(Labels::new(scratch));
    let mut blocks = Blocks::of(mesh);
    let mut workspaces: Vec<_> = (0..plan.threads).map(|_| Workspace::new(mesh, metric, plan.carried.bound)).collect();
    schedule.begin_cycle(histogram.take_limits(), blocks.triangles());
    let mut shared_vertices = mesh.seam_vertices.len();
    let progress = Mutex::new(progress);
    let tell = || {
        let share = journal.collapses() as f64 / mesh.positions.len().max(1) as f64;
        (progress.lock().unwrap_or_else(PoisonError::into_inner))(share);
    };
    while !schedule.is_cycle_over() && (schedule.done == 0 || !blocks.fit(plan)) {
        let rounds = schedule.next_rounds(plan.pass_rounds(blocks.contents.len(), shared_vertices));
        let pass = Pass {
            mesh,
            scratch,
            journal,
            plan: *plan,
            sample: schedule.is_over_with(&rounds).then(|| schedule.sample()),
            rounds,
            histogram: Mutex::new(Histogram::new()),
        };
        let results = workers::for_each(&mut workspaces, blocks.contents.len(), |workspace, number| {
            workspace.clear();
            load_block(workspace, &pass, &blocks, number, &inboxes, &labels)?;
            let done = pass.do_block(workspace, number as u16);
            tell();
            done
        })?;
        let edges: usize = results.iter().map(|(_, _, edges)| edges).sum();
        let next = merge(&results, plan);
        let count = next.last().map_or(0, |last| usize::from(*last) + 1);
        let mut pieces: Vec<Vec<Piece>> = (0..count).map(|_| Vec::new()).collect();
        let mut seams = Vec::with_capacity(results.len());
        for (number, (settled, seam, _)) in results.into_iter().enumerate() {
            pieces[usize::from(next[number])].push(settled);
            seams.push(seam);
        }
        // What a pass has read is let go before the seams are written again.
        blocks.contents.clear();
        scratch.release_memory();
        shared_vertices = Plan::shared_vertices(seams.iter().map(Seam::triangles).sum(), pass.rounds.len());
        let settled = through_groups(plan, &mut workspaces, seams, |workspace, seams, is_last| {
            let done = pass.do_group(workspace, seams, &next, is_last);
            tell();
            done
        })?;
        for (block, piece) in settled.into_iter().flatten() {
            pieces[usize::from(block)].push(piece);
        }
        blocks = Blocks { contents: pieces.into_iter().map(Content::Pieces).collect(), numbers: next };
        scratch.release_memory();
        if edges == 0 && schedule.is_dry() {
            // No candidate is left: this was no round at all.
            break;
        }
        schedule.advance(&pass.rounds);
        if let Some(sample) = pass.sample {
            let mut limits = pass.histogram.into_inner().unwrap_or_else(PoisonError::into_inner).take_limits();
            if limits.is_none() && sample != Sample::ALL {
                limits = count_all(&blocks, &mut workspaces, schedule.last())?;
            }
            schedule.begin_cycle(limits, blocks.triangles());
        }
    }
    drop(inboxes);
    let components = labels.into_inner().unwrap_or_else(PoisonError::into_inner).join()?;
    if !blocks.fit(plan) {
        let end = EndPhase { attributes: mesh.attributes.as_ref(), plan, scratch, journal, components: &components };
        let legal_collapses = journal.collapses();
        let roots = end.run(&mut workspaces, blocks)?;
        return Ok(Left::Roots { roots, legal_collapses });
    }
    // The memory of blocks is let go before the whole mesh takes it.
    drop(workspaces);
    scratch.release_memory();
    let mut workspace = Workspace::new(mesh, metric, plan.carried.bound);
    let all = blocks.contents.iter().flat_map(|content| match content {
        Content::Initial(_) => [].iter(),
        Content::Pieces(pieces) => pieces.iter(),
    });
    let Workspace { engine, spans, homes, .. } = &mut workspace;
    let (attributes, all) = (mesh.attributes.as_ref(), all.map(|piece| (0, piece)));
    read_pieces(&mut engine.mesh, attributes, all, spans, homes, plan.memory as usize / 16)?;
    Ok(Left::Core(workspace.engine, components))
}

/// The end phase of a mesh that does not fit in memory.
struct EndPhase<'a> {
    attributes: Option<&'a MeshAttributes>,
    plan: &'a Plan,
    scratch: &'a Scratch,
    journal: &'a Journal,
    components: &'a Components,
}

impl EndPhase<'_> {
    fn run<M: CollapseMetric>(
        &self,
        workspaces: &mut [Workspace<M>],
        blocks: Blocks,
    ) -> Result<Vec<LoggedRoot>, SimplifyError> {
        let results = workers::for_each(workspaces, blocks.contents.len(), |workspace, number| {
            workspace.clear();
            let Content::Pieces(pieces) = &blocks.contents[number] else { return Ok((Vec::new(), None)) };
            let Workspace { engine, spans, homes, .. } = workspace;
            let pieces = pieces.iter().map(|piece| (number as u16, piece));
            read_pieces(&mut engine.mesh, self.attributes, pieces, spans, homes, self.plan.buffer_bytes * 2)?;
            spans.iter_mut().for_each(|span| *span = span.renumbered(&blocks.numbers));
            self.take_whole(workspace, number as u16, number as u16, false)
        })?;
        drop(blocks);
        let (mut roots, mut seams) = (Vec::new(), Vec::new());
        for (found, seam) in results {
            roots.extend(found);
            seams.extend(seam);
        }
        let found = through_groups(self.plan, workspaces, seams, |workspace, seams, is_last| {
            workspace.clear();
            let pieces = seams.iter().flat_map(|seam| &seam.pieces).map(|(home, piece)| (*home, piece));
            let Workspace { engine, spans, homes, .. } = workspace;
            read_pieces(&mut engine.mesh, self.attributes, pieces, spans, homes, self.plan.buffer_bytes * 2)?;
            self.take_whole(workspace, seams[0].first, seams[seams.len() - 1].last, is_last)
        })?;
        roots.extend(found.into_iter().flatten());
        Ok(roots)
    }

    /// Runs the end phase on the components that no block but `first..=last` has a part of, and hands on the others.
    fn take_whole<M: CollapseMetric>(
        &self,
        workspace: &mut Workspace<M>,
        first: u16,
        last: u16,
        is_last: bool,
    ) -> Result<(Vec<LoggedRoot>, Option<Seam>), StorageError> {
        let Workspace { engine, spans, places, .. } = workspace;
        let mut elsewhere = HashSet::new();
        for (span, node) in spans.iter().zip(&engine.mesh.nodes) {
            if !is_last && !span.is_within(first, last) {
                elsewhere.insert(self.components.of(node.label));
            }
        }
        let mut roots = Vec::new();
        let is_taken = |component: u32| !elsewhere.contains(&component);
        let take = |engine: &mut Engine<M>| self.journal.take(engine);
        end_phase::run(engine, self.components, is_taken, &mut roots, take)?;
        if elsewhere.is_empty() {
            return Ok((roots, None));
        }
        let writer = PieceWriter::new(self.scratch, "parts", self.plan.carried, self.plan.buffer_bytes);
        let piece = writer.write(&engine.mesh, spans, |_| true, |_| true, places)?;
        let undecided = Spool::from_vec(Vec::new());
        Ok((roots, Some(Seam { first, last, pieces: vec![(first, piece)], undecided })))
    }
}

/// Loads a block into an empty workspace.
fn load_block<M: CollapseMetric>(
    workspace: &mut Workspace<M>,
    pass: &Pass<'_>,
    blocks: &Blocks,
    number: usize,
    inboxes: &[Spool<VertexRecord>],
    labels: &Mutex<Labels>,
) -> Result<(), StorageError> {
    let Workspace { engine, spans, homes, .. } = workspace;
    match &blocks.contents[number] {
        Content::Pieces(pieces) => {
            let pieces = pieces.iter().map(|piece| (number as u16, piece));
            let attributes = pass.mesh.attributes.as_ref();
            read_pieces(&mut engine.mesh, attributes, pieces, spans, homes, pass.plan.buffer_bytes * 2)?;
            spans.iter_mut().for_each(|span| *span = span.renumbered(&blocks.numbers));
            Ok(())
        }
        Content::Initial(_) => {
            let mesh = pass.mesh;
            let (start, end) = (mesh.blocks[number], mesh.blocks.get(number + 1));
            let mut known = vec![VertexRecord::zeroed(); inboxes[number].len() as usize];
            inboxes[number].read_at(0, &mut known)?;
            initial::load(
                &mut engine.mesh,
                &mesh.positions,
                &mesh.triangles,
                [
                    [start.first_vertex, end.map_or(mesh.positions.len() as u32, |end| end.first_vertex)],
                    [start.first_triangle, end.map_or(mesh.triangles.len() as u32, |end| end.first_triangle)],
                ],
                &known,
                engine.metric.uses_quadrics(),
                spans,
            )?;
            if let Some(attributes) = &mesh.attributes {
                engine.mesh.load_first_attributes(attributes, start.first_triangle)?;
            }
            let block = BlockLabels::of(&mut engine.mesh, |vertex| spans[vertex].is_shared());
            let raise = labels.lock().unwrap_or_else(PoisonError::into_inner).add(&block)?;
            engine.mesh.nodes.iter_mut().for_each(|node| node.label += raise);
            Ok(())
        }
    }
}

/// The limits over all that is left, where a sample found nothing above the last one.
fn count_all<M: CollapseMetric>(
    blocks: &Blocks,
    workspaces: &mut [Workspace<M>],
    last: Option<u32>,
) -> Result<Option<[u32; CYCLE]>, StorageError> {
    let total = Mutex::new(Histogram::new());
    workers::for_each(workspaces, blocks.contents.len(), |workspace, number| {
        workspace.clear();
        let Content::Pieces(pieces) = &blocks.contents[number] else { return Ok(()) };
        let Workspace { engine, spans, homes, histogram, .. } = workspace;
        // Keys do not ask for wedges.
        read_pieces(&mut engine.mesh, None, pieces.iter().map(|piece| (0, piece)), spans, homes, 1 << 20)?;
        count_keys(engine, last, Sample::ALL, |_| true, histogram);
        total.lock().unwrap_or_else(PoisonError::into_inner).add_all(histogram);
        histogram.clear();
        Ok::<_, StorageError>(())
    })?;
    Ok(total.into_inner().unwrap_or_else(PoisonError::into_inner).take_limits())
}

/// The number of each block in the next pass: neighbours that have become small are one.
fn merge(results: &[(Piece, Seam, usize)], plan: &Plan) -> Vec<u16> {
    let (mut number, mut size) = (0_u16, 0);
    results
        .iter()
        .map(|(settled, seam, _)| {
            let load = load(settled, plan) + seam.load(plan);
            if size > 0 && size + load > plan.block_triangles {
                number += 1;
                size = 0;
            }
            size += load;
            number
        })
        .collect()
}

/// Hands seams to groups of neighbours, what these hand on to groups of groups, until nothing is handed on. `work` does a
/// group, and is told whether it is the last; returns what all groups came to.
fn through_groups<M: CollapseMetric, R: Send>(
    plan: &Plan,
    workspaces: &mut [Workspace<M>],
    mut seams: Vec<Seam>,
    work: impl Fn(&mut Workspace<M>, &[Seam], bool) -> Result<(R, Option<Seam>), StorageError> + Sync,
) -> Result<Vec<R>, SimplifyError> {
    let mut all = Vec::new();
    while !seams.is_empty() {
        let groups = group(&seams, plan, workspaces.len());
        // A group that is too large for one thread of several has the memory of all.
        let sizes = groups.iter().map(|group| {
            let load: u64 = group.iter().map(|seam| seam.load(plan)).sum();
            (load, group.iter().map(Seam::triangles).sum())
        });
        let (largest, triangles) = sizes.max().unwrap_or_default();
        if largest > plan.seam_triangles {
            return Err(SimplifyError::Seam { triangles, needed: Plan::memory_for_core(largest, plan.carried) });
        }
        let threads = if largest > plan.group_triangles { 1 } else { workspaces.len() };
        let is_last = groups.len() == 1;
        workspaces[threads..].iter_mut().for_each(Workspace::release);
        let results = workers::for_each(&mut workspaces[..threads], groups.len(), |workspace, number| {
            work(workspace, groups[number], is_last)
        })?;
        if threads < workspaces.len() {
            workspaces[..threads].iter_mut().for_each(Workspace::release);
        }
        seams = Vec::new();
        for (result, seam) in results {
            all.push(result);
            seams.extend(seam);
        }
    }
    Ok(all)
}

/// Cuts the seams into groups of neighbours, each of two seams at least where there are two, that fit in a
/// thread's memory if that can be; into one for each thread where there are enough.
fn group<'a>(seams: &'a [Seam], plan: &Plan, threads: usize) -> Vec<&'a [Seam]> {
    let total: u64 = seams.iter().map(|seam| seam.load(plan)).sum();
    let share = if seams.len() >= 2 * threads { total / threads as u64 + 1 } else { total };
    let most = share.min(plan.group_triangles);
    let mut groups = Vec::new();
    let mut start = 0;
    while start < seams.len() {
        let (mut end, mut size) = (start, 0);
        while end < seams.len() {
            let load = seams[end].load(plan);
            // Two at least, so that there is always an end to it; and none is left alone behind the last group.
            if end >= start + 2 && size + load > most && seams.len() - end >= 2 {
                break;
            }
            size += load;
            end += 1;
        }
        groups.push(&seams[start..end]);
        start = end;
    }
    groups
}
