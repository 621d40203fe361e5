//! The navigator's side of the pool and the board: usage counts, and requests for pages that are missing.

use std::sync::Arc;
use std::thread::JoinHandle;

use metanode::model::Model;
use metanode::page::{Page, PageLocation};
use parking_lot::RwLockReadGuard;

use crate::board::{Board, Request};
use crate::front::{Front, Misfit, NONE};
use crate::io_process::{Io, IoProcess};
use crate::navigator::NavigatorError;
use crate::pool::{Hold, Pool, Use, splits_to_refer};

/// Who carries out the commands on the board.
#[derive(Debug)]
enum Executor {
    /// The navigator itself, at once.
    Inline(Box<IoProcess>),
    /// A thread; `None` once it has ended.
    Thread(Option<JoinHandle<()>>),
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

    /// The pool.
    pub fn pool(&self) -> &Pool {
        &self.pool
    }

    /// The board.
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// The page in a place holder that is in use.
    pub fn page(&self, slot: u32) -> RwLockReadGuard<'_, Page> {
        self.pool.page(slot)
    }

    /// Number of the page in a place holder that is in use.
    pub fn page_number(&self, slot: u32) -> u32 {
        self.page_of_slot[slot as usize]
    }

    /// Counts the use of the page that the split of the active node at a vertex is in. A missing page is asked for urgently.
    pub fn begin_use(&mut self, front: &Front, vertex: u32) -> Use {
        let (page, _) = front.place(vertex);
        let above = front.slot_above(vertex);
        if above != NONE {
            // Most often the parent's split is in the same page, which is therefore in use.
            let slot = above;
            if self.page_of_slot[slot as usize] == page {
                self.pool.use_again(slot);
                return Use::Granted { slot };
            }
        }
        // The parent's page is in use, and its ancestors are there. Who has no parent may have to have them brought in.
        let way = if above == NONE { self.model.way_to(page) } else { Vec::new() };
        let mut found = self.pool.use_page(page, &way);
        if found == Use::Missing {
            let parent = (above != NONE).then(|| self.page_of_slot[above as usize]);
            let request = Request { location: self.location(front, vertex), parent };
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
        if self.pool.usage(slot) == splits_to_refer(&self.pool.page(slot)) {
            self.board.post_change(slot);
            self.run_inline();
        }
    }

    /// The use begun before has led to nothing, as yet.
    pub fn cancel_use(&mut self, slot: u32) {
        if self.pool.stop_using(slot, Hold::Keep) {
            self.page_of_slot[slot as usize] = NONE;
        }
    }

    /// A split of the page in this place holder was undone.
    pub fn end_use(&mut self, slot: u32, hold: Hold) {
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

    /// Where the page lies that the split of the active node at a vertex is in.
    pub fn location(&self, front: &Front, vertex: u32) -> PageLocation {
        match front.slot_above(vertex) {
            // The roots are the first vertices of the front, in their order.
            NONE => self.model.roots()[vertex as usize].page,
            above => {
                let page = self.pool.page(above);
                let child = front.place(vertex).0.wrapping_sub(page.child_location(0).number);
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
            Executor::Thread(_) => false,
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
