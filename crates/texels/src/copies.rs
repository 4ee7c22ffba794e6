//! Copies of meshes that several nodes use. Each node gets a separate copy, because values differ between
//! nodes.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use crate::TexelsError;
use crate::file::{GltfParts, member};
use crate::instances::{expand, undeclare};
use crate::parts::PrimitiveInstances;

/// Gives each mesh instance with triangles a separate mesh. Returns the index of the mesh of each instance,
/// in the order of `parts.draws`.
///
/// The first instance of a mesh keeps the mesh, unless a node outside the scene also uses the mesh. The other
/// instances get copies, which share the accessors of the mesh.
pub(crate) fn separate(
    file: &mut GltfParts,
    parts: &PrimitiveInstances,
) -> Result<Vec<usize>, TexelsError> {
    let mut with_triangles = vec![false; parts.draws.len()];
    for part in &parts.all {
        with_triangles[part.draw] = true;
    }
    let mut taken = vec![false; file.array("meshes").len()];
    let mut drawn = vec![false; file.array("nodes").len()];
    for draw in &parts.draws {
        if let Some(drawn) = drawn.get_mut(draw.node) {
            *drawn = true;
        }
    }
    for (node, drawn) in file.array("nodes").iter().zip(&drawn) {
        if let Some(taken) = member(node, "mesh")
            .filter(|_| !drawn)
            .and_then(|m| taken.get_mut(m))
        {
            *taken = true;
        }
    }
    let mut meshes = Vec::with_capacity(parts.draws.len());
    let mut instances: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (draw, with_triangles) in parts.draws.iter().zip(with_triangles) {
        let mut mesh = draw.mesh;
        if with_triangles {
            match taken.get_mut(mesh) {
                Some(taken) if !*taken => *taken = true,
                _ => {
                    let copy = file
                        .array("meshes")
                        .get(mesh)
                        .cloned()
                        .unwrap_or(Value::Null);
                    mesh = file.push("meshes", copy)?;
                }
            }
        }
        meshes.push(mesh);
        if draw.instance.is_some() {
            instances.entry(draw.node).or_default().push(mesh);
        } else if let Some(node) = file.array_mut("nodes")?.get_mut(draw.node) {
            node["mesh"] = json!(mesh);
        }
    }
    for (node, meshes) in &instances {
        expand(file, *node, meshes)?;
    }
    if !instances.is_empty() {
        undeclare(file)?;
    }
    Ok(meshes)
}
