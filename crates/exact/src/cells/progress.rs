//! The states of the triangles below each node of the hierarchy during the search.

use sightline_geometry::bvh::Below;
use sightline_scene::TriangleId;

use crate::cells::work::TriangleState;
use crate::occluders::Occluders;

/// A summary of the states of the triangles below a node.
#[derive(Clone, Copy, Default)]
pub struct NodeSummary {
    /// True if at least one triangle below the node is visible.
    pub visible: bool,
    /// True if at least one triangle below the node was open when the search began.
    pub open: bool,
    /// The number of triangles below the node that were open when the search began. The triangles of one
    /// polygon share a query and count once.
    pub count: u32,
}

/// For each node of the hierarchy over the targets (`Occluders::targets`), the states of the
/// triangles below it. With these summaries the search skips a node, queries its box, or expands it.
pub struct NodeSummaries {
    /// For each node, its summary.
    below: Vec<NodeSummary>,
    /// For each node, the index of its parent node.
    parent: Vec<u32>,
    /// For each triangle, the index of its leaf node.
    leaf: Vec<u32>,
}

impl NodeSummaries {
    /// Summarises the states of the triangles below each node. `state` contains the state of each triangle of
    /// the scene.
    pub fn new(scene: &Occluders, state: &[TriangleState]) -> Self {
        let tree = scene.targets();
        let open = |id: &u32| state[*id as usize] == TriangleState::Open;
        let first = |id: u32| {
            let members = scene
                .occluder_id(TriangleId(id))
                .map(|o| &scene.occluder(o).triangles);
            members.is_none_or(|m| m.iter().map(|t| t.triangle).find(|t| open(t)) == Some(id))
        };
        let mut out = Self {
            below: vec![NodeSummary::default(); tree.len()],
            parent: vec![0; tree.len()],
            leaf: vec![0; state.len()],
        };
        // Children come after their parents.
        for node in (0..tree.len() as u32).rev() {
            out.below[node as usize] = match tree.below(node) {
                Below::Nodes(children) => {
                    children.iter().for_each(|c| out.parent[*c as usize] = node);
                    let [a, b] = children.map(|c| out.below[c as usize]);
                    NodeSummary {
                        visible: a.visible || b.visible,
                        open: a.open || b.open,
                        count: a.count + b.count,
                    }
                }
                Below::Items(items) => {
                    items.iter().for_each(|t| out.leaf[*t as usize] = node);
                    NodeSummary {
                        visible: items
                            .iter()
                            .any(|t| state[*t as usize] == TriangleState::Visible),
                        open: items.iter().any(open),
                        count: items.iter().filter(|t| open(t) && first(**t)).count() as u32,
                    }
                }
            };
        }
        out
    }

    /// Returns the summary of a node.
    pub fn of_node(&self, node: u32) -> NodeSummary {
        self.below[node as usize]
    }

    /// Marks the nodes above a triangle as visible, after the triangle was seen.
    pub fn show(&mut self, triangle: TriangleId) {
        let mut node = self.leaf[triangle.at()];
        // If a node has a visible triangle, all its ancestors are already marked.
        while !self.below[node as usize].visible {
            self.below[node as usize].visible = true;
            node = self.parent[node as usize];
        }
    }
}
