//! May this half-edge be collapsed? Link condition, boundaries and non-manifold edges, fold-overs.
//!
//! The answer reads the stars of the two vertices and positions, nothing else: that is what lets blocks of an external
//! pass decide most collapses without each other (`facts/exact.md`).
//!
//! - *Link condition*: the vertices next to both ends are exactly the apexes of the edge's triangles, each once, and no
//!   edge lies opposite to both ends (a tetrahedron, which would fold into two coincident triangles).
//! - *Special edges*, all that are not shared by exactly two triangles with opposite directions (boundaries,
//!   non-manifold edges, seams of disagreeing orientation): a vertex on one moves along one only, and no triangle may
//!   vanish that has special edges on both of its other sides (that would close a hole, or swallow a part).
//! - *Ears*: a triangle around the vertex that goes is left. (Without one, triangles that the collapse does not move would have
//!   to answer for what vanishes, see `docs/error.md`.)
//! - *Fold-over*: no surviving triangle's normal may turn by more than 78 degrees (cosine 0.2), nor may it become a
//!   needle. Triangles that were needles before are not asked: they would block for ever.

use crate::vector::{cross, dot, minus};

use super::live_mesh::{EdgeUse, LiveMesh, edge_use};

/// Smallest cosine between a triangle's normals before and after a collapse.
const LEAST_COSINE: f64 = 0.2;

/// A triangle whose height over its longest side in question is less than 1e-5 of that side is a needle, without a
/// normal to speak of. Here squared.
const NEEDLE: f64 = 1e-10;

/// Rings with a product of sizes up to this are compared one by one; larger ones are sorted first.
const SMALL_RINGS: usize = 1024;

/// What the tests say of a half-edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It may be collapsed.
    Legal,
    /// It may not.
    Illegal,
    /// There is no such edge.
    NoEdge,
}

/// The rings of the two ends, kept from call to call for their memory.
#[derive(Debug, Default)]
pub(super) struct Rings {
    /// The other two corners of every triangle at the vertex that goes, in the order of its star.
    pub gone: Vec<[u32; 2]>,
    stays: Vec<[u32; 2]>,
    apexes: Vec<u32>,
    gone_sorted: Vec<u32>,
    stays_sorted: Vec<u32>,
}

impl Rings {
    /// Whether `gone` may be collapsed onto `stays`. Fills the ring of `gone`.
    pub fn judge(&mut self, mesh: &LiveMesh, gone: u32, stays: u32) -> Verdict {
        mesh.fill_ring(gone, &mut self.gone);
        self.apexes.clear();
        let mut edge = EdgeUse::default();
        for [next, previous] in &self.gone {
            if *next == stays {
                edge.forward += 1;
                self.apexes.push(*previous);
            } else if *previous == stays {
                edge.backward += 1;
                self.apexes.push(*next);
            }
        }
        if edge.is_unused() {
            return Verdict::NoEdge;
        }
        let [gone_special, stays_special] = [gone, stays].map(|end| mesh.vertices[end as usize].is_special());
        if gone_special && edge.is_regular() || self.apexes.len() == self.gone.len() {
            return Verdict::Illegal;
        }
        mesh.fill_ring(stays, &mut self.stays);
        let legal = self.link_condition(gone, stays, [gone_special, stays_special])
            && (!(gone_special && stays_special) || self.no_special_triangle())
            && self.no_fold_over(mesh, gone, stays);
        if legal { Verdict::Legal } else { Verdict::Illegal }
    }

    /// Whether there is an edge from `gone` to `stays`, without any test. Fills the ring of `gone`.
    pub fn look(&mut self, mesh: &LiveMesh, gone: u32, stays: u32) -> Verdict {
        mesh.fill_ring(gone, &mut self.gone);
        if edge_use(&self.gone, stays).is_unused() { Verdict::NoEdge } else { Verdict::Legal }
    }

    /// `special`: whether the two ends are. All edges of one that is not are regular, so that each of its neighbours
    /// comes next in exactly one triangle.
    fn link_condition(&mut self, gone: u32, stays: u32, special: [bool; 2]) -> bool {
        let apexes = &self.apexes;
        if (1..apexes.len()).any(|index| apexes[..index].contains(&apexes[index])) {
            return false;
        }
        let is_apex = |vertex: u32| apexes.contains(&vertex);
        let common_are_apexes = if special == [false; 2] && self.gone.len() * self.stays.len() <= SMALL_RINGS {
            let is_next_to_stays = |vertex: u32| self.stays.iter().any(|[next, _]| *next == vertex);
            self.gone.iter().all(|[next, _]| *next == stays || is_apex(*next) || !is_next_to_stays(*next))
        } else if self.gone.len() * self.stays.len() <= SMALL_RINGS {
            self.gone
                .as_flattened()
                .iter()
                .all(|vertex| *vertex == stays || is_apex(*vertex) || !self.stays.as_flattened().contains(vertex))
        } else {
            sort_into(&mut self.gone_sorted, &self.gone);
            sort_into(&mut self.stays_sorted, &self.stays);
            self.gone_sorted
                .iter()
                .all(|vertex| *vertex == stays || is_apex(*vertex) || self.stays_sorted.binary_search(vertex).is_err())
        };
        // An edge opposite to both ends joins two common neighbours, that is two apexes.
        common_are_apexes
            && !self.gone.iter().any(|[a, b]| {
                is_apex(*a)
                    && is_apex(*b)
                    && self
                        .stays
                        .iter()
                        .any(|other| (other == &[*a, *b] || other == &[*b, *a]) && !other.contains(&gone))
            })
    }

    /// No triangle of the edge has special edges on both other sides.
    fn no_special_triangle(&self) -> bool {
        self.apexes
            .iter()
            .all(|apex| edge_use(&self.gone, *apex).is_regular() || edge_use(&self.stays, *apex).is_regular())
    }

    fn no_fold_over(&self, mesh: &LiveMesh, gone: u32, stays: u32) -> bool {
        let position = |vertex: u32| mesh.vertices[vertex as usize].position.map(f64::from);
        let (from, to) = (position(gone), position(stays));
        self.gone.iter().filter(|pair| !pair.contains(&stays)).all(|[next, previous]| {
            let (a, b) = (position(*next), position(*previous));
            let opposite = minus(b, a);
            let side = dot(opposite, opposite);
            let old = cross(minus(a, from), minus(b, from));
            let old_square = dot(old, old);
            if old_square <= NEEDLE * side * side {
                return true;
            }
            let new = cross(minus(a, to), minus(b, to));
            let new_square = dot(new, new);
            let turn = dot(old, new);
            new_square > NEEDLE * side * side
                && turn > 0.0
                && turn * turn >= LEAST_COSINE * LEAST_COSINE * old_square * new_square
        })
    }
}

fn sort_into(sorted: &mut Vec<u32>, ring: &[[u32; 2]]) {
    sorted.clear();
    sorted.extend(ring.as_flattened());
    sorted.sort_unstable();
}
