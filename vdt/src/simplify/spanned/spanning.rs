//! The spanning edges of a load, and the sub-meshes that they span (the paper, 3.1.1).
//!
//! A connected component of the spanning edges spans a triangle if one of the triangle's edges is among them, or if all
//! three of its corners are ends of theirs. Components are found by union-find, as edges come in: sub-meshes are created,
//! grow, and merge.
//!
//! Memory: 9 bytes for each loaded vertex, and 16 for each spanning edge.

use std::collections::{HashMap, HashSet};

use crate::simplify::components::DisjointSets;

/// The spanning edges of a load, by local ids.
#[derive(Debug, Default)]
pub(super) struct Spanning {
    components: DisjointSets,
    is_end: Vec<bool>,
    edges: HashSet<(u32, u32)>,
}

/// What the spanning edges of a load span.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Spanned {
    /// Connected components of the spanning edges.
    pub sub_meshes: u64,
    /// Triangles of all of them.
    pub triangles: u64,
    /// Triangles of the largest.
    pub largest: u64,
}

impl Spanning {
    /// Begins anew.
    pub fn clear(&mut self) {
        self.components.clear_to(0);
        self.is_end.clear();
        self.edges.clear();
    }

    /// Adds a spanning edge.
    pub fn add(&mut self, [a, b]: [u32; 2]) {
        let count = self.components.len().max(a.max(b) as usize + 1);
        self.components.grow_to(count);
        self.is_end.resize(count, false);
        self.is_end[a as usize] = true;
        self.is_end[b as usize] = true;
        self.edges.insert((a.min(b), a.max(b)));
        self.components.unite(a, b);
    }

    fn is_end(&self, vertex: u32) -> bool {
        self.is_end.get(vertex as usize).copied().unwrap_or(false)
    }

    /// The component that spans a triangle, by one of its vertices.
    fn spans(&mut self, corners: [u32; 3]) -> Option<u32> {
        let side = (0..3).map(|side| (corners[side], corners[(side + 1) % 3]));
        if let Some((a, _)) = side.into_iter().find(|(a, b)| self.edges.contains(&(*a.min(b), *a.max(b)))) {
            return Some(self.components.find(a));
        }
        if !corners.iter().all(|corner| self.is_end(*corner)) {
            return None;
        }
        let [a, b, c] = corners.map(|corner| self.components.find(corner));
        (a == b && b == c).then_some(a)
    }

    /// What is spanned of these triangles.
    pub fn measure(&mut self, triangles: impl Iterator<Item = [u32; 3]>) -> Spanned {
        let mut sizes: HashMap<u32, u64> = HashMap::new();
        for vertex in 0..self.components.len() as u32 {
            if self.is_end(vertex) {
                let component = self.components.find(vertex);
                sizes.entry(component).or_default();
            }
        }
        for corners in triangles {
            if let Some(component) = self.spans(corners) {
                *sizes.entry(component).or_default() += 1;
            }
        }
        Spanned {
            sub_meshes: sizes.len() as u64,
            triangles: sizes.values().sum(),
            largest: sizes.values().copied().max().unwrap_or(0),
        }
    }
}
