//! Exact overlap tests of triangles and boxes. Both are closed, so touching counts as overlap.
//!
//! The separating axes (Akenine-Möller, "Fast 3D Triangle–Box Overlap Testing", 2001) are the box's three
//! normals, the triangle's normal, and the nine cross products of an edge of the box and an edge of the
//! triangle. Every comparison along an axis
//! is an orientation of `f32` points, which [`sightline_geometry::predicates`] decides with proved filter
//! bounds and without an epsilon.

use std::cmp::Ordering;

use glam::Vec3;
use sightline_geometry::predicates::{orient2d_sign, orient3d_sign};

use crate::{Aabb, Scene, Triangle};

/// Returns true if the closed triangle and the closed box share a point.
///
/// An empty box (`min` > `max` on some axis) never meets a triangle. A triangle without area is treated as a
/// segment or point.
pub fn triangle_touches_box(t: &Triangle, b: &Aabb) -> bool {
    b.min.cmple(b.max).all()
        && t.bounds().touches(b)
        && (t
            .v
            .iter()
            .any(|v| b.min.cmple(*v).all() && v.cmple(b.max).all())
            || !edge_separates(t, b, 0, 1)
                && !edge_separates(t, b, 1, 2)
                && !edge_separates(t, b, 2, 0)
                && plane_meets(t, b))
}

/// Returns the ids of the triangles with area that meet `bounds`, ascending.
///
/// Searches among `ids` in any order, or in the whole scene if `ids` is `None`. Ids that are not in the scene
/// are ignored.
pub fn triangles_in_box(scene: &Scene, ids: Option<&[u32]>, bounds: &Aabb) -> Vec<u32> {
    let meets = |id: &u32| {
        scene.triangles().get(*id as usize).is_some_and(|t| {
            t.bounds().touches(bounds) && triangle_touches_box(t, bounds) && !t.is_degenerate()
        })
    };
    match ids {
        None => (0..scene.len()).filter(meets).collect(),
        Some(ids) => {
            let mut found: Vec<u32> = ids.iter().copied().filter(meets).collect();
            found.sort_unstable();
            found.dedup();
            found
        }
    }
}

/// Returns true if a plane parallel to the third axis and to a triangle edge separates triangle and box.
///
/// The axes `i` and `j` are the other two. In the projection along the third axis, the triangle is on or
/// behind the edge, and the whole rectangle of the box is strictly in front of the edge. Only the side
/// without the triangle must be tested. A face of the Minkowski difference that an edge of each shape creates
/// has the triangle's edge as its support: no part of the triangle is in front of this edge.
fn edge_separates(t: &Triangle, b: &Aabb, i: usize, j: usize) -> bool {
    let flat = |v: Vec3| [v[i], v[j]];
    (0..3).any(|k| {
        let (p, q, r) = (flat(t.v[k]), flat(t.v[(k + 1) % 3]), flat(t.v[(k + 2) % 3]));
        let rest = orient2d_sign(p, q, r);
        // The corner with the maximum (q−p)×(x−p) has the larger y if q−p points right, and the smaller x if
        // q−p points up. The corner with the minimum is opposite.
        let pick = |up: bool, a: usize| if up { b.max[a] } else { b.min[a] };
        let (right, up) = (q[0] > p[0], q[1] > p[1]);
        let greatest = [pick(!up, i), pick(right, j)];
        let least = [pick(up, i), pick(!right, j)];
        (rest != Ordering::Greater && orient2d_sign(p, q, least) == Ordering::Greater)
            || (rest != Ordering::Less && orient2d_sign(p, q, greatest) == Ordering::Less)
    })
}

/// Returns true if the triangle's plane meets the box: the box's corners that are furthest along and against
/// the normal are not strictly on one side. For a triangle without area, which has no plane, the result is
/// also true, because every sign is `Equal`.
fn plane_meets(t: &Triangle, b: &Aabb) -> bool {
    let [p, q, r] = t.v;
    let mut front = b.min;
    let mut back = b.max;
    for axis in 0..3 {
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        if orient2d_sign([p[i], p[j]], [q[i], q[j]], [r[i], r[j]]) == Ordering::Greater {
            front[axis] = b.max[axis];
            back[axis] = b.min[axis];
        }
    }
    orient3d_sign(p, q, r, front) != Ordering::Less
        && orient3d_sign(p, q, r, back) != Ordering::Greater
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::Object;

    fn tri(v: [[f32; 3]; 3]) -> Triangle {
        Triangle {
            v: v.map(Vec3::from),
        }
    }

    fn unit() -> Aabb {
        Aabb {
            min: Vec3::ZERO,
            max: Vec3::ONE,
        }
    }

    /// Clips the triangle by the box's six half-spaces in homogeneous integers. Returns true if a part
    /// remains.
    fn clipped(v: [[i32; 3]; 3], lo: [i32; 3], hi: [i32; 3]) -> bool {
        let gcd = |mut a: i128, mut b: i128| {
            while b != 0 {
                (a, b) = (b, a % b);
            }
            a.abs().max(1)
        };
        let mut polygon: Vec<[i128; 4]> = v
            .iter()
            .map(|p| [p[0].into(), p[1].into(), p[2].into(), 1])
            .collect();
        for axis in 0..3 {
            for (bound, s) in [(i128::from(lo[axis]), 1), (i128::from(hi[axis]), -1)] {
                let d = |p: &[i128; 4]| s * (p[axis] - bound * p[3]);
                let mut kept = Vec::new();
                for (k, p) in polygon.iter().enumerate() {
                    let q = &polygon[(k + 1) % polygon.len()];
                    let (dp, dq) = (d(p), d(q));
                    if dp >= 0 {
                        kept.push(*p);
                    }
                    if dp.signum() * dq.signum() < 0 {
                        let cut = [0, 1, 2, 3].map(|c| p[c] * dq.abs() + q[c] * dp.abs());
                        let g = cut.iter().fold(0, |g, c| gcd(g, *c));
                        kept.push(cut.map(|c| c / g));
                    }
                }
                polygon = kept;
            }
        }
        !polygon.is_empty()
    }

    #[test]
    fn touching_counts_and_next_float_does_not() {
        let up = |x: f32| f32::from_bits(x.to_bits() + 1);
        // A face, an edge and a corner that only touch the box.
        assert!(triangle_touches_box(
            &tri([[1., 0., 0.], [1., 1., 0.], [1., 0., 1.]]),
            &unit()
        ));
        assert!(!triangle_touches_box(
            &tri([[up(1.), 0., 0.], [up(1.), 1., 0.], [up(1.), 0., 1.]]),
            &unit()
        ));
        let corner = |s: f32| tri([[s, 0., 0.], [0., s, 0.], [0., 0., s]]);
        assert!(triangle_touches_box(&corner(3.), &unit()));
        assert!(!triangle_touches_box(&corner(up(3.)), &unit()));
        let edge = |s: f32| tri([[s, 0., 0.5], [0., s, 0.5], [s, s, 0.5]]);
        assert!(triangle_touches_box(&edge(2.), &unit()));
        assert!(!triangle_touches_box(&edge(up(2.)), &unit()));
    }

    #[test]
    fn last_bit_decides_slivers() {
        // The sliver passes the box's edge x = 1, y = 1 at a distance far below the rounding of f64 products.
        let far = 16_777_216.0f32;
        let sliver = |e: f32| {
            tri([
                [1. + far, 1. - far, 0.25],
                [1. - far, 1. + far, 0.25],
                [far, far + e, 0.25],
            ])
        };
        assert!(triangle_touches_box(&sliver(2.), &unit()));
        let off = tri([
            [far, -far + 2., 0.25],
            [-far + 2., far, 0.25],
            [far, far, 0.25],
        ]);
        assert!(
            triangle_touches_box(&off, &unit()),
            "x + y = 2 passes through the corner"
        );
        let past = tri([
            [far, -far + 3., 0.25],
            [-far + 2., far, 0.25],
            [far, far, 0.25],
        ]);
        assert!(!triangle_touches_box(&past, &unit()));
        // A needle along the diagonal, with hardly any area.
        let needle = tri([
            [-1e30, -1e30, -1e30],
            [1e30, 1e30, 1e30],
            [1e30, 1e30, 1.000_000_1e30],
        ]);
        assert!(triangle_touches_box(&needle, &unit()));
    }

    #[test]
    fn degenerate_triangles_are_segments_and_are_not_listed() {
        let segment = tri([[-1., -1., -1.], [2., 2., 2.], [0., 0., 0.]]);
        let miss = tri([[-1., 1.5, 0.], [0.5, 3., 0.], [0., 2.5, 0.]]);
        let hit = tri([[0.2, 0.2, 0.2], [0.4, 0.2, 0.2], [0.2, 0.4, 0.2]]);
        assert!(triangle_touches_box(&segment, &unit()) && !triangle_touches_box(&miss, &unit()));
        let objects = vec![Object {
            name: "all".into(),
            first: 0,
            count: 4,
        }];
        let scene = Scene::new("test", vec![hit, segment, miss, hit], objects).unwrap();
        assert_eq!(triangles_in_box(&scene, None, &unit()), [0, 3]);
        assert_eq!(
            triangles_in_box(&scene, Some(&[3, 1, 3, 0, 99]), &unit()),
            [0, 3]
        );
        assert!(triangles_in_box(&scene, None, &Aabb::EMPTY).is_empty());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn agrees_with_clipping_under_symmetries(
            v in prop::array::uniform3(prop::array::uniform3(-5i32..6)),
            lo in prop::array::uniform3(-3i32..3),
            size in prop::array::uniform3(0i32..4),
            e in -100i32..100,
        ) {
            let hi = [lo[0] + size[0], lo[1] + size[1], lo[2] + size[2]];
            let truth = clipped(v, lo, hi);
            let float = |p: [i32; 3]| Vec3::from(p.map(|c| c as f32));
            for (i, j, k) in [(0, 1, 2), (1, 2, 0), (2, 0, 1), (1, 0, 2), (0, 2, 1), (2, 1, 0)] {
                let swap = |p: [i32; 3]| float([p[i], p[j], p[k]]) * 2f32.powi(e);
                let b = Aabb { min: swap(lo), max: swap(hi) };
                let t = Triangle { v: v.map(swap) };
                prop_assert_eq!(triangle_touches_box(&t, &b), truth);
                let turned = Triangle { v: [t.v[i], t.v[j], t.v[k]] };
                prop_assert_eq!(triangle_touches_box(&turned, &b), truth);
            }
        }
    }
}
