//! Where born leaves are: the displacement from the kept leaf.
//!
//! Of the three coordinates that comes last along which the surface faces most; it is predicted from the tangent plane and the
//! other two. How large each is likely to be follows from the displacements of the nodes above, scaled by the root of the
//! sizes, and from how steep the plane is along it. On a lattice the numbers are steps. Elsewhere they are differences of
//! single-precision numbers in the order of all such numbers, so that every bit comes back.
//!
//! Positions take a half of a model, and most of that is noise: raw bits.

use super::contexts::{
    FIRST_COORDINATE, FIRST_FREQUENT, Family, SECOND_COORDINATE, SECOND_FREQUENT, SIGN, THIRD_COORDINATE,
    THIRD_FREQUENT,
};
use super::frequent::OCTAVES;
use super::nodes::{BORN, KEPT, Node, Nodes, reflected};
use super::rans::Coder;
use super::scale::{self, CONTEXTS, logarithm};
use super::{Damage, Fields, Shape};

/// Single-precision numbers as whole numbers in the same order.
#[inline(always)]
fn ordered(value: f32) -> i64 {
    let bits = value.to_bits() as i32;
    i64::from(if bits < 0 { i32::MIN.wrapping_sub(bits) } else { bits })
}

/// The inverse of [`ordered`]; none where there is no such number.
#[inline(always)]
fn from_ordered(value: i64) -> Option<f32> {
    let value = i32::try_from(value).ok()?;
    Some(f32::from_bits(if value < 0 { i32::MIN.wrapping_sub(value) } else { value } as u32))
        .filter(|value| value.is_finite())
}

/// The axes, that along which a normal is longest last.
#[inline(always)]
fn axes(normal: [f32; 3]) -> [usize; 3] {
    let [x, y, z] = normal.map(f32::abs);
    if z >= x && z >= y {
        [0, 1, 2]
    } else if y >= x {
        [2, 0, 1]
    } else {
        [1, 2, 0]
    }
}

/// How many steps off the plane a guess is at most.
const FARTHEST: i32 = 1 << 30;
/// A square that is at least a little.
const LITTLE: f32 = 1.0 / 64.0;

/// Codes the positions, and fills in what follows from them from the top down.
pub(super) fn code<C: Coder>(coder: &mut C, nodes: &mut Nodes, fields: &Fields, shape: &Shape) -> Result<(), Damage> {
    let first = nodes.first;
    let step = shape.lattice_step;
    // Logarithms of lengths are those of squares of mesh units.
    let of_step = logarithm(step * step);
    for index in first..nodes.all.len() {
        let wrong = |problem| Damage { field: "record", index: index - first, problem };
        let node = nodes.all[index];
        let (kept, normal) = (node.places[KEPT], node.normals[KEPT]);
        let expected = i32::from(node.length) + logarithm(node.size() as f32);
        let [a, b, c] = axes(normal);
        let steep = |axis: usize| logarithm((1.0 - normal[axis] * normal[axis]).max(LITTLE));
        let (mut place, mut steps) = (kept, node.steps[KEPT]);
        if step > 0.0 {
            let actual = if C::DECODES { steps } else { shape.steps(fields.places[index - first]) };
            let difference = |axis: usize| i64::from(actual[axis].wrapping_sub(node.steps[KEPT][axis]));
            let expected = expected - of_step;
            let no_number = || wrong("its position is no number of the file");
            let frequent =
                |coder: &mut C, family: Family, others: usize, expected: i32, along: i64, off: Option<i64>| {
                    if shape.frequent.is_empty() {
                        return Ok(None);
                    }
                    let octave = (expected >> 5).clamp(0, OCTAVES as i32 - 1) as usize;
                    let symbol = coder
                        .symbol(family.context(others * OCTAVES + octave), shape.frequent.symbol(along.unsigned_abs()));
                    if symbol == 0 {
                        return Ok(None);
                    }
                    let magnitude = i64::from(shape.frequent.number(symbol).ok_or_else(no_number)?);
                    let is_negative = match off {
                        _ if magnitude == 0 => false,
                        Some(off) => coder.decision(SIGN + usize::from(off < 0), along < 0),
                        None => coder.raw(1, u32::from(along < 0)) == 1,
                    };
                    Ok(Some(if is_negative { -magnitude } else { magnitude }))
                };
            let wide = expected + steep(a);
            let known_a = frequent(coder, FIRST_FREQUENT, 0, wide, difference(a), None)?;
            let along_a = match known_a {
                Some(along) => along,
                None => scale::code(coder, FIRST_COORDINATE.first, wide, difference(a)),
            };
            let level = level(along_a as f32, wide);
            let wide = expected + steep(b);
            let known_b = frequent(coder, SECOND_FREQUENT, known_a.is_some().into(), wide, difference(b), None)?;
            let along_b = match known_b {
                Some(along) => along,
                None => scale::code(coder, SECOND_COORDINATE.first + level * CONTEXTS, wide, difference(b)),
            };
            let (x, y) = (along_a as f32, along_b as f32);
            let off =
                i64::from(super::nearest(-(normal[a] * x + normal[b] * y) / normal[c]).clamp(-FARTHEST, FARTHEST));
            let bent = logarithm((x * x + y * y).max(LITTLE)) + i32::from(node.bend);
            let others = usize::from(known_a.is_some()) + usize::from(known_b.is_some());
            let wide = logarithm((off * off) as f32).max(bent);
            let known_c = frequent(coder, THIRD_FREQUENT, others, wide, difference(c), Some(off))?;
            let along_c = match known_c {
                Some(along) => along,
                None => {
                    scale::code(coder, THIRD_COORDINATE.first, bent, difference(c).wrapping_sub(off)).wrapping_add(off)
                }
            };
            for (axis, along) in [(a, along_a), (b, along_b), (c, along_c)] {
                let found = i64::from(steps[axis]).wrapping_add(along);
                // Whole numbers up to 2^24 are exact in single precision.
                if found.unsigned_abs() > 1 << 24 {
                    return Err(wrong("its position lies outside of the lattice"));
                }
                steps[axis] = found as i32;
                place[axis] = steps[axis] as f32 * step;
            }
        } else {
            let actual = if C::DECODES { kept } else { fields.places[index - first] };
            let mut coordinate = |contexts: usize, expected: i32, axis: usize, guess: f32| {
                let grain = f32::from_bits(guess.to_bits() & 0x7f80_0000) / (1 << 23) as f32;
                let from = ordered(guess);
                let expected = expected - logarithm((grain * grain).max(f32::MIN_POSITIVE));
                let along = scale::code(coder, contexts, expected, ordered(actual[axis]).wrapping_sub(from));
                from_ordered(from.wrapping_add(along)).ok_or(wrong("its position is not finite"))
            };
            place[a] = coordinate(FIRST_COORDINATE.first, expected + steep(a), a, kept[a])?;
            let level = level(place[a] - kept[a], expected + steep(a));
            let contexts = SECOND_COORDINATE.first + level * CONTEXTS;
            place[b] = coordinate(contexts, expected + steep(b), b, kept[b])?;
            let (x, y) = (place[a] - kept[a], place[b] - kept[b]);
            let guess = kept[c] - (normal[a] * x + normal[b] * y) / normal[c];
            let guess = if guess.is_finite() { guess } else { kept[c] };
            let bent = logarithm(x * x + y * y) + i32::from(node.bend);
            place[c] = coordinate(THIRD_COORDINATE.first, bent, c, guess)?;
        }
        if !C::DECODES && place != fields.places[index - first] {
            return Err(wrong("its position would not come back: it is not on the lattice"));
        }
        let node = &mut nodes.all[index];
        node.bear_at(place, steps);
        node.normals[BORN] = reflected(normal, node.displacement());
        let node = *node;
        for side in [KEPT, BORN] {
            if let Some(child) = nodes.all.get_mut(node.children[side] as usize) {
                let Node { id, born, step_class, children, radii, .. } = *child;
                *child = Node { id, born, step_class, children, radii, ..node.child(index as u32, side) };
            }
        }
    }
    Ok(())
}

/// How large the first coordinate is, for what was expected: the smaller it is, the larger the second one.
#[inline(always)]
fn level(first: f32, expected: i32) -> usize {
    match logarithm(first * first) - expected {
        ..-64 => 0,
        -64..-16 => 1,
        -16..16 => 2,
        _ => 3,
    }
}
