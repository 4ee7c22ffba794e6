//! The errors of blob stores. Each message names a remedy.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustix::io::Errno;
use sightline_records::ids::Digest;

use super::super::identity::StoreId;

/// An error of an operation on a blob.
#[derive(Clone, Debug, thiserror::Error)]
pub enum BlobError {
    /// The disk is full. Accept no more data for now.
    #[error("no space left to write {}; free some space and try again", .path.display())]
    NoSpace {
        /// The path of the file that was being written.
        path: PathBuf,
    },
    /// The blob is absent.
    #[error("blob {} is missing; upload or compute the blob again", .path.display())]
    Missing {
        /// The path that the blob would have.
        path: PathBuf,
    },
    /// The blob's bytes do not have the digest that is its name.
    #[error("blob {} is damaged; delete the blob, and upload or compute it again", .path.display())]
    Damaged {
        /// The path of the file.
        path: PathBuf,
    },
    /// The disk contains the blob but does not return its bytes.
    #[error(
        "blob {} cannot be read: {source}; check the disk, and upload or compute the blob again",
        .path.display()
    )]
    Unreadable {
        /// The path of the file.
        path: PathBuf,
        /// The system's error.
        source: Arc<io::Error>,
    },
    /// The written bytes do not have the announced digest.
    #[error(
        "the announced digest is {expected}, but the received bytes have {found}; send the bytes again"
    )]
    Mismatch {
        /// The announced digest, in hexadecimal.
        expected: String,
        /// The digest of the bytes that arrived, in hexadecimal.
        found: String,
    },
    /// The object store has no bucket with this name.
    #[error("the bucket of {place} does not exist; create it, or correct --blobs")]
    NoBucket {
        /// The bucket, with the prefix.
        place: String,
    },
    /// The object store rejects the keys, or the keys do not permit this operation.
    #[error(
        "the object store denies permission to {doing} {place} ({reason}); check AWS_ACCESS_KEY_ID \
         and AWS_SECRET_ACCESS_KEY or the file of keys=, and their permissions to list, read, \
         write and delete"
    )]
    Refused {
        /// The operation.
        doing: &'static str,
        /// The object.
        place: String,
        /// The error code of the store.
        reason: String,
    },
    /// The object store does not answer, or reports an internal fault.
    #[error(
        "cannot {doing} {place}: the object store cannot be reached ({reason}); check the endpoint, its \
         certificate and the network, and try again"
    )]
    Unreachable {
        /// The operation.
        doing: &'static str,
        /// The object.
        place: String,
        /// The description of the fault.
        reason: String,
    },
    /// The object store answers with another error.
    #[error(
        "cannot {doing} {place}: the object store answers {reason}; check that the store supports \
         S3, and the log of the store"
    )]
    Object {
        /// The operation.
        doing: &'static str,
        /// The object.
        place: String,
        /// The error code of the store.
        reason: String,
    },
    /// The settings of an object store are invalid.
    #[error("{place} cannot be used: {reason}; correct --blobs or the variables AWS_*")]
    Unusable {
        /// The bucket, with the prefix.
        place: String,
        /// The description of the fault.
        reason: String,
    },
    /// The record of the blobs' owner is invalid.
    #[error(
        "{} does not name a store (32 hexadecimal digits are expected); if these blobs belong to \
         this coordinator, run `sightline store verify --claim-blobs` with its --data-dir, --store \
         and --blobs",
        .path.display()
    )]
    Owner {
        /// The path of the file or object.
        path: PathBuf,
    },
    /// A file operation failed.
    #[error("cannot {doing} {}: {source}; check the disk and the permissions", .path.display())]
    Io {
        /// The operation.
        doing: &'static str,
        /// The path of the file.
        path: PathBuf,
        /// The system's error.
        source: Arc<io::Error>,
    },
}

/// Parses the record of the blobs' owner at `path`.
pub(super) fn parse_owner(bytes: &[u8], path: &Path) -> Result<StoreId, BlobError> {
    let text = std::str::from_utf8(bytes).unwrap_or_default();
    text.trim_end().parse().map_err(|()| BlobError::Owner {
        path: path.to_owned(),
    })
}

impl BlobError {
    /// Returns true if a blob exists but is unusable. Such a blob can be removed or replaced.
    pub fn is_broken(&self) -> bool {
        matches!(self, Self::Damaged { .. } | Self::Unreadable { .. })
    }

    /// Returns true if the blob must be uploaded or computed again.
    pub fn is_lost(&self) -> bool {
        self.is_broken() || matches!(self, Self::Missing { .. })
    }

    /// Returns true if the operation may succeed later without a change to a blob. The caller can retry then.
    pub fn passes(&self) -> bool {
        matches!(
            self,
            Self::NoSpace { .. }
                | Self::Unreachable { .. }
                | Self::Refused { .. }
                | Self::NoBucket { .. }
        )
    }
}

/// Returns a function that converts a system error of an operation (`doing`) on `path` into a [`BlobError`].
pub(super) fn fault(doing: &'static str, path: &Path) -> impl Fn(io::Error) -> BlobError {
    let path = path.to_owned();
    move |source| match source.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            BlobError::NoSpace { path: path.clone() }
        }
        ErrorKind::NotFound if doing == "read" => BlobError::Missing { path: path.clone() },
        _ if doing == "read" && is_of_the_disk(&source) => BlobError::Unreadable {
            path: path.clone(),
            source: Arc::new(source),
        },
        _ => BlobError::Io {
            doing,
            path: path.clone(),
            source: Arc::new(source),
        },
    }
}

/// Returns true if the disk cannot read a file, or the file system reports damage to the file.
///
/// Other errors concern the machine or the permissions, and do not indicate damage to the file.
fn is_of_the_disk(e: &io::Error) -> bool {
    let of_the_disk = [Errno::IO, Errno::UCLEAN, Errno::BADMSG].map(Errno::raw_os_error);
    e.raw_os_error()
        .is_some_and(|number| of_the_disk.contains(&number))
}

/// Compares the digest of the written bytes with the announced digest, and returns the former.
///
/// # Errors
/// [`BlobError::Mismatch`] if the digests differ.
pub(super) fn check_announced(
    found: blake3::Hash,
    expected: Option<&Digest>,
) -> Result<Digest, BlobError> {
    match expected.map(|expected| blake3::Hash::from_bytes(*expected)) {
        Some(expected) if expected != found => Err(BlobError::Mismatch {
            expected: expected.to_hex().to_string(),
            found: found.to_hex().to_string(),
        }),
        _ => Ok(*found.as_bytes()),
    }
}
