//! The states of the triangles below each node of the hierarchy while they are decided.

use sightline_geometry::bvh::Below;

use crate::cells::work::State;
use crate::occluders::Occluders;

/// The states of the triangles below a node, summarised.
#[derive(Clone, Copy, Default)]
pub struct Known {
    /// Whether some triangle is visible.
    pub visible: bool,
    /// Whether some triangle was open at first.
    pub open: bool,
    /// How many triangles were open at first; the triangles of one polygon share a query and count once.
    pub count: u32,
}

/// A summary for each node of the hierarchy.
pub struct Progress {
    below: Vec<Known>,
    parent: Vec<u32>,
    leaf: Vec<u32>,
}

impl Progress {
    pub fn of(scene: &Occluders, state: &[State]) -> Self {
        let tree = scene.targets();
        let open = |id: &u32| state[*id as usize] == State::Open;
        let first = |id: u32| {
            let members = scene.of(id).map(|o| &scene.occluder(o).triangles);
            members.is_none_or(|m| m.iter().map(|t| t.triangle).find(|t| open(t)) == Some(id))
        };
        let mut out = Self {
            below: vec![Known::default(); tree.len()],
            parent: vec![0; tree.len()],
            leaf: vec![0; state.len()],
        };
        // Children come after their parents.
        for node in (0..tree.len() as u32).rev() {
            out.below[node as usize] = match tree.below(node) {
                Below::Nodes(children) => {
                    children.iter().for_each(|c| out.parent[*c as usize] = node);
                    let [a, b] = children.map(|c| out.below[c as usize]);
                    Known {
                        visible: a.visible || b.visible,
                        open: a.open || b.open,
                        count: a.count + b.count,
                    }
                }
                Below::Items(items) => {
                    items.iter().for_each(|t| out.leaf[*t as usize] = node);
                    Known {
                        visible: items.iter().any(|t| state[*t as usize] == State::Visible),
                        open: items.iter().any(open),
                        count: items.iter().filter(|t| open(t) && first(**t)).count() as u32,
                    }
                }
            };
        }
        out
    }

    pub fn of_node(&self, node: u32) -> Known {
        self.below[node as usize]
    }

    /// A triangle was seen.
    pub fn show(&mut self, triangle: u32) {
        let mut node = self.leaf[triangle as usize];
        // All ancestors of a node that has a visible triangle are marked already.
        while !self.below[node as usize].visible {
            self.below[node as usize].visible = true;
            node = self.parent[node as usize];
        }
    }
}
