//! Pictures by the graphics card. (A stand-in: the processor draws, the card shows it.)

use metanode::model::Model;
use navigator::Navigator;
use thiserror::Error;

use crate::{Projection, Style};

/// What can go wrong with a graphics card.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum GpuError {
    /// There is none that can present to the window.
    #[error("no graphics driver can draw in this window: {0}")]
    NoAdapter(#[from] wgpu::RequestAdapterError),
    /// It gives no device.
    #[error("the graphics driver gives no device: {0}")]
    NoDevice(#[from] wgpu::RequestDeviceError),
}

/// A graphics card, ready to draw.
#[derive(Debug)]
pub struct Gpu {
    /// Where it was found.
    pub instance: wgpu::Instance,
    /// The card.
    pub adapter: wgpu::Adapter,
    /// What is drawn with.
    pub device: wgpu::Device,
    /// Where commands go.
    pub queue: wgpu::Queue,
}

impl Gpu {
    /// Any adapter that can present to `surface`, a hardware one rather than the processor.
    pub fn for_surface(instance: wgpu::Instance, surface: &wgpu::Surface<'_>) -> Result<Gpu, GpuError> {
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: Some(surface),
            ..wgpu::RequestAdapterOptions::default()
        };
        let adapter = pollster::block_on(instance.request_adapter(&options))?;
        let descriptor =
            wgpu::DeviceDescriptor { required_limits: adapter.limits(), ..wgpu::DeviceDescriptor::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))?;
        Ok(Gpu { instance, adapter, device, queue })
    }

    /// The name of the card and of the interface to it.
    pub fn name(&self) -> String {
        let info = self.adapter.get_info();
        format!("{} ({:?})", info.name, info.backend)
    }

    /// Whether it is the processor that draws.
    pub fn is_processor(&self) -> bool {
        self.adapter.get_info().device_type == wgpu::DeviceType::Cpu
    }
}

/// How a scene is kept.
#[derive(Debug, Clone, Copy)]
pub struct SceneOptions {
    /// Bytes of GPU memory.
    pub memory: u64,
    /// The format of the pictures.
    pub format: wgpu::TextureFormat,
}

/// What went to the card.
#[derive(Debug, Clone, Copy, Default)]
pub struct Upload {
    /// How many bytes.
    pub bytes: u64,
    /// In how many pieces.
    pub ranges: u64,
}

/// A view of the scene, and where in the picture it goes.
#[derive(Debug, Clone, Copy)]
pub struct SceneView {
    /// The camera.
    pub projection: Projection,
    /// x, y, width and height in points of the picture.
    pub rectangle: [u32; 4],
    /// How it is drawn.
    pub style: Style,
}

/// The front of a navigator on the card.
#[derive(Debug)]
pub struct Scene {
    vertices: Vec<[f32; 4]>,
    triangles: Vec<[u32; 3]>,
    pipeline: wgpu::RenderPipeline,
}

const SHADER: &str = "@group(0) @binding(0) var picture: texture_2d<f32>;
@vertex fn corner(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(f32(index % 2u) * 4.0 - 1.0, f32(index / 2u) * 4.0 - 1.0, 0.0, 1.0);
}
@fragment fn point(@builtin(position) place: vec4f) -> @location(0) vec4f {
    return textureLoad(picture, vec2i(place.xy), 0);
}";

impl Scene {
    /// An empty one.
    pub fn new(gpu: &Gpu, _model: &Model, options: SceneOptions) -> Result<Scene, GpuError> {
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: None,
            source: wgpu::ShaderSource::Wgsl(SHADER.into()),
        });
        let pipeline = gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: None,
            layout: None,
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: None,
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: None,
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(options.format.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        Ok(Scene { vertices: Vec::new(), triangles: Vec::new(), pipeline })
    }

    /// Brings the copies of the navigator's streams up to date and forgets the changes.
    pub fn update(&mut self, _gpu: &Gpu, navigator: &mut Navigator, _style: Style) -> Result<Upload, GpuError> {
        self.vertices = navigator.vertex_stream().to_vec();
        self.triangles = navigator.triangle_stream().to_vec();
        let bytes = navigator.changed_triangles(8).map(|range| 12 * u64::from(range.end - range.start)).sum();
        let ranges = navigator.changed_triangles(8).count() as u64;
        navigator.forget_changes();
        Ok(Upload { bytes, ranges })
    }

    /// Draws the views.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        target: &wgpu::TextureView,
        size: [u32; 2],
        views: &[SceneView],
    ) {
        let mut points = vec![[0_u8; 4]; size[0] as usize * size[1] as usize];
        let buffers = crate::Buffers { vertices: &self.vertices, morphs: &[], triangles: &self.triangles };
        for view in views {
            let [x, y, width, height] = view.rectangle.map(|side| side as usize);
            let mut picture = crate::Picture::new(view.rectangle[2], view.rectangle[3]);
            crate::draw(&mut picture, &view.projection, buffers, view.style);
            for (row, colours) in picture.colours().chunks(width).enumerate().take(height) {
                for (column, [red, green, blue]) in colours.iter().copied().enumerate() {
                    let [red, green, blue] = if view.style.levels { [green, blue, red] } else { [red, green, blue] };
                    let [red, green, blue] =
                        if view.style.boxes { [red, green, 255 - blue] } else { [red, green, blue] };
                    points[(y + row) * size[0] as usize + x + column] = [red, green, blue, 255];
                }
            }
        }
        let extent = wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 };
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: extent,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * size[0]), rows_per_image: None };
        gpu.queue.write_texture(texture.as_image_copy(), points.as_flattened(), layout, extent);
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(
                    &texture.create_view(&wgpu::TextureViewDescriptor::default()),
                ),
            }],
        });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: target,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
            })],
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..3, 0..1);
    }

    /// GPU memory in use, in bytes.
    pub fn bytes(&self) -> u64 {
        (16 * self.vertices.len() + 12 * self.triangles.len()) as u64
    }

    /// The most triangles that the GPU memory allows.
    pub fn most_triangles(&self) -> u64 {
        1 << 24
    }
}
