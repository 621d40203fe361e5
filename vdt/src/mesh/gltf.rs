//! Reads glTF 2.0 assets: `.gltf` with its buffers in files or data URIs, and binary `.glb`.
//!
//! The nodes of the default scene are walked (of all scenes, if none is the default; all nodes without a parent, if
//! there are no scenes; all meshes, if there are no nodes). Each mesh is pushed once for each node that shows it, in
//! scene coordinates. Read are primitives of triangles, triangle strips and triangle fans; points and lines are
//! stepped over. Meshes are read as they are stored: morph targets, skins and animations are not applied (for a
//! skinned mesh, the specification has the node's transform ignored). Where a mirroring transform turns triangles
//! inside out, they are turned back.
//!
//! Primitives of one mesh that share their positions share their vertices. A node without a transform leaves every
//! bit of a coordinate alone; others are composed and applied in f64.
//!
//! Memory: the JSON document (at most 256 MiB; a data URI is part of it), the transform of each node that shows a
//! mesh, and up to six windows of 256 KiB. Positions and vertex numbers are streamed from where they lie. The bytes
//! of a primitive are read once for each node that shows it.
//!
//! Format: glTF 2.0 specification, sections 3.5 (scenes), 3.6 (binary data), 3.7 (meshes) and 4 (GLB); integer
//! positions as in KHR_mesh_quantization.

mod accessors;
mod container;
mod document;
mod transform;

use std::collections::{HashMap, HashSet};
use std::path::Path;

use storage::Disk;

use self::accessors::{Accessors, Stream};
use self::container::{Buffers, Container};
use self::document::{Document, Primitive, read_document, unsupported_extension};
use self::transform::Transform;
use super::polygon::Strip;
use super::{Face, MeshError, MeshSink, Vertex};

/// Reads the whole of `path`, and the files that it names, into `sink`.
///
/// # Errors
///
/// The disk's, the sink's, [`MeshError::Malformed`] where the asset breaks the rules or ends early, and
/// [`MeshError::Unsupported`] for other versions of the format, for extensions that hide or multiply triangles, and
/// for buffers that are not on the disk.
pub fn read(disk: &dyn Disk, path: &Path, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
    let container = Container::open(disk, path)?;
    let mut document = read_document(path, &container)?;
    let buffers = Buffers::locate(disk, path, container, std::mem::take(&mut document.buffers))?;
    let accessors = Accessors::new(path, &document, &buffers);
    let asset = Asset { path, document: &document, accessors };
    let instances = asset.instances()?;
    let (vertices, faces) = asset.size_of(&instances)?;
    sink.announce(vertices, faces)?;
    let mut pushed = 0;
    for instance in &instances {
        asset.read_instance(instance, &mut pushed, sink)?;
    }
    Ok(())
}

/// A mesh as one node shows it.
#[derive(Debug)]
struct Instance {
    mesh: usize,
    /// To scene coordinates; none where it changes nothing.
    transform: Option<Transform>,
}

/// What a primitive's corners mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    Triangles,
    Strip,
    Fan,
}

/// A primitive that has triangles.
#[derive(Debug, Clone, Copy)]
struct Triangles {
    mode: Mode,
    positions: usize,
    indices: Option<usize>,
}

struct Asset<'a> {
    path: &'a Path,
    document: &'a Document,
    accessors: Accessors<'a>,
}

impl Asset<'_> {
    fn malformed(&self, place: impl Into<String>, problem: impl Into<String>) -> MeshError {
        MeshError::malformed(self.path, place, problem)
    }

    /// The nodes from which the walk starts, in groups: within each group, no node may be reached twice.
    fn roots(&self) -> Result<Vec<Vec<usize>>, MeshError> {
        let scenes = &self.document.scenes;
        if let Some(number) = self.document.scene {
            return match scenes.get(number) {
                Some(scene) => Ok(vec![scene.nodes.clone()]),
                None => Err(self.malformed("JSON document", format!("there is no scene {number}"))),
            };
        }
        if !scenes.is_empty() {
            return Ok(scenes.iter().map(|scene| scene.nodes.clone()).collect());
        }
        let mut is_child = vec![false; self.document.nodes.len()];
        for child in self.document.nodes.iter().flat_map(|node| &node.children) {
            if let Some(flag) = is_child.get_mut(*child) {
                *flag = true;
            }
        }
        Ok(vec![(0..is_child.len()).filter(|&node| !is_child[node]).collect()])
    }

    /// All meshes that are shown, in the order of the walk: parents first, children in their order.
    fn instances(&self) -> Result<Vec<Instance>, MeshError> {
        let nodes = &self.document.nodes;
        if nodes.is_empty() && self.document.scene.is_none() && self.document.scenes.is_empty() {
            let meshes = 0..self.document.meshes.len();
            return Ok(meshes.map(|mesh| Instance { mesh, transform: None }).collect());
        }
        let mut instances = Vec::new();
        // The group in which a node was reached.
        let mut reached: Vec<Option<usize>> = vec![None; nodes.len()];
        for (group, roots) in self.roots()?.into_iter().enumerate() {
            let mut waiting: Vec<(usize, Option<Transform>)> =
                roots.into_iter().rev().map(|node| (node, None)).collect();
            while let Some((number, above)) = waiting.pop() {
                let (Some(node), Some(reached)) = (nodes.get(number), reached.get_mut(number)) else {
                    return Err(self.malformed(format!("node {number}"), "there is no such node"));
                };
                match reached {
                    Some(other) if *other == group => {
                        let problem = "it is reached twice; the nodes of a scene must be trees";
                        return Err(self.malformed(format!("node {number}"), problem));
                    }
                    // Another scene shows it, and so it has been seen.
                    Some(_) => continue,
                    None => *reached = Some(group),
                }
                if node.extensions.instancing.is_some() {
                    return Err(unsupported_extension(self.path, "EXT_mesh_gpu_instancing"));
                }
                let transform = match (above, Transform::of(node)) {
                    (Some(above), Some(own)) => Some(above.after(&own)),
                    (above, own) => above.or(own),
                };
                if let Some(mesh) = node.mesh {
                    instances.push(Instance { mesh, transform: transform.filter(|_| node.skin.is_none()) });
                }
                waiting.extend(node.children.iter().rev().map(|&child| (child, transform)));
            }
        }
        Ok(instances)
    }

    /// The triangles of a primitive; none if it has only points or lines.
    fn triangles_of(&self, place: &str, primitive: &Primitive) -> Result<Option<Triangles>, MeshError> {
        let mode = match primitive.mode {
            0..=3 => return Ok(None),
            4 => Mode::Triangles,
            5 => Mode::Strip,
            6 => Mode::Fan,
            other => return Err(self.malformed(place, format!("{other} is not a mode of primitives"))),
        };
        let Some(positions) = primitive.attributes.position else {
            return Err(MeshError::Unsupported {
                path: self.path.to_path_buf(),
                feature: format!("{place}: a primitive without positions"),
                advice: "write the asset again without it, or with its positions".to_string(),
            });
        };
        if primitive.extensions.draco.is_some() && self.accessors.has_no_data(positions)? {
            return Err(unsupported_extension(self.path, "KHR_draco_mesh_compression"));
        }
        Ok(Some(Triangles { mode, positions, indices: primitive.indices }))
    }

    /// The primitives of an instance that have triangles, with their places for messages.
    fn primitives(&self, instance: &Instance) -> Result<Vec<(String, Triangles)>, MeshError> {
        let number = instance.mesh;
        let Some(mesh) = self.document.meshes.get(number) else {
            return Err(self.malformed(format!("mesh {number}"), "there is no such mesh"));
        };
        let mut primitives = Vec::new();
        for (index, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("mesh {number}, primitive {index}");
            if let Some(triangles) = self.triangles_of(&place, primitive)? {
                primitives.push((place, triangles));
            }
        }
        Ok(primitives)
    }

    /// How many vertices all instances have together, and at least how many faces. Opens every accessor that will be
    /// read, so that what is wrong with the document shows before anything is pushed.
    fn size_of(&self, instances: &[Instance]) -> Result<(u64, u64), MeshError> {
        let (mut vertices, mut faces) = (0_u64, 0_u64);
        for instance in instances {
            let mut seen = HashSet::new();
            for (_, triangles) in self.primitives(instance)? {
                let positions = self.accessors.positions(triangles.positions)?.count();
                if seen.insert(triangles.positions) {
                    vertices = vertices.saturating_add(positions);
                }
                let corners = match triangles.indices {
                    Some(accessor) => self.accessors.indices(accessor)?.count(),
                    None => positions,
                };
                faces = faces.saturating_add(match triangles.mode {
                    Mode::Triangles => corners / 3,
                    Mode::Fan => corners.saturating_sub(2),
                    // Any of them may be there only to chain strips.
                    Mode::Strip => 0,
                });
            }
        }
        Ok((vertices, faces))
    }

    /// Pushes the vertices and faces of one instance, behind `pushed` vertices so far.
    fn read_instance(&self, instance: &Instance, pushed: &mut i64, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
        let mirrored = instance.transform.is_some_and(|transform| transform.mirrors());
        // The first vertex and the number of vertices of each accessor of positions. Attributes, once they are read,
        // belong into the key.
        let mut known: HashMap<usize, (i64, u64)> = HashMap::new();
        for (place, triangles) in self.primitives(instance)? {
            let (first, count) = match known.get(&triangles.positions) {
                Some(&range) => range,
                None => {
                    let first = *pushed;
                    let mut positions = self.accessors.positions(triangles.positions)?;
                    for _ in 0..positions.count() {
                        let position = positions.next_position()?;
                        let position = instance.transform.map_or(position, |transform| transform.apply(position));
                        sink.vertex(Vertex::at(position))?;
                        *pushed += 1;
                    }
                    known.insert(triangles.positions, (first, positions.count()));
                    (first, positions.count())
                }
            };
            let indices = match triangles.indices {
                Some(accessor) => Some(self.accessors.indices(accessor)?),
                None => None,
            };
            let corners = CornerSource { asset: self, place: &place, indices, next: 0, first, vertices: count };
            corners.push_faces(triangles.mode, mirrored, sink)?;
        }
        Ok(())
    }
}

/// The corners of one primitive, one after the other.
struct CornerSource<'a> {
    asset: &'a Asset<'a>,
    place: &'a str,
    /// None if the corners are the vertices in their order.
    indices: Option<Stream<'a>>,
    next: u64,
    /// The primitive's first vertex among all.
    first: i64,
    vertices: u64,
}

impl CornerSource<'_> {
    fn count(&self) -> u64 {
        self.indices.as_ref().map_or(self.vertices, Stream::count)
    }

    fn next(&mut self) -> Result<i64, MeshError> {
        let number = self.next;
        self.next += 1;
        let index = match &mut self.indices {
            Some(stream) => stream.next_index()?,
            None => number,
        };
        // Beyond its own vertices it would name one of another primitive.
        match i64::try_from(index) {
            Ok(local) if index < self.vertices => Ok(self.first + local),
            _ => {
                let problem = format!("it names vertex {index}, but there are {} vertices", self.vertices);
                Err(self.asset.malformed(format!("{}, corner {number}", self.place), problem))
            }
        }
    }

    fn push_faces(mut self, mode: Mode, mirrored: bool, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
        let count = self.count();
        let mut push = |[first, second, third]: [i64; 3]| {
            let corners = if mirrored { [first, third, second] } else { [first, second, third] };
            sink.face(Face::new(&corners))
        };
        match mode {
            Mode::Triangles => {
                if !count.is_multiple_of(3) {
                    let problem = format!("its {count} corners are not a multiple of 3");
                    return Err(self.asset.malformed(self.place, problem));
                }
                for _ in 0..count / 3 {
                    push([self.next()?, self.next()?, self.next()?])?;
                }
            }
            Mode::Strip => {
                let mut strip = Strip::default();
                for _ in 0..count {
                    if let Some(triangle) = strip.push(self.next()?) {
                        push(triangle)?;
                    }
                }
            }
            Mode::Fan => {
                if count >= 3 {
                    let hub = self.next()?;
                    let mut previous = self.next()?;
                    for _ in 2..count {
                        let corner = self.next()?;
                        push([previous, corner, hub])?;
                        previous = corner;
                    }
                }
            }
        }
        Ok(())
    }
}
