//! The statistics of a result's cells, as columns of its file.

use sightline_model::CellSet;
use sightline_model::statistics::{COLUMNS, column_names};
use sightline_pvs::Column;

/// A collector of the statistics of cells, in the order of the cells.
pub struct Statistics {
    values: [Vec<u64>; COLUMNS],
}

impl Default for Statistics {
    fn default() -> Self {
        Self {
            values: std::array::from_fn(|_| Vec::new()),
        }
    }
}

impl Statistics {
    /// Adds the statistics of the next cell.
    pub fn push(&mut self, cell: &CellSet) {
        for (column, value) in self.values.iter_mut().zip(cell.row()) {
            column.push(value);
        }
    }

    /// Returns the columns that have a value other than zero.
    pub fn columns(self) -> Vec<Column> {
        let column = |(name, values): (&str, Vec<u64>)| Column {
            name: name.to_owned(),
            values,
        };
        let kept = |(_, values): &(&str, Vec<u64>)| values.iter().any(|v| *v != 0);
        column_names()
            .zip(self.values)
            .filter(kept)
            .map(column)
            .collect()
    }
}
