//! A simplification done over again on one list of triangles, with every rule asked in the slowest way that is sure.

use std::collections::{BTreeMap, BTreeSet};

/// A mesh that is a list of triangles, and nothing else.
#[derive(Debug, Clone, Default)]
pub struct PlainMesh {
    /// Positions by vertex.
    pub positions: Vec<[f64; 3]>,
    /// What is left of each triangle; `None` once it is gone.
    pub triangles: Vec<Option<[u32; 3]>>,
}

type Directed = (u32, u32);

impl PlainMesh {
    /// From lists.
    pub fn new(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Self {
        PlainMesh {
            positions: positions.iter().map(|p| p.map(f64::from)).collect(),
            triangles: triangles.iter().copied().map(Some).collect(),
        }
    }

    fn star(&self, vertex: u32) -> Vec<[u32; 3]> {
        self.triangles.iter().flatten().copied().filter(|corners| corners.contains(&vertex)).collect()
    }

    fn neighbours(&self, vertex: u32) -> BTreeSet<u32> {
        self.star(vertex).into_iter().flatten().filter(|other| *other != vertex).collect()
    }

    /// Whether the edge has exactly two triangles, that run along it in opposite directions.
    fn is_regular(&self, a: u32, b: u32) -> bool {
        let runs = |from: u32, to: u32| {
            let along = |corners: &&[u32; 3]| (0..3).any(|side| (corners[side], corners[(side + 1) % 3]) == (from, to));
            self.triangles.iter().flatten().filter(along).count()
        };
        runs(a, b) == 1 && runs(b, a) == 1
    }

    fn is_special(&self, vertex: u32) -> bool {
        self.neighbours(vertex).into_iter().any(|other| !self.is_regular(vertex, other))
    }

    /// Why collapsing `gone` onto `stays` would break a rule, if it would.
    pub fn objection(&self, gone: u32, stays: u32) -> Option<&'static str> {
        let apexes: Vec<u32> = self
            .star(gone)
            .into_iter()
            .filter(|corners| corners.contains(&stays))
            .flat_map(|corners| corners.into_iter().filter(|corner| *corner != gone && *corner != stays))
            .collect();
        let apex_set: BTreeSet<u32> = apexes.iter().copied().collect();
        if apexes.is_empty() {
            return Some("no edge");
        }
        if apex_set.len() != apexes.len() {
            return Some("two triangles with the same corners");
        }
        let mut common = &self.neighbours(gone) & &self.neighbours(stays);
        common.remove(&gone);
        common.remove(&stays);
        if common != apex_set {
            return Some("a common neighbour that is no apex");
        }
        let opposite = |vertex: u32| -> BTreeSet<BTreeSet<u32>> {
            self.star(vertex).iter().map(|corners| corners.iter().copied().filter(|c| *c != vertex).collect()).collect()
        };
        if opposite(gone).intersection(&opposite(stays)).next().is_some() {
            return Some("an edge opposite to both ends");
        }
        if self.is_special(gone) && self.is_regular(gone, stays) {
            return Some("a special vertex leaves its line");
        }
        if self.is_special(gone) && self.is_special(stays) {
            let lost = apex_set.iter().any(|apex| !self.is_regular(gone, *apex) && !self.is_regular(stays, *apex));
            if lost {
                return Some("a triangle between special edges vanishes");
            }
        }
        let fold = self.star(gone).into_iter().filter(|corners| !corners.contains(&stays)).any(|corners| {
            let moved = corners.map(|corner| if corner == gone { stays } else { corner });
            let (old, new) = (self.normal(corners), self.normal(moved));
            let length = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
            let turn: f64 = (0..3).map(|axis| old[axis] * new[axis]).sum();
            let longest = (0..3)
                .map(|side| {
                    let [p, q] = [corners[side], corners[(side + 1) % 3]].map(|c| self.positions[c as usize]);
                    length([p[0] - q[0], p[1] - q[1], p[2] - q[2]])
                })
                .fold(0.0, f64::max);
            // Needles are a matter of rounding; what is surely not one must not turn over.
            length(old) > 1e-3 * longest * longest && turn < 0.19 * length(old) * length(new)
        });
        fold.then_some("a triangle folds over")
    }

    fn normal(&self, corners: [u32; 3]) -> [f64; 3] {
        let [a, b, c] = corners.map(|corner| self.positions[corner as usize]);
        let (u, v) = ([b[0] - a[0], b[1] - a[1], b[2] - a[2]], [c[0] - a[0], c[1] - a[1], c[2] - a[2]]);
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    }

    /// Moves everything at `gone` to `stays`. Returns the triangles that vanish.
    pub fn collapse(&mut self, gone: u32, stays: u32) -> Vec<usize> {
        let mut vanished = Vec::new();
        for (index, slot) in self.triangles.iter_mut().enumerate() {
            let Some(corners) = slot else { continue };
            if !corners.contains(&gone) {
                continue;
            }
            if corners.contains(&stays) {
                vanished.push(index);
                *slot = None;
            } else {
                corners.iter_mut().filter(|corner| **corner == gone).for_each(|corner| *corner = stays);
            }
        }
        vanished
    }

    /// The connected components of the triangles, over shared vertices.
    pub fn component_count(&self) -> usize {
        let mut component: BTreeMap<u32, u32> = BTreeMap::new();
        self.triangles.iter().flatten().flatten().for_each(|corner| {
            component.insert(*corner, *corner);
        });
        loop {
            let mut changed = false;
            for corners in self.triangles.iter().flatten() {
                let least = corners.iter().map(|corner| component[corner]).min().unwrap_or(0);
                for corner in corners {
                    changed |= component.insert(*corner, least) != Some(least);
                }
            }
            if !changed {
                return component.values().collect::<BTreeSet<_>>().len();
            }
        }
    }

    /// The directed edges that more than one triangle runs along.
    pub fn doubled_edges(&self) -> BTreeSet<Directed> {
        let mut seen = BTreeSet::new();
        let edges = self.triangles.iter().flatten().flat_map(|c| [(c[0], c[1]), (c[1], c[2]), (c[2], c[0])]);
        edges.filter(|edge| !seen.insert(*edge)).collect()
    }
}
