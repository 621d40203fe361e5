//! A front on the device: copies of the navigator's streams, and what draws them.
//!
//! The vertex shader fetches corners and vertices itself out of the copies, so that streams may lie in several buffers, each within
//! what the device allows, and a triangle may have its vertices in any of them.
//!
//! Depth is one over the distance (the nearest is 1, what is infinitely far 0), so that it is as exact far away as near. The eye
//! is given as a sum of two numbers in single precision: what is near it is at its place to the last bit of its own position.
//!
//! Memory on the device: what [`Scene::bytes`] tells, never more than [`SceneOptions::memory`].

use std::num::NonZeroU64;

use bytemuck::{Pod, Zeroable, cast_slice};
use glam::{DVec3, Vec3};
use metanode::model::Model;
use navigator::{DrawnWedge, Navigator};
use wgpu::{
    BindGroup, BindGroupLayout, BindingType, Buffer, BufferUsages, CommandEncoder, RenderPass, RenderPipeline,
    ShaderStages, Texture, TextureFormat, TextureView,
};

use super::device::{BUFFERS_PER_PART, Gpu, GpuError, OTHER_BUFFERS};
use super::mirror::{BLOCK_BYTES, Courier, Mirror, Upload, buffer};
use super::read_back::{POINT_BYTES, target};
use super::textures::Textures;
use crate::boxes::{LineEnd, box_lines};
use crate::colours::from_stored;
use crate::levels::{BLOCK, LEVELS, Levels, colour};
use crate::looks::{Look, Looks, PLAIN};
use crate::picture::BACKGROUND;
use crate::projection::Projection;
use crate::rasteriser::{AMBIENT, SIDE, SIDE_WIDTH};
use crate::style::Style;

/// Format of the depths.
const DEPTH_FORMAT: TextureFormat = TextureFormat::Depth32Float;
/// Most views that are drawn at once.
const MOST_VIEWS: usize = 4;
/// Bytes from one view to the next: any device's alignment.
const VIEW_STRIDE: u64 = 256;
/// Most parts that vertices are divided into.
const MOST_PARTS: usize = 4;
/// Ranges of a stream with at most so many elements between them are sent as one.
const GAP: u32 = 8;
/// Vertices for each triangle that GPU memory is planned for. (Closed surfaces have half of that.)
const VERTICES_PER_TRIANGLE: f64 = 1.0;
/// Bytes of an element of each stream.
const VERTEX_BYTES: usize = 16;
const MORPH_BYTES: usize = 16;
const TRIANGLE_BYTES: usize = 12;
const WEDGE_BYTES: usize = size_of::<DrawnWedge>();

/// How a front lies on the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SceneOptions {
    /// Bytes on the device, at most.
    pub memory: u64,
    /// Format of the pictures.
    pub format: TextureFormat,
    /// Width and height of the pictures, in points; with another size the scene takes other memory.
    pub size: [u32; 2],
    /// The most bytes of a buffer, where that is to be less than the device allows.
    pub most_buffer_bytes: Option<u64>,
}

/// What is seen in a part of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SceneView {
    /// From where.
    pub projection: Projection,
    /// x, y, width and height of the part, in points from the top left.
    pub rectangle: [u32; 4],
    /// What of it.
    pub style: Style,
}

/// The uniform of the shader.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct View {
    eye: [f32; 4],
    eye_rest: [f32; 4],
    right: [f32; 4],
    up: [f32; 4],
    forward: [f32; 4],
    light: [f32; 4],
    flags: [u32; 4],
}

/// A front on the device.
#[derive(Debug)]
pub struct Scene {
    options: SceneOptions,
    diagonal: f64,
    courier: Courier,
    vertices: Mirror,
    morphs: Mirror,
    wedges: Mirror,
    triangles: Mirror,
    corners: Mirror,
    level_mirror: Mirror,
    levels: Levels,
    lines: Option<(Buffer, u32)>,
    views: Buffer,
    has_morphs: bool,
    /// What corners carry, as the shader has it.
    carried: u32,
    fixed_bytes: u64,
    view_group: BindGroup,
    triangle_layout: BindGroupLayout,
    triangle_groups: Vec<BindGroup>,
    vertex_layout: BindGroupLayout,
    vertex_group: BindGroup,
    surfaces: RenderPipeline,
    line_pipeline: RenderPipeline,
    cover: RenderPipeline,
    depths: Texture,
}

impl Scene {
    /// The scene of a model, with nothing in it yet.
    pub fn new(gpu: &Gpu, model: &Model, looks: &Looks, options: SceneOptions) -> Result<Self, GpuError> {
        let most_bytes = options.most_buffer_bytes.unwrap_or(u64::MAX).min(gpu.most_buffer_bytes());
        let for_parts = gpu.device.limits().max_storage_buffers_per_shader_stage - OTHER_BUFFERS;
        let parts = ((for_parts / BUFFERS_PER_PART) as usize).min(MOST_PARTS);
        // As many vertices in a part of each of their streams.
        let wedges = Mirror::new(gpu, "wedges", WEDGE_BYTES, most_bytes, parts);
        let part_bytes = |element_bytes: usize| (element_bytes as u64) << wedges.part_shift();
        let vertices = Mirror::new(gpu, "vertices", VERTEX_BYTES, part_bytes(VERTEX_BYTES), parts);
        let morphs = Mirror::new(gpu, "morphs", MORPH_BYTES, part_bytes(MORPH_BYTES), parts);
        let triangles = Mirror::new(gpu, "triangles", TRIANGLE_BYTES, most_bytes, usize::MAX);
        let corners = Mirror::new(gpu, "corners", TRIANGLE_BYTES, most_bytes, usize::MAX);
        let level_mirror = Mirror::new(gpu, "levels", BLOCK, most_bytes, 1);

        let views =
            buffer(gpu, "views", MOST_VIEWS as u64 * VIEW_STRIDE, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        let colours = (0..LEVELS as u8).map(|level| {
            let [red, green, blue] = colour(level);
            [red, green, blue, 1.0]
        });
        let colours: Vec<[f32; 4]> = colours.collect();
        let level_colours =
            buffer(gpu, "level colours", (LEVELS * 16) as u64, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        gpu.queue.write_buffer(&level_colours, 0, cast_slice(&colours));
        let materials = materials(gpu, looks);
        let textures = Textures::new(gpu, looks);

        let uniform = |binding: u32, has_offset: bool, bytes: u64| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: ShaderStages::VERTEX_FRAGMENT,
            ty: BindingType::Buffer {
                ty: wgpu::BufferBindingType::Uniform,
                has_dynamic_offset: has_offset,
                min_binding_size: NonZeroU64::new(bytes),
            },
            count: None,
        };
        let storage = |binding: u32| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: ShaderStages::VERTEX,
            ty: BindingType::Buffer {
                ty: wgpu::BufferBindingType::Storage { read_only: true },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        };
        let textured = |binding: u32, ty: BindingType| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let layout = |label: &str, entries: &[wgpu::BindGroupLayoutEntry]| {
            let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some(label), entries };
            gpu.device.create_bind_group_layout(&descriptor)
        };
        let view_bytes = size_of::<View>() as u64;
        let view_layout = layout(
            "view",
            &[
                uniform(0, true, view_bytes),
                uniform(1, false, (LEVELS * 16) as u64),
                textured(2, Textures::BINDING),
                textured(3, BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
                storage(4),
            ],
        );
        let triangle_layout = layout("triangles", &[storage(0), storage(1)]);
        let entries: Vec<_> = (0..1 + BUFFERS_PER_PART * parts as u32).map(storage).collect();
        let vertex_layout = layout("vertices", &entries);
        let one_view = wgpu::BufferBinding { buffer: &views, offset: 0, size: NonZeroU64::new(view_bytes) };
        let view_group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("view"),
            layout: &view_layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::Buffer(one_view) },
                wgpu::BindGroupEntry { binding: 1, resource: level_colours.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 2, resource: wgpu::BindingResource::TextureView(textures.view()) },
                wgpu::BindGroupEntry { binding: 3, resource: wgpu::BindingResource::Sampler(textures.sampler()) },
                wgpu::BindGroupEntry { binding: 4, resource: materials.as_entire_binding() },
            ],
        });

        let source = include_str!("shader.wgsl")
            .replace("//COLOURS//", &colours_of_shader())
            .replace("//PARTS//", &parts_of_shader(parts, vertices.part_shift()));
        let shader = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("front"),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        let pipeline_layout = |layouts: &[Option<&BindGroupLayout>]| {
            let descriptor =
                wgpu::PipelineLayoutDescriptor { label: Some("front"), bind_group_layouts: layouts, immediate_size: 0 };
            gpu.device.create_pipeline_layout(&descriptor)
        };
        let of_surfaces = pipeline_layout(&[Some(&view_layout), Some(&triangle_layout), Some(&vertex_layout)]);
        let of_lines = pipeline_layout(&[Some(&view_layout)]);
        let line_ends = wgpu::VertexBufferLayout {
            array_stride: size_of::<LineEnd>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Unorm8x4],
        };
        let pipeline = |layout: &wgpu::PipelineLayout,
                        [vertex, fragment]: [&str; 2],
                        buffers: &[Option<wgpu::VertexBufferLayout<'_>>],
                        topology: wgpu::PrimitiveTopology,
                        depth_compare: wgpu::CompareFunction| {
            gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(fragment),
                layout: Some(layout),
                vertex: wgpu::VertexState {
                    module: &shader,
                    entry_point: Some(vertex),
                    compilation_options: Default::default(),
                    buffers,
                },
                primitive: wgpu::PrimitiveState { topology, ..Default::default() },
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH_FORMAT,
                    depth_write_enabled: Some(true),
                    depth_compare: Some(depth_compare),
                    stencil: Default::default(),
                    bias: Default::default(),
                }),
                multisample: Default::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &shader,
                    entry_point: Some(fragment),
                    compilation_options: wgpu::PipelineCompilationOptions {
                        constants: &[("is_turned_by_device", f64::from(u8::from(options.format.is_srgb())))],
                        ..Default::default()
                    },
                    targets: &[Some(options.format.into())],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        let nearer = wgpu::CompareFunction::Greater;
        let triangle_list = wgpu::PrimitiveTopology::TriangleList;
        let surfaces = pipeline(&of_surfaces, ["corner", "surface"], &[], triangle_list, nearer);
        let line_list = wgpu::PrimitiveTopology::LineList;
        let line_pipeline = pipeline(&of_lines, ["line_end", "line"], &[Some(line_ends)], line_list, nearer);
        let always = wgpu::CompareFunction::Always;
        let cover = pipeline(&of_lines, ["cover_corner", "cover"], &[], triangle_list, always);

        let vertex_group = vertex_group(gpu, &vertex_layout, parts, &level_mirror, [&vertices, &morphs, &wedges]);
        let triangle_groups = triangle_groups(gpu, &triangle_layout, &triangles, &corners);
        let scene = Scene {
            options,
            diagonal: model.header().diagonal(),
            courier: Courier::new(gpu),
            vertices,
            morphs,
            wedges,
            triangles,
            corners,
            level_mirror,
            levels: Levels::default(),
            lines: None,
            fixed_bytes: views.size() + materials.size() + textures.bytes() + BLOCK_BYTES as u64,
            views,
            has_morphs: false,
            carried: 0,
            view_group,
            triangle_layout,
            triangle_groups,
            vertex_layout,
            vertex_group,
            surfaces,
            line_pipeline,
            cover,
            depths: depths(gpu, options.size),
        };
        gpu.check()?;
        if scene.bytes() > options.memory {
            let (allowed, needed) = (options.memory, scene.bytes());
            return Err(GpuError::Memory { allowed, needed, what: "an empty scene" });
        }
        Ok(scene)
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        let lines = self.lines.as_ref().map_or(0, |(lines, _)| lines.size());
        self.mirrors().map(Mirror::bytes).iter().sum::<u64>() + lines + self.still_bytes()
    }

    /// Bytes of what does not grow with the front.
    fn still_bytes(&self) -> u64 {
        self.fixed_bytes + depth_bytes([self.depths.width(), self.depths.height()])
    }

    fn mirrors(&self) -> [&Mirror; 6] {
        [&self.vertices, &self.morphs, &self.wedges, &self.triangles, &self.corners, &self.level_mirror]
    }

    /// The most triangles for which the memory allowed will do whatever the front is like.
    pub fn most_triangles(&self) -> u64 {
        // Buffers grow by doubling: at worst the new one is twice what is needed, beside the old one.
        let vertex_bytes = (VERTEX_BYTES + MORPH_BYTES + WEDGE_BYTES + 1) as f64 * VERTICES_PER_TRIANGLE;
        let triangle_bytes = 3.0 * (2.0 * TRIANGLE_BYTES as f64 + vertex_bytes);
        let by_memory = (self.options.memory.saturating_sub(self.still_bytes()) as f64 / triangle_bytes) as u64;
        by_memory.min((self.vertices.most_elements() as f64 / VERTICES_PER_TRIANGLE) as u64)
    }

    /// Brings the copies up to date with a navigator of the scene's model, and has it forget its changes.
    pub fn update(&mut self, gpu: &Gpu, navigator: &mut Navigator, style: Style) -> Result<Upload, GpuError> {
        if style.levels {
            self.levels.update(navigator);
        }
        let levels = if style.levels { self.levels.of_vertices() } else { &[] };
        let lines = if style.boxes { box_lines(navigator) } else { Vec::new() };
        let line_bytes = size_of_val(lines.as_slice()) as u64;
        let (wedges, corners) = (navigator.wedge_stream(), navigator.corner_stream());
        self.has_morphs = !navigator.morph_stream().is_empty();
        self.carried = if wedges.is_empty() { 0 } else { 1 + u32::from(!corners.is_empty()) };
        let streams: [&[u8]; 6] = [
            cast_slice(navigator.vertex_stream()),
            cast_slice(navigator.morph_stream()),
            cast_slice(wedges),
            cast_slice(navigator.triangle_stream()),
            cast_slice(corners),
            levels,
        ];
        let of_streams =
            self.mirrors().iter().zip(streams).map(|(mirror, stream)| mirror.bytes_for(stream)).sum::<u64>();
        let needed = of_streams + line_bytes.next_power_of_two() + self.still_bytes();
        if needed > self.options.memory {
            return Err(GpuError::Memory { allowed: self.options.memory, needed, what: "the triangles of this view" });
        }
        let mirrors = [
            &mut self.vertices,
            &mut self.morphs,
            &mut self.wedges,
            &mut self.triangles,
            &mut self.corners,
            &mut self.level_mirror,
        ];
        let mut is_new = false;
        for (mirror, stream) in mirrors.into_iter().zip(streams) {
            is_new |= mirror.make_room(gpu, stream)?;
        }
        if is_new {
            self.triangle_groups = triangle_groups(gpu, &self.triangle_layout, &self.triangles, &self.corners);
            let parts = self.vertices.most_parts();
            let mirrors = [&self.vertices, &self.morphs, &self.wedges];
            self.vertex_group = vertex_group(gpu, &self.vertex_layout, parts, &self.level_mirror, mirrors);
        }
        let courier = &mut self.courier;
        let [vertices, morphs, wedges, triangles, corners, levels] = streams;
        self.vertices.update(gpu, courier, vertices, navigator.changed_vertices(GAP));
        self.morphs.update(gpu, courier, morphs, navigator.changed_morphs(GAP));
        self.wedges.update(gpu, courier, wedges, navigator.changed_wedges(GAP));
        self.triangles.update(gpu, courier, triangles, navigator.changed_triangles(GAP));
        self.corners.update(gpu, courier, corners, navigator.changed_triangles(GAP));
        if style.levels {
            self.level_mirror.update(gpu, courier, levels, self.levels.changed());
        }
        if line_bytes == 0 {
            self.lines = None;
        } else {
            let has_room = self.lines.as_ref().is_some_and(|(lines, _)| lines.size() >= line_bytes);
            if !has_room {
                let usages = BufferUsages::VERTEX | BufferUsages::COPY_DST;
                self.lines = Some((buffer(gpu, "boxes", line_bytes.next_power_of_two(), usages), 0));
            }
            if let Some((buffer, ends)) = &mut self.lines {
                courier.take(gpu, cast_slice(&lines), buffer, 0);
                *ends = lines.len() as u32;
            }
        }
        let upload = courier.finish(gpu);
        navigator.forget_changes();
        gpu.check()?;
        Ok(upload)
    }

    /// Draws what was last brought up to date: as each view sees it, into its part of a target of `size` points, each over those
    /// before. At most four views. The first one's background is that of all of the target.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut CommandEncoder,
        target: &TextureView,
        size: [u32; 2],
        views: &[SceneView],
    ) {
        if [self.depths.width(), self.depths.height()] != size {
            self.depths.destroy();
            self.depths = depths(gpu, size);
        }
        let depth = self.depths.create_view(&Default::default());
        let views = &views[..views.len().min(MOST_VIEWS)];
        for (index, view) in views.iter().enumerate() {
            gpu.queue.write_buffer(&self.views, index as u64 * VIEW_STRIDE, bytemuck::bytes_of(&self.uniform(view)));
        }
        let is_turned = self.options.format.is_srgb();
        let [red, green, blue] =
            BACKGROUND.map(|part| f64::from(part) / 255.0).map(|part| if is_turned { from_stored(part) } else { part });
        for (index, view) in views.iter().enumerate() {
            let background = wgpu::Color { r: red, g: green, b: blue, a: 1.0 };
            let load = if index == 0 { wgpu::LoadOp::Clear(background) } else { wgpu::LoadOp::Load };
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("front"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: target,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &depth,
                    depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store }),
                    stencil_ops: None,
                }),
                ..Default::default()
            });
            let [x, y, width, height] = view.rectangle;
            pass.set_viewport(x as f32, y as f32, width as f32, height as f32, 0.0, 1.0);
            pass.set_scissor_rect(x, y, width, height);
            if index > 0 {
                pass.set_bind_group(0, &self.view_group, &[(index as u64 * VIEW_STRIDE) as u32]);
                pass.set_pipeline(&self.cover);
                pass.draw(0..3, 0..1);
            }
            self.draw_view(&mut pass, index, view.style);
        }
    }

    /// The depths of what was drawn last: how near it is, in parts of the least depth; 0 where there is nothing.
    pub(super) fn depths(&self) -> &Texture {
        &self.depths
    }

    fn draw_view(&self, pass: &mut RenderPass<'_>, index: usize, style: Style) {
        pass.set_bind_group(0, &self.view_group, &[(index as u64 * VIEW_STRIDE) as u32]);
        pass.set_pipeline(&self.surfaces);
        pass.set_bind_group(2, &self.vertex_group, &[]);
        for (part, group) in self.triangle_groups.iter().enumerate() {
            let corners = 3 * self.triangles.elements_in(part) as u32;
            if corners > 0 {
                pass.set_bind_group(1, group, &[]);
                pass.draw(0..corners, 0..1);
            }
        }
        if let Some((lines, ends)) = self.lines.as_ref().filter(|_| style.boxes) {
            pass.set_pipeline(&self.line_pipeline);
            pass.set_vertex_buffer(0, lines.slice(..));
            pass.draw(0..*ends, 0..1);
        }
    }

    fn uniform(&self, view: &SceneView) -> View {
        let projection = &view.projection;
        let over_diagonal = 1.0 / if self.diagonal > 0.0 { self.diagonal } else { 1.0 };
        let eye = projection.eye().as_vec3();
        let rest = (projection.eye() - eye.as_dvec3()).as_vec3();
        let with = |vector: Vec3, last: f32| [vector.x, vector.y, vector.z, last];
        let scaled = |direction: DVec3| (direction * over_diagonal).as_vec3();
        let [right, up, forward] = projection.directions().map(scaled);
        let Style { edges, levels, .. } = view.style;
        View {
            eye: with(eye, 0.0),
            eye_rest: with(rest, 0.0),
            right: with(right, 0.0),
            up: with(up, 0.0),
            forward: with(forward, (projection.nearest() * over_diagonal) as f32),
            light: with(projection.headlight().as_vec3(), 0.0),
            flags: [edges.into(), levels.into(), self.has_morphs.into(), self.carried],
        }
    }
}

/// Depths for pictures of so many points.
fn depths(gpu: &Gpu, size: [u32; 2]) -> Texture {
    target(gpu, "depths", size.map(|side| side.max(1)), DEPTH_FORMAT)
}

fn depth_bytes([width, height]: [u32; 2]) -> u64 {
    u64::from(POINT_BYTES) * u64::from(width) * u64::from(height)
}

/// The bind groups of triangles, with what their corners carry: one for each part.
fn triangle_groups(gpu: &Gpu, layout: &BindGroupLayout, triangles: &Mirror, corners: &Mirror) -> Vec<BindGroup> {
    let group = |(part, triangles): (usize, &Buffer)| {
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("triangles"),
            layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: triangles.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: corners.part_or_last(part).as_entire_binding() },
            ],
        })
    };
    triangles.parts().iter().enumerate().map(group).collect()
}

/// The bind group of levels and vertices.
fn vertex_group(
    gpu: &Gpu,
    layout: &BindGroupLayout,
    parts: usize,
    levels: &Mirror,
    streams: [&Mirror; 3],
) -> BindGroup {
    let mut buffers = vec![levels.part_or_last(0)];
    for part in 0..parts {
        buffers.extend(streams.map(|stream| stream.part_or_last(part)));
    }
    let entries: Vec<_> = (0..)
        .zip(&buffers)
        .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
        .collect();
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some("vertices"), layout, entries: &entries })
}

/// The colours of materials and the numbers of their textures, as the shader has them.
fn materials(gpu: &Gpu, looks: &Looks) -> Buffer {
    let mut materials: Vec<[f32; 4]> = Vec::with_capacity(looks.materials().len().max(1));
    for Look { colour: [red, green, blue], texture } in looks.materials() {
        materials.push([*red, *green, *blue, *texture as f32]);
    }
    if materials.is_empty() {
        materials.push([1.0, 1.0, 1.0, 0.0]);
    }
    let bytes: &[u8] = cast_slice(&materials);
    let materials = buffer(gpu, "materials", bytes.len() as u64, BufferUsages::STORAGE | BufferUsages::COPY_DST);
    gpu.queue.write_buffer(&materials, 0, bytes);
    materials
}

/// The colours that pictures by the processor have, too.
fn colours_of_shader() -> String {
    let colour = |[red, green, blue]: [f64; 3]| format!("vec3<f32>({red:?}, {green:?}, {blue:?})");
    let (plain, background) = (PLAIN.map(f64::from), BACKGROUND.map(|part| f64::from(part) / 255.0));
    format!(
        "const PLAIN = {};\nconst BACKGROUND = {};\nconst EDGE = {};\nconst EDGE_WIDTH = {SIDE_WIDTH:?};\nconst AMBIENT = {AMBIENT:?};\n",
        colour(plain),
        colour(background),
        colour(SIDE)
    )
}

/// What the shader says of the parts that vertices and wedges are divided into.
fn parts_of_shader(parts: usize, shift: u32) -> String {
    let streams = [
        ("vertex", "vec4<u32>", "vec4<u32>", "#[place]"),
        ("morph", "vec4<u32>", "vec4<u32>", "#[place]"),
        (
            "wedge",
            "u32",
            "Wedge",
            "Wedge(#[5 * place], vec2<u32>(#[5 * place + 1], #[5 * place + 2]), #[5 * place + 3], #[5 * place + 4])",
        ),
    ];
    let mut text = String::new();
    for (stream, (name, stored, fetched, fetch)) in streams.into_iter().enumerate() {
        for part in 0..parts {
            let binding = 1 + streams.len() * part + stream;
            text += &format!("@group(2) @binding({binding}) var<storage, read> {name}_{part}: array<{stored}>;\n");
        }
        let mask = (1_u64 << shift) - 1;
        text += &format!("fn {name}_at(number: u32) -> {fetched} {{\n    let place = number & {mask}u;\n");
        text += &format!("    switch number >> {shift}u {{\n");
        for part in (0..parts).rev() {
            let case = if part == 0 { "default:".to_owned() } else { format!("case {part}u:") };
            text += &format!("        {case} {{ return {}; }}\n", fetch.replace('#', &format!("{name}_{part}")));
        }
        text += "    }\n}\n";
    }
    text
}
