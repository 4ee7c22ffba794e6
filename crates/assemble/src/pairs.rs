//! The pairs of cells of a result that see each other, joined and renumbered from the tiles' relations.
//!
//! A tile numbers cells by a regular grid over the view box ([`Visibility::pair_cells`]). A result numbers
//! cells in the order of its tree. A cell of an adaptive tree contains several cells of that grid, or is a
//! part of one.

use sightline_model::{PairTable, TilePairs, Visibility};
use sightline_pvs::{CellPairs, MOST_PAIR_CELLS, PvsError, Relation};
use sightline_viewcells::CellBox;

/// The union of the relations of the tiles read so far, and the cells of the result.
pub struct PairJoin {
    sides: [u32; 3],
    units: [u32; 3],
    seen: PairTable,
    hidden: Option<PairTable>,
    /// For each cell of the result, the grid cells that it contains or lies in.
    cells: Vec<Vec<u32>>,
    /// For each cell of the result: true if it has viewpoints, and true if its tile was set aside or is not
    /// done.
    states: Vec<(bool, bool)>,
}

impl PairJoin {
    /// Creates a join without relations. Returns `None` if the job has no pairs, or more than
    /// [`MOST_PAIR_CELLS`] cells.
    pub fn new(task: &Visibility, cells: u32) -> Option<Self> {
        let sides = task.pair_cells().filter(|_| cells <= MOST_PAIR_CELLS)?;
        let count = sides.iter().product();
        Some(Self {
            sides,
            units: task.lattice().units(),
            seen: PairTable::empty(count),
            hidden: task.is_decided().then(|| PairTable::empty(count)),
            cells: Vec::new(),
            states: Vec::new(),
        })
    }

    /// Adds the relations of a tile. Returns false if the relations have another number of cells than the
    /// job.
    pub fn add_tile(&mut self, pairs: &TilePairs) -> bool {
        if pairs.seen.cells() != self.seen.cells() {
            return false;
        }
        self.seen.extend(&pairs.seen);
        if let (Some(all), Some(hidden)) = (&mut self.hidden, &pairs.hidden) {
            all.extend(hidden);
        }
        true
    }

    /// Adds the next cell of the result, with its box on the lattice. `reached` is true if the cell has
    /// viewpoints, and `aside` is true if its tile was set aside or is not done.
    pub fn add_cell(&mut self, at: &CellBox, reached: bool, aside: bool) {
        let range = |a: usize| {
            let [lo, hi, sides, units] =
                [at.lo[a], at.hi[a], self.sides[a], self.units[a]].map(u64::from);
            (lo * sides / units) as u32..(hi * sides).div_ceil(units) as u32
        };
        let [nx, ny, _] = self.sides;
        let row = |y: u32, z: u32| range(0).map(move |x| (z * ny + y) * nx + x);
        let all = range(2).flat_map(|z| range(1).flat_map(move |y| row(y, z)));
        self.cells.push(all.collect());
        self.states.push((reached, aside));
    }

    /// Computes the relations between the cells of the result.
    pub fn finish(&self) -> Result<CellPairs, PvsError> {
        let count = self.cells.len() as u32;
        let (mut visible, mut undecided) = (Relation::empty(count)?, Relation::empty(count)?);
        for (a, cells) in self.cells.iter().enumerate() {
            let union = |table: &PairTable| {
                let mut row = vec![0u64; table.row(0).len()];
                for cell in cells {
                    row.iter_mut()
                        .zip(table.row(*cell))
                        .for_each(|(r, bits)| *r |= bits);
                }
                row
            };
            let seen = union(&self.seen);
            // A pair of cells of the result is hidden if all pairs of their grid cells are hidden.
            let hidden = self.hidden.as_ref().map(|hidden| {
                let mut row = vec![u64::MAX; hidden.row(0).len()];
                for cell in cells {
                    row.iter_mut()
                        .zip(hidden.row(*cell))
                        .for_each(|(r, bits)| *r &= bits);
                }
                row
            });
            let has = |row: &[u64], cell: u32| row[cell as usize / 64] >> (cell % 64) & 1 == 1;
            for (b, others) in self.cells.iter().enumerate().skip(a) {
                let ((reached_a, aside_a), (reached_b, aside_b)) = (self.states[a], self.states[b]);
                if !reached_a && !reached_b && a != b {
                    continue;
                }
                let is_hidden = hidden
                    .as_ref()
                    .is_some_and(|row| others.iter().all(|c| has(row, *c)));
                let is_seen = a == b || others.iter().any(|c| has(&seen, *c));
                let open = aside_a || aside_b || (hidden.is_some() && !is_seen);
                if a == b || (!is_hidden && (is_seen || open)) {
                    visible.insert(a as u32, b as u32);
                    if !is_seen {
                        undecided.insert(a as u32, b as u32);
                    }
                }
            }
        }
        Ok(CellPairs {
            visible,
            undecided: Some(undecided).filter(|u| u.pairs() > 0),
        })
    }
}
