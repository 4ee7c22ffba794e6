//! The side of a plane on which a point lies: computed in doubles with an error bound, then in integers.
//!
//! The module `sightline_geometry::predicates` has the same predicates for points in single precision. The
//! points of this module are doubles or homogeneous integers; rounded points have a bound on their rounding
//! error.

use std::cmp::Ordering;

use dashu_int::{IBig, Sign};
use glam::{DVec3, Vec3Swizzles as _};
use sightline_geometry::predicates::{det3_small, differences};
use sightline_geometry::rounding::UNIT as U;

use crate::arithmetic::number::homogeneous;
use crate::geometry::frame::{Point, PointOrigin};

/// Returns the sign of an integer.
pub fn sign(x: &IBig) -> Ordering {
    if x.is_zero() {
        Ordering::Equal
    } else if x.sign() == Sign::Positive {
        Ordering::Greater
    } else {
        Ordering::Less
    }
}

/// Computes the orientation of four points: the sign of (b − a) × (c − a) · (d − a).
///
/// The result is `None` if doubles cannot decide the sign.
///
/// A difference is off by at most e: the errors of both points and a rounding. For each of the three
/// differences, the determinant is then off by at most 6 products of its error and the sizes of the other
/// differences. Its own roundings add 16u of the products' magnitudes (as in
/// `sightline_geometry::predicates::orient3d_sign`).
pub fn orient_points(p: [&Point; 4]) -> Option<Ordering> {
    let d = |i: usize| -> ([f64; 3], f64, f64) {
        let x: [f64; 3] = std::array::from_fn(|k| p[i].at[k] - p[0].at[k]);
        let size = x.iter().fold(0.0f64, |m, c| m.max(c.abs()));
        (x, size, p[i].error + p[0].error + U * size)
    };
    let ((x, nx, ex), (y, ny, ey), (z, nz, ez)) = (d(1), d(2), d(3));
    let det = x[0] * (y[1] * z[2] - y[2] * z[1])
        + x[1] * (y[2] * z[0] - y[0] * z[2])
        + x[2] * (y[0] * z[1] - y[1] * z[0]);
    let (nx, ny, nz) = (nx + ex, ny + ey, nz + ez);
    let bound = 6.1 * (ex * ny * nz + nx * ey * nz + nx * ny * ez) + 100.0 * U * nx * ny * nz;
    (det.abs() > bound && bound < 1e280).then_some(if det > 0.0 {
        Ordering::Greater
    } else {
        Ordering::Less
    })
}

/// Computes the orientation of four homogeneous points a, b, c, d with w > 0: the sign of (b − a) × (c − a) ·
/// (d − a).
pub fn orient_exact(p: [&[IBig; 4]; 4]) -> Ordering {
    let a = p[0];
    let d = |q: &[IBig; 4]| -> [IBig; 3] { std::array::from_fn(|k| &q[k] * &a[3] - &a[k] * &q[3]) };
    let (x, y, z) = (d(p[1]), d(p[2]), d(p[3]));
    let minor = |i: usize, j: usize| &y[i] * &z[j] - &y[j] * &z[i];
    sign(&(&x[0] * minor(1, 2) + &x[1] * minor(2, 0) + &x[2] * minor(0, 1)))
}

/// Computes the determinant of four homogeneous points.
pub fn determinant(p: [&[IBig; 4]; 4]) -> IBig {
    let [a, b, c, d] = p;
    // The expansion by pairs of rows is Σ ± (minor of a, b) · (complementary minor of c, d).
    let minor = |x: &[IBig; 4], y: &[IBig; 4], i: usize, j: usize| &x[i] * &y[j] - &x[j] * &y[i];
    let term = |i: usize, j: usize, k: usize, l: usize| minor(a, b, i, j) * minor(c, d, k, l);
    term(0, 1, 2, 3) - term(0, 2, 1, 3) + term(0, 3, 1, 2) + term(1, 2, 0, 3) - term(1, 3, 0, 2)
        + term(2, 3, 0, 1)
}

/// Computes the orientation of four points a, b, c, d in world space: the sign of (b − a) × (c − a) · (d −
/// a).
pub fn orient(p: [&PointOrigin; 4]) -> Ordering {
    if let [
        PointOrigin::Given(a),
        PointOrigin::Given(b),
        PointOrigin::Given(c),
        PointOrigin::Given(d),
    ] = p
        && let Some(sign) =
            orient_doubles(*a, *b, *c, *d).or_else(|| orient_small([*a, *b, *c, *d]))
    {
        return sign;
    }
    let [a, b, c, d] = p.map(integers);
    orient_exact([&a, &b, &c, &d])
}

/// Computes the orientation of four points given in doubles, or returns `None` if doubles cannot decide it.
///
/// The bound is the bound of [`orient_points`] with exact points. The result is also `None` if a product
/// could underflow or overflow.
pub fn orient_doubles(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> Option<Ordering> {
    let (x, y, z) = (b - a, c - a, d - a);
    let (m, n) = (
        y.cross(z),
        y.abs().yzx() * z.abs().zxy() + y.abs().zxy() * z.abs().yzx(),
    );
    let (det, magnitude) = (x.dot(m), x.abs().dot(n));
    // Underflow is negligible if the sum of products is far above the smallest normal double.
    let safe = magnitude > 1e-200 && magnitude < 1e250 && x.abs().max_element() < 1e80;
    (safe && det.abs() > 16.0 * U * magnitude + 1e-280).then_some(if det > 0.0 {
        Ordering::Greater
    } else {
        Ordering::Less
    })
}

/// Computes the orientation of four points, given in doubles, in integers of fixed width.
///
/// The result is `None` unless the differences of the points are integers of few bits times a common power of
/// two.
pub fn orient_small([a, b, c, d]: [DVec3; 4]) -> Option<Ordering> {
    differences(a, [b, c, d]).and_then(det3_small)
}

/// Returns a point's exact homogeneous coordinates in world space.
pub fn integers(p: &PointOrigin) -> [IBig; 4] {
    match p {
        PointOrigin::Given(p) => homogeneous(p.to_array()),
        PointOrigin::Exact(p) => (**p).clone(),
    }
}

/// Computes the plane (n, k), n·x = k, through three points that are not on a line.
///
/// n points to the side from which the points appear counter-clockwise.
pub fn plane(p: [&[IBig; 4]; 3]) -> [IBig; 4] {
    // These are the cofactors of the 3×4 matrix of homogeneous points. With w > 0, the first three are n up
    // to a positive factor.
    let minor = |i: usize, j: usize, k: usize| {
        let [a, b, c] = p;
        &a[i] * (&b[j] * &c[k] - &b[k] * &c[j]) - &a[j] * (&b[i] * &c[k] - &b[k] * &c[i])
            + &a[k] * (&b[i] * &c[j] - &b[j] * &c[i])
    };
    let mut out = [
        minor(1, 2, 3),
        minor(2, 0, 3),
        minor(0, 1, 3),
        minor(0, 1, 2),
    ];
    crate::arithmetic::number::primitive(&mut out);
    out
}

/// Computes the plane (n, k) through two different points and parallel to an axis.
///
/// The axis must not be parallel to the line through both points.
pub fn plane_along([a, b]: [&[IBig; 4]; 2], axis: usize) -> [IBig; 4] {
    let towards: [IBig; 4] =
        std::array::from_fn(|i| if i == axis { IBig::ONE } else { IBig::ZERO });
    plane([a, b, &towards])
}

/// Computes n·x − k·w. The sign is the side of the plane on which the point lies.
pub fn height(plane: &[IBig; 4], p: &[IBig; 4]) -> IBig {
    &plane[0] * &p[0] + &plane[1] * &p[1] + &plane[2] * &p[2] - &plane[3] * &p[3]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn grid() -> impl Strategy<Value = [[i32; 3]; 4]> {
        prop::array::uniform4(prop::array::uniform3(-4i32..5))
    }

    proptest! {
        #[test]
        fn orientation_agrees_with_integers(p in grid(), e in -300i32..300) {
            let d = |k: usize, i: usize| i64::from(p[k][i] - p[0][i]);
            let cross = |i: usize, j: usize| d(1, i) * d(2, j) - d(1, j) * d(2, i);
            let det = cross(1, 2) * d(3, 0) + cross(2, 0) * d(3, 1) + cross(0, 1) * d(3, 2);
            let s = p.map(|q| PointOrigin::Given(DVec3::from(q.map(|c| f64::from(c) * f64::powi(2.0, e)))));
            prop_assert_eq!(orient([&s[0], &s[1], &s[2], &s[3]]), det.cmp(&0));
            let x = [0, 1, 2, 3].map(|i| integers(&s[i]));
            prop_assert_eq!(orient_exact([&x[0], &x[1], &x[2], &x[3]]), det.cmp(&0));
            let normal = plane([&x[0], &x[1], &x[2]]);
            prop_assert_eq!(sign(&height(&normal, &x[3])), det.cmp(&0));
        }
    }
}
