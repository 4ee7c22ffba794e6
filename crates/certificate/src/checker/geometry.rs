//! Points, planes and lines in homogeneous integer coordinates.

use std::cmp::Ordering;

use dashu_int::ops::{Gcd as _, UnsignedAbs as _};
use dashu_int::{IBig, UBig};
use glam::Vec3;

/// The point (x/w, y/w, z/w), with w > 0.
pub type Point = [IBig; 4];
/// The plane (n, k) of the points with n·x = k·w.
pub type Plane = [IBig; 4];
/// The Plücker coordinates (d, m) of a line. For the line from p to q, they are d = q − p and m = p × q, up
/// to a positive factor. Also any vector of the six-dimensional space that these coordinates span.
pub type Line = [IBig; 6];

/// Multiplies doubles by the lowest power of two, at least 1, that makes all of them integers. Returns the
/// integers and the exponent of that power.
fn scaled<const N: usize>(x: [f64; N]) -> ([IBig; N], i32) {
    // The mantissa and the exponent, without trailing zeros of the mantissa.
    let parts = x.map(|x| {
        let bits = x.to_bits();
        let field = (bits >> 52 & 0x7ff) as i32;
        let fraction = (bits & ((1 << 52) - 1)) as i64;
        let (m, e) = if field == 0 {
            (fraction, -1074)
        } else {
            (fraction + (1 << 52), field - 1075)
        };
        let zeros = if m == 0 { 0 } else { m.trailing_zeros() as i32 };
        (
            if x < 0.0 { -(m >> zeros) } else { m >> zeros },
            if m == 0 { 0 } else { e + zeros },
        )
    });
    let up = -parts.iter().map(|p| p.1).min().unwrap_or(0).min(0);
    (parts.map(|(m, e)| IBig::from(m) << (e + up) as usize), up)
}

/// Converts a point in double precision exactly.
pub fn point(p: [f64; 3]) -> Point {
    let ([x, y, z], up) = scaled(p);
    [x, y, z, IBig::ONE << up as usize]
}

/// Divides a vector by the greatest common divisor of its components.
pub fn reduced<const N: usize>(mut v: [IBig; N]) -> [IBig; N] {
    let mut common = UBig::ZERO;
    for x in v.iter().filter(|x| !x.is_zero()) {
        common = if common.is_zero() {
            x.unsigned_abs()
        } else {
            (&common).gcd(x.unsigned_abs())
        };
        if common.is_one() {
            return v;
        }
    }
    if !common.is_zero() {
        let common = IBig::from(common);
        v.iter_mut().for_each(|x| *x /= &common);
    }
    v
}

/// Returns the sign of an integer.
pub fn sign(x: &IBig) -> Ordering {
    x.cmp(&IBig::ZERO)
}

/// Computes n·x − k·w, which is positive on the positive side of the plane.
pub fn height(plane: &Plane, p: &Point) -> IBig {
    &plane[0] * &p[0] + &plane[1] * &p[1] + &plane[2] * &p[2] - &plane[3] * &p[3]
}

/// Returns the line from p to q, which is zero if p and q are the same point.
pub fn join(p: &Point, q: &Point) -> Line {
    let d = |i: usize| &p[3] * &q[i] - &q[3] * &p[i];
    let m = |i: usize, j: usize| &p[i] * &q[j] - &p[j] * &q[i];
    [d(0), d(1), d(2), m(1, 2), m(2, 0), m(0, 1)]
}

/// Returns the line along n × n' in which two planes meet.
pub fn meet(a: &Plane, b: &Plane) -> Line {
    let d = |i: usize, j: usize| &a[i] * &b[j] - &a[j] * &b[i];
    let m = |i: usize| &b[3] * &a[i] - &a[3] * &b[i];
    [d(1, 2), d(2, 0), d(0, 1), m(0), m(1), m(2)]
}

/// Returns the plane through three points, which turn counter-clockwise as seen from its positive side.
pub fn plane(p: [&Point; 3]) -> Plane {
    let [a, b, c] = p;
    let (ab, ac) = (join(a, b), join(a, c));
    // n = (b − a) × (c − a) and k = n·a, scaled by w(a).
    let n = |i: usize, j: usize| &ab[i] * &ac[j] - &ab[j] * &ac[i];
    let n = [n(1, 2), n(2, 0), n(0, 1)];
    let k = &n[0] * &a[0] + &n[1] * &a[1] + &n[2] * &a[2];
    let [x, y, z] = n.map(|c| c * &a[3]);
    [x, y, z, k]
}

/// Computes the Klein form d·m' + m·d'.
pub fn klein(a: &Line, b: &Line) -> IBig {
    (0..6).map(|i| &a[i] * &b[(i + 3) % 6]).sum()
}

/// Converts the corners of a triangle exactly.
pub(super) fn exact(t: &[Vec3; 3]) -> [Point; 3] {
    t.map(|v| point(v.as_dvec3().to_array()))
}

/// Returns true if the corners of a triangle are not collinear.
pub(super) fn has_area(t: &[Vec3; 3]) -> bool {
    let [a, b, c] = exact(t);
    !plane([&a, &b, &c])[..3].iter().all(IBig::is_zero)
}

/// Returns the weighted mean of points, for positive weights.
pub(super) fn mixed(points: &[Point], weights: &[IBig]) -> Point {
    let scale: IBig = points.iter().map(|p| &p[3]).product();
    let parts: Vec<IBig> = points
        .iter()
        .zip(weights)
        .map(|(p, w)| w * &scale / &p[3])
        .collect();
    let along = |k: usize| points.iter().zip(&parts).map(|(p, s)| &p[k] * s).sum();
    let total: IBig = weights.iter().sum();
    reduced([along(0), along(1), along(2), total * scale])
}

/// Returns the crossing of a plane and the segment between two points on different sides of it.
pub(super) fn cut(p: &Point, q: &Point, flat: &Plane) -> Point {
    let weight = |x: &Point| {
        let h = height(flat, x);
        if sign(&h) == Ordering::Less { -h } else { h }
    };
    let (s, t) = (weight(p), weight(q));
    reduced(std::array::from_fn(|k| &q[k] * &s + &p[k] * &t))
}
