//! The cpu backend: a tracer with the same hits, to the bit, on every processor.
//!
//! # Rule
//!
//! The triangle that a ray meets is a function of only the ray, the triangles and the scene's bounds. Neither
//! the hierarchy nor its traversal nor the instruction set can change a bit, so all processors have one
//! numerics profile.
//!
//! 1. **Units.** Along axes on which the scene is far from the origin of world space, the scene is translated
//!    to the new origin. It is then scaled by a power of two to coordinates of at most one, and each
//!    direction so that its largest component is one to two. All three are exact, except for coordinates
//!    below 2⁻¹²⁶ of the largest. The origin of a ray is rounded once if it is far from the scene.
//! 2. **Shear.** Vertices are translated by the origin and sheared so that the ray becomes the third axis
//!    (Woop, Benthin and Wald 2013). Each operation in `f32` is rounded separately. A vertex has the same
//!    sheared position in all its triangles.
//! 3. **Sides.** The side of the axis on which the edge from p to q lies is the exact sign of p.x · q.y −
//!    p.y · q.x. The products are first rounded to `f32`. Rounding is monotone, so different rounded products
//!    have the order of the exact ones. Equal ones are decided in `f64`, where the products are exact.
//! 4. **Hits.** A triangle is met on its border too, and from both sides unless it is one-sided. A triangle
//!    seen edge-on is not met; its neighbours are. So no ray passes between triangles that share an edge or a
//!    vertex.
//! 5. **Order.** The distance is computed in `f64` from the sheared vertices. The nearest hit counts, and
//!    among equal distances the triangle with the least id. The distance is then rounded to `f32`.
//!
//! The distances of two triangles in one plane differ by rounding in `f64`, so each is nearest along some
//! rays.
//!
//! **Boxes.** Let D be one plus the largest coordinate of the origin, in the units of step 1. D is an upper
//! bound of every coordinate difference between origin and scene. Boxes are widened by 2⁻¹⁹ · D, which is 32
//! units of 2⁻²⁴ · D. The shear moves a vertex by at most 6 of these units: subtraction 1, the sheared error
//! of the third coordinate 1, quotient 1, product 1, difference 2. A box test is wrong by at most 5: sum of
//! origin and widening 1, its product 1, reciprocal 1, product of the plane 1, sum 1. Fused operations have
//! fewer errors. The distance of a hit is wrong by at most 2. So every box that contains a hit is visited,
//! as long as no nearer hit is known.
//!
//! **Distant origins.** Rays from origins beyond 2⁴⁰ in the units of step 1 meet nothing.
//!
//! **Modes.** The rule needs rounding to nearest and subnormal numbers. A host program can have changed these
//! modes of the processor, so `FloatMode` sets them during each call and each build.
//!
//! # Modules
//!
//! - `hierarchy`: nodes of eight children over leaves of eight triangles.
//! - `lines`, `packet_rays`, `line_origin`: the lines of a call, the scaled rays of a packet, and the nodes
//!   that contain their origin.
//! - `batch`, `tile`: traversals of separate rays and of sixteen similar rays.
//! - `tracer`, `renderer`: sight lines and visibility cubes.

mod batch;
mod float_mode;
mod hierarchy;
mod line_origin;
mod lines;
mod packet_rays;
mod renderer;
#[cfg(test)]
mod tests;
mod tile;
mod tracer;

use std::sync::{Arc, OnceLock};

use rayon::prelude::*;
use sightline_scene::{Scene, Side, TriangleId};

use self::hierarchy::{InputTriangle, NUMBER, ONE_SIDED, PASSED, Units, WideHierarchy};
use self::renderer::CpuRenderer;
#[cfg(test)]
pub(crate) use self::tests::levels;
use self::tracer::{CpuScene, CpuTracer};
use crate::cube::CubeSpec;
use crate::error::TracerError;
use crate::packet::{LineTracer, PassingTracer};
use crate::tracer::{CubeRenderer, LineSet, Tracer};
use crate::width::{self, TooNarrow};

/// The numerics profile of this backend, on every processor. The number changes with the rule.
pub const PROFILE: &str = "cpu/1";

/// The minimum width of a scene. The distance below which rays meet nothing is at least 10⁻³⁰ lengths of the
/// direction ([`crate::near_distance`]), which is 2⁻⁴⁰ of this width.
const MIN_WIDTH: f32 = 1.1e-18;

/// Checks the width of a scene.
///
/// # Errors
/// [`TooNarrow`] if the width is below 1.1 · 10⁻¹⁸.
pub fn check_width(scene: &Scene) -> Result<(), TooNarrow> {
    width::check(scene, "cpu", MIN_WIDTH)
}

/// The cpu backend of a scene.
pub struct CpuBackend {
    scene: Arc<Scene>,
    spec: CubeSpec,
    whole: OnceLock<Result<Arc<CpuScene>, String>>,
    /// The hierarchies over the triangles that sight lines can meet, by [`LineSet`].
    lines: [OnceLock<Result<Arc<CpuScene>, String>>; LineSet::COUNT],
    /// The hierarchy over the triangles that end lines and the triangles that lines pass.
    together: OnceLock<Result<Arc<CpuScene>, String>>,
}

impl CpuBackend {
    /// Creates the backend for `scene`. Hierarchies are built when they are first used.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if a coordinate is beyond the largest supported one, the scene is too narrow,
    /// or it has too many triangles.
    pub fn new(scene: Arc<Scene>, spec: CubeSpec) -> Result<Self, TracerError> {
        scene
            .check_reach("the scene")
            .map_err(|e| failed(e.to_string()))?;
        check_width(&scene).map_err(|e| failed(e.to_string()))?;
        if scene.len() > NUMBER {
            return Err(failed(format!(
                "the scene has {} triangles, and the tracer can number {NUMBER}",
                scene.len()
            )));
        }
        Ok(Self {
            scene,
            spec,
            whole: OnceLock::new(),
            lines: Default::default(),
            together: OnceLock::new(),
        })
    }

    /// Builds a hierarchy over the triangles that end rays, with their numbers, and over the triangles that
    /// rays pass.
    fn build(
        &self,
        ending: impl IndexedParallelIterator<Item = (u32, u32)>,
        passed: &[u32],
    ) -> Result<Arc<CpuScene>, String> {
        let ending = ending.map(|(number, id)| self.input(id, number, 0));
        let mut triangles: Vec<InputTriangle> = ending.flatten_iter().collect();
        let passed = passed.par_iter().map(|id| self.input(*id, *id, PASSED));
        triangles.par_extend(passed.flatten_iter());
        let near = crate::near_distance(self.scene.bounds());
        let units = Units::of_scene(self.scene.bounds());
        let hierarchy = WideHierarchy::build(&triangles, units)?;
        Ok(Arc::new(CpuScene::new(hierarchy, near)))
    }

    /// Returns a triangle with its marks, or `None` if it has no area or the scene lacks it.
    ///
    /// The vertices of a triangle with one side run counter-clockwise as seen from this side.
    fn input(&self, id: u32, number: u32, marks: u32) -> Option<InputTriangle> {
        let triangle = self.scene.triangles().get(id as usize)?;
        let [a, b, c] = triangle.v;
        let (vertices, side) = match self.scene.sides().side(TriangleId(id)) {
            Side::Both => ([a, b, c], 0),
            Side::CounterClockwise => ([a, b, c], ONE_SIDED),
            Side::Clockwise => ([a, c, b], ONE_SIDED),
        };
        (!triangle.is_degenerate()).then_some(InputTriangle {
            vertices,
            number: number | marks | side,
        })
    }

    /// Builds a hierarchy whose numbers are ids.
    fn build_lines(&self, ending: &[u32], passed: &[u32]) -> Result<Arc<CpuScene>, String> {
        self.build(ending.par_iter().map(|id| (*id, *id)), passed)
    }
}

fn failed(reason: String) -> TracerError {
    TracerError::Failed {
        profile: PROFILE.to_owned(),
        reason,
    }
}

impl Tracer for CpuBackend {
    fn profile(&self) -> &str {
        PROFILE
    }

    fn lines(&self, set: LineSet, ids: &[u32]) -> Result<Box<dyn LineTracer + '_>, TracerError> {
        let built = self.lines[set as usize].get_or_init(|| self.build_lines(ids, &[]));
        Ok(Box::new(CpuTracer(built.clone().map_err(failed)?)))
    }

    fn passing(
        &self,
        blocking: &[u32],
        see_through: &[u32],
    ) -> Result<Option<Box<dyn PassingTracer + '_>>, TracerError> {
        let built = self
            .together
            .get_or_init(|| self.build_lines(blocking, see_through));
        Ok(Some(Box::new(CpuTracer(built.clone().map_err(failed)?))))
    }

    fn prepare(&self, superset: Option<&[u32]>) -> Result<Box<dyn CubeRenderer + '_>, TracerError> {
        let ids: Vec<u32> = match superset {
            Some(ids) => ids.to_vec(),
            None => (0..self.scene.len()).collect(),
        };
        // The places in `ids` are the numbers of the triangles, so that samples need little memory.
        let numbered = || ids.par_iter().enumerate().map(|(at, id)| (at as u32, *id));
        let built = match superset {
            Some(_) => self.build(numbered(), &[]),
            None => self
                .whole
                .get_or_init(|| self.build(numbered(), &[]))
                .clone(),
        };
        let tracer = CpuTracer(built.map_err(failed)?);
        Ok(Box::new(CpuRenderer::new(tracer, ids, self.spec)))
    }
}
