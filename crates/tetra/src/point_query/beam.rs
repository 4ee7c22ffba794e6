//! Beams: convex cones of directions, and their cuts by planes through the viewpoint.
//!
//! A beam is the ring of its corners; from each corner to the next, the border lies in one plane. The normals
//! of sides point inwards. A corner between sides with the normals n and m, in the ring's order, has the
//! direction n × m. The normal of the side between the corners v and w is a positive multiple of v × w. The
//! angle between two directions of a beam is at most a right angle, because beams begin as octants.

use sightline_geometry::vector::dot;

use super::eye::Eye;
use super::planes::{Corner, EyePlane, Facing, PlaneOrigin, Planes, Side};
use super::rounded::{BOUND, Rounded, unit};

/// A corner of a ring, and the side of the border from this corner to the next.
#[derive(Clone, Copy, Debug)]
pub struct Edge {
    /// The corner.
    pub corner: Corner,
    /// The side that contains the border from the corner to the next corner.
    pub side: Side,
}

/// The corners of a beam in order.
pub type Ring = Vec<Edge>;

/// Creates the ring of an octant: the directions whose coordinates have the given signs.
///
/// Bit k of `signs` is set if coordinate k is negative.
pub fn octant(planes: &mut Planes, eye: &Eye<'_>, signs: u32, ring: &mut Ring) {
    let sides: [Side; 3] = std::array::from_fn(|k| {
        let normal = std::array::from_fn(|j| f64::from(u8::from(j == k)));
        let side = planes.add(EyePlane {
            kind: PlaneOrigin::Normal(normal),
            normal: Rounded::exact(normal),
        });
        if signs >> k & 1 == 1 {
            side.other()
        } else {
            side
        }
    });
    // An odd number of reflections reverses the ring.
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

/// The position of a beam relative to a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BeamSide {
    /// No direction of the beam's interior is on the outer side.
    Inside,
    /// No direction of the beam's interior is on the inner side.
    Outside,
    /// The beam's interior has directions on both sides.
    Both,
}

/// Computes the sign of each corner relative to a side, in `signs`: 1 inside, 0 on the plane, −1 outside.
/// Returns the position of the beam.
#[inline]
pub fn place(
    planes: &mut Planes,
    eye: &Eye<'_>,
    ring: &[Edge],
    side: Side,
    signs: &mut Vec<i32>,
) -> BeamSide {
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
        (true, true) => BeamSide::Both,
        (_, false) => BeamSide::Inside,
        (false, true) => BeamSide::Outside,
    }
}

/// Divides a beam that has corners on both sides of a plane into the parts `inside` and `outside`.
///
/// `signs` contains the signs that [`place`] computed for the same side.
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
            // No border lies in the plane: otherwise all of the beam would be on one side.
            (1, _) | (0, _) => inside.push(*edge),
            _ => outside.push(*edge),
        }
    }
}

/// Returns a direction near the middle of a beam that is certainly inside the beam.
///
/// Returns `None` if rounding errors are too large to be certain.
pub fn middle(planes: &Planes, ring: &[Edge]) -> Option<[f64; 3]> {
    let way = Rounded::exact(center(ring)).scaled();
    let way = Rounded::exact(way.v);
    let inside = ring
        .iter()
        .all(|e| way.dot(&planes.normal(e.side)).sign() == Some(1));
    inside.then_some(way.v)
}

/// Computes the two widths of a beam as sines, rounded.
///
/// The first is the minimum, over the sides of the beam, of the largest distance of a corner from the plane
/// of the side. The second is the maximum distance between two corners. Both refer to corners at distance 1
/// from the viewpoint. The widths decide if a mode's angle drops or keeps a beam, and do not decide
/// visibility.
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

/// Returns a direction near the middle of a ring, rounded, of any length.
pub fn center(ring: &[Edge]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for edge in ring {
        let way = unit(edge.corner.way.v);
        (0..3).for_each(|k| sum[k] += way[k]);
    }
    sum
}

/// Returns the square of a beam's radius around the middle of its corners, at distance 1 from the viewpoint,
/// rounded.
pub fn radius(ring: &[Edge]) -> f64 {
    let middle = unit(center(ring));
    ring.iter().fold(0.0f64, |most, e| {
        let way = unit(e.corner.way.v);
        most.max((0..3).fold(0.0, |sum, k| {
            sum + (way[k] - middle[k]) * (way[k] - middle[k])
        }))
    })
}

/// Returns an upper bound of the square of the distance, within a beam, of a face's plane from the viewpoint.
/// The bound includes roundings.
pub fn reach(ring: &[Edge], face: &Facing) -> f64 {
    // The part of the plane in the beam is convex, so its farthest point is a corner.
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
