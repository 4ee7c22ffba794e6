//! A lease of this worker: its progress, and its cancellation.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use sightline_bake::Watcher;
use sightline_proto::v1;

/// A lease of this worker, shared by the session and the tile that is computed under it.
pub struct LeasedTile {
    /// The lease of the tile.
    pub lease: v1::Lease,
    cells: AtomicU64,
    samples: AtomicU64,
    cancelled: AtomicBool,
    begun: AtomicBool,
}

impl LeasedTile {
    /// Creates the state of a new lease.
    pub fn new(lease: v1::Lease) -> Self {
        Self {
            lease,
            cells: AtomicU64::new(0),
            samples: AtomicU64::new(0),
            cancelled: AtomicBool::new(false),
            begun: AtomicBool::new(false),
        }
    }

    /// Cancels the tile. Its computation stops soon after.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Records that the tile runs.
    pub fn begin(&self) {
        self.begun.store(true, Ordering::Relaxed);
    }

    /// Returns true if the tile runs. Before that, the worker fetches the tile's data or finishes the
    /// preceding tile.
    pub fn begun(&self) -> bool {
        self.begun.load(Ordering::Relaxed)
    }

    /// Returns the progress of the tile, as the message that renews the lease.
    pub fn progress(&self) -> v1::Progress {
        v1::Progress {
            lease: Some(self.lease),
            cells: self.cells.load(Ordering::Relaxed),
            samples: self.samples.load(Ordering::Relaxed),
        }
    }
}

impl Watcher for LeasedTile {
    fn rendered(&self, cubes: u64) {
        self.samples.fetch_add(cubes, Ordering::Relaxed);
    }
    fn cell_done(&self) {
        self.cells.fetch_add(1, Ordering::Relaxed);
    }
    fn cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}
