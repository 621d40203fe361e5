//! Which children of a record are leaves, in the same page, or in a child page; and of those in child pages how large they are.
//!
//! All leaf numbers follow: sizes add up from below, and from the top down each node's interval is divided.
//!
//! The radius of a subtree in a child page cannot be worked out in this page. What is coded is by how many quarter octaves it is
//! smaller than that of the page's root above it, rounded up to the larger radius; its size says most of it.

use super::contexts::{STRUCTURE, SUBTREE_RADIUS, SUBTREE_SIZE};
use super::nodes::{BORN, ELSEWHERE, KEPT, LEAF, Node, Nodes};
use super::paths::step_class;
use super::rans::Coder;
use super::scale::{self, logarithm};
use super::{Below, Damage, Fields};

/// A child's kinds.
pub(crate) const KIND_LEAF: u8 = 0;
pub(crate) const KIND_HERE: u8 = 1;
pub(crate) const KIND_BELOW: u8 = 2;

/// The classes of radii: quarter octaves below that of the root. The last stands for 0.
pub(crate) const SMALLEST_RADIUS: u8 = 63;
/// Two to the power of 0, 1/4, 1/2 and 3/4, rounded up.
const QUARTERS: [f32; 4] = [1.0, 1.189_207_2, 1.414_213_7, 1.681_793];

/// The radius that a class stands for, below a root with radius `of_root`.
pub(crate) fn radius(class: u8, of_root: f32) -> f32 {
    if class >= SMALLEST_RADIUS {
        return 0.0;
    }
    // 2^(-class / 4) of it.
    let octaves = class.div_ceil(4);
    let factor = f32::from_bits((127 - u32::from(octaves)) << 23);
    of_root * (factor * QUARTERS[usize::from(4 * octaves - class)])
}

/// The class of the smallest radius that is at least `radius`; the largest there is where none is.
pub(crate) fn radius_class(value: f32, of_root: f32) -> u8 {
    if value <= 0.0 {
        return SMALLEST_RADIUS;
    }
    (0..SMALLEST_RADIUS).rev().find(|class| radius(*class, of_root) >= value).unwrap_or(0)
}

/// Codes the structure, and fills in all leaf numbers, references and known radii.
pub(super) fn code<C: Coder>(coder: &mut C, nodes: &mut Nodes, fields: &mut Fields) -> Result<(), Damage> {
    let (first, records) = (nodes.first, fields.kinds.len());
    let is_inner = usize::from(!fields.children.is_empty());
    let wrong = |index, problem| Damage { field: "record", index, problem };
    // Of each node for now its size in `end`, and which root it is under in `start`.
    let roots: Vec<(u32, u32, f32)> =
        nodes.all[first..].iter().map(|node| (node.start, node.end, node.radius)).collect();
    let mut below = 0;
    for index in 0..records {
        if nodes.all.len() <= first + index {
            return Err(wrong(index, "no record leads to it"));
        }
        let (is_root, parent) = (index < fields.root_count, nodes.all[first + index].parent);
        let above = if is_root { 9 } else { fields.kinds[parent as usize - first].into() };
        let root = if is_root { index as u32 } else { nodes.all[parent as usize].born };
        let kinds = coder.symbol(STRUCTURE.context(above * 2 + is_inner), fields.kinds[index].into()) as u8;
        fields.kinds[index] = kinds;
        nodes.all[first + index].born = root;
        for (side, kind) in [kinds / 3, kinds % 3].into_iter().enumerate() {
            nodes.all[first + index].children[side] = match kind {
                KIND_LEAF => LEAF,
                KIND_HERE => {
                    let child = nodes.all.len();
                    if child - first >= records {
                        return Err(wrong(index, "it leads to more records than there are"));
                    }
                    let parent = (first + index) as u32;
                    nodes.all.push(Node { parent, side: side as u8, ..Node::UNKNOWN });
                    child as u32
                }
                _ => {
                    if is_inner == 0 {
                        return Err(wrong(index, "it leads to a child page, of which there is none"));
                    }
                    if C::DECODES {
                        fields.below.push(Below::default());
                    }
                    let (_, _, of_root) = roots[root as usize];
                    let size_of_root = roots[root as usize].1 - roots[root as usize].0;
                    let found = code_below(coder, fields.below[below], size_of_root)?;
                    fields.below[below] = found;
                    below += 1;
                    nodes.all[first + index].radii[side] = radius(found.radius, of_root);
                    ELSEWHERE
                }
            };
        }
    }
    if nodes.all.len() != first + records {
        return Err(wrong(records, "it is missing"));
    }
    // Sizes, from below.
    let mut next_below = fields.below.len();
    for index in (0..records).rev() {
        let children = nodes.all[first + index].children;
        let mut sizes = [1_u64; 2];
        for side in [BORN, KEPT] {
            sizes[side] = match children[side] {
                LEAF => 1,
                ELSEWHERE => {
                    next_below -= 1;
                    fields.below[next_below].size.into()
                }
                child => nodes.all[child as usize].end.into(),
            };
        }
        let (node, total) = (&mut nodes.all[first + index], sizes[KEPT] + sizes[BORN]);
        if total > u64::from(u32::MAX) {
            return Err(wrong(index, "it has too many leaves"));
        }
        let is_root = index < fields.root_count;
        if is_root && total != u64::from(roots[index].1 - roots[index].0) {
            return Err(wrong(index, "it has not as many leaves as its node"));
        }
        node.end = total as u32;
        // How many the kept child has.
        node.born = sizes[KEPT] as u32;
    }
    // Leaf numbers, from the top.
    for index in first..first + records {
        let node = &mut nodes.all[index];
        if let Some((start, end, _)) = roots.get(index - first) {
            (node.start, node.end) = (*start, *end);
        }
        node.born += node.start;
        node.step_class = step_class(node.start, node.born, node.end);
        let Node { start, born, end, children, .. } = *node;
        for (child, (start, end)) in children.into_iter().zip([(start, born), (born, end)]) {
            if let Some(child) = nodes.all.get_mut(child as usize) {
                (child.start, child.end) = (start, end);
            }
        }
    }
    Ok(())
}

/// Codes what is known of a subtree in a child page, below a root of so many leaves.
fn code_below<C: Coder>(coder: &mut C, below: Below, size_of_root: u32) -> Result<Below, Damage> {
    let wrong = |problem| Damage { field: "subtree in a child page", index: 0, problem };
    // Two leaves at least.
    let size = scale::number(coder, SUBTREE_SIZE.context(0), below.size.max(2).into());
    if size < 2 {
        return Err(wrong("a size that none can have"));
    }
    let Some(size) = u32::try_from(size).ok().filter(|size| *size <= size_of_root) else {
        return Err(wrong("it is larger than the tree that it is in"));
    };
    let smaller = (logarithm(size_of_root as f32) - logarithm(size as f32)) / 16;
    let context = SUBTREE_RADIUS.context((smaller as usize).min(SUBTREE_RADIUS.contexts - 1));
    let radius = coder.symbol(context, below.radius.into()) as u8;
    Ok(Below { size, radius })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_of_radii_are_rounded_up() {
        for of_root in [1.0_f32, 3.7e-20, 123.456] {
            for part in [1.0, 0.999, 0.5, 0.1, 0.011, 1e-4] {
                let value = of_root * part;
                let found = radius(radius_class(value, of_root), of_root);
                assert!(found >= value && found <= value * 1.1893, "{found} {value}");
            }
            assert_eq!(radius(radius_class(0.0, of_root), of_root), 0.0);
        }
    }
}
