//! The coordinator: accepts scenes and jobs, divides jobs into tiles, leases tiles to workers, stores their
//! outputs and assembles the results.
//!
//! Invariants: an acknowledged change is durable; a tile's first result stays; totals are derived from the
//! states of tiles; no schedule, crash or repetition changes a result. The coordinator samples nothing
//! itself.
//!
//! Modules depend on each other in one direction: [`services`](serve) translate between gRPC and the subjects
//! (`jobs`, `workers`, `outputs`, `results`, `uploads`); the subjects decide; below them are the shared
//! state, the scheduler and the [store](sightline_store).
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
mod dispatch;
#[doc(hidden)]
pub mod fuzzing;
mod jobs;
mod kept;
mod lifecycle;
mod locks;
mod outputs;
mod quota;
mod records;
mod results;
mod services;
mod state;
mod telemetry;
mod uploads;
mod users;
mod workers;

#[cfg(test)]
mod tests;

pub use kept::{Retention, SceneQueries};
pub use lifecycle::{Config, OpenError};
pub use quota::{Quota, QuotaError, Quotas, bytes};
pub use services::{
    ConnectionLimits, Connections, FewDescriptors, Front, Listener, Probed, ReplicaError,
    ServeError, Tls, TlsError, TlsFiles, serve, serve_http, serve_probes,
};
pub use sightline_scheduler::choose_profile;
pub use state::{Coordinator, Leases};
pub use uploads::scenes::TakeError;
