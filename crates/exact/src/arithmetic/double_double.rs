//! Double-doubles: pairs of doubles whose sum is the value, with about 104 significant bits.
//!
//! Double-doubles decide signs that doubles cannot decide and that integers decide slowly. Sums and products
//! follow Dekker 1971 ("A Floating-Point Technique for Extending the Available Precision") and Knuth ("The
//! Art of Computer Programming", volume 2). [`STEP`] bounds the error of an operation if no intermediate
//! value overflows or underflows.

use sightline_geometry::predicates::two_sum;

/// A value as the unevaluated sum of two doubles.
///
/// The second double is at most half a unit in the last place of the first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DoubleDouble(pub f64, pub f64);

/// The relative error bound of one operation: 2⁻¹⁰¹ times the sum of the magnitudes of both operands for a
/// sum or difference, and 2⁻¹⁰¹ times the magnitude of the result for a product.
pub const STEP: f64 = f64::EPSILON * f64::EPSILON * 8.0;

/// Computes a + b exactly, for |a| ≥ |b|.
#[inline]
fn quick_sum(a: f64, b: f64) -> (f64, f64) {
    let s = a + b;
    (s, b - (s - a))
}

/// Splits a double into two halves of its bits (Veltkamp).
#[inline]
fn halves(a: f64) -> (f64, f64) {
    let c = 134_217_729.0 * a;
    let high = c - (c - a);
    (high, a - high)
}

/// Computes a·b exactly, as the rounded product and the rounding error.
///
/// The function uses no fused operation, because not every processor has one.
#[inline]
fn two_product(a: f64, b: f64) -> (f64, f64) {
    let p = a * b;
    let ((ah, al), (bh, bl)) = (halves(a), halves(b));
    (p, ((ah * bh - p) + ah * bl + al * bh) + al * bl)
}

impl DoubleDouble {
    /// Computes a + b exactly.
    #[inline]
    pub fn sum(a: f64, b: f64) -> Self {
        let (s, e) = two_sum(a, b);
        Self(s, e)
    }

    /// Computes a·b exactly.
    #[inline]
    pub fn product(a: f64, b: f64) -> Self {
        let (p, e) = two_product(a, b);
        Self(p, e)
    }

    /// Computes a − b exactly.
    #[inline]
    pub fn difference(a: f64, b: f64) -> Self {
        Self::sum(a, -b)
    }

    /// Computes the sum of two double-doubles.
    #[inline]
    pub fn plus(self, o: Self) -> Self {
        let (s, e) = two_sum(self.0, o.0);
        let (t, f) = two_sum(self.1, o.1);
        let (s, e) = quick_sum(s, e + t);
        let (s, e) = quick_sum(s, e + f);
        Self(s, e)
    }

    /// Computes the difference of two double-doubles.
    #[inline]
    pub fn minus(self, o: Self) -> Self {
        self.plus(Self(-o.0, -o.1))
    }

    /// Computes the product of two double-doubles.
    #[inline]
    pub fn times(self, o: Self) -> Self {
        let (p, e) = two_product(self.0, o.0);
        let (p, e) = quick_sum(p, e + (self.0 * o.1 + self.1 * o.0));
        Self(p, e)
    }

    /// Multiplies the value by a power of two, which is exact unless a double underflows or overflows.
    #[inline]
    pub fn scaled(self, power: f64) -> Self {
        Self(self.0 * power, self.1 * power)
    }

    /// Computes the quotient of two double-doubles, with a relative error of at most 2⁻¹⁰⁰.
    #[inline]
    pub fn over(self, o: Self) -> Self {
        let q = self.0 / o.0;
        let rest = self.minus(o.times(Self(q, 0.0)));
        let r = rest.0 / o.0;
        let rest = rest.minus(o.times(Self(r, 0.0)));
        let (s, e) = quick_sum(q, r);
        Self(s, e).plus(Self(rest.0 / o.0, 0.0))
    }

    /// Returns the magnitude.
    #[inline]
    pub fn abs(self) -> Self {
        if self.0 < 0.0 {
            Self(-self.0, -self.1)
        } else {
            self
        }
    }
}

#[cfg(test)]
mod tests {
    use dashu_int::IBig;
    use proptest::prelude::*;
    use sightline_geometry::predicates::dyadic;

    use super::*;

    /// Returns the value times 2³⁰⁰ exactly.
    fn exact(x: DoubleDouble) -> IBig {
        let to_integer = |x: f64| {
            let (n, e) = dyadic(x);
            if n == 0 {
                IBig::ZERO
            } else {
                IBig::from(n) << (e + 300) as usize
            }
        };
        to_integer(x.0) + to_integer(x.1)
    }

    fn value() -> impl Strategy<Value = DoubleDouble> {
        (-1.0f64..1.0, -1.0f64..1.0, -30i32..1).prop_map(|(a, b, e)| {
            let (s, r) = quick_sum(a, b * f64::EPSILON * 0.5);
            DoubleDouble(s, r).scaled(f64::powi(2.0, e))
        })
    }

    fn near(got: DoubleDouble, want: &IBig, scale: &IBig) -> bool {
        use dashu_int::ops::Abs as _;
        // STEP is 2^-101.
        ((exact(got) - want).abs() << 101) <= *scale
    }

    proptest! {
        #[test]
        fn operations_stay_within_error_step(a in value(), b in value()) {
            use dashu_int::ops::Abs as _;
            prop_assert_eq!(STEP, f64::powi(2.0, -101));
            let (x, y) = (exact(a), exact(b));
            let sum = x.clone().abs() + y.clone().abs();
            prop_assert!(near(a.plus(b), &(&x + &y), &sum));
            prop_assert!(near(a.minus(b), &(&x - &y), &sum));
            let product: IBig = (&x * &y) >> 300;
            prop_assert!(near(a.times(b), &product, &(product.clone().abs() + IBig::from(2))));
            if b.0.abs() > 1e-6 {
                let quotient: IBig = (&x << 300) / &y;
                prop_assert!(near(a.over(b), &quotient, &(quotient.clone().abs() * 2 + IBig::from(2))));
            }
        }
    }
}
