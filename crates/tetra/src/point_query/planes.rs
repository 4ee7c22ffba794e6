//! Planes through the viewpoint, corners of beams, and the sides of planes on which corners are.
//!
//! All decisions are about directions, not about points. A plane through the viewpoint is its normal, a
//! corner of a beam is the cross product of two normals, and a side is the sign of a determinant of three
//! normals. Doubles with error bounds decide most signs. Points and faces that define both a corner and a
//! plane decide most signs that are 0 (`zeros`). Integers decide the other signs.

use sightline_geometry::rounding::UNIT as U;

use super::eye::{self, Eye, IntegerVector};
use super::rounded::{Rounded, RoundedNumber};

/// The definition of a plane through the viewpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlaneOrigin {
    /// The plane through the viewpoint x and two points a and b, given by their numbers, the smaller number
    /// first.
    ///
    /// The normal is (a − x) × (b − x).
    Edge(u32, u32),
    /// The plane through the viewpoint x and the line in which the planes of two faces meet.
    ///
    /// A face is three point numbers, ordered so that the normal points away from the viewpoint: (b − a) × (c
    /// − a) · (a − x) > 0. On the positive side of the plane, the second face is nearer.
    Meet([u32; 3], [u32; 3]),
    /// The plane through the viewpoint with this normal.
    Normal([f64; 3]),
}

/// A plane through the viewpoint.
#[derive(Clone, Copy, Debug)]
pub struct EyePlane {
    /// The definition of the plane.
    pub kind: PlaneOrigin,
    /// The normal of the plane, scaled by [`Rounded::scaled`].
    pub normal: Rounded,
}

impl EyePlane {
    /// Creates the plane through the viewpoint and two points, given by their numbers.
    #[inline]
    pub fn edge(eye: &Eye<'_>, a: u32, b: u32) -> Self {
        let (low, high) = (a.min(b), a.max(b));
        // The vector from point to point is far more precise than the difference of two long vectors.
        let normal = eye.to(low).cross(&eye.between(low, high)).scaled();
        Self {
            kind: PlaneOrigin::Edge(low, high),
            normal,
        }
    }
}

/// A side of a plane in [`Planes::list`].
///
/// The value is twice the plane's index, plus 1 for the negative side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Side(u32);

impl Side {
    /// Creates the positive or the negative side of a plane.
    pub fn new(plane: usize, negative: bool) -> Self {
        Self((plane as u32) << 1 | u32::from(negative))
    }

    /// Returns the index of the plane.
    #[inline]
    pub fn plane(self) -> usize {
        (self.0 >> 1) as usize
    }

    /// Returns true for the negative side.
    #[inline]
    pub fn negative(self) -> bool {
        self.0 & 1 == 1
    }

    /// Returns the other side of the plane.
    #[inline]
    pub fn other(self) -> Self {
        Self(self.0 ^ 1)
    }
}

/// Marker for a missing point.
pub const NONE: u32 = u32::MAX;

/// A corner of a beam: the direction of the cross product of the normals of two sides.
#[derive(Clone, Copy, Debug)]
pub struct Corner {
    /// The direction of the corner, scaled by [`Rounded::scaled`].
    pub way: Rounded,
    /// The two sides, in the order of the cross product.
    pub sides: [Side; 2],
    /// The number of a point in this direction that both planes are known to contain, or [`NONE`].
    pub point: u32,
}

/// The planes of a query, and the number of signs that were decided and that needed integers.
#[derive(Default)]
pub struct Planes {
    /// The list of planes. When a beam ends, the search removes the planes that only this beam needs.
    pub list: Vec<EyePlane>,
    /// The number of signs that the query decided.
    pub decided: u64,
    /// The number of signs and directions that the query computed in integers.
    pub integers: u64,
}

/// Relative error bound above which a direction is computed again in integers.
///
/// All signs of such a direction would need integers.
const POOR: f64 = 1.0 / (1u64 << 30) as f64;

impl Planes {
    /// Adds a plane, and returns its positive side.
    pub fn add(&mut self, plane: EyePlane) -> Side {
        self.list.push(plane);
        Side::new(self.list.len() - 1, false)
    }

    /// Adds the plane through the viewpoint x and two points, and returns the side to which (a − x) × (b − x)
    /// points.
    pub fn add_edge(&mut self, eye: &Eye<'_>, a: u32, b: u32) -> Side {
        self.add(EyePlane::edge(eye, a, b));
        Side::new(self.list.len() - 1, a > b)
    }

    /// Returns the numbers of the two points of an edge's plane, ordered so that (a − x) × (b − x) points to
    /// the given side.
    ///
    /// Returns `None` if the plane is not the plane of an edge.
    pub fn edge_of(&self, side: Side) -> Option<(u32, u32)> {
        match self.list[side.plane()].kind {
            PlaneOrigin::Edge(a, b) if side.negative() => Some((b, a)),
            PlaneOrigin::Edge(a, b) => Some((a, b)),
            _ => None,
        }
    }

    /// Returns the normal that points to a side.
    #[inline]
    pub fn normal(&self, side: Side) -> Rounded {
        let normal = &self.list[side.plane()].normal;
        if side.negative() {
            normal.reversed()
        } else {
            *normal
        }
    }

    /// Returns the sign of a corner's scalar product with a plane's normal: the side of the plane on which
    /// the corner is.
    #[inline]
    pub fn sign_of(&mut self, eye: &Eye<'_>, corner: &Corner, plane: &EyePlane) -> i32 {
        self.decided += 1;
        match corner.way.side(&plane.normal) {
            Some(sign) => sign,
            None => self.sign_closely(eye, corner, plane),
        }
    }

    /// Computes the result of [`Self::sign_of`] if the quick error bounds do not decide the sign.
    #[cold]
    fn sign_closely(&mut self, eye: &Eye<'_>, corner: &Corner, plane: &EyePlane) -> i32 {
        if let Some(sign) = corner.way.dot(&plane.normal).sign() {
            return sign;
        }
        if self.is_on(eye, corner, plane.kind) {
            return 0;
        }
        self.integers += 1;
        let short = match plane.kind {
            PlaneOrigin::Edge(a, b) if corner.point != NONE => eye.turn([corner.point, a, b]),
            _ => None,
        };
        short.unwrap_or_else(|| {
            let way = self.way_exactly(eye, corner);
            eye::sign(&eye::dot(&way, &normal_exactly(eye, plane.kind)))
        })
    }

    /// Computes the corner in which the planes of two sides meet. The corner is between the directions `from`
    /// and `to`, which are less than a right angle apart, or these are 0.
    pub fn corner(
        &mut self,
        eye: &Eye<'_>,
        sides: [Side; 2],
        from: &Rounded,
        to: &Rounded,
    ) -> Corner {
        let point = match sides.map(|s| self.list[s.plane()].kind) {
            [PlaneOrigin::Edge(a, b), PlaneOrigin::Edge(c, d)] if a == c || a == d => {
                Some((a, b, c, d))
            }
            [PlaneOrigin::Edge(a, b), PlaneOrigin::Edge(c, d)] if b == c || b == d => {
                Some((b, a, c, d))
            }
            _ => None,
        };
        if let Some((point, ..)) = point {
            let way = eye.to(point).scaled();
            // The planes meet in the line through the viewpoint and the point, and the corner is a positive
            // combination of `from` and `to`. The scalar product of the corner with their sum is at least
            // half of the product of the lengths, which is far larger than the error bounds of precise
            // directions.
            let between = Rounded {
                v: std::array::from_fn(|k| from.v[k] + to.v[k]),
                error: from.error + to.error,
            };
            if way.dot(&between).sign() == Some(1) {
                return Corner { way, sides, point };
            }
        }
        let way = self.normal(sides[0]).cross(&self.normal(sides[1]));
        let mut corner = Corner {
            way: way.scaled(),
            sides,
            point: NONE,
        };
        // The condition includes a product that is 0 compared with its bound, and NaN.
        if way.error.is_nan() || way.error > POOR * way.size() {
            self.integers += 1;
            corner.way = eye::rounded(&self.way_exactly(eye, &corner));
        }
        corner
    }

    /// Computes a corner's direction in integers.
    fn way_exactly(&self, eye: &Eye<'_>, corner: &Corner) -> IntegerVector {
        if corner.point != NONE {
            return eye.to_exactly(corner.point);
        }
        let [a, b] = corner.sides.map(|s| {
            let n = normal_exactly(eye, self.list[s.plane()].kind);
            if s.negative() { n.map(|c| -c) } else { n }
        });
        eye::cross(&a, &b)
    }
}

/// A face's plane as seen from the viewpoint.
#[derive(Clone, Copy, Debug, Default)]
pub struct Facing {
    /// The numbers of the three points a, b and c, in front order: the normal points away from the viewpoint.
    pub points: [u32; 3],
    /// The normal (b − a) × (c − a).
    pub normal: Rounded,
    /// The scalar product of the normal with a − x, which is positive: the distance of the plane from the
    /// viewpoint x times the length of the normal.
    pub height: RoundedNumber,
}

impl Facing {
    /// Computes the plane of three points, given by their numbers, or returns `None` if the viewpoint is in
    /// the plane.
    #[inline]
    pub fn new(eye: &Eye<'_>, points: [u32; 3]) -> Option<Self> {
        let [a, b, c] = points;
        let normal = eye.between(a, b).cross(&eye.between(a, c));
        let height = eye.to(a).dot(&normal);
        // (a − x) · ((b − a) × (c − a)) is the determinant of the vectors to the three points.
        let sign = height
            .sign()
            .or_else(|| eye.turn(points))
            .unwrap_or_else(|| {
                let [ab, ac] = [b, c].map(|p| eye.between_exactly(a, p));
                eye::sign(&eye::dot(&eye.to_exactly(a), &eye::cross(&ab, &ac)))
            });
        match sign {
            0 => None,
            1 => Some(Self {
                points,
                normal,
                height,
            }),
            _ => Some(Self {
                points: [a, c, b],
                normal: normal.reversed(),
                height: RoundedNumber {
                    value: -height.value,
                    ..height
                },
            }),
        }
    }

    /// Returns true if all given positions are certainly behind the plane.
    ///
    /// `ways` contains the vectors from the viewpoint to the positions.
    pub fn hides(&self, ways: &[Rounded]) -> bool {
        ways.iter().all(|way| {
            let along = self.normal.dot(way);
            let value = along.value - self.height.value;
            let error =
                along.error + self.height.error + U * (along.value.abs() + self.height.value.abs());
            RoundedNumber { value, error }.sign() == Some(1)
        })
    }

    /// Returns true if both faces have the same points, so that they are in one plane.
    pub fn has_points_of(&self, other: &Self) -> bool {
        other.points.iter().all(|p| self.points.contains(p))
    }

    /// Returns true if both faces are known to be in one plane.
    pub fn is_level_with(&self, eye: &Eye<'_>, other: &Self) -> bool {
        other
            .points
            .iter()
            .all(|p| eye.is_in_plane(*p, self.points) == Some(true))
    }

    /// Returns the plane that separates the directions in which `other` is nearer from the other directions.
    pub fn meet(&self, other: &Self) -> EyePlane {
        let normal = Rounded::combination(self.height, &other.normal, other.height, &self.normal);
        EyePlane {
            kind: PlaneOrigin::Meet(self.points, other.points),
            normal: normal.scaled(),
        }
    }
}

/// Computes the normal of a plane in integers, up to a positive factor.
fn normal_exactly(eye: &Eye<'_>, kind: PlaneOrigin) -> IntegerVector {
    match kind {
        PlaneOrigin::Edge(a, b) => eye::cross(&eye.to_exactly(a), &eye.to_exactly(b)),
        PlaneOrigin::Meet(first, second) => {
            let [(n, h), (m, g)] = [first, second].map(|[a, b, c]| {
                let normal = eye::cross(&eye.between_exactly(a, b), &eye.between_exactly(a, c));
                let height = eye::dot(&eye.to_exactly(a), &normal);
                (normal, height)
            });
            std::array::from_fn(|k| &h * &m[k] - &g * &n[k])
        }
        PlaneOrigin::Normal(n) => {
            use sightline_geometry::predicates::dyadic;
            let unit = eye::unit_of(n.iter().copied());
            n.map(|c| {
                let (mantissa, exponent) = dyadic(c);
                dashu_int::IBig::from(mantissa) << (exponent.saturating_sub(unit)).max(0) as usize
            })
        }
    }
}

/// Returns true if a triangle with area contains the viewpoint. The triangle contains its border.
pub fn holds(eye: &Eye<'_>, points: [u32; 3]) -> bool {
    if Facing::new(eye, points).is_some() {
        return false;
    }
    let ways = points.map(|p| eye.to_exactly(p));
    let normal = {
        let [a, b, c] = points;
        eye::cross(&eye.between_exactly(a, b), &eye.between_exactly(a, c))
    };
    // The viewpoint is in the triangle's plane. The triangle contains the viewpoint if the viewpoint is on
    // the inner side of each edge or on the edge.
    (0..3).all(|k| {
        eye::sign(&eye::dot(
            &eye::cross(&ways[k], &ways[(k + 1) % 3]),
            &normal,
        )) >= 0
    })
}
