//! Scenes: uploaded in chunks or handed over in memory, checked, recorded, and the facts that planning needs.

use std::sync::{Arc, PoisonError};

use sightline_assemble::SceneSummary;
use sightline_records::SceneRecord;
use sightline_records::ids::Digest;
use sightline_scene::{Aabb, Scene, SceneError};
use sightline_store::{BlobError, StoreError};

use crate::access::Caller;
use crate::quota::Usage;
use crate::state::Coordinator;
use crate::telemetry::metrics::Cache;
use crate::uploads::complete::{ListBytes, UploadError, announced, forget_chunks, here, join};
use crate::users::quota_check::{HavingError, may_send, reserve_quota, turn_of};

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
        let more = Usage {
            bytes: bytes.len() as u64,
            scenes: 1,
            ..Usage::default()
        };
        reserve_quota(self, owner, more, 0)?;
        let digest = self.blobs.put(&bytes)?;
        remember(self, digest, scene);
        self.store
            .record_scene(record_of(digest, bytes.len(), scene, owner))?;
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
        let owned = || {
            c.store
                .scene(&digest)
                .map(|known| known.is_some_and(|s| s.owners.contains(owner)))
        };
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
    c.uploads
        .note(owner, digest, bytes.len() as u32, !was_there);
    Ok(digest)
}

/// Checks that an owner has sent the chunks of a new scene. Takes little time, so that the usual first
/// question of a client waits for nothing.
///
/// # Errors
/// [`UploadError::ChunkMissing`], or the store's errors.
pub(crate) fn check_sent(
    c: &Coordinator,
    owner: &str,
    whole: Digest,
    chunks: &[Digest],
) -> Result<(), UploadError> {
    let known = c.store.scene(&whole)?;
    let is_owned = known.is_some_and(|known| owner.is_empty() || known.owners.contains(owner));
    match is_owned || chunks.iter().all(|chunk| c.uploads.has(owner, chunk)) {
        true => Ok(()),
        false => Err(UploadError::ChunkMissing),
    }
}

/// Joins stored chunks to a scene, checks and records it, and removes the chunks.
pub(crate) fn put_scene(
    c: &Coordinator,
    owner: &str,
    whole: Digest,
    chunks: &[Digest],
) -> Result<SceneRecord, UploadError> {
    let known = c.store.scene(&whole)?;
    let owned = known
        .as_ref()
        .is_some_and(|known| owner.is_empty() || known.owners.contains(owner));
    if let Some(known) = known.filter(|_| owned)
        && here(c, whole, chunks)?.is_some()
    {
        return Ok(known);
    }
    let ListBytes {
        all: bytes,
        distinct,
    } = announced(c, owner, owned, chunks, MOST_BYTES)?;
    let _turn = turn_of(c, owner);
    if !owned {
        reserve_quota(
            c,
            owner,
            Usage {
                bytes,
                scenes: 1,
                ..Usage::default()
            },
            distinct,
        )?;
    }
    let joined = join(c, whole, chunks)?;
    let name = "uploaded scene";
    let checked = Scene::from_blob(name, &joined.bytes).and_then(|scene| {
        scene.check_reach(name)?;
        Ok(scene)
    });
    let scene = checked.map_err(|e| {
        joined.discard(c, owner, chunks);
        UploadError::Scene(e)
    })?;
    remember(c, whole, &scene);
    let record = record_of(whole, joined.bytes.len(), &scene, owner);
    c.store.record_scene(record.clone())?;
    forget_chunks(c, owner, whole, chunks);
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

/// The record of a scene that a caller may see. One that belongs to others does not exist.
///
/// # Errors
/// [`StoreError::UnknownScene`], or the store's.
pub(crate) fn known(
    c: &Coordinator,
    caller: &Caller,
    scene: Digest,
) -> Result<SceneRecord, StoreError> {
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
pub(crate) fn facts(c: &Coordinator, digest: &Digest) -> Result<Arc<SceneSummary>, FactsError> {
    let last = c
        .last_scene
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .clone();
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
fn remember(c: &Coordinator, digest: Digest, scene: &Scene) -> Arc<SceneSummary> {
    let facts = Arc::new(SceneSummary::from(scene));
    *c.last_scene.lock().unwrap_or_else(PoisonError::into_inner) =
        Some((digest, Arc::clone(&facts)));
    facts
}

#[cfg(test)]
mod tests {
    use sightline_scene::Triangle;

    use super::*;
    use crate::clock::SystemClock;
    use crate::state::Leases;
    use crate::telemetry::events::EventLog;
    use crate::workers::crews::Crews;
    use sightline_records::ids::Epoch;
    use sightline_scene::Object;
    use sightline_scheduler::{Scheduler, Settings};
    use sightline_store::{FileBlobs, MemoryStore, Outcomes, Store as _};

    #[test]
    fn a_scene_handed_over_in_memory_is_stored_and_a_damaged_blob_is_repaired() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = FileBlobs::open(directory.path()).unwrap();
        let store = Box::new(MemoryStore::new());
        let identity = store.identity().unwrap();
        let settings = Settings {
            epoch: Epoch(1),
            ttl: 1,
            stuck: 1,
            seed: 1,
            spot_check: 0.0,
            spot_seed: 0,
        };
        let scheduler = Scheduler::new(settings);
        let crews = Crews::new(Outcomes::nowhere());
        let (boxed, clock) = (Box::new(blobs.clone()), Box::new(SystemClock));
        let coordinator = Coordinator::of(
            Leases::default(),
            &identity,
            store,
            boxed,
            clock,
            (crews, EventLog::nowhere()),
            scheduler,
        );
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
        // Missing, there, altered, cut short.
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
            let record = coordinator.store.scene(&digest).unwrap().unwrap();
            assert_eq!((record.triangles, record.objects), (1, 1));
        }
    }
}
