//! The picture as a PNG file: drawn once more, into a texture of its own, and read back.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use render::gpu::Gpu;
use storage::{AtomicFile, Disk, StorageError};
use thiserror::Error;

use crate::free_name::free_name;

/// Why there is no picture.
#[derive(Debug, Error)]
pub enum ScreenshotError {
    /// The graphics driver does not give it back.
    #[error("the picture cannot be read back: {problem}")]
    ReadBack {
        /// What it said.
        problem: String,
    },
    /// It cannot be encoded.
    #[error("the picture cannot be encoded: {source}")]
    Encoding {
        /// What is wrong.
        #[from]
        source: image::ImageError,
    },
    /// It cannot be written.
    #[error(transparent)]
    Storage(#[from] StorageError),
}

/// A texture that a picture is drawn in to be kept.
#[derive(Debug)]
pub struct Screenshot {
    texture: wgpu::Texture,
}

impl Screenshot {
    /// One of this size and format.
    pub fn new(gpu: &Gpu, [width, height]: [u32; 2], format: wgpu::TextureFormat) -> Self {
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("screenshot"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        Screenshot { texture }
    }

    /// What is to be drawn in.
    pub fn texture(&self) -> &wgpu::Texture {
        &self.texture
    }

    /// Waits for the drawing, and writes it beside the model; the name of the file.
    pub fn keep(&self, gpu: &Gpu, disk: Arc<dyn Disk>, model: &Path) -> Result<PathBuf, ScreenshotError> {
        let colours = self.colours(gpu)?;
        let mut png = Vec::new();
        PngEncoder::new(&mut png).write_image(
            &colours,
            self.texture.width(),
            self.texture.height(),
            ExtendedColorType::Rgb8,
        )?;
        let path = free_name(disk.as_ref(), model, "png");
        let mut file = AtomicFile::create(disk, &path)?;
        file.append(&png)?;
        file.commit()?;
        Ok(path)
    }

    /// Red, green and blue of each point.
    fn colours(&self, gpu: &Gpu) -> Result<Vec<u8>, ScreenshotError> {
        let (width, height) = (self.texture.width(), self.texture.height());
        let row_bytes = (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("screenshot"),
            size: u64::from(row_bytes) * u64::from(height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_texture_to_buffer(
            self.texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(row_bytes),
                    rows_per_image: Some(height),
                },
            },
            self.texture.size(),
        );
        gpu.queue.submit([encoder.finish()]);
        let failed = |problem: String| ScreenshotError::ReadBack { problem };
        let (sender, receiver) = mpsc::channel();
        buffer.map_async(wgpu::MapMode::Read, .., move |mapped| {
            // Whoever waits for it is right below.
            let _ = sender.send(mapped);
        });
        gpu.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|error| failed(error.to_string()))?;
        receiver.recv().map_err(|error| failed(error.to_string()))?.map_err(|error| failed(error.to_string()))?;
        let bytes = buffer.get_mapped_range(..).map_err(|error| failed(error.to_string()))?;
        let is_blue_first =
            matches!(self.texture.format(), wgpu::TextureFormat::Bgra8Unorm | wgpu::TextureFormat::Bgra8UnormSrgb);
        let rows = bytes.chunks_exact(row_bytes as usize);
        let points = rows.flat_map(|row| row[..4 * width as usize].chunks_exact(4));
        Ok(points
            .flat_map(
                |point| if is_blue_first { [point[2], point[1], point[0]] } else { [point[0], point[1], point[2]] },
            )
            .collect())
    }
}
