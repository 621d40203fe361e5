//! The JSON document of a glTF asset: of all that it may say, what leads to triangles.
//!
//! Members that are not listed here (animations, cameras, ...) are stepped over without being held, so they may be as new
//! or as odd as they like. Materials, textures and images are read only where they are wanted ([`Looks`]). Node transforms are read as f64: geo-referenced assets keep their
//! metres there. All values are as the file has them; whoever uses an index or a length checks it.
//!
//! Format: glTF 2.0 specification, section 5 ("Properties Reference").

use std::io::Read;
use std::path::Path;

use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};
use storage::{SequentialReader, StorageError};

use super::super::MeshError;
use super::container::Container;

/// The largest document that is read: it is held in RAM, and may expand to a few times its size there.
const DOCUMENT_LIMIT: u64 = 256 << 20;

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document {
    pub asset: Asset,
    #[serde(default)]
    pub extensions_required: Vec<String>,
    pub scene: Option<usize>,
    #[serde(default)]
    pub scenes: Vec<Scene>,
    #[serde(default)]
    pub nodes: Vec<Node>,
    #[serde(default)]
    pub meshes: Vec<Mesh>,
    #[serde(default)]
    pub accessors: Vec<Accessor>,
    #[serde(default)]
    pub buffer_views: Vec<BufferView>,
    #[serde(default)]
    pub buffers: Vec<Buffer>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Asset {
    pub version: String,
}

#[derive(Debug, Deserialize)]
pub(super) struct Scene {
    #[serde(default)]
    pub nodes: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct Node {
    #[serde(default)]
    pub children: Vec<usize>,
    pub mesh: Option<usize>,
    pub skin: Option<IgnoredAny>,
    /// Column by column.
    pub matrix: Option<[f64; 16]>,
    pub translation: Option<[f64; 3]>,
    /// A unit quaternion: x, y, z, w.
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
    #[serde(default)]
    pub extensions: NodeExtensions,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub instancing: Option<IgnoredAny>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Mesh {
    #[serde(default)]
    pub primitives: Vec<Primitive>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Primitive {
    pub attributes: Attributes,
    pub indices: Option<usize>,
    pub material: Option<u32>,
    #[serde(default = "triangles")]
    pub mode: u32,
    #[serde(default)]
    pub extensions: PrimitiveExtensions,
}

fn triangles() -> u32 {
    4
}

#[derive(Debug, Deserialize)]
pub(super) struct Attributes {
    #[serde(rename = "POSITION")]
    pub position: Option<usize>,
    #[serde(rename = "NORMAL")]
    pub normal: Option<usize>,
    #[serde(rename = "COLOR_0")]
    pub colour: Option<usize>,
    #[serde(rename = "TEXCOORD_0")]
    pub texture_0: Option<usize>,
    #[serde(rename = "TEXCOORD_1")]
    pub texture_1: Option<usize>,
    #[serde(rename = "TEXCOORD_2")]
    pub texture_2: Option<usize>,
    #[serde(rename = "TEXCOORD_3")]
    pub texture_3: Option<usize>,
}

impl Attributes {
    /// The texture coordinates of a set.
    pub fn texture(&self, set: u32) -> Option<usize> {
        match set {
            0 => self.texture_0,
            1 => self.texture_1,
            2 => self.texture_2,
            3 => self.texture_3,
            _ => None,
        }
    }
}

/// How the surface looks, of the same document.
#[derive(Debug, Default, Deserialize)]
pub(super) struct Looks {
    #[serde(default)]
    pub materials: Vec<DocumentMaterial>,
    #[serde(default)]
    pub textures: Vec<Texture>,
    #[serde(default)]
    pub images: Vec<DocumentImage>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct DocumentMaterial {
    #[serde(default)]
    pub name: String,
    #[serde(default)]
    pub pbr_metallic_roughness: BaseLook,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BaseLook {
    /// Linear.
    pub base_color_factor: Option<[f64; 4]>,
    pub base_color_texture: Option<TextureReference>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TextureReference {
    pub index: usize,
    /// The set of texture coordinates.
    #[serde(default)]
    pub tex_coord: u32,
}

#[derive(Debug, Deserialize)]
pub(super) struct Texture {
    /// Its image; none where only an extension has one.
    pub source: Option<usize>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct DocumentImage {
    pub name: Option<String>,
    pub uri: Option<String>,
    pub buffer_view: Option<usize>,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub draco: Option<IgnoredAny>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub buffer_view: Option<usize>,
    #[serde(default)]
    pub byte_offset: u64,
    pub component_type: u32,
    #[serde(default)]
    pub normalized: bool,
    pub count: u64,
    #[serde(rename = "type")]
    pub kind: String,
    pub sparse: Option<Sparse>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Sparse {
    pub count: u64,
    pub indices: SparseIndices,
    pub values: SparseValues,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub buffer_view: usize,
    #[serde(default)]
    pub byte_offset: u64,
    pub component_type: u32,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub buffer_view: usize,
    #[serde(default)]
    pub byte_offset: u64,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: u64,
    pub byte_length: u64,
    pub byte_stride: Option<u64>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer {
    pub uri: Option<String>,
    pub byte_length: u64,
}

/// An asset of any version: only what tells the version.
#[derive(Debug, Deserialize)]
struct AnyVersion {
    asset: Asset,
}

/// Reads the document, and refuses assets of other versions and those that need unknown extensions.
pub(super) fn read_document(path: &Path, container: &Container) -> Result<Document, MeshError> {
    if container.document_length > DOCUMENT_LIMIT {
        return Err(MeshError::Unsupported {
            path: path.to_path_buf(),
            feature: format!("a JSON document of {} bytes (at most {DOCUMENT_LIMIT})", container.document_length),
            advice: "keep the buffers in .bin files beside it, or convert it to .glb".to_string(),
        });
    }
    let document = match parse::<Document>(path, container) {
        Ok(document) => document,
        // Other versions have other shapes. If this is one, say so rather than what is odd about its shape.
        Err(error) => match parse::<AnyVersion>(path, container) {
            Ok(document) => {
                check_version(path, &document.asset.version)?;
                return Err(error);
            }
            Err(_) => return Err(error),
        },
    };
    check_version(path, &document.asset.version)?;
    match document.extensions_required.iter().find(|name| !is_harmless(name)) {
        Some(name) => Err(unsupported_extension(path, name)),
        None => Ok(document),
    }
}

/// Reads how the surface looks.
pub(super) fn read_looks(path: &Path, container: &Container) -> Result<Looks, MeshError> {
    parse(path, container)
}

fn parse<T: DeserializeOwned>(path: &Path, container: &Container) -> Result<T, MeshError> {
    let reader = SequentialReader::starting_at(container.file.clone(), container.document_offset);
    let mut deserializer = serde_json::Deserializer::from_reader(reader.take(container.document_length));
    // What follows the document is not looked at: some writers fill the chunk with zero bytes instead of spaces.
    T::deserialize(&mut deserializer).map_err(|error| {
        if error.is_io() {
            match std::io::Error::from(error).downcast::<StorageError>() {
                Ok(error) => error.into(),
                Err(error) => StorageError::io(path, "read", error).into(),
            }
        } else {
            MeshError::malformed(path, "JSON document", error.to_string())
        }
    })
}

fn check_version(path: &Path, version: &str) -> Result<(), MeshError> {
    if version.split('.').next() == Some("2") {
        return Ok(());
    }
    Err(MeshError::Unsupported {
        path: path.to_path_buf(),
        feature: format!("glTF version {version}"),
        advice: "convert it to glTF 2.0".to_string(),
    })
}

/// Whether a reader that knows nothing of the extension `name` still reads the right triangles, or one that knows it
/// is right here.
fn is_harmless(name: &str) -> bool {
    const PREFIXES: [&str; 6] =
        ["KHR_materials_", "EXT_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_"];
    const NAMES: [&str; 5] = [
        "KHR_mesh_quantization",
        "KHR_animation_pointer",
        "KHR_techniques_webgl",
        "KHR_xmp_json_ld",
        "EXT_lights_image_based",
    ];
    NAMES.contains(&name) || PREFIXES.iter().any(|prefix| name.starts_with(prefix))
}

/// The refusal of an asset that needs the extension `name`.
pub(super) fn unsupported_extension(path: &Path, name: &str) -> MeshError {
    let advice = match name {
        "KHR_draco_mesh_compression" | "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "write the asset again without mesh compression (for example 'gltf-transform copy in.glb out.glb', \
             or 'gltfpack' without -c)"
        }
        "EXT_mesh_gpu_instancing" => "write the asset again with a node for each instance",
        _ => "write the asset again without it",
    };
    MeshError::Unsupported {
        path: path.to_path_buf(),
        feature: format!("the glTF extension {name}"),
        advice: advice.to_string(),
    }
}
