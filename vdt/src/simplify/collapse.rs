//! One collapse: tried, made, and written down.
//!
//! A candidate is an edge with the key that it had when it was put on a list. When its turn comes, the key is computed
//! again: quadrics only grow, so a candidate whose key has grown goes back and waits (and where rounding would make a
//! key shrink, the old one stands). The cheaper direction is tried first; where it is not legal, the other direction
//! becomes a candidate of its own, with its own key.
//!
//! *Switch values* are monotone over the dependency DAG, not only over the tree: a collapse takes the maximum of its own
//! error, of the switch values of the collapses that last rewrote the triangles around the vertex that goes or took one
//! away from there, and of its two child nodes (`facts/error.md`, section 2). So every triangle of a uniform cut is one
//! that the construction went through, corner for corner, and uniform cuts need no forced split. (The legality tests also
//! read the star of the vertex that stays. To be monotone over that too was measured: switch values 3 to 8 % larger, and
//! on three scans not one edge of the uniform cuts less used twice.)

use crate::ingest::CoreMesh;

use super::History;
use super::end_phase::Parts;
use super::legality::{Rings, Verdict};
use super::live_mesh::LiveMesh;
use super::metric::CollapseMetric;

/// Switch values start here, in units of the normalised mesh (which is between a half and one wide): flat regions have
/// no error but rounding noise, and "split where the switch value is above 0" must still split everything.
const SMALLEST_SWITCH: f32 = 1.0 / (1_u64 << 33) as f32;

/// A collapse, as the history has it. Vertices are named by canonical ids.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Collapse {
    /// The vertex that stays, and gives the new node its position.
    pub kept: u32,
    /// The vertex that goes: born again when the node is split.
    pub born: u32,
    /// Switch value of the new node, in mesh units.
    pub switch: f32,
}

/// An edge that waits for its collapse. Ordered by key, then by a hash of the canonical ids (in id order, flat regions
/// would be eaten up from one side), then by the ids.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Candidate {
    /// Bits of the key, an f32 that is not negative: they order as the keys do.
    pub key: u32,
    tie: u32,
    low: u32,
    /// The larger vertex, and in the top bit whether the dearer direction is meant.
    high: u32,
}

/// Top bit of [`Candidate::high`].
const DEARER: u32 = 1 << 31;

impl Candidate {
    /// Its two ends, the smaller one first.
    pub fn vertices(&self) -> (u32, u32) {
        (self.low, self.high & !DEARER)
    }

    fn is_dearer(&self) -> bool {
        self.high & DEARER != 0
    }

    /// The same candidate at the key of the dearer direction.
    fn dearer(self, key: u32) -> Self {
        Candidate { key, high: self.high | DEARER, ..self }
    }
}

/// The two directions of an edge, the cheaper one first. Ties go to collapsing the larger id onto the smaller.
#[derive(Debug, Clone, Copy)]
pub(super) struct Directions {
    /// Key bits, vertex that goes, vertex that stays.
    pub cheaper: (u32, u32, u32),
    pub dearer: (u32, u32, u32),
}

/// What became of a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outcome {
    /// One of its ends is gone, or the edge is.
    Gone,
    /// Its key has grown: to be tried again at the new one.
    Grown(Candidate),
    /// Not legal this way; the other direction may be tried.
    OtherWay(Candidate),
    /// Not legal in either direction.
    Illegal,
    /// Collapsed onto this vertex.
    Collapsed {
        /// The vertex that stayed.
        stays: u32,
    },
}

/// Which rules a collapse must keep.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rules {
    /// All legality tests.
    Strict,
    /// None: the end phase.
    Relaxed,
}

/// The mesh being simplified, with everything written down so far.
pub(super) struct Engine<M> {
    pub mesh: LiveMesh,
    metric: M,
    rules: Rules,
    parts: Parts,
    rings: Rings,
    dead: Vec<(u32, u32)>,
    round: u32,
    collapses: Vec<Collapse>,
    death: Vec<u32>,
    regular: Vec<bool>,
    /// Mesh units per normalised unit.
    unit: f64,
}

/// A hash of two numbers, the same for either order when the caller sorts them. (The finaliser of SplitMix64.)
pub(super) fn hash_pair(low: u32, high: u32) -> u32 {
    let mut bits = (u64::from(low) << 32 | u64::from(high)).wrapping_add(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (bits ^ (bits >> 31)) as u32
}

impl<M: CollapseMetric> Engine<M> {
    pub fn new(mesh: &CoreMesh, metric: M) -> Self {
        let live = LiveMesh::new(mesh, metric.uses_quadrics());
        let regular = live.vertices.iter().map(|vertex| !vertex.is_special()).collect();
        Engine {
            mesh: live,
            metric,
            rules: Rules::Strict,
            parts: Parts::default(),
            rings: Rings::default(),
            dead: Vec::new(),
            round: 0,
            collapses: Vec::with_capacity(mesh.positions.len()),
            death: vec![u32::MAX; mesh.triangles.len()],
            regular,
            unit: crate::ingest::power_of_two(mesh.exponent),
        }
    }

    pub fn collapse_count(&self) -> usize {
        self.collapses.len()
    }

    pub fn collapses(&self) -> &[Collapse] {
        &self.collapses
    }

    pub fn round(&self) -> u32 {
        self.round
    }

    /// Share of the vertices that are gone.
    pub fn share_done(&self) -> f64 {
        self.collapses.len() as f64 / self.regular.len().max(1) as f64
    }

    /// From now on no legality is asked, and parts are watched for the moment at which they vanish.
    pub fn relax(&mut self, parts: Parts) {
        self.rules = Rules::Relaxed;
        self.parts = parts;
    }

    pub fn next_round(&mut self) -> u32 {
        self.round += 1;
        self.mesh.compact();
        self.round
    }

    /// Both directions of the edge between two vertices.
    #[inline]
    pub fn directions(&self, a: u32, b: u32) -> Directions {
        let d = self.mesh.displacement(a, b);
        let back = [-d[0], -d[1], -d[2]];
        let (vertex_a, vertex_b) = (&self.mesh.vertices[a as usize], &self.mesh.vertices[b as usize]);
        let a_onto_b = (self.metric.key(&vertex_a.quadric, &vertex_b.quadric, d).to_bits(), a, b);
        let b_onto_a = (self.metric.key(&vertex_b.quadric, &vertex_a.quadric, back).to_bits(), b, a);
        // Equal keys: the larger id goes.
        if (a_onto_b.0, b) < (b_onto_a.0, a) {
            Directions { cheaper: a_onto_b, dearer: b_onto_a }
        } else {
            Directions { cheaper: b_onto_a, dearer: a_onto_b }
        }
    }

    /// The candidate for the cheaper direction of an edge.
    #[inline]
    pub fn candidate(&self, directions: &Directions) -> Candidate {
        let (key, a, b) = directions.cheaper;
        let (low, high) = (a.min(b), a.max(b));
        let canonical = |vertex: u32| self.mesh.canonical_vertex[vertex as usize];
        Candidate { key, tie: hash_pair(canonical(low), canonical(high)), low, high }
    }

    /// The candidate for the dearer direction of an edge.
    pub fn dearer_candidate(&self, directions: &Directions) -> Candidate {
        self.candidate(directions).dearer(directions.dearer.0)
    }

    /// The turn of a candidate has come.
    pub fn attempt(&mut self, candidate: Candidate) -> Outcome {
        let (low, high) = candidate.vertices();
        if self.mesh.vertices[low as usize].is_gone() || self.mesh.vertices[high as usize].is_gone() {
            return Outcome::Gone;
        }
        let directions = self.directions(low, high);
        let (key, gone, stays) = if candidate.is_dearer() { directions.dearer } else { directions.cheaper };
        if key > candidate.key {
            return Outcome::Grown(Candidate { key, ..candidate });
        }
        let verdict = match self.rules {
            Rules::Strict => self.rings.judge(&self.mesh, gone, stays),
            Rules::Relaxed if self.mesh.edge_use(gone, stays).is_unused() => Verdict::NoEdge,
            Rules::Relaxed => Verdict::Legal,
        };
        match verdict {
            Verdict::Legal => {}
            Verdict::NoEdge => return Outcome::Gone,
            Verdict::Illegal if candidate.is_dearer() => return Outcome::Illegal,
            Verdict::Illegal => return Outcome::OtherWay(candidate.dearer(candidate.key.max(directions.dearer.0))),
        }
        self.collapse(gone, stays);
        Outcome::Collapsed { stays }
    }

    fn collapse(&mut self, gone: u32, stays: u32) {
        let d = self.mesh.displacement(gone, stays);
        let gone_quadric = self.mesh.vertices[gone as usize].quadric;
        let own = self.metric.error(&gone_quadric, &self.mesh.vertices[stays as usize].quadric, d);
        let own = match self.rules {
            Rules::Strict => own,
            Rules::Relaxed => own.max(end_phase_error(&self.mesh, gone, stays)),
        };
        let nodes = self.mesh.node_switch[gone as usize].max(self.mesh.node_switch[stays as usize]);
        let star = self.mesh.star(gone).iter();
        let rewriters = star.map(|triangle| self.mesh.triangle_switch[*triangle as usize]).fold(0.0, f32::max);
        let lost = self.mesh.star_switch[gone as usize];
        let mut switch = own.max(nodes).max(rewriters).max(lost).max(SMALLEST_SWITCH);

        let stays_quadric = &mut self.mesh.vertices[stays as usize].quadric;
        self.metric.merge(&gone_quadric, stays_quadric, d);
        self.mesh.touch_ring(gone, self.round);
        let moved = self.mesh.contract(gone, stays, &mut self.dead);

        let [gone_id, stays_id] = [gone, stays].map(|vertex| self.mesh.canonical_vertex[vertex as usize]);
        switch = switch.max(self.parts.lose(stays_id, self.dead.len()));
        self.mesh.node_switch[stays as usize] = switch;
        let collapse = self.collapses.len() as u32;
        for (triangle, apex) in &self.dead {
            self.death[self.mesh.canonical_triangle[*triangle as usize] as usize] = collapse;
            let lost = &mut self.mesh.star_switch[*apex as usize];
            *lost = lost.max(switch);
        }
        self.mesh.rewrite_last(stays, moved, switch);
        self.collapses.push(Collapse { kept: stays_id, born: gone_id, switch: self.in_mesh_units(switch) });
    }

    /// The parts that the end phase watches.
    pub fn parts_mut(&mut self) -> &mut Parts {
        &mut self.parts
    }

    /// Writes down the union of two vertices that no triangle is left at (the end of the end phase). The switch value
    /// is in mesh units.
    pub fn join(&mut self, kept: u32, born: u32, switch: f32) {
        self.collapses.push(Collapse { kept, born, switch });
    }

    /// A power of two, so the order of switch values survives; where the mesh is so small that they would vanish, the
    /// smallest number that does not.
    pub fn in_mesh_units(&self, switch: f32) -> f32 {
        ((f64::from(switch) * self.unit) as f32).clamp(f32::MIN_POSITIVE, f32::MAX)
    }

    pub fn into_history(self, legal: usize, rounds: u32) -> History {
        History { collapses: self.collapses, death: self.death, regular: self.regular, legal, rounds }
    }
}

/// How far a collapse without legality tests can move or swallow the surface: the length of the edge, and of the
/// longest side of every triangle that vanishes with it (nothing may be left where it was).
fn end_phase_error(mesh: &LiveMesh, gone: u32, stays: u32) -> f32 {
    let length = |a: u32, b: u32| {
        let d = mesh.displacement(a, b);
        (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
    };
    let mut longest = length(gone, stays);
    for triangle in mesh.star(gone) {
        let [a, b] = mesh.others(*triangle, gone);
        if a == stays || b == stays {
            longest = longest.max(length(gone, a)).max(length(gone, b)).max(length(a, b));
        }
    }
    longest
}
