//! The coordinator: takes scenes and jobs, cuts jobs into tiles, leases tiles to workers, keeps what they give, and
//! puts the result together.
//!
//! Invariants: what is acknowledged is durable; a tile's first result stays; totals are derived from tile states; no
//! schedule, crash or repetition changes a result. It samples nothing itself.

pub mod assemble;
pub mod core;
mod jobs_service;
pub mod scene_facts;
pub mod scheduler;
pub mod server;
mod statistics;
mod status;
pub mod store;
mod streams;
mod summary;
mod workers_service;

pub use crate::core::{Config, Coordinator, OpenError};
pub use server::{ServeError, serve};
