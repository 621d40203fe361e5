//! Draws pictures by a graphics device where there is one, else by the processor.

use metanode::model::Model;
use navigator::Navigator;
use storage::StorageError;
use thiserror::Error;

use crate::boxes::box_lines;
use crate::gpu::{Drivers, Gpu, GpuError, OffScreen, Scene, SceneOptions, SceneView, Upload};
use crate::levels::Levels;
use crate::looks::{Looks, Room};
use crate::picture::Picture;
use crate::projection::Projection;
use crate::rasteriser::{Buffers, draw, draw_lines};
use crate::style::Style;

/// The part of the memory that textures may take.
const TEXTURE_PART: u64 = 4;

/// What pictures are to be drawn by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Renderer {
    /// Graphics hardware where there is any that will do, else the processor.
    Auto,
    /// A graphics driver, and be it one that draws by the processor.
    Gpu,
    /// The processor, without a driver: within the memory that a picture takes.
    Software,
}

/// What can go wrong before anything is drawn.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PainterError {
    /// With the graphics driver.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// Images cannot be read.
    #[error(transparent)]
    Storage(#[from] StorageError),
}

/// What draws pictures of one size, of one model.
#[derive(Debug)]
pub struct Painter(Means);

#[derive(Debug)]
enum Means {
    Processor { levels: Levels, looks: Looks },
    Device(Box<OnDevice>),
}

#[derive(Debug)]
struct OnDevice {
    gpu: Gpu,
    scene: Scene,
    off_screen: OffScreen,
    /// What images are not drawn, and why.
    problems: Vec<String>,
}

impl Painter {
    /// Finds what to draw by: pictures of `width` × `height` points, in at most `gpu_memory` bytes on a device and a quarter of
    /// `memory` bytes of RAM for textures. While images are decoded, all of `memory` may be used.
    pub fn open(
        renderer: Renderer,
        model: &Model,
        [width, height]: [u32; 2],
        [memory, gpu_memory]: [u64; 2],
    ) -> Result<Self, PainterError> {
        let drivers = match renderer {
            Renderer::Auto => Drivers::Hardware,
            Renderer::Gpu => Drivers::Any,
            Renderer::Software => return Self::processor(model, memory),
        };
        match OnDevice::open(drivers, model, [width, height], [memory, gpu_memory]) {
            Err(PainterError::Gpu(GpuError::NoDriver { .. } | GpuError::TooLittle { .. }))
                if renderer == Renderer::Auto =>
            {
                Self::processor(model, memory)
            }
            opened => Ok(Painter(Means::Device(Box::new(opened?)))),
        }
    }

    fn processor(model: &Model, memory: u64) -> Result<Self, PainterError> {
        let bytes = memory / TEXTURE_PART;
        let room = Room { bytes, decoding_bytes: memory - bytes, most_side: u32::MAX, most_textures: u32::MAX };
        Ok(Painter(Means::Processor { levels: Levels::default(), looks: Looks::of(model, room)? }))
    }

    /// Bytes of RAM that it holds for what it draws.
    pub fn bytes(&self) -> u64 {
        match &self.0 {
            Means::Processor { looks, .. } => looks.bytes(),
            Means::Device(_) => 0,
        }
    }

    /// What images are not drawn, and why.
    pub fn problems(&self) -> &[String] {
        match &self.0 {
            Means::Processor { looks, .. } => looks.problems(),
            Means::Device(device) => &device.problems,
        }
    }

    /// The driver and the device; none where the processor draws without one.
    pub fn device(&self) -> Option<&Gpu> {
        match &self.0 {
            Means::Processor { .. } => None,
            Means::Device(device) => Some(&device.gpu),
        }
    }

    /// The most triangles that there is memory for on the device.
    pub fn most_triangles(&self) -> Option<u64> {
        match &self.0 {
            Means::Processor { .. } => None,
            Means::Device(device) => Some(device.scene.most_triangles()),
        }
    }

    /// Bytes of RAM for each point of a picture, beside it, while it is drawn.
    pub fn point_bytes(&self) -> u64 {
        match &self.0 {
            Means::Processor { .. } => 0,
            Means::Device(_) => OffScreen::POINT_BYTES,
        }
    }

    /// Draws a picture of a navigator's front, which is then taken to be copied: it forgets its changes. What was sent to the
    /// device for it.
    pub fn paint(
        &mut self,
        picture: &mut Picture,
        navigator: &mut Navigator,
        projection: &Projection,
        style: Style,
    ) -> Result<Upload, GpuError> {
        match &mut self.0 {
            Means::Processor { levels, looks } => {
                if style.levels {
                    levels.update(navigator);
                }
                let buffers = Buffers {
                    vertices: navigator.vertex_stream(),
                    morphs: navigator.morph_stream(),
                    triangles: navigator.triangle_stream(),
                    levels: if style.levels { levels.of_vertices() } else { &[] },
                    wedges: navigator.wedge_stream(),
                    corners: navigator.corner_stream(),
                    looks: Some(looks),
                };
                picture.clear();
                draw(picture, projection, buffers, style.edges);
                if style.boxes {
                    draw_lines(picture, projection, &box_lines(navigator));
                }
                navigator.forget_changes();
                Ok(Upload::default())
            }
            Means::Device(device) => {
                let OnDevice { gpu, scene, off_screen, .. } = device.as_mut();
                let upload = scene.update(gpu, navigator, style)?;
                let rectangle = [0, 0, picture.width(), picture.height()];
                off_screen.draw(gpu, scene, &SceneView { projection: *projection, rectangle, style }, picture)?;
                Ok(upload)
            }
        }
    }
}

impl OnDevice {
    fn open(
        drivers: Drivers,
        model: &Model,
        [width, height]: [u32; 2],
        [memory, gpu_memory]: [u64; 2],
    ) -> Result<Self, PainterError> {
        let gpu = Gpu::open(drivers)?;
        let for_picture = OffScreen::bytes_for(width, height);
        let too_little = GpuError::Memory { allowed: gpu_memory, needed: for_picture, what: "the picture" };
        let on_device = gpu_memory.checked_sub(for_picture).ok_or(too_little)?;
        let off_screen = OffScreen::new(&gpu, width, height)?;
        let looks = Looks::of(model, gpu.room_for_textures(memory, on_device))?;
        let options = SceneOptions {
            memory: on_device,
            format: OffScreen::FORMAT,
            size: [width, height],
            most_buffer_bytes: None,
        };
        let scene = Scene::new(&gpu, model, &looks, options)?;
        Ok(OnDevice { gpu, scene, off_screen, problems: looks.problems().to_vec() })
    }
}
