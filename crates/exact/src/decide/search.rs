//! The queries about a cell: boxes of the scene's hierarchy, polygons and triangles, what looks largest from the cell first.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::progress::Progress;
use super::{State, Work};
use crate::bvh::Below;
use crate::cell::{Found, faces_towards, from_cell};
use crate::polygon::Polygon;
use crate::query::{Cost, Reason};
use crate::rays;

/// Nodes asked about at a time, in parallel: enough to keep a few cores busy, few enough to go by size.
const BATCH: usize = 64;
/// So many open polygons are asked about one by one: a box has more faces, and hides less than it seems.
const FEW: u32 = 6;

/// A node or a triangle that is still to be asked about, by how large it looks.
#[derive(PartialEq)]
struct Doubt {
    size: f64,
    of: Item,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Item {
    Node(u32),
    Triangle(u32),
    /// Triangles in one plane that make up a convex polygon, by their occluder.
    Face(u32),
}

impl Eq for Doubt {}

impl Ord for Doubt {
    fn cmp(&self, o: &Self) -> Ordering {
        self.size.total_cmp(&o.size).then(o.of.cmp(&self.of))
    }
}

impl PartialOrd for Doubt {
    fn partial_cmp(&self, o: &Self) -> Option<Ordering> {
        Some(self.cmp(o))
    }
}
/// What was found out about an item.
pub struct Asked {
    pub of: Item,
    pub found: Option<Found>,
    /// Witnesses for triangles that are seen next to where the query found a free line.
    pub beside: Vec<(u32, [Vec3; 2])>,
    pub rays: u64,
    pub cost: Cost,
}
impl Work<'_> {
    /// Goes through the hierarchy, from what looks largest.
    pub fn search(&mut self) {
        let tree = self.task.scene.hierarchy();
        let mut below = Progress::of(self.task.scene, &self.state);
        let mut doubts = BinaryHeap::new();
        // Polygons that came up, and whether they were asked about as such.
        let mut faces: BTreeMap<u32, bool> = BTreeMap::new();
        let mut batch: Vec<Item> = Vec::new();
        let mut expand = vec![0u32];
        loop {
            // What needs no query is taken apart at once.
            while let Some(node) = expand.pop() {
                match tree.below(node) {
                    Below::Nodes(children) => {
                        for child in children {
                            let known = below.of_node(child);
                            if !known.open {
                                continue;
                            }
                            // A box has more faces than a polygon or two.
                            if known.visible
                                || known.count <= FEW
                                || self.task.cell.touches(tree.bounds(child))
                            {
                                expand.push(child);
                            } else {
                                doubts.push(self.doubt(Item::Node(child)));
                            }
                        }
                    }
                    Below::Items(items) => {
                        for id in items.iter().filter(|t| self.state[**t as usize] == State::Open) {
                            let face = match self.task.scene.of(*id) {
                                Some(face) if self.hidden_half(Item::Triangle(*id)).is_none() => face,
                                _ => {
                                    doubts.push(self.doubt(Item::Triangle(*id)));
                                    continue;
                                }
                            };
                            // The first triangle of a polygon brings it up, and with it the others.
                            let known = *faces.entry(face).or_insert_with(|| {
                                let worth = self.worth_asking(face);
                                if worth {
                                    doubts.push(self.doubt(Item::Face(face)));
                                }
                                worth
                            });
                            if !known {
                                doubts.push(self.doubt(Item::Triangle(*id)));
                            }
                        }
                    }
                }
            }
            batch.clear();
            while batch.len() < BATCH {
                let Some(doubt) = doubts.pop() else { break };
                // Rays may have shown since what it is about, or something in it.
                match doubt.of {
                    Item::Triangle(id) if self.state[id as usize] != State::Open => {}
                    Item::Node(node) if below.of_node(node).visible => expand.push(node),
                    Item::Face(face) if !self.worth_asking(face) => {
                        doubts
                            .extend(self.open_of(face).into_iter().map(|id| self.doubt(Item::Triangle(id))));
                    }
                    of => batch.push(of),
                }
            }
            if batch.is_empty() && expand.is_empty() {
                break;
            }
            let answers: Vec<Asked> = batch.par_iter().with_max_len(1).map(|item| self.ask(*item)).collect();
            for mut answer in answers {
                for id in self.show_beside(&mut answer) {
                    below.show(id);
                }
                let hidden = matches!(answer.found, Some(Found::Hidden(_)));
                match answer.of {
                    // What is in it is asked about by itself, and nothing at all any more once it is time to stop.
                    Item::Node(node) if !hidden => {
                        if answer.found.is_some() {
                            expand.push(node);
                        } else {
                            self.each_below(node, |work, id| work.leave(id, None));
                        }
                    }
                    Item::Face(face) if !hidden => {
                        for id in self.open_of(face) {
                            match answer.found {
                                Some(_) => doubts.push(self.doubt(Item::Triangle(id))),
                                None => self.leave(id, None),
                            }
                        }
                    }
                    Item::Triangle(id) if matches!(answer.found, Some(Found::Visible(_))) => below.show(id),
                    _ => {}
                }
                self.take(answer);
            }
        }
    }

    fn doubt(&self, of: Item) -> Doubt {
        let [min, max] = self.bounds(of);
        Doubt { size: self.task.cell.size_of(min, max), of }
    }

    fn bounds(&self, of: Item) -> [Vec3; 2] {
        match of {
            Item::Node(node) => self.task.scene.hierarchy().bounds(node),
            Item::Triangle(id) => {
                let [a, b, c] = *self.task.scene.triangle(id);
                [a.min(b).min(c), a.max(b).max(c)]
            }
            Item::Face(id) => self
                .task
                .scene
                .occluder(id)
                .border
                .iter()
                .fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[lo, hi], [p, _]| [lo.min(*p), hi.max(*p)]),
        }
    }

    /// The polygon that an occluder's triangles make up, if it has few enough corners to be asked about at once.
    pub fn outline(&self, occluder: u32) -> Option<Polygon> {
        let corners: Vec<DVec3> =
            self.task.scene.occluder(occluder).outline().iter().map(|c| c.as_dvec3()).collect();
        let mut pieces = Polygon::checked(&corners).ok()?;
        if pieces.len() == 1 { pieces.pop() } else { None }
    }

    /// The triangles of an occluder that are open, and not half hidden by a surface.
    pub fn open_of(&self, occluder: u32) -> Vec<u32> {
        let open = |id: &u32| {
            self.state[*id as usize] == State::Open && self.hidden_half(Item::Triangle(*id)).is_none()
        };
        self.task.scene.occluder(occluder).triangles.iter().map(|(id, _)| *id).filter(open).collect()
    }

    /// Whether all of an occluder's polygon may well be hidden, and there is more than one triangle to win.
    fn worth_asking(&self, occluder: u32) -> bool {
        let members = &self.task.scene.occluder(occluder).triangles;
        let hidden = |id: u32| matches!(self.state[id as usize], State::Open | State::Hidden);
        members.len() > 1
            && members.iter().all(|(id, _)| hidden(*id))
            && self.open_of(occluder).len() > 1
            && self.outline(occluder).is_some()
    }

    /// Asks about one item; nothing is found when it is time to stop.
    pub fn ask(&self, of: Item) -> Asked {
        let mut cost = Cost::default();
        if (self.task.stop)() {
            return Asked { of, found: None, beside: Vec::new(), rays: 0, cost };
        }
        let targets = match of {
            Item::Node(node) => {
                let [min, max] = self.task.scene.hierarchy().bounds(node);
                faces_towards(min, max, self.task.cell)
            }
            Item::Face(id) => self.outline(id).into_iter().collect(),
            Item::Triangle(id) => {
                Polygon::triangle(self.task.scene.triangle(id).map(|v| v.as_dvec3())).into_iter().collect()
            }
        };
        let hidden = self.hidden_half(of);
        let found = from_cell(
            self.task.scene,
            self.task.cell,
            (&targets, hidden),
            (&self.task.limits, &self.task.stop),
            &mut cost,
        );
        if matches!(found, Found::Undecided(Reason::Stopped)) {
            return Asked { of, found: None, beside: Vec::new(), rays: 0, cost };
        }
        (self.task.asked)();
        let (mut beside, mut rays) = (Vec::new(), 0);
        if let Found::Visible(ends) = &found {
            let wanted = |id: u32| {
                self.state[id as usize] == State::Open
                    && of != Item::Triangle(id)
                    && self.task.scene.of(id).is_some()
            };
            let ends = ends.each_ref().map(crate::polygon::rounded);
            let stream = match of {
                Item::Node(id) => u64::from(id) << 2,
                Item::Triangle(id) => u64::from(id) << 2 | 1,
                Item::Face(id) => u64::from(id) << 2 | 2,
            };
            let [min, max] = self.bounds(of);
            let random = rays::Random::new(!self.task.seed, stream);
            let wide = f64::from((max - min).length());
            (beside, rays) = rays::around(self.task.scene, &self.task.cell, ends, wide, &wanted, random);
        }
        Asked { of, found: Some(found), beside, rays, cost }
    }

    /// The side of its plane from which a triangle is known to be hidden.
    pub fn hidden_half(&self, of: Item) -> Option<Ordering> {
        let Item::Triangle(id) = of else { return None };
        self.halves.binary_search_by_key(&id, |h| h.0).ok().map(|at| self.halves[at].1)
    }

    pub fn each_below(&mut self, node: u32, mut f: impl FnMut(&mut Self, u32)) {
        let tree = self.task.scene.hierarchy();
        let mut open = vec![node];
        while let Some(node) = open.pop() {
            match tree.below(node) {
                Below::Nodes(children) => open.extend(children),
                Below::Items(items) => items.iter().for_each(|id| f(self, *id)),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubts_are_ordered_by_size_and_then_by_number() {
        let doubt = |size, of| Doubt { size, of };
        let mut heap = BinaryHeap::from([
            doubt(1.0, Item::Triangle(3)),
            doubt(2.0, Item::Node(9)),
            doubt(2.0, Item::Node(4)),
        ]);
        let order: Vec<Item> = std::iter::from_fn(|| heap.pop().map(|d| d.of)).collect();
        assert_eq!(order, [Item::Node(4), Item::Node(9), Item::Triangle(3)]);
    }
}
