//! Reads and writes of scratch files beside the computation: while a store computes with one buffer, the other is on its
//! way to or from the disk.
//!
//! A few threads take jobs from one queue; they do nothing but wait for the disk, so they take next to no time of the
//! processor, and several of them since a disk does more with several requests at once (facts: 64 KiB direct reads, 5,400 a
//! second one at a time, 12,000 with eight). They begin with the first job and end with the [`crate::Scratch`].

use std::fmt;
use std::io;
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, PoisonError};

/// How many jobs are under way at once.
const THREADS: usize = 4;

type Job = Box<dyn FnOnce() + Send>;

/// The queue of jobs; its threads end with it.
pub(crate) struct Background {
    queue: Mutex<Option<Sender<Job>>>,
}

impl Background {
    /// Without a thread as yet.
    pub fn new() -> Self {
        Background { queue: Mutex::new(None) }
    }

    /// Has a thread do `job`.
    ///
    /// # Errors
    ///
    /// Where the system has no thread to give.
    pub fn begin<R: Send + 'static>(&self, job: impl FnOnce() -> R + Send + 'static) -> io::Result<Task<R>> {
        let (sender, result) = mpsc::sync_channel(1);
        let job: Job = Box::new(move || {
            // Whoever asked may be gone: then nobody needs it.
            let _ = sender.send(job());
        });
        let mut queue = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        let queue = match &mut *queue {
            Some(queue) => queue,
            none => none.insert(start()?),
        };
        queue.send(job).map_err(|_| io::Error::other("the threads for reading and writing have ended"))?;
        Ok(Task { result: Mutex::new(result) })
    }
}

/// Starts the threads, which end when the sender is gone.
fn start() -> io::Result<Sender<Job>> {
    let (queue, jobs) = mpsc::channel::<Job>();
    let jobs = Arc::new(Mutex::new(jobs));
    for _ in 0..THREADS {
        let jobs = jobs.clone();
        std::thread::Builder::new().name("scratch".into()).stack_size(128 << 10).spawn(move || {
            while let Some(job) = next(&jobs) {
                job();
            }
        })?;
    }
    Ok(queue)
}

fn next(jobs: &Mutex<Receiver<Job>>) -> Option<Job> {
    // One waits for the queue, the others for the lock; either way it is the next job.
    jobs.lock().unwrap_or_else(PoisonError::into_inner).recv().ok()
}

impl fmt::Debug for Background {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Background")
    }
}

/// A job that is under way.
#[derive(Debug)]
pub(crate) struct Task<R> {
    /// Behind a lock so that threads may share what it is a part of.
    result: Mutex<Receiver<R>>,
}

impl<R> Task<R> {
    /// Waits until it is done.
    ///
    /// # Errors
    ///
    /// Where its thread ended before.
    pub fn wait(self) -> io::Result<R> {
        let result = self.result.into_inner().unwrap_or_else(PoisonError::into_inner);
        result.recv().map_err(|_| io::Error::other("the thread for reading and writing has ended"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jobs_are_done_beside_each_other_and_without_anybody_waiting() {
        let background = Background::new();
        // Each waits for the next one, so that in one thread they would wait for ever.
        let (first, second) = (mpsc::channel(), mpsc::channel());
        let waits = background.begin(move || first.1.recv().unwrap() + 1).unwrap();
        let answers = background.begin(move || second.1.recv().unwrap() + 1).unwrap();
        drop(background.begin(move || second.0.send(1).unwrap()).unwrap());
        first.0.send(answers.wait().unwrap()).unwrap();
        assert_eq!(waits.wait().unwrap(), 3);
    }
}
