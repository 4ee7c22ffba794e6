//! The pairs of cells that see each other, from one tile: symmetric relations over all cells of the division.
//!
//! [`Visibility::pair_cells`] numbers the cells: the cells of a grid by their index, x fastest, then y, then
//! z. A pair of cells is in the relation *seen* if a line of the tile crossed both cells before a triangle
//! blocked it. The pair is in the relation *hidden* if a proof shows that no such line exists.
//!
//! The crate `sightline_pvs` has another type for the relation of a result, because it depends on no other
//! crate of the project.
//!
//! [`Visibility::pair_cells`]: crate::Visibility::pair_cells

/// Maximum number of cells of a job that lists pairs of cells. A table has cells² / 8 bytes.
pub const MOST_PAIR_CELLS: u64 = 1 << 15;

/// A symmetric relation over cells: one bit for each ordered pair.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PairTable {
    cells: u32,
    words: usize,
    rows: Vec<u64>,
}

impl PairTable {
    /// Creates a relation without pairs over `cells` cells, at most [`MOST_PAIR_CELLS`].
    pub fn empty(cells: u32) -> Self {
        let words = (cells as usize).div_ceil(64);
        Self {
            cells,
            words,
            rows: vec![0; words * cells as usize],
        }
    }

    /// Returns the number of cells.
    pub fn cells(&self) -> u32 {
        self.cells
    }

    /// Adds the pair of two cells; both must be below [`Self::cells`].
    pub fn insert(&mut self, a: u32, b: u32) {
        for (a, b) in [(a, b), (b, a)] {
            self.rows[a as usize * self.words + b as usize / 64] |= 1 << (b % 64);
        }
    }

    /// Returns true if two cells are a pair. Both must be below [`Self::cells`].
    pub fn has(&self, a: u32, b: u32) -> bool {
        self.row(a)[b as usize / 64] >> (b % 64) & 1 == 1
    }

    /// Returns the cells that are a pair with `cell`, as bits: cell b is bit `b % 64` of word `b / 64`.
    pub fn row(&self, cell: u32) -> &[u64] {
        &self.rows[cell as usize * self.words..][..self.words]
    }

    /// Adds all pairs of another relation over the same number of cells.
    pub fn extend(&mut self, other: &Self) {
        self.rows
            .iter_mut()
            .zip(&other.rows)
            .for_each(|(a, b)| *a |= b);
    }

    /// Returns the cells from `cell` on that are a pair with `cell`, as the bounds of runs: start, end,
    /// start, end.
    pub(crate) fn later(&self, cell: u32) -> Vec<u32> {
        let mut bounds: Vec<u32> = Vec::new();
        for (w, bits) in self.row(cell).iter().enumerate().skip(cell as usize / 64) {
            let mut rest = *bits;
            while rest != 0 {
                let at = w as u32 * 64 + rest.trailing_zeros();
                rest &= rest - 1;
                if at < cell {
                    continue;
                }
                match bounds.last_mut() {
                    Some(end) if *end == at => *end = at + 1,
                    _ => bounds.extend([at, at + 1]),
                }
            }
        }
        bounds
    }
}

/// The relations between cells that one tile found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TilePairs {
    /// The pairs of cells that a sight line crossed.
    pub seen: PairTable,
    /// The pairs that were proved hidden; `None` for the method aggressive.
    pub hidden: Option<PairTable>,
}
