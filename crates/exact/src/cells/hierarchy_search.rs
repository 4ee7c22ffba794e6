//! The order of the queries from a cell: boxes of the hierarchy, polygons and triangles, by apparent size.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap};

use rayon::prelude::*;
use sightline_geometry::bvh::Below;
use sightline_numbers::Aabb;

use crate::cells::ask::{Asked, Item};
use crate::cells::from_cell::Found;
use crate::cells::progress::Progress;
use crate::cells::work::{State, Work};
use crate::occluders::OccluderId;

/// Number of queries that run in parallel: enough to keep a few cores busy, few enough to keep the order by
/// size.
const BATCH: usize = 64;
/// Up to this number, open polygons are queried one by one: their box has no fewer faces.
const FEW: u32 = 6;

/// A node, polygon or triangle that is still to be queried, ordered by its apparent size.
#[derive(PartialEq)]
struct Doubt {
    size: f64,
    of: Item,
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
impl Work<'_> {
    /// Queries the open items of the hierarchy, those of the largest apparent size first.
    pub fn search(&mut self) {
        let tree = self.task.scene.occluders().targets();
        let mut below = Progress::of(self.task.scene.occluders(), &self.state);
        let mut doubts = BinaryHeap::new();
        // Polygons found so far, and whether each was queried as a whole.
        let mut faces: BTreeMap<OccluderId, bool> = BTreeMap::new();
        let mut batch: Vec<Item> = Vec::new();
        let mut expand = vec![0u32];
        loop {
            // Nodes that need no query are expanded at once.
            while let Some(node) = expand.pop() {
                match tree.below(node) {
                    Below::Nodes(children) => {
                        for child in children {
                            let known = below.of_node(child);
                            if !known.open {
                                continue;
                            }
                            // A query of the box cannot succeed or costs more than queries of its few
                            // polygons.
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
                        for id in items
                            .iter()
                            .filter(|t| self.state[**t as usize] == State::Open)
                        {
                            let face = match self.task.scene.occluders().of(*id) {
                                Some(face) if self.hidden_half(Item::Triangle(*id)).is_none() => {
                                    face
                                }
                                _ => {
                                    doubts.push(self.doubt(Item::Triangle(*id)));
                                    continue;
                                }
                            };
                            // The first triangle of a polygon queues the whole polygon, which includes the
                            // others.
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
                // Since the item was queued, rays may have shown it or a triangle in it.
                match doubt.of {
                    Item::Triangle(id) if self.state[id as usize] != State::Open => {}
                    Item::Node(node) if below.of_node(node).visible => expand.push(node),
                    Item::Face(face) if !self.worth_asking(face) => {
                        doubts.extend(
                            self.open_of(face)
                                .into_iter()
                                .map(|id| self.doubt(Item::Triangle(id))),
                        );
                    }
                    of => batch.push(of),
                }
            }
            if batch.is_empty() && expand.is_empty() {
                break;
            }
            let answers: Vec<Asked> = batch
                .par_iter()
                .with_max_len(1)
                .map(|item| self.ask(*item))
                .collect();
            for mut answer in answers {
                for id in self.show_beside(&mut answer) {
                    below.show(id);
                }
                let hidden = matches!(answer.found, Some(Found::Hidden(_)));
                match answer.of {
                    // The node's children are queried instead, unless the search was stopped.
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
                    Item::Triangle(id) if matches!(answer.found, Some(Found::Visible(_))) => {
                        below.show(id)
                    }
                    _ => {}
                }
                self.take(answer);
            }
        }
    }

    fn doubt(&self, of: Item) -> Doubt {
        let Aabb { min, max } = self.bounds(of);
        Doubt {
            size: self.task.cell.size_of(min, max),
            of,
        }
    }

    /// Whether to query an occluder's polygon as a whole: all its triangles may be hidden, and more than one
    /// is open.
    fn worth_asking(&self, occluder: OccluderId) -> bool {
        let members = &self.task.scene.occluders().occluder(occluder).triangles;
        let hidden = |id: u32| matches!(self.state[id as usize], State::Open | State::Hidden);
        members.len() > 1
            && members.iter().all(|t| hidden(t.triangle))
            && self.open_of(occluder).len() > 1
            && self.outline(occluder).is_some()
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
