//! The pool of place holders (the paper, 3.3.3): a fixed number of slots, allocated once, each with room for any page.
//!
//! A page in a slot is in the *physical main memory*: the hash table leads to it. Each slot has two counts: the *usage
//! count*, how many splits of its page are applied, and the *reference count*, how many pages in use have it prefetched
//! as their parent or child; and for [`HOLD_FRAMES`] frames it may be *held*, for a node that asked for it urgently and
//! has not used it yet, or had to let go of it because another page is missing. Then it gives way to nobody: else
//! urgent pages would push each other out for nothing. A slot with both counts zero and not held is in the *free list*,
//! and is given to the next page that needs one. Its page stays in the hash table until then: when it is asked for
//! again before, it gets a *second chance*, and is taken out of the free list without a disk read. Freed slots go to
//! the end of the list, slots to be filled come from its front.
//!
//! Only the navigator changes usage counts. A change from or to zero is made under the pool's lock, as is every look at
//! the hash table, the free list and the other counts; a change of a count that stays above zero needs no lock. No lock
//! but that of the page being filled is held during a disk read, and nobody else looks at that page.
//!
//! # Never all in use
//!
//! The paper's rule of three: urgent prefetching for switching down only while at least three place holders are not in
//! use, because switching down may bring two more into use (one for each child), so that one remains. Here a page is in
//! use while one of its *splits* is applied, so:
//!
//! - A split brings at most one page into use: its own. It is refused while fewer than [`LEAST_FOR_SPLIT`] = 2 slots
//!   are not in use, so at least one remains.
//! - A collapse needs no page that is not there: the split that it undoes is applied, so its page is in use. Switching
//!   up can always go on, and never has to wait for a disk.
//! - A page is loaded urgently only while at least [`LEAST_FOR_URGENT`] = 3 slots are not in use: one that it goes to,
//!   one that stays, and one more for a page that comes into use while it is being read. With fewer it could be read
//!   for nothing.

use std::sync::atomic::{AtomicU32, Ordering};

use hashbrown::HashMap;
use metanode::page::Page;
use parking_lot::{Mutex, RwLock, RwLockReadGuard, RwLockWriteGuard};

use crate::front::NONE;

/// Slots that must not be in use for a split to bring one more page into use.
pub const LEAST_FOR_SPLIT: usize = 2;
/// Slots that must not be in use for a page to be loaded urgently.
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

/// What a slot is at the moment; the first three are in a list each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Nobody needs its page: in the free list.
    Free,
    /// Its page is only prefetched.
    Prefetched,
    /// Its page is held for a node that is to use it.
    Held,
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
            Kind::Used | Kind::Loading => None,
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
    /// What follows from all that.
    kind: Kind,
    /// Neighbours in the list.
    before: u32,
    after: u32,
}

impl Slot {
    fn kind(&self, usage: u32) -> Kind {
        if self.stage == Stage::Loading {
            Kind::Loading
        } else if usage > 0 {
            Kind::Used
        } else if self.held.is_some() {
            Kind::Held
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
    /// Urgent pages that found no room, because what is not in use is held for others; and pages that could not be
    /// held.
    pub starved: u64,
}

#[derive(Debug)]
struct State {
    table: HashMap<u32, u32>,
    slots: Vec<Slot>,
    lists: [List; LISTS],
    in_use: usize,
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
    /// There is no room for it.
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

    /// Takes the slot out of the hash table, and out of its list, and gives it to `page`.
    fn allocate(&mut self, slot: u32, page: u32) -> Room {
        self.unlink(slot);
        let previous = self.slots[slot as usize];
        if previous.stage != Stage::Empty {
            self.table.remove(&previous.page);
        }
        self.table.insert(page, slot);
        self.slots[slot as usize] = Slot {
            page,
            stage: Stage::Loading,
            references: 0,
            held: None,
            refers: false,
            kind: Kind::Loading,
            before: NONE,
            after: NONE,
        };
        Room::Slot { slot, refers: previous.refers }
    }
}

impl Pool {
    /// A pool of the given pages, which are empty and all of one size.
    pub fn new(pages: Vec<Page>, second_chance: bool) -> Self {
        let count = pages.len();
        let empty = Slot {
            page: NONE,
            stage: Stage::Empty,
            references: 0,
            held: None,
            refers: false,
            kind: Kind::Free,
            before: NONE,
            after: NONE,
        };
        let mut state = State {
            table: HashMap::with_capacity(count),
            slots: vec![empty; count],
            lists: [List { first: NONE, last: NONE, length: 0 }; LISTS],
            in_use: 0,
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

    /// Puts a slot into the list that it belongs to after a change; one that is held, or nobody needs any more, to its
    /// end.
    fn settle(&self, state: &mut State, slot: u32) {
        let before = state.slots[slot as usize];
        let kind = before.kind(self.usage(slot));
        if kind == before.kind && kind != Kind::Held {
            return;
        }
        if kind == Kind::Free && before.stage == Stage::Ready && !self.second_chance {
            state.table.remove(&before.page);
            state.slots[slot as usize].stage = Stage::Empty;
        }
        state.unlink(slot);
        state.slots[slot as usize].kind = kind;
        state.append(slot);
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

    /// A first or further split of this page is to be applied. Navigator only.
    pub fn use_page(&self, page: u32) -> Use {
        let mut state = self.state.lock();
        let not_in_use = self.pages.len() - state.in_use;
        let ready = state.table.get(&page).filter(|slot| state.slots[**slot as usize].stage == Stage::Ready);
        let Some(slot) = ready.copied() else {
            return if not_in_use < LEAST_FOR_URGENT { Use::Refused } else { Use::Missing };
        };
        if self.usage(slot) == 0 {
            if not_in_use < LEAST_FOR_SPLIT {
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
        match hold {
            Hold::End => state.slots[slot as usize].held = None,
            Hold::Keep => (),
            // Never so many that none is left for what is missing; where there is room for all pages, they never are.
            Hold::Renew if state.list(Kind::Held).length + LEAST_FOR_URGENT <= self.pages.len() - state.in_use => {
                state.slots[slot as usize].held = Some(state.frame);
            }
            Hold::Renew => state.counters.starved += 1,
        }
        self.settle(&mut state, slot);
        true
    }

    /// Makes room for a page that a page in use refers to, and counts the reference.
    pub fn reference(&self, page: u32) -> Room {
        let mut state = self.state.lock();
        if let Some(slot) = state.find(page) {
            state.slots[slot as usize].references += 1;
            self.settle(&mut state, slot);
            return Room::Resident;
        }
        match state.list(Kind::Free).first {
            NONE => {
                state.counters.prefetch_given_up += 1;
                Room::None
            }
            slot => {
                let room = state.allocate(slot, page);
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
    /// is prefetched but not in use, which is the one that has been so for the longest time.
    pub fn make_room(&self, page: u32) -> Room {
        let mut state = self.state.lock();
        let frame = state.frame;
        if let Some(slot) = state.find(page) {
            state.slots[slot as usize].held = Some(frame);
            self.settle(&mut state, slot);
            return Room::Resident;
        }
        if self.pages.len() - state.in_use < LEAST_FOR_URGENT {
            return Room::None;
        }
        let firsts = [Kind::Free, Kind::Prefetched].map(|kind| state.list(kind).first);
        let Some(slot) = firsts.into_iter().find(|slot| *slot != NONE) else {
            state.counters.starved += 1;
            return Room::None;
        };
        let room = state.allocate(slot, page);
        state.slots[slot as usize].held = Some(frame);
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
    /// any more, where that changes. It is to be while it is in use; `always` counts it even so (the root pages, at the
    /// start).
    pub fn update_references(&self, slot: u32, always: bool) -> Option<bool> {
        let mut state = self.state.lock();
        let refers = self.usage(slot) > 0 || always;
        let entry = &mut state.slots[slot as usize];
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
            if entry.stage == Stage::Ready && self.page(slot as u32).number() != entry.page {
                return Err(format!("slot {slot} holds another page than {}", entry.page));
            }
        }
        if in_table != state.table.len() {
            return Err(format!("the hash table has {} entries for {in_table} pages", state.table.len()));
        }
        if in_use != state.in_use || (in_use > 0 && in_use == self.pages.len()) {
            return Err(format!("{in_use} of {} slots are in use, {} counted", self.pages.len(), state.in_use));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use metanode::model::Model;
    use metanode::page::PageLocation;

    use super::*;
    use crate::testing;

    /// Does what the I/O process does with the room it was given.
    fn fill(pool: &Pool, model: &Model, location: PageLocation, room: Room) -> Option<u32> {
        let Room::Slot { slot, .. } = room else { return None };
        model.read_page(location, &mut Vec::new(), &mut pool.page_to_fill(slot)).unwrap();
        pool.loaded(slot, Some(location.length));
        Some(slot)
    }

    fn pool(model: &Model, slots: usize, second_chance: bool) -> Pool {
        Pool::new((0..slots).map(|_| model.empty_page()).collect(), second_chance)
    }

    fn pages() -> (std::sync::Arc<Model>, Vec<PageLocation>) {
        let tree = testing::grid_tree(12, 12, 1);
        let disk = testing::disk_of(&tree, metanode::header::Blocking::Levels { levels: 4 });
        let model = std::sync::Arc::new(Model::open(&disk, "model.vdt".as_ref()).unwrap());
        let mut page = model.empty_page();
        model.read_page(model.root_pages()[0], &mut Vec::new(), &mut page).unwrap();
        let locations = model.root_pages().iter().copied().chain(page.children()).collect();
        (model, locations)
    }

    #[test]
    fn a_flushed_page_gets_a_second_chance_until_its_slot_is_needed() {
        let (model, pages) = pages();
        for second_chance in [true, false] {
            let pool = pool(&model, 3, second_chance);
            for page in &pages[..3] {
                fill(&pool, &model, *page, pool.reference(page.number)).unwrap();
            }
            assert_eq!(pool.reference(pages[3].number), Room::None);
            assert_eq!(pool.counters().prefetch_given_up, 1);
            // Flushed in this order: 1, 0. So 1 makes room first, and 0 is still there.
            pool.dereference(pages[1].number);
            pool.dereference(pages[0].number);
            pool.check().unwrap();
            fill(&pool, &model, pages[3], pool.reference(pages[3].number)).unwrap();
            pool.check().unwrap();
            let again = pool.reference(pages[0].number);
            assert_eq!(again == Room::Resident, second_chance);
            assert_eq!(pool.counters().second_chances, u64::from(second_chance));
            assert_eq!(pool.counters().reads, 4);
            if second_chance {
                pool.check().unwrap();
                assert_eq!(pool.reference(pages[1].number), Room::None);
            }
        }
    }

    #[test]
    fn the_pool_is_never_all_in_use() {
        let (model, pages) = pages();
        let pool = pool(&model, 4, true);
        let slot_of = |page: &PageLocation| match pool.use_page(page.number) {
            Use::Granted { slot } => slot,
            other => panic!("{other:?}"),
        };
        for page in &pages[..4] {
            fill(&pool, &model, *page, pool.reference(page.number)).unwrap();
        }
        // Urgently, while three are not in use: in the place of the first that is only prefetched.
        let first = slot_of(&pages[0]);
        fill(&pool, &model, pages[4], pool.make_room(pages[4].number)).unwrap();
        assert_eq!(pool.use_page(pages[1].number), Use::Missing);
        assert_eq!(pool.counters().urgent, 1);
        pool.check().unwrap();
        let second = slot_of(&pages[4]);
        assert_eq!(pool.make_room(pages[1].number), Room::None);
        assert_eq!(pool.use_page(pages[1].number), Use::Refused);
        // A page that is there, while two are not in use.
        let third = slot_of(&pages[2]);
        assert_eq!(pool.use_page(pages[3].number), Use::Refused);
        assert_eq!(pool.in_use(), 3);
        // One that is in use already always goes.
        pool.use_again(third);
        assert_eq!(slot_of(&pages[2]), third);
        pool.check().unwrap();
        assert!(
            !pool.stop_using(third, Hold::End)
                && !pool.stop_using(third, Hold::End)
                && pool.stop_using(third, Hold::End)
        );
        assert!(pool.stop_using(first, Hold::End) && pool.stop_using(second, Hold::End));
        assert_eq!(pool.in_use(), 0);
        // Three are prefetched, one is free.
        assert_eq!(pool.make_room(pages[1].number), Room::Slot { slot: second, refers: false });
        pool.loaded(second, None);
        // A page that nobody comes to use is let go after a while.
        let held = fill(&pool, &model, pages[4], pool.make_room(pages[4].number)).unwrap();
        for _ in 0..HOLD_FRAMES {
            pool.begin_frame();
            assert_eq!(pool.reference(pages[1].number), Room::None);
        }
        pool.begin_frame();
        pool.check().unwrap();
        assert_eq!(pool.reference(pages[1].number), Room::Slot { slot: held, refers: false });
    }

    #[test]
    fn a_page_that_cannot_be_read_leaves_its_slot_free() {
        let (model, pages) = pages();
        let pool = pool(&model, 1, true);
        let Room::Slot { slot, .. } = pool.reference(pages[0].number) else { panic!("there is room") };
        pool.loaded(slot, None);
        pool.check().unwrap();
        assert_eq!(pool.counters().reads, 0);
        assert!(fill(&pool, &model, pages[1], pool.reference(pages[1].number)).is_some());
        pool.check().unwrap();
    }
}
