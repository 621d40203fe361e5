//! A window onto a model: what `vdt view` opens.
//!
//! | module | what it does |
//! |---|---|
//! | `app` | the window's life: opening, events, when a frame is drawn |
//! | `session` | a model being looked at: navigator, scene and cameras, frame by frame |
//! | `controls` | how mouse and keys move a camera |
//! | `keys` | what each key does |
//! | `pick` | what of the surface is under the cursor |
//! | `overlay` | figures, sliders, help and messages over the picture |
//! | `notes` | those messages, and how long they stay |
//! | `interface` | the overlay's way from the window and to the picture |
//! | `canvas` | the surface of the window |
//! | `screenshot` | the picture as a PNG file |
//! | `recording` | a camera path as it is flown |
//! | `last_view` | the view with which a model was left |
//! | `free_name` | names that no file has yet |
//! | `frame_times` | how long frames took |
//!
//! A frame is drawn when something has changed: by whoever sits before it, or because the picture is not finished. Else the
//! program sleeps. What opens a file, and builds the model of a mesh, comes from outside as an [`Opener`] and runs in a thread of
//! its own.

mod app;
mod canvas;
mod controls;
mod frame_times;
mod free_name;
mod interface;
mod keys;
mod last_view;
mod notes;
mod overlay;
mod pick;
mod recording;
mod screenshot;
mod session;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use metanode::model::Model;
use navigator::Camera;
use render::gpu::GpuError;
use thiserror::Error;
use winit::error::{EventLoopError, OsError};

pub use last_view::LastViews;

/// How far the opening of a file is.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Progress {
    /// What is being done.
    pub phase: String,
    /// What part of all is done, 0 to 1.
    pub share: f64,
}

/// A file that is open.
#[derive(Debug)]
pub struct Opened {
    /// The model.
    pub model: Model,
    /// What there is to know about it.
    pub notes: Vec<String>,
}

/// What opens files.
pub trait Opener: Send + Sync {
    /// Opens the model at `path`, or builds that of the mesh there, and tells how far that is: opening does not tell anything,
    /// building does. An error says what is wrong, for people.
    fn open(&self, path: &Path, tell: &mut (dyn FnMut(Progress) + Send)) -> Result<Opened, String>;
}

/// What to look at, and how.
#[derive(Debug, Clone)]
pub struct ViewOptions {
    /// The file; without one, the window waits for a file to be dropped onto it.
    pub file: Option<PathBuf>,
    /// Bytes of RAM for the navigation.
    pub memory: u64,
    /// Bytes of memory of the graphics card.
    pub gpu_memory: u64,
    /// Error to be seen at most, in pixels.
    pub pixels: f32,
    /// Most triangles to be drawn.
    pub max_triangles: Option<u64>,
    /// Width and height of the window in points of the screen, as far as the screen allows.
    pub size: [u32; 2],
    /// Where to look from at first; else from where the model was left, or at all of it.
    pub camera: Option<Camera>,
    /// Where the last view of each model is kept, if anywhere.
    pub state_folder: Option<PathBuf>,
    /// Is told what goes wrong while the window is open; it is shown there, too.
    pub tell: fn(&str),
}

/// What was seen.
#[derive(Debug, Clone, Default)]
pub struct Summary {
    /// The model that was looked at last.
    pub model: Option<PathBuf>,
    /// Why nothing was looked at after the last file that was to be opened.
    pub unopened: Option<String>,
    /// Whether the window was closed while a model was being built: then the build goes on until the program ends.
    pub is_building: bool,
    /// Frames drawn, of any model.
    pub frames: u64,
    /// How long a frame took, without waiting for the screen, in milliseconds: median of the last 65,536.
    pub frame_ms_p50: f64,
    /// The 99th percentile of the same.
    pub frame_ms_p99: f64,
    /// Triangles in the last frame.
    pub triangles: u64,
    /// Triangles of the model.
    pub model_triangles: u64,
    /// Largest error in the last frame, in pixels.
    pub pixels_drawn: f32,
    /// Splits and collapses, all together.
    pub adapts: u64,
    /// Splits that had to wait for a page, all together.
    pub misses: u64,
    /// Reads of the navigation.
    pub reads: u64,
    /// Bytes that they read.
    pub bytes_read: u64,
    /// Bytes that went to the graphics card for the model.
    pub uploaded_bytes: u64,
    /// Bytes of RAM allocated for the navigation at the end.
    pub budget_bytes: u64,
    /// Bytes of the graphics card in use at the end.
    pub gpu_bytes: u64,
    /// Whether the last picture was finished.
    pub is_settled: bool,
    /// Seconds from the beginning to the first picture of a model.
    pub first_picture_seconds: Option<f64>,
    /// What drew.
    pub renderer: String,
    /// Whether that was the processor.
    pub is_processor: bool,
    /// Path files that were recorded.
    pub paths: Vec<PathBuf>,
    /// Pictures that were kept.
    pub screenshots: Vec<PathBuf>,
}

/// Why there is no window.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ViewError {
    /// There is no display.
    #[error(
        "cannot open a window, there is no display to be reached ({problem}); `vdt render` makes pictures without one"
    )]
    Display {
        /// What winit said.
        problem: String,
    },
    /// The display gives no window.
    #[error("the display gives no window ({problem}); `vdt render` makes pictures without one")]
    Window {
        /// What winit said.
        problem: String,
    },
    /// Nothing can draw in the window.
    #[error("no graphics driver can draw in the window ({problem}). {DRIVERS}")]
    Surface {
        /// What wgpu said.
        problem: String,
    },
    /// The graphics card does not do.
    #[error("{source}. {DRIVERS}")]
    Gpu {
        /// What is missing.
        #[from]
        source: GpuError,
    },
    /// The window has no format of colours that can be drawn in.
    #[error("the graphics driver can draw in this window in no format; `vdt render` makes pictures without it")]
    NoFormat,
}

/// What to do without a driver.
const DRIVERS: &str = "A driver for Vulkan or OpenGL is needed, such as Mesa's (the package mesa-vulkan-drivers), which can do \
                       with the processor; `vdt render` makes pictures without any";

impl From<EventLoopError> for ViewError {
    fn from(error: EventLoopError) -> Self {
        ViewError::Display { problem: without_place(&error.to_string()) }
    }
}

impl From<OsError> for ViewError {
    fn from(error: OsError) -> Self {
        ViewError::Window { problem: without_place(&error.to_string()) }
    }
}

impl From<wgpu::CreateSurfaceError> for ViewError {
    fn from(error: wgpu::CreateSurfaceError) -> Self {
        // Behind the colon it lists what each driver said, of which there may be none.
        let problem = error.to_string().trim_end_matches(": {}").to_owned();
        ViewError::Surface { problem }
    }
}

/// What winit says, without the line of its source that says it.
fn without_place(said: &str) -> String {
    let behind = said.split_once(".rs:").and_then(|(_, behind)| behind.split_once(": "));
    behind.map_or(said, |(_, problem)| problem).trim_end_matches('.').to_owned()
}

/// Opens a window, and returns when it is closed. To be called from the main thread of a program, once.
pub fn run(options: ViewOptions, opener: Arc<dyn Opener>) -> Result<Summary, ViewError> {
    app::run(options, opener)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn problems_are_told_without_places_in_the_source() {
        let said = "os error at /home/x/.cargo/winit-0.30.13/src/linux/mod.rs:765: neither A: nor B is set.";
        assert_eq!(without_place(said), "neither A: nor B is set");
        assert_eq!(without_place("the event loop failed"), "the event loop failed");
    }
}
