//! What the operating system says of a process's memory, and memory cgroups to hold it to a limit.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

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

/// A memory cgroup of its own, with a limit on all that the processes in it have together; gone with this value.
#[derive(Debug)]
pub struct MemoryCgroup {
    folder: PathBuf,
}

impl MemoryCgroup {
    /// A cgroup of so many bytes, swap included. The error says why there is none: mostly because it takes root.
    pub fn new(bytes: u64) -> io::Result<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("vdt-tests-{}-{number}", std::process::id());
        // Version 1 has a hierarchy for memory alone.
        let (parent, files) = if Path::new("/sys/fs/cgroup/memory/memory.limit_in_bytes").exists() {
            ("/sys/fs/cgroup/memory", [("memory.limit_in_bytes", bytes), ("memory.memsw.limit_in_bytes", bytes)])
        } else {
            ("/sys/fs/cgroup", [("memory.max", bytes), ("memory.swap.max", 0)])
        };
        let folder = Path::new(parent).join(name);
        fs::create_dir(&folder)?;
        let group = MemoryCgroup { folder };
        for (place, (file, value)) in files.into_iter().enumerate() {
            let set = fs::write(group.folder.join(file), value.to_string());
            // Systems that have no swap, or do not count it, have no limit on it.
            if place == 0 {
                set?;
            }
        }
        Ok(group)
    }

    /// Runs the program inside.
    pub fn run(&self, place: &Workplace, arguments: &str) -> Outcome {
        let mut command = Command::new("sh");
        command.args(["-c", r#"echo $$ > "$0" && exec "$@""#]).arg(self.folder.join("cgroup.procs"));
        command.arg(place.program()).args(arguments.split_whitespace()).current_dir(place.folder());
        finish(command, arguments)
    }
}

impl Drop for MemoryCgroup {
    fn drop(&mut self) {
        // A process that was killed may still be on its way out.
        for _ in 0..1000 {
            if fs::remove_dir(&self.folder).is_ok() {
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
    }
}
