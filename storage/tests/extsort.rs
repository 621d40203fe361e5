//! The traps of `extsort`, each shown in it as it is (should one of these tests fail with a new version, a guard can go),
//! and that the guarded sorter withstands them.

#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::io::{self, Read, Write};
use std::path::Path;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use extsort::{ExternalSorter, Sortable};
use proptest::prelude::*;
use vdt_storage::{
    CountingDisk, Disk, FaultyDisk, GuardedSorted, GuardedSorter, LocalDisk, MemoryDisk, Scratch, SortRecord,
    StorageError,
};

/// Twelve bytes, of which eight decide.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct Record {
    first: u32,
    second: u32,
    third: u32,
}

impl SortRecord for Record {
    fn prefix(&self) -> u64 {
        self.first.into()
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

/// Records with some that are equal.
fn records(count: u32, seed: u32) -> Vec<Record> {
    let mix = |number: u32| number.wrapping_add(seed).wrapping_mul(0x9e37_79b9) >> 12;
    (0..count).map(|number| Record { first: mix(number / 2) % 5000, second: mix(number / 2), third: seed }).collect()
}

fn in_order(mut records: Vec<Record>) -> Vec<Record> {
    records.sort_unstable();
    records
}

fn scratch_in(folder: &Path, disk: impl Disk + 'static) -> Scratch {
    Scratch::open(Arc::new(disk), &folder.join("scratch"), "test").unwrap().0
}

fn guarded(scratch: &Scratch, records: &[Record], ram_bytes: usize) -> Result<GuardedSorted<Record>, StorageError> {
    let mut sorter = GuardedSorter::new(scratch, "test", ram_bytes);
    records.iter().try_for_each(|record| sorter.push(*record))?;
    sorter.finish()
}

fn all(mut sorted: GuardedSorted<Record>) -> Result<Vec<Record>, StorageError> {
    let mut found = Vec::new();
    while let Some(record) = sorted.next()? {
        found.push(record);
    }
    Ok(found)
}

/// Bytes for a buffer of 64 records, the smallest there is.
const SMALLEST: usize = 64 * 12;

fn bare(folder: &Path, segment_size: usize) -> ExternalSorter {
    ExternalSorter::new().with_segment_size(segment_size).with_sort_dir(folder.to_path_buf())
}

fn names(folder: &Path) -> usize {
    std::fs::read_dir(folder).unwrap().count()
}

#[test]
fn extsort_loses_all_where_the_count_is_an_exact_multiple() {
    let folder = tempfile::tempdir().unwrap();
    for (count, found) in [(63, 63), (64, 0), (65, 65), (127, 127), (128, 0), (640, 0), (641, 641)] {
        let sorted = bare(folder.path(), 63).sort(records(count, 1)).unwrap();
        assert_eq!((sorted.sorted_count(), sorted.count()), (u64::from(count), found));
    }
}

#[test]
fn an_exact_multiple_is_sorted_like_any_count() {
    let folder = tempfile::tempdir().unwrap();
    let scratch = scratch_in(folder.path(), LocalDisk);
    // Two runs make a batch.
    for count in [63, 64, 65, 127, 128, 129, 255, 256, 257, 640, 641] {
        let records = records(count, 1);
        let sorted = guarded(&scratch, &records, SMALLEST).unwrap();
        assert_eq!(sorted.len(), u64::from(count));
        assert_eq!(all(sorted).unwrap(), in_order(records));
    }
}

#[test]
fn two_sorters_of_extsort_in_a_folder_spoil_each_other_and_leave_their_files() {
    let folder = tempfile::tempdir().unwrap();
    // Runs that are longer than what is read ahead.
    let [first, second] = [1, 2].map(|seed| bare(folder.path(), 4999).sort(records(52_000, seed)).unwrap());
    let first: Vec<Record> = first.map_while(Result::ok).collect();
    assert!(first.iter().any(|record| record.third == 2));
    drop(second);
    assert!(names(folder.path()) > 10);
}

#[test]
fn two_guarded_sorters_in_a_scratch_do_not_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let scratch = scratch_in(folder.path(), LocalDisk);
    for (count, ram_bytes) in [(1000, SMALLEST), (3000, 60_000)] {
        let inputs = [1, 2].map(|seed| records(count, seed));
        let mut sorters = [0, 1].map(|_| GuardedSorter::new(&scratch, "test", ram_bytes));
        for (a, b) in inputs[0].iter().zip(&inputs[1]) {
            sorters[0].push(*a).unwrap();
            sorters[1].push(*b).unwrap();
        }
        let sorted = sorters.map(|sorter| sorter.finish().unwrap());
        assert!(scratch.peak_bytes_on_disk() >= u64::from(count) * 2 * 12 / 2);
        for (sorted, input) in sorted.into_iter().zip(inputs) {
            assert_eq!(all(sorted).unwrap(), in_order(input));
        }
        // The lock.
        assert_eq!(names(&folder.path().join("scratch")), 1);
    }
    // One that is given up in the middle.
    drop(guarded(&scratch, &records(1000, 3), SMALLEST).unwrap());
    drop(scratch);
    assert_eq!(names(folder.path()), 0);
}

/// A run that was cut short is the end of it, to extsort.
#[test]
fn records_that_are_missing_are_an_error_with_the_counts() {
    let folder = tempfile::tempdir().unwrap();
    let scratch = scratch_in(folder.path(), LocalDisk);
    let sorted = guarded(&scratch, &records(6000, 1), 60_000).unwrap();
    let runs: Vec<_> =
        std::fs::read_dir(folder.path().join("scratch")).unwrap().map(|entry| entry.unwrap().path()).collect();
    let run = runs.iter().find(|path| path.is_dir()).unwrap().join("0");
    std::fs::File::options().write(true).open(&run).unwrap().set_len(40_000).unwrap();
    let error = all(sorted).unwrap_err();
    assert!(matches!(error, StorageError::Miscounted { taken: 6000, delivered: 5237, .. }), "{error}");
    assert!(error.to_string().contains("6000 records were put in"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_guarded_sorter_sorts(
        count in prop_oneof![0_u32..6000, (0..40_u32, 6..9_u32).prop_map(|(runs, bits)| runs << bits)],
        ram_bytes in prop_oneof![Just(SMALLEST), 0_usize..100_000], seed in any::<u32>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let memory = MemoryDisk::new();
        let scratches = [
            Scratch::in_memory(),
            scratch_in(Path::new(""), memory.clone()),
            scratch_in(folder.path(), CountingDisk::new(Arc::new(LocalDisk))),
        ];
        for scratch in scratches {
            let records = records(count, seed);
            let sorted = guarded(&scratch, &records, ram_bytes).unwrap();
            prop_assert_eq!((sorted.len(), sorted.is_empty()), (u64::from(count), count == 0));
            prop_assert_eq!(all(sorted).unwrap(), in_order(records));
        }
        prop_assert!(memory.paths().is_empty());
        prop_assert_eq!(names(folder.path()), 0);
    }
}

#[test]
fn on_a_disk_of_another_kind_its_failures_are_ours() {
    let disk = FaultyDisk::new(Arc::new(MemoryDisk::new()));
    disk.full_after(20_000);
    let scratch = scratch_in(Path::new(""), disk);
    assert!(guarded(&scratch, &records(6000, 1), SMALLEST).and_then(all).is_err());
}

#[test]
fn a_folder_that_is_gone_is_an_error_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let scratch = scratch_in(folder.path(), LocalDisk);
    let mut sorter = GuardedSorter::new(&scratch, "test", SMALLEST);
    sorter.push(records(1, 1)[0]).unwrap();
    std::fs::remove_dir_all(folder.path().join("scratch")).unwrap();
    let error = records(100, 1).iter().try_for_each(|record| sorter.push(*record)).unwrap_err();
    assert!(error.to_string().contains("000000-test"), "{error}");
}
