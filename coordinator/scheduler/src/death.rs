//! Missing workers and counted deaths. `deaths.rs` contains the decisions about them.

use sightline_records::ids::{JobId, Lease, TileIndex};

/// A worker whose stream has ended while it held at least one lease.
#[derive(Clone, Debug)]
pub(super) struct Missing {
    pub(super) name: String,
    pub(super) instance: u64,
    /// The oldest of the leases that the worker held.
    pub(super) lease: Lease,
}

/// The job and the tile of the oldest lease that a dead worker held, and the worker's name.
pub(super) type DeathOf = (JobId, TileIndex, String);

/// A counted death of a worker.
#[derive(Clone, Debug)]
pub(super) struct Death {
    pub(super) name: String,
    pub(super) instance: u64,
    pub(super) job: JobId,
    pub(super) tile: TileIndex,
}
