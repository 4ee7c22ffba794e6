//! Convex polygons in world space, and cutting them exactly along planes.

use std::cmp::Ordering;

use dashu_int::IBig;
use dashu_int::ops::UnsignedAbs as _;
use glam::{DVec3, Vec3Swizzles as _};
use sightline_geometry::predicates::differences;
use sightline_geometry::rounding::UNIT as U;
use sightline_numbers::Aabb;

use crate::arithmetic::number::primitive;
use crate::geometry::frame::{Source, point_doubles};
use crate::geometry::predicates::{height, integers, orient, plane, sign};

/// Most vertices of a polygon in a query.
pub const MOST_VERTICES: usize = 64;
/// Maximum number of corners of a polygon in one query: a query has two rays for every pair of corners, and
/// its work grows with the cube of their number.
const MOST_AT_ONCE: usize = 8;
/// A polygon of more than three vertices counts as flat, and is split into triangles, if no vertex is farther
/// from its plane than this fraction of its diameter. The constant decides only whether a query is refused.
const FLAT: f64 = 1e-6;

/// A convex polygon whose vertices lie exactly in one plane, no three of them on a line.
#[derive(Clone, Debug)]
pub struct Polygon {
    points: Vec<Source>,
}

/// Why a list of points is no polygon for a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PolygonError {
    /// Fewer than three different points, or all on a line.
    #[error("it has no area; give at least three corners that are not on one line")]
    NoArea,
    /// More than [`MOST_VERTICES`] vertices.
    #[error("it has more than {MOST_VERTICES} corners; split it")]
    TooMany,
    /// A coordinate that is not finite, or beyond what products of coordinates can hold.
    #[error("a coordinate is not finite or beyond ±1e60; scale the query")]
    NotFinite,
    /// So small that products of coordinates vanish.
    #[error(
        "it is less than 1e-60 across, or a coordinate is less than 1e-100 and not 0; scale the query"
    )]
    TooSmall,
    /// Vertices far from one plane.
    #[error("its corners are not in one plane; split it into triangles")]
    NotFlat,
    /// A reflex vertex, or a boundary that goes round more than once.
    #[error(
        "it is not convex (or its corners are not in order around it); split it into triangles"
    )]
    NotConvex,
}

impl Polygon {
    /// Checks the corners of a convex polygon, in order either way round.
    ///
    /// Corners that repeat or lie on the line of their neighbours are dropped. Corners that are in one plane
    /// only up to rounding cannot bound one convex polygon exactly; the result is then the fan of triangles
    /// from the first corner.
    ///
    /// # Errors
    /// [`PolygonError`], by kind.
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
        let mut points: Vec<Source> = distinct.into_iter().map(Source::Given).collect();
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

    /// Checks the corners of a convex polygon that is exactly flat, in order either way round. Corners that
    /// repeat or lie on the line of their neighbours are dropped.
    ///
    /// # Errors
    /// [`PolygonError`], by kind; [`PolygonError::NotFlat`] also where rounding is the reason.
    pub fn exact(corners: Vec<Source>) -> Result<Self, PolygonError> {
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
        let same = |p: &Source, q: &Source| {
            let (p, q) = (integers(p), integers(q));
            (0..3).all(|k| &p[k] * &q[3] == &q[k] * &p[3])
        };
        let mut points: Vec<Source> = Vec::new();
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
        let on = |p: &Source| orient([&points[0], &points[1], &points[2], p]) == Ordering::Equal;
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

    /// A triangle with area.
    pub fn triangle(v: [DVec3; 3]) -> Option<Self> {
        Self::checked(&v).ok().and_then(|mut p| p.pop())
    }

    /// A rectangle along two axes, which is flat by construction and must have an area.
    pub fn rectangle(corners: [DVec3; 4]) -> Self {
        Self {
            points: corners.map(Source::Given).into(),
        }
    }

    /// The six faces of a box with a volume.
    pub fn faces_of(bounds: Aabb) -> [Self; 6] {
        std::array::from_fn(|k| Self::face_of(bounds, k / 2, k % 2 == 1))
    }

    /// The face of a box across an axis, its greater one or its lesser one.
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

    /// The section of the plane (n, k) with a box; `None` if they share no area.
    ///
    /// The part of the plane over the box's face across the axis along which n is longest, cut along the
    /// other two faces.
    pub fn section(of: &[IBig; 4], bounds: Aabb) -> Option<Self> {
        let longest = |best: usize, a: usize| {
            if of[a].clone().unsigned_abs() > of[best].clone().unsigned_abs() {
                a
            } else {
                best
            }
        };
        let axis = (1..3).fold(0, longest);
        // On the plane above or below each corner of the face: (k − Σ nᵢ xᵢ) / n along the axis.
        let turn = if sign(&of[axis]) == Ordering::Less {
            -IBig::ONE
        } else {
            IBig::ONE
        };
        let corner = |p: &Source| {
            let p = integers(p);
            let others: IBig = (0..3).filter(|i| *i != axis).map(|i| &of[i] * &p[i]).sum();
            let mut point: [IBig; 4] = std::array::from_fn(|i| {
                let own = if i == axis {
                    &of[3] * &p[3] - &others
                } else {
                    &of[axis] * &p[i]
                };
                own * &turn
            });
            primitive(&mut point);
            Source::Exact(Box::new(point))
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

    /// The corners, in order.
    pub fn points(&self) -> &[Source] {
        &self.points
    }

    /// The corners, rounded.
    pub fn rounded(&self) -> Vec<DVec3> {
        self.points.iter().map(rounded).collect()
    }

    /// Its plane (n, k); n points to the side from which the corners appear counter-clockwise.
    pub fn plane(&self) -> [IBig; 4] {
        let [a, b, c] = [0, 1, 2].map(|i| integers(&self.points[i]));
        plane([&a, &b, &c])
    }

    /// On which side of this polygon's plane each corner of `other` is.
    pub fn sides(&self, other: &Self) -> Vec<Ordering> {
        let [a, b, c] = [0, 1, 2].map(|i| &self.points[i]);
        other.points.iter().map(|p| orient([a, b, c, p])).collect()
    }

    /// The part on the side `keep` of the plane, given each corner's side; None if no corner is on that side.
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
                points.push(Source::Exact(Box::new(cut)));
            }
        }
        Some(Self { points })
    }

    /// The two parts on both sides of the line through two of its points: point 2i is vertex i, point 2i + 1
    /// the middle of the edge after it. The first part begins with `from`.
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

    fn point(&self, number: usize) -> Source {
        let n = self.points.len();
        let a = &self.points[number / 2];
        if number.is_multiple_of(2) {
            return a.clone();
        }
        let (p, q) = (integers(a), integers(&self.points[(number / 2 + 1) % n]));
        let mut middle: [IBig; 4] = std::array::from_fn(|k| &p[k] * &q[3] + &q[k] * &p[3]);
        middle[3] = &p[3] * &q[3] * IBig::from(2);
        primitive(&mut middle);
        Source::Exact(Box::new(middle))
    }

    /// Itself, or pieces around the first corner with few enough corners for one query each.
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

    /// Whether every corner is on the inner side of every edge, where doubles can tell: in the projection
    /// along the axis nearest to the normal, with the bound of [`surely_not_collinear`].
    fn convex_in_doubles(&self) -> Option<bool> {
        if self.points.iter().any(|p| matches!(p, Source::Exact(_))) {
            return None;
        }
        let n = self.points.len();
        let p = self.rounded();
        let normal = (p[1] - p[0]).cross(p[2] - p[0]);
        let k = (0..3)
            .max_by(|i, j| normal[*i].abs().total_cmp(&normal[*j].abs()))
            .unwrap_or(0);
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        // All corners turn the same way, left or right.
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

    /// Whether every corner is on the inner side of every edge.
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
fn drop_collinear(points: &mut Vec<Source>) {
    // Dropping a corner can make its neighbours collinear.
    while let Some(i) = (0..points.len()).find(|i| {
        let n = points.len();
        n >= 3 && collinear([&points[(i + n - 1) % n], &points[*i], &points[(i + 1) % n]])
    }) {
        points.remove(i);
    }
}

/// The triangles of a polygon that is flat up to rounding.
fn fan(points: &[Source]) -> Result<Vec<Polygon>, PolygonError> {
    let p: Vec<DVec3> = points.iter().map(rounded).collect();
    let n = p.len();
    // Twice the area times the mean normal (Newell).
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

/// A point as doubles.
pub fn rounded(p: &Source) -> DVec3 {
    match p {
        Source::Given(p) => *p,
        Source::Exact(p) => DVec3::from(point_doubles(p)),
    }
}

/// For each coordinate whether [`rounded`] is not exactly it.
pub fn is_rounded(p: &Source) -> [bool; 3] {
    let Source::Exact(exact) = p else {
        return [false; 3];
    };
    let near = integers(&Source::Given(rounded(p)));
    [0, 1, 2].map(|k| &near[k] * &exact[3] != &exact[k] * &near[3])
}

/// Whether three points are on a line.
fn collinear(p: [&Source; 3]) -> bool {
    if let [Source::Given(a), Source::Given(b), Source::Given(c)] = p
        && surely_not_collinear(*a, *b, *c)
    {
        return false;
    }
    let [a, b, c] = p.map(integers);
    plane([&a, &b, &c]).iter().take(3).all(IBig::is_zero)
}

/// Whether doubles show that three points are not on a line: a component of (b − a) × (c − a), the
/// differences being exact, is off by 3u of the magnitudes of its products.
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
    fn corners_are_checked_and_superfluous_ones_dropped() {
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
        // A star winds twice: every turn is to the left, but it is no convex polygon.
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
    fn many_corners_become_pieces() {
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
        // Triangles of the whole and of the pieces.
        assert_eq!(
            pieces.iter().map(|p| p.points().len() - 2).sum::<usize>(),
            62
        );
    }

    #[test]
    fn corners_in_one_plane_up_to_rounding_become_a_fan() {
        let bent = v(&[
            [0.0; 3],
            [1.0, 0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, 1e-12],
        ]);
        assert_eq!(Polygon::checked(&bent).unwrap().len(), 2);
    }

    #[test]
    fn parts_meet_in_the_plane() {
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
