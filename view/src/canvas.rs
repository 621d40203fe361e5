//! The surface of the window: what is drawn in, and what becomes of it when the window changes.

use std::sync::Arc;

use render::gpu::Gpu;
use winit::event_loop::ActiveEventLoop;
use winit::window::Window;

use crate::ViewError;

/// Formats of colours, the best first: where what is stored is blended, the overlay looks as its designers saw it.
const FORMATS: [wgpu::TextureFormat; 4] = [
    wgpu::TextureFormat::Bgra8Unorm,
    wgpu::TextureFormat::Rgba8Unorm,
    wgpu::TextureFormat::Bgra8UnormSrgb,
    wgpu::TextureFormat::Rgba8UnormSrgb,
];

/// The surface of a window, with the graphics card that draws there.
#[derive(Debug)]
pub struct Canvas {
    gpu: Gpu,
    surface: wgpu::Surface<'static>,
    configuration: wgpu::SurfaceConfiguration,
    window: Arc<Window>,
    /// Why there is no other surface for one that was lost.
    complaint: Option<String>,
}

/// What there is to be drawn in.
#[derive(Debug)]
pub enum Sheet {
    /// This.
    Ready(wgpu::SurfaceTexture),
    /// Nothing at the moment; it is to be tried again soon.
    Later,
    /// Nothing, as the window is not seen: until something happens to it.
    Hidden,
}

impl Canvas {
    /// Finds what can draw in the window.
    pub fn new(event_loop: &ActiveEventLoop, window: Arc<Window>) -> Result<Self, ViewError> {
        let display = Box::new(event_loop.owned_display_handle());
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_with_display_handle_from_env(display));
        let surface = instance.create_surface(window.clone())?;
        let gpu = Gpu::for_surface(instance, &surface)?;
        let size = window.inner_size();
        let capabilities = surface.get_capabilities(&gpu.adapter);
        let format = FORMATS.into_iter().find(|format| capabilities.formats.contains(format));
        let mut configuration = surface
            .get_default_config(&gpu.adapter, size.width.max(1), size.height.max(1))
            .ok_or(ViewError::NoFormat)?;
        configuration.format = format.ok_or(ViewError::NoFormat)?;
        configuration.present_mode = wgpu::PresentMode::Fifo;
        let canvas = Canvas { gpu, surface, configuration, window, complaint: None };
        canvas.configure();
        Ok(canvas)
    }

    /// The graphics card.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// The window.
    pub fn window(&self) -> &Window {
        &self.window
    }

    /// How colours are stored.
    pub fn format(&self) -> wgpu::TextureFormat {
        self.configuration.format
    }

    /// Width and height in points of the screen; `None` where there is nothing to be seen.
    pub fn size(&self) -> Option<[u32; 2]> {
        let size = self.window.inner_size();
        let most = self.gpu.device.limits().max_texture_dimension_2d;
        (size.width > 0 && size.height > 0).then(|| [size.width.min(most), size.height.min(most)])
    }

    /// What the graphics driver complained of since the last time.
    pub fn take_complaint(&mut self) -> Option<String> {
        self.complaint.take().or_else(|| self.gpu.check().err().map(|error| error.to_string()))
    }

    fn configure(&self) {
        self.surface.configure(&self.gpu.device, &self.configuration);
    }

    /// Something to be drawn in, of the size of the window.
    pub fn sheet(&mut self) -> Sheet {
        let Some([width, height]) = self.size() else { return Sheet::Hidden };
        if [self.configuration.width, self.configuration.height] != [width, height] {
            (self.configuration.width, self.configuration.height) = (width, height);
            self.configure();
        }
        match self.surface.get_current_texture() {
            wgpu::CurrentSurfaceTexture::Success(texture) | wgpu::CurrentSurfaceTexture::Suboptimal(texture) => {
                Sheet::Ready(texture)
            }
            wgpu::CurrentSurfaceTexture::Occluded => Sheet::Hidden,
            wgpu::CurrentSurfaceTexture::Outdated => {
                self.configure();
                Sheet::Later
            }
            wgpu::CurrentSurfaceTexture::Lost => {
                match self.gpu.instance.create_surface(self.window.clone()) {
                    Ok(surface) => {
                        self.surface = surface;
                        self.configure();
                    }
                    Err(error) => {
                        self.complaint = Some(error.to_string());
                    }
                }
                Sheet::Later
            }
            wgpu::CurrentSurfaceTexture::Timeout | wgpu::CurrentSurfaceTexture::Validation => Sheet::Later,
        }
    }
}
