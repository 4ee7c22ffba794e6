//! A box strictly around points, with corners of few bits.

use super::error::DelaunayError;

/// The 8 corners of a box whose border no point touches. Corner k has the upper x if bit 0 of k is set, the
/// upper y for bit 1, the upper z for bit 2.
///
/// Corners are multiples of one power of two, about a sixteenth of the largest extent, so they add few bits
/// to exact arithmetic. Each bound is one or two such steps outside of the points. Points must be finite.
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
        // The step is a power of two and at least a 2⁻²¹th of the reach, so the quotients are exact and below
        // 2²², and the bounds are integers of at most 23 bits times the step: exact in f32 unless they
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

/// The power of two for the corners' grid: the largest that is at most a sixteenth of the extent, or more
/// where f32 needs it.
fn step(extent: f64, reach: f64) -> f64 {
    let wanted = floor_power(extent) / 16.0;
    // 2⁻¹⁴⁹ is the least f32. f64 holds all of these powers.
    let step = wanted
        .max(floor_power(reach) / f64::from(1 << 20))
        .max(f64::from(f32::from_bits(1)));
    if reach == 0.0 { 1.0 } else { step }
}

/// The largest power of two that is at most x, for x = 0 or x at least 2⁻¹⁴⁹, which f64 holds as a normal
/// number.
fn floor_power(x: f64) -> f64 {
    f64::from_bits(x.to_bits() & (0x7ff << 52))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_box_is_strictly_around_and_coarse() {
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
    fn no_room_is_an_error() {
        let error = corners(&[[f32::MAX, 0.0, 0.0]]).unwrap_err();
        assert_eq!(error, DelaunayError::TooFar { reach: f32::MAX });
    }
}
