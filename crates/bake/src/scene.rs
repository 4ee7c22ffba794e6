//! A scene with everything that tiles need of it, each part prepared once.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use sightline_ambient::Prepared;
use sightline_exact::ExactScene;
use sightline_model::Visibility;
use sightline_numbers::Aabb;
use sightline_portals::{Limits, NoPartition, Partition};
use sightline_scene::{Scene, SceneError};
use sightline_trace::PreparedScene;
use sightline_viewcells::Region;

/// A scene, prepared for sampling and, when a tile first needs them, for exact queries, for ambient occlusion
/// and along its walls.
pub struct BakeScene {
    sampling: PreparedScene,
    exact: OnceLock<Result<ExactScene, String>>,
    ambient: OnceLock<Result<Prepared, String>>,
    /// The partition for the last job, with what it depends on beside the scene.
    partition: Mutex<Option<(ViewSpace, Arc<Partition>)>>,
}

/// Where viewpoints are: the view box and the region.
type ViewSpace = (Aabb, Option<Arc<Region>>);

impl BakeScene {
    /// Takes up `scene`.
    ///
    /// # Errors
    /// [`SceneError`] when it has too many triangles to sample.
    pub fn new(scene: Arc<Scene>) -> Result<Self, SceneError> {
        let sampling = PreparedScene::new(scene)?;
        Ok(Self {
            sampling,
            exact: OnceLock::new(),
            ambient: OnceLock::new(),
            partition: Mutex::default(),
        })
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
        assert!(
            rayon::current_thread_index().is_none(),
            "a thread of the pool could wait for itself here"
        );
        let found = self
            .exact
            .get_or_init(|| ExactScene::prepare(self.scene()).map_err(|e| e.to_string()));
        found.as_ref().map_err(Clone::clone)
    }

    /// What hides from receivers of ambient occlusion, which takes all threads of rayon's pool the first
    /// time.
    ///
    /// # Panics
    /// On a thread of rayon's pool: it could wait for itself.
    ///
    /// # Errors
    /// The reason, when the scene has too many corners to number.
    pub fn ambient(&self) -> Result<&Prepared, String> {
        assert!(
            rayon::current_thread_index().is_none(),
            "a thread of the pool could wait for itself here"
        );
        let found = self
            .ambient
            .get_or_init(|| Prepared::new(self.scene(), false).map_err(|e| e.to_string()));
        found.as_ref().map_err(Clone::clone)
    }

    /// The scene divided along its walls for the viewpoints of a job. `stop` is called now and then, and ends
    /// the work when it returns true.
    ///
    /// # Panics
    /// On a thread of rayon's pool: it could wait for itself.
    ///
    /// # Errors
    /// [`NoPartition`].
    pub fn partition(
        &self,
        task: &Visibility,
        stop: &dyn Fn() -> bool,
    ) -> Result<Arc<Partition>, NoPartition> {
        assert!(
            rayon::current_thread_index().is_none(),
            "a thread of the pool could wait for itself here"
        );
        let (view_box, region) = (task.view_box(), task.viewpoints().region());
        let mut last = self
            .partition
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(((of_box, of), partition)) = &*last
            && (*of_box, of.as_ref()) == (view_box, region)
        {
            return Ok(Arc::clone(partition));
        }
        let within = region.map(|region| &**region);
        let made = Partition::new(self.scene(), within, view_box, Limits::default(), stop)?;
        let made = Arc::new(made);
        *last = Some(((view_box, region.cloned()), Arc::clone(&made)));
        Ok(made)
    }
}
