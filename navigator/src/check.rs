//! Whether the front and the pool are well-formed (invariants 4 and 5 of the design). Slow: for tests, and for whoever
//! does not trust a model.

use metanode::model::{Model, PageReader};
use metanode::page::{Page, PageLocation, Target};

use crate::dependency::Dependency;
use crate::front::{Front, NEVER, NONE, State};
use crate::navigator::Navigator;

/// Checks, between two frames, everything that must hold; says what does not.
///
/// - the leaf intervals of the active nodes partition the leaves, and those of two children their parent's;
/// - each corner of a triangle is under its node, the three nodes are distinct, and it is once in each one's star;
/// - the triangles are those that the applied splits bear, each once; they are counted by their trees;
/// - with implicit dependency, of the collapses that moved a corner of a triangle, those that are not undone come before those
///   that are;
/// - the usage count of each place holder is the number of applied splits of its page; the pool's own counts and lists
///   fit to each other; the parent of each page that is there is there.
pub fn check(navigator: &Navigator) -> Result<(), String> {
    check_cut(navigator)?;
    if navigator.dependency() == Dependency::Implicit {
        check_lives(navigator)?;
    }
    Ok(())
}

/// All of that but for what pages below the front say, which are not read: what holds whatever the pages of a model are.
pub(crate) fn check_cut(navigator: &Navigator) -> Result<(), String> {
    check_nodes(navigator)?;
    check_stars(navigator.front())?;
    check_births(navigator)?;
    check_usage(navigator)?;
    navigator.paging().pool().check()
}

fn check_nodes(navigator: &Navigator) -> Result<(), String> {
    let front = navigator.front();
    let mut intervals = Vec::new();
    for node in front.nodes() {
        let (start, end) = front.interval(node);
        if front.is_active(node) {
            intervals.push((start, end));
            let is_leaf = front.state(node) == State::Leaf;
            if is_leaf != (end - start == 1) || is_leaf != (front.id(node) == 0) {
                return Err(format!("active node {node} with leaves {start}..{end} has id {}", front.id(node)));
            }
        } else {
            let [kept, born] = front.children(node);
            let ((kept_start, kept_end), (born_start, born_end)) = (front.interval(kept), front.interval(born));
            let both_active = front.is_active(kept) && front.is_active(born);
            let fits = kept_start == start
                && kept_end == born_start
                && born_end == end
                && [kept, born].iter().all(|child| front.parent(*child) == node && front.id(*child) < front.id(node))
                && front.moved_by(born) == front.id(node)
                && [front.id(node), front.moved_by(node)].contains(&front.moved_by(kept))
                && both_active == (front.state(node) == State::Collapsible);
            if !fits {
                return Err(format!("node {node} with leaves {start}..{end} does not fit to {kept} and {born}"));
            }
        }
        if front.parent(node) == NONE && front.moved_by(node) != NEVER {
            return Err(format!("root {node} is moved by something"));
        }
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
    if intervals.len() != front.active_count() || front.nodes().count() != front.node_count() {
        return Err(format!("{} active nodes, counted {}", intervals.len(), front.active_count()));
    }
    Ok(())
}

fn check_stars(front: &Front) -> Result<(), String> {
    let mut from_triangles = Vec::new();
    for (leaves, nodes) in front.triangles() {
        for (leaf, node) in leaves.into_iter().zip(nodes) {
            let (start, end) = front.interval(node);
            if !front.is_active(node) || leaf < start || leaf >= end {
                return Err(format!("triangle {leaves:?}: leaf {leaf} is not under node {node}"));
            }
        }
        if nodes[0] == nodes[1] || nodes[1] == nodes[2] || nodes[2] == nodes[0] {
            return Err(format!("triangle {leaves:?} has the corners {nodes:?}"));
        }
        from_triangles.extend((0..3).map(|place| (nodes[place], [nodes[(place + 1) % 3], nodes[(place + 2) % 3]])));
    }
    if from_triangles.len() != 3 * front.triangle_count() {
        return Err(format!("{} corners, {} triangles counted", from_triangles.len(), front.triangle_count()));
    }
    let active = front.nodes().filter(|node| front.is_active(*node));
    let mut from_stars: Vec<_> = active
        .flat_map(|node| front.star(node).take(from_triangles.len() + 1).map(move |others| (node, others)))
        .collect();
    from_triangles.sort_unstable();
    from_stars.sort_unstable();
    if from_triangles != from_stars {
        return Err("the stars are not those of the triangles".into());
    }
    Ok(())
}

fn check_births(navigator: &Navigator) -> Result<(), String> {
    let front = navigator.front();
    let mut born = Vec::new();
    for node in front.nodes().filter(|node| !front.is_active(*node)) {
        born.extend(navigator.paging().page(front.page_or_slot(node)).triangles(front.record(node)));
    }
    let mut drawn: Vec<_> = front.triangles().map(|(leaves, _)| leaves).collect();
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

fn check_lives(navigator: &Navigator) -> Result<(), String> {
    let front = navigator.front();
    for (leaves, nodes) in front.triangles() {
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
    if front.state(node) == State::Leaf {
        return Ok(0);
    }
    let (mut moved, mut index) = (front.id(node), front.record(node));
    let mut above = Vec::new();
    let mut below = match front.parent(node) {
        NONE => {
            let location = paging.location(front, node);
            for location in model.way_to(location.number) {
                read_below(model, location, &mut above, &mut PageReader::default())?;
            }
            Some(location)
        }
        parent => {
            let slot = front.page_or_slot(parent);
            let page = paging.page(slot);
            above.extend(paging.ancestors(slot));
            above.push(Page::clone(&page));
            if page.number() == front.page_or_slot(node) {
                moved_within(&page, &mut index, leaf, &mut moved)?
            } else {
                Some(paging.location(front, node))
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
    let mut applied = vec![0; paging.slot_count()];
    for node in front.nodes().filter(|node| !front.is_active(*node)) {
        applied[front.page_or_slot(node) as usize] += 1;
    }
    for (slot, applied) in applied.into_iter().enumerate() {
        let slot = slot as u32;
        if paging.usage(slot) != applied {
            return Err(format!("slot {slot}: {applied} splits are applied, {} counted", paging.usage(slot)));
        }
        if applied > 0 && paging.page_number(slot) != paging.page(slot).number() {
            return Err(format!("slot {slot} does not hold page {}", paging.page_number(slot)));
        }
    }
    Ok(())
}
