//! Adaptive trees from sight lines.
//!
//! A block of small cells is sampled at once, and cells are joined if their union has at most the triangle
//! budget.
//!
//! The set of a cell is the union of the sets of its parts. The sets of the small cells therefore determine
//! the sets of all nodes above them, and these sets determine where the tree ends. Nirenstein 2003 (section
//! 4.2.2) grows the tree from the root: a set from cubes on a cell's surface is known before the sets of the
//! cell's parts. A line, in contrast, costs less per cell if more cells share it.
//!
//! The small cells are not divided further, because new lines from their parts would miss triangles that the
//! whole cell is known to see. This is the reason for the maximum depth [`MOST_LINE_DEPTH`].

use sightline_model::CellStats;
use sightline_model::{CellSet, CellSets, MOST_LINE_DEPTH, SubtreeNode};
use sightline_trace::lines::grid::CellGrid;
use sightline_viewcells::division::FORCED_DEPTH;
use sightline_viewcells::{CellBox, Division, Split, Tile};

use super::likely_items::{LikelyItem, SEEN_PER_LIKELY, completed_set, joined};
use super::rounds::Tolerance;
use super::tile_sampling::{TileSampling, share};
use crate::context::{JobContext, TileError};

/// Maximum number of levels of the tree that one block samples: 8×8×8 cells, fewer along the short axes of a
/// flat cell.
const LEVELS: u32 = 9;

// The specification rejects deeper trees.
const _: () = assert!(MOST_LINE_DEPTH == FORCED_DEPTH + LEVELS);
/// Maximum margin of a grid ([`CellGrid::margin`]), as a fraction of a cell. The tree has no further level if
/// the rounding of coordinates would need a larger margin.
const MOST_MARGIN: f32 = 1.0 / 16.0;

/// Computes a leaf tile of an adaptive tree, whose small cells are finished at an expected error.
///
/// # Errors
/// [`TileError`] if the tile is cancelled or the tracer fails.
pub fn run(
    sampling: &TileSampling<'_>,
    error: f64,
    tile: &Tile,
) -> Result<(CellSets, u64), TileError> {
    let TileSampling { job, watcher, .. } = sampling;
    let (levels, sides) = regular(job, &tile.cell, tile.depth);
    let number = |c: [u32; 3]| number(job.lattice.units(), &tile.cell, sides, c);
    let mut block = sampling.block(&tile.cell, sides, number, |_| u64::MAX);
    // The number of finished cells is unknown until the tree is built.
    block.caller_reports_cells = true;
    if job.completes {
        block.enable_completion(sampling.scene.duplicates);
    }
    block.sample(error, &[], Tolerance::Raised)?;
    block.complete_all();
    let likely = block.likely_items();
    share(sampling, &mut block);
    let mut sampled = Sampled {
        grid: block.grid().clone(),
        cell: tile.cell,
        levels,
        columns: block.bits().columns(),
        likely,
        stats: block.stats().to_vec(),
    };
    let rays = sampled.stats.iter().flat_map(|s| s.rays).sum::<u64>();
    drop(block);
    let part = sampled.part(job, &tile.cell, tile.depth, 0);
    part.cells.iter().for_each(|_| watcher.cell_done());
    Ok((
        CellSets {
            nodes: part.nodes,
            cells: part.cells,
            pairs: None,
            portals: Vec::new(),
        },
        rays,
    ))
}

/// A part of the tree, in preorder.
struct Subtree {
    nodes: Vec<SubtreeNode>,
    cells: Vec<CellSet>,
    /// The ids of the triangles seen from this part, in ascending order.
    seen: Vec<u32>,
    /// The likely triangles of the smaller cells, by ascending id. The part may have seen some of them.
    likely: Vec<LikelyItem>,
    stats: CellStats,
}

/// The sampled small cells below a cell.
struct Sampled {
    grid: CellGrid,
    /// The cell that contains the small cells.
    cell: CellBox,
    levels: u32,
    columns: Vec<Vec<u32>>,
    /// The likely triangles of each cell.
    likely: Vec<Vec<LikelyItem>>,
    stats: Vec<CellStats>,
}

/// Returns the number of regular levels below a cell, at most [`LEVELS`], and the number of cells of the last
/// level along each axis.
fn regular(job: &JobContext<'_>, cell: &CellBox, depth: u32) -> (u32, [u32; 3]) {
    let (min, max) = cell.world(&job.lattice);
    let (mut sides, mut cells) = ([1; 3], vec![*cell]);
    for level in 0..LEVELS {
        let splits: Option<Vec<Split>> = cells
            .iter()
            .map(|c| job.division.split(&job.lattice, c, depth + level))
            .collect();
        // The tree ends if no plane is left. This can happen in some cells of a level only.
        let Some(splits) = splits else {
            return (level, sides);
        };
        let axis = splits[0].axis;
        let halves =
            |(c, s): (&CellBox, &Split)| s.axis == axis && s.at - c.lo[axis] == c.hi[axis] - s.at;
        let mut finer = sides;
        finer[axis] *= 2;
        let fine = CellGrid::new(min, max, finer).margin() > MOST_MARGIN;
        if fine || !cells.iter().zip(&splits).all(halves) {
            return (level, sides);
        }
        sides = finer;
        cells = cells
            .iter()
            .zip(splits)
            .flat_map(|(c, s)| c.children(s))
            .collect();
    }
    (LEVELS, sides)
}

impl Sampled {
    /// Builds the tree of a cell at a depth, `level` levels below the cell of the block.
    fn part(&mut self, job: &JobContext<'_>, cell: &CellBox, depth: u32, level: u32) -> Subtree {
        let split = job
            .division
            .split(&job.lattice, cell, depth)
            .filter(|_| level < self.levels);
        let Some(split) = split else {
            let (seen, likely, stats) = self.take(cell);
            return Subtree::leaf(job, seen, likely, stats);
        };
        let [below, above] = cell
            .children(split)
            .map(|c| self.part(job, &c, depth + 1, level + 1));
        let seen = union(&below.seen, &above.seen);
        let likely = joined(&below.likely, &above.likely);
        let stats = below.stats.joined(&above.stats);
        if !job.division.wants_split(seen.len(), depth) {
            return Subtree::leaf(job, seen, likely, stats);
        }
        let mut nodes = vec![SubtreeNode::Split(split)];
        nodes.extend(below.nodes.into_iter().chain(above.nodes));
        let mut cells = below.cells;
        cells.extend(above.cells);
        Subtree {
            nodes,
            cells,
            seen,
            likely,
            stats,
        }
    }

    /// Removes and returns the seen and the likely triangles of a small cell, and returns the cell's
    /// statistics.
    fn take(&mut self, cell: &CellBox) -> (Vec<u32>, Vec<LikelyItem>, CellStats) {
        let sides = self.grid.cells();
        let at = [0, 1, 2].map(|a| {
            (cell.lo[a] - self.cell.lo[a]) / ((self.cell.hi[a] - self.cell.lo[a]) / sides[a])
        });
        let place = ((at[2] * sides[1] + at[1]) * sides[0] + at[0]) as usize;
        (
            std::mem::take(&mut self.columns[self.grid.slot(at).index()]),
            std::mem::take(&mut self.likely[place]),
            self.stats[place],
        )
    }
}

impl Subtree {
    /// Creates a cell. Its completed set is within the triangle budget if the seen triangles are.
    fn leaf(
        job: &JobContext<'_>,
        seen: Vec<u32>,
        likely: Vec<LikelyItem>,
        stats: CellStats,
    ) -> Self {
        let budget = match job.division {
            Division::Adaptive { budget, .. } => budget as usize,
            _ => usize::MAX,
        };
        let most = (seen.len() / SEEN_PER_LIKELY).min(budget.saturating_sub(seen.len()));
        let (visible, undecided) = completed_set(seen.clone(), likely.clone(), most);
        let cell = CellSet {
            visible,
            undecided,
            stats,
            ..CellSet::default()
        };
        Self {
            nodes: vec![SubtreeNode::Cell],
            cells: vec![cell],
            seen,
            likely,
            stats,
        }
    }
}

/// Returns a unique number for each cell of each level of the tree, for the cell's random numbers.
///
/// The number is 2 to the power of the level plus the cell's index in the level.
fn number(units: [u32; 3], block: &CellBox, sides: [u32; 3], c: [u32; 3]) -> u64 {
    let step = [0, 1, 2].map(|a| (block.hi[a] - block.lo[a]) / sides[a]);
    let many = [0, 1, 2].map(|a| u64::from(units[a] / step[a]));
    let [x, y, z] = [0, 1, 2].map(|a| u64::from(block.lo[a] / step[a] + c[a]));
    many.iter().product::<u64>() + (z * many[1] + y) * many[0] + x
}

/// Returns the union of two ascending lists.
fn union(a: &[u32], b: &[u32]) -> Vec<u32> {
    let mut out = Vec::with_capacity(a.len().max(b.len()));
    let (mut i, mut j) = (0, 0);
    while let (Some(x), Some(y)) = (a.get(i), b.get(j)) {
        out.push(*x.min(y));
        (i, j) = (i + usize::from(x <= y), j + usize::from(y <= x));
    }
    out.extend_from_slice(&a[i..]);
    out.extend_from_slice(&b[j..]);
    out
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_cell_of_every_level_has_unique_number() {
        // The cell is halved along x, y, x, z, in blocks of two levels each.
        let units = [1 << 16; 3];
        let root = CellBox {
            lo: [0; 3],
            hi: units,
        };
        let halves = |cells: &[CellBox], axis: usize| -> Vec<CellBox> {
            let at = |c: &CellBox| c.lo[axis] + (c.hi[axis] - c.lo[axis]) / 2;
            cells
                .iter()
                .flat_map(|c| c.children(Split { axis, at: at(c) }))
                .collect()
        };
        let (mut numbers, mut many) = (BTreeSet::new(), 0);
        let mut add = |block: &CellBox, sides: [u32; 3]| {
            for (z, y, x) in (0..sides[2]).flat_map(|z| {
                (0..sides[1]).flat_map(move |y| (0..sides[0]).map(move |x| (z, y, x)))
            }) {
                numbers.insert(number(units, block, sides, [x, y, z]));
                many += 1;
            }
        };
        add(&root, [1, 1, 1]);
        add(&root, [2, 2, 1]);
        for cell in halves(&halves(&[root], 0), 1) {
            add(&cell, [2, 1, 1]);
            add(&cell, [2, 1, 2]);
        }
        assert_eq!((numbers.len(), many), (1 + 4 + 8 + 16, 1 + 4 + 8 + 16));
    }

    #[test]
    fn union_is_ascending_without_duplicates() {
        assert_eq!(union(&[1, 3, 5], &[]), [1, 3, 5]);
        assert_eq!(union(&[1, 3, 5], &[0, 3, 4, 9]), [0, 1, 3, 4, 5, 9]);
    }
}
