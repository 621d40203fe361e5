//! The I/O process (the paper, 3.3.2 and 3.3.4): takes commands from the board, reads pages into place holders and decodes
//! them. A few threads beside the navigator's, so that there are several reads in flight and several pages being decoded; or
//! carried out at once by the navigator, so that a flight is the same each time.
//!
//! Who takes commands takes a few together, finds place holders for them, and reads them in the order of the file, those that
//! lie near each other in one go. Then he decodes one after the other; siblings lie together, and what a decoder knows of
//! their ancestors holds for all of them. No lock is held meanwhile.
//!
//! A page is loaded below its parent only (see [`pool`](crate::pool)). Most often that one is there: the split that asks
//! for the page follows one in the parent page. Where the parent has gone meanwhile, so has the node that asked, and the
//! request is dropped. Only the page in which a tree begins is asked for by somebody without a parent; what is missing of
//! the way to it is loaded first, from the root page down. Where a page of the way, or the only place holder that there is,
//! is just being filled, the command waits for that.
//!
//! What cannot be read, or is not what was written, is tried again three times, after pauses that grow: sources that are
//! far away fail now and then. Then it counts as failed, and is noted on the board. The navigator's next frame finds it there.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use metanode::model::{Model, PageReader};
use metanode::page::{Page, PageLocation};
use storage::Block;

use crate::board::{Board, Command, Request};
use crate::pool::{Filling, Pool, Room};

/// Most commands that are taken together.
const MOST_TOGETHER: usize = 8;
/// Most bytes between two pages that are read in one go: to read so many costs no more than to begin another read.
const MOST_BETWEEN: u64 = 16 << 10;
/// Most bytes of a read of more than one page.
const MOST_IN_ONE_READ: u64 = 128 << 10;
/// How long to wait before a read is tried again. (Tests try often.)
const PAUSES: [Duration; 3] = if cfg!(test) {
    [Duration::from_micros(20); 3]
} else {
    [Duration::from_millis(1), Duration::from_millis(4), Duration::from_millis(16)]
};

/// How the I/O process runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Io {
    /// As threads of its own; the navigator never waits for the disk.
    #[default]
    Thread,
    /// Within the navigator's frames, which wait for every page they want.
    Sync,
}

/// Bytes that who reads needs, with at most so many records on the way from a root page of this model down to a page: the bytes
/// read, twice where they are read directly, those of a page that is read again, what the decoder knows of the records, and
/// references to the pages.
pub fn reader_bytes(model: &Model, records_on_a_way: usize) -> usize {
    let (largest, levels) = (model.header().largest_page_bytes as usize, model.header().page_levels as usize);
    let read = (MOST_IN_ONE_READ as usize).min(MOST_TOGETHER * (largest + MOST_BETWEEN as usize)).max(largest);
    let direct = if model.is_direct() { read + 2 * Block::BYTES } else { 0 };
    let commands = MOST_TOGETHER * (size_of::<Command>() + 2 * size_of::<Job>() + levels * size_of::<Arc<Page>>());
    read + direct + largest + commands + records_on_a_way * DECODER_BYTES_PER_RECORD
}

/// What a decoder takes for each record of a page and its ancestors.
const DECODER_BYTES_PER_RECORD: usize = 300;

/// A page that is to be read.
#[derive(Debug)]
struct Job {
    location: PageLocation,
    filling: Filling,
    command: Command,
}

/// What is to be done for a command next.
enum Step {
    /// This page is to be read.
    Read(Job),
    /// It has to wait for a page that is being read.
    Wait,
    /// Nothing.
    Done,
}

/// One of those who read: what he needs to carry out commands.
#[derive(Debug)]
pub struct IoProcess {
    model: Arc<Model>,
    pool: Arc<Pool>,
    board: Arc<Board>,
    most_together: usize,
    commands: Vec<Command>,
    jobs: Vec<Job>,
    /// What was read in one go.
    bytes: Vec<u8>,
    reader: PageReader,
}

impl IoProcess {
    /// Reads pages of `model` into `pool` as `board` says.
    pub fn new(model: Arc<Model>, pool: Arc<Pool>, board: Arc<Board>) -> Self {
        // Place holders that are being filled are of no use to anybody.
        let most_together = (pool.slot_count() / 16).clamp(1, MOST_TOGETHER);
        IoProcess {
            model,
            pool,
            board,
            most_together,
            commands: Vec::with_capacity(most_together),
            jobs: Vec::with_capacity(most_together),
            bytes: Vec::new(),
            reader: PageReader::default(),
        }
    }

    /// Carries out everything on the board.
    pub fn run_pending(&mut self) {
        loop {
            let loads = self.board.take(self.most_together, &mut self.commands);
            if self.commands.is_empty() {
                return;
            }
            self.execute(loads);
        }
    }

    /// Carries out commands, in a thread of its own, until told to stop.
    pub fn run_in_thread(mut self) -> std::io::Result<JoinHandle<()>> {
        std::thread::Builder::new().name("vdt-io".into()).spawn(move || {
            while let Some(loads) = self.board.wait(self.most_together, &mut self.commands) {
                self.execute(loads);
            }
        })
    }

    /// The start: loads root pages, into at most half of the place holders.
    pub fn load_roots(&mut self) {
        for location in self.model.clone().root_pages().iter().take(self.pool.slot_count() / 2) {
            let request = Request { location: *location, parent: None };
            self.board.post_urgent(request, 0.0);
            self.run_pending();
        }
        self.pool.end_all_holds();
    }

    /// Carries out the commands that were taken.
    fn execute(&mut self, loads: u64) {
        let mut jobs = std::mem::take(&mut self.jobs);
        for command in &self.commands {
            match self.next_step(command) {
                Step::Read(job) => jobs.push(job),
                Step::Wait => self.board.put_back(*command, loads),
                Step::Done => (),
            }
        }
        jobs.sort_unstable_by_key(|job| job.location.offset);
        let mut rest = jobs.drain(..).peekable();
        while let Some(first) = rest.next() {
            let start = first.location.offset;
            let mut run = vec![first];
            let mut end = run_end(&run[0].location, start);
            while let Some(next) = rest.next_if(|next| {
                next.location.offset <= end + MOST_BETWEEN && run_end(&next.location, start) <= start + MOST_IN_ONE_READ
            }) {
                end = end.max(run_end(&next.location, start));
                run.push(next);
            }
            self.read_run(start, end, run);
        }
        drop(rest);
        self.jobs = jobs;
        self.board.done(self.commands.len());
    }

    /// Finds out which page is to be read for a command, of what is missing of the way to it, and makes room for that.
    fn next_step(&self, command: &Command) -> Step {
        let Request { location, mut parent } = command.request;
        let way = if parent.is_none() { self.model.way_to(location.number) } else { Vec::new() };
        for location in way.into_iter().chain([location]) {
            let room = if command.is_urgent {
                self.pool.make_room(location.number, parent)
            } else {
                self.pool.prefetch(location.number, parent, command.priority)
            };
            match room {
                Room::Resident => parent = Some(location.number),
                Room::Slot(filling) => return Step::Read(Job { location, filling, command: *command }),
                Room::Later => return Step::Wait,
                Room::None => return Step::Done,
            }
        }
        Step::Done
    }

    /// Reads pages that lie from `start` to `end` in the file, and decodes them.
    fn read_run(&mut self, start: u64, end: u64, run: Vec<Job>) {
        let mut bytes = std::mem::take(&mut self.bytes);
        let are_inside = run.iter().all(|job| self.model.check_location(job.location).is_ok());
        let is_read = are_inside && {
            bytes.resize((end - start) as usize, 0);
            self.model.read_bytes(start, &mut bytes).is_ok()
        };
        for job in run {
            let first = (job.location.offset - start) as usize;
            let encoded = is_read.then(|| &bytes[first..first + job.location.length as usize]);
            self.load(job, encoded);
        }
        self.bytes = bytes;
    }

    /// Decodes a page, from the bytes that were read; or reads it once more, and again.
    fn load(&mut self, job: Job, encoded: Option<&[u8]>) {
        let Job { location, filling: Filling { slot, mut page, ancestors }, command } = job;
        // Nobody else has it; and if somebody did, this would leave it to him.
        let to_fill = Arc::make_mut(&mut page);
        let above: Vec<&Page> = ancestors.iter().map(|page| &**page).collect();
        let inside = self.model.check_location(location);
        let tries = if inside.is_ok() { PAUSES.len() } else { 0 };
        // Where several pages were to be read and could not be, nobody knows which of them it was.
        let mut outcome = match (inside, encoded) {
            (Err(failure), _) => Err(Some(failure)),
            (Ok(()), Some(encoded)) => {
                self.model.decode(location, encoded, &above, &mut self.reader, to_fill).map_err(Some)
            }
            (Ok(()), None) => Err(None),
        };
        for pause in PAUSES.into_iter().take(tries) {
            // Where the disk fails for good, only the first page takes so long. The others are asked for again, if need be.
            if outcome.is_ok() || self.board.has_failure() {
                break;
            }
            self.pool.count(|counters| counters.retries += 1);
            std::thread::sleep(pause);
            outcome = self.model.read_page(location, &above, &mut self.reader, to_fill).map_err(Some);
        }
        drop(above);
        drop(ancestors);
        self.pool.loaded(slot, page, outcome.is_ok().then_some(location.length));
        match outcome {
            Ok(()) if location != command.request.location => self.board.carry_on(command),
            Err(Some(failure)) => self.board.fail(&command, failure),
            Ok(()) | Err(None) => (),
        }
        self.board.loaded();
    }
}

/// Where a page ends; no nearer than `start`, whatever a damaged file says.
fn run_end(location: &PageLocation, start: u64) -> u64 {
    location.offset.saturating_add(location.length.into()).max(start)
}
