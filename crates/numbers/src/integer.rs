//! Integers of any size and what they are rounded to.

use dashu_int::IBig;

/// n / d, correctly rounded up to 3u, for d > 0.
pub fn ratio(n: &IBig, d: &IBig) -> f64 {
    use dashu_int::ops::BitTest;
    // Leading bits of both; the exponents are put back at the end.
    let part = |x: &IBig| {
        let cut = x.bit_len().saturating_sub(120);
        ((x >> cut).to_f64().value(), cut as i32)
    };
    let ((n, en), (d, ed)) = (part(n), part(d));
    let half = (en - ed) / 2;
    n / d * f64::powi(2.0, half) * f64::powi(2.0, en - ed - half)
}
