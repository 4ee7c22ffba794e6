//! The sets of the cells of a fine grid, and the costs of the boxes of these cells.
//!
//! The set of a box is the union of the sets of its cells. The weight of a box is the sum of the weights of
//! its cells, and its cost for the search ([`sightline_viewcells::cheapest`]) is weight times cost of the
//! union.

use rayon::prelude::*;
use sightline_model::statistics::VIEWPOINT_WEIGHT;
use sightline_model::{CellBudget, CellCost};
use sightline_pvs::{Granularity, Pvs, PvsError, coded_bytes, runs};
use sightline_viewcells::cheapest::{
    BoxCost, CheapestTree, CheapestTrees, FineBox, FineGrid, FineGridError, FineNode,
};

/// The reason why cells by cost cannot be chosen in a result.
#[derive(Debug, thiserror::Error)]
pub enum FineSetsError {
    /// The cells of the result are not a grid.
    #[error("the cells are not a grid; bake the scene with --cells NXxNYxNZ for a fine grid")]
    NotGrid,
    /// The grid has too many boxes.
    #[error(transparent)]
    Grid(#[from] FineGridError),
    /// The rows of bits need too much memory.
    #[error(
        "the sets of {cells} cells need {megabytes} MB of memory, which is more than the search uses for the \
         file; bake the scene with fewer cells"
    )]
    Memory {
        /// The number of cells.
        cells: usize,
        /// The memory that the rows need, in millions of bytes.
        megabytes: u64,
    },
    /// The memory for the rows of bits is not available.
    #[error("the memory for the sets of the cells is not available: {0}")]
    Allocation(#[from] std::collections::TryReserveError),
    /// The weights are for another number of cells.
    #[error("the number of weights differs from the number of cells; give a weight for each cell")]
    Weights,
    /// All weights are of cells without viewpoints.
    #[error("no weighted viewpoint is in a cell with viewpoints; give other viewpoints")]
    NoWeight,
    /// No cell of the result has viewpoints.
    #[error("no cell has viewpoints; bake the scene with other viewpoints")]
    NoViewpoints,
    /// The search was cancelled.
    #[error("the search for cells was cancelled")]
    Cancelled,
    /// The result cannot be read.
    #[error(transparent)]
    Pvs(#[from] PvsError),
}

/// The sets of the cells of a fine grid, as rows of bits.
pub struct FineSets {
    grid: FineGrid,
    /// The coordinates of the faces of the cells along each axis.
    planes: [Vec<f32>; 3],
    cost: CellCost,
    /// The number of words of a row that the cost counts. The rest of a row has the items of the coded set.
    counted: usize,
    /// The number of words of a row.
    words: usize,
    /// The rows of the cells, x fastest, then y, then z. Cells without viewpoints have no bits.
    rows: Vec<u64>,
    /// The number of each cell in the result.
    numbers: Vec<u32>,
    /// The weight of each cell; `None` for a cell without viewpoints.
    weights: Vec<Option<u64>>,
}

/// The numbers of the union of a box.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UnionCost {
    /// The number of fine cells with viewpoints.
    pub reached: u64,
    /// The sum of the weights of these cells.
    pub weight: u64,
    /// The cost of the union for a viewpoint.
    pub cost: u64,
    /// The number of bytes of the coded union.
    pub bytes: u64,
}

/// The costs of all boxes of a fine grid for a budget.
pub struct BoxCosts {
    search: CheapestTrees,
    limit: u64,
}

/// The numbers of a division.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct CellDivision {
    /// The number of cells with a set.
    pub cells: u64,
    /// The sum of the sizes of the sets, each coded separately, in bytes.
    pub bytes: u64,
    /// The expected set: the mean cost over all viewpoints.
    pub expected: f64,
}

/// The largest number of divisions of [`FineSets::hull`].
const MOST_DIVISIONS: usize = 16;

impl FineSets {
    /// Reads the sets of a result. `weights` are the weights of the cells, x fastest, then y, then z; empty
    /// for the weights of the result. The rows use at most `most_bytes` bytes.
    ///
    /// # Errors
    /// [`FineSetsError`] if the cells are not a grid, are too many, or have no viewpoints, or if the result
    /// cannot be read.
    pub fn read(
        pvs: &Pvs,
        cost: CellCost,
        weights: &[u32],
        most_bytes: u64,
    ) -> Result<Self, FineSetsError> {
        let cells = cell_bounds(pvs);
        let planes = fine_planes(pvs)?;
        let grid = FineGrid::new(planes.each_ref().map(|planes| planes.len() - 1))?;
        if ![0, cells.len()].contains(&weights.len()) {
            return Err(FineSetsError::Weights);
        }
        let counted = match cost {
            CellCost::Triangles => (pvs.triangle_count() as usize).div_ceil(64),
            CellCost::Objects => pvs.objects().len().div_ceil(64),
            CellCost::Bytes => 0,
        };
        // The coded sets name triangles or other items.
        let names_triangles = pvs.granularity() == Granularity::Triangles;
        let coded = match cost == CellCost::Triangles && names_triangles {
            true => 0,
            false => (pvs.item_count() as usize).div_ceil(64),
        };
        let words = counted + coded;
        let bytes = 8 * words as u64 * cells.len() as u64;
        if bytes > most_bytes {
            return Err(FineSetsError::Memory {
                cells: cells.len(),
                megabytes: bytes / 1_000_000,
            });
        }
        let mut rows = Vec::new();
        rows.try_reserve_exact(words * cells.len())?;
        rows.resize(words * cells.len(), 0);
        let mut sets = Self {
            grid,
            planes,
            cost,
            counted,
            words,
            rows,
            numbers: vec![0; cells.len()],
            weights: vec![None; cells.len()],
        };
        let own = result_weights(pvs)?;
        let mut ids = Vec::new();
        for (number, bounds) in (0..).zip(&cells) {
            let place = sets.place_of_corner(bounds[0]);
            sets.numbers[place] = number;
            if !pvs.is_reached(number)? {
                continue;
            }
            sets.weights[place] = Some(match (weights.get(place), own.get(number as usize)) {
                (Some(weight), _) => u64::from(*weight),
                // The sum of the weights of a job fits in 32 bits; a foreign file may have any numbers.
                (None, Some(weight)) => (*weight).min(u64::from(u32::MAX) / cells.len() as u64),
                (None, None) => 1,
            });
            let row = &mut sets.rows[place * words..][..words];
            let (counted, coded) = row.split_at_mut(counted);
            match cost {
                CellCost::Triangles => pvs.visible_bits(number, counted)?,
                CellCost::Objects => {
                    pvs.visible_objects(number, &mut ids)?;
                    set_bits(counted, &ids);
                }
                CellCost::Bytes => {}
            }
            if coded.is_empty() {
                continue;
            }
            if names_triangles {
                pvs.visible_bits(number, coded)?;
            } else {
                pvs.visible_items(number, &mut ids)?;
                set_bits(coded, &ids);
            }
        }
        if sets.weights.iter().all(Option::is_none) {
            return Err(FineSetsError::NoViewpoints);
        }
        if !weights.is_empty() && sets.weights.iter().flatten().all(|weight| *weight == 0) {
            return Err(FineSetsError::NoWeight);
        }
        Ok(sets)
    }

    /// Returns the fine grid.
    pub fn grid(&self) -> FineGrid {
        self.grid
    }

    /// Returns the coordinate of a plane of the grid: the lower face of cell `at` along `axis`.
    pub fn plane(&self, axis: usize, at: usize) -> f32 {
        self.planes[axis][at]
    }

    /// Returns the numbers, in the result, of the cells of a box that have viewpoints.
    pub fn reached_cells(&self, of_cells: FineBox) -> impl Iterator<Item = u32> + '_ {
        let reached = |place: usize| self.weights[place].map(|_| self.numbers[place]);
        self.places(of_cells).filter_map(reached)
    }

    /// Returns the numbers of all cells of a box in the result.
    pub fn all_cells(&self, of_cells: FineBox) -> impl Iterator<Item = u32> + '_ {
        self.places(of_cells).map(|place| self.numbers[place])
    }

    /// Returns the weight of a box of cells.
    pub fn weight(&self, of_cells: FineBox) -> u64 {
        self.places(of_cells)
            .filter_map(|place| self.weights[place])
            .sum()
    }

    /// Returns the cells of the grid as boxes.
    pub fn cells(&self) -> Vec<FineBox> {
        let mut cells = Vec::new();
        self.grid.each(|of_cells| {
            if (0..3).all(|a| of_cells.hi[a] == of_cells.lo[a] + 1) {
                cells.push(of_cells);
            }
        });
        cells
    }

    /// Returns the union of a box of cells.
    pub fn union(&self, of_cells: FineBox) -> UnionCost {
        let mut row = vec![0; self.words];
        let mut union = UnionCost::default();
        for place in self.places(of_cells) {
            if let Some(weight) = self.weights[place] {
                union.reached += 1;
                union.weight += weight;
                add(&mut row, self.row(place));
            }
        }
        match union.reached {
            0 => union,
            _ => UnionCost {
                reached: union.reached,
                weight: union.weight,
                ..self.union_cost(&row, true)
            },
        }
    }

    /// Returns the numbers of a division into boxes.
    pub fn division(&self, boxes: &[FineBox]) -> CellDivision {
        let unions: Vec<UnionCost> = boxes.par_iter().map(|b| self.union(*b)).collect();
        let reached = || unions.iter().filter(|union| union.reached > 0);
        CellDivision {
            cells: reached().count() as u64,
            bytes: reached().map(|union| union.bytes).sum(),
            expected: self.expected(reached().map(|union| union.weight * union.cost).sum()),
        }
    }

    /// Returns the mean of a sum of weights times costs. Without weights, the mean is 0.
    fn expected(&self, sum: u64) -> f64 {
        let weight: u64 = self.weights.iter().flatten().sum();
        match weight {
            0 => 0.0,
            weight => sum as f64 / weight as f64,
        }
    }

    /// Computes the costs of all boxes.
    ///
    /// # Errors
    /// [`FineSetsError::Cancelled`] if `is_cancelled` returns true.
    pub fn costs(
        &self,
        budget: CellBudget,
        is_cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<BoxCosts, FineSetsError> {
        let (limit, in_bytes) = match budget {
            CellBudget::Cells(cells) => (cells.get(), false),
            CellBudget::Bytes(bytes) => (bytes.get(), true),
        };
        let needs_bytes = in_bytes || self.cost == CellCost::Bytes;
        let [_, ny, nz] = self.grid.cells();
        let parts: Vec<Vec<(usize, BoxCost)>> = (0..ny * nz)
            .into_par_iter()
            .map(|low| {
                if is_cancelled() {
                    return Err(FineSetsError::Cancelled);
                }
                let mut found = Vec::new();
                self.each_union_from([low % ny, low / ny], needs_bytes, |of_cells, union| {
                    if union.reached > 0 {
                        let cost = BoxCost {
                            cost: union.weight * union.cost,
                            size: if in_bytes { union.bytes } else { 1 },
                        };
                        found.push((self.grid.number(of_cells), cost));
                    }
                });
                Ok(found)
            })
            .collect::<Result<_, _>>()?;
        let mut costs = vec![BoxCost::default(); self.grid.boxes()];
        for (number, cost) in parts.into_iter().flatten() {
            costs[number] = cost;
        }
        Ok(BoxCosts {
            search: CheapestTrees::new(self.grid, costs),
            limit,
        })
    }

    /// Returns divisions at vertices of the lower convex hull of size and expected set, at most 16, with
    /// ascending sizes.
    pub fn hull(&self, costs: &BoxCosts) -> Vec<CellDivision> {
        let trees = costs.search.hull(MOST_DIVISIONS);
        trees
            .iter()
            .map(|tree| self.division(&leaves(tree)))
            .collect()
    }

    /// Calls `each` with the union of every box whose lowest cells have the coordinates `low` along y and z.
    /// A union grows by one layer of cells at a time.
    fn each_union_from(
        &self,
        low: [usize; 2],
        needs_bytes: bool,
        mut each: impl FnMut(FineBox, UnionCost),
    ) {
        let ([nx, ny, nz], words) = (self.grid.cells(), self.words);
        let [y0, z0] = low;
        // The unions over the interval along z, of each column of cells along z, with their numbers and
        // weights of reached cells.
        let mut columns = vec![0u64; nx * (ny - y0) * words];
        let mut column_weights = vec![[0u64; 2]; nx * (ny - y0)];
        for z in z0..nz {
            // The unions over the intervals along z and y.
            let mut layers = vec![0u64; nx * words];
            let mut layer_weights = vec![[0u64; 2]; nx];
            for y in y0..ny {
                for x in 0..nx {
                    let (place, at) = (self.place([x, y, z]), (y - y0) * nx + x);
                    let column = &mut columns[at * words..][..words];
                    if let Some(weight) = self.weights[place] {
                        column_weights[at][0] += 1;
                        column_weights[at][1] += weight;
                        add(column, self.row(place));
                    }
                    let [reached, weight] = column_weights[at];
                    if reached > 0 {
                        layer_weights[x][0] += reached;
                        layer_weights[x][1] += weight;
                        add(&mut layers[x * words..][..words], column);
                    }
                }
                for x0 in 0..nx {
                    let mut row = vec![0u64; words];
                    let mut union = UnionCost::default();
                    for x in x0..nx {
                        let [reached, weight] = layer_weights[x];
                        if reached > 0 {
                            add(&mut row, &layers[x * words..][..words]);
                            union = UnionCost {
                                reached: union.reached + reached,
                                weight: union.weight + weight,
                                ..self.union_cost(&row, needs_bytes)
                            };
                        }
                        let of_cells = FineBox {
                            lo: [x0, y0, z0],
                            hi: [x + 1, y + 1, z + 1],
                        };
                        each(of_cells, union);
                    }
                }
            }
        }
    }

    /// Returns the cost and the bytes of a union.
    fn union_cost(&self, row: &[u64], needs_bytes: bool) -> UnionCost {
        let (counted, coded) = row.split_at(self.counted);
        let coded = if coded.is_empty() { counted } else { coded };
        let bytes = match needs_bytes {
            true => coded_bytes(&runs::from_bits(coded)),
            false => 0,
        };
        let count = |words: &[u64]| words.iter().map(|w| u64::from(w.count_ones())).sum();
        UnionCost {
            reached: 0,
            weight: 0,
            cost: match self.cost {
                CellCost::Bytes => bytes,
                CellCost::Triangles | CellCost::Objects => count(counted),
            },
            bytes,
        }
    }

    fn row(&self, place: usize) -> &[u64] {
        &self.rows[place * self.words..][..self.words]
    }

    /// Returns the place of the cell with this lowest corner.
    fn place_of_corner(&self, min: [f32; 3]) -> usize {
        self.place([0, 1, 2].map(|a: usize| self.planes[a].partition_point(|p| *p < min[a])))
    }

    fn place(&self, [x, y, z]: [usize; 3]) -> usize {
        let [nx, ny, _] = self.grid.cells();
        (z * ny + y) * nx + x
    }

    fn places(&self, of_cells: FineBox) -> impl Iterator<Item = usize> + '_ {
        let along = move |axis: usize| of_cells.lo[axis]..of_cells.hi[axis];
        let row = move |y: usize, z: usize| along(0).map(move |x| self.place([x, y, z]));
        along(2).flat_map(move |z| along(1).flat_map(move |y| row(y, z)))
    }
}

impl BoxCosts {
    /// Finds the tree with the least cost within the budget, among the vertices of the lower convex hull.
    ///
    /// # Errors
    /// The least size of a tree, if every tree is larger than the budget.
    pub fn within_budget(&self) -> Result<CheapestTree, u64> {
        self.search.within(self.limit).map_err(|e| e.least)
    }

    /// Finds the smallest tree, and of these the tree with the least cost.
    pub fn smallest(&self) -> CheapestTree {
        self.search.smallest()
    }
}

/// Returns the leaves of a tree, in its order.
pub fn leaves(tree: &CheapestTree) -> Vec<FineBox> {
    let leaf = |node: &FineNode| match node {
        FineNode::Leaf(leaf) => Some(*leaf),
        FineNode::Split { .. } => None,
    };
    tree.nodes.iter().filter_map(leaf).collect()
}

/// Returns the bounds of the cells of a result.
fn cell_bounds(pvs: &Pvs) -> Vec<[[f32; 3]; 2]> {
    (0..pvs.cells())
        .filter_map(|cell| pvs.cell_bounds(cell))
        .collect()
}

/// Returns the planes of a result's grid along each axis, ascending.
///
/// # Errors
/// [`FineSetsError::NotGrid`] if the cells are not a grid.
pub fn fine_planes(pvs: &Pvs) -> Result<[Vec<f32>; 3], FineSetsError> {
    let cells = cell_bounds(pvs);
    let planes: [Vec<f32>; 3] = [0, 1, 2].map(|axis| {
        let mut planes: Vec<f32> = cells
            .iter()
            .flat_map(|c| [c[0][axis], c[1][axis]])
            .collect();
        planes.sort_unstable_by(f32::total_cmp);
        planes.dedup();
        planes
    });
    let sides = planes.each_ref().map(|planes| planes.len() - 1);
    let count = sides
        .iter()
        .try_fold(1usize, |n, side| n.checked_mul(*side));
    match count == Some(cells.len()) {
        true => Ok(planes),
        false => Err(FineSetsError::NotGrid),
    }
}

/// Returns the weights of the viewpoints in the cells of a result; empty if the result has no such column.
fn result_weights(pvs: &Pvs) -> Result<Vec<u64>, PvsError> {
    let columns = pvs.columns()?.into_iter();
    let weights = columns.filter(|column| column.name == VIEWPOINT_WEIGHT);
    Ok(weights
        .map(|column| column.values)
        .next()
        .unwrap_or_default())
}

fn add(all: &mut [u64], more: &[u64]) {
    all.iter_mut()
        .zip(more)
        .for_each(|(all, more)| *all |= more);
}

/// Sets the bits of the items `ids` in a row.
pub fn set_bits(row: &mut [u64], ids: &[u32]) {
    for id in ids {
        row[(id / 64) as usize] |= 1 << (id % 64);
    }
}
