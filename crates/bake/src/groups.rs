//! The cells of a tile's subtree, and the cell groups that exact queries treat as one box.

use std::ops::Range;

use sightline_model::SubtreeNode;
use sightline_viewcells::CellBox;

use crate::choices::GROUP_CELLS;

/// A box of the tree around several cells, from which triangles are decided once for all these cells.
pub struct CellGroup {
    /// The box around the cells.
    pub around: CellBox,
    /// The numbers of the group's cells in the tile.
    pub cells: Range<usize>,
}

/// Returns the boxes of a subtree's cells, in preorder, and the cell groups. Groups are the largest boxes of
/// the tree that contain [`GROUP_CELLS`] cells.
pub fn cells_and_groups(root: &CellBox, nodes: &[SubtreeNode]) -> (Vec<CellBox>, Vec<CellGroup>) {
    // The number of cells below each node, counted from the last node.
    let mut below = vec![1; nodes.len()];
    let mut open: Vec<usize> = Vec::new();
    for (i, node) in nodes.iter().enumerate().rev() {
        if let SubtreeNode::Split(_) = node {
            let both = open.pop().unwrap_or(0) + open.pop().unwrap_or(0);
            below[i] = both;
        }
        open.push(below[i]);
    }
    let (mut cells, mut groups) = (Vec::new(), Vec::<CellGroup>::new());
    let mut waiting = vec![*root];
    for (node, count) in nodes.iter().zip(below) {
        let Some(cell) = waiting.pop() else { break };
        let within = groups
            .last()
            .is_some_and(|g| g.cells.contains(&cells.len()));
        if !within && GROUP_CELLS.contains(&count) {
            groups.push(CellGroup {
                around: cell,
                cells: cells.len()..cells.len() + count,
            });
        }
        match node {
            SubtreeNode::Split(split) => {
                let [below, above] = cell.children(*split);
                waiting.extend([above, below]);
            }
            SubtreeNode::Cell => cells.push(cell),
        }
    }
    (cells, groups)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use sightline_viewcells::Division;

    use super::*;

    /// Returns the subtree of a grid in preorder.
    fn grid(cells: [u32; 3]) -> (CellBox, Vec<SubtreeNode>) {
        let division = Division::Grid(cells);
        let lattice = division.lattice(Vec3::ZERO, Vec3::ONE).unwrap();
        let root = division.root(&lattice);
        let (mut nodes, mut waiting) = (Vec::new(), vec![(root, 0)]);
        while let Some((cell, depth)) = waiting.pop() {
            match division.split(&lattice, &cell, depth) {
                Some(split) => {
                    nodes.push(SubtreeNode::Split(split));
                    let [below, above] = cell.children(split);
                    waiting.extend([(above, depth + 1), (below, depth + 1)]);
                }
                None => nodes.push(SubtreeNode::Cell),
            }
        }
        (root, nodes)
    }

    #[test]
    fn groups_contain_their_cells_and_do_not_overlap() {
        for (size, sizes) in [
            ([1, 1, 1], vec![]),
            ([3, 1, 1], vec![]),
            ([2, 2, 1], vec![4]),
            ([2, 2, 2], vec![8]),
            ([5, 1, 1], vec![5]),
            ([4, 4, 2], vec![8; 4]),
            ([4, 4, 4], vec![8; 8]),
            ([9, 1, 1], vec![4, 5]),
        ] {
            let (root, nodes) = grid(size);
            let (cells, groups) = cells_and_groups(&root, &nodes);
            assert_eq!(cells.len(), size.iter().product::<u32>() as usize);
            assert_eq!(
                groups.iter().map(|g| g.cells.len()).collect::<Vec<_>>(),
                sizes,
                "{size:?}"
            );
            assert!(
                groups
                    .windows(2)
                    .all(|w| w[0].cells.end <= w[1].cells.start)
            );
            for CellGroup {
                around: at,
                cells: range,
            } in &groups
            {
                let volume = |b: &CellBox| {
                    (0..3)
                        .map(|a| u64::from(b.hi[a] - b.lo[a]))
                        .product::<u64>()
                };
                let within =
                    |c: &CellBox| (0..3).all(|a| at.lo[a] <= c.lo[a] && c.hi[a] <= at.hi[a]);
                assert!(cells[range.clone()].iter().all(within));
                assert_eq!(
                    volume(at),
                    cells[range.clone()].iter().map(volume).sum::<u64>()
                );
            }
        }
    }
}
