//! The default order: rounds of a frozen batch (design, section 3; proof in `facts/exact.md`).
//!
//! Round r takes as its limit the 20 % quantile of the keys above the last limit, and processes, by (key, hash, ids), the
//! edges that exist when the round begins, with a key up to the limit, and that are *fresh*: above the last limit, or at
//! a vertex whose star changed in the round before. Edges that the round makes or enables again wait for the next. So
//! what a round does is a function of the mesh at its start, whatever the memory, the threads or the cutting into
//! blocks; the paper's order (see `queue`) is not, but for these two points it is the same.
//!
//! The quantile is counted over (live triangle, edge), in an integer histogram; of a large mesh, over a sample of the
//! triangles that a hash of their canonical ids picks.
//!
//! Memory: 16 bytes for each edge in the batch, which is at most about a fifth of the edges, twice while it is sorted;
//! 256 KiB for the histogram.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::collapse::{Candidate, Engine, Outcome, hash_pair};
use super::metric::CollapseMetric;

/// Share of the live keys that one round takes on. Larger ones cost quality: 0.35 adds 6 % to the error at 1 % of the
/// triangles on some meshes (measured).
const QUANTILE: f64 = 0.2;

/// The quantile of a mesh of more triangles than this is taken from a sample of about as many.
const SAMPLED_TRIANGLES: usize = 1 << 15;

/// Key bits are counted by their leading 16 bits below the sign.
const BIN_SHIFT: u32 = 15;
const BINS: usize = 1 << 16;

/// Runs rounds until no candidate is left.
pub(super) fn run<M: CollapseMetric>(engine: &mut Engine<M>, progress: &mut dyn FnMut(f64)) {
    let first_round = engine.round() + 1;
    let mut histogram = vec![0_u32; BINS];
    let mut batch: Vec<Candidate> = Vec::new();
    let mut waiting: BinaryHeap<Reverse<Candidate>> = BinaryHeap::new();
    let mut limit: Option<u32> = None;
    loop {
        let round = engine.next_round();
        let next = next_limit(engine, limit, &mut histogram);
        // In the first round every key counts as above the last limit.
        let touched = if round == first_round { None } else { Some(round - 1) };
        let Some(this_limit) = next.or(limit) else { return };
        collect(engine, limit, this_limit, touched, &mut batch);
        if batch.is_empty() && next.is_none() {
            return;
        }
        limit = Some(this_limit);
        process(engine, &batch, this_limit, &mut waiting);
        progress(engine.share_done());
    }
}

/// The quantile of the keys above the last limit; `None` where there are none.
fn next_limit<M: CollapseMetric>(engine: &Engine<M>, last: Option<u32>, histogram: &mut [u32]) -> Option<u32> {
    let live = engine.mesh.live_triangles();
    let shift = (live / SAMPLED_TRIANGLES).max(1).ilog2();
    match quantile(engine, last, shift, histogram) {
        // A sample that holds nothing above the limit does not say that there is nothing.
        None if shift > 0 => quantile(engine, last, 0, histogram),
        limit => limit,
    }
}

fn quantile<M: CollapseMetric>(
    engine: &Engine<M>,
    last: Option<u32>,
    shift: u32,
    histogram: &mut [u32],
) -> Option<u32> {
    let mesh = &engine.mesh;
    let (mut count, mut lowest, mut highest) = (0_u32, BINS, 0);
    for (triangle, corners) in mesh.triangles.iter().enumerate() {
        let canonical = mesh.canonical_triangle[triangle];
        if !mesh.is_live(triangle) || (shift > 0 && hash_pair(canonical, canonical) >> (32 - shift) != 0) {
            continue;
        }
        for side in 0..3 {
            let directions = engine.directions(corners[side], corners[(side + 1) % 3]);
            for key in [directions.cheaper.0, directions.dearer.0] {
                if last.is_none_or(|last| key > last) {
                    let bin = (key >> BIN_SHIFT) as usize;
                    histogram[bin] += 1;
                    count += 1;
                    lowest = lowest.min(bin);
                    highest = highest.max(bin);
                    // Only the cheaper key of an edge counts, unless it was passed already.
                    break;
                }
            }
        }
    }
    if count == 0 {
        return None;
    }
    let target = (f64::from(count) * QUANTILE).ceil() as u32;
    let (mut below, mut found) = (0, highest);
    for (bin, count) in histogram.iter().enumerate().take(highest + 1).skip(lowest) {
        below += count;
        if below >= target {
            found = bin;
            break;
        }
    }
    histogram[lowest..=highest].fill(0);
    Some((((found as u32) + 1) << BIN_SHIFT) - 1)
}

/// The batch of a round, sorted.
fn collect<M: CollapseMetric>(
    engine: &Engine<M>,
    last: Option<u32>,
    limit: u32,
    touched: Option<u32>,
    batch: &mut Vec<Candidate>,
) {
    let mesh = &engine.mesh;
    batch.clear();
    for (triangle, corners) in mesh.triangles.iter().enumerate() {
        if !mesh.is_live(triangle) {
            continue;
        }
        for side in 0..3 {
            let (a, b) = (corners[side], corners[(side + 1) % 3]);
            let ends = [&mesh.vertices[a as usize], &mesh.vertices[b as usize]];
            // A regular edge runs upwards in exactly one of its two triangles. Others may do anything.
            if a > b && !ends.iter().all(|end| end.is_special()) {
                continue;
            }
            let changed = touched.is_some_and(|round| ends.iter().any(|end| end.touched() == round));
            let fresh = |key: u32| changed || last.is_none_or(|last| key > last);
            let directions = engine.directions(a, b);
            let (cheaper, dearer) = (directions.cheaper.0, directions.dearer.0);
            if cheaper > limit {
                continue;
            }
            if fresh(cheaper) {
                batch.push(engine.candidate(&directions));
            } else if dearer <= limit && fresh(dearer) {
                batch.push(engine.dearer_candidate(&directions));
            }
        }
    }
    batch.sort_unstable();
    batch.dedup();
}

/// Processes a batch in order, with those that must wait again merged in at their new keys.
fn process<M: CollapseMetric>(
    engine: &mut Engine<M>,
    batch: &[Candidate],
    limit: u32,
    waiting: &mut BinaryHeap<Reverse<Candidate>>,
) {
    let mut batch = batch.iter().copied().peekable();
    loop {
        let from_heap = match (batch.peek(), waiting.peek()) {
            (None, None) => return,
            (Some(next), Some(Reverse(top))) => top < next,
            (next, _) => next.is_none(),
        };
        let candidate = if from_heap { waiting.pop().map(|top| top.0) } else { batch.next() };
        let Some(candidate) = candidate else { return };
        match engine.attempt(candidate) {
            Outcome::Grown(again) | Outcome::OtherWay(again) if again.key <= limit => waiting.push(Reverse(again)),
            _ => {}
        }
    }
}
