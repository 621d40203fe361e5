//! What the whole-system and property tests hold vdt against: slow, obvious references, random meshes, mesh files
//! written and read by other code than vdt's, and the program itself, run and watched.
//!
//! | module | what it holds |
//! |---|---|
//! | [`random_mesh`] | meshes of every kind that people have, for property tests |
//! | [`replay`] | a simplification done over again, one triangle list and nothing else |
//! | [`cut`] | the mesh of a cut by the rule: three corners with three distinct active ancestors |
//! | [`mesh_files`] | meshes as files of every format, and a PLY reader |
//! | [`program`] | the program, run in a folder of its own |
//! | [`memory`] | what the operating system says of a process's memory, and memory cgroups |

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

pub mod cut;
pub mod memory;
pub mod mesh_files;
pub mod program;
pub mod random_mesh;
pub mod replay;
