//! Statistics of each cell's sampling and queries, as columns of the result's file.
//!
//! Only numbers that are the same on every run: rays and triangles found, not seconds. The record of a job
//! has the time of each tile.

use sightline_exact::Effort;
use sightline_pvs::Column;
use sightline_sampling::lines::CellStats;
use sightline_sampling::tile::CellSet;

/// Columns: the cubes of a cell, [`CellStats::NAMES`], then those of exact queries.
const COLUMNS: usize = 1 + CellStats::NAMES.len() + Effort::NAMES.len();

/// Collects the cells in their order.
pub(crate) struct Statistics {
    values: [Vec<u64>; COLUMNS],
}

impl Default for Statistics {
    fn default() -> Self {
        Self { values: std::array::from_fn(|_| Vec::new()) }
    }
}

impl Statistics {
    /// Adds a cell.
    pub(crate) fn push(&mut self, cell: &CellSet) {
        let counts = cell.decision.as_ref().map_or(&[][..], |d| &d.counts);
        // Cells without exact queries have no such numbers, and a worker may send fewer than there are
        // columns.
        let exact = counts.iter().copied().chain(std::iter::repeat(0)).take(Effort::NAMES.len());
        let row = [u64::from(cell.samples)].into_iter().chain(cell.stats.numbers()).chain(exact);
        for (column, value) in self.values.iter_mut().zip(row) {
            column.push(value);
        }
    }

    /// The columns; those that are zero everywhere are left out.
    pub(crate) fn columns(self) -> Vec<Column> {
        let column = |(name, values): (&str, Vec<u64>)| Column { name: name.to_owned(), values };
        let kept = |(_, values): &(&str, Vec<u64>)| values.iter().any(|v| *v != 0);
        ["samples"]
            .into_iter()
            .chain(CellStats::NAMES)
            .chain(Effort::NAMES)
            .zip(self.values)
            .filter(kept)
            .map(column)
            .collect()
    }
}
