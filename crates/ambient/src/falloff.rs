//! The falloff of section 5.3 of the paper, as an integral over what is seen: a direction in which a face is
//! met at the distance d < D counts √(d/D). (Equation 4 there takes the barycentre of each fragment, so that
//! its value depends on how fragments were cut.)
//!
//! Let N be the unit normal of the face's plane, h the point's distance from it, and μ = N·ω. Along ω the
//! plane is h/μ away, so a part adds √(h/D) ∫ μ^(−½) (n·ω) dω. In the plane at distance 1, at p = ω/μ − N, dω
//! = μ³ dp and μ = (1 + p²)^(−½); with n = (n·N) N + t the integral is that of
//!
//! - (n·N) μ^(7/2), the divergence of (n·N) ⅔ (1 − μ^(3/2)) p / p²,
//! - (t·p) μ^(7/2), the divergence of −⅔ μ^(3/2) t,
//!
//! and so one along the border: in closed form on the circle of the distance, by Gauss' rule on great
//! circles.

use glam::DVec3;

use crate::arcs::{Piece, common};
use crate::lambert::Cap;
use crate::polygon::Corner;

/// Longest stretch of a great circle that one application of the rule takes, in radians.
const STRETCH: f64 = 0.8;
/// A stretch is halved until its halves give the same but for this, at most so many times: near the plane's
/// horizon μ^(−½) is steep.
const NEAR: f64 = 1e-12;
const HALVINGS: u32 = 16;
/// Gauss' rule of eight points between −1 and 1: points and weights (Abramowitz and Stegun, table 25.4).
const RULE: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
];

/// What a part that meets a plane counts, divided by π, where it meets it within the distance, and the error
/// of the rule as estimated. `cap` has the plane's normal, and its height by the distance as its cosine.
pub fn counts(n: DVec3, corners: &[Corner], cap: &Cap) -> (f64, f64) {
    let normal = cap.axis;
    let up = n.dot(normal);
    let t = n - normal * up;
    let (u, v) = cap.across();
    let (mut sum, mut error) = (0.0, 0.0);
    for piece in common(corners, cap) {
        match piece {
            Piece::Great { v, w, length } => {
                sum += along(v, w, length, (normal, up, t), &mut error)
            }
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

/// One and a half times the integral along a stretch of a great circle.
fn along(
    v: DVec3,
    w: DVec3,
    length: f64,
    (normal, up, t): (DVec3, f64, DVec3),
    error: &mut f64,
) -> f64 {
    let (turn, side) = (normal.dot(v.cross(w)), normal.cross(t));
    let at = |angle: f64| {
        let (sin, cos) = libm::sincos(angle);
        let (here, way) = (v * cos + w * sin, w * cos - v * sin);
        let (mu, slope) = (normal.dot(here).max(0.0), normal.dot(way));
        let root = mu.sqrt();
        // (1 − μ^(3/2)) / (1 − μ²), without the root of both at μ = 1.
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
                (from, from + step),
                rule(&at, from, from + step),
                HALVINGS,
                error,
            )
        })
        .sum()
}

/// Gauss' rule on a stretch.
fn rule(at: &impl Fn(f64) -> f64, from: f64, to: f64) -> f64 {
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    RULE.iter()
        .map(|(x, weight)| weight * (at(middle - x * half) + at(middle + x * half)))
        .sum::<f64>()
        * half
}

/// The integral over a stretch whose rule gives `whole`, by its halves, and theirs while they differ.
fn halved(
    at: &impl Fn(f64) -> f64,
    (from, to): (f64, f64),
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
    halved(at, (from, middle), one, halvings - 1, error)
        + halved(at, (middle, to), two, halvings - 1, error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::openness::quarters;

    #[test]
    fn a_ceiling_counts_as_in_closed_form() {
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
    fn a_tilted_plane_counts_as_a_sum_over_cells() {
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
