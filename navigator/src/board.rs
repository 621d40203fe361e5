//! The command board (the paper, 3.3.4): what the navigator wants of the I/O process.
//!
//! The board has one lock of its own, and its size is fixed. Urgent requests go first, at most a quarter as many as
//! there are place holders: more would only push each other out. Pages that came into use, or went out of it, are noted
//! by their place holder, each once however often that happened in between: the I/O process looks up what holds when it
//! comes to it.

use std::collections::VecDeque;
use std::time::Duration;

use metanode::header::ModelError;
use metanode::page::PageLocation;
use parking_lot::{Condvar, Mutex};

/// Most urgent requests on the board.
const URGENT_LIMIT: usize = 256;

/// A page that a node of the front needs to be split.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    /// Where it lies.
    pub location: PageLocation,
    /// Number of its parent, which is in use by then; `None` for the page in which a tree begins, whose ancestors need
    /// not be there.
    pub parent: Option<u32>,
}

/// What the I/O process is to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Load a page that a node of the front needs to be split.
    Urgent(Request),
    /// The page in this place holder came into use, or went out of it: prefetch its parent and its children, or let go
    /// of them.
    Follow {
        /// The place holder.
        slot: u32,
    },
    /// End.
    Stop,
}

#[derive(Debug)]
struct State {
    urgent: VecDeque<Request>,
    /// The page that is being loaded urgently.
    loading: Option<u32>,
    changed: VecDeque<u32>,
    is_noted: Vec<bool>,
    stop: bool,
    busy: bool,
    failure: Option<ModelError>,
}

/// The command board.
#[derive(Debug)]
pub struct Board {
    state: Mutex<State>,
    posted: Condvar,
    idle: Condvar,
    urgent_limit: usize,
}

impl Board {
    /// A board for a pool of so many slots.
    pub fn new(slot_count: usize) -> Self {
        let urgent_limit = (slot_count / 4).clamp(1, URGENT_LIMIT);
        Board {
            state: Mutex::new(State {
                urgent: VecDeque::with_capacity(urgent_limit),
                loading: None,
                changed: VecDeque::with_capacity(slot_count),
                is_noted: vec![false; slot_count],
                stop: false,
                busy: false,
                failure: None,
            }),
            posted: Condvar::new(),
            idle: Condvar::new(),
            urgent_limit,
        }
    }

    /// Asks for a page, unless it is asked for already or too many are.
    pub fn post_urgent(&self, request: Request) {
        let mut state = self.state.lock();
        let number = request.location.number;
        let asked_for =
            state.loading == Some(number) || state.urgent.iter().any(|other| other.location.number == number);
        if !asked_for && state.urgent.len() < self.urgent_limit {
            state.urgent.push_back(request);
            self.posted.notify_one();
        }
    }

    /// Says that the page in a place holder came into use or went out of it.
    pub fn post_change(&self, slot: u32) {
        let mut state = self.state.lock();
        if !std::mem::replace(&mut state.is_noted[slot as usize], true) {
            state.changed.push_back(slot);
            self.posted.notify_one();
        }
    }

    /// Tells the I/O process to end.
    pub fn post_stop(&self) {
        self.state.lock().stop = true;
        self.posted.notify_one();
    }

    /// The next command, at once; `None` when there is none. What was taken before counts as done.
    pub fn take(&self) -> Option<Command> {
        self.take_from(&mut self.state.lock())
    }

    /// The next command, as soon as there is one. What was taken before counts as done.
    pub fn wait(&self) -> Command {
        let mut state = self.state.lock();
        loop {
            if let Some(command) = self.take_from(&mut state) {
                return command;
            }
            self.posted.wait(&mut state);
        }
    }

    fn take_from(&self, state: &mut State) -> Option<Command> {
        state.loading = None;
        let command = if state.stop {
            Some(Command::Stop)
        } else if let Some(request) = state.urgent.pop_front() {
            state.loading = Some(request.location.number);
            Some(Command::Urgent(request))
        } else if let Some(slot) = state.changed.pop_front() {
            state.is_noted[slot as usize] = false;
            Some(Command::Follow { slot })
        } else {
            None
        };
        state.busy = command.is_some();
        if !state.busy {
            self.idle.notify_all();
        }
        command
    }

    /// Notes that a page could not be read; the first such failure is kept until somebody takes it.
    pub fn fail(&self, failure: ModelError) {
        self.state.lock().failure.get_or_insert(failure);
    }

    /// Takes the failure that was noted, if any.
    pub fn take_failure(&self) -> Option<ModelError> {
        self.state.lock().failure.take()
    }

    /// Whether everything posted has been done.
    pub fn is_idle(&self) -> bool {
        let state = self.state.lock();
        !state.busy && state.urgent.is_empty() && state.changed.is_empty()
    }

    /// Waits until everything posted has been done, but no longer than this.
    pub fn wait_until_idle(&self, longest: Duration) {
        let mut state = self.state.lock();
        let is_busy = |state: &mut State| state.busy || !state.urgent.is_empty() || !state.changed.is_empty();
        self.idle.wait_while_for(&mut state, is_busy, longest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(number: u32) -> Request {
        Request { location: PageLocation { number, offset: 0, length: 4 }, parent: None }
    }

    #[test]
    fn urgent_goes_first_and_nothing_is_queued_twice() {
        let board = Board::new(16);
        board.post_change(3);
        board.post_change(3);
        board.post_urgent(request(7));
        board.post_urgent(request(7));
        assert!(!board.is_idle());
        assert_eq!(board.take(), Some(Command::Urgent(request(7))));
        // Still being loaded.
        board.post_urgent(request(7));
        assert_eq!(board.take(), Some(Command::Follow { slot: 3 }));
        board.post_change(3);
        assert_eq!(board.take(), Some(Command::Follow { slot: 3 }));
        assert!(!board.is_idle());
        assert_eq!(board.take(), None);
        assert!(board.is_idle());
        // Four for 16 slots.
        (0..9).for_each(|number| board.post_urgent(request(number)));
        assert_eq!((0..9).filter(|_| board.take().is_some()).count(), 4);
        board.post_change(0);
        board.post_stop();
        assert_eq!(board.wait(), Command::Stop);
    }
}
