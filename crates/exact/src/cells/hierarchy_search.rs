//! The order of the queries from a cell: boxes of the hierarchy, polygons and triangles, by apparent size.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap};

use rayon::prelude::*;
use sightline_geometry::bvh::Below;
use sightline_numbers::Aabb;
use sightline_scene::TriangleId;

use crate::cells::cell_queries::{ItemAnswer, QueryItem};
use crate::cells::from_cell::FromCellAnswer;
use crate::cells::progress::NodeSummaries;
use crate::cells::work::{CellWork, TriangleState};
use crate::occluders::OccluderId;

/// The maximum number of queries that run in parallel.
///
/// The number is large enough to use a few cores fully, and small enough to preserve the order by size.
const BATCH: usize = 64;
/// The maximum number of open polygons below a node that the search queries one by one instead of with their
/// box.
///
/// A box has up to six faces, so a query of the box would not be cheaper.
const FEW: u32 = 6;

/// A node, polygon or triangle that is still to be queried, ordered by its apparent size.
#[derive(PartialEq)]
struct OpenItem {
    size: f64,
    item: QueryItem,
}

impl Eq for OpenItem {}

impl Ord for OpenItem {
    fn cmp(&self, o: &Self) -> Ordering {
        self.size.total_cmp(&o.size).then(o.item.cmp(&self.item))
    }
}

impl PartialOrd for OpenItem {
    fn partial_cmp(&self, o: &Self) -> Option<Ordering> {
        Some(self.cmp(o))
    }
}
impl CellWork<'_> {
    /// Queries the open items of the hierarchy in descending order of apparent size.
    pub fn search(&mut self) {
        let tree = self.task.scene.occluders().targets();
        let mut below = NodeSummaries::new(self.task.scene.occluders(), &self.state);
        let mut queue = BinaryHeap::new();
        // The polygons found so far, each with true if the search queries the polygon as a whole.
        let mut faces: BTreeMap<OccluderId, bool> = BTreeMap::new();
        let mut batch: Vec<QueryItem> = Vec::new();
        let mut expand = vec![0u32];
        loop {
            // Expand nodes that need no query at once.
            while let Some(node) = expand.pop() {
                match tree.below(node) {
                    Below::Nodes(children) => {
                        for child in children {
                            let known = below.of_node(child);
                            if !known.open {
                                continue;
                            }
                            // A query of the box cannot succeed, or costs more than queries of its few
                            // polygons.
                            if known.visible
                                || known.count <= FEW
                                || self.task.cell.touches(tree.bounds(child))
                            {
                                expand.push(child);
                            } else {
                                queue.push(self.open_item(QueryItem::Node(child)));
                            }
                        }
                    }
                    Below::Items(items) => {
                        for id in items
                            .iter()
                            .filter(|t| self.state[**t as usize] == TriangleState::Open)
                        {
                            let face =
                                match self.task.scene.occluders().occluder_id(TriangleId(*id)) {
                                    Some(face)
                                        if self.hidden_half(QueryItem::Triangle(*id)).is_none() =>
                                    {
                                        face
                                    }
                                    _ => {
                                        queue.push(self.open_item(QueryItem::Triangle(*id)));
                                        continue;
                                    }
                                };
                            // The first triangle of a polygon queues the whole polygon, which includes the
                            // other triangles.
                            let known = *faces.entry(face).or_insert_with(|| {
                                let worth = self.worth_asking(face);
                                if worth {
                                    queue.push(self.open_item(QueryItem::Face(face)));
                                }
                                worth
                            });
                            if !known {
                                queue.push(self.open_item(QueryItem::Triangle(*id)));
                            }
                        }
                    }
                }
            }
            batch.clear();
            while batch.len() < BATCH {
                let Some(open) = queue.pop() else { break };
                // Since the item was queued, rays may have shown the triangle, or a triangle in the box or
                // polygon.
                match open.item {
                    QueryItem::Triangle(id) if self.state[id as usize] != TriangleState::Open => {}
                    QueryItem::Node(node) if below.of_node(node).visible => expand.push(node),
                    QueryItem::Face(face) if !self.worth_asking(face) => {
                        queue.extend(
                            self.open_of(face)
                                .into_iter()
                                .map(|id| self.open_item(QueryItem::Triangle(id))),
                        );
                    }
                    of => batch.push(of),
                }
            }
            if batch.is_empty() && expand.is_empty() {
                break;
            }
            let answers: Vec<ItemAnswer> = batch
                .par_iter()
                .with_max_len(1)
                .map(|item| self.ask(*item))
                .collect();
            for mut answer in answers {
                for id in self.show_beside(&mut answer) {
                    below.show(TriangleId(id));
                }
                let hidden = matches!(answer.found, Some(FromCellAnswer::Hidden(_)));
                match answer.item {
                    // Query the node's children instead, unless the caller stopped the search.
                    QueryItem::Node(node) if !hidden => {
                        if answer.found.is_some() {
                            expand.push(node);
                        } else {
                            self.each_below(node, |work, id| work.leave(id, None));
                        }
                    }
                    QueryItem::Face(face) if !hidden => {
                        for id in self.open_of(face) {
                            match answer.found {
                                Some(_) => queue.push(self.open_item(QueryItem::Triangle(id))),
                                None => self.leave(id, None),
                            }
                        }
                    }
                    QueryItem::Triangle(id)
                        if matches!(answer.found, Some(FromCellAnswer::Visible(_))) =>
                    {
                        below.show(TriangleId(id))
                    }
                    _ => {}
                }
                self.take(answer);
            }
        }
    }

    /// Returns an item with its apparent size from the cell.
    fn open_item(&self, item: QueryItem) -> OpenItem {
        let Aabb { min, max } = self.bounds(item);
        OpenItem {
            size: self.task.cell.size_of(min, max),
            item,
        }
    }

    /// Returns true if an occluder's polygon should be queried as a whole.
    ///
    /// This is the case if every triangle of the polygon is open or hidden, and more than one is open.
    fn worth_asking(&self, occluder: OccluderId) -> bool {
        let members = &self.task.scene.occluders().occluder(occluder).triangles;
        let hidden = |id: u32| {
            matches!(
                self.state[id as usize],
                TriangleState::Open | TriangleState::Hidden
            )
        };
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
    fn open_items_are_ordered_by_size_then_number() {
        let open_item = |size, item| OpenItem { size, item };
        let mut heap = BinaryHeap::from([
            open_item(1.0, QueryItem::Triangle(3)),
            open_item(2.0, QueryItem::Node(9)),
            open_item(2.0, QueryItem::Node(4)),
        ]);
        let order: Vec<QueryItem> = std::iter::from_fn(|| heap.pop().map(|d| d.item)).collect();
        assert_eq!(
            order,
            [
                QueryItem::Node(4),
                QueryItem::Node(9),
                QueryItem::Triangle(3)
            ]
        );
    }
}
