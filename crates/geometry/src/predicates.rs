//! Exact predicates for `f32` points: a filter in `f64` decides most cases, exact arithmetic the others.
//! Functions that take `f64` return `None` where they cannot decide.
//!
//! No tolerance decides anything, and nothing overflows or underflows: a finite `f32` is a multiple of 2⁻¹⁴⁹
//! below 2¹²⁸, so a product of three of them is a multiple of 2⁻⁴⁴⁷ below 2³⁸⁴, well inside the range of
//! `f64`. The methods are those of Shewchuk, "Adaptive Precision Floating-Point Arithmetic and Fast Robust
//! Geometric Predicates", 1997, section 2 (expansions) and section 4 (filters).

use std::cmp::Ordering;

use glam::{DVec3, Vec3};

use crate::rounding::UNIT as U;

/// Whether the three points lie on one line (or coincide): all three components of (b − a) × (c − a) are 0.
pub fn collinear(a: Vec3, b: Vec3, c: Vec3) -> bool {
    let zero = |i: usize, j: usize| {
        orient2d_sign([a[i], a[j]], [b[i], b[j]], [c[i], c[j]]) == Ordering::Equal
    };
    zero(0, 1) && zero(1, 2) && zero(2, 0)
}

/// Error bound of [`orient2d_filtered`], relative to the sum of the magnitudes of its two products.
///
/// Halving this bound gives wrong signs: the tests have points whose sign is wrong by 2.0u.
const ORIENT2D_BOUND: f64 = 3.001 * U;

/// Error bound of [`orient3d_filtered`], relative to the sum of the magnitudes of its six products.
///
/// Halving this bound gives wrong signs: the tests have points whose sign is wrong by 4.7u.
const ORIENT3D_BOUND: f64 = 7.001 * U;

/// Returns the sign of (b − a) × (p − a) in the plane: `Greater` when a, b, p turn counter-clockwise.
pub fn orient2d_sign(a: [f32; 2], b: [f32; 2], p: [f32; 2]) -> Ordering {
    orient2d_filtered(a, b, p).unwrap_or_else(|| {
        // Expanded; the ax·ay terms cancel. A product of two f32 has at most 48 bits and is exact.
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

/// Returns the sign of [`orient2d_sign`] if `f64` decides it.
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

/// Returns the side of the plane through `a`, `b`, `c` on which the point `p` lies: the sign of
/// (b − a) × (c − a) · (p − a). It is `Greater` on the side the triangle's normal points to, `Equal` on the
/// plane (or when there is no plane).
pub fn orient3d_sign(a: Vec3, b: Vec3, c: Vec3, p: Vec3) -> Ordering {
    let exactly = || {
        let rows = differences(a.as_dvec3(), [b, c, p].map(Vec3::as_dvec3));
        rows.and_then(det3_small)
            .unwrap_or_else(|| orient3d_expanded(a, b, c, p))
    };
    orient3d_filtered(a, b, c, p).unwrap_or_else(exactly)
}

/// Returns the sign of [`orient3d_sign`] if `f64` decides it.
///
/// Each of the six triple products loses at most 3u of its magnitude to the three rounded differences. It
/// loses at most u to each of four operations: the product of two factors, the minor, the minor's product
/// with the third factor, and the first of the two additions. The last addition does not change the sign.
/// The sum is 7u of the magnitudes, and terms in u². The last thousandth of the bound covers these terms and
/// the roundings of the computed bound (Shewchuk 1997, section 4.3).
fn orient3d_filtered(a: Vec3, b: Vec3, c: Vec3, p: Vec3) -> Option<Ordering> {
    let d = |x: Vec3| (x.as_dvec3() - a.as_dvec3()).to_array();
    let (det, magnitude) = det3(d(b), d(c), d(p));
    (det.abs() > ORIENT3D_BOUND * magnitude).then(|| sign(det))
}

/// [`orient3d_sign`] for coordinates in `f64`.
fn orient3d_expanded(a: Vec3, b: Vec3, c: Vec3, p: Vec3) -> Ordering {
    // The determinant of differences is linear in each row, and rows with a twice vanish.
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
    /// They have no point in common.
    Not,
    /// They have, or may have, a common point, which may be on the triangle's border or at an end of the
    /// segment.
    Touches,
    /// The segment passes from one side to the other through the interior.
    Inside,
}

/// The relation of the segment from `p` to `q` to a triangle with area, decided exactly.
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
        // For a line in the triangle's plane all turns are equal, so this line crosses the plane, outside of
        // the triangle.
        (true, _) => Crossing::Not,
        (false, true) => Crossing::Touches,
        (false, false) => Crossing::Inside,
    }
}

/// The only triangle that a segment has a point in common with, if it passes through its interior and that is
/// certain. Looks at all triangles: a truth for tests.
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

/// The differences of some points from one point; `None` where `f64` does not hold them exactly.
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

/// The sign of the determinant with the given rows; `None` where [`small_integers`] does not hold them.
pub fn det3_small(rows: [[f64; 3]; 3]) -> Option<Ordering> {
    let [x, y, z] = small_integers(rows)?.map(|row| row.map(i128::from));
    // Below 2⁸³, times 2⁴¹, three of them: below 2¹²⁶.
    let minor = |i: usize, j: usize| x[i] * y[j] - x[j] * y[i];
    Some((minor(1, 2) * z[0] + minor(2, 0) * z[1] + minor(0, 1) * z[2]).cmp(&0))
}

/// Integers below 2 to the power of [`MOST_BITS`] such that the given numbers are these integers times one
/// power of two. `None` where they do not fit: where one number is far smaller than another, or has bits far
/// below another's.
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
            // The shift wraps where the number does not fit, and then the result is not used.
            *integer = m.wrapping_shl(up as u32);
        }
    }
    fits.then_some(integers)
}

/// Bits of the integers of [`small_integers`].
pub const MOST_BITS: i32 = 41;
// The sum of three products of three of them fits.
const _: () = assert!(3 * MOST_BITS + 3 <= 126);

/// A finite double as `mantissa · 2^exponent`, the mantissa odd (or both 0).
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

/// Computes the determinant with the given rows, rounded, and the sum of the magnitudes of its six products.
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

/// Twelve doubles whose exact sum is the determinant with rows `x`, `y`, `z`: each of the six products of
/// three `f32` (72 bits) as its rounded value and the exact error of that.
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

/// The sign of the exact sum of doubles, by growing a non-overlapping expansion.
///
/// The components end up in order of growing magnitude, zeros between them, and do not overlap (Shewchuk
/// 1997, theorem 10), so the last that is not zero outweighs all others together.
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
    /// Non-overlapping, growing in magnitude, no zeros.
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

    /// The sign of the sum.
    pub fn sign(&self) -> Ordering {
        sign(self.expansion.last().copied().unwrap_or(0.0))
    }
}

/// Computes `a + b` as the rounded sum and its exact error (Knuth's two-sum).
#[inline]
pub fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let bb = sum - a;
    (sum, (a - (sum - bb)) + (b - bb))
}

/// The sign of a double that is not NaN; no value in this module is.
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
    fn nearly_collinear_is_told_from_collinear() {
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
    fn a_point_one_unit_off_a_slanted_plane_is_told() {
        // The plane x + y + z = 3·2²⁴ through points whose differences are as small as f32 allows there.
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
    fn the_extremes_of_f32_neither_overflow_nor_vanish() {
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

    /// Coordinates as integers times a power of two per axis, so that the truth is an integer determinant.
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
        fn small_integers_are_used_up_to_their_bits_and_no_further(
            m in prop::array::uniform9(-(1i64 << 41) + 1..1i64 << 41), e in -200i32..200,
        ) {
            let rows = |m: [i64; 9]| [0, 3, 6].map(|k| [0, 1, 2].map(|i| m[k + i] as f64 * 2f64.powi(e)));
            let at = |m: [i64; 9], i: usize, j: usize| i128::from(m[3 * i + j]);
            let minor = |i: usize, j: usize| at(m, 0, i) * at(m, 1, j) - at(m, 0, j) * at(m, 1, i);
            let det = minor(1, 2) * at(m, 2, 0) + minor(2, 0) * at(m, 2, 1) + minor(0, 1) * at(m, 2, 2);
            prop_assert_eq!(det3_small(rows(m)), Some(det.cmp(&0)));
            // An odd number, which uses the least bit, beside a number with a bit too many.
            let mut wide = m;
            (wide[0], wide[4]) = (1 << 41, m[4] | 1);
            prop_assert_eq!(det3_small(rows(wide)), None);
        }

        #[test]
        fn the_exact_path_alone_agrees_with_any_bits(bits in prop::array::uniform12(any::<f32>())) {
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
