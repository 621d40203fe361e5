//! Random attributes for the trees of the tests: any wedges at any leaf, with any images, numbered by hand.

use std::sync::Arc;

use metanode::chain::PageChain;
use metanode::header::Blocking;
use metanode::model::Model;
use storage::{MemoryDisk, Spool};
use vdt::tree::{
    Appearance, AttributeKinds, CornerPlaces, NO_SPLIT, Normal, StoredTree, Tree, TreeAttributes, TreeSeams, Wedge,
    WedgeNode,
};

use super::{Random, SMALL_PAGES, disk_of_stored};

/// For each leaf its wedges with their images, for each triangle the wedges of its corners, by place.
#[derive(Debug, Clone)]
pub struct Attributes {
    kinds: AttributeKinds,
    wedges: Vec<Vec<(Wedge, u32)>>,
    corners: Vec<[u32; 3]>,
    /// Onto which leaf each is collapsed; a first leaf of a tree onto none.
    keepers: Vec<Option<u32>>,
}

fn keepers(tree: &Tree) -> Vec<Option<u32>> {
    let mut keepers = vec![None; tree.leaf_count()];
    for root in &tree.roots {
        let mut stack = vec![(root.split, root.start)];
        while let Some((split, start)) = stack.pop() {
            keepers[split as usize] = Some(start);
            let node = tree.splits[split as usize];
            stack.extend([(node.kept, start), (node.born, split)].into_iter().filter(|(child, _)| *child != NO_SPLIT));
        }
    }
    keepers
}

impl Attributes {
    /// Some of any kind: without seams, with few, or with many, and now and then many wedges at one leaf.
    pub fn random(tree: &Tree, seed: u64) -> Self {
        let seams = [0, 20, 2, 2][seed as usize % 4];
        Self::with_counts(tree, seed, |_, random| match seams {
            0 => 1,
            _ if random.below(200) == 0 => 1 + random.below(1000),
            _ if random.below(seams) == 0 => 2 + random.below(3),
            _ => 1,
        })
    }

    /// Some of any kind, with so many wedges at each leaf.
    pub fn with_counts(tree: &Tree, seed: u64, mut count_at: impl FnMut(u32, &mut Random) -> usize) -> Self {
        let random = &mut Random(seed);
        let bits = 1 + random.below(15);
        let is = |bit: usize| bits >> bit & 1 == 1;
        let kinds = AttributeKinds { normals: is(0), colours: is(1), textures: is(2), materials: is(3) };
        let keepers = keepers(tree);
        let mut wedges: Vec<Vec<(Wedge, u32)>> = Vec::new();
        for (leaf, keeper) in (0..).zip(&keepers) {
            let count = count_at(leaf, random);
            let choice = keeper.map_or(1, |keeper| wedges[keeper as usize].len());
            let mut wedge = || {
                let mut number = || random.below(6001) as i32 - 3000;
                let texture = if kinds.textures { [number(), number()] } else { [0; 2] };
                let direction = [number(), number(), number()].map(f64::from);
                Wedge {
                    material: if kinds.materials { random.below(3) as u32 } else { 0 },
                    texture,
                    colour: if kinds.colours { (random.next() as u32).to_le_bytes() } else { [255; 4] },
                    normal: if kinds.normals { Normal::encode(direction) } else { Normal::UP },
                }
            };
            let of_leaf: Vec<Wedge> = (0..count).map(|_| wedge()).collect();
            wedges.push(of_leaf.into_iter().map(|wedge| (wedge, random.below(choice) as u32)).collect());
        }
        let mut corner = |leaf: u32| random.below(wedges[leaf as usize].len()) as u32;
        let corners = tree.triangles.corners.iter().map(|leaves| leaves.map(&mut corner)).collect();
        Attributes { kinds, wedges, corners, keepers }
    }

    /// The numbers of all wedges, and where they end: depth-first through the forest of images. By leaf and place.
    fn numbers(&self) -> Vec<Vec<[u32; 2]>> {
        let mut sizes: Vec<Vec<u32>> = self.wedges.iter().map(|wedges| vec![1; wedges.len()]).collect();
        for (leaf, keeper) in self.keepers.iter().enumerate().rev() {
            for (place, (_, image)) in self.wedges[leaf].iter().enumerate() {
                if let Some(keeper) = keeper {
                    sizes[*keeper as usize][*image as usize] += sizes[leaf][place];
                }
            }
        }
        // What turns into a wedge directly is gone through by ascending leaf, and by place: behind it, and behind one another.
        let mut next_root = 0;
        let mut next: Vec<Vec<u32>> = Vec::new();
        let mut numbers = Vec::new();
        for (leaf, keeper) in self.keepers.iter().enumerate() {
            let mut of_leaf = Vec::new();
            for (place, (_, image)) in self.wedges[leaf].iter().enumerate() {
                let next = keeper.map_or(&mut next_root, |keeper| &mut next[keeper as usize][*image as usize]);
                let number = *next;
                *next += sizes[leaf][place];
                of_leaf.push([number, *next]);
            }
            next.push(of_leaf.iter().map(|[number, _]| number + 1).collect());
            numbers.push(of_leaf);
        }
        numbers
    }

    /// The tree with these attributes.
    fn stored(&self, tree: &Tree) -> StoredTree {
        let mut stored = StoredTree::from_tree(tree.clone());
        let (mut wedges, mut first_wedges, mut nodes) = (Vec::new(), Vec::new(), Vec::new());
        for (of_leaf, numbers) in self.wedges.iter().zip(self.numbers()) {
            first_wedges.push(wedges.len() as u32);
            for ((wedge, image), [number, end]) in of_leaf.iter().zip(numbers) {
                wedges.push(*wedge);
                nodes.push(WedgeNode { number, end, image: *image });
            }
        }
        let has_seams = self.wedges.iter().any(|wedges| wedges.len() > 1);
        let appearance = Appearance { kinds: self.kinds, texture_exponent: -7, ..Appearance::default() };
        let material = |name: &str| vdt::tree::Material { name: name.into(), base_colour: None, image: None };
        let appearance = Appearance { materials: vec![material("one"), material("two")], ..appearance };
        stored.attributes = Some(TreeAttributes {
            appearance,
            wedges: Spool::from_vec(wedges),
            seams: has_seams.then(|| TreeSeams {
                first_wedges: Spool::from_vec(first_wedges),
                nodes: Spool::from_vec(nodes),
                corners: Spool::from_vec(self.corners.iter().map(|places| CornerPlaces::of(*places)).collect()),
            }),
        });
        stored
    }

    /// A disk with the tree's model file, `model.vdt`.
    pub fn disk_of(&self, tree: &Tree, blocking: Blocking) -> MemoryDisk {
        disk_of_stored(&self.stored(tree), blocking)
    }

    /// The model of a tree with them, with small pages.
    pub fn model_of(&self, tree: &Tree) -> Arc<Model> {
        Arc::new(Model::open(&self.disk_of(tree, SMALL_PAGES), "model.vdt".as_ref()).unwrap())
    }
}

/// The model has them, numbered as here.
#[test]
fn the_attributes_are_sound() {
    let tree = super::grid_tree(12, 9, 3);
    for seed in 0..20 {
        let attributes = Attributes::random(&tree, seed);
        let (model, numbers) = (attributes.model_of(&tree), attributes.numbers());
        if !model.appearance().unwrap().layout.has_seams {
            continue;
        }
        let mut chain = PageChain::new(&model);
        let mut stack: Vec<_> = model.root_pages().iter().map(|page| (*page, None)).collect();
        while let Some((location, parent)) = stack.pop() {
            let page = chain.page(location, parent).unwrap();
            stack.extend(page.children().map(|child| (child, Some(location.number))));
            for index in 0..page.counts().records as u16 {
                let leaf = page.record(index).unwrap().born_leaf as usize;
                let found: Vec<_> = page.wedges(index).map(|placed| [placed.number, placed.end]).collect();
                assert_eq!(found, numbers[leaf]);
            }
        }
    }
}
