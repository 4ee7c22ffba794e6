//! Vectors in doubles with error bounds.
//!
//! A bound is absolute and holds for each component. The rules follow from the standard model of
//! floating-point arithmetic with u = 2⁻⁵³, without overflow. Coordinates are in single precision, and
//! vectors are scaled to a magnitude near 1 before they are multiplied again. So a product of five
//! coordinates is below 2⁷⁶⁰. If a viewpoint is very near to a point, products can underflow, and each then
//! loses less than [`LEAST`].

use sightline_geometry::rounding::UNIT as U;
use sightline_geometry::vector::dot;

/// Bound on the error of a few products that underflow.
pub const LEAST: f64 = f64::MIN_POSITIVE;

/// Relative margin of bounds on distances, far larger than the errors of their few roundings.
pub const BOUND: f64 = 1e-12;

/// A vector in doubles without an error bound.
pub type Vector = [f64; 3];

/// Returns the largest magnitude of a component.
#[inline]
pub fn size(v: Vector) -> f64 {
    v[0].abs().max(v[1].abs()).max(v[2].abs())
}

/// Scales a vector to length 1, without an error bound.
pub fn unit(v: Vector) -> Vector {
    let length = dot(v, v).sqrt();
    v.map(|c| c / length)
}

/// A vector and a bound on the error of each of its components.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rounded {
    /// The rounded vector.
    pub v: [f64; 3],
    /// The error bound of each component.
    pub error: f64,
}

/// A number and a bound on its error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RoundedNumber {
    /// The rounded number.
    pub value: f64,
    /// The error bound of the number.
    pub error: f64,
}

impl RoundedNumber {
    /// Returns the sign of the exact number, 1 or −1, or `None` if the error bound allows several signs.
    #[inline]
    pub fn sign(self) -> Option<i32> {
        if self.value > self.error {
            Some(1)
        } else if self.value < -self.error {
            Some(-1)
        } else {
            None
        }
    }
}

impl Rounded {
    /// Creates a vector without error.
    pub fn exact(v: [f64; 3]) -> Self {
        Self { v, error: 0.0 }
    }

    /// Computes a − b of points without errors, with one rounding of each component.
    #[inline]
    pub fn difference(a: [f64; 3], b: [f64; 3]) -> Self {
        let v = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        let mut it = Self { v, error: 0.0 };
        it.error = U * it.size();
        it
    }

    /// Returns the largest magnitude of a component.
    #[inline]
    pub fn size(&self) -> f64 {
        size(self.v)
    }

    /// Computes the cross product.
    ///
    /// Let A, B be the sizes and α, β the bounds. A product of two components errs by at most Aβ + Bα + αβ
    /// before it is rounded. Rounding adds at most uAB for each of the two products and 2uAB for their
    /// difference, up to second order.
    #[inline]
    pub fn cross(&self, b: &Self) -> Self {
        let (x, y) = (&self.v, &b.v);
        let v = [
            x[1] * y[2] - x[2] * y[1],
            x[2] * y[0] - x[0] * y[2],
            x[0] * y[1] - x[1] * y[0],
        ];
        let (sa, sb) = (self.size(), b.size());
        let error =
            2.0 * (sa * b.error + sb * self.error + self.error * b.error) + 6.0 * U * sa * sb;
        // The bound itself is rounded a few times.
        Self {
            v,
            error: error * (1.0 + 8.0 * U) + LEAST,
        }
    }

    /// Computes the scalar product: three products with the error of [`Self::cross`], and two sums.
    #[inline]
    pub fn dot(&self, b: &Self) -> RoundedNumber {
        let (x, y) = (&self.v, &b.v);
        let value = x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
        let (sa, sb) = (self.size(), b.size());
        let error =
            3.0 * (sa * b.error + sb * self.error + self.error * b.error) + 10.0 * U * sa * sb;
        RoundedNumber {
            value,
            error: error * (1.0 + 8.0 * U) + LEAST,
        }
    }

    /// Returns the sign of the scalar product, or `None` if the error bounds allow several signs.
    ///
    /// The components must be below 2. Then the bound of [`Self::dot`] is at most 6(α + β) + 3αβ + 40u. If α
    /// or β is at least 1, 12.1 times this number exceeds any product. So 3αβ is at most 3(α + β) if the
    /// function returns a sign.
    #[inline]
    pub fn side(&self, b: &Self) -> Option<i32> {
        let (x, y) = (&self.v, &b.v);
        let value = x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
        let error = 12.1 * (self.error + b.error) + 48.0 * U;
        RoundedNumber { value, error }.sign()
    }

    /// Computes p·a − q·b.
    pub fn combination(p: RoundedNumber, a: &Self, q: RoundedNumber, b: &Self) -> Self {
        let mut v = [0.0; 3];
        for (k, v) in v.iter_mut().enumerate() {
            *v = p.value * a.v[k] - q.value * b.v[k];
        }
        let part = |p: RoundedNumber, a: &Self| {
            let (s, t) = (p.value.abs(), a.size());
            s * a.error + t * p.error + p.error * a.error + 3.0 * U * s * t
        };
        Self {
            v,
            error: (part(p, a) + part(q, b)) * (1.0 + 8.0 * U) + LEAST,
        }
    }

    /// Scales the vector by a power of two to a size in [1, 2), without rounding. The size is the largest
    /// magnitude of a component.
    #[inline]
    pub fn scaled(&self) -> Self {
        let size = self.size();
        if size == 0.0 || !size.is_finite() {
            return *self;
        }
        // Two factors are necessary, because the inverse of a subnormal number is infinite.
        let by = power_below(size);
        let v = self.v.map(|x| x * by.0 * by.1);
        // The added number prevents an underflow of the bound to 0.
        Self {
            v,
            error: self.error * by.0 * by.1 + f64::MIN_POSITIVE,
        }
    }

    /// Returns the vector in the opposite direction.
    #[inline]
    pub fn reversed(&self) -> Self {
        Self {
            v: self.v.map(|x| -x),
            error: self.error,
        }
    }
}

/// Returns two powers of two whose product times `x` is in [1, 2), for `x` > 0.
fn power_below(x: f64) -> (f64, f64) {
    let exponent = if x < f64::MIN_POSITIVE {
        // A subnormal number is normalised first.
        ((x * f64::powi(2.0, 64)).to_bits() >> 52) as i32 - 1023 - 64
    } else {
        (x.to_bits() >> 52) as i32 - 1023
    };
    let half = -exponent / 2;
    // The halves of exponents are far from the limits, so each power is a normal double, given by its
    // exponent bits.
    let power = |e: i32| f64::from_bits(((e + 1023) as u64) << 52);
    (power(half), power(-exponent - half))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scaling_yields_size_below_two() {
        for x in [1.0, 1.5, 3.0, 1e-300, 1e300, 5e-324, 0.75] {
            let it = Rounded::exact([x, -x / 4.0, 0.0]).scaled();
            assert!((1.0..2.0).contains(&it.size()), "{x}: {it:?}");
        }
    }
}
