//! The border of the intersection of a convex polygon and a cap: pieces of great circles and of the cap's
//! circle.

use std::f64::consts::TAU;

use glam::DVec3;

use crate::lambert::{Cap, CapCoverage, crossing};
use crate::polygon::Corner;

/// A piece of the border, which runs counter-clockwise as seen from outside the sphere of directions.
#[derive(Clone, Copy, Debug)]
pub enum Piece {
    /// The directions v cos t + w sin t, 0 ≤ t ≤ length, of a great circle.
    Great {
        /// The start of the arc, a unit vector.
        v: DVec3,
        /// The direction of travel at the start, a unit vector at a right angle to `v`.
        w: DVec3,
        /// The length of the arc in radians.
        length: f64,
    },
    /// The directions of the cap's circle at the angles between `from` and `to`, as in [`Cap::on_circle`].
    Circle {
        /// The first angle, in radians.
        from: f64,
        /// The last angle, in radians, which is larger than `from`.
        to: f64,
    },
}

/// Computes the border of the intersection of a polygon and a cap. Consecutive pieces in the list need not be
/// adjacent on the border.
pub fn common(corners: &[Corner], cap: &Cap) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let covered = cap.covers(corners);
    if covered == CapCoverage::None {
        return pieces;
    }
    for (i, v) in corners.iter().enumerate() {
        let next = corners[if i + 1 == corners.len() { 0 } else { i + 1 }].at;
        let way = v.border.cross(v.at);
        let length = libm::atan2(v.at.cross(next).length(), v.at.dot(next));
        let (mut from, mut to) = (0.0, length);
        if covered == CapCoverage::Part {
            // The inside of a cap is one stretch of the great circle between two crossings, at most half a
            // turn long.
            let Some([p, q]) = crossing(v.border, 0.0, cap.axis, cap.cosine) else {
                continue;
            };
            let angle = |p: DVec3| libm::atan2(way.dot(p), v.at.dot(p));
            let (one, two) = (angle(p), angle(q));
            let middle = libm::atan2(way.dot(cap.axis), v.at.dot(cap.axis));
            // The angles from the middle to the next crossing, and from the previous crossing to the middle.
            let past = |t: f64| (t - middle).rem_euclid(TAU);
            let after = past(one).min(past(two));
            let before = TAU - past(one).max(past(two));
            let middle = if middle + after < 0.0 {
                middle + TAU
            } else {
                middle
            };
            (from, to) = (
                f64::max(middle - before, 0.0),
                f64::min(middle + after, length),
            );
        }
        if to > from {
            let (sin, cos) = libm::sincos(from);
            let (v, w) = (v.at * cos + way * sin, way * cos - v.at * sin);
            pieces.push(Piece::Great {
                v,
                w,
                length: to - from,
            });
        }
    }
    if covered == CapCoverage::Part {
        pieces.extend(
            circle(corners, cap)
                .into_iter()
                .map(|[from, to]| Piece::Circle { from, to }),
        );
    }
    pieces
}

/// Computes the ranges of angles, in radians, in which the cap's circle lies inside the polygon.
fn circle(corners: &[Corner], cap: &Cap) -> Vec<[f64; 2]> {
    let (u, v) = cap.across();
    let mut cuts: Vec<f64> = Vec::new();
    for c in corners {
        let found = crossing(c.border, 0.0, cap.axis, cap.cosine);
        cuts.extend(
            found
                .into_iter()
                .flatten()
                .map(|p| libm::atan2(v.dot(p), u.dot(p)).rem_euclid(TAU)),
        );
    }
    cuts.sort_unstable_by(f64::total_cmp);
    let ends: Vec<[f64; 2]> = match (cuts.first(), cuts.last()) {
        (Some(first), Some(last)) => cuts
            .windows(2)
            .map(|w| [w[0], w[1]])
            .chain([[*last, first + TAU]])
            .collect(),
        _ => vec![[0.0, TAU]],
    };
    let inside = |[from, to]: &[f64; 2]| {
        let at = cap.on_circle(u, v, 0.5 * (from + to));
        corners.iter().all(|c| c.border.dot(at) > 0.0)
    };
    ends.into_iter()
        .filter(|e| e[1] > e[0])
        .filter(inside)
        .collect()
}

/// Computes a polygon that approximates the intersection of a polygon and a cap. The result contains
/// directions on the border in order, at most `step` radians apart on the cap's circle.
pub fn outline(corners: &[Corner], cap: &Cap, step: f64) -> Vec<DVec3> {
    let (u, v) = cap.across();
    let mut points = Vec::new();
    for piece in common(corners, cap) {
        match piece {
            Piece::Great { v, w, length } => {
                let (sin, cos) = libm::sincos(length);
                points.extend([v, v * cos + w * sin]);
            }
            Piece::Circle { from, to } => {
                let n = ((to - from) / step).ceil().max(1.0) as u32;
                let at = |k: u32| from + (to - from) * f64::from(k) / f64::from(n);
                points.extend((0..=n).map(|k| cap.on_circle(u, v, at(k))));
            }
        }
    }
    // An intersection of convex sets is convex, so its border turns once around its middle.
    let middle = points.iter().sum::<DVec3>().normalize_or(cap.axis);
    let (u, v) = middle.any_orthonormal_pair();
    let (u, v) = if u.cross(v).dot(middle) > 0.0 {
        (u, v)
    } else {
        (v, u)
    };
    let mut turned: Vec<(f64, DVec3)> = points
        .into_iter()
        .map(|p| (libm::atan2(v.dot(p), u.dot(p)), p))
        .collect();
    turned.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    turned.dedup_by(|a, b| (a.1 - b.1).length_squared() < 1e-24);
    turned.into_iter().map(|(_, p)| p).collect()
}
