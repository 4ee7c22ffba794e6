//! Pieces of work on cells of a block. The crew shares them, and their counts are added to the cells'
//! statistics.

use sightline_model::{CellStats, LineKind};
use sightline_trace::TracerError;
use sightline_trace::lines::tally::Tally;

use super::block::{Block, Scratch};
use super::phase::{self, Items, Tables};
use crate::context::TileError;

/// A piece of work on one cell of the block.
pub(super) trait Piece: Sync {
    /// Returns the index of the cell in `CellTable::cells`.
    fn cell(&self) -> usize;

    /// Returns the expected cost of the piece, in any unit.
    fn cost(&self) -> u64;
}

/// A piece of uniform lines: a cell, and the number of tiles along a cube face.
impl Piece for (usize, u32) {
    fn cell(&self) -> usize {
        self.0
    }

    fn cost(&self) -> u64 {
        u64::from(self.1) * u64::from(self.1)
    }
}

/// A piece of lines: a cell, and a number of lines.
impl Piece for (usize, u64) {
    fn cell(&self) -> usize {
        self.0
    }

    fn cost(&self) -> u64 {
        self.1
    }
}

/// A piece of held-out lines: a cell, the number of a look, and a number of lines.
impl Piece for (usize, (u32, u64)) {
    fn cell(&self) -> usize {
        self.0
    }

    fn cost(&self) -> u64 {
        self.1.1
    }
}

impl Block<'_> {
    /// Ensures that this or another member calls `f` for each piece of work, and adds the counts to the
    /// cells' statistics.
    pub(super) fn each<W, F>(&mut self, work: &[W], f: F) -> Result<(), TileError>
    where
        W: Piece,
        F: Fn(&Self, &mut Scratch, &W) -> Result<CellStats, TracerError> + Sync,
    {
        let cells: Vec<usize> = work.iter().map(Piece::cell).collect();
        let cost = |item: usize| work[item].cost();
        self.each_prepared(&cells, &|_| {}, &cost, &|block, scratch, item| {
            f(block, scratch, &work[item])
        })
    }

    /// Works like [`Self::each`], for one piece of work on each of `cells`. `prepare` creates the data that
    /// `f` needs.
    pub(super) fn each_prepared(
        &mut self,
        cells: &[usize],
        prepare: &(dyn Fn(&Self) + Sync),
        cost: &(dyn Fn(usize) -> u64 + Sync),
        f: &(dyn Fn(&Self, &mut Scratch, usize) -> Result<CellStats, TracerError> + Sync),
    ) -> Result<(), TileError> {
        let this = &*self;
        let compute = |item: usize| {
            if this.inputs.watcher.cancelled() {
                return Err(TileError::Cancelled);
            }
            if this.late() {
                return Ok(Default::default());
            }
            let answer = this.with_scratch(|scratch| {
                scratch.tally = Tally::default();
                f(this, scratch, item).map(|stats| (stats, scratch.tally.clone()))
            })?;
            if this.inputs.watcher.cancelled() {
                return Err(TileError::Cancelled);
            }
            this.inputs.watcher.rendered(answer.0.rays.iter().sum());
            Ok(answer)
        };
        let items = Items {
            count: cells.len(),
            prepare: &|| prepare(this),
            cost,
            compute: &compute,
            fits: &|_| true,
        };
        let done = phase::run(this.inputs.crew, this.tables(), items)?;
        for (cell, (s, tally)) in cells.iter().zip(done) {
            self.yields.add(&tally);
            self.count(*cell, &s);
        }
        Ok(())
    }

    /// Adds the counts of a phase to a cell's statistics.
    pub(super) fn count(&mut self, cell: usize, s: &CellStats) {
        let all = &mut self.table.stats[cell];
        for k in 0..s.rays.len() {
            all.rays[k] += s.rays[k];
            all.finds[k] += s.finds[k];
        }
        if s.rays[LineKind::Uniform as usize] > 0 {
            all.rounds += 1;
            (all.last_rays, all.last_misses) = (s.last_rays, s.last_misses);
        }
        if s.bound_lines > 0 {
            (all.bound_lines, all.bound_misses, all.bound_look) =
                (s.bound_lines, s.bound_misses, s.bound_look);
        }
        if s.bound_cell_lines > 0 {
            (
                all.bound_cell_lines,
                all.bound_cell_misses,
                all.bound_cell_look,
            ) = (s.bound_cell_lines, s.bound_cell_misses, s.bound_cell_look);
        }
    }

    /// Returns the tables to which lines write.
    pub(super) fn tables(&self) -> Tables<'_> {
        Tables {
            bits: Some(&self.table.bits),
            pairs: self.inputs.pairs,
        }
    }
}
