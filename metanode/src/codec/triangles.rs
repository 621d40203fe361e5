//! The triangles that a split bears: how many, and their three corners, as ways through the tree (`paths`).
//!
//! A born triangle spans the edge between the two children. One corner lies under the kept child and one under the born child,
//! near the edge; the third lies outside, to the left or to the right of it. Most splits bear one triangle on each side; those to
//! the left come first. Records are gone through depth-first, so that what was found last is near.

use super::contexts::TRIANGLE_COUNT;
use super::nodes::{BORN, ELSEWHERE, KEPT, NONE, Node, Nodes, cross, dot, minus};
use super::paths::{Before, Corner, Found, Outside, Way, up_and_down};
use super::rans::Coder;
use super::{Damage, Fields};

/// Numbers of triangles that have a symbol of their own.
const COUNTS: [[u32; 2]; 4] = [[1, 1], [1, 0], [0, 1], [0, 0]];
/// Bits of numbers that have none.
const COUNT_BITS: u32 = 26;

/// Room to work in.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    ways: [Before; 3],
    outside: Outside,
    /// What was found, for each triangle as `Fields::corners` has them.
    pub found: Vec<[Found; 3]>,
    /// Records that wait for their turn.
    waiting: Vec<u32>,
}

/// Codes how many triangles a record bears on each side.
#[inline(always)]
fn code_counts<C: Coder>(coder: &mut C, context: usize, counts: [u32; 2]) -> [u32; 2] {
    let symbol = COUNTS.iter().position(|known| *known == counts).unwrap_or(COUNTS.len());
    match COUNTS.get(coder.symbol(TRIANGLE_COUNT.context(context), symbol)) {
        Some(known) => *known,
        None => counts.map(|count| coder.raw(COUNT_BITS, count)),
    }
}

/// Codes the triangles of all records.
pub(super) fn code<C: Coder>(
    coder: &mut C,
    nodes: &Nodes,
    fields: &mut Fields,
    scratch: &mut Scratch,
) -> Result<(), Damage> {
    let Nodes { all, first, .. } = nodes;
    let Scratch { ways, outside, found, waiting } = scratch;
    found.clear();
    found.resize(fields.corners.len(), [Found::NONE; 3]);
    outside.clear();
    waiting.clear();
    waiting.extend((*first as u32..(first + fields.root_count) as u32).rev());
    let is_inner = usize::from(!fields.children.is_empty());
    let mut next = 0;
    while let Some(index) = waiting.pop() {
        let record = index as usize - first;
        let wrong = |problem| Damage { field: "record", index: record, problem };
        let node = &all[index as usize];
        waiting.extend([BORN, KEPT].map(|side| node.children[side]).into_iter().filter(|child| *child < ELSEWHERE));
        let counts = code_counts(coder, is_inner, fields.counts[record]);
        let count = u64::from(counts[0]) + u64::from(counts[1]);
        if next as u64 + count > found.len() as u64 {
            return Err(wrong("it bears more triangles than the page has"));
        }
        if C::DECODES {
            (fields.counts[record], fields.starts[record]) = (counts, next as u32);
        }
        let start = fields.starts[record] as usize;
        for number in 0..count as usize {
            let is_right = number >= counts[0] as usize;
            ways.iter_mut().for_each(|way| if number == 0 { way.begin_first() } else { way.begin_other() });
            let corners = fields.corners[start + number];
            let here = one(coder, all, index as usize, is_right, ways, outside, corners);
            if here.iter().any(|corner| corner.leaf == NONE) {
                return Err(wrong("a corner leads nowhere"));
            }
            let leaves = here.map(|corner| corner.leaf);
            if !C::DECODES && leaves != corners {
                return Err(wrong("a triangle would not come back: it is not born here"));
            }
            fields.corners[start + number] = leaves;
            found[start + number] = here;
        }
        next += count as usize;
    }
    if next != found.len() {
        return Err(Damage { field: "triangle", index: next, problem: "no record bears it" });
    }
    Ok(())
}

/// Codes one triangle of a node: on its left side, or on its right side.
#[inline(always)]
fn one<C: Coder>(
    coder: &mut C,
    all: &[Node],
    index: usize,
    is_right: bool,
    [kept_way, born_way, third_way]: &mut [Before; 3],
    outside: &mut Outside,
    [kept, born, third]: [u32; 3],
) -> [Found; 3] {
    let node = &all[index];
    let normal = node.normals[KEPT];
    // To the left of a way, seen from outside.
    let aside = |along: [f32; 3], part: f32| {
        let left = cross(normal, along);
        left.map(|value| if is_right { -part * value } else { part * value })
    };
    let middle = |a: [f32; 3], b: [f32; 3]| -> [f32; 3] { std::array::from_fn(|axis| 0.5 * (a[axis] + b[axis])) };
    let plus = |a: [f32; 3], b: [f32; 3]| -> [f32; 3] { std::array::from_fn(|axis| a[axis] + b[axis]) };

    let target = plus(middle(node.places[KEPT], node.places[BORN]), aside(node.displacement(), 0.5));
    let d = node.displacement();
    let (mut to_kept, mut to_born) = (Way::new(index, KEPT, Corner::Kept), Way::new(index, BORN, Corner::Born));
    // Side by side, step by step: the steps of one do not have to wait for those of the other.
    loop {
        let next = (to_kept.next(all), to_born.next(all));
        if let Some(child) = next.0 {
            to_kept.go_on(coder, all, child, target, kept_way, kept);
        }
        if let Some(child) = next.1 {
            to_born.go_on(coder, all, child, target, born_way, born);
        }
        if next == (None, None) {
            break;
        }
    }
    let target = (target, dot(d, d));
    let kept = to_kept.end(coder, all, target, outside, kept);
    let born = to_born.end(coder, all, target, outside, born);
    let edge = minus(born.place, kept.place);
    let target = plus(middle(kept.place, born.place), aside(edge, 0.7));
    let third = up_and_down(coder, all, index, (target, dot(edge, edge)), third_way, outside, third);
    [kept, born, third]
}
