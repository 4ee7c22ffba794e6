//! Scenes: uploaded in chunks or handed over in memory, checked, recorded, and the facts that planning needs.

use std::sync::{Arc, PoisonError};

use sightline_model::receivers::ReceiversError;
use sightline_scene::{Aabb, Scene, SceneError};

use crate::access::Caller;
use crate::having::{HavingError, may_have, may_send, turn_of};
use crate::ids::Digest;
use crate::limits::Usage;
use crate::metrics::Cache;
use crate::state::{Coordinator, SceneFacts};
use crate::store::{BlobError, SceneRecord, StoreError};

/// Most bytes of a scene, which is in memory while it is checked.
const MOST_BYTES: u64 = 16 << 30;

/// The facts of a stored scene cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FactsError {
    /// The scene's blob cannot be read.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The blob is not a scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// A scene cannot be stored.
#[derive(Debug, thiserror::Error)]
pub enum TakeError {
    /// Its blob cannot be written.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// Its record cannot be written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The user may not have more.
    #[error(transparent)]
    Having(#[from] HavingError),
}

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
    #[error("the chunks have {bytes} bytes together, and at most {most} are taken; split what they are of")]
    TooLong {
        /// Bytes of all chunks of the list.
        bytes: u64,
        /// Most that are taken.
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

impl Coordinator {
    /// Stores a scene of this process as an upload would, without chunks and without reading it back.
    ///
    /// # Errors
    /// When its blob or its record cannot be written.
    pub fn take_scene(&self, scene: &Scene) -> Result<Digest, TakeError> {
        self.take_scene_of("", scene)
    }

    /// The same for a scene that a user has sent.
    pub(crate) fn take_scene_of(&self, owner: &str, scene: &Scene) -> Result<Digest, TakeError> {
        let bytes = scene.to_blob();
        let _turn = turn_of(self, owner);
        let more = Usage { bytes: bytes.len() as u64, scenes: 1, ..Usage::default() };
        may_have(self, owner, more, 0)?;
        let digest = self.blobs.put(&bytes)?;
        remember(self, digest, scene);
        self.store.record_scene(record_of(digest, bytes.len(), scene, owner))?;
        Ok(digest)
    }
}

/// Those of the digests that name no stored blob. What an owner has not sent is missing, whoever else has.
pub(crate) fn missing(
    c: &Coordinator,
    owner: &str,
    digests: Vec<Digest>,
) -> Result<Vec<Digest>, UploadError> {
    let mut missing = Vec::new();
    for digest in digests {
        let owned = || c.store.scene(&digest).map(|known| known.is_some_and(|s| s.owners.contains(owner)));
        if !(c.uploads.has(owner, &digest) || owned()?) || !c.blobs.has(&digest)? {
            missing.push(digest);
        }
    }
    Ok(missing)
}

/// Stores a chunk. It need not survive a power failure: its sender still has it.
pub(crate) fn put_chunk(c: &Coordinator, owner: &str, bytes: &[u8]) -> Result<Digest, UploadError> {
    may_send(c, owner, bytes.len() as u64)?;
    let was_there = c.blobs.has(blake3::hash(bytes).as_bytes())?;
    let digest = c.blobs.put_unsynced(bytes)?;
    // A message has at most a few megabytes.
    c.uploads.note(owner, digest, bytes.len() as u32, !was_there);
    Ok(digest)
}

/// Joins stored chunks to a scene, checks and records it, and removes the chunks.
pub(crate) fn put_scene(
    c: &Coordinator,
    owner: &str,
    whole: Digest,
    chunks: &[Digest],
) -> Result<SceneRecord, UploadError> {
    let known = c.store.scene(&whole)?;
    let owned = known.as_ref().is_some_and(|known| owner.is_empty() || known.owners.contains(owner));
    // A scene of one chunk has its chunk's digest, and chunks are not synced: it is written again below.
    if let Some(known) = known.filter(|_| owned)
        && chunks != [whole]
        && c.blobs.has(&whole)?
    {
        match c.blobs.read(&whole) {
            Ok(_) => return Ok(known),
            // Removed, so that its chunks are missing and the client sends them again: workers would fetch
            // the damaged scene for ever.
            Err(e) if e.is_broken() => {
                tracing::warn!("{e}; it is uploaded again now");
                c.blobs.remove(&whole)?;
            }
            Err(e) => return Err(e.into()),
        }
    }
    // Whose scene it is need not send it again.
    if !owned && !chunks.iter().all(|chunk| c.uploads.has(owner, chunk)) {
        return Err(UploadError::ChunkMissing);
    }
    // A list may name a chunk many times, so its length is looked at before anything is written.
    let bytes = length(c, chunks)?;
    if bytes > MOST_BYTES {
        return Err(UploadError::TooLong { bytes, most: MOST_BYTES });
    }
    let _turn = turn_of(c, owner);
    if !owned {
        may_have(c, owner, Usage { bytes, scenes: 1, ..Usage::default() }, bytes)?;
    }
    // A chunk that is the whole was stored as a chunk.
    let was_there = c.blobs.has(&whole)? && chunks != [whole];
    join(c, whole, chunks)?;
    let bytes = c.blobs.read(&whole)?;
    let scene = Scene::from_blob("uploaded scene", &bytes).map_err(|e| {
        discard(c, owner, (whole, was_there), chunks);
        UploadError::Scene(e)
    })?;
    remember(c, whole, &scene);
    let record = record_of(whole, bytes.len(), &scene, owner);
    c.store.record_scene(record.clone())?;
    // The whole is kept; its chunks are no longer needed, but for those that were there before. A single
    // chunk is the whole.
    for chunk in c.uploads.forget(owner, chunks).iter().filter(|chunk| **chunk != whole) {
        remove(c, chunk);
    }
    Ok(record)
}

/// Removes an upload that is not what it should be; a blob that was there before may be somebody's result.
pub(crate) fn discard(c: &Coordinator, owner: &str, (whole, was_there): (Digest, bool), chunks: &[Digest]) {
    let new = c.uploads.forget(owner, chunks);
    if !was_there && (chunks != [whole] || new == [whole]) {
        remove(c, &whole);
    }
    new.iter().filter(|chunk| **chunk != whole).for_each(|chunk| remove(c, chunk));
}

/// Bytes of all chunks of a list.
pub(crate) fn length(c: &Coordinator, chunks: &[Digest]) -> Result<u64, UploadError> {
    let mut sum: u64 = 0;
    for chunk in chunks {
        sum = sum.saturating_add(c.blobs.len(chunk)?.ok_or(UploadError::ChunkMissing)?);
    }
    Ok(sum)
}

/// Writes stored chunks as one blob.
pub(crate) fn join(c: &Coordinator, whole: Digest, chunks: &[Digest]) -> Result<(), UploadError> {
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
    Ok(())
}

fn remove(c: &Coordinator, digest: &Digest) {
    if let Err(e) = c.blobs.remove(digest) {
        tracing::warn!("{e}");
    }
}

fn record_of(digest: Digest, bytes: usize, scene: &Scene, owner: &str) -> SceneRecord {
    let (triangles, objects) = (scene.len(), scene.objects().len() as u32);
    let owners = Some(owner.to_owned()).filter(|owner| !owner.is_empty()).into_iter().collect();
    SceneRecord { digest, bytes: bytes as u64, triangles, objects, owners }
}

/// The record of a scene that a caller may see. One that belongs to others does not exist.
///
/// # Errors
/// [`StoreError::UnknownScene`], or the store's.
pub(crate) fn known(c: &Coordinator, caller: &Caller, scene: Digest) -> Result<SceneRecord, StoreError> {
    let record = c.store.scene(&scene)?;
    let own = |record: &SceneRecord| caller.sees_all() || record.owners.contains(caller.owner());
    record.filter(own).ok_or(StoreError::UnknownScene { scene })
}

/// The bounds of a stored scene.
pub(crate) fn bounds(c: &Coordinator, scene: &Digest) -> Result<Aabb, FactsError> {
    let facts = facts(c, scene)?;
    Ok(facts.bounds)
}

/// The facts of a stored scene.
pub(crate) fn facts(c: &Coordinator, digest: &Digest) -> Result<Arc<SceneFacts>, FactsError> {
    let last = c.last_scene.lock().unwrap_or_else(PoisonError::into_inner).clone();
    match last {
        Some((d, facts)) if d == *digest => {
            c.metrics.looked("scene", Cache::Hit);
            Ok(facts)
        }
        _ => {
            c.metrics.looked("scene", Cache::Miss);
            let scene = Scene::from_blob("stored scene", &c.blobs.read(digest)?)?;
            Ok(remember(c, *digest, &scene))
        }
    }
}

/// Keeps the facts of a scene that is in memory.
fn remember(c: &Coordinator, digest: Digest, scene: &Scene) -> Arc<SceneFacts> {
    let (triangles, objects) = (scene.len(), scene.objects().to_vec());
    let (bounds, kinds, sources) = (scene.bounds(), scene.kinds().clone(), scene.sources().to_vec());
    let culled = !scene.sides().are_both();
    let facts = Arc::new(SceneFacts { triangles, objects, bounds, kinds, sources, culled });
    *c.last_scene.lock().unwrap_or_else(PoisonError::into_inner) = Some((digest, Arc::clone(&facts)));
    facts
}

#[cfg(test)]
mod tests {
    use sightline_scene::Triangle;

    use super::*;
    use crate::chronicle::Chronicle;
    use crate::clock::SystemClock;
    use crate::crews::Crews;
    use crate::ids::Epoch;
    use crate::scheduler::{Machine, Settings};
    use crate::state::Leases;
    use crate::store::{FileBlobs, MemoryStore, Outcomes};
    use sightline_scene::Object;

    #[test]
    fn a_scene_handed_over_in_memory_is_stored_and_a_damaged_blob_is_repaired() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = FileBlobs::open(directory.path()).unwrap();
        let store = Box::new(MemoryStore::new());
        let settings = Settings { epoch: Epoch(1), ttl: 1, stuck: 1, seed: 1, spot_check: 0.0, spot_seed: 0 };
        let scheduler = Machine::new(settings);
        let crews = Crews::new(Outcomes::nowhere());
        let (boxed, clock) = (Box::new(blobs.clone()), Box::new(SystemClock));
        let coordinator =
            Coordinator::of(Leases::default(), store, boxed, clock, (crews, Chronicle::nowhere()), scheduler);
        let triangle = Triangle { v: [glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y] };
        let objects = vec![Object { name: "all".to_owned(), first: 0, count: 1 }];
        let scene = Scene::new("test", vec![triangle], objects).unwrap();
        let place = blobs.path(&scene.digest().0);
        // Missing, there, altered, cut short.
        for before in [None, Some(scene.to_blob()), Some(b"halls".to_vec()), Some(Vec::new())] {
            if let Some(bytes) = before {
                std::fs::write(&place, bytes).unwrap();
            }
            let digest = coordinator.take_scene(&scene).unwrap();
            assert_eq!(digest, scene.digest().0);
            assert_eq!(coordinator.blobs.read(&digest).unwrap(), scene.to_blob());
            assert_eq!(facts(&coordinator, &digest).unwrap().triangles, 1);
            let record = coordinator.store.scene(&digest).unwrap().unwrap();
            assert_eq!((record.triangles, record.objects), (1, 1));
        }
    }
}
