//! What workers do with a store of blobs by themselves: they read blobs and write outputs at addresses that
//! the coordinator signs, each for one kind of request, one object and a short time.
//!
//! A worker never writes under the name of a blob, because whatever has such a name has that digest. It
//! writes beside the blobs, and the coordinator puts what it has read and checked in place.

use std::fmt;
use std::time::{Duration, SystemTime};

use sightline_records::ids::{Digest, Lease, hex};

use super::error::BlobError;

/// A signed address. Whoever has it may make its request until it expires, so it is in no message, no event
/// and no log.
pub struct Address {
    /// The address, with its signature.
    pub url: String,
    /// The signed headers, which the request must have.
    pub headers: Vec<(&'static str, String)>,
    /// The time for which the store accepts it.
    pub lives: Duration,
}

impl fmt::Debug for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Address(…)")
    }
}

/// An output that a worker writes by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Staged {
    /// The lease under which it was computed.
    pub lease: Lease,
    /// SHA-256 of the output: the address is good for no other bytes.
    pub sha256: [u8; 32],
    /// Its length.
    pub bytes: u64,
}

impl Staged {
    /// The name of its object, which is no blob's.
    pub(super) fn name(&self) -> String {
        let Lease { job, tile, id } = self.lease;
        format!(
            "{job}-{tile}-{}-{}-{}",
            id.epoch.0,
            id.number,
            hex(&self.sha256)
        )
    }
}

/// A store of blobs that workers reach by themselves. All calls block.
pub trait Direct: Send + Sync {
    /// The authorities, as PEM, that are trusted for the store beside those of the system; empty for none.
    fn authorities(&self) -> &[u8];

    /// Where a blob is read.
    ///
    /// # Errors
    /// When there are no keys to sign with.
    fn reading(&self, digest: &Digest) -> Result<Address, BlobError>;

    /// Where an output is written.
    ///
    /// # Errors
    /// When there are no keys to sign with.
    fn writing(&self, staged: &Staged) -> Result<Address, BlobError>;

    /// Reads an output that a worker has written; never more than it has announced.
    ///
    /// # Errors
    /// [`BlobError::Missing`]; [`BlobError::Damaged`] when it has another length.
    fn read_staged(&self, staged: &Staged) -> Result<Vec<u8>, BlobError>;

    /// Makes a blob of an output that a worker has written and of which these are the bytes. Its object stays
    /// beside the blob.
    ///
    /// # Errors
    /// As [`put`](super::Blobs::put).
    fn adopt(&self, staged: &Staged, digest: &Digest, bytes: &[u8]) -> Result<(), BlobError>;

    /// Removes an output that a worker has written, whether it is there or not.
    ///
    /// # Errors
    /// When the store does not answer.
    fn discard(&self, staged: &Staged) -> Result<(), BlobError>;

    /// Removes the outputs of workers whose time `is_old`; returns how many.
    ///
    /// # Errors
    /// When the store does not answer.
    fn sweep(&self, is_old: &dyn Fn(SystemTime) -> bool) -> Result<u64, BlobError>;
}
