//! Normals of born leaves.
//!
//! A normal is mostly that of the triangles around, weighted by their areas. Those of the page's own triangles are summed up; where
//! they close up around the leaf there are no others, and the normal is known but for its last bit. Whether they do is told by
//! adding up what follows each triangle's corner and taking away what comes before it: all cancels out. Where the page has no
//! triangle at the leaf, the normal estimated from the node's is taken.
//!
//! A normal has two coordinates on an octahedron, of ten bits each; their differences are coded.

use vdt::tree::Normal;

use super::contexts::{FIRST_NORMAL, SECOND_NORMAL};
use super::nodes::{BORN, KEPT, NONE, Nodes, cross, minus};
use super::rans::Coder;
use super::scale;
use super::triangles::Scratch as Triangles;
use super::{Damage, Fields};

/// Contexts by what is expected: triangles that close up; 0 to 6 that do not.
pub(super) const CONTEXTS: usize = 8;
/// Signed half-octave classes of differences.
pub(super) const SYMBOLS: usize = 2 * 20;
/// Bits of a coordinate.
const BITS: u32 = 10;

/// Room to work in: for each record of the page the normals of its triangles at the born leaf.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    sums: Vec<Sum>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    normal: [f32; 3],
    /// What follows at the leaf, less what comes before it.
    open: u32,
    triangles: u32,
}

/// Spreads leaf numbers out, so that sums of some are not those of others.
#[inline(always)]
fn spread(leaf: u32) -> u32 {
    let mixed = leaf.wrapping_mul(0x9e37_79b1);
    mixed ^ mixed >> 15
}

/// Codes the normals, and fills in those of all nodes of the page.
pub(super) fn code<C: Coder>(
    coder: &mut C,
    nodes: &mut Nodes,
    fields: &mut Fields,
    triangles: &Triangles,
    scratch: &mut Scratch,
) -> Result<(), Damage> {
    let first = nodes.first;
    let records = nodes.all.len() - first;
    let Scratch { sums } = scratch;
    sums.clear();
    sums.resize(records, Sum::default());
    for (counts, start) in fields.counts.iter().zip(&fields.starts) {
        let start = *start as usize;
        for (number, found) in triangles.found[start..start + (counts[0] + counts[1]) as usize].iter().enumerate() {
            let [kept, born, third] = found;
            if !(kept.is_placed && born.is_placed && third.is_placed) {
                continue;
            }
            let corners = if number < counts[0] as usize { [kept, born, third] } else { [kept, third, born] };
            let [a, b, c] = corners.map(|corner| corner.place);
            let normal = cross(minus(b, a), minus(c, a));
            for corner in 0..3 {
                let bearer = corners[corner].bearer;
                if bearer == NONE || (bearer as usize) < first {
                    continue;
                }
                let sum = &mut sums[bearer as usize - first];
                (0..3).for_each(|axis| sum.normal[axis] += normal[axis]);
                sum.triangles += 1;
                let (after, before) = (corners[(corner + 1) % 3].leaf, corners[(corner + 2) % 3].leaf);
                sum.open = sum.open.wrapping_add(spread(after)).wrapping_sub(spread(before));
            }
        }
    }
    for index in first..nodes.all.len() {
        let record = index - first;
        let node = &nodes.all[index];
        let sum = &sums[record];
        let (context, expected) = match sum.triangles {
            0 => (1, encoded(node.normals[BORN])),
            triangles if sum.open == 0 && triangles > 2 => (0, encoded(sum.normal)),
            triangles => (1 + triangles.min(6) as usize, encoded(sum.normal)),
        };
        let split = |word: u32| [(word & ((1 << BITS) - 1)) as i32, (word >> BITS) as i32];
        let (expected, actual) = (split(expected.to_word()), split(fields.normals[record]));
        let u = coordinate(coder, FIRST_NORMAL.context(context), expected[0], actual[0]);
        let level = match (u - expected[0]).abs() {
            0 => 0,
            1..=4 => 1,
            _ => 2,
        };
        let v = coordinate(coder, SECOND_NORMAL.context(context * 3 + level), expected[1], actual[1]);
        if u < 0 || v < 0 || u >> BITS != 0 || v >> BITS != 0 {
            return Err(Damage { field: "record", index: record, problem: "its normal is none" });
        }
        fields.normals[record] = (u | v << BITS) as u32;
    }
    // From here on all normals are known.
    for index in first..nodes.all.len() {
        let normal = Normal::from_word(fields.normals[index - first]).decode();
        nodes.all[index].normals[BORN] = normal;
        let node = nodes.all[index];
        for side in [KEPT, BORN] {
            if let Some(child) = nodes.all.get_mut(node.children[side] as usize) {
                child.normals[KEPT] = node.normals[side];
            }
        }
    }
    Ok(())
}

fn encoded(direction: [f32; 3]) -> Normal {
    Normal::encode(direction.map(f64::from))
}

/// Codes a coordinate.
#[inline(always)]
fn coordinate<C: Coder>(coder: &mut C, context: usize, expected: i32, actual: i32) -> i32 {
    expected + scale::signed(coder, context, i64::from(actual - expected)) as i32
}
