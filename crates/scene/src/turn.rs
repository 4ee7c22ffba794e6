//! Cosine and sine by Taylor series, because the math libraries of platforms differ in the last bit.

/// Returns the cosine and sine of the angle `quarters`, whose unit is a quarter of a full turn.
pub(crate) fn of_quarters(quarters: f64) -> (f64, f64) {
    let nearest = (quarters + 0.5).floor();
    let x = (quarters - nearest) * std::f64::consts::FRAC_PI_2;
    let xx = x * x;
    // |x| ≤ π/4: the first omitted term is below 1e-11, far below the resolution of f32.
    let sin = x * (1.0 - xx / 6.0 * (1.0 - xx / 20.0 * (1.0 - xx / 42.0 * (1.0 - xx / 72.0))));
    let cos = 1.0
        - xx / 2.0 * (1.0 - xx / 12.0 * (1.0 - xx / 30.0 * (1.0 - xx / 56.0 * (1.0 - xx / 90.0))));
    match (nearest as i64).rem_euclid(4) {
        0 => (cos, sin),
        1 => (-sin, cos),
        2 => (-cos, -sin),
        _ => (sin, -cos),
    }
}
