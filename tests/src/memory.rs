//! What the operating system says of a process's memory, and runs in memory cgroups, which hold it to a limit.

use std::fs;
use std::process::Stdio;

pub use storage::MemoryCgroup;

use crate::program::{Outcome, Workplace, finish, wait};

/// Runs the program, and watches its largest resident set, in bytes.
///
/// That is `VmHWM` of `/proc/PID/status`, looked at every millisecond: `wait4` would tell the larger of this process's
/// own peak and the child's. `None` where there is no such file.
pub fn run_watched(place: &Workplace, arguments: &str) -> (Outcome, Option<u64>) {
    let words: Vec<&str> = arguments.split_whitespace().collect();
    let mut command = place.command(&words);
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let program = fs::canonicalize(place.program()).unwrap();
    let mut peak = None;
    let outcome = wait(child, arguments, |process| {
        // Before it runs the program, the child is a copy of this process.
        let has_begun = fs::read_link(format!("/proc/{process}/exe")).is_ok_and(|running| running == program);
        if has_begun {
            peak = peak.max(peak_of(process));
        }
    });
    (outcome, peak)
}

fn peak_of(process: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kilobytes: u64 = line.split_ascii_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes * 1024)
}

/// Runs the program inside a cgroup.
pub fn run_in(group: &MemoryCgroup, place: &Workplace, arguments: &str) -> Outcome {
    let mut command = group.command(place.program());
    command.args(arguments.split_whitespace()).current_dir(place.folder());
    finish(command, arguments)
}
