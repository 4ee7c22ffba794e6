//! A scene with its prepared parts, each of which is prepared once.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use sightline_ambient::AmbientScene;
use sightline_exact::ExactScene;
use sightline_model::Visibility;
use sightline_numbers::Aabb;
use sightline_portals::{EnclosureLimits, NoPartition, Partition};
use sightline_scene::{Scene, SceneError};
use sightline_trace::PreparedScene;
use sightline_viewcells::Region;

/// A scene that is prepared for sampling. The preparations for exact queries and ambient occlusion, and the
/// division along walls, are made when a tile first needs them.
pub struct BakeScene {
    sampling: PreparedScene,
    exact: OnceLock<Result<ExactScene, String>>,
    ambient: OnceLock<Result<AmbientScene, String>>,
    /// The partition for the last job, with the view box and the region on which it depends.
    partition: Mutex<Option<(ViewSpace, Arc<Partition>)>>,
}

/// The view box and the region of viewpoints.
type ViewSpace = (Aabb, Option<Arc<Region>>);

impl BakeScene {
    /// Prepares `scene` for sampling.
    ///
    /// # Errors
    /// [`SceneError`] if the scene has too many triangles to sample.
    pub fn new(scene: Arc<Scene>) -> Result<Self, SceneError> {
        let sampling = PreparedScene::new(scene)?;
        Ok(Self {
            sampling,
            exact: OnceLock::new(),
            ambient: OnceLock::new(),
            partition: Mutex::default(),
        })
    }

    /// Returns the scene.
    pub fn scene(&self) -> &Arc<Scene> {
        self.sampling.scene()
    }

    /// Returns the scene prepared for samplers.
    pub fn sampling(&self) -> &PreparedScene {
        &self.sampling
    }

    /// Returns the scene prepared for exact queries. The first call uses all threads of rayon's pool.
    ///
    /// # Panics
    /// Panics on a thread of rayon's pool, because the thread could wait for itself.
    ///
    /// # Errors
    /// Returns the reason if the scene has too many corners to number.
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

    /// Returns the scene prepared for ambient occlusion. The first call uses all threads of rayon's pool.
    ///
    /// # Panics
    /// Panics on a thread of rayon's pool, because the thread could wait for itself.
    ///
    /// # Errors
    /// Returns the reason if the scene has too many corners to number.
    pub fn ambient(&self) -> Result<&AmbientScene, String> {
        assert!(
            rayon::current_thread_index().is_none(),
            "a thread of the pool could wait for itself here"
        );
        let found = self
            .ambient
            .get_or_init(|| AmbientScene::new(self.scene(), false).map_err(|e| e.to_string()));
        found.as_ref().map_err(Clone::clone)
    }

    /// Returns the scene's division along its walls for the viewpoints of a job. The work calls `stop`
    /// repeatedly and ends if `stop` returns true.
    ///
    /// # Panics
    /// Panics on a thread of rayon's pool, because the thread could wait for itself.
    ///
    /// # Errors
    /// [`NoPartition`] if `stop` ended the work, or the region belongs to another scene or has too many
    /// parts.
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
        if let Some(((of_box, of_region), partition)) = &*last
            && (*of_box, of_region.as_ref()) == (view_box, region)
        {
            return Ok(Arc::clone(partition));
        }
        let within = region.map(|region| &**region);
        let made = Partition::new(
            self.scene(),
            within,
            view_box,
            EnclosureLimits::default(),
            stop,
        )?;
        let made = Arc::new(made);
        *last = Some(((view_box, region.cloned()), Arc::clone(&made)));
        Ok(made)
    }
}
