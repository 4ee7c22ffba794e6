//! What can go wrong with blobs, and what to do about it.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustix::io::Errno;
use sightline_records::ids::Digest;

use super::super::identity::StoreId;

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
    /// The disk has the blob and does not give its bytes.
    #[error(
        "blob {} cannot be read: {source}; it must be uploaded or computed again; check the disk",
        .path.display()
    )]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: Arc<io::Error>,
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
    /// The record of the blobs' owner cannot be understood.
    #[error(
        "{} names no store (32 hexadecimal digits are expected); if these blobs belong to this coordinator, \
         run `sightline store verify --claim-blobs` with its --data-dir, --store and --blobs",
        .path.display()
    )]
    Owner {
        /// The file or object.
        path: PathBuf,
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

/// Parses the record of the blobs' owner at `path`.
pub(super) fn parse_owner(bytes: &[u8], path: &Path) -> Result<StoreId, BlobError> {
    let text = std::str::from_utf8(bytes).unwrap_or_default();
    text.trim_end().parse().map_err(|()| BlobError::Owner {
        path: path.to_owned(),
    })
}

impl BlobError {
    /// Whether there is a blob that is of no use: it can be removed or replaced.
    pub fn is_broken(&self) -> bool {
        matches!(self, Self::Damaged { .. } | Self::Unreadable { .. })
    }

    /// Whether the blob must be uploaded or computed again.
    pub fn is_lost(&self) -> bool {
        self.is_broken() || matches!(self, Self::Missing { .. })
    }

    /// Whether the same may succeed later without anybody changing a blob: what needs it waits.
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

/// A function that turns an error of the system, met while `doing` something to `path`, into a [`BlobError`].
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

/// Whether the disk cannot read a file, or the file system finds it damaged. Other errors are of the machine
/// or the permissions, and say nothing about the file.
fn is_of_the_disk(e: &io::Error) -> bool {
    let of_the_disk = [Errno::IO, Errno::UCLEAN, Errno::BADMSG].map(Errno::raw_os_error);
    e.raw_os_error()
        .is_some_and(|number| of_the_disk.contains(&number))
}

/// Checks the digest of what was written against the one announced.
///
/// # Errors
/// [`BlobError::Mismatch`].
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
