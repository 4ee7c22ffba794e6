//! The planes of the input with unique numbers.
//!
//! Two planes are equal if both contain the same points of space. Equal planes have the same number, even if
//! the input defines the planes by different points. The numbers follow the order in which planes are first
//! listed, so the numbers do not depend on the machine.

use std::cmp::Ordering;

use glam::Vec3;
use rustc_hash::FxHashMap;
use sightline_geometry::predicates::{dyadic, orient2d_sign, orient3d_sign};

use super::number::{Number, Residue, along_axis, through_points};

/// Marker for a missing plane, cell or tetrahedron.
pub const NONE: u32 = u32::MAX;

/// An oriented plane of the input.
///
/// The plane goes through three points, given as point numbers, or goes through two points and is parallel to
/// a coordinate axis.
///
/// A viewer in front of the plane through a, b and c sees the three points turn counter-clockwise. The front
/// of the plane through a and b along an axis is the side that (b − a) × axis points to. For the axis x, y or
/// z, the third number is `AXIS`, `AXIS` + 1 or `AXIS` + 2 instead of a point number.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Plane(pub [u32; 3]);

impl Plane {
    /// The third number of a plane along the axis x. The next two numbers stand for the axes y and z.
    pub const AXIS: u32 = u32::MAX - 3;

    /// Creates the plane through two points that is parallel to axis 0 (x), 1 (y) or 2 (z).
    pub fn along([a, b]: [u32; 2], axis: usize) -> Self {
        Self([a, b, Self::AXIS + axis as u32])
    }

    /// Returns the axis of a plane along an axis, or `None` for a plane through three points.
    pub fn axis(self) -> Option<usize> {
        (self.0[2] >= Self::AXIS).then(|| (self.0[2] - Self::AXIS) as usize)
    }

    /// Returns the numbers of the two or three points that define the plane.
    pub fn given(&self) -> &[u32] {
        &self.0[..if self.axis().is_some() { 2 } else { 3 }]
    }

    /// Returns the side of the plane on which the position `place` is: `Greater` in front of the plane,
    /// `Less` behind, and `Equal` on the plane.
    pub fn side(self, points: &[[f32; 3]], place: [f32; 3]) -> Ordering {
        let [a, b] = [self.0[0], self.0[1]].map(|n| points[n as usize]);
        if let Some(axis) = self.axis() {
            let flat = |p: [f32; 3]| [p[(axis + 1) % 3], p[(axis + 2) % 3]];
            return orient2d_sign(flat(a), flat(b), flat(place)).reverse();
        }
        let [a, b, c, p] = [a, b, points[self.0[2] as usize], place].map(Vec3::from);
        orient3d_sign(a, b, c, p)
    }

    /// Returns the side of the plane on which the point with the number `point` is ([`Self::side`]).
    pub fn side_of(self, points: &[[f32; 3]], point: u32) -> Ordering {
        if self.given().contains(&point) {
            return Ordering::Equal;
        }
        self.side(points, points[point as usize])
    }

    /// Returns the sign of a coordinate of the normal: `Greater` if the front is towards larger coordinates.
    pub fn normal_sign(self, points: &[[f32; 3]], axis: usize) -> Ordering {
        let [a, b] = [self.0[0], self.0[1]].map(|n| points[n as usize]);
        let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
        match self.axis() {
            None => {
                let flat = |p: [f32; 3]| [p[next], p[last]];
                orient2d_sign(flat(a), flat(b), flat(points[self.0[2] as usize]))
            }
            // The normal is (b − a) × axis.
            Some(own) if own == last => b[next].partial_cmp(&a[next]).unwrap_or(Ordering::Equal),
            Some(own) if own == next => a[last].partial_cmp(&b[last]).unwrap_or(Ordering::Equal),
            Some(_) => Ordering::Equal,
        }
    }

    /// Returns true if an axis is parallel to the plane.
    fn holds_direction(self, points: &[[f32; 3]], axis: usize) -> bool {
        let [a, b] = [self.0[0], self.0[1]].map(|n| points[n as usize]);
        match self.axis() {
            Some(own) => own == axis || a[3 - own - axis] == b[3 - own - axis],
            None => {
                let c = points[self.0[2] as usize];
                let flat = |p: [f32; 3]| [p[(axis + 1) % 3], p[(axis + 2) % 3]];
                orient2d_sign(flat(a), flat(b), flat(c)) == Ordering::Equal
            }
        }
    }

    /// Returns true if two planes are equal: both contain the same points of space.
    pub fn is(self, other: Self, points: &[[f32; 3]]) -> bool {
        self.given()
            .iter()
            .all(|p| other.side_of(points, *p) == Ordering::Equal)
            && self
                .axis()
                .is_none_or(|axis| other.holds_direction(points, axis))
    }

    /// Computes a hash of the plane. Equal planes have the same hash; different planes rarely do.
    pub fn name(self, points: &[[f32; 3]]) -> u64 {
        let residues = |n: u32| {
            points[n as usize].map(|x| {
                let (mantissa, exponent) = dyadic(f64::from(x));
                Residue::dyadic(mantissa, exponent)
            })
        };
        let [a, b] = [self.0[0], self.0[1]].map(residues);
        let plane = match self.axis() {
            Some(axis) => along_axis([&a, &b], axis),
            None => through_points([&a, &b, &residues(self.0[2])]),
        };
        let first = plane
            .iter()
            .copied()
            .find(|c| c.get() != 0)
            .unwrap_or_default();
        let scale = first.inverse();
        plane.iter().fold(0, |name: u64, c| {
            (name.rotate_left(17) ^ c.mul(&scale).get()).wrapping_mul(SPREAD)
        })
    }
}

/// An odd multiplier that distributes the bits of a hash.
const SPREAD: u64 = 0x9e37_79b9_7f4a_7c15;

/// Returns the axis to which the planes through the edges of a triangle are parallel: 0, 1 or 2.
///
/// The axis is not parallel to the triangle, so these planes differ from the triangle's own plane. The
/// function prefers the axis that is closest to the triangle's normal.
pub fn axis_apart(corners: [[f32; 3]; 3]) -> usize {
    let [a, b, c] = corners.map(|p| p.map(f64::from));
    let minor =
        |i: usize, j: usize| ((b[i] - a[i]) * (c[j] - a[j]) - (b[j] - a[j]) * (c[i] - a[i])).abs();
    let size = [minor(1, 2), minor(2, 0), minor(0, 1)];
    let mut order = [0, 1, 2];
    order.sort_by(|i, j| size[*j].total_cmp(&size[*i]));
    let apart = |axis: &usize| {
        let [a, b, c] = corners.map(|p| [p[(axis + 1) % 3], p[(axis + 2) % 3]]);
        orient2d_sign(a, b, c) != Ordering::Equal
    };
    // A triangle with area is parallel to at most two axes.
    order.into_iter().find(apart).unwrap_or(order[0])
}

/// A table that assigns numbers to planes.
#[derive(Default)]
pub struct PlaneTable {
    /// The planes by number.
    pub planes: Vec<Plane>,
    /// For each hash ([`Plane::name`]), the number of the last plane with this hash.
    last: FxHashMap<u64, u32>,
    /// For each plane, the number of the previous plane with the same hash, or [`NONE`].
    before: Vec<u32>,
}

impl PlaneTable {
    /// Returns the number of a plane. Adds the plane if the table does not contain an equal plane. `name` is
    /// the result of [`Plane::name`].
    pub fn number(&mut self, plane: Plane, name: u64, points: &[[f32; 3]]) -> u32 {
        let last = self.last.get(&name).copied();
        let mut at = last;
        while let Some(n) = at {
            if plane.is(self.planes[n as usize], points) {
                return n;
            }
            at = Some(self.before[n as usize]).filter(|b| *b != NONE);
        }
        let n = self.planes.len() as u32;
        self.planes.push(plane);
        self.before.push(last.unwrap_or(NONE));
        self.last.insert(name, n);
        n
    }

    /// Adds a plane without a search for an equal plane, and returns its number.
    ///
    /// Use this function for planes that no decision compares with other planes.
    pub fn add(&mut self, plane: Plane) -> u32 {
        self.planes.push(plane);
        self.before.push(NONE);
        self.planes.len() as u32 - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_planes_share_one_number() {
        let points = [
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [0.0, 1.0, 1.0],
            [7.0, 3.0, 1.0],
            [-2.5, 8.0, 1.0],
            [3.0, 3.5, 1.0],
            [0.0, 0.0, 2.0],
        ];
        let mut table = PlaneTable::default();
        let mut number = |p: Plane| table.number(p, p.name(&points), &points);
        let first = number(Plane([0, 1, 2]));
        assert_eq!(number(Plane([3, 5, 4])), first);
        assert_eq!(number(Plane::along([3, 4], 0)), first);
        assert_eq!(number(Plane::along([3, 4], 1)), first);
        assert_ne!(number(Plane::along([3, 4], 2)), first);
        let upright = number(Plane([0, 1, 6]));
        assert_eq!(number(Plane::along([0, 1], 2)), upright);
        assert_ne!(upright, first);
    }

    #[test]
    fn normal_points_to_front_of_plane() {
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert_eq!(
            Plane([0, 1, 2]).side(&points, [0.2, 0.2, 1.0]),
            Ordering::Greater
        );
        // x × z = −y.
        assert_eq!(
            Plane::along([0, 1], 2).side(&points, [0.0, -1.0, 0.0]),
            Ordering::Greater
        );
        // x × y = z, and y × x = −z.
        assert_eq!(
            Plane::along([0, 1], 1).side(&points, [0.0, 0.0, 1.0]),
            Ordering::Greater
        );
        assert_eq!(
            Plane::along([0, 2], 0).side(&points, [0.0, 0.0, 1.0]),
            Ordering::Less
        );
        let planes = [
            Plane([0, 1, 2]),
            Plane([2, 1, 0]),
            Plane::along([0, 1], 2),
            Plane::along([0, 1], 1),
        ];
        for plane in planes
            .into_iter()
            .chain([Plane::along([0, 2], 0), Plane::along([1, 2], 2)])
        {
            for axis in 0..3 {
                let step = |by: f32| {
                    let mut p = points[plane.0[0] as usize];
                    p[axis] += by;
                    plane.side(&points, p)
                };
                assert_eq!(
                    plane.normal_sign(&points, axis),
                    step(1.0),
                    "{plane:?} {axis}"
                );
                assert_eq!(
                    plane.normal_sign(&points, axis),
                    step(-1.0).reverse(),
                    "{plane:?} {axis}"
                );
            }
        }
    }
}
