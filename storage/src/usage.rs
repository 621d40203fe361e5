//! What the operating system says of this process. Budgets are judged by these figures, not by our own counters
//! (invariant 6 of the design).

use std::time::Duration;

/// The largest resident set of this process so far, in bytes.
///
/// From `VmHWM` of `/proc/self/status` where there is one: `getrusage` would hand a child process its parent's peak.
/// `None` where the system does not tell.
pub fn peak_resident_bytes() -> Option<u64> {
    status_bytes("VmHWM:")
}

/// The resident set of this process at the moment, in bytes. `None` where the system does not tell.
pub fn resident_bytes() -> Option<u64> {
    status_bytes("VmRSS:")
}

fn status_bytes(name: &str) -> Option<u64> {
    kilobytes(&std::fs::read_to_string("/proc/self/status").ok()?, name)
}

/// The size behind a name, in a text of lines such as `VmRSS: 1234 kB`, in bytes.
fn kilobytes(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    Some(line.split_ascii_whitespace().next()?.parse::<u64>().ok()? * 1024)
}

/// The RAM of this machine, in bytes. `None` where the system does not tell.
pub fn machine_bytes() -> Option<u64> {
    kilobytes(&std::fs::read_to_string("/proc/meminfo").ok()?, "MemTotal:")
}

/// Has memory of large blocks go back to the system as soon as it is freed, whatever came before. Called once, when a
/// program begins that has to keep to a budget: the C library's allocator raises the size from which it does so with
/// every large block that is freed, up to 32 MiB, and keeps what is smaller. (Measured: a build in 64 MiB had 40 MiB of
/// freed memory at its peak.) Does nothing where another allocator is at work.
pub fn return_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        const LARGE: i32 = 1 << 20;
        // SAFETY: `mallopt` may be called at any time, and only sets a number of the allocator; a wrong one would be
        // refused. No other thread sets it.
        unsafe { libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE) };
    }
}

/// Has memory that was freed before, but lies between pieces that are in use, go back to the system as well. It takes a
/// few milliseconds: something for the end of a phase. (Measured: a build in 256 MiB had 30 MiB of it after the first
/// phase.) Does nothing where another allocator is at work.
pub fn trim_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // SAFETY: `malloc_trim` may be called at any time and from any thread; it touches free memory only.
        unsafe { libc::malloc_trim(0) };
    }
}

/// Bytes that this process has read and written so far, as the operating system counts them: all that went through its
/// calls, from and to the disk or the system's cache. `None` where the system does not tell.
pub fn bytes_read_and_written() -> Option<(u64, u64)> {
    let counts = std::fs::read_to_string("/proc/self/io").ok()?;
    let count = |name: &str| counts.lines().find_map(|line| line.strip_prefix(name)?.trim().parse().ok());
    Some((count("rchar:")?, count("wchar:")?))
}

/// User and system CPU time of all threads of this process so far.
pub fn cpu_time() -> Duration {
    cpu_clock(rustix::time::ClockId::ProcessCPUTime)
}

/// User and system CPU time of the calling thread so far.
pub fn thread_cpu_time() -> Duration {
    cpu_clock(rustix::time::ClockId::ThreadCPUTime)
}

fn cpu_clock(clock: rustix::time::ClockId) -> Duration {
    let time = rustix::time::clock_gettime(clock);
    Duration::new(time.tv_sec.try_into().unwrap_or(0), time.tv_nsec.try_into().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_read_is_counted() {
        let Some(before) = bytes_read_and_written() else { return };
        let length = std::fs::read(std::env::current_exe().unwrap()).unwrap().len() as u64;
        assert!(bytes_read_and_written().unwrap().0 >= before.0 + length);
    }

    #[test]
    fn cpu_time_passes() {
        let (process, thread) = (cpu_time(), thread_cpu_time());
        let mut sum = 0_u64;
        for i in 0..20_000_000_u64 {
            sum = std::hint::black_box(sum.wrapping_add(i));
        }
        assert!(cpu_time() > process && thread_cpu_time() > thread);
    }
}
