//! A worker: leases tiles from a coordinator, computes them, and streams the results back.
//!
//! A worker stores nothing on disk. The coordinator plans tiles, assigns them and assembles their
//! results. Killing a worker at any moment loses the work on its tiles and changes no result.
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use sightline_proto::connecting::Credentials;
//! use sightline_trace::gpu::AdapterChoice;
//! use sightline_worker::{Backends, Config, SceneCache, Stop, TracerSelection};
//!
//! # async fn example() -> Result<(), sightline_worker::WorkerError> {
//! let config = Config {
//!     coordinator: "http://127.0.0.1:7600".to_owned(),
//!     credentials: Credentials::default(),
//!     name: "worker 1".to_owned(),
//!     backends: Arc::new(Backends::probe(TracerSelection::Auto, AdapterChoice::default())),
//!     scenes: Arc::new(SceneCache::default()),
//!     receivers: Arc::default(),
//!     helps: true,
//!     direct: true,
//!     give_up_after: None,
//!     counters: Arc::default(),
//!     traces: Default::default(),
//! };
//! let (stop, stopped) = tokio::sync::watch::channel(Stop::No);
//! sightline_worker::run(config, stopped).await?;
//! # drop(stop);
//! # Ok(())
//! # }
//! ```

pub mod backends;
mod config;
mod connect;
mod counters;
mod crew;
mod direct;
mod fetch;
mod leased_tile;
mod packs;
mod planned;
mod session;
mod shared_cache;
mod spans;
mod status;
mod tile_runner;
mod traced_scenes;
mod upload;

use tokio::sync::watch;

pub use backends::{Backends, TracerSelection};
pub use config::{Config, Stop, WorkerError};
pub use counters::{Moved, WorkerCounters};
pub use shared_cache::SharedCache;
pub use tile_runner::time_profiles;
pub use traced_scenes::{SceneCache, TracedScene};

/// Runs a worker until `stop` tells it to stop.
///
/// # Errors
/// [`WorkerError`] when the coordinator cannot be reached or refuses the worker.
pub async fn run(config: Config, stop: watch::Receiver<Stop>) -> Result<(), WorkerError> {
    session::Worker::new(config)?.run(stop).await
}
