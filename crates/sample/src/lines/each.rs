//! Pieces of work on cells of a block: shared by the crew, their counts added to the cells' statistics.

use sightline_model::{CellStats, LineKind};
use sightline_trace::BackendError;
use sightline_trace::lines::tally::Tally;

use super::block::{Block, Scratch};
use super::phase::{self, Items, Tables};
use crate::context::TileError;

/// A piece of work on one cell of the block.
pub(super) trait Piece: Sync {
    /// Its place in `Block::cells`.
    fn cell(&self) -> usize;

    /// Its expected cost, in any unit.
    fn cost(&self) -> u64;
}

/// Tiles along a cube face.
impl Piece for (usize, u32) {
    fn cell(&self) -> usize {
        self.0
    }

    fn cost(&self) -> u64 {
        u64::from(self.1) * u64::from(self.1)
    }
}

/// A number of lines.
impl Piece for (usize, u64) {
    fn cell(&self) -> usize {
        self.0
    }

    fn cost(&self) -> u64 {
        self.1
    }
}

/// The number of a test, and a number of lines.
impl Piece for (usize, (u32, u64)) {
    fn cell(&self) -> usize {
        self.0
    }

    fn cost(&self) -> u64 {
        self.1.1
    }
}

impl Block<'_> {
    /// Sees to it that `f` is called for each piece of work, here or elsewhere, and adds its counts to the
    /// cell's statistics.
    pub(super) fn each<W, F>(&mut self, work: &[W], f: F) -> Result<(), TileError>
    where
        W: Piece,
        F: Fn(&Self, &mut Scratch, &W) -> Result<CellStats, BackendError> + Sync,
    {
        let cells: Vec<usize> = work.iter().map(Piece::cell).collect();
        let cost = |item: usize| work[item].cost();
        self.each_prepared(&cells, &|_| {}, &cost, &|block, scratch, item| {
            f(block, scratch, &work[item])
        })
    }

    /// As [`Self::each`], for one piece of work on each of `cells`. `prepare` makes what `f` needs.
    pub(super) fn each_prepared(
        &mut self,
        cells: &[usize],
        prepare: &(dyn Fn(&Self) + Sync),
        cost: &(dyn Fn(usize) -> u64 + Sync),
        f: &(dyn Fn(&Self, &mut Scratch, usize) -> Result<CellStats, BackendError> + Sync),
    ) -> Result<(), TileError> {
        let this = &*self;
        let compute = |item: usize| {
            if this.tools.watcher.cancelled() {
                return Err(TileError::Cancelled);
            }
            if this.late() {
                return Ok(Default::default());
            }
            let answer = this.with_scratch(|scratch| {
                scratch.tally = Tally::default();
                f(this, scratch, item).map(|stats| (stats, scratch.tally.clone()))
            })?;
            if this.tools.watcher.cancelled() {
                return Err(TileError::Cancelled);
            }
            this.tools.watcher.rendered(answer.0.rays.iter().sum());
            Ok(answer)
        };
        let items = Items {
            count: cells.len(),
            prepare: &|| prepare(this),
            cost,
            compute: &compute,
            fits: &|_| true,
        };
        let done = phase::run(this.tools.crew, this.tables(), items)?;
        for (cell, (s, tally)) in cells.iter().zip(done) {
            self.yields.add(&tally);
            self.count(*cell, &s);
        }
        Ok(())
    }

    /// Adds what was counted in a phase to a cell's statistics.
    pub(super) fn count(&mut self, cell: usize, s: &CellStats) {
        let all = &mut self.stats[cell];
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

    /// The tables that lines write to.
    pub(super) fn tables(&self) -> Tables<'_> {
        Tables {
            bits: Some(&self.bits),
            pairs: self.tools.pairs,
        }
    }
}
