//! Small glTF files for tests, and readers of written files that are independent of the crate.

#![allow(dead_code, reason = "each test uses a part of it")]
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use glam::DVec3;
use serde_json::{Value, json};
use sightline_scene::Scene;
use sightline_texels::{Plan, Settings, WrittenFile};

/// A file under construction: its JSON, and the bytes of its single buffer.
pub struct Maker {
    /// The glTF document.
    pub json: Value,
    bytes: Vec<u8>,
}

impl Maker {
    /// Creates an empty file.
    pub fn new() -> Self {
        let json = json!({
            "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [] }],
            "nodes": [], "meshes": [], "accessors": [], "bufferViews": [], "buffers": [{}],
        });
        Self {
            json,
            bytes: Vec::new(),
        }
    }

    /// Adds an element to an array, and returns its number.
    pub fn push(&mut self, key: &str, value: Value) -> usize {
        if self.json.get(key).is_none() {
            self.json[key] = json!([]);
        }
        let array = self.json[key].as_array_mut().unwrap();
        array.push(value);
        array.len() - 1
    }

    fn view(&mut self, bytes: Vec<u8>) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let (at, size) = (self.bytes.len(), bytes.len());
        self.bytes.extend(bytes);
        self.push(
            "bufferViews",
            json!({ "buffer": 0, "byteOffset": at, "byteLength": size }),
        )
    }

    /// Adds an accessor of floats.
    pub fn floats(&mut self, kind: &str, numbers: &[f32]) -> usize {
        let n = match kind {
            "VEC2" => 2,
            "VEC3" => 3,
            _ => 1,
        };
        let view = self.view(numbers.iter().flat_map(|f| f.to_le_bytes()).collect());
        let component_values = |c: usize| numbers.iter().skip(c).step_by(n).copied();
        let min: Vec<f32> = (0..n)
            .map(|c| component_values(c).fold(f32::INFINITY, f32::min))
            .collect();
        let max: Vec<f32> = (0..n)
            .map(|c| component_values(c).fold(f32::NEG_INFINITY, f32::max))
            .collect();
        self.push(
            "accessors",
            json!({
                "bufferView": view, "componentType": 5126, "count": numbers.len() / n, "type": kind,
                "min": min, "max": max,
            }),
        )
    }

    /// Adds an accessor of indices of 16 bits.
    pub fn indices(&mut self, all: &[u16]) -> usize {
        let view = self.view(all.iter().flat_map(|i| i.to_le_bytes()).collect());
        let accessor = json!({
            "bufferView": view, "componentType": 5123, "count": all.len(), "type": "SCALAR"
        });
        self.push("accessors", accessor)
    }

    /// Adds a node at the root.
    pub fn node(&mut self, node: Value) -> usize {
        let number = self.push("nodes", node);
        self.json["scenes"][0]["nodes"]
            .as_array_mut()
            .unwrap()
            .push(json!(number));
        number
    }

    /// Adds a mesh of one primitive.
    pub fn mesh(&mut self, primitive: Value) -> usize {
        self.push("meshes", json!({ "primitives": [primitive] }))
    }

    /// Returns the file as a GLB.
    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"][0]["byteLength"] = json!(self.bytes.len());
        let mut text = serde_json::to_vec(&json).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bytes = self.bytes.clone();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        let total = 12 + 8 + text.len() + 8 + bytes.len();
        let mut out = b"glTF".to_vec();
        for word in [2, total as u32, text.len() as u32] {
            out.extend(word.to_le_bytes());
        }
        out.extend(b"JSON");
        out.extend(text);
        out.extend((bytes.len() as u32).to_le_bytes());
        out.extend(b"BIN\0");
        out.extend(bytes);
        out
    }
}

/// Returns the eight vertices and twelve triangles of a cube from 0 to 1, wound outwards.
pub fn cube() -> (Vec<f32>, Vec<u16>) {
    let positions = (0..8)
        .flat_map(|i| [i & 1, i >> 1 & 1, i >> 2 & 1])
        .map(|b| b as f32)
        .collect();
    let faces: [[u16; 4]; 6] = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let triangles = faces
        .iter()
        .flat_map(|f| [f[0], f[1], f[2], f[0], f[2], f[3]])
        .collect();
    (positions, triangles)
}

/// Adds the accessors of a cube with shared vertices, and returns them: positions, indices.
pub fn add_cube(maker: &mut Maker) -> (usize, usize) {
    let (positions, indices) = cube();
    (maker.floats("VEC3", &positions), maker.indices(&indices))
}

/// Creates a primitive of a cube without a material.
pub fn cube_primitive(maker: &mut Maker) -> Value {
    let (positions, indices) = add_cube(maker);
    json!({ "attributes": { "POSITION": positions }, "indices": indices })
}

/// Loads the scene of a file.
pub fn scene(glb: &[u8]) -> Scene {
    sightline_scene::load_bytes("test.glb", glb, None).unwrap()
}

/// Writes the file with a function of point and normal as values.
pub fn written(
    glb: &[u8],
    settings: &Settings,
    value: impl Fn(DVec3, DVec3) -> f64,
) -> WrittenFile {
    let scene = scene(glb);
    let plan = Plan::new("test.glb", glb, None, &scene, settings).unwrap();
    let values = plan.receivers().iter();
    let values: Vec<_> = values
        .map(|r| sightline_texels::ReceiverValue {
            open: value(r.point, r.normal).clamp(0.0, 1.0),
            inside: false,
        })
        .collect();
    let written = plan.write(&values).unwrap();
    let again = sightline_scene::load_bytes("out.glb", &written.glb, None).unwrap();
    assert!(
        again.triangles() == scene.triangles(),
        "triangles or their order changed"
    );
    written
}

/// A written GLB: its document and its binary chunk.
pub struct Read {
    /// The glTF document of the file.
    pub json: Value,
    /// The bytes of the file's binary chunk.
    pub bytes: Vec<u8>,
}

fn number(v: &Value) -> usize {
    v.as_u64().unwrap_or(0) as usize
}

impl Read {
    /// Reads a GLB, and checks its header.
    pub fn new(glb: &[u8]) -> Self {
        let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&glb[..4], word(4), word(8)), (&b"glTF"[..], 2, glb.len()));
        let text = &glb[20..20 + word(12)];
        let json: Value = serde_json::from_slice(text).unwrap();
        let bytes = glb[28 + text.len()..].to_vec();
        assert!(number(&json["buffers"][0]["byteLength"]) <= bytes.len());
        assert!(
            json["buffers"].as_array().unwrap().len() == 1
                && json["buffers"][0].get("uri").is_none()
        );
        Self { json, bytes }
    }

    /// Returns the bytes of a buffer view.
    pub fn view(&self, v: usize) -> &[u8] {
        let view = &self.json["bufferViews"][v];
        &self.bytes[number(&view["byteOffset"])..][..number(&view["byteLength"])]
    }

    /// Returns the components of an accessor as numbers, without normalisation.
    pub fn accessor(&self, a: usize) -> Vec<f64> {
        let a = &self.json["accessors"][a];
        let n = match a["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            _ => 4,
        };
        let size = match number(&a["componentType"]) {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            _ => 4,
        };
        let v = number(&a["bufferView"]);
        let stride = number(&self.json["bufferViews"][v]["byteStride"]);
        let stride = if stride == 0 { n * size } else { stride };
        let bytes = &self.view(v)[number(&a["byteOffset"])..];
        let component = |b: &[u8]| match number(&a["componentType"]) {
            5126 => f64::from(f32::from_le_bytes(b[..4].try_into().unwrap())),
            5125 => f64::from(u32::from_le_bytes(b[..4].try_into().unwrap())),
            5123 => f64::from(u16::from_le_bytes(b[..2].try_into().unwrap())),
            _ => f64::from(b[0]),
        };
        let element = |i: usize| (0..n).map(move |c| component(&bytes[i * stride + c * size..]));
        (0..number(&a["count"])).flat_map(element).collect()
    }

    /// Returns a primitive of a mesh.
    pub fn primitive(&self, mesh: usize, p: usize) -> &Value {
        &self.json["meshes"][mesh]["primitives"][p]
    }

    /// Returns an attribute of a primitive.
    pub fn attribute(&self, mesh: usize, p: usize, name: &str) -> Vec<f64> {
        self.accessor(number(&self.primitive(mesh, p)["attributes"][name]))
    }

    /// Returns the triangles of a primitive as vertex numbers.
    pub fn triangles(&self, mesh: usize, p: usize) -> Vec<[usize; 3]> {
        let all = self.accessor(number(&self.primitive(mesh, p)["indices"]));
        all.chunks(3)
            .map(|c| [c[0] as usize, c[1] as usize, c[2] as usize])
            .collect()
    }

    /// Returns the texture coordinates of the corners of each triangle, from the set of the occlusion
    /// texture.
    pub fn coordinates(&self, mesh: usize, p: usize) -> Vec<[[f64; 2]; 3]> {
        let material = &self.json["materials"][number(&self.primitive(mesh, p)["material"])];
        let set = number(&material["occlusionTexture"]["texCoord"]);
        let uv = self.attribute(mesh, p, &format!("TEXCOORD_{set}"));
        self.triangles(mesh, p)
            .iter()
            .map(|t| t.map(|v| [uv[2 * v], uv[2 * v + 1]]))
            .collect()
    }

    /// Returns the occlusion image: width, height, values from 0 to 1.
    pub fn image(&self) -> Image {
        let images = self.json["images"].as_array().unwrap();
        let png = self.view(number(&images[images.len() - 1]["bufferView"]));
        let mut reader = png::Decoder::new(std::io::Cursor::new(png))
            .read_info()
            .unwrap();
        let mut data = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut data).unwrap();
        assert_eq!(info.color_type, png::ColorType::Grayscale);
        let values = match info.bit_depth {
            png::BitDepth::Sixteen => data
                .chunks(2)
                .map(|b| f64::from(u16::from_be_bytes([b[0], b[1]])) / 65535.0)
                .collect(),
            _ => data.iter().map(|b| f64::from(*b) / 255.0).collect(),
        };
        Image {
            width: info.width as usize,
            height: info.height as usize,
            values,
        }
    }
}

/// An image of grey values.
pub struct Image {
    /// The width in texels.
    pub width: usize,
    /// The height in texels.
    pub height: usize,
    /// The values, row by row.
    pub values: Vec<f64>,
}

impl Image {
    /// Returns the value at texture coordinates, by bilinear filtering that clamps to the edge.
    pub fn at(&self, uv: [f64; 2]) -> f64 {
        let place = |c: f64, n: usize| {
            let c = (c * n as f64 - 0.5).clamp(0.0, (n - 1) as f64);
            (
                c.floor() as usize,
                (c.floor() as usize + 1).min(n - 1),
                c.fract(),
            )
        };
        let ((x, xx, fx), (y, yy, fy)) = (place(uv[0], self.width), place(uv[1], self.height));
        let value_at = |x: usize, y: usize| self.values[y * self.width + x];
        let (above, below) = (
            value_at(x, y) * (1.0 - fx) + value_at(xx, y) * fx,
            value_at(x, yy) * (1.0 - fx) + value_at(xx, yy) * fx,
        );
        above * (1.0 - fy) + below * fy
    }
}
