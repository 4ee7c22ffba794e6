//! Beams: convex cones of directions, and how a plane through the viewpoint cuts them.
//!
//! A beam is the ring of its corners; from each corner to the next the border lies in one plane. Sides point
//! inwards. A corner between the planes n and m, in the ring's order, is in the direction n × m, and the
//! plane between the corners v and w has its normal on the side of v × w. Angles are below a right angle,
//! because beams begin as octants.

use sightline_geometry::vector::dot;

use super::eye::Eye;
use super::planes::{Corner, EyePlane, Facing, Kind, Planes, Side};
use super::rounded::{BOUND, Rounded, unit};

/// A corner of a ring and the side of the border from it to the next corner.
#[derive(Clone, Copy, Debug)]
pub struct Edge {
    /// The corner.
    pub corner: Corner,
    /// The side.
    pub side: Side,
}

/// The corners of a beam in order.
pub type Ring = Vec<Edge>;

/// The eighth of all directions in which the coordinates have the given signs (bit k for a negative
/// coordinate k).
pub fn octant(planes: &mut Planes, eye: &Eye<'_>, signs: u32, ring: &mut Ring) {
    let sides: [Side; 3] = std::array::from_fn(|k| {
        let normal = std::array::from_fn(|j| f64::from(u8::from(j == k)));
        let side = planes.add(EyePlane {
            kind: Kind::Normal(normal),
            normal: Rounded::exact(normal),
        });
        if signs >> k & 1 == 1 {
            side.other()
        } else {
            side
        }
    });
    // An odd number of reflections turns the ring.
    let order = if signs.count_ones().is_multiple_of(2) {
        [0, 1, 2]
    } else {
        [0, 2, 1]
    };
    let sides = order.map(|k| sides[k]);
    let zero = Rounded::default();
    ring.clear();
    for k in 0..3 {
        let corner = planes.corner(eye, [sides[(k + 2) % 3], sides[k]], &zero, &zero);
        ring.push(Edge {
            corner,
            side: sides[k],
        });
    }
}

/// Where a beam is relative to a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// No direction of its interior is on the outer side.
    Inside,
    /// No direction of its interior is on the inner side.
    Outside,
    /// It has directions on both.
    Both,
}

/// The sides of all corners, and what follows for the beam.
#[inline]
pub fn place(
    planes: &mut Planes,
    eye: &Eye<'_>,
    ring: &[Edge],
    side: Side,
    signs: &mut Vec<i32>,
) -> Place {
    signs.clear();
    let (mut inner, mut outer) = (false, false);
    let plane = planes.list[side.plane()];
    signs.extend(ring.iter().map(|edge| {
        let sign = planes.sign_of(eye, &edge.corner, &plane);
        let sign = if side.negative() { -sign } else { sign };
        inner |= sign > 0;
        outer |= sign < 0;
        sign
    }));
    match (inner, outer) {
        (true, true) => Place::Both,
        (_, false) => Place::Inside,
        (false, true) => Place::Outside,
    }
}

/// Divides a beam that has corners on both sides; `signs` are those of [`place`].
pub fn cut(
    planes: &mut Planes,
    eye: &Eye<'_>,
    ring: &[Edge],
    side: Side,
    signs: &[i32],
    inside: &mut Ring,
    outside: &mut Ring,
) {
    inside.clear();
    outside.clear();
    for (k, edge) in ring.iter().enumerate() {
        let next = if k + 1 == ring.len() { 0 } else { k + 1 };
        let (here, there) = (signs[k], signs[next]);
        let meet = |planes: &mut Planes, sides: [Side; 2]| {
            planes.corner(eye, sides, &edge.corner.way, &ring[next].corner.way)
        };
        match (here, there) {
            (1, -1) => {
                inside.push(*edge);
                let corner = meet(planes, [edge.side, side]);
                inside.push(Edge { corner, side });
                outside.push(Edge {
                    corner,
                    side: edge.side,
                });
            }
            (-1, 1) => {
                outside.push(*edge);
                let corner = meet(planes, [side, edge.side]);
                outside.push(Edge {
                    corner,
                    side: side.other(),
                });
                inside.push(Edge {
                    corner,
                    side: edge.side,
                });
            }
            (0, -1) => {
                inside.push(Edge {
                    corner: edge.corner,
                    side,
                });
                outside.push(*edge);
            }
            (0, 1) => {
                outside.push(Edge {
                    corner: edge.corner,
                    side: side.other(),
                });
                inside.push(*edge);
            }
            // An edge in the plane itself cannot be: then all of the beam would be on one side.
            (1, _) | (0, _) => inside.push(*edge),
            _ => outside.push(*edge),
        }
    }
}

/// A direction inside of a beam, which no rounding has put outside; nothing if no double near the middle is
/// certainly inside.
pub fn middle(planes: &Planes, ring: &[Edge]) -> Option<[f64; 3]> {
    let way = Rounded::exact(center(ring)).scaled();
    let way = Rounded::exact(way.v);
    let inside = ring
        .iter()
        .all(|e| way.dot(&planes.normal(e.side)).sign() == Some(1));
    inside.then_some(way.v)
}

/// The widths of a beam as sines: the least distance between two parallel great circles around it, and the
/// largest distance between two corners. Rounded: they decide what an angle leaves out, never what is seen.
pub fn widths(planes: &Planes, ring: &[Edge]) -> (f64, f64) {
    let mut narrow = f64::INFINITY;
    let mut wide = 0.0f64;
    for edge in ring {
        let n = unit(planes.normal(edge.side).v);
        let here = unit(edge.corner.way.v);
        let mut far = 0.0f64;
        for other in ring {
            let w = unit(other.corner.way.v);
            far = far.max(dot(n, w));
            let apart: [f64; 3] = std::array::from_fn(|k| w[k] - here[k]);
            wide = wide.max(dot(apart, apart));
        }
        narrow = narrow.min(far);
    }
    (narrow, wide.sqrt())
}

/// A direction near the middle of a ring, rounded, of any length.
pub fn center(ring: &[Edge]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for edge in ring {
        let way = unit(edge.corner.way.v);
        (0..3).for_each(|k| sum[k] += way[k]);
    }
    sum
}

/// The square of the radius of a beam around the middle of its corners, at distance 1, rounded.
pub fn radius(ring: &[Edge]) -> f64 {
    let middle = unit(center(ring));
    ring.iter().fold(0.0f64, |most, e| {
        let way = unit(e.corner.way.v);
        most.max((0..3).fold(0.0, |sum, k| {
            sum + (way[k] - middle[k]) * (way[k] - middle[k])
        }))
    })
}

/// The square of how far away a face is at most in a beam, with what rounding may add.
pub fn reach(ring: &[Edge], face: &Facing) -> f64 {
    // The part of the plane in the beam is convex, so a corner is its farthest place.
    ring.iter().fold(0.0, |most: f64, edge| {
        let way = &edge.corner.way;
        let along = face.normal.dot(way);
        let least = along.value - along.error;
        if least <= 0.0 {
            return f64::INFINITY;
        }
        let size = way.v.iter().fold(0.0, |sum, c| {
            sum + (c.abs() + way.error) * (c.abs() + way.error)
        });
        let times = (face.height.value + face.height.error) / least;
        most.max(times * times * size * (1.0 + BOUND))
    })
}
