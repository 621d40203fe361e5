//! Splitting a node together with all that has to be split for it: the forced splits of the implicit dependency (the
//! paper, 3.3.5), to a fixpoint.
//!
//! The nodes to be split form a stack: on top of a node the neighbour that blocks it, or a child that has to follow its
//! parent's split at once. Ids rise strictly along a chain of blocking neighbours, so it ends.
//!
//! With [`Dependency::Flip`] it is a triangle that stands on top of the node whose split may have turned it round: the node at its
//! corner that is split for it is chosen when its turn comes, if it still has to be repaired. Nodes come down to leaves, so
//! that ends, too; but where [`REPAIR_LIMIT`] splits do not do, what was split for triangles is undone, and the wish stays alone.
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
use crate::flip;
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
/// Most splits that are forced for a wish in order to repair triangles. Where they do not do, the wish is split without them.
const REPAIR_LIMIT: u64 = 256;
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
    /// Triangles that the splits turned round, or might have, and that are drawn the right way round after them.
    pub repaired: u64,
    /// Triangles that were left as they are, because too many splits would have been needed.
    pub unrepaired: u64,
}

#[derive(Debug, Clone, Copy)]
struct Link {
    vertex: u32,
    /// That of the node at the vertex: once that node is split there is another one.
    id: u32,
    kind: Kind,
}

/// What a link stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// The node that is wished to be split, or one that blocks another.
    Node,
    /// A child that has to follow its parent's split: before that, the front is not as it must be.
    Child,
    /// A triangle that has to be repaired, which is the same. It is named in place of a vertex, and there is no id.
    Triangle,
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
        let wish = Link { vertex: wish, id: self.front.id(wish), kind: Kind::Node };
        self.chain.stack.clear();
        self.chain.log.clear();
        self.chain.stack.push(wish);
        let mut done = Refinement { outcome: Outcome::Split, splits: 0, forced: 0, repaired: 0, unrepaired: 0 };
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
            let Some(link) = self.still_due(link) else {
                self.chain.stack.pop();
                done.repaired += u64::from(link.kind == Kind::Triangle);
                continue;
            };
            if link.kind == Kind::Triangle && done.forced >= REPAIR_LIMIT {
                self.give_up_repair(&mut done);
                return Ok(done);
            }
            let step =
                if self.is_too_long() { Ok(Step::Impossible(Outcome::Blocked)) } else { self.step(link.vertex, error) };
            match step {
                Ok(Step::Applied { born }) => {
                    done.splits += 1;
                    done.forced += u64::from(link.id != wish.id || link.vertex != wish.vertex);
                    self.chain.log.push(Done { born, is_wish: link.id == wish.id && link.vertex == wish.vertex });
                    match self.dependency {
                        Dependency::Implicit => self.follow_up([link.vertex, born]),
                        Dependency::Flip => self.repair([link.vertex, born]),
                        Dependency::None => {
                            self.chain.stack.pop();
                        }
                    }
                }
                Ok(Step::After(neighbour)) => {
                    if self.chain.stack.len() >= CHAIN_LIMIT {
                        self.chain.stack.retain(|link| link.kind != Kind::Node);
                        is_cut = true;
                    }
                    let id = self.front.id(neighbour);
                    self.chain.stack.push(Link { vertex: neighbour, id, kind: Kind::Node });
                }
                Ok(Step::Impossible(outcome)) => {
                    if outcome != Outcome::Missing {
                        self.undo(&mut done, Hold::Keep);
                    } else if self.chain.stack.iter().any(|link| link.kind != Kind::Node) {
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

    /// What a link stands for now: the node of it, if that is active still; or the one that is to be split for a triangle, if it has
    /// to be repaired still.
    fn still_due(&self, link: Link) -> Option<Link> {
        if link.kind != Kind::Triangle {
            return (self.front.id(link.vertex) == link.id).then_some(link);
        }
        let is_due = flip::triangle_is_suspect(self.front, link.vertex);
        let vertex = is_due.then(|| flip::vertex_to_split(self.front, link.vertex)).flatten()?;
        Some(Link { vertex, id: self.front.id(vertex), ..link })
    }

    /// After the split of the topmost node: takes it off the stack, unless it stands for a triangle; and puts there those around
    /// the children that have to be repaired. Where they are too many, the stack is so long that the wish is given up.
    fn repair(&mut self, children: [u32; 2]) {
        let (front, stack) = (&*self.front, &mut self.chain.stack);
        stack.pop_if(|link| link.kind != Kind::Triangle);
        for triangle in flip::suspects_at(front, children) {
            let is_new = || stack.iter().all(|link| link.kind != Kind::Triangle || link.vertex != triangle);
            if stack.len() < STACK_LIMIT && is_new() {
                stack.push(Link { vertex: triangle, id: 0, kind: Kind::Triangle });
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
            if stack.iter().any(|link| link.kind != Kind::Node) {
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
        let fits = self.front.has_room(prepared) && self.front.triangle_count() + born <= self.triangle_limit;
        (!fits).then_some(Step::Impossible(Outcome::FrontFull))
    }

    /// After the split of the topmost node: takes it off the stack, and puts its children there if they have to follow.
    fn follow_up(&mut self, [kept, born]: [u32; 2]) {
        let stack = &mut self.chain.stack;
        // While a child is still to follow, so may be the children of any node: what it is too late for may be
        // anywhere around them. Else only the new triangles matter.
        let look_around = stack.iter().any(|link| link.kind != Kind::Node);
        stack.pop();
        for (child, other) in [(kept, born), (born, kept)] {
            let is_late = if look_around {
                dependency::is_late(self.front, self.paging, child, |_| true)
            } else {
                dependency::is_born_late(self.front, self.paging, child, other)
            };
            if is_late {
                stack.push(Link { vertex: child, id: self.front.id(child), kind: Kind::Child });
            }
        }
    }

    /// Undoes what was split for triangles to be repaired, but not the wish itself.
    fn give_up_repair(&mut self, done: &mut Refinement) {
        let Some(wish) = self.chain.log.iter().find(|split| split.is_wish).copied() else { return };
        self.undo_down_to(1, done, Hold::Keep);
        let children = [self.front.kept(wish.born), wish.born];
        done.unrepaired = flip::suspects_at(self.front, children).count() as u64;
    }

    /// Undoes the splits in the log.
    fn undo(&mut self, done: &mut Refinement, hold: Hold) {
        self.undo_down_to(0, done, hold);
    }

    /// Undoes the splits in the log but for so many of the first.
    fn undo_down_to(&mut self, first: usize, done: &mut Refinement, hold: Hold) {
        while self.chain.log.len() > first
            && let Some(Done { born, is_wish }) = self.chain.log.pop()
        {
            let slot = self.front.slot(born);
            self.front.collapse(born, self.paging.page_number(slot));
            self.paging.end_use(slot, hold);
            done.splits -= 1;
            done.forced -= u64::from(!is_wish);
        }
        done.repaired = 0;
    }
}
