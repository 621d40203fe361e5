//! The finished view-dependence tree (VDT): what the build hands to the blocking.
//!
//! Leaves are the vertices of the mesh, numbered in depth-first order of the forest, the kept child first. So
//!
//! - the leaves under a node are one interval `start..end`, and "is an ancestor of" is two comparisons;
//! - a node stands where the first leaf of its interval stands (half-edge collapses keep the position of one child,
//!   the paper, 3.2), so only leaves have positions;
//! - every inner node splits its interval at one leaf, the *born* leaf `m`: the kept child has `start..m`, the born
//!   child `m..end`. Each leaf is born by exactly one split, but for the first leaf of each tree. So the splits are
//!   stored by their born leaf, and a split needs no other name.
//!
//! Memory: 28 bytes per split, 12 per position, 12 per triangle, 4 per leaf for the triangle offsets.

mod attributes;
mod bounding_spheres;
mod check;
mod finish;
mod normal_cones;
mod normals;
mod order;
mod positions;
mod record;
mod stored;

pub use attributes::{
    Appearance, AttributeKinds, CornerPlaces, Image, ImageSource, MOST_WEDGES, Material, MeshAttributes, MeshSeams,
    TreeAttributes, TreeSeams, Wedge, WedgeNode,
};
pub use bounding_spheres::enclosing_radius;
pub use check::{TreeError, check};
pub use finish::{FinishError, finish};
pub use normal_cones::{enclosing_cone, leaf_cone};
pub use normals::{LARGEST_ERROR as LARGEST_NORMAL_ERROR, Normal, vertex_normal};
pub use order::{CHAIN_BITS, CLASSES_PER_OCTAVE, id_after, switch_of};
pub use positions::{LARGEST_NUMBER, ParsePositionsError, Positions, lattice_number, on_lattice};
pub use record::{
    BornTriangles, ErrorBound, Metric, NO_SPLIT, NormalCone, Root, Split, Strategy, Tree, UnknownNameError,
};
pub use stored::StoredTree;

pub use crate::vector::{length_not_below, rounded_up};
