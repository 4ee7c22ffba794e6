//! Exact decisions about `f32` points: a filter in `f64` first, exact arithmetic when it cannot tell.

use glam::Vec3;

/// Whether the three points lie on one line (or coincide).
///
/// Each component of (b − a) × (c − a) is a sum of six products of two `f32`, and the triangle is degenerate
/// when all three are zero. A product of two `f32` is exact in `f64` (48 bits of mantissa, exponents in range),
/// so only the additions can round; they are done as an error-free expansion (Shewchuk 1997, §2).
pub fn collinear(a: Vec3, b: Vec3, c: Vec3) -> bool {
    let zero2 = |a: (f32, f32), b: (f32, f32), c: (f32, f32)| {
        let p = |x: f32, y: f32| f64::from(x) * f64::from(y);
        // (bx−ax)(cy−ay) − (by−ay)(cx−ax), expanded; the ax·ay terms cancel.
        sum_is_zero([p(b.0, c.1), -p(b.0, a.1), -p(a.0, c.1), -p(b.1, c.0), p(b.1, a.0), p(a.1, c.0)])
    };
    zero2((a.x, a.y), (b.x, b.y), (c.x, c.y))
        && zero2((a.y, a.z), (b.y, b.z), (c.y, c.z))
        && zero2((a.z, a.x), (b.z, b.x), (c.z, c.x))
}

/// Whether six doubles sum to exactly zero, by growing a non-overlapping expansion.
fn sum_is_zero(terms: [f64; 6]) -> bool {
    let mut expansion = [0.0f64; 6];
    for (len, term) in terms.into_iter().enumerate() {
        let mut q = term;
        for e in &mut expansion[..len] {
            let (sum, error) = two_sum(q, *e);
            *e = error;
            q = sum;
        }
        expansion[len] = q;
    }
    expansion.iter().all(|e| *e == 0.0)
}

/// `a + b` as rounded sum and exact error (Knuth's two-sum).
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let bb = sum - a;
    (sum, (a - (sum - bb)) + (b - bb))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearly_collinear_is_told_from_collinear() {
        let a = Vec3::new(0.1, 0.1, 0.0);
        let c = Vec3::new(0.3, 0.3, 0.0);
        assert!(collinear(a, Vec3::new(0.2, 0.2, 0.0), c));
        let off = Vec3::new(0.2, f32::from_bits(0.2f32.to_bits() + 1), 0.0);
        assert!(!collinear(a, off, c));
        assert!(!collinear(Vec3::ZERO, Vec3::splat(1e30), Vec3::new(1e-30, 0.0, 0.0)));
    }
}
