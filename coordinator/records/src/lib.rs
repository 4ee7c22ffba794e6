//! The records of a coordinator: jobs, tiles, scenes, quarantined workers, and the clocks of retention.
//!
//! The store (`coordinator/store`) stores records; the scheduler and the services of the coordinator use
//! them. This crate depends on no other crate of the project.
//!
//! # Modules
//!
//! - `records`: [`JobRecord`], [`TileRecord`], [`SceneRecord`], [`QuarantineRecord`], [`RetentionStamp`], and
//!   the states of jobs and tiles.
//! - [`ids`]: the numbers and digests that identify jobs, tiles, workers and leases.
//! - `limits`: maximum lengths of texts and lists in records.
//!
//! # Invariants
//!
//! - A record is small: scenes, packs, outputs and results are blobs, which records name by digests.
//! - The texts and lists of a record have maximum lengths.
//! - Specifications of jobs are opaque bytes here.

pub mod ids;
mod limits;
mod records;

pub use self::limits::{
    MAX_FAILURES, MAX_HELPERS, MAX_IDENTIFIER_BYTES, MAX_NAME_BYTES, MAX_OWNER_BYTES, MAX_OWNERS,
    MAX_REASON_BYTES, MAX_REASONS, MAX_SIGNATURE_BYTES, MAX_SPEC_BYTES, MAX_TILES,
    MAX_WORKER_BYTES,
};
pub use self::records::{
    CommitOutcome, JobPhase, JobRecord, JobState, NewJob, NextSpan, QuarantineRecord,
    RetentionStamp, SceneRecord, Submitted, TileCheck, TileFailure, TileRecord, TileResult,
    TileState, TileStats, TrustedSpan, hex_digest, owned_key, owned_request,
};
