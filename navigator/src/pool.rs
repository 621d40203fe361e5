//! The pool of place holders (the paper, 3.3.3): a fixed number of slots, allocated once, each with room for any page.
//!
//! A page in a slot is in the *physical main memory*: the hash table leads to it. Each slot has two counts: the *usage
//! count*, how many splits of its page are applied, and the *reference count*, how many pages in use have it prefetched
//! as their parent or child; and for [`HOLD_FRAMES`] frames it may be *held*, for a node that asked for it urgently and
//! has not used it yet, or had to let go of it because another page is missing. Then it gives way to nobody: else
//! urgent pages would push each other out for nothing. A slot with both counts zero, not held and without child pages is
//! in the *free list*, and is given to the next page that needs one. Its page stays in the hash table until then: when it
//! is asked for again before, it gets a *second chance*, and is taken out of the free list without a disk read. Freed
//! slots go to the end of the list, slots to be filled come from its front.
//!
//! # Ancestors before descendants
//!
//! A page is decoded with all its ancestors at hand, from a root page down to its parent. So a page is only loaded below
//! a parent that is there, and a slot counts the child pages that are there or being read: while there are any it is in
//! no list from which slots are given out, whatever its other counts. Leaves of the page tree go first; with its last
//! child gone, a page is what its other counts make of it. So the ancestors of a page that is there are always there.
//!
//! Only the navigator changes usage counts. A change from or to zero is made under the pool's lock, as is every look at
//! the hash table, the lists and the other counts; a change of a count that stays above zero needs no lock. No lock is
//! held during a disk read. Those of a page and its ancestors are held while it is decoded, the ancestors' shared with
//! whoever reads them, and nobody else looks at the page itself.
//!
//! # Never all in use
//!
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
//! So a page on level l of the page tree can be used, whatever else was let go, with l + 2 slots: its l - 1 ancestors and
//! the three that it asks for.

use std::sync::atomic::{AtomicU32, Ordering};

use hashbrown::HashMap;
use metanode::page::{Page, PageLocation};
use parking_lot::{Mutex, RwLock, RwLockReadGuard, RwLockWriteGuard};

use crate::front::NONE;

/// Slots that must not be needed for a split that needs one more page.
pub const LEAST_FOR_SPLIT: usize = 2;
/// Slots that must not be needed for a page to be loaded urgently whose ancestors are.
pub const LEAST_FOR_URGENT: usize = 3;

/// How many frames a page that was loaded urgently waits for its use.
pub const HOLD_FRAMES: u32 = 4;

/// Bytes that a slot takes beside its page: counts, its entry in the hash table (at the worst filling), the navigator's
/// note of its page, and the board's.
pub const SLOT_OVERHEAD_BYTES: usize =
    size_of::<RwLock<Page>>() + size_of::<AtomicU32>() + size_of::<Slot>() + 9 * 16 / 7 + 2 * size_of::<u32>() + 1;

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

/// What a slot is at the moment; the first three are in a list each. Those of the first two may be given to other pages.
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

impl Kind {
    /// The list that such a slot is in.
    fn list(self) -> Option<usize> {
        match self {
            Kind::Free => Some(0),
            Kind::Prefetched => Some(1),
            Kind::Held => Some(2),
            Kind::Above | Kind::Used | Kind::Loading => None,
        }
    }
}

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
    references: u32,
    /// The frame in which the page was held for a node that is to use it.
    held: Option<u32>,
    /// Whether the page in it has been counted in the references of its parent and children.
    refers: bool,
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
        references: 0,
        held: None,
        refers: false,
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

    fn is_needed(&self, usage: u32) -> bool {
        usage > 0 || self.needed_children > 0
    }

    fn is_kept(&self, usage: u32) -> bool {
        self.is_needed(usage) || self.held.is_some() || self.kept_children > 0
    }

    fn kind(&self, usage: u32) -> Kind {
        if self.stage == Stage::Loading {
            Kind::Loading
        } else if usage > 0 {
            Kind::Used
        } else if self.held.is_some() {
            Kind::Held
        } else if self.children > 0 {
            Kind::Above
        } else if self.references > 0 {
            Kind::Prefetched
        } else {
            Kind::Free
        }
    }
}

/// What happened in a pool, since it was made.
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
    /// Prefetches given up because there was no free slot.
    pub prefetch_given_up: u64,
    /// Urgent pages that found no room, because what is not needed is held for others; and pages that could not be
    /// held.
    pub starved: u64,
}

#[derive(Debug)]
struct State {
    table: HashMap<u32, u32>,
    slots: Vec<Slot>,
    lists: [List; LISTS],
    in_use: usize,
    needed: usize,
    kept: usize,
    /// Counts the frames.
    frame: u32,
    counters: PoolCounters,
}

/// What became of a wish to use a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    /// It is in this slot, and its usage count is one more.
    Granted {
        /// The slot.
        slot: u32,
    },
    /// It is not there, and may be asked for.
    Missing,
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

/// What became of a wish to have a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Room {
    /// It is there.
    Resident,
    /// It is to be read into this slot, and then [`Pool::loaded`] to be called.
    Slot {
        /// The slot.
        slot: u32,
        /// Whether the page that is still in it counts in the references of its parent and children, and is to be
        /// taken out of them first.
        refers: bool,
    },
    /// There is no room for it, or its parent is not there.
    None,
}

/// The place holders, with all that is known about them.
#[derive(Debug)]
pub struct Pool {
    pages: Vec<RwLock<Page>>,
    usage: Vec<AtomicU32>,
    state: Mutex<State>,
    second_chance: bool,
}

impl State {
    fn list(&self, kind: Kind) -> List {
        kind.list().map_or(List { first: NONE, last: NONE, length: 0 }, |list| self.lists[list])
    }

    /// Takes a slot out of the list that it is in, if any.
    fn unlink(&mut self, slot: u32) {
        let Slot { kind, before, after, .. } = self.slots[slot as usize];
        let Some(list) = kind.list() else { return };
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
        let Some(list) = self.slots[slot as usize].kind.list() else { return };
        let before = std::mem::replace(&mut self.lists[list].last, slot);
        match before {
            NONE => self.lists[list].first = slot,
            before => self.slots[before as usize].after = slot,
        }
        self.lists[list].length += 1;
        let entry = &mut self.slots[slot as usize];
        (entry.before, entry.after) = (before, NONE);
    }

    /// The slot with this page. One in the free list gets its second chance: the caller takes it out of there.
    fn find(&mut self, page: u32) -> Option<u32> {
        let slot = *self.table.get(&page)?;
        self.counters.second_chances += u64::from(self.slots[slot as usize].kind == Kind::Free);
        Some(slot)
    }

    /// The slot that `page` can have, of those whose pages are of this kind: the one that has been so for the longest
    /// time, but not that of its own parent. [`NONE`] where there is none.
    fn first_but(&self, kind: Kind, parent: u32) -> u32 {
        let first = self.list(kind).first;
        if first != NONE && first == parent { self.slots[first as usize].after } else { first }
    }

    /// The slot of a parent page, [`NONE`] for that of a root page, which has none; `None` where it is not there.
    fn slot_of_parent(&self, parent: Option<u32>) -> Option<u32> {
        let Some(parent) = parent else { return Some(NONE) };
        self.table.get(&parent).copied().filter(|slot| self.slots[*slot as usize].stage == Stage::Ready)
    }

    /// The slots above one, from that of its parent up.
    fn above(&self, slot: u32) -> impl Iterator<Item = u32> + '_ {
        let parent = |slot: u32| Some(self.slots[slot as usize].parent).filter(|parent| *parent != NONE);
        std::iter::successors(parent(slot), move |slot| parent(*slot))
    }
}

/// How many splits of a page are applied when its children are near enough to be prefetched: nine of ten, see `io_process`.
pub fn splits_to_refer(page: &Page) -> u32 {
    (page.counts().records as u32 * 9 / 10).max(1)
}

impl Pool {
    /// A pool of the given pages, which are empty and all of one size.
    pub fn new(pages: Vec<Page>, second_chance: bool) -> Self {
        let count = pages.len();
        let mut state = State {
            table: HashMap::with_capacity(count),
            slots: vec![Slot::EMPTY; count],
            lists: [List { first: NONE, last: NONE, length: 0 }; LISTS],
            in_use: 0,
            needed: 0,
            kept: 0,
            frame: 0,
            counters: PoolCounters::default(),
        };
        (0..count as u32).for_each(|slot| state.append(slot));
        Pool {
            pages: pages.into_iter().map(RwLock::new).collect(),
            usage: (0..count).map(|_| AtomicU32::new(0)).collect(),
            state: Mutex::new(state),
            second_chance,
        }
    }

    /// Puts a slot into the list that it belongs to after a change; one that was held, or that nobody needs any more, to
    /// its end. Then the same for those above it, as far as it changes anything for them.
    fn settle(&self, state: &mut State, slot: u32) {
        let mut slot = slot;
        while slot != NONE {
            slot = self.settle_one(state, slot);
        }
    }

    /// Settles one slot. Returns that of the parent, where something changed for it.
    fn settle_one(&self, state: &mut State, slot: u32) -> u32 {
        let usage = self.usage(slot);
        let before = state.slots[slot as usize];
        let (kind, is_needed, is_kept) = (before.kind(usage), before.is_needed(usage), before.is_kept(usage));
        let is_flushed = kind == Kind::Free && before.stage == Stage::Ready && !self.second_chance;
        if is_flushed {
            state.table.remove(&before.page);
        }
        if kind != before.kind || (kind == Kind::Held && before.held == Some(state.frame)) {
            state.unlink(slot);
            state.slots[slot as usize].kind = kind;
            state.append(slot);
        }
        let entry = &mut state.slots[slot as usize];
        (entry.is_needed, entry.is_kept) = (is_needed, is_kept);
        let is_gone = is_flushed || before.stage == Stage::Empty;
        if is_gone {
            (entry.stage, entry.parent) = (Stage::Empty, NONE);
        }
        state.needed = state.needed + usize::from(is_needed) - usize::from(before.is_needed);
        state.kept = state.kept + usize::from(is_kept) - usize::from(before.is_kept);
        let Some(parent) = state.slots.get_mut(before.parent as usize) else { return NONE };
        parent.children -= u32::from(is_gone);
        parent.needed_children = parent.needed_children + u32::from(is_needed) - u32::from(before.is_needed);
        parent.kept_children = parent.kept_children + u32::from(is_kept) - u32::from(before.is_kept);
        let changed = is_gone || is_needed != before.is_needed || is_kept != before.is_kept;
        if changed { before.parent } else { NONE }
    }

    /// Gives the slot, whose page is not kept and has no children, to `page`, whose parent is in the slot `parent`.
    fn allocate(&self, state: &mut State, slot: u32, page: u32, parent: u32) -> Room {
        state.unlink(slot);
        let previous = state.slots[slot as usize];
        if previous.stage != Stage::Empty {
            state.table.remove(&previous.page);
        }
        state.table.insert(page, slot);
        state.slots[slot as usize] = Slot { page, stage: Stage::Loading, parent, kind: Kind::Loading, ..Slot::EMPTY };
        if let Some(parent) = state.slots.get_mut(parent as usize) {
            parent.children += 1;
        }
        if let Some(parent) = state.slots.get_mut(previous.parent as usize) {
            parent.children -= 1;
        }
        [parent, previous.parent].into_iter().for_each(|parent| self.settle(state, parent));
        Room::Slot { slot, refers: previous.refers }
    }

    /// A frame begins: what was held long enough is let go. Navigator only.
    pub fn begin_frame(&self) {
        let mut state = self.state.lock();
        state.frame = state.frame.wrapping_add(1);
        self.end_holds(&mut state, HOLD_FRAMES);
    }

    /// Lets go of all that is held: for who loads pages one at a time, and uses each at once.
    pub fn end_all_holds(&self) {
        let mut state = self.state.lock();
        state.frame = state.frame.wrapping_add(1);
        self.end_holds(&mut state, 0);
    }

    /// Lets go of what has been held for more than so many frames.
    fn end_holds(&self, state: &mut State, frames: u32) {
        loop {
            let slot = state.list(Kind::Held).first;
            let Some(entry) = state.slots.get_mut(slot as usize) else { return };
            if entry.held.is_some_and(|since| state.frame.wrapping_sub(since) <= frames) {
                return;
            }
            entry.held = None;
            self.settle(state, slot);
        }
    }

    /// Number of slots.
    pub fn slot_count(&self) -> usize {
        self.pages.len()
    }

    /// Slots whose page is in use.
    pub fn in_use(&self) -> usize {
        self.state.lock().in_use
    }

    /// Slots whose page is in use or above one that is.
    pub fn needed(&self) -> usize {
        self.state.lock().needed
    }

    /// What happened so far.
    pub fn counters(&self) -> PoolCounters {
        self.state.lock().counters
    }

    /// The page in a slot; for who knows that it is in use.
    pub fn page(&self, slot: u32) -> RwLockReadGuard<'_, Page> {
        self.pages[slot as usize].read()
    }

    /// Usage count of a slot.
    pub fn usage(&self, slot: u32) -> u32 {
        self.usage[slot as usize].load(Ordering::Relaxed)
    }

    /// One more split of the page in this slot, which is in use, is applied. Navigator only.
    pub fn use_again(&self, slot: u32) {
        self.usage[slot as usize].fetch_add(1, Ordering::Relaxed);
    }

    /// The ancestors of the page in a slot, from the root page down to its parent; for who knows that the page is there,
    /// or being read.
    pub fn ancestors(&self, slot: u32) -> Vec<RwLockReadGuard<'_, Page>> {
        let mut above: Vec<u32> = self.state.lock().above(slot).collect();
        above.reverse();
        above.into_iter().map(|slot| self.page(slot)).collect()
    }

    /// A first or further split of this page is to be applied. `way` are those of its ancestors that need not be there:
    /// all of them for the root of a tree, else none. Navigator only.
    pub fn use_page(&self, page: u32, way: &[PageLocation]) -> Use {
        let mut state = self.state.lock();
        let not_needed = self.pages.len() - state.needed;
        let ready = state.table.get(&page).filter(|slot| state.slots[**slot as usize].stage == Stage::Ready);
        let Some(slot) = ready.copied() else {
            let is_needed = |page: &&PageLocation| {
                state.table.get(&page.number).is_some_and(|slot| state.slots[*slot as usize].is_needed)
            };
            let more = way.len() - way.iter().filter(is_needed).count();
            return if not_needed < LEAST_FOR_URGENT + more { Use::Refused } else { Use::Missing };
        };
        if self.usage(slot) == 0 {
            let pages = std::iter::once(slot).chain(state.above(slot));
            let more = pages.filter(|slot| !state.slots[*slot as usize].is_needed).count();
            if not_needed + 1 < LEAST_FOR_SPLIT + more {
                return Use::Refused;
            }
            state.find(page);
            state.in_use += 1;
            self.use_again(slot);
            self.settle(&mut state, slot);
        } else {
            self.use_again(slot);
        }
        Use::Granted { slot }
    }

    /// A split of the page in this slot is not applied any more, or was not after all; true when it was the last.
    /// Navigator only.
    pub fn stop_using(&self, slot: u32, hold: Hold) -> bool {
        let usage = &self.usage[slot as usize];
        if usage.load(Ordering::Relaxed) > 1 {
            usage.fetch_sub(1, Ordering::Relaxed);
            return false;
        }
        let mut state = self.state.lock();
        usage.store(0, Ordering::Relaxed);
        state.in_use -= 1;
        let frame = state.frame;
        let entry = &mut state.slots[slot as usize];
        let before = entry.held;
        match hold {
            Hold::End => entry.held = None,
            Hold::Keep => (),
            Hold::Renew => entry.held = Some(frame),
        }
        self.settle(&mut state, slot);
        // Never so many that none is left for what is missing; where there is room for all pages, they never are.
        if hold == Hold::Renew && self.pages.len() - state.kept < LEAST_FOR_URGENT - 1 {
            state.counters.starved += 1;
            state.slots[slot as usize].held = before;
            self.settle(&mut state, slot);
        }
        true
    }

    /// Makes room for a page that a page in use refers to, and counts the reference; below page `parent`, `None` for a
    /// root page.
    pub fn reference(&self, page: u32, parent: Option<u32>) -> Room {
        let mut state = self.state.lock();
        if let Some(slot) = state.find(page) {
            state.slots[slot as usize].references += 1;
            self.settle(&mut state, slot);
            return Room::Resident;
        }
        let Some(parent) = state.slot_of_parent(parent) else { return Room::None };
        match state.first_but(Kind::Free, parent) {
            NONE => {
                state.counters.prefetch_given_up += 1;
                Room::None
            }
            slot => {
                let room = self.allocate(&mut state, slot, page, parent);
                state.slots[slot as usize].references = 1;
                room
            }
        }
    }

    /// Counts a reference to a page, if it is there.
    pub fn reference_if_resident(&self, page: u32) {
        let mut state = self.state.lock();
        if let Some(slot) = state.find(page) {
            state.slots[slot as usize].references += 1;
            self.settle(&mut state, slot);
        }
    }

    /// Takes a reference, and the hold of who never came to use it, from a page; no effect where it is not there.
    pub fn dereference(&self, page: u32) {
        let mut state = self.state.lock();
        if let Some(slot) = state.table.get(&page).copied() {
            let entry = &mut state.slots[slot as usize];
            entry.references = entry.references.saturating_sub(1);
            entry.held = None;
            self.settle(&mut state, slot);
        }
    }

    /// Makes room for a page that is wanted urgently, and holds it: in a free slot, else in the first found whose page
    /// is prefetched but not in use, which is the one that has been so for the longest time. Below page `parent`, `None`
    /// for a root page.
    pub fn make_room(&self, page: u32, parent: Option<u32>) -> Room {
        let mut state = self.state.lock();
        let frame = state.frame;
        if let Some(slot) = state.find(page) {
            state.slots[slot as usize].held = Some(frame);
            self.settle(&mut state, slot);
            return Room::Resident;
        }
        if self.pages.len() - state.needed < LEAST_FOR_URGENT {
            return Room::None;
        }
        let Some(parent) = state.slot_of_parent(parent) else { return Room::None };
        let firsts = [Kind::Free, Kind::Prefetched].map(|kind| state.first_but(kind, parent));
        let Some(slot) = firsts.into_iter().find(|slot| *slot != NONE) else {
            state.counters.starved += 1;
            return Room::None;
        };
        let room = self.allocate(&mut state, slot, page, parent);
        state.slots[slot as usize].held = Some(frame);
        self.settle(&mut state, slot);
        state.counters.urgent += 1;
        room
    }

    /// The page of a slot that was given out to be filled.
    pub fn page_to_fill(&self, slot: u32) -> RwLockWriteGuard<'_, Page> {
        self.pages[slot as usize].write()
    }

    /// The page of the slot was read: so many bytes; or could not be read.
    pub fn loaded(&self, slot: u32, bytes: Option<u32>) {
        let mut state = self.state.lock();
        let entry = &mut state.slots[slot as usize];
        match bytes {
            Some(bytes) => {
                entry.stage = Stage::Ready;
                state.counters.reads += 1;
                state.counters.bytes_read += u64::from(bytes);
            }
            None => {
                (entry.stage, entry.references, entry.held) = (Stage::Empty, 0, None);
                let page = entry.page;
                state.table.remove(&page);
            }
        }
        self.settle(&mut state, slot);
    }

    /// Whether the page in the slot is to be counted in the references of its parent and children from now on, or not
    /// any more, where that changes. It is to be from when [`splits_to_refer`] of its splits are applied until none is; `always`
    /// counts it even so (the root pages, at the start).
    pub fn update_references(&self, slot: u32, always: bool) -> Option<bool> {
        let least = splits_to_refer(&self.page(slot));
        let mut state = self.state.lock();
        let usage = self.usage(slot);
        let entry = &mut state.slots[slot as usize];
        let refers = usage >= if entry.refers { 1 } else { least } || always;
        let change = (entry.refers != refers).then_some(refers);
        entry.refers = refers;
        change
    }

    /// Checks all that must hold of the pool between two operations (invariant 5); says what does not.
    pub fn check(&self) -> Result<(), String> {
        let state = self.state.lock();
        let mut listed = vec![None; self.pages.len()];
        for kind in [Kind::Free, Kind::Prefetched, Kind::Held] {
            let List { first, last, length } = state.list(kind);
            let (mut slot, mut before, mut count) = (first, NONE, 0);
            while slot != NONE {
                if listed[slot as usize].replace(kind).is_some() || state.slots[slot as usize].before != before {
                    return Err(format!("the {kind:?} list is broken at slot {slot}"));
                }
                (before, slot, count) = (slot, state.slots[slot as usize].after, count + 1);
            }
            if (last, length) != (before, count) {
                return Err(format!(
                    "the {kind:?} list has {count} slots and ends at {before}, not {length} and {last}"
                ));
            }
        }
        let (mut in_use, mut in_table) = (0, 0);
        for (slot, entry) in state.slots.iter().enumerate() {
            let usage = self.usage(slot as u32);
            in_use += usize::from(usage > 0);
            let kind = entry.kind(usage);
            if kind != entry.kind || kind.list().map(|_| kind) != listed[slot] {
                return Err(format!("slot {slot}: {entry:?}, used {usage} times, in the list {:?}", listed[slot]));
            }
            if usage > 0 && entry.stage != Stage::Ready {
                return Err(format!("slot {slot} is in use, and not ready"));
            }
            in_table += usize::from(entry.stage != Stage::Empty);
            if entry.stage != Stage::Empty && state.table.get(&entry.page) != Some(&(slot as u32)) {
                return Err(format!("slot {slot} with page {} is not in the hash table", entry.page));
            }
            if entry.stage == Stage::Ready {
                let page = self.page(slot as u32);
                if page.number() != entry.page {
                    return Err(format!("slot {slot} holds another page than {}", entry.page));
                }
                let parent = state.slots.get(entry.parent as usize);
                if page.parent() != parent.map(|parent| parent.page)
                    || parent.is_some_and(|parent| parent.stage != Stage::Ready)
                {
                    return Err(format!("slot {slot}: its page is below {:?}, which is not above it", page.parent()));
                }
            }
        }
        self.check_ancestors(&state)?;
        if in_table != state.table.len() {
            return Err(format!("the hash table has {} entries for {in_table} pages", state.table.len()));
        }
        if in_use != state.in_use || (in_use > 0 && state.needed == self.pages.len()) {
            let (slots, needed) = (self.pages.len(), state.needed);
            return Err(format!("{in_use} of {slots} slots are in use, {} counted, {needed} needed", state.in_use));
        }
        Ok(())
    }

    /// Checks what slots know of those below them.
    fn check_ancestors(&self, state: &State) -> Result<(), String> {
        let mut children = vec![0; state.slots.len()];
        let (mut needed, mut kept) = (vec![false; state.slots.len()], vec![false; state.slots.len()]);
        for (slot, entry) in state.slots.iter().enumerate() {
            if let Some(children) = children.get_mut(entry.parent as usize) {
                *children += 1;
            }
            for above in std::iter::once(slot as u32).chain(state.above(slot as u32)) {
                needed[above as usize] |= self.usage(slot as u32) > 0;
                kept[above as usize] |= self.usage(slot as u32) > 0 || entry.held.is_some();
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
    use crate::testing::{self, Random};

    /// A page, and the number of its parent.
    type Place = (PageLocation, Option<u32>);

    /// Does what the I/O process does with the room it was given.
    fn fill(pool: &Pool, model: &Model, (location, _): Place, room: Room) -> Option<u32> {
        let Room::Slot { slot, .. } = room else { return None };
        {
            let above = pool.ancestors(slot);
            let ancestors: Vec<&Page> = above.iter().map(|page| &**page).collect();
            model.read_page(location, &ancestors, &mut PageReader::default(), &mut pool.page_to_fill(slot)).unwrap();
        }
        pool.loaded(slot, Some(location.length));
        Some(slot)
    }

    fn prefetch(pool: &Pool, model: &Model, place: Place) -> Option<u32> {
        fill(pool, model, place, pool.reference(place.0.number, place.1))
    }

    fn load_urgently(pool: &Pool, model: &Model, place: Place) -> Option<u32> {
        fill(pool, model, place, pool.make_room(place.0.number, place.1))
    }

    fn pool(model: &Model, slots: usize, second_chance: bool) -> Pool {
        Pool::new((0..slots).map(|_| model.empty_page()).collect(), second_chance)
    }

    /// A model with several levels of pages, and all of its pages, parents first.
    fn all_pages() -> (std::sync::Arc<Model>, Vec<Place>) {
        let tree = testing::grid_tree(12, 12, 1);
        let disk = testing::disk_of(&tree, Blocking::Levels { levels: 4 });
        let model = std::sync::Arc::new(Model::open(&disk, "model.vdt".as_ref()).unwrap());
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
    fn pages() -> (std::sync::Arc<Model>, Place, Vec<Place>) {
        let (model, places) = all_pages();
        let children = places.iter().copied().filter(|(_, parent)| *parent == Some(places[0].0.number)).collect();
        (model, places[0], children)
    }

    #[test]
    fn a_flushed_page_gets_a_second_chance_until_its_slot_is_needed() {
        let (model, root, pages) = pages();
        for second_chance in [true, false] {
            let pool = pool(&model, 4, second_chance);
            prefetch(&pool, &model, root).unwrap();
            for page in &pages[..3] {
                prefetch(&pool, &model, *page).unwrap();
            }
            assert_eq!(prefetch(&pool, &model, pages[3]), None);
            assert_eq!(pool.counters().prefetch_given_up, 1);
            // Flushed in this order: 1, 0. So 1 makes room first, and 0 is still there.
            pool.dereference(pages[1].0.number);
            pool.dereference(pages[0].0.number);
            pool.check().unwrap();
            prefetch(&pool, &model, pages[3]).unwrap();
            pool.check().unwrap();
            let again = pool.reference(pages[0].0.number, pages[0].1);
            assert_eq!(again == Room::Resident, second_chance);
            assert_eq!(pool.counters().second_chances, u64::from(second_chance));
            assert_eq!(pool.counters().reads, 5);
            if second_chance {
                pool.check().unwrap();
                assert_eq!(pool.reference(pages[1].0.number, pages[1].1), Room::None);
            }
        }
    }

    #[test]
    fn the_pool_is_never_all_in_use() {
        let (model, root, pages) = pages();
        let pool = pool(&model, 5, true);
        let use_page = |page: &Place| pool.use_page(page.0.number, &[]);
        let slot_of = |page: &Place| match use_page(page) {
            Use::Granted { slot } => slot,
            other => panic!("{other:?}"),
        };
        prefetch(&pool, &model, root).unwrap();
        for page in &pages[..4] {
            prefetch(&pool, &model, *page).unwrap();
        }
        // Urgently, while three are not needed: in the place of the first that is only prefetched.
        let first = slot_of(&pages[0]);
        assert_eq!((pool.in_use(), pool.needed()), (1, 2));
        load_urgently(&pool, &model, pages[4]).unwrap();
        assert_eq!(use_page(&pages[1]), Use::Missing);
        assert_eq!(pool.counters().urgent, 1);
        pool.check().unwrap();
        let second = slot_of(&pages[4]);
        assert_eq!(load_urgently(&pool, &model, pages[1]), None);
        assert_eq!(use_page(&pages[1]), Use::Refused);
        // A page that is there, while two are not needed.
        let third = slot_of(&pages[2]);
        assert_eq!(use_page(&pages[3]), Use::Refused);
        assert_eq!((pool.in_use(), pool.needed()), (3, 4));
        // One that is in use already always goes, and one that is above those in use.
        pool.use_again(third);
        assert_eq!(slot_of(&pages[2]), third);
        let top = slot_of(&root);
        pool.check().unwrap();
        assert!(pool.stop_using(top, Hold::End));
        assert!(
            !pool.stop_using(third, Hold::End)
                && !pool.stop_using(third, Hold::End)
                && pool.stop_using(third, Hold::End)
        );
        assert!(pool.stop_using(first, Hold::End) && pool.stop_using(second, Hold::End));
        assert_eq!((pool.in_use(), pool.needed()), (0, 0));
        // Three are prefetched, one is free, one is above them.
        let room = pool.make_room(pages[1].0.number, pages[1].1);
        assert_eq!(room, Room::Slot { slot: second, refers: false });
        pool.loaded(second, None);
        // A page that nobody comes to use is let go after a while.
        let held = load_urgently(&pool, &model, pages[4]).unwrap();
        for _ in 0..HOLD_FRAMES {
            pool.begin_frame();
            assert_eq!(pool.reference(pages[1].0.number, pages[1].1), Room::None);
        }
        pool.begin_frame();
        pool.check().unwrap();
        assert_eq!(pool.reference(pages[1].0.number, pages[1].1), Room::Slot { slot: held, refers: false });
    }

    #[test]
    fn a_page_that_cannot_be_read_leaves_its_slot_free() {
        let (model, root, pages) = pages();
        let pool = pool(&model, 2, true);
        prefetch(&pool, &model, root).unwrap();
        let Room::Slot { slot, .. } = pool.reference(pages[0].0.number, pages[0].1) else { panic!("there is room") };
        pool.loaded(slot, None);
        pool.check().unwrap();
        assert_eq!(pool.counters().reads, 1);
        assert!(prefetch(&pool, &model, pages[1]).is_some());
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
        for second_chance in [true, false] {
            let pool = pool(&model, 5, second_chance);
            // Not without its parent.
            assert_eq!(load_urgently(&pool, &model, bottom), None);
            assert_eq!(prefetch(&pool, &model, middle), None);
            let slots = [top, middle, bottom].map(|place| load_urgently(&pool, &model, place).unwrap());
            assert_eq!(
                pool.ancestors(slots[2]).iter().map(|page| page.number()).collect::<Vec<_>>(),
                [top.0.number, middle.0.number]
            );
            // The root of a tree that begins at the bottom needs all three, so that one of five would be left for more.
            assert_eq!(pool.use_page(bottom.0.number, &[top.0, middle.0]), Use::Granted { slot: slots[2] });
            assert_eq!((pool.in_use(), pool.needed()), (1, 3));
            let mut others = places.iter().filter(|(_, above)| *above == Some(top.0.number));
            let other = others.find(|place| place.0 != middle.0).unwrap();
            assert_eq!(pool.use_page(other.0.number, &[]), Use::Refused);
            assert!(pool.stop_using(slots[2], Hold::End));
            pool.end_all_holds();
            pool.check().unwrap();
            let kinds = |pool: &Pool| slots.map(|slot| pool.state.lock().slots[slot as usize].kind);
            if !second_chance {
                // With the last page below it, each goes.
                assert!(pool.state.lock().table.is_empty());
                continue;
            }
            assert_eq!(kinds(&pool), [Kind::Above, Kind::Above, Kind::Free]);
            // Two slots are empty; then the page at the bottom makes room, then the one above it.
            let siblings = places.iter().copied().filter(|(_, above)| *above == Some(top.0.number));
            for (number, sibling) in siblings.filter(|place| place.0 != middle.0).take(4).enumerate() {
                let slot = prefetch(&pool, &model, sibling).unwrap();
                assert_eq!([slots[2], slots[1]].iter().position(|other| *other == slot), number.checked_sub(2));
                pool.check().unwrap();
            }
            assert_eq!(kinds(&pool)[0], Kind::Above);
            // None is left but that of the parent itself.
            assert_eq!(prefetch(&pool, &model, middle), None);
        }
    }

    /// The root of a tree asks for more: the pages of the way to it that nobody needs.
    #[test]
    fn a_way_that_is_not_needed_counts() {
        let (model, places) = all_pages();
        let top = places[0];
        let middle = places.iter().copied().find(|(_, above)| *above == Some(top.0.number)).unwrap();
        let asked = |slots: usize| pool(&model, slots, true).use_page(places[2].0.number, &[top.0, middle.0]);
        assert_eq!((asked(4), asked(5)), (Use::Refused, Use::Missing));
        let pool = pool(&model, 3, true);
        let slots = [top, middle].map(|place| load_urgently(&pool, &model, place).unwrap());
        // Its own page and the one above: one of three is left.
        assert_eq!(pool.use_page(middle.0.number, &[top.0]), Use::Granted { slot: slots[1] });
        pool.check().unwrap();
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

        /// Whatever happens, in any order: what slots know of each other is what the slow check finds.
        #[test]
        fn the_counts_are_right_after_anything(seed in any::<u64>(), slots in 3..24_usize, second_chance in any::<bool>()) {
            let (model, places) = all_pages();
            let pool = pool(&model, slots, second_chance);
            let mut random = Random(seed);
            let mut used: Vec<u32> = Vec::new();
            for _ in 0..300 {
                let place = places[random.below(places.len().min(3 * slots))];
                let (number, parent) = (place.0.number, place.1);
                match random.below(9) {
                    0 => pool.begin_frame(),
                    1 => pool.dereference(number),
                    2 | 3 => drop(prefetch(&pool, &model, place)),
                    4 | 5 => drop(load_urgently(&pool, &model, place)),
                    6 => {
                        if let Room::Slot { slot, .. } = pool.make_room(number, parent) {
                            pool.loaded(slot, None);
                        }
                    }
                    7 => {
                        if let Use::Granted { slot } = pool.use_page(number, &[]) {
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
