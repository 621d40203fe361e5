//! Textures that are drawn into, and how what is in them comes back to RAM.

use wgpu::{Buffer, CommandEncoder, Texture, TextureFormat, TextureUsages};

use super::device::{Gpu, GpuError};

/// Bytes of a point, in all formats that are drawn into.
pub const POINT_BYTES: u32 = 4;

/// A texture of so many points that is drawn into, and can be copied from.
pub fn target(gpu: &Gpu, label: &str, [width, height]: [u32; 2], format: TextureFormat) -> Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}

/// Bytes from one row to the next of what was copied.
pub fn row_bytes(width: u32) -> u32 {
    (width * POINT_BYTES).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
}

/// Copies a texture to a place in a buffer, row by row from the top.
pub fn copy(encoder: &mut CommandEncoder, texture: &Texture, buffer: &Buffer, offset: u64) {
    let (bytes_per_row, rows_per_image) = (Some(row_bytes(texture.width())), Some(texture.height()));
    let layout = wgpu::TexelCopyBufferLayout { offset, bytes_per_row, rows_per_image };
    let target = wgpu::TexelCopyBufferInfo { buffer, layout };
    encoder.copy_texture_to_buffer(texture.as_image_copy(), target, texture.size());
}

/// Waits for all that was asked for, and hands on what is in a buffer then.
pub fn read<T>(gpu: &Gpu, buffer: &Buffer, take: impl FnOnce(&[u8]) -> T) -> Result<T, GpuError> {
    let failed = |problem: String| GpuError::Failed { driver: gpu.name().to_owned(), problem };
    let (tell, told) = std::sync::mpsc::channel();
    buffer.map_async(wgpu::MapMode::Read, .., move |result| {
        // Who asked waits for it below.
        let _ = tell.send(result);
    });
    gpu.wait()?;
    let mapped = told.recv().map_err(|error| failed(error.to_string()))?;
    mapped.map_err(|error| failed(error.to_string()))?;
    let taken = take(&buffer.get_mapped_range(..).map_err(|error| failed(error.to_string()))?);
    buffer.unmap();
    Ok(taken)
}
