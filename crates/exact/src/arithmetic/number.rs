//! Big integers, the conversion of doubles to integers, and the rounding back.
//!
//! Every coordinate is a finite double: an integer times a power of two. Points and lines are homogeneous, so
//! a common positive factor does not change them, and all components can be integers. [`primitive`] keeps
//! these integers small.

use dashu_int::IBig;
use dashu_int::ops::{BitTest, Gcd, UnsignedAbs as _};
use sightline_geometry::predicates::dyadic;

use crate::arithmetic::double_double::DoubleDouble;
#[cfg(doc)]
use crate::arithmetic::double_double::STEP;

/// Converts doubles to integers `n` with one common exponent `e`, so that `xs[i] = n[i] · 2^e` exactly.
pub fn integers<const N: usize>(xs: [f64; N]) -> ([IBig; N], i32) {
    let parts = xs.map(dyadic);
    let least = parts
        .iter()
        .filter(|p| p.0 != 0)
        .map(|p| p.1)
        .min()
        .unwrap_or(0);
    (
        parts.map(|(m, e)| {
            if m == 0 {
                IBig::ZERO
            } else {
                IBig::from(m) << (e - least) as usize
            }
        }),
        least,
    )
}

/// Converts a point to homogeneous integers (x, y, z, w), where w is a positive power of two.
pub fn homogeneous(p: [f64; 3]) -> [IBig; 4] {
    let ([x, y, z], e) = integers(p);
    if e < 0 {
        [x, y, z, IBig::ONE << (-e) as usize]
    } else {
        let up = e as usize;
        [x << up, y << up, z << up, IBig::ONE]
    }
}

/// Divides a vector by the greatest common divisor of its components. A vector of zeros stays unchanged.
pub fn primitive<const N: usize>(v: &mut [IBig; N]) {
    let Some(zeros) = v.iter().filter_map(IBig::trailing_zeros).min() else {
        return;
    };
    if zeros > 0 {
        v.iter_mut().for_each(|x| *x >>= zeros);
    }
    let mut divisor: Option<dashu_int::UBig> = None;
    for x in v.iter().filter(|x| !x.is_zero()) {
        let next = match divisor {
            None => x.clone().unsigned_abs(),
            Some(d) => d.gcd(x.clone().unsigned_abs()),
        };
        if next.is_one() {
            return;
        }
        divisor = Some(next);
    }
    if let Some(d) = divisor {
        let d = IBig::from(d);
        v.iter_mut().for_each(|x| *x /= &d);
    }
}

/// Converts a vector to doubles, scaled by a power of two so that the largest magnitude of a component is
/// from 1/2 to 1.
///
/// The error of each component is at most 2⁻⁵³. A vector of zeros stays unchanged.
pub fn rounded<const N: usize>(v: &[IBig; N]) -> [f64; N] {
    let longest = v.iter().map(|x| x.bit_len()).max().unwrap_or(0);
    // A double has fewer bits, so the error of the cut is far below the error of the rounding that follows.
    const KEPT: usize = 120;
    let cut = longest.saturating_sub(KEPT);
    let scale = f64::powi(2.0, -((longest - cut) as i32));
    std::array::from_fn(|i| {
        let x = if cut > 0 {
            (&v[i] >> cut).to_f64().value()
        } else {
            v[i].to_f64().value()
        };
        x * scale
    })
}

/// Converts a vector to double-doubles, scaled like [`rounded`], with an error of at most [`STEP`] per
/// component.
pub fn rounded_double_double<const N: usize>(v: &[IBig; N]) -> [DoubleDouble; N] {
    let longest = v.iter().map(|x| x.bit_len()).max().unwrap_or(0);
    const KEPT: usize = 160;
    let cut = longest.saturating_sub(KEPT);
    let scale = f64::powi(2.0, -((longest - cut) as i32));
    std::array::from_fn(|i| {
        if cut > 0 {
            double_double(&(&v[i] >> cut))
        } else {
            double_double(&v[i])
        }
        .scaled(scale)
    })
}

/// Converts an integer, whose magnitude must be below 2^1000, to a double-double.
pub fn double_double(x: &IBig) -> DoubleDouble {
    let high = x.to_f64().value();
    let ([n], e) = integers([high]);
    let low = (x - (n << e.max(0) as usize)).to_f64().value();
    DoubleDouble(high, low)
}

/// Scales a vector by a power of two so that the largest magnitude of a component is at least 1/2 and below
/// 1.
///
/// The function also returns the factor. If all components are 0 or the largest is not finite, the vector
/// stays unchanged and the factor is 1.
pub fn normalised<const N: usize>(x: [f64; N]) -> ([f64; N], f64) {
    let greatest = x.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    if greatest == 0.0 || !greatest.is_finite() {
        return (x, 1.0);
    }
    let exponent = ((greatest.to_bits() >> 52 & 0x7ff) as i32 - 1022).clamp(-1000, 1000);
    // The code sets the bits of 2^−exponent directly.
    let scale = f64::from_bits(((1023 - exponent) as u64) << 52);
    (x.map(|c| c * scale), scale)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use sightline_geometry::rounding::UNIT;

    use super::*;

    proptest! {
        #[test]
        fn doubles_convert_to_integers_and_back(x in any::<f64>().prop_filter("finite", |x| x.is_finite())) {
            let (m, e) = dyadic(x);
            prop_assert!(m % 2 != 0 || x == 0.0);
            // The product has two steps, because 2^e may be below the range of doubles.
            let half = e / 2;
            prop_assert_eq!(m as f64 * f64::powi(2.0, half) * f64::powi(2.0, e - half), x);
        }

        #[test]
        fn rounded_stays_within_error_bound(v in prop::array::uniform3(any::<i64>()), up in 0usize..300) {
            prop_assume!(v.iter().any(|x| *x != 0));
            let big = v.map(|x| IBig::from(x) << up);
            let near = rounded(&big);
            let longest = v.iter().map(|x| 64 - x.unsigned_abs().leading_zeros()).max().unwrap_or(0);
            for (x, n) in v.iter().zip(near) {
                prop_assert!((*x as f64 / f64::powi(2.0, longest as i32) - n).abs() <= 2.0 * UNIT);
            }
        }
    }

    #[test]
    fn primitive_vectors_have_no_common_factor() {
        let mut v = [12, -18, 0, 30].map(IBig::from);
        primitive(&mut v);
        assert_eq!(v, [2, -3, 0, 5].map(IBig::from));
        let mut zero = [IBig::ZERO, IBig::ZERO];
        primitive(&mut zero);
        assert_eq!(zero, [IBig::ZERO, IBig::ZERO]);
    }
}
