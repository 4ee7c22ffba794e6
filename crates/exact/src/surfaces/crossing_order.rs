//! The order in which a segment crosses two triangles, computed in doubles with an error bound or, if the
//! bound leaves the order open, in integers.

use std::cmp::Ordering;

use dashu_int::ops::Abs as _;
use glam::{DVec3, Vec3};
use sightline_geometry::predicates::det3;
use sightline_geometry::rounding::UNIT as U;

use crate::arithmetic::number::homogeneous;
use crate::geometry::predicates;

/// Compares the points at which the segment from `from` to `to` crosses two triangles: `Less` if the segment
/// crosses `u` first.
pub fn sooner(u: &[Vec3; 3], t: &[Vec3; 3], from: Vec3, to: Vec3) -> Ordering {
    sooner_filtered(u, t, from, to).unwrap_or_else(|| sooner_exact(u, t, from, to))
}

/// Computes the order of [`sooner`] in doubles, or returns `None` if doubles cannot decide it.
///
/// The segment crosses a plane at from + s(to − from) with s = a / (a + b), where a and b are the distances
/// of the ends from the plane. So s(u) < s(t) if a(u) b(t) < a(t) b(u).
fn sooner_filtered(u: &[Vec3; 3], t: &[Vec3; 3], from: Vec3, to: Vec3) -> Option<Ordering> {
    let heights = |triangle: &[Vec3; 3]| [from, to].map(|p| height(triangle, p));
    let ([au, bu], [at, bt]) = (heights(u), heights(t));
    let less = |x: (f64, f64), y: (f64, f64), z: (f64, f64), w: (f64, f64)| {
        // The closure compares the upper bound of a product with the lower bound of another. The bounds are
        // twice the errors, and so 8u too large. This covers the roundings, which are below 8u of each
        // product.
        (x.0 + x.1) * (y.0 + y.1) < (z.0 - z.1).max(0.0) * (w.0 - w.1).max(0.0)
    };
    if less(au, bt, at, bu) {
        Some(Ordering::Less)
    } else {
        less(at, bu, au, bt).then_some(Ordering::Greater)
    }
}

/// Computes the order of [`sooner`] in integers.
fn sooner_exact(u: &[Vec3; 3], t: &[Vec3; 3], from: Vec3, to: Vec3) -> Ordering {
    let exact = |triangle: &[Vec3; 3]| {
        let point = |v: Vec3| homogeneous(v.as_dvec3().to_array());
        let [a, b, c] = triangle.map(point);
        let flat = predicates::plane([&a, &b, &c]);
        // Multiply each height by the other end's w, so that both heights have the same scale.
        let (p, q) = (point(from), point(to));
        [
            predicates::height(&flat, &p) * &q[3],
            predicates::height(&flat, &q) * &p[3],
        ]
    };
    let ([au, bu], [at, bt]) = (exact(u), exact(t));
    (au * bt).abs().cmp(&(at * bu).abs())
}

/// Computes the distance of a point from a triangle's plane, times twice the triangle's area, and a bound on
/// the error of this product.
///
/// The error is at most 8u of the products' magnitudes: 7u as in the filter of
/// [`sightline_geometry::predicates::orient3d_sign`], and u for the last addition. The bound is twice that.
fn height(t: &[Vec3; 3], p: Vec3) -> (f64, f64) {
    let [a, x, y, z] = [t[0], t[1], t[2], p].map(|v| v.as_dvec3());
    let d = |x: DVec3| (x - a).to_array();
    let (det, magnitude) = det3(d(x), d(y), d(z));
    (det.abs(), 16.0 * U * magnitude)
}

#[cfg(test)]
mod tests {
    use dashu_int::IBig;
    use proptest::prelude::*;
    use sightline_geometry::predicates::dyadic;
    use sightline_numbers::random::SplitMix64;

    use super::*;

    fn vector(c: [f32; 3]) -> Vec3 {
        Vec3::from(c)
    }

    /// The two triangles differ only in their first corner, so the segment crosses both at one point.
    ///
    /// The heights of the segment's ends still round differently. Near the plane the roundings decide:
    /// without their bound, the filter would order equal points.
    #[test]
    fn filter_leaves_equal_triangles_open() {
        let mut differing = 0;
        let mut stream = SplitMix64::new(1);
        let mut next = || (stream.bits() >> 40) as f32 / (1 << 24) as f32 - 0.5;
        for _ in 0..200 {
            let [a, b, c, off] = std::array::from_fn(|_| Vec3::new(next(), next(), next()));
            let (u, t) = ([a, b, c], [b, c, a]);
            let middle = (a + b + c) / 3.0;
            let (from, to) = (middle + off * 1e-6, middle - off);
            assert_eq!(sooner_filtered(&u, &t, from, to), None);
            assert_eq!(sooner_filtered(&u, &t, to, from), None);
            assert_eq!(sooner(&u, &t, from, to), Ordering::Equal);
            let product = |x: &[Vec3; 3], y: &[Vec3; 3]| height(x, from).0 * height(y, to).0;
            differing += u32::from((product(&u, &t) / product(&t, &u) - 1.0).abs() > 1e-14);
        }
        // In most cases the products differ by far more than their own roundings.
        assert!(differing > 100, "{differing} of 200");
    }

    /// The heights have no error, because the segment begins at a corner of both triangles.
    #[test]
    fn filter_leaves_common_corner_open() {
        let u = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let t = [Vec3::ZERO, Vec3::X, Vec3::new(0.0, 1.0, 0.5)];
        let to = Vec3::new(0.1, 0.1, 1.0);
        assert_eq!(sooner_filtered(&u, &t, Vec3::ZERO, to), None);
        assert_eq!(sooner(&u, &t, Vec3::ZERO, to), Ordering::Equal);
    }

    proptest! {
        /// The bound covers the error of the height, which integers determine, also at points near the plane.
        #[test]
        fn heights_err_by_less_than_bound(
            t in prop::array::uniform3(prop::array::uniform3(-1.0f32..1.0)),
            p in prop::array::uniform3(-1.0f32..1.0), mix in prop::array::uniform2(-1.0f32..1.0),
            near in any::<bool>(), e in -40i32..40,
        ) {
            let t = t.map(|c| vector(c) * 2f32.powi(e));
            let on = t[0] + (t[1] - t[0]) * mix[0] + (t[2] - t[0]) * mix[1];
            let p = if near { on } else { vector(p) * 2f32.powi(e) };
            let (rounded, bound) = height(&t, p);
            // The coordinates are integers times 2⁻¹⁹⁰, so the determinant is an integer times 2⁻⁵⁷⁰.
            let whole = |x: f64| {
                let (m, at) = dyadic(x);
                if m == 0 { IBig::ZERO } else { IBig::from(m) << (at + 190) as usize }
            };
            let [a, b, c, q] = [t[0], t[1], t[2], p].map(|v| v.as_dvec3().to_array().map(whole));
            let d = |x: &[IBig; 3]| -> [IBig; 3] { std::array::from_fn(|k| &x[k] - &a[k]) };
            let (b, c, q) = (d(&b), d(&c), d(&q));
            let minor = |i: usize, j: usize| &b[i] * &c[j] - &b[j] * &c[i];
            let det = minor(1, 2) * &q[0] + minor(2, 0) * &q[1] + minor(0, 1) * &q[2];
            let scaled = |x: f64| {
                let (m, at) = dyadic(x);
                let at = if m == 0 { 0 } else { at + 570 };
                // Bounds can be finer than the determinant; rounded down, they are stricter.
                if at < 0 { IBig::from(m) >> -at as usize } else { IBig::from(m) << at as usize }
            };
            let off = (scaled(rounded) - det.abs()).abs();
            prop_assert!(off <= scaled(bound));
        }

        /// Planes z = k + a few bits, crossed by a steep segment at rational points.
        #[test]
        fn order_agrees_with_rational_places(
            tilt in prop::array::uniform4(-8i32..9), z in prop::array::uniform2(-4i32..5),
            fine in prop::array::uniform2(-2i32..3), x in prop::array::uniform4(-8i32..9), shift in 0u32..21,
            e in -4i32..2,
        ) {
            // The corners are (0, 0), (8, 0), (0, 8), with heights of 24 bits.
            let plane = |k: usize| {
                let z = (z[k] << shift) + fine[k];
                [[0, 0, z], [8, 0, z + tilt[2 * k]], [0, 8, z + tilt[2 * k + 1]]]
            };
            let (u, t) = (plane(0), plane(1));
            let up = 1i32 << 23;
            let (from, to) = ([x[0], x[1], -up], [x[2], x[3], up]);
            // Eight times the distance above the plane, along z.
            let above = |triangle: &[[i32; 3]; 3], p: [i32; 3]| {
                let [a, b, c] = triangle.map(|q| i128::from(q[2]));
                let [x, y, z] = p.map(i128::from);
                (8 * (z - a) - (b - a) * x - (c - a) * y).abs()
            };
            let truth = (above(&u, from) * above(&t, to)).cmp(&(above(&t, from) * above(&u, to)));
            // With this scale, the coordinates of some points are fractions.
            let float = |p: [i32; 3]| vector(p.map(|c| c as f32)) * 2f32.powi(e);
            let (u, t, from, to) = (u.map(float), t.map(float), float(from), float(to));
            prop_assert_eq!(sooner(&u, &t, from, to), truth);
            prop_assert_eq!(sooner(&t, &u, from, to), truth.reverse());
            prop_assert_eq!(sooner(&u, &t, to, from), truth.reverse());
            prop_assert_eq!(sooner_exact(&u, &t, from, to), truth);
            prop_assert!(sooner_filtered(&u, &t, from, to).is_none_or(|order| order == truth));
        }

        /// A filter that never decided the order would be slow but would pass every other test.
        #[test]
        fn filter_decides_clear_orders(
            z in -0.5f32..0.0, off in prop::array::uniform4(prop::array::uniform3(-0.01f32..0.01)),
            e in -30i32..30,
        ) {
            let scale = |v: Vec3| v * 2f32.powi(e);
            let at = |z: f32, k: usize| {
                let corners = [Vec3::new(-1.0, -1.0, z), Vec3::new(3.0, -1.0, z), Vec3::new(-1.0, 3.0, z)];
                corners.map(|c| scale(c + vector(off[k])))
            };
            let (u, t) = (at(z, 0), at(z + 0.1, 1));
            let [from, to] = [scale(vector(off[2]) - Vec3::Z), scale(vector(off[3]) + Vec3::Z)];
            prop_assert_eq!(sooner_filtered(&u, &t, from, to), Some(Ordering::Less));
            prop_assert_eq!(sooner_filtered(&t, &u, from, to), Some(Ordering::Greater));
            prop_assert_eq!(sooner_filtered(&u, &t, to, from), Some(Ordering::Greater));
        }
    }
}
