//! A corner of a triangle, as the way to its leaf through the tree: down from a node, at each node to the kept or to the born
//! child; or first up, to the first node whose other child has it.
//!
//! One looks for a leaf near an edge that is known, so it is roughly known where it must be (the *target*). Where that lies
//! between the two children says most about the way down; how far it is from a subtree, for its size, about the way up. The other
//! triangle of a split often goes the same way for a while.
//!
//! Where the way leads into a subtree in a page that is neither this one nor an ancestor, nothing is known of what is below. What is
//! known are the leaves that other triangles of the page have had there, and about where: what is near has a number that is near
//! ([`Outside`]). The first of a subtree is its first leaf, or any of the others.

use super::contexts::{DOWN, FIRST_LEAF, OUTSIDE, UP};
use super::nodes::{BORN, ELSEWHERE, KEPT, LEAF, NONE, Node, dot, minus};
use super::rans::Coder;
use super::scale;

/// Which corner is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Corner {
    /// That under the kept child.
    Kept,
    /// That under the born child.
    Born,
    /// The third one.
    Third,
}

/// Where a way has led.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    /// The leaf.
    pub leaf: u32,
    /// Where it is; for a leaf in a subtree elsewhere, where the first one there is.
    pub place: [f32; 3],
    /// Whether that is where it is.
    pub is_placed: bool,
    /// The node that bore it, or [`NONE`].
    pub bearer: u32,
}

impl Found {
    /// Nothing was found: the file is wrong.
    pub const NONE: Found = Found { leaf: NONE, place: [0.0; 3], is_placed: false, bearer: NONE };
}

/// Steps of a way that those behind it may follow.
const FOLLOWED: usize = 32;

/// The ways of the first triangle of a record, for those behind it. What is decided here is hard to foresee, so it is worked
/// out without branches.
#[derive(Debug)]
pub(super) struct Before {
    /// The nodes on the way, behind the last of them [`NONE`]; and what was decided.
    nodes: [u32; FOLLOWED + 1],
    decisions: [bool; FOLLOWED + 1],
    /// How many of them there are, or how many of them the way at hand has followed.
    next: usize,
    is_first: bool,
    follows: bool,
}

impl Default for Before {
    fn default() -> Self {
        let decisions = [false; FOLLOWED + 1];
        Before { nodes: [NONE; FOLLOWED + 1], decisions, next: 0, is_first: true, follows: false }
    }
}

impl Before {
    /// A first way begins.
    pub fn begin_first(&mut self) {
        (self.next, self.is_first) = (0, true);
        self.nodes[0] = NONE;
    }

    /// Another way begins, which may follow the first one.
    pub fn begin_other(&mut self) {
        (self.next, self.is_first, self.follows) = (0, false, true);
    }

    /// Context: 0 for the first way; 1 and 2 where it decided no and yes here; 3 where it has not been here.
    #[inline(always)]
    fn context(&mut self, node: u32) -> usize {
        if self.is_first {
            return 0;
        }
        let at = self.next.min(FOLLOWED);
        self.follows &= self.nodes[at] == node;
        let decided = 1 + usize::from(self.decisions[at]);
        if self.follows { decided } else { 3 }
    }

    #[inline(always)]
    fn note(&mut self, node: u32, decision: bool) {
        let at = self.next.min(FOLLOWED);
        if self.is_first {
            if at < FOLLOWED {
                (self.nodes[at], self.decisions[at], self.nodes[at + 1]) = (node, decision, NONE);
                self.next += 1;
            }
        } else {
            self.follows &= self.decisions[at] == decision;
            self.next += 1;
        }
    }
}

/// How many leaves elsewhere are remembered.
const REMEMBERED: usize = 16;

/// The last leaves in other pages that triangles of a page have had for corners, and where they were looked for.
#[derive(Debug)]
pub(super) struct Outside {
    leaves: [u32; REMEMBERED],
    places: [[f32; REMEMBERED]; 3],
    /// How many there have been.
    count: usize,
}

impl Default for Outside {
    fn default() -> Self {
        Outside { leaves: [NONE; REMEMBERED], places: [[0.0; REMEMBERED]; 3], count: 0 }
    }
}

impl Outside {
    /// Another page begins.
    pub fn clear(&mut self) {
        self.leaves = [NONE; REMEMBERED];
        self.count = 0;
    }

    fn remember(&mut self, leaf: u32, place: [f32; 3]) {
        let at = self.count % REMEMBERED;
        self.leaves[at] = leaf;
        (0..3).for_each(|axis| self.places[axis][at] = place[axis]);
        self.count += 1;
    }

    /// The square of the distance to the nearest one of `start..end`, and which that is, if there is one.
    #[inline(always)]
    fn nearest(&self, [start, end]: [u32; 2], target: [f32; 3]) -> (f32, Option<u32>) {
        let mut squares = [0.0; REMEMBERED];
        for axis in 0..3 {
            for at in 0..REMEMBERED {
                let off = self.places[axis][at] - target[axis];
                squares[at] += off * off;
            }
        }
        for at in 0..REMEMBERED {
            let is_one = self.leaves[at].wrapping_sub(start) < end - start;
            squares[at] = if is_one { squares[at] } else { f32::INFINITY };
        }
        let (mut least, mut found) = (f32::INFINITY, None);
        for (square, leaf) in squares.into_iter().zip(self.leaves) {
            if square < least {
                (least, found) = (square, Some(leaf));
            }
        }
        (least, found)
    }

    /// Codes `leaf`, which is one of `start..end` and which only an encoder knows, by the known one that is nearest to the
    /// target. None where the file is wrong.
    fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        [start, end]: [u32; 2],
        target: [f32; 3],
        edge: f32,
        corner: Corner,
        leaf: u32,
    ) -> Option<u32> {
        let found = match self.nearest([start, end], target) {
            (square, Some(known)) => {
                let far = ((half_octaves(square) - half_octaves(edge)) >> 1) + 4;
                let context = OUTSIDE.context(far.clamp(0, 7) as usize);
                let difference = i64::from(leaf) - i64::from(known);
                let found = i64::from(known) + scale::signed(coder, context, difference);
                if found == i64::from(known) {
                    return Some(known);
                }
                found
            }
            _ => {
                if coder.decision(FIRST_LEAF + corner as usize, leaf == start) {
                    start.into()
                } else {
                    // The others are one less; a subtree has two leaves at least.
                    let others = end - start - 1;
                    let bits = u32::BITS - (others - 1).leading_zeros();
                    i64::from(start) + 1 + i64::from(coder.raw(bits, leaf.wrapping_sub(start + 1)))
                }
            }
        };
        let found = u32::try_from(found).ok().filter(|found| (start..end).contains(found))?;
        self.remember(found, target);
        Some(found)
    }
}

/// The logarithm of a number that is not negative, in half octaves.
#[inline(always)]
fn half_octaves(value: f32) -> i32 {
    (value.abs().to_bits() >> 22) as i32
}

/// Small, middling or large.
#[inline(always)]
fn size_level(size: u32) -> usize {
    match size {
        ..=2 => 0,
        3..=5 => 1,
        6..=16 => 2,
        _ => 3,
    }
}

/// What the sizes of a node and its children say about a step down at it, from 0 to 11.
pub(super) fn step_class(start: u32, born: u32, end: u32) -> u8 {
    let (kept, born) = (born - start, end - born);
    let ratio = if kept / 2 > born {
        0
    } else if born / 2 > kept {
        2
    } else {
        1
    };
    (ratio * 4 + size_level(end - start)) as u8
}

/// The context of a step down at a node.
#[inline(always)]
fn down_context(node: &Node, target: [f32; 3], before: usize, corner: Corner) -> usize {
    // From -0.8 to 1.8 in steps of 0.2. (A cast brings what is no number to 0.)
    let along = dot(minus(target, node.places[KEPT]), node.axis);
    let step = ((along * 5.0 + 4.0) as i32).clamp(0, 12) as usize;
    ((usize::from(node.step_class) * 13 + step) * 4 + before) * 3 + corner as usize + DOWN
}

/// A way down to a leaf, from a child of a node.
#[derive(Debug, Clone, Copy)]
pub(super) struct Way {
    /// The node that it has come to, and to which child it goes.
    index: usize,
    side: usize,
    corner: Corner,
}

impl Way {
    /// From a child of a node.
    pub fn new(index: usize, side: usize, corner: Corner) -> Self {
        Way { index, side, corner }
    }

    /// The node that it goes to next, if it goes to one: no [`LEAF`], and not [`ELSEWHERE`].
    #[inline(always)]
    pub fn next(self, nodes: &[Node]) -> Option<u32> {
        Some(nodes[self.index].children[self.side]).filter(|child| *child < ELSEWHERE)
    }

    /// Goes on to that node, and decides to which of its children. `leaf` is where it leads, which only an encoder knows.
    #[inline(always)]
    pub fn go_on<C: Coder>(
        &mut self,
        coder: &mut C,
        nodes: &[Node],
        child: u32,
        target: [f32; 3],
        before: &mut Before,
        leaf: u32,
    ) {
        let before_here = before.context(child);
        self.index = child as usize;
        let node = &nodes[self.index];
        let is_born = coder.decision(down_context(node, target, before_here, self.corner), leaf >= node.born);
        before.note(child, is_born);
        self.side = usize::from(is_born);
    }

    /// Where it ends: at a leaf, or in a subtree elsewhere, where `leaf` is. It is looked for near the target, beside an edge the
    /// square of whose length is given. [`Found::NONE`] where the file is wrong.
    #[inline(always)]
    pub fn end<C: Coder>(
        self,
        coder: &mut C,
        nodes: &[Node],
        (target, edge): ([f32; 3], f32),
        outside: &mut Outside,
        leaf: u32,
    ) -> Found {
        let Way { index, side, corner } = self;
        let node = &nodes[index];
        let bearer = if side == BORN { index as u32 } else { node.bearer };
        let place = node.places[side];
        let (start, end) = node.interval(side);
        if node.children[side] == LEAF {
            return Found { leaf: start, place, is_placed: true, bearer };
        }
        let Some(leaf) = outside.code(coder, [start, end], target, edge, corner, leaf) else { return Found::NONE };
        let is_placed = leaf == start;
        Found { leaf, place, is_placed, bearer: if is_placed { bearer } else { NONE } }
    }
}

/// Goes up from a node to the first one above it whose other child has `leaf`, which only an encoder knows, and down to it from
/// there. `edge` is the square of the length of the edge that it is at. [`Found::NONE`] where the file is wrong.
pub(super) fn up_and_down<C: Coder>(
    coder: &mut C,
    nodes: &[Node],
    from: usize,
    (target, edge): ([f32; 3], f32),
    before: &mut Before,
    outside: &mut Outside,
    leaf: u32,
) -> Found {
    let mut index = from;
    let half_edge = 0.5 * edge.sqrt();
    let mut height = 0;
    loop {
        let Node { parent, side, .. } = nodes[index];
        let Some(node) = nodes.get(parent as usize) else { return Found::NONE };
        let other = 1 - usize::from(side);
        // At the root of the tree there is no choice.
        let is_there = node.parent == NONE || {
            let before_here = before.context(parent);
            let to_target = minus(target, node.places[other]);
            let reach = node.radii[other] + half_edge;
            // Half octaves of the square, from 2^-4 to 2^3.
            let far =
                ((half_octaves(dot(to_target, to_target)) - half_octaves(reach * reach)) + 8).clamp(0, 13) as usize;
            let thick = node.radii[other];
            let thick = if thick <= 0.0 {
                0
            } else if thick < half_edge {
                1
            } else if thick < 4.0 * half_edge {
                2
            } else {
                3
            };
            let (start, end) = node.interval(other);
            let size = match end - start {
                1 => 0,
                2..=8 => 1,
                _ => 2,
            };
            let context = (((far * 4 + thick) * 4 + before_here) * 3 + size) * 3 + usize::min(height, 2) + UP;
            let is_there = coder.decision(context, (start..end).contains(&leaf));
            before.note(parent, is_there);
            is_there
        };
        if is_there {
            let mut way = Way::new(parent as usize, other, Corner::Third);
            while let Some(child) = way.next(nodes) {
                way.go_on(coder, nodes, child, target, before, leaf);
            }
            return way.end(coder, nodes, (target, edge), outside, leaf);
        }
        index = parent as usize;
        height += 1;
    }
}
