//! A cache of a worker's scenes. Each scene is fetched and analysed once, and is stored with its open
//! backends.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use sightline_bake::BakeScene;
use sightline_model::TracerChoice;
use sightline_scene::{Scene, SceneError};
use sightline_trace::sight::SightLineTracer;
use sightline_trace::{CubeSpec, Strata, Tracer};

use crate::backends::Backends;
use crate::shared_cache::SharedCache;

/// A scene with the backends that are open for it.
pub struct TracedScene {
    /// The scene, prepared for tiles.
    pub scene: BakeScene,
    backends: Mutex<BTreeMap<String, Arc<dyn Tracer>>>,
}

impl TracedScene {
    /// Prepares a scene for tiles.
    ///
    /// # Errors
    /// A [`SceneError`] if the scene has too many triangles to sample.
    pub fn new(scene: Arc<Scene>) -> Result<Self, SceneError> {
        Ok(Self {
            scene: BakeScene::new(scene)?,
            backends: Mutex::default(),
        })
    }

    /// Decodes a scene, and prepares it for tiles.
    ///
    /// # Errors
    /// A message if the bytes are not a scene, or if the scene has too many triangles to sample.
    pub(crate) fn decode(bytes: &[u8]) -> Result<Self, String> {
        let scene = Scene::from_blob("fetched scene", bytes).map_err(|e| e.to_string())?;
        Self::new(Arc::new(scene)).map_err(|e| e.to_string())
    }

    /// Builds the hierarchy for sight lines on the cpu backend, or on Embree if it is requested, before the
    /// first tile needs it.
    ///
    /// Does nothing if neither is requested. Ignores errors: the tile that needs the hierarchy
    /// builds it again and reports errors.
    pub fn warm(&self, backends: &Backends, spec: CubeSpec) {
        let cpu = backends.profiles().into_iter().find(|p| {
            [TracerChoice::Cpu, TracerChoice::Embree]
                .iter()
                .any(|c| c.accepts(p))
        });
        let Some(backend) = cpu.and_then(|profile| self.backend(backends, &profile, spec, "").ok())
        else {
            return;
        };
        let traced = self.scene.sampling().traced();
        std::thread::scope(|scope| {
            scope.spawn(|| self.scene.sampling().for_lines());
            if let Err(e) = SightLineTracer::new(&*backend, traced) {
                tracing::debug!("the hierarchy was not built in advance: {e}");
            }
        });
    }

    /// Returns the backend with `profile` for the cubes of `spec`, and opens it at its first use.
    ///
    /// Each `owner` has a separate software gpu, because such a device uses only one core.
    ///
    /// # Errors
    /// The error of the backend.
    pub fn backend(
        &self,
        backends: &Backends,
        profile: &str,
        spec: CubeSpec,
        owner: &str,
    ) -> Result<Arc<dyn Tracer>, sightline_trace::TracerError> {
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

/// A cache of the scenes of one process, by digest.
pub type SceneCache = SharedCache<[u8; 32], TracedScene>;
