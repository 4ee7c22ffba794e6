//! The nodes of the default scene, depth first in file order, with their transforms to world space.

use glam::DAffine3;

use super::kinds::{self, Extras};
use super::source::GltfContext;
use super::{json, transform};
use crate::SceneError;
use crate::load::marks::Marks;

/// A mesh with the transform of a node that uses it.
#[derive(Clone, Debug)]
pub(super) struct PlacedMesh {
    pub(super) node: usize,
    /// The index of the instance, if the node has instances.
    pub(super) instance: Option<u64>,
    pub(super) mesh: usize,
    pub(super) world: DAffine3,
    /// True if an animation moves the node or an ancestor, or changes the visibility of such a node.
    pub(super) animated: bool,
    /// True if the node or an ancestor is hidden, and no animation changes the visibility of this node.
    pub(super) hidden: bool,
    /// True if a skin deforms the mesh.
    pub(super) skinned: bool,
    /// The extras of the node and its ancestors.
    pub(super) extras: Extras,
}

impl PlacedMesh {
    /// Returns true if the transform reverses the winding. Front faces are wound counter-clockwise if the
    /// determinant is positive, otherwise clockwise (glTF 2.0, section 3.7.4).
    pub(super) fn mirrors(&self) -> bool {
        let determinant = self.world.matrix3.determinant();
        determinant.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater)
    }
}

/// Lists the meshes that the shown scene places. The shown scene is the default scene, otherwise the first
/// scene or (without scenes) every root node.
///
/// The stack is explicit, so a deep hierarchy needs memory in proportion to the file and does not overflow
/// the call stack. Each node is visited at most once: the format allows one parent per node, which also
/// excludes cycles.
pub(super) fn walk(
    source: &GltfContext<'_>,
    root: &json::Root,
    marks: &mut Marks,
) -> Result<Vec<PlacedMesh>, SceneError> {
    let roots = roots(source, root)?;
    let mut met = vec![false; root.nodes.len()];
    let mut draws = Vec::new();
    let animations = kinds::animations(root);
    let start = |n: &usize| (*n, DAffine3::IDENTITY, [false; 2], Extras::default());
    let mut stack: Vec<(usize, DAffine3, [bool; 2], Extras)> =
        roots.iter().rev().map(start).collect();
    while let Some((n, parent, [moves, hides], outer)) = stack.pop() {
        let element = format!("node {n}");
        let Some(node) = root.nodes.get(n) else {
            return Err(source.bad(
                element,
                format!(
                    "the scene or a node refers to this node, but the file has {} nodes",
                    root.nodes.len()
                ),
            ));
        };
        if std::mem::replace(&mut met[n], true) {
            let reason =
                "the node is reached twice: the nodes form a cycle, or the node has two parents";
            return Err(source.bad(element, reason));
        }
        let local = transform::local(node).map_err(|why| source.bad(element.as_str(), why))?;
        let world = if parent == DAffine3::IDENTITY {
            local
        } else {
            parent * local
        };
        if !world.is_finite() {
            return Err(source.bad(
                element,
                "the transform, combined with the transforms of the ancestors, is not finite",
            ));
        }
        let animated = moves || animations[n].any();
        let hidden = hides || (node.is_hidden() && !animations[n].visibility);
        let extras = Extras::read(node.extras.as_deref(), || element.clone(), marks).or(outer);
        if let Some(mesh) = node.mesh {
            if mesh >= root.meshes.len() {
                let reason = format!(
                    "the node refers to mesh {mesh}, but the file has {} meshes",
                    root.meshes.len()
                );
                return Err(source.bad(element, reason));
            }
            let skinned = node.skin.is_some();
            draws.push(PlacedMesh {
                node: n,
                instance: None,
                mesh,
                world,
                animated,
                hidden,
                skinned,
                extras,
            });
        }
        stack.extend(
            node.children
                .iter()
                .rev()
                .map(|c| (*c, world, [animated, hidden], extras)),
        );
    }
    Ok(draws)
}

/// Returns the indices of the root nodes of the shown scene.
fn roots(source: &GltfContext<'_>, root: &json::Root) -> Result<Vec<usize>, SceneError> {
    if let Some(scene) = root.scenes.get(root.scene.unwrap_or(0)) {
        return Ok(scene.nodes.clone());
    }
    if let Some(n) = root.scene {
        return Err(source.bad(
            "scene",
            format!(
                "the default scene is scene {n}, but the file has {} scenes",
                root.scenes.len()
            ),
        ));
    }
    let mut is_child = vec![false; root.nodes.len()];
    for child in root.nodes.iter().flat_map(|n| &n.children) {
        if let Some(c) = is_child.get_mut(*child) {
            *c = true;
        }
    }
    let roots: Vec<usize> = (0..root.nodes.len()).filter(|n| !is_child[*n]).collect();
    if roots.is_empty() && !root.nodes.is_empty() {
        return Err(source.bad(
            "nodes",
            "every node is a child of another node, so the nodes form a cycle",
        ));
    }
    Ok(roots)
}
