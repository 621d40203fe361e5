//! The meta-nodes in use as boxes: the sides of each, as lines.
//!
//! Memory: 384 bytes for each meta-node in use, while boxes are drawn.

use navigator::{ActiveMetaNode, Navigator};

/// An end of a line.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct LineEnd {
    /// Where it is, in mesh units relative to the model's origin.
    pub position: [f32; 3],
    /// Red, green, blue and alpha; parts of 255 of light.
    pub colour: [u8; 4],
}

/// The corners at the ends of the twelve sides of a box: bit by bit, whether at the largest x, y and z.
const SIDES: [[usize; 2]; 12] =
    [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

/// The sides of the boxes of all meta-nodes in use: each two ends are a line.
pub fn box_lines(navigator: &Navigator) -> Vec<LineEnd> {
    navigator
        .active_meta_nodes()
        .iter()
        .flat_map(|node| SIDES.as_flattened().iter().map(|corner| end(node, *corner)))
        .collect()
}

fn end(node: &ActiveMetaNode, corner: usize) -> LineEnd {
    let bounds = [node.minimum, node.maximum];
    let position = std::array::from_fn(|axis| bounds[corner >> axis & 1][axis]);
    // Neighbours have numbers near each other, and colours that are not.
    let [red, green, blue] = crate::levels::colour(1 + (node.page.wrapping_mul(5) % 12) as u8);
    LineEnd { position, colour: [red, green, blue, 1.0].map(|part| (255.0 * part) as u8) }
}
