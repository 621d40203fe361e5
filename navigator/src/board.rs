//! The command board (the paper, 3.3.4): what the navigator wants of the I/O process.
//!
//! The board has one lock of its own, and its size is fixed. On it are
//! - the *urgent* requests, for pages that a node needs to be split now: at most a quarter as many as there are place
//!   holders, since more would only push each other out, the strongest first. One that is not asked again for
//!   [`STALE_FRAMES`] frames is dropped;
//! - the *wishes* of the last frame, pages that will probably be needed soon, the strongest first. Each frame's replace those
//!   before: what was not begun by then and is not wished again is cancelled;
//! - what *waits* for a page that is being read just now, for a parent or for a place holder.
//!
//! Whoever reads takes several commands together, urgent ones before all others, so that he can read them in the order of the
//! file; but no more than his share, so that others find something, too. The priority of a command is an error over the
//! threshold: how much better the picture would be with that page. For wishes it is the larger, the sooner the page will
//! be needed (see [`prediction`](crate::prediction)).
//!
//! A wished page that cannot be read is left alone for [`COOL_DOWN_FRAMES`] frames, and nobody is told: perhaps no
//! one ever needs it. That an urgent one cannot be read is told with the next frame.

use std::time::Duration;

use metanode::header::ModelError;
use metanode::page::PageLocation;
use parking_lot::{Condvar, Mutex};

/// Most urgent requests on the board.
const URGENT_LIMIT: usize = 256;
/// How many frames an urgent request stays without being asked again.
const STALE_FRAMES: u32 = 3;
/// For how many frames a wished page that cannot be read is not wished again.
const COOL_DOWN_FRAMES: u32 = 60;
/// Most such pages that are remembered.
const FAILED_LIMIT: usize = 64;
/// Bytes that the board takes beside the wishes, of which there are a bounded number.
pub const BOARD_BYTES: usize = 2 * URGENT_LIMIT * size_of::<Urgent>() + FAILED_LIMIT * size_of::<(u32, u32)>();

/// A page that is to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    /// Where it lies.
    pub location: PageLocation,
    /// Number of its parent, which is in use by then; `None` for the page in which a tree begins, whose ancestors need
    /// not be there.
    pub parent: Option<u32>,
}

/// What the I/O process is to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// The page that is to be read.
    pub request: Request,
    /// How much it is wanted.
    pub priority: f32,
    /// Whether a node of the front needs it to be split now.
    pub is_urgent: bool,
}

impl Command {
    /// The number of the page.
    pub fn page(&self) -> u32 {
        self.request.location.number
    }
}

#[derive(Debug, Clone, Copy)]
struct Urgent {
    command: Command,
    /// The frame in which it was last asked for.
    asked: u32,
}

#[derive(Debug)]
struct State {
    /// The weakest first.
    urgent: Vec<Urgent>,
    /// The weakest first.
    wishes: Vec<Command>,
    /// The numbers of the pages of new wishes, in their order.
    pages: Vec<u32>,
    /// What cannot be done before some page has been read.
    waiting: Vec<Command>,
    /// Commands that were taken and are not done.
    in_flight: usize,
    /// Pages that have been read, or could not be.
    loads: u64,
    frame: u32,
    stop: bool,
    failure: Option<ModelError>,
    /// Wished pages that could not be read, and in which frame.
    failed: Vec<(u32, u32)>,
}

impl State {
    fn is_idle(&self) -> bool {
        self.in_flight == 0 && self.urgent.is_empty() && self.wishes.is_empty() && self.waiting.is_empty()
    }

    /// Puts an urgent request where it belongs. Returns how many were dropped for it.
    fn insert(&mut self, urgent: Urgent, limit: usize) -> u64 {
        let weaker = |other: &Urgent| other.command.priority < urgent.command.priority;
        let place = self.urgent.partition_point(weaker);
        self.urgent.insert(place, urgent);
        if self.urgent.len() <= limit {
            return 0;
        }
        self.urgent.remove(0);
        1
    }

    fn return_to_its_list(&mut self, command: Command, limit: usize) {
        if command.is_urgent {
            let asked = self.frame;
            self.insert(Urgent { command, asked }, limit);
        } else {
            self.wishes.push(command);
        }
    }
}

/// The command board.
#[derive(Debug)]
pub struct Board {
    state: Mutex<State>,
    posted: Condvar,
    idle: Condvar,
    urgent_limit: usize,
    readers: usize,
}

impl Board {
    /// A board for a pool of so many slots, and so many who take commands.
    pub fn new(slot_count: usize, readers: usize) -> Self {
        let urgent_limit = (slot_count / 4).clamp(1, URGENT_LIMIT);
        Board {
            state: Mutex::new(State {
                urgent: Vec::with_capacity(urgent_limit + 1),
                wishes: Vec::new(),
                pages: Vec::new(),
                waiting: Vec::new(),
                in_flight: 0,
                loads: 0,
                frame: 0,
                stop: false,
                failure: None,
                failed: Vec::with_capacity(FAILED_LIMIT),
            }),
            posted: Condvar::new(),
            idle: Condvar::new(),
            urgent_limit,
            readers: readers.max(1),
        }
    }

    /// A frame begins: drops the urgent requests that nobody has asked again for long. Returns how many.
    pub fn begin_frame(&self) -> u64 {
        let mut state = self.state.lock();
        state.frame = state.frame.wrapping_add(1);
        let (frame, before) = (state.frame, state.urgent.len());
        state.urgent.retain(|urgent| frame.wrapping_sub(urgent.asked) <= STALE_FRAMES);
        state.failed.retain(|(_, since)| frame.wrapping_sub(*since) <= COOL_DOWN_FRAMES);
        (before - state.urgent.len()) as u64
    }

    /// Asks for a page, or asks again. Returns how many requests were dropped because there are too many.
    pub fn post_urgent(&self, request: Request, priority: f32) -> u64 {
        let command = Command { request, priority, is_urgent: true };
        let mut state = self.state.lock();
        if state.waiting.iter().any(|other| other.is_urgent && other.page() == command.page()) {
            return 0;
        }
        if let Some(place) = state.urgent.iter().position(|other| other.command.page() == command.page()) {
            state.urgent.remove(place);
        }
        let asked = state.frame;
        let dropped = state.insert(Urgent { command, asked }, self.urgent_limit);
        self.posted.notify_one();
        dropped
    }

    /// These are the wishes from now on, the strongest first. Returns how many of those before were cancelled.
    pub fn publish(&self, wishes: &[Command]) -> u64 {
        let mut guard = self.state.lock();
        let state = &mut *guard;
        state.pages.clear();
        state.pages.extend(wishes.iter().map(Command::page));
        state.pages.sort_unstable();
        let is_dropped = |old: &&Command| state.pages.binary_search(&old.page()).is_err();
        let cancelled = state.wishes.iter().filter(is_dropped).count() as u64;
        state.waiting.retain(|command| command.is_urgent);
        let may_be_read = |wish: &&Command| state.failed.iter().all(|(page, _)| *page != wish.page());
        state.wishes.clear();
        state.wishes.extend(wishes.iter().rev().filter(may_be_read));
        if state.wishes.is_empty() {
            if state.is_idle() {
                self.idle.notify_all();
            }
        } else {
            self.posted.notify_all();
        }
        cancelled
    }

    /// Tells all who read to end.
    pub fn post_stop(&self) {
        self.state.lock().stop = true;
        self.posted.notify_all();
    }

    /// Takes the next commands, at once, but no more than `most`. Returns how many pages have been read so far, for
    /// [`Board::put_back`].
    pub fn take(&self, most: usize, batch: &mut Vec<Command>) -> u64 {
        let mut state = self.state.lock();
        self.take_from(&mut state, most, batch);
        state.loads
    }

    /// The same as soon as there are any; `None` when it is time to end.
    pub fn wait(&self, most: usize, batch: &mut Vec<Command>) -> Option<u64> {
        let mut state = self.state.lock();
        loop {
            if state.stop {
                return None;
            }
            self.take_from(&mut state, most, batch);
            if !batch.is_empty() {
                return Some(state.loads);
            }
            self.posted.wait(&mut state);
        }
    }

    fn take_from(&self, state: &mut State, most: usize, batch: &mut Vec<Command>) {
        batch.clear();
        let share = |length: usize| most.min(length.div_ceil(self.readers));
        if state.urgent.is_empty() {
            for _ in 0..share(state.wishes.len()) {
                batch.extend(state.wishes.pop());
            }
        } else {
            for _ in 0..share(state.urgent.len()) {
                batch.extend(state.urgent.pop().map(|urgent| urgent.command));
            }
        }
        state.in_flight += batch.len();
    }

    /// So many of the commands that were taken are done.
    pub fn done(&self, count: usize) {
        let mut state = self.state.lock();
        state.in_flight -= count;
        if state.is_idle() {
            self.idle.notify_all();
        }
    }

    /// A command that was taken cannot be done before some page that was being read is there. `loads` is what
    /// [`Board::take`] said: if one has been read since, it is tried again at once.
    pub fn put_back(&self, command: Command, loads: u64) {
        let mut state = self.state.lock();
        if state.loads == loads {
            state.waiting.push(command);
        } else {
            state.return_to_its_list(command, self.urgent_limit);
            self.posted.notify_one();
        }
    }

    /// A command that was taken has to be carried on.
    pub fn carry_on(&self, command: Command) {
        self.state.lock().return_to_its_list(command, self.urgent_limit);
        self.posted.notify_one();
    }

    /// A page has been read, or could not be: what waited is tried again.
    pub fn loaded(&self) {
        let mut state = self.state.lock();
        state.loads += 1;
        while let Some(command) = state.waiting.pop() {
            state.return_to_its_list(command, self.urgent_limit);
            self.posted.notify_one();
        }
    }

    /// Notes that a page could not be read. Of the urgent ones the first failure is kept until somebody takes it.
    pub fn fail(&self, command: &Command, failure: ModelError) {
        let mut state = self.state.lock();
        if command.is_urgent {
            state.failure.get_or_insert(failure);
        } else if state.failed.len() < FAILED_LIMIT {
            let frame = state.frame;
            state.failed.push((command.page(), frame));
        }
    }

    /// Whether a failure is noted that nobody has taken yet.
    pub fn has_failure(&self) -> bool {
        self.state.lock().failure.is_some()
    }

    /// Takes the failure that was noted, if any.
    pub fn take_failure(&self) -> Option<ModelError> {
        self.state.lock().failure.take()
    }

    /// Whether everything posted has been done.
    pub fn is_idle(&self) -> bool {
        self.state.lock().is_idle()
    }

    /// Waits until everything posted has been done, but no longer than this.
    pub fn wait_until_idle(&self, longest: Duration) {
        let mut state = self.state.lock();
        self.idle.wait_while_for(&mut state, |state| !state.is_idle(), longest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(number: u32) -> Request {
        Request { location: PageLocation { number, offset: 0, length: 4 }, parent: None }
    }

    fn wish(number: u32, priority: f32) -> Command {
        Command { request: request(number), priority, is_urgent: false }
    }

    /// The pages taken together.
    fn take(board: &Board, most: usize) -> Vec<u32> {
        let mut batch = Vec::new();
        board.take(most, &mut batch);
        board.done(batch.len());
        batch.iter().map(Command::page).collect()
    }

    #[test]
    fn urgent_goes_first_the_strongest_before_others_and_nothing_twice() {
        let board = Board::new(64, 1);
        assert_eq!(board.publish(&[wish(1, 9.0), wish(2, 8.0), wish(3, 7.0)]), 0);
        for (page, priority) in [(5, 1.0), (6, 3.0), (7, 2.0), (5, 1.5)] {
            assert_eq!(board.post_urgent(request(page), priority), 0);
        }
        assert!(!board.is_idle());
        assert_eq!(take(&board, 2), [6, 7]);
        assert_eq!(take(&board, 2), [5]);
        assert_eq!(take(&board, 2), [1, 2]);
        assert!(!board.is_idle());
        assert_eq!(take(&board, 2), [3]);
        assert!(board.is_idle());
        assert!(take(&board, 2).is_empty());
        // Four for 16 slots, and the strongest of them.
        let board = Board::new(16, 1);
        assert_eq!((0..9).map(|page| board.post_urgent(request(page), page as f32)).sum::<u64>(), 5);
        assert_eq!(take(&board, 9), [8, 7, 6, 5]);
        board.post_stop();
        assert_eq!(board.wait(1, &mut Vec::new()), None);
    }

    #[test]
    fn what_nobody_wants_any_more_is_cancelled() {
        let board = Board::new(64, 1);
        board.publish(&[wish(1, 3.0), wish(2, 2.0), wish(3, 1.0)]);
        assert_eq!(take(&board, 1), [1]);
        assert_eq!(board.publish(&[wish(3, 5.0), wish(4, 4.0)]), 1);
        assert_eq!(take(&board, 9), [3, 4]);
        board.post_urgent(request(5), 1.0);
        board.post_urgent(request(6), 1.0);
        for _ in 0..STALE_FRAMES {
            assert_eq!(board.begin_frame(), 0);
            board.post_urgent(request(6), 1.0);
        }
        assert_eq!(board.begin_frame(), 1);
        assert_eq!(take(&board, 9), [6]);
        assert!(board.is_idle());
    }

    #[test]
    fn readers_share_what_there_is() {
        let board = Board::new(64, 3);
        let wishes: Vec<_> = (0..7).map(|page| wish(page, (9 - page) as f32)).collect();
        board.publish(&wishes);
        assert_eq!(take(&board, 8), [0, 1, 2]);
        assert_eq!(take(&board, 8), [3, 4]);
        assert_eq!(take(&board, 1), [5]);
        assert_eq!(take(&board, 8), [6]);
    }

    #[test]
    fn what_waits_is_tried_again_when_a_page_has_come() {
        let board = Board::new(64, 1);
        board.post_urgent(request(1), 1.0);
        board.post_urgent(request(2), 2.0);
        let mut batch = Vec::new();
        let loads = board.take(1, &mut batch);
        board.put_back(batch[0], loads);
        board.done(1);
        // Waiting for page 1, which is still being read.
        assert_eq!(take(&board, 9), [1]);
        assert!(!board.is_idle() && take(&board, 9).is_empty());
        board.loaded();
        let loads = board.take(9, &mut batch);
        assert_eq!(batch.len(), 1);
        // Another one has come meanwhile.
        board.loaded();
        board.put_back(batch[0], loads);
        board.done(1);
        assert_eq!(take(&board, 9), [2]);
        assert!(board.is_idle());
    }

    #[test]
    fn a_wished_page_that_cannot_be_read_is_left_alone_for_a_while() {
        let board = Board::new(64, 1);
        let failure = || ModelError::NotAModel { path: "model.vdt".into() };
        board.fail(&wish(1, 1.0), failure());
        assert!(board.take_failure().is_none());
        for _ in 0..COOL_DOWN_FRAMES {
            board.begin_frame();
            board.publish(&[wish(1, 1.0)]);
            assert!(board.is_idle());
        }
        board.begin_frame();
        board.publish(&[wish(1, 1.0)]);
        assert_eq!(take(&board, 9), [1]);
        board.fail(&Command { is_urgent: true, ..wish(1, 1.0) }, failure());
        assert!(board.has_failure() && board.take_failure().is_some() && !board.has_failure());
    }
}
