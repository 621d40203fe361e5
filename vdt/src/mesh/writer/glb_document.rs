//! The JSON document of a GLB file: one mesh, as `glb` lays it out.
//!
//! Memory: the document, some hundred bytes for each material and image.

use serde_json::{Value, json};

use super::super::srgb::linear_of_srgb;
use super::{CoordinateType, LayoutAttributes, MeshLayout};
use crate::tree::Material;

/// Type of components: 16 bits without a sign.
const UNSIGNED_SHORT: u32 = 5123;
/// Type of components: 32 bits without a sign.
const UNSIGNED_INT: u32 = 5125;
/// Type of components: single precision.
const FLOAT: u32 = 5126;
/// Target of a buffer view: attributes of vertices.
const ARRAY_BUFFER: u32 = 34962;
/// Target of a buffer view: vertex numbers.
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// A number of as many letters as a coordinate can have.
const WIDEST_NUMBER: f64 = -1.175_494_350_822_287_5e-38;
/// Bytes for six coordinates that are written in another way than that one.
const SLACK: usize = 64;

/// What the document tells that is not in the layout. Offsets and lengths are in bytes; offsets are those in the binary chunk.
#[derive(Debug)]
pub(super) struct Document {
    /// The images, none where it is left out.
    pub images: Vec<Option<PlacedImage>>,
    /// Where the vertices begin.
    pub vertices_at: u64,
    /// Length of a vertex.
    pub stride: u64,
    /// The smallest and the largest coordinates, as they are written.
    pub bounds: [[f64; 3]; 2],
    /// The triangles by material.
    pub groups: Vec<Group>,
    /// Length of the binary chunk.
    pub binary_bytes: u64,
    /// Blanks behind the document.
    slack: usize,
}

/// An image in the binary chunk.
#[derive(Debug, Clone)]
pub(super) struct PlacedImage {
    pub offset: u64,
    pub length: u64,
    /// Its media type.
    pub mime: &'static str,
}

/// The triangles of a material.
#[derive(Debug, Clone)]
pub(super) struct Group {
    /// Which material, counted from 0.
    pub material: Option<u32>,
    /// Where they begin, from the beginning of all triangles on.
    pub offset: u64,
    pub triangles: u64,
}

impl Document {
    /// Of a mesh without triangles or images, so far.
    pub fn empty(stride: u64) -> Self {
        Document {
            images: Vec::new(),
            vertices_at: 0,
            stride,
            bounds: [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]],
            groups: Vec::new(),
            binary_bytes: 0,
            slack: 0,
        }
    }

    /// One that is as long as the document of a mesh with this layout can be.
    pub fn widest(layout: &MeshLayout, stride: u64) -> Self {
        let most = u64::from(u32::MAX);
        let appearance = layout.attributes.as_ref().map(|attributes| &attributes.appearance);
        let images = appearance.map_or(0, |appearance| appearance.images.len());
        let materials = appearance.map_or(0, |appearance| appearance.materials.len() as u32);
        let of_materials = (0..materials).map(Some).chain([None]);
        Document {
            images: vec![Some(PlacedImage { offset: most, length: most, mime: "image/jpeg" }); images],
            vertices_at: most,
            stride,
            bounds: [[WIDEST_NUMBER; 3]; 2],
            groups: of_materials.map(|material| Group { material, offset: most, triangles: most }).collect(),
            binary_bytes: most,
            slack: SLACK,
        }
    }

    /// The document as text.
    pub fn to_json(&self, layout: &MeshLayout) -> String {
        let mut asset = json!({ "version": "2.0", "generator": "vdt" });
        if !layout.comments.is_empty() {
            asset["extras"] = json!({ "comments": layout.comments });
        }
        let mut document = json!({ "asset": asset, "scene": 0, "scenes": [{}] });
        if !self.groups.is_empty() && layout.triangles > 0 {
            self.add_mesh(layout, &mut document);
        }
        let mut text = document.to_string();
        text.extend(std::iter::repeat_n(' ', self.slack));
        text
    }

    fn add_mesh(&self, layout: &MeshLayout, document: &mut Value) {
        document["scenes"] = json!([{ "nodes": [0] }]);
        let mut node = json!({ "mesh": 0 });
        if layout.coordinates == CoordinateType::Double && layout.origin != [0.0; 3] {
            node["translation"] = json!(layout.origin);
        }
        document["nodes"] = json!([node]);
        document["buffers"] = json!([{ "byteLength": self.binary_bytes }]);
        let vertex_bytes = layout.vertices * self.stride;
        let corners_at = self.vertices_at + vertex_bytes;
        let mut views = vec![
            json!({
                "buffer": 0,
                "byteOffset": self.vertices_at,
                "byteLength": vertex_bytes,
                "byteStride": self.stride,
                "target": ARRAY_BUFFER,
            }),
            json!({
                "buffer": 0,
                "byteOffset": corners_at,
                "byteLength": layout.triangles * 12,
                "target": ELEMENT_ARRAY_BUFFER,
            }),
        ];
        let mut accessors = Vec::new();
        let attributes = self.add_attributes(layout, &mut accessors);
        let primitives: Vec<Value> = self
            .groups
            .iter()
            .map(|group| {
                accessors.push(json!({
                    "bufferView": 1,
                    "byteOffset": group.offset,
                    "componentType": UNSIGNED_INT,
                    "count": group.triangles * 3,
                    "type": "SCALAR",
                }));
                let mut primitive = json!({ "attributes": attributes, "indices": accessors.len() - 1 });
                if let Some(material) = group.material {
                    primitive["material"] = json!(material);
                }
                primitive
            })
            .collect();
        document["meshes"] = json!([{ "primitives": primitives }]);
        document["accessors"] = json!(accessors);
        if let Some(attributes) = &layout.attributes {
            self.add_looks(attributes, &mut views, document);
        }
        document["bufferViews"] = json!(views);
    }

    /// Adds the accessors of the vertices. Says which attribute has which.
    fn add_attributes(&self, layout: &MeshLayout, accessors: &mut Vec<Value>) -> Value {
        let kinds = layout.attributes.as_ref().map(|attributes| attributes.appearance.kinds).unwrap_or_default();
        let [minimum, maximum] = self.bounds;
        let mut attributes = json!({});
        let mut offset = 0;
        let mut add = |name: &str, kind: &str, component: u32, bytes: u64| {
            let mut accessor = json!({
                "bufferView": 0,
                "byteOffset": offset,
                "componentType": component,
                "count": layout.vertices,
                "type": kind,
            });
            if name == "POSITION" {
                accessor["min"] = json!(minimum);
                accessor["max"] = json!(maximum);
            }
            if component == UNSIGNED_SHORT {
                accessor["normalized"] = json!(true);
            }
            attributes[name] = json!(accessors.len());
            accessors.push(accessor);
            offset += bytes;
        };
        add("POSITION", "VEC3", FLOAT, 12);
        if kinds.normals {
            add("NORMAL", "VEC3", FLOAT, 12);
        }
        if kinds.textures {
            add("TEXCOORD_0", "VEC2", FLOAT, 8);
        }
        if kinds.colours {
            add("COLOR_0", "VEC4", UNSIGNED_SHORT, 8);
        }
        attributes
    }

    /// Adds materials, textures and images.
    fn add_looks(&self, attributes: &LayoutAttributes, views: &mut Vec<Value>, document: &mut Value) {
        let LayoutAttributes { appearance, has_alpha, .. } = attributes;
        let mut images = Vec::new();
        // The number of each image that is in the file.
        let mut numbers = vec![None; appearance.images.len()];
        for ((image, placed), number) in appearance.images.iter().zip(&self.images).zip(&mut numbers) {
            let Some(PlacedImage { offset, length, mime }) = placed else { continue };
            views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": length }));
            *number = Some(images.len());
            images.push(json!({ "name": image.name, "bufferView": views.len() - 1, "mimeType": mime }));
        }
        let has_alpha = *has_alpha && appearance.kinds.colours;
        let materials: Vec<Value> = appearance
            .materials
            .iter()
            .map(|material| {
                let image = material.image.and_then(|image| numbers.get(image as usize).copied().flatten());
                look(material, image, has_alpha)
            })
            .collect();
        if !materials.is_empty() {
            document["materials"] = json!(materials);
        }
        if !images.is_empty() {
            let textures: Vec<Value> = (0..images.len()).map(|number| json!({ "source": number })).collect();
            document["textures"] = json!(textures);
            document["images"] = json!(images);
        }
    }
}

/// A material with the texture of this number.
fn look(material: &Material, texture: Option<usize>, has_alpha: bool) -> Value {
    let mut surface = json!({ "metallicFactor": 0 });
    let mut is_clear = has_alpha;
    if let Some(colour) = material.base_colour {
        let [red, green, blue, alpha] = colour.map(|channel| f64::from(channel).clamp(0.0, 1.0));
        let [red, green, blue] = [red, green, blue].map(linear_of_srgb);
        surface["baseColorFactor"] = json!([red, green, blue, alpha]);
        is_clear |= alpha < 1.0;
    }
    if let Some(texture) = texture {
        surface["baseColorTexture"] = json!({ "index": texture });
    }
    let mut found = json!({ "pbrMetallicRoughness": surface });
    if !material.name.is_empty() {
        found["name"] = json!(material.name);
    }
    if is_clear {
        found["alphaMode"] = json!("BLEND");
    }
    found
}
