//! Splitting a node together with all that has to be split for it: the forced splits of the implicit dependency (the
//! paper, 3.3.5), to a fixpoint.
//!
//! The nodes to be split form a stack: on top of a node the neighbour that blocks it, or a child that has to follow its
//! parent's split at once. Ids rise strictly along a chain of blocking neighbours, so it ends.
//!
//! Nobody but the node at the bottom wished those splits. So if that one cannot be split in the end, the next frame
//! would undo them all, the one after it begin again, and the picture would never come to rest. Hence:
//! - Where a limit is reached, what was split for the wish is undone at once, the last one first, and the front is as
//!   it was.
//! - Where a page is missing, what was split stays, and with it the pages for it; the nodes are not to be collapsed for
//!   [`PATIENCE`] frames, in which the page can come.
//! - Where the page is missing for a child that has to follow, it cannot stay, and is undone too; but its pages are
//!   held.

use crate::dependency::{self, Dependency};
use crate::front::{Front, Prepared};
use crate::navigator::NavigatorError;
use crate::paging::{Paging, Use, Want};
use crate::pool::Hold;

/// Most nodes of a chain of neighbours. Of a longer one the end is worked off first, and then it is begun again.
const CHAIN_LIMIT: usize = if cfg!(test) { 12 } else { 1024 };
/// Most nodes on the stack, with the children that have to follow. If they are more, the wish is given up.
const STACK_LIMIT: usize = 2048;
/// Most splits that can be undone. Those before stay, unless a child still has to follow; then the wish is given up.
const LOG_LIMIT: usize = 8192;
/// How many frames what was split for a node waits for a page that is missing.
pub const PATIENCE: u16 = 4;
/// Bytes that the chain takes.
pub const CHAIN_BYTES: usize = (STACK_LIMIT + 2) * size_of::<Link>() + LOG_LIMIT * size_of::<Done>();

/// What became of a wish to split a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It is split.
    Split,
    /// A page is missing.
    Missing,
    /// The front is full.
    FrontFull,
    /// Too many pages are in use.
    PoolFull,
    /// The chain of dependencies is too long for one go.
    Blocked,
}

/// What was done for a wish.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refinement {
    /// What became of the wish.
    pub outcome: Outcome,
    /// Splits applied and not undone.
    pub splits: u64,
    /// Those of them that the wish needed, but nobody wished.
    pub forced: u64,
}

#[derive(Debug, Clone, Copy)]
struct Link {
    vertex: u32,
    /// That of the node at the vertex: once that node is split there is another one.
    id: u32,
    /// Whether it is a child that has to follow its parent's split: before that, the front is not as it must be.
    follows: bool,
}

/// A split that was applied.
#[derive(Debug, Clone, Copy)]
struct Done {
    born: u32,
    is_wish: bool,
}

/// The stack of nodes to be split, and the log of the splits that may have to be undone.
#[derive(Debug)]
pub struct Chain {
    stack: Vec<Link>,
    log: Vec<Done>,
}

impl Chain {
    /// An empty chain. Its memory is allocated here, once.
    pub fn new() -> Self {
        // The children of a node at the limit go beyond it.
        Chain { stack: Vec::with_capacity(STACK_LIMIT + 2), log: Vec::with_capacity(LOG_LIMIT) }
    }
}

/// What a split works on.
#[derive(Debug)]
pub struct Refiner<'a> {
    /// The front.
    pub front: &'a mut Front,
    /// The way to the pages.
    pub paging: &'a mut Paging,
    /// Room for the chain.
    pub chain: &'a mut Chain,
    /// What keeps a split from being applied at once.
    pub dependency: Dependency,
    /// Most active triangles.
    pub triangle_limit: usize,
    /// The clock by which collapses are deferred, in frames, modulo 65536.
    pub now: u16,
}

/// The page that the split of the active node at a vertex is in.
pub fn want(front: &Front, vertex: u32, error: f32) -> Want {
    // The roots are the first vertices of the front, in their order.
    Want { page: front.place(vertex).0, parent_slot: front.slot_above(vertex), root: vertex, error }
}

/// What became of the topmost node of the stack.
enum Step {
    Applied {
        /// The vertex that was born.
        born: u32,
    },
    /// The node at this vertex has to be split before.
    After(u32),
    Impossible(Outcome),
}

impl Refiner<'_> {
    /// Splits the active node at the vertex `wish`, and before it what has to be. What was applied in the end, [`Refiner::born`]
    /// tells. Its error is so many times the threshold.
    pub fn split(&mut self, wish: u32, error: f32) -> Result<Refinement, NavigatorError> {
        let wish = Link { vertex: wish, id: self.front.id(wish), follows: false };
        self.chain.stack.clear();
        self.chain.log.clear();
        self.chain.stack.push(wish);
        let mut done = Refinement { outcome: Outcome::Split, splits: 0, forced: 0 };
        let mut is_cut = false;
        loop {
            let Some(link) = self.chain.stack.last().copied() else {
                if !is_cut {
                    return Ok(done);
                }
                // The end of a long chain is done: once more from its beginning.
                is_cut = false;
                self.chain.stack.push(wish);
                continue;
            };
            if self.front.id(link.vertex) != link.id {
                self.chain.stack.pop();
                continue;
            }
            let step =
                if self.is_too_long() { Ok(Step::Impossible(Outcome::Blocked)) } else { self.step(link.vertex, error) };
            match step {
                Ok(Step::Applied { born }) => {
                    done.splits += 1;
                    done.forced += u64::from(link.id != wish.id || link.vertex != wish.vertex);
                    self.chain.log.push(Done { born, is_wish: link.id == wish.id && link.vertex == wish.vertex });
                    if self.dependency == Dependency::Implicit {
                        self.follow_up([link.vertex, born]);
                    } else {
                        self.chain.stack.pop();
                    }
                }
                Ok(Step::After(neighbour)) => {
                    if self.chain.stack.len() >= CHAIN_LIMIT {
                        self.chain.stack.retain(|link| link.follows);
                        is_cut = true;
                    }
                    let id = self.front.id(neighbour);
                    self.chain.stack.push(Link { vertex: neighbour, id, follows: false });
                }
                Ok(Step::Impossible(outcome)) => {
                    if outcome != Outcome::Missing {
                        self.undo(&mut done, Hold::Keep);
                    } else if self.chain.stack.iter().any(|link| link.follows) {
                        self.undo(&mut done, Hold::Renew);
                    } else {
                        let until = self.now.wrapping_add(PATIENCE);
                        self.chain.log.iter().for_each(|split| self.front.defer_collapse(split.born, until));
                    }
                    done.outcome = outcome;
                    return Ok(done);
                }
                Err(error) => {
                    self.undo(&mut done, Hold::Keep);
                    return Err(error);
                }
            }
        }
    }

    /// The vertices that the splits applied for the last wish bore; of a very long chain only the last ones.
    pub fn born(&self) -> impl Iterator<Item = u32> + '_ {
        self.chain.log.iter().map(|split| split.born)
    }

    /// Whether nothing more fits into the chain because too many children have to follow.
    fn is_too_long(&mut self) -> bool {
        let Chain { stack, log } = &mut self.chain;
        if log.len() >= LOG_LIMIT {
            if stack.iter().any(|link| link.follows) {
                return true;
            }
            log.clear();
        }
        stack.len() >= STACK_LIMIT
    }

    /// Applies the split of the node at a vertex, if nothing is in its way. `error` is that of the wish.
    fn step(&mut self, vertex: u32, error: f32) -> Result<Step, NavigatorError> {
        let slot = match self.paging.begin_use(&want(self.front, vertex, error)) {
            Use::Granted { slot } => slot,
            Use::Missing => return Ok(Step::Impossible(Outcome::Missing)),
            Use::Refused => return Ok(Step::Impossible(Outcome::PoolFull)),
        };
        let page = self.paging.page(slot);
        let prepared = match self.front.prepare(vertex, page) {
            Ok(prepared) => prepared,
            Err(source) => {
                let number = page.number();
                self.paging.cancel_use(slot);
                return Err(self.paging.misfit(number, source));
            }
        };
        if let Some(refused) = self.refusal(&prepared) {
            self.paging.cancel_use(slot);
            return Ok(refused);
        }
        let born = self.front.split(&prepared, page, slot);
        Ok(Step::Applied { born })
    }

    /// What keeps a prepared split from being applied.
    fn refusal(&self, prepared: &Prepared) -> Option<Step> {
        if self.dependency == Dependency::Implicit
            && let Some(other) = dependency::blocking_vertex(self.front, self.paging, prepared)
        {
            return Some(Step::After(other));
        }
        let born = self.front.thirds().len();
        let fits = self.front.has_room(born) && self.front.triangle_count() + born <= self.triangle_limit;
        (!fits).then_some(Step::Impossible(Outcome::FrontFull))
    }

    /// After the split of the topmost node: takes it off the stack, and puts its children there if they have to follow.
    fn follow_up(&mut self, [kept, born]: [u32; 2]) {
        let stack = &mut self.chain.stack;
        // While a child is still to follow, so may be the children of any node: what it is too late for may be
        // anywhere around them. Else only the new triangles matter.
        let look_around = stack.iter().any(|link| link.follows);
        stack.pop();
        for (child, other) in [(kept, born), (born, kept)] {
            if dependency::is_late(self.front, self.paging, child, (!look_around).then_some(other)) {
                stack.push(Link { vertex: child, id: self.front.id(child), follows: true });
            }
        }
    }

    /// Undoes the splits in the log.
    fn undo(&mut self, done: &mut Refinement, hold: Hold) {
        while let Some(Done { born, is_wish }) = self.chain.log.pop() {
            let slot = self.front.slot(born);
            self.front.collapse(born, self.paging.page_number(slot));
            self.paging.end_use(slot, hold);
            done.splits -= 1;
            done.forced -= u64::from(!is_wish);
        }
    }
}
