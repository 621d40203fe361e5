//! The B-tree of edges on disk (the paper, 3.1.2, step 1): the edges of a mesh by what their collapse costs, of which the
//! smallest are deleted again and again, while others are put in.
//!
//! One trait, [`EdgeTree`], with two backends: `redb`, which keeps to a bound of memory, and `sled`, which does not and is
//! allowed only where the memory is above what it was measured to take ([`sled_needs`]).
//!
//! An edge is its key: nothing is stored with it. (The paper keeps the triangles that share an edge with it. Here whole
//! stars are needed, and they lie in a store of their own by vertex; the ends of the edge lead there.) So an entry has 16
//! bytes, and the tree is a set: an edge that is put in twice with the same key is there once.

mod redb_tree;
mod sled_tree;

use std::fmt;
use std::str::FromStr;

use std::fmt::Debug;
use std::path::PathBuf;

use bytemuck::{Pod, Zeroable};
use thiserror::Error;

use crate::byte_size::ByteSize;
use crate::disk::StorageError;
use crate::random_file::Traffic;
use crate::scratch::Scratch;
use crate::sorter::SortRecord;

use redb_tree::RedbTree;
use sled_tree::SledTree;
pub use sled_tree::needs as sled_needs;

/// An edge with its place in the order of collapses: by its fields, from the first to the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Pod, Zeroable)]
#[repr(C)]
pub struct Edge {
    /// What the collapse costs, as bits that order as the costs do.
    pub key: u32,
    /// What decides between equal keys.
    pub tie: u32,
    /// The smaller vertex.
    pub low: u32,
    /// The larger vertex, and in the top bit a direction.
    pub high: u32,
}

impl Edge {
    /// Bytes that order as edges do.
    pub fn to_bytes(self) -> [u8; 16] {
        let Edge { key, tie, low, high } = self;
        let [key, tie, low, high] = [key, tie, low, high].map(u128::from);
        (key << 96 | tie << 64 | low << 32 | high).to_be_bytes()
    }

    /// The edge of such bytes.
    pub fn from_bytes(bytes: [u8; 16]) -> Self {
        let bits = u128::from_be_bytes(bytes);
        let [key, tie, low, high] = [96, 64, 32, 0].map(|shift| (bits >> shift) as u32);
        Edge { key, tie, low, high }
    }
}

impl SortRecord for Edge {
    fn prefix(&self) -> u64 {
        u64::from(self.key) << 32 | u64::from(self.tie)
    }
}

/// Why a tree of edges failed.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum EdgeTreeError {
    /// The disk failed or is full.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// redb failed.
    #[error("the edge tree {} failed: {source}", path.display())]
    Redb {
        /// Its file.
        path: PathBuf,
        /// What redb said.
        source: Box<redb::Error>,
    },
    /// sled failed.
    #[error("the edge tree {} failed: {source}", path.display())]
    Sled {
        /// Its folder.
        path: PathBuf,
        /// What sled said.
        source: sled::Error,
    },
    /// A key in the tree is not one of ours.
    #[error("the edge tree {} holds a key of {length} bytes, where every key has 16; it was altered", path.display())]
    ForeignKey {
        /// Its file or folder.
        path: PathBuf,
        /// Bytes of the key.
        length: usize,
    },
    /// sled would need more memory than there is.
    #[error(
        "with {edges} edges, sled was measured to take {needed} of memory for the edge tree, but it may have {share}"
    )]
    SledMemory {
        /// Edges of the mesh.
        edges: u64,
        /// What sled takes.
        needed: ByteSize,
        /// What it may have.
        share: ByteSize,
    },
}

/// Edges on disk, in order.
pub trait EdgeTree: Debug {
    /// Edges that are best put in at once.
    fn bulk(&self) -> usize;

    /// Puts edges into an empty tree, which `next` hands out in ascending order, `None` behind the last.
    fn bulk_load(&mut self, next: &mut dyn FnMut() -> Result<Option<Edge>, StorageError>) -> Result<(), EdgeTreeError> {
        let mut edges = Vec::with_capacity(self.bulk());
        loop {
            while edges.len() < self.bulk()
                && let Some(edge) = next()?
            {
                edges.push(edge);
            }
            if edges.is_empty() {
                return Ok(());
            }
            self.change(&[], &edges)?;
            edges.clear();
        }
    }

    /// Deletes the smallest edges, as long as `is_taken` says so: it is asked once for each, in ascending order, and the
    /// first one that is not taken stays.
    fn delete_smallest(&mut self, is_taken: &mut dyn FnMut(Edge) -> bool) -> Result<(), EdgeTreeError>;

    /// Deletes edges and puts others in, all in one go through the tree where both are in ascending order. Edges to delete
    /// that are not there are passed over; returns how many were there. No edge is among both.
    fn change(&mut self, deleted: &[Edge], inserted: &[Edge]) -> Result<u64, EdgeTreeError>;

    /// Edges in the tree.
    fn len(&self) -> u64;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// What passed between RAM and the tree's files so far.
    fn traffic(&self) -> Traffic;
}

/// A change of a tree, edge by edge.
enum Change {
    Delete(Edge),
    Insert(Edge),
}

/// Both lists as one, in ascending order where they are.
fn in_turn<'a>(deleted: &'a [Edge], inserted: &'a [Edge]) -> impl Iterator<Item = Change> + 'a {
    let (mut deleted, mut inserted) = (deleted.iter().copied().peekable(), inserted.iter().copied().peekable());
    std::iter::from_fn(move || match (deleted.peek(), inserted.peek()) {
        (Some(first), Some(second)) if first < second => deleted.next().map(Change::Delete),
        (Some(_), None) => deleted.next().map(Change::Delete),
        _ => inserted.next().map(Change::Insert),
    })
}

/// The B-trees there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EdgeTreeKind {
    /// redb.
    #[default]
    Redb,
    /// sled.
    Sled,
}

impl fmt::Display for EdgeTreeKind {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(self.name())
    }
}

/// A name that no edge tree has.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("there is no edge tree `{name}`; there are redb and sled")]
pub struct UnknownEdgeTreeError {
    name: String,
}

impl FromStr for EdgeTreeKind {
    type Err = UnknownEdgeTreeError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        let found = EdgeTreeKind::ALL.into_iter().find(|kind| kind.name() == name);
        found.ok_or_else(|| UnknownEdgeTreeError { name: name.to_owned() })
    }
}

impl EdgeTreeKind {
    /// All of them.
    pub const ALL: [EdgeTreeKind; 2] = [EdgeTreeKind::Redb, EdgeTreeKind::Sled];

    /// Its name, as the command line has it.
    fn name(self) -> &'static str {
        match self {
            EdgeTreeKind::Redb => "redb",
            EdgeTreeKind::Sled => "sled",
        }
    }

    /// A new, empty tree for at first so many edges, that takes at most `ram_bytes`. Its files are gone with it.
    ///
    /// sled does its own I/O: the scratch must be on the machine's file system.
    ///
    /// # Errors
    ///
    /// [`EdgeTreeError::SledMemory`] where sled would take more than `ram_bytes`.
    pub fn create(self, scratch: &Scratch, edges: u64, ram_bytes: u64) -> Result<Box<dyn EdgeTree>, EdgeTreeError> {
        match self {
            EdgeTreeKind::Redb => Ok(Box::new(RedbTree::create(scratch, ram_bytes)?)),
            EdgeTreeKind::Sled => {
                let needed = sled_needs(edges);
                if needed.0 > ram_bytes {
                    return Err(EdgeTreeError::SledMemory { edges, needed, share: ByteSize(ram_bytes) });
                }
                Ok(Box::new(SledTree::create(scratch)?))
            }
        }
    }
}

#[cfg(test)]
mod tests;
