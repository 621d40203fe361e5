//! The tree of edges in sled.
//!
//! sled keeps no bound of memory: what it takes beyond its cache was measured, see [`needs`]. It does its own I/O, past
//! [`crate::Disk`]; what passes is taken from the operating system's count for this process, around each call.

use std::path::PathBuf;

use crate::byte_size::ByteSize;
use crate::random_file::Traffic;
use crate::scratch::{ForeignFolder, Scratch};
use crate::usage::bytes_read_and_written;

use super::{Change, Edge, EdgeTree, EdgeTreeError, in_turn};

/// Memory that sled takes for a tree of at first so many edges.
///
/// With a cache of 2 MiB it was measured to take 35 MB with 0.3 million edges, 72 MB with 1 million, and 171 MB and slowly
/// rising with 3 million when it was stopped after 15 minutes (sled 0.34.7, `examples/edge_tree_memory.rs`; with a cache
/// of 16 MiB, 67, 143 and 246 MB; with 10 million more than 548 MB, `facts/storage.md`). What is asked for is half as much
/// again and more, for trees that grow: on a scan the tree had at most 1.07 times as many edges as in the beginning.
pub fn needs(edges: u64) -> ByteSize {
    ByteSize((32 << 20) + edges.saturating_mul(96))
}

/// sled's own cache: more makes it take still more, for little speed.
const CACHE_BYTES: u64 = 2 << 20;

/// Edges that go to sled at once.
const BATCH: usize = 1 << 10;

#[derive(Debug)]
pub(super) struct SledTree {
    database: sled::Db,
    length: u64,
    traffic: Traffic,
    // The last to go.
    folder: ForeignFolder,
}

impl SledTree {
    /// A new tree in a new folder.
    pub fn create(scratch: &Scratch) -> Result<Self, EdgeTreeError> {
        let folder = scratch.foreign_folder("edges-sled")?;
        let config = sled::Config::new()
            .path(folder.path())
            .cache_capacity(CACHE_BYTES)
            .mode(sled::Mode::LowSpace)
            .flush_every_ms(None);
        match config.open() {
            Ok(database) => Ok(SledTree { database, length: 0, traffic: Traffic::default(), folder }),
            Err(source) => Err(EdgeTreeError::Sled { path: folder.path().to_path_buf(), source }),
        }
    }

    /// Does something with the database, and counts what the process reads and writes meanwhile.
    fn counted<R>(&mut self, work: impl FnOnce(&sled::Db) -> sled::Result<R>) -> Result<R, EdgeTreeError> {
        let before = bytes_read_and_written().unwrap_or_default();
        let result = work(&self.database);
        let after = bytes_read_and_written().unwrap_or_default();
        self.traffic.read += after.0.saturating_sub(before.0);
        self.traffic.written += after.1.saturating_sub(before.1);
        result.map_err(|source| EdgeTreeError::Sled { path: self.path(), source })
    }
}

impl SledTree {
    fn path(&self) -> PathBuf {
        self.folder.path().to_path_buf()
    }
}

impl EdgeTree for SledTree {
    fn bulk(&self) -> usize {
        BATCH
    }

    fn delete_smallest(&mut self, is_taken: &mut dyn FnMut(Edge) -> bool) -> Result<(), EdgeTreeError> {
        loop {
            // In batches, since a scan is far cheaper than asking for the smallest again and again.
            let mut more = true;
            let mut foreign = None;
            let deleted = self.counted(|database| {
                let mut batch = sled::Batch::default();
                let mut deleted = 0;
                for entry in database.iter() {
                    let (key, _) = entry?;
                    let Ok(bytes) = <[u8; 16]>::try_from(&*key) else {
                        foreign = Some(key.len());
                        break;
                    };
                    more = is_taken(Edge::from_bytes(bytes));
                    if !more {
                        break;
                    }
                    batch.remove(key);
                    deleted += 1;
                    if deleted == BATCH as u64 {
                        break;
                    }
                }
                database.apply_batch(batch)?;
                Ok(deleted)
            })?;
            self.length -= deleted;
            if let Some(length) = foreign {
                return Err(EdgeTreeError::ForeignKey { path: self.path(), length });
            }
            if !more || deleted < BATCH as u64 {
                return Ok(());
            }
        }
    }

    fn change(&mut self, deleted: &[Edge], inserted: &[Edge]) -> Result<u64, EdgeTreeError> {
        let [deleted, inserted] = self.counted(|database| {
            let mut counts = [0, 0];
            for change in in_turn(deleted, inserted) {
                match change {
                    Change::Delete(edge) => counts[0] += u64::from(database.remove(edge.to_bytes())?.is_some()),
                    Change::Insert(edge) => counts[1] += u64::from(database.insert(edge.to_bytes(), &[])?.is_none()),
                }
            }
            Ok(counts)
        })?;
        self.length = self.length + inserted - deleted;
        Ok(deleted)
    }

    fn len(&self) -> u64 {
        self.length
    }

    fn traffic(&self) -> Traffic {
        self.traffic
    }
}
