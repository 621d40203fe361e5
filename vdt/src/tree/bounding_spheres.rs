//! Nested bounding spheres: about the position of each node, round all leaves under it and round its children's spheres.
//!
//! radius(p) = max(radius(kept child), distance to the born child + its radius): the kept child stands where its parent
//! does. Bottom up in one pass over the build order; rounded up, so that "inside" is true of the stored numbers.

use super::finish::NodePlace;
use super::record::{Split, Tree};

/// Fills the radii of all splits. `nodes` in build order.
pub(super) fn fill(tree: &mut Tree, nodes: &[NodePlace]) {
    for NodePlace { first, born } in nodes {
        let Split { kept: kept_split, born: born_split, .. } = tree.splits[*born as usize];
        let radius_of = |split: u32| tree.splits.get(split as usize).map_or(0.0, |split| f64::from(split.radius));
        let [from, to] = [first, born].map(|leaf| tree.positions[*leaf as usize].map(f64::from));
        let square: f64 = (0..3).map(|axis| (to[axis] - from[axis]) * (to[axis] - from[axis])).sum();
        let radius = radius_of(kept_split).max(square.sqrt() + radius_of(born_split));
        tree.splits[*born as usize].radius = rounded_up(radius);
    }
}

/// The smallest f32 that is not below `value`, or the largest there is.
fn rounded_up(value: f64) -> f32 {
    let nearest = (value as f32).min(f32::MAX);
    if f64::from(nearest) < value { nearest.next_up().min(f32::MAX) } else { nearest }
}
