//! Leaf numbers, from the roots down: one pass over the log from its end.
//!
//! A node's children come before it in the log, so when a collapse is met from the end, the number of its kept leaf (its
//! node's first) is known: it is a root's, or the node is a child of one met before, the kept child with the same first
//! leaf or the born child with the one given then. The born leaf follows it by the size of the kept child. (Time-forward
//! processing, where the messages to the future wait in the table of leaves.)
//!
//! Segments of the log are spatially local, and so are canonical ids: the table's pages that a segment needs stay in RAM.

use bytemuck::Zeroable;
use storage::{PagedArray, Scatter, Scattered, Spool};

use super::{FinishError, UNNUMBERED, Work};
use crate::simplify::log::LoggedCollapse;
use crate::tree::order::switch_of;
use crate::tree::record::{NO_SPLIT, NormalCone, Split};

/// Numbers the leaf of each vertex in `leaf_of`, in which those of the roots stand. Returns the splits by born leaf, with
/// their cones as the triangles are oriented. The mesh is at most 2^`exponent` wide. `keepers`, where it is asked for, is told for
/// each born leaf onto which one it is collapsed.
pub(super) fn number(
    log: &Spool<LoggedCollapse>,
    leaf_of: &mut PagedArray,
    exponent: i32,
    mut keepers: Option<&mut Scatter<u32>>,
    work: &mut Work<'_>,
) -> Result<Scattered<Split>, FinishError> {
    let mut splits = Scatter::new(work.scratch, "splits-by-leaf", work.leaf_count.into(), work.shares.moved_splits);
    let records = (work.shares.log / size_of::<LoggedCollapse>()).clamp(1, MOST_RECORDS);
    let mut buffer = vec![LoggedCollapse::zeroed(); records.min(log.len() as usize)];
    let leaf_count = work.leaf_count;
    let mut end = log.len();
    while end > 0 {
        let count = buffer.len().min(end as usize);
        let start = end - count as u64;
        log.read_at(start, &mut buffer[..count])?;
        for (index, collapse) in buffer[..count].iter().enumerate().rev() {
            let LoggedCollapse { kept, born, .. } = *collapse;
            let wrong = |problem| FinishError::Collapse { collapse: start + index as u64, kept, born, problem };
            if kept.max(born) >= leaf_count {
                return Err(wrong("there is no such vertex"));
            }
            let kept_leaf = leaf_of.get(kept)?;
            if kept_leaf == UNNUMBERED {
                return Err(wrong("its node belongs to no tree"));
            }
            let Some((born_leaf, split)) = split_at(kept_leaf, collapse, exponent, leaf_count) else {
                return Err(wrong("its node has more leaves than there are"));
            };
            leaf_of.set(born, born_leaf)?;
            splits.put(born_leaf, split)?;
            if let Some(keepers) = &mut keepers {
                keepers.put(born_leaf, kept_leaf)?;
            }
            work.step();
        }
        end = start;
    }
    Ok(splits.finish()?)
}

/// The most records of the log that are read at once: more are not faster.
const MOST_RECORDS: usize = 1 << 15;

/// The born leaf of a collapse whose node begins at `kept_leaf`, and its split.
#[inline]
fn split_at(kept_leaf: u32, collapse: &LoggedCollapse, exponent: i32, leaf_count: u32) -> Option<(u32, Split)> {
    let behind = |first: u32, leaves: u32| first.checked_add(leaves).filter(|leaf| *leaf < leaf_count);
    let split_of = |first, kept_leaves| if kept_leaves == 0 { Some(NO_SPLIT) } else { behind(first, kept_leaves) };
    let born_leaf = behind(kept_leaf, collapse.kept_leaves)?;
    let split = Split {
        kept: split_of(kept_leaf, collapse.kept_split)?,
        born: split_of(born_leaf, collapse.born_split)?,
        id: collapse.id,
        switch: switch_of(collapse.id, exponent),
        radius: collapse.radius,
        cone: NormalCone::from_word(collapse.cone),
        normal: collapse.normal,
    };
    Some((born_leaf, split))
}
