//! What the coordinator itself needs to know of a scene: counts, objects and bounds, without its triangles.

use std::sync::{Arc, Mutex, PoisonError};

use sightline_scene::{Aabb, Object, Scene, SceneError};

use crate::core::Coordinator;
use crate::store::{BlobError, Digest, SceneRecord, StoreError};

/// Facts about a scene.
pub(crate) struct SceneFacts {
    pub(crate) triangles: u32,
    pub(crate) objects: Vec<Object>,
    pub(crate) bounds: Aabb,
}

impl SceneFacts {
    fn of(scene: &Scene) -> Self {
        Self { triangles: scene.len(), objects: scene.objects().to_vec(), bounds: scene.bounds() }
    }
}

/// The facts of the scene asked for last: jobs on one scene come together.
#[derive(Default)]
pub(crate) struct LastScene(Mutex<Option<(Digest, Arc<SceneFacts>)>>);

/// Why they cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum FactsError {
    /// The scene's blob cannot be read.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// It is not a scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// Why a scene cannot be stored.
#[derive(Debug, thiserror::Error)]
pub enum TakeError {
    /// Its blob cannot be written.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// It cannot be recorded.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl Coordinator {
    /// Remembers a scene that is at hand anyway.
    pub(crate) fn remember(&self, digest: Digest, scene: &Scene) -> Arc<SceneFacts> {
        let facts = Arc::new(SceneFacts::of(scene));
        *self.last_scene.0.lock().unwrap_or_else(PoisonError::into_inner) =
            Some((digest, Arc::clone(&facts)));
        facts
    }

    /// Stores a scene that is in this process, as an upload would: what takes no chunks, and no reading back.
    ///
    /// # Errors
    /// When it cannot be written, or not be recorded.
    pub fn take_scene(&self, scene: &Scene) -> Result<Digest, TakeError> {
        let bytes = scene.to_blob();
        let digest = self.blobs.put(&bytes)?;
        self.remember(digest, scene);
        self.store.record_scene(SceneRecord {
            digest,
            bytes: bytes.len() as u64,
            triangles: scene.len(),
            objects: scene.objects().len() as u32,
        })?;
        Ok(digest)
    }

    /// The facts of a stored scene.
    pub(crate) fn facts(&self, digest: &Digest) -> Result<Arc<SceneFacts>, FactsError> {
        let last = self.last_scene.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        match last {
            Some((d, facts)) if d == *digest => Ok(facts),
            _ => {
                let scene = Scene::from_blob("stored scene", &self.blobs.read(digest)?)?;
                Ok(self.remember(*digest, &scene))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use sightline_scene::Triangle;

    use super::*;
    use crate::core::Config;

    #[test]
    fn a_scene_that_is_handed_over_is_stored_as_an_upload_is_and_mended() {
        let directory = tempfile::tempdir().unwrap();
        let coordinator = Coordinator::open(Config::new(directory.path().to_owned())).unwrap();
        let triangle = Triangle { v: [glam::Vec3::ZERO, glam::Vec3::X, glam::Vec3::Y] };
        let objects = vec![Object { name: "all".to_owned(), first: 0, count: 1 }];
        let scene = Scene::new("test", vec![triangle], objects).unwrap();
        let place = coordinator.blobs.path(&scene.digest().0);
        // Missing, there, altered, cut short.
        for before in [None, Some(scene.to_blob()), Some(b"halls".to_vec()), Some(Vec::new())] {
            if let Some(bytes) = before {
                std::fs::write(&place, bytes).unwrap();
            }
            let digest = coordinator.take_scene(&scene).unwrap();
            assert_eq!(digest, scene.digest().0);
            assert_eq!(coordinator.blobs.read(&digest).unwrap(), scene.to_blob());
            assert_eq!(coordinator.facts(&digest).unwrap().triangles, 1);
            let record = coordinator.store.scene(&digest).unwrap().unwrap();
            assert_eq!((record.triangles, record.objects), (1, 1));
        }
    }
}
