//! The probabilities of all symbols and decisions, counted once for a whole file, and how they are written down.
//!
//! A page is far too small to learn from, and to decode a page must not take any other but its ancestors. So the writer looks at
//! the pages beforehand, and all of them are coded with the same tables. What is written down are not probabilities of 12 bits
//! but their quarter-octave classes, which cost half as much, and less than a hundredth of a bit for each symbol; both the
//! writer and the readers code with what these stand for. A context that is not worth it is not written down: it has the
//! built-in probabilities (`built_in`). No probability is ever 0, so that anything can be coded with any table.
//!
//! ```text
//! 6 bits                                  frequent numbers (`frequent`)
//!   32 bits                               for each of them
//! 1 bit                                   whether most coordinates have a denominator (`fractions`); if so
//!   32 bits                               it
//! for each family of symbols     1 bit    whether a context of it is written down; if so, for each context:
//!                                1 bit      whether it is; if so, for each symbol:
//!                                1 bit        whether it was seen; if so
//!                                6 bits       its class
//! for each family of decisions   1 bit    whether a context of it is written down; if so, for each context:
//!                                1 bit      whether it is; if so
//!                                7 bits       the class of the rarer outcome, and in the top bit whether that is "no"
//! ```
//!
//! filled up with zeros to whole bytes.
//!
//! Memory: about 300 KB.

use super::contexts::{DECISION_CONTEXTS, DECISIONS, FAMILIES, Family, SYMBOL_CONTEXTS};
use super::frequent::Frequent;
use super::rans::{Coder, TOTAL};
use super::raw::{RawReader, RawWriter};
use super::{Numbers, built_in};

/// Bits of the class of a symbol.
pub(super) const SYMBOL_BITS: u32 = 6;
/// Bits of the class of a decision.
pub(super) const DECISION_BITS: u32 = 7;
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
    /// For each symbol of each context, in order; 0 where it was not seen. The built-in ones for contexts where none was.
    pub(super) symbols: Vec<u8>,
    /// For each context of a decision; 0 for the built-in one.
    pub(super) decisions: Vec<u8>,
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
    pub(super) symbols: Vec<u64>,
    pub(super) decisions: Vec<[u64; 2]>,
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

    /// Where the symbols of a context are.
    pub(super) fn symbols_of(&self, context: usize) -> std::ops::Range<usize> {
        let end = self.offsets.get(context + 1).map_or(self.symbols.len(), |end| *end as usize);
        self.offsets[context] as usize..end
    }

    /// Adds a share of what another one has seen, in 256ths; what of a decision was seen, a little less seldom.
    #[cfg(test)]
    pub fn add_share(&mut self, other: &Counts, share: u64) {
        self.symbols.iter_mut().zip(&other.symbols).for_each(|(sum, count)| *sum += count * share);
        for (sum, [no, yes]) in self.decisions.iter_mut().zip(&other.decisions) {
            *sum = [sum[0] + no * share, sum[1] + yes * share];
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

    /// As bytes, with what numbers coordinates are in the file.
    pub fn to_bytes(&self, numbers: Numbers) -> Vec<u8> {
        let Numbers { denominator, frequent } = numbers;
        let mut bits = RawWriter::default();
        bits.push(6, frequent.numbers().len() as u32);
        frequent.numbers().iter().for_each(|number| bits.push(32, *number));
        bits.push(1, (denominator > 0.0).into());
        if denominator > 0.0 {
            bits.push(32, denominator.to_bits());
        }
        self.write(&mut bits);
        let mut bytes = Vec::new();
        bits.finish(&mut bytes);
        bytes
    }

    /// Writes the contexts.
    pub(super) fn write(&self, bits: &mut RawWriter) {
        let mut rest = self.symbols.as_slice();
        for family in FAMILIES {
            let (symbols, others) = rest.split_at(family.contexts * family.symbols);
            rest = others;
            let is_some = symbols.iter().any(|class| *class > 0);
            bits.push(1, is_some.into());
            for symbols in symbols.chunks(family.symbols).filter(|_| is_some) {
                let is_written = symbols.iter().any(|class| *class > 0);
                bits.push(1, is_written.into());
                for class in symbols.iter().filter(|_| is_written) {
                    bits.push(1, (*class > 0).into());
                    if *class > 0 {
                        bits.push(SYMBOL_BITS, (*class).into());
                    }
                }
            }
        }
        for family in DECISIONS {
            let classes = &self.decisions[family.first..family.first + family.contexts];
            let is_some = classes.iter().any(|class| *class > 0);
            bits.push(1, is_some.into());
            for class in classes.iter().filter(|_| is_some) {
                bits.push(1, (*class > 0).into());
                if *class > 0 {
                    bits.push(DECISION_BITS, (*class).into());
                }
            }
        }
    }

    /// Reads the contexts of the first families; nothing is known of the others.
    pub(super) fn read(bits: &mut RawReader<'_>, families: &[Family], decisions: &[Family]) -> Self {
        let mut classes = Classes { symbols: Vec::new(), decisions: Vec::new() };
        for family in families {
            let is_some = bits.take(1) == 1;
            for _ in 0..family.contexts {
                let is_written = is_some && bits.take(1) == 1;
                for _ in 0..family.symbols {
                    let is_seen = is_written && bits.take(1) == 1;
                    classes.symbols.push(if is_seen { bits.take(SYMBOL_BITS) as u8 } else { 0 });
                }
            }
        }
        for family in decisions {
            let is_some = bits.take(1) == 1;
            for _ in 0..family.contexts {
                let is_written = is_some && bits.take(1) == 1;
                classes.decisions.push(if is_written { bits.take(DECISION_BITS) as u8 } else { 0 });
            }
        }
        classes.symbols.resize(offsets().1, 0);
        classes.decisions.resize(DECISION_CONTEXTS, 0);
        classes
    }

    /// How many contexts of symbols and of decisions are written down.
    fn written(&self) -> usize {
        let mut rest = self.symbols.as_slice();
        let mut written = 0;
        for count in alphabets() {
            let (symbols, others) = rest.split_at(count);
            rest = others;
            written += usize::from(symbols.iter().any(|class| *class > 0));
        }
        written + self.decisions.iter().filter(|class| **class > 0).count()
    }

    /// From bytes, all of which must be used.
    pub fn from_bytes(bytes: &[u8]) -> Result<(Self, Numbers), BadTables> {
        let mut bits = RawReader::new(bytes);
        let numbers: Vec<u32> = (0..bits.take(6)).map(|_| bits.take(32)).collect();
        let frequent = Frequent::new(&numbers).ok_or(BadTables)?;
        let denominator = if bits.take(1) == 1 { f32::from_bits(bits.take(32)) } else { 0.0 };
        if denominator != 0.0 && !(denominator.is_normal() && denominator > 0.0) {
            return Err(BadTables);
        }
        let numbers = Numbers { denominator, frequent };
        let classes = Classes::read(&mut bits, &FAMILIES, &DECISIONS);
        // Nothing else has the same meaning: no class but those that are written, no byte behind the last.
        if classes.to_bytes(numbers) != bytes || classes.symbols.iter().any(|value| *value > class(TOTAL)) {
            return Err(BadTables);
        }
        Ok((classes, numbers))
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
    /// How many contexts are the file's own, not built in.
    own: usize,
}

impl Tables {
    /// What these classes stand for, and for the contexts that are not written down the built-in ones.
    pub fn new(classes: &Classes) -> Self {
        let built_in = built_in::classes();
        let (offsets, count) = offsets();
        let mut intervals = Vec::with_capacity(count);
        let mut look_up = vec![0; SYMBOL_CONTEXTS * LOOK_UPS];
        for ((offset, symbols), look_up) in offsets.iter().zip(alphabets()).zip(look_up.chunks_exact_mut(LOOK_UPS)) {
            let mut start = 0;
            let own = &classes.symbols[*offset as usize..][..symbols];
            let is_written = own.iter().any(|class| *class > 0);
            let classes = if is_written { own } else { &built_in.symbols[*offset as usize..][..symbols] };
            for (symbol, frequency) in frequencies(classes).into_iter().enumerate() {
                intervals.push(frequency << 16 | start);
                let end = start + frequency;
                // The stretches that begin inside.
                let stretches = start.div_ceil(1 << LOOK_UP_SHIFT)..end.div_ceil(1 << LOOK_UP_SHIFT);
                stretches.for_each(|stretch| look_up[stretch as usize] = symbol as u8);
                start = end;
            }
        }
        let ones = classes.decisions.iter().zip(&built_in.decisions).map(|(own, built_in)| match own {
            0 => ones(*built_in),
            own => ones(*own),
        });
        Tables { offsets, intervals, look_up, ones: ones.collect(), own: classes.written() }
    }

    /// How many contexts are the file's own, not built in.
    pub fn own_contexts(&self) -> usize {
        self.own
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

/// The probability of "yes" that the class of a decision stands for.
pub(super) fn ones(class: u8) -> u16 {
    let rarer = of_class(class & (RARELY_NO - 1)).clamp(1, TOTAL - 1);
    (if class == 0 {
        TOTAL / 2
    } else if class & RARELY_NO != 0 {
        TOTAL - rarer
    } else {
        rarer
    }) as u16
}

/// Probabilities, in [`TOTAL`] parts, none of them 0, about in proportion to what the classes stand for.
pub(super) fn frequencies(classes: &[u8]) -> Vec<u32> {
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
