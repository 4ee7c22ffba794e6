//! A lease that this worker works under: its progress, and whether it is cancelled.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use sightline_bake::Watcher;
use sightline_proto::v1;

/// A held lease, shared by the session and the tile that runs under it.
pub struct LeasedTile {
    /// The lease.
    pub lease: v1::Lease,
    cells: AtomicU64,
    samples: AtomicU64,
    cancelled: AtomicBool,
    begun: AtomicBool,
}

impl LeasedTile {
    /// The state of a new lease.
    pub fn new(lease: v1::Lease) -> Self {
        Self {
            lease,
            cells: AtomicU64::new(0),
            samples: AtomicU64::new(0),
            cancelled: AtomicBool::new(false),
            begun: AtomicBool::new(false),
        }
    }

    /// Tells the tile to stop.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Notes that the tile runs.
    pub fn begin(&self) {
        self.begun.store(true, Ordering::Relaxed);
    }

    /// Whether the tile runs. Before that it fetches its data and waits for the tile before it.
    pub fn begun(&self) -> bool {
        self.begun.load(Ordering::Relaxed)
    }

    /// The progress of the tile, as the message that renews the lease.
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
