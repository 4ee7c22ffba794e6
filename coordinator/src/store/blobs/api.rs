//! The trait of a blob store, its readers, its writers and its errors.
//!
//! A blob has the BLAKE3 digest of its bytes as its name. It is complete under that name or absent. A blob
//! store does not know which blobs are still needed; the records of the [store](super::super::Store) do.

use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use crate::ids::Digest;

/// An operation on a blob that failed.
#[derive(Clone, Debug, thiserror::Error)]
pub enum BlobError {
    /// The disk is full: take in no more data for now.
    #[error("no space left to write {}; free some and try again", .path.display())]
    NoSpace {
        /// The file that was being written.
        path: PathBuf,
    },
    /// The blob is absent.
    #[error("blob {} is missing; it must be uploaded or computed again", .path.display())]
    Missing {
        /// Where the blob would be.
        path: PathBuf,
    },
    /// The blob's bytes do not have the digest that is its name.
    #[error("blob {} is damaged; delete it, it must be uploaded or computed again", .path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
    },
    /// The bytes written do not have the digest that was announced.
    #[error("digest {expected} was announced, {found} arrived; send it again")]
    Mismatch {
        /// The digest announced, in hexadecimal.
        expected: String,
        /// The digest of the bytes that arrived, in hexadecimal.
        found: String,
    },
    /// The object store has no such bucket.
    #[error("there is no bucket for {place}; create it, or correct --blobs")]
    NoBucket {
        /// The bucket, with the prefix.
        place: String,
    },
    /// The object store does not accept the keys, or they may not do this.
    #[error(
        "the object store does not let us {doing} {place} ({reason}); check AWS_ACCESS_KEY_ID and \
         AWS_SECRET_ACCESS_KEY or the file that keys= names, and that they may list, read, write and delete \
         there"
    )]
    Refused {
        /// The operation.
        doing: &'static str,
        /// The object.
        place: String,
        /// The store's code.
        reason: String,
    },
    /// The object store does not answer, or is in trouble.
    #[error(
        "cannot {doing} {place}: the object store cannot be reached ({reason}); check the endpoint, its \
         certificate and the network, and try again"
    )]
    Unreachable {
        /// The operation.
        doing: &'static str,
        /// The object.
        place: String,
        /// What went wrong.
        reason: String,
    },
    /// The object store answers with another error.
    #[error(
        "cannot {doing} {place}: the object store answers {reason}; check that it speaks S3, and its log"
    )]
    Object {
        /// The operation.
        doing: &'static str,
        /// The object.
        place: String,
        /// The store's code.
        reason: String,
    },
    /// The settings of an object store cannot be used.
    #[error("{place} cannot be used: {reason}; correct --blobs or the variables AWS_*")]
    Unusable {
        /// The bucket, with the prefix.
        place: String,
        /// What is wrong.
        reason: String,
    },
    /// A file operation failed.
    #[error("cannot {doing} {}: {source}; check the disk and the permissions", .path.display())]
    Io {
        /// The operation.
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: Arc<io::Error>,
    },
}

impl BlobError {
    /// Whether the same may succeed later without anybody changing a blob: what needs it waits.
    pub fn passes(&self) -> bool {
        matches!(
            self,
            Self::NoSpace { .. } | Self::Unreachable { .. } | Self::Refused { .. } | Self::NoBucket { .. }
        )
    }
}

/// A function that turns an error of the system, met while `doing` something to `path`, into a [`BlobError`].
pub(super) fn fault(doing: &'static str, path: &Path) -> impl Fn(io::Error) -> BlobError {
    let path = path.to_owned();
    move |source| match source.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => BlobError::NoSpace { path: path.clone() },
        ErrorKind::NotFound if doing == "read" => BlobError::Missing { path: path.clone() },
        _ => BlobError::Io { doing, path: path.clone(), source: Arc::new(source) },
    }
}

/// Checks the digest of what was written against the one announced.
///
/// # Errors
/// [`BlobError::Mismatch`].
pub(super) fn check_announced(found: blake3::Hash, expected: Option<&Digest>) -> Result<Digest, BlobError> {
    match expected.map(|expected| blake3::Hash::from_bytes(*expected)) {
        Some(expected) if expected != found => Err(BlobError::Mismatch {
            expected: expected.to_hex().to_string(),
            found: found.to_hex().to_string(),
        }),
        _ => Ok(*found.as_bytes()),
    }
}

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

    /// An empty, unnamed file that the system deletes when it is closed, for work that may exceed memory;
    /// `None` where the blobs themselves are in memory.
    fn scratch(&self) -> Result<Option<File>, BlobError>;

    /// The blob error behind an error of a [`Blobs::scratch`] file or of a [`BlobWriter`] used as [`Write`].
    fn io_error(&self, e: io::Error) -> BlobError;
}
