//! The binary space partition of a scene along planes of its triangles: convex leaves, and the openings
//! (portals) that connect them (Teller 1992, sections 5.2 and 8.2).
//!
//! All computations are exact. A leaf is an intersection of half-spaces. A portal is a convex part of the
//! border of two leaves that no triangle in its plane covers. Triangles that no plane of the tree contains
//! stay in the leaves as detail and do not block. So a leaf that the search does not reach is proved to be
//! unreachable, regardless of the chosen planes.

use sightline_scene::{ObjectId, TriangleId};
use std::cmp::Ordering;
use std::collections::BTreeMap;

use glam::Vec3;
use sightline_exact::Polygon;
use sightline_numbers::Aabb;
use sightline_scene::Scene;

use crate::face_cover::divide_covered;
use crate::plane::{Face, Plane, PlaneId};
use crate::planes::{Planes, by_place, is_door};

/// The work of a split per wall of the leaf, in units of [`Tree::work`].
const WALL_WORK: u64 = 32;

/// The index of a leaf in its [`Tree`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LeafId(pub u32);

/// The leaf that represents all space outside the box of the tree.
pub const OUTSIDE: LeafId = LeafId(0);

/// The index of a portal in its [`Tree`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PortalId(pub u32);

/// A node of the tree: an inner node or a leaf.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BspNode {
    /// A plane, and the indices of the nodes on the plane's lower and upper side.
    Split(PlaneId, [u32; 2]),
    /// A leaf.
    Leaf(LeafId),
}

/// The part of a triangle that lies in a leaf.
#[derive(Clone, Debug)]
pub struct Fragment {
    /// The plane of the triangle.
    pub plane: PlaneId,
    /// The object whose door contains the triangle, or `None` if it is not part of a door.
    pub door: Option<ObjectId>,
    /// The part of the triangle in the leaf.
    pub face: Face,
}

/// A convex cell of the partition.
#[derive(Debug, Default)]
pub struct Leaf {
    /// The index of the leaf's node in the tree.
    node: u32,
    /// The planes of the tree's nodes from the root to the leaf, each with the side that contains the leaf.
    pub walls: Vec<(PlaneId, Ordering)>,
    /// The parts of triangles inside the leaf that no plane of the tree contains.
    pub detail: Vec<Fragment>,
    /// The portals between the leaf and its neighbours.
    pub portals: Vec<PortalId>,
    /// The planes of the leaf's detail that belong to walls along which the leaf was split, in ascending
    /// order.
    pub begun: Vec<PlaneId>,
}

/// An opening between two leaves.
#[derive(Debug)]
pub struct Portal {
    /// The face of the opening, which contains the true opening and may be larger.
    pub face: Face,
    /// The plane of the portal; `None` for a portal in a face of the tree's box.
    pub plane: Option<PlaneId>,
    /// The object whose door covers the portal when the door is shut; `None` if no door covers the portal.
    pub door: Option<ObjectId>,
    /// The leaves on the lower and on the upper side of the portal's face.
    pub leaves: [LeafId; 2],
}

impl Portal {
    /// Returns the leaf on the other side of the portal, as seen from `leaf`.
    pub fn beyond(&self, leaf: LeafId) -> LeafId {
        if self.leaves[0] == leaf {
            self.leaves[1]
        } else {
            self.leaves[0]
        }
    }
}

/// A partition of a box, which contains the scene, into convex leaves with portals.
pub struct Tree {
    planes: Planes,
    bounds: Aabb,
    nodes: Vec<BspNode>,
    leaves: Vec<Leaf>,
    portals: Vec<Portal>,
    /// The value of [`Tree::work`].
    work: u64,
}

impl Tree {
    /// Creates a tree of one leaf with all blocking triangles as detail.
    ///
    /// The box of the tree contains the scene's bounds and `points`, with a margin.
    pub fn new(scene: &Scene, points: &[[f32; 3]]) -> Self {
        Self::build(scene, points, false)
    }

    /// Creates a tree like [`Tree::new`] that also contains the scene's doors. A door's triangles divide an
    /// opening into portals, but do not cover the opening.
    pub fn with_doors(scene: &Scene, points: &[[f32; 3]]) -> Self {
        Self::build(scene, points, true)
    }

    fn build(scene: &Scene, points: &[[f32; 3]], has_doors: bool) -> Self {
        let planes = Planes::new(scene);
        let around = points.iter().fold(scene.bounds(), |b, p| {
            b.union(Aabb::around([Vec3::from(*p)]))
        });
        // Any margin keeps the outside connected. The coordinates stay finite.
        let margin = ((around.max - around.min) * 0.125)
            .max_element()
            .clamp(f32::MIN_POSITIVE, f32::MAX);
        let limit = Vec3::splat(f32::MAX);
        let step = |p: Vec3, by: f32| (p + Vec3::splat(by)).clamp(-limit, limit);
        let bounds = Aabb::new(
            step(around.min, -margin).min(around.min.map(f32::next_down)),
            step(around.max, margin).max(around.max.map(f32::next_up)),
        );
        let detail = by_place(scene)
            .into_iter()
            .filter(|id| has_doors || !is_door(scene, *id))
            .filter_map(|id| {
                let corners = scene.triangles()[id as usize].v.map(|v| v.as_dvec3());
                let face = Face::new(Polygon::triangle(corners)?);
                let after = scene.objects().partition_point(|o| o.first <= id) as u32;
                let door = is_door(scene, id).then(|| ObjectId(after - 1));
                Some(Fragment {
                    plane: planes.find_plane(TriangleId(id))?,
                    door,
                    face,
                })
            })
            .collect();
        let inside = LeafId(1);
        let portals: Vec<Portal> = Polygon::faces_of(bounds)
            .into_iter()
            .enumerate()
            // The faces come in pairs, the lower face first.
            .map(|(k, face)| Portal {
                face: Face::new(face),
                plane: None,
                door: None,
                leaves: if k % 2 == 0 {
                    [OUTSIDE, inside]
                } else {
                    [inside, OUTSIDE]
                },
            })
            .collect();
        let ids: Vec<PortalId> = (0..portals.len() as u32).map(PortalId).collect();
        let leaves = vec![
            Leaf {
                portals: ids.clone(),
                ..Leaf::default()
            },
            Leaf {
                detail,
                portals: ids,
                ..Leaf::default()
            },
        ];
        Self {
            planes,
            bounds,
            nodes: vec![BspNode::Leaf(inside)],
            leaves,
            portals,
            work: 0,
        }
    }

    /// Returns the planes of the scene.
    pub fn planes(&self) -> &Planes {
        &self.planes
    }

    /// Returns the box of the tree.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Returns the nodes; the root is the first node.
    pub fn nodes(&self) -> &[BspNode] {
        &self.nodes
    }

    /// Returns a leaf.
    pub fn leaf(&self, id: LeafId) -> &Leaf {
        &self.leaves[id.0 as usize]
    }

    /// Returns the number of leaves, including [`OUTSIDE`].
    pub fn len(&self) -> usize {
        self.leaves.len()
    }

    /// Returns true if the tree has no leaf except [`OUTSIDE`]. The result is always false, because a tree
    /// has at least one other leaf.
    pub fn is_empty(&self) -> bool {
        self.leaves.len() < 2
    }

    /// Returns a portal.
    pub fn portal(&self, id: PortalId) -> &Portal {
        &self.portals[id.0 as usize]
    }

    /// Returns the number of portals.
    pub fn portals(&self) -> usize {
        self.portals.len()
    }

    /// Returns the work so far. One unit is the classification of a fragment or portal by a plane; other
    /// operations count as multiples.
    pub fn work(&self) -> u64 {
        self.work
    }

    /// Returns the leaves that contain a point, or [`OUTSIDE`] for a point outside the tree's box. A point on
    /// a plane is in the leaves on both sides of the plane.
    pub fn leaves_of(&self, point: Vec3) -> Vec<LeafId> {
        if !self.bounds.contains(point) {
            return vec![OUTSIDE];
        }
        let (mut found, mut open) = (Vec::new(), vec![0u32]);
        while let Some(node) = open.pop() {
            match self.nodes[node as usize] {
                BspNode::Leaf(leaf) => found.push(leaf),
                BspNode::Split(plane, [less, greater]) => {
                    match self.planes.plane(plane).side_of(point) {
                        Ordering::Less => open.push(less),
                        Ordering::Greater => open.push(greater),
                        Ordering::Equal => open.extend([less, greater]),
                    }
                }
            }
        }
        found
    }

    /// Computes the section of a plane with a leaf, or returns `None` if the section has no area.
    pub fn section(&self, leaf: LeafId, plane: PlaneId) -> Option<Face> {
        let mut face = Face::new(Polygon::section(
            self.planes.plane(plane).coefficients(),
            self.bounds,
        )?);
        for (wall, keep) in &self.leaf(leaf).walls {
            let wall = self.planes.plane(*wall);
            let sides = face.sides(wall);
            face = face.part(wall, &sides, *keep)?;
        }
        Some(face)
    }

    /// Splits a leaf along a plane, which must contain a fragment of the leaf's detail.
    ///
    /// The leaf becomes the part on the plane's lower side. The function returns the part on the upper
    /// side.
    ///
    /// # Panics
    /// If the plane does not divide the leaf.
    pub fn split(&mut self, id: LeafId, plane: PlaneId) -> LeafId {
        // A fragment in the plane is in the closed leaf and in none of its walls, so the section has an area.
        let section = self
            .section(id, plane)
            .expect("the plane of a fragment divides its leaf");
        let upper = LeafId(self.leaves.len() as u32);
        // For each compared plane, a section was cut along all walls of the leaf. A leaf keeps its walls
        // after a split.
        self.work += WALL_WORK * self.leaf(id).walls.len() as u64;
        let leaf = std::mem::take(&mut self.leaves[id.0 as usize]);
        let (mut inside, mut details) = (Vec::new(), [Vec::new(), Vec::new()]);
        let mut doors: BTreeMap<ObjectId, Vec<Face>> = BTreeMap::new();
        let exact = &self.planes.plane(plane).clone();
        for fragment in leaf.detail {
            self.work += 1;
            if fragment.plane == plane {
                match fragment.door {
                    None => inside.push(fragment.face),
                    Some(door) => doors.entry(door).or_default().push(fragment.face),
                }
                continue;
            }
            let Fragment { plane, door, face } = fragment;
            for (part, detail) in face.parts(exact).into_iter().zip(&mut details) {
                detail.extend(part.map(|face| Fragment { plane, door, face }));
            }
        }
        let mut portals = [Vec::new(), Vec::new()];
        for portal in leaf.portals {
            self.work += 1;
            self.divide_portal(portal, id, upper, exact, &mut portals);
        }
        // The part of the section that walls cover is not an opening. Each door covers its own part of the
        // remaining section.
        let [mut open, _] = divide_covered(vec![section], inside, exact, &mut self.work);
        let mut openings = Vec::new();
        for (door, covers) in doors {
            let [rest, covered] = divide_covered(open, covers, exact, &mut self.work);
            openings.extend(covered.into_iter().map(|face| (face, Some(door))));
            open = rest;
        }
        openings.extend(open.into_iter().map(|face| (face, None)));
        for (face, door) in openings {
            let number = self.add_portal(Portal {
                face,
                plane: Some(plane),
                door,
                leaves: [id, upper],
            });
            portals.iter_mut().for_each(|p| p.push(number));
        }
        let places = [0, 1].map(|k| self.nodes.len() as u32 + k);
        self.nodes[leaf.node as usize] = BspNode::Split(plane, places);
        self.nodes.extend([BspNode::Leaf(id), BspNode::Leaf(upper)]);
        let sides = [Ordering::Less, Ordering::Greater];
        let [lower_leaf, upper_leaf] = std::array::from_fn(|k| Leaf {
            node: places[k],
            walls: leaf
                .walls
                .iter()
                .copied()
                .chain([(plane, sides[k])])
                .collect(),
            detail: std::mem::take(&mut details[k]),
            portals: std::mem::take(&mut portals[k]),
            begun: Vec::new(),
        });
        self.leaves[id.0 as usize] = lower_leaf;
        self.leaves.push(upper_leaf);
        upper
    }

    /// Records the planes of a leaf's detail that belong to a wall along which the leaf was split.
    ///
    /// `planes` contains the planes of the wall in ascending order. The function ignores planes without
    /// detail in the leaf.
    pub fn set_begun(&mut self, id: LeafId, planes: &[PlaneId]) {
        let leaf = &mut self.leaves[id.0 as usize];
        // Each fragment of the leaf was compared with the wall.
        self.work += leaf.detail.len() as u64;
        let is_of_wall = |plane: &PlaneId| planes.binary_search(plane).is_ok();
        leaf.begun = leaf
            .detail
            .iter()
            .map(|f| f.plane)
            .filter(is_of_wall)
            .collect();
        leaf.begun.sort_unstable();
        leaf.begun.dedup();
    }

    /// Assigns a portal of a leaf that is being split to the sides of the plane.
    fn divide_portal(
        &mut self,
        id: PortalId,
        lower: LeafId,
        upper: LeafId,
        plane: &Plane,
        out: &mut [Vec<PortalId>; 2],
    ) {
        let portal = &mut self.portals[id.0 as usize];
        let [below, above] = portal.face.clone().parts(plane);
        let move_up = |portal: &mut Portal| {
            portal
                .leaves
                .iter_mut()
                .filter(|l| **l == lower)
                .for_each(|l| *l = upper);
        };
        match (below, above) {
            (Some(below), Some(above)) => {
                portal.face = below;
                let mut other = Portal {
                    face: above,
                    plane: portal.plane,
                    door: portal.door,
                    leaves: portal.leaves,
                };
                move_up(&mut other);
                let beyond = other.beyond(upper);
                out[0].push(id);
                let number = self.add_portal(other);
                out[1].push(number);
                self.leaves[beyond.0 as usize].portals.push(number);
            }
            (None, Some(_)) => {
                move_up(portal);
                out[1].push(id);
            }
            // A portal is on the border of the leaf, and the plane divides the leaf's interior, so the portal
            // is not in the plane.
            _ => out[0].push(id),
        }
    }

    fn add_portal(&mut self, portal: Portal) -> PortalId {
        self.portals.push(portal);
        PortalId(self.portals.len() as u32 - 1)
    }
}
