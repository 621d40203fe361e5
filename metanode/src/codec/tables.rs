//! The probabilities of all symbols and decisions, counted once for a whole file, and how they are written down.
//!
//! A page is far too small to learn from, and to decode a page must not take any other but its ancestors. So the writer looks at
//! the pages beforehand, and all of them are coded with the same tables. What is written down are not probabilities of 12 bits
//! but their quarter-octave classes, which cost half as much, and less than a hundredth of a bit for each symbol; both the
//! writer and the readers code with what these stand for. A context that was never seen is not written down: it has the
//! built-in probabilities. No probability is ever 0, so that anything can be coded with any table.
//!
//! ```text
//! 6 bits                                  frequent numbers (`frequent`)
//!   32 bits                               for each of them
//! for each context of symbols    1 bit    whether it was seen; if so, for each symbol:
//!                                1 bit      whether it was seen; if so
//!                                6 bits     its class
//! for each context of decisions  1 bit    whether it was seen; if so
//!                                7 bits     the class of the rarer outcome, and in the top bit whether that is "no"
//! ```
//!
//! filled up with zeros to whole bytes.
//!
//! Memory: about 250 KB.

use super::contexts::{DECISION_CONTEXTS, FAMILIES, SYMBOL_CONTEXTS};
use super::frequent::Frequent;
use super::rans::{Coder, TOTAL};
use super::raw::{RawReader, RawWriter};

/// Bits of the class of a symbol.
const SYMBOL_BITS: u32 = 6;
/// Bits of the class of a decision.
const DECISION_BITS: u32 = 7;
/// In the class of a decision: the rarer outcome is "no".
const RARELY_NO: u8 = 1 << (DECISION_BITS - 1);
/// How many values of the coder one look-up stands for, as a power of two.
const LOOK_UP_SHIFT: u32 = 4;
/// Entries of the look-up table of a context.
const LOOK_UPS: usize = (TOTAL >> LOOK_UP_SHIFT) as usize;

/// The quarter-octave class of a number from 1 to 4,096.
fn class(number: u32) -> u8 {
    if number < 8 {
        return number as u8;
    }
    let top = 31 - number.leading_zeros();
    (4 * top - 4 + (number >> (top - 2) & 3)) as u8
}

/// The middle of the numbers of a class.
fn of_class(class: u8) -> u32 {
    let class = u32::from(class);
    if class < 8 {
        return class;
    }
    let top = class / 4 + 1;
    (4 | class & 3) << (top - 2) | 1 << (top - 2) >> 1
}

/// What is written down of the probabilities.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Classes {
    /// For each symbol of each context, in order; 0 where it was not seen.
    symbols: Vec<u8>,
    /// For each context of a decision; 0 where it was not seen.
    decisions: Vec<u8>,
}

/// The contexts in order, with the number of symbols in each.
fn alphabets() -> impl Iterator<Item = usize> {
    FAMILIES.iter().flat_map(|family| std::iter::repeat_n(family.symbols, family.contexts))
}

/// Where the symbols of each context begin among all, and how many there are of all.
fn offsets() -> (Vec<u32>, usize) {
    let mut next = 0;
    let mut offsets = Vec::with_capacity(SYMBOL_CONTEXTS);
    for symbols in alphabets() {
        offsets.push(next as u32);
        next += symbols;
    }
    (offsets, next)
}

/// How often each symbol and decision came, in each context.
#[derive(Debug, Clone)]
pub(crate) struct Counts {
    offsets: Vec<u32>,
    symbols: Vec<u64>,
    decisions: Vec<[u64; 2]>,
}

impl Counts {
    /// Nothing was seen.
    pub fn new() -> Self {
        let (offsets, symbols) = offsets();
        Counts { offsets, symbols: vec![0; symbols], decisions: vec![[0; 2]; DECISION_CONTEXTS] }
    }

    /// Adds what another one has seen.
    pub fn add(&mut self, other: &Counts) {
        self.symbols.iter_mut().zip(&other.symbols).for_each(|(sum, count)| *sum += count);
        for (sum, count) in self.decisions.iter_mut().zip(&other.decisions) {
            *sum = [sum[0] + count[0], sum[1] + count[1]];
        }
    }

    /// The classes of what was seen.
    pub fn classes(&self) -> Classes {
        let scaled = |count: u64, total: u64| {
            let scaled = (count * u64::from(TOTAL) + total / 2).checked_div(total).unwrap_or(0);
            if count == 0 { 0 } else { class((scaled as u32).clamp(1, TOTAL)) }
        };
        let mut symbols = Vec::with_capacity(self.symbols.len());
        for (offset, count) in self.offsets.iter().zip(alphabets()) {
            let counts = &self.symbols[*offset as usize..][..count];
            let total = counts.iter().sum();
            symbols.extend(counts.iter().map(|count| scaled(*count, total)));
        }
        let decision = |[no, yes]: &[u64; 2]| {
            let total = no + yes;
            let rarer = class((scaled_half((*no).min(*yes), total)).max(1));
            match total {
                0 => 0,
                _ if no < yes => rarer | RARELY_NO,
                _ => rarer,
            }
        };
        Classes { symbols, decisions: self.decisions.iter().map(decision).collect() }
    }
}

/// A share of a half of the total, at most.
fn scaled_half(count: u64, total: u64) -> u32 {
    ((count * u64::from(TOTAL) + total / 2).checked_div(total).unwrap_or(0) as u32).min(TOTAL / 2)
}

impl Coder for Counts {
    const DECODES: bool = false;

    fn symbol(&mut self, context: usize, symbol: usize) -> usize {
        self.symbols[self.offsets[context] as usize + symbol] += 1;
        symbol
    }

    fn decision(&mut self, context: usize, decision: bool) -> bool {
        self.decisions[context][usize::from(decision)] += 1;
        decision
    }

    fn raw(&mut self, _: u32, value: u32) -> u32 {
        value
    }
}

/// Why what should be tables is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct BadTables;

impl Classes {
    /// Of contexts none of which was seen.
    pub fn unseen() -> Self {
        Classes { symbols: vec![0; offsets().1], decisions: vec![0; DECISION_CONTEXTS] }
    }

    /// As bytes, with the frequent numbers of the file.
    pub fn to_bytes(&self, frequent: &Frequent) -> Vec<u8> {
        let mut bits = RawWriter::default();
        bits.push(6, frequent.numbers().len() as u32);
        frequent.numbers().iter().for_each(|number| bits.push(32, *number));
        let mut rest = self.symbols.as_slice();
        for count in alphabets() {
            let (symbols, others) = rest.split_at(count);
            rest = others;
            let is_seen = symbols.iter().any(|class| *class > 0);
            bits.push(1, is_seen.into());
            if is_seen {
                for class in symbols {
                    bits.push(1, (*class > 0).into());
                    if *class > 0 {
                        bits.push(SYMBOL_BITS, (*class).into());
                    }
                }
            }
        }
        for class in &self.decisions {
            bits.push(1, (*class > 0).into());
            if *class > 0 {
                bits.push(DECISION_BITS, (*class).into());
            }
        }
        let mut bytes = Vec::new();
        bits.finish(&mut bytes);
        bytes
    }

    /// From bytes, all of which must be used.
    pub fn from_bytes(bytes: &[u8]) -> Result<(Self, Frequent), BadTables> {
        let mut bits = RawReader::new(bytes);
        let numbers: Vec<u32> = (0..bits.take(6)).map(|_| bits.take(32)).collect();
        let frequent = Frequent::new(&numbers).ok_or(BadTables)?;
        let mut symbols = Vec::new();
        for count in alphabets() {
            let is_seen = bits.take(1) == 1;
            for _ in 0..count {
                symbols.push(if is_seen && bits.take(1) == 1 { bits.take(SYMBOL_BITS) as u8 } else { 0 });
            }
        }
        let decisions = (0..DECISION_CONTEXTS)
            .map(|_| if bits.take(1) == 1 { bits.take(DECISION_BITS) as u8 } else { 0 })
            .collect();
        let classes = Classes { symbols, decisions };
        // Nothing else has the same meaning: no class but those that are written, no byte behind the last.
        if classes.to_bytes(&frequent) != bytes || classes.symbols.iter().any(|value| *value > class(TOTAL)) {
            return Err(BadTables);
        }
        Ok((classes, frequent))
    }
}

/// The tables that a coder works with.
#[derive(Debug, Clone)]
pub(crate) struct Tables {
    offsets: Vec<u32>,
    /// Of each symbol where its interval begins, and in the upper half how long it is.
    intervals: Vec<u32>,
    /// For each context and each stretch of values the symbol with the first of them.
    look_up: Vec<u8>,
    /// Of each decision the probability of "yes".
    ones: Vec<u16>,
}

impl Tables {
    /// What these classes stand for.
    pub fn new(classes: &Classes) -> Self {
        let (offsets, count) = offsets();
        let mut intervals = Vec::with_capacity(count);
        let mut look_up = vec![0; SYMBOL_CONTEXTS * LOOK_UPS];
        for ((offset, symbols), look_up) in offsets.iter().zip(alphabets()).zip(look_up.chunks_exact_mut(LOOK_UPS)) {
            let classes = &classes.symbols[*offset as usize..][..symbols];
            let mut start = 0;
            for (symbol, frequency) in frequencies(classes).into_iter().enumerate() {
                intervals.push(frequency << 16 | start);
                let end = start + frequency;
                // The stretches that begin inside.
                let stretches = start.div_ceil(1 << LOOK_UP_SHIFT)..end.div_ceil(1 << LOOK_UP_SHIFT);
                stretches.for_each(|stretch| look_up[stretch as usize] = symbol as u8);
                start = end;
            }
        }
        let ones = classes.decisions.iter().map(|class| {
            let rarer = of_class(class & (RARELY_NO - 1)).clamp(1, TOTAL - 1);
            (if *class == 0 {
                TOTAL / 2
            } else if class & RARELY_NO != 0 {
                TOTAL - rarer
            } else {
                rarer
            }) as u16
        });
        Tables { offsets, intervals, look_up, ones: ones.collect() }
    }

    /// Bytes of RAM that this holds.
    pub fn ram_bytes(&self) -> usize {
        4 * (self.offsets.len() + self.intervals.len()) + self.look_up.len() + 2 * self.ones.len()
    }

    /// The interval of a symbol: where it begins, and in the upper half how long it is.
    pub fn interval(&self, context: usize, symbol: usize) -> u32 {
        self.intervals[self.offsets[context] as usize + symbol]
    }

    /// The symbol whose interval holds a value below [`TOTAL`], and that interval.
    #[inline(always)]
    pub fn find(&self, context: usize, value: u32) -> (usize, u32) {
        let mut symbol = usize::from(self.look_up[context * LOOK_UPS + (value >> LOOK_UP_SHIFT) as usize]);
        let offset = self.offsets[context] as usize;
        loop {
            let interval = self.intervals[offset + symbol];
            // The last interval ends at the total, so this ends there.
            if value < (interval & 0xffff) + (interval >> 16) {
                return (symbol, interval);
            }
            symbol += 1;
        }
    }

    /// The probability of "yes".
    #[inline(always)]
    pub fn ones(&self, context: usize) -> u16 {
        self.ones[context]
    }
}

/// Probabilities, in [`TOTAL`] parts, none of them 0, about in proportion to what the classes stand for.
fn frequencies(classes: &[u8]) -> Vec<u32> {
    let weights: Vec<u32> = if classes.iter().all(|class| *class == 0) {
        vec![1; classes.len()]
    } else {
        classes.iter().map(|class| of_class(*class)).collect()
    };
    let sum: u32 = weights.iter().sum();
    let parts = TOTAL - classes.len() as u32;
    let mut frequencies: Vec<u32> =
        weights.iter().map(|weight| 1 + (u64::from(*weight) * u64::from(parts) / u64::from(sum)) as u32).collect();
    let missing = TOTAL - frequencies.iter().sum::<u32>();
    let largest = (0..weights.len()).max_by_key(|symbol| (weights[*symbol], usize::MAX - symbol)).unwrap_or(0);
    frequencies[largest] += missing;
    frequencies
}
