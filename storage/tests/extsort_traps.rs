//! What the crate extsort gets wrong, and that [`ExtsortSorter`] does not. Where a test finds that the crate has mended a
//! trap, the guard against it can go.

#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use extsort::{ExternalSorter, Sortable};
use proptest::prelude::*;
use vdt_storage::{ExtsortSorter, LocalDisk, Scratch, SortRecord, StorageError};

/// Twelve bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct Record([u32; 3]);

impl SortRecord for Record {
    fn prefix(&self) -> u64 {
        self.0[0].into()
    }
}

impl Sortable for Record {
    fn encode<W: Write>(&self, writer: &mut W) -> io::Result<()> {
        writer.write_all(bytemuck::bytes_of(self))
    }

    fn decode<R: Read>(reader: &mut R) -> io::Result<Self> {
        let mut record = Record::zeroed();
        reader.read_exact(bytemuck::bytes_of_mut(&mut record))?;
        Ok(record)
    }
}

fn records(count: u32, seed: u32) -> Vec<Record> {
    let mix = |number: u32| (number ^ seed).wrapping_mul(2_654_435_761) >> 20;
    (0..count).map(|number| Record([mix(number), seed, number])).collect()
}

fn in_order(mut records: Vec<Record>) -> Vec<Record> {
    records.sort_unstable();
    records
}

/// A scratch on the machine's file system, and where it is.
fn scratch() -> (tempfile::TempDir, PathBuf, Scratch) {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("scratch");
    let scratch = Scratch::open(Arc::new(LocalDisk), &place, "test").unwrap().0;
    (folder, place, scratch)
}

/// Bytes for segments of 2048 records, and for three of them.
const RAM: usize = 3 * (8192 + 20 * 12);
const SEGMENT: u32 = 2048;

fn sort(scratch: &Scratch, ram_bytes: usize, records: &[Record]) -> Result<Vec<Record>, StorageError> {
    let mut sorter = ExtsortSorter::new(scratch, "sort", ram_bytes)?;
    records.iter().try_for_each(|record| sorter.push(*record))?;
    let mut sorted = sorter.finish()?;
    assert_eq!(sorted.len(), records.len() as u64);
    let mut found = Vec::new();
    while let Some(record) = sorted.next()? {
        found.push(record);
    }
    assert_eq!(sorted.next()?, None);
    Ok(found)
}

/// Trap 1: as many records as fill whole segments, and none is handed out.
#[test]
fn records_that_fill_whole_segments_are_lost_by_the_crate_and_kept_by_ours() {
    let folder = tempfile::tempdir().unwrap();
    let sort_by_crate = |count| {
        let sorter = ExternalSorter::new().with_segment_size(9).with_sort_dir(folder.path().to_path_buf());
        let sorted = sorter.sort(records(count, 0)).unwrap();
        assert_eq!(sorted.sorted_count(), u64::from(count));
        sorted.count()
    };
    assert_eq!(sort_by_crate(21), 21);
    for count in [10, 20, 500] {
        assert_eq!(sort_by_crate(count), 0, "extsort has mended this trap: its guard can go");
    }

    let (_folder, place, scratch) = scratch();
    for count in [0, 1, SEGMENT - 1, SEGMENT, SEGMENT + 1, 2 * SEGMENT - 1, 2 * SEGMENT, 2 * SEGMENT + 1, 3 * SEGMENT] {
        let records = records(count, 0);
        assert_eq!(sort(&scratch, RAM, &records).unwrap(), in_order(records), "{count} records");
    }
    drop(scratch);
    assert!(!place.exists());
}

/// Trap 2: two sorters in one folder overwrite each other, and their files stay.
#[test]
fn two_sorters_in_one_folder_overwrite_each_other_in_the_crate_and_not_in_ours() {
    let both = [records(5000, 1), records(5000, 2)];
    let folder = tempfile::tempdir().unwrap();
    let mut sorters = [(); 2].map(|()| {
        ExternalSorter::new().with_segment_size(999).with_sort_dir(folder.path().to_path_buf()).pushed::<Record>()
    });
    for number in 0..5000 {
        (0..2).for_each(|which| sorters[which].push(both[which][number]).unwrap());
    }
    let [first, _second] = sorters.map(|mut sorter| {
        sorter.push(Record([u32::MAX; 3])).unwrap();
        sorter.done().unwrap().collect::<io::Result<Vec<_>>>()
    });
    let expected = in_order(both[0].iter().copied().chain([Record([u32::MAX; 3])]).collect());
    assert!(first.is_err() || first.unwrap() != expected, "extsort has mended this trap: its guard can go");
    assert!(folder.path().join("0").exists(), "extsort has mended this trap: its guard can go");

    let (_folder, place, scratch) = scratch();
    let mut sorters = [(); 2].map(|()| ExtsortSorter::new(&scratch, "sort", RAM).unwrap());
    for number in 0..5000 {
        (0..2).for_each(|which| sorters[which].push(both[which][number]).unwrap());
    }
    let mut sorted = sorters.map(|sorter| sorter.finish().unwrap());
    let mut found = [Vec::new(), Vec::new()];
    for _ in 0..5000 {
        (0..2).for_each(|which| found[which].push(sorted[which].next().unwrap().unwrap()));
    }
    assert_eq!(found, both.map(in_order));
    assert!(sorted.iter_mut().all(|sorted| sorted.next().unwrap().is_none()));
    assert!(files_below(&place) > 2);
    drop(sorted);
    // What is left is the lock.
    assert_eq!(files_below(&place), 1);
}

fn files_below(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.map(|path| if path.is_dir() { files_below(&path) } else { 1 }).sum()
}

/// Trap 3: all segments are open at once, however many there are.
#[test]
fn segments_without_bound_are_open_at_once_in_the_crate_and_refused_by_ours() {
    let folder = tempfile::tempdir().unwrap();
    let sorter = ExternalSorter::new().with_segment_size(9).with_sort_dir(folder.path().to_path_buf());
    let sorted = sorter.sort(records(6001, 0)).unwrap();
    assert_eq!(sorted.disk_segment_count(), 601, "extsort has mended this trap: its guard can go");
    #[cfg(target_os = "linux")]
    {
        let open =
            std::fs::read_dir("/proc/self/fd").unwrap().filter_map(|entry| entry.unwrap().path().read_link().ok());
        let open = open.filter(|path| path.starts_with(folder.path())).count();
        assert_eq!(open, 601, "extsort has mended this trap: its guard can go");
    }
    drop(sorted);

    let (_folder, place, scratch) = scratch();
    let sorter = ExtsortSorter::<Record>::new(&scratch, "sort", RAM).unwrap();
    assert_eq!(sorter.capacity(), u64::from(3 * SEGMENT));
    drop(sorter);
    let message = sort(&scratch, RAM, &records(3 * SEGMENT + 1, 0)).unwrap_err().to_string();
    assert!(
        message.contains("cannot sort more than 6144 records") && message.contains("give it more memory"),
        "{message}"
    );
    // Neither by much memory does it come to more open files than a process may have.
    let sorter = ExtsortSorter::<Record>::new(&scratch, "sort", 1 << 30).unwrap();
    assert_eq!(sorter.capacity(), 512 << 26);
    drop((sorter, scratch));
    assert!(!place.exists());
}

/// A segment that is cut short looks to the crate like one that ends there.
#[test]
fn a_segment_cut_short_is_an_error() {
    let (_folder, place, scratch) = scratch();
    let mut sorter = ExtsortSorter::new(&scratch, "sort", RAM).unwrap();
    records(5000, 0).into_iter().try_for_each(|record| sorter.push(record)).unwrap();
    let mut sorted = sorter.finish().unwrap();
    let segment = std::fs::File::options().write(true).open(place.join("000000-sort/1")).unwrap();
    segment.set_len(8192).unwrap();
    let error = (0..5000).find_map(|_| sorted.next().err()).unwrap();
    assert!(matches!(error, StorageError::SortIncomplete { taken: 5000, .. }), "{error}");
    assert!(error.to_string().contains("000000-sort took 5000 records"), "{error}");
}

#[test]
fn a_folder_that_is_gone_is_an_error_that_names_it() {
    let (_folder, place, scratch) = scratch();
    let mut sorter = ExtsortSorter::new(&scratch, "sort", RAM).unwrap();
    std::fs::remove_dir(place.join("000000-sort")).unwrap();
    let error = records(5000, 0).into_iter().find_map(|record| sorter.push(record).err()).unwrap();
    assert!(error.to_string().contains("cannot sort in") && error.to_string().contains("000000-sort"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn it_sorts_in_ram_and_on_disk(count in 0_u32..20_000, ram in 60_000_usize..200_000, seed in any::<u32>()) {
        let records = records(count, seed);
        let (_folder, _, on_disk) = scratch();
        for scratch in [Scratch::in_memory(), on_disk] {
            prop_assert_eq!(&sort(&scratch, ram, &records).unwrap(), &in_order(records.clone()));
        }
    }
}
