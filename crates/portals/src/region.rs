//! The region of a job: its computation from the reached leaves of a tree, and exact queries about its space.
//!
//! A region's planes are planes of its scene's triangles, so all queries are exact. A region needs no
//! bounding box: if planes do not bound a reached leaf, the leaf leads outside, and then the points reach the
//! outside, too.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};
use sightline_exact::{ExactViewRegion, Polygon};
use sightline_numbers::Aabb;
use sightline_scene::Scene;
use sightline_viewcells::{Region, RegionError, RegionNode};

use crate::convex::{divide, whole};
use crate::plane::{Face, Plane};
use crate::planes::divides;
use crate::tree::{BspNode, LeafId, Tree};

/// Computes the region that consists of some leaves of a tree. `leaves` must be in ascending order.
///
/// # Errors
/// [`RegionError`] if the region is too large for a job.
pub fn region_of(tree: &Tree, leaves: &[LeafId]) -> Result<Region, RegionError> {
    // Children have larger numbers than their parents, so one pass from the end visits subtrees before their
    // parents. A subtree that is wholly inside or outside becomes one node.
    let nodes = tree.nodes();
    let mut whole: Vec<Option<bool>> = vec![None; nodes.len()];
    for (i, node) in nodes.iter().enumerate().rev() {
        whole[i] = match node {
            BspNode::Leaf(leaf) => Some(leaves.binary_search(leaf).is_ok()),
            BspNode::Split(_, [a, b]) => {
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
            (None, BspNode::Split(plane, [a, b])) => {
                open.extend([b, a]);
                RegionNode::Split(tree.planes().triangle(plane).0)
            }
            _ => RegionNode::Outside,
        });
    }
    Region::new(out)
}

/// The region of a job with its planes, for exact queries about its space.
#[derive(Debug)]
pub struct RegionPlanes {
    nodes: Vec<SpacePart>,
}

/// A part of space: wholly outside the region, wholly inside, or divided by a plane. The part on the lower
/// side of the plane is the next entry of the list, and `greater` is the index of the part on the upper side.
#[derive(Debug)]
enum SpacePart {
    Outside,
    Inside,
    Split { plane: Box<Plane>, greater: u32 },
}

/// The error that a region names a triangle without a plane in this scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the region of viewpoints refers to triangle {0}, which has no plane in this scene; use the \
     scene of the region"
)]
pub struct ForeignRegion(pub u32);

impl RegionPlanes {
    /// Computes the planes of a region.
    ///
    /// # Errors
    /// [`ForeignRegion`] if a triangle of the region does not divide space in this scene.
    pub fn new(region: &Region, scene: &Scene) -> Result<Self, ForeignRegion> {
        let mut nodes: Vec<SpacePart> = Vec::with_capacity(region.nodes().len());
        // The indices of the splits whose upper side has not started yet.
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
                    // The next node begins the upper side of the innermost split whose upper side has not
                    // started.
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

    /// Returns true if a point is in the closed region, so that a viewpoint can be there.
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

    /// Returns the parts of a cell's face through which free segments from viewpoints leave the cell. The
    /// parts do not overlap.
    ///
    /// The parts are in the region. If the face is in a plane of the region, a part must be in the region on
    /// both sides of the plane; if one side is outside the region, a wall is in the plane.
    pub fn parts(&self, face: &Polygon) -> Vec<Polygon> {
        let parts = self.parts_from(0, Face::new(face.clone()));
        parts
            .into_iter()
            .flat_map(|part| part.polygon().clone().pieces())
            .collect()
    }

    /// Returns the parts of a face that are in the region below a node.
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
                        // No other plane of the region equals this plane, so this branch runs once per path.
                        let lesser = self.parts_from(at + 1, face);
                        found.extend(
                            lesser
                                .into_iter()
                                .flat_map(|part| self.parts_from(*greater, part)),
                        );
                    } else {
                        open.extend(beside(plane, at + 1, *greater, face));
                    }
                }
            }
        }
        found
    }

    /// Returns true if a triangle shares an area with the closed region within a closed box.
    ///
    /// A triangle that touches the region only in an edge or a corner does not count, because lines in the
    /// region do not meet it.
    pub fn touches(&self, triangle: [Vec3; 3], within: Aabb) -> bool {
        let Some(mut face) = Polygon::triangle(triangle.map(|v| v.as_dvec3())).map(Face::new)
        else {
            return false;
        };
        let sticks_out = !triangle.iter().all(|v| within.contains(*v));
        for wall in Polygon::faces_of(within).into_iter().filter(|_| sticks_out) {
            let plane = Plane::from_coefficients(wall.plane());
            // The box is on the side of its corners that are not on the wall.
            let inner = [within.min, within.max].map(|p| plane.side_of(p));
            let inner = if inner[0] == Ordering::Equal {
                inner[1]
            } else {
                inner[0]
            };
            let sides = face.sides(&plane);
            // Do not cut a triangle in the plane of the wall.
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
                    open.extend(beside(plane, at + 1, *greater, face))
                }
            }
        }
        false
    }

    /// Returns true if the region has a volume within a box.
    pub fn meets(&self, bounds: Aabb) -> bool {
        self.solid(bounds, &mut |_| true).is_some()
    }

    /// Returns a point that is in the region and in a box.
    ///
    /// The result is `None` if no such point exists, or if rounding to single precision moves every tried
    /// point out of the region.
    pub fn any_in(&self, bounds: Aabb) -> Option<Vec3> {
        let middle = |faces: &[Face]| {
            let corners = || faces.iter().flat_map(|face| face.corners());
            (corners().sum::<DVec3>() / corners().count() as f64)
                .as_vec3()
                .clamp(bounds.min, bounds.max)
        };
        let solid = self.solid(bounds, &mut |faces| self.holds(middle(faces)));
        solid.map(|faces| middle(&faces))
    }

    /// Returns the faces of the first convex part of the region within a box for which `wanted` returns true,
    /// or `None` if no such part exists.
    fn solid(&self, bounds: Aabb, wanted: &mut dyn FnMut(&[Face]) -> bool) -> Option<Vec<Face>> {
        let mut open = vec![(0u32, whole(bounds))];
        while let Some((at, faces)) = open.pop() {
            match &self.nodes[at as usize] {
                _ if faces.is_empty() => {}
                SpacePart::Outside => {}
                SpacePart::Inside if wanted(&faces) => return Some(faces),
                SpacePart::Inside => {}
                SpacePart::Split { plane, greater } => {
                    open.extend(
                        [at + 1, *greater]
                            .into_iter()
                            .zip(divide(faces, plane, bounds)),
                    );
                }
            }
        }
        None
    }
}

/// Returns the parts of a face on both sides of a plane, each with the node of its side: `lesser` or
/// `greater`.
///
/// A face in the plane belongs to both sides.
pub(crate) fn beside(plane: &Plane, lesser: u32, greater: u32, face: Face) -> Vec<(u32, Face)> {
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

impl ExactViewRegion for RegionPlanes {
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
