//! The I/O process (the paper, 3.3.2 and 3.3.4): takes commands from the board, reads pages into place holders, and
//! keeps the reference counts. A thread of its own, beside the navigator's; or carried out at once by the navigator, so
//! that a flight is the same each time.
//!
//! When nine of ten splits of a page are applied its parent and its children are prefetched, each into a free place holder, as
//! long as there are any. (The paper does so as soon as a page comes into use. Its meta-nodes have few levels; the splits of ours
//! reach over several octaves of error, so children are mostly far off then. Bytes read over those of the records used, misses,
//! and CPU time of a frame, on a flight over srtm at 1 pixel in 48 MB: from the first split on 5.6, 1.4 %, 7.4 ms; from half of
//! them on 4.8, 1.5 %, 6.2 ms; from nine of ten on 3.4, 1.2 %, 5.7 ms. In 16 MB 8.1, 6.4 and 5.5 times.)
//!
//! A page is loaded below its parent only (see [`pool`](crate::pool)). Most often that one is there: the split that asks
//! for the page follows one in the parent page. Where the parent has gone meanwhile, so has the node that asked, and the
//! request is dropped. Only the page in which a tree begins is asked for by somebody without a parent; what is missing of
//! the way to it is loaded first, from the root page down.
//!
//! What cannot be read is noted on the board. The navigator's next frame finds it there.

use std::sync::Arc;
use std::thread::JoinHandle;

use metanode::model::{Model, PageReader};
use metanode::page::{Page, PageLocation};

use crate::board::{Board, Command, Request};
use crate::pool::{Pool, Room};

/// How the I/O process runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Io {
    /// As a thread of its own; the navigator never waits for the disk.
    #[default]
    Thread,
    /// Within the navigator's frames, which wait for every page they want.
    Sync,
}

/// Whether there is no page in the place holder: not read yet, or in vain.
fn is_empty(page: &Page) -> bool {
    page.counts().records == 0
}

/// The I/O process: what it needs to carry out a command.
#[derive(Debug)]
pub struct IoProcess {
    model: Arc<Model>,
    pool: Arc<Pool>,
    board: Arc<Board>,
    prefetch: bool,
    /// The encoded page that is being decoded.
    reader: PageReader,
}

impl IoProcess {
    /// An I/O process that reads pages of `model` into `pool` as `board` says.
    pub fn new(model: Arc<Model>, pool: Arc<Pool>, board: Arc<Board>, prefetch: bool) -> Self {
        let reader = PageReader::default();
        IoProcess { model, pool, board, prefetch, reader }
    }

    /// Carries out everything on the board.
    pub fn run_pending(&mut self) {
        while let Some(command) = self.board.take() {
            self.execute(command);
        }
    }

    /// Carries out commands, in a thread of its own, until told to stop.
    pub fn run_in_thread(mut self) -> std::io::Result<JoinHandle<()>> {
        std::thread::Builder::new().name("vdt-io".into()).spawn(move || {
            loop {
                match self.board.wait() {
                    Command::Stop => return,
                    command => self.execute(command),
                }
            }
        })
    }

    fn execute(&mut self, command: Command) {
        match command {
            Command::Urgent(request) => self.load_urgently(request),
            Command::Follow { slot } => self.follow(slot, false),
            Command::Stop => (),
        }
    }

    /// Loads a page that a node needs, and before it what is missing of the way to the page of a tree.
    fn load_urgently(&mut self, Request { location, parent }: Request) {
        let mut parent = parent;
        let way = if parent.is_none() { self.model.way_to(location.number) } else { Vec::new() };
        for above in way {
            self.load(self.pool.make_room(above.number, parent), above);
            parent = Some(above.number);
        }
        self.load(self.pool.make_room(location.number, parent), location);
    }

    /// The start: loads root pages, into at most half of the place holders, and prefetches their children. The roots
    /// are always there to refer to these pages, so they are given up only to urgent ones.
    pub fn load_roots(&mut self, locations: &[PageLocation]) {
        let mut slots = Vec::new();
        for location in locations.iter().take(self.pool.slot_count() / 2) {
            let room = self.pool.reference(location.number, None);
            self.load(room, *location);
            if let Room::Slot { slot, .. } = room {
                slots.push(slot);
            }
        }
        for slot in slots {
            self.follow(slot, true);
        }
    }

    /// Brings the reference counts of the neighbours of the page in `slot` up to date.
    fn follow(&mut self, slot: u32, always: bool) {
        match self.pool.update_references(slot, always) {
            Some(true) if self.prefetch => self.refer(slot),
            Some(false) if self.prefetch => self.stop_referring(slot, None),
            _ => (),
        }
    }

    fn refer(&mut self, slot: u32) {
        let (number, parent, children) = {
            let page = self.pool.page(slot);
            if is_empty(&page) {
                return;
            }
            (page.number(), page.parent(), page.counts().children)
        };
        if let Some(parent) = parent {
            self.pool.reference_if_resident(parent);
        }
        for child in 0..children {
            let location = {
                let page = self.pool.page(slot);
                // Not in use any more, it may have made room for its own child.
                if is_empty(&page) || page.number() != number {
                    return;
                }
                page.child_location(child)
            };
            self.load(self.pool.reference(location.number, Some(number)), location);
        }
    }

    /// Takes back the references of the page that is or was last in `slot`; but none to `newcomer`.
    fn stop_referring(&mut self, slot: u32, newcomer: Option<u32>) {
        let page = self.pool.page(slot);
        if is_empty(&page) {
            return;
        }
        let neighbours = page.parent().into_iter().chain(page.children().map(|location| location.number));
        for neighbour in neighbours.filter(|neighbour| Some(*neighbour) != newcomer) {
            self.pool.dereference(neighbour);
        }
    }

    fn load(&mut self, room: Room, location: PageLocation) {
        let Room::Slot { slot, refers } = room else { return };
        if refers && self.prefetch {
            self.stop_referring(slot, Some(location.number));
        }
        let read = self.model.read_encoded(location, &mut self.reader).and_then(|()| {
            let above = self.pool.ancestors(slot);
            let ancestors: Vec<&Page> = above.iter().map(|page| &**page).collect();
            self.model.decode(location, &ancestors, &mut self.reader, &mut self.pool.page_to_fill(slot))
        });
        self.pool.loaded(slot, read.is_ok().then_some(location.length));
        if let Err(failure) = read {
            self.board.fail(failure);
        }
    }
}
