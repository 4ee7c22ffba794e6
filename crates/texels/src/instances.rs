//! The mirroring of transforms, and the conversion of a node's mesh instances (EXT_mesh_gpu_instancing) to
//! nodes.

use serde_json::{Map, Value, json};

use crate::TexelsError;
use crate::accessor::CheckedElements;
use crate::file::{GltfParts, member};

/// The name of the extension.
const INSTANCING: &str = "EXT_mesh_gpu_instancing";

/// Returns a sign for each node: -1 if the node's transform to world space mirrors, otherwise 1.
pub(crate) fn mirrors(file: &GltfParts) -> Vec<f64> {
    let nodes = file.array("nodes");
    let mut parents = vec![None; nodes.len()];
    for (n, node) in nodes.iter().enumerate() {
        for child in node
            .get("children")
            .and_then(Value::as_array)
            .into_iter()
            .flatten()
        {
            if let Some(parent) = child
                .as_u64()
                .and_then(|c| parents.get_mut(usize::try_from(c).ok()?))
            {
                *parent = Some(n);
            }
        }
    }
    let own: Vec<f64> = nodes.iter().map(own).collect();
    let mut signs = vec![0.0; nodes.len()];
    for start in 0..nodes.len() {
        // Walk up to a root or to a node whose sign is known, and then compute the signs on the way down.
        let (mut path, mut at) = (Vec::new(), Some(start));
        // The limit on the path's length ends cycles of nodes, which the scene loader rejects.
        while let Some(n) = at.filter(|n| signs[*n] == 0.0 && path.len() < nodes.len()) {
            path.push(n);
            at = parents[n];
        }
        let mut sign = at.map_or(1.0, |n| if signs[n] == 0.0 { 1.0 } else { signs[n] });
        for n in path.into_iter().rev() {
            sign *= own[n];
            signs[n] = sign;
        }
    }
    signs
}

/// Returns 1, or -1 if the transform of a node relative to its parent mirrors.
fn own(node: &Value) -> f64 {
    let numbers = |key: &str| -> Option<Vec<f64>> {
        node.get(key)?
            .as_array()?
            .iter()
            .map(Value::as_f64)
            .collect()
    };
    if let Some(&[a, b, c, _, d, e, f, _, g, h, i, ..]) = numbers("matrix").as_deref() {
        return sign(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g));
    }
    numbers("scale").map_or(1.0, |s| s.into_iter().map(sign).product())
}

/// Returns the sign of a number, which is 1 for zero.
fn sign(x: f64) -> f64 {
    if x < 0.0 { -1.0 } else { 1.0 }
}

/// Returns the indices of the accessors of a node's instances: of their translations, rotations and scales.
/// Returns `None` if the node has no instances.
fn attributes(node: &Value) -> Option<[Option<usize>; 3]> {
    let attributes = node.get("extensions")?.get(INSTANCING)?.get("attributes")?;
    Some(["TRANSLATION", "ROTATION", "SCALE"].map(|key| member(attributes, key)))
}

/// Returns 1, or -1 if the transform of instance `i` of a node mirrors.
pub(crate) fn instance_mirrors(file: &GltfParts, node: usize, i: u32) -> Result<f64, TexelsError> {
    let scale = file
        .array("nodes")
        .get(node)
        .and_then(attributes)
        .and_then(|a| a[2]);
    let Some(scale) = scale else { return Ok(1.0) };
    let elements = CheckedElements::read(file, scale)?;
    Ok((0..3)
        .map(|c| sign(elements.number(i as usize, c)))
        .product())
}

/// Replaces the instances of a node by child nodes: one for each mesh index in `meshes`, in the order of the
/// instances.
///
/// The new children precede the node's other children, so triangles keep their order.
pub(crate) fn expand(
    file: &mut GltfParts,
    node: usize,
    meshes: &[usize],
) -> Result<(), TexelsError> {
    let original = file.array("nodes").get(node).cloned().unwrap_or_default();
    let Some(of) = attributes(&original) else {
        return Ok(());
    };
    let mut children = Vec::with_capacity(meshes.len());
    for (i, mesh) in meshes.iter().enumerate() {
        let mut child = Map::new();
        if let Some(name) = original.get("name").and_then(Value::as_str) {
            child.insert("name".to_owned(), json!(format!("{name}[{i}]")));
        }
        child.insert("mesh".to_owned(), json!(mesh));
        for key in ["skin", "weights"] {
            child.extend(original.get(key).map(|v| (key.to_owned(), v.clone())));
        }
        for (accessor, (key, n)) in
            of.into_iter()
                .zip([("translation", 3), ("rotation", 4), ("scale", 3)])
        {
            let Some(accessor) = accessor else { continue };
            let elements = CheckedElements::read(file, accessor)?;
            let numbers: Vec<f64> = (0..n).map(|c| elements.number(i, c)).collect();
            child.insert(key.to_owned(), json!(numbers));
        }
        children.push(json!(file.push("nodes", Value::Object(child))?));
    }
    let Some(node) = file
        .array_mut("nodes")?
        .get_mut(node)
        .and_then(Value::as_object_mut)
    else {
        return Ok(());
    };
    for key in ["mesh", "skin", "weights"] {
        node.shift_remove(key);
    }
    if let Some(extensions) = node.get_mut("extensions").and_then(Value::as_object_mut) {
        extensions.shift_remove(INSTANCING);
        if extensions.is_empty() {
            node.shift_remove("extensions");
        }
    }
    if let Some(others) = node.get("children").and_then(Value::as_array) {
        children.extend(others.iter().cloned());
    }
    node.insert("children".to_owned(), json!(children));
    Ok(())
}

/// Removes the extension from `extensionsUsed` and `extensionsRequired` if no node uses the extension.
pub(crate) fn undeclare(file: &mut GltfParts) -> Result<(), TexelsError> {
    if file.array("nodes").iter().any(|n| attributes(n).is_some()) {
        return Ok(());
    }
    for key in ["extensionsUsed", "extensionsRequired"] {
        if file.root.contains_key(key) {
            let list = file.array_mut(key)?;
            list.retain(|e| e.as_str() != Some(INSTANCING));
            if list.is_empty() {
                file.root.shift_remove(key);
            }
        }
    }
    Ok(())
}
