//! A scene with the facts about its triangles that samplers need, each computed once.
//!
//! The facts are computed on all threads of rayon's pool. A thread of the pool that waits for such a
//! computation can run another task meanwhile, reach the same lock and wait for itself. So a sampler gets all
//! facts before it distributes work over threads: [`PreparedScene::for_lines`] and
//! [`PreparedScene::for_cubes`] are the only access to them, and both panic on a thread of the pool.

use std::sync::{Arc, OnceLock};

use rayon::prelude::*;
use sightline_scene::topology::{self, Solids};
use sightline_scene::{Kind, Scene, SceneError};

use crate::surface::Surface;

/// A scene and the facts about it that are known so far.
pub struct PreparedScene {
    scene: Arc<Scene>,
    solids: OnceLock<Solids>,
    /// Classes of triangles with the same three vertices.
    classes: OnceLock<Vec<Vec<u32>>>,
    duplicates: OnceLock<Vec<Vec<u32>>>,
    distinct: OnceLock<Vec<u32>>,
    see_through: OnceLock<Vec<u32>>,
    shown: OnceLock<Vec<u32>>,
    surface: OnceLock<Surface>,
}

/// The triangles among which sight lines are traced.
#[derive(Clone, Copy)]
pub struct Traced<'a> {
    /// The triangles.
    pub scene: &'a Scene,
    /// Ids of the blocking triangles with area, one of each class of duplicates, in ascending order.
    pub distinct: &'a [u32],
    /// The same for see-through triangles.
    pub see_through: &'a [u32],
}

/// The facts that sight lines need.
#[derive(Clone, Copy)]
pub struct LineScene<'a> {
    /// The triangles.
    pub scene: &'a Scene,
    /// Ids of the blocking triangles with area, one of each class of duplicates, in ascending order.
    pub distinct: &'a [u32],
    /// The same for see-through triangles.
    pub see_through: &'a [u32],
    /// The triangles of both that show, in ascending order.
    pub shown: &'a [u32],
    /// Classes of showing triangles of one kind with the same three vertices, which are seen together or not
    /// at all.
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
            classes: OnceLock::new(),
            duplicates: OnceLock::new(),
            distinct: OnceLock::new(),
            see_through: OnceLock::new(),
            shown: OnceLock::new(),
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
        let (duplicates, distinct, see_through) = (self.duplicates(), self.distinct(), self.see_through());
        let shown = self.shown(distinct, see_through);
        let surface = self.surface.get_or_init(|| Surface::of(&self.scene, shown));
        LineScene { scene: &self.scene, distinct, see_through, shown, duplicates, surface }
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
    pub fn traced(&self) -> Traced<'_> {
        outside_the_pool();
        Traced { scene: &self.scene, distinct: self.distinct(), see_through: self.see_through() }
    }

    #[expect(clippy::expect_used, reason = "new() has checked the only thing that can fail")]
    fn classes(&self) -> &[Vec<u32>] {
        self.classes.get_or_init(|| topology::duplicates(&self.scene).expect(CHECKED))
    }

    fn duplicates(&self) -> &[Vec<u32>] {
        let kinds = self.scene.kinds();
        if kinds.all_opaque() {
            return self.classes();
        }
        self.duplicates.get_or_init(|| {
            let of = |kind: Kind, class: &[u32]| -> Vec<u32> {
                class.iter().copied().filter(|t| kinds.kind(*t) == kind).collect()
            };
            let classes = self.classes().iter();
            let parts = classes.flat_map(|c| [of(Kind::Opaque, c), of(Kind::SeeThrough, c)]);
            parts.filter(|class| class.len() > 1).collect()
        })
    }

    fn distinct(&self) -> &[u32] {
        // An occluder-only triangle in the place of an opaque one must not hide it.
        self.distinct.get_or_init(|| self.one_of_each(&[Kind::Opaque, Kind::OccluderOnly]))
    }

    fn see_through(&self) -> &[u32] {
        self.see_through.get_or_init(|| match self.scene.kinds().all_opaque() {
            true => Vec::new(),
            false => self.one_of_each(&[Kind::SeeThrough]),
        })
    }

    fn shown<'a>(&'a self, distinct: &'a [u32], see_through: &[u32]) -> &'a [u32] {
        let kinds = self.scene.kinds();
        if kinds.all_opaque() {
            return distinct;
        }
        self.shown.get_or_init(|| {
            let shows = |t: &u32| kinds.kind(*t).shows();
            let mut shown: Vec<u32> = distinct.iter().chain(see_through).copied().filter(shows).collect();
            shown.sort_unstable();
            shown
        })
    }

    /// The triangles with area of some kinds, in ascending order; of a class of duplicates only the first of
    /// the first of these kinds that is in it.
    fn one_of_each(&self, wanted: &[Kind]) -> Vec<u32> {
        let kinds = self.scene.kinds();
        let rank = |t: u32| wanted.iter().position(|k| *k == kinds.kind(t));
        let mut kept = vec![true; self.scene.triangles().len()];
        for class in self.classes() {
            let first = class.iter().copied().filter(|t| rank(*t).is_some()).min_by_key(|t| (rank(*t), *t));
            class.iter().filter(|t| Some(**t) != first).for_each(|t| kept[*t as usize] = false);
        }
        let area = |id: &u32| !self.scene.triangles()[*id as usize].is_degenerate();
        let of_these = |id: &u32| kept[*id as usize] && rank(*id).is_some();
        (0..self.scene.len()).into_par_iter().filter(of_these).filter(area).collect()
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
        assert_eq!(scene.traced().distinct, [0]);
    }

    #[test]
    fn a_thread_of_the_pool_gets_no_facts() {
        let scene = scene();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let uses: [&(dyn Fn() -> usize + Sync); 3] =
            [&|| scene.for_lines().distinct.len(), &|| scene.for_cubes(true).duplicates.len(), &|| {
                scene.traced().distinct.len()
            }];
        for one in uses {
            assert!(one() > 0);
            let refused = std::panic::AssertUnwindSafe(|| pool.install(one));
            assert!(std::panic::catch_unwind(refused).is_err());
        }
    }
}
