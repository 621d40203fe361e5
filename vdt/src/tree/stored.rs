//! A finished tree as record sequences in leaf order: the same arrays as [`Tree`], on disk where they are large.

use storage::{Spool, StorageError};

use super::attributes::TreeAttributes;
use super::record::{BornTriangles, Root, Split, Tree};

/// A view-dependence tree of any size.
#[derive(Debug)]
pub struct StoredTree {
    /// Position of each leaf, in mesh units, relative to `origin`.
    pub positions: Spool<[f32; 3]>,
    /// Splits by born leaf; [`Split::VACANT`] at the first leaf of each tree.
    pub splits: Spool<Split>,
    /// For each leaf, how many triangles its split has.
    pub triangle_counts: Spool<u32>,
    /// Corners of the born triangles, grouped by split in leaf order, sorted within a split; as in
    /// [`BornTriangles::corners`].
    pub triangles: Spool<[u32; 3]>,
    /// The trees, by ascending start.
    pub roots: Vec<Root>,
    /// What to add to a position to get back the coordinates of the input file.
    pub origin: [f64; 3],
    /// The mesh was normalised by 2^`exponent` for its simplification: switch values follow from ids with it.
    pub exponent: i32,
    /// The step of the lattice that all positions are on, in mesh units; 0 where there is none.
    pub lattice_step: f32,
    /// What the corners carry, where they carry anything.
    pub attributes: Option<TreeAttributes>,
}

impl StoredTree {
    /// How many leaves there are.
    pub fn leaf_count(&self) -> u64 {
        self.positions.len()
    }

    /// A tree in RAM as a stored one, without attributes.
    pub fn from_tree(tree: Tree) -> Self {
        let counts = tree.triangles.offsets.windows(2).map(|range| range[1] - range[0]).collect();
        StoredTree {
            positions: Spool::from_vec(tree.positions),
            splits: Spool::from_vec(tree.splits),
            triangle_counts: Spool::from_vec(counts),
            triangles: Spool::from_vec(tree.triangles.corners),
            roots: tree.roots,
            origin: tree.origin,
            exponent: tree.exponent,
            lattice_step: tree.lattice_step,
            attributes: None,
        }
    }

    /// The whole tree in RAM, without its attributes.
    pub fn load(&self) -> Result<Tree, StorageError> {
        let leaves = self.leaf_count() as usize;
        let mut positions = vec![[0.0; 3]; leaves];
        self.positions.read_at(0, &mut positions)?;
        let mut splits = vec![Split::VACANT; leaves];
        self.splits.read_at(0, &mut splits)?;
        let mut counts = vec![0; leaves];
        self.triangle_counts.read_at(0, &mut counts)?;
        let mut corners = vec![[0; 3]; self.triangles.len() as usize];
        self.triangles.read_at(0, &mut corners)?;
        let mut offsets = Vec::with_capacity(leaves + 1);
        offsets.push(0);
        let mut end = 0;
        for count in counts {
            end += count;
            offsets.push(end);
        }
        let triangles = BornTriangles { offsets, corners };
        let roots = self.roots.clone();
        Ok(Tree {
            positions,
            splits,
            roots,
            triangles,
            origin: self.origin,
            exponent: self.exponent,
            lattice_step: self.lattice_step,
        })
    }
}
