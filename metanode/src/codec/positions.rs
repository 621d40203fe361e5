//! Where born leaves are: the displacement from the kept leaf.
//!
//! Of the three coordinates that comes last along which the surface faces most; it is predicted from the tangent plane and the
//! other two. How large each is likely to be follows from the displacements of the nodes above, scaled by the root of the
//! sizes, and from how steep the plane is along it. On a lattice the numbers are steps. Elsewhere they are differences of
//! single-precision numbers in the order of all such numbers, so that every bit comes back.
//!
//! Positions take a half of a model, and most of that is noise: raw bits.

use super::contexts::{
    FIRST_COORDINATE, FIRST_FREQUENT, FRACTION, Family, SECOND_COORDINATE, SECOND_FREQUENT, SIGN, THIRD_COORDINATE,
    THIRD_FREQUENT,
};
use super::fractions::{self, from_ordered, ordered};
use super::frequent::OCTAVES;
use super::nodes::{BORN, KEPT, Node, Nodes, reflected};
use super::rans::Coder;
use super::scale::{self, CONTEXTS, logarithm};
use super::{Damage, Fields, Numbers, Shape};

/// The square of the sine of a plane that is as steep as can be told.
const STEEPEST: f32 = 1.0 / 64.0;
/// What is wrong with a position that is no number.
const NOT_FINITE: &str = "its position is not finite";

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
/// What the logarithm of a length in steps is at least: an eighth of one.
const LITTLE: i32 = -96;

/// The families of the three coordinates where they are frequent numbers.
const FREQUENT: [Family; 3] = [FIRST_FREQUENT, SECOND_FREQUENT, THIRD_FREQUENT];

/// What is known of a coordinate before it is coded.
struct Guess {
    /// The first of the contexts for numbers.
    contexts: usize,
    /// How far from the kept leaf it is likely to be, in mesh units.
    shift: f32,
    /// How far off that: a logarithm of mesh units, and what is to be added to it.
    expected: i32,
    bend: i32,
}

/// The coordinates of a record, one after the other.
#[derive(Clone, Copy)]
struct Coordinates<'a> {
    shape: &'a Shape,
    /// Steps to a mesh unit, and the logarithm of a step; 0 where there are no whole numbers.
    per_unit: f32,
    of_step: i32,
    /// How many of those so far were frequent numbers, and how many no fractions.
    frequent: usize,
    others: usize,
}

impl<'a> Coordinates<'a> {
    fn new(shape: &'a Shape) -> Self {
        let Shape { lattice_step, numbers: Numbers { denominator, .. }, .. } = *shape;
        let (step, per_unit) = if lattice_step > 0.0 {
            (lattice_step, 1.0 / lattice_step)
        } else if denominator > 0.0 {
            (1.0 / denominator, denominator)
        } else {
            (0.0, 0.0)
        };
        Coordinates { shape, per_unit, of_step: logarithm(step * step), frequent: 0, others: 0 }
    }

    /// Codes a coordinate, the `TURN`th of the record, which only an encoder knows: the number that it is on the lattice or of the fractions, and
    /// itself. The kept leaf's are known.
    #[inline(always)]
    fn code<const TURN: usize, C: Coder>(
        &mut self,
        coder: &mut C,
        guess: &Guess,
        kept: (i32, f32),
        (step, actual): (i32, f32),
    ) -> Result<(i32, f32), &'static str> {
        let lattice_step = self.shape.lattice_step;
        let found = if lattice_step > 0.0 {
            let step = self.whole::<TURN, C>(coder, guess, kept.0, step)?;
            (step, step as f32 * lattice_step)
        } else if self.shape.numbers.denominator > 0.0 {
            let context = FRACTION.context(TURN * (TURN + 1) / 2 + self.others);
            let denominator = self.shape.numbers.denominator;
            let off = fractions::offset(actual, step, denominator);
            let symbol = coder.symbol(context, off.map_or(0, |off| (off + fractions::NEAR + 1) as usize));
            if symbol == 0 {
                self.others += 1;
                let found = self.float(coder, guess, kept.1, actual)?;
                (fractions::nearest(found, denominator), found)
            } else {
                let step = self.whole::<TURN, C>(coder, guess, kept.0, step)?;
                let off = symbol as i64 - 1 - fractions::NEAR;
                (step, from_ordered(ordered(step as f32 / denominator) + off).ok_or(NOT_FINITE)?)
            }
        } else {
            (0, self.float(coder, guess, kept.1, actual)?)
        };
        Ok(found)
    }

    /// Codes a coordinate as one of all single-precision numbers.
    #[inline(always)]
    fn float<C: Coder>(&self, coder: &mut C, guess: &Guess, kept: f32, actual: f32) -> Result<f32, &'static str> {
        let near = kept + guess.shift;
        let near = if near.is_finite() { near } else { kept };
        let grain = f32::from_bits(near.to_bits() & 0x7f80_0000) / (1 << 23) as f32;
        let from = ordered(near);
        let expected = guess.expected + guess.bend - logarithm((grain * grain).max(f32::MIN_POSITIVE));
        let along = scale::code(coder, guess.contexts, expected, ordered(actual).wrapping_sub(from));
        from_ordered(from.wrapping_add(along)).ok_or(NOT_FINITE)
    }

    /// Codes a whole number: which of the frequent ones its distance from the kept leaf's is, or that distance.
    #[inline(always)]
    fn whole<const TURN: usize, C: Coder>(
        &mut self,
        coder: &mut C,
        guess: &Guess,
        kept: i32,
        actual: i32,
    ) -> Result<i32, &'static str> {
        let off = i64::from(super::nearest(guess.shift * self.per_unit).clamp(-FARTHEST, FARTHEST));
        let expected = if TURN < 2 {
            guess.expected - self.of_step
        } else {
            (guess.expected - self.of_step).max(LITTLE) + guess.bend
        };
        let along = i64::from(actual) - i64::from(kept);
        let along = match self.frequent::<TURN, C>(coder, expected, off, along)? {
            Some(along) => {
                self.frequent += 1;
                along
            }
            None => scale::code(coder, guess.contexts, expected, along.wrapping_sub(off)).wrapping_add(off),
        };
        // Whole numbers up to 2^24 are exact in single precision.
        match i64::from(kept).wrapping_add(along) {
            found if found.unsigned_abs() <= 1 << 24 => Ok(found as i32),
            _ => Err("its position lies outside of the lattice"),
        }
    }

    /// Codes which of the file's frequent numbers one is, if there are some and it is one.
    #[inline(always)]
    fn frequent<const TURN: usize, C: Coder>(
        &self,
        coder: &mut C,
        expected: i32,
        off: i64,
        along: i64,
    ) -> Result<Option<i64>, &'static str> {
        let list = &self.shape.numbers.frequent;
        if list.is_empty() {
            return Ok(None);
        }
        let expected = if TURN < 2 { expected } else { logarithm((off * off) as f32).max(expected) };
        let octave = (expected >> 5).clamp(0, OCTAVES as i32 - 1) as usize;
        let context = FREQUENT[TURN].context(self.frequent * OCTAVES + octave);
        let symbol = coder.symbol(context, list.symbol(along.unsigned_abs()));
        if symbol == 0 {
            return Ok(None);
        }
        let magnitude = i64::from(list.number(symbol).ok_or("its position is no number of the file")?);
        let is_negative = match TURN {
            _ if magnitude == 0 => false,
            2 => coder.decision(SIGN + usize::from(off < 0), along < 0),
            _ => coder.raw(1, u32::from(along < 0)) == 1,
        };
        Ok(Some(if is_negative { -magnitude } else { magnitude }))
    }
}

/// Codes the positions, and fills in what follows from them from the top down.
pub(super) fn code<C: Coder>(coder: &mut C, nodes: &mut Nodes, fields: &Fields, shape: &Shape) -> Result<(), Damage> {
    let first = nodes.first;
    let empty = Coordinates::new(shape);
    for index in first..nodes.all.len() {
        let wrong = |problem| Damage { field: "record", index: index - first, problem };
        let node = nodes.all[index];
        let (kept, normal) = (node.places[KEPT], node.normals[KEPT]);
        let expected = i32::from(node.length) + logarithm(node.size() as f32);
        let [a, b, c] = axes(normal);
        let steep = |axis: usize| logarithm((1.0 - normal[axis] * normal[axis]).max(STEEPEST));
        let (mut place, mut steps) = (kept, node.steps[KEPT]);
        let (actual, actual_steps) = if C::DECODES {
            (place, steps)
        } else {
            let actual = fields.places[index - first];
            (actual, shape.steps(actual))
        };
        let mut coordinates = empty;
        let wide = expected + steep(a);
        let guess = Guess { contexts: FIRST_COORDINATE.first, shift: 0.0, expected: wide, bend: 0 };
        let found = coordinates.code::<0, C>(coder, &guess, (steps[a], kept[a]), (actual_steps[a], actual[a]));
        (steps[a], place[a]) = found.map_err(wrong)?;
        let x = place[a] - kept[a];
        let contexts = SECOND_COORDINATE.first + level(x, wide) * CONTEXTS;
        let guess = Guess { contexts, shift: 0.0, expected: expected + steep(b), bend: 0 };
        let found = coordinates.code::<1, C>(coder, &guess, (steps[b], kept[b]), (actual_steps[b], actual[b]));
        (steps[b], place[b]) = found.map_err(wrong)?;
        let y = place[b] - kept[b];
        let shift = -(normal[a] * x + normal[b] * y) / normal[c];
        let expected = logarithm(x * x + y * y);
        let guess = Guess { contexts: THIRD_COORDINATE.first, shift, expected, bend: node.bend.into() };
        let found = coordinates.code::<2, C>(coder, &guess, (steps[c], kept[c]), (actual_steps[c], actual[c]));
        (steps[c], place[c]) = found.map_err(wrong)?;
        if !C::DECODES && place != actual {
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
