//! Solid angles of beams, and of the parts of beams within round cones.

use std::f64::consts::PI;

use sightline_geometry::vector::{cross, dot};

use super::beam::Edge;
use super::rounded::{Vector, unit};

/// Computes the solid angle of the triangle of three unit vectors, in steradians.
///
/// The formula is from van Oosterom and Strackee, "The Solid Angle of a Plane Triangle", 1983.
fn triangle(a: Vector, b: Vector, c: Vector) -> f64 {
    // Differences lose the least precision for vectors that nearly agree, so the determinant is computed from
    // differences.
    let (p, q): (Vector, Vector) = (
        std::array::from_fn(|k| b[k] - a[k]),
        std::array::from_fn(|k| c[k] - a[k]),
    );
    2.0 * libm::atan2(dot(a, cross(p, q)), 1.0 + dot(a, b) + dot(b, c) + dot(c, a))
}

/// Returns the solid angle of a beam, in steradians.
pub fn area(ring: &[Edge]) -> f64 {
    let Some((first, rest)) = ring.split_first() else {
        return 0.0;
    };
    let first = unit(first.corner.way.v);
    let mut sum = 0.0;
    for pair in rest.windows(2) {
        sum += triangle(
            first,
            unit(pair[0].corner.way.v),
            unit(pair[1].corner.way.v),
        );
    }
    sum.max(0.0)
}

/// Distance, on each axis, below which two unit vectors count as one corner: about a hundred roundings.
const SHORTEST: f64 = 1e-14;

/// Angle in radians. An arc that is shorter than a full circle by less than this angle may in fact be empty.
const NEARLY: f64 = 1e-3;

/// A round cone of directions around a unit vector.
#[derive(Clone, Copy, Debug)]
pub struct Cone {
    /// The axis, of length 1.
    pub axis: Vector,
    /// The cosine of half of the cone's angle, in 0…1.
    pub cosine: f64,
}

impl Cone {
    /// Returns true if a direction, given as a unit vector, is inside the cone.
    pub fn holds(&self, way: Vector) -> bool {
        dot(way, self.axis) > self.cosine
    }
}

/// A piece of a region's border, along a great circle or along the circle of a cone.
#[derive(Clone, Copy, Debug)]
struct BorderPiece {
    from: Vector,
    to: Vector,
    /// The index of the cone whose circle the piece follows, counter-clockwise around the cone's axis. `None`
    /// for a great circle.
    circle: Option<usize>,
}

/// The part of a beam that is within all of some cones.
enum BeamPart {
    /// The part is the whole beam.
    Whole,
    /// The part is empty.
    Nothing,
    /// The beam is thinner than rounding errors. The flag is true if a corner of the beam is within all
    /// cones.
    Thin(bool),
    /// The corners of the beam, and the border of the part.
    Within(Vec<Vector>, Vec<BorderPiece>),
}

fn part(ring: &[Edge], cones: &[Cone]) -> BeamPart {
    let mut ways: Vec<Vector> = ring.iter().map(|e| unit(e.corner.way.v)).collect();
    if cones.iter().all(|cone| ways.iter().all(|w| cone.holds(*w))) {
        // Cones are convex, so a cone that contains all corners of a beam contains the beam.
        return BeamPart::Whole;
    }
    // A border between corners that differ only by rounding has no direction.
    ways.dedup_by(|a, b| is_near(a, b));
    while ways.len() > 1 && is_near(&ways[0], &ways[ways.len() - 1]) {
        ways.pop();
    }
    if ways.len() < 3 {
        return BeamPart::Thin(ways.iter().any(|w| cones.iter().all(|cone| cone.holds(*w))));
    }
    let mut border: Vec<BorderPiece> = (0..ways.len())
        .map(|k| BorderPiece {
            from: ways[k],
            to: ways[(k + 1) % ways.len()],
            circle: None,
        })
        .collect();
    for number in 0..cones.len() {
        match within(&border, cones, number, |v| inside_ring(&ways, v)) {
            Some(next) => border = next,
            None => return BeamPart::Nothing,
        }
    }
    BeamPart::Within(ways, border)
}

/// Computes the solid angle of the part of a beam that is within all cones, in steradians.
///
/// Returns `None` if the part is empty. The formula follows from the Gauss–Bonnet theorem: 2π minus the turns
/// at the corners, minus the total curvature of the arcs. The total curvature of a circular arc is the cosine
/// of the cone times the angle around the axis. At most two cones are allowed, each at most as wide as a half
/// space.
///
/// The part is in the beam, which is within an octant. If the part is thinner than rounding errors, a turn of
/// nearly half a circle can have the wrong sign. Then the sum is wrong by a full turn, which the function
/// removes. The result is at most the beam's own solid angle.
pub fn area_within(ring: &[Edge], cones: &[Cone]) -> Option<f64> {
    let (ways, border) = match part(ring, cones) {
        BeamPart::Whole => return Some(area(ring)),
        BeamPart::Nothing => return None,
        BeamPart::Thin(some) => return some.then_some(0.0),
        BeamPart::Within(ways, border) => (ways, border),
    };
    let turn = 2.0 * PI;
    let sum = enclosed(&border, cones, |v| inside_ring(&ways, v)).rem_euclid(turn);
    let sum = if sum > PI { sum - turn } else { sum };
    // The sum is NaN if the border is thinner than rounding errors everywhere.
    Some(if sum.is_nan() {
        0.0
    } else {
        sum.clamp(0.0, area(ring))
    })
}

/// Returns true if `cone` contains the part of a beam that is within all of `cones`.
///
/// The result is true if the part is empty.
///
/// The part is in an octant and the cone is convex, so it is sufficient to test the border of the part.
pub fn is_within(ring: &[Edge], cones: &[Cone], cone: &Cone) -> bool {
    match part(ring, cones) {
        BeamPart::Whole => ring.iter().all(|e| cone.holds(unit(e.corner.way.v))),
        BeamPart::Nothing => true,
        BeamPart::Thin(_) => ring
            .iter()
            .map(|e| unit(e.corner.way.v))
            .all(|w| cone.holds(w) || cones.iter().any(|other| !other.holds(w))),
        BeamPart::Within(_, border) => {
            let is_in = |piece: &BorderPiece| {
                [piece.from, piece.to].iter().all(|v| cone.holds(*v))
                    && crossings(piece, cones, cone).is_empty()
            };
            border.iter().all(is_in)
        }
    }
}

/// Returns true if two directions differ only by rounding.
fn is_near(a: &Vector, b: &Vector) -> bool {
    (0..3).all(|k| (a[k] - b[k]).abs() < SHORTEST)
}

/// Returns true if a direction is in the ring with the corners `ways`, or on its border up to rounding.
///
/// The tolerance is necessary because short edges do not have exact planes.
fn inside_ring(ways: &[Vector], v: Vector) -> bool {
    (0..ways.len()).all(|k| dot(cross(ways[k], ways[(k + 1) % ways.len()]), v) > -1e-15)
}

/// Returns the crossings of a piece with a cone's circle: the angle along the piece in radians, and the
/// direction of each crossing.
fn crossings(piece: &BorderPiece, cones: &[Cone], cone: &Cone) -> Vec<(f64, Vector)> {
    // The points of the piece are centre + cos(t)·e + sin(t)·f for t from 0 to its angle.
    let (centre, e, f, angle) = frame(piece, cones);
    let (c, a, b) = (
        dot(centre, cone.axis) - cone.cosine,
        dot(e, cone.axis),
        dot(f, cone.axis),
    );
    let size = (a * a + b * b).sqrt();
    if size <= c.abs() {
        return Vec::new();
    }
    let (middle, half) = (libm::atan2(b, a), libm::acos(-c / size));
    let mut found: Vec<(f64, Vector)> = [middle - half, middle + half]
        .into_iter()
        .map(|t| t.rem_euclid(2.0 * PI))
        .filter(|t| *t < angle)
        .map(|t| {
            (
                t,
                std::array::from_fn(|k| centre[k] + libm::cos(t) * e[k] + libm::sin(t) * f[k]),
            )
        })
        .collect();
    found.sort_by(|x, y| x.0.total_cmp(&y.0));
    found
}

/// Returns the circle of a piece: the centre, two perpendicular vectors from the centre (the first to the
/// start of the piece), and the angle that the piece spans, in radians.
fn frame(piece: &BorderPiece, cones: &[Cone]) -> (Vector, Vector, Vector, f64) {
    match piece.circle {
        None => {
            let normal = unit(cross(piece.from, piece.to));
            let f = cross(normal, piece.from);
            let angle = libm::atan2(dot(f, piece.to), dot(piece.from, piece.to));
            ([0.0; 3], piece.from, f, angle)
        }
        Some(n) => {
            let Cone { axis, cosine } = cones[n];
            let centre = axis.map(|c| c * cosine);
            let e: Vector = std::array::from_fn(|k| piece.from[k] - centre[k]);
            let f = cross(axis, e);
            let to: Vector = std::array::from_fn(|k| piece.to[k] - centre[k]);
            let angle = libm::atan2(dot(f, to), dot(e, to)).rem_euclid(2.0 * PI);
            // A full circle ends where it starts.
            (
                centre,
                e,
                f,
                if piece.from == piece.to {
                    2.0 * PI
                } else {
                    angle
                },
            )
        }
    }
}

/// Computes the border of a region's part within the cone `cones[number]`, from the border of the region.
/// Returns `None` if the part is empty. `holds` returns true if the beam contains a direction.
fn within(
    border: &[BorderPiece],
    cones: &[Cone],
    number: usize,
    holds: impl Fn(Vector) -> bool,
) -> Option<Vec<BorderPiece>> {
    let cone = &cones[number];
    let mut kept: Vec<BorderPiece> = Vec::new();
    for piece in border {
        let (centre, e, f, angle) = frame(piece, cones);
        let at = |t: f64| -> Vector {
            std::array::from_fn(|k| centre[k] + libm::cos(t) * e[k] + libm::sin(t) * f[k])
        };
        let mut stops = vec![(0.0, piece.from)];
        stops.extend(crossings(piece, cones, cone));
        stops.push((angle, piece.to));
        for pair in stops.windows(2) {
            // Between two crossings, the whole piece is on one side of the circle.
            if pair[1].0 - pair[0].0 > SHORTEST && cone.holds(at((pair[0].0 + pair[1].0) / 2.0)) {
                kept.push(BorderPiece {
                    from: pair[0].1,
                    to: pair[1].1,
                    circle: piece.circle,
                });
            }
        }
    }
    if kept.is_empty() {
        // The cone's circle is completely inside the region, or completely outside.
        let others = cones[..number].iter().all(|c| c.holds(cone.axis));
        if !(holds(cone.axis) && others) {
            return None;
        }
        let e = unit(cross(cone.axis, smallest_axis(cone.axis)));
        let sine = (1.0 - cone.cosine * cone.cosine).max(0.0).sqrt();
        let start: Vector = std::array::from_fn(|k| cone.axis[k] * cone.cosine + e[k] * sine);
        return Some(vec![BorderPiece {
            from: start,
            to: start,
            circle: Some(number),
        }]);
    }
    // Arcs of the new circle close the gaps between the remaining pieces.
    let mut closed = Vec::new();
    for (k, piece) in kept.iter().enumerate() {
        closed.push(*piece);
        let next = &kept[(k + 1) % kept.len()];
        if !is_near(&piece.to, &next.from) {
            closed.push(BorderPiece {
                from: piece.to,
                to: next.from,
                circle: Some(number),
            });
        }
    }
    Some(closed)
}

/// Returns the coordinate axis that forms the largest angle with a vector.
fn smallest_axis(v: Vector) -> Vector {
    let least = (0..3)
        .min_by(|a, b| v[*a].abs().total_cmp(&v[*b].abs()))
        .unwrap_or(0);
    std::array::from_fn(|k| f64::from(u8::from(k == least)))
}

/// Computes the solid angle within a border, up to multiples of 2π. `holds` returns true if the beam contains
/// a direction.
fn enclosed(border: &[BorderPiece], cones: &[Cone], holds: impl Fn(Vector) -> bool) -> f64 {
    let mut sum = 2.0 * PI;
    for (k, piece) in border.iter().enumerate() {
        let (centre, e, f, mut angle) = frame(piece, cones);
        let last = border.len() == 1;
        if let Some(n) = piece.circle {
            // An arc between nearly equal points is a full circle or empty.
            if !last && angle > 2.0 * PI - NEARLY {
                let middle = std::array::from_fn(|j| centre[j] - e[j]);
                angle -= if holds(middle) { 0.0 } else { 2.0 * PI };
            }
            sum -= cones[n].cosine * angle;
        }
        if last && piece.from == piece.to {
            continue;
        }
        // Directions of travel at the end of the piece and at the start of the next piece.
        let leaving: Vector =
            std::array::from_fn(|j| libm::cos(angle) * f[j] - libm::sin(angle) * e[j]);
        let next = &border[(k + 1) % border.len()];
        let starting = frame(next, cones).2;
        let (p, q) = (unit(leaving), unit(starting));
        sum -= libm::atan2(dot(piece.to, cross(p, q)), dot(p, q));
    }
    sum
}
