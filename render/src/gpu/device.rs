//! The graphics driver, and what it allows.
//!
//! A *processor driver* (lavapipe, SwiftShader, WARP) draws by the processor, as [`draw`](crate::draw) does: it is of use where a
//! window needs a driver, and for tests.
//!
//! Memory: a driver takes tens to hundreds of MiB of RAM for itself, beside all budgets, as soon as it is looked for. On Linux none
//! is looked for where the system has no device for it, see [`Drivers::Hardware`].

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use thiserror::Error;
use wgpu::{Adapter, Device, DeviceType, DownlevelFlags, Instance, Limits, Queue, Surface};

use crate::looks::Room;

/// Storage buffers that the vertex shader takes beside those of the vertices and their wedges.
pub(crate) const OTHER_BUFFERS: u32 = 4;
/// Storage buffers that it takes for each part that vertices are divided into.
pub(crate) const BUFFERS_PER_PART: u32 = 3;

/// What can go wrong with a graphics driver.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum GpuError {
    /// There is no driver, or none of those asked for.
    #[error("no graphics driver was found ({reason})")]
    NoDriver {
        /// What was looked for.
        reason: String,
    },
    /// The driver cannot do what is needed.
    #[error("the graphics driver {driver} cannot draw this: {problem}")]
    TooLittle {
        /// Its name.
        driver: String,
        /// What is missing.
        problem: String,
    },
    /// The memory allowed on the device is too little.
    #[error("{allowed} bytes of GPU memory are too few: {needed} are needed for {what}")]
    Memory {
        /// Bytes allowed.
        allowed: u64,
        /// Bytes needed.
        needed: u64,
        /// For what.
        what: &'static str,
    },
    /// The driver failed while it was at work.
    #[error("the graphics driver {driver} failed: {problem}")]
    Failed {
        /// Its name.
        driver: String,
        /// What it said.
        problem: String,
    },
}

/// Which drivers to look for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drivers {
    /// Those of graphics hardware. On Linux, where the system has no device of that kind, no driver is loaded at all.
    Hardware,
    /// Any; that of hardware rather than one that draws by the processor.
    Any,
}

/// An open graphics device.
#[derive(Debug)]
pub struct Gpu {
    /// The device: makes buffers and pipelines.
    pub device: Device,
    /// Where commands go.
    pub queue: Queue,
    /// What it was opened from: tells what surfaces can do.
    pub adapter: Adapter,
    /// Where that was found: makes surfaces.
    pub instance: Instance,
    name: String,
    is_processor: bool,
    failure: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Opens a device for pictures without a window.
    pub fn open(drivers: Drivers) -> Result<Self, GpuError> {
        if drivers == Drivers::Hardware && !may_have_hardware() {
            let reason = "the system has no graphics device".to_owned();
            return Err(GpuError::NoDriver { reason });
        }
        let instance = Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        Self::choose(instance, None, drivers)
    }

    /// Opens a device that can show its pictures on a surface.
    pub fn for_surface(instance: Instance, surface: &Surface<'_>) -> Result<Self, GpuError> {
        Self::choose(instance, Some(surface), Drivers::Any)
    }

    fn choose(instance: Instance, surface: Option<&Surface<'_>>, drivers: Drivers) -> Result<Self, GpuError> {
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: surface,
            ..Default::default()
        };
        let adapter = pollster::block_on(instance.request_adapter(&options))
            .map_err(|error| GpuError::NoDriver { reason: error.to_string() })?;
        let info = adapter.get_info();
        let is_processor = info.device_type == DeviceType::Cpu;
        if is_processor && drivers == Drivers::Hardware {
            let reason = format!("{} draws by the processor", info.name);
            return Err(GpuError::NoDriver { reason });
        }
        let name = format!("{} ({})", info.name, info.backend);
        let too_little = |problem: String| GpuError::TooLittle { driver: name.clone(), problem };
        let allowed = adapter.limits();
        let buffers = OTHER_BUFFERS + BUFFERS_PER_PART;
        let has_storage = adapter.get_downlevel_capabilities().flags.contains(DownlevelFlags::VERTEX_STORAGE);
        if !has_storage || allowed.max_storage_buffers_per_shader_stage < buffers {
            return Err(too_little(format!("{buffers} storage buffers are needed for vertices")));
        }
        let limits = Limits {
            max_storage_buffers_per_shader_stage: allowed.max_storage_buffers_per_shader_stage,
            max_storage_buffer_binding_size: allowed.max_storage_buffer_binding_size,
            max_buffer_size: allowed.max_buffer_size,
            max_texture_array_layers: allowed.max_texture_array_layers,
            ..Limits::downlevel_defaults().using_resolution(allowed.clone())
        };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("vdt"),
            required_limits: limits,
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| too_little(error.to_string()))?;
        let failure = Arc::new(Mutex::new(None));
        let note = |failure: &Arc<Mutex<Option<String>>>, problem: String| {
            failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(problem);
        };
        let (of_errors, of_loss) = (failure.clone(), failure.clone());
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&of_errors, error.to_string())));
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                note(&of_loss, message);
            }
        });
        Ok(Gpu { device, queue, adapter, instance, name, is_processor, failure })
    }

    /// Its name, and how it is spoken to: "llvmpipe (LLVM 15.0.6, 256 bits) (vulkan)".
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether the driver draws by the processor.
    pub fn is_processor(&self) -> bool {
        self.is_processor
    }

    /// How much room there is for textures: half of the memory on the device, and while they are made, half of that in RAM.
    pub fn room_for_textures(&self, memory: u64, gpu_memory: u64) -> Room {
        let limits = self.device.limits();
        let bytes = (gpu_memory / 2).min(memory / 2);
        Room {
            bytes,
            decoding_bytes: memory - bytes,
            most_side: limits.max_texture_dimension_2d,
            most_textures: limits.max_texture_array_layers,
        }
    }

    /// Whether depths can be read back.
    pub(crate) fn can_read_depths(&self) -> bool {
        let flags = self.adapter.get_downlevel_capabilities().flags;
        flags.contains(DownlevelFlags::DEPTH_TEXTURE_AND_BUFFER_COPIES)
    }

    /// The most bytes of a buffer that a shader can read.
    pub(crate) fn most_buffer_bytes(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// What the driver has failed in since the last time, if anything.
    pub fn check(&self) -> Result<(), GpuError> {
        let failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner).take();
        failure.map_or(Ok(()), |problem| Err(GpuError::Failed { driver: self.name.clone(), problem }))
    }

    /// Waits until all that was asked for is done.
    pub fn wait(&self) -> Result<(), GpuError> {
        let failed =
            |error: wgpu::PollError| GpuError::Failed { driver: self.name.clone(), problem: error.to_string() };
        self.device.poll(wgpu::PollType::wait_indefinitely()).map_err(failed)?;
        self.check()
    }
}

/// Whether the system has a graphics device, as far as can be seen without a driver.
fn may_have_hardware() -> bool {
    let has_entries = |folder: &str| Path::new(folder).read_dir().is_ok_and(|mut entries| entries.next().is_some());
    !cfg!(target_os = "linux")
        || has_entries("/dev/dri")
        || ["/dev/nvidiactl", "/dev/dxg", "/dev/kgsl-3d0", "/dev/mali0"].iter().any(|path| Path::new(path).exists())
}
