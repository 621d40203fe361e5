//! View-dependence trees on disk: blocked into meta-nodes, in one model file, `.vdt`.
//!
//! | module | what it does | where it comes from |
//! |---|---|---|
//! | [`page`] | the decoded meta-node: what lies in a place holder | the paper, 3.2; design, 4 |
//! | [`wedges`] | attributes of corners, as they lie in pages | |
//! | [`appearance`] | what wedges refer to: materials, images | |
//! | [`header`] | the model file's header and root table, byte by byte | |
//! | [`blocking`] | which splits share a meta-node, and in which order | the paper, 3.2; design, 4 |
//! | `codec` | a page as few bits as it needs | `facts/codec.md` |
//! | `leaf_order` | a tree of any size, looked up through caches | |
//! | [`mod@write`] | writes a tree as a model file | |
//! | [`model`] | a model file open for reading | |
//! | [`chain`] | the pages on the way down to one, which decoding it needs | design, 4 |
//! | [`mod@verify`] | checks a whole model file, believing nothing | design, 6 |
//! | [`decoded_file`] | all pages decoded in one mapped file: virtual memory, to measure against | the paper, 4 |
//! | `page_words` | the words of a page: its own, or in that file | |
//! | [`decode`] | all pages decoded by several threads: what decoding costs | |
//! | [`cut`] | uniform cuts, streaming: the mesh of one error | the paper, 3.3.1 |
//! | [`cut_wedges`] | the same with attributes | |
//! | [`drawn_mesh`] | the mesh of any cut with attributes, in RAM | |
//! | [`statement`] | what can be said of a surface drawn: how far the input is from it | design, 1 |
//! | [`vanished`] | parts that are not drawn at all, and how far from the surface they are | |
//! | [`mod@statistics`] | how full the pages are, how long the paths, where the bytes go | |
//! | [`mod@details`] | what only the decoded pages tell: smallest error, levels of detail, what the fields take | |
//!
//! The bytes of the file are documented in `docs/format.md`.

pub mod appearance;
mod bits;
pub mod blocking;
pub mod chain;
mod codec;
pub mod cut;
pub mod cut_wedges;
pub mod decode;
pub mod decoded_file;
pub mod details;
pub mod drawn_mesh;
pub mod header;
mod leaf_order;
pub mod model;
pub mod page;
mod page_words;
pub mod statement;
pub mod statistics;
pub mod vanished;
pub mod verify;
mod walk;
pub mod wedges;
pub mod write;

pub use codec::FieldBits;
pub use cut::{UniformCut, error_for_triangles};
pub use cut_wedges::CutWedges;
pub use decoded_file::{DecodedFile, DecodedFileError, write_decoded};
pub use details::{ModelDetails, details};
pub use drawn_mesh::DrawnMesh;
pub use statement::Statement;
pub use statistics::{ModelStatistics, statistics};
pub use verify::{VerifyError, VerifyReport, verify};
pub use write::{ModelOptions, ModelSummary, WriteError, WriteResources, write_model};

#[cfg(test)]
mod reference;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod wedge_tests;
