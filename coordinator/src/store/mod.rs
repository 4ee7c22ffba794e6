//! The persistent state of a coordinator: records of scenes, jobs, tiles and the epoch, and blobs beside
//! them.
//!
//! The records are small; everything large (scenes, packs, tile results, `.pvs` files) lies beside them as
//! content-addressed files ([`Blobs`]). A record may name a blob by its digest: write the blob first.
//! Commands are atomic, and durable when they return. Totals are derived from tile states, never kept beside
//! them. Nothing here knows of leases, workers' liveness, plans or time: callers pass the time in.
//!
//! All calls block (for about one disk sync when they change anything): call them off the async threads.

mod api;
mod blobs;
mod checked;
mod commands;
mod compaction;
mod disk;
mod engine;
mod entries;
mod error;
#[doc(hidden)]
pub mod fuzzing;
mod identity;
mod journal;
mod limits;
mod live;
mod lock;
mod memory;
mod outcomes;
mod place;
mod postgres;
mod private;
mod records;
mod rules;
mod salvage;
mod sled_store;
mod table;
mod upkeep;
mod watermark;

#[cfg(test)]
mod conformance;
#[cfg(test)]
mod conformance_trust;
#[cfg(test)]
pub(crate) mod failing;
#[cfg(test)]
mod power_failures;

pub use api::Store;
pub use blobs::{
    Address, BlobError, BlobPlace, BlobReader, BlobWriter, Blobs, BucketPlace, Carried, Direct,
    FileBlobs, MemoryBlobs, ObjectBlobs, ObjectFolder, PlaceError, Staged, Stored, Ways,
};
pub use entries::Entry;
pub use error::{JournalError, StoreError};
pub use identity::{StoreId, StoreIdentity};
pub use limits::{
    MAX_FAILURES, MAX_HELPERS, MAX_IDENTIFIER_BYTES, MAX_NAME_BYTES, MAX_OWNER_BYTES, MAX_OWNERS,
    MAX_REASON_BYTES, MAX_REASONS, MAX_SIGNATURE_BYTES, MAX_SPEC_BYTES, MAX_TILES,
    MAX_WORKER_BYTES,
};
pub use lock::OwnDirectory;
pub use memory::MemoryStore;
pub use outcomes::{MAX_OUTCOME_BYTES, Outcomes};
pub use postgres::{DatabaseAddress, Leader, PostgresStore, Replica, Role};
pub use records::{
    CommitOutcome, JobPhase, JobRecord, JobState, NewJob, NextSpan, QuarantineRecord,
    RetentionStamp, SceneRecord, Submitted, TileCheck, TileFailure, TileRecord, TileResult,
    TileState, TileStats, TrustedSpan, owned_key, owned_request,
};
pub use salvage::Damage;
pub use sled_store::{Compacted, Repaired, SledStore, StoreInspection};

pub use crate::ids::Digest;
