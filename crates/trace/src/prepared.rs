//! A scene with the facts about its triangles that samplers need. Each fact is computed once.
//!
//! The facts are computed on all threads of rayon's pool. A thread of the pool that waits for such a
//! computation can run another task, reach the same lock and wait for itself. A sampler therefore gets all
//! facts before it distributes work over threads. [`PreparedScene::for_lines`] and
//! [`PreparedScene::for_cubes`] are the only access to the facts, and both panic on a thread of the pool.

use std::sync::{Arc, OnceLock};

use rayon::prelude::*;
use sightline_model::Granularity;
use sightline_scene::topology::{self, Solids};
use sightline_scene::{Scene, SceneError, Side, SurfaceKind, TriangleId};

use crate::rows::Rows;
use crate::surface::Surface;

/// A scene, and the facts about it that were computed so far.
pub struct PreparedScene {
    scene: Arc<Scene>,
    solids: OnceLock<Solids>,
    /// The classes of triangles with the same three vertices.
    classes: OnceLock<Vec<Vec<u32>>>,
    duplicates: OnceLock<Vec<Vec<u32>>>,
    distinct: OnceLock<Vec<u32>>,
    see_through: OnceLock<Vec<u32>>,
    masked: OnceLock<(Vec<u32>, Vec<Vec<u32>>)>,
    shown: OnceLock<Vec<u32>>,
    surface: OnceLock<Surface>,
    /// The rows of tables with a row for each triangle, by granularity.
    fine_rows: [OnceLock<Rows>; 3],
    /// The rows of tables with a row for each item, by granularity.
    item_rows: [OnceLock<Rows>; 3],
}

/// The triangles among which sight lines are traced.
#[derive(Clone, Copy)]
pub struct Traced<'a> {
    /// The scene that contains the triangles.
    pub scene: &'a Scene,
    /// The ids of the blocking triangles with area, one of each class of duplicates, in ascending order. A
    /// class with triangles of one side and opposite fronts has two.
    pub distinct: &'a [u32],
    /// The ids of the see-through triangles with area, selected like `distinct`.
    pub see_through: &'a [u32],
    /// The ids of the masked triangles with area, selected like `distinct`.
    pub masked: &'a [u32],
    /// The classes of masked triangles with the same three vertices, whose masks may differ. The classes
    /// ascend by their first triangle, which is in `masked`.
    pub coincident: &'a [Vec<u32>],
}

/// The facts that sight lines need.
#[derive(Clone, Copy)]
pub struct LineScene<'a> {
    /// The scene that contains the triangles.
    pub scene: &'a Scene,
    /// The ids of the blocking triangles with area, one of each class of duplicates, in ascending order.
    pub distinct: &'a [u32],
    /// The ids of the see-through triangles with area, selected like `distinct`.
    pub see_through: &'a [u32],
    /// The triangles of `distinct` and `see_through` that show, and all masked triangles with area, in
    /// ascending order.
    pub shown: &'a [u32],
    /// The classes of opaque or of see-through triangles with the same three vertices.
    ///
    /// The triangles of a class are seen together or not at all. Triangles with one side are in the class of
    /// the triangles with both sides, if there are any, otherwise in the class of the same front. Masked
    /// triangles are found one by one, because their masks may differ.
    pub duplicates: &'a [Vec<u32>],
    /// The neighbours of triangles over edges, and the triangles' order in space.
    pub surface: &'a Surface,
}

/// The facts that visibility cubes need.
#[derive(Clone, Copy)]
pub struct CubeScene<'a> {
    /// The classes of triangles with the same three vertices, which are seen together or not at all.
    pub duplicates: &'a [Vec<u32>],
    /// The triangles that bound closed solids; `None` if samples inside solids have no separate threshold.
    pub solids: Option<&'a Solids>,
}

/// The reason why an analysis cannot fail.
const CHECKED: &str = "the number of triangles was checked when the scene was prepared";

impl PreparedScene {
    /// Prepares `scene` without computing facts.
    ///
    /// # Errors
    /// [`SceneError::Bad`] if the scene has too many triangles to analyse.
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

    /// Returns the scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// Returns the facts that sight lines need.
    ///
    /// # Panics
    /// Panics on a thread of rayon's pool (see the module's documentation).
    pub fn for_lines(&self) -> LineScene<'_> {
        outside_the_pool();
        let (duplicates, distinct, see_through) =
            (self.duplicates(), self.distinct(), self.see_through());
        let shown = self.shown(distinct, see_through);
        let surface = self
            .surface
            .get_or_init(|| Surface::new(&self.scene, shown));
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
    /// Panics on a thread of rayon's pool (see the module's documentation).
    pub fn fine_rows(&self, granularity: Granularity) -> &Rows {
        outside_the_pool();
        let place = &self.fine_rows[place_of(granularity)];
        place.get_or_init(|| Rows::fine(&self.scene, granularity))
    }

    /// Returns the rows of a table with a row for each item.
    ///
    /// # Panics
    /// Panics on a thread of rayon's pool (see the module's documentation).
    pub fn item_rows(&self, granularity: Granularity) -> &Rows {
        outside_the_pool();
        let place = &self.item_rows[place_of(granularity)];
        place.get_or_init(|| Rows::of_items(&self.scene, granularity, self.duplicates()))
    }

    /// Returns the facts that visibility cubes need.
    ///
    /// # Panics
    /// Panics on a thread of rayon's pool (see the module's documentation).
    #[expect(
        clippy::expect_used,
        reason = "new() has checked the only thing that can fail"
    )]
    pub fn for_cubes(&self, solids: bool) -> CubeScene<'_> {
        outside_the_pool();
        let solids = solids.then(|| {
            self.solids
                .get_or_init(|| Solids::find(&self.scene).expect(CHECKED))
        });
        CubeScene {
            duplicates: self.duplicates(),
            solids,
        }
    }

    /// Returns the triangles among which sight lines are traced. Computes less than [`Self::for_lines`].
    ///
    /// # Panics
    /// Panics on a thread of rayon's pool (see the module's documentation).
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
            let keep_kind = |kind: SurfaceKind, class: &[u32]| -> Vec<u32> {
                class
                    .iter()
                    .copied()
                    .filter(|t| kinds.kind(TriangleId(*t)) == kind)
                    .collect()
            };
            let classes = self.classes().iter();
            let parts = classes.flat_map(|c| {
                [
                    keep_kind(SurfaceKind::Opaque, c),
                    keep_kind(SurfaceKind::SeeThrough, c),
                ]
            });
            let parts = parts.flat_map(|class| self.seen_together(class));
            parts.filter(|class| class.len() > 1).collect()
        })
    }

    fn distinct(&self) -> &[u32] {
        // An occluder-only triangle must not hide a coincident opaque triangle.
        self.distinct
            .get_or_init(|| self.one_of_each(&[SurfaceKind::Opaque, SurfaceKind::OccluderOnly]))
    }

    fn see_through(&self) -> &[u32] {
        self.see_through
            .get_or_init(|| match self.scene.kinds().all_opaque() {
                true => Vec::new(),
                false => self.one_of_each(&[SurfaceKind::SeeThrough]),
            })
    }

    /// Returns [`Traced::masked`] and [`Traced::coincident`].
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
                    .filter(|t| kinds.kind(TriangleId(*t)) == SurfaceKind::Masked)
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
            (self.one_of_each(&[SurfaceKind::Masked]), classes)
        })
    }

    fn shown<'a>(&'a self, distinct: &'a [u32], see_through: &[u32]) -> &'a [u32] {
        let kinds = self.scene.kinds();
        if kinds.all_opaque() {
            return distinct;
        }
        self.shown.get_or_init(|| {
            let shows = |t: &u32| kinds.kind(TriangleId(*t)).shows();
            let mut shown: Vec<u32> = distinct
                .iter()
                .chain(see_through)
                .copied()
                .filter(shows)
                .collect();
            // Each of several coincident masked triangles has its own holes.
            shown.extend((0..self.scene.len()).filter(|t| {
                kinds.kind(TriangleId(*t)) == SurfaceKind::Masked
                    && !self.scene.triangles()[*t as usize].is_degenerate()
            }));
            shown.sort_unstable();
            shown
        })
    }

    /// Splits a class of duplicates of one kind by front if all triangles have one side. Otherwise returns
    /// the class as a whole.
    fn seen_together(&self, class: Vec<u32>) -> [Vec<u32>; 2] {
        let faces = |t: &u32, wanted: bool| front(&self.scene, TriangleId(*t)) == Some(wanted);
        if class
            .iter()
            .any(|t| front(&self.scene, TriangleId(*t)).is_none())
        {
            return [class, Vec::new()];
        }
        [true, false].map(|wanted| class.iter().copied().filter(|t| faces(t, wanted)).collect())
    }

    /// Returns the triangles with area of some kinds, in ascending order.
    ///
    /// Of a class of duplicates, returns only one triangle for each side of its plane: the first triangle of
    /// the first of these kinds that the class contains.
    fn one_of_each(&self, wanted: &[SurfaceKind]) -> Vec<u32> {
        let kinds = self.scene.kinds();
        let rank = |t: u32| wanted.iter().position(|k| *k == kinds.kind(TriangleId(t)));
        let mut kept = vec![true; self.scene.triangles().len()];
        for class in self.classes() {
            let first = [true, false].map(|side| {
                let met = class.iter().copied().filter(|t| rank(*t).is_some());
                let met = met
                    .map(|t| (t, front(&self.scene, TriangleId(t))))
                    .filter(|(_, f)| *f != Some(!side));
                // A triangle with both sides also replaces the triangle of the other side.
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

/// Returns the side of its plane from which a triangle is met, or `None` if it is met from both sides. The
/// result is the same for triangles with the same vertices in any order.
fn front(scene: &Scene, triangle: TriangleId) -> Option<bool> {
    let side = scene.sides().side(triangle);
    let [a, b, c] = scene.triangles()[triangle.at()].v.map(topology::position);
    // Vertices that are sorted by position run one way around, except for the choice of the first vertex.
    let sorted = [a < b, b < c, c < a]
        .into_iter()
        .filter(|ascends| *ascends)
        .count()
        == 2;
    (side != Side::Both).then_some(sorted == (side == Side::CounterClockwise))
}

/// Returns the index of a granularity in the arrays of rows.
fn place_of(granularity: Granularity) -> usize {
    match granularity {
        Granularity::Triangles => 0,
        Granularity::Clusters => 1,
        Granularity::Objects => 2,
    }
}

/// Panics on a thread of rayon's pool, because the thread could wait for itself.
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
    fn thread_of_pool_gets_no_facts() {
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
