//! The reached leaves of a tree as a region of a job, and what a region holds.
//!
//! A region's planes are those of its scene's triangles, so all questions about it are answered exactly. It
//! needs no box: a reached leaf that is not bounded by planes leads outside, and then the outside is reached.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};
use sightline_exact::{ExactViewRegion, Polygon};
use sightline_numbers::Aabb;
use sightline_scene::Scene;
use sightline_viewcells::{Region, RegionError, RegionNode};

use crate::convex::{divide, whole};
use crate::plane::{Face, Plane};
use crate::planes::divides;
use crate::tree::{LeafId, Node, Tree};

/// The region of some leaves of a tree, ascending.
///
/// # Errors
/// [`RegionError`] when it is too large for a job.
pub fn region_of(tree: &Tree, leaves: &[LeafId]) -> Result<Region, RegionError> {
    // Children have greater numbers than their parents, so one pass from the end knows all subtrees: a
    // subtree that is wholly inside or outside becomes one node.
    let nodes = tree.nodes();
    let mut whole: Vec<Option<bool>> = vec![None; nodes.len()];
    for (i, node) in nodes.iter().enumerate().rev() {
        whole[i] = match node {
            Node::Leaf(leaf) => Some(leaves.binary_search(leaf).is_ok()),
            Node::Split(_, [a, b]) => {
                let [a, b] = [a, b].map(|n| whole[*n as usize]);
                if a == b { a } else { None }
            }
        };
    }
    let mut out = Vec::new();
    let mut open = vec![0u32];
    while let Some(at) = open.pop() {
        out.push(match (whole[at as usize], nodes[at as usize]) {
            (Some(true), _) => RegionNode::Inside,
            (None, Node::Split(plane, [a, b])) => {
                open.extend([b, a]);
                RegionNode::Split(tree.planes().triangle(plane))
            }
            _ => RegionNode::Outside,
        });
    }
    Region::new(out)
}

/// A region with its planes.
#[derive(Debug)]
pub struct Reached {
    nodes: Vec<SpacePart>,
}

/// A part of space: wholly outside, wholly inside, or divided. The lesser side of a plane is the next part.
#[derive(Debug)]
enum SpacePart {
    Outside,
    Inside,
    Split { plane: Box<Plane>, greater: u32 },
}

/// A region that is not of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the region of viewpoints names triangle {0}, which has no plane in this scene; is it another scene?"
)]
pub struct ForeignRegion(pub u32);

impl Reached {
    /// Finds the planes of a region.
    ///
    /// # Errors
    /// [`ForeignRegion`].
    pub fn new(region: &Region, scene: &Scene) -> Result<Self, ForeignRegion> {
        let mut nodes: Vec<SpacePart> = Vec::with_capacity(region.nodes().len());
        // Splits whose greater side is still to come.
        let mut open: Vec<usize> = Vec::new();
        for node in region.nodes() {
            let number = nodes.len();
            match node {
                RegionNode::Split(triangle) => {
                    if *triangle >= scene.len() || !divides(scene, *triangle) {
                        return Err(ForeignRegion(*triangle));
                    }
                    let plane = Box::new(Plane::through(scene.triangles()[*triangle as usize].v));
                    nodes.push(SpacePart::Split { plane, greater: 0 });
                    open.push(number);
                }
                RegionNode::Inside | RegionNode::Outside => {
                    nodes.push(if *node == RegionNode::Inside {
                        SpacePart::Inside
                    } else {
                        SpacePart::Outside
                    });
                    // The next node begins the greater side of the innermost split that has none yet.
                    if let Some(split) = open.pop()
                        && let SpacePart::Split { greater, .. } = &mut nodes[split]
                    {
                        *greater = number as u32 + 1;
                    }
                }
            }
        }
        Ok(Self { nodes })
    }

    /// Whether a viewpoint can be at a point: whether it is in the closed region.
    pub fn holds(&self, point: Vec3) -> bool {
        let mut open = vec![0u32];
        while let Some(at) = open.pop() {
            match &self.nodes[at as usize] {
                SpacePart::Outside => {}
                SpacePart::Inside => return true,
                SpacePart::Split { plane, greater } => match plane.side_of(point) {
                    Ordering::Less => open.push(at + 1),
                    Ordering::Greater => open.push(*greater),
                    Ordering::Equal => open.extend([at + 1, *greater]),
                },
            }
        }
        false
    }

    /// The parts of a cell's face through which free segments leave the cell, without common area: those in
    /// the region. Of a face in a plane of the region they are in it on both sides of the plane; where one
    /// side is outside, a wall is in the plane.
    pub fn parts(&self, face: &Polygon) -> Vec<Polygon> {
        let parts = self.parts_from(0, Face::new(face.clone()));
        parts
            .into_iter()
            .flat_map(|part| part.polygon().clone().pieces())
            .collect()
    }

    /// The parts of a face that are in the region, from a node on.
    fn parts_from(&self, node: u32, face: Face) -> Vec<Face> {
        let mut found = Vec::new();
        let mut open = vec![(node, face)];
        while let Some((at, face)) = open.pop() {
            match &self.nodes[at as usize] {
                SpacePart::Outside => {}
                SpacePart::Inside => found.push(face),
                SpacePart::Split { plane, greater } => {
                    if face
                        .sides(plane)
                        .iter()
                        .all(|side| *side == Ordering::Equal)
                    {
                        // No other plane of the region is this one, so this happens once.
                        let lesser = self.parts_from(at + 1, face);
                        found.extend(
                            lesser
                                .into_iter()
                                .flat_map(|part| self.parts_from(*greater, part)),
                        );
                    } else {
                        open.extend(beside(plane, (at + 1, *greater), face));
                    }
                }
            }
        }
        found
    }

    /// Whether a triangle has an area in common with the closed region within a closed box. What touches it
    /// in an edge or a corner alone is not met by lines in it.
    pub fn touches(&self, triangle: [Vec3; 3], within: Aabb) -> bool {
        let Some(mut face) = Polygon::triangle(triangle.map(|v| v.as_dvec3())).map(Face::new)
        else {
            return false;
        };
        let sticks_out = !triangle.iter().all(|v| within.contains(*v));
        for wall in Polygon::faces_of(within).into_iter().filter(|_| sticks_out) {
            let plane = Plane::of(wall.plane());
            // The box is on the side of its corners that are not on the wall.
            let inner = [within.min, within.max].map(|p| plane.side_of(p));
            let inner = if inner[0] == Ordering::Equal {
                inner[1]
            } else {
                inner[0]
            };
            let sides = face.sides(&plane);
            // A triangle in the plane of the wall is not cut.
            if sides.iter().any(|side| *side != Ordering::Equal) {
                let Some(part) = face.part(&plane, &sides, inner) else {
                    return false;
                };
                face = part;
            }
        }
        let mut open = vec![(0u32, face)];
        while let Some((at, face)) = open.pop() {
            match &self.nodes[at as usize] {
                SpacePart::Outside => {}
                SpacePart::Inside => return true,
                SpacePart::Split { plane, greater } => {
                    open.extend(beside(plane, (at + 1, *greater), face))
                }
            }
        }
        false
    }

    /// Whether the region has a volume within a box.
    pub fn meets(&self, of: Aabb) -> bool {
        self.solid(of, &mut |_| true).is_some()
    }

    /// A point of the region in a box; `None` when there is none, or single precision has none.
    pub fn any_in(&self, of: Aabb) -> Option<Vec3> {
        let middle = |faces: &[Face]| {
            let corners = || faces.iter().flat_map(|face| face.corners());
            (corners().sum::<DVec3>() / corners().count() as f64)
                .as_vec3()
                .clamp(of.min, of.max)
        };
        let solid = self.solid(of, &mut |faces| self.holds(middle(faces)));
        solid.map(|faces| middle(&faces))
    }

    /// The faces of the first convex part that the region has within a box and that `wanted` takes.
    fn solid(&self, of: Aabb, wanted: &mut dyn FnMut(&[Face]) -> bool) -> Option<Vec<Face>> {
        let mut open = vec![(0u32, whole(of))];
        while let Some((at, faces)) = open.pop() {
            match &self.nodes[at as usize] {
                _ if faces.is_empty() => {}
                SpacePart::Outside => {}
                SpacePart::Inside if wanted(&faces) => return Some(faces),
                SpacePart::Inside => {}
                SpacePart::Split { plane, greater } => {
                    open.extend([at + 1, *greater].into_iter().zip(divide(faces, plane, of)));
                }
            }
        }
        None
    }
}

/// The parts of a face on both sides of a plane, with the nodes there. A face in the plane borders on both
/// sides.
pub(crate) fn beside(plane: &Plane, (lesser, greater): (u32, u32), face: Face) -> Vec<(u32, Face)> {
    let sides = face.sides(plane);
    let in_plane = sides.iter().all(|side| *side == Ordering::Equal);
    [(lesser, Ordering::Less), (greater, Ordering::Greater)]
        .into_iter()
        .filter_map(|(node, keep)| {
            let part = if in_plane {
                Some(face.clone())
            } else {
                face.part(plane, &sides, keep)
            };
            part.map(|part| (node, part))
        })
        .collect()
}

impl ExactViewRegion for Reached {
    fn hold(&self, point: Vec3) -> bool {
        self.holds(point)
    }

    fn parts(&self, face: &Polygon) -> Vec<Polygon> {
        self.parts(face)
    }

    fn touch(&self, triangle: [Vec3; 3], within: Aabb) -> bool {
        self.touches(triangle, within)
    }
}
