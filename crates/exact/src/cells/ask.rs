//! The queries from one cell to the nodes, polygons and triangles of a scene, and the use of their answers.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};
use sightline_certificate::{Target, Witness};
use sightline_geometry::bvh::Below;
use sightline_numbers::Aabb;

use crate::arithmetic::random::Random;
use crate::cells::from_cell::{Found, faces_towards, from_cell};
use crate::cells::rays;
use crate::cells::sources::Sources;
use crate::cells::work::{State, Work};
use crate::geometry::polygon::{Polygon, rounded};
use crate::geometry::{Source, predicates};
use crate::occluders::segment::shows;
use crate::occluders::{OccluderId, Occluders};
use crate::search::{Cost, Reason};

/// How far a rounded witness extends beyond the triangle, as a fraction of the segment's length.
const BEYOND: f64 = 1e-5;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Item {
    Node(u32),
    Triangle(u32),
    /// Coplanar triangles that form a convex polygon, by their occluder.
    Face(OccluderId),
}

/// The answer of a query about an item.
pub struct Asked {
    pub of: Item,
    pub found: Option<Found>,
    /// Witnesses for triangles that rays near the query's witness have shown.
    pub beside: Vec<(u32, [Vec3; 2])>,
    pub rays: u64,
    pub cost: Cost,
}

impl Work<'_> {
    pub fn bounds(&self, of: Item) -> Aabb {
        match of {
            Item::Node(node) => self.task.scene.occluders().targets().bounds(node),
            Item::Triangle(id) => Aabb::around(*self.task.scene.occluders().triangle(id)),
            Item::Face(id) => Aabb::around(
                self.task
                    .scene
                    .occluders()
                    .occluder(id)
                    .border
                    .iter()
                    .map(|[p, _]| *p),
            ),
        }
    }

    /// The polygon that an occluder's triangles form, if it has few enough corners for one query.
    pub fn outline(&self, occluder: OccluderId) -> Option<Polygon> {
        let corners: Vec<DVec3> = self
            .task
            .scene
            .occluders()
            .occluder(occluder)
            .outline()
            .iter()
            .map(|c| c.as_dvec3())
            .collect();
        let mut pieces = Polygon::checked(&corners).ok()?;
        if pieces.len() == 1 {
            pieces.pop()
        } else {
            None
        }
    }

    /// The open triangles of an occluder, except those that a surface hides from one side.
    pub fn open_of(&self, occluder: OccluderId) -> Vec<u32> {
        let open = |id: &u32| {
            self.state[*id as usize] == State::Open
                && self.hidden_half(Item::Triangle(*id)).is_none()
        };
        self.task
            .scene
            .occluders()
            .occluder(occluder)
            .triangles
            .iter()
            .map(|t| t.triangle)
            .filter(open)
            .collect()
    }

    /// Runs the query of one item; no answer when stopped.
    pub fn ask(&self, of: Item) -> Asked {
        let mut cost = Cost::default();
        if (self.task.stop)() {
            return Asked {
                of,
                found: None,
                beside: Vec::new(),
                rays: 0,
                cost,
            };
        }
        let targets = match of {
            Item::Node(node) => {
                let Aabb { min, max } = self.task.scene.occluders().targets().bounds(node);
                faces_towards(min, max, self.task.cell)
            }
            Item::Face(id) => self.outline(id).into_iter().collect(),
            Item::Triangle(id) => Polygon::triangle(
                self.task
                    .scene
                    .occluders()
                    .triangle(id)
                    .map(|v| v.as_dvec3()),
            )
            .into_iter()
            .collect(),
        };
        let hidden = self.hidden_half(of);
        let found = from_cell(
            self.task.scene.occluders(),
            &self.sources,
            (&targets, hidden),
            (&self.task.limits, &self.task.stop),
            &mut cost,
        );
        if matches!(found, Found::Undecided(Reason::Stopped)) {
            return Asked {
                of,
                found: None,
                beside: Vec::new(),
                rays: 0,
                cost,
            };
        }
        (self.task.asked)();
        let (mut beside, mut rays) = (Vec::new(), 0);
        if let Found::Visible(ends) = &found {
            let wanted = |id: u32| {
                self.state[id as usize] == State::Open
                    && of != Item::Triangle(id)
                    && self.task.scene.occluders().is_target(id)
            };
            let ends = ends.each_ref().map(rounded);
            let stream = match of {
                Item::Node(id) => u64::from(id) << 2,
                Item::Triangle(id) => u64::from(id) << 2 | 1,
                Item::Face(id) => u64::from(id.0) << 2 | 2,
            };
            let Aabb { min, max } = self.bounds(of);
            let random = Random::new(!self.task.seed, stream);
            let wide = f64::from((max - min).length());
            (beside, rays) = rays::around(
                self.task.scene.occluders(),
                &self.sources,
                ends,
                wide,
                &wanted,
                random,
            );
        }
        Asked {
            of,
            found: Some(found),
            beside,
            rays,
            cost,
        }
    }

    /// The side of its plane from which a triangle is known to be hidden.
    pub fn hidden_half(&self, of: Item) -> Option<Ordering> {
        let Item::Triangle(id) = of else { return None };
        self.halves
            .binary_search_by_key(&id, |h| h.0)
            .ok()
            .map(|at| self.halves[at].1)
    }

    pub fn each_below(&mut self, node: u32, mut f: impl FnMut(&mut Self, u32)) {
        let tree = self.task.scene.occluders().targets();
        let mut open = vec![node];
        while let Some(node) = open.pop() {
            match tree.below(node) {
                Below::Nodes(children) => open.extend(children),
                Below::Items(items) => items.iter().for_each(|id| f(self, *id)),
            }
        }
    }

    /// Records the answer of a query.
    pub fn take(
        &mut self,
        Asked {
            of, found, cost, ..
        }: Asked,
    ) {
        self.decided.statistics.cost += cost;
        self.decided.statistics.queries += u64::from(found.is_some());
        // Meanwhile a ray may have shown the triangle, or a box around it may have been proved hidden.
        if matches!(of, Item::Triangle(id) if self.state[id as usize] != State::Open) {
            return;
        }
        match (of, found) {
            (Item::Triangle(id), Some(Found::Visible(ends))) => {
                if self.task.seen.binary_search(&id).is_err() {
                    self.decided.statistics.missed += 1;
                }
                self.see(id, |work| {
                    witness(work.task.scene.occluders(), &work.sources, id, &ends)
                });
            }
            (Item::Triangle(id), Some(Found::Undecided(reason))) => self.leave(id, Some(reason)),
            (Item::Triangle(id), None) => self.leave(id, None),
            (Item::Triangle(id), Some(Found::Hidden(proofs))) => {
                let half = self.hidden_half(of).is_some();
                self.hide(
                    &[id],
                    if half { Target::Half } else { Target::Triangle },
                    proofs,
                );
            }
            (Item::Node(node), Some(Found::Hidden(proofs))) => {
                let mut ids = Vec::new();
                self.each_below(node, |work, id| {
                    if work.state[id as usize] == State::Open {
                        ids.push(id);
                    }
                });
                ids.sort_unstable();
                self.decided.statistics.boxes += 1;
                self.hide(
                    &ids,
                    Target::Box(self.task.scene.occluders().targets().bounds(node)),
                    proofs,
                );
            }
            (Item::Face(face), Some(Found::Hidden(proofs))) => {
                let mut ids = self.open_of(face);
                ids.sort_unstable();
                // The corners as the query had them: single-precision points of the scene.
                let corners = self.outline(face).map_or_else(Vec::new, |p| p.rounded());
                let corners = corners.iter().map(|c| c.as_vec3()).collect();
                self.hide(&ids, Target::Polygon(corners), proofs);
            }
            (Item::Node(_) | Item::Face(_), _) => {}
        }
    }

    /// Records witnesses found near the witness of a query.
    pub fn show_beside(&mut self, answer: &mut Asked) -> Vec<u32> {
        self.decided.statistics.rays += answer.rays;
        let mut beside = std::mem::take(&mut answer.beside);
        beside.retain(|(id, _)| self.state[*id as usize] == State::Open);
        for (id, ends) in &beside {
            self.decided.statistics.missed += u64::from(self.task.seen.binary_search(id).is_err());
            self.see(*id, |_| Witness::Floats(*ends));
        }
        beside.into_iter().map(|(id, _)| id).collect()
    }
}

/// A query's witness in the form that is stored: in single precision if the rounded segment is a witness,
/// else exact.
fn witness(scene: &Occluders, sources: &Sources<'_>, id: u32, ends: &[Source; 2]) -> Witness {
    let [p, q] = ends.each_ref().map(rounded);
    let [min, max] = sources.cell().corners();
    let near = p.as_vec3().clamp(min, max);
    let far = (p + (q - p) * (1.0 + BEYOND)).as_vec3();
    if far.is_finite() && sources.holds(near) && shows(scene, near, far, id, &mut Vec::new()) {
        return Witness::Floats([near, far]);
    }
    Witness::Exact(Box::new(ends.each_ref().map(predicates::integers)))
}
