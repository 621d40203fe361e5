//! Pictures of what a [`Navigator`](navigator::Navigator) draws. Nothing here touches the disk.
//!
//! | module | what it does |
//! |---|---|
//! | `projection` | where on the picture a place of the model is |
//! | `style` | what is to be seen |
//! | [`looks`] | what materials look like, textures |
//! | `colours` | parts of light, and how they are stored |
//! | `painter` | draws pictures by a graphics device, or else by the processor |
//! | `picture` | a picture in RAM |
//! | `rasteriser` | draws by the processor alone, each time in the same way |
//! | [`levels`] | levels of detail as colours |
//! | [`boxes`] | meta-nodes as boxes |
//! | [`gpu`] | draws on a graphics device, with or without a window |

pub mod boxes;
mod colours;
pub mod gpu;
pub mod levels;
pub mod looks;
mod painter;
mod picture;
mod projection;
mod rasteriser;
mod style;

pub use looks::{Looks, Room};
pub use painter::{Painter, PainterError, Renderer};
pub use picture::Picture;
pub use projection::Projection;
pub use rasteriser::{Buffers, draw, draw_lines};
pub use style::Style;
