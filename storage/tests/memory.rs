//! The stores keep to the bytes that they are given. In a process of its own, since everything that it allocates counts.

#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use bytemuck::{Pod, Zeroable};
use vdt_storage::{LocalDisk, PagedArray, Scatter, Scratch, SortRecord, Sorter, SpoolWriter, StorageError};

/// The system's allocator, with what is allocated counted.
struct Counting;

static NOW: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

fn grow(bytes: usize) {
    PEAK.fetch_max(NOW.fetch_add(bytes, Ordering::Relaxed) + bytes, Ordering::Relaxed);
}

fn shrink(bytes: usize) {
    NOW.fetch_sub(bytes, Ordering::Relaxed);
}

// SAFETY: every call goes to the system's allocator as it is; the counters have nothing to do with the memory. A block that
// is made larger counts once, as large blocks are moved by their pages.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grow(layout.size());
        // SAFETY: as the caller promised.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        shrink(layout.size());
        // SAFETY: as the caller promised.
        unsafe { System.dealloc(block, layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        grow(size.saturating_sub(layout.size()));
        shrink(layout.size().saturating_sub(size));
        // SAFETY: as the caller promised.
        unsafe { System.realloc(block, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct Record([u32; 5]);

impl SortRecord for Record {
    fn prefix(&self) -> u64 {
        self.0[0].into()
    }
}

fn record(number: u32) -> Record {
    Record([number.wrapping_mul(2_654_435_761), number, 2, 3, 4])
}

/// 4 MB of records.
const COUNT: u32 = 200_000;
/// File names, lists of runs, the frames of the system's library.
const BESIDES: usize = 24 << 10;

fn spool(scratch: &Scratch, ram_bytes: usize, _: usize) -> Result<(), StorageError> {
    let mut writer = SpoolWriter::new(scratch, "spool", ram_bytes);
    (0..COUNT / 2).try_for_each(|number| writer.push(record(number)))?;
    writer.extend(&[record(0); 100])?;
    (0..COUNT / 2).try_for_each(|number| writer.push(record(number)))?;
    let spool = writer.finish()?;
    let mut reader = spool.reader(ram_bytes);
    while reader.next()?.is_some() {}
    Ok(())
}

fn sorter(scratch: &Scratch, ram_bytes: usize, threads: usize) -> Result<(), StorageError> {
    let mut sorter = Sorter::new(scratch, "sorter", ram_bytes, threads);
    (0..COUNT).try_for_each(|number| sorter.push(record(number)))?;
    let mut sorted = sorter.finish()?;
    while sorted.next()?.is_some() {}
    Ok(())
}

fn scatter(scratch: &Scratch, ram_bytes: usize, _: usize) -> Result<(), StorageError> {
    let mut scatter = Scatter::new(scratch, "scatter", COUNT.into(), ram_bytes);
    (0..COUNT)
        .try_for_each(|number| scatter.put((u64::from(number) * 77_773 % u64::from(COUNT)) as u32, record(number)))?;
    let mut scattered = scatter.finish()?;
    while scattered.next()?.is_some() {}
    Ok(())
}

fn paged_array(scratch: &Scratch, ram_bytes: usize, _: usize) -> Result<(), StorageError> {
    let mut array = PagedArray::new(scratch, "array", u64::from(COUNT) * 5, 0, ram_bytes)?;
    (0..COUNT).try_for_each(|number| array.set(number * 5, number))?;
    (0..COUNT).try_for_each(|number| array.get(number * 5).map(|_| ()))
}

#[test]
fn stores_take_no_more_than_they_are_given() {
    type Use = fn(&Scratch, usize, usize) -> Result<(), StorageError>;
    let stores: [(&str, Use); 4] =
        [("spool", spool), ("sorter", sorter), ("scatter", scatter), ("paged array", paged_array)];
    let folder = tempfile::tempdir().unwrap();
    for (name, go) in stores {
        for ram_bytes in [256 << 10, 500_000, 1 << 20, 3_000_000] {
            for threads in 1..3 {
                let scratch = Scratch::open(Arc::new(LocalDisk), &folder.path().join("scratch"), "").unwrap().0;
                if threads == 2 {
                    scratch.overlap();
                }
                let before = NOW.load(Ordering::Relaxed);
                PEAK.store(before, Ordering::Relaxed);
                go(&scratch, ram_bytes, threads).unwrap();
                let taken = PEAK.load(Ordering::Relaxed) - before;
                assert!(scratch.peak_bytes_on_disk() > 0, "{name} within {ram_bytes} bytes used no disk");
                assert!(taken <= ram_bytes + BESIDES, "{name} within {ram_bytes} bytes took {taken}");
                // It is not that it makes no use of them.
                assert!(taken >= ram_bytes / 4, "{name} within {ram_bytes} bytes took {taken}");
            }
        }
    }
}
