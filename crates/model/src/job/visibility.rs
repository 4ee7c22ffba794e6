//! The task of visibility: the visible set of each view cell, by one of several methods.

use sightline_numbers::Aabb;
use sightline_viewcells::{CellBox, Division, Lattice, Plan, USUAL_BLOCK_CELLS};

use super::CellsByCost;
use super::cells::{AnyCells, Cells, KnownCells, MOST_LINE_DEPTH, Viewpoints, marks};
use super::names::{CellToCell, Completion, Effort, Granularity, MethodName, Up};
use super::numbers::{Length, TimeBudget};
use super::sampler::{Sampler, Sampling};

/// Maximum number of cells for which a job computes pairs of cells by default: the cells of a default tile.
/// With several tiles, the lines of each tile cross the whole division once more.
const FEW_PAIR_CELLS: u64 = USUAL_BLOCK_CELLS as u64;

/// A computation of the visible sets of view cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Visibility {
    /// The method.
    pub method: Method,
    /// The distance from the viewpoint at which sight lines end, in the scene's units; `None` for unlimited
    /// sight.
    pub far: Option<Length>,
    /// The option to list the pairs of cells that see each other.
    pub pairs: CellToCell,
    /// The seed of all random numbers.
    pub seed: u64,
    /// The axis that points up, if it is known. The axis does not affect the sets.
    pub up: Option<Up>,
}

/// The method by which visibility is decided.
#[derive(Clone, Debug, PartialEq)]
pub enum Method {
    /// Sampling without queries. A triangle in the set was seen or, with completion, is undecided. A triangle
    /// outside the set may be visible.
    Aggressive {
        /// The sampling of the cells.
        sampling: Sampling,
        /// The items that the sets list.
        items: Granularity,
        /// The completion of the sets. Only the sampler lines completes sets.
        completion: Completion,
    },
    /// Sampling, then exact queries for every triangle that sampling did not show.
    Exact {
        /// The sampling of the cells.
        sampling: Sampling,
        /// The limits of a single query.
        effort: Effort,
        /// True if witnesses and certificates are stored.
        certificates: bool,
    },
    /// Portals between the parts of the scene, without sampling. A triangle that no line through portals
    /// reaches is hidden; any other triangle without a witness is undecided.
    Portals {
        /// The cells.
        cells: KnownCells,
        /// The duration from submission until the work stops; `None` for unlimited time.
        time: Option<TimeBudget>,
    },
}

impl Method {
    /// Creates the method `aggressive`, with sets of triangles.
    pub fn aggressive(sampling: Sampling) -> Self {
        Self::Aggressive {
            sampling,
            items: Granularity::Triangles,
            completion: Completion::default(),
        }
    }

    /// Creates an exact method without certificates.
    pub fn exact(sampling: Sampling, effort: Effort) -> Self {
        Self::Exact {
            sampling,
            effort,
            certificates: false,
        }
    }

    /// Creates the method `portals` without a time budget.
    pub fn portals(cells: KnownCells) -> Self {
        Self::Portals { cells, time: None }
    }

    /// Returns the method's name.
    pub fn name(&self) -> MethodName {
        match self {
            Self::Aggressive { .. } => MethodName::Aggressive,
            Self::Exact {
                effort: Effort::Full,
                ..
            } => MethodName::Exact,
            Self::Exact {
                effort: Effort::Bounded,
                ..
            } => MethodName::Verified,
            Self::Portals { .. } => MethodName::Portals,
        }
    }

    fn any_cells(&self) -> &dyn AnyCells {
        match self {
            Self::Aggressive { sampling, .. } | Self::Exact { sampling, .. } => {
                sampling.sampler.cells()
            }
            Self::Portals { cells, .. } => cells,
        }
    }
}

impl From<Method> for Visibility {
    /// Creates the task of this method, with the defaults of all other values.
    fn from(method: Method) -> Self {
        Self {
            method,
            far: None,
            pairs: CellToCell::default(),
            seed: 0,
            up: None,
        }
    }
}

impl Visibility {
    /// Returns the view box with its division.
    pub fn cells(&self) -> &Cells {
        self.method.any_cells().cells()
    }

    /// Returns the view box, which contains all viewpoints, in world space.
    pub fn view_box(&self) -> Aabb {
        self.cells().view_box()
    }

    /// Returns the division of the view box.
    pub fn division(&self) -> &Division {
        self.cells().division()
    }

    /// Returns the lattice of sample positions.
    pub fn lattice(&self) -> &Lattice {
        self.cells().lattice()
    }

    /// Returns the parts of the view box that contain viewpoints.
    pub fn viewpoints(&self) -> &Viewpoints {
        self.method.any_cells().viewpoints()
    }

    /// Returns the choice of view cells among the boxes of the grid's cells. `None` if the cells of the
    /// division are the view cells.
    pub fn cells_by_cost(&self) -> Option<&CellsByCost> {
        self.method.any_cells().cells_by_cost()
    }

    /// Returns the sampling, or `None` for the method portals.
    pub fn sampling(&self) -> Option<&Sampling> {
        match &self.method {
            Method::Aggressive { sampling, .. } | Method::Exact { sampling, .. } => Some(sampling),
            Method::Portals { .. } => None,
        }
    }

    /// Returns the time budget, or `None` for unlimited time.
    pub fn time_budget(&self) -> Option<TimeBudget> {
        match &self.method {
            Method::Aggressive { sampling, .. } | Method::Exact { sampling, .. } => {
                sampling.sampler.time()
            }
            Method::Portals { time, .. } => *time,
        }
    }

    /// Returns the items that the sets list.
    pub fn items(&self) -> Granularity {
        match self.method {
            Method::Aggressive { items, .. } => items,
            Method::Exact { .. } | Method::Portals { .. } => Granularity::Triangles,
        }
    }

    /// Returns true if sets also contain likely items that no sight line met, as undecided items.
    pub fn is_completed(&self) -> bool {
        match &self.method {
            Method::Aggressive {
                sampling,
                completion,
                ..
            } => {
                let is_lines = matches!(sampling.sampler, Sampler::Lines { .. });
                // Items above the minimum share are found, and two seeds agree on them. Likely items depend
                // on the seed.
                let has_share = sampling.sampler.min_share().is_some();
                *completion == Completion::Auto && is_lines && !has_share
            }
            Method::Exact { .. } | Method::Portals { .. } => false,
        }
    }

    /// Returns true if every triangle is visible with a witness, hidden, or undecided. This is the case for
    /// every method except aggressive.
    pub fn is_decided(&self) -> bool {
        !matches!(self.method, Method::Aggressive { .. })
    }

    /// Returns true if witnesses and certificates are stored.
    pub fn has_certificates(&self) -> bool {
        matches!(
            self.method,
            Method::Exact {
                certificates: true,
                ..
            }
        )
    }

    /// Returns true if the bake measures the contribution of each visible item.
    pub fn has_contributions(&self) -> bool {
        self.sampling()
            .is_some_and(|sampling| sampling.contributions)
    }

    /// Returns true if the result contains the scene's division along its walls, for queries from a point.
    ///
    /// This is the case for the method portals, and for exact methods if walls enclose the viewpoints. The
    /// division is in the output of the first tile.
    pub fn has_portals(&self) -> bool {
        match self.method {
            Method::Portals { .. } => true,
            Method::Exact { .. } => self.viewpoints().region().is_some(),
            Method::Aggressive { .. } => false,
        }
    }

    /// Returns the marked parts of a cell that is known before the bake. A bit is set for each part that
    /// contains viewpoints.
    pub fn marks(&self, cell: &CellBox) -> u64 {
        marks(self.cells(), self.viewpoints(), cell)
    }

    /// Returns the grid of the pairs in a tile's output, or `None` for a job without pairs.
    ///
    /// The grid is the number of cells of the view box along each axis. An adaptive tree has a grid of the
    /// cells of its deepest level, at most [`MOST_LINE_DEPTH`]. A cell of the tree contains whole cells of
    /// the grid. If the tree is deeper, a cell of the grid contains several cells of the tree.
    pub fn pair_cells(&self) -> Option<[u32; 3]> {
        let few = |sides: &[u32; 3]| count(*sides) <= FEW_PAIR_CELLS;
        match self.pairs {
            CellToCell::Auto => self.pair_grid().filter(few),
            CellToCell::On => self.pair_grid(),
            CellToCell::Off => None,
        }
    }

    /// Returns the grid over whose cells pairs can be listed, or `None` for boxes and portals.
    pub(super) fn pair_grid(&self) -> Option<[u32; 3]> {
        if let Method::Portals { .. } = self.method {
            return None;
        }
        match *self.division() {
            Division::Grid(cells) => Some(cells),
            Division::Tree(_) => None,
            Division::Adaptive { max_depth, .. } => {
                // An adaptive tree halves the longest side.
                let Aabb { min, max } = self.view_box();
                let size = [0, 1, 2].map(|a| f64::from(max[a]) - f64::from(min[a]));
                let mut cells = [1u32; 3];
                for _ in 0..max_depth.min(MOST_LINE_DEPTH) {
                    let side = |a: usize| size[a] / f64::from(cells[a]);
                    let longer = |longest, a| if side(a) > side(longest) { a } else { longest };
                    let axis = (1..3).fold(0, longer);
                    cells[axis] *= 2;
                }
                Some(cells)
            }
        }
    }

    /// Returns the maximum displacement of a sight line by rounding to single precision, as a fraction of the
    /// thinnest view cell.
    ///
    /// The fraction is 0 except for the method aggressive with the sampler `lines`. Exact queries find the
    /// triangles that sampling misses.
    ///
    /// # Errors
    /// [`DivisionError`](sightline_viewcells::DivisionError) if the cells are thinner than the rounding.
    pub fn rounding_displacement(&self) -> Result<f64, sightline_viewcells::DivisionError> {
        match &self.method {
            Method::Aggressive { sampling, .. }
                if matches!(sampling.sampler, Sampler::Lines { .. }) =>
            {
                self.division().rounding_displacement(self.lattice())
            }
            _ => Ok(0.0),
        }
    }

    /// Returns the plan of tiles.
    pub(super) fn plan(&self) -> Plan {
        let layout = self.method.any_cells().layout();
        Plan::new(self.division(), self.lattice(), layout)
    }
}

/// Returns the number of cells of a grid, which a division has checked.
pub(super) fn count(sides: [u32; 3]) -> u64 {
    sides.map(u64::from).iter().product()
}
