//! The nodes of the line tracer's hierarchy on the device, in the layout that `traverse.wgsl` reads.
//!
//! A leaf has up to four triangles. A node of the binary tree ([`crate::bvh`]) becomes a leaf where this
//! costs less than its subtree.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use sightline_scene::Aabb;

use crate::bvh::Bvh;

/// Maximum number of triangles in a leaf.
const MAX_LEAF: u32 = 4;
/// The number of low bits of [`DeviceNode::child`] that contain a leaf's number of triangles.
const COUNT_BITS: u32 = 4;
/// The limit of node and triangle indices, which must fit in the other bits.
const MOST: usize = 1 << (32 - COUNT_BITS);
/// The cost of testing two boxes, in triangle tests.
const STEP_COST: f32 = 1.0;

/// A node. Siblings are adjacent; the left sibling has an even index.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct DeviceNode {
    pub(super) low: Vec3,
    /// The reference to the node's children or triangles.
    ///
    /// Inner node: the index of the left child in the upper 28 bits, 0 in the lower 4. Leaf: the place of its
    /// first triangle in the upper 28 bits, the number of its triangles in the lower 4.
    pub(super) child: u32,
    pub(super) high: Vec3,
    unused: u32,
}

/// A hierarchy for the device.
#[derive(Debug)]
pub(super) struct DeviceHierarchy {
    /// The root, an unused node, then pairs of siblings. Empty if the input has no boxes.
    pub(super) nodes: Vec<DeviceNode>,
    /// The index of the input box for each place in the leaves' order.
    pub(super) order: Vec<u32>,
}

impl DeviceHierarchy {
    /// Builds the hierarchy over `boxes`, none of which is empty.
    ///
    /// # Errors
    /// A message if `boxes` has more elements than the nodes can number.
    pub(super) fn build(boxes: &[Aabb]) -> Result<Self, String> {
        // A binary tree has fewer than two nodes per leaf, plus the unused node.
        if boxes.len() >= MOST / 2 {
            return Err(format!(
                "{} triangles are more than the {} that the nodes of the device can number",
                boxes.len(),
                MOST / 2 - 1
            ));
        }
        let tree = Bvh::build(boxes)?;
        Ok(Self {
            nodes: paired(&tree, &leaves(&tree)),
            order: tree.order,
        })
    }
}

/// Returns for each node of the tree whether it becomes a leaf.
fn leaves(tree: &Bvh) -> Vec<bool> {
    let mut costs = vec![0.0f32; tree.nodes.len()];
    let mut leaves = vec![true; tree.nodes.len()];
    // Children come after their parent.
    for place in (0..tree.nodes.len()).rev() {
        let node = &tree.nodes[place];
        let area = node.half_area();
        let as_leaf = area * node.count as f32;
        costs[place] = as_leaf;
        if !node.is_leaf() {
            let below = costs[place + 1] + costs[tree.right(place)] + STEP_COST * area;
            if node.count > MAX_LEAF || below < as_leaf {
                (costs[place], leaves[place]) = (below, false);
            }
        }
    }
    leaves
}

/// Returns the nodes with siblings adjacent.
fn paired(tree: &Bvh, leaves: &[bool]) -> Vec<DeviceNode> {
    if tree.nodes.is_empty() {
        return Vec::new();
    }
    let mut nodes = vec![DeviceNode::zeroed(); 2];
    // (place in the tree, index in `nodes`)
    let mut todo = vec![(0usize, 0usize)];
    while let Some((from, to)) = todo.pop() {
        let node = &tree.nodes[from];
        let child = if leaves[from] {
            node.first << COUNT_BITS | node.count
        } else {
            let left = nodes.len();
            nodes.extend([DeviceNode::zeroed(); 2]);
            todo.push((tree.right(from), left + 1));
            todo.push((from + 1, left));
            (left as u32) << COUNT_BITS
        };
        nodes[to] = DeviceNode {
            low: node.bounds.min,
            child,
            high: node.bounds.max,
            unused: 0,
        };
    }
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bvh::MAX_DEPTH;

    #[test]
    fn every_box_is_in_one_leaf() {
        for count in [1, 2, 4, 5, 1000, 20_000] {
            let boxes: Vec<Aabb> = (0..count)
                .map(|i| {
                    let p = Vec3::new(
                        (i * 7919 % 1009) as f32,
                        (i * 104_729 % 977) as f32,
                        (i % 31) as f32,
                    );
                    Aabb {
                        min: p,
                        max: p + 1.0 + (i % 5) as f32,
                    }
                })
                .collect();
            let bvh = DeviceHierarchy::build(&boxes).unwrap();
            let mut met = vec![0; boxes.len()];
            let mut todo = vec![(0usize, 0u32)];
            while let Some((at, depth)) = todo.pop() {
                assert!(depth <= MAX_DEPTH);
                let node = bvh.nodes[at];
                let bounds = Aabb {
                    min: node.low,
                    max: node.high,
                };
                let (place, count) = ((node.child >> COUNT_BITS) as usize, node.child & 15);
                if count == 0 {
                    assert!(place.is_multiple_of(2) && place > at);
                    for child in [place, place + 1] {
                        let c = bvh.nodes[child];
                        assert!(bounds.contains(c.low) && bounds.contains(c.high));
                        todo.push((child, depth + 1));
                    }
                } else {
                    assert!(count <= MAX_LEAF);
                    for id in &bvh.order[place..place + count as usize] {
                        let b = boxes[*id as usize];
                        assert!(bounds.contains(b.min) && bounds.contains(b.max));
                        met[*id as usize] += 1;
                    }
                }
            }
            assert!(met.iter().all(|m| *m == 1));
        }
        assert!(DeviceHierarchy::build(&[]).unwrap().nodes.is_empty());
    }
}
