//! Convex polygons on the sphere of directions of a point, bounded by great circles, and their division by
//! planes through the point.
//!
//! A polygon is the list of its corners, counter-clockwise as seen from outside the sphere. Each corner
//! stores the plane of the border that starts at the corner. So a border stores the exact direction of the
//! plane that cut the polygon; a plane that is computed from two near corners would differ.

use std::f64::consts::PI;

use glam::DVec3;

/// A corner of a polygon.
#[derive(Clone, Copy, Debug)]
pub struct Corner {
    /// The direction of the corner, a unit vector.
    pub at: DVec3,
    /// The unit normal of the plane of the border from this corner to the next corner. The normal points to
    /// the inside of the polygon.
    pub border: DVec3,
}

/// Creates the polygon with these corners, which are unit vectors in counter-clockwise order. No corner may
/// be on the border between its neighbours. Omits a corner that equals the next corner up to rounding.
pub fn polygon(corners: &[DVec3]) -> Vec<Corner> {
    let n = corners.len();
    let next = |i: usize| corners[if i + 1 == n { 0 } else { i + 1 }];
    let corner = |i: usize| {
        let border = corners[i].cross(next(i)).try_normalize()?;
        Some(Corner {
            at: corners[i],
            border,
        })
    };
    (0..n).filter_map(corner).collect()
}

/// A plane through the point: the directions ω with m·ω = 0. `m` can have any length.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// The normal, which points to the inner side. The inner side is the positive side.
    pub m: DVec3,
    /// A bound on the error of m·v for a unit vector v.
    pub error: f64,
}

impl Plane {
    /// Bounds the cosine-weighted area, divided by π, that the plane's error can move between the sides of a
    /// polygon.
    ///
    /// The true plane differs by an angle of at most error / |m|. So the two planes differ within the polygon
    /// by strips of at most that width. A strip is at most as long as half of the polygon's border, and this
    /// half is at most twice as long as the polygon's extent. The area is also at most the area of the
    /// polygon.
    pub fn uncertain(&self, corners: &[Corner]) -> f64 {
        let Some(first) = corners.first() else {
            return 0.0;
        };
        let extent = corners.iter().fold(0.0f64, |most, v| {
            most.max((v.at - first.at).abs().element_sum())
        });
        let size = self.m.length();
        let strip = if size > self.error {
            (2.0 * extent).min(PI) * self.error / (size * PI)
        } else {
            1.0
        };
        // Avoid the polygon's area if possible, because it is more expensive to compute.
        if strip < LITTLE {
            strip
        } else {
            strip.min(most_area(corners))
        }
    }
}

/// The area of a strip, divided by π, below which [`Plane::uncertain`] does not compute the polygon's area.
const LITTLE: f64 = 1e-13;

/// Bounds the area, divided by π, of a polygon of at most a quarter of the sphere. The bound is the sum over
/// the triangles of a fan from the first corner, on the planes through their corners.
fn most_area(corners: &[Corner]) -> f64 {
    let [first, rest @ ..] = corners else {
        return 0.0;
    };
    let fan = rest.windows(2).map(|w| {
        let (p, q) = (w[0].at - first.at, w[1].at - first.at);
        // A spherical triangle within a quarter of the sphere has less than 3 times the area of its flat
        // triangle.
        p.cross(q).length() * 0.5 * 3.0
    });
    // The constant covers the rounding errors of the products.
    fan.sum::<f64>() / PI + 1e-15
}

/// The position of a polygon with respect to a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The polygon is on the positive side. The flag is true if a corner is within the plane's error.
    Inside(bool),
    /// The polygon is on the negative side. The flag is true if a corner is within the plane's error.
    Outside(bool),
    /// The polygon is on both sides of the plane.
    Both,
}

/// Returns the side of the plane on which the polygon lies. Stores the products of `plane.m` and the corners
/// in `values`.
pub fn side(plane: &Plane, corners: &[Corner], values: &mut Vec<f64>) -> Side {
    values.clear();
    values.extend(corners.iter().map(|v| plane.m.dot(v.at)));
    let (least, most) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), d| {
            (l.min(*d), m.max(*d))
        });
    let e = plane.error;
    if least >= -e && (most > e || most >= -least) {
        Side::Inside(least <= e)
    } else if most <= e {
        Side::Outside(most >= -e)
    } else {
        Side::Both
    }
}

/// Divides a polygon that lies on both sides of a plane, and appends the corners of the two parts to `inside`
/// and `outside`. `values` are the products that [`side`] stored.
///
/// Corners within the plane's error belong to both parts. A part with fewer than three corners has no area.
pub fn split(
    plane: &Plane,
    corners: &[Corner],
    values: &[f64],
    inside: &mut Vec<Corner>,
    outside: &mut Vec<Corner>,
) {
    let e = plane.error;
    let cut = plane.m.normalize();
    for (i, (v, d)) in corners.iter().zip(values).enumerate() {
        let next = if i + 1 == corners.len() { 0 } else { i + 1 };
        let (w, f) = (&corners[next], values[next]);
        if *d >= -e {
            let leaves = *d <= e && f < -e;
            inside.push(if leaves {
                Corner { border: cut, ..*v }
            } else {
                *v
            });
        }
        if *d <= e {
            let leaves = *d >= -e && f > e;
            outside.push(if leaves {
                Corner { border: -cut, ..*v }
            } else {
                *v
            });
        }
        if (*d > e && f < -e) || (*d < -e && f > e) {
            // The direction at which the plane divides the border from v to w.
            let at = (v.at * f.abs() + w.at * d.abs()).normalize();
            let (along, across) = (
                Corner {
                    at,
                    border: v.border,
                },
                |border| Corner { at, border },
            );
            if *d > e {
                inside.push(across(cut));
                outside.push(along);
            } else {
                inside.push(along);
                outside.push(across(-cut));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::lambert::cosine;

    proptest! {
        /// The two parts of an octant have the area of the whole octant, and each lies on its side.
        #[test]
        fn parts_add_up(m in prop::array::uniform3(-1.0f64..1.0)) {
            let plane = Plane { m: DVec3::from(m), error: 1e-15 };
            prop_assume!(plane.m.length() > 1e-3);
            let octant = polygon(&[DVec3::Z, DVec3::X, DVec3::Y]);
            let (mut values, mut parts) = (Vec::new(), (Vec::new(), Vec::new()));
            if side(&plane, &octant, &mut values) == Side::Both {
                split(&plane, &octant, &values, &mut parts.0, &mut parts.1);
                prop_assert!(parts.0.iter().all(|v| plane.m.dot(v.at) > -1e-14));
                prop_assert!(parts.1.iter().all(|v| plane.m.dot(v.at) < 1e-14));
                let sum = cosine(DVec3::Z, &parts.0) + cosine(DVec3::Z, &parts.1);
                prop_assert!((sum - 0.25).abs() < 1e-14, "{sum}");
            }
        }
    }
}
