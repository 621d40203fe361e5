//! The records of a view-dependence tree: plain data, no behaviour beyond looking things up.

use std::fmt;
use std::str::FromStr;

use bytemuck::{Pod, Zeroable};
use thiserror::Error;

use super::normals::Normal;

/// What a collapse costs: the key by which collapses are ordered, and where switch values start from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Metric {
    /// Quadric error: the distance to the planes of the surface; with a small edge-length term in the key.
    Quadric,
    /// Euclidean edge length, the paper's.
    Length,
}

/// How the order of the collapses is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Strategy {
    /// Rounds of a frozen batch: the order that external passes reproduce exactly.
    Passes,
    /// The paper's: always the shortest edge, edges made on the way included.
    Btree,
}

/// What the switch values are: an estimate, or a proven bound on the distance from any point of the input to the surface.
///
/// A certified bound follows every triangle of the input through all collapses: each collapse cuts what it removes into
/// pieces and measures how far each piece is from its new triangle. What a triangle remembers of finer surfaces, instead of
/// adding to the bound of a coarser one, makes the bound tighter and the build slower.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ErrorBound {
    /// The metric's error, made monotone over the collapses that depend on each other. An estimate.
    None,
    /// Certified, with one piece kept for each triangle.
    Fast,
    /// Certified, with two pieces kept for each triangle.
    #[default]
    Default,
    /// Certified, with four pieces kept for each triangle.
    Tight,
    /// Certified in both directions: it also bounds how far any point of the surface is from the input. Else as the
    /// default.
    TwoSided,
}

/// A name that stands for nothing.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("there is no {kind} `{name}`; there are {known}")]
pub struct UnknownNameError {
    kind: &'static str,
    name: String,
    known: String,
}

/// Finds the item whose [`fmt::Display`] is `name`.
fn named<T: fmt::Display + Copy>(kind: &'static str, all: &[T], name: &str) -> Result<T, UnknownNameError> {
    all.iter().copied().find(|item| item.to_string() == name).ok_or_else(|| {
        let mut known = all.iter().map(T::to_string).collect::<Vec<_>>();
        let last = known.pop().unwrap_or_default();
        let known = format!("{} and {last}", known.join(", "));
        UnknownNameError { kind, name: name.to_owned(), known }
    })
}

impl Metric {
    /// All there are.
    pub const ALL: [Metric; 2] = [Metric::Quadric, Metric::Length];
}

impl Strategy {
    /// All there are.
    pub const ALL: [Strategy; 2] = [Strategy::Passes, Strategy::Btree];
}

impl ErrorBound {
    /// All there are.
    pub const ALL: [ErrorBound; 5] =
        [ErrorBound::None, ErrorBound::Fast, ErrorBound::Default, ErrorBound::Tight, ErrorBound::TwoSided];

    /// Whether switch values are proven bounds.
    pub fn is_certified(self) -> bool {
        self != ErrorBound::None
    }

    /// Whether they bound the distance from any point of the surface to the input, too.
    pub fn is_two_sided(self) -> bool {
        self == ErrorBound::TwoSided
    }

    /// Pieces of finer surfaces that are kept for each triangle while the mesh is simplified; 0 without a bound.
    pub fn pieces(self) -> usize {
        match self {
            ErrorBound::None => 0,
            ErrorBound::Fast => 1,
            ErrorBound::Default | ErrorBound::TwoSided => 2,
            ErrorBound::Tight => 4,
        }
    }
}

impl fmt::Display for Metric {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(match self {
            Metric::Quadric => "quadric",
            Metric::Length => "length",
        })
    }
}

impl fmt::Display for Strategy {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(match self {
            Strategy::Passes => "passes",
            Strategy::Btree => "btree",
        })
    }
}

impl fmt::Display for ErrorBound {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(match self {
            ErrorBound::None => "none",
            ErrorBound::Fast => "fast",
            ErrorBound::Default => "default",
            ErrorBound::Tight => "tight",
            ErrorBound::TwoSided => "two-sided",
        })
    }
}

impl FromStr for Metric {
    type Err = UnknownNameError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        named("metric", &Metric::ALL, name)
    }
}

impl FromStr for Strategy {
    type Err = UnknownNameError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        named("strategy", &Strategy::ALL, name)
    }
}

impl FromStr for ErrorBound {
    type Err = UnknownNameError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        named("error bound", &ErrorBound::ALL, name)
    }
}

/// Stands for "no split": the child is a leaf.
pub const NO_SPLIT: u32 = u32::MAX;

/// A cone of directions that holds every surface normal under a node; nested: a parent's cone holds its children's.
///
/// The axis is a vector of three signed bytes, not of unit length. `sine` is the sine of the cone's half-angle in
/// steps of 1/254, rounded up; 255 says that the cone reaches 90 degrees or more, or that the part of the surface has
/// no inside, so that nothing under the node may ever be taken for back-facing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct NormalCone {
    /// Direction of the axis, outward, in steps of 1/127.
    pub axis: [i8; 3],
    /// Sine of the half-angle, times 254, rounded up; 255: no bound.
    pub sine: u8,
}

impl NormalCone {
    /// The cone of all directions: never back-facing.
    pub const EVERYTHING: NormalCone = NormalCone { axis: [0; 3], sine: u8::MAX };

    /// The cone of the same directions turned round.
    pub fn reversed(self) -> Self {
        NormalCone { axis: self.axis.map(i8::saturating_neg), sine: self.sine }
    }

    /// The four bytes of the cone as one little-endian word: axis x, y, z, sine.
    #[inline]
    pub fn to_word(self) -> u32 {
        let [x, y, z] = self.axis.map(|component| component.to_le_bytes()[0]);
        u32::from_le_bytes([x, y, z, self.sine])
    }

    /// The inverse of [`NormalCone::to_word`].
    #[inline]
    pub fn from_word(word: u32) -> Self {
        let [x, y, z, sine] = word.to_le_bytes();
        NormalCone { axis: [x, y, z].map(|byte| i8::from_le_bytes([byte])), sine }
    }
}

/// An inner node of the tree, as the split that refines it. Stored by the born leaf.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Split {
    /// The split of the kept child (by its born leaf), or [`NO_SPLIT`] where that child is a leaf.
    pub kept: u32,
    /// The split of the born child, or [`NO_SPLIT`].
    pub born: u32,
    /// Dependency id of the node, see [`crate::tree::id_after`]: above those of all collapses that its own depends on (the
    /// paper, 3.3.5), so ids rise from child to parent. Nodes that do not depend on each other may have the same. (Leaves
    /// have 0.)
    pub id: u32,
    /// Switch value: the error, in mesh units, of drawing the node unsplit. It is [`crate::tree::switch_of`] the id. Positive; never falls from child to parent. That
    /// of a root is no less than the diameter of its component, rounded to single precision: there the component vanishes.
    pub switch: f32,
    /// Radius of a sphere about the node's position that holds all leaf positions under it, in mesh units. Nested:
    /// the sphere also holds the children's spheres.
    pub radius: f32,
    /// Holds all surface normals under the node.
    pub cone: NormalCone,
    /// The normal of the surface at the born leaf: those of the triangles at it in the input, by their areas, as the triangles
    /// are oriented.
    pub normal: Normal,
}

impl Split {
    /// What stands in the places that no split has: those of the first leaf of each tree.
    pub const VACANT: Split = Split {
        kept: NO_SPLIT,
        born: NO_SPLIT,
        id: u32::MAX,
        switch: 0.0,
        radius: 0.0,
        cone: NormalCone::EVERYTHING,
        normal: Normal::UP,
    };
}

/// A tree of the forest: one for each connected component of the mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Root {
    /// First leaf of the tree's interval; also where the root stands.
    pub start: u32,
    /// One past the last leaf.
    pub end: u32,
    /// The root's split, by its born leaf. Every component has at least one triangle, so every root splits.
    pub split: u32,
    /// The normal of the surface at the first leaf, as [`Split::normal`] is at a born one.
    pub normal: Normal,
    /// Whether the surface faces the other way than its triangles' orientation says: its cones do, too. (False where it has no
    /// inside.)
    pub is_inward: bool,
}

/// The triangles of the mesh, each with the split at which it is born: the deepest node that holds two of its corners.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct BornTriangles {
    /// `offsets[m]..offsets[m + 1]` are the triangles born by split `m`. One more entry than there are leaves.
    pub offsets: Vec<u32>,
    /// Corners as leaf numbers, in the mesh's orientation, rotated so that the first lies under the kept child. Of the
    /// other two exactly one lies under the born child. The triangles of a split are sorted.
    pub corners: Vec<[u32; 3]>,
}

impl BornTriangles {
    /// The triangles born by the split with born leaf `split`.
    pub fn of(&self, split: u32) -> &[[u32; 3]] {
        &self.corners[self.offsets[split as usize] as usize..self.offsets[split as usize + 1] as usize]
    }
}

/// A finished view-dependence tree (a forest: one tree for each connected component).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tree {
    /// Position of each leaf, in mesh units, relative to `origin`.
    pub positions: Vec<[f32; 3]>,
    /// Splits by born leaf; [`Split::VACANT`] at the first leaf of each tree.
    pub splits: Vec<Split>,
    /// The trees, by ascending start; their intervals partition `0..positions.len()`.
    pub roots: Vec<Root>,
    /// Every triangle of the mesh, once.
    pub triangles: BornTriangles,
    /// What to add to a position to get back the coordinates of the input file.
    pub origin: [f64; 3],
    /// The mesh was normalised by 2^`exponent` for its simplification: switch values follow from ids with it.
    pub exponent: i32,
    /// The step of the lattice that all positions are on, in mesh units; 0 where there is none.
    pub lattice_step: f32,
}

impl Tree {
    /// Number of leaves, that is of vertices of the mesh.
    pub fn leaf_count(&self) -> usize {
        self.positions.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_stands_for_what_bears_it() {
        for bound in ErrorBound::ALL {
            assert_eq!(bound.to_string().parse(), Ok(bound));
        }
        assert_eq!(Metric::ALL.map(|metric| metric.to_string().parse()), Metric::ALL.map(Ok));
        assert_eq!(Strategy::ALL.map(|strategy| strategy.to_string().parse()), Strategy::ALL.map(Ok));
        let refused = |outcome: Result<ErrorBound, UnknownNameError>| outcome.unwrap_err().to_string();
        let expected = "there is no error bound `loose`; there are none, fast, default, tight and two-sided";
        assert_eq!(refused("loose".parse()), expected);
        assert_eq!(
            "angle".parse::<Metric>().unwrap_err().to_string(),
            "there is no metric `angle`; there are quadric and length"
        );
    }
}
