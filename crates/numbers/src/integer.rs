//! Integers of any size, and quotients of two of them in floating point.

use dashu_int::IBig;

/// `n / d` for `d > 0`, with a relative error of at most about 3u, where u = 2⁻⁵³. A quotient beyond the
/// range of `f64` becomes infinite or 0.
pub fn ratio(n: &IBig, d: &IBig) -> f64 {
    use dashu_int::ops::BitTest;
    // Only the leading bits of both are divided; their exponents are added at the end.
    let part = |x: &IBig| {
        let cut = x.bit_len().saturating_sub(120);
        ((x >> cut).to_f64().value(), cut as i32)
    };
    let ((n, en), (d, ed)) = (part(n), part(d));
    // In two steps, so that neither power of two overflows where their product does not.
    let half = (en - ed) / 2;
    n / d * f64::powi(2.0, half) * f64::powi(2.0, en - ed - half)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotients_of_large_integers_are_close() {
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
