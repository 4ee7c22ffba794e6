//! The nodes of the default scene, depth first in file order, with their transforms to world space.

use glam::DAffine3;

use super::kinds::{self, Extras};
use super::source::GltfContext;
use super::{json, transform};
use crate::SceneError;
use crate::load::marks::Marks;

/// A mesh and the transform of a node that has it.
#[derive(Clone, Debug)]
pub(super) struct Draw {
    pub(super) node: usize,
    /// The number of the instance, of a node with instances.
    pub(super) instance: Option<u64>,
    pub(super) mesh: usize,
    pub(super) world: DAffine3,
    /// True if an animation moves the node or an ancestor, or changes the visibility of one.
    pub(super) animated: bool,
    /// True if the node or an ancestor is hidden, and no animation shows it.
    pub(super) hidden: bool,
    /// Whether a skin deforms the mesh.
    pub(super) skinned: bool,
    /// The extras of the node and its ancestors.
    pub(super) extras: Extras,
}

impl Draw {
    /// Whether its transform turns the winding around: front faces are wound counter-clockwise when the
    /// determinant is positive, else clockwise (glTF 2.0, section 3.7.4).
    pub(super) fn mirrors(&self) -> bool {
        let determinant = self.world.matrix3.determinant();
        determinant.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater)
    }
}

/// All draws of the scene to show: the default one, else the first, else (without scenes) every root node.
///
/// The stack is explicit, so that a deep hierarchy takes memory in proportion to the file and does not
/// overflow the call stack. Each node is visited at most once: the format allows it one parent, which also
/// excludes cycles.
pub(super) fn walk(
    source: &GltfContext<'_>,
    root: &json::Root,
    marks: &mut Marks,
) -> Result<Vec<Draw>, SceneError> {
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
                format!("it is named, but there are {} nodes", root.nodes.len()),
            ));
        };
        if std::mem::replace(&mut met[n], true) {
            let reason = "it is reached twice: the nodes form a cycle, or it has two parents";
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
                "its transform, with those of its parents, is not finite",
            ));
        }
        let animated = moves || animations[n].any();
        let hidden = hides || (node.is_hidden() && !animations[n].visibility);
        let extras = Extras::read(node.extras.as_deref(), || element.clone(), marks).or(outer);
        if let Some(mesh) = node.mesh {
            if mesh >= root.meshes.len() {
                let reason = format!("it names mesh {mesh} of {}", root.meshes.len());
                return Err(source.bad(element, reason));
            }
            let skinned = node.skin.is_some();
            draws.push(Draw {
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

/// The root nodes of the scene.
fn roots(source: &GltfContext<'_>, root: &json::Root) -> Result<Vec<usize>, SceneError> {
    if let Some(scene) = root.scenes.get(root.scene.unwrap_or(0)) {
        return Ok(scene.nodes.clone());
    }
    if let Some(n) = root.scene {
        return Err(source.bad(
            "scene",
            format!("it names scene {n} of {}", root.scenes.len()),
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
            "every node is a child of another, so they form a cycle",
        ));
    }
    Ok(roots)
}
