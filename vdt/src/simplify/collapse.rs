//! One collapse: tried, made, and written down.
//!
//! A candidate is an edge with the key that it had when it was put on a list. When its turn comes, the key is computed
//! again: quadrics only grow, so a candidate whose key has grown goes back and waits (and where rounding would make a
//! key shrink, the old one stands). The cheaper direction is tried first; where it is not legal, the other direction
//! becomes a candidate of its own, with its own key.
//!
//! Where colours or textures count ([`super::attribute_error`]), keys are *raised* by what the collapse changes on the surface.
//! Raised keys cost more, so they are worked out only when a candidate's turn comes; if the raised key is above the
//! candidate's, it waits as that. Cheaper and dearer are by raised keys, then.
//!
//! *Dependency ids* ([`crate::tree::id_after`]), and with them switch values, are monotone over the dependency DAG, not only
//! over the tree: the id of a collapse has at least the class of its own error, and is above those of the collapses that last
//! rewrote the triangles around the vertex that goes or took one away from there, and of its two child nodes
//! (`facts/error.md`, section 2). So every triangle of a uniform cut is one that the construction went through, corner for
//! corner, and uniform cuts need no forced split. (The legality tests also read the star of the vertex that stays. To be
//! monotone over that too was measured: switch values 3 to 8 % larger, and on three scans not one edge of the uniform cuts
//! less used twice.)
//!
//! What a collapse reads are the stars of its two ends, their quadrics and nodes, and positions and wedges; what it writes are the
//! stars of the ring of the vertex that goes, and the vertex that stays. External passes rest on that (`unsettled`).

use crate::tree::{ErrorBound, NormalCone, enclosing_cone, enclosing_radius, id_after};

use super::attribute_error::AttributeError;
use super::bound::{Rewriter, Rewritten};
use super::legality::{Rings, Verdict};
use super::live_mesh::{LiveMesh, Vertex};
use super::log::{LoggedCollapse, WedgeImage};
use super::metric::CollapseMetric;
use super::wedge_images::WedgeImages;

/// An edge that waits for its collapse. Ordered by key, then by a hash of the canonical ids (in id order, flat regions
/// would be eaten up from one side), then by the ids: local ones, which keep the order of the canonical ones.
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
    /// The cheaper direction of an edge between two vertices, by their local and canonical ids.
    #[inline]
    pub fn of(ends: [u32; 2], canonical: [u32; 2], key: u32) -> Self {
        let [low, high] = if ends[0] < ends[1] { ends } else { [ends[1], ends[0]] };
        let tie = hash_pair(canonical[0].min(canonical[1]), canonical[0].max(canonical[1]));
        Candidate { key, tie, low, high }
    }

    /// Its two ends, the smaller one first.
    #[inline]
    pub fn vertices(&self) -> (u32, u32) {
        (self.low, self.high & !DEARER)
    }

    pub fn is_dearer(&self) -> bool {
        self.high & DEARER != 0
    }

    /// The same candidate at the key of the dearer direction.
    pub fn dearer(self, key: u32) -> Self {
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

/// A direction of an edge with its raised key.
#[derive(Debug, Clone, Copy)]
struct Raised {
    /// Bits of the key.
    key: u32,
    gone: u32,
    stays: u32,
    /// What the collapse changes on the surface, normalised.
    attribute_error: f32,
}

/// What became of a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outcome {
    /// One of its ends is gone, or the edge is.
    Gone,
    /// Its key has grown: it is to wait as this.
    Grown(Candidate),
    /// Its raised key is above its key: it is to wait as this.
    Raised(Candidate),
    /// The cheaper direction is not legal: the other one is to wait as this.
    OtherWay(Candidate),
    /// Neither direction is legal, as things stand.
    Illegal,
    /// Done: an end is gone, and this one is left.
    Collapsed {
        /// The vertex that is left.
        stays: u32,
    },
}

/// What a collapse has to pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rules {
    /// All legality tests.
    Strict,
    /// None: the end phase.
    Relaxed,
}

/// A component in the end phase, watched for the moment at which its last triangle vanishes.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Watched {
    /// Triangles that are left of it.
    pub triangles: u32,
    /// Diameter of the component, normalised: the diagonal of the box of its vertices in the input.
    pub diameter: f32,
}

/// A mesh being simplified, or a part of it, with what was written down of late.
#[derive(Debug)]
pub(super) struct Engine<M> {
    pub mesh: LiveMesh,
    pub metric: M,
    rules: Rules,
    /// The component that the end phase is at.
    pub watched: Watched,
    rings: Rings,
    wedge_rules: WedgeImages,
    attribute_error: AttributeError,
    /// Works out certified errors; none where the metric's are asked for.
    rewriter: Option<Rewriter>,
    dead: Vec<(u32, u32)>,
    /// The round that goes on.
    pub round: u32,
    /// Collapses that the caller has yet to take away.
    pub collapses: Vec<LoggedCollapse>,
    /// Deaths that the caller has yet to take away: triangle, vertex born by the collapse.
    pub deaths: Vec<(u32, u32)>,
    /// Images of wedges that the caller has yet to take away.
    pub wedge_images: Vec<WedgeImage>,
    /// Mesh units per normalised unit.
    unit: f64,
}

/// A hash of two numbers, the same for either order when the caller sorts them. (The finaliser of SplitMix64.)
#[inline]
pub(super) fn hash_pair(low: u32, high: u32) -> u32 {
    let mut bits = (u64::from(low) << 32 | u64::from(high)).wrapping_add(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (bits ^ (bits >> 31)) as u32
}

impl<M: CollapseMetric> Engine<M> {
    /// An engine for (parts of) a mesh that is at most 2^exponent wide.
    pub fn new(mesh: LiveMesh, metric: M, exponent: i32, bound: ErrorBound) -> Self {
        Engine {
            mesh,
            metric,
            rules: Rules::Strict,
            watched: Watched::default(),
            rings: Rings::default(),
            wedge_rules: WedgeImages::default(),
            attribute_error: AttributeError::default(),
            rewriter: bound.is_certified().then(|| Rewriter::new(bound)),
            dead: Vec::new(),
            round: 0,
            collapses: Vec::new(),
            deaths: Vec::new(),
            wedge_images: Vec::new(),
            unit: crate::ingest::power_of_two(exponent),
        }
    }

    /// From now on no legality is asked, and what is watched counts.
    pub fn relax(&mut self) {
        self.rules = Rules::Relaxed;
    }

    /// Lets go of the mesh, and of the memory that it took.
    pub fn release(&mut self) {
        self.mesh.release();
        (self.collapses, self.deaths, self.wedge_images) = Default::default();
    }

    /// Mesh units per normalised unit.
    pub fn unit(&self) -> f64 {
        self.unit
    }

    /// The key bits of the edge between two vertices: of the first one's going, and of the second one's.
    #[inline(always)]
    pub fn edge_keys(&self, a: &Vertex, b: &Vertex) -> [u32; 2] {
        let d: [f32; 3] = std::array::from_fn(|axis| b.position[axis] - a.position[axis]);
        self.metric.keys(&a.quadric, &b.quadric, d).map(f32::to_bits)
    }

    /// Both directions of the edge between two vertices.
    #[inline]
    pub fn directions(&self, a: u32, b: u32) -> Directions {
        let [first, second] = [a, b].map(|end| &self.mesh.vertices[end as usize]);
        let [key_a, key_b] = self.edge_keys(first, second);
        let (a_onto_b, b_onto_a) = ((key_a, a, b), (key_b, b, a));
        // Equal keys: the larger canonical id goes. (Local ids do not keep the order everywhere, see `spanned`.)
        if (key_a, second.id) < (key_b, first.id) {
            Directions { cheaper: a_onto_b, dearer: b_onto_a }
        } else {
            Directions { cheaper: b_onto_a, dearer: a_onto_b }
        }
    }

    /// The candidate for the cheaper direction of an edge.
    #[inline]
    pub fn candidate(&self, a: u32, b: u32) -> Candidate {
        let ends = [a, b].map(|end| &self.mesh.vertices[end as usize]);
        let keys = self.edge_keys(ends[0], ends[1]);
        Candidate::of([a, b], ends.map(|end| end.id), keys[0].min(keys[1]))
    }

    /// The turn of a candidate has come.
    pub fn attempt(&mut self, candidate: Candidate) -> Outcome {
        let (low, high) = candidate.vertices();
        if self.mesh.vertices[low as usize].is_gone() || self.mesh.vertices[high as usize].is_gone() {
            return Outcome::Gone;
        }
        let directions = self.directions(low, high);
        let (key, mut gone, mut stays) = if candidate.is_dearer() { directions.dearer } else { directions.cheaper };
        if key > candidate.key {
            return Outcome::Grown(Candidate { key, ..candidate });
        }
        let mut attribute_error = 0.0;
        if self.mesh.wedges.heeded().counts() {
            if !self.mesh.has_edge(gone, stays) {
                return Outcome::Gone;
            }
            let raised = self.raised(directions, candidate.is_dearer());
            if raised.key > candidate.key {
                return Outcome::Raised(Candidate { key: raised.key, ..candidate });
            }
            Raised { gone, stays, attribute_error, .. } = raised;
        }
        let verdict = match self.rules {
            Rules::Strict => self.rings.judge(&self.mesh, gone, stays),
            Rules::Relaxed => self.rings.look(&self.mesh, gone, stays),
        };
        let verdict = self.with_seams(verdict, gone, stays);
        match verdict {
            Verdict::Legal => {}
            Verdict::NoEdge => return Outcome::Gone,
            Verdict::Illegal if candidate.is_dearer() => return Outcome::Illegal,
            Verdict::Illegal => return Outcome::OtherWay(candidate.dearer(candidate.key.max(directions.dearer.0))),
        }
        self.collapse(gone, stays, attribute_error);
        Outcome::Collapsed { stays }
    }

    /// The direction of an edge that is cheaper by its raised key, or the dearer one. The raised keys of both are only worked out
    /// where that may make a difference.
    fn raised(&mut self, directions: Directions, is_dearer: bool) -> Raised {
        let Directions { cheaper, dearer } = directions;
        let first = self.raise(cheaper);
        if !is_dearer && first.key < dearer.0 {
            return first;
        }
        let second = self.raise(dearer);
        // Equal keys: the larger canonical id goes.
        let order = |raised: &Raised| (raised.key, self.mesh.vertices[raised.stays as usize].id);
        if (order(&second) < order(&first)) != is_dearer { second } else { first }
    }

    /// Raises the key of a direction by its attribute error.
    fn raise(&mut self, (key, gone, stays): (u32, u32, u32)) -> Raised {
        let Engine { mesh, metric, wedge_rules, attribute_error: measure, .. } = self;
        wedge_rules.find(mesh, gone, stays);
        let attribute_error = measure.measure(mesh, gone, stays, wedge_rules.images());
        let [first, second] = [gone, stays].map(|end| &mesh.vertices[end as usize].quadric);
        let key = metric.raised(f32::from_bits(key), first, second, attribute_error).to_bits();
        Raised { key, gone, stays, attribute_error }
    }

    /// What the seams of the texture make of a verdict. Finds what the wedges of `gone` turn into.
    fn with_seams(&mut self, verdict: Verdict, gone: u32, stays: u32) -> Verdict {
        if verdict != Verdict::Legal || !self.mesh.wedges.heeded().seams {
            return verdict;
        }
        self.wedge_rules.find(&self.mesh, gone, stays);
        if self.rules == Rules::Relaxed || self.wedge_rules.keep_seams(&self.mesh, gone, stays) {
            Verdict::Legal
        } else {
            Verdict::Illegal
        }
    }

    /// Collapses `gone`, whose ring and whose wedges' images are at hand, onto `stays`.
    fn collapse(&mut self, gone: u32, stays: u32, attribute_error: f32) {
        let d = self.mesh.displacement(gone, stays);
        let gone_quadric = self.mesh.vertices[gone as usize].quadric;
        let Rewritten { mut error, latest: of_others } = self.error_of(gone, stays, d);
        let born = self.mesh.nodes[gone as usize];
        let kept = self.mesh.nodes[stays as usize];
        let star = self.mesh.star(gone).iter();
        let of_star = star.map(|triangle| self.mesh.triangles[*triangle as usize].order).fold(of_others, u32::max);
        let latest = of_star.max(born.order).max(kept.order).max(born.star_order);
        if self.rules == Rules::Relaxed {
            let lost = self.rings.gone.iter().filter(|pair| pair.contains(&stays)).count() as u32;
            self.watched.triangles -= lost;
            if self.watched.triangles == 0 {
                error = error.max(self.watched.diameter);
            }
        }
        let attribute_error =
            if self.rules == Rules::Relaxed { attribute_error.min(self.watched.diameter) } else { attribute_error };
        let order = id_after(error.max(attribute_error), latest);

        if self.mesh.wedges.heeded().seams {
            self.mesh.rewrite_corners(gone, stays, self.wedge_rules.images());
            self.log_images(gone, stays);
        }
        let stays_quadric = &mut self.mesh.vertices[stays as usize].quadric;
        self.metric.merge(&gone_quadric, stays_quadric, d);
        self.mesh.touch(gone, self.round);
        self.mesh.touch(stays, self.round);
        for corner in self.rings.gone.as_flattened() {
            self.mesh.touch(*corner, self.round);
        }
        self.mesh.contract(gone, stays, &self.rings.gone, order, &mut self.dead);
        if let Some(rewriter) = &mut self.rewriter {
            rewriter.write(&mut self.mesh, order);
        }
        for (triangle, apex) in &self.dead {
            self.deaths.push((self.mesh.triangle_ids[*triangle as usize], born.id));
            let lost = &mut self.mesh.nodes[*apex as usize].star_order;
            *lost = order.max(*lost);
        }
        self.write_down(gone, stays, order);
    }

    /// The error of the collapse of `gone`, whose ring is at hand, onto `stays`, and what it depends on beyond the triangles
    /// around `gone`.
    fn error_of(&mut self, gone: u32, stays: u32, d: [f32; 3]) -> Rewritten {
        let Engine { mesh, metric, rules, rewriter, rings, watched, .. } = self;
        let is_relaxed = *rules == Rules::Relaxed;
        match rewriter {
            Some(rewriter) => {
                // Nothing of a component is farther from what is left of it than it is wide, even if a part of it has
                // vanished. (No legal collapse makes a part vanish.)
                let most = if is_relaxed { watched.diameter } else { f32::MAX };
                let rewritten = rewriter.measure(mesh, gone, stays, &rings.gone);
                let Rewritten { error, latest } = rewritten.unwrap_or(Rewritten { error: most, latest: 0 });
                Rewritten { error: error.min(most), latest }
            }
            None => {
                let [gone_quadric, stays_quadric] = [gone, stays].map(|end| &mesh.vertices[end as usize].quadric);
                let error = metric.error(gone_quadric, stays_quadric, d);
                let error = if is_relaxed { error.max(end_phase_error(mesh, gone, stays, &rings.gone)) } else { error };
                Rewritten { error, latest: 0 }
            }
        }
    }

    /// Logs what the wedges of `gone` turn into, unless there is only one at `stays`.
    fn log_images(&mut self, gone: u32, stays: u32) {
        if self.mesh.wedges.of(stays).len() > 1 {
            let born = self.mesh.nodes[gone as usize].id;
            let images = (0..).zip(self.wedge_rules.images());
            self.wedge_images.extend(images.map(|(wedge, image)| WedgeImage { born, wedge, image: *image as u16 }));
        }
    }

    /// Makes the node of `gone` a child of that of `stays`, and logs it.
    fn write_down(&mut self, gone: u32, stays: u32, order: u32) {
        let born = self.mesh.nodes[gone as usize];
        let node = &mut self.mesh.nodes[stays as usize];
        let radius = enclosing_radius(node.position, node.radius, born.position, born.radius);
        let cone = enclosing_cone(NormalCone::from_word(node.cone), NormalCone::from_word(born.cone)).to_word();
        self.collapses.push(LoggedCollapse {
            kept: node.id,
            born: born.id,
            kept_leaves: node.leaves,
            kept_split: node.last_split,
            born_split: born.last_split,
            id: order,
            radius,
            cone,
            normal: born.normal,
        });
        node.order = order;
        node.last_split = node.leaves;
        node.leaves += born.leaves;
        node.radius = radius;
        node.cone = cone;
    }

    /// Unites two vertices at which no triangle is left (the end of the end phase). The error is normalised; `latest` is the
    /// largest id of what the union depends on besides the two.
    pub fn join(&mut self, kept: u32, born: u32, error: f32, latest: u32) {
        let [of_kept, of_born] = [kept, born].map(|vertex| self.mesh.nodes[vertex as usize].order);
        if self.mesh.wedges.heeded().seams {
            self.wedge_rules.find(&self.mesh, born, kept);
            self.log_images(born, kept);
        }
        self.write_down(born, kept, id_after(error, latest.max(of_kept).max(of_born)));
    }
}

/// How far a collapse without legality tests can move or swallow the surface: the length of the edge, and of the
/// longest side of every triangle that vanishes with it (nothing may be left where it was).
fn end_phase_error(mesh: &LiveMesh, gone: u32, stays: u32, ring: &[[u32; 2]]) -> f32 {
    let length = |a: u32, b: u32| {
        let d = mesh.displacement(a, b);
        (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
    };
    let mut longest = length(gone, stays);
    for [a, b] in ring.iter().filter(|pair| pair.contains(&stays)) {
        longest = longest.max(length(gone, *a)).max(length(gone, *b)).max(length(*a, *b));
    }
    longest
}
