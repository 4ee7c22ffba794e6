//! Scenes: uploaded in chunks or passed in memory, checked, recorded, and summarised for planning.

use std::sync::{Arc, PoisonError};

use sightline_assemble::SceneSummary;
use sightline_records::SceneRecord;
use sightline_records::ids::Digest;
use sightline_scene::{Aabb, Scene, SceneError};
use sightline_store::{BlobError, StoreError};

use crate::access::Caller;
use crate::coordinator::Coordinator;
use crate::quota::Usage;
use crate::records::Records;
use crate::telemetry::metrics::CacheOutcome;
use crate::uploads::complete::{ListBytes, UploadError, join, list_bytes, read_whole};
use crate::uploads::state::UploadState;
use crate::users::quota_check::{QuotaReservation, ReservationError, may_send};

/// Maximum size of a scene in bytes. The scene is in memory while it is checked.
const MOST_BYTES: u64 = 16 << 30;

/// The reason why the facts of a stored scene cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FactsError {
    /// The scene's blob cannot be read.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The blob is not a scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// The reason why a scene cannot be stored.
#[derive(Debug, thiserror::Error)]
pub enum TakeError {
    /// The scene's blob cannot be written.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The scene's record cannot be written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The scene exceeds the user's quota.
    #[error(transparent)]
    Quota(#[from] ReservationError),
}

impl Coordinator {
    /// Stores a scene from memory like an upload, without chunks and without reading it back.
    ///
    /// # Errors
    /// [`TakeError`] if the scene's blob or record cannot be written.
    pub fn take_scene(&self, scene: &Scene) -> Result<Digest, TakeError> {
        self.take_scene_of("", scene)
    }

    /// Stores a scene from memory like an upload of `owner`.
    pub(crate) fn take_scene_of(&self, owner: &str, scene: &Scene) -> Result<Digest, TakeError> {
        let bytes = scene.to_blob();
        let quota = QuotaReservation::begin(self, owner);
        let more = Usage {
            bytes: bytes.len() as u64,
            scenes: 1,
            ..Usage::default()
        };
        quota.reserve(more, 0)?;
        let digest = self.blobs.put(&bytes)?;
        self.uploads.remember_scene(digest, scene);
        self.records
            .record_scene(record_of(digest, bytes.len(), scene, owner))?;
        Ok(digest)
    }
}

/// Returns the digests that are missing for an owner. A blob that only other owners have uploaded is missing,
/// too.
pub(crate) fn missing(
    c: &Coordinator,
    owner: &str,
    digests: Vec<Digest>,
) -> Result<Vec<Digest>, UploadError> {
    let mut missing = Vec::new();
    for digest in digests {
        let owned = || {
            c.records
                .scene(&digest)
                .map(|known| known.is_some_and(|s| s.owners.contains(owner)))
        };
        if !(c.uploads.chunks.has(owner, &digest) || owned()?) || !c.blobs.has(&digest)? {
            missing.push(digest);
        }
    }
    Ok(missing)
}

/// Stores a chunk without syncing it. A chunk need not survive a power failure, because its sender still has
/// it.
pub(crate) fn put_chunk(c: &Coordinator, owner: &str, bytes: &[u8]) -> Result<Digest, UploadError> {
    may_send(c, owner, bytes.len() as u64)?;
    let was_there = c.blobs.has(blake3::hash(bytes).as_bytes())?;
    let digest = c.blobs.put_unsynced(bytes)?;
    // A message has at most a few megabytes, so the length fits.
    c.uploads
        .chunks
        .note(owner, digest, bytes.len() as u32, !was_there);
    Ok(digest)
}

/// Checks that an owner has uploaded the chunks of a new scene. The check is fast, so that the usual first
/// query of a client does not wait.
///
/// # Errors
/// [`UploadError::ChunkMissing`] if a chunk is missing, or [`UploadError::Store`] if the store fails.
pub(crate) fn check_sent(
    records: &Records,
    uploads: &UploadState,
    owner: &str,
    whole: Digest,
    chunks: &[Digest],
) -> Result<(), UploadError> {
    let known = records.scene(&whole)?;
    if known.is_some_and(|known| owner.is_empty() || known.owners.contains(owner)) {
        return Ok(());
    }
    uploads.check_sent(owner, chunks)
}

/// Joins stored chunks to a scene, checks and records the scene, and removes the chunks.
pub(crate) fn put_scene(
    c: &Coordinator,
    owner: &str,
    whole: Digest,
    chunks: &[Digest],
) -> Result<SceneRecord, UploadError> {
    let (uploads, blobs) = (&c.uploads, &*c.blobs);
    let known = c.records.scene(&whole)?;
    let owned = known
        .as_ref()
        .is_some_and(|known| owner.is_empty() || known.owners.contains(owner));
    if let Some(known) = known.filter(|_| owned)
        && read_whole(blobs, whole, chunks)?.is_some()
    {
        return Ok(known);
    }
    if !owned {
        uploads.check_sent(owner, chunks)?;
    }
    let ListBytes {
        all: bytes,
        distinct,
    } = list_bytes(blobs, chunks, MOST_BYTES)?;
    let quota = QuotaReservation::begin(c, owner);
    if !owned {
        quota.reserve(
            Usage {
                bytes,
                scenes: 1,
                ..Usage::default()
            },
            distinct,
        )?;
    }
    let joined = join(blobs, whole, chunks)?;
    let name = "uploaded scene";
    let checked = Scene::from_blob(name, &joined.bytes).and_then(|scene| {
        scene.check_reach(name)?;
        Ok(scene)
    });
    let scene = checked.map_err(|e| {
        joined.discard(uploads, blobs, owner, chunks);
        UploadError::Scene(e)
    })?;
    uploads.remember_scene(whole, &scene);
    let record = record_of(whole, joined.bytes.len(), &scene, owner);
    c.records.record_scene(record.clone())?;
    uploads.forget_chunks(blobs, owner, whole, chunks);
    Ok(record)
}

fn record_of(digest: Digest, bytes: usize, scene: &Scene, owner: &str) -> SceneRecord {
    let (triangles, objects) = (scene.len(), scene.objects().len() as u32);
    let owners = Some(owner.to_owned())
        .filter(|owner| !owner.is_empty())
        .into_iter()
        .collect();
    SceneRecord {
        digest,
        bytes: bytes as u64,
        triangles,
        objects,
        owners,
    }
}

/// Returns the record of a scene that a caller may see. A scene of another owner is reported as not existing.
///
/// # Errors
/// [`StoreError::UnknownScene`] if the scene does not exist, or another [`StoreError`] if the store fails.
pub(crate) fn known(
    records: &Records,
    caller: &Caller,
    scene: Digest,
) -> Result<SceneRecord, StoreError> {
    let record = records.scene(&scene)?;
    let own = |record: &SceneRecord| caller.sees_all() || record.owners.contains(caller.owner());
    record.filter(own).ok_or(StoreError::UnknownScene { scene })
}

/// Returns the bounds of a stored scene.
pub(crate) fn bounds(c: &Coordinator, scene: &Digest) -> Result<Aabb, FactsError> {
    let facts = facts(c, scene)?;
    Ok(facts.bounds)
}

/// Returns the facts of a stored scene, from the cache if possible.
pub(crate) fn facts(c: &Coordinator, digest: &Digest) -> Result<Arc<SceneSummary>, FactsError> {
    let last = c
        .uploads
        .last_scene
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .clone();
    match last {
        Some((d, facts)) if d == *digest => {
            c.telemetry
                .metrics
                .cache_request("scene", CacheOutcome::Hit);
            Ok(facts)
        }
        _ => {
            c.telemetry
                .metrics
                .cache_request("scene", CacheOutcome::Miss);
            let scene = Scene::from_blob("stored scene", &c.blobs.read(digest)?)?;
            Ok(c.uploads.remember_scene(*digest, &scene))
        }
    }
}

impl UploadState {
    /// Caches the summary of a scene that is in memory.
    fn remember_scene(&self, digest: Digest, scene: &Scene) -> Arc<SceneSummary> {
        let summary = Arc::new(SceneSummary::from(scene));
        *self
            .last_scene
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Some((digest, Arc::clone(&summary)));
        summary
    }
}

#[cfg(test)]
mod tests {
    use sightline_scene::Triangle;

    use super::*;
    use crate::clock::SystemClock;
    use crate::config::Leases;
    use sightline_scene::Object;
    use sightline_store::{FileBlobs, MemoryStore};

    #[test]
    fn scene_in_memory_is_stored_and_damaged_blob_is_repaired() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = FileBlobs::open(directory.path()).unwrap();
        let store = Box::new(MemoryStore::new());
        let (boxed, clock) = (Box::new(blobs.clone()), Box::new(SystemClock));
        let coordinator = Coordinator::new(Leases::default(), store, boxed, clock).unwrap();
        let triangle = Triangle {
            v: [glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y],
        };
        let objects = vec![Object {
            name: "all".to_owned(),
            first: 0,
            count: 1,
        }];
        let scene = Scene::new("test", vec![triangle], objects).unwrap();
        let place = blobs.path(&scene.digest().0);
        // The blob before the upload: missing, intact, altered, truncated.
        for before in [
            None,
            Some(scene.to_blob()),
            Some(b"halls".to_vec()),
            Some(Vec::new()),
        ] {
            if let Some(bytes) = before {
                std::fs::write(&place, bytes).unwrap();
            }
            let digest = coordinator.take_scene(&scene).unwrap();
            assert_eq!(digest, scene.digest().0);
            assert_eq!(coordinator.blobs.read(&digest).unwrap(), scene.to_blob());
            assert_eq!(facts(&coordinator, &digest).unwrap().triangles, 1);
            let record = coordinator.records.scene(&digest).unwrap().unwrap();
            assert_eq!((record.triangles, record.objects), (1, 1));
        }
    }
}
