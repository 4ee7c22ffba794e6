//! A box strictly around points, with corners of few bits.

use super::error::DelaunayError;

/// Returns the 8 corners of a box whose border touches none of the points.
///
/// Corner k has the upper x if bit 0 of k is set, the upper y if bit 1 is set, and the upper z if bit 2 is
/// set. The coordinates of corners are multiples of one power of two, the step, which is about 1/16 of the
/// largest extent of the points. So the corners add few bits to exact arithmetic. Each side of the box is one
/// or two steps outside of the points. Points must be finite.
pub(super) fn corners(points: &[[f32; 3]]) -> Result<[[f32; 3]; 8], DelaunayError> {
    let mut lower = *points.first().unwrap_or(&[0.0; 3]);
    let mut upper = lower;
    for p in points {
        for axis in 0..3 {
            lower[axis] = lower[axis].min(p[axis]);
            upper[axis] = upper[axis].max(p[axis]);
        }
    }
    let reach = lower
        .iter()
        .chain(&upper)
        .fold(0.0f32, |m, c| m.max(c.abs()));
    let extent = (0..3)
        .map(|axis| f64::from(upper[axis]) - f64::from(lower[axis]))
        .fold(0.0, f64::max);
    let step = step(extent, f64::from(reach));
    let mut bounds = [[0.0f32; 3]; 2];
    for axis in 0..3 {
        // The step is a power of two and at least 2⁻²¹ times `reach`. So the quotients are exact and below
        // 2²². The bounds are integers of at most 23 bits times the step, which are exact in f32 unless they
        // overflow.
        let down = ((f64::from(lower[axis]) / step).floor() - 1.0) * step;
        let up = ((f64::from(upper[axis]) / step).ceil() + 1.0) * step;
        if down < f64::from(f32::MIN) || up > f64::from(f32::MAX) {
            return Err(DelaunayError::TooFar { reach });
        }
        bounds[0][axis] = down as f32;
        bounds[1][axis] = up as f32;
    }
    Ok(std::array::from_fn(|k| {
        std::array::from_fn(|axis| bounds[k >> axis & 1][axis])
    }))
}

/// Returns the power of two whose multiples are the coordinates of the box corners.
///
/// The result is the largest power of two that is at most 1/16 of `extent`, or a larger power if the
/// precision of f32 requires it. `reach` is the largest magnitude of a coordinate.
fn step(extent: f64, reach: f64) -> f64 {
    let wanted = floor_power(extent) / 16.0;
    // 2⁻¹⁴⁹ is the smallest positive f32. f64 represents all of these powers.
    let step = wanted
        .max(floor_power(reach) / f64::from(1 << 20))
        .max(f64::from(f32::from_bits(1)));
    if reach == 0.0 { 1.0 } else { step }
}

/// Returns the largest power of two that is at most x, or 0 if x is 0.
///
/// Any other x must be at least 2⁻¹⁴⁹, which is a normal number in f64.
fn floor_power(x: f64) -> f64 {
    f64::from_bits(x.to_bits() & (0x7ff << 52))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn box_encloses_points_strictly_with_coarse_corners() {
        let tiny = f32::from_bits(1);
        for points in [
            vec![[0.0; 3]],
            vec![[5.0, -1.0, 1e-30]],
            vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
            vec![[tiny, -tiny, 0.0], [3.0 * tiny, 0.0, 0.0]],
            vec![[1e38, 1e-38, 0.0], [-1e38, 0.0, 7.0]],
            vec![[1_000_000.1, 0.3, 0.0], [1_000_000.2, 0.0, 0.0]],
        ] {
            let corners = corners(&points).unwrap();
            for p in &points {
                for axis in 0..3 {
                    assert!(
                        corners[0][axis] < p[axis] && p[axis] < corners[7][axis],
                        "{points:?} {corners:?}"
                    );
                }
            }
        }
        let c = corners(&[[0.3, 0.0, 0.0], [99.7, 1.0, 1.0]]).unwrap();
        assert_eq!((c[0], c[7]), ([-4.0, -4.0, -4.0], [104.0, 8.0, 8.0]));
        assert_eq!(c[5], [104.0, -4.0, 8.0]);
    }

    #[test]
    fn rejects_points_at_limit_of_single_precision() {
        let error = corners(&[[f32::MAX, 0.0, 0.0]]).unwrap_err();
        assert_eq!(error, DelaunayError::TooFar { reach: f32::MAX });
    }
}
