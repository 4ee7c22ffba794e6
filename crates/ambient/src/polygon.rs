//! Convex polygons on the sphere of directions, bounded by great circles, and their division by planes through the
//! point.
//!
//! A polygon is the list of its corners, unit vectors in the order in which they turn to the left as seen from outside
//! of the sphere, so that (vᵢ × vᵢ₊₁)·ω ≥ 0 for all directions ω inside.

use glam::DVec3;

/// A plane through the point: the directions ω with m·ω = 0. `m` is not of unit length.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// The normal; the positive side is the inner one.
    pub m: DVec3,
    /// Bound on the error of m·v for a unit vector v.
    pub error: f64,
}

impl Plane {
    /// Bound on the cosine-weighted area, divided by π, that the plane's error can move from one side to the other.
    ///
    /// The true plane differs by an angle of at most error / |m|, so the two differ by strips of at most that width
    /// along half a great circle, whose cosine-weighted area is at most twice the width.
    pub fn uncertain(&self) -> f64 {
        let size = self.m.length();
        if size > self.error { std::f64::consts::FRAC_2_PI * self.error / size } else { 1.0 }
    }
}

/// Where a polygon lies with respect to a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// On the positive side; `true` if it is so only within the plane's error.
    Inside(bool),
    /// On the negative side, likewise.
    Outside(bool),
    /// On both.
    Both,
}

/// On which side of the plane the polygon lies. `values` gets m·v for its corners.
pub fn side(plane: &Plane, corners: &[DVec3], values: &mut Vec<f64>) -> Side {
    values.clear();
    values.extend(corners.iter().map(|v| plane.m.dot(*v)));
    let (least, most) =
        values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), d| (l.min(*d), m.max(*d)));
    let e = plane.error;
    if least >= -e && (most > e || most >= -least) {
        Side::Inside(least <= e)
    } else if most <= e {
        Side::Outside(most >= -e)
    } else {
        Side::Both
    }
}

/// Divides a polygon that lies on both sides. Corners within the plane's error of it belong to both parts. A part may
/// have fewer than three corners, and then has no area.
pub fn split(
    plane: &Plane,
    corners: &[DVec3],
    values: &[f64],
    inside: &mut Vec<DVec3>,
    outside: &mut Vec<DVec3>,
) {
    let e = plane.error;
    let (mut v, mut d) = match (corners.last(), values.last()) {
        (Some(v), Some(d)) => (*v, *d),
        _ => return,
    };
    for (w, f) in corners.iter().zip(values) {
        if (d > e && *f < -e) || (d < -e && *f > e) {
            // The point of the arc from v to w on the plane.
            let cut = (v * f.abs() + *w * d.abs()).normalize();
            inside.push(cut);
            outside.push(cut);
        }
        if *f >= -e {
            inside.push(*w);
        }
        if *f <= e {
            outside.push(*w);
        }
        (v, d) = (*w, *f);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::lambert::cosine;

    proptest! {
        /// The two parts of an octant have the area of the whole, and each lies on its side.
        #[test]
        fn parts_add_up(m in prop::array::uniform3(-1.0f64..1.0)) {
            let plane = Plane { m: DVec3::from(m), error: 1e-15 };
            prop_assume!(plane.m.length() > 1e-3);
            let octant = [DVec3::Z, DVec3::X, DVec3::Y];
            let (mut values, mut parts) = (Vec::new(), (Vec::new(), Vec::new()));
            if side(&plane, &octant, &mut values) == Side::Both {
                split(&plane, &octant, &values, &mut parts.0, &mut parts.1);
                prop_assert!(parts.0.iter().all(|v| plane.m.dot(*v) > -1e-14));
                prop_assert!(parts.1.iter().all(|v| plane.m.dot(*v) < 1e-14));
                let sum = cosine(DVec3::Z, &parts.0) + cosine(DVec3::Z, &parts.1);
                prop_assert!((sum - 0.25).abs() < 1e-14, "{sum}");
            }
        }
    }
}
