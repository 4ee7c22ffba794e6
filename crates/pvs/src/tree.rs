//! The kd-tree of view cells in the form of the file: finds the cell of a point and the box of a cell.
//!
//! This module checks a tree. Other crates choose its planes.

use crate::error::PvsError;

/// The maximum number of planes between the root and a cell. Halving a box 64 times exhausts the precision of
/// `f32` in practice, so no real tree is rejected, and functions that walk a tree can recurse.
pub const MAX_DEPTH: usize = 64;

/// A node of the tree. The children of a split come after the split, first the lower child with all of its
/// descendants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Node {
    /// A split of the box by the plane on which coordinate `axis` equals `at`.
    Split {
        /// The axis: 0, 1 or 2 for x, y or z.
        axis: u8,
        /// The coordinate of the plane, strictly inside the node's box.
        at: f32,
    },
    /// A view cell.
    Leaf,
}

/// The links of a node, for walks up and down the tree without searches.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Links {
    /// The index of the parent node; the root is its own parent.
    parent: u32,
    /// The index of the upper child of a split, or of the cell of a leaf.
    upper_or_cell: u32,
    /// The first cell below the node, and the cell after the last one.
    first: u32,
    end: u32,
}

/// A valid kd-tree over a view box. The leaves are the cells, numbered 0 … M−1 in depth-first order, lower
/// child first.
#[derive(Clone, Debug, PartialEq)]
pub struct CellTree {
    view_box: [[f32; 3]; 2],
    nodes: Vec<Node>,
    links: Vec<Links>,
    /// The index of the node of each cell.
    leaves: Vec<u32>,
}

impl CellTree {
    /// Creates a tree after checks of the view box (min, max; world space) and of the nodes in depth-first
    /// order.
    ///
    /// # Errors
    /// [`PvsError::Tree`] if the box is not finite or has min > max, a plane is not strictly inside its
    /// node's box, an axis is above 2, nodes are missing or left over, or the tree is deeper than
    /// [`MAX_DEPTH`]. [`PvsError::TooLarge`] if there are more than 2³¹ − 1 nodes.
    pub fn new(view_box: [[f32; 3]; 2], nodes: Vec<Node>) -> Result<Self, PvsError> {
        let bad = |node: usize, reason: &str| PvsError::Tree {
            node,
            reason: reason.to_owned(),
        };
        let [lo, hi] = view_box;
        if !(0..3).all(|a| lo[a].is_finite() && hi[a].is_finite() && lo[a] <= hi[a]) {
            return Err(bad(0, "the view box must be finite with min ≤ max"));
        }
        if nodes.len() > (u32::MAX >> 1) as usize {
            return Err(PvsError::TooLarge {
                what: "the number of tree nodes",
                value: nodes.len() as u64,
                limit: u64::from(u32::MAX >> 1),
            });
        }
        let mut links = Vec::with_capacity(nodes.len());
        let mut leaves = Vec::new();
        // The subtrees not read yet, with the next one on top: (parent, box, is the upper child, depth).
        let mut open = vec![(0u32, view_box, false, 0usize)];
        for (i, node) in nodes.iter().enumerate() {
            let Some((parent, bounds, is_upper, depth)) = open.pop() else {
                return Err(bad(i, "the tree is complete before this node"));
            };
            if is_upper {
                let above: &mut Links = &mut links[parent as usize];
                above.upper_or_cell = i as u32;
            }
            match *node {
                Node::Leaf => {
                    let cell = leaves.len() as u32;
                    links.push(Links {
                        parent,
                        upper_or_cell: cell,
                        first: cell,
                        end: cell + 1,
                    });
                    leaves.push(i as u32);
                }
                Node::Split { axis, at } => {
                    let a = usize::from(axis);
                    if a > 2 {
                        return Err(bad(i, "the axis must be 0, 1 or 2"));
                    }
                    if !(bounds[0][a] < at && at < bounds[1][a]) {
                        return Err(bad(i, "the plane must lie strictly inside the node's box"));
                    }
                    if depth >= MAX_DEPTH {
                        return Err(bad(i, "the tree has more than 64 levels of planes"));
                    }
                    links.push(Links {
                        parent,
                        upper_or_cell: 0,
                        first: leaves.len() as u32,
                        end: 0,
                    });
                    let (mut lower, mut upper) = (bounds, bounds);
                    lower[1][a] = at;
                    upper[0][a] = at;
                    open.push((i as u32, upper, true, depth + 1));
                    open.push((i as u32, lower, false, depth + 1));
                }
            }
        }
        if !open.is_empty() {
            return Err(bad(nodes.len(), "nodes are missing at the end"));
        }
        // Children come after their parents, so a backward loop finishes every child before its parent.
        for i in (0..nodes.len()).rev() {
            if let Node::Split { .. } = nodes[i] {
                links[i].end = links[links[i].upper_or_cell as usize].end;
            }
        }
        Ok(Self {
            view_box,
            nodes,
            links,
            leaves,
        })
    }

    /// Returns the view box: min, max.
    pub fn view_box(&self) -> [[f32; 3]; 2] {
        self.view_box
    }

    /// Returns the nodes in depth-first order, lower child first.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Returns the number of cells, M ≥ 1.
    pub fn cells(&self) -> u32 {
        self.leaves.len() as u32
    }

    /// Returns the box of a cell (min, max), or `None` if the cell does not exist.
    pub fn cell_bounds(&self, cell: u32) -> Option<[[f32; 3]; 2]> {
        let mut child = self.leaf(cell)?;
        let mut bounds = self.view_box;
        let mut known = [[false; 3]; 2];
        // On the way up from the leaf, the first plane on each side is the tightest.
        while child != 0 {
            let parent = self.parent(child);
            if let Node::Split { axis, at } = self.nodes[parent as usize] {
                let side = usize::from(child == parent + 1);
                let a = usize::from(axis);
                if !known[side][a] {
                    known[side][a] = true;
                    bounds[side][a] = at;
                }
            }
            child = parent;
        }
        Some(bounds)
    }

    /// Returns the index of the cell that contains a point in world space. A point on a splitting plane
    /// belongs to the upper side, and the view box is closed. Returns `None` if the point is outside the view
    /// box or a coordinate is NaN.
    pub fn find_cell(&self, point: [f32; 3]) -> Option<u32> {
        self.find_cell_precisely(point.map(f64::from))
    }

    /// Returns the cell of a point like [`Self::find_cell`], for coordinates in doubles.
    pub fn find_cell_precisely(&self, point: [f64; 3]) -> Option<u32> {
        let [lo, hi] = self.view_box.map(|corner| corner.map(f64::from));
        if !(0..3).all(|a| lo[a] <= point[a] && point[a] <= hi[a]) {
            return None;
        }
        let mut node = 0usize;
        while let Node::Split { axis, at } = self.nodes[node] {
            let below = point[usize::from(axis)] < f64::from(at);
            node = if below {
                node + 1
            } else {
                self.links[node].upper_or_cell as usize
            };
        }
        Some(self.links[node].upper_or_cell)
    }

    /// Returns the index of the node of a cell, or `None` if the cell does not exist.
    pub(crate) fn leaf(&self, cell: u32) -> Option<u32> {
        self.leaves.get(cell as usize).copied()
    }

    /// Returns the parent of a node. The root is its own parent.
    pub(crate) fn parent(&self, node: u32) -> u32 {
        self.links[node as usize].parent
    }

    /// Returns the upper child of a split, or `None` for a leaf. The lower child is the next node.
    pub(crate) fn upper(&self, node: u32) -> Option<u32> {
        match self.nodes[node as usize] {
            Node::Split { .. } => Some(self.links[node as usize].upper_or_cell),
            Node::Leaf => None,
        }
    }

    /// Returns the first cell below a node, and the cell after the last one.
    pub(crate) fn cells_below(&self, node: u32) -> [u32; 2] {
        [
            self.links[node as usize].first,
            self.links[node as usize].end,
        ]
    }

    /// Returns the nodes from `node` up to the root, including both.
    pub(crate) fn path(&self, node: u32) -> impl Iterator<Item = u32> + '_ {
        std::iter::successors(Some(node), |&n| (n != 0).then(|| self.parent(n)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: [[f32; 3]; 2] = [[0.0, 0.0, 0.0], [4.0, 2.0, 1.0]];

    fn tree() -> CellTree {
        let split = |axis, at| Node::Split { axis, at };
        // x<1 | x≥1: (y<1: (x<3 | x≥3) | y≥1)
        let nodes = vec![
            split(0, 1.0),
            Node::Leaf,
            split(1, 1.0),
            split(0, 3.0),
            Node::Leaf,
            Node::Leaf,
            Node::Leaf,
        ];
        CellTree::new(BOX, nodes).unwrap()
    }

    #[test]
    fn cells_have_depth_first_numbers_and_plane_bounds() {
        let t = tree();
        assert_eq!(t.cells(), 4);
        assert_eq!(t.cell_bounds(0), Some([[0.0, 0.0, 0.0], [1.0, 2.0, 1.0]]));
        assert_eq!(t.cell_bounds(1), Some([[1.0, 0.0, 0.0], [3.0, 1.0, 1.0]]));
        assert_eq!(t.cell_bounds(2), Some([[3.0, 0.0, 0.0], [4.0, 1.0, 1.0]]));
        assert_eq!(t.cell_bounds(3), Some([[1.0, 1.0, 0.0], [4.0, 2.0, 1.0]]));
        assert_eq!(t.cell_bounds(4), None);
    }

    #[test]
    fn point_on_plane_is_above_and_view_box_is_closed() {
        let t = tree();
        assert_eq!(t.find_cell([0.5, 0.5, 0.5]), Some(0));
        assert_eq!(t.find_cell([1.0, 0.5, 0.5]), Some(1));
        assert_eq!(t.find_cell([3.0, 0.5, 0.5]), Some(2));
        assert_eq!(t.find_cell([2.0, 1.0, 0.5]), Some(3));
        assert_eq!(t.find_cell([4.0, 2.0, 1.0]), Some(3));
        assert_eq!(t.find_cell([0.0, 0.0, 0.0]), Some(0));
        for outside in [
            [4.1, 0.5, 0.5],
            [-0.1, 0.5, 0.5],
            [f32::NAN, 0.5, 0.5],
            [1.0, f32::INFINITY, 0.0],
        ] {
            assert_eq!(t.find_cell(outside), None);
        }
    }

    #[test]
    fn new_rejects_bad_trees() {
        let split = |at| Node::Split { axis: 0, at };
        let why = |nodes: Vec<Node>| CellTree::new(BOX, nodes).unwrap_err().to_string();
        assert!(why(vec![]).contains("missing"));
        assert!(why(vec![split(1.0), Node::Leaf]).contains("missing"));
        assert!(why(vec![Node::Leaf, Node::Leaf]).contains("complete"));
        assert!(why(vec![split(4.0), Node::Leaf, Node::Leaf]).contains("strictly inside"));
        assert!(why(vec![split(f32::NAN), Node::Leaf, Node::Leaf]).contains("strictly inside"));
        assert!(
            why(vec![
                Node::Split { axis: 3, at: 1.0 },
                Node::Leaf,
                Node::Leaf
            ])
            .contains("axis")
        );
        assert!(CellTree::new([[f32::NAN; 3], [1.0; 3]], vec![Node::Leaf]).is_err());
        assert!(CellTree::new([[1.0; 3], [0.0; 3]], vec![Node::Leaf]).is_err());
        assert!(
            CellTree::new([[1.0; 3], [1.0; 3]], vec![Node::Leaf]).is_ok(),
            "a flat box is a box"
        );
        // Build two degenerate trees deeper than allowed, one to each side.
        let box_x = [[0.0; 3], [1.0; 3]];
        let lower: Vec<Node> = (1..100)
            .map(|i| split(0.5f32.powi(i)))
            .chain(std::iter::repeat_n(Node::Leaf, 100))
            .collect();
        assert!(
            CellTree::new(box_x, lower)
                .unwrap_err()
                .to_string()
                .contains("more than 64 levels")
        );
        let upper: Vec<Node> = (1..100)
            .flat_map(|i| [split(i as f32 / 128.0), Node::Leaf])
            .chain([Node::Leaf])
            .collect();
        assert!(
            CellTree::new(box_x, upper)
                .unwrap_err()
                .to_string()
                .contains("more than 64 levels")
        );
    }
}
