//! View-dependence trees on disk: blocked into meta-nodes, in one model file, `.vdt`.
//!
//! | module | what it does | where it comes from |
//! |---|---|---|
//! | [`page`] | the decoded meta-node: what lies in a place holder | the paper, 3.2; design, 4 |
//! | [`header`] | the model file's header and root table, byte by byte | |
//! | [`blocking`] | which splits share a meta-node, and in which order | the paper, 3.2; design, 4 |
//! | [`write`] | writes a tree as a model file | |
//! | [`model`] | a model file open for reading | |
//!
//! The bytes of the file are documented in `docs/format.md`.

mod bits;
pub mod blocking;
pub mod header;
pub mod model;
pub mod page;
pub mod write;

pub use write::{ModelOptions, ModelSummary, WriteError, write_model};

#[cfg(test)]
mod testing;
