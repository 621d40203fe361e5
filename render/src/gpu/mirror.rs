//! The copy of a stream on the device, in parts where the device allows no buffer as large; only what has changed is sent.
//!
//! What is sent in a frame is gathered in one block of RAM, sent at once, and there copied range by range to where it belongs: a
//! range costs a copy on the device, not an allocation and a transfer each.
//!
//! Memory: on the device up to twice what the stream takes (a part grows by doubling, and then exists twice for a moment), and
//! [`BLOCK_BYTES`] for what is sent; as much in RAM, and once more in the driver.

use std::ops::Range;

use wgpu::{Buffer, BufferUsages};

use super::device::{Gpu, GpuError};

/// Most bytes that are sent at once.
pub const BLOCK_BYTES: usize = 4 << 20;
/// Fewest bytes of a part.
const LEAST_BYTES: u64 = 1 << 16;

/// What was sent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Upload {
    /// Bytes.
    pub bytes: u64,
    /// Ranges of the streams.
    pub ranges: u64,
}

/// What is on its way to the device.
#[derive(Debug)]
pub struct Courier {
    block: Vec<u8>,
    /// Where it arrives.
    arrival: Buffer,
    /// From where in the block, to which buffer, to where in it, and how many bytes.
    copies: Vec<(u64, Buffer, u64, u64)>,
    sent: Upload,
}

impl Courier {
    /// With nothing to carry.
    pub fn new(gpu: &Gpu) -> Self {
        let arrival = buffer(gpu, "arrival", BLOCK_BYTES as u64, BufferUsages::COPY_DST | BufferUsages::COPY_SRC);
        Courier { block: Vec::with_capacity(BLOCK_BYTES), arrival, copies: Vec::new(), sent: Upload::default() }
    }

    /// Takes bytes for a place in a buffer; both are multiples of four.
    pub fn take(&mut self, gpu: &Gpu, bytes: &[u8], target: &Buffer, mut offset: u64) {
        self.sent.bytes += bytes.len() as u64;
        self.sent.ranges += 1;
        let mut left = bytes;
        while !left.is_empty() {
            if self.block.len() == BLOCK_BYTES {
                self.send(gpu);
            }
            let (now, later) = left.split_at(left.len().min(BLOCK_BYTES - self.block.len()));
            self.copies.push((self.block.len() as u64, target.clone(), offset, now.len() as u64));
            self.block.extend_from_slice(now);
            offset += now.len() as u64;
            left = later;
        }
    }

    /// Sends what was taken.
    fn send(&mut self, gpu: &Gpu) {
        if self.copies.is_empty() {
            return;
        }
        gpu.queue.write_buffer(&self.arrival, 0, &self.block);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for (from, target, to, bytes) in self.copies.drain(..) {
            encoder.copy_buffer_to_buffer(&self.arrival, from, &target, to, bytes);
        }
        gpu.queue.submit([encoder.finish()]);
        self.block.clear();
    }

    /// Sends the last; what it was in all since the last time.
    pub fn finish(&mut self, gpu: &Gpu) -> Upload {
        self.send(gpu);
        std::mem::take(&mut self.sent)
    }
}

/// A stream on the device.
#[derive(Debug)]
pub struct Mirror {
    name: &'static str,
    element_bytes: usize,
    /// Elements in each part but the last: a power of two.
    part_elements: usize,
    most_parts: usize,
    parts: Vec<Buffer>,
    /// Elements that are to be drawn.
    length: usize,
}

impl Mirror {
    /// An empty one, of elements of so many bytes, a multiple of four, in parts of at most so many bytes, at most so many of them.
    pub fn new(gpu: &Gpu, name: &'static str, element_bytes: usize, most_bytes: u64, most_parts: usize) -> Self {
        let most_elements = usize::try_from(most_bytes).unwrap_or(usize::MAX) / element_bytes;
        let part_elements = 1 << most_elements.max(1).ilog2();
        let mut mirror = Mirror { name, element_bytes, part_elements, most_parts, parts: Vec::new(), length: 0 };
        // Something has to be bound where there is nothing.
        mirror.parts.push(mirror.part(gpu, 1));
        mirror
    }

    fn part(&self, gpu: &Gpu, elements: usize) -> Buffer {
        let elements = elements.next_power_of_two().clamp(self.least_elements(), self.part_elements);
        buffer(gpu, self.name, (elements * self.element_bytes) as u64, STREAM_USAGES)
    }

    fn least_elements(&self) -> usize {
        (LEAST_BYTES as usize / self.element_bytes).next_power_of_two().min(self.part_elements)
    }

    /// The parts, at least one.
    pub fn parts(&self) -> &[Buffer] {
        &self.parts
    }

    /// A part, or the last one where there is none with this number.
    pub fn part_or_last(&self, part: usize) -> &Buffer {
        &self.parts[part.min(self.parts.len() - 1)]
    }

    /// Most parts.
    pub fn most_parts(&self) -> usize {
        self.most_parts
    }

    /// Elements of the stream in a part.
    pub fn elements_in(&self, part: usize) -> usize {
        self.length.saturating_sub(part * self.part_elements).min(self.part_elements)
    }

    /// Elements that a part takes, as a power of two.
    pub fn part_shift(&self) -> u32 {
        self.part_elements.ilog2()
    }

    /// Most elements.
    pub fn most_elements(&self) -> usize {
        self.part_elements.saturating_mul(self.most_parts)
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.parts.iter().map(Buffer::size).sum()
    }

    /// Bytes that there will be on the device for a stream, the old and the new of a part that grows included.
    pub fn bytes_for(&self, stream: &[u8]) -> u64 {
        let elements = stream.len() / self.element_bytes;
        let old = self.parts.last().map_or(0, Buffer::size);
        let (whole, rest) = (elements / self.part_elements, elements % self.part_elements);
        let rest = if rest > 0 { rest.next_power_of_two().max(self.least_elements()) } else { 0 };
        let needed = (whole * self.part_elements + rest) * self.element_bytes;
        if needed as u64 > self.bytes() { needed as u64 + old } else { self.bytes() }
    }

    /// Makes room for a stream; true if parts are other buffers than before.
    pub fn make_room(&mut self, gpu: &Gpu, stream: &[u8]) -> Result<bool, GpuError> {
        let elements = stream.len() / self.element_bytes;
        if elements > self.most_elements() {
            let (most, name) = (self.most_elements(), self.name);
            let problem =
                format!("it takes {most} {name} at most, here are {elements}: give a smaller triangle budget");
            return Err(GpuError::TooLittle { driver: gpu.name().to_owned(), problem });
        }
        let mut is_new = false;
        loop {
            let last = self.parts.len() - 1;
            let needed = (elements - (last * self.part_elements).min(elements)).min(self.part_elements);
            let has = self.parts[last].size() as usize / self.element_bytes;
            if needed > has {
                let larger = self.part(gpu, needed);
                let mut encoder = gpu.device.create_command_encoder(&Default::default());
                encoder.copy_buffer_to_buffer(&self.parts[last], 0, &larger, 0, self.parts[last].size());
                gpu.queue.submit([encoder.finish()]);
                std::mem::replace(&mut self.parts[last], larger).destroy();
                is_new = true;
            }
            if elements <= self.parts.len() * self.part_elements {
                return Ok(is_new);
            }
            self.parts.push(self.part(gpu, elements - self.parts.len() * self.part_elements));
            is_new = true;
        }
    }

    /// Brings it up to date with a stream for which there is room: its bytes, and which of its elements have changed. What it is
    /// longer by than before is sent in any case: the device may have there what was in it when it was as long before.
    pub fn update(
        &mut self,
        gpu: &Gpu,
        courier: &mut Courier,
        stream: &[u8],
        changed: impl Iterator<Item = Range<u32>>,
    ) {
        let before = std::mem::replace(&mut self.length, stream.len() / self.element_bytes);
        let known = before.min(self.length);
        let changed = changed.map(|range| range.start as usize..(range.end as usize).min(known));
        for mut range in changed.chain(std::iter::once(known..self.length)) {
            while range.start < range.end {
                let part = range.start / self.part_elements;
                let end = range.end.min((part + 1) * self.part_elements);
                let offset = (range.start - part * self.part_elements) * self.element_bytes;
                let bytes = &stream[range.start * self.element_bytes..end * self.element_bytes];
                courier.take(gpu, bytes, &self.parts[part], offset as u64);
                range.start = end;
            }
        }
    }
}

const STREAM_USAGES: BufferUsages = BufferUsages::STORAGE.union(BufferUsages::COPY_DST).union(BufferUsages::COPY_SRC);

/// A buffer on the device.
pub fn buffer(gpu: &Gpu, name: &str, size: u64, usage: BufferUsages) -> Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor { label: Some(name), size, usage, mapped_at_creation: false })
}
