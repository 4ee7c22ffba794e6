//! The receivers of ambient occlusion jobs: uploaded in chunks like scenes, checked, and kept while a job
//! references them.
//!
//! Receivers have no record. The owners of the jobs that reference them own them. Before the first job, they
//! count as a chunk of their sender.

use std::sync::{Arc, PoisonError};
use std::time::Duration;

use sightline_model::receivers::{self, MOST_BYTES, ReceiversError};
use sightline_records::ids::Digest;
use sightline_store::{BlobError, Blobs, StoreError};

use crate::access::Caller;
use crate::coordinator::Coordinator;
use crate::jobs::stored_spec;
use crate::quota::Usage;
use crate::records::{JobChanges, Records};
use crate::uploads::complete::{ListBytes, UploadError, join, list_bytes, read_whole};
use crate::uploads::state::{StoredReceivers, UploadState};
use crate::users::quota_check::QuotaReservation;

/// The age from which on stored receivers receive a new time when a job references them. Retention removes
/// blobs without references after a day.
const OLD: Duration = Duration::from_secs(3600);

/// The reason why receivers cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StoredReceiversError {
    /// The caller has not uploaded receivers with this digest.
    #[error(
        "receivers with the digest {} are not stored; send them with PutReceivers and try again",
        blake3::Hash::from_bytes(*.0)
    )]
    Unknown(Digest),
    /// The blob does not contain receivers.
    #[error(transparent)]
    Receivers(#[from] ReceiversError),
    /// The blob cannot be read.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl UploadState {
    /// Returns true if an owner has uploaded the receivers, or has a job that references them. Without
    /// authentication, every client has the same owner.
    fn owns_receivers(
        &self,
        records: &Records,
        owner: &str,
        digest: &Digest,
    ) -> Result<bool, StoreError> {
        if self.chunks.has(owner, digest) {
            return Ok(true);
        }
        let names = |spec: &[u8]| {
            stored_spec::receivers(spec).is_some_and(|ambient| ambient.receivers == digest)
        };
        Ok(records
            .jobs()?
            .iter()
            .any(|job| job.owner == owner && names(&job.spec)))
    }

    /// Returns the stored receivers with this digest, regardless of their owner.
    pub(crate) fn receivers(
        &self,
        blobs: &dyn Blobs,
        digest: Digest,
    ) -> Result<StoredReceivers, StoredReceiversError> {
        let last = self
            .last_receivers
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        match last {
            Some((last, stored)) if last == digest => Ok(stored),
            _ => Ok(self.check_receivers(digest, &blobs.read(&digest)?)?),
        }
    }

    /// Checks receivers and caches their header.
    fn check_receivers(
        &self,
        digest: Digest,
        bytes: &[u8],
    ) -> Result<StoredReceivers, ReceiversError> {
        let facts = Arc::new(receivers::check(bytes)?);
        let stored = StoredReceivers {
            bytes: bytes.len() as u64,
            facts,
        };
        *self
            .last_receivers
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Some((digest, stored.clone()));
        Ok(stored)
    }
}

/// Joins stored chunks to receivers, checks the receivers, and removes the chunks.
pub(crate) fn put(
    c: &Coordinator,
    owner: &str,
    whole: Digest,
    chunks: &[Digest],
) -> Result<StoredReceivers, UploadError> {
    let (uploads, blobs) = (&c.uploads, &*c.blobs);
    let owned = uploads.owns_receivers(&c.records, owner, &whole)?;
    if owned && let Some(bytes) = read_whole(blobs, whole, chunks)? {
        return Ok(uploads.check_receivers(whole, &bytes)?);
    }
    if !owned {
        uploads.check_sent(owner, chunks)?;
    }
    let ListBytes {
        all: bytes,
        distinct,
    } = list_bytes(blobs, chunks, MOST_BYTES)?;
    let quota = QuotaReservation::begin(c, owner);
    // The chunks count already.
    quota.reserve(
        Usage {
            bytes,
            ..Usage::default()
        },
        distinct,
    )?;
    let joined = join(blobs, whole, chunks)?;
    let stored = uploads
        .check_receivers(whole, &joined.bytes)
        .inspect_err(|_| joined.discard(uploads, blobs, owner, chunks))?;
    let new = uploads.forget_chunks(blobs, owner, whole, chunks);
    let is_new = !joined.was_there && (chunks != [whole] || new.contains(&whole));
    // Receivers have at most 2 GiB.
    uploads.chunks.note(owner, whole, bytes as u32, is_new);
    Ok(stored)
}

/// Returns the stored receivers with this digest if a caller may reference them.
pub(crate) fn known(
    c: &Coordinator,
    caller: &Caller,
    digest: Digest,
) -> Result<StoredReceivers, StoredReceiversError> {
    let is_known = caller.sees_all()
        || c.uploads
            .owns_receivers(&c.records, caller.owner(), &digest)?;
    if !is_known || !c.blobs.has(&digest)? {
        return Err(StoredReceiversError::Unknown(digest));
    }
    c.uploads.receivers(&*c.blobs, digest)
}

/// Renews the time of receivers, so that they stay until the record of their job exists. The removal of
/// unreferenced blobs waits for the lock of `changes`.
pub(crate) fn hold(changes: &JobChanges<'_>, digest: Digest) -> Result<(), StoredReceiversError> {
    let blobs = &*changes.coordinator().blobs;
    let written = blobs
        .written(&digest)?
        .ok_or(StoredReceiversError::Unknown(digest))?;
    // A time in the future is wrong, and can become old at any moment.
    if written.elapsed().is_ok_and(|age| age < OLD) {
        return Ok(());
    }
    blobs.put(&blobs.read(&digest)?)?;
    Ok(())
}
