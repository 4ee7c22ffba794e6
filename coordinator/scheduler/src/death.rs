//! Missing workers, and deaths that were counted. `deaths.rs` decides about them.

use sightline_records::ids::{JobId, Lease, TileIndex};

/// A worker whose stream has ended before its first lease.
#[derive(Clone, Debug)]
pub(super) struct Missing {
    pub(super) name: String,
    pub(super) instance: u64,
    /// The first lease given.
    pub(super) lease: Lease,
}

/// The name of a dead worker, and the tile that it held first.
pub(super) type DeathOf = (JobId, TileIndex, String);

/// A death that was counted.
#[derive(Clone, Debug)]
pub(super) struct Death {
    pub(super) name: String,
    pub(super) instance: u64,
    pub(super) job: JobId,
    pub(super) tile: TileIndex,
}
