//! How a front is drawn.

/// What is to be seen beside the surface, or in place of its colours.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Style {
    /// The sides of the triangles.
    pub edges: bool,
    /// The levels of detail, as colours.
    pub levels: bool,
    /// The meta-nodes in use, as boxes around what they bore.
    pub boxes: bool,
}
