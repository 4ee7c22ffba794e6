//! The coordinator: accepts scenes and jobs, divides jobs into tiles, leases tiles to workers, stores their
//! outputs and assembles the results.
//!
//! The coordinator does not sample, and depends on no tracer and no search. The library `sightline` answers
//! the questions that need either, through [`SceneQueries`].
//!
//! # Modules
//!
//! Modules depend on each other in one direction. The [`services`](serve) translate between gRPC or HTTP and
//! the *subjects*, which are the modules that decide. Below the subjects are the shared state, the scheduler
//! and the [store](sightline_store).
//!
//! - `services`: gRPC services, HTTP for browsers, connections of all listeners, and authorization of calls.
//! - `jobs`, `outputs`, `results`, `uploads`, `workers`, `users`, `blobs`: the subjects.
//! - `dispatch`: passes events to the scheduler and executes its effects.
//! - `records`: the store with the rights to change it.
//! - `access`, `quota`: tokens, scopes and owners; the limits of each user.
//! - `telemetry`: metrics, events and spans.
//! - `config`, `startup`, `coordinator`, `locks`, `clock`, `timekeeper`: the [`Config`], the start, the
//!   [`Coordinator`] and its locks and clocks.
//!
//! # Invariants
//!
//! - An acknowledged change is durable.
//! - A change of a record needs a right: every module may read the store, but commands are methods of the
//!   guards `JobChanges`, `OutputCommit` and `OutputRemoval`, which hold the locks. Debug builds check the
//!   order of the locks (`docs/decisions/0020-rights-to-change-records.md`).
//! - An output counts only under a lease that was granted: each lease has a tag that only coordinators of the
//!   store can make. Leases of an earlier epoch count while their tile is open.
//! - The first output of a tile stays. The same bytes again are accepted; different bytes are rejected,
//!   counted and logged.
//! - With tokens, a call is closed until a rule opens it. A path without a rule requires the scope `admin`.
//!   Data of other users looks like missing data, and jobs of different owners are never one job.
//! - The coordinator checks lease, announced length, quota and the sum over all uploads before it stores the
//!   first byte. All listeners limit handshakes, idle connections and unread answers, and reserve room for
//!   workers. Large uploads wait on the disk (`uploads/spool.rs`).
//! - No step of the wall clock deletes data: retention compares the wall clock with the monotonic clock and
//!   with the last time in the store, and pauses if they disagree.
//! - Only `OutputRemoval` removes outputs and results, if no record names them. The sweep of unknown blobs
//!   waits for one day after the last upload of a blob.
//! - Metrics, events and spans do not affect results. No state is derived from events. A full disk loses
//!   events, and a slow collector loses spans. The stream of the dashboard is made once for all watchers, at
//!   most once per second.
//!
//! # Limits
//!
//! - Encryption, authentication, quotas and spot checks are off by default (`docs/security.md`). Addresses
//!   other than loopback need certificates or `--allow-plaintext`.
//! - The coordinator cannot check whether a set is right; workers are trusted unless `--spot-check` computes
//!   tiles again.
//! - Events and the outcomes of phases are files of one coordinator, and do not follow a change of leaders.
//!
//! # Example
//!
//! ```
//! use sightline_coordinator::{Config, Coordinator};
//! use sightline_scene::{Object, Scene, Triangle};
//!
//! let directory = tempfile::tempdir()?;
//! let coordinator = Coordinator::open(Config::new(directory.path().to_owned()))?;
//! let triangle = Triangle { v: [glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y] };
//! let objects = vec![Object { name: "all".to_owned(), first: 0, count: 1 }];
//! let digest = coordinator.take_scene(&Scene::new("test", vec![triangle], objects)?)?;
//! // Jobs can now be submitted on the scene with this digest; `serve` offers the gRPC services for that.
//! assert_ne!(digest, [0; 32]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod access;
pub mod blobs;
pub mod clock;
mod config;
mod coordinator;
mod dispatch;
#[doc(hidden)]
pub mod fuzzing;
mod jobs;
mod locks;
mod outputs;
mod quota;
mod records;
mod results;
mod services;
mod startup;
mod telemetry;
mod timekeeper;
mod uploads;
mod users;
mod workers;

#[cfg(test)]
mod tests;

pub use config::{Config, Leases, Retention};
pub use coordinator::Coordinator;
pub use quota::{Quota, QuotaError, Quotas, bytes};
pub use results::state::SceneQueries;
pub use services::{
    ConnectionLimits, Connections, FewDescriptors, Front, Listener, Probed, ReplicaError,
    ServeError, Tls, TlsError, TlsFiles, serve, serve_http, serve_probes,
};
pub use sightline_scheduler::choose_profile;
pub use startup::OpenError;
pub use uploads::scenes::TakeError;
