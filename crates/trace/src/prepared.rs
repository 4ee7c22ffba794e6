//! A scene with the facts about its triangles that samplers need, each computed once.
//!
//! The facts are computed on all threads of rayon's pool. A thread of the pool that waits for such a
//! computation can run another task meanwhile, reach the same lock and wait for itself. So a sampler gets all
//! facts before it distributes work over threads: [`PreparedScene::for_lines`] and
//! [`PreparedScene::for_cubes`] are the only access to them, and both panic on a thread of the pool.

use std::sync::{Arc, OnceLock};

use rayon::prelude::*;
use sightline_model::Granularity;
use sightline_scene::topology::{self, Solids};
use sightline_scene::{Kind, Scene, SceneError, Side};

use crate::rows::Rows;
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
    masked: OnceLock<(Vec<u32>, Vec<Vec<u32>>)>,
    shown: OnceLock<Vec<u32>>,
    surface: OnceLock<Surface>,
    /// With a row for each triangle, by granularity.
    fine_rows: [OnceLock<Rows>; 3],
    /// With a row for each item, by granularity.
    item_rows: [OnceLock<Rows>; 3],
}

/// The triangles among which sight lines are traced.
#[derive(Clone, Copy)]
pub struct Traced<'a> {
    /// The triangles.
    pub scene: &'a Scene,
    /// Ids of the blocking triangles with area, one of each class of duplicates (two if it has triangles of
    /// one side with opposite fronts), in ascending order.
    pub distinct: &'a [u32],
    /// The same for see-through triangles.
    pub see_through: &'a [u32],
    /// The same for masked triangles.
    pub masked: &'a [u32],
    /// The classes of masked triangles with the same three vertices, whose masks may differ; ascending by
    /// their first triangle, which is the one in `masked`.
    pub coincident: &'a [Vec<u32>],
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
    /// The triangles of both that show, and all masked ones with area, in ascending order.
    pub shown: &'a [u32],
    /// Classes of opaque or of see-through triangles with the same three vertices, which are seen together or
    /// not at all: those of one side are seen with those of both sides, if there are any, else with those of
    /// the same front. Masked ones are found one by one, since their masks may differ.
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
            masked: OnceLock::new(),
            shown: OnceLock::new(),
            surface: OnceLock::new(),
            fine_rows: Default::default(),
            item_rows: Default::default(),
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
        let (duplicates, distinct, see_through) =
            (self.duplicates(), self.distinct(), self.see_through());
        let shown = self.shown(distinct, see_through);
        let surface = self.surface.get_or_init(|| Surface::of(&self.scene, shown));
        LineScene {
            scene: &self.scene,
            distinct,
            see_through,
            shown,
            duplicates,
            surface,
        }
    }

    /// Returns the rows of a table with a row for each triangle.
    ///
    /// # Panics
    /// On a thread of rayon's pool (see the module's documentation).
    pub fn fine_rows(&self, granularity: Granularity) -> &Rows {
        outside_the_pool();
        let place = &self.fine_rows[place_of(granularity)];
        place.get_or_init(|| Rows::fine(&self.scene, granularity))
    }

    /// Returns the rows of a table with a row for each item.
    ///
    /// # Panics
    /// On a thread of rayon's pool (see the module's documentation).
    pub fn item_rows(&self, granularity: Granularity) -> &Rows {
        outside_the_pool();
        let place = &self.item_rows[place_of(granularity)];
        place.get_or_init(|| Rows::of_items(&self.scene, granularity, self.duplicates()))
    }

    /// The facts that visibility cubes need.
    ///
    /// # Panics
    /// On a thread of rayon's pool (see the module's documentation).
    #[expect(
        clippy::expect_used,
        reason = "new() has checked the only thing that can fail"
    )]
    pub fn for_cubes(&self, solids: bool) -> CubeScene<'_> {
        outside_the_pool();
        let solids = solids.then(|| {
            self.solids
                .get_or_init(|| Solids::of(&self.scene).expect(CHECKED))
        });
        CubeScene {
            duplicates: self.duplicates(),
            solids,
        }
    }

    /// The triangles among which sight lines are traced; computes less than [`Self::for_lines`].
    ///
    /// # Panics
    /// On a thread of rayon's pool (see the module's documentation).
    pub fn traced(&self) -> Traced<'_> {
        outside_the_pool();
        let (distinct, see_through) = (self.distinct(), self.see_through());
        let (masked, coincident) = self.masked();
        Traced {
            scene: &self.scene,
            distinct,
            see_through,
            masked,
            coincident,
        }
    }

    #[expect(
        clippy::expect_used,
        reason = "new() has checked the only thing that can fail"
    )]
    fn classes(&self) -> &[Vec<u32>] {
        self.classes
            .get_or_init(|| topology::duplicates(&self.scene).expect(CHECKED))
    }

    fn duplicates(&self) -> &[Vec<u32>] {
        let kinds = self.scene.kinds();
        if kinds.all_opaque() && self.scene.sides().are_both() {
            return self.classes();
        }
        self.duplicates.get_or_init(|| {
            let keep_kind = |kind: Kind, class: &[u32]| -> Vec<u32> {
                class
                    .iter()
                    .copied()
                    .filter(|t| kinds.kind(*t) == kind)
                    .collect()
            };
            let classes = self.classes().iter();
            let parts =
                classes.flat_map(|c| [keep_kind(Kind::Opaque, c), keep_kind(Kind::SeeThrough, c)]);
            let parts = parts.flat_map(|class| self.seen_together(class));
            parts.filter(|class| class.len() > 1).collect()
        })
    }

    fn distinct(&self) -> &[u32] {
        // An occluder-only triangle in the place of an opaque one must not hide it.
        self.distinct
            .get_or_init(|| self.one_of_each(&[Kind::Opaque, Kind::OccluderOnly]))
    }

    fn see_through(&self) -> &[u32] {
        self.see_through
            .get_or_init(|| match self.scene.kinds().all_opaque() {
                true => Vec::new(),
                false => self.one_of_each(&[Kind::SeeThrough]),
            })
    }

    /// See [`Traced::masked`] and [`Traced::coincident`].
    fn masked(&self) -> &(Vec<u32>, Vec<Vec<u32>>) {
        self.masked.get_or_init(|| {
            let kinds = self.scene.kinds();
            if !kinds.any_masked() {
                return Default::default();
            }
            let keep_masked = |class: &Vec<u32>| -> Vec<u32> {
                class
                    .iter()
                    .copied()
                    .filter(|t| kinds.kind(*t) == Kind::Masked)
                    .collect()
            };
            let mut classes: Vec<Vec<u32>> = self
                .classes()
                .iter()
                .map(keep_masked)
                .filter(|c| c.len() > 1)
                .collect();
            classes.iter_mut().for_each(|c| c.sort_unstable());
            classes.sort_unstable();
            (self.one_of_each(&[Kind::Masked]), classes)
        })
    }

    fn shown<'a>(&'a self, distinct: &'a [u32], see_through: &[u32]) -> &'a [u32] {
        let kinds = self.scene.kinds();
        if kinds.all_opaque() {
            return distinct;
        }
        self.shown.get_or_init(|| {
            let shows = |t: &u32| kinds.kind(*t).shows();
            let mut shown: Vec<u32> = distinct
                .iter()
                .chain(see_through)
                .copied()
                .filter(shows)
                .collect();
            // Of masked triangles in one place each has its own holes.
            shown.extend((0..self.scene.len()).filter(|t| {
                kinds.kind(*t) == Kind::Masked
                    && !self.scene.triangles()[*t as usize].is_degenerate()
            }));
            shown.sort_unstable();
            shown
        })
    }

    /// A class of duplicates of one kind, or its two parts of opposite fronts when all have one side.
    fn seen_together(&self, class: Vec<u32>) -> [Vec<u32>; 2] {
        let faces = |t: &u32, wanted: bool| front(&self.scene, *t) == Some(wanted);
        if class.iter().any(|t| front(&self.scene, *t).is_none()) {
            return [class, Vec::new()];
        }
        [true, false].map(|wanted| class.iter().copied().filter(|t| faces(t, wanted)).collect())
    }

    /// The triangles with area of some kinds, in ascending order; of a class of duplicates only the first of
    /// the first of these kinds that is in it, for each side of its plane.
    fn one_of_each(&self, wanted: &[Kind]) -> Vec<u32> {
        let kinds = self.scene.kinds();
        let rank = |t: u32| wanted.iter().position(|k| *k == kinds.kind(t));
        let mut kept = vec![true; self.scene.triangles().len()];
        for class in self.classes() {
            let first = [true, false].map(|side| {
                let met = class.iter().copied().filter(|t| rank(*t).is_some());
                let met = met
                    .map(|t| (t, front(&self.scene, t)))
                    .filter(|(_, f)| *f != Some(!side));
                // One with both sides spares the other side's.
                met.min_by_key(|(t, front)| (rank(*t), front.is_some(), *t))
                    .map(|(t, _)| t)
            });
            class
                .iter()
                .filter(|t| !first.contains(&Some(**t)))
                .for_each(|t| kept[*t as usize] = false);
        }
        let area = |id: &u32| !self.scene.triangles()[*id as usize].is_degenerate();
        let of_these = |id: &u32| kept[*id as usize] && rank(*id).is_some();
        (0..self.scene.len())
            .into_par_iter()
            .filter(of_these)
            .filter(area)
            .collect()
    }
}

/// On which side of its plane a triangle is met, the same for triangles with the same vertices in any order;
/// none when it is met from both.
fn front(scene: &Scene, triangle: u32) -> Option<bool> {
    let side = scene.sides().side(triangle);
    let [a, b, c] = scene.triangles()[triangle as usize]
        .v
        .map(topology::position);
    // Vertices that are sorted by position run one way around, up to the choice of the first.
    let sorted = [a < b, b < c, c < a]
        .into_iter()
        .filter(|ascends| *ascends)
        .count()
        == 2;
    (side != Side::Both).then_some(sorted == (side == Side::CounterClockwise))
}

/// Returns the place of a granularity among the rows.
fn place_of(granularity: Granularity) -> usize {
    match granularity {
        Granularity::Triangles => 0,
        Granularity::Clusters => 1,
        Granularity::Objects => 2,
    }
}

/// Refuses threads of rayon's pool.
pub(crate) fn outside_the_pool() {
    assert!(
        rayon::current_thread_index().is_none(),
        "a thread of the pool could wait for itself here"
    );
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use sightline_scene::{Object, Triangle};

    use super::*;

    fn scene() -> PreparedScene {
        let one = Triangle {
            v: [Vec3::ZERO, Vec3::X, Vec3::Y],
        };
        let flat = Triangle { v: [Vec3::ZERO; 3] };
        let objects = vec![Object {
            name: "all".to_owned(),
            first: 0,
            count: 3,
        }];
        PreparedScene::new(Arc::new(
            Scene::new("test", vec![one, flat, one], objects).unwrap(),
        ))
        .unwrap()
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
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        let uses: [&(dyn Fn() -> usize + Sync); 3] = [
            &|| scene.for_lines().distinct.len(),
            &|| scene.for_cubes(true).duplicates.len(),
            &|| scene.traced().distinct.len(),
        ];
        for one in uses {
            assert!(one() > 0);
            let refused = std::panic::AssertUnwindSafe(|| pool.install(one));
            assert!(std::panic::catch_unwind(refused).is_err());
        }
    }
}
