//! The record stores, whatever they are allowed to hold in RAM.

#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::path::Path;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use proptest::prelude::*;
use vdt_storage::{
    Disk, FaultyDisk, KeptSpool, LocalDisk, MemoryDisk, PagedArray, Scatter, Scattered, Scratch, SortRecord, Sorter,
    Spool, SpoolWriter, StorageError,
};

/// Twelve bytes, so that records straddle blocks.
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

fn record(number: u32) -> Record {
    Record { first: number.wrapping_mul(2_654_435_761) >> 8, second: number, third: !number }
}

fn scratch_on(disk: Arc<dyn Disk>) -> Scratch {
    Scratch::open(disk, Path::new("scratch"), "test").unwrap().0
}

/// Without a disk, on one, and on one beside the computation.
fn scratches() -> [(Scratch, Option<MemoryDisk>); 3] {
    let disks = [MemoryDisk::new(), MemoryDisk::new()];
    let [plain, overlapped] = disks.clone().map(|disk| scratch_on(Arc::new(disk)));
    overlapped.overlap();
    let [disk, other] = disks;
    [(Scratch::in_memory(), None), (plain, Some(disk)), (overlapped, Some(other))]
}

fn all(spool: &Spool<Record>, ram_bytes: usize) -> Vec<Record> {
    let mut reader = spool.reader(ram_bytes);
    let mut records = Vec::new();
    while let Some(record) = reader.next().unwrap() {
        records.push(record);
    }
    assert_eq!(reader.next().unwrap(), None);
    records
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_spool_gives_back_what_it_got(count in 0_u32..6000, ram in 0_usize..100_000, read_ram in 0_usize..50_000,
        keep in any::<bool>(), part in (0.0..1.0, 0.0..1.0)) {
        for (scratch, disk) in scratches() {
            let expected: Vec<Record> = (0..count).map(record).collect();
            let mut writer = SpoolWriter::new(&scratch, "test", ram);
            writer.extend(&expected).unwrap();
            let spool = if keep { writer.finish() } else { writer.finish_on_disk() }.unwrap();
            prop_assert_eq!(spool.len(), u64::from(count));
            prop_assert_eq!(&all(&spool, read_ram), &expected);
            let mut start = (f64::from(count) * part.0) as usize;
            let mut end = (f64::from(count) * part.1) as usize;
            if start > end {
                std::mem::swap(&mut start, &mut end);
            }
            let mut found = vec![Record::zeroed(); end - start];
            spool.read_at(start as u64, &mut found).unwrap();
            prop_assert_eq!(&found[..], &expected[start..end]);
            let mut reader = spool.reader_of(start as u64, end as u64, read_ram);
            let mut found = Vec::new();
            loop {
                let chunk = reader.next_chunk().unwrap();
                if chunk.is_empty() {
                    break;
                }
                found.extend_from_slice(chunk);
            }
            prop_assert_eq!(&found[..], &expected[start..end]);
            if let Some(disk) = disk {
                let for_blocks = (ram / 4 / 4096).clamp(2, 256) * 4096;
                let in_ram = ram.saturating_sub(for_blocks).max(8192) / 12;
                let on_disk = count as usize > in_ram || (!keep && count > 0);
                // One more is the lock.
                prop_assert_eq!(disk.paths().len(), 2 * usize::from(on_disk));
                prop_assert!(scratch.peak_bytes_on_disk() >= u64::from(on_disk) * u64::from(count) * 12);
                drop((spool, scratch));
                prop_assert!(disk.paths().is_empty());
            }
        }
    }

    #[test]
    fn a_sorter_sorts(count in 0_u32..6000, ram in 0_usize..60_000, threads in 1_usize..3, spread in 1_u32..5000) {
        for (scratch, disk) in scratches() {
            let records = (0..count).map(|number| Record { first: record(number).first % spread, ..record(number) });
            let mut expected: Vec<Record> = records.clone().collect();
            expected.sort_unstable();
            let mut sorter = Sorter::new(&scratch, "test", ram, threads);
            records.clone().try_for_each(|record| sorter.push(record)).unwrap();
            let mut sorted = sorter.finish().unwrap();
            prop_assert_eq!(sorted.len(), u64::from(count));
            let mut found = Vec::new();
            while let Some(record) = sorted.next().unwrap() {
                found.push(record);
            }
            prop_assert_eq!(found, expected);
            drop((sorted, scratch));
            prop_assert!(disk.is_none_or(|disk| disk.paths().is_empty()));
        }
    }

    #[test]
    fn a_scatter_puts_records_in_their_places(count in 1_u32..6000, ram in 0_usize..60_000, holes in 0_u32..5,
        keep in any::<bool>()) {
        for (scratch, disk) in scratches() {
            let mut scatter = Scatter::new(&scratch, "test", count.into(), ram);
            let mut expected = vec![Record::zeroed(); count as usize];
            for number in 0..count {
                // A permutation: the factor is a prime larger than any count.
                let key = (u64::from(number) * 1_000_003 % u64::from(count)) as u32;
                if holes == 0 || number % holes != 0 {
                    scatter.put(key, record(number)).unwrap();
                    expected[key as usize] = record(number);
                }
            }
            let mut scattered = scatter.finish().unwrap();
            if keep && disk.is_some() {
                let kept = scattered.keep(&scratch, "kept").unwrap();
                scratch.checkpoint(serde_json::Value::Null, kept.files().collect()).unwrap();
                drop(scattered);
                scattered = Scattered::reopen(&scratch, &kept).unwrap();
                scratch.discard_checkpoint().unwrap();
            }
            let mut found = Vec::new();
            while let Some(record) = scattered.next().unwrap() {
                found.push(record);
            }
            prop_assert_eq!(found, expected);
            drop((scattered, scratch));
            prop_assert!(disk.is_none_or(|disk| disk.paths().is_empty()));
        }
    }

    #[test]
    fn a_paged_array_is_an_array(
        count in 1_u32..40_000, ram in 0_usize..100_000,
        accesses in prop::collection::vec((any::<u32>(), any::<Option<u32>>()), 0..2000),
    ) {
        for (scratch, disk) in scratches() {
            let mut array = PagedArray::new(&scratch, "test", count.into(), 7, ram).unwrap();
            let mut expected = vec![7; count as usize];
            for (index, value) in &accesses {
                let index = index % count;
                match value {
                    Some(value) => {
                        array.set(index, *value).unwrap();
                        expected[index as usize] = *value;
                    }
                    None => prop_assert_eq!(array.get(index).unwrap(), expected[index as usize]),
                }
            }
            for (index, value) in (0..).zip(&expected) {
                prop_assert_eq!(array.get(index).unwrap(), *value);
            }
            drop((array, scratch));
            prop_assert!(disk.is_none_or(|disk| disk.paths().is_empty()));
        }
    }
}

/// Every store on a disk that is full after so many bytes: an error, and nothing is left.
#[test]
fn a_full_disk_is_an_error_and_leaves_nothing() {
    fn everything(scratch: &Scratch) -> Result<(), StorageError> {
        let mut writer = SpoolWriter::new(scratch, "spool", 10_000);
        let mut sorter = Sorter::new(scratch, "sorter", 20_000, 2);
        let mut scatter = Scatter::new(scratch, "scatter", 5000, 20_000);
        let mut array = PagedArray::new(scratch, "array", 50_000, 0, 40_000)?;
        for number in 0..5000 {
            writer.push(record(number))?;
            sorter.push(record(number))?;
            scatter.put(number, record(number))?;
            array.set(number * 10, number)?;
        }
        let (spool, mut sorted, mut scattered) = (writer.finish()?, sorter.finish()?, scatter.finish()?);
        assert_eq!(all(&spool, 10_000).len(), 5000);
        while sorted.next()?.is_some() && scattered.next()?.is_some() {}
        Ok(())
    }
    for is_overlapped in [false, true] {
        let memory = MemoryDisk::new();
        let faulty = FaultyDisk::new(Arc::new(memory.clone()));
        let go = || {
            let scratch = scratch_on(Arc::new(faulty.clone()));
            if is_overlapped {
                scratch.overlap();
            }
            let result = everything(&scratch);
            drop(scratch);
            assert!(memory.paths().is_empty(), "{:?}", memory.paths());
            result
        };
        let mut failures = 0;
        for bytes in (0..).step_by(16_384) {
            faulty.full_after(bytes);
            match go() {
                Ok(()) => break,
                Err(error) => assert!(error.to_string().contains("cannot write"), "{error}"),
            }
            failures += 1;
        }
        assert!(failures > 10);
        faulty.heal();
        faulty.fail_reads_after(3);
        assert!(go().unwrap_err().to_string().contains("injected fault"));
    }
}

/// On the machine's own file system, past its page cache where that can be.
#[test]
fn files_of_the_machine_do_as_well() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("scratch");
    let scratch = Scratch::open(Arc::new(LocalDisk), &place, "test").unwrap().0;
    let mut sorter = Sorter::new(&scratch, "sorter", 100_000, 2);
    (0..100_000).try_for_each(|number| sorter.push(record(number))).unwrap();
    let mut sorted = sorter.finish().unwrap();
    assert!(LocalDisk.list(&place).unwrap().len() > 1);
    assert!(scratch.peak_bytes_on_disk() >= 1_200_000);
    let mut before = Record::zeroed();
    let mut count = 0;
    while let Some(record) = sorted.next().unwrap() {
        assert!(before <= record);
        (before, count) = (record, count + 1);
    }
    assert_eq!(count, 100_000);
    drop((sorted, scratch));
    assert!(!place.exists());
}

/// A process dies after a checkpoint: the next one finds what it kept, and nothing else.
#[test]
fn a_checkpoint_outlives_its_process_and_other_files_do_not() {
    let disk = MemoryDisk::new();
    let open = |fingerprint: &str| Scratch::open(Arc::new(disk.clone()), Path::new("scratch"), fingerprint).unwrap();
    let (scratch, state) = open("this mesh");
    assert_eq!(state, None);
    let mut writer = SpoolWriter::new(&scratch, "kept", 10_000);
    (0..3000).try_for_each(|number| writer.push(record(number))).unwrap();
    let mut spool = writer.finish().unwrap();
    let kept = spool.keep(&scratch, "kept").unwrap();
    scratch.checkpoint(serde_json::json!({ "spool": kept }), kept.file.iter().cloned().collect()).unwrap();
    let mut writer = SpoolWriter::new(&scratch, "lost", 10_000);
    (0..3000).try_for_each(|number| writer.push(record(number))).unwrap();
    let lost = writer.finish_on_disk().unwrap();
    disk.insert("scratch/somebody else's", b"file".to_vec());
    // A killed process drops nothing.
    std::mem::forget((spool, lost, scratch));
    assert_eq!(disk.paths().len(), 5);

    let (scratch, state) = open("this mesh");
    assert_eq!(disk.paths().len(), 4, "{:?}", disk.paths());
    let again: KeptSpool = serde_json::from_value(state.unwrap()["spool"].clone()).unwrap();
    assert_eq!(again, kept);
    let spool = Spool::<Record>::reopen(&scratch, &again).unwrap();
    assert_eq!(all(&spool, 20_000), (0..3000).map(record).collect::<Vec<_>>());
    drop((spool, scratch));
    assert_eq!(disk.paths().len(), 4, "{:?}", disk.paths());

    let (scratch, state) = open("another mesh");
    assert_eq!(state, None);
    drop(scratch);
    assert_eq!(disk.paths(), [Path::new("scratch/somebody else's")]);
}

/// Once the checkpoint is not needed any more, nothing is left.
#[test]
fn a_discarded_checkpoint_leaves_nothing() {
    let disk = MemoryDisk::new();
    let scratch = scratch_on(Arc::new(disk.clone()));
    let mut spool = Spool::from_vec((0..3000).map(record).collect());
    let kept = spool.keep(&scratch, "kept").unwrap();
    scratch.checkpoint(serde_json::Value::Null, kept.file.iter().cloned().collect()).unwrap();
    assert_eq!(all(&spool, 20_000).len(), 3000);
    scratch.discard_checkpoint().unwrap();
    drop((spool, scratch));
    assert!(disk.paths().is_empty(), "{:?}", disk.paths());
}

/// A place that is not there is an error that says which, in RAM and on disk.
#[test]
fn keys_and_indices_out_of_range_are_errors() {
    for (scratch, _) in scratches() {
        for count in [10_u64, 40_000] {
            let mut scatter = Scatter::new(&scratch, "ids", count, 1000);
            scatter.put(count as u32 - 1, record(1)).unwrap();
            let mut array = PagedArray::new(&scratch, "ids", count, 7, 1000).unwrap();
            array.set(count as u32 - 1, 1).unwrap();
            for index in [count, u32::MAX.into()] {
                let expected = format!("ids has places 0 to {count} (without {count}), not {index}");
                let key = index as u32;
                assert_eq!(scatter.put(key, record(1)).unwrap_err().to_string(), expected);
                assert_eq!(array.get(key).unwrap_err().to_string(), expected);
                assert_eq!(array.set(key, 1).unwrap_err().to_string(), expected);
            }
        }
    }
}

/// Not one byte of the file of a scatter is believed: with any of them altered it ends with an error, or with as many
/// records.
#[test]
fn an_altered_scatter_is_an_error_or_another_record() {
    let disk = MemoryDisk::new();
    let scratch = scratch_on(Arc::new(disk.clone()));
    let mut scatter = Scatter::new(&scratch, "scatter", 3000, 20_000);
    (0..3000).try_for_each(|number| scatter.put(number, record(number))).unwrap();
    let mut scattered = scatter.finish().unwrap();
    let kept = scattered.keep(&scratch, "scatter").unwrap();
    let path = Path::new("scratch/000000-scatter");
    let bytes = disk.bytes(path).unwrap();
    let mut errors = 0;
    for place in (0..bytes.len()).step_by(61).chain(0..16).chain(4096..4112) {
        let mut altered = bytes.clone();
        altered[place] ^= 0x40;
        disk.insert(path, altered);
        let mut scattered = Scattered::<Record>::reopen(&scratch, &kept).unwrap();
        let mut count = 0;
        let error = loop {
            match scattered.next() {
                Ok(Some(_)) => count += 1,
                Ok(None) => break None,
                Err(error) => break Some(error.to_string()),
            }
        };
        match error {
            Some(message) => {
                assert!(
                    message.contains("000000-scatter is altered") || message.contains("000000-scatter is too short")
                );
                errors += 1;
            }
            None => assert_eq!(count, 3000),
        }
    }
    assert!(errors > 10, "{errors}");
}

/// A machine that dies may leave a file shorter than the manifest says: then there is no checkpoint, and what is left of
/// it goes, half a manifest too.
#[test]
fn a_checkpoint_with_a_truncated_or_missing_file_is_none() {
    let name = Path::new("scratch/000000-kept");
    let damages: [&dyn Fn(&MemoryDisk); 4] = [
        &|disk| disk.insert(name, disk.bytes(name).unwrap()[1..].to_vec()),
        &|disk| disk.remove(name).unwrap(),
        &|disk| disk.insert("scratch/manifest.json", b"{".to_vec()),
        &|disk| disk.insert("scratch/.manifest.json.17.tmp", b"{".to_vec()),
    ];
    for (number, damage) in damages.iter().enumerate() {
        let disk = MemoryDisk::new();
        let scratch = scratch_on(Arc::new(disk.clone()));
        let mut spool = Spool::from_vec((0..3000).map(record).collect());
        let kept = spool.keep(&scratch, "kept").unwrap();
        scratch.checkpoint(serde_json::json!(7), kept.file.iter().cloned().collect()).unwrap();
        drop((spool, scratch));
        assert_eq!(disk.paths().len(), 3);
        damage(&disk);
        let (scratch, state) = Scratch::open(Arc::new(disk.clone()), Path::new("scratch"), "test").unwrap();
        if number < 3 {
            assert_eq!(state, None);
        } else {
            assert_eq!(state, Some(serde_json::json!(7)));
            scratch.discard_checkpoint().unwrap();
        }
        drop(scratch);
        assert!(disk.paths().is_empty(), "{number}: {:?}", disk.paths());
    }
}

/// What the caller writes down can be all that there is to a checkpoint.
#[test]
fn a_checkpoint_without_files_is_one() {
    let disk = MemoryDisk::new();
    let open = || Scratch::open(Arc::new(disk.clone()), Path::new("scratch"), "test").unwrap();
    let (scratch, _) = open();
    scratch.checkpoint(serde_json::json!("done"), Vec::new()).unwrap();
    drop(scratch);
    // Twice: it is not used up.
    for _ in 0..2 {
        assert_eq!(open().1, Some(serde_json::json!("done")));
    }
    let (scratch, _) = open();
    scratch.discard_checkpoint().unwrap();
    drop(scratch);
    assert!(disk.paths().is_empty(), "{:?}", disk.paths());
}

/// A file that was shortened after it was opened again is named.
#[test]
fn a_truncated_file_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("scratch");
    let scratch = Scratch::open(Arc::new(LocalDisk), &place, "test").unwrap().0;
    let mut writer = SpoolWriter::new(&scratch, "short", 0);
    (0..3000).try_for_each(|number| writer.push(record(number))).unwrap();
    let spool = writer.finish().unwrap();
    let file = std::fs::File::options().write(true).open(place.join("000000-short")).unwrap();
    file.set_len(8192).unwrap();
    let message = spool.read_at(0, &mut [Record::zeroed(); 3000]).unwrap_err().to_string();
    assert!(message.contains("000000-short is too short: it has 8192 bytes"), "{message}");
}

/// Two processes in one folder would destroy each other's files.
#[test]
fn a_folder_at_work_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let open = || Scratch::open(Arc::new(LocalDisk), &folder.path().join("scratch"), "test");
    let scratch = open().unwrap().0;
    let mut writer = SpoolWriter::new(&scratch, "test", 0);
    writer.push(record(1)).unwrap();
    let spool = writer.finish_on_disk().unwrap();
    let message = open().unwrap_err().to_string();
    assert!(message.contains("another build is at work in") && message.contains("--scratch"), "{message}");
    drop((spool, scratch));
    open().unwrap();
}
