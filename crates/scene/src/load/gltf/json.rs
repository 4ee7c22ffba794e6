//! The fields of a glTF document that determine its triangles (glTF 2.0 specification, section 5). All other
//! fields are skipped.
//!
//! Only JSON types are checked here. Indices, counts and offsets are unchecked values from the file.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

use super::source::MESHOPT;

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Root {
    pub(super) asset: Asset,
    pub(super) scene: Option<usize>,
    #[serde(default)]
    pub(super) scenes: Vec<SceneNodes>,
    #[serde(default)]
    pub(super) nodes: Vec<Node>,
    #[serde(default)]
    pub(super) meshes: Vec<Mesh>,
    /// The materials as any JSON, so that a fault in a material does not make the scene unreadable. The same
    /// applies to the animations.
    #[serde(default)]
    pub(super) materials: Vec<Value>,
    #[serde(default)]
    pub(super) animations: Vec<Value>,
    #[serde(default)]
    pub(super) accessors: Vec<Accessor>,
    #[serde(default)]
    pub(super) buffer_views: Vec<BufferView>,
    #[serde(default)]
    pub(super) buffers: Vec<Buffer>,
    #[serde(default)]
    pub(super) extensions_required: Vec<String>,
    #[serde(default)]
    pub(super) extensions_used: Vec<String>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Asset {
    pub(super) version: String,
    pub(super) min_version: Option<String>,
}

#[derive(Debug, Deserialize)]
pub(super) struct SceneNodes {
    #[serde(default)]
    pub(super) nodes: Vec<usize>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Node {
    pub(super) name: Option<String>,
    #[serde(default)]
    pub(super) children: Vec<usize>,
    pub(super) mesh: Option<usize>,
    pub(super) skin: Option<Value>,
    pub(super) extensions: Option<Box<NodeExtensions>>,
    pub(super) extras: Option<Box<Value>>,
    /// The column-major matrix. Boxed, because few nodes have one.
    pub(super) matrix: Option<Box<[f64; 16]>>,
    pub(super) translation: Option<Box<[f64; 3]>>,
    /// The quaternion x, y, z, w.
    pub(super) rotation: Option<Box<[f64; 4]>>,
    pub(super) scale: Option<Box<[f64; 3]>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(super) instancing: Option<Instancing>,
    #[serde(rename = "KHR_node_visibility")]
    pub(super) visibility: Option<Visibility>,
}

/// The visibility of a node and of its descendants (KHR_node_visibility).
#[derive(Debug, Deserialize)]
pub(super) struct Visibility {
    pub(super) visible: Option<bool>,
}

/// Instances of a node's mesh (EXT_mesh_gpu_instancing).
#[derive(Debug, Deserialize)]
pub(super) struct Instancing {
    pub(super) attributes: InstanceAttributes,
}

/// The indices of the accessors of the instances' transforms.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) struct InstanceAttributes {
    pub(super) translation: Option<usize>,
    pub(super) rotation: Option<usize>,
    pub(super) scale: Option<usize>,
}

impl Node {
    /// Returns the instances of the node's mesh, if the node has instances.
    pub(super) fn instances(&self) -> Option<&InstanceAttributes> {
        Some(&self.extensions.as_ref()?.instancing.as_ref()?.attributes)
    }

    /// Returns true if the node hides itself and its descendants.
    pub(super) fn is_hidden(&self) -> bool {
        let visibility = self.extensions.as_ref().and_then(|e| e.visibility.as_ref());
        visibility.is_some_and(|v| v.visible == Some(false))
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct Mesh {
    pub(super) name: Option<String>,
    pub(super) extras: Option<Box<Value>>,
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Primitive {
    pub(super) attributes: Attributes,
    pub(super) indices: Option<usize>,
    pub(super) material: Option<Value>,
    pub(super) mode: Option<u32>,
    pub(super) extensions: Option<Box<PrimitiveExtensions>>,
}

impl Primitive {
    /// Returns the primitive's Draco data, or `None` if the primitive is not compressed.
    pub(super) fn draco(&self) -> Option<&Draco> {
        self.extensions.as_ref()?.draco.as_ref()
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub(super) draco: Option<Draco>,
}

/// A compressed primitive (KHR_draco_mesh_compression).
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Draco {
    pub(super) buffer_view: usize,
    /// The ids of the attributes in the compressed data, by the names of the glTF attributes.
    #[serde(default)]
    pub(super) attributes: BTreeMap<String, u32>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) struct Attributes {
    pub(super) position: Option<usize>,
    #[serde(default, deserialize_with = "index")]
    texcoord_0: Option<usize>,
    #[serde(default, deserialize_with = "index")]
    texcoord_1: Option<usize>,
    #[serde(default, deserialize_with = "index")]
    texcoord_2: Option<usize>,
    #[serde(default, deserialize_with = "index")]
    texcoord_3: Option<usize>,
    #[serde(default, deserialize_with = "index")]
    pub(super) color_0: Option<usize>,
}

impl Attributes {
    /// Returns the index of the accessor of texture coordinate set `set`. Only sets 0 to 3 are supported.
    pub(super) fn coordinates(&self, set: u64) -> Option<usize> {
        [
            self.texcoord_0,
            self.texcoord_1,
            self.texcoord_2,
            self.texcoord_3,
        ]
        .get(set as usize)
        .copied()?
    }
}

/// Reads an index, or `None` for any other JSON, so that a fault in an attribute that most scenes do not need
/// is ignored.
fn index<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Option<usize>, D::Error> {
    Ok(Value::deserialize(from)?
        .as_u64()
        .and_then(|n| usize::try_from(n).ok()))
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: Option<usize>,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: u32,
    #[serde(default)]
    pub(super) normalized: bool,
    pub(super) count: u64,
    #[serde(rename = "type")]
    pub(super) shape: String,
    pub(super) sparse: Option<Box<Sparse>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Sparse {
    pub(super) count: u64,
    pub(super) indices: SparseIndices,
    pub(super) values: SparseValues,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub(super) buffer_view: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) component_type: u32,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub(super) buffer_view: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: Option<u64>,
    pub(super) extensions: Option<ViewExtensions>,
}

#[derive(Debug, Deserialize)]
pub(super) struct ViewExtensions {
    #[serde(rename = "KHR_meshopt_compression")]
    meshopt_khr: Option<Box<MeshoptView>>,
    #[serde(rename = "EXT_meshopt_compression")]
    meshopt_ext: Option<Box<MeshoptView>>,
}

impl BufferView {
    /// Returns the name of the compression extension and its data, or `None` if the view is not compressed.
    pub(super) fn meshopt(&self) -> Option<(&'static str, &MeshoptView)> {
        let extensions = self.extensions.as_ref()?;
        let [khr, ext] = MESHOPT;
        let of_khr = extensions.meshopt_khr.as_deref().map(|view| (khr, view));
        of_khr.or_else(|| extensions.meshopt_ext.as_deref().map(|view| (ext, view)))
    }
}

/// A compressed buffer view (KHR_meshopt_compression, EXT_meshopt_compression).
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct MeshoptView {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: u64,
    pub(super) count: u64,
    pub(super) mode: String,
    pub(super) filter: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer {
    pub(super) uri: Option<String>,
    pub(super) byte_length: u64,
}
