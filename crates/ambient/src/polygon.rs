//! Convex polygons on the sphere of directions, bounded by great circles, and their division by planes
//! through the point.
//!
//! A polygon is the list of its corners in the order in which they turn to the left as seen from outside of
//! the sphere. Each corner has the plane of the border that starts there, so that a border keeps the
//! direction of the plane that cut it however short it gets: the planes through two near corners would not be
//! the same.

use std::f64::consts::PI;

use glam::DVec3;

/// A corner of a polygon.
#[derive(Clone, Copy, Debug)]
pub struct Corner {
    /// Its direction, of unit length.
    pub at: DVec3,
    /// The plane of the border from here to the next corner: a unit normal, positive inside.
    pub border: DVec3,
}

/// The polygon of some corners, none of which is on the border between its neighbours. Corners that are the
/// next one but for rounding are left out.
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

/// A plane through the point: the directions ω with m·ω = 0. `m` is not of unit length.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// The normal; the positive side is the inner one.
    pub m: DVec3,
    /// Bound on the error of m·v for a unit vector v.
    pub error: f64,
}

impl Plane {
    /// Bound on the cosine-weighted area, divided by π, of a polygon's part that the plane's error can move
    /// from one side to the other.
    ///
    /// The true plane differs by an angle of at most error / |m|, so the two differ within the polygon by
    /// strips of at most that width, whose length is at most half of the polygon's outline and so twice its
    /// extent; and by no more than the polygon.
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
        // The area costs more to know.
        if strip < LITTLE {
            strip
        } else {
            strip.min(most_area(corners))
        }
    }
}

/// Strips of less area are not compared with the polygon's.
const LITTLE: f64 = 1e-13;

/// Bound on the area of a polygon of at most a quarter of the sphere, divided by π: that of the triangles of
/// a fan on the planes through their first corners, which stand over them.
fn most_area(corners: &[Corner]) -> f64 {
    let [first, rest @ ..] = corners else {
        return 0.0;
    };
    let fan = rest.windows(2).map(|w| {
        let (p, q) = (w[0].at - first.at, w[1].at - first.at);
        // A spherical triangle of a quarter of the sphere is less than 3 times as large as its flat one.
        p.cross(q).length() * 0.5 * 3.0
    });
    // What rounding hides from the products.
    fan.sum::<f64>() / PI + 1e-15
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

/// Divides a polygon that lies on both sides. Corners within the plane's error of it belong to both parts. A
/// part may have fewer than three corners, and then has no area.
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
            // The point of the border from v to w on the plane.
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
        /// The two parts of an octant have the area of the whole, and each lies on its side.
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
