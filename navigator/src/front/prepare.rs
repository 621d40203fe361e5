//! Reading a split from its page, and making sure that it fits into the front, before anything is changed.

use metanode::page::{ChildEntry, Page, Record, Target};
use thiserror::Error;

use super::wedges::Wedges;
use super::{Corner, Front, NONE, Span, Vertex};

/// A page that cannot belong to this model: what in it does not fit to what is known from its ancestors.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("record {record}: {problem}")]
pub struct Misfit {
    /// Index of the record in its page.
    pub record: u16,
    /// What is wrong with it.
    pub problem: String,
}

/// A split, read from its page and found to fit: what [`Front::split`] applies.
#[derive(Debug, Clone, Copy)]
pub struct Prepared {
    pub(super) vertex: u32,
    pub(super) record: Record,
    pub(super) kept_page: u32,
    pub(super) born_page: u32,
    /// Slots for the wedges of the born leaf.
    pub(super) born_wedges: usize,
}

impl Prepared {
    /// The vertex whose node is to be split.
    pub fn vertex(&self) -> u32 {
        self.vertex
    }

    /// The leaf that is born.
    pub fn born_leaf(&self) -> u32 {
        self.record.born_leaf
    }
}

impl Front {
    /// Reads the split of the active node at a vertex from its page, and makes sure that it fits into the front. After it,
    /// [`Front::thirds`] are the third corners.
    pub fn prepare(&mut self, vertex: u32, page: &Page) -> Result<Prepared, Misfit> {
        let Vertex { span: Span { start, end, id, .. }, record: index, .. } = self.vertices[vertex as usize];
        let misfit = |problem: String| Misfit { record: index, problem };
        let Some(record) = page.record(index) else {
            return Err(misfit(format!("there are only {} records, and a parent refers to it", page.counts().records)));
        };
        let middle = record.born_leaf;
        if middle <= start || middle >= end {
            return Err(misfit(format!("born leaf {middle} does not split the leaves {start}..{end}")));
        }
        for (entry, from, to) in [(record.kept, start, middle), (record.born, middle, end)] {
            let fits = match entry {
                Some(entry) => to - from > 1 && entry.id > 0 && entry.id < id,
                None => to - from == 1,
            };
            if !fits {
                return Err(misfit(format!("the child with the leaves {from}..{to} cannot be of node {id}")));
            }
        }
        self.thirds.clear();
        for corners in page.triangles(index) {
            let [first, second, third] = corners;
            let under_born = |leaf: u32| middle <= leaf && leaf < end;
            let outside = |leaf: u32| leaf < start || leaf >= end;
            let fits = start <= first && first < middle;
            let other = if fits && under_born(second) && outside(third) {
                third
            } else if fits && under_born(third) && outside(second) {
                second
            } else {
                return Err(misfit(format!(
                    "the triangle of the leaves {corners:?} is not born where {start}..{end} splits at {middle}"
                )));
            };
            if other >= self.leaf_count || self.thirds.len() == self.thirds.capacity() {
                return Err(misfit(format!("a triangle of the leaves {corners:?} cannot be")));
            }
            self.thirds.push(Corner { vertex: self.vertex_of(other, vertex), leaf: other });
        }
        let page_of = |entry: Option<ChildEntry>| match entry.map(|entry| entry.target) {
            None => NONE,
            Some(Target::SamePage { .. }) => page.number(),
            Some(Target::ChildPage { child, .. }) => page.child_number(child),
        };
        let born_wedges = match self.wedges.as_ref().and_then(Wedges::seams) {
            Some(seams) => self.wedges_that_fit(seams, vertex, middle, page).map_err(misfit)?,
            None => 0,
        };
        let (kept_page, born_page) = (page_of(record.kept), page_of(record.born));
        Ok(Prepared { vertex, record, kept_page, born_page, born_wedges })
    }

    /// The third corners of the triangles that the split last prepared bears.
    pub fn thirds(&self) -> &[Corner] {
        &self.thirds
    }
}
