//! Visits the pages that a uniform cut needs, once each.
//!
//! A split is applied where its node's switch value is above the error; since switch values never rise from parent to
//! child, the applied splits of a tree hang together, and a page without one is not visited. Pages are visited parents
//! before children. Where a tree begins in a page that no applied split leads to, the pages above it are read, since it
//! cannot be decoded without them.
//!
//! The page holds its records' switch values only in the entries that lead to them, which may be in the parent page.
//! So what the walk keeps of a page is those of its entries that lead on, until the child page was visited. RAM: a page
//! for each level of the page tree ([`PageChain`]), those entries for the pages on one path, 4 bytes for each tree and one
//! for each page on the way to one. A file that `verify` would refuse gives wrong figures or an error, but no endless walk:
//! a page is entered from its parent only, and references within a page lead forward.

use crate::chain::PageChain;
use crate::header::ModelError;
use crate::model::Model;
use crate::page::{Page, PageLocation, Target};

/// What the walk knows of the node of a record.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Reached {
    /// The node's switch value, in mesh units; 0 where the parent's split is not applied.
    pub(crate) switch: f32,
    /// How many pages lead from the tree's root to the record, both counted.
    pub(crate) pages: u32,
}

/// A page that is to be visited.
struct Visit {
    location: PageLocation,
    /// Number of its parent page, `None` for a root page.
    parent: Option<u32>,
    /// Nodes that are reached, by record.
    nodes: Vec<(u16, Reached)>,
}

/// Visits each page with a split whose switch value is above `error`: all with a negative error. `visit` gets, with the
/// page, what is known of each record's node.
pub(crate) fn walk<E: From<ModelError>>(
    model: &Model,
    error: f32,
    visit: impl FnMut(&Page, &[Reached]) -> Result<(), E>,
) -> Result<(), E> {
    walk_along(&mut PageChain::new(model), model, error, visit)
}

/// The same, with a chain that reads the pages.
pub(crate) fn walk_along<E: From<ModelError>>(
    chain: &mut PageChain<'_>,
    model: &Model,
    error: f32,
    mut visit: impl FnMut(&Page, &[Reached]) -> Result<(), E>,
) -> Result<(), E> {
    let applied = |switch: f32| switch > error;
    let begins = |number: u32| {
        let trees = model.roots_in_page(number);
        trees.iter().any(|index| applied(model.roots()[*index as usize].switch))
    };
    let leads = leading_ways(model, begins);
    let is_needed = |number: u32| match model.ways().binary_search_by_key(&number, |way| way.page.number) {
        Ok(way) => leads.ways[way],
        Err(_) => leads.root_pages.get(number as usize).is_some_and(|leads| *leads),
    };
    let mut reached = Vec::new();
    for root_page in model.root_pages() {
        if !is_needed(root_page.number) {
            continue;
        }
        let mut stack = vec![Visit { location: *root_page, parent: None, nodes: Vec::new() }];
        while let Some(Visit { location, parent, mut nodes }) = stack.pop() {
            let page = chain.page(location, parent)?;
            for index in model.roots_in_page(location.number) {
                let root = &model.roots()[*index as usize];
                nodes.push((root.record, Reached { switch: root.switch, pages: 1 }));
            }
            reached.clear();
            reached.resize(page.counts().records, Reached::default());
            for (record, node) in nodes {
                match reached[..page.root_count()].get_mut(usize::from(record)) {
                    Some(place) => *place = node,
                    None => {
                        let problem = format!("record {record} is referred to, of {} roots", page.root_count());
                        return Err(model.damaged_page(location.number, problem).into());
                    }
                }
            }
            let mut below: Vec<Vec<(u16, Reached)>> = vec![Vec::new(); page.counts().children];
            for index in 0..page.counts().records {
                let node = reached[index];
                let Some(record) = page.record(index as u16).filter(|_| applied(node.switch)) else { continue };
                for entry in [record.kept, record.born].into_iter().flatten() {
                    let child = Reached { switch: entry.switch, pages: node.pages };
                    match entry.target {
                        Target::SamePage { record } => reached[usize::from(record)] = child,
                        Target::ChildPage { child: page, record } => {
                            below[usize::from(page)].push((record, Reached { pages: node.pages + 1, ..child }));
                        }
                    }
                }
            }
            if reached.iter().any(|node| applied(node.switch)) {
                visit(page, &reached)?;
            }
            let first = stack.len();
            for (child, nodes) in page.children().zip(below) {
                if is_needed(child.number) || nodes.iter().any(|(_, node)| applied(node.switch)) {
                    stack.push(Visit { location: child, parent: Some(location.number), nodes });
                }
            }
            stack[first..].reverse();
        }
    }
    Ok(())
}

/// Which pages of the model's tables are needed.
struct Leads {
    root_pages: Vec<bool>,
    ways: Vec<bool>,
}

/// The pages in which one of the trees looked for begins, by `begins`, and those that lead there.
fn leading_ways(model: &Model, begins: impl Fn(u32) -> bool) -> Leads {
    let mut leads = Leads {
        root_pages: model.root_pages().iter().map(|page| begins(page.number)).collect(),
        ways: model.ways().iter().map(|way| begins(way.page.number)).collect(),
    };
    // Parents stand before their children.
    for (index, way) in model.ways().iter().enumerate().rev() {
        if leads.ways[index] {
            match model.ways().binary_search_by_key(&way.parent, |way| way.page.number) {
                Ok(parent) => leads.ways[parent] = true,
                Err(_) => leads.root_pages[way.parent as usize] = true,
            }
        }
    }
    leads
}
