//! Pictures without a window: drawn on the device, and read back.
//!
//! Memory on the device, beside the scene: 12 bytes a point; in RAM that of the [`Picture`], and 8 bytes a point that are read back.

use wgpu::{Buffer, BufferUsages, Texture, TextureFormat};

use super::device::{Gpu, GpuError};
use super::mirror::buffer;
use super::read_back::{POINT_BYTES, copy, read, row_bytes, target};
use super::scene::{Scene, SceneView};
use crate::picture::Picture;

/// Format of the colours.
const FORMAT: TextureFormat = TextureFormat::Rgba8Unorm;

/// What a picture is drawn into.
#[derive(Debug)]
pub struct OffScreen {
    size: [u32; 2],
    colours: Texture,
    /// Where the colours, and then the depths, are read.
    back: Buffer,
}

impl OffScreen {
    /// The format that its scene has to have.
    pub const FORMAT: TextureFormat = FORMAT;

    /// Bytes of RAM for each point, while a picture is read back.
    pub const POINT_BYTES: u64 = 2 * POINT_BYTES as u64;

    /// Bytes on the device for a picture of so many points.
    pub fn bytes_for(width: u32, height: u32) -> u64 {
        let texture = u64::from(POINT_BYTES) * u64::from(width) * u64::from(height);
        texture + 2 * u64::from(row_bytes(width)) * u64::from(height)
    }

    /// One of so many points.
    pub fn new(gpu: &Gpu, width: u32, height: u32) -> Result<Self, GpuError> {
        let most = gpu.device.limits().max_texture_dimension_2d;
        if width > most || height > most {
            let problem = format!("its pictures have at most {most}x{most} points, not {width}x{height}");
            return Err(GpuError::TooLittle { driver: gpu.name().to_owned(), problem });
        }
        if !gpu.can_read_depths() {
            let problem = "it does not give back the depths of a picture".to_owned();
            return Err(GpuError::TooLittle { driver: gpu.name().to_owned(), problem });
        }
        let colours = target(gpu, "colours", [width, height], FORMAT);
        let bytes = 2 * u64::from(row_bytes(width)) * u64::from(height);
        let back = buffer(gpu, "picture", bytes, BufferUsages::COPY_DST | BufferUsages::MAP_READ);
        let drawn = OffScreen { size: [width, height], colours, back };
        gpu.check()?;
        Ok(drawn)
    }

    /// Draws a scene as a view sees it, and reads the picture back. What the view says of where is ignored: it is all of the picture.
    pub fn draw(&self, gpu: &Gpu, scene: &mut Scene, view: &SceneView, picture: &mut Picture) -> Result<(), GpuError> {
        let [width, height] = self.size;
        let view = SceneView { rectangle: [0, 0, width, height], ..*view };
        let colours = self.colours.create_view(&Default::default());
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        scene.draw(gpu, &mut encoder, &colours, self.size, &[view]);
        let row = row_bytes(width);
        let of_colours = u64::from(row) * u64::from(height);
        copy(&mut encoder, &self.colours, &self.back, 0);
        copy(&mut encoder, scene.depths(), &self.back, of_colours);
        gpu.queue.submit([encoder.finish()]);
        let nearest = view.projection.nearest() as f32;
        read(gpu, &self.back, |bytes| {
            let (colours, depths) = bytes.split_at(of_colours as usize);
            let rows = colours.chunks_exact(row as usize).zip(depths.chunks_exact(row as usize));
            for (number, (colours, depths)) in rows.enumerate() {
                let (row_colours, row_nearness) = picture.row(number, 0, width as usize);
                for (colour, stored) in row_colours.iter_mut().zip(colours.chunks_exact(4)) {
                    *colour = [stored[0], stored[1], stored[2]];
                }
                for (nearness, stored) in row_nearness.iter_mut().zip(depths.chunks_exact(4)) {
                    *nearness = f32::from_le_bytes([stored[0], stored[1], stored[2], stored[3]]) / nearest;
                }
            }
        })
    }
}
