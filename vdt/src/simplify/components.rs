//! The connected components of the input: how large each is, and whether it has an inside.
//!
//! They are found while the blocks of the mesh are read for the first time. Within a block, vertices that triangles join
//! have the same *label*; labels of different blocks are joined by the vertices that blocks share. A live vertex carries
//! its label along ([`super::live_mesh::Node::label`]).
//!
//! Memory: 60 bytes for each label, that is for each component of each block; 8 on disk for each vertex of each seam.

use storage::{Scratch, SortRecord, Sorter, StorageError};

use bytemuck::{Pod, Zeroable};

use crate::vector::{cross, dot, minus};

use super::live_mesh::{LiveMesh, Triangle};

/// RAM for joining the labels of different blocks.
const SORTER_BYTES: usize = 1 << 20;

/// Volumes are summed in integers of this fraction of the cube of a normalised unit, so that their order does not
/// matter. A component of 2^-20 of the mesh's width still has a volume of 2^20 of them.
const VOLUME_UNIT: f64 = 1.0 / (1_u128 << 80) as f64;

/// What is known of a label, or of a component.
#[derive(Debug, Clone, Copy)]
struct Extent {
    minimum: [f32; 3],
    maximum: [f32; 3],
    /// Six times the signed volume, in [`VOLUME_UNIT`]s.
    volume: i128,
    is_regular: bool,
}

impl Extent {
    const NOTHING: Extent =
        Extent { minimum: [f32::INFINITY; 3], maximum: [f32::NEG_INFINITY; 3], volume: 0, is_regular: true };

    fn add(&mut self, other: &Extent) {
        for axis in 0..3 {
            self.minimum[axis] = self.minimum[axis].min(other.minimum[axis]);
            self.maximum[axis] = self.maximum[axis].max(other.maximum[axis]);
        }
        self.volume += other.volume;
        self.is_regular &= other.is_regular;
    }
}

/// Union-find with path halving; the smaller number represents.
#[derive(Debug, Default)]
pub(super) struct DisjointSets {
    parent: Vec<u32>,
}

impl DisjointSets {
    /// Makes it so many elements, each alone.
    pub fn clear_to(&mut self, count: usize) {
        self.parent.clear();
        self.grow_to(count);
    }

    /// Adds elements, each alone, until there are so many.
    pub fn grow_to(&mut self, count: usize) {
        self.parent.extend(self.parent.len() as u32..count as u32);
    }

    /// How many elements there are.
    pub fn len(&self) -> usize {
        self.parent.len()
    }

    pub fn find(&mut self, mut element: u32) -> u32 {
        while self.parent[element as usize] != element {
            let grandparent = self.parent[self.parent[element as usize] as usize];
            self.parent[element as usize] = grandparent;
            element = grandparent;
        }
        element
    }

    pub fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }
}

/// A vertex of a seam, with the label that it has in one of its blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct Link {
    vertex: u32,
    label: u32,
}

impl SortRecord for Link {
    fn prefix(&self) -> u64 {
        u64::from(self.vertex) << 32 | u64::from(self.label)
    }
}

/// Labels while blocks are read.
#[derive(Debug)]
pub(super) struct Labels {
    sets: DisjointSets,
    extents: Vec<Extent>,
    links: Sorter<Link>,
}

/// The labels of one block.
#[derive(Debug, Default)]
pub(super) struct BlockLabels {
    extents: Vec<Extent>,
    links: Vec<Link>,
}

impl BlockLabels {
    /// Labels the components of a live mesh, as they are before the first collapse. The labels, from 0 on, go to the
    /// nodes. `is_shared`: whether a vertex has triangles elsewhere too.
    pub fn of(mesh: &mut LiveMesh, is_shared: impl Fn(usize) -> bool) -> Self {
        let mut sets = DisjointSets::default();
        sets.clear_to(mesh.vertices.len());
        for Triangle { corners, .. } in &mesh.triangles {
            sets.unite(corners[0], corners[1]);
            sets.unite(corners[0], corners[2]);
        }
        let mut labels = BlockLabels::default();
        for vertex in 0..mesh.vertices.len() {
            let representative = sets.find(vertex as u32) as usize;
            // The smallest vertex represents, so it comes first.
            let label = if representative == vertex {
                labels.extents.push(Extent::NOTHING);
                labels.extents.len() as u32 - 1
            } else {
                mesh.nodes[representative].label
            };
            let node = &mut mesh.nodes[vertex];
            node.label = label;
            let is_regular = !mesh.vertices[vertex].is_special();
            let own = Extent { minimum: node.position, maximum: node.position, volume: 0, is_regular };
            labels.extents[label as usize].add(&own);
            if is_shared(vertex) {
                labels.links.push(Link { vertex: node.id, label });
            }
        }
        // Any reference point will do for a closed surface; a corner of the normalised mesh keeps the numbers small.
        for Triangle { corners, .. } in &mesh.triangles {
            let [a, b, c] = corners.map(|corner| mesh.vertices[corner as usize].position.map(f64::from));
            let reference = mesh.reference.map(f64::from);
            let [a, b, c] = [a, b, c].map(|position| minus(position, reference));
            let volume = dot(a, cross(b, c)) / VOLUME_UNIT;
            let label = mesh.nodes[corners[0] as usize].label;
            labels.extents[label as usize].volume += volume as i128;
        }
        labels
    }
}

impl Labels {
    pub fn new(scratch: &Scratch) -> Self {
        Labels {
            sets: DisjointSets::default(),
            extents: Vec::new(),
            links: Sorter::new(scratch, "component-links", SORTER_BYTES, 1),
        }
    }

    /// Takes the labels of a block over; says by how much they are to be raised.
    pub fn add(&mut self, block: &BlockLabels) -> Result<u32, StorageError> {
        let raise = self.extents.len() as u32;
        self.extents.extend_from_slice(&block.extents);
        for link in &block.links {
            self.links.push(Link { label: link.label + raise, ..*link })?;
        }
        Ok(raise)
    }

    /// Joins the labels that a shared vertex has in different blocks.
    pub fn join(mut self) -> Result<Components, StorageError> {
        self.sets.clear_to(self.extents.len());
        let mut links = self.links.finish()?;
        let mut before: Option<Link> = None;
        while let Some(link) = links.next()? {
            if let Some(before) = before.filter(|before| before.vertex == link.vertex) {
                self.sets.unite(before.label, link.label);
            }
            before = Some(link);
        }
        let components: Vec<u32> = (0..self.extents.len() as u32).map(|label| self.sets.find(label)).collect();
        for (label, component) in components.iter().map(|component| *component as usize).enumerate() {
            if component != label {
                let part = self.extents[label];
                self.extents[component].add(&part);
            }
        }
        Ok(Components { components, extents: self.extents })
    }
}

/// The components of a mesh.
#[derive(Debug)]
pub(super) struct Components {
    /// The component of each label.
    components: Vec<u32>,
    extents: Vec<Extent>,
}

impl Components {
    /// The component of a label, by the smallest of its labels.
    pub fn of(&self, label: u32) -> u32 {
        self.components[label as usize]
    }

    /// The diagonal of the box of a component's vertices in the input, in mesh units.
    pub fn diameter(&self, component: u32) -> f64 {
        let Extent { minimum, maximum, .. } = self.extents[component as usize];
        let square = |axis: usize| {
            let extent = f64::from(maximum[axis]) - f64::from(minimum[axis]);
            extent * extent
        };
        (square(0) + square(1) + square(2)).sqrt()
    }

    /// Which way is out of a component: 1 or -1 times the orientation of its triangles, 0 where it has no inside.
    pub fn outward(&self, component: u32) -> i8 {
        let Extent { volume, is_regular, .. } = self.extents[component as usize];
        if is_regular { volume.signum() as i8 } else { 0 }
    }
}
