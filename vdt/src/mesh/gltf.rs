//! Reads glTF 2.0 assets: `.gltf` with its buffers in files or data URIs, and binary `.glb`.
//!
//! The nodes of the default scene are walked (of all scenes, if none is the default; all nodes without a parent, if
//! there are no scenes; all meshes, if there are no nodes). Each mesh is pushed once for each node that shows it, in
//! scene coordinates. Read are primitives of triangles, triangle strips and triangle fans; points and lines are
//! stepped over. Meshes are read as they are stored: morph targets, skins and animations are not applied (for a
//! skinned mesh, the specification has the node's transform ignored). Where a mirroring transform turns triangles
//! inside out, they are turned back.
//!
//! Where attributes are wanted: normals, the colours `COLOR_0`, materials with base colour and image, and the texture
//! coordinates that the image asks for. Other sets, and images that only an extension names, are stepped over.
//!
//! Primitives of one mesh that share their positions, and the attributes that are wanted, share their vertices. A node without a transform leaves every
//! bit of a coordinate alone; others are composed and applied in f64.
//!
//! Memory: the JSON document (at most 256 MiB; a data URI is part of it), the transform of each node that shows a
//! mesh, and up to six windows of 256 KiB for each of positions
//! and attributes. Positions and vertex numbers are streamed from where they lie. The bytes
//! of a primitive are read once for each node that shows it.
//!
//! Format: glTF 2.0 specification, sections 3.5 (scenes), 3.6 (binary data), 3.7 (meshes) and 4 (GLB); integer
//! positions as in KHR_mesh_quantization.

mod accessors;
mod container;
mod document;
mod transform;

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use storage::Disk;

use self::accessors::{Accessors, Stream};
use self::container::{Buffers, Container};
use self::document::{Document, Looks, Primitive, read_document, read_looks, unsupported_extension};
use self::transform::Transform;
use super::attributes::{Image, ImageSource, Material};
use super::polygon::Strip;
use super::srgb::srgb_of_linear;
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
    let looks = if sink.wants_attributes() { Some(read_looks(path, &container)?) } else { None };
    let buffers = Buffers::locate(disk, path, container, std::mem::take(&mut document.buffers))?;
    let accessors = Accessors::new(path, &document, &buffers);
    let asset = Asset { path, document: &document, accessors, looks: looks.as_ref() };
    let instances = asset.instances()?;
    let (vertices, faces) = asset.size_of(&instances)?;
    sink.announce(vertices, faces)?;
    asset.push_materials(&buffers, sink)?;
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
    vertices: VertexAccessors,
    indices: Option<usize>,
    material: Option<u32>,
}

/// The accessors of a primitive's vertices: their positions, and the attributes that are wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct VertexAccessors {
    positions: usize,
    normals: Option<usize>,
    colours: Option<usize>,
    textures: Option<usize>,
}

/// The vertices of a primitive, one after the other.
struct VertexStreams<'a> {
    positions: Stream<'a>,
    normals: Option<Stream<'a>>,
    colours: Option<Stream<'a>>,
    textures: Option<Stream<'a>>,
}

impl VertexStreams<'_> {
    fn next(&mut self, transform: Option<&Transform>) -> Result<Vertex, MeshError> {
        let position = self.positions.next_numbers()?;
        let mut vertex = Vertex::at(transform.map_or(position, |transform| transform.apply(position)));
        if let Some(normals) = &mut self.normals {
            let normal = normals.next_numbers()?.map(|value| value as f32);
            vertex.normal = Some(transform.map_or(normal, |transform| transform.apply_to_normal(normal)));
        }
        if let Some(colours) = &mut self.colours {
            vertex.colour = Some(colours.next_colour()?);
        }
        if let Some(textures) = &mut self.textures {
            vertex.texture = Some(textures.next_numbers()?.map(|value| value as f32));
        }
        Ok(vertex)
    }
}

struct Asset<'a> {
    path: &'a Path,
    document: &'a Document,
    accessors: Accessors<'a>,
    /// How surfaces look; none if attributes are not wanted.
    looks: Option<&'a Looks>,
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
        let mut vertices = VertexAccessors { positions, normals: None, colours: None, textures: None };
        let mut material = None;
        if let Some(looks) = self.looks {
            let mut set = 0;
            if let Some(number) = primitive.material {
                let Some(found) = looks.materials.get(number as usize) else {
                    return Err(self.malformed(place, format!("there is no material {number}")));
                };
                set = found.pbr_metallic_roughness.base_color_texture.map_or(0, |texture| texture.tex_coord);
                material = Some(number);
            }
            let attributes = &primitive.attributes;
            vertices.normals = attributes.normal;
            vertices.colours = attributes.colour;
            vertices.textures = attributes.texture(set);
        }
        Ok(Some(Triangles { mode, vertices, indices: primitive.indices, material }))
    }

    /// Opens the accessors of a primitive's vertices.
    fn vertex_streams(&self, place: &str, accessors: &VertexAccessors) -> Result<VertexStreams<'_>, MeshError> {
        let VertexAccessors { positions, normals, colours, textures } = *accessors;
        let streams = VertexStreams {
            positions: self.accessors.positions(positions)?,
            normals: normals.map(|number| self.accessors.vectors(number, "normals", 3)).transpose()?,
            colours: colours.map(|number| self.accessors.colours(number)).transpose()?,
            textures: textures.map(|number| self.accessors.vectors(number, "texture coordinates", 2)).transpose()?,
        };
        let count = streams.positions.count();
        for (number, stream) in
            [(normals, &streams.normals), (colours, &streams.colours), (textures, &streams.textures)]
        {
            if let (Some(number), Some(stream)) = (number, stream)
                && stream.count() != count
            {
                let problem = format!("accessor {number} has {} elements for its {count} vertices", stream.count());
                return Err(self.malformed(place, problem));
            }
        }
        Ok(streams)
    }

    /// Pushes the materials, if they are wanted, in the order of the document.
    fn push_materials(&self, buffers: &Buffers<'_>, sink: &mut dyn MeshSink) -> Result<(), MeshError> {
        let Some(looks) = self.looks else { return Ok(()) };
        for (number, material) in looks.materials.iter().enumerate() {
            let look = &material.pbr_metallic_roughness;
            let image = match look.base_color_texture {
                Some(texture) => self.image(&format!("material {number}"), looks, texture.index, buffers, sink)?,
                None => None,
            };
            let [red, green, blue, alpha] = look.base_color_factor.unwrap_or([1.0; 4]);
            let [red, green, blue] = [red, green, blue].map(srgb_of_linear);
            let base_colour = Some([red, green, blue, alpha].map(|channel| channel as f32));
            sink.material(Material { name: material.name.clone(), base_colour, image })?;
        }
        Ok(())
    }

    /// The image of texture `number`; none if only an extension has one.
    fn image(
        &self,
        place: &str,
        looks: &Looks,
        number: usize,
        buffers: &Buffers<'_>,
        sink: &mut dyn MeshSink,
    ) -> Result<Option<Image>, MeshError> {
        let Some(texture) = looks.textures.get(number) else {
            return Err(self.malformed(place, format!("there is no texture {number}")));
        };
        let Some(source) = texture.source else { return Ok(None) };
        let Some(image) = looks.images.get(source) else {
            return Err(self.malformed(format!("texture {number}"), format!("there is no image {source}")));
        };
        let place = format!("image {source}");
        let is_data = |uri: &str| uri.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:"));
        let uri = image.uri.as_ref().filter(|uri| !is_data(uri));
        let name = image.name.as_ref().filter(|name| !name.is_empty()).or(uri).unwrap_or(&place).clone();
        let found: Result<ImageSource, PathBuf> = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => buffers.image_at(&place, uri)?,
            (None, Some(view)) => {
                let view = self.accessors.view(view)?;
                buffers.image(view.buffer, view.byte_offset, view.byte_length)?
            }
            (None, None) => return Err(self.malformed(place, "it has neither a URI nor a buffer view")),
        };
        let source = match found {
            Ok(source) => source,
            Err(path) => {
                sink.missing_file(path)?;
                ImageSource::Missing
            }
        };
        Ok(Some(Image { name, source }))
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
            for (place, triangles) in self.primitives(instance)? {
                let positions = self.vertex_streams(&place, &triangles.vertices)?.positions.count();
                if seen.insert(triangles.vertices) {
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
        let primitives = self.primitives(instance)?;
        if let Some(mesh) = self.document.meshes.get(instance.mesh) {
            sink.left_out((mesh.primitives.len() - primitives.len()) as u64);
        }
        let mirrored = instance.transform.is_some_and(|transform| transform.mirrors());
        // The first vertex and the number of vertices of the accessors.
        let mut known: HashMap<VertexAccessors, (i64, u64)> = HashMap::new();
        for (place, triangles) in primitives {
            let (first, count) = match known.get(&triangles.vertices) {
                Some(&range) => range,
                None => {
                    let first = *pushed;
                    let mut streams = self.vertex_streams(&place, &triangles.vertices)?;
                    let count = streams.positions.count();
                    for _ in 0..count {
                        sink.vertex(streams.next(instance.transform.as_ref())?)?;
                        *pushed += 1;
                    }
                    known.insert(triangles.vertices, (first, count));
                    (first, count)
                }
            };
            let indices = match triangles.indices {
                Some(accessor) => Some(self.accessors.indices(accessor)?),
                None => None,
            };
            let material = triangles.material;
            let corners =
                CornerSource { asset: self, place: &place, indices, next: 0, first, vertices: count, material };
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
    material: Option<u32>,
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
        let (count, material) = (self.count(), self.material);
        let mut push = |[first, second, third]: [i64; 3]| {
            let corners = if mirrored { [first, third, second] } else { [first, second, third] };
            let mut face = Face::new(&corners);
            face.material = material;
            sink.face(face)
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

#[cfg(test)]
mod tests {
    use std::path::PathBuf;
    use std::sync::Arc;

    use proptest::prelude::*;
    use serde_json::{Value, json};
    use storage::{FaultyDisk, MemoryDisk};

    use super::super::testing::{Collected, WithAttributes, meshes, widened};
    use super::*;

    /// Builds an asset: a document, and the buffer that it speaks of.
    #[derive(Debug, Clone)]
    struct Builder {
        document: Value,
        buffer: Vec<u8>,
    }

    impl Builder {
        /// An asset of one mesh without primitives, shown by one node.
        fn new() -> Self {
            let document = json!({
                "asset": {"version": "2.0", "generator": "by hand"},
                "scene": 0,
                "scenes": [{"nodes": [0]}],
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": []}],
                "accessors": [],
                "bufferViews": [],
                "materials": [{"name": "red"}],
                "textures": [{"extensions": {"KHR_texture_basisu": {}}}],
            });
            Builder { document, buffer: Vec::new() }
        }

        fn list(&mut self, name: &str) -> &mut Vec<Value> {
            self.document[name].as_array_mut().unwrap()
        }

        fn add(&mut self, list: &str, value: Value) -> usize {
            self.list(list).push(value);
            self.list(list).len() - 1
        }

        fn view(&mut self, bytes: &[u8], stride: Option<u64>) -> usize {
            let mut view = json!({"buffer": 0, "byteOffset": self.buffer.len(), "byteLength": bytes.len()});
            if let Some(stride) = stride {
                view["byteStride"] = json!(stride);
            }
            self.buffer.extend_from_slice(bytes);
            self.add("bufferViews", view)
        }

        /// An accessor of f32 positions, with `gap` bytes between any two.
        fn positions(&mut self, positions: &[[f32; 3]], gap: usize) -> usize {
            let mut bytes = Vec::new();
            for (index, position) in positions.iter().enumerate() {
                bytes.resize(index * (12 + gap), 0xee);
                bytes.extend(position.iter().flat_map(|value| value.to_le_bytes()));
            }
            let view = self.view(&bytes, (gap > 0).then_some(12 + gap as u64));
            let accessor = json!({"bufferView": view, "componentType": 5126, "count": positions.len(), "type": "VEC3"});
            self.add("accessors", accessor)
        }

        fn indices(&mut self, indices: &[u32], component: u32) -> usize {
            let bytes: Vec<u8> = indices
                .iter()
                .flat_map(|&index| match component {
                    5121 => vec![index as u8],
                    5123 => (index as u16).to_le_bytes().to_vec(),
                    _ => index.to_le_bytes().to_vec(),
                })
                .collect();
            let view = self.view(&bytes, None);
            let accessor =
                json!({"bufferView": view, "componentType": component, "count": indices.len(), "type": "SCALAR"});
            self.add("accessors", accessor)
        }

        fn primitive(&mut self, positions: usize, indices: Option<usize>, mode: Option<u32>) {
            let mut primitive = json!({"attributes": {"POSITION": positions, "NORMAL": 77}, "material": 0});
            if let Some(indices) = indices {
                primitive["indices"] = json!(indices);
            }
            if let Some(mode) = mode {
                primitive["mode"] = json!(mode);
            }
            self.document["meshes"][0]["primitives"].as_array_mut().unwrap().push(primitive);
        }

        fn glb(&self) -> Vec<u8> {
            let mut document = self.document.clone();
            document["buffers"] = json!([{"byteLength": self.buffer.len()}]);
            glb_of(&document.to_string(), Some(&self.buffer))
        }

        fn read(&self) -> Result<Collected, MeshError> {
            read_glb(&self.glb())
        }

        fn found(&self) -> Collected {
            self.read().unwrap()
        }

        fn refusal(&self) -> String {
            self.read().unwrap_err().to_string()
        }

        /// The document as a file of its own, with its buffer at `uri`.
        fn gltf(&self, uri: &str) -> String {
            let mut document = self.document.clone();
            document["buffers"] = json!([{"byteLength": self.buffer.len(), "uri": uri}]);
            document.to_string()
        }
    }

    fn glb_of(document: &str, buffer: Option<&[u8]>) -> Vec<u8> {
        let mut chunks = Vec::new();
        let mut push = |kind: &[u8; 4], bytes: &[u8], filler: u8| {
            let padded = bytes.len().next_multiple_of(4);
            chunks.extend_from_slice(&(padded as u32).to_le_bytes());
            chunks.extend_from_slice(kind);
            chunks.extend_from_slice(bytes);
            chunks.resize(chunks.len() + padded - bytes.len(), filler);
        };
        push(b"JSON", document.as_bytes(), b' ');
        if let Some(buffer) = buffer {
            push(b"BIN\0", buffer, 0);
        }
        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend_from_slice(&(12 + chunks.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&chunks);
        bytes
    }

    fn read_from(disk: &dyn Disk, path: &str) -> Result<Collected, MeshError> {
        let mut collected = Collected::default();
        read(disk, Path::new(path), &mut collected).map(|()| collected)
    }

    fn read_glb(bytes: &[u8]) -> Result<Collected, MeshError> {
        let disk = MemoryDisk::new();
        disk.insert("file", bytes);
        read_from(&disk, "file")
    }

    fn base64(bytes: &[u8]) -> String {
        let alphabet: Vec<char> = ('A'..='Z').chain('a'..='z').chain('0'..='9').chain(['+', '/']).collect();
        let mut text = String::new();
        for group in bytes.chunks(3) {
            let word = group.iter().fold(0_u32, |word, &byte| word << 8 | u32::from(byte)) << (8 * (3 - group.len()));
            for place in 0..4 {
                let sextet = word >> (18 - 6 * place) & 63;
                text.push(if place > group.len() { '=' } else { alphabet[sextet as usize] });
            }
        }
        text
    }

    const QUAD: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.1]];
    const TWO: [u32; 6] = [0, 1, 2, 0, 2, 3];

    fn quad() -> Builder {
        let mut builder = Builder::new();
        let positions = builder.positions(&QUAD, 0);
        let indices = builder.indices(&TWO, 5123);
        builder.primitive(positions, Some(indices), None);
        builder
    }

    fn expected_quad() -> Collected {
        let faces = vec![vec![0, 1, 2], vec![0, 2, 3]];
        Collected { announced: Some((4, 2)), vertices: widened(&QUAD), faces, left_out: 0 }
    }

    #[test]
    fn a_buffer_may_lie_in_a_chunk_in_a_file_or_in_the_document() {
        let builder = quad();
        assert_eq!(builder.found(), expected_quad());
        let disk = MemoryDisk::new();
        disk.insert("folder/my mesh.bin", builder.buffer.clone());
        disk.insert("folder/external.gltf", builder.gltf("my%20mesh.bin"));
        disk.insert("folder/deeper/up.gltf", format!("\u{feff}{}", builder.gltf("../my mesh.bin")));
        let data = base64(&builder.buffer);
        for kind in ["application/octet-stream;base64", "application/gltf-buffer;base64", ";BASE64"] {
            disk.insert("embedded.gltf", builder.gltf(&format!("data:{kind},{data}")));
            assert_eq!(read_from(&disk, "embedded.gltf").unwrap(), expected_quad());
        }
        assert_eq!(read_from(&disk, "folder/external.gltf").unwrap(), expected_quad());
        // A memory disk knows no "..", so the path that is asked for shows in the error.
        let message = read_from(&disk, "folder/deeper/up.gltf").unwrap_err().to_string();
        let expected = "folder/deeper/up.gltf: buffer 0: cannot open folder/deeper/../my mesh.bin";
        assert!(message.starts_with(expected), "{message}");
    }

    #[test]
    fn buffers_that_cannot_be_had_are_refused() {
        let builder = quad();
        let disk = MemoryDisk::new();
        disk.insert("short.bin", &builder.buffer[1..]);
        for (uri, expected) in [
            ("https://a.b/c.bin", "buffer 0 at 'https://a.b/c.bin': a URI with a scheme is not supported; download"),
            ("C:\\a.bin", "a URI with a scheme is not supported"),
            ("/a.bin", "buffer 0 at '/a.bin': an absolute path is not supported"),
            ("data:text/plain,abc", "data that is not in base64 is not supported"),
            ("data:;base64", "file.gltf: buffer 0: a data URI without data"),
            ("data:;base64,AA*A", "file.gltf: buffer 0: character 2 of its data is '*'"),
            ("data:;base64,AAAA", "file.gltf: buffer 0: file.gltf has 3 bytes of it, the document promises 60"),
            ("short.bin", "file.gltf: buffer 0: short.bin has 59 bytes of it, the document promises 60"),
            ("%zz", "file.gltf: buffer 0: '%zz' is not a URI"),
            ("missing.bin", "cannot open missing.bin"),
        ] {
            disk.insert("file.gltf", builder.gltf(uri));
            let message = read_from(&disk, "file.gltf").unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        let mut document = builder.document.clone();
        document["buffers"] = json!([{"byteLength": 60}]);
        disk.insert("file.gltf", document.to_string());
        let message = read_from(&disk, "file.gltf").unwrap_err().to_string();
        assert!(message.contains("buffer 0: it has no URI"), "{message}");
    }

    impl Builder {
        /// An accessor of numbers of a component type, `width` of them an element.
        fn numbers(&mut self, component: u32, normalized: bool, width: usize, values: &[f64]) -> usize {
            let bytes: Vec<u8> = values
                .iter()
                .flat_map(|&value| match component {
                    5120 => (value as i8).to_le_bytes().to_vec(),
                    5121 => vec![value as u8],
                    5122 => (value as i16).to_le_bytes().to_vec(),
                    5123 => (value as u16).to_le_bytes().to_vec(),
                    _ => (value as f32).to_le_bytes().to_vec(),
                })
                .collect();
            let view = self.view(&bytes, None);
            let kind = format!("VEC{width}");
            let count = values.len() / width;
            let accessor = json!({
                "bufferView": view, "componentType": component, "normalized": normalized, "count": count, "type": kind,
            });
            self.add("accessors", accessor)
        }

        /// Sets a member of the only primitive.
        fn set(&mut self, pointer: &str, value: Value) {
            let primitive = &mut self.document["meshes"][0]["primitives"][0];
            match pointer.split_once('/') {
                Some((outer, inner)) => primitive[outer][inner] = value,
                None => primitive[pointer] = value,
            }
        }

        fn attributes(&self) -> Result<WithAttributes, MeshError> {
            let disk = MemoryDisk::new();
            disk.insert("folder/file.glb", self.glb());
            disk.insert("folder/wood 1.png", "png");
            let mut found = WithAttributes::default();
            read(&disk, Path::new("folder/file.glb"), &mut found).map(|()| found)
        }
    }

    /// A quad whose primitive has no material and no attribute but its positions.
    fn plain_quad() -> Builder {
        let mut builder = quad();
        builder.document["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("material");
        builder.document["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("NORMAL");
        builder.document["materials"] = json!([]);
        builder.document["textures"] = json!([]);
        builder
    }

    #[test]
    fn vertices_have_normals_colours_and_texture_coordinates() {
        for (component, one) in [(5120, 127.0), (5122, 32767.0), (5126, 1.0)] {
            let mut builder = plain_quad();
            let normals = builder.numbers(component, component != 5126, 3, &[0.0, -one, one].repeat(4));
            builder.set("attributes/NORMAL", json!(normals));
            assert_eq!(builder.attributes().unwrap().vertices, [(Some([0.0, -1.0, 1.0]), None, None); 4]);
        }
        for (component, one) in [(5121, 255.0), (5123, 65535.0), (5126, 1.0)] {
            let mut builder = plain_quad();
            let texture = builder.numbers(component, component != 5126, 2, &[0.0, one].repeat(4));
            builder.set("attributes/TEXCOORD_0", json!(texture));
            let colours = builder.numbers(component, component != 5126, 3, &[0.0, one, one * 0.2].repeat(4));
            builder.set("attributes/COLOR_0", json!(colours));
            // A fifth of the light is 124 in sRGB. Alpha is linear.
            let expected = (None, Some([0, 255, 124, 255]), Some([0.0, 1.0]));
            let found = builder.attributes().unwrap();
            assert_eq!(found.vertices, [expected; 4], "{component}");
            assert_eq!(found.plain, expected_quad());
            let colours = builder.numbers(component, component != 5126, 4, &[0.0, one, one, one * 0.4].repeat(4));
            builder.set("attributes/COLOR_0", json!(colours));
            assert_eq!(builder.attributes().unwrap().vertices[3].1, Some([0, 255, 255, 102]));
        }
    }

    #[test]
    fn normals_turn_with_their_nodes() {
        let mut builder = plain_quad();
        let normals = builder.numbers(5126, false, 3, &[0.0, 0.0, 3.0].repeat(4));
        builder.set("attributes/NORMAL", json!(normals));
        builder.document["nodes"][0]["scale"] = json!([1.0, 1.0, -2.0]);
        assert_eq!(builder.attributes().unwrap().vertices[0].0, Some([0.0, 0.0, -1.0]));
    }

    #[test]
    fn primitives_share_vertices_only_with_all_their_attributes() {
        let mut builder = plain_quad();
        let first = builder.numbers(5126, false, 3, &[0.0, 0.0, 1.0].repeat(4));
        let second = builder.numbers(5126, false, 3, &[0.0, 1.0, 0.0].repeat(4));
        builder.set("attributes/NORMAL", json!(first));
        let primitive = builder.document["meshes"][0]["primitives"][0].clone();
        for normals in [first, second] {
            let mut other = primitive.clone();
            other["attributes"]["NORMAL"] = json!(normals);
            builder.document["meshes"][0]["primitives"].as_array_mut().unwrap().push(other);
        }
        let found = builder.attributes().unwrap();
        assert_eq!((found.plain.vertices.len(), found.plain.announced), (8, Some((8, 6))));
        assert_eq!((found.vertices[0].0, found.vertices[4].0), (Some([0.0, 0.0, 1.0]), Some([0.0, 1.0, 0.0])));
        assert_eq!((&found.plain.faces[2], &found.plain.faces[4]), (&vec![0, 1, 2], &vec![4, 5, 6]));
        assert_eq!(builder.found().vertices.len(), 4);
    }

    #[test]
    fn materials_have_colours_and_images_wherever_they_lie() {
        let mut builder = plain_quad();
        let view = builder.view(b"png here", None);
        let texture =
            |index: usize| json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": index, "texCoord": 1}}});
        builder.document["materials"] = json!([
            {"name": "plain"}, {"pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0, 0.25]}},
            texture(0), texture(1), texture(2), texture(3), texture(4), texture(5),
        ]);
        builder.document["textures"] = json!([
            {"source": 0}, {"source": 1}, {"source": 2}, {"source": 3}, {"source": 4}, {"extensions": {}},
        ]);
        let data = format!("data:image/png;base64,{}", base64(b"another"));
        builder.document["images"] = json!([
            {"bufferView": view, "mimeType": "image/png"}, {"uri": "wood%201.png"}, {"uri": data, "name": "inside"},
            {"uri": "missing.png"}, {"uri": "https://a.b/c.png"},
        ]);
        builder.set("material", json!(3));
        let first = builder.numbers(5126, false, 2, &[0.0; 8]);
        let second = builder.numbers(5126, false, 2, &[1.0; 8]);
        builder.set("attributes/TEXCOORD_0", json!(first));
        builder.set("attributes/TEXCOORD_1", json!(second));
        let found = builder.attributes().unwrap();
        assert!(found.faces.iter().all(|face| face.material == Some(3)));
        assert_eq!(found.vertices[0].2, Some([1.0, 1.0]));
        let colours: Vec<_> = found.materials[..2].iter().map(|material| material.base_colour.unwrap()).collect();
        // Half of the light.
        assert_eq!(colours, [[1.0; 4], [1.0, 0.735_357, 0.0, 0.25]]);
        let images: Vec<_> = found.materials[2..].iter().map(|material| material.image.clone()).collect();
        let named = |number: usize| images[number].clone().map(|image| (image.name, image.source)).unwrap();
        let bytes = builder.glb();
        match named(0) {
            (name, ImageSource::Part { path, offset, length: 8 }) => {
                assert_eq!((name.as_str(), path.as_path()), ("image 0", Path::new("folder/file.glb")));
                assert_eq!(&bytes[offset as usize..][..8], b"png here");
            }
            other => panic!("{other:?}"),
        }
        assert_eq!(named(1), ("wood%201.png".into(), ImageSource::File("folder/wood 1.png".into())));
        assert_eq!(named(2), ("inside".into(), ImageSource::Bytes(b"another".to_vec())));
        assert_eq!(named(3), ("missing.png".into(), ImageSource::Missing));
        assert_eq!(named(4), ("https://a.b/c.png".into(), ImageSource::Missing));
        assert_eq!(images[5], None);
        assert_eq!(found.missing_files, ["folder/missing.png", "'https://a.b/c.png'"].map(PathBuf::from));
    }

    #[test]
    fn broken_attributes_say_where_and_what_and_only_to_who_asks() {
        let colours = |component, width| {
            move |builder: &mut Builder| {
                let colours = builder.numbers(component, true, width, &vec![0.0; width * 4]);
                builder.set("attributes/COLOR_0", json!(colours));
            }
        };
        let set =
            |pointer: &'static str, value: Value| move |builder: &mut Builder| builder.set(pointer, value.clone());
        let texture = |textures: Value, images: Value| {
            move |builder: &mut Builder| {
                let look = json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}});
                builder.document["materials"] = json!([look]);
                builder.document["textures"] = textures.clone();
                builder.document["images"] = images.clone();
            }
        };
        type Change = Box<dyn Fn(&mut Builder)>;
        let cases: Vec<(Change, &str)> = vec![
            (Box::new(set("attributes/NORMAL", json!(77))), "accessor 77: there is no such accessor"),
            (Box::new(set("attributes/NORMAL", json!(1))), "accessor 1: normals are of type VEC3, not SCALAR"),
            (
                Box::new(set("attributes/TEXCOORD_0", json!(0))),
                "accessor 0: texture coordinates are of type VEC2, not VEC3",
            ),
            (Box::new(set("material", json!(1))), "mesh 0, primitive 0: there is no material 1"),
            (Box::new(colours(5122, 3)), "accessor 2: colours are floats, or unsigned integers of 8 or 16 bits"),
            (Box::new(colours(5126, 2)), "accessor 2: colours are of type VEC3 or VEC4, not VEC2"),
            (
                Box::new(|builder: &mut Builder| {
                    let normals = builder.numbers(5126, false, 3, &[0.0; 9]);
                    builder.set("attributes/NORMAL", json!(normals));
                }),
                "mesh 0, primitive 0: accessor 2 has 3 elements for its 4 vertices",
            ),
            (
                Box::new(|builder: &mut Builder| {
                    let colours = builder.numbers(5126, false, 3, &[f64::NAN; 12]);
                    builder.set("attributes/COLOR_0", json!(colours));
                }),
                "accessor 2: colour 0 is not finite",
            ),
            (Box::new(texture(json!([]), json!([]))), "material 0: there is no texture 0"),
            (Box::new(texture(json!([{"source": 2}]), json!([]))), "texture 0: there is no image 2"),
            (
                Box::new(texture(json!([{"source": 0}]), json!([{"name": "a"}]))),
                "image 0: it has neither a URI nor a buffer view",
            ),
            (
                Box::new(texture(json!([{"source": 0}]), json!([{"bufferView": 9}]))),
                "buffer view 9: there is no such buffer view",
            ),
            (
                Box::new(texture(json!([{"source": 0}]), json!([{"uri": "data:;base64,A*"}]))),
                "image 0: character 1 of its data is '*', which is not base64",
            ),
        ];
        for (change, expected) in cases {
            let mut builder = plain_quad();
            change(&mut builder);
            let message = builder.attributes().unwrap_err().to_string();
            assert_eq!(message, format!("folder/file.glb: {expected}"));
            assert_eq!(builder.found(), expected_quad());
        }
    }

    #[test]
    fn indices_come_in_three_widths_or_not_at_all() {
        for component in [5121, 5123, 5125] {
            let mut builder = Builder::new();
            let positions = builder.positions(&QUAD, 4);
            let indices = builder.indices(&TWO, component);
            builder.primitive(positions, Some(indices), Some(4));
            assert_eq!(builder.found(), expected_quad());
        }
        let mut builder = Builder::new();
        let positions = builder.positions(&QUAD[..3], 0);
        builder.primitive(positions, None, None);
        assert_eq!(builder.found().faces, [[0, 1, 2]]);
    }

    #[test]
    fn strips_and_fans_are_cut_and_points_and_lines_stepped_over() {
        let mut builder = Builder::new();
        let positions = builder.positions(&QUAD, 0);
        let strip = builder.indices(&[0, 1, 2, 3, 3, 0], 5121);
        builder.primitive(positions, Some(strip), Some(5));
        builder.primitive(positions, None, Some(6));
        for mode in 0..4 {
            builder.primitive(99, None, Some(mode));
        }
        let collected = builder.found();
        assert_eq!(collected.announced, Some((4, 2)));
        assert_eq!(collected.vertices.len(), 4);
        assert_eq!(collected.faces, [[0, 1, 2], [2, 1, 3], [1, 2, 0], [2, 3, 0]]);
        assert_eq!(collected.left_out, 4);
    }

    #[test]
    fn primitives_that_share_positions_share_vertices() {
        let mut builder = quad();
        let other = builder.positions(&QUAD[..3], 0);
        builder.primitive(other, None, None);
        builder.primitive(0, Some(1), None);
        let collected = builder.found();
        assert_eq!(collected.announced, Some((7, 5)));
        assert_eq!(collected.vertices.len(), 7);
        assert_eq!(collected.faces, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [0, 1, 2], [0, 2, 3]]);
        // But not across nodes.
        builder.document["nodes"] = json!([{"mesh": 0, "children": [1]}, {"mesh": 0}]);
        let collected = builder.found();
        assert_eq!((collected.announced, collected.vertices.len()), (Some((14, 10)), 14));
        assert_eq!(collected.faces[5..7], [[7, 8, 9], [7, 9, 10]]);
    }

    #[test]
    fn transforms_are_composed_down_the_tree() {
        let mut builder = quad();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        builder.document["nodes"] = json!([
            {"children": [2, 1], "translation": [10, 20, 30]},
            {"mesh": 0, "scale": [1, 1, -2]},
            {"children": [3], "rotation": [0, 0, half, half]},
            {"mesh": 0, "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 1, 0, 0, 1]},
        ]);
        let collected = builder.found();
        // Node 3 comes first: it is below the first child. Twice the size, moved along x, turned, moved.
        for (vertex, [x, y, z]) in collected.vertices[..4].iter().zip(widened(&QUAD)) {
            let expected = [10.0 - 2.0 * y, 20.0 + 2.0 * x + 1.0, 30.0 + 2.0 * z];
            assert!(vertex.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12));
        }
        let mirrored: Vec<[f64; 3]> =
            widened(&QUAD).iter().map(|[x, y, z]| [x + 10.0, y + 20.0, 30.0 - 2.0 * z]).collect();
        assert_eq!(collected.vertices[4..], mirrored);
        // A mirror turns triangles inside out, so they are turned back.
        assert_eq!(collected.faces, [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]]);
    }

    #[test]
    fn without_a_transform_not_a_bit_changes() {
        let odd = [[-0.0, f32::MIN_POSITIVE / 4.0, 0.1], [f32::MAX, -1.0, 1e-20], [f32::NAN, f32::INFINITY, 0.0]];
        let mut builder = Builder::new();
        let positions = builder.positions(&odd, 0);
        builder.primitive(positions, None, None);
        builder.document["nodes"] =
            json!([{"children": [1], "scale": [1, 1, 1]}, {"mesh": 0, "rotation": [0, 0, 0, 1]}]);
        let bits = |vertices: &[[f64; 3]]| vertices.iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&builder.found().vertices), bits(&widened(&odd)));
    }

    #[test]
    fn a_geo_referenced_translation_keeps_its_millimetres() {
        let mut builder = quad();
        builder.document["nodes"] = json!([{"mesh": 0, "translation": [456_789.125_123, 5_412_345.001, 0]}]);
        assert_eq!(builder.found().vertices[1], [456_790.125_123, 5_412_345.001, 0.0]);
    }

    #[test]
    fn the_nodes_of_scenes_are_walked_or_all_of_them() {
        let mut builder = quad();
        let faces = |builder: &Builder| builder.found().faces.len();
        builder.document["nodes"] = json!([{"mesh": 0}, {"mesh": 0}, {"mesh": 0, "children": [1]}]);
        builder.document["scenes"] = json!([{"nodes": [0]}, {"nodes": [2, 0]}, {}]);
        assert_eq!(faces(&builder), 2);
        builder.document["scene"] = json!(1);
        assert_eq!(faces(&builder), 6);
        builder.document["scene"] = json!(2);
        assert_eq!(faces(&builder), 0);
        builder.document["scene"] = json!(null);
        assert_eq!(faces(&builder), 6);
        builder.document["scenes"] = json!([]);
        assert_eq!(faces(&builder), 6);
        builder.document["nodes"] = json!([]);
        assert_eq!(faces(&builder), 2);
    }

    #[test]
    fn nodes_that_are_no_trees_are_refused() {
        let mut builder = quad();
        for (nodes, expected) in [
            (json!([{"children": [0]}]), "file: node 0: it is reached twice; the nodes of a scene must be trees"),
            (json!([{"children": [1]}, {"children": [0]}]), "file: node 0: it is reached twice"),
            (json!([{"children": [1, 1]}, {"mesh": 0}]), "file: node 1: it is reached twice"),
            (json!([{"children": [5]}]), "file: node 5: there is no such node"),
            (json!([{"mesh": 3}]), "file: mesh 3: there is no such mesh"),
        ] {
            builder.document["nodes"] = nodes;
            let message = builder.refusal();
            assert!(message.starts_with(expected), "{message}");
        }
        // A tree may be as deep as it likes.
        let mut nodes: Vec<Value> =
            (1..100_000).map(|child| json!({"children": [child], "translation": [1, 0, 0]})).collect();
        nodes.push(json!({"mesh": 0}));
        builder.document["nodes"] = json!(nodes);
        assert_eq!(builder.found().vertices[0], [99_999.0, 0.0, 0.0]);
    }

    #[test]
    fn a_skinned_mesh_stays_as_it_is_stored() {
        let mut builder = quad();
        builder.document["nodes"] = json!([{"mesh": 0, "skin": 0, "scale": [-5, 1, 1]}]);
        assert_eq!(builder.found(), expected_quad());
    }

    #[test]
    fn quantised_positions_are_read() {
        for (component, bytes, normalized, expected) in [
            (5120, vec![0x81_u8, 0x80, 0x7f], true, [-1.0, -1.0, 1.0]),
            (5120, vec![0x81, 0x80, 0x7f], false, [-127.0, -128.0, 127.0]),
            (5121, vec![0, 51, 255], true, [0.0, 0.2, 1.0]),
            (5122, vec![0x01, 0x80, 0, 0, 0xff, 0x7f], true, [-1.0, 0.0, 1.0]),
            (5123, vec![0, 0, 0x33, 0x33, 0xff, 0xff], true, [0.0, 0.2, 1.0]),
            (5123, vec![1, 0, 2, 0, 0xff, 0xff], false, [1.0, 2.0, 65535.0]),
        ] {
            let mut builder = Builder::new();
            builder.document["extensionsRequired"] = json!(["KHR_mesh_quantization", "KHR_materials_unlit"]);
            let size = bytes.len().next_multiple_of(4);
            let mut all = bytes.clone();
            all.resize(size, 0);
            let view = builder.view(&all.repeat(3), Some(size as u64));
            let accessor = json!({"bufferView": view, "componentType": component, "count": 3, "type": "VEC3",
                "normalized": normalized});
            let positions = builder.add("accessors", accessor);
            builder.primitive(positions, None, None);
            assert_eq!(builder.found().vertices, [expected; 3]);
        }
    }

    #[test]
    fn sparse_accessors_are_merged() {
        let mut builder = quad();
        let indices = builder.view(&[1, 0, 3, 0], None);
        let bytes: Vec<u8> = [7_f32, 8.0, 9.0, 4.0, 5.0, 6.0].iter().flat_map(|value| value.to_le_bytes()).collect();
        let values = builder.view(&bytes, None);
        let sparse = json!({"count": 2, "indices": {"bufferView": indices, "componentType": 5123},
            "values": {"bufferView": values}});
        builder.document["accessors"][0]["sparse"] = sparse;
        let mut expected = expected_quad();
        expected.vertices[1] = [7.0, 8.0, 9.0];
        expected.vertices[3] = [4.0, 5.0, 6.0];
        assert_eq!(builder.found(), expected);

        let mut wrong = builder.clone();
        wrong.document["accessors"][0]["sparse"]["indices"]["componentType"] = json!(5121);
        assert_eq!(wrong.refusal(), "file: accessor 0: sparse index 0 is out of order or out of range");
        wrong.document["accessors"][0]["sparse"]["indices"]["componentType"] = json!(5126);
        assert_eq!(wrong.refusal(), "file: accessor 0: 5126 is not a component type for sparse indices");
        let mut wrong = builder.clone();
        wrong.document["accessors"][0]["sparse"]["count"] = json!(3);
        assert!(
            wrong.refusal().starts_with("file: accessor 0: its 3 elements from byte 0 on reach beyond the 4 bytes")
        );
        let mut wrong = builder.clone();
        wrong.document["accessors"][0].as_object_mut().unwrap().remove("bufferView");
        assert!(wrong.refusal().contains("accessor 0: a sparse accessor without a buffer view is not supported"));
    }

    #[test]
    fn extensions_that_hide_triangles_are_refused_with_advice() {
        for name in ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "ACME_secret"] {
            let mut builder = quad();
            builder.document["extensionsRequired"] = json!(["KHR_texture_basisu", name]);
            let message = builder.refusal();
            let expected = format!("file: the glTF extension {name} is not supported; write the asset again without");
            assert!(message.starts_with(&expected), "{message}");
        }
        let mut builder = quad();
        let draco = json!({"KHR_draco_mesh_compression": {"bufferView": 0}});
        builder.document["meshes"][0]["primitives"][0]["extensions"] = draco;
        assert_eq!(builder.found(), expected_quad());
        builder.document["accessors"][0].as_object_mut().unwrap().remove("bufferView");
        assert!(builder.refusal().contains("KHR_draco_mesh_compression is not supported"));
        let mut builder = quad();
        builder.document["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {}});
        assert!(builder.refusal().contains("EXT_mesh_gpu_instancing is not supported"));
        let mut builder = quad();
        builder.document["meshes"][0]["primitives"][0]["attributes"] = json!({});
        assert!(builder.refusal().contains("mesh 0, primitive 0: a primitive without positions is not supported"));
    }

    #[test]
    fn other_versions_are_refused() {
        let mut builder = quad();
        builder.document["asset"]["version"] = json!("3.0");
        assert!(builder.refusal().starts_with("file: glTF version 3.0 is not supported"));
        let first = json!({"asset": {"version": "1.0"}, "meshes": {"mesh1": {}}}).to_string();
        let message = read_glb(first.as_bytes()).unwrap_err().to_string();
        assert_eq!(message, "file: glTF version 1.0 is not supported; convert it to glTF 2.0");
        let mut bytes = quad().glb();
        bytes[4] = 1;
        let message = read_glb(&bytes).unwrap_err().to_string();
        assert_eq!(message, "file: binary glTF version 1 is not supported; convert it to glTF 2.0");
    }

    #[test]
    fn lengths_that_do_not_fit_are_refused() {
        for (pointer, value, expected) in [
            (
                "/accessors/0/count",
                json!(5),
                "accessor 0: its 5 elements from byte 0 on reach beyond the 48 bytes of buffer view 0",
            ),
            ("/accessors/0/count", json!(u64::MAX), "accessor 0: its 18446744073709551615 elements"),
            (
                "/accessors/0/byteOffset",
                json!(u64::MAX),
                "accessor 0: its 4 elements from byte 18446744073709551615 on",
            ),
            ("/accessors/0/bufferView", json!(9), "accessor 0: there is no buffer view 9"),
            ("/accessors/0/bufferView", json!(null), "accessor 0: it has no buffer view"),
            ("/accessors/0/type", json!("VEC2"), "accessor 0: positions are of type VEC3, not VEC2"),
            ("/accessors/0/componentType", json!(5125), "accessor 0: positions are floats"),
            ("/accessors/0/componentType", json!(5130), "accessor 0: 5130 is not a component type"),
            ("/accessors/1/componentType", json!(5122), "accessor 1: vertex numbers are of type SCALAR"),
            ("/accessors/1/type", json!("VEC3"), "accessor 1: vertex numbers are of type SCALAR"),
            ("/accessors/1/count", json!(5), "mesh 0, primitive 0: its 5 corners are not a multiple of 3"),
            ("/bufferViews/0/byteLength", json!(u64::MAX), "buffer view 0: 18446744073709551615 bytes from byte 0 on"),
            (
                "/bufferViews/0/byteOffset",
                json!(13),
                "buffer view 0: 48 bytes from byte 13 on reach beyond the 60 bytes of buffer 0",
            ),
            ("/bufferViews/0/buffer", json!(1), "buffer view 0: there is no buffer 1"),
            (
                "/bufferViews/0/byteStride",
                json!(8),
                "accessor 0: its elements have 12 bytes, but buffer view 0 puts one every 8",
            ),
            ("/bufferViews/0/byteStride", json!(u64::MAX), "accessor 0: its 4 elements from byte 0 on reach beyond"),
            ("/meshes/0/primitives/0/indices", json!(2), "accessor 2: there is no such accessor"),
            ("/meshes/0/primitives/0/attributes/POSITION", json!(2), "accessor 2: there is no such accessor"),
            ("/meshes/0/primitives/0/mode", json!(7), "mesh 0, primitive 0: 7 is not a mode of primitives"),
            ("/scene", json!(1), "JSON document: there is no scene 1"),
            ("/scenes/0/nodes/0", json!(-1), "JSON document: invalid value: integer `-1`"),
            ("/nodes/0/mesh", json!("a"), "JSON document: invalid type: string \"a\""),
            ("/accessors/0/count", json!(1.5), "JSON document: invalid type: floating point `1.5`"),
        ] {
            let mut builder = quad();
            builder.document["bufferViews"][0]["byteStride"] = json!(null);
            builder.document["accessors"][0]["byteOffset"] = json!(0);
            builder.document["meshes"][0]["primitives"][0]["mode"] = json!(4);
            *builder.document.pointer_mut(pointer).unwrap() = value.clone();
            let message = builder.refusal();
            assert!(message.starts_with(&format!("file: {expected}")), "{pointer} = {value}: {message}");
        }
    }

    #[test]
    fn an_index_does_not_reach_into_other_primitives() {
        let mut builder = quad();
        let indices = builder.indices(&[0, 1, 4], 5121);
        builder.primitive(0, Some(indices), None);
        let other = builder.positions(&QUAD, 0);
        builder.primitive(other, None, Some(6));
        let message = builder.refusal();
        assert_eq!(message, "file: mesh 0, primitive 1, corner 2: it names vertex 4, but there are 4 vertices");
    }

    #[test]
    fn a_file_cut_or_altered_anywhere_does_no_harm() {
        let bytes = quad().glb();
        for length in 0..bytes.len() {
            assert!(read_glb(&bytes[..length]).is_err(), "{length}");
        }
        for place in 0..bytes.len() {
            for value in [0, 1, 0x7f, 0xff, b' ', b'9', bytes[place] ^ 1] {
                let mut altered = bytes.clone();
                altered[place] = value;
                let _ = read_glb(&altered);
            }
        }
        let text = quad().gltf("a.bin");
        let disk = MemoryDisk::new();
        disk.insert("a.bin", quad().buffer);
        for length in 0..text.len() {
            disk.insert("file.gltf", &text.as_bytes()[..length]);
            assert!(read_from(&disk, "file.gltf").is_err(), "{length}");
        }
    }

    #[test]
    fn odd_chunks_are_stepped_over_or_refused() {
        let document = r#"{"asset": {"version": "2.0"}}"#;
        assert_eq!(read_glb(&glb_of(document, None)).unwrap().announced, Some((0, 0)));
        assert_eq!(read_glb(&glb_of(&format!("{document}\0\0\0"), None)).unwrap().announced, Some((0, 0)));
        let mut bytes = glb_of(document, None);
        bytes[16] = b'X';
        let message = read_glb(&bytes).unwrap_err().to_string();
        assert_eq!(message, "file: chunk 0: the first chunk is not the JSON document");
        let mut bytes = glb_of(document, None);
        bytes[12] = 0xff;
        let message = read_glb(&bytes).unwrap_err().to_string();
        assert_eq!(message, "file: chunk 0: 255 bytes, but only 32 are left of the file");
        let message = read_glb(&glb_of(document, None)[..30]).unwrap_err().to_string();
        assert_eq!(message, "file: header: the file has 30 bytes; the header promises 52");
        // An unknown chunk between the two.
        let builder = quad();
        let whole = builder.glb();
        let json_end = whole.len() - builder.buffer.len() - 8;
        let mut bytes = whole[..json_end].to_vec();
        bytes.extend_from_slice(b"\x04\0\0\0ODD!abcd");
        bytes.extend_from_slice(&whole[json_end..]);
        let length = bytes.len() as u32;
        bytes[8..12].copy_from_slice(&length.to_le_bytes());
        assert_eq!(read_glb(&bytes).unwrap(), expected_quad());
    }

    #[test]
    fn a_failing_disk_is_no_fault_of_the_document() {
        let disk = MemoryDisk::new();
        disk.insert("file", quad().glb());
        let faulty = FaultyDisk::new(Arc::new(disk));
        for reads in 0..100 {
            faulty.fail_reads_after(reads);
            match read_from(&faulty, "file") {
                Ok(found) => {
                    assert!(reads > 4 && found == expected_quad());
                    return;
                }
                Err(error) => assert!(matches!(error, MeshError::Storage(_)), "{error}"),
            }
        }
        panic!("the asset takes more than a hundred reads");
    }

    /// A file of which only the first bytes exist, and zeros behind them.
    #[derive(Debug)]
    struct Huge {
        start: Vec<u8>,
        length: u64,
    }

    impl storage::ReadAt for Huge {
        fn path(&self) -> &Path {
            Path::new("huge.bin")
        }

        fn length(&self) -> u64 {
            self.length
        }

        fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<usize, storage::StorageError> {
            let count = self.length.saturating_sub(offset).min(buffer.len() as u64) as usize;
            for (place, byte) in (offset..).zip(&mut buffer[..count]) {
                // The last bytes repeat the first.
                let repeated = place.checked_sub(self.length - self.start.len() as u64);
                *byte = repeated.and_then(|place| self.start.get(place as usize).copied()).unwrap_or(0);
            }
            Ok(count)
        }
    }

    #[derive(Debug)]
    struct HugeDisk {
        document: MemoryDisk,
        start: Vec<u8>,
        length: u64,
    }

    impl Disk for HugeDisk {
        fn open(&self, path: &Path) -> Result<Arc<dyn storage::ReadAt>, storage::StorageError> {
            if path == Path::new("huge.bin") {
                return Ok(Arc::new(Huge { start: self.start.clone(), length: self.length }));
            }
            self.document.open(path)
        }

        fn create_new(&self, path: &Path) -> Result<Box<dyn storage::WriteFile>, storage::StorageError> {
            self.document.create_new(path)
        }

        fn rename(&self, from: &Path, to: &Path) -> Result<(), storage::StorageError> {
            self.document.rename(from, to)
        }

        fn remove(&self, path: &Path) -> Result<(), storage::StorageError> {
            self.document.remove(path)
        }

        fn list(&self, folder: &Path) -> Result<Vec<std::path::PathBuf>, storage::StorageError> {
            self.document.list(folder)
        }

        fn exists(&self, path: &Path) -> bool {
            self.document.exists(path)
        }
    }

    #[test]
    fn offsets_beyond_four_gibibytes_are_reached() {
        let mut builder = quad();
        let length = 5_u64 << 30;
        let base = length - builder.buffer.len() as u64;
        for view in builder.list("bufferViews") {
            view["byteOffset"] = json!(view["byteOffset"].as_u64().unwrap() + base);
        }
        let mut document = builder.document.clone();
        document["buffers"] = json!([{"byteLength": length, "uri": "huge.bin"}]);
        let disk = HugeDisk { document: MemoryDisk::new(), start: builder.buffer.clone(), length };
        disk.document.insert(PathBuf::from("file.gltf"), document.to_string());
        assert_eq!(read_from(&disk, "file.gltf").unwrap(), expected_quad());
    }

    proptest! {
        #[test]
        fn every_variant_reads_back(
            (vertices, faces) in meshes(),
            component in prop::sample::select(vec![5121_u32, 5123, 5125]),
            gap in prop::sample::select(vec![0_usize, 4, 12]),
            embedded: bool,
        ) {
            let mut builder = Builder::new();
            let positions = builder.positions(&vertices, gap);
            let corners: Vec<u32> = faces.iter().flat_map(|face| &face[..3]).map(|&corner| corner as u32).collect();
            let indices = builder.indices(&corners, component);
            builder.primitive(positions, Some(indices), None);
            let disk = MemoryDisk::new();
            if embedded {
                disk.insert("file", builder.gltf(&format!("data:;base64,{}", base64(&builder.buffer))));
            } else {
                disk.insert("file", builder.glb());
            }
            let collected = read_from(&disk, "file").unwrap();
            prop_assert_eq!(collected.announced, Some((vertices.len() as u64, faces.len() as u64)));
            prop_assert_eq!(collected.vertices, widened(&vertices));
            let triangles: Vec<Vec<i64>> = faces.iter().map(|face| face[..3].to_vec()).collect();
            prop_assert_eq!(collected.faces, triangles);
        }
    }
}
