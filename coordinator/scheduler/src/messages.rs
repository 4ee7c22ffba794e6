//! The messages between the scheduler and the workers, apart from their wire format.

use std::sync::Arc;

use sightline_model::PlannedJob;
use sightline_records::ids::{Digest, Epoch, JobId, Lease, WorkerId};

/// A point in time, as plain numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Now {
    /// Milliseconds of monotonic time, from any origin.
    pub ms: u64,
    /// Milliseconds since 1970, for time budgets. May jump.
    pub unix_ms: u64,
}

/// A worker's first message.
#[derive(Clone, Debug)]
pub struct Introduction {
    /// Its name, for people; unique among the connected workers.
    pub name: String,
    /// The name together with the worker's identity, to which authorship and quarantine belong.
    pub signature: String,
    /// The version of its program, for people.
    pub version: String,
    /// A random number drawn when the worker started; 0 when it sends none.
    pub instance: u64,
    /// The numerics profiles of its backends.
    pub profiles: Vec<String>,
    /// Leases that it holds from an earlier stream.
    pub held: Vec<Lease>,
    /// Whether it helps the leaders of crews.
    pub helps: bool,
}

/// The answer to an [`Introduction`].
#[derive(Clone, Debug)]
pub struct Joined {
    /// The worker's number for this stream.
    pub worker: WorkerId,
    /// The coordinator's epoch.
    pub epoch: Epoch,
    /// Those of the held leases that are still the worker's.
    pub kept: Vec<Lease>,
}

/// Another worker of the same name is connected.
#[derive(Clone, Debug, thiserror::Error)]
#[error("a worker named {name:?} is connected already; give this one another --name")]
pub struct NameTaken {
    /// The name.
    pub name: String,
}

/// How far a leased tile is. Renews the lease.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// The tile's lease.
    pub lease: Lease,
    /// Finished view cells.
    pub cells: u64,
    /// Samples taken.
    pub samples: u64,
}

/// The measured speed of a backend on a job's scene.
#[derive(Clone, Debug, PartialEq)]
pub struct ProfileTime {
    /// The backend's numerics profile.
    pub profile: String,
    /// Seconds for one visibility cube.
    pub seconds_per_cube: f64,
}

/// A message to a worker.
#[derive(Clone, Debug, PartialEq)]
pub enum WorkerCommand {
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
pub struct Grant {
    /// The tile and its lease.
    pub lease: Lease,
    /// The planned job.
    pub work: Arc<PlannedJob>,
    /// The numerics profile that the tile must be computed with.
    pub profile: String,
    /// Digests of the packs that the tile needs, in the plan's order of needed tiles; `None` for one that is
    /// not there.
    pub packs: Vec<Option<Digest>>,
    /// Time for the tile in milliseconds, when the job has a time budget.
    pub millis: Option<u64>,
}

/// A leader who can use a helper.
#[derive(Clone, Debug, PartialEq)]
pub struct Help {
    /// The leader's lease.
    pub lease: Lease,
    /// The planned job.
    pub work: Arc<PlannedJob>,
    /// The numerics profile of the job.
    pub profile: String,
}
