//! The leaves of a tree as convex solids, to be measured and drawn.

use glam::DVec3;

use crate::convex::{divide, whole};
use crate::plane::Face;
use crate::tree::{LeafId, Node, Tree};

/// A leaf with the faces that bound it.
pub struct Solid {
    /// The leaf.
    pub leaf: LeafId,
    /// Its faces, some of them in parts.
    pub faces: Vec<Face>,
}

impl Solid {
    /// The volume, rounded: the sum of the pyramids from a point inside to the faces.
    pub fn volume(&self) -> f64 {
        let corners = || self.faces.iter().flat_map(|f| f.corners());
        let inside = corners().sum::<DVec3>() / corners().count().max(1) as f64;
        let pyramid = |face: &Face| {
            let at = face.corners();
            let fan = at.windows(2).map(|w| (w[0] - at[0]).cross(w[1] - at[0]).dot(inside - at[0]));
            fan.sum::<f64>().abs() / 6.0
        };
        self.faces.iter().map(pyramid).sum()
    }
}

/// The solids of some leaves, ascending. Those that reach to the border of the tree's box end there.
pub fn solids(tree: &Tree<'_>, leaves: &[LeafId]) -> Vec<Solid> {
    let nodes = tree.nodes();
    // Children have greater numbers than their parents.
    let mut wanted = vec![false; nodes.len()];
    for (i, node) in nodes.iter().enumerate().rev() {
        wanted[i] = match node {
            Node::Leaf(leaf) => leaves.binary_search(leaf).is_ok(),
            Node::Split(_, children) => children.iter().any(|c| wanted[*c as usize]),
        };
    }
    let mut found = Vec::new();
    let mut open = vec![(0u32, whole(tree.bounds()))];
    while let Some((at, faces)) = open.pop() {
        if !wanted[at as usize] {
            continue;
        }
        match nodes[at as usize] {
            Node::Leaf(leaf) => found.push(Solid { leaf, faces }),
            Node::Split(plane, below) => {
                let parts = divide(faces, tree.planes().plane(plane), tree.bounds());
                open.extend(below.into_iter().zip(parts));
            }
        }
    }
    found.sort_by_key(|solid| solid.leaf);
    found
}
