//! Logs of simplifications that no engine made: any two vertices of a component collapse, in any order. Their trees are
//! deep or flat, many collapses have the same switch value, and the log is in any order in which children come before their
//! parents.

use std::collections::BTreeMap;

use storage::{Scatter, Scratch, Spool};
use vdt::ingest::{CoreMesh, FileCounts, MeshBlock, StoredMesh};
use vdt::simplify::log::{LoggedCollapse, LoggedRoot, Simplified};
use vdt::tree::{Normal, NormalCone, enclosing_radius, id_after};

use crate::random_mesh::Random;
use crate::replay::PlainMesh;

/// A mesh and what a simplification of it wrote down.
#[derive(Debug, Clone)]
pub struct RandomLog {
    /// The mesh.
    pub mesh: CoreMesh,
    /// The collapses, one after the other.
    pub collapses: Vec<LoggedCollapse>,
    /// For each triangle the vertex that went when it vanished.
    pub deaths: Vec<u32>,
    /// What was left, by ascending vertex.
    pub roots: Vec<LoggedRoot>,
}

/// What a vertex stands for.
#[derive(Debug, Clone, Copy)]
struct Node {
    leaves: u32,
    split: u32,
    id: u32,
    radius: f32,
}

impl RandomLog {
    /// Collapses the components of a mesh in random order. `deep` of 8 collapses go on with the last one's vertex, which
    /// makes for deep trees.
    pub fn new(mesh: CoreMesh, deep: usize, seed: u64) -> Self {
        let random = &mut Random(seed);
        let mut plain = PlainMesh::new(&mesh.positions, &mesh.triangles);
        let mut parts = components(&mesh);
        let leaf = Node { leaves: 1, split: 0, id: 0, radius: 0.0 };
        let normals: Vec<Normal> =
            mesh.positions.iter().map(|_| Normal::encode([(); 3].map(|()| random.signed()))).collect();
        let mut nodes = vec![leaf; mesh.positions.len()];
        let mut deaths = vec![u32::MAX; mesh.triangles.len()];
        let mut collapses: Vec<LoggedCollapse> = Vec::new();
        let mut open: Vec<usize> = (0..parts.len()).filter(|part| parts[*part].len() > 1).collect();
        while !open.is_empty() {
            let chosen = random.below(open.len());
            let part = &mut parts[open[chosen]];
            let last = part.len() - 1;
            let kept_at = if random.below(8) < deep { last } else { random.below(part.len()) };
            let kept = part.swap_remove(kept_at);
            let born_at = random.below(part.len());
            let mut pair = [kept, part.swap_remove(born_at)];
            if random.below(8) >= deep {
                pair.reverse();
            }
            let [kept, born] = pair;
            part.push(kept);
            if part.len() == 1 {
                open.swap_remove(chosen);
            }
            let [kept_node, born_node] = pair.map(|vertex| nodes[vertex as usize]);
            let [from, to] = pair.map(|vertex| mesh.positions[vertex as usize]);
            let collapse = LoggedCollapse {
                kept,
                born,
                kept_leaves: kept_node.leaves,
                kept_split: kept_node.split,
                born_split: born_node.split,
                id: id_after(1.0 + random.below(9) as f32, kept_node.id.max(born_node.id)),
                radius: enclosing_radius(from, kept_node.radius, to, born_node.radius),
                cone: random_cone(random).to_word(),
                normal: normals[born as usize],
            };
            nodes[kept as usize] = Node {
                leaves: kept_node.leaves + born_node.leaves,
                split: kept_node.leaves,
                id: collapse.id,
                radius: collapse.radius,
            };
            plain.collapse(born, kept).into_iter().for_each(|triangle| deaths[triangle] = born);
            collapses.push(collapse);
        }
        let mut roots: Vec<LoggedRoot> = parts
            .iter()
            .map(|part| {
                let Node { leaves, split, .. } = nodes[part[0] as usize];
                let (vertex, normal) = (part[0], normals[part[0] as usize]);
                LoggedRoot { vertex, leaves, split, outward: random.below(3) as i8 - 1, normal }
            })
            .collect();
        roots.sort_by_key(|root| root.vertex);
        RandomLog { mesh, collapses, deaths, roots }
    }

    /// The mesh as the build has it.
    pub fn stored_mesh(&self) -> StoredMesh {
        StoredMesh {
            positions: Spool::from_vec(self.mesh.positions.clone()),
            triangles: Spool::from_vec(self.mesh.triangles.clone()),
            blocks: vec![MeshBlock { first_vertex: 0, first_triangle: 0 }],
            seam_vertices: Spool::from_vec(Vec::new()),
            bounds: [[0.0; 3]; 2],
            origin: self.mesh.origin,
            exponent: self.mesh.exponent,
            kept_as: self.mesh.kept_as,
            lattice_step: self.mesh.lattice_step,
            cleaning: self.mesh.cleaning,
            input_error: self.mesh.input_error,
            files: FileCounts::default(),
            attributes: None,
            missing_files: Vec::new(),
        }
    }

    /// What the engine would hand on, with the log in a random order that has children before their parents.
    pub fn simplified(&self, seed: u64) -> Simplified {
        let random = &mut Random(seed);
        let mut waiting = self.collapses.clone();
        let mut log = Vec::new();
        while !waiting.is_empty() {
            // Some collapse that touches no vertex of an earlier one that waits.
            let chosen = random.below(waiting.len());
            let touches = |collapse: &LoggedCollapse, other: &LoggedCollapse| {
                [other.kept, other.born].iter().any(|vertex| [collapse.kept, collapse.born].contains(vertex))
            };
            let mut first = chosen;
            while let Some(earlier) = (0..first).find(|earlier| touches(&waiting[*earlier], &waiting[first])) {
                first = earlier;
            }
            log.push(waiting.remove(first));
        }
        let mut deaths = Scatter::new(&Scratch::in_memory(), "deaths", self.deaths.len() as u64, 1 << 20);
        for (triangle, death) in self.deaths.iter().enumerate() {
            deaths.put(triangle as u32, *death).unwrap();
        }
        Simplified {
            log: Spool::from_vec(log),
            deaths: deaths.finish().unwrap(),
            roots: self.roots.clone(),
            wedge_images: Spool::from_vec(Vec::new()),
            rounds: 1,
            legal_collapses: 0,
            spanned: None,
        }
    }
}

fn random_cone(random: &mut Random) -> NormalCone {
    NormalCone { axis: [0; 3].map(|_: i8| (random.below(255) as i32 - 127) as i8), sine: random.below(256) as u8 }
}

/// The vertices of each component.
fn components(mesh: &CoreMesh) -> Vec<Vec<u32>> {
    let mut part_of: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    loop {
        let before = part_of.clone();
        for corners in &mesh.triangles {
            let least = corners.iter().map(|corner| part_of[*corner as usize]).min().unwrap();
            corners.iter().for_each(|corner| part_of[*corner as usize] = least);
        }
        if before == part_of {
            break;
        }
    }
    let mut parts: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (vertex, part) in part_of.iter().enumerate() {
        parts.entry(*part).or_default().push(vertex as u32);
    }
    parts.into_values().collect()
}
