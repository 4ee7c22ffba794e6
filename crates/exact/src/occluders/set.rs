//! All occluders of a scene, with the hierarchy over its triangles.

use glam::Vec3;
use rayon::prelude::*;
use sightline_certificate::proof::OccluderTriangle;
use sightline_geometry::bvh::Bvh;
use sightline_scene::topology::corner_vertices;
use sightline_scene::{Scene, SceneError};

use super::boundary_edges::BoundaryEdges;
use super::merge::MergedFaces;
use super::occluder::{Occluder, OccluderId, border};

/// All occluders of a scene.
pub struct Occluders {
    triangles: Vec<[Vec3; 3]>,
    occluders: Vec<Occluder>,
    /// The occluder of each triangle; none for those without area and those that do not block.
    of: Vec<Option<OccluderId>>,
    /// Whether each triangle is reversed in its occluder.
    turned: Vec<bool>,
    boundary_edges: BoundaryEdges,
    /// Three corner numbers a triangle.
    corners: Vec<u32>,
    /// The hierarchy over the blocking triangles.
    bvh: Bvh,
    /// The hierarchy over the triangles that can be in a set; none if these are the blocking ones.
    targets: Option<Targets>,
    reach: f64,
}

/// The triangles that can be in a set, where some of these do not block or some that block are not shown.
struct Targets {
    bvh: Bvh,
    is_target: Vec<bool>,
}

impl Occluders {
    /// Merges the coplanar neighbours of a scene into convex occluders and builds the hierarchy, on all of
    /// rayon's threads.
    ///
    /// # Errors
    /// As [`corner_vertices`]: when the scene has more corners than can be numbered. Also when some triangles
    /// have one side: occluders, silhouettes and closed surfaces block from both.
    pub fn new(scene: &Scene) -> Result<Self, SceneError> {
        if !scene.sides().are_both() {
            return Err(SceneError::bad(
                "scene",
                "sides",
                "its back faces are culled, and exact queries take every triangle as seen from both sides",
                "leave --cull-back-faces out, or give --method aggressive",
            ));
        }
        Self::from_both_sides(scene)
    }

    /// [`Occluders::new`] for what takes every triangle as seen from both sides, whatever the scene says.
    ///
    /// # Errors
    /// As [`corner_vertices`]: when the scene has more corners than can be numbered.
    pub fn from_both_sides(scene: &Scene) -> Result<Self, SceneError> {
        let corners = corner_vertices(scene)?;
        let triangles: Vec<[Vec3; 3]> = scene.triangles().iter().map(|t| t.v).collect();
        let ids = (0..scene.len()).into_par_iter();
        let solid: Vec<bool> = ids.clone().map(|t| scene.blocks(t)).collect();
        let shown: Option<Vec<bool>> =
            (!scene.kinds().all_opaque()).then(|| ids.map(|t| scene.shows(t)).collect());
        let joined = || {
            let mut faces = MergedFaces::new(&triangles, &corners, &solid);
            faces.merge();
            let (occluders, of) = faces.finish();
            let boundary_edges = BoundaryEdges::new(&occluders);
            let mut turned = vec![false; triangles.len()];
            occluders
                .iter()
                .flat_map(|o| &o.triangles)
                .for_each(|t| turned[t.triangle as usize] = t.reversed);
            (occluders, of, turned, boundary_edges)
        };
        let hierarchy = |of: &[bool]| {
            let boxes = scene.triangles().iter().map(|t| t.bounds()).collect();
            let items = (0..triangles.len() as u32)
                .filter(|i| of[*i as usize])
                .collect();
            Bvh::new(boxes, items)
        };
        let hierarchies = || {
            let targets = shown.map(|is_target| Targets {
                bvh: hierarchy(&is_target),
                is_target,
            });
            (hierarchy(&solid), targets)
        };
        let ((occluders, of, turned, boundary_edges), (bvh, targets)) =
            rayon::join(joined, hierarchies);
        let b = scene.bounds();
        let reach = f64::from(b.min.abs().max(b.max.abs()).max_element());
        Ok(Self {
            triangles,
            occluders,
            of,
            turned,
            boundary_edges,
            corners,
            bvh,
            targets,
            reach,
        })
    }

    /// A triangle's vertices.
    pub fn triangle(&self, id: u32) -> &[Vec3; 3] {
        &self.triangles[id as usize]
    }

    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Whether there is no triangle; a scene has at least one.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// The occluder a triangle is part of.
    pub fn of(&self, triangle: u32) -> Option<OccluderId> {
        self.of[triangle as usize]
    }

    /// The occluder of a triangle that a line goes through, and whether the line passes the occluder's edges
    /// on their negative side. `front` says whether the line comes from the side from which the triangle's
    /// corners appear counter-clockwise.
    pub fn passed(&self, triangle: u32, front: bool) -> Option<(OccluderId, bool)> {
        // Down the z axis, (0, 0, −1; 0, 0, 0), with an edge around it from x to y, (−1, 1, 0; 0, 0, 1): K =
        // −1.
        self.of(triangle)
            .map(|id| (id, front != self.turned[triangle as usize]))
    }

    /// An occluder.
    pub fn occluder(&self, id: OccluderId) -> &Occluder {
        &self.occluders[id.0 as usize]
    }

    /// The edges of all occluders' borders.
    pub fn boundary_edges(&self) -> &BoundaryEdges {
        &self.boundary_edges
    }

    /// The numbers of a triangle's corners; equal positions have equal numbers.
    pub fn corners(&self, id: u32) -> [u32; 3] {
        let at = 3 * id as usize;
        [self.corners[at], self.corners[at + 1], self.corners[at + 2]]
    }

    /// The boundary edges of some triangles, each perhaps reversed: the edges that remain when opposite ones
    /// are removed.
    pub fn border(&self, members: &[OccluderTriangle]) -> (Vec<[u32; 2]>, Vec<[Vec3; 2]>) {
        border(members, &self.triangles, &self.corners)
    }

    /// Number of occluders.
    pub fn count(&self) -> usize {
        self.occluders.len()
    }

    /// The hierarchy over the triangles with an area that can be in a set.
    pub fn targets(&self) -> &Bvh {
        self.targets.as_ref().map_or(&self.bvh, |t| &t.bvh)
    }

    /// Whether a triangle has an area and can be in a set.
    pub fn is_target(&self, triangle: u32) -> bool {
        match &self.targets {
            None => self.of(triangle).is_some(),
            Some(targets) => targets.is_target[triangle as usize],
        }
    }

    /// The hierarchy over the blocking triangles with an area.
    pub fn hierarchy(&self) -> &Bvh {
        &self.bvh
    }

    /// Appends the triangles that the segment may meet. Its ends are rounded combinations of points whose
    /// coordinates are at most `size`.
    pub fn along(&self, p: glam::DVec3, q: glam::DVec3, size: f64, out: &mut Vec<u32>) {
        self.bvh.along(p, q, self.slack(size), out);
    }

    /// Bound on the rounding error of a coordinate of such an end.
    pub fn slack(&self, size: f64) -> f64 {
        self.reach.max(size) * 1e-14
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;
    use sightline_scene::{Object, Triangle};

    use super::*;

    proptest! {
        /// Lines through the interior of one of two triangles that form one occluder, for both orientations
        /// of each.
        #[test]
        fn edges_are_passed_on_the_side_that_is_said(
            corners in prop::array::uniform3(prop::array::uniform2(-8i32..9)),
            turned in prop::array::uniform2(any::<bool>()),
            tilt in prop::array::uniform2(-3i32..4),
            along in prop::array::uniform3(-9i32..10),
            weights in prop::array::uniform3(1i32..5),
            second in any::<bool>(),
        ) {
            // The two triangles form a parallelogram in a tilted plane, with integer coordinates.
            let at = |[x, y]: [i32; 2]| {
                DVec3::new(f64::from(x), f64::from(y), f64::from(tilt[0] * x + tilt[1] * y))
            };
            let [a, b, c] = corners.map(at);
            let d = b + c - a;
            let normal = (b - a).cross(c - a);
            let along = DVec3::from(along.map(f64::from));
            prop_assume!(normal.dot(along) != 0.0);
            let shapes: Vec<[DVec3; 3]> = [[a, b, c], [d, c, b]]
                .into_iter()
                .zip(turned)
                .map(|([p, q, r], turned)| if turned { [p, r, q] } else { [p, q, r] })
                .collect();
            let triangles = shapes.iter().map(|t| Triangle { v: t.map(|p| p.as_vec3()) }).collect();
            let object = Object { name: "all".to_owned(), first: 0, count: 2 };
            let scene = Occluders::new(&Scene::new("two", triangles, vec![object]).unwrap()).unwrap();
            prop_assert_eq!(scene.count(), 1);
            let [p, q, r] = shapes[usize::from(second)];
            // A point inside, times the sum of the weights, and the line through it.
            let w = weights.map(f64::from);
            let (x, total) = (p * w[0] + q * w[1] + r * w[2], w[0] + w[1] + w[2]);
            let (way, moment) = (along * total, x.cross(along));
            let front = (q - p).cross(r - p).dot(along) < 0.0;
            let (id, negative) = scene.passed(u32::from(second), front).unwrap();
            for [s, t] in &scene.occluder(id).border {
                let (s, t) = (s.as_dvec3(), t.as_dvec3());
                let form = way.dot(s.cross(t)) + moment.dot(t - s);
                prop_assert!(form != 0.0 && (form < 0.0) == negative, "{} {}", form, negative);
            }
        }
    }
}
