//! Which of two triangles a segment crosses first: in doubles with a bound, else in integers.

use std::cmp::Ordering;

use dashu_int::IBig;
use glam::Vec3;

use crate::arithmetic::number::homogeneous;
use crate::geometry::predicates;

/// Which of two triangles a segment that passes through both crosses first.
pub fn sooner(u: &[Vec3; 3], t: &[Vec3; 3], from: Vec3, to: Vec3) -> Ordering {
    // At from + s(to − from) with s = a / (a + b), a and b the distances of the ends to the plane: s(u) <
    // s(t) when a(u) b(t) < a(t) b(u).
    let heights = |of: &[Vec3; 3]| [from, to].map(|p| height(of, p));
    let ([(au, eau), (bu, ebu)], [(at, eat), (bt, ebt)]) = (heights(u), heights(t));
    let less = |x: (f64, f64), y: (f64, f64), z: (f64, f64), w: (f64, f64)| {
        // Compares the upper bound of a product with the lower bound of another; the roundings are below
        // 1e-15.
        (x.0 + x.1) * (y.0 + y.1) * (1.0 + 1e-15) < (z.0 - z.1).max(0.0) * (w.0 - w.1).max(0.0)
    };
    if less((au, eau), (bt, ebt), (at, eat), (bu, ebu)) {
        return Ordering::Less;
    }
    if less((at, eat), (bu, ebu), (au, eau), (bt, ebt)) {
        return Ordering::Greater;
    }
    let exact = |of: &[Vec3; 3]| {
        let point = |v: Vec3| homogeneous(v.as_dvec3().to_array());
        let [a, b, c] = of.map(point);
        let flat = predicates::plane([&a, &b, &c]);
        // Multiplying by the other end's w gives both heights one scale.
        let (p, q) = (point(from), point(to));
        [predicates::height(&flat, &p) * &q[3], predicates::height(&flat, &q) * &p[3]]
    };
    let size = |x: &IBig| if predicates::sign(x) == Ordering::Less { -x } else { x.clone() };
    let ([au, bu], [at, bt]) = (exact(u), exact(t));
    (size(&au) * size(&bt)).cmp(&(size(&at) * size(&bu)))
}

/// How far a point is from a triangle's plane, times twice the area, and by how much that may be off: the
/// determinant and bound of [`sightline_scene::exact::orient3d_sign`].
fn height(t: &[Vec3; 3], p: Vec3) -> (f64, f64) {
    let [a, x, y, z] = [t[0], t[1], t[2], p].map(|v| v.as_dvec3());
    let (x, y, z) = (x - a, y - a, z - a);
    let minor = |i: usize, j: usize| {
        let (l, r) = (x[i] * y[j], x[j] * y[i]);
        (l - r, l.abs() + r.abs())
    };
    let (mx, my, mz) = (minor(1, 2), minor(2, 0), minor(0, 1));
    let det = mx.0 * z.x + my.0 * z.y + mz.0 * z.z;
    let magnitude = mx.1 * z.x.abs() + my.1 * z.y.abs() + mz.1 * z.z.abs();
    (det.abs(), 8.0 * f64::EPSILON * magnitude)
}
