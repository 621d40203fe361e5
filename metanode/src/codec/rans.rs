//! The entropy coder: rANS with static tables (Duda, *Asymmetric numeral systems*, 2013), and raw bits beside it.
//!
//! Two states of 32 bits take turns, so that a decoder can begin with a symbol before the one before it is done; both are
//! renormalised by 16-bit words from one stream. Probabilities have 12 bits. The encoder takes all symbols of a page in
//! order, and writes them from the last to the first, as rANS asks for; the decoder gets them in order. What has no
//! structure (mantissas, offsets) goes into a stream of raw bits of its own, which costs no multiplication.
//!
//! A decoder never reads outside of what it is given: beyond the end it reads zeros, and says so in the end
//! ([`Decoder::is_exact`]). When all symbols are read both states must be back where the encoder began: that is a checksum
//! of its own.
//!
//! ```text
//! bytes  a coded body
//! 4      words: how many 16-bit words there are
//! 4 + 4  the states from which decoding begins
//! 2 w    the words
//!        raw bits, lowest first, filled up with zeros to whole bytes
//! ```
//!
//! Written here and not taken from a crate: `constriction` has the same coder, but with models that are built for each symbol
//! or looked up in tables of 2¹² entries for each context. With some thousand contexts, most of them for one bit, what is
//! needed is a multiplication and a comparison.

use super::raw::{RawReader, RawWriter};
use super::tables::Tables;

/// Bits of a probability.
pub(crate) const PRECISION: u32 = 12;
/// What all probabilities of a context add up to.
pub(crate) const TOTAL: u32 = 1 << PRECISION;
/// Where both states begin, and below which they are renormalised.
const LOWEST: u32 = 1 << 16;
/// Bytes in front of the words.
const START: usize = 12;

/// Codes symbols: encodes them, decodes them, or counts them. An encoder returns what it is given; a decoder returns what was
/// given to the encoder, whatever it is given itself. So whoever codes a field writes it down once for all three.
pub(crate) trait Coder {
    /// Whether what it returns is to be believed more than what it is given.
    const DECODES: bool;

    /// A symbol of an alphabet, in a context of it.
    fn symbol(&mut self, context: usize, symbol: usize) -> usize;

    /// A decision, in a context.
    fn decision(&mut self, context: usize, decision: bool) -> bool;

    /// The lowest `bits` bits of a value, at most 32.
    fn raw(&mut self, bits: u32, value: u32) -> u32;
}

/// Takes symbols and does nothing with them: for who wants to know what follows from the fields.
#[derive(Debug)]
pub(crate) struct Uncounted;

impl Coder for Uncounted {
    const DECODES: bool = false;

    fn symbol(&mut self, _: usize, symbol: usize) -> usize {
        symbol
    }

    fn decision(&mut self, _: usize, decision: bool) -> bool {
        decision
    }

    fn raw(&mut self, _: u32, value: u32) -> u32 {
        value
    }
}

/// Encodes a page.
#[derive(Debug)]
pub(crate) struct Encoder<'a> {
    tables: &'a Tables,
    /// Where the interval of each symbol begins, and in the upper half how long it is.
    intervals: Vec<u32>,
    raw: RawWriter,
    words: Vec<u16>,
}

impl<'a> Encoder<'a> {
    /// By these tables.
    pub fn new(tables: &'a Tables) -> Self {
        Encoder { tables, intervals: Vec::new(), raw: RawWriter::default(), words: Vec::new() }
    }

    /// Appends all that was coded to `bytes`, and begins anew.
    pub fn finish(&mut self, bytes: &mut Vec<u8>) {
        let mut states = [LOWEST; 2];
        self.words.clear();
        for (index, interval) in self.intervals.iter().enumerate().rev() {
            let (start, frequency) = (interval & 0xffff, interval >> 16);
            let state = &mut states[index & 1];
            if u64::from(*state) >= u64::from(frequency) << (32 - PRECISION) {
                self.words.push(*state as u16);
                *state >>= 16;
            }
            *state = ((*state / frequency) << PRECISION) + *state % frequency + start;
        }
        bytes.extend((self.words.len() as u32).to_le_bytes());
        states.iter().for_each(|state| bytes.extend(state.to_le_bytes()));
        self.words.iter().rev().for_each(|word| bytes.extend(word.to_le_bytes()));
        self.raw.finish(bytes);
        self.intervals.clear();
    }
}

impl Coder for Encoder<'_> {
    const DECODES: bool = false;

    fn symbol(&mut self, context: usize, symbol: usize) -> usize {
        self.intervals.push(self.tables.interval(context, symbol));
        symbol
    }

    fn decision(&mut self, context: usize, decision: bool) -> bool {
        let ones = u32::from(self.tables.ones(context));
        self.intervals.push(if decision { ones << 16 } else { (TOTAL - ones) << 16 | ones });
        decision
    }

    fn raw(&mut self, bits: u32, value: u32) -> u32 {
        self.raw.push(bits, value);
        value
    }
}

/// Decodes a page.
#[derive(Debug)]
pub(crate) struct Decoder<'a> {
    tables: &'a Tables,
    /// The state whose turn it is, and the other one.
    states: [u32; 2],
    words: &'a [[u8; 2]],
    next_word: usize,
    raw: RawReader<'a>,
}

impl<'a> Decoder<'a> {
    /// Of a coded body; `None` where it is too short to be one.
    pub fn new(tables: &'a Tables, bytes: &'a [u8]) -> Option<Self> {
        let (start, rest) = bytes.split_first_chunk::<START>()?;
        let word =
            |index: usize| u32::from_le_bytes([start[index], start[index + 1], start[index + 2], start[index + 3]]);
        let (words, raw) = rest.split_at_checked((word(0) as usize).checked_mul(2)?)?;
        Some(Decoder {
            tables,
            states: [word(4), word(8)],
            words: words.as_chunks::<2>().0,
            next_word: 0,
            raw: RawReader::new(raw),
        })
    }

    /// Whether everything that there was has been read, and nothing beyond.
    pub fn is_exact(&self) -> bool {
        self.states == [LOWEST; 2] && self.next_word == self.words.len() && self.raw.is_exact()
    }

    /// The state after a symbol whose interval was found.
    #[inline(always)]
    fn advance(&mut self, start: u32, frequency: u32) {
        let state = self.states[0];
        let next = frequency.wrapping_mul(state >> PRECISION).wrapping_add((state & (TOTAL - 1)).wrapping_sub(start));
        // Whether a word is due is hard to foresee, so there is no branch for it.
        let word = self.words.get(self.next_word).map_or(0, |word| u16::from_le_bytes(*word));
        let is_due = next < LOWEST;
        self.next_word += usize::from(is_due);
        let shifted = next << 16 | u32::from(word);
        self.states = [self.states[1], if is_due { shifted } else { next }];
    }
}

impl Coder for Decoder<'_> {
    const DECODES: bool = true;

    #[inline(always)]
    fn symbol(&mut self, context: usize, _: usize) -> usize {
        let (symbol, interval) = self.tables.find(context, self.states[0] & (TOTAL - 1));
        self.advance(interval & 0xffff, interval >> 16);
        symbol
    }

    #[inline(always)]
    fn decision(&mut self, context: usize, _: bool) -> bool {
        let ones = u32::from(self.tables.ones(context));
        let decision = self.states[0] & (TOTAL - 1) < ones;
        let (start, frequency) = if decision { (0, ones) } else { (ones, TOTAL - ones) };
        self.advance(start, frequency);
        decision
    }

    #[inline(always)]
    fn raw(&mut self, bits: u32, _: u32) -> u32 {
        self.raw.take(bits)
    }
}
