//! Convex polygons in world space, and exact cuts of them along planes.

use std::cmp::Ordering;

use dashu_int::IBig;
use dashu_int::ops::UnsignedAbs as _;
use glam::{DVec3, Vec3Swizzles as _};
use sightline_geometry::predicates::differences;
use sightline_geometry::rounding::UNIT as U;
use sightline_numbers::Aabb;

use crate::arithmetic::number::primitive;
use crate::geometry::frame::{PointOrigin, point_doubles};
use crate::geometry::predicates::{height, integers, orient, plane, sign};

/// The maximum number of vertices of a polygon in a query.
pub const MOST_VERTICES: usize = 64;
/// The maximum number of corners of a polygon in one query; [`Polygon::pieces`] splits larger polygons.
///
/// A query has two rays for every pair of corners, and its work grows with the cube of their number.
const MOST_AT_ONCE: usize = 8;
/// The maximum distance of a vertex from the plane of a flat polygon, as a fraction of the polygon's
/// diameter.
///
/// [`Polygon::checked`] splits a polygon of more than three vertices within this distance into triangles, and
/// rejects a polygon with a vertex farther away.
const FLAT: f64 = 1e-6;

/// A convex polygon whose vertices lie exactly in one plane, no three of them on a line.
#[derive(Clone, Debug)]
pub struct Polygon {
    points: Vec<PointOrigin>,
}

/// The reason why a list of points is not a valid polygon for a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PolygonError {
    /// The list has fewer than three different points, or all points are on one line.
    #[error("the polygon has no area; give at least three corners that are not on one line")]
    NoArea,
    /// The list has more than [`MOST_VERTICES`] vertices.
    #[error("the polygon has more than {MOST_VERTICES} corners; split the polygon")]
    TooMany,
    /// A coordinate is not finite, or too large for products of coordinates in doubles.
    #[error("a coordinate is not finite or beyond ±1e60; scale the query down")]
    NotFinite,
    /// The polygon or a coordinate is so small that products of coordinates underflow.
    #[error(
        "the polygon is less than 1e-60 across, or a nonzero coordinate is below 1e-100; scale the query up"
    )]
    TooSmall,
    /// The vertices are far from one plane.
    #[error("the corners are not in one plane; split the polygon into triangles")]
    NotFlat,
    /// A vertex is reflex, or the boundary goes around more than once.
    #[error(
        "the polygon is not convex, or its corners are not in order; split the polygon into triangles"
    )]
    NotConvex,
}

impl Polygon {
    /// Checks the corners of a convex polygon, which must be in order around the polygon, and returns the
    /// polygon.
    ///
    /// The function drops corners that repeat or lie on the line of their neighbours. If the corners are in
    /// one plane only up to rounding, the result is the fan of triangles from the first corner. If the
    /// polygon has more corners than one query allows, the result is a list of its pieces.
    ///
    /// # Errors
    /// [`PolygonError`] with the reason.
    pub fn checked(corners: &[DVec3]) -> Result<Vec<Self>, PolygonError> {
        if corners
            .iter()
            .any(|p| !p.is_finite() || p.abs().max_element() > 1e60)
        {
            return Err(PolygonError::NotFinite);
        }
        if corners.len() > MOST_VERTICES {
            return Err(PolygonError::TooMany);
        }
        let vanishing = |c: f64| c != 0.0 && c.abs() < 1e-100;
        if corners
            .iter()
            .any(|p| p.to_array().into_iter().any(vanishing))
        {
            return Err(PolygonError::TooSmall);
        }
        if corners.len() > 1
            && corners
                .iter()
                .all(|p| (*p - corners[0]).abs().max_element() < 1e-60)
        {
            return Err(PolygonError::TooSmall);
        }
        let mut distinct: Vec<DVec3> = Vec::new();
        for p in corners {
            // −0 and 0 are one coordinate.
            let p = *p + DVec3::ZERO;
            if distinct.last() != Some(&p) {
                distinct.push(p);
            }
        }
        while distinct.len() > 1 && distinct.first() == distinct.last() {
            distinct.pop();
        }
        let mut points: Vec<PointOrigin> = distinct.into_iter().map(PointOrigin::Given).collect();
        drop_collinear(&mut points);
        if points.len() < 3 {
            return Err(PolygonError::NoArea);
        }
        if points.len() == 3 {
            return Ok(vec![Self { points }]);
        }
        let flat = points[3..]
            .iter()
            .all(|p| orient([&points[0], &points[1], &points[2], p]) == Ordering::Equal);
        if flat {
            let one = Self { points };
            return if one.convex() {
                Ok(one.pieces())
            } else {
                Err(PolygonError::NotConvex)
            };
        }
        fan(&points)
    }

    /// Checks the corners of a convex polygon that is exactly flat. The corners must be in order around the
    /// polygon.
    ///
    /// The function drops corners that repeat or lie on the line of their neighbours.
    ///
    /// # Errors
    /// [`PolygonError`] with the reason. If the corners are in one plane only up to rounding, the error is
    /// [`PolygonError::NotFlat`].
    pub fn exact(corners: Vec<PointOrigin>) -> Result<Self, PolygonError> {
        if corners.len() > MOST_VERTICES {
            return Err(PolygonError::TooMany);
        }
        let near: Vec<DVec3> = corners.iter().map(rounded).collect();
        if near
            .iter()
            .any(|p| !p.is_finite() || p.abs().max_element() > 1e60)
        {
            return Err(PolygonError::NotFinite);
        }
        let vanishing = |c: f64| c != 0.0 && c.abs() < 1e-100;
        let is_dot = near.len() > 1
            && near
                .iter()
                .all(|p| (*p - near[0]).abs().max_element() < 1e-60);
        if is_dot || near.iter().any(|p| p.to_array().into_iter().any(vanishing)) {
            return Err(PolygonError::TooSmall);
        }
        let same = |p: &PointOrigin, q: &PointOrigin| {
            let (p, q) = (integers(p), integers(q));
            (0..3).all(|k| &p[k] * &q[3] == &q[k] * &p[3])
        };
        let mut points: Vec<PointOrigin> = Vec::new();
        for p in corners {
            if points.last().is_none_or(|last| !same(last, &p)) {
                points.push(p);
            }
        }
        while points.len() > 1 && same(&points[0], &points[points.len() - 1]) {
            points.pop();
        }
        drop_collinear(&mut points);
        if points.len() < 3 {
            return Err(PolygonError::NoArea);
        }
        let on =
            |p: &PointOrigin| orient([&points[0], &points[1], &points[2], p]) == Ordering::Equal;
        if !points[3..].iter().all(on) {
            return Err(PolygonError::NotFlat);
        }
        let one = Self { points };
        if one.points.len() == 3 || one.convex() {
            Ok(one)
        } else {
            Err(PolygonError::NotConvex)
        }
    }

    /// Creates a triangle, or returns `None` if it has no area or its coordinates are out of range.
    pub fn triangle(v: [DVec3; 3]) -> Option<Self> {
        Self::checked(&v).ok().and_then(|mut p| p.pop())
    }

    /// Creates a rectangle whose edges are parallel to two axes, without checks. The rectangle must have an
    /// area.
    pub fn rectangle(corners: [DVec3; 4]) -> Self {
        Self {
            points: corners.map(PointOrigin::Given).into(),
        }
    }

    /// Returns the six faces of a box with a volume, the lower face of each axis first.
    pub fn faces_of(bounds: Aabb) -> [Self; 6] {
        std::array::from_fn(|k| Self::face_of(bounds, k / 2, k % 2 == 1))
    }

    /// Returns the upper (`up` is true) or lower face of a box perpendicular to an axis (0 to 2).
    pub fn face_of(bounds: Aabb, axis: usize, up: bool) -> Self {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let (lo, hi) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        let corner = |s: bool, t: bool| {
            let mut p = lo;
            p[axis] = if up { hi[axis] } else { lo[axis] };
            p[u] = if s { hi[u] } else { lo[u] };
            p[v] = if t { hi[v] } else { lo[v] };
            p
        };
        Self::rectangle([
            corner(false, false),
            corner(true, false),
            corner(true, true),
            corner(false, true),
        ])
    }

    /// Computes the section of the plane n·x = k with a box, or returns `None` if the section has no area.
    ///
    /// Let the axis be the coordinate axis along which n is longest. The function projects a face of the box
    /// perpendicular to the axis to the plane. Then it cuts the projection along the planes of the two faces
    /// perpendicular to the axis.
    pub fn section(plane: &[IBig; 4], bounds: Aabb) -> Option<Self> {
        let longest = |best: usize, a: usize| {
            if plane[a].clone().unsigned_abs() > plane[best].clone().unsigned_abs() {
                a
            } else {
                best
            }
        };
        let axis = (1..3).fold(0, longest);
        // The point of the plane above or below each corner of the face: (k − Σ nᵢ xᵢ) / n along the axis.
        let turn = if sign(&plane[axis]) == Ordering::Less {
            -IBig::ONE
        } else {
            IBig::ONE
        };
        let corner = |p: &PointOrigin| {
            let p = integers(p);
            let others: IBig = (0..3)
                .filter(|i| *i != axis)
                .map(|i| &plane[i] * &p[i])
                .sum();
            let mut point: [IBig; 4] = std::array::from_fn(|i| {
                let own = if i == axis {
                    &plane[3] * &p[3] - &others
                } else {
                    &plane[axis] * &p[i]
                };
                own * &turn
            });
            primitive(&mut point);
            PointOrigin::Exact(Box::new(point))
        };
        let mut face = Self {
            points: Self::face_of(bounds, axis, false)
                .points
                .iter()
                .map(corner)
                .collect(),
        };
        for up in [false, true] {
            let wall = Self::face_of(bounds, axis, up).plane();
            let along = sign(&wall[axis]);
            let sides: Vec<Ordering> = face
                .points
                .iter()
                .map(|p| sign(&height(&wall, &integers(p))))
                .collect();
            face = face.part(&wall, &sides, if up { along.reverse() } else { along })?;
        }
        Some(face)
    }

    /// Returns the corners in order.
    pub fn points(&self) -> &[PointOrigin] {
        &self.points
    }

    /// Returns the rounded corners in order.
    pub fn rounded(&self) -> Vec<DVec3> {
        self.points.iter().map(rounded).collect()
    }

    /// Computes the polygon's plane n·x = k as (n, k). n points to the side from which the corners appear
    /// counter-clockwise.
    pub fn plane(&self) -> [IBig; 4] {
        let [a, b, c] = [0, 1, 2].map(|i| integers(&self.points[i]));
        plane([&a, &b, &c])
    }

    /// Computes the side of this polygon's plane on which each corner of `other` lies, in the order of the
    /// corners.
    pub fn sides(&self, other: &Self) -> Vec<Ordering> {
        let [a, b, c] = [0, 1, 2].map(|i| &self.points[i]);
        other.points.iter().map(|p| orient([a, b, c, p])).collect()
    }

    /// Returns the part of the polygon on the side `keep` of a plane (n, k), or `None` if no corner is on
    /// that side.
    ///
    /// `sides` contains the side of the plane on which each corner lies.
    pub fn part(&self, plane: &[IBig; 4], sides: &[Ordering], keep: Ordering) -> Option<Self> {
        if !sides.contains(&keep) {
            return None;
        }
        if !sides.contains(&keep.reverse()) {
            return Some(self.clone());
        }
        let n = self.points.len();
        let mut points = Vec::with_capacity(n + 1);
        for i in 0..n {
            let j = (i + 1) % n;
            if sides[i] != keep.reverse() {
                points.push(self.points[i].clone());
            }
            if sides[i] == sides[j].reverse() && sides[i] != Ordering::Equal {
                let (p, q) = (integers(&self.points[i]), integers(&self.points[j]));
                let (s, t) = (
                    height(plane, &p).unsigned_abs(),
                    height(plane, &q).unsigned_abs(),
                );
                let mut cut: [IBig; 4] = std::array::from_fn(|k| &q[k] * &s + &p[k] * &t);
                primitive(&mut cut);
                points.push(PointOrigin::Exact(Box::new(cut)));
            }
        }
        Some(Self { points })
    }

    /// Divides the polygon along the line through two points of its border, and returns both parts.
    ///
    /// Point 2i is vertex i, and point 2i + 1 is the middle of the edge after vertex i. The first part begins
    /// with `from`.
    pub fn divided(&self, from: u16, to: u16) -> [Self; 2] {
        let n = 2 * self.points.len();
        let part = |from: usize, to: usize| {
            let mut points = vec![self.point(from)];
            let mut at = (from + 1) % n;
            while at != to {
                if at.is_multiple_of(2) {
                    points.push(self.points[at / 2].clone());
                }
                at = (at + 1) % n;
            }
            points.push(self.point(to));
            Self { points }
        };
        let (from, to) = (usize::from(from) % n, usize::from(to) % n);
        [part(from, to), part(to, from)]
    }

    fn point(&self, number: usize) -> PointOrigin {
        let n = self.points.len();
        let a = &self.points[number / 2];
        if number.is_multiple_of(2) {
            return a.clone();
        }
        let (p, q) = (integers(a), integers(&self.points[(number / 2 + 1) % n]));
        let mut middle: [IBig; 4] = std::array::from_fn(|k| &p[k] * &q[3] + &q[k] * &p[3]);
        middle[3] = &p[3] * &q[3] * IBig::from(2);
        primitive(&mut middle);
        PointOrigin::Exact(Box::new(middle))
    }

    /// Splits the polygon into convex pieces that share the first corner and have few enough corners for one
    /// query each.
    ///
    /// If the polygon already has few enough corners, the result contains only the polygon.
    pub fn pieces(self) -> Vec<Self> {
        if self.points.len() <= MOST_AT_ONCE {
            return vec![self];
        }
        let mut out = Vec::new();
        let mut first = 1;
        while first + 1 < self.points.len() {
            let last = (first + MOST_AT_ONCE - 2).min(self.points.len() - 1);
            let mut points = vec![self.points[0].clone()];
            points.extend_from_slice(&self.points[first..=last]);
            out.push(Self { points });
            first = last;
        }
        out
    }

    /// Returns true if every corner is on the inner side of every edge.
    ///
    /// The result is `None` if doubles cannot decide this.
    ///
    /// The function tests the projection along the axis nearest to the normal, with the bound of
    /// [`surely_not_collinear`].
    fn convex_in_doubles(&self) -> Option<bool> {
        if self
            .points
            .iter()
            .any(|p| matches!(p, PointOrigin::Exact(_)))
        {
            return None;
        }
        let n = self.points.len();
        let p = self.rounded();
        let normal = (p[1] - p[0]).cross(p[2] - p[0]);
        let k = (0..3)
            .max_by(|i, j| normal[*i].abs().total_cmp(&normal[*j].abs()))
            .unwrap_or(0);
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        // In a convex polygon, all corners turn in the same direction.
        let (mut left, mut right) = (true, true);
        for a in 0..n {
            let b = (a + 1) % n;
            for c in (0..n).filter(|c| *c != a && *c != b) {
                let [x, y] = differences(p[a], [p[b], p[c]])?;
                let (l, r) = (x[i] * y[j], x[j] * y[i]);
                if (l - r).abs() <= 4.0 * U * (l.abs() + r.abs()) + 1e-290 {
                    return None;
                }
                left &= l > r;
                right &= l < r;
            }
        }
        Some(left || right)
    }

    /// Returns true if every corner is on the inner side of every edge.
    fn convex(&self) -> bool {
        if let Some(known) = self.convex_in_doubles() {
            return known;
        }
        let exact: Vec<[IBig; 4]> = self.points.iter().map(integers).collect();
        let normal = self.plane();
        let n = exact.len();
        let left = |a: &[IBig; 4], b: &[IBig; 4], p: &[IBig; 4]| {
            let d = |q: &[IBig; 4]| -> [IBig; 3] {
                std::array::from_fn(|k| &q[k] * &a[3] - &a[k] * &q[3])
            };
            let (x, y) = (d(b), d(p));
            let minor = |i: usize, j: usize| &x[i] * &y[j] - &x[j] * &y[i];
            sign(&(&normal[0] * minor(1, 2) + &normal[1] * minor(2, 0) + &normal[2] * minor(0, 1)))
        };
        (0..n).all(|i| {
            let j = (i + 1) % n;
            (0..n)
                .filter(|k| *k != i && *k != j)
                .all(|k| left(&exact[i], &exact[j], &exact[k]) == Ordering::Greater)
        })
    }
}

/// Drops corners on the line of their neighbours.
fn drop_collinear(points: &mut Vec<PointOrigin>) {
    // Dropping a corner can make its neighbours collinear.
    while let Some(i) = (0..points.len()).find(|i| {
        let n = points.len();
        n >= 3 && collinear([&points[(i + n - 1) % n], &points[*i], &points[(i + 1) % n]])
    }) {
        points.remove(i);
    }
}

/// Divides a polygon that is flat only up to rounding into triangles that share its first corner.
fn fan(points: &[PointOrigin]) -> Result<Vec<Polygon>, PolygonError> {
    let p: Vec<DVec3> = points.iter().map(rounded).collect();
    let n = p.len();
    // The sum is twice the area times the mean normal (Newell).
    let normal: DVec3 = (0..n)
        .map(|i| (p[i] - p[0]).cross(p[(i + 1) % n] - p[0]))
        .sum();
    let normal = normal.try_normalize().ok_or(PolygonError::NoArea)?;
    let diameter = p.iter().fold(0.0f64, |m, q| m.max((*q - p[0]).length()));
    if p.iter()
        .any(|q| (*q - p[0]).dot(normal).abs() > FLAT * diameter)
    {
        return Err(PolygonError::NotFlat);
    }
    for i in 0..n {
        let (a, b) = (p[i], p[(i + 1) % n]);
        let inner = normal.cross(b - a);
        if p.iter()
            .any(|q| (*q - a).dot(inner) < -FLAT * diameter * inner.length())
        {
            return Err(PolygonError::NotConvex);
        }
    }
    let triangles: Vec<Polygon> = (1..n - 1)
        .filter(|i| !collinear([&points[0], &points[*i], &points[i + 1]]))
        .map(|i| Polygon {
            points: vec![points[0].clone(), points[i].clone(), points[i + 1].clone()],
        })
        .collect();
    if triangles.is_empty() {
        Err(PolygonError::NoArea)
    } else {
        Ok(triangles)
    }
}

/// Converts a point in world space to doubles, rounded if needed.
pub fn rounded(p: &PointOrigin) -> DVec3 {
    match p {
        PointOrigin::Given(p) => *p,
        PointOrigin::Exact(p) => DVec3::from(point_doubles(p)),
    }
}

/// Returns, for each coordinate of a point, true if [`rounded`] changes the coordinate.
pub fn is_rounded(p: &PointOrigin) -> [bool; 3] {
    let PointOrigin::Exact(exact) = p else {
        return [false; 3];
    };
    let near = integers(&PointOrigin::Given(rounded(p)));
    [0, 1, 2].map(|k| &near[k] * &exact[3] != &exact[k] * &near[3])
}

/// Returns true if three points are on a line.
fn collinear(p: [&PointOrigin; 3]) -> bool {
    if let [
        PointOrigin::Given(a),
        PointOrigin::Given(b),
        PointOrigin::Given(c),
    ] = p
        && surely_not_collinear(*a, *b, *c)
    {
        return false;
    }
    let [a, b, c] = p.map(integers);
    plane([&a, &b, &c]).iter().take(3).all(IBig::is_zero)
}

/// Returns true if doubles show that three points are not on a line.
///
/// If the differences are exact, a component of (b − a) × (c − a) is off by at most 3u of the magnitudes of
/// its products.
fn surely_not_collinear(a: DVec3, b: DVec3, c: DVec3) -> bool {
    let Some(rows) = differences(a, [b, c]) else {
        return false;
    };
    let [x, y] = rows.map(DVec3::from);
    let (l, r) = (x.yzx() * y.zxy(), x.zxy() * y.yzx());
    let surely = (l - r)
        .abs()
        .cmpgt(4.0 * U * (l.abs() + r.abs()) + DVec3::splat(1e-290));
    surely.any()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn v(p: &[[f64; 3]]) -> Vec<DVec3> {
        p.iter().map(|p| DVec3::from(*p)).collect()
    }

    #[test]
    fn checked_rejects_bad_corners_and_drops_redundant_corners() {
        let square = v(&[
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [1.0, 1.0, 1.0],
            [0.0, 1.0, 1.0],
        ]);
        assert_eq!(Polygon::checked(&square).unwrap()[0].points().len(), 4);
        let more = v(&[
            [0.0, 0.0, 1.0],
            [0.5, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [1.0, 1.0, 1.0],
            [0.0, 1.0, 1.0],
        ]);
        assert_eq!(Polygon::checked(&more).unwrap()[0].points().len(), 4);
        let error = |p: &[[f64; 3]]| Polygon::checked(&v(p)).unwrap_err();
        assert_eq!(
            error(&[[0.0; 3], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]),
            PolygonError::NoArea
        );
        assert_eq!(error(&[]), PolygonError::NoArea);
        assert_eq!(
            error(&[[0.0; 3], [1e-70, 0.0, 0.0], [0.0, 1e-70, 0.0]]),
            PolygonError::TooSmall
        );
        assert_eq!(
            error(&[[0.0; 3], [f64::NAN, 0.0, 0.0], [1.0, 0.0, 0.0]]),
            PolygonError::NotFinite
        );
        assert_eq!(
            error(&[[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.5]]),
            PolygonError::NotFlat
        );
        assert_eq!(
            error(&[[0.0; 3], [4.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 4.0, 0.0]]),
            PolygonError::NotConvex
        );
        // A star goes around twice: every turn is to the left, but the star is not a convex polygon.
        let star: Vec<DVec3> = (0..5)
            .map(|i| {
                DVec3::new(
                    (f64::from(i) * 2.0 * 72f64.to_radians()).cos(),
                    (f64::from(i) * 2.0 * 72f64.to_radians()).sin(),
                    0.0,
                )
            })
            .collect();
        assert_eq!(
            Polygon::checked(&star).unwrap_err(),
            PolygonError::NotConvex
        );
        assert_eq!(
            Polygon::checked(&vec![DVec3::ZERO; 65]).unwrap_err(),
            PolygonError::TooMany
        );
    }

    #[test]
    fn checked_splits_many_corners_into_pieces() {
        let parabola: Vec<DVec3> = (0..64)
            .map(f64::from)
            .map(|i| DVec3::new(i, i * i, 1.0))
            .collect();
        let pieces = Polygon::checked(&parabola).unwrap();
        assert!(
            pieces
                .iter()
                .all(|p| (3..=MOST_AT_ONCE).contains(&p.points().len()) && p.convex())
        );
        // The pieces consist of as many triangles as the whole polygon.
        assert_eq!(
            pieces.iter().map(|p| p.points().len() - 2).sum::<usize>(),
            62
        );
    }

    #[test]
    fn checked_turns_nearly_flat_corners_into_fan() {
        let bent = v(&[
            [0.0; 3],
            [1.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 1e-12],
        ]);
        assert_eq!(Polygon::checked(&bent).unwrap().len(), 2);
    }

    #[test]
    fn parts_meet_in_plane() {
        let square = &Polygon::checked(&v(&[
            [0.0; 3],
            [1.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 0.0],
        ]))
        .unwrap()[0];
        let wall = &Polygon::checked(&v(&[[0.3, -1.0, -1.0], [0.3, 2.0, -1.0], [0.3, 2.0, 1.0]]))
            .unwrap()[0];
        let sides = wall.sides(square);
        let plane = wall.plane();
        for keep in [Ordering::Less, Ordering::Greater] {
            let part = square.part(&plane, &sides, keep).unwrap();
            assert_eq!(part.points().len(), 4);
            assert!(
                part.points()
                    .iter()
                    .all(|p| sign(&height(&plane, &integers(p))) != keep.reverse())
            );
            assert_eq!(
                part.points()
                    .iter()
                    .filter(|p| height(&plane, &integers(p)).is_zero())
                    .count(),
                2
            );
        }
    }
}
