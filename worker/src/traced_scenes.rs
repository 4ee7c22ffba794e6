//! Cache of the scenes of a worker: each is fetched once and analysed once, and keeps its backends.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use sightline_bake::BakeScene;
use sightline_scene::{Scene, SceneError};
use sightline_trace::sight::SightLineTracer;
use sightline_trace::{Backend, CubeSpec, Strata};

use crate::backends::Backends;
use crate::shared_cache::SharedCache;

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

    /// Decodes a scene, and prepares it for tiles.
    ///
    /// # Errors
    /// A message when the bytes are not a scene, or the scene has too many triangles to sample.
    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, String> {
        let scene = Scene::from_blob("scene that was fetched", bytes).map_err(|e| e.to_string())?;
        Self::new(Arc::new(scene)).map_err(|e| e.to_string())
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
            if let Err(e) = SightLineTracer::new(&*backend, traced) {
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
pub type SceneCache = SharedCache<[u8; 32], TracedScene>;
