//! The creation of a job's cells from its options and a scene.

use std::sync::Arc;

use sightline_model::numbers::{TileCells, TriangleBudget};
use sightline_model::{
    Adaptive, BoxCells, CellBudget, CellsByCost, CubeGrid, GridCells, KnownCells, SpecError,
    USUAL_GRID, Viewpoints,
};
use sightline_scene::{Aabb, Scene, Triangle};
use sightline_viewcells::cheapest::FineGrid;
use sightline_viewcells::{DivisionError, KdTree, Lattice, axis_name};

use super::cells::Cells;
use super::job_options::JobOptions;
use crate::error::Error;
use crate::observer::Observer;
use crate::viewpoints::read_viewpoints;
use crate::viewpoints::weights::{cell_weights, grid_planes};

/// Returns the numbers of cells along x, y and z: the smallest numbers for which the sides of a cell are at
/// most `size`.
fn cells_of_size(view_box: Aabb, size: f64) -> [u32; 3] {
    // The cast saturates, and a grid that is too fine is rejected later with its numbers.
    (view_box.max.as_dvec3() - view_box.min.as_dvec3())
        .to_array()
        .map(|extent| ((extent / size).ceil() as u32).max(1))
}

/// The number of fine cells for each cell of a budget, and the least and the largest numbers of fine cells.
const FINE_PER_CELL: u64 = 8;
const LEAST_FINE: u64 = 512;
const MOST_FINE: u64 = 1728;
/// The number of fine cells if viewpoints reach only a part of the view box. Cells without viewpoints are not
/// sampled.
const FINE_IN_PART: u64 = 4096;

/// Returns the default fine grid, whose cells are approximately cubes. If viewpoints are everywhere, the grid
/// has eight cells for each cell of the budget, at least 512 and at most 1728.
fn usual_fine_cells(view_box: Aabb, budget: CellBudget, is_restricted: bool) -> [u32; 3] {
    let wanted = match budget {
        _ if is_restricted => FINE_IN_PART,
        CellBudget::Cells(cells) => (cells.get() * FINE_PER_CELL).clamp(LEAST_FINE, MOST_FINE),
        CellBudget::Bytes(_) => MOST_FINE,
    };
    let extents = (view_box.max.as_dvec3() - view_box.min.as_dvec3()).to_array();
    let mut sides = [1u32; 3];
    // The axis with the longest cells gets another cell, while the grid has fewer cells than wanted.
    loop {
        let length = |axis: usize| extents[axis] / f64::from(sides[axis]);
        let mut longest = 0;
        for axis in 1..3 {
            if length(axis) > length(longest) {
                longest = axis;
            }
        }
        let mut finer = sides;
        finer[longest] += 1;
        let count: u64 = finer.map(u64::from).iter().product();
        if count > wanted || FineGrid::new(finer.map(|side| side as usize)).is_err() {
            return sides;
        }
        sides = finer;
    }
}

/// A maker of a job's cells from its options.
pub(super) struct CellMaker<'a> {
    pub(super) options: &'a JobOptions,
    pub(super) scene: &'a Arc<Scene>,
    pub(super) view_box: Aabb,
    /// True if the cells serve only to check the job: boxes along walls are a single box, and viewpoints are
    /// everywhere.
    pub(super) is_trial: bool,
    pub(super) observer: &'a dyn Observer,
}

impl CellMaker<'_> {
    /// Creates the cells that are known before the bake.
    pub(super) fn known(&self, tile_cells: TileCells) -> Result<KnownCells, Error> {
        if let Some(Cells::Walls(most)) = self.options.cells {
            let boxes = match self.is_trial {
                true => self.one_box()?,
                false => self.options.viewpoints.along_walls(
                    self.scene,
                    self.view_box,
                    most,
                    self.observer,
                )?,
            };
            return Ok(KnownCells::Boxes(boxes));
        }
        let grid = GridCells::new(self.view_box, self.sides()?).map_err(|e| self.explain(e))?;
        let grid = grid.with_tile_cells(tile_cells)?;
        // Proofs apply to whole cells, so walls do not restrict viewpoints with certificates.
        let walls = !self.options.certificates;
        let viewpoints = self.viewpoints(grid.sides(), grid.cells().lattice(), walls)?;
        let by_cost = self.by_cost(grid.sides(), grid.cells().lattice(), &viewpoints)?;
        let grid = grid.with_viewpoints(viewpoints)?;
        Ok(grid.with_cells_by_cost(by_cost).map(KnownCells::Grid)?)
    }

    /// Creates cells with the view box as a single box.
    fn one_box(&self) -> Result<BoxCells, Error> {
        let tree = KdTree::new(&[3], &[]).map_err(Error::internal)?;
        BoxCells::new(self.view_box, Arc::new(tree)).map_err(|e| self.explain(e))
    }

    /// Creates the grid of visibility cubes. Cubes are at the points of the lattice and have no region.
    pub(super) fn cube_grid(&self) -> Result<CubeGrid, Error> {
        let grid = CubeGrid::new(self.view_box, self.sides()?).map_err(|e| self.explain(e))?;
        let viewpoints = self.viewpoints(grid.sides(), grid.cells().lattice(), false)?;
        let by_cost = self.by_cost(grid.sides(), grid.cells().lattice(), &viewpoints)?;
        let grid = match viewpoints.mask() {
            Some(mask) => grid.with_mask(Arc::clone(mask))?,
            None => grid,
        };
        Ok(grid.with_cells_by_cost(by_cost)?)
    }

    /// Creates the cells of an adaptive tree.
    pub(super) fn adaptive<const DEPTH: u32>(&self, budget: u32) -> Result<Adaptive<DEPTH>, Error> {
        if self.options.viewpoints.restrict() {
            return Err(Error::usage(
                "several view boxes, --view-mesh, --viewpoints and --reachable-from need a grid of cells; \
                 give --cells or --cell-size in place of --triangle-budget",
            )
            .about("triangle-budget"));
        }
        let budget = TriangleBudget::new(budget)?;
        let tree = Adaptive::new(self.view_box, budget, self.options.max_depth());
        tree.map_err(|e| match e {
            SpecError::Division(e) => self.explain(e),
            e => e.into(),
        })
    }

    /// Returns the choice of cells by cost; `None` without a budget.
    fn by_cost(
        &self,
        cells: [u32; 3],
        lattice: &Lattice,
        viewpoints: &Viewpoints,
    ) -> Result<Option<CellsByCost>, Error> {
        let Some(choice) = self.options.by_cost.choice()? else {
            return Ok(None);
        };
        let options = &self.options.viewpoints;
        let Some(file) = options.viewpoints.as_ref().filter(|_| !self.is_trial) else {
            return Ok(Some(choice));
        };
        let points = read_viewpoints(file)?;
        let planes = grid_planes(lattice, cells);
        let mask = viewpoints.mask().map(|mask| &**mask);
        let Some(weights) = cell_weights(&points, &planes, mask) else {
            return Err(Error::input(format!(
                "{}: no viewpoint is in a cell that the options allow; give other viewpoints or fewer of \
                 --view-box, --view-mesh and --reachable-from",
                file.display()
            ))
            .about("viewpoints"));
        };
        Ok(Some(choice.with_weights(weights)?))
    }

    /// Returns the number of cells of the grid along each axis.
    fn sides(&self) -> Result<[u32; 3], Error> {
        if let Some(choice) = self.options.by_cost.choice()? {
            let is_restricted = self.options.viewpoints.restrict();
            let usual = || usual_fine_cells(self.view_box, choice.budget(), is_restricted);
            return Ok(self.options.by_cost.fine.unwrap_or_else(usual));
        }
        Ok(match (self.options.cell_size, self.options.cells) {
            (Some(size), _) if size.is_finite() && size > 0.0 => cells_of_size(self.view_box, size),
            (Some(size), _) => {
                let text = format!(
                    "--cell-size {size} is not a length; give a number above 0, such as \
                 2.5"
                );
                return Err(Error::usage(text).about("cell-size"));
            }
            (None, Some(Cells::Grid(cells))) => cells,
            (None, Some(Cells::Walls(_)) | None) => USUAL_GRID,
        })
    }

    fn viewpoints(
        &self,
        cells: [u32; 3],
        lattice: &Lattice,
        walls: bool,
    ) -> Result<Viewpoints, Error> {
        if self.is_trial {
            return Ok(Viewpoints::Everywhere);
        }
        let options = &self.options.viewpoints;
        options.viewpoints(self.scene, cells, lattice, walls, self.observer)
    }

    /// Converts the error of a view box that cannot be divided. If the user gave no view box, the error names
    /// the file that the box came from.
    fn explain(&self, e: DivisionError) -> Error {
        let places = &self.options.viewpoints;
        let (DivisionError::Box { axis, .. }, None) = (&e, places.view_box.first()) else {
            return SpecError::from(e).into();
        };
        let along = axis_name(*axis);
        if let Some(mesh) = &places.view_mesh {
            return Error::input(format!(
                "{}: the box around all viewpoints has no extent along {along}, so it cannot be a view \
                 box; give --view-box, and for a navigation mesh --eye-heights LO,HI with LO < HI and --up",
                mesh.display()
            ))
            .about("view-mesh");
        }
        let nothing = self.scene.triangles().iter().all(Triangle::is_degenerate);
        Error::scene(format!(
            "{}, so its bounds cannot be a view box; give --view-box x0,y0,z0,x1,y1,z1 with x0 < \
             x1, y0 < y1 and z0 < z1",
            if nothing {
                "none of the triangles of the scene has an area".to_owned()
            } else {
                format!("the scene is flat along {along}")
            }
        ))
        .about("view-box")
    }
}
