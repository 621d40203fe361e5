//! The tree of edges in redb.
//!
//! redb does its I/O through [`RandomFile`], so through a [`crate::Disk`]. The file is scratch: it is never opened again, so
//! nothing is ever waited for to reach the device, and a commit costs what it writes. Every so many changes are one
//! transaction: within one, redb changes in place the pages that it made; across commits it copies every page on the way
//! from the root to a change; but it keeps a list of all pages that a transaction made, which a commit empties.
//!
//! Memory: the cache as it was set.

use std::io;
use std::ops::Bound;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use redb::{Database, TableDefinition, WriteTransaction};

use crate::disk::StorageError;
use crate::random_file::{RandomFile, Traffic};
use crate::scratch::Scratch;

use super::{Change, Edge, EdgeTree, EdgeTreeError, in_turn};

type Table<'a> = redb::Table<'a, &'static [u8; 16], ()>;

const EDGES: TableDefinition<'static, &[u8; 16], ()> = TableDefinition::new("edges");

/// Changes in a transaction.
const CHANGES: u64 = 1 << 16;

/// Edges that are put in at once when the tree is loaded.
const BULK: usize = 1 << 12;

/// A file as redb sees it.
#[derive(Debug)]
struct Backend {
    file: Arc<RandomFile>,
    failure: Failure,
}

/// The first thing that went wrong with the file: redb itself passes on little of it, and nothing the second time.
type Failure = Arc<Mutex<Option<StorageError>>>;

impl Backend {
    fn report(&self, result: Result<(), StorageError>) -> io::Result<()> {
        result.map_err(|error| {
            let message = io::Error::other(error.to_string());
            self.failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
            message
        })
    }
}

impl redb::StorageBackend for Backend {
    fn len(&self) -> io::Result<u64> {
        Ok(self.file.length())
    }

    fn read(&self, offset: u64, out: &mut [u8]) -> io::Result<()> {
        self.report(self.file.read_at(offset, out))
    }

    fn set_len(&self, length: u64) -> io::Result<()> {
        self.report(self.file.set_length(length))
    }

    fn sync_data(&self) -> io::Result<()> {
        Ok(())
    }

    fn write(&self, offset: u64, data: &[u8]) -> io::Result<()> {
        self.report(self.file.write_at(offset, data))
    }
}

#[derive(Debug)]
pub(super) struct RedbTree {
    // Before the database, which writes when it is closed.
    transaction: Option<Transaction>,
    database: Database,
    file: Arc<RandomFile>,
    failure: Failure,
    length: u64,
}

struct Transaction {
    inner: WriteTransaction,
    changes: u64,
}

impl std::fmt::Debug for Transaction {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Transaction").field("changes", &self.changes).finish_non_exhaustive()
    }
}

impl RedbTree {
    /// A new tree in a new file.
    pub fn create(scratch: &Scratch, cache_bytes: u64) -> Result<Self, EdgeTreeError> {
        let file = Arc::new(RandomFile::create(scratch, "edges-redb")?);
        let failure = Failure::default();
        let backend = Backend { file: file.clone(), failure: failure.clone() };
        let database = Database::builder()
            .set_cache_size(usize::try_from(cache_bytes).unwrap_or(usize::MAX))
            .create_with_backend(backend)
            .map_err(|error| explain(&failure, file.path(), error))?;
        Ok(RedbTree { transaction: None, database, file, failure, length: 0 })
    }

    /// Does something to the table, within the transaction that is open. `work` also says how much it changed.
    fn with_table<R>(
        &mut self,
        work: impl FnOnce(&mut Table<'_>) -> Result<(R, u64), redb::Error>,
    ) -> Result<R, EdgeTreeError> {
        self.try_with_table(work).map_err(|error| explain(&self.failure, self.file.path(), error))
    }

    fn try_with_table<R>(
        &mut self,
        work: impl FnOnce(&mut Table<'_>) -> Result<(R, u64), redb::Error>,
    ) -> Result<R, redb::Error> {
        let mut open = match self.transaction.take() {
            Some(open) => open,
            None => Transaction { inner: self.database.begin_write()?, changes: 0 },
        };
        let (result, changes) = work(&mut open.inner.open_table(EDGES)?)?;
        open.changes += changes;
        if open.changes >= CHANGES {
            open.inner.commit()?;
        } else {
            self.transaction = Some(open);
        }
        Ok(result)
    }
}

/// What is to be said of a failure of redb: what the file said, where that was the cause.
fn explain(failure: &Failure, path: &Path, error: impl Into<redb::Error>) -> EdgeTreeError {
    match failure.lock().unwrap_or_else(PoisonError::into_inner).take() {
        Some(cause) => EdgeTreeError::Storage(cause),
        None => EdgeTreeError::Redb { path: path.to_path_buf(), source: Box::new(error.into()) },
    }
}

impl EdgeTree for RedbTree {
    fn bulk(&self) -> usize {
        BULK
    }

    fn delete_smallest(&mut self, is_taken: &mut dyn FnMut(Edge) -> bool) -> Result<(), EdgeTreeError> {
        let deleted = self.with_table(|table| {
            let mut deleted = 0;
            let mut cursor = table.lower_bound_mut(Bound::<&[u8; 16]>::Unbounded)?;
            loop {
                let next = cursor.peek_next()?.map(|(key, _)| Edge::from_bytes(*key.value()));
                if !next.is_some_and(&mut *is_taken) {
                    break;
                }
                cursor.remove_next()?;
                deleted += 1;
            }
            cursor.close()?;
            Ok((deleted, deleted))
        })?;
        self.length -= deleted;
        Ok(())
    }

    fn change(&mut self, deleted: &[Edge], inserted: &[Edge]) -> Result<u64, EdgeTreeError> {
        let [deleted, inserted] = self.with_table(|table| {
            let mut counts = [0, 0];
            for change in in_turn(deleted, inserted) {
                match change {
                    Change::Delete(edge) => counts[0] += u64::from(table.remove(&edge.to_bytes())?.is_some()),
                    Change::Insert(edge) => counts[1] += u64::from(table.insert(&edge.to_bytes(), ())?.is_none()),
                }
            }
            Ok((counts, counts[0] + counts[1]))
        })?;
        self.length = self.length + inserted - deleted;
        Ok(deleted)
    }

    fn len(&self) -> u64 {
        self.length
    }

    fn traffic(&self) -> Traffic {
        self.file.traffic()
    }
}
