//! Formulas for planes and their intersections, over several kinds of numbers.
//!
//! The same formulas run over doubles with error bounds ([`Approx`]), over integers, and over residues modulo
//! 2⁶¹ − 1 ([`Residue`]). The hashes of planes are computed from the residues.

use dashu_int::IBig;
use sightline_geometry::rounding::UNIT as U;

/// The operations on numbers that the formulas need.
pub trait Number: Clone {
    /// Returns the sum.
    fn add(&self, other: &Self) -> Self;
    /// Returns the difference.
    fn sub(&self, other: &Self) -> Self;
    /// Returns the product.
    fn mul(&self, other: &Self) -> Self;
    /// Returns zero.
    fn zero() -> Self;
}

impl Number for IBig {
    fn add(&self, other: &Self) -> Self {
        self + other
    }
    fn sub(&self, other: &Self) -> Self {
        self - other
    }
    fn mul(&self, other: &Self) -> Self {
        self * other
    }
    fn zero() -> Self {
        Self::ZERO
    }
}

/// A double with a bound on its error, for numbers whose magnitudes are below 10⁶.
///
/// Each operation adds to the bound the effect of the operands' bounds on the result, and `U` times the
/// rounded result for its own rounding. The bounds are sums of products of non-negative doubles. Each
/// operation rounds a bound down by at most 4u of its value; 100 operations in a row lose less than 10⁻¹³ of
/// the bounds. Products below the range of doubles become 0, each with an error below 2⁻¹⁰⁷⁴, and later
/// factors are together less than 10³⁰. [`Approx::sign`] includes a margin for both errors.
#[derive(Clone, Copy, Debug, Default)]
pub struct Approx {
    /// The rounded value.
    pub value: f64,
    /// An upper bound of the error of `value`.
    pub error: f64,
}

impl Approx {
    /// Computes (x − y) · `scale`, where `scale` is a power of two.
    pub fn difference(x: f64, y: f64, scale: f64) -> Self {
        let value = x - y;
        // Knuth's sum: the computed remainder is exact.
        let back = value - x;
        let rest = (x - (value - back)) + (-y - back);
        Self {
            value: value * scale,
            error: rest.abs() * scale,
        }
    }

    /// Returns the sign of the exact number, 1 or −1, or `None` if the error may be larger than the value.
    pub fn sign(self) -> Option<i8> {
        if self.value.abs() > self.error * (1.0 + 1e-9) + 1e-280 {
            Some(if self.value > 0.0 { 1 } else { -1 })
        } else {
            None
        }
    }

    /// Returns the number with the opposite sign.
    pub fn negated(self) -> Self {
        Self {
            value: -self.value,
            error: self.error,
        }
    }
}

impl Number for Approx {
    fn add(&self, other: &Self) -> Self {
        let value = self.value + other.value;
        Self {
            value,
            error: self.error + other.error + U * value.abs(),
        }
    }
    fn sub(&self, other: &Self) -> Self {
        let value = self.value - other.value;
        Self {
            value,
            error: self.error + other.error + U * value.abs(),
        }
    }
    fn mul(&self, other: &Self) -> Self {
        let value = self.value * other.value;
        let of_operands =
            self.error * (other.value.abs() + other.error) + other.error * self.value.abs();
        Self {
            value,
            error: of_operands + U * value.abs(),
        }
    }
    fn zero() -> Self {
        Self::default()
    }
}

/// An integer modulo the prime 2⁶¹ − 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Residue(u64);

impl Residue {
    const PRIME: u64 = (1 << 61) - 1;

    /// Computes `mantissa` times two to the power of `exponent`, modulo the prime. Two to the power of 61 is
    /// 1.
    pub fn dyadic(mantissa: i64, exponent: i32) -> Self {
        let turn = exponent.rem_euclid(61) as u32;
        let magnitude = mantissa.unsigned_abs() % Self::PRIME;
        let turned = Self(((u128::from(magnitude) << turn) % u128::from(Self::PRIME)) as u64);
        if mantissa < 0 {
            Self::zero().sub(&turned)
        } else {
            turned
        }
    }

    /// Returns the residue as an integer below 2⁶¹.
    pub fn get(self) -> u64 {
        self.0
    }

    /// Computes the multiplicative inverse by Fermat's theorem. The inverse of 0 is 0.
    pub fn inverse(self) -> Self {
        let mut result = Self(1);
        let mut power = self;
        let mut exponent = Self::PRIME - 2;
        while exponent > 0 {
            if exponent & 1 == 1 {
                result = result.mul(&power);
            }
            power = power.mul(&power);
            exponent >>= 1;
        }
        result
    }
}

impl Number for Residue {
    fn add(&self, other: &Self) -> Self {
        let sum = self.0 + other.0;
        Self(if sum >= Self::PRIME {
            sum - Self::PRIME
        } else {
            sum
        })
    }
    fn sub(&self, other: &Self) -> Self {
        Self(if self.0 >= other.0 {
            self.0 - other.0
        } else {
            self.0 + Self::PRIME - other.0
        })
    }
    fn mul(&self, other: &Self) -> Self {
        let product = u128::from(self.0) * u128::from(other.0);
        let sum = (product as u64 & Self::PRIME) + (product >> 61) as u64;
        Self(if sum >= Self::PRIME {
            sum - Self::PRIME
        } else {
            sum
        })
    }
    fn zero() -> Self {
        Self(0)
    }
}

/// Computes normal and offset of the plane through three points a, b, c.
///
/// The normal is (b − a) × (c − a). The offset is −normal · a, so the plane's value at a is 0.
pub fn through_points<T: Number>([a, b, c]: [&[T; 3]; 3]) -> [T; 4] {
    let d: [T; 3] = std::array::from_fn(|i| b[i].sub(&a[i]));
    let e: [T; 3] = std::array::from_fn(|i| c[i].sub(&a[i]));
    let minor = |i: usize, j: usize| d[i].mul(&e[j]).sub(&d[j].mul(&e[i]));
    with_offset([minor(1, 2), minor(2, 0), minor(0, 1)], a)
}

/// Computes normal and offset of the plane through two points a, b and parallel to an axis.
///
/// The normal is (b − a) × axis.
pub fn along_axis<T: Number>([a, b]: [&[T; 3]; 2], axis: usize) -> [T; 4] {
    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut normal = std::array::from_fn(|_| T::zero());
    normal[i] = b[j].sub(&a[j]);
    normal[j] = a[i].sub(&b[i]);
    with_offset(normal, a)
}

fn with_offset<T: Number>(n: [T; 3], a: &[T; 3]) -> [T; 4] {
    let offset = n[0].mul(&a[0]).add(&n[1].mul(&a[1])).add(&n[2].mul(&a[2]));
    let [x, y, z] = n;
    [x, y, z, T::zero().sub(&offset)]
}

/// Computes the intersection of three planes in homogeneous coordinates.
///
/// The value of a fourth plane at the result is the determinant of the four planes. The last coordinate is
/// the determinant of the three normals.
pub fn meet<T: Number>(p: &[T; 4], q: &[T; 4], r: &[T; 4]) -> [T; 4] {
    let m = |i: usize, j: usize| p[i].mul(&q[j]).sub(&p[j].mul(&q[i]));
    let (m01, m02, m03) = (m(0, 1), m(0, 2), m(0, 3));
    let (m12, m13, m23) = (m(1, 2), m(1, 3), m(2, 3));
    // Minors of three columns, expanded along the row r.
    let det = |a: usize, ma: &T, b: usize, mb: &T, c: usize, mc: &T| {
        r[a].mul(ma).sub(&r[b].mul(mb)).add(&r[c].mul(mc))
    };
    [
        T::zero().sub(&det(1, &m23, 2, &m13, 3, &m12)),
        det(0, &m23, 2, &m03, 3, &m02),
        T::zero().sub(&det(0, &m13, 1, &m03, 3, &m01)),
        det(0, &m12, 1, &m02, 2, &m01),
    ]
}

/// Computes the value of a plane at a point in homogeneous coordinates.
pub fn value<T: Number>(plane: &[T; 4], point: &[T; 4]) -> T {
    let sum = plane[0].mul(&point[0]).add(&plane[1].mul(&point[1]));
    sum.add(&plane[2].mul(&point[2]))
        .add(&plane[3].mul(&point[3]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> [[i64; 4]; 4] {
        [[3, -1, 4, 1], [5, 9, -2, 6], [-5, 3, 5, 8], [9, 7, -9, 3]]
    }

    #[test]
    fn meet_lies_on_planes_and_gives_determinant() {
        let [p, q, r, s] = rows().map(|row| row.map(IBig::from));
        let x = meet(&p, &q, &r);
        for plane in [&p, &q, &r] {
            assert_eq!(value(plane, &x), IBig::ZERO);
        }
        // The expected value is computed separately, by expansion along the first column.
        let det3 = |a: [i64; 3], b: [i64; 3], c: [i64; 3]| {
            a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
                + a[2] * (b[0] * c[1] - b[1] * c[0])
        };
        let m = rows();
        let rest = |k: usize| [m[k][1], m[k][2], m[k][3]];
        let det = m[0][0] * det3(rest(1), rest(2), rest(3))
            - m[1][0] * det3(rest(0), rest(2), rest(3))
            + m[2][0] * det3(rest(0), rest(1), rest(3))
            - m[3][0] * det3(rest(0), rest(1), rest(2));
        assert_eq!(value(&s, &x), IBig::from(det));
    }

    #[test]
    fn residues_form_field() {
        let x = Residue::dyadic(-12345, -7);
        assert_eq!(x.mul(&x.inverse()), Residue::dyadic(1, 0));
        assert_eq!(Residue::dyadic(3, 61), Residue::dyadic(3, 0));
        assert_eq!(
            Residue::dyadic(1, -1).mul(&Residue::dyadic(2, 0)),
            Residue::dyadic(1, 0)
        );
        assert_eq!(
            Residue::dyadic(-5, 3).add(&Residue::dyadic(5, 3)),
            Residue::zero()
        );
    }

    #[test]
    fn difference_bounds_its_rounding_error() {
        let exact = Approx::difference(3.0, 1.0, 0.5);
        assert_eq!((exact.value, exact.error), (1.0, 0.0));
        let lost = Approx::difference(1.0, 1e-30, 1.0);
        assert_eq!((lost.value, lost.error), (1.0, 1e-30));
        assert_eq!(
            lost.sub(&Approx {
                value: 1.0,
                error: 0.0
            })
            .sign(),
            None
        );
    }
}
