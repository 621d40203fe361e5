//! A budget of RAM that several parts of a program share: each reserves what it is about to take, and is told before it
//! takes it where it does not fit.
//!
//! It counts what it is told, and allocates nothing. Whether it was told the truth is for the operating system to say
//! (see [`crate::usage`]).

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use thiserror::Error;

use crate::byte_size::ByteSize;

/// What does not fit.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("{what} needs {needed} of memory, but {free} of {limit} are free: with {} it would fit", enough.as_argument())]
pub struct BudgetError {
    /// What the memory was for.
    pub what: String,
    /// What it needs.
    pub needed: ByteSize,
    /// What is not reserved.
    pub free: ByteSize,
    /// The whole budget.
    pub limit: ByteSize,
    /// The smallest budget with which it would have fitted.
    pub enough: ByteSize,
}

#[derive(Debug)]
struct Account {
    limit: u64,
    reserved: u64,
    peak: u64,
}

/// A budget of RAM. Clones share it.
#[derive(Debug, Clone)]
pub struct Budget {
    account: Arc<Mutex<Account>>,
}

impl Budget {
    /// A budget of so many bytes, none of them reserved.
    pub fn new(limit: ByteSize) -> Self {
        Budget { account: Arc::new(Mutex::new(Account { limit: limit.0, reserved: 0, peak: 0 })) }
    }

    fn account(&self) -> MutexGuard<'_, Account> {
        // Its numbers change together, and nothing in between can fail.
        self.account.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reserves so many bytes for `what`, until the reservation is dropped.
    ///
    /// # Errors
    ///
    /// Where they are not free; then nothing is reserved.
    pub fn reserve(&self, bytes: u64, what: &str) -> Result<Reservation, BudgetError> {
        let mut account = self.account();
        let free = account.limit - account.reserved;
        if bytes > free {
            return Err(BudgetError {
                what: what.to_owned(),
                needed: ByteSize(bytes),
                free: ByteSize(free),
                limit: ByteSize(account.limit),
                enough: ByteSize(account.reserved.saturating_add(bytes)),
            });
        }
        account.reserved += bytes;
        account.peak = account.peak.max(account.reserved);
        Ok(Reservation { budget: self.clone(), bytes })
    }

    /// Bytes that are not reserved.
    pub fn free(&self) -> ByteSize {
        let account = self.account();
        ByteSize(account.limit - account.reserved)
    }

    /// The most bytes that were ever reserved at once.
    pub fn peak(&self) -> ByteSize {
        ByteSize(self.account().peak)
    }
}

/// Bytes of a [`Budget`] that are spoken for; free again when it is dropped.
#[derive(Debug)]
pub struct Reservation {
    budget: Budget,
    bytes: u64,
}

impl Reservation {
    /// How many bytes.
    pub fn bytes(&self) -> ByteSize {
        ByteSize(self.bytes)
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.budget.account().reserved -= self.bytes;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_dropped_is_free_again_and_the_peak_stays() {
        let budget = Budget::new(ByteSize(100));
        let first = budget.reserve(60, "blocks").unwrap();
        let second = budget.clone().reserve(40, "a sort").unwrap();
        assert_eq!((budget.free(), first.bytes(), second.bytes()), (ByteSize(0), ByteSize(60), ByteSize(40)));
        drop(first);
        assert_eq!((budget.free(), budget.peak()), (ByteSize(60), ByteSize(100)));
        let third = budget.reserve(60, "blocks").unwrap();
        drop((second, third));
        assert_eq!((budget.free(), budget.peak()), (ByteSize(100), ByteSize(100)));
    }

    #[test]
    fn what_does_not_fit_is_refused_with_what_would() {
        let budget = Budget::new(ByteSize(16 << 20));
        let _blocks = budget.reserve(12 << 20, "blocks").unwrap();
        let error = budget.reserve(6 << 20, "the sort").unwrap_err();
        let message = "the sort needs 6 MiB of memory, but 4 MiB of 16 MiB are free: with 18M it would fit";
        assert_eq!(error.to_string(), message);
        assert_eq!(budget.free(), ByteSize(4 << 20));
        assert_eq!(budget.reserve(u64::MAX, "everything").unwrap_err().enough, ByteSize(u64::MAX));
    }
}
