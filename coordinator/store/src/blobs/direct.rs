//! Direct access of workers to a blob store: workers read blobs and write outputs at signed addresses.
//!
//! The coordinator signs each address for one kind of request, one object and a short time. A worker never
//! writes under the name of a blob, because the bytes under such a name must have that digest. The worker
//! writes to a separate object, and the coordinator copies that to the blob after it has read and checked the
//! bytes.

use std::fmt;
use std::time::{Duration, SystemTime};

use sightline_records::ids::{Digest, Lease, hex};

use super::error::BlobError;

/// A signed address. Every holder of the address can make its request until it expires, so messages, events
/// and logs never contain it.
pub struct Address {
    /// The URL with its signature.
    pub url: String,
    /// The signed headers, which the request must contain.
    pub headers: Vec<(&'static str, String)>,
    /// The time for which the store accepts the address after it was signed.
    pub lives: Duration,
}

impl fmt::Debug for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Address(…)")
    }
}

/// An output that a worker writes to the store directly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Staged {
    /// The lease under which the output was computed.
    pub lease: Lease,
    /// The SHA-256 digest of the output. The store accepts no other bytes at the address.
    pub sha256: [u8; 32],
    /// The length of the output, in bytes.
    pub bytes: u64,
}

impl Staged {
    /// Returns the name of the output's object, which is never the name of a blob.
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

/// A blob store that workers access directly. All calls block.
pub trait Direct: Send + Sync {
    /// Returns the certificate authorities, as PEM, that workers trust in addition to the system's; empty for
    /// none.
    fn authorities(&self) -> &[u8];

    /// Returns the address at which a worker reads a blob.
    ///
    /// # Errors
    /// An error if there are no keys to sign with.
    fn reading(&self, digest: &Digest) -> Result<Address, BlobError>;

    /// Returns the address at which a worker writes an output.
    ///
    /// # Errors
    /// An error if there are no keys to sign with.
    fn writing(&self, staged: &Staged) -> Result<Address, BlobError>;

    /// Reads an output that a worker has written, at most as many bytes as it has announced.
    ///
    /// # Errors
    /// [`BlobError::Missing`] if the output is absent; [`BlobError::Damaged`] if the output does not have the
    /// announced length.
    fn read_staged(&self, staged: &Staged) -> Result<Vec<u8>, BlobError>;

    /// Creates a blob from an output that a worker has written. `bytes` are the bytes of the output.
    ///
    /// The object of the output is not removed.
    ///
    /// # Errors
    /// The errors of [`put`](super::Blobs::put).
    fn adopt(&self, staged: &Staged, digest: &Digest, bytes: &[u8]) -> Result<(), BlobError>;

    /// Removes an output that a worker may have written.
    ///
    /// # Errors
    /// An error if the store does not answer.
    fn discard(&self, staged: &Staged) -> Result<(), BlobError>;

    /// Removes the outputs of workers whose write time satisfies `is_old`. Returns the number of removed
    /// outputs.
    ///
    /// # Errors
    /// An error if the store does not answer.
    fn sweep(&self, is_old: &dyn Fn(SystemTime) -> bool) -> Result<u64, BlobError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn debug_text_of_address_has_no_signature() {
        let address = Address {
            url: "https://farm/output?signature=secret".to_owned(),
            headers: vec![("x-amz-date", "secret".to_owned())],
            lives: Duration::from_secs(1),
        };
        assert_eq!(format!("{address:?}"), "Address(…)");
    }
}
