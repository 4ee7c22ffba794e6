//! The work of a worker since it connected.

use sightline_records::TileStats;

/// The number of finished tiles, and their total cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkerTotals {
    pub tiles: u64,
    pub cells: u64,
    pub samples: u64,
    pub millis: u64,
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
