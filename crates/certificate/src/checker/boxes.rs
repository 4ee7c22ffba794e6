//! Boxes: their faces as polygons and planes, and a test of triangles against a box.

use std::cmp::Ordering;

use dashu_int::IBig;
use glam::Vec3;
use sightline_numbers::Aabb;

use super::Corners;
use super::geometry::{Plane, Point, cut, exact, has_area, height, point, sign};
use crate::certificate::faces;

/// Returns the plane of a face of a box, with its normal pointing out of the box.
pub(super) fn face_plane(Aabb { min, max }: Aabb, axis: usize, up: bool) -> Plane {
    let [x, y, z, w] = point([f64::from(if up { max[axis] } else { min[axis] }), 0.0, 0.0]);
    debug_assert!(y.is_zero() && z.is_zero());
    let mut out: Plane = std::array::from_fn(|_| IBig::ZERO);
    (out[axis], out[3]) = (w, x);
    if up { out } else { out.map(|c| -c) }
}

/// Returns the corners of a face of a box in order. The first corner is the lowest corner of the face. The
/// second corner follows along the axis after `axis` in the cyclic order x, y, z.
pub(super) fn face(Aabb { min, max }: Aabb, axis: usize, up: bool) -> Corners {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    [[false, false], [true, false], [true, true], [false, true]]
        .into_iter()
        .map(|[s, t]| {
            let mut p = min.as_dvec3();
            let max = max.as_dvec3();
            if up {
                p[axis] = max[axis];
            }
            if s {
                p[u] = max[u];
            }
            if t {
                p[v] = max[v];
            }
            point(p.to_array())
        })
        .collect()
}

/// Returns true if a triangle with area has a point in a box, including the border. The function clips the
/// triangle to one face after another.
pub(super) fn meets_box(t: &[Vec3; 3], cell: Aabb) -> bool {
    if !has_area(t) {
        return false;
    }
    let mut left: Vec<Point> = exact(t).into();
    for (axis, up) in faces() {
        let flat = face_plane(cell, axis, up);
        let heights: Vec<_> = left.iter().map(|p| height(&flat, p)).collect();
        let n = left.len();
        let mut kept = Vec::with_capacity(n + 1);
        for i in 0..n {
            let j = (i + 1) % n;
            if sign(&heights[i]) != Ordering::Greater {
                kept.push(left[i].clone());
            }
            if sign(&(&heights[i] * &heights[j])) == Ordering::Less {
                kept.push(cut(&left[i], &left[j], &flat));
            }
        }
        left = kept;
    }
    !left.is_empty()
}
