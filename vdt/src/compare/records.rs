//! Records that stay in RAM where they fit in a number of bytes, and lie on disk where they do not; there they are read
//! through a cache.
//!
//! Memory: the bytes given for records in RAM; of a [`Window`] to records on disk, the bytes given, and 32 for each page.
//! I/O: a page for each access to one that is not in the cache. Pages are let go by second chance.

use bytemuck::Pod;
use hashbrown::HashMap;
use storage::{Scratch, Spool, SpoolWriter, StorageError};

/// Records, written once.
#[derive(Debug)]
pub(super) enum Records<T> {
    Ram(Vec<T>),
    Disk(Spool<T>),
}

impl<T: Pod> Records<T> {
    /// What a spool holds. One in RAM is copied, and then gone.
    pub fn of(spool: Spool<T>) -> Result<Self, StorageError> {
        if spool.ram_bytes() == 0 && !spool.is_empty() {
            return Ok(Records::Disk(spool));
        }
        let mut records = vec![T::zeroed(); spool.len() as usize];
        spool.read_at(0, &mut records)?;
        Ok(Records::Ram(records))
    }

    pub fn len(&self) -> u64 {
        match self {
            Records::Ram(records) => records.len() as u64,
            Records::Disk(spool) => spool.len(),
        }
    }

    /// Fills `records` with those from number `start` on, as far as there are any, and says how many that are.
    pub fn read(&self, start: u64, records: &mut [T]) -> Result<usize, StorageError> {
        let count = (self.len().saturating_sub(start)).min(records.len() as u64) as usize;
        match self {
            Records::Ram(all) => records[..count].copy_from_slice(&all[start as usize..][..count]),
            Records::Disk(spool) => spool.read_at(start, &mut records[..count])?,
        }
        Ok(count)
    }
}

/// Writes [`Records`] whose number is known beforehand.
#[derive(Debug)]
pub(super) enum RecordsWriter<T> {
    Ram(Vec<T>),
    Disk(Box<SpoolWriter<T>>),
}

impl<T: Pod> RecordsWriter<T> {
    /// For `count` records, which stay in RAM if they take no more than `ram_bytes`.
    pub fn new(scratch: &Scratch, name: &str, count: u64, ram_bytes: usize) -> Self {
        match usize::try_from(count) {
            Ok(count) if count.saturating_mul(size_of::<T>()) <= ram_bytes => {
                RecordsWriter::Ram(Vec::with_capacity(count))
            }
            _ => RecordsWriter::Disk(Box::new(SpoolWriter::to_disk(scratch, name, ram_bytes))),
        }
    }

    pub fn push(&mut self, record: T) -> Result<(), StorageError> {
        match self {
            RecordsWriter::Ram(records) => {
                records.push(record);
                Ok(())
            }
            RecordsWriter::Disk(writer) => writer.push(record),
        }
    }

    pub fn finish(self) -> Result<Records<T>, StorageError> {
        match self {
            RecordsWriter::Ram(records) => Ok(Records::Ram(records)),
            RecordsWriter::Disk(writer) => Ok(Records::Disk(writer.finish()?)),
        }
    }
}

/// The fewest bytes of a page.
const PAGE_BYTES: usize = 8 << 10;
/// The fewest pages of a cache.
const FEWEST_PAGES: usize = 4;

/// Looks at runs of records anywhere, through a cache of its own where they are on disk.
#[derive(Debug)]
pub(super) struct Window<'a, T> {
    records: &'a Records<T>,
    /// Records in a page, a multiple of the run.
    page: u64,
    /// Pages of the records in the cache, one behind the other.
    cached: Vec<T>,
    slots: Vec<Slot>,
    most_slots: usize,
    slot_of: HashMap<u64, usize>,
    hand: usize,
}

#[derive(Debug, Clone, Copy)]
struct Slot {
    page: u64,
    is_used: bool,
}

impl<'a, T: Pod> Window<'a, T> {
    /// Looks at runs of `run` records, in a cache of at most `ram_bytes` (or four pages).
    pub fn new(records: &'a Records<T>, run: usize, ram_bytes: usize) -> Self {
        let run_bytes = run.max(1) * size_of::<T>();
        let page = run.max(1) * PAGE_BYTES.div_ceil(run_bytes);
        let most_slots = (ram_bytes / (page * size_of::<T>())).max(FEWEST_PAGES);
        Window {
            records,
            page: page as u64,
            cached: Vec::new(),
            slots: Vec::new(),
            most_slots,
            slot_of: HashMap::new(),
            hand: 0,
        }
    }

    /// The records of run number `run` of `length` records, the length that the window was made for. The last run may be
    /// shorter, and behind it they are empty.
    #[inline]
    pub fn run(&mut self, run: u64, length: usize) -> Result<&[T], StorageError> {
        let start = run * length as u64;
        let count = self.records.len().saturating_sub(start).min(length as u64) as usize;
        if let Records::Ram(records) = self.records {
            return Ok(records.get(start as usize..).map_or(&[], |rest| &rest[..count]));
        }
        let (page, offset) = (start / self.page, (start % self.page) as usize);
        let slot = match self.slot_of.get(&page) {
            Some(slot) => *slot,
            None => self.load(page)?,
        };
        self.slots[slot].is_used = true;
        Ok(&self.cached[slot * self.page as usize + offset..][..count])
    }

    #[cold]
    fn load(&mut self, page: u64) -> Result<usize, StorageError> {
        let slot = self.free_slot();
        let length = self.page as usize;
        self.records.read(page * self.page, &mut self.cached[slot * length..][..length])?;
        self.slots[slot].page = page;
        self.slot_of.insert(page, slot);
        Ok(slot)
    }

    /// A slot for a page that is to come.
    fn free_slot(&mut self) -> usize {
        if self.slots.len() < self.most_slots {
            if self.slots.is_empty() {
                // The system gives the memory when it is first touched.
                self.cached = vec![T::zeroed(); self.most_slots * self.page as usize];
            }
            self.slots.push(Slot { page: 0, is_used: false });
            return self.slots.len() - 1;
        }
        while std::mem::replace(&mut self.slots[self.hand].is_used, false) {
            self.hand = (self.hand + 1) % self.slots.len();
        }
        let slot = self.hand;
        self.hand = (self.hand + 1) % self.slots.len();
        self.slot_of.remove(&self.slots[slot].page);
        slot
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_the_same_in_ram_and_through_a_small_cache() {
        let folder = tempfile::tempdir().unwrap();
        let disk = std::sync::Arc::new(storage::LocalDisk);
        let (scratch, _) = Scratch::open(disk, &folder.path().join("scratch"), "").unwrap();
        let count = 100_003_u64;
        let written = |ram_bytes| {
            let mut writer = RecordsWriter::new(&scratch, "numbers", count, ram_bytes);
            (0..count).for_each(|number| writer.push(number).unwrap());
            writer.finish().unwrap()
        };
        let (ram, disk) = (written(1 << 20), written(1 << 10));
        assert!(matches!(ram, Records::Ram(_)) && matches!(disk, Records::Disk(_)));
        let mut windows = [&ram, &disk].map(|records| Window::new(records, 8, 1 << 16));
        let mut run = 0;
        for step in 0..50_000 {
            // Near the last one, mostly.
            run = if step % 7 == 0 { step * 7919 % 12_501 } else { (run + 3) % 12_501 };
            let expected: Vec<u64> = (run * 8..(run * 8 + 8).min(count)).collect();
            for window in &mut windows {
                assert_eq!(window.run(run, 8).unwrap(), expected);
                assert!(window.slots.len() <= 8);
            }
        }
        assert!(windows.iter_mut().all(|window| window.run(99_999, 8).unwrap().is_empty()));
    }
}
