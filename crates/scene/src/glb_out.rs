//! The writer of scenes as binary glTF 2.0 (GLB): one node and one mesh for each object, with indexed
//! triangles.
//!
//! A reader of the file gets the same triangles in the same order and the same objects. Only geometry and
//! names are written. An object's vertices are shared if they are equal bit for bit. Layout: Khronos, "glTF
//! 2.0 Specification", section 4 (GLB), sections 3.6 and 3.7 (accessors, meshes).

use std::io::Write;

use glam::Vec3;
use serde_json::{Value, json};
use sightline_formats::glb;

use crate::{Aabb, Scene, Triangle};

/// The reason why a scene could not be written.
#[derive(Debug, thiserror::Error)]
pub enum GlbError {
    /// A destination that cannot be written.
    #[error("the GLB cannot be written: {0}; check the destination and the space left on it")]
    Io(#[from] std::io::Error),
    /// A scene that exceeds the 32-bit size of a GLB.
    #[error(
        "as GLB, the scene would have {bytes} bytes, but the limit is 4 294 967 295; write the scene in \
         parts or as PLY"
    )]
    TooLarge {
        /// The minimum number of bytes of the file.
        bytes: u64,
    },
    /// A glTF structure that cannot be encoded as JSON.
    #[error("the glTF structure cannot be encoded: {0}; report this with the scene")]
    Json(#[from] serde_json::Error),
    /// An object without triangles, which glTF cannot express.
    #[error(
        "object {index} ({name:?}) has no triangles, which glTF cannot express; remove the object \
         from the scene"
    )]
    EmptyObject {
        /// The index of the object in the scene.
        index: usize,
        /// The name of the object.
        name: String,
    },
}

/// Writes `scene` to `out`. The bytes depend only on the scene.
///
/// # Errors
/// [`GlbError`] if the scene is too large, has an object without triangles, or cannot be written. If the
/// scene is too large, no byte is written.
pub fn write_glb(scene: &Scene, out: &mut dyn Write) -> Result<(), GlbError> {
    let mut positions: Vec<u8> = Vec::new();
    let mut indices: Vec<u8> = Vec::with_capacity(scene.triangles().len() * 12);
    let (mut accessors, mut meshes, mut nodes) = (Vec::new(), Vec::new(), Vec::new());
    for (k, o) in scene.objects().iter().enumerate() {
        if o.count == 0 {
            return Err(GlbError::EmptyObject {
                index: k,
                name: o.name.clone(),
            });
        }
        // `Scene::new` has checked that the objects cover the triangles without gaps.
        let triangles = &scene.triangles()[o.first as usize..][..o.count as usize];
        let (vertices, numbers) = share(triangles);
        let bounds = triangles
            .iter()
            .fold(Aabb::EMPTY, |b, t| b.union(t.bounds()));
        accessors.push(json!({
            "bufferView": 0, "byteOffset": positions.len(), "componentType": FLOAT, "count": vertices.len(),
            "type": "VEC3", "min": exact(bounds.min), "max": exact(bounds.max),
        }));
        accessors.push(json!({
            "bufferView": 1, "byteOffset": indices.len(), "componentType": UNSIGNED_INT,
            "count": numbers.len(), "type": "SCALAR",
        }));
        meshes.push(json!({
            "name": o.name,
            "primitives": [{ "attributes": { "POSITION": 2 * k }, "indices": 2 * k + 1, "mode": TRIANGLES }],
        }));
        nodes.push(json!({ "name": o.name, "mesh": k }));
        positions.extend(
            vertices
                .iter()
                .flat_map(|v| v.to_array())
                .flat_map(f32::to_le_bytes),
        );
        indices.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
        fits([(positions.len() + indices.len()) as u64])?;
    }
    let (vertex_bytes, index_bytes) = (positions.len(), indices.len());
    let binary = vertex_bytes + index_bytes;
    let document = json!({
        "asset": { "version": "2.0", "generator": "sightline" },
        "scene": 0,
        "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes,
        "meshes": meshes,
        "accessors": accessors,
        "bufferViews": [
            {
                "buffer": 0, "byteOffset": 0, "byteLength": vertex_bytes, "byteStride": 12,
                "target": ARRAY_BUFFER,
            },
            {
                "buffer": 0, "byteOffset": vertex_bytes, "byteLength": index_bytes,
                "target": ELEMENT_ARRAY_BUFFER,
            },
        ],
        "buffers": [{ "byteLength": binary }],
    });
    let text = serde_json::to_vec(&document)?;
    let length = fits([text.len() as u64, binary as u64])?;
    glb::begin(out, length, &text, binary as u64)?;
    out.write_all(&positions)?;
    out.write_all(&indices)?;
    out.flush()?;
    Ok(())
}

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const TRIANGLES: u32 = 4;

/// Computes the length of a GLB with chunks of these lengths, in bytes. Fails if a GLB cannot have this
/// length.
fn fits<const N: usize>(chunks: [u64; N]) -> Result<u32, GlbError> {
    glb::length(chunks).map_err(|fault| GlbError::TooLarge {
        bytes: match fault {
            glb::GlbFault::TooLong(bytes) => bytes,
            _ => chunks.iter().sum(),
        },
    })
}

/// Returns the coordinates as JSON numbers, from which readers get the same `f32` values.
fn exact(v: Vec3) -> Value {
    json!(v.to_array().map(f64::from))
}

/// Computes the distinct vertices in order of first use, and three indices for each triangle.
fn share(triangles: &[Triangle]) -> (Vec<Vec3>, Vec<u32>) {
    let corners: Vec<Vec3> = triangles.iter().flat_map(|t| t.v).collect();
    let bits = |v: Vec3| v.to_array().map(f32::to_bits);
    let mut order: Vec<([u32; 3], usize)> = corners
        .iter()
        .enumerate()
        .map(|(i, v)| (bits(*v), i))
        .collect();
    order.sort_unstable();
    // For each corner, the first corner at the same position. Corners at the same position are sorted, so the
    // first corner of a run is the smallest.
    let mut leader = vec![0usize; corners.len()];
    for run in order.chunk_by(|a, b| a.0 == b.0) {
        for (_, corner) in run {
            leader[*corner] = run[0].1;
        }
    }
    let mut vertices = Vec::new();
    let mut numbers: Vec<u32> = Vec::with_capacity(corners.len());
    for (i, v) in corners.iter().enumerate() {
        if leader[i] == i {
            // There are fewer than 2³² vertices: a GLB with more vertices is too large, and `write_glb`
            // rejects it before it writes these indices.
            numbers.push(vertices.len() as u32);
            vertices.push(*v);
        } else {
            // The first corner at this position precedes corner i, so its index is already known.
            numbers.push(numbers[leader[i]]);
        }
    }
    (vertices, numbers)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Object;
    use crate::generate::{SceneKind, SceneParams, generate};

    fn bytes(scene: &Scene) -> Vec<u8> {
        let mut out = Vec::new();
        write_glb(scene, &mut out).unwrap();
        out
    }

    fn u32_at(b: &[u8], at: usize) -> usize {
        u32::from_le_bytes(b[at..at + 4].try_into().unwrap()) as usize
    }

    fn number(v: &Value) -> usize {
        v.as_u64().unwrap() as usize
    }

    /// Reads a written GLB according to the specification, without the loader, and checks lengths, alignment
    /// and bounds.
    fn read(glb: &[u8]) -> (Vec<Triangle>, Vec<Object>) {
        assert_eq!(
            (&glb[..4], u32_at(glb, 4), u32_at(glb, 8)),
            (&b"glTF"[..], 2, glb.len())
        );
        let json_len = u32_at(glb, 12);
        assert_eq!((&glb[16..20], json_len % 4), (&b"JSON"[..], 0));
        let doc: Value = serde_json::from_slice(&glb[20..20 + json_len]).unwrap();
        let bin_len = u32_at(glb, 20 + json_len);
        let bin = &glb[28 + json_len..];
        assert_eq!(
            (&glb[24 + json_len..28 + json_len], bin.len(), bin_len % 4),
            (&b"BIN\0"[..], bin_len, 0)
        );
        assert_eq!(number(&doc["buffers"][0]["byteLength"]), bin_len);
        assert_eq!(doc["asset"]["version"], "2.0");
        let slice = |accessor: &Value, size: usize| {
            let view = &doc["bufferViews"][number(&accessor["bufferView"])];
            let at = number(&accessor["byteOffset"]);
            let len = number(&accessor["count"]) * size;
            assert!(at.is_multiple_of(4) && at + len <= number(&view["byteLength"]));
            &bin[number(&view["byteOffset"]) + at..][..len]
        };
        let (mut triangles, mut objects) = (Vec::new(), Vec::new());
        for node in doc["scenes"][0]["nodes"].as_array().unwrap() {
            let node = &doc["nodes"][number(node)];
            let primitive = &doc["meshes"][number(&node["mesh"])]["primitives"][0];
            let positions = &doc["accessors"][number(&primitive["attributes"]["POSITION"])];
            let indices = &doc["accessors"][number(&primitive["indices"])];
            let vertices: Vec<Vec3> = slice(positions, 12)
                .chunks(12)
                .map(|c| [0, 4, 8].map(|o| f32::from_bits(u32_at(c, o) as u32)))
                .map(Vec3::from)
                .collect();
            let extreme = |name: &str| {
                Vec3::from([0, 1, 2].map(|i| positions[name][i].as_f64().unwrap() as f32))
            };
            assert_eq!(
                vertices.iter().fold(Vec3::INFINITY, |a, v| a.min(*v)),
                extreme("min")
            );
            assert_eq!(
                vertices.iter().fold(Vec3::NEG_INFINITY, |a, v| a.max(*v)),
                extreme("max")
            );
            let first = triangles.len() as u32;
            let indices: Vec<usize> = slice(indices, 4).chunks(4).map(|c| u32_at(c, 0)).collect();
            triangles.extend(indices.chunks(3).map(|i| Triangle {
                v: [0, 1, 2].map(|k| vertices[i[k]]),
            }));
            let name = node["name"].as_str().unwrap().to_owned();
            objects.push(Object {
                name,
                first,
                count: triangles.len() as u32 - first,
            });
        }
        (triangles, objects)
    }

    #[test]
    fn written_scene_reads_back_unchanged() {
        for kind in SceneKind::ALL {
            let scene = generate(
                kind,
                &SceneParams {
                    triangles: Some(3_000),
                    ..SceneParams::default()
                },
            )
            .unwrap();
            let glb = bytes(&scene);
            // The loader numbers the triangles in the original order.
            let loaded = crate::load_bytes("made.glb", &glb, None).unwrap();
            assert!(loaded.triangles() == scene.triangles(), "{}", kind.name());
            assert_eq!(loaded.objects().len(), scene.objects().len());
            let (triangles, objects) = read(&glb);
            assert!(
                triangles == scene.triangles() && objects == scene.objects(),
                "{}",
                kind.name()
            );
            assert_eq!(glb, bytes(&scene));
            let other = generate(
                kind,
                &SceneParams {
                    triangles: Some(3_000),
                    seed: 1,
                    ..SceneParams::default()
                },
            )
            .unwrap();
            assert_ne!(glb, bytes(&other), "{}", kind.name());
        }
    }

    #[test]
    fn odd_names_extreme_numbers_and_signed_zeros_survive() {
        let v = [
            [f32::MAX, -0.0, 1e-45],
            [0.1, 0.0, f32::MIN],
            [-0.0, 0.0, 16_777_216.0],
        ]
        .map(Vec3::from);
        let objects = vec![
            Object {
                name: "a \"quoted\"\n\u{1F332} name".into(),
                first: 0,
                count: 1,
            },
            Object {
                name: String::new(),
                first: 1,
                count: 2,
            },
        ];
        let t = Triangle { v };
        let scene = Scene::new(
            "test",
            vec![
                t,
                t,
                Triangle {
                    v: [v[0], v[0], v[2]],
                },
            ],
            objects,
        )
        .unwrap();
        let (triangles, read_objects) = read(&bytes(&scene));
        let bits = |t: &[Triangle]| -> Vec<u32> {
            t.iter()
                .flat_map(|t| t.v)
                .flat_map(|v| v.to_array())
                .map(f32::to_bits)
                .collect()
        };
        assert_eq!(bits(&triangles), bits(scene.triangles()));
        assert_eq!(read_objects, scene.objects());
    }

    #[test]
    fn vertices_are_shared() {
        let scene = generate(
            SceneKind::Maze,
            &SceneParams {
                grid: Some([1, 1]),
                ..SceneParams::default()
            },
        )
        .unwrap();
        let (vertices, numbers) = share(&scene.triangles()[..12]);
        assert_eq!((vertices.len(), numbers.len()), (8, 36));
    }

    #[test]
    fn rejects_large_scene_and_empty_object_before_writing() {
        assert!(matches!(
            fits([1 << 32]),
            Err(GlbError::TooLarge {
                bytes: 4_294_967_316
            })
        ));
        assert_eq!(fits([(1 << 32) - 24]).unwrap(), u32::MAX - 3);
        let t = Triangle {
            v: [Vec3::ZERO, Vec3::X, Vec3::Y],
        };
        let objects = vec![
            Object {
                name: "something".into(),
                first: 0,
                count: 1,
            },
            Object {
                name: "nothing".into(),
                first: 1,
                count: 0,
            },
        ];
        let scene = Scene::new("test", vec![t], objects).unwrap();
        let mut out = Vec::new();
        let error = write_glb(&scene, &mut out).unwrap_err();
        assert!(out.is_empty() && error.to_string().contains("object 1 (\"nothing\")"));
    }
}
