//! What the whole-system and property tests hold vdt against: slow, obvious references, and random meshes.
//!
//! | module | what it holds |
//! |---|---|
//! | [`random_mesh`] | meshes of every kind that people have, for property tests |
//! | [`replay`] | a simplification done over again, one triangle list and nothing else |
//! | [`cut`] | the mesh of a cut by the rule: three corners with three distinct active ancestors |

pub mod cut;
pub mod random_mesh;
pub mod replay;
