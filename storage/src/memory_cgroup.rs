//! Memory cgroups of Linux: groups of processes that the system holds to a limit on all memory that they have together, pages
//! of its page cache that they were the first to read among it. What goes beyond is first taken from that cache; where that
//! does not help, a process is killed.
//!
//! Version 1 (a hierarchy for memory alone) and version 2 are known. To make one mostly takes root.

use std::ffi::OsStr;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Where the system shows cgroups.
const ROOT: &str = "/sys/fs/cgroup";
/// How often, and after how long, it is tried to remove a group whose processes may still be on their way out.
const TRIES: u32 = 1000;
const PAUSE: Duration = Duration::from_millis(1);

/// The names of the files of a version.
#[derive(Debug, Clone, Copy)]
struct Files {
    folder: &'static str,
    limit: &'static str,
    /// That on swap, and whether it counts memory and swap together.
    swap_limit: (&'static str, bool),
    peak: &'static str,
    /// The one with a line for the kills.
    events: &'static str,
}

const VERSION_1: Files = Files {
    folder: "memory",
    limit: "memory.limit_in_bytes",
    swap_limit: ("memory.memsw.limit_in_bytes", true),
    peak: "memory.max_usage_in_bytes",
    events: "memory.oom_control",
};

const VERSION_2: Files = Files {
    folder: "",
    limit: "memory.max",
    swap_limit: ("memory.swap.max", false),
    peak: "memory.peak",
    events: "memory.events",
};

/// A memory cgroup of its own; gone with this value.
#[derive(Debug)]
pub struct MemoryCgroup {
    folder: PathBuf,
    files: Files,
}

impl MemoryCgroup {
    /// A cgroup of so many bytes, swap included. The error says why there is none.
    pub fn new(bytes: u64) -> io::Result<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("vdt-{}-{number}", std::process::id());
        let has_version_1 = Path::new(ROOT).join(VERSION_1.folder).join(VERSION_1.limit).exists();
        let files = if has_version_1 { VERSION_1 } else { VERSION_2 };
        let folder = Path::new(ROOT).join(files.folder).join(name);
        fs::create_dir(&folder)?;
        let group = MemoryCgroup { folder, files };
        fs::write(group.folder.join(files.limit), bytes.to_string())?;
        let (swap_limit, is_sum) = files.swap_limit;
        // Systems that have no swap, or do not count it, have no limit on it.
        let _ = fs::write(group.folder.join(swap_limit), if is_sum { bytes } else { 0 }.to_string());
        Ok(group)
    }

    /// Its folder in the file system of cgroups.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// A program to be started inside, its arguments to be added.
    pub fn command(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", r#"echo $$ > "$0" && exec "$@""#]).arg(self.folder.join("cgroup.procs")).arg(program);
        command
    }

    /// The most that its processes had together, in bytes; `None` where the system does not tell.
    pub fn peak_bytes(&self) -> Option<u64> {
        fs::read_to_string(self.folder.join(self.files.peak)).ok()?.trim().parse().ok()
    }

    /// How many of its processes were killed because of the limit; `None` where the system does not tell.
    pub fn kills(&self) -> Option<u64> {
        let events = fs::read_to_string(self.folder.join(self.files.events)).ok()?;
        events.lines().find_map(|line| line.strip_prefix("oom_kill ")?.trim().parse().ok())
    }
}

impl Drop for MemoryCgroup {
    fn drop(&mut self) {
        remove_cgroup(&self.folder);
    }
}

/// Removes the cgroup with this folder, whose processes have ended or are about to.
pub fn remove_cgroup(folder: &Path) {
    for _ in 0..TRIES {
        if fs::remove_dir(folder).is_ok() || !folder.exists() {
            return;
        }
        std::thread::sleep(PAUSE);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What takes more memory than it may is killed, and is counted. Where no cgroup can be made, there is nothing to test.
    #[test]
    fn a_limit_holds() {
        let Ok(group) = MemoryCgroup::new(8 << 20) else { return };
        let folder = group.folder().to_path_buf();
        let run = |bytes: &str| {
            group.command("sh").args(["-c", &format!("head -c {bytes} /dev/zero | tail -c {bytes} | wc -c")]).output()
        };
        let output = run("1000").unwrap();
        assert!(output.status.success() && output.stdout.starts_with(b"1000"), "{output:?}");
        assert_eq!(group.kills().unwrap_or(0), 0);
        let output = run("64000000").unwrap();
        assert!(!output.stdout.starts_with(b"64000000"), "{output:?}");
        assert!(group.kills().unwrap_or(1) > 0);
        assert!(group.peak_bytes().is_none_or(|peak| peak > 1 << 20 && peak <= 8 << 20));
        drop(group);
        assert!(!folder.exists());
    }
}
