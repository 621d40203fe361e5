//! Wedges in leaf order, and their numbers: those of a slow reference, whatever the memory, and an error where they do not
//! belong to the log.

// A test says what it expects by unwrapping.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;

use proptest::prelude::*;
use storage::{ByteSize, Scratch, Spool};
use vdt::ingest::{CleaningCounts, StoredMesh, canonical};
use vdt::simplify::log::{Simplified, WedgeImage};
use vdt::tree::{
    Appearance, AttributeKinds, CornerPlaces, FinishError, MeshAttributes, MeshSeams, StoredTree, Wedge, WedgeNode,
    finish,
};
use vdt_tests::random_log::RandomLog;
use vdt_tests::random_mesh::{Random, any_mesh, sheet};

/// A wedge, by its canonical vertex and its place there.
type Name = (u32, u32);

/// Wedges for the vertices and triangles of a mesh, each of which bears its name, and images for them.
#[derive(Debug, Clone)]
struct Wedges {
    counts: Vec<u32>,
    corners: Vec<[u32; 3]>,
    /// Of all wedges but those of roots.
    images: BTreeMap<Name, u32>,
}

impl Wedges {
    /// One of `rarity` vertices has several; none with 0.
    fn random(log: &RandomLog, rarity: usize, seed: u64) -> Self {
        let random = &mut Random(seed);
        let mut count = || if rarity > 0 && random.below(rarity) == 0 { 2 + random.below(4) as u32 } else { 1 };
        let counts: Vec<u32> = log.mesh.positions.iter().map(|_| count()).collect();
        let triangles = log.mesh.triangles.iter();
        let corners =
            triangles.map(|corners| corners.map(|corner| random.below(counts[corner as usize] as usize) as u32));
        let corners = corners.collect();
        let mut images = BTreeMap::new();
        for collapse in &log.collapses {
            for place in 0..counts[collapse.born as usize] {
                let image = random.below(counts[collapse.kept as usize] as usize) as u32;
                images.insert((collapse.born, place), image);
            }
        }
        Wedges { counts, corners, images }
    }

    fn has_seams(&self) -> bool {
        self.counts.iter().any(|count| *count > 1)
    }

    fn attributes(&self) -> MeshAttributes {
        let (mut wedges, mut first_wedges) = (Vec::new(), Vec::new());
        for (vertex, count) in self.counts.iter().enumerate() {
            first_wedges.push(wedges.len() as u32);
            wedges.extend((0..*count).map(|place| Wedge { texture: [vertex as i32, place as i32], ..Wedge::PLAIN }));
        }
        let kinds = AttributeKinds { textures: true, ..AttributeKinds::default() };
        MeshAttributes {
            appearance: Appearance { kinds, ..Appearance::default() },
            wedges: Spool::from_vec(wedges),
            seams: self.has_seams().then(|| MeshSeams {
                first_wedges: Spool::from_vec(first_wedges),
                corners: Spool::from_vec(self.corners.iter().map(|places| CornerPlaces::of(*places)).collect()),
            }),
        }
    }

    /// The images as the engine notes them: where there is a choice.
    fn noted(&self, log: &RandomLog) -> Vec<WedgeImage> {
        let kept: BTreeMap<u32, u32> = log.collapses.iter().map(|collapse| (collapse.born, collapse.kept)).collect();
        let has_choice = |(name, _): &(&Name, &u32)| self.counts[kept[&name.0] as usize] > 1;
        let noted = self.images.iter().filter(has_choice);
        noted
            .map(|((born, wedge), image)| WedgeImage { born: *born, wedge: *wedge as u16, image: *image as u16 })
            .collect()
    }
}

fn finished(
    log: &RandomLog,
    wedges: &Wedges,
    images: Vec<WedgeImage>,
    memory: u64,
    threads: usize,
) -> Result<StoredTree, FinishError> {
    let mesh = StoredMesh { attributes: Some(wedges.attributes()), ..log.stored_mesh() };
    let simplified = Simplified { wedge_images: Spool::from_vec(images), ..log.simplified(7) };
    finish(mesh, simplified, &Scratch::in_memory(), ByteSize(memory), threads, &mut |_| ())
}

fn all<T: bytemuck::Pod>(spool: &Spool<T>) -> Vec<T> {
    let mut records = vec![T::zeroed(); spool.len() as usize];
    spool.read_at(0, &mut records).unwrap();
    records
}

fn name(wedge: &Wedge) -> Name {
    (wedge.texture[0] as u32, wedge.texture[1] as u32)
}

/// Numbers of all wedges and where they end: depth-first through their forest, those of earlier leaves first.
fn numbers(log: &RandomLog, wedges: &Wedges, leaf_of: &BTreeMap<u32, u32>) -> BTreeMap<Name, [u32; 2]> {
    let mut by_leaf: Vec<Name> = (0..wedges.counts.len() as u32)
        .flat_map(|vertex| (0..wedges.counts[vertex as usize]).map(move |place| (vertex, place)))
        .collect();
    by_leaf.sort_by_key(|(vertex, place)| (leaf_of[vertex], *place));
    let kept: BTreeMap<u32, u32> = log.collapses.iter().map(|collapse| (collapse.born, collapse.kept)).collect();
    let mut below: BTreeMap<Option<Name>, Vec<Name>> = BTreeMap::new();
    for name in by_leaf {
        let image = kept.get(&name.0).map(|kept| (*kept, wedges.images[&name]));
        below.entry(image).or_default().push(name);
    }
    let mut numbers = BTreeMap::new();
    let mut next = 0;
    let mut stack: Vec<(Name, bool)> = below[&None].iter().rev().map(|name| (*name, false)).collect();
    while let Some((name, is_done)) = stack.pop() {
        if is_done {
            numbers.entry(name).and_modify(|number: &mut [u32; 2]| number[1] = next);
            continue;
        }
        numbers.insert(name, [next, 0]);
        next += 1;
        stack.push((name, true));
        stack.extend(below.get(&Some(name)).into_iter().flatten().rev().map(|name| (*name, false)));
    }
    numbers
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn wedges_are_those_of_the_slow_reference(
        mesh in any_mesh(), deep in 0..9_usize, seed in any::<u64>(), rarity in prop::sample::select(vec![0, 1, 3, 20]),
        memory in 10..24_u32, threads in 1..3_usize,
    ) {
        let core = canonical(mesh.positions.clone(), mesh.triangles.clone(), CleaningCounts::default()).unwrap();
        let log = RandomLog::new(core, deep, seed);
        let wedges = Wedges::random(&log, rarity, seed);
        let tree = finished(&log, &wedges, wedges.noted(&log), 1 << memory, threads).unwrap();
        let attributes = tree.attributes.as_ref().unwrap();
        prop_assert_eq!(attributes.seams.is_some(), wedges.has_seams());
        let names: Vec<Name> = all(&attributes.wedges).iter().map(name).collect();
        let positions = all(&tree.positions);
        let Some(seams) = &attributes.seams else {
            prop_assert_eq!(names.len(), positions.len());
            for ((vertex, _), position) in names.iter().zip(&positions) {
                prop_assert_eq!(&log.mesh.positions[*vertex as usize], position);
            }
            return Ok(());
        };
        let (firsts, nodes, corners) = (all(&seams.first_wedges), all(&seams.nodes), all(&seams.corners));
        prop_assert_eq!(firsts.len(), positions.len());
        let mut leaf_of = BTreeMap::new();
        for (leaf, (first, position)) in firsts.iter().zip(&positions).enumerate() {
            let (vertex, _) = names[*first as usize];
            leaf_of.insert(vertex, leaf as u32);
            prop_assert_eq!(&log.mesh.positions[vertex as usize], position);
            let of_leaf = &names[*first as usize..firsts.get(leaf + 1).map_or(names.len(), |end| *end as usize)];
            let expected: Vec<Name> = (0..wedges.counts[vertex as usize]).map(|place| (vertex, place)).collect();
            prop_assert_eq!(of_leaf, expected);
        }
        let numbers = numbers(&log, &wedges, &leaf_of);
        let kept: BTreeMap<u32, u32> = log.collapses.iter().map(|collapse| (collapse.born, collapse.kept)).collect();
        for (name, node) in names.iter().zip(&nodes) {
            let image = kept.get(&name.0).map_or(0, |_| wedges.images[name]);
            let [number, end] = numbers[name];
            prop_assert_eq!(node, &WedgeNode { number, end, image }, "{:?}", name);
        }
        // Each triangle has the corners that it had, with their wedges.
        let named = |leaves: &[u32; 3], places: [u32; 3]| {
            let mut corners = [0, 1, 2].map(|corner| (names[firsts[leaves[corner] as usize] as usize].0, places[corner]));
            let first = (0..3).min_by_key(|corner| corners[*corner]).unwrap();
            corners.rotate_left(first);
            corners
        };
        let mut found: Vec<_> =
            all(&tree.triangles).iter().zip(&corners).map(|(leaves, places)| named(leaves, places.places())).collect();
        let mut expected: Vec<[Name; 3]> = log.mesh.triangles.iter().zip(&wedges.corners).map(|(corners, places)| {
            [0, 1, 2].map(|corner| (corners[corner], places[corner]))
        }).collect();
        found.sort();
        expected.sort();
        prop_assert_eq!(found, expected);
    }
}

#[test]
fn wedges_that_do_not_fit_are_refused() {
    let mesh = sheet(6, 6, 0.3, 0, 1);
    let core = canonical(mesh.positions.clone(), mesh.triangles.clone(), CleaningCounts::default()).unwrap();
    let log = RandomLog::new(core, 2, 5);
    let good = Wedges::random(&log, 2, 3);
    let noted = good.noted(&log);
    assert!(finished(&log, &good, noted.clone(), 1 << 20, 1).is_ok());
    let refused = |wedges: &Wedges, images: &[WedgeImage]| {
        finished(&log, wedges, images.to_vec(), 1 << 20, 1).err().unwrap().to_string()
    };
    let message = refused(&good, &[&noted[..], &noted[..1]].concat());
    assert!(message.contains("a second one"), "{message}");
    let message = refused(&good, &[&noted[..], &[WedgeImage { born: 49, wedge: 0, image: 0 }]].concat());
    assert!(message.contains("vertex 49: there is no such vertex"), "{message}");
    let mut far = noted.clone();
    far[0].image = 9;
    let message = refused(&good, &far);
    assert!(message.contains("fewer wedges than others turn into"), "{message}");
    let message = refused(&Wedges { counts: [&good.counts[..], &[1]].concat(), ..good.clone() }, &noted);
    assert!(message.contains("wedges"), "{message}");
}
