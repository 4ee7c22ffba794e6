//! Solid angles of beams, also of the part of a beam within round cones.

use std::f64::consts::PI;

use sightline_geometry::vector::{cross, dot};

use super::beam::Edge;
use super::rounded::{V, unit};

/// The solid angle of the triangle of three unit vectors (van Oosterom and Strackee, "The Solid Angle of a
/// Plane Triangle", 1983).
fn triangle(a: V, b: V, c: V) -> f64 {
    // The volume from differences: beside long vectors that nearly agree it loses the least.
    let (p, q): (V, V) = (
        std::array::from_fn(|k| b[k] - a[k]),
        std::array::from_fn(|k| c[k] - a[k]),
    );
    2.0 * libm::atan2(dot(a, cross(p, q)), 1.0 + dot(a, b) + dot(b, c) + dot(c, a))
}

/// The solid angle of a beam, in steradians.
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

/// Corners that are nearer to each other are one: some hundred roundings.
const SHORTEST: f64 = 1e-14;

/// Arcs that are this near to a whole circle may be none.
const NEARLY: f64 = 1e-3;

/// A round cone of directions around a unit vector.
#[derive(Clone, Copy, Debug)]
pub struct Cone {
    /// The axis, of length 1.
    pub axis: V,
    /// The cosine of half of its angle, in 0…1.
    pub cosine: f64,
}

impl Cone {
    /// Whether a direction of length 1 is inside.
    pub fn holds(&self, way: V) -> bool {
        dot(way, self.axis) > self.cosine
    }
}

/// A piece of a region's border: from one direction to the next along a great circle, or along the circle of
/// a cone.
#[derive(Clone, Copy, Debug)]
struct BorderPiece {
    from: V,
    to: V,
    /// The cone whose circle it follows, counter-clockwise around its axis.
    circle: Option<usize>,
}

/// The part of a beam that is within some cones.
enum BeamPart {
    /// All of the beam.
    Whole,
    /// There is none.
    Nothing,
    /// The beam is thinner than rounding: whether a corner of it is in the part.
    Thin(bool),
    /// The corners of the beam, and the border of the part.
    Within(Vec<V>, Vec<BorderPiece>),
}

fn part(ring: &[Edge], cones: &[Cone]) -> BeamPart {
    let mut ways: Vec<V> = ring.iter().map(|e| unit(e.corner.way.v)).collect();
    if cones.iter().all(|cone| ways.iter().all(|w| cone.holds(*w))) {
        // Cones are convex.
        return BeamPart::Whole;
    }
    // Between corners that are one but for rounding a border has no direction.
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

/// The solid angle of the part of a beam that is within all cones; nothing where there is no such part. With
/// Gauss and Bonnet: 2π less the turns at the corners, less the curvature of the arcs, which on a circle is
/// the cosine times the angle around its axis. At most two cones, none over a half space.
///
/// The part is in the beam, which is within an octant. So where a turn of nearly half a circle has the wrong
/// sign, as in parts that are thinner than rounding, the whole turn that the sum is off by is taken away, and
/// what is left is within the beam's own solid angle.
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
    // Not a number where the border is thinner than rounding everywhere.
    Some(if sum.is_nan() {
        0.0
    } else {
        sum.clamp(0.0, area(ring))
    })
}

/// Whether the part of a beam that is within some cones is in another one as well, or there is none. The part
/// is in an octant and the cone is convex, so it is enough that the part's border is.
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

/// Whether two directions are one but for rounding.
fn is_near(a: &V, b: &V) -> bool {
    (0..3).all(|k| (a[k] - b[k]).abs() < SHORTEST)
}

/// Whether a direction is in a ring, or on its border but for rounding: short edges have no exact planes.
fn inside_ring(ways: &[V], v: V) -> bool {
    (0..ways.len()).all(|k| dot(cross(ways[k], ways[(k + 1) % ways.len()]), v) > -1e-15)
}

/// Positions along a piece, as parts of its whole, at which it crosses a cone's circle.
fn crossings(piece: &BorderPiece, cones: &[Cone], cone: &Cone) -> Vec<(f64, V)> {
    // Points of the piece: centre + cos(t)·e + sin(t)·f for t from 0 to its angle.
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
    let mut found: Vec<(f64, V)> = [middle - half, middle + half]
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

/// A piece as a circle: its centre, two axes, and the angle it runs through.
fn frame(piece: &BorderPiece, cones: &[Cone]) -> (V, V, V, f64) {
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
            let e: V = std::array::from_fn(|k| piece.from[k] - centre[k]);
            let f = cross(axis, e);
            let to: V = std::array::from_fn(|k| piece.to[k] - centre[k]);
            let angle = libm::atan2(dot(f, to), dot(e, to)).rem_euclid(2.0 * PI);
            // A whole circle ends where it starts.
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

/// The border of the part within one more cone; nothing if there is no such part.
fn within(
    border: &[BorderPiece],
    cones: &[Cone],
    number: usize,
    holds: impl Fn(V) -> bool,
) -> Option<Vec<BorderPiece>> {
    let cone = &cones[number];
    let mut kept: Vec<BorderPiece> = Vec::new();
    for piece in border {
        let (centre, e, f, angle) = frame(piece, cones);
        let at = |t: f64| -> V {
            std::array::from_fn(|k| centre[k] + libm::cos(t) * e[k] + libm::sin(t) * f[k])
        };
        let mut stops = vec![(0.0, piece.from)];
        stops.extend(crossings(piece, cones, cone));
        stops.push((angle, piece.to));
        for pair in stops.windows(2) {
            // Between two crossings all of the piece is on one side.
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
        // All of the circle is inside of the region, or nothing is.
        let others = cones[..number].iter().all(|c| c.holds(cone.axis));
        if !(holds(cone.axis) && others) {
            return None;
        }
        let e = unit(cross(cone.axis, smallest_axis(cone.axis)));
        let sine = (1.0 - cone.cosine * cone.cosine).max(0.0).sqrt();
        let start: V = std::array::from_fn(|k| cone.axis[k] * cone.cosine + e[k] * sine);
        return Some(vec![BorderPiece {
            from: start,
            to: start,
            circle: Some(number),
        }]);
    }
    // Arcs of the new circle join what was cut off.
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

/// The coordinate axis that a vector is farthest from.
fn smallest_axis(v: V) -> V {
    let least = (0..3)
        .min_by(|a, b| v[*a].abs().total_cmp(&v[*b].abs()))
        .unwrap_or(0);
    std::array::from_fn(|k| f64::from(u8::from(k == least)))
}

/// The solid angle within a border, but for whole turns.
fn enclosed(border: &[BorderPiece], cones: &[Cone], holds: impl Fn(V) -> bool) -> f64 {
    let mut sum = 2.0 * PI;
    for (k, piece) in border.iter().enumerate() {
        let (centre, e, f, mut angle) = frame(piece, cones);
        let last = border.len() == 1;
        if let Some(n) = piece.circle {
            // From a place to nearly the same one it is all of the circle or nothing.
            if !last && angle > 2.0 * PI - NEARLY {
                let middle = std::array::from_fn(|j| centre[j] - e[j]);
                angle -= if holds(middle) { 0.0 } else { 2.0 * PI };
            }
            sum -= cones[n].cosine * angle;
        }
        if last && piece.from == piece.to {
            continue;
        }
        // Directions of travel at the piece's end and at the next one's start.
        let leaving: V = std::array::from_fn(|j| libm::cos(angle) * f[j] - libm::sin(angle) * e[j]);
        let next = &border[(k + 1) % border.len()];
        let starting = frame(next, cones).2;
        let (p, q) = (unit(leaving), unit(starting));
        sum -= libm::atan2(dot(piece.to, cross(p, q)), dot(p, q));
    }
    sum
}
