//! Presigned addresses, with which workers read and write the blob store directly.

use std::time::Instant;

use sightline_records::ids::Digest;
use sightline_store::{Address, BlobError, Blobs, Staged};

use crate::coordinator::Coordinator;

/// Minimum size of a blob that workers read directly, in bytes. Smaller blobs are part of the answer, because
/// a request to the blob store takes longer.
const LEAST_READ: u64 = 64 << 10;

/// Returns the address from which a worker reads a blob of this length, or `None` if the blob goes through
/// the coordinator.
pub(crate) fn reading(c: &Coordinator, digest: &Digest, bytes: u64) -> Option<Address> {
    let direct = c.blobs.direct().filter(|_| bytes >= LEAST_READ)?;
    match direct.reading(digest) {
        Ok(address) => {
            c.telemetry.metrics.addressed("read");
            c.telemetry.metrics.went_directly("read", bytes);
            Some(address)
        }
        Err(e) => {
            // The coordinator may have a local copy of the blob, so the call continues.
            tracing::warn!("a worker receives no address of a blob: {e}");
            None
        }
    }
}

/// Returns the address to which the holder of a lease writes an output of at most `most` bytes. Returns
/// `None` if the output goes through the coordinator.
///
/// # Errors
/// [`BlobError`] if the blob store has no keys for signatures.
pub(crate) fn writing(
    c: &Coordinator,
    staged: &Staged,
    most: u64,
) -> Result<Option<Address>, BlobError> {
    let Some(direct) = c.blobs.direct() else {
        return Ok(None);
    };
    if staged.bytes > most
        || !c
            .dispatcher
            .read(|scheduler| scheduler.is_leased(&staged.lease))
    {
        return Ok(None);
    }
    let address = direct.writing(staged)?;
    if !c
        .uploads
        .presigned
        .claims(staged, Instant::now() + address.lives)
    {
        return Ok(None);
    }
    c.telemetry.metrics.addressed("write");
    Ok(Some(address))
}

/// Removes an output that was committed or rejected. If this fails, the sweep removes the output a day later.
pub(crate) fn discard(blobs: &dyn Blobs, staged: &Staged) {
    if let Some(direct) = blobs.direct()
        && let Err(e) = direct.discard(staged)
    {
        tracing::warn!("{e}; retention removes the object later");
    }
}
