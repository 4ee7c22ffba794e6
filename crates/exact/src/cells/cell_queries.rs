//! Queries from one cell to the nodes, polygons and triangles of a scene, and the use of their answers.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};
use sightline_certificate::{Target, Witness};
use sightline_geometry::bvh::Below;
use sightline_numbers::Aabb;
use sightline_scene::TriangleId;

use crate::arithmetic::random::Random;
use crate::cells::from_cell::{FromCellAnswer, faces_towards, from_cell};
use crate::cells::rays;
use crate::cells::sources::Sources;
use crate::cells::work::{CellWork, TriangleState};
use crate::geometry::polygon::{Polygon, rounded};
use crate::geometry::{PointOrigin, predicates};
use crate::occluders::segment::shows;
use crate::occluders::{OccluderId, Occluders};
use crate::search::{QueryCost, UndecidedReason};

/// The length by which a witness in single precision extends beyond the triangle, as a fraction of the
/// segment's length.
const BEYOND: f64 = 1e-5;

/// The target of one query from a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum QueryItem {
    /// The box of a node of the hierarchy over the targets, identified by the node's index.
    Node(u32),
    /// A triangle, identified by its id.
    Triangle(u32),
    /// Coplanar triangles that form a convex polygon, identified by their occluder.
    Face(OccluderId),
}

/// The answer of a query about an item.
pub struct ItemAnswer {
    pub item: QueryItem,
    /// The answer; `None` if the caller stopped the search.
    pub found: Option<FromCellAnswer>,
    /// The ids of triangles that rays near the query's witness have shown, with their witnesses.
    pub beside: Vec<(u32, [Vec3; 2])>,
    /// The number of rays cast near the query's witness.
    pub rays: u64,
    /// The cost of the query.
    pub cost: QueryCost,
}

impl CellWork<'_> {
    /// Returns the bounding box of an item.
    pub fn bounds(&self, item: QueryItem) -> Aabb {
        match item {
            QueryItem::Node(node) => self.task.scene.occluders().targets().bounds(node),
            QueryItem::Triangle(id) => Aabb::around(*self.task.scene.occluders().triangle(id)),
            QueryItem::Face(id) => Aabb::around(
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

    /// Returns the polygon that an occluder's triangles form, or `None` if the polygon has too many corners
    /// for one query.
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

    /// Returns the open triangles of an occluder, except triangles that a closed surface hides from one side.
    pub fn open_of(&self, occluder: OccluderId) -> Vec<u32> {
        let open = |id: &u32| {
            self.state[*id as usize] == TriangleState::Open
                && self.hidden_half(QueryItem::Triangle(*id)).is_none()
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

    /// Queries one item from the cell. [`ItemAnswer::found`] is `None` if the caller stopped the search.
    pub fn ask(&self, item: QueryItem) -> ItemAnswer {
        let mut cost = QueryCost::default();
        if (self.task.stop)() {
            return ItemAnswer {
                item,
                found: None,
                beside: Vec::new(),
                rays: 0,
                cost,
            };
        }
        let targets = match item {
            QueryItem::Node(node) => {
                let Aabb { min, max } = self.task.scene.occluders().targets().bounds(node);
                faces_towards(min, max, self.task.cell)
            }
            QueryItem::Face(id) => self.outline(id).into_iter().collect(),
            QueryItem::Triangle(id) => Polygon::triangle(
                self.task
                    .scene
                    .occluders()
                    .triangle(id)
                    .map(|v| v.as_dvec3()),
            )
            .into_iter()
            .collect(),
        };
        let hidden = self.hidden_half(item);
        let found = from_cell(
            self.task.scene.occluders(),
            &self.sources,
            &targets,
            hidden,
            &self.task.limits,
            &self.task.stop,
            &mut cost,
        );
        if matches!(found, FromCellAnswer::Undecided(UndecidedReason::Stopped)) {
            return ItemAnswer {
                item,
                found: None,
                beside: Vec::new(),
                rays: 0,
                cost,
            };
        }
        (self.task.asked)();
        let (mut beside, mut rays) = (Vec::new(), 0);
        if let FromCellAnswer::Visible(ends) = &found {
            let wanted = |id: u32| {
                self.state[id as usize] == TriangleState::Open
                    && item != QueryItem::Triangle(id)
                    && self.task.scene.occluders().is_target(TriangleId(id))
            };
            let ends = ends.each_ref().map(rounded);
            let stream = match item {
                QueryItem::Node(id) => u64::from(id) << 2,
                QueryItem::Triangle(id) => u64::from(id) << 2 | 1,
                QueryItem::Face(id) => u64::from(id.0) << 2 | 2,
            };
            let Aabb { min, max } = self.bounds(item);
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
        ItemAnswer {
            item,
            found: Some(found),
            beside,
            rays,
            cost,
        }
    }

    /// Returns the side of a triangle's plane from which a closed surface hides the triangle, or `None` if no
    /// such side is known or the item is not a triangle.
    pub fn hidden_half(&self, item: QueryItem) -> Option<Ordering> {
        let QueryItem::Triangle(id) = item else {
            return None;
        };
        self.halves
            .binary_search_by_key(&id, |h| h.0)
            .ok()
            .map(|at| self.halves[at].1)
    }

    /// Calls `f` with the id of each triangle below a node of the hierarchy.
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

    /// Records the answer of a query: the states of its triangles, the certificate and the statistics.
    pub fn take(
        &mut self,
        ItemAnswer {
            item: of,
            found,
            cost,
            ..
        }: ItemAnswer,
    ) {
        self.decided.statistics.cost += cost;
        self.decided.statistics.queries += u64::from(found.is_some());
        // Since the query began, a ray may have shown the triangle, or another query may have proved a box
        // around the triangle hidden.
        if matches!(of, QueryItem::Triangle(id) if self.state[id as usize] != TriangleState::Open) {
            return;
        }
        match (of, found) {
            (QueryItem::Triangle(id), Some(FromCellAnswer::Visible(ends))) => {
                if self.task.seen.binary_search(&id).is_err() {
                    self.decided.statistics.missed += 1;
                }
                self.see(id, |work| {
                    witness(work.task.scene.occluders(), &work.sources, id, &ends)
                });
            }
            (QueryItem::Triangle(id), Some(FromCellAnswer::Undecided(reason))) => {
                self.leave(id, Some(reason))
            }
            (QueryItem::Triangle(id), None) => self.leave(id, None),
            (QueryItem::Triangle(id), Some(FromCellAnswer::Hidden(proofs))) => {
                let half = self.hidden_half(of).is_some();
                self.hide(
                    &[id],
                    if half { Target::Half } else { Target::Triangle },
                    proofs,
                );
            }
            (QueryItem::Node(node), Some(FromCellAnswer::Hidden(proofs))) => {
                let mut ids = Vec::new();
                self.each_below(node, |work, id| {
                    if work.state[id as usize] == TriangleState::Open {
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
            (QueryItem::Face(face), Some(FromCellAnswer::Hidden(proofs))) => {
                let mut ids = self.open_of(face);
                ids.sort_unstable();
                // These corners are exact: the query used the same points of the scene, which are in single
                // precision.
                let corners = self.outline(face).map_or_else(Vec::new, |p| p.rounded());
                let corners = corners.iter().map(|c| c.as_vec3()).collect();
                self.hide(&ids, Target::Polygon(corners), proofs);
            }
            (QueryItem::Node(_) | QueryItem::Face(_), _) => {}
        }
    }

    /// Records the witnesses that were found near the witness of a query, and returns their triangles.
    pub fn show_beside(&mut self, answer: &mut ItemAnswer) -> Vec<u32> {
        self.decided.statistics.rays += answer.rays;
        let mut beside = std::mem::take(&mut answer.beside);
        beside.retain(|(id, _)| self.state[*id as usize] == TriangleState::Open);
        for (id, ends) in &beside {
            self.decided.statistics.missed += u64::from(self.task.seen.binary_search(id).is_err());
            self.see(*id, |_| Witness::Floats(*ends));
        }
        beside.into_iter().map(|(id, _)| id).collect()
    }
}

/// Converts a query's witness for triangle `id` to the form that the certificate stores.
///
/// The form is single precision if the segment rounded to single precision is a witness, and exact otherwise.
fn witness(scene: &Occluders, sources: &Sources<'_>, id: u32, ends: &[PointOrigin; 2]) -> Witness {
    let [p, q] = ends.each_ref().map(rounded);
    let [min, max] = sources.cell().corners();
    let near = p.as_vec3().clamp(min, max);
    let far = (p + (q - p) * (1.0 + BEYOND)).as_vec3();
    if far.is_finite() && sources.holds(near) && shows(scene, near, far, id, &mut Vec::new()) {
        return Witness::Floats([near, far]);
    }
    Witness::Exact(Box::new(ends.each_ref().map(predicates::integers)))
}
