//! The pool of place holders (the paper, 3.3.3): a fixed number of slots, allocated once, each with room for any page.
//!
//! A page in a slot is in the *physical main memory*: the hash table leads to it. The *usage count* of the paper, how many
//! splits of a page are applied, is the navigator's own (see [`paging`](crate::paging)); the pool is told when it leaves
//! zero and when it comes back to it. In place of the *reference count*, how many pages in use have a page prefetched, stands a
//! *wish* with a priority: the navigator names, frame by frame, the pages that it will probably use soon (see
//! [`prediction`](crate::prediction)), and a page is prefetched as long as it is named. And for [`HOLD_FRAMES`] frames a page
//! may be *held*, for a node that asked for it urgently and has not used it yet, or had to let go of it because another page
//! is missing. Then it gives way to nobody: else urgent pages would push each other out for nothing. A slot that is not in
//! use, not wished, not held and without child pages is in the *free list*, and is given to the next page that needs one. Its
//! page stays in the hash table until then: when it is asked for again before, it gets a *second chance*, and is taken out
//! of the free list without a disk read. Freed slots go to the end of the list, slots to be filled come from its front.
//!
//! A page that is wished takes a free slot, else that of the page that is wished least, if that is less than itself. A page that
//! is wanted urgently takes either; so prefetching never keeps out what is needed, nor pushes out what is needed sooner.
//!
//! # Other policies
//!
//! With [`Policy::LeastRecentlyUsed`] the free and the prefetched slots are one list, in the order in which their pages went out
//! of use, or were first wished; whoever needs a slot takes its first. (A wish still does not push out a stronger one.) With
//! [`Policy::None`] there is no second chance: a page goes with the last that needs it.
//!
//! # Ancestors before descendants
//!
//! A page is decoded with all its ancestors at hand, from a root page down to its parent. So a page is only loaded below
//! a parent that is there, and a slot counts the child pages that are there or being read: while there are any it is in
//! no list from which slots are given out, whatever else it is. Leaves of the page tree go first; with its last
//! child gone, a page is what its other marks make of it. So the ancestors of a page that is there are always there.
//!
//! # Whose a page is
//!
//! All that is known about slots is under one lock, which nobody holds during a disk read or while a page is decoded. The
//! pages themselves are shared by counted references: the pool has one to each, the navigator one to each that is in use, and
//! reads it without asking anybody. Who is to fill a slot gets its page out of the pool, and as nobody else can have it then
//! he is free to write to it; and references to its ancestors, which stay as they are until he is done.
//!
//! # Never all in use
//! The paper's rule of three: urgent prefetching for switching down only while at least three place holders are not in
//! use, because switching down may bring two more into use (one for each child), so that one remains. Here a page is in
//! use while one of its *splits* is applied, and its ancestors cannot go then either. So what counts are the pages that
//! are *needed*: in use, or above one that is. The pages that are there and not needed have no needed page below them,
//! so with one of them there is also one without children, whose slot can be had, unless it is held.
//!
//! - A split needs at most one page more: its own. Its parent's split is applied, in the same page or in the parent page;
//!   so that one is in use, and the ancestors are needed already. The root of a tree has no parent: it needs its page,
//!   and those of the way to it that nobody needed. A split is refused while fewer than
//!   [`LEAST_FOR_SPLIT`] = 2 slots are not needed, and one more for each further page that it needs; so at least one
//!   remains.
//! - A collapse needs no page that is not there: the split that it undoes is applied, so its page is in use. Switching
//!   up can always go on, and never has to wait for a disk.
//! - A page is loaded urgently only while at least [`LEAST_FOR_URGENT`] = 3 slots are not needed: one that it goes to,
//!   one that stays, and one more for a page that comes into use while it is being read. With fewer it could be read
//!   for nothing. For the root of a tree, one more for each page on the way to it that is not needed yet.
//!
//! Those are the least. Of more slots, an eighth is reserved for what is not in use (see [`reserved_slots`]): else a
//! pool that is the limit of what is drawn would be in use nearly as a whole, with no slot for what is prefetched. (Dragon in
//! 16 MB: misses 5.6 % without, 2.1 % with an eighth and a tenth fewer triangles; with a fifth 2.0 %, and a sixth fewer; one run each.)
//!
//! So a page on level l of the page tree can be used, whatever else was let go, with l + 2 slots: its l - 1 ancestors and
//! the three that it asks for.

use std::ops::{AddAssign, Sub};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use hashbrown::HashMap;
use metanode::header::Header;
use metanode::page::{Page, PageLocation};
use parking_lot::Mutex;

use crate::board::Command;
use crate::front::NONE;
use crate::paging::TABLE_ENTRY_BYTES;

/// Slots that must not be needed for a split that needs one more page, at the least.
pub const LEAST_FOR_SPLIT: usize = 2;
/// Slots that must not be needed for a page to be loaded urgently whose ancestors are, at the least.
pub const LEAST_FOR_URGENT: usize = 3;

/// The part of the slots that are reserved for what is prefetched.
const RESERVED_PART: usize = 8;

/// How many of so many slots, for this model, must stay for what is not in use: fewer where nearly all pages have a slot, or where
/// a page on the last level could not be used.
pub fn reserved_slots(slots: usize, header: &Header) -> usize {
    let missing = (header.page_count as usize + LEAST_FOR_SPLIT).saturating_sub(slots);
    let not_on_the_way = slots.saturating_sub(header.page_levels as usize);
    (slots / RESERVED_PART).min(missing).min(not_on_the_way).max(LEAST_FOR_SPLIT)
}

/// How many frames a page that was loaded urgently waits for its use.
pub const HOLD_FRAMES: u32 = 4;

/// Bytes that a slot takes beside what is in its page: the page's counts, references to it, the pool's marks, its
/// entries in the pool's hash table and in the navigator's, and the navigator's notes of its page and of its usage count.
pub const SLOT_OVERHEAD_BYTES: usize = 2 * size_of::<usize>()
    + size_of::<Page>()
    + 2 * size_of::<Arc<Page>>()
    + size_of::<Slot>()
    + 2 * TABLE_ENTRY_BYTES
    + 2 * size_of::<u32>();

/// Words with a bit for each of so many pages.
fn there_words(model_pages: usize) -> usize {
    model_pages.div_ceil(64)
}

/// Bytes of RAM that the notes take of which pages of a model are there.
pub fn there_bytes(model_pages: usize) -> usize {
    2 * size_of::<usize>() + there_words(model_pages) * size_of::<u64>()
}

/// What becomes of pages that nobody needs at the moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Policy {
    /// The paper's: such a page is found again without a disk read as long as its place holder was not needed, and
    /// prefetched ones come after those that are not.
    #[default]
    SecondChance,
    /// The one that was not used for the longest time makes room, prefetched or not.
    LeastRecentlyUsed,
    /// It is forgotten.
    None,
}

/// How far a slot has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// There is no page in it.
    Empty,
    /// A page is being read into it.
    Loading,
    /// There is a page in it.
    Ready,
}

/// What a slot is at the moment. Those of the first two may be given to other pages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Nobody needs its page: in the free list.
    Free,
    /// Its page is only prefetched.
    Prefetched,
    /// Its page is held for a node that is to use it.
    Held,
    /// Its page is there for its child pages, whatever it is besides.
    Above,
    /// Its page is in use.
    Used,
    /// Its page is being read.
    Loading,
}

/// Number of lists.
const LISTS: usize = 3;

/// First and last slot of a list, and how many there are.
#[derive(Debug, Clone, Copy)]
struct List {
    first: u32,
    last: u32,
    length: usize,
}

#[derive(Debug, Clone, Copy)]
struct Slot {
    /// The page in it, last in it, or on its way.
    page: u32,
    stage: Stage,
    /// Whether any split of the page is applied.
    in_use: bool,
    /// How strongly it is wished, and with which of the lists of wishes it last was.
    wish: f32,
    wished_with: u32,
    /// Whether it was loaded for a wish, and not used since.
    is_untried: bool,
    /// The frame in which the page was held for a node that is to use it.
    held: Option<u32>,
    /// The slot of its parent page, [`NONE`] for a root page.
    parent: u32,
    /// How many of its child pages are there or being read; how many of those are needed, and how many kept.
    children: u32,
    needed_children: u32,
    kept_children: u32,
    /// What follows from all that: whether its page is in use or above one that is; whether it is or is above one that is
    /// in use or held.
    is_needed: bool,
    is_kept: bool,
    kind: Kind,
    /// Neighbours in the list.
    before: u32,
    after: u32,
}

impl Slot {
    /// A slot without a page.
    const EMPTY: Slot = Slot {
        page: NONE,
        stage: Stage::Empty,
        in_use: false,
        wish: 0.0,
        wished_with: 0,
        is_untried: false,
        held: None,
        parent: NONE,
        children: 0,
        needed_children: 0,
        kept_children: 0,
        is_needed: false,
        is_kept: false,
        kind: Kind::Free,
        before: NONE,
        after: NONE,
    };

    fn is_needed(&self) -> bool {
        self.in_use || self.needed_children > 0
    }

    fn is_kept(&self) -> bool {
        self.is_needed() || self.held.is_some() || self.kept_children > 0
    }

    /// `wishes` is the number of the present list of wishes.
    fn kind(&self, wishes: u32) -> Kind {
        if self.stage == Stage::Loading {
            Kind::Loading
        } else if self.in_use {
            Kind::Used
        } else if self.held.is_some() {
            Kind::Held
        } else if self.children > 0 {
            Kind::Above
        } else if self.stage == Stage::Ready && self.wished_with == wishes {
            Kind::Prefetched
        } else {
            Kind::Free
        }
    }
}

/// What happened in the pool of place holders: since it was made, in a frame, or in a flight.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PoolCounters {
    /// Pages read from disk.
    pub reads: u64,
    /// Their encoded bytes.
    pub bytes_read: u64,
    /// Flushed pages that were still there when they were asked for again.
    pub second_chances: u64,
    /// Pages loaded urgently.
    pub urgent: u64,
    /// Pages loaded because they were wished.
    pub prefetched: u64,
    /// Those of them that came into use.
    pub prefetch_used: u64,
    /// Wishes given up because there was no slot for them.
    pub prefetch_given_up: u64,
    /// Requests and wishes that nobody repeated before they were begun.
    pub cancelled: u64,
    /// Pages that made room for others.
    pub evicted: u64,
    /// Those of them that were still wished.
    pub evicted_wished: u64,
    /// Those of them that were prefetched in vain.
    pub evicted_untried: u64,
    /// Reads that were tried again.
    pub retries: u64,
    /// Pages that could not be read, however often it was tried.
    pub read_failures: u64,
    /// Urgent pages that found no room, because what is not needed is held for others; and pages that could not be
    /// held.
    pub starved: u64,
}

impl PoolCounters {
    /// Each counter made of the two.
    fn each(self, other: Self, of: impl Fn(u64, u64) -> u64) -> Self {
        PoolCounters {
            reads: of(self.reads, other.reads),
            bytes_read: of(self.bytes_read, other.bytes_read),
            second_chances: of(self.second_chances, other.second_chances),
            urgent: of(self.urgent, other.urgent),
            prefetched: of(self.prefetched, other.prefetched),
            prefetch_used: of(self.prefetch_used, other.prefetch_used),
            prefetch_given_up: of(self.prefetch_given_up, other.prefetch_given_up),
            cancelled: of(self.cancelled, other.cancelled),
            evicted: of(self.evicted, other.evicted),
            evicted_wished: of(self.evicted_wished, other.evicted_wished),
            evicted_untried: of(self.evicted_untried, other.evicted_untried),
            retries: of(self.retries, other.retries),
            read_failures: of(self.read_failures, other.read_failures),
            starved: of(self.starved, other.starved),
        }
    }
}

/// What happened between two readings.
impl Sub for PoolCounters {
    type Output = Self;

    fn sub(self, before: Self) -> Self {
        self.each(before, |after, before| after - before)
    }
}

impl AddAssign for PoolCounters {
    fn add_assign(&mut self, more: Self) {
        *self = self.each(more, |sum, more| sum + more);
    }
}

#[derive(Debug)]
struct State {
    policy: Policy,
    /// The pages of the slots; of a slot that is being filled one without records.
    pages: Vec<Arc<Page>>,
    table: HashMap<u32, u32>,
    /// The pool's notes of what is in the table.
    is_there: Arc<[AtomicU64]>,
    slots: Vec<Slot>,
    lists: [List; LISTS],
    in_use: usize,
    needed: usize,
    kept: usize,
    loading: usize,
    /// Counts the frames.
    frame: u32,
    /// Counts the lists of wishes.
    wishes: u32,
    /// Counts changes that can make room or take it.
    version: u64,
    counters: PoolCounters,
}

/// What became of a wish to use a page.
#[derive(Debug, Clone)]
pub enum Found {
    /// It is in this slot, in use.
    Granted {
        /// The slot.
        slot: u32,
        /// The page, where it was not in use before.
        fresh: Option<Arc<Page>>,
    },
    /// It is not there, and may be asked for.
    Missing,
    /// It is not there, but being read.
    Coming,
    /// Too many slots are in use.
    Refused,
}

/// What becomes of the hold on a page that goes out of use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// It ends.
    End,
    /// It stays what it was.
    Keep,
    /// It begins anew: the page is only let go until another one has come.
    Renew,
}

/// A slot that is to be filled, and then handed back to [`Pool::loaded`].
#[derive(Debug)]
pub struct Filling {
    /// The slot.
    pub slot: u32,
    /// Its page, which nobody else has.
    pub page: Arc<Page>,
    /// The ancestors of the page that is to be read, from the root page down to its parent.
    pub ancestors: Vec<Arc<Page>>,
}

/// What became of a wish to have a page.
#[derive(Debug)]
pub enum Room {
    /// It is there, or being read.
    Resident,
    /// It is to be read.
    Slot(Filling),
    /// Not before some page that is being read is there.
    Later,
    /// There is no room for it, or its parent is not there.
    None,
}

/// The place holders, with all that is known about them.
#[derive(Debug)]
pub struct Pool {
    state: Mutex<State>,
    slot_count: usize,
    /// A bit for each page of the model: whether it is in a slot, or on its way there.
    is_there: Arc<[AtomicU64]>,
    /// Slots that must not be needed for a split that needs one more page.
    least_for_split: usize,
    /// A page without records.
    nothing: Arc<Page>,
}

impl State {
    /// The list that slots of this kind are in.
    fn list_of(&self, kind: Kind) -> Option<usize> {
        match kind {
            Kind::Free => Some(0),
            Kind::Prefetched if self.policy == Policy::LeastRecentlyUsed => Some(0),
            Kind::Prefetched => Some(1),
            Kind::Held => Some(2),
            Kind::Above | Kind::Used | Kind::Loading => None,
        }
    }

    /// The first slot in the list of this kind.
    fn first(&self, kind: Kind) -> u32 {
        self.list_of(kind).map_or(NONE, |list| self.lists[list].first)
    }

    /// The slots in the list of this kind, in their order.
    fn listed(&self, kind: Kind) -> impl Iterator<Item = u32> + '_ {
        let there = |slot: u32| Some(slot).filter(|slot| *slot != NONE);
        std::iter::successors(there(self.first(kind)), move |slot| there(self.slots[*slot as usize].after))
    }

    /// Takes a slot out of the list that it is in, if any.
    fn unlink(&mut self, slot: u32) {
        let Slot { kind, before, after, .. } = self.slots[slot as usize];
        let Some(list) = self.list_of(kind) else { return };
        match before {
            NONE => self.lists[list].first = after,
            before => self.slots[before as usize].after = after,
        }
        match after {
            NONE => self.lists[list].last = before,
            after => self.slots[after as usize].before = before,
        }
        self.lists[list].length -= 1;
    }

    /// Puts a slot at the end of the list of its kind, if there is one.
    fn append(&mut self, slot: u32) {
        let Some(list) = self.list_of(self.slots[slot as usize].kind) else { return };
        let before = std::mem::replace(&mut self.lists[list].last, slot);
        match before {
            NONE => self.lists[list].first = slot,
            before => self.slots[before as usize].after = slot,
        }
        self.lists[list].length += 1;
        let entry = &mut self.slots[slot as usize];
        (entry.before, entry.after) = (before, NONE);
    }

    /// A page is in a slot, or on its way there.
    fn enter(&mut self, page: u32, slot: u32) {
        self.table.insert(page, slot);
        if let Some(word) = self.is_there.get(page as usize / 64) {
            word.fetch_or(1 << (page % 64), Ordering::Relaxed);
        }
    }

    /// It is not any more.
    fn forget(&mut self, page: u32) {
        self.table.remove(&page);
        if let Some(word) = self.is_there.get(page as usize / 64) {
            word.fetch_and(!(1 << (page % 64)), Ordering::Relaxed);
        }
    }

    /// The slot with this page. One in the free list gets its second chance: the caller takes it out of there.
    fn find(&mut self, page: u32) -> Option<u32> {
        let slot = *self.table.get(&page)?;
        self.counters.second_chances += u64::from(self.slots[slot as usize].kind == Kind::Free);
        Some(slot)
    }

    /// The slot that a page can have, of those whose pages are of this kind: the first in their list, but not that of its own
    /// parent. [`NONE`] where there is none.
    fn first_but(&self, kind: Kind, parent: u32) -> u32 {
        let first = self.first(kind);
        if first != NONE && first == parent { self.slots[first as usize].after } else { first }
    }

    /// The slot of a parent page, [`NONE`] for that of a root page, which has none; where it is not there, whether it will
    /// be.
    fn slot_of_parent(&self, parent: Option<u32>) -> Result<u32, Room> {
        let Some(parent) = parent else { return Ok(NONE) };
        match self.table.get(&parent) {
            None => Err(Room::None),
            Some(slot) if self.slots[*slot as usize].stage != Stage::Ready => Err(Room::Later),
            Some(slot) => Ok(*slot),
        }
    }

    /// The slots above one, from that of its parent up.
    fn above(&self, slot: u32) -> impl Iterator<Item = u32> + '_ {
        let parent = |slot: u32| Some(self.slots[slot as usize].parent).filter(|parent| *parent != NONE);
        std::iter::successors(parent(slot), move |slot| parent(*slot))
    }

    /// The pages above a slot, from the root page down.
    fn ancestors(&self, slot: u32) -> Vec<Arc<Page>> {
        let mut ancestors: Vec<_> = self.above(slot).map(|slot| self.pages[slot as usize].clone()).collect();
        ancestors.reverse();
        ancestors
    }

    /// Puts a slot into the list that it belongs to after a change; one that was held, or that nobody needs any more, to
    /// its end. Then the same for those above it, as far as it changes anything for them.
    fn settle(&mut self, slot: u32) {
        let mut slot = slot;
        while slot != NONE {
            slot = self.settle_one(slot);
        }
    }

    /// Settles one slot. Returns that of the parent, where something changed for it.
    fn settle_one(&mut self, slot: u32) -> u32 {
        let before = self.slots[slot as usize];
        let (kind, is_needed, is_kept) = (before.kind(self.wishes), before.is_needed(), before.is_kept());
        let is_flushed = kind == Kind::Free && before.stage == Stage::Ready && self.policy == Policy::None;
        if is_flushed {
            self.forget(before.page);
            self.counters.evicted_untried += u64::from(before.is_untried);
        }
        let only_unwished = (before.kind, kind) == (Kind::Prefetched, Kind::Free);
        if only_unwished && self.policy == Policy::LeastRecentlyUsed {
            self.slots[slot as usize].kind = kind;
        } else if kind != before.kind || (kind == Kind::Held && before.held == Some(self.frame)) {
            self.unlink(slot);
            self.slots[slot as usize].kind = kind;
            self.append(slot);
        }
        let entry = &mut self.slots[slot as usize];
        (entry.is_needed, entry.is_kept) = (is_needed, is_kept);
        let is_gone = is_flushed || before.stage == Stage::Empty;
        if is_gone {
            (entry.stage, entry.parent, entry.is_untried) = (Stage::Empty, NONE, false);
        }
        let is_new = kind != before.kind && !only_unwished && (before.kind, kind) != (Kind::Free, Kind::Prefetched);
        self.version += u64::from(is_new || is_gone);
        self.needed = self.needed + usize::from(is_needed) - usize::from(before.is_needed);
        self.kept = self.kept + usize::from(is_kept) - usize::from(before.is_kept);
        let Some(parent) = self.slots.get_mut(before.parent as usize) else { return NONE };
        parent.children -= u32::from(is_gone);
        parent.needed_children = parent.needed_children + u32::from(is_needed) - u32::from(before.is_needed);
        parent.kept_children = parent.kept_children + u32::from(is_kept) - u32::from(before.is_kept);
        let changed = is_gone || is_needed != before.is_needed || is_kept != before.is_kept;
        if changed { before.parent } else { NONE }
    }

    /// Lets go of what has been held for more than so many frames.
    fn end_holds(&mut self, frames: u32) {
        loop {
            let slot = self.first(Kind::Held);
            let Some(entry) = self.slots.get_mut(slot as usize) else { return };
            if entry.held.is_some_and(|since| self.frame.wrapping_sub(since) <= frames) {
                return;
            }
            entry.held = None;
            self.settle(slot);
        }
    }
}

impl Pool {
    /// A pool of the given place holders, which are empty and all of one size, for a model with so many pages; see
    /// [`reserved_slots`].
    pub fn new(pages: Vec<Page>, model_pages: usize, reserved: usize, policy: Policy) -> Self {
        let count = pages.len();
        let is_there: Arc<[AtomicU64]> = (0..there_words(model_pages)).map(|_| AtomicU64::new(0)).collect();
        let mut state = State {
            policy,
            pages: pages.into_iter().map(Arc::new).collect(),
            table: HashMap::with_capacity(count),
            is_there: is_there.clone(),
            slots: vec![Slot::EMPTY; count],
            lists: [List { first: NONE, last: NONE, length: 0 }; LISTS],
            in_use: 0,
            needed: 0,
            kept: 0,
            loading: 0,
            frame: 0,
            wishes: 1,
            version: 0,
            counters: PoolCounters::default(),
        };
        (0..count as u32).for_each(|slot| state.append(slot));
        let least_for_split = reserved.max(LEAST_FOR_SPLIT);
        Pool {
            state: Mutex::new(state),
            slot_count: count,
            is_there,
            least_for_split,
            nothing: Arc::new(Page::with_slot_bytes(0)),
        }
    }

    /// A page without records: what stands for one that is not there.
    pub fn nothing(&self) -> &Arc<Page> {
        &self.nothing
    }

    /// Gives the slot, whose page is not kept and has no children, to `page`, whose parent is in the slot `parent`.
    fn allocate(&self, state: &mut State, slot: u32, page: u32, parent: u32) -> Filling {
        state.unlink(slot);
        let previous = state.slots[slot as usize];
        if previous.stage != Stage::Empty {
            state.forget(previous.page);
            state.counters.evicted += 1;
            state.counters.evicted_wished += u64::from(previous.kind == Kind::Prefetched);
            state.counters.evicted_untried += u64::from(previous.is_untried);
        }
        state.enter(page, slot);
        state.slots[slot as usize] = Slot { page, stage: Stage::Loading, parent, kind: Kind::Loading, ..Slot::EMPTY };
        state.loading += 1;
        state.version += 1;
        if let Some(parent) = state.slots.get_mut(parent as usize) {
            parent.children += 1;
        }
        if let Some(parent) = state.slots.get_mut(previous.parent as usize) {
            parent.children -= 1;
        }
        [parent, previous.parent].into_iter().for_each(|parent| state.settle(parent));
        let page = std::mem::replace(&mut state.pages[slot as usize], self.nothing.clone());
        Filling { slot, page, ancestors: state.ancestors(slot) }
    }

    /// A frame begins: what was held long enough is let go. True if there is a slot in which no page ever was, so that no page has to
    /// go for another, and none goes without need. Navigator only.
    pub fn begin_frame(&self) -> bool {
        let mut state = self.state.lock();
        state.frame = state.frame.wrapping_add(1);
        state.end_holds(HOLD_FRAMES);
        let is_empty = |slot: u32| state.slots.get(slot as usize).is_some_and(|slot| slot.stage == Stage::Empty);
        state.policy != Policy::None && is_empty(state.first(Kind::Free))
    }

    /// Whether a page is in a slot, or on its way there: as it was a moment ago, without waiting for anybody.
    #[inline]
    pub fn is_there(&self, page: u32) -> bool {
        let word = self.is_there.get(page as usize / 64);
        word.is_some_and(|word| word.load(Ordering::Relaxed) >> (page % 64) & 1 == 1)
    }

    /// Lets go of all that is held: for who loads pages one at a time, and uses each at once.
    pub fn end_all_holds(&self) {
        let mut state = self.state.lock();
        state.frame = state.frame.wrapping_add(1);
        state.end_holds(0);
    }

    /// Number of slots.
    pub fn slot_count(&self) -> usize {
        self.slot_count
    }

    /// Slots whose page is in use.
    pub fn in_use(&self) -> usize {
        self.state.lock().in_use
    }

    /// Slots in which there is a page.
    pub fn ready(&self) -> usize {
        let state = self.state.lock();
        state.table.len() - state.loading
    }

    /// Slots whose page is in use or above one that is.
    pub fn needed(&self) -> usize {
        self.state.lock().needed
    }

    /// What happened so far.
    pub fn counters(&self) -> PoolCounters {
        self.state.lock().counters
    }

    /// Counts what is not the pool's own doing.
    pub fn count(&self, change: impl FnOnce(&mut PoolCounters)) {
        change(&mut self.state.lock().counters);
    }

    /// Counts changes after which what found no room may find some.
    pub fn version(&self) -> u64 {
        self.state.lock().version
    }

    /// The ancestors of the page in a slot, from the root page down to its parent; for who knows that the page is there.
    pub fn ancestors(&self, slot: u32) -> Vec<Arc<Page>> {
        self.state.lock().ancestors(slot)
    }

    /// A first split of this page, or a further one, is to be applied. `way` are those of its ancestors that need not be
    /// there: all of them for the root of a tree, else none. Navigator only.
    pub fn use_page(&self, page: u32, way: &[PageLocation]) -> Found {
        let mut state = self.state.lock();
        let not_needed = self.slot_count - state.needed;
        let there = state.table.get(&page).copied();
        let Some(slot) = there.filter(|slot| state.slots[*slot as usize].stage == Stage::Ready) else {
            let is_needed = |page: &&PageLocation| {
                state.table.get(&page.number).is_some_and(|slot| state.slots[*slot as usize].is_needed)
            };
            let more = way.len() - way.iter().filter(is_needed).count();
            if not_needed < self.least_for_split + 1 + more {
                return Found::Refused;
            }
            let Some(slot) = there else { return Found::Missing };
            let frame = state.frame;
            state.slots[slot as usize].held = Some(frame);
            state.settle(slot);
            return Found::Coming;
        };
        if state.slots[slot as usize].in_use {
            return Found::Granted { slot, fresh: None };
        }
        let pages = std::iter::once(slot).chain(state.above(slot));
        let more = pages.filter(|slot| !state.slots[*slot as usize].is_needed).count();
        if not_needed + 1 < self.least_for_split + more {
            return Found::Refused;
        }
        state.find(page);
        state.in_use += 1;
        let entry = &mut state.slots[slot as usize];
        entry.in_use = true;
        let was_untried = std::mem::replace(&mut entry.is_untried, false);
        state.counters.prefetch_used += u64::from(was_untried);
        state.settle(slot);
        Found::Granted { slot, fresh: Some(state.pages[slot as usize].clone()) }
    }

    /// No split of the page in this slot is applied any more. Navigator only; it has no reference to the page by then.
    pub fn stop_using(&self, slot: u32, hold: Hold) {
        let mut state = self.state.lock();
        state.in_use -= 1;
        let frame = state.frame;
        let entry = &mut state.slots[slot as usize];
        entry.in_use = false;
        let before = entry.held;
        match hold {
            Hold::End => entry.held = None,
            Hold::Keep => (),
            Hold::Renew => entry.held = Some(frame),
        }
        state.settle(slot);
        // Never so many that none is left for what is missing; where there is room for all pages, they never are.
        if hold == Hold::Renew && self.slot_count - state.kept < LEAST_FOR_URGENT - 1 {
            state.counters.starved += 1;
            state.slots[slot as usize].held = before;
            state.settle(slot);
        }
    }

    /// From now on these pages are wished, no others: each once, the strongest wish first. Leaves those that are to be read
    /// and for which there is room. Navigator only.
    pub fn renew_wishes(&self, wishes: &mut Vec<Command>) {
        let mut guard = self.state.lock();
        let state = &mut *guard;
        state.wishes = state.wishes.wrapping_add(1).max(1);
        // In the list of those that are prefetched, the weakest comes first.
        for wish in wishes.iter().rev() {
            let Some(slot) = state.find(wish.request.location.number) else { continue };
            let entry = &mut state.slots[slot as usize];
            (entry.wish, entry.wished_with) = (wish.priority, state.wishes);
            if entry.kind == Kind::Prefetched && state.policy != Policy::LeastRecentlyUsed {
                state.unlink(slot);
                state.append(slot);
            }
            state.settle(slot);
        }
        let mut slot = state.first(Kind::Prefetched);
        while slot != NONE {
            let Slot { after, kind, wished_with, .. } = state.slots[slot as usize];
            if kind == Kind::Prefetched && wished_with != state.wishes {
                state.settle(slot);
            } else if state.policy != Policy::LeastRecentlyUsed {
                break;
            }
            slot = after;
        }
        let mut room = state.lists[0].length + state.lists[1].length;
        let mut given_up = 0;
        wishes.retain(|wish| {
            let kind = state.table.get(&wish.request.location.number).map(|slot| state.slots[*slot as usize].kind);
            let takes_room = matches!(kind, None | Some(Kind::Prefetched));
            let is_to_be_read = kind.is_none() && room > 0;
            given_up += u64::from(kind.is_none() && room == 0);
            room = room.saturating_sub(usize::from(takes_room));
            is_to_be_read
        });
        state.counters.prefetch_given_up += given_up;
    }

    /// Makes room for a page that is wished so strongly, below page `parent`, `None` for a root page: in a free slot, else
    /// in that of a page that is wished less.
    pub fn prefetch(&self, page: u32, parent: Option<u32>, priority: f32) -> Room {
        let mut state = self.state.lock();
        if state.table.contains_key(&page) {
            return Room::Resident;
        }
        let parent = match state.slot_of_parent(parent) {
            Ok(parent) => parent,
            Err(room) => return room,
        };
        let is_weaker = |slot: &u32| {
            let Slot { kind, wish, .. } = state.slots[*slot as usize];
            kind == Kind::Free || wish < priority
        };
        let firsts = [Kind::Free, Kind::Prefetched].map(|kind| state.first_but(kind, parent));
        let found = if state.policy == Policy::LeastRecentlyUsed {
            state.listed(Kind::Free).filter(|slot| *slot != parent).find(is_weaker)
        } else {
            firsts.into_iter().filter(|slot| *slot != NONE).find(is_weaker)
        };
        let Some(slot) = found else {
            state.counters.prefetch_given_up += 1;
            return Room::None;
        };
        let filling = self.allocate(&mut state, slot, page, parent);
        let wishes = state.wishes;
        let entry = &mut state.slots[slot as usize];
        (entry.wish, entry.wished_with, entry.is_untried) = (priority, wishes, true);
        state.counters.prefetched += 1;
        Room::Slot(filling)
    }

    /// Makes room for a page that is wanted urgently, and holds it: in a free slot, else in that of the page that is
    /// wished least. Below page `parent`, `None` for a root page.
    pub fn make_room(&self, page: u32, parent: Option<u32>) -> Room {
        let mut state = self.state.lock();
        let frame = state.frame;
        if let Some(slot) = state.find(page) {
            state.slots[slot as usize].held = Some(frame);
            state.settle(slot);
            return Room::Resident;
        }
        if self.slot_count - state.needed < LEAST_FOR_URGENT {
            return Room::None;
        }
        let parent = match state.slot_of_parent(parent) {
            Ok(parent) => parent,
            Err(room) => return room,
        };
        let firsts = [Kind::Free, Kind::Prefetched].map(|kind| state.first_but(kind, parent));
        let Some(slot) = firsts.into_iter().find(|slot| *slot != NONE) else {
            if state.loading > 0 {
                return Room::Later;
            }
            state.counters.starved += 1;
            return Room::None;
        };
        let filling = self.allocate(&mut state, slot, page, parent);
        state.slots[slot as usize].held = Some(frame);
        state.settle(slot);
        state.counters.urgent += 1;
        Room::Slot(filling)
    }

    /// The slot was filled with its page, so many bytes in the file; or could not be. Who filled it has given up his
    /// references to the ancestors.
    pub fn loaded(&self, slot: u32, page: Arc<Page>, bytes: Option<u32>) {
        let mut state = self.state.lock();
        state.pages[slot as usize] = page;
        state.loading -= 1;
        let entry = &mut state.slots[slot as usize];
        match bytes {
            Some(bytes) => {
                entry.stage = Stage::Ready;
                state.counters.reads += 1;
                state.counters.bytes_read += u64::from(bytes);
            }
            None => {
                (entry.stage, entry.held, entry.is_untried) = (Stage::Empty, None, false);
                let page = entry.page;
                state.forget(page);
                state.counters.read_failures += 1;
            }
        }
        state.settle(slot);
    }

    /// Checks all that must hold of the pool between two operations (invariant 5); says what does not.
    pub fn check(&self) -> Result<(), String> {
        let state = self.state.lock();
        let mut listed = vec![None; self.slot_count];
        for (number, List { first, last, length }) in state.lists.into_iter().enumerate() {
            let (mut slot, mut before, mut count) = (first, NONE, 0);
            while slot != NONE {
                if listed[slot as usize].replace(number).is_some() || state.slots[slot as usize].before != before {
                    return Err(format!("list {number} is broken at slot {slot}"));
                }
                (before, slot, count) = (slot, state.slots[slot as usize].after, count + 1);
            }
            if (last, length) != (before, count) {
                return Err(format!("list {number} has {count} slots and ends at {before}, not {length} and {last}"));
            }
        }
        let (mut in_use, mut in_table, mut loading) = (0, 0, 0);
        for (slot, entry) in state.slots.iter().enumerate() {
            in_use += usize::from(entry.in_use);
            loading += usize::from(entry.stage == Stage::Loading);
            let kind = entry.kind(state.wishes);
            if kind != entry.kind || state.list_of(kind) != listed[slot] {
                return Err(format!("slot {slot}: {entry:?} in the list {:?}", listed[slot]));
            }
            if entry.in_use && entry.stage != Stage::Ready {
                return Err(format!("slot {slot} is in use, and not ready"));
            }
            if entry.is_untried && entry.in_use {
                return Err(format!("slot {slot} is in use, and was not used since it was prefetched"));
            }
            in_table += usize::from(entry.stage != Stage::Empty);
            if entry.stage != Stage::Empty && state.table.get(&entry.page) != Some(&(slot as u32)) {
                return Err(format!("slot {slot} with page {} is not in the hash table", entry.page));
            }
            let page = &state.pages[slot];
            if (entry.stage == Stage::Loading) != Arc::ptr_eq(page, &self.nothing) {
                return Err(format!("slot {slot}: {:?}, with another page than that", entry.stage));
            }
            if entry.stage == Stage::Ready && page.number() != entry.page {
                return Err(format!("slot {slot} holds another page than {}", entry.page));
            }
            let parent = state.slots.get(entry.parent as usize);
            if entry.stage != Stage::Empty && parent.is_some_and(|parent| parent.stage != Stage::Ready) {
                return Err(format!("slot {slot}: the page above its page is not there"));
            }
            if entry.stage == Stage::Ready && page.parent() != parent.map(|parent| parent.page) {
                return Err(format!("slot {slot}: its page is below {:?}, which is not above it", page.parent()));
            }
        }
        Self::check_ancestors(&state)?;
        let bits: u32 = self.is_there.iter().map(|word| word.load(Ordering::Relaxed).count_ones()).sum();
        if bits as usize != state.table.len() || !state.table.keys().all(|page| self.is_there(*page)) {
            return Err(format!("{bits} pages are noted as being there, {} are", state.table.len()));
        }
        if in_table != state.table.len() || loading != state.loading {
            return Err(format!(
                "the hash table has {} entries for {in_table} pages; {loading} are being read, {} by the count",
                state.table.len(),
                state.loading
            ));
        }
        if in_use != state.in_use || (in_use > 0 && state.needed == self.slot_count) {
            let (slots, needed) = (self.slot_count, state.needed);
            return Err(format!("{in_use} of {slots} slots are in use, {} counted, {needed} needed", state.in_use));
        }
        Ok(())
    }

    /// Checks that the pages in use, by the navigator's usage counts, are those that the pool knows of.
    pub fn check_usage(&self, usage: &[u32]) -> Result<(), String> {
        let state = self.state.lock();
        for (slot, entry) in state.slots.iter().enumerate() {
            if entry.in_use != usage.get(slot).is_some_and(|usage| *usage > 0) {
                return Err(format!("slot {slot}: {entry:?}, with the usage count {:?}", usage.get(slot)));
            }
        }
        Ok(())
    }

    /// Checks what slots know of those below them.
    fn check_ancestors(state: &State) -> Result<(), String> {
        let mut children = vec![0; state.slots.len()];
        let (mut needed, mut kept) = (vec![false; state.slots.len()], vec![false; state.slots.len()]);
        for (slot, entry) in state.slots.iter().enumerate() {
            if let Some(children) = children.get_mut(entry.parent as usize) {
                *children += 1;
            }
            for above in std::iter::once(slot as u32).chain(state.above(slot as u32)) {
                needed[above as usize] |= entry.in_use;
                kept[above as usize] |= entry.in_use || entry.held.is_some();
            }
        }
        for (slot, entry) in state.slots.iter().enumerate() {
            let found = (children[slot], needed[slot], kept[slot]);
            if found != (entry.children, entry.is_needed, entry.is_kept) {
                return Err(format!("slot {slot}: {entry:?}, with children, needed and kept: {found:?}"));
            }
        }
        let count = |flags: &[bool]| flags.iter().filter(|flag| **flag).count();
        if (count(&needed), count(&kept)) != (state.needed, state.kept) {
            return Err(format!("{} slots are needed and {} kept, by the count", state.needed, state.kept));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use metanode::chain::PageChain;
    use metanode::header::Blocking;
    use metanode::model::{Model, PageReader};
    use proptest::prelude::*;

    use super::*;
    use crate::board::Request;
    use crate::testing::{self, Random};

    /// A page, and the number of its parent.
    type Place = (PageLocation, Option<u32>);

    const POLICIES: [Policy; 3] = [Policy::SecondChance, Policy::LeastRecentlyUsed, Policy::None];

    /// Does what the I/O process does with the room it was given.
    fn fill(pool: &Pool, model: &Model, (location, _): Place, room: Room) -> Option<u32> {
        let Room::Slot(Filling { slot, mut page, ancestors }) = room else { return None };
        let above: Vec<&Page> = ancestors.iter().map(|page| &**page).collect();
        let page_to_fill = Arc::get_mut(&mut page).expect("nobody else has it");
        model.read_page(location, &above, &mut PageReader::default(), page_to_fill).unwrap();
        drop(ancestors);
        pool.loaded(slot, page, Some(location.length));
        Some(slot)
    }

    fn wish((location, parent): Place, priority: f32) -> Command {
        Command { request: Request { location, parent }, priority, is_urgent: false }
    }

    /// What is to be read when these are wished, the strongest first.
    fn renew(pool: &Pool, wishes: &[(Place, f32)]) -> Vec<u32> {
        let mut wishes: Vec<_> = wishes.iter().map(|(place, priority)| wish(*place, *priority)).collect();
        pool.renew_wishes(&mut wishes);
        wishes.iter().map(|wish| wish.request.location.number).collect()
    }

    fn prefetch(pool: &Pool, model: &Model, place: Place, priority: f32) -> Option<u32> {
        fill(pool, model, place, pool.prefetch(place.0.number, place.1, priority))
    }

    fn load_urgently(pool: &Pool, model: &Model, place: Place) -> Option<u32> {
        fill(pool, model, place, pool.make_room(place.0.number, place.1))
    }

    /// The slot of a page that comes into use.
    fn use_it(pool: &Pool, place: &Place) -> Option<u32> {
        match pool.use_page(place.0.number, &[]) {
            Found::Granted { slot, fresh } => {
                assert!(fresh.is_none_or(|page| page.number() == place.0.number));
                Some(slot)
            }
            _ => None,
        }
    }

    fn pool(model: &Model, slots: usize, policy: Policy) -> Pool {
        Pool::new((0..slots).map(|_| model.empty_page()).collect(), model.header().page_count as usize, 0, policy)
    }

    /// A model with several levels of pages, and all of its pages, parents first.
    fn all_pages() -> (Arc<Model>, Vec<Place>) {
        let tree = testing::grid_tree(12, 12, 1);
        let disk = testing::disk_of(&tree, Blocking::Levels { levels: 4 });
        let model = Arc::new(Model::open(&disk, "model.vdt".as_ref()).unwrap());
        let mut chain = PageChain::new(&model);
        let mut stack: Vec<Place> = model.root_pages().iter().map(|page| (*page, None)).collect();
        let mut places = Vec::new();
        while let Some((location, parent)) = stack.pop() {
            places.push((location, parent));
            stack.extend(chain.page(location, parent).unwrap().children().map(|child| (child, Some(location.number))));
        }
        drop(chain);
        (model, places)
    }

    /// The root page of that model, and its children.
    fn pages() -> (Arc<Model>, Place, Vec<Place>) {
        let (model, places) = all_pages();
        let children = places.iter().copied().filter(|(_, parent)| *parent == Some(places[0].0.number)).collect();
        (model, places[0], children)
    }

    #[test]
    fn a_flushed_page_gets_a_second_chance_until_its_slot_is_needed() {
        let (model, root, pages) = pages();
        for policy in POLICIES {
            let pool = pool(&model, 4, policy);
            let all = [(pages[0], 4.0), (pages[1], 3.0), (pages[2], 2.0)];
            renew(&pool, &all);
            load_urgently(&pool, &model, root).unwrap();
            for (page, priority) in all {
                prefetch(&pool, &model, page, priority).unwrap();
            }
            // Wished less than all of them.
            assert_eq!(prefetch(&pool, &model, pages[3], 1.0), None);
            assert_eq!(pool.counters().prefetch_given_up, 1);
            // Flushed in this order: 1, 0. So 1 makes room first, and 0 is still there.
            renew(&pool, &[(pages[0], 4.0), (pages[2], 2.0)]);
            renew(&pool, &[(pages[2], 2.0)]);
            pool.check().unwrap();
            if policy == Policy::LeastRecentlyUsed {
                // Loaded before the others.
                let slot = prefetch(&pool, &model, pages[3], 1.0).unwrap();
                assert_eq!(pool.state.lock().slots[slot as usize].page, pages[3].0.number);
                assert!(!pool.state.lock().table.contains_key(&pages[0].0.number));
                continue;
            }
            prefetch(&pool, &model, pages[3], 1.0).unwrap();
            pool.check().unwrap();
            let second_chance = policy == Policy::SecondChance;
            let to_be_read = renew(&pool, &[(pages[0], 4.0), (pages[2], 2.0), (pages[3], 1.0)]);
            assert_eq!(to_be_read.is_empty(), second_chance);
            assert_eq!(pool.counters().second_chances, u64::from(second_chance));
            assert_eq!(pool.counters().reads, 5);
            assert_eq!(pool.counters().evicted, u64::from(second_chance));
            assert_eq!(pool.counters().evicted_untried, 1 + u64::from(!second_chance));
            if second_chance {
                pool.check().unwrap();
                assert_eq!(prefetch(&pool, &model, pages[1], 1.0), None);
            }
        }
    }

    /// What is wished less gives way to what is wished more, and never the other way round.
    #[test]
    fn the_stronger_wish_wins() {
        let (model, root, pages) = pages();
        for policy in [Policy::SecondChance, Policy::LeastRecentlyUsed] {
            let pool = pool(&model, 4, policy);
            load_urgently(&pool, &model, root).unwrap();
            // There is room for three of them.
            let wishes = [(pages[0], 9.0), (pages[1], 5.0), (pages[2], 2.0), (pages[3], 1.0)];
            let to_be_read = renew(&pool, &wishes);
            assert_eq!(to_be_read, [0, 1, 2].map(|page: usize| pages[page].0.number));
            assert_eq!(pool.counters().prefetch_given_up, 1);
            for (page, priority) in wishes.into_iter().rev() {
                // The weakest comes first, and goes first.
                prefetch(&pool, &model, page, priority).unwrap();
                pool.check().unwrap();
            }
            assert!(renew(&pool, &wishes[..3]).is_empty());
            assert_eq!((pool.counters().evicted_wished, pool.counters().prefetched), (1, 4));
            assert_eq!(prefetch(&pool, &model, pages[3], 1.5), None);
            // What is urgent takes the weakest, too.
            let slot = load_urgently(&pool, &model, pages[4]).unwrap();
            assert_eq!(pool.counters().evicted_wished, 2);
            assert!(!pool.state.lock().table.contains_key(&pages[2].0.number), "{slot}");
            // What comes into use was not prefetched in vain.
            use_it(&pool, &pages[0]).unwrap();
            assert_eq!(pool.counters().prefetch_used, 1);
            pool.check().unwrap();
        }
    }

    /// With LRU what went out of use last stays longest, whether it is wished or not; else what is wished does.
    #[test]
    fn the_least_recently_used_page_makes_room() {
        let (model, root, pages) = pages();
        for (policy, victim) in [(Policy::LeastRecentlyUsed, 0), (Policy::SecondChance, 1)] {
            let pool = pool(&model, 5, policy);
            load_urgently(&pool, &model, root).unwrap();
            renew(&pool, &[(pages[0], 5.0)]);
            prefetch(&pool, &model, pages[0], 5.0).unwrap();
            let slots = [1, 2].map(|page: usize| {
                load_urgently(&pool, &model, pages[page]).unwrap();
                use_it(&pool, &pages[page]).unwrap()
            });
            slots.into_iter().for_each(|slot| pool.stop_using(slot, Hold::End));
            load_urgently(&pool, &model, pages[3]).unwrap();
            load_urgently(&pool, &model, pages[4]).unwrap();
            let state = pool.state.lock();
            for page in 0..3 {
                assert_eq!(state.table.contains_key(&pages[page].0.number), page != victim, "{policy:?}, page {page}");
            }
        }
    }

    #[test]
    fn the_pool_is_never_all_in_use() {
        let (model, root, pages) = pages();
        let pool = pool(&model, 5, Policy::SecondChance);
        let found = |page: &Place| pool.use_page(page.0.number, &[]);
        load_urgently(&pool, &model, root).unwrap();
        pool.end_all_holds();
        let wishes: Vec<_> = pages[..4].iter().map(|page| (*page, 1.0)).collect();
        renew(&pool, &wishes);
        for page in &pages[..4] {
            prefetch(&pool, &model, *page, 1.0).unwrap();
        }
        // Urgently, while three are not needed: in the place of one that is only prefetched.
        let first = use_it(&pool, &pages[0]).unwrap();
        assert_eq!((pool.in_use(), pool.needed()), (1, 2));
        load_urgently(&pool, &model, pages[4]).unwrap();
        assert!(matches!(found(&pages[1]), Found::Missing));
        assert_eq!(pool.counters().urgent, 2);
        pool.check().unwrap();
        let second = use_it(&pool, &pages[4]).unwrap();
        assert_eq!(load_urgently(&pool, &model, pages[1]), None);
        assert!(matches!(found(&pages[1]), Found::Refused));
        // A page that is there, while two are not needed.
        let third = use_it(&pool, &pages[2]).unwrap();
        assert!(matches!(found(&pages[3]), Found::Refused));
        assert_eq!((pool.in_use(), pool.needed()), (3, 4));
        // One that is in use already always goes, and one that is above those in use.
        assert!(matches!(found(&pages[2]), Found::Granted { slot, fresh: None } if slot == third));
        let top = use_it(&pool, &root).unwrap();
        pool.check().unwrap();
        [top, third, first, second].into_iter().for_each(|slot| pool.stop_using(slot, Hold::End));
        assert_eq!((pool.in_use(), pool.needed()), (0, 0));
        // A page that nobody comes to use is let go after a while.
        renew(&pool, &[]);
        let held = load_urgently(&pool, &model, pages[1]).unwrap();
        for _ in 0..=HOLD_FRAMES {
            assert_eq!(pool.state.lock().slots[held as usize].kind, Kind::Held);
            pool.begin_frame();
        }
        assert_eq!(pool.state.lock().slots[held as usize].kind, Kind::Free);
        pool.check().unwrap();
    }

    #[test]
    fn a_page_that_cannot_be_read_leaves_its_slot_free() {
        let (model, root, pages) = pages();
        let pool = pool(&model, 3, Policy::SecondChance);
        load_urgently(&pool, &model, root).unwrap();
        pool.end_all_holds();
        let Room::Slot(Filling { slot, page, ancestors }) = pool.prefetch(pages[0].0.number, pages[0].1, 1.0) else {
            panic!("there is room")
        };
        // Meanwhile it is wanted urgently.
        assert!(matches!(pool.use_page(pages[0].0.number, &[]), Found::Coming));
        drop(ancestors);
        pool.loaded(slot, page, None);
        pool.check().unwrap();
        assert_eq!((pool.counters().reads, pool.counters().read_failures), (1, 1));
        assert!(prefetch(&pool, &model, pages[1], 1.0).is_some());
        pool.check().unwrap();
    }

    #[test]
    fn ancestors_come_first_and_go_last() {
        let (model, places) = all_pages();
        let below = |parent: &Place| *places.iter().find(|(_, above)| *above == Some(parent.0.number)).unwrap();
        let top = places[0];
        let middle = places.iter().copied().find(|place| {
            place.1 == Some(top.0.number) && places.iter().any(|(_, above)| *above == Some(place.0.number))
        });
        let middle = middle.unwrap();
        let bottom = below(&middle);
        for policy in POLICIES {
            let pool = pool(&model, 5, policy);
            // Not without its parent.
            assert_eq!(load_urgently(&pool, &model, bottom), None);
            assert_eq!(prefetch(&pool, &model, middle, 1.0), None);
            // Nor before it is there.
            let Room::Slot(filling) = pool.make_room(top.0.number, None) else { panic!("there is room") };
            assert!(matches!(pool.make_room(middle.0.number, middle.1), Room::Later));
            assert!(matches!(pool.prefetch(middle.0.number, middle.1, 1.0), Room::Later));
            assert!(matches!(pool.make_room(top.0.number, None), Room::Resident));
            assert!(matches!(pool.use_page(top.0.number, &[]), Found::Coming));
            pool.check().unwrap();
            let mut slots = vec![fill(&pool, &model, top, Room::Slot(filling)).unwrap()];
            slots.extend([middle, bottom].map(|place| load_urgently(&pool, &model, place).unwrap()));
            assert_eq!(
                pool.ancestors(slots[2]).iter().map(|page| page.number()).collect::<Vec<_>>(),
                [top.0.number, middle.0.number]
            );
            // The root of a tree that begins at the bottom needs all three, so that one of five would be left for more.
            let found = |page: &Place| pool.use_page(page.0.number, &[top.0, middle.0]);
            assert!(matches!(found(&bottom), Found::Granted { slot, .. } if slot == slots[2]));
            assert_eq!((pool.in_use(), pool.needed()), (1, 3));
            let mut others = places.iter().filter(|(_, above)| *above == Some(top.0.number));
            let other = others.find(|place| place.0 != middle.0).unwrap();
            assert!(matches!(pool.use_page(other.0.number, &[]), Found::Refused));
            pool.stop_using(slots[2], Hold::End);
            pool.end_all_holds();
            pool.check().unwrap();
            let kinds = |pool: &Pool| [0, 1, 2].map(|page: usize| pool.state.lock().slots[slots[page] as usize].kind);
            if policy == Policy::None {
                // With the last page below it, each goes.
                assert!(pool.state.lock().table.is_empty());
                continue;
            }
            assert_eq!(kinds(&pool), [Kind::Above, Kind::Above, Kind::Free]);
            // Two slots are empty; then the page at the bottom makes room, then the one above it.
            let siblings = places.iter().copied().filter(|(_, above)| *above == Some(top.0.number));
            for (number, sibling) in siblings.filter(|place| place.0 != middle.0).take(4).enumerate() {
                let slot = prefetch(&pool, &model, sibling, 1.0).unwrap();
                assert_eq!([slots[2], slots[1]].iter().position(|other| *other == slot), number.checked_sub(2));
                pool.check().unwrap();
            }
            assert_eq!(kinds(&pool)[0], Kind::Above);
            // None is left but that of the parent itself.
            assert_eq!(prefetch(&pool, &model, middle, 1.0), None);
        }
    }

    /// The root of a tree asks for more: the pages of the way to it that nobody needs.
    #[test]
    fn a_way_that_is_not_needed_counts() {
        let (model, places) = all_pages();
        let top = places[0];
        let middle = places.iter().copied().find(|(_, above)| *above == Some(top.0.number)).unwrap();
        let asked =
            |slots: usize| pool(&model, slots, Policy::SecondChance).use_page(places[2].0.number, &[top.0, middle.0]);
        assert!(matches!(asked(4), Found::Refused) && matches!(asked(5), Found::Missing));
        let pool = pool(&model, 3, Policy::SecondChance);
        let slots = [top, middle].map(|place| load_urgently(&pool, &model, place).unwrap());
        // Its own page and the one above: one of three is left.
        assert!(matches!(pool.use_page(middle.0.number, &[top.0]), Found::Granted { slot, .. } if slot == slots[1]));
        pool.check().unwrap();
    }

    #[test]
    fn what_is_reserved_keeps_no_page_out() {
        let (model, _) = all_pages();
        let header = |page_count, page_levels| Header { page_count, page_levels, ..*model.header() };
        assert_eq!(reserved_slots(800, &header(10_000, 9)), 100);
        // Nearly all pages have a slot; all have.
        assert_eq!(reserved_slots(800, &header(830, 9)), 32);
        assert_eq!(reserved_slots(802, &header(800, 9)), LEAST_FOR_SPLIT);
        // A page on the last of many levels, in the fewest slots.
        assert_eq!(reserved_slots(62, &header(10_000, 60)), LEAST_FOR_SPLIT);
        assert_eq!(reserved_slots(64, &header(10_000, 60)), 4);
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

        /// Whatever happens, in any order: what slots know of each other is what the slow check finds.
        #[test]
        fn the_counts_are_right_after_anything(seed in any::<u64>(), slots in 3..24_usize, policy in 0..3_usize) {
            let (model, places) = all_pages();
            let pool = pool(&model, slots, POLICIES[policy]);
            let mut random = Random(seed);
            let mut used: Vec<u32> = Vec::new();
            let mut fillings: Vec<(Place, Filling)> = Vec::new();
            for _ in 0..300 {
                let place = places[random.below(places.len().min(3 * slots))];
                let (number, parent) = (place.0.number, place.1);
                let priority = random.unit();
                match random.below(10) {
                    0 => {
                        pool.begin_frame();
                    }
                    1 => {
                        let mut wishes: Vec<_> =
                            places.iter().take(3 * slots).map(|place| (*place, random.unit())).collect();
                        wishes.retain(|_| random.below(3) == 0);
                        wishes.sort_by(|one, other| other.1.total_cmp(&one.1));
                        renew(&pool, &wishes);
                    }
                    2 | 3 => drop(prefetch(&pool, &model, place, priority)),
                    4 | 5 => drop(load_urgently(&pool, &model, place)),
                    6 => {
                        let urgently = random.below(2) == 0;
                        let room =
                            if urgently { pool.make_room(number, parent) } else { pool.prefetch(number, parent, priority) };
                        if let Room::Slot(filling) = room {
                            fillings.push((place, filling));
                        }
                    }
                    7 if !fillings.is_empty() => {
                        let (place, filling) = fillings.swap_remove(random.below(fillings.len()));
                        if random.below(3) == 0 {
                            pool.loaded(filling.slot, filling.page, None);
                        } else {
                            fill(&pool, &model, place, Room::Slot(filling));
                        }
                    }
                    7 | 8 => {
                        if let Found::Granted { slot, fresh: Some(_) } = pool.use_page(number, &[]) {
                            used.push(slot);
                        }
                    }
                    _ if used.is_empty() => (),
                    _ => {
                        let slot = used.swap_remove(random.below(used.len()));
                        pool.stop_using(slot, [Hold::End, Hold::Keep, Hold::Renew][random.below(3)]);
                    }
                }
                prop_assert!(pool.check().is_ok(), "{:?}", pool.check());
            }
        }
    }
}
