//! The trait of a blob store, its readers and its writers.
//!
//! The name of a blob is the BLAKE3 digest of its bytes. A blob is complete under its name or absent. A blob
//! store does not know which blobs are still needed; the records of the [store](super::super::Store) do.

use std::fs::File;
use std::io::{self, Read, Write};
use std::time::SystemTime;

use sightline_records::ids::Digest;

use super::super::identity::StoreId;
use super::direct::Direct;
use super::error::BlobError;

/// The name of the file or object that contains the name of the store that owns the blobs.
pub(super) const OWNER: &str = "store-identity";

/// A reader of a blob whose digest was checked, positioned at the start of the blob.
pub struct BlobReader {
    /// The reader of the bytes.
    pub bytes: Box<dyn Read + Send>,
    /// The length of the blob, in bytes.
    pub length: u64,
}

/// A blob that [`Blobs::visit`] found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stored {
    /// The digest of the blob, which is its name.
    pub digest: Digest,
    /// The size of the blob, in bytes.
    pub bytes: u64,
    /// The time at which the blob was last written or put.
    pub written: SystemTime,
}

/// The number of bytes that a blob store has exchanged with its storage since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Carried {
    /// The number of bytes read from the storage.
    pub read: u64,
    /// The number of bytes written to the storage.
    pub written: u64,
}

/// A writer of a blob that arrives in pieces. A blob that is not finished is discarded.
///
/// The errors of [`Write`] contain a [`BlobError`], which [`Blobs::io_error`] extracts.
pub trait BlobWriter: Write + Send {
    /// Appends the next piece.
    ///
    /// # Errors
    /// The error of the write. Then drop the writer and begin again.
    fn append(&mut self, bytes: &[u8]) -> Result<(), BlobError>;

    /// Returns the number of bytes added so far.
    fn length(&self) -> u64;

    /// Publishes the blob, which is durable when this returns its digest.
    ///
    /// # Errors
    /// [`BlobError::Mismatch`] if the blob does not have the `expected` digest, or the error of the write.
    fn finish(self: Box<Self>, expected: Option<&Digest>) -> Result<Digest, BlobError>;
}

/// A store of blobs.
///
/// All calls block. Do not call them on async threads.
pub trait Blobs: Send + Sync {
    /// Returns a blob's size in bytes, or `None` if it is absent. Does not check for damage.
    fn len(&self, digest: &Digest) -> Result<Option<u64>, BlobError>;

    /// Returns true if a blob is present. Does not check for damage; [`Blobs::read`] does.
    fn has(&self, digest: &Digest) -> Result<bool, BlobError> {
        Ok(self.len(digest)?.is_some())
    }

    /// Reads a whole blob and checks its digest.
    fn read(&self, digest: &Digest) -> Result<Vec<u8>, BlobError>;

    /// Checks a blob's digest and opens it. A blob in a file is not loaded into memory.
    fn open_checked(&self, digest: &Digest) -> Result<BlobReader, BlobError>;

    /// Writes a blob, which is durable when this returns its digest. Replaces a damaged blob of the same
    /// name.
    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError>;

    /// Writes a blob as [`Blobs::put`] does, without a sync, for data that its sender still has.
    ///
    /// After a power failure the blob may be absent or truncated, and [`Blobs::read`] reports that.
    fn put_unsynced(&self, bytes: &[u8]) -> Result<Digest, BlobError>;

    /// Begins a blob that arrives in pieces.
    fn put_stream(&self) -> Result<Box<dyn BlobWriter>, BlobError>;

    /// Calls `visit` for every blob, in any order. `visit` receives the size of the blob and the time at
    /// which it was last written or put. Ends when `visit` returns false.
    fn visit(&self, visit: &mut dyn FnMut(Stored) -> bool) -> Result<(), BlobError>;

    /// Returns the time at which a blob was last written or put, or `None` if it is absent.
    fn written(&self, digest: &Digest) -> Result<Option<SystemTime>, BlobError>;

    /// Removes a blob. Returns true if the blob was present.
    fn remove(&self, digest: &Digest) -> Result<bool, BlobError>;

    /// Returns the name of the store that the blobs belong to, or `None` before the first [`Blobs::claim`].
    fn owner(&self) -> Result<Option<StoreId>, BlobError>;

    /// Records durably that the blobs belong to a store. Replaces an earlier owner.
    fn claim(&self, store: StoreId) -> Result<(), BlobError>;

    /// Creates an empty, unnamed file for work that may exceed memory. The system deletes the file when it is
    /// closed. Returns `None` if the blobs themselves are in memory.
    fn scratch(&self) -> Result<Option<File>, BlobError>;

    /// Returns the interface for workers' direct access, or `None` if all data passes through the
    /// coordinator.
    fn direct(&self) -> Option<&dyn Direct> {
        None
    }

    /// Returns the numbers of bytes read and written over the network, or `None` if the blobs are on this
    /// machine.
    fn carried(&self) -> Option<Carried> {
        None
    }

    /// Extracts the blob error from an error of a [`Blobs::scratch`] file or of a [`BlobWriter`] used as
    /// [`Write`].
    fn io_error(&self, e: io::Error) -> BlobError;
}
