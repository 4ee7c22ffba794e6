//! The partition of a job's scene: its leaves along walls, the outlines of the portals between them, and the
//! triangles in each leaf.
//!
//! The partition is a function of only the scene, the view box and the region of viewpoints, so every worker
//! computes the same one.

use sightline_scene::{ObjectId, TriangleId};
use std::cmp::Ordering;
use std::collections::BTreeSet;

use rayon::prelude::*;
use sightline_exact::{PointOrigin, Polygon};
use sightline_numbers::Aabb;
use sightline_scene::Scene;
use sightline_viewcells::{Region, RegionNode};

use crate::beam::LineSource;
use crate::enclosure::{EnclosureLimits, WALL};
use crate::outline::{ErrorBounds, HalfSpace, Outline};
use crate::plane::{Face, Plane, PlaneId};
use crate::plane_choice::{RatedPlane, best_plane, split_wall};
use crate::region::{ForeignRegion, beside};
use crate::solids::{Solid, above, solids_in};
use crate::tree::{BspNode, LeafId, OUTSIDE, Portal, PortalId, Tree};

/// The minimum section of a plane that divides a large leaf.
///
/// The value is the area of the section as a fraction of the most parallel face of the tree's box.
///
/// The division splits a large leaf also along a plane of lower merit than [`WALL`], because walls have a
/// high merit only in smaller leaves.
const LARGE: f64 = 0.01;
/// The minimum merit of a plane that divides a large leaf.
const POOR: f64 = -0.2;

/// The part of a triangle in a leaf.
#[derive(Debug)]
pub struct TrianglePart {
    /// The triangle.
    pub triangle: TriangleId,
    /// The outline of the part of the triangle.
    pub outline: Outline,
}

/// A portal that lines can cross, as bounds in doubles.
#[derive(Debug)]
struct PortalOpening {
    outline: Outline,
    /// The half-spaces below and above the portal's plane, or slightly larger half-spaces; `None` if doubles
    /// cannot represent the half-space.
    sides: [Option<HalfSpace>; 2],
}

/// The reason why a scene is not divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoPartition {
    /// The region of viewpoints belongs to a different scene.
    #[error(transparent)]
    Foreign(#[from] ForeignRegion),
    /// The region of viewpoints has more planes than [`EnclosureLimits`] allow.
    #[error(
        "the region of viewpoints has too many planes; omit the region, or compute the region again with \
         --reachable-from"
    )]
    TooLarge,
    /// The caller ended the division.
    #[error("the caller stopped the division of the scene")]
    Stopped,
}

/// A scene divided along its walls.
pub struct Partition {
    tree: Tree,
    /// For each portal, its bounds in doubles; `None` if lines cannot cross the portal.
    openings: Vec<Option<PortalOpening>>,
    /// For each leaf, the parts of triangles in it, in ascending order of triangle; empty if lines cannot
    /// enter the leaf.
    parts: Vec<Vec<TrianglePart>>,
    /// For each node, true if lines can be in a leaf at or below the node.
    inside: Vec<bool>,
    /// The number of triangles of the scene.
    triangles: usize,
    /// The names of the scene's objects.
    names: Vec<String>,
    errors: ErrorBounds,
}

impl Partition {
    /// Divides a scene for viewpoints in a region, or in the view box if `region` is `None`.
    ///
    /// The function calls `stop` before each split and returns [`NoPartition::Stopped`] if `stop` returns
    /// true.
    ///
    /// # Errors
    /// [`NoPartition`] if the region does not fit the scene or the limits, or if `stop` returned true.
    pub fn new(
        scene: &Scene,
        region: Option<&Region>,
        view_box: Aabb,
        limits: EnclosureLimits,
        stop: &dyn Fn() -> bool,
    ) -> Result<Self, NoPartition> {
        let mut tree = Tree::with_doors(scene, &[view_box.min.to_array(), view_box.max.to_array()]);
        let is_inside = match region {
            Some(region) => follow(&mut tree, region, scene, limits, stop)?,
            None => vec![false, true],
        };
        // The search that computed the region has already divided large leaves.
        let large = if region.is_some() {
            f64::INFINITY
        } else {
            LARGE
        };
        let is_inside = divide(&mut tree, is_inside, large, limits, stop)?;
        let lines_in = |leaf: LeafId| is_inside[leaf.0 as usize];
        let inside = above(&tree, &lines_in);
        let bounds = tree.bounds();
        let errors = ErrorBounds::new(f64::from(
            bounds.min.abs().max(bounds.max.abs()).max_element(),
        ));
        let openings = (0..tree.portals())
            .into_par_iter()
            .map(|k| {
                let portal = tree.portal(PortalId(k as u32));
                let plane = tree.planes().plane(portal.plane?);
                let is_crossed = portal.leaves.iter().all(|l| *l != OUTSIDE && lines_in(*l));
                is_crossed.then(|| PortalOpening {
                    outline: Outline::around(portal.face.polygon(), plane.normal(), portal.plane),
                    sides: [false, true].map(|is_above| HalfSpace::beside(plane, is_above, errors)),
                })
            })
            .collect();
        let parts = parts(scene, &tree, &is_inside);
        let names = scene
            .objects()
            .iter()
            .map(|object| object.name.clone())
            .collect();
        Ok(Self {
            tree,
            openings,
            parts,
            inside,
            triangles: scene.len() as usize,
            names,
            errors,
        })
    }

    /// Returns the tree.
    pub fn tree(&self) -> &Tree {
        &self.tree
    }

    /// Returns the outline of a portal, or `None` if lines cannot be in one of the portal's leaves.
    pub fn opening(&self, portal: PortalId) -> Option<&Outline> {
        self.openings[portal.0 as usize]
            .as_ref()
            .map(|opening| &opening.outline)
    }

    /// Returns true if a body is entirely on the far side of a portal, the side of the leaf `into`, or in the
    /// portal's plane.
    ///
    /// Lines cross the portal from the near side, so no line from such a body crosses the portal. The test is
    /// exact.
    pub fn is_beyond(&self, portal: PortalId, into: LeafId, body: &LineSource) -> bool {
        let Portal {
            plane: Some(plane),
            leaves,
            ..
        } = self.tree.portal(portal)
        else {
            return false;
        };
        let plane = self.tree.planes().plane(*plane);
        let near = if leaves[1] == into {
            Ordering::Less
        } else {
            Ordering::Greater
        };
        body.hull
            .corners
            .iter()
            .all(|at| plane.side(&PointOrigin::Given(*at), *at) != near)
    }

    /// Returns the half-space that contains lines beyond a portal after they cross it into the leaf `into`.
    /// The result is `None` if lines cannot cross the portal or doubles cannot represent the half-space.
    pub fn beyond(&self, portal: PortalId, into: LeafId) -> Option<HalfSpace> {
        let is_above = self.tree.portal(portal).leaves[1] == into;
        self.openings[portal.0 as usize].as_ref()?.sides[usize::from(is_above)]
    }

    /// Returns the name of an object.
    pub fn name_of(&self, object: ObjectId) -> &str {
        &self.names[object.at()]
    }

    /// Returns the names of the doors that cover a portal, in ascending order.
    pub fn doors(&self) -> BTreeSet<&str> {
        let doors =
            (0..self.tree.portals() as u32).filter_map(|k| self.tree.portal(PortalId(k)).door);
        doors.map(|object| self.name_of(object)).collect()
    }

    /// Returns the error bounds of doubles in the tree's box.
    pub fn errors(&self) -> ErrorBounds {
        self.errors
    }

    /// Returns the parts of triangles in a leaf, in ascending order of triangle.
    pub fn parts(&self, leaf: LeafId) -> &[TrianglePart] {
        &self.parts[leaf.0 as usize]
    }

    /// Returns the number of triangles of the scene.
    pub fn triangles(&self) -> usize {
        self.triangles
    }

    /// Returns the parts of a box in which viewpoints can be, one per leaf.
    pub fn solids(&self, bounds: Aabb) -> Vec<Solid> {
        solids_in(&self.tree, bounds, &self.inside)
    }

    /// Returns true if lines can be in a leaf at or below a node.
    pub fn is_inside(&self, node: u32) -> bool {
        self.inside[node as usize]
    }

    /// Returns the number of leaves in which lines can be.
    pub fn leaves(&self) -> usize {
        let inside =
            |node: &(usize, &BspNode)| matches!(node.1, BspNode::Leaf(_)) && self.inside[node.0];
        self.tree.nodes().iter().enumerate().filter(inside).count()
    }
}

/// Splits a tree along the planes of a region. Returns, for each leaf, true if it is inside the region.
fn follow(
    tree: &mut Tree,
    region: &Region,
    scene: &Scene,
    limits: EnclosureLimits,
    stop: &dyn Fn() -> bool,
) -> Result<Vec<bool>, NoPartition> {
    let most = limits.work.saturating_add(tree.work());
    let mut looked = 0;
    let mut is_inside = vec![false, false];
    // The leaves of the next nodes; `None` for the side of a plane that contains no part of the tree's box.
    let mut open = vec![Some(LeafId(1))];
    for node in region.nodes() {
        // A region is one tree, so a leaf exists for each node.
        let Some(leaf) = open.pop() else { break };
        let RegionNode::Split(triangle) = node else {
            if let Some(leaf) = leaf {
                is_inside[leaf.0 as usize] = *node == RegionNode::Inside;
            }
            continue;
        };
        let plane = (*triangle < scene.len())
            .then(|| tree.planes().find_plane(TriangleId(*triangle)))
            .flatten();
        let plane = plane.ok_or(ForeignRegion(*triangle))?;
        let Some(leaf) = leaf else {
            open.extend([None, None]);
            continue;
        };
        if stop() {
            return Err(NoPartition::Stopped);
        }
        if tree.len() > limits.leaves || tree.work() + looked >= most {
            return Err(NoPartition::TooLarge);
        }
        if tree.section(leaf, plane).is_some() {
            let upper = tree.split(leaf, plane);
            is_inside.resize(tree.len(), false);
            open.extend([Some(upper), Some(leaf)]);
        } else {
            // The box of the region's tree was larger than this tree's box.
            looked += tree.nodes().len() as u64;
            let is_upper = side_of(tree, leaf, plane) == Ordering::Greater;
            open.extend(if is_upper {
                [Some(leaf), None]
            } else {
                [None, Some(leaf)]
            });
        }
    }
    Ok(is_inside)
}

/// Returns the side of a plane that contains a leaf. The plane must not divide the leaf.
fn side_of(tree: &Tree, leaf: LeafId, plane: PlaneId) -> Ordering {
    let of_leaf = solids_in(tree, tree.bounds(), &above(tree, &|l| l == leaf));
    let sides = of_leaf
        .iter()
        .flat_map(|s| &s.faces)
        .flat_map(|f| f.sides(tree.planes().plane(plane)));
    sides
        .into_iter()
        .find(|side| *side != Ordering::Equal)
        .unwrap_or(Ordering::Less)
}

/// Splits the leaves for which `is_inside` is true along walls. Returns `is_inside` for the leaves of the new
/// tree: each part of a split leaf is inside.
///
/// The function ends if all leaves are small and no plane's triangles cover much of a leaf's section, or at
/// the limits.
fn divide(
    tree: &mut Tree,
    mut is_inside: Vec<bool>,
    large: f64,
    limits: EnclosureLimits,
    stop: &dyn Fn() -> bool,
) -> Result<Vec<bool>, NoPartition> {
    let most = limits.work.saturating_add(tree.work());
    let is_worth = |choice: &RatedPlane| {
        choice.merit >= WALL || choice.merit >= POOR && choice.section >= large
    };
    let mut next = 1;
    while next < tree.len() {
        let leaf = LeafId(next as u32);
        let is_open = is_inside[next] && !tree.leaf(leaf).detail.is_empty();
        let may = tree.len() < limits.leaves && tree.work() < most;
        if is_open && stop() {
            return Err(NoPartition::Stopped);
        }
        let choice = if is_open && may {
            best_plane(tree, leaf)
        } else {
            None
        };
        match choice.filter(is_worth) {
            // Inspect both halves again: the lower half keeps the leaf's number, and the upper half is the
            // last leaf.
            Some(choice) => {
                split_wall(tree, leaf, choice.plane);
                is_inside.push(true);
            }
            None => next += 1,
        }
    }
    Ok(is_inside)
}

/// Computes, for each leaf, the parts of all triangles that can be in a set of visible triangles.
fn parts(scene: &Scene, tree: &Tree, is_inside: &[bool]) -> Vec<Vec<TrianglePart>> {
    let wanted = above(tree, &|leaf| is_inside[leaf.0 as usize]);
    let clip_to_leaves = |triangle: TriangleId| -> Vec<(LeafId, TrianglePart)> {
        let corners = scene.triangles()[triangle.at()].v.map(|v| v.as_dvec3());
        let Some(polygon) = Polygon::triangle(corners).filter(|_| scene.shows(triangle)) else {
            return Vec::new();
        };
        let plane = tree.planes().find_plane(triangle);
        let normal = Plane::from_coefficients(polygon.plane()).normal();
        let mut found = Vec::new();
        let mut open = vec![(0u32, Face::new(polygon))];
        while let Some((at, face)) = open.pop() {
            match tree.nodes()[at as usize] {
                _ if !wanted[at as usize] => {}
                BspNode::Leaf(leaf) => {
                    found.push((
                        leaf,
                        TrianglePart {
                            triangle,
                            outline: Outline::around(face.polygon(), normal, plane),
                        },
                    ));
                }
                BspNode::Split(plane, [less, greater]) => {
                    open.extend(beside(tree.planes().plane(plane), less, greater, face));
                }
            }
        }
        found
    };
    let all: Vec<Vec<(LeafId, TrianglePart)>> = (0..scene.len())
        .into_par_iter()
        .map(|t| clip_to_leaves(TriangleId(t)))
        .collect();
    let mut parts: Vec<Vec<TrianglePart>> = (0..tree.len()).map(|_| Vec::new()).collect();
    for (leaf, part) in all.into_iter().flatten() {
        parts[leaf.0 as usize].push(part);
    }
    parts
}
