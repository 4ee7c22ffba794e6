//! `sightline cells`: finds view cells for a budget in the grid of a result.

use std::fmt::Write as _;

use sightline::words::plural;
use sightline::{
    CellBudgetOptions, CellCost, CellDivision, CellDivisions, Error, NamedResult, Silent,
    cell_divisions, open,
};

use crate::args::results::CellsArgs;
use crate::terminal::stdout::{print, print_json};

/// Prints the division of a result's grid with the least expected set for a budget.
pub fn run(args: &CellsArgs, json: bool) -> Result<(), Error> {
    let pvs = open(&args.result)?;
    let options = CellBudgetOptions {
        cell_budget: args.cell_budget,
        byte_budget: args.byte_budget,
        cost: args.cost,
        ..CellBudgetOptions::default()
    };
    let Some(choice) = options.choice()? else {
        return Err(Error::usage("give --cell-budget or --byte-budget"));
    };
    let result = NamedResult::new(&pvs, &args.result);
    let found = cell_divisions(result, choice.budget(), choice.cost(), &Silent)?;
    if json {
        print_json(&found)
    } else {
        print(&in_words(&found))
    }
}

/// Returns the ratio of a number to the grid's number, which is 0 only if both are.
fn ratio(chosen: f64, grid: f64) -> f64 {
    if grid > 0.0 { chosen / grid } else { 1.0 }
}

fn in_words(found: &CellDivisions) -> String {
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
    let _ = write!(
        text,
        "\n{}: {:.2} of the grid's bytes, {:.2} of its expected set\n\
         other budgets: cells, bytes, expected set",
        line("chosen cells".to_owned(), &found.chosen),
        ratio(found.chosen.bytes as f64, found.grid.bytes as f64),
        ratio(found.chosen.expected, found.grid.expected)
    );
    for point in &found.hull {
        let _ = write!(
            text,
            "\n  {:>8} {:>12} {:>12.1}",
            point.cells, point.bytes, point.expected
        );
    }
    text
}
