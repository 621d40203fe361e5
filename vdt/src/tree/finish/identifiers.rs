//! Ids of inner nodes: their rank by (switch value as stored, build order), by external sort; the ranks go back to the
//! splits by their born leaf.

use std::cmp::Ordering;

use bytemuck::{Pod, Zeroable};
use storage::{Scatter, Scattered, SortRecord, Sorter};

use super::{FinishError, Work};
use crate::simplify::log::{LoggedCollapse, tie_order};

/// What the id of a node goes by. 24 bytes.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct IdKey {
    /// Bits of the switch value: positive floats order as their bits do.
    switch: u32,
    round: u32,
    key: u32,
    kept: u32,
    born: u32,
    /// The split's name, of no matter for the order.
    born_leaf: u32,
}

impl IdKey {
    pub fn of(collapse: &LoggedCollapse, born_leaf: u32) -> Self {
        let LoggedCollapse { kept, born, round, key, switch, .. } = *collapse;
        IdKey { switch: switch.to_bits(), round, key, kept, born, born_leaf }
    }
}

impl Ord for IdKey {
    #[inline]
    fn cmp(&self, other: &Self) -> Ordering {
        let order = |record: &IdKey| (record.switch, record.round, record.key);
        order(self)
            .cmp(&order(other))
            .then_with(|| tie_order(self.kept, self.born).cmp(&tie_order(other.kept, other.born)))
    }
}

impl PartialOrd for IdKey {
    #[inline]
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for IdKey {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for IdKey {}

impl SortRecord for IdKey {
    #[inline]
    fn prefix(&self) -> u64 {
        u64::from(self.switch) << 32 | u64::from(self.round)
    }
}

/// For each born leaf the rank of its split's node.
pub(super) fn rank(keys: Sorter<IdKey>, work: &mut Work<'_>) -> Result<Scattered<u32>, FinishError> {
    let mut sorted = keys.finish()?;
    let mut ranks = Scatter::new(work.scratch, "ids", work.leaf_count.into(), work.shares.ranks);
    let mut rank = 0;
    while let Some(key) = sorted.next()? {
        ranks.put(key.born_leaf, rank)?;
        rank += 1;
        work.step();
    }
    Ok(ranks.finish()?)
}
