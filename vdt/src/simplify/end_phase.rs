//! Brings what no legal collapse can reduce down to one root per component: closed parts that ended as tetrahedra, loops
//! around holes, non-manifold knots (design, section 3).
//!
//! It begins at a point that the state defines, when no legal candidate is left, never "when it fits in memory". The
//! same rounds go on without legality tests, until no triangle is left. The collapse with which the last triangle of a
//! connected part vanishes has the part's diameter as its switch value: its error is its size. What is then left of a
//! part, single vertices, is joined to one root, neighbours in canonical order first.

use crate::ingest::{CoreMesh, power_of_two};

use super::collapse::Engine;
use super::metric::CollapseMetric;
use super::rounds;

/// The connected parts of a mesh, watched for the moment at which they vanish.
#[derive(Debug, Default)]
pub(super) struct Parts {
    /// Part of each canonical vertex; empty before the end phase.
    part_of: Vec<u32>,
    /// Triangles left of each part.
    triangles: Vec<u32>,
    /// Diameter of each part, normalised: the diagonal of the box of its vertices in the input.
    diameter: Vec<f32>,
}

impl Parts {
    /// Takes `count` triangles off the part of a vertex. Returns the least switch value of the collapse that did it:
    /// the part's diameter when it has vanished, else 0.
    pub fn lose(&mut self, vertex: u32, count: usize) -> f32 {
        let Some(part) = self.part_of.get(vertex as usize) else { return 0.0 };
        let left = &mut self.triangles[*part as usize];
        *left -= count as u32;
        if *left == 0 { self.diameter[*part as usize] } else { 0.0 }
    }

    /// The parts of what is left of the mesh, with the diameters that they had in the input.
    fn of<M: CollapseMetric>(engine: &Engine<M>, input: &CoreMesh) -> Self {
        let mesh = &engine.mesh;
        let mut sets = DisjointSets::new(mesh.vertices.len());
        for corners in (0..mesh.triangles.len()).filter(|t| mesh.is_live(*t)).map(|t| mesh.triangles[t]) {
            sets.unite(corners[0], corners[1]);
            sets.unite(corners[0], corners[2]);
        }
        // Parts are numbered by their smallest canonical vertex that is left.
        let mut part_of_local = vec![u32::MAX; mesh.vertices.len()];
        let mut part_of = vec![u32::MAX; input.positions.len()];
        let mut parts = 0;
        for vertex in (0..mesh.vertices.len() as u32).filter(|vertex| !mesh.vertices[*vertex as usize].is_gone()) {
            let representative = sets.find(vertex) as usize;
            if part_of_local[representative] == u32::MAX {
                part_of_local[representative] = parts;
                parts += 1;
            }
            part_of[mesh.canonical_vertex[vertex as usize] as usize] = part_of_local[representative];
        }
        let mut triangles = vec![0; parts as usize];
        for corners in (0..mesh.triangles.len()).filter(|t| mesh.is_live(*t)).map(|t| mesh.triangles[t]) {
            triangles[part_of[mesh.canonical_vertex[corners[0] as usize] as usize] as usize] += 1;
        }
        // A vertex that is gone belongs to the part of the one that it went to, which went later or is left.
        for collapse in engine.collapses().iter().rev() {
            part_of[collapse.born as usize] = part_of[collapse.kept as usize];
        }
        let mut boxes = vec![([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]); parts as usize];
        for (part, position) in part_of.iter().zip(&input.positions) {
            let (minimum, maximum) = &mut boxes[*part as usize];
            for axis in 0..3 {
                minimum[axis] = minimum[axis].min(position[axis]);
                maximum[axis] = maximum[axis].max(position[axis]);
            }
        }
        let diagonal = |(minimum, maximum): &([f32; 3], [f32; 3])| {
            let square = |axis: usize| {
                let extent = f64::from(maximum[axis]) - f64::from(minimum[axis]);
                extent * extent
            };
            ((square(0) + square(1) + square(2)).sqrt() / power_of_two(input.exponent)) as f32
        };
        Parts { part_of, triangles, diameter: boxes.iter().map(diagonal).collect() }
    }
}

/// Union-find with path halving; the smaller number represents.
struct DisjointSets {
    parent: Vec<u32>,
}

impl DisjointSets {
    fn new(count: usize) -> Self {
        DisjointSets { parent: (0..count as u32).collect() }
    }

    fn find(&mut self, mut element: u32) -> u32 {
        while self.parent[element as usize] != element {
            let grandparent = self.parent[self.parent[element as usize] as usize];
            self.parent[element as usize] = grandparent;
            element = grandparent;
        }
        element
    }

    fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }
}

/// Runs the end phase on what is left of `input`.
pub(super) fn run<M: CollapseMetric>(engine: &mut Engine<M>, input: &CoreMesh, progress: &mut dyn FnMut(f64)) {
    engine.relax(Parts::of(engine, input));
    rounds::run(engine, progress);
    join_remains(engine);
}

/// Joins the vertices that are left of each part to one root: neighbours in canonical order, then the results, and so
/// on, so that the tree stays flat. No triangle is left to be moved by that.
fn join_remains<M: CollapseMetric>(engine: &mut Engine<M>) {
    let part_of = std::mem::take(&mut engine.parts_mut().part_of);
    let diameter = std::mem::take(&mut engine.parts_mut().diameter);
    let mut switch_of = vec![0.0_f32; part_of.len()];
    let mut is_left = vec![true; part_of.len()];
    for collapse in engine.collapses() {
        is_left[collapse.born as usize] = false;
        switch_of[collapse.kept as usize] = collapse.switch;
    }
    let mut remains: Vec<Vec<u32>> = vec![Vec::new(); diameter.len()];
    for vertex in (0..part_of.len()).filter(|vertex| is_left[*vertex]) {
        remains[part_of[vertex] as usize].push(vertex as u32);
    }
    for (part, mut vertices) in remains.into_iter().enumerate() {
        let own = vertices.iter().map(|vertex| switch_of[*vertex as usize]).fold(0.0, f32::max);
        let switch = own.max(engine.in_mesh_units(diameter[part]));
        while vertices.len() > 1 {
            for pair in vertices.chunks_exact(2) {
                engine.join(pair[0], pair[1], switch);
            }
            vertices = vertices.into_iter().step_by(2).collect();
        }
    }
}
