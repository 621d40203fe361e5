//! What is said of resident memory: in a process of its own, since other tests take and give memory meanwhile.

#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use vdt_storage::usage::{peak_resident_bytes, resident_bytes};

#[test]
fn the_peak_rises_with_what_is_touched() {
    let Some(before) = peak_resident_bytes() else { return };
    let block = vec![1_u8; 64 << 20];
    let after = peak_resident_bytes().unwrap();
    assert!(block.iter().step_by(4096).all(|byte| *byte == 1));
    assert!(after >= before + (60 << 20), "{before} -> {after}");
    let with_it = resident_bytes().unwrap();
    drop(block);
    // The system counts pages in lots.
    assert!(resident_bytes().unwrap() + (60 << 20) <= with_it);
    assert!(with_it <= peak_resident_bytes().unwrap() + (1 << 20));
}
