//! The linear dependence of three lines, decided in integers of fixed width. The test is frequent, because
//! scenes contain many pencils.

use glam::DVec3;
use sightline_geometry::predicates::{differences, small_integers};

/// Returns true if three lines through two points each are linearly dependent as vectors.
///
/// The result is `None` unless all points are small integers relative to the first point.
///
/// Relative to the first point, the first line is A = (d, 0), and the other lines B and C have directions
/// below 2⁴² and moments below 2⁸³. Let k be a component with d_k ≠ 0. The components of d_k B − B_k A and
/// d_k C − C_k A are below 2¹²⁵. The three lines are dependent if these two vectors are dependent.
pub fn dependent([a, b, c]: [[DVec3; 2]; 3]) -> Option<bool> {
    let [d, b0, b1, c0, c1] = small_integers(differences(a[0], [a[1], b[0], b[1], c[0], c[1]])?)?;
    let Some(k) = (0..3).find(|k| d[*k] != 0) else {
        return Some(true);
    };
    let d = d.map(i128::from);
    let without = |p: [i64; 3], q: [i64; 3]| -> [i128; 6] {
        let (p, q) = (p.map(i128::from), q.map(i128::from));
        let moment = |i: usize, j: usize| p[i] * q[j] - p[j] * q[i];
        let along = q[k] - p[k];
        let [x, y, z] = [0, 1, 2].map(|i| d[k] * (q[i] - p[i]) - along * d[i]);
        [
            x,
            y,
            z,
            d[k] * moment(1, 2),
            d[k] * moment(2, 0),
            d[k] * moment(0, 1),
        ]
    };
    let (x, y) = (without(b0, b1), without(c0, c1));
    let Some(i) = (0..6).find(|i| x[*i] != 0) else {
        return Some(true);
    };
    Some((0..6).all(|j| product(x[i], y[j]) == product(x[j], y[i])))
}

/// Computes a product as its sign, the upper 128 bits of its magnitude, and the lower 128 bits.
fn product(a: i128, b: i128) -> (i128, u128, u128) {
    const HALF: u32 = 64;
    let (x, y) = (a.unsigned_abs(), b.unsigned_abs());
    let low = |v: u128| v & u128::from(u64::MAX);
    let (xh, xl, yh, yl) = (x >> HALF, low(x), y >> HALF, low(y));
    let (ll, lh, hl) = (xl * yl, xl * yh, xh * yl);
    let middle = (ll >> HALF) + low(lh) + low(hl);
    let high = xh * yh + (lh >> HALF) + (hl >> HALF) + (middle >> HALF);
    (a.signum() * b.signum(), high, low(ll) | middle << HALF)
}

#[cfg(test)]
mod tests {
    use dashu_int::IBig;
    use proptest::prelude::*;

    use super::*;
    use crate::arithmetic::number::integers;

    /// Returns the line through two points in integers, with their coordinates scaled by 2^200.
    fn line([p, q]: [DVec3; 2]) -> [IBig; 6] {
        let at = |x: f64| {
            let ([n], e) = integers([x]);
            if n == IBig::ZERO {
                n
            } else {
                n << (e + 200) as usize
            }
        };
        let (p, q) = (p.to_array().map(at), q.to_array().map(at));
        let moment = |i: usize, j: usize| &p[i] * &q[j] - &p[j] * &q[i];
        let [x, y, z] = [0, 1, 2].map(|i| &q[i] - &p[i]);
        [x, y, z, moment(1, 2), moment(2, 0), moment(0, 1)]
    }

    /// Tests dependence by all minors of three.
    fn truth(lines: [[DVec3; 2]; 3]) -> bool {
        let [x, y, z] = lines.map(line);
        let minor = |i: usize, j: usize| &x[i] * &y[j] - &x[j] * &y[i];
        let mut all = (0..6).flat_map(|i| (0..6).flat_map(move |j| (0..6).map(move |k| (i, j, k))));
        all.all(|(i, j, k)| {
            (minor(i, j) * &z[k] - minor(i, k) * &z[j] + minor(j, k) * &z[i]).is_zero()
        })
    }

    proptest! {
        #[test]
        fn products_are_exact(a in any::<i128>(), b in any::<i128>()) {
            let (s, h, l) = product(a, b);
            let value = ((IBig::from(h) << 128) + IBig::from(l)) * IBig::from(s);
            prop_assert_eq!(value, IBig::from(a) * IBig::from(b));
        }

        #[test]
        fn dependent_agrees_with_integers_of_any_size(
            points in prop::array::uniform6(prop::array::uniform3(-3i32..4)),
            spread in 0i32..24,
            far in 0i32..2,
        ) {
            // Few values make many lines meet, be parallel or be equal; large values use all bits.
            let at = |i: usize| {
                let wide = |c: i32, k: i32| {
                    f64::from(c) * f64::powi(2.0, spread) + f64::from(far * (i as i32 * 7 + k))
                };
                DVec3::new(wide(points[i][0], 1), wide(points[i][1], 2), wide(points[i][2], 3))
            };
            let lines = [[at(0), at(1)], [at(2), at(3)], [at(4), at(5)]];
            if let Some(known) = dependent(lines) {
                prop_assert_eq!(known, truth(lines));
            }
            // Large values form pencils, and lines one unit off.
            let large = |c: i32| (f64::from(c) * f64::powi(2.0, 36)).round() + f64::from(c * 5 + 1);
            let d = |i: usize| DVec3::from(points[i].map(large));
            for off in [0.0, 1.0] {
                let third = d(0) * 2.0 + d(1) + DVec3::X * off;
                let lines = [[DVec3::ZERO, d(0)], [DVec3::ZERO, d(1)], [DVec3::ZERO, third]];
                prop_assert_eq!(dependent(lines), Some(truth(lines)));
                let third = [d(2) * 2.0 - d(4) + DVec3::Y * off, d(2) - d(4) + d(3)];
                let lines = [[d(2), d(3)], [d(4), d(4) + d(3) - d(2)], third];
                if let Some(known) = dependent(lines) {
                    prop_assert_eq!(known, truth(lines));
                }
            }
            // The first three lines share a point and a plane; the second three share a direction and a
            // plane.
            let v = DVec3::new(1.0, 2.0, 3.0) * f64::from(spread + 1);
            let (p, q) = (at(0), at(1));
            prop_assert_eq!(dependent([[p, q], [p, p + v], [p, p + v + (q - p)]]), Some(true));
            let r = p + (q - p) * 4.0;
            prop_assert_eq!(dependent([[p, p + v], [q, q + v], [r, r + v]]), Some(true));
        }
    }
}
