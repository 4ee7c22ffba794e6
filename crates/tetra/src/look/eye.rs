//! A viewpoint and the points seen from it: rounded vectors, and the same as integers.
//!
//! All coordinates are doubles, so they are integers times one power of two, which the smallest bit of any of
//! them gives. Signs of polynomials whose terms have equal degree do not depend on that power.

use dashu_int::IBig;
use glam::{DVec3, Vec3};
use sightline_geometry::predicates::{det3_small, differences, dyadic, orient3d_sign};
use sightline_geometry::rounding::UNIT as U;

use super::rounded::Rounded;

/// A vector of integers.
pub type IntegerVector = [IBig; 3];

/// A viewpoint, and the points that it looks at.
pub struct Eye<'a> {
    /// The viewpoint.
    pub x: [f64; 3],
    /// The scene's points.
    points: &'a [[f32; 3]],
    /// More points, numbered after the scene's: corners of target boxes.
    more: &'a [[f64; 3]],
    /// The coordinates are multiples of 2 to this power.
    unit: i32,
}

impl<'a> Eye<'a> {
    /// A viewpoint; `unit` is a power of two that divides the scene's coordinates ([`unit_of`]).
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

    /// A point by its number.
    #[inline]
    pub fn point(&self, number: u32) -> [f64; 3] {
        match self.points.get(number as usize) {
            Some(p) => p.map(f64::from),
            None => self.more[number as usize - self.points.len()],
        }
    }

    /// The points of a triangle of the scene.
    #[inline]
    pub fn scene_points(&self, triangle: [u32; 3]) -> [[f32; 3]; 3] {
        triangle.map(|p| self.points[p as usize])
    }

    /// The way to a point.
    #[inline]
    pub fn to(&self, number: u32) -> Rounded {
        Rounded::difference(self.point(number), self.x)
    }

    /// The vector from one point to another.
    #[inline]
    pub fn between(&self, a: u32, b: u32) -> Rounded {
        Rounded::difference(self.point(b), self.point(a))
    }

    /// The sign of the determinant of the ways to three points, where their integers are short.
    pub fn turn(&self, points: [u32; 3]) -> Option<i32> {
        let points = points.map(|p| DVec3::from(self.point(p)));
        let rows = differences(DVec3::from(self.x), points)?;
        det3_small(rows).map(|sign| sign as i32)
    }

    /// Whether a point is in a face's plane; nothing for points that are not the scene's.
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

    /// The way to a point in integers.
    pub fn to_exactly(&self, number: u32) -> IntegerVector {
        self.apart_exactly(self.point(number), self.x)
    }

    /// The vector from one point to another in integers.
    pub fn between_exactly(&self, a: u32, b: u32) -> IntegerVector {
        self.apart_exactly(self.point(b), self.point(a))
    }

    /// p − q in integers.
    fn apart_exactly(&self, p: [f64; 3], q: [f64; 3]) -> IntegerVector {
        std::array::from_fn(|k| {
            let d = p[k] - q[k];
            // What rounding took away (Knuth's two-sum): most often nothing, and then one number is enough.
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
        // 0 has no exponent of its own.
        let shift = (exponent - self.unit).max(0) as usize;
        // A mantissa has 53 bits.
        if shift <= 72 {
            IBig::from(i128::from(mantissa) << shift)
        } else {
            IBig::from(mantissa) << shift
        }
    }
}

/// The exponent of the largest power of two that divides all of some finite numbers; `i32::MAX` if all are 0.
pub fn unit_of(numbers: impl Iterator<Item = f64>) -> i32 {
    numbers
        .map(dyadic)
        .filter(|d| d.0 != 0)
        .fold(i32::MAX, |least, d| least.min(d.1))
}

/// a × b.
pub fn cross(a: &IntegerVector, b: &IntegerVector) -> IntegerVector {
    let minor = |i: usize, j: usize| &a[i] * &b[j] - &a[j] * &b[i];
    [minor(1, 2), minor(2, 0), minor(0, 1)]
}

/// a · b.
pub fn dot(a: &IntegerVector, b: &IntegerVector) -> IBig {
    &a[0] * &b[0] + &a[1] * &b[1] + &a[2] * &b[2]
}

/// A number's sign: −1, 0 or 1.
pub fn sign(n: &IBig) -> i32 {
    match n.cmp(&IBig::ZERO) {
        std::cmp::Ordering::Less => -1,
        std::cmp::Ordering::Equal => 0,
        std::cmp::Ordering::Greater => 1,
    }
}

/// The direction of a vector of integers, rounded, with a size in [1, 2).
pub fn rounded(a: &IntegerVector) -> Rounded {
    use dashu_int::ops::BitTest;
    // Of each component the bits that a double holds beside the longest one, and one bit of error at most.
    let longest = a.iter().map(BitTest::bit_len).max().unwrap_or(0);
    let cut = longest.saturating_sub(120);
    let v = a.each_ref().map(|c| (c >> cut).to_f64().value());
    let it = Rounded { v, error: 0.0 }.scaled();
    // What was cut off is less than one unit of 120 bits; the conversion rounds to nearest.
    Rounded {
        error: it.size() * 2.0 * U,
        ..it
    }
}
