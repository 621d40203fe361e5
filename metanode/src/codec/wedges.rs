//! Wedges: the attributes of born leaves, and where there are seams which wedges turn into which, and which one each corner has.
//!
//! The wedges of the leaf that a split bears turn into wedges of the leaf onto which it is collapsed: their *images*. So an image
//! says most of what a wedge is, and what is coded are the differences.
//!
//! The numbers of wedges follow, as those of leaves do, from how many wedges turn into each: from below they add up; from above
//! each wedge's numbers are divided, those that stay with the kept child first. What cannot be worked out in the page is how many
//! there are in child pages, so these are coded.
//!
//! A corner has one of the wedges of its leaf. Where the leaf is in a page that is not at hand, its wedge is told by number among
//! those of the subtree that it is in; in a subtree without a seam there is but one.

use vdt::tree::{Appearance, MOST_WEDGES, Wedge};

use super::contexts::{
    COLOUR, CORNER_WEDGE, Family, MATERIAL, MATERIAL_NUMBER, SUBTREE_WEDGES, TEXTURE_FIRST, TEXTURE_SECOND,
    WEDGE_COUNT, WEDGE_IMAGE, WEDGE_NORMAL_FIRST, WEDGE_NORMAL_SECOND,
};
use super::nodes::{BORN, ELSEWHERE, KEPT, LEAF, NONE, Node, Nodes, dot};
use super::paths::Found;
use super::rans::Coder;
use super::scale::{self, CONTEXTS, logarithm};
use super::{Damage, Fields, Shape};
use crate::page::Page;
use crate::wedges::{PlacedWedge, RootWedges, WedgeLayout};

/// Places from this one on have no symbol of their own.
pub(super) const LARGE_PLACE: usize = 15;
/// Symbols of a place.
pub(super) const PLACES: usize = LARGE_PLACE + 1;
/// Bits of a place that has none.
const PLACE_BITS: u32 = 10;
/// Numbers of wedges that contexts tell apart.
pub(super) const COUNT_LEVELS: usize = 4;
/// Symbols of differences of colours and of normals: signed half-octave classes.
pub(super) const DIFFERENCES: usize = 2 * 20;
/// Levels of a difference that was coded before.
pub(super) const LEVELS: usize = 3;

/// What a writer knows of a wedge beforehand.
#[derive(Debug, Clone, Copy)]
pub(crate) struct KnownWedge {
    pub placed: PlacedWedge,
    /// The place of its image among the wedges of the leaf onto which its own is collapsed.
    pub image: u32,
}

/// The wedges of the leaves that are born by the nodes at hand.
#[derive(Debug, Default)]
pub(crate) struct State {
    /// For each page on the path its number, and where its nodes and their wedges begin.
    pages: Vec<(u32, usize, usize)>,
    /// For each node where the wedges of the leaf that it bears begin.
    firsts: Vec<u32>,
    wedges: Vec<PlacedWedge>,
    /// Where the nodes of the page at hand and their wedges begin.
    first_node: usize,
    first: usize,
    /// The images of the wedges of the page at hand.
    images: Vec<u32>,
    /// Of the page at hand: for each child in a child page, one behind the other, how many wedges turn into each of its own.
    below: Vec<u32>,
    /// The same for each node: where they begin, and all of them.
    size_firsts: Vec<u32>,
    sizes: Vec<u32>,
    /// For each triangle of the page the numbers of its corners' wedges, as `Fields::corners` has its corners.
    pub corners: Vec<[u32; 3]>,
    /// For each node which of the wedges of the leaf that it bears was chosen last; behind the nodes the same for the first leaf of
    /// a tree.
    chosen: Vec<u32>,
}

impl State {
    /// Has the wedges of these pages, from a root page down.
    pub fn begin(&mut self, ancestors: &[&Page], layout: WedgeLayout) {
        if layout.kinds.is_empty() {
            return;
        }
        let known = self.pages.iter().zip(ancestors).take_while(|(known, page)| known.0 == page.number()).count();
        let (nodes, wedges) = match self.pages.get(known) {
            Some((_, nodes, wedges)) => (*nodes, *wedges),
            None => (self.first_node, self.first),
        };
        self.firsts.truncate(nodes);
        self.wedges.truncate(wedges);
        self.pages.truncate(known);
        for page in &ancestors[known..] {
            self.pages.push((page.number(), self.firsts.len(), self.wedges.len()));
            for record in 0..page.counts().records as u16 {
                self.firsts.push(self.wedges.len() as u32);
                self.wedges.extend(page.wedges(record));
            }
        }
        self.first = self.wedges.len();
        self.first_node = self.firsts.len();
    }

    /// Forgets all pages.
    pub fn clear(&mut self) {
        *self = State::default();
    }

    /// Those of the leaf that a node bears.
    fn born(&self, node: u32) -> &[PlacedWedge] {
        let first = self.firsts.get(node as usize).map_or(self.wedges.len(), |first| *first as usize);
        let end = self.firsts.get(node as usize + 1).map_or(self.wedges.len(), |end| *end as usize);
        &self.wedges[first..end]
    }

    /// Those of the leaf at which a node stands.
    fn kept<'s>(&'s self, node: &Node, roots: &'s RootWedges) -> &'s [PlacedWedge] {
        if node.bearer == NONE { roots.of(node.start) } else { self.born(node.bearer) }
    }

    /// Those of the leaf at which a child of a node stands.
    fn of_child<'s>(&'s self, nodes: &Nodes, index: u32, side: usize, roots: &'s RootWedges) -> &'s [PlacedWedge] {
        if side == BORN { self.born(index) } else { self.kept(&nodes.all[index as usize], roots) }
    }

    /// The wedges of the page at hand.
    pub fn of_page(&self) -> &[PlacedWedge] {
        &self.wedges[self.first..]
    }

    /// For each record of the page at hand where its wedges begin among those of the page.
    pub fn firsts_of_page(&self) -> impl Iterator<Item = u32> + '_ {
        self.firsts[self.first_node..].iter().map(|first| first - self.first as u32)
    }

    /// How many wedges turn into each of those at which a child of a node stands, by the numbers of all above and of the node's own;
    /// into `sizes`.
    fn sizes_of_child(&self, nodes: &Nodes, index: u32, side: usize, roots: &RootWedges, sizes: &mut Vec<u32>) {
        let own = self.of_child(nodes, index, side, roots);
        sizes.clear();
        sizes.extend(own.iter().map(|placed| placed.end.saturating_sub(placed.number)));
        if side == BORN {
            return;
        }
        // What joins them further up the tree has larger numbers.
        let mut at = index;
        loop {
            for joined in self.born(at) {
                let image = own.iter().position(|placed| (placed.number..placed.end).contains(&joined.number));
                if let Some(image) = image {
                    sizes[image] = sizes[image].min(joined.number - own[image].number);
                }
            }
            let node = &nodes.all[at as usize];
            if node.parent == NONE || usize::from(node.side) == BORN {
                return;
            }
            at = node.parent;
        }
    }
}

/// Small numbers as they are, larger ones alike.
fn level(number: usize, levels: usize) -> usize {
    number.min(levels - 1)
}

/// Codes a place among some.
fn place<C: Coder>(coder: &mut C, context: usize, place: u32) -> u32 {
    let symbol = coder.symbol(context, (place as usize).min(LARGE_PLACE));
    if symbol == LARGE_PLACE { coder.raw(PLACE_BITS, place) } else { symbol as u32 }
}

/// Codes a number near another one; which of two contexts' worth of families it is in follows from `before`, the difference
/// coded last.
fn near<C: Coder>(coder: &mut C, family: Family, context: usize, before: i32, expected: i32, actual: i32) -> i32 {
    let level = match before.unsigned_abs() {
        0 => 0,
        1..=8 => 1,
        _ => 2,
    };
    let difference = i64::from(actual) - i64::from(expected);
    let found = scale::signed(coder, family.context(context * LEVELS + level), difference);
    i64::from(expected).saturating_add(found).clamp(i32::MIN.into(), i32::MAX.into()) as i32
}

/// Codes what a wedge is, by what its image is. `normal` is the computed one of its leaf.
fn code_wedge<C: Coder>(
    coder: &mut C,
    shape: &Shape,
    node: &Node,
    (image, normal): (&Wedge, u32),
    is_first: bool,
    actual: Wedge,
) -> Result<Wedge, &'static str> {
    let WedgeLayout { kinds, has_seams } = shape.wedges;
    let mut wedge = Wedge::PLAIN;
    if kinds.materials {
        let is_other =
            coder.symbol(MATERIAL.context(usize::from(is_first)), usize::from(actual.material != image.material));
        wedge.material = if is_other == 1 {
            let number = scale::number(coder, MATERIAL_NUMBER.context(0), actual.material.into());
            u32::try_from(number).map_err(|_| "it has a material that there cannot be")?
        } else {
            image.material
        };
    }
    if kinds.textures {
        let d = node.displacement();
        let expected = logarithm(dot(d, d)) + shape.texture_density;
        let difference = |axis: usize| i64::from(actual.texture[axis]) - i64::from(image.texture[axis]);
        let first = scale::code(coder, TEXTURE_FIRST.first, expected, difference(0));
        let size = logarithm((first as f32) * (first as f32)) - expected;
        let level = match size {
            ..-64 => 0,
            -64..-16 => 1,
            -16..16 => 2,
            _ => 3,
        };
        let second = scale::code(coder, TEXTURE_SECOND.first + level * CONTEXTS, expected, difference(1));
        for (axis, found) in [first, second].into_iter().enumerate() {
            let number = i64::from(image.texture[axis]).saturating_add(found);
            if number.unsigned_abs() > Appearance::LARGEST_TEXTURE.unsigned_abs().into() {
                return Err("its texture coordinate is too far away");
            }
            wedge.texture[axis] = number as i32;
        }
    }
    if kinds.colours {
        let [red, green, blue, alpha] = image.colour.map(i32::from);
        let actual = actual.colour.map(i32::from);
        let within = |value: i32| value.clamp(0, 255);
        // Red and blue mostly change as green does.
        let found_green = near(coder, COLOUR, 0, 0, green, actual[1]);
        let turn = found_green.saturating_sub(green);
        let red = within(red.saturating_add(turn));
        let found_red = near(coder, COLOUR, 1, turn, red, actual[0]);
        let blue = within(blue.saturating_add(turn));
        let found_blue = near(coder, COLOUR, 2, found_red.saturating_sub(red), blue, actual[2]);
        let found_alpha = near(coder, COLOUR, 3, 0, alpha, actual[3]);
        for (channel, found) in wedge.colour.iter_mut().zip([found_red, found_green, found_blue, found_alpha]) {
            *channel = u8::try_from(found).map_err(|_| "its colour is none")?;
        }
    }
    if kinds.normals && has_seams {
        let split = |word: u32| [(word & 1023) as i32, (word >> 10) as i32];
        let (expected, actual) = (split(normal), split(actual.normal.to_word()));
        let context = usize::from(!is_first);
        let u = near(coder, WEDGE_NORMAL_FIRST, context, 0, expected[0], actual[0]);
        let v = near(coder, WEDGE_NORMAL_SECOND, context, u.saturating_sub(expected[0]), expected[1], actual[1]);
        if u < 0 || v < 0 || u >> 10 != 0 || v >> 10 != 0 {
            return Err("its normal is none");
        }
        wedge.normal = vdt::tree::Normal::from_word((u | v << 10) as u32);
        if !wedge.normal.is_valid() {
            return Err("its normal is none");
        }
    }
    Ok(wedge)
}

/// Codes all that a page says of wedges. `found` are the corners of its triangles, as `Fields::corners` has them.
pub(super) fn code<C: Coder>(
    coder: &mut C,
    nodes: &Nodes,
    fields: &Fields,
    found: &[[Found; 3]],
    (shape, roots): (&Shape, &RootWedges),
    state: &mut State,
) -> Result<(), Damage> {
    state.images.clear();
    state.corners.clear();
    if shape.wedges.kinds.is_empty() {
        return Ok(());
    }
    code_wedges(coder, nodes, fields, (shape, roots), state)?;
    if shape.wedges.has_seams {
        code_sizes(coder, nodes, roots, state)?;
        number(nodes, fields, roots, state, C::DECODES)?;
        code_corners(coder, nodes, fields, found, roots, state)?;
    }
    Ok(())
}

/// Codes how many wedges each born leaf has, their images, and what they are.
fn code_wedges<C: Coder>(
    coder: &mut C,
    nodes: &Nodes,
    fields: &Fields,
    (shape, roots): (&Shape, &RootWedges),
    state: &mut State,
) -> Result<(), Damage> {
    for index in nodes.first..nodes.all.len() {
        let record = index - nodes.first;
        let wrong = |problem| Damage { field: "record", index: record, problem };
        let node = &nodes.all[index];
        let kept = state.kept(node, roots).len();
        if kept == 0 {
            return Err(wrong("the leaf that it is born from has no wedge"));
        }
        let known = fields.wedges_of(record);
        let count = if shape.wedges.has_seams {
            let context = WEDGE_COUNT.context(level(kept - 1, COUNT_LEVELS));
            place(coder, context, (known.len() as u32).wrapping_sub(1)) as usize + 1
        } else {
            1
        };
        if count > MOST_WEDGES || state.wedges.len() - state.first + count > fields.most_wedges {
            return Err(wrong("it has more wedges than there can be"));
        }
        state.firsts.push(state.wedges.len() as u32);
        for number in 0..count {
            let actual = known.get(number).copied();
            let image = match kept {
                1 => 0,
                _ => {
                    let context = level(number, COUNT_LEVELS) * COUNT_LEVELS + level(kept - 2, COUNT_LEVELS);
                    place(coder, WEDGE_IMAGE.context(context), actual.map_or(0, |known| known.image))
                }
            };
            let Some(PlacedWedge { wedge: image_wedge, .. }) = state.kept(node, roots).get(image as usize).copied()
            else {
                return Err(wrong("a wedge turns into one that there is not"));
            };
            let is = actual.map_or(Wedge::PLAIN, |known| known.placed.wedge);
            let like = (&image_wedge, fields.normals[record]);
            let wedge = code_wedge(coder, shape, node, like, number == 0, is).map_err(wrong)?;
            let mut placed = match actual {
                Some(known) => PlacedWedge { wedge, ..known.placed },
                None => PlacedWedge { wedge, number: node.born, end: node.born.saturating_add(1) },
            };
            if shape.wedges.kinds.normals && !shape.wedges.has_seams {
                placed.wedge.normal = vdt::tree::Normal::from_word(fields.normals[record]);
            }
            if actual.is_some_and(|known| known.placed.wedge != placed.wedge) {
                return Err(wrong("a wedge would not come back: it has what the model does not"));
            }
            state.wedges.push(placed);
            state.images.push(image);
        }
    }
    Ok(())
}

/// Codes how many wedges turn into those of each child in a child page.
fn code_sizes<C: Coder>(coder: &mut C, nodes: &Nodes, roots: &RootWedges, state: &mut State) -> Result<(), Damage> {
    let mut below = std::mem::take(&mut state.below);
    below.clear();
    let mut known = Vec::new();
    for (record, index) in (nodes.first as u32..nodes.all.len() as u32).enumerate() {
        let node = &nodes.all[index as usize];
        for side in [KEPT, BORN] {
            if node.children[side] != ELSEWHERE {
                continue;
            }
            let (start, end) = node.interval(side);
            let count = state.of_child(nodes, index, side, roots).len();
            // Leaves with one wedge each are most.
            let least = if count == 1 { end - start } else { 1 };
            if C::DECODES {
                known.clear();
                known.resize(count, 0);
            } else {
                state.sizes_of_child(nodes, index, side, roots, &mut known);
            }
            for size in &known {
                let more = u64::from(size.wrapping_sub(least));
                let found = scale::number(coder, SUBTREE_WEDGES.context(usize::from(count > 1)), more);
                let size = found.checked_add(least.into()).and_then(|size| u32::try_from(size).ok());
                let wrong = Damage { field: "record", index: record, problem: "a child has more wedges than can be" };
                below.push(size.ok_or(wrong)?);
            }
        }
    }
    state.below = below;
    Ok(())
}

/// Works out how many wedges turn into each from below, and their numbers from above. What a writer knows is checked.
fn number(nodes: &Nodes, fields: &Fields, roots: &RootWedges, state: &mut State, is_new: bool) -> Result<(), Damage> {
    let first = nodes.first;
    let wrong = |record: usize, problem| Damage { field: "record", index: record, problem };
    let records = nodes.all.len() - first;
    // For each child, kept and born, where its sizes begin, in `state.sizes`.
    let mut sides: Vec<[u32; 2]> = vec![[0; 2]; records];
    let (mut sizes, mut size_firsts) = (std::mem::take(&mut state.sizes), std::mem::take(&mut state.size_firsts));
    sizes.clear();
    size_firsts.clear();
    size_firsts.resize(records, 0);
    let mut next_below = state.below.len();
    for record in (0..records).rev() {
        let index = (first + record) as u32;
        let node = &nodes.all[index as usize];
        for side in [BORN, KEPT] {
            let count = state.of_child(nodes, index, side, roots).len();
            sides[record][side] = match node.children[side] {
                LEAF => {
                    sizes.resize(sizes.len() + count, 1);
                    (sizes.len() - count) as u32
                }
                ELSEWHERE => {
                    next_below = next_below.saturating_sub(count);
                    sizes.extend_from_slice(&state.below[next_below..next_below + count]);
                    (sizes.len() - count) as u32
                }
                child => size_firsts[child as usize - first],
            };
        }
        let [kept, born] = sides[record].map(|start| start as usize);
        let count = state.kept(node, roots).len();
        size_firsts[record] = sizes.len() as u32;
        sizes.extend_from_within(kept..kept + count);
        let own = sizes.len() - count;
        let wedges = state.firsts[index as usize] as usize - state.first;
        for (number, _) in state.born(index).iter().enumerate() {
            let place = own + state.images[wedges + number] as usize;
            let sum = sizes[place].checked_add(sizes[born + number]);
            sizes[place] = sum.ok_or(wrong(record, "it has more wedges than can be numbered"))?;
        }
    }
    let (mut known, mut next) = (Vec::new(), Vec::<u32>::new());
    for record in 0..records {
        let index = (first + record) as u32;
        let node = &nodes.all[index as usize];
        let count = state.kept(node, roots).len();
        if record < fields.root_count {
            known.clear();
            if node.parent == NONE {
                known.extend(state.kept(node, roots).iter().map(|placed| placed.end - placed.number));
            } else {
                state.sizes_of_child(nodes, node.parent, node.side.into(), roots, &mut known);
            }
            if known != sizes[size_firsts[record] as usize..][..count] {
                return Err(wrong(record, "it has not as many wedges as its node"));
            }
        }
        // The next number below each wedge of the leaf that stays.
        let [kept, born] = sides[record].map(|start| start as usize);
        next.clear();
        for (placed, size) in state.kept(node, roots).iter().zip(&sizes[kept..]) {
            next.push(placed.number.checked_add(*size).ok_or(wrong(record, "its wedges cannot be numbered"))?);
        }
        let wedges = state.firsts[index as usize] as usize;
        for number in 0..state.born(index).len() {
            let size = sizes[born + number];
            let place = &mut next[state.images[wedges - state.first + number] as usize];
            let end = place.checked_add(size).ok_or(wrong(record, "its wedges cannot be numbered"))?;
            let placed = &mut state.wedges[wedges + number];
            let found = PlacedWedge { number: *place, end, ..*placed };
            if !is_new && found != *placed {
                return Err(wrong(record, "its wedges would not come back: they are not numbered depth-first"));
            }
            *placed = found;
            *place = end;
        }
    }
    (state.sizes, state.size_firsts) = (sizes, size_firsts);
    Ok(())
}

/// Nothing was chosen before.
const NEVER: u32 = u32::MAX;
/// What was chosen before, as contexts tell it apart.
pub(super) const CHOICES: usize = 4;

/// Codes the wedge of each corner.
fn code_corners<C: Coder>(
    coder: &mut C,
    nodes: &Nodes,
    fields: &Fields,
    found: &[[Found; 3]],
    roots: &RootWedges,
    state: &mut State,
) -> Result<(), Damage> {
    let mut corners = std::mem::take(&mut state.corners);
    let mut chosen = std::mem::take(&mut state.chosen);
    corners.resize(found.len(), [0; 3]);
    chosen.clear();
    chosen.resize(nodes.all.len() + 1, NEVER);
    let mut sizes = Vec::new();
    for (record, (counts, start)) in fields.counts.iter().zip(&fields.starts).enumerate() {
        let wrong = Damage { field: "record", index: record, problem: "a corner has a wedge that its leaf does not" };
        for triangle in *start as usize..(*start + counts[0] + counts[1]) as usize {
            for corner in 0..3 {
                let at = found[triangle][corner];
                let actual = fields.corner_wedges.get(triangle).map_or(0, |corners| corners[corner]);
                corners[triangle][corner] = if at.is_placed {
                    let (own, slot) = match at.bearer {
                        NONE => (roots.of(at.leaf), nodes.all.len()),
                        bearer => (state.born(bearer), bearer as usize),
                    };
                    let mut choice = 0;
                    if own.len() > 1 {
                        let before = match chosen[slot] {
                            NEVER => 0,
                            choice => 1 + level(choice as usize, CHOICES - 1),
                        };
                        let context = (level(own.len() - 2, COUNT_LEVELS) * 3 + corner) * CHOICES + before;
                        let actual = own.iter().position(|placed| placed.number == actual);
                        choice = place(coder, CORNER_WEDGE.context(context), actual.unwrap_or(own.len()) as u32);
                        chosen[slot] = choice;
                    }
                    own.get(choice as usize).ok_or(wrong)?.number
                } else {
                    let (index, side) =
                        subtree_of(nodes, first_of_tree(nodes, nodes.first + record), at.leaf).ok_or(wrong)?;
                    let own = state.of_child(nodes, index, side, roots);
                    state.sizes_of_child(nodes, index, side, roots, &mut sizes);
                    let (start, end) = nodes.all[index as usize].interval(side);
                    if let ([placed], [size]) = (own, &sizes[..])
                        && *size == end - start
                    {
                        placed.number + (at.leaf - start)
                    } else {
                        among(coder, own, &sizes, actual).ok_or(wrong)?
                    }
                };
                if !C::DECODES && corners[triangle][corner] != actual {
                    return Err(wrong);
                }
            }
        }
    }
    (state.corners, state.chosen) = (corners, chosen);
    Ok(())
}

/// Codes a number among those of some wedges.
fn among<C: Coder>(coder: &mut C, own: &[PlacedWedge], sizes: &[u32], actual: u32) -> Option<u32> {
    let total: u64 = sizes.iter().map(|size| u64::from(*size)).sum();
    let total = u32::try_from(total).ok()?;
    let bits = u32::BITS - total.saturating_sub(1).leading_zeros();
    let mut before = 0;
    let mut offset = 0;
    for (placed, size) in own.iter().zip(sizes) {
        if let Some(inside) = actual.checked_sub(placed.number).filter(|inside| inside < size) {
            offset = before + inside;
        }
        before += size;
    }
    let mut offset = coder.raw(bits, offset);
    for (placed, size) in own.iter().zip(sizes) {
        if offset < *size {
            return Some(placed.number + offset);
        }
        offset -= size;
    }
    None
}

/// The root of the tree that a node is in.
fn first_of_tree(nodes: &Nodes, index: usize) -> u32 {
    let mut index = index as u32;
    while nodes.all[index as usize].parent != NONE {
        index = nodes.all[index as usize].parent;
    }
    index
}

/// The subtree elsewhere that has a leaf, as a child of a node, from the root of the tree down.
fn subtree_of(nodes: &Nodes, root: u32, leaf: u32) -> Option<(u32, usize)> {
    let mut index = root;
    loop {
        let node = nodes.all.get(index as usize).filter(|node| (node.start..node.end).contains(&leaf))?;
        let side = usize::from(leaf >= node.born);
        match node.children[side] {
            ELSEWHERE => return Some((index, side)),
            LEAF => return None,
            child => index = child,
        }
    }
}
