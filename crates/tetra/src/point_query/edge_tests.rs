//! A fast test in doubles that shows that an edge of a triangle separates the triangle from a ring.
//!
//! The test uses one error bound per edge.
//!
//! Most triangles that are compared with a beam are next to the beam, and share a point or an edge with a
//! triangle that is visible in the beam. If the test returns true, the triangle is certainly separate;
//! [`super::outline`] decides the other cases.

use sightline_geometry::rounding::UNIT as U;
use sightline_geometry::vector::{cross, dot};

use super::beam::Edge;
use super::eye::Eye;
use super::rounded::{LEAST, RoundedNumber, Vector, size};

/// The edges of a triangle, as seen from the viewpoint.
pub(super) struct Edges {
    points: [u32; 3],
    /// The normals of the planes through the viewpoint and each edge. The triangle is on the positive sides.
    normals: [Vector; 3],
    /// For each edge, the product of the sizes of the two vectors whose cross product is the normal.
    sizes: [f64; 3],
}

impl Edges {
    /// Computes the edges of a triangle, given by three point numbers.
    ///
    /// Returns `None` if doubles do not decide the side of the triangle's plane on which the viewpoint is.
    ///
    /// Let a and e be the sizes of the vector to a point and of an edge's vector, both rounded once. A
    /// component of their cross product is at most 2ae. Up to second order, it errs by at most 10uae: 4uae
    /// from the vectors, and 6uae from products and a difference. Its scalar product with a vector of size d,
    /// which is rounded once too, errs by at most 3 · 10uaed + 3 · 2uaed from these, and by 5u · 6aed from
    /// products and sums. The bound 128uaed is larger. Each underflow loses less than [`LEAST`].
    #[inline]
    pub fn new(eye: &Eye<'_>, points: [u32; 3]) -> Option<Self> {
        let places = points.map(|p| eye.point(p));
        let minus = |p: Vector, q: Vector| [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
        let along = [
            minus(places[1], places[0]),
            minus(places[2], places[1]),
            minus(places[0], places[2]),
        ];
        let ways = places.map(|p| minus(p, eye.x));
        let mut normals = [
            cross(ways[0], along[0]),
            cross(ways[1], along[1]),
            cross(ways[2], along[2]),
        ];
        let sizes = [0, 1, 2].map(|k| size(ways[k]) * size(along[k]));
        // The vector to the third point is the vector to the first point plus the vector from there. The
        // normal is perpendicular to the vector to the first point.
        let turn = -dot(normals[0], along[2]);
        let reach = size(along[2]);
        let error = 128.0 * U * sizes[0] * reach + 8.0 * LEAST * (reach + 1.0);
        match (RoundedNumber { value: turn, error }).sign()? {
            1 => {}
            _ => normals = normals.map(|n| n.map(|c| -c)),
        }
        Some(Self {
            points,
            normals,
            sizes,
        })
    }

    /// Returns true if an edge of the triangle certainly separates the triangle from a ring's interior.
    ///
    /// A corner's components are below 2, so its scalar product with a normal errs by at most 3 · 2 · 10uae +
    /// 3 · 2ae · ε + 5u · 12ae, with ε the corner's own bound. A corner in the direction of one of the edge's
    /// points is in the edge's plane.
    #[inline]
    pub fn are_beside(&self, ring: &[Edge]) -> bool {
        (0..3).any(|k| {
            let (a, b) = (self.points[k], self.points[if k == 2 { 0 } else { k + 1 }]);
            let (normal, size) = (self.normals[k], self.sizes[k]);
            ring.iter().all(|edge| {
                let corner = &edge.corner;
                let error = size * (7.0 * corner.way.error + 128.0 * U) + 16.0 * LEAST;
                dot(normal, corner.way.v) < -error || corner.point == a || corner.point == b
            })
        })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "these are tests")]
mod tests {
    use proptest::prelude::*;

    use super::super::beam::{self, BeamSide};
    use super::super::outline::Outline;
    use super::super::planes::Planes;
    use super::super::rings::Rings;
    use super::*;
    use crate::point_query::eye::unit_of;

    /// Generates points of a coarse lattice, so that many are collinear or coplanar, moved and scaled.
    fn lattice() -> impl Strategy<Value = Vec<[f32; 3]>> {
        let point = [-3i8..4, -3i8..4, -3i8..4];
        (prop::collection::vec(point, 6), -60i32..60, 0u8..3).prop_map(|(points, power, moved)| {
            let place = |p: [i8; 3]| p.map(|c| f32::from(c) * f32::powi(2.0, power));
            points
                .into_iter()
                .map(place)
                .map(|p| if moved == 0 { p } else { p.map(|c| c + 0.3) })
                .collect()
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100_000))]

        #[test]
        fn are_beside_implies_exact_separation(
            points in lattice(),
            x in prop::array::uniform3((-12i8..13, -2i8..3)),
            octant in 0u32..8,
        ) {
            // The viewpoint is near a place where planes through points meet in one line, or at a tiny offset
            // from it.
            let size = points.iter().flatten().fold(0.0f32, |m, c| m.max(c.abs()));
            let unit = f64::from(size) / 12.0;
            let x = x.map(|(c, hair)| (f64::from(c) + f64::from(hair) * 4.0 * f64::EPSILON) * unit);
            let eye = Eye::new(x, &points, &[], unit_of(points.iter().flatten().map(|c| f64::from(*c))));
            let (mut planes, mut rings, mut ring) = (Planes::default(), Rings::default(), Vec::new());
            beam::octant(&mut planes, &eye, octant, &mut ring);
            // The corners of the ring are directions to points.
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                let side = planes.add_edge(&eye, a, b);
                if beam::place(&mut planes, &eye, &ring, side, &mut rings.signs) == BeamSide::Both {
                    let Rings { signs, next, far, .. } = &mut rings;
                    beam::cut(&mut planes, &eye, &ring, side, signs, next, far);
                    std::mem::swap(&mut ring, next);
                }
            }
            for triangle in [[3, 4, 5], [0, 3, 4], [0, 1, 3], [1, 0, 4], [2, 1, 5]] {
                if let Some(edges) = Edges::new(&eye, triangle) {
                    let outline = Outline::new(&eye, triangle);
                    prop_assert!(outline.is_some(), "its plane holds the viewpoint");
                    let exactly = outline.unwrap().is_beside(&mut planes, &eye, &ring);
                    prop_assert!(exactly || !edges.are_beside(&ring));
                }
            }
        }
    }

    #[test]
    fn are_beside_holds_across_shared_edge() {
        let points = [
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [0.0, 1.0, 1.0],
            [1.0, -1.0, 1.0],
        ];
        let eye = Eye::new([-0.1, -0.2, 0.0], &points, &[], 0);
        let (mut planes, mut rings, mut ring) = (Planes::default(), Rings::default(), Vec::new());
        beam::octant(&mut planes, &eye, 0, &mut ring);
        assert!(
            Outline::new(&eye, [0, 1, 2])
                .unwrap()
                .clip(&mut planes, &eye, &ring, &mut rings)
        );
        for (triangle, beside) in [([1, 0, 3], true), ([0, 1, 2], false), ([0, 2, 3], false)] {
            assert_eq!(
                Edges::new(&eye, triangle)
                    .unwrap()
                    .are_beside(&rings.inside),
                beside,
                "{triangle:?}"
            );
        }
    }
}
