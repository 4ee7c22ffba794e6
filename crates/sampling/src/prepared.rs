//! A scene with the facts about its triangles that samplers need, each computed once.
//!
//! The facts are computed on all threads of rayon's pool. A thread of the pool that waits for such a
//! computation can run another task meanwhile, reach the same lock and wait for itself. So a sampler gets all
//! facts before it distributes work over threads: [`PreparedScene::for_lines`] and
//! [`PreparedScene::for_cubes`] are the only access to them, and both panic on a thread of the pool.

use std::sync::{Arc, OnceLock};

use rayon::prelude::*;
use sightline_scene::topology::{self, Solids};
use sightline_scene::{Scene, SceneError};

use crate::surface::Surface;

/// A scene and the facts about it that are known so far.
pub struct PreparedScene {
    scene: Arc<Scene>,
    solids: OnceLock<Solids>,
    duplicates: OnceLock<Vec<Vec<u32>>>,
    distinct: OnceLock<Vec<u32>>,
    surface: OnceLock<Surface>,
}

/// The facts that sight lines need.
#[derive(Clone, Copy)]
pub struct LineScene<'a> {
    /// The triangles.
    pub scene: &'a Scene,
    /// Ids of the triangles with area, without those that duplicate an earlier one, in ascending order.
    pub distinct: &'a [u32],
    /// Classes of triangles with the same three vertices, which are seen together or not at all.
    pub duplicates: &'a [Vec<u32>],
    /// Neighbours over edges, and the triangles' order in space.
    pub surface: &'a Surface,
}

/// The facts that visibility cubes need.
#[derive(Clone, Copy)]
pub struct CubeScene<'a> {
    /// Classes of triangles with the same three vertices, which are seen together or not at all.
    pub duplicates: &'a [Vec<u32>],
    /// Which triangles bound closed solids; `None` when samples inside solids are not judged apart.
    pub solids: Option<&'a Solids>,
}

/// The reason why an analysis cannot fail.
const CHECKED: &str = "the number of triangles was checked when the scene was prepared";

impl PreparedScene {
    /// Prepares `scene` without computing any fact yet.
    ///
    /// # Errors
    /// [`SceneError::Bad`] when it has too many triangles to analyse.
    pub fn new(scene: Arc<Scene>) -> Result<Self, SceneError> {
        topology::check_size(&scene)?;
        Ok(Self {
            scene,
            solids: OnceLock::new(),
            duplicates: OnceLock::new(),
            distinct: OnceLock::new(),
            surface: OnceLock::new(),
        })
    }

    /// The triangles.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// The facts that sight lines need.
    ///
    /// # Panics
    /// On a thread of rayon's pool (see the module's documentation).
    pub fn for_lines(&self) -> LineScene<'_> {
        outside_the_pool();
        let (duplicates, distinct) = (self.duplicates(), self.distinct());
        let surface = self.surface.get_or_init(|| Surface::of(&self.scene, distinct));
        LineScene { scene: &self.scene, distinct, duplicates, surface }
    }

    /// The facts that visibility cubes need.
    ///
    /// # Panics
    /// On a thread of rayon's pool (see the module's documentation).
    #[expect(clippy::expect_used, reason = "new() has checked the only thing that can fail")]
    pub fn for_cubes(&self, solids: bool) -> CubeScene<'_> {
        outside_the_pool();
        let solids = solids.then(|| self.solids.get_or_init(|| Solids::of(&self.scene).expect(CHECKED)));
        CubeScene { duplicates: self.duplicates(), solids }
    }

    /// The triangles among which sight lines are traced; computes less than [`Self::for_lines`].
    ///
    /// # Panics
    /// On a thread of rayon's pool (see the module's documentation).
    pub fn traced(&self) -> &[u32] {
        outside_the_pool();
        self.distinct()
    }

    #[expect(clippy::expect_used, reason = "new() has checked the only thing that can fail")]
    fn duplicates(&self) -> &[Vec<u32>] {
        self.duplicates.get_or_init(|| topology::duplicates(&self.scene).expect(CHECKED))
    }

    fn distinct(&self) -> &[u32] {
        self.distinct.get_or_init(|| {
            let mut kept = vec![true; self.scene.triangles().len()];
            self.duplicates().iter().flat_map(|class| &class[1..]).for_each(|id| kept[*id as usize] = false);
            let area = |id: &u32| !self.scene.triangles()[*id as usize].is_degenerate();
            (0..self.scene.len()).into_par_iter().filter(|id| kept[*id as usize]).filter(area).collect()
        })
    }
}

/// Refuses threads of rayon's pool.
pub(crate) fn outside_the_pool() {
    assert!(rayon::current_thread_index().is_none(), "a thread of the pool could wait for itself here");
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use sightline_scene::{Object, Triangle};

    use super::*;

    fn scene() -> PreparedScene {
        let one = Triangle { v: [Vec3::ZERO, Vec3::X, Vec3::Y] };
        let flat = Triangle { v: [Vec3::ZERO; 3] };
        let objects = vec![Object { name: "all".to_owned(), first: 0, count: 3 }];
        PreparedScene::new(Arc::new(Scene::new("test", vec![one, flat, one], objects).unwrap())).unwrap()
    }

    #[test]
    fn duplicates_and_triangles_without_area_are_not_traced() {
        let scene = scene();
        let facts = scene.for_lines();
        assert_eq!(facts.distinct, [0]);
        assert_eq!(facts.duplicates, [vec![0, 2]]);
        assert_eq!(scene.traced(), [0]);
    }

    #[test]
    fn a_thread_of_the_pool_gets_no_facts() {
        let scene = scene();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let uses: [&(dyn Fn() -> usize + Sync); 3] =
            [&|| scene.for_lines().distinct.len(), &|| scene.for_cubes(true).duplicates.len(), &|| {
                scene.traced().len()
            }];
        for one in uses {
            assert!(one() > 0);
            let refused = std::panic::AssertUnwindSafe(|| pool.install(one));
            assert!(std::panic::catch_unwind(refused).is_err());
        }
    }
}
