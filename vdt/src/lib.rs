//! Meshes in, view-dependence trees out.
//!
//! | module | what it does | where it comes from |
//! |---|---|---|
//! | [`mesh`] | reads and writes mesh files, streaming | |
//! | [`generate`] | makes test meshes of any size, streaming | |
//! | [`ingest`] | local origin, welding, canonical ids, power-of-two normalisation | design, section 3 |
//! | [`simplify`] | the half-edge collapse engine and what drives it | the paper, 3.1 |
//! | [`tree`] | the finished view-dependence tree: leaf intervals, ids, born triangles | the paper, 3.3.1, 3.3.5 |
//! | [`build`] | all of that in a row, within a memory limit | |
//! | [`compare`] | how far two meshes are apart | Guthe et al. (2005) |
//! | [`workers`] | many jobs by a few threads | |
//!
//! "The paper" is El-Sana and Chiang, *External Memory View-Dependent Simplification* (2000).

pub mod build;
pub mod compare;
pub mod generate;
pub mod ingest;
pub mod mesh;
mod nearby;
pub mod simplify;
pub mod tree;
mod vector;
pub mod workers;
