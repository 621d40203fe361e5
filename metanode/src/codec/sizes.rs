//! How many bits of a page each kind of field takes.
//!
//! A symbol of probability p takes -log2 p bits, so it is enough to look on while a page is decoded, by the same tables. What
//! is missing to the page's bytes are the states of the coder and the rounding to whole bytes.

use super::contexts::{CLASS_STEP, CONE, FIRST_COORDINATE, FIRST_NORMAL, OUTSIDE, SIGN, TRIANGLE_COUNT, WEDGE_COUNT};
use super::rans::{Coder, Decoder, PRECISION, TOTAL};
use super::tables::Tables;

/// Bits of coded fields, by kind.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FieldBits {
    /// Which children are leaves, and sizes and radii of subtrees in child pages.
    pub structure: f64,
    /// Dependency ids, from which switch values follow.
    pub ids: f64,
    /// Positions of born leaves.
    pub positions: f64,
    /// Born triangles.
    pub triangles: f64,
    /// Normals of born leaves.
    pub normals: f64,
    /// Normal cones.
    pub cones: f64,
    /// Attributes of corners.
    pub attributes: f64,
}

impl FieldBits {
    /// All of them.
    pub fn total(&self) -> f64 {
        self.structure + self.ids + self.positions + self.triangles + self.normals + self.cones + self.attributes
    }

    fn of(&mut self, field: Field) -> &mut f64 {
        match field {
            Field::Structure => &mut self.structure,
            Field::Ids => &mut self.ids,
            Field::Positions => &mut self.positions,
            Field::Triangles => &mut self.triangles,
            Field::Normals => &mut self.normals,
            Field::Cones => &mut self.cones,
            Field::Attributes => &mut self.attributes,
        }
    }
}

#[derive(Debug, Clone, Copy)]
enum Field {
    Structure,
    Ids,
    Positions,
    Triangles,
    Normals,
    Cones,
    Attributes,
}

impl Field {
    /// That of the symbols of a context. The families of contexts stand in the order of the fields.
    fn of_symbols(context: usize) -> Field {
        match context {
            _ if context < CLASS_STEP.first => Field::Structure,
            _ if context < FIRST_COORDINATE.first => Field::Ids,
            _ if context < TRIANGLE_COUNT.first => Field::Positions,
            _ if context < FIRST_NORMAL.first => Field::Triangles,
            _ if context < CONE.first => Field::Normals,
            _ if context < OUTSIDE.first => Field::Cones,
            _ if context < WEDGE_COUNT.first => Field::Triangles,
            _ => Field::Attributes,
        }
    }
}

/// A decoder, looked on.
pub(crate) struct Measured<'a, 'b> {
    decoder: &'a mut Decoder<'b>,
    tables: &'a Tables,
    bits: &'a mut FieldBits,
    /// The field of the last symbol or decision: raw bits stand behind what they belong to.
    field: Field,
}

impl<'a, 'b> Measured<'a, 'b> {
    /// Adds to `bits` what is decoded.
    pub fn new(decoder: &'a mut Decoder<'b>, tables: &'a Tables, bits: &'a mut FieldBits) -> Self {
        Measured { decoder, tables, bits, field: Field::Structure }
    }

    fn add(&mut self, field: Field, frequency: u32) {
        self.field = field;
        *self.bits.of(field) += f64::from(PRECISION) - f64::from(frequency).log2();
    }
}

impl Coder for Measured<'_, '_> {
    const DECODES: bool = true;

    fn symbol(&mut self, context: usize, symbol: usize) -> usize {
        let symbol = self.decoder.symbol(context, symbol);
        self.add(Field::of_symbols(context), self.tables.interval(context, symbol) >> 16);
        symbol
    }

    fn decision(&mut self, context: usize, decision: bool) -> bool {
        let decision = self.decoder.decision(context, decision);
        let ones = u32::from(self.tables.ones(context));
        let field = if context < SIGN { Field::Triangles } else { Field::Positions };
        self.add(field, if decision { ones } else { TOTAL - ones });
        decision
    }

    fn raw(&mut self, bits: u32, value: u32) -> u32 {
        *self.bits.of(self.field) += f64::from(bits);
        self.decoder.raw(bits, value)
    }
}
