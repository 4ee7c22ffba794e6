//! The configuration of a worker, the ways to stop it, and its errors.

use std::sync::Arc;
use std::time::Duration;

use crate::backends::Backends;
use crate::scenes::SceneCache;

/// How a worker is set up.
#[derive(Clone)]
pub struct Config {
    /// The coordinator's address, such as `http://127.0.0.1:7600`.
    pub coordinator: String,
    /// Shown to people; unique among the workers of the coordinator.
    pub name: String,
    /// The backends it may use.
    pub backends: Arc<Backends>,
    /// Scenes and their hierarchies, shared by the workers of one process.
    pub scenes: Arc<SceneCache>,
    /// How long to go on trying when the coordinator cannot be reached; `None` for ever.
    pub give_up_after: Option<Duration>,
}

/// How a worker is told to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stop {
    /// It goes on.
    No,
    /// It finishes the tiles it holds and takes no more (SIGTERM).
    Drain,
    /// It drops what it holds.
    Now,
}

/// Why a worker ended before it was told to.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The coordinator's address is not one.
    #[error("{0} is not a coordinator's address: {1}; give one such as http://127.0.0.1:7600")]
    Address(String, String),
    /// The coordinator could not be reached for too long.
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
