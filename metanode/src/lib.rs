//! View-dependence trees on disk: blocked into meta-nodes, in one model file, `.vdt`.
//!
//! | module | what it does | where it comes from |
//! |---|---|---|
//! | [`page`] | the decoded meta-node: what lies in a place holder | the paper, 3.2; design, 4 |
//! | [`header`] | the model file's header and root table, byte by byte | |
//! | [`model`] | a model file open for reading | |
//!
//! The bytes of the file are documented in `docs/format.md`.

pub mod header;
pub mod model;
pub mod page;
