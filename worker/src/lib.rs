//! A worker: leases tiles from a coordinator, computes them, and streams the results back.
//!
//! The coordinator plans tiles, assigns them and assembles their results. [`run`] connects with a [`Config`]
//! and returns when the worker has stopped.
//!
//! # Modules
//!
//! - `session`, `connect`, `status`: the stream to the coordinator, with grants, renewals and progress.
//! - `tile_runner`, `leased_tile`: one tile from grant to commit, under its lease.
//! - `fetch`, `upload`, `direct`: scenes, packs and outputs, through the coordinator or directly at signed
//!   addresses of an object store.
//! - `backends`, `traced_scenes`, `packs`, `planned`, `shared_cache`: tracers by numerics profile, and
//!   caches.
//! - `crew`: the streams of a crew, for its leader and its helpers.
//! - `config`, `counters`, `spans`: the configuration, metrics and spans.
//!
//! # Invariants
//!
//! - A worker stores nothing on disk. A killed worker loses the work on its tiles, and the result does not
//!   change.
//! - A worker keeps its last four planned jobs, so that it decodes and plans a job once for many tiles.
//! - Packs can be lost: a worker that needs a lost pack computes the pack again and checks its digest.
//! - Workers do not connect to each other: members of a crew exchange data through the coordinator.
//!
//! # Example
//!
//! ```no_run
//! use std::sync::Arc;
//!
//! use sightline_proto::connection::Credentials;
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
pub use counters::{TransferTotals, WorkerCounters};
pub use shared_cache::SharedCache;
pub use tile_runner::time_profiles;
pub use traced_scenes::{SceneCache, TracedScene};

/// Runs a worker until `stop` contains a command to stop.
///
/// # Errors
/// A [`WorkerError`] if the coordinator cannot be reached or rejects the worker.
pub async fn run(config: Config, stop: watch::Receiver<Stop>) -> Result<(), WorkerError> {
    session::Worker::new(config)?.run(stop).await
}
