//! Pictures of what a [`Navigator`](navigator::Navigator) draws. Nothing here touches the disk.
//!
//! [`Projection`] says where on the picture a place of the model is, [`draw`] fills a [`Picture`] with the triangles of the front.
//! That is done without a graphics card or its driver, by the processor alone, and each time in the same way.

pub mod gpu;
mod picture;
mod projection;
mod rasteriser;

pub use picture::Picture;
pub use projection::Projection;
pub use rasteriser::{Buffers, Style, draw};
