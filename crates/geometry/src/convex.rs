//! Flat convex polygons with corners in single precision, the shape of area lights.
//!
//! The client, the coordinator and the solver use the same check, so that all three accept the same lights.

use glam::DVec3;

/// The maximum number of corners of a polygon.
pub const MOST_CORNERS: usize = 1024;

/// The reason why corners do not form a flat convex polygon.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConvexError {
    /// The number of corners is below 3 or above [`MOST_CORNERS`].
    #[error("the polygon has {0} corners; give a convex polygon of 3 to {MOST_CORNERS} corners")]
    Corners(usize),
    /// A coordinate of the corner with this index, from 0, is not finite in single precision.
    #[error("corner {0} is not finite; give three coordinates with magnitudes below 3·10³⁸")]
    NotFinite(usize),
    /// The corners lie on one line or are equal.
    #[error("the polygon has no area; give corners that do not all lie on one line")]
    Flat,
    /// The corner with this index, from 0, is off the plane of the other corners.
    #[error(
        "corner {0} is not in the plane of the other corners; divide the polygon into flat polygons"
    )]
    Bent(usize),
    /// The border turns to the wrong side at the corner with this index, from 0. The index is also 0 if the
    /// border goes around the polygon more than once.
    #[error(
        "the polygon is not convex at corner {0}; divide it into convex polygons, and list the corners of \
         each in order"
    )]
    NotConvex(usize),
}

/// A flat convex polygon whose corners are rounded to single precision.
#[derive(Clone, Debug, PartialEq)]
pub struct Convex {
    corners: Vec<DVec3>,
    normal: DVec3,
    slack: f64,
}

impl Convex {
    /// Creates a polygon from its corners in order, and rounds them to single precision.
    ///
    /// # Errors
    /// [`ConvexError`] if the corners do not form a flat convex polygon.
    pub fn new(corners: &[[f64; 3]]) -> Result<Self, ConvexError> {
        if !(3..=MOST_CORNERS).contains(&corners.len()) {
            return Err(ConvexError::Corners(corners.len()));
        }
        let corners: Vec<DVec3> = corners
            .iter()
            .map(|c| DVec3::from(*c).as_vec3().as_dvec3())
            .collect();
        if let Some(k) = corners.iter().position(|c| !c.is_finite()) {
            return Err(ConvexError::NotFinite(k));
        }
        let n = corners.len();
        let area: DVec3 = (1..n - 1)
            .map(|k| (corners[k] - corners[0]).cross(corners[k + 1] - corners[0]))
            .sum();
        // The coordinates of the polygon and of a scene have errors of half a unit in the last place of
        // single precision.
        let most = corners
            .iter()
            .fold(0.0f64, |m, c| m.max(c.abs().max_element()));
        let slack = 4.0 * f64::from(f32::EPSILON) * most;
        let Some(normal) = area.try_normalize() else {
            return Err(ConvexError::Flat);
        };
        if let Some(k) = corners
            .iter()
            .position(|c| normal.dot(*c - corners[0]).abs() > slack)
        {
            return Err(ConvexError::Bent(k));
        }
        let mut turns = 0.0;
        for k in 0..n {
            let (a, b, c) = (corners[(k + n - 1) % n], corners[k], corners[(k + 1) % n]);
            let (p, q) = (b - a, c - b);
            let turn = normal.dot(p.cross(q));
            // A corner that is off by the slack turns an edge by slack / length.
            if turn < -slack * (p.length() + q.length())
                || p == DVec3::ZERO
                || (turn <= 0.0 && p.dot(q) < 0.0)
            {
                return Err(ConvexError::NotConvex(k));
            }
            turns += libm::atan2(turn, p.dot(q));
        }
        if turns > 3.0 * std::f64::consts::PI {
            return Err(ConvexError::NotConvex(0));
        }
        Ok(Self {
            corners,
            normal,
            slack,
        })
    }

    /// Returns the corners in order, rounded to single precision.
    pub fn corners(&self) -> &[DVec3] {
        &self.corners
    }

    /// Returns the unit normal. Viewed from the side to which the normal points, the corners run
    /// counter-clockwise.
    pub fn normal(&self) -> DVec3 {
        self.normal
    }

    /// Returns the maximum distance of a corner from the polygon's plane, in units of the scene.
    ///
    /// The rounding of corners to single precision causes this distance. The corners of a scene are rounded
    /// in the same way.
    pub fn slack(&self) -> f64 {
        self.slack
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use super::*;

    /// Returns `n` corners on a circle in a plane that is not aligned with the axes.
    ///
    /// The angle from each corner to the next is `step` of `n` parts of the circle.
    fn ring(n: usize, step: usize) -> Vec<[f64; 3]> {
        let at = |k: usize| {
            let angle = std::f64::consts::TAU * (k * step) as f64 / n as f64;
            let (s, c) = (libm::sin(angle), libm::cos(angle));
            [7.0 + c, s - 2.0, 3.0 + 0.5 * c - 0.25 * s]
        };
        (0..n).map(at).collect()
    }

    #[test]
    fn convex_accepts_rings_and_rejects_other_shapes() {
        for n in [3, 4, 5, 64] {
            let convex = Convex::new(&ring(n, 1)).unwrap();
            assert_eq!(convex.corners().len(), n);
            let mut back = ring(n, 1);
            back.reverse();
            assert!(convex.normal().dot(Convex::new(&back).unwrap().normal()) < -0.999_999);
        }
        let refused = |corners: &[[f64; 3]]| Convex::new(corners).unwrap_err();
        // A star turns to the left at every corner, and goes around twice.
        assert_eq!(refused(&ring(5, 2)), ConvexError::NotConvex(0));
        let mut dented = ring(5, 1);
        dented[2] = [7.0, -2.0, 3.0];
        assert_eq!(refused(&dented), ConvexError::NotConvex(2));
        let mut bent = ring(5, 1);
        bent[3][2] += 0.1;
        assert!(matches!(refused(&bent), ConvexError::Bent(_)));
        let mut twice = ring(4, 1);
        twice[1] = twice[0];
        assert!(matches!(refused(&twice), ConvexError::NotConvex(_)));
        assert_eq!(
            refused(&[[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]),
            ConvexError::Flat
        );
        assert_eq!(refused(&ring(2, 1)), ConvexError::Corners(2));
        assert_eq!(refused(&ring(1025, 1)), ConvexError::Corners(1025));
        for far in [f64::NAN, f64::INFINITY, 1e39] {
            let mut corners = ring(3, 1);
            corners[1][0] = far;
            assert_eq!(refused(&corners), ConvexError::NotFinite(1));
        }
    }
}
