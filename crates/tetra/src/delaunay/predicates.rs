//! Exact predicates: the side of a plane or of a sphere on which a point lies.
//!
//! There are three stages, from fast to general: `f64` with a proven error bound, integers of fixed width,
//! and integers of any width. The first stage decides all signs for points on a coarse lattice, because `f64`
//! does not round then.
//!
//! No `f64` operation here overflows or underflows. Coordinates are multiples of 2⁻¹⁴⁹ below 2¹²⁸, so
//! differences are below 2¹²⁹ and values of degree 5 are below 2⁶⁶⁰. A value of degree k remains a multiple
//! of 2⁻¹⁴⁹ᵏ when it is rounded, and 2⁻⁷⁴⁵ is more than the smallest positive `f64`.

use std::cmp::Ordering;
use std::ops::{Add, Mul, Sub};

use dashu_int::IBig;
use glam::{DVec3, Vec3};
use sightline_geometry::predicates::{differences, dyadic, orient3d_sign, small_integers};
use sightline_geometry::rounding::UNIT as U;

use super::ties;

/// Error bound of an orientation, relative to the product of the largest differences of each axis. A larger
/// computed orientation has the right sign.
///
/// Let these largest differences be 1, as in the filter. The determinant of a matrix with components of at
/// most 1 is at most 4 (Hadamard). So is the sum of the magnitudes of the products of a row with its minors.
/// Let the computed sign be wrong; then the exact determinant is 0 or has the other sign. First-order errors,
/// in u:
/// - Each row's differences are off by at most u, which changes the determinant by at most 4 per row: 12.
/// - Each of the six products is off by at most 1: 6.
/// - The roundings of the three minors, times the third row, add up to 4.
/// - The roundings of the three products with the third row add up to 4.
/// - The first sum is off by at most its magnitude. This sum and the third product cancel up to the error,
///   and all three products add up to at most 4, so the sum is at most 2: 2.
/// - The last sum rounds without a change of its sign: 0.
///
/// The total is 28. The last thousandth covers the terms in u² and the roundings of the bound. Half of this
/// bound gives wrong signs: the tests have points whose sign is wrong by 15.5u.
const ORIENT_BOUND: f64 = 28.001 * U;

/// Error bound of the determinant of [`Predicates::conflicts`].
///
/// The bound is relative to the product of the largest differences of each axis and the square of the largest
/// difference of all. The determinant has 4 cofactors of 6 products, each times 3 squares: 72 terms, each at
/// most that product. A term passes through at most 17 rounded operations: 8 of the cofactor (as in
/// [`ORIENT_BOUND`]), 5 of the lift (two differences, a product, two additions), their product and three
/// additions. So the error is at most ((1+u)¹⁷ − 1) · 72 times the product of true differences. That is less
/// than 1230 u times the product of computed differences. The value 1300 also covers the roundings of the
/// bound itself.
const CONFLICT_BOUND: f64 = 1300.0 * U;

/// The predicates for a list of points, with the limits up to which `f64` is exact for these points.
pub(super) struct Predicates<'a> {
    points: &'a [[f32; 3]],
    /// The limit up to which sums of products of 3 differences are exact in `f64`.
    ///
    /// The magnitudes of the products must add up to at most this value.
    exact3: f64,
    /// The limit up to which sums of products of 5 differences are exact in `f64`.
    ///
    /// The magnitudes of the products must add up to at most this value.
    exact5: f64,
}

impl<'a> Predicates<'a> {
    /// Prepares the predicates for points, which must be finite. Other functions identify a point by its
    /// index.
    pub(super) fn new(points: &'a [[f32; 3]]) -> Self {
        let exponents = points.as_flattened().iter().map(|&c| dyadic(f64::from(c)));
        let least = exponents
            .filter(|(m, _)| *m != 0)
            .map(|(_, e)| e)
            .min()
            .unwrap_or(0);
        // All coordinates are multiples of the unit, so all values of degree k are multiples of its k-th
        // power. Multiples of one number up to 2⁵³ times that number are exact in f64. The powers are at
        // least 2⁻⁷⁴⁵.
        let unit = f64::from_bits(((1023 + least) as u64) << 52);
        let most = f64::from(2).powi(53);
        let cube = unit * unit * unit;
        Self {
            points,
            exact3: most * cube,
            exact5: most * (cube * unit * unit),
        }
    }

    fn at(&self, k: u32) -> [f32; 3] {
        self.points[k as usize]
    }

    /// Returns true if two points are equal.
    pub(super) fn same(&self, p: u32, q: u32) -> bool {
        self.at(p) == self.at(q)
    }

    /// Returns the sign of (b − a) × (c − a) · (d − a) of four points.
    pub(super) fn orient(&self, corners: [u32; 4]) -> Ordering {
        let [a, b, c, d] = corners.map(|k| self.at(k));
        let rows = [b, c, d].map(|p| minus(p, a));
        self.orient_filtered(&rows)
            .unwrap_or_else(|| orient3d_sign(a.into(), b.into(), c.into(), d.into()))
    }

    /// Returns the sign of the determinant of the differences of points `rows`, or `None` if `f64` does not
    /// decide the sign.
    #[inline]
    fn orient_filtered(&self, rows: &[[f64; 3]; 3]) -> Option<Ordering> {
        let most = largest(rows);
        let size = most[0] * most[1] * most[2];
        let det = det(&rows[0], &rows[1], &rows[2]);
        (det.abs() > ORIENT_BOUND * size || 6.0 * size <= self.exact3).then(|| sign(det))
    }

    /// Returns true if point `e` is inside the circumsphere of a tetrahedron.
    ///
    /// The tetrahedron must have a positive [`Self::orient`] and must not contain `e` as a corner. If `e` is
    /// on the sphere, [`ties`] decides.
    pub(super) fn conflicts(&self, corners: [u32; 4], e: u32) -> bool {
        let origin = self.at(e);
        let rows = corners.map(|k| minus(self.at(k), origin));
        let (side, signs) = match self.conflicts_filtered(&rows) {
            Some((Ordering::Equal, cofactors)) => (Ordering::Equal, cofactors.map(sign)),
            Some((side, _)) => return side == Ordering::Greater,
            None => {
                let [a, b, c, d] = corners.map(|k| Vec3::from(self.at(k)));
                let exact = differences(
                    Vec3::from(origin).as_dvec3(),
                    [a, b, c, d].map(|p| p.as_dvec3()),
                );
                exact
                    .and_then(small_signs)
                    .unwrap_or_else(|| big_signs(origin, corners.map(|k| self.at(k))))
            }
        };
        match side {
            Ordering::Greater => true,
            Ordering::Less => false,
            Ordering::Equal => ties::conflicts(corners, e, signs),
        }
    }

    /// Returns the sign of the determinant of [`Self::conflicts`] and its cofactors, or `None` if `f64` does
    /// not decide the sign.
    ///
    /// The signs of the cofactors are exact if the determinant is 0.
    #[inline]
    fn conflicts_filtered(&self, rows: &[[f64; 3]; 4]) -> Option<(Ordering, [f64; 4])> {
        let most = largest(rows);
        let longest = most[0].max(most[1]).max(most[2]);
        // The size is positive, because the corners are not coplanar.
        let size = most[0] * most[1] * most[2] * (longest * longest);
        let cofactors = cofactors(rows);
        let lift = |k: usize| square(&rows[k]);
        let value = cofactors[0] * lift(0)
            + cofactors[1] * lift(1)
            + cofactors[2] * lift(2)
            + cofactors[3] * lift(3);
        // If `72 * size <= exact5`, every difference, cofactor, lift and sum is exact: none is larger than
        // the sum of all magnitudes of its degree.
        (value.abs() > CONFLICT_BOUND * size || 72.0 * size <= self.exact5)
            .then(|| (sign(value), cofactors))
    }
}

/// Returns the sign of (a − x) × (b − x) · (c − x) for three points a, b, c and any finite `x`.
pub(super) fn side([a, b, c]: [[f32; 3]; 3], x: [f64; 3]) -> Ordering {
    if let Some(sign) = side_filtered([a, b, c], x) {
        return sign;
    }
    let exact = differences(DVec3::from(x), [a, b, c].map(|p| Vec3::from(p).as_dvec3()));
    if let Some([a, b, c]) = exact.and_then(small_integers) {
        let [a, b, c] = [a, b, c].map(|row| row.map(i128::from));
        return det(&a, &b, &c).cmp(&0);
    }
    let [x, a, b, c] = big_rows([x, a.map(f64::from), b.map(f64::from), c.map(f64::from)]);
    let rows = [a, b, c].map(|p| minus_big(&p, &x));
    det(&rows[0], &rows[1], &rows[2]).cmp(&IBig::ZERO)
}

/// Returns the result of [`side`], or `None` if `f64` does not decide the sign.
fn side_filtered(points: [[f32; 3]; 3], x: [f64; 3]) -> Option<Ordering> {
    let rows = points.map(|p| [0, 1, 2].map(|k| f64::from(p[k]) - x[k]));
    let most = largest(&rows);
    // Products of two numbers can underflow here, by at most 2⁻¹⁰⁷⁵ each. There are 6, each times less than
    // 2¹⁶⁰, and 3 more, so their sum is less than 2⁻⁹⁰⁰. Values below 2¹⁶⁰ do not overflow.
    if most.iter().any(|m| *m >= f64::from(2).powi(160)) {
        return None;
    }
    let det = det(&rows[0], &rows[1], &rows[2]);
    let bound = ORIENT_BOUND * (most[0] * most[1] * most[2]) + f64::from(2).powi(-900);
    (det.abs() > bound).then(|| sign(det))
}

/// Computes the signs of the determinant and of the four cofactors in integers of fixed width.
///
/// `rows` contains the differences of the corners from the point e. Returns `None` if these do not fit in
/// short integers.
fn small_signs(rows: [[f64; 3]; 4]) -> Option<(Ordering, [Ordering; 4])> {
    let rows = small_integers(rows)?.map(|row| row.map(i128::from));
    // The cofactors are below 2¹²⁶ and the lifts below 2⁸⁴.
    let cofactors = cofactors(&rows);
    let lifts = rows.each_ref().map(square);
    Some((
        sum_of_products(cofactors, lifts),
        cofactors.map(|c| c.cmp(&0)),
    ))
}

/// Returns the sign of Σ cᵢ·lᵢ for |cᵢ| < 2¹²⁶ and 0 ≤ lᵢ < 2⁸⁴.
///
/// Each c is split at bit 63 and each l at bit 42, so that all partial sums are below 2¹⁰⁸ and fit in an
/// i128. Then carries are moved upwards.
fn sum_of_products(c: [i128; 4], l: [i128; 4]) -> Ordering {
    let low = |x: i128, bits: u32| x & ((1 << bits) - 1);
    // The units of the entries of `places` are 2⁰, 2⁴², 2⁶³ and 2¹⁰⁵.
    let mut places = [0i128; 4];
    for (c, l) in c.into_iter().zip(l) {
        let ([c0, c1], [l0, l1]) = ([low(c, 63), c >> 63], [low(l, 42), l >> 42]);
        for (place, product) in places.iter_mut().zip([c0 * l0, c0 * l1, c1 * l0, c1 * l1]) {
            *place += product;
        }
    }
    let mut rest = false;
    for (k, bits) in [(0, 42), (1, 21), (2, 42)] {
        places[k + 1] += places[k] >> bits;
        rest |= low(places[k], bits) != 0;
    }
    // The remainder of the lower entries is not negative and is less than one unit of the highest entry.
    places[3].cmp(&0).then(rest.cmp(&false))
}

/// Computes the result of [`small_signs`] for any coordinates.
fn big_signs(e: [f32; 3], corners: [[f32; 3]; 4]) -> (Ordering, [Ordering; 4]) {
    let [a, b, c, d] = corners.map(|p| p.map(f64::from));
    let [e, a, b, c, d] = big_rows([e.map(f64::from), a, b, c, d]);
    let rows = [a, b, c, d].map(|p| minus_big(&p, &e));
    let cofactors = cofactors(&rows);
    let sum = cofactors
        .iter()
        .zip(&rows)
        .fold(IBig::ZERO, |sum, (c, row)| sum + c * square(row));
    (sum.cmp(&IBig::ZERO), cofactors.map(|c| c.cmp(&IBig::ZERO)))
}

/// Converts finite coordinates to integers, in units of one power of two.
fn big_rows<const N: usize>(rows: [[f64; 3]; N]) -> [[IBig; 3]; N] {
    let parts = rows.map(|row| row.map(dyadic));
    let least = parts
        .as_flattened()
        .iter()
        .filter(|(m, _)| *m != 0)
        .map(|(_, e)| *e)
        .min()
        .unwrap_or(0);
    parts.map(|row| {
        row.map(|(m, e)| {
            if m == 0 {
                IBig::ZERO
            } else {
                IBig::from(m) << (e - least) as usize
            }
        })
    })
}

fn minus_big(p: &[IBig; 3], q: &[IBig; 3]) -> [IBig; 3] {
    std::array::from_fn(|k| &p[k] - &q[k])
}

fn minus(p: [f32; 3], q: [f32; 3]) -> [f64; 3] {
    std::array::from_fn(|k| f64::from(p[k]) - f64::from(q[k]))
}

/// Returns the largest magnitude of each column.
fn largest<const N: usize>(rows: &[[f64; 3]; N]) -> [f64; 3] {
    std::array::from_fn(|k| rows.iter().fold(0.0f64, |most, row| most.max(row[k].abs())))
}

/// Returns the sign of a number that is not NaN.
fn sign(x: f64) -> Ordering {
    x.partial_cmp(&0.0).unwrap_or(Ordering::Equal)
}

/// Computes, for each corner, the orientation of a tetrahedron after the origin replaced the corner.
///
/// The sum of the four is the orientation of the tetrahedron itself.
#[inline(always)]
fn cofactors<T>(rows: &[[T; 3]; 4]) -> [T; 4]
where
    for<'t> &'t T: Mul<&'t T, Output = T>,
    T: Add<Output = T> + Sub<Output = T>,
{
    let minor = |i: usize, j: usize| &rows[i][0] * &rows[j][1] - &rows[j][0] * &rows[i][1];
    let (ab, ac, ad) = (minor(0, 1), minor(0, 2), minor(0, 3));
    let (bc, bd, cd) = (minor(1, 2), minor(1, 3), minor(2, 3));
    let [a, b, c, d] = rows.each_ref().map(|row| &row[2]);
    // The second and the fourth cofactors are the negated determinants of the other rows.
    [
        b * &cd - c * &bd + d * &bc,
        c * &ad - a * &cd - d * &ac,
        a * &bd - b * &ad + d * &ab,
        b * &ac - a * &bc - c * &ab,
    ]
}

/// Computes the determinant of three rows: a × b · c.
#[inline(always)]
fn det<T>(a: &[T; 3], b: &[T; 3], c: &[T; 3]) -> T
where
    for<'t> &'t T: Mul<&'t T, Output = T>,
    T: Add<Output = T> + Sub<Output = T>,
{
    let minor = |i: usize, j: usize| &a[i] * &b[j] - &a[j] * &b[i];
    &minor(1, 2) * &c[0] + &minor(2, 0) * &c[1] + &minor(0, 1) * &c[2]
}

#[inline(always)]
fn square<T>(row: &[T; 3]) -> T
where
    for<'t> &'t T: Mul<&'t T, Output = T>,
    T: Add<Output = T>,
{
    &row[0] * &row[0] + &row[1] * &row[1] + &row[2] * &row[2]
}

#[cfg(test)]
mod tests;
