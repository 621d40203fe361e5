//! A tree with random attributes: each leaf has one wedge or several, which turn into any of those of the leaf onto which it is
//! collapsed, and each corner has any of those of its leaf.
//!
//! Their numbers come from the definition: wedges sorted by the way that leads to each from a root of the forest of wedges.

use std::collections::BTreeMap;

use storage::Spool;
use vdt::tree::{
    Appearance, AttributeKinds, CornerPlaces, Image, ImageSource, Material, NO_SPLIT, Normal, StoredTree, Tree,
    TreeAttributes, TreeSeams, Wedge, WedgeNode,
};

use crate::random_mesh::Random;

/// What attributes are to be like.
#[derive(Debug, Clone, Copy)]
pub struct WedgePlan {
    /// Which there are, at least one.
    pub kinds: AttributeKinds,
    /// One of so many leaves has several wedges; 0: none has.
    pub seams: usize,
    /// At one of a hundred of these are as many as there can be, or nearly.
    pub has_fans: bool,
    /// Wedges are hardly different from each other.
    pub is_smooth: bool,
    /// All else follows from it.
    pub seed: u64,
}

/// A wedge by leaf and place.
type At = (u32, u32);

/// The tree with random attributes, as a build has it.
pub fn with_random_wedges(tree: &Tree, plan: &WedgePlan) -> StoredTree {
    let random = &mut Random(plan.seed);
    let keepers = keepers(tree);
    let leaves = 0..tree.leaf_count() as u32;
    let counts: Vec<u32> = leaves.clone().map(|_| wedge_count(random, plan)).collect();
    let has_seams = counts.iter().any(|count| *count > 1);
    let image = |random: &mut Random, keeper: &u32| random.below(counts[*keeper as usize] as usize) as u32;
    let all: Vec<At> = leaves.flat_map(|leaf| (0..counts[leaf as usize]).map(move |place| (leaf, place))).collect();
    let images: Vec<Option<At>> =
        all.iter().map(|(leaf, _)| keepers[*leaf as usize].map(|keeper| (keeper, image(random, &keeper)))).collect();
    let wedges: Vec<Wedge> = all.iter().map(|_| random_wedge(random, plan)).collect();
    let nodes: Vec<WedgeNode> = numbers(&all, &images)
        .into_iter()
        .zip(&images)
        .map(|([number, end], image)| WedgeNode { number, end, image: image.map_or(0, |(_, place)| place) })
        .collect();
    let first_wedges = counts.iter().scan(0, |next, count| Some(std::mem::replace(next, *next + count))).collect();
    let place = |leaf: u32, random: &mut Random| random.below(counts[leaf as usize] as usize) as u32;
    let corners =
        tree.triangles.corners.iter().map(|corners| CornerPlaces::of(corners.map(|leaf| place(leaf, random))));
    let corners = corners.collect();
    let seams = TreeSeams {
        first_wedges: Spool::from_vec(first_wedges),
        nodes: Spool::from_vec(nodes),
        corners: Spool::from_vec(corners),
    };
    let mut stored = StoredTree::from_tree(tree.clone());
    stored.attributes = Some(TreeAttributes {
        appearance: appearance(plan.kinds),
        wedges: Spool::from_vec(wedges),
        seams: has_seams.then_some(seams),
    });
    stored
}

/// Onto which leaf each is collapsed; the first one of a tree onto none.
fn keepers(tree: &Tree) -> Vec<Option<u32>> {
    let mut keepers = vec![None; tree.leaf_count()];
    for root in &tree.roots {
        let mut waiting = vec![(root.split, root.start)];
        while let Some((split, stands_at)) = waiting.pop() {
            if split == NO_SPLIT {
                continue;
            }
            keepers[split as usize] = Some(stands_at);
            let node = tree.splits[split as usize];
            waiting.extend([(node.kept, stands_at), (node.born, split)]);
        }
    }
    keepers
}

/// The number of each wedge, and one past those of all that turn into it.
fn numbers(all: &[At], images: &[Option<At>]) -> Vec<[u32; 2]> {
    // An image belongs to a leaf before that of its wedge.
    let mut ways: BTreeMap<At, Vec<At>> = BTreeMap::new();
    for (wedge, image) in all.iter().zip(images) {
        let mut way = image.map_or(Vec::new(), |image| ways[&image].clone());
        way.push(*wedge);
        ways.insert(*wedge, way);
    }
    let mut sorted: Vec<&Vec<At>> = ways.values().collect();
    sorted.sort_unstable();
    let number = |wedge: &At| {
        let way = &ways[wedge];
        let number = sorted.partition_point(|other| *other < way);
        let below = sorted[number..].iter().take_while(|other| other.starts_with(way)).count();
        [number as u32, (number + below) as u32]
    };
    all.iter().map(number).collect()
}

fn wedge_count(random: &mut Random, plan: &WedgePlan) -> u32 {
    if plan.seams == 0 || random.below(plan.seams) > 0 {
        1
    } else if plan.has_fans && random.below(100) == 0 {
        [17, 400, 1023][random.below(3)]
    } else {
        2 + random.below(4) as u32
    }
}

fn random_wedge(random: &mut Random, plan: &WedgePlan) -> Wedge {
    let AttributeKinds { normals, colours, textures, materials } = plan.kinds;
    let mut wedge = Wedge::PLAIN;
    if materials {
        let choices = if plan.is_smooth { 2 } else { 4 };
        wedge.material = random.below(choices) as u32;
    }
    if textures {
        let farthest = if plan.is_smooth { 20 } else { [3, 3000, 1 << 23][random.below(3)] };
        wedge.texture = [(); 2].map(|()| random.below(2 * farthest + 1) as i32 - farthest as i32);
    }
    if colours {
        let choices = if plan.is_smooth { 4 } else { 256 };
        wedge.colour = [(); 4].map(|()| random.below(choices) as u8);
    }
    if normals {
        let tilt = if plan.is_smooth { 0.1 } else { 10.0 };
        wedge.normal = Normal::encode([tilt * random.signed(), tilt * random.signed(), random.signed().signum()]);
    }
    wedge
}

fn appearance(kinds: AttributeKinds) -> Appearance {
    let material = |name: &str, base_colour, image| Material { name: name.into(), base_colour, image };
    let image = |name: &str, source| Image { name: name.into(), source };
    Appearance {
        kinds,
        texture_exponent: -11,
        materials: vec![
            material("stone", Some([0.5, 0.25, 1.0, 0.0]), Some(1)),
            material("", None, None),
            material("Ölfarbe", None, Some(0)),
        ],
        images: vec![
            image("wall.png", ImageSource::Bytes((0..3000).map(|byte| (byte % 251) as u8).collect())),
            image("gone.jpg", ImageSource::Missing),
            image("dot", ImageSource::Bytes(vec![7])),
            image("nothing", ImageSource::Bytes(Vec::new())),
        ],
    }
}
