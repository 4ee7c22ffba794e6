//! A division that is given by its planes: a kd-tree of boxes of any size.
//!
//! The lattice of the tree has one unit between neighbouring planes of an axis. So each plane has exactly its
//! given coordinate, bit for bit.

use std::sync::Arc;

use glam::Vec3;
use serde::{Serialize, Serializer};

use crate::cell::axis_name;
use crate::{CellBox, Lattice, Split};

/// The maximum number of boxes of a tree.
pub const MOST_BOXES: usize = 1 << 12;
/// The maximum number of planes between the root and a box.
pub const MOST_PLANES: usize = 64;
/// The number in place of the axis for a node that is a box.
const BOX: u8 = 3;

/// The reason why nodes do not form a tree of boxes.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TreeError {
    /// The axis of a node is above 3. The fields are the index of the node, from 0, and the axis.
    #[error(
        "node {0} has the axis {1}; give 0, 1 or 2 for a plane across x, y or z, and 3 for a box"
    )]
    Axis(usize, u32),
    /// Nodes or planes are missing or superfluous.
    #[error(
        "the nodes do not form a tree: each plane is followed by its lower and then its upper child"
    )]
    Shape,
    /// The tree has too many boxes, or is too deep.
    #[error(
        "the tree is too large; give at most {MOST_BOXES} boxes, and {MOST_PLANES} planes above a box"
    )]
    TooLarge,
}

/// A plane that is not strictly inside the box that it divides.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "the plane {} = {at} is not strictly inside the box that it divides; give a coordinate between {min} and \
     {max}",
    axis_name(*axis)
)]
pub struct PlaneError {
    /// The axis: 0 = x, 1 = y, 2 = z.
    pub axis: usize,
    /// The coordinate of the plane.
    pub at: f32,
    /// The lowest coordinate of the box along the axis.
    pub min: f32,
    /// The highest coordinate of the box along the axis.
    pub max: f32,
}

/// A kd-tree of boxes.
#[derive(Clone, Debug, PartialEq)]
pub struct KdTree {
    nodes: Vec<KdNode>,
    boxes: usize,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum KdNode {
    /// A plane where the coordinate `axis` equals `at`. The lower child is the next node, and `upper` is the
    /// index of the upper child.
    Split { axis: usize, at: f32, upper: usize },
    /// A box with this index, in the order of the nodes.
    Box(usize),
}

impl KdTree {
    /// Creates the tree of these nodes, in preorder with lower children first. `axes` contains the axis of
    /// each node, 3 for a box. `planes` contains the coordinate of each plane.
    ///
    /// # Errors
    /// [`TreeError`] if the nodes do not form a tree, or exceed the limits. [`crate::Division::lattice`]
    /// checks that each plane is inside the box that it divides.
    pub fn new(axes: &[u32], planes: &[f32]) -> Result<Self, TreeError> {
        if axes.len() >= 2 * MOST_BOXES {
            return Err(TreeError::TooLarge);
        }
        let (mut nodes, mut boxes, mut planes) = (Vec::with_capacity(axes.len()), 0, planes.iter());
        // The pending children: the parent for an upper child, and the depth.
        let mut open = vec![(None, 0usize)];
        for (i, axis) in axes.iter().enumerate() {
            let (parent, depth) = open.pop().ok_or(TreeError::Shape)?;
            if let Some(KdNode::Split { upper, .. }) = parent.and_then(|p: usize| nodes.get_mut(p))
            {
                *upper = i;
            }
            match *axis {
                axis if axis < u32::from(BOX) => {
                    if depth == MOST_PLANES {
                        return Err(TreeError::TooLarge);
                    }
                    // −0 and 0 are equal planes, so store 0 for both.
                    let at = planes.next().ok_or(TreeError::Shape)? + 0.0;
                    nodes.push(KdNode::Split {
                        axis: axis as usize,
                        at,
                        upper: 0,
                    });
                    open.extend([(Some(i), depth + 1), (None, depth + 1)]);
                }
                axis if axis == u32::from(BOX) => {
                    nodes.push(KdNode::Box(boxes));
                    boxes += 1;
                }
                axis => return Err(TreeError::Axis(i, axis)),
            }
        }
        if !open.is_empty() || planes.next().is_some() {
            return Err(TreeError::Shape);
        }
        Ok(Self { nodes, boxes })
    }

    /// Returns the axis of each node in preorder, 3 for a box, and the coordinate of each plane.
    pub fn parts(&self) -> (Vec<u32>, Vec<f32>) {
        let axis = |node: &KdNode| match node {
            KdNode::Split { axis, .. } => *axis as u32,
            KdNode::Box(_) => u32::from(BOX),
        };
        let plane = |node: &KdNode| match node {
            KdNode::Split { at, .. } => Some(*at),
            KdNode::Box(_) => None,
        };
        (
            self.nodes.iter().map(axis).collect(),
            self.nodes.iter().filter_map(plane).collect(),
        )
    }

    /// Returns the number of undivided boxes, which are the cells.
    pub fn boxes(&self) -> usize {
        self.boxes
    }

    /// Returns the lattice of the tree's planes over a view box, which must not be empty.
    pub(crate) fn lattice(&self, min: Vec3, max: Vec3) -> Result<Lattice, PlaneError> {
        let mut planes: [Vec<f32>; 3] = Default::default();
        let mut open = vec![(0usize, min, max)];
        while let Some((node, min, max)) = open.pop() {
            let KdNode::Split { axis, at, upper } = self.nodes[node] else {
                continue;
            };
            if !(min[axis] < at && at < max[axis]) {
                return Err(PlaneError {
                    axis,
                    at,
                    min: min[axis],
                    max: max[axis],
                });
            }
            planes[axis].push(at);
            let (mut lower_max, mut upper_min) = (max, min);
            lower_max[axis] = at;
            upper_min[axis] = at;
            open.extend([(node + 1, min, lower_max), (upper, upper_min, max)]);
        }
        for planes in &mut planes {
            planes.sort_by(f32::total_cmp);
            planes.dedup();
        }
        Ok(Lattice::of_planes(min, max, Arc::new(planes)))
    }

    /// Returns the plane that splits the box `cell` of the tree, or `None` if the tree does not divide the
    /// box.
    pub(crate) fn split(&self, lattice: &Lattice, cell: &CellBox) -> Option<Split> {
        match self.nodes[self.find(lattice, cell)?] {
            KdNode::Split { axis, at, .. } => Some(Split {
                axis,
                at: lattice.unit(axis, at)?,
            }),
            KdNode::Box(_) => None,
        }
    }

    /// Returns the index of the undivided box `cell`, in the order of the tree, or `None` if the tree has no
    /// such box.
    pub(crate) fn number(&self, lattice: &Lattice, cell: &CellBox) -> Option<usize> {
        match self.nodes[self.find(lattice, cell)?] {
            KdNode::Box(number) => Some(number),
            KdNode::Split { .. } => None,
        }
    }

    /// Returns the index of the node of the box `cell`, or `None` if the box is not in the tree.
    fn find(&self, lattice: &Lattice, cell: &CellBox) -> Option<usize> {
        let mut at = CellBox {
            lo: [0; 3],
            hi: lattice.units(),
        };
        let mut node = 0;
        while at != *cell {
            let KdNode::Split {
                axis,
                at: plane,
                upper,
            } = self.nodes[node]
            else {
                return None;
            };
            let plane = lattice.unit(axis, plane)?;
            let [below, above] = at.children(Split { axis, at: plane });
            (node, at) = if cell.hi[axis] <= plane {
                (node + 1, below)
            } else {
                (upper, above)
            };
        }
        Some(node)
    }

    /// Returns the smallest width of a box along any axis, in world units, and the axis of this width.
    pub(crate) fn thinnest(&self, lattice: &Lattice) -> (f64, usize) {
        let (mut least, mut open) = ((f64::INFINITY, 0), vec![(0usize, [0; 3], lattice.units())]);
        while let Some((node, lo, hi)) = open.pop() {
            match self.nodes[node] {
                KdNode::Box(_) => {
                    let (min, max) = CellBox { lo, hi }.world(lattice);
                    for axis in 0..3 {
                        let width = f64::from(max[axis]) - f64::from(min[axis]);
                        least = if width < least.0 {
                            (width, axis)
                        } else {
                            least
                        };
                    }
                }
                KdNode::Split { axis, at, upper } => {
                    let at = lattice.unit(axis, at).unwrap_or(lo[axis]);
                    let [below, above] = CellBox { lo, hi }.children(Split { axis, at });
                    open.extend([(node + 1, below.lo, below.hi), (upper, above.lo, above.hi)]);
                }
            }
        }
        least
    }
}

impl Serialize for KdTree {
    /// Serializes only the number of boxes, because a result contains the tree itself.
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeMap as _;
        let mut map = to.serialize_map(Some(1))?;
        map.serialize_entry("boxes", &self.boxes)?;
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::{Division, DivisionError, Layout, Plan};

    /// Returns two rooms, where a wall at 0 divides the upper one.
    fn rooms() -> Division {
        Division::Tree(Arc::new(
            KdTree::new(&[1, 3, 0, 3, 3], &[0.5, -0.0]).unwrap(),
        ))
    }

    #[test]
    fn planes_keep_their_coordinates() {
        let division = rooms();
        let lattice = division
            .lattice(Vec3::splat(-1.0), Vec3::new(1.0, 2.0, 3.0))
            .unwrap();
        assert_eq!(lattice.units(), [2, 2, 1]);
        let plan = Plan::new(&division, &lattice, Layout::Blocks(512));
        let boxes: Vec<_> = plan
            .tiles
            .iter()
            .map(|tile| tile.cell.world(&lattice))
            .collect();
        assert_eq!(
            boxes,
            [
                (Vec3::splat(-1.0), Vec3::new(1.0, 0.5, 3.0)),
                (Vec3::new(-1.0, 0.5, -1.0), Vec3::new(0.0, 2.0, 3.0)),
                (Vec3::new(0.0, 0.5, -1.0), Vec3::new(1.0, 2.0, 3.0)),
            ]
        );
        let numbers = plan
            .tiles
            .iter()
            .map(|tile| division.number(&lattice, &tile.cell));
        assert_eq!(numbers.collect::<Vec<_>>(), [Some(0), Some(1), Some(2)]);
    }

    #[test]
    fn lattice_rejects_planes_outside_boxes() {
        let lattice_for = |axes: &[u32], planes: &[f32]| {
            Division::Tree(Arc::new(KdTree::new(axes, planes).unwrap()))
                .lattice(Vec3::ZERO, Vec3::ONE)
        };
        assert!(matches!(
            lattice_for(&[0, 3, 3], &[1.0]),
            Err(DivisionError::Plane(PlaneError { axis: 0, .. }))
        ));
        assert!(matches!(
            lattice_for(&[0, 3, 3], &[f32::NAN]),
            Err(DivisionError::Plane(_))
        ));
        assert!(matches!(
            lattice_for(&[0, 0, 3, 3, 3], &[0.5, 0.75]),
            Err(DivisionError::Plane(_))
        ));
        assert_eq!(lattice_for(&[3], &[]).unwrap().units(), [1, 1, 1]);
    }

    proptest! {
        #[test]
        fn random_nodes_give_tree_or_error(
            axes in proptest::collection::vec(0u32..5, 0..20),
            planes in proptest::collection::vec(-2f32..2.0, 0..10),
        ) {
            if let Ok(tree) = KdTree::new(&axes, &planes) {
                let (a, p) = tree.parts();
                prop_assert_eq!(a, axes);
                prop_assert_eq!(p.len() + 1, tree.boxes());
                let division = Division::Tree(Arc::new(tree));
                if let Ok(lattice) = division.lattice(Vec3::splat(-2.0), Vec3::splat(2.0)) {
                    let plan = Plan::new(&division, &lattice, Layout::Blocks(1));
                    prop_assert_eq!(plan.tiles.len(), p.len() + 1);
                }
            }
        }
    }
}
