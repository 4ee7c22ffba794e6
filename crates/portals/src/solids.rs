//! The leaves of a tree as convex solids, for measurements and drawings, and their parts in a box.

use glam::DVec3;
use sightline_numbers::Aabb;

use crate::convex::{divide, whole};
use crate::plane::Face;
use crate::tree::{BspNode, LeafId, Tree};

/// A leaf with the faces that bound it.
pub struct Solid {
    /// The leaf.
    pub leaf: LeafId,
    /// The faces of the leaf.
    pub faces: Vec<Face>,
}

impl Solid {
    /// Computes the volume, rounded, as the sum of the pyramids from a point inside to the faces.
    pub fn volume(&self) -> f64 {
        let corners = || self.faces.iter().flat_map(|f| f.corners());
        let inside = corners().sum::<DVec3>() / corners().count().max(1) as f64;
        let pyramid = |face: &Face| {
            let at = face.corners();
            let fan = at
                .windows(2)
                .map(|w| (w[0] - at[0]).cross(w[1] - at[0]).dot(inside - at[0]));
            fan.sum::<f64>().abs() / 6.0
        };
        self.faces.iter().map(pyramid).sum()
    }
}

/// Returns the solids of some leaves, in ascending order.
///
/// The solid of a leaf that extends to the border of the tree's box ends at this border.
pub fn solids(tree: &Tree, leaves: &[LeafId]) -> Vec<Solid> {
    let wanted = above(tree, &|leaf| leaves.binary_search(&leaf).is_ok());
    solids_in(tree, tree.bounds(), &wanted)
}

/// Returns, for each node, true if a leaf for which `wanted` is true is at or below the node.
pub fn above(tree: &Tree, wanted: &dyn Fn(LeafId) -> bool) -> Vec<bool> {
    let nodes = tree.nodes();
    let mut found = vec![false; nodes.len()];
    // Children have larger numbers than their parents.
    for (i, node) in nodes.iter().enumerate().rev() {
        found[i] = match node {
            BspNode::Leaf(leaf) => wanted(*leaf),
            BspNode::Split(_, children) => children.iter().any(|c| found[*c as usize]),
        };
    }
    found
}

/// Returns the parts, within a box, of the leaves for which `wanted` is true, in ascending order of leaf.
/// `wanted` has an entry for each node, as [`above`] returns it.
pub fn solids_in(tree: &Tree, bounds: Aabb, wanted: &[bool]) -> Vec<Solid> {
    let nodes = tree.nodes();
    let mut found = Vec::new();
    let mut open = vec![(0u32, whole(bounds))];
    while let Some((at, faces)) = open.pop() {
        if faces.is_empty() || !wanted[at as usize] {
            continue;
        }
        match nodes[at as usize] {
            BspNode::Leaf(leaf) => found.push(Solid { leaf, faces }),
            BspNode::Split(plane, below) => {
                open.extend(below.into_iter().zip(divide(
                    faces,
                    tree.planes().plane(plane),
                    bounds,
                )));
            }
        }
    }
    found.sort_by_key(|solid| solid.leaf);
    found
}
