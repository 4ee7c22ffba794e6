//! Planes through triangles of a scene: exact integers, and a filter in doubles that decides most signs.
//!
//! Coordinates are finite doubles, so a plane through three points has integer coefficients up to a power of
//! two. Two planes are equal exactly if their coefficients are equal, so the test for coplanarity is a
//! comparison.

use std::cmp::Ordering;

use dashu_int::{IBig, Sign};
use glam::{DVec3, Vec3};
use sightline_exact::{PointOrigin, Polygon, predicates};
use sightline_geometry::rounding::UNIT as U;

/// The magnitude below which a nonzero coordinate may have lost bits to underflow.
const TINY: f64 = 1e-150;

/// The index of a plane in its [`crate::Planes`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PlaneId(pub u32);

/// The plane n·x = k. The first nonzero component of n is positive.
#[derive(Clone, Debug)]
pub struct Plane {
    /// n and k: integers without a common factor.
    exact: [IBig; 4],
    /// n and k, each rounded to the nearest double.
    near: [f64; 4],
    /// The axis along which n is longest.
    axis: usize,
    /// The coordinate on the axis `axis` that all points of the plane have.
    ///
    /// The value is `None` unless n is parallel to the axis and a double represents the coordinate exactly.
    across: Option<f64>,
}

impl Plane {
    /// Creates the plane through three points that are not on a line.
    pub fn through(v: [Vec3; 3]) -> Self {
        let [a, b, c] = v.map(|p| predicates::integers(&PointOrigin::Given(p.as_dvec3())));
        Self::from_coefficients(predicates::plane([&a, &b, &c]))
    }

    /// Creates the plane with the coefficients n and k, which must have no common factor.
    pub fn from_coefficients(mut exact: [IBig; 4]) -> Self {
        if exact
            .iter()
            .find(|c| !c.is_zero())
            .is_some_and(|c| c.sign() == Sign::Negative)
        {
            exact.iter_mut().for_each(|c| *c = -std::mem::take(c));
        }
        let near = exact.each_ref().map(|c| c.to_f64().value());
        let axis = (1..3).fold(0, |best, a| {
            if near[a].abs() > near[best].abs() {
                a
            } else {
                best
            }
        });
        let is_across = (0..3).all(|i| i == axis || exact[i].is_zero());
        let level = near[3] / near[axis];
        let is_level = || {
            let [own, .., w] =
                predicates::integers(&PointOrigin::Given(DVec3::new(level, 0.0, 0.0)));
            level.is_finite() && own * &exact[axis] == &exact[3] * w
        };
        let across = (is_across && is_level()).then_some(level);
        Self {
            exact,
            near,
            axis,
            across,
        }
    }

    /// Returns n and k.
    pub fn coefficients(&self) -> &[IBig; 4] {
        &self.exact
    }

    /// Returns the rounded normal, which need not have unit length.
    pub fn normal(&self) -> DVec3 {
        DVec3::new(self.near[0], self.near[1], self.near[2])
    }

    /// Returns the axis along which the normal is longest.
    pub fn axis(&self) -> usize {
        self.axis
    }

    /// Returns n and k, each rounded to the nearest double.
    pub fn rounded(&self) -> [f64; 4] {
        self.near
    }

    /// Returns the coordinate on [`Plane::axis`] that all points of the plane have. The result is `None`
    /// unless the plane is perpendicular to the axis and a double represents the coordinate exactly.
    ///
    /// The normal of a plane with such a coordinate points in the positive direction of the axis.
    pub fn across(&self) -> Option<f64> {
        self.across
    }

    /// Returns the side of the plane on which a point lies: `Greater` if n·x > k.
    ///
    /// `at` is the point rounded to doubles.
    ///
    /// A coordinate is off by at most 3u of itself (u = 2⁻⁵³) and a coefficient by u. A product is then off
    /// by 5u of itself, and the three sums add at most 3u of the sum of magnitudes. The bound 16u also covers
    /// its own roundings.
    pub fn side(&self, point: &PointOrigin, at: DVec3) -> Ordering {
        // The comparison of two doubles is exact; neither is NaN.
        if let (Some(level), PointOrigin::Given(p)) = (self.across, point) {
            return p[self.axis].partial_cmp(&level).unwrap_or(Ordering::Equal);
        }
        let [a, b, c, k] = self.near;
        let (x, y, z) = (a * at.x, b * at.y, c * at.z);
        let value = x + y + z - k;
        let bound = 16.0 * U * (x.abs() + y.abs() + z.abs() + k.abs());
        let lost = at.to_array().iter().any(|c| c.abs() < TINY && *c != 0.0);
        if value.abs() > bound && !lost {
            return if value > 0.0 {
                Ordering::Greater
            } else {
                Ordering::Less
            };
        }
        predicates::sign(&predicates::height(
            &self.exact,
            &predicates::integers(point),
        ))
    }

    /// Returns the side of the plane on which a point in single precision lies.
    pub fn side_of(&self, point: Vec3) -> Ordering {
        let at = point.as_dvec3();
        self.side(&PointOrigin::Given(at), at)
    }

    /// Returns the rounded distance of a point from the plane, positive if n·x > k.
    pub fn distance(&self, at: DVec3) -> f64 {
        let normal = self.normal();
        (normal.dot(at) - self.near[3]) / normal.length()
    }
}

/// A convex polygon with its corners in doubles; each coordinate is off by at most 3u of itself.
#[derive(Clone, Debug)]
pub struct Face {
    polygon: Polygon,
    at: Vec<DVec3>,
    /// The box around the rounded corners.
    bounds: [DVec3; 2],
}

impl Face {
    /// Creates a face from a polygon and rounds its corners.
    pub fn new(polygon: Polygon) -> Self {
        let at = polygon.rounded();
        let around = |[min, max]: [DVec3; 2], p: &DVec3| [min.min(*p), max.max(*p)];
        let bounds = at
            .iter()
            .fold([DVec3::INFINITY, DVec3::NEG_INFINITY], around);
        Self {
            polygon,
            at,
            bounds,
        }
    }

    /// Returns the exact polygon.
    pub fn polygon(&self) -> &Polygon {
        &self.polygon
    }

    /// Converts the face to its exact polygon.
    pub fn into_polygon(self) -> Polygon {
        self.polygon
    }

    /// Returns the rounded corners in order.
    pub fn corners(&self) -> &[DVec3] {
        &self.at
    }

    /// Computes the side of a plane on which each corner of the face lies.
    pub fn sides(&self, plane: &Plane) -> Vec<Ordering> {
        self.polygon
            .points()
            .iter()
            .zip(&self.at)
            .map(|(p, at)| plane.side(p, *at))
            .collect()
    }

    /// Returns the part of the face on the side `keep` of a plane, or `None` if no corner is on that side.
    ///
    /// `sides` contains the side of the plane on which each corner lies.
    pub fn part(&self, plane: &Plane, sides: &[Ordering], keep: Ordering) -> Option<Self> {
        if !sides.contains(&keep.reverse()) {
            return sides.contains(&keep).then(|| self.clone());
        }
        self.polygon
            .part(plane.coefficients(), sides, keep)
            .map(Self::new)
    }

    /// Returns the parts of the face on the lower and on the upper side of a plane. A part is `None` if the
    /// face has no corner on that side.
    ///
    /// Both parts are `None` for a face in the plane.
    pub fn parts(self, plane: &Plane) -> [Option<Self>; 2] {
        let sides = self.sides(plane);
        match (
            sides.contains(&Ordering::Less),
            sides.contains(&Ordering::Greater),
        ) {
            (true, true) => {
                [Ordering::Less, Ordering::Greater].map(|keep| self.part(plane, &sides, keep))
            }
            (true, false) => [Some(self), None],
            (false, true) => [None, Some(self)],
            (false, false) => [None, None],
        }
    }

    /// Computes twice the area of the face, rounded.
    pub fn area(&self) -> f64 {
        let first = self.at[0];
        self.at
            .windows(2)
            .map(|w| (w[0] - first).cross(w[1] - first))
            .sum::<DVec3>()
            .length()
    }

    /// Returns the rounded mean of the corners.
    pub fn middle(&self) -> DVec3 {
        self.at.iter().sum::<DVec3>() / self.at.len() as f64
    }

    /// Computes the width of the face, rounded: the smallest distance between two parallel lines in the plane
    /// that enclose the face.
    ///
    /// A wider object does not fit through the face.
    pub fn width(&self) -> f64 {
        let n = self.at.len();
        let across = |i: usize| {
            let (a, b) = (self.at[i], self.at[(i + 1) % n]);
            let along = (b - a).normalize_or_zero();
            let from = |p: &DVec3| ((*p - a) - along * (*p - a).dot(along)).length();
            self.at.iter().map(from).fold(0.0, f64::max)
        };
        (0..n).map(across).fold(f64::INFINITY, f64::min)
    }

    /// Returns true if the rounded boxes around both faces are disjoint.
    pub fn apart(&self, other: &Self) -> bool {
        let ([a, b], [c, d]) = (self.bounds, other.bounds);
        b.cmplt(c).any() || d.cmplt(a).any()
    }
}
