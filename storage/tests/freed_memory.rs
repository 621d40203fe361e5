//! Freed memory goes back to the system: in a process of its own, since the peaks of others would be seen.

#![cfg(all(target_os = "linux", target_env = "gnu"))]
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

/// KiB of RAM that this process has.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().strip_suffix(" kB").unwrap().trim().parse().unwrap()
}

// One test: another would run beside it and be seen.
#[test]
fn freed_memory_goes_back() {
    vdt_storage::usage::return_freed_memory();
    let before = resident();
    // Freed large blocks would raise the size from which blocks are large.
    for megabytes in [24, 20, 16] {
        let blocks: Vec<Vec<u8>> = (0..8).map(|_| vec![1; megabytes << 20]).collect();
        let small: Vec<Vec<u8>> = (0..100).map(|_| vec![1; 1000]).collect();
        drop(blocks);
        assert!(resident() < before + (16 << 10), "{before} KiB, then {} KiB", resident());
        drop(small);
    }
    // What lies between pieces that are in use stays, until it is trimmed.
    let mut pieces: Vec<(Vec<u8>, Vec<u8>)> = (0..640).map(|_| (vec![1; 100 << 10], vec![1; 100])).collect();
    pieces.iter_mut().for_each(|(large, _)| *large = Vec::new());
    let untrimmed = resident();
    vdt_storage::usage::trim_freed_memory();
    assert!(resident() + (32 << 10) < untrimmed, "{untrimmed} KiB, then {} KiB", resident());
    assert!(pieces.iter().all(|(_, small)| small.iter().all(|byte| *byte == 1)));
}
