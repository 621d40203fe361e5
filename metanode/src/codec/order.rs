//! Dependency ids: how far the switch value of a child is below its parent's, and where it is in a chain of dependent nodes with
//! the same.
//!
//! The id is both (`vdt::tree::order`), and the switch value follows from it. A child's id is below its parent's.

use super::contexts::{CHAIN, CLASS_STEP};
use super::nodes::{BORN, KEPT, LEAF, Nodes};
use super::rans::Coder;
use super::{Damage, Fields};

/// The symbol that stands for all numbers from it on.
const ESCAPE: u32 = 63;

/// Codes a number that is mostly small.
#[inline(always)]
fn small<C: Coder>(coder: &mut C, context: usize, value: u32) -> u32 {
    let symbol = coder.symbol(context, value.min(ESCAPE) as usize) as u32;
    if symbol == ESCAPE { coder.raw(16, value) } else { symbol }
}

/// Codes the ids of all children that split.
pub(super) fn code<C: Coder>(coder: &mut C, nodes: &mut Nodes, fields: &mut Fields) -> Result<(), Damage> {
    let mut entry = 0;
    for index in nodes.first..nodes.all.len() {
        let node = nodes.all[index];
        let (parent_class, parent_chain) = (node.id >> 16, node.id & 0xffff);
        for side in [KEPT, BORN] {
            if node.children[side] == LEAF {
                continue;
            }
            if C::DECODES {
                fields.ids.push(0);
            }
            let (start, end) = node.interval(side);
            let size = (end - start).ilog2().min(9) as usize;
            let (class, chain) = (fields.ids[entry] >> 16, fields.ids[entry] & 0xffff);
            let step = small(coder, CLASS_STEP.context(size * 2 + side), parent_class.wrapping_sub(class) & 0xffff);
            let context = CHAIN.context((step.min(3) * 6 + parent_chain.min(5)) as usize);
            let chain = small(coder, context, chain);
            let class = parent_class.wrapping_sub(step);
            if step >= parent_class || (step == 0 && chain >= parent_chain) {
                return Err(Damage { field: "entry", index: entry, problem: "its id is not below its parent's" });
            }
            let id = class << 16 | chain;
            fields.ids[entry] = id;
            if let Some(child) = nodes.all.get_mut(node.children[side] as usize) {
                child.id = id;
            }
            entry += 1;
        }
    }
    Ok(())
}
