//! The textures of materials on the device: the layers of one, all of the same size, each with its halves of halves.

use wgpu::{
    BindingType, Sampler, TextureDimension, TextureFormat, TextureSampleType, TextureUsages, TextureView,
    TextureViewDimension,
};

use super::device::Gpu;
use crate::looks::Looks;

/// Colours in sRGB, which the device turns into parts of light.
const FORMAT: TextureFormat = TextureFormat::Rgba8UnormSrgb;
/// Bytes of a point.
const POINT_BYTES: u32 = 4;

/// All textures.
#[derive(Debug)]
pub struct Textures {
    view: TextureView,
    sampler: Sampler,
    bytes: u64,
}

impl Textures {
    /// What the shader has them as.
    pub const BINDING: BindingType = BindingType::Texture {
        sample_type: TextureSampleType::Float { filterable: true },
        view_dimension: TextureViewDimension::D2Array,
        multisampled: false,
    };

    /// Those of a model; a single point where it has none.
    pub fn new(gpu: &Gpu, looks: &Looks) -> Self {
        // By OpenGL, a texture of one layer has none, and the shader would read black.
        let least_layers = if gpu.adapter.get_info().backend == wgpu::Backend::Gl { 2 } else { 1 };
        let (side, layers) = (looks.side().max(1), (looks.textures().len() as u32).max(least_layers));
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("textures"),
            size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: layers },
            mip_level_count: 1 + side.ilog2(),
            sample_count: 1,
            dimension: TextureDimension::D2,
            format: FORMAT,
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
            view_formats: &[],
        });
        for (layer, image) in (0..).zip(looks.textures()) {
            for (level, points) in (0..).zip(image.levels()) {
                let side = side >> level;
                let place = wgpu::TexelCopyTextureInfo {
                    texture: &texture,
                    mip_level: level,
                    origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
                    aspect: wgpu::TextureAspect::All,
                };
                let layout = wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(POINT_BYTES * side),
                    rows_per_image: Some(side),
                };
                let size = wgpu::Extent3d { width: side, height: side, depth_or_array_layers: 1 };
                gpu.queue.write_texture(place, points, layout, size);
            }
            // Sent image by image, so that they are not all waiting in RAM.
            gpu.queue.submit([]);
        }
        let view = texture.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(TextureViewDimension::D2Array),
            ..Default::default()
        });
        let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            mipmap_filter: wgpu::MipmapFilterMode::Linear,
            ..Default::default()
        });
        let points: u64 = (0..=side.ilog2()).map(|level| u64::from(side >> level).pow(2)).sum();
        Textures { view, sampler, bytes: u64::from(layers) * u64::from(POINT_BYTES) * points }
    }

    /// As the shader reads them.
    pub fn view(&self) -> &TextureView {
        &self.view
    }

    /// How it reads them.
    pub fn sampler(&self) -> &Sampler {
        &self.sampler
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }
}
