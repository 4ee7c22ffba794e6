//! The statistics of a result's cells, as columns of its file.

use sightline_model::CellSet;
use sightline_model::statistics::{COLUMNS, VIEWPOINT_WEIGHT, column_names};
use sightline_pvs::Column;

/// A collector of the statistics of cells, in the order of the cells.
pub struct Statistics {
    values: [Vec<u64>; COLUMNS],
    /// The number of parts with viewpoints of each cell; empty if the job marks no parts of a grid.
    weights: Vec<u64>,
}

impl Default for Statistics {
    fn default() -> Self {
        Self {
            values: std::array::from_fn(|_| Vec::new()),
            weights: Vec::new(),
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

    /// Adds the number of parts of the next cell that contain viewpoints.
    pub fn push_weight(&mut self, parts: u32) {
        self.weights.push(parts.into());
    }

    /// Returns the columns that have a value other than zero.
    pub fn columns(self) -> Vec<Column> {
        let column = |(name, values): (&str, Vec<u64>)| Column {
            name: name.to_owned(),
            values,
        };
        let weights = (!self.weights.is_empty()).then(|| column((VIEWPOINT_WEIGHT, self.weights)));
        let kept = |(_, values): &(&str, Vec<u64>)| values.iter().any(|v| *v != 0);
        column_names()
            .zip(self.values)
            .filter(kept)
            .map(column)
            .chain(weights)
            .collect()
    }
}
