//! The messages between the scheduler and the workers, apart from their wire format.

use std::sync::Arc;

use sightline_model::PlannedJob;

use crate::ids::{Digest, Epoch, JobId, Lease, WorkerId};

/// A point in time, as plain numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Now {
    /// Milliseconds of monotonic time, from any origin.
    pub(crate) ms: u64,
    /// Milliseconds since 1970, for time budgets. May jump.
    pub(crate) unix_ms: u64,
}

/// A worker's first message.
#[derive(Clone, Debug)]
pub(crate) struct Introduction {
    /// Its name, for people; unique among the connected workers.
    pub(crate) name: String,
    /// The name together with the worker's identity, to which authorship and quarantine belong.
    pub(crate) signature: String,
    /// The version of its program, for people.
    pub(crate) version: String,
    /// A random number drawn when the worker started; 0 when it sends none.
    pub(crate) instance: u64,
    /// The numerics profiles of its backends.
    pub(crate) profiles: Vec<String>,
    /// Leases that it holds from an earlier stream.
    pub(crate) held: Vec<Lease>,
    /// Whether it helps the leaders of crews.
    pub(crate) helps: bool,
}

/// The answer to an [`Introduction`].
#[derive(Clone, Debug)]
pub(crate) struct Joined {
    /// The worker's number for this stream.
    pub(crate) worker: WorkerId,
    /// The coordinator's epoch.
    pub(crate) epoch: Epoch,
    /// Those of the held leases that are still the worker's.
    pub(crate) kept: Vec<Lease>,
}

/// Another worker of the same name is connected.
#[derive(Clone, Debug, thiserror::Error)]
#[error("a worker named {name:?} is connected already; give this one another --name")]
pub(crate) struct NameTaken {
    /// The name.
    pub(crate) name: String,
}

/// How far a leased tile is. Renews the lease.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Progress {
    /// The tile's lease.
    pub(crate) lease: Lease,
    /// Finished view cells.
    pub(crate) cells: u64,
    /// Samples taken.
    pub(crate) samples: u64,
}

/// The measured speed of a backend on a job's scene.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ProfileTime {
    /// The backend's numerics profile.
    pub(crate) profile: String,
    /// Seconds for one visibility cube.
    pub(crate) seconds_per_cube: f64,
}

/// A message to a worker.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum WorkerCommand {
    /// Work on a tile.
    Grant(Box<Grant>),
    /// Stop working on a tile, or helping its leader.
    Revoke(Lease),
    /// Help the leader of a tile.
    Help(Box<Help>),
    /// Measure the backends on a job's scene.
    Time {
        /// The job.
        job: JobId,
        /// The planned job.
        work: Arc<PlannedJob>,
    },
}

/// A tile given to a worker.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Grant {
    /// The tile and its lease.
    pub(crate) lease: Lease,
    /// The planned job.
    pub(crate) work: Arc<PlannedJob>,
    /// The numerics profile that the tile must be computed with.
    pub(crate) profile: String,
    /// Digests of the packs that the tile needs, in the plan's order of needed tiles; `None` for one that is
    /// not there.
    pub(crate) packs: Vec<Option<Digest>>,
    /// Time for the tile in milliseconds, when the job has a time budget.
    pub(crate) millis: Option<u64>,
}

/// A leader who can use a helper.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Help {
    /// The leader's lease.
    pub(crate) lease: Lease,
    /// The planned job.
    pub(crate) work: Arc<PlannedJob>,
    /// The numerics profile of the job.
    pub(crate) profile: String,
}
