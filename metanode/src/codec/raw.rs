//! Bits without a model: each value takes as many as it is said to, the lowest first; the last byte is filled up with zeros.
//!
//! A reader never reads outside of what it is given: beyond the end it reads zeros, and [`RawReader::is_exact`] says so.

/// Writes bits.
#[derive(Debug, Default)]
pub(super) struct RawWriter {
    bytes: Vec<u8>,
    pending: u64,
    count: u32,
}

impl RawWriter {
    /// The lowest `bits` bits of a value, at most 32.
    pub fn push(&mut self, bits: u32, value: u32) {
        self.pending |= (u64::from(value) & ((1 << bits) - 1)) << self.count;
        self.count += bits;
        while self.count >= 8 {
            self.bytes.push(self.pending as u8);
            self.pending >>= 8;
            self.count -= 8;
        }
    }

    /// Appends all that was written to `bytes`, and begins anew.
    pub fn finish(&mut self, bytes: &mut Vec<u8>) {
        if self.count > 0 {
            self.bytes.push(self.pending as u8);
            (self.pending, self.count) = (0, 0);
        }
        bytes.append(&mut self.bytes);
    }
}

/// Reads bits.
#[derive(Debug)]
pub(super) struct RawReader<'a> {
    bytes: &'a [u8],
    next_byte: usize,
    pending: u64,
    count: u32,
}

impl<'a> RawReader<'a> {
    /// From the first bit on.
    pub fn new(bytes: &'a [u8]) -> Self {
        RawReader { bytes, next_byte: 0, pending: 0, count: 0 }
    }

    /// A value of so many bits, at most 32.
    #[inline(always)]
    pub fn take(&mut self, bits: u32) -> u32 {
        if self.count < bits {
            // As many whole bytes as fit, at least 32 bits in all.
            match self.bytes.get(self.next_byte..).and_then(|rest| rest.first_chunk::<4>()) {
                Some(chunk) => {
                    self.pending |= u64::from(u32::from_le_bytes(*chunk)) << self.count;
                    self.next_byte += 4;
                    self.count += 32;
                }
                None => {
                    while self.count < bits {
                        let byte = self.bytes.get(self.next_byte).copied().unwrap_or(0);
                        self.pending |= u64::from(byte) << self.count;
                        self.next_byte += 1;
                        self.count += 8;
                    }
                }
            }
        }
        let value = self.pending & ((1 << bits) - 1);
        self.pending >>= bits;
        self.count -= bits;
        value as u32
    }

    /// Whether everything that there was has been read, and nothing beyond: what fills up the last byte is zero.
    pub fn is_exact(&self) -> bool {
        let read = self.next_byte * 8 - self.count as usize;
        read.div_ceil(8) == self.bytes.len() && self.pending == 0
    }
}
