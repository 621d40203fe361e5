//! The built-in tables, and which contexts of a file have tables of their own.
//!
//! A file need not say anything of a context: then it has the built-in probabilities. Small models are almost all coded with
//! these, since tables of their own would take more bytes than they save. The writer compares both, context by context and
//! then family by family, by what the symbols that were counted take and what it takes to write the table down, exactly and
//! with whole numbers, so that every machine writes the same.
//!
//! The tables in `built_in.tables` are a part of the format. They were counted on models of meshes of several kinds (see
//! `write::count::tests::the_built_in_tables_made_anew`, which makes the file), and are in the form that a file's own are in, behind two
//! bytes: for how many families of symbols and of decisions they are. The families behind those came later, and have the
//! same probability for all symbols until the file is made anew.

use super::contexts::{DECISIONS, FAMILIES};
use super::rans::{PRECISION, TOTAL};
use super::raw::RawReader;
#[cfg(test)]
use super::raw::RawWriter;
use super::tables::{BadTables, Classes, Counts, DECISION_BITS, SYMBOL_BITS, frequencies, ones};

/// The file.
const BYTES: &[u8] = include_bytes!("built_in.tables");

/// The built-in classes; 0 for whatever there is none of.
pub(super) fn classes() -> Classes {
    read(BYTES).unwrap_or(Classes::unseen())
}

/// From the bytes of a file like this.
fn read(bytes: &[u8]) -> Result<Classes, BadTables> {
    let ([symbols, decisions], bytes) = bytes.split_first_chunk().ok_or(BadTables)?;
    let families = FAMILIES.get(..usize::from(*symbols)).ok_or(BadTables)?;
    let decisions = DECISIONS.get(..usize::from(*decisions)).ok_or(BadTables)?;
    let mut bits = RawReader::new(bytes);
    let classes = Classes::read(&mut bits, families, decisions);
    if bits.is_exact() { Ok(classes) } else { Err(BadTables) }
}

/// A file like this, for all families that there are.
#[cfg(test)]
pub(crate) fn to_bytes(classes: &Classes) -> Vec<u8> {
    let mut bits = RawWriter::default();
    classes.write(&mut bits);
    let mut bytes = vec![FAMILIES.len() as u8, DECISIONS.len() as u8];
    bits.finish(&mut bytes);
    bytes
}

/// Costs are in 65,536ths of a bit.
const BIT: u64 = 1 << 16;

/// What a symbol of so many parts takes.
fn cost(parts: u32) -> u64 {
    let top = parts.ilog2();
    let mut log = u64::from(top) * BIT;
    // Between 1 and 2, with 31 bits behind the point: squared, each bit of the logarithm comes out.
    let mut rest = u64::from(parts) << (31 - top);
    for bit in (0..BIT.ilog2()).rev() {
        rest = (rest * rest) >> 31;
        if rest >> 32 > 0 {
            rest >>= 1;
            log += 1 << bit;
        }
    }
    u64::from(PRECISION) * BIT - log
}

/// What symbols that came so often take.
fn cost_of_all(counts: &[u64], parts: &[u32]) -> u64 {
    counts.iter().zip(parts).map(|(count, parts)| count * cost(*parts)).sum()
}

impl Counts {
    /// The classes that a file with these symbols needs of its own: what it saves to have them is more than what they take.
    pub fn classes_worth_writing(&self) -> Classes {
        let mut classes = self.classes();
        let built_in = self::classes();
        for family in FAMILIES {
            let range = |context: usize| self.symbols_of(context);
            let worth = |context: usize| {
                let (counts, own) = (&self.symbols[range(context)], &classes.symbols[range(context)]);
                let seen = own.iter().filter(|class| **class > 0).count() as u64;
                let saved = cost_of_all(counts, &frequencies(&built_in.symbols[range(context)]))
                    .saturating_sub(cost_of_all(counts, &frequencies(own)));
                saved.saturating_sub((own.len() as u64 + seen * u64::from(SYMBOL_BITS)) * BIT)
            };
            let worth: Vec<u64> = (family.first..family.first + family.contexts).map(worth).collect();
            let is_family_worth = worth.iter().sum::<u64>() > family.contexts as u64 * BIT;
            for (index, worth) in worth.into_iter().enumerate() {
                if worth == 0 || !is_family_worth {
                    classes.symbols[range(family.first + index)].fill(0);
                }
            }
        }
        for family in DECISIONS {
            let worth = |context: usize| {
                let parts = |class| [TOTAL - u32::from(ones(class)), u32::from(ones(class))];
                let cost = |class| cost_of_all(&self.decisions[context], &parts(class));
                let saved = cost(built_in.decisions[context]).saturating_sub(cost(classes.decisions[context]));
                saved.saturating_sub(u64::from(DECISION_BITS) * BIT)
            };
            let range = family.first..family.first + family.contexts;
            let worth: Vec<u64> = range.clone().map(worth).collect();
            let is_family_worth = worth.iter().sum::<u64>() > family.contexts as u64 * BIT;
            for (class, worth) in classes.decisions[range].iter_mut().zip(worth) {
                if worth == 0 || !is_family_worth {
                    *class = 0;
                }
            }
        }
        classes
    }
}
