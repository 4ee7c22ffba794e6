//! Instances of a node's mesh (EXT_mesh_gpu_instancing): one draw for each.

use glam::DAffine3;

use super::accessor::Accessors;
use super::json::{self, InstanceAttributes};
use super::nodes::Draw;
use super::source::GltfContext;
use super::transform;
use super::uses::{Role, User};
use crate::SceneError;
use crate::load::limits::too_many_objects;

/// Replaces each draw of a node with instances by one draw for each instance, in their order.
pub(super) fn expand(
    source: &GltfContext<'_>,
    root: &json::Root,
    accessors: &Accessors<'_>,
    draws: Vec<Draw>,
) -> Result<Vec<Draw>, SceneError> {
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
        let element = User::Instances { node: draw.node }.to_string();
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
                    format!("the transform of instance {i} is no finite rotation and scale"),
                )
            })?;
            all.push(Draw {
                instance: Some(i),
                world,
                ..draw.clone()
            });
        }
    }
    Ok(all)
}

/// The number of instances, which all attributes agree on.
fn count(accessors: &Accessors<'_>, attributes: &InstanceAttributes) -> Result<u64, String> {
    let offsets = [attributes.translation, attributes.scale]
        .into_iter()
        .flatten()
        .map(|a| (Role::Offsets, a));
    let all = offsets.chain(attributes.rotation.map(|a| (Role::Rotations, a)));
    let mut counts = all.map(|(role, a)| accessors.get(role, a).count());
    let first = counts
        .next()
        .ok_or("it has neither TRANSLATION, ROTATION nor SCALE")?;
    match counts.find(|n| *n != first) {
        Some(other) => Err(format!(
            "its attributes have {first} and {other} elements, and must have the same number"
        )),
        None => Ok(first),
    }
}

/// The transform of an instance relative to its node; none if the rotation is no quaternion.
fn local(accessors: &Accessors<'_>, attributes: &InstanceAttributes, i: u64) -> Option<DAffine3> {
    let offset = |a: Option<usize>| a.map(|a| accessors.get(Role::Offsets, a).position(i));
    let rotation = attributes
        .rotation
        .map(|a| accessors.get(Role::Rotations, a).quaternion(i));
    transform::compose(
        offset(attributes.translation),
        rotation,
        offset(attributes.scale),
    )
}
