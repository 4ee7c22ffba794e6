//! The messages between the scheduler and the workers, independent of their wire format.

use std::sync::Arc;

use sightline_model::PlannedJob;
use sightline_records::ids::{Digest, Epoch, JobId, Lease, WorkerId};

/// A point in time, as plain numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Now {
    /// The monotonic time in milliseconds, from any origin.
    pub ms: u64,
    /// The wall-clock time in milliseconds since 1970, for time budgets. May jump.
    pub unix_ms: u64,
}

/// A worker's first message.
#[derive(Clone, Debug)]
pub struct Introduction {
    /// The display name of the worker, unique among the connected workers.
    pub name: String,
    /// The signature: the name with the worker's identity. Authorship and quarantine refer to it.
    pub signature: String,
    /// The version of the worker's program, for display.
    pub version: String,
    /// A random number generated when the worker started; 0 if the worker sends none.
    pub instance: u64,
    /// The numerics profiles of the worker's backends.
    pub profiles: Vec<String>,
    /// The leases that the worker holds from an earlier stream.
    pub held: Vec<Lease>,
    /// True if the worker can help the leaders of crews.
    pub helps: bool,
}

/// The answer to an [`Introduction`].
#[derive(Clone, Debug)]
pub struct Joined {
    /// The worker's number for this stream.
    pub worker: WorkerId,
    /// The coordinator's epoch.
    pub epoch: Epoch,
    /// The claimed leases that still belong to the worker.
    pub kept: Vec<Lease>,
}

/// An error: another worker with the same name is connected.
#[derive(Clone, Debug, thiserror::Error)]
#[error("a worker named {name:?} is already connected; give this worker another --name")]
pub struct NameTaken {
    /// The name of both workers.
    pub name: String,
}

/// The progress of a leased tile. The report renews the lease.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// The lease of the tile.
    pub lease: Lease,
    /// The number of finished view cells.
    pub cells: u64,
    /// The number of samples.
    pub samples: u64,
}

/// The measured speed of a backend on a job's scene.
#[derive(Clone, Debug, PartialEq)]
pub struct ProfileTime {
    /// The backend's numerics profile.
    pub profile: String,
    /// The time for one visibility cube, in seconds.
    pub seconds_per_cube: f64,
}

/// A message to a worker.
#[derive(Clone, Debug, PartialEq)]
pub enum WorkerCommand {
    /// Work on a tile.
    Grant(Box<Grant>),
    /// Stop computing a tile, or stop helping its leader.
    Revoke(Lease),
    /// Help the leader of a tile.
    Help(Box<Help>),
    /// Measure the backends on a job's scene.
    Time {
        /// The job whose scene is used.
        job: JobId,
        /// The planned job.
        planned: Arc<PlannedJob>,
    },
}

/// A tile that is granted to a worker.
#[derive(Clone, Debug, PartialEq)]
pub struct Grant {
    /// The tile and its lease.
    pub lease: Lease,
    /// The planned job.
    pub planned: Arc<PlannedJob>,
    /// The numerics profile that the tile must be computed with.
    pub profile: String,
    /// The digests of the needed packs, in the plan's order of needed tiles; `None` for a missing pack.
    pub packs: Vec<Option<Digest>>,
    /// The time limit for the tile in milliseconds; `None` without a time budget.
    pub millis: Option<u64>,
}

/// A leader that can use a helper.
#[derive(Clone, Debug, PartialEq)]
pub struct Help {
    /// The lease of the leader.
    pub lease: Lease,
    /// The planned job.
    pub planned: Arc<PlannedJob>,
    /// The numerics profile of the job.
    pub profile: String,
}
