//! The combinations that a job can express but that are not implemented. A change that implements a
//! combination deletes the combination here.

use sightline_viewcells::Division;

use super::SpecError;
use super::names::CellToCell;
use super::sampler::{LineAim, Sampler, Stop};
use super::visibility::{Visibility, count};
use crate::output::pairs::MOST_PAIR_CELLS;

/// Checks that a task is a combination that is implemented.
///
/// # Errors
/// [`SpecError`] for the first combination that is not implemented.
pub(super) fn check(task: &Visibility) -> Result<(), SpecError> {
    certificates(task)?;
    cells_by_cost(task)?;
    pairs(task)
}

/// Checks that cells by cost are combined only with values that a union of sets has.
fn cells_by_cost(task: &Visibility) -> Result<(), SpecError> {
    if task.cells_by_cost().is_none() {
        return Ok(());
    }
    let is_bounded = task.sampling().is_some_and(|sampling| {
        matches!(
            &sampling.sampler,
            Sampler::Lines {
                aim: LineAim::Known {
                    stop: Stop::Bound(_),
                    ..
                },
                ..
            }
        )
    });
    let options = [
        ("certificates", task.has_certificates()),
        ("contributions", task.has_contributions()),
        ("max-error", is_bounded),
    ];
    match options.into_iter().find(|(_, is_given)| *is_given) {
        Some((option, _)) => Err(SpecError::combination(option, "cell-budget or byte-budget")),
        None => Ok(()),
    }
}

/// Checks that certificates are combined only with whole closed cells and unlimited sight.
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

/// Checks that pairs of cells are combined only with cells of equal size, up to a number of cells.
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
            "pairs are listed for at most 32768 cells; give fewer cells, or off",
        )),
        Some(_) => Ok(()),
    }
}
