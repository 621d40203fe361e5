//! The picture as a PNG file: drawn once more, into a texture of its own, and read back.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use render::gpu::read_back::{copy, read, row_bytes, target};
use render::gpu::{Gpu, GpuError};
use storage::{AtomicFile, Disk, StorageError};
use thiserror::Error;

use crate::free_name::free_name;

/// Why there is no picture.
#[derive(Debug, Error)]
pub enum ScreenshotError {
    /// The graphics driver does not give it back.
    #[error("the picture cannot be read back: {source}")]
    ReadBack {
        /// What it said.
        #[from]
        source: GpuError,
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
        let texture = target(gpu, "screenshot", [width, height], format);
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
        let row_bytes = row_bytes(width);
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("screenshot"),
            size: u64::from(row_bytes) * u64::from(height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        copy(&mut encoder, &self.texture, &buffer, 0);
        gpu.queue.submit([encoder.finish()]);
        let is_blue_first =
            matches!(self.texture.format(), wgpu::TextureFormat::Bgra8Unorm | wgpu::TextureFormat::Bgra8UnormSrgb);
        let colour =
            |point: &[u8]| if is_blue_first { [point[2], point[1], point[0]] } else { [point[0], point[1], point[2]] };
        let colours = read(gpu, &buffer, |bytes| {
            let rows = bytes.chunks_exact(row_bytes as usize);
            rows.flat_map(|row| row[..4 * width as usize].chunks_exact(4)).flat_map(colour).collect()
        })?;
        Ok(colours)
    }
}
