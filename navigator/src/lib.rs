//! View-dependent navigation of a model file in a fixed amount of RAM: the run-time half of El-Sana and Chiang,
//! *External Memory View-Dependent Simplification* (2000), "the paper".
//!
//! | module | what it does | where it comes from |
//! |---|---|---|
//! | [`camera`] | a camera and its text form | |
//! | [`path`] | camera paths: from a file, an orbit, a flight over the surface | |
//! | [`random`] | random numbers, the same for the same seed | |
//! | [`walk`] | an endless random walk over the surface, with jumps and stops | |
//! | [`view`] | a camera looking at a model: the error of a node in pixels | the paper, 3.3.1 |
//! | [`view_parameters`] | what counts in it: frustum, cones, silhouettes, light | 3.3.1 |
//! | [`evaluation`] | the criterion, for nodes and for blocks of them | 3.3.1 |
//! | `front` | the lists of active nodes and active triangles, split and collapse, and the streams to draw | 3.3.1 |
//! | `split_queue`, `collapse_queue`, `window` | in which order they change, with what is looked at fetched ahead | 3.3.1, 3.3.5 |
//! | `dependency` | implicit dependency by ids | 3.3.5 |
//! | `flip` | which triangles may be drawn the wrong way round | design, 5 |
//! | `refine` | a split with all that it forces | 3.3.5 |
//! | `pool` | the place holders: hash table, free list, second chance, never all in use | 3.3.2, 3.3.3 |
//! | `board` | the command board | 3.3.4 |
//! | `io_process` | the I/O process: threads that read and decode | 3.3.2, 3.3.4 |
//! | `prediction` | where the camera will be: what is prefetched | 6 |
//! | `paging` | the navigator's side of pool and board | 3.3.3, 3.3.4 |
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
mod collapse_queue;
mod dependency;
pub mod evaluation;
mod flip;
mod front;
mod io_process;
pub mod navigator;
mod paging;
pub mod path;
mod pool;
mod prediction;
pub mod random;
mod refine;
mod split_queue;
pub mod statistics;
pub mod view;
pub mod view_parameters;
pub mod walk;
mod window;

#[cfg(test)]
mod property_tests;
#[cfg(test)]
mod testing;

pub use budget::{Budget, BudgetError, plan};
pub use camera::Camera;
pub use dependency::Dependency;
pub use front::{DrawnWedge, Misfit};
pub use io_process::Io;
pub use navigator::{
    ActiveMetaNode, ActiveNode, ActiveTriangle, AppliedSplit, MAX_ADAPTS, Navigator, NavigatorError, NavigatorOptions,
};
pub use path::PathSpec;
pub use pool::{Policy, PoolCounters};
pub use statistics::{FlightSummary, FrameStatistics};
pub use view_parameters::{Light, ViewParameters, ViewParametersError};
pub use walk::RandomWalk;
