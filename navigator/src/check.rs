//! Whether the front and the pool are well-formed (invariants 4 and 5 of the design). Slow: for tests, and for whoever
//! does not trust a model.

use metanode::model::{Model, PageReader};
use metanode::page::{Page, PageLocation, Target};
use metanode::wedges::PlacedWedge;

use crate::camera::{Camera, CameraError};
use crate::dependency::Dependency;
use crate::front::{Front, NONE, Seams};
use crate::navigator::Navigator;
use crate::refine::want;

/// Checks, between two frames, everything that must hold; says what does not.
///
/// - the leaf intervals of the active nodes partition the leaves, and those of two children their parent's;
/// - each corner of a triangle is under its node, the three nodes are distinct, and it is once in each one's star;
/// - the triangles are those that the applied splits bear, each once; they are counted by their trees;
/// - where corners have wedges, each vertex has those of its first leaf, and each corner that of them with the largest number which
///   is not above the one that it has in the input;
/// - with implicit dependency, of the collapses that moved a corner of a triangle, those that are not undone come before those
///   that are (with `flip` nothing is proven of all triangles together, so nothing is checked);
/// - the usage count of each place holder is the number of applied splits of its page; the pool's own counts and lists
///   fit to each other; the parent of each page that is there is there.
pub fn check(navigator: &Navigator) -> Result<(), String> {
    check_cut(navigator)?;
    if navigator.dependency() == Dependency::Implicit {
        check_lives(navigator)?;
    }
    Ok(())
}

/// What a front leaves undone for a camera.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Undone {
    /// Active nodes whose error is above the threshold.
    pub splits: u64,
    /// Nodes whose children are active and whose error is below the threshold, by the margin between the two tests, that no
    /// dependency keeps from being restored.
    pub collapses: u64,
}

/// What the front leaves undone for this camera, with the threshold that the navigator has come to, raised by limits or not. Of
/// one that is settled there with it: nothing, but for nodes that it would take too long a chain of dependencies to split.
///
/// So its front lies between two cuts: all is split in it that a fresh navigator would have to split for that threshold, and
/// nothing that the margin and the dependencies would not keep.
pub fn undone(navigator: &Navigator, camera: &Camera) -> Result<Undone, CameraError> {
    let view = navigator.view(camera)?;
    let threshold = navigator.threshold();
    let (for_split, for_collapse) = (view.splits(threshold), view.collapses(threshold));
    let is_kept = navigator.keeps_splits(&view, threshold);
    let front = navigator.front();
    let mut undone = Undone::default();
    for vertex in front.vertices() {
        undone.splits += u64::from(!front.is_leaf(vertex) && for_split.is_exceeded(&front.sphere(vertex)));
        let born = front.last_born(vertex);
        let is_wish =
            born != NONE && front.is_collapsible(born) && !for_collapse.is_exceeded(&front.sphere_above(born));
        undone.collapses += u64::from(is_wish && !is_kept(front, born));
    }
    Ok(undone)
}

/// All of that but for what pages below the front say, which are not read: what holds whatever the pages of a model are.
pub(crate) fn check_cut(navigator: &Navigator) -> Result<(), String> {
    check_nodes(navigator)?;
    check_stars(navigator.front())?;
    check_births(navigator)?;
    check_wedges(navigator)?;
    check_usage(navigator)?;
    navigator.paging().pool().check()
}

fn check_nodes(navigator: &Navigator) -> Result<(), String> {
    let front = navigator.front();
    let mut intervals = Vec::new();
    for vertex in front.vertices() {
        let (start, end) = front.interval(vertex);
        intervals.push((start, end));
        if front.is_leaf(vertex) != (end - start == 1) {
            return Err(format!("active node {vertex} with leaves {start}..{end} has id {}", front.id(vertex)));
        }
        let is_root = front.kept(vertex) == NONE;
        if is_root != ((vertex as usize) < navigator.model().roots().len()) {
            return Err(format!("vertex {vertex} is a root, or is not"));
        }
        check_births_at(front, vertex)?;
    }
    intervals.sort_unstable();
    let mut next = 0;
    for (start, end) in &intervals {
        if *start != next {
            return Err(format!("the active nodes leave or share leaf {}", next.min(*start)));
        }
        next = *end;
    }
    if next != navigator.model().header().leaf_count {
        return Err(format!("the active nodes end at leaf {next}"));
    }
    if intervals.len() != front.vertex_count() {
        return Err(format!("{} active nodes, counted {}", intervals.len(), front.vertex_count()));
    }
    Ok(())
}

/// The id of the node that a vertex was born as: that of the first split there, or of the active node.
fn first_id(front: &Front, vertex: u32) -> u32 {
    let mut born = front.last_born(vertex);
    if born == NONE {
        return front.id(vertex);
    }
    while front.previous(born) != NONE {
        born = front.previous(born);
    }
    front.id_above(born)
}

/// The splits at a vertex, from the last one back: each bore a vertex whose leaves come after those of later ones, and undoing it
/// restores a node with a larger id than those of both children.
fn check_births_at(front: &Front, vertex: u32) -> Result<(), String> {
    let (start, mut end) = front.interval(vertex);
    let (mut born, mut kept_id) = (front.last_born(vertex), front.id(vertex));
    let can_be_undone = born != NONE && front.last_born(born) == NONE;
    if born != NONE && front.is_collapsible(born) != can_be_undone {
        return Err(format!(
            "vertex {vertex}: whether the split that bore {born} can be undone is not {can_be_undone}"
        ));
    }
    if front.criteria_fit(vertex) != Ok(()) {
        return Err(format!("vertex {vertex}: {:?}", front.criteria_fit(vertex)));
    }
    while born != NONE {
        let (born_start, born_end) = front.interval_of_birth(born);
        let id = front.id_above(born);
        let fits = front.kept(born) == vertex && born_start == end && id > kept_id && id > first_id(front, born);
        if !fits {
            return Err(format!(
                "vertex {born}, with leaves {born_start}..{born_end}, was not born from {vertex}, {start}..{end}"
            ));
        }
        (end, kept_id) = (born_end, id);
        born = front.previous(born);
    }
    Ok(())
}

fn check_stars(front: &Front) -> Result<(), String> {
    let mut from_triangles = Vec::new();
    for (triangle, corners) in front.triangles() {
        for (place, vertex) in corners.into_iter().enumerate() {
            let leaf = front.leaf_at(vertex, triangle);
            let (start, end) = front.interval(vertex);
            if !front.is_vertex(vertex) || leaf < start || leaf >= end {
                return Err(format!("triangle {triangle}: leaf {leaf} is not under vertex {vertex}"));
            }
            from_triangles.push((vertex, triangle << 2 | place as u32));
        }
        if corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0] {
            return Err(format!("triangle {triangle} has the corners {corners:?}"));
        }
    }
    if from_triangles.len() != 3 * front.triangle_count() {
        return Err(format!("{} corners, {} triangles counted", from_triangles.len(), front.triangle_count()));
    }
    let star = |vertex: u32| front.star(vertex).take(from_triangles.len() + 1).map(move |entry| (vertex, entry.corner));
    let mut from_stars: Vec<_> = front.vertices().flat_map(star).collect();
    from_triangles.sort_unstable();
    from_stars.sort_unstable();
    if from_triangles != from_stars {
        return Err("the stars are not those of the triangles".into());
    }
    let drawn = front.corners().iter().filter(|[first, second, _]| first != second).count();
    if drawn != front.triangle_count() {
        return Err(format!("the list draws {drawn} triangles of {}", front.triangle_count()));
    }
    Ok(())
}

fn check_births(navigator: &Navigator) -> Result<(), String> {
    let front = navigator.front();
    let mut born = Vec::new();
    for vertex in front.born() {
        born.extend(navigator.paging().page(front.slot(vertex)).triangles(front.record_of_birth(vertex)));
    }
    let source = |(triangle, corners): (u32, [u32; 3])| corners.map(|vertex| front.leaf_at(vertex, triangle));
    let mut drawn: Vec<_> = front.triangles().map(source).collect();
    born.sort_unstable();
    drawn.sort_unstable();
    let mut by_tree = vec![0; navigator.model().roots().len()];
    drawn.iter().for_each(|leaves| by_tree[front.tree_of(leaves[0])] += 1);
    for (tree, triangles) in by_tree.iter().enumerate() {
        if front.tree_triangles(tree) != *triangles {
            return Err(format!("tree {tree} has {triangles} triangles, {} counted", front.tree_triangles(tree)));
        }
    }
    let vanished = by_tree.iter().filter(|triangles| **triangles == 0).count();
    if front.vanished_trees() != vanished {
        return Err(format!("{vanished} trees have no triangle, {} counted", front.vanished_trees()));
    }
    if born != drawn {
        return Err(format!("{} triangles are drawn, the applied splits bear {}", drawn.len(), born.len()));
    }
    Ok(())
}

fn check_wedges(navigator: &Navigator) -> Result<(), String> {
    let front = navigator.front();
    let (Some(wedges), Some(appearance)) = (front.wedges(), navigator.model().appearance()) else { return Ok(()) };
    let drawn = |slot: u32| wedges.stream()[slot as usize];
    let mut slots = Vec::new();
    for vertex in front.vertices() {
        let normal = front.positions()[vertex as usize][3].to_bits();
        let mut said: Vec<PlacedWedge> = match front.kept(vertex) {
            NONE => appearance.root_wedges.of_tree(vertex as usize).to_vec(),
            _ => navigator.paging().page(front.slot(vertex)).wedges(front.record_of_birth(vertex)).collect(),
        };
        let is_there = match wedges.seams() {
            None => said.iter().map(|placed| wedges.drawn(placed, normal)).eq([drawn(vertex)]),
            Some(seams) => {
                said.sort_by_key(|placed| placed.number);
                slots.extend(seams.at(vertex).map(|(slot, _)| slot));
                let found = seams.at(vertex).map(|(slot, number)| (number, drawn(slot)));
                found.eq(said.iter().map(|placed| (placed.number, wedges.drawn(placed, normal))))
            }
        };
        if !is_there {
            return Err(format!("vertex {vertex} does not have the wedges {said:?}"));
        }
    }
    let Some(seams) = wedges.seams() else { return Ok(()) };
    let count = slots.len();
    slots.sort_unstable();
    slots.dedup();
    if slots.len() != count || count != seams.used() {
        return Err(format!(
            "{} slots of wedges are taken, {count} wedges have one, {} counted",
            slots.len(),
            seams.used()
        ));
    }
    check_corners(navigator, seams)
}

fn check_corners(navigator: &Navigator, seams: &Seams) -> Result<(), String> {
    let front = navigator.front();
    let mut born = Vec::new();
    for vertex in front.born() {
        let (page, record) = (navigator.paging().page(front.slot(vertex)), front.record_of_birth(vertex));
        born.extend(page.triangles(record).zip(page.corner_wedges(record)));
    }
    let mut drawn = Vec::new();
    for (triangle, corners) in front.triangles() {
        let sources = [0, 1, 2].map(|place| seams.source(triangle, place));
        drawn.push((corners.map(|vertex| front.leaf_at(vertex, triangle)), sources));
        for ((vertex, source), slot) in corners.into_iter().zip(sources).zip(seams.corners()[triangle as usize]) {
            let expected = seams.at(vertex).take_while(|(_, number)| *number <= source).last();
            if expected.is_none_or(|(expected, _)| expected != slot) {
                return Err(format!("triangle {triangle}: wedge {source} is slot {slot}, and not {expected:?}"));
            }
        }
    }
    let mut places = front.corners().iter().zip(seams.corners());
    if places.any(|([first, second, _], slots)| first == second && *slots != [0; 3]) {
        return Err("a corner of no triangle has a wedge".into());
    }
    if seams.corners().len() != front.corners().len() {
        return Err(format!(
            "{} places of triangles, {} of their wedges",
            front.corners().len(),
            seams.corners().len()
        ));
    }
    born.sort_unstable();
    drawn.sort_unstable();
    if born != drawn { Err("the wedges of corners are not those that splits bear".into()) } else { Ok(()) }
}

fn check_lives(navigator: &Navigator) -> Result<(), String> {
    let front = navigator.front();
    for (triangle, nodes) in front.triangles() {
        let leaves = nodes.map(|vertex| front.leaf_at(vertex, triangle));
        for first in 0..3 {
            for second in (0..3).filter(|second| *second != first) {
                let moves_on = front.moved_by(nodes[second]);
                // Seldom is more to be known than the node's id.
                if front.id(nodes[first]) > moves_on && last_moved(navigator, nodes[first], leaves[first])? > moves_on {
                    return Err(format!(
                        "triangle {leaves:?}: a corner was moved to node {} when that at {} had moved on",
                        front.id(nodes[first]),
                        front.id(nodes[second])
                    ));
                }
            }
        }
    }
    Ok(())
}

/// By which collapse the corner of this leaf was moved to an active node; 0 where it never was. Reads the pages below.
fn last_moved(navigator: &Navigator, node: u32, leaf: u32) -> Result<u32, String> {
    let (front, paging, model) = (navigator.front(), navigator.paging(), navigator.model());
    if front.is_leaf(node) {
        return Ok(0);
    }
    let (page_number, mut index) = front.place(node);
    let mut moved = front.id(node);
    let mut above = Vec::new();
    let mut below = match front.slot_above(node) {
        NONE => {
            let location = paging.location(&want(front, node, 0.0));
            for location in model.way_to(location.number) {
                read_below(model, location, &mut above, &mut PageReader::default())?;
            }
            Some(location)
        }
        slot => {
            let page = paging.page(slot);
            above.extend(paging.ancestors(slot));
            above.push(page.clone());
            if page.number() == page_number {
                moved_within(page, &mut index, leaf, &mut moved)?
            } else {
                Some(paging.location(&want(front, node, 0.0)))
            }
        }
    };
    let mut reader = PageReader::default();
    while let Some(location) = below {
        let page = read_below(model, location, &mut above, &mut reader)?;
        below = moved_within(page, &mut index, leaf, &mut moved)?;
    }
    Ok(moved)
}

/// Reads a page whose ancestors are `above`, and adds it to them.
fn read_below<'a>(
    model: &Model,
    location: PageLocation,
    above: &'a mut Vec<Page>,
    reader: &mut PageReader,
) -> Result<&'a Page, String> {
    let mut page = model.empty_page();
    let ancestors: Vec<&Page> = above.iter().collect();
    model.read_page(location, &ancestors, reader, &mut page).map_err(|error| error.to_string())?;
    above.push(page);
    Ok(&above[above.len() - 1])
}

/// Follows the kept children below record `index` of a page to that whose split moved the corner of this leaf. The child
/// page where it goes on, if it does.
fn moved_within(page: &Page, index: &mut u16, leaf: u32, moved: &mut u32) -> Result<Option<PageLocation>, String> {
    loop {
        let Some(record) = page.record(*index) else { return Err(format!("no record {index}")) };
        if leaf >= record.born_leaf {
            return Ok(None);
        }
        let Some(kept) = record.kept else {
            *moved = 0;
            return Ok(None);
        };
        *moved = kept.id;
        match kept.target {
            Target::SamePage { record } => *index = record,
            Target::ChildPage { child, record } => {
                *index = record;
                return Ok(Some(page.child_location(child.into())));
            }
        }
    }
}

fn check_usage(navigator: &Navigator) -> Result<(), String> {
    let (front, paging) = (navigator.front(), navigator.paging());
    let mut applied = vec![0; paging.usage().len()];
    for born in front.born() {
        applied[front.slot(born) as usize] += 1;
    }
    for (slot, applied) in applied.into_iter().enumerate() {
        let slot = slot as u32;
        let counted = paging.usage()[slot as usize];
        if counted != applied {
            return Err(format!("slot {slot}: {applied} splits are applied, {counted} counted"));
        }
        if paging.page_number(slot) != paging.page(slot).number() {
            return Err(format!("slot {slot} does not hold page {}", paging.page_number(slot)));
        }
    }
    paging.pool().check_usage(paging.usage())
}
