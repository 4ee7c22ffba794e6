//! Large, content-addressed data beside the records: scenes, their chunks, packs, tile results, `.pvs` files.

mod api;
mod files;
mod memory;
mod object;

#[cfg(test)]
mod conformance;

pub use api::{BlobError, BlobReader, BlobWriter, Blobs, Stored};
pub use files::FileBlobs;
pub use memory::MemoryBlobs;
pub use object::{BlobPlace, BucketPlace, ObjectBlobs, PlaceError};
