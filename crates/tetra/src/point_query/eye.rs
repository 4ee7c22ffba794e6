//! A viewpoint and the vectors from the viewpoint to points, rounded and as integers.
//!
//! All coordinates are doubles, so all coordinates are integers times one power of two. The lowest bit of all
//! coordinates determines this power. Signs of polynomials whose terms have equal degree do not depend on the
//! power.

use dashu_int::IBig;
use glam::{DVec3, Vec3};
use sightline_geometry::predicates::{det3_small, differences, dyadic, orient3d_sign};
use sightline_geometry::rounding::UNIT as U;

use super::rounded::Rounded;

/// A vector of integers.
pub type IntegerVector = [IBig; 3];

/// A viewpoint, and the numbered points of the scene.
pub struct Eye<'a> {
    /// The viewpoint.
    pub x: [f64; 3],
    /// The points of the scene.
    points: &'a [[f32; 3]],
    /// The corners of target boxes. Their numbers follow the numbers of the scene's points.
    more: &'a [[f64; 3]],
    /// The exponent of the unit: all coordinates are multiples of 2 to this power.
    unit: i32,
}

impl<'a> Eye<'a> {
    /// Creates a viewpoint in a scene.
    ///
    /// `unit` is the exponent of a power of two that divides the scene's coordinates ([`unit_of`]).
    pub fn new(x: [f64; 3], points: &'a [[f32; 3]], more: &'a [[f64; 3]], unit: i32) -> Self {
        let unit = more
            .iter()
            .chain([&x])
            .fold(unit, |least, p| least.min(unit_of(p.iter().copied())));
        Self {
            x,
            points,
            more,
            unit,
        }
    }

    /// Returns a point by its number.
    #[inline]
    pub fn point(&self, number: u32) -> [f64; 3] {
        match self.points.get(number as usize) {
            Some(p) => p.map(f64::from),
            None => self.more[number as usize - self.points.len()],
        }
    }

    /// Returns the positions of three points of the scene, given by their numbers.
    #[inline]
    pub fn scene_points(&self, triangle: [u32; 3]) -> [[f32; 3]; 3] {
        triangle.map(|p| self.points[p as usize])
    }

    /// Returns the vector from the viewpoint to a point.
    #[inline]
    pub fn to(&self, number: u32) -> Rounded {
        Rounded::difference(self.point(number), self.x)
    }

    /// Returns the vector from point `a` to point `b`.
    #[inline]
    pub fn between(&self, a: u32, b: u32) -> Rounded {
        Rounded::difference(self.point(b), self.point(a))
    }

    /// Returns the sign of the determinant of the vectors from the viewpoint to three points.
    ///
    /// Returns `None` if the vectors do not fit in integers of fixed width.
    pub fn turn(&self, points: [u32; 3]) -> Option<i32> {
        let points = points.map(|p| DVec3::from(self.point(p)));
        let rows = differences(DVec3::from(self.x), points)?;
        det3_small(rows).map(|sign| sign as i32)
    }

    /// Returns true if a point is in the plane of a face, given by three point numbers.
    ///
    /// Returns `None` if one of the points is a corner of a target box.
    pub fn is_in_plane(&self, point: u32, face: [u32; 3]) -> Option<bool> {
        if face.contains(&point) {
            return Some(true);
        }
        let position_of = |p: u32| self.points.get(p as usize).map(|p| Vec3::from(*p));
        Some(
            orient3d_sign(
                position_of(face[0])?,
                position_of(face[1])?,
                position_of(face[2])?,
                position_of(point)?,
            )
            .is_eq(),
        )
    }

    /// Returns the vector from the viewpoint to a point, in integers.
    pub fn to_exactly(&self, number: u32) -> IntegerVector {
        self.apart_exactly(self.point(number), self.x)
    }

    /// Returns the vector from point `a` to point `b`, in integers.
    pub fn between_exactly(&self, a: u32, b: u32) -> IntegerVector {
        self.apart_exactly(self.point(b), self.point(a))
    }

    /// Returns p − q in integers.
    fn apart_exactly(&self, p: [f64; 3], q: [f64; 3]) -> IntegerVector {
        std::array::from_fn(|k| {
            let d = p[k] - q[k];
            // `rest` is the rounding error (Knuth's two-sum). If the error is 0, which is usual, one
            // conversion is sufficient.
            let back = d + q[k];
            let rest = (p[k] - back) - (q[k] - (back - d));
            if rest == 0.0 && d.is_finite() {
                self.whole(d)
            } else {
                self.whole(p[k]) - self.whole(q[k])
            }
        })
    }

    fn whole(&self, c: f64) -> IBig {
        let (mantissa, exponent) = dyadic(c);
        // The exponent of the number 0 can be smaller than the unit's exponent.
        let shift = (exponent - self.unit).max(0) as usize;
        // A mantissa has 53 bits, so a shift of up to 72 fits in an i128.
        if shift <= 72 {
            IBig::from(i128::from(mantissa) << shift)
        } else {
            IBig::from(mantissa) << shift
        }
    }
}

/// Returns the exponent of the largest power of two that divides all numbers.
///
/// The numbers must be finite. The result is `i32::MAX` if all numbers are 0.
pub fn unit_of(numbers: impl Iterator<Item = f64>) -> i32 {
    numbers
        .map(dyadic)
        .filter(|d| d.0 != 0)
        .fold(i32::MAX, |least, d| least.min(d.1))
}

/// Computes a × b.
pub fn cross(a: &IntegerVector, b: &IntegerVector) -> IntegerVector {
    let minor = |i: usize, j: usize| &a[i] * &b[j] - &a[j] * &b[i];
    [minor(1, 2), minor(2, 0), minor(0, 1)]
}

/// Computes a · b.
pub fn dot(a: &IntegerVector, b: &IntegerVector) -> IBig {
    &a[0] * &b[0] + &a[1] * &b[1] + &a[2] * &b[2]
}

/// Returns the sign of a number: −1, 0 or 1.
pub fn sign(n: &IBig) -> i32 {
    match n.cmp(&IBig::ZERO) {
        std::cmp::Ordering::Less => -1,
        std::cmp::Ordering::Equal => 0,
        std::cmp::Ordering::Greater => 1,
    }
}

/// Returns the direction of a vector of integers as a rounded vector with a size in [1, 2).
pub fn rounded(a: &IntegerVector) -> Rounded {
    use dashu_int::ops::BitTest;
    // Keep 120 bits of the longest component, and remove the same number of low bits from the other
    // components.
    let longest = a.iter().map(BitTest::bit_len).max().unwrap_or(0);
    let cut = longest.saturating_sub(120);
    let v = a.each_ref().map(|c| (c >> cut).to_f64().value());
    let it = Rounded { v, error: 0.0 }.scaled();
    // The removed bits are less than one unit of 120 bits; the conversion rounds to nearest.
    Rounded {
        error: it.size() * 2.0 * U,
        ..it
    }
}
