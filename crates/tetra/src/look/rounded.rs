//! Vectors in doubles that know how far they may be from the truth.
//!
//! A bound is absolute and holds for each component. The rules follow from the standard model of
//! floating-point arithmetic, with u = 2⁻⁵³ and nothing that overflows: coordinates are of single precision,
//! vectors are scaled to a magnitude near 1 before they are multiplied again, and a product of five
//! coordinates is below 2⁷⁶⁰. A viewpoint can be so near to a point that products underflow: each loses less
//! than [`LEAST`] then.

use sightline_geometry::rounding::UNIT as U;
use sightline_geometry::vector::dot;

/// More than what underflow takes away from a few products.
pub const LEAST: f64 = f64::MIN_POSITIVE;

/// A part by which bounds on distances are moved: far more than their few roundings.
pub const BOUND: f64 = 1e-12;

/// A vector without a bound.
pub type V = [f64; 3];

/// The largest magnitude of a component.
#[inline]
pub fn size(v: V) -> f64 {
    v[0].abs().max(v[1].abs()).max(v[2].abs())
}

/// The vector with length 1, without a bound.
pub fn unit(v: V) -> V {
    let length = dot(v, v).sqrt();
    v.map(|c| c / length)
}

/// A vector and a bound on the error of each of its components.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rounded {
    /// The vector.
    pub v: [f64; 3],
    /// The bound.
    pub error: f64,
}

/// A number and a bound on its error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RoundedNumber {
    /// The number.
    pub value: f64,
    /// The bound.
    pub error: f64,
}

impl RoundedNumber {
    /// The number's sign, if the bound leaves no doubt.
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
    /// A vector without error.
    pub fn exact(v: [f64; 3]) -> Self {
        Self { v, error: 0.0 }
    }

    /// a − b of exact points: one rounding of each component.
    #[inline]
    pub fn difference(a: [f64; 3], b: [f64; 3]) -> Self {
        let v = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        let mut it = Self { v, error: 0.0 };
        it.error = U * it.size();
        it
    }

    /// The largest magnitude of a component.
    #[inline]
    pub fn size(&self) -> f64 {
        size(self.v)
    }

    /// The cross product.
    ///
    /// With A, B the sizes and α, β the bounds, a product of two components errs by at most Aβ + Bα + αβ
    /// before it is rounded, and the two products and their difference are rounded by at most uAB each
    /// product and 2uAB together, up to second order.
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

    /// The scalar product: three products, each as above, and two sums.
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

    /// The sign of the scalar product of two vectors whose components are below 2, if bounds leave no doubt.
    ///
    /// With sizes below 2 the bound of [`Self::dot`] is at most 6(α + β) + 3αβ + 40u. Where α or β is 1 or
    /// more, 12.1 of it is more than any product, so that 3αβ is at most 3(α + β) wherever a sign comes out.
    #[inline]
    pub fn side(&self, b: &Self) -> Option<i32> {
        let (x, y) = (&self.v, &b.v);
        let value = x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
        let error = 12.1 * (self.error + b.error) + 48.0 * U;
        RoundedNumber { value, error }.sign()
    }

    /// p·a − q·b.
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

    /// The same direction with a size in [1, 2): the factor is a power of two, so nothing is rounded.
    #[inline]
    pub fn scaled(&self) -> Self {
        let size = self.size();
        if size == 0.0 || !size.is_finite() {
            return *self;
        }
        // In two steps, because the inverse of a subnormal number is infinite.
        let by = power_below(size);
        let v = self.v.map(|x| x * by.0 * by.1);
        // A bound that underflows to 0 would claim too much.
        Self {
            v,
            error: self.error * by.0 * by.1 + f64::MIN_POSITIVE,
        }
    }

    /// The vector in the opposite direction.
    #[inline]
    pub fn reversed(&self) -> Self {
        Self {
            v: self.v.map(|x| -x),
            error: self.error,
        }
    }
}

/// Two powers of two whose product times `x` is in [1, 2), for `x` > 0.
fn power_below(x: f64) -> (f64, f64) {
    let exponent = if x < f64::MIN_POSITIVE {
        // Subnormal: normalised first.
        ((x * f64::powi(2.0, 64)).to_bits() >> 52) as i32 - 1023 - 64
    } else {
        (x.to_bits() >> 52) as i32 - 1023
    };
    let half = -exponent / 2;
    // Halves of exponents are far from the limits, so the bits of the exponents are all there is to it.
    let power = |e: i32| f64::from_bits(((e + 1023) as u64) << 52);
    (power(half), power(-exponent - half))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scaling_is_a_power_of_two() {
        for x in [1.0, 1.5, 3.0, 1e-300, 1e300, 5e-324, 0.75] {
            let it = Rounded::exact([x, -x / 4.0, 0.0]).scaled();
            assert!((1.0..2.0).contains(&it.size()), "{x}: {it:?}");
        }
    }
}
