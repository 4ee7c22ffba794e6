//! The persistent state of a coordinator: records of scenes, jobs, tiles and the epoch, and their blobs.
//!
//! Records are small; scenes, packs, outputs and results are content-addressed [`Blobs`]. The store does not
//! depend on leases, connections of workers, plans or clocks: callers pass the time in. All calls block, for
//! about one disk sync if they change the state; call them off the async threads.
//!
//! # Modules
//!
//! - `api`, `engine`, `rules`, `commands`, `upkeep`: the trait [`Store`], its implementation over any ordered
//!   table, and the rules of its commands.
//! - `journal`, `watermark`, `compaction`, `salvage`, `sled_store`: the store on a disk ([`SledStore`]): an
//!   append-only journal holds the state, and sled is a view of it.
//! - `postgres`: [`PostgresStore`], which several coordinators share, and the election of their leader.
//! - `memory`: [`MemoryStore`], for tests.
//! - `blobs`: files, an object store, or memory; `direct` signs addresses for workers.
//! - `outcomes`: the outcomes of the phases of unfinished tiles.
//! - `table`, `entries`, `entry_checks`, `identity`, `limits`, `lock`, `private`: encodings, checks and
//!   directories.
//! - `conformance`: one suite of tests that runs over every implementation.
//!
//! # Invariants
//!
//! - Commands are atomic, and durable when they return. A blob is complete before a record names it. Chunks
//!   of a scene are not synced one by one; the assembled scene is synced before it is acknowledged.
//! - A blob has its digest as its name: it is complete under this name or absent. Its bytes are checked
//!   against the digest before a reader receives the first byte.
//! - Totals are derived from the states of tiles and never stored.
//! - On a shared database each change is a transaction that first claims the row of its leadership, which a
//!   take-over closes. An earlier leader therefore cannot change the state. If the connection is lost during
//!   a commit, the outcome is looked up (`docs/decisions/0013-postgresql-and-replicas.md`).
//!
//! # Limits
//!
//! - A journal in use is not compacted, only at the start.
//! - The stores on disk and in memory have one coordinator.

mod api;
mod blobs;
mod commands;
mod compaction;
mod disk;
mod engine;
mod entries;
mod entry_checks;
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
mod rules;
mod salvage;
mod sled_store;
mod table;
mod untrusted;
mod upkeep;
mod watermark;

#[cfg(test)]
mod conformance;
#[cfg(test)]
mod conformance_trust;
#[cfg(any(test, feature = "simulation"))]
#[doc(hidden)]
pub mod failing;
#[cfg(test)]
mod power_failures;

pub use api::{Queries, Store};
pub use blobs::{
    Address, BlobError, BlobPlace, BlobReader, BlobWriter, Blobs, BucketPlace, Carried, Direct,
    FileBlobs, MemoryBlobs, ObjectBlobs, ObjectFolder, PlaceError, Staged, Stored, Ways,
};
pub use entries::Entry;
pub use error::{JournalError, StoreError};
pub use identity::{StoreId, StoreIdentity};
pub use lock::OwnDirectory;
pub use memory::MemoryStore;
pub use outcomes::{MAX_OUTCOME_BYTES, OutcomeHeader, Outcomes};
pub use postgres::{DatabaseAddress, Leader, PostgresStore, Replica, Role};
pub use salvage::Damage;
pub use sled_store::{Compacted, Repaired, SledStore, StoreInspection};
pub use untrusted::{TileFilter, untrusted_tiles};
