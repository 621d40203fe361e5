//! Work on many jobs by a few threads, each with a workspace of its own.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Does the jobs `0..count`, each by whichever workspace is free, and returns what they came to, in order. After a
/// failure no job is begun any more, and the first failure is returned.
pub fn for_each<W: Send, R: Send, E: Send>(
    workspaces: &mut [W],
    count: usize,
    work: impl Fn(&mut W, usize) -> Result<R, E> + Sync,
) -> Result<Vec<R>, E> {
    let next = AtomicUsize::new(0);
    let failed = AtomicBool::new(false);
    let results: Mutex<Vec<(usize, Result<R, E>)>> = Mutex::new(Vec::with_capacity(count));
    let run = |workspace: &mut W| {
        while !failed.load(Ordering::Relaxed) {
            let job = next.fetch_add(1, Ordering::Relaxed);
            if job >= count {
                return;
            }
            let result = work(workspace, job);
            failed.fetch_or(result.is_err(), Ordering::Relaxed);
            results.lock().unwrap_or_else(PoisonError::into_inner).push((job, result));
        }
    };
    if let [first, others @ ..] = workspaces {
        std::thread::scope(|scope| {
            for workspace in others {
                scope.spawn(|| run(workspace));
            }
            run(first);
        });
    }
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_unstable_by_key(|(job, _)| *job);
    results.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::for_each;

    #[test]
    fn results_come_in_order_and_the_first_failure_counts() {
        for threads in 1..4 {
            let mut workspaces = vec![0_usize; threads];
            let squares = for_each(&mut workspaces, 100, |done, job| {
                *done += 1;
                Ok::<_, usize>(job * job)
            });
            assert_eq!(squares.unwrap(), (0..100).map(|job| job * job).collect::<Vec<_>>());
            assert_eq!(workspaces.iter().sum::<usize>(), 100);
            let failure = for_each(&mut workspaces, 100, |_, job| if job < 40 { Ok(()) } else { Err(job) });
            assert!(failure.unwrap_err() >= 40);
        }
        assert!(for_each(&mut [()], 0, |(), _| Ok::<_, ()>(())).unwrap().is_empty());
    }
}
