//! Stored chunks that become one blob: a scene, or receivers.

use std::collections::BTreeMap;

use sightline_model::receivers::ReceiversError;
use sightline_proto::chunks::CHUNK_BYTES;
use sightline_records::ids::Digest;
use sightline_scene::SceneError;
use sightline_store::{BlobError, StoreError};

use crate::state::Coordinator;
use crate::users::quota_check::HavingError;

/// Maximum ratio of the bytes of a list of chunks and of the bytes that were sent for it. A scene repeats a
/// chunk where its bytes are equal for megabytes, which is the case for few of them.
const MAX_COPIES: u64 = 16;
/// Bytes of a list that may repeat a chunk as it likes.
const FEW_BYTES: u64 = 64 << 20;

/// An upload that does not become a scene, or receivers.
#[derive(Debug, thiserror::Error)]
pub(crate) enum UploadError {
    /// A chunk was never uploaded.
    #[error("a chunk is not here yet; ask MissingChunks which, put it, and try again")]
    ChunkMissing,
    /// A stored chunk was damaged and has been removed.
    #[error("a chunk was damaged and is gone; ask MissingChunks which, put it, and try again")]
    ChunkDamaged,
    /// The chunks do not make the announced whole.
    #[error("{0}")]
    Mismatch(BlobError),
    /// The whole is not a scene.
    #[error(transparent)]
    Scene(SceneError),
    /// The whole is not receivers.
    #[error(transparent)]
    Receivers(#[from] ReceiversError),
    /// The list of chunks is longer than what is taken.
    #[error(
        "the chunks have {bytes} bytes together, and at most {most} are taken; split what they are of"
    )]
    TooLong {
        /// Bytes of all chunks of the list.
        bytes: u64,
        /// Most that are taken.
        most: u64,
    },
    /// A chunk is longer than a chunk may be.
    #[error("a chunk of {bytes} bytes is in the list; chunks have at most {most}")]
    LongChunk {
        /// The length of the chunk.
        bytes: u64,
        /// The bound.
        most: u64,
    },
    /// The list names the same chunks again and again.
    #[error(
        "the list makes {bytes} bytes of chunks that have {sent} together, and at most {most} times as many \
         are accepted; send a scene without that many copies"
    )]
    Repeated {
        /// Bytes of all chunks of the list.
        bytes: u64,
        /// Bytes of the chunks, each counted once.
        sent: u64,
        /// The bound of their ratio.
        most: u64,
    },
    /// The user may not have more.
    #[error(transparent)]
    Having(#[from] HavingError),
    /// A blob cannot be read or written.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// The bytes of a whole that is here already. A damaged one is removed, so that its chunks are missing and
/// the client sends them again: workers would fetch it for ever.
pub(crate) fn here(
    c: &Coordinator,
    whole: Digest,
    chunks: &[Digest],
) -> Result<Option<Vec<u8>>, UploadError> {
    // A whole of one chunk has its chunk's digest, and chunks are not synced: it is written again.
    if chunks == [whole] || !c.blobs.has(&whole)? {
        return Ok(None);
    }
    match c.blobs.read(&whole) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(e) if e.is_broken() => {
            tracing::warn!("{e}; it is uploaded again now");
            c.blobs.remove(&whole)?;
            Ok(None)
        }
        Err(e) => Err(e.into()),
    }
}

/// The lengths of the chunks of a list, in bytes.
pub(crate) struct ListBytes {
    /// The bytes of all chunks of the list.
    pub(crate) all: u64,
    /// The bytes of the chunks, each counted once.
    pub(crate) distinct: u64,
}

/// Returns the bytes of the chunks of a list that an owner may join. An owner of the whole need not have sent
/// them again.
pub(crate) fn announced(
    c: &Coordinator,
    owner: &str,
    owned: bool,
    chunks: &[Digest],
    most: u64,
) -> Result<ListBytes, UploadError> {
    if !owned && !chunks.iter().all(|chunk| c.uploads.has(owner, chunk)) {
        return Err(UploadError::ChunkMissing);
    }
    // A list may name a chunk many times, so its length is looked at before anything is written.
    let mut lengths = BTreeMap::new();
    let mut bytes: u64 = 0;
    for chunk in chunks {
        let length = match lengths.get(chunk) {
            Some(length) => *length,
            None => c.blobs.len(chunk)?.ok_or(UploadError::ChunkMissing)?,
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

/// A whole of chunks.
pub(crate) struct Joined {
    whole: Digest,
    /// Its bytes.
    pub(crate) bytes: Vec<u8>,
    /// Whether it was there before; a chunk that is the whole was stored as a chunk.
    pub(crate) was_there: bool,
}

/// Writes stored chunks as one blob, and reads it.
pub(crate) fn join(
    c: &Coordinator,
    whole: Digest,
    chunks: &[Digest],
) -> Result<Joined, UploadError> {
    let was_there = c.blobs.has(&whole)? && chunks != [whole];
    let mut writer = c.blobs.put_stream()?;
    for chunk in chunks {
        if !c.blobs.has(chunk)? {
            return Err(UploadError::ChunkMissing);
        }
        match c.blobs.read(chunk) {
            Ok(bytes) => writer.append(&bytes)?,
            // Chunks are not synced to the disk: after a power failure one may be truncated.
            Err(e) if e.is_broken() => {
                tracing::warn!("{e}; it is uploaded again now");
                c.blobs.remove(chunk)?;
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
        bytes: c.blobs.read(&whole)?,
        was_there,
    })
}

impl Joined {
    /// Removes an upload that is not what it should be; a blob that was there before may be somebody's
    /// result.
    pub(crate) fn discard(&self, c: &Coordinator, owner: &str, chunks: &[Digest]) {
        let new = forget_chunks(c, owner, self.whole, chunks);
        if !self.was_there && (chunks != [self.whole] || new == [self.whole]) {
            remove(c, &self.whole);
        }
    }
}

/// Removes the chunks of a whole, which are no longer needed, but for those that were there before their
/// owner sent them; returns the others. A single chunk is the whole, which stays.
pub(crate) fn forget_chunks(
    c: &Coordinator,
    owner: &str,
    whole: Digest,
    chunks: &[Digest],
) -> Vec<Digest> {
    let new = c.uploads.forget(owner, chunks);
    new.iter()
        .filter(|chunk| **chunk != whole)
        .for_each(|chunk| remove(c, chunk));
    new
}

fn remove(c: &Coordinator, digest: &Digest) {
    if let Err(e) = c.blobs.remove(digest) {
        tracing::warn!("{e}");
    }
}
