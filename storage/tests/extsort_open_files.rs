//! The trap of `extsort` that is a limit of the process: a file of its own, since it lowers that limit.

#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::io::{self, Read, Write};
use std::sync::Arc;

use extsort::{ExternalSorter, Sortable};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use vdt_storage::{Edge, GuardedSorter, LocalDisk, Scratch};

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Number(u32);

impl Sortable for Number {
    fn encode<W: Write>(&self, writer: &mut W) -> io::Result<()> {
        writer.write_all(&self.0.to_le_bytes())
    }

    fn decode<R: Read>(reader: &mut R) -> io::Result<Self> {
        let mut bytes = [0; 4];
        reader.read_exact(&mut bytes)?;
        Ok(Number(u32::from_le_bytes(bytes)))
    }
}

/// 2,000 runs where 256 files may be open: extsort fails; the guarded sorter does not.
#[test]
fn many_runs_need_few_files() {
    setrlimit(Resource::Nofile, Rlimit { current: Some(256), ..getrlimit(Resource::Nofile) }).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let bare = ExternalSorter::new().with_segment_size(9).with_sort_dir(folder.path().to_path_buf());
    let error = bare.sort((0..20_005).map(Number)).map(|_| ()).unwrap_err();
    assert_eq!(error.raw_os_error(), Some(rustix::io::Errno::MFILE.raw_os_error()), "{error}");

    let (scratch, _) = Scratch::open(Arc::new(LocalDisk), &folder.path().join("scratch"), "test").unwrap();
    let edge = |number: u32| Edge { key: number.wrapping_mul(0x9e37_79b9) >> 1, tie: 0, low: 0, high: number };
    // 64 records of 16 bytes in a run, and two runs in a batch; or as many runs as may be in a batch.
    for (ram_bytes, records) in [(1024, 64), (2 << 20, 1 << 17)] {
        let count = if records == 64 { 2000 * records } else { 131 * records };
        let mut sorter = GuardedSorter::new(&scratch, "edges", ram_bytes);
        (0..count).try_for_each(|number| sorter.push(edge(number))).unwrap();
        let mut sorted = sorter.finish().unwrap();
        let (mut before, mut found) = (None, 0);
        while let Some(edge) = sorted.next().unwrap() {
            assert!(before.replace(edge).is_none_or(|before| before < edge));
            found += 1;
        }
        assert_eq!(found, count);
    }
}
