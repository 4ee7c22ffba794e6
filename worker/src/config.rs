//! The configuration of a worker, the ways to stop it, and its errors.

use std::sync::Arc;
use std::time::Duration;

use sightline_model::receivers::Receivers;
use sightline_proto::connecting::Credentials;
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
    /// Whom it trusts and who it says it is.
    pub credentials: Credentials,
    /// Shown to users; unique among the workers of the coordinator.
    pub name: String,
    /// The backends that the worker may use.
    pub backends: Arc<Backends>,
    /// Cache of scenes and their hierarchies, shared by the workers of one process.
    pub scenes: Arc<SceneCache>,
    /// Cache of the receivers of ambient occlusion, by their digest and the number of their scene's
    /// triangles, shared like the scenes.
    pub receivers: Arc<SharedCache<([u8; 32], u32), Receivers>>,
    /// Whether it helps other workers' tiles while it has none of its own: not where those workers share its
    /// threads.
    pub helps: bool,
    /// Whether it reads and writes the store of the blobs by itself where the coordinator offers that.
    pub direct: bool,
    /// How long to retry when the coordinator cannot be reached; `None` for no limit.
    pub give_up_after: Option<Duration>,
    /// What it tells of itself.
    pub counters: Arc<WorkerCounters>,
    /// Where spans of its tiles go, if their coordinator sends traces, too.
    pub traces: Traces,
}

/// Tells a worker whether and how to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stop {
    /// Continue.
    No,
    /// Finish the running tile, give back tiles that have not begun, and take no more (SIGTERM).
    Drain,
    /// Stop at once; the held tiles are lost.
    Now,
}

/// Why a worker ended before it was told to.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The given address is not valid.
    #[error("{0} is not a coordinator's address: {1}; give one such as http://127.0.0.1:7600")]
    Address(String, String),
    /// The coordinator could not be reached for longer than `give_up_after`.
    #[error(
        "the coordinator at {address} cannot be reached: {reason}; check that `sightline coordinator` runs \
            there and that the port is open"
    )]
    Unreachable {
        /// Its address.
        address: String,
        /// The last error.
        reason: String,
    },
    /// The system has no random numbers.
    #[error("the system gave no random number ({0}); check that /dev/urandom is there")]
    Random(String),
    /// The coordinator refused this worker.
    #[error("the coordinator refused this worker: {0}")]
    Refused(String),
}
