//! Morton codes: the cells of a grid in the order of a space-filling curve, three bits for each halving of the box.

/// Bits of a cell's number along one axis.
const AXIS_BITS: u32 = 21;
const LAST_CELL: u64 = (1 << AXIS_BITS) - 1;

/// Spreads the low 21 bits of `value` to every third bit.
#[inline]
fn spread(value: u64) -> u64 {
    let mut bits = value & LAST_CELL;
    bits = (bits | bits << 32) & 0x001f_0000_0000_ffff;
    bits = (bits | bits << 16) & 0x001f_0000_ff00_00ff;
    bits = (bits | bits << 8) & 0x100f_00f0_0f00_f00f;
    bits = (bits | bits << 4) & 0x10c3_0c30_c30c_30c3;
    (bits | bits << 2) & 0x1249_2492_4924_9249
}

/// The Morton code, of 63 bits, of the cell in which a position lies. `minimum` is the lowest corner of the grid;
/// what lies outside counts to the nearest cell.
#[inline]
pub(super) fn code(position: [f64; 3], minimum: [f64; 3], cells_per_unit: f64) -> u64 {
    let cell = |axis: usize| (((position[axis] - minimum[axis]) * cells_per_unit) as u64).min(LAST_CELL);
    spread(cell(0)) | spread(cell(1)) << 1 | spread(cell(2)) << 2
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn what_lies_outside_counts_to_the_nearest_cell() {
        assert_eq!(code([-1.0; 3], [0.0; 3], 1.0), 0);
        assert_eq!(code([1e30; 3], [0.0; 3], 1.0), (1 << 63) - 1);
    }

    proptest! {
        #[test]
        fn the_bits_of_three_axes_take_turns(cell in prop::array::uniform3(0_u64..=LAST_CELL)) {
            let interleaved = code(cell.map(|cell| cell as f64), [0.0; 3], 1.0);
            for bit in 0..AXIS_BITS {
                for axis in 0..3 {
                    prop_assert_eq!(interleaved >> (3 * bit + axis as u32) & 1, cell[axis] >> bit & 1);
                }
            }
        }
    }
}
