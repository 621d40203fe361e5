//! Uniform cuts, streaming: the mesh in which exactly the splits with a switch value above an error are applied.
//!
//! No split of such a cut has to be forced: what a collapse depends on has no larger switch value, so the cut is a state of
//! the construction (design, 1).
//!
//! A leaf begins the interval of an active node just where the leaf was born by an applied split, or begins a tree. So
//! one bit for each leaf is the whole cut: the active ancestor of a leaf is the last set bit at or before it, and its
//! vertex number the rank of that bit. A triangle is active where its birth split is applied (design, 1).
//!
//! RAM: 1.5 bits for each leaf, a page for each level of the page tree, 80 bytes for each level of the binary tree for the
//! vertices, 9 bytes for each tree; for the statement, where parts have vanished, 31 bytes for each of those and a bit for
//! each vertex. I/O: each page with an applied split, or on the way to a tree with one, once for the counts, once for the
//! triangles and once for the vertices; for the statement, where parts have vanished, once more for the triangles and three
//! times for the vertices.

use crate::bits::{Bits, RankedBits};
use crate::chain::PageChain;
use crate::header::ModelError;
use crate::model::Model;
use crate::page::{ChildEntry, PageLocation, Target};
use crate::statement::{Drawn, Statement};
use crate::vanished::VanishedParts;
use crate::walk::walk;
use crate::wedges::PlacedWedge;

/// The mesh of a uniform cut.
#[derive(Debug)]
pub struct UniformCut<'a> {
    model: &'a Model,
    error: f32,
    /// The first leaves of the active nodes.
    starts: RankedBits,
    triangle_count: u64,
    trees: Trees,
}

impl<'a> UniformCut<'a> {
    /// The cut in which the splits with switch values above `error`, in mesh units, are applied. 0 gives the input mesh,
    /// [`crate::header::Header::largest_switch`] or more the roots alone.
    pub fn new(model: &'a Model, error: f32) -> Result<Self, ModelError> {
        let is_applied = |switch: f32| switch > error;
        let mut starts = Bits::new(model.header().leaf_count);
        let mut triangle_count = 0;
        let mut trees = Trees::new(model);
        model.roots().iter().for_each(|root| starts.insert(root.start));
        walk(model, error, |page, switches| {
            for (index, _) in (0..).zip(switches).filter(|(_, switch)| is_applied(**switch)) {
                let born = page.triangles(index).len() as u64;
                triangle_count += born;
                let Some(record) = page.record(index) else { continue };
                starts.insert(record.born_leaf);
                let children = [record.kept, record.born].into_iter().flatten().map(|entry| entry.switch);
                let unsplit = children.filter(|switch| !is_applied(*switch)).fold(0.0, f32::max);
                trees.add(model, record.born_leaf, unsplit, born > 0);
            }
            Ok::<_, ModelError>(())
        })?;
        Ok(UniformCut { model, error, starts: starts.ranked(), triangle_count, trees })
    }

    /// Vertices of the mesh.
    pub fn vertex_count(&self) -> u64 {
        self.starts.len().into()
    }

    /// Triangles of the mesh.
    pub fn triangle_count(&self) -> u64 {
        self.triangle_count
    }

    /// What can be said of the mesh's distance from the input.
    pub fn statement(&self) -> Result<Statement, ModelError> {
        let roots = (0..).zip(self.model.roots());
        let vanished_roots = roots.filter(|(tree, _)| !self.trees.drawn.contains(*tree)).map(|(_, root)| root);
        let mut vanished = VanishedParts::new(vanished_roots);
        if vanished.count() > 0 && self.triangle_count > 0 {
            let mut on_surface = Bits::new(self.starts.len());
            self.for_each_triangle(|corners| -> Result<(), ModelError> {
                corners.iter().for_each(|corner| on_surface.insert(*corner as u32));
                Ok(())
            })?;
            for stride in STRIDES {
                let mut number = 0;
                self.for_each_vertex(|position| -> Result<(), ModelError> {
                    if number % stride == 0 && on_surface.contains(number) {
                        vanished.pass(position);
                    }
                    number += 1;
                    Ok(())
                })?;
            }
        }
        let largest_switch = self.trees.largest_unsplit();
        let drawn = Drawn { largest_switch, is_a_state: true, vanished: &vanished };
        Ok(Statement::new(self.model.header(), drawn))
    }

    /// Bytes of RAM that this holds.
    pub fn resident_bytes(&self) -> usize {
        size_of::<Self>() + self.starts.resident_bytes() + self.trees.resident_bytes()
    }

    /// Hands every vertex's position, in mesh units relative to the model's origin, to `action`, in the order of the
    /// vertex numbers, which is that of the leaves.
    pub fn for_each_vertex<E: From<ModelError>>(
        &self,
        mut action: impl FnMut([f32; 3]) -> Result<(), E>,
    ) -> Result<(), E> {
        self.for_each_leaf(|position, _| action(position))
    }

    /// The same, with the wedges of each vertex: none where the model has no attributes.
    pub(crate) fn for_each_leaf<E: From<ModelError>>(
        &self,
        mut action: impl FnMut([f32; 3], &[PlacedWedge]) -> Result<(), E>,
    ) -> Result<(), E> {
        // Of a page's children, those by smaller leaves come before those by larger ones: none is come back to.
        let mut chain = PageChain::new(self.model);
        let mut left = self.vertex_count();
        let mut stack = Vec::new();
        for root in self.model.roots() {
            if root.switch > self.error {
                let parent = chain.page_of_tree(root.page)?.parent();
                self.expand(&mut stack, root.switch, root.page, parent, root.record);
            }
            // On top: where the root stands comes before all that is born below it.
            let wedges = self.model.appearance().map_or(&[][..], |found| found.root_wedges.of(root.start));
            stack.push(Step::Vertex(root.position, wedges.to_vec()));
            while let Some(step) = stack.pop() {
                match step {
                    Step::Vertex(position, wedges) => {
                        // A file with references that meet would otherwise be followed almost without end.
                        left = left.checked_sub(1).ok_or_else(|| self.unsound())?;
                        action(position, &wedges)?;
                    }
                    Step::Split { location, parent, record: index } => {
                        let page = chain.page(location, parent)?;
                        let record = page.record(index).ok_or_else(|| {
                            self.model.damaged_page(location.number, format!("it has no record {index}"))
                        })?;
                        let below = |entry: Option<ChildEntry>, stack: &mut Vec<Step>| {
                            let Some(entry) = entry else { return };
                            match entry.target {
                                Target::SamePage { record } => {
                                    self.expand(stack, entry.switch, location, parent, record);
                                }
                                Target::ChildPage { child, record } => {
                                    let child = page.child_location(child.into());
                                    self.expand(stack, entry.switch, child, Some(location.number), record);
                                }
                            }
                        };
                        below(record.born, &mut stack);
                        stack.push(Step::Vertex(record.position, page.wedges(index).collect()));
                        below(record.kept, &mut stack);
                    }
                }
            }
        }
        if left > 0 { Err(self.unsound().into()) } else { Ok(()) }
    }

    /// Puts the split of a node on the stack, if it is applied.
    fn expand(&self, stack: &mut Vec<Step>, switch: f32, location: PageLocation, parent: Option<u32>, record: u16) {
        if switch > self.error {
            stack.push(Step::Split { location, parent, record });
        }
    }

    fn unsound(&self) -> ModelError {
        let problem = "the records do not give each vertex once; `vdt verify` says where".into();
        ModelError::Damaged { path: self.model.path().into(), part: "file".into(), problem }
    }

    /// Hands the vertex numbers of every triangle to `action`, in the orientation of the input mesh.
    pub fn for_each_triangle<E: From<ModelError>>(
        &self,
        mut action: impl FnMut([u64; 3]) -> Result<(), E>,
    ) -> Result<(), E> {
        walk(self.model, self.error, |page, switches| {
            for (index, _) in (0..).zip(switches).filter(|(_, switch)| **switch > self.error) {
                page.triangles(index).try_for_each(|corners| action(corners.map(|leaf| self.vertex_of(leaf))))?;
            }
            Ok(())
        })
    }

    /// The vertex number of the active ancestor of a leaf.
    pub(crate) fn vertex_of(&self, leaf: u32) -> u64 {
        u64::from(self.starts.rank(leaf)).saturating_sub(1)
    }

    /// The model, and the error of the cut.
    pub(crate) fn model(&self) -> (&'a Model, f32) {
        (self.model, self.error)
    }
}

/// What a cut has of each tree.
#[derive(Debug)]
struct Trees {
    /// Those with an active triangle.
    drawn: Bits,
    /// For each, the largest switch value of the nodes that are drawn unsplit, once its root is split.
    unsplit: Vec<f32>,
    /// The tree that was looked up last: splits of one stand together.
    last: usize,
}

impl Trees {
    fn new(model: &Model) -> Self {
        let count = model.roots().len();
        Trees { drawn: Bits::new(count as u32), unsplit: vec![0.0; count], last: 0 }
    }

    /// A split is applied: the largest switch value of its children that are not split, and whether it bears triangles.
    fn add(&mut self, model: &Model, born_leaf: u32, unsplit: f32, bears_triangles: bool) {
        let roots = model.roots();
        if !roots.get(self.last).is_some_and(|root| root.start <= born_leaf && born_leaf < root.end) {
            self.last = roots.partition_point(|root| root.start <= born_leaf).saturating_sub(1);
        }
        if let Some(largest) = self.unsplit.get_mut(self.last) {
            *largest = largest.max(unsplit);
        }
        if bears_triangles {
            self.drawn.insert(self.last as u32);
        }
    }

    /// The largest switch value of a node that is drawn unsplit, of the trees that are drawn.
    fn largest_unsplit(&self) -> f32 {
        let drawn = (0..).zip(&self.unsplit).filter(|(tree, _)| self.drawn.contains(*tree));
        drawn.map(|(_, switch)| *switch).fold(0.0, f32::max)
    }

    fn resident_bytes(&self) -> usize {
        self.drawn.resident_bytes() + self.unsplit.capacity() * size_of::<f32>()
    }
}

/// One vertex of so many passes by the parts that have vanished, in turn. Vertices in the order of the leaves come nearer
/// to a part step by step, and each step is work; with some from everywhere ahead, few are left.
const STRIDES: [u32; 3] = [1024, 32, 1];

/// What is left to be done while the vertices are handed out in the order of the leaves.
enum Step {
    /// A vertex, with its wedges.
    Vertex([f32; 3], Vec<PlacedWedge>),
    /// What is born below a node whose split is applied.
    Split {
        location: PageLocation,
        /// Its parent page.
        parent: Option<u32>,
        record: u16,
    },
}

/// Buckets of a histogram over half of a switch value's bits.
const BUCKETS: usize = 1 << 16;

/// The smallest error, in mesh units, whose uniform cut has at most `triangles` triangles.
///
/// Switch values are positive, so their bits are ordered as they are: one pass over the file counts the triangles by the
/// upper half of the bits of the switch value that bears them, a second one, within the bucket that decides, by the
/// lower half. RAM: 512 KiB and what a walk takes.
pub fn error_for_triangles(model: &Model, triangles: u64) -> Result<f32, ModelError> {
    if u64::from(model.header().triangle_count) <= triangles {
        return Ok(0.0);
    }
    // Of the triangles at or above the switch value looked for, how many lie above the range looked at.
    let mut above = 0;
    let mut upper = None;
    for _ in 0..2 {
        let mut counts = vec![0_u64; BUCKETS];
        walk(model, -1.0, |page, switches| {
            for (index, switch) in (0..).zip(switches) {
                let (high, low) = (switch.to_bits() >> 16, switch.to_bits() & 0xffff);
                let bucket = match upper {
                    None => high,
                    Some(upper) if upper == high => low,
                    Some(_) => continue,
                };
                counts[bucket as usize] += page.triangles(index).len() as u64;
            }
            Ok::<_, ModelError>(())
        })?;
        // The greatest bucket that may not be drawn as a whole.
        let deciding = (0..BUCKETS).rev().find(|bucket| {
            let fits = above + counts[*bucket] <= triangles;
            if fits {
                above += counts[*bucket];
            }
            !fits
        });
        let Some(deciding) = deciding else {
            // The header promised more triangles than there are.
            return Ok(0.0);
        };
        match upper {
            None => upper = Some(deciding as u32),
            Some(upper) => return Ok(f32::from_bits(upper << 16 | deciding as u32)),
        }
    }
    Ok(0.0)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;
    use std::sync::Arc;

    use proptest::prelude::*;
    use storage::{FaultyDisk, MemoryDisk};
    use vdt::tree::{NO_SPLIT, Root, Split, Tree, length_not_below, rounded_up};

    use super::*;
    use crate::header::Blocking;
    use crate::testing::{Random, Shape, TreePlan, blockings, model, model_bytes, plans, random_tree};

    /// A uniform cut by the definition: each leaf's active ancestor, found from the root down.
    struct Expected {
        vertices: Vec<[f32; 3]>,
        triangles: Vec<[u64; 3]>,
        statement: Statement,
    }

    fn expected(tree: &Tree, error: f32) -> Expected {
        let (mut active, mut unsplit) = (vec![0; tree.leaf_count()], vec![0.0_f32; tree.leaf_count()]);
        for root in &tree.roots {
            for leaf in root.start..root.end {
                let (mut split, mut start) = (root.split, root.start);
                while split != NO_SPLIT && tree.splits[split as usize].switch > error {
                    let node = &tree.splits[split as usize];
                    (split, start) = if leaf < split { (node.kept, start) } else { (node.born, split) };
                }
                active[leaf as usize] = start;
                unsplit[leaf as usize] = tree.splits.get(split as usize).map_or(0.0, |node| node.switch);
            }
        }
        let mut starts = active.clone();
        starts.dedup();
        let number = |leaf: u32| starts.binary_search(&active[leaf as usize]).unwrap() as u64;
        let triangles = tree.triangles.corners.iter().map(|corners| corners.map(number));
        let mut triangles: Vec<_> = triangles.filter(|[a, b, c]| a != b && b != c && c != a).collect();
        triangles.sort_unstable();
        let vertices = starts.iter().map(|leaf| tree.positions[*leaf as usize]).collect();
        let statement = said(tree, &starts, &triangles, &unsplit);
        Expected { vertices, triangles, statement }
    }

    /// What is to be said of a cut: by all pairs of roots that have vanished and vertices that are drawn.
    fn said(tree: &Tree, starts: &[u32], triangles: &[[u64; 3]], unsplit: &[f32]) -> Statement {
        let drawn: BTreeSet<u32> = triangles.iter().flatten().map(|vertex| starts[*vertex as usize]).collect();
        let is_drawn = |root: &&Root| drawn.range(root.start..root.end).next().is_some();
        let (present, vanished): (Vec<&Root>, Vec<&Root>) = tree.roots.iter().partition(is_drawn);
        let switches = present.iter().flat_map(|root| &unsplit[root.start as usize..root.end as usize]);
        let error_drawn = switches.copied().fold(0.0, f32::max);
        let of_split = |root: &&Root| {
            let Split { switch, radius, .. } = tree.splits[root.split as usize];
            (f64::from(switch) * (1.0 + 2.0_f64.powi(-22)), f64::from(radius))
        };
        let reach = |root: &&Root| f64::from(rounded_up(of_split(root).0.min(of_split(root).1)));
        let diameter = |root: &&Root| of_split(root).0.min(2.0 * of_split(root).1);
        let at = |leaf: u32| tree.positions[leaf as usize].map(f64::from);
        let distance = |from: u32, to: u32| {
            let square: f64 =
                (0..3).map(|axis| (at(to)[axis] - at(from)[axis]) * (at(to)[axis] - at(from)[axis])).sum();
            square.sqrt()
        };
        let farthest = vanished.iter().map(|root| {
            let nearest = drawn.iter().map(|vertex| distance(root.start, *vertex)).fold(f64::INFINITY, f64::min);
            nearest + reach(root)
        });
        let farthest = farthest.fold(0.0, f64::max);
        let vanished_distance = farthest.is_finite().then(|| length_not_below(farthest));
        let largest_switch = tree.roots.iter().map(|root| tree.splits[root.split as usize].switch).fold(0.0, f32::max);
        Statement {
            error_stated: vanished_distance.map_or(largest_switch, |distance| distance.max(error_drawn)),
            guaranteed: vanished_distance.is_some(),
            is_two_sided: vanished_distance.is_some() && error_drawn == 0.0,
            error_drawn,
            vanished_parts: vanished.len() as u32,
            vanished_diameter: length_not_below(vanished.iter().map(diameter).fold(0.0, f64::max)),
            vanished_distance,
        }
    }

    fn check(tree: &Tree, model: &Model, error: f32) -> Result<(), TestCaseError> {
        let expected = expected(tree, error);
        let cut = UniformCut::new(model, error).unwrap();
        prop_assert_eq!(cut.vertex_count(), expected.vertices.len() as u64);
        prop_assert_eq!(cut.triangle_count(), expected.triangles.len() as u64);
        prop_assert_eq!(cut.statement().unwrap(), expected.statement);
        let mut vertices = Vec::new();
        cut.for_each_vertex(|position| {
            vertices.push(position);
            Ok::<_, ModelError>(())
        })
        .unwrap();
        prop_assert_eq!(vertices, expected.vertices);
        let mut triangles = Vec::new();
        cut.for_each_triangle(|corners| {
            triangles.push(corners);
            Ok::<_, ModelError>(())
        })
        .unwrap();
        triangles.sort_unstable();
        prop_assert_eq!(triangles, expected.triangles);
        Ok(())
    }

    fn switches(tree: &Tree) -> Vec<f32> {
        let mut switches: Vec<f32> =
            tree.splits.iter().map(|split| split.switch).filter(|switch| *switch > 0.0).collect();
        switches.sort_by(f32::total_cmp);
        switches
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(96))]

        #[test]
        fn a_uniform_cut_is_the_mesh_of_the_definition(plan in plans(700), blocking in blockings(), seed in any::<u64>()) {
            let tree = random_tree(&plan);
            let model = model(&tree, blocking);
            let switches = switches(&tree);
            let largest = switches[switches.len() - 1];
            let mut random = Random(seed);
            let some = switches[random.below(switches.len())];
            let between = largest * random.signed().abs();
            for error in [-1.0, 0.0, some, f32::from_bits(some.to_bits() - 1), between, largest, 2.0 * largest, f32::INFINITY, f32::NAN] {
                check(&tree, &model, error)?;
            }
        }

        #[test]
        fn the_error_for_a_number_of_triangles_is_the_smallest(plan in plans(700), blocking in blockings()) {
            let tree = random_tree(&plan);
            let model = model(&tree, blocking);
            let mut candidates = vec![0.0];
            candidates.extend(switches(&tree));
            let drawn = |error: f32| -> u64 {
                let splits = (0..tree.leaf_count() as u32).filter(|split| tree.splits[*split as usize].switch > error);
                splits.map(|split| tree.triangles.of(split).len() as u64).sum()
            };
            let all = tree.triangles.corners.len() as u64;
            for triangles in [0, 1, all / 3, all / 2, all.saturating_sub(1), all, all + 1, u64::MAX] {
                let expected = candidates.iter().copied().find(|error| drawn(*error) <= triangles).unwrap();
                prop_assert_eq!(error_for_triangles(&model, triangles).unwrap(), expected);
            }
        }
    }

    #[test]
    fn an_empty_model_has_an_empty_cut() {
        let model = model(&Tree::default(), Blocking::default());
        let cut = UniformCut::new(&model, 0.0).unwrap();
        assert_eq!((cut.vertex_count(), cut.triangle_count()), (0, 0));
        let said = cut.statement().unwrap();
        assert_eq!((said.error_stated, said.guaranteed, said.vanished_parts), (0.0, true, 0));
        cut.for_each_vertex(|_| -> Result<(), ModelError> { panic!("a vertex") }).unwrap();
        cut.for_each_triangle(|_| -> Result<(), ModelError> { panic!("a triangle") }).unwrap();
        assert_eq!(error_for_triangles(&model, 0).unwrap(), 0.0);
    }

    #[test]
    fn what_the_caller_cannot_take_ends_the_stream() {
        let tree = random_tree(&TreePlan {
            seed: 2,
            leaves: 500,
            components: 2,
            triangles: 900,
            shape: Shape::Random,
            hub: 0,
            reach: 40,
        });
        let model = model(&tree, Blocking::default());
        let cut = UniformCut::new(&model, 0.0).unwrap();
        let full = || ModelError::NotAModel { path: "full".into() };
        let mut room = 3;
        let mut take = || {
            room -= 1;
            if room < 0 { Err(full()) } else { Ok(()) }
        };
        assert!(cut.for_each_vertex(|_| take()).is_err());
        assert!(cut.for_each_triangle(|_| take()).is_err());
    }

    #[test]
    fn pages_are_read_once() {
        for (shape, components) in
            [(Shape::Random, 1), (Shape::Random, 3000), (Shape::Neighbours, 7), (Shape::Chain, 1)]
        {
            let tree = random_tree(&TreePlan {
                seed: 6,
                leaves: 20_000,
                components,
                triangles: 40_000,
                shape,
                hub: 0,
                reach: 60,
            });
            let (bytes, summary) = model_bytes(&tree, Blocking::Forest { slot_bytes: 8192, fan_out: 8 });
            let memory = MemoryDisk::new();
            memory.insert("model.vdt", bytes);
            let disk = FaultyDisk::new(Arc::new(memory));
            let model = Model::open(&disk, Path::new("model.vdt")).unwrap();
            let pages = u64::from(summary.pages);
            disk.fail_reads_after(pages);
            let cut = UniformCut::new(&model, 0.0).unwrap();
            disk.fail_reads_after(pages);
            cut.for_each_triangle(|_| Ok::<_, ModelError>(())).unwrap();
            disk.fail_reads_after(pages);
            cut.for_each_vertex(|_| Ok::<_, ModelError>(())).unwrap();
            // The roots alone need none.
            disk.fail_reads_after(0);
            UniformCut::new(&model, model.header().largest_switch).unwrap();
        }
    }
}
