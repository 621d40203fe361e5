//! Draws pictures by a graphics device where there is one, else by the processor.

use metanode::model::Model;
use navigator::Navigator;

use crate::boxes::box_lines;
use crate::gpu::{Drivers, Gpu, GpuError, OffScreen, Scene, SceneOptions, SceneView, Upload};
use crate::levels::Levels;
use crate::picture::Picture;
use crate::projection::Projection;
use crate::rasteriser::{Buffers, draw, draw_lines};
use crate::style::Style;

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

/// What draws pictures of one size, of one model.
#[derive(Debug)]
pub struct Painter(Means);

#[derive(Debug)]
enum Means {
    Processor { levels: Levels },
    Device(Box<OnDevice>),
}

#[derive(Debug)]
struct OnDevice {
    gpu: Gpu,
    scene: Scene,
    off_screen: OffScreen,
}

impl Painter {
    /// Finds what to draw by: pictures of `width` × `height` points, and at most `gpu_memory` bytes on a device.
    pub fn open(renderer: Renderer, model: &Model, width: u32, height: u32, gpu_memory: u64) -> Result<Self, GpuError> {
        let drivers = match renderer {
            Renderer::Auto => Drivers::Hardware,
            Renderer::Gpu => Drivers::Any,
            Renderer::Software => return Ok(Self::processor()),
        };
        match OnDevice::open(drivers, model, width, height, gpu_memory) {
            Err(GpuError::NoDriver { .. } | GpuError::TooLittle { .. }) if renderer == Renderer::Auto => {
                Ok(Self::processor())
            }
            opened => Ok(Painter(Means::Device(Box::new(opened?)))),
        }
    }

    fn processor() -> Self {
        Painter(Means::Processor { levels: Levels::default() })
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
            Means::Processor { levels } => {
                if style.levels {
                    levels.update(navigator);
                }
                let buffers = Buffers {
                    vertices: navigator.vertex_stream(),
                    morphs: navigator.morph_stream(),
                    triangles: navigator.triangle_stream(),
                    levels: if style.levels { levels.of_vertices() } else { &[] },
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
                let OnDevice { gpu, scene, off_screen } = device.as_mut();
                let upload = scene.update(gpu, navigator, style)?;
                let rectangle = [0, 0, picture.width(), picture.height()];
                off_screen.draw(gpu, scene, &SceneView { projection: *projection, rectangle, style }, picture)?;
                Ok(upload)
            }
        }
    }
}

impl OnDevice {
    fn open(drivers: Drivers, model: &Model, width: u32, height: u32, gpu_memory: u64) -> Result<Self, GpuError> {
        let gpu = Gpu::open(drivers)?;
        let for_picture = OffScreen::bytes_for(width, height);
        let too_little = GpuError::Memory { allowed: gpu_memory, needed: for_picture, what: "the picture" };
        let memory = gpu_memory.checked_sub(for_picture).ok_or(too_little)?;
        let off_screen = OffScreen::new(&gpu, width, height)?;
        let options = SceneOptions { memory, format: OffScreen::FORMAT, most_buffer_bytes: None };
        let scene = Scene::new(&gpu, model, options)?;
        Ok(OnDevice { gpu, scene, off_screen })
    }
}
