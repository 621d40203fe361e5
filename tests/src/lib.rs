//! What the whole-system and property tests hold vdt against: slow, obvious references, random meshes, mesh files
//! written and read by other code than vdt's, and the program itself, run and watched.
//!
//! | module | what it holds |
//! |---|---|
//! | [`random_mesh`] | meshes of every kind that people have, for property tests |
//! | [`history`] | a mesh in RAM, simplified: what happened, and the tree |
//! | [`random_log`] | logs of simplifications that no engine made |
//! | [`random_wedges`] | trees with attributes that no mesh file gave |
//! | [`plain_tree`] | the tree of a list of collapses, from nodes with links |
//! | [`replay`] | a simplification done over again, one triangle list and nothing else |
//! | [`cut`] | the mesh of a cut by the rule: three corners with three distinct active ancestors |
//! | [`distance`] | how far points are from triangles |
//! | [`mesh_files`] | meshes as files of every format, and a PLY reader |
//! | [`reference_decoder`] | a decoder of model files, from the format's document alone |
//! | [`program`] | the program, run in a folder of its own |
//! | [`display`] | a display without a screen: real key and mouse events, and what is seen |
//! | [`memory`] | what the operating system says of a process's memory, and memory cgroups |

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

pub mod cut;
pub mod display;
pub mod distance;
pub mod history;
pub mod memory;
pub mod mesh_files;
pub mod plain_tree;
pub mod program;
pub mod random_log;
pub mod random_mesh;
pub mod random_wedges;
pub mod reference_decoder;
pub mod replay;
