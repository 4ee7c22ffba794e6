//! Small hand-written scene files for all tests of the loaders.
#![allow(dead_code, clippy::unwrap_used)]

use serde_json::{Value, json};
use sightline_scene::{Scene, SceneError, load_bytes};

/// A glTF document under construction: one buffer, and the views and accessors in it.
pub struct Gltf {
    pub json: Value,
    pub bin: Vec<u8>,
}

impl Default for Gltf {
    fn default() -> Self {
        let json = json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [], "accessors": [], "bufferViews": [], "buffers": []
        });
        Self {
            json,
            bin: Vec::new(),
        }
    }
}

impl Gltf {
    pub fn add(&mut self, list: &str, v: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(v);
        list.len() - 1
    }

    pub fn view(&mut self, bytes: &[u8]) -> usize {
        let offset = self.bin.len();
        self.bin.extend(bytes);
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        self.add(
            "bufferViews",
            json!({"buffer": 0, "byteOffset": offset, "byteLength": bytes.len()}),
        )
    }

    pub fn accessor(&mut self, bytes: &[u8], component: u32, shape: &str, count: usize) -> usize {
        let view = self.view(bytes);
        let a =
            json!({"bufferView": view, "componentType": component, "type": shape, "count": count});
        self.add("accessors", a)
    }

    pub fn positions(&mut self, p: &[[f32; 3]]) -> usize {
        let bytes: Vec<u8> = p.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
        self.accessor(&bytes, 5126, "VEC3", p.len())
    }

    pub fn pairs(&mut self, p: &[[f32; 2]]) -> usize {
        let bytes: Vec<u8> = p.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
        self.accessor(&bytes, 5126, "VEC2", p.len())
    }

    /// Adds indices of a component type: 5121, 5123 or 5125.
    pub fn indices(&mut self, component: u32, i: &[u32]) -> usize {
        let width = match component {
            5121 => 1,
            5123 => 2,
            _ => 4,
        };
        let bytes: Vec<u8> = i
            .iter()
            .flat_map(|i| i.to_le_bytes()[..width].to_vec())
            .collect();
        self.accessor(&bytes, component, "SCALAR", i.len())
    }

    pub fn mesh(&mut self, primitives: Value) -> usize {
        self.add("meshes", json!({"primitives": primitives}))
    }

    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if json["buffers"].as_array().unwrap().is_empty() {
            json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        }
        glb(json.to_string().as_bytes(), &self.bin)
    }

    pub fn load(&self) -> Result<Scene, SceneError> {
        load_bytes("test.glb", &self.glb(), None)
    }
}

/// Creates a GLB container.
pub fn glb(json: &[u8], bin: &[u8]) -> Vec<u8> {
    let (j, b) = (
        json.len().next_multiple_of(4),
        bin.len().next_multiple_of(4),
    );
    let mut out = b"glTF".to_vec();
    for n in [2, 12 + 8 + j + 8 + b, j] {
        out.extend((n as u32).to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(json);
    out.resize(20 + j, b' ');
    out.extend((b as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(bin);
    out.resize(28 + j + b, 0);
    out
}

/// The corners of a unit square in the plane z = 0.
pub const SQUARE: [[f32; 3]; 4] = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];

/// Creates two triangles with u16 indices.
pub fn square() -> Gltf {
    let mut g = Gltf::default();
    let (p, i) = (g.positions(&SQUARE), g.indices(5123, &[0, 1, 2, 0, 2, 3]));
    g.mesh(json!([{"attributes": {"POSITION": p}, "indices": i}]));
    g
}

/// Creates a sparse, strided, transformed scene with a strip and a fan, so that mutations cover many
/// features.
pub fn rich() -> Gltf {
    let mut g = square();
    let (i, v) = (
        g.view(&[1, 0, 3, 0]),
        g.view(bytemuck::cast_slice(&[5f32, 0., 0., 0., 5., 0.])),
    );
    g.json["accessors"][0]["sparse"] = json!({
        "count": 2, "indices": {"bufferView": i, "componentType": 5123}, "values": {"bufferView": v}
    });
    let strip = g.indices(5121, &[0, 1, 3, 2]);
    g.mesh(json!([
        {"attributes": {"POSITION": 0}, "mode": 6},
        {"attributes": {"POSITION": 0}, "mode": 5, "indices": strip},
        {"attributes": {"POSITION": 0}, "mode": 1}
    ]));
    g.json["nodes"] = json!([
        {"mesh": 0, "children": [1, 2], "translation": [1, 2, 3], "name": "root"},
        {"mesh": 1, "rotation": [0, 0, 0.707_106_77, 0.707_106_77], "scale": [2, 2, 2]},
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 9, 1]}
    ]);
    g
}

/// Replaces the data of accessor `a` by a view that is compressed with EXT_meshopt_compression.
pub fn compress(g: &mut Gltf, a: usize, packed: &[u8], mode: &str, filter: &str, stride: usize) {
    let count = g.json["accessors"][a]["count"].clone();
    let at = g.bin.len();
    g.bin.extend(packed);
    g.bin.resize(g.bin.len().next_multiple_of(4), 0);
    let view = json!({
        "buffer": 0, "byteLength": stride as u64 * count.as_u64().unwrap(),
        "extensions": {"EXT_meshopt_compression": {
            "buffer": 0, "byteOffset": at, "byteLength": packed.len(), "byteStride": stride,
            "count": count, "mode": mode, "filter": filter
        }}
    });
    let view = g.add("bufferViews", view);
    g.json["accessors"][a]["bufferView"] = json!(view);
    g.json["extensionsRequired"] = json!(["EXT_meshopt_compression"]);
}

/// Creates [`square`] with both views compressed.
pub fn packed_square() -> Gltf {
    use meshopt_rs::{index, vertex};
    let mut g = square();
    let positions: Vec<[u8; 12]> = SQUARE.iter().map(|p| bytemuck::cast(*p)).collect();
    let mut v = vec![0; vertex::buffer::encode_vertex_buffer_bound(4, 12)];
    let n = vertex::buffer::encode_vertex_buffer(&mut v, &positions, Default::default()).unwrap();
    compress(&mut g, 0, &v[..n], "ATTRIBUTES", "NONE", 12);
    let mut i = vec![0; index::buffer::encode_index_buffer_bound(6, 4)];
    let n = index::buffer::encode_index_buffer(&mut i, &[0, 1, 2, 0, 2, 3], Default::default())
        .unwrap();
    compress(&mut g, 1, &i[..n], "TRIANGLES", "NONE", 2);
    g
}

/// A mesh compressed with Draco, with its numbers of points and faces.
pub struct DracoMesh {
    pub bytes: Vec<u8>,
    pub points: usize,
    pub faces: usize,
}

/// Compresses a mesh of `faces` with Draco: positions as attribute 0, and texture coordinates as
/// attribute 1 if there are some. Returns the bytes and the numbers of points and faces.
pub fn draco(
    positions: &[[f32; 3]],
    uvs: &[[f32; 2]],
    faces: &[[u32; 3]],
    options: &draco_core::EncoderOptions,
) -> DracoMesh {
    use draco_core::{
        DataType, EncoderBuffer, GeometryAttributeType, Mesh, MeshEncoder, PointAttribute,
    };
    let mut mesh = Mesh::new();
    mesh.set_num_points(positions.len());
    let mut attribute = |kind, components: u8, values: &[f32]| {
        let mut a = PointAttribute::new();
        a.init(kind, components, DataType::Float32, false, positions.len());
        a.buffer_mut().update_f32s_le(0, values);
        mesh.add_attribute(a);
    };
    attribute(GeometryAttributeType::Position, 3, positions.as_flattened());
    if !uvs.is_empty() {
        attribute(GeometryAttributeType::TexCoord, 2, uvs.as_flattened());
    }
    mesh.set_num_faces(faces.len());
    mesh.set_faces_from_flat_indices(faces.as_flattened());
    let (mut encoder, mut out) = (MeshEncoder::new(), EncoderBuffer::new());
    encoder.set_mesh(mesh);
    encoder.encode(options, &mut out).unwrap();
    let mut read = Mesh::new();
    let mut buffer = draco_core::DecoderBuffer::new(out.data());
    draco_core::MeshDecoder::new()
        .decode(&mut buffer, &mut read)
        .unwrap();
    DracoMesh {
        bytes: out.data().to_vec(),
        points: read.num_points(),
        faces: read.num_faces(),
    }
}

/// Replaces the data of a primitive of mesh 0 by compressed data.
pub fn compress_primitive(g: &mut Gltf, p: usize, packed: &DracoMesh, attributes: Value) {
    let view = g.view(&packed.bytes);
    let primitive = g.json["meshes"][0]["primitives"][p].clone();
    let mut change = |accessor: &Value, count: usize| {
        let accessor = &mut g.json["accessors"][accessor.as_u64().unwrap() as usize];
        accessor.as_object_mut().unwrap().remove("bufferView");
        accessor["count"] = json!(count);
    };
    change(&primitive["indices"], packed.faces * 3);
    for name in attributes.as_object().unwrap().keys() {
        change(&primitive["attributes"][name], packed.points);
    }
    g.json["meshes"][0]["primitives"][p]["extensions"] =
        json!({"KHR_draco_mesh_compression": {"bufferView": view, "attributes": attributes}});
    g.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
}

/// Creates [`square`] compressed with Draco.
pub fn draco_square() -> Gltf {
    let mut g = square();
    let packed = draco(
        &SQUARE,
        &[],
        &[[0, 1, 2], [0, 2, 3]],
        &draco_core::EncoderOptions::new(),
    );
    compress_primitive(&mut g, 0, &packed, json!({"POSITION": 0}));
    g
}

/// An OBJ file with groups, negative indices, an n-gon, a continuation and a forward reference.
pub const OBJ: &str = "# a comment\nv 0 0 0\nv 1 0 0 1.0\nv 1 1 0\no house\ng wall\nf 1/1/1 2/2/2 3//3\n\
    g roof\nv 0 1 0\nf -4 -3 \\\n -2 -1\nf 1 2 5\nv 5e0 .5 -1.25E-1\nusemtl x\nl 1 2\n";

/// An ascii PLY file with a skipped property, a skipped list, a quad and a triangle.
pub const PLY: &str = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\nproperty float x\n\
    property uchar red\nproperty float y\nproperty double z\nelement extra 1\nproperty list uchar int n\n\
    element face 2\nproperty list uchar int vertex_indices\nproperty float w\nend_header\n\
    0 9 0 0\n1 9 0 0\n1 9 1 0\n0 9 1 0\n2 7 8\n4 0 1 2 3 0.5\n3 2 1 0 1\n";

/// Creates a binary PLY of either byte order with two triangles. The last index is `last`.
pub fn binary_ply(big: bool, vertices: &[[f32; 3]], last: i32) -> Vec<u8> {
    let order = if big { "big" } else { "little" };
    let mut out = format!(
        "ply\nformat binary_{order}_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\nelement face 2\nproperty list uchar int vertex_index\nend_header\n",
        vertices.len()
    )
    .into_bytes();
    let mut put = |b: [u8; 4]| out.extend(if big { [b[3], b[2], b[1], b[0]] } else { b });
    vertices.iter().flatten().for_each(|c| put(c.to_le_bytes()));
    for f in [[0, 1, 2], [0, 2, last]] {
        out.push(3);
        let mut put = |b: [u8; 4]| out.extend(if big { [b[3], b[2], b[1], b[0]] } else { b });
        f.iter().for_each(|i: &i32| put(i.to_le_bytes()));
    }
    out
}

/// Returns the vertices of all triangles as plain arrays.
pub fn soup(s: &Scene) -> Vec<[[f32; 3]; 3]> {
    s.triangles()
        .iter()
        .map(|t| t.v.map(|v| v.to_array()))
        .collect()
}

/// Returns the triangles of `points` by their indices.
pub fn by_index(points: &[[f32; 3]], t: &[[usize; 3]]) -> Vec<[[f32; 3]; 3]> {
    t.iter().map(|t| t.map(|i| points[i])).collect()
}

/// Creates a PNG file of black texels with these alphas.
pub fn png([width, height]: [u32; 2], alpha: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(png::ColorType::GrayscaleAlpha);
    let texels: Vec<u8> = alpha.iter().flat_map(|a| [0, *a]).collect();
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&texels)
        .unwrap();
    out
}

/// Creates a unit square with a texture of 4 × 2 texels. The texels in `open` have no alpha, and v points
/// down as in glTF. `change` edits the document.
pub fn card(open: &[usize], change: impl FnOnce(&mut Gltf)) -> Gltf {
    let mut g = square();
    let uv = g.pairs(&[[0., 1.], [1., 1.], [1., 0.], [0., 0.]]);
    let alpha: Vec<u8> = (0..8)
        .map(|t| if open.contains(&t) { 0 } else { 255 })
        .collect();
    let view = g.view(&png([4, 2], &alpha));
    g.json["images"] = json!([{"bufferView": view, "mimeType": "image/png"}]);
    g.json["textures"] = json!([{"source": 0}]);
    g.json["materials"] = json!([
        {"name": "fence", "alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    ]);
    let primitive = &mut g.json["meshes"][0]["primitives"][0];
    primitive["attributes"]["TEXCOORD_0"] = json!(uv);
    primitive["material"] = json!(0);
    change(&mut g);
    g
}
