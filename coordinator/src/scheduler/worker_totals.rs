//! What a worker did since it connected.

use crate::store::TileStats;

/// Finished tiles and what they took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct WorkerTotals {
    pub(crate) tiles: u64,
    pub(crate) cells: u64,
    pub(crate) samples: u64,
    pub(crate) millis: u64,
}

impl WorkerTotals {
    /// Adds a finished tile.
    pub(super) fn add(&mut self, stats: &TileStats) {
        self.tiles += 1;
        self.cells = self.cells.saturating_add(stats.cells);
        self.samples = self.samples.saturating_add(stats.samples);
        self.millis = self.millis.saturating_add(stats.millis);
    }
}
