//! A glTF file for a scene from another file format. The file has a node and a mesh for each object, and
//! three separate vertices for each triangle, so that each face can have separate values.

use serde_json::json;
use sightline_scene::{Aabb, GltfLocation, Scene};

use crate::TexelsError;
use crate::accessor::FLOAT;
use crate::added_accessors::ARRAY_BUFFER;
use crate::file::GltfParts;

/// Creates the glTF file `name`, and the location of each object of the scene in the file. The file omits
/// objects without triangles, because glTF requires that a mesh has a primitive.
pub(crate) fn file_of(
    name: &str,
    scene: &Scene,
) -> Result<(GltfParts, Vec<GltfLocation>), TexelsError> {
    let document = json!({
        "asset": { "version": "2.0", "generator": "sightline" },
        "scene": 0,
        "scenes": [{ "nodes": [] }],
    });
    let mut file = GltfParts::read(name, &serde_json::to_vec(&document)?, None)?;
    let mut sources = Vec::with_capacity(scene.objects().len());
    let mut nodes = 0u32;
    for object in scene.objects() {
        sources.push(GltfLocation {
            node: nodes,
            mesh: nodes,
            primitive: 0,
            instance: None,
        });
        if object.count == 0 {
            continue;
        }
        // `Scene::new` has checked that the objects cover the triangles without gaps.
        let triangles = &scene.triangles()[object.first as usize..][..object.count as usize];
        let bounds = triangles
            .iter()
            .fold(Aabb::EMPTY, |b, t| b.union(t.bounds()));
        let bytes: Vec<u8> = triangles
            .iter()
            .flat_map(|t| t.v)
            .flat_map(|v| v.to_array())
            .flat_map(f32::to_le_bytes)
            .collect();
        let view = file.add_view(&bytes, Some(ARRAY_BUFFER))?;
        let exact = |v: glam::Vec3| v.to_array().map(f64::from);
        let accessor = file.push(
            "accessors",
            json!({
                "bufferView": view, "componentType": FLOAT, "count": triangles.len() * 3, "type": "VEC3",
                "min": exact(bounds.min), "max": exact(bounds.max),
            }),
        )?;
        let primitives = json!([{ "attributes": { "POSITION": accessor } }]);
        file.push(
            "meshes",
            json!({ "name": object.name, "primitives": primitives }),
        )?;
        let node = file.push("nodes", json!({ "name": object.name, "mesh": nodes }))?;
        if let Some(list) = file
            .root
            .get_mut("scenes")
            .and_then(|s| s[0]["nodes"].as_array_mut())
        {
            list.push(json!(node));
        }
        nodes += 1;
    }
    Ok((file, sources))
}
