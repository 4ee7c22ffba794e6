//! What workers read and write in the store of the blobs by themselves: who gets which address.

use std::time::Instant;

use sightline_records::ids::Digest;
use sightline_store::{Address, BlobError, Staged};

use crate::state::Coordinator;

/// Smaller blobs come with the answer to the call: a request to the store takes longer.
const LEAST_READ: u64 = 64 << 10;

/// Where a worker reads a blob of this length; `None` where that goes through the coordinator.
pub(crate) fn reading(c: &Coordinator, digest: &Digest, bytes: u64) -> Option<Address> {
    let direct = c.blobs.direct().filter(|_| bytes >= LEAST_READ)?;
    match direct.reading(digest) {
        Ok(address) => {
            c.metrics.addressed("read");
            c.metrics.went_directly("read", bytes);
            Some(address)
        }
        Err(e) => {
            // A copy of the blob may be here all the same.
            tracing::warn!("a worker has no address of a blob: {e}");
            None
        }
    }
}

/// Returns the address to which the holder of a lease writes an output of at most `most` bytes; `None` if the
/// output goes through the coordinator.
///
/// # Errors
/// When the store has no keys to sign with.
pub(crate) fn writing(
    c: &Coordinator,
    staged: &Staged,
    most: u64,
) -> Result<Option<Address>, BlobError> {
    let Some(direct) = c.blobs.direct() else {
        return Ok(None);
    };
    if staged.bytes > most || !c.lock().scheduler.is_leased(&staged.lease) {
        return Ok(None);
    }
    let address = direct.writing(staged)?;
    if !c.staging.claims(staged, Instant::now() + address.lives) {
        return Ok(None);
    }
    c.metrics.addressed("write");
    Ok(Some(address))
}

/// Removes an output that is committed or refused. What cannot be removed is swept a day later.
pub(crate) fn discard(c: &Coordinator, staged: &Staged) {
    if let Some(direct) = c.blobs.direct()
        && let Err(e) = direct.discard(staged)
    {
        tracing::warn!("{e}; it is removed later");
    }
}
