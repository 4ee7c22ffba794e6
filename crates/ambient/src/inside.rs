//! A test for receivers inside closed solids of blocking triangles. No viewpoint outside a solid sees its
//! inside.

use glam::{DVec3, Vec3};
use sightline_geometry::Bvh;
use sightline_geometry::rounding::UNIT as U;
use sightline_numbers::Aabb;
use sightline_scene::topology::Solids;
use sightline_scene::{Scene, SceneError, TriangleId};

use crate::receivers::Receiver;

/// Maximum number of tested directions per receiver. If the line in one direction touches an edge, the test
/// continues with the next direction.
const TRIES: u32 = 8;

/// The triangles of the closed solids of a scene whose normals all point outwards.
pub struct Inside {
    triangles: Vec<[Vec3; 3]>,
    /// The ids of the triangles in the scene.
    ids: Vec<u32>,
    bvh: Bvh,
    bounds: Aabb,
}

impl Inside {
    /// Finds the solids of a scene.
    ///
    /// # Errors
    /// [`SceneError`] as for [`Solids::find`].
    pub fn new(scene: &Scene) -> Result<Self, SceneError> {
        let solids = Solids::find_blocking(scene)?;
        let outer = |id: u32| solids.outward(TriangleId(id)) == Some(1.0);
        let ids: Vec<u32> = (0..scene.len()).filter(|id| outer(*id)).collect();
        let triangles: Vec<[Vec3; 3]> = ids
            .iter()
            .map(|id| scene.triangles()[*id as usize].v)
            .collect();
        let boxes: Vec<Aabb> = triangles
            .iter()
            .map(|t| Aabb::around(t.iter().copied()))
            .collect();
        let bounds = boxes.iter().fold(Aabb::EMPTY, |all: Aabb, b| all.union(*b));
        let order = (0..triangles.len() as u32).collect();
        Ok(Self {
            bvh: Bvh::new(boxes, order),
            triangles,
            ids,
            bounds,
        })
    }

    /// Returns true if a receiver, moved slightly above its surface, is inside a solid.
    ///
    /// A line from a receiver inside n solids leaves solids n times more often than the line enters solids.
    /// If every tested line touches an edge, the receiver counts as outside.
    pub fn holds(&self, receiver: &Receiver) -> bool {
        let x = receiver.point;
        let box_ = (self.bounds.min.as_dvec3(), self.bounds.max.as_dvec3());
        if self.triangles.is_empty() || x.cmplt(box_.0).any() || x.cmpgt(box_.1).any() {
            return false;
        }
        let n = receiver.normal.normalize();
        let (u, v) = n.any_orthonormal_pair();
        let away = (box_.1 - box_.0).length() * 2.0;
        let mut near = Vec::new();
        (0..TRIES).find_map(|k| {
            // The tangent of the angle to the normal is 0.1 to 0.8, and each direction tilts to another side.
            let (tilt, turn) = (0.1 + 0.1 * f64::from(k), 2.4 * f64::from(k) + 0.37);
            let way = (n + u * (tilt * libm::cos(turn)) + v * (tilt * libm::sin(turn))).normalize()
                * away;
            near.clear();
            let size = x.abs().max_element() + away;
            self.bvh.along(x, x + way, size * 1e-12, &mut near);
            // The receiver counts as above its own triangle, even if rounding moved the receiver below.
            let others = near
                .iter()
                .filter(|t| receiver.triangle != Some(TriangleId(self.ids[**t as usize])));
            let leaves = others.copied().try_fold(0i64, |sum, t| {
                Some(sum + crossing(&self.triangles[t as usize], x, way)?)
            });
            leaves.map(|leaves| leaves > 0)
        }) == Some(true)
    }
}

/// Returns 1 if a ray leaves through a triangle along its normal, and −1 if the ray enters.
///
/// Returns 0 if the ray misses the triangle or starts in its plane, and `None` if doubles cannot decide.
fn crossing(triangle: &[Vec3; 3], x: DVec3, way: DVec3) -> Option<i64> {
    let [a, b, c] = triangle.map(|p| p.as_dvec3() - x);
    let rounded = 4.0 * U * x.abs().max_element();
    let (p, q) = (b - a, c - a);
    let normal = p.cross(q);
    let height = normal.dot(a);
    if height.abs() <= (16.0 * U * a.length() + rounded) * p.length() * q.length() {
        return Some(0);
    }
    let sign = |p: DVec3, q: DVec3| {
        let value = p.cross(q).dot(way);
        let error = (16.0 * U * p.length() * q.length() + rounded * (p.length() + q.length()))
            * way.length();
        (value.abs() > error).then_some(value > 0.0)
    };
    let sides = [sign(a, b), sign(b, c), sign(c, a)];
    // Two sides with certain and different signs prove a miss, whatever the sign of the third side is.
    if sides.contains(&Some(true)) && sides.contains(&Some(false)) {
        return Some(0);
    }
    let [Some(side), Some(_), Some(_)] = sides else {
        return None;
    };
    // If all three signs are positive, the triangle runs counter-clockwise about the ray. The ray leaves
    // through the triangle if the triangle is ahead.
    let ahead = (height > 0.0) == (normal.dot(way) > 0.0);
    Some(i64::from(ahead) * if side { 1 } else { -1 })
}
