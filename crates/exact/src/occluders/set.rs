//! All occluders of a scene, with the hierarchy over its triangles.

use glam::Vec3;
use rayon::prelude::*;
use sightline_certificate::proof::OccluderTriangle;
use sightline_geometry::bvh::Bvh;
use sightline_scene::topology::corner_vertices;
use sightline_scene::{Scene, SceneError, TriangleId};

use super::boundary_edges::BoundaryEdges;
use super::merge::MergedFaces;
use super::occluder::{Occluder, OccluderId, border};

/// All occluders of a scene.
pub struct Occluders {
    triangles: Vec<[Vec3; 3]>,
    occluders: Vec<Occluder>,
    /// The occluder of each triangle; `None` for triangles without area and for triangles that do not block.
    by_triangle: Vec<Option<OccluderId>>,
    /// For each triangle, true if it is reversed in its occluder.
    turned: Vec<bool>,
    boundary_edges: BoundaryEdges,
    /// Three corner numbers per triangle.
    corners: Vec<u32>,
    /// The hierarchy over the blocking triangles.
    bvh: Bvh,
    /// The triangles that can be in a set of visible triangles; `None` if these are the blocking triangles.
    targets: Option<Targets>,
    /// The largest magnitude of a coordinate of the scene.
    reach: f64,
}

/// The triangles that can be in a set of visible triangles, if these differ from the blocking triangles.
struct Targets {
    bvh: Bvh,
    is_target: Vec<bool>,
}

impl Occluders {
    /// Merges coplanar neighbouring triangles of a scene into convex occluders and builds the hierarchies.
    ///
    /// The function uses all threads of rayon.
    ///
    /// # Errors
    /// [`SceneError`] from [`corner_vertices`] if the scene has more corners than can be numbered, or if the
    /// scene culls back faces. Occluders, silhouettes and closed surfaces block from both sides.
    pub fn new(scene: &Scene) -> Result<Self, SceneError> {
        if !scene.sides().are_both() {
            return Err(SceneError::bad(
                "scene",
                "sides",
                "the scene culls back faces, but exact queries see every triangle from both sides",
                "omit --cull-back-faces, or use --method aggressive",
            ));
        }
        Self::from_both_sides(scene)
    }

    /// Creates the occluders like [`Occluders::new`], but treats every triangle as visible from both sides.
    ///
    /// # Errors
    /// [`SceneError`] from [`corner_vertices`] if the scene has more corners than can be numbered.
    pub fn from_both_sides(scene: &Scene) -> Result<Self, SceneError> {
        let corners = corner_vertices(scene)?;
        let triangles: Vec<[Vec3; 3]> = scene.triangles().iter().map(|t| t.v).collect();
        let ids = (0..scene.len()).into_par_iter();
        let solid: Vec<bool> = ids.clone().map(|t| scene.blocks(TriangleId(t))).collect();
        let shown: Option<Vec<bool>> = (!scene.kinds().all_opaque())
            .then(|| ids.map(|t| scene.shows(TriangleId(t))).collect());
        let joined = || {
            let mut faces = MergedFaces::new(&triangles, &corners, &solid);
            faces.merge();
            let (occluders, by_triangle) = faces.finish();
            let boundary_edges = BoundaryEdges::new(&occluders);
            let mut turned = vec![false; triangles.len()];
            occluders
                .iter()
                .flat_map(|o| &o.triangles)
                .for_each(|t| turned[t.triangle as usize] = t.reversed);
            (occluders, by_triangle, turned, boundary_edges)
        };
        let hierarchy = |included: &[bool]| {
            let boxes = scene.triangles().iter().map(|t| t.bounds()).collect();
            let items = (0..triangles.len() as u32)
                .filter(|i| included[*i as usize])
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
        let ((occluders, by_triangle, turned, boundary_edges), (bvh, targets)) =
            rayon::join(joined, hierarchies);
        let b = scene.bounds();
        let reach = f64::from(b.min.abs().max(b.max.abs()).max_element());
        Ok(Self {
            triangles,
            occluders,
            by_triangle,
            turned,
            boundary_edges,
            corners,
            bvh,
            targets,
            reach,
        })
    }

    /// Returns a triangle's vertices.
    pub fn triangle(&self, id: u32) -> &[Vec3; 3] {
        &self.triangles[id as usize]
    }

    /// Returns the number of triangles.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Returns true if the scene has no triangles. The result is always false, because a scene has at least
    /// one triangle.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Returns the occluder that contains a triangle, if such an occluder exists.
    pub fn occluder_id(&self, triangle: TriangleId) -> Option<OccluderId> {
        self.by_triangle[triangle.at()]
    }

    /// Returns the occluder of a triangle that a line passes through, or `None` if the triangle does not
    /// block.
    ///
    /// `front` is true if the line comes from the side from which the triangle's corners appear
    /// counter-clockwise. The flag in the result is true if the line passes the occluder's edges on their
    /// negative side.
    pub fn passed(&self, triangle: TriangleId, front: bool) -> Option<(OccluderId, bool)> {
        // Example: the line down the z axis, (0, 0, −1; 0, 0, 0), and an edge around it from x to y, (−1, 1,
        // 0; 0, 0, 1), have K = −1.
        self.occluder_id(triangle)
            .map(|id| (id, front != self.turned[triangle.at()]))
    }

    /// Returns an occluder.
    pub fn occluder(&self, id: OccluderId) -> &Occluder {
        &self.occluders[id.0 as usize]
    }

    /// Returns the boundary edges of all occluders.
    pub fn boundary_edges(&self) -> &BoundaryEdges {
        &self.boundary_edges
    }

    /// Returns the corner numbers of a triangle. Corners at equal positions have equal numbers.
    pub fn corners(&self, id: u32) -> [u32; 3] {
        let at = 3 * id as usize;
        [self.corners[at], self.corners[at + 1], self.corners[at + 2]]
    }

    /// Returns the boundary edges of a set of triangles, as corner numbers and as positions.
    ///
    /// Each member states whether its triangle is reversed. Boundary edges are the edges that remain after
    /// opposite edges cancel.
    pub fn border(&self, members: &[OccluderTriangle]) -> (Vec<[u32; 2]>, Vec<[Vec3; 2]>) {
        border(members, &self.triangles, &self.corners)
    }

    /// Returns the number of occluders.
    pub fn count(&self) -> usize {
        self.occluders.len()
    }

    /// Returns the hierarchy over the triangles with area that can be in a set of visible triangles.
    pub fn targets(&self) -> &Bvh {
        self.targets.as_ref().map_or(&self.bvh, |t| &t.bvh)
    }

    /// Returns true if a triangle has area and can be in a set of visible triangles.
    pub fn is_target(&self, triangle: TriangleId) -> bool {
        match &self.targets {
            None => self.occluder_id(triangle).is_some(),
            Some(targets) => targets.is_target[triangle.at()],
        }
    }

    /// Returns the hierarchy over the blocking triangles with area.
    pub fn hierarchy(&self) -> &Bvh {
        &self.bvh
    }

    /// Appends to `out` the triangles that the segment from `p` to `q` may meet.
    ///
    /// The ends of the segment are rounded combinations of points whose coordinates are at most `size`.
    pub fn along(&self, p: glam::DVec3, q: glam::DVec3, size: f64, out: &mut Vec<u32>) {
        self.bvh.along(p, q, self.slack(size), out);
    }

    /// Returns a bound on the rounding error of a coordinate of a segment end. The end is a rounded
    /// combination of points whose coordinates are at most `size` in magnitude.
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
        /// Tests lines through the interior of one of two triangles that form one occluder, for both
        /// orientations of each.
        #[test]
        fn passed_reports_side_of_edges(
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
            // A point inside, multiplied by the sum of the weights, and the line through the point.
            let w = weights.map(f64::from);
            let (x, total) = (p * w[0] + q * w[1] + r * w[2], w[0] + w[1] + w[2]);
            let (way, moment) = (along * total, x.cross(along));
            let front = (q - p).cross(r - p).dot(along) < 0.0;
            let (id, negative) = scene.passed(TriangleId(u32::from(second)), front).unwrap();
            for [s, t] in &scene.occluder(id).border {
                let (s, t) = (s.as_dvec3(), t.as_dvec3());
                let form = way.dot(s.cross(t)) + moment.dot(t - s);
                prop_assert!(form != 0.0 && (form < 0.0) == negative, "{} {}", form, negative);
            }
        }
    }
}
