//! Meshes that several nodes have get a copy for each node, since values differ from node to node.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use crate::TexelsError;
use crate::file::{File, member};
use crate::instances::{expand, undeclare};
use crate::parts::Parts;

/// Gives each draw that has triangles a mesh of its own, and returns the mesh of each draw. The first node
/// keeps the mesh that it has, unless nodes that are not drawn have it, too. Accessors are shared by the
/// copies.
pub(crate) fn separate(file: &mut File, parts: &Parts) -> Result<Vec<usize>, TexelsError> {
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
