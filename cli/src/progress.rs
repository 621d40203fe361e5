//! Progress on standard error, when that is a terminal; nothing otherwise.

use std::borrow::Cow;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// Steps of the bar.
const STEPS: u64 = 1000;

/// A bar that is cleared when it is dropped.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
}

impl Progress {
    /// Begins a bar. indicatif draws it on standard error, and only if that is a terminal.
    pub fn new(what: &'static str) -> Self {
        let bar = ProgressBar::new(STEPS);
        if let Ok(style) = ProgressStyle::with_template("{msg:31} {wide_bar} {percent:>3} %  {eta:>5} left") {
            bar.set_style(style);
        }
        bar.set_message(what);
        bar.enable_steady_tick(Duration::from_millis(200));
        Progress { bar }
    }

    /// Begins a sign of life, for work whose share done is not known.
    pub fn waiting(what: &'static str) -> Self {
        let bar = ProgressBar::new_spinner();
        bar.set_message(what);
        bar.enable_steady_tick(Duration::from_millis(200));
        Progress { bar }
    }

    /// Names what is being done.
    pub fn phase(&self, what: impl Into<Cow<'static, str>>) {
        self.bar.set_message(what);
    }

    /// Shows the share done, 0 to 1.
    pub fn show(&self, share: f64) {
        self.bar.set_position((share.clamp(0.0, 1.0) * STEPS as f64) as u64);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
