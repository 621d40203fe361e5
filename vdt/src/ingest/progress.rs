//! The share of the work that is done, for whoever shows it.

/// The phases of [`super::store`], by the time that they take.
pub(super) struct Progress<'a> {
    report: &'a mut dyn FnMut(f64),
    start: f64,
    length: f64,
}

impl<'a> Progress<'a> {
    /// How many elements pass between two reports.
    pub const STRIDE: u64 = 1 << 16;

    pub fn new(report: &'a mut dyn FnMut(f64)) -> Self {
        Progress { report, start: 0.0, length: 0.0 }
    }

    /// The next phase begins, which has such a share of all the work.
    pub fn phase(&mut self, share: f64) {
        self.start += self.length;
        self.length = share;
        self.set(0.0);
    }

    /// So much of the phase is done, from 0 to 1.
    pub fn set(&mut self, done: f64) {
        (self.report)(self.start + self.length * done);
    }

    /// So many elements of the phase are done.
    #[inline]
    pub fn count(&mut self, done: u64, all: u64) {
        if done.is_multiple_of(Self::STRIDE) {
            self.set(done as f64 / all.max(1) as f64);
        }
    }
}
