//! The configuration of a worker, the ways to stop it, and its errors.

use std::sync::Arc;
use std::time::Duration;

use sightline_model::receivers::Receivers;
use sightline_proto::connection::Credentials;
use sightline_traces::Traces;

use crate::backends::Backends;
use crate::counters::WorkerCounters;
use crate::shared_cache::SharedCache;
use crate::traced_scenes::SceneCache;

/// The configuration of a worker.
#[derive(Clone)]
pub struct Config {
    /// The coordinator's address, such as `http://127.0.0.1:7600`.
    pub coordinator: String,
    /// The trusted authorities and the worker's own certificate or token.
    pub credentials: Credentials,
    /// The display name of the worker, unique among the workers of the coordinator.
    pub name: String,
    /// The backends that the worker may use.
    pub backends: Arc<Backends>,
    /// The cache of scenes and their hierarchies, shared by the workers of one process.
    pub scenes: Arc<SceneCache>,
    /// The cache of the receivers of ambient occlusion, shared like the scenes. The key is the digest of the
    /// receivers and the number of triangles of their scene.
    pub receivers: Arc<SharedCache<([u8; 32], u32), Receivers>>,
    /// True if the worker helps with tiles of other workers while it has no tile. Use false if the other
    /// workers share the threads of this worker.
    pub helps: bool,
    /// True if the worker accesses the blob store directly, if the coordinator offers that.
    pub direct: bool,
    /// The time for which the worker retries to reach the coordinator; `None` for no limit.
    pub give_up_after: Option<Duration>,
    /// The metrics of the worker.
    pub counters: Arc<WorkerCounters>,
    /// The sender of the worker's spans. Spans are sent only if the coordinator sends traces, too.
    pub traces: Traces,
}

/// A command to a worker to continue or to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stop {
    /// Continue.
    No,
    /// Finish the running tile, return tiles that have not begun, and accept no further tiles (SIGTERM).
    Drain,
    /// Stop at once; the held tiles are lost.
    Now,
}

/// An error that ended a worker before a command to stop.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The address of the coordinator is invalid.
    #[error("{0} is not a coordinator's address: {1}; give one such as http://127.0.0.1:7600")]
    Address(String, String),
    /// The coordinator could not be reached for longer than `give_up_after`.
    #[error(
        "the coordinator at {address} cannot be reached: {reason}; check that `sightline coordinator` runs \
            there and that the port is open"
    )]
    Unreachable {
        /// The address of the coordinator.
        address: String,
        /// The last error.
        reason: String,
    },
    /// The system returns no random numbers.
    #[error("the system returned no random number ({0}); check that /dev/urandom exists")]
    Random(String),
    /// The coordinator rejected the worker.
    #[error("the coordinator rejected this worker: {0}")]
    Refused(String),
}
