//! What a result keeps of how each cell was sampled, as columns of its file.
//!
//! Only what is the same on every run: rays and finds, not seconds. The time a tile took is in its job's record.

use sightline_pvs::Column;
use sightline_sampling::tile::CellSet;

/// Names of the columns, in the order of [`row`].
const NAMES: [&str; 15] = [
    "samples",
    "rays_uniform",
    "rays_flood",
    "rays_candidate",
    "rays_check",
    "finds_uniform",
    "finds_flood",
    "finds_candidate",
    "finds_check",
    "rounds",
    "last_rays",
    "last_misses",
    "bound_lines",
    "bound_misses",
    "bound_look",
];

fn row(cell: &CellSet) -> [u64; 15] {
    let s = &cell.stats;
    let ([a, b, c, d], [e, f, g, h]) = (s.rays, s.finds);
    [
        u64::from(cell.samples),
        a,
        b,
        c,
        d,
        e,
        f,
        g,
        h,
        u64::from(s.rounds),
        s.last_rays,
        s.last_misses,
        s.bound_lines,
        s.bound_misses,
        u64::from(s.bound_look),
    ]
}

/// Collects the cells in their order.
#[derive(Default)]
pub(crate) struct Statistics {
    values: [Vec<u64>; 15],
}

impl Statistics {
    /// Adds a cell.
    pub(crate) fn push(&mut self, cell: &CellSet) {
        for (column, value) in self.values.iter_mut().zip(row(cell)) {
            column.push(value);
        }
    }

    /// The columns; those that are zero everywhere are left out.
    pub(crate) fn columns(self) -> Vec<Column> {
        let column = |(name, values): (&str, Vec<u64>)| Column { name: name.to_owned(), values };
        let kept = |(_, values): &(&str, Vec<u64>)| values.iter().any(|v| *v != 0);
        NAMES.into_iter().zip(self.values).filter(kept).map(column).collect()
    }
}
