//! The leaves of a tree as convex solids, to be measured and drawn, and their parts in a box.

use glam::DVec3;
use sightline_numbers::Aabb;

use crate::convex::{divide, whole};
use crate::plane::Face;
use crate::tree::{LeafId, Node, Tree};

/// A leaf with the faces that bound it.
pub struct Solid {
    /// The leaf.
    pub leaf: LeafId,
    /// Its faces.
    pub faces: Vec<Face>,
}

impl Solid {
    /// The volume, rounded: the sum of the pyramids from a point inside to the faces.
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

/// The solids of some leaves, ascending. Those that reach to the border of the tree's box end there.
pub fn solids(tree: &Tree, leaves: &[LeafId]) -> Vec<Solid> {
    let wanted = above(tree, &|leaf| leaves.binary_search(&leaf).is_ok());
    solids_in(tree, tree.bounds(), &wanted)
}

/// For each node whether there is a wanted leaf below it.
pub fn above(tree: &Tree, wanted: &dyn Fn(LeafId) -> bool) -> Vec<bool> {
    let nodes = tree.nodes();
    let mut found = vec![false; nodes.len()];
    // Children have greater numbers than their parents.
    for (i, node) in nodes.iter().enumerate().rev() {
        found[i] = match node {
            Node::Leaf(leaf) => wanted(*leaf),
            Node::Split(_, children) => children.iter().any(|c| found[*c as usize]),
        };
    }
    found
}

/// The parts of leaves in a box, ascending by leaf: of those below the `wanted` nodes.
pub fn solids_in(tree: &Tree, of: Aabb, wanted: &[bool]) -> Vec<Solid> {
    let nodes = tree.nodes();
    let mut found = Vec::new();
    let mut open = vec![(0u32, whole(of))];
    while let Some((at, faces)) = open.pop() {
        if faces.is_empty() || !wanted[at as usize] {
            continue;
        }
        match nodes[at as usize] {
            Node::Leaf(leaf) => found.push(Solid { leaf, faces }),
            Node::Split(plane, below) => {
                open.extend(
                    below
                        .into_iter()
                        .zip(divide(faces, tree.planes().plane(plane), of)),
                );
            }
        }
    }
    found.sort_by_key(|solid| solid.leaf);
    found
}
