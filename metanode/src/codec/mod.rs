//! The coder of pages: the fields of a decoded page as few bits as they need, from which the page comes back exactly.
//!
//! To decode a page takes its bytes, its ancestor pages (decoded), and the tables of the file: nothing else, so pages are read
//! in any order. Everything that follows from something else is left out (leaf numbers, sizes, radii, references, switch
//! values), and what is left is predicted from what was decoded before, in this order:
//!
//! | module | field | predicted from |
//! |---|---|---|
//! | `structure` | which children are leaves, here, or in a child page; sizes and radii of subtrees there | the parent |
//! | `order` | dependency ids, with them switch values | the parent's, the size |
//! | `positions` | where the born leaf is | displacements above, the tangent plane |
//! | (here) | radii of bounding spheres | follow from the positions |
//! | `triangles`, `paths` | corners, as ways through the tree | where a corner is likely to be |
//! | `normals` | normals | the page's own triangles |
//! | `cones` | normal cones | the cones below, the normals |
//! | `wedges` | attributes of corners | those of the leaf that the born one is collapsed onto |
//!
//! | module | what else there is |
//! |---|---|
//! | `rans` | the entropy coder |
//! | `raw` | bits without a model |
//! | `tables` | probabilities, counted once for a file |
//! | `built_in` | probabilities for where that is not worth it |
//! | `contexts` | how many contexts there are of each kind |
//! | `fractions` | coordinates that are fractions of one denominator |
//! | `frequent` | numbers that come again and again |
//! | `scale` | numbers whose size is roughly known |
//! | `sizes` | how many bits each kind of field takes |
//! | `nodes` | what is known of the nodes around, of ancestor pages too |
//!
//! The fields and what they cost were found on prototypes (`shared/facts/codec.md`). Each field is written down once, for coding
//! and decoding alike ([`rans::Coder`]): an encoder goes through the same steps, with the true values at hand.
//!
//! A page that was altered gives an error or a page that is consistent within itself; never a panic, an endless loop or more
//! memory than the largest page may take.

mod built_in;
mod cones;
mod contexts;
mod fractions;
mod frame;
mod frequent;
mod nodes;
mod normals;
mod order;
mod paths;
mod positions;
mod rans;
mod raw;
mod scale;
mod sizes;
mod structure;
mod tables;
#[cfg(test)]
mod tests;
mod triangles;
mod wedges;

use storage::StorageError;
use vdt::tree::StoredTree;

use crate::page::{PageCounts, PageError};
use crate::wedges::{RootWedges, WedgeLayout};

use nodes::{BORN, ELSEWHERE, KEPT, LEAF, Nodes};

#[cfg(test)]
pub(crate) use built_in::to_bytes as built_in_to_bytes;
pub(crate) use cones::class_for;
pub(crate) use frame::{CHECKSUM_BYTES, Context, Head, PageDecoder};
pub(crate) use frequent::Frequent;
pub(crate) use nodes::Node;
pub(crate) use rans::{Coder, Decoder, Encoder, Uncounted};
pub(crate) use scale::logarithm;
pub use sizes::FieldBits;
pub(crate) use sizes::Measured;
pub(crate) use structure::{KIND_BELOW, KIND_HERE, radius_class};
pub(crate) use tables::{BadTables, Classes, Counts, Tables};
pub(crate) use wedges::KnownWedge;

/// What pages of a model have in common.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Shape {
    /// Switch values are normalised by two to this power.
    pub exponent: i32,
    /// The step of the lattice that all positions are on, in mesh units; 0 where there is none.
    pub lattice_step: f32,
    /// What numbers coordinates are.
    pub numbers: Numbers,
    /// What wedges are made of.
    pub wedges: WedgeLayout,
    /// How long displacements in the texture are, in steps, for those of the leaves, in mesh units: the logarithm of their ratio, in
    /// 32nds of an octave.
    pub texture_density: i32,
}

/// What numbers the coordinates of a model are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Numbers {
    /// The denominator of which most of them are fractions, where there is no lattice; 0 where there is none either.
    pub denominator: f32,
    /// Those that many displacements have, in steps of the lattice or numerators of the fractions.
    pub frequent: Frequent,
}

impl Numbers {
    /// Any.
    pub const ANY: Numbers = Numbers { denominator: 0.0, frequent: Frequent::NONE };
}

impl Shape {
    /// Of a tree, but for its textures: looks for what its positions have in common.
    pub fn of(tree: &StoredTree) -> Result<Self, StorageError> {
        let StoredTree { positions, exponent, lattice_step, .. } = tree;
        let mut shape = Shape {
            exponent: *exponent,
            lattice_step: *lattice_step,
            numbers: Numbers::ANY,
            wedges: WedgeLayout::of(tree),
            texture_density: 0,
        };
        if *lattice_step == 0.0 {
            shape.numbers.denominator = fractions::denominator(positions)?;
        }
        if *lattice_step > 0.0 || shape.numbers.denominator > 0.0 {
            shape.numbers.frequent = Frequent::find(positions, |position| {
                let steps = shape.steps(position);
                std::array::from_fn(|axis| shape.is_whole(position[axis], steps[axis]).then_some(steps[axis]))
            })?;
        }
        Ok(shape)
    }

    /// The whole numbers that come nearest to a position, on the lattice or as numerators. In double precision: a quotient
    /// above 2^22 would be rounded in single precision.
    fn steps(&self, position: [f32; 3]) -> [i32; 3] {
        if self.lattice_step > 0.0 {
            position.map(|value| (f64::from(value) / f64::from(self.lattice_step)).round() as i32)
        } else if self.numbers.denominator > 0.0 {
            position.map(|value| fractions::nearest(value, self.numbers.denominator))
        } else {
            [0; 3]
        }
    }

    /// Whether a coordinate can be coded as the whole number that comes nearest to it.
    fn is_whole(&self, coordinate: f32, step: i32) -> bool {
        self.lattice_step > 0.0 || fractions::offset(coordinate, step, self.numbers.denominator).is_some()
    }
}

/// The nearest whole number, within those of 32 bits; 0 for what is no number. Faster than `f32::round` where the processor has
/// no instruction for that.
#[inline(always)]
fn nearest(value: f32) -> i32 {
    (value + 0.5_f32.copysign(value)) as i32
}

/// What is wrong with a coded page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Damage {
    pub field: &'static str,
    pub index: usize,
    pub problem: &'static str,
}

impl From<Damage> for PageError {
    fn from(Damage { field, index, problem }: Damage) -> Self {
        PageError::Field { what: field, index, problem: problem.into() }
    }
}

/// A subtree in a child page.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Below {
    /// Its leaves.
    pub size: u32,
    /// The class of its bounding sphere's radius, see `structure`.
    pub radius: u8,
}

/// The fields of a page in the order in which they are coded.
#[derive(Debug, Clone, Default)]
pub(crate) struct Fields {
    /// How many child pages there are, and for each the number of entries that lead there.
    pub children: Vec<u16>,
    pub root_count: usize,
    /// For each record, which children are leaves (0), in this page (1), in a child page (2): the kept one's times 3.
    pub kinds: Vec<u8>,
    /// Each child that is in a child page, by its record, the kept one first.
    pub below: Vec<Below>,
    /// The id of each child that splits.
    pub ids: Vec<u32>,
    /// For each record where the born leaf is. Not used to decode.
    pub places: Vec<[f32; 3]>,
    /// For each record, how many triangles it bears: those whose second corner lies under the born child, and those whose third
    /// one does.
    pub counts: Vec<[u32; 2]>,
    /// For each record, where its triangles begin among `corners`.
    pub starts: Vec<u32>,
    /// Their corners: the one under the kept child, the one under the born child, the third one.
    pub corners: Vec<[u32; 3]>,
    /// For each record the normal of the born leaf.
    pub normals: Vec<u32>,
    /// For each child that splits the class of its cone.
    pub cones: Vec<u8>,
    /// For each record where its wedges begin among all. Not used to decode, like what follows.
    pub wedge_firsts: Vec<u32>,
    pub wedges: Vec<KnownWedge>,
    /// For each triangle the numbers of its corners' wedges, as `corners` has the corners.
    pub corner_wedges: Vec<[u32; 3]>,
    /// There are no more wedges than this.
    pub most_wedges: usize,
}

impl Fields {
    /// Forgets all but the room.
    pub fn clear(&mut self) {
        let Fields { children, root_count, kinds, below, ids, places, counts, starts, corners, normals, cones, .. } =
            self;
        let Fields { wedge_firsts, wedges, corner_wedges, most_wedges, .. } = self;
        (*root_count, *most_wedges) = (0, usize::MAX);
        wedge_firsts.clear();
        wedges.clear();
        corner_wedges.clear();
        children.clear();
        kinds.clear();
        below.clear();
        ids.clear();
        places.clear();
        counts.clear();
        starts.clear();
        corners.clear();
        normals.clear();
        cones.clear();
    }
}

impl Fields {
    /// What a writer knows of the wedges of a record.
    fn wedges_of(&self, record: usize) -> &[KnownWedge] {
        let Some(first) = self.wedge_firsts.get(record) else { return &[] };
        let end = self.wedge_firsts.get(record + 1).map_or(self.wedges.len(), |end| *end as usize);
        &self.wedges[*first as usize..end]
    }
}

/// Codes pages.
#[derive(Debug, Default)]
pub(crate) struct PageCoder {
    pub nodes: Nodes,
    pub fields: Fields,
    triangles: triangles::Scratch,
    normals: normals::Scratch,
    cones: cones::Scratch,
    pub wedges: wedges::State,
}

impl PageCoder {
    /// The counts of the page at hand.
    pub fn counts(&self, shape: &Shape) -> PageCounts {
        PageCounts {
            wedges: self.wedges.of_page().len(),
            layout: shape.wedges,
            children: self.fields.children.len(),
            records: self.fields.kinds.len(),
            entries: self.fields.ids.len(),
            triangles: self.fields.corners.len(),
        }
    }

    /// Codes the fields, of which a decoder only knows the counts of `children`, `root_count` and how many records there are.
    /// The roots of the page are the last of the nodes.
    pub fn code<C: Coder>(&mut self, coder: &mut C, shape: &Shape, roots: &RootWedges) -> Result<(), Damage> {
        let PageCoder { nodes, fields, triangles, normals, cones, wedges } = self;
        structure::code(coder, nodes, fields)?;
        order::code(coder, nodes, fields)?;
        positions::code(coder, nodes, fields, shape)?;
        radii(nodes, fields);
        triangles::code(coder, nodes, fields, triangles)?;
        normals::code(coder, nodes, fields, triangles, normals)?;
        cones::code(coder, nodes, fields, cones);
        wedges::code(coder, nodes, fields, &triangles.found, (shape, roots), wedges)
    }
}

/// How much larger a sum of lengths is taken for what its rounding loses.
const ROUNDED_UP: f32 = 1.0 + 1.0 / (1 << 21) as f32;

/// Works out the radii of the page's bounding spheres: from below they hold what is under them; from above, where the radius of
/// a root is known better than from the subtrees below, no sphere needs to reach out of its parent's.
fn radii(nodes: &mut Nodes, fields: &Fields) {
    let first = nodes.first;
    let length = |node: &nodes::Node| {
        // In double precision: squares of very small or very large lengths are no single-precision numbers.
        let d: [f64; 3] =
            std::array::from_fn(|axis| f64::from(node.places[BORN][axis]) - f64::from(node.places[KEPT][axis]));
        ((d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt() as f32) * ROUNDED_UP
    };
    for index in (first..nodes.all.len()).rev() {
        let node = nodes.all[index];
        let mut radii = node.radii;
        for side in [KEPT, BORN] {
            match node.children[side] {
                LEAF => radii[side] = 0.0,
                ELSEWHERE => (),
                child => radii[side] = nodes.all[child as usize].radius,
            }
        }
        let held = radii[KEPT].max((length(&node) + radii[BORN]) * ROUNDED_UP);
        let node = &mut nodes.all[index];
        node.radii = radii;
        if index - first >= fields.root_count {
            node.radius = held;
        }
    }
    for index in first..nodes.all.len() {
        let node = nodes.all[index];
        let left = (node.radius - length(&node)).max(0.0) + node.radius * (ROUNDED_UP - 1.0);
        let radii = [node.radii[KEPT].min(node.radius), node.radii[BORN].min(left)];
        nodes.all[index].radii = radii;
        for side in [KEPT, BORN] {
            if let Some(child) = nodes.all.get_mut(node.children[side] as usize) {
                child.radius = radii[side];
            }
        }
    }
}
