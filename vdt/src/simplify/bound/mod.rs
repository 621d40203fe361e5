//! The certified switch value: how far the input is, at most, from the surface after a collapse (`facts/error.md`,
//! sections 1, 2 and 6; the proof is in `docs/error.md`).
//!
//! | module | what it does |
//! |---|---|
//! | [`pieces`] | what each triangle answers for: a residual, and pieces of earlier surface |
//! | [`rewrite`] | hands all of it on when a collapse rewrites triangles, at distances that are bounds |
//! | [`reverse`] | the other direction: how far new triangles are from the input |
//! | [`fan`] | the triangles around a vertex, in order |
//! | [`cut`] | cuts pieces along the edges of the new triangles |
//! | [`distance`] | distances from above, eight at a time |
//! | [`lanes`] | eight numbers at a time |
//!
//! What it reads and writes is with the triangles around the vertex that goes, where one of them is left, else around the
//! vertex that stays; so it travels with their records through external passes, and needs no more of them than the collapse
//! itself.

mod cut;
mod distance;
mod fan;
mod lanes;
mod pieces;
mod reverse;
mod rewrite;

pub(super) use pieces::{Cover, Covers, MOST_PIECES, Piece};
pub(super) use rewrite::{Rewriter, Rewritten};

fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn square(vector: [f32; 3]) -> f32 {
    vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]
}
