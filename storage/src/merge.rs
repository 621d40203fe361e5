//! Several sorted runs as one: the merge of an external sort.
//!
//! A tree of losers (Knuth, The Art of Computer Programming, volume 3, 5.4.1): the leaves are the runs, and every inner
//! node keeps the run whose record came second there. So the next record takes one comparison a level on the way from its
//! run to the root, of prefixes that lie in the tree; the records themselves are compared where prefixes are equal.
//!
//! Memory: the bytes given, divided equally among the runs, each of which is read through a buffer of its own.

use crate::disk::{Block, StorageError};
use crate::sorter::SortRecord;
use crate::spool::{Cursor, Spool};

/// More than this many bytes for a run bring nothing.
const MOST_RUN_BYTES: usize = 1 << 20;

/// Several runs as one.
#[derive(Debug)]
pub(crate) struct Merge<T: SortRecord> {
    runs: Vec<Run<T>>,
    /// The first record of each run that is not handed out; `None` behind its last.
    heads: Vec<Option<T>>,
    /// At 0 the winner. The node n has the nodes 2n and 2n + 1 below it, where those from the number of runs on stand for
    /// the runs.
    nodes: Vec<Node>,
}

/// A run, with the prefix of its head.
#[derive(Debug, Clone, Copy)]
struct Node {
    prefix: u64,
    run: u32,
}

#[derive(Debug)]
struct Run<T> {
    spool: Spool<T>,
    cursor: Cursor,
}

impl<T: SortRecord> Merge<T> {
    /// Of these runs, of which there is at least one.
    pub(crate) fn new(spools: Vec<Spool<T>>, ram_bytes: usize) -> Result<Self, StorageError> {
        let count = spools.len();
        let bytes = (ram_bytes / count.max(1)).clamp(2 * Block::BYTES, MOST_RUN_BYTES);
        let run = |spool: Spool<T>| Run { cursor: Cursor::new::<T>(0, spool.len(), bytes), spool };
        let mut runs: Vec<_> = spools.into_iter().map(run).collect();
        let heads = runs.iter_mut().map(|run| run.cursor.next(&run.spool)).collect::<Result<Vec<_>, _>>()?;
        let mut merge = Merge { runs, heads, nodes: Vec::new() };
        // Who wins at every node, from the leaves up.
        let mut winners = vec![Node { prefix: 0, run: 0 }; count];
        winners.extend((0..count as u32).map(|run| merge.node(run)));
        merge.nodes = winners[..count].to_vec();
        for node in (1..count).rev() {
            let [mut winner, mut loser] = [winners[2 * node], winners[2 * node + 1]];
            if merge.is_before(loser, winner) {
                std::mem::swap(&mut winner, &mut loser);
            }
            winners[node] = winner;
            merge.nodes[node] = loser;
        }
        if let (Some(first), Some(winner)) = (merge.nodes.first_mut(), winners.get(1)) {
            *first = *winner;
        }
        Ok(merge)
    }

    /// The head of a run; behind the last record, a prefix after which nothing comes.
    fn node(&self, run: u32) -> Node {
        Node { prefix: self.heads[run as usize].map_or(u64::MAX, |record| record.prefix()), run }
    }

    #[inline]
    fn is_before(&self, a: Node, b: Node) -> bool {
        a.prefix < b.prefix || a.prefix == b.prefix && self.is_record_before(a, b)
    }

    /// Where the prefixes are equal.
    #[cold]
    fn is_record_before(&self, a: Node, b: Node) -> bool {
        match (&self.heads[a.run as usize], &self.heads[b.run as usize]) {
            (Some(a), Some(b)) => a < b,
            (head, _) => head.is_some(),
        }
    }

    /// The next record, `None` behind the last.
    #[inline]
    pub(crate) fn next(&mut self) -> Result<Option<T>, StorageError> {
        let winner = self.nodes[0].run as usize;
        let Some(found) = self.heads[winner] else { return Ok(None) };
        let Run { spool, cursor } = &mut self.runs[winner];
        self.heads[winner] = cursor.next(spool)?;
        let mut best = self.node(winner as u32);
        let mut node = (winner + self.runs.len()) / 2;
        while node > 0 {
            let rival = self.nodes[node];
            let is_rival_first = self.is_before(rival, best);
            // Without a branch, since nobody can tell how this comes out.
            self.nodes[node] = if is_rival_first { best } else { rival };
            best = if is_rival_first { rival } else { best };
            node /= 2;
        }
        self.nodes[0] = best;
        Ok(Some(found))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Many records have the same prefix, and one that nothing comes after.
    impl SortRecord for u32 {
        fn prefix(&self) -> u64 {
            if *self >= 900 { u64::MAX } else { u64::from(*self / 10) }
        }
    }

    proptest! {
        #[test]
        fn runs_come_as_one(mut runs in prop::collection::vec(prop::collection::vec(0_u32..1000, 0..40), 1..20)) {
            runs.iter_mut().for_each(|run| run.sort_unstable());
            let mut merge = Merge::new(runs.iter().cloned().map(Spool::from_vec).collect(), 0).unwrap();
            let mut found = Vec::new();
            while let Some(record) = merge.next().unwrap() {
                found.push(record);
            }
            let mut expected = runs.concat();
            expected.sort_unstable();
            prop_assert_eq!(found, expected);
            prop_assert_eq!(merge.next().unwrap(), None);
        }
    }
}
