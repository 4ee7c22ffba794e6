//! Convex sets of points, and their extents along vectors.

use glam::DVec3;

/// A convex set: the hull of corners, or a box.
#[derive(Clone, Copy, Debug)]
pub enum Hull<'a> {
    /// The convex hull of these corners.
    Of(&'a [DVec3]),
    /// A box: its middle and half its size.
    Box(DVec3, DVec3),
}

impl Hull<'_> {
    /// Returns the minimum and the maximum of m·p over the points p of the set.
    pub fn extent(&self, m: DVec3) -> (f64, f64) {
        let ([least], [most]) = self.extents(&[[m.x], [m.y], [m.z]]);
        (least, most)
    }

    /// Returns the minima and maxima of m·p for `N` vectors m. `m` contains the x, y and z coordinates of
    /// these vectors.
    #[inline]
    pub fn extents<const N: usize>(&self, m: &[[f64; N]; 3]) -> ([f64; N], [f64; N]) {
        let along = |p: &DVec3, lane: usize| m[0][lane] * p.x + m[1][lane] * p.y + m[2][lane] * p.z;
        let (mut least, mut most) = ([f64::INFINITY; N], [f64::NEG_INFINITY; N]);
        match self {
            Self::Of(corners) => {
                for c in *corners {
                    for k in 0..N {
                        let value = along(c, k);
                        least[k] = if value < least[k] { value } else { least[k] };
                        most[k] = if value > most[k] { value } else { most[k] };
                    }
                }
            }
            Self::Box(middle, half) => {
                for k in 0..N {
                    let value = along(middle, k);
                    let reach =
                        m[0][k].abs() * half.x + m[1][k].abs() * half.y + m[2][k].abs() * half.z;
                    (least[k], most[k]) = (value - reach, value + reach);
                }
            }
        }
        (least, most)
    }
}
