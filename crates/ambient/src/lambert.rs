//! Lambert's formula: the cosine-weighted area of a polygon on the sphere of directions, and of the part of a
//! polygon outside spherical caps (Apostu et al., "Analytic Ambient Occlusion using Exact from-Polygon
//! Visibility", equation 2).
//!
//! By Stokes' theorem ∫ ω dω = ½ ∮ r × dr along the border. An arc of a great circle adds half its angle
//! times the unit normal of its plane. An arc of a circle about an axis has a closed form, too. So the circle
//! of directions in which a plane is at a given distance is integrated exactly (section 4.3 of the paper),
//! and not by chords.

use std::f64::consts::TAU;

use glam::DVec3;

use crate::polygon::Corner;

/// A spherical cap: the directions ω with axis·ω > cosine. In these directions, a plane is nearer to the
/// point than a distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cap {
    /// The unit vector from the point towards the plane, at a right angle to the plane.
    pub axis: DVec3,
    /// The cosine of the cap's angular radius: the height of the point over the plane, divided by the
    /// distance. Above 0 and below 1.
    pub cosine: f64,
}

/// The position of a polygon with respect to a cap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CapCoverage {
    /// The polygon lies in the cap.
    All,
    /// The polygon and the cap are disjoint.
    None,
    /// The polygon may lie partly in the cap.
    Part,
}

/// Computes the angle between two vectors from the length of their cross product and their dot product, in
/// radians.
fn angle(cross: f64, dot: f64) -> f64 {
    libm::atan2(cross, dot)
}

/// Computes 2π times the contribution to [`cosine`] of an arc of a great circle from `v` to `w`.
fn arc(n: DVec3, v: DVec3, w: DVec3) -> f64 {
    let c = v.cross(w);
    let size = c.length();
    if size > 0.0 {
        n.dot(c) * (angle(size, v.dot(w)) / size)
    } else {
        0.0
    }
}

/// Computes the area of a polygon, weighted by the cosine of the angle to the unit normal `n` and divided by
/// π. The result is 1 for the hemisphere over `n`, and 0 for a polygon of fewer than three corners.
pub fn cosine(n: DVec3, corners: &[Corner]) -> f64 {
    let [.., last] = corners else { return 0.0 };
    let mut v = last.at;
    let mut sum = 0.0;
    for w in corners {
        sum += arc(n, v, w.at);
        v = w.at;
    }
    sum / TAU
}

impl Cap {
    /// Returns the position of a convex polygon with respect to the cap.
    pub fn covers(&self, corners: &[Corner]) -> CapCoverage {
        let inside = corners
            .iter()
            .filter(|v| self.axis.dot(v.at) >= self.cosine)
            .count();
        // A cap is convex, so a cap that contains all corners of a polygon contains the polygon.
        if inside == corners.len() {
            return CapCoverage::All;
        }
        if inside > 0 {
            return CapCoverage::Part;
        }
        let mut centred = true;
        let limit = 1.0 - self.cosine * self.cosine;
        for (i, v) in corners.iter().enumerate() {
            let height = v.border.dot(self.axis);
            centred &= height >= 0.0;
            // The direction of the border's great circle nearest to the axis has the cosine √(1 − height²).
            if height * height < limit {
                let near = self.axis - v.border * height;
                let w = corners[if i + 1 == corners.len() { 0 } else { i + 1 }].at;
                if v.at.cross(near).dot(v.border) >= 0.0 && near.cross(w).dot(v.border) >= 0.0 {
                    return CapCoverage::Part;
                }
            }
        }
        if centred {
            CapCoverage::Part
        } else {
            CapCoverage::None
        }
    }

    /// Returns true if the cap contains another cap, except for a border narrower than `slack` radians.
    pub fn holds(&self, other: &Self, slack: f64) -> bool {
        let between = angle(
            self.axis.cross(other.axis).length(),
            self.axis.dot(other.axis),
        );
        between + libm::acos(other.cosine) <= libm::acos(self.cosine) + slack
    }

    /// Returns the sine of the cap's angular radius.
    pub fn sine(&self) -> f64 {
        ((1.0 - self.cosine) * (1.0 + self.cosine)).sqrt()
    }

    /// Returns the direction on the cap's circle at an angle, in radians, from `u` towards `v`.
    /// [`Cap::across`] returns `u` and `v`.
    pub fn on_circle(&self, u: DVec3, v: DVec3, angle: f64) -> DVec3 {
        let (sin, cos) = libm::sincos(angle);
        self.axis * self.cosine + (u * cos + v * sin) * self.sine()
    }

    /// Returns two unit vectors u and v at right angles to the axis, so that (u, v, axis) is right-handed.
    pub fn across(&self) -> (DVec3, DVec3) {
        let (u, v) = self.axis.any_orthonormal_pair();
        if u.cross(v).dot(self.axis) > 0.0 {
            (u, v)
        } else {
            (v, u)
        }
    }
}

/// The relative distance from a tangency below which two circles count as not crossing. The distance is
/// relative to the smaller squared radius. The area that two such circles cut off each other is less than the
/// power 3/2 of this constant.
const TANGENT: f64 = 1e-10;

/// Computes the directions p with a·p = `at_a` and b·p = `at_b`, for unit vectors a and b: the crossings of
/// two circles.
///
/// Both circles use the same two crossings, so a border that leaves one circle continues along the other
/// circle from the same direction. Near a tangency, angles that are computed for each circle separately
/// differ by the root of a rounding error. Returns `None` if the circles do not cross.
pub fn crossing(a: DVec3, at_a: f64, b: DVec3, at_b: f64) -> Option<[DVec3; 2]> {
    let across = a.cross(b);
    let size = across.length_squared();
    // p = along + across t, where along lies in the plane of a and b: x a + y b with x + g y = at_a and g x +
    // y = at_b.
    let g = a.dot(b);
    let along = (a * (at_a - g * at_b) + b * (at_b - g * at_a)) / size;
    let rest = 1.0 - along.length_squared();
    let least = TANGENT * f64::min(1.0 - at_a * at_a, 1.0 - at_b * at_b);
    if !(size > 0.0 && rest > least) {
        return None;
    }
    let reach = across * (rest / size).sqrt();
    Some([along - reach, along + reach])
}

/// Returns an angle plus a multiple of 2π, so that the sum is at least 0 and less than 2π.
fn turned(t: f64) -> f64 {
    let t = t.rem_euclid(TAU);
    if t < TAU { t } else { 0.0 }
}

/// Computes [`cosine`] of the part of a convex polygon outside all `caps`. No cap may contain or equal
/// another cap. `scratch` is reused memory.
pub fn cosine_without(n: DVec3, corners: &[Corner], caps: &[Cap], scratch: &mut Vec<f64>) -> f64 {
    let whole = cosine(n, corners);
    if caps.is_empty() {
        return whole;
    }
    let mut sum = 0.0;
    for (i, v) in corners.iter().enumerate() {
        let w = corners[if i + 1 == corners.len() { 0 } else { i + 1 }].at;
        let length = angle(v.at.cross(w).length(), v.at.dot(w));
        sum += n.dot(v.border) * outside(v, length, caps, scratch);
    }
    for k in 0..caps.len() {
        sum -= border(n, corners, caps, k, scratch);
    }
    // If a circle touches a border, the sum over borders or the sum over circles may count an arc that the
    // other sum misses.
    (sum / TAU).clamp(0.0, whole.max(0.0))
}

/// Computes the length, in radians, of the part of a border outside all caps. The border starts at `corner`
/// and is `length` radians long.
fn outside(corner: &Corner, length: f64, caps: &[Cap], cuts: &mut Vec<f64>) -> f64 {
    let (v, w) = (corner.at, corner.border.cross(corner.at));
    cuts.clear();
    for cap in caps {
        for p in crossing(corner.border, 0.0, cap.axis, cap.cosine)
            .into_iter()
            .flatten()
        {
            let t = turned(libm::atan2(w.dot(p), v.dot(p)));
            if t < length {
                cuts.push(t);
            }
        }
    }
    cuts.sort_unstable_by(f64::total_cmp);
    let mut from = 0.0;
    let mut sum = 0.0;
    for to in cuts.iter().copied().chain([length]) {
        let (sin, cos) = libm::sincos(0.5 * (from + to));
        let middle = v * cos + w * sin;
        if caps.iter().all(|cap| cap.axis.dot(middle) < cap.cosine) {
            sum += to - from;
        }
        from = to;
    }
    sum
}

/// Computes 2π times the contribution to [`cosine_without`] of the arcs of cap `k`'s circle that are inside
/// the polygon and outside the other caps. The circle runs counter-clockwise about its axis.
fn border(n: DVec3, corners: &[Corner], caps: &[Cap], k: usize, cuts: &mut Vec<f64>) -> f64 {
    let cap = caps[k];
    let (u, v) = cap.across();
    let (cos_a, sin_a) = (cap.cosine, cap.sine());
    let edges = || corners.iter().map(|c| c.border);
    let others = || caps.iter().enumerate().filter(|(j, _)| *j != k);
    cuts.clear();
    let mut cut = |p: DVec3| cuts.push(turned(libm::atan2(v.dot(p), u.dot(p))));
    for m in edges() {
        crossing(m, 0.0, cap.axis, cap.cosine)
            .into_iter()
            .flatten()
            .for_each(&mut cut);
    }
    for (j, other) in others() {
        // Use the same order for both caps of a pair, so that both get the same crossings.
        let (one, two) = if j < k { (other, &cap) } else { (&cap, other) };
        crossing(one.axis, one.cosine, two.axis, two.cosine)
            .into_iter()
            .flatten()
            .for_each(&mut cut);
    }
    cuts.sort_unstable_by(f64::total_cmp);
    // The first arc extends from the last cut around to the first cut.
    let mut from = cuts.last().map_or(0.0, |t| t - TAU);
    if cuts.is_empty() {
        cuts.push(TAU);
    }
    let mut sum = 0.0;
    for to in cuts.iter().copied() {
        let (sin, cos) = libm::sincos(0.5 * (from + to));
        let middle = cap.axis * cos_a + (u * cos + v * sin) * sin_a;
        if edges().all(|m| m.dot(middle) > 0.0)
            && others().all(|(_, other)| other.axis.dot(middle) < other.cosine)
        {
            // ∫ r × dr = axis sin²a Δt − cos a sin a (u Δsin − v Δcos).
            let half = 0.5 * (to - from);
            let swing = 2.0 * libm::sin(half) * cos_a * sin_a;
            sum += n.dot(cap.axis) * sin_a * sin_a * (to - from) - n.dot(u * cos + v * sin) * swing;
        }
        from = to;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::polygon::polygon;

    fn quadrants() -> [Vec<Corner>; 4] {
        let at = [DVec3::X, DVec3::Y, DVec3::NEG_X, DVec3::NEG_Y];
        std::array::from_fn(|i| polygon(&[DVec3::Z, at[i], at[(i + 1) % 4]]))
    }

    #[test]
    fn hemisphere_has_area_one() {
        let sum: f64 = quadrants().iter().map(|q| cosine(DVec3::Z, q)).sum();
        assert!((sum - 1.0).abs() < 1e-15, "{sum}");
    }

    #[test]
    fn cap_about_normal_removes_sine_squared() {
        let mut scratch = Vec::new();
        for cosine in [0.1, 0.5, 0.9, 0.999] {
            let caps = [Cap {
                axis: DVec3::Z,
                cosine,
            }];
            let left: f64 = quadrants()
                .iter()
                .map(|q| cosine_without(DVec3::Z, q, &caps, &mut scratch))
                .sum();
            assert!((left - cosine * cosine).abs() < 1e-14, "{left} {cosine}");
        }
    }

    /// Compares caps at various positions, also beyond the horizon and overlapping, with a sum over many
    /// small cells.
    #[test]
    fn cap_integrals_match_sum_over_cells() {
        let caps = [
            Cap {
                axis: DVec3::new(0.6, 0.0, 0.8),
                cosine: 0.8,
            },
            Cap {
                axis: DVec3::new(0.0, 0.8, 0.6),
                cosine: 0.7,
            },
            Cap {
                axis: DVec3::new(1.0, 0.0, 0.0),
                cosine: 0.6,
            },
        ];
        let mut scratch = Vec::new();
        let exact: f64 = quadrants()
            .iter()
            .map(|q| cosine_without(DVec3::Z, q, &caps, &mut scratch))
            .sum();
        let (steps, mut sum) = (2000, 0.0);
        for i in 0..steps {
            // Cells of equal size in sin²θ and φ have equal cosine-weighted areas.
            let s = (f64::from(i) + 0.5) / f64::from(steps);
            let (sin, cos) = (s.sqrt(), (1.0 - s).sqrt());
            for j in 0..steps {
                let (y, x) = ((f64::from(j) + 0.5) / f64::from(steps) * TAU).sin_cos();
                let ray = DVec3::new(sin * x, sin * y, cos);
                sum += f64::from(u8::from(caps.iter().all(|c| c.axis.dot(ray) < c.cosine)));
            }
        }
        let sampled = sum / f64::from(steps * steps);
        assert!((exact - sampled).abs() < 2e-5, "{exact} {sampled}");
    }

    #[test]
    fn cap_covers_all_part_or_none_of_polygon() {
        let octant = polygon(&[DVec3::Z, DVec3::X, DVec3::Y]);
        let cap = |axis: [f64; 3], cosine| Cap {
            axis: DVec3::from(axis).normalize(),
            cosine,
        };
        assert_eq!(cap([1.0, 1.0, 1.0], 0.9).covers(&octant), CapCoverage::Part);
        assert_eq!(cap([1.0, 1.0, 1.0], 0.5).covers(&octant), CapCoverage::All);
        assert_eq!(
            cap([1.0, 1.0, -1.0], 0.99).covers(&octant),
            CapCoverage::None
        );
        assert_eq!(
            cap([1.0, 1.0, -0.1], 0.99).covers(&octant),
            CapCoverage::Part
        );
        assert_eq!(
            cap([-1.0, -1.0, -1.0], 0.1).covers(&octant),
            CapCoverage::None
        );
    }
}
