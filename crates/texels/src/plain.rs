//! A glTF file of a scene that comes from another kind of file: a node and a mesh for each object, three own
//! vertices for each triangle, so that each face can have values of its own.

use serde_json::json;
use sightline_scene::{Aabb, Scene, Source};

use crate::TexelsError;
use crate::accessor::FLOAT;
use crate::added::ARRAY_BUFFER;
use crate::file::File;

/// The file, and where the objects of the scene are in it. Objects without triangles have meshes without
/// primitives of them, which glTF cannot express, so they are left out.
pub(crate) fn file_of(name: &str, scene: &Scene) -> Result<(File, Vec<Source>), TexelsError> {
    let document = json!({
        "asset": { "version": "2.0", "generator": "sightline" },
        "scene": 0,
        "scenes": [{ "nodes": [] }],
    });
    let mut file = File::read(name, &serde_json::to_vec(&document)?, None)?;
    let mut sources = Vec::with_capacity(scene.objects().len());
    let mut nodes = 0u32;
    for object in scene.objects() {
        sources.push(Source {
            node: nodes,
            mesh: nodes,
            primitive: 0,
            instance: None,
        });
        if object.count == 0 {
            continue;
        }
        // `Scene::new` checked that objects tile the triangles.
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
