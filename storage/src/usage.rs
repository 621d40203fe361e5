//! What the operating system says of this process. Budgets are judged by these figures, not by our own counters
//! (invariant 6 of the design).

use std::time::Duration;

/// The largest resident set of this process so far, in bytes.
///
/// From `VmHWM` of `/proc/self/status` where there is one: `getrusage` would hand a child process its parent's peak.
/// `None` where the system does not tell.
pub fn peak_resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kilobytes: u64 = line.split_ascii_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes * 1024)
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
    fn the_peak_rises_with_what_is_touched() {
        let Some(before) = peak_resident_bytes() else { return };
        let block = vec![1_u8; 64 << 20];
        let after = peak_resident_bytes().unwrap();
        assert!(block.iter().step_by(4096).all(|byte| *byte == 1));
        assert!(after >= before + (60 << 20), "{before} -> {after}");
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
