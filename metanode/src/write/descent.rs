//! The way through the page tree, page by page: filled by the blocking, visited, gone on from into its children.
//!
//! The first levels are visited breadth-first, until there are enough subtrees to be shared out to threads as jobs; each
//! of those is visited depth-first, so that what blocking looks up stays within the leaves of ever smaller subtrees. Where
//! the first levels end depends on the tree alone. Within a level pages are visited from left to right, in either part.

use std::borrow::Cow;
use std::sync::{Arc, Mutex, PoisonError};

use vdt::workers;

use crate::blocking::{BlockingError, Filled, Filler};
use crate::leaf_order::{Nodes, Subtree};

use super::WriteError;
use super::gather::{Ancestor, Position};

/// From so many pages in a level on, they are shared out.
const JOBS: usize = 8;
/// The most jobs.
const MOST_JOBS: usize = 256;

/// What a page is handed.
#[derive(Debug)]
pub(super) struct Handed {
    /// Where the page is.
    pub position: Position,
    /// The subtrees, by ascending leaf.
    pub subtrees: Vec<Subtree>,
}

/// Who goes that way.
pub(super) trait Visitor<'a> {
    /// What the blocking looks at the tree through.
    fn nodes(&mut self) -> &mut Nodes<'a>;

    /// Fills a page of a level.
    fn fill(&mut self, filler: Filler, level: u32, subtrees: Vec<Subtree>) -> Result<Filled, BlockingError>;

    /// Splits of the pages that it has visited.
    fn splits(&self) -> u64;

    /// Visits a page. `children` are the subtrees at the roots of each of its child pages. Returns the page as their
    /// ancestor, if there are any.
    fn page(
        &mut self,
        position: &Position,
        page: &Filled,
        children: &[Cow<'_, [Subtree]>],
    ) -> Result<Option<Arc<Ancestor>>, WriteError>;
}

/// Visits the first levels. Returns the jobs: neighbouring pages of the next level, from left to right.
pub(super) fn first_levels<'a>(
    visitor: &mut impl Visitor<'a>,
    filler: Filler,
    root_groups: Vec<Vec<Subtree>>,
) -> Result<Vec<Vec<Handed>>, WriteError> {
    let root_page = |(number, subtrees)| Handed { position: Position { level: 1, number, above: None }, subtrees };
    let mut level: Vec<Handed> = (0..).zip(root_groups).map(root_page).collect();
    while level.len() < JOBS && !level.is_empty() {
        let mut next = Vec::new();
        for handed in level {
            next.extend(visit(visitor, filler, handed)?);
        }
        level = next;
    }
    let count = level.len().div_ceil(MOST_JOBS).max(1);
    let mut jobs = Vec::with_capacity(level.len().div_ceil(count));
    let mut rest = level.into_iter().peekable();
    while rest.peek().is_some() {
        jobs.push(rest.by_ref().take(count).collect());
    }
    Ok(jobs)
}

/// Has the visitors do the jobs. `begin` prepares one for the job of this number; `end` takes what it has come to, of which
/// there is one for each job, in order. `progress` is told how many splits more are visited.
pub(super) fn do_jobs<'a, V: Visitor<'a> + Send, R: Send>(
    visitors: &mut [V],
    filler: Filler,
    jobs: Vec<Vec<Handed>>,
    progress: &(impl Fn(u64) + Sync),
    begin: impl Fn(&mut V, usize) + Sync,
    end: impl Fn(&mut V) -> R + Sync,
) -> Result<Vec<R>, WriteError> {
    let jobs: Vec<Mutex<Vec<Handed>>> = jobs.into_iter().map(Mutex::new).collect();
    workers::for_each(visitors, jobs.len(), |visitor, number| {
        begin(visitor, number);
        for handed in std::mem::take(&mut *jobs[number].lock().unwrap_or_else(PoisonError::into_inner)) {
            let before = visitor.splits();
            depth_first(visitor, filler, handed)?;
            progress(visitor.splits() - before);
        }
        Ok(end(visitor))
    })
}

/// Visits a page and all below it.
fn depth_first<'a>(visitor: &mut impl Visitor<'a>, filler: Filler, handed: Handed) -> Result<(), WriteError> {
    let mut stack = vec![handed];
    while let Some(handed) = stack.pop() {
        stack.extend(visit(visitor, filler, handed)?.rev());
    }
    Ok(())
}

/// Visits a page. Returns what its child pages are handed.
fn visit<'a>(
    visitor: &mut impl Visitor<'a>,
    filler: Filler,
    handed: Handed,
) -> Result<impl DoubleEndedIterator<Item = Handed>, WriteError> {
    let Handed { position, subtrees } = handed;
    let page = visitor.fill(filler, position.level, subtrees)?;
    let children = page.groups.iter().map(|group| roots(visitor.nodes(), filler, group));
    let children = children.collect::<Result<Vec<_>, _>>()?;
    let above = visitor.page(&position, &page, &children)?;
    drop(children);
    let first = above.as_ref().map_or(0, |ancestor| ancestor.first_child());
    Ok((first..)
        .zip(page.groups)
        .map(move |(number, subtrees)| Handed {
            position: Position { level: position.level + 1, number, above: above.clone() },
            subtrees,
        })
        .collect::<Vec<_>>()
        .into_iter())
}

/// The subtrees at the roots of a page that is handed these. All of them but perhaps whole trees, which may be left to its
/// child pages: only then it has to be filled to know.
fn roots<'g>(nodes: &mut Nodes<'_>, filler: Filler, group: &'g [Subtree]) -> Result<Cow<'g, [Subtree]>, BlockingError> {
    if !group.iter().any(|subtree| subtree.is_tree) {
        return Ok(Cow::Borrowed(group));
    }
    let Filled { root_count, mut records, .. } = filler.fill(nodes, group.to_vec())?;
    records.truncate(root_count);
    Ok(Cow::Owned(records))
}
