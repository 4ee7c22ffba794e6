//! Segments between points in single precision: the exact test whether a segment shows a triangle, and a
//! guess of the first triangle that it meets.
//!
//! Nearly all visible triangles are visible along an open set of many lines, so a witness with ends in single
//! precision usually exists. Queries in line space decide the triangles that are visible only along thin sets
//! of lines.

use std::cmp::Ordering;

use glam::{DVec3, Vec3};
use sightline_geometry::predicates::{Crossing, crossing, orient3d_sign};

use super::set::Occluders;

/// Returns true if the segment from `p` to `q` passes through a triangle and meets no other.
///
/// The segment must pass through the triangle's interior.
///
/// Other triangles in the same plane do not count as met. `scratch` is a buffer whose contents do not matter.
/// Such a segment is a witness, because all nearby segments pass through the triangle, too.
pub fn shows(scene: &Occluders, p: Vec3, q: Vec3, id: u32, scratch: &mut Vec<u32>) -> bool {
    let [a, b, c] = *scene.triangle(id);
    if crossing([a, b, c], p, q) != Crossing::Inside {
        return false;
    }
    scratch.clear();
    let size = f64::from(p.abs().max(q.abs()).max_element());
    scene.along(p.as_dvec3(), q.as_dvec3(), size, scratch);
    scratch.iter().all(|other| {
        let t = *scene.triangle(*other);
        *other == id
            || crossing(t, p, q) == Crossing::Not
            || t.iter()
                .all(|v| orient3d_sign(a, b, c, *v) == Ordering::Equal)
    })
}

/// Returns the first triangle that a ray meets, and its distance in units of the length of `direction`.
///
/// The computation in doubles has no error bound, so the result is only a proposal.
pub fn first(scene: &Occluders, origin: DVec3, direction: DVec3) -> Option<(u32, f64)> {
    let mut best: Option<(u32, f64)> = None;
    scene.hierarchy().nearest(origin, direction, |id, limit| {
        let [a, b, c] = scene.triangle(id).map(|v| v.as_dvec3());
        // The test follows Möller and Trumbore 1997.
        let (e, f) = (b - a, c - a);
        let h = direction.cross(f);
        let det = e.dot(h);
        let s = origin - a;
        let (u, w) = (s.dot(h) / det, s.cross(e));
        let (v, t) = (direction.dot(w) / det, f.dot(w) / det);
        // The condition is false for NaN, which a triangle parallel to the ray gives.
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < limit {
            best = Some((id, t));
            return t;
        }
        limit
    });
    best
}

#[cfg(test)]
mod tests {
    use sightline_scene::{Object, Scene, Triangle};

    use super::*;

    fn scene(triangles: &[[[f32; 3]; 3]]) -> Occluders {
        let triangles: Vec<Triangle> = triangles
            .iter()
            .map(|t| Triangle {
                v: t.map(Vec3::from),
            })
            .collect();
        let object = Object {
            name: "all".to_owned(),
            first: 0,
            count: triangles.len() as u32,
        };
        Occluders::new(&Scene::new("test", triangles, vec![object]).unwrap()).unwrap()
    }

    #[test]
    fn segment_shows_first_triangle_on_its_way() {
        let at = |x: f32| [[x, -1.0, -1.0], [x, 2.0, -1.0], [x, -1.0, 2.0]];
        let s = scene(&[at(1.0), at(2.0), at(1.0)]);
        let mut scratch = Vec::new();
        let mut shows =
            |p: [f32; 3], q: [f32; 3], id| shows(&s, p.into(), q.into(), id, &mut scratch);
        assert!(shows([0.0; 3], [1.5, 0.0, 0.0], 0) && shows([0.0; 3], [1.5, 0.0, 0.0], 2));
        assert!(!shows([0.0; 3], [1.5, 0.0, 0.0], 1) && !shows([0.0; 3], [2.5, 0.0, 0.0], 1));
        assert!(
            !shows([0.0; 3], [1.0, 0.0, 0.0], 0),
            "it ends on the triangle"
        );
        assert!(
            !shows([0.0, 0.5, 0.5], [1.5, 0.5, 0.5], 0),
            "it meets an edge"
        );
        assert!(
            !shows([0.0, 3.0, 0.0], [1.5, 3.0, 0.0], 0),
            "it passes outside"
        );
        assert!(shows([3.0, 0.0, 0.0], [1.5, 0.0, 0.0], 1), "from behind");
        assert!(
            !shows([1.0, 0.0, 0.0], [2.5, 0.0, 0.0], 1),
            "it begins on another triangle"
        );
        assert!(shows([1.25, 0.0, 0.0], [2.5, 0.0, 0.0], 1));
        assert_eq!(first(&s, DVec3::ZERO, DVec3::X).map(|(_, t)| t), Some(1.0));
        assert_eq!(
            first(&s, DVec3::new(1.5, 0.0, 0.0), DVec3::X * 0.5),
            Some((1, 1.0))
        );
        assert_eq!(first(&s, DVec3::new(2.5, 0.0, 0.0), DVec3::X), None);
    }
}
