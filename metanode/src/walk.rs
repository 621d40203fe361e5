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

/// A page that is to be visited.
struct Visit {
    location: PageLocation,
    /// Number of its parent page, `None` for a root page.
    parent: Option<u32>,
    /// The switch values of nodes that are reached, by record.
    nodes: Vec<(u16, f32)>,
}

/// Visits each page with a split whose switch value is above `error`: all with a negative error. `visit` gets, with the
/// page, the switch value of each record's node, in mesh units; 0 where its parent's split is not applied.
pub(crate) fn walk<E: From<ModelError>>(
    model: &Model,
    error: f32,
    visit: impl FnMut(&Page, &[f32]) -> Result<(), E>,
) -> Result<(), E> {
    walk_along(&mut PageChain::new(model), model, error, visit)
}

/// The same, with a chain that reads the pages.
pub(crate) fn walk_along<E: From<ModelError>>(
    chain: &mut PageChain<'_>,
    model: &Model,
    error: f32,
    mut visit: impl FnMut(&Page, &[f32]) -> Result<(), E>,
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
    let mut switches = Vec::new();
    for root_page in model.root_pages() {
        if !is_needed(root_page.number) {
            continue;
        }
        let mut stack = vec![Visit { location: *root_page, parent: None, nodes: Vec::new() }];
        while let Some(Visit { location, parent, mut nodes }) = stack.pop() {
            let page = chain.page(location, parent)?;
            for index in model.roots_in_page(location.number) {
                let root = &model.roots()[*index as usize];
                nodes.push((root.record, root.switch));
            }
            switches.clear();
            switches.resize(page.counts().records, 0.0);
            for (record, switch) in nodes {
                match switches[..page.root_count()].get_mut(usize::from(record)) {
                    Some(place) => *place = switch,
                    None => {
                        let problem = format!("record {record} is referred to, of {} roots", page.root_count());
                        return Err(model.damaged_page(location.number, problem).into());
                    }
                }
            }
            let mut below: Vec<Vec<(u16, f32)>> = vec![Vec::new(); page.counts().children];
            for index in 0..page.counts().records {
                let Some(record) = page.record(index as u16).filter(|_| applied(switches[index])) else { continue };
                for entry in [record.kept, record.born].into_iter().flatten() {
                    match entry.target {
                        Target::SamePage { record } => switches[usize::from(record)] = entry.switch,
                        Target::ChildPage { child, record } => below[usize::from(child)].push((record, entry.switch)),
                    }
                }
            }
            if switches.iter().any(|switch| applied(*switch)) {
                visit(page, &switches)?;
            }
            let first = stack.len();
            for (child, nodes) in page.children().zip(below) {
                if is_needed(child.number) || nodes.iter().any(|(_, switch)| applied(*switch)) {
                    stack.push(Visit { location: child, parent: Some(location.number), nodes });
                }
            }
            stack[first..].reverse();
        }
    }
    Ok(())
}

/// Visits the pages with these numbers, ascending, and those that lead to them; each page has its parent among them, but for those
/// with no node whose parent's split is in another page.
pub(crate) fn walk_pages<E: From<ModelError>>(
    model: &Model,
    numbers: &[u32],
    mut visit: impl FnMut(&Page) -> Result<(), E>,
) -> Result<(), E> {
    let is_wanted = |number: u32| numbers.binary_search(&number).is_ok();
    let leads = leading_ways(model, |number| is_wanted(number) && !model.roots_in_page(number).is_empty());
    let is_needed = |number: u32| {
        let way = model.ways().binary_search_by_key(&number, |way| way.page.number);
        let leads = way.map_or_else(|_| leads.root_pages.get(number as usize).copied(), |way| Some(leads.ways[way]));
        is_wanted(number) || leads == Some(true)
    };
    let mut chain = PageChain::new(model);
    let mut stack: Vec<(PageLocation, Option<u32>)> =
        model.root_pages().iter().rev().filter(|page| is_needed(page.number)).map(|page| (*page, None)).collect();
    while let Some((location, parent)) = stack.pop() {
        let page = chain.page(location, parent)?;
        visit(page)?;
        let first = stack.len();
        let children = page.children().filter(|child| is_needed(child.number));
        stack.extend(children.map(|child| (child, Some(location.number))));
        stack[first..].reverse();
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
