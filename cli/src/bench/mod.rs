//! `vdt bench`: measurements of builds, on the meshes given, of what models state, of how they are blocked, and of flights.
//!
//! | module | what it does |
//! |---|---|
//! | [`table1`] | the paper's Table 1: construction times and file sizes |
//! | [`table2`] | the paper's Table 2: frame times by virtual memory and by our I/O |
//! | [`memory_share`] | memory as a share of what all takes |
//! | [`io`] | bytes moved against the memory limit |
//! | [`error`], [`cuts`] | stated errors of cuts against measured ones |
//! | [`blocking`], [`blockings`], [`flight`] | blockings: sizes, and what flights read |
//! | [`decode`] | how fast pages are decoded |
//! | [`soak`] | a long random walk with a disk that fails now and then |
//! | [`dependency`] | what the dependencies cost, and what they leave flipped |
//! | [`pictures`], [`likeness`] | what is drawn against the full mesh, point by point |
//! | [`surface`], [`open_sides`] | for that: the nearest triangle of a mesh; whether a mesh is as closed as it should be |
//! | [`uploads`] | what a renderer has to upload with each frame |
//! | [`child`] | builds and flights as processes of their own, in a temporary folder and in memory cgroups |
//! | [`figures`] | what a build says of itself |
//! | [`machine`] | on which machine it was measured |
//! | [`strategy`] | a strategy with its B-tree |
//! | [`plot`] | the pictures of all |

mod blocking;
mod blockings;
mod child;
mod cuts;
mod decode;
mod dependency;
mod error;
mod figures;
mod flight;
mod io;
mod likeness;
mod machine;
mod memory_share;
mod open_sides;
mod pictures;
mod plot;
mod soak;
mod strategy;
mod surface;
mod table1;
mod table2;
mod uploads;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;
use storage::{Disk, LocalDisk};

use crate::arguments::{BenchCommand, BenchOptions};
use crate::output::{may_write, write_text};

pub use blockings::Blockings;
pub use child::{Workshop, end};
pub use memory_share::MemoryShare;
pub use soak::end_early;
pub use strategy::StrategyChoice;

pub fn run(options: BenchOptions, json: bool) -> Result<()> {
    match options.command {
        BenchCommand::Table1(options) => table1::run(&options, json),
        BenchCommand::Table2(options) => table2::run(&options, json),
        BenchCommand::Io(options) => io::run(&options, json),
        BenchCommand::Error(options) => error::run(&options, json),
        BenchCommand::Blocking(options) => blocking::run(&options, json),
        BenchCommand::Decode(options) => decode::run(&options, json),
        BenchCommand::Soak(options) => soak::run(&options, json),
        BenchCommand::Dependency(options) => dependency::run(&options, json),
        BenchCommand::Pictures(options) => pictures::run(&options, json),
        BenchCommand::Uploads(options) => uploads::run(&options, json),
    }
}

/// Where temporary files go: to the folder asked for, or to the system's.
fn workshop_parent(scratch: Option<&Path>) -> PathBuf {
    scratch.map_or_else(std::env::temp_dir, Path::to_path_buf)
}

/// Refuses inputs that cannot be opened and a picture that cannot be written, before anything is measured.
fn check_files(meshes: &[&Path], plot: Option<&Path>, force: bool) -> Result<()> {
    for mesh in meshes {
        LocalDisk.open(mesh)?;
    }
    plot.map_or(Ok(()), |plot| may_write(&LocalDisk, plot, force, meshes))
}

fn write_plot(plot: &Path, picture: &str) -> Result<()> {
    write_text(Arc::new(LocalDisk), plot, picture)
}

/// Options of a build: each a name and, behind it, a value.
fn build_options(pairs: &[(&str, Option<String>)]) -> Vec<OsString> {
    let given = pairs.iter().filter_map(|(name, value)| Some([name.into(), value.as_ref()?.into()]));
    given.flatten().collect()
}

/// The name of a mesh in tables and pictures: that of its file.
fn mesh_name(mesh: &Path) -> String {
    mesh.file_name().unwrap_or(mesh.as_os_str()).to_string_lossy().into_owned()
}
