//! Visits the pages that a uniform cut needs, once each.
//!
//! A split is applied where its node's switch value is above the error; since switch values never rise from parent to
//! child, the applied splits hang together, and a page without one is not read. Pages are visited parents before
//! children; a tree whose root lies in a page that no applied split leads to is entered at that page.
//!
//! The page holds its records' switch values only in the entries that lead to them, which may be in the parent page.
//! So what the walk keeps of a page is those of its entries that lead on, until the child page was visited. RAM: one
//! page, those entries for the pages on one path, and 5 bytes for each tree. A file that `verify` would refuse gives
//! wrong figures or an error, but no endless walk: a page is entered from its parent only, and references within a page
//! lead forward.

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
    /// The page whose entries lead there, `None` where only trees begin there.
    parent: Option<u32>,
    /// Nodes that are reached, by record.
    nodes: Vec<(u16, Reached)>,
}

/// Visits each page with a split whose switch value is above `error`: all with a negative error. `visit` gets, with the
/// page, what is known of each record's node.
pub(crate) fn walk<E: From<ModelError>>(
    model: &Model,
    error: f32,
    mut visit: impl FnMut(&Page, &[Reached]) -> Result<(), E>,
) -> Result<(), E> {
    let applied = |switch: f32| switch > error;
    let roots_by_page = model.roots_by_page();
    let mut roots_done = vec![false; model.roots().len()];
    let mut page = model.empty_page();
    let mut staging = Vec::new();
    let mut reached = Vec::new();
    for first in &roots_by_page {
        let root = &model.roots()[*first as usize];
        // Pages of smaller numbers come first, and with them all that could lead to this one.
        if roots_done[*first as usize] || !applied(root.switch) {
            continue;
        }
        let mut stack = vec![Visit { location: root.page, parent: None, nodes: Vec::new() }];
        while let Some(Visit { location, parent, mut nodes }) = stack.pop() {
            model.read_page(location, &mut staging, &mut page)?;
            if parent.is_some() && page.parent() != parent {
                let problem = format!("its parent is given as {:?}", page.parent());
                return Err(model.damaged_page(location.number, problem).into());
            }
            for index in model.roots_in_page(&roots_by_page, location.number) {
                let root = &model.roots()[*index as usize];
                roots_done[*index as usize] = true;
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
            visit(&page, &reached)?;
            let first = stack.len();
            for (child, nodes) in page.children().zip(below) {
                let trees = model.roots_in_page(&roots_by_page, child.number);
                let begins = trees.iter().any(|index| applied(model.roots()[*index as usize].switch));
                if begins || nodes.iter().any(|(_, node)| applied(node.switch)) {
                    stack.push(Visit { location: child, parent: Some(location.number), nodes });
                }
            }
            stack[first..].reverse();
        }
    }
    Ok(())
}
