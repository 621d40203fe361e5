//! The decoded pages on the way from a root page down to one page: what decoding the next one needs (design, 4).
//!
//! A page is decoded with all its ancestors at hand. Whoever goes through the page tree parents first, or by ascending
//! leaf, needs a page together with those above it, and then never again once another page of its level was needed. So
//! one place for each level is enough, and each page is read once.
//!
//! Invariant: each page of the chain but the first is a child of the one before it.
//!
//! RAM: one page for each level of the page tree down to the deepest page read, and the largest encoded page.

use crate::codec::FieldBits;
use crate::header::ModelError;
use crate::model::{Model, PageReader};
use crate::page::{NONE_32, Page, PageLocation};

/// The pages on the way down to the page that was asked for last, and perhaps some below it.
#[derive(Debug)]
pub struct PageChain<'a> {
    model: &'a Model,
    /// One for each level, and where it was read.
    pages: Vec<(PageLocation, Page)>,
    /// How many of them are the chain; in the others there is nothing of use.
    length: usize,
    reader: PageReader,
}

impl<'a> PageChain<'a> {
    /// A chain of no pages.
    pub fn new(model: &'a Model) -> Self {
        PageChain { model, pages: Vec::new(), length: 0, reader: PageReader::default() }
    }

    /// The same, adding up what the fields of the pages take.
    pub(crate) fn measuring(model: &'a Model) -> Self {
        PageChain { reader: PageReader::measuring(), ..PageChain::new(model) }
    }

    /// What the fields of the pages read have taken, where that was asked for.
    pub(crate) fn sizes(&self) -> FieldBits {
        self.reader.sizes()
    }

    /// The page at `location`: a root page, or a child of page `parent`, which is one of the chain. It is read unless it
    /// is in the chain already.
    pub fn page(&mut self, location: PageLocation, parent: Option<u32>) -> Result<&Page, ModelError> {
        let level = match parent {
            None => 0,
            Some(parent) => match self.pages[..self.length].iter().rposition(|(at, _)| at.number == parent) {
                Some(level) => level + 1,
                None => {
                    let problem = format!("its parent, {parent}, is not on the way to it");
                    return Err(self.model.damaged_page(location.number, problem));
                }
            },
        };
        if level >= self.length || self.pages[level].0 != location {
            self.read(level, location)?;
        }
        Ok(&self.pages[level].1)
    }

    /// The page at `location`, in which a tree begins. What is missing of the way to it is read.
    pub fn page_of_tree(&mut self, location: PageLocation) -> Result<&Page, ModelError> {
        let mut parent = None;
        for above in self.model.way_to(location.number) {
            self.page(above, parent)?;
            parent = Some(above.number);
        }
        self.page(location, parent)
    }

    /// Reads a page of a level, counted from 0, the first of whose ancestors are the chain.
    fn read(&mut self, level: usize, location: PageLocation) -> Result<(), ModelError> {
        // Should the read fail, the chain ends above it.
        self.length = level;
        if self.pages.len() == level {
            let nowhere = PageLocation { number: NONE_32, offset: 0, length: 0 };
            self.pages.push((nowhere, self.model.empty_page()));
        }
        let (above, below) = self.pages.split_at_mut(level);
        let ancestors: Vec<&Page> = above.iter().map(|(_, page)| page).collect();
        let Some((at, page)) = below.first_mut() else { return Ok(()) };
        self.model.read_page(location, &ancestors, &mut self.reader, page)?;
        *at = location;
        self.length = level + 1;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::header::Blocking;
    use crate::testing::{Shape, TreePlan, model, random_tree};

    fn many_trees(blocking: Blocking) -> Model {
        let plan = TreePlan {
            seed: 5,
            leaves: 3000,
            components: 400,
            triangles: 3000,
            shape: Shape::Random,
            hub: 0,
            reach: 30,
        };
        model(&random_tree(&plan), blocking)
    }

    const DEEP: Blocking = Blocking::Forest { slot_bytes: 4096, fan_out: 2 };

    #[test]
    fn the_page_of_any_tree_is_reached() {
        for blocking in [DEEP, Blocking::Levels { levels: 3 }] {
            let model = many_trees(blocking);
            assert_eq!(model.ways().is_empty(), blocking != DEEP);
            let mut chain = PageChain::new(&model);
            let mut deepest = 0;
            // Forwards in the order of the leaves, and wildly.
            for turn in 0..2 {
                for index in 0..model.roots().len() {
                    let root = &model.roots()[index * [1, 37][turn] % model.roots().len()];
                    let page = chain.page_of_tree(root.page).unwrap();
                    assert_eq!(page.number(), root.page.number);
                    assert!(usize::from(root.record) < page.root_count());
                    let above = page.parent();
                    let way = model.way_to(root.page.number);
                    assert_eq!(way.last().map(|parent| parent.number), above);
                    deepest = deepest.max(way.len());
                }
            }
            assert_eq!(deepest + 1, if blocking == DEEP { model.header().page_levels as usize } else { 1 });
        }
    }

    #[test]
    fn a_page_is_read_below_its_ancestors_only() {
        let model = many_trees(DEEP);
        let mut chain = PageChain::new(&model);
        let root = chain.page(model.root_pages()[0], None).unwrap().clone();
        let (first, second) = (root.child_location(0), root.child_location(1));
        let child = chain.page(first, Some(0)).unwrap().clone();
        let other = chain.page(second, Some(0)).unwrap().clone();
        let below = child.child_location(0);
        let mut page = model.empty_page();
        let mut refuse = |location: PageLocation, ancestors: &[&Page]| {
            let message =
                model.read_page(location, ancestors, &mut PageReader::default(), &mut page).unwrap_err().to_string();
            assert!(message.starts_with(&format!("model.vdt: meta-node {}", location.number)), "{message}");
            assert_eq!(page.number(), NONE_32);
        };
        refuse(below, &[]);
        refuse(below, &[&child]);
        refuse(below, &[&root]);
        refuse(below, &[&root, &other]);
        refuse(below, &[&child, &root]);
        refuse(first, &[&root, &root]);
        model.read_page(below, &[&root, &child], &mut PageReader::default(), &mut page).unwrap();
        // The chain has gone on to the other child.
        assert!(chain.page(below, Some(child.number())).unwrap_err().to_string().contains("not on the way"));
        chain.page(first, Some(0)).unwrap();
        assert_eq!(chain.page(below, Some(child.number())).unwrap().number(), below.number);
    }
}
