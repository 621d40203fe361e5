//! What the benches of vdt are made of; the benches themselves are in `benches/`.
//!
//! | module | what it does |
//! |---|---|
//! | `surface` | an indexed mesh, points spread over it, and the distance to it |
//! | `deviation` | how far two surfaces are apart: root mean square and Hausdorff distance |
//! | `levels` | levels of detail of one mesh: uniform cuts of a vdt model, and meshopt's |

#[cfg(feature = "quality")]
pub mod deviation;
#[cfg(feature = "quality")]
pub mod levels;
#[cfg(feature = "quality")]
pub mod surface;
