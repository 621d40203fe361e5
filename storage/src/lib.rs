//! Disk access and the machine's resources, for all of vdt.
//!
//! Everything the libraries read or write goes through the [`Disk`] trait, so that a test can put a disk that
//! fails, fills up or tears writes in place of the real one ([`FaultyDisk`]). Nothing here knows what a mesh is.
//!
//! | module | what it holds |
//! |---|---|
//! | [`disk`] | the trait, and the machine's own file system behind it |
//! | [`direct_disk`] | the same, past the system's page cache |
//! | [`mapped_file`] | a file mapped into memory: virtual memory, to measure against |
//! | [`memory_cgroup`] | groups of processes that the system holds to a limit |
//! | [`memory_disk`] | a file system in RAM, for tests |
//! | [`faulty_disk`] | a disk that fails, or is slow, where a test says so |
//! | [`atomic_file`] | a file that appears whole under its name, or not at all |
//! | [`counting_disk`] | a disk that counts what passes through it |
//! | [`sequential`] | buffered reading of a file from front to back |
//! | [`byte_size`] | sizes as people write them: `16M`, `1.5G` |
//! | [`scratch`] | where temporary data goes |
//! | `buffers`, `background` | buffers that go from one store to the next; reads and writes beside the computation |
//! | [`spool`] | sequences of records: in RAM while they are small, in scratch files beyond |
//! | [`sorter`], `merge` | external sorting |
//! | [`guarded_extsort`] | external sorting by the crate `extsort`, behind guards |
//! | [`scatter`] | records into the order of dense keys |
//! | [`paged_array`] | an array on disk, with its pages in use in RAM |
//! | [`random_file`] | a scratch file that is read and written at any place |
//! | [`record_file`] | fixed-size records on disk by number, with the pages in use in RAM |
//! | [`edge_tree`] | the B-tree of edges on disk: one trait, redb and sled behind it |
//! | [`prefetch`] | large lists in RAM: fetching ahead, large memory pages |
//! | [`usage`] | what the operating system says of this process: peak RAM, CPU time |

pub mod atomic_file;
mod background;
mod buffers;
pub mod byte_size;
pub mod counting_disk;
pub mod direct_disk;
pub mod disk;
pub mod edge_tree;
pub mod faulty_disk;
pub mod guarded_extsort;
pub mod mapped_file;
pub mod memory_cgroup;
pub mod memory_disk;
mod merge;
pub mod paged_array;
pub mod prefetch;
pub mod random_file;
pub mod record_file;
pub mod scatter;
pub mod scratch;
pub mod sequential;
pub mod sorter;
pub mod spool;
pub mod usage;

pub use atomic_file::{AtomicFile, Standstill, remove_unfinished};
pub use byte_size::ByteSize;
pub use counting_disk::CountingDisk;
pub use direct_disk::DirectDisk;
pub use disk::{Block, Disk, LocalDisk, ReadAt, ScratchFile, StorageError, WriteFile};
pub use edge_tree::{Edge, EdgeTree, EdgeTreeError, EdgeTreeKind};
pub use faulty_disk::FaultyDisk;
pub use guarded_extsort::{GuardedSorted, GuardedSorter};
pub use mapped_file::{MapAdvice, MappedFile};
pub use memory_cgroup::MemoryCgroup;
pub use memory_disk::MemoryDisk;
pub use paged_array::PagedArray;
pub use random_file::Traffic;
pub use record_file::RecordFile;
pub use scatter::{KeptScattered, Scatter, Scattered};
pub use scratch::{ForeignFolder, Scratch};
pub use sequential::SequentialReader;
pub use sorter::{SortRecord, Sorted, Sorter};
pub use spool::{KeptSpool, Spool, SpoolReader, SpoolWriter};
