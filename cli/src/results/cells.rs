//! `sightline cells`: finds view cells for a budget in the grid of a result.

use std::fmt::Write as _;

use sightline::words::plural;
use sightline::{
    CellBudget, CellCost, CellDivision, CellDivisions, Error, NamedResult, Silent, cell_divisions,
    open,
};

use crate::args::results::CellsArgs;
use crate::terminal::stdout::{print, print_json};

/// Prints the division of a result's grid with the least expected set for a budget.
pub fn run(args: &CellsArgs, json: bool) -> Result<(), Error> {
    let pvs = open(&args.result)?;
    let budget = match (args.cell_budget, args.byte_budget) {
        (Some(cells), _) => CellBudget::Cells(cells),
        (None, Some(bytes)) => CellBudget::Bytes(bytes),
        (None, None) => return Err(Error::usage("give --cell-budget or --byte-budget")),
    };
    let result = NamedResult::new(&pvs, &args.result);
    let found = cell_divisions(result, budget, args.cost, &Silent)?;
    if json {
        print_json(&found)
    } else {
        print(&in_words(&found, budget))
    }
}

/// Returns the ratio of a number to the grid's number, which is 0 only if both are.
fn ratio(chosen: f64, grid: f64) -> f64 {
    if grid > 0.0 { chosen / grid } else { 1.0 }
}

fn in_words(found: &CellDivisions, budget: CellBudget) -> String {
    let unit = match found.cost {
        CellCost::Triangles => "triangles",
        CellCost::Objects => "objects",
        CellCost::Bytes => "bytes",
    };
    let [x, y, z] = found.fine;
    let line = |name: String, division: &CellDivision| {
        format!(
            "{name}: {} with a set, {} bytes, expected set {:.1} {unit}",
            plural(division.cells as usize, "cell"),
            division.bytes,
            division.expected
        )
    };
    let mut text = line(format!("grid of {x}x{y}x{z} cells"), &found.grid);
    let of_size = match budget {
        CellBudget::Cells(_) => "cells",
        CellBudget::Bytes(_) => "bytes",
    };
    let _ = write!(
        text,
        "\n{}: {:.2} of the grid's bytes, {:.2} of its expected set\n{of_size} of other budgets, with their \
         expected sets:",
        line("chosen cells".to_owned(), &found.chosen),
        ratio(found.chosen.bytes as f64, found.grid.bytes as f64),
        ratio(found.chosen.expected, found.grid.expected)
    );
    for point in &found.hull {
        let _ = write!(text, "\n  {:>10}: {:.1}", point.size, point.expected);
    }
    text
}
