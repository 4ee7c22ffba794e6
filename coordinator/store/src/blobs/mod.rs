//! Large, content-addressed data next to the records: scenes, their chunks, packs, tile results, `.pvs`
//! files.

mod api;
mod direct;
mod error;
mod files;
mod memory;
mod object;

#[cfg(test)]
mod conformance;

pub use api::{BlobReader, BlobWriter, Blobs, Carried, Stored};
pub use direct::{Address, Direct, Staged};
pub use error::BlobError;
pub use files::FileBlobs;
pub use memory::MemoryBlobs;
pub use object::{BlobPlace, BucketPlace, ObjectBlobs, ObjectFolder, PlaceError, Ways};
