//! The receivers of jobs of ambient occlusion: uploaded in chunks as scenes are, checked, and kept as long as
//! a job names them.
//!
//! They have no record: the jobs that name them are their owners', and before there is a job they are their
//! sender's chunk.

use std::sync::{Arc, PoisonError};
use std::time::Duration;

use sightline_model::receivers::{self, MOST_BYTES, ReceiversError};
use sightline_records::ids::Digest;
use sightline_store::{BlobError, StoreError};

use crate::access::Caller;
use crate::jobs::stored_spec;
use crate::quota::Usage;
use crate::state::{Coordinator, StoredReceivers};
use crate::uploads::complete::{ListBytes, UploadError, announced, forget_chunks, here, join};
use crate::users::quota_check::{reserve_quota, turn_of};

/// Receivers that were stored longer ago than this are dated anew when a job names them: blobs that nobody
/// needs are removed after a day.
const OLD: Duration = Duration::from_secs(3600);

/// Receivers that cannot be had.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Fault {
    /// The caller has sent none with this digest.
    #[error(
        "no receivers with the digest {} are here; send them with PutReceivers and try again",
        blake3::Hash::from_bytes(*.0)
    )]
    Unknown(Digest),
    /// The blob is something else.
    #[error(transparent)]
    Receivers(#[from] ReceiversError),
    /// They cannot be read.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Whether an owner has sent receivers, or has a job that names them. Where nothing has an owner everybody
/// has.
fn is_owned(c: &Coordinator, owner: &str, digest: &Digest) -> Result<bool, StoreError> {
    if c.uploads.has(owner, digest) {
        return Ok(true);
    }
    let names = |spec: &[u8]| {
        stored_spec::receivers(spec).is_some_and(|ambient| ambient.receivers == digest)
    };
    Ok(c.store
        .jobs()?
        .iter()
        .any(|job| job.owner == owner && names(&job.spec)))
}

/// Joins stored chunks to receivers and checks them; removes the chunks.
pub(crate) fn put(
    c: &Coordinator,
    owner: &str,
    whole: Digest,
    chunks: &[Digest],
) -> Result<StoredReceivers, UploadError> {
    let owned = is_owned(c, owner, &whole)?;
    if owned && let Some(bytes) = here(c, whole, chunks)? {
        return Ok(remember(c, whole, &bytes)?);
    }
    let ListBytes {
        all: bytes,
        distinct,
    } = announced(c, owner, owned, chunks, MOST_BYTES)?;
    let _turn = turn_of(c, owner);
    // As chunks they count already.
    reserve_quota(
        c,
        owner,
        Usage {
            bytes,
            ..Usage::default()
        },
        distinct,
    )?;
    let joined = join(c, whole, chunks)?;
    let stored =
        remember(c, whole, &joined.bytes).inspect_err(|_| joined.discard(c, owner, chunks))?;
    let new = forget_chunks(c, owner, whole, chunks);
    let is_new = !joined.was_there && (chunks != [whole] || new.contains(&whole));
    // At most 2 GiB.
    c.uploads.note(owner, whole, bytes as u32, is_new);
    Ok(stored)
}

/// Stored receivers that a caller may name.
pub(crate) fn known(
    c: &Coordinator,
    caller: &Caller,
    digest: Digest,
) -> Result<StoredReceivers, Fault> {
    if !(caller.sees_all() || is_owned(c, caller.owner(), &digest)?) || !c.blobs.has(&digest)? {
        return Err(Fault::Unknown(digest));
    }
    stored(c, digest)
}

/// Stored receivers, whoever has sent them.
pub(crate) fn stored(c: &Coordinator, digest: Digest) -> Result<StoredReceivers, Fault> {
    let last = c
        .last_receivers
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .clone();
    match last {
        Some((of, stored)) if of == digest => Ok(stored),
        _ => Ok(remember(c, digest, &c.blobs.read(&digest)?)?),
    }
}

/// Checks receivers and keeps what is to be known of them.
fn remember(
    c: &Coordinator,
    digest: Digest,
    bytes: &[u8],
) -> Result<StoredReceivers, ReceiversError> {
    let facts = Arc::new(receivers::check(bytes)?);
    let stored = StoredReceivers {
        bytes: bytes.len() as u64,
        facts,
    };
    *c.last_receivers
        .lock()
        .unwrap_or_else(PoisonError::into_inner) = Some((digest, stored.clone()));
    Ok(stored)
}

/// Makes sure that receivers stay until the job that names them is recorded. The caller holds the turn.
pub(crate) fn hold(c: &Coordinator, digest: Digest) -> Result<(), Fault> {
    let written = c.blobs.written(&digest)?.ok_or(Fault::Unknown(digest))?;
    // A time in the future is wrong, and can become old at any moment.
    if written.elapsed().is_ok_and(|age| age < OLD) {
        return Ok(());
    }
    c.blobs.put(&c.blobs.read(&digest)?)?;
    Ok(())
}
