//! Models with attributes of every kind, there and back: random trees with random wedges, numbered by hand.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use proptest::prelude::*;
use storage::{ByteSize, Disk, MemoryDisk, Scratch, Spool};
use vdt::tree::{
    Appearance, AttributeKinds, CornerPlaces, Image, ImageSource, Material, NO_SPLIT, Normal, StoredTree, Tree,
    TreeAttributes, TreeSeams, Wedge, WedgeNode,
};

use crate::cut::UniformCut;
use crate::cut_wedges::CutWedges;
use crate::drawn_mesh::DrawnMesh;
use crate::header::{Blocking, ModelError, ROOT_WORDS};
use crate::model::Model;
use crate::testing::{Random, TreePlan, all_pages, blockings, options, plans, random_tree, read_back};
use crate::wedges::PlacedWedge;
use crate::write::{WriteResources, write_model};

/// Attributes of a tree: for each leaf its wedges with their images, for each triangle the wedges of its corners.
#[derive(Debug, Clone)]
struct Attributes {
    appearance: Appearance,
    wedges: Vec<Vec<(Wedge, u32)>>,
    corners: Vec<[u32; 3]>,
}

/// Onto which leaf each is collapsed; a first leaf of a tree onto none.
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
    fn random(tree: &Tree, seed: u64) -> Self {
        let random = &mut Random(seed);
        let bits = 1 + random.below(15);
        let is = |bit: usize| bits >> bit & 1 == 1;
        let kinds = AttributeKinds { normals: is(0), colours: is(1), textures: is(2), materials: is(3) };
        // No seams, few, or many; now and then many wedges at one leaf.
        let seams = [0, 0, 20, 2][random.below(4)];
        let is_constant = random.below(4) == 0;
        let keepers = keepers(tree);
        let mut wedges: Vec<Vec<(Wedge, u32)>> = Vec::new();
        for keeper in &keepers {
            let count = match seams {
                0 => 1,
                _ if random.below(200) == 0 => 1 + random.below(1000),
                _ if random.below(seams) == 0 => 2 + random.below(3),
                _ => 1,
            };
            let choice = keeper.map_or(1, |keeper| wedges[keeper as usize].len());
            let mut wedge = || {
                let far = [3, 3000, 1 << 23][random.below(3)];
                let mut number = || random.below(2 * far + 1) as i32 - far as i32;
                let texture = if kinds.textures { [number(), number()] } else { [0; 2] };
                let bytes = (random.next() as u32).to_le_bytes();
                let constant = if is_constant { [10, 20, 30, 255] } else { bytes };
                Wedge {
                    material: if kinds.materials { random.below(4) as u32 } else { 0 },
                    texture,
                    colour: if kinds.colours { constant } else { [255; 4] },
                    normal: match kinds.normals {
                        true => Normal::encode([(); 3].map(|()| f64::from(random.signed()))),
                        false => Normal::UP,
                    },
                }
            };
            let all: Vec<Wedge> = (0..count).map(|_| wedge()).collect();
            wedges.push(all.into_iter().map(|wedge| (wedge, random.below(choice) as u32)).collect());
        }
        let corner = |leaf: &u32, random: &mut Random| random.below(wedges[*leaf as usize].len()) as u32;
        let corners = tree.triangles.corners.iter().map(|[a, b, c]| [a, b, c].map(|leaf| corner(leaf, random)));
        let corners = corners.collect();
        let image = |name: &str, source| Image { name: name.into(), source };
        let appearance = Appearance {
            kinds,
            texture_exponent: -12,
            materials: vec![
                Material { name: "plain".into(), base_colour: Some([0.5, 0.25, 1.0, 1.0]), image: None },
                Material { name: String::new(), base_colour: None, image: Some(0) },
                Material { name: "π".into(), base_colour: None, image: Some(1) },
            ],
            images: vec![
                image("skin.png", ImageSource::Bytes((0..70_000).map(|byte| (byte % 251) as u8).collect())),
                image("gone.png", ImageSource::Missing),
            ],
        };
        Attributes { appearance, wedges, corners }
    }

    fn has_seams(&self) -> bool {
        self.wedges.iter().any(|wedges| wedges.len() > 1)
    }

    /// Numbers of all wedges, and where they end, by leaf and place: depth-first through the forest of images.
    fn numbers(&self, tree: &Tree) -> Vec<Vec<[u32; 2]>> {
        let keepers = keepers(tree);
        let mut numbers: Vec<Vec<[u32; 2]>> =
            self.wedges.iter().map(|wedges| vec![[u32::MAX; 2]; wedges.len()]).collect();
        let mut children: HashMap<(usize, usize), Vec<(usize, usize)>> = HashMap::new();
        let mut roots = Vec::new();
        for (leaf, wedges) in self.wedges.iter().enumerate() {
            for (place, (_, image)) in wedges.iter().enumerate() {
                match keepers[leaf] {
                    None => roots.push((leaf, place)),
                    Some(keeper) => {
                        children.entry((keeper as usize, *image as usize)).or_default().push((leaf, place));
                    }
                }
            }
        }
        let mut next = 0;
        // Each wedge is met twice: before and behind those that turn into it.
        let mut stack: Vec<((usize, usize), bool)> = roots.into_iter().rev().map(|wedge| (wedge, true)).collect();
        while let Some((wedge, is_first)) = stack.pop() {
            let place = &mut numbers[wedge.0][wedge.1];
            if is_first {
                place[0] = next;
                next += 1;
                stack.push((wedge, false));
                let below = children.get(&wedge).into_iter().flatten().rev();
                stack.extend(below.map(|wedge| (*wedge, true)));
            } else {
                place[1] = next;
            }
        }
        numbers
    }

    fn stored(&self, tree: &Tree) -> StoredTree {
        let mut stored = StoredTree::from_tree(tree.clone());
        let numbers = self.numbers(tree);
        let (mut wedges, mut first_wedges, mut nodes) = (Vec::new(), Vec::new(), Vec::new());
        for (of_leaf, numbers) in self.wedges.iter().zip(&numbers) {
            first_wedges.push(wedges.len() as u32);
            for ((wedge, image), [number, end]) in of_leaf.iter().zip(numbers) {
                wedges.push(*wedge);
                nodes.push(WedgeNode { number: *number, end: *end, image: *image });
            }
        }
        stored.attributes = Some(TreeAttributes {
            appearance: self.appearance.clone(),
            wedges: Spool::from_vec(wedges),
            seams: self.has_seams().then(|| TreeSeams {
                first_wedges: Spool::from_vec(first_wedges),
                nodes: Spool::from_vec(nodes),
                corners: Spool::from_vec(self.corners.iter().map(|places| CornerPlaces::of(*places)).collect()),
            }),
        });
        stored
    }

    /// Writes a model, in memory with all in RAM or with hardly any.
    fn written(&self, tree: &Tree, blocking: Blocking, memory: u64, threads: usize) -> Vec<u8> {
        let disk = MemoryDisk::new();
        let path = Path::new("model.vdt");
        let shared: Arc<dyn Disk> = Arc::new(disk.clone());
        let (scratch, _) = Scratch::open(shared.clone(), Path::new("scratch"), "test").unwrap();
        let resources = WriteResources { scratch, memory: ByteSize(memory), threads };
        write_model(shared, path, &self.stored(tree), &options(blocking), &resources, &mut |_| ()).unwrap();
        disk.bytes(path).unwrap()
    }

    /// Whether a model has these attributes, and the tree.
    fn check(&self, tree: &Tree, model: &Model) {
        let kinds = self.appearance.kinds;
        let has_seams = self.has_seams();
        let found = model.appearance().unwrap();
        assert_eq!((found.layout.kinds, found.layout.has_seams), (kinds, has_seams));
        assert_eq!(found.wedge_count as usize, self.wedges.iter().map(Vec::len).sum::<usize>());
        assert_eq!(found.appearance.materials, self.appearance.materials);
        assert_eq!(found.appearance.texture_exponent, self.appearance.texture_exponent);
        let numbers = if has_seams {
            self.numbers(tree)
        } else {
            (0..tree.leaf_count() as u32).map(|leaf| vec![[leaf, leaf + 1]]).collect()
        };
        let expected = |leaf: u32| -> Vec<PlacedWedge> {
            let of_leaf = self.wedges[leaf as usize].iter().zip(&numbers[leaf as usize]);
            of_leaf
                .map(|((wedge, _), [number, end])| PlacedWedge { wedge: *wedge, number: *number, end: *end })
                .collect()
        };
        for root in model.roots() {
            assert_eq!(found.root_wedges.of(root.start), expected(root.start));
        }
        let mut born: Vec<Vec<[u32; 3]>> = vec![Vec::new(); tree.leaf_count()];
        for (_, page) in all_pages(model) {
            for index in 0..page.counts().records as u16 {
                let leaf = page.record(index).unwrap().born_leaf;
                assert_eq!(page.wedges(index).collect::<Vec<_>>(), expected(leaf), "leaf {leaf}");
                born[leaf as usize] = page.corner_wedges(index).collect();
            }
        }
        let mut triangles = tree.triangles.corners.iter().zip(&self.corners);
        for (leaf, born) in born.iter().enumerate() {
            let count = tree.triangles.of(leaf as u32).len();
            let here = triangles.by_ref().take(count);
            let numbers = here.map(|(leaves, places)| {
                [0, 1, 2].map(|corner: usize| numbers[leaves[corner] as usize][places[corner] as usize][0])
            });
            let expected: Vec<[u32; 3]> = numbers.filter(|_| has_seams).collect();
            assert_eq!(born, &expected, "split {leaf}");
        }
        // The tree itself, with the given normals in place of the computed ones.
        let mut given = tree.clone();
        if kinds.normals && !has_seams {
            let normal = |leaf: u32| self.wedges[leaf as usize][0].0.normal;
            (0..).zip(&mut given.splits).for_each(|(leaf, split)| split.normal = normal(leaf));
            for root in &mut given.roots {
                root.normal = normal(root.start);
                given.splits[root.start as usize] = tree.splits[root.start as usize];
            }
        }
        if !kinds.normals || has_seams {
            assert_eq!(read_back(model).compare(&given), Ok(()));
        }
    }
}

fn open(bytes: &[u8]) -> Result<Model, ModelError> {
    crate::testing::open_bytes(bytes)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(160))]

    #[test]
    fn every_wedge_comes_back_as_it_was(
        plan in plans(1500), blocking in blockings(), seed: u64, memory in prop::sample::select(vec![0_u64, 1 << 40]),
        threads in 1_usize..3,
    ) {
        let tree = random_tree(&TreePlan { hub: plan.hub.min(200), ..plan });
        let attributes = Attributes::random(&tree, seed);
        let bytes = attributes.written(&tree, blocking, memory, threads);
        prop_assert!(bytes == attributes.written(&tree, blocking, 1 << 40, 1));
        let model = open(&bytes).unwrap();
        attributes.check(&tree, &model);
        let found = crate::statistics(&model).unwrap();
        prop_assert_eq!(found.file.total(), bytes.len() as u64);
        let decoded: usize = all_pages(&model).iter().map(|(_, page)| page.counts().decoded_bytes()).sum();
        prop_assert_eq!(found.decoded.total(), (decoded + tree.roots.len() * ROOT_WORDS * 4) as u64);
        crate::verify(&model, &mut |_| ()).unwrap();
    }
}

/// A corner as it is drawn: where, and its wedge.
type DrawnCorner = ([u32; 3], Wedge);

impl Attributes {
    /// The triangles of the cut of an error, by the images step by step.
    fn drawn(&self, tree: &Tree, error: f32) -> Vec<[DrawnCorner; 3]> {
        let keepers = keepers(tree);
        let is_active = |leaf: usize| keepers[leaf].is_none() || tree.splits[leaf].switch > error;
        let mut drawn = Vec::new();
        let mut triangle = 0;
        for split in 0..tree.leaf_count() {
            for leaves in tree.triangles.of(split as u32) {
                let places = self.corners[triangle];
                triangle += 1;
                if tree.splits[split].switch <= error {
                    continue;
                }
                drawn.push([0, 1, 2].map(|corner: usize| {
                    let (mut leaf, mut place) = (leaves[corner] as usize, places[corner] as usize);
                    while !is_active(leaf) {
                        place = self.wedges[leaf][place].1 as usize;
                        leaf = keepers[leaf].unwrap() as usize;
                    }
                    (tree.positions[leaf].map(f32::to_bits), self.wedges[leaf][place].0)
                }));
            }
        }
        drawn
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn corners_of_a_cut_have_the_images_of_their_wedges(plan in plans(800), blocking in blockings(), seed: u64) {
        let tree = random_tree(&TreePlan { hub: 0, ..plan });
        let attributes = Attributes::random(&tree, seed);
        let model = open(&attributes.written(&tree, blocking, 1 << 40, 1)).unwrap();
        let mut errors: Vec<f32> = tree.splits.iter().map(|split| split.switch).filter(|switch| *switch > 0.0).collect();
        errors.sort_by(f32::total_cmp);
        let errors = [0.0, errors[errors.len() / 4], errors[errors.len() / 2], errors[errors.len() * 9 / 10], f32::MAX];
        for error in errors {
            let cut = UniformCut::new(&model, error).unwrap();
            let wedges = CutWedges::of(&cut).unwrap().unwrap();
            let mut vertices: Vec<DrawnCorner> = Vec::new();
            wedges.for_each_vertex(|position, wedge| -> Result<(), ModelError> {
                vertices.push((position.map(f32::to_bits), *wedge));
                Ok(())
            }).unwrap();
            prop_assert_eq!(vertices.len() as u64, wedges.vertex_count());
            let mut found = Vec::new();
            let mut used = vec![false; vertices.len()];
            wedges.for_each_triangle(|corners, material| -> Result<(), ModelError> {
                    assert_eq!(material, vertices[corners[0] as usize].1.material);
                corners.iter().for_each(|corner| used[*corner as usize] = true);
                found.push(corners.map(|corner| vertices[corner as usize]));
                Ok(())
            }).unwrap();
            prop_assert!(used[cut.vertex_count() as usize..].iter().all(|used| *used));
            let mut expected = attributes.drawn(&tree, error);
            let key = |corners: &[DrawnCorner; 3]| corners.map(|(position, wedge)| (position, wedge.order()));
            found.sort_by_key(key);
            expected.sort_by_key(key);
            prop_assert_eq!(&found, &expected);
            // The same cut as the splits that are applied.
            let mut applied = (Vec::new(), Vec::new());
            for (location, page) in all_pages(&model) {
                for record in (0..page.counts().records as u16).filter_map(|index| page.record(index)) {
                    if tree.splits[record.born_leaf as usize].switch > error {
                        applied.0.push(record.born_leaf);
                        applied.1.push(location.number);
                    }
                }
            }
            let drawn = DrawnMesh::of(&model, applied.0, applied.1).unwrap();
            let corner = |vertex: u32| {
                let (position, wedge) = drawn.vertices[vertex as usize];
                (position.map(f32::to_bits), wedge)
            };
            let mut found: Vec<_> = drawn.triangles.iter().map(|(corners, _)| corners.map(corner)).collect();
            found.sort_by_key(key);
            prop_assert_eq!(found, expected);
        }
    }
}

fn small(seed: u64) -> (Tree, Attributes) {
    let plan = TreePlan {
        seed,
        leaves: 300,
        components: 2,
        triangles: 600,
        shape: crate::testing::Shape::Neighbours,
        hub: 0,
        reach: 30,
    };
    let tree = random_tree(&plan);
    let attributes = Attributes::random(&tree, seed);
    (tree, attributes)
}

const SMALL: Blocking = Blocking::Forest { slot_bytes: 4096, fan_out: 3 };

/// A small model with random attributes.
pub(crate) fn some_model(seed: u64) -> Model {
    let (tree, attributes) = small(seed);
    open(&attributes.written(&tree, SMALL, 1 << 20, 1)).unwrap()
}

#[test]
fn images_travel_inside_the_model() {
    let (tree, attributes) = small(3);
    let bytes = attributes.written(&tree, SMALL, 1 << 40, 1);
    let model = open(&bytes).unwrap();
    let images = &model.appearance().unwrap().appearance.images;
    assert_eq!(images.iter().map(|image| image.name.as_str()).collect::<Vec<_>>(), ["skin.png", "gone.png"]);
    let mut found = Vec::new();
    let mut take = |chunk: &[u8]| -> Result<(), storage::StorageError> {
        found.extend(chunk);
        Ok(())
    };
    assert!(model.image(0, &mut take).unwrap());
    assert!(!model.image(1, &mut take).unwrap() && !model.image(2, &mut take).unwrap());
    assert_eq!(ImageSource::Bytes(found), attributes.appearance.images[0].source);
    assert_eq!(images[1].source, ImageSource::Missing);
    let mut changed = bytes;
    changed[model.header().pages_offset as usize - 1] ^= 1;
    let message = crate::verify(&open(&changed).unwrap(), &mut |_| ()).unwrap_err().to_string();
    assert!(message.contains("image 0: the checksum does not match"), "{message}");
}

/// Every byte of the section, and every word with its checksum put right: refused, or a model that still decodes within bounds.
#[test]
fn a_damaged_appearance_is_refused_or_harmless() {
    for seed in [3, 4, 9] {
        let (tree, attributes) = small(seed);
        let bytes = attributes.written(&tree, SMALL, 1 << 40, 1);
        let model = open(&bytes).unwrap();
        let start = model.header().after_tables() as usize;
        let end = start + model.header().appearance_bytes as usize;
        for at in start..end {
            let mut changed = bytes.clone();
            changed[at] ^= 0x41;
            let message = open(&changed).unwrap_err().to_string();
            assert!(message.contains("appearance: the checksum"), "{message}");
            let checksum = crc32fast::hash(&changed[start..end - 4]);
            changed[end - 4..end].copy_from_slice(&checksum.to_le_bytes());
            if let Ok(model) = open(&changed) {
                let _ = crate::verify(&model, &mut |_| ());
            }
        }
    }
}

/// Neither a base colour that a material does not have nor the checksum of an image that is missing can hide anything.
#[test]
fn what_says_nothing_is_zero() {
    let (tree, attributes) = small(3);
    let bytes = attributes.written(&tree, SMALL, 1 << 40, 1);
    let model = open(&bytes).unwrap();
    let start = model.header().after_tables() as usize;
    let end = start + model.header().appearance_bytes as usize;
    let behind = |pattern: &[u8]| {
        let place = bytes[start..end].windows(pattern.len()).position(|found| found == pattern).unwrap();
        start + place + pattern.len()
    };
    for at in [behind("π\0\0\0\0".as_bytes()), behind(b"gone.png\xff\xff\xff\xff\xff\xff\xff\xff")] {
        let mut changed = bytes.clone();
        assert_eq!(changed[at..at + 4], [0; 4]);
        changed[at] = 1;
        let checksum = crc32fast::hash(&changed[start..end - 4]);
        changed[end - 4..end].copy_from_slice(&checksum.to_le_bytes());
        let message = open(&changed).unwrap_err().to_string();
        assert!(message.contains("a field holds what it cannot hold"), "{message}");
    }
}

#[test]
fn a_changed_byte_of_a_page_with_wedges_does_no_harm_without_its_checksum() {
    let mut came_through = 0;
    for seed in 0..24 {
        let (tree, attributes) = small(seed);
        let bytes = attributes.written(&tree, SMALL, 1 << 40, 1);
        let model = open(&bytes).unwrap();
        let pages = all_pages(&model);
        let random = &mut Random(seed);
        for _ in 0..200 {
            let location = pages[random.below(pages.len())].0;
            let range = location.offset as usize..location.offset as usize + location.length as usize;
            let mut changed = bytes.clone();
            let at = range.start + 24 + random.below(range.len() - 28);
            changed[at] ^= 1 + random.below(255) as u8;
            let checksum = crc32fast::hash(&changed[range.start..range.end - 4]);
            changed[range.end - 4..range.end].copy_from_slice(&checksum.to_le_bytes());
            came_through += u32::from(crate::verify(&open(&changed).unwrap(), &mut |_| ()).is_ok());
        }
    }
    assert!(came_through > 0);
}
