//! The trait of a blob store, its readers and its writers.
//!
//! A blob has the BLAKE3 digest of its bytes as its name. It is complete under that name or absent. A blob
//! store does not know which blobs are still needed; the records of the [store](super::super::Store) do.

use std::fs::File;
use std::io::{self, Read, Write};
use std::time::SystemTime;

use sightline_records::ids::Digest;

use super::super::identity::StoreId;
use super::direct::Direct;
use super::error::BlobError;

/// The name of the file or object that names the owner of the blobs.
pub(super) const OWNER: &str = "store-identity";

/// A blob whose digest was checked, to be read from its start.
pub struct BlobReader {
    /// The bytes.
    pub bytes: Box<dyn Read + Send>,
    /// How many there are.
    pub length: u64,
}

/// A blob as [`Blobs::visit`] finds it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stored {
    /// Its name.
    pub digest: Digest,
    /// Its size.
    pub bytes: u64,
    /// When it was written or put last.
    pub written: SystemTime,
}

/// Bytes of blobs that a store has exchanged with where it keeps them, since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Carried {
    /// Read from there.
    pub read: u64,
    /// Written there.
    pub written: u64,
}

/// A blob that arrives in pieces. Nothing of it is kept unless it is finished.
///
/// The errors of [`Write`] carry a [`BlobError`]; [`Blobs::io_error`] takes it out again.
pub trait BlobWriter: Write + Send {
    /// Adds the next piece.
    ///
    /// # Errors
    /// When it cannot be written; then drop the writer and begin again.
    fn append(&mut self, bytes: &[u8]) -> Result<(), BlobError>;

    /// Bytes added so far.
    fn length(&self) -> u64;

    /// Publishes the blob, which is durable when this returns its digest.
    ///
    /// # Errors
    /// [`BlobError::Mismatch`] when it does not have the `expected` digest, or the error of writing it.
    fn finish(self: Box<Self>, expected: Option<&Digest>) -> Result<Digest, BlobError>;
}

/// A store of blobs.
///
/// All calls block; call them off the async threads.
pub trait Blobs: Send + Sync {
    /// A blob's size in bytes; `None` when it is absent. Does not check for damage.
    fn len(&self, digest: &Digest) -> Result<Option<u64>, BlobError>;

    /// Whether a blob is present. Does not check for damage; [`Blobs::read`] does.
    fn has(&self, digest: &Digest) -> Result<bool, BlobError> {
        Ok(self.len(digest)?.is_some())
    }

    /// Reads a whole blob and checks its digest.
    fn read(&self, digest: &Digest) -> Result<Vec<u8>, BlobError>;

    /// Checks a blob's digest and opens it, without holding it in memory where it is in a file.
    fn open_checked(&self, digest: &Digest) -> Result<BlobReader, BlobError>;

    /// Writes a blob, which is durable when this returns its digest. A damaged blob of that name is replaced.
    fn put(&self, bytes: &[u8]) -> Result<Digest, BlobError>;

    /// As [`Blobs::put`], but the blob may be absent or truncated after a power failure, which
    /// [`Blobs::read`] then reports. For data that its sender still has.
    fn put_unsynced(&self, bytes: &[u8]) -> Result<Digest, BlobError>;

    /// Begins a blob that arrives in pieces.
    fn put_stream(&self) -> Result<Box<dyn BlobWriter>, BlobError>;

    /// Calls `visit` for every blob, in any order, with its size and the time when it was written or put
    /// last. Ends when `visit` returns false.
    fn visit(&self, visit: &mut dyn FnMut(Stored) -> bool) -> Result<(), BlobError>;

    /// When a blob was written or put last; `None` when it is absent.
    fn written(&self, digest: &Digest) -> Result<Option<SystemTime>, BlobError>;

    /// Removes a blob; returns whether it was present.
    fn remove(&self, digest: &Digest) -> Result<bool, BlobError>;

    /// Returns the store that the blobs belong to, or `None` before the first [`Blobs::claim`].
    fn owner(&self) -> Result<Option<StoreId>, BlobError>;

    /// Records durably that the blobs belong to a store, in place of any earlier owner.
    fn claim(&self, store: StoreId) -> Result<(), BlobError>;

    /// An empty, unnamed file that the system deletes when it is closed, for work that may exceed memory;
    /// `None` where the blobs themselves are in memory.
    fn scratch(&self) -> Result<Option<File>, BlobError>;

    /// What workers do with the store by themselves; `None` where everything goes through the coordinator.
    fn direct(&self) -> Option<&dyn Direct> {
        None
    }

    /// The bytes that went over the network; `None` where blobs are on this machine.
    fn carried(&self) -> Option<Carried> {
        None
    }

    /// The blob error behind an error of a [`Blobs::scratch`] file or of a [`BlobWriter`] used as [`Write`].
    fn io_error(&self, e: io::Error) -> BlobError;
}
