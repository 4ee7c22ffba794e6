//! A scene with everything that tiles need of it, each part prepared once.

use std::sync::{Arc, OnceLock};

use sightline_exact::ExactScene;
use sightline_sampling::PreparedScene;
use sightline_scene::{Scene, SceneError};

/// A scene, prepared for sampling and, when a tile first needs it, for exact queries.
pub struct BakeScene {
    sampling: PreparedScene,
    exact: OnceLock<Result<ExactScene, String>>,
}

impl BakeScene {
    /// Takes up `scene`.
    ///
    /// # Errors
    /// [`SceneError`] when it has too many triangles to sample.
    pub fn new(scene: Arc<Scene>) -> Result<Self, SceneError> {
        Ok(Self { sampling: PreparedScene::new(scene)?, exact: OnceLock::new() })
    }

    /// The triangles.
    pub fn scene(&self) -> &Arc<Scene> {
        self.sampling.scene()
    }

    /// The facts for samplers.
    pub fn sampling(&self) -> &PreparedScene {
        &self.sampling
    }

    /// The scene prepared for exact queries, which takes all threads of rayon's pool the first time.
    ///
    /// # Panics
    /// On a thread of rayon's pool: it could wait for itself.
    ///
    /// # Errors
    /// The reason, when the scene has too many corners to number.
    pub fn exact(&self) -> Result<&ExactScene, String> {
        assert!(rayon::current_thread_index().is_none(), "a thread of the pool could wait for itself here");
        let found = self.exact.get_or_init(|| ExactScene::prepare(self.scene()).map_err(|e| e.to_string()));
        found.as_ref().map_err(Clone::clone)
    }
}
