//! A page of a tree as fields to be coded.
//!
//! Whoever codes pages, to count or to encode, goes the same way as a decoder: with the decoded ancestors at hand, as a reader
//! will have them. So what is coded is what a reader decodes, by construction.
//!
//! Memory: the caches; for each page on the way from the root down one decoded page.

use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use storage::Spool;
use vdt::tree::{Normal, Root, Split, StoredTree};

use super::leaf_wedges::LeafWedges;
use super::{WriteError, WriteResources, check_values};
use crate::blocking::{BlockingError, Filled, Filler};
use crate::codec::{
    Below, Coder, Fields, Head, KIND_BELOW, KIND_HERE, Node, PageCoder, Shape, class_for, radius_class,
};
use crate::header::ModelRoot;
use crate::leaf_order::{Cache, Nodes, Subtree, Sums};
use crate::page::{NONE_32, Page, PageError, PageLocation};
use crate::wedges::RootWedges;

/// A coded page with children, as a reader will have it when it decodes these, and the pages above it.
#[derive(Debug)]
pub(super) struct Ancestor {
    pub page: Page,
    /// The trees that begin in it.
    trees: Vec<ModelRoot>,
    above: Option<Arc<Ancestor>>,
}

impl Ancestor {
    /// The number of its first child page.
    pub fn first_child(&self) -> u32 {
        self.page.child_location(0).number
    }

    /// From the root page down.
    fn path(this: &Option<Arc<Ancestor>>) -> Vec<&Ancestor> {
        let mut path: Vec<&Ancestor> =
            std::iter::successors(this.as_deref(), |ancestor| ancestor.above.as_deref()).collect();
        path.reverse();
        path
    }
}

/// Where a page is while its number in the file is not known.
#[derive(Debug, Clone)]
pub(super) struct Position {
    pub level: u32,
    /// Tells it from all others.
    pub number: u32,
    pub above: Option<Arc<Ancestor>>,
}

/// What both ways through the page tree are given.
#[derive(Debug, Clone, Copy)]
pub(super) struct Work<'a> {
    pub tree: &'a StoredTree,
    pub shape: Shape,
    pub sums: &'a Sums,
    pub root_wedges: &'a RootWedges,
    pub filler: Filler,
    pub resources: &'a WriteResources,
}

/// Looks up what pages are made of, and codes them.
pub(super) struct Gatherer<'a> {
    tree: &'a StoredTree,
    pub shape: Shape,
    pub nodes: Nodes<'a>,
    positions: Cache<&'a Spool<[f32; 3]>>,
    triangles: Cache<&'a Spool<[u32; 3]>>,
    wedges: Option<LeafWedges<'a>>,
    root_wedges: &'a RootWedges,
    coder: PageCoder,
    /// The next number for a page whose parent is coded, by whichever thread.
    next_number: &'a AtomicU32,
    /// Of the page at hand: its trees, its corners and their wedges on either side, and room to write it down.
    trees: Vec<ModelRoot>,
    sides: [Vec<([u32; 3], [u32; 3])>; 2],
    room: (Vec<(u32, u32)>, Vec<[u32; 3]>),
    pub bounds: Bounds,
}

/// The box of some positions.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub minimum: [f32; 3],
    pub maximum: [f32; 3],
}

impl Bounds {
    pub const NONE: Bounds = Bounds { minimum: [f32::INFINITY; 3], maximum: [f32::NEG_INFINITY; 3] };

    fn extend(&mut self, position: [f32; 3]) {
        self.add(&Bounds { minimum: position, maximum: position });
    }

    pub fn add(&mut self, other: &Bounds) {
        for axis in 0..3 {
            // Not `f32::min`, which may take either of 0.0 and -0.0.
            if other.minimum[axis] < self.minimum[axis] {
                self.minimum[axis] = other.minimum[axis];
            }
            if other.maximum[axis] > self.maximum[axis] {
                self.maximum[axis] = other.maximum[axis];
            }
        }
    }
}

/// What a page came to besides what was coded.
#[derive(Debug)]
pub(super) struct Gathered {
    pub triangles: u32,
    /// Wedges beyond one for each record.
    pub more_wedges: u16,
    /// The page as an ancestor of its children, where it has any.
    pub ancestor: Option<Arc<Ancestor>>,
}

impl<'a> Gatherer<'a> {
    /// One of as many as threads are to work.
    pub fn new(work: &Work<'a>, next_number: &'a AtomicU32) -> Self {
        let Work { tree, shape, sums, resources, root_wedges, .. } = *work;
        // Wedges take some of the others' shares.
        let share = |sixteenths: u64| resources.thread_share(sixteenths - u64::from(tree.attributes.is_some()));
        let wedges = tree.attributes.as_ref();
        Gatherer {
            tree,
            shape,
            nodes: Nodes::new(tree, sums, share(5)),
            positions: Cache::new(&tree.positions, share(3)),
            triangles: Cache::new(&tree.triangles, share(4)),
            wedges: wedges.map(|attributes| LeafWedges::new(attributes, resources.thread_share(1))),
            root_wedges,
            coder: PageCoder::default(),
            next_number,
            trees: Vec::new(),
            sides: Default::default(),
            room: Default::default(),
            bounds: Bounds::NONE,
        }
    }

    /// Codes a page. `children` are the subtrees at the roots of each of its child pages.
    pub fn code(
        &mut self,
        position: &Position,
        page: &Filled,
        children: &[Cow<'_, [Subtree]>],
        coder: &mut impl Coder,
    ) -> Result<Gathered, WriteError> {
        self.begin(position, page)?;
        self.gather(page, children)?;
        self.coder.code(coder, &self.shape, self.root_wedges).map_err(unlike)?;
        let coded = &self.coder.nodes.all[self.coder.nodes.first..];
        if let Some((node, subtree)) =
            coded.iter().zip(&page.records).find(|(node, subtree)| node.born != subtree.split)
        {
            let problem = format!("split {} would come back as {}", subtree.split, node.born);
            return Err(BlockingError::Tree { problem }.into());
        }
        let triangles = self.coder.fields.corners.len() as u32;
        let more_wedges = self.coder.fields.wedges.len().saturating_sub(page.records.len());
        let Ok(more_wedges) = u16::try_from(more_wedges) else {
            let problem = format!("a meta-node would have {more_wedges} wedges more than splits; ask for smaller ones");
            return Err(BlockingError::Tree { problem }.into());
        };
        let ancestor = if children.is_empty() { None } else { Some(self.ancestor(position, children)?) };
        Ok(Gathered { triangles, more_wedges, ancestor })
    }

    /// Has the nodes of all ancestors, and the roots of the page.
    fn begin(&mut self, position: &Position, page: &Filled) -> Result<(), WriteError> {
        self.trees.clear();
        for (record, subtree) in page.records[..page.root_count].iter().enumerate() {
            if subtree.is_tree {
                let index = self.tree.roots.partition_point(|root| root.start < subtree.start);
                let root = self.tree.roots[index];
                let model_root = self.tree_root(root, record as u16)?;
                self.bounds.extend(model_root.position);
                self.trees.push(model_root);
            }
        }
        let path = Ancestor::path(&position.above);
        let pages: Vec<&Page> = path.iter().map(|ancestor| &ancestor.page).collect();
        let here = &self.trees;
        let trees = |number| {
            let ancestor = path.iter().find(|ancestor| ancestor.page.number() == number);
            ancestor.map_or(here, |ancestor| &ancestor.trees).iter()
        };
        self.coder.nodes.begin(&pages, position.number, page.root_count, trees, &self.shape).map_err(unlike)?;
        self.coder.wedges.begin(&pages, self.shape.wedges);
        Ok(())
    }

    /// The root of a tree, as the root table has it but for where its page lies.
    pub fn tree_root(&mut self, root: Root, record: u16) -> Result<ModelRoot, WriteError> {
        let Split { id, switch, radius, cone, .. } = self.nodes.split(root.split)?;
        check_values(root.split, switch, radius)?;
        Ok(ModelRoot {
            start: root.start,
            end: root.end,
            position: self.position(root.start)?,
            normal: self.normal(root.start, root.normal)?,
            id,
            switch,
            radius,
            cone,
            is_inward: root.is_inward,
            record,
            page: PageLocation { number: 0, offset: 0, length: 0 },
        })
    }

    /// Fills in the fields of the page of these records.
    fn gather(&mut self, page: &Filled, children: &[Cow<'_, [Subtree]>]) -> Result<(), WriteError> {
        let records = &page.records;
        let fields = &mut self.coder.fields;
        fields.clear();
        fields.root_count = page.root_count;
        fields.children.extend(children.iter().map(|roots| roots.iter().filter(|root| !root.is_tree).count() as u16));
        // Breadth-first, so the next record that is not a root belongs to the next child that is in this page.
        let mut next_inside = page.root_count;
        // For each record which root of the page it is under, and the normal where it stands.
        let roots = &self.coder.nodes.all[self.coder.nodes.first..];
        let mut stands: Vec<(usize, [f32; 3])> =
            roots.iter().enumerate().map(|(index, root)| (index, root.normals[0])).collect();
        for (index, subtree) in records.iter().enumerate() {
            let position = self.positions.get(subtree.split)?;
            check_position(subtree.split, position)?;
            self.bounds.extend(position);
            let (root, at_kept) = stands[index];
            let Node { radius: of_root, is_inward, .. } = self.coder.nodes.all[self.coder.nodes.first + root];
            let normal = self.nodes.split(subtree.split)?.normal;
            let normal = self.normal(subtree.split, normal)?;
            let mut kinds = [0; 2];
            let children = self.nodes.children(*subtree)?.into_iter().zip([at_kept, normal.decode()]);
            for (kind, (child, normal)) in kinds.iter_mut().zip(children) {
                let Some(child) = child else { continue };
                let Split { id, switch, radius, cone, .. } = self.nodes.split(child.split)?;
                check_values(child.split, switch, radius)?;
                if records.get(next_inside).is_some_and(|record| record.split == child.split) {
                    next_inside += 1;
                    stands.push((root, normal));
                    *kind = KIND_HERE;
                } else {
                    let (size, radius) = (child.end - child.start, radius_class(radius, of_root));
                    self.coder.fields.below.push(Below { size, radius });
                    *kind = KIND_BELOW;
                }
                self.coder.fields.ids.push(id);
                self.coder.fields.cones.push(class_for(cone, normal, is_inward));
            }
            self.sides.iter_mut().for_each(Vec::clear);
            for triangle in self.nodes.triangles(subtree.split)? {
                let corners = self.triangles.get(triangle)?;
                if let Some(wrong) = corners.iter().find(|leaf| u64::from(**leaf) >= self.tree.leaf_count()) {
                    let problem = format!("a triangle with the corner {wrong}, of {} leaves", self.tree.leaf_count());
                    return Err(BlockingError::Tree { problem }.into());
                }
                let wedges = match &mut self.wedges {
                    Some(wedges) => wedges.of_corners(triangle, corners)?,
                    None => corners,
                };
                let is_born = |leaf: u32| (subtree.split..subtree.end).contains(&leaf);
                let turned = |[kept, second, third]: [u32; 3]| [kept, third, second];
                if is_born(corners[1]) {
                    self.sides[0].push((corners, wedges));
                } else {
                    self.sides[1].push((turned(corners), turned(wedges)));
                }
            }
            let fields: &mut Fields = &mut self.coder.fields;
            fields.kinds.push(kinds[0] * 3 + kinds[1]);
            fields.places.push(position);
            fields.counts.push([self.sides[0].len() as u32, self.sides[1].len() as u32]);
            fields.starts.push(fields.corners.len() as u32);
            fields.corners.extend(self.sides.iter().flatten().map(|(corners, _)| corners));
            fields.normals.push(normal.to_word());
            if let Some(wedges) = &mut self.wedges {
                fields.corner_wedges.extend(self.sides.iter().flatten().map(|(_, wedges)| wedges));
                fields.wedge_firsts.push(fields.wedges.len() as u32);
                wedges.of_leaf(subtree.split, &mut fields.wedges)?;
            }
        }
        Ok(())
    }

    /// The page that was coded last, for its children.
    fn ancestor(&mut self, position: &Position, children: &[Cow<'_, [Subtree]>]) -> Result<Arc<Ancestor>, WriteError> {
        let count = children.len() as u32;
        let head = Head {
            number: position.number,
            parent: position.above.as_ref().map_or(NONE_32, |above| above.page.number()),
            first_child: self.next_number.fetch_add(count, Ordering::Relaxed),
            children: self.coder.fields.children.iter().map(|entries| (0, *entries)).collect(),
            ..Head::default()
        };
        let is_tree =
            |child: usize, record: u16| children[child].get(usize::from(record)).is_some_and(|root| root.is_tree);
        let (places, corners) = &mut self.room;
        let mut page = Page::with_slot_bytes(self.coder.counts(&self.shape).decoded_bytes());
        self.coder.targets(&is_tree, places).map_err(unlike)?;
        self.coder.write(&head, places, &self.shape, corners, &mut page).map_err(unlike)?;
        Ok(Arc::new(Ancestor { page, trees: std::mem::take(&mut self.trees), above: position.above.clone() }))
    }

    /// The normal of a leaf: that which the file gives, where each leaf has one, else the computed one.
    fn normal(&mut self, leaf: u32, computed: Normal) -> Result<Normal, WriteError> {
        match &mut self.wedges {
            Some(wedges) if self.shape.wedges.kinds.normals && !self.shape.wedges.has_seams => {
                Ok(wedges.wedge(leaf)?.normal)
            }
            _ => Ok(computed),
        }
    }

    /// The position of a leaf.
    fn position(&mut self, leaf: u32) -> Result<[f32; 3], WriteError> {
        let position = self.positions.get(leaf)?;
        check_position(leaf, position)?;
        Ok(position)
    }
}

fn check_position(leaf: u32, position: [f32; 3]) -> Result<(), BlockingError> {
    if position.iter().all(|value| value.is_finite()) {
        return Ok(());
    }
    Err(BlockingError::Tree { problem: format!("leaf {leaf}: a coordinate is not finite") })
}

/// A tree that breaks a promise of its type shows when it is coded, if not before.
fn unlike(problem: impl Into<PageError>) -> WriteError {
    let problem: PageError = problem.into();
    BlockingError::Tree { problem: format!("it cannot be coded: {problem}") }.into()
}
