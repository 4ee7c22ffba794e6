//! The persistent state of a coordinator: records of scenes, jobs, tiles and the epoch, and their
//! blobs.
//!
//! The records are small; everything large (scenes, packs, tile results, `.pvs` files) is in
//! content-addressed files ([`Blobs`]). A record may name a blob by its digest: write the blob first.
//! Commands are atomic, and durable when they return. Totals are derived from tile states, never
//! stored. The store does not depend on leases, connections of workers, plans or clocks: callers pass the
//! time in.
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
pub use outcomes::{MAX_OUTCOME_BYTES, Outcomes};
pub use postgres::{DatabaseAddress, Leader, PostgresStore, Replica, Role};
pub use salvage::Damage;
pub use sled_store::{Compacted, Repaired, SledStore, StoreInspection};
pub use untrusted::{TileFilter, untrusted_tiles};
