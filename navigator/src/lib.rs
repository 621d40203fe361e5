//! View-dependent navigation of a model file in a fixed amount of RAM: the run-time half of El-Sana and Chiang,
//! *External Memory View-Dependent Simplification* (2000), "the paper".
//!
//! | module | what it does | where it comes from |
//! |---|---|---|
//! | [`camera`] | a camera and its text form | |
//! | [`path`] | camera paths: from a file, an orbit, a flight over the surface | |
//! | [`view`] | the error of a node in pixels | the paper, 3.3.1 |
//! | `front` | the lists of active nodes and active triangles, split and collapse | 3.3.1 |
//! | `dependency` | implicit dependency by ids | 3.3.5 |
//! | `refine` | a split with all that it forces | 3.3.5 |
//! | `pool` | the place holders: hash table, free list, second chance, never all in use | 3.3.2, 3.3.3 |
//! | `board` | the command board | 3.3.4 |
//! | `io_process` | the I/O process: prefetching, urgent loading | 3.3.2, 3.3.4 |
//! | `paging` | the navigator's side of pool and board | 3.3.3, 3.3.4 |
//! | `mapped` | pages by virtual memory, for comparison | 4 |
//! | `budget` | how the memory allowed is shared out | design, 5 |
//! | [`navigator`] | the frames | 3.3.1, 3.3.2 |
//! | [`statistics`] | what frames and flights did | 4 |
//! | [`check`] | whether front and pool are well-formed | design, 6 |
//!
//! It runs without a GPU and without a window: a [`Navigator`] is given a camera and has the triangles to be drawn.

mod board;
mod budget;
pub mod camera;
pub mod check;
mod dependency;
mod front;
mod io_process;
mod mapped;
pub mod navigator;
mod paging;
pub mod path;
mod pool;
mod refine;
pub mod statistics;
pub mod view;

#[cfg(test)]
mod property_tests;
#[cfg(test)]
mod testing;

pub use budget::{Budget, BudgetError, plan};
pub use camera::Camera;
pub use dependency::Dependency;
pub use front::Misfit;
pub use io_process::Io;
pub use navigator::{ActiveNode, ActiveTriangle, AppliedSplit, Navigator, NavigatorError, NavigatorOptions};
pub use path::PathSpec;
pub use statistics::{FlightSummary, FrameStatistics};
