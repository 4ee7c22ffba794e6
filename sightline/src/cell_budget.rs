//! Cells by cost on a result: the view cells with the least expected set for a number of cells or of bytes.
//!
//! The set of a box of fine cells is the union of their sets. The weight of a fine cell is the number of its
//! parts that contain viewpoints, unless the result has other weights. The expected set is the weighted mean
//! of the sizes of the sets. The division is a kd-tree over the planes of the fine grid
//! ([`sightline_viewcells::cheapest`]).

use std::path::Path;

use serde::Serialize;
use sightline_assemble::{
    CellDivision, ChosenCells, FineSets, FineSetsError, fine_planes, leaves, write_cells_by_cost,
};
use sightline_model::{CellBudget, CellCost, CellsByCost};
use sightline_pvs::{Pvs, PvsError};
use sightline_viewcells::cheapest::FineBox;

use crate::error::Error;
use crate::observer::{Observer, warn};
use crate::output::{Format, Output};
use crate::result::{NamedResult, open};
use crate::viewpoints::read_viewpoints;
use crate::viewpoints::weights::cell_weights;

/// The memory for the sets of the fine cells that every result may use, in bytes.
const SMALL: u64 = 64 << 20;
/// The largest memory for the sets of the fine cells, in bytes, and as a multiple of the file's length. The
/// header of a small file can name billions of triangles.
const MOST: u64 = sightline_model::MOST_FINE_BYTES;
const MOST_PER_BYTE: u64 = 1000;

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
    /// Divisions at vertices of the lower convex hull of size and cost, at most 16, with ascending sizes.
    pub hull: Vec<CellDivision>,
}

/// Finds the division of a result's grid with the least expected set for a budget.
///
/// ```no_run
/// use sightline::numbers::CellCount;
/// use sightline::{CellBudget, CellCost, NamedResult, Silent, cell_divisions, open};
///
/// let path = "level.pvs".as_ref();
/// let pvs = open(path)?;
/// let result = NamedResult::new(&pvs, path);
/// let budget = CellBudget::Cells(CellCount::new(64)?);
/// let tried = cell_divisions(result, budget, CellCost::Triangles, &Silent)?;
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
    refuse_set_aside(result)?;
    let failed = |e| of_result(result, e);
    let sets = FineSets::read(result.pvs, cost, &[], most_bytes(result.pvs)).map_err(failed)?;
    let costs = sets
        .costs(budget, &|| observer.is_cancelled())
        .map_err(failed)?;
    let tree = costs
        .within_budget()
        .map_err(|least| too_small(budget, least))?;
    let leaves = leaves(&tree);
    Ok(CellDivisions {
        fine: sets.grid().cells(),
        cost,
        grid: sets.division(&sets.cells()),
        chosen: sets.division(&leaves),
        boxes: leaves.iter().map(|leaf| cell(&sets, *leaf)).collect(),
        hull: sets.hull(&costs),
    })
}

/// Writes the result of the cells by cost of a fine result, without another bake, and opens it. A file of
/// viewpoints gives the weights of the fine cells.
///
/// ```no_run
/// use sightline::numbers::CellCount;
/// use sightline::{CellBudget, CellCost, CellsByCost, NamedResult, Silent, open, unite_cells};
///
/// let path = "fine.pvs".as_ref();
/// let fine = open(path)?;
/// let budget = CellBudget::Cells(CellCount::new(64)?);
/// let choice = CellsByCost::new(budget, CellCost::Triangles);
/// let pvs = unite_cells(NamedResult::new(&fine, path), &choice, None, "level.pvs".as_ref(), &Silent)?;
/// println!("{} cells", pvs.cells());
/// # Ok::<(), sightline::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Input`] if the cells of the result are not a grid, are too many, were set aside, or
/// have no viewpoints, or if the result has contributions or certificates. [`crate::ErrorKind::Usage`] if the
/// output cannot be written.
pub fn unite_cells(
    fine: NamedResult<'_>,
    choice: &CellsByCost,
    viewpoints: Option<&Path>,
    output: &Path,
    observer: &dyn Observer,
) -> Result<Pvs, Error> {
    refuse_set_aside(fine)?;
    let pvs = fine.pvs;
    if pvs.has_contributions() || pvs.certificate(0)?.is_some() {
        return Err(fine.error(
            "cells by cost have no contributions and no certificates; bake the fine grid without these \
             options",
        ));
    }
    let mut choice = choice.clone();
    if let Some(file) = viewpoints {
        let planes = fine_planes(pvs).map_err(|e| of_result(fine, e))?;
        let weights = cell_weights(&read_viewpoints(file)?, &planes, None).ok_or_else(|| {
            Error::input(format!(
                "{}: no viewpoint is in the view box of {}; give other viewpoints",
                file.display(),
                fine.name.display()
            ))
        })?;
        choice = choice.with_weights(weights)?;
    }
    let output = Output::check(output, Format::Pvs, Some(fine.name))?;
    let digest = blake3::hash(pvs.bytes()).to_hex();
    let mut chosen = None;
    output.write(|mut out| {
        let written = write_cells_by_cost(pvs, &choice, most_bytes(pvs), Some(&digest), &mut out);
        chosen = Some(written.map_err(|e| of_result(fine, e))?);
        Ok(())
    })?;
    if let Some(ChosenCells {
        least: Some(least), ..
    }) = chosen
    {
        warn(observer, too_small(choice.budget(), least).to_string());
    }
    open(output.path())
}

/// Rejects a result with cells that were set aside.
fn refuse_set_aside(result: NamedResult<'_>) -> Result<(), Error> {
    for cell in 0..result.pvs.cells() {
        if result.pvs.is_set_aside(cell).map_err(|e| result.error(e))? {
            return Err(result.error(format!(
                "cell {cell} was set aside, so its set contains all triangles; bake the scene again or retry \
                 the job"
            )));
        }
    }
    Ok(())
}

/// Returns the largest memory for the sets of the fine cells of a result, in bytes.
fn most_bytes(pvs: &Pvs) -> u64 {
    let [length, ..] = pvs.file_bytes();
    MOST.min(SMALL.max(length.saturating_mul(MOST_PER_BYTE)))
}

fn of_result(result: NamedResult<'_>, e: FineSetsError) -> Error {
    match e {
        FineSetsError::Cancelled => Error::cancelled(e.to_string()),
        FineSetsError::Allocation(_) | FineSetsError::Pvs(PvsError::Memory { .. }) => {
            Error::internal(e)
        }
        e => result.error(e),
    }
}

/// Creates the error of a budget below the size of every division.
pub(crate) fn too_small(budget: CellBudget, least: u64) -> Error {
    match budget {
        CellBudget::Bytes(_) => Error::usage(format!(
            "every division has sets of at least {least} bytes; give this byte budget or a larger one"
        ))
        .about("byte-budget"),
        CellBudget::Cells(_) => Error::usage(format!(
            "every division has at least {least} cells; give this cell budget or a larger one"
        ))
        .about("cell-budget"),
    }
}

fn cell(sets: &FineSets, of_cells: FineBox) -> CellOfBudget {
    let union = sets.union(of_cells);
    let corner = |at: [usize; 3]| [0, 1, 2].map(|axis: usize| sets.plane(axis, at[axis]));
    CellOfBudget {
        min: corner(of_cells.lo),
        max: corner(of_cells.hi),
        cost: union.cost,
        reached: union.reached > 0,
    }
}
