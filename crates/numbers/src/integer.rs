//! Quotients of two integers of any size, in floating point.

use dashu_int::IBig;

/// Computes `n / d` for `d > 0`, with a relative error of at most about 3u (u = 2⁻⁵³).
///
/// A quotient outside the range of `f64` becomes infinite or 0.
pub fn ratio(n: &IBig, d: &IBig) -> f64 {
    use dashu_int::ops::BitTest;
    // Divide only the leading 120 bits of both integers. The difference of their numbers of cut bits then
    // scales the quotient.
    let part = |x: &IBig| {
        let cut = x.bit_len().saturating_sub(120);
        ((x >> cut).to_f64().value(), cut as i32)
    };
    let ((n, en), (d, ed)) = (part(n), part(d));
    // The scaling has two steps, so that neither power of two overflows unless the result does.
    let half = (en - ed) / 2;
    n / d * f64::powi(2.0, half) * f64::powi(2.0, en - ed - half)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratio_of_large_integers_is_close() {
        let large = |x: i32, shift: usize| IBig::from(x) << shift;
        assert_eq!(ratio(&IBig::from(7), &IBig::from(2)), 3.5);
        assert_eq!(ratio(&large(-7, 3000), &large(2, 3000)), -3.5);
        assert_eq!(
            ratio(&large(3, 900), &large(1, 0)),
            3.0 * f64::powi(2.0, 900)
        );
        let third = ratio(&large(1, 1500), &(large(3, 1500) + IBig::ONE));
        assert!((third * 3.0 - 1.0).abs() < 3.0 * f64::EPSILON);
        assert_eq!(ratio(&IBig::ZERO, &large(1, 2000)), 0.0);
    }
}
