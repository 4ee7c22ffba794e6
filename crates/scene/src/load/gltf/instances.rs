//! Instances of a node's mesh (EXT_mesh_gpu_instancing): one placed mesh for each instance.

use glam::DAffine3;

use super::accessor::Accessors;
use super::json::{self, InstanceAttributes};
use super::nodes::PlacedMesh;
use super::source::GltfContext;
use super::transform;
use super::uses::{AccessorRole, AccessorUser};
use crate::SceneError;
use crate::load::limits::too_many_objects;

/// Replaces the placed mesh of each node with instances by one placed mesh for each instance, in their order.
pub(super) fn expand(
    source: &GltfContext<'_>,
    root: &json::Root,
    accessors: &Accessors<'_>,
    draws: Vec<PlacedMesh>,
) -> Result<Vec<PlacedMesh>, SceneError> {
    if draws
        .iter()
        .all(|d| root.nodes[d.node].instances().is_none())
    {
        return Ok(draws);
    }
    let mut all = Vec::new();
    for draw in draws {
        let Some(attributes) = root.nodes[draw.node].instances() else {
            all.push(draw);
            continue;
        };
        let element = AccessorUser::Instances { node: draw.node }.to_string();
        let count =
            count(accessors, attributes).map_err(|why| source.bad(element.as_str(), why))?;
        if all.len() as u64 + count > u64::from(source.limits.objects) {
            return Err(too_many_objects(source.file, element, source.limits));
        }
        for i in 0..count {
            let local = local(accessors, attributes, i);
            let world = local
                .map(|local| draw.world * local)
                .filter(DAffine3::is_finite);
            let world = world.ok_or_else(|| {
                source.bad(
                    element.as_str(),
                    format!(
                        "the transform of instance {i} is not finite, or its rotation has no length"
                    ),
                )
            })?;
            all.push(PlacedMesh {
                instance: Some(i),
                world,
                ..draw.clone()
            });
        }
    }
    Ok(all)
}

/// Returns the number of instances, which must be equal for all attributes.
fn count(accessors: &Accessors<'_>, attributes: &InstanceAttributes) -> Result<u64, String> {
    let offsets = [attributes.translation, attributes.scale]
        .into_iter()
        .flatten()
        .map(|a| (AccessorRole::Offsets, a));
    let all = offsets.chain(attributes.rotation.map(|a| (AccessorRole::Rotations, a)));
    let mut counts = all.map(|(role, a)| accessors.get(role, a).count());
    let first = counts
        .next()
        .ok_or("the extension has neither TRANSLATION, ROTATION nor SCALE")?;
    match counts.find(|n| *n != first) {
        Some(other) => Err(format!(
            "the attributes have {first} and {other} elements, but must have the same number"
        )),
        None => Ok(first),
    }
}

/// Computes the transform of instance `i` relative to its node. Returns `None` if [`transform::compose`]
/// rejects the rotation.
fn local(accessors: &Accessors<'_>, attributes: &InstanceAttributes, i: u64) -> Option<DAffine3> {
    let offset = |a: Option<usize>| a.map(|a| accessors.get(AccessorRole::Offsets, a).position(i));
    let rotation = attributes
        .rotation
        .map(|a| accessors.get(AccessorRole::Rotations, a).quaternion(i));
    transform::compose(
        offset(attributes.translation),
        rotation,
        offset(attributes.scale),
    )
}
