//! The combinations that a job can express and that are not built. A feature that builds one deletes its row.

use sightline_viewcells::Division;

use super::SpecError;
use super::names::CellToCell;
use super::visibility::{Visibility, count};
use crate::output::pairs::MOST_PAIR_CELLS;

/// Checks a task against the combinations that are built.
///
/// # Errors
/// [`SpecError`] for the first combination that is not.
pub(super) fn check(task: &Visibility) -> Result<(), SpecError> {
    certificates(task)?;
    pairs(task)
}

/// Certificates are about whole closed cells of unlimited sight.
fn certificates(task: &Visibility) -> Result<(), SpecError> {
    let about = [
        (
            matches!(task.division(), Division::Tree(_)),
            "boxes along walls",
        ),
        (
            task.viewpoints().region().is_some(),
            "viewpoints in a region",
        ),
        (task.far.is_some(), "far"),
    ];
    let first = about.iter().find(|(is_given, _)| *is_given);
    match first {
        Some((_, what)) if task.has_certificates() => {
            Err(SpecError::combination("certificates", what))
        }
        _ => Ok(()),
    }
}

/// Pairs of cells exist for cells of equal size, up to a number of cells.
fn pairs(task: &Visibility) -> Result<(), SpecError> {
    if task.pairs != CellToCell::On {
        return Ok(());
    }
    match task.pair_grid().map(count) {
        None => Err(SpecError::combination(
            "cell-to-cell",
            "boxes along walls, or portals",
        )),
        Some(cells) if cells > MOST_PAIR_CELLS => Err(SpecError::new(
            "cell-to-cell",
            "at most 32768 cells can have it; give fewer cells, or off",
        )),
        Some(_) => Ok(()),
    }
}
