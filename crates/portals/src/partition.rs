//! The partition of a job's scene: its leaves along walls, the outlines of the portals between them, and the
//! triangles in each leaf.
//!
//! It is a function of the scene, the view box and the region of viewpoints alone, so every worker makes the
//! same one.

use std::cmp::Ordering;
use std::collections::BTreeSet;

use rayon::prelude::*;
use sightline_exact::{Polygon, Source};
use sightline_numbers::Aabb;
use sightline_scene::Scene;
use sightline_viewcells::{Region, RegionNode};

use crate::beam::Body;
use crate::choose::{Choice, best_plane, split_wall};
use crate::enclose::{Limits, WALL};
use crate::outline::{Errors, HalfSpace, Outline};
use crate::plane::{Face, Plane, PlaneId};
use crate::region::{ForeignRegion, beside};
use crate::solids::{Solid, above, solids_in};
use crate::tree::{LeafId, Node, OUTSIDE, Portal, PortalId, Tree};

/// A large leaf is split by a plane of less merit as well: walls are found only when it is smaller. A plane
/// with this section, as a fraction of the box, divides a large leaf.
const LARGE: f64 = 0.01;
/// The least merit of a plane that divides a large leaf.
const POOR: f64 = -0.2;

/// A part of a triangle in a leaf.
#[derive(Debug)]
pub struct Part {
    /// The triangle.
    pub triangle: u32,
    /// The part.
    pub outline: Outline,
}

/// A portal as lines cross it.
#[derive(Debug)]
struct Opening {
    outline: Outline,
    /// What is below and above its plane, or a little more; `None` where no half-space says it.
    sides: [Option<HalfSpace>; 2],
}

/// Why a scene is not divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoPartition {
    /// The region is not of the scene.
    #[error(transparent)]
    Foreign(#[from] ForeignRegion),
    /// The region has more planes than a search for walls gives it.
    #[error(
        "the region of viewpoints is too finely divided; leave it out, or find it again with \
         --reachable-from"
    )]
    TooLarge,
    /// The caller ended it.
    #[error("dividing the scene was stopped")]
    Stopped,
}

/// A scene divided along its walls.
pub struct Partition {
    tree: Tree,
    /// The openings of portals that can be crossed.
    openings: Vec<Option<Opening>>,
    /// The parts of triangles in each leaf where lines can be, ascending by triangle.
    parts: Vec<Vec<Part>>,
    /// For each node whether viewpoints can be below it.
    inside: Vec<bool>,
    /// Number of triangles of the scene.
    triangles: usize,
    /// The names of its objects.
    names: Vec<String>,
    errors: Errors,
}

impl Partition {
    /// Divides a scene, for viewpoints in a region or in a box. `stop` is called before each split.
    ///
    /// # Errors
    /// [`NoPartition`].
    pub fn new(
        scene: &Scene,
        region: Option<&Region>,
        view_box: Aabb,
        limits: Limits,
        stop: &dyn Fn() -> bool,
    ) -> Result<Self, NoPartition> {
        let mut tree = Tree::with_doors(scene, &[view_box.min.to_array(), view_box.max.to_array()]);
        let is_inside = match region {
            Some(region) => follow(&mut tree, (region, scene), limits, stop)?,
            None => vec![false, true],
        };
        // What encloses a region has divided large leaves.
        let large = if region.is_some() {
            f64::INFINITY
        } else {
            LARGE
        };
        let is_inside = divide(&mut tree, is_inside, large, limits, stop)?;
        let lines_in = |leaf: LeafId| is_inside[leaf.0 as usize];
        let inside = above(&tree, &lines_in);
        let bounds = tree.bounds();
        let errors = Errors::new(f64::from(
            bounds.min.abs().max(bounds.max.abs()).max_element(),
        ));
        let openings = (0..tree.portals())
            .into_par_iter()
            .map(|k| {
                let portal = tree.portal(PortalId(k as u32));
                let plane = tree.planes().plane(portal.plane?);
                let is_crossed = portal.leaves.iter().all(|l| *l != OUTSIDE && lines_in(*l));
                is_crossed.then(|| Opening {
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

    /// The tree.
    pub fn tree(&self) -> &Tree {
        &self.tree
    }

    /// The outline of a portal between two leaves where lines can be.
    pub fn opening(&self, portal: PortalId) -> Option<&Outline> {
        self.openings[portal.0 as usize]
            .as_ref()
            .map(|opening| &opening.outline)
    }

    /// Whether all of a box is on the far side of such a portal, or in its plane: lines cross it from the
    /// near side. Exact.
    pub fn is_beyond(&self, portal: PortalId, into: LeafId, body: &Body) -> bool {
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
            .all(|at| plane.side(&Source::Given(*at), *at) != near)
    }

    /// The half-space into which such a portal is crossed.
    pub fn beyond(&self, portal: PortalId, into: LeafId) -> Option<HalfSpace> {
        let is_above = self.tree.portal(portal).leaves[1] == into;
        self.openings[portal.0 as usize].as_ref()?.sides[usize::from(is_above)]
    }

    /// The name of an object.
    pub fn name_of(&self, object: u32) -> &str {
        &self.names[object as usize]
    }

    /// The names of the doors that cover an opening, ascending.
    pub fn doors(&self) -> BTreeSet<&str> {
        let doors =
            (0..self.tree.portals() as u32).filter_map(|k| self.tree.portal(PortalId(k)).door);
        doors.map(|object| self.name_of(object)).collect()
    }

    /// The errors of doubles in the tree's box.
    pub fn errors(&self) -> Errors {
        self.errors
    }

    /// The parts of triangles in a leaf.
    pub fn parts(&self, leaf: LeafId) -> &[Part] {
        &self.parts[leaf.0 as usize]
    }

    /// Number of triangles of the scene.
    pub fn triangles(&self) -> usize {
        self.triangles
    }

    /// The parts of a box in which viewpoints can be, by leaf.
    pub fn solids(&self, of: Aabb) -> Vec<Solid> {
        solids_in(&self.tree, of, &self.inside)
    }

    /// Whether lines can be below a node.
    pub fn is_inside(&self, node: u32) -> bool {
        self.inside[node as usize]
    }

    /// Number of leaves where lines can be.
    pub fn leaves(&self) -> usize {
        let inside = |node: &(usize, &Node)| matches!(node.1, Node::Leaf(_)) && self.inside[node.0];
        self.tree.nodes().iter().enumerate().filter(inside).count()
    }
}

/// Splits a tree along the planes of a region. Returns for each leaf whether it is inside.
fn follow(
    tree: &mut Tree,
    (region, scene): (&Region, &Scene),
    limits: Limits,
    stop: &dyn Fn() -> bool,
) -> Result<Vec<bool>, NoPartition> {
    let most = limits.work.saturating_add(tree.work());
    let mut looked = 0;
    let mut is_inside = vec![false, false];
    // The leaves that the next nodes are about; `None` for a side of a plane that the tree's box has none of.
    let mut open = vec![Some(LeafId(1))];
    for node in region.nodes() {
        // A region is one tree, so there is a leaf for each node.
        let Some(leaf) = open.pop() else { break };
        let RegionNode::Split(triangle) = node else {
            if let Some(leaf) = leaf {
                is_inside[leaf.0 as usize] = *node == RegionNode::Inside;
            }
            continue;
        };
        let plane = (*triangle < scene.len())
            .then(|| tree.planes().of(*triangle))
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
            // The box of the region's tree reached farther than this one.
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

/// The side of a plane on which a leaf is that the plane does not divide.
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

/// Splits the leaves inside along walls, until they are small and no plane covers much of one, or the limits
/// are reached. Returns for each leaf whether it is inside.
fn divide(
    tree: &mut Tree,
    mut is_inside: Vec<bool>,
    large: f64,
    limits: Limits,
    stop: &dyn Fn() -> bool,
) -> Result<Vec<bool>, NoPartition> {
    let most = limits.work.saturating_add(tree.work());
    let is_worth =
        |choice: &Choice| choice.merit >= WALL || choice.merit >= POOR && choice.section >= large;
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
            // Both halves are looked at again: the lesser keeps its number, the greater comes last.
            Some(choice) => {
                split_wall(tree, leaf, choice.plane);
                is_inside.push(true);
            }
            None => next += 1,
        }
    }
    Ok(is_inside)
}

/// The parts of the triangles that can be in a set, by leaf.
fn parts(scene: &Scene, tree: &Tree, is_inside: &[bool]) -> Vec<Vec<Part>> {
    let wanted = above(tree, &|leaf| is_inside[leaf.0 as usize]);
    let clip_to_leaves = |triangle: u32| -> Vec<(LeafId, Part)> {
        let corners = scene.triangles()[triangle as usize].v.map(|v| v.as_dvec3());
        let Some(polygon) = Polygon::triangle(corners).filter(|_| scene.shows(triangle)) else {
            return Vec::new();
        };
        let plane = tree.planes().of(triangle);
        let normal = Plane::of(polygon.plane()).normal();
        let mut found = Vec::new();
        let mut open = vec![(0u32, Face::new(polygon))];
        while let Some((at, face)) = open.pop() {
            match tree.nodes()[at as usize] {
                _ if !wanted[at as usize] => {}
                Node::Leaf(leaf) => {
                    found.push((
                        leaf,
                        Part {
                            triangle,
                            outline: Outline::around(face.polygon(), normal, plane),
                        },
                    ));
                }
                Node::Split(plane, [less, greater]) => {
                    open.extend(beside(tree.planes().plane(plane), (less, greater), face));
                }
            }
        }
        found
    };
    let all: Vec<Vec<(LeafId, Part)>> = (0..scene.len())
        .into_par_iter()
        .map(clip_to_leaves)
        .collect();
    let mut parts: Vec<Vec<Part>> = (0..tree.len()).map(|_| Vec::new()).collect();
    for (leaf, part) in all.into_iter().flatten() {
        parts[leaf.0 as usize].push(part);
    }
    parts
}
