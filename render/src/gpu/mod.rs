//! Drawing on a graphics device, by `wgpu`.
//!
//! | module | what it does |
//! |---|---|
//! | `device` | finds a driver, and asks what it allows |
//! | `mirror` | copies of streams on the device: sends what has changed |
//! | `scene` | a front on the device, and how it is drawn |
//! | `textures` | the textures of materials on the device |
//! | [`read_back`] | textures that are drawn into, read back |
//! | `off_screen` | pictures without a window |

mod device;
mod mirror;
mod off_screen;
pub mod read_back;
mod scene;
mod textures;

pub use device::{Drivers, Gpu, GpuError};
pub use mirror::Upload;
pub use off_screen::OffScreen;
pub use scene::{Scene, SceneOptions, SceneView};
