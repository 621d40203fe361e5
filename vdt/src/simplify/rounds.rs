//! The default order: rounds of a frozen batch (design, section 3; the proof is in `docs/exactness.md`).
//!
//! A round has a limit, and processes, by (key, hash, ids), the edges that exist when the round begins, with a key up to
//! the limit, and that are *fresh*: above the limit of the round before, or at a vertex whose star changed in that round.
//! Edges that the round makes or enables again wait for the next. So what a round does is a function of the mesh at its
//! start and of its limit, whatever the memory, the threads or the cutting into blocks; the paper's order (see `queue`)
//! is not, but for these two points it is the same.
//!
//! Where attributes count (see `attribute_error`), a candidate may turn out, at its turn, to have a raised key above the limit. Its
//! edge then *waits* for that key, at its smaller end, with the others that do: what is noted is the smallest of their keys
//! ([`super::live_wedges::Wait`]). In the round that takes that key on, all edges of which the vertex is the smaller end are
//! fresh; those that have still longer to wait note that again. So an edge is tried again only when one that shares this end
//! may be due, or a star has changed.
//!
//! The limits of the four rounds of a *cycle* are taken together when it begins: each takes on one more fifth of the keys
//! that are above the last limit at that time. So the rounds of a cycle can be done in one go by a part of the mesh that
//! knows nothing of the others. The keys are counted over (live
//! triangle, edge), in an integer histogram; of a large mesh, over a sample of the triangles that a hash of their
//! canonical ids picks. How small a part the sample is follows from the triangles there were when the cycle before began.
//!
//! Memory: 16 bytes for each edge in the batch, twice while it is sorted, and that is a fifth of the edges or so;
//! 256 KiB for the histogram.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use super::collapse::{Candidate, Engine, Outcome, hash_pair};
use super::metric::CollapseMetric;
use super::radix::sort_by_key;

/// Share of the keys that each round takes on, of those above the last limit when the cycle began. (Measured: 0.1 to 0.25
/// make no difference to the error at 50, 10 and 1 % of the triangles but noise of 1 %, nor does the paper's order.)
const QUANTILE: f64 = 0.2;

/// Rounds of a cycle.
pub(super) const CYCLE: usize = 4;

/// The quantile of a mesh of more triangles than this is taken from a sample of between one and two times as many.
const SAMPLED_TRIANGLES: u64 = 1 << 13;

/// Key bits are counted by their leading 16 bits below the sign.
const BIN_SHIFT: u32 = 15;
const BINS: usize = 1 << 16;

/// Which triangles stand for all of them when keys are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sample {
    /// One of 2^shift.
    shift: u32,
}

impl Sample {
    /// All of them.
    pub const ALL: Sample = Sample { shift: 0 };

    /// For a mesh of so many triangles.
    pub fn of(triangles: u64) -> Self {
        Sample { shift: (triangles / SAMPLED_TRIANGLES).max(1).ilog2() }
    }

    /// Whether the triangle of this canonical id is in it.
    #[inline]
    pub fn has(self, triangle: u32) -> bool {
        self.shift == 0 || hash_pair(triangle, triangle) >> (32 - self.shift) == 0
    }
}

/// How many keys there are of each size.
#[derive(Debug)]
pub(super) struct Histogram {
    bins: Vec<u32>,
    count: u64,
    lowest: usize,
    highest: usize,
}

impl Histogram {
    pub fn new() -> Self {
        Histogram { bins: vec![0; BINS], count: 0, lowest: BINS, highest: 0 }
    }

    #[inline]
    fn add(&mut self, key: u32, times: u32) {
        let bin = (key >> BIN_SHIFT) as usize;
        self.bins[bin] += times;
        self.count += u64::from(times);
        self.lowest = self.lowest.min(bin);
        self.highest = self.highest.max(bin);
    }

    /// Adds what another one has counted.
    pub fn add_all(&mut self, other: &Histogram) {
        for bin in other.lowest..other.bins.len().min(other.highest + 1) {
            if other.bins[bin] > 0 {
                self.add((bin as u32) << BIN_SHIFT, other.bins[bin]);
            }
        }
    }

    /// Forgets what was counted.
    pub fn clear(&mut self) {
        if self.count > 0 {
            self.bins[self.lowest..=self.highest].fill(0);
        }
        (self.count, self.lowest, self.highest) = (0, BINS, 0);
    }

    /// The limits of a cycle, `None` where there are no keys. Forgets what was counted.
    pub fn take_limits(&mut self) -> Option<[u32; CYCLE]> {
        if self.count == 0 {
            return None;
        }
        let (mut below, mut bin) = (u64::from(self.bins[self.lowest]), self.lowest);
        let mut share = 0.0;
        let limits = [(); CYCLE].map(|()| {
            share += QUANTILE;
            let target = (self.count as f64 * share).ceil() as u64;
            while below < target && bin < self.highest {
                bin += 1;
                below += u64::from(self.bins[bin]);
            }
            ((bin as u32 + 1) << BIN_SHIFT) - 1
        });
        self.clear();
        Some(limits)
    }
}

/// A round, as all blocks know it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Round {
    /// Its number, from 1 on.
    pub number: u32,
    /// The limit of the round before; `None` in the first.
    pub last: Option<u32>,
    /// Keys up to this are taken on.
    pub limit: u32,
}

/// Counts, over the triangles of a sample, the keys above `last`: of each edge the cheaper one, unless it was passed
/// already; or that for which it may wait. Of the triangles those count for which `counts` holds.
pub(super) fn count_keys<M: CollapseMetric>(
    engine: &Engine<M>,
    last: Option<u32>,
    sample: Sample,
    counts: impl Fn(usize) -> bool,
    histogram: &mut Histogram,
) {
    let mesh = &engine.mesh;
    for (triangle, id) in mesh.triangle_ids.iter().enumerate() {
        if !sample.has(*id) || !mesh.is_live(triangle) || !counts(triangle) {
            continue;
        }
        let corners = mesh.triangles[triangle].corners;
        let ends = corners.map(|corner| &mesh.vertices[corner as usize]);
        for side in 0..3 {
            let low = corners[side].min(corners[(side + 1) % 3]);
            let wait = mesh.wedges.wait(low).key;
            count_edge(last, engine.edge_keys(ends[side], ends[(side + 1) % 3]), wait, histogram);
        }
    }
}

/// Counts an edge by the keys of its two directions, and that for which something waits at its smaller end (0: nothing).
pub(super) fn count_edge(last: Option<u32>, keys: [u32; 2], wait: u32, histogram: &mut Histogram) {
    let to_come = |key: &u32| last.is_none_or(|last| *key > last);
    let waiting = Some(wait).filter(|wait| *wait > 0);
    if let Some(key) = keys.into_iter().chain(waiting).filter(to_come).min() {
        histogram.add(key, 1);
    }
}

/// Room that the rounds need, kept from one to the next.
#[derive(Debug, Default)]
pub(super) struct Batch {
    candidates: Vec<Candidate>,
    buffer: Vec<Candidate>,
    waiting: BinaryHeap<Reverse<Candidate>>,
}

impl Batch {
    /// How many edges are in it.
    pub fn len(&self) -> usize {
        self.candidates.len()
    }

    /// Makes it one of these candidates, and of those edges of a round's batch that a stale end kept all blocks from
    /// seeing; `is_stale` tells of the vertices that were so when the round began.
    pub fn replace<M: CollapseMetric>(
        &mut self,
        candidates: impl Iterator<Item = Candidate>,
        engine: &Engine<M>,
        round: Round,
        is_stale: impl Fn(u32) -> bool,
    ) {
        self.candidates.clear();
        self.candidates.extend(candidates);
        self.add_fresh(engine, round, |a, b| is_stale(a) || is_stale(b));
        self.sort();
    }

    fn sort(&mut self) {
        sort_by_key(&mut self.candidates, &mut self.buffer, |candidate| candidate.key);
        self.candidates.dedup();
    }

    /// Makes it the batch of a round, but for what is stale.
    pub fn collect<M: CollapseMetric>(&mut self, engine: &Engine<M>, round: Round) {
        self.candidates.clear();
        self.add_fresh(engine, round, |_, _| true);
        self.sort();
    }

    /// Adds those edges of a round's batch without a stale end for which `is_wanted` holds.
    #[inline]
    fn add_fresh<M: CollapseMetric>(&mut self, engine: &Engine<M>, round: Round, is_wanted: impl Fn(u32, u32) -> bool) {
        let mesh = &engine.mesh;
        let Round { number, last, limit } = round;
        for triangle in mesh.triangles.iter().filter(|triangle| !triangle.is_gone()) {
            let corners = triangle.corners;
            let ends = corners.map(|corner| &mesh.vertices[corner as usize]);
            for side in 0..3 {
                let (a, b) = (corners[side], corners[(side + 1) % 3]);
                let (end_a, end_b) = (ends[side], ends[(side + 1) % 3]);
                // A regular edge runs upwards in exactly one of its two triangles. Others may do anything.
                if a > b && !(end_a.is_special() && end_b.is_special()) {
                    continue;
                }
                let keys = engine.edge_keys(end_a, end_b);
                let (cheaper, dearer) = (keys[0].min(keys[1]), keys[0].max(keys[1]));
                if cheaper > limit || end_a.is_stale() || end_b.is_stale() || !is_wanted(a, b) {
                    continue;
                }
                let changed = end_a.touched() + 1 == number || end_b.touched() + 1 == number;
                let is_due = mesh.wedges.wait(a.min(b)).is_due(last, limit);
                let fresh = |key: u32| changed || is_due || last.is_none_or(|last| key > last);
                if fresh(cheaper) {
                    self.candidates.push(Candidate::of([a, b], [end_a.id, end_b.id], cheaper));
                } else if dearer <= limit && fresh(dearer) {
                    self.candidates.push(Candidate::of([a, b], [end_a.id, end_b.id], cheaper).dearer(dearer));
                }
            }
        }
    }

    /// Processes the batch in order, with those that must wait again merged in at their new keys. An edge with an end
    /// that is unsettled when its turn comes is not decided, but handed to `undecided`; that unsettles what it could
    /// change (see `unsettled`).
    pub fn process<M: CollapseMetric>(&mut self, engine: &mut Engine<M>, limit: u32, undecided: &mut Vec<Candidate>) {
        let Batch { candidates, waiting, .. } = self;
        let mut next = 0;
        loop {
            let from_heap = match (candidates.get(next), waiting.peek()) {
                (None, None) => return,
                (Some(candidate), Some(Reverse(top))) => top < candidate,
                (candidate, _) => candidate.is_none(),
            };
            let candidate = if from_heap {
                waiting.pop().map(|top| top.0)
            } else {
                look_ahead(engine, candidates, next);
                next += 1;
                candidates.get(next - 1).copied()
            };
            let Some(candidate) = candidate else { return };
            let (low, high) = candidate.vertices();
            let ends = [low, high].map(|end| &engine.mesh.vertices[end as usize]);
            if ends.iter().any(|end| end.is_unsettled()) && !ends.iter().any(|end| end.is_gone()) {
                super::unsettled::unsettle_rings(&mut engine.mesh, low, high);
                undecided.push(candidate);
                continue;
            }
            match engine.attempt(candidate) {
                Outcome::Grown(again) | Outcome::OtherWay(again) | Outcome::Raised(again) if again.key <= limit => {
                    waiting.push(Reverse(again));
                }
                Outcome::Raised(again) => {
                    let round = engine.round;
                    engine.mesh.wedges.make_wait(low, again.key, round, limit);
                }
                _ => {}
            }
        }
    }
}

/// Has what the candidates behind number `next` will read on its way from memory, in stages: each stage reads what the
/// one before has fetched.
#[inline]
fn look_ahead<M: CollapseMetric>(engine: &Engine<M>, candidates: &[Candidate], next: usize) {
    let mesh = &engine.mesh;
    if let Some(candidate) = candidates.get(next + 32) {
        let (low, high) = candidate.vertices();
        mesh.prefetch_vertex(low);
        mesh.prefetch_vertex(high);
    }
    if let Some(candidate) = candidates.get(next + 24) {
        let (low, high) = candidate.vertices();
        mesh.prefetch_star(low);
        mesh.prefetch_star(high);
    }
    if let Some(candidate) = candidates.get(next + 16) {
        let (low, high) = candidate.vertices();
        mesh.prefetch_triangles(low);
        mesh.prefetch_triangles(high);
    }
    if let Some(candidate) = candidates.get(next + 8) {
        let (low, high) = candidate.vertices();
        mesh.prefetch_ring(low);
        mesh.prefetch_ring(high);
        mesh.prefetch_node(low);
        mesh.prefetch_node(high);
    }
}

/// Where the rounds have got to.
#[derive(Debug)]
pub(super) struct Schedule {
    /// Rounds that were done.
    pub done: u32,
    /// The limit of the last one.
    last: Option<u32>,
    /// The limits of the rounds to come in this cycle.
    limits: VecDeque<u32>,
    /// Triangles there were when the cycle began.
    triangles: u64,
    /// Whether there was no key above the last limit when the cycle began. It is of one round, then, with the same limit.
    is_dry: bool,
}

impl Schedule {
    /// Before the first cycle, for a mesh of so many triangles.
    pub fn new(triangles: u64) -> Self {
        Schedule { done: 0, last: None, limits: VecDeque::new(), triangles, is_dry: false }
    }

    /// Where the keys of the cycle to come are counted.
    pub fn sample(&self) -> Sample {
        Sample::of(self.triangles)
    }

    /// The limit of the last round.
    pub fn last(&self) -> Option<u32> {
        self.last
    }

    /// Whether there was no key above the last limit when the cycle began: if its batch is empty, the rounds are over.
    pub fn is_dry(&self) -> bool {
        self.is_dry
    }

    /// Whether all rounds of the cycle are done.
    pub fn is_cycle_over(&self) -> bool {
        self.limits.is_empty()
    }

    /// Begins a cycle, on a mesh of so many triangles. `limits` follow from the keys above the last limit, if there are any.
    pub fn begin_cycle(&mut self, limits: Option<[u32; CYCLE]>, triangles: u64) {
        self.is_dry = limits.is_none();
        self.limits = match limits {
            Some(limits) => limits.into(),
            None => self.last.into_iter().collect(),
        };
        self.triangles = triangles;
    }

    /// The next rounds of the cycle, at most so many.
    pub fn next_rounds(&self, most: usize) -> Vec<Round> {
        let mut last = self.last;
        let limits = (self.done + 1..).zip(self.limits.iter().take(most));
        limits.map(|(number, limit)| Round { number, last: last.replace(*limit), limit: *limit }).collect()
    }

    /// Whether the cycle is over once these rounds are done.
    pub fn is_over_with(&self, rounds: &[Round]) -> bool {
        rounds.len() == self.limits.len()
    }

    /// Takes note that these rounds were done.
    pub fn advance(&mut self, rounds: &[Round]) {
        for round in rounds {
            self.limits.pop_front();
            (self.done, self.last) = (round.number, Some(round.limit));
        }
    }
}

/// Runs rounds, from where `schedule` has got to, until no candidate is left. Nothing of the mesh is unsettled or lies
/// elsewhere. `after_round` takes away what was written down.
pub(super) fn run<M: CollapseMetric, E>(
    engine: &mut Engine<M>,
    schedule: &mut Schedule,
    histogram: &mut Histogram,
    mut after_round: impl FnMut(&mut Engine<M>) -> Result<(), E>,
) -> Result<(), E> {
    let mut batch = Batch::default();
    let mut undecided = Vec::new();
    loop {
        engine.mesh.compact();
        if schedule.is_cycle_over() {
            let (sample, last) = (schedule.sample(), schedule.last());
            count_keys(engine, last, sample, |_| true, histogram);
            let mut limits = histogram.take_limits();
            if limits.is_none() && sample != Sample::ALL {
                // A sample that holds nothing above the limit does not say that there is nothing.
                count_keys(engine, last, Sample::ALL, |_| true, histogram);
                limits = histogram.take_limits();
            }
            schedule.begin_cycle(limits, engine.mesh.live_triangles() as u64);
        }
        let rounds = schedule.next_rounds(1);
        let [round] = rounds[..] else { return Ok(()) };
        batch.collect(engine, round);
        if batch.len() == 0 && schedule.is_dry() {
            return Ok(());
        }
        engine.round = round.number;
        batch.process(engine, round.limit, &mut undecided);
        schedule.advance(&rounds);
        after_round(engine)?;
    }
}
