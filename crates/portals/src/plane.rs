//! Planes through triangles of a scene: exact integers, with a filter in doubles that decides most signs.
//!
//! Coordinates are finite doubles, so a plane through three points has integer coefficients up to a power of
//! two. Planes are equal exactly when their coefficients are, which makes coplanarity a comparison.

use std::cmp::Ordering;

use dashu_int::{IBig, Sign};
use glam::{DVec3, Vec3};
use sightline_exact::{Polygon, Source, predicates};
use sightline_geometry::rounding::UNIT as U;

/// A coordinate that is not 0 and smaller than this may have lost bits to underflow.
const TINY: f64 = 1e-150;

/// The number of a plane in its [`crate::Planes`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PlaneId(pub u32);

/// The plane n·x = k. The first component of n that is not 0 is positive.
#[derive(Clone, Debug)]
pub struct Plane {
    /// n and k: integers without a common factor.
    exact: [IBig; 4],
    /// The same, each rounded to the nearest double.
    near: [f64; 4],
    /// The axis along which n is longest.
    axis: usize,
    /// The coordinate along the axis of all points, if n is along it and a double holds it.
    across: Option<f64>,
}

impl Plane {
    /// The plane through three points that are not on a line.
    pub fn through(v: [Vec3; 3]) -> Self {
        let [a, b, c] = v.map(|p| predicates::integers(&Source::Given(p.as_dvec3())));
        Self::of(predicates::plane([&a, &b, &c]))
    }

    /// The plane of these coefficients n and k, which have no common factor.
    pub fn of(mut exact: [IBig; 4]) -> Self {
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
            let [own, .., w] = predicates::integers(&Source::Given(DVec3::new(level, 0.0, 0.0)));
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

    /// n and k.
    pub fn coefficients(&self) -> &[IBig; 4] {
        &self.exact
    }

    /// The normal, rounded, of any length.
    pub fn normal(&self) -> DVec3 {
        DVec3::new(self.near[0], self.near[1], self.near[2])
    }

    /// The axis along which the normal is longest.
    pub fn axis(&self) -> usize {
        self.axis
    }

    /// n and k, each rounded to the nearest double.
    pub fn rounded(&self) -> [f64; 4] {
        self.near
    }

    /// The coordinate of all points, for a plane across an axis where a double holds it. Its normal points up
    /// the axis.
    pub fn across(&self) -> Option<f64> {
        self.across
    }

    /// On which side of the plane a point lies: `Greater` where n·x > k. `at` is the point, rounded.
    ///
    /// A coordinate is off by at most 3u of itself (u = 2⁻⁵³) and a coefficient by u. A product is then off
    /// by 5u of itself, and the three sums add at most 3u of the sum of magnitudes. 16u also covers the
    /// roundings of the bound.
    pub fn side(&self, point: &Source, at: DVec3) -> Ordering {
        // Two doubles are compared exactly; none is NaN.
        if let (Some(level), Source::Given(p)) = (self.across, point) {
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

    /// On which side of the plane a point of single precision lies.
    pub fn side_of(&self, point: Vec3) -> Ordering {
        let at = point.as_dvec3();
        self.side(&Source::Given(at), at)
    }

    /// The distance of a point from the plane, rounded; positive where n·x > k.
    pub fn distance(&self, at: DVec3) -> f64 {
        let normal = self.normal();
        (normal.dot(at) - self.near[3]) / normal.length()
    }
}

/// A convex polygon with its corners in doubles, each coordinate correct to 3u.
#[derive(Clone, Debug)]
pub struct Face {
    polygon: Polygon,
    at: Vec<DVec3>,
    /// The box around the rounded corners.
    bounds: [DVec3; 2],
}

impl Face {
    /// The polygon with its corners rounded.
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

    /// The exact polygon.
    pub fn polygon(&self) -> &Polygon {
        &self.polygon
    }

    /// The exact polygon, by value.
    pub fn into_polygon(self) -> Polygon {
        self.polygon
    }

    /// The corners, rounded, in order.
    pub fn corners(&self) -> &[DVec3] {
        &self.at
    }

    /// On which side of a plane each corner is.
    pub fn sides(&self, plane: &Plane) -> Vec<Ordering> {
        self.polygon
            .points()
            .iter()
            .zip(&self.at)
            .map(|(p, at)| plane.side(p, *at))
            .collect()
    }

    /// The part on the side `keep` of a plane, given each corner's side; `None` if no corner is on that side.
    pub fn part(&self, plane: &Plane, sides: &[Ordering], keep: Ordering) -> Option<Self> {
        if !sides.contains(&keep.reverse()) {
            return sides.contains(&keep).then(|| self.clone());
        }
        self.polygon
            .part(plane.coefficients(), sides, keep)
            .map(Self::new)
    }

    /// The parts on the lesser and on the greater side of a plane; both are `None` for a face in the plane.
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

    /// Twice the area, rounded.
    pub fn area(&self) -> f64 {
        let first = self.at[0];
        self.at
            .windows(2)
            .map(|w| (w[0] - first).cross(w[1] - first))
            .sum::<DVec3>()
            .length()
    }

    /// The mean of the corners, rounded.
    pub fn middle(&self) -> DVec3 {
        self.at.iter().sum::<DVec3>() / self.at.len() as f64
    }

    /// The least distance between two parallel lines of the face's plane with the face between them, rounded:
    /// what is wider does not fit through.
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

    /// Whether the boxes around both faces, rounded, are apart.
    pub fn apart(&self, other: &Self) -> bool {
        let ([a, b], [c, d]) = (self.bounds, other.bounds);
        b.cmplt(c).any() || d.cmplt(a).any()
    }
}
