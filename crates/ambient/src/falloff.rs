//! The falloff of section 5.3 of the paper, as an integral over the visible faces: a direction that meets a
//! face at the distance d < D is open by the fraction √(d/D). (Equation 4 of the paper evaluates the
//! barycentre of each fragment, so its value depends on the division into fragments.)
//!
//! Let N be the unit normal of the face's plane, h the point's distance from it, and μ = N·ω. Along ω the
//! plane is at the distance h/μ, so a part adds √(h/D) ∫ μ^(−½) (n·ω) dω. In the plane at distance 1, at p =
//! ω/μ − N, dω = μ³ dp and μ = (1 + p²)^(−½). With n = (n·N) N + t the integrand is the sum of
//!
//! - (n·N) μ^(7/2), the divergence of (n·N) ⅔ (1 − μ^(3/2)) p / p²,
//! - (t·p) μ^(7/2), the divergence of −⅔ μ^(3/2) t.
//!
//! Both are divergences, so the integral is an integral along the border: in closed form on the circle of the
//! distance, and by Gauss' rule on great circles.

use glam::DVec3;

use crate::arcs::{Piece, common};
use crate::lambert::Cap;
use crate::polygon::Corner;

/// Maximum length, in radians, of a stretch of a great circle for one application of Gauss' rule.
const STRETCH: f64 = 0.8;
/// Maximum accepted difference between the integral over a stretch and the sum of the integrals over its two
/// halves.
///
/// A stretch with a larger difference is halved again, at most [`HALVINGS`] times, because μ^(−½) is steep
/// near the plane's horizon.
const NEAR: f64 = 1e-12;
/// Maximum number of successive halvings of a stretch.
const HALVINGS: u32 = 16;
/// Gauss' rule of eight points between −1 and 1: positive points and weights (Abramowitz and Stegun, table
/// 25.4).
const RULE: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
];

/// Computes the contribution to the openness, with the falloff, of the directions of a polygon that meet a
/// plane within the distance.
///
/// The second value is the estimated error of Gauss' rule. `n` is the receiver's normal. The axis of `cap` is
/// the plane's normal, and its cosine is the plane's height divided by the distance.
pub fn counts(n: DVec3, corners: &[Corner], cap: &Cap) -> (f64, f64) {
    let normal = cap.axis;
    let up = n.dot(normal);
    let t = n - normal * up;
    let (u, v) = cap.across();
    let (mut sum, mut error) = (0.0, 0.0);
    for piece in common(corners, cap) {
        match piece {
            Piece::Great { v, w, length } => sum += along(v, w, length, normal, up, t, &mut error),
            Piece::Circle { from, to } => {
                let c = cap.cosine;
                let root = c * c.sqrt();
                // p = r (u cos φ + v sin φ) with r c = sin a.
                let (half, middle) = (0.5 * (to - from), 0.5 * (to + from));
                let (sin, cos) = libm::sincos(middle);
                let swing = 2.0 * libm::sin(half);
                sum += up * (1.0 - root) * (to - from);
                sum -= root * cap.sine() / c * swing * t.dot(u * cos + v * sin);
            }
        }
    }
    let scale = cap.cosine.sqrt() * 2.0 / (3.0 * std::f64::consts::PI);
    (sum * scale, error * scale)
}

/// Computes 3/2 times the integral along the arc v cos t + w sin t, 0 ≤ t ≤ `length`, of a great circle. Adds
/// the estimated error to `error`.
fn along(
    v: DVec3,
    w: DVec3,
    length: f64,
    normal: DVec3,
    up: f64,
    t: DVec3,
    error: &mut f64,
) -> f64 {
    let (turn, side) = (normal.dot(v.cross(w)), normal.cross(t));
    let at = |angle: f64| {
        let (sin, cos) = libm::sincos(angle);
        let (here, way) = (v * cos + w * sin, w * cos - v * sin);
        let (mu, slope) = (normal.dot(here).max(0.0), normal.dot(way));
        let root = mu.sqrt();
        // (1 − μ^(3/2)) / (1 − μ²), without the zero of both at μ = 1.
        let ratio = (1.0 + root + mu) / ((1.0 + root) * (1.0 + mu));
        let crossed = side.dot(way * mu - here * slope);
        up * ratio * turn - if root > 0.0 { crossed / root } else { 0.0 }
    };
    let pieces = (length / STRETCH).ceil().max(1.0);
    let step = length / pieces;
    (0..pieces as u32)
        .map(|k| {
            let from = f64::from(k) * step;
            halved(
                &at,
                from,
                from + step,
                rule(&at, from, from + step),
                HALVINGS,
                error,
            )
        })
        .sum()
}

/// Integrates the function `at` from `from` to `to` by Gauss' rule.
fn rule(at: &impl Fn(f64) -> f64, from: f64, to: f64) -> f64 {
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    RULE.iter()
        .map(|(x, weight)| weight * (at(middle - x * half) + at(middle + x * half)))
        .sum::<f64>()
        * half
}

/// Integrates the function `at` from `from` to `to` as the sum over two halves. `whole` is the value of
/// Gauss' rule for the whole stretch.
///
/// Halves further, at most `halvings` times, while the sum differs from `whole` by more than [`NEAR`]. Adds
/// the remaining difference to `error`.
fn halved(
    at: &impl Fn(f64) -> f64,
    from: f64,
    to: f64,
    whole: f64,
    halvings: u32,
    error: &mut f64,
) -> f64 {
    let middle = 0.5 * (from + to);
    let (one, two) = (rule(at, from, middle), rule(at, middle, to));
    let off = (one + two - whole).abs();
    if off <= NEAR || halvings == 0 {
        *error += off;
        return one + two;
    }
    halved(at, from, middle, one, halvings - 1, error)
        + halved(at, middle, to, two, halvings - 1, error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::openness::quarters;

    #[test]
    fn ceiling_falloff_matches_closed_form() {
        for c in [0.1, 0.35, 0.8] {
            let cap = Cap {
                axis: DVec3::Z,
                cosine: c,
            };
            let value: f64 = quarters(DVec3::Z)
                .iter()
                .map(|q| counts(DVec3::Z, q, &cap).0)
                .sum();
            let expected = 4.0 / 3.0 * c.sqrt() - 4.0 / 3.0 * c * c;
            assert!((value - expected).abs() < 1e-12, "{value} {expected}");
        }
    }

    #[test]
    fn tilted_plane_falloff_matches_sum_over_cells() {
        let n = DVec3::Z;
        let cap = Cap {
            axis: DVec3::new(0.48, 0.6, 0.64),
            cosine: 0.3,
        };
        let (steps, mut sum) = (2000, 0.0);
        for i in 0..steps {
            let s = (f64::from(i) + 0.5) / f64::from(steps);
            let (sin, cos) = (s.sqrt(), (1.0 - s).sqrt());
            for j in 0..steps {
                let (y, x) =
                    ((f64::from(j) + 0.5) / f64::from(steps) * std::f64::consts::TAU).sin_cos();
                let mu = cap.axis.dot(DVec3::new(sin * x, sin * y, cos));
                sum += if mu > cap.cosine {
                    (cap.cosine / mu).sqrt()
                } else {
                    0.0
                };
            }
        }
        let expected = sum / f64::from(steps * steps);
        let value: f64 = quarters(n).iter().map(|q| counts(n, q, &cap).0).sum();
        assert!((value - expected).abs() < 3e-5, "{value} {expected}");
    }
}
