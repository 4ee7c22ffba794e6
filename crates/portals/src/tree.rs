//! The binary space partition of a scene along planes of its triangles: convex leaves, and the openings
//! (portals) through which one gets from leaf to leaf (Teller 1992, sections 5.2 and 8.2).
//!
//! Everything is exact. A leaf is an intersection of half-spaces; a portal is a convex part of the border of
//! two leaves that no triangle in its plane covers. Triangles that no plane of the tree contains stay in the
//! leaves as detail: they block nothing here, so what is not reached is proved not to be reached, whichever
//! planes were chosen.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use glam::Vec3;
use sightline_exact::Polygon;
use sightline_numbers::Aabb;
use sightline_scene::Scene;

use crate::covered::divide_covered;
use crate::plane::{Face, Plane, PlaneId};
use crate::planes::{Planes, by_place, is_door};

/// The work of a split for each wall of the leaf.
const WALL_WORK: u64 = 32;

/// The number of a leaf in its [`Tree`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LeafId(pub u32);

/// The leaf that stands for everything outside the box of the tree.
pub const OUTSIDE: LeafId = LeafId(0);

/// The number of a portal in its [`Tree`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PortalId(pub u32);

/// A node: an inner one, or the place of a leaf.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Node {
    /// A plane, and the nodes on its lesser and on its greater side.
    Split(PlaneId, [u32; 2]),
    /// A leaf.
    Leaf(LeafId),
}

/// What is left of a triangle in a leaf.
#[derive(Clone, Debug)]
pub struct Fragment {
    /// The plane of the triangle.
    pub plane: PlaneId,
    /// The object whose door it is part of, if it is.
    pub door: Option<u32>,
    /// The part of the triangle in the leaf.
    pub face: Face,
}

/// A convex cell of the partition.
#[derive(Debug, Default)]
pub struct Leaf {
    node: u32,
    /// The planes on the way from the root, with the side of each on which the leaf is.
    pub walls: Vec<(PlaneId, Ordering)>,
    /// Triangles inside, which no plane of the tree contains.
    pub detail: Vec<Fragment>,
    /// The portals of the leaf.
    pub portals: Vec<PortalId>,
    /// The planes of detail that belongs to walls along which the leaf was split, ascending.
    pub begun: Vec<PlaneId>,
}

/// An opening between two leaves.
#[derive(Debug)]
pub struct Portal {
    /// The opening. It may be larger than the true one, never smaller.
    pub face: Face,
    /// Its plane; `None` for the box of the tree.
    pub plane: Option<PlaneId>,
    /// The object that covers it where its door is shut.
    pub door: Option<u32>,
    /// The leaves on the lesser and on the greater side of its plane.
    pub leaves: [LeafId; 2],
}

impl Portal {
    /// The leaf on the other side.
    pub fn beyond(&self, leaf: LeafId) -> LeafId {
        if self.leaves[0] == leaf {
            self.leaves[1]
        } else {
            self.leaves[0]
        }
    }
}

/// A partition of a box.
pub struct Tree {
    planes: Planes,
    bounds: Aabb,
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
    portals: Vec<Portal>,
    /// The work so far, counted in fragments and portals that were put on a side of a plane.
    work: u64,
}

impl Tree {
    /// One leaf that holds all blocking triangles, in a box that has a margin around the scene's bounds and
    /// the given points.
    pub fn new(scene: &Scene, points: &[[f32; 3]]) -> Self {
        Self::of(scene, points, false)
    }

    /// The same with the scene's doors, which divide openings and cover none.
    pub fn with_doors(scene: &Scene, points: &[[f32; 3]]) -> Self {
        Self::of(scene, points, true)
    }

    fn of(scene: &Scene, points: &[[f32; 3]], has_doors: bool) -> Self {
        let planes = Planes::new(scene);
        let around = points.iter().fold(scene.bounds(), |b, p| {
            b.union(Aabb::around([Vec3::from(*p)]))
        });
        // Any margin keeps the outside in one piece. The coordinates stay finite.
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
                let object = || scene.objects().partition_point(|o| o.first <= id) as u32 - 1;
                let door = is_door(scene, id).then(object);
                Some(Fragment {
                    plane: planes.of(id)?,
                    door,
                    face,
                })
            })
            .collect();
        let inside = LeafId(1);
        let portals: Vec<Portal> = Polygon::faces_of(bounds)
            .into_iter()
            .enumerate()
            // The faces come in pairs, the lesser first.
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
            nodes: vec![Node::Leaf(inside)],
            leaves,
            portals,
            work: 0,
        }
    }

    /// The planes.
    pub fn planes(&self) -> &Planes {
        &self.planes
    }

    /// The box that is divided.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// The nodes; the root is the first.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// A leaf.
    pub fn leaf(&self, id: LeafId) -> &Leaf {
        &self.leaves[id.0 as usize]
    }

    /// Number of leaves, with [`OUTSIDE`].
    pub fn len(&self) -> usize {
        self.leaves.len()
    }

    /// Whether there is no leaf but [`OUTSIDE`]; never.
    pub fn is_empty(&self) -> bool {
        self.leaves.len() < 2
    }

    /// A portal.
    pub fn portal(&self, id: PortalId) -> &Portal {
        &self.portals[id.0 as usize]
    }

    /// Number of portals.
    pub fn portals(&self) -> usize {
        self.portals.len()
    }

    /// The work so far: how often a fragment or portal was put on a side of a plane.
    pub fn work(&self) -> u64 {
        self.work
    }

    /// The leaves that hold a point: of a point on planes, those on all sides of it.
    pub fn leaves_of(&self, point: Vec3) -> Vec<LeafId> {
        if !self.bounds.contains(point) {
            return vec![OUTSIDE];
        }
        let (mut found, mut open) = (Vec::new(), vec![0u32]);
        while let Some(node) = open.pop() {
            match self.nodes[node as usize] {
                Node::Leaf(leaf) => found.push(leaf),
                Node::Split(plane, [less, greater]) => {
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

    /// The section of a plane with a leaf; `None` if they share no area.
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

    /// Splits a leaf along a plane, which must contain a fragment of its detail. The leaf becomes the part on
    /// the plane's lesser side; returns the part on the greater one.
    ///
    /// # Panics
    /// When the plane does not divide the leaf.
    pub fn split(&mut self, id: LeafId, plane: PlaneId) -> LeafId {
        // A fragment in the plane is in the closed leaf and in no wall of it, so the section has an area.
        let section = self
            .section(id, plane)
            .expect("the plane of a fragment divides its leaf");
        let upper = LeafId(self.leaves.len() as u32);
        // Sections are cut along all walls, for each plane that was compared; a leaf keeps its walls.
        self.work += WALL_WORK * self.leaf(id).walls.len() as u64;
        let leaf = std::mem::take(&mut self.leaves[id.0 as usize]);
        let (mut inside, mut details) = (Vec::new(), [Vec::new(), Vec::new()]);
        let mut doors: BTreeMap<u32, Vec<Face>> = BTreeMap::new();
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
            self.divide_portal(portal, (id, upper), exact, &mut portals);
        }
        // What a wall covers is no opening; of the rest each door covers its own.
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
        self.nodes[leaf.node as usize] = Node::Split(plane, places);
        self.nodes.extend([Node::Leaf(id), Node::Leaf(upper)]);
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

    /// Marks the planes of a leaf's detail that belong to a wall along which it was split, of `planes`, which
    /// ascend. Those without detail in the leaf are left out.
    pub fn set_begun(&mut self, id: LeafId, planes: &[PlaneId]) {
        let leaf = &mut self.leaves[id.0 as usize];
        // Each fragment was compared with the wall.
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

    /// Puts a portal of a leaf that is being split on the sides of the plane.
    fn divide_portal(
        &mut self,
        id: PortalId,
        (lower, upper): (LeafId, LeafId),
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
            // A portal is on the border of the leaf, whose inside the plane divides, so it is not in the
            // plane.
            _ => out[0].push(id),
        }
    }

    fn add_portal(&mut self, portal: Portal) -> PortalId {
        self.portals.push(portal);
        PortalId(self.portals.len() as u32 - 1)
    }
}
