//! Exact predicates for `f32` points: a filter in `f64` decides most cases, exact arithmetic the other cases.
//! Functions that decide with `f64` arguments return `None` if they cannot decide.
//!
//! No predicate uses a tolerance, and no operation overflows or underflows. A finite `f32` is a multiple of
//! 2⁻¹⁴⁹ below 2¹²⁸, so a product of three of them is a multiple of 2⁻⁴⁴⁷ below 2³⁸⁴, well inside the range
//! of `f64`. The methods are from Shewchuk, "Adaptive Precision Floating-Point Arithmetic and Fast Robust
//! Geometric Predicates", 1997, section 2 (expansions) and section 4 (filters).

use std::cmp::Ordering;

use glam::{DVec3, Vec3};

use crate::rounding::UNIT as U;

/// Returns true if the three points lie on one line or coincide.
///
/// This is the case if all three components of (b − a) × (c − a) are 0.
pub fn collinear(a: Vec3, b: Vec3, c: Vec3) -> bool {
    let zero = |i: usize, j: usize| {
        orient2d_sign([a[i], a[j]], [b[i], b[j]], [c[i], c[j]]) == Ordering::Equal
    };
    zero(0, 1) && zero(1, 2) && zero(2, 0)
}

/// Error bound of [`orient2d_filtered`], relative to the sum of the magnitudes of its two products.
///
/// Half of this bound gives wrong signs: for points in the tests, the sign is wrong although the relative
/// magnitude is 2.0u.
const ORIENT2D_BOUND: f64 = 3.001 * U;

/// Error bound of [`orient3d_filtered`], relative to the sum of the magnitudes of its six products.
///
/// Half of this bound gives wrong signs: for points in the tests, the sign is wrong although the relative
/// magnitude is 4.7u.
const ORIENT3D_BOUND: f64 = 7.001 * U;

/// Returns the sign of (b − a) × (p − a) in the plane: `Greater` if a, b, p turn counter-clockwise.
pub fn orient2d_sign(a: [f32; 2], b: [f32; 2], p: [f32; 2]) -> Ordering {
    orient2d_filtered(a, b, p).unwrap_or_else(|| {
        // Expand the product of differences; the terms a[0]·a[1] cancel. A product of two f32 has at most 48
        // bits and is exact.
        let m = |x: f32, y: f32| f64::from(x) * f64::from(y);
        sum_sign([
            m(b[0], p[1]),
            -m(b[0], a[1]),
            -m(a[0], p[1]),
            -m(b[1], p[0]),
            m(b[1], a[0]),
            m(a[1], p[0]),
        ])
    })
}

/// Returns the result of [`orient2d_sign`], or `None` if rounding errors in `f64` could change the sign.
///
/// Each true difference is the rounded one times 1 + ε with |ε| ≤ u, and each exact product of rounded
/// differences is off from the rounded product l or r by at most u|l| or u|r|. So the true determinant
/// differs from l − r by at most (3u + 3u² + u³)(|l|+|r|). Rounding l − r does not change its sign, and
/// divides its magnitude by at most 1 + u. The last thousandth of the bound covers the terms in u² and the
/// roundings of the computed bound (Shewchuk 1997, section 4.3).
fn orient2d_filtered(a: [f32; 2], b: [f32; 2], p: [f32; 2]) -> Option<Ordering> {
    let d = |x: f32, y: f32| f64::from(x) - f64::from(y);
    let l = d(b[0], a[0]) * d(p[1], a[1]);
    let r = d(b[1], a[1]) * d(p[0], a[0]);
    let det = l - r;
    (det.abs() > ORIENT2D_BOUND * (l.abs() + r.abs())).then(|| sign(det))
}

/// Returns the side of the plane through `a`, `b`, `c` on which the point `p` lies.
///
/// The result is the sign of (b − a) × (c − a) · (p − a). The result is `Greater` on the side to which the
/// triangle's normal points. The result is `Equal` if `p` is in the plane or if the three points do not
/// define a plane.
pub fn orient3d_sign(a: Vec3, b: Vec3, c: Vec3, p: Vec3) -> Ordering {
    let exactly = || {
        let rows = differences(a.as_dvec3(), [b, c, p].map(Vec3::as_dvec3));
        rows.and_then(det3_small)
            .unwrap_or_else(|| orient3d_expanded(a, b, c, p))
    };
    orient3d_filtered(a, b, c, p).unwrap_or_else(exactly)
}

/// Returns the result of [`orient3d_sign`], or `None` if rounding errors in `f64` could change the sign.
///
/// Each of the six triple products loses at most 3u of its magnitude to the three rounded differences. The
/// product loses at most u to each of four operations: the product of two factors, the minor, the minor's
/// product with the third factor, and the first of the two additions. The last addition does not change the
/// sign. The sum is 7u of the magnitudes, and terms in u². The last thousandth of the bound covers these
/// terms and the roundings of the computed bound (Shewchuk 1997, section 4.3).
fn orient3d_filtered(a: Vec3, b: Vec3, c: Vec3, p: Vec3) -> Option<Ordering> {
    let d = |x: Vec3| (x.as_dvec3() - a.as_dvec3()).to_array();
    let (det, magnitude) = det3(d(b), d(c), d(p));
    (det.abs() > ORIENT3D_BOUND * magnitude).then(|| sign(det))
}

/// Computes [`orient3d_sign`] exactly, as the sign of a sum of 48 doubles.
fn orient3d_expanded(a: Vec3, b: Vec3, c: Vec3, p: Vec3) -> Ordering {
    // The determinant of differences is linear in each row, and a determinant with two rows `a` is 0.
    let mut terms = [0.0; 48];
    for (chunk, (x, y, z, minus)) in terms.chunks_exact_mut(12).zip([
        (b, c, p, false),
        (a, c, p, true),
        (a, b, p, false),
        (a, b, c, true),
    ]) {
        chunk.copy_from_slice(&det3_terms(x, y, z));
        if minus {
            chunk.iter_mut().for_each(|t| *t = -*t);
        }
    }
    sum_sign(terms)
}

/// The relation of a segment to a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Crossing {
    /// The segment and the triangle have no common point.
    Not,
    /// The segment and the triangle have, or may have, a common point on a border.
    ///
    /// The border is the triangle's border or an end of the segment.
    Touches,
    /// The segment passes through the interior of the triangle, and its ends are on different sides.
    Inside,
}

/// Returns the exact relation of the segment from `p` to `q` to a triangle with area.
pub fn crossing([a, b, c]: [Vec3; 3], p: Vec3, q: Vec3) -> Crossing {
    let ends = [p, q].map(|e| orient3d_sign(a, b, c, e));
    if ends[0] == ends[1] && ends[0] != Ordering::Equal {
        return Crossing::Not;
    }
    let turns = [(a, b), (b, c), (c, a)].map(|(s, t)| orient3d_sign(p, q, s, t));
    let has = |o: Ordering| turns.contains(&o);
    match (
        has(Ordering::Less) && has(Ordering::Greater),
        has(Ordering::Equal) || ends.contains(&Ordering::Equal),
    ) {
        // If the line is in the triangle's plane, all turns are `Equal`. So this line crosses the plane, at a
        // point outside the triangle.
        (true, _) => Crossing::Not,
        (false, true) => Crossing::Touches,
        (false, false) => Crossing::Inside,
    }
}

/// Returns the index of the only triangle that the segment from `p` to `q` meets, if the segment passes
/// through the interior of this triangle.
///
/// The result is `None` if the segment meets no triangle, several triangles or a border. The function tests
/// all triangles and serves as ground truth for tests.
pub fn crossed_alone(triangles: impl Iterator<Item = [Vec3; 3]>, p: Vec3, q: Vec3) -> Option<u32> {
    let mut crossed = None;
    for (id, triangle) in (0..).zip(triangles) {
        match crossing(triangle, p, q) {
            Crossing::Not => {}
            Crossing::Inside if crossed.is_none() => crossed = Some(id),
            Crossing::Inside | Crossing::Touches => return None,
        }
    }
    crossed
}

/// Returns the differences `p[i] − a`, or `None` if a difference is not exact in `f64`.
pub fn differences<const N: usize>(a: DVec3, p: [DVec3; N]) -> Option<[[f64; 3]; N]> {
    let mut exact = true;
    let mut rows = [[0.0; 3]; N];
    let a = a.to_array();
    for (row, x) in rows.iter_mut().zip(p) {
        for (d, (x, a)) in row.iter_mut().zip(x.to_array().into_iter().zip(a)) {
            let (difference, error) = two_sum(x, -a);
            exact &= error == 0.0;
            *d = difference;
        }
    }
    exact.then_some(rows)
}

/// Returns the sign of the determinant with the given rows.
///
/// The result is `None` if [`small_integers`] cannot represent the rows.
pub fn det3_small(rows: [[f64; 3]; 3]) -> Option<Ordering> {
    let [x, y, z] = small_integers(rows)?.map(|row| row.map(i128::from));
    // Each minor is below 2⁸³. Times 2⁴¹, the sum of three such products is below 2¹²⁶.
    let minor = |i: usize, j: usize| x[i] * y[j] - x[j] * y[i];
    Some((minor(1, 2) * z[0] + minor(2, 0) * z[1] + minor(0, 1) * z[2]).cmp(&0))
}

/// Scales the given numbers by one power of two to integers of at most [`MOST_BITS`] bits.
///
/// The result is `None` if a number is not finite, or if the numbers do not fit: one number is far smaller
/// than another, or has bits far below the bits of another.
pub fn small_integers<const N: usize>(rows: [[f64; 3]; N]) -> Option<[[i64; 3]; N]> {
    let mut parts = [[(0i64, 0i32); 3]; N];
    let mut least = i32::MAX;
    for (x, part) in rows.as_flattened().iter().zip(parts.as_flattened_mut()) {
        *part = dyadic(*x);
        if part.0 != 0 {
            least = least.min(part.1);
        }
    }
    let mut integers = [[0i64; 3]; N];
    let mut fits = rows.as_flattened().iter().all(|x| x.is_finite());
    for ((m, e), integer) in parts.as_flattened().iter().zip(integers.as_flattened_mut()) {
        if *m != 0 {
            let up = e - least;
            fits &= up < MOST_BITS && m.unsigned_abs() >> (MOST_BITS - up) == 0;
            // If the number does not fit, the shift wraps and the caller gets `None`.
            *integer = m.wrapping_shl(up as u32);
        }
    }
    fits.then_some(integers)
}

/// The maximum number of bits of the integers of [`small_integers`].
pub const MOST_BITS: i32 = 41;
// The sum of three products of three such integers fits into `i128`.
const _: () = assert!(3 * MOST_BITS + 3 <= 126);

/// Decomposes a finite double into `mantissa · 2^exponent`; the mantissa is odd, or both are 0.
pub fn dyadic(x: f64) -> (i64, i32) {
    if x == 0.0 {
        return (0, 0);
    }
    let bits = x.to_bits();
    let field = (bits >> 52 & 0x7ff) as i32;
    let fraction = (bits & ((1 << 52) - 1)) as i64;
    let (mantissa, exponent) = if field == 0 {
        (fraction, -1074)
    } else {
        (fraction | 1 << 52, field - 1075)
    };
    let zeros = mantissa.trailing_zeros() as i32;
    let odd = mantissa >> zeros;
    (if x < 0.0 { -odd } else { odd }, exponent + zeros)
}

/// Computes the determinant with rows `x`, `y`, `z` in rounded `f64`, and the sum of the magnitudes of its
/// six products.
pub fn det3(x: [f64; 3], y: [f64; 3], z: [f64; 3]) -> (f64, f64) {
    let minor = |i: usize, j: usize| {
        let (l, r) = (x[i] * y[j], x[j] * y[i]);
        (l - r, l.abs() + r.abs())
    };
    let (mx, my, mz) = (minor(1, 2), minor(2, 0), minor(0, 1));
    let det = mx.0 * z[0] + my.0 * z[1] + mz.0 * z[2];
    (
        det,
        mx.1 * z[0].abs() + my.1 * z[1].abs() + mz.1 * z[2].abs(),
    )
}

/// Returns twelve doubles whose exact sum is the determinant with rows `x`, `y`, `z`.
///
/// Each of the six products of three `f32` has up to 72 bits. The result contains the rounded
/// value of each product and the exact error of this value.
pub fn det3_terms(x: Vec3, y: Vec3, z: Vec3) -> [f64; 12] {
    let mut out = [0.0; 12];
    for (pair, (i, j, k, minus)) in out.chunks_exact_mut(2).zip([
        (0, 1, 2, false),
        (1, 2, 0, false),
        (2, 0, 1, false),
        (2, 1, 0, true),
        (1, 0, 2, true),
        (0, 2, 1, true),
    ]) {
        let xy = f64::from(x[i]) * f64::from(y[j]);
        let w = if minus {
            -f64::from(z[k])
        } else {
            f64::from(z[k])
        };
        let rounded = xy * w;
        #[expect(
            clippy::disallowed_methods,
            reason = "a fused product minus its rounded value is the exact error"
        )]
        let error = xy.mul_add(w, -rounded);
        pair.copy_from_slice(&[rounded, error]);
    }
    out
}

/// Computes the sign of the exact sum of doubles by growing a non-overlapping expansion.
///
/// The components are then in order of growing magnitude, with zeros between them, and do not overlap
/// (Shewchuk 1997, theorem 10). So the last nonzero component has the sign of the sum.
fn sum_sign<const N: usize>(terms: [f64; N]) -> Ordering {
    let mut expansion = [0.0f64; N];
    for (len, term) in terms.into_iter().enumerate() {
        let mut q = term;
        for e in &mut expansion[..len] {
            (q, *e) = two_sum(q, *e);
        }
        expansion[len] = q;
    }
    sign(
        expansion
            .iter()
            .rev()
            .copied()
            .find(|e| *e != 0.0)
            .unwrap_or(0.0),
    )
}

/// The exact sum of any number of doubles, for totals over whole meshes.
#[derive(Default)]
pub struct Sum {
    /// The components of the sum: non-overlapping, nonzero, growing in magnitude.
    expansion: Vec<f64>,
}

impl Sum {
    /// Adds `term` exactly.
    pub fn add(&mut self, term: f64) {
        let mut q = term;
        self.expansion.retain_mut(|e| {
            (q, *e) = two_sum(q, *e);
            *e != 0.0
        });
        if q != 0.0 {
            self.expansion.push(q);
        }
    }

    /// Returns the sign of the sum.
    pub fn sign(&self) -> Ordering {
        sign(self.expansion.last().copied().unwrap_or(0.0))
    }
}

/// Computes `a + b` as the rounded sum and the exact error of this sum (Knuth's two-sum).
#[inline]
pub fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let bb = sum - a;
    (sum, (a - (sum - bb)) + (b - bb))
}

/// Returns the sign of a double. The double must not be NaN; this module produces no NaN.
fn sign(x: f64) -> Ordering {
    x.partial_cmp(&0.0).unwrap_or(Ordering::Equal)
}

#[cfg(test)]
mod filter_tests;
#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn collinear_rejects_nearly_collinear_points() {
        let a = Vec3::new(0.1, 0.1, 0.0);
        let c = Vec3::new(0.3, 0.3, 0.0);
        assert!(collinear(a, Vec3::new(0.2, 0.2, 0.0), c));
        let off = Vec3::new(0.2, f32::from_bits(0.2f32.to_bits() + 1), 0.0);
        assert!(!collinear(a, off, c));
        assert!(!collinear(
            Vec3::ZERO,
            Vec3::splat(1e30),
            Vec3::new(1e-30, 0.0, 0.0)
        ));
    }

    #[test]
    fn orient3d_detects_offset_of_one_unit_from_slanted_plane() {
        // All points are near the plane x + y + z = 3·2²⁴, and their differences are as small as `f32` allows
        // at this size.
        let s = 16_777_216.0f32;
        let (a, b, c) = (
            Vec3::splat(s),
            Vec3::new(s + 2.0, s - 2.0, s),
            Vec3::new(s, s + 2.0, s - 2.0),
        );
        assert_eq!(
            orient3d_sign(a, b, c, Vec3::new(s + 4.0, s, s - 4.0)),
            Ordering::Equal
        );
        assert_eq!(
            orient3d_sign(a, b, c, Vec3::new(s + 4.0, s, s - 3.0)),
            Ordering::Greater
        );
        assert_eq!(
            orient3d_sign(a, b, c, Vec3::new(s + 4.0, s, s - 5.0)),
            Ordering::Less
        );
    }

    #[test]
    fn orient3d_handles_extremes_of_f32() {
        let (big, small) = (f32::MAX, f32::from_bits(1));
        let tiny = [Vec3::ZERO, Vec3::X * small, Vec3::Y * small];
        assert_eq!(
            orient3d_sign(tiny[0], tiny[1], tiny[2], Vec3::Z * small),
            Ordering::Greater
        );
        let far = Vec3::new(big, -big, small);
        assert_eq!(
            orient3d_sign(tiny[0], tiny[1], tiny[2], far),
            Ordering::Greater
        );
        let huge = [
            Vec3::splat(-big),
            Vec3::new(big, -big, -big),
            Vec3::new(-big, big, -big),
        ];
        assert_eq!(
            orient3d_sign(huge[0], huge[1], huge[2], Vec3::splat(big)),
            Ordering::Greater
        );
        assert_eq!(
            orient3d_sign(huge[0], huge[1], huge[2], Vec3::new(big, 1.0, -big)),
            Ordering::Equal
        );
    }

    /// Generates coordinates as integers, so that the expected sign is the sign of an integer determinant.
    fn wide() -> impl Strategy<Value = [[i64; 3]; 4]> {
        let near = -3i64..4;
        let wide = (-3i64..4, 0u32..22).prop_map(|(m, e)| m << e);
        prop::array::uniform4(prop::array::uniform3(prop_oneof![near, wide]))
    }

    proptest! {
        #[test]
        fn orientation_agrees_with_integers(p in wide(), e in -60i32..60) {
            let d = |k: usize, i: usize| i128::from(p[k][i] - p[0][i]);
            let cross = |i: usize, j: usize| d(1, i) * d(2, j) - d(1, j) * d(2, i);
            let det = cross(1, 2) * d(3, 0) + cross(2, 0) * d(3, 1) + cross(0, 1) * d(3, 2);
            let v = p.map(|q| Vec3::from(q.map(|c| c as f32 * 2f32.powi(e))));
            prop_assert_eq!(orient3d_sign(v[0], v[1], v[2], v[3]), det.cmp(&0));
            prop_assert_eq!(orient3d_sign(v[1], v[0], v[2], v[3]), det.cmp(&0).reverse());
            prop_assert_eq!(orient3d_expanded(v[0], v[1], v[2], v[3]), det.cmp(&0));
            let rows = differences(v[0].as_dvec3(), [v[1], v[2], v[3]].map(Vec3::as_dvec3));
            prop_assert_eq!(rows.and_then(det3_small), Some(det.cmp(&0)));
            let flat = |k: usize| [v[k].x, v[k].y];
            prop_assert_eq!(orient2d_sign(flat(0), flat(1), flat(2)), cross(0, 1).cmp(&0));
            let on_line = cross(0, 1) == 0 && cross(1, 2) == 0 && cross(2, 0) == 0;
            prop_assert_eq!(collinear(v[0], v[1], v[2]), on_line);
        }

        #[test]
        fn small_integers_accept_exactly_maximum_bits(
            m in prop::array::uniform9(-(1i64 << 41) + 1..1i64 << 41), e in -200i32..200,
        ) {
            let rows = |m: [i64; 9]| [0, 3, 6].map(|k| [0, 1, 2].map(|i| m[k + i] as f64 * 2f64.powi(e)));
            let at = |m: [i64; 9], i: usize, j: usize| i128::from(m[3 * i + j]);
            let minor = |i: usize, j: usize| at(m, 0, i) * at(m, 1, j) - at(m, 0, j) * at(m, 1, i);
            let det = minor(1, 2) * at(m, 2, 0) + minor(2, 0) * at(m, 2, 1) + minor(0, 1) * at(m, 2, 2);
            prop_assert_eq!(det3_small(rows(m)), Some(det.cmp(&0)));
            // The test places an odd number, which uses the lowest bit, next to a number with one bit too
            // many.
            let mut wide = m;
            (wide[0], wide[4]) = (1 << 41, m[4] | 1);
            prop_assert_eq!(det3_small(rows(wide)), None);
        }

        #[test]
        fn orient3d_agrees_with_exact_sum_for_any_bits(bits in prop::array::uniform12(any::<f32>())) {
            prop_assume!(bits.iter().all(|c| c.is_finite()));
            let v: Vec<Vec3> = bits.chunks(3).map(Vec3::from_slice).collect();
            let mut sum = Sum::default();
            for (x, y, z, s) in [(1, 2, 3, 1.0), (0, 2, 3, -1.0), (0, 1, 3, 1.0), (0, 1, 2, -1.0)] {
                det3_terms(v[x], v[y], v[z]).into_iter().for_each(|t| sum.add(s * t));
            }
            prop_assert_eq!(orient3d_sign(v[0], v[1], v[2], v[3]), sum.sign());
        }
    }
}
