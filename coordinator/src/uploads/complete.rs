//! Joining of stored chunks to one blob: a scene or receivers.

use std::collections::BTreeMap;

use sightline_model::receivers::ReceiversError;
use sightline_proto::chunks::CHUNK_BYTES;
use sightline_records::ids::Digest;
use sightline_scene::SceneError;
use sightline_store::{BlobError, Blobs, StoreError};

use crate::uploads::state::UploadState;
use crate::users::quota_check::ReservationError;

/// Maximum ratio of the bytes of a chunk list to the bytes that were uploaded for it. A scene repeats a chunk
/// only if its bytes repeat over megabytes, which is rare.
const MAX_COPIES: u64 = 16;
/// Maximum size of a list that may repeat chunks without a limit, in bytes.
const FEW_BYTES: u64 = 64 << 20;

/// The reason why an upload does not become a scene or receivers.
#[derive(Debug, thiserror::Error)]
pub(crate) enum UploadError {
    /// A chunk was never uploaded.
    #[error("a chunk is not uploaded yet; find it with MissingChunks, upload it, and try again")]
    ChunkMissing,
    /// A stored chunk was damaged and has been removed.
    #[error(
        "a chunk was damaged and is deleted; find it with MissingChunks, upload it, and try again"
    )]
    ChunkDamaged,
    /// The chunks do not have the announced digest.
    #[error("{0}")]
    Mismatch(BlobError),
    /// The joined bytes are not a scene.
    #[error(transparent)]
    Scene(SceneError),
    /// The joined bytes are not receivers.
    #[error(transparent)]
    Receivers(#[from] ReceiversError),
    /// The chunk list exceeds the maximum size.
    #[error("the chunks have {bytes} bytes together, but the maximum is {most}; split the file")]
    TooLong {
        /// The size of all chunks in the list, in bytes.
        bytes: u64,
        /// The maximum size, in bytes.
        most: u64,
    },
    /// A chunk exceeds the maximum length.
    #[error("the list contains a chunk of {bytes} bytes; the maximum is {most}")]
    LongChunk {
        /// The length of the chunk, in bytes.
        bytes: u64,
        /// The maximum length, in bytes.
        most: u64,
    },
    /// The chunk list repeats chunks too often.
    #[error(
        "the list expands chunks of {sent} bytes to {bytes} bytes, but the maximum is {most} times \
         their size; send a scene with fewer identical parts"
    )]
    Repeated {
        /// The size of all chunks in the list, in bytes.
        bytes: u64,
        /// The size of the chunks in bytes, each counted once.
        sent: u64,
        /// The maximum ratio of the two sizes.
        most: u64,
    },
    /// The upload exceeds the user's quota.
    #[error(transparent)]
    Quota(#[from] ReservationError),
    /// A blob cannot be read or written.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Reads the stored blob `whole`, or returns `None` if it is absent. A damaged blob is removed, so that its
/// chunks are missing and the client uploads them again. Otherwise, workers would request the damaged blob
/// forever.
pub(crate) fn read_whole(
    blobs: &dyn Blobs,
    whole: Digest,
    chunks: &[Digest],
) -> Result<Option<Vec<u8>>, UploadError> {
    // A blob of one chunk has the digest of the chunk, and chunks are not synced. So the blob is written
    // again.
    if chunks == [whole] || !blobs.has(&whole)? {
        return Ok(None);
    }
    match blobs.read(&whole) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(e) if e.is_broken() => {
            tracing::warn!("{e}; the client uploads the blob again");
            blobs.remove(&whole)?;
            Ok(None)
        }
        Err(e) => Err(e.into()),
    }
}

/// The sizes of a chunk list, in bytes.
pub(crate) struct ListBytes {
    /// The size of all chunks in the list, in bytes.
    pub(crate) all: u64,
    /// The size of the chunks in bytes, each counted once.
    pub(crate) distinct: u64,
}

/// Returns the sizes of a chunk list, in bytes.
///
/// # Errors
/// [`UploadError`] if a chunk is absent, or the list is too long or repeats chunks too often.
pub(crate) fn list_bytes(
    blobs: &dyn Blobs,
    chunks: &[Digest],
    most: u64,
) -> Result<ListBytes, UploadError> {
    // A list may repeat a chunk many times, so check the lengths before the first write.
    let mut lengths = BTreeMap::new();
    let mut bytes: u64 = 0;
    for chunk in chunks {
        let length = match lengths.get(chunk) {
            Some(length) => *length,
            None => blobs.len(chunk)?.ok_or(UploadError::ChunkMissing)?,
        };
        if length > CHUNK_BYTES as u64 {
            return Err(UploadError::LongChunk {
                bytes: length,
                most: CHUNK_BYTES as u64,
            });
        }
        lengths.insert(*chunk, length);
        bytes = bytes.saturating_add(length);
    }
    if bytes > most {
        return Err(UploadError::TooLong { bytes, most });
    }
    let sent: u64 = lengths.values().sum();
    if bytes > sent.saturating_mul(MAX_COPIES).max(FEW_BYTES) {
        return Err(UploadError::Repeated {
            bytes,
            sent,
            most: MAX_COPIES,
        });
    }
    Ok(ListBytes {
        all: bytes,
        distinct: sent,
    })
}

/// A blob that was joined from chunks.
pub(crate) struct Joined {
    whole: Digest,
    /// The bytes of the blob.
    pub(crate) bytes: Vec<u8>,
    /// True if the blob existed before. A single chunk that equals the blob was stored as a chunk and does
    /// not count.
    pub(crate) was_there: bool,
}

/// Writes stored chunks as one blob, and reads the blob.
pub(crate) fn join(
    blobs: &dyn Blobs,
    whole: Digest,
    chunks: &[Digest],
) -> Result<Joined, UploadError> {
    let was_there = blobs.has(&whole)? && chunks != [whole];
    let mut writer = blobs.put_stream()?;
    for chunk in chunks {
        if !blobs.has(chunk)? {
            return Err(UploadError::ChunkMissing);
        }
        match blobs.read(chunk) {
            Ok(bytes) => writer.append(&bytes)?,
            // Chunks are not synced to the disk, so a power failure may truncate them.
            Err(e) if e.is_broken() => {
                tracing::warn!("{e}; the client uploads the blob again");
                blobs.remove(chunk)?;
                return Err(UploadError::ChunkDamaged);
            }
            Err(e) => return Err(e.into()),
        }
    }
    writer.finish(Some(&whole)).map_err(|e| match e {
        e @ BlobError::Mismatch { .. } => UploadError::Mismatch(e),
        e => UploadError::Blob(e),
    })?;
    Ok(Joined {
        whole,
        bytes: blobs.read(&whole)?,
        was_there,
    })
}

impl Joined {
    /// Removes an invalid upload. A blob that existed before stays, because it may be another user's result.
    pub(crate) fn discard(
        &self,
        uploads: &UploadState,
        blobs: &dyn Blobs,
        owner: &str,
        chunks: &[Digest],
    ) {
        let new = uploads.forget_chunks(blobs, owner, self.whole, chunks);
        if !self.was_there && (chunks != [self.whole] || new == [self.whole]) {
            remove(blobs, &self.whole);
        }
    }
}

impl UploadState {
    /// Checks that an owner has uploaded all chunks of a list.
    ///
    /// # Errors
    /// [`UploadError::ChunkMissing`] if the owner has not uploaded a chunk.
    pub(crate) fn check_sent(&self, owner: &str, chunks: &[Digest]) -> Result<(), UploadError> {
        match chunks.iter().all(|chunk| self.chunks.has(owner, chunk)) {
            true => Ok(()),
            false => Err(UploadError::ChunkMissing),
        }
    }

    /// Removes the owner's records of the chunks of the blob `whole`, which are no longer needed. Returns the
    /// chunks that the owner's uploads have added to the store, and deletes them from the store. Chunks that
    /// the store contained before these uploads stay. A single chunk that equals the blob stays, too.
    pub(crate) fn forget_chunks(
        &self,
        blobs: &dyn Blobs,
        owner: &str,
        whole: Digest,
        chunks: &[Digest],
    ) -> Vec<Digest> {
        let new = self.chunks.forget(owner, chunks);
        new.iter()
            .filter(|chunk| **chunk != whole)
            .for_each(|chunk| remove(blobs, chunk));
        new
    }
}

fn remove(blobs: &dyn Blobs, digest: &Digest) {
    if let Err(e) = blobs.remove(digest) {
        tracing::warn!("{e}");
    }
}
