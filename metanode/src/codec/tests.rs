//! The entropy coder, its tables, and decoders that are given anything at all.
//!
//! That pages come back as they were is tested where they are written (`write`, against `reference`).

use proptest::prelude::*;

use super::contexts::{DECISION_CONTEXTS, DECISIONS, FAMILIES, FIRST_COORDINATE};
use super::frequent::MOST;
use super::rans::{Decoder, Encoder, TOTAL};
use super::raw::RawWriter;
use super::tables::{BadTables, Classes, Counts, Tables};
use super::{Coder, Context, Frequent, Numbers, PageDecoder, Shape, scale};
use crate::header::{Blocking, Header, ModelRoot};
use crate::model::Model;
use crate::page::{Page, PageError, PageLocation};
use crate::testing::{self, Random, TreePlan, all_pages, model_bytes, open_bytes, random_tree};
use crate::wedges::{RootWedges, WedgeLayout};

/// Something to be coded.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Step {
    Symbol(usize, usize),
    Decision(usize, bool),
    Raw(u32, u32),
}

impl Step {
    /// Any, mostly in a few contexts, and there mostly the same.
    fn any(random: &mut Random) -> Self {
        let some = |random: &mut Random, count: usize| match random.below(3) {
            0 => random.below(count),
            _ => random.below(count.min(4)),
        };
        match random.below(3) {
            0 => {
                let family = FAMILIES[some(random, FAMILIES.len())];
                let context = some(random, family.contexts);
                Step::Symbol(family.context(context), some(random, family.symbols))
            }
            1 => Step::Decision(some(random, DECISION_CONTEXTS), random.below(9) == 0),
            _ => {
                let bits = random.below(33) as u32;
                Step::Raw(bits, (random.next() & ((1 << bits) - 1)) as u32)
            }
        }
    }

    /// Codes it; a decoder is not told what it is.
    fn code<C: Coder>(self, coder: &mut C) -> Self {
        match self {
            Step::Symbol(context, symbol) => {
                Step::Symbol(context, coder.symbol(context, if C::DECODES { 0 } else { symbol }))
            }
            Step::Decision(context, decision) => {
                Step::Decision(context, coder.decision(context, !C::DECODES && decision))
            }
            Step::Raw(bits, value) => Step::Raw(bits, coder.raw(bits, if C::DECODES { 0 } else { value })),
        }
    }
}

fn steps(random: &mut Random, count: usize) -> Vec<Step> {
    (0..count).map(|_| Step::any(random)).collect()
}

/// The class of all of a whole.
const LARGEST_CLASS: u32 = 44;

/// Any tables, as bytes.
fn any_tables(random: &mut Random) -> Vec<u8> {
    let mut bits = RawWriter::default();
    let frequent = [0, 1, MOST, random.below(MOST + 1)][random.below(4)] as u32;
    bits.push(6, frequent);
    let mut number = 0;
    for _ in 0..frequent {
        let size = [1, 10, 25][random.below(3)];
        number += 1 + random.below(1 << size) as u32;
        bits.push(32, number);
    }
    let denominator = [0.0, 1e6, 0.5_f32][random.below(3)];
    bits.push(1, (denominator > 0.0).into());
    if denominator > 0.0 {
        bits.push(32, denominator.to_bits());
    }
    let is_dense = random.below(2) == 0;
    for family in FAMILIES {
        let contexts: Vec<Vec<u32>> = (0..family.contexts)
            .map(|_| {
                let is_written = random.below(4) > 0;
                let class = |_| match is_written && (is_dense || random.below(3) == 0) {
                    true => random.below(LARGEST_CLASS as usize + 1) as u32,
                    false => 0,
                };
                (0..family.symbols).map(class).collect()
            })
            .collect();
        let is_some = contexts.iter().flatten().any(|class| *class > 0) && random.below(4) > 0;
        bits.push(1, is_some.into());
        for classes in contexts.iter().filter(|_| is_some) {
            let is_written = classes.iter().any(|class| *class > 0);
            bits.push(1, is_written.into());
            for class in classes.iter().filter(|_| is_written) {
                bits.push(1, (*class > 0).into());
                if *class > 0 {
                    bits.push(6, *class);
                }
            }
        }
    }
    for family in DECISIONS {
        let is_some = random.below(3) > 0;
        bits.push(1, is_some.into());
        for context in 0..if is_some { family.contexts } else { 0 } {
            // At least one.
            let class = if context == 0 { 1 + random.below(127) } else { random.below(128) } as u32;
            bits.push(1, (class > 0).into());
            if class > 0 {
                bits.push(7, class);
            }
        }
    }
    let mut bytes = Vec::new();
    bits.finish(&mut bytes);
    bytes
}

/// Tables of all kinds: of what was counted, of what was counted elsewhere, of nothing, and any.
fn some_tables(random: &mut Random, counted: &[Step]) -> Tables {
    let classes = match random.below(4) {
        0 => Classes::unseen(),
        1 => Classes::from_bytes(&any_tables(random)).unwrap().0,
        kind => {
            let others = steps(random, 500);
            let mut counts = Counts::new();
            for step in if kind == 2 { counted } else { &others } {
                step.code(&mut counts);
            }
            counts.classes()
        }
    };
    Tables::new(&classes)
}

fn encoded(tables: &Tables, steps: &[Step]) -> Vec<u8> {
    let mut encoder = Encoder::new(tables);
    for step in steps {
        assert_eq!(step.code(&mut encoder), *step);
    }
    let mut bytes = Vec::new();
    encoder.finish(&mut bytes);
    bytes
}

/// What is decoded in place of these steps, and whether that was all there was; none where it cannot begin.
fn decoded(tables: &Tables, bytes: &[u8], steps: &[Step]) -> Option<(Vec<Step>, bool)> {
    let mut decoder = Decoder::new(tables, bytes)?;
    let found = steps.iter().map(|step| step.code(&mut decoder)).collect();
    Some((found, decoder.is_exact()))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn what_is_encoded_is_decoded(seed in any::<u64>(), count in 0_usize..3000) {
        let random = &mut Random(seed);
        let steps = steps(random, count);
        let tables = some_tables(random, &steps);
        let bytes = encoded(&tables, &steps);
        prop_assert_eq!(decoded(&tables, &bytes, &steps), Some((steps.clone(), true)));
        // An encoder begins anew, and adds to what is there.
        let mut encoder = Encoder::new(&tables);
        let mut twice = vec![7];
        for _ in 0..2 {
            steps.iter().for_each(|step| {
                step.code(&mut encoder);
            });
            encoder.finish(&mut twice);
        }
        prop_assert!(twice == [&[7], &bytes[..], &bytes[..]].concat());
    }

    #[test]
    fn what_is_damaged_ends_and_is_told(seed in any::<u64>(), count in 1_usize..300) {
        let random = &mut Random(seed);
        let steps = steps(random, count);
        let tables = some_tables(random, &steps);
        let bytes = encoded(&tables, &steps);
        let is_exact = |bytes: &[u8]| decoded(&tables, bytes, &steps).is_some_and(|(_, is_exact)| is_exact);
        for length in 0..bytes.len() {
            prop_assert!(!is_exact(&bytes[..length]), "{} of {}", length, bytes.len());
        }
        let mut more = bytes.clone();
        more.push(0);
        prop_assert!(!is_exact(&more));
        for _ in 0..100 {
            let mut altered = bytes.clone();
            let at = random.below(altered.len());
            altered[at] ^= 1 << random.below(8);
            let same = decoded(&tables, &altered, &steps);
            prop_assert!(same != Some((steps.clone(), true)), "byte {}", at);
        }
        // Fewer and more steps than were encoded, and bytes that never were.
        prop_assert!(steps.len() < 40 || decoded(&tables, &bytes, &steps[..steps.len() / 2]).is_some_and(|(_, is_exact)| !is_exact));
        let twice = [&steps[..], &steps[..]].concat();
        let wanted: u32 = twice.iter().map(|step| if let Step::Raw(bits, _) = step { *bits } else { 0 }).sum();
        prop_assert!(wanted < 50 || decoded(&tables, &bytes, &twice).is_some_and(|(_, is_exact)| !is_exact));
        let length = random.below(200);
        let mut noise: Vec<u8> = (0..length).map(|_| random.next() as u8).collect();
        decoded(&tables, &noise, &twice);
        if let Some(words) = noise.first_chunk_mut::<4>() {
            *words = (random.below(60) as u32).to_le_bytes();
            decoded(&tables, &noise, &twice);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn probabilities_add_up_and_none_is_nothing(seed in any::<u64>()) {
        let random = &mut Random(seed);
        let counted = steps(random, 2000);
        let tables = some_tables(random, &counted);
        for family in FAMILIES {
            for context in family.first..family.first + family.contexts {
                let mut start = 0;
                for symbol in 0..family.symbols {
                    let interval = tables.interval(context, symbol);
                    let (begin, length) = (interval & 0xffff, interval >> 16);
                    prop_assert!(begin == start && length > 0);
                    for value in [begin, begin + length / 2, begin + length - 1] {
                        prop_assert_eq!(tables.find(context, value), (symbol, interval));
                    }
                    start += length;
                }
                prop_assert_eq!(start, TOTAL);
            }
        }
        for context in 0..DECISION_CONTEXTS {
            prop_assert!((1..TOTAL).contains(&tables.ones(context).into()));
        }
    }

    #[test]
    fn tables_come_back_as_they_were_and_nothing_else_is_taken(seed in any::<u64>()) {
        let random = &mut Random(seed);
        let mut counts = Counts::new();
        steps(random, 3000).iter().for_each(|step| {
            step.code(&mut counts);
        });
        let unseen = Classes::unseen().to_bytes(Numbers::ANY);
        let numbers = Numbers { denominator: 1e6, frequent: Frequent::new(&[0, 5, u32::MAX]).unwrap() };
        for bytes in [counts.classes().to_bytes(numbers), any_tables(random), unseen] {
            let (classes, numbers) = Classes::from_bytes(&bytes).unwrap();
            prop_assert!(classes.to_bytes(numbers) == bytes);
            for length in [0, 1, random.below(bytes.len()), bytes.len() - 1] {
                prop_assert_eq!(Classes::from_bytes(&bytes[..length]), Err(BadTables));
            }
            let mut more = bytes.clone();
            more.push(0);
            prop_assert_eq!(Classes::from_bytes(&more), Err(BadTables));
            for _ in 0..20 {
                let mut altered = bytes.clone();
                let at = random.below(bytes.len());
                altered[at] ^= 1 << random.below(8);
                if let Ok((other, others)) = Classes::from_bytes(&altered) {
                    prop_assert!((&other, others) != (&classes, numbers) && other.to_bytes(others) == altered);
                    // Whatever is taken can be coded with.
                    Tables::new(&other);
                }
            }
        }
    }

    #[test]
    fn numbers_of_any_size_come_back(seed in any::<u64>()) {
        let random = &mut Random(seed);
        let numbers: Vec<(i32, i64)> = (0..500)
            .map(|_| {
                let bits = random.below(41);
                let magnitude = (random.next() & ((1_u64 << bits) - 1)) as i64;
                let magnitude = if random.below(4) == 0 { (1_i64 << bits.min(39)) - random.below(2) as i64 } else { magnitude };
                let sign = if random.below(2) == 0 { 1 } else { -1 };
                // Mostly about as large as it is.
                let expected = if random.below(3) == 0 { random.below(8000) as i32 - 4000 } else { 32 * bits as i32 };
                (expected, sign * magnitude)
            })
            .collect();
        let mut counts = Counts::new();
        let first = FIRST_COORDINATE.first;
        numbers.iter().for_each(|(expected, value)| {
            scale::code(&mut counts, first, *expected, *value);
        });
        let tables = Tables::new(&counts.classes());
        let mut encoder = Encoder::new(&tables);
        for (expected, value) in &numbers {
            prop_assert_eq!(scale::code(&mut encoder, first, *expected, *value), *value);
        }
        let mut bytes = Vec::new();
        encoder.finish(&mut bytes);
        let mut decoder = Decoder::new(&tables, &bytes).unwrap();
        for (expected, value) in &numbers {
            prop_assert_eq!(scale::code(&mut decoder, first, *expected, 0), *value);
        }
        prop_assert!(decoder.is_exact());
        // Anything else is some number.
        let noise: Vec<u8> = [20_u32.to_le_bytes(); 20].concat().into_iter().map(|byte| byte ^ random.next() as u8 & 7).collect();
        if let Some(mut decoder) = Decoder::new(&tables, &noise) {
            numbers.iter().for_each(|(expected, _)| {
                scale::code(&mut decoder, first, *expected, 0);
            });
        }
    }
}

#[test]
fn tables_that_no_writer_writes_are_refused() {
    let unseen = Classes::unseen().to_bytes(Numbers::ANY);
    let families = FAMILIES.len() + DECISIONS.len();
    assert_eq!(unseen.len(), (6 + 1 + families).div_ceil(8));
    let with_first_context = |classes: &[u32]| {
        let mut bits = RawWriter::default();
        // No frequent numbers, no denominator; the first family, and its first context.
        bits.push(6, 0);
        bits.push(1, 0);
        bits.push(2, 3);
        for class in classes {
            bits.push(1, u32::from(*class != u32::MAX));
            if *class != u32::MAX {
                bits.push(6, *class);
            }
        }
        (0..FAMILIES[0].contexts - 1 + families - 1).for_each(|_| bits.push(1, 0));
        let mut bytes = Vec::new();
        bits.finish(&mut bytes);
        Classes::from_bytes(&bytes)
    };
    let symbols = FAMILIES[0].symbols;
    let none = vec![u32::MAX; symbols];
    let but_one = |class: u32| [&[class], &none[1..]].concat();
    with_first_context(&but_one(1)).unwrap();
    with_first_context(&but_one(LARGEST_CLASS)).unwrap();
    assert_eq!(with_first_context(&but_one(LARGEST_CLASS + 1)), Err(BadTables));
    assert_eq!(with_first_context(&but_one(0)), Err(BadTables));
    assert_eq!(with_first_context(&none), Err(BadTables));
    // A denominator that is none.
    for denominator in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-40] {
        let mut bits = RawWriter::default();
        bits.push(7, 1 << 6);
        bits.push(32, denominator.to_bits());
        (0..families).for_each(|_| bits.push(1, 0));
        let mut bytes = Vec::new();
        bits.finish(&mut bytes);
        assert_eq!(Classes::from_bytes(&bytes), Err(BadTables));
    }
    // The last bits are no part of any class.
    if !(6 + 1 + families).is_multiple_of(8) {
        let mut altered = unseen.clone();
        *altered.last_mut().unwrap() |= 0x80;
        assert_eq!(Classes::from_bytes(&altered), Err(BadTables));
    }
}

/// What symbols take by some tables, with the tables.
fn bits_with(classes: &Classes, counts: &Counts) -> f64 {
    let tables = Tables::new(classes);
    let of = |parts: u32, count: u64| count as f64 * (12.0 - f64::from(parts).log2());
    let symbols = FAMILIES
        .into_iter()
        .flat_map(|family| (family.first..family.first + family.contexts).map(move |context| (family, context)));
    let symbols: f64 = symbols
        .flat_map(|(family, context)| (0..family.symbols).map(move |symbol| (context, symbol)))
        .map(|(context, symbol)| {
            of(tables.interval(context, symbol) >> 16, counts.symbols[counts.symbols_of(context)][symbol])
        })
        .sum();
    let decisions: f64 = (0..DECISION_CONTEXTS)
        .map(|context| {
            let (ones, [no, yes]) = (u32::from(tables.ones(context)), counts.decisions[context]);
            of(ones, yes) + of(TOTAL - ones, no)
        })
        .sum();
    symbols + decisions + 8.0 * classes.to_bytes(Numbers::ANY).len() as f64
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Next to the built-in tables, to all of its own, and to all but one context of what was chosen or one more.
    #[test]
    fn a_file_has_the_tables_of_its_own_that_are_worth_it(seed in any::<u64>(), count in 0_usize..100_000) {
        let random = &mut Random(seed);
        let mut counts = Counts::new();
        steps(random, count).iter().for_each(|step| {
            step.code(&mut counts);
        });
        let (chosen, all) = (counts.classes_worth_writing(), counts.classes());
        let taken = bits_with(&chosen, &counts);
        // Bits that fill up the last byte.
        let most = |other: &Classes| bits_with(other, &counts) + 8.0;
        prop_assert!(taken <= most(&Classes::unseen()) && taken <= most(&all));
        for _ in 0..20 {
            let mut other = chosen.clone();
            let family = FAMILIES[random.below(FAMILIES.len())];
            let context = counts.symbols_of(family.first + random.below(family.contexts));
            let is_written = other.symbols[context.clone()].iter().any(|class| *class > 0);
            for symbol in context {
                other.symbols[symbol] = if is_written { 0 } else { all.symbols[symbol] };
            }
            let decision = random.below(DECISION_CONTEXTS);
            other.decisions[decision] = if other.decisions[decision] > 0 { 0 } else { all.decisions[decision] };
            prop_assert!(taken <= most(&other));
        }
    }
}

/// The file is whole, and has something of every family but those that came after it was made.
#[test]
fn the_built_in_tables_are_there() {
    let built_in = super::built_in::classes();
    assert_ne!(built_in, Classes::unseen());
    assert_eq!(super::built_in_to_bytes(&built_in)[2..], include_bytes!("built_in.tables")[2..]);
    let tables = Tables::new(&Classes::unseen());
    assert_eq!(tables.own_contexts(), 0);
    for family in FAMILIES {
        for context in family.first..family.first + family.contexts {
            assert!((0..family.symbols).all(|symbol| tables.interval(context, symbol) >> 16 > 0));
        }
    }
}

/// A small model, taken apart so that its pages can be decoded from any bytes below any ancestors.
struct Apart {
    model: Model,
    bytes: Vec<u8>,
    shape: Shape,
    tables: Tables,
    pages: Vec<(PageLocation, Page)>,
}

impl Apart {
    fn new(seed: u64) -> Self {
        let random = &mut Random(seed);
        let shape = [testing::Shape::Random, testing::Shape::Neighbours, testing::Shape::Chain][random.below(3)];
        let leaves = 200 + random.below(500) as u32;
        let components = [1, 9, leaves / 7][random.below(3)];
        let plan = TreePlan { seed, leaves, components, triangles: 2 * leaves, shape, hub: 0, reach: 40 };
        let blocking = match random.below(3) {
            0 => Blocking::Levels { levels: 4 },
            _ => Blocking::Forest { slot_bytes: 4096, fan_out: 3 },
        };
        let bytes = model_bytes(&random_tree(&plan), blocking).0;
        let model = open_bytes(&*bytes).unwrap();
        let header = model.header();
        let (start, end) = (header.after_root_tables() as usize, header.pages_offset as usize - 4);
        let (classes, numbers) = Classes::from_bytes(&bytes[start..end]).unwrap();
        let Header { exponent, lattice_step, .. } = *header;
        let shape = Shape { exponent, lattice_step, numbers, wedges: WedgeLayout::default(), texture_density: 0 };
        let tables = Tables::new(&classes);
        let pages = all_pages(&model);
        Apart { model, bytes, shape, tables, pages }
    }

    /// The bytes of a page.
    fn coded(&self, number: usize) -> &[u8] {
        let PageLocation { offset, length, .. } = self.pages[number].0;
        &self.bytes[offset as usize..][..length as usize]
    }

    /// The ancestors of a page, from the root page down.
    fn ancestors(&self, number: usize) -> Vec<&Page> {
        let mut ancestors = Vec::new();
        let mut above = self.pages[number].1.parent();
        while let Some(number) = above {
            let page = &self.pages[number as usize].1;
            ancestors.insert(0, page);
            above = page.parent();
        }
        ancestors
    }

    /// Decodes bytes as if they were a page. What comes out must be sound in itself, and no larger than may be.
    fn decode(
        &self,
        decoder: &mut PageDecoder,
        number: usize,
        bytes: &[u8],
        ancestors: &[&Page],
    ) -> Result<Page, PageError> {
        let trees = |number: u32| {
            let roots: Vec<&ModelRoot> = self.model.roots().iter().filter(|root| root.page.number == number).collect();
            roots.into_iter()
        };
        let context = Context {
            location: self.pages[number].0,
            ancestors,
            shape: &self.shape,
            tables: &self.tables,
            root_wedges: &RootWedges::default(),
            trees,
        };
        let mut page = self.model.empty_page();
        let result = decoder.decode(bytes, &context, &mut page);
        assert!(page.counts().decoded_bytes() <= self.model.header().slot_bytes as usize);
        match result {
            Ok(()) => {
                page.check(self.model.header().leaf_count).unwrap();
                Ok(page)
            }
            Err(error) => {
                assert_eq!((page.counts().records, page.number()), (0, u32::MAX));
                Err(error)
            }
        }
    }
}

/// The length of a page and its checksum put right.
fn put_right(bytes: &mut [u8]) {
    let length = bytes.len();
    if length < 16 {
        return;
    }
    bytes[8..12].copy_from_slice(&(length as u32).to_le_bytes());
    let checksum = crc32fast::hash(&bytes[..length - 4]);
    bytes[length - 4..].copy_from_slice(&checksum.to_le_bytes());
}

#[test]
fn a_changed_byte_is_refused_by_the_checksum_and_does_no_harm_without() {
    let mut came_through = 0;
    for seed in 0..20 {
        let apart = Apart::new(seed);
        let random = &mut Random(seed);
        let mut decoder = PageDecoder::default();
        for _ in 0..500 {
            let number = random.below(apart.pages.len());
            let ancestors = apart.ancestors(number);
            let mut bytes = apart.coded(number).to_vec();
            // The front of a page says most.
            let within = if random.below(3) == 0 { 60 } else { usize::MAX };
            let at = random.below(bytes.len().min(within));
            bytes[at] ^= 1 + random.below(255) as u8;
            assert_eq!(apart.decode(&mut decoder, number, &bytes, &ancestors).err(), Some(PageError::Checksum));
            put_right(&mut bytes);
            let Ok(page) = apart.decode(&mut decoder, number, &bytes, &ancestors) else { continue };
            came_through += 1;
            // Its children, of which nothing was changed, are decoded below it.
            let below: Vec<&Page> = ancestors.iter().copied().chain([&page]).collect();
            for child in page.children().map(|child| child.number as usize).filter(|child| *child < apart.pages.len()) {
                let _ = apart.decode(&mut PageDecoder::default(), child, apart.coded(child), &below);
            }
        }
    }
    // Raw bits mean something else, whatever they are.
    assert!(came_through > 100, "{came_through}");
}

#[test]
fn pages_cut_short_and_pages_of_noise_do_no_harm() {
    for seed in 20..23 {
        let apart = Apart::new(seed);
        let random = &mut Random(seed);
        let mut decoder = PageDecoder::default();
        for number in 0..apart.pages.len() {
            let ancestors = apart.ancestors(number);
            let whole = apart.coded(number);
            for length in 0..whole.len() {
                let mut bytes = whole[..length].to_vec();
                assert!(apart.decode(&mut decoder, number, &bytes, &ancestors).is_err());
                put_right(&mut bytes);
                assert!(apart.decode(&mut decoder, number, &bytes, &ancestors).is_err(), "{length} of {}", whole.len());
            }
            for _ in 0..20 {
                // As noise from any place on; the head as it was, or not.
                let mut bytes = whole.to_vec();
                let from = random.below(bytes.len());
                bytes[from..].iter_mut().for_each(|byte| *byte = random.next() as u8);
                put_right(&mut bytes);
                let _ = apart.decode(&mut decoder, number, &bytes, &ancestors);
            }
            // What went wrong before leaves nothing behind.
            apart.decode(&mut decoder, number, whole, &ancestors).unwrap();
        }
    }
}

#[test]
fn pages_in_each_others_places_do_no_harm() {
    for seed in 30..34 {
        let apart = Apart::new(seed);
        let random = &mut Random(seed);
        let mut decoder = PageDecoder::default();
        for _ in 0..400 {
            let (number, other) = (random.below(apart.pages.len()), random.below(apart.pages.len()));
            if number == other {
                continue;
            }
            // Another page, and one that says that it is this.
            let ancestors = apart.ancestors(number);
            let mut bytes = apart.coded(other).to_vec();
            assert!(apart.decode(&mut decoder, number, &bytes, &ancestors).is_err());
            let above = ancestors.last().map_or(u32::MAX, |page| page.number());
            bytes[..4].copy_from_slice(&(number as u32).to_le_bytes());
            bytes[4..8].copy_from_slice(&above.to_le_bytes());
            put_right(&mut bytes);
            let _ = apart.decode(&mut decoder, number, &bytes, &ancestors);
            // The page below others' ancestors, and one that says that it belongs there.
            let others = [&apart.ancestors(other)[..], &[&apart.pages[other].1]].concat();
            let mut bytes = apart.coded(number).to_vec();
            if others.last().map(|page| page.number()) != apart.pages[number].1.parent() {
                assert!(apart.decode(&mut decoder, number, &bytes, &others).is_err());
                if other < number {
                    bytes[4..8].copy_from_slice(&(other as u32).to_le_bytes());
                    put_right(&mut bytes);
                    let _ = apart.decode(&mut decoder, number, &bytes, &others);
                }
            }
        }
    }
}
