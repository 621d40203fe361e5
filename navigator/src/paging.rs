//! The navigator's side of the pool and the board: usage counts, the pages in use, and requests and wishes for those that are
//! missing.
//!
//! Or all pages lie decoded in one mapped file, to compare with (the paper, 4, Table 2: *Virt.*). To the navigator each is always
//! there then, and its place holder is its number; which of them are in RAM is the operating system's matter, and a frame that looks
//! at one that is not waits for the disk. So there is nothing to prefetch, nothing is missing, and no split is refused for want of
//! place holders.
//!
//! The navigator knows the pages in use itself: for each place holder the page, its number, and its usage count, how many
//! of its splits are applied. So nothing of what it does most, reading records and counting splits, asks the pool for anything;
//! the pool is told when a page comes into use and when it goes out of it.
//!
//! # Wishes
//!
//! A frame names pages that will probably be needed soon (see [`Paging::wish`]). It need not look everywhere: what it names stays
//! wished for [`SWEEP_FRAMES`] frames, so that each of them may look at its part of the front. At the end of every
//! other one the strongest wishes are the prefetch list, at most half as many as there are place holders and no more than
//! [`WISH_LIMIT`].

use std::sync::Arc;
use std::thread::JoinHandle;

use hashbrown::HashMap;
use metanode::DecodedFile;
use metanode::model::Model;
use metanode::page::{Page, PageLocation};
use storage::prefetch::prefetch;

use crate::board::{Board, Command, Request};
use crate::front::{Misfit, NONE};
use crate::io_process::{Io, IoProcess};
use crate::navigator::NavigatorError;
use crate::pool::{Found, Hold, Policy, Pool, reserved_slots};

/// In how many frames the front is looked at for pages to be wished, a part of it in each.
pub const SWEEP_FRAMES: usize = 4;
/// In how many frames there is a new prefetch list.
const PUBLISHED_EVERY: usize = 2;
/// Most wishes.
const WISH_LIMIT: usize = 1024;

/// Bytes of an entry of a hash table of pages, at the worst filling.
pub const TABLE_ENTRY_BYTES: usize = 9 * 16 / 7;
/// Bytes that wishes take for each place holder, at the most: there is a wish for two of them. Those of a frame, of the last ones,
/// of all together, and on the board.
pub const WISH_BYTES: usize = size_of::<Want>()
    + ((2 * SWEEP_FRAMES + 1) * size_of::<Command>() + 2 * size_of::<u32>()).div_ceil(2)
    + 2 * TABLE_ENTRY_BYTES;

/// Bytes of RAM for each page of a model in a mapped file, beside what the system keeps of the file.
pub const MAPPED_PAGE_BYTES: usize = size_of::<Arc<Page>>() + 2 * size_of::<u32>();

fn wish_limit(slots: usize) -> usize {
    (slots / 2).clamp(1, WISH_LIMIT)
}

/// The page that the split of an active node is in, and how much it is wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Want {
    /// Number of the page.
    pub page: u32,
    /// The place holder of the page with the parent's split, which is in use; [`NONE`] for a root.
    pub parent_slot: u32,
    /// Number of the root, where there is no parent.
    pub root: u32,
    /// How much it is wanted: the node's error in pixels over the threshold; for wishes see [`prediction`](crate::prediction).
    pub error: f32,
}

/// What became of a wish to use a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    /// It is in this slot, and its usage count is one more.
    Granted {
        /// The slot.
        slot: u32,
    },
    /// It is not there, and has been asked for.
    Missing,
    /// Too many slots are in use.
    Refused,
}

/// Who carries out the commands on the board.
#[derive(Debug)]
enum Executor {
    /// The navigator itself, at once.
    Inline(Box<IoProcess>),
    /// Threads.
    Threads(Vec<JoinHandle<()>>),
    /// Nobody: all pages are in a mapped file.
    Nobody(DecodedFile),
}

/// What the I/O process is to be like.
#[derive(Debug, Clone, Copy)]
pub struct PagingOptions {
    /// Number of place holders.
    pub slots: usize,
    /// How it runs.
    pub io: Io,
    /// How many threads it has.
    pub io_threads: usize,
    /// Whether wishes are listened to.
    pub prefetch: bool,
    /// What becomes of pages that nobody needs.
    pub policy: Policy,
}

/// The way from the nodes of a front to their pages.
#[derive(Debug)]
pub struct Paging {
    model: Arc<Model>,
    pool: Arc<Pool>,
    board: Arc<Board>,
    executor: Executor,
    prefetch: bool,
    /// For each place holder the page that is in use there, else one without records; its number; and its usage count.
    pages: Vec<Arc<Page>>,
    page_of_slot: Vec<u32>,
    usage: Vec<u32>,
    wish_limit: usize,
    /// The place holder of each page in use.
    slot_of_page: HashMap<u32, u32>,
    /// Where in `wants` each page is.
    wanted: HashMap<u32, u32>,
    /// What was wished in this frame, each page once, and in the last ones; all of that together; and the pages of the last prefetch list, with
    /// the pool's version by then.
    wants: Vec<Want>,
    wishes: [Vec<Command>; SWEEP_FRAMES],
    merged: Vec<Command>,
    published: Vec<u32>,
    published_at: u64,
    /// How strong the strongest wish was that found no place in the last list; 0 where there was none.
    weakest_wish: f32,
    /// Whether there are place holders in which no page ever was, and pages stay where they are until then.
    has_empty_slots: bool,
    /// Whether there is anything to be read on that list that may find room.
    has_wishes: bool,
    frame: usize,
}

/// By how strongly it is wished: the strongest first, and among equals the page with the smaller number.
fn strongest_first(commands: &mut [Command]) {
    commands.sort_unstable_by(|one, other| other.priority.total_cmp(&one.priority).then(one.page().cmp(&other.page())));
}

/// Leaves of several wishes for the same page the strongest.
fn merge(commands: &mut Vec<Command>) {
    commands.sort_unstable_by(|one, other| one.page().cmp(&other.page()).then(other.priority.total_cmp(&one.priority)));
    commands.dedup_by_key(|command| command.page());
}

impl Paging {
    /// Fills a pool with the root pages, and starts the I/O process.
    pub fn start(model: Arc<Model>, options: PagingOptions) -> Result<Self, NavigatorError> {
        let PagingOptions { slots, io, io_threads, prefetch, policy } = options;
        let pages = (0..slots).map(|_| model.empty_page()).collect();
        let reserved = reserved_slots(slots, model.header());
        let pool = Arc::new(Pool::new(pages, model.header().page_count as usize, reserved, policy));
        let readers = if io == Io::Sync { 1 } else { io_threads.max(1) };
        let board = Arc::new(Board::new(slots, readers));
        let new_process = || IoProcess::new(model.clone(), pool.clone(), board.clone());
        let mut process = new_process();
        process.load_roots();
        if let Some(failure) = board.take_failure() {
            return Err(failure.into());
        }
        let wish_limit = wish_limit(slots);
        let nothing = pool.nothing().clone();
        let mut paging = Paging {
            model: model.clone(),
            pool: pool.clone(),
            board: board.clone(),
            executor: Executor::Threads(Vec::new()),
            prefetch,
            pages: vec![nothing; slots],
            page_of_slot: vec![NONE; slots],
            usage: vec![0; slots],
            wish_limit,
            slot_of_page: HashMap::with_capacity(slots),
            wanted: HashMap::with_capacity(2 * wish_limit),
            wants: Vec::with_capacity(2 * wish_limit),
            wishes: std::array::from_fn(|_| Vec::with_capacity(wish_limit)),
            merged: Vec::with_capacity(SWEEP_FRAMES * wish_limit),
            published: Vec::with_capacity(wish_limit),
            published_at: 0,
            weakest_wish: 0.0,
            has_empty_slots: false,
            has_wishes: false,
            frame: 0,
        };
        match io {
            Io::Sync => paging.executor = Executor::Inline(Box::new(process)),
            Io::Thread => {
                for process in std::iter::once(process).chain((1..readers).map(|_| new_process())) {
                    // Those that run are ended where one cannot be started.
                    let thread = process.run_in_thread().map_err(|source| NavigatorError::Thread { source })?;
                    if let Executor::Threads(threads) = &mut paging.executor {
                        threads.push(thread);
                    }
                }
            }
        }
        Ok(paging)
    }

    /// The way to pages that lie in a mapped file.
    pub fn mapped(model: Arc<Model>, decoded: DecodedFile) -> Self {
        let pool = Arc::new(Pool::new(Vec::new(), 0, 0, Policy::None));
        let count = decoded.page_count() as usize;
        Paging {
            model,
            board: Arc::new(Board::new(0, 1)),
            executor: Executor::Nobody(decoded),
            prefetch: false,
            pages: vec![pool.nothing().clone(); count],
            page_of_slot: vec![NONE; count],
            usage: vec![0; count],
            pool,
            wish_limit: 0,
            slot_of_page: HashMap::new(),
            wanted: HashMap::new(),
            wants: Vec::new(),
            wishes: std::array::from_fn(|_| Vec::new()),
            merged: Vec::new(),
            published: Vec::new(),
            published_at: 0,
            weakest_wish: 0.0,
            has_empty_slots: false,
            has_wishes: false,
            frame: 0,
        }
    }

    /// The pool; without place holders where pages lie in a mapped file.
    pub fn pool(&self) -> &Pool {
        &self.pool
    }

    /// The board.
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// The page in a place holder that is in use.
    pub fn page(&self, slot: u32) -> &Page {
        &self.pages[slot as usize]
    }

    /// Number of the page in a place holder that is in use; [`NONE`] for one that is not.
    pub fn page_number(&self, slot: u32) -> u32 {
        self.page_of_slot[slot as usize]
    }

    /// How many splits of the page in each place holder are applied.
    pub fn usage(&self) -> &[u32] {
        &self.usage
    }

    /// Place holders whose page is in use.
    pub fn in_use(&self) -> usize {
        match &self.executor {
            Executor::Nobody(_) => self.usage.iter().filter(|usage| **usage > 0).count(),
            _ => self.pool.in_use(),
        }
    }

    /// The ancestors of the page in a place holder that is in use, from the root page down to its parent.
    pub fn ancestors(&self, slot: u32) -> Vec<Page> {
        match &self.executor {
            Executor::Nobody(decoded) => {
                let above = |page: &Page| page.parent().and_then(|parent| decoded.page(parent));
                let mut ancestors: Vec<Page> = std::iter::successors(above(self.page(slot)), above).collect();
                ancestors.reverse();
                ancestors
            }
            _ => self.pool.ancestors(slot).iter().map(|page| Page::clone(page)).collect(),
        }
    }

    /// The place holder of a page that is in use. Most often it is that of the parent's split, which is given.
    #[inline]
    fn slot_in_use(&self, page: u32, slot_above: u32) -> Option<u32> {
        if slot_above != NONE && self.page_number(slot_above) == page {
            return Some(slot_above);
        }
        match &self.executor {
            Executor::Nobody(_) => {
                Some(page).filter(|page| self.usage.get(*page as usize).is_some_and(|usage| *usage > 0))
            }
            _ => self.slot_of_page.get(&page).copied(),
        }
    }

    /// A step towards a split, whose parent's record is in the place holder `slot_above`: fetches the page's own fields, then the
    /// record, then its parts into the cache. No effect where the page is not in use: then it may not be there.
    #[inline]
    pub fn prefetch(&self, slot_above: u32, (page, record): (u32, u16), step: usize) {
        let Some(slot) = self.slot_in_use(page, slot_above) else { return };
        let page = self.page(slot);
        match step {
            0 => prefetch(std::slice::from_ref(page), 0),
            1 => page.prefetch_record(record),
            _ => page.prefetch_parts(record),
        }
    }

    /// A frame begins.
    pub fn begin_frame(&mut self) {
        self.has_empty_slots = self.pool.begin_frame();
        let stale = self.board.begin_frame();
        self.count_cancelled(stale);
        self.frame += 1;
        self.wants.clear();
        self.wanted.clear();
    }

    fn count_cancelled(&self, count: u64) {
        if count > 0 {
            self.pool.count(|counters| counters.cancelled += count);
        }
    }

    /// Counts the use of the page that the split of an active node is in. A missing page is asked for urgently.
    pub fn begin_use(&mut self, want: &Want) -> Use {
        let Want { page, parent_slot, .. } = *want;
        if let Some(slot) = self.slot_in_use(page, parent_slot) {
            self.usage[slot as usize] += 1;
            return Use::Granted { slot };
        }
        if let Executor::Nobody(decoded) = &self.executor {
            let Some(mapped) = decoded.page(page) else { return Use::Refused };
            self.pages[page as usize] = Arc::new(mapped);
            self.page_of_slot[page as usize] = page;
            self.usage[page as usize] = 1;
            return Use::Granted { slot: page };
        }
        // The parent's page is in use, and its ancestors are there. Who has no parent may have to have them brought in.
        let way = if parent_slot == NONE { self.model.way_to(page) } else { Vec::new() };
        let mut found = self.pool.use_page(page, &way);
        if matches!(found, Found::Missing) {
            self.ask_urgently(want);
            if self.run_inline() {
                found = self.pool.use_page(page, &way);
                if matches!(found, Found::Missing) && !self.board.has_failure() {
                    // What else is held is for later; this page is used now.
                    self.pool.end_all_holds();
                    self.ask_urgently(want);
                    self.run_inline();
                    found = self.pool.use_page(page, &way);
                }
            }
        }
        match found {
            Found::Granted { slot, fresh } => {
                if let Some(fresh) = fresh {
                    self.pages[slot as usize] = fresh;
                    self.page_of_slot[slot as usize] = page;
                    self.slot_of_page.insert(page, slot);
                }
                self.usage[slot as usize] += 1;
                Use::Granted { slot }
            }
            Found::Missing | Found::Coming => Use::Missing,
            Found::Refused => Use::Refused,
        }
    }

    fn ask_urgently(&self, want: &Want) {
        let dropped = self.board.post_urgent(self.request(want), want.error);
        self.count_cancelled(dropped);
    }

    /// The use begun before has led to nothing, as yet.
    pub fn cancel_use(&mut self, slot: u32) {
        self.end_use(slot, Hold::Keep);
    }

    /// A split of the page in this place holder was undone.
    pub fn end_use(&mut self, slot: u32, hold: Hold) {
        let usage = &mut self.usage[slot as usize];
        *usage -= 1;
        if *usage == 0 {
            let page = std::mem::replace(&mut self.page_of_slot[slot as usize], NONE);
            self.slot_of_page.remove(&page);
            self.pages[slot as usize] = self.pool.nothing().clone();
            if !matches!(self.executor, Executor::Nobody(_)) {
                self.pool.stop_using(slot, hold);
            }
        }
    }

    /// Whether all pages of the model are there: then there is nothing to wish for.
    pub fn has_all_pages(&self) -> bool {
        self.pool.ready() == self.model.header().page_count as usize
    }

    /// How strong a wish has to be, about, to find a place in the prefetch list.
    pub fn weakest_wish(&self) -> f32 {
        self.weakest_wish
    }

    /// Whether a page is there and will stay, whatever is wished: because it is in use, or because none has to go.
    #[inline]
    pub fn will_stay(&self, page: u32) -> bool {
        if self.has_empty_slots { self.pool.is_there(page) } else { self.slot_of_page.contains_key(&page) }
    }

    /// The page that the split of this node is in will probably be needed soon. No effect where it will stay anyway.
    pub fn wish(&mut self, want: &Want) {
        if !self.prefetch || self.will_stay(want.page) {
            return;
        }
        if let Some(index) = self.wanted.get(&want.page) {
            let wanted = &mut self.wants[*index as usize];
            if want.error > wanted.error {
                *wanted = *want;
            }
            return;
        }
        if self.wants.len() == self.wants.capacity() {
            self.limit_wants();
            self.wanted.clear();
            self.wanted.extend(self.wants.iter().map(|want| want.page).zip(0..));
        }
        self.wanted.insert(want.page, self.wants.len() as u32);
        self.wants.push(*want);
    }

    /// Leaves of what was wished in this frame the strongest.
    fn limit_wants(&mut self) {
        if self.wants.len() > self.wish_limit {
            let strongest_first =
                |one: &Want, other: &Want| other.error.total_cmp(&one.error).then(one.page.cmp(&other.page));
            self.wants.select_nth_unstable_by(self.wish_limit, strongest_first);
            self.wants.truncate(self.wish_limit);
        }
    }

    /// A frame ends: what was wished in it and the last ones is the prefetch list from now on, or from the next one on. True if
    /// there is anything to be read on it that may find room.
    pub fn end_frame(&mut self) -> bool {
        if !self.prefetch || (self.wants.is_empty() && self.has_all_pages()) {
            return false;
        }
        self.limit_wants();
        let mut wishes = std::mem::take(&mut self.wishes[self.frame % SWEEP_FRAMES]);
        wishes.clear();
        wishes.extend(self.wants.iter().map(|want| Command {
            request: self.request(want),
            priority: want.error,
            is_urgent: false,
        }));
        self.wishes[self.frame % SWEEP_FRAMES] = wishes;
        if !self.frame.is_multiple_of(PUBLISHED_EVERY) {
            return self.has_wishes;
        }
        let merged = &mut self.merged;
        merged.clear();
        self.wishes.iter().for_each(|wishes| merged.extend_from_slice(wishes));
        merge(merged);
        strongest_first(merged);
        self.weakest_wish = merged.get(self.wish_limit).map_or(0.0, |first_left_out| first_left_out.priority);
        merged.truncate(self.wish_limit);
        self.pool.renew_wishes(merged);
        // The same list, after nothing has changed, would find no room again, and never let the I/O process come to rest.
        let version = self.pool.version();
        let pages = merged.iter().map(Command::page);
        if version == self.published_at && pages.clone().eq(self.published.iter().copied()) {
            self.has_wishes = false;
            return false;
        }
        self.published.clear();
        self.published.extend(pages);
        self.published_at = version;
        let cancelled = self.board.publish(merged);
        self.count_cancelled(cancelled);
        self.run_inline();
        self.has_wishes = !self.published.is_empty();
        self.has_wishes
    }

    /// An error that names the file and the page that does not fit.
    pub fn misfit(&self, page: u32, source: Misfit) -> NavigatorError {
        NavigatorError::Misfit { path: self.model.path().into(), page, source }
    }

    fn request(&self, want: &Want) -> Request {
        let parent = (want.parent_slot != NONE).then(|| self.page_number(want.parent_slot));
        Request { location: self.location(want), parent }
    }

    /// Where a page lies that is wanted.
    pub fn location(&self, want: &Want) -> PageLocation {
        match want.parent_slot {
            NONE => self.model.roots()[want.root as usize].page,
            slot => {
                let page = self.page(slot);
                let child = want.page.wrapping_sub(page.child_number(0));
                page.child_location(child as usize)
            }
        }
    }

    /// Carries out what is on the board, where nobody else does; true if so.
    fn run_inline(&mut self) -> bool {
        match &mut self.executor {
            Executor::Inline(process) => {
                process.run_pending();
                true
            }
            Executor::Threads(_) | Executor::Nobody(_) => false,
        }
    }
}

impl Drop for Paging {
    fn drop(&mut self) {
        if let Executor::Threads(threads) = &mut self.executor {
            self.board.post_stop();
            for thread in threads.drain(..) {
                // It can only have failed by a panic, which has been reported by then.
                let _ = thread.join();
            }
        }
    }
}
