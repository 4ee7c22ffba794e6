//! The pairs of cells that see each other. A free segment joins all cells that it crosses, over the whole
//! division and not only in the tile's block.
//!
//! Lines write to the table by bitwise or, in any order. No thread reads the table before all lines of a
//! phase are traced, so the order of threads does not affect the result.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

use sightline_model::PairTable;

use super::grid::{CellGrid, Crossed, Slot};

/// The table of pairs while lines are traced.
pub struct Pairs {
    grid: CellGrid,
    words: usize,
    /// A row of bits for each slot of the grid.
    rows: Vec<AtomicU64>,
    /// The words of a row without the cells that have no viewpoint; empty if all cells have one.
    reached: Vec<u64>,
    /// The bit masks of the parts of each cell that contain viewpoints, by [`CellGrid::each`]; empty if all
    /// parts of all cells do.
    parts: Vec<u64>,
    /// The rows that the other members of the crew have or receive; empty if the crew has no other members.
    kept: Mutex<Vec<u64>>,
}

impl Pairs {
    /// Creates a table without pairs over the cells of `grid`.
    pub fn new(grid: CellGrid) -> Self {
        let words = grid.words();
        let mut rows = Vec::new();
        rows.resize_with(words * 64 * words, || AtomicU64::new(0));
        Self {
            grid,
            words,
            rows,
            reached: Vec::new(),
            parts: Vec::new(),
            kept: Mutex::default(),
        }
    }

    /// Restricts the table to the parts of cells that contain viewpoints. `parts` returns the parts of a cell
    /// as a bit mask, by the cell's index in [`CellGrid::each`]; 0 excludes the cell.
    #[must_use]
    pub fn reached_in(mut self, parts: impl Fn(usize) -> u64) -> Self {
        self.parts = (0..self.grid.count()).map(parts).collect();
        let mut reached = vec![0; self.words];
        for (at, _) in self
            .grid
            .each()
            .zip(&self.parts)
            .filter(|(_, parts)| **parts != 0)
        {
            let slot = self.grid.slot(at);
            reached[slot.word as usize] |= 1 << slot.bit;
        }
        self.reached = reached;
        self
    }

    /// Returns the parts of a cell that contain viewpoints as a bit mask, by the cell's index in
    /// [`CellGrid::each`].
    pub fn parts(&self, cell: usize) -> u64 {
        self.parts.get(cell).copied().unwrap_or(u64::MAX)
    }

    /// Returns the words of a row without the cells that have no viewpoint. The list is empty if all cells
    /// have one.
    pub fn reached(&self) -> &[u64] {
        &self.reached
    }

    /// Returns the number of words of the table.
    pub fn places(&self) -> usize {
        self.rows.len()
    }

    /// Joins the cells of the bits of a word, by its index.
    pub fn add(&self, at: usize, bits: u64) {
        self.rows[at].fetch_or(bits, Relaxed);
    }

    /// Calls `each` with the index and the bits of every word that is new since [`Self::keep`], by ascending
    /// index.
    pub fn each_new(&self, mut each: impl FnMut(usize, u64)) {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        for (at, word) in self.rows.iter().enumerate() {
            let new = word.load(Relaxed) & !kept.get(at).copied().unwrap_or(0);
            if new != 0 {
                each(at, new);
            }
        }
    }

    /// Records the current pairs as known to all members of the crew, or sent to them.
    pub fn keep(&self) {
        *self.kept.lock().unwrap_or_else(PoisonError::into_inner) = self.copy();
    }

    /// Returns the grid of the whole division.
    pub fn grid(&self) -> &CellGrid {
        &self.grid
    }

    /// Joins all cells that a free segment crosses.
    pub fn join(&self, crossed: &[(u32, u64)]) {
        for (word, bits) in crossed {
            let mut rest = *bits;
            while rest != 0 {
                let cell = *word as usize * 64 + rest.trailing_zeros() as usize;
                rest &= rest - 1;
                let row = &self.rows[cell * self.words..][..self.words];
                for (at, bits) in crossed {
                    let place = &row[*at as usize];
                    if bits & !place.load(Relaxed) != 0 {
                        place.fetch_or(*bits, Relaxed);
                    }
                }
            }
        }
    }

    /// Joins all cells that a line crosses between two distances. `crossed` is scratch memory.
    pub fn join_line(&self, line: ([f32; 3], [f32; 3]), from: f32, to: f32, crossed: &mut Crossed) {
        self.grid.walk(line.0, line.1, from, to, crossed);
        self.join(crossed);
    }

    /// Returns the row of the cell at `slot` in a copy of the table.
    pub fn row_of<'b>(&self, copy: &'b [u64], slot: Slot) -> &'b [u64] {
        &copy[slot.index() * self.words..][..self.words]
    }

    /// Returns a copy of the table, which can be read while lines write to the table.
    pub fn copy(&self) -> Vec<u64> {
        self.rows.iter().map(|w| w.load(Relaxed)).collect()
    }

    /// Returns true if a segment joins the cell at `slot` with a new cell.
    ///
    /// A new cell is not a pair with the cell at `slot` in `copy`. `crossed` are the cells that the segment
    /// crosses.
    pub fn is_new(&self, copy: &[u64], slot: Slot, crossed: &[(u32, u64)]) -> bool {
        let row = self.row_of(copy, slot);
        crossed
            .iter()
            .any(|(at, bits)| bits & !row[*at as usize] != 0)
    }

    /// Returns the pairs of cells by their index, x fastest. Every cell is a pair with itself. Pairs of two
    /// cells for which `counts` returns false are omitted.
    pub fn table(&self, counts: impl Fn(u32) -> bool) -> PairTable {
        let mut table = PairTable::empty(self.grid.count() as u32);
        let slots: Vec<usize> = self
            .grid
            .each()
            .map(|c| self.grid.slot(c).index())
            .collect();
        let mut numbers = vec![0u32; self.words * 64];
        slots
            .iter()
            .zip(0..)
            .for_each(|(slot, number)| numbers[*slot] = number);
        for (slot, a) in slots.iter().zip(0..) {
            if !counts(a) {
                continue;
            }
            table.insert(a, a);
            for (word, bits) in self.rows[slot * self.words..][..self.words]
                .iter()
                .enumerate()
            {
                let mut rest = bits.load(Relaxed);
                while rest != 0 {
                    table.insert(a, numbers[word * 64 + rest.trailing_zeros() as usize]);
                    rest &= rest - 1;
                }
            }
        }
        table
    }
}
