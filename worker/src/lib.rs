//! A worker: leases tiles from a coordinator, computes them, and streams the results back.
//!
//! A worker stores nothing on disk and decides nothing: the coordinator plans tiles, assigns them and
//! assembles their results. Killing a worker at any moment loses the work on its tiles and changes no result.
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use sightline_sampling::gpu::AdapterChoice;
//! use sightline_worker::{Backends, Choice, Config, SceneCache, Stop};
//!
//! # async fn example() -> Result<(), sightline_worker::WorkerError> {
//! let config = Config {
//!     coordinator: "http://127.0.0.1:7600".to_owned(),
//!     name: "worker 1".to_owned(),
//!     backends: Arc::new(Backends::probe(Choice::Auto, AdapterChoice::default())),
//!     scenes: Arc::new(SceneCache::default()),
//!     give_up_after: None,
//! };
//! let (stop, stopped) = tokio::sync::watch::channel(Stop::No);
//! sightline_worker::run(config, stopped).await?;
//! # drop(stop);
//! # Ok(())
//! # }
//! ```

pub mod backends;
mod packs;
mod scenes;
mod session;
mod tiles;

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;

pub use backends::{Backends, Choice};
pub use scenes::{Loaded, SceneCache};

/// The configuration of a worker.
#[derive(Clone)]
pub struct Config {
    /// The coordinator's address, such as `http://127.0.0.1:7600`.
    pub coordinator: String,
    /// Shown to users; unique among the workers of the coordinator.
    pub name: String,
    /// The backends that the worker may use.
    pub backends: Arc<Backends>,
    /// Cache of scenes and their hierarchies, shared by the workers of one process.
    pub scenes: Arc<SceneCache>,
    /// How long to retry when the coordinator cannot be reached; `None` for no limit.
    pub give_up_after: Option<Duration>,
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

/// Runs a worker until `stop` tells it to stop.
///
/// # Errors
/// [`WorkerError`] when the coordinator cannot be reached or refuses the worker.
pub async fn run(config: Config, stop: watch::Receiver<Stop>) -> Result<(), WorkerError> {
    session::Worker::new(config)?.run(stop).await
}
