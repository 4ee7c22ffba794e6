//! Budgets of cells: the view cells with the least expected set for a number of cells or of bytes, tried on
//! the sets of a fine grid.
//!
//! The set of a box of fine cells is the union of their sets. A viewpoint is equally likely in every reached
//! cell of the fine grid, and the expected set is the mean number of items over all viewpoints. The division
//! is a kd-tree over the planes of the fine grid ([`sightline_viewcells::cheapest`]).

use rayon::prelude::*;
use serde::Serialize;
use sightline_pvs::{Granularity, PvsError, coded_bytes, runs};
use sightline_viewcells::cheapest::{BoxCost, CheapestTrees, FineBox, FineGrid, FineNode};

use crate::error::Error;
use crate::observer::Observer;
use crate::result::NamedResult;

/// The memory for the sets of the fine cells that every result may use, in bytes.
const SMALL: u64 = 64 << 20;
/// The largest memory for the sets of the fine cells, in bytes, and as a multiple of the file's length. The
/// header of a small file can name billions of triangles.
const MOST: u64 = 2 << 30;
const MOST_PER_BYTE: u64 = 1000;
/// The largest number of divisions in [`CellDivisions::hull`].
const MOST_DIVISIONS: usize = 16;

/// A limit on the cells of a division.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellBudget {
    /// The largest number of cells with a set.
    Cells(u64),
    /// The largest sum of the sizes of the sets, each coded separately, in bytes.
    Bytes(u64),
}

/// The cost of a cell for a viewpoint in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum CellCost {
    /// The number of triangles of its set.
    Triangles,
    /// The number of objects with a triangle in its set.
    Objects,
    /// The size of its coded set, in bytes.
    Bytes,
}

/// A division of the view box.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CellDivision {
    /// The number of cells with a set.
    pub cells: u64,
    /// The sum of the sizes of the sets, each coded separately, in bytes.
    pub bytes: u64,
    /// The mean cost over all viewpoints.
    pub expected: f64,
}

/// A cell of a division, in world space.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CellOfBudget {
    /// The lowest corner.
    pub min: [f32; 3],
    /// The highest corner.
    pub max: [f32; 3],
    /// The cost of the cell for a viewpoint in it; 0 without viewpoints.
    pub cost: u64,
    /// True if a viewpoint can be in the cell.
    pub reached: bool,
}

/// A division with the least cost for its size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HullPoint {
    /// The number of cells with a set, or the number of bytes of the sets.
    pub size: u64,
    /// The mean cost over all viewpoints.
    pub expected: f64,
}

/// The divisions of a fine grid for a budget.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CellDivisions {
    /// The number of fine cells along x, y and z.
    pub fine: [usize; 3],
    /// The cost of a cell.
    pub cost: CellCost,
    /// The fine grid.
    pub grid: CellDivision,
    /// The division with the least cost within the budget, among the vertices of the convex hull.
    pub chosen: CellDivision,
    /// The cells of the division, in the order of the tree.
    pub boxes: Vec<CellOfBudget>,
    /// Vertices of the lower convex hull of size and cost, at most 16, with ascending sizes.
    pub hull: Vec<HullPoint>,
}

/// Finds the division of a result's grid with the least expected set for a budget.
///
/// ```no_run
/// use sightline::{CellBudget, CellCost, NamedResult, Silent, cell_divisions, open};
///
/// let path = "level.pvs".as_ref();
/// let pvs = open(path)?;
/// let result = NamedResult::new(&pvs, path);
/// let tried = cell_divisions(result, CellBudget::Cells(64), CellCost::Triangles, &Silent)?;
/// println!("{} instead of {}", tried.chosen.expected, tried.grid.expected);
/// # Ok::<(), sightline::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Input`] if the cells of the result are not a grid, are too many, were set aside, or
/// have no viewpoints. [`crate::ErrorKind::Usage`] if no division is within the budget.
/// [`crate::ErrorKind::Cancelled`] if the observer cancels.
pub fn cell_divisions(
    result: NamedResult<'_>,
    budget: CellBudget,
    cost: CellCost,
    observer: &dyn Observer,
) -> Result<CellDivisions, Error> {
    let fine = FineSets::read(result, cost)?;
    let (limit, in_bytes) = match budget {
        CellBudget::Cells(cells) => (cells, false),
        CellBudget::Bytes(bytes) => (bytes, true),
    };
    let search = CheapestTrees::new(fine.grid, fine.costs(in_bytes, observer)?);
    let tree = search.within(limit).map_err(|e| match in_bytes {
        true => Error::usage(format!(
            "every division has sets of at least {} bytes; give this byte budget or a larger one",
            e.least
        ))
        .about("byte-budget"),
        false => Error::usage(format!(
            "every division has at least {} cells; give this cell budget or a larger one",
            e.least
        ))
        .about("cell-budget"),
    })?;
    let leaves: Vec<FineBox> = tree
        .nodes
        .iter()
        .filter_map(|node| match node {
            FineNode::Leaf(leaf) => Some(*leaf),
            FineNode::Split { .. } => None,
        })
        .collect();
    let viewpoints = fine.reached.iter().filter(|reached| **reached).count() as f64;
    Ok(CellDivisions {
        fine: fine.grid.cells(),
        cost,
        grid: fine.division(&fine.cells()),
        chosen: fine.division(&leaves),
        boxes: leaves.iter().map(|leaf| fine.cell(*leaf)).collect(),
        hull: search
            .hull(MOST_DIVISIONS)
            .iter()
            .map(|total| HullPoint {
                size: total.size,
                expected: total.cost as f64 / viewpoints,
            })
            .collect(),
    })
}

/// The sets of the cells of a fine grid, as rows of bits.
struct FineSets {
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
    reached: Vec<bool>,
}

/// The union of the sets of a box, and its numbers.
#[derive(Clone, Copy, Default)]
struct UnionCost {
    /// The number of fine cells with viewpoints.
    viewpoints: u64,
    /// The cost of the union for a viewpoint.
    cost: u64,
    /// The number of bytes of the coded union.
    bytes: u64,
}

impl FineSets {
    fn read(result: NamedResult<'_>, cost: CellCost) -> Result<Self, Error> {
        let pvs = result.pvs;
        let cells: Vec<[[f32; 3]; 2]> = (0..pvs.cells())
            .filter_map(|cell| pvs.cell_bounds(cell))
            .collect();
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
        if sides
            .iter()
            .try_fold(1usize, |n, side| n.checked_mul(*side))
            != Some(cells.len())
        {
            return Err(result.error(
                "the cells are not a grid; bake the scene with --cells NXxNYxNZ for a fine grid",
            ));
        }
        let grid = FineGrid::new(sides).map_err(|e| result.error(e))?;
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
        let [length, ..] = pvs.file_bytes();
        if bytes > MOST.min(SMALL.max(length.saturating_mul(MOST_PER_BYTE))) {
            return Err(result.error(format!(
                "the sets of {} cells need {} MB of memory, which is more than this command uses for the \
                 file; bake the scene with fewer cells",
                cells.len(),
                bytes / 1_000_000
            )));
        }
        let mut rows = Vec::new();
        rows.try_reserve_exact(words * cells.len())
            .map_err(Error::internal)?;
        rows.resize(words * cells.len(), 0);
        let mut sets = Self {
            grid,
            planes,
            cost,
            counted,
            words,
            rows,
            reached: vec![false; cells.len()],
        };
        let unreadable = |e: PvsError| match e {
            PvsError::Memory { .. } => Error::internal(e),
            e => result.error(e),
        };
        let mut ids = Vec::new();
        for (number, bounds) in (0..).zip(&cells) {
            if pvs.is_set_aside(number).map_err(unreadable)? {
                return Err(result.error(format!(
                    "cell {number} was set aside, so its set contains all triangles; bake the scene again \
                     or retry the job"
                )));
            }
            if !pvs.is_reached(number).map_err(unreadable)? {
                continue;
            }
            let place = sets.place(bounds[0]);
            sets.reached[place] = true;
            let row = &mut sets.rows[place * words..][..words];
            let (counted, coded) = row.split_at_mut(counted);
            match cost {
                CellCost::Triangles => pvs.visible_bits(number, counted).map_err(unreadable)?,
                CellCost::Objects => {
                    pvs.visible_objects(number, &mut ids).map_err(unreadable)?;
                    set_bits(counted, &ids);
                }
                CellCost::Bytes => {}
            }
            if coded.is_empty() {
                continue;
            }
            if names_triangles {
                pvs.visible_bits(number, coded).map_err(unreadable)?;
            } else {
                pvs.visible_items(number, &mut ids).map_err(unreadable)?;
                set_bits(coded, &ids);
            }
        }
        if !sets.reached.contains(&true) {
            return Err(
                result.error("no cell has viewpoints; bake the scene with other viewpoints")
            );
        }
        Ok(sets)
    }

    /// Returns the place of the cell with this lowest corner.
    fn place(&self, min: [f32; 3]) -> usize {
        let [x, y, z] = [0, 1, 2].map(|a: usize| self.planes[a].partition_point(|p| *p < min[a]));
        self.place_of([x, y, z])
    }

    fn place_of(&self, [x, y, z]: [usize; 3]) -> usize {
        let [nx, ny, _] = self.grid.cells();
        (z * ny + y) * nx + x
    }

    /// Returns the cells of the grid as boxes.
    fn cells(&self) -> Vec<FineBox> {
        let mut cells = Vec::new();
        self.grid.each(|of_cells| {
            if (0..3).all(|a| of_cells.hi[a] == of_cells.lo[a] + 1) {
                cells.push(of_cells);
            }
        });
        cells
    }

    /// Returns the costs of all boxes in the order of their numbers. Sizes are bytes if `in_bytes` is true,
    /// and numbers of cells otherwise.
    fn costs(&self, in_bytes: bool, observer: &dyn Observer) -> Result<Vec<BoxCost>, Error> {
        let needs_bytes = in_bytes || self.cost == CellCost::Bytes;
        let [_, ny, nz] = self.grid.cells();
        let parts: Vec<Vec<(usize, BoxCost)>> = (0..ny * nz)
            .into_par_iter()
            .map(|low| {
                if observer.is_cancelled() {
                    return Err(Error::cancelled("the search for cells was cancelled"));
                }
                let mut found = Vec::new();
                self.each_union_from([low % ny, low / ny], needs_bytes, |of_cells, union| {
                    if union.viewpoints > 0 {
                        let cost = BoxCost {
                            cost: union.viewpoints * union.cost,
                            size: if in_bytes { union.bytes } else { 1 },
                        };
                        found.push((self.grid.number(of_cells), cost));
                    }
                });
                Ok(found)
            })
            .collect::<Result<_, Error>>()?;
        let mut costs = vec![BoxCost::default(); self.grid.boxes()];
        for (number, cost) in parts.into_iter().flatten() {
            costs[number] = cost;
        }
        Ok(costs)
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
        // The unions over the interval along z, of each column of cells along z.
        let mut columns = vec![0u64; nx * (ny - y0) * words];
        let mut column_viewpoints = vec![0u64; nx * (ny - y0)];
        for z in z0..nz {
            // The unions over the intervals along z and y.
            let mut layers = vec![0u64; nx * words];
            let mut layer_viewpoints = vec![0u64; nx];
            for y in y0..ny {
                for x in 0..nx {
                    let (place, at) = (self.place_of([x, y, z]), (y - y0) * nx + x);
                    let column = &mut columns[at * words..][..words];
                    if self.reached[place] {
                        column_viewpoints[at] += 1;
                        add(column, self.row(place));
                    }
                    if column_viewpoints[at] > 0 {
                        layer_viewpoints[x] += column_viewpoints[at];
                        add(&mut layers[x * words..][..words], column);
                    }
                }
                for x0 in 0..nx {
                    let mut row = vec![0u64; words];
                    let mut union = UnionCost::default();
                    for x in x0..nx {
                        if layer_viewpoints[x] > 0 {
                            add(&mut row, &layers[x * words..][..words]);
                            union = UnionCost {
                                viewpoints: union.viewpoints + layer_viewpoints[x],
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

    fn row(&self, place: usize) -> &[u64] {
        &self.rows[place * self.words..][..self.words]
    }

    /// Returns the numbers of a union, without its viewpoints.
    fn union_cost(&self, row: &[u64], needs_bytes: bool) -> UnionCost {
        let (counted, coded) = row.split_at(self.counted);
        let coded = if coded.is_empty() { counted } else { coded };
        let bytes = match needs_bytes {
            true => coded_bytes(&runs::from_bits(coded)),
            false => 0,
        };
        let cost = match self.cost {
            CellCost::Bytes => bytes,
            _ => counted
                .iter()
                .map(|word| u64::from(word.count_ones()))
                .sum(),
        };
        UnionCost {
            viewpoints: 0,
            cost,
            bytes,
        }
    }

    /// Returns the union of a box of cells.
    fn union(&self, of_cells: FineBox) -> UnionCost {
        let mut row = vec![0; self.words];
        let mut viewpoints = 0;
        for z in of_cells.lo[2]..of_cells.hi[2] {
            for y in of_cells.lo[1]..of_cells.hi[1] {
                for x in of_cells.lo[0]..of_cells.hi[0] {
                    let place = self.place_of([x, y, z]);
                    if self.reached[place] {
                        viewpoints += 1;
                        add(&mut row, self.row(place));
                    }
                }
            }
        }
        UnionCost {
            viewpoints,
            ..self.union_cost(&row, true)
        }
    }

    fn division(&self, cells: &[FineBox]) -> CellDivision {
        let unions: Vec<UnionCost> = cells.par_iter().map(|cell| self.union(*cell)).collect();
        let reached = || unions.iter().filter(|union| union.viewpoints > 0);
        let viewpoints: u64 = reached().map(|union| union.viewpoints).sum();
        let cost: u64 = reached().map(|union| union.viewpoints * union.cost).sum();
        CellDivision {
            cells: reached().count() as u64,
            bytes: reached().map(|union| union.bytes).sum(),
            expected: cost as f64 / viewpoints as f64,
        }
    }

    fn cell(&self, of_cells: FineBox) -> CellOfBudget {
        let union = self.union(of_cells);
        let corner = |at: [usize; 3]| [0, 1, 2].map(|a: usize| self.planes[a][at[a]]);
        CellOfBudget {
            min: corner(of_cells.lo),
            max: corner(of_cells.hi),
            cost: if union.viewpoints > 0 { union.cost } else { 0 },
            reached: union.viewpoints > 0,
        }
    }
}

fn add(all: &mut [u64], more: &[u64]) {
    all.iter_mut()
        .zip(more)
        .for_each(|(all, more)| *all |= more);
}

fn set_bits(row: &mut [u64], ids: &[u32]) {
    for id in ids {
        row[(id / 64) as usize] |= 1 << (id % 64);
    }
}
