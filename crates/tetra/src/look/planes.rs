//! Planes through the viewpoint, the directions where two of them meet, and on which side of a third one such
//! a direction is.
//!
//! Directions are decided on, never points: a plane through the viewpoint is its normal, a corner of a beam
//! is the cross product of two normals, and a side is the sign of a determinant of three. Doubles with bounds
//! decide most signs; what a corner and a plane have in common decides most zeros; integers decide the rest.

use sightline_geometry::rounding::UNIT as U;

use super::eye::{self, Eye, IntegerVector};
use super::rounded::{Rounded, RoundedNumber};

/// What defines a plane through the viewpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Through two points, the first with the smaller number: the normal is (a − x) × (b − x).
    Edge(u32, u32),
    /// Through the line in which the planes of two faces meet. A face is three points, ordered so that its
    /// plane is in front of its normal: (b − a) × (c − a) · (a − x) > 0. On the positive side the second one
    /// is nearer.
    Meet([u32; 3], [u32; 3]),
    /// With this normal.
    Normal([f64; 3]),
}

/// A plane through the viewpoint.
#[derive(Clone, Copy, Debug)]
pub struct EyePlane {
    /// Its definition.
    pub kind: Kind,
    /// Its normal, scaled.
    pub normal: Rounded,
}

impl EyePlane {
    /// The plane through two points.
    #[inline]
    pub fn edge(eye: &Eye<'_>, a: u32, b: u32) -> Self {
        let (low, high) = (a.min(b), a.max(b));
        // The edge's own vector is far more precise than the difference of two long ways.
        let normal = eye.to(low).cross(&eye.between(low, high)).scaled();
        Self {
            kind: Kind::Edge(low, high),
            normal,
        }
    }
}

/// A plane of a list, with a side: twice its index, and one more where the other side is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Side(u32);

impl Side {
    /// The positive side of a plane, or the negative one.
    pub fn new(plane: usize, negative: bool) -> Self {
        Self((plane as u32) << 1 | u32::from(negative))
    }

    /// The plane's index.
    #[inline]
    pub fn plane(self) -> usize {
        (self.0 >> 1) as usize
    }

    /// Whether the negative side is meant.
    #[inline]
    pub fn negative(self) -> bool {
        self.0 & 1 == 1
    }

    /// The other side.
    #[inline]
    pub fn other(self) -> Self {
        Self(self.0 ^ 1)
    }
}

/// No point.
pub const NONE: u32 = u32::MAX;

/// A corner of a beam: the direction of the cross product of the normals of two sides.
#[derive(Clone, Copy, Debug)]
pub struct Corner {
    /// The direction, scaled.
    pub way: Rounded,
    /// The two sides, in this order.
    pub sides: [Side; 2],
    /// The point in this direction that both planes are known to hold, or [`NONE`].
    pub point: u32,
}

/// The planes of a query, and how often its signs were decided and needed integers.
#[derive(Default)]
pub struct Planes {
    /// The planes. The newest are dropped with the beams that need them.
    pub list: Vec<EyePlane>,
    /// Signs that were decided.
    pub decided: u64,
    /// Signs that needed integers.
    pub integers: u64,
}

/// Directions with a larger relative bound are computed again in integers: signs of such directions would all
/// need integers.
const POOR: f64 = 1.0 / (1u64 << 30) as f64;

impl Planes {
    /// Adds a plane.
    pub fn add(&mut self, plane: EyePlane) -> Side {
        self.list.push(plane);
        Side::new(self.list.len() - 1, false)
    }

    /// Adds the plane through two points, with the side on which (a − x) × (b − x) is.
    pub fn add_edge(&mut self, eye: &Eye<'_>, a: u32, b: u32) -> Side {
        self.add(EyePlane::edge(eye, a, b));
        Side::new(self.list.len() - 1, a > b)
    }

    /// The two points of an edge's plane, in the order that has the side inside.
    pub fn edge_of(&self, side: Side) -> Option<(u32, u32)> {
        match self.list[side.plane()].kind {
            Kind::Edge(a, b) if side.negative() => Some((b, a)),
            Kind::Edge(a, b) => Some((a, b)),
            _ => None,
        }
    }

    /// The normal of a side.
    #[inline]
    pub fn normal(&self, side: Side) -> Rounded {
        let normal = &self.list[side.plane()].normal;
        if side.negative() {
            normal.reversed()
        } else {
            *normal
        }
    }

    /// The sign of a corner's product with a plane's normal.
    #[inline]
    pub fn sign_of(&mut self, eye: &Eye<'_>, corner: &Corner, plane: &EyePlane) -> i32 {
        self.decided += 1;
        match corner.way.side(&plane.normal) {
            Some(sign) => sign,
            None => self.sign_closely(eye, corner, plane),
        }
    }

    /// The same where quick bounds leave it open.
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
            Kind::Edge(a, b) if corner.point != NONE => eye.turn([corner.point, a, b]),
            _ => None,
        };
        short.unwrap_or_else(|| {
            let way = self.way_exactly(eye, corner);
            eye::sign(&eye::dot(&way, &normal_exactly(eye, plane.kind)))
        })
    }

    /// The corner where two sides meet, between two directions less than a right angle apart.
    pub fn corner(
        &mut self,
        eye: &Eye<'_>,
        sides: [Side; 2],
        from: &Rounded,
        to: &Rounded,
    ) -> Corner {
        let point = match sides.map(|s| self.list[s.plane()].kind) {
            [Kind::Edge(a, b), Kind::Edge(c, d)] if a == c || a == d => Some((a, b, c, d)),
            [Kind::Edge(a, b), Kind::Edge(c, d)] if b == c || b == d => Some((b, a, c, d)),
            _ => None,
        };
        if let Some((point, ..)) = point {
            let way = eye.to(point).scaled();
            // The planes meet in the line through the point, and the corner is a positive combination of both
            // directions: its scalar product with their sum is at least half of all their lengths, far beyond
            // the bounds of good directions.
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
        // Also where the product is 0 beside its bound, or not a number.
        if way.error.is_nan() || way.error > POOR * way.size() {
            self.integers += 1;
            corner.way = eye::rounded(&self.way_exactly(eye, &corner));
        }
        corner
    }

    /// A corner's direction in integers.
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
    /// The three points, in the order that puts the plane in front of the normal.
    pub points: [u32; 3],
    /// The normal (b − a) × (c − a).
    pub normal: Rounded,
    /// Its scalar product with a − x: positive.
    pub height: RoundedNumber,
}

impl Facing {
    /// The plane of three points, or nothing if the viewpoint is in it.
    #[inline]
    pub fn of(eye: &Eye<'_>, points: [u32; 3]) -> Option<Self> {
        let [a, b, c] = points;
        let normal = eye.between(a, b).cross(&eye.between(a, c));
        let height = eye.to(a).dot(&normal);
        // (a − x) · ((b − a) × (c − a)) is the determinant of the ways to the three.
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

    /// Whether all of some places are behind the plane for certain; `ways` lead to them.
    pub fn hides(&self, ways: &[Rounded]) -> bool {
        ways.iter().all(|way| {
            let along = self.normal.dot(way);
            let value = along.value - self.height.value;
            let error =
                along.error + self.height.error + U * (along.value.abs() + self.height.value.abs());
            RoundedNumber { value, error }.sign() == Some(1)
        })
    }

    /// Whether both have the same points, so that they are in one plane.
    pub fn has_points_of(&self, other: &Self) -> bool {
        other.points.iter().all(|p| self.points.contains(p))
    }

    /// Whether both are in one plane, unless it is open.
    pub fn is_level_with(&self, eye: &Eye<'_>, other: &Self) -> bool {
        other
            .points
            .iter()
            .all(|p| eye.is_in_plane(*p, self.points) == Some(true))
    }

    /// The plane that divides the directions in which the other face is nearer from those in which this one
    /// is.
    pub fn meet(&self, other: &Self) -> EyePlane {
        let normal = Rounded::combination(self.height, &other.normal, other.height, &self.normal);
        EyePlane {
            kind: Kind::Meet(self.points, other.points),
            normal: normal.scaled(),
        }
    }
}

/// The normal of a plane in integers, up to a positive factor.
fn normal_exactly(eye: &Eye<'_>, kind: Kind) -> IntegerVector {
    match kind {
        Kind::Edge(a, b) => eye::cross(&eye.to_exactly(a), &eye.to_exactly(b)),
        Kind::Meet(first, second) => {
            let [(n, h), (m, g)] = [first, second].map(|[a, b, c]| {
                let normal = eye::cross(&eye.between_exactly(a, b), &eye.between_exactly(a, c));
                let height = eye::dot(&eye.to_exactly(a), &normal);
                (normal, height)
            });
            std::array::from_fn(|k| &h * &m[k] - &g * &n[k])
        }
        Kind::Normal(n) => {
            use sightline_geometry::predicates::dyadic;
            let unit = eye::unit_of(n.iter().copied());
            n.map(|c| {
                let (mantissa, exponent) = dyadic(c);
                dashu_int::IBig::from(mantissa) << (exponent.saturating_sub(unit)).max(0) as usize
            })
        }
    }
}

/// Whether a triangle with area holds the viewpoint, its border included.
pub fn holds(eye: &Eye<'_>, points: [u32; 3]) -> bool {
    if Facing::of(eye, points).is_some() {
        return false;
    }
    let ways = points.map(|p| eye.to_exactly(p));
    let normal = {
        let [a, b, c] = points;
        eye::cross(&eye.between_exactly(a, b), &eye.between_exactly(a, c))
    };
    // The viewpoint is in the plane: it is on the inner side of each edge or on it.
    (0..3).all(|k| {
        eye::sign(&eye::dot(
            &eye::cross(&ways[k], &ways[(k + 1) % 3]),
            &normal,
        )) >= 0
    })
}
