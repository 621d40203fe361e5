//! The navigator's side of the pool and the board: usage counts, and requests for pages that are missing. Or, where all
//! pages lie in a mapped file, the way to these (`mapped`): then the pool has no place holders, and there is nothing to ask
//! for.

use std::ops::Deref;
use std::sync::Arc;
use std::thread::JoinHandle;

use metanode::DecodedFile;
use metanode::model::Model;
use metanode::page::{Page, PageLocation};
use parking_lot::RwLockReadGuard;

use crate::board::{Board, Request};
use crate::front::{Front, Misfit, NONE};
use crate::io_process::{Io, IoProcess};
use crate::mapped::Mapped;
use crate::navigator::NavigatorError;
use crate::pool::{Hold, Pool, Use, splits_to_refer};

/// Who carries out the commands on the board.
#[derive(Debug)]
enum Executor {
    /// The navigator itself, at once.
    Inline(Box<IoProcess>),
    /// A thread; `None` once it has ended.
    Thread(Option<JoinHandle<()>>),
    /// Nobody: all pages are there.
    Nobody(Box<Mapped>),
}

/// A page in use, for as long as it is looked at.
#[derive(Debug)]
pub enum PageInUse<'a> {
    /// In a place holder.
    Held(RwLockReadGuard<'a, Page>),
    /// In a mapped file.
    Mapped(&'a Page),
}

impl Deref for PageInUse<'_> {
    type Target = Page;

    fn deref(&self) -> &Page {
        match self {
            PageInUse::Held(page) => page,
            PageInUse::Mapped(page) => page,
        }
    }
}

/// The way from the nodes of a front to their pages.
#[derive(Debug)]
pub struct Paging {
    model: Arc<Model>,
    pool: Arc<Pool>,
    board: Arc<Board>,
    executor: Executor,
    /// The page in each place holder that is in use.
    page_of_slot: Vec<u32>,
}

impl Paging {
    /// Fills a pool with the root pages and their children, and starts the I/O process.
    pub fn start(
        model: Arc<Model>,
        slots: usize,
        io: Io,
        prefetch: bool,
        second_chance: bool,
    ) -> Result<Self, NavigatorError> {
        let pages = (0..slots).map(|_| model.empty_page()).collect();
        let pool = Arc::new(Pool::new(pages, second_chance));
        let board = Arc::new(Board::new(slots));
        let mut process = IoProcess::new(model.clone(), pool.clone(), board.clone(), prefetch);
        process.load_roots(model.root_pages());
        if let Some(failure) = board.take_failure() {
            return Err(failure.into());
        }
        let executor = match io {
            Io::Sync => Executor::Inline(Box::new(process)),
            Io::Thread => {
                let thread = process.run_in_thread().map_err(|source| NavigatorError::Thread { source })?;
                Executor::Thread(Some(thread))
            }
        };
        Ok(Paging { model, pool, board, executor, page_of_slot: vec![NONE; slots] })
    }

    /// The way to pages that lie in a mapped file.
    pub fn mapped(model: Arc<Model>, decoded: DecodedFile) -> Self {
        let mapped = Mapped::new(decoded);
        let page_of_slot = (0..mapped.page_count() as u32).collect();
        let (pool, board) = (Arc::new(Pool::new(Vec::new(), false)), Arc::new(Board::new(0)));
        Paging { model, pool, board, executor: Executor::Nobody(Box::new(mapped)), page_of_slot }
    }

    /// The pool.
    pub fn pool(&self) -> &Pool {
        &self.pool
    }

    /// The board.
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// The page in a place holder that is in use.
    pub fn page(&self, slot: u32) -> PageInUse<'_> {
        match &self.executor {
            Executor::Nobody(mapped) => PageInUse::Mapped(mapped.page(slot)),
            _ => PageInUse::Held(self.pool.page(slot)),
        }
    }

    /// The ancestors of the page in a place holder that is in use, from the root page down to its parent.
    pub fn ancestors(&self, slot: u32) -> Vec<Page> {
        match &self.executor {
            Executor::Nobody(mapped) => mapped.ancestors(slot),
            _ => self.pool.ancestors(slot).iter().map(|page| Page::clone(page)).collect(),
        }
    }

    /// Number of place holders.
    pub fn slot_count(&self) -> usize {
        self.page_of_slot.len()
    }

    /// How many splits of the page in a place holder are applied.
    pub fn usage(&self, slot: u32) -> u32 {
        match &self.executor {
            Executor::Nobody(mapped) => mapped.usage(slot),
            _ => self.pool.usage(slot),
        }
    }

    /// Place holders whose page is in use.
    pub fn in_use(&self) -> usize {
        match &self.executor {
            Executor::Nobody(mapped) => mapped.in_use(),
            _ => self.pool.in_use(),
        }
    }

    /// Number of the page in a place holder that is in use.
    pub fn page_number(&self, slot: u32) -> u32 {
        self.page_of_slot[slot as usize]
    }

    /// Counts the use of the page that the split of an active node is in. A missing page is asked for urgently.
    pub fn begin_use(&mut self, front: &Front, node: u32) -> Use {
        let page = front.page_or_slot(node);
        if let Executor::Nobody(mapped) = &mut self.executor {
            return if mapped.begin_use(page) { Use::Granted { slot: page } } else { Use::Refused };
        }
        let parent = front.parent(node);
        if parent != NONE {
            // Most often the parent's split is in the same page, which is therefore in use.
            let slot = front.page_or_slot(parent);
            if self.page_of_slot[slot as usize] == page {
                self.pool.use_again(slot);
                return Use::Granted { slot };
            }
        }
        // The parent's page is in use, and its ancestors are there. Who has no parent may have to have them brought in.
        let way = if parent == NONE { self.model.way_to(page) } else { Vec::new() };
        let mut found = self.pool.use_page(page, &way);
        if found == Use::Missing {
            let above = (parent != NONE).then(|| self.page_of_slot[front.page_or_slot(parent) as usize]);
            let request = Request { location: self.location(front, node), parent: above };
            self.board.post_urgent(request);
            if self.run_inline() {
                found = self.pool.use_page(page, &way);
                if found == Use::Missing {
                    // What else is held is for later; this page is used now.
                    self.pool.end_all_holds();
                    self.board.post_urgent(request);
                    self.run_inline();
                    found = self.pool.use_page(page, &way);
                }
            }
        }
        if let Use::Granted { slot } = found {
            self.page_of_slot[slot as usize] = page;
        }
        found
    }

    /// The use begun before has led to a split.
    pub fn confirm_use(&mut self, slot: u32) {
        if let Executor::Nobody(_) = &self.executor {
            return;
        }
        if self.pool.usage(slot) == splits_to_refer(&self.pool.page(slot)) {
            self.board.post_change(slot);
            self.run_inline();
        }
    }

    /// The use begun before has led to nothing, as yet.
    pub fn cancel_use(&mut self, slot: u32) {
        if let Executor::Nobody(mapped) = &mut self.executor {
            return mapped.end_use(slot);
        }
        if self.pool.stop_using(slot, Hold::Keep) {
            self.page_of_slot[slot as usize] = NONE;
        }
    }

    /// A split of the page in this place holder was undone.
    pub fn end_use(&mut self, slot: u32, hold: Hold) {
        if let Executor::Nobody(mapped) = &mut self.executor {
            return mapped.end_use(slot);
        }
        if self.pool.stop_using(slot, hold) {
            self.page_of_slot[slot as usize] = NONE;
            self.board.post_change(slot);
            self.run_inline();
        }
    }

    /// An error that names the file and the page that does not fit.
    pub fn misfit(&self, page: u32, source: Misfit) -> NavigatorError {
        NavigatorError::Misfit { path: self.model.path().into(), page, source }
    }

    /// Where the page lies that the split of an active node is in.
    pub fn location(&self, front: &Front, node: u32) -> PageLocation {
        match front.parent(node) {
            // The roots are the first nodes of the front, in their order.
            NONE => self.model.roots()[node as usize].page,
            parent => {
                let page = self.page(front.page_or_slot(parent));
                let child = front.page_or_slot(node).wrapping_sub(page.child_location(0).number);
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
            Executor::Thread(_) | Executor::Nobody(_) => false,
        }
    }
}

impl Drop for Paging {
    fn drop(&mut self) {
        if let Executor::Thread(thread) = &mut self.executor {
            self.board.post_stop();
            if let Some(thread) = thread.take() {
                // It can only have failed by a panic, which has been reported by then.
                let _ = thread.join();
            }
        }
    }
}
