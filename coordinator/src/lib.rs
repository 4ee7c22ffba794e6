//! The coordinator: takes scenes and jobs, divides jobs into tiles, leases tiles to workers, stores their
//! outputs and assembles the results.
//!
//! Invariants: an acknowledged change is durable; a tile's first result stays; totals are derived from the
//! states of tiles; no schedule, crash or repetition changes a result. The coordinator samples nothing
//! itself.
//!
//! Modules depend on each other in one direction: [`services`](serve) translate between gRPC and the subjects
//! (`submit`, `jobs`, `sessions`, `results`, `scenes`); the subjects decide; below them are the shared state,
//! the scheduler and the [`store`].
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
mod asking;
mod assemble;
mod assemble_pairs;
mod chores;
mod chronicle;
pub mod clock;
mod crews;
mod deleting;
mod direct;
mod estimate;
mod finishing;
mod found;
#[doc(hidden)]
pub mod fuzzing;
mod having;
mod housekeeping;
pub mod ids;
mod invalidating;
mod jobs;
mod joining;
pub mod keeping;
mod kept;
mod lease_tags;
mod lifecycle;
mod limits;
#[cfg(test)]
mod load;
mod lost;
mod metrics;
mod openness;
mod orders;
pub mod ownership;
mod partial;
mod readiness;
mod receivers;
mod releasing;
mod results;
mod retention_clock;
mod retention_stamp;
mod scene_files;
mod scenes;
mod scheduler;
mod scheduling;
mod services;
mod sessions;
mod spans;
mod specs;
mod spool;
mod staging;
mod state;
mod statistics;
pub mod store;
mod submit;
mod tiles;
mod turning;
mod uploads;
mod worker_identity;

#[cfg(test)]
mod ambient_tests;
#[cfg(test)]
mod reopening_tests;
#[cfg(test)]
mod retention_tests;
#[cfg(test)]
mod simulator;
#[cfg(test)]
mod staged_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod trust_tests;

pub use kept::{Answers, Retention};
pub use lifecycle::{Config, OpenError};
pub use limits::{Quota, QuotaError, Quotas, bytes};
pub use scenes::TakeError;
pub use services::{
    ConnectionLimits, Connections, FewDescriptors, Front, Listener, Probed, ReplicaError,
    ServeError, Tls, TlsError, TlsFiles, serve, serve_http, serve_probes,
};
pub use state::{Coordinator, Leases};
