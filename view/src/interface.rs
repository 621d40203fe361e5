//! The overlay's way from the window and to the picture: egui, its events and its drawing.

use egui_wgpu::ScreenDescriptor;
use render::gpu::Gpu;
use winit::event::WindowEvent;
use winit::event_loop::ActiveEventLoop;
use winit::window::Window;

use std::time::Duration;

/// What is drawn over the pictures.
pub struct Interface {
    context: egui::Context,
    state: egui_winit::State,
    renderer: egui_wgpu::Renderer,
    /// What the last overlay covers, in its own units.
    covered: Vec<egui::Rect>,
    shapes: Vec<egui::ClippedPrimitive>,
    pixels_per_point: f32,
    /// What it draws no more, once the frame is drawn.
    to_be_freed: Vec<egui::TextureId>,
}

impl Interface {
    /// One for a window.
    pub fn new(event_loop: &ActiveEventLoop, window: &Window, gpu: &Gpu, format: wgpu::TextureFormat) -> Self {
        let context = egui::Context::default();
        context.set_visuals(egui::Visuals::dark());
        context.all_styles_mut(|style| style.interaction.selectable_labels = false);
        let most = gpu.device.limits().max_texture_dimension_2d as usize;
        let scale = window.scale_factor() as f32;
        let state = egui_winit::State::new(
            context.clone(),
            egui::ViewportId::ROOT,
            event_loop,
            Some(scale),
            Some(winit::window::Theme::Dark),
            Some(most),
        );
        let renderer = egui_wgpu::Renderer::new(&gpu.device, format, egui_wgpu::RendererOptions::default());
        Interface {
            context,
            state,
            renderer,
            covered: Vec::new(),
            shapes: Vec::new(),
            pixels_per_point: scale,
            to_be_freed: Vec::new(),
        }
    }

    /// Tells the overlay of an event; true where it is to be drawn again.
    pub fn tell(&mut self, window: &Window, event: &WindowEvent) -> bool {
        let is_over = |interface: &Self| {
            interface.state.egui_input().events.iter().rev().any(|event| match event {
                egui::Event::PointerMoved(place) => interface.covers_point(*place),
                _ => false,
            })
        };
        let response = self.state.on_window_event(window, event);
        match event {
            // The mouse goes over the picture without a change.
            WindowEvent::CursorMoved { .. } => is_over(self) || self.context.egui_is_using_pointer() || self.was_over(),
            _ => response.repaint,
        }
    }

    fn was_over(&self) -> bool {
        self.context.pointer_latest_pos().is_some_and(|place| self.covers_point(place))
    }

    fn covers_point(&self, place: egui::Pos2) -> bool {
        self.covered.iter().any(|rectangle| rectangle.contains(place))
    }

    /// Whether the overlay is at a place of the window, so that the mouse there is its own.
    pub fn covers(&self, [x, y]: [f64; 2]) -> bool {
        self.covers_point(egui::pos2(x as f32, y as f32) / self.pixels_per_point)
    }

    /// Whether a text is being written, so that keys are letters.
    pub fn takes_keys(&self) -> bool {
        self.context.text_edit_focused()
    }

    /// Makes the overlay of the next frame. `show` tells what it covers. Returns after what time it changes by itself.
    pub fn run(
        &mut self,
        window: &Window,
        event_loop: &ActiveEventLoop,
        gpu: &Gpu,
        mut show: impl FnMut(&egui::Context) -> Vec<egui::Rect>,
    ) -> Duration {
        let input = self.state.take_egui_input(window);
        let mut covered = Vec::new();
        let mut output = self.context.run_pass(input, |context| covered = show(context));
        self.covered = covered;
        // Arrow keys fly; they do not move the slider that was dragged last.
        if !self.takes_keys() {
            self.context.memory_mut(|memory| {
                if let Some(focused) = memory.focused() {
                    memory.surrender_focus(focused);
                }
            });
        }
        self.state.handle_platform_output_with_event_loop(window, event_loop, output.platform_output);
        for (id, deltas) in std::mem::take(&mut output.textures_delta.set) {
            for delta in deltas {
                self.renderer.update_texture(&gpu.device, &gpu.queue, id, &delta);
            }
        }
        self.to_be_freed.extend(std::mem::take(&mut output.textures_delta.free));
        self.pixels_per_point = output.pixels_per_point;
        self.shapes = self.context.tessellate(output.shapes, output.pixels_per_point);
        let delays = output.viewport_output.values().map(|viewport| viewport.repaint_delay);
        delays.min().unwrap_or(Duration::MAX)
    }

    /// Draws it over what is in the target; commands that are to go before those of the encoder.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        target: &wgpu::TextureView,
        size: [u32; 2],
    ) -> Vec<wgpu::CommandBuffer> {
        let screen = ScreenDescriptor { size_in_pixels: size, pixels_per_point: self.pixels_per_point };
        let before = self.renderer.update_buffers(&gpu.device, &gpu.queue, encoder, &self.shapes, &screen);
        let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("overlay"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: target,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
            })],
            ..wgpu::RenderPassDescriptor::default()
        });
        self.renderer.render(&mut pass.forget_lifetime(), &self.shapes, &screen);
        before
    }

    /// The frame is drawn: what it needed and the next one does not goes.
    pub fn end_frame(&mut self) {
        for id in self.to_be_freed.drain(..) {
            self.renderer.free_texture(&id);
        }
    }
}
