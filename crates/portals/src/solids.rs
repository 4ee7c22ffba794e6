//! The leaves of a tree as convex solids, to be measured and drawn.

use std::cmp::Ordering;

use glam::DVec3;
use sightline_exact::Polygon;

use crate::plane::{Face, Plane};
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
    let mut open = vec![(0u32, Polygon::faces_of(tree.bounds()).map(Face::new).to_vec())];
    while let Some((at, faces)) = open.pop() {
        if !wanted[at as usize] {
            continue;
        }
        match nodes[at as usize] {
            Node::Leaf(leaf) => found.push(Solid { leaf, faces }),
            Node::Split(plane, below) => {
                let plane = tree.planes().plane(plane);
                let cap = section(tree, plane, &faces);
                for (node, keep) in below.into_iter().zip([Ordering::Less, Ordering::Greater]) {
                    let parts = faces.iter().filter_map(|face| face.part(plane, &face.sides(plane), keep));
                    open.push((node, parts.chain(cap.clone()).collect()));
                }
            }
        }
    }
    found.sort_by_key(|solid| solid.leaf);
    found
}

/// The section of a plane with a solid.
fn section(tree: &Tree<'_>, plane: &Plane, faces: &[Face]) -> Option<Face> {
    let mut cap = Face::new(Polygon::section(plane.coefficients(), tree.bounds())?);
    for face in faces {
        let wall = Plane::of(face.polygon().plane());
        // The solid is on the side of any corner that is not in the wall.
        let sides = faces.iter().flat_map(|other| other.sides(&wall));
        let inner = sides.into_iter().find(|side| *side != Ordering::Equal)?;
        let sides = cap.sides(&wall);
        cap = cap.part(&wall, &sides, inner)?;
    }
    Some(cap)
}
