//! Scenes a worker has at hand: fetched once, analysed once, with the hierarchies built for them.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use sightline_bake::BakeScene;
use sightline_sampling::{Backend, CubeSpec, Strata};
use sightline_scene::{Scene, SceneError};

use crate::backends::Backends;

/// Scenes kept at once: the one at work and the one that comes next.
const KEPT: usize = 2;

/// A scene with its backends.
pub struct Loaded {
    /// The scene, prepared for tiles.
    pub scene: BakeScene,
    backends: Mutex<BTreeMap<String, Arc<dyn Backend>>>,
}

impl Loaded {
    /// Takes up a scene.
    ///
    /// # Errors
    /// [`SceneError`] when it has too many triangles to sample.
    pub fn new(scene: Arc<Scene>) -> Result<Self, SceneError> {
        Ok(Self { scene: BakeScene::new(scene)?, backends: Mutex::default() })
    }

    /// Makes ready to trace sight lines on the cpu, if this machine can: what the first tile would wait for.
    /// What cannot be done now is done, and complained of, when it is needed.
    pub fn warm(&self, backends: &Backends, spec: CubeSpec) {
        let cpu = backends.profiles().into_iter().find(|p| p.starts_with("cpu/"));
        let Some(backend) = cpu.and_then(|profile| self.backend(backends, &profile, spec, "").ok()) else {
            return;
        };
        let traced = self.scene.sampling().traced();
        std::thread::scope(|scope| {
            scope.spawn(|| self.scene.sampling().for_lines());
            if let Err(e) = backend.lines(traced) {
                tracing::debug!("not made ready: {e}");
            }
        });
    }

    /// The backend with `profile` for cubes as in `spec`, made on first use. A software gpu belongs to one
    /// `owner` alone, because such a device keeps only one core busy.
    ///
    /// # Errors
    /// What the backend reports.
    pub fn backend(
        &self,
        backends: &Backends,
        profile: &str,
        spec: CubeSpec,
        owner: &str,
    ) -> Result<Arc<dyn Backend>, sightline_sampling::BackendError> {
        let strata = match spec.strata {
            Strata::One => 1,
            Strata::Faces => 6,
            Strata::Quadrants => 24,
        };
        let owner = if backends.is_software(profile) { owner } else { "" };
        let key = format!("{profile}|{}|{strata}|{}|{owner}", spec.resolution, spec.keep_pixels);
        let mut open = self.backends.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(backend) = open.get(&key) {
            return Ok(Arc::clone(backend));
        }
        let backend = backends.open(profile, Arc::clone(self.scene.scene()), spec)?;
        open.insert(key, Arc::clone(&backend));
        Ok(backend)
    }
}

impl Loaded {
    /// Drops the backends with `profile`: the next tile that needs one opens it anew.
    pub fn forget(&self, profile: &str) {
        let mut open = self.backends.lock().unwrap_or_else(PoisonError::into_inner);
        open.retain(|key, _| !key.starts_with(&format!("{profile}|")));
    }
}

/// The scenes of one process, by digest.
#[derive(Default)]
pub struct SceneCache {
    // Most recently used last.
    scenes: tokio::sync::Mutex<Vec<([u8; 32], Arc<Loaded>)>>,
}

impl SceneCache {
    /// A cache that has a scene already.
    pub fn holding(digest: [u8; 32], loaded: Arc<Loaded>) -> Self {
        Self { scenes: tokio::sync::Mutex::new(vec![(digest, loaded)]) }
    }

    /// The scene with `digest`, fetched with `fetch` when it is not at hand. Two tiles that ask at once fetch
    /// once.
    ///
    /// # Errors
    /// What `fetch` reports, or that the bytes are not that scene.
    pub async fn get<F>(&self, digest: [u8; 32], fetch: F) -> Result<Arc<Loaded>, String>
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
            if *blake3::hash(&bytes).as_bytes() != digest {
                return Err("the scene that arrived is not the one asked for".to_owned());
            }
            let scene = Scene::from_blob("scene from the coordinator", &bytes).map_err(|e| e.to_string())?;
            drop(bytes);
            Ok(Arc::new(Loaded::new(Arc::new(scene)).map_err(|e| e.to_string())?))
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
