//! The records of a coordinator: jobs, tiles, scenes and the trust in workers, with the numbers that identify
//! them. The store keeps records, the scheduler and the services of the coordinator use them.

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
