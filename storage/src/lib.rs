//! Disk access and the machine's resources, for all of vdt.
//!
//! Everything the libraries read or write goes through the [`Disk`] trait, so that a test can put a disk that
//! fails, fills up or tears writes in place of the real one ([`FaultyDisk`]). Nothing here knows what a mesh is.
//!
//! | module | what it holds |
//! |---|---|
//! | [`disk`] | the trait, and the machine's own file system behind it |
//! | [`memory_disk`] | a file system in RAM, for tests |
//! | [`faulty_disk`] | a disk that fails where a test says so |
//! | [`atomic_file`] | a file that appears whole under its name, or not at all |
//! | [`counting_disk`] | a disk that counts what passes through it |
//! | [`sequential`] | buffered reading of a file from front to back |
//! | [`byte_size`] | sizes as people write them: `16M`, `1.5G` |
//! | [`usage`] | what the operating system says of this process: peak RAM, CPU time |

pub mod atomic_file;
pub mod byte_size;
pub mod counting_disk;
pub mod disk;
pub mod faulty_disk;
pub mod memory_disk;
pub mod sequential;
pub mod usage;

pub use atomic_file::{AtomicFile, Standstill, remove_unfinished};
pub use byte_size::ByteSize;
pub use counting_disk::CountingDisk;
pub use disk::{Disk, LocalDisk, ReadAt, StorageError, WriteFile};
pub use faulty_disk::FaultyDisk;
pub use memory_disk::MemoryDisk;
pub use sequential::SequentialReader;
