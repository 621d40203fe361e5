//! Sorts by a 32-bit key first, byte-wise and stable, and leaves to comparisons only what has equal keys.
//!
//! Three passes over 11 bits each; one in which all have the same digit is left out. Takes a buffer as large as what is
//! sorted.

/// Bits of a digit.
const DIGIT: u32 = 11;
/// Below this many, comparisons are faster.
const FEW: usize = 512;

/// Sorts `items` by [`Ord`], of which `key` is the first part.
pub(super) fn sort_by_key<T: Ord + Copy>(items: &mut [T], buffer: &mut Vec<T>, key: impl Fn(&T) -> u32) {
    if items.len() < FEW {
        items.sort_unstable();
        return;
    }
    for pass in 0..3 {
        let digit = |item: &T| (key(item) >> (pass * DIGIT)) as usize & ((1 << DIGIT) - 1);
        let mut starts = [0_usize; 1 << DIGIT];
        for item in items.iter() {
            starts[digit(item)] += 1;
        }
        if starts.contains(&items.len()) {
            continue;
        }
        let mut start = 0;
        for count in &mut starts {
            start += std::mem::replace(count, start);
        }
        buffer.clear();
        buffer.extend_from_slice(items);
        for item in buffer.iter() {
            let place = &mut starts[digit(item)];
            items[*place] = *item;
            *place += 1;
        }
    }
    for equal in items.chunk_by_mut(|a, b| key(a) == key(b)) {
        if equal.len() > 1 {
            equal.sort_unstable();
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::sort_by_key;

    proptest! {
        #[test]
        fn it_sorts(mut items in prop::collection::vec((0_u32..5000, any::<u32>()), 0..3000), shift in 0_u32..20) {
            items.iter_mut().for_each(|item| item.0 = item.0.wrapping_shl(shift));
            let mut expected = items.clone();
            expected.sort_unstable();
            sort_by_key(&mut items, &mut Vec::new(), |item| item.0);
            prop_assert_eq!(items, expected);
        }
    }
}
