//! Cache of the scenes of a worker: each is fetched once and analysed once, and keeps its backends.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use sightline_bake::BakeScene;
use sightline_scene::{Scene, SceneError};
use sightline_trace::sight::Sight;
use sightline_trace::{Backend, CubeSpec, Strata};

use crate::backends::Backends;

/// Most scenes kept: the current one and the next one.
const KEPT: usize = 2;

/// A scene with the backends opened for it.
pub struct TracedScene {
    /// The scene, prepared for tiles.
    pub scene: BakeScene,
    backends: Mutex<BTreeMap<String, Arc<dyn Backend>>>,
}

impl TracedScene {
    /// Prepares a scene for tiles.
    ///
    /// # Errors
    /// [`SceneError`] when it has too many triangles to sample.
    pub fn new(scene: Arc<Scene>) -> Result<Self, SceneError> {
        Ok(Self {
            scene: BakeScene::new(scene)?,
            backends: Mutex::default(),
        })
    }

    /// Builds the hierarchy for sight lines on the cpu backend, if this machine has one, so that the first
    /// tile does not wait for it. Errors are ignored here: the tile that needs the hierarchy tries again and
    /// reports them.
    pub fn warm(&self, backends: &Backends, spec: CubeSpec) {
        let cpu = backends
            .profiles()
            .into_iter()
            .find(|p| p.starts_with("cpu/"));
        let Some(backend) = cpu.and_then(|profile| self.backend(backends, &profile, spec, "").ok())
        else {
            return;
        };
        let traced = self.scene.sampling().traced();
        std::thread::scope(|scope| {
            scope.spawn(|| self.scene.sampling().for_lines());
            if let Err(e) = Sight::new(&*backend, traced) {
                tracing::debug!("not made ready: {e}");
            }
        });
    }

    /// The backend with `profile` for the cubes of `spec`, opened at first use. Each `owner` has a software
    /// gpu for itself, because such a device uses only one core.
    ///
    /// # Errors
    /// The error of the backend.
    pub fn backend(
        &self,
        backends: &Backends,
        profile: &str,
        spec: CubeSpec,
        owner: &str,
    ) -> Result<Arc<dyn Backend>, sightline_trace::BackendError> {
        let strata = match spec.strata {
            Strata::One => 1,
            Strata::Faces => 6,
            Strata::Quadrants => 24,
        };
        let owner = if backends.is_software(profile) {
            owner
        } else {
            ""
        };
        let key = format!(
            "{profile}|{}|{strata}|{}|{owner}",
            spec.resolution, spec.keep_pixels
        );
        let mut open = self.backends.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(backend) = open.get(&key) {
            return Ok(Arc::clone(backend));
        }
        let backend = backends.open(profile, Arc::clone(self.scene.scene()), spec)?;
        open.insert(key, Arc::clone(&backend));
        Ok(backend)
    }
}

impl TracedScene {
    /// Drops the backends with `profile`, so that the next tile opens them again.
    pub fn forget(&self, profile: &str) {
        let mut open = self.backends.lock().unwrap_or_else(PoisonError::into_inner);
        open.retain(|key, _| !key.starts_with(&format!("{profile}|")));
    }
}

/// The scenes of one process, by digest.
#[derive(Default)]
pub struct SceneCache {
    // The most recently used scene is last.
    scenes: tokio::sync::Mutex<Vec<([u8; 32], Arc<TracedScene>)>>,
}

impl SceneCache {
    /// A cache that holds one scene.
    pub fn holding(digest: [u8; 32], loaded: Arc<TracedScene>) -> Self {
        Self {
            scenes: tokio::sync::Mutex::new(vec![(digest, loaded)]),
        }
    }

    /// The scene with `digest`; `fetch` is called when it is not in the cache, and checks the digest of what
    /// it gives. Simultaneous calls for a scene fetch it once.
    ///
    /// # Errors
    /// The error of `fetch`, or a message when the bytes are no scene.
    pub async fn get<F>(&self, digest: [u8; 32], fetch: F) -> Result<Arc<TracedScene>, String>
    where
        F: Future<Output = Result<Vec<u8>, String>>,
    {
        let mut scenes = self.scenes.lock().await;
        if let Some(at) = scenes.iter().position(|(d, _)| *d == digest) {
            let found = scenes.remove(at);
            let loaded = Arc::clone(&found.1);
            scenes.push(found);
            return Ok(loaded);
        }
        let bytes = fetch.await?;
        let loaded = tokio::task::spawn_blocking(move || {
            let scene =
                Scene::from_blob("scene that was fetched", &bytes).map_err(|e| e.to_string())?;
            drop(bytes);
            let loaded = TracedScene::new(Arc::new(scene)).map_err(|e| e.to_string())?;
            Ok::<_, String>(Arc::new(loaded))
        })
        .await
        .map_err(|e| format!("the scene could not be analysed: {e}"))??;
        if scenes.len() == KEPT {
            scenes.remove(0);
        }
        scenes.push((digest, Arc::clone(&loaded)));
        Ok(loaded)
    }
}
